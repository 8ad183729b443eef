"""Sums of products of the partials of rays, which belong to a linearisation."""

from __future__ import annotations

import numpy as np

from ..types import Array, Index
from .linear import LinearSystem
from .linear_rays import OF_POINT
from .point_cholesky import ELEMENTS
from .rays import Rays
from .spokes import add_to_points


class RaySums:
    """Products of partials, summed over the rays of each node and of each point."""

    def __init__(self, rays: Rays, system: LinearSystem) -> None:
        """Sum the products of one linearisation."""
        self.rays, self.system = rays, system
        n, p = rays.places.n, rays.n_points
        largest = max(
            (6 + len(system.equations.rays[x.place].lens_free) for x in rays.photo_parts), default=0
        )
        self.nodes = np.zeros((n, largest, largest))
        """AᵀA of each node with pose and parameters of the lens, (n, 6 + k, 6 + k); empty without
        photos."""
        normal = np.zeros((p, 6))
        self.cross = np.zeros((p, 3, rays.side))
        """JᵀA of each point with the shared calibrations, (p, 3, border)."""
        flat = self.cross.reshape(p, -1)
        for part in rays.photo_parts:
            a = part.partials(system)
            width = len(a)
            for node, start, stop in part.runs:
                x, y = a[:, 0, start:stop], a[:, 1, start:stop]
                own = self.nodes[node, :width, :width]
                own += x @ x.T
                own += y @ y.T
            m = a.shape[2]
            k = width - 6 if part.camera >= 0 else 0
            products = np.empty((6 + 3 * k, m))
            j = a[OF_POINT]
            for place, (r, c) in enumerate(ELEMENTS):
                _product(j[r], j[c], products[place])
            for r in range(3):
                for c in range(k):
                    _product(j[r], a[6 + c], products[6 + r * k + c])
            if k:  # partials by the point have the opposite sign
                np.negative(products[6:], out=products[6:])
            found = part.sums.incidence @ np.ascontiguousarray(products.T)
            normal[part.sums.points] += found[:, :6]
            if k:
                side = rays.cameras[part.camera].side
                columns = (
                    np.arange(3)[:, None] * rays.side + np.arange(side.start, side.stop)
                ).ravel()
                flat[part.sums.points[:, None], columns] += found[:, 6:]
        self.points = np.ascontiguousarray(normal.T)
        """JᵀJ of each point, (6, p)."""
        for rows in rays.spoke_rows:
            add_to_points(rows, rows.arrays(system), self.points, self.cross)
        for _, number, _, j in self.coordinates():
            for place, (r, c) in enumerate(ELEMENTS):
                value = np.sum(j[:, :, r] * j[:, :, c], axis=1)
                self.points[place] += np.bincount(number, weights=value, minlength=p)

    def coordinates(self) -> list[tuple[int, Index, Index, Array]]:
        """Return the observed coordinates of points of the first layer.

        Returns:
            For each block: its place, the points of the first layer (n,), the observations in the
            block (n,), and their partials (n, d, 3).
        """
        out = []
        reduced = self.rays.layers.reduced
        local = np.cumsum(reduced) - 1
        for place in self.rays.coordinate_places:
            lb = self.system.blocks[place]
            number = lb.block.variables[0][1]
            on = np.flatnonzero(reduced[number])
            if len(lb.a[0]) and len(on):
                out.append((place, local[number[on]], on, lb.a[0][on]))
        return out


def _product(a: Array, b: Array, out: Array) -> None:
    """Write the sum over both components of a and b (2, m) to out (m,)."""
    np.multiply(a[0], b[0], out=out)
    out += a[1] * b[1]
