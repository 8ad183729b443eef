"""Cameras of simulated blocks, and the choice of the points on a photo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...errors import InputError, Problem, known
from ...models.lens import Lens
from ...models.registry import LENSES
from ...network.network import Network
from ...types import Array, Mask
from ..parameters import Parameters, number, path_of
from .part import MICROMETRE, Scene

LensName = Literal[
    "none",
    "harmonic",
    "brown",
    "brown_forward",
    "normalised",
    "balanced",
    "affine",
    "ebner",
    "gruen",
]


@dataclass(frozen=True)
class Camera(Parameters):
    """A camera: true calibration, free parameters, and σ of image coordinates."""

    name: str = "camera"
    """Name of the camera; parts with equal cameras share one camera."""
    c_mm: float = number(153.0, above=0)
    """Principal distance, mm."""
    format_mm: tuple[float, float] = number((230.0, 230.0), above=0)
    """Width and height of the photos, mm."""
    x0_mm: float = 0.0
    """x of the principal point, mm."""
    y0_mm: float = 0.0
    """y of the principal point, mm."""
    lens: LensName = "none"
    """Lens model of the adjustment."""
    lens_options: Mapping[str, float] = field(default_factory=dict)
    """Options of the lens model, such as ``reference_radius``, mm."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """True additional parameters; absent parameters are 0."""
    free: tuple[str, ...] = ()
    """Calibration parameters to estimate."""
    sigma: Mapping[str, float] = field(default_factory=dict, metadata={"above": 0.0})
    """Standard deviations of weighted calibration parameters."""
    sigma_um: float = number(5.0, above=0)
    """Standard deviation of image coordinates, µm."""

    def made_lens(self) -> Lens:
        """Return the lens model with its options."""
        return LENSES[self.lens](**self.lens_options)

    def problems(self, where: str) -> list[Problem]:
        """Return the problems: options and parameters that are unknown in the lens model."""
        try:
            names = self.made_lens().names
        except TypeError:
            valid = known(LENSES[self.lens].__dataclass_fields__)
            what = f"lens {self.lens!r} does not take these; valid: {valid}"
            return [Problem(what, path_of(where, "lens_options"))]
        except InputError as error:
            return [Problem(str(error), path_of(where, "lens_options"))]
        asked = {"parameters": self.parameters, "free": self.free, "sigma": self.sigma}
        return [
            Problem(
                f"unknown calibration parameter {n!r} of lens {self.lens!r}; valid: "
                f"{known(names, meant=n, most=40)}",
                path_of(where, key),
            )
            for key, given in asked.items()
            for n in given
            if n not in names
        ]

    def add_to(self, scene: Scene) -> None:
        """Add the camera to the plan if the plan lacks it."""
        values = {"c": self.c_mm, "x0": self.x0_mm, "y0": self.y0_mm, **self.parameters}
        alone = Network()
        alone.add_camera(self.name, self.made_lens(), values, free=self.free, sigma=self.sigma)
        there = scene.plan.cameras.setdefault(self.name, alone.cameras[self.name])
        if there != alone.cameras[self.name]:
            scene.fail(
                "camera.name",
                f"an earlier part has another camera {self.name!r}; give this one another name",
            )

    def sees(self, points: Array, at: Array, rotation: Array) -> Mask:
        """Return the mask (n,) of the points (n, 3) on a photo."""
        return in_view(points, at, rotation, self.c_mm, self.format_mm)


def in_view(
    points: Array, at: Array, rotation: Array, c: float, plate: tuple[float, float]
) -> Mask:
    """Return the mask (n,) of the points (n, 3) in front of a camera and on its plate.

    Args:
        points: coordinates, metres.
        at: projection centre, metres.
        rotation: world_R_camera.
        c: principal distance, mm.
        plate: width and height, mm.
    """
    p = (points - at) @ rotation
    on = np.all(np.abs(p[:, :2] / p[:, 2:]) < np.array(plate) / 2 / c, axis=1)
    return np.asarray(on & (p[:, 2] > 0))


def add_photo(
    scene: Scene,
    name: str,
    camera: Camera,
    at: Array,
    rotation: Array,
    points: Sequence[str],
) -> None:
    """Add a photo and its image points to the plan."""
    plan = scene.plan
    plan.add_photo(name, camera.name, position=at.tolist(), rotation=rotation)
    xy = np.zeros((len(points), 2))
    plan.add_image_points(name, list(points), xy, sigma=camera.sigma_um * MICROMETRE)
