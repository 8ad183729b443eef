"""Accuracies that field books do not have, and what else of a survey the reader is told."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import get_args

from ...errors import InputError, Problem, known
from ...field.faces import Faces
from ...stochastic import StandardDeviation
from ...units import ANGLE, LENGTH

DIRECTION_MGON, ZENITH_MGON = 1.0, 1.0
"""Default σ of a reading of a circle in one face, milligons: an instrument of 3″."""
DISTANCE_MM, PPM = 2.0, 2.0
"""Default σ of a distance: 2 mm + 2 ppm, usual for total stations with prisms."""
CENTRING_MM = 1.0
"""Default σ of the centring of instrument and of target, millimetres: tribrach and tripod."""
LEVELLING_MM = 1.0
"""Default σ of one kilometre of levelled line, millimetres."""
REFRACTION = 0.13
"""Default coefficient of refraction k (Gauss)."""


@dataclass(frozen=True)
class Accuracies:
    """Standard deviations of the readings of a field book, and how they are reduced.

    They are options of every reader of field books, because the files do not have them.
    """

    sigma_direction_mgon: float = DIRECTION_MGON
    """σ of a horizontal reading in one face, mgon."""
    sigma_zenith_mgon: float = ZENITH_MGON
    """σ of a zenith reading in one face, mgon."""
    sigma_distance_mm: float = DISTANCE_MM
    """Constant part of σ of a distance, mm."""
    ppm: float = PPM
    """Part of σ of a distance that grows with it, mm/km."""
    centring_mm: float | None = None
    """σ of the centring of instrument and of target, mm; None: 1, and 0 for both faces."""
    sigma_levelling_mm: float = LEVELLING_MM
    """σ of one kilometre of levelled line, mm."""
    faces: Faces = "means"
    """Means of two faces, or both readings, see `factorgraph_adj.reduce_faces`."""
    refraction: float | None = REFRACTION
    """Coefficient of refraction k. None: heights are above a plane, neither curvature nor
    refraction."""
    fixed: str | Iterable[str] = field(default=())
    """Names of the points that are held at the coordinates of the file; in a text with commas."""

    def __post_init__(self) -> None:
        """Refuse numbers that are no standard deviations; InputError lists all of them."""
        problems = []
        for name in (
            "sigma_direction_mgon",
            "sigma_zenith_mgon",
            "sigma_distance_mm",
            "sigma_levelling_mm",
        ):
            if not _within(getattr(self, name), 1e-9, 1e6):
                problems.append(_wrong(name, "a number > 0", getattr(self, name)))
        for name in ("ppm", "centring_mm"):
            value = getattr(self, name)
            if not (value is None and name == "centring_mm") and not _within(value, 0.0, 1e6):
                problems.append(_wrong(name, "a number ≥ 0", value))
        if self.faces not in (valid := get_args(Faces)):
            problems.append(_wrong("faces", known(valid, meant=self.faces), self.faces))
        if self.refraction is not None and not _within(self.refraction, -10.0, 10.0):
            problems.append(_wrong("refraction", "a number such as 0.13", self.refraction))
        if problems:
            raise InputError(problems)
        if self.centring_mm is None:
            object.__setattr__(self, "centring_mm", CENTRING_MM if self.faces == "means" else 0.0)

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the points that are held."""
        return names_of(self.fixed)

    def angle(self, mgon: float) -> float | StandardDeviation:
        """Return σ of a reading of a circle, with the centring of both ends."""
        constant, c = mgon * ANGLE["mgon"], (self.centring_mm or 0.0) * LENGTH["mm"]
        if c == 0.0:
            return constant
        return StandardDeviation(constant, centring_instrument=c, centring_target=c)

    def distance(self, mm: float, ppm: float) -> StandardDeviation:
        """Return σ of a distance, with the centring of both ends."""
        c = (self.centring_mm or 0.0) * LENGTH["mm"]
        constant = mm * LENGTH["mm"]
        return StandardDeviation(constant, ppm=ppm, centring_instrument=c, centring_target=c)

    def levelling(self) -> StandardDeviation:
        """Return σ of a levelled height difference."""
        return StandardDeviation(per_sqrt_km=self.sigma_levelling_mm * LENGTH["mm"])


def names_of(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return names; those in a text are separated by commas."""
    if isinstance(given, str):
        return tuple(n for part in given.split(",") if (n := part.strip()))
    if isinstance(given, int | float):  # a name that the command line took for a number
        return (str(given),)
    return tuple(str(n) for n in given)


def _within(value: object, low: float, high: float) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) and low <= value <= high


def _wrong(name: str, valid: str, value: object) -> Problem:
    return Problem(f"must be {valid}, not {value!r}", name)
