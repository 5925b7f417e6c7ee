"""All equations about a later estimate, a few with every new frame (§4).

Equations about different estimates must not be added: together they would fix what no task can see. So those
of everything observed are made anew about one estimate while new frames go on entering the old ones, and take
their place when they have caught up. A frame's work is bounded and given by counts alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from vmf.learn.adjustment import Estimate, System

# Adds to a system the equations of the observations from one number up to another, about an estimate.
Equations = Callable[[System, Estimate, int, int], System]

# Observations looked at again for each new one: all are about a new estimate when they are an eighth more.
_AGAIN = 8
# Fewer are not worth their overhead.
_AT_ONCE = 256


@dataclass(frozen=True)
class Renewal:
    """Equations of the first observations about one estimate.

    Attributes
    ----------
    about : the estimate.
    system : the equations so far.
    done : how many observations were looked at.
    owed : how many more may be by now.
    """

    about: Estimate
    system: System
    done: int = 0
    owed: int = 0

    @classmethod
    def of(cls, about: Estimate) -> Renewal:
        """Return the beginning of a renewal."""
        return cls(about, System.nothing(len(about.points)))

    def went_on(
        self, new: int, end: int, equations: Callable[[System, Estimate, int, int], System]
    ) -> Renewal:
        """Return the renewal after further observations.

        Parameters
        ----------
        new : how many observations are new.
        end : how many there are.
        equations : adds those of some observations.
        """
        owed = self.owed + _AGAIN * new
        if owed < _AT_ONCE:
            return replace(self, owed=owed)
        upto = min(self.done + owed, end)
        return Renewal(self.about, equations(self.system, self.about, self.done, upto), upto)
