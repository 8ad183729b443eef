"""Heights, coordinates, poses, mounts from given values, differences, surfaces, relative poses.

Levelled and trigonometric height differences lead from known heights to unknown ones. The height of
a point above a surface is that of the surface plus a known number; a surface is known from a point
of known height. GNSS vectors and coordinate differences lead from known points to unknown ones.
Control points, positions of photos and strips give coordinates directly. Azimuths of a
gyrotheodolite are directions whose orientation, the constant of the instrument, is that of all its
stations.

With the photos A and B, the mount B_m, b of B on A, and the observed R_obs, t_obs (photogrammetric
axes, see `factorgraph_adj.models.relative_poses`):

    R_B = R_A B_m R_obs        X_B = X_A + R_A (b + t_obs)
    B_m = R_Aᵀ R_B R_obsᵀ      b   = R_Aᵀ (X_B − X_A) − t_obs

A free component of a mount that is stated as zero is looked for: the start value of an arm is the
median over all pairs of photos that were found without it, that of a rotation is the rotation with
the smallest sum of angles to all others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import DEFAULT
from ..models.relative_poses import bases, relative_rotations
from ..models.unknown_registry import ROTATION, UNKNOWNS
from ..network.network import Network
from ..observations.base import of_quantities
from ..observations.registry import POSITION_QUANTITIES
from ..rotation import TURN_ABOUT_X, exp_rotation, log_rotation
from ..rotation import TURN_ABOUT_X as TURN
from ..types import Array, Index, Mask
from .search_state import SearchState
from .terrestrial_readings import StationObservations, group_angle, group_median

MAX_PAIRS_OF_MOUNT = 200
"""Largest number of pairs of photos from which the rotation of a mount is computed."""


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
    for o in of_quantities(network.observations.values(), *POSITION_QUANTITIES):
        if o.record.photos:
            at = progress.pose[unknowns["pose"].number[o.photo], 9:]
            # The lever arm is short relative to the distance to the object.
            for axis, value in zip(o.axes, o.value, strict=True):
                i = "xyz".index(axis)
                at[i] = value if np.isnan(at[i]) else at[i]
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
    for o in of_quantities(network.observations.values(), "coordinates in a strip"):
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
    for o in of_quantities(network.observations.values(), "attitude of a photo"):
        pose = poses[unknowns["pose"].number[o.photo]]
        if np.isnan(pose[:9]).any() and not np.isnan(pose[9:]).any():
            boresight = mounts.values[mounts.number[o.mount or DEFAULT], :9].reshape(3, 3)
            body = o.object_R_body(network.frame, pose[9:])
            pose[:9] = (body @ boresight.T @ TURN_ABOUT_X).ravel()


def given_positions(network: Network) -> Array:
    """Return all positions (n, 3) that observations of points and photos give."""
    found = [
        o.value
        for o in of_quantities(network.observations.values(), *POSITION_QUANTITIES)
        if o.axes == "xyz" or set(o.axes) <= set("enu")
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


@dataclass(frozen=True)
class RelativePoses:
    """Pairs of photos with an observed relative pose, each pair once for each mount."""

    first: Index
    """Number of photo A, (n,)."""
    second: Index
    """Number of photo B, (n,)."""
    mount: Index
    """Number of the mount, (n,)."""
    rotation: Array
    """R_obs, (n, 3, 3); NaN where it was not observed."""
    base: Array
    """t_obs in metres, (n, 3); NaN where it was not observed."""
    wanted: Mask
    """Components of each mount whose start values are looked for, (m, 6)."""

    @property
    def n(self) -> int:
        """Number of pairs."""
        return len(self.first)


def read_relative_poses(equations: Equations) -> RelativePoses:
    """Return the relative poses that a network observes."""
    found: dict[tuple[int, int, int], tuple[Array, Array]] = {}
    odometers = equations.unknowns["edm"].values
    for block in equations.blocks:
        if block.quantity == "relative rotation":
            for key, r in zip(_keys(block), exp_rotation(block.observed), strict=True):
                found.setdefault(key, _nothing())[0][:] = r
        elif block.quantity == "relative position":
            scale = 1.0 + odometers[block.variables[3][1], :1]
            for key, t in zip(_keys(block), block.observed / scale, strict=True):
                found.setdefault(key, _nothing())[1][:] = t
    number = np.array(list(found), dtype=np.intp).reshape(-1, 3)
    table, record = equations.unknowns["mount"], UNKNOWNS["mount"]
    unknown = table.free & np.isinf(table.sigma)
    wanted = unknown & (record.given(table.values) == 0.0)
    used = np.isin(np.arange(len(wanted)), number[:, 2])
    return RelativePoses(
        number[:, 0],
        number[:, 1],
        number[:, 2],
        np.array([r for r, _ in found.values()]).reshape(-1, 3, 3),
        np.array([t for _, t in found.values()]).reshape(-1, 3),
        wanted & used[:, None],
    )


def _keys(block: Block) -> Iterable[tuple[int, int, int]]:
    return zip(*(block.variables[j][1].tolist() for j in range(3)), strict=True)


def _nothing() -> tuple[Array, Array]:
    return np.full((3, 3), np.nan), np.full(3, np.nan)


def open_mounts(stored: Array, wanted: Mask) -> Array:
    """Return mounts (m, 12) with NaN in the rotations and arms that are looked for."""
    out = stored.copy()
    out[wanted[:, :3].any(axis=1), :ROTATION] = np.nan
    out[:, ROTATION:][wanted[:, 3:]] = np.nan
    return out


def fill_mounts(progress: SearchState, seen: RelativePoses, given: Array) -> bool:
    """Fill mounts from the photos that are known on both sides; return whether any was filled.

    Args:
        progress: is filled.
        seen: the relative poses.
        given: mounts as they were stated, (m, 12), whose held components are kept.
    """
    filled = False
    for number in np.flatnonzero(np.isnan(progress.mount).any(axis=1)).tolist():
        rows = np.flatnonzero(seen.mount == number)
        known = np.isfinite(progress.pose[seen.first[rows]]).all(axis=1)
        known &= np.isfinite(progress.pose[seen.second[rows]]).all(axis=1)
        rows = rows[known][:MAX_PAIRS_OF_MOUNT]
        if not len(rows):
            continue
        a, b = progress.pose[seen.first[rows]], progress.pose[seen.second[rows]]
        mount, wanted = progress.mount[number], seen.wanted[number]
        turned = relative_rotations(a, b) @ np.swapaxes(seen.rotation[rows], 1, 2)
        turned = turned[np.isfinite(turned).all(axis=(1, 2))]
        if np.isnan(mount[0]) and len(turned):
            w = log_rotation(_median_rotation(turned)[None])[0]
            stated = UNKNOWNS["mount"].given(given[number][None])[0, :3]
            mount[:ROTATION] = exp_rotation(np.where(wanted[:3], w, stated)).ravel()
            filled = True
        arm = bases(a, b) - seen.base[rows]
        arm = arm[np.isfinite(arm).all(axis=1)]
        if np.isnan(mount[ROTATION:]).any() and len(arm):
            mount[ROTATION:] = np.where(wanted[3:], np.median(arm, axis=0), mount[ROTATION:])
            filled = True
    return filled


def _median_rotation(rotations: Array) -> Array:
    """Return the rotation (3, 3) with the smallest sum of angles to all rotations (n, 3, 3)."""
    cosine = np.einsum("aij,bij->ab", rotations, rotations) / 2 - 0.5
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.asarray(rotations[int(np.argmin(angle.sum(axis=1)))])


def fill_poses(progress: SearchState, seen: RelativePoses) -> bool:
    """Fill attitudes and centres of photos from those that they are joined to.

    Returns:
        Whether any was filled.
    """
    filled = False
    if not seen.n or not np.isnan(progress.pose).any():
        return False
    mount = progress.mount[seen.mount]
    rotation = TURN @ mount[:, :ROTATION].reshape(-1, 3, 3) @ seen.rotation @ TURN
    base = (mount[:, ROTATION:] + seen.base) @ TURN
    ends = ((seen.first, seen.second, rotation), (seen.second, seen.first, _transposed(rotation)))
    while True:
        before = int(np.isnan(progress.pose).sum())
        for known, new, turn in ends:
            of_known = progress.pose[known, :ROTATION].reshape(-1, 3, 3)
            found = (of_known @ turn).reshape(-1, ROTATION)
            _fill(progress.pose[:, :ROTATION], new, found)
        at_first = progress.pose[seen.first, :ROTATION].reshape(-1, 3, 3)
        vector = np.einsum("nij,nj->ni", at_first, base)
        centres = progress.pose[:, ROTATION:]
        _fill(centres, seen.second, centres[seen.first] + vector)
        _fill(centres, seen.first, centres[seen.second] - vector)
        if int(np.isnan(progress.pose).sum()) == before:
            return filled
        filled = True


def _transposed(rotations: Array) -> Array:
    return np.swapaxes(rotations, 1, 2)


def _fill(values: Array, rows: Index, found: Array) -> None:
    """Fill rows of values that are not known with what was found, in place."""
    new = np.isnan(values[rows]).any(axis=1) & np.isfinite(found).all(axis=1)
    values[rows[new]] = found[new]


def start_with_photo(progress: SearchState, seen: RelativePoses) -> bool:
    """Place one photo of a free network of which nothing is known; return whether it was."""
    if np.isfinite(progress.plan).any() or np.isfinite(progress.pose).any():
        return False
    mount_known = np.isfinite(progress.mount[seen.mount]).all(axis=1)
    whole = np.isfinite(seen.rotation).all(axis=(1, 2)) & np.isfinite(seen.base).all(axis=1)
    rows = np.flatnonzero(mount_known & whole)
    if not len(rows):
        return False
    pose = progress.pose[seen.first[rows[0]]]
    pose[:ROTATION] = np.eye(3).ravel()
    pose[ROTATION:] = progress.horizon.from_plan(np.zeros((1, 3)))[0]
    return True
