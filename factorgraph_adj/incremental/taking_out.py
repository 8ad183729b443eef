"""What is not determined any more without some observations, and what has to go with them.

With M = I − A Q Aᵀ of the rows that go, the rest determines everything exactly where M is
regular. A null vector z of M is a motion x = Q Aᵀ z that only these rows see: the variables that
it moves wait again, and with them every observation of theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

import numpy as np

from ..models.variables import VariableKind
from ..types import Array
from .cliques import cofactor_times
from .engine import Engine
from .judging import MOVES, TIED
from .trial import MOST_ROWS
from .units import Unit


@dataclass(frozen=True)
class Loosened:
    """What goes together."""

    ids: tuple[str, ...]
    """Ids of all rows that go, weights of unknowns among them."""
    variables: tuple[tuple[VariableKind, int], ...]
    """Variables that are not determined without them."""


def what_loosens(
    engine: Engine,
    units: Iterable[Unit],
    weights: Iterable[str],
    unit_of: Callable[[str], Unit | None],
) -> Loosened | None:
    """Return what goes with some units; none where that is too much to find out.

    Args:
        engine: the network.
        units: what is to be taken out.
        weights: ids of weighted unknowns that lose their weights.
        unit_of: the unit of an id; none for weights of unknowns.
    """
    going: dict[str, Unit | None] = {i: u for u in units for i in u.ids}
    going |= dict.fromkeys(weights)
    variables: set[tuple[VariableKind, int]] = set()
    while True:
        if engine.store.n_rows_of(going) > MOST_ROWS:
            return None
        trial = engine.trial_of_ids(list(going))
        values, vectors = np.linalg.eigh(trial.judged.m)
        null = vectors[:, values <= TIED]
        if not null.shape[1]:
            break
        places = np.concatenate([engine.register.places(k) for k in trial.system.keys])
        y = np.zeros((engine.register.n_places, null.shape[1]))
        y[places] = trial.system.a.T @ null
        moved = _moved(engine, cofactor_times(engine.cliques(), y))
        if moved <= variables:
            break
        variables |= moved
        for ident in touching(engine, moved):
            unit = unit_of(ident)
            for i in (ident,) if unit is None else unit.ids:
                going[i] = unit
    return Loosened(tuple(going), tuple(sorted(variables)))


def _moved(engine: Engine, x: Array) -> set[tuple[VariableKind, int]]:
    """Return the variables that motions x (n_places, k) move, by their conditional σ."""
    out = set()
    padded = np.append(np.abs(x).max(axis=1), 0.0)
    for kind, table in engine.register.tables.items():
        if table.n:
            far = padded[table.place.view] * np.sqrt(table.weight.view)
            out |= {(kind, i) for i in np.flatnonzero((far > MOVES).any(axis=1)).tolist()}
    return out


def touching(engine: Engine, variables: Collection[tuple[VariableKind, int]]) -> list[str]:
    """Return the ids of all rows that touch variables."""
    wanted: dict[VariableKind, list[int]] = {}
    for kind, number in variables:
        wanted.setdefault(kind, []).append(number)
    found: dict[str, None] = {}
    for rows in engine.store.kinds.values():
        touched = np.zeros(rows.n, dtype=bool)
        for kind, index in zip(rows.kinds, rows.index, strict=True):
            if kind in wanted:
                touched |= np.isin(index.view, wanted[kind])
        at = np.flatnonzero(touched & rows.alive.view).tolist()
        found.update(dict.fromkeys(rows.ids[i] for i in at))
    return list(found)
