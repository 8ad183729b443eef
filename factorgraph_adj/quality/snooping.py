"""Data snooping: find gross errors, set them aside, adjust again, until nothing is found.

A round adjusts the network, tests every observation (Baarda's w, or Pope's τ where σ0 is not
known), and sets aside the worst by the rule of `candidates`. Where a round finds nothing more,
those set aside are predicted from the clean solution: what fits is re-admitted, once, and the
search goes on. An image point goes with x and y, a vector with all its components; what counts is
the largest test value of the components.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from ..errors import InputError, Problem
from ..network.network import DatumChoice, Network
from ..solve.batch import adjust
from ..solve.solution import Solution
from ..solve.start import Start
from .levels import ALPHA, POWER
from .rejections import Round, Snooping, Test
from .robust import ESTIMATORS, Estimator, robust_adjust
from .snooping_search import SnoopingSearch


def snoop(
    network: Network,
    *,
    alpha: float = ALPHA,
    power: float = POWER,
    test: Test = "baarda",
    sidak: bool = False,
    share: float = 0.4,
    robust: Estimator | None = None,
    max_rounds: int = 100,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | Start | None = None,
    progress: Callable[[Round], None] | None = None,
) -> Snooping:
    """Find gross errors by iterated tests.

    Every observation can be set aside, control points and weighted unknowns among them: a
    weighted unknown without its given value is free. One without which something would not be
    determined stays in, and is listed as unresolved; but a point that only images see goes with
    all its rays where the other rays alone do not determine it.

    Args:
        network: what was measured; it is not changed.
        alpha: probability α0 of a false alarm of one test.
        power: power of the tests, for the reliability of each round.
        test: ``baarda`` where σ0 = 1 is known, ``pope`` where it is estimated.
        sidak: ``alpha`` is that of all n tests together: α0 = 1 − (1 − α)^(1/n).
        share: observations with test values from this part of the largest on may go in the same
            round, see `candidates`; 1: only the largest of each round.
        robust: set aside what this M-estimator finds first, then snoop: for many gross errors.
        max_rounds: adjustments after which the search stops.
        datum: as for `adjust`.
        variance: as for `adjust`.
        start: an earlier solution of the network to start from.
        progress: called after each round; an exception in it ends the search.

    Raises:
        InputError: unknown choices, probabilities or shares outside (0, 1]; what `adjust` raises.
        DatumError, ApproximationError: as `adjust`, for the whole network.
        AdjustmentError: as `reliability`.
    """
    problems = []
    if test not in ("baarda", "pope"):
        problems.append(f"unknown test {test!r}; valid: baarda, pope")
    if robust is not None and robust not in ESTIMATORS:
        problems.append(f"unknown estimator {robust!r}; valid: {', '.join(ESTIMATORS)}")
    if not 0 < alpha < power < 1:
        problems.append(
            f"alpha and power must lie between 0 and 1, alpha below power: {alpha}, {power}"
        )
    if not 0 < share <= 1:
        problems.append(f"share must lie between 0 and 1, not {share}")
    if max_rounds < 1:
        problems.append(f"max_rounds must be 1 or more, not {max_rounds}")
    if problems:
        raise InputError([Problem(p) for p in problems])
    if robust is None:
        solution = adjust(network, datum=datum, variance=variance, start=start)
        values = None
    else:
        scale: Literal["a-priori", "median"] = "a-priori" if test == "baarda" else "median"
        found = robust_adjust(network, estimator=robust, scale=scale, datum=datum, start=start)
        solution, values = found.solution, found.test_values / found.scale
    if sidak:
        alpha = float(1.0 - (1.0 - alpha) ** (1.0 / solution.equations.n_rows))
    search = SnoopingSearch(solution, test, alpha, power, {"datum": datum, "variance": variance})
    if values is not None:
        search.begin(values, progress)
    reason = search.run(share, max_rounds, progress)
    return search.result(reason)
