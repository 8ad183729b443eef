"""Simulated points on planes, lines, circles, cylinders, spheres; targets that trackers sight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...errors import Problem
from ...models.shapes import SHAPES
from ...observations import (
    ControlPoint,
    FrameDirection,
    FrameDistance,
    FrameZenith,
    OnCircle,
    OnCylinder,
    OnLine,
    OnPlane,
    OnSphere,
)
from ...rotation import exp_rotation
from ...stochastic_model import StandardDeviation
from ...types import Array
from ...units import ARCSEC, MILLIMETRE
from ..parameters import number, path_of
from .scene import Part, Scene

Form = Literal["plane", "line", "circle", "cylinder", "sphere"]
KINDS = {
    "plane": OnPlane,
    "line": OnLine,
    "circle": OnCircle,
    "cylinder": OnCylinder,
    "sphere": OnSphere,
}
LEAST_POINTS = 7
"""Number of points with which each shape is determined and has a redundancy."""


@dataclass(frozen=True)
class Shapes(Part):
    """Shapes side by side along X, and points on them: walls, rails, pipes, target spheres.

    Points lie on their shape exactly; the error of its form, with the tolerance as standard
    deviation, is in the reading of their distance from it. An adjustment that finds the axis of a
    plane, line or circle the other way round has other readings of the same distribution. Points
    have measured coordinates if ``measured_mm`` is given; otherwise later parts observe them, such
    as photos ``of_parts``.
    """

    kind = "shapes"
    prefix: str = ""
    """Prefix of the names of shapes ``plane 1``, and of points ``plane 1/1, 2, …``."""
    shapes: tuple[Form, ...] = ("plane", "cylinder", "sphere")
    """The shapes, numbered from 1."""
    count: int = number(16, least=LEAST_POINTS)
    """Number of points on each."""
    tolerance_mm: float = number(1.0, above=0)
    """Standard deviation of the distance of a point from its shape, mm."""
    radius: float = number(1.0, above=0)
    """Radius of circles, cylinders and spheres, half the length of planes and lines, metres."""
    height: float = number(2.0, above=0)
    """Length of cylinders, metres."""
    arc_deg: float = number(360.0, above=0, most=360)
    """Arc on which circles, cylinders and spheres have points, degrees."""
    tilt_deg: float = number(10.0, least=0, most=60)
    """Standard deviation of each of the two tilts of a shape, degrees."""
    spacing: float = number(4.0, above=0)
    """Distance of the middles of the shapes, metres."""
    measured_mm: float | None = number(None, above=0)
    """Standard deviation of measured X, Y and Z of the points, mm; None: not measured."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        if not self.shapes:
            return [Problem("there are none; valid: one or more", path_of(where, "shapes"))]
        return []

    def add_to(self, scene: Scene) -> None:
        """Add the shapes, their points and observations."""
        added = [p for i, form in enumerate(self.shapes) for p in self._add_shape(scene, i, form)]
        if self.measured_mm is not None:
            sigma = (self.measured_mm * MILLIMETRE,) * 3
            for point, x in zip(added, scene.coordinates(added).tolist(), strict=True):
                scene.plan.add(ControlPoint(point, tuple(x), sigma=sigma, id=f"measured {point}"))
        scene.points.append(added)

    def _add_shape(self, scene: Scene, i: int, form: Form) -> list[str]:
        """Add the shape of a number; return its points."""
        plan, rng = scene.plan, scene.rng(i)
        name, record = f"{self.prefix}{form} {i + 1}", SHAPES[form]
        scene.refuse_used([name], {**plan.frames, **plan.sizes}, "shapes")
        tilts = rng.standard_normal(2) * np.deg2rad(self.tilt_deg)
        given = (*tilts.tolist(), *rng.uniform(-0.1, 0.1, 3).tolist())
        values = dict(zip(("rx", "ry", "x", "y", "z"), given, strict=True))
        values = {n: v for n, v in values.items() if n in record.free}
        turn = np.array([[values.get("rx", 0.0), values.get("ry", 0.0), 0.0]])
        offset = np.array([values.get(axis, 0.0) for axis in "xyz"])
        origin = np.array([i * self.spacing, 0.0, 0.0])
        on = origin + (PLACES[form](self, rng) + offset) @ exp_rotation(turn)[0].T
        points = scene.add_points(f"{name}/", [f"{k + 1}" for k in range(len(on))], on)
        if any(size.suffix == "" for size in record.sizes):
            plan.set_size(name, self.radius)
        plan.add_shape(name, form, origin=origin.tolist(), values=values)
        sigma = self.tolerance_mm * MILLIMETRE
        plan.add(*(KINDS[form](name, p, sigma=sigma, id=f"{p} on {name}") for p in points))
        return points

    def angles(self, rng: np.random.Generator) -> Array:
        """Return angles on the arc, spread evenly and jittered, (n,) radians."""
        place = (np.arange(self.count) + rng.uniform(0.2, 0.8, self.count)) / self.count
        return np.asarray(np.deg2rad(self.arc_deg) * rng.permutation(place))

    def spread(self, rng: np.random.Generator, length: float) -> Array:
        """Return places from −length/2 to length/2, spread evenly and jittered, (n,) metres."""
        place = (np.arange(self.count) + rng.uniform(0.2, 0.8, self.count)) / self.count
        return np.asarray(length * (place - 0.5))


def _plane(part: Shapes, rng: np.random.Generator) -> Array:
    x = part.spread(rng, 2 * part.radius)
    y = rng.permutation(part.spread(rng, 2 * part.radius))
    return np.column_stack([x, y, np.zeros_like(x)])


def _line(part: Shapes, rng: np.random.Generator) -> Array:
    z = part.spread(rng, 2 * part.radius)
    return np.column_stack([np.zeros((len(z), 2)), z])


def _circle(part: Shapes, rng: np.random.Generator) -> Array:
    turn = part.angles(rng)
    return np.column_stack(
        [part.radius * np.cos(turn), part.radius * np.sin(turn), np.zeros_like(turn)]
    )


def _cylinder(part: Shapes, rng: np.random.Generator) -> Array:
    places = _circle(part, rng)
    places[:, 2] = part.spread(rng, part.height)
    return places


def _sphere(part: Shapes, rng: np.random.Generator) -> Array:
    turn, up = part.angles(rng), part.spread(rng, 2.0)
    flat = np.sqrt(1.0 - up**2)
    return np.asarray(part.radius * np.column_stack([flat * np.cos(turn), flat * np.sin(turn), up]))


PLACES: dict[str, Callable[[Shapes, np.random.Generator], Array]] = {
    "plane": _plane,
    "line": _line,
    "circle": _circle,
    "cylinder": _cylinder,
    "sphere": _sphere,
}
"""Places of points on each shape in its own axes, (n, 3) metres."""


@dataclass(frozen=True)
class Trackers(Part):
    """Instruments on a ring around an object, and targets on it that they sight.

    Each sight is a direction, a zenith angle and a distance. A tracker that is not levelled has six
    unknowns, a levelled one four.
    """

    kind = "trackers"
    prefix: str = ""
    """Prefix of the names of targets ``M1, M2, …`` and of frames ``T1, T2, …``."""
    instruments: int = number(4, least=1)
    """Number of instruments."""
    distance: float = number(6.0, above=0)
    """Radius of their ring, metres."""
    level: bool = False
    """Whether they are levelled."""
    targets: int = number(40, least=3)
    """Number of targets, on the sides of a cylinder."""
    radius: float = number(2.5, above=0)
    """Radius of the object, metres."""
    height: float = number(3.0, above=0)
    """Height of the object, metres."""
    hidden: float = number(0.25, least=0, below=1)
    """Share of the targets that an instrument does not see."""
    sigma_angle_arcsec: float = number(1.0, above=0)
    """Standard deviation of directions and zenith angles, arc seconds."""
    centring_mm: float = number(0.01, least=0)
    """Standard deviation of the centring of a reflector, mm."""
    sigma_distance_mm: float = number(0.01, above=0)
    """Constant part of the standard deviation of distances, mm."""
    ppm: float = number(0.4, least=0)
    """Part proportional to the distance, 1e-6."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        if self.distance <= self.radius:
            what = f"is {self.distance:g} m, within the object; valid: above {self.radius:g} m"
            found.append(Problem(what, path_of(where, "distance")))
        if round((1.0 - self.hidden) * self.targets) < 3:
            what = "leaves less than three targets to an instrument"
            found.append(Problem(what, path_of(where, "hidden")))
        return found

    def add_to(self, scene: Scene) -> None:
        """Add points, frames and observations."""
        rng = scene.rng(0)
        place = np.arange(self.targets)
        angle = place * np.pi * (3 - np.sqrt(5.0))  # a spiral: all heights and sides have some
        up = self.height * (place + 0.5) / self.targets
        on = np.column_stack([self.radius * np.cos(angle), self.radius * np.sin(angle), up])
        names = scene.add_points(
            self.prefix, [f"M{i + 1}" for i in place.tolist()], np.round(on, 4)
        )
        scene.points.append(names)
        angles = StandardDeviation(
            constant=self.sigma_angle_arcsec * ARCSEC,
            centring_target=self.centring_mm * MILLIMETRE,
        )
        lengths = StandardDeviation(constant=self.sigma_distance_mm * MILLIMETRE, ppm=self.ppm)
        free = ("rz", "x", "y", "z") if self.level else ("rx", "ry", "rz", "x", "y", "z")
        kept = round((1.0 - self.hidden) * self.targets)
        for k in range(self.instruments):
            turn = 2 * np.pi * (k + 0.3 * rng.random()) / self.instruments
            at = [np.cos(turn), np.sin(turn), rng.uniform(0.1, 0.4)]
            origin = np.round(self.distance * np.array(at), 1)
            values = dict(zip("xyz", rng.uniform(-0.04, 0.04, 3).tolist(), strict=True))
            tilts = rng.uniform(-0.2, 0.2, 2).tolist()
            values["rz"] = float(rng.uniform(-3.0, 3.0))
            if not self.level:
                values |= {"rx": tilts[0], "ry": tilts[1]}
            name = f"{self.prefix}T{k + 1}"
            if name in scene.plan.frames:
                scene.fail("prefix", f"a frame {name!r} exists already in an earlier part")
            scene.plan.add_frame(
                name, free=free, values=values, origin=tuple(origin.tolist()), level=self.level
            )
            for i in sorted(rng.permutation(self.targets)[:kept].tolist()):
                scene.plan.add(
                    FrameDirection(name, names[i], 0.0, sigma=angles),
                    FrameZenith(name, names[i], 1.0, sigma=angles),
                    FrameDistance(name, names[i], 1.0, sigma=lengths),
                )
