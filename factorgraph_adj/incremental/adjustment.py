"""`IncrementalAdjustment` for users: commands, verdicts, retirement, a journal, resumption."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from threading import RLock
from typing import Any

from ..blas_threads import one_at_a_time, with_one_thread
from ..entities import Camera, Photo, Point
from ..errors import AdjustmentError, InputError
from ..graph.dependence import Variable
from ..graph.user_factors import MakesFactor
from ..io.journal import Journal, begun_journal, opened_journal
from ..io.journal_lines import JournalStore
from ..ledger import journal_entries
from ..ledger.command_input import Engine, Input, Options, ids_in, listed
from ..ledger.ledger import Ledger
from ..ledger.verdicts import Policy
from ..network.additions import UnknownsGiven
from ..network.network import DatumChoice, Network
from ..observations import AnyObservation, Observation
from ..quality.rejections import Snooping
from ..solve.solution import Solution
from ..validate.repeated_readings import CopiedBlocks
from . import commands, manual_decisions, retirement, retirement_window
from .arrival import Arrival
from .initial_adjustment import initial_state
from .resumption import RecordedEstimates, resumed
from .sight_queries import SightQueries
from .worklist import IncrementalState


class IncrementalAdjustment(SightQueries):
    """A network that is adjusted while its observations arrive.

    Every observation is predicted from all others and tested before it enters; an observation whose
    unknowns are not determined yet waits and enters by itself. Estimates and covariances are at any
    time within ``accuracy`` of a batch adjustment of the same observations, and equal to it after
    `settle`.

    Several threads may use one adjustment: each call is atomic, and calls of other threads wait
    until it has ended.

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

    @with_one_thread
    def __init__(
        self,
        network: Network,
        *,
        policy: Policy = "flag",
        alpha: float = 0.001,
        accuracy: float = 0.01,
        datum: DatumChoice | None = None,
        engine: Engine = "auto",
        keep: int | None = None,
        keep_seconds: float | None = None,
        start: Solution | None = None,
        journal: str | Path | JournalStore | None = None,
    ) -> None:
        """Start from a network; it is copied.

        Args:
            network: points, cameras, photos and other stated unknowns. Its observations, if there
                are any, enter without a test; those that are not determined yet wait.
            policy: treatment of an observation beyond the critical value: ``accept`` (it enters,
                and its verdict has the test), ``flag`` (suspect: left out until it is accepted or
                discarded) or ``reject``.
            alpha: probability of a false alarm of one test.
            accuracy: largest deviation from the batch adjustment, relative to each standard
                deviation, until `settle` removes it.
            datum: as in `adjust`.
            engine: what holds the linear system: ``isam2``, ``fronts``, or ``auto``: iSAM2 where
                the network has few image points and a given datum. Results do not depend on it.
            keep: number of the latest photos that are kept: points, photos and orientations that
                nothing later touches are retired automatically, several photos at once, see
                `retire`. Every photo then sees only points of the last ``keep`` photos; a photo
                stays as long as one of its points does, though no longer than twice as many photos.
                By default nothing is retired.
            keep_seconds: the same as a time: what nothing has touched in the last seconds is
                retired. `add` then needs the time of each arrival.
            start: a solution of the network, which saves an adjustment.
            journal: a new file, or another store, to which every change is appended before it
                counts.

        Raises:
            InputError: an option or the network's input is bad, or the journal has content.
        """
        (network,) = listed([network], "fga.Network: fga.read_project(FOLDER) reads one", Network)
        chosen = network.datum if datum is None else datum
        self.resumed = ""
        """What `resume` found incomplete at the end of its journal; empty if nothing."""
        self._lock = RLock()
        self._rules = Options(policy, alpha, accuracy, chosen, engine, keep, keep_seconds)
        self._journal: Journal | JournalStore | None = None
        self._solution: tuple[IncrementalState, Solution] | None = None
        self.latest = Arrival()
        """Result of the latest command; after `snoop`, the verdicts on what came back."""
        self._copies, self._recorded = CopiedBlocks(), RecordedEstimates()
        own = network.copy()
        own.datum = chosen
        self._state = initial_state(Ledger.of(own), self._rules, start)
        self._copies.add(self._state.ledger.observations())
        if journal is not None:
            line = self._recorded.next_line(Ledger.of(own), self._state, everything=True)
            changed = journal_entries.difference(Ledger.of(own), self._state.ledger)
            head = journal_entries.header(network, asdict(self._rules))
            head["start"] = changed | line.fields()
            self._journal = begun_journal(journal, head)
            self._recorded.written(line)
            self._state = self._state.recorded()

    @classmethod
    @with_one_thread
    def resume(
        cls,
        journal: str | Path | JournalStore,
        *,
        engine: Engine | None = None,
        geoids: Collection[str] = (),
        allow_outside: bool = False,
    ) -> IncrementalAdjustment:
        """Rebuild the state from a journal, and continue it.

        An incomplete last line, of an arrival that was being written when the process ended, is
        left out; ``resumed`` says so. The network, the waiting observations with their reasons,
        suspects and rejected observations are as they were; estimates have converged.

        Args:
            journal: the file, or another store.
            engine: what holds the linear system from now on; by default the engine with which the
                journal was begun. Every journal resumes under either engine.
            geoids: paths of geoids that may be read although they lie outside the folder of the
                journal, which may come from anybody.
            allow_outside: whether the geoid may lie anywhere.

        Raises:
            InputError: no journal, a damaged line before the last, or an unknown engine.
        """
        opened, header, entries, torn = opened_journal(journal)
        try:
            place, folder = opened.where, opened.folder
            network, rules = journal_entries.start_of(
                header, f"{place}:1", folder, geoids, allow_outside
            )
            rules = rules if engine is None else replace(rules, engine=engine)
            out = cls.__new__(cls)
            network.datum = rules.datum
            out._rules, out._lock = rules, RLock()
            out.resumed, out._solution, out._journal = torn, None, None
            out.latest = Arrival()
            out._copies, out._recorded = CopiedBlocks(), RecordedEstimates()
            out._state = resumed(network, header, entries, out._rules, place)
            out._copies.add(out._state.ledger.observations())
        except BaseException:
            opened.close()
            raise
        out._journal = opened
        return out

    @property
    def policy(self) -> Policy:
        """Treatment of observations beyond the critical value."""
        return self._rules.policy

    @property
    def alpha(self) -> float:
        """Probability of a false alarm of one test."""
        return self._rules.alpha

    @property
    def keep(self) -> int | float | None:
        """What is kept: a number of photos, or of seconds; None: everything."""
        return self._rules.keep if self._rules.keep_seconds is None else self._rules.keep_seconds

    @property
    def latest_time(self) -> float | None:
        """Time of the latest arrival with a time, seconds; None: none had one."""
        with self._lock:
            return self._state.ledger.time

    def _changed(
        self,
        do: str,
        result: tuple[IncrementalState, Arrival],
        fields: Mapping[str, Any] | None = None,
    ) -> Arrival:
        """Write the difference of two ledgers to the journal, then take over the new state."""
        state, arrival = result
        if do != "add":
            self._suspects_doubts = None
        if self._journal is not None:
            before = self._state.ledger
            line = self._recorded.next_line(before, state, everything=do == "settle")
            changed = journal_entries.difference(before, state.ledger) | line.fields()
            self._journal.append({"do": do, **(fields or {}), **changed})
            self._recorded.written(line)
        self._state, self.latest = state.recorded(), arrival
        return arrival

    @one_at_a_time
    def add(
        self,
        observations: AnyObservation | Sequence[AnyObservation] = (),
        *,
        points: Point | Iterable[Point] = (),
        photos: Photo | Iterable[Photo] = (),
        cameras: Camera | Iterable[Camera] = (),
        unknowns: UnknownsGiven | None = None,
        factors: Mapping[str, MakesFactor] | None = None,
        time: float | None = None,
    ) -> Arrival:
        """Test observations and let them enter; those that lack something wait.

        Each is compared with its prediction from everything else, see
        `factorgraph_adj.ledger.verdicts`. Of several that are beyond the critical value the worst
        is left out first, as in data snooping. Suspects that fit with what has entered are
        readmitted at once, see `factorgraph_adj.incremental.readmission`. The arrival has a verdict
        on each given observation, then on those that entered by themselves.

        Args:
            observations: one or several, of any kind, correlated groups among them.
            points: new points, or approximate coordinates of points that have none yet.
            photos: new photos.
            cameras: new cameras.
            unknowns: new frames, mounts, shapes, drifts and unknowns of any other kind, by kind and
                name, as a scratch network states them: ``unknowns=scratch.parameters``.
            factors: your own factors by id, each as a function of ``key(kind, name)`` that makes
                it, such as ``lambda key: gtsam.RangeFactor3(key("point", "A"), …)``. They are
                observations of the kind ``factor`` from then on. Not with a journal.
            time: time of this arrival, in seconds from any epoch, such as the exposure of the
                photos; not earlier than that of any arrival before. None: that of the latest
                arrival with a time. Only with ``keep_seconds``.

        Raises:
            InputError: all problems of the input; nothing has changed then.
        """
        given = Input.of(observations, points, photos, cameras, unknowns, factors)
        if self._journal is not None:
            given.refuse_factors()
        result = commands.add(commands.at_time(self._state, time, self._rules), given, self._rules)
        new = journal_entries.entities(self._state.ledger.network, result[0].ledger.network, given)
        new |= {} if time is None else {"time": float(time)}
        arrived = result[0].ledger.observations(self._state.ledger.rows.n)
        arrival = self._changed("add", result, new)
        self._copies.add(arrived)
        self._forget()
        return arrival

    @one_at_a_time
    def remove(self, ids: str | Iterable[str]) -> Arrival:
        """Take observations out: from the graph, or waiting, suspect or rejected ones.

        Unknowns that they alone determined wait again, with all their observations. Suspects and
        rejected observations that fit now are readmitted, see
        `factorgraph_adj.incremental.readmission`.

        Args:
            ids: ids; ``photo/point`` for image points; names such as ``"point P1 x"`` for weighted
                unknowns, which become free without their given values.

        Raises:
            InputError: all ids that do not exist; nothing has changed then.
        """
        return self._changed("remove", commands.remove(self._state, ids, self._rules))

    @one_at_a_time
    def replace(self, id: str, observation: Observation) -> Arrival:
        """Put a new observation in the place of another, under the same id, and test it.

        Raises:
            InputError: no such id, or problems of the observation; nothing has changed.
        """
        result = commands.replace_observation(self._state, id, observation, self._rules)
        return self._changed("replace", result)

    @one_at_a_time
    def reweight(self, ids: str | Iterable[str], factor: float) -> Arrival:
        """Multiply the weights of observations by a factor: their σ are divided by its root.

        Suspects and rejected observations are tested again.

        Args:
            ids: ids of observations; members of correlated groups reweight the group.
            factor: from 1e-12 to 1e12.

        Raises:
            InputError: unknown ids, or a bad factor; nothing has changed then.
        """
        result = commands.reweight(self._state, ids, factor, self._rules)
        return self._changed("reweight", result)

    @one_at_a_time
    def accept(self, ids: str | Iterable[str]) -> Arrival:
        """Let suspects or rejected observations enter without regard to their tests.

        Others that fit now are readmitted, as after `remove`.

        Raises:
            InputError: all ids that are neither; nothing has changed then.
        """
        return self._changed("accept", manual_decisions.accept(self._state, ids, self._rules))

    @one_at_a_time
    def discard(self, ids: str | Iterable[str]) -> Arrival:
        """Reject suspects or accepted observations; they are not readmitted automatically.

        Others that fit now are readmitted, as after `remove`.

        Raises:
            InputError: all ids that are neither; nothing has changed then.
        """
        return self._changed("discard", manual_decisions.discard(self._state, ids, self._rules))

    @one_at_a_time
    def revoke(self, ids: str | Iterable[str]) -> Arrival:
        """Take the last `accept` or `discard` of observations back: earlier verdicts stand again.

        An accepted observation that a test had rejected leaves the graph, and is rejected with the
        figures of that test; a discarded one that had been accepted enters again. What was
        readmitted because of the decision has its earlier outcome as well. ``decided`` lists the
        observations about which a decision can be taken back.

        Raises:
            InputError: all ids about which no decision stands, or with whose decision something
                came back about which a later decision stands, or image points that have been
                measured again since; nothing has changed then.
        """
        return self._changed("revoke", manual_decisions.revoke(self._state, ids, self._rules))

    @one_at_a_time
    def snoop(self, /, **options: Any) -> Snooping:
        """Search the whole network for gross errors, and reject the observations found.

        Args:
            options: as those of `factorgraph_adj.snoop`.

        These observations are then among ``rejected``; only the returned result has their figures.
        Observations that fit without them are readmitted, as after `remove`: ``latest`` has their
        verdicts, while the returned solution is the one without them.

        Raises:
            InputError: nothing is in the graph, or something was retired.
        """
        if self.retired is not None:
            raise InputError(
                "a search for gross errors examines all observations, and some are retired: take "
                "them back first (settle(all=True)), or search before they are retired"
            )
        chosen = {"alpha": self.alpha, **options}
        there = self.network(), self.solution()
        after, self.latest, found = commands.snooped(self._state, *there, self._rules, chosen)
        if after is not self._state:
            self._changed("snoop", (after, self.latest))
        return found

    @one_at_a_time
    def retire(
        self,
        *,
        points: str | Iterable[str] = (),
        photos: str | Iterable[str] = (),
        before: str | None = None,
    ) -> None:
        """Retire points and photos that nothing new will touch, with all their observations.

        The information of these observations on everything else is kept as linear rows, so that the
        remaining unknowns keep their estimates and covariances, while memory and time are those of
        the remaining network. Orientations of sets that nothing else observes are retired too. A
        later observation that names something retired is refused. `settle` takes everything back.

        Args:
            points: names of points; held ones may be among them: ``retired`` names these, as no new
                observation can use them.
            photos: names of photos.
            before: id of an observation, or name of a photo: what nothing has touched since before
                its arrival is retired as well, except given points; photos whose points remain
                stay.

        Raises:
            InputError: all names that do not exist or are retired already, and points for which
                something else was stated; a free network; nothing would remain.
            AdjustmentError: there is no minimum. Nothing has changed then.
        """
        wanted: list[Variable] = [("point", name) for name in ids_in(points)]
        wanted += [("pose", name) for name in ids_in(photos)]
        between: list[str] = []
        if before is not None:
            ledger = self._state.ledger
            since = retirement_window.command_of(ledger, before)
            wanted += retirement_window.untouched(ledger, since)
            between = retirement_window.observations_between_given(ledger, since)
        if wanted or between:
            self._retire(dict.fromkeys(wanted), between)

    def _forget(self) -> None:
        """Retire what is due; where that fails, report it, and try again some photos later."""
        rules, ledger = self._rules, self._state.ledger
        reached = retirement_window.extent(ledger, rules)
        if not rules.forgets or reached < self._next_try:
            return
        if rules.keep_seconds is not None:  # time passes, whatever is retired
            self._next_try = reached + retirement_window.lot_of(rules)
        (found, between), arrival = retirement_window.due_for_retirement(ledger, rules), self.latest
        if not found:
            return
        self._not_retired = ""
        try:
            self._retire(found, between)
        except AdjustmentError as error:  # InputError among them
            self._not_retired = f"what is due cannot be retired: {error}"
        if rules.keep is not None:
            self._next_try = reached + 1 if self._not_retired else 0
        self.latest = arrival

    def _retire(self, variables: Collection[Variable], between: Collection[str]) -> None:
        """Retire unknowns, and observations between given points; write it to the journal."""
        state, line = retirement.retire(self._state, variables, self._rules, between)
        if self._journal is not None:
            estimates = self._recorded.next_line(self._state.ledger, state, everything=True)
            self._journal.append({"do": "retire", "retired": line} | estimates.fields())
            self._recorded.written(estimates)
        self._state, self.latest = state.recorded(), Arrival()
        self._copies = CopiedBlocks().add(self._state.ledger.observations())

    @one_at_a_time
    def settle(self, *, all: bool = False) -> None:
        """Iterate to convergence: no estimate is further than 1e-6 σ from the batch adjustment's.

        Where rounding errors are larger than that, as in networks that are hardly determined, the
        distance is no larger than that between batch adjustments from nearby start values. In a
        free network the coordinates are then on the inner constraints over all datum points. Where
        something was retired, the batch adjustment is that of the remaining observations with the
        linear rows of the retired ones.

        Args:
            all: take back everything that was retired first.

        Raises:
            AdjustmentError: there is no minimum with the retired observations; they stay retired.
            InputError: another observation has the id of a retired one, which stays retired.
        """
        if all and self._state.ledger.retired is not None:
            before = self._state
            taken = retirement.taken_back(before, self._rules)
            self._state = taken
            try:
                result = commands.settle(taken, self._rules)
                self._changed("settle", result, {"taken_back": True})
                self._copies = CopiedBlocks().add(self._state.ledger.observations())
            except BaseException:
                self._state = before
                raise
        elif self._state.system is not None or self.n_waiting:
            self._changed("settle", commands.settle(self._state, self._rules))
