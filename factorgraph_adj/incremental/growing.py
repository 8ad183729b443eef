"""Arrays that grow at their end, without a copy each time."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from ..types import Array, Index, Mask

Rows: TypeAlias = Array | Index | Mask


class Growing:
    """An array whose rows are appended; room doubles when it is used up."""

    __slots__ = ("_room", "n")

    def __init__(self, start: Rows) -> None:
        """Start with the rows of ``start`` (n, ...)."""
        self._room: Any = np.array(start)
        self.n = len(start)

    @property
    def view(self) -> Any:
        """The rows (n, ...), to read and to write."""
        return self._room[: self.n]

    def append(self, rows: Rows) -> None:
        """Add rows (m, ...)."""
        n = self.n + len(rows)
        if n > len(self._room):
            room = np.empty(
                (max(n, 2 * len(self._room), 8), *self._room.shape[1:]), self._room.dtype
            )
            room[: self.n] = self._room[: self.n]
            self._room = room
        self._room[self.n : n] = rows
        self.n = n

    def widen(self, width: int, fill: object) -> None:
        """Give every row ``width`` columns at least, new ones filled."""
        have = self._room.shape[1]
        if width > have:
            more = np.full((len(self._room), width - have), fill, dtype=self._room.dtype)
            self._room = np.concatenate([self._room, more], axis=1)

    def truncate(self, n: int) -> None:
        """Keep the first n rows."""
        self.n = n

    def keep(self, rows: Rows) -> None:
        """Keep some rows (mask or numbers), in their order."""
        kept = self.view[rows]
        self._room, self.n = np.array(kept), len(kept)
