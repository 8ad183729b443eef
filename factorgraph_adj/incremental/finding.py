"""Which of the waiting things the observations determine by now, and where they are.

A waiting variable enters with all observations that join it to what enters or is known. Counts
come first, then approximate values, then the rank: with known variables held, the partials by
the others must have full column rank, because nothing else can hold them. What the null space
moves stays, with its observations, and the rest is looked at again. So does a point that may be
anywhere, see `factorgraph_adj.solve.anywhere`.

What is left in the end is the largest set of variables that determines itself. It does not depend
on the order in which its observations came: more observations make it larger, never smaller.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..approximate import reach
from ..errors import AdjustmentError, DatumError, InputError, Problem
from ..graph.equations import Equations, compile_rows
from ..graph.variables import State
from ..models.variables import UNKNOWNS
from ..network.network import DatumChoice, Network
from ..observations import ControlPoint, PhotoPosition
from ..quality.snooping import snoop
from ..solve.anywhere import anywhere
from ..solve.batch import adjust
from ..solve.datum import find_defects
from ..solve.linear import LinearSystem
from ..solve.rank import NULL, null_space
from ..solve.solution import Solution
from ..types import Array
from .candidates import Candidates
from .excerpt import excerpt
from .ledger import Some
from .units import Variable, components


@dataclass(frozen=True)
class Limits:
    """Limits of the search."""

    dense: int = 400
    """Number of columns up to which the rank is found from dense singular values."""
    disturbed: float = 3.0
    """Value of σ̂0 of a local adjustment above which gross errors have moved it."""
    rounds: int = 30
    """Largest number of rounds of snooping in a local network."""
    spare: int = 1
    """Readings beyond the number of its components that a point may have and still wait on."""
    share: float = 0.05
    """Part of the length of a null vector in a variable from which on the variable is moved."""
    ever_so_little: float = 1e-6
    """The same limit in the search for the weakest of all moved variables."""
    at_rest: float = 1e-7
    """Bound of the last step of the local adjustment that begins a free network."""


LIMITS = Limits()
"""The limits of `find` and `determined`."""
ABSURD = "some value is absurdly large"
RUNS_AWAY = "its observations hardly determine it: their adjustment runs away"
NOWHERE = "has no datum yet: nothing that it hangs together with is known, held or weighted"


@dataclass(frozen=True)
class Found:
    """What may enter."""

    some: Some
    """Observations that enter; none: nothing does."""
    solution: Solution | None
    """Their adjustment with what is known held."""
    lacks: Mapping[Variable, str]
    """Why the others wait."""


def find(
    given: Candidates,
    *,
    datum: DatumChoice,
    blunders: bool,
    alpha: float,
    start: Solution | None = None,
) -> Found:
    """Find what of some observations can enter.

    Args:
        given: observations that wait, joined by their open variables.
        datum: ``free`` for the beginning of a free network.
        blunders: whether gross errors are to be expected: the adjustment then is one without what
            stands out, as a place to start from. It is not their test.
        alpha: probability of a false alarm of the tests that find what stands out.
        start: where everything was, if it was; none: approximate values are found.
    """
    lacks: dict[Variable, str] = {}
    left = given
    while (left := _countable(left, lacks, free=datum == "free")).some:
        local = excerpt(left.ledger, left.known, left.some, datum=datum)
        if datum == "given" and not _placed(local):
            return Found(Some.none(), None, lacks | _all(left, NOWHERE))
        lost: set[Variable] = set()
        whys: dict[Variable, str] = {}
        try:
            lost = _unreachable(compile_rows(local), left, lacks, datum)
            if not lost:
                solution = _adjusted(local, datum, start)
                lost = _anywhere(solution, left, lacks)
                # What disagrees may come to rest without its gross errors; what creeps is too weak.
                disturbed = solution.sigma0 > LIMITS.disturbed
                if not lost and (solution.converged or disturbed):
                    if blunders and disturbed:
                        solution = _without_blunders(solution, alpha)
                    return Found(left.some, solution, lacks)
                whys = _disagreeing(left, solution.reason)
        except OverflowError:
            whys = _all(left, ABSURD)
        except AdjustmentError as error:
            lost = _named(left, error, lacks)
            whys = _all(left, RUNS_AWAY if isinstance(error, DatumError) else str(error))
        if lost:
            left = left.without(lost)
        else:
            lacks |= whys
            left = left.only(firm(left))
    return Found(Some.none(), None, lacks)


def _adjusted(local: Network, datum: DatumChoice, start: Solution | None) -> Solution:
    """Adjust from where everything was; from approximate values where that leads nowhere."""
    tolerance = LIMITS.at_rest if datum == "free" else 1e-4
    if start is not None:
        with suppress(AdjustmentError):
            solution = adjust(local, datum=datum, start=start, tolerance=tolerance)
            if solution.converged:
                return solution
    return adjust(local, datum=datum, tolerance=tolerance)


def _anywhere(solution: Solution, left: Candidates, lacks: dict[Variable, str]) -> set[Variable]:
    """Return waiting points of which their readings do not say where they are."""
    lost: set[Variable] = set()
    for point in anywhere(solution):
        if left.known.value("point", point.name) is None:
            lost.add(("point", point.name))
            lacks["point", point.name] = str(point)
    return lost


def _placed(local: Network) -> bool:
    """Return whether anything says where a local network is; its rank need not be looked at."""
    return (
        any(p.sigma is not None or any(p.fixed) for p in local.points.values())
        or any(f.sigma_position is not None or any(f.fixed[3:]) for f in local.photos.values())
        or any(isinstance(o, ControlPoint | PhotoPosition) for o in local.observations.values())
    )


def _without_blunders(solution: Solution, alpha: float) -> Solution:
    """Return the solution where the network is without what stands out."""
    try:
        clean = snoop(solution.network, start=solution, alpha=alpha, max_rounds=LIMITS.rounds)
    except AdjustmentError:
        return solution
    unknowns = solution.equations.unknowns
    found = clean.solution
    state = unknowns.carried(solution.state, found.equations.unknowns, found.state)
    return replace(solution, state=state)


def firm(left: Candidates) -> Some:
    """Return candidates without those of points that have hardly more readings than they need.

    These add next to nothing to what else enters, and a wrong one keeps all of it from a solution.
    Nothing is returned where there are no such points, or nothing else.
    """
    weak = set()
    for v, n in left.rows.items():
        if v[0] == "point":
            size, own = components(left.ledger.network, v)
            if n + own <= size + LIMITS.spare:
                weak.add(v)
    rest = left.without(weak)
    return rest.some if weak and rest.rows else Some.none()


def _all(left: Candidates, why: str) -> dict[Variable, str]:
    return dict.fromkeys(left.rows, why)


def _disagreeing(left: Candidates, reason: str) -> dict[Variable, str]:
    """Return for each waiting variable of which observations no adjustment came to rest, and why.

    Their approximate values are found, and lead to no minimum: one of them may be grossly wrong.
    """
    return {
        v: f"{UNKNOWNS[v[0]].noun} {v[1]!r} has {left.describe(v)}, which agree nowhere: {reason}"
        for v in left.rows
    }


def determined(given: Candidates, *, datum: DatumChoice) -> Some:
    """Return observations whose variables have full rank together, at approximate values.

    Whether their adjustment comes to rest is not looked at. The others may still be determined
    among themselves: `find` looks at them more closely.
    """
    lacks: dict[Variable, str] = {}
    left = given
    try:
        while (left := counted(left, lacks)).some:
            local = excerpt(left.ledger, left.known, left.some, datum=datum)
            if datum == "given" and not _placed(local):
                return Some.none()
            equations = compile_rows(local)
            state, lost = _started(equations, lacks, datum)
            if not lost:
                loose = _loose(equations, state, left, lacks, datum, least=LIMITS.ever_so_little)
                if not loose:
                    return left.some
                lost = _weakest(left, loose)
            left = left.without(lost)
    except (AdjustmentError, OverflowError):
        pass  # `find` names the observations
    return Some.none()


def _weakest(left: Candidates, variables: set[Variable]) -> set[Variable]:
    """Return those of some variables that have fewest readings beyond their components.

    What is loose may move much that is not: a free network tilts with a zenith angle to a point
    that nothing else determines. Without that point it is at rest.
    """
    spare: dict[Variable, int] = {}
    for v in variables:
        size, own = components(left.ledger.network, v)
        spare[v] = own - size + left.rows.get(v, 0)
    least = min(spare.values())
    return {v for v, n in spare.items() if n == least}


def _countable(left: Candidates, lacks: dict[Variable, str], *, free: bool) -> Candidates:
    """Return the candidates of `_counted`; none where all are fewer rows than components."""
    left = counted(left, lacks)
    needs = [components(left.ledger.network, v) for v in left.rows]
    total = sum(size for size, _ in needs)
    n_rows = left.some.n_rows + sum(own for _, own in needs)
    if n_rows >= total - (7 if free else 0):
        return left
    for v in left.rows:
        lacks[v] = f"{n_rows} readings for {total} unknowns that hang together"
    return left.only(Some.none())


def counted(left: Candidates, lacks: dict[Variable, str]) -> Candidates:
    """Return the candidates whose open variables all have as many rows as components."""
    first = left
    network = left.ledger.network
    needs: dict[Variable, tuple[int, int]] = {}
    while left.some:
        lost = set()
        for v, n in left.rows.items():
            if v not in needs:
                needs[v] = components(network, v)
            size, own = needs[v]
            if n + own < size:
                lost.add(v)
                usable = first.rows[v]
                of_known = "" if usable == n else " are between things that can be determined"
                lacks[v] = (
                    f"{UNKNOWNS[v[0]].noun} {v[1]!r} has {first.describe(v)}: "
                    f"{n + own} of the {size} readings that it needs{of_known}"
                )
        if not lost:
            return left
        left = left.without(lost)
    return left


def _unreachable(
    equations: Equations, left: Candidates, lacks: dict[Variable, str], datum: DatumChoice
) -> set[Variable]:
    """Return variables without approximate values, or that the observations do not determine.

    Points come first: a photo may do without one of its points.
    """
    state, lost = _started(equations, lacks, datum)
    return lost or _points_first(_loose(equations, state, left, lacks, datum))


def _started(
    equations: Equations, lacks: dict[Variable, str], datum: DatumChoice
) -> tuple[State, set[Variable]]:
    """Return approximate values, and the variables for which there are none."""
    state, problems = reach(equations, datum=datum)
    lost: set[Variable] = set()
    for kind, table in equations.unknowns.tables.items():
        for i in np.flatnonzero(np.isnan(state[kind]).any(axis=1)).tolist():
            if problems or kind != "calibration":
                lost.add((kind, table.names[i]))
    if not problems:
        return state, set()
    lost = {v for v in lost if v[0] in ("point", "pose")} or lost
    for v in lost:
        lacks[v] = _why(problems, v)
    return state, lost


def _loose(
    equations: Equations,
    state: State,
    left: Candidates,
    lacks: dict[Variable, str],
    datum: DatumChoice,
    *,
    least: float = LIMITS.share,
) -> set[Variable]:
    """Return the variables that the null space of the observations at a state moves.

    Args:
        equations: of the observations.
        state: where they are linearised.
        left: the observations.
        lacks: gets why they are not determined.
        datum: given or free.
        least: part of a null vector's length in a variable that counts as moved.
    """
    unknowns = equations.unknowns
    system = LinearSystem(equations.weighted_at(state), state)
    diagonal = system.diagonal()
    z = _null(system, diagonal)
    if datum == "free" and z.shape[1]:
        defects = find_defects(system, state, diagonal, free=True)
        if len(defects) > 1:
            keep = max(defects, key=lambda d: len(d.part))
            others = [d.part for d in defects if d is not keep]
            return _in_columns(equations, np.concatenate(others), lacks)
        if defects:
            scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0)), 1.0)
            basis, _ = np.linalg.qr(scale[:, None] * defects[0].motions)
            z = z - basis @ (basis.T @ z)
            u, s, _ = np.linalg.svd(z, full_matrices=False)
            z = u[:, s > 0.5]
    if not z.shape[1]:
        return set()
    share = np.sum(z * z, axis=1)
    lost: set[Variable] = set()
    for kind, number in unknowns.active():
        if share[unknowns.columns(kind, number)].sum() > least:
            v = (kind, unknowns[kind].names[number])
            lost.add(v)
            lacks[v] = f"{UNKNOWNS[kind].noun} {v[1]!r} is not determined by {left.describe(v)}"
    if not lost:  # spread thinly over very many: all of them
        for kind, number in unknowns.active():
            if share[unknowns.columns(kind, number)].any():
                v = (kind, unknowns[kind].names[number])
                lost.add(v)
                lacks[v] = f"{UNKNOWNS[kind].noun} {v[1]!r} has no datum yet"
    return lost


def _in_columns(equations: Equations, columns: Array, lacks: dict[Variable, str]) -> set[Variable]:
    """Return the variables of columns that are not joined to the free network."""
    unknowns = equations.unknowns
    lost: set[Variable] = set()
    for kind, number in unknowns.active():
        if np.isin(unknowns.columns(kind, number), columns).any():
            v = (kind, unknowns[kind].names[number])
            lost.add(v)
            lacks[v] = f"{UNKNOWNS[kind].noun} {v[1]!r} is not joined to the free network"
    return lost


def _null(system: LinearSystem, diagonal: Array) -> Array:
    """Return a basis of what is undetermined, scaled by √diagonal, (n_columns, d)."""
    n = system.unknowns.n_columns
    if n > LIMITS.dense:
        return null_space(system, diagonal)
    free = np.flatnonzero(system.unknowns.free)
    if not len(free):
        return np.zeros((n, 0))
    unit = np.zeros((n, len(free)))
    scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0.0)), 1.0)
    unit[free, np.arange(len(free))] = 1.0 / scale[free]
    a = system.times(unit)
    _, s, vt = np.linalg.svd(a, full_matrices=True)
    values = np.zeros(len(free))
    values[: len(s)] = s
    out = np.zeros((n, int((values < NULL).sum())))
    out[free] = vt[values < NULL].T
    return out


def _points_first(variables: Iterable[Variable]) -> set[Variable]:
    """Return the points of them, if there are any: a photo may do without one of its points."""
    return {v for v in variables if v[0] == "point"} or set(variables)


def _why(problems: Sequence[Problem], variable: Variable) -> str:
    """Return the reason that names a variable."""
    for p in problems:
        if repr(variable[1]) in (p.where or "") or variable[1] in (p.where or ""):
            return str(p)
    return str(problems[0])


def _named(left: Candidates, error: AdjustmentError, lacks: dict[Variable, str]) -> set[Variable]:
    """Return the waiting variables that an error is about, points first."""
    lost: set[Variable] = set()
    if isinstance(error, DatumError):
        lost = _points_first(left.rows.keys() & set(error.unknowns))
        for v in lost:
            lacks[v] = f"{UNKNOWNS[v[0]].noun} {v[1]!r} is not determined by {left.describe(v)}"
    elif isinstance(error, InputError):
        about = _labels(left)
        for p in error.problems:
            where = p.where or ""
            # The observation, or one of its components.
            for v in about.get(where, about.get(where.rpartition(" ")[0], [])):
                lost.add(v)
                lacks[v] = str(p)
    return lost


def _labels(left: Candidates) -> dict[str, list[Variable]]:
    """Return the open points, or photos, of every observation by its label."""
    out: dict[str, list[Variable]] = {}
    geometric = ("point", "pose")
    for unit, variables in zip(left.some.units, left.of_units, strict=True):
        found = sorted(_points_first(v for v in variables if v[0] in geometric))
        out |= {o.label(): found for o in unit.observations}
    rays, names = left.ledger.rays, left.ledger.names
    (poses, photo, open_pose), _, (places, point, open_point) = left.of_rays
    for i, row in enumerate(left.some.rays.tolist()):
        of_point = [places[point[i]]] if open_point[point[i]] else []
        of_photo = [poses[photo[i]]] if open_pose[photo[i]] else []
        out[rays.observation(names, row).label()] = of_point or of_photo
    return out | {f"photo {v[1]!r}": [v] for v in left.rows if v[0] == "pose"}
