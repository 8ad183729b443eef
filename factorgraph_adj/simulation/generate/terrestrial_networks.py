"""Terrestrial networks: traverse, triangulation grid, levelling loops, monitoring of an object."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np

from ...errors import Problem
from ...types import Array
from ..parameters import number, path_of
from .scene import Part, Scene
from .terrestrial_additions import Level, TotalStation

Line = tuple[str, str]
Heights = Literal["zenith", "levelled", "none"]
"""Measurement of heights; ``none`` holds every Z and gives a network in the plane."""


@dataclass(frozen=True)
class Traverse(Part):
    """A traverse: directions and distances from each station to the previous and next one."""

    kind = "traverse"
    prefix: str = ""
    """Prefix of the names of points ``T1, T2, …``."""
    legs: int = number(8, least=2)
    """Number of sides."""
    length: float = number(100.0, above=0)
    """Length of a side, metres."""
    shape: Literal["line", "loop"] = "line"
    """A line along X, or a closed polygon."""
    bend_deg: float = number(10.0, least=0, most=60)
    """Largest angle between the sides of a line and X, degrees."""
    relief: float = number(3.0, least=0)
    """Largest height above and below zero, metres."""
    both_ways: bool = True
    """Whether distances and zenith angles are measured in both directions."""
    heights: Heights = "zenith"
    """Measurement of heights."""
    instrument: TotalStation = field(default_factory=TotalStation)
    """The total station."""
    level: Level = field(default_factory=Level)
    """The level."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        if self.shape == "loop" and self.legs < 3:
            return [Problem("a loop has at least 3 legs", path_of(where, "legs"))]
        return []

    def add_to(self, scene: Scene) -> None:
        """Add points and observations."""
        rng = scene.rng(0)
        if self.shape == "loop":
            radius = self.length / (2 * np.sin(np.pi / self.legs))
            turn = 2 * np.pi * np.arange(self.legs) / self.legs
            xy = radius * np.column_stack([np.cos(turn), np.sin(turn)])
        else:
            bend = np.deg2rad(self.bend_deg) * rng.uniform(-1.0, 1.0, self.legs)
            steps = self.length * np.column_stack([np.cos(bend), np.sin(bend)])
            xy = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        names = _add_points(scene, self.prefix, "T", xy, self.relief, self.heights, rng)
        lines = list(pairwise(names))
        if self.shape == "loop":
            lines.append((names[-1], names[0]))
        _sight(scene, self, lines, both_ways=self.both_ways)


@dataclass(frozen=True)
class TriangulationGrid(Part):
    """A grid of stations, each sighting its neighbours along the grid and across its cells."""

    kind = "triangulation_grid"
    prefix: str = ""
    """Prefix of the names of points ``G1, G2, …``, column by column."""
    columns: int = number(4, least=2)
    """Stations along X."""
    rows: int = number(4, least=2)
    """Stations along Y."""
    spacing: float = number(500.0, above=0)
    """Distance between neighbours, metres."""
    relief: float = number(20.0, least=0)
    """Largest height above and below zero, metres."""
    observe: Literal["directions", "distances", "both"] = "both"
    """Observations in plan."""
    heights: Heights = "zenith"
    """Measurement of heights."""
    instrument: TotalStation = field(default_factory=TotalStation)
    """The total station."""
    level: Level = field(default_factory=Level)
    """The level."""

    def add_to(self, scene: Scene) -> None:
        """Add points and observations."""
        rng = scene.rng(0)
        xy, lines = _grid(self.columns, self.rows, self.spacing, diagonals=True)
        xy = xy + rng.uniform(-0.15, 0.15, xy.shape) * self.spacing
        names = _add_points(scene, self.prefix, "G", xy, self.relief, self.heights, rng)
        _sight(
            scene,
            self,
            [(names[i], names[j]) for i, j in lines],
            both_ways=False,
            directions=self.observe != "distances",
            distances=self.observe != "directions",
        )


@dataclass(frozen=True)
class LevellingLoops(Part):
    """Loops of levelling along the lines of a grid; X and Y are held."""

    kind = "levelling_loops"
    prefix: str = ""
    """Prefix of the names of points ``L1, L2, …``, column by column."""
    columns: int = number(3, least=1)
    """Loops along X."""
    rows: int = number(2, least=1)
    """Loops along Y."""
    spacing: float = number(1000.0, above=0)
    """Length of a line, metres."""
    relief: float = number(20.0, least=0)
    """Largest height above and below zero, metres."""
    level: Level = field(default_factory=Level)
    """The level."""

    def add_to(self, scene: Scene) -> None:
        """Add points and observations."""
        xy, lines = _grid(self.columns + 1, self.rows + 1, self.spacing, diagonals=False)
        z = scene.rng(0).uniform(-self.relief, self.relief, len(xy))
        points = np.asarray(np.round(np.column_stack([xy, z]), 3), dtype=float)
        names = scene.add_points(self.prefix, _numbered("L", len(xy)), points, fixed="xy")
        scene.points.append(names)
        self.level.height_differences(scene, [(names[i], names[j]) for i, j in lines])


@dataclass(frozen=True)
class Monitoring(Part):
    """Pillars around an object and targets on it: directions in sets, zenith angles, distances.

    Every pillar sights all other pillars, and the targets on its side of the object.
    """

    kind = "monitoring"
    prefix: str = ""
    """Prefix of the names of pillars ``S1, S2, …`` and targets ``M1, M2, …``."""
    pillars: int = number(4, least=2)
    """Number of pillars, on a ring."""
    distance: float = number(60.0, above=0)
    """Radius of the ring, metres."""
    targets: int = number(16, least=1)
    """Number of targets, on the sides of a cylinder."""
    radius: float = number(10.0, above=0)
    """Radius of the object, metres."""
    height: float = number(20.0, above=0)
    """Height of the object, metres."""
    sets: int = number(2, least=1)
    """Number of sets of directions from each pillar, each set with its own orientation unknown, and
    number of repetitions of zenith angles and distances."""
    instrument: TotalStation = field(
        default_factory=lambda: TotalStation(
            sigma_direction_arcsec=1.0, sigma_zenith_arcsec=1.5, centring_mm=0.1
        )
    )
    """The total station."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        if self.distance <= self.radius:
            what = f"is {self.distance:g} m, within the object; valid: above {self.radius:g} m"
            return [Problem(what, path_of(where, "distance"))]
        return []

    def add_to(self, scene: Scene) -> None:
        """Add points and observations."""
        rng = scene.rng(0)
        turn = 2 * np.pi * (np.arange(self.pillars) + 0.3 * rng.random(self.pillars)) / self.pillars
        at = np.column_stack([np.cos(turn), np.sin(turn)]) * self.distance
        at = np.column_stack([at, rng.uniform(0.0, 0.1, self.pillars) * self.height])
        pillars = scene.add_points(self.prefix, _numbered("S", self.pillars), np.round(at, 3))
        # The targets follow a spiral around the object, so that all heights and sides have some.
        place = np.arange(self.targets)
        angle = place * np.pi * (3 - np.sqrt(5.0))
        up = self.height * (place + 0.5) / self.targets
        on = np.column_stack([self.radius * np.cos(angle), self.radius * np.sin(angle), up])
        targets = scene.add_points(self.prefix, _numbered("M", self.targets), np.round(on, 3))
        scene.points.append(pillars + targets)
        seen = self._seen(at, on)
        for i, pillar in enumerate(pillars):
            marks = [p for p in pillars if p != pillar]
            marks += [targets[j] for j in np.flatnonzero(seen[i])]
            for _ in range(self.sets):
                _station(scene, self.instrument, pillar, marks)

    def _seen(self, at: Array, on: Array) -> Array:
        """Return the mask (n, m) of targets that pillars sight; each has at least two pillars."""
        cosine = at[:, :2] @ on[:, :2].T / (self.distance * self.radius)
        seen = cosine > self.radius / self.distance
        for j in np.flatnonzero(seen.sum(axis=0) < 2):
            # A target that faces one pillar only is assumed to stand out, so two pillars sight it.
            seen[np.argsort(cosine[:, j])[-2:], j] = True
        return np.asarray(seen)


def _numbered(letter: str, n: int) -> list[str]:
    return [f"{letter}{i}" for i in range(1, n + 1)]


def _grid(
    columns: int, rows: int, spacing: float, *, diagonals: bool
) -> tuple[Array, list[tuple[int, int]]]:
    """Return X, Y (n, 2) of a grid, column by column, and the lines between neighbours."""
    at = [(c, r) for c in range(columns) for r in range(rows)]
    steps = [(1, 0), (0, 1)] + ([(1, 1), (1, -1)] if diagonals else [])
    number_of = {place: i for i, place in enumerate(at)}
    lines = [
        (i, number_of[c + dc, r + dr])
        for i, (c, r) in enumerate(at)
        for dc, dr in steps
        if (c + dc, r + dr) in number_of
    ]
    return spacing * np.array(at, dtype=float), lines


def _add_points(
    scene: Scene,
    prefix: str,
    letter: str,
    xy: Array,
    relief: float,
    heights: Heights,
    rng: np.random.Generator,
) -> list[str]:
    """Add the stations of a network; Z is held if no heights are measured."""
    z = rng.uniform(-relief, relief, len(xy))
    points = np.asarray(np.round(np.column_stack([xy, z]), 3), dtype=float)
    fixed = "z" if heights == "none" else ""
    names = scene.add_points(prefix, _numbered(letter, len(xy)), points, fixed=fixed)
    scene.points.append(names)
    return names


def _sight(
    scene: Scene,
    part: Traverse | TriangulationGrid,
    lines: list[Line],
    *,
    both_ways: bool,
    directions: bool = True,
    distances: bool = True,
) -> None:
    """Measure lines: directions from both ends, distances, heights."""
    back = [(b, a) for a, b in lines]
    if directions:
        targets: dict[str, list[str]] = {}
        for a, b in lines + back:
            targets.setdefault(a, []).append(b)
        for station, marks in targets.items():
            part.instrument.directions(scene, station, marks)
    sights = lines + back if both_ways else lines
    if distances:
        part.instrument.distance_meter.distances(scene, sights, "instrument.distance_meter")
    if part.heights == "zenith":
        part.instrument.zenith_angles(scene, sights)
    if part.heights == "levelled":
        part.level.height_differences(scene, lines)


def _station(scene: Scene, instrument: TotalStation, station: str, marks: list[str]) -> None:
    """Measure a set of directions with zenith angles and distances to the same marks."""
    lines = [(station, m) for m in marks]
    instrument.directions(scene, station, marks)
    instrument.zenith_angles(scene, lines)
    instrument.distance_meter.distances(scene, lines, "instrument.distance_meter")
