"""Lens model of satellite images: rational polynomial coefficients (RPC) with an affine bias.

Line and sample of an image are ratios of cubic polynomials of geodetic latitude, longitude and
height, each less an offset and divided by a scale:

    P = (φ − lat_off)/lat_scale,  L = (λ − long_off)/long_scale,  H = (h − height_off)/height_scale
    u = samp_scale N_s(P, L, H)/D_s(P, L, H),    w = −line_scale N_l(P, L, H)/D_l(P, L, H)

with 20 coefficients of each polynomial, in the order of RPC00B, by

    1 L P H LP LH PH L² P² H² PLH L³ LP² LH² L²P P³ PH² L²H P²H H³.

A bias of six parameters in the image takes up what orbit and attitude are wrong by (Grodecki & Dial
2003, Block adjustment of high-resolution satellite images described by rational polynomials, PE&RS
69, 59–68; its origin is the middle of the image here):

    x = samp_off + x0 + c ((1 + b1) u + b2 w)
    y = −line_off + y0 + c (b3 u + w)

x counts columns and y, upwards, minus rows. c is 1 and x0, y0, b1, b2, b3 are 0 without bias.
Angles of the coefficients are degrees, heights metres above the ellipsoid WGS 84.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..ellipsoid import ellipsoid
from ..errors import InputError
from ..frames import Frame, GeocentricFrame, TopocentricFrame
from ..types import Array
from .base import require
from .lens import Pair, Ray, Seen
from .place_lens import PlaceLens

COEFFICIENTS = 20
"""Number of coefficients of each polynomial."""
POWERS = np.array(
    [
        *[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)],
        *[(2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 1), (3, 0, 0), (1, 2, 0), (1, 0, 2)],
        *[(2, 1, 0), (0, 3, 0), (0, 1, 2), (2, 0, 1), (0, 2, 1), (0, 0, 3)],
    ]
)
"""Powers of L, P and H of each coefficient, (20, 3)."""
BIAS = ("c", "x0", "y0", "b1", "b2", "b3")
"""Names of the parameters of the bias."""
NORMALISATION = tuple(
    f"{what}_{part}"
    for part in ("off", "scale")
    for what in ("line", "samp", "lat", "long", "height")
)
"""Names of offsets and scales."""
POLYNOMIALS = ("line_num", "line_den", "samp_num", "samp_den")
"""Beginnings of the names of the coefficients; their numbers from 1 follow."""
MAX_STEPS = 20
"""Largest number of steps of the inverse at a given height."""
TOLERANCE = 1e-12
"""Change of normalised coordinates at which the inverse ends: 10 nm on the ground."""
WHERE_STARTS = 10.0
"""Height of the start of a line above the middle of the heights, in units of their scale."""
NO_RATIO = "the denominator of a rational polynomial is zero: the point is far outside the image"
DEGREES = 180.0 / np.pi
_WGS84 = GeocentricFrame("WGS84")


@dataclass(frozen=True)
class RpcLens(PlaceLens):
    """Rational polynomial coefficients of a satellite image, with an affine bias."""

    kind: ClassVar[str] = "rpc"
    given: ClassVar[tuple[str, ...]] = (
        *NORMALISATION,
        *(f"{p}_{i}" for p in POLYNOMIALS for i in range(1, COEFFICIENTS + 1)),
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters: bias, offsets and scales, 80 coefficients."""
        return (*BIAS, *self.given)

    def seen(self, p: Ray, x: Array, y: Array, k: Array, *, jacobians: bool = True) -> Seen:
        """Return v and its partials by geocentric places and the calibration, see `Lens.seen`.

        Raises:
            DegenerateError: a denominator is zero.
        """
        place = np.stack(p, axis=1)
        latitude, longitude, height = _WGS84.ellipsoid.to_geodetic(place)
        scales = _normalisation(k)
        lph = _normalised(np.stack([longitude * DEGREES, latitude * DEGREES, height]), scales)
        found = _Ratios.of(lph, k, jacobians)
        line_scale, samp_scale = scales["line_scale"], scales["samp_scale"]
        u, w = samp_scale * found.sample, -line_scale * found.line
        c, b1, b2, b3 = k[:, 0], k[:, 3], k[:, 4], k[:, 5]
        in_x, in_y = (1.0 + b1) * u + b2 * w, b3 * u + w
        v = (
            scales["samp_off"] + k[:, 1] + c * in_x - x,
            -scales["line_off"] + k[:, 2] + c * in_y - y,
        )
        if not jacobians:
            return Seen(v, (), ())

        def in_image(by_sample: Array, by_line: Array) -> tuple[Array, Array]:
            du, dw = samp_scale * by_sample, -line_scale * by_line
            return c * ((1.0 + b1) * du + b2 * dw), c * (b3 * du + dw)

        by_lph = [in_image(*pair) for pair in zip(*found.by_lph, strict=True)]
        units = [scales[f"{name}_scale"] for name in ("long", "lat", "height")]
        by_place = (
            _places_of_geocentric(place) / np.stack(np.broadcast_arrays(*units), -1)[..., None]
        )
        by_p = tuple(
            (
                sum(by[0] * by_place[:, i, axis] for i, by in enumerate(by_lph)),
                sum(by[1] * by_place[:, i, axis] for i, by in enumerate(by_lph)),
            )
            for axis in range(3)
        )
        zero, one = np.zeros_like(u), np.ones_like(u)
        by_off = [(-by[0] / unit, -by[1] / unit) for by, unit in zip(by_lph, units, strict=True)]
        by_scale = [(by[0] * at, by[1] * at) for by, at in zip(by_off, lph, strict=True)]
        by_k: list[Pair] = [(in_x, in_y), (one, zero), (zero, one)]
        by_k += [(c * u, zero), (c * w, zero), (zero, c * u)]
        by_k += [(zero, -one), (one, zero), by_off[1], by_off[0], by_off[2]]
        by_k += [in_image(zero, found.line / line_scale), in_image(found.sample / samp_scale, zero)]
        by_k += [by_scale[1], by_scale[0], by_scale[2]]
        by_k += [in_image(zero, by) for by in found.line_by]
        by_k += [in_image(by, zero) for by in found.sample_by]
        return Seen(v, by_p, tuple(by_k))

    def places(self, xy: Array, calibration: Array) -> Array:
        """Return the geocentric places at the middle height, see `PlaceLens.places`."""
        return self._at_height(xy, calibration, 0.0)

    def lines(self, xy: Array, calibration: Array) -> tuple[Array, Array]:
        """Return the lines through places one scale above and below the middle height."""
        above, below = (self._at_height(xy, calibration, h) for h in (1.0, -1.0))
        d = below - above
        length = np.linalg.norm(d, axis=1, keepdims=True)
        return above - (WHERE_STARTS - 1.0) / 2.0 * d, d / length

    def _at_height(self, xy: Array, k: Array, height: float) -> Array:
        """Return the geocentric places (n, 3) of measured coordinates at a normalised height."""
        n = len(xy)
        k = np.broadcast_to(k, (n, k.shape[1]))
        scales = _normalisation(k)
        c, b1, b2, b3 = k[:, 0], k[:, 3], k[:, 4], k[:, 5]
        from_x = (xy[:, 0] - k[:, 1] - scales["samp_off"]) / c
        from_y = (xy[:, 1] - k[:, 2] + scales["line_off"]) / c
        det = 1.0 + b1 - b2 * b3
        sample = (from_x - b2 * from_y) / det / scales["samp_scale"]
        line = -((1.0 + b1) * from_y - b3 * from_x) / det / scales["line_scale"]
        lph = np.zeros((3, n))
        lph[2] = height
        for _ in range(MAX_STEPS):
            found = _Ratios.of(lph, k, True)
            off = np.stack([line - found.line, sample - found.sample], axis=1)
            by = np.stack([found.by_lph[1][:2], found.by_lph[0][:2]]).transpose(2, 0, 1)
            step = np.linalg.solve(by, off[:, :, None])[:, :, 0]
            lph[:2] += step.T
            if np.abs(step).max(initial=0.0) < TOLERANCE:
                break
        named = ("long", "lat", "height")
        longitude, latitude, h = (
            at * scales[f"{a}_scale"] + scales[f"{a}_off"] for a, at in zip(named, lph, strict=True)
        )
        return ellipsoid("WGS84").to_cartesian(latitude / DEGREES, longitude / DEGREES, h)

    def stated_pose(self, frame: Frame) -> tuple[Array, Array]:
        """Return the centre of the Earth and geocentric axes in a frame.

        Raises:
            InputError: the frame is local, or has another ellipsoid than WGS 84 and GRS 80.
        """
        if isinstance(frame, GeocentricFrame | TopocentricFrame):
            if frame.ellipsoid_name not in ("WGS84", "GRS80"):
                what = "rational polynomials are functions of latitude, longitude and height in WGS"
                raise InputError(f"{what} 84, not on the ellipsoid {frame.ellipsoid_name}")
            if isinstance(frame, GeocentricFrame):
                return np.zeros(3), np.eye(3)
            return frame.from_geocentric(np.zeros((1, 3)))[0], frame.axes_in_geocentric
        what = "rational polynomials need a geocentric or topocentric frame"
        raise InputError(f"{what}, which knows latitude, longitude and height")


def normalised_plan(place: Array, calibration: Array) -> Array:
    """Return L and P of geocentric places (n, 3): within about ±1 the coefficients hold, (n, 2)."""
    latitude, longitude, height = _WGS84.ellipsoid.to_geodetic(place)
    at = np.stack([longitude * DEGREES, latitude * DEGREES, height])
    return _normalised(at, _normalisation(calibration))[:2].T


def _normalisation(k: Array) -> dict[str, Array]:
    """Return offsets and scales by name, (n,) or (1,) each."""
    first = len(BIAS)
    return {name: k[:, first + i] for i, name in enumerate(NORMALISATION)}


def _normalised(at: Array, scales: dict[str, Array]) -> Array:
    """Return L, P, H (3, n) of longitude and latitude, degrees, and height (3, n)."""
    off = at - np.stack(
        np.broadcast_arrays(*(scales[f"{a}_off"] for a in ("long", "lat", "height")))
    )
    off[0] -= 360.0 * np.round(off[0] / 360.0)  # an image on the meridian of 180°
    return np.asarray(
        off
        / np.stack(np.broadcast_arrays(*(scales[f"{a}_scale"] for a in ("long", "lat", "height"))))
    )


def _places_of_geocentric(place: Array) -> Array:
    """Return the partials of longitude, latitude (degrees) and height by X, (n, 3, 3)."""
    basis = _WGS84.basis(place, np.zeros((len(place), 2)))
    out = np.empty((len(place), 3, 3))
    out[:, 0] = DEGREES * basis.angles_by_position[:, 1]
    out[:, 1] = DEGREES * basis.angles_by_position[:, 0]
    out[:, 2] = basis.enu[:, 2]
    return out


@dataclass(frozen=True)
class _Ratios:
    """The ratios of line and sample, and their partials."""

    line: Array
    """N_l/D_l, (n,)."""
    sample: Array
    """N_s/D_s, (n,)."""
    by_lph: tuple[Array, Array]
    """Partials of sample and line by L, P, H, (3, n) each."""
    line_by: Array
    """Partials of the line by its 40 coefficients, (40, n)."""
    sample_by: Array
    """Those of the sample."""

    @classmethod
    def of(cls, lph: Array, k: Array, partials: bool) -> _Ratios:
        """Compute the ratios at normalised coordinates (3, n)."""
        first = len(BIAS) + len(NORMALISATION)
        coefficients = k[:, first:].T.reshape(2, 2, COEFFICIENTS, -1)
        power = np.ones((4, *lph.shape))
        for i in range(1, 4):
            power[i] = power[i - 1] * lph
        terms = power[POWERS[:, 0], 0] * power[POWERS[:, 1], 1] * power[POWERS[:, 2], 2]
        values = np.einsum("sptn,tn->spn", coefficients + 0.0 * lph[0], terms)
        top, below = values[:, 0], values[:, 1]
        require(
            (np.abs(below) > 1e-9 * np.abs(coefficients[:, 1]).max(axis=1)).all(axis=0), NO_RATIO
        )
        ratio = top / below
        if not partials:
            return cls(ratio[0], ratio[1], (ratio, ratio), ratio, ratio)
        slopes = np.empty((3, *terms.shape))
        for axis in range(3):
            factor = [power[POWERS[:, j], j] for j in range(3)]
            degree = POWERS[:, axis]
            factor[axis] = degree[:, None] * power[np.maximum(degree - 1, 0), axis]
            slopes[axis] = factor[0] * factor[1] * factor[2]
        by = np.einsum("sptn,atn->span", coefficients + 0.0 * lph[0], slopes)
        by_lph = (by[:, 0] - ratio[:, None] * by[:, 1]) / below[:, None]
        line_by, sample_by = (
            np.concatenate([terms / d, -r * terms / d]) for r, d in zip(ratio, below, strict=True)
        )
        return cls(ratio[0], ratio[1], (by_lph[1], by_lph[0]), line_by, sample_by)
