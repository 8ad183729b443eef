"""Linear system in iSAM2: networks that suit it, rows that enter or leave, joint tests in the tree.

The tree answers the queries of an arrival. All other queries need the network in fronts, see
`front_system`: these are adjusted from the present estimates, once, when they are first needed.

"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import AdjustmentError
from ..factor_graph.factor_tests import JointCovariance
from ..factor_graph.linear_isam2 import MAX_TURNS, LinearISAM2
from ..factor_graph.row_arrays import Arriving, Mark
from ..graph.dependence import Variable
from ..graph.equations import Equations, compile_rows
from ..graph.variables import State, Unknowns
from ..ledger.command_input import Options
from ..ledger.excerpts import excerpt
from ..ledger.ledger import Ledger
from ..ledger.row_store import Unit
from ..models.unknown_registry import VariableKind
from ..quality.group_tests import LeaveOneOutTests
from ..solve.adjustment_run import ShapeMisfit
from ..solve.given_state import solution_at_given_values
from ..solve.second_minimum import WEAK_EIGENVALUE_RATIO, mirror_midpoints, points_without_rays
from ..solve.solution import Solution
from ..start.start_values import Start
from ..types import NO_ROWS, Array, Index, Mask
from .arrival_decisions import MOTION_SIGMAS, SINGULAR_REDUNDANCY, PointCovariance
from .front_system import FrontSystem
from .linear_system import EngineName, LinearForms, block_by_block, rows_of
from .rebase import EFFORT, Draft

MAX_UNKNOWNS_CHOSEN = 2_500
"""Largest number of unknowns of a network without poses for which iSAM2 is chosen, measured with
grids of total stations: a single reading takes as long in fronts with 1 600 unknowns, and a third
of the time with 4 100, where new stations take as long; with 40 000 these take half."""
MAX_IMAGE_POINTS = 64
"""Largest number of image points that arrive together in a tree; more are adjusted in fronts."""
SAMPLED_SIGMA_FACTOR = 1.5
"""Factor that turns standard deviations from samples into upper bounds."""
LINEARISATION_SHARE = 0.5
"""Share of the promised accuracy that errors of forms may have: their bound is of first order."""


class ISAM2System:
    """A network at its minimum, in iSAM2."""

    def __init__(
        self, tree: LinearISAM2, ledger: Ledger, rules: Options, beside: FrontSystem | None = None
    ) -> None:
        """Take a tree over as it is.

        Args:
            tree: the tree.
            ledger: the ledger of its observations.
            rules: the options.
            beside: the network adjusted at once, if it has been; None: it has not.
        """
        self._tree, self._ledger, self._rules, self._beside = tree, ledger, rules, beside
        self._version = tree.version
        self._mark: Mark | None = None
        self._refused: tuple[str, ...] = ()
        """First ids of the units with which the tree did not converge last."""
        self.doubt = ""

    @staticmethod
    def suits(system: FrontSystem, rules: Options) -> bool:
        """Return whether a network suits iSAM2."""
        base = system.base
        return not (
            system.section is not None
            or system.doubt
            or not base.converged
            or rules.datum == "free"
            or base.extra.rows
            or base.equations.n_rays > _most_rays(rules)
            or outgrown(base.equations.unknowns.n_unknowns, rules, has_poses=system.has_poses)
        )

    @classmethod
    def of(cls, system: FrontSystem, ledger: Ledger, rules: Options) -> ISAM2System | None:
        """Put a network into iSAM2; None where iSAM2 refuses it, or linear forms do not hold."""
        base = system.base
        tree = LinearISAM2(
            base.equations.network.frame, accuracy=LINEARISATION_SHARE * rules.accuracy
        )
        equations, state = base.equations, base.state
        if system.changed:
            draft = Draft.of(ledger, system, rules.datum)
            equations, state = draft.equations, draft.start.state
        try:
            tree.enter([Arriving(equations.weighted_at(state), state)])
            tree.bound(base.equations.unknowns, SAMPLED_SIGMA_FACTOR * system.lifted.sigma)
        except AdjustmentError:
            return None
        if not tree.follow_to_rest():
            return None
        return cls(tree, ledger, rules, None if system.changed else system)

    # -- what is known ------------------------------------------------------------------------

    @property
    def tree(self) -> LinearISAM2:
        """The tree in the state of this system: later changes are undone."""
        if self._tree.version != self._version:
            assert self._mark is not None
            self._tree.restore(self._mark)
            self._mark = None
        return self._tree

    @cached_property
    def fronts(self) -> FrontSystem:
        """The network in fronts, adjusted from the present estimates, or linearised there.

        Raises:
            AdjustmentError: the network is singular to working precision.
        """
        if self._beside is not None:
            return self._beside
        draft = Draft.of(self._ledger, self, self._rules.datum)
        found = draft.adjusted(self._rules.datum, tolerances=(EFFORT.close,))
        if isinstance(found, FrontSystem):
            return found
        within = self._rules.accuracy
        reason = f"within {within:.0%} of each σ of the minimum"
        there = solution_at_given_values(
            draft.equations,
            draft.start,
            None,
            reason=reason,
            within=within,
            doubt="",
            extra=draft.extra,
        )
        return FrontSystem.of(there, rows=draft.rows)

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether a variable is determined, or a constant."""
        table = self.tree.tables.get(kind)
        return table is not None and name in table.number

    def columns(self, kind: VariableKind, name: str) -> Index:
        """Return the columns of the free components of a known variable."""
        columns = self.tree.columns(kind, name)
        return np.asarray(columns[columns >= 0])

    @property
    def extent(self) -> float:
        """Diagonal of the box around all points, metres."""
        return float(np.linalg.norm(np.ptp(self.tree.state()["point"], axis=0)))

    def forms(self, ledger: Ledger, rows: Index) -> LinearForms:
        """Linearise observations between known variables at the present state.

        Raises:
            InputError: names observations with degenerate geometry.
        """
        equations = compile_rows(excerpt(ledger, self, rows, hold=False))
        state = equations.unknowns.start()
        units, columns = ledger.units(rows), self.tree.columns
        return LinearForms.of(units, equations, columns, lambda c: np.zeros(len(c)), state)

    def names(self, kind: VariableKind) -> set[str]:
        """Return the names of the known variables of a kind."""
        table = self.tree.tables.get(kind)
        return set() if table is None else set(table.number)

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return the value of a variable as in a state; None: it is not known."""
        return self.tree.value(kind, name) if self.known(kind, name) else None

    def places(self) -> list[tuple[Unknowns, State, State]]:
        """Return unknowns, state and start values: none; see `carried`."""
        return []

    def carried(self, unknowns: Unknowns, state: State) -> State:
        """Return a state with the values of all known variables."""
        return self.tree.carried(unknowns, state)

    def cofactors(self, a: Variable, b: Variable) -> Array:
        """Return the joint cofactors of the components of two variables, (i, j)."""
        tree = self.tree
        columns = [tree.columns(*v) for v in (a, b)]
        out = np.zeros((len(columns[0]), len(columns[1])))
        free = [c >= 0 for c in columns]
        if not free[0].any() or not free[1].any():
            return out
        keys = [tree.key(v) for v in (a, b)]
        if tree.lost:
            return self.fronts.cofactors(a, b)
        if a == b:
            found = tree.covariance(a)
        else:
            joint = tree.covariance_of(sorted(keys))
            n = int(free[0].sum()) if keys[0] < keys[1] else int(free[1].sum())
            found = joint[:n, n:] if keys[0] < keys[1] else joint[n:, :n]
        out[np.ix_(free[0], free[1])] = found
        return out

    def function_cofactors(
        self, touched: Mapping[Variable, Index], a: Array, groups: Sequence[Index]
    ) -> list[Array]:
        """Return the cofactors A Q Aᵀ of groups of functions; see `LinearSystem`."""
        return block_by_block(self, touched, a, groups)

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear forms."""
        return self.tree.vtpv

    @property
    def n_rows(self) -> int:
        """Number of scalar rows, weighted unknowns among them."""
        return self.tree.n_rows

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        return self.tree.n_rows - self.tree.n_unknowns

    @property
    def n_rays(self) -> int:
        """Number of image points: few, see `MAX_IMAGE_POINTS`."""
        return 0

    @property
    def looked(self) -> Mapping[str, ShapeMisfit]:
        """Shapes that were fitted again in vain: none is known."""
        return {}

    @property
    def is_free(self) -> bool:
        """Whether it is a free network: these are adjusted in fronts."""
        return False

    @property
    def engine(self) -> EngineName:
        """Engine that holds the system."""
        return "isam2"

    @property
    def has_poses(self) -> bool:
        """Whether a pose is known."""
        table = self.tree.tables.get("pose")
        return table is not None and len(table.number) > 0

    @property
    def outgrown(self) -> bool:
        """Whether fronts would be faster now."""
        return outgrown(self.tree.n_unknowns, self._rules, has_poses=self.has_poses)

    @property
    def adjusted_solution(self) -> Solution | None:
        """The batch solution of everything; None: something has changed since there was one."""
        return None if self._beside is None else self._beside.adjusted_solution

    @property
    def datum_solution(self) -> Solution | None:
        """None: the datum is given."""
        return None

    def renumbered(self, new: Index) -> ISAM2System:
        """Return the system after the rows of the ledger have got new numbers (n,)."""
        if self._beside is not None:
            self._beside = self._beside.renumbered(new)
        return self

    def prepared(self) -> ISAM2System:
        """Return the system: there is nothing to prepare."""
        return self

    # -- arrivals -----------------------------------------------------------------------------

    def entered(
        self,
        ledger: Ledger,
        rows: Index,
        found: Sequence[Start],
        equations: Equations | None = None,
    ) -> EnteredRows | None:
        """Let observations enter the tree; None where it cannot take them.

        Args:
            ledger: the ledger with them.
            rows: the observations.
            found: start values of the variables that enter with them.
            equations: the observations alone; None: they have not been compiled.

        Raises:
            InputError: names observations with degenerate geometry.
        """
        if self.tree.lost or len(ledger.rows.images(rows)) > _most_rays(self._rules):
            return None
        units = ledger.units(rows)
        if any(o.kind == "factor" for unit in units for o in unit.observations):
            return None
        if equations is None:
            equations = compile_rows(excerpt(ledger, self, rows, hold=False))
        state = equations.unknowns.start()
        moving = equations.unknowns.moving()
        for start in found:
            state = equations.unknowns.carried(state, start.unknowns, start.state, where=moving)
        if any(np.isnan(x).any() for x in state.values()):
            return None
        equations = equations.weighted_at(self.carried(equations.unknowns, state))
        tree = self.tree
        self._mark = tree.mark()
        with suppress(AdjustmentError):
            tree.enter([Arriving(equations, state)])
            return EnteredRows.of(tree, equations, tuple(units))
        _ = self.tree  # which undoes the changes
        return None

    def without(self, ids: Sequence[str], ledger: Ledger) -> ISAM2System | None:
        """Return the system without units; None where they alone determine something.

        Args:
            ids: first ids of the units.
            ledger: the ledger without them.
        """
        tree = self.tree
        # Weights of unknowns are in no unit.
        if tree.lost or not all(i in tree.unit for i in ids):
            return None
        units = np.array([tree.unit[i] for i in ids], dtype=np.intp)
        redundancy = tree.joint_covariance(units).least_redundancy
        if redundancy <= SINGULAR_REDUNDANCY:
            return None
        self._mark = tree.mark()
        with suppress(AdjustmentError):
            tree.leave(units, redundancy)
            if tree.follow_to_rest():
                return ISAM2System(tree, ledger, self._rules)
        _ = self.tree  # which undoes the changes
        return None

    def converged(self, beside: FrontSystem) -> ISAM2System | None:
        """Return the system converged; None where the tree converges elsewhere, or does not.

        Args:
            beside: the network adjusted at once.
        """
        tree = self.tree
        self._mark = tree.mark()
        with suppress(AdjustmentError):
            if tree.settle() < MAX_TURNS and tree.agrees(beside.unknowns, beside.state):
                return ISAM2System(tree, self._ledger, self._rules, beside)
        _ = self.tree  # which undoes the changes
        return None

    def after(self, entered: EnteredRows, ledger: Ledger) -> ISAM2System | None:
        """Return the system with the units that have entered; None where it does not converge."""
        tree, ids = entered.tree, tuple(unit.ids[0] for unit in entered.units)
        if ids != self._refused:
            tree.bound_new(entered.together)
            with suppress(AdjustmentError):
                if tree.follow_to_rest():
                    return ISAM2System(tree, ledger, self._rules)
        self._refused = ids
        _ = self.tree  # which undoes the changes
        return None


def outgrown(n_unknowns: int, rules: Options, *, has_poses: bool) -> bool:
    """Return whether fronts are faster than iSAM2, where the engine may be chosen.

    A new base for each pose of a long chain takes longer in fronts, whatever their number.
    """
    return rules.engine == "auto" and not has_poses and n_unknowns > MAX_UNKNOWNS_CHOSEN


def _most_rays(rules: Options) -> int:
    """Return the largest number of image points in a tree: fronts are made for photos."""
    return MAX_IMAGE_POINTS if rules.engine == "isam2" else 0


@dataclass(frozen=True, eq=False)
class EnteredRows:
    """Units that have entered a tree, as `arrival_decisions.JointTest`."""

    tree: LinearISAM2
    """The tree with them."""
    units: tuple[Unit, ...]
    """The units."""
    raw: tuple[Array, ...]
    """L of each unit with Σ = L Lᵀ, (d, d)."""
    numbers: Index
    """Their numbers in the tree."""
    equations: Equations
    """The units alone."""
    together: JointCovariance
    """The units with the joint covariance of what they touch, before anything is evaluated again: a
    gross error displaces everything that it touches, beyond the range of linear forms."""
    version: int
    """Version of the tree in which they are tested."""

    @classmethod
    def of(cls, tree: LinearISAM2, equations: Equations, units: tuple[Unit, ...]) -> EnteredRows:
        """Find units that have just entered."""
        raw = rows_of(units, equations)[1]
        numbers = np.array([tree.unit[u.ids[0]] for u in units], dtype=np.intp)
        return cls(
            tree, units, raw, numbers, equations, tree.joint_covariance(numbers), tree.version
        )

    def tested(self) -> LeaveOneOutTests:
        """Return the tests of the units against everything else."""
        return self.together.tested()

    def renewed(self) -> EnteredRows:
        """Return the units, to be tested at the present estimates."""
        if self.tree.version == self.version:
            return self
        together = self.tree.joint_covariance(self.numbers)
        return replace(self, together=together, version=self.tree.version)

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns with the rows of a unit, (m, d)."""
        return self.together.spread(i, columns)

    def place(self, name: str) -> PointCovariance:
        """Return a point with all units in."""
        columns = self.tree.columns("point", name)
        free: Mask = columns >= 0
        if not free.any():
            return PointCovariance(NO_ROWS, free, np.zeros(0))
        return PointCovariance(columns, free, self.together.variance(columns))

    def images(self, new: Collection[Variable]) -> bool:
        """Return whether new points may fit on other sides too; see `solve.second_minimum`."""
        equations = self.equations
        unknowns = equations.unknowns
        mine = np.array([("point", name) in new for name in unknowns["point"].names], dtype=bool)
        candidates = points_without_rays(equations) & mine
        if not candidates.any():
            return False
        for number in np.flatnonzero(candidates).tolist():
            columns = self.tree.columns("point", unknowns["point"].names[number])
            a = self.together.partials(columns[columns >= 0])
            values = np.linalg.eigvalsh(a.T @ a)
            if values[0] < WEAK_EIGENVALUE_RATIO * values[-1]:
                return True
        state = self.tree.carried(unknowns, unknowns.start())
        return bool(mirror_midpoints(equations, state, candidates))

    def held_by(self, i: int, combinations: Array, new: Collection[Variable]) -> set[Variable]:
        """Return those of new variables that combinations (d, n) of a unit's rows determine."""
        out: set[Variable] = set()
        mine = set(self.units[i].variables)
        for kind, name in new:
            columns = self.tree.columns(kind, name)
            columns = columns[columns >= 0]
            if (kind, name) not in mine or not len(columns):
                continue
            motion = self.spread(i, columns) @ combinations
            far = np.abs(motion).max(axis=1) * self.tree.weight(columns)
            if (far > MOTION_SIGMAS).any():
                out.add((kind, name))
        return out
