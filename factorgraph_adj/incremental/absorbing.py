"""How observations get into the graph of an incremental adjustment, and out of it again.

An arrival between known variables is put in, judged, recorded and kept; nothing else changes.
Whatever lets something enter that waited, or makes something wait again, works on a copy's
safety: after an error everything is as it was.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

from ..errors import AdjustmentError
from ..models.variables import VariableKind
from ..network.network import Network
from ..observations import ImagePoint
from ..solve.batch import adjust
from ..solve.singular import SingularError
from ..solve.solution import Solution
from . import records
from .anywhere import anywhere
from .book import Book
from .engine import Engine
from .entering import determined, find, firm
from .journal import Journal
from .judging import Decision, decide, verdicts, waiting
from .local import known_network
from .retries import around
from .taking_out import touching, what_loosens
from .trial import Trial, parts
from .units import Unit, Variable, pending
from .verdicts import Outcome, Policy, Verdict
from .view import solution_of

MOST_JUDGED = 5
"""Times that what enters together is judged, each time without what did not fit."""
TOO_WEAK = "is determined too weakly yet: no solution was reached with it"
NO_SOLUTION = "no solution is reached with it: is it near to where its kind has no answer?"
OPEN = (
    "it fixes a motion that the datum of the free network left open, and other parts of the "
    "network need such observations too"
)
PARALLEL = "its rays are parallel by now: there is no minimum at a finite distance"
CONTRADICT = "its observations contradict each other, and nothing tells yet which of them is wrong"


class _LosesDatum(AdjustmentError):
    """With what enters, parts of a free network are not determined any more."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """What an arrival, or a change, came to."""

    verdicts: tuple[Verdict, ...] = ()
    """Of every observation given, then of those that entered by themselves."""
    waits: tuple[str, ...] = ()
    """Ids of observations that wait again: something is not determined any more."""

    @property
    def points(self) -> tuple[str, ...]:
        """Points of the accepted observations."""
        found = (p for v in self.verdicts if v.verdict == "accepted" for p in v.points)
        return tuple(dict.fromkeys(found))


class Absorbing:
    """A book of what has arrived, and the graph of what counts."""

    policy: Policy
    """What becomes of observations beyond the critical value."""
    alpha: float
    """Probability of a false alarm of one test."""
    _book: Book
    _engine: Engine
    _journal: Journal | None
    _solution: Solution | None
    _spared: set[str]
    """Keys of waiting units that the last search left out."""
    _depth: int
    _starting_over: bool
    _most_split: float
    """Units that reached no solution together, while they are tried in parts; else infinite."""
    _was: Solution | None
    """Where everything was, while it is found out anew what is determined; else none."""

    def _take_over(self, network: Network) -> None:
        self._book.network = self._engine.network = network

    def _absorb(
        self, units: Sequence[Unit], *, test: bool, entry: dict[str, Any] | None = None
    ) -> Arrival:
        """Put in what is determined of units and of what waits; test, record, keep.

        Nothing has changed after an error.
        """
        engine = self._engine
        policy = self.policy if test else "accept"
        ready, late = self._divided(units)
        begins = engine.datum == "free" and engine.empty
        if begins:
            ready, late = [], list(units)
        found, solutions, lacks = self._find([*late, *self._weak_ones()], begins=begins)
        if not found:
            trial = engine.try_out(ready) if ready else None
            if trial is None or not engine.new_to_datum(trial):
                return self._settle_hot(units, ready, trial, lacks, policy, entry)
            # It may notice what the datum has left open.
            engine.take_back(trial)
        with self._all_or_nothing(entry) as saved:
            return self._enter(units, ready, found, solutions, lacks, policy, saved)

    def _weak_ones(self) -> list[Unit]:
        """Return what was too weak to enter, where much more has arrived since."""
        pool, retries = self._book.pool, self._book.retries
        return [pool[k] for k in retries.due(self._arrived())] if retries.weak else []

    def _arrived(self) -> int:
        return self._engine.store.n_scalars + self._book.n_rows_waiting

    def _divided(self, units: Sequence[Unit]) -> tuple[list[Unit], list[Unit]]:
        """Return units whose variables are all known, and the others."""
        register = self._engine.register
        ready: list[Unit] = []
        late: list[Unit] = []
        for unit in units:
            (late if pending(register, unit) else ready).append(unit)
        return ready, late

    def _find(
        self, late: Sequence[Unit], *, begins: bool
    ) -> tuple[list[Unit], list[Solution], dict[Variable, str]]:
        """Return what can enter of new and waiting units, where it is, and what the rest lacks."""
        book, register = self._book, self._engine.register
        found: list[Unit] = []
        solutions: list[Solution] = []
        lacks: dict[Variable, str] = {}
        retries = book.retries
        self._spared = set()
        # A new ray may give a point that had been let go its place.
        touched = {v for u in late for v in pending(register, u)}
        without = retries.weak.keys() - retries.let_go_of(book.waiting_for(touched))
        for component in book.joined(late, register, without=without):
            looked_at: Sequence[Unit] = component
            if not retries.worthwhile(component, book.pool):
                if begins:
                    continue
                new = {u.ids[0] for u in late}
                looked_at = around(register, component, (u for u in component if u.ids[0] in new))
                retries.note_beside(component)
                self._spared.update(u.ids[0] for u in component)
                self._spared.difference_update(u.ids[0] for u in looked_at)
            part = find(
                book.network,
                register,
                looked_at,
                datum="free" if begins else "given",
                blunders=self.policy != "accept",
                alpha=self.alpha,
                start=self._was,
            )
            lacks |= part.lacks
            if looked_at is component:
                inside = {u.ids[0] for u in part.units}
                retries.note([u for u in component if u.ids[0] not in inside])
            if part.solution is not None and not (begins and found):
                found += part.units
                solutions.append(part.solution)
                self._spared.update(u.ids[0] for u in part.aside)
        return found, solutions, lacks

    def _settle_hot(
        self,
        units: Sequence[Unit],
        ready: Sequence[Unit],
        trial: Trial | None,
        lacks: dict[Variable, str],
        policy: Policy,
        entry: dict[str, Any] | None,
    ) -> Arrival:
        """Judge, record and keep units that depend on what is known alone; the others wait."""
        book, engine = self._book, self._engine
        try:
            decision, told = self._judge(trial, policy, {u.ids[0] for u in ready})
            late = self._late(units, {u.ids[0] for u in ready}, lacks, told)
            arrival = _arrival(units, told)
        except BaseException:
            if trial is not None:
                engine.take_back(trial)
            raise
        self._solution = None
        for unit in decision.stay:
            book.enter(unit)
        self._leave_out(decision, arrival, policy)
        book.wait(late)
        try:
            if trial is not None:
                kept = engine.kept
                engine.keep(trial, decision.left_out)
                engine.keep_the_promise()
                if kept:
                    decision.apart = self._let_go(units)
                    arrival = _apart(arrival, decision.apart)
                    engine = self._engine
                if kept and not engine.kept and decision.stay and policy != "accept":
                    arrival = self._leave_out_again(decision.stay, arrival, policy)
            if entry is not None:
                line = records.outcome(book.network, units, arrival.verdicts)
                if arrival.waits:
                    line["waiting"] = [*line.get("waiting", ()), *arrival.waits]
                self._record(entry | line)
        except BaseException:
            self._undo(units)
            raise
        return arrival

    def _undo(self, units: Sequence[Unit]) -> None:
        """Take units that arrived out again, wherever they are."""
        self._engine.rebuild()
        self._remove([i for u in units for i in u.ids])

    def _leave_out_again(self, units: Sequence[Unit], arrival: Arrival, policy: Policy) -> Arrival:
        """Leave out units with which no solution is reached, though their tests passed."""
        ids = [i for u in units for i in u.ids]
        outcome: Outcome = "rejected" if policy == "reject" else "suspect"
        told = Arrival(
            tuple(
                replace(v, verdict=outcome, lacks=NO_SOLUTION, gains=()) if v.id in ids else v
                for v in arrival.verdicts
            )
        )
        waits = self._remove(ids)
        self._leave_out(Decision(left_out=list(units)), told, policy)
        return replace(told, waits=(*arrival.waits, *waits))

    def _enter(
        self,
        units: Sequence[Unit],
        ready: list[Unit],
        found: list[Unit],
        solutions: list[Solution],
        lacks: dict[Variable, str],
        policy: Policy,
        saved: tuple[Book, Engine],
    ) -> Arrival:
        """Put units in with what enters with them; it waits on if no solution is reached."""
        book = self._book
        self._solution = None
        given = _ids(units)
        entering = [*ready, *found]
        for unit in entering:
            book.enter(unit)
        try:
            reached = self._reach(entering, solutions, policy, given, saved[1])
        except _LosesDatum:
            return self._start_over(units, entering, policy, saved[1])
        except AdjustmentError:
            if not found:
                raise
            reached = None
        if reached is None:
            return self._wait_on(units, ready, found, lacks, policy, saved[1])
        decision, told = reached
        late = self._late(units, {u.ids[0] for u in entering}, lacks, told)
        arrival = _apart(_arrival(units, told), decision.apart)
        self._leave_out(decision, arrival, policy)
        book.wait(late)
        # What was left alone may be determined beside it.
        known = (v for u in entering for v in u.unknowns)
        awake = book.awake(self._engine.register, known, self._spared)
        if awake:
            for unit in awake:
                book.retries.forget(unit.ids[0])
            beside = self._absorb(awake, test=policy != "accept")
            arrival = joined(arrival, _entered_beside(beside, given))
        return arrival

    def _start_over(
        self, units: Sequence[Unit], entering: Sequence[Unit], policy: Policy, before: Engine
    ) -> Arrival:
        """Find out anew what is determined, now that something notices what the datum left open.

        Parts of a free network that do not notice it are loose then. Where no more is determined
        than before, what arrived waits.
        """
        book = self._book
        given = _ids(units)
        for unit in entering:
            if book.in_graph(unit.ids[0]):
                book.remove(unit)
        book.wait(u for u in entering if u.ids[0] not in given)
        waited = list(book.pool.values())
        inside = book.take_all()
        if not self._starting_over:
            self._starting_over = True
            book.retries.clear()
            self._engine.clear()
            try:
                every = [*inside, *waited, *units]
                arrival = self._absorb(every, test=policy != "accept")
            finally:
                self._starting_over = False
            if len(book.inside) > sum(len(u.ids) for u in inside):
                again = [u for u in inside if u.ids[0] in book.pool]
                known = _ids(inside) - given
                told = Arrival(tuple(v for v in arrival.verdicts if v.id not in known))
                waits = tuple(i for u in again for i in book.pool[u.ids[0]].ids)
                return replace(_entered_beside(told, given), waits=waits)
            book.take_all()
        self._engine = before.copy()
        self._engine.network = book.network
        for unit in inside:
            book.enter(unit)
        book.lacks.update(dict.fromkeys((v for u in units for v in u.unknowns), OPEN))
        told_: dict[str, list[Verdict]] = {}
        for unit in units:
            for verdict in waiting(unit, OPEN):
                told_.setdefault(verdict.id, []).append(verdict)
        book.wait(units)
        return _arrival(units, told_)

    def _reach(
        self,
        entering: Sequence[Unit],
        solutions: Sequence[Solution],
        policy: Policy,
        given: set[str],
        before: Engine,
    ) -> tuple[Decision, dict[str, list[Verdict]]] | None:
        """Put units in, leave out what does not fit, and go to a solution with the others.

        Returns:
            The decision and all verdicts; none where no solution is reached.
        """
        self._put_in(entering, solutions)
        self._book.fill(self._engine.register)
        whole = Decision(stay=list(entering))
        told: dict[str, list[Verdict]] = {}
        kept = False
        try:
            kept = self._leave_and_go(whole, told, policy, given, before)
        finally:
            if not kept:
                new = {u.ids[0] for u in entering}
                for unit in whole.apart:
                    if unit.ids[0] not in new:
                        self._book.enter(unit)
        return (whole, told) if kept else None

    def _leave_and_go(
        self,
        whole: Decision,
        told: dict[str, list[Verdict]],
        policy: Policy,
        given: set[str],
        before: Engine,
    ) -> bool:
        """Leave out what does not fit, and go to a solution with the others, see `_reach`.

        Returns:
            Whether one was reached.
        """
        book, engine = self._book, self._engine
        entering = list(whole.stay)
        for _ in range(MOST_JUDGED):
            if not whole.stay:
                break
            decision = Decision()
            several = parts(whole.stay)
            for part in several:
                trial = engine.trial_of(part)
                trial.entered[:] = _new_variables(part, engine, before)
                of_part, now = self._judge(trial, policy, given)
                decision.join(of_part)
                told |= now
            if decision.leaving and len(several) > 1:
                return False  # who depends on them is not known; fewer at a time will tell
            gone = [*decision.left_out, *decision.back]
            for unit in gone:
                book.remove(unit)
            if gone:
                priors = [i for v in decision.leaving for i in engine.priors.get(v, [])]
                engine.drop([i for u in gone for i in u.ids] + priors, decision.leaving)
            whole.stay = decision.stay
            whole.left_out += decision.left_out
            whole.back += decision.back
            engine.keep_the_promise()
            if before.kept:
                whole.apart += self._let_go(entering)
                engine = self._engine
            if not engine.kept and _new_variables(entering, engine, before):
                return False
            waits = {u.ids[0] for u in whole.apart}
            whole.stay = [u for u in whole.stay if u.ids[0] not in waits]
            if not gone:
                break
        return True

    def _let_go(self, because: Sequence[Unit]) -> list[Unit]:
        """Let points wait again whose rays run parallel, so that everything else has its minimum.

        Two rays on a short base meet somewhere until the photos turn by a little more. Other
        observations give a point a place, wherever a wild reading takes the network.

        Args:
            because: units that have just arrived.

        Returns:
            The units of those points; none where that does not help: nothing has changed then.
        """
        book, engine = self._book, self._engine
        if engine.kept or engine.loose is None:
            return []
        saved = engine.copy()
        gone: list[Unit] = []
        points: list[Variable] = []
        try:
            while not engine.kept and engine.loose is not None:
                lost = self._only_rays(engine.loose)
                if not lost:
                    break
                points += lost
                units = [u for of_point in lost.values() for u in of_point]
                gone += units
                for unit in units:
                    book.remove(unit)
                engine.go_on_without(lost)
        except BaseException:
            self._return_to(saved, gone)
            raise
        if not engine.kept:
            self._return_to(saved, gone)
            return []
        book.lacks.update(dict.fromkeys(points, PARALLEL))
        book.wait(gone)
        keys = [u.ids[0] for u in gone]
        book.retries.let_go(keys, self._arrived(), [i for u in because for i in u.ids])
        return gone

    def _only_rays(self, variables: Iterable[tuple[str, str]]) -> dict[Variable, list[Unit]]:
        """Return those points of variables that nothing but image points determines, with them."""
        book, engine = self._book, self._engine
        out: dict[Variable, list[Unit]] = {}
        for kind, name in variables:
            if kind == "point" and engine.register.known("point", name):
                number = engine.register["point"].number[name]
                own = [book.unit_or_none(i) for i in touching(engine, {("point", number)})]
                rays = [u for u in own if u is not None and isinstance(u.item, ImagePoint)]
                if len(rays) == len(own):
                    out["point", name] = rays
        return out

    def _return_to(self, engine: Engine, units: Iterable[Unit]) -> None:
        """Go back to a graph that still had some units."""
        book = self._book
        for unit in units:
            if not book.in_graph(unit.ids[0]):
                book.enter(unit)
        self._engine = engine
        engine.network = book.network

    def _wait_on(
        self,
        units: Sequence[Unit],
        ready: Sequence[Unit],
        found: Sequence[Unit],
        lacks: dict[Variable, str],
        policy: Policy,
        before: Engine,
    ) -> Arrival:
        """Let what was to enter wait on: no solution was reached with it."""
        book = self._book
        given = _ids(units)
        for unit in (*found, *ready):
            if book.in_graph(unit.ids[0]):
                book.remove(unit)
        late = [v for u in found for v in pending(before.register, u)]
        lacks = lacks | dict.fromkeys(late, TOO_WEAK)
        self._engine = before.copy()
        self._engine.network = book.network
        book.lacks.update(lacks)
        book.wait(u for u in found if u.ids[0] not in given)
        told: dict[str, list[Verdict]] = {}
        book.wait(self._late(units, {u.ids[0] for u in ready}, lacks, told))
        book.retries.fail(found, self._arrived())
        waits: tuple[str, ...] = ()
        if ready:
            beside = self._absorb(ready, test=policy != "accept")
            waits = beside.waits
            for verdict in beside.verdicts:
                told.setdefault(verdict.id, []).append(verdict)
        arrival = replace(_arrival(units, told), waits=waits)
        # Fewer each time, or it would not end; and nothing helps where there was no minimum before.
        most, self._most_split = self._most_split, len(found)
        try:
            for some in self._fewer(found) if before.kept and len(found) < most else ():
                waits_on = [u for u in some if u.ids[0] in book.pool]
                for unit in waits_on:
                    book.retries.forget(unit.ids[0])
                beside = self._absorb(waits_on, test=policy != "accept")
                arrival = joined(arrival, _entered_beside(beside, given))
        finally:
            self._most_split = most
        return arrival

    def _fewer(self, found: Sequence[Unit]) -> list[list[Unit]]:
        """Split what reached no solution together: what is firm before the rest, or in halves."""
        book, register = self._book, self._engine.register
        several = book.joined(found, register, without=book.retries.weak)
        if len(several) > 1:
            half = len(several) // 2
            return [[u for c in some for u in c] for some in (several[:half], several[half:])]
        inside = firm(book.network, register, found)
        if not inside:
            return []
        keys = {u.ids[0] for u in inside}
        return [inside, [u for u in found if u.ids[0] not in keys]]

    def _put_in(self, entering: Sequence[Unit], solutions: Sequence[Solution]) -> None:
        """Put units into the graph; find the datum of a free network anew where they touch it."""
        engine = self._engine
        if engine.datum == "free" and engine.empty:
            first = solutions[0]
            engine.load(first.equations, first.state, first.start, first.constraint)
            return
        placed = engine.put_in(entering, solutions)
        if engine.new_to_datum(placed):
            engine.take_back(placed)
            try:
                engine.begin_anew_with(entering, solutions)
            except AdjustmentError as error:
                raise _LosesDatum from error

    def _judge(
        self, trial: Trial | None, policy: Policy, given: set[str]
    ) -> tuple[Decision, dict[str, list[Verdict]]]:
        """Decide on the units of a trial; return the verdicts by id of the observation."""
        told: dict[str, list[Verdict]] = {}
        if trial is None:
            return Decision(), told
        engine = self._engine
        decision = decide(engine, trial, policy=policy, alpha=self.alpha)
        entered = {u.ids[0] for u in trial.units if u.ids[0] not in given}
        for v in verdicts(
            engine,
            trial,
            decision,
            policy=policy,
            alpha=self.alpha,
            entered=entered,
            lacks=CONTRADICT,
        ):
            told.setdefault(v.id, []).append(v)
        return decision, told

    def _late(
        self,
        units: Sequence[Unit],
        inside: set[str],
        lacks: Mapping[Variable, str],
        told: dict[str, list[Verdict]],
    ) -> list[Unit]:
        """Return the units that wait, and add their verdicts to those told."""
        out = [u for u in units if u.ids[0] not in inside]
        self._book.lacks.update(lacks)
        for unit in out:
            for verdict in waiting(unit, self._book.why(unit, self._engine.register)):
                told.setdefault(verdict.id, []).append(verdict)
        return out

    def _leave_out(self, decision: Decision, arrival: Arrival, policy: Policy) -> None:
        """Put units that do not stay where they belong."""
        told: dict[str, list[Verdict]] = {}
        for verdict in arrival.verdicts:
            told.setdefault(verdict.id, []).append(verdict)
        book = self._book
        for unit in decision.left_out:
            verdicts_ = tuple(v for i in unit.ids for v in told[i])
            if policy == "reject":
                book.reject([unit], verdicts_)
            else:
                book.suspect(unit, verdicts_)
        for unit in decision.back:
            for v in unit.variables:
                if not self._engine.register.known(*v):
                    book.lacks[v] = CONTRADICT
        book.wait(decision.back)

    def _entry(self, do: str, **fields: Any) -> dict[str, Any] | None:
        """Return the beginning of a line of the journal; none without one."""
        return None if self._journal is None else {"do": do, **fields}

    def _record(self, entry: Mapping[str, object]) -> None:
        if self._journal is not None:
            self._journal.append(entry)

    def _remove(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """Take out, and return the ids of what waits again."""
        book, engine = self._book, self._engine
        self._solution = None
        gone = set(wanted)
        # A wrong one that waits may be what kept others from entering.
        looked_at = {u.ids[0]: u for u in book.beside(wanted, engine.register)}
        left_over = book.forget(gone)
        for key in looked_at:
            book.retries.forget(key)
        looked_at |= {k: book.pool[k] for k in book.retries.freed(gone, book.pool)}
        left_over += looked_at.values()
        weights = [i for i in wanted if not book.in_graph(i) and i in engine.store.places]
        units = list(dict.fromkeys(book.unit(i) for i in wanted if book.in_graph(i)))
        if weights:
            book.unweight(weights)
            engine.network = book.network
        if not units and not weights:
            # What remains of groups that wait or are suspect is as if it arrived now.
            waited = _ids(book.pool.values())
            found = self._absorb(left_over, test=True) if left_over else Arrival()
            return _waiting_again(found, waited)
        left_over += [rest for u in units if (rest := _rest(book, u, gone)) is not None]
        loosened = what_loosens(engine, units, weights, book.unit_or_none)
        if loosened is None or (loosened.variables and engine.datum == "free"):
            return self._anew(units, left_over)
        touched = list(dict.fromkeys(book.unit(i) for i in loosened.ids if book.in_graph(i)))
        again = [u for u in touched if not gone & set(u.ids)]
        for unit in touched:
            book.remove(unit)
        kept = engine.kept
        try:
            engine.drop(loosened.ids, loosened.variables)
        except SingularError:  # to working precision, which is not that of M
            return self._anew((), [*left_over, *again])
        engine.keep_the_promise()
        apart = self._let_go(()) if kept else []
        engine = self._engine
        if kept and not engine.kept and engine.loose is not None:
            return self._anew((), [*left_over, *again])
        book.wait(again)
        left_over += again
        if engine.kept and not kept:  # what kept others from entering may be gone
            left_over += [book.pool[k] for k in book.retries.weak]
            book.retries.clear()
        waited = _ids(book.pool.values()) - _ids(again)
        found = self._absorb(left_over, test=False) if left_over else Arrival()
        return (*_waiting_again(found, waited), *(i for u in apart for i in u.ids))

    def _anew(self, units: Sequence[Unit], left_over: Sequence[Unit]) -> tuple[str, ...]:
        """Take units out, and find out again what of the network is determined."""
        book, engine = self._book, self._engine
        for unit in units:
            book.remove(unit)
        waited = _ids(book.pool.values())
        before = known_network(book.network, engine.register)
        start: Solution | None = None
        with suppress(AdjustmentError):
            start = None if engine.empty else solution_of(engine)
        held = False
        with suppress(AdjustmentError):
            solution = adjust(before, datum=engine.datum, start=start)
            # Without redundancy there is a minimum, v = 0, where everything is determined.
            if solution.converged or (solution.redundancy and not anywhere(solution)):
                engine.hold(solution)
                held = True
        every: list[Unit] = []
        if not held:
            every = book.take_all()
            book.retries.clear()
            engine.clear()
            self._was = start
        try:
            return _waiting_again(self._absorb([*every, *left_over], test=False), waited)
        finally:
            self._was = None

    @contextmanager
    def _all_or_nothing(self, entry: Mapping[str, object] | None) -> Iterator[tuple[Book, Engine]]:
        """Record what changed at the end; bring everything back as it was if anything fails."""
        book, engine = self._book, self._engine
        saved, whole, solution = book.copy(), engine.copy(), self._solution
        whole.network = saved.network
        outermost = self._depth == 0
        if outermost:
            book.watch()
        self._depth += 1
        try:
            yield saved, whole
            if outermost and entry is not None and self._journal is not None:
                self._record({**entry, **records.difference(saved, self._book)})
        except BaseException:
            self._book, self._engine, self._solution = saved, whole, solution
            raise
        finally:
            self._depth -= 1

    def _restore(self) -> None:
        """Build the graph of everything that the book holds, at rest."""
        book, engine = self._book, self._engine
        self._take_over(book.network)
        engine.clear()
        if not book.inside:
            return
        self._start_with(book.adjustable(), None)
        if engine.kept:
            engine.settle()

    def _set_aside(self) -> list[Unit]:
        """Take out of the network what its observations do not determine; return those units."""
        book = self._book
        units = book.copy().take_all()
        stay = determined(book.network, self._engine.register, units, datum=self._engine.datum)
        if len(stay) == len(units):
            return []
        book.take_all()
        for unit in stay:
            book.enter(unit)
        return [u for u in units if not book.in_graph(u.ids[0])]

    def _start_with(self, network: Network, start: Solution | None) -> None:
        """Load a network's adjustment, see `_hold`."""
        self._hold(network, self._adjusted(network, start), start)

    def _adjusted(self, network: Network, start: Solution | None) -> Solution | None:
        """Return a network's adjustment; none where it ends in an error."""
        with suppress(AdjustmentError):
            return adjust(network, datum=self._engine.datum, start=start)
        return None

    def _hold(self, network: Network, solution: Solution | None, start: Solution | None) -> None:
        """Load a network's adjustment; where it finds no minimum, what it began with.

        Raises:
            AdjustmentError: it is not determined even there.
        """
        engine = self._engine
        doubt = "" if solution is None else solution.reason
        if solution is None or not solution.converged:
            step = 1 if engine.datum == "free" else 0  # with which the datum is found
            solution = adjust(network, datum=engine.datum, start=start, max_iterations=step)
        engine.hold(solution, doubt)


def _arrival(units: Sequence[Unit], told: Mapping[str, list[Verdict]]) -> Arrival:
    """Return the verdicts of units, then those of others."""
    given = dict.fromkeys(i for u in units for i in u.ids)
    order = [*given, *(i for i in told if i not in given)]
    return Arrival(tuple(v for i in order for v in told.get(i, ())))


def _new_variables(
    units: Sequence[Unit], engine: Engine, before: Engine
) -> list[tuple[VariableKind, int]]:
    """Return variables of units that were not known before."""
    found = (v for u in units for v in _variables(engine, u) if not _was_known(before, engine, v))
    return list(dict.fromkeys(found))


def _variables(engine: Engine, unit: Unit) -> Iterator[tuple[VariableKind, int]]:
    for kind, name in unit.variables:
        table = engine.register[kind]
        number = table.number.get(name)
        if number is not None and table.free.view[number].any():
            yield kind, number


def _was_known(before: Engine, now: Engine, variable: tuple[VariableKind, int]) -> bool:
    kind, number = variable
    return before.register.known(kind, now.register[kind].names[number])


def _rest(book: Book, unit: Unit, gone: set[str]) -> Unit | None:
    return None if unit.covariance is None else unit.without(book.network, gone)


def _entered_beside(arrival: Arrival, given: set[str]) -> Arrival:
    """Return the verdicts on what waited and does so no more, and on what was given."""
    told = (v for v in arrival.verdicts if v.id in given or v.verdict != "waiting")
    verdicts_ = tuple(v if v.id in given else replace(v, entered=True) for v in told)
    return replace(arrival, verdicts=verdicts_)


def _apart(arrival: Arrival, units: Sequence[Unit]) -> Arrival:
    """Return an arrival some of whose units wait after all, and some that were there before."""
    told = {v.id: v for u in units for v in waiting(u, PARALLEL)}
    given = {v.id for v in arrival.verdicts}
    return Arrival(
        tuple(told.get(v.id, v) for v in arrival.verdicts),
        (*arrival.waits, *(i for i in told if i not in given)),
    )


def _ids(units: Iterable[Unit]) -> set[str]:
    """Return the ids of all observations of units."""
    return {i for u in units for i in u.ids}


def _waiting_again(found: Arrival, waited: Collection[str]) -> tuple[str, ...]:
    """Return the ids of what waits by now, but for what had waited before."""
    waits = [v.id for v in found.verdicts if v.verdict == "waiting" and v.id not in waited]
    return (*waits, *found.waits)


def joined(a: Arrival, b: Arrival) -> Arrival:
    """Return both arrivals; what entered in the second is not waiting any more, or does again."""
    later = {v.id: v for v in b.verdicts}
    again = set(b.waits)
    first = [
        replace(v, verdict="waiting", lacks=PARALLEL, gains=()) if v.id in again else v
        for v in (later.pop(v.id, v) for v in a.verdicts)
    ]
    given = {v.id for v in first}
    inside = {v.id for v in b.verdicts if v.verdict != "waiting"}
    waits = dict.fromkeys(i for i in (*a.waits, *b.waits) if i not in inside and i not in given)
    return Arrival((*first, *later.values()), tuple(waits))
