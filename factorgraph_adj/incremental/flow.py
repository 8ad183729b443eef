"""The one loop: observations enter, are tested, wait, or are let go until nothing changes.

A worklist holds tasks: observations to be looked at. Each round takes a task, finds what of it,
and of what waits with it, is determined (`finding`), puts that in, and tests it. Where no solution
is reached, something waits on, and smaller tasks come onto the list. States are values; what goes
wrong leaves the state from which the loop began.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..solve.solution import Solution
from .beside import Beside
from .candidates import Candidates, Nothing, known_in
from .finding import counted, find, firm
from .joining import Entered, Entry, Refused, enter
from .ledger import Ledger, Some
from .rules import Rules
from .system import System
from .units import Variable
from .verdicts import Verdict

TOO_WEAK = "is determined too weakly yet: no solution was reached with it"
OPEN = (
    "it fixes a motion that the datum of the free network left open, and other parts of the "
    "network need such observations too"
)


@dataclass(frozen=True, eq=False)
class State:
    """Everything that an incremental adjustment is; every command returns another one."""

    ledger: Ledger
    """What has arrived."""
    system: System | None = None
    """Where everything is; none: nothing is determined."""
    settled: bool = True
    """Whether nothing has changed since it was at rest."""


class Task(NamedTuple):
    """Observations to be looked at."""

    some: Some
    """The observations; they wait."""
    fixed: frozenset[str] = frozenset()
    """Ids of those that are in without a test."""
    most: float = np.inf
    """Number of rows of what it was split from, because no solution was reached with all of it; it
    is then looked at alone. Infinite: it was not split."""


@dataclass
class Told:
    """What the loop has said of observations."""

    verdicts: dict[str, Verdict] = field(default_factory=dict)
    """The latest verdict on each tested observation, by id."""

    def take(self, verdicts: Iterable[Verdict]) -> None:
        """Take verdicts in; later ones replace earlier ones."""
        self.verdicts.update({v.id: v for v in verdicts})


def absorb(
    state: State, tasks: Collection[Task], rules: Rules, *, start: Solution | None = None
) -> tuple[State, Told]:
    """Look at observations until nothing changes.

    Args:
        state: the state; the observations of the tasks wait in its ledger.
        tasks: what is to be looked at first.
        rules: the options.
        start: where everything was, if that has been; approximate values are found otherwise.

    Raises:
        InputError: names observations whose geometry has no answer.
    """
    return _Loop(state, list(tasks), rules, start).run()


class _Loop:
    """One run of the loop."""

    def __init__(
        self, state: State, tasks: list[Task], rules: Rules, start: Solution | None
    ) -> None:
        self.state, self.tasks, self.rules, self.start = state, tasks, rules, start
        self.told = Told()
        self.given = {i for t in tasks for i in state.ledger.ids_of(t.some)}
        self.fixed: set[str] = {i for t in tasks for i in t.fixed}
        self.over: tuple[State, Some] | None = None
        """The state before everything was begun anew, and what arrived; none: it was not."""

    def run(self) -> tuple[State, Told]:
        """Work the list off."""
        while self.tasks or self.over:
            if not self.tasks:
                self._decide_whether_anew()
                continue
            self._look_at(self.tasks.pop(0))
        return self.state, self.told

    # -- one task -----------------------------------------------------------------------------

    def _look_at(self, task: Task) -> None:
        """Find what of a task, and of what waits with it, is determined, and put it in."""
        ledger, system = self.state.ledger, self.state.system
        begins = system is None and self.rules.datum == "free"
        some = ledger.among(task.some, "waiting")  # an earlier task may have taken some in
        if not some:
            return
        candidates = Candidates(ledger, known_in(system), some)
        ready = Some.none() if begins else candidates.ready
        late = candidates.only(some) if begins else candidates.only(candidates.late)
        found: list[Entry] = []
        lacks: dict[Variable, str] = {}
        if late.some:
            beside = ledger.having("waiting").less(some) if task.most == np.inf else Some.none()
            left = counted(candidates.only(late.some.joined(beside)), lacks)
            lacks = {v: why for v, why in lacks.items() if v in late.rows}
            for part in left.only(left.late).parts():
                if part.less(late.some).n_rows == part.n_rows:
                    continue  # nothing of it has just come
                entry = find(
                    left.only(part),
                    datum="free" if begins else "given",
                    blunders=self.rules.policy != "accept",
                    alpha=self.rules.alpha,
                    start=self.start,
                )
                lacks |= entry.lacks
                if entry.solution is not None:
                    found.append(Entry(entry.some, entry.solution))
        if begins and len(found) > 1:  # a free network is one connected part
            found = [max(found, key=lambda e: e.some.n_rows)]
        self.state = replace(self.state, ledger=ledger.with_lacks(lacks))
        if found or system is None:
            if found:
                self._enter(task, ready, found)
        elif ready:
            self._beside(task, ready)

    def _beside(self, task: Task, ready: Some) -> None:
        """Put observations between known variables in, beside the system where that holds."""
        system = self.state.system
        assert system is not None
        tried = Beside.of(self.state.ledger, system, ready, task.fixed | self.fixed, self.rules)
        if tried is None:
            self._enter(task, ready, [])
            return
        after = tried.state()
        if after is None:
            self._enter(task, ready, [])
            return
        self.told.take(tried.verdicts(self.given))
        self.state = State(*after, settled=False)

    def _enter(self, task: Task, ready: Some, found: list[Entry]) -> None:
        """Put observations in with what enters with them; see `joining`."""
        before = self.state
        fixed = task.fixed | self.fixed
        result = enter(before.ledger, before.system, ready, found, fixed, self.rules, self.given)
        if isinstance(result, Entered):
            self.told.take(result.verdicts)
            self.state = State(result.ledger, result.system, settled=False)
            if before.system is None:  # what lies between constants has waited for anything
                self.tasks.append(Task(result.ledger.having("waiting")))
            else:
                self._awake(result.new)
            if ready and not found:
                self.tasks.insert(0, Task(ready, task.fixed))  # those that still wait
            return
        if result.loses_datum and self.over is None and before.system is not None:
            self._begin_anew(task)
            return
        self._wait_on(task, ready, found, result)

    def _awake(self, new: Collection[Variable]) -> None:
        """Look at what waits and touches what has become known."""
        if not new:
            return
        assert self.state.system is not None
        waiting = self.state.ledger.having("waiting")
        touching = Candidates(self.state.ledger, self.state.system, waiting).touching(new)
        if touching:
            self.tasks.append(Task(touching))

    def _wait_on(self, task: Task, ready: Some, found: list[Entry], result: Refused) -> None:
        """Let what was to enter wait; try what is ready alone, and what is left in parts."""
        entering = Some.of([e.some for e in found])
        if ready and found:
            self.tasks.insert(0, Task(ready, task.fixed))
        known = known_in(self.state.system)
        candidates = Candidates(self.state.ledger, known, entering)
        lacks = dict.fromkeys(candidates.rows, TOO_WEAK)
        self.state = replace(self.state, ledger=self.state.ledger.with_lacks(lacks))
        doubted = self.state.system is not None and bool(self.state.system.doubt)
        if doubted or not entering.n_rows < task.most:
            return
        # Fewer each time, or it would not end; and nothing helps where there was no minimum before.
        for part in self._fewer(candidates, found):
            self.tasks.append(Task(part, task.fixed, most=entering.n_rows))

    @staticmethod
    def _fewer(candidates: Candidates, found: list[Entry]) -> list[Some]:
        """Split what reached no solution together: what is firm before the rest, or in halves."""
        if len(found) > 1:
            half = len(found) // 2
            return [Some.of([e.some for e in part]) for part in (found[:half], found[half:])]
        inside = firm(candidates)
        return [inside, candidates.some.less(inside)] if inside else []

    # -- beginning anew -----------------------------------------------------------------------

    def _begin_anew(self, task: Task) -> None:
        """Find out anew what is determined, now that something notices what the datum left open.

        Parts of a free network that do not notice it are loose then.
        """
        self.over = self.state, task.some
        ledger = self.state.ledger
        inside = ledger.having("accepted")
        self.fixed |= set(ledger.ids_of(inside))
        ledger = ledger.moved(inside, "waiting", "anew")
        self.state = State(ledger, None, settled=False)
        self.tasks = [Task(ledger.having("waiting"))]

    def _decide_whether_anew(self) -> None:
        """Keep what was found anew where it is more than before; otherwise the arrival waits."""
        assert self.over is not None
        (before, arrived), self.over = self.over, None
        was, now = (s.ledger.having("accepted") for s in (before, self.state))
        if now.n_rows > was.n_rows and self.state.system is not None:
            return
        self.told.verdicts.clear()
        touched = Candidates(before.ledger, Nothing(), arrived).rows
        self.state = replace(before, ledger=before.ledger.with_lacks(dict.fromkeys(touched, OPEN)))
