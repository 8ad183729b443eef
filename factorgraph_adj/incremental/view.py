"""A `Solution` of the network in an iSAM2, whose covariances come from its own Bayes tree."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import gtsam
import numpy as np

from ..errors import DatumError
from ..graph.equations import Equations
from ..graph.keys import CHARS
from ..graph.variables import State
from ..models.registry import VariableKind
from ..quality.solution import Solution
from ..solve.batch import OFF_DATUM
from ..solve.datum import Defect, FreeDatum, find_defects
from ..solve.factor import Factor
from ..solve.free_network import (
    MOST_TRANSFORMATIONS,
    datum_columns,
    is_nothing,
    moved_from,
    onto_constraints,
)
from ..solve.linear import LinearSystem
from ..solve.normal import NormalEquations, Solver
from ..solve.plan import make_plan
from ..solve.selected_inverse import SelectedInverse
from ..solve.tree import SMALL, Clique, SingularError, cliques_of, down, nested_dissection, up
from ..solve.triangular import upper_solve
from ..types import Array, Index

if TYPE_CHECKING:
    from .engine import Engine
    from .register import Register
    from .tree import LinearTree

UNCHANGED = 1e-6
"""Part of vᵀPv that moving a free network to its datum points may change."""
MOST_DRAWN = 300
"""Variables up to which the cliques are read from iSAM2's own tree."""

_LABEL = re.compile(r'label="([^":]*)')
_KEY = re.compile(r"([a-z])(\d+)")
_KIND: dict[str, VariableKind] = {char: kind for kind, char in CHARS.items()}


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
        self.plan = make_plan(equations, reduce_points=False, touched=nothing)
        self.free = equations.unknowns.free
        self.points = None
        self.cliques = own_cliques(tree, columns)
        self.border = np.zeros((0, 0))
        self._factor_border()
        self._border_covariance = None
        self._inner = None


def own_cliques(tree: LinearTree, columns: dict[int, Index]) -> list[Clique]:
    """Return the cliques of iSAM2's Bayes tree, parents first.

    iSAM2 shows its cliques only as a drawing; with the order of elimination read from that,
    ``jointBayesNet`` gives the conditionals of the tree itself. That takes time with the square
    of their number; a large tree's factors are eliminated anew instead.
    """
    isam = tree.isam
    if len(columns) > MOST_DRAWN:
        return cliques_anew(tree, columns)
    groups = [
        [gtsam.symbol(c, int(i)) for c, i in _KEY.findall(label)]
        for label in _LABEL.findall(isam.dot())
    ]
    groups.reverse()
    order = [key for group in groups for key in group]
    net = isam.jointBayesNet(order, gtsam.EliminateQR)
    place = {key: i for i, key in enumerate(order)}
    of = {c.keys()[0]: c for c in (net.at(i) for i in range(net.size()))}
    clique_of = {key: n for n, group in enumerate(groups) for key in group}
    count = len(groups)
    out: list[Clique] = []
    for n in range(count - 1, -1, -1):
        group = groups[n]
        conditionals = [of[key] for key in group]
        seen: dict[int, None] = {}
        for c in conditionals:
            seen.update(dict.fromkeys(c.keys()))
        own = set(group)
        separator = sorted((k for k in seen if k not in own), key=place.__getitem__)
        r, s = _stack(group, separator, conditionals, columns)
        t = upper_solve(r, s) if s.size else s
        parent = count - 1 - clique_of[separator[0]] if separator else -1
        out.append(
            Clique(
                np.concatenate([columns[k] for k in group]),
                np.concatenate([columns[k] for k in separator] or [np.zeros(0, dtype=np.intp)]),
                r,
                t,
                parent,
            )
        )
    return out


def cliques_anew(tree: LinearTree, columns: dict[int, Index]) -> list[Clique]:
    """Return the cliques of the same factors, eliminated once more."""
    isam = tree.isam
    graph = isam.getFactorsUnsafe().linearize(isam.getLinearizationPoint())
    ordering = (
        nested_dissection(graph)
        if len(columns) > SMALL
        else gtsam.Ordering.ColamdGaussianFactorGraph(graph)
    )
    if not tree.qr:
        try:
            return cliques_of(graph.eliminateMultifrontal(ordering), columns)
        except RuntimeError:
            pass  # Cholesky may refuse in this order what it did in the tree's
    try:
        bayes = graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    except RuntimeError as error:
        raise SingularError(str(error)) from None
    return cliques_of(bayes, columns)


def _stack(
    group: Sequence[int],
    separator: Sequence[int],
    conditionals: Sequence[gtsam.GaussianConditional],
    columns: dict[int, Index],
) -> tuple[Array, Array]:
    """Return R (f, f) and S (f, s) of a clique from the conditionals of its variables."""
    first: dict[int, int] = {}
    n = 0
    for key in (*group, *separator):
        first[key] = n
        n += len(columns[key])
    f = sum(len(columns[k]) for k in group)
    whole = np.zeros((f, n), order="F")
    for key, c in zip(group, conditionals, strict=True):
        at = first[key]
        k = len(columns[key])
        r = np.array(c.R())
        s = np.array(c.S()).reshape(k, -1)
        model = c.get_model()
        if model is not None:
            scale = 1.0 / np.array(model.sigmas())
            r, s = r * scale[:, None], s * scale[:, None]
        whole[at : at + k, at : at + k] = r
        left = 0
        for other in list(c.keys())[1:]:
            size = len(columns[other])
            to = first[other]
            if to < at:
                raise SingularError("the tree is not in the order of its drawing")
            whole[at : at + k, to : to + size] = s[:, left : left + size]
            left += size
    r = np.asfortranarray(whole[:, :f])
    if not np.all(np.isfinite(r)) or np.any(np.diag(r) == 0):
        raise SingularError("a pivot vanished")
    return r, whole[:, f:]


class TreeNormal(NormalEquations):
    """Normal equations whose factorisation is that of iSAM2."""

    def __init__(
        self, solver: Solver, state: State, tree: LinearTree, columns: dict[int, Index]
    ) -> None:
        """Linearise at ``state``."""
        super().__init__(solver, state)
        self._tree, self._columns = tree, columns

    def factorise(self, extra: Array, *, exact: bool = False) -> Factor:
        """Return the factorisation that iSAM2 has, with its minimal datum; see the base."""
        try:
            return TreeFactor(self.solver.equations, self._tree, self._columns)
        except (SingularError, RuntimeError):
            return super().factorise(extra, exact=exact)


def variances_of(tree: LinearTree, register: Register) -> Array:
    """Return the variances of all free components from one pass down the tree, (n_places,)."""
    n = register.n_places
    cliques = cliques_anew(tree, {k: register.places(k) for k in register.keys})
    inverse = SelectedInverse(cliques, np.zeros((0, 0)), np.full(n, -1), n)
    return inverse.joint(np.arange(n)[:, None])[:, 0, 0]


def cofactor_times(tree: LinearTree, register: Register, y: Array) -> Array:
    """Return Q y over all free components, (n_places, k)."""
    cliques = cliques_anew(tree, {k: register.places(k) for k in register.keys})
    x = np.zeros_like(y)
    up(cliques, down(cliques, y), x)
    if not np.isfinite(x).all():
        raise SingularError("a pivot vanished")
    return x


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


def solution_of(engine: Engine) -> Solution:
    """Return the solution of the network as it stands; a free one on its inner constraints."""
    equations, state, given = engine.whole()
    solver = Solver.of(equations)
    tree = engine.tree.copy()
    columns = columns_of(engine.register, equations)
    constraint = engine.constraint(equations)
    datum: FreeDatum | None = None
    defects: tuple[Defect, ...] = ()
    v = equations.residuals(state)
    on_datum = True
    if engine.held:
        moved, defects, datum = _on_datum(equations, state, given)
        there = equations.residuals(moved)
        # What no observation notices changes no residual.
        on_datum = abs(float(there @ there) - float(v @ v)) <= UNCHANGED * (1.0 + float(v @ v))
        if on_datum:
            state, v = moved, there

    def normal_at(at: State) -> NormalEquations:
        return NormalEquations(solver, at)

    made: list[NormalEquations] = []

    def normal() -> NormalEquations:
        if not made:
            made.append(TreeNormal(solver, state, tree, columns))
        return made[0]

    at_rest = f"within {engine.accuracy:.0%} of each σ of the minimum"
    doubt = engine.doubt if not engine.kept else "" if on_datum else OFF_DATUM
    return Solution(
        network=equations.network,
        equations=equations,
        state=state,
        start=given,
        converged=engine.kept and on_datum,
        reason=doubt or ("at rest" if engine.settled else at_rest),
        iterations=0,
        vtpv=float(v @ v),
        datum=datum,
        defects=defects,
        variance="a-priori",
        weights=None,
        n_extra=0,
        normal=normal,
        normal_at=normal_at,
        constraint=constraint,
    )


def start_at(equations: Equations, state: State, given: State) -> Solution:
    """Return values for an adjustment to start from."""

    def normal_at(at: State) -> NormalEquations:
        return NormalEquations(Solver.of(equations), at)

    return Solution(
        network=equations.network,
        equations=equations,
        state=state,
        start=given,
        converged=False,
        reason="a start",
        iterations=0,
        vtpv=np.nan,
        datum=None,
        defects=(),
        variance="a-priori",
        weights=None,
        n_extra=0,
        normal=lambda: normal_at(state),
        normal_at=normal_at,
        constraint=np.zeros(equations.unknowns.n_columns),
    )


def _on_datum(
    equations: Equations, state: State, given: State
) -> tuple[State, tuple[Defect, ...], FreeDatum]:
    """Return the state moved onto the inner constraints, its defect, and the constraints."""
    columns = None
    for _ in range(MOST_TRANSFORMATIONS):
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
