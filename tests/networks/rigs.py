"""Rigs of cameras in a room of targets, with known truth.

The carrier is the photo of the reference camera. Mounts are those of members on it: B leads from
photogrammetric axes of the member to those of the reference, b is the arm in axes of the reference.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from factorgraph_adj.entities import Photo
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.composite_unknowns import RIGID
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.rotation import TURN_ABOUT_X, exp_rotation
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.types import Array

PARTS = ("rx", "ry", "rz", "x", "y", "z")
SIGMA_MM = 0.002
FOCAL = 12.0
HALF = 11.0
"""Half the width of the sensor, mm."""
MOUNTS: dict[str, tuple[float, ...]] = {
    "left": (0.02, 1.55, -0.01, -0.22, 0.01, 0.11),
    "right": (-0.03, -1.6, 0.02, 0.21, -0.02, 0.12),
    "back": (0.01, 3.0, 0.05, 0.02, 0.05, 0.25),
}
"""Rotation vectors and arms of the members on the reference camera."""
ROOM = (8.0, 6.0, 3.0)


def targets() -> dict[str, Array]:
    """Return targets on the walls of the room."""
    rng = np.random.default_rng(5)
    x, y, z = ROOM
    out: dict[str, Array] = {}
    for i in range(32):
        along, high = rng.uniform(-0.9, 0.9), rng.uniform(0.1, 0.9) * z
        wall = i % 4
        at = [(along * x, y), (x, along * y), (along * x, -y), (-x, along * y)][wall]
        out[f"T{i}"] = np.array([*at, high])
    return out


def carriers(epochs: int) -> list[tuple[Array, Array]]:
    """Return world_R_camera and projection centre of the reference camera at each epoch."""
    out = []
    for i in range(epochs):
        centre = np.array([1.5 * np.cos(0.9 * i), 1.2 * np.sin(1.3 * i), 1.5 + 0.3 * np.sin(i)])
        ahead = np.array([6 * np.cos(0.7 * i + 0.3), 5 * np.sin(0.7 * i + 0.3), 1.3])
        turn = exp_rotation(np.array([0.05 * np.sin(i), 0.0, 0.6 * i]))
        out.append((look_at(centre, ahead) @ turn, centre))
    return out


def on_mount(rotation: Array, centre: Array, mount: tuple[float, ...]) -> tuple[Array, Array]:
    """Return world_R_camera and projection centre of a member on its carrier."""
    b = exp_rotation(np.array([mount[:3]]))[0]
    turned = rotation @ TURN_ABOUT_X
    return turned @ b @ TURN_ABOUT_X, centre + turned @ np.array(mount[3:])


def rig(
    epochs: int = 4,
    *,
    free: tuple[str, ...] = PARTS,
    held_points: int = 8,
    play: tuple[float, float] = RIGID,
    members: tuple[str, ...] = tuple(MOUNTS),
    mounts: Mapping[str, tuple[float, ...]] = MOUNTS,
    second: Mapping[str, str] | None = None,
) -> Network:
    """Return a rig with its true values, to be measured.

    Args:
        epochs: exposures of the rig.
        free: free components of the mounts.
        held_points: targets with known coordinates.
        play: of the members on their mounts, radians and metres.
        members: names of the mounts of the members.
        mounts: true values of all mounts that are stated.
        second: mounts of a second rig, by the mount of the first one, at every other epoch.
    """
    network = Network("rig")
    network.add_camera("camera", NoDistortion(), {"c": FOCAL})
    for name in mounts if second else members:
        values = dict(zip(PARTS, mounts[name], strict=True))
        network.set_mount(name, free=free, values=values)
    for i, (rotation, centre) in enumerate(carriers(epochs)):
        network.add_photo(f"E{i}", "camera", position=centre, rotation=rotation)
        for member in members:
            name = (second or {}).get(member, member) if i % 2 else member
            turned, at = on_mount(rotation, centre, mounts[name])
            network.add_photo(
                f"E{i} {member}",
                "camera",
                position=at,
                rotation=turned,
                carrier=f"E{i}",
                mount=name,
                play=play,
            )
    see(network, held_points)
    return network


def see(network: Network, held: int) -> None:
    """Add the targets that two photos or more see, and their image points.

    Args:
        network: a network with photos at their true places.
        held: number of targets that are held.
    """
    for name, x in targets().items():
        photos = [n for n, f in network.photos.items() if _sees(f, x)]
        if len(photos) < 2:
            continue
        network.add_point(name, x, fixed="xyz" if len(network.points) < held else "")
        for photo in photos:
            network.add(ImagePoint(photo, name, 0.0, 0.0, sigma=SIGMA_MM))


def _sees(photo: Photo, x: Array) -> bool:
    """Return whether a target is in the image of a photo."""
    assert photo.rotation is not None
    p = photo.rotation.T @ (x - np.array(photo.position))
    return bool(p[2] > 0.3 and max(abs(p[0]), abs(p[1])) < HALF / FOCAL * p[2])
