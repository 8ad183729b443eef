"""Correction grid of a camera: measured coordinates are corrected by a table before another lens.

    (x', y') = (x, y) + (dx, dy)(x, y),    v = computed − corrected by the lens behind it (x', y')

dx and dy are given at the nodes of a grid of image coordinates as they are measured, x right and y
up, and bilinear between them; outside of the grid those of its nearest edge count. As the table is
a function of measured coordinates alone, partials are those of the lens behind it, whose
parameters can be free or held. Calibration laboratories state such grids, and collocation of the
residuals of a block makes them, see `factorgraph_adj.collocation.image_corrections`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..errors import InputError, Problem
from ..types import Array, Index
from .lens import Lens, LensPartials, Pair


@dataclass(frozen=True)
class GridLens(Lens):
    """Correction grid before another lens model of tangents, measured → ideal.

    Raises:
        InputError: nodes do not increase, tables have other sizes, a value is not finite, or the
            lens behind the grid takes rays or places.
    """

    kind: ClassVar[str] = "grid"
    base: Lens = Lens()  # noqa: RUF009 (a lens is frozen)
    """Lens model behind the grid, whose calibration parameters are those of the camera."""
    x: tuple[float, ...] = ()
    """Nodes along x, image units, increasing; none: no correction."""
    y: tuple[float, ...] = ()
    """Nodes along y, image units, increasing, y up."""
    dx: tuple[tuple[float, ...], ...] = ()
    """Corrections of x, image units: a row for each node of y, from below."""
    dy: tuple[tuple[float, ...], ...] = ()
    """Corrections of y, image units, y up: likewise."""

    def __post_init__(self) -> None:
        """Check sizes and values."""
        problems = []
        if self.base.takes != "tangents" or isinstance(self.base, GridLens):
            what = f"the lens behind a grid must be a model of tangents, not {self.base.kind!r}"
            problems.append(Problem(what))
        for name, nodes in (("x", self.x), ("y", self.y)):
            if len(nodes) == 1 or not (np.isfinite(nodes).all() and (np.diff(nodes) > 0).all()):
                problems.append(Problem(f"{name} must be two or more increasing nodes"))
        size = (len(self.y), len(self.x))
        if 0 in size and size != (0, 0):
            problems.append(Problem("x and y must both have nodes"))
        for name, rows in (("dx", self.dx), ("dy", self.dy)):
            lengths = {len(row) for row in rows} or {size[1]}
            if len(rows) != size[0] or lengths != {size[1]}:
                what = f"{name} must have {size[0]} rows (nodes of y) of {size[1]} (nodes of x)"
                problems.append(Problem(what))
            elif not all(np.isfinite(row).all() for row in rows):
                problems.append(Problem(f"{name} must be finite"))
        if problems:
            raise InputError(problems)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters: those of the lens behind the grid."""
        return self.base.names

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`."""
        dx, dy = self.corrections(x, y)
        return self.base.partials(tx, ty, x + dx, y + dy, k, jacobians=jacobians)

    @property
    def in_ideal_coordinates(self) -> GridLens:
        """The grid before the lens with residuals in ideal coordinates."""
        return replace(self, base=self.base.in_ideal_coordinates)

    def towards_ideal(self, x: Array, y: Array, k: Array) -> Pair:
        """Return differences of measured coordinates turned back, see `Lens.towards_ideal`."""
        return self.base.towards_ideal(x, y, k)

    def corrections(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return dx and dy at measured coordinates, (n,) each."""
        if not self.x:
            return np.zeros_like(x), np.zeros_like(y)
        i, s = _cell(self._nodes[0], x)
        j, t = _cell(self._nodes[1], y)
        out = []
        for table in self._tables:
            below = (1.0 - s) * table[j, i] + s * table[j, i + 1]
            above = (1.0 - s) * table[j + 1, i] + s * table[j + 1, i + 1]
            out.append((1.0 - t) * below + t * above)
        return out[0], out[1]

    def plus(self, dx: Array, dy: Array) -> GridLens:
        """Return the grid with further corrections at its nodes, (nodes of y, nodes of x) each."""
        own = (np.asarray(self.dx) + dx, np.asarray(self.dy) + dy)
        tables = [tuple(tuple(row) for row in table.tolist()) for table in own]
        return replace(self, dx=tables[0], dy=tables[1])

    @cached_property
    def _nodes(self) -> tuple[Array, Array]:
        return np.array(self.x), np.array(self.y)

    @cached_property
    def _tables(self) -> tuple[Array, Array]:
        return np.array(self.dx), np.array(self.dy)


def _cell(nodes: Array, at: Array) -> tuple[Index, Array]:
    """Return the cell of each coordinate, and where it lies in it, from 0 to 1."""
    found = np.searchsorted(nodes, at, side="right") - 1
    i = np.clip(found, 0, len(nodes) - 2).astype(np.intp)
    share = (at - nodes[i]) / (nodes[i + 1] - nodes[i])
    return i, np.clip(share, 0.0, 1.0)
