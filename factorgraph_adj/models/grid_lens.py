"""Correction grid of a camera: measured coordinates are corrected by a table before another lens.

    (x', y') = (x, y) + (dx, dy)(x, y),    v = computed − corrected by the lens behind it (x', y')

dx and dy are given at the nodes of a grid of image coordinates as they are measured, x right and y
up, and bilinear between them; outside of the grid those of its nearest edge count. As the table is
a function of measured coordinates alone, partials are those of the lens behind it, whose
parameters can be free or held. With modes φ_i at the nodes, the signal of the images is unknown,

    (dx, dy)(x, y) + Σ_i (sx_i, sy_i) φ_i(x, y),

and its amplitudes sx_i, sy_i are further parameters: those of a random field, with a common
standard deviation, see `factorgraph_adj.collocation.signal_variables`. Calibration laboratories
state grids without modes (corrections, ideal − measured; distortions, measured − ideal, have the
opposite signs), and collocation of the residuals of a block makes them, see
`factorgraph_adj.collocation.image_corrections`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..errors import InputError, Problem
from ..types import Array, Index
from .lens import Lens, LensPartials, Pair
from .scanner_lens import LineLens


@dataclass(frozen=True)
class GridLens(Lens):
    """Correction grid before another lens model of tangents, measured → ideal.

    Raises:
        InputError: nodes do not increase, tables have other sizes, a value is not finite, the lens
            behind the grid takes rays or places, or its y is time and is to be corrected.
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
    modes: tuple[tuple[float, ...], ...] = ()
    """Modes φ of the signal at the nodes: of each the rows from below, one after the other."""

    def __post_init__(self) -> None:
        """Check sizes and values."""
        problems = []
        if self.base.takes != "tangents" or isinstance(self.base, GridLens):
            what = f"the lens behind a grid must be a model of tangents, not {self.base.kind!r}"
            problems.append(Problem(what))
        elif y_is_time(self.base) and (self.modes or np.any([v for row in self.dy for v in row])):
            what = (
                f"y of the lens {self.base.kind!r} is the time of a line of the image, so that "
                "corrections dy have no effect: give dx alone, and no modes"
            )
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
        if any(len(m) != size[0] * size[1] or not np.isfinite(m).all() for m in self.modes):
            problems.append(Problem(f"a mode must have {size[0]} × {size[1]} finite values"))
        if problems:
            raise InputError(problems)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters: those of the lens behind the grid, amplitudes."""
        numbers = range(1, len(self.modes) + 1)
        return (*self.base.names, *(f"s{a}{i}" for a in "xy" for i in numbers))

    @property
    def in_ideal_coordinates(self) -> Lens:
        """The grid before its lens with residuals in ideal coordinates."""
        return replace(self, base=self.base.in_ideal_coordinates)

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`."""
        dx, dy = self.corrections(x, y)
        if not self.modes:
            return self.base.partials(tx, ty, x + dx, y + dy, k, jacobians=jacobians)
        first, m = len(self.base.names), len(self.modes)
        phi = self._between(self._modes, x, y)
        dx = dx + np.einsum("mn,nm->n", phi, np.broadcast_to(k[:, first : first + m], (len(x), m)))
        own = np.broadcast_to(k[:, first + m : first + 2 * m], (len(x), m))
        dy = dy + np.einsum("mn,nm->n", phi, own)
        found = self.base.partials(tx, ty, x + dx, y + dy, k[:, :first], jacobians=jacobians)
        if not jacobians:
            return found
        # v depends on x − x0 and y − y0: its partials by x and y are those by x0 and y0, negative.
        by_sx, by_sy = ([(-px * f, -py * f) for f in phi] for px, py in found.by_k[1:3])
        return found._replace(by_k=(*found.by_k, *by_sx, *by_sy))

    def towards_ideal(self, x: Array, y: Array, k: Array) -> Pair:
        """Return differences of measured coordinates turned back, see `Lens.towards_ideal`."""
        return self.base.towards_ideal(x, y, k)

    def corrections(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return dx and dy at measured coordinates, (n,) each."""
        if not self.x:
            return np.zeros_like(x), np.zeros_like(y)
        dx, dy = self._between(self._tables, x, y)
        return dx, dy

    def _between(self, tables: Array, x: Array, y: Array) -> Array:
        """Return tables (m, nodes of y, nodes of x) at measured coordinates, bilinear, (m, n)."""
        i, s = _cell(self._nodes[0], x)
        j, t = _cell(self._nodes[1], y)
        below = (1.0 - s) * tables[:, j, i] + s * tables[:, j, i + 1]
        above = (1.0 - s) * tables[:, j + 1, i] + s * tables[:, j + 1, i + 1]
        return np.asarray((1.0 - t) * below + t * above)

    def neighbours(self, x: Array, y: Array) -> tuple[Index, Array]:
        """Return numbers and weights of the four nodes around coordinates, (n, 4) each."""
        i, s = _cell(self._nodes[0], x)
        j, t = _cell(self._nodes[1], y)
        first, row = j * len(self.x) + i, len(self.x)
        number = np.column_stack([first, first + 1, first + row, first + row + 1])
        return number, np.column_stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t])

    def refined(self, step: float) -> GridLens:
        """Return the same corrections with further nodes, in distances of a step at most."""
        x, y = (_refined(nodes, step) for nodes in self._nodes)
        at_x, at_y = np.meshgrid(x, y)
        tables = self._between(self._tables, at_x.ravel(), at_y.ravel()).reshape(2, *at_x.shape)
        dx, dy = (tuple(tuple(row) for row in table.tolist()) for table in tables)
        return replace(self, x=tuple(x.tolist()), y=tuple(y.tolist()), dx=dx, dy=dy)

    def plus(self, dx: Array, dy: Array) -> GridLens:
        """Return the grid with further corrections at its nodes, (nodes of y, nodes of x) each."""
        own = (np.asarray(self.dx) + dx, np.asarray(self.dy) + dy)
        tables = [tuple(tuple(row) for row in table.tolist()) for table in own]
        return replace(self, dx=tables[0], dy=tables[1])

    @cached_property
    def _nodes(self) -> tuple[Array, Array]:
        return np.array(self.x), np.array(self.y)

    @cached_property
    def _tables(self) -> Array:
        return np.array([self.dx, self.dy])

    @cached_property
    def _modes(self) -> Array:
        return np.array(self.modes).reshape(len(self.modes), len(self.y), len(self.x))


def y_is_time(lens: Lens) -> bool:
    """Return whether the measured y of image points is a time alone, on which no ray depends."""
    return isinstance(lens.base if isinstance(lens, GridLens) else lens, LineLens)


def _cell(nodes: Array, at: Array) -> tuple[Index, Array]:
    """Return the cell of each coordinate, and where it lies in it, from 0 to 1."""
    found = np.searchsorted(nodes, at, side="right") - 1
    i = np.clip(found, 0, len(nodes) - 2).astype(np.intp)
    share = (at - nodes[i]) / (nodes[i + 1] - nodes[i])
    return i, np.clip(share, 0.0, 1.0)


def _refined(nodes: Array, step: float) -> Array:
    """Return nodes with further ones between them."""
    counts = np.maximum(np.ceil(np.diff(nodes) / step * (1.0 - 1e-12)).astype(int), 1)
    parts = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(nodes[:-1], nodes[1:], counts.tolist(), strict=True)
    ]
    return np.concatenate([*parts, nodes[-1:]])
