"""Accuracies of the readings of field books, which their files do not state.

`Accuracies` has the standard deviations of directions, zenith readings, distances and levelled
lines, and how readings in two faces are reduced; `StatedSigmas` those that a file states for one
sight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

from ...errors import InputError, Problem, known
from ...network.face_reduction import FacesChoice
from ...stochastic_model import StandardDeviation
from ...units import ANGLE, LENGTH

DEFAULT_DIRECTION_MGON, DEFAULT_ZENITH_MGON = 1.0, 1.0
"""Default σ of a reading of a circle in one face, milligons: an instrument of 3″."""
DEFAULT_DISTANCE_MM, DEFAULT_DISTANCE_PPM = 2.0, 2.0
"""Default σ of a distance: 2 mm + 2 ppm, usual for total stations with prisms."""
DEFAULT_CENTRING_MM = 1.0
"""Default σ of the centring of instrument and of target, millimetres: tribrach and tripod."""
DEFAULT_LEVELLING_MM = 1.0
"""Default σ of one kilometre of levelled line, millimetres."""
DEFAULT_SETUP_M = 60.0
"""Length of line that a set-up of a level without lengths of sights counts as, metres."""
DEFAULT_REFRACTION = 0.13
"""Default coefficient of refraction k (Gauss)."""
STATED_SIGMAS = ("sigma_direction_mgon", "sigma_zenith_mgon", "sigma_distance_mm")
"""Standard deviations that a file may state."""


@dataclass(frozen=True)
class Accuracies:
    """Standard deviations of the readings of a field book, and how they are reduced.

    Every reader of field books takes them as ``accuracies``, because the files do not have them.
    `factorgraph_adj.read` and the commands (``--set``) also take each field as an option of its
    own.

    Raises:
        InputError: numbers that are no standard deviations, all of them.
    """

    sigma_direction_mgon: float | None = None
    """σ of a horizontal reading in one face, mgon; None: that of the file, which JobXML may have,
    or 1."""
    sigma_zenith_mgon: float | None = None
    """σ of a zenith reading in one face, mgon; None: that of the file, or 1."""
    sigma_distance_mm: float | None = None
    """Constant part of σ of a distance, mm; None: that of the file, which then has no part that
    grows, or 2."""
    ppm: float = DEFAULT_DISTANCE_PPM
    """Part of σ of a distance that grows with it, mm/km."""
    centring_mm: float | None = None
    """σ of the centring of instrument and of target, mm; None: 1, and 0 for both faces."""
    sigma_levelling_mm: float = DEFAULT_LEVELLING_MM
    """σ of one kilometre of levelled line, mm."""
    faces: FacesChoice = "means"
    """Means of two faces, or both readings, see `factorgraph_adj.reduce_faces`."""
    refraction: float | None = DEFAULT_REFRACTION
    """Coefficient of refraction k. None: heights are above a plane, neither curvature nor
    refraction."""

    def __post_init__(self) -> None:
        """Refuse numbers that are no standard deviations."""
        problems = []
        for name in (*STATED_SIGMAS, "sigma_levelling_mm"):
            value = getattr(self, name)
            if not (value is None and name in STATED_SIGMAS) and not _is_within(value, 1e-9, 1e6):
                problems.append(_range_problem(name, "a number > 0", value))
        for name in ("ppm", "centring_mm"):
            value = getattr(self, name)
            if not (value is None and name == "centring_mm") and not _is_within(value, 0.0, 1e6):
                problems.append(_range_problem(name, "a number ≥ 0", value))
        if self.faces not in (valid := get_args(FacesChoice)):
            problems.append(_range_problem("faces", known(valid, meant=self.faces), self.faces))
        if self.refraction is not None and not _is_within(self.refraction, -10.0, 10.0):
            problems.append(_range_problem("refraction", "a number such as 0.13", self.refraction))
        if problems:
            raise InputError(problems)

    @property
    def centring(self) -> float:
        """σ of the centring of instrument and of target, metres."""
        usual = DEFAULT_CENTRING_MM if self.faces == "means" else 0.0
        return (usual if self.centring_mm is None else self.centring_mm) * LENGTH["mm"]

    def direction(self, stated: float | None) -> float | StandardDeviation:
        """Return σ of a horizontal reading, with the centring of both ends.

        Args:
            stated: σ that the file states, radians; it counts where none is given.
        """
        return self._angle(self.sigma_direction_mgon, stated, DEFAULT_DIRECTION_MGON)

    def zenith(self, stated: float | None) -> float | StandardDeviation:
        """Return σ of a zenith reading as `direction` does."""
        return self._angle(self.sigma_zenith_mgon, stated, DEFAULT_ZENITH_MGON)

    def _angle(
        self, given: float | None, stated: float | None, usual: float
    ) -> float | StandardDeviation:
        c = self.centring
        constant = (usual if given is None else given) * ANGLE["mgon"]
        if given is None and stated is not None:
            constant = stated
        if c == 0.0:
            return constant
        return StandardDeviation(constant, centring_instrument=c, centring_target=c)

    def distance(self, stated: float | None) -> StandardDeviation:
        """Return σ of a distance, with the centring of both ends.

        Args:
            stated: σ that the file states, metres; it has no part that grows, and counts where
                none is given.
        """
        c, given = self.centring, self.sigma_distance_mm
        constant = (DEFAULT_DISTANCE_MM if given is None else given) * LENGTH["mm"]
        ppm = self.ppm
        if given is None and stated is not None:
            constant, ppm = stated, 0.0
        return StandardDeviation(constant, ppm=ppm, centring_instrument=c, centring_target=c)

    def levelling(self) -> StandardDeviation:
        """Return σ of a levelled height difference."""
        return StandardDeviation(per_sqrt_km=self.sigma_levelling_mm * LENGTH["mm"])


def _is_within(value: object, low: float, high: float) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) and low <= value <= high


def _range_problem(name: str, valid: str, value: object) -> Problem:
    return Problem(f"must be {valid}, not {value!r}", name)


DEFAULT_ACCURACIES = Accuracies()
"""Accuracies of an instrument of 3″ and 2 mm + 2 ppm on tripods, and means of both faces."""


@dataclass(frozen=True)
class StatedSigmas:
    """Standard deviations that a file states for a sight: radians, radians, metres."""

    direction: float | None = None
    zenith: float | None = None
    distance: float | None = None


NO_SIGMAS = StatedSigmas()


def root_mean_square(stated: list[float | None]) -> float | None:
    """Return the root mean square of standard deviations; None where there is none."""
    given = [s for s in stated if s is not None]
    return math.sqrt(sum(s * s for s in given) / len(given)) if given else None
