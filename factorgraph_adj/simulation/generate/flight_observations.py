"""GNSS positions, INS attitudes and statoscope readings of photos; lakes with points as shores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ...errors import Problem
from ...models.positions import heights
from ...observations import (
    LevelHeight,
    NavigationAttitude,
    PhotoAttitude,
    PhotoPosition,
    ProfileHeight,
)
from ...units import KILOMETRE, MILLIMETRE
from ..parameters import number, path_of
from .photo_blocks import Exposure, Known, drawn, stated, strips_kept
from .scene import Part, Scene

ARM, BORESIGHT = ("x", "y", "z"), ("rx", "ry", "rz")
MILLISECOND = 1e-3
ZERO = (0.0, 0.0, 0.0)
ROUNDS = 3
"""Number of Newton's steps that put a point on a level surface; each squares the error."""


@dataclass(frozen=True)
class Gnss(Part):
    """Positions of an antenna and attitudes of an inertial platform at the exposures of photos.

    Their mount has an arm, which adds to the known lever arm, and a boresight; each strip has a
    shift and drift of its positions, and a turn and its rate of its attitudes. What has neither a
    value nor a standard deviation is zero and held. A shift of positions that is free needs
    control, and the boresight a strip flown back or across.
    """

    kind = "gnss"
    prefix: str = ""
    """Prefix of the names of the mount ``platform``, of drifts ``strip 1, 2, …``, and of ids."""
    parts: tuple[int, ...] = number((), least=0)
    """Earlier parts whose photos take part; empty: all earlier parts."""
    observe: Literal["both", "positions", "attitudes"] = "both"
    """What is observed."""
    sigma_horizontal_mm: float = number(30.0, above=0)
    """Standard deviation of X and of Y of the antenna, mm."""
    sigma_vertical_mm: float = number(50.0, above=0)
    """Standard deviation of Z of the antenna, mm."""
    angles: Literal["omega_phi_kappa", "roll_pitch_heading"] = "omega_phi_kappa"
    """Angles of the attitudes: in the axes of the frame, or from the horizon."""
    sigma_tilt_deg: float = number(0.005, above=0)
    """Standard deviation of the rotations about two axes across the axis of view, degrees."""
    sigma_heading_deg: float = number(0.008, above=0)
    """Standard deviation of the rotation about the axis of view, degrees."""
    without: float = number(0.0, least=0, below=1)
    """Share of the photos of each strip that have no readings."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 1.2)
    """Known vector from the projection centre to the antenna, metres: x right, y up, z back."""
    mount: Known = "free"
    """What is known of the arm and the boresight of the mount."""
    arm: tuple[float, float, float] | None = None
    """True arm that adds to the lever arm, metres; None: drawn."""
    arm_sigma_mm: float = number(0.0, least=0)
    """Standard deviation of the drawing, and of a weighted arm, mm; 0: nothing is drawn."""
    boresight_deg: tuple[float, float, float] | None = None
    """True boresight, the rotation vector of the platform in the camera, degrees; None: drawn."""
    boresight_sigma_deg: float = number(0.2, least=0)
    """Standard deviation of the drawing, and of a weighted boresight, degrees; 0: none is drawn."""
    drifts: Known = "weighted"
    """What is known of shifts, drifts, turns and their rates."""
    shift_mm: float = number(0.0, least=0)
    """Standard deviation of the drawn shift of each strip along X, Y and Z, mm."""
    drift_mm_s: float = number(0.0, least=0)
    """Standard deviation of its drawn drift, mm per second."""
    turn_deg: float = number(0.0, least=0)
    """Standard deviation of the drawn turn of the attitudes of each strip, degrees."""
    turn_rate_deg_s: float = number(0.0, least=0)
    """Standard deviation of its drawn rate, degrees per second."""
    speed: float = number(60.0, above=0)
    """Speed of flight, metres per second."""
    time_error_ms: float | None = None
    """True time error of the shutter, ms, which is a free unknown; None: there is none."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        for given, sigma in (("arm", "arm_sigma_mm"), ("boresight_deg", "boresight_sigma_deg")):
            if self.mount == "weighted" and getattr(self, given) and not getattr(self, sigma):
                what = f"is 0, but {given} is weighted; valid: above 0, or mount free or held"
                found.append(Problem(what, path_of(where, sigma)))
        if self.time_error_ms is not None and self.observe == "attitudes":
            what = "goes with positions, which are not observed"
            found.append(Problem(what, path_of(where, "time_error_ms")))
        return found

    def add_to(self, scene: Scene) -> None:
        """Add the observations and their unknowns; no points."""
        scene.points.append([])
        plan, mount, shutter = scene.plan, f"{self.prefix}platform", None
        strips = strips_kept(scene, self.parts, self.without, scene.rng(0))
        names = [f"{self.prefix}strip {i + 1}" for i in range(len(strips))]
        scene.refuse_used([mount], plan.mounts, "mounts")
        scene.refuse_used(names, {**plan.drifts, **plan.attitude_drifts}, "drifts")
        values, sigma = self._mount(scene.rng(1))
        plan.set_mount(mount, **stated(values, sigma, self.mount))
        if self.time_error_ms is not None:
            shutter = f"{self.prefix}shutter"
            scene.refuse_used([shutter], plan.shutters, "shutters")
            plan.set_shutter(shutter, error=self.time_error_ms * MILLISECOND)
        shifts, turns = scene.rng(2), scene.rng(3)
        for name, strip in zip(names, strips, strict=True):
            # Drawn for every strip, so that a lost one does not change the others.
            drift, sigma_drift = self._positions(shifts)
            turn, sigma_turn = self._attitudes(turns)
            if not strip:
                continue
            if self.drifts == "free" and (self._rates and len(strip) < 2):
                scene.fail("without", f"leaves {name!r} one photo, and its drift is free")
            if self.observe != "attitudes":
                plan.set_drift(name, **stated(drift, sigma_drift, self.drifts))
            if self.observe != "positions":
                plan.set_attitude_drift(name, **stated(turn, sigma_turn, self.drifts))
            for exposure in strip:
                self._observe(scene, exposure, mount, name, shutter)

    @property
    def _rates(self) -> bool:
        """Whether drifts have rates."""
        positions = self.observe != "attitudes" and self.drift_mm_s > 0
        return positions or (self.observe != "positions" and self.turn_rate_deg_s > 0)

    def _mount(self, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
        """Return the true arm and boresight, and their standard deviations, SI."""
        arm = dict.fromkeys(ARM, self.arm_sigma_mm * MILLIMETRE)
        turn = dict.fromkeys(BORESIGHT, float(np.deg2rad(self.boresight_sigma_deg)))
        values = drawn({**turn, **arm}, rng)
        if self.arm is not None:
            values |= dict(zip(ARM, self.arm, strict=True))
        if self.boresight_deg is not None:
            angles = np.deg2rad(self.boresight_deg).tolist()
            values |= dict(zip(BORESIGHT, angles, strict=True))
        # What is not observed cannot be found.
        seen = {"both": (*ARM, *BORESIGHT), "positions": ARM, "attitudes": BORESIGHT}[self.observe]
        return {n: v for n, v in values.items() if n in seen}, {**turn, **arm}

    def _positions(self, rng: np.random.Generator) -> tuple[dict[str, float], Mapping[str, float]]:
        sigma = dict.fromkeys(ARM, self.shift_mm * MILLIMETRE)
        sigma |= {f"{a}_t": self.drift_mm_s * MILLIMETRE for a in ARM}
        return drawn(sigma, rng), sigma

    def _attitudes(self, rng: np.random.Generator) -> tuple[dict[str, float], Mapping[str, float]]:
        sigma = dict.fromkeys(BORESIGHT, float(np.deg2rad(self.turn_deg)))
        sigma |= {f"{a}_t": float(np.deg2rad(self.turn_rate_deg_s)) for a in BORESIGHT}
        return drawn(sigma, rng), sigma

    def _observe(
        self, scene: Scene, at: Exposure, mount: str, drift: str, shutter: str | None
    ) -> None:
        time = at.along / self.speed
        if self.observe != "attitudes":
            velocity = tuple((self.speed * at.direction).tolist())
            moving: dict[str, Any] = {}
            if shutter is not None:
                if not any(velocity):
                    scene.fail("time_error_ms", f"needs strips of two photos, for {at.photo!r}")
                moving = {"shutter": shutter, "velocity": velocity}
            plan, up = self.sigma_horizontal_mm * MILLIMETRE, self.sigma_vertical_mm * MILLIMETRE
            scene.plan.add(
                PhotoPosition(
                    *(at.photo, ZERO),
                    sigma=(plan, plan, up),
                    lever_arm=self.lever_arm,
                    mount=mount,
                    drift=drift,
                    time=time,
                    id=f"{self.prefix}GNSS {at.photo}",
                    **moving,
                )
            )
        if self.observe != "positions":
            kind = PhotoAttitude if self.angles == "omega_phi_kappa" else NavigationAttitude
            tilt, heading = np.deg2rad([self.sigma_tilt_deg, self.sigma_heading_deg]).tolist()
            scene.plan.add(
                kind(
                    *(at.photo, ZERO),
                    sigma=(tilt, tilt, heading),
                    about="body",
                    mount=mount,
                    drift=drift,
                    time=time,
                    id=f"{self.prefix}INS {at.photo}",
                )
            )


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
