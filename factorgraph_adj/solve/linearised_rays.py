"""Linearised image coordinates: partials, their products by photo, 3 × 3 factors of points.

Image coordinates are linearised in chunks. The sums JᵀJ of the rays to each object point are
factorised for all points at once; their arrays have one contiguous row for each component: x y z of
vectors, xx xy xz yy yz zz of symmetric matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..graph.blocks import Block
from ..graph.image_blocks import POSE, ImageChunks, RayPartials
from ..graph.variables import State
from ..models.unknown_registry import VariableKind
from ..types import Array, Index

SYMMETRIC_ELEMENTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Rows and columns of the elements of a symmetric matrix, in the order of its array."""
DIAGONAL_ELEMENTS = (0, 3, 5)
"""Places of the elements on the diagonal."""
POINT_PARTIALS = slice(3, 6)
"""Partials by X₀ among those of a ray: partials by the object point have the opposite sign."""


class PointCholesky:
    """H = L Lᵀ of the normal matrices H of points."""

    def __init__(self, h: Array, free: Array) -> None:
        """Factorise.

        Args:
            h: the normal matrices, (6, p).
            free: one for each free component, zero for held ones, (3, p). Held components take no
                part: their pivot is one, and what is solved for them is zero.
        """
        tiny = np.finfo(float).tiny
        fx, fy, fz = free
        xx, yy, zz = h[0], h[3], h[5]
        xy, xz, yz = h[1] * (fx * fy), h[2] * (fx * fz), h[4] * (fy * fz)
        l11 = np.sqrt(np.maximum(xx, tiny))
        l21, l31 = xy / l11, xz / l11
        left22 = yy - l21**2
        l22 = np.sqrt(np.maximum(left22, np.maximum(yy * 1e-16, tiny)))
        l32 = (yz - l31 * l21) / l22
        left33 = zz - l31**2 - l32**2
        l33 = np.sqrt(np.maximum(left33, np.maximum(zz * 1e-16, tiny)))
        self.l = np.stack([fx / l11, l21, l31, fy / l22, l32, fz / l33])
        """1/l11, l21, l31, 1/l22, l32, 1/l33, (6, p); zero for held components."""
        with np.errstate(invalid="ignore", divide="ignore"):
            pivots = np.stack([(xx > 0) * 1.0, left22 / yy, left33 / zz])
        np.nan_to_num(pivots, copy=False, nan=0.0)
        self.pivots = np.where(free > 0, pivots, 1.0)
        self._largest = np.maximum(np.stack([xx, yy, zz]), tiny)
        """Pivots relative to the diagonal of H, (3, p); one for held components."""

    def refine(self, second: PointCholesky, points: Index) -> None:
        """Multiply the factors L of some points by the factors of L⁻¹ H L⁻ᵀ."""
        i11, l21, l31, i22, l32, i33 = self.l[:, points]
        j11, m21, m31, j22, m32, j33 = second.l
        with np.errstate(divide="ignore"):
            l22, l33 = _reciprocal(i22), _reciprocal(i33)
            m11, m22 = _reciprocal(j11), _reciprocal(j22)
        self.l[:, points] = (
            i11 * j11,
            l21 * m11 + l22 * m21,
            l31 * m11 + l32 * m21 + l33 * m31,
            i22 * j22,
            l32 * m22 + l33 * m32,
            i33 * j33,
        )
        roots = np.stack([i11, i22, i33])  # zero for held components
        left = second.pivots * second._largest * _reciprocal(roots) ** 2
        self.pivots[:, points] = np.where(roots > 0, left / self._largest[:, points], 1.0)

    def lower(self, b: Array, at: Index | None = None) -> Array:
        """Return L⁻¹ b for b (3, …, m); ``at`` gives the point of each column."""
        e = self.l if at is None else np.take(self.l, at, axis=1)
        out = np.empty_like(b)
        np.multiply(b[0], e[0], out=out[0])
        np.multiply(out[0], e[1], out=out[1])
        np.subtract(b[1], out[1], out=out[1])
        out[1] *= e[3]
        np.multiply(out[0], e[2], out=out[2])
        np.subtract(b[2], out[2], out=out[2])
        out[2] -= out[1] * e[4]
        out[2] *= e[5]
        return out

    def upper(self, b: Array, at: Index | None = None) -> Array:
        """Return L⁻ᵀ b for b (3, …, m); ``at`` gives the point of each column."""
        e = self.l if at is None else np.take(self.l, at, axis=1)
        out = np.empty_like(b)
        np.multiply(b[2], e[5], out=out[2])
        np.multiply(out[2], e[4], out=out[1])
        np.subtract(b[1], out[1], out=out[1])
        out[1] *= e[3]
        np.multiply(out[1], e[1], out=out[0])
        np.subtract(b[0], out[0], out=out[0])
        out[0] -= out[2] * e[2]
        out[0] *= e[0]
        return out

    def covariances(self, inner: Array) -> Array:
        """Return L⁻ᵀ K L⁻¹ (6, p) of all points for K (6, p)."""
        whole = np.empty((3, 3, inner.shape[1]))
        for (i, j), value in zip(SYMMETRIC_ELEMENTS, inner, strict=True):
            whole[i, j] = whole[j, i] = value
        out = self.upper(self.upper(whole).transpose(1, 0, 2))
        return np.stack([out[i, j] for i, j in SYMMETRIC_ELEMENTS])


def _reciprocal(x: Array) -> Array:
    """Return 1/x; zero where x is zero."""
    return np.where(x != 0.0, 1.0 / np.where(x != 0.0, x, 1.0), 0.0)


def symmetric_matrices(elements: Array) -> Array:
    """Return symmetric matrices (p, 3, 3) from their elements (6, p)."""
    out = np.empty((elements.shape[1], 3, 3))
    for (i, j), value in zip(SYMMETRIC_ELEMENTS, elements, strict=True):
        out[:, i, j] = out[:, j, i] = value
    return out


@dataclass(frozen=True)
class LinearRays:
    """Image coordinates, linearised.

    The interface is that of `factorgraph_adj.solve.linearised_equations.LinearBlock`.
    """

    chunks: ImageChunks
    """The rays in chunks."""
    parts: tuple[RayPartials, ...]
    """Whitened residuals and partials of each chunk."""
    kinds: frozenset[VariableKind] = frozenset(("pose", "calibration", "point", "photo_motion"))
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
        """First column of each variable (n,), −1 where they are constants."""
        unknowns = self.chunks.unknowns
        return tuple(unknowns[kind].offset[index] for kind, index in self.block.variables)

    @cached_property
    def a(self) -> tuple[Array, ...]:
        """Partials by pose (n, 2, 6), calibration (n, 2, k), point (n, 2, 3), whitened.

        Photos that move have partials by their motion (n, 2, 6) besides.

        They are zero for held components, and empty if all variables of the kind are held.
        """
        return self.partials(np.arange(self.block.n))

    def partials(self, rows: Index) -> tuple[Array, ...]:
        """Return the partials of some rays, as ``a``; ``rows`` (n,) are in ascending order."""
        lens = self.block.lens
        assert lens is not None
        free = self.chunks.lens_free
        n = len(rows)
        own = self.chunks.own
        of_photo, point = np.empty((n, 2, own)), np.empty((n, 2, 3))
        calibration = np.zeros((n, 2, len(lens.names)))
        cuts = np.searchsorted(rows, [p.chunk.rows.start for p in self.parts] + [self.block.n])
        for part, start, stop in zip(self.parts, cuts[:-1], cuts[1:], strict=True):
            if start == stop:
                continue
            a = part.a[:, :, rows[start:stop] - part.chunk.rows.start].transpose(2, 1, 0)
            of_photo[start:stop] = a[:, :, :own]
            calibration[start:stop, :, free] = a[:, :, own:]
            np.negative(a[:, :, POINT_PARTIALS], out=point[start:stop])
        out = []
        every = [of_photo[:, :, :POSE], calibration, point]
        every += [of_photo[:, :, POSE:]] if own > POSE else []
        for (kind, index), partials in zip(self.block.variables, every, strict=True):
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
        """[A v]ᵀ[A v] of the rays of each photo of each chunk, (own + k + 1, …) square each."""
        return tuple(
            photo_products(p.rows, [(start, stop) for _, start, stop in p.chunk.parts])
            for p in self.parts
        )

    @cached_property
    def points(self) -> Array:
        """JᵀJ, see `SYMMETRIC_ELEMENTS`, and Jᵀv of each point of the network, (9, n)."""
        out = np.zeros((len(self.chunks.unknowns["point"].names), 9))
        for part, of_points in zip(self.parts, self.chunks.sums, strict=True):
            j = part.a[POINT_PARTIALS]
            products = np.empty((9, j.shape[2]))
            for place, (r, c) in enumerate(SYMMETRIC_ELEMENTS):
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
        self._add_sums(
            out, lambda product: np.diag(product)[:-1], self.points[list(DIAGONAL_ELEMENTS)]
        )

    def _add_sums(self, out: Array, of_photo: Callable[[Array], Array], of_points: Array) -> None:
        """Add what the products of photos give, (own + k,), and values of points (3, n)."""
        sums = self._zeros(1)
        calibration = self.block.variables[1][1]
        free, own = self.chunks.lens_free, self.chunks.own
        for part, products in zip(self.parts, self.photos, strict=True):
            for (photo, start, _), product in zip(part.chunk.parts, products, strict=True):
                value = of_photo(product)
                number = calibration[part.chunk.rows.start + start]
                self._add_own(sums, photo, part.chunk.rows.start + start, value[:own, None])
                sums["calibration"][number, free, 0] += value[own:]
        sums["point"] = of_points.T[:, :, None]
        self._add(out[:, None], sums)

    # -- products ---------------------------------------------------------------------------------

    def times(self, g: Array) -> Array:
        """Return A G (n, 2, k) for G (n_columns, k)."""
        k = g.shape[1]
        out = np.empty((self.block.n, 2, k))
        poses, lenses, points, *moving = (self._values(kind, g) for kind, _ in self.block.variables)
        _, (_, calibration), (_, point), *motions = self.block.variables
        free = self.chunks.lens_free
        lenses = lenses[:, free]
        moving = [of[:, : self.chunks.own - POSE] for of in moving]  # as far as these photos have
        columns = np.ascontiguousarray(points.transpose(2, 1, 0))  # (k, 3, points)
        for part in self.parts:
            rows = part.chunk.rows
            product = np.empty((2, rows.stop - rows.start, k))
            for photo, start, stop in part.chunk.parts:
                first = rows.start + start
                own = [of[index[first]] for of, (_, index) in zip(moving, motions, strict=True)]
                x = np.concatenate([poses[photo], *own, lenses[calibration[first]]])
                for row in range(2):
                    np.matmul(part.a[:, row, start:stop].T, x, out=product[row, start:stop])
            for column in range(k):
                moved = np.take(columns[column], point[rows], axis=1)
                by_point = part.a[POINT_PARTIALS]
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
        free, own = self.chunks.lens_free, self.chunks.own
        for part, of_points in zip(self.parts, self.chunks.sums, strict=True):
            rows = part.chunk.rows
            w = np.ascontiguousarray(z[rows].transpose(1, 0, 2))
            for photo, start, stop in part.chunk.parts:
                a = part.a[:, :, start:stop]
                value = a[:, 0] @ w[0, start:stop] + a[:, 1] @ w[1, start:stop]
                self._add_own(sums, photo, rows.start + start, value[:own])
                sums["calibration"][calibration[rows.start + start], free] += value[own:]
            products = np.empty((rows.stop - rows.start, 3, k))
            for i, a in enumerate(part.a[POINT_PARTIALS]):
                products[:, i] = -(a[0, :, None] * w[0] + a[1, :, None] * w[1])
            flat = sums["point"].reshape(-1, 3 * k)
            of_points.add(flat, products.reshape(len(products), -1))
        self._add(out, sums)

    def _add_own(self, sums: dict[VariableKind, Array], photo: int, ray: int, value: Array) -> None:
        """Add values (own, k) of a photo to the sums of its pose and, if it has one, its motion.

        Args:
            sums: sums of each kind, changed in place.
            photo: number of the photo.
            ray: number of one of its rays.
            value: the values.
        """
        sums["pose"][photo] += value[:POSE]
        for kind, motion in self.block.variables[3:]:
            sums[kind][motion[ray], : len(value) - POSE] += value[POSE:]

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
        for kind in self.kinds.intersection(sums):
            columns = self.chunks.unknowns[kind].columns
            free = self.chunks.unknowns.free[columns, None]
            out[columns] += self.chunks.unknowns[kind].in_columns(sums[kind]) * free


def photo_products(rows: Array, runs: Iterable[tuple[int, int]]) -> list[Array]:
    """Return [A v]ᵀ[A v] of runs of rays, (own + k + 1, …) square, given as [A v] (…, 2, m)."""
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
