"""Elimination of object points that only cameras see, vectorised over all of them.

With H = Σ JₚᵀJₚ of a point, H = L Lᵀ, and W = L⁻¹ JₚᵀJ_c of each of its rays, the reduced
normal matrix of the cameras is S = Σ J_cᵀJ_c − Σ WᵀW, the second sum over pairs of photos
that share points. The index lists (`Rays`) are the same in all iterations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Array, Index
from .linear import LinearSystem
from .point_blocks import factorise_points
from .rays import Rays, joined


class ReducedPoints:
    """The first layer eliminated: factors of the points and the reduced normal matrix."""

    def __init__(self, rays: Rays, system: LinearSystem, extra: Array) -> None:
        """Eliminate the points.

        Args:
            rays: the index lists.
            system: the linearised network.
            extra: added to the diagonal of the normal matrix, (n_columns,).
        """
        self.rays = rays
        j_pose, j_lens, j_point = (
            joined([system.blocks[i].a[slot] for i in rays.places], rays) for slot in range(3)
        )
        self.cholesky = factorise_points(rays, system, j_point, extra)
        self._rays(j_pose, j_lens, j_point)
        self.normal = self._normal(j_pose, j_lens, extra)

    def _rays(self, j_pose: Array, j_lens: Array, j_point: Array) -> None:
        """Compute W of every ray (m, 3, width), and of every point and shared calibration."""
        rays = self.rays
        # L⁻¹Jₚᵀ is small; W is its product with the partials by poses and calibrations.
        half = self.cholesky.lower(j_point.transpose(0, 2, 1), rays.point)
        if rays.width == 6:
            self.w = half @ j_pose
        else:
            self.w = np.zeros((len(half), 3, rays.width))
            self.w[:, :, :6] = half @ j_pose
            on = rays.own_rays
            self.w[on, :, 6 : 6 + j_lens.shape[2]] = half[on] @ j_lens[on]
        self.shared: list[Array] = []
        for r, points, place, columns in zip(
            rays.shared_rays,
            rays.shared_points,
            rays.shared_place,
            rays.shared_columns,
            strict=True,
        ):
            e = np.zeros((len(points), 3, len(columns)))
            for axis in range(3):
                for c in np.flatnonzero(rays.layers.unknowns.free[rays.layers.border[columns]]):
                    product = (
                        half[r, axis, 0] * j_lens[r, 0, c] + half[r, axis, 1] * j_lens[r, 1, c]
                    )
                    e[:, axis, c] = np.bincount(place, weights=product, minlength=len(points))
            self.shared.append(e)

    def _normal(self, j_pose: Array, j_lens: Array, extra: Array) -> Array:
        """Return S (border, border)."""
        rays, w = self.rays, self.w
        n = len(rays.layers.border)
        s = np.zeros((n, n))
        k = j_lens.shape[2]
        shared_at = []
        for points in rays.shared_points:
            at = np.full(rays.n_points, -1, dtype=np.intp)
            at[points] = np.arange(len(points))
            shared_at.append(at)
        for number, photo in enumerate(rays.photos):
            r = photo.rows
            a = j_pose[r].reshape(-1, 6)
            b = j_lens[r].reshape(-1, k)
            if rays.width > 6:
                a = np.concatenate([a, np.zeros((len(a), rays.width - 6))], axis=1)
                if rays.has_own[number]:
                    a[:, 6 : 6 + k] = b
            wa = w[r].reshape(-1, rays.width)
            _scatter(s, photo.columns, photo.columns, a.T @ a - wa.T @ wa)
            for which, at, ws, columns in zip(
                rays.shared, shared_at, self.shared, rays.shared_columns, strict=True
            ):
                block = -self._across(r, at, ws)
                if rays.calibration[r.start] == which:
                    block += a.T @ b[:, : len(columns)]
                _scatter(s, photo.columns, columns, block)
                _scatter(s, columns, photo.columns, block.T)
        self._pairs(s)
        for i, (ws, points, columns) in enumerate(
            zip(self.shared, rays.shared_points, rays.shared_columns, strict=True)
        ):
            flat = ws.reshape(-1, ws.shape[2])
            own = j_lens[rays.shared_rays[i], :, : len(columns)].reshape(-1, len(columns))
            _scatter(s, columns, columns, own.T @ own - flat.T @ flat)
            for j in range(i):
                at = shared_at[j][points]
                on = at >= 0
                block = -(
                    ws[on].reshape(-1, ws.shape[2]).T
                    @ self.shared[j][at[on]].reshape(-1, self.shared[j].shape[2])
                )
                _scatter(s, columns, rays.shared_columns[j], block)
                _scatter(s, rays.shared_columns[j], columns, block.T)
        s[np.diag_indices(n)] += extra[rays.layers.border]
        return s

    def _across(self, rows: slice, at: Index, shared: Array) -> Array:
        """Return Σ WᵀW_s of one photo with a shared calibration."""
        place = at[self.rays.point[rows]]
        wa = self.w[rows]
        if (place < 0).any():
            on = place >= 0
            wa, place = wa[on], place[on]
        return np.asarray(
            wa.reshape(-1, wa.shape[2]).T @ shared[place].reshape(-1, shared.shape[2])
        )

    def _pairs(self, s: Array) -> None:
        """Subtract WᵀW of all pairs of photos with common points."""
        rays, w, d = self.rays, self.w, self.rays.width
        for a, b, start, stop in rays.pairs:
            left = w[rays.left[start:stop]].reshape(-1, d)
            right = w[rays.right[start:stop]].reshape(-1, d)
            block = left.T @ right
            ra, rb = rays.runs[a], rays.runs[b]
            if ra is not None and rb is not None:
                block = block[: ra.stop - ra.start, : rb.stop - rb.start]
                s[ra, rb] -= block
                s[rb, ra] -= block.T
            else:
                ca, cb = rays.photos[a].columns, rays.photos[b].columns
                _scatter(s, ca, cb, -block)
                _scatter(s, cb, ca, -block.T)

    # -- use ----------------------------------------------------------------------------------

    def forward(self, y: Array, border: Array) -> Array:
        """Return L⁻¹ y_p (p, 3, k), and subtract its part from the right sides of the border.

        Args:
            y: right sides, (n_columns, k).
            border: right sides of the border (b, k), changed in place.
        """
        rays = self.rays
        z = self.cholesky.lower(y[rays.layers.point_columns])
        of_rays = z[rays.point]
        for photo in rays.photos:
            r, on = photo.rows, photo.columns >= 0
            part = self.w[r].reshape(-1, rays.width).T @ of_rays[r].reshape(-1, z.shape[2])
            border[photo.columns[on]] -= part[on]
        for ws, points, columns in zip(
            self.shared, rays.shared_points, rays.shared_columns, strict=True
        ):
            border[columns] -= np.einsum("pic,pik->ck", ws, z[points])
        return z

    def backward(self, z: Array, border: Array) -> Array:
        """Return the solution of the points (p, 3, k) from the solution of the border (b, k)."""
        rays = self.rays
        n, k = rays.n_points, z.shape[2]
        along = np.empty((len(rays.point), 3, k))
        for photo in rays.photos:
            r, on = photo.rows, photo.columns >= 0
            x = np.zeros((rays.width, k))
            x[on] = border[photo.columns[on]]
            along[r] = (self.w[r].reshape(-1, rays.width) @ x).reshape(-1, 3, k)
        t = z.copy()
        for axis in range(3):
            for column in range(k):
                t[:, axis, column] -= np.bincount(
                    rays.point, weights=along[:, axis, column], minlength=n
                )
        for ws, points, columns in zip(
            self.shared, rays.shared_points, rays.shared_columns, strict=True
        ):
            t[points] -= np.einsum("pic,ck->pik", ws, border[columns])
        return self.cholesky.upper(t)

    def joint(self, border: Array) -> RayCovariances:
        """Return the joint covariances of points and border from that of the border (b, b).

        With W over all rays of a point and its shared calibrations, and L of the point's block:
        Q_pp = L⁻ᵀ (I + W Σ_b Wᵀ) L⁻¹ and Q_pb = −L⁻ᵀ W Σ_b. The computation is vectorised over the
        points with the same number of rays.
        """
        rays, d = self.rays, self.rays.width
        n = rays.n_points
        order = np.argsort(rays.point, kind="stable")
        counts = np.bincount(rays.point, minlength=n)
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        padded = np.zeros((len(border) + 1, len(border) + 1))
        padded[:-1, :-1] = border  # the last row and column serve held components
        columns = np.array([p.columns for p in rays.photos])
        all_shared = np.concatenate([*rays.shared_columns, np.zeros(0, dtype=np.intp)])
        width = len(all_shared)
        blocks = padded[columns[:, None, :, None], columns[None, :, None, :]]
        photo_shared = padded[columns[:, :, None], all_shared]
        shared_photo = np.ascontiguousarray(photo_shared.transpose(0, 2, 1))
        shared_shared = border[np.ix_(all_shared, all_shared)]
        shared = np.zeros((n, 3, width))
        at = 0
        for ws, points, c in zip(self.shared, rays.shared_points, rays.shared_columns, strict=True):
            shared[points, :, at : at + len(c)] = ws
            at += len(c)
        out_shared = shared @ shared_shared
        of_rays = np.empty((len(rays.point), 3, d))
        inner = np.tile(np.eye(3), (n, 1, 1))
        for count in np.unique(counts[counts > 0]).tolist():
            at_once = max(1, 4_000_000 // (d * count * max(d, width)))
            every = np.flatnonzero(counts == count)
            for start in range(0, len(every), at_once):
                points = every[start : start + at_once]
                r = order[first[points][:, None] + np.arange(count)]
                photo = rays.ray_photo[r]
                w = self.w[r]
                flat = w.transpose(0, 2, 1, 3).reshape(len(points), 3, -1)
                if width:
                    between = photo_shared[photo].reshape(len(points), count * d, width)
                    out_shared[points] += flat @ between
                for i in range(count):
                    block = blocks[photo, photo[:, i, None]].reshape(len(points), count * d, d)
                    m = flat @ block
                    if width:
                        m += shared[points] @ shared_photo[photo[:, i]]
                    of_rays[r[:, i]] = m
                    inner[points] += m @ w[:, i].transpose(0, 2, 1)
        if width:
            inner += out_shared @ shared.transpose(0, 2, 1)
        return RayCovariances(of_rays, out_shared, inner)

    def covariances(self, inner: Array) -> Array:
        """Return the covariance L⁻ᵀ inner L⁻¹ (p, 3, 3) of every point."""
        half = self.cholesky.upper(inner)
        return self.cholesky.upper(np.ascontiguousarray(half.transpose(0, 2, 1)))


@dataclass(frozen=True)
class RayCovariances:
    """Products W Σ_b of points with the border, see `ReducedPoints.joint`."""

    rays: Array
    """Columns of W Σ_b of the photo of each ray, (m, 3, width)."""
    shared: Array
    """Columns of W Σ_b of the shared calibrations, one after the other, (p, 3, k)."""
    inner: Array
    """I + W Σ_b Wᵀ, (p, 3, 3)."""


def _scatter(s: Array, rows: Index, columns: Index, block: Array) -> None:
    """Add a block to S, without its rows and columns of held components."""
    r, c = rows >= 0, columns >= 0
    s[np.ix_(rows[r], columns[c])] += block[np.ix_(r, c)]
