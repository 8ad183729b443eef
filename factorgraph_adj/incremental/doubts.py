"""Why a result may be wrong: sentences on what has been accepted.

Without a minimum everything stands where the last one was, and what came since is not in it. The
solution has ``converged`` false then; here it is said what contradicts that place most.

Three image points leave up to four places of a photo. One that came by few of them may be at the
wrong one, and its other image points are then suspects for good, however right they are: only
points are looked for at other places (`nonlinear_tests`).
"""

from __future__ import annotations

import numpy as np

from ..ledger.ledger import Ledger
from ..ledger.options import Options
from ..linear_system.front_system import FrontSystem
from ..linear_system.innovations import innovation_tests
from .worklist import IncrementalState

MAX_OBSERVATIONS_NAMED = 5
"""Largest number of observations that a doubt names."""
MAX_OBSERVATIONS_TESTED = 50
"""Largest number of observations without a minimum that are tested to name the worst: the first."""
MIN_SUSPECTS_OF_PHOTO = 3
"""Smallest number of suspects of a photo that may be right against what is in."""


def photo_doubts(ledger: Ledger) -> tuple[str, ...]:
    """Return sentences on photos of which more image points are suspects than accepted."""
    rows, names = ledger.rows, ledger.names
    out, inside = rows.images(ledger.having("suspect")), rows.images(ledger.having("accepted"))
    if len(out) < MIN_SUSPECTS_OF_PHOTO:
        return ()
    n = len(names.photos)
    suspects = np.bincount(rows.photo[out], minlength=n)
    accepted = np.bincount(rows.photo[inside], minlength=n)
    told = np.flatnonzero((suspects >= MIN_SUSPECTS_OF_PHOTO) & (suspects > accepted))
    return tuple(
        f"{suspects[f]} of {suspects[f] + accepted[f]} image points of photo {names.photos[f]!r} "
        "are suspects: it may be at the wrong one of two places; remove the image points that are "
        "in, or adjust all of them at once (fga.adjust)"
        for f in told.tolist()
    )


def minimum_doubts(state: IncrementalState, rules: Options) -> tuple[str, ...]:
    """Return a sentence on why there is no minimum; none where there is one."""
    system, ledger = state.system, state.ledger
    if not isinstance(system, FrontSystem) or not system.doubt:
        return ()
    why = system.doubt.partition("\n")[0].rstrip(":")
    begin = f"there is no minimum of everything in the graph: {why}"
    if not system.converged:
        return (f"{begin}. Everything stands where it began",)
    there = np.union1d(system.rows, ledger.find(system.joined))
    since = np.setdiff1d(ledger.having("accepted"), there)
    if not len(since):
        return (f"{begin}. Everything stands where the last minimum was",)
    ids = ledger.ids_of(since)
    told = f"{begin}. Everything stands where the last minimum was, without {_listed(ids)}"
    tests = innovation_tests(ledger, system, since[:MAX_OBSERVATIONS_TESTED], rules.alpha)
    beyond = sorted((t for t in tests if t.ratio > 1.0), key=lambda t: -t.ratio)
    if beyond:
        worst = ledger.ids_of(np.array([beyond[0].row]))[0]
        by = float(np.sqrt(beyond[0].ratio))
        told += f"; {worst!r} contradicts it most ({by:.2g} times the critical value): remove it"
    return (told,)


def _listed(ids: list[str]) -> str:
    """Return ids, the first of many."""
    more = len(ids) - MAX_OBSERVATIONS_NAMED
    shown = ", ".join(map(repr, ids[:MAX_OBSERVATIONS_NAMED]))
    return f"{shown} and {more} more" if more > 0 else shown
