"""Frames from sights to known points without distances, and points where such sights meet.

An instrument that stands on a known point is turned; any other one is placed by a resection in
space from four points or more, see `three_points`. The sights of two frames or more intersect.
"""

from __future__ import annotations

import numpy as np

from ..models.sub_frame import horizons, split_frame
from ..rotation import exp_rotation, log_rotation, nearest_rotation
from ..types import Array, Index, Mask
from .in_frames import InFrames
from .progress import Progress
from .rays import nearest_to_rays
from .resection import some_triples, three_points
from .sub_frames import origins_of

LEAST = 4
"""Smallest number of known points of a resection in space."""
SCORED = 60
"""Largest number of points by which positions of an instrument are compared."""
FITS = 0.02
"""Miss of a sight, radians, above which it does not support a position."""
FLAT = 1e-3
"""Smallest sine of the angle between two sights that fix a rotation."""


def orient_frames(progress: Progress, seen: InFrames) -> bool:
    """Turn frames whose instrument stands on a known place; return whether any was turned."""
    filled = False
    origins = origins_of(progress, seen)
    for f, rows in _open(progress, seen):
        given = seen.given[f]
        if not np.isfinite(origins[f]).all() or np.any(given[3:6] != 0.0):
            continue
        y = _directions_to(progress, seen, f, rows, origins[f])
        found = _turned(y, seen.sights.value[rows], seen.sights.unit[rows], given)
        if found is not None:
            _fill(progress, f, found, given[3:6], given)
            filled = True
    return filled


def resect_frames(progress: Progress, seen: InFrames) -> bool:
    """Place instruments by resection from known points; return whether any was placed."""
    filled = False
    origins = origins_of(progress, seen)
    unit = seen.sights.unit
    for f, rows in _open(progress, seen):
        own = rows[np.isfinite(unit[rows]).all(axis=1)]
        given = seen.given[f]
        if len(own) < LEAST or (seen.origin[f] >= 0 and np.any(given[3:6] != 0.0)):
            continue
        x = progress.horizon.from_plan(progress.plan[seen.sights.point[own]])
        # In the axes of the horizon, because those of the network may be left-handed.
        middle = x.mean(axis=0)
        nearby = _horizon(progress, f, middle)
        pose = resect_in_space((x - middle) @ nearby.T, unit[own])
        if pose is None:
            continue
        turned, centre = pose[0], middle + nearby.T @ pose[1]
        known = np.isfinite(origins[f]).all()
        if not known:  # the instrument stands on its point
            plan = progress.horizon.to_plan(centre[None])
            progress.set_plan(seen.origin[f : f + 1], plan[:, :2])
            progress.set_height(seen.origin[f : f + 1], plan[:, 2])
        at = origins[f] if known else centre
        if not np.isnan(given[:2]).any():
            tilt = exp_rotation(np.array([[given[0], given[1], 0.0]]))[0]
            left = log_rotation((tilt.T @ turned)[None])[0, 2]
            turn = given[2] if np.isfinite(given[2]) else left
            turned = tilt @ exp_rotation(np.array([[0.0, 0.0, turn]]))[0]
        scale = np.exp(-given[6]) if np.isfinite(given[6]) else 1.0
        offset = scale * turned.T @ (_horizon(progress, f, at) @ (centre - at))
        offset = np.where(np.isnan(given[3:6]), offset, given[3:6])
        _fill(progress, f, turned, offset, given)
        filled = True
    return filled


def intersect_sights(progress: Progress, seen: InFrames, *, parallax: float) -> bool:
    """Fill points that two known frames or more sight; return whether any was filled.

    Args:
        progress: is filled.
        seen: the sights.
        parallax: smallest strength of an intersection, radians, see `nearest_to_rays`.
    """
    sights = seen.sights
    known: Mask = np.all(np.isfinite(progress.frame), axis=1)
    origins = origins_of(progress, seen)
    known &= np.isfinite(origins).all(axis=1)
    rows = np.flatnonzero(known[sights.frame] & ~progress.complete[sights.point])
    rows = rows[np.isfinite(sights.unit[rows]).all(axis=1)]
    if not len(rows):
        return False
    points, group = np.unique(sights.point[rows], return_inverse=True)
    stored = progress.frame[sights.frame[rows]]
    rotation, offset, ln_scale, _, level = split_frame(stored)
    at = origins[sights.frame[rows]]
    horizon = horizons(progress.horizon.frame.basis(at, np.zeros((len(at), 2))), level)
    to_object = horizon.transpose(0, 2, 1) @ rotation
    centre = at + np.exp(ln_scale)[:, None] * (to_object @ offset[:, :, None])[:, :, 0]
    direction = (to_object @ sights.unit[rows][:, :, None])[:, :, 0]
    x, strength = nearest_to_rays(centre, direction, group, len(points))
    ahead = np.einsum("ni,ni->n", x[group] - centre, direction) > 0
    good = np.bincount(group, ahead, len(points)) > 0.5 * np.bincount(group)
    good &= (strength >= parallax) & np.isfinite(x).all(axis=1)
    if not good.any():
        return False
    plan = progress.horizon.to_plan(x[good])
    placed = progress.set_plan(points[good], plan[:, :2])
    return progress.set_height(points[good], plan[:, 2]) or placed


def start_frame(progress: Progress, seen: InFrames) -> bool:
    """Give the frame with the most whole sights an arbitrary place, if nothing is known.

    Returns:
        Whether that was done.
    """
    if progress.placed.any() or not len(seen.frame) or np.isfinite(progress.pose).any():
        return False
    whole = np.isfinite(seen.q).all(axis=1) & (seen.point >= 0)
    count = np.bincount(seen.frame[whole], minlength=len(seen.given))
    scaled = ~np.isnan(seen.given[:, 6])
    f = int(np.argmax(np.where(scaled, count, 0)))
    if count[f] < 3 or not scaled[f] or np.isfinite(progress.frame[:, :13]).all(axis=1).any():
        return False
    given = np.nan_to_num(seen.given[f])
    if seen.origin[f] >= 0:
        progress.set_plan(seen.origin[f : f + 1], np.zeros((1, 2)))
        progress.set_height(seen.origin[f : f + 1], np.zeros(1))
    _fill(progress, f, exp_rotation(given[None, :3])[0], given[3:6], given)
    return True


def resect_in_space(x: Array, unit: Array) -> tuple[Array, Array] | None:
    """Return the rotation (3, 3), instrument → object, and the place (3,) of an instrument.

    Args:
        x: points that it sights, (n, 3), n ≥ 4.
        unit: unit vectors to them in its axes, (n, 3).

    Returns:
        The position that most sights support; none: too few of them support it.
    """
    rng = np.random.default_rng(len(x))
    if len(x) > 4 * SCORED:
        chosen = np.sort(rng.choice(len(x), 4 * SCORED, replace=False))
        x, unit = x[chosen], unit[chosen]
    middle = x.mean(axis=0)
    some = some_triples(len(x))
    rotations, centres = three_points((x - middle)[some], unit[some])
    if not len(rotations):
        return None
    to = (x - middle)[None] - centres[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        to /= np.linalg.norm(to, axis=2, keepdims=True)
    miss = np.linalg.norm(to @ rotations - unit, axis=2)
    miss = np.where(np.isfinite(miss), np.minimum(miss, 10 * FITS), 10 * FITS)
    best = int(np.argmin(miss.mean(axis=1)))
    if np.count_nonzero(miss[best] < FITS) < max(LEAST, len(x) // 2):
        return None
    return rotations[best], centres[best] + middle


def _open(progress: Progress, seen: InFrames) -> list[tuple[int, Index]]:
    """Return the frames that are not known, and their sights to known points."""
    sights = seen.sights
    missing: Mask = np.any(np.isnan(progress.frame), axis=1)
    if not len(sights.frame) or not missing.any():
        return []
    rows = np.flatnonzero(missing[sights.frame] & progress.complete[sights.point])
    if not len(rows):
        return []
    rows = rows[np.argsort(sights.frame[rows], kind="stable")]
    frames, first = np.unique(sights.frame[rows], return_index=True)
    return list(zip(frames.tolist(), np.split(rows, first[1:]), strict=True))


def _horizon(progress: Progress, f: int, at: Array) -> Array:
    """Return E (3, 3) of a frame with the origin ``at`` (3,)."""
    basis = progress.horizon.frame.basis(at[None], np.zeros((1, 2)))
    return np.asarray(horizons(basis, progress.frame[f, 16:])[0])


def _directions_to(progress: Progress, seen: InFrames, f: int, rows: Index, at: Array) -> Array:
    """Return unit vectors from ``at`` to the points of sights, in its horizon, (n, 3)."""
    x = progress.horizon.from_plan(progress.plan[seen.sights.point[rows]])
    y = (x - at) @ _horizon(progress, f, at).T
    length = np.linalg.norm(y, axis=1, keepdims=True)
    return np.asarray(y / np.where(length > 0, length, np.nan))


def _turned(y: Array, value: Array, unit: Array, given: Array) -> Array | None:
    """Return R of an instrument from directions in the horizon; none: they do not fix it.

    Args:
        y: unit vectors from the instrument in its horizon, (n, 3).
        value: directions, zenith angles and distances, (n, 3).
        unit: unit vectors in the axes of the instrument, (n, 3).
        given: given components of the frame, (7,).
    """
    if not np.isnan(given[:2]).any():
        tilt = exp_rotation(np.array([[given[0], given[1], 0.0]]))[0]
        there = y @ tilt
        turn = np.arctan2(there[:, 1], there[:, 0]) - (np.pi / 2 - value[:, 0])
        turn = turn[np.isfinite(turn)]
        if not len(turn):
            return None
        mean = np.arctan2(np.sin(turn).sum(), np.cos(turn).sum())
        kappa = given[2] if np.isfinite(given[2]) else mean
        return np.asarray(tilt @ exp_rotation(np.array([[0.0, 0.0, kappa]]))[0])
    sound = np.isfinite(unit).all(axis=1) & np.isfinite(y).all(axis=1)
    a, b = unit[sound], y[sound]
    if len(a) < 2 or np.linalg.norm(np.cross(a[0], a), axis=1).max() < FLAT:
        return None
    return nearest_rotation(b.T @ a)


def _fill(progress: Progress, f: int, rotation: Array, offset: Array, given: Array) -> None:
    """Fill rotation, offset and scale of a frame; a scale that sights do not tell is 1."""
    ln_scale = given[6] if np.isfinite(given[6]) else 0.0
    progress.frame[f, :13] = np.concatenate([rotation.ravel(), offset, [ln_scale]])
