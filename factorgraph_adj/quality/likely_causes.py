"""The likely causes of misfits of an adjustment alone, without data snooping.

Names that were exchanged are looked up where sights are far off, and mistakes that bend a block
where rows of a block are; then every cause that has a size is tested, see `causes.search`.
"""

from __future__ import annotations

import numpy as np

from ..solve.solution import Solution
from .causes.block_mistakes import block_mistakes
from .causes.matches import Match
from .causes.search import Causes, causes, exchanges_alone
from .exchanged_names import exchanged_names, sights_far_off
from .reliability import Reliability
from .unit_weight import global_test


def likely_causes(
    solution: Solution, rel: Reliability | None, *, alpha: float, estimated: bool
) -> Causes | None:
    """Return the causes of misfits that several observations share; None where nothing misfits.

    Where σ0 is known, nothing misfits if no test value is critical and the global test is accepted.
    Pope's τ cannot exceed √r: what several observations share may show in none of them, so that
    with an estimated σ0 every cause is tested.

    Args:
        solution: the adjustment, or where it ended.
        rel: its reliability; none: it has none, and exchanges alone are looked up.
        alpha: probability of a false alarm of one test.
        estimated: whether σ0 is estimated; otherwise it is 1.
    """
    matches = _matches(solution, alpha, estimated)
    if rel is None or not solution.converged:
        return exchanges_alone(solution, matches, alpha) if matches else None
    test = global_test(solution)
    fits = test.accepted or test.too_good
    if not estimated and fits and not np.nanmax(np.abs(rel.w), initial=0.0) > rel.critical_w:
        return None
    return causes(rel, matches, estimated=estimated)


def _matches(solution: Solution, alpha: float, estimated: bool) -> list[Match]:
    """Return exchanged names of targets, and mistakes that bend a block."""
    found = [m.match for m in block_mistakes(solution, alpha, estimated=estimated)]
    if sights_far_off(solution):
        every = exchanged_names(solution.network, solution, alpha, estimated=estimated)
        found += [e.match for e in every]
    return found
