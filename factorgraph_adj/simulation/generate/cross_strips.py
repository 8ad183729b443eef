"""Strips across the strips of earlier blocks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...errors import Problem
from ...rotation import world_R_camera
from ..parameters import number, path_of
from .part import Part, Scene
from .photos import Camera, add_photo


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
