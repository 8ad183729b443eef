"""Keeping the promise of an incremental adjustment, and going to rest.

The promise is `accuracy`: an estimate is never further from that of a batch adjustment of the
same observations than this part of its own standard deviation, and neither is the standard
deviation. `Engine.keep_the_promise` linearises anew what does not hold any more, see
`factorgraph_adj.incremental.rows`; `Engine.settle` goes to rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

import gtsam
import numpy as np

from ..errors import AdjustmentError, DatumError, InputError
from ..graph.equations import Equations, compile_network
from ..graph.variables import State
from ..models.variables import VariableKind
from ..network.network import Network
from ..solve.batch import OFF_DATUM, adjust
from ..solve.singular import SingularError
from ..solve.solution import Solution
from ..solve.start import Start
from ..solve.stopping import STOPPING
from ..types import Array, Index
from .anywhere import anywhere
from .local import filtered, starting_state
from .network_graph import Graph, slots_of
from .rows import Piece, Rows
from .trial import Placed
from .units import Unit, Variable, components
from .view import onto_datum

AT_REST = 1e-7
"""Bound of the last step relative to σ at which the network has settled."""
CLOSE = 1e-3
"""Step relative to σ below which the next ones converge for sure."""
ON_DATUM = 1e-7
"""Motion relative to the extent of the points, second powers of which are nothing."""
AT_DATUM = 1e-11
"""The same, where a settled network is on its inner constraints."""
MOST_ROUNDS = 12
"""Rounds of relinearisation after an arrival."""
MOST_PARTS = 5
"""Rounds of that in which only what does not hold is linearised anew."""
MOST_STEPS = 15
"""Steps of `Engine.settle` before the batch adjustment takes over."""
MOST_ITERATIONS = 200
"""Of the batch adjustment that takes over."""
FEW_ITERATIONS = 20
"""Of one where there was no minimum before, and nothing was taken out since, at least;"""
WORK = 60_000
"""its iterations times unknowns, which small networks may take more of."""
SHARE = 0.2
"""Part of the promise that a Gauss-Newton step may be, where σ̂0 is 1 or less. Where residuals are
large the minimum is further away than such a step, as second partials count too: there it is this
divided by σ̂0."""
TURNED_SHARE = 0.2
"""Part of the promise that √Σρ² may be, from which the error of every standard deviation follows: ρ
counts the unknowns of a row as uncorrelated, and may be too small by √8."""
MANY_TURNED = 0.5
"""The same where there are many rows: those that determine an unknown change with all signs."""
CORRELATED = 5.0
"""√(gᵀQg) relative to that of unknowns without correlation, where Q is not at hand."""
AGED = 0.05
"""√Σρ² from which on variances are worked out anew before they are needed,"""
MOST_WHOLE = 2
"""Rounds that linearise everything anew, where there are many unknowns, before the batch adjustment
takes over: its iterations build no tree."""
MOST_OF_IMAGES = 2, 1
"""Both where there are many unknowns and mostly image points: the batch adjustment eliminates all
points at once there, and is sooner at rest. Where much is missed of all rows, it takes over at
once."""
FEW = 300
"""and unknowns up to which they are at once: that takes no time."""
MANY = 200
"""Rows that are many."""
MOSTLY = 0.5
"""Part of the rows."""
RUNAWAY = 1e8
"""Misfit of the linear forms, Σ|Δv|² + Σρ²|v|², from which on their steps lead astray."""
ROUGH = 1.0
"""The same from which on they are linearised anew in any case."""
QUIET = 0.01
"""Part of what is missed that may stay where it is."""
TURNED = 1e-3
"""Rotation, radians, from which on the axes of a photo are not those of its chart any more."""
LARGE = 0.25
"""Part of all rows from which on all of them are linearised anew together."""
SPARE = 20_000
"""Empty slots of iSAM2 beyond twice those in use, at which it is built anew."""


class Engine(Graph):
    """A network in an iSAM2 that stays within ``accuracy`` of its minimum."""

    # -- keeping the promise ------------------------------------------------------------------

    def keep_the_promise(self) -> None:
        """Linearise anew what no longer holds; where that runs away, adjust in batch.

        Where that has no answer either, `kept` is false, and `doubt` says why.
        """
        if self.empty:
            self.kept = True
            return
        was = self.kept
        if was:
            try:
                self.kept = self._relinearise()
            except (InputError, SingularError, RuntimeError, np.linalg.LinAlgError):
                self.kept = False
            if self.kept:
                return
        for kind, values in self._before.items():
            self.register[kind].value.view[:] = values
        # Where there was no minimum before, only less can help.
        few = min(max(FEW_ITERATIONS, WORK // self.register.n_places), MOST_ITERATIONS)
        iterations = MOST_ITERATIONS if was or self.fewer else few
        lost, self.fewer = self.fewer and not was, False
        self._adjust_or_stay(*self.whole(), iterations, anew=lost)

    def _adjust_or_stay(
        self, equations: Equations, state: State, given: State, iterations: int, *, anew: bool
    ) -> None:
        """Let the batch adjustment find the minimum; where it finds none, stay at the state.

        Args:
            equations: of the network.
            state: where the adjustment starts.
            given: x₀.
            iterations: how many it may take.
            anew: whether it is to start from new approximate values where that fails.
        """
        constraint = self.constraint(equations)
        start = Start(equations.unknowns, state, given)
        for begin in (start, None) if anew else (start,):
            try:
                found = self._adjust(equations.network, begin, iterations)
            except AdjustmentError as error:
                self.doubt = f"no step leads to a minimum: {error}"
                # Not the error itself: its traceback would keep everything alive.
                self.loose = tuple(error.unknowns) if isinstance(error, DatumError) else None
            else:
                if self.kept:
                    self.loose = None
                    return
                vague = tuple(("point", p.name) for p in anywhere(found))
                self.loose = found.drifting or vague or None
        self.kept = self.settled = False
        with suppress(AdjustmentError, RuntimeError, np.linalg.LinAlgError):
            self.load(equations, state, given, constraint)

    def go_on_without(self, variables: Iterable[Variable]) -> None:
        """Let the batch adjustment find the minimum where some variables are left out.

        Args:
            variables: their observations have been taken out of `network`.
        """
        self.register.leave([(k, self.register[k].number[name]) for k, name in variables])
        self._adjust_or_stay(*self.whole(), MOST_ITERATIONS, anew=False)

    def _relinearise(self) -> bool:
        """Linearise anew what no longer holds; return whether the promise is kept."""
        if self.recent is not None and self.recent.holds(self.register, *self._bounds()):
            self.settled = False
            return True
        last = np.inf
        whole = 0
        many = self.register.n_places >= FEW
        quick = many and self._share_of_images() > MOSTLY
        most_parts, most_whole = MOST_OF_IMAGES if quick else (MOST_PARTS, MOST_WHOLE)
        for round_ in range(MOST_ROUNDS):
            step, bound = self._bounds()
            moved = self.register.moved(step / SHARE)
            if moved:
                self.settled = False
                self.store.compare(moved, self.network)
            kinds = [r for r in self.store.kinds.values() if r.n]
            off = [np.where(r.alive.view, r.off.view, 0.0) for r in kinds]
            turned = [np.where(r.alive.view, r.turned.view, 0.0) for r in kinds]
            total = sum(float(o.sum()) for o in off)
            turned_away = self.register.turned(TURNED)
            if total == 0.0 and not turned_away:
                return True
            bent = self._bent(turned, bound)
            far = self._far(step, total)
            if not bent and not far and not turned_away:
                return True
            if not total < RUNAWAY or (total > last and total > ROUGH):
                return False
            last = total
            piece = self._doubtful(kinds, off, turned, turned_away, far=far)
            rough = total > ROUGH or sum(float(t @ t) for t in turned) > AGED**2
            self.aged = self.aged or rough
            if piece is None or round_ >= most_parts:
                whole += 1
                if many and (whole > most_whole or (quick and total > ROUGH)):
                    return False
                self.relinearise_all()
                if not many:
                    self._renew_variances()
                continue
            self.flush()
            remove = slots_of(piece, self.store)
            self.register.recentre_turned(turned_away)
            self.store.reweigh(piece, self.network)
            self.store.linearise(piece)
            for rows, at in piece.rows:
                for kind, index in zip(rows.kinds, rows.index, strict=True):
                    self.register.line_up(kind, index.view[at])
            factors, owners = self.store.factors(piece)
            self._update(factors, owners, gtsam.Values(), remove)
            if self.tree.slots > 2 * self.store.n_scalars + SPARE:
                self.store.compact()
                self.rebuild()
            if not many:
                self._renew_variances()
        return False

    def _bounds(self) -> tuple[float, float]:
        """Return the bounds of the step that is left, and of √Σρ²."""
        if self.size is None:
            self.size = self.store.vtpv()
        r = self.redundancy
        sigma0 = float(np.sqrt(self.size / r)) if r > 0 else 1.0
        turned = TURNED_SHARE if self.store.n_scalars < MANY else MANY_TURNED
        return SHARE * self.accuracy / max(1.0, sigma0), turned * self.accuracy

    @staticmethod
    def _bent(turned: list[Array], bound: float) -> bool:
        """Return whether standard deviations may be wrong by more than a bound.

        They are not if √Σρ² is within it; nor, where there are many rows, if every ρ is within
        the stricter bound of few.
        """
        if sum(float(t @ t) for t in turned) <= bound**2:
            return False
        few = TURNED_SHARE / MANY_TURNED * bound
        return sum(map(len, turned)) < MANY or max(float(t.max()) for t in turned) > few

    def _far(self, step: float, total: float) -> bool:
        """Return whether the step that is left may be more than ``step``, relative to σ.

        What it would be without correlations is a rough guess. Where that is more, the system is
        factorised to know; but not where so much is missed that linearising anew pays in any case.

        Args:
            step: the bound.
            total: misfit of the linear forms, as that of `ROUGH`.
        """
        gradient = self.store.gradient()
        if self.recent is None:
            alone = gradient**2 @ self.register.all_variances()
            if CORRELATED * float(np.sqrt(alone)) <= step:
                return False
            if total > ROUGH or not self.factorise():
                return True
        assert self.recent is not None
        return self.recent.bound(gradient) > step

    def linearise_here(self) -> None:
        """Linearise everything at the present state, so that nothing is left to do but rounding."""
        for _ in range(MOST_STEPS):
            self.relinearise_all()
            if self._step() < CLOSE:
                return

    def relinearise_all(self) -> None:
        """Linearise everything at the present state, and build the tree anew."""
        everything = self.store.everything()
        for rows, at in everything.rows:
            self.store.evaluate(rows, at)  # or nothing has changed
        self.register.recentre()
        self.store.reweigh(everything, self.network)
        self.store.linearise(everything)
        self.rebuild()

    @staticmethod
    def _doubtful(
        kinds: list[Rows],
        off: list[Array],
        turned: list[Array],
        turned_away: Mapping[VariableKind, Index],
        *,
        far: bool,
    ) -> Piece | None:
        """Return the rows to linearise anew.

        Where the step that is left is too ``far``, all but a hundredth of what is missed;
        otherwise those whose partials have changed. None where those are so many that all may
        as well be.
        """
        every = np.concatenate([o + t**2 for o, t in zip(off, turned, strict=True)])
        order = np.sort(every)
        quiet = int(np.searchsorted(np.cumsum(order), QUIET * float(order.sum())))
        threshold = order[min(quiet, len(order) - 1)] if far else np.inf
        much = 0.25 * max((float(t.max()) for t in turned if len(t)), default=0.0)
        chosen = [
            ((o + t**2 >= threshold) | (t >= much)) & (o + t**2 > 0) & r.alive.view
            for r, o, t in zip(kinds, off, turned, strict=True)
        ]
        for r, c in zip(kinds, chosen, strict=True):
            for kind, index in zip(r.kinds, r.index, strict=True):
                if kind in turned_away:
                    c |= np.isin(index.view, turned_away[kind]) & r.alive.view
        inside = [r.group.view[c] for r, c in zip(kinds, chosen, strict=True)]
        groups = np.unique(np.concatenate(inside))
        groups = groups[groups >= 0]
        rows = []
        for r, c in zip(kinds, chosen, strict=True):
            at = np.flatnonzero(c | (np.isin(r.group.view, groups) & r.alive.view))
            if len(at):
                rows.append((r, at))
        n = sum(len(at) for _, at in rows)
        if n > LARGE * len(every) and n > 100:
            return None
        return Piece(rows, groups.tolist())

    def settle(self) -> None:
        """Go to rest: Gauss-Newton steps until no unknown moves by 1e-7 of its σ.

        Where there is no minimum, `kept` is false, and `doubt` says why.
        """
        last = np.inf
        begun = equations, state, given = self.whole()
        try:
            for step in range(MOST_STEPS if self.kept else 0):
                moved = np.inf if self.held else 0.0
                if self.held and last < CLOSE:
                    moved, state = onto_datum(equations, state, given)
                self.load(equations, state, given, self.constraint(equations))
                bound = self._step()
                if bound < AT_REST and step and moved < AT_DATUM:
                    # Partials before a step that small may still not be those after it.
                    self.compare_all()
                    if self.store.turned() < AT_REST**2 or bound > STOPPING.shrinking * last:
                        self.settled = self.kept = True
                        return
                if not np.isfinite(bound) or (bound > 2 * last and bound > CLOSE):
                    break
                last = bound
                equations, state, given = self.whole()
        except (InputError, SingularError, RuntimeError, np.linalg.LinAlgError):
            pass
        self._adjust_or_stay(*begun, MOST_ITERATIONS, anew=True)

    def begin_anew_with(self, units: Sequence[Unit], found: Sequence[Solution]) -> None:
        """Let the batch adjustment find the solution and its datum, of all and some new units.

        Args:
            units: units whose variables are known, or in ``found``.
            found: where those are that enter with them.
        """
        new = {v for u in units for v in u.variables}

        def stays(kind: VariableKind, name: str) -> bool:
            known = self.register.known(kind, name) or (kind, name) in new
            return known or not components(self.network, (kind, name))[0]

        equations = compile_network(filtered(self.network, stays))
        state, given = starting_state(equations, self.register, found)
        self._adjust(equations.network, Start(equations.unknowns, state, given))

    def _adjust(
        self, network: Network, start: Solution | Start | None, iterations: int = MOST_ITERATIONS
    ) -> Solution:
        solution = adjust(
            network, datum=self.datum, start=start, tolerance=AT_REST, max_iterations=iterations
        )
        self.hold(solution)
        self.settled = solution.converged
        return solution

    def hold(self, solution: Solution, doubt: str = "") -> None:
        """Make everything anew from a batch adjustment.

        Args:
            solution: of `network`.
            doubt: why it is not at rest, where that is not its own reason.
        """
        # Where a free network lies changes no observation.
        was, self.kept = self.kept, solution.converged or solution.reason == OFF_DATUM
        try:
            self.load(solution.equations, solution.state, solution.start, solution.constraint)
        except BaseException:
            self.kept = was
            raise
        self.settled, self.doubt = False, doubt or solution.reason

    def to_datum(self) -> None:
        """Move a free network to its inner constraints, charts and all.

        Verticals and orientations follow such a motion only to first order; the next step does
        the rest. Where that leads nowhere it stays where it was, and `kept` is false.
        """
        if not self.held:
            return
        begun = self.whole()
        arrived = False
        try:
            for _ in range(MOST_STEPS):
                equations, state, given = self.whole()
                far, moved = onto_datum(equations, state, given)
                if far < ON_DATUM:
                    arrived = True
                    return
                self.load(equations, moved, given, self.constraint(equations))
            self.kept, self.settled, self.doubt = False, False, OFF_DATUM
        finally:
            if not arrived:
                equations, state, given = begun
                self.load(equations, state, given, self.constraint(equations))

    def _step(self) -> float:
        """Return √(δᵀ N δ) of the step from the charts' origins: its bound relative to σ."""
        total = 0.0
        piece = self.store.everything()
        for rows, at in piece.rows:
            step = self.store._product(rows, at)
            total += float(np.sum(step[rows.group.view[at] < 0] ** 2))
        for number in piece.groups:
            group = self.store.groups[number]
            v = np.zeros(len(group.whitener))
            for (rows, at), order in zip(group.members, group.order, strict=True):
                v[order] = self.store._product(rows, at)
            total += float(np.sum((group.whitener @ v) ** 2))
        return float(np.sqrt(total))

    # -- the datum ----------------------------------------------------------------------------

    def new_to_datum(self, trial: Placed) -> bool:
        """Return whether a trial notices what the minimal datum of a free network holds."""
        return self.open_motions is not None and self.open_motions.noticed(
            self.network, self.register, trial.units
        )
