"""Heights along height differences and surfaces, points along vectors, given coordinates.

Levelled and trigonometric height differences lead from known heights to unknown ones. The height of
a point above a surface is that of the surface plus a known number; a surface is known from a point
of known height. GNSS vectors and coordinate differences lead from known points to unknown ones.
Control points, positions of photos and strips give coordinates directly. Azimuths of a
gyrotheodolite are directions whose orientation, the constant of the instrument, is that of all its
stations.
"""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import DEFAULT
from ..network.network import Network
from ..observations import ControlPoint, PhotoAttitude, PhotoPosition, StripCoordinate
from ..rotation import TURN_ABOUT_X
from ..types import Array, Index
from .search_state import SearchState
from .terrestrial_observations import StationObservations, group_angle, group_median


def height_differences(progress: SearchState) -> tuple[Index, Index, Array]:
    """Return pairs of points and their height differences H_b − H_a, metres, known so far.

    Levelling and slope distance with zenith angle need no plan; a zenith angle alone takes the
    distance D from the plan: D cot z + D²/2R, plus instrument height minus target height.
    """
    e, z = progress.survey.edges, progress.survey.zeniths
    d = progress.plan[z.target, :2] - progress.plan[z.station, :2]
    length = np.hypot(d[:, 0], d[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        trig = length / np.tan(z.value) + length**2 * progress.horizon.curvature / 2 - z.rise
    joined, _ = progress.survey.edge(z.station, z.target)
    single = np.ones(z.n, dtype=bool)
    if len(joined):
        single[joined] = np.isnan(e.rise[progress.survey.edge(z.station, z.target)[1]])
    single &= np.isfinite(trig)
    levelled = np.isfinite(e.rise)
    return (
        np.concatenate([e.a[levelled], z.station[single]]),
        np.concatenate([e.b[levelled], z.target[single]]),
        np.concatenate([e.rise[levelled], trig[single]]),
    )


def fill_heights(progress: SearchState) -> bool:
    """Fill heights by height differences from points of known height; the median of several."""
    if not np.isnan(progress.plan[:, 2]).any():
        return False
    i, j, rise = height_differences(progress)
    return _transfer_heights(progress, i, j, rise)


def _transfer_heights(progress: SearchState, i: Index, j: Index, rise: Array) -> bool:
    filled = False
    while True:
        known = np.isfinite(progress.plan[:, 2])
        forth, back = known[i] & ~known[j], known[j] & ~known[i]
        if not (forth.any() or back.any()):
            return filled
        target = np.concatenate([j[forth], i[back]])
        height = np.concatenate(
            [progress.plan[i[forth], 2] + rise[forth], progress.plan[j[back], 2] - rise[back]]
        )
        new = np.unique(target)
        found = group_median(np.searchsorted(new, target), height, len(new))
        filled |= progress.set_height(new, found)


def fill_surface_heights(progress: SearchState) -> bool:
    """Fill surfaces from points of known height, and heights of points from known surfaces."""
    s, found = progress.survey.above, False
    while True:
        height = progress.plan[s.point, 2]
        known = np.isfinite(height) & np.isnan(progress.surface[s.surface])
        if known.any():
            new = group_median(s.surface[known], (height - s.above)[known], len(progress.surface))
            progress.surface = np.where(np.isnan(progress.surface), new, progress.surface)
        up = progress.surface[s.surface] + s.above
        rows = np.isnan(height) & np.isfinite(up)
        if not rows.any():
            return found
        points = np.unique(s.point[rows])
        place = np.searchsorted(points, s.point[rows])
        found |= progress.set_height(points, group_median(place, up[rows], len(points)))


def start_surface(progress: SearchState) -> bool:
    """Set a surface to the height 0 if a free network has no known height."""
    s = progress.survey.above
    if not len(s.surface) or np.isfinite(progress.plan[:, 2]).any():
        return False
    progress.surface[s.surface[0]] = 0.0
    return fill_surface_heights(progress)


def share_gyro_constants(progress: SearchState) -> bool:
    """Give the constants of gyrotheodolites that one station found to all other stations."""
    gyro = progress.survey.gyro
    own = progress.orientation[len(progress.orientation) - len(gyro) :]
    known = np.isfinite(own)
    if known.all() or not known.any():
        return False
    found = group_angle(gyro[known], own[known], int(gyro.max()) + 1)[gyro]
    new = ~known & np.isfinite(found)
    own[new] = found[new]
    return bool(new.any())


def fill_given_coordinates(equations: Equations, progress: SearchState) -> None:
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
    fill_given_attitudes(equations, progress.pose)


def fill_given_attitudes(equations: Equations, poses: Array) -> None:
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


def fill_vector_ends(progress: SearchState) -> bool:
    """Fill points at the end of a GNSS vector from a known point; the median of several.

    Differences of plan coordinates fill the plan alone.
    """
    survey = progress.survey
    placed = _fill_ends(progress, survey.vectors, height=True)
    return _fill_ends(progress, survey.plan_steps, height=False) or placed


def _fill_ends(progress: SearchState, v: StationObservations, *, height: bool) -> bool:
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
