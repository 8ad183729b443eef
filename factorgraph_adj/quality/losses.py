"""What data snooping has taken from whole groups: much of an instrument, or of what fixes a point.

Gross errors are few. Where a large part of what one instrument read is set aside, its readings have
a mistake in common, or they are right and others are not. Where most of what determines a point is
set aside and its place changes by far more than its standard deviation, nothing tells that those
readings that stay are the right ones. The same holds of given coordinates, control and positions,
where so many are set aside that those that stay only place the network.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from ..errors import AdjustmentError
from ..network.network import Network
from ..observations.registry import KINDS
from ..solve.solution import Solution
from ..types import Array
from .causes.hypotheses import SIGHTS
from .rejections import Snooping

PART = 1.0 / 3.0
"""Largest share of its readings that an instrument loses to gross errors of single readings."""
LEAST = 6
"""Smallest number of readings set aside of an instrument: two sights with all they consist of."""
KEPT = 0.5
"""Smallest share of its observations that a point keeps."""
MOVED = 10.0
"""Largest change of the place of such a point, in its standard deviations."""


@dataclass(frozen=True)
class Loss:
    """A group of which much was set aside."""

    noun: str
    """What it is: frame, station, photo or point."""
    name: str
    """Its name."""
    lost: int
    """Number of its observations set aside."""
    whole: int
    """Number of its observations."""
    moved: float = 0.0
    """Change of a point, in its standard deviations; 0 for groups of readings."""

    def __str__(self) -> str:
        """Return the loss as a sentence without a stop."""
        text = f"of {self.noun} {self.name!r} {self.lost} of {self.whole} observations were set "
        text += "aside"
        if np.isfinite(self.moved) and self.moved:
            text += f", and by that it moved by {self.moved:.0f} times its standard deviation"
        return text


def losses(found: Snooping, original: Network, whole: Solution | None) -> tuple[Loss, ...]:
    """Return the groups of which data snooping has set much aside, those that lost most first.

    Args:
        found: the result of data snooping.
        original: the network before it.
        whole: the adjustment of everything, against which points are compared; none: points count
            however far they moved.
    """
    aside = set(found.ids_set_aside)
    if not aside:
        return ()
    readings, points = _members(original)
    out = [
        Loss(noun, name, lost, n)
        for (noun, name), ids in readings.items()
        for lost, n in [(len(aside.intersection(ids)), len(ids))]
        if lost >= LEAST and lost > PART * n
    ]
    removed = {p.name for p in found.points_set_aside}
    for name, ids in points.items():
        lost = len(aside.intersection(ids))
        if name in removed or lost < 2 or len(ids) - lost >= KEPT * len(ids):
            continue
        moved = _moved(name, found.solution, whole)
        if moved > MOVED:
            out.append(Loss("point", name, lost, len(ids), moved))
    return tuple(sorted(out, key=lambda loss: -loss.lost / loss.whole))


@dataclass(frozen=True)
class BarePlace:
    """Given coordinates that place the network, controlled by nothing after others have gone."""

    lost: int
    """Number of observations of coordinates set aside."""
    left: int
    """Number of scalar coordinates that are left."""

    def __str__(self) -> str:
        """Return it as a sentence without a stop."""
        were = "1 given coordinate was" if self.lost == 1 else f"{self.lost} given coordinates were"
        rest = "the one that is left places" if self.left == 1 else f"the {self.left} left place"
        return (
            f"{were} set aside, and {rest} the network without control: nothing tells which of "
            "them are right (axes exchanged, another system, wrong names?)"
        )


def bare_place(found: Snooping) -> BarePlace | None:
    """Return what is left of given coordinates, if data snooping took all control from them.

    Args:
        found: the result of data snooping.
    """
    lost = [r for r in found.rejected if r.kind in KINDS and KINDS[r.kind].fixes == "coordinates"]
    if not lost:
        return None
    controlled = found.reliability.controlled
    own = [b.rows for b in found.solution.equations.blocks if b.fixes == "coordinates"]
    left = sum(rows.stop - rows.start for rows in own)
    if not left or any(controlled[rows].any() for rows in own):
        return None
    return BarePlace(len(lost), left)


def _members(network: Network) -> tuple[dict[tuple[str, str], list[str]], dict[str, list[str]]]:
    """Return the ids of the observations of each instrument, and of each point.

    An instrument is a frame, the station of a sight, or a photo.
    """
    readings: dict[tuple[str, str], list[str]] = defaultdict(list)
    points: dict[str, list[str]] = defaultdict(list)
    for ident, o in network.observations.items():
        if frames := o.frames():
            readings["frame", frames[0]].append(ident)
        elif o.kind in SIGHTS:
            readings["station", o.points()[0]].append(ident)
        for point in dict.fromkeys(o.points()):
            points[point].append(ident)
    for ray in network.image_points():
        ident = ray.id or f"{ray.photo}/{ray.point}"
        readings["photo", ray.photo].append(ident)
        points[ray.point].append(ident)
    return readings, points


def _moved(name: str, clean: Solution, whole: Solution | None) -> float:
    """Return the distance between two places of a point, in the largest σ of the clean one."""
    if whole is None or not whole.converged:
        return np.inf
    try:
        sigma: Array = clean.standard_deviations(name)
    except AdjustmentError:
        return np.inf
    size = float(np.max(sigma))
    return float(np.linalg.norm(clean.point(name) - whole.point(name))) / size if size else 0.0
