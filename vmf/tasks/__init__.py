"""The task spaces of Chapter 3, one file each."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from vmf.tasks.base import Task
from vmf.tasks.pan_tilt import PanTilt
from vmf.tasks.planar import Planar
from vmf.tasks.six_dof import SixDof
from vmf.tasks.translation import Translation

TASKS: Mapping[str, Callable[[], Task]] = MappingProxyType(
    {"pan_tilt": PanTilt, "translation": Translation, "planar": Planar, "six_dof": SixDof}
)


def make_task(name: str, lift: str = "general") -> Task:
    """Return the task space of that name; `lift="thesis"` keeps the 8-entry form of `pan_tilt` (C3)."""
    if name == PanTilt.name:
        return PanTilt(lift)
    return TASKS[name]()


__all__ = ["TASKS", "Task", "make_task"]
