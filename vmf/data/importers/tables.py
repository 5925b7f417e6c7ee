"""Tables in text files, row by row, so that what is wrong can be named by its line."""

from __future__ import annotations

import csv
import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from io import TextIOWrapper
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vmf.errors import InputError
from vmf.regular_file import open_regular

_LINE_CHARS = 2**16
# What is read of a table is held in memory, at some hundred bytes a line.
MAX_ROWS = 4_000_000
# A ROS 2 stamp counts seconds in 32 bits without a sign.
END_NS = 2**32 * 10**9
_TIME = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?")


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes
    ----------
    where : file and line.
    cells : what stands in it, without blanks around.
    """

    where: str
    cells: tuple[str, ...]

    def need(self, count: int) -> None:
        """Check that the row has at least `count` columns.

        Raises
        ------
        InputError : it has fewer.
        """
        if len(self.cells) < count:
            raise InputError(f"{self.where}: found {len(self.cells)} columns, {count} are accepted")

    def number(self, column: int) -> float:
        """Return the number in a column (from 0), which may be NaN or infinite.

        Raises
        ------
        InputError : it is none.
        """
        try:
            if "_" in self.cells[column]:  # Python's own way to write 1000
                raise ValueError
            return float(self.cells[column])
        except ValueError:
            raise InputError(
                f"{self.where}, column {column + 1}: found {self.cells[column]!r}, a number is accepted"
            ) from None

    def time_ns(self, column: int, unit_ns: int = 10**9) -> int:
        """Return the time in a column (from 0) of units of `unit_ns`, to the nanosecond.

        Raises
        ------
        InputError : it is no time that fits a ROS 2 stamp.
        """
        return time_ns(self.cells[column], unit_ns, f"{self.where}, column {column + 1}")


def time_ns(text: str, unit_ns: int, where: str) -> int:
    """Return a time written in units of `unit_ns` (s: 1e9), to the nanosecond.

    Raises
    ------
    InputError : it is no time that fits a ROS 2 stamp.
    """
    unit = "ns (a whole number)" if unit_ns == 1 else "s"
    try:
        # A double would round the seconds of today to a quarter of a microsecond.
        if not _TIME.fullmatch(text):
            raise InvalidOperation
        exact = Decimal(text) * unit_ns
        time = round(exact)
        if unit_ns == 1 and time != exact:
            raise InvalidOperation
    except (InvalidOperation, OverflowError):
        raise InputError(f"{where}: found {text!r}, a time in {unit} is accepted") from None
    if not 0 <= time < END_NS:
        raise InputError(f"{where}: found {text!r}, a time in {unit} from 0 to 2^32 s is accepted")
    return time


def rows(path: Path, separator: str | None) -> Iterator[Row]:
    """Yield the rows of a text file, separated by blanks (None) or a character, without comments (`#`).

    Between blanks are numbers, and comments may stand anywhere; a table may have a name that begins like a
    comment in its first column, so that comments stand above its header alone.

    Raises
    ------
    InputError : the file is missing or no text, or has more than `MAX_ROWS` lines.
    """
    try:
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig", newline="") as file:
            lines = _lines(path, iter(lambda: file.readline(_LINE_CHARS), ""))
            begun = False
            for count, (n, cells) in enumerate(_split(lines, separator)):
                if count == MAX_ROWS:
                    raise InputError(f"{path}:{n}: more than the {MAX_ROWS} lines accepted")
                stripped = tuple(cell.strip() for cell in cells)
                comments = separator is None or not begun
                if any(stripped) and not (comments and stripped[0].startswith("#")):
                    begun = True
                    yield Row(f"{path}:{n}", stripped)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text in UTF-8 (byte {error.start} of a part of it)") from None
    except csv.Error as error:
        raise InputError(f"{path}: is no table separated by {separator!r}: {error}") from None


def times(stamps: Iterable[int]) -> NDArray[np.int64]:
    """Return times (n,) in ns as an array."""
    return np.fromiter(stamps, np.int64)


def columns(header: Row, names: Sequence[str]) -> tuple[int, ...]:
    """Return where the columns of these names stand.

    Raises
    ------
    InputError : one is missing, or stands there twice.
    """
    found = []
    for name in names:
        if header.cells.count(name) != 1:
            how = "no column" if name not in header.cells else "several columns"
            close = difflib.get_close_matches(name, header.cells, n=1) if name not in header.cells else []
            hint = f"; is {close[0]} meant?" if close else ""
            raise InputError(f"{header.where}: {how} {name}{hint}; found: {', '.join(header.cells)}")
        found.append(header.cells.index(name))
    return tuple(found)


def _lines(path: Path, lines: Iterator[str]) -> Iterator[str]:
    for n, line in enumerate(lines, start=1):
        if len(line) == _LINE_CHARS:
            raise InputError(f"{path}:{n}: is longer than the {_LINE_CHARS} characters accepted")
        yield line


def _split(lines: Iterator[str], separator: str | None) -> Iterator[tuple[int, list[str]]]:
    if separator is None:
        yield from ((n, line.split()) for n, line in enumerate(lines, start=1))
        return
    reader = csv.reader(lines, delimiter=separator, strict=True)
    for cells in reader:
        yield reader.line_num, cells
