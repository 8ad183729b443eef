"""The rows of a network in an iSAM2: putting them in, taking them out.

Arrivals between known variables first stay beside the tree (`factorgraph_adj.incremental.recent`)
and go into it together.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from typing import Self

import gtsam
import numpy as np

from ..errors import InputError, Problem
from ..graph.equations import Equations, compile_network, compile_rows
from ..graph.keys import KeyMap
from ..graph.variables import State
from ..models.variables import UNKNOWNS, VariableKind
from ..network.network import DatumChoice, Network
from ..observations import Observation
from ..solve.singular import SingularError
from ..solve.solution import Solution
from ..solve.tree import SMALL, Clique, nested_dissection
from ..types import Array, Index, Mask
from .cliques import cliques_anew, cofactor_times, those_above, variances_of
from .local import known_network, local_network, starting_state
from .open_motions import OpenMotions
from .recent import MOST, Recent
from .register import Register
from .rows import Group, Piece, Rows, Store
from .tree import LinearTree
from .trial import LowRank, Marks, Placed, Trial, gather, rows_of
from .units import Unit
from .verdicts import Judged

SINGULAR = (
    "with it the normal equations are singular to working precision: is its standard deviation, or "
    "its value, in the right unit?"
)
MANY_KEYS = 100
"""Variables beyond which solving for all rows is quicker than the tree's own joint covariance."""
NAMED = 12
"""Observations that a message names."""
PATIENCE = 8
"""Arrivals in a row between known variables after which a system is factorised for the next, where
that takes all variances anew."""
IMPRECISE = 1000
"""Arrivals until it is tried again where that was not precise."""


class _Imprecise(Exception):
    """The factorised system is not precise enough for what arrives."""


@dataclass
class Held:
    """A component that carries the minimal datum of a free network."""

    kind: VariableKind
    """Kind of the variable."""
    number: int
    """Its number."""
    component: int
    """Its component."""
    weight: float
    """√ of what is added to the diagonal of N."""
    slot: int = -1
    """Its factor."""


class Graph:
    """A network in an iSAM2."""

    def __init__(self, network: Network, *, datum: DatumChoice, accuracy: float) -> None:
        """Start with an empty graph.

        Args:
            network: points, photos and so on; its observations are those in the graph.
            datum: given or free.
            accuracy: the promise, relative to standard deviations.
        """
        self.network, self.datum, self.accuracy = network, datum, accuracy
        self.qr = False
        self.settled = True
        self.doubt = ""
        """Why estimates are not within ``accuracy`` of the minimum."""
        self.loose: tuple[tuple[str, str], ...] | None = None
        """What is not determined, where that is why."""
        self.fewer = False
        """Whether something was taken out since a minimum was looked for."""
        self.clear()

    def clear(self) -> None:
        """Empty the graph."""
        self.kept = True
        """Whether estimates are within ``accuracy`` of the minimum."""
        self.register = Register()
        self.store = Store(self.network.frame, self.register)
        self.tree = LinearTree(qr=self.qr)
        self.unflushed: list[Piece] = []
        """Rows that are not in the tree yet."""
        self.recent: Recent | None = None
        """A factorised system to which they are a low-rank part."""
        self.patience = 0
        self.aged = False
        """Whether variances are older than the tree; linearising anew hardly changes them."""
        self.held: list[Held] = []
        self.open_motions: OpenMotions | None = None
        """What no observation of a free network notices."""
        self.size: float | None = None
        """vᵀPv; none where it has not been worked out since the tree changed."""
        self._cliques: tuple[tuple[LinearTree, int], list[Clique]] | None = None
        """Those of `cliques`, and the tree and its update that they are of."""
        self._before: State = {}
        """Where the variables were before the last change."""
        self.priors: dict[tuple[VariableKind, int], list[str]] = {}
        """Ids of the rows that weight a variable's own given values."""

    def copy(self) -> Self:
        """Return an engine of its own; iSAM2 copies its tree in no time."""
        self.flush()
        out = copy(self)
        out.recent, out.unflushed = None, []
        parts = (self.register, self.store, self.held, self.priors)
        own = deepcopy(parts)
        out.register, out.store, out.held, out.priors = own
        out.register.renew()
        out.tree = self.tree.copy()
        return out

    def values_of(
        self, variables: Sequence[tuple[VariableKind, int]]
    ) -> dict[VariableKind, dict[str, list[float]]]:
        """Return x₀ of points and photos, by kind and name."""
        out: dict[VariableKind, dict[str, list[float]]] = {}
        for kind, number in variables:
            if kind in ("point", "pose"):
                table = self.register[kind]
                values = table.given.view[number].tolist()
                out.setdefault(kind, {})[table.names[number]] = values
        return out

    def point_covariance(self, a: str, b: str) -> Array:
        """Return the covariance between two points, (3, 3); zero for held components."""
        table = self.register["point"]
        out = np.zeros((3, 3))
        numbers = [table.number.get(n, -1) for n in (a, b)]
        if min(numbers) < 0:
            return out
        free = [table.free.view[i] for i in numbers]
        if not (free[0].any() and free[1].any()):
            return out
        keys = [KeyMap.of("point", i) for i in dict.fromkeys(numbers)]
        joint = self.tree.joint(keys)
        k = int(free[0].sum())
        block = joint if a == b else joint[:k, k:]
        out[np.ix_(free[0], free[1])] = block
        return out

    @property
    def empty(self) -> bool:
        """Whether nothing is in the graph."""
        return not self.register.keys

    @property
    def redundancy(self) -> int:
        """Redundancy n − u + d."""
        return self.store.n_scalars - self.register.n_places + len(self.held)

    # -- building the tree --------------------------------------------------------------------

    def load(self, equations: Equations, state: State, given: State, constraint: Array) -> None:
        """Make everything anew from equations at a state.

        Args:
            equations: those of ``network``, weights evaluated.
            state: values of all variables.
            given: x₀, what the inner constraints of a free network refer to.
            constraint: what a minimal datum adds to the diagonal of N, (n_columns,).

        Raises:
            InputError: names observations whose geometry has no answer; nothing has changed then.
        """
        before = dict(vars(self))
        try:
            self.clear()
            self.kept = before["kept"]
            numbers = self.register.absorb(equations, state, given)
            piece = self.store.absorb(equations, numbers)
            self.store.linearise(piece)
            for column in np.flatnonzero(constraint).tolist():
                kind, name, _ = equations.unknowns.describe(column)
                table = equations.unknowns[kind]
                i = table.number[name]
                component = column - int(table.offset[i])
                number = int(numbers[kind][i])
                self.held.append(Held(kind, number, component, float(np.sqrt(constraint[column]))))
            if self.held:
                self.open_motions = OpenMotions.of(equations, state)
            self._note_priors(piece)
            self.rebuild()
            self._renew_variances()
        except BaseException:
            vars(self).update(before)
            raise

    def _note_priors(self, piece: Piece) -> None:
        """Note the rows of weighted unknowns: one variable, and no observation of their id."""
        for rows, at in piece.rows:
            if not rows.template.prior and not rows.template.by_axis:
                continue
            for i in at.tolist():
                if not rows.labels[i].startswith("weighted "):
                    continue
                owner = rows.kinds[0], int(rows.index[0].view[i])
                ids = self.priors.setdefault(owner, [])
                if rows.ids[i] not in ids:
                    ids.append(rows.ids[i])

    def rebuild(self) -> None:
        """Build the tree anew from the linear forms, by QR where Cholesky refuses."""
        self.unflushed, self.recent, self.patience = [], None, 0
        self.size = None
        while True:
            tree = LinearTree(qr=self.qr)
            factors, owners = self.store.factors(self.store.everything())
            factors += [self._held_factor(h) for h in self.held]
            try:
                if factors:
                    slots = tree.update(factors, self.register.values(), late=self._late(factors))
                    self.store.number(owners, slots[: len(owners)])
                    for h, slot in zip(self.held, slots[len(owners) :], strict=True):
                        h.slot = slot
                self._follow(tree)
            except (SingularError, RuntimeError) as error:
                if self.qr:
                    raise SingularError(str(error)) from None
                self.qr = True
                continue
            self.tree = tree
            return

    def _follow(self, tree: LinearTree) -> None:
        """Move to the tree's solution.

        Where no minimum was found the state stays: a step from there leads nowhere, and what
        comes next may undo what brought it there.

        Raises:
            SingularError: it has none.
        """
        delta = tree.delta(self.register.keys)
        if not np.isfinite(delta).all():
            raise SingularError("δ is not finite")
        if self.kept:
            self.register.move_to(delta)

    def _late(self, factors: Sequence[gtsam.NonlinearFactor]) -> list[tuple[int, int]]:
        """Return when variables are to be eliminated, in groups.

        Photos and calibrations after points; a large terrestrial network by nested dissection.
        """
        keys = self.register.keys
        if self._has_images():
            return self._after_points()
        if len(keys) <= SMALL:
            return []
        graph = gtsam.GaussianFactorGraph()
        for factor in factors:
            graph.add(factor.factor())  # type: ignore[attr-defined]
        order = nested_dissection(graph)
        return [(order.at(i), i) for i in range(order.size())]

    def _has_images(self) -> bool:
        return self._share_of_images() > 0.0

    def _share_of_images(self) -> float:
        """Return the part of all rows that belong to image points."""
        rows = self.store.kinds.values()
        images = sum(r.n_scalars for r in rows if r.template.kind == "image")
        return images / max(self.store.n_scalars, 1)

    def _after_points(self) -> list[tuple[int, int]]:
        """Return variables of very many observations, to be eliminated after all others."""
        every = ((key, self.register.variable(key)[0]) for key in self.register.keys)
        late = [(key, UNKNOWNS[kind].late) for key, kind in every if UNKNOWNS[kind].late]
        # COLAMD knows as many groups as there are variables: a network may have only two.
        group = {n: i for i, n in enumerate(sorted({n for _, n in late}), start=1)}
        out = [(key, group[n]) for key, n in late]
        return out if len(out) < len(self.register.keys) else []

    def _late_in(self, n: int) -> list[tuple[int, int]]:
        """Return the same for an update that changes n factors, where these are many.

        Without, iSAM2 eliminates what the factors touch last of all it changes: photos before
        points that they see, which joins all of these in one clique.
        """
        return self._after_points() if n > MANY_KEYS and self._has_images() else []

    def _held_factor(self, held: Held) -> gtsam.NonlinearFactor:
        table = self.register[held.kind]
        free = np.flatnonzero(table.free.view[held.number])
        a = np.zeros((1, len(free)))
        a[0, int(np.searchsorted(free, held.component))] = held.weight
        key = KeyMap.of(held.kind, held.number)
        unit = gtsam.noiseModel.Unit.Create(1)
        # Held where it is now: moving along a defect of datum changes no observation.
        b = a @ table.delta.view[held.number][free]
        return gtsam.LinearContainerFactor(gtsam.JacobianFactor(key, a, b, unit))

    def _update(
        self,
        factors: Sequence[gtsam.NonlinearFactor],
        owners: list[tuple[object, int]],
        values: gtsam.Values,
        remove: Sequence[int],
    ) -> None:
        """Change the tree, and move to its solution; build it anew where that fails."""
        self.recent, self.patience, self.size = None, min(self.patience, 0), None
        try:
            late = self._late_in(len(factors) + len(remove))
            slots = self.tree.update(factors, values, remove, late)
            self.store.number(owners, slots)
            self._follow(self._tree)
        except (SingularError, RuntimeError):
            self.rebuild()

    # -- putting in and taking back -----------------------------------------------------------

    def try_out(self, units: Sequence[Unit]) -> Trial:
        """Put units between known variables in, to be judged, and kept or taken back.

        Raises:
            InputError: as `put_in`.
        """
        recent = self._recent_of(sum(u.n_scalars for u in units))
        placed = self._placed(units, (), recent, judge=True)
        assert isinstance(placed, Trial)
        return placed

    def put_in(self, units: Sequence[Unit], found: Sequence[Solution]) -> Placed:
        """Put units into the tree; they may be taken back.

        Args:
            units: what they depend on is known, or in ``found``.
            found: where the variables are that enter with them.

        Raises:
            InputError: names observations whose geometry has no answer, or whose weights are so
                different from others that double precision cannot hold both; nothing has changed
                then.
        """
        return self._placed(units, found, None, judge=False)

    def _placed(
        self,
        units: Sequence[Unit],
        found: Sequence[Solution],
        recent: Recent | None,
        *,
        judge: bool,
    ) -> Placed:
        local = local_network(self.network, self.register, units)
        equations = compile_rows(local)
        state, given = starting_state(equations, self.register, found)
        equations = equations.weighted_at(state)
        if recent is None:
            self.flush()
        marks = self.register.marks(), self.store.marks()
        known = {k: t.known.view.copy() for k, t in self.register.tables.items()}
        try:
            try:
                return self._place(units, equations, state, given, recent, marks, judge=judge)
            except _Imprecise:
                self._forget(marks, known)
                self.flush()
                return self._place(units, equations, state, given, None, marks, judge=judge)
        except BaseException as error:
            self._forget(marks, known)
            self.aged = True
            self.rebuild()
            if isinstance(error, SingularError | RuntimeError | np.linalg.LinAlgError):
                raise InputError([Problem(SINGULAR, o.label()) for o in _some(units)]) from None
            raise

    def _place(
        self,
        units: Sequence[Unit],
        equations: Equations,
        state: State,
        given: State,
        recent: Recent | None,
        marks: Marks,
        *,
        judge: bool,
    ) -> Placed:
        n_keys = len(self.register.keys)
        numbers = self.register.absorb(equations, state, given)
        piece = self.store.absorb(equations, numbers)
        self.store.linearise(piece)
        self._remember()
        fresh = self.register.keys[n_keys:]
        if recent is not None and not fresh:
            return self._beside(recent, units, piece, marks)
        self.recent, self.size, self.aged = None, None, True
        if fresh:
            self.patience = min(self.patience, 0)
        factors, owners = self.store.factors(piece)
        late = self._late_in(len(factors))
        try:
            slots = self.tree.update(factors, self.register.values(fresh), late=late)
            self.store.number(owners, slots)
            self._follow(self._tree)
        except (SingularError, RuntimeError):
            self.rebuild()  # by QR
        self._note_priors(piece)
        entered = [self.register.variable(k) for k in fresh]
        placed = Placed(tuple(units), piece, marks, entered)
        return self._judged(placed, arrived=not late) if judge else placed

    def _remember(self) -> None:
        self._before = {k: v.copy() for k, v in self.register.state.items()}

    def _forget(
        self,
        marks: Marks,
        known: dict[VariableKind, Mask],
    ) -> None:
        back = []
        for kind, mask in known.items():
            now = self.register[kind].known.view[: len(mask)]
            back += [(kind, int(i)) for i in np.flatnonzero(now & ~mask)]
        self.store.forget(marks[1])
        self._forget_variables(marks, back)

    def _forget_variables(self, marks: Marks, back: Sequence[tuple[VariableKind, int]]) -> None:
        keys = list(self.register.keys)
        self.register.forget(marks[0], back)
        if self.register.keys != keys:
            self.recent = None  # its places are others now

    def trial_of(self, units: Sequence[Unit]) -> Trial:
        """Return units that are in the graph as a trial, to be judged."""
        trial = self.trial_of_ids([i for u in units for i in u.ids])
        rows = rows_of(units, trial.system)
        return replace(trial, units=tuple(units), rows=rows)

    def trial_of_ids(self, ids: Sequence[str]) -> Trial:
        """Return rows of the graph by their ids, correlated groups as a whole."""
        chosen: dict[int, tuple[Rows, list[int]]] = {}
        for ident in ids:
            for rows, i in self.store.places[ident]:
                chosen.setdefault(id(rows), (rows, []))[1].append(i)
        pieces = [(rows, np.array(at, dtype=np.intp)) for rows, at in chosen.values()]
        inside = np.concatenate([rows.group.view[at] for rows, at in pieces])
        piece = Piece(pieces, np.unique(inside[inside >= 0]).tolist())
        return self._judged(Placed((), piece, (self.register.marks(), self.store.marks()), []))

    def take_back(self, trial: Placed) -> None:
        """Make everything as it was before `put_in`, or `try_out`."""
        if not trial.marks[1][0]:
            self.clear()
            return
        slots = [] if trial.low_rank is not None else slots_of(trial.piece, self.store)
        self.store.forget(trial.marks[1])
        entered = [(k, n) for k, n in trial.entered if n < trial.marks[0][k]]
        self._forget_variables(trial.marks, entered)
        if trial.low_rank is None:
            self._update([], [], gtsam.Values(), slots)
            self._renew_variances()

    def _judged(self, placed: Placed, *, arrived: bool = False) -> Trial:
        """Return rows that are in the tree as a trial."""
        units, piece = placed.units, placed.piece
        system = gather(self.store, piece)
        if len(system.keys) > MANY_KEYS:
            part, columns = those_above(self.cliques(), system.places)
            place = np.full(self.register.n_places, -1, dtype=np.intp)
            place[columns] = np.arange(len(columns))
            own = place[system.places]
            y = np.zeros((len(columns), len(system.v)))
            y[own] = system.a.T
            spread = cofactor_times(part, y)[own]
            variances = variances_of(part, len(columns))[own]
        else:
            joint = self.tree.joint(system.keys, arrived=arrived)
            variances = np.array(np.diag(joint))
            spread = joint @ system.a.T
        self.register.note_variances(system.keys, variances)
        m = np.eye(len(system.v)) - system.a @ spread
        # Where the state has stayed, v are not yet the residuals.
        judged = Judged(m, system.v if self.kept else m @ system.v)
        rows = rows_of(units, system) if units else system.rows
        figures = rows, system, spread, variances, judged
        return Trial(units, piece, placed.marks, placed.entered, *figures)

    def _beside(self, recent: Recent, units: Sequence[Unit], piece: Piece, marks: Marks) -> Trial:
        """Return rows between known variables as a trial beside the tree."""
        system = gather(self.store, piece)
        b = np.zeros((self.register.n_places, len(system.v)))
        b[system.places] = system.a.T
        y = recent.times(b)
        if not recent.precise or not np.isfinite(y).all():
            self.recent, self.patience = None, -IMPRECISE
            raise _Imprecise
        own = y[system.places]
        d = np.eye(len(system.v)) + system.a @ own
        m = np.linalg.inv(d)
        spread = own @ m
        before = self.register.variances(system.keys)
        variances = before - np.einsum("ij,ij->i", spread, own)
        judged = Judged(0.5 * (m + m.T), m @ system.v)
        low = LowRank(y, d, system.v)
        rows = rows_of(units, system)
        figures = rows, system, spread, variances, judged
        return Trial(tuple(units), piece, marks, [], *figures, low_rank=low)

    def _recent_of(self, rows: int) -> Recent | None:
        """Return the factorised system, made when several arrivals in a row could use it."""
        if not self.kept:  # its step is one from the minimum
            return None
        if self.recent is not None and self.recent.full(rows):
            self.flush()
            self.recent = None
        if self.recent is None and rows <= MOST // 2 and not self.empty:
            self.patience += 1
            if self.patience > PATIENCE or not self.aged:
                self.factorise()
        return None if self.recent is None or self.recent.full(rows) else self.recent

    def _renew_variances(self) -> None:
        """Work out all variances: without some rows they are larger."""
        if self.register.keys:
            self.register.set_variances(variances_of(self.cliques(), self.register.n_places))
        self.aged = False

    def cliques(self) -> list[Clique]:
        """Return the cliques of all factors, eliminated once for each state of the tree.

        Raises:
            SingularError: a pivot vanished.
        """
        tree = self.tree
        of = tree, tree.updates
        if self._cliques is None or self._cliques[0] != of:
            columns = {k: self.register.places(k) for k in self.register.keys}
            self._cliques = of, cliques_anew(tree, columns)
        return self._cliques[1]

    def compare_all(self) -> None:
        """Compare all rows with their models at the present state.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        every = {k: np.ones(t.n, dtype=bool) for k, t in self.register.tables.items() if t.n}
        self.store.compare(every, self.network)

    def factorise(self) -> bool:
        """Factorise the system for the next arrivals; return whether that is precise enough."""
        if self.patience < 0:
            return False
        if self.aged:
            self._renew_variances()
        held = [
            (int(self.register[h.kind].place.view[h.number, h.component]), h.weight)
            for h in self.held
        ]
        try:
            self.compare_all()
            self.register.start_from_here()
            self.recent = Recent(self.store, held, self._order() if self._has_images() else None)
            if self.recent.precise:
                return True
        except (InputError, RuntimeError):
            pass
        self.recent, self.patience = None, -IMPRECISE
        return False

    def _order(self) -> Index:
        """Return all places in an order of elimination with little fill."""
        order = self.tree.ordering()
        return np.concatenate([self.register.places(order.at(i)) for i in range(order.size())])

    def keep(self, trial: Trial, gone: Sequence[Unit]) -> None:
        """Keep a trial but for some units; every variable of it was known before."""
        ids = [i for u in gone for i in u.ids]
        low = trial.low_rank
        if low is None:
            if ids:
                self.drop(ids, ())
            return
        self._remember()
        nothing = np.zeros(0, dtype=np.intp)
        left_out = np.concatenate([nothing, *(trial.rows[u.ids[0]] for u in gone)])
        stay = np.setdiff1d(np.arange(len(low.innovation)), left_out)
        self.store.drop(ids)
        if not len(stay):
            return
        assert self.recent is not None
        y, d = low.y[:, stay], low.d[np.ix_(stay, stay)]
        weighted = np.linalg.solve(d, low.innovation[stay])
        if self.size is not None:
            self.size += float(low.innovation[stay] @ weighted)
        step = -y @ weighted
        self.register.lose_variances(self.recent.absorb(y, d))
        self.register.move_to(self.register.vector() + step)
        self.unflushed.append(trial.piece)

    def flush(self) -> None:
        """Put what arrived beside the tree into it."""
        if not self.unflushed:
            return
        rows: list[tuple[Rows, Index]] = []
        groups: list[int] = []
        for piece in self.unflushed:
            rows += [(r, alive) for r, at in piece.rows if len(alive := at[r.alive.view[at]])]
            groups += [g for g in piece.groups if g in self.store.groups]
        self.unflushed = []
        factors, owners = self.store.factors(Piece(rows, groups))
        try:
            late = self._late_in(len(factors))
            slots = self._tree.update(factors, gtsam.Values(), late=late)
            self.store.number(owners, slots)
            self._follow(self._tree)
        except (SingularError, RuntimeError):
            self.rebuild()

    @property
    def tree(self) -> LinearTree:
        """The tree, with everything in it."""
        self.flush()
        return self._tree

    @tree.setter
    def tree(self, tree: LinearTree) -> None:
        self._tree = tree

    def drop(self, ids: Sequence[str], leaving: Sequence[tuple[VariableKind, int]]) -> None:
        """Take observations out of the tree, and variables that lose all theirs with them.

        The caller has made sure that everything else stays determined.
        """
        self._remember()
        self.fewer = True
        alone = [v for v in self._left_alone(ids) if v not in leaving]
        weights = [i for v in alone for i in self.priors.get(v, ())]
        slots = self.store.drop([*ids, *weights])
        self.register.leave([*leaving, *alone])
        self._update([], [], gtsam.Values(), slots)
        self.store.compact()
        before = {k: t.variance.view.copy() for k, t in self.register.tables.items() if t.n}
        self._renew_variances()
        self.register.doubt_grown(before)

    def _left_alone(self, ids: Sequence[str]) -> list[tuple[VariableKind, int]]:
        """Return variables that nothing but their own weights touches without some rows."""
        places = [place for ident in ids for place in self.store.places.get(ident, ())]
        touched = {
            (kind, int(index.view[i]))
            for rows, i in places
            for kind, index in zip(rows.kinds, rows.index, strict=True)
        }
        out = []
        for kind, number in touched:
            if not (self.register[kind].place.view[number] >= 0).any():
                continue
            going = {*ids, *self.priors.get((kind, number), ())}
            if all(
                rows.ids[i] in going
                for rows in self.store.kinds.values()
                for k, index in zip(rows.kinds, rows.index, strict=True)
                if k == kind
                for i in np.flatnonzero((index.view == number) & rows.alive.view).tolist()
            ):
                out.append((kind, number))
        return sorted(out)

    # -- the whole network --------------------------------------------------------------------

    def whole(self) -> tuple[Equations, State, State]:
        """Return the equations of the network, its state, and x₀."""
        equations = compile_network(known_network(self.network, self.register))
        state, given = equations.unknowns.start(), equations.unknowns.start()
        for kind, theirs in equations.unknowns.tables.items():
            table = self.register[kind]
            mine = [table.number.get(n, -1) for n in theirs.names]
            at = np.array(mine, dtype=np.intp)
            on = np.flatnonzero(at >= 0)
            on = on[table.known.view[at[on]]] if len(on) else on
            width = min(state[kind].shape[1], table.value.view.shape[1])
            state[kind][on, :width] = table.value.view[at[on], :width]
            given[kind][on, :width] = table.given.view[at[on], :width]
        return equations.weighted_at(state), state, given

    def constraint(self, equations: Equations) -> Array:
        """Return what the minimal datum adds to the diagonal of N, (n_columns,)."""
        out = np.zeros(equations.unknowns.n_columns)
        for h in self.held:
            name = self.register[h.kind].names[h.number]
            table = equations.unknowns[h.kind]
            if name not in table.number:  # it has been left out
                continue
            out[int(table.offset[table.number[name]]) + h.component] = h.weight**2
        return out


def _some(units: Sequence[Unit]) -> list[Observation]:
    return [o for u in units for o in u.observations][:NAMED]


def slots_of(piece: Piece, store: Store) -> list[int]:
    """Return the slots of the factors of some rows."""
    out: list[int] = []
    for rows, at in piece.rows:
        slots = rows.slot.view[at]
        out += slots[slots >= 0].tolist()
    for number in piece.groups:
        group: Group = store.groups[number]
        if group.slot >= 0:
            out.append(group.slot)
    return out
