"""How a user hears of trouble: a wrong input, work that was not finished, data that was partly lost."""

from __future__ import annotations

from dataclasses import dataclass


class InputError(Exception):
    """The user's input is wrong (exit code 2); every line names place, finding and what is accepted."""

    def __init__(self, *lines: str) -> None:
        super().__init__("\n".join(lines))
        self.lines = lines


class UnfinishedError(Exception):
    """Work could not be finished although the input may be right (exit code 3), one reason per line."""

    def __init__(self, *lines: str) -> None:
        super().__init__("\n".join(lines))
        self.lines = lines


@dataclass(frozen=True)
class Loss:
    """Something that could not be used although the work went on (exit code 3).

    Attributes
    ----------
    place : file, topic or stage where it was lost.
    what : what was lost and why, in words.
    count : how many items.
    """

    place: str
    what: str
    count: int

    def __str__(self) -> str:
        return f"{self.place}: {self.what} ({self.count})"
