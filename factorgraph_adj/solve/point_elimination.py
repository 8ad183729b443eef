"""Elimination of the points of the first layer, their solution and their covariances.

With H = Σ JₚᵀJₚ of a point, H = L Lᵀ, and W = L⁻¹ JₚᵀJ_c of each of its rays, the reduced
normal matrix of the cameras is S = Σ J_cᵀJ_c − Σ WᵀW, the second sum over pairs of photos
that share points. The index lists of the rays are the same in all iterations. Spokes to the frames
of instruments (`factorgraph_adj.solve.node_rows`) have W as rays have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Array, Index
from .block_matrix import BlockMatrix
from .linearised_rays import (
    DIAGONAL_ELEMENTS,
    POINT_PARTIALS,
    SYMMETRIC_ELEMENTS,
    PointCholesky,
    symmetric_matrices,
)
from .nested_dissection import BlockPattern
from .node_rows import Spokes, add_to_spokes
from .point_rays import RaySums

POOR_POINT_PIVOT = 1e-6
"""Relative pivot below which a point is factorised twice; a point at a distance of 1000 bases has
this pivot."""


class ReducedPoints:
    """The first layer eliminated: factors of the points, and W of every ray."""

    def __init__(self, sums: RaySums, extra: Array) -> None:
        """Eliminate the points.

        Args:
            sums: the products of one linearisation.
            extra: added to the diagonal of the normal matrix, (n_columns,).
        """
        self.sums, self.rays, self.system = sums, sums.rays, sums.system
        rays = self.rays
        self.cholesky, self.shared = factorise_points(sums, extra)
        """``shared``: W of every point with the shared calibrations, (p, 3, border)."""
        self.w = np.empty((rays.n_rays, 3, rays.width))
        """W of every ray, (n_rays, 3, width)."""
        self._own = np.zeros((rays.places.n, rays.width, rays.width + rays.side))
        for photos in rays.photo_parts:
            a = photos.partials(self.system)
            half = self.cholesky.lower(a[POINT_PARTIALS], photos.points)
            width = photos.own(self.system) if photos.camera >= 0 else len(a)
            w = np.zeros((3, rays.width, a.shape[2]))
            product = np.empty((width, 2, a.shape[2]))
            for axis in range(3):
                np.multiply(half[axis], a[:width], out=product)
                np.add(product[:, 0], product[:, 1], out=w[axis, :width])
            np.negative(w.transpose(2, 0, 1), out=self.w[photos.rows])
            self._add_own(photos)
        if rays.spokes is not None:
            of_spokes = self.w[rays.spokes.rows]
            of_spokes[:] = 0.0
            for sights in rays.spoke_rows:
                if sights.slots:
                    arrays = sights.arrays(self.system)
                    u = self.cholesky.lower(arrays[sights.target].transpose(2, 1, 0), sights.points)
                    add_to_spokes(sights, arrays, u, of_spokes)
            self._add_own(rays.spokes)

    def _add_own(self, part: Spokes) -> None:
        """Add WᵀW and WᵀE of each node, E that of the shared calibrations, to those of its rays."""
        rays = self.rays
        w = self.w[part.rows]
        shared = np.take(self.shared, part.points, axis=0)
        for node, start, stop in part.runs:
            one, own = w[start:stop].reshape(-1, rays.width), self._own[node]
            own[:, : rays.width] += one.T @ one
            if rays.side:
                own[:, rays.width :] += one.T @ shared[start:stop].reshape(-1, rays.side)

    def matrix(self, pattern: BlockPattern) -> BlockMatrix:
        """Return S in the blocks of a pattern, without regard to held places."""
        rays, w = self.rays, self.rays.width
        nodes = self.sums.nodes
        out = BlockMatrix.zeros(pattern)
        np.negative(self._own[:, :, :w], out=out.diagonal)
        np.negative(self._own[:, :, w:], out=out.side[:, :, : rays.side])
        if rays.photo_parts:
            self._add_photos(out, nodes)
        if rays.side:
            flat = self.shared.reshape(-1, rays.side)
            out.corner[: rays.side, : rays.side] -= flat.T @ flat
        self._subtract_pairs(out)
        return out

    def _add_photos(self, out: BlockMatrix, nodes: Array) -> None:
        """Add AᵀA of the photos (n, own + k, own + k) to their blocks."""
        rays = self.rays
        shared = np.zeros(rays.places.n, dtype=bool)
        for part in rays.photo_parts:
            if part.camera < 0:
                continue
            side = rays.cameras[part.camera].side
            own, size = part.own(self.system), side.stop - side.start
            lens = slice(own, own + size)
            for node in sorted({run[0] for run in part.runs}):
                if not shared[node]:
                    shared[node] = True
                    out.diagonal[node, :own, :own] += nodes[node, :own, :own]
                    out.side[node, :own, side] += nodes[node, :own, lens]
                    out.corner[side, side] += nodes[node, lens, lens]
        alone = ~shared
        if alone.any():
            size = min(rays.width, nodes.shape[1])
            out.diagonal[alone, :size, :size] += nodes[alone, :size, :size]

    def _subtract_pairs(self, out: BlockMatrix) -> None:
        """Subtract WᵀW of all pairs of nodes with common points."""
        rays, w = self.rays, self.rays.width
        found = np.empty((len(rays.pair_first), w, w))
        flat = self.w.reshape(-1, 3 * w)
        for pairs, both in rays.by_first():
            left = np.take(flat, rays.left[both], axis=0).reshape(-1, w).T
            right = np.take(flat, rays.right[both], axis=0).reshape(-1, w)
            for i, s, t in pairs:
                np.dot(left[:, 3 * s : 3 * t], right[3 * s : 3 * t], out=found[i])
        out.pairs[out.find(rays.pair_first, rays.pair_second)] = -found

    # -- use ----------------------------------------------------------------------------------

    def forward(self, y: Array, reduced: Array) -> Array:
        """Return L⁻¹ y_p (3, k, p), and subtract its part from the right sides of the nodes.

        Args:
            y: right sides, (n_columns, k).
            reduced: right sides of the reduced system (places, k), changed in place.
        """
        rays = self.rays
        n, w, k = rays.places.n, rays.width, y.shape[1]
        z = self.cholesky.lower(y[rays.layers.point_columns].transpose(1, 2, 0))
        of_points = np.ascontiguousarray(z.transpose(2, 0, 1)).reshape(rays.n_points, 3 * k)
        self._subtract_spread(of_points, reduced[: n * w].reshape(n, w, k))
        if rays.side:
            border = reduced[n * w : n * w + rays.side]
            border -= self.shared.reshape(-1, rays.side).T @ of_points.reshape(-1, k)
        return z

    def backward(self, z: Array, x: Array) -> Array:
        """Return the points' solution (p, 3, k) from that of the reduced system (places, k)."""
        rays = self.rays
        n, w, k = rays.places.n, rays.width, z.shape[1]
        nodes = x[: n * w].reshape(n, w, k)
        moved = np.zeros((rays.n_points, 3 * k))
        if rays.side:
            border = x[n * w : n * w + rays.side]
            moved[:] = (self.shared.reshape(-1, rays.side) @ border).reshape(-1, 3 * k)
        self._add_sums(nodes, moved)
        t = z - moved.reshape(-1, 3, k).transpose(1, 2, 0)
        return self.cholesky.upper(t).transpose(2, 0, 1)

    def followed(self, x: Array) -> Array:
        """Return how points follow a movement x (n_columns, k) of the rest: −L⁻ᵀ W x, (p, 3, k).

        Of movements with the covariance Q, Q_pp is the covariance of it and L⁻ᵀL⁻¹.
        """
        columns = self.rays.places.columns
        reduced = np.where(columns[:, None] >= 0, x[np.maximum(columns, 0)], 0.0)
        z = np.zeros((3, x.shape[1], self.rays.n_points))
        return self.backward(z, reduced)

    def own_variances(self) -> Array:
        """Return the variances of the points where everything else is held, (p, 3)."""
        identity = np.zeros((6, self.rays.n_points))
        identity[list(DIAGONAL_ELEMENTS)] = 1.0
        return np.diagonal(self.covariances(identity), axis1=1, axis2=2)

    def _subtract_spread(self, of_points: Array, nodes: Array) -> None:
        """Subtract Wᵀ z, z (p, 3 k) at the points, from the nodes (n, w, k), in place."""
        w, k = nodes.shape[1:]
        for part in self.rays.parts:
            rows = self.w[part.rows]
            along = np.take(of_points, part.points, axis=0)
            for node, start, stop in part.runs:
                one = rows[start:stop].reshape(-1, w)
                nodes[node] -= one.T @ along[start:stop].reshape(-1, k)

    def _add_sums(self, nodes: Array, moved: Array) -> None:
        """Add W x of the nodes (n, w, k) to the points (p, 3 k), in place."""
        w, k = nodes.shape[1:]
        for part in self.rays.parts:
            rows = self.w[part.rows]
            along = np.empty((len(rows), 3 * k))
            for node, start, stop in part.runs:
                one = rows[start:stop].reshape(-1, w)
                along[start:stop] = (one @ nodes[node]).reshape(-1, 3 * k)
            part.sums.add(moved, along)

    def between_nodes(self, nodes: Array) -> Array:
        """Return Σ w_iᵀ w_j x_j over all pairs of different nodes, for x (n, w, k)."""
        moved = np.zeros((self.rays.n_points, 3 * nodes.shape[2]))
        self._add_sums(nodes, moved)
        out = self._own[:, :, : self.rays.width] @ nodes
        self._subtract_spread(moved, out)
        return np.asarray(-out)

    def partials_of(self, nodes: Index) -> Array:
        """Return W (3 q, m w) of the q points that some nodes (m,) see."""
        rays, w = self.rays, self.rays.width
        own = [rays.of_node(node) for node in nodes.tolist()]
        seen, row = np.unique(rays.point_of_ray[np.concatenate(own)], return_inverse=True)
        out = np.zeros((len(seen), 3, len(nodes), w))
        at = 0
        for place, mine in enumerate(own):
            out[row[at : at + len(mine)], :, place] = self.w[mine]
            at += len(mine)
        return out.reshape(3 * len(seen), -1)

    def carried(self, point: int) -> tuple[Index, Array, Array]:
        """Return how a point follows the other unknowns: x_p = C x + L⁻ᵀ e, e with covariance I.

        Args:
            point: number of the point in the first layer.

        Returns:
            Columns of the other unknowns (m,), C = −L⁻ᵀ W (3, m), and L⁻ᵀ (3, 3).
        """
        rays = self.rays
        places: list[Index] = [np.zeros(0, dtype=np.intp)]
        w: list[Array] = [np.zeros((3, 0))]
        for ray in rays.of_point(point).tolist():
            node = rays.node_of_ray[ray]
            places.append(rays.width * node + np.arange(rays.width))
            w.append(self.w[ray])
        if rays.side:
            places.append(rays.places.n * rays.width + np.arange(rays.side))
            w.append(self.shared[point])
        columns = rays.places.columns[np.concatenate(places)]
        on = columns >= 0
        half = self.cholesky.upper(np.eye(3)[:, :, None], np.array([point]))[:, :, 0]
        return columns[on], -half @ np.concatenate(w, axis=1)[:, on], half

    def joint(self, inverse: BlockMatrix) -> RayCovariances:
        """Return the joint covariances of points and nodes from those of the nodes.

        With W over all rays of a point and its shared calibrations, and L of the point's block:
        Q_pp = L⁻ᵀ (I + W Σ Wᵀ) L⁻¹ and Q_pc = −L⁻ᵀ W Σ.

        Args:
            inverse: Σ at the blocks of the reduced system; zero at held places.
        """
        rays, w = self.rays, self.rays.width
        m = np.empty_like(self.w)
        shared = np.zeros((rays.n_points, 3 * rays.side))
        flat = self.shared.reshape(rays.n_points, -1)
        if rays.side:
            corner = inverse.corner[: rays.side, : rays.side]
            shared[:] = (self.shared.reshape(-1, rays.side) @ corner).reshape(rays.n_points, -1)
        side = inverse.side[:, :, : rays.side]
        for part in rays.parts:
            rows, out = self.w[part.rows], m[part.rows]
            of_points = np.take(flat, part.points, axis=0)
            along = np.empty((len(rows), 3 * rays.side))
            for node, start, stop in part.runs:
                one = rows[start:stop].reshape(-1, w)
                value = one @ inverse.diagonal[node]
                if rays.side:
                    e = of_points[start:stop].reshape(-1, rays.side)
                    value += e @ side[node].T
                    along[start:stop] = (one @ side[node]).reshape(stop - start, -1)
                out[start:stop] = value.reshape(-1, 3, w)
            if rays.side:
                part.sums.add(shared, along)
        self._add_pairs(m, inverse)
        inner = np.zeros((rays.n_points, 6))
        for part in rays.parts:
            mine = np.ascontiguousarray(m[part.rows].transpose(1, 2, 0))
            rows = np.ascontiguousarray(self.w[part.rows].transpose(1, 2, 0))
            products = np.stack(
                [np.einsum("km,km->m", mine[i], rows[j]) for i, j in SYMMETRIC_ELEMENTS], 1
            )
            part.sums.add(inner, products)
        inner = np.ascontiguousarray(inner.T)
        if rays.side:
            of_border = shared.reshape(rays.n_points, 3, rays.side)
            for place, (i, j) in enumerate(SYMMETRIC_ELEMENTS):
                inner[place] += np.einsum("pk,pk->p", of_border[:, i], self.shared[:, j])
        inner[list(DIAGONAL_ELEMENTS)] += 1.0
        return RayCovariances(m, shared.reshape(rays.n_points, 3, rays.side), inner)

    def covariances(self, inner: Array) -> Array:
        """Return the covariance L⁻ᵀ K L⁻¹ (p, 3, 3) of every point from K = I + W Σ Wᵀ (6, p)."""
        return symmetric_matrices(self.cholesky.covariances(inner))

    def _add_pairs(self, m: Array, inverse: BlockMatrix) -> None:
        """Add W of each ray times Σ of its node with the node of every other ray of the point."""
        rays, w = self.rays, self.rays.width
        place = inverse.find(rays.pair_first, rays.pair_second)
        rows, out = self.w.reshape(-1, 3 * w), m.reshape(-1, 3 * w)
        for pairs, both in rays.by_first():
            left, right = rays.left[both], rays.right[both]
            of_left, of_right = np.take(rows, left, axis=0), np.take(rows, right, axis=0)
            to_right = np.empty_like(of_right)
            for i, s, t in pairs:
                block = inverse.pairs[place[i]]
                to_right[s:t] = (of_left[s:t].reshape(-1, w) @ block).reshape(-1, 3 * w)
                # A point is once in a photo: no ray comes twice in a pair.
                out[left[s:t]] += (of_right[s:t].reshape(-1, w) @ block.T).reshape(-1, 3 * w)
            out[right] += to_right  # every ray to a point of the first photo comes once


@dataclass(frozen=True)
class RayCovariances:
    """Products W Σ of points with the reduced system, see `ReducedPoints.joint`."""

    rays: Array
    """Columns of W Σ of the node of each ray, (n_rays, 3, width)."""
    shared: Array
    """Columns of W Σ of the shared calibrations, (p, 3, border)."""
    inner: Array
    """I + W Σ Wᵀ, (6, p), see `linearised_rays`."""


def factorise_points(sums: RaySums, extra: Array) -> tuple[PointCholesky, Array]:
    """Factorise the normal matrices of the points; return L, and L⁻¹ of their cross products.

    H has the square of the condition of A: a point at a distance of 10⁵ bases keeps 6 digits.
    Where pivots are poor the rows are factorised again, in the axes of the first factor
    (Cholesky-QR, Yamamoto et al. 2015): A L⁻ᵀ is nearly orthogonal,
    AᵀA = L (L⁻¹AᵀA L⁻ᵀ) Lᵀ = L L' (L L')ᵀ.

    Args:
        sums: the products of one linearisation.
        extra: added to the diagonal of the normal matrix, (n_columns,).
    """
    columns = sums.rays.layers.point_columns
    added = extra[columns].T
    free = sums.rays.layers.unknowns.free[columns].T.astype(float)
    h = sums.points.copy()
    h[list(DIAGONAL_ELEMENTS)] += added
    cholesky = PointCholesky(h, free)
    cross = cholesky.lower(np.ascontiguousarray(sums.cross.transpose(1, 2, 0))).transpose(2, 0, 1)
    poor = np.flatnonzero(cholesky.pivots.min(axis=0, initial=1.0) < POOR_POINT_PIVOT)
    if len(poor):
        again, products = _in_axes(sums, cholesky, poor, added[:, poor])
        second = PointCholesky(again, free[:, poor])
        cholesky.refine(second, poor)
        cross[poor] = second.lower(products.transpose(1, 2, 0)).transpose(2, 0, 1)
    return cholesky, np.ascontiguousarray(cross)


def _in_axes(
    sums: RaySums, axes: PointCholesky, points: Index, added: Array
) -> tuple[Array, Array]:
    """Return L⁻¹ H L⁻ᵀ (6, q) and L⁻¹ JᵀA (q, 3, border) of some points, from the rows A L⁻ᵀ.

    Args:
        sums: the products of one linearisation.
        axes: factors L of all points.
        points: the points, (q,).
        added: terms on the diagonal of H, (3, q).
    """
    rays, system = sums.rays, sums.system
    local = np.full(rays.n_points, -1, dtype=np.intp)
    local[points] = np.arange(len(points))
    h = np.zeros((6, len(points)))
    cross = np.zeros((len(points), 3, rays.side))

    def add(rows: Array, at: Index) -> Array:
        """Add the products of rows (3, d, m) to points; return them in the axes of the points."""
        u = axes.lower(rows, at)
        for place, (i, j) in enumerate(SYMMETRIC_ELEMENTS):
            h[place] += np.bincount(
                local[at], weights=np.sum(u[i] * u[j], axis=0), minlength=len(points)
            )
        return u

    for part in rays.photo_parts:
        on = np.flatnonzero(local[part.points] >= 0)
        if not len(on):
            continue
        a = part.partials(system)[:, :, on]
        at = part.points[on]
        u = add(-a[POINT_PARTIALS], at)
        if part.camera >= 0:
            side, own = rays.cameras[part.camera].side, part.own(system)
            for c in range(side.stop - side.start):
                value = np.sum(u * a[own + c], axis=1)
                for axis in range(3):
                    cross[:, axis, side.start + c] += np.bincount(
                        local[at], weights=value[axis], minlength=len(points)
                    )
    for sights in rays.spoke_rows:
        on = np.flatnonzero(local[sights.points] >= 0)
        if not len(on):
            continue
        arrays, at = sights.arrays(system), sights.points[on]
        u = add(arrays[sights.target][on].transpose(2, 1, 0), at)
        for column, a in sights.border_columns(arrays):
            value, places = np.einsum("adm,md->ma", u, a[on]), column[on]
            has = np.flatnonzero(places >= 0)
            for axis in range(3):
                np.add.at(cross[:, axis], (local[at[has]], places[has]), value[has, axis])
    root = np.sqrt(added)
    for c in range(3):
        rows = np.zeros((3, 1, len(points)))
        rows[c, 0] = root[c]
        add(rows, points)
    return h, cross
