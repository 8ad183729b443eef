"""Lens models by tangents: residuals of image points, with measured or ideal places corrected.

A ray has tangents (t_x, t_y) = (−q1/q3, −q2/q3) in photogrammetric camera axes (eq. 1).
Every model gives the residual v = computed − observed of image coordinates (x, y), x right,
y up, in image units, with c the principal distance and (x0, y0) the principal point.

Two directions exist:

- measured → ideal: corrections are functions of the measured coordinates,
  w = c t − corrected(x − x0, y − y0), see `CorrectingLens`.
- ideal → measured: v = x0 + distorted(c t) − x.

These models have no image of a ray at 90° to the axis. Models of `ray_lens` take the ray itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from ..errors import InputError
from ..types import Array
from .base import require
from .measured_coordinates import Correction as Correction
from .measured_coordinates import Pair as Pair
from .measured_coordinates import measured_residuals

IN_FOCAL_PLANE = "the point lies in the focal plane of the photo: it has no image"

Ray: TypeAlias = tuple[Array, Array, Array]
"""Components p of rays in the axes of the camera (x right, y down, z ahead), (n,) each."""
LensResult: TypeAlias = tuple[Array, Array | None, Array | None]
"""v (n, 2); ∂v/∂t (n, 2, 2) and ∂v/∂K (n, 2, k), or None if not requested."""


class LensPartials(NamedTuple):
    """Residuals and partials of many rays, one array for each component."""

    v: tuple[Array, Array]
    """v_x and v_y, (n,) each."""
    by_t: tuple[Pair, ...]
    """∂v/∂t_x and ∂v/∂t_y; empty if not requested."""
    by_k: tuple[Pair, ...]
    """∂v/∂K of each calibration parameter; empty if not requested."""


class Seen(NamedTuple):
    """Image coordinates of rays p = Rᵀ (X − X₀), one array for each component."""

    v: tuple[Array, Array]
    """v_x and v_y, (n,) each, image units."""
    by_p: tuple[tuple[Array, Array], ...]
    """g = ∂v/∂p_x, ∂v/∂p_y and ∂v/∂p_z, each of v_x and v_y; empty if not requested."""
    by_k: tuple[Pair, ...]
    """∂v/∂K of each calibration parameter; empty if not requested."""


@dataclass(frozen=True)
class Lens:
    """Base of the lens models, and the pinhole model with c, x0, y0."""

    kind: ClassVar[str] = "none"
    takes: ClassVar[Literal["tangents", "rays", "places"]] = "tangents"
    """What the model is a function of. Models of tangents have images only of points in front of
    the camera; models of rays have images of points at 90° to the axis and behind it, too; models
    of places have no projection centre, see `place_lens`."""
    given: ClassVar[tuple[str, ...]] = ()
    """Parameters that come with an image in large numbers: none may be left out where they are
    stated by name; text and page of a report leave them out where they are held."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters, in order."""
        return ("c", "x0", "y0")

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, one array for each component.

        Args:
            tx: tangents t_x of the rays, (n,).
            ty: tangents t_y of the rays, (n,).
            x: measured coordinates x, (n,).
            y: measured coordinates y, (n,).
            k: calibration parameters, (n, number of names) or (1, ...).
            jacobians: whether to compute the partials.
        """
        c = k[:, 0]
        ax, ay = x - k[:, 1], y - k[:, 2]
        dx, dy, d, columns = self._correction(ax, ay, k, jacobians)
        v = c * tx - ax - dx, c * ty - ay - dy
        if not jacobians:
            return LensPartials(v, (), ())
        dxx, dxy, dyx, dyy = d
        by_k: list[Pair] = [
            (tx, ty),
            (1.0 + dxx, dyx),
            (dxy, 1.0 + dyy),
            *((-px, -py) for px, py in columns),
        ]
        return LensPartials(v, ((c, 0.0), (0.0, c)), tuple(by_k))

    def seen(self, p: Ray, x: Array, y: Array, k: Array, *, jacobians: bool = True) -> Seen:
        """Return v and its partials by the rays and the calibration.

        Args:
            p: components of the rays in the axes of the camera, (n,) each, of any length.
            x: measured coordinates x, (n,).
            y: measured coordinates y, (n,).
            k: calibration parameters, (n, number of names) or (1, ...).
            jacobians: whether to compute the partials.

        Raises:
            DegenerateError: a ray has no image, as it lies in the focal plane. Rays behind the
                camera are computed, because an iteration may pass there.
        """
        px, py, pz = p
        require(np.abs(pz) > 1e-12 * (np.abs(px) + np.abs(py) + np.abs(pz)), IN_FOCAL_PLANE)
        iz = 1.0 / pz
        tx, ty = px * iz, -py * iz
        v, by_t, by_k = self.partials(tx, ty, x, y, k, jacobians=jacobians)
        if not jacobians:
            return Seen(v, (), ())
        # ∂v/∂p from ∂t/∂p = [[1/z, 0, −t_x/z], [0, −1/z, −t_y/z]]
        (xx, yx), (xy, yy) = by_t
        by_x, by_y = (xx * iz, yx * iz), (-xy * iz, -yy * iz)
        by_z = by_y[0] * ty - by_x[0] * tx, by_y[1] * ty - by_x[1] * tx
        return Seen(v, (by_x, by_y, by_z), by_k)

    def towards_ideal(self, x: Array, y: Array, k: Array) -> Pair:
        """Return differences of measured coordinates (n,) as ideal ones, roughly.

        It is the way from measured coordinates to rays, which begins with the coordinates
        themselves where the model has no large linear part.
        """
        return x, y

    @property
    def in_ideal_coordinates(self) -> Lens:
        """The model with residuals in ideal coordinates, where it can choose; else itself."""
        return self

    def residual(
        self, tx: Array, ty: Array, xy: Array, k: Array, *, jacobians: bool = True
    ) -> LensResult:
        """Return v and its partials as one array each.

        Args:
            tx: tangents t_x of the rays, (n,).
            ty: tangents t_y of the rays, (n,).
            xy: measured coordinates, (n, 2).
            k: calibration parameters, (n, number of names) or (1, ...).
            jacobians: whether to compute the partials.
        """
        v, by_t, by_k = self.partials(tx, ty, xy[:, 0], xy[:, 1], k, jacobians=jacobians)
        joined = np.stack(v, 1)
        if not jacobians:
            return joined, None, None
        return joined, _joined(by_t, len(tx)), _joined(by_k, len(tx))

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        """Return dV_x, dV_y and their partials by x̄, ȳ and by the additional parameters."""
        zero = np.zeros_like(x)
        return zero, zero, (zero, zero, zero, zero), []


def _joined(pairs: Sequence[Pair], n: int) -> Array:
    """Return pairs of partials as one array, (n, 2, number of pairs)."""
    out = np.empty((n, 2, len(pairs)))
    for j, (px, py) in enumerate(pairs):
        out[:, 0, j], out[:, 1, j] = px, py
    return out


NoDistortion = Lens
"""Pinhole: c, x0, y0."""


@dataclass(frozen=True)
class CorrectingLens(Lens):
    """Base of the models measured → ideal: w(l) = c t − corrected(l − l0) for measured l = (x, y).

    Residuals in measured coordinates are v = l̂ − l with w(l̂) = 0, so that Σ is that of measured
    coordinates: the least squares of the model with conditions, w − B v = 0 with B = −∂w/∂l at l̂.
    To the first order their weights are those of eqs. 18 and 20 of El-Hakim & Faig (1981),
    v = B⁻¹ w and vᵀ Σ⁻¹ v = wᵀ (B Σ Bᵀ)⁻¹ w. Residuals in ideal coordinates are v = w(l), and Σ is
    taken as that of corrected coordinates (B = I), as other programs with such a model do.

    A ray without l̂, far outside the image, has one in ideal coordinates, without a message.
    """

    _: KW_ONLY
    residuals: Literal["measured", "ideal"] = "measured"
    """Coordinates in which residuals are formed and σ are stated."""

    def __post_init__(self) -> None:
        """Check the option."""
        if self.residuals not in ("measured", "ideal"):
            raise InputError(f"residuals must be measured or ideal, not {self.residuals!r}")

    @property
    def in_ideal_coordinates(self) -> Lens:
        """The model with residuals in ideal coordinates."""
        return self if self.residuals == "ideal" else replace(self, residuals="ideal")

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`."""
        if self.residuals == "ideal":
            return super().partials(tx, ty, x, y, k, jacobians=jacobians)
        found = measured_residuals(self._correction, tx, ty, x, y, k, jacobians=jacobians)
        return LensPartials(*found)


def brown_terms(
    x: Array, y: Array, k: tuple[Array, ...], radius: float, partials: bool
) -> Correction:
    """Return radial and decentring terms and partials, k = (k1, k2, k3, p1, p2).

    dx = x Σ k_i (r^2i − R^2i) + p1 (r² + 2x²) + 2 p2 x y
    dy = y Σ k_i (r^2i − R^2i) + p2 (r² + 2y²) + 2 p1 x y
    """
    k1, k2, k3, p1, p2 = k
    xx, yy, xy2 = x * x, y * y, 2.0 * x * y
    r2 = xx + yy
    r4 = r2 * r2
    r6 = r4 * r2
    s2, s4, s6 = r2 - radius**2, r4 - radius**4, r6 - radius**6
    radial = k1 * s2 + k2 * s4 + k3 * s6
    tx, ty = r2 + 2.0 * xx, r2 + 2.0 * yy
    dx = x * radial + p1 * tx + p2 * xy2
    dy = y * radial + p2 * ty + p1 * xy2
    if not partials:
        return dx, dy, (), []
    slope = 2.0 * (k1 + 2.0 * k2 * r2 + 3.0 * k3 * r4)
    cross = 0.5 * xy2 * slope + 2.0 * (p1 * y + p2 * x)
    dxx = radial + xx * slope + 6.0 * p1 * x + 2.0 * p2 * y
    dyy = radial + yy * slope + 6.0 * p2 * y + 2.0 * p1 * x
    columns = [(x * s2, y * s2), (x * s4, y * s4), (x * s6, y * s6), (tx, xy2), (xy2, ty)]
    return dx, dy, (dxx, cross, cross, dyy), columns


def with_affinity(found: Correction, x: Array, y: Array, b1: Array, b2: Array) -> Correction:
    """Return a correction with b1 x + b2 y added to dV_x."""
    dx, dy, d, columns = found
    dx = dx + b1 * x + b2 * y
    if not d:
        return dx, dy, (), []
    zero = np.zeros_like(x)
    return dx, dy, (d[0] + b1, d[1] + b2, d[2], d[3]), [*columns, (x, zero), (y, zero)]


@dataclass(frozen=True)
class BrownLens(CorrectingLens):
    """Brown, measured → ideal: radial k1..k3, decentring p1, p2, affinity b1, shear b2.

    With a = (x̄, ȳ): corrected = a + brown(a). The affinity (x, y) → (x(1 + b1) + b2 y, y) acts
    before or after this correction. Units: k_i in 1/unit^2i, p in 1/unit.
    """

    kind: ClassVar[str] = "brown"
    affine: Literal["before", "after"] = "before"
    """Whether the affinity acts before or after radial and decentring terms."""

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        if self.affine not in ("before", "after"):
            raise InputError(f"affine must be before or after, not {self.affine!r}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1", "b2")

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        k1, k2, k3, p1, p2, b1, b2 = (k[:, j] for j in range(3, 10))
        brown = (k1, k2, k3, p1, p2)
        zero = np.zeros_like(x)
        if self.affine == "before":
            ax = x * (1.0 + b1) + b2 * y
            dx, dy, d, columns = brown_terms(ax, y, brown, 0.0, partials)
            fx, fy = ax - x + dx, dy
            if not partials:
                return fx, fy, (), []
            dxx, dxy, dyx, dyy = d
            by = (
                (1.0 + dxx) * (1.0 + b1) - 1.0,
                (1.0 + dxx) * b2 + dxy,
                dyx * (1.0 + b1),
                dyx * b2 + dyy,
            )
            columns += [((1.0 + dxx) * x, dyx * x), ((1.0 + dxx) * y, dyx * y)]
            return fx, fy, by, columns
        dx, dy, d, columns = brown_terms(x, y, brown, 0.0, partials)
        cx, cy = x + dx, y + dy
        fx, fy = cx * (1.0 + b1) + b2 * cy - x, dy
        if not partials:
            return fx, fy, (), []
        dxx, dxy, dyx, dyy = d
        by = (
            (1.0 + dxx) * (1.0 + b1) + b2 * dyx - 1.0,
            dxy * (1.0 + b1) + b2 * (1.0 + dyy),
            dyx,
            dyy,
        )
        columns = [(px * (1.0 + b1) + b2 * py, py) for px, py in columns]
        columns += [(cx, zero), (cy, zero)]
        return fx, fy, by, columns


@dataclass(frozen=True)
class ForwardLens(Lens):
    """Base of ideal → measured models: v = (x0, y0) + a + s·F(a) − (x, y), a = c t."""

    radius: ClassVar[float] = 0.0

    def partials(
        self, tx: Array, ty: Array, x: Array, y: Array, k: Array, *, jacobians: bool = True
    ) -> LensPartials:
        """Return v and its partials, see `Lens.partials`."""
        c = k[:, 0]
        unit = self._unit(c)
        ax, ay = c * tx, c * ty
        dx, dy, d, columns = self._correction(ax / unit, ay / unit, k, jacobians)
        v = k[:, 1] + ax + unit * dx - x, k[:, 2] + ay + unit * dy - y
        if not jacobians:
            return LensPartials(v, (), ())
        dxx, dxy, dyx, dyy = d
        by_a = (1.0 + dxx, dxy, dyx, 1.0 + dyy)
        # c changes a, and also the unit of the correction in models with the unit c.
        by_c = self._by_c(tx, ty, by_a, dx, dy)
        by_k: list[Pair] = [
            by_c,
            (1.0, 0.0),
            (0.0, 1.0),
            *((unit * px, unit * py) for px, py in columns),
        ]
        xx, xy, yx, yy = (c * p for p in by_a)
        return LensPartials(v, ((xx, yx), (xy, yy)), tuple(by_k))

    def _unit(self, c: Array) -> Array:
        """Return the unit in which F takes coordinates."""
        return np.ones_like(c)

    def _by_c(
        self, tx: Array, ty: Array, by_a: tuple[Array, ...], dx: Array, dy: Array
    ) -> tuple[Array, Array]:
        """Return the partials of v by c; ``by_a`` are those by a, row by row."""
        xx, xy, yx, yy = by_a
        return xx * tx + xy * ty, yx * tx + yy * ty


@dataclass(frozen=True)
class BrownForwardLens(ForwardLens):
    """Brown, ideal → measured: the corrections are subtracted from the ideal coordinates.

    F = −brown(a), a = c t in image units; k_i in 1/unit^2i. The parameters have the signs of
    `BrownLens`.
    """

    kind: ClassVar[str] = "brown_forward"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2")

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        brown = tuple(-k[:, j] for j in range(3, 8))
        dx, dy, d, columns = brown_terms(x, y, brown, 0.0, partials)
        return dx, dy, d, [(-px, -py) for px, py in columns]


@dataclass(frozen=True)
class NormalisedLens(ForwardLens):
    """Radial-tangential in normalised coordinates, as in OpenCV and Bundle Adjustment in the Large.

    v = (x0, y0) + c (t + brown(t)) − (x, y), dimensionless k1..k3, p1, p2. Since y points up,
    p1, p2 are those of `BrownLens` (OpenCV's p1 is −p2 here, OpenCV's p2 is p1).
    """

    kind: ClassVar[str] = "normalised"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2")

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        return brown_terms(x, y, tuple(k[:, j] for j in range(3, 8)), 0.0, partials)

    def _unit(self, c: Array) -> Array:
        return c

    def _by_c(
        self, tx: Array, ty: Array, by_a: tuple[Array, ...], dx: Array, dy: Array
    ) -> tuple[Array, Array]:
        return tx + dx, ty + dy


@dataclass(frozen=True)
class BalancedLens(ForwardLens):
    """Balanced radial form of close-range systems, ideal → measured.

    F = a·[A1 (r² − R²) + A2 (r⁴ − R⁴) + A3 (r⁶ − R⁶)] + decentring B1, B2 + affinity
    (C1 x + C2 y in x), with the radius R of zero distortion.
    """

    kind: ClassVar[str] = "balanced"
    zero_radius: float = 0.0
    """R: radius at which the radial distortion vanishes, image units."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "A1", "A2", "A3", "B1", "B2", "C1", "C2")

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        brown = tuple(k[:, j] for j in range(3, 8))
        found = brown_terms(x, y, brown, self.zero_radius, partials)
        return with_affinity(found, x, y, k[:, 8], k[:, 9])


@dataclass(frozen=True)
class AffineLens(CorrectingLens):
    """Affine deformation of film or sensor, measured → ideal: dV = (b1 x̄ + b2 ȳ, 0)."""

    kind: ClassVar[str] = "affine"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", "b1", "b2")

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        b1, b2 = np.broadcast_to(k[:, 3], x.shape), np.broadcast_to(k[:, 4], x.shape)
        zero = np.zeros_like(x)
        return b1 * x + b2 * y, zero, (b1, b2, zero, zero), [(x, zero), (y, zero)]


@dataclass(frozen=True)
class HarmonicLens(CorrectingLens):
    """El-Hakim & Faig's harmonic function, measured → ideal: dV = (x̄, ȳ)·T. Eqs. 2 and 3.

    T = a00 + a11 cosλ + b11 sinλ + a20 ρ + a22 ρ cos2λ + b22 ρ sin2λ + a31 ρ² cosλ
        + b31 ρ² sinλ + a33 ρ² cos3λ + b33 ρ² sin3λ,  ρ = r/reference_radius, λ = atan2(ȳ, x̄).

    All coefficients are dimensionless and of one order of magnitude. At r = 0, where λ is
    undefined, the correction and its partials by a11 and b11 are zero.
    """

    kind: ClassVar[str] = "harmonic"
    reference_radius: float = 1.0
    """Radius by which r is divided, image units."""

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        if not self.reference_radius > 0:
            raise InputError(f"reference_radius must be positive, not {self.reference_radius}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        terms = ("a00", "a11", "b11", "a20", "a22", "b22", "a31", "b31", "a33", "b33")
        return ("c", "x0", "y0", *terms)

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        r = np.hypot(x, y)
        angle = np.arctan2(y, x)
        rho = r / self.reference_radius
        c1, s1 = np.cos(angle), np.sin(angle)
        c2, s2 = np.cos(2 * angle), np.sin(2 * angle)
        c3, s3 = np.cos(3 * angle), np.sin(3 * angle)
        rho2 = rho * rho
        one = np.ones_like(r)
        terms = [one, c1, s1, rho, rho * c2, rho * s2, rho2 * c1, rho2 * s1, rho2 * c3, rho2 * s3]
        a = [k[:, j] for j in range(3, 13)]
        t = sum(ai * term for ai, term in zip(a, terms, strict=True))
        if not partials:
            return x * t, y * t, (), []
        # x̄ ∂T/∂x̄ and so on, written with r ∂T/∂r and ∂T/∂λ so that r = 0 needs no division.
        by_r = rho * (a[3] + a[4] * c2 + a[5] * s2) + 2 * rho2 * (
            a[6] * c1 + a[7] * s1 + a[8] * c3 + a[9] * s3
        )
        by_angle = (
            -a[1] * s1
            + a[2] * c1
            + rho * (-2 * a[4] * s2 + 2 * a[5] * c2)
            + rho2 * (-a[6] * s1 + a[7] * c1 - 3 * a[8] * s3 + 3 * a[9] * c3)
        )
        rtx, rty = c1 * by_r - s1 * by_angle, s1 * by_r + c1 * by_angle
        d = (t + c1 * rtx, c1 * rty, s1 * rtx, t + s1 * rty)
        return x * t, y * t, d, [(x * term, y * term) for term in terms]
