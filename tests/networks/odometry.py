"""A camera on a closed path: visual odometry from each photo to the next, and back to the first."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Correlated,
    PhotoPosition,
    RelativePosition,
    RelativeRotation,
)
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.types import Array

ZERO = (0.0, 0.0, 0.0)
SIGMA_TURN, SIGMA_STEP = 2e-4, 0.01
RADIUS = 20.0


def covariance(seed: int) -> Array:
    """Return a joint covariance (6, 6) of rotation and base."""
    root = np.random.default_rng(seed).normal(size=(6, 6))
    scale = np.repeat([SIGMA_TURN, SIGMA_STEP], 3)
    return np.asarray((np.eye(6) + 0.2 * root @ root.T) * np.outer(scale, scale))


def odometry(
    photos: int = 12, *, closures: int = 2, joint: bool = True, scale: float | None = None
) -> Network:
    """Return the path with its true values, to be measured; its first photo is held.

    Args:
        photos: photos on the path.
        closures: pairs that close loops: the last with the first, and others across.
        joint: whether rotation and base of a pair have a joint covariance.
        scale: true scale of the odometer less one, which is free; None: the scale is one.
    """
    network = Network("odometry")
    network.add_camera("camera", NoDistortion(), {"c": 10.0})
    for i in range(photos):
        angle = 2 * np.pi * i / photos
        at = np.array([RADIUS * np.cos(angle), RADIUS * np.sin(angle), 2.0 + 0.3 * np.sin(5 * i)])
        ahead = at + np.array([-np.sin(angle), np.cos(angle), 0.05 * np.sin(3 * i)])
        turned = look_at(at, ahead) @ exp_rotation(np.array([0.0, 0.0, 0.1 * np.sin(i)]))
        network.add_photo(f"F{i}", "camera", position=at, rotation=turned, fixed=i == 0)
    odometer = None
    if scale is not None:
        odometer = "odometer"
        network.set_distance_meter(odometer, scale=scale, free=["scale"])
    pairs = [(i, i + 1) for i in range(photos - 1)] + [(photos - 1, 0), (0, photos // 2)][:closures]
    for k, (i, j) in enumerate(pairs):
        turn_sigma, step_sigma = (SIGMA_TURN,) * 3, (SIGMA_STEP,) * 3
        a, b = f"F{i}", f"F{j}"
        step = RelativePosition(
            a, b, ZERO, sigma=step_sigma, instrument=odometer, id=f"step {i} {j}"
        )
        turn = RelativeRotation(a, b, ZERO, sigma=turn_sigma, id=f"turn {i} {j}")
        network.add(*((Correlated((turn, step), covariance(k)),) if joint else (turn, step)))
    if scale is not None:
        for name, f in list(network.photos.items())[::3]:
            assert f.position is not None
            network.add(PhotoPosition(name, f.position, sigma=(0.02,) * 3))
    return network
