"""Growth in plan by relative blocks, their joins, and the choice between two positions.

A block starts with a station with directions and distances, with a distance, or (if nothing gives a
scale) with a line of arbitrary length. The block grows by the same steps as the network, and a
plane Helmert transformation over common points joins it to the network. A free network without any
known point is one such block.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..models.base import wrap
from ..types import Array, Index, Mask
from .intersection import (
    GOOD_CROSSING_SINE,
    MAX_RELATIVE_MISFIT,
    MIN_COMPARED_MISFIT,
    MIN_CROSSING_SINE,
    MIN_MISFIT_RATIO,
    ambiguous_positions,
    contradiction_misfits,
    intersect_in_plan,
)
from .polar_points import bearing, orient_sets, place_clouds, place_polar_points
from .search_state import SearchState
from .terrestrial_readings import StationObservations, median_angle

MAX_BLOCK_STARTS = 20
"""Largest number of starts that are tried at one stage."""
MAX_TRIED_AMBIGUITIES = 6
"""Largest number of doubtful points that are tried at one stage."""
TRIAL_STEPS = (2, 5, 15, None)
"""Numbers of steps for which either of two positions is followed; none: to the end."""


def extend_plan(progress: SearchState, *, most: int | None = None) -> bool:
    """Extend the plan by orientation, polar points and intersections, the most certain first.

    Args:
        progress: is filled.
        most: largest number of steps; none: until no further point can be reached.

    Returns:
        Whether a point or an orientation was reached.
    """
    steps = 0
    while (most is None or steps < most) and (
        place_clouds(progress) | orient_sets(progress) | place_polar_points(progress)
        or intersect_in_plan(progress, crossing=GOOD_CROSSING_SINE)
        or intersect_in_plan(progress, crossing=MIN_CROSSING_SINE)
    ):
        steps += 1
    return steps > 0


def observed_misfits(progress: SearchState) -> Array:
    """Return the capped misfit of every length, direction and angle; NaN where a point is unknown.

    Misfits of lengths are relative to the length, those of angles are in radians.
    """
    s, plan = progress.survey, progress.plan
    length = progress.lengths()
    d = plan[s.edges.b, :2] - plan[s.edges.a, :2]
    parts = [np.abs(np.hypot(d[:, 0], d[:, 1]) / np.maximum(length, 1e-9) - 1.0)]
    t, a, z = s.directions, s.angles, s.azimuths
    turn = progress.horizon.convergence(plan)
    parts.append(
        np.abs(
            wrap(
                bearing(progress, t.station, t.target)
                - turn[t.station]
                - t.value
                - progress.orientation[t.third]
            )
        )
    )
    parts.append(np.abs(wrap(bearing(progress, z.station, z.target) - turn[z.station] - z.value)))
    parts.append(
        np.abs(
            wrap(
                bearing(progress, a.station, a.third)
                - bearing(progress, a.station, a.target)
                - a.value
            )
        )
    )
    return np.asarray(np.minimum(np.concatenate(parts), MAX_RELATIVE_MISFIT))


def resolve_ambiguity(progress: SearchState, *, mirror: bool) -> bool:
    """Choose one of the two positions of a point by the misfits that follow from each.

    Args:
        progress: is filled.
        mirror: whether any position may be chosen if both fit equally well: the first such
            decision in a network without any angle only chooses one of two mirrored figures.

    Returns:
        Whether a point was decided.
    """
    doubts = ambiguous_positions(progress)[:MAX_TRIED_AMBIGUITIES]
    if not doubts:
        return False
    if mirror and progress.placed.sum() == 2:
        return _decide(progress, doubts[0], 0)
    before = np.isnan(observed_misfits(progress))
    for depth in TRIAL_STEPS:
        for doubt in doubts:
            misfits = [_misfit_after(progress, doubt[0], at, before, depth) for at in doubt[1]]
            best = int(np.argmin(misfits))
            if misfits[1 - best] > MIN_MISFIT_RATIO * misfits[best] + MIN_COMPARED_MISFIT:
                return _decide(progress, doubt, best)
    return mirror and _decide(progress, doubts[0], 0)


def _decide(progress: SearchState, doubt: tuple[int, list[Array]], which: int) -> bool:
    return progress.set_plan(np.array([doubt[0]]), doubt[1][which][None])


def _misfit_after(
    progress: SearchState, point: int, at: Array, before: Mask, depth: int | None
) -> float:
    """Return the mean misfit of the observations that can be computed after a point is placed.

    It includes points that cannot be placed then, because their observations contradict.
    """
    trial = progress.copy()
    trial.set_plan(np.array([point]), at[None])
    extend_plan(trial, most=depth)
    new = observed_misfits(trial)[before]
    new = np.concatenate([new[np.isfinite(new)], contradiction_misfits(trial)])
    return float(new.mean()) if len(new) else 0.0


@dataclass(frozen=True)
class RelativeBlock:
    """A part of the network with its own plan coordinates."""

    progress: SearchState
    """Coordinates and orientations of the block."""
    scaled: bool
    """Whether the coordinates are in metres."""
    mirrored: bool
    """Whether the block may be a mirror image, as it has lengths only."""


def _only_relative(progress: SearchState) -> SearchState:
    """Return a copy without plan, orientations and azimuths; heights are kept."""
    none = np.zeros(0, dtype=np.intp)
    plan = progress.plan.copy()
    plan[:, :2] = np.nan
    return replace(
        progress,
        survey=replace(
            progress.survey,
            azimuths=StationObservations(none, none, np.zeros(0), np.zeros(0), none),
        ),
        plan=plan,
        orientation=np.full_like(progress.orientation, np.nan),
    )


def relative_blocks(progress: SearchState) -> Iterator[RelativeBlock]:
    """Make relative blocks with points that are not yet placed, the best starts first."""
    s = progress.survey
    placed = progress.placed
    covered = np.zeros(len(placed), dtype=bool)
    lengths = progress.lengths()
    angular = bool(s.directions.n or s.angles.n)
    for start in _starts(progress, lengths)[:MAX_BLOCK_STARTS]:
        i, j, group, length = start
        if covered[i] and (j < 0 or covered[j]):
            continue
        block = _only_relative(progress)
        block.plan[i, :2] = 0.0
        if j >= 0:
            block.plan[j, :2] = 0.0, length if np.isfinite(length) else 100.0
        if group >= 0:
            block.orientation[group] = 0.0
        extend_plan(block)
        mirror = j >= 0 and not angular
        decided = mirror
        while resolve_ambiguity(block, mirror=mirror):
            mirror = False
            extend_plan(block)
        if block.placed.sum() < 2:
            continue
        covered |= block.placed
        yield RelativeBlock(block, bool(group >= 0 or np.isfinite(length)), decided)


def _starts(progress: SearchState, lengths: Array) -> list[tuple[int, int, int, float]]:
    """Return starts: station, −1, set, NaN; or two points, −1, their distance (NaN: unknown)."""
    s = progress.survey
    d = s.directions
    starts: list[tuple[int, int, int, float]] = []
    rows, edges = s.edge(d.station, d.target)
    rows = rows[np.isfinite(lengths[edges])]
    for group, n in _by_frequency(d.third[rows]):
        own = rows[d.third[rows] == group]
        if n >= 1:
            starts.append((int(d.station[own[0]]), -1, group, np.nan))
    e = s.edges
    known = np.flatnonzero(np.isfinite(lengths))
    degree = np.bincount(np.concatenate([e.a[known], e.b[known]]), minlength=s.n_points)
    for k in known[np.argsort(-(degree[e.a[known]] + degree[e.b[known]]), kind="stable")]:
        starts.append((int(e.a[k]), int(e.b[k]), -1, float(lengths[k])))
    if not len(known):
        # Without any length: a line of arbitrary length between stations that see each other.
        i = np.concatenate([d.station, s.angles.station])
        j = np.concatenate([d.target, s.angles.target])
        degree = np.bincount(np.concatenate([i, j]), minlength=s.n_points)
        for k in np.argsort(-(degree[i] + degree[j]), kind="stable"):
            starts.append((int(i[k]), int(j[k]), -1, np.nan))
    return starts


def _by_frequency(group: Index) -> list[tuple[int, int]]:
    """Return the groups and the frequency of each, the most frequent first."""
    values, count = np.unique(group, return_counts=True)
    order = np.argsort(-count, kind="stable")
    return [(int(values[k]), int(count[k])) for k in order]


def join_block(progress: SearchState, block: RelativeBlock, *, free: bool) -> bool:
    """Place the points of a block by a plane Helmert transformation over common points.

    Args:
        progress: is filled.
        block: the block.
        free: whether missing shift and rotation may be chosen.

    Returns:
        Whether any point was placed.
    """
    b = block.progress
    new = b.placed & ~progress.placed
    if not new.any():
        return False
    common = np.flatnonzero(b.placed & progress.placed)
    best: tuple[float, Array, Array] | None = None
    for mirror in (False, True) if block.mirrored else (False,):
        plan = b.plan[:, :2] * (np.array([-1.0, 1.0]) if mirror else 1.0)
        fitted = _helmert(progress, block, plan, common, free)
        if fitted is None:
            continue
        misfit, matrix, shift = fitted
        if best is not None:
            if (
                min(best[0], misfit) * MIN_MISFIT_RATIO + MIN_COMPARED_MISFIT > max(best[0], misfit)
                and not free
            ):
                return False
            if best[0] <= misfit:
                continue
        best = misfit, plan @ matrix.T, shift
    if best is None:
        return False
    points = np.flatnonzero(new)
    return progress.set_plan(points, best[1][points] + best[2])


def _helmert(
    progress: SearchState, block: RelativeBlock, plan: Array, common: Index, free: bool
) -> tuple[float, Array, Array] | None:
    """Return misfit, matrix (2, 2) and shift (2,) that transform ``plan``; none: undetermined."""
    target, source = progress.plan[common, :2], plan[common]
    turn, ratio = np.nan, 1.0
    if len(common) >= 2:
        i, j = np.triu_indices(min(len(common), 40), 1)
        a, b = source[j] - source[i], target[j] - target[i]
        la, lb = np.hypot(a[:, 0], a[:, 1]), np.hypot(b[:, 0], b[:, 1])
        long = (la >= 0.3 * la.max()) & (la > 0) & (lb > 0)
        if long.any():
            angles = np.arctan2(b[long, 0], b[long, 1]) - np.arctan2(a[long, 0], a[long, 1])
            turn = median_angle(angles)
            ratio = float(np.median(lb[long] / la[long]))
            if block.scaled:
                if abs(ratio - 1.0) > MAX_RELATIVE_MISFIT:
                    return None
                ratio = 1.0
    elif not block.scaled and not free:
        return None
    if not np.isfinite(turn):
        turn = _turn_by_bearings(progress, block)
    if not np.isfinite(turn) and free:
        turn = 0.0
    if not np.isfinite(turn) or (not len(common) and (progress.placed.any() or not free)):
        return None
    matrix = ratio * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    moved = source @ matrix.T
    shift = np.median(target - moved, axis=0) if len(common) else np.zeros(2)
    size = float(np.ptp(plan[block.progress.placed], axis=0).max()) * ratio + 1e-9
    off = np.hypot(*(moved + shift - target).T) / size if len(common) else np.zeros(1)
    return float(np.minimum(off, MAX_RELATIVE_MISFIT).mean()), matrix, np.asarray(shift)


def _turn_by_bearings(progress: SearchState, block: RelativeBlock) -> float:
    """Return the rotation of a block from azimuths inside it and from known orientations."""
    z = progress.survey.azimuths
    b = block.progress
    hints = z.value - bearing(b, z.station, z.target)
    hints = np.concatenate([hints, progress.orientation - b.orientation])
    hints = hints[np.isfinite(hints)]
    return median_angle(hints) if len(hints) else np.nan


def join_blocks(progress: SearchState, *, free: bool) -> bool:
    """Join the first relative block that fits; with ``free``, start a network without known points.

    Returns:
        Whether any point was placed.
    """
    if progress.placed.all():
        return False
    if free and not progress.placed.any():
        largest = max(
            relative_blocks(progress), key=lambda b: int(b.progress.placed.sum()), default=None
        )
        return largest is not None and join_block(progress, largest, free=True)
    made = []
    for block in relative_blocks(progress):
        if join_block(progress, block, free=False):
            return True
        made.append(block)
    return free and any(join_block(progress, block, free=True) for block in made)


def start_height(progress: SearchState, i: Index) -> bool:
    """Set the first of points ``i`` to height 0 if a free network has no known height.

    Those whose position in plan is known come first: heights of a part that plan does not reach
    would leave both parts without places.
    """
    if not len(i) or np.isfinite(progress.plan[:, 2]).any():
        return False
    known = np.isfinite(progress.plan[i, :2]).all(axis=1)
    first = i[known][:1] if known.any() else i[:1]
    return progress.set_height(first, np.zeros(1))
