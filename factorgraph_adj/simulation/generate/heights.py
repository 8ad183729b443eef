"""Heights from the air pressure at exposures, and from the shore of a lake."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import Problem
from ...models.height import heights
from ...observations import LevelHeight, ProfileHeight
from ..parameters import number, path_of
from .flown import Known, drawn, stated, strips_kept
from .part import Part, Scene

KILOMETRE = 1e3
ROUNDS = 3
"""Number of Newton's steps that put a point on a level surface; each squares the error."""


@dataclass(frozen=True)
class Statoscope(Part):
    """Readings of a statoscope at the exposures of photos, with one height profile to each strip.

    The profile counts from the middle of the strip, in kilometres in the direction of flight.
    """

    kind = "statoscope"
    prefix: str = ""
    """Prefix of the names of the profiles ``profile 1, 2, …``, and of ids."""
    parts: tuple[int, ...] = number((), least=0)
    """Earlier parts whose photos take part; empty: all earlier parts."""
    sigma: float = number(0.3, above=0)
    """Standard deviation of a reading, metres."""
    without: float = number(0.0, least=0, below=1)
    """Share of the photos of each strip that have no readings."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Known vector from the projection centre to the instrument, metres."""
    profiles: Known = "free"
    """What is known of the profiles."""
    height: float = number(20.0, above=0)
    """Standard deviation of the drawn height of the surface of each profile, metres."""
    slope: float = number(0.0, least=0)
    """Standard deviation of its drawn slope, metres per kilometre; 0: it is level."""
    bend: float = number(0.0, least=0)
    """Standard deviation of its drawn bend, metres per kilometre²; 0: none."""
    scale_ppm: float = number(0.0, least=0)
    """Standard deviation of the drawn scale of its readings, 1e-6; 0: none."""

    def add_to(self, scene: Scene) -> None:
        """Add the readings and the profiles; no points."""
        scene.points.append([])
        strips = strips_kept(scene, self.parts, self.without, scene.rng(0))
        names = [f"{self.prefix}profile {i + 1}" for i in range(len(strips))]
        scene.refuse_used(names, scene.plan.profiles, "profiles")
        given = (self.height, self.slope, self.bend, 1e-6 * self.scale_ppm)
        sigma = dict(zip(("height", "height_t", "height_tt", "scale"), given, strict=True))
        rng = scene.rng(1)
        for name, strip in zip(names, strips, strict=True):
            true = drawn(sigma, rng)
            if not strip:
                continue
            if self.profiles == "free" and len(strip) < len(true):
                what = f"leaves {name!r} {len(strip)} photos for {len(true)} free unknowns"
                scene.fail("without", what)
            scene.plan.set_profile(name, **stated(true, sigma, self.profiles))
            scene.plan.add(
                *(
                    ProfileHeight(
                        *(None, 0.0),
                        photo=at.photo,
                        sigma=self.sigma,
                        profile=name,
                        time=at.along / KILOMETRE,
                        lever_arm=self.lever_arm,
                        id=f"{self.prefix}statoscope {at.photo}",
                    )
                    for at in strip
                )
            )


@dataclass(frozen=True)
class Lake(Part):
    """A lake: points of earlier parts are moved to its level, as points of its shore.

    They are the points nearest to its middle that have no known coordinates of their own.
    """

    kind = "lake"
    name: str = "lake"
    """Name of the level surface, and prefix of ids."""
    parts: tuple[int, ...] = number((), least=0)
    """Earlier parts whose points may be on the shore; empty: all earlier parts."""
    count: int = number(8, least=1)
    """Number of points on the shore."""
    middle: tuple[float, float] = number((0.5, 0.5), least=0, most=1)
    """Middle of the lake along X and Y, as fractions of the extent of the points."""
    height: float | None = None
    """True height of the water, metres; None: the mean height of its points."""
    sigma: float = number(0.1, above=0)
    """Standard deviation of the height of a point above the water, metres."""
    level: Known = "free"
    """What is known of the height of the water."""
    level_sigma: float = number(0.1, above=0)
    """Standard deviation of the height of the water where it is weighted, metres."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        if not self.name:
            found.append(Problem("must not be empty", path_of(where, "name")))
        if self.level == "free" and self.count < 2:
            what = "is 1, which only determines the height of the water; valid: 2 or more"
            found.append(Problem(what, path_of(where, "count")))
        return found

    def add_to(self, scene: Scene) -> None:
        """Move the points and add the observations; no points of its own."""
        scene.points.append([])
        plan = scene.plan
        if self.name in plan.levels:
            scene.fail("name", f"a level surface {self.name!r} exists already in an earlier part")
        names = [n for n in scene.points_of(self.parts) if not any(plan.points[n].fixed)]
        if len(names) < self.count:
            what = f"is {self.count}, but {len(names)} points are not held; valid: up to that"
            scene.fail("count", what)
        xyz = scene.coordinates(names)
        low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
        away = np.linalg.norm(xyz[:, :2] - low - np.array(self.middle) * (high - low), axis=1)
        shore = np.sort(np.argsort(away, kind="stable")[: self.count])
        x = xyz[shore]
        water = self.height
        if water is None:
            water = round(float(heights(plan.frame, x)[0].mean()), 2)
        for _ in range(ROUNDS):
            h, gradient = heights(plan.frame, x)
            square = np.sum(gradient**2, axis=1, keepdims=True)
            x = x + (water - h)[:, None] * gradient / square
        sigma = self.level_sigma if self.level == "weighted" else None
        plan.set_level(self.name, water, sigma=sigma, fixed=self.level == "held")
        for i, at in zip(shore.tolist(), x.tolist(), strict=True):
            point = plan.points[names[i]]
            plan.points[point.name] = replace(point, coordinates=tuple(at))
            plan.add(
                LevelHeight(point.name, self.name, sigma=self.sigma, id=f"{self.name} {point.name}")
            )
