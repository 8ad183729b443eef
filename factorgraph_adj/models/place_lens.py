"""Lens models of places: parallel projection, in which the distance from the camera counts.

A central projection has rays from one centre, so that the length of p = Rᵀ (X − X₀) does not
matter. The models of this module are functions of the place p itself, metres in the axes of the
camera (x right, y down, z ahead), and a measured point has a line on which its place lies.

Parallel projection, of scanning electron microscopes and telecentric lenses:

    t = (p_x, −p_y),    v = c t − corrected(x − x0, y − y0)        (FRAMES F19.4)

c is the scale, image units per metre. The image does not depend on p_z: no image point determines
X₀ along the viewing axis, and a network holds that coordinate of X₀ which is nearest to the axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ..frames import Frame
from ..types import Array
from .lens import BrownLens, Lens, Ray, Seen

AHEAD = 100.0
"""Distance between the start of a line of parallel projection and the plane p_z = 0, in units of
the largest distance from the axis: all of an object lies ahead of the start."""


@dataclass(frozen=True)
class PlaceLens(Lens):
    """Base of the lens models that take places."""

    takes: ClassVar[Literal["tangents", "rays", "places"]] = "places"

    def places(self, xy: Array, calibration: Array) -> Array:
        """Return a place of each measured point, (n, 3) metres, arguments as `lines`."""
        raise NotImplementedError

    def lines(self, xy: Array, calibration: Array) -> tuple[Array, Array]:
        """Return the lines on which the places of measured coordinates lie.

        Args:
            xy: measured coordinates, (n, 2), image units.
            calibration: parameters, (n, k) or (1, k).

        Returns:
            A place of each line, behind all objects as the camera sees them, metres, and the unit
            vector from there to the objects, (n, 3) each, axes of the camera.
        """
        raise NotImplementedError

    def stated_pose(self, frame: Frame) -> tuple[Array, Array] | None:
        """Return X₀ and R that every photo has, as the model states places itself; None: none."""
        return None


@dataclass(frozen=True)
class ParallelLens(PlaceLens, BrownLens):
    """Parallel projection with Brown's terms, measured → ideal: w = c (p_x, −p_y) − corrected.

    For scanning electron microscopes and telecentric lenses.

    The parameters are those of `BrownLens` in image units; c is the scale, image units per metre
    of the object, and b1 the relative difference of the scales along x and y.
    """

    kind: ClassVar[str] = "parallel"

    def seen(self, p: Ray, x: Array, y: Array, k: Array, *, jacobians: bool = True) -> Seen:
        """Return v and its partials by the places and the calibration, see `Lens.seen`."""
        px, py, _ = p
        v, by_t, by_k = self.partials(px, -py, x, y, k, jacobians=jacobians)
        if not jacobians:
            return Seen(v, (), ())
        zero = np.zeros_like(px)
        (xx, yx), (xy, yy) = ((zero + a, zero + b) for a, b in by_t)
        return Seen(v, ((xx, yx), (-xy, -yy), (zero, zero)), by_k)

    def places(self, xy: Array, calibration: Array) -> Array:
        """Return the places with p_z = 0, see `PlaceLens.places`."""
        still = np.zeros(len(xy))
        ideal = self.in_ideal_coordinates
        v, _, _ = ideal.residual(still, still, xy, calibration, jacobians=False)
        t = -v / calibration[:, :1]
        return np.stack([t[:, 0], -t[:, 1], still], axis=1)

    def lines(self, xy: Array, calibration: Array) -> tuple[Array, Array]:
        """Return lines parallel to the axis, see `PlaceLens.lines`."""
        at = self.places(xy, calibration)
        axis = np.array([0.0, 0.0, 1.0])
        away = AHEAD * float(np.abs(at).max(initial=0.0)) or 1.0
        return at - away * axis, np.broadcast_to(axis, at.shape)
