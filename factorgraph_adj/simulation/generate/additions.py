"""Terrestrial observations added to points of earlier parts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...errors import InputError, Problem, known
from ...frames import LocalFrame
from ...observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    VerticalAngle,
)
from ...units import ARCSEC
from ..parameters import number, path_of
from .instruments import DistanceMeter, Level, TotalStation
from .part import Part, Scene
from .patterns import nearest_lines, perimeter, round_lines

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
            f"unknown point {name!r}; known: {known(names, meant=name)}",
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
