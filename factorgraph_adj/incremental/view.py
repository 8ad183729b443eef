"""A `Solution` of the network in an iSAM2, whose covariances come from its own Bayes tree."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DatumError
from ..graph.equations import Equations
from ..graph.variables import State
from ..solve.batch import OFF_DATUM
from ..solve.datum import Defect, FreeDatum, find_defects
from ..solve.elimination import layers_of
from ..solve.factor import Factor
from ..solve.free_network import (
    MOTION,
    datum_columns,
    is_nothing,
    moved_from,
    onto_constraints,
)
from ..solve.linear import LinearSystem
from ..solve.normal import NormalEquations, Solver
from ..solve.singular import SingularError
from ..solve.solution import Solution
from ..solve.stopping import STOPPING
from ..types import Array, Index
from .cliques import own_cliques

if TYPE_CHECKING:
    from .network_graph import Graph
    from .register import Register
    from .tree import LinearTree


class TreeFactor(Factor):
    """The normal equations as iSAM2 has eliminated them."""

    def __init__(self, equations: Equations, tree: LinearTree, columns: dict[int, Index]) -> None:
        """Copy R and S out of a Bayes tree.

        Args:
            equations: whose columns are meant.
            tree: the tree.
            columns: free columns of each key.
        """
        nothing = np.zeros(equations.unknowns.n_columns, dtype=bool)
        self.layers = layers_of(equations, reduce_points=False, touched=nothing)
        self.free = equations.unknowns.free
        self.cliques = own_cliques(tree, columns)


class TreeNormal(NormalEquations):
    """Normal equations whose factorisation is that of iSAM2."""

    def __init__(
        self, solver: Solver, state: State, tree: LinearTree, columns: dict[int, Index]
    ) -> None:
        """Linearise at ``state``."""
        super().__init__(solver, state)
        self._tree, self._columns = tree, columns

    def for_covariances(self, constraint: Array, datum: FreeDatum | None = None) -> Factor:
        """Return the factorisation that iSAM2 has, with its minimal datum; see the base.

        It is that of the states where its factors were linearised, so that probes at this one
        would not tell rounding from that.
        """
        try:
            return TreeFactor(self.solver.equations, self._tree, self._columns)
        except (SingularError, RuntimeError):
            return super().for_covariances(constraint, datum)


@dataclass(frozen=True, eq=False, repr=False)
class TreeSolution(Solution):
    """A solution whose covariances come from the Bayes tree of an iSAM2."""

    tree: LinearTree | None = field(default=None, repr=False)
    """The tree; without it, as in copies, they come from the normal equations."""
    columns: dict[int, Index] = field(default_factory=dict, repr=False)
    """Free columns of each key of the tree."""

    def _linearise(self) -> NormalEquations:
        if self.tree is None:
            return super()._linearise()
        return TreeNormal(self.solver, self.state, self.tree, self.columns)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is copied and pickled, all but the tree."""
        return super().__getstate__() | {"tree": None}


def without_tree(solution: Solution) -> Solution:
    """Return a solution whose covariances come from its normal equations."""
    return replace(solution, tree=None) if isinstance(solution, TreeSolution) else solution


def columns_of(register: Register, equations: Equations) -> dict[int, Index]:
    """Return the free columns of each key of the graph."""
    out: dict[int, Index] = {}
    for key in register.keys:
        kind, number = register.variable(key)
        table = register[kind]
        theirs = equations.unknowns[kind]
        first = int(theirs.offset[theirs.number[table.names[number]]])
        out[key] = first + np.flatnonzero(table.free.view[number])
    return out


def solution_of(graph: Graph) -> Solution:
    """Return the solution of the network as it stands; a free one on its inner constraints."""
    equations, state, given = graph.whole()
    solver = Solver.of(equations)
    tree = graph.tree.copy()
    columns = columns_of(graph.register, equations)
    constraint = graph.constraint(equations)
    datum: FreeDatum | None = None
    defects: tuple[Defect, ...] = ()
    v = equations.residuals(state)
    on_datum = True
    if graph.held:
        moved, defects, datum = _on_datum(equations, state, given)
        there = equations.residuals(moved)
        # What no observation notices changes no residual.
        change = abs(float(there @ there) - float(v @ v))
        on_datum = change <= STOPPING.unchanged * (1.0 + float(v @ v))
        if on_datum:
            state, v = moved, there

    at_rest = f"within {graph.accuracy:.0%} of each σ of the minimum"
    doubt = graph.doubt if not graph.kept else "" if on_datum else OFF_DATUM
    return TreeSolution(
        network=equations.network,
        equations=equations,
        state=state,
        start=given,
        converged=graph.kept and on_datum,
        reason=doubt or ("at rest" if graph.settled else at_rest),
        iterations=0,
        vtpv=float(v @ v),
        solver=solver,
        constraint=constraint,
        datum=datum,
        defects=defects,
        tree=tree,
        columns=columns,
    )


def _on_datum(
    equations: Equations, state: State, given: State
) -> tuple[State, tuple[Defect, ...], FreeDatum]:
    """Return the state moved onto the inner constraints, its defect, and the constraints."""
    columns = None
    for _ in range(MOTION.transformations):
        system = LinearSystem(equations, state)
        defects = find_defects(system, state, system.diagonal(), free=True)
        if len(defects) != 1:
            raise DatumError(
                f"a free network must be one connected part, not {len(defects)}",
                defect=sum(d.size for d in defects),
            )
        if columns is None:
            columns = datum_columns(equations, defects[0].motions)
        datum = FreeDatum(defects[0].motions, columns)
        amounts = datum.project(moved_from(equations, state, given))
        if is_nothing(datum.motions @ amounts, state):
            break
        state = onto_constraints(equations, state, given, defects[0], columns)
    return state, tuple(defects), datum


def onto_datum(equations: Equations, state: State, given: State) -> tuple[float, State]:
    """Return how far a free network is from its inner constraints, and where it is on them.

    The distance is relative to the extent of the points.
    """
    moved, _, _ = _on_datum(equations, state, given)
    points = state["point"]
    extent = float(np.abs(points - points.mean(axis=0)).max(initial=0.0)) or 1.0
    return float(np.abs(moved["point"] - points).max(initial=0.0)) / extent, moved
