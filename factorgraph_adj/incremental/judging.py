"""Which of the arriving units stay, by the policy, and what their verdicts say."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..graph.keys import KeyMap
from ..models.variables import VariableKind
from ..types import Array, Index
from .engine import Engine
from .trial import Trial
from .units import Unit
from .verdicts import UNCONTROLLED, Gain, Outcome, Policy, Verdict, critical_t2, pseudo_inverse

MOST_GAINS = 300
"""Units of one arrival up to which it is worked out what each adds to its points."""
TIED = 1e-5
"""Eigenvalue of M up to which rows are all that determines something: without them its standard
deviation would be more than 300 times as large."""
NOTHING = 1e-9
"""Eigenvalue of M, and part of σ, that are rounding."""
MOVES = 1e-3
"""Movement relative to σ by which a variable takes part in a null motion."""


@dataclass
class Decision:
    """What happens to the units of a trial."""

    stay: list[Unit] = field(default_factory=list)
    beyond: dict[str, tuple[float, int, Array, Array]] = field(default_factory=dict)
    """Units left out because of their test: T², degrees of freedom, M and v at that moment."""
    left_out: list[Unit] = field(default_factory=list)
    """Those units."""
    back: list[Unit] = field(default_factory=list)
    """Units that contradict each other: the next ones may tell which is wrong."""
    apart: list[Unit] = field(default_factory=list)
    """Units, of the trial or not, that had to wait again so that the others could enter."""
    leaving: list[tuple[VariableKind, int]] = field(default_factory=list)
    """Variables that they alone determined."""

    def join(self, other: Decision) -> None:
        """Take in what happens to other units."""
        self.stay += other.stay
        self.beyond |= other.beyond
        self.left_out += other.left_out
        self.back += other.back
        self.leaving += other.leaving


def decide(engine: Engine, trial: Trial, *, policy: Policy, alpha: float) -> Decision:
    """Leave out units one by one, the one with the largest T²/critical first."""
    out = Decision(stay=list(trial.units))
    if policy == "accept":
        return out
    judged = trial.judged
    entered = set(trial.entered)
    while out.stay:
        ratios = np.array([_ratio(trial, u, alpha) for u in out.stay])
        worst = int(np.argmax(ratios))
        if not ratios[worst] > 1.0:
            return out
        unit = out.stay[worst]
        rows = trial.rows[unit.ids[0]]
        values = np.linalg.eigvalsh(judged.m[np.ix_(rows, rows)])
        lost = set() if values[0] > TIED else _held_by(engine, trial, rows, entered)
        if lost:
            # Without it something is not determined: whoever joins that goes back to waiting.
            touching = [u for u in out.stay if lost & _variables(engine, u)]
            taken = np.concatenate([trial.rows[u.ids[0]] for u in touching])
            out.back += touching
            out.leaving += sorted(lost)
        else:
            t2, dof = judged.test(rows)
            out.beyond[unit.ids[0]] = (
                *(t2, dof, judged.m[np.ix_(rows, rows)].copy(), judged.v[rows].copy()),
            )
            out.left_out.append(unit)
            touching, taken = [unit], rows
        trial.take_out(taken)
        out.stay = [u for u in out.stay if u not in touching]
    return out


def _ratio(trial: Trial, unit: Unit, alpha: float) -> float:
    t2, dof = trial.judged.test(trial.rows[unit.ids[0]])
    if np.isnan(t2):  # too far off for its square: beyond every critical value
        return np.inf
    return t2 / critical_t2(alpha, dof) if dof else 0.0


def _variables(engine: Engine, unit: Unit) -> set[tuple[VariableKind, int]]:
    return {
        (kind, number)
        for kind, name in unit.variables
        if (number := engine.register[kind].number.get(name)) is not None
    }


def _held_by(
    engine: Engine, trial: Trial, rows: Index, entered: set[tuple[VariableKind, int]]
) -> set[tuple[VariableKind, int]]:
    """Return the entering variables that only these rows keep determined."""
    m = trial.judged.m[np.ix_(rows, rows)]
    values, vectors = np.linalg.eigh(m)
    null = vectors[:, values <= TIED]
    motion = trial.spread[:, rows] @ null
    sigma = np.sqrt(np.maximum(trial.variances, 0.0))
    lost = set()
    for key, columns in trial.system.column.items():
        variable = engine.register.variable(key)
        if variable not in entered:
            continue
        moved = np.abs(motion[columns]) / np.where(sigma[columns] > 0, sigma[columns], 1.0)[:, None]
        if (moved > MOVES).any():
            lost.add(variable)
    return lost


def verdicts(
    engine: Engine,
    trial: Trial,
    decision: Decision,
    *,
    policy: Policy,
    alpha: float,
    entered: set[str],
    lacks: str,
) -> list[Verdict]:
    """Return the verdict of every observation of a trial, in the order of its units.

    Args:
        engine: what it was put into.
        trial: the units.
        decision: what happens to them.
        policy: what becomes of those beyond the critical value.
        alpha: probability of a false alarm of one test.
        entered: ids of units that had been waiting.
        lacks: what those lack that contradict each other.
    """
    back = {u.ids[0] for u in decision.back}
    with_gains = len(trial.units) <= MOST_GAINS and not engine.held
    out: list[Verdict] = []
    for unit in trial.units:
        first = unit.ids[0]
        rows = trial.rows[first]
        outcome: Outcome = "accepted"
        why = ""
        if first in back:
            outcome, why = "waiting", lacks
            m, v = trial.judged.m[np.ix_(rows, rows)], trial.judged.v[rows]
            t2, dof = np.nan, 0
        elif first in decision.beyond:
            outcome = "rejected" if policy == "reject" else "suspect"
            t2, dof, m, v = decision.beyond[first]
        else:
            m, v = trial.judged.m[np.ix_(rows, rows)], trial.judged.v[rows]
            t2, dof = trial.judged.test(rows)
        gains = _gains(engine, trial, unit, rows, m) if with_gains and outcome == "accepted" else ()
        inverse, _ = pseudo_inverse(m)
        raw = trial.system.raw[np.ix_(rows, rows)]
        innovation = raw @ inverse @ v
        sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", raw, inverse, raw), 0.0))
        pv = np.linalg.solve(raw.T, v)
        half = np.linalg.inv(raw)
        precision = np.einsum("ji,jk,ki->i", half, m, half)
        weight = np.einsum("ji,ji->i", half, half)
        controlled = precision > UNCONTROLLED * weight
        w = np.where(controlled, pv / np.sqrt(np.where(controlled, precision, 1.0)), np.nan)
        r = np.einsum("ij,jk,ki->i", raw, m, half)
        sigma = np.where(controlled, sigma, np.inf)
        innovation = np.where(controlled, innovation, np.nan)
        at = 0
        for ident, o in zip(unit.ids, unit.observations, strict=True):
            part = slice(at, at + len(o.component_names()))
            at = part.stop
            out.append(
                Verdict(
                    ident,
                    o.kind,
                    o.label(),
                    outcome,
                    o.component_names(),
                    innovation[part],
                    sigma[part],
                    w[part],
                    r[part],
                    t2,
                    dof,
                    critical_t2(alpha, dof),
                    first in entered,
                    why,
                    unit.points,
                    gains,
                )
            )
    return out


def waiting(unit: Unit, lacks: str) -> list[Verdict]:
    """Return the verdicts of a unit that waits."""
    return [
        Verdict(
            i, o.kind, o.label(), "waiting", o.component_names(), lacks=lacks, points=unit.points
        )
        for i, o in zip(unit.ids, unit.observations, strict=True)
    ]


def _gains(engine: Engine, trial: Trial, unit: Unit, rows: Index, m: Array) -> tuple[Gain, ...]:
    """Return what a unit adds to its points: without it, Q + Q Aᵀ M⁻¹ A Q."""
    out = []
    values, vectors = np.linalg.eigh(m)
    on = values > NOTHING
    for kind, name in unit.variables:
        if kind != "point":
            continue
        number = engine.register[kind].number[name]
        free = engine.register[kind].free.view[number]
        if not free.any():
            continue
        columns = trial.system.column[KeyMap.of(kind, number)]
        variance = np.maximum(trial.variances[columns], 0.0)
        turned = trial.spread[np.ix_(columns, rows)] @ vectors
        more = (turned[:, on] ** 2 / values[on]).sum(axis=1)
        lost = (np.abs(turned[:, ~on]) > NOTHING * np.sqrt(variance)[:, None]).any(axis=1)
        after, before = np.zeros(3), np.zeros(3)
        after[free] = np.sqrt(variance)
        before[free] = np.where(lost, np.inf, np.sqrt(variance + more))
        out.append(Gain(name, before, after))
    return tuple(out)
