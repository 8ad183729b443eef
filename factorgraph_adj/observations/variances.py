"""Variances from the parts of standard deviations, by kind and geometry of the observation.

`factorgraph_adj.stochastic_model.StandardDeviation` has the formulas. The record of each kind
holds the `Weight` of the kind, or None.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..stochastic_model import PARTS, StandardDeviation
from ..types import Array

CENTRING = ("centring_instrument", "centring_target")
"""Parts for the centring of instrument and target."""
VERTICAL = ("vertical_instrument", "vertical_target")
"""Parts for the heights of instrument and target."""


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
class Along:
    """One sight of known length, for a tolerance without coordinates."""

    length: float
    """Length, metres."""
    km: float | None = None
    """Length of the levelled line, km; None: that of the sight."""

    @property
    def observed(self) -> Array:
        """The length, (1,)."""
        return np.array([self.length])

    def sight(self, target: str = "target") -> Array:
        """Return the line as a level one, (1, 3) metres."""
        return np.array([[0.0, self.length, 0.0]])

    def number(self, attribute: str) -> Array:
        """Return the length of the levelled line, km, (1,); NaN if it is that of the sight."""
        return np.array([np.nan if self.km is None else self.km])


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
    vertical_instrument: Array
    """Standard deviation of the height of the instrument, metres; NaN: that of its centring."""
    vertical_target: Array
    """Standard deviation of the height of the target, metres; NaN: that of its centring."""

    @classmethod
    def of(cls, sigmas: Sequence[StandardDeviation]) -> Parts:
        """Return the parts of standard deviations."""
        names = ("constant", *PARTS)
        return cls(*(np.array([getattr(s, n) for s in sigmas], dtype=float) for n in names))


@dataclass(frozen=True)
class Effects:
    """Effects of the parts of n standard deviations on their observations, each (n,)."""

    reading: tuple[Array, ...]
    """Effects of the reading itself, unit of the observation."""
    beside: tuple[Array, ...] = ()
    """Effects of what is beside the reading, such as centring."""

    def variance(self, combine: Sequence[str]) -> Array:
        """Return σ² (n,), by how the effects of each standard deviation combine (n,)."""
        every = (*self.reading, *self.beside)
        linear = np.square(sum(every))
        quadratic = sum(map(np.square, every))
        mixed = np.square(sum(self.reading)) + sum(map(np.square, self.beside))
        rule = np.array(combine)
        return np.select([rule == "linear", rule == "quadratic"], [linear, quadratic], mixed)


@dataclass(frozen=True)
class Weight:
    """Variance of a kind of observation as a function of parts and geometry."""

    effects: Callable[[Parts, Geometry], Effects]
    """(parts, geometry) → effects of the parts on the observations."""
    parts: tuple[str, ...] = CENTRING
    """Parts that have an effect besides the constant one; only these have columns in tables."""

    def variance(self, sigmas: Sequence[StandardDeviation], geometry: Geometry) -> Array:
        """Return σ² of standard deviations, (n,)."""
        effects = self.effects(Parts.of(sigmas), geometry)
        return effects.variance([s.combine for s in sigmas])


def _of_lengths(p: Parts, geometry: Geometry) -> Effects:
    length = np.abs(geometry.observed)
    return Effects((p.constant, 1e-6 * p.ppm * length), _along(p, geometry))


def _of_plain_lengths(p: Parts, geometry: Geometry) -> Effects:
    length = np.abs(geometry.observed)
    return Effects((p.constant, 1e-6 * p.ppm * length), (p.centring_instrument, p.centring_target))


def _along(p: Parts, geometry: Geometry) -> tuple[Array, Array]:
    """Return the movement of both ends along their sight, metres."""
    return _moved(p, geometry, lambda level, up: (level, up))


def _across(p: Parts, geometry: Geometry) -> tuple[Array, Array]:
    """Return the movement of both ends across their sight in its vertical plane, metres."""
    return _moved(p, geometry, lambda level, up: (up, level))


def _moved(
    p: Parts, geometry: Geometry, shares: Callable[[Array, Array], tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Return √((c·h)² + (v·u)²) of both ends, (n,) metres; c where v is NaN.

    Args:
        p: parts of the standard deviations.
        geometry: where the observations are.
        shares: function of sin z and |cos z| of the sights that returns h and u.
    """
    ends = (
        (p.centring_instrument, p.vertical_instrument),
        (p.centring_target, p.vertical_target),
    )
    if all(np.isnan(v).all() for _, v in ends):
        # Without a part for the height the direction does not matter, and may be unknown: a kind
        # of one's own need not be a sight in space.
        return p.centring_instrument, p.centring_target
    q = geometry.sight()
    slope = np.linalg.norm(q, axis=1)
    apart = slope > 0
    safe = np.where(apart, slope, 1.0)
    # Where both ends are one place, the line between them is taken as level.
    h, u = shares(np.where(apart, _level(q) / safe, 1.0), np.abs(q[:, 2]) / safe)
    instrument, target = (np.where(np.isnan(v), c, np.hypot(c * h, v * u)) for c, v in ends)
    return instrument, target


def _of_levelling(p: Parts, geometry: Geometry) -> Effects:
    stated = geometry.number("length_km")
    km = np.where(np.isnan(stated), _level(geometry.sight()) / 1000.0, stated)
    # Without the part the length does not matter, and may be unknown.
    return Effects((p.constant,), (np.where(p.per_sqrt_km > 0, p.per_sqrt_km * np.sqrt(km), 0.0),))


def _of_inclinations(p: Parts, geometry: Geometry) -> Effects:
    slope = np.linalg.norm(geometry.sight(), axis=1)
    instrument, target = _across(p, geometry)
    return Effects((p.constant,), (instrument / slope, target / slope))


def _of_directions(p: Parts, geometry: Geometry) -> Effects:
    level = _level(geometry.sight())
    return Effects((p.constant,), (p.centring_instrument / level, p.centring_target / level))


def _of_angles(p: Parts, geometry: Geometry) -> Effects:
    q, q2 = geometry.sight(), geometry.sight("target2")
    level, level2 = _level(q), _level(q2)
    across = np.hypot(q2[:, 0] - q[:, 0], q2[:, 1] - q[:, 1])
    return Effects(
        (p.constant,),
        (
            p.centring_instrument * across / (level * level2),
            p.centring_target * np.hypot(1 / level, 1 / level2),
        ),
    )


def _level(q: Array) -> Array:
    return np.hypot(q[:, 0], q[:, 1])


LENGTHS = Weight(_of_lengths, ("ppm", *CENTRING, *VERTICAL))
"""Variance of slope distances."""
PLAIN_LENGTHS = Weight(_of_plain_lengths, ("ppm", *CENTRING))
"""Variance of lengths on which heights have no effect, or whose axes are those of a frame."""
LEVELLING = Weight(_of_levelling, ("per_sqrt_km",))
"""Variance of levelled height differences: a level has no centring."""
INCLINATIONS = Weight(_of_inclinations, (*CENTRING, *VERTICAL))
"""Variance of vertical and zenith angles."""
PLAIN_INCLINATIONS = Weight(_of_inclinations)
"""Variance of zenith angles whose axes are those of a frame."""
DIRECTIONS = Weight(_of_directions)
"""Variance of horizontal directions and azimuths."""
ANGLES = Weight(_of_angles)
"""Variance of horizontal angles between two targets."""
