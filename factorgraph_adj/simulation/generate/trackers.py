"""Laser trackers or scanners around an object, each in a frame of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import Problem
from ...observations import FrameDirection, FrameDistance, FrameZenith
from ...stochastic import StandardDeviation
from ...units import ARCSEC
from ..parameters import number, path_of
from .part import MILLIMETRE, Part, Scene


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
