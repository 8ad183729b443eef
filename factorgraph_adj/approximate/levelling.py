"""Heights by levelled and trigonometric height differences."""

from __future__ import annotations

import numpy as np

from ..types import Array, Index
from .progress import Progress
from .survey import group_median


def height_differences(progress: Progress) -> tuple[Index, Index, Array]:
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


def heights(progress: Progress) -> bool:
    """Fill heights by height differences from points of known height; the median of several."""
    if not np.isnan(progress.plan[:, 2]).any():
        return False
    i, j, rise = height_differences(progress)
    return _carry(progress, i, j, rise)


def _carry(progress: Progress, i: Index, j: Index, rise: Array) -> bool:
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
