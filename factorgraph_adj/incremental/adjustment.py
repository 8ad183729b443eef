"""Observations one by one: tested before they count, absorbed, taken out again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..entities import Camera, Photo, Point
from ..errors import AdjustmentError, InputError, Problem, known
from ..models.registry import VariableKind
from ..network import DatumChoice, Network
from ..observations import AnyObservation, Correlated, Observation
from ..quality.rejections import Snooping
from ..quality.reliability import Reliability, reliability
from ..quality.snooping import snoop
from ..quality.solution import CalibrationEstimate, PoseEstimate, Solution
from ..solve.batch import adjust
from ..stochastic import StandardDeviation
from ..types import Array
from . import records
from .book import Book
from .engine import Engine
from .entering import find
from .journal import Journal
from .judging import Decision, decide, verdicts, waiting
from .local import known_network
from .taking_out import what_loosens
from .trial import Trial
from .units import Unit, Variable, named, pending
from .verdicts import Outcome, Policy, Verdict
from .view import solution_of

TOO_WEAK = "is determined too weakly yet: no solution was reached with it"
NO_SOLUTION = "no solution is reached with it: is it near to where its kind has no answer?"
CONTRADICT = "its observations contradict each other, and nothing tells yet which of them is wrong"
POLICIES = ("accept", "flag", "reject")
MOST_WEIGHT = 1e12
"""Factor of weights beyond which nothing is meant by it."""
MOST_ROWS = 2500
"""Scalar rows of one arrival that are judged together; more go in one part after the other."""


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


@dataclass(frozen=True)
class Waiting:
    """An observation that waits."""

    id: str
    """Its id."""
    kind: str
    """Its kind."""
    label: str
    """Readable name."""
    lacks: str
    """What is missing until it can enter."""


class IncrementalAdjustment:
    """A network that is adjusted while its observations arrive.

    Every observation is predicted from all others and tested before it counts; what is not
    determined yet waits and enters by itself; estimates and covariances are at any time within
    ``accuracy`` of a batch adjustment of the same observations, and after `settle` the same.

    Example:
        >>> import factorgraph_adj as fga
        >>> from factorgraph_adj.observations import SlopeDistance
        >>> net = fga.Network("three distances")
        >>> net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
        >>> net.add_point("B", (10.0, 0.0, 0.0), fixed="yz")
        >>> inc = fga.IncrementalAdjustment(net)
        >>> for value in (10.002, 10.000, 10.050):
        ...     verdict = inc.add(SlopeDistance("A", "B", value, sigma=0.002)).verdicts[0]
        ...     print(verdict.verdict, round(verdict.test, 1))
        accepted nan
        accepted 0.2
        suspect 6.0
    """

    def __init__(
        self,
        network: Network,
        *,
        policy: Policy = "flag",
        alpha: float = 0.001,
        accuracy: float = 0.01,
        datum: DatumChoice | None = None,
        start: Solution | None = None,
        journal: str | Path | None = None,
    ) -> None:
        """Start from a network; it is copied.

        Args:
            network: points, cameras, photos and what is known of other unknowns; observations, if
                there are any, enter without a test, those that are not determined yet wait.
            policy: what becomes of an observation beyond the critical value: ``accept`` (it is in,
                its verdict tells), ``flag`` (suspect: left out until it is accepted or discarded)
                or ``reject``.
            alpha: probability of a false alarm of one test.
            accuracy: largest deviation from the batch adjustment, relative to each standard
                deviation, until `settle` removes it.
            datum: as in `adjust`.
            start: a solution of the network, which saves adjusting it.
            journal: a new file to which every change is appended before it counts.

        Raises:
            InputError: an option or the network's input is bad, or the journal has content.
        """
        _check_options(policy, alpha, accuracy, datum)
        self.policy: Policy = policy
        """What becomes of observations beyond the critical value."""
        self.alpha = alpha
        """Probability of a false alarm of one test."""
        self.resumed = ""
        """What `resume` found torn at the end of its journal; empty if nothing."""
        self._journal: Journal | None = None
        self._solution: Solution | None = None
        self._weak: dict[str, int] = {}
        chosen = network.datum if datum is None else datum
        self._book = Book(network.copy())
        self._book.network.datum = chosen
        self._engine = Engine(self._book.network, datum=chosen, accuracy=accuracy)
        self._begin(start)
        if journal is not None:
            options = {"policy": policy, "alpha": alpha, "accuracy": accuracy, "datum": chosen}
            self._journal = Journal.create(journal, records.header(network, options), durable=False)

    def _begin(self, start: Solution | None) -> None:
        """Put the network's own observations in: all at once, or what is determined of them."""
        network = self._book.network
        if not network.observations and not network.n_image_points:
            return
        try:
            solution = adjust(network, datum=self._engine.datum, start=start)
        except AdjustmentError:
            units = self._book.take_all()
            self._absorb(units, test=False)
            return
        self._engine.load(solution.equations, solution.state, solution.start, solution.constraint)
        self._engine.settled = False
        self._book.fill(self._engine.register)

    @classmethod
    def resume(cls, journal: str | Path) -> IncrementalAdjustment:
        """Rebuild the state from a journal, and go on with it.

        A torn last line, of an arrival in hand when the process ended, is left out; ``resumed``
        says so. The network, what waits, suspects and rejected observations are as they were;
        estimates are at rest.

        Raises:
            InputError: no journal, or a damaged line before the last.
        """
        opened, header, entries, torn = Journal.open(journal, durable=False)
        try:
            network, options = records.start_of(header)
            _check_options(options["policy"], options["alpha"], options["accuracy"], None)
            out = cls.__new__(cls)
            out.policy, out.alpha = options["policy"], options["alpha"]
            out.resumed, out._solution, out._journal, out._weak = torn, None, None, {}
            out._book = Book(network)
            network.datum = options["datum"]
            out._engine = Engine(network, datum=options["datum"], accuracy=options["accuracy"])
            out._begin(None)
            for entry in entries:
                out._replay(entry)
            out._restore()
        except BaseException:
            opened.close()
            raise
        out._journal = opened
        return out

    # -- arriving -----------------------------------------------------------------------------

    def add(
        self,
        observations: AnyObservation | Sequence[AnyObservation] = (),
        *,
        points: Iterable[Point] = (),
        photos: Iterable[Photo] = (),
        cameras: Iterable[Camera] = (),
    ) -> Arrival:
        """Test observations and absorb them; what they lack, they wait for.

        Each is compared with its prediction from everything else, see
        `factorgraph_adj.incremental.verdicts`. Of several that are beyond the critical value the
        worst goes first, as in data snooping.

        Args:
            observations: one or many, of any kind, correlated groups among them.
            points: new points.
            photos: new photos.
            cameras: new cameras.

        Returns:
            A verdict for each observation given, then for those that entered by themselves.

        Raises:
            InputError: everything that is wrong with the input; nothing has changed then.
        """
        if isinstance(observations, Observation | Correlated):
            observations = [observations]
        new = tuple(points), tuple(photos), tuple(cameras)
        draft = self._book.with_entities(*new) if any(new) else self._book.network
        units = self._book.units(draft, list(observations))
        entry = self._entry("add", **records.entities(*new))
        if sum(u.n_scalars for u in units) > MOST_ROWS:
            with self._all_or_nothing(entry):
                self._take_over(draft)
                found = Arrival()
                for part in _parts(units):
                    found = _joined(found, self._absorb(part, test=True))
            return found
        before = self._book.network
        self._take_over(draft)
        try:
            return self._absorb(units, test=True, entry=entry)
        except BaseException:
            self._take_over(before)
            raise

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
        again = [] if begins else self._weak_ones()
        found, solutions, lacks = self._find([*late, *again], begins=begins)
        if not found:
            trial = engine.put_in(ready, ()) if ready else None
            if trial is None or not engine.new_to_datum(trial):
                return self._settle_hot(units, ready, trial, lacks, policy, entry)
            # It may notice what the datum has left open.
            engine.take_back(trial)
        with self._all_or_nothing(entry) as saved:
            return self._enter(units, ready, found, solutions, lacks, policy, saved)

    def _weak_ones(self) -> list[Unit]:
        """Return what was too weak to enter, where the network has grown by a tenth since."""
        now = self.redundancy if self._weak else 0
        due = [k for k, then in self._weak.items() if now > 1.1 * then + 2]
        for key in due:
            del self._weak[key]
        return [self._book.pool[k] for k in due if k in self._book.pool]

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
        for component in book.joined(late, register):
            part = find(book.network, register, component, datum="free" if begins else "given")
            lacks |= part.lacks
            if part.solution is not None and not (begins and found):
                found += part.units
                solutions.append(part.solution)
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
            if entry is not None:
                self._record(entry | records.outcome(book.network, units, arrival.verdicts))
        except BaseException:
            if trial is not None:
                engine.take_back(trial)
            raise
        # From here on it counts.
        self._solution = None
        book.lacks.update(lacks)
        for unit in decision.stay:
            book.enter(unit)
        self._leave_out(decision, arrival, policy)
        book.wait(late)
        gone = [u for u in ready if u not in decision.stay]
        if trial is not None:
            kept = engine.kept
            engine.keep(trial, gone)
            engine.keep_the_promise()
            if kept and not engine.kept and decision.stay and policy != "accept":
                return self._leave_out_again(decision.stay, arrival, policy)
        return arrival

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
        with self._all_or_nothing({"do": "add"}):
            self._remove(ids)
            self._leave_out(Decision(left_out=list(units)), told, policy)
        return told

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
        book, engine = self._book, self._engine
        self._solution = None
        given = {i for u in units for i in u.ids}
        entering = [*ready, *found]
        for unit in entering:
            book.enter(unit)
        begins = engine.datum == "free" and engine.empty
        if begins:
            trial = engine.begin(entering, solutions[0])
        elif found:
            trial = engine.put_in(entering, solutions)
        if not found or (engine.new_to_datum(trial) and not begins):
            if found:
                engine.take_back(trial)
            engine.begin_anew_with(entering)
        book.fill(engine.register)
        engine.keep_the_promise()
        if found and not engine.kept:
            # No solution was reached with it: it waits on.
            for unit in found:
                book.remove(unit)
            late = [v for u in found for v in pending(saved[1].register, u)]
            lacks = lacks | dict.fromkeys(late, TOO_WEAK)
            self._engine = engine = saved[1].copy()
            engine.network = book.network
            for unit in ready:
                book.remove(unit)
            book.lacks.update(lacks)
            self._weak.update((u.ids[0], self.redundancy) for u in found)
            book.wait(u for u in found if u.ids[0] not in given)
            told: dict[str, list[Verdict]] = {}
            book.wait(self._late(units, {u.ids[0] for u in ready}, lacks, told))
            first = _arrival(units, told)
            if not ready:
                return first
            second = self._absorb(ready, test=policy != "accept")
            for v in second.verdicts:
                told.setdefault(v.id, []).append(v)
            return _arrival(units, told)
        trial = engine.trial_of(entering)
        trial.entered[:] = [
            v for u in found for v in _variables(engine, u) if not _was_known(saved[1], engine, v)
        ]
        decision, told = self._judge(trial, policy, given)
        late_units = self._late(units, {u.ids[0] for u in entering}, lacks, told)
        arrival = _arrival(units, told)
        book.lacks.update(lacks)
        gone = [u for u in entering if u not in decision.stay]
        for unit in gone:
            book.remove(unit)
        self._leave_out(decision, arrival, policy)
        book.wait(late_units)
        if gone:
            priors = [i for v in decision.leaving for i in engine.priors.get(v, [])]
            engine.drop([i for u in gone for i in u.ids] + priors, decision.leaving)
            engine.keep_the_promise()
        return arrival

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

    # -- changing -----------------------------------------------------------------------------

    def remove(self, ids: str | Iterable[str]) -> Arrival:
        """Take observations out, wherever they are: in the graph, waiting, suspect or rejected.

        What they alone determined waits again, with all observations of it.

        Args:
            ids: ids; ``photo/point`` for image points; names such as ``"point P1 x"`` for weighted
                unknowns, which are free without their given values.

        Raises:
            InputError: every id that there is not; nothing has changed then.
        """
        wanted = self._known_ids([ids] if isinstance(ids, str) else list(ids))
        with self._all_or_nothing({"do": "remove"}):
            waits = self._remove(wanted)
        return Arrival((), waits)

    def _remove(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """Take out, and return the ids of what waits again."""
        book, engine = self._book, self._engine
        self._solution = None
        gone = set(wanted)
        left_over = book.forget(gone)
        weights = [i for i in wanted if not book.in_graph(i) and i in engine.store.places]
        units = list(dict.fromkeys(book.unit(i) for i in wanted if book.in_graph(i)))
        if weights:
            book.unweight(weights)
            engine.network = book.network
        if not units and not weights:
            # What remains of groups that wait or are suspect is as if it arrived now.
            found = self._absorb(left_over, test=True) if left_over else Arrival()
            return tuple(v.id for v in found.verdicts if v.verdict == "waiting")
        left_over += [rest for u in units if (rest := _rest(u, gone)) is not None]
        loosened = what_loosens(engine, units, weights, book.unit_or_none)
        if loosened is None or (loosened.variables and engine.datum == "free"):
            return self._anew(units, left_over)
        touched = {book.unit(i) for i in loosened.ids if book.in_graph(i)}
        again = [u for u in touched if not gone & set(u.ids)]
        for unit in touched:
            book.remove(unit)
        engine.drop(loosened.ids, loosened.variables)
        engine.keep_the_promise()
        book.wait(again)
        found = self._absorb([*left_over, *again], test=False) if left_over or again else Arrival()
        return tuple(v.id for v in found.verdicts if v.verdict == "waiting")

    def _anew(self, units: Sequence[Unit], left_over: Sequence[Unit]) -> tuple[str, ...]:
        """Take units out, and find out again what of the network is determined."""
        book, engine = self._book, self._engine
        for unit in units:
            book.remove(unit)
        before = known_network(book.network, engine.register)
        try:
            start = solution_of(engine) if not engine.empty else None
            solution = adjust(before, datum=engine.datum, start=start)
        except AdjustmentError:
            every = book.take_all()
            engine.clear()
            found = self._absorb([*every, *left_over], test=False)
            return tuple(v.id for v in found.verdicts if v.verdict == "waiting")
        engine.load(solution.equations, solution.state, solution.start, solution.constraint)
        self._absorb(left_over, test=False)
        return ()

    def replace(self, id: str, observation: Observation) -> Arrival:
        """Put a new observation in the place of another, under the same id; it is tested.

        Raises:
            InputError: no such id, or what is wrong with the observation; nothing has changed.
        """
        self._known_ids([id])
        with self._all_or_nothing({"do": "replace"}):
            self._remove([id])
            units = self._book.units(self._book.network, [named(observation, id)])
            found = self._absorb(units, test=True)
        return found

    def reweight(self, ids: str | Iterable[str], factor: float) -> Arrival:
        """Multiply the weights of observations by a factor: their σ are divided by its root.

        Args:
            ids: ids of observations; members of correlated groups reweight the group.
            factor: from 1e-12 to 1e12.

        Raises:
            InputError: unknown ids, or a bad factor; nothing has changed then.
        """
        wanted = self._known_ids([ids] if isinstance(ids, str) else list(ids))
        if not 1.0 / MOST_WEIGHT <= factor <= MOST_WEIGHT:
            what = f"the factor of weights must be between {1 / MOST_WEIGHT:g} and {MOST_WEIGHT:g}"
            raise InputError(f"{what}, not {factor}")
        with self._all_or_nothing({"do": "reweight"}):
            units = list(dict.fromkeys(self._book.unit(i) for i in wanted))
            every = [i for u in units for i in u.ids]
            self._remove(every)
            scaled = [_scaled(u, 1.0 / np.sqrt(factor)) for u in units]
            found = self._absorb(scaled, test=False)
        return found

    def accept(self, ids: str | Iterable[str]) -> Arrival:
        """Put suspects, or rejected observations, in after all.

        Raises:
            InputError: every id that is neither; nothing has changed then.
        """
        wanted = [ids] if isinstance(ids, str) else list(ids)
        with self._all_or_nothing({"do": "accept"}):
            units = self._book.release(wanted)
            self._solution = None
            found = self._absorb(units, test=False)
        return found

    def discard(self, ids: str | Iterable[str]) -> None:
        """Throw suspects out: they count as rejected.

        Raises:
            InputError: every id that is not a suspect; nothing has changed then.
        """
        wanted = [ids] if isinstance(ids, str) else list(ids)
        with self._all_or_nothing({"do": "discard"}):
            self._book.discard(wanted)

    def snoop(self, **options: Any) -> Snooping:
        """Search the whole network for gross errors, and take out what is found.

        Args:
            options: as those of `factorgraph_adj.snoop`.

        Raises:
            DatumError: nothing is in the graph.
        """
        found = snoop(self.network(), start=self.solution(), **{"alpha": self.alpha, **options})
        ids = [r.id for r in found.rejected]
        ids += [i for p in found.points_set_aside for i in p.rays]
        if ids:
            with self._all_or_nothing({"do": "snoop"}):
                inside = [i for i in dict.fromkeys(ids) if self._book.in_graph(i)]
                weights = [i for i in dict.fromkeys(ids) if i not in inside]
                units = list(dict.fromkeys(self._book.unit(i) for i in inside))
                self._remove([*(i for u in units for i in u.ids), *weights])
                self._book.reject(units)
        return found

    def settle(self) -> None:
        """Iterate to rest: no estimate is further than 1e-6 σ from the batch adjustment's.

        In a free network the coordinates are then on the inner constraints over all datum points.
        """
        if self._engine.empty:
            return
        with self._all_or_nothing(self._entry("settle")):
            self._solution = None
            self._engine.settle()
            if self._weak:
                self._weak = dict.fromkeys(self._weak, -self.redundancy)
                if self._absorb([], test=True).verdicts:
                    self._engine.settle()

    # -- asking -------------------------------------------------------------------------------

    @property
    def waiting(self) -> tuple[Waiting, ...]:
        """What waits, and what it lacks."""
        return tuple(w for u in self._book.pool.values() for w in self._waiting_of(u))

    def latest_waiting(self, most: int) -> tuple[Waiting, ...]:
        """Return what began to wait last, the latest first: ``most`` units at most."""
        units = islice(reversed(self._book.pool.values()), most)
        return tuple(w for u in units for w in self._waiting_of(u))

    @property
    def n_waiting(self) -> int:
        """Number of observations that wait."""
        return sum(len(u.ids) for u in self._book.pool.values())

    def _waiting_of(self, unit: Unit) -> Iterator[Waiting]:
        lacks = self._book.why(unit, self._engine.register)
        for ident, o in zip(unit.ids, unit.observations, strict=True):
            yield Waiting(ident, o.kind, o.label(), lacks)

    @property
    def suspects(self) -> tuple[Verdict, ...]:
        """Observations beyond the critical value that are left out until they are decided on."""
        return tuple(v for _, found in self._book.suspects.values() for v in found)

    @property
    def rejected(self) -> tuple[Verdict, ...]:
        """Observations that were rejected."""
        return tuple(v for _, found in self._book.rejected.values() for v in found)

    def network(self) -> Network:
        """Return the network as it stands: what is in the graph, to save or to adjust in batch.

        Approximate values that were found stand in it as given ones.
        """
        return known_network(self._book.network, self._engine.register)

    def solution(self) -> Solution:
        """Return the solution: the same as that of the batch adjustment.

        Its covariances are those of iSAM2's Bayes tree.

        Raises:
            InputError: nothing is in the graph.
        """
        if self._solution is None:
            if self._engine.empty:
                raise InputError("nothing is determined yet: there is no solution")
            self._engine.to_datum()
            self._solution = solution_of(self._engine)
        return self._solution

    def reliability(self, *, alpha: float | None = None, power: float = 0.80) -> Reliability:
        """Return the reliability of every observation, from iSAM2's own Bayes tree.

        All observations are linearised anew for it.
        """
        if not self._engine.settled and not self._engine.empty:
            self._solution = None
            self._engine.relinearise_all()
        chosen = self.alpha if alpha is None else alpha
        return reliability(self.solution(), alpha=chosen, power=power)

    def estimate(self, name: str) -> Array:
        """Return the coordinates of a point, (3,) metres.

        In a free network they belong to the inner constraints, which takes a whole solution.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        if self._engine.held:
            return self.solution().point(self._determined(name))
        table = self._engine.register["point"]
        self._determined(name)
        if name not in table.number:
            return np.array(self._book.network.points[name].coordinates)
        return np.array(table.value.view[table.number[name]])

    def covariance(self, a: str, b: str | None = None) -> Array:
        """Return the covariance of a point, or between two points, (3, 3) metres²; σ0 = 1.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        names = [self._determined(n) for n in ((a,) if b is None or a == b else (a, b))]
        if self._engine.held:
            return self.solution().covariance(a, b)
        return self._engine.point_covariance(names[0], names[-1])

    def standard_deviations(self, name: str) -> Array:
        """Return the standard deviations of a point, (3,) metres."""
        return np.sqrt(np.maximum(np.diag(self.covariance(name)), 0.0))

    def pose(self, photo: str) -> PoseEstimate:
        """Return the exterior orientation of a photo, as `Solution.pose`."""
        return self.solution().pose(photo)

    def calibration(self, camera: str) -> CalibrationEstimate:
        """Return the calibration of a camera, as `Solution.calibration`."""
        return self.solution().calibration(camera)

    def observation(self, id: str) -> Observation:
        """Return an observation by its id: in the graph, waiting, suspect or rejected.

        Raises:
            InputError: no such id.
        """
        unit = self._book.unit(id)
        return unit.observations[unit.ids.index(id)]

    @property
    def described(self) -> Network:
        """Everything that was described, what is not determined yet among it; not to be changed.

        Its observations are those in the graph.
        """
        return self._book.network

    @property
    def n_observations(self) -> int:
        """Number of scalar rows in the graph, weighted unknowns among them."""
        return self._engine.store.n_scalars

    @property
    def redundancy(self) -> int:
        """Redundancy of the network as it stands."""
        return self.n_observations - self._engine.register.n_places + len(self._engine.held)

    @property
    def vtpv(self) -> float:
        """VᵀPv, of the linear forms."""
        return self._engine.store.vtpv()

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight √(vᵀPv/r); NaN without redundancy."""
        r = self.redundancy
        return float(np.sqrt(self.vtpv / r)) if r > 0 else np.nan

    @property
    def settled(self) -> bool:
        """Whether nothing has changed since it was at rest."""
        return self._engine.settled

    def __len__(self) -> int:
        """Return the number of observations in the graph."""
        network = self._book.network
        return len(network.observations) + network.n_image_points

    def __repr__(self) -> str:
        """Say what is in the graph, and what is not."""
        book = self._book
        return (
            f"<IncrementalAdjustment of {book.network.name!r}: {len(self)} observations, "
            f"redundancy {self.redundancy}, {len(self.waiting)} waiting, {len(self.suspects)} "
            f"suspects, {len(self.rejected)} rejected>"
        )

    # -- helpers ------------------------------------------------------------------------------

    def _determined(self, name: str) -> str:
        points = self._book.network.points
        if name not in points:
            raise InputError(f"unknown point {name!r}; known: {known(points)}")
        if self._engine.register.known("point", name) or all(points[name].fixed):
            return name
        lacks = self._book.lacks.get(("point", name), "no observation has determined it yet")
        raise InputError(Problem(f"is not determined: {lacks}", f"point {name!r}"))

    def _known_ids(self, ids: Sequence[str]) -> list[str]:
        wanted = list(dict.fromkeys(ids))
        problems = [
            Problem("unknown observation", f"observation {i!r}")
            for i in wanted
            if not self._book.has(i) and i not in self._engine.store.places
        ]
        if problems:
            raise InputError(problems)
        return wanted

    @contextmanager
    def _all_or_nothing(self, entry: Mapping[str, object] | None) -> Iterator[tuple[Book, Engine]]:
        """Record what changed at the end; bring everything back as it was if anything fails."""
        book, engine = self._book, self._engine
        saved, whole, solution = book.copy(), engine.copy(), self._solution
        whole.network = saved.network
        if entry is not None:
            book.watch()
        try:
            yield saved, whole
            if entry is not None and self._journal is not None:
                self._record({**entry, **records.difference(saved, self._book)})
        except BaseException:
            self._book, self._engine, self._solution = saved, whole, solution
            raise

    # -- resuming -----------------------------------------------------------------------------

    def _replay(self, entry: Mapping[str, Any]) -> None:
        """Bring what the journal says into the book; the graph follows in `_restore`."""
        records.replay(entry, self._book)

    def _restore(self) -> None:
        """Build the graph of everything that the book holds, at rest."""
        book, engine = self._book, self._engine
        self._take_over(book.network)
        engine.clear()
        if not len(self):
            return
        solution = adjust(book.adjustable(), datum=engine.datum)
        engine.load(solution.equations, solution.state, solution.start, solution.constraint)
        engine.settle()


def _check_options(policy: str, alpha: float, accuracy: float, datum: str | None) -> None:
    problems = []
    if policy not in POLICIES:
        problems.append(Problem(f"unknown policy {policy!r}; valid: {', '.join(POLICIES)}"))
    if not 0 < alpha < 1:
        problems.append(Problem(f"alpha must be between 0 and 1, not {alpha}"))
    if not 0 < accuracy <= 0.1:
        problems.append(Problem(f"accuracy must be in (0, 0.1], not {accuracy}"))
    if datum not in (None, "given", "free"):
        problems.append(Problem(f"unknown datum {datum!r}; valid: given, free"))
    if problems:
        raise InputError(problems)


def _parts(units: Sequence[Unit]) -> Iterator[list[Unit]]:
    """Split units into parts of no more than `MOST_ROWS` rows."""
    part: list[Unit] = []
    n = 0
    for unit in units:
        if part and n + unit.n_scalars > MOST_ROWS:
            yield part
            part, n = [], 0
        part.append(unit)
        n += unit.n_scalars
    if part:
        yield part


def _joined(a: Arrival, b: Arrival) -> Arrival:
    """Return both arrivals; what entered in the second is not waiting any more."""
    later = {v.id for v in b.verdicts}
    return Arrival((*(v for v in a.verdicts if v.id not in later), *b.verdicts))


def _arrival(units: Sequence[Unit], told: Mapping[str, list[Verdict]]) -> Arrival:
    """Return the verdicts of units, then those of others."""
    given = dict.fromkeys(i for u in units for i in u.ids)
    order = [*given, *(i for i in told if i not in given)]
    return Arrival(tuple(v for i in order for v in told.get(i, ())))


def _variables(engine: Engine, unit: Unit) -> Iterator[tuple[VariableKind, int]]:
    for kind, name in unit.variables:
        table = engine.register[kind]
        number = table.number.get(name)
        if number is not None and table.free.view[number].any():
            yield kind, number


def _was_known(before: Engine, now: Engine, variable: tuple[VariableKind, int]) -> bool:
    kind, number = variable
    return before.register.known(kind, now.register[kind].names[number])


def _rest(unit: Unit, gone: set[str]) -> Unit | None:
    return None if unit.covariance is None else unit.without(gone)


def _scaled(unit: Unit, by: float) -> Unit:
    """Return the unit with its standard deviations multiplied."""
    covariance = None if unit.covariance is None else unit.covariance * by**2
    return Unit(
        unit.ids,
        tuple(_scaled_observation(o, by) for o in unit.observations),
        covariance,
        unit.variables,
        unit.unknowns,
    )


def _scaled_observation(o: Observation, by: float) -> Observation:
    changes: dict[str, Any] = {}
    sigma = getattr(o, "sigma", None)
    if isinstance(sigma, StandardDeviation):
        changes["sigma"] = sigma.scaled(by)
    elif isinstance(sigma, tuple):
        changes["sigma"] = tuple(s * by for s in sigma)
    elif sigma is not None:
        changes["sigma"] = sigma * by
    covariance = getattr(o, "covariance", None)
    if covariance is not None:
        changes["covariance"] = np.asarray(covariance) * by**2
    return replace(o, **changes)
