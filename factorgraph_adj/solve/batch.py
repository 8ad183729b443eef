"""The adjustment of a network in memory, and the memory that it takes."""

from __future__ import annotations

from typing import Literal, get_args

from ..blas_threads import with_one_thread
from ..block_orientation.begin import leaving_out, start_of
from ..errors import ApproximationError, DatumError, InputError, known
from ..graph.equations import compile_network
from ..network.network import DatumChoice, Network
from ..types import Array
from .determined_part import largest_determined, with_option
from .double_precision import lost_rows
from .extra import Extra, ExtraFactors
from .iterate import Progress
from .memory import Memory, memory_of
from .minimum import MOST_ITERATIONS, TOLERANCE, adjust_from
from .normal import Solver
from .solution import Solution
from .start import Start

VARIANCES = ("a-priori", "a-posteriori")
"""Valid scales of covariances: 1, or σ̂0²."""


@with_one_thread
def adjust(
    network: Network,
    *,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | Start | None = None,
    weights: Array | None = None,
    tolerance: float = TOLERANCE,
    max_iterations: int = MOST_ITERATIONS,
    extra_factors: ExtraFactors = (),
    progress: Progress | None = None,
    leave_out_undetermined: bool = False,
) -> Solution:
    """Adjust a network by least squares: minimise vᵀPv over all unknowns.

    Photos without a pose that see too few known points are oriented from image points alone, see
    `orient`; the solution says so (``begun``).

    Args:
        network: the points, photos, instruments and observations.
        datum: ``given`` (control, fixed, weighted) or ``free`` (inner constraints over the datum
            points); none: the datum of the network.
        variance: whether covariances are scaled by 1 or by σ̂0².
        start: an earlier solution or other values by name, from which the iteration starts; it
            takes a step or two if few observations have changed. The inner constraints refer to
            the same coordinates x₀ as those of ``start``.
        weights: factor on the weight of each scalar observation, in the order of
            ``solution.observations``; see `Equations.reweighted`.
        tolerance: bound on the last step of every unknown, relative to its own σ.
        max_iterations: largest number of iterations; a solution that needs more is returned as
            not converged.
        extra_factors: any ``gtsam.NonlinearFactor`` over the keys of `build_graph`, in a list or
            by name, or functions by name that make them, as for `IncrementalAdjustment.add`; they
            take part in solution and covariance, and have test values in `Reliability.factors`.
        progress: called after each iteration; an exception in it ends the adjustment.
        leave_out_undetermined: whether `determined_part` is adjusted, without what the observations
            do not determine; ``solution.network.unknowns_left_out`` names it. Not with ``weights``.

    Returns:
        The solution; its ``converged`` and ``reason`` say how the iteration ended.

    Raises:
        InputError: an observation cannot be computed, a point lies behind a camera, there is
            nothing to adjust, the Jacobian of a factor contradicts its error, standard deviations
            are below what double precision carries, or too little memory; the error names all of
            them at once.
        ApproximationError: the points, photos or sets that it names have no approximate values.
        DatumError: the observations do not determine the unknowns that it names, or the network
            has datum defects and no free network is asked for.
    """
    choice = network.datum if datum is None else datum
    if choice not in (valid := get_args(DatumChoice)):
        raise InputError(f"unknown datum {choice!r}; valid: {known(valid, meant=choice)}")
    if variance not in VARIANCES:
        raise InputError(
            f"unknown variance {variance!r}; valid: {known(VARIANCES, meant=variance)}"
        )
    if leave_out_undetermined:
        if weights is not None:
            raise InputError(
                "weights are in the order of all observations, of which leave_out_undetermined may "
                "leave some out: adjust fga.determined_part(network) with weights of its own"
            )

        def whole(some: Network) -> Solution:
            return adjust(
                some,
                datum=datum,
                variance=variance,
                start=start,
                tolerance=tolerance,
                max_iterations=max_iterations,
                extra_factors=extra_factors,
                progress=progress,
            )

        return largest_determined(network, whole)[1]
    equations = compile_network(network)
    try:
        begin, extra = start_of(equations, choice, start), Extra.of(extra_factors, network)
    except (ApproximationError, DatumError) as error:
        raise with_option(error) from None
    extra.refuse_wrong_partials(equations, begin.state)

    def attempt(weights: Array | None, progress: Progress | None = None) -> Solution:
        return adjust_from(
            equations,
            begin,
            free=choice == "free",
            variance=variance,
            weights=weights,
            tolerance=tolerance,
            max_iterations=max_iterations,
            extra=extra,
            progress=progress,
            astray=True,
        )

    def lost(*, undetermined: bool) -> InputError | None:
        if isinstance(start, Solution) and not start.converged:
            return None  # where it ended, points may lie in one place: that says nothing of σ
        weighed = equations.weighted_at(begin.state)

        def works(eased: Array) -> bool:
            return attempt(eased).converged or undetermined

        return lost_rows(weighed, begin.state, weights, works)

    try:
        solution = attempt(weights, progress)
    except (InputError, DatumError) as error:
        undetermined = isinstance(error, DatumError)
        if undetermined and (why := lost(undetermined=True)) is not None:
            raise why from None
        told = error if start is not None else leaving_out(begin, error)
        raise (with_option(told) if isinstance(told, DatumError) else told) from None
    if not solution.converged and (why := lost(undetermined=False)) is not None:
        raise why
    return solution


@with_one_thread
def determined_part(
    network: Network,
    *,
    datum: DatumChoice | None = None,
    start: Solution | Start | None = None,
    extra_factors: ExtraFactors = (),
) -> Network:
    """Return a network without what its observations do not determine.

    Points, photos, sets of directions and frames that are not determined are left out with all
    observations of them, then what these observations have determined, and so on. The new network
    names them with their observations (``unknowns_left_out``). A network that is determined is
    returned itself.

    Args:
        network: the network; it stays unchanged.
        datum: as for `adjust`.
        start: as for `adjust`.
        extra_factors: as for `adjust`.

    Raises:
        ApproximationError, DatumError: as `adjust`, if the rest has no datum, or if coefficients of
            instruments, cameras or the air are not determined: these are to be held or weighted.
    """

    def attempt(some: Network) -> Solution:
        return adjust(some, datum=datum, start=start, extra_factors=extra_factors)

    return largest_determined(network, attempt)[0]


def memory_needed(network: Network) -> Memory:
    """Estimate the memory that `adjust` and `reliability` take beside the network itself.

    Simulated blocks of 300 000 and a million image points took 0.7 to 0.8 of the estimate.

    Args:
        network: the network; `adjust` refuses one that takes more memory than is free.

    Raises:
        InputError: there is nothing to adjust.
        ApproximationError: the points, photos or sets that it names have no approximate values.
    """
    equations = compile_network(network)
    state = start_of(equations, network.datum, None).state
    return memory_of(Solver.of(equations).plan, equations, state)
