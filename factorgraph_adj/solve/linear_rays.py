"""The linearised image coordinates of one block, in chunks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..graph.blocks import Block
from ..graph.image_chunks import ImageChunks, RayPartials
from ..graph.variables import State
from ..models.variables import VariableKind
from ..types import Array, Index
from .point_cholesky import DIAGONAL, ELEMENTS

OF_POINT = slice(3, 6)
"""Partials by X₀ among those of a ray: partials by the object point have the opposite sign."""


@dataclass(frozen=True)
class LinearRays:
    """Image coordinates, linearised; it answers as `factorgraph_adj.solve.linear.LinearBlock`."""

    chunks: ImageChunks
    """The rays in chunks."""
    parts: tuple[RayPartials, ...]
    """Whitened residuals and partials of each chunk."""
    kinds: frozenset[VariableKind] = frozenset(("pose", "calibration", "point"))
    """Kinds of variables that are not held."""

    @classmethod
    def at(cls, chunks: ImageChunks, state: State) -> LinearRays:
        """Linearise at a state.

        Raises:
            InputError: rays in the focal plane of their photo; the message names all of them.
        """
        return cls(chunks, tuple(chunks.linearise(state)))

    def only(self, kinds: Collection[VariableKind]) -> LinearRays:
        """Return the rays with the other kinds of variables held."""
        return replace(self, kinds=self.kinds.intersection(kinds))

    @property
    def block(self) -> Block:
        """The observations."""
        return self.chunks.block

    @cached_property
    def offsets(self) -> tuple[Index, ...]:
        """First column of pose, calibration and point (n,), −1 where they are constants."""
        unknowns = self.chunks.unknowns
        return tuple(unknowns[kind].offset[index] for kind, index in self.block.variables)

    @cached_property
    def a(self) -> tuple[Array, ...]:
        """Partials by pose (n, 2, 6), calibration (n, 2, k) and point (n, 2, 3), whitened.

        They are zero for held components, and empty if all variables of the kind are held.
        """
        return self.partials(np.arange(self.block.n))

    def partials(self, rows: Index) -> tuple[Array, ...]:
        """Return the partials of some rays, as ``a``; ``rows`` (n,) are in ascending order."""
        lens = self.block.lens
        assert lens is not None
        free = self.chunks.lens_free
        n = len(rows)
        pose, point = np.empty((n, 2, 6)), np.empty((n, 2, 3))
        calibration = np.zeros((n, 2, len(lens.names)))
        cuts = np.searchsorted(rows, [p.chunk.rows.start for p in self.parts] + [self.block.n])
        for part, start, stop in zip(self.parts, cuts[:-1], cuts[1:], strict=True):
            if start == stop:
                continue
            a = part.a[:, :, rows[start:stop] - part.chunk.rows.start].transpose(2, 1, 0)
            pose[start:stop] = a[:, :, :6]
            calibration[start:stop, :, free] = a[:, :, 6:]
            np.negative(a[:, :, OF_POINT], out=point[start:stop])
        out = []
        for (kind, index), partials in zip(
            self.block.variables, (pose, calibration, point), strict=True
        ):
            table = self.chunks.unknowns[kind]
            if kind not in self.kinds or not (table.offset[index] >= 0).any():
                out.append(partials[:0])
                continue
            partials *= table.free[index[rows], None, : partials.shape[2]]
            out.append(partials)
        return tuple(out)

    def residual(self) -> Array:
        """Return the whitened residuals (n, 2)."""
        out = np.empty((self.block.n, 2))
        for part in self.parts:
            out[part.chunk.rows] = part.v.T
        return out

    # -- sums of products -------------------------------------------------------------------------

    @cached_property
    def photos(self) -> tuple[list[Array], ...]:
        """[A v]ᵀ[A v] of the rays of each photo of each chunk, (7 + k, 7 + k) each."""
        return tuple(
            photo_products(p.rows, [(start, stop) for _, start, stop in p.chunk.parts])
            for p in self.parts
        )

    @cached_property
    def points(self) -> Array:
        """JᵀJ, see `point_cholesky.ELEMENTS`, and Jᵀv of each point of the network, (9, n)."""
        out = np.zeros((len(self.chunks.unknowns["point"].names), 9))
        for part, of_points in zip(self.parts, self.chunks.sums, strict=True):
            j = part.a[OF_POINT]
            products = np.empty((9, j.shape[2]))
            for place, (r, c) in enumerate(ELEMENTS):
                add_components(j[r], j[c], products[place])
            for axis in range(3):
                add_components(j[axis], part.v, products[6 + axis])
            of_points.add(out, np.ascontiguousarray(products.T))
        out = np.ascontiguousarray(out.T)
        np.negative(out[6:], out=out[6:])
        return out

    def add_gradient(self, out: Array) -> None:
        """Add Aᵀv to out (n_columns,)."""
        self._add_sums(out, lambda product: product[:-1, -1], self.points[6:])

    def add_diagonal(self, out: Array) -> None:
        """Add the diagonal of AᵀA to out (n_columns,)."""
        self._add_sums(out, lambda product: np.diag(product)[:-1], self.points[list(DIAGONAL)])

    def _add_sums(self, out: Array, of_photo: Callable[[Array], Array], of_points: Array) -> None:
        """Add what the products of photos give, (6 + k,), and values of points (3, n)."""
        sums = self._zeros(1)
        calibration = self.block.variables[1][1]
        free = self.chunks.lens_free
        for part, products in zip(self.parts, self.photos, strict=True):
            for (photo, start, _), product in zip(part.chunk.parts, products, strict=True):
                value = of_photo(product)
                number = calibration[part.chunk.rows.start + start]
                sums["pose"][photo, :, 0] += value[:6]
                sums["calibration"][number, free, 0] += value[6:]
        sums["point"] = of_points.T[:, :, None]
        self._add(out[:, None], sums)

    # -- products ---------------------------------------------------------------------------------

    def times(self, g: Array) -> Array:
        """Return A G (n, 2, k) for G (n_columns, k)."""
        k = g.shape[1]
        out = np.empty((self.block.n, 2, k))
        poses, lenses, points = (self._values(kind, g) for kind in ("pose", "calibration", "point"))
        calibration, point = (self.block.variables[i][1] for i in (1, 2))
        free = self.chunks.lens_free
        lenses = lenses[:, free]
        columns = np.ascontiguousarray(points.transpose(2, 1, 0))  # (k, 3, points)
        for part in self.parts:
            rows = part.chunk.rows
            product = np.empty((2, rows.stop - rows.start, k))
            for photo, start, stop in part.chunk.parts:
                x = np.concatenate([poses[photo], lenses[calibration[rows.start + start]]])
                for row in range(2):
                    np.matmul(part.a[:, row, start:stop].T, x, out=product[row, start:stop])
            for column in range(k):
                moved = np.take(columns[column], point[rows], axis=1)
                by_point = part.a[OF_POINT]
                product[:, :, column] -= (
                    by_point[0] * moved[0] + by_point[1] * moved[1] + by_point[2] * moved[2]
                )
            out[rows] = product.transpose(1, 0, 2)
        return out

    def add_transposed(self, out: Array, z: Array) -> None:
        """Add Aᵀ Z to out (n_columns, k), for Z (n, 2, k)."""
        k = z.shape[2]
        sums = self._zeros(k)
        calibration = self.block.variables[1][1]
        free = self.chunks.lens_free
        for part, of_points in zip(self.parts, self.chunks.sums, strict=True):
            rows = part.chunk.rows
            w = np.ascontiguousarray(z[rows].transpose(1, 0, 2))
            for photo, start, stop in part.chunk.parts:
                a = part.a[:, :, start:stop]
                value = a[:, 0] @ w[0, start:stop] + a[:, 1] @ w[1, start:stop]
                sums["pose"][photo] += value[:6]
                sums["calibration"][calibration[rows.start + start], free] += value[6:]
            products = np.empty((rows.stop - rows.start, 3, k))
            for i, a in enumerate(part.a[OF_POINT]):
                products[:, i] = -(a[0, :, None] * w[0] + a[1, :, None] * w[1])
            flat = sums["point"].reshape(-1, 3 * k)
            of_points.add(flat, products.reshape(len(products), -1))
        self._add(out, sums)

    def _values(self, kind: VariableKind, g: Array) -> Array:
        """Return G of every variable of a kind, (n, width, k); zero for held components."""
        table = self.chunks.unknowns[kind]
        if kind not in self.kinds:
            return np.zeros((*table.free.shape, g.shape[1]))
        held = ~self.chunks.unknowns.free[table.columns]
        if held.any():
            g = g.copy()
            g[table.columns][held] = 0.0
        return table.of_columns(g[table.columns])

    def _zeros(self, k: int) -> dict[VariableKind, Array]:
        unknowns = self.chunks.unknowns
        return {
            kind: np.zeros((len(unknowns[kind].names), unknowns[kind].free.shape[1], k))
            for kind, _ in self.block.variables
        }

    def _add(self, out: Array, sums: dict[VariableKind, Array]) -> None:
        """Add sums (n, width, k) of each kind to out (n_columns, k), without held components."""
        for kind in self.kinds:
            columns = self.chunks.unknowns[kind].columns
            free = self.chunks.unknowns.free[columns, None]
            out[columns] += self.chunks.unknowns[kind].in_columns(sums[kind]) * free


def photo_products(rows: Array, runs: Iterable[tuple[int, int]]) -> list[Array]:
    """Return [A v]ᵀ[A v] (7 + k, 7 + k) of runs of rays, given as [A v] (7 + k, 2, m)."""
    out = []
    for start, stop in runs:
        x, y = rows[:, 0, start:stop], rows[:, 1, start:stop]
        product = x @ x.T
        product += y @ y.T
        out.append(product)
    return out


def add_components(a: Array, b: Array, out: Array) -> None:
    """Write the sum over both components of a and b (2, m) to out (m,)."""
    np.multiply(a[0], b[0], out=out)
    out += a[1] * b[1]
