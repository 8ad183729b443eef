"""Which of the waiting things the observations determine by now, and where they are.

A waiting variable enters with all observations that join it to what enters or is known. Counts
come first, then approximate values, then the rank: with known variables held, the partials by
the others must have full column rank, because nothing else can hold them. What the null space
moves stays, with its observations, and the rest is looked at again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..approximate import reach
from ..errors import AdjustmentError, InputError, Problem
from ..graph.equations import Equations, compile_rows
from ..network import DatumChoice, Network
from ..quality.snooping import snoop
from ..quality.solution import Solution
from ..solve.batch import adjust
from ..solve.datum import find_defects
from ..solve.linear import LinearSystem
from ..solve.rank import NOUN, NULL, null_space
from ..types import Array
from .local import describe, local_network
from .register import Register
from .units import Unit, Variable, components, pending

DENSE = 400
"""Columns up to which the rank is found from dense singular values."""
DISTURBED = 3.0
"""σ̂0 of a local adjustment above which gross errors have moved it."""
ABSURD = "some value is absurdly large"
MOST_SNOOPED = 30
"""Rounds of snooping in a local network."""
SHARE = 0.05
"""Part of a null vector's length in a variable from which on the variable counts as moved."""
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


def find(
    network: Network,
    register: Register,
    units: Sequence[Unit],
    *,
    datum: DatumChoice,
    blunders: bool,
    alpha: float,
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
    """
    lacks: dict[Variable, str] = {}
    left = list(units)
    while True:
        left = _countable(network, register, left, lacks, free=datum == "free")
        if not left:
            return Found((), None, lacks)
        local = local_network(network, register, left, datum=datum)
        try:
            equations = compile_rows(local)
            lost = _unreachable(equations, left, lacks, datum)
        except OverflowError:
            return Found((), None, lacks | _all(register, left, ABSURD))
        except InputError as error:
            lost = _named(network, register, error, left, lacks)
            if not lost:
                return Found((), None, lacks | _all(register, left, str(error)))
        if not lost:
            try:
                solution = adjust(
                    local, datum=datum, tolerance=LEFT_AT_REST if datum == "free" else 1e-4
                )
            except AdjustmentError as error:
                return Found((), None, lacks | _all(register, left, str(error)))
            if not solution.converged and not solution.redundancy:
                return Found((), None, lacks | _all(register, left, solution.reason))
            if blunders and solution.sigma0 > DISTURBED:
                solution = _without_blunders(solution, alpha)
            return Found(tuple(left), solution, lacks)
        left = [u for u in left if not lost & set(u.variables)]


def _without_blunders(solution: Solution, alpha: float) -> Solution:
    """Return the solution where the network is without what stands out."""
    try:
        clean = snoop(solution.network, start=solution, alpha=alpha, max_rounds=MOST_SNOOPED)
    except AdjustmentError:
        return solution
    unknowns = solution.equations.unknowns
    found = clean.solution
    everything = {k: np.ones(v.shape, dtype=bool) for k, v in solution.state.items()}
    state = unknowns.carried(
        solution.state, found.equations.unknowns, found.state, where=everything
    )
    return replace(solution, state=state)


def _all(register: Register, units: Iterable[Unit], why: str) -> dict[Variable, str]:
    return {v: why for u in units for v in pending(register, u)}


def _countable(
    network: Network,
    register: Register,
    units: list[Unit],
    lacks: dict[Variable, str],
    *,
    free: bool,
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
        total = weights = 0
        for v, n in rows.items():
            if v not in needs:
                needs[v] = components(network, v)
            size, own = needs[v]
            total, weights = total + size, weights + own
            if n + own < size:
                lost.add(v)
                usable = sum(u.n_scalars for u in every[v])
                of_known = "" if usable == n else " are between things that can be determined"
                lacks[v] = (
                    f"{NOUN[v[0]]} {v[1]!r} has {describe(every[v], v)}: "
                    f"{n + own} of the {size} readings that it needs{of_known}"
                )
        n_rows = sum(u.n_scalars for u in units) + weights
        if not lost and n_rows < total - (7 if free else 0):
            for v in rows:
                lacks[v] = f"{n_rows} readings for {total} unknowns that hang together"
            return []
        if not lost:
            return units
        units = [u for u in units if not lost & set(u.variables)]
    return []


def _unreachable(
    equations: Equations, units: list[Unit], lacks: dict[Variable, str], datum: DatumChoice
) -> set[Variable]:
    """Return variables without approximate values, or that the observations do not determine."""
    state, problems = reach(equations, datum=datum)
    unknowns = equations.unknowns
    lost: set[Variable] = set()
    for kind, table in unknowns.tables.items():
        for i in np.flatnonzero(np.isnan(state[kind]).any(axis=1)).tolist():
            if problems or kind != "calibration":
                lost.add((kind, table.names[i]))
    if problems and lost:
        geometric = {v for v in lost if v[0] in ("point", "pose")}
        lost = geometric or lost
        for v in lost:
            lacks[v] = _why(problems, v)
        return lost
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
                        lacks[v] = f"{NOUN[kind]} {v[1]!r} is not joined to the free network"
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
        if share[unknowns.columns(kind, number)].sum() > SHARE:
            v = (kind, unknowns[kind].names[number])
            lost.add(v)
            of = [u for u in units if v in u.variables]
            lacks[v] = f"{NOUN[kind]} {v[1]!r} is not determined by {describe(of, v)}"
    if not lost:  # spread thinly over very many: all of them
        for kind, number in unknowns.active():
            if share[unknowns.columns(kind, number)].any():
                v = (kind, unknowns[kind].names[number])
                lost.add(v)
                lacks[v] = f"{NOUN[kind]} {v[1]!r} has no datum yet"
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


def _why(problems: Sequence[Problem], variable: Variable) -> str:
    """Return the reason that names a variable."""
    for p in problems:
        if repr(variable[1]) in (p.where or "") or variable[1] in (p.where or ""):
            return str(p)
    return str(problems[0])


def _named(
    network: Network,
    register: Register,
    error: InputError,
    units: list[Unit],
    lacks: dict[Variable, str],
) -> set[Variable]:
    """Return the waiting variables of the observations that an error names."""
    lost: set[Variable] = set()
    for unit in units:
        labels = [o.label() for o in unit.observations]
        for p in error.problems:
            if any(label in (p.where or "") for label in labels):
                for v in pending(register, unit):
                    if v[0] in ("point", "pose"):
                        lost.add(v)
                        lacks[v] = str(p)
    return lost
