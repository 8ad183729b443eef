"""Photos from relative poses, and mounts from photos: rigs and odometry.

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
from ..models.relative_poses import bases, relative_rotations
from ..models.variables import ROTATION, UNKNOWNS
from ..rotation import TURN_ABOUT_X as TURN
from ..rotation import exp_rotation, log_rotation
from ..types import Array, Index, Mask
from .search_state import SearchState

MAX_PAIRS_OF_MOUNT = 200
"""Largest number of pairs of photos from which the rotation of a mount is computed."""


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
        if block.kind == "relative_rotation":
            for key, r in zip(_keys(block), exp_rotation(block.observed), strict=True):
                found.setdefault(key, _nothing())[0][:] = r
        elif block.kind == "relative_position":
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
