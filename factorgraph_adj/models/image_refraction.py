"""Refraction of rays from the air: how far the air displaces the ray to a point of the ground.

A ray that leaves a camera at the height H with the nadir angle ν bends towards the vertical in the
denser air below, and reaches the height h where a straight ray with the angle ν − Δ would:

    Δ = K tan ν,    K = 1/(H − h) ∫ (n − n_H) dz   from h to H                (ν up to about 60°)

K is in radians. With N = n − 1 = A p/T, p the pressure, T the temperature, and hydrostatic balance
dp = −g p/(R T) dz the integral is that of the density of the air, whatever the temperatures are:

    K = A [ (R/g) (p_h − p_H)/(H − h) − p_H/T_H ]

| model | K in 10⁻⁶ rad, heights in km |
| --- | --- |
| ``integral`` | the integral of any atmosphere, as in Schut 1969 and Saastamoinen 1972; to 11 km |
| ``traced`` | Snell's law in spherical layers instead, for any nadir angle, to 11 km |
| ``saastamoinen`` | 13 (H − h) (1 − 0.02 (2 H + h)), his approximation, to 9 km |
| ``bertram`` | 2410 [ H/(H² − 6 H + 250) − h²/(H (h² − 6 h + 250)) ], atmosphere of ARDC 1959 |
| ``wolf`` | 7.4·10⁻⁴ ° (H − h) (1 − 0.02 (2 H − h)) of textbooks |

The atmosphere is that of ICAO, or follows from pressure and temperature at one height. Heights are
above sea level. (FRAMES F15.2.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from ..atmosphere import (
    CEILING,
    EXPONENT,
    GAS_CONSTANT,
    GRAVITY,
    LAPSE_RATE,
    SEA_LEVEL_PRESSURE,
    SEA_LEVEL_TEMPERATURE,
)
from ..errors import InputError, known
from ..frames import MEAN_EARTH_RADIUS
from ..types import Array

RefractionModel: TypeAlias = Literal["integral", "traced", "saastamoinen", "bertram", "wolf"]
"""Models of the refraction of rays from the air."""
REFRACTIVITY = 78.83e-8
"""A = (n − 1) T/p of visible light in dry air, kelvin per pascal."""
NODES = 32
"""Number of Gaussian nodes along a ray."""


@dataclass(frozen=True)
class Atmosphere:
    """Air with a constant lapse rate, in hydrostatic balance; by default that of ICAO."""

    pressure: float = SEA_LEVEL_PRESSURE
    """Pressure at ``height``, Pa."""
    temperature: float = SEA_LEVEL_TEMPERATURE
    """Temperature at ``height``, kelvin."""
    height: float = 0.0
    """Height at which both were read, metres above sea level."""

    def __post_init__(self) -> None:
        """Refuse values of other units."""
        if not 15_000.0 < self.pressure < 1.2 * SEA_LEVEL_PRESSURE:
            raise InputError(
                f"the pressure must be between 15000 and 120000 Pa, not {self.pressure}; 1 hPa is "
                "100 Pa"
            )
        if not 180.0 < self.temperature < 340.0:
            raise InputError(f"the temperature must be in kelvin, not {self.temperature}")

    def at(self, height: Array) -> tuple[Array, Array]:
        """Return pressure, Pa, and temperature, kelvin, at heights up to 11 km, metres."""
        h = np.asarray(height, dtype=float)
        if (h > CEILING).any():
            raise InputError(
                f"the lapse rate is constant up to {CEILING:.0f} m above sea level, and a height "
                f"is {h.max():.0f} m: heights are metres"
            )
        temperature = self.temperature - LAPSE_RATE * (h - self.height)
        return self.pressure * (temperature / self.temperature) ** (1.0 / EXPONENT), temperature

    def refractivity(self, height: Array) -> Array:
        """Return n − 1 at heights, metres."""
        p, t = self.at(height)
        return REFRACTIVITY * p / t


def refraction_constant(
    camera: Array,
    ground: Array,
    *,
    model: RefractionModel = "integral",
    atmosphere: Atmosphere | None = None,
) -> Array:
    """Return K, radians, of cameras and points on the ground.

    >>> k = refraction_constant(np.array([3000.0]), np.array([300.0]))
    >>> (1e6 * k).round(1).tolist()
    [30.7]

    Args:
        camera: heights H of the cameras above sea level, metres, (n,).
        ground: heights h of the points, metres, (n,); below those of the cameras.
        model: the model; ``traced`` has no K.
        atmosphere: the air of ``integral``; None: that of ICAO.

    Raises:
        InputError: an unknown model, one with an atmosphere of its own although one is given,
            points that are not below their cameras, or heights above 11 km.
    """
    if model not in get_args(RefractionModel) or model == "traced":
        valid = known([m for m in get_args(RefractionModel) if m != "traced"], meant=str(model))
        raise InputError(f"unknown model of refraction with a constant {model!r}; valid: {valid}")
    if atmosphere is not None and model != "integral":
        raise InputError(
            f"the model {model!r} has an atmosphere of its own: pressure and temperature belong to "
            "integral and traced"
        )
    _refuse_above(camera, ground)
    if model == "integral":
        air = atmosphere or Atmosphere()
        (low, _), (high, t) = air.at(ground), air.at(camera)
        k = (GAS_CONSTANT / GRAVITY) * (low - high) / (camera - ground) - high / t
        return np.asarray(REFRACTIVITY * k)
    top, h = camera / 1000.0, ground / 1000.0
    if model == "saastamoinen":
        k = 13.0 * (top - h) * (1.0 - 0.02 * (2.0 * top + h))
    elif model == "bertram":
        k = 2410.0 * (top / (top**2 - 6 * top + 250) - h**2 / (top * (h**2 - 6 * h + 250)))
    else:
        k = 1e6 * np.radians(7.4e-4) * (top - h) * (1.0 - 0.02 * (2.0 * top - h))
    return np.asarray(1e-6 * k)


def ray_refraction(
    nadir_angle: Array,
    camera: Array,
    ground: Array,
    *,
    model: RefractionModel = "integral",
    atmosphere: Atmosphere | None = None,
) -> Array:
    """Return Δ, radians: how much larger the nadir angle of a ray is than that of its point.

    Args:
        nadir_angle: nadir angles ν of the rays as they arrive, radians, (n,).
        camera: heights H of the cameras above sea level, metres, (n,).
        ground: heights h of the points, metres, (n,).
        model: the model.
        atmosphere: the air of ``integral`` and ``traced``; None: that of ICAO.

    Raises:
        InputError: as `refraction_constant`; or a ray that does not reach its height.
    """
    if model != "traced":
        k = refraction_constant(camera, ground, model=model, atmosphere=atmosphere)
        return np.asarray(k * np.tan(nadir_angle))
    _refuse_above(camera, ground)
    air = atmosphere or Atmosphere()
    x, w = np.polynomial.legendre.leggauss(NODES)
    half = 0.5 * (camera - ground)
    heights = ground[:, None] + half[:, None] * (1.0 + x)
    radius, top, low = (MEAN_EARTH_RADIUS + h for h in (heights, camera, ground))
    n = 1.0 + air.refractivity(heights)
    n_top = 1.0 + air.refractivity(camera)
    invariant = (top * np.sin(nadir_angle))[:, None]  # n r sin θ, over n at the camera
    seen = []
    for ratio in (n / n_top[:, None], np.ones_like(n)):
        sine = invariant / (ratio * radius)
        if (np.abs(sine) >= 1.0).any():
            raise InputError("a ray passes above the height of its point, beyond the horizon")
        # The angle at the centre of the Earth is the integral of tan θ dr / r.
        along = half * np.sum(w * sine / np.sqrt(1.0 - sine**2) / radius, axis=1)
        seen.append(np.arctan2(low * np.sin(along), top - low * np.cos(along)))
    return np.asarray(seen[1] - seen[0])


def _refuse_above(camera: Array, ground: Array) -> None:
    """Refuse points that are not below their cameras."""
    if not (camera > ground).all():
        i = int(np.flatnonzero(~(camera > ground))[0])
        raise InputError(
            f"refraction from the air is that of points below the camera: heights {camera[i]:.1f} "
            f"and {ground[i]:.1f} m"
        )


def in_map_plane(nadir_angle: Array, camera: Array, ground: Array, radius: float) -> Array:
    """Return nadir angles in a map plane of rays in space, radians, (n,).

    A map has heights above a sphere and arcs on it as if the Earth were flat: a point at the arc s
    from the nadir of the camera is seen at tan ν' = s/(H − h). To first order the image radius
    grows by H r³/(2 R c²). The scale of a map is that of its horizontal coordinates, and of heights
    of cameras above the ground, see `map_height`. (FRAMES F15.1.)

    Args:
        nadir_angle: nadir angles ν of straight rays, radians, (n,).
        camera: heights of the cameras, metres, (n,).
        ground: heights of the points, metres, (n,).
        radius: radius of the Earth, metres.

    Raises:
        InputError: points that are not below their cameras, or beyond the horizon.
    """
    _refuse_above(camera, ground)
    top, low = radius + camera, radius + ground
    sine = top * np.sin(nadir_angle) / low
    if (np.abs(sine) > 1.0).any():
        raise InputError("a ray passes above the height of its point, beyond the horizon")
    # Law of sines in the triangle of the camera, the point and the centre of the Earth.
    arc = np.arcsin(sine) - nadir_angle
    return np.asarray(np.arctan2(radius * arc, camera - ground))


def map_height(height: Array, ground: Array | float, scale: float) -> Array:
    """Return heights of cameras in a map plane with a scale: Z' = Z + (m − 1) (Z − Z_ground).

    Rays of a map plane intersect where heights above the ground are enlarged as the map is.

    Args:
        height: heights Z of cameras, metres.
        ground: heights of the ground below them, metres.
        scale: m, distances in the map over those on the Earth.
    """
    return np.asarray(height + (scale - 1.0) * (height - ground))
