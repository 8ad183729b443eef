"""The search of an adjustment for datum defects and for undetermined unknowns."""

from __future__ import annotations

import numpy as np

from ..errors import DatumError, InputError, Problem
from ..models.variables import UNKNOWNS
from ..types import Array
from .datum import FreeDatum, find_defects, minimal_datum
from .free_network import datum_columns
from .normal import NormalEquations
from .rank import LISTED, describe_defects, undetermined, unnoticed
from .run import Run
from .shrinking import lengths_of_zero
from .singular import SingularError

GROSS = 30.0
"""Root mean square of v/σ above which a state is far from the minimum: nothing that is singular
there tells what the observations determine."""
FITTING = 3.0
"""Root mean square of v/σ up to which readings fit where an iteration ended. Above it gross errors
or poor start values have led it there."""


def is_gross(normal: NormalEquations) -> bool:
    """Return whether residuals say that a state is far from the minimum."""
    return normal.system.vtpv > GROSS**2 * normal.solver.equations.n_rows


def settle_datum(run: Run, normal: NormalEquations) -> None:
    """Find the datum defects; hold a minimal datum in a free network, otherwise raise an error.

    Raises:
        DatumError: unknowns have no observations; or the network has datum defects and no free
            network is asked for, or has them in several parts.
    """
    unknowns = run.equations.unknowns
    if np.any(run.unobserved(normal)):
        explain(run, normal)
    defects = find_defects(normal.system, run.state, normal.diagonal, free=run.free)
    run.defects = tuple(defects)
    if run.free:
        refuse_shrinking(run, normal, sum(d.size for d in defects))
    if not defects:
        return
    if not run.free:
        error = undetermined(normal.system, normal.diagonal, defects)
        if error is not None:
            raise error
    if len(defects) > 1:
        lines = describe_defects(unknowns, defects)
        raise DatumError(
            "\n  ".join(["a free network must be connected", *lines]),
            defect=sum(d.size for d in defects),
        )
    motions = defects[0].motions
    columns = datum_columns(run.equations, motions)
    held = minimal_datum(motions * np.sqrt(normal.diagonal)[:, None], columns)
    run.constraint = np.zeros_like(run.constraint)  # a run that goes on chooses anew
    run.constraint[held] = normal.diagonal[held]
    run.datum = FreeDatum(motions, columns)


def refuse_shrinking(run: Run, normal: NormalEquations, known: int) -> None:
    """Raise an error if a free network has no minimum, as its residuals in metres shrink with it.

    Args:
        run: the adjustment.
        normal: its normal equations.
        known: number of its datum defects.

    Raises:
        DatumError: nothing in the network has a length.
    """
    found = list(lengths_of_zero(normal.system))
    if not found:
        return
    every = find_defects(normal.system, run.state, normal.diagonal, free=True, shrinking=True)
    size = sum(d.size for d in every)
    scaled = any("scale" in d.names() for d in every)
    if not scaled or (size == known and any("scale" in d.names() for d in run.defects)):
        return
    counts = ", ".join(f"{int(zero.sum())} {b.kind.replace('_', ' ')}" for b, zero in found)
    raise DatumError(
        "nothing in the free network has a length, so that it has no size at which it fits best: "
        f"residuals in metres ({counts}) are lengths that should be zero, and shrink with the "
        "network\n  give it a length: a distance, two control points, a known size of a shape "
        "(hold its size), or a frame of known scale",
        defect=size,
    )


def refuse_unnoticed(run: Run, normal: NormalEquations) -> None:
    """Raise an error that names the undetermined unknowns, after a poor pivot.

    Rounding gives a singular N a small pivot instead of zero, and its step is then arbitrary.
    """
    try:
        factor = normal.factorise(run.constraint)
    except SingularError:
        explain(run, normal)
        return
    filled = [] if run.datum is None else [d.at(run.equations, run.state) for d in run.defects]
    known = unnoticed(normal.system, normal.diagonal, factor, filled)
    if known.shape[1]:
        explain(run, normal, known)


def explain(run: Run, normal: NormalEquations, known: Array | None = None) -> None:
    """Raise an error that names the undetermined unknowns; ``known`` as in `undetermined`."""
    error = what_is_undetermined(run, normal, known)
    try:
        if error is not None:
            raise error from None
    finally:
        del error  # otherwise frame and traceback keep each other and all their objects alive


def astray(run: Run, normal: NormalEquations) -> str:
    """Return what nothing determines where an iteration ended; empty if all is determined.

    Raises:
        DatumError: the same is not determined where the iteration began, so that it is the network
            that does not determine it, or the run may not go astray. Otherwise gross errors, or
            poor start values, have led to a place where points lie upon one another, or far away.
    """
    error = what_is_undetermined(run, normal)
    if error is None:
        return ""
    if not run.may_go_astray or normal.system.vtpv <= FITTING**2 * run.equations.n_rows:
        explain(run, normal)  # readings that fit do not determine it
    try:
        began = run.normal_at(run.began)
        if what_is_undetermined(run, began) is None:
            named = error.names or tuple(name for _, name in error.unknowns)
            listed = f": {', '.join(map(str, named[:LISTED]))}" if named else ""
            return f"where it ended something is not determined that was at the start{listed}"
    except InputError:
        pass
    explain(run, normal)
    return ""


def what_is_undetermined(
    run: Run, normal: NormalEquations, known: Array | None = None
) -> DatumError | None:
    """Return an error that names the undetermined unknowns; none: all are determined."""
    if run.datum is not None:
        free, defects = True, [d.at(run.equations, run.state) for d in run.defects]
    else:
        defects = find_defects(normal.system, run.state, normal.diagonal, free=run.free)
        # Inner constraints would fill the defect, if all else were determined.
        free = run.free and len(defects) < 2
    return undetermined(normal.system, normal.diagonal, defects, free=free, known=known)


def name_overflow(run: Run) -> None:
    """Raise an error that names the observations for which vᵀPv is not finite."""
    v = run.equations.residuals(run.state)
    with np.errstate(over="ignore"):
        bad = np.flatnonzero(~np.isfinite(v * v))[:LISTED]
    bad = bad if len(bad) else np.argsort(-np.abs(v))[:1]
    raise InputError(
        [
            Problem(
                f"its residual is {abs(v[r]):.3g} σ: vᵀPv with it is not a finite number"
                if np.isfinite(v[r])
                else "its residual is not a finite number",
                run.equations.label(int(r)),
            )
            for r in bad
        ]
    )


def drifting(run: Run, bound: float) -> str:
    """Return the reason of an iteration that ended while unknowns still moved without gain."""
    names = [f"{UNKNOWNS[kind].noun} {name!r}" for kind, name in run.drifting]
    listed = ": " + ", ".join(names[:LISTED]) if names else ""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return (
        f"vᵀPv hardly decreases any more, yet unknowns still move (by up to {bound:.2g} σ): "
        f"some of them are nearly undetermined{listed}{more}"
    )
