"""How far a system is from the minimum of what is in the graph, and how its σ differ from there.

In small networks all observations are linearised where everything is by now: the Gauss-Newton step
from there is what the system lacks, and its cofactors are compared with those of that place. In
large ones `holding` looks at the linear forms of the base now and then, and predicts in between.
"""

from __future__ import annotations

import numpy as np

from ..errors import AdjustmentError
from ..solve.singular import SingularError
from ..types import NO_ROWS
from .forms import Forms
from .holding import largest_step, within
from .ledger import Ledger
from .rebasing import Draft
from .rules import Rules
from .system import System

MOST_UNKNOWNS = 250
"""Largest number of unknowns of a network that is linearised anew after every change: the look at
its linear forms would take as long."""
SHARE = 0.9
"""Part of the promised accuracy by which a standard deviation may differ there."""


def is_small(system: System) -> bool:
    """Return whether everything is linearised after every change."""
    return system.unknowns.n_columns <= MOST_UNKNOWNS


def near_minimum(
    ledger: Ledger, system: System, rules: Rules, arrived: Forms | None = None
) -> System | None:
    """Return a system, moved if need be, within the promised accuracy of the minimum.

    None: only a new base is.

    Args:
        ledger: what is in the graph.
        system: the system of that.
        rules: the options.
        arrived: forms that the system has just taken in.

    Raises:
        InputError: names observations whose geometry has no answer at the present state.
    """
    if system.section is not None or not is_small(system):
        return within(system, rules.accuracy, arrived)
    try:
        return system if _is_near(ledger, system, rules) else None
    except (AdjustmentError, SingularError):
        return None


def _is_near(ledger: Ledger, system: System, rules: Rules) -> bool:
    """Return whether step and standard deviations are within what is promised."""
    draft = Draft.of(ledger, system, rules.datum)
    unknowns = draft.equations.unknowns
    normal, constraint = draft.normal(system.base)
    factor = normal.factorise(constraint)
    n = unknowns.n_columns
    solved = factor.solve(np.column_stack([normal.gradient, np.eye(n)]))
    variance = np.where(unknowns.free, np.maximum(np.diag(solved[:, 1:]), 0.0), 0.0)
    there = variance > 0.0
    step = np.abs(solved[there, 0]) / np.sqrt(variance[there])
    if not np.max(step, initial=0.0) <= largest_step(system, rules.accuracy):
        return False
    own = np.zeros(n)
    for kind, number in unknowns.active():
        v = kind, unknowns[kind].names[number]
        columns = unknowns.columns(kind, number)
        found = np.diag(system.cofactors(v, v)) if len(columns) else NO_ROWS
        own[columns] = found[: len(columns)]
    ratio = np.sqrt(np.maximum(own[there], 0.0) / variance[there])
    return bool(np.max(np.abs(ratio - 1.0), initial=0.0) <= SHARE * rules.accuracy)
