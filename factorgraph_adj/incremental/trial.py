"""Arriving rows as one dense system, to be judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from ..graph.keys import KeyMap
from ..models.variables import VariableKind
from ..types import Array, Index
from .rows import Piece, Store
from .units import Unit
from .verdicts import Judged, pseudo_inverse

Marks: TypeAlias = tuple[dict[VariableKind, int], tuple[dict[int, int], int]]
"""How many variables and rows there were."""

MOST_ROWS = 2500
"""Scalar rows that are judged together: their matrices are dense."""


@dataclass
class Gathered:
    """Some rows, and the variables that they touch."""

    keys: list[int]
    """Keys of the variables."""
    column: dict[int, Index]
    """Columns of each key."""
    places: Index
    """Place of each column."""
    a: Array
    """Whitened partials (rows, columns)."""
    v: Array
    """Whitened residuals at the present state, (rows,)."""
    raw: Array
    """L with Σ = L Lᵀ: what whitening is undone with, (rows, rows)."""
    rows: dict[str, Index]
    """Rows of each id."""


@dataclass
class LowRank:
    """What a trial would change, if it has not been put into the tree."""

    y: Array
    """Q Aᵀ of the state before, over all places, (n_places, rows)."""
    d: Array
    """I + A Q Aᵀ, (rows, rows)."""
    innovation: Array
    """Whitened residuals of the state before, (rows,)."""


@dataclass
class Placed:
    """Units that may still be taken back."""

    units: tuple[Unit, ...]
    """The units."""
    piece: Piece
    """Their rows in the store."""
    marks: Marks
    """What there was before."""
    entered: list[tuple[VariableKind, int]]
    """Variables that entered with them."""
    low_rank: LowRank | None = field(default=None, kw_only=True)
    """What they would change; none where they are in the tree."""


@dataclass
class Trial(Placed):
    """The same with what they are judged by."""

    rows: dict[str, Index]
    """Scalar rows of each unit, by its first id."""
    system: Gathered
    """The rows."""
    spread: Array
    """Q Aᵀ of the state with them, for the columns of the system, (columns, rows)."""
    variances: Array
    """Variances of the columns with them, (columns,)."""
    judged: Judged
    """M and v of the state with them."""

    def take_out(self, u: Index) -> None:
        """Leave rows out: Q ← Q + S_u M_uu⁻¹ S_uᵀ, S ← S − S_u M_uu⁻¹ M_u, with S = Q Aᵀ."""
        m = self.judged.m
        own = self.spread[:, u]
        gain = own @ pseudo_inverse(m[np.ix_(u, u)])[0]
        self.variances = self.variances + np.einsum("ij,ij->i", gain, own)
        self.spread = self.spread - gain @ m[u]
        self.judged.take_out(u)


def parts(units: Sequence[Unit]) -> list[list[Unit]]:
    """Split units into parts that can be judged together."""
    out: list[list[Unit]] = []
    room = 0
    for unit in units:
        room -= unit.n_scalars
        if room < 0:
            out.append([])
            room = MOST_ROWS - unit.n_scalars
        out[-1].append(unit)
    return out


def rows_of(units: Sequence[Unit], system: Gathered) -> dict[str, Index]:
    """Return the scalar rows of each unit, by its first id."""
    return {u.ids[0]: np.concatenate([system.rows[i] for i in u.ids]) for u in units}


def gather(store: Store, piece: Piece) -> Gathered:
    """Return rows as a dense system."""
    register = store.register
    keys = _keys_of(store, piece)
    column: dict[int, Index] = {}
    place_to_column = np.full(register.n_places + 1, -1)
    n = 0
    for key in keys:
        places = register.places(key)
        column[key] = np.arange(n, n + len(places))
        place_to_column[places] = column[key]
        n += len(places)
    nothing = np.zeros(0, dtype=np.intp)
    where = np.concatenate([register.places(k) for k in keys] or [nothing])
    a, v, raw, rows = _dense(store, piece, place_to_column, n)
    return Gathered(keys, column, where, a, v, raw, rows)


def _keys_of(store: Store, piece: Piece) -> list[int]:
    found: dict[int, None] = {}
    for rows, at in piece.rows:
        for kind, index in zip(rows.kinds, rows.index, strict=True):
            numbers = np.unique(index.view[at])
            inside = (store.register[kind].place.view[numbers] >= 0).any(axis=1)
            found.update(dict.fromkeys(KeyMap.of(kind, i) for i in numbers[inside].tolist()))
    return list(found)


def _dense(
    store: Store, piece: Piece, place_to_column: Index, n: int
) -> tuple[Array, Array, Array, dict[str, Index]]:
    """Return whitened A (rows, n) and v, L of whitening, and the rows of each id."""
    total = sum(len(at) * rows.template.dimension for rows, at in piece.rows)
    a, v, raw = np.zeros((total, n)), np.zeros(total), np.zeros((total, total))
    of: dict[str, list[int]] = {}
    where: dict[tuple[int, int], Index] = {}
    first = 0
    for rows, at in piece.rows:
        d = rows.template.dimension
        at_row = first + np.arange(len(at) * d).reshape(len(at), d)
        first += len(at) * d
        v[at_row] = store.linear(rows, at)
        for kind, index, partials in zip(rows.kinds, rows.index, rows.a, strict=True):
            values = partials.view[at]
            k = values.shape[2]
            columns = place_to_column[store.register[kind].place.view[index.view[at], :k]]
            on = columns >= 0
            for j in range(k):
                i = np.flatnonzero(on[:, j])
                if len(i):
                    for c in range(d):
                        np.add.at(a, (at_row[i, c], columns[i, j]), values[i, c, j])
        if rows.whitener is None:
            raw[at_row, at_row] = rows.sigma.view[at]
        else:
            inverse = np.linalg.inv(rows.whitener.view[at])
            raw[at_row[:, :, None], at_row[:, None, :]] = inverse
        for i, r in zip(at.tolist(), at_row, strict=True):
            of.setdefault(rows.ids[i], []).extend(r.tolist())
            where[id(rows), i] = r
    for number in piece.groups:
        group = store.groups[number]
        r = np.zeros(len(group.whitener), dtype=np.intp)
        for (rows, at), order in zip(group.members, group.order, strict=True):
            r[order] = np.array([where[id(rows), i] for i in at.tolist()])
        a[r], v[r] = group.whitener @ a[r], group.whitener @ v[r]
        raw[np.ix_(r, r)] = np.linalg.inv(group.whitener)
    return a, v, raw, {k: np.array(i, dtype=np.intp) for k, i in of.items()}
