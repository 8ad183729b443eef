"""Rigs of a network as rigs and frames of COLMAP."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...network.entities import Photo
from ...network.network import Network
from ...observations.relative import RelativeRotation
from ...rotation import TURN_ABOUT_X, exp_rotation, log_rotation
from ...types import Array
from .colmap_model import FrameRecord, Pose, RigRecord, Sensor

TURN, SHIFT = 1e-6, 1e-5
"""Largest turn (radians) and shift (parts of the distances in the rig, or metres) of a member from
its mount; a member that is further off is no part of a rigid rig."""


@dataclass
class Rigs:
    """Rigs of a network."""

    mounts: dict[int, dict[int, str]] = field(default_factory=dict)
    """Mount of each other camera, by reference camera and camera."""
    members: dict[str, dict[str, str]] = field(default_factory=dict)
    """Mount of each member, by carrier and member."""

    @property
    def stand_ins(self) -> set[str]:
        """Photos that carry others."""
        return set(self.members)


def rigs_of(network: Network, cameras: Mapping[str, int]) -> Rigs:
    """Return the rigs that COLMAP can express; empty: there are none.

    COLMAP has one mount for each camera, and a camera belongs to one rig. A network with other
    rigs, or with members that are off their mounts, has none here: its photos stand alone.

    Args:
        network: photos with poses.
        cameras: number of the camera of each photo.
    """
    out = Rigs()
    reference: dict[int, int] = {}
    for o in network.observations.values():
        if not isinstance(o, RelativeRotation) or o.mount is None:
            continue
        if max(map(abs, o.value)) > TURN:  # an observed rotation, not a tie of a member
            continue
        carrier, member = o.photos()
        first, second = cameras[carrier], cameras[member]
        known = out.mounts.setdefault(first, {})
        off = (
            first == second
            or known.get(second, o.mount) != o.mount
            or reference.get(second, first) != first
            or reference.get(first, first) != first
            or not _on_mount(network, carrier, member, o.mount)
        )
        if off:
            return Rigs()
        reference[first] = reference[second] = first
        known[second] = o.mount
        out.members.setdefault(carrier, {})[member] = o.mount
    carried = {m for members in out.members.values() for m in members}
    return Rigs() if carried & set(out.members) else out


def mount_pose(network: Network, mount: str, scale: float = 1.0) -> Pose:
    """Return sensor_from_rig of a mount."""
    values = np.array(network.mounts[mount].values)
    b = exp_rotation(values[None, :3])[0]
    return Pose.of(TURN_ABOUT_X @ b @ TURN_ABOUT_X, scale * TURN_ABOUT_X @ values[3:6])


def _on_mount(network: Network, carrier: str, member: str, mount: str) -> bool:
    """Return whether a member stands where its mount puts it."""
    (r_a, x_a), (r_b, x_b) = (_pose(network.photos[n]) for n in (carrier, member))
    pose = mount_pose(network, mount)
    turn = log_rotation((pose.rotation @ r_a.T @ r_b)[None])[0]
    shift = x_b - x_a - r_a @ pose.centre
    distance = max(1.0, float(np.linalg.norm(pose.centre)))
    return bool(np.linalg.norm(turn) <= TURN and np.linalg.norm(shift) <= SHIFT * distance)


def _pose(photo: Photo) -> tuple[Array, Array]:
    assert photo.rotation is not None
    assert photo.position is not None
    return photo.rotation, np.array(photo.position)


def rig_records(
    network: Network,
    rigs: Rigs,
    images: Mapping[str, int],
    cameras: Mapping[str, int],
    poses: Mapping[str, Pose],
) -> tuple[tuple[RigRecord, ...], tuple[FrameRecord, ...]]:
    """Return rigs and frames of all images; an image alone has a rig of one camera.

    Args:
        network: the network.
        rigs: its rigs.
        images: number of each image.
        cameras: number of the camera of each photo.
        poses: camera from world of each photo.
    """
    carried = {m: c for c, members in rigs.members.items() for m in members}
    of_camera: dict[int, int] = {}
    records: list[RigRecord] = []
    for number in sorted(set(cameras.values())):
        if any(number in others for others in rigs.mounts.values()):
            continue
        others = rigs.mounts.get(number, {})
        records.append(
            RigRecord(
                len(records) + 1,
                ("CAMERA", number),
                tuple((("CAMERA", c), mount_pose(network, m)) for c, m in sorted(others.items())),
                "",
            )
        )
        for camera in (number, *others):
            of_camera[camera] = len(records)
    frames: list[FrameRecord] = []
    for name in poses:
        if name in carried:
            continue
        own = [n for n in (name, *rigs.members.get(name, ())) if n in images]
        if not own:
            continue
        data: list[tuple[Sensor, int]] = [(("CAMERA", cameras[n]), images[n]) for n in own]
        frames.append(
            FrameRecord(len(frames) + 1, of_camera[cameras[name]], poses[name], tuple(data), "")
        )
    return tuple(records), tuple(frames)
