"""The start of every adjustment: given and approximate values, or image points alone.

Batch and robust adjustments, snooping, variance components, parts, plans and the arrival of
observations all begin with `start_of`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import AdjustmentError, ApproximationError, DatumError, InputError, Problem
from ..graph.equations import Equations, compile_network
from ..network.network import DatumChoice, Network
from ..solve.determine import GROSS
from ..solve.solution import Solution
from ..solve.start import Start, approximate_start
from .block_start import BlockStart
from .judged_start import judged, refuse_wrong_marks
from .known import without_approximations


def start_of(equations: Equations, datum: DatumChoice, given: Solution | Start | None) -> Start:
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
        return start if given is not None else judged(equations, datum, start)
    except ApproximationError as error:
        found = block_of(equations, datum, error)
    assert found.start is not None
    refuse_wrong_marks(equations, found.start)
    return found.start


def block_of(
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
    from .orient import orient_equations

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


def tried_start(network: Network) -> tuple[Start | None, tuple[Problem, ...]]:
    """Return the start of an adjustment, or none and the unknowns that have no start values."""
    try:
        return start_of(compile_network(network), network.datum, None), ()
    except (ApproximationError, InputError) as error:
        return None, error.problems
    except DatumError as error:
        return None, (Problem(str(error)),)


def without_poses(network: Network) -> bool:
    """Return whether photos have no pose, so that an adjustment may begin from image points."""
    return any(f.rotation is None for f in network.photos.values()) and network.n_image_points > 0


def begun(
    network: Network, datum: DatumChoice | None, given: Solution | Start | None
) -> Solution | Start | None:
    """Return the given start; for photos without poses the start that `start_of` finds.

    Raises:
        ApproximationError: photos or points have no start values.
    """
    if given is not None or not without_poses(network):
        return given
    return start_of(compile_network(network), network.datum if datum is None else datum, None)


def begun_anew(network: Network, datum: DatumChoice | None) -> Start | None:
    """Return a start from image points where other start values led to no minimum; none: no start.

    A resection from few known points, one of them a mismatch, gives a wrong pose; and from given
    poses mismatches drag points to infinity, whose readings then say nothing.
    """
    if not network.n_image_points:
        return None
    equations = compile_network(network)
    if not equations.unknowns.rough()["pose"].any():
        return None
    # Imported here, because few adjustments begin from image points, and the import is slow.
    from .orient import orient_equations

    with suppress(InputError, ApproximationError):
        found = orient_equations(without_approximations(equations), datum=datum).start
        carried = None if found is None else found.carried_to(equations.unknowns)
        if carried is not None:
            given = equations.unknowns.start()
            origin = {
                kind: np.where(np.isnan(given[kind]), values, given[kind])
                for kind, values in carried.origin.items()
            }
            return replace(carried, origin=origin)
    return None


def is_lost(solution: Solution) -> bool:
    """Return whether an adjustment has no minimum, or ended far from any.

    Where photos had no poses, those that a resection gave may be what it began with.
    """
    if without_poses(solution.network):
        return not solution.converged
    v = solution.equations.residuals(solution.state)
    return not solution.converged and float(v @ v) > GROSS**2 * len(v)


def leaving_out(start: Start, error: AdjustmentError) -> AdjustmentError:
    """Return an error of an adjustment that began from image points, with what it may come from."""
    if not start.doubtful:
        return error
    what = (
        f"the adjustment began from image points alone, and uses the {len(start.doubtful)} too "
        "that do not agree; fga.snoop, or adjust --snoop, begins without them, "
        "found = fga.orient(network) names them, and found.without_doubtful() has none of them"
    )
    return with_note(error, what)


def with_note(error: AdjustmentError, what: str) -> AdjustmentError:
    """Return an error with what it may come from, of the same kind where that says more."""
    if isinstance(error, InputError):
        return InputError([*error.problems, Problem(what)])
    if isinstance(error, DatumError):
        return DatumError(
            f"{error}\n{what}", defect=error.defect, names=error.names, unknowns=error.unknowns
        )
    return AdjustmentError(f"{error}\n{what}")
