"""Points in plan by intersection and resection: directions, distances and angles mixed."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from ..types import Array
from .loci import CAP, NOISE, SURE, Crossing, Loci, crossings
from .polar import rays
from .progress import Progress

GOOD_CROSSING = 0.3
"""Smallest sine of the crossing angle of an intersection that is used at once."""
LEAST_CROSSING = 0.005
"""Smallest sine of the crossing angle at which loci determine a point."""


def gather(progress: Progress) -> dict[int, Loci]:
    """Return the loci of every point unknown in plan, from known points."""
    s, plan = progress.survey, progress.plan
    placed = progress.placed
    if placed.all():
        return {}
    loci: defaultdict[int, Loci] = defaultdict(Loci)
    r = rays(progress)
    for i, j, angle in zip(r.known.tolist(), r.unknown.tolist(), r.bearing.tolist(), strict=True):
        loci[j].rays.append((plan[i, 0], plan[i, 1], angle))
    e = s.edges
    length = progress.lengths()
    for near, far in ((e.a, e.b), (e.b, e.a)):
        rows = np.flatnonzero(placed[near] & ~placed[far] & np.isfinite(length))
        for i, j, v in zip(near[rows].tolist(), far[rows].tolist(), length[rows], strict=True):
            loci[j].lengths.append((plan[i, 0], plan[i, 1], float(v)))
    d = s.directions
    rows = np.flatnonzero(
        ~placed[d.station] & placed[d.target] & np.isnan(progress.orientation[d.third])
    )
    rows = rows[np.lexsort((d.value[rows], d.third[rows]))]
    groups, first = np.unique(d.third[rows], return_index=True)
    for own in np.split(rows, first[1:]) if len(groups) else []:
        if len(own) > 1:
            loci[int(d.station[own[0]])].rounds.append((plan[d.target[own], :2], d.value[own]))
    a = s.angles
    rows = np.flatnonzero(~placed[a.station] & placed[a.target] & placed[a.third])
    for i, j, k, v in zip(
        a.station[rows], a.target[rows], a.third[rows], a.value[rows], strict=True
    ):
        loci[int(i)].rounds.append((plan[[j, k], :2], np.array([0.0, v])))
    for p, known in loci.items():
        for c in (0, 1):
            if np.isfinite(plan[p, c]):
                known.coordinates.append((c, float(plan[p, c])))
    return loci


def figure_size(own: Loci) -> float:
    """Return the size of the figure of a point and its known points, metres."""
    anchors = own.anchors()
    spread = float(np.ptp(anchors, axis=0).max()) if len(anchors) else 0.0
    reach = max((length for *_, length in own.lengths), default=0.0)
    return max(spread, reach, 1e-6)


def choose(own: Loci, found: list[Crossing]) -> Crossing | None:
    """Return the best candidate; none: the second best fits nearly as well."""
    if not found:
        return None
    best = found[0]
    if len(found) > 1 and found[1].misfit < SURE * best.misfit + NOISE:
        return None
    return best


def intersect(progress: Progress, *, crossing: float) -> bool:
    """Fill points that two or more loci determine uniquely.

    Args:
        progress: is filled.
        crossing: smallest sine of the angle at which the loci cross.

    Returns:
        Whether any point was found.
    """
    led_on = False
    for p, own in gather(progress).items():
        if own.count < 2:
            continue
        best = choose(own, crossings(own, figure_size(own)))
        if best is not None and best.crossing >= crossing:
            led_on |= progress.set_plan(np.array([p]), best.plan[None])
    return led_on


def doubtful(progress: Progress) -> list[tuple[int, list[Array]]]:
    """Return points with two positions that fit equally well, points with most loci first."""
    out: list[tuple[int, int, list[Array]]] = []
    for p, own in gather(progress).items():
        if own.count < 2:
            continue
        found = [c for c in crossings(own, figure_size(own)) if c.crossing >= LEAST_CROSSING]
        if not found:
            continue
        limit = SURE * found[0].misfit + NOISE
        fitting = [c.plan for c in found if c.misfit <= limit]
        if len(fitting) == 2:
            out.append((-own.count, p, fitting))
    return [(p, fitting) for _, p, fitting in sorted(out, key=lambda o: o[:2])]


def contradictions(progress: Progress) -> Array:
    """Return the misfits of the best positions of points with three or more loci."""
    found = []
    for own in gather(progress).values():
        if own.count >= 3:
            options = crossings(own, figure_size(own))
            found.append(options[0].misfit if options else CAP)
    return np.array(found)
