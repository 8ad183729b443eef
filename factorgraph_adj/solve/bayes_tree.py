"""Elimination by GTSAM of the unknowns outside the first layer, and its selected inverse.

GTSAM eliminates multifrontally in its ordering, by QR or Cholesky; each clique of the Bayes tree
gives R and S of  R x_F = d − S x_S.  R and S are copied once (GTSAM's views do not own their
memory) and serve every right side and the selected inverse (Takahashi), with T = R⁻¹S:

    Σ_FS = −T Σ_SS,   Σ_FF = R⁻¹R⁻ᵀ − Σ_FS Tᵀ       (top down),

where Σ_SS is a part of the parent's joint covariance. All variables of an observation lie in the
clique that eliminates the first of them, so that the covariances of many observations are looked up
at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from ..errors import SingularError
from ..graph.variables import Unknowns
from ..models.unknown_registry import UNKNOWNS
from ..types import Array, Index
from .elimination_layers import Layers, rows_outside_first_layer
from .fronts import BlockMatrix, upper_solve, upper_transposed_solve
from .linearised_equations import LinearBlock, LinearisedEquations
from .linearised_rays import LinearRays
from .reduced_system import EliminationRemainder

UNIT_NOISE = {d: gtsam.noiseModel.Unit.Create(d) for d in range(1, 7)}
MAX_JACOBIAN_KEYS = 3
"""Largest number of keys that the JacobianFactor constructor takes in Python."""
MAX_COLAMD_VARIABLES = 300
"""Largest number of variables for which the fill of COLAMD is as good as that of nested
dissection."""


@dataclass(frozen=True)
class Clique:
    """One clique of the Bayes tree."""

    frontal: Index
    """Columns that the clique eliminates."""
    separator: Index
    """Columns on which the eliminated columns depend."""
    r: Array
    """Upper triangular R, (f, f)."""
    t: Array
    """T = R⁻¹ S, (f, s)."""
    parent: int
    """Number of the clique that contains the separator; −1: only the border contains it."""


def forward_substitution(cliques: Sequence[Clique], y: Array) -> list[Array]:
    """Return R⁻ᵀ y of each clique, (f, k), for y (n_columns, k), from the leaves to the roots.

    The parts of y that belong to separators are changed in place.
    """
    halves = []
    for c in reversed(cliques):
        halves.append(upper_transposed_solve(c.r, y[c.frontal]))
        if len(c.separator):
            # Sᵀ R⁻ᵀ y = Tᵀ y
            y[c.separator] -= c.t.T @ y[c.frontal]
    return halves[::-1]


def back_substitution(cliques: Sequence[Clique], halves: Sequence[Array], x: Array) -> None:
    """Fill x (n_columns, k) with R⁻¹ (R⁻ᵀ y − S x_S), from the roots to the leaves."""
    for c, half in zip(cliques, halves, strict=True):
        x[c.frontal] = upper_solve(c.r, half)
        if len(c.separator):
            x[c.frontal] -= c.t @ x[c.separator]


class TreeFactors:
    """The factors that GTSAM eliminates; each linearisation makes them once."""

    def __init__(self, layers: Layers, system: LinearisedEquations) -> None:
        """Turn the rows outside the first layer into GTSAM's Jacobian factors."""
        self.layers = layers
        self.system = system
        # A GTSAM key is the first column of its variable: keys sort, and give the place of a block.
        self.graph = gtsam.GaussianFactorGraph()
        if layers.in_fronts:
            return
        graph = self.graph
        for place, lb in enumerate(system.blocks):
            rows = rows_outside_first_layer(system.equations, layers, place)
            if len(rows):
                self._add_block(graph, lb, rows)
        for columns, a in system.cluster_rows():
            self._add_dense(graph, columns, a)
        for e in system.extra:
            self._add_dense(graph, e.columns, e.a)

    def _add_block(
        self,
        graph: gtsam.GaussianFactorGraph,
        lb: LinearBlock | LinearRays,
        rows: Index,
    ) -> None:
        """Add one factor for each row, over those of its variables that are unknown."""
        arrays, d = lb.partials(rows), lb.block.dimension
        offsets = [offset[rows] for offset in lb.offsets]
        slots = [j for j, a in enumerate(arrays) if len(a)]
        pattern = np.zeros(len(rows), dtype=np.int64)
        for bit, j in enumerate(slots):
            pattern |= (offsets[j] >= 0).astype(np.int64) << bit
        zero, unit = np.zeros(d), UNIT_NOISE[d]
        for code in np.unique(pattern):
            chosen = [j for bit, j in enumerate(slots) if code >> bit & 1]
            at = np.flatnonzero(pattern == code)
            keys = [offsets[j][at].tolist() for j in chosen]
            a = [
                list(np.asfortranarray(arrays[j][at].transpose(1, 2, 0)).transpose(2, 0, 1))
                for j in chosen
            ]
            if len(chosen) == 1:
                for k1, a1 in zip(keys[0], a[0], strict=True):
                    graph.add(gtsam.JacobianFactor(k1, a1, zero, unit))
            elif len(chosen) == 2:
                for k1, a1, k2, a2 in zip(keys[0], a[0], keys[1], a[1], strict=True):
                    graph.add(gtsam.JacobianFactor(k1, a1, k2, a2, zero, unit))
            elif len(chosen) == MAX_JACOBIAN_KEYS:
                for k1, a1, k2, a2, k3, a3 in zip(
                    keys[0], a[0], keys[1], a[1], keys[2], a[2], strict=True
                ):
                    graph.add(gtsam.JacobianFactor(k1, a1, k2, a2, k3, a3, zero, unit))
            elif chosen:
                for i in range(len(at)):
                    terms = [(k[i], m[i]) for k, m in zip(keys, a, strict=True)]
                    graph.add(gtsam.GaussianConditional(terms, 1, zero, unit))

    def _add_dense(self, graph: gtsam.GaussianFactorGraph, columns: Index, a: Array) -> None:
        """Add rows over any number of variables; missing columns of a variable are zero."""
        place = {int(c): i for i, c in enumerate(columns)}
        size = self.layers.unknowns.size_at
        starts = np.array(sorted(size), dtype=np.intp)
        keys = np.unique(starts[np.searchsorted(starts, columns, side="right") - 1])
        terms = []
        for key in keys.tolist():
            block = np.zeros((len(a), size[key]))
            for j in range(size[key]):
                if key + j in place:
                    block[:, j] = a[:, place[key + j]]
            terms.append((key, block))
        if not terms:
            return
        unit = gtsam.noiseModel.Unit.Create(len(a))
        zero = np.zeros(len(a))
        if len(terms) <= MAX_JACOBIAN_KEYS:
            flat = [x for term in terms for x in term]
            make: Callable[..., gtsam.JacobianFactor] = gtsam.JacobianFactor
            graph.add(make(*flat, zero, unit))
        else:
            graph.add(gtsam.GaussianConditional(terms, 1, zero, unit))

    def eliminate(
        self, extra: Array, *, qr: bool
    ) -> tuple[list[Clique], list[EliminationRemainder]]:
        """Eliminate the tree's variables.

        Args:
            extra: added to the diagonal of the normal matrix, (n_columns,).
            qr: whether QR is used instead of Cholesky.

        Returns:
            The cliques, parents first, and what the elimination leaves to the cameras.

        Raises:
            SingularError: a pivot vanished.
        """
        layers = self.layers
        graph = gtsam.GaussianFactorGraph()
        graph.push_back(self.graph)
        root = np.sqrt(extra)
        first = []
        for kind, number in layers.tree:
            columns = layers.unknowns.columns(kind, number)
            key = int(columns[0])
            first.append(key)
            diagonal = root[columns]
            on = np.flatnonzero(diagonal > 0)
            if len(on):
                a = np.zeros((len(on), len(columns)))
                a[np.arange(len(on)), on] = diagonal[on]
                unit = gtsam.noiseModel.Unit.Create(len(on))
                graph.add(gtsam.JacobianFactor(key, a, np.zeros(len(on)), unit))
        if not first:
            return [], self._remainders(graph)
        rest: list[EliminationRemainder] = []
        try:
            if layers.has_cameras:
                ordering = self._ordering_of(graph, first)
                tree, left = (
                    graph.eliminatePartialMultifrontal(ordering, gtsam.EliminateQR)
                    if qr
                    else graph.eliminatePartialMultifrontal(ordering)
                )
                rest = self._remainders(left)
            else:
                ordering = self._ordering_of(graph, first)
                tree = (
                    graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)
                    if qr
                    else graph.eliminateMultifrontal(ordering)
                )
        except RuntimeError as error:
            raise SingularError(str(error)) from None
        return cliques_of(tree, layers.unknowns), rest

    def _ordering_of(self, graph: gtsam.GaussianFactorGraph, first: list[int]) -> gtsam.Ordering:
        """Return the ordering; it is computed once, as graphs of the same layers are alike."""
        if self.layers.ordering is None:
            self.layers.ordering = self._ordering(graph, first)
        return self.layers.ordering

    def _ordering(self, graph: gtsam.GaussianFactorGraph, first: list[int]) -> gtsam.Ordering:
        """Order the tree's variables by COLAMD, with what most observations touch last.

        Poses and frames are among the others: a point that a hundred poses observe, eliminated
        before them, would join them all.
        """
        layers = self.layers
        table = layers.unknowns
        late = [
            int(table[kind].offset[number])
            for kind, number in layers.tree
            if UNKNOWNS[kind].late > 1
        ]
        inside = set(first)
        present = set(graph.keyVector())
        last = [k for k in late if k in present]
        last += [k for k in present if k not in inside]
        whole = (
            gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(graph, last)
            if last
            else metis_ordering(graph)
            if len(first) > MAX_COLAMD_VARIABLES
            else gtsam.Ordering.ColamdGaussianFactorGraph(graph)
        )
        if len(inside) == whole.size():
            return whole
        ordering = gtsam.Ordering()
        for i in range(whole.size()):
            if whole.at(i) in inside:
                ordering.push_back(whole.at(i))
        return ordering

    def _remainders(self, graph: gtsam.GaussianFactorGraph) -> list[EliminationRemainder]:
        """Return the normal equations of factors over the cameras, one for each set of keys."""
        groups: dict[tuple[int, ...], gtsam.GaussianFactorGraph] = {}
        for i in range(graph.size()):
            factor = graph.at(i)
            if factor is not None and factor.size():
                keys = tuple(sorted(factor.keys()))
                groups.setdefault(keys, gtsam.GaussianFactorGraph()).push_back(factor)
        out = []
        for keys, group in groups.items():
            ordering = gtsam.Ordering()
            for key in keys:
                ordering.push_back(key)
            normal = np.asarray(group.augmentedHessian(ordering))[:-1, :-1]
            out.append(EliminationRemainder(self.layers.unknowns.columns_of(keys), normal))
        return out


def cliques_of(tree: gtsam.GaussianBayesTree, unknowns: Unknowns) -> list[Clique]:
    """Copy the cliques out of a Bayes tree, parents first.

    Args:
        tree: the tree.
        unknowns: the unknowns; a key is the first column of one.

    Raises:
        SingularError: a pivot vanished.
    """
    out: list[Clique] = []
    stack = [(root, -1) for root in tree.roots()]
    while stack:
        clique, parent = stack.pop()
        conditional = clique.conditional()
        r = np.array(conditional.R(), order="F")
        keys = list(conditional.keys())
        own = unknowns.columns_of(keys)
        f = r.shape[1]
        s = np.array(conditional.S()).reshape(f, len(own) - f)
        if not np.all(np.isfinite(r)) or np.any(np.diag(r) == 0):
            raise SingularError("a pivot vanished")
        t = upper_solve(r, s) if s.size else s
        stack.extend((clique[i], len(out)) for i in range(clique.nrChildren()))
        out.append(Clique(own[:f], own[f:], r, t, parent))
    return out


def metis_ordering(graph: gtsam.GaussianFactorGraph) -> gtsam.Ordering:
    """Return the order of METIS; variables without neighbours come first.

    They are ordered without METIS, which writes to invalid memory if a graph contains them.
    """
    joined = gtsam.GaussianFactorGraph()
    for i in range(graph.size()):
        factor = graph.at(i)
        if factor is not None and factor.size() > 1:
            joined.add(factor)
    inner = gtsam.Ordering.MetisGaussianFactorGraph(joined) if joined.size() else gtsam.Ordering()
    dissected = [inner.at(i) for i in range(inner.size())]
    inside = set(dissected)
    out = gtsam.Ordering()
    for key in (*(k for k in graph.keyVector() if k not in inside), *dissected):
        out.push_back(key)
    return out


class SelectedInverse:
    """Covariances of tree and cameras of a factorised system."""

    def __init__(
        self,
        cliques: Sequence[Clique],
        border: BlockMatrix | None,
        in_border: Index,
        n_columns: int,
    ) -> None:
        """Compute the joint covariance of each clique, from the roots to the leaves.

        Args:
            cliques: the cliques of the tree, parents first.
            border: covariances of the cameras; none: there are none.
            in_border: place of each column in them, −1 elsewhere, (n_columns,).
            n_columns: number of columns.
        """
        self._n = n_columns
        self._cliques = cliques
        self._border = border
        self._in_border = in_border
        nothing = [np.zeros(0, dtype=np.intp)]
        columns = np.concatenate([x for c in cliques for x in (c.frontal, c.separator)] or nothing)
        frontal = np.array([len(c.frontal) for c in cliques], dtype=np.intp)
        separator = np.array([len(c.separator) for c in cliques], dtype=np.intp)
        parent = np.array([c.parent for c in cliques], dtype=np.intp)
        size = self._size = frontal + separator
        first = np.cumsum(size) - size
        place = np.arange(len(columns)) - np.repeat(first, size)
        owner = np.repeat(np.arange(len(cliques)), size)
        own = place < np.repeat(frontal, size)
        self._clique = np.full(n_columns, -1, dtype=np.intp)
        self._clique[columns[own]] = owner[own]
        code = owner * n_columns + columns
        order = np.argsort(code)
        self._code, self._place = code[order], place[order]
        # Places of the separators in the parent, or among the cameras.
        there = parent[owner[~own]]
        within = np.where(
            there >= 0, self._find(np.maximum(there, 0), columns[~own]), in_border[columns[~own]]
        )
        stop = np.cumsum(separator)
        self._start = np.cumsum(size**2) - size**2
        self._values = np.empty(int(np.sum(size**2)))
        joints: list[Array] = []
        for number, c in enumerate(cliques):
            f, k = frontal[number], size[number]
            inverse = upper_solve(c.r, np.eye(f))
            at = self._start[number]
            joint = self._values[at : at + k * k].reshape(k, k)
            if k > f:
                where = within[stop[number] - (k - f) : stop[number]]
                if c.parent >= 0:
                    sss = joints[c.parent][where[:, None], where]
                else:
                    sss = self._cameras(where[None])[0]
                across = -c.t @ sss
                joint[:f, :f] = inverse @ inverse.T - across @ c.t.T
                joint[:f, f:] = across
                joint[f:, :f] = across.T
                joint[f:, f:] = sss
            else:
                joint[:] = inverse @ inverse.T
            joints.append(joint)

    def _cameras(self, places: Index) -> Array:
        """Return the joint covariances (n, k, k) of places (n, k); zero at −1: held components."""
        out = np.zeros((*places.shape, places.shape[1]))
        on = (places[:, :, None] >= 0) & (places[:, None, :] >= 0)
        if on.any():
            assert self._border is not None
            rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
            out[on] = self._border.at(rows[on], columns[on])
        return out

    def _find(self, clique: Index, columns: Index) -> Index:
        """Return the places of columns in the cliques that contain them."""
        if not len(self._code):
            return np.zeros(np.shape(columns), dtype=np.intp)
        found = np.searchsorted(self._code, clique * self._n + columns)
        return np.asarray(self._place[np.minimum(found, len(self._place) - 1)])

    def joint(self, columns: Index) -> Array:
        """Return the joint covariances (n, k, k) of sets of columns (n, k).

        The columns of a set belong to variables of one observation; −1 and held components give
        zeros.
        """
        out = np.zeros((*columns.shape, columns.shape[1]))
        safe = np.maximum(columns, 0)
        # Held components have no place in a clique or in the border.
        free = (self._clique[safe] >= 0) | (self._in_border[safe] >= 0)
        known = (columns >= 0) & free
        # Parents come first, so that the last clique eliminates the first variable.
        clique = np.where(known, self._clique[safe], -1).max(axis=1, initial=-1)
        inside = np.flatnonzero(clique >= 0)
        if len(inside):
            at, has = clique[inside], known[inside]
            place = np.where(has, self._find(at[:, None], safe[inside]), 0)
            flat = self._start[at][:, None, None] + (
                place[:, :, None] * self._size[at][:, None, None] + place[:, None, :]
            )
            pair = has[:, :, None] & has[:, None, :]
            out[inside] = np.where(pair, self._values[flat], 0.0)
        outside = np.flatnonzero((clique < 0) & known.any(axis=1))
        if len(outside):
            place = np.where(known[outside], self._in_border[safe[outside]], -1)
            out[outside] = self._cameras(place)
        return out

    def leverage(self, columns: Index, a: Array) -> Array:
        """Return A Σ Aᵀ (d, d) of one observation with partials (d, k) by columns (k,).

        The value equals that from `joint`, but is computed from the clique's own R: with
        y = R⁻ᵀ A_Fᵀ and B = A_S − A_F T,  A Σ Aᵀ = yᵀy + B Σ_SS Bᵀ.  No digits cancel if Σ_FF is
        large along a direction that the observation hardly measures, such as to a far point.
        """
        known = columns >= 0
        columns, a = columns[known], a[:, known]
        free = (self._clique[columns] >= 0) | (self._in_border[columns] >= 0)
        columns, a = columns[free], a[:, free]  # held components have no place
        number = int(self._clique[columns].max(initial=-1))
        if number < 0:
            return np.asarray(a @ self._cameras(self._in_border[columns][None])[0] @ a.T)
        c, k = self._cliques[number], int(self._size[number])
        f = len(c.frontal)
        whole = np.zeros((len(a), k))
        whole[:, self._find(np.full(len(columns), number), columns)] = a
        y = upper_transposed_solve(c.r, whole[:, :f].T)
        b = whole[:, f:] - whole[:, :f] @ c.t
        start = self._start[number]
        outer = self._values[start : start + k * k].reshape(k, k)[f:, f:]
        return np.asarray(y.T @ y + b @ outer @ b.T)
