"""The likely cause of the misfits of one epoch alone: a mistake that looks as if points had moved.

A wrong height of an instrument or another prism constant bends the points of its epoch. The
readings of this epoch alone tell of it, by the same tests as those of any adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..errors import AdjustmentError
from ..quality.causes.search import Causes
from ..quality.levels import ALPHA, POWER
from ..quality.likely_causes import likely_causes
from ..quality.reliability import reliability
from ..solve.solution import Solution

ADJUSTMENTS = {1: ("the common adjustment",), 2: ("the first epoch", "the second epoch")}
"""Words for the adjustments, by their number."""
BELIEVED = "put it right before any displacement is believed"
"""What is to be done with a likely cause."""


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
    for which, solution in zip(ADJUSTMENTS[len(solutions)], solutions, strict=True):
        found = _causes(solution, estimated)
        if found is None:
            continue
        if (first := found.likeliest) is None:
            for said in found.nothing_tells:
                yield f"in {which} alone, {said}; {BELIEVED}"
        elif first.given is None or not known:
            yield f"{which} alone has a mistake, {found.said_likeliest(str)}; {BELIEVED}"


def not_comparable(solutions: Sequence[Solution], *, estimated: bool) -> str:
    """Return why adjustments whose normal equations are singular cannot be compared."""
    ended = [
        f"{which} is not converged: {solution.reason}"
        for which, solution in zip(ADJUSTMENTS[len(solutions)], solutions, strict=True)
        if not solution.converged
    ]
    why = [*ended, *epoch_causes(solutions, estimated=estimated)]
    singular = "the normal equations are singular where an adjustment ended"
    return f"the epochs cannot be compared, {singular}{': ' * bool(why)}{'; '.join(why)}"


def _causes(solution: Solution, estimated: bool) -> Causes | None:
    """Return the causes of misfits of an adjustment; none where it has no tests."""
    try:
        rel = reliability(solution, alpha=ALPHA, power=POWER) if solution.converged else None
        return likely_causes(solution, rel, alpha=ALPHA, estimated=estimated)
    except AdjustmentError:
        return None
