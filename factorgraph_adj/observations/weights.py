"""Variance of an observation from the parts of its standard deviation, for each kind.

    Lengths (S in metres):    σ² = (constant + ppm·10⁻⁶ S)² + centring_i² + centring_t²
    Levelling (L in km):      σ² = constant² + per_sqrt_km² L + centring_i² + centring_t²
    Directions, azimuths:     σ² = constant² + (centring_i² + centring_t²)/D²
    Vertical, zenith angles:  σ² = constant² + (centring_i² + centring_t²)/S²
    Angles j-i-k:             σ² = constant² + centring_i² D_jk²/(D_ij D_ik)²
                                   + centring_t² (1/D_ij² + 1/D_ik²)

D are horizontal distances and S slope distances from the start coordinates; S of a length is the
observed value. The record of each kind holds the `Weight` of the kind, or None.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..types import Array

PARTS = ("ppm", "per_sqrt_km", "centring_instrument", "centring_target")
"""Attributes of `StandardDeviation` for the parts that are not constant."""
CENTRING = ("centring_instrument", "centring_target")
"""Parts for the centring of instrument and target."""


class Geometry(Protocol):
    """Quantities on which a variance may depend."""

    @property
    def observed(self) -> Array:
        """Observed values, (n,)."""

    def sight(self, target: str = "target") -> Array:
        """Return the line from the instrument to ``target`` in the horizon of the station.

        East, north and up, (n, 3) metres.
        """

    def number(self, attribute: str) -> Array:
        """Return a numeric attribute of each observation, (n,); NaN where the value is None."""


@dataclass(frozen=True)
class Parts:
    """The parts of n standard deviations, each (n,)."""

    constant: Array
    """Constant part, unit of the observation."""
    ppm: Array
    """Part proportional to a distance, millionths."""
    per_sqrt_km: Array
    """Standard deviation of one kilometre of levelled line, metres."""
    centring_instrument: Array
    """Standard deviation of the centring of the instrument, metres."""
    centring_target: Array
    """Standard deviation of the centring of the target, metres."""


@dataclass(frozen=True)
class Weight:
    """Variance of a kind of observation as a function of parts and geometry."""

    variance: Callable[[Parts, Geometry], Array]
    """(parts, geometry) → σ², (n,)."""
    parts: tuple[str, ...] = CENTRING
    """Parts that ``variance`` uses besides the constant one; only these have columns in tables."""


def _of_lengths(p: Parts, geometry: Geometry) -> Array:
    length = np.abs(geometry.observed)
    variance: Array = (
        (p.constant + 1e-6 * p.ppm * length) ** 2 + p.centring_instrument**2 + p.centring_target**2
    )
    return variance


def _of_levelling(p: Parts, geometry: Geometry) -> Array:
    stated = geometry.number("length_km")
    km = np.where(np.isnan(stated), _level(geometry.sight()) / 1000.0, stated)
    variance: Array = (
        p.constant**2 + p.per_sqrt_km**2 * km + p.centring_instrument**2 + p.centring_target**2
    )
    return variance


def _of_inclinations(p: Parts, geometry: Geometry) -> Array:
    slope = np.linalg.norm(geometry.sight(), axis=1)
    variance: Array = p.constant**2 + (p.centring_instrument**2 + p.centring_target**2) / slope**2
    return variance


def _of_directions(p: Parts, geometry: Geometry) -> Array:
    level = _level(geometry.sight())
    variance: Array = p.constant**2 + (p.centring_instrument**2 + p.centring_target**2) / level**2
    return variance


def _of_angles(p: Parts, geometry: Geometry) -> Array:
    q, q2 = geometry.sight(), geometry.sight("target2")
    level, level2 = _level(q), _level(q2)
    across = np.hypot(q2[:, 0] - q[:, 0], q2[:, 1] - q[:, 1])
    variance: Array = (
        p.constant**2
        + p.centring_instrument**2 * (across / (level * level2)) ** 2
        + p.centring_target**2 * (1 / level**2 + 1 / level2**2)
    )
    return variance


def _level(q: Array) -> Array:
    return np.hypot(q[:, 0], q[:, 1])


LENGTHS = Weight(_of_lengths, ("ppm", *CENTRING))
"""Variance of distances."""
LEVELLING = Weight(_of_levelling, ("per_sqrt_km", *CENTRING))
"""Variance of levelled height differences."""
INCLINATIONS = Weight(_of_inclinations)
"""Variance of vertical and zenith angles."""
DIRECTIONS = Weight(_of_directions)
"""Variance of horizontal directions and azimuths."""
ANGLES = Weight(_of_angles)
"""Variance of horizontal angles between two targets."""
