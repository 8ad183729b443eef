"""Predicted observations outside a solution, tests of their fit; intersection of a new point.

For an observation l with covariance Σ, computed from the solution as f(x̂) with partials A,

    d = f(x̂) − l,   D = Σ + A Q Aᵀ        innovation and its cofactors (σ0 = 1)

`innovation_statistics` of `factorgraph_adj.solve.low_rank_update` gives the test values w of the
components of l, T² of all components together, and their redundancy numbers. To first order, w
equals the test value of the observation in an adjustment that includes it: in that adjustment P
Q_vv P of its rows is D⁻¹, and Pv is D⁻¹ d. If other members of its correlated group are in the
solution, an observation is predicted given their residuals, with the conditional covariance.

In a free network Q belongs to the inner constraints. Predicted observations of the geometry are
independent of these constraints, predicted coordinates depend on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ..blas_threads import with_one_thread
from ..errors import MOST_COMPARED, InputError, Problem, similar, taking
from ..graph.equations import Equations, compile_network
from ..network.network import Network
from ..observations import AnyObservation, Correlated, Observation
from ..result_display import Rows, Shown
from ..solve.low_rank_update import covariance_whitener, innovation_statistics
from ..solve.solution import Solution
from ..types import Array, Index, Mask
from .innovations import Innovations

MAX_RIGHT_SIDE_ELEMENTS = 5_000_000
"""Maximum number of elements of the dense right-hand sides that are solved at once."""
MAX_INTERSECTION_STEPS = 20
"""Maximum number of steps of the intersection of a point."""
INTERSECTION_TOLERANCE = 1e-4
"""Step relative to σ below which an intersection has converged."""
MAX_POINTS_INTERSECTED = 500
"""Number of points that are intersected together: their rows and cofactors are in memory at once,
those of 500 points in 300 photos have 30 MB."""


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Shown):
    """Predictions of m observations with k scalar components; all with the a-priori σ0 = 1."""

    equations: Equations
    """Equations that contain the observations."""
    rows: Index
    """Scalar rows of the observations in these equations, ascending (k,)."""
    ids: tuple[str, ...]
    """Ids of the observations (m,)."""
    first: Index
    """Place of the first component of each observation among the k, (m,)."""
    size: Index
    """Number of components of each observation, (m,)."""
    innovation: Array
    """d = computed − observed (k,), SI or image units."""
    sigma: Array
    """Standard deviations of the innovations √D_ii, (k,)."""
    w: Array
    """Test values (k,), with the sign of the residual after inclusion in the adjustment."""
    redundancy_numbers: Array
    """Redundancy number of each component after inclusion in the adjustment, (k,); NaN if other
    members of its correlated group are in the solution, since their redundancy changes too."""
    t2: Array
    """T² (m,), χ² with ``size`` degrees of freedom."""

    def headline(self) -> str:
        """Return how many observations were predicted, and the largest test value."""
        largest = float(np.nanmax(self.largest, initial=0.0))
        return f"Prediction: {len(self.ids)} observations, largest |w| {largest:.2f}"

    def first_rows(self) -> Rows:
        """Return the predicted observations."""
        return Rows(
            ("observation", "|w|", "T²"),
            (
                (i, float(w), float(t))
                for i, w, t in zip(self.ids, self.largest, self.t2, strict=True)
            ),
            len(self.ids),
        )

    @cached_property
    def largest(self) -> Array:
        """Largest |w| of the components of each observation, (m,)."""
        if not len(self.first):
            return np.zeros(0)
        return np.asarray(np.maximum.reduceat(np.abs(self.w), self.first))

    def components(self, number: int) -> slice:
        """Return the places of the components of an observation among the k."""
        start = int(self.first[number])
        return slice(start, start + int(self.size[number]))


@taking(Solution)
@with_one_thread
def predict(
    solution: Solution,
    what: Network | AnyObservation | Sequence[AnyObservation],
    *,
    ids: Sequence[str] | None = None,
) -> Prediction:
    """Predict observations that are not part of a solution.

    Args:
        solution: the solution from which the observations are predicted.
        what: a network that contains the observations; or one observation, or several, between
            points and photos of the solution.
        ids: ids of the observations, weighted unknowns among them; None: all observations that
            are not in the solution.

    Raises:
        InputError: ids unknown in ``what`` or present in the solution, and observations of
            variables that the solution does not determine, all at once; a solution with other
            weights than its network (`adjust` with ``weights``, robust estimation, variance
            components).
    """
    if solution.weights is not None:
        raise InputError(
            "no prediction from a solution with changed weights: state the standard deviations in "
            "the network and adjust it"
        )
    if isinstance(what, Observation | Correlated):
        what = [what]
    if isinstance(what, Network):
        equations = compile_network(what)
        wanted = None if ids is None else _rows_of(equations, ids)
        _refuse_known(solution, () if ids is None else ids)
        rows = _new_rows(equations, solution) if wanted is None else wanted
    else:
        equations = compile_network(_network_of(solution.network, what))
        rows = _stated_rows(equations) if ids is None else _rows_of(equations, ids)
    return Predictor(equations, solution).predict(rows)


def _refuse_known(solution: Solution, ids: Sequence[str]) -> None:
    found = solution.equations.find(list(ids))
    problems = [
        Problem(
            "is in the solution already: it has a residual, no prediction", f"observation {i!r}"
        )
        for i, rows in zip(ids, found, strict=True)
        if len(rows)
    ]
    if problems:
        raise InputError(problems)


@dataclass(frozen=True, eq=False)
class Intersection:
    """The intersection of a new point."""

    coordinates: Array
    """Coordinates of the point (3,), metres."""
    t2: float
    """Residual sum of squares vᵀ D⁻¹ v, χ² with ``dof`` degrees of freedom; infinite if the
    observations do not determine the point."""
    dof: int
    """Number of components − 3."""


class Predictor:
    """Predicts rows of compiled equations from a solution with the same names of unknowns."""

    def __init__(self, equations: Equations, solution: Solution) -> None:
        """Copy the values of the solution to the unknowns of ``equations``."""
        self.equations, self.solution = equations, solution
        self.innovations = Innovations(equations, solution)

    def known(self, rows: Index) -> Mask:
        """Return which rows (k,) can be computed from the solution."""
        return self.innovations.known(rows)

    def predict(self, rows: Index) -> Prediction:
        """Predict scalar rows (ascending, with all components of each observation).

        Raises:
            InputError: names the variables missing in the solution, or the observations that
                cannot be computed.
        """
        linear = self.innovations.linearise(rows)
        v, a, covariance = linear.v, linear.a, linear.covariance
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
        for cluster in self.equations.clusters:
            others = [self.equations.id(int(i)) for i in np.setdiff1d(cluster.rows, rows)]
            if any(len(found) for found in self.solution.equations.find(others)):
                r[np.isin(rows, cluster.rows)] = np.nan
        return Prediction(self.equations, rows, ids, first, size, v, sigma, w, r, t2)

    def intersect(self, point: str, start: Array, rows: Index) -> Intersection:
        """Intersect a new point from observations outside the solution.

        x̂ = argmin vᵀ D⁻¹ v with D = Σ + A Q Aᵀ; the solution itself stays the same.

        Args:
            point: name of the point.
            start: approximate coordinates (3,), metres.
            rows: rows of the observations, ascending.

        Raises:
            InputError: as `predict`.
        """
        return self._intersect({point: (np.array(start, dtype=float), rows)})[point]

    def intersections(
        self, points: Mapping[str, tuple[Array, Index]]
    ) -> dict[str, Intersection | None]:
        """Intersect new points, each from its observations alone, as `intersect`.

        All points share the cofactors Q of the unknowns that their observations have, which the
        solution is solved for once, not for each point and step.

        Args:
            points: approximate coordinates (3,), metres, and rows of the observations by name.

        Returns:
            Intersections by name; None where observations cannot be computed.
        """
        out: dict[str, Intersection | None] = {}
        names = list(points)
        for begin in range(0, len(names), MAX_POINTS_INTERSECTED):
            some = {n: points[n] for n in names[begin : begin + MAX_POINTS_INTERSECTED]}
            try:
                out |= self._intersect(some)
            except InputError:  # of some of them: the others are intersected one by one
                for name in some:
                    try:
                        out |= self._intersect({name: some[name]})
                    except InputError:
                        out[name] = None
        return out

    def _intersect(self, points: Mapping[str, tuple[Array, Index]]) -> dict[str, Intersection]:
        """Intersect points, each from its own rows.

        Raises:
            InputError: observations of one of them cannot be computed.
        """
        n = self.solution.equations.unknowns.n_columns
        at = {name: start for name, (start, _) in points.items()}
        out: dict[str, Intersection] = {}
        cofactors = _Cofactors(self.solution)
        for _ in range(MAX_INTERSECTION_STEPS):
            left = [name for name in points if name not in out]
            if not left:
                break
            rows = np.unique(np.concatenate([points[name][1] for name in left]))
            here = Innovations(self.equations, self.solution, points={p: at[p] for p in left})
            linear = here.linearise(rows)
            cofactors.include(np.asarray(linear.a.indices[linear.a.indices < n], dtype=np.intp))
            for i, name in enumerate(left):
                own = np.searchsorted(rows, points[name][1])
                a = linear.a[own]
                d = linear.covariance[own][:, own].toarray() + cofactors.of_rows(a, n)
                root = covariance_whitener(d)
                v, b = root @ linear.v[own], root @ a[:, n + 3 * i : n + 3 * i + 3].toarray()
                step, _, rank, _ = np.linalg.lstsq(b, -v, rcond=None)
                dof = len(own) - 3
                if rank < 3:
                    out[name] = Intersection(at[name], np.inf, dof)
                    continue
                at[name] = at[name] + step
                if np.linalg.norm(b @ step) < INTERSECTION_TOLERANCE:
                    t2 = float(np.sum((v + b @ step) ** 2))
                    out[name] = Intersection(at[name], t2, dof)
        for name, (_, rows) in points.items():
            out.setdefault(name, Intersection(at[name], np.inf, len(rows) - 3))
        return out

    def _chunks(self, first: Index) -> list[Index]:
        """Split observations so that their right-hand sides take bounded memory."""
        columns = max(1, self.solution.equations.unknowns.n_columns)
        part = first // max(1, MAX_RIGHT_SIDE_ELEMENTS // columns)
        return [np.flatnonzero(part == p) for p in np.unique(part)]


class _Cofactors:
    """Cofactors Q between those unknowns of a solution that some rows have partials by."""

    def __init__(self, solution: Solution) -> None:
        self.solution = solution
        self.columns: Index = np.zeros(0, dtype=np.intp)
        self.q: Array = np.zeros((0, 0))

    def include(self, columns: Index) -> None:
        """Solve for the unknowns of columns, if some of them are new."""
        wanted = np.union1d(self.columns, columns).astype(np.intp)
        if len(wanted) == len(self.columns):
            return
        n = self.solution.equations.unknowns.n_columns
        self.columns, self.q = wanted, np.empty((len(wanted), len(wanted)))
        most = max(1, MAX_RIGHT_SIDE_ELEMENTS // max(1, n))
        for begin in range(0, len(wanted), most):
            some = wanted[begin : begin + most]
            unit = np.zeros((n, len(some)))
            unit[some, np.arange(len(some))] = 1.0
            self.q[:, begin : begin + most] = self.solution.cofactor_times(unit)[wanted]

    def of_rows(self, a: csr_array, n: int) -> Array:
        """Return A Q Aᵀ of rows (k, columns) by their first n columns."""
        used = np.unique(a.indices[a.indices < n])
        known = a[:, used].toarray()
        at = np.searchsorted(self.columns, used)
        return np.asarray(known @ self.q[np.ix_(at, at)] @ known.T)


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
    # All observations are padded to ``most`` components; ones on the diagonal have no effect.
    start = np.cumsum(size) - size
    valid = np.arange(most) < size[:, None]
    place = np.where(valid, start[:, None] + np.arange(most), 0)
    pair = valid[:, :, None] & valid[:, None, :]
    grid = (place[:, :, None], place[:, None, :])
    own = np.where(pair, sigma[grid], np.eye(most))
    full = np.where(pair, d[grid], np.eye(most))
    t2, w, r = innovation_statistics(np.where(valid, v[place], 0.0), full, own)
    return _Figures(np.sqrt(np.diag(d)), w[valid], r[valid], t2)


def _rows_of(equations: Equations, ids: Sequence[str]) -> Index:
    """Return the rows of observations by id, ascending."""
    found = equations.find(list(dict.fromkeys(ids)))
    few = equations.n_rows <= MOST_COMPARED
    there = [i for b in equations.blocks for i in b.ids] if few else []
    problems = [
        Problem(f"unknown observation{similar(ident, there)}", f"observation {ident!r}")
        for ident, rows in zip(dict.fromkeys(ids), found, strict=True)
        if not len(rows)
    ]
    if problems:
        raise InputError(problems)
    return np.sort(np.concatenate([np.zeros(0, dtype=np.intp), *found]))


def _stated_rows(equations: Equations) -> Index:
    """Return the rows of all observations except weighted unknowns."""
    out = [np.zeros(0, dtype=np.intp)]
    for block in equations.blocks:
        if block.image:
            out.append(np.arange(block.rows.start, block.rows.stop))
            continue
        known = np.array([i in equations.network.observations for i in block.ids], dtype=bool)
        rows = np.arange(block.rows.start, block.rows.stop)
        out.append(rows[np.repeat(known, block.dimension)])
    return np.concatenate(out)


def _new_rows(equations: Equations, solution: Solution) -> Index:
    """Return the rows of observations that are not in a solution."""
    rows = _stated_rows(equations)
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
        if block.image:
            (_, photo), _, (_, point), *_ = block.variables
            i, j = own_photo[photo], own_point[point]
            code = np.where((i < 0) | (j < 0), -1, i * len(points) + j)
            inside = np.isin(code, f * len(points) + p)
        else:
            inside = np.array([i in there.observations for i in block.ids], dtype=bool)
        stays[block.rows] = ~np.repeat(inside, block.dimension)
    return rows[stays[rows]]


def _network_of(network: Network, observations: Sequence[AnyObservation]) -> Network:
    """Return the network with ``observations`` in place of its own."""
    out = network.copy()
    out.observations, out.clusters = {}, []
    out.image_mask(np.zeros(network.n_image_points, dtype=bool))
    out.add(*observations)
    return out
