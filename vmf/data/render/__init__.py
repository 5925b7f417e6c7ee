"""Simulated images: what the cameras of a simulation see, with known true pixels."""

from vmf.data.render.draw import Film, film, grey

__all__ = ["Film", "film", "grey"]
