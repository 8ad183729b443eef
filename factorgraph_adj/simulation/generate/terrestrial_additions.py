"""Simulated instruments; terrestrial observations of one kind between points of earlier parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...errors import InputError, Problem, unknown_name
from ...frames import LocalFrame
from ...observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    Direction,
    HeightDifference,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from ...stochastic_model import StandardDeviation
from ...units import ARCSEC, MILLIMETRE
from ..parameters import Parameters, number, path_of
from .scene import Part, Scene, nearest_lines, perimeter, round_lines


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


Line = tuple[str, str]
Between = Literal["perimeter", "nearest", "given"]


@dataclass(frozen=True)
class Additions(Part):
    """Base of observations of one kind between points of earlier parts.

    Lines between them:

    - ``perimeter``: along the edge, evenly spread if there are fewer lines than points on the
      edge; further lines join every second point of the edge;
    - ``nearest``: from every point to its nearest one, then the shortest other lines;
    - ``given``: the lines in ``lines``.
    """

    parts: tuple[int, ...] = number((), least=0)
    """Earlier parts whose points take part; empty: all earlier parts."""
    between: Between = "perimeter"
    """Choice of the lines between points."""
    count: int = number(24, least=0)
    """Number of lines or stations; ignored for ``given``."""
    lines: tuple[tuple[str, str], ...] = ()
    """Pairs of points, for ``given``."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        if (self.between == "given") != bool(self.lines):
            what = "goes with between = 'given', which needs it"
            return [Problem(what, path_of(where, "lines"))]
        return [
            Problem("joins a point to itself", path_of(path_of(where, "lines"), i))
            for i, (a, b) in enumerate(self.lines)
            if a == b
        ]

    def add_to(self, scene: Scene) -> None:
        """Add the observations; no points."""
        chosen = self.chosen(scene)
        scene.points.append([])
        self.observe(scene, chosen)

    def observe(self, scene: Scene, lines: list[Line]) -> None:
        """Add the observations of the lines."""
        raise NotImplementedError

    def chosen(self, scene: Scene) -> list[Line]:
        """Return the lines between the points of the earlier parts."""
        names = scene.points_of(self.parts)
        if self.between == "given":
            _check_names(scene, self.lines, names)
            return list(self.lines)
        xyz = scene.coordinates(names)
        if self.between == "nearest":
            lines = nearest_lines(xyz, self.count)
        else:
            ring = perimeter(xyz[:, :2])
            lines = [(ring[i], ring[j]) for i, j in round_lines(len(ring), self.count)]
        if len(lines) < self.count:
            scene.fail(
                "count",
                f"is {self.count}, but there are only {len(lines)} lines; valid: up to that",
            )
        return [(names[i], names[j]) for i, j in lines]


def _check_names(scene: Scene, lines: tuple[Line, ...], names: list[str]) -> None:
    valid = set(names)
    problems = [
        Problem(
            unknown_name("point", name, names),
            path_of(path_of(scene.where, "lines"), i),
        )
        for i, line in enumerate(lines)
        for name in line
        if name not in valid
    ]
    if problems:
        raise InputError(problems)


@dataclass(frozen=True)
class Distances(Additions):
    """Slope distances."""

    kind = "distances"
    distance_meter: DistanceMeter = field(default_factory=DistanceMeter)
    """The distance meter or tape."""

    def observe(self, scene: Scene, lines: list[Line]) -> None:
        """Add them."""
        self.distance_meter.distances(scene, lines, "distance_meter")


@dataclass(frozen=True)
class HeightDifferences(Additions):
    """Levelled height differences."""

    kind = "height_differences"
    level: Level = field(default_factory=Level)
    """The level."""

    def observe(self, scene: Scene, lines: list[Line]) -> None:
        """Add them."""
        self.level.height_differences(scene, lines)


@dataclass(frozen=True)
class Directions(Additions):
    """Directions: one set on each station; both ends of a line sight each other.

    A station with one line has one direction, which only determines its orientation unknown.
    """

    kind = "directions"
    instrument: TotalStation = field(default_factory=TotalStation)
    """The theodolite."""

    def observe(self, scene: Scene, lines: list[Line]) -> None:
        """Add them."""
        targets: dict[str, list[str]] = {}
        for a, b in lines:
            targets.setdefault(a, []).append(b)
            targets.setdefault(b, []).append(a)
        for station, marks in targets.items():
            self.instrument.directions(scene, station, list(dict.fromkeys(marks)))


@dataclass(frozen=True)
class Azimuths(Additions):
    """Azimuths."""

    kind = "azimuths"
    sigma_arcsec: float = number(2.0, above=0)
    """Standard deviation, arc seconds."""

    def observe(self, scene: Scene, lines: list[Line]) -> None:
        """Add them."""
        scene.plan.add(*(Azimuth(a, b, 0.0, sigma=self.sigma_arcsec * ARCSEC) for a, b in lines))


@dataclass(frozen=True)
class VerticalAngles(Additions):
    """Vertical angles."""

    kind = "vertical_angles"
    sigma_arcsec: float = number(3.0, above=0)
    """Standard deviation, arc seconds."""

    def observe(self, scene: Scene, lines: list[Line]) -> None:
        """Add them."""
        sigma = self.sigma_arcsec * ARCSEC
        scene.plan.add(*(VerticalAngle(a, b, 0.0, sigma=sigma) for a, b in lines))


@dataclass(frozen=True)
class Astronomic(Additions):
    """Astronomic latitude and longitude of stations, in a frame on a curved Earth.

    The stations are ``count`` points, evenly spread along the edge or from the first name on; for
    ``given`` they are the points of ``lines``. The deflection of the vertical of each station is
    drawn, and weighted with the standard deviation of the drawing; without deflections, the
    plumb line is the normal of the ellipsoid.
    """

    kind = "astronomic"
    sigma_arcsec: float = number(0.5, above=0)
    """Standard deviation, arc seconds."""
    deflection_arcsec: float = number(5.0, least=0)
    """Standard deviation of the deflections, arc seconds; 0: no deflections."""

    def add_to(self, scene: Scene) -> None:
        """Add the observations; no points."""
        if isinstance(scene.plan.frame, LocalFrame):
            scene.fail(
                "kind",
                "astronomic latitude and longitude need earth.frame = 'topocentric', not 'local'",
            )
        stations = self._stations(scene)
        scene.points.append([])
        rng, sigma = scene.rng(0), self.sigma_arcsec * ARCSEC
        deflection = self.deflection_arcsec * ARCSEC
        for station in stations:
            xi, eta = deflection * rng.standard_normal(2)
            if deflection > 0 and station not in scene.plan.verticals:
                scene.plan.set_vertical(station, xi=xi, eta=eta, sigma=deflection)
            scene.plan.add(
                AstronomicLatitude(station, 0.0, sigma=sigma),
                AstronomicLongitude(station, 0.0, sigma=sigma),
            )

    def _stations(self, scene: Scene) -> list[str]:
        names = scene.points_of(self.parts)
        if self.between == "given":
            _check_names(scene, self.lines, names)
            return list(dict.fromkeys(name for line in self.lines for name in line))
        if self.between == "perimeter":
            names = [names[i] for i in perimeter(scene.coordinates(names)[:, :2])]
        if self.count > len(names):
            what = f"is {self.count}, but there are {len(names)} points; valid: up to that"
            scene.fail("count", what)
        return [names[int(i)] for i in np.arange(self.count) * len(names) // max(1, self.count)]
