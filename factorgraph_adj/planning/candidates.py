"""What could be added to a design: observations, stations, photos, each with a cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array, csr_array

from ..additions import add_entities
from ..entities import Camera, Photo, Point
from ..errors import InputError, Problem
from ..graph.equations import Equations, compile_network
from ..incremental.units import identity, named
from ..network import Network
from ..observations import AnyObservation, Correlated
from ..solve.linear import LinearSystem
from ..types import Array, Index
from .readings import as_planned


@dataclass(frozen=True, eq=False)
class Candidate:
    """Observations that are made together or not at all, with what they need.

    A station is a candidate with all its sights, and its point if that is new; a photo one with
    all its image points.
    """

    name: str
    """Its name."""
    observations: tuple[AnyObservation, ...]
    """They; observed values do not matter."""
    cost: float = 1.0
    """In any unit."""
    points: tuple[Point, ...] = ()
    """New points, with their coordinates as planned."""
    photos: tuple[Photo, ...] = ()
    """New photos, with position and rotation as planned."""
    cameras: tuple[Camera, ...] = ()
    """New cameras."""

    @property
    def ids(self) -> list[str]:
        """Ids of its observations."""
        out = []
        for item in self.observations:
            for o in item.observations if isinstance(item, Correlated) else (item,):
                out.append(identity(o) or "")
        return out


def identified(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates whose observations all have ids; otherwise candidate and number."""
    return [
        replace(
            c,
            observations=tuple(
                _identified(item, f"{c.name}/{n}") for n, item in enumerate(c.observations, 1)
            ),
        )
        for c in candidates
    ]


def _identified(item: AnyObservation, ident: str) -> AnyObservation:
    if isinstance(item, Correlated):
        members = tuple(_identified(o, f"{ident}.{n}") for n, o in enumerate(item.observations, 1))
        return Correlated(members, item.covariance)  # type: ignore[arg-type]
    if identity(item) is not None:
        return item
    return named(item, ident)


def with_candidates(network: Network, candidates: Sequence[Candidate]) -> Network:
    """Return the network with candidates in it.

    Raises:
        InputError: everything that is wrong with them: equal names, costs that are none, ids that
            there are already, unknown points and photos; by candidate.
    """
    problems: list[Problem] = []
    names: set[str] = set()
    out = network.copy()
    for c in candidates:
        where = f"candidate {c.name!r}"
        if c.name in names:
            problems.append(Problem("there are two of this name", where))
        names.add(c.name)
        if not (np.isfinite(c.cost) and c.cost > 0):
            problems.append(Problem(f"its cost must be greater than zero, not {c.cost}", where))
        if not c.observations:
            problems.append(Problem("it has no observations", where))
        found = add_entities(out, points=c.points, photos=c.photos, cameras=c.cameras)
        for item in c.observations:
            try:
                out.add(item)
            except InputError as error:
                found += error.problems
        problems += [Problem(p.what, f"{where}, {p.where}") for p in found]
    if problems:
        raise InputError(problems)
    return out


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of a candidate: partials by what it touches, whitened."""

    a: Array
    """Partials, (k, m)."""
    columns: Index
    """Columns of the equations with all candidates, (m,)."""
    new: Index
    """Which of the m belong to unknowns that the design does not have."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """A design and its candidates at the given values."""

    equations: Equations
    """Of the network with all candidates."""
    column: Index
    """Their column of each column of the design, (n_columns of the design,)."""
    rows: tuple[Rows, ...]
    """Of each candidate."""


def linearise(design: Equations, network: Network, candidates: Sequence[Candidate]) -> Linearised:
    """Linearise candidates where they are planned.

    Args:
        design: equations of the design.
        network: the design with all candidates.
        candidates: they.
    """
    equations = compile_network(as_planned(network))
    state = equations.unknowns.start()
    equations = equations.weighted_at(state)
    a = partials(LinearSystem(equations, state))
    column = np.full(design.unknowns.n_columns, -1, dtype=np.intp)
    for kind, table in design.unknowns.tables.items():
        other = equations.unknowns[kind]
        for number, name in enumerate(table.names):
            there = equations.unknowns.columns(kind, other.number[name])
            column[design.unknowns.columns(kind, number)] = there
    old = np.zeros(equations.unknowns.n_columns, dtype=bool)
    old[column] = True
    owner = _owners(equations, candidates)
    out = []
    for n in range(len(candidates)):
        part = a[np.flatnonzero(owner == n)]
        columns = np.unique(part.indices).astype(np.intp)
        columns = columns[equations.unknowns.free[columns]]
        dense = np.asarray(part[:, columns].todense())
        out.append(Rows(dense, columns, np.flatnonzero(~old[columns])))
    return Linearised(equations, column, tuple(out))


def _owners(equations: Equations, candidates: Sequence[Candidate]) -> Index:
    """Return the number of the candidate that brings each row, −1 for the design's, (n_rows,)."""
    owner = np.full(equations.n_rows, -1, dtype=np.intp)
    weighted: dict[tuple[str, str], int] = {}
    for n, c in enumerate(candidates):
        for rows in equations.find(c.ids):
            owner[rows] = n
        weighted |= {("point", p.name): n for p in c.points}
        weighted |= {("pose", f.name): n for f in c.photos}
        weighted |= {("calibration", k.name): n for k in c.cameras}
    if weighted:
        for block in equations.blocks:
            if len(block.variables) > 1:
                continue
            ((kind, index),) = block.variables
            names = equations.unknowns[kind].names
            for i, number in enumerate(index.tolist()):
                n = weighted.get((kind, names[number]), -1)
                first = block.first_row + i * block.dimension
                if n >= 0 and block.ids[i].startswith(f"{kind} "):
                    owner[first : first + block.dimension] = n
    return owner


def partials(system: LinearSystem) -> csr_array:
    """Return the whitened partials of all rows, (n_rows, n_columns)."""
    equations = system.equations
    values: list[Array] = []
    rows: list[Index] = []
    columns: list[Index] = []
    grouped = np.zeros(equations.n_rows, dtype=bool)
    for c in equations.clusters:
        grouped[c.rows] = True
    for lb in system.blocks:
        n, d = lb.block.observed.shape
        own = lb.block.first_row + np.arange(n * d).reshape(n, d)
        for offset, a in zip(lb.offsets, lb.a, strict=True):
            if not len(a):
                continue
            on = ((offset >= 0)[:, None] & ~grouped[own])[:, :, None]
            full = np.broadcast_to(on, a.shape)
            at = np.broadcast_to((offset[:, None] + np.arange(a.shape[2]))[:, None, :], a.shape)
            values.append(a[full])
            rows.append(np.broadcast_to(own[:, :, None], a.shape)[full])
            columns.append(at[full])
    for cluster, (at, a) in zip(equations.clusters, system.cluster_rows(), strict=True):
        values.append(a.ravel())
        rows.append(np.repeat(cluster.rows, len(at)))
        columns.append(np.tile(at, len(cluster.rows)))
    none = [np.zeros(0)]
    places = (np.concatenate(rows or none), np.concatenate(columns or none))
    shape = (equations.n_rows, equations.unknowns.n_columns)
    out = coo_array((np.concatenate(values or none), places), shape=shape).tocsr()
    out.eliminate_zeros()
    return out
