"""Choice of every start: given, moved, from images, after a failure; refusals, notes on errors.

Batch and robust adjustments, snooping, variance components, parts, plans and new observations all
begin with `choose_start`. A start that no kind of observation grossly misfits is used as it is.
Otherwise the block is moved by the similarity that fits, and, where that still misfits, oriented
from image points; the start with the least robust cost is used, and says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError, ApproximationError, DatumError, InputError, Problem
from ..graph.equations import Equations, compile_network
from ..graph.variables import MaskState, State
from ..network.network import DatumChoice, Network
from ..solve.adjustment_run import GROSS_RMS
from ..solve.solution import Solution
from ..start.image_axes import cameras_along_other_axes, problems_of_marks
from ..start.start_values import Start, approximate_start
from ..types import Mask
from .block_input import KnownPlaces, given_places, without_approximations
from .block_start import BlockStart
from .similarity_start import (
    GROSS_START_MISFIT,
    StartMisfit,
    robust_cost,
    similarity_starts,
    start_misfits,
)


@dataclass(frozen=True)
class _Candidate:
    """A start, its robust cost and where it comes from."""

    start: Start
    cost: float
    words: tuple[str, ...]


def least_cost_start(equations: Equations, datum: DatumChoice, start: Start) -> Start:
    """Return the start itself if no kind of observation grossly misfits it, or the best of others.

    Args:
        equations: the network in arrays.
        datum: given or free.
        start: values of all unknowns, from given coordinates and poses.

    Raises:
        InputError: the marks of known points count along other image axes, or these points all
            have the same coordinates.
    """
    if not equations.n_rays or not equations.unknowns.rough()["pose"].any():
        return start
    bare = without_approximations(equations)
    known = given_places(bare)
    static = _known_places(equations, known)
    wrong = _gross_misfits(start_misfits(equations, _with_known(start.state, known), static))
    if not wrong:
        return start
    refuse_wrong_marks(equations, start)
    # Images along other axes fit no pose; the causes of a misfit name them from the given poses.
    network, state = equations.network, _with_known(start.state, known)
    if cameras_along_other_axes(network, state["pose"], state["point"]):
        return start
    found = [_Candidate(start, robust_cost(equations, start.state), ())]
    for moved in similarity_starts(equations, bare, start.state, datum):
        words = f"the given poses and points, moved by the similarity {moved.words}"
        other = replace(start, state=moved.state)
        found.append(_Candidate(other, robust_cost(equations, moved.state), (words,)))
    best = min(found, key=lambda c: c.cost)
    if _gross_misfits(start_misfits(equations, _with_known(best.start.state, known), static)):
        found += _from_images(equations, bare, datum, start)
        best = min(found, key=lambda c: c.cost)
        refuse_wrong_marks(equations, best.start)
    if best.start is start:
        return start
    told = _reasons_of_choice(wrong, best, found[0].cost)
    return replace(best.start, words=told, instead_of=start.state)


def refuse_wrong_marks(equations: Equations, start: Start) -> None:
    """Refuse marks of known points whose rays do not meet, but would along other image axes.

    Raises:
        InputError: so it is, or all these points have the same coordinates.
    """
    if problems := problems_of_marks(equations.network, start.state["pose"]):
        raise InputError(problems)


def _known_places(equations: Equations, known: KnownPlaces) -> MaskState:
    """Return the points and photos whose places are known, (n, 1) each."""
    fixed: Mask = np.all(~equations.unknowns.rough()["pose"], axis=1)
    point: Mask = np.all(np.isfinite(known.point), axis=1)
    return {"point": point[:, None], "pose": fixed[:, None]}


def _with_known(state: State, known: KnownPlaces) -> State:
    """Return a state in which points have their known coordinates."""
    full = np.isfinite(known.point).all(axis=1, keepdims=True)
    return {**state, "point": np.where(full, known.point, state["point"])}


def _gross_misfits(found: Sequence[StartMisfit]) -> tuple[StartMisfit, ...]:
    return tuple(
        sorted((m for m in found if m.median > GROSS_START_MISFIT), key=lambda m: -m.median)
    )


def _from_images(
    equations: Equations, bare: Equations, datum: DatumChoice, start: Start
) -> list[_Candidate]:
    """Return the start that the image points alone lead to; empty: they do not, or no PoseLib."""
    carried = _oriented(equations, bare, datum)
    if carried is None:
        return []
    carried = replace(carried, origin=start.origin)
    return [_Candidate(carried, robust_cost(equations, carried.state), carried.words)]


def _oriented(equations: Equations, bare: Equations, datum: DatumChoice | None) -> Start | None:
    """Return the start of the block that is oriented from image points; none: it cannot be."""
    # Imported here, because few adjustments begin from image points, and the import is slow.
    from .block_orientation import orient_equations

    with suppress(InputError, ApproximationError):
        found = orient_equations(bare, datum=datum).start
        return None if found is None else found.for_unknowns(equations.unknowns)
    return None


def _reasons_of_choice(
    wrong: Sequence[StartMisfit], best: _Candidate, cost: float
) -> tuple[str, ...]:
    """Return sentences on why and how another start was chosen."""
    how = ", ".join(
        f"{m.what} (behind the cameras)" if np.isinf(m.median) else f"{m.what} ({m.median:.0%})"
        for m in wrong
    )
    first, *more = best.words
    return (
        f"The given poses and coordinates grossly misfit: {how}, median relative misfits.",
        f"The adjustment began from {first}; robust cost {best.cost:.4g} instead of {cost:.4g}."
        if not best.start.doubtful
        else first,
        *more,
    )


def choose_start(equations: Equations, datum: DatumChoice, given: Solution | Start | None) -> Start:
    """Return the start of an adjustment.

    The given values come first, then approximate values, which the observations lead to from what
    is known. Where these leave photos without a pose, the block is oriented from image points
    alone; the start says so (``words``).

    Args:
        equations: the network in arrays.
        datum: given or free.
        given: a solution or a start of this or a similar network; none: there is none.

    Raises:
        ApproximationError: the unknowns that it names have no start values.
        InputError: the marks of known points count along other image axes, or these points all
            have the same coordinates.
    """
    try:
        start = approximate_start(equations, datum, given)
        return start if given is not None else least_cost_start(equations, datum, start)
    except ApproximationError as error:
        found = block_start_from_images(equations, datum, error)
    assert found.start is not None
    refuse_wrong_marks(equations, found.start)
    return found.start


def block_start_from_images(
    equations: Equations, datum: DatumChoice, error: ApproximationError, *, whole: bool = True
) -> BlockStart:
    """Return the block that was oriented from image points, with a start of all unknowns.

    Args:
        equations: the network in arrays.
        datum: given or free.
        error: what the search for approximate values has missed.
        whole: whether all photos and points must be found.

    Raises:
        ApproximationError: photos are not what was missed; PoseLib is not installed; or photos and
            points remain without values, which the error names.
    """
    if not equations.network.n_image_points or not error.photos:
        raise error
    # Imported here, because few adjustments begin from image points, and the import is slow.
    from .block_orientation import orient_equations

    try:
        found = orient_equations(equations, datum=datum)
    except (InputError, ApproximationError) as other:
        raise ApproximationError(
            [*other.problems, *(p for p in error.problems if "fga.orient" not in p.what)],
            photos=error.photos,
            unknowns=error.unknowns,
        ) from None
    if found.start is None and whole:
        # What the search for approximate values says of a photo is the nearer cause.
        lost = [
            Problem(why, f"photo {name!r}")
            for name, why in found.unoriented.items()
            if not any(p.startswith(f"photo {name}: ") for p in found.problems)
        ]
        first = " ".join([*found.sentences()[: len(found.parts)], *found.doubts])
        raise ApproximationError(
            [
                Problem(f"not all photos and points were found from image points: {first}"),
                *lost,
                *(Problem(p) for p in found.problems),
            ],
            photos=found.unoriented,
            unknowns=error.unknowns,
        )
    return found


def start_or_problems(network: Network) -> tuple[Start | None, tuple[Problem, ...]]:
    """Return the start of an adjustment, or none and the unknowns that have no start values."""
    try:
        return choose_start(compile_network(network), network.datum, None), ()
    except (ApproximationError, InputError) as error:
        return None, error.problems
    except DatumError as error:
        return None, (Problem(str(error)),)


def has_photos_without_pose(network: Network) -> bool:
    """Return whether photos have no pose, so that an adjustment may begin from image points."""
    return any(f.rotation is None for f in network.photos.values()) and network.n_image_points > 0


def given_or_image_start(
    network: Network, datum: DatumChoice | None, given: Solution | Start | None
) -> Solution | Start | None:
    """Return the given start; for photos without poses the start that `choose_start` finds.

    Raises:
        ApproximationError: photos or points have no start values.
    """
    if given is not None or not has_photos_without_pose(network):
        return given
    return choose_start(compile_network(network), network.datum if datum is None else datum, None)


def image_start(network: Network, datum: DatumChoice | None) -> Start | None:
    """Return a start from image points where other start values led to no minimum; none: no start.

    A resection from few known points, one of them a mismatch, gives a wrong pose; and from given
    poses mismatches drag points to infinity, whose readings then say nothing.
    """
    if not network.n_image_points:
        return None
    equations = compile_network(network)
    if not equations.unknowns.rough()["pose"].any():
        return None
    carried = _oriented(equations, without_approximations(equations), datum)
    if carried is None:
        return None
    given = equations.unknowns.start()
    origin = {
        kind: np.where(np.isnan(given[kind]), values, given[kind])
        for kind, values in carried.origin.items()
    }
    return replace(carried, origin=origin)


def misses_minimum(solution: Solution) -> bool:
    """Return whether an adjustment has no minimum, or ended far from any.

    Where photos had no poses, those that a resection gave may be what it began with.
    """
    if has_photos_without_pose(solution.network):
        return not solution.converged
    v = solution.equations.residuals(solution.state)
    return not solution.converged and float(v @ v) > GROSS_RMS**2 * len(v)


def with_doubtful_image_points(start: Start, error: AdjustmentError) -> AdjustmentError:
    """Return an error of an adjustment that began from image points, with what it may come from."""
    if not start.doubtful:
        return error
    what = (
        f"the adjustment began from image points alone, and uses the {len(start.doubtful)} too "
        "that do not agree; fga.snoop, or adjust --snoop, begins without them, "
        "found = fga.orient(network) names them, and found.without_doubtful() has none of them"
    )
    return noted_error(error, what)


def noted_error(error: AdjustmentError, what: str) -> AdjustmentError:
    """Return an error with what it may come from, of the same kind where that says more."""
    if isinstance(error, InputError):
        return InputError([*error.problems, Problem(what)])
    if isinstance(error, DatumError):
        return DatumError(
            f"{error}\n{what}", defect=error.defect, names=error.names, unknowns=error.unknowns
        )
    return AdjustmentError(f"{error}\n{what}")
