"""Convergent close-range blocks around or over an object."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...errors import Problem
from ...types import Array
from ..measurement import look_at
from ..parameters import number, path_of
from .scene import Camera, Part, Scene, add_photo, jittered_grid

QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation by 90° about the axis of the camera."""


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
