"""Arrays that grow at the end, each appended row at constant cost on average."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Scalar = TypeVar("Scalar", bound=np.generic)

# Room grows by this factor whenever it runs out: at most a third of it is ever unused.
_GROWTH = 1.5
_FIRST = 16


class Growing(Generic[Scalar]):
    """Rows of one shape and type, appended in amortised constant time.

    Parameters
    ----------
    shape : of one row.
    dtype : of its entries.
    """

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._room: NDArray[Any] = np.empty((0, *shape), dtype)
        self._n = 0

    def __len__(self) -> int:
        return self._n

    def append(self, rows: ArrayLike) -> None:
        """Add rows (m, …)."""
        rows = np.asarray(rows, self._room.dtype)
        end = self._n + len(rows)
        if end > len(self._room):
            room = np.empty((max(end, int(_GROWTH * end), _FIRST), *self._room.shape[1:]), self._room.dtype)
            room[: self._n] = self._room[: self._n]
            self._room = room
        self._room[self._n : end] = rows
        self._n = end

    @property
    def rows(self) -> NDArray[Scalar]:
        """All rows (n, …) so far: a view, to be read before the next `append`."""
        return self._room[: self._n]
