"""Elimination by GTSAM of the unknowns outside the first layer, and the cliques of its Bayes tree.

GTSAM eliminates multifrontally in its ordering, by QR or Cholesky; each clique of the Bayes tree
gives R and S of  R x_F = d − S x_S.  R and S are copied once (GTSAM's views do not own their
memory) and serve every right side and the selected inverse:

    Σ_FS = −T Σ_SS,   Σ_FF = R⁻¹R⁻ᵀ − Σ_FS Tᵀ,   T = R⁻¹ S       (top down).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from ..graph.variables import Unknowns
from ..models.variables import UNKNOWNS
from ..types import Array, Index
from .elimination import Layers, outside
from .linear import LinearisedEquations
from .linear_block import LinearBlock
from .linear_rays import LinearRays
from .remainder import Remainder
from .singular import SingularError
from .triangular import upper_solve, upper_transposed_solve

UNIT = {d: gtsam.noiseModel.Unit.Create(d) for d in range(1, 7)}
MOST_KEYS = 3
"""Largest number of keys that the JacobianFactor constructor takes in Python."""


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


def down(cliques: Sequence[Clique], y: Array) -> list[Array]:
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


def up(cliques: Sequence[Clique], halves: Sequence[Array], x: Array) -> None:
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
            rows = outside(system.equations, layers, place)
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
        zero, unit = np.zeros(d), UNIT[d]
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
            elif len(chosen) == MOST_KEYS:
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
        if len(terms) <= MOST_KEYS:
            flat = [x for term in terms for x in term]
            make: Callable[..., gtsam.JacobianFactor] = gtsam.JacobianFactor
            graph.add(make(*flat, zero, unit))
        else:
            graph.add(gtsam.GaussianConditional(terms, 1, zero, unit))

    def eliminate(self, extra: Array, *, qr: bool) -> tuple[list[Clique], list[Remainder]]:
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
        rest: list[Remainder] = []
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
            else nested_dissection(graph)
            if len(first) > SMALL
            else gtsam.Ordering.ColamdGaussianFactorGraph(graph)
        )
        if len(inside) == whole.size():
            return whole
        ordering = gtsam.Ordering()
        for i in range(whole.size()):
            if whole.at(i) in inside:
                ordering.push_back(whole.at(i))
        return ordering

    def _remainders(self, graph: gtsam.GaussianFactorGraph) -> list[Remainder]:
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
            out.append(Remainder(self.layers.unknowns.columns_of(keys), normal))
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


SMALL = 300
"""Largest number of variables for which the fill of COLAMD is as good as that of nested
dissection."""


def nested_dissection(graph: gtsam.GaussianFactorGraph) -> gtsam.Ordering:
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
