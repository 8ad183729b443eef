"""Blocks of photos: vertical ones in strips and cross strips, convergent ones around an object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ...errors import Problem
from ...rotation import world_R_camera
from ...types import Array
from ..measurement import look_at
from ..parameters import number, path_of
from .scene import Camera, Part, Scene, add_photo, jittered_grid

END_COLUMN = 0.5
"""Position of von Gruber's points of the end photos, as a fraction of the way from the nadir to the
edge of the neighbouring photo; points half-way stay in the photo in spite of tilts."""
SEAM = 0.45
"""Distance of the outer points of the outer strips from the nadir, fraction of a photo's side."""
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation by 90° about the axis of the camera."""


@dataclass(frozen=True)
class Aerial(Part):
    """A block of vertical photos: strips along X, every second one flown backwards.

    Points in fewer than two photos are left out. Patterns of points:

    - ``grid``: a jittered grid; ``random``: random positions; both with about ``points_per_photo``;
    - ``von_gruber``: 3 × 3 points in each photo, at the nadirs of the strip's photos and between
      strips; the end photos, which have a neighbour on one side only, have their third column in
      the overlap, where the second photo sees it too.
    """

    kind = "aerial"
    prefix: str = ""
    """Prefix of the names of points ``1, 2, …`` and of photos ``strip/place``."""
    strips: int = number(3, least=1)
    """Number of strips."""
    photos_per_strip: int = number(6, least=1)
    """Number of photos in each strip."""
    forward_overlap: float = number(0.6, least=0, below=1)
    """Overlap along the strips, as a fraction of the photo's side."""
    side_overlap: float = number(0.2, least=0, below=1)
    """Overlap of neighbouring strips, as a fraction of the photo's side."""
    scale: float | None = number(None, above=0)
    """Denominator of the photo scale; 5000 if neither scale nor height is given."""
    flying_height: float | None = number(None, above=0)
    """Height above the terrain, metres, instead of ``scale``."""
    camera: Camera = field(default_factory=Camera)
    """The camera."""
    relief: float = number(10.0, least=0)
    """Largest height of a point above and below zero, metres."""
    centre_scatter: float = number(0.03, least=0, most=0.5)
    """Scatter of the projection centres, as a fraction of the base."""
    tilt_deg: float = number(1.0, least=0, most=20)
    """Standard deviation of each angle of a photo, degrees."""
    points: Literal["grid", "von_gruber", "random"] = "grid"
    """Pattern of the points."""
    points_per_photo: int = number(30, least=4)
    """Approximate number of points in a photo; ignored for ``von_gruber``."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        if self.scale is not None and self.flying_height is not None:
            found.append(
                Problem("give either scale or flying_height", path_of(where, "flying_height"))
            )
        along = self.forward_overlap >= 0.5 and self.photos_per_strip > 1
        across = self.side_overlap >= 0.5 and self.strips > 1
        if not (along or across):
            if self.photos_per_strip == 1:
                key, what = "photos_per_strip", "1 photo in a strip leaves"
            else:
                key, what = "forward_overlap", f"{self.forward_overlap:g} leaves"
            found.append(
                Problem(
                    f"{what} points with one ray; valid: forward_overlap ≥ 0.5 with 2 photos in a "
                    "strip, or side_overlap ≥ 0.5 with 2 strips",
                    path_of(where, key),
                )
            )
        if self.relief > 0.3 * self.height:
            found.append(
                Problem(
                    f"is {self.relief:g} m, but the photos are only {self.height:g} m up; valid: "
                    "up to 0.3 of that",
                    path_of(where, "relief"),
                )
            )
        return found

    @property
    def height(self) -> float:
        """Flying height above Z = 0, metres."""
        if self.flying_height is not None:
            return self.flying_height
        return (self.scale or 5000.0) * self.camera.c_mm * 1e-3

    @property
    def side(self) -> Array:
        """Width and height of a photo on the ground, metres, (2,)."""
        return self.height / self.camera.c_mm * np.array(self.camera.format_mm)

    @property
    def base(self) -> Array:
        """Distances between photos of a strip and between strips, metres, (2,)."""
        return self.side * [1 - self.forward_overlap, 1 - self.side_overlap]

    def add_to(self, scene: Scene) -> None:
        """Add camera, points and photos."""
        self.camera.add_to(scene)
        poses = self._poses(scene.rng(0))
        xy = self._plan(scene.rng(1))
        z = scene.rng(2).uniform(-self.relief, self.relief, len(xy))
        points = np.asarray(np.round(np.column_stack([xy, z]), 3), dtype=float)
        seen = np.array([self.camera.sees(points, *pose) for pose in poses.values()])
        used = seen.sum(axis=0) >= 2
        if used.sum() < 4:
            scene.fail("points_per_photo", f"only {used.sum()} points have two rays; take more")
        points, seen = points[used], seen[:, used]
        names = scene.add_points(self.prefix, [f"{i}" for i in range(1, len(points) + 1)], points)
        scene.points.append(names)
        photos = scene.photo_names(self.prefix, list(poses))
        n = self.photos_per_strip
        flown = [photos[i : i + n] for i in range(0, len(photos), n)]
        scene.strips[scene.number] = [strip[:: 1 - 2 * (i % 2)] for i, strip in enumerate(flown)]
        for photo, (at, rotation), on in zip(photos, poses.values(), seen, strict=True):
            chosen = [n for n, s in zip(names, on, strict=True) if s]
            add_photo(scene, photo, self.camera, at, rotation, chosen)

    def _poses(self, rng: np.random.Generator) -> dict[str, tuple[Array, Array]]:
        """Return position and world_R_camera of each photo."""
        poses = {}
        for strip in range(self.strips):
            for place in range(self.photos_per_strip):
                at = np.array([*(self.base * [place, strip]), self.height])
                at += rng.normal(0.0, 1.0, 3) * self.centre_scatter * self.base[0]
                omega, phi, kappa = rng.normal(0.0, 1.0, 3) * np.deg2rad(self.tilt_deg)
                poses[f"{strip + 1}/{place + 1}"] = (
                    at,
                    world_R_camera(omega, phi, kappa + np.pi * (strip % 2)),
                )
        return poses

    def _plan(self, rng: np.random.Generator) -> Array:
        """Return X and Y of the points, (n, 2) metres."""
        last = self.base * [self.photos_per_strip - 1, self.strips - 1]
        if self.points == "von_gruber":
            x = np.arange(self.photos_per_strip) * self.base[0]
            end = min(END_COLUMN * (self.side[0] / 2 - self.base[0]), self.base[0])
            if end > 0:
                x = np.concatenate([[-end], x, [last[0] + end]])
            y = np.arange(2 * self.strips - 1) * self.base[1] / 2
            outer = min(self.base[1] / 2, SEAM * self.side[1])
            y = np.concatenate([[-outer], y, [last[1] + outer]])
            return np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
        low, high = -self.side / 2, last + self.side / 2
        if self.points == "grid":
            spacing = float(np.sqrt(self.side.prod() / self.points_per_photo))
            return jittered_grid(low, high, spacing, rng)
        count = round(self.points_per_photo * float(np.prod((high - low) / self.side)))
        return rng.uniform(low, high, (count, 2))


@dataclass(frozen=True)
class CrossStrips(Part):
    """Strips of vertical photos along Y, over the points of earlier blocks flown along X.

    One strip is over the middle of the points; two or more are spread from one edge to the other.
    """

    kind = "cross_strips"
    prefix: str = "x"
    """Prefix of the names of photos ``strip/place``."""
    parts: tuple[int, ...] = number((), least=0)
    """Earlier parts whose points are photographed; empty: all earlier parts."""
    strips: int = number(1, least=1)
    """Number of strips."""
    forward_overlap: float = number(0.6, least=0, below=1)
    """Overlap along the strips, as a fraction of the photo's side."""
    height: float | None = number(None, above=0)
    """Height above Z = 0, metres; None: the mean height of the earlier photos."""
    camera: Camera = field(default_factory=Camera)
    """The camera."""
    centre_scatter: float = number(0.03, least=0, most=0.5)
    """Scatter of the projection centres, as a fraction of the base."""
    tilt_deg: float = number(1.0, least=0, most=20)
    """Standard deviation of each angle of a photo, degrees."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        return [] if self.prefix else [Problem("must not be empty", path_of(where, "prefix"))]

    def add_to(self, scene: Scene) -> None:
        """Add camera, photos and image points; no points."""
        scene.points.append([])
        points = scene.points_of(self.parts)
        x, height = scene.coordinates(points), self.height
        if height is None:
            flown = [n for strip in scene.strips_of(self.parts) for n in strip]
            height = float(np.mean([np.array(scene.plan.photos[n].position)[2] for n in flown]))
        self.camera.add_to(scene)
        side = height / self.camera.c_mm * np.array(self.camera.format_mm)
        # The x axis of photos points along the strip, as in the strips along X.
        base = float(side[0]) * (1 - self.forward_overlap)
        low, high = x[:, :2].min(axis=0), x[:, :2].max(axis=0)
        edge = np.minimum(side[::-1] / 4, (high - low) / 2)
        n = max(2, int(np.ceil((high - low - 2 * edge)[1] / base - 1e-9)) + 1)
        ys = (low + high)[1] / 2 + base * (np.arange(n) - (n - 1) / 2)
        xs = np.linspace((low + edge)[0], (high - edge)[0], self.strips)
        if self.strips == 1:
            xs = np.array([(low + high)[0] / 2])
        rng, strips = scene.rng(0), []
        for i, across in enumerate(xs.tolist()):
            names = scene.photo_names(self.prefix, [f"{i + 1}/{k + 1}" for k in range(n)])
            for name, along in zip(names, ys.tolist(), strict=True):
                at = np.array([across, along, height])
                at += rng.normal(0.0, 1.0, 3) * self.centre_scatter * base
                omega, phi, kappa = rng.normal(0.0, 1.0, 3) * np.deg2rad(self.tilt_deg)
                rotation = world_R_camera(omega, phi, kappa + np.pi * (0.5 + i % 2))
                seen = np.flatnonzero(self.camera.sees(x, at, rotation)).tolist()
                if len(seen) < 3:
                    scene.fail("height", f"photo {name!r} sees {len(seen)} points; fly higher")
                add_photo(scene, name, self.camera, at, rotation, [points[j] for j in seen])
            strips.append(names[:: 1 - 2 * (i % 2)])
        scene.strips[scene.number] = strips


Known = Literal["free", "weighted", "held"]
"""What an adjustment knows of an unknown: nothing, its value with a standard deviation, all."""


@dataclass(frozen=True)
class Exposure:
    """A photo in its strip."""

    photo: str
    """Its name."""
    along: float
    """Horizontal distance from the middle of the strip, metres, in the direction of flight."""
    direction: Array
    """Horizontal unit vector of the flight, (3,); zero in a strip of one photo."""


def exposures(scene: Scene, strip: Sequence[str]) -> list[Exposure]:
    """Return the photos of a strip with their true places along it."""
    at = np.array([scene.plan.photos[n].position for n in strip], dtype=float)
    line = (at[-1] - at[0]) * [1.0, 1.0, 0.0]
    length = float(np.linalg.norm(line))
    direction = line / length if length else line
    along = (at - at.mean(axis=0)) @ direction
    return [Exposure(n, float(s), direction) for n, s in zip(strip, along, strict=True)]


def strips_kept(
    scene: Scene, parts: Sequence[int], without: float, rng: np.random.Generator
) -> list[list[Exposure]]:
    """Return the photos of each strip that have readings.

    Args:
        scene: the scene.
        parts: earlier parts; empty: all.
        without: share of the photos of each strip that have none, rounded.
        rng: stream by which they are drawn.
    """
    out = []
    for strip in scene.strips_of(parts):
        kept = len(strip) - round(without * len(strip))
        chosen = sorted(rng.permutation(len(strip))[:kept].tolist())
        flown = exposures(scene, strip)
        out.append([flown[i] for i in chosen])
    if not any(out):
        scene.fail("without", f"is {without:g}, which leaves no photo with a reading")
    return out


def stated(true: Mapping[str, float], sigma: Mapping[str, float], known: Known) -> dict[str, Any]:
    """Return the arguments by which a network states an unknown with true values.

    Args:
        true: values of the components that act, by name; all others are held at zero.
        sigma: standard deviations by which they were drawn, the weights of weighted ones.
        known: what an adjustment knows of them.
    """
    free = tuple(true) if known == "free" else ()
    weights = {n: sigma[n] for n in true} if known == "weighted" else {}
    return {"free": free, "values": dict(true), "sigma": weights}


def drawn(sigma: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Return normal values of the components whose standard deviation is not zero.

    Every component takes its number from the stream, so that the others stay the same.
    """
    z = rng.standard_normal(len(sigma)).tolist()
    return {n: s * e for (n, s), e in zip(sigma.items(), z, strict=True) if s > 0}


def _close_range_camera() -> Camera:
    return Camera(name="close range", c_mm=28.0, format_mm=(36.0, 24.0), sigma_um=2.0)


@dataclass(frozen=True)
class CloseRange(Part):
    """Convergent photos that look at an object from all sides.

    The object is a box that stands on Z = 0 with points of its own, or the points of earlier
    parts, or both. Own points in fewer than two photos are left out; points of earlier parts are
    observed in every photo that sees them.
    """

    kind = "close_range"
    prefix: str = ""
    """Prefix of the names of points ``1, 2, …`` and of photos ``photo 1, 2, …``."""
    photos: int = number(8, least=2)
    """Number of photos."""
    arrangement: Literal["around", "over"] = "around"
    """``around``: all photos on a ring about the object; ``over``: half of the photos on a second
    ring of half the radius, higher by half the distance."""
    distance: float = number(10.0, above=0)
    """Horizontal distance from the middle of the object to the ring, metres."""
    height: float = 4.0
    """Height of the photos above the middle of the object, metres."""
    scatter: float = number(0.03, least=0, most=0.3)
    """Scatter of projection centres and aims, as a fraction of the distance."""
    turned: bool = True
    """Whether every second photo is turned by 90°, which separates principal point and attitude."""
    camera: Camera = field(default_factory=_close_range_camera)
    """The camera."""
    of_parts: tuple[int, ...] = number((), least=0)
    """Earlier parts whose points are photographed."""
    points: Literal["grid", "surface", "random", "none"] = "grid"
    """Own points: ``grid`` on the floor, a third of them up to the height of the object;
    ``surface`` on its sides and top; ``random`` inside the object; ``none``."""
    count: int = number(48, least=4)
    """Approximate number of own points."""
    size: tuple[float, float, float] = number((6.0, 6.0, 2.0), above=0)
    """Size of the object along X, Y and Z, metres."""
    hidden: float = number(0.0, least=0, most=0.9)
    """Fraction of the sights that is hidden."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        if self.points == "none" and not self.of_parts:
            what = "none, and no of_parts: there is nothing to photograph"
            found.append(Problem(what, path_of(where, "points")))
        if not self.of_parts and self.distance < np.hypot(*self.size[:2]) / 2:
            found.append(
                Problem(
                    f"is {self.distance:g} m, within the object; valid: above "
                    f"{np.hypot(*self.size[:2]) / 2:g} m",
                    path_of(where, "distance"),
                )
            )
        return found

    def add_to(self, scene: Scene) -> None:
        """Add camera, points and photos."""
        self.camera.add_to(scene)
        wrong = [p for p in self.of_parts if p >= scene.number]
        if wrong:
            scene.fail("of_parts", f"there is no earlier part {', '.join(map(str, wrong))}")
        others = scene.points_of(self.of_parts) if self.of_parts else []
        own = self._object(scene.rng(0))
        there = scene.coordinates(others)
        middle = np.array([0.0, 0.0, self.size[2] / 2])
        if others:
            middle = (there.max(axis=0) + there.min(axis=0)) / 2
            own = own + np.array([*middle[:2], 0.0])
        points = np.concatenate([own, there])
        poses = self._poses(middle, scene.rng(1))
        seen = np.array([self.camera.sees(points, *pose) for pose in poses])
        seen &= scene.rng(2).random(seen.shape) >= self.hidden
        rays = seen.sum(axis=0)
        used = rays >= np.where(np.arange(len(points)) < len(own), 2, 1)
        if used.sum() < 4:
            scene.fail(
                "distance",
                f"only {used.sum()} of {len(points)} points are on the photos; go farther away or "
                "take a wider camera",
            )
        mine = np.flatnonzero(used[: len(own)])
        names = scene.add_points(self.prefix, [f"{i + 1}" for i in range(len(mine))], own[mine])
        scene.points.append(names)
        every = [""] * len(points)
        for i, n in zip([*mine, *range(len(own), len(points))], [*names, *others], strict=True):
            every[i] = n
        photos = scene.photo_names(self.prefix, [f"photo {i + 1}" for i in range(len(poses))])
        for photo, (at, rotation), on in zip(photos, poses, seen, strict=True):
            chosen = [every[i] for i in np.flatnonzero(on & used)]
            add_photo(scene, photo, self.camera, at, rotation, chosen)

    def _object(self, rng: np.random.Generator) -> Array:
        """Return the points of the object, whole mm, (n, 3)."""
        if self.points == "none":
            return np.zeros((0, 3))
        size = np.array(self.size)
        low, high = size * [-0.5, -0.5, 0.0], size * [0.5, 0.5, 1.0]
        if self.points == "grid":
            spacing = float(np.sqrt(size[0] * size[1] / self.count))
            xy = jittered_grid(low[:2], high[:2], spacing, rng)
            up = rng.random(len(xy)) < 1 / 3
            z = np.where(up, rng.uniform(0.25, 1.0, len(xy)), rng.uniform(0.0, 0.05, len(xy)))
            return np.round(np.column_stack([xy, size[2] * z]), 3)
        points = rng.uniform(low, high, (self.count, 3))
        if self.points == "surface":
            x, y, z = size
            # Faces: sides at ± X and ± Y, and the top, chosen in proportion to their areas.
            area = np.array([y * z, y * z, x * z, x * z, x * y])
            face = rng.choice(5, size=self.count, p=area / area.sum())
            for f, (axis, at) in enumerate(
                [(0, low[0]), (0, high[0]), (1, low[1]), (1, high[1]), (2, high[2])]
            ):
                points[face == f, axis] = at
        return np.asarray(np.round(points, 3))

    def _poses(self, middle: Array, rng: np.random.Generator) -> list[tuple[Array, Array]]:
        """Return position and world_R_camera of each photo."""
        poses = []
        for i in range(self.photos):
            turn = 2 * np.pi * (i + 0.5) / self.photos
            near = self.arrangement == "over" and i % 2 == 1
            radius = self.distance * (0.5 if near else 1.0)
            up = self.height + (0.5 * self.distance if near else 0.0)
            at = middle + np.array([radius * np.cos(turn), radius * np.sin(turn), up])
            stray = rng.normal(0.0, self.scatter * self.distance, (2, 3))
            at = at + stray[0]
            rotation = look_at(at, middle + stray[1] * [1.0, 1.0, 0.0])
            # Upper and lower photos alternate; turning by pairs gives both rings turned photos.
            place = i // 2 if self.arrangement == "over" else i
            if self.turned and place % 2:
                rotation = rotation @ QUARTER_TURN
            poses.append((at, rotation))
        return poses
