"""Terrestrial instruments: their observations, precision and unknowns."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from ...errors import Problem
from ...observations import Direction, HeightDifference, SlopeDistance, ZenithAngle
from ...stochastic import StandardDeviation
from ...units import ARCSEC
from ..parameters import Parameters, number, path_of
from .part import MILLIMETRE, Scene


@dataclass(frozen=True)
class DistanceMeter(Parameters):
    """A distance meter or a tape: its precision and its estimated constants."""

    name: str = ""
    """Name of the distance meter; empty: scale 1 and zero constant 0 are assumed."""
    sigma_mm: float = number(1.0, least=0)
    """Constant part of the standard deviation, mm."""
    ppm: float = number(1.0, least=0)
    """Part proportional to the distance, 1e-6."""
    unknown: tuple[Literal["scale", "zero"], ...] = ()
    """Constants that the adjustment estimates."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        if self.sigma_mm == 0 and self.ppm == 0:
            found.append(Problem("sigma_mm or ppm must be > 0", path_of(where, "sigma_mm")))
        if self.unknown and not self.name:
            found.append(
                Problem("is missing: unknowns belong to a named one", path_of(where, "name"))
            )
        return found

    @property
    def sigma(self) -> StandardDeviation:
        """Standard deviation of its distances."""
        return StandardDeviation(constant=self.sigma_mm * MILLIMETRE, ppm=self.ppm)

    def distances(self, scene: Scene, lines: Iterable[tuple[str, str]], where: str) -> None:
        """Add slope distances to the plan, and the distance meter if the plan lacks it."""
        plan = scene.plan
        if self.name:
            before = plan.distance_meters.get(self.name)
            plan.set_distance_meter(self.name, free=self.unknown)
            if before not in (None, plan.distance_meters[self.name]):
                scene.fail(
                    path_of(where, "unknown"),
                    f"an earlier part has {self.name!r} with other unknowns; give this one "
                    "another name",
                )
        plan.add(
            *(
                SlopeDistance(a, b, 0.0, sigma=self.sigma, instrument=self.name or None)
                for a, b in lines
            )
        )


@dataclass(frozen=True)
class TotalStation(Parameters):
    """A total station: directions, zenith angles and slope distances."""

    sigma_direction_arcsec: float = number(2.0, above=0)
    """Standard deviation of a direction, arc seconds."""
    sigma_zenith_arcsec: float = number(3.0, above=0)
    """Standard deviation of a zenith angle, arc seconds."""
    centring_mm: float = number(0.0, least=0)
    """Standard deviation of the centring of instrument and of target, mm."""
    distance_meter: DistanceMeter = field(default_factory=DistanceMeter)
    """Its distance meter."""

    def angle(self, arcsec: float) -> StandardDeviation:
        """Return the standard deviation of an angle including the centring."""
        centring = self.centring_mm * MILLIMETRE
        return StandardDeviation(
            constant=arcsec * ARCSEC, centring_instrument=centring, centring_target=centring
        )

    def directions(
        self, scene: Scene, station: str, targets: Iterable[str], *, set: str = "1"
    ) -> None:
        """Add a set of directions; its true orientation is drawn."""
        plan = scene.plan
        while (station, set) in plan.orientations:
            set = str(int(set) + 1)
        value = float(scene.rng(100 + len(plan.orientations)).uniform(0.0, 6.0))
        plan.set_orientation(station, set=set, value=value)
        sigma = self.angle(self.sigma_direction_arcsec)
        plan.add(*(Direction(station, t, 0.0, sigma=sigma, set=set) for t in targets))

    def zenith_angles(self, scene: Scene, lines: Iterable[tuple[str, str]]) -> None:
        """Add zenith angles."""
        sigma = self.angle(self.sigma_zenith_arcsec)
        scene.plan.add(*(ZenithAngle(a, b, 0.0, sigma=sigma) for a, b in lines))


@dataclass(frozen=True)
class Level(Parameters):
    """A level: height differences."""

    sigma_mm: float = number(0.0, least=0)
    """Constant part of the standard deviation, mm."""
    mm_per_sqrt_km: float = number(1.0, least=0)
    """Standard deviation of one kilometre of line, mm."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        if self.sigma_mm == 0 and self.mm_per_sqrt_km == 0:
            what = "sigma_mm or mm_per_sqrt_km must be > 0"
            return [Problem(what, path_of(where, "sigma_mm"))]
        return []

    def height_differences(self, scene: Scene, lines: Iterable[tuple[str, str]]) -> None:
        """Add height differences."""
        sigma = StandardDeviation(
            constant=self.sigma_mm * MILLIMETRE, per_sqrt_km=self.mm_per_sqrt_km * MILLIMETRE
        )
        scene.plan.add(*(HeightDifference(a, b, 0.0, sigma=sigma) for a, b in lines))
