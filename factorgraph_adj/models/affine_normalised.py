"""Frame camera of current photogrammetric programs, in normalised coordinates with an affinity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .lens import LensPartials, NormalisedLens, Pair


@dataclass(frozen=True)
class AffineNormalisedLens(NormalisedLens):
    """Radial-tangential in normalised coordinates with k4, affinity b1 and shear b2.

    v = (x0, y0) + c d + (b1 d_x + b2 d_y, 0) − (x, y) with d = t + brown(t) + k4 r⁸ t. The focal
    length in x is c + b1, that in y is c. k1..k4, p1, p2 are dimensionless, b1 and b2 are in image
    units. This is the frame camera of Metashape (whose y points down: its b2 is −b2 here, its p2
    is −p2), and, with fx = c + b1, OpenCV's without its rational terms.
    """

    kind: ClassVar[str] = "normalised_affine"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "k4", "b1", "b2")

    def _correction(
        self, x: Array, y: Array, k: Array, partials: bool
    ) -> tuple[Array, Array, tuple[Array, ...], list[tuple[Array, Array]]]:
        dx, dy, d, columns = super()._correction(x, y, k, partials)
        k4 = k[:, 8]
        r2 = x * x + y * y
        r6 = r2 * r2 * r2
        r8 = r6 * r2
        dx, dy = dx + k4 * r8 * x, dy + k4 * r8 * y
        if not partials:
            return dx, dy, (), []
        dxx, dxy, dyx, dyy = d
        slope = 8.0 * k4 * r6
        cross = slope * x * y
        d = (
            dxx + k4 * r8 + slope * x * x,
            dxy + cross,
            dyx + cross,
            dyy + k4 * r8 + slope * y * y,
        )
        return dx, dy, d, [*columns, (r8 * x, r8 * y)]

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`."""
        c, x0, y0, b1, b2 = k[:, 0], k[:, 1], k[:, 2], k[:, 9], k[:, 10]
        dx, dy, d, columns = self._correction(tx, ty, k, jacobians)
        ux, uy = tx + dx, ty + dy
        v = x0 + (c + b1) * ux + b2 * uy - x, y0 + c * uy - y
        if not jacobians:
            return LensPartials(v, (), ())

        def affine(px: Array | float, py: Array | float) -> Pair:
            return (c + b1) * px + b2 * py, c * py

        dxx, dxy, dyx, dyy = d
        by_k: list[Pair] = [
            (ux, uy),
            (1.0, 0.0),
            (0.0, 1.0),
            *(affine(px, py) for px, py in columns),
            (ux, 0.0),
            (uy, 0.0),
        ]
        by_t = affine(1.0 + dxx, dyx), affine(dxy, 1.0 + dyy)
        return LensPartials(v, by_t, tuple(by_k))


@dataclass(frozen=True)
class FraserNormalisedLens(NormalisedLens):
    """Radial-tangential in normalised coordinates with an affinity of the ideal coordinates.

    v = (x0, y0) + c (t + brown(t) + (b1 t_x + b2 t_y, 0)) − (x, y). All parameters besides c, x0
    and y0 are dimensionless. This is the calibration of MMVII, IsFraserMode 1 and degrees up to
    3 1 1 (cMMVIIUnivDist of its Formulas_CamStenope.h), whose y points down: its p2 and b2 are
    −p2 and −b2 here.
    """

    kind: ClassVar[str] = "normalised_fraser"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1", "b2")

    def _correction(
        self, x: Array, y: Array, k: Array, partials: bool
    ) -> tuple[Array, Array, tuple[Array, ...], list[tuple[Array, Array]]]:
        dx, dy, d, columns = super()._correction(x, y, k, partials)
        b1, b2 = k[:, 8], k[:, 9]
        dx = dx + b1 * x + b2 * y
        if not partials:
            return dx, dy, (), []
        zero = np.zeros_like(x)
        return dx, dy, (d[0] + b1, d[1] + b2, d[2], d[3]), [*columns, (x, zero), (y, zero)]
