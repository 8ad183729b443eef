"""Explanations other than displacements: mistakes, names, copied readings, scale, held points.

- A mistake in one epoch, which its readings alone reveal: a wrong height of an instrument or
  another prism constant bends the points of its epoch. The tests are those of any adjustment.
- The same readings in both epochs: a file that was compared with itself, or copied in part.
- Names that were exchanged: points whose displacements lead to one another's places, and that kept
  their places once the names are exchanged back.
- A point with another name: a point that only the second epoch has, where one lay that only the
  first has.
- A scale: reference points of free networks kept their shape but for one common factor. A distance
  meter does this, and no displacement.
- Held points that moved: everything else then seems to move. Both epochs are adjusted once more as
  free networks, in which held points can be seen to move.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..adjustment import adjust
from ..errors import AdjustmentError
from ..models.similarity import fit_similarity
from ..quality.causes.cause_search import Causes
from ..quality.misleading_readings import likely_causes
from ..quality.reliability import reliability
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from ..types import Array
from .comparison_result import Congruence
from .differences import ONE_EPOCH_ALONE

ADJUSTMENTS_IN_WORDS = {1: ("the common adjustment",), 2: ("the first epoch", "the second epoch")}
"""Words for the adjustments, by their number."""
CAUSE_ADVICE = "put it right before any displacement is believed"
"""What is to be done with a likely cause."""
MAX_PART_LEFT = 0.1
"""Largest distance from the place of another point, relative to the displacement, at which a point
may be that other point."""
MAX_PART_TO_NEXT = 0.01
"""Largest distance of two points of one epoch each, relative to that to the nearest other point, at
which they may be the same."""
MIN_POINTS_HELD = 2
"""Smallest number of held points, of which one alone cannot be seen to move."""
MIN_EQUAL_SHARE = 0.5
"""Smallest part of equal readings of an epoch that is reported: some are equal by chance."""


def epoch_causes(
    solutions: Sequence[Solution], *, estimated: bool, known: bool = False
) -> Iterator[str]:
    """Yield a sentence on what has bent each epoch; nothing of one whose readings fit.

    Nothing is said of a common adjustment: a point that moved between its epochs misfits in it as
    a mistake does.

    Args:
        solutions: the adjustments.
        estimated: whether σ0 is estimated; otherwise it is 1.
        known: whether held points that moved between the epochs have been found, so that a given
            value that is wrong in one of them says nothing new.
    """
    if len(solutions) == 1:
        return
    for which, solution in zip(ADJUSTMENTS_IN_WORDS[len(solutions)], solutions, strict=True):
        found = _causes(solution, estimated)
        if found is None:
            continue
        if (first := found.most_probable) is None:
            for said in found.undecided_sentences:
                yield f"in {which} alone, {said}; {CAUSE_ADVICE}"
        elif first.given is None or not known:
            yield f"{which} alone has a mistake, {found.most_probable_text(str)}; {CAUSE_ADVICE}"


def not_comparable(solutions: Sequence[Solution], *, estimated: bool) -> str:
    """Return why adjustments whose normal equations are singular cannot be compared."""
    ended = [
        f"{which} is not converged: {solution.reason}"
        for which, solution in zip(ADJUSTMENTS_IN_WORDS[len(solutions)], solutions, strict=True)
        if not solution.converged
    ]
    why = [*ended, *epoch_causes(solutions, estimated=estimated)]
    singular = "the normal equations are singular where an adjustment ended"
    return f"the epochs cannot be compared, {singular}{': ' * bool(why)}{'; '.join(why)}"


def _causes(solution: Solution, estimated: bool) -> Causes | None:
    """Return the causes of misfits of an adjustment; none where it has no tests."""
    try:
        rel = (
            reliability(solution, alpha=ALPHA_OF_OBSERVATION, power=POWER_OF_TEST)
            if solution.converged
            else None
        )
        return likely_causes(solution, rel, alpha=ALPHA_OF_OBSERVATION, estimated=estimated)
    except AdjustmentError:
        return None


Compare = Callable[[Solution, Solution, Mapping[str, str]], Congruence]
"""Compares two epochs by names in the second by names in the first."""


def alternative_explanations(
    found: Congruence, compare: Compare, *, estimated: bool
) -> tuple[str, ...]:
    """Return sentences on what may explain the differences instead of displacements.

    Args:
        found: the comparison.
        compare: the same comparison of other solutions, or with other names.
        estimated: whether σ0 is estimated; otherwise it is 1.
    """
    if len(found.solutions) != 2:
        return ()
    held = tuple(_moved_held_points(found, compare))
    own = epoch_causes(found.solutions, estimated=estimated, known=bool(held))
    return (
        *held,
        *own,
        *_exchanged(found, compare),
        *_of_other_names(found),
        *_common_scale(found),
    )


# -- names ----------------------------------------------------------------------------------------


def _exchanged(found: Congruence, compare: Compare) -> Iterator[str]:
    """Yield the sets of points whose names seem exchanged."""
    every = found.displacements
    names, places = list(every), np.array([x.place for x in every.values()]).reshape(-1, 3)
    axes = ["xyz".index(a) for a in found.differences.axes]
    place_of: dict[str, str] = {}
    for name, x in every.items():
        if not x.moved or len(names) < 2:
            continue
        apart = np.linalg.norm((places - x.place - x.vector)[:, axes], axis=1)
        nearest = int(np.argmin(apart))
        if names[nearest] != name and apart[nearest] < MAX_PART_LEFT * x.length:
            place_of[name] = names[nearest]
    later = dict(zip(found.differences.names, found.differences.later, strict=True))
    for ring in _rings(place_of):
        back = {place_of[n]: later[n] for n in ring}
        try:
            again = compare(*_both_solutions(found), {**later, **back})
        except AdjustmentError:
            continue
        left = max(again.displacements[n].length for n in ring)
        moved = max(every[n].length for n in ring)
        if left < MAX_PART_LEFT * moved:
            listed = " and ".join(map(repr, ring)) if len(ring) == 2 else ", ".join(map(repr, ring))
            yield (
                f"the names of {listed} look exchanged in one epoch: they lie within "
                f"{1000 * left:.2f} mm of one another's places, and {moved:.3g} m from their own"
            )


def _rings(leads: Mapping[str, str]) -> Iterator[list[str]]:
    """Yield the rings a → b → … → a of a mapping."""
    seen: set[str] = set()
    for first in leads:
        ring, at = [first], leads[first]
        while at in leads and at not in ring:
            ring.append(at)
            at = leads[at]
        if at == first and not seen.intersection(ring):
            seen.update(ring)
            yield ring


def _both_solutions(found: Congruence) -> tuple[Solution, Solution]:
    first, second = found.solutions
    return first, second


def _of_other_names(found: Congruence) -> Iterator[str]:
    """Yield pairs of points of one epoch each that lie at one place."""
    alone = found.roles.not_compared
    old = [n for n, why in alone.items() if why == ONE_EPOCH_ALONE[0]]
    new = [n for n, why in alone.items() if why == ONE_EPOCH_ALONE[1]]
    if not old or not new:
        return
    first, second = _both_solutions(found)
    moved = _onto_first(found, np.array([second.point(n) for n in new]))
    others = np.concatenate([np.array([first.point(n) for n in old]), *_compared_places(found)])
    for name, at in zip(new, moved, strict=True):
        apart = np.linalg.norm(others - at, axis=1)
        order = np.argsort(apart)
        nearest = int(order[0])
        if nearest >= len(old) or (
            len(order) > 1 and apart[nearest] > MAX_PART_TO_NEXT * apart[order[1]]
        ):
            continue
        yield (
            f"point {name!r} of the second epoch lies {1000 * apart[nearest]:.2f} mm from where "
            f"{old[nearest]!r} of the first was, and neither was compared: give the point one name"
        )


def _compared_places(found: Congruence) -> list[Array]:
    return [x.place[None] for x in found.displacements.values()]


def _onto_first(found: Congruence, points: Array) -> Array:
    """Return points of a free second epoch where the first one has them, by rotation and shift."""
    names = found.stable or tuple(found.displacements)
    if not found.differences.motions.size or not names:
        return points
    first, second = _both_solutions(found)
    later = dict(zip(found.differences.names, found.differences.later, strict=True))
    here = np.array([first.point(n) for n in names])
    there = np.array([second.point(later[n]) for n in names])
    return fit_similarity(there, here, scale=1.0).of(points)


# -- scale and datum ------------------------------------------------------------------------------


def _common_scale(found: Congruence) -> Iterator[str]:
    change = found.scale_change
    if change is None or not found.steps or found.steps[0].test.accepted:
        return
    if change.significant and change.rest.accepted:
        yield (
            f"a scale of {change} between the epochs explains all differences of the reference "
            "points: compare the distance meters and the weather of both epochs before any "
            "displacement is believed"
        )


def _moved_held_points(found: Congruence, compare: Compare) -> Iterator[str]:
    """Yield what a comparison of free networks says of held points, where little else fits."""
    held = found.roles.held
    fits = found.steps and found.stable and found.steps[-1].test.accepted
    if len(held) < MIN_POINTS_HELD or (fits and (found.ratio is None or found.ratio.accepted)):
        return
    later = dict(zip(found.differences.names, found.differences.later, strict=True))
    try:
        first, second = (_released(s, held, found.differences.axes) for s in found.solutions)
        free = compare(first, second, {**later, **{n: n for n in held}})
    except AdjustmentError:
        return
    if not free.fine or not free.stable:
        return
    moved = [n for n in free.moved if n in held]
    if moved:
        told = ", ".join(f"{n!r} by {1000 * free.displacements[n].length:.2f} mm" for n in moved)
        yield (
            f"held points moved, as a free adjustment of both epochs shows, in which the others "
            f"kept their shape: {told}. All displacements refer to them"
        )


def _released(solution: Solution, held: Mapping[str, Array], axes: str) -> Solution:
    """Return the free adjustment of a network in which held points are unknown in some axes.

    Raises:
        AdjustmentError: it has no solution.
    """
    network = solution.network.copy()
    for name in held:
        point = network.points[name]
        network.points[name] = replace(
            point, fixed=("x" not in axes, "y" not in axes, "z" not in axes)
        )
    network.datum = "free"
    return adjust(network, start=solution)


def identical_readings(first: Solution, second: Solution) -> tuple[int, int]:
    """Return how many readings of two epochs are equal, and how many the larger epoch has.

    Readings are equal if they have the same kind and names, and the same numbers to the last digit;
    given values of weighted unknowns do not count.
    """
    a, b = (Counter(_readings(s)) for s in (first, second))
    return (a & b).total(), max(a.total(), b.total())


def _readings(s: Solution) -> Iterator[tuple[object, ...]]:
    for block in s.equations.blocks:
        if block.prior:
            continue
        named = [(kind, s.equations.unknowns[kind].names, index) for kind, index in block.variables]
        for i, values in enumerate(block.observed.tolist()):
            names = tuple((kind, every[index[i]]) for kind, every, index in named)
            yield (block.kind, names, tuple(values))


def identical_readings_note(first: Solution, second: Solution) -> str:
    """Return a sentence on equal readings; empty where few are equal."""
    n, every = identical_readings(first, second)
    if not n or n < MIN_EQUAL_SHARE * every:
        return ""
    if n == every:
        return (
            f"ATTENTION: both epochs have the same {n} readings, digit by digit: one epoch was "
            "compared with itself, and nothing can have moved. Give the other epoch."
        )
    return (
        f"ATTENTION: {n} of {every} readings are the same in both epochs, digit by digit: were "
        "they copied from one epoch to the other?"
    )
