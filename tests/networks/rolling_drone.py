"""A drone block of a rolling shutter with 30 ms readout: photos in two strips that move as read.

The camera is self-calibrated. The drone flies at 10 m/s above a terrain with steep relief and turns
by some hundredths of a radian in a second; every photo has GNSS and 12 points are control.
"""

from __future__ import annotations

import numpy as np

from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, PhotoPosition
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array

READOUT = 0.03
"""Readout time, seconds."""
SENSOR = (5472.0, 3648.0)
"""Width and height, px."""
FOCAL, SIGMA_PX = 3600.0, 0.4
SPEED, INTERVAL = 10.0, 4.0
"""Speed, m/s, and time between exposures, seconds."""
FREE = ("c", "x0", "y0", "k1")
MOTION_SIGMA = (1.0, 1.0, 1.0, 0.1, 0.1, 0.1)
"""Standard deviations of weighted motions, m/s and rad/s."""
SIGMA_GNSS, SIGMA_CONTROL = (0.02, 0.02, 0.03), (0.02, 0.02, 0.02)


def flown(
    photos: int = 4, strips: int = 2, points: int = 160, *, per_photo: bool = False
) -> Network:
    """Return the block with its true values, and motions that are free.

    Args:
        photos: photos in a strip.
        strips: strips, flown to and fro.
        points: points on the ground, some of which no two photos see.
        per_photo: whether every photo has a calibration of its own.
    """
    network = Network("drone block")
    network.add_camera(
        "camera",
        BrownForwardLens(),
        {"c": FOCAL, "k1": -8e-10},
        free=() if per_photo else FREE,
        sigma=dict(zip(FREE, (2.0, 2.0, 2.0, 1e-11), strict=True)) if per_photo else None,
        unit="px",
        per_photo=per_photo,
        format=SENSOR,
        readout=READOUT,
    )
    rng = np.random.default_rng([photos, strips, points])
    extent = SPEED * INTERVAL * np.array([photos - 1, strips - 1])
    ground = np.column_stack(
        [rng.uniform([-40.0, -40.0], extent + 40.0, (points, 2)), rng.uniform(0.0, 25.0, points)]
    )
    poses: list[tuple[Array, Array]] = []
    motions: list[Array] = []
    for strip in range(strips):
        ahead = 1.0 if strip % 2 == 0 else -1.0
        for i in range(photos):
            at = SPEED * INTERVAL * np.array([i, strip, 2.0]) + rng.normal(0.0, [1.0, 1.0, 5.0])
            omega, phi = rng.normal(0.0, 0.12, 2)
            poses.append((at, world_R_camera(omega, phi, ahead * np.pi / 2)))
            motions.append(
                np.append(
                    ahead * np.array([SPEED, 0, 0]) + rng.normal(0, 0.5, 3), rng.normal(0, 0.05, 3)
                )
            )
    seen = np.array([_inside(ground, *pose) for pose in poses])
    used = np.flatnonzero(seen.sum(axis=0) >= 2)
    names = [f"P{i}" for i in range(points)]
    for i in used.tolist():
        network.add_point(names[i], ground[i])
    for number, ((at, rotation), motion, inside) in enumerate(
        zip(poses, motions, seen, strict=True)
    ):
        photo = f"F{number}"
        network.add_photo(photo, "camera", position=at, rotation=rotation)
        network.set_unknown("photo_motion", photo, motion)
        own = [names[i] for i in used.tolist() if inside[i]]
        network.add_image_points(photo, own, np.zeros((len(own), 2)), sigma=SIGMA_PX)
        network.add(PhotoPosition(photo, (0.0, 0.0, 0.0), sigma=SIGMA_GNSS))
    for i in used[:: max(1, len(used) // 12)].tolist():
        network.add(ControlPoint(names[i], (0.0, 0.0, 0.0), sigma=SIGMA_CONTROL))
    return network


def _inside(ground: Array, at: Array, rotation: Array) -> Array:
    """Return whether points (n, 3) are on a photo, (n,), with a margin for its motion."""
    p = (ground - at) @ rotation
    return np.asarray((np.abs(FOCAL * p[:, :2] / p[:, 2:]) < np.array(SENSOR) * 0.49).all(axis=1))


def measured(plan: Network, seed: int) -> Network:
    """Return a block with measuring errors, and photos of which only the poses are known roughly.

    The motions are zero at the start.
    """
    network = measure(plan, seed=seed)
    for photo in network.photos:
        network.set_unknown("photo_motion", photo, (0.0,) * 6)
    return disturb(network, seed=seed, points=0.5, centres=0.5, attitudes=0.01)


def true_motions(plan: Network) -> dict[str, Array]:
    """Return the motions by photo, (6,) each."""
    return {name: np.array(p.values) for name, p in plan.of_kind("photo_motion").items()}


def errors_of_motions(plan: Network, solution: Solution) -> Array:
    """Return the errors of all motions divided by their standard deviations, (photos, 6)."""
    out = []
    for photo, true in true_motions(plan).items():
        found = solution.unknown("photo_motion", photo)
        out.append((np.array(found.values) - true) / np.array(found.sigmas))
    return np.array(out)
