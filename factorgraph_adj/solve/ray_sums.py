"""Sums of products of the partials of rays, which belong to a linearisation."""

from __future__ import annotations

import numpy as np

from ..types import Array, Index
from .linear import LinearisedEquations
from .linear_rays import LinearRays
from .point_cholesky import ELEMENTS
from .rays import Rays
from .spokes import add_to_points


class RaySums:
    """Products of partials, summed over the rays of each node and of each point."""

    def __init__(self, rays: Rays, system: LinearisedEquations) -> None:
        """Sum the products of one linearisation."""
        self.rays, self.system = rays, system
        n, p = rays.places.n, rays.n_points
        largest = max(
            (6 + len(system.equations.rays[x.place].lens_free) for x in rays.photo_parts), default=0
        )
        self.nodes = np.zeros((n, largest, largest))
        """AᵀA of each node with pose and parameters of the lens, (n, 6 + k, 6 + k); empty without
        photos."""
        self.points = np.zeros((6, p))
        """JᵀJ of each point, (6, p)."""
        self.cross = np.zeros((p, 3, rays.side))
        """JᵀA of each point with the shared calibrations, (p, 3, border)."""
        for block in system.blocks:
            if isinstance(block, LinearRays):
                self.points += block.points[:6, rays.layers.reduced]
        for part in rays.photo_parts:
            for (node, _, _), product in zip(part.runs, part.products(system), strict=True):
                width = len(product) - 1
                self.nodes[node, :width, :width] += product[:width, :width]
            if part.camera >= 0:
                side = rays.cameras[part.camera].side
                self.cross[part.sums.points, :, side] += part.cross(system)
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
