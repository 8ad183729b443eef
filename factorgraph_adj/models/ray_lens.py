"""Lens models of rays to 90° and beyond: fisheye, field of view, division, unified, panorama.

With the ray p in the axes of the camera (x right, y down, z ahead), ρ = √(p_x² + p_y²) and
R = |p|, a model gives dimensionless image coordinates D(p) with x right and y up, and then

    x = x0 + c ((1 + b1) D_x + b2 D_y)
    y = y0 + c D_y

with affinity b1 and shear b2 (f_x = c (1 + b1), f_y = c). All models are ideal → measured, the
residual is v = computed − observed, and the length of p does not matter. Radial models have
D = s(ρ, p_z) (p_x, −p_y).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from ..types import Array
from .base import require, wrap
from .lens import Lens, LensPartials, Pair, Ray, Seen

BACKWARDS = "the point lies on the axis of the camera, exactly behind it: it has no image"
OUTSIDE = "the point lies outside the field of view of the lens model: it has no image"
AT_CENTRE = "the point is the projection centre: it has no image"
SERIES = 0.03
"""Ratio ρ/p_z below which the angle is a series; both forms agree to 1e-12 there."""
SMALL_FIELD = 0.01
"""Parameter ω of `FovLens` below which its factors are series, radians."""


class Drawn(NamedTuple):
    """Dimensionless image coordinates D of rays, y up, and their partials."""

    d: tuple[Array, Array]
    """D_x and D_y, (n,) each."""
    by_p: tuple[tuple[Array, Array], ...]
    """∂D/∂p_x, ∂D/∂p_y and ∂D/∂p_z; empty if not requested."""
    by_own: tuple[Pair, ...]
    """∂D/∂ the parameters of `RayLens.own`; empty if not requested."""


class Stretch(NamedTuple):
    """The factor s of a radial model, and its partials."""

    s: Array
    """s = |D|/ρ, (n,)."""
    by_rho: Array
    """(∂s/∂ρ)/ρ, which is regular at ρ = 0."""
    by_z: Array
    """∂s/∂p_z."""
    by_own: tuple[Array, ...]
    """∂s/∂ the parameters."""


@dataclass(frozen=True)
class RayLens(Lens):
    """Base of the lens models that take rays."""

    takes: ClassVar[Literal["tangents", "rays", "places"]] = "rays"
    own: ClassVar[tuple[str, ...]] = ()
    """Names of the parameters of D."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", *self.own, "b1", "b2")

    def drawn(self, p: Ray, own: tuple[Array, ...], partials: bool) -> Drawn:
        """Return D and its partials.

        Args:
            p: components of the rays, (n,) each.
            own: parameters of D, (n,) or (1,) each.
            partials: whether to compute the partials.
        """
        raise NotImplementedError

    def seen(self, p: Ray, x: Array, y: Array, k: Array, *, jacobians: bool = True) -> Seen:
        """Return v and its partials by the rays and the calibration, see `Lens.seen`.

        Raises:
            DegenerateError: a ray has no image: outside the field of view of the model.
        """
        end = 3 + len(self.own)
        c, b1, b2 = k[:, 0], k[:, end], k[:, end + 1]
        found = self.drawn(p, tuple(k[:, j] for j in range(3, end)), jacobians)
        u, w = found.d
        in_x, in_y = (1.0 + b1) * u + b2 * w, w
        v = k[:, 1] + c * in_x - x, k[:, 2] + c * in_y - y
        if not jacobians:
            return Seen(v, (), ())

        def drawn_out(pair: Pair) -> tuple[Array, Array]:
            du, dw = pair
            return c * ((1.0 + b1) * du + b2 * dw), c * dw

        by_k: list[Pair] = [(in_x, in_y), (1.0, 0.0), (0.0, 1.0)]
        by_k += [drawn_out(pair) for pair in found.by_own]
        by_k += [(c * u, 0.0), (c * w, 0.0)]
        return Seen(v, tuple(drawn_out(pair) for pair in found.by_p), tuple(by_k))

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials for rays in front of the camera, see `Lens.partials`."""
        ray = tx, -ty, np.ones_like(tx)
        v, by_p, by_k = self.seen(ray, x, y, k, jacobians=jacobians)
        if not jacobians:
            return LensPartials(v, (), ())
        by_x, (xy, yy) = by_p[0], by_p[1]
        return LensPartials(v, (by_x, (-xy, -yy)), by_k)

    def guess(self, ax: Array, ay: Array) -> Array:
        """Return rays (n, 3) of coordinates divided by c, (n,) each: r is the angle to the axis."""
        r = np.hypot(ax, ay)
        angle = np.minimum(r, 3.0)
        across = np.sinc(angle / np.pi) * angle / np.where(r > 0, r, 1.0)
        return np.stack([across * ax, -across * ay, np.cos(angle)], axis=1)


@dataclass(frozen=True)
class RadialRayLens(RayLens):
    """Base of the models D = s(ρ, p_z) (p_x, −p_y)."""

    def stretch(self, rho2: Array, z: Array, own: tuple[Array, ...], partials: bool) -> Stretch:
        """Return s and its partials.

        Args:
            rho2: ρ², (n,).
            z: p_z, (n,).
            own: parameters, (n,) or (1,) each.
            partials: whether to compute the partials.
        """
        raise NotImplementedError

    def drawn(self, p: Ray, own: tuple[Array, ...], partials: bool) -> Drawn:
        """Return D and its partials, see `RayLens.drawn`."""
        px, py, pz = p
        found = self.stretch(px * px + py * py, pz, own, partials)
        s = found.s
        d = px * s, -py * s
        if not partials:
            return Drawn(d, (), ())
        g = found.by_rho
        cross = px * py * g
        by_p = (
            (s + px * px * g, -cross),
            (cross, -s - py * py * g),
            (px * found.by_z, -py * found.by_z),
        )
        return Drawn(d, by_p, tuple((px * q, -py * q) for q in found.by_own))


def angle_over(rho2: Array, z: Array, partials: bool) -> tuple[Array, Array, Array]:
    """Return S = atan2(ρ, z)/ρ, (∂S/∂ρ)/ρ and ∂S/∂z, (n,) each, from ρ² and z.

    Raises:
        DegenerateError: rays of no length, and rays exactly backwards.
    """
    rr = rho2 + z * z
    require(rr > 0, AT_CENTRE)
    require((z > 0) | (rho2 > 1e-24 * rr), BACKWARDS)
    near = (z > 0) & (rho2 < SERIES**2 * z * z)
    rho = np.sqrt(np.where(near, 1.0, rho2))
    iz = 1.0 / np.where(near, z, 1.0)
    q = np.where(near, rho2, 0.0) * iz * iz
    s = np.where(
        near, iz * (1 - q * (1 / 3 - q * (1 / 5 - q * (1 / 7 - q / 9)))), np.arctan2(rho, z) / rho
    )
    if not partials:
        return s, s, s
    series = -(iz**3) * (2 / 3 - q * (4 / 5 - q * (6 / 7 - q * (8 / 9 - q * 10 / 11))))
    slope = np.where(near, series, (z / rr - s) / np.where(near, 1.0, rho2))
    return s, slope, -1.0 / rr


@dataclass(frozen=True)
class FisheyeLens(RadialRayLens):
    """Equidistant fisheye with distortion: OpenCV's, and those of COLMAP, Metashape and Kalibr.

    With the angle θ between ray and axis, u = θ (p_x, −p_y)/ρ, and r² = u_x² + u_y² = θ²:

        D_x = u_x g + p1 (r² + 2 u_x²) + 2 p2 u_x u_y + s1 r²
        D_y = u_y g + p2 (r² + 2 u_y²) + 2 p1 u_x u_y + s2 r²
        g = 1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸

    All parameters are dimensionless. s1, s2 are those of a thin prism. Rays of every direction but
    exactly backwards have images, also beyond the angle where D ceases to grow.
    """

    kind: ClassVar[str] = "fisheye"
    own: ClassVar[tuple[str, ...]] = ("k1", "k2", "k3", "k4", "p1", "p2", "s1", "s2")

    def drawn(self, p: Ray, own: tuple[Array, ...], partials: bool) -> Drawn:
        """Return D and its partials, see `RayLens.drawn`."""
        px, py, pz = p
        k1, k2, k3, k4, p1, p2, s1, s2 = own
        s, slope, by_z = angle_over(px * px + py * py, pz, partials)
        x, y = px * s, -py * s
        xx, yy, xy2 = x * x, y * y, 2.0 * x * y
        r2 = xx + yy
        g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
        tx, ty = r2 + 2.0 * xx, r2 + 2.0 * yy
        d = x * g + p1 * tx + p2 * xy2 + s1 * r2, y * g + p2 * ty + p1 * xy2 + s2 * r2
        if not partials:
            return Drawn(d, (), ())
        rise = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4)))
        cross = x * y * rise + 2.0 * (p1 * y + p2 * x)
        dxx = g + xx * rise + 6.0 * p1 * x + 2.0 * p2 * y + 2.0 * s1 * x
        dyy = g + yy * rise + 6.0 * p2 * y + 2.0 * p1 * x + 2.0 * s2 * y
        dxy, dyx = cross + 2.0 * s1 * y, cross + 2.0 * s2 * x
        mixed = px * py * slope
        by_p: tuple[tuple[Array, Array], ...] = (
            (s + px * px * slope, -mixed),
            (mixed, -s - py * py * slope),
            (px * by_z, -py * by_z),
        )
        by_p = tuple((dxx * a + dxy * b, dyx * a + dyy * b) for a, b in by_p)
        r4 = r2 * r2
        powers = (r2, r4, r4 * r2, r4 * r4)
        columns: list[Pair] = [(x * power, y * power) for power in powers]
        columns += [(tx, xy2), (xy2, ty), (r2, 0.0), (0.0, r2)]
        return Drawn(d, by_p, tuple(columns))


@dataclass(frozen=True)
class FovLens(RadialRayLens):
    """Field-of-view model of Devernay & Faugeras (2001): |D| = atan2(2 ρ tan(ω/2), p_z)/ω.

    The parameter is ω, ``w``, in radians. F. Devernay, O. Faugeras, Straight lines have to be
    straight, Machine Vision and Applications 13 (2001), 14–24.
    """

    kind: ClassVar[str] = "fov"
    own: ClassVar[tuple[str, ...]] = ("w",)

    def stretch(self, rho2: Array, z: Array, own: tuple[Array, ...], partials: bool) -> Stretch:
        """Return s = a/ω · S(a ρ, p_z) with a = 2 tan(ω/2), see `RadialRayLens.stretch`."""
        w = own[0]
        small = np.abs(w) < SMALL_FIELD
        safe = np.where(small, 1.0, w)
        a = 2.0 * np.tan(0.5 * w)
        ratio = np.where(small, 1 + w**2 / 12 + w**4 / 120, a / safe)
        require((z > 0) | (a != 0), OUTSIDE)
        s, slope, by_z = angle_over(a * a * rho2, z, partials)
        if not partials:
            return Stretch(ratio * s, s, s, ())
        a_by_w = 1.0 + 0.25 * a * a
        ratio_by_w = np.where(small, w / 6 + w**3 / 30, (a_by_w * safe - a) / safe**2)
        by_w = ratio_by_w * s + ratio * slope * a * rho2 * a_by_w
        return Stretch(ratio * s, ratio * slope * a * a, ratio * by_z, (by_w,))


@dataclass(frozen=True)
class DivisionLens(RadialRayLens):
    """Division model of Fitzgibbon (2001): the ideal tangents are D/(1 + k |D|²).

    Its inverse is s = 2/(p_z + √(p_z² − 4 k ρ²)). For k < 0, barrel distortion, rays at 90° to the
    axis have images too; for k > 0 a ray has none where the root is imaginary. A. Fitzgibbon,
    Simultaneous linear estimation of multiple view geometry and lens distortion, CVPR 2001.
    """

    kind: ClassVar[str] = "division"
    own: ClassVar[tuple[str, ...]] = ("k1",)

    def stretch(self, rho2: Array, z: Array, own: tuple[Array, ...], partials: bool) -> Stretch:
        """Return s and its partials, see `RadialRayLens.stretch`."""
        k = own[0]
        square = z * z - 4.0 * k * rho2
        require(square > 1e-20 * (z * z + rho2), OUTSIDE)
        root = np.sqrt(square)
        require(z + root > 1e-12 * root, OUTSIDE)
        s = 2.0 / (z + root)
        if not partials:
            return Stretch(s, s, s, ())
        ss = s * s / root
        return Stretch(s, 2.0 * k * ss, -s / root, (ss * rho2,))


@dataclass(frozen=True)
class UnifiedLens(RadialRayLens):
    """Enhanced unified camera model: s = 1/(α d + (1 − α) p_z), d = √(β ρ² + p_z²).

    Parameters ``alpha`` (0 … 1) and ``beta`` (positive, 1: a sphere) are dimensionless; α = 0 is
    the pinhole. A ray has an image where p_z > −d α/(1 − α), and for α > ½ where
    p_z > −d (1 − α)/α. B. Khomutenko, G. Garcia, P. Martinet, An enhanced unified camera model,
    IEEE Robotics and Automation Letters 1 (2016), 137–144.
    """

    kind: ClassVar[str] = "eucm"
    own: ClassVar[tuple[str, ...]] = ("alpha", "beta")

    def stretch(self, rho2: Array, z: Array, own: tuple[Array, ...], partials: bool) -> Stretch:
        """Return s and its partials, see `RadialRayLens.stretch`."""
        alpha, beta = own
        square = beta * rho2 + z * z
        require(square > 0, OUTSIDE)
        d = np.sqrt(square)
        below = alpha * d + (1.0 - alpha) * z
        # Beyond, |D| is infinite (α ≤ ½), or falls again, so that two rays share an image (α > ½).
        fold = alpha * z + (1.0 - alpha) * d
        require((below > 1e-12 * d) & ((alpha <= 0.5) | (fold > 0)), OUTSIDE)
        s = 1.0 / below
        if not partials:
            return Stretch(s, s, s, ())
        ss = -s * s
        by_own = ss * (d - z), ss * alpha * rho2 / (2.0 * d)
        return Stretch(s, ss * alpha * beta / d, ss * (alpha * z / d + 1.0 - alpha), by_own)


@dataclass(frozen=True)
class EquirectangularLens(RayLens):
    """Panorama over the whole sphere: D = (λ, φ), longitude and latitude in radians.

    λ = atan2(p_x, p_z) grows to the right and φ = atan2(−p_y, √(p_x² + p_z²)) upwards. The
    principal distance c is image units per radian, the width of the panorama divided by 2π. A
    residual is taken the shorter way round. The vertical axis itself has no image.
    """

    kind: ClassVar[str] = "equirectangular"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0")

    def seen(self, p: Ray, x: Array, y: Array, k: Array, *, jacobians: bool = True) -> Seen:
        """Return v and its partials, see `Lens.seen`.

        Raises:
            DegenerateError: a ray is vertical in the axes of the camera.
        """
        px, py, pz = p
        c = k[:, 0]
        plan2 = px * px + pz * pz
        require(plan2 > 1e-24 * py * py, OUTSIDE)
        plan = np.sqrt(plan2)
        longitude, latitude = np.arctan2(px, pz), np.arctan2(-py, plan)
        off = wrap(longitude - (x - k[:, 1]) / c)
        v = c * off, k[:, 2] + c * latitude - y
        if not jacobians:
            return Seen(v, (), ())
        zero = np.zeros_like(px)
        rr = plan2 + py * py
        by_p = (
            (c * pz / plan2, c * px * py / (plan * rr)),
            (zero, -c * plan / rr),
            (-c * px / plan2, c * pz * py / (plan * rr)),
        )
        # v_x = c λ − (x − x0) up to whole turns, which grow with c.
        turns = off + (x - k[:, 1]) / c
        return Seen(v, by_p, ((turns, latitude), (1.0, 0.0), (0.0, 1.0)))

    def guess(self, ax: Array, ay: Array) -> Array:
        """Return rays (n, 3) of longitudes and latitudes, (n,) each."""
        plan = np.cos(ay)
        return np.stack([plan * np.sin(ax), -np.sin(ay), plan * np.cos(ax)], axis=1)
