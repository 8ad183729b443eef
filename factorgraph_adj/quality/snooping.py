"""Data snooping by iterated tests: `snoop`; choice of its start, also one without misfitting rays.

A round tests every observation (Baarda's w, or Pope's τ if σ0 is unknown), and rejects the worst
observations by the rule of `snooping_candidates`. After a round without a new gross error, the
network is adjusted without the rejected observations, and these are predicted from the clean
solution. An observation that fits is put back, at most once, and the search continues until nothing
changes. An observation is rejected with all its components, by their largest test value.

The start of a block that is oriented from image points alone names the image points that do not
agree with it. With them the network has no minimum: a point of two rays that do not meet lies at
infinity or behind a photo. So they are rejected before the first round, and are examined afterwards
as all other rejected observations: what fits the clean solution is put back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..adjustment import adjust
from ..blas_threads import with_one_thread
from ..errors import AdjustmentError, DatumError, InputError, Problem, known, taking
from ..graph.equations import Equations, compile_network
from ..graph.listed_points import with_listed_points_apart
from ..graph.observation_selection import without
from ..network.network import DatumChoice, Network
from ..observations.base import joined_points
from ..orientation.choice_of_start import (
    given_or_image_start,
    image_start,
    misses_minimum,
    noted_error,
    with_doubtful_image_points,
)
from ..solve.added_factors import AddedFactors, ExtraFactors
from ..solve.minimum import DEFAULT_MAX_ITERATIONS
from ..solve.solution import Solution
from ..start.start_values import Start
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from ..types import Array
from .causes.block_mistakes import BlockMistake, block_mistakes
from .causes.mistaken_identity import MistakenIdentity
from .group_tests import Test
from .misleading_readings import (
    exchanged_names,
    has_far_off_sights,
    is_misled,
    simpler_result,
    start_at_approximate_values,
    start_without_exchanges,
)
from .rejections import RejectedPoint, Round, Snooping
from .robust_estimation import ESTIMATORS, Estimator, robust_adjust
from .snooping_search import CannotSettle, SnoopingSearch
from .snooping_state import rejected_components

LOST_POINT_REASON = "fewer than two of its rays agree with the others"
"""Reason that a point is removed at the start."""


def clean_adjustment(network: Network, start: Start, options: dict[str, Any]) -> Solution:
    """Adjust a network without the image points that do not agree with its start."""
    lost = _lost_points(network, start)
    equations = compile_network(network)
    rays = _rays(equations, lost)
    gone = {ray for own in rays.values() for ray in own}
    ids = [i for i in start.doubtful if i not in gone]
    return adjust(without(network, ids, points=lost), start=start, **options)


def clean_search(
    network: Network,
    start: Start,
    clean: Solution,
    *,
    test: Test,
    alpha: float,
    power: float,
    options: dict[str, Any],
    withdrawing: bool,
) -> SnoopingSearch:
    """Return a search of data snooping that begins with a clean adjustment.

    Args:
        network: the whole network.
        start: its start, which names the image points that do not agree.
        clean: its adjustment without them, see `clean_adjustment`.
        test: as for `SnoopingSearch`.
        alpha: as there.
        power: as there.
        options: as there.
        withdrawing: as there.
    """
    search = SnoopingSearch(clean, test, alpha, power, options, withdrawing=withdrawing)
    equations = compile_network(network)
    moved = start.for_unknowns(equations.unknowns)
    assert moved is not None
    with np.errstate(all="ignore"):
        v = np.nan_to_num(equations.residuals(moved.state))
        raw = np.nan_to_num(equations.residuals(moved.state, whitened=False))
    rays = _rays(equations, _lost_points(network, start))
    of_points = {ray for own in rays.values() for ray in own}
    search.network, search.equations, search.whole = network, equations, None
    search.start = moved.origin["point"]
    for ident in start.doubtful:
        if ident not in of_points:
            every = rejected_components(equations, equations.find([ident])[0], v, -raw, 0)
            search.components[ident] = every
            search.aside[ident] = max(every, key=lambda r: abs(r.test))
    for name, own in rays.items():
        rows = np.concatenate(equations.find(own))
        worst = int(rows[np.argmax(np.abs(v[rows]))])
        number = equations.unknowns["point"].number[name]
        search.coordinates[name] = moved.state["point"][number]
        label = equations.label(worst)
        search.points[name] = RejectedPoint(name, own, label, float(v[worst]), 0, LOST_POINT_REASON)
    return search


def _lost_points(network: Network, start: Start) -> tuple[str, ...]:
    """Return the points that leave with all their rays: nothing else observes them."""
    observed = joined_points(network.observations.values())
    return tuple(p for p in start.unreached if p not in observed)


def _rays(equations: Equations, points: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the ids of the image points of each of some points."""
    number = equations.unknowns["point"].number
    out: dict[int, list[str]] = {number[p]: [] for p in points}
    for block in equations.blocks if points else ():
        if not block.image:
            continue
        at = block.variables[2][1]
        for i in np.flatnonzero(np.isin(at, list(out))).tolist():
            out[int(at[i])].append(equations.id(block.first_row + 2 * i))
    return {p: tuple(out[number[p]]) for p in points}


@taking(Network)
@with_one_thread
def snoop(
    network: Network,
    *,
    alpha: float = ALPHA_OF_OBSERVATION,
    power: float = POWER_OF_TEST,
    test: Test = "baarda",
    sidak: bool = False,
    share: float = 0.4,
    robust: Estimator | None = None,
    max_rounds: int = 100,
    max_iterations: int = DEFAULT_MAX_ITERATIONS,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | Start | None = None,
    extra_factors: ExtraFactors = (),
    progress: Callable[[Round], None] | None = None,
) -> Snooping:
    """Find gross errors by iterated tests.

    Every observation can be rejected, also control points and weighted unknowns: a weighted
    unknown without its given value is free. An observation that some unknown needs to be
    determined stays in the network and is listed as unresolved. A point that only images observe
    is removed with all its rays, if its other rays do not determine it.

    Args:
        network: the network; it is not changed.
        alpha: probability α0 of a false alarm of one test.
        power: power of the tests, for the reliability of each round.
        test: ``baarda`` for the known σ0 = 1, ``pope`` for an estimated σ0.
        sidak: whether ``alpha`` refers to all n tests together: α0 = 1 − (1 − α)^(1/n).
        share: part of the largest test value that others must reach to be rejected in the same
            round, see `candidates`; 1: only the largest of each round.
        robust: M-estimator for networks with many gross errors; the outliers of its adjustment
            are rejected before the first round. Without one, Huber's is used where the network
            as it is has no minimum, or where readings have such large errors that they may have
            misled the search (`has_far_off_sights`): it is then repeated from approximate values.
        max_rounds: maximum number of rounds.
        max_iterations: largest number of iterations of each adjustment, as for `adjust`.
        datum: as for `adjust`.
        variance: as for `adjust`.
        start: an earlier solution of the network to start from, if it has converged.
        extra_factors: as for `adjust`. A factor is tested with all its rows (T²), and is rejected
            as a whole; not with a robust estimator.
        progress: called after each round; an exception in it ends the search.

    Raises:
        InputError: unknown choices, probabilities or shares outside (0, 1]; factors with a robust
            estimator; errors of `adjust`.
        DatumError, ApproximationError: as `adjust`, for the whole network.
        AdjustmentError: as `reliability`; the network has no minimum with factors.
    """
    problems = []
    if test not in ("baarda", "pope"):
        problems.append(f"unknown test {test!r}; valid: {known(('baarda', 'pope'), meant=test)}")
    if robust is not None and robust not in ESTIMATORS:
        problems.append(f"unknown estimator {robust!r}; valid: {known(ESTIMATORS, meant=robust)}")
    if not 0 < alpha < power < 1:
        problems.append(
            f"alpha and power must lie between 0 and 1, alpha below power: {alpha}, {power}"
        )
    if not 0 < share <= 1:
        problems.append(f"share must lie between 0 and 1, not {share}")
    if max_rounds < 1:
        problems.append(f"max_rounds must be 1 or more, not {max_rounds}")
    if not extra_factors:  # keys of factors are those of the network as it is
        network = with_listed_points_apart(network)
    extra = AddedFactors.of(extra_factors, network)
    if extra.factors and robust is not None:
        problems.append("there is no robust estimator with factors: leave robust out")
    if problems:
        raise InputError([Problem(p) for p in problems])
    if isinstance(start, Solution) and not start.converged:
        start = None  # nothing leads back from where it ended
    options: dict[str, Any] = {
        "datum": datum,
        "variance": variance,
        "max_iterations": max_iterations,
    }
    given, start = start, given_or_image_start(network, datum, start)
    searching = _SearchArguments(
        network, test, alpha, power, sidak, options, share, max_rounds, progress
    )
    plain = robust is None and not extra.factors and given is None
    if plain and isinstance(start, Start) and start.doubtful:
        return searching.run_beside(start)[1]
    first: Solution | None = None
    failure: InputError | DatumError | None = None
    from_images: Snooping | None = None
    mistakes: tuple[BlockMistake, ...] = ()
    if robust is None:
        try:
            first = adjust(network, start=start, extra_factors=extra, **options)
        except (InputError, DatumError) as error:
            failure = error
        if plain and first is not None:
            mistakes = block_mistakes(first, searching.alpha, estimated=test == "pope")
        aside = tuple(i for m in mistakes for i in m.aside)
        if aside:
            beside = replace(Start.of(mistakes[0].solution), doubtful=aside)
            return searching.run_beside(beside, [m.match for m in mistakes])[1]
        lost = first is None or misses_minimum(first)
        if plain and lost and (start_again := image_start(network, datum)) is not None:
            with suppress(AdjustmentError):
                from_images = searching.run_beside(start_again, [m.match for m in mistakes])[1]
        if from_images is not None and (failure is not None or not from_images.unresolved):
            return from_images
        if failure is not None:
            raise failure
        assert first is not None
        if extra.factors and not first.converged:
            raise AdjustmentError(
                f"the network has no minimum with its factors: {first.reason}; find the gross "
                "errors without extra_factors first"
            )
    try:
        found = _search_from_given_values(
            searching, first, start, robust, extra, mistakes, plain=plain
        )
    except AdjustmentError as error:
        if not mistakes:
            raise
        said = "; ".join(f"{m.match.cause} {m.match.where}" for m in mistakes)
        raise noted_error(error, f"nearly everything fits without one mistake: {said}") from None
    if from_images is None:
        return found
    # Wrong images mislead, too: the result that leaves less unresolved is chosen.
    return min(found, from_images, key=lambda f: (len(f.unresolved), len(f.rejected)))


def _search_from_given_values(
    searching: _SearchArguments,
    first: Solution | None,
    start: Solution | Start | None,
    robust: Estimator | None,
    extra: AddedFactors,
    mistakes: Sequence[BlockMistake],
    *,
    plain: bool,
) -> Snooping:
    """Return the search from the given values, or from an earlier solution.

    searching: arguments that all searches have in common.
        searching: what all searches have in common.
        first: the adjustment of the whole network; None: a robust one is asked for.
        start: where it began.
        robust: the robust estimator.
        extra: the user's factors.
        mistakes: mistakes that distort the block of photos.
        plain: whether there is no estimator, no factor and no earlier solution.
    """
    network, options = searching.network, searching.options
    names = [m.match for m in mistakes]
    estimated = searching.test == "pope"
    if plain and first is not None and has_far_off_sights(first):
        # Exchanged names distort an adjustment, and a search that begins with it.
        exchanged = exchanged_names(network, first, searching.alpha, estimated=estimated)
        names += [e.match for e in exchanged]
        beside = start_without_exchanges(network, exchanged, options) if exchanged else None
        if beside is not None:
            return searching.run_beside(beside, names)[1]
    if first is not None and first.converged:
        search, found = searching.run(first, exchanged=names)
        # There is no robust estimator of free networks, nor one with factors.
        free = options["datum"] == "free" or network.datum == "free"
        if free or extra.factors or not is_misled(search, found):
            return found
        with suppress(AdjustmentError):
            again = searching.robust("huber", start_at_approximate_values(first), from_start=True)
            found = simpler_result(search, found, *searching.run(*again, exchanged=names))
        return found
    # An adjustment without a minimum need not be tried again: the start values are what is left.
    begin = searching.robust(robust or "huber", start, from_start=first is not None)
    return searching.run(*begin, exchanged=names)[1]


@dataclass(frozen=True)
class _SearchArguments:
    """Arguments that all searches in a network have in common; the fields are those of `snoop`."""

    network: Network
    test: Test
    alpha: float
    power: float
    sidak: bool
    options: dict[str, Any]
    share: float
    max_rounds: int
    progress: Callable[[Round], None] | None

    def robust(
        self, estimator: Estimator, start: Solution | Start | None, *, from_start: bool = False
    ) -> tuple[Solution, Array]:
        """Return a robust adjustment and its test values for σ0 = 1, (n,)."""
        found = robust_adjust(
            self.network,
            estimator=estimator,
            scale="a-priori" if self.test == "baarda" else "median",
            datum=self.options["datum"],
            start=start,
            from_start=from_start,
            iterations_each=self.options["max_iterations"],
        )
        return found.solution, found.test_values / found.scale

    def run(
        self,
        solution: Solution,
        values: Array | None = None,
        *,
        exchanged: Sequence[MistakenIdentity] = (),
    ) -> tuple[SnoopingSearch, Snooping]:
        """Return a search at its end, and its result.

        Args:
            solution: the adjustment of the whole network.
            values: test values (n,) of its outliers, which are rejected before the first round.
            exchanged: exchanges that are known already.
        """
        arguments = (solution, self.test, self._alpha(solution), self.power, self.options)

        def made(withdrawing: bool) -> SnoopingSearch:
            search = SnoopingSearch(*arguments, withdrawing=withdrawing)
            if values is not None:
                search.begin(values, self.progress)
            return search

        return self._to_the_end(made, exchanged)

    def run_beside(
        self, start: Start, exchanged: Sequence[MistakenIdentity] = ()
    ) -> tuple[SnoopingSearch, Snooping]:
        """Return a search that begins without the observations that do not agree with a start.

        Args:
            start: the start, which names the observations that do not agree.
            exchanged: what is known of them already.
        """
        try:
            clean = clean_adjustment(self.network, start, self.options)
        except (InputError, DatumError) as error:
            raise with_doubtful_image_points(start, error) from None

        def made(withdrawing: bool) -> SnoopingSearch:
            return clean_search(
                self.network,
                start,
                clean,
                test=self.test,
                alpha=self._alpha(clean),
                power=self.power,
                options=self.options,
                withdrawing=withdrawing,
            )

        return self._to_the_end(made, exchanged)

    def _alpha(self, solution: Solution) -> float:
        """Return the probability of a false alarm of one test."""
        if not self.sidak:
            return self.alpha
        return float(1.0 - (1.0 - self.alpha) ** (1.0 / solution.equations.n_rows))

    def _to_the_end(
        self, made: Callable[[bool], SnoopingSearch], exchanged: Sequence[MistakenIdentity]
    ) -> tuple[SnoopingSearch, Snooping]:
        """Return a search at its end, and its result.

        Args:
            made: makes the search; whether its rounds withdraw observations.
            exchanged: exchanges that are known already.
        """
        for withdrawing in (True, False):
            try:
                search = made(withdrawing)
                search.exchanged = tuple(exchanged)
                reason = search.run(self.share, self.max_rounds, self.progress)
            except CannotSettle:
                continue
            return search, search.result(reason)
        raise AssertionError("a search that adjusts in every round has nothing to settle")
