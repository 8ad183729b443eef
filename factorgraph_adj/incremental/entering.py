"""Which of the waiting things the observations determine by now, and where they are.

A waiting variable enters with all observations that join it to what enters or is known. Counts
come first, then approximate values, then the rank: with known variables held, the partials by
the others must have full column rank, because nothing else can hold them. What the null space
moves stays, with its observations, and the rest is looked at again. So does a point that may be
anywhere, see `factorgraph_adj.incremental.anywhere`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
from ..solve.batch import adjust
from ..solve.datum import find_defects
from ..solve.linear import LinearSystem
from ..solve.rank import NULL, null_space
from ..solve.solution import Solution
from ..types import Array
from .anywhere import anywhere
from .local import describe, local_network
from .register import Register
from .units import Unit, Variable, components, pending

DENSE = 400
"""Columns up to which the rank is found from dense singular values."""
DISTURBED = 3.0
"""σ̂0 of a local adjustment above which gross errors have moved it."""
ABSURD = "some value is absurdly large"
RUNS_AWAY = "its observations hardly determine it: their adjustment runs away"
NOWHERE = "has no datum yet: nothing that it hangs together with is known, held or weighted"
MOST_SNOOPED = 30
"""Rounds of snooping in a local network."""
SPARE = 1
"""Readings more than its components that a point has at most to be one that may wait on."""
SHARE = 0.05
"""Part of a null vector's length in a variable from which on the variable counts as moved."""
EVER_SO_LITTLE = 1e-6
"""The same where the weakest of all that moves is looked for."""
LEFT_AT_REST = 1e-7
"""Bound of the last step of a local adjustment, relative to σ."""


@dataclass(frozen=True)
class Found:
    """What may enter."""

    units: tuple[Unit, ...]
    """Units that enter; none: nothing does."""
    solution: Solution | None
    """Their adjustment with what is known held."""
    lacks: dict[Variable, str]
    """Why the others wait."""
    aside: tuple[Unit, ...] = ()
    """Units that kept those from entering; they may enter once those are in."""


def find(
    network: Network,
    register: Register,
    units: Sequence[Unit],
    *,
    datum: DatumChoice,
    blunders: bool,
    alpha: float,
    start: Solution | None = None,
) -> Found:
    """Find what of some units can enter.

    Args:
        network: everything that was described.
        register: what is known.
        units: units that wait, joined by their waiting variables.
        datum: ``free`` for the beginning of a free network.
        blunders: whether gross errors are to be expected: the adjustment then is one without what
            stands out, as a place to start from. It is not their test.
        alpha: of the tests that find what stands out.
        start: where everything was, if it was; none: approximate values are found.
    """
    lacks: dict[Variable, str] = {}
    aside: list[Unit] = []
    left = list(units)
    while left := _countable(network, register, left, lacks, free=datum == "free"):
        local = local_network(network, register, left, datum=datum)
        if datum == "given" and not _placed(local):
            return Found((), None, lacks | _all(register, left, NOWHERE))
        lost: set[Variable] = set()
        whys: dict[Variable, str] = {}
        try:
            lost = _unreachable(compile_rows(local), left, lacks, datum)
            if not lost:
                solution = _adjusted(local, datum, start)
                lost = _anywhere(solution, register, lacks)
                if not lost and (solution.converged or solution.redundancy):
                    if blunders and solution.sigma0 > DISTURBED:
                        solution = _without_blunders(solution, alpha)
                    return Found(tuple(left), solution, lacks, tuple(aside))
                whys = _disagreeing(register, left, solution.reason)
        except OverflowError:
            whys = _all(register, left, ABSURD)
        except AdjustmentError as error:
            lost = _named(register, error, left, lacks)
            why = RUNS_AWAY if isinstance(error, DatumError) else str(error)
            whys = _all(register, left, why)
        if lost:
            rest = [u for u in left if not lost.intersection(u.variables)]
        else:
            lacks |= whys
            rest = firm(network, register, left)
        stay = {u.ids[0] for u in rest}
        aside += [u for u in left if u.ids[0] not in stay]
        left = rest
    return Found((), None, lacks)


def _adjusted(local: Network, datum: DatumChoice, start: Solution | None) -> Solution:
    """Adjust from where everything was; from approximate values where that leads nowhere."""
    tolerance = LEFT_AT_REST if datum == "free" else 1e-4
    if start is not None:
        with suppress(AdjustmentError):
            solution = adjust(local, datum=datum, start=start, tolerance=tolerance)
            if solution.converged:
                return solution
    return adjust(local, datum=datum, tolerance=tolerance)


def _anywhere(solution: Solution, register: Register, lacks: dict[Variable, str]) -> set[Variable]:
    """Return waiting points of which their readings do not say where they are."""
    lost: set[Variable] = set()
    for point in anywhere(solution):
        if not register.known("point", point.name):
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
        clean = snoop(solution.network, start=solution, alpha=alpha, max_rounds=MOST_SNOOPED)
    except AdjustmentError:
        return solution
    unknowns = solution.equations.unknowns
    found = clean.solution
    state = unknowns.carried(solution.state, found.equations.unknowns, found.state)
    return replace(solution, state=state)


def firm(network: Network, register: Register, units: Sequence[Unit]) -> list[Unit]:
    """Return units without those of points that have hardly more readings than they need.

    These add next to nothing to what else enters, and a wrong one keeps all of it from a solution.
    Nothing is returned where there are no such points, or nothing else.
    """
    rows: dict[Variable, int] = {}
    for u in units:
        for v in pending(register, u):
            if v[0] == "point":
                rows[v] = rows.get(v, 0) + u.n_scalars
    weak = set()
    for v, n in rows.items():
        size, own = components(network, v)
        if n + own <= size + SPARE:
            weak.add(v)
    rest = [u for u in units if not weak.intersection(u.variables)]
    return rest if weak and any(pending(register, u) for u in rest) else []


def _all(register: Register, units: Iterable[Unit], why: str) -> dict[Variable, str]:
    return {v: why for u in units for v in pending(register, u)}


def _disagreeing(register: Register, units: Iterable[Unit], reason: str) -> dict[Variable, str]:
    """Return for each waiting variable of which observations no adjustment came to rest, and why.

    Their approximate values are found, and lead to no minimum: one of them may be grossly wrong.
    """
    of: dict[Variable, list[Unit]] = {}
    for unit in units:
        for v in pending(register, unit):
            of.setdefault(v, []).append(unit)
    return {
        v: f"{UNKNOWNS[v[0]].noun} {v[1]!r} has {describe(own, v)}, which agree nowhere: {reason}"
        for v, own in of.items()
    }


def determined(
    network: Network, register: Register, units: Sequence[Unit], *, datum: DatumChoice
) -> list[Unit]:
    """Return units whose variables have full rank together, at given or approximate values.

    Whether their adjustment comes to rest is not looked at. The other units may still be
    determined among themselves: `find` looks at them more closely.

    Args:
        network: everything that was described.
        register: what is known.
        units: all units of a network.
        datum: given or free.
    """
    lacks: dict[Variable, str] = {}
    left = list(units)
    try:
        while left := _counted(network, register, left, lacks):
            local = local_network(network, register, left, datum=datum)
            if datum == "given" and not _placed(local):
                return []
            equations = compile_rows(local)
            state, lost = _started(equations, lacks, datum)
            if not lost:
                loose = _loose(equations, state, left, lacks, datum, least=EVER_SO_LITTLE)
                if not loose:
                    return left
                lost = _weakest(network, left, loose)
            left = [u for u in left if not lost.intersection(u.variables)]
    except (AdjustmentError, OverflowError):
        pass  # `find` names the observations
    return []


def _weakest(network: Network, units: Sequence[Unit], variables: set[Variable]) -> set[Variable]:
    """Return those of some variables that have fewest readings beyond their components.

    What is loose may move much that is not: a free network tilts with a zenith angle to a point
    that nothing else determines. Without that point it is at rest.
    """
    spare: dict[Variable, int] = {}
    for v in variables:
        size, own = components(network, v)
        spare[v] = own - size
    for u in units:
        for v in variables.intersection(u.variables):
            spare[v] += u.n_scalars
    least = min(spare.values())
    return {v for v, n in spare.items() if n == least}


def _countable(
    network: Network,
    register: Register,
    units: list[Unit],
    lacks: dict[Variable, str],
    *,
    free: bool,
) -> list[Unit]:
    """Return the units of `_counted`; none where all of them are fewer rows than components."""
    units = _counted(network, register, units, lacks)
    waiting = dict.fromkeys(v for u in units for v in pending(register, u))
    needs = [components(network, v) for v in waiting]
    total = sum(size for size, _ in needs)
    n_rows = sum(u.n_scalars for u in units) + sum(own for _, own in needs)
    if n_rows >= total - (7 if free else 0):
        return units
    for v in waiting:
        lacks[v] = f"{n_rows} readings for {total} unknowns that hang together"
    return []


def _counted(
    network: Network, register: Register, units: list[Unit], lacks: dict[Variable, str]
) -> list[Unit]:
    """Return the units whose waiting variables all have as many rows as components."""
    needs: dict[Variable, tuple[int, int]] = {}
    every: dict[Variable, list[Unit]] = {}
    for u in units:
        for v in pending(register, u):
            every.setdefault(v, []).append(u)
    while units:
        rows: dict[Variable, int] = {}
        for u in units:
            for v in pending(register, u):
                rows[v] = rows.get(v, 0) + u.n_scalars
        lost = set()
        for v, n in rows.items():
            if v not in needs:
                needs[v] = components(network, v)
            size, own = needs[v]
            if n + own < size:
                lost.add(v)
                usable = sum(u.n_scalars for u in every[v])
                of_known = "" if usable == n else " are between things that can be determined"
                lacks[v] = (
                    f"{UNKNOWNS[v[0]].noun} {v[1]!r} has {describe(every[v], v)}: "
                    f"{n + own} of the {size} readings that it needs{of_known}"
                )
        if not lost:
            return units
        units = [u for u in units if not lost & set(u.variables)]
    return []


def _unreachable(
    equations: Equations, units: list[Unit], lacks: dict[Variable, str], datum: DatumChoice
) -> set[Variable]:
    """Return variables without approximate values, or that the observations do not determine.

    Points come first: a photo may do without one of its points.
    """
    state, lost = _started(equations, lacks, datum)
    return lost or _points_first(_loose(equations, state, units, lacks, datum))


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
    units: list[Unit],
    lacks: dict[Variable, str],
    datum: DatumChoice,
    *,
    least: float = SHARE,
) -> set[Variable]:
    """Return the variables that the null space of the observations at a state moves.

    Args:
        equations: of the units.
        state: where they are linearised.
        units: the units.
        lacks: gets why they are not determined.
        datum: given or free.
        least: part of a null vector's length in a variable that counts as moved.
    """
    unknowns = equations.unknowns
    lost: set[Variable] = set()
    system = LinearSystem(equations.weighted_at(state), state)
    diagonal = system.diagonal()
    z = _null(system, diagonal)
    if datum == "free" and z.shape[1]:
        defects = find_defects(system, state, diagonal, free=True)
        if len(defects) > 1:
            keep = max(defects, key=lambda d: len(d.part))
            outside = np.ones(unknowns.n_columns, dtype=bool)
            outside[keep.part] = False
            for d in defects:
                if d is keep:
                    continue
                for kind, number in unknowns.active():
                    if np.isin(unknowns.columns(kind, number), d.part).any():
                        v = (kind, unknowns[kind].names[number])
                        lost.add(v)
                        lacks[v] = (
                            f"{UNKNOWNS[kind].noun} {v[1]!r} is not joined to the free network"
                        )
            return lost
        if defects:
            scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0)), 1.0)
            basis, _ = np.linalg.qr(scale[:, None] * defects[0].motions)
            z = z - basis @ (basis.T @ z)
            u, s, _ = np.linalg.svd(z, full_matrices=False)
            z = u[:, s > 0.5]
    if not z.shape[1]:
        return set()
    share = np.sum(z * z, axis=1)
    for kind, number in unknowns.active():
        if share[unknowns.columns(kind, number)].sum() > least:
            v = (kind, unknowns[kind].names[number])
            lost.add(v)
            of = [u for u in units if v in u.variables]
            lacks[v] = f"{UNKNOWNS[kind].noun} {v[1]!r} is not determined by {describe(of, v)}"
    if not lost:  # spread thinly over very many: all of them
        for kind, number in unknowns.active():
            if share[unknowns.columns(kind, number)].any():
                v = (kind, unknowns[kind].names[number])
                lost.add(v)
                lacks[v] = f"{UNKNOWNS[kind].noun} {v[1]!r} has no datum yet"
    return lost


def _null(system: LinearSystem, diagonal: Array) -> Array:
    """Return a basis of what is undetermined, scaled by √diagonal, (n_columns, d)."""
    n = system.unknowns.n_columns
    if n > DENSE:
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


def _points_first(variables: set[Variable]) -> set[Variable]:
    """Return the points of them, if there are any: a photo may do without one of its points."""
    return {v for v in variables if v[0] == "point"} or variables


def _why(problems: Sequence[Problem], variable: Variable) -> str:
    """Return the reason that names a variable."""
    for p in problems:
        if repr(variable[1]) in (p.where or "") or variable[1] in (p.where or ""):
            return str(p)
    return str(problems[0])


def _named(
    register: Register, error: AdjustmentError, units: list[Unit], lacks: dict[Variable, str]
) -> set[Variable]:
    """Return the waiting variables that an error is about, points first."""
    waiting = {v for u in units for v in pending(register, u)}
    lost: set[Variable] = set()
    if isinstance(error, DatumError):
        lost = _points_first(waiting & set(error.unknowns))
        of: dict[Variable, list[Unit]] = {v: [] for v in lost}
        for u in units:
            for v in lost.intersection(u.variables):
                of[v].append(u)
        for v in lost:
            lacks[v] = f"{UNKNOWNS[v[0]].noun} {v[1]!r} is not determined by {describe(of[v], v)}"
    elif isinstance(error, InputError):
        about: dict[str, list[Variable]] = {}
        for unit in units:
            late = pending(register, unit)
            geometric = {v for v in late if v[0] in ("point", "pose")}
            for o in unit.observations:
                about[o.label()] = sorted(_points_first(geometric))
        about |= {f"photo {v[1]!r}": [v] for v in waiting if v[0] == "pose"}
        for p in error.problems:
            where = p.where or ""
            # The observation, or one of its components.
            for v in about.get(where, about.get(where.rpartition(" ")[0], [])):
                lost.add(v)
                lacks[v] = str(p)
    return lost
