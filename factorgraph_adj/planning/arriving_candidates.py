"""Candidates that are given to a network that grows: rows by its unknowns, without new ones.

A candidate is that of a design (`factorgraph_adj.planning.candidates`): observations that are made
only together, with the points, photos and other unknowns that they bring. It is linearised at the
present estimates, with readings of its models. What it says of the unknowns that are there is
`factorgraph_adj.planning.candidate_search.told`: new unknowns are eliminated with its own rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError, Problem
from ..graph.equations import compile_network
from ..ledger.excerpts import excerpt
from ..ledger.ledger import Ledger
from ..linear_system.cofactor_columns import UNKNOWN, CofactorColumns
from ..linear_system.linear_system import LinearSystem
from ..linear_system.rebase import notices_motion
from ..solve.linearised_equations import LinearisedEquations
from ..types import Index
from .candidate_search import told
from .candidates import Candidate, CandidateRows, as_candidates, as_planned, owners, partials
from .sight_rows import PossibleSights


def given_candidates(
    ledger: Ledger,
    system: LinearSystem,
    cofactors: CofactorColumns,
    candidates: Sequence[Candidate] | Candidate,
) -> PossibleSights:
    """Return the rows of candidates.

    Args:
        ledger: what has arrived.
        system: the linear system.
        cofactors: its cofactors.
        candidates: the candidates.

    Raises:
        InputError: no candidates, equal names, unknown points and photos, ids that exist already,
            missing approximate values.
    """
    every = as_candidates(candidates)
    problems = [] if every else [Problem("there are none", "candidates")]
    names: set[str] = set()
    for c in every:
        if c.name in names:
            problems.append(Problem("there are two of this name", f"candidate {c.name!r}"))
        if not c.observations:
            problems.append(Problem("it has no observations", f"candidate {c.name!r}"))
        if not (np.isfinite(c.cost) and c.cost > 0):
            what = f"its cost must be greater than zero, not {c.cost}"
            problems.append(Problem(what, f"candidate {c.name!r}"))
        names.add(c.name)
    if problems:
        raise InputError(problems)
    rows = [_rows(ledger, system, cofactors, c) for c in every]
    depth = max(1, *(len(a) for a, _, _ in rows))
    width = max(1, *(a.shape[1] for a, _, _ in rows))
    a = np.zeros((len(every), depth, width))
    columns = np.full((len(every), width), -1, dtype=np.intp)
    for i, (part, own, _) in enumerate(rows):
        a[i, : part.shape[0], : part.shape[1]] = part
        columns[i, : len(own)] = own
    none = np.full(len(every), -1, dtype=np.intp)
    lacks = np.array([lost for _, _, lost in rows], dtype=bool)
    costs = np.array([c.cost for c in every], dtype=float)
    return PossibleSights(a, columns, none, every.__getitem__, lacks, none, costs=costs)


def _rows(
    ledger: Ledger, system: LinearSystem, cofactors: CofactorColumns, candidate: Candidate
) -> tuple[Any, Index, bool]:
    """Return rows (k, m) by columns (m,) of the cofactors, and whether a new unknown stays open."""
    nothing = np.zeros((0, 0)), np.zeros(0, dtype=np.intp)
    there = ledger.with_entities(
        candidate.points, candidate.photos, candidate.cameras, candidate.unknowns
    )
    there, rows = there.taken(candidate.observations)
    planned = as_planned(excerpt(there, system, rows, hold=False))
    equations = compile_network(planned)
    state = equations.unknowns.start()
    equations = equations.weighted_at(state)
    a = partials(LinearisedEquations(equations, state))
    a = a[np.flatnonzero(owners(equations, [candidate]) == 0)]
    unknowns = equations.unknowns
    place = np.full(unknowns.n_columns, UNKNOWN, dtype=np.intp)
    for kind, number in unknowns.active():
        at = unknowns.columns(kind, number)
        place[at] = cofactors.columns(kind, [unknowns[kind].names[number]], len(at))[0]
    columns = np.unique(a.indices).astype(np.intp)
    columns = columns[unknowns.free[columns] & (place[columns] != -1)]
    dense = np.asarray(a[:, columns].todense())
    known = place != UNKNOWN
    new = np.flatnonzero(~known[columns])
    found = told(CandidateRows(dense, columns, new), np.arange(len(place)), known)
    if found is None:
        return *nothing, True
    own = place[found.at]
    motions = cofactors.motions
    if motions.shape[1] and notices_motion(found.b, motions[own]):
        return *nothing, False
    return found.b, own, False
