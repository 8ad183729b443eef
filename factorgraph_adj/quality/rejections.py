"""Results of data snooping, and what instruments, points and the datum have lost by it.

Gross errors are few. Where data snooping rejects a large part of what one instrument read, its
readings have a mistake in common, or they are right and others are not. Where it rejects most of
what determines a point, and the place of the point changes by far more than its standard deviation,
nothing shows that the readings that stay are the right ones. The same is valid for given
coordinates, control and positions, where so many are rejected that the rest only places the
network.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any, Literal

import numpy as np

from ..errors import AdjustmentError, known
from ..graph.equations import Equations, compile_network
from ..network.network import Network
from ..observations.positions import ControlPoint
from ..observations.registry import KINDS, TOTAL_STATION_QUANTITIES
from ..result_display import Rows, Shown
from ..solve.given_state import solution_at_given_values
from ..solve.solution import Solution
from ..start.start_values import Start
from ..types import Array, Mask
from .causes.cause_search import Causes
from .group_tests import Test
from .reliability import Reliability, reliability

MAX_LOST_SHARE = 1.0 / 3.0
"""Largest share of its readings that an instrument loses to gross errors of single readings."""
MIN_LOST_READINGS = 6
"""Smallest number of readings rejected of an instrument: two sights with all they consist of."""
MIN_KEPT_SHARE = 0.5
"""Smallest share of its observations that a point keeps."""
MAX_POINTS_IN_LOSS = 6
"""Largest number of points that a sentence names."""
MAX_POINT_CHANGE_SIGMAS = 10.0
"""Largest change of the place of such a point, in its standard deviations."""


@dataclass(frozen=True)
class Rejected:
    """An observation that was rejected, with the component that misfits most.

    It is that of the largest ``final_test``: where gross errors bend the adjustment, another may
    have the largest test value. Where the clean solution does not determine the observation, it is
    that of the largest ``test``.
    """

    id: str
    """Id of the observation."""
    kind: str
    """Kind of the observation."""
    label: str
    """Readable name with the component, and the source."""
    component: str
    """The component, empty for scalar kinds."""
    test: float
    """Test value of the component, w or τ, in the adjustment with the observation."""
    estimated_error: float
    """Estimated gross error of the component, observed − true, in the same adjustment."""
    round: int
    """Round in which the observation was rejected; 0: before the first, by the start."""
    final_error: float
    """Observed − computed from the clean solution; NaN if that solution does not determine it."""
    final_sigma: float
    """Standard deviation of ``final_error`` without a gross error, a-priori σ0 = 1."""
    final_test: float
    """Test value of the observation put back into the clean solution: w or τ."""
    inseparable: tuple[tuple[str, float], ...]
    """Labels of inseparable observations at that round, with the correlations."""


@dataclass(frozen=True)
class RejectedFactor:
    """A factor of the user that was rejected, with all its rows."""

    name: str
    """Name of the factor."""
    test: float
    """√(T²/critical) in the adjustment with it; above 1. For Pope's test T² is relative to σ̂0²."""
    round: int
    """Round in which it was rejected."""
    final_test: float
    """√(T²/critical) of the factor put back into the clean solution."""


@dataclass(frozen=True)
class Unresolved:
    """An observation above the critical value that stays in the adjustment."""

    id: str
    """Id of the observation."""
    kind: str
    """Kind of the observation."""
    label: str
    """Readable name with the component of the largest test value, and the source."""
    component: str
    """Component with the largest test value, empty for scalar kinds."""
    test: float
    """Test value, w or τ."""
    estimated_error: float
    """Estimated gross error, observed − true."""
    reason: str
    """Reason why the observation stays."""


@dataclass(frozen=True)
class RejectedPoint:
    """A point that was removed with all its rays."""

    name: str
    """Name of the point."""
    rays: tuple[str, ...]
    """Ids of the rays removed with the point; its other rays were rejected before."""
    label: str
    """Label of the ray with the largest test value."""
    test: float
    """Largest test value, w or τ."""
    round: int
    """Round in which the point was removed; 0: before the first, by the start."""
    reason: str
    """Reason why the whole point was removed."""


@dataclass(frozen=True)
class Round:
    """One round of the search."""

    number: int
    """Number of the round."""
    sigma0: float
    """σ̂0 before the round rejects anything."""
    largest: float
    """Largest |test value|."""
    suspects: int
    """Number of observations above the critical value."""
    set_aside: int
    """Number of observations rejected in the round, including the rays of removed points."""
    readmitted: int
    """Number of observations put back in the round."""


@dataclass(frozen=True, eq=False, repr=False)
class Snooping(Shown):
    """Result of data snooping."""

    solution: Solution
    """The adjustment without the observations that were rejected (the clean solution)."""
    reliability: Reliability
    """Reliability of ``solution``, with α0 and power of the tests."""
    rejected: tuple[Rejected, ...]
    """Rejected observations, in that order, without the rays of removed points."""
    readmitted: tuple[str, ...]
    """Ids of observations that fitted and were put back, including those rejected again later."""
    rejected_points: tuple[RejectedPoint, ...]
    """Points removed with all their rays, since the remaining rays did not determine them."""
    unresolved: tuple[Unresolved, ...]
    """Observations above the critical value that cannot be rejected."""
    rounds: tuple[Round, ...]
    """The rounds of the search."""
    critical: float
    """Critical value of the last round."""
    test: Test
    """Test that decides."""
    reason: str
    """Reason why the search ended."""
    rejected_factors: tuple[RejectedFactor, ...] = ()
    """Factors of the user that were rejected, in that order."""
    whole: Solution | None = field(default=None, repr=False)
    """The adjustment of everything; None where it has no minimum."""
    look: Callable[[], Causes | None] | None = field(default=None, repr=False)
    """Looks for the causes of the misfits; None: they were not asked for before pickling."""

    def headline(self) -> str:
        """Return the numbers of rejected observations and points, and why the search ended."""
        counts = [
            (len(self.rejected), "observation"),
            (len(self.rejected_points), "point"),
            (len(self.rejected_factors), "factor"),
        ]
        parts = [f"{n} {noun}{'s' * (n != 1)}" for n, noun in counts if n] or ["nothing"]
        return (
            f"Snooping: {' and '.join(parts)} rejected, {len(self.unresolved)} unresolved, "
            f"σ̂0 {self.solution.sigma0:.4f}; {self.reason}"
        )

    def first_rows(self) -> Rows:
        """Return the observations that were rejected."""
        return Rows(
            ("observation", "test value", "estimated error", "round"),
            ((r.label, r.test, r.estimated_error, r.round) for r in self.rejected),
            len(self.rejected),
        )

    def summary(self) -> str:
        """Return the result on one screen, with what was rejected; see `Solution.summary`."""
        # Reports are above this module.
        found: str = import_module("factorgraph_adj.report.summary").snooping_summary(self)
        return found

    @property
    def at_the_start(self) -> Literal["robust", "before"]:
        """What rejected observations before the first round: a robust adjustment, or the start."""
        return "robust" if any(r.number == 0 for r in self.rounds) else "before"

    @cached_property
    def causes(self) -> Causes | None:
        """What may have caused the misfits, the most probable first; None where there are none."""
        return None if self.look is None else self.look()

    def __getstate__(self) -> dict[str, Any]:
        """Return the data for pickles: with the causes if they have been asked for."""
        return self.__dict__ | {"look": None}

    @property
    def rejected_ids(self) -> tuple[str, ...]:
        """Ids of all observations rejected, the rays of removed points among them."""
        rays = (ray for p in self.rejected_points for ray in p.rays)
        return (*(r.id for r in self.rejected), *rays)

    @property
    def first_name(self) -> str:
        """Label of the first observation rejected, or of the worst ray of the first point.

        It is empty where nothing was rejected.
        """
        names = [r.label for r in self.rejected[:1]] + [p.label for p in self.rejected_points[:1]]
        return names[0] if names else ""

    @property
    def network(self) -> Network:
        """The network without the observations that were rejected."""
        return self.solution.network


@dataclass(frozen=True)
class GroupLoss:
    """A group of which much was rejected."""

    noun: str
    """What it is: frame, station, photo or point."""
    name: str
    """Its name."""
    lost: int
    """Number of its observations rejected."""
    whole: int
    """Number of its observations."""
    moved: float = 0.0
    """Change of a point, in its standard deviations; 0 for groups of readings."""

    def __str__(self) -> str:
        """Return the loss as a sentence without a stop."""
        text = f"of {self.noun} {self.name!r} {self.lost} of {self.whole} observations were "
        text += "rejected"
        if np.isfinite(self.moved) and self.moved:
            text += f", and by that it moved by {self.moved:.0f} times its standard deviation"
        return text


def group_losses(
    found: Snooping, original: Network, whole: Solution | None
) -> tuple[GroupLoss, ...]:
    """Return the groups of which data snooping has rejected much, those that lost most first.

    Args:
        found: the result of data snooping.
        original: the network before it.
        whole: the adjustment of everything, against which points are compared; None: points count
            however far they moved.
    """
    aside = set(found.rejected_ids)
    if not aside:
        return ()
    readings, points = _members(original)
    out = [
        GroupLoss(noun, name, lost, n)
        for (noun, name), ids in readings.items()
        for lost, n in [(len(aside.intersection(ids)), len(ids))]
        if lost >= MIN_LOST_READINGS and lost > MAX_LOST_SHARE * n
    ]
    removed = {p.name for p in found.rejected_points}
    for name, ids in points.items():
        lost = len(aside.intersection(ids))
        if name in removed or lost < 2 or len(ids) - lost >= MIN_KEPT_SHARE * len(ids):
            continue
        moved = _moved(name, found.solution, whole)
        if moved > MAX_POINT_CHANGE_SIGMAS:
            out.append(GroupLoss("point", name, lost, len(ids), moved))
    return tuple(sorted(out, key=lambda loss: -loss.lost / loss.whole))


@dataclass(frozen=True)
class UncontrolledDatum:
    """Given coordinates that place the network, controlled by nothing after others have gone."""

    lost: int
    """Number of rejected observations of coordinates."""
    left: int
    """Number of scalar coordinates that are left."""

    def __str__(self) -> str:
        """Return it as a sentence without a stop."""
        were = "1 given coordinate was" if self.lost == 1 else f"{self.lost} given coordinates were"
        rest = "the one that is left places" if self.left == 1 else f"the {self.left} left place"
        return (
            f"{were} rejected, and {rest} the network without control: it is not known which of "
            "them are right (axes exchanged, another system, wrong names?)"
        )


def uncontrolled_datum(found: Snooping) -> UncontrolledDatum | None:
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
    return UncontrolledDatum(len(lost), left)


@dataclass(frozen=True)
class RejectedCoordinates:
    """Weighted coordinates of points that were rejected, though the points have other readings.

    A gross error of given coordinates and another mark that was observed in place of the point
    leave the same misfits: no reading distinguishes them.
    """

    points: tuple[str, ...]
    """Names of the points."""

    def __str__(self) -> str:
        """Return it as a sentence without a stop."""
        named = known(map(repr, self.points), most=MAX_POINTS_IN_LOSS)
        noun = "point" if len(self.points) == 1 else "points"
        return (
            f"given coordinates of {noun} {named} were rejected: they are wrong, or another mark "
            "was observed under that name; the readings do not determine which"
        )


def rejected_coordinates(found: Snooping, original: Network) -> RejectedCoordinates | None:
    """Return the points whose weighted coordinates data snooping rejected; None: there are none.

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
    return RejectedCoordinates(tuple(sorted(points)))


@dataclass(frozen=True)
class LostControl:
    """Points of which what is left is controlled by nothing, after others have gone."""

    points: tuple[str, ...]
    """Names of the points."""
    rows: int
    """Number of scalar observations that have lost their control."""

    def __str__(self) -> str:
        """Return it as a sentence without a stop."""
        named = known(map(repr, self.points), most=MAX_POINTS_IN_LOSS)
        noun, them = ("point", "it") if len(self.points) == 1 else ("points", "them")
        return (
            f"gross errors took the control of {noun} {named} away: {self.rows} of the "
            f"readings that are left of {them} are controlled by nothing, so that it is "
            "not known whether the wrong ones were rejected"
        )


def lost_control(found: Snooping, original: Network) -> LostControl | None:
    """Return the points whose control data snooping has rejected; None: there are none.

    An observation has lost its control if others control it in the whole network, and none do in
    the clean one: then its error and that of what was rejected change all others alike. Points
    that only images observe do not count: a block has many of two rays, whose depth nothing
    controls.

    Args:
        found: the result of data snooping.
        original: the network before it.
    """
    clean, controlled = found.solution, found.reliability.controlled
    aside = found.rejected_ids
    if not aside or controlled.all():
        return None
    left = clean.equations
    rows = np.flatnonzero(~controlled)
    whole = _whole_at_clean_solution(found, original)
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


def _whole_at_clean_solution(found: Snooping, original: Network) -> Solution | None:
    """Return the whole network at the clean solution, where gross errors have bent nothing."""
    if found.solution.datum is not None:
        return found.whole
    equations = compile_network(original)
    start = Start.of(found.solution).for_unknowns(equations.unknowns)
    return (
        None
        if start is None
        else solution_at_given_values(equations, start, None, reason="", doubt="")
    )


def _points_of_rows(
    equations: Equations, controlled: Mask, rows: Sequence[int]
) -> tuple[Array, list[list[int]]]:
    """Return the number of controlled rows of each point, and the free points of some rows."""
    table = equations.unknowns["point"]
    counts = np.zeros(len(table.names))
    own: dict[int, list[int]] = defaultdict(list)
    for block in equations.blocks:
        if block.image:
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
        elif o.record.quantity in TOTAL_STATION_QUANTITIES:
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
