"""Linear system in fronts: an adjusted network or section, and rows that joined or left it since.

The base is a batch solution at a minimum. A low-rank update
(`factorgraph_adj.solve.low_rank_update`) beside it has the rows of arrivals between known variables
and of removals. Estimates and cofactors are those of both together, to first order;
`linearisation_error` computes how far that is valid. A system is a value: every change returns
another one.

"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..graph.dependence import Variable
from ..graph.equations import compile_rows
from ..graph.variables import State, Unknowns
from ..ledger.excerpts import excerpt
from ..ledger.ledger import Ledger
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..solve.adjustment_run import ShapeMisfit
from ..solve.doubtful_points import VaguePoint, vague_points
from ..solve.linear_base import LinearisationDrift, ReducedCofactors, ReducedFunctions
from ..solve.low_rank_update import Update
from ..solve.solution import Solution, forget_normal_equations, solution_at
from ..types import NO_ROWS, Array, Index, Mask
from .border import Border
from .free_network_cofactors import UpdatedCofactors
from .linear_system import EngineName, LinearForms, block_by_block
from .section import Attempts, Section, renumbered

MAX_UPDATE_ROWS = 256
"""Largest number of rows beside a base: with more of them a new base costs less on average, from
400 to 1 000 points."""
MAX_UPDATE_ROWS_LARGE = 512
"""The same for large networks, measured with 10 000 points."""
LARGE_SYSTEM_UNKNOWNS = 10_000
"""Number of unknowns of the reduced system from which a network is large."""


@dataclass(frozen=True, eq=False)
class FrontSystem:
    """A network at its minimum, to first order."""

    base: Solution
    """The adjusted network."""
    lifted: ReducedCofactors
    """Its cofactors."""
    update: Update
    """Rows that joined or left."""
    joined: Mapping[str, Index] = field(default_factory=dict)
    """Rows of the update that joined, by id."""
    slots: Mapping[int, int] = field(default_factory=dict)
    """Slots of points that only cameras see, by their numbers in the first layer."""
    offset: Array | None = None
    """Movement of the base itself, which followed its gradient, (n_columns,); None: it did not."""
    followed: Array | None = None
    """The gradient that it followed, (n_columns,)."""
    shifted: float = 0.0
    """Bound of the length of that movement, relative to σ."""
    drift: LinearisationDrift | None = None
    """The last examination of how far the linear forms of the base hold; None: there was none."""
    doubt: str = ""
    """Why this is not the minimum of everything in the graph; empty if it is."""
    rows: Index = field(default_factory=lambda: NO_ROWS)
    """Rows of the ledger in the base."""
    section: Section | None = None
    """Information of the rest on the base, if it is a section of the network; None: it is the
    whole."""
    attempts: Attempts = field(default_factory=Attempts)
    """Attempts to adjust a section instead of the whole."""
    border: Border = field(default_factory=Border)
    """New unknowns that the update has beside those of the base, which then is the whole."""

    @classmethod
    def of(
        cls,
        base: Solution,
        doubt: str = "",
        *,
        rows: Index = NO_ROWS,
        section: Section | None = None,
    ) -> FrontSystem:
        """Return the system of a solution.

        Raises:
            SingularError: an unknown is determined too weakly for covariances.
        """
        lifted = ReducedCofactors(base)
        return cls(base, lifted, Update.of(lifted), doubt=doubt, rows=rows, section=section)

    @cached_property
    def whole(self) -> FrontSystem:
        """The whole network at its last adjustment; of a section without later observations."""
        section = self.section
        if section is None:
            return self
        update = Update.of(section.lifted)
        return FrontSystem(
            section.base, section.lifted, update, drift=section.drift, rows=section.inside
        )

    @cached_property
    def rest(self) -> FrontSystem:
        """The whole network as it follows the section."""
        section = self.section
        assert section is not None
        drift = None if section.looked is None else section.looked.drift
        offset, length = section.movement(*self.followed_by), section.length(*self.followed_by)
        return replace(self.whole, offset=offset, shifted=length, drift=drift)

    @cached_property
    def followed_by(self) -> tuple[Array, Array]:
        """Movement of T (m,) and coordinates u (n,), which the rest follows."""
        section = self.section
        assert section is not None
        u = -(self.update.spread[self.of_own] @ self.weights)
        return section.known.prior.movement(self.base.equations, self.state), u

    def renumbered(self, new: Index) -> FrontSystem:
        """Return the system after the rows of the ledger have got new numbers (n,)."""
        section = self.section and self.section.renumbered(new)
        return replace(self, rows=renumbered(self.rows, new), section=section)

    def prepared(self) -> FrontSystem:
        """Compute now what the first arrival would wait for.

        Covariances of all points of photos are not computed: few of them are ever needed.
        """
        _ = self.lifted.sigma
        if self.base.factor.points is None:
            _ = self.base.factor.inverse
        return self

    # -- what is known ------------------------------------------------------------------------

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether a variable is determined, or a constant."""
        return (
            name in self.unknowns[kind].number
            or (kind, name) in self.border.unknowns
            or (self.section is not None and self.whole.known(kind, name))
        )

    def names(self, kind: VariableKind) -> set[str]:
        """Return the names of the known variables of a kind."""
        own = set(self.unknowns[kind].number) | self.border.names(kind)
        return own | set(self.whole.unknowns[kind].number)

    @property
    def has_poses(self) -> bool:
        """Whether a pose is known."""
        new = any(kind == "pose" for kind, _ in self.border.unknowns)
        return new or any(s.unknowns["pose"].number for s in (self, self.whole))

    def places(self) -> list[tuple[Unknowns, State, State]]:
        """Return unknowns, state and start values; those of a later entry were adjusted later."""
        own = self.unknowns, self.state, self.base.start
        if self.section is None:
            return [own]
        rest = self.rest
        return [(rest.unknowns, rest.state, rest.base.start), own]

    def carried(self, unknowns: Unknowns, state: State) -> State:
        """Return a state with the values of the new unknowns beside the base."""
        return self.border.carried(unknowns, state, self.value) if self.border.unknowns else state

    @property
    def solution(self) -> Solution:
        """The whole network at the present estimates, without new unknowns since it was made."""
        if self.section is None:
            return solution_at(self.base, self.state)
        rest = self.rest
        carried = rest.unknowns.carried(rest.state, self.unknowns, self.state)
        return solution_at(rest.base, carried)

    def covers(self, variables: Iterable[Variable]) -> bool:
        """Return whether the base has all of some known variables."""
        unknowns = self.unknowns
        return self.section is None or all(name in unknowns[k].number for k, name in variables)

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return the value of a variable as in a state; None: it is not known."""
        table = self.base.equations.unknowns[kind]
        number = table.number.get(name)
        if (kind, name) in self.border.unknowns:
            return self.border.value((kind, name), self.step_at(self.columns(kind, name)))
        if number is None:
            return None if self.section is None else self.rest.value(kind, name)
        stored = self.base.state[kind][number]
        if not self.changed or table.offset[number] < 0:
            return np.array(stored)
        columns = self.columns(kind, name)
        step = np.zeros(table.free.shape[1])
        step[: len(columns)] = self.moved(columns)
        return np.asarray(UNKNOWNS[kind].retract(stored[None], step[None])[0])

    def reaching(self, variables: Iterable[Variable]) -> FrontSystem | None:
        """Return the system beside which rows may touch some known variables.

        None: there is no room for those outside its section.
        """
        own = self.unknowns
        apart = [v for v in variables if v[1] not in own[v[0]].number]
        if self.section is None or not apart:
            return self
        columns = np.concatenate([self.whole.columns(*v) for v in apart])
        section = self.section.reaching(columns)
        found = None if section is None else replace(self, section=section)
        return found if found is not None and found.has_room(self.slots) else None

    @property
    def most_beside(self) -> int:
        """Largest number of rows beside the base."""
        return (
            MAX_UPDATE_ROWS
            if len(self.lifted.columns) < LARGE_SYSTEM_UNKNOWNS
            else MAX_UPDATE_ROWS_LARGE
        )

    def has_room(self, slots: Mapping[int, int]) -> bool:
        """Return whether there is room for slots of points beside the coordinates u."""
        n_own = 0 if self.section is None else self.section.n_own
        return 3 * len(slots) + n_own <= 3 * self.lifted.slots

    def columns(self, kind: VariableKind, name: str) -> Index:
        """Return the columns of a variable; empty for constants.

        Those of a variable outside the section are its columns of the whole, after all columns of
        the base, where those of new unknowns are too.
        """
        unknowns = self.unknowns
        number = unknowns[kind].number.get(name)
        if (new := self.border.unknowns.get((kind, name))) is not None:
            return np.asarray(unknowns.n_columns + new.columns)
        if number is None and self.section is not None:
            return unknowns.n_columns + self.whole.columns(kind, name)
        return NO_ROWS if number is None else unknowns.columns(kind, number)

    def free(self, columns: Index) -> Mask:
        """Return which columns are free, (m,)."""
        own = self.unknowns.free
        more = self.border.place >= 0 if self.section is None else self.whole.unknowns.free
        return np.asarray(np.append(own, more)[columns])

    def expand(self, columns: Index, a: Array) -> ReducedFunctions:
        """Return functions of unknowns (k, m) as functions of the coordinates.

        Unknowns outside the section are functions of T and u; their remaining independent part is
        left out.
        """
        n = self.unknowns.n_columns
        inner = columns < n
        f = self.lifted.expand(columns[inner], a[:, inner], self.slots)
        if inner.all():
            return f
        if self.section is None:
            place = self.border.place[columns[~inner] - n]
            new = place >= 0
            at = np.append(f.at, self.lifted.size + place[new])
            return ReducedFunctions(at, np.hstack([f.b, a[:, ~inner][:, new]]), f.own)
        carried = a[:, ~inner] @ self.section.carried(columns[~inner] - n)
        at, which = np.unique(np.append(f.at, self.of_rest), return_inverse=True)
        out = np.zeros((len(a), len(at)))
        np.add.at(out.T, which, np.hstack([f.b, carried]).T)
        return ReducedFunctions(at, out, f.own)

    # -- the movement from the base -----------------------------------------------------------

    @property
    def weights(self) -> Array:
        """P v of the update, (k,)."""
        return self.update.weights

    def moved(self, columns: Index) -> Array:
        """Return the movement of some unknowns from the base, (m,)."""
        step = self.step_at(columns)
        return step if self.offset is None else np.asarray(step + self.offset[columns])

    def step_at(self, columns: Index) -> Array:
        """Return the part of the movement that the update makes, (m,)."""
        if not len(self.update.signs):
            return np.zeros(len(columns))
        f = self.expand(columns, np.eye(len(columns)))
        return self.update.moved(f.at, f.b)

    @cached_property
    def movement(self) -> Array:
        """Movement of all unknowns from the base, (n_columns,)."""
        if not len(self.update.signs):
            return self.shift
        step = self.lifted.unknowns(self.update.step[: self.lifted.size], self.slots)
        return np.asarray(self.shift + step)

    @property
    def shift(self) -> Array:
        """Movement of the base itself, (n_columns,)."""
        return np.zeros(len(self.lifted.place)) if self.offset is None else self.offset

    @cached_property
    def state(self) -> dict[VariableKind, Array]:
        """Values of all variables of the base."""
        if not self.changed:
            return self.base.state
        return self.base.equations.unknowns.retract(self.base.state, self.movement)

    @property
    def extent(self) -> float:
        """Diagonal of the box around all points, metres."""
        return float(np.linalg.norm(np.ptp(self.state["point"], axis=0)))

    @property
    def n_rays(self) -> int:
        """Number of image points of the whole network as it was adjusted last."""
        return self.whole.base.equations.n_rays

    @property
    def looked(self) -> Mapping[str, ShapeMisfit]:
        """Shapes that were fitted again in vain, see `solve.shape_minimum`."""
        return self.base.run.shape_misfits

    @property
    def is_free(self) -> bool:
        """Whether it is a free network."""
        return self.base.datum is not None

    @property
    def changed(self) -> bool:
        """Whether anything has changed since the base was made."""
        return len(self.update.signs) > 0 or self.offset is not None

    @property
    def engine(self) -> EngineName:
        """Engine that holds the system."""
        return "fronts"

    @property
    def converged(self) -> bool:
        """Whether the adjustment of the base converged."""
        return self.base.converged

    @property
    def reason(self) -> str:
        """Why the adjustment of the base ended."""
        return self.base.reason

    def points_anywhere(self) -> list[VaguePoint]:
        """Return the points of the base that its observations do not determine."""
        return vague_points(self.base)

    def with_second_place(self, sentence: str) -> FrontSystem:
        """Return the system of an adjusted network whose solution reports another minimum."""
        base = replace(self.base, second_places=(*self.base.second_places, sentence))
        return FrontSystem.of(base, rows=self.rows, section=self.section)

    def forget(self) -> None:
        """Delete what was computed of the base."""
        forget_normal_equations(self.base)

    @property
    def adjusted_solution(self) -> Solution | None:
        """The batch solution of everything; None: something has changed since there was one."""
        whole = self.section is None and not self.changed and not self.doubt
        return self.base if whole else None

    @property
    def datum_solution(self) -> Solution | None:
        """The solution whose minimal datum holds a free network; None: the datum is given."""
        return self.base if self.is_free else None

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear forms."""
        rest = 0.0 if self.section is None else self.section.vtpv
        found = self.base.vtpv + self.update.vtpv + rest
        return max(found, 0.0)  # a sum of squares, except for the rounding of rows that have left

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        rest = -self.border.n if self.section is None else self.section.redundancy
        return self.base.redundancy + int(self.update.signs.sum()) + rest

    @property
    def n_rows(self) -> int:
        """Number of scalar rows, weighted unknowns among them."""
        rest = 0 if self.section is None else self.section.n_rows
        return self.base.n_observations + int(self.update.signs.sum()) + rest

    # -- cofactors ----------------------------------------------------------------------------

    def cofactors(self, a: Variable, b: Variable) -> Array:
        """Return the joint cofactors of the components of two variables, (i, j)."""
        if not self.covers((a, b)):
            return self._across(a, b)
        parts = [self.columns(*v) for v in dict.fromkeys((a, b))]
        columns = np.concatenate(parts)
        free = np.diag(self.free(columns).astype(float))
        if a != b or a in self.border.unknowns or self.lifted.touched(columns):
            out = self._updated.joint(columns, free)
        else:  # the selected inverse has the blocks of all variables
            out = free @ self._updated.selected(a, columns) @ free
        return out[: len(parts[0]), len(columns) - len(parts[-1]) :]

    def function_cofactors(
        self, touched: Mapping[Variable, Index], a: Array, groups: Sequence[Index]
    ) -> list[Array]:
        """Return the cofactors A Q Aᵀ of groups of functions; see `LinearSystem`."""
        if not (touched and self.covers(touched)):
            return block_by_block(self, touched, a, groups)
        columns = np.concatenate([self.columns(*v)[own] for v, own in touched.items()])
        joint = self._updated.joint(columns, np.where(self.free(columns), a, 0.0))
        return [joint[np.ix_(rows, rows)] for rows in groups]

    @cached_property
    def _updated(self) -> UpdatedCofactors:
        return UpdatedCofactors(self.base, self.lifted, self.update, self.slots, self.expand)

    def _across(self, a: Variable, b: Variable) -> Array:
        """Return the cofactors of two variables of which the section has one at most."""
        if self.covers((a,)):
            return self._across(b, a).T
        section, at = self.section, self.of_rest
        assert section is not None
        outer = self.whole
        k = section.carried(outer.columns(*a))
        if self.covers((b,)):
            f = self.lifted.expand(self.columns(*b), np.eye(len(self.columns(*b))), self.slots)
            return np.asarray(k @ self.update.times(f.at, f.b)[at])
        other = section.carried(outer.columns(*b))
        now = self.update.times(at, np.eye(len(at)))[at] - section.root @ section.root.T
        return np.asarray(outer.cofactors(a, b) + k @ now @ other.T)

    @property
    def of_own(self) -> Index:
        """Coordinates of u: the last ones of the room of slots, (n,)."""
        assert self.section is not None
        return np.asarray(self.lifted.size - 1 - np.arange(self.section.n_own))

    @property
    def of_rest(self) -> Index:
        """Coordinates of T and of u, (m + n,)."""
        return np.append(self.lifted.place[self.base.extra.rows[0].columns], self.of_own)

    # -- rows beside the base -----------------------------------------------------------------

    def forms(self, ledger: Ledger, rows: Index) -> LinearForms:
        """Linearise observations between known variables at the present state.

        Raises:
            InputError: names observations with degenerate geometry.
        """
        equations = compile_rows(excerpt(ledger, self, rows, hold=False))
        state = equations.unknowns.start()
        return LinearForms.of(ledger.units(rows), equations, self.columns, self.step_at, state)

    def bordered(
        self, ledger: Ledger, rows: Index, values: Callable[[Unknowns, State], State]
    ) -> tuple[FrontSystem, LinearForms] | None:
        """Return the system with new unknowns of observations, and their linear forms.

        None: an unknown has no value. The rows have yet to determine the new unknowns.

        Args:
            ledger: where the observations are stored.
            rows: the observations.
            values: returns a state of given unknowns with values of the new ones.

        Raises:
            InputError: names observations with degenerate geometry.
        """
        equations = compile_rows(excerpt(ledger, self, rows, hold=False))
        unknowns = equations.unknowns
        state = unknowns.start()
        for kind, given in values(unknowns, state).items():
            names = unknowns[kind].names
            new = [i for i, name in enumerate(names) if not self.known(kind, name)]
            state[kind][new] = given[new]
        if any(np.isnan(x).any() for x in state.values()):
            return None
        border = self.border.with_unknowns(unknowns, state, self.known)
        update = self.update.with_unknowns(border.n - self.border.n)
        out = replace(self, border=border, update=update)
        n_before = self.unknowns.n_columns + len(self.border.place)

        def moved(columns: Index) -> Array:
            movement = np.zeros(len(columns))
            movement[columns < n_before] = self.step_at(columns[columns < n_before])
            return movement

        return out, LinearForms.of(ledger.units(rows), equations, out.columns, moved, state)

    @property
    def unknowns(self) -> Unknowns:
        """Unknowns of the base."""
        return self.base.equations.unknowns
