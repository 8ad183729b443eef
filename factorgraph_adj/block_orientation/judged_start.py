"""The judgement of a start: given poses that grossly misfit other observations are not used as is.

A start that no kind of observation grossly misfits is used as it is. Otherwise the block is moved
by the similarity that fits, and, where that still misfits, oriented from image points; the start
with the least robust cost is used, and says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..approximate.image_axes import cameras_along_other_axes, problems_of_marks
from ..errors import ApproximationError, InputError
from ..graph.equations import Equations
from ..graph.variables import MaskState, State
from ..network.network import DatumChoice
from ..solve.start import Start
from ..types import Mask
from .known import Known, given, without_approximations
from .similarity_start import similarity_starts
from .start_misfit import GROSS, Misfit, misfits, robust_cost


@dataclass(frozen=True)
class _Candidate:
    """A start, its robust cost and where it comes from."""

    start: Start
    cost: float
    words: tuple[str, ...]


def judged(equations: Equations, datum: DatumChoice, start: Start) -> Start:
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
    known = given(bare)
    static = _static(equations, known)
    wrong = _gross(misfits(equations, _with_known(start.state, known), static))
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
    if _gross(misfits(equations, _with_known(best.start.state, known), static)):
        found += _from_images(equations, bare, datum, start)
        best = min(found, key=lambda c: c.cost)
        refuse_wrong_marks(equations, best.start)
    if best.start is start:
        return start
    told = _told(wrong, best, found[0].cost)
    return replace(best.start, words=told, instead_of=start.state)


def refuse_wrong_marks(equations: Equations, start: Start) -> None:
    """Refuse marks of known points whose rays do not meet, but would along other image axes.

    Raises:
        InputError: so it is, or all these points have the same coordinates.
    """
    if problems := problems_of_marks(equations.network, start.state["pose"]):
        raise InputError(problems)


def _static(equations: Equations, known: Known) -> MaskState:
    """Return the points and photos whose places are known, (n, 1) each."""
    fixed: Mask = np.all(~equations.unknowns.rough()["pose"], axis=1)
    point: Mask = np.all(np.isfinite(known.point), axis=1)
    return {"point": point[:, None], "pose": fixed[:, None]}


def _with_known(state: State, known: Known) -> State:
    """Return a state in which points have their known coordinates."""
    full = np.isfinite(known.point).all(axis=1, keepdims=True)
    return {**state, "point": np.where(full, known.point, state["point"])}


def _gross(found: Sequence[Misfit]) -> tuple[Misfit, ...]:
    return tuple(sorted((m for m in found if m.median > GROSS), key=lambda m: -m.median))


def _from_images(
    equations: Equations, bare: Equations, datum: DatumChoice, start: Start
) -> list[_Candidate]:
    """Return the start that the image points alone lead to; empty: they do not, or no PoseLib."""
    # Imported here, because few adjustments begin from image points, and the import is slow.
    from .orient import orient_equations

    with suppress(InputError, ApproximationError):
        found = orient_equations(bare, datum=datum).start
        carried = None if found is None else found.carried_to(equations.unknowns)
        if carried is not None:
            carried = replace(carried, origin=start.origin)
            return [_Candidate(carried, robust_cost(equations, carried.state), carried.words)]
    return []


def _told(wrong: Sequence[Misfit], best: _Candidate, cost: float) -> tuple[str, ...]:
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
