"""Find a topic in a recording, or say what there is instead."""

from __future__ import annotations

import difflib

from vmf.data.recording.container import Contents
from vmf.errors import InputError


def check_topic(contents: Contents, topic: str, accepted: tuple[str, ...]) -> None:
    """Check that a topic is there, has one of the `accepted` schemas, and holds readable messages.

    Raises
    ------
    InputError : it does not; the topics present and what was damaged are listed.
    """
    found = [(t, n) for t, n in contents.counts if t.name == topic]
    damage = [str(loss) for loss in contents.losses]
    if not found:
        close = difflib.get_close_matches(topic, [t.name for t, _ in contents.counts], n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise InputError(
            f"{contents.path}: no topic {topic}{hint}; topics present: {present(contents)}", *damage
        )
    for t, _ in found:
        if t.schema not in accepted:
            raise InputError(
                f"{contents.path}: topic {topic} has schema {t.schema or 'none'}; "
                f"accepted here: {', '.join(accepted)}"
            )
    if not sum(n for _, n in found):
        raise InputError(f"{contents.path}: topic {topic} holds no readable message", *damage)


def present(contents: Contents) -> str:
    """Return the topics of a recording with their schemas, as text."""
    return ", ".join(f"{t.name} ({t.schema or 'no schema'})" for t, _ in contents.counts) or "none"
