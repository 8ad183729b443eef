"""Lens models of scanners: the line of a pushbroom scanner, the cylinder of a panoramic camera.

Their image points are seen from a camera that moves while it scans: the time of a point follows
from its measured coordinate along the readout (`rolling_shutter`), and its ray from these models.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .base import require, wrap
from .lens import Correction, Lens, LensPartials, Ray, Seen
from .ray_lens import OUTSIDE, RayLens


@dataclass(frozen=True)
class LineLens(Lens):
    """Line of a pushbroom scanner, measured → ideal: y of an image point is its time alone.

    The line of detectors lies along x in the focal plane, at the ideal coordinates

        x' = x̄ + k1 x̄³ + k2 x̄⁵,    y' = −y0 + t1 x̄ + t2 x̄²,    x̄ = x − x0

    with the principal point (x0, y0) relative to the line: lines that look forward or backward
    have y0 = ∓c tan of the angle. The residual in y is the distance of the point from the line of
    detectors in the focal plane, at the time of the measured y: a motion that scans one pixel in
    the time of one line makes it that of y. The readout has to proceed down or up.
    Units: k1 1/unit², k2 1/unit⁴, t2 1/unit.
    """

    kind: ClassVar[str] = "line"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "t1", "t2")

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`; y is not used."""
        return super().partials(tx, ty, x, np.zeros_like(y), k, jacobians=jacobians)

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        k1, k2, t1, t2 = (k[:, j] for j in range(3, 7))
        x2 = x * x
        dx, dy = x * x2 * (k1 + k2 * x2), x * (t1 + t2 * x)
        if not partials:
            return dx, dy, (), []
        zero = np.zeros_like(x)
        slopes = x2 * (3.0 * k1 + 5.0 * k2 * x2), zero, t1 + 2.0 * t2 * x, zero
        return dx, dy, slopes, [(x * x2, zero), (x * x2 * x2, zero), (zero, x), (zero, x2)]


@dataclass(frozen=True)
class CylindricalLens(RayLens):
    """Image on a cylinder about the y axis: D = (λ, tan φ), the image of a panoramic camera.

    λ = atan2(p_x, p_z) grows to the right in radians, and tan φ = −p_y/√(p_x² + p_z²) upwards. The
    principal distance c is the radius of the cylinder, image units per radian. A camera that
    scans has a readout to the right or to the left. A residual is taken the shorter way round. The
    y axis itself has no image.
    """

    kind: ClassVar[str] = "cylindrical"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0")

    def seen(self, p: Ray, x: Array, y: Array, k: Array, *, jacobians: bool = True) -> Seen:
        """Return v and its partials, see `Lens.seen`.

        Raises:
            DegenerateError: a ray is parallel to the y axis of the camera.
        """
        px, py, pz = p
        c = k[:, 0]
        plan2 = px * px + pz * pz
        require(plan2 > 1e-24 * py * py, OUTSIDE)
        plan = np.sqrt(plan2)
        angle, up = np.arctan2(px, pz), -py / plan
        off = wrap(angle - (x - k[:, 1]) / c)
        v = c * off, k[:, 2] + c * up - y
        if not jacobians:
            return Seen(v, (), ())
        zero = np.zeros_like(px)
        by_p = (
            (c * pz / plan2, -c * up * px / plan2),
            (zero, -c / plan),
            (-c * px / plan2, -c * up * pz / plan2),
        )
        # v_x = c λ − (x − x0) up to whole turns, which grow with c.
        turns = off + (x - k[:, 1]) / c
        return Seen(v, by_p, ((turns, up), (1.0, 0.0), (0.0, 1.0)))

    def guess(self, ax: Array, ay: Array) -> Array:
        """Return rays (n, 3) of coordinates divided by c, (n,) each."""
        return np.stack([np.sin(ax), -ay, np.cos(ax)], axis=1)
