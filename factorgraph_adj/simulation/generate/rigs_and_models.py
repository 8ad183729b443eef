"""Further cameras on the carriers of photos, and independent models in the place of photos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...errors import Problem
from ...network.composite_unknowns import RIGID
from ...rotation import TURN_ABOUT_X, exp_rotation
from ...triangulation.independent_models import as_models, photos_of_strips
from ...types import Array
from ...units import MILLIMETRE
from ..measurement import measure
from ..parameters import number, path_of
from .photo_blocks import Known, drawn, stated
from .scene import MICROMETRE, Camera, Part, Scene

TURNS, ARM = ("rx", "ry", "rz"), ("x", "y", "z")
LEAST_SIGHTS = 3
"""Number of image points of a member with a free mount, which has six components."""


@dataclass(frozen=True)
class IndependentModels(Part):
    """Models of the photos of all earlier parts, with the covariance of their orientations.

    Relative orientations of the true images give coordinates and covariance of each model; rays
    leave the network. Readings then have the errors that measured images would have given. Points
    that no model has are left out.
    """

    kind = "models"
    photos: int = number(2, least=2, most=8)
    """Photos in a model that follow one another in a strip: pairs, triplets …"""
    shared: int = number(1, least=0)
    """Photos that models which follow one another share, fewer than ``photos``."""
    centres: bool = True
    """Whether projection centres are coordinates of the models."""
    joint: bool = False
    """Whether models that share photos have one covariance."""

    def add_to(self, scene: Scene) -> None:
        """Replace the photos by models."""
        scene.points.append([])
        if self.shared >= self.photos:
            scene.fail("shared", f"is {self.shared}; valid: fewer than photos, {self.photos}")
        true = measure(scene.plan, seed=0, noise=False)
        units = [u for strip in photos_of_strips(true) for u in self._units(strip)]
        block = as_models(true, units, centres=self.centres, joint=self.joint)
        vars(scene.plan).update(vars(block.network))
        scene.points = [[p for p in names if p in scene.plan.points] for names in scene.points]
        scene.strips = {
            part: [[p for p in strip if p in scene.plan.photos] for strip in strips]
            for part, strips in scene.strips.items()
        }

    def _units(self, strip: Sequence[str]) -> list[tuple[str, ...]]:
        step = self.photos - self.shared
        starts = range(0, len(strip) - self.photos + 1, step)
        return [tuple(strip[i : i + self.photos]) for i in starts]


def _member_camera() -> Camera:
    return Camera(name="oblique")


@dataclass(frozen=True)
class Rig(Part):
    """Cameras around the camera of earlier photos, tilted outwards, on rigid mounts.

    Every earlier photo, of aerial or close-range blocks, carries all of them. They see the points
    of the earlier parts that are on their photos; exposures that see none are left out.
    """

    kind = "rig"
    prefix: str = ""
    """Prefix of the names of mounts ``member 1, 2, …``; a photo adds that to its carrier's name."""
    parts: tuple[int, ...] = number((), least=0)
    """Earlier parts whose photos are carriers and whose points are seen; empty: all of them."""
    members: int = number(4, least=1)
    """Number of cameras on a carrier; the first is tilted to the right, others follow to the
    left about the axis of view."""
    tilt_deg: float = number(30.0, least=0, most=80)
    """Nominal angle between their axes of view and that of the carrier, degrees."""
    radius: float = number(0.3, least=0)
    """Nominal distance of their projection centres from that of the carrier, metres."""
    camera: Camera = field(default_factory=_member_camera)
    """The cameras; each has a number behind this name, and a calibration of its own."""
    mounts: Known = "free"
    """What is known of the mounts."""
    turn_deg: float = number(0.5, above=0)
    """Standard deviation by which each rotation of a mount differs from nominal, degrees."""
    shift_mm: float = number(10.0, above=0)
    """Standard deviation by which each coordinate of an arm differs from nominal, mm."""
    play_deg: float = number(0.0, least=0)
    """Standard deviation of the rotation of a member on its mount, degrees; 0: rigid."""
    play_mm: float = number(0.0, least=0)
    """Standard deviation of the place of a member on its mount, mm; 0: rigid."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        if self.tilt_deg == 0 and self.radius == 0 and self.members > 1:
            return [Problem("all members are in one place; give a tilt or a radius",
                            path_of(where, "tilt_deg"))]  # fmt: skip
        return []

    def add_to(self, scene: Scene) -> None:
        """Add cameras, mounts, photos and image points; no points."""
        scene.points.append([])
        carriers = [n for strip in scene.strips_of(self.parts) for n in strip]
        points = scene.points_of(self.parts)
        scene.strips[scene.number] = []
        rng = scene.rng(0)
        for i in range(self.members):
            self._add_member(scene, i, carriers, points, rng)

    def _add_member(
        self,
        scene: Scene,
        i: int,
        carriers: list[str],
        points: list[str],
        rng: np.random.Generator,
    ) -> None:
        plan, mount = scene.plan, f"{self.prefix}member {i + 1}"
        camera = replace(self.camera, name=f"{self.camera.name} {i + 1}")
        scene.refuse_used([mount], plan.mounts, "mounts")
        camera.add_to(scene)
        true, sigma = self._mount(i, rng)
        plan.set_mount(mount, **stated(true, sigma, self.mounts))
        x = scene.coordinates(points)
        play = (
            float(np.deg2rad(self.play_deg)) or RIGID[0],
            self.play_mm * MILLIMETRE or RIGID[1],
        )
        sights = 0
        for carrier in carriers:
            photo = plan.photos[carrier]
            at, rotation = on_mount(
                np.array(photo.rotation), np.array(photo.position), [*true.values()]
            )
            seen = [points[j] for j in np.flatnonzero(camera.sees(x, at, rotation)).tolist()]
            if not seen:
                continue
            name = f"{carrier} {mount}"
            scene.refuse_used([name], plan.photos, "photos")
            plan.add_photo(
                name,
                camera.name,
                position=at.tolist(),
                rotation=rotation,
                carrier=carrier,
                mount=mount,
                play=play,
            )
            zeros = np.zeros((len(seen), 2))
            plan.add_image_points(name, seen, zeros, sigma=camera.sigma_um * MICROMETRE)
            sights += len(seen)
        if sights < LEAST_SIGHTS:
            scene.fail(
                "tilt_deg",
                f"{mount!r} sees {sights} points; take a smaller tilt or a wider camera",
            )

    def _mount(self, i: int, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
        """Return the true components of a mount, and their standard deviations, SI."""
        turn = 2 * np.pi * i / self.members
        c, s = float(np.cos(turn)), float(np.sin(turn))
        # About this axis the direction of view, −z, turns towards (c, s, 0).
        tilt = float(np.deg2rad(self.tilt_deg))
        nominal = (tilt * s, -tilt * c, 0.0, self.radius * c, self.radius * s, 0.0)
        sigma = dict.fromkeys(TURNS, float(np.deg2rad(self.turn_deg)))
        sigma |= dict.fromkeys(ARM, self.shift_mm * MILLIMETRE)
        off = drawn(sigma, rng)
        true = {n: v + off[n] for n, v in zip((*TURNS, *ARM), nominal, strict=True)}
        return true, sigma


def on_mount(rotation: Array, centre: Array, mount: list[float]) -> tuple[Array, Array]:
    """Return projection centre and world_R_camera of a member on its carrier.

    Args:
        rotation: world_R_camera of the carrier, (3, 3).
        centre: its projection centre, (3,) metres.
        mount: rotation vector and arm in photogrammetric axes of the carrier, (6,).
    """
    turned = rotation @ TURN_ABOUT_X
    b = exp_rotation(np.array([mount[:3]]))[0]
    return centre + turned @ np.array(mount[3:]), turned @ b @ TURN_ABOUT_X
