"""What data snooping has taken from whole groups: much of an instrument, or of what fixes a point.

Gross errors are few. Where a large part of what one instrument read is set aside, its readings have
a mistake in common, or they are right and others are not. Where most of what determines a point is
set aside and its place changes by far more than its standard deviation, nothing tells that those
readings that stay are the right ones. The same holds of given coordinates, control and positions,
where so many are set aside that those that stay only place the network.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import AdjustmentError
from ..graph.equations import Equations, compile_network
from ..network.network import Network
from ..observations.positions import ControlPoint
from ..observations.registry import KINDS
from ..solve.solution import Solution
from ..solve.standing import standing
from ..solve.start import Start
from ..types import Array, Mask
from .causes.hypotheses import SIGHTS
from .rejections import Snooping
from .reliability import reliability

PART = 1.0 / 3.0
"""Largest share of its readings that an instrument loses to gross errors of single readings."""
LEAST = 6
"""Smallest number of readings set aside of an instrument: two sights with all they consist of."""
KEPT = 0.5
"""Smallest share of its observations that a point keeps."""
NAMED = 6
"""Largest number of points that a sentence names."""
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


@dataclass(frozen=True)
class GivenCoordinates:
    """Weighted coordinates of points that were set aside, though the points have other readings.

    A gross error of given coordinates and another mark that was observed in place of the point
    leave the same misfits: no reading tells the one from the other.
    """

    points: tuple[str, ...]
    """Names of the points."""

    def __str__(self) -> str:
        """Return it as a sentence without a stop."""
        named = ", ".join(repr(p) for p in self.points[:NAMED])
        if more := len(self.points) - NAMED:
            named += f" and {more} more" if more > 0 else ""
        noun = "point" if len(self.points) == 1 else "points"
        return (
            f"given coordinates of {noun} {named} were set aside: they are wrong, or another mark "
            "was observed under that name; the readings do not tell which"
        )


def given_coordinates(found: Snooping, original: Network) -> GivenCoordinates | None:
    """Return the points whose weighted coordinates data snooping set aside; none: there are none.

    Args:
        found: the result of data snooping.
        original: the network before it.
    """
    aside = [r.id for r in found.rejected if r.kind == ControlPoint.kind]
    if not aside:
        return None
    equations = compile_network(original)
    rows = np.concatenate(equations.find(aside))
    names = equations.unknowns["point"].names
    points: set[str] = set()
    for block in equations.blocks:
        if block.kind == ControlPoint.kind:
            ((_, index),) = block.variables
            inside = rows[(rows >= block.rows.start) & (rows < block.rows.stop)]
            points |= {names[p] for p in index[(inside - block.first_row) // block.dimension]}
    return GivenCoordinates(tuple(sorted(points)))


@dataclass(frozen=True)
class LostControl:
    """Points of which what is left is controlled by nothing, after others have gone."""

    points: tuple[str, ...]
    """Names of the points."""
    rows: int
    """Number of scalar observations that have lost their control."""

    def __str__(self) -> str:
        """Return it as a sentence without a stop."""
        named = ", ".join(repr(p) for p in self.points[:NAMED])
        more = f", … {len(self.points)} in all" if len(self.points) > NAMED else ""
        noun, them = ("point", "it") if len(self.points) == 1 else ("points", "them")
        return (
            f"gross errors took the control of {noun} {named}{more} away: {self.rows} of the "
            f"readings that are left of {them} are controlled by nothing, so that nothing "
            "tells whether the wrong ones were set aside"
        )


def lost_control(found: Snooping, original: Network) -> LostControl | None:
    """Return the points whose control data snooping has set aside; none: there are none.

    An observation has lost its control if others control it in the whole network, and none do in
    the clean one: then its error and that of what was set aside change all others alike. Points
    that only images observe do not count: a block has many of two rays, whose depth nothing
    controls.

    Args:
        found: the result of data snooping.
        original: the network before it.
    """
    clean, controlled = found.solution, found.reliability.controlled
    aside = found.ids_set_aside
    if not aside or controlled.all():
        return None
    left = clean.equations
    rows = np.flatnonzero(~controlled)
    whole = _whole(found, original)
    if whole is None:
        return None
    equations, before = whole.equations, reliability(whole).controlled
    ids = [left.id(int(row)) for row in rows]
    lost = []
    for row, own in zip(rows.tolist(), equations.find(ids), strict=True):
        place = row - int(left.find([left.id(row)])[0][0])
        if len(own) and before[own[place]]:
            lost.append(row)
    counts, touched = _points_of_rows(left, controlled, lost)
    names = left.unknowns["point"].names
    points = dict.fromkeys(names[min(own, key=lambda p: counts[p])] for own in touched if own)
    return LostControl(tuple(sorted(points)), len([t for t in touched if t])) if points else None


def _whole(found: Snooping, original: Network) -> Solution | None:
    """Return the whole network at the clean solution, where gross errors have bent nothing."""
    if found.solution.datum is not None:
        return found.whole
    equations = compile_network(original)
    start = Start.of(found.solution).carried_to(equations.unknowns)
    return None if start is None else standing(equations, start, None, reason="", doubt="")


def _points_of_rows(
    equations: Equations, controlled: Mask, rows: Sequence[int]
) -> tuple[Array, list[list[int]]]:
    """Return the number of controlled rows of each point, and the free points of some rows."""
    table = equations.unknowns["point"]
    counts = np.zeros(len(table.names))
    own: dict[int, list[int]] = defaultdict(list)
    for block in equations.blocks:
        if block.kind == "image":
            continue
        fine = controlled[block.rows].reshape(block.n, block.dimension)
        for kind, index in block.variables:
            if kind != "point":
                continue
            np.add.at(counts, index, fine.sum(axis=1))
            for row in rows:
                if block.rows.start <= row < block.rows.stop:
                    p = int(index[(row - block.first_row) // block.dimension])
                    own[row] += [p] if table.free[p].any() else []
    return counts, [own[row] for row in rows]


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
