"""Points from known coordinates, strips and GNSS vectors; photos from known positions."""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import DEFAULT
from ..network.network import Network
from ..observations import ControlPoint, PhotoAttitude, PhotoPosition, StripCoordinate
from ..rotation import TURN_ABOUT_X
from ..types import Array
from .progress import Progress
from .survey import Sighted, group_median


def known_coordinates(equations: Equations, progress: Progress) -> None:
    """Fill coordinates from control points, GNSS positions, photo positions, and then strips."""
    network, unknowns = equations.network, equations.unknowns
    horizon = progress.horizon
    for o in network.observations.values():
        if isinstance(o, PhotoPosition):
            at = progress.pose[unknowns["pose"].number[o.photo], 9:]
            # The lever arm is short relative to the distance to the object.
            for axis, value in zip(o.axes, o.value, strict=True):
                i = "xyz".index(axis)
                at[i] = value if np.isnan(at[i]) else at[i]
        if not isinstance(o, ControlPoint):
            continue
        row = np.array([unknowns["point"].number[o.point]])
        xyz = np.full((1, 3), np.nan)
        if set(o.axes) <= set("enu"):
            known = horizon.to_plan(np.asarray(o.value, dtype=float)[None])
            for i, axis in enumerate("enu"):
                if axis not in o.axes:
                    known[0, i] = np.nan
        else:
            for axis, value in zip(o.axes, o.value, strict=True):
                xyz[0, "xyz".index(axis)] = value
            known = horizon.to_plan(xyz)
        progress.set_plan(row, known[:, :2])
        progress.set_height(row, known[:, 2])
    for o in network.observations.values():
        if isinstance(o, StripCoordinate):
            xyz = np.full((1, 3), np.nan)
            xyz[0, ["xyz".index(a) for a in o.axes]] = o.value
            row, known = np.array([unknowns["point"].number[o.point]]), horizon.to_plan(xyz)
            progress.set_plan(row, known[:, :2])
            progress.set_height(row, known[:, 2])
    known_attitudes(equations, progress.pose)


def known_attitudes(equations: Equations, poses: Array) -> None:
    """Fill the rotations of photos at known places from observed attitudes, in place.

    Boresights are those that their mounts state; drifts and unknown boresights are small.

    Args:
        equations: the network.
        poses: stored poses, (n, 12).
    """
    network, unknowns = equations.network, equations.unknowns
    mounts = unknowns["mount"]
    for o in network.observations.values():
        if isinstance(o, PhotoAttitude):
            pose = poses[unknowns["pose"].number[o.photo]]
            if np.isnan(pose[:9]).any() and not np.isnan(pose[9:]).any():
                boresight = mounts.values[mounts.number[o.mount or DEFAULT], :9].reshape(3, 3)
                body = o.object_R_body(network.frame, pose[9:])
                pose[:9] = (body @ boresight.T @ TURN_ABOUT_X).ravel()


def given_positions(network: Network) -> Array:
    """Return all positions (n, 3) that observations of points and photos give."""
    found = [
        o.value
        for o in network.observations.values()
        if (isinstance(o, PhotoPosition) and o.axes == "xyz")
        or (isinstance(o, ControlPoint) and (o.axes == "xyz" or set(o.axes) <= set("enu")))
    ]
    found += [f.position for f in network.photos.values() if f.position is not None]
    return np.array(found, dtype=float).reshape(-1, 3)


def vectors(progress: Progress) -> bool:
    """Fill points at the end of a GNSS vector from a known point; the median of several.

    Differences of plan coordinates fill the plan alone.
    """
    survey = progress.survey
    placed = _along(progress, survey.vectors, height=True)
    return _along(progress, survey.plan_steps, height=False) or placed


def _along(progress: Progress, v: Sighted, *, height: bool) -> bool:
    complete = progress.complete
    if not v.n or (complete[v.station].all() and complete[v.target].all()):
        return False
    forth = complete[v.station] & ~complete[v.target]
    back = complete[v.target] & ~complete[v.station]
    if not (forth.any() or back.any()):
        return False
    near = np.concatenate([v.station[forth], v.target[back]])
    far = np.concatenate([v.target[forth], v.station[back]])
    step = np.concatenate([v.value[forth], -v.value[back]])
    at = progress.horizon.to_plan(progress.horizon.from_plan(progress.plan[near]) + step)
    at[:, 2] -= np.concatenate([v.rise[forth], -v.rise[back]])
    new = np.unique(far)
    place = np.searchsorted(new, far)
    found = np.stack([group_median(place, at[:, c], len(new)) for c in range(3)], 1)
    placed = progress.set_plan(new, found[:, :2])
    return (height and progress.set_height(new, found[:, 2])) or placed
