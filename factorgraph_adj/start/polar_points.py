"""Orientations of direction sets, polar points, and set-ups as levelled clouds of points.

An orientation unknown is the median of bearing − direction over known targets. A polar point has a
bearing and a length from a known point.

A set of directions with distances is a cloud of points about its station, with known scale and
plumb line: a turn, a shift in plan and one in height are all that is unknown (three unknowns where
nothing gives heights). Every pair of points that the cloud has in common with known points proposes
one transformation; the one with which most of the common points agree is taken, unless as many
agree with another turn. So where four or more points agree, a target with the name of another
neither turns a set-up nor moves its station. Two points agree with what they propose themselves: of
three common points two exchanged ones may lead to a start that is turned, which misfits then.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..graph.blocks import Block
from ..graph.variables import State
from ..models.base import wrap
from ..types import Array, Index, Mask
from .search_state import SearchState
from .terrestrial_readings import StationObservations, group_angle, group_median

MAX_CLOUD_MISFIT_RATIO = 3e-3
"""Distance of a common point from its known place, relative to the size of the cloud, up to which
it agrees with a transformation."""
MIN_OTHER_TURN_RAD = 0.1
"""Difference of two turns from which on they are not the same one, radians."""
MAX_COMMON_POINTS_IN_PAIRS = 30
"""Largest number of common points of which pairs are formed."""


class LevelledTransformation(NamedTuple):
    """The levelled transformation on which most common points agree."""

    turn: float
    """Rotation from north to east, radians."""
    shift: Array
    """Shift in east, north and height, metres, (3,); height NaN: unknown."""
    agree: Mask
    """Which of the common points agree, (m,)."""


def turned_in_plan(plan: Array, turn: float) -> Array:
    """Return positions (n, 2) turned from north to east."""
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(plan @ np.array([[c, -s], [s, c]]))


def agreed_transformation(
    cloud: Array, known: Array, *, within: float
) -> LevelledTransformation | None:
    """Return the turn and shift on which more than half of the common points agree.

    None: there is no such transformation, or as many points agree on one with another turn.

    known = R(turn) cloud + shift, with the scale of both.

    Args:
        cloud: east, north, height of the common points in the cloud, (m, 3); heights may be NaN.
        known: the same of the known places, (m, 3).
        within: largest distance, in plan and in height, of a point that agrees, metres.
    """
    m = len(cloud)
    some = np.unique(np.linspace(0, m - 1, min(m, MAX_COMMON_POINTS_IN_PAIRS)).astype(int))
    i, j = (some[k] for k in np.triu_indices(len(some), 1))
    a, b = cloud[j] - cloud[i], known[j] - known[i]
    la, lb = (np.hypot(d[:, 0], d[:, 1]) for d in (a, b))
    # Heights that are not known contradict nothing.
    fit = (np.abs(la - lb) <= 2 * within) & ~(np.abs(a[:, 2] - b[:, 2]) > 2 * within)
    fit &= np.minimum(la, lb) > 2 * within
    if not fit.any():
        return None
    a, b, i, j = a[fit], b[fit], i[fit], j[fit]
    turns = np.arctan2(b[:, 0], b[:, 1]) - np.arctan2(a[:, 0], a[:, 1])
    middle, place = (cloud[i] + cloud[j]) / 2, (known[i] + known[j]) / 2
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    d = cloud[None] - middle[:, None]
    e = c * d[..., 0] + s * d[..., 1] + place[:, :1] - known[:, 0]
    n = c * d[..., 1] - s * d[..., 0] + place[:, 1:2] - known[:, 1]
    h = np.nan_to_num(d[..., 2] + place[:, 2:] - known[:, 2])
    off = np.maximum(np.hypot(e, n), np.abs(h)) / within
    best = int(np.argmin(np.minimum(off, 1.0).sum(axis=1)))
    agree = np.asarray(off[best] <= 1.0)
    if 2 * np.count_nonzero(agree) <= m:
        return None
    as_many = np.count_nonzero(off <= 1.0, axis=1) >= np.count_nonzero(agree)
    if np.any(np.abs(wrap(turns[as_many] - turns[best])) > MIN_OTHER_TURN_RAD):
        return None
    return _fitted(cloud[agree], known[agree], agree)


def _fitted(cloud: Array, known: Array, agree: Mask) -> LevelledTransformation:
    """Return the transformation of the points that agree, by least squares in plan."""
    a = cloud[:, :2] - cloud[:, :2].mean(axis=0)
    b = known[:, :2] - known[:, :2].mean(axis=0)
    turn = float(np.arctan2(np.sum(b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]), np.sum(a * b)))
    shift = np.full(3, np.nan)
    shift[:2] = np.mean(known[:, :2] - turned_in_plan(cloud[:, :2], turn), axis=0)
    rise = known[:, 2] - cloud[:, 2]
    if np.isfinite(rise).any():
        shift[2] = np.nanmedian(rise)
    return LevelledTransformation(turn, shift, agree)


def place_clouds(progress: SearchState) -> bool:
    """Fill stations, orientations and targets of set-ups whose clouds agree with known points.

    The set-up with which most points agree comes first, so that a target on which two set-ups
    contradict one another has the place of the better one.

    Returns:
        Whether any set-up was joined.
    """
    joined: list[tuple[int, int, Index, Array, LevelledTransformation]] = []
    for group, point, place in _clouds(progress):
        common: Index = np.flatnonzero(progress.placed[point])
        known = progress.plan[point[common]]
        size = float(np.hypot(place[:, 0], place[:, 1]).max())
        found = agreed_transformation(place[common], known, within=MAX_CLOUD_MISFIT_RATIO * size)
        if found is not None:
            joined.append((-int(found.agree.sum()), group, point, place, found))
    for _, group, point, place, found in sorted(joined, key=lambda c: c[:2]):
        at = np.append(turned_in_plan(place[:, :2], found.turn), place[:, 2:], axis=1) + found.shift
        progress.set_plan(point, at[:, :2])
        high: Mask = np.isfinite(at[:, 2])
        progress.set_height(point[high], at[high, 2])
        convergence = progress.horizon.convergence(progress.plan[point[:1]])[0]
        progress.orientation[group] = found.turn - convergence
    return bool(joined)


def _clouds(progress: SearchState) -> list[tuple[int, Index, Array]]:
    """Return sets that are not oriented, with their points, the station first, and their places.

    Sets with fewer than two known points are left out, and those with nothing but known ones.
    """
    d, e = progress.survey.directions, progress.survey.edges
    open_ = np.flatnonzero(np.isnan(progress.orientation[d.third]))
    rows, edge = progress.survey.edge(d.station[open_], d.target[open_])
    rows = open_[rows]
    length = progress.lengths()[edge]
    usable = np.isfinite(length) & (length > 0.0)
    rows, edge, length = rows[usable], edge[usable], length[usable]
    group, placed = d.third[rows], progress.placed
    sets = len(progress.orientation)
    known = np.bincount(group, placed[d.target[rows]], sets)[group] + placed[d.station[rows]]
    # Where every point is known, the median of all bearings is the orientation.
    enough = (known >= 2) & (known <= np.bincount(group, None, sets)[group])
    if not enough.any():
        return []
    rows, edge, length = rows[enough], edge[enough], length[enough]
    rise = np.where(d.station[rows] == e.a[edge], e.rise[edge], -e.rise[edge])
    place = np.stack([length * np.sin(d.value[rows]), length * np.cos(d.value[rows]), rise], axis=1)
    order = np.argsort(d.third[rows], kind="stable")
    groups, first = np.unique(d.third[rows][order], return_index=True)
    out: list[tuple[int, Index, Array]] = []
    for group, own in zip(groups.tolist(), np.split(order, first[1:]), strict=True):
        station = d.station[rows[own[0]]]
        # A target that was sighted more than once is one point.
        targets, once = np.unique(d.target[rows[own]], return_index=True)
        point = np.append(station, targets)
        out.append((group, point, np.append(np.zeros((1, 3)), place[own[once]], axis=0)))
    return out


def bearing(progress: SearchState, i: Index, j: Index) -> Array:
    """Return the bearing in plan from points i to points j, radians; NaN where unknown."""
    d = progress.plan[j, :2] - progress.plan[i, :2]
    out = np.arctan2(d[:, 0], d[:, 1])
    out[~np.isfinite(d).all(axis=1) | (np.abs(d) < 1e-9).all(axis=1)] = np.nan
    return np.asarray(out)


def orient_sets(progress: SearchState) -> bool:
    """Fill the orientation of sets that sight known targets: the median of α − direction.

    Returns:
        Whether any orientation was filled.
    """
    d: StationObservations = progress.survey.directions
    rows = np.flatnonzero(np.isnan(progress.orientation[d.third]))
    if not len(rows):
        return False
    i, j, group = d.station[rows], d.target[rows], d.third[rows]
    turned = (
        bearing(progress, i, j) - progress.horizon.convergence(progress.plan[i]) - d.value[rows]
    )
    known = np.isfinite(turned)
    if not known.any():
        return False
    found = group_angle(group[known], turned[known], len(progress.orientation))
    new = np.isnan(progress.orientation) & np.isfinite(found)
    progress.orientation[new] = found[new]
    return bool(new.any())


def orient_sets_by_model(blocks: Iterable[Block], frame: Frame, state: State) -> None:
    """Fill unknown orientations of a state with known points, by the model of directions."""
    missing = np.isnan(state["orientation"][:, 0])
    for block in blocks:
        if block.quantity != "direction" or not missing.any():
            continue
        group = block.variables[4][1]
        rows = np.flatnonzero(missing[group])
        trial = dict(state)
        trial["orientation"] = np.where(missing[:, None], 0.0, state["orientation"])
        v = block.select(rows).evaluate(frame, trial, jacobians=False).residual
        found = group_angle(group[rows], v[:, 0], len(missing))
        state["orientation"][missing, 0] = found[missing]
        missing = np.isnan(state["orientation"][:, 0])


class KnownBearings(NamedTuple):
    """Known bearings from known to unknown points."""

    known: Index
    """Number of the known point, (n,)."""
    unknown: Index
    """Number of the unknown point, (n,)."""
    bearing: Array
    """Bearing in plan from the known to the unknown point, radians, (n,)."""


def known_bearings(progress: SearchState) -> KnownBearings:
    """Collect the bearings of oriented directions, azimuths, and angles with one known arm.

    Sights from unknown stations to known targets are reversed.
    """
    s = progress.survey
    placed = progress.placed
    d, z, a = s.directions, s.azimuths, s.angles
    back = bearing(progress, a.station, a.target)
    fore = bearing(progress, a.station, a.third)
    i = np.concatenate([d.station, z.station, a.station, a.station])
    j = np.concatenate([d.target, z.target, a.third, a.target])
    # Angles start from bearings in plan; directions and azimuths are azimuths at their station.
    azimuth = np.concatenate([progress.orientation[d.third] + d.value, z.value])
    n = len(azimuth)
    angle = np.concatenate([azimuth, back + a.value, fore - a.value])
    open_ = np.flatnonzero((placed[i] != placed[j]) & np.isfinite(angle))
    i, j, angle = i[open_], j[open_], angle[open_]
    forward = placed[i]
    near, far = np.where(forward, i, j), np.where(forward, j, i)
    turn = np.where(open_ < n, progress.horizon.convergence(progress.plan[near]), 0.0)
    return KnownBearings(near, far, angle + turn + np.where(forward, 0.0, np.pi))


def place_polar_points(progress: SearchState) -> bool:
    """Fill points with a bearing and a length from one known point; the median of several."""
    if not len(progress.survey.edges.key):
        return False
    r = known_bearings(progress)
    rows, edges = progress.survey.edge(r.known, r.unknown)
    length = progress.lengths()[edges]
    rows, length = rows[np.isfinite(length)], length[np.isfinite(length)]
    if not len(rows):
        return False
    start, target, angle = r.known[rows], r.unknown[rows], r.bearing[rows]
    at = progress.plan[start, :2] + length[:, None] * np.stack([np.sin(angle), np.cos(angle)], 1)
    new = np.unique(target)
    place = np.searchsorted(new, target)
    found = np.stack([group_median(place, at[:, c], len(new)) for c in (0, 1)], 1)
    return progress.set_plan(new, found)
