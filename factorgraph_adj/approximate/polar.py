"""Points by direction and distance from known stations, or to known targets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..types import Array, Index
from .orientation import bearing
from .progress import Progress
from .survey import group_median


class Rays(NamedTuple):
    """Known bearings from known to unknown points."""

    known: Index
    """Number of the known point, (n,)."""
    unknown: Index
    """Number of the unknown point, (n,)."""
    bearing: Array
    """Bearing in plan from the known to the unknown point, radians, (n,)."""


def rays(progress: Progress) -> Rays:
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
    return Rays(near, far, angle + turn + np.where(forward, 0.0, np.pi))


def polar(progress: Progress) -> bool:
    """Fill points with a bearing and a length from one known point; the median of several."""
    if not len(progress.survey.edges.key):
        return False
    r = rays(progress)
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
