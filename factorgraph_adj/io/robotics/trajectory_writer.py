"""Writer of trajectories of TUM and KITTI: the poses of photos, or of points with a heading."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ...errors import InputError, taking
from ...network.network import Network
from ...rotation import TURN_ABOUT_X
from ...solve.solution import Solution
from ...types import Array
from ..file_transaction import write_files
from ..format_limits import Refusals
from ..numbers import checked_number
from .g2o_writer import numbers, quaternion
from .pose_graph import BODY, WORLD, in_plan
from .trajectory import LARGEST_TIME, SECOND, AxesChoice, decimal_time

TrajectoryChoice = Literal["TUM", "KITTI"]
"""Rows of a trajectory: time, place and quaternion, or (R, X) without times."""


@taking(Network | Solution)
def write_trajectory(
    network: Network | Solution,
    path: str | Path,
    *,
    rows: TrajectoryChoice = "TUM",
    axes: AxesChoice | None = None,
) -> None:
    """Write the poses of photos, or of points with a heading, as a trajectory.

    The formats have poses alone: no observations, standard deviations, points and cameras.

    Args:
        network: the network with its given poses, or a solution.
        path: the file.
        rows: ``TUM``, whose times are the names of the poses, seconds, which are written with all
            their digits, or ``KITTI``, which has no times.
        axes: axes of the poses, see `read_trajectory`; those of a pose in plan are the body's.
            None: those that were read: of the body for photos of the camera ``body``, as of pose
            graphs and of trajectories read with ``axes="body"``, of the camera for all others.

    Raises:
        InputError: there are no poses; a pose has no values; its name is no time in seconds, or
            does not grow; poses were read with axes of both sorts, and ``axes`` is None. No file
            has changed.
    """
    if isinstance(network, Solution):
        network = network.as_network()
    used = {"body" if p.camera == BODY else "camera" for p in network.photos.values()}
    chosen: str = axes or min(used, default="camera")
    for what, value, valid in (("rows", rows, TrajectoryChoice), ("axes", chosen, AxesChoice)):
        if value not in get_args(valid):
            raise InputError(f"{what} must be one of {', '.join(get_args(valid))}, not {value!r}")
    refused = Refusals(rows)
    if axes is None and len(used) == 2:
        what = "poses with the axes of cameras beside those of a body without the option axes"
        refused.refuse(what, network.name)
    lines, before = list[str](), Decimal("-Infinity")
    for name, pose in _poses(network, chosen):
        where = f"pose {name!r}"
        if pose is None or not np.isfinite(pose).all():
            refused.refuse("a pose without values: write the solution", where)
            continue
        if rows == "KITTI":
            lines.append(numbers(pose.ravel()))
            continue
        text = name.removesuffix(SECOND)
        try:
            checked_number(text, "time", largest=LARGEST_TIME)
        except ValueError:
            refused.refuse("a pose whose name is no time in seconds; rows='KITTI' has none", where)
            continue
        time = decimal_time(text)
        if time < before or (time == before and text == name):
            refused.refuse("times that do not grow", where)
        before = time
        lines.append(f"{text} {numbers([*pose[:, 3], *quaternion(pose[:, :3])])}")
    if not lines and not refused.count:
        refused.refuse("a network without poses: photos, or points with a heading", network.name)
    refused.raise_all()
    target = Path(path)
    write_files(target.parent, {target.name: "\n".join(lines) + "\n"})


def _poses(network: Network, axes: str) -> Iterator[tuple[str, Array | None]]:
    """Yield names and (R, X) of the poses, (3, 4), without the held world of a pose graph."""
    turn = np.eye(3) if axes == "camera" else TURN_ABOUT_X
    for name, photo in network.photos.items():
        if photo.rotation is None or photo.position is None:
            yield name, None
        elif name != WORLD:
            yield name, np.column_stack([photo.rotation @ turn, photo.position])
    for name, heading in network.of_kind("heading").items():
        point = network.points.get(name)
        if point is None:
            yield name, None
        elif name != WORLD:
            x, y, z = point.coordinates
            pose = in_plan(x, y, 0.5 * np.pi - heading.values[0])
            yield name, np.column_stack([pose.rotation, [x, y, z]])
