"""What a solution predicts for observations that are not in it, and how well they fit.

For an observation l with covariance Σ, computed from the solution as f(x̂) with partials A,

    d = f(x̂) − l,   D = Σ + A Q Aᵀ        innovation and its cofactors (σ0 = 1)
    w_i = (D⁻¹d)_i / √(D⁻¹)_ii             test value of a component
    T² = dᵀ D⁻¹ d                          of all its components, χ² with as many degrees

w is, to first order, what the observation would have as test value were it put into the
adjustment: there (P Q_vv P) of its rows is D⁻¹ and Pv is D⁻¹ d. Its redundancy numbers are
then the diagonal of Σ D⁻¹. Observations of a correlated group of which others are in the
solution are predicted given their residuals, with the conditional covariance.

In a free network Q is that of the inner constraints: observations of the geometry do not notice,
coordinates do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array

from ..errors import InputError, Problem
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_network
from ..graph.variables import State
from ..graph.weights import weigh
from ..models.registry import VariableKind
from ..network import Network
from ..observations import AnyObservation
from ..types import Array, Index, Mask
from .solution import Solution

CHUNK = 5_000_000
"""Numbers in the dense right sides of one solution for many observations."""
NOUNS: dict[VariableKind, str] = {
    "pose": "photo",
    "calibration": "calibration of camera",
    "orientation": "orientation of set",
    "refraction": "refraction group",
    "vertical": "vertical of station",
    "edm": "distance meter",
}


@dataclass(frozen=True, eq=False)
class Prediction:
    """m observations with k scalar components, predicted; a-priori σ0 = 1 throughout."""

    equations: Equations
    """Equations that contain them."""
    rows: Index
    """Their scalar rows there, ascending (k,)."""
    ids: tuple[str, ...]
    """Ids of the observations (m,)."""
    first: Index
    """Place of the first component of each observation among the k, (m,)."""
    size: Index
    """Number of its components, (m,)."""
    innovation: Array
    """d = computed − observed (k,), SI or image units."""
    sigma: Array
    """Standard deviations of the innovations √D_ii, (k,)."""
    w: Array
    """Test values (k,) with the sign of what the residual would be."""
    redundancy_numbers: Array
    """What each component's redundancy number would be, (k,)."""
    t2: Array
    """T² (m,), χ² with ``size`` degrees of freedom."""

    @cached_property
    def largest(self) -> Array:
        """Largest |w| of the components of each observation, (m,)."""
        if not len(self.first):
            return np.zeros(0)
        return np.asarray(np.maximum.reduceat(np.abs(self.w), self.first))

    def components(self, number: int) -> slice:
        """Return where the components of an observation are among the k."""
        start = int(self.first[number])
        return slice(start, start + int(self.size[number]))


def predict(
    solution: Solution,
    what: Network | Sequence[AnyObservation],
    *,
    ids: Sequence[str] | None = None,
) -> Prediction:
    """Predict observations from a solution that they had no part in.

    Args:
        solution: what predicts.
        what: a network that contains the observations, or observations between points and
            photos of the solution.
        ids: which of the network's observations, weighted unknowns among them; none: all
            observations that the solution does not have.

    Raises:
        InputError: an id that ``what`` does not have, or an observation of something that the
            solution does not determine; all at once.
    """
    if isinstance(what, Network):
        equations = compile_network(what)
        wanted = None if ids is None else _rows_of(equations, ids)
        rows = _absent(equations, solution) if wanted is None else wanted
    else:
        equations = compile_network(_only(solution.network, what))
        rows = _given(equations) if ids is None else _rows_of(equations, ids)
    return Predictor(equations, solution).predict(rows)


class Predictor:
    """Predicts rows of compiled equations from a solution whose unknowns bear the same names."""

    def __init__(self, equations: Equations, solution: Solution) -> None:
        """Carry the solution over to the unknowns of ``equations``."""
        self.equations, self.solution = equations, solution
        unknowns, source = equations.unknowns, solution.equations.unknowns
        start = unknowns.start()
        for kind, table in unknowns.tables.items():
            start[kind][table.offset >= 0] = np.nan
        everything = {kind: np.ones(values.shape, dtype=bool) for kind, values in start.items()}
        self.state: State = unknowns.carried(start, source, solution.state, where=everything)
        self.lost: dict[VariableKind, Mask] = {
            kind: np.any(np.isnan(values), axis=1) for kind, values in self.state.items()
        }
        self.offset: dict[VariableKind, Index] = {}
        """Columns of the solution, by number of the variable here; −1 where it is no unknown."""
        for kind, table in unknowns.tables.items():
            other = source[kind]
            if table.names == other.names:
                self.offset[kind] = other.offset
                continue
            number = np.array([other.number.get(n, -1) for n in table.names], dtype=np.intp)
            places = np.append(other.offset, -1)
            self.offset[kind] = np.asarray(places[number], dtype=np.intp)

    def known(self, rows: Index) -> Mask:
        """Return which rows (k,) can be computed from what the solution knows."""
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

    def predict(self, rows: Index) -> Prediction:
        """Predict scalar rows, all components of each observation among them, ascending.

        Raises:
            InputError: names what the solution does not know, or cannot be computed.
        """
        self._refuse_unknown(rows)
        context = self._context(rows)
        every = np.union1d(rows, context)
        v, a, covariance = self._linearise(every)
        given = _given_the_others(self.equations, every, rows, covariance)
        v, a, covariance = given @ v, csr_array(given @ a), csr_array(given @ covariance @ given.T)
        number = self.equations.observation_of_row[rows]
        first = np.flatnonzero(np.diff(number, prepend=-1))
        size = np.diff(np.append(first, len(rows)))
        figures = [_Figures.none()]
        for units in self._chunks(first):
            at = np.arange(first[units[0]], first[units[-1]] + size[units[-1]])
            y = a[at].toarray().T
            own = covariance[at][:, at].toarray()
            full = own + y.T @ self.solution.cofactor_times(y)
            figures.append(_figures(v[at], own, full, size[units]))
        sigma, w, r, t2 = (np.concatenate(x) for x in zip(*figures, strict=True))
        ids = tuple(self.equations.id(int(row)) for row in rows[first])
        return Prediction(self.equations, rows, ids, first, size, v, sigma, w, r, t2)

    def _parts(self, rows: Index) -> Iterator[tuple[Block, Index, int]]:
        """Iterate over blocks of some observations, their places in ``rows``, and the block's."""
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
                        f"{NOUNS.get(kind, kind)} {names[index[i]]!r} is not in the solution",
                        part.labels(int(i)),
                    )
                    for i in np.flatnonzero(lost)
                ]
        if problems:
            raise InputError(list(dict.fromkeys(problems)))

    def _context(self, rows: Index) -> Index:
        """Return the rows of correlated groups that are in the solution beside ``rows``."""
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
        """Return innovations (k,), partials (k, n_columns of the solution) and Σ (k, k)."""
        equations = self.equations
        free = self.solution.equations.unknowns.free
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
                a.add(own[on], columns, np.where(free[columns][:, None, :], partials[on], 0.0))
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
        return v, a.matrix(len(rows), len(free)), sigma.matrix(len(rows), len(rows))

    def _chunks(self, first: Index) -> list[Index]:
        """Split observations so that their right sides take a bounded space."""
        columns = max(1, self.solution.equations.unknowns.n_columns)
        part = first // max(1, CHUNK // columns)
        return [np.flatnonzero(part == p) for p in np.unique(part)]


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


def _given_the_others(
    equations: Equations, every: Index, rows: Index, covariance: csr_array
) -> csr_array:
    """Return T (k, k + context): l₂ − Σ₂₁ Σ₁₁⁻¹ l₁, without correlation to the l₁ of the context.

    T has ones for the rows themselves, −Σ₂₁ Σ₁₁⁻¹ for correlated ones that are in the solution.
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


class _Figures(NamedTuple):
    """Figures of some observations, see `Prediction`."""

    sigma: Array
    w: Array
    redundancy_numbers: Array
    t2: Array

    @classmethod
    def none(cls) -> _Figures:
        return cls(*(np.zeros(0) for _ in range(4)))


def _figures(v: Array, sigma: Array, d: Array, size: Index) -> _Figures:
    """Return the figures of m observations that follow one another.

    Args:
        v: innovations (c,).
        sigma: Σ of all components (c, c).
        d: D of all components (c, c).
        size: number of components of each observation (m,).
    """
    most = int(size.max())
    # Padded to the most components with ones on the diagonal, which test nothing.
    start = np.cumsum(size) - size
    valid = np.arange(most) < size[:, None]
    place = np.where(valid, start[:, None] + np.arange(most), 0)
    pair = valid[:, :, None] & valid[:, None, :]
    grid = (place[:, :, None], place[:, None, :])
    own = np.where(pair, sigma[grid], np.eye(most))
    inverse = np.linalg.inv(np.where(pair, d[grid], np.eye(most)))
    each = np.where(valid, v[place], 0.0)
    pv = np.einsum("nij,nj->ni", inverse, each)
    w = pv / np.sqrt(np.einsum("nii->ni", inverse))
    r = np.einsum("nij,nji->ni", own, inverse)
    return _Figures(np.sqrt(np.diag(d)), w[valid], r[valid], np.sum(each * pv, axis=1))


def _rows_of(equations: Equations, ids: Sequence[str]) -> Index:
    """Return the rows of observations by id, ascending."""
    found = equations.find(list(dict.fromkeys(ids)))
    problems = [
        Problem("unknown observation", f"observation {ident!r}")
        for ident, rows in zip(dict.fromkeys(ids), found, strict=True)
        if not len(rows)
    ]
    if problems:
        raise InputError(problems)
    return np.sort(np.concatenate([np.zeros(0, dtype=np.intp), *found]))


def _given(equations: Equations) -> Index:
    """Return the rows of all observations but weighted unknowns."""
    out = [np.zeros(0, dtype=np.intp)]
    for block in equations.blocks:
        if block.kind == "image":
            out.append(np.arange(block.rows.start, block.rows.stop))
            continue
        known = np.array([i in equations.network.observations for i in block.ids], dtype=bool)
        rows = np.arange(block.rows.start, block.rows.stop)
        out.append(rows[np.repeat(known, block.dimension)])
    return np.concatenate(out)


def _absent(equations: Equations, solution: Solution) -> Index:
    """Return the rows of observations that a solution does not have."""
    rows = _given(equations)
    stays = np.ones(equations.n_rows, dtype=bool)
    there = solution.network
    photos, points = list(there.photos), list(there.points)
    f, p, *_ = there.images.columns()
    photo_number = {n: i for i, n in enumerate(photos)}
    point_number = {n: i for i, n in enumerate(points)}
    mine = equations.network
    own_photo = np.array([photo_number.get(n, -1) for n in mine.photos], dtype=np.intp)
    own_point = np.array([point_number.get(n, -1) for n in mine.points], dtype=np.intp)
    for block in equations.blocks:
        if block.kind == "image":
            (_, photo), _, (_, point) = block.variables
            i, j = own_photo[photo], own_point[point]
            code = np.where((i < 0) | (j < 0), -1, i * len(points) + j)
            inside = np.isin(code, f * len(points) + p)
        else:
            inside = np.array([i in there.observations for i in block.ids], dtype=bool)
        stays[block.rows] = ~np.repeat(inside, block.dimension)
    return rows[stays[rows]]


def _only(network: Network, observations: Sequence[AnyObservation]) -> Network:
    """Return the network with other observations than its own."""
    out = network.copy()
    out.observations, out.clusters = {}, []
    out.image_mask(np.zeros(network.n_image_points, dtype=bool))
    out.add(*observations)
    return out
