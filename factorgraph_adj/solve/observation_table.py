"""The observations of a solution with their residuals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

from ..errors import InputError, known
from ..graph.equations import Equations
from ..types import Array


@dataclass(frozen=True, slots=True)
class ObservationRecord:
    """One scalar observation after the adjustment, SI or image units."""

    id: str
    """Id of the observation."""
    kind: str
    """Kind of the observation."""
    component: str
    """Component of the observation, empty for scalar kinds: x, y; an axis of control or a weighted
    point; a parameter of a weighted calibration."""
    observed: float
    """Observed value."""
    residual: float
    """Computed − observed."""
    sigma: float
    """A-priori standard deviation."""


class ObservationTable(Sequence[ObservationRecord]):
    """A sequence of records of all scalar observations, including weighted unknowns.

    ``residuals`` and ``sigmas`` are arrays in the same order.
    """

    def __init__(self, equations: Equations, residuals: Array) -> None:
        """Describe the rows of ``equations``."""
        self._equations = equations
        self.residuals = residuals
        self.sigmas = equations.sigmas()

    def __len__(self) -> int:
        return len(self.residuals)

    @overload
    def __getitem__(self, row: int) -> ObservationRecord: ...
    @overload
    def __getitem__(self, row: slice) -> list[ObservationRecord]: ...
    def __getitem__(self, row: int | slice) -> ObservationRecord | list[ObservationRecord]:
        """Return one record, or several."""
        if isinstance(row, slice):
            return [self[i] for i in range(*row.indices(len(self)))]
        if row < 0:
            row += len(self)
        for block in self._equations.blocks:
            if block.rows.start <= row < block.rows.stop:
                i, c = divmod(row - block.first_row, block.dimension)
                return ObservationRecord(
                    block.ids[i],
                    block.kind,
                    block.component(i, c),
                    float(block.observed[i, c]),
                    float(self.residuals[row]),
                    float(self.sigmas[row]),
                )
        raise IndexError(row)

    def __iter__(self) -> Iterator[ObservationRecord]:
        return (self[i] for i in range(len(self)))

    def row(self, id: str, component: str | None = None) -> int:
        """Return the row of an observation by its id.

        Args:
            id: id of the observation; ``photo/point`` for image points.
            component: component such as ``x``; needed if the observation has several.

        Raises:
            InputError: no observation has this id, or it has several components and none is named.
        """
        rows = self._rows.get(id, [])
        if not rows:
            raise InputError(f"unknown observation {id!r}; known: {known(self._rows, meant=id)}")
        found = [r for r in rows if component is None or self[r].component == component]
        if len(found) != 1:
            names = ", ".join(self[r].component or f"row {r}" for r in rows)
            raise InputError(
                f"observation {id!r} has the components {names}: name one of them with component="
            )
        return found[0]

    @cached_property
    def _rows(self) -> dict[str, list[int]]:
        out: dict[str, list[int]] = {}
        for row, ident in enumerate(self.ids):
            out.setdefault(ident, []).append(row)
        return out

    @cached_property
    def kinds(self) -> list[str]:
        """Kind of each row."""
        return [b.kind for b in self._equations.blocks for _ in range(b.observed.size)]

    @cached_property
    def ids(self) -> list[str]:
        """Id of each row."""
        return [
            b.ids[i] for b in self._equations.blocks for i in range(b.n) for _ in range(b.dimension)
        ]

    @cached_property
    def normalised(self) -> Array:
        """Residuals divided by their a-priori standard deviations."""
        return self.residuals / self.sigmas
