"""A four-camera rig over a terrain: the nadir camera carries three oblique ones; GNSS, control."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.composite_unknowns import RIGID
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, PhotoPosition
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.types import Array
from tests.networks.rigs import PARTS, on_mount

HEIGHT = 150.0
BASE = 45.0
ACROSS = 70.0
FOCAL = 35.0
HALF = (18.0, 12.0)
"""Halves of the sensor, mm."""
SIGMA_MM = 0.002
SIGMA_GNSS = (0.02, 0.02, 0.03)
MOUNTS: dict[str, tuple[float, ...]] = {
    "forward": (0.62, 0.01, -0.02, 0.02, 0.31, 0.05),
    "left": (0.01, -0.61, 0.03, -0.28, 0.02, 0.04),
    "right": (-0.02, 0.63, -0.01, 0.29, -0.01, 0.06),
}
"""Rotation vectors and arms of the oblique cameras on the nadir camera."""


def aerial_rig(
    strips: int = 2,
    exposures: int = 4,
    *,
    spacing: float = 22.0,
    free: tuple[str, ...] = PARTS,
    play: tuple[float, float] = RIGID,
) -> Network:
    """Return the block with its true values, to be measured.

    Args:
        strips: strips, every second one flown backwards.
        exposures: of each strip.
        spacing: width of the grid of points, metres.
        free: free components of the mounts.
        play: of the members on their mounts, radians and metres.
    """
    rng = np.random.default_rng([strips, exposures])
    network = Network("aerial rig")
    for name in ("nadir", *MOUNTS):
        network.add_camera(name, NoDistortion(), {"c": FOCAL})
    for name, values in MOUNTS.items():
        network.set_mount(name, free=free, values=dict(zip(PARTS, values, strict=True)))
    for strip in range(strips):
        for k in range(exposures):
            at = np.array([strip * ACROSS, k * BASE, HEIGHT]) + rng.normal(0.0, 2.0, 3)
            omega, phi, turn = rng.normal(0.0, np.deg2rad(2.0), 3)
            rotation = world_R_camera(omega, phi, turn + np.pi * (strip % 2))
            carrier = f"{strip}-{k}"
            network.add_photo(carrier, "nadir", position=at, rotation=rotation)
            network.add(PhotoPosition(carrier, (0.0, 0.0, 0.0), sigma=SIGMA_GNSS))
            for name, values in MOUNTS.items():
                turned, centre = on_mount(rotation, at, values)
                network.add_photo(
                    f"{carrier} {name}",
                    name,
                    position=centre,
                    rotation=turned,
                    carrier=carrier,
                    mount=name,
                    play=play,
                )
    _see(network, _terrain(strips, exposures, spacing, rng))
    return network


def _terrain(strips: int, exposures: int, spacing: float, rng: np.random.Generator) -> Array:
    """Return a jittered grid of points under the block, (n, 3)."""
    low, high = np.array([-90.0, -90.0]), np.array([90 + strips * ACROSS, 90 + exposures * BASE])
    axes = [np.arange(a, b, spacing) for a, b in zip(low, high, strict=True)]
    xy = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    xy += rng.uniform(-0.4, 0.4, xy.shape) * spacing
    z = 10 * np.sin(xy[:, 0] / 60) * np.cos(xy[:, 1] / 45)
    return np.column_stack([xy, z])


def _see(network: Network, x: Array) -> None:
    """Add the points that three photos or more see, and their image points."""
    seen = np.zeros((len(network.photos), len(x)), dtype=bool)
    for i, f in enumerate(network.photos.values()):
        assert f.rotation is not None
        p = (x - np.array(f.position)) @ f.rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.abs(p[:, :2] / p[:, 2:]) * FOCAL
        seen[i] = (p[:, 2] > 10) & (p[:, 2] < 400) & (t < HALF).all(axis=1)
    used = np.flatnonzero(seen.sum(axis=0) > 2)
    names = [f"P{i}" for i in used.tolist()]
    network.add_points(names, x[used])
    for i, photo in enumerate(network.photos):
        chosen = [names[j] for j in np.flatnonzero(seen[i, used]).tolist()]
        if chosen:
            zeros = np.zeros((len(chosen), 2))
            network.add_image_points(photo, chosen, zeros, sigma=SIGMA_MM)
    for corner in (0, -1):
        at = tuple(x[used[corner]].tolist())
        network.add(ControlPoint(names[corner], at, sigma=(0.01, 0.01, 0.01)))
