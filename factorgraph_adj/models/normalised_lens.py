"""Further lens models: affine, Fraser's and rational in normalised coordinates; centred Brown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..types import Array
from .lens import (
    CorrectingLens,
    Correction,
    ForwardLens,
    LensPartials,
    NormalisedLens,
    Pair,
    brown_terms,
    with_affinity,
)


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

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
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

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        found = super()._correction(x, y, k, partials)
        return with_affinity(found, x, y, k[:, 8], k[:, 9])


@dataclass(frozen=True)
class CentredBrownLens(CorrectingLens):
    """Brown, measured → ideal, about a centre of distortion beside the principal point.

    With a = (x̄, ȳ) from the principal point and q = a − (xd, yd): corrected = a + brown(q) +
    (b1 q_x + b2 q_y, 0). Units: k_i in 1/unit^2i, p in 1/unit; xd and yd, the centre of distortion
    from the principal point, in image units. This is the model of MicMac (RadialStd, Fraser), whose
    y points down: its p2 and b2 are −p2 and −b2 here. Only distortion tells the centre: xd and yd
    are undetermined where the radial terms are zero.
    """

    kind: ClassVar[str] = "brown_centred"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1", "b2", "xd", "yd")

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        b1, b2, xd, yd = (k[:, j] for j in range(8, 12))
        qx, qy = x - xd, y - yd
        found = brown_terms(qx, qy, tuple(k[:, j] for j in range(3, 8)), 0.0, partials)
        dx, dy, d, columns = with_affinity(found, qx, qy, b1, b2)
        if not partials:
            return dx, dy, (), []
        dxx, dxy, dyx, dyy = d
        return dx, dy, d, [*columns, (-dxx, -dyx), (-dxy, -dyy)]


@dataclass(frozen=True)
class RationalLens(ForwardLens):
    """Radial quotient and decentring of tangents, with affinity, ideal → measured.

    With r² = t_x² + t_y² and g = (1 + k1 r² + k2 r⁴ + k3 r⁶)/(1 + k4 r² + k5 r⁴ + k6 r⁶):

        D_x = t_x g + p1 (r² + 2 t_x²) + 2 p2 t_x t_y
        D_y = t_y g + p2 (r² + 2 t_y²) + 2 p1 t_x t_y
        x = x0 + c ((1 + b1) D_x + b2 D_y),  y = y0 + c D_y

    so that f_x = c (1 + b1) and f_y = c. All parameters but c, x0, y0 are dimensionless. Since y
    points up, OpenCV's p1 is −p2 here and its p2 is p1. It is `NormalisedLens` where k4 … b2 are 0.
    """

    kind: ClassVar[str] = "rational"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        own = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "b1", "b2")
        return ("c", "x0", "y0", *own)

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        k1, k2, k3, k4, k5, k6, p1, p2, b1, b2 = (k[:, j] for j in range(3, 13))
        xx, yy, xy2 = x * x, y * y, 2.0 * x * y
        r2 = xx + yy
        below = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        g = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) * below
        tx, ty = r2 + 2.0 * xx, r2 + 2.0 * yy
        u, w = x * g + p1 * tx + p2 * xy2, y * g + p2 * ty + p1 * xy2
        stretch = 1.0 + b1
        dx, dy = stretch * u + b2 * w - x, w - y
        if not partials:
            return dx, dy, (), []
        rise = (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2)) - g * (k4 + r2 * (2.0 * k5 + 3.0 * k6 * r2))
        slope = 2.0 * rise * below
        cross = 0.5 * xy2 * slope + 2.0 * (p1 * y + p2 * x)
        uxx = g + xx * slope + 6.0 * p1 * x + 2.0 * p2 * y
        wyy = g + yy * slope + 6.0 * p2 * y + 2.0 * p1 * x
        d = (stretch * uxx + b2 * cross - 1.0, stretch * cross + b2 * wyy, cross, wyy - 1.0)
        powers = [r2 * below]
        powers += [powers[0] * r2]
        powers += [powers[1] * r2]
        powers += [-g * power for power in powers]
        columns = [(x * power, y * power) for power in powers]
        columns += [(tx, xy2), (xy2, ty)]
        columns = [(stretch * a + b2 * b, b) for a, b in columns]
        zero = 0.0 * w
        return dx, dy, d, [*columns, (u, zero), (w, zero)]

    def _unit(self, c: Array) -> Array:
        return c

    def _by_c(
        self, tx: Array, ty: Array, by_a: tuple[Array, ...], dx: Array, dy: Array
    ) -> tuple[Array, Array]:
        return tx + dx, ty + dy
