"""Innovations: residuals and partials, at a solution, of observations outside of it.

The values of the solution are copied to the equations of the observations by the names of the
unknowns; partial derivatives refer to the unknowns of the solution. If a part l₁ of a correlated
group is in the solution, the rest l₂ is made independent of it: l₂ − Σ₂₁ Σ₁₁⁻¹ l₁.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from ..errors import InputError, Problem
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..graph.weights import weigh
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..solve.low_rank_update import covariance_whitener
from ..solve.solution import Solution
from ..types import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class LinearInnovations:
    """k scalar rows: v + A dx with covariance Σ."""

    v: Array
    """Innovations, computed − observed, (k,)."""
    a: csr_array
    """Partials by the n_columns unknowns of the solution, then by x, y, z of each new point."""
    covariance: csr_array
    """Σ, (k, k)."""

    def whitened(self, solution: Solution) -> tuple[Array, Array]:
        """Return W v (k,) and W A (k, columns) with W D Wᵀ = I, D = Σ + A Q Aᵀ of a solution."""
        a = self.a.toarray()
        known = a[:, : solution.equations.unknowns.n_columns]
        root = covariance_whitener(
            self.covariance.toarray() + known @ solution.cofactor_times(known.T)
        )
        return root @ self.v, root @ a


class Innovations:
    """Rows of compiled equations, computed from a solution with the same names of unknowns."""

    def __init__(
        self, equations: Equations, solution: Solution, *, points: Mapping[str, Array] | None = None
    ) -> None:
        """Copy the values of the solution to the unknowns of ``equations``.

        Args:
            equations: the equations that contain the rows.
            solution: the solution from which the rows are computed.
            points: coordinates (3,) of new points, which become additional unknowns.
        """
        self.equations, self.solution = equations, solution
        unknowns, source = equations.unknowns, solution.equations.unknowns
        start = unknowns.start()
        for kind, table in unknowns.tables.items():
            start[kind][table.offset >= 0] = np.nan
        self.state: State = unknowns.carried(start, source, solution.state)
        new = {unknowns["point"].number[name]: x for name, x in (points or {}).items()}
        for place, x in new.items():
            self.state["point"][place] = x
        self.lost: dict[VariableKind, Mask] = {
            kind: np.any(np.isnan(values), axis=1) for kind, values in self.state.items()
        }
        self.offset: dict[VariableKind, Index] = {}
        """First column of each variable in the solution, by its number here; −1 if not free."""
        for kind, table in unknowns.tables.items():
            other = source[kind]
            if table.names == other.names:
                self.offset[kind] = other.offset
                continue
            number = np.array([other.number.get(n, -1) for n in table.names], dtype=np.intp)
            places = np.append(other.offset, -1)
            self.offset[kind] = np.asarray(places[number], dtype=np.intp)
        for i, place in enumerate(new):
            # With the same names the array is the solution's own, so it is copied.
            self.offset["point"] = self.offset["point"].copy()
            self.offset["point"][place] = len(solution.equations.unknowns.free) + 3 * i
        self.free = np.append(solution.equations.unknowns.free, np.ones(3 * len(new), dtype=bool))

    def known(self, rows: Index) -> Mask:
        """Return which rows (k,) can be computed from the solution."""
        out = np.ones(len(rows), dtype=bool)
        frame = self.equations.network.frame
        for part, at, _ in self._parts(rows):
            fine = np.ones(part.n, dtype=bool)
            for kind, index in part.variables:
                fine &= ~self.lost[kind][index]
            try:
                part.select(np.flatnonzero(fine)).evaluate(frame, self.state, jacobians=False)
            except InputError:
                for i in np.flatnonzero(fine).tolist():
                    try:
                        part.select(np.array([i])).evaluate(frame, self.state, jacobians=False)
                    except InputError:
                        fine[i] = False
            out[at] = np.repeat(fine, part.dimension)
        return out

    def residuals(self) -> Array:
        """Return whitened residuals (n,); NaN where a variable is not known to the solution."""
        state = dict(self.state)
        for kind, lost in self.lost.items():
            if lost.any() and not lost.all():
                state[kind] = state[kind].copy()
                state[kind][lost] = state[kind][np.flatnonzero(~lost)[0]]
        out = self.equations.residuals(state)
        for block in self.equations.blocks:
            unknown = np.zeros(block.n, dtype=bool)
            for kind, index in block.variables:
                unknown |= self.lost[kind][index]
            out[block.rows][np.repeat(unknown, block.dimension)] = np.nan
        return out

    def _parts(self, rows: Index) -> Iterator[tuple[Block, Index, int]]:
        """Yield the blocks of ``rows``, with their places in ``rows`` and the block's number."""
        for place, block in enumerate(self.equations.blocks):
            at = np.flatnonzero((rows >= block.rows.start) & (rows < block.rows.stop))
            if len(at):
                chosen = (rows[at[:: block.dimension]] - block.first_row) // block.dimension
                yield block.select(chosen), at, place

    def _refuse_unknown(self, rows: Index) -> None:
        problems = []
        for part, _, _ in self._parts(rows):
            for kind, index in part.variables:
                lost = self.lost[kind][index]
                names = self.equations.unknowns[kind].names
                problems += [
                    Problem(
                        f"{UNKNOWNS[kind].noun} {names[index[i]]!r} is not in the solution",
                        part.labels(int(i)),
                    )
                    for i in np.flatnonzero(lost)
                ]
        if problems:
            raise InputError(list(dict.fromkeys(problems)))

    def linearise(self, rows: Index) -> LinearInnovations:
        """Linearise rows (ascending, with all components of each observation).

        Raises:
            InputError: names the variables missing in the solution, or the observations that
                cannot be computed.
        """
        self._refuse_unknown(rows)
        every = np.union1d(rows, self._context(rows))
        v, a, covariance = self._linearise(every)
        given = _conditional_transformation(self.equations, every, rows, covariance)
        return LinearInnovations(
            given @ v, csr_array(given @ a), csr_array(given @ covariance @ given.T)
        )

    def _context(self, rows: Index) -> Index:
        """Return the rows in the solution that are correlated with ``rows``."""
        found = [np.zeros(0, dtype=np.intp)]
        for cluster in self.equations.clusters:
            inside = np.isin(cluster.rows, rows)
            if inside.any() and not inside.all():
                others = cluster.rows[~inside]
                ids = [self.equations.id(int(r)) for r in others]
                there = [len(r) > 0 for r in self.solution.equations.find(ids)]
                found.append(others[np.array(there)])
        return np.concatenate(found)

    def _linearise(self, rows: Index) -> tuple[Array, csr_array, csr_array]:
        """Return innovations (k,), partials (k, columns) and Σ (k, k)."""
        equations = self.equations
        v = np.empty(len(rows))
        a = _Entries()
        sigma = _Entries()
        for part, at, place in self._parts(rows):
            block = weigh(equations.network, part, self.state)
            residual, jacobians = block.evaluate(equations.network.frame, self.state)
            v[at] = residual.ravel()
            own = at.reshape(residual.shape)
            for (kind, index), partials in zip(block.variables, jacobians, strict=True):
                offset = self.offset[kind][index]
                on = offset >= 0
                columns = offset[on, None] + np.arange(partials.shape[2])
                a.add(own[on], columns, np.where(self.free[columns][:, None, :], partials[on], 0.0))
            root: Array = np.einsum("ni,ij->nij", block.sigma, np.eye(block.dimension))
            if block.whitener is not None:
                root = np.asarray(np.linalg.inv(block.whitener), dtype=float)
            clustered = equations.in_cluster.get(place)
            if clustered is not None:
                chosen = (rows[at[:: block.dimension]] - block.first_row) // block.dimension
                root[np.isin(chosen, clustered)] = 0.0
            sigma.add(own, own, root @ root.transpose(0, 2, 1))
        for cluster in equations.clusters:
            inside = np.isin(cluster.rows, rows)
            if inside.any():
                joint = np.linalg.inv(cluster.whitener)[inside]
                at = np.searchsorted(rows, cluster.rows[inside])[None]
                sigma.add(at, at, (joint @ joint.T)[None])
        return v, a.matrix(len(rows), len(self.free)), sigma.matrix(len(rows), len(rows))


class _Entries:
    """Entries of a sparse matrix, collected block by block."""

    def __init__(self) -> None:
        self.parts: list[tuple[Array, Index, Index]] = []

    def add(self, rows: Index, columns: Index, values: Array) -> None:
        """Add values (n, d, k) at rows (n, d) and columns (n, k)."""
        shape = values.shape
        self.parts.append(
            (
                values.ravel(),
                np.broadcast_to(rows[:, :, None], shape).ravel(),
                np.broadcast_to(columns[:, None, :], shape).ravel(),
            )
        )

    def matrix(self, rows: int, columns: int) -> csr_array:
        """Return the sum of all entries as a matrix."""
        if not self.parts:
            return csr_array((rows, columns))
        values, i, j = (np.concatenate(x) for x in zip(*self.parts, strict=True))
        return csr_array(coo_array((values, (i, j)), shape=(rows, columns)))


def _conditional_transformation(
    equations: Equations, every: Index, rows: Index, covariance: csr_array
) -> csr_array:
    """Return T (k, k + context): T l = l₂ − Σ₂₁ Σ₁₁⁻¹ l₁ is uncorrelated with l₁, the context.

    T has ones for the rows themselves and −Σ₂₁ Σ₁₁⁻¹ for the correlated rows in the solution.
    """
    entries = _Entries()
    own = np.searchsorted(every, rows)[:, None]
    entries.add(np.arange(len(rows))[:, None], own, np.ones((len(rows), 1, 1)))
    for cluster in equations.clusters:
        inside = cluster.rows[np.isin(cluster.rows, rows)]
        others = cluster.rows[np.isin(cluster.rows, every) & ~np.isin(cluster.rows, rows)]
        if not len(inside) or not len(others):
            continue
        two, one = np.searchsorted(every, inside), np.searchsorted(every, others)
        s11 = covariance[one][:, one].toarray()
        s12 = covariance[one][:, two].toarray()
        gain = np.linalg.solve(s11, s12).T
        entries.add(np.searchsorted(rows, inside)[None], one[None], -gain[None])
    return entries.matrix(len(rows), len(every))
