"""Least-squares adjustment of a network, or of its determined part (`adjust`); its memory needs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeAlias, TypeVar, get_args

from .blas_threads import with_one_thread
from .entities import parameter_name
from .errors import ApproximationError, DatumError, InputError, UnknownLeftOut, known, taking
from .graph.equations import compile_network
from .graph.listed_points import listed_points, with_listed_points_apart
from .graph.observation_selection import without
from .models.unknown_registry import UNKNOWNS
from .network.network import DatumChoice, Network
from .orientation.choice_of_start import choose_start, with_doubtful_image_points
from .solve.added_factors import AddedFactors, ExtraFactors
from .solve.gauss_newton import Progress
from .solve.machine_limits import (
    MemoryEstimate,
    error_of_weight_ratios,
    estimate_memory,
    refuse_too_many_pairs,
)
from .solve.minimum import DEFAULT_MAX_ITERATIONS, DEFAULT_TOLERANCE, adjust_from_start
from .solve.normal_equations import Solver
from .solve.solution import Solution
from .start.start_values import Start
from .types import Array

REASON_UNDETERMINED = "its observations do not determine it"
"""Why an unknown in the null space is left out."""
REASON_WITHOUT_DATUM = "it belongs to a part without datum"
"""Why an unknown of another part is left out."""
REASON_WITHOUT_VALUE = "no approximate value leads to it"
"""Why an unknown without a value is left out."""
REASON_NOT_OBSERVED = "it has no observation"
"""Why an unknown that nothing observes is left out."""
LEAVE_OUT_HINT = (
    "adjust --leave-out-undetermined, or fga.adjust(network, leave_out_undetermined=True), leaves "
    "it out with its observations, and names what was left out"
)
"""What a user can do where a part of the network is determined."""

_Named = tuple[str, str]
"""Kind and name of an unknown."""


AdjustedResult = TypeVar("AdjustedResult")
SolverName: TypeAlias = Literal["direct", "conjugate-gradients"]
"""How normal equations are solved."""
VARIANCE_SCALES = ("a-priori", "a-posteriori")
"""Valid scales of covariances: 1, or σ̂0²."""


def largest_determined_part(
    network: Network, attempt: Callable[[Network], AdjustedResult], *, factors: bool = False
) -> tuple[Network, AdjustedResult]:
    """Return the network without what an attempt to adjust it calls undetermined, adjusted.

    What is left out takes its observations along, so that others may lose theirs: the attempt is
    repeated until it succeeds. Coefficients that serve many observations (calibrations, refraction,
    constants of instruments) are never left out: they are to be held, or weighted.

    Args:
        network: the network; it stays unchanged, and is returned itself if it is determined.
        attempt: adjusts a network, or raises the errors of `adjust`.
        factors: whether factors of the user take part, over the keys of the network as it is.

    Raises:
        ApproximationError, DatumError: nothing that can be left out makes the rest determined; the
            error is that of the whole network.
    """
    if not factors:
        network = with_listed_points_apart(network)
    rest: Network | None = network
    first: ApproximationError | DatumError | None = None
    while rest is not None:
        try:
            return rest, attempt(rest)
        except InputError:  # such as: nothing is left to adjust
            if first is None:
                raise
            break
        except (ApproximationError, DatumError) as error:
            first = first or error
            rest = _without(rest, _unknowns(error), factors=factors)
    assert first is not None
    raise first


def with_leave_out_hint(error: ApproximationError | DatumError) -> ApproximationError | DatumError:
    """Return an error that says, if something can be left out, which option does so."""
    if _concerned(_unknowns(error)):
        error.args = (f"{error}\n  {LEAVE_OUT_HINT}",)
    return error


def _unknowns(error: ApproximationError | DatumError) -> dict[_Named, str]:
    """Return the unknowns that an error names, with the reason."""
    if isinstance(error, ApproximationError):
        return dict.fromkeys(error.unknowns, REASON_WITHOUT_VALUE)
    return dict.fromkeys(error.apart, REASON_WITHOUT_DATUM) | dict.fromkeys(
        error.unknowns, REASON_UNDETERMINED
    )


def _concerned(unknowns: Iterable[_Named]) -> Sequence[_Named]:
    """Return what can be left out: points and photos, otherwise sets and frames.

    Sets of directions and frames lose their observations with their points. Where a coefficient is
    open too, it may be what leaves the points open, and nothing is left out.
    """
    every = list(unknowns)
    if any(UNKNOWNS[kind].additional or UNKNOWNS[kind].on_earth for kind, _ in every):
        return []
    return [u for u in every if u[0] in ("point", "pose")] or every


def _without(network: Network, unknowns: dict[_Named, str], *, factors: bool) -> Network | None:
    """Return the network without some unknowns; None if none of them can be left out.

    Points that lose their last observation with them are left out as well: they were observed, so
    that they are no listed points.
    """
    concerned = _concerned(unknowns)
    ids = _observations(network, concerned)
    points = [name for kind, name in concerned if kind == "point"]
    photos = [name for kind, name in concerned if kind == "pose"]
    gone = {i for own in ids.values() for i in own if i in network.observations}
    if not gone and not points and not photos:
        return None
    out = without(network, gone, points=points, photos=photos)
    before = {i for left in network.unknowns_left_out for i in left.ids}
    for u in concerned:
        # What has lost its observations with another unknown is reached by nothing; what never had
        # any is not observed.
        why = unknowns[u] if ids[u] or before else REASON_NOT_OBSERVED
        out.unknowns_left_out.append(UnknownLeftOut(*u, why, tuple(ids[u])))
    lonely = [] if factors else listed_points(out)
    if lonely:
        out = without(out, (), points=lonely)
        out.unknowns_left_out += [
            UnknownLeftOut("point", name, REASON_UNDETERMINED, ()) for name in lonely
        ]
    return out


def _observations(network: Network, concerned: Sequence[_Named]) -> dict[_Named, list[str]]:
    """Return the ids of the observations of each unknown; image points by photo/point."""
    wanted = set(concerned)
    found: dict[_Named, list[str]] = defaultdict(list)
    for i, o in network.observations.items():
        named = {
            *(("point", name) for name in o.points()),
            *(("pose", name) for name in o.photos()),
            *((kind, parameter_name(key)) for kind, key in o.parameters()),
        }
        for u in wanted & named:
            found[u].append(i)
    photo, point, *_ = network.images.columns()
    photos, points = list(network.photos), list(network.points)
    for f, p in zip(photo.tolist(), point.tolist(), strict=True):
        for u in wanted & {("pose", photos[f]), ("point", points[p])}:
            found[u].append(f"{photos[f]}/{points[p]}")
    return found


@with_one_thread
def adjust(
    network: Network,
    *,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | Start | None = None,
    weights: Array | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    max_iterations: int = DEFAULT_MAX_ITERATIONS,
    extra_factors: ExtraFactors = (),
    progress: Progress | None = None,
    leave_out_undetermined: bool = False,
    solver: SolverName = "direct",
) -> Solution:
    """Adjust a network by least squares: minimise vᵀPv over all unknowns.

    Photos without a pose that see too few known points are oriented from image points alone, see
    `orient`; the solution says so (``begun``). Points that no observation concerns are listed, not
    adjusted: ``solution.network.listed_points`` has them.

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
            With them every point is an unknown.
        progress: called after each iteration; an exception in it ends the adjustment.
        leave_out_undetermined: whether `determined_part` is adjusted, without what the observations
            do not determine; ``solution.network.unknowns_left_out`` names it. Not with ``weights``.
        solver: ``direct``, elimination in fronts; or ``conjugate-gradients`` for blocks of photos
            whose fronts do not fit in memory. The minimum is the same within ``tolerance``, without
            the covariances of all unknowns: see `estimate_precision`. It needs a given datum.

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

    Example:
        >>> import factorgraph_adj as fga
        >>> from factorgraph_adj.observations import SlopeDistance
        >>> net = fga.Network("two distances")
        >>> net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
        >>> net.add_point("B", (10.0, 0.0, 0.0), fixed="yz")
        >>> ids = net.add(
        ...     SlopeDistance("A", "B", 10.002, sigma=0.002),
        ...     SlopeDistance("A", "B", 10.012, sigma=0.002),
        ... )
        >>> solution = fga.adjust(net)
        >>> solution.converged, solution.redundancy
        (True, 1)
        >>> x, sigma = solution.point("B")[0], solution.covariance("B")[0, 0] ** 0.5
        >>> print(f"x = {x:.4f} m, σ = {1e3 * sigma:.2f} mm")
        x = 10.0070 m, σ = 1.41 mm
    """
    choice = network.datum if datum is None else datum
    if choice not in (valid := get_args(DatumChoice)):
        raise InputError(f"unknown datum {choice!r}; valid: {known(valid, meant=choice)}")
    if variance not in VARIANCE_SCALES:
        raise InputError(
            f"unknown variance {variance!r}; valid: {known(VARIANCE_SCALES, meant=variance)}"
        )
    if solver not in (valid := get_args(SolverName)):
        raise InputError(f"unknown solver {solver!r}; valid: {known(valid, meant=solver)}")
    if solver == "conjugate-gradients" and choice == "free":
        raise InputError(
            "conjugate gradients need a given datum, and a free network has none; valid: "
            "solver='direct', or datum='given' with control"
        )
    if not extra_factors:  # keys of factors are those of the network as it is
        network = with_listed_points_apart(network)
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
                solver=solver,
            )

        return largest_determined_part(network, whole, factors=bool(extra_factors))[1]
    equations = compile_network(network)
    try:
        begin, extra = (
            choose_start(equations, choice, start),
            AddedFactors.of(extra_factors, network),
        )
    except (ApproximationError, DatumError) as error:
        raise with_leave_out_hint(error) from None
    extra.refuse_wrong_partials(equations, begin.state)
    chosen: Solver | None = None
    if solver == "conjugate-gradients":
        rows = extra.at(equations, begin.state).rows
        chosen = Solver.by_gradients(equations.weighted_at(begin.state), rows)
    else:
        refuse_too_many_pairs(equations)

    def attempt(weights: Array | None, progress: Progress | None = None) -> Solution:
        return adjust_from_start(
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
            solver=chosen,
        )

    def lost(*, undetermined: bool) -> InputError | None:
        if isinstance(start, Solution) and not start.converged:
            return None  # where it ended, points may lie in one place: that says nothing of σ
        weighed = equations.weighted_at(begin.state)

        def works(eased: Array) -> bool:
            return attempt(eased).converged or undetermined

        return error_of_weight_ratios(weighed, begin.state, weights, works)

    try:
        solution = attempt(weights, progress)
    except (InputError, DatumError) as error:
        undetermined = isinstance(error, DatumError)
        if undetermined and (why := lost(undetermined=True)) is not None:
            raise why from None
        told = error if start is not None else with_doubtful_image_points(begin, error)
        raise (with_leave_out_hint(told) if isinstance(told, DatumError) else told) from None
    if not solution.converged and (why := lost(undetermined=False)) is not None:
        raise why
    return solution


@taking(Network)
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

    return largest_determined_part(network, attempt, factors=bool(extra_factors))[0]


@taking(Network)
def memory_needed(network: Network, *, solver: SolverName = "direct") -> MemoryEstimate:
    """Estimate the memory that `adjust` and `reliability` take beside the network itself.

    Simulated blocks of 300 000 and a million image points took 0.7 to 0.8 of the estimate.

    Args:
        network: the network; `adjust` refuses one that takes more memory than is free.
        solver: as for `adjust`; conjugate gradients have no reliability.

    Raises:
        InputError: there is nothing to adjust.
        ApproximationError: the points, photos or sets that it names have no approximate values.
    """
    equations = compile_network(with_listed_points_apart(network))
    state = choose_start(equations, network.datum, None).state
    make = Solver.of if solver == "direct" else Solver.by_gradients
    return estimate_memory(make(equations).plan, equations, state)
