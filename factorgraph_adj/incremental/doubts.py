"""Sentences of doubt: no minimum, photos mostly of suspects, the reading that suspects contradict.

Without a minimum the estimates are those of the last one, without the observations that came since.
The solution then has ``converged`` false; here the observations are named that contradict these
estimates most.

Nothing tests the first reading of a point. If it is wrong, later ones become suspects, however
right they are: where several suspects share a point, a station or another unknown, its accepted
readings are left out in turn, with the suspects in, and the reading is named without which most of
them fit. Where there is none, the suspects may share an error (`causes`).

Three image points leave up to four positions of a photo. A photo with few of them may be at the
wrong one, and its other image points then remain suspects, however right they are: only points are
tried at other positions (`nonlinear_tests`).
"""

from __future__ import annotations

import numpy as np

from ..errors import known
from ..graph.dependence import Variable
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..ledger.row_store import NO_PHOTO
from ..ledger.waiting_observations import Candidates, NothingKnown, known_in
from ..linear_system.front_system import FrontSystem
from ..linear_system.predictions import UNANSWERED, innovation_tests, joined
from ..models.unknown_registry import UNKNOWNS
from ..quality.group_tests import LeaveOneOutTests
from ..types import Index
from .worklist import IncrementalState

MAX_OBSERVATIONS_NAMED = 5
"""Largest number of observations that a doubt names."""
MAX_OBSERVATIONS_TESTED = 50
"""Largest number of observations without a minimum that are tested to name the worst: the first."""
MIN_SUSPECTS_OF_PHOTO = 3
"""Smallest number of suspects of a photo that may be right against what is in."""
MIN_SUSPECTS_TOGETHER = 2
"""Smallest number of suspects of an unknown that may be right against a reading that is in."""
MIN_SUSPECTS_SHARING = 3
"""Smallest number of suspects of an unknown that may share an error."""
MIN_SHARE_OF_SUSPECTS = 0.1
"""Smallest share of suspects among the observations of an unknown: single gross errors are
fewer."""
MAX_SUSPECTS_TOGETHER = 12
"""Largest number of suspects of an unknown that are examined: the latest."""
MAX_UNKNOWNS_LOOKED_AT = 5
"""Largest number of unknowns that suspects share that are examined: those of most suspects."""
MAX_READINGS_BESIDE = 12
"""Largest number of accepted readings of an unknown that are examined with its suspects: the
first."""
SHARED_ERROR = (
    "causes() looks for an error that several share, such as wrong given "
    "coordinates or a wrong height of an instrument"
)


def photo_doubts(ledger: Ledger) -> tuple[str, ...]:
    """Return sentences on photos of which more image points are suspects than accepted."""
    rows, names = ledger.rows, ledger.names
    out, inside = rows.images(ledger.having("suspect")), rows.images(ledger.having("accepted"))
    if len(out) < MIN_SUSPECTS_OF_PHOTO:
        return ()
    n = len(names.photos)
    suspects = np.bincount(rows.photo[out], minlength=n)
    accepted = np.bincount(rows.photo[inside], minlength=n)
    doubtful = np.flatnonzero((suspects >= MIN_SUSPECTS_OF_PHOTO) & (suspects > accepted))
    return tuple(
        f"{suspects[f]} of {suspects[f] + accepted[f]} image points of photo {names.photos[f]!r} "
        "are suspects: it may be at the wrong one of two places; remove the image points that are "
        "in, or adjust all of them at once (fga.adjust)"
        for f in doubtful.tolist()
    )


def minimum_doubts(state: IncrementalState, rules: Options) -> tuple[str, ...]:
    """Return a sentence on why there is no minimum; none where there is one."""
    system, ledger = state.system, state.ledger
    if not isinstance(system, FrontSystem) or not system.doubt:
        return ()
    why = system.doubt.partition("\n")[0].rstrip(":")
    begin = f"there is no minimum of everything in the graph: {why}"
    if not system.converged:
        return (f"{begin}. Everything is at its start values",)
    there = np.union1d(system.rows, ledger.find(system.joined))
    since = np.setdiff1d(ledger.having("accepted"), there)
    if not len(since):
        return (f"{begin}. Everything is at the last minimum",)
    ids = ledger.ids_of(since)
    message = f"{begin}. Everything is at the last minimum, without {_listed(ids)}"
    tests = list(innovation_tests(ledger, system, since[:MAX_OBSERVATIONS_TESTED], rules.alpha))
    beyond = sorted((t for t in tests if t.ratio > 1.0), key=lambda t: -t.ratio)
    if beyond:
        worst = ledger.ids_of(np.array([beyond[0].row]))[0]
        by = float(np.sqrt(beyond[0].ratio))
        message += f"; {worst!r} contradicts it most ({by:.2g} times the critical value): remove it"
    if weak := [t.row for t in tests if not t.answered]:
        message += f"; of {_listed(ledger.ids_of(np.array(weak)))}: {UNANSWERED}"
    return (message,)


def suspects_doubts(state: IncrementalState, rules: Options) -> tuple[str, ...]:
    """Return sentences on suspects that share an unknown.

    They name the accepted reading without which several suspects fit, since these then control each
    other; or how many suspects share an unknown, for an error that they may have in common.
    """
    ledger, system = state.ledger, state.system
    rows = ledger.having("suspect")
    rows = rows[ledger.rows.photo[rows] == NO_PHOTO]  # see `photo_doubts`
    if system is None or system.doubt or len(rows) < MIN_SUSPECTS_TOGETHER:
        return ()
    suspects = Candidates(ledger, known_in(system), rows)
    inside = Candidates(ledger, NothingKnown(), ledger.having("accepted"))
    left, out = suspects.ready, []
    for variable in _shared(suspects)[:MAX_UNKNOWNS_LOOKED_AT]:
        mine = np.intersect1d(suspects.touching([variable]), left)
        if len(mine) < MIN_SUSPECTS_TOGETHER:
            continue
        message = _contradicted_by(state, variable, mine, inside.touching([variable]), rules)
        if message:
            out.append(message)
            left = np.setdiff1d(left, mine)
    return tuple(out)


def _shared(suspects: Candidates) -> list[Variable]:
    """Return the points and unknowns that several suspects share, those of most suspects first."""
    every = suspects.links.variables
    number = np.bincount(suspects.links.variable, minlength=len(every)).tolist()
    needs = suspects.ledger.needs
    shared = [
        i
        for i, n in enumerate(number)
        if n >= MIN_SUSPECTS_TOGETHER and (every[i][0] == "point" or needs(every[i])[0])
    ]
    return [every[i] for i in sorted(shared, key=lambda i: (-number[i], every[i][0] != "point"))]


def _contradicted_by(
    state: IncrementalState, variable: Variable, suspects: Index, inside: Index, rules: Options
) -> str:
    """Return a sentence on the suspects of a variable; empty: there is no doubt."""
    ledger = state.ledger
    ids = ledger.ids_of(suspects)
    found = _contradicted(state, suspects[-MAX_SUSPECTS_TOGETHER:], inside, rules)
    if found is not None:
        wrong, fitting = found
        return (
            f"suspects {_listed(fitting)} fit without {wrong!r}, which is in: if that is the wrong "
            f"one, remove it, and they come back; {SHARED_ERROR}"
        )
    every = len(suspects) + len(inside)
    if len(suspects) < max(MIN_SUSPECTS_SHARING, MIN_SHARE_OF_SUSPECTS * every):
        return ""
    noun, name = UNKNOWNS[variable[0]].noun, variable[1]
    return (
        f"{len(suspects)} suspects ({_listed(ids)}) touch {noun} {name!r}, of which "
        f"{len(inside)} observations are in: {SHARED_ERROR}"
    )


def _contradicted(
    state: IncrementalState, suspects: Index, inside: Index, rules: Options
) -> tuple[str, list[str]] | None:
    """Return the accepted reading without which most of some suspects fit, and these suspects."""
    ledger = state.ledger
    rows = inside[ledger.rows.photo[inside] == NO_PHOTO][:MAX_READINGS_BESIDE]
    if state.system is None or not len(rows):
        return None
    joint = joined(ledger, state.system, suspects, rows)
    if joint is None:
        return None
    every = np.union1d(suspects, rows)
    out = np.flatnonzero(np.isin(every, suspects))
    best: tuple[int, list[int]] = (0, [])
    for number in np.flatnonzero(np.isin(every, rows)).tolist():
        fits = _fitting_without(joint.tested(), number, out.tolist(), rules.alpha)
        best = (number, fits) if len(fits) > len(best[1]) else best
    number, fits = best
    if len(fits) < MIN_SUSPECTS_TOGETHER or 2 * len(fits) <= len(out):
        return None  # what most do not fit is another error
    return ledger.ids_of(every[[number]])[0], ledger.ids_of(every[fits])


def _fitting_without(
    tested: LeaveOneOutTests, wrong: int, suspects: list[int], alpha: float
) -> list[int]:
    """Return which suspects fit, each against all others, if a reading is left out.

    None where other readings do not fit then. An uncontrolled observation fits anything.
    """
    tested.leave_out(wrong)
    left = list(suspects)
    while left:
        ratios = tested.ratios(alpha)
        worst = max(left, key=lambda i: ratios[i])
        if ratios[worst] <= 1.0:
            dof = tested.statistics()[1]
            return [i for i in left if dof[i]] if (ratios <= 1.0).all() else []
        tested.leave_out(worst)
        left.remove(worst)
    return []


def _listed(ids: list[str]) -> str:
    """Return ids as text: all, or the first of many."""
    return known(map(repr, ids), most=MAX_OBSERVATIONS_NAMED)
