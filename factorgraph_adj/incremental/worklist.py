"""Incremental state, and the worklist by which observations enter it, wait, or fail their tests.

A task is a set of observations to be examined. Each round takes a task, finds which of its
observations, and of those that wait with them, are determined (`determinability`), lets these
enter, and tests them. Where no solution is reached, observations wait on, and smaller tasks come
onto the list. States are values: after an error the state from which the loop began is unchanged.

"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from ..errors import AdjustmentError, InputError, known
from ..graph.dependence import Variable
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..ledger.verdicts import Verdict
from ..ledger.waiting_observations import Candidates, known_in
from ..linear_system import engines
from ..linear_system.front_system import FrontSystem
from ..linear_system.isam2_system import ISAM2System
from ..linear_system.linear_system import LinearSystem
from ..linear_system.rebase import EFFORT, Draft
from ..linear_system.section_choice import is_due
from ..linear_system.staged_rebase import Renewal, next_stage
from ..network.network import DatumChoice
from ..solve.solution import Solution
from ..types import NO_ROWS, Index
from .determinability import DeterminabilitySearch, Enterable, determined_in_parts, well_determined
from .entry import Entry, EntryResult
from .nonlinear_tests import (
    MAX_UNITS_TESTED,
    contradicted_reading,
    may_bend,
    tested_by_readjustment,
    with_current_sides,
)

TOO_WEAK = "is determined too weakly yet: no solution was reached with it"
MAX_GIVEN_POINTS_NAMED = 6
"""Largest number of given points that a message names."""
OPEN = (
    "it fixes a motion that the datum of the free network left open, and other parts of the "
    "network need such observations too"
)
Verdicts: TypeAlias = dict[str, Verdict]
"""The latest verdict on each tested observation, by id."""


@dataclass(frozen=True, eq=False)
class IncrementalState:
    """State of an incremental adjustment; every command returns another one."""

    ledger: Ledger
    """Everything that has arrived."""
    system: LinearSystem | None = None
    """The linear system; None: nothing is determined."""
    settled: bool = True
    """Whether nothing has changed since it converged."""
    renewal: Renewal | None = None
    """A new base under construction; None: there is none."""
    refused: engines.RefusedNetwork | None = None
    """The network that iSAM2 refused; None: it has not."""

    @cached_property
    def fronts(self) -> FrontSystem | None:
        """The network in fronts, all of it in the base or a section.

        Raises:
            AdjustmentError: there is no minimum.
        """
        return engines.with_border_adjusted(self.system, self.ledger)

    def on_fronts(self) -> IncrementalState:
        """Return the state with its network in fronts; errors as of `fronts`."""
        return replace(self, system=self.fronts)

    def recorded(self) -> IncrementalState:
        """Return the state without what was noted for the journal."""
        ledger, new = self.ledger.recorded()
        if new is None:
            return replace(self, ledger=ledger)
        system = None if self.system is None else self.system.renumbered(new)
        return replace(self, ledger=ledger, system=system, renewal=None)


class Task(NamedTuple):
    """Observations to be examined."""

    rows: Index
    """The observations; they wait."""
    fixed: Index = NO_ROWS
    """Those that enter without a test."""
    asked: bool = False
    """Whether they have just arrived: degenerate geometry of one of them is an error then,
    otherwise it waits; and no other task takes them in before."""
    most: float = np.inf
    """Number of rows of the task from which it was split, because no solution was reached with all
    of it; it is then examined alone. Infinite: it was not split."""


class StateBeforeRestart(NamedTuple):
    """State of a run before everything was started again."""

    state: IncrementalState
    """The state."""
    verdicts: Verdicts
    """The verdicts until then."""
    tasks: list[Task]
    """The remaining tasks."""
    fixed: Index
    """Observations without a test."""
    task: Task
    """The task that arrived."""
    noticing: Index
    """Its observations that are sensitive to motions left open by the datum."""


def worked_off(
    state: IncrementalState,
    tasks: Collection[Task],
    rules: Options,
    *,
    start: Solution | None = None,
    growing: bool = False,
) -> tuple[IncrementalState, Verdicts]:
    """Examine observations until nothing changes.

    Args:
        state: the state; the observations of the tasks wait in its ledger.
        tasks: the observations to be examined first.
        rules: the options.
        start: the solution before, if there is one; otherwise approximate values are computed.
        growing: whether they are arrivals, so that the engine of the options takes them.

    Raises:
        InputError: names observations with degenerate geometry.
    """
    begun = in_chosen_engine(state, rules) if growing else state
    after, verdicts = Worklist(begun, list(tasks), rules, start, growing).run()
    return (replace(after, refused=begun.refused) if begun.refused else after), verdicts


def in_chosen_engine(state: IncrementalState, rules: Options) -> IncrementalState:
    """Return a state whose network is in the engine that the options choose, if it is suitable."""
    system, refused = engines.in_chosen_engine(state.system, state.ledger, rules, state.refused)
    if system is state.system and refused == state.refused:
        return state
    return replace(state, system=system, refused=refused)


class Worklist:
    """One run of the loop."""

    def __init__(
        self,
        state: IncrementalState,
        tasks: list[Task],
        rules: Options,
        start: Solution | None,
        growing: bool,
    ) -> None:
        self.state, self.tasks, self.rules, self.start = state, tasks, rules, start
        self.growing = growing
        self.verdicts: Verdicts = {}
        self._first = state.ledger, tuple(tasks)
        self.fixed: Index = np.concatenate([NO_ROWS, *(t.fixed for t in tasks)])
        self.over: StateBeforeRestart | None = None
        """State before everything was started again; None: it was not."""
        self.may_restart = rules.datum == "free"
        """Whether everything may be started again: once in a run."""

    @cached_property
    def given(self) -> Collection[str]:
        """Ids of the observations that are examined first."""
        ledger, tasks = self._first
        return {i for t in tasks for i in ledger.ids_of(t.rows)}

    def run(self) -> tuple[IncrementalState, Verdicts]:
        """Work the list off."""
        before = self.state
        self._work()
        self._test_by_adjusting(self.verdicts)
        if self.growing and isinstance(system := self.state.system, FrontSystem):
            ledger = self.state.ledger
            system, renewal = next_stage(before.renewal, ledger, system, self.rules)
            self.state = replace(self.state, system=system, renewal=renewal)
        if self.state.ledger.sides:
            self.state = self.state.on_fronts()
            ledger = with_current_sides(self.state.ledger, self.state.fronts, self.rules)
            self.state = replace(self.state, ledger=ledger)
        return self.state, self.verdicts

    def _work(self) -> None:
        while self.tasks or self.over:
            if self.tasks:
                self._look_at(self.tasks.pop(0))
                self._merge()
            else:
                self._decide_on_restart()

    def _test_by_adjusting(self, ids: Collection[str]) -> None:
        """Test again, by readjustment, observations that failed beyond linear range."""
        verdicts = [self.verdicts[i] for i in ids if i in self.verdicts]
        failed = [v.id for v in verdicts if v.verdict == self.rules.failed and v.dof]
        ledger, system = self.state.ledger, self.state.system
        if not failed:
            return
        rows = ledger.find(failed)
        if isinstance(system, ISAM2System) and not (ledger.sides or may_bend(ledger, system, rows)):
            return
        if (system := engines.in_fronts(system)) is None:
            return
        ledger, found, entered = tested_by_readjustment(
            ledger, system, rows, self.rules, self.given
        )
        self.verdicts |= {v.id: v for v in entered}
        if entered:
            self.state = IncrementalState(ledger, found, settled=False)
        self._name_contradicted(ledger, found, rows[-MAX_UNITS_TESTED:])

    def _name_contradicted(self, ledger: Ledger, system: FrontSystem, rows: Index) -> None:
        """Name the readings that alone determine a side, without which others would fit."""
        failed = self.rules.failed
        for row in ledger.rows.among(rows, failed).tolist() if ledger.sides else ():
            if doubt := contradicted_reading(ledger, system, row, self.rules):
                ids = ledger.unit(row).ids
                verdicts = {
                    i: replace(self.verdicts[i], doubt=doubt) for i in ids if i in self.verdicts
                }
                self.verdicts |= verdicts
                ledger = ledger.moved(np.array([row]), failed, "tested by adjusting", verdicts)
        self.state = replace(self.state, ledger=ledger)

    def _merge(self) -> None:
        """Adjust the whole network once its sections have taken as much time."""
        ledger, system = self.state.ledger, self.state.system
        if not isinstance(system, FrontSystem) or system.section is None:
            return
        if not is_due(system.section):
            return
        draft = Draft.of(ledger, system, self.rules.datum)
        system.whole.forget()  # two of them may be more than there is memory for
        close = min(EFFORT.again, self.rules.accuracy)
        found = draft.adjusted(self.rules.datum, tolerances=(close,))
        if not isinstance(found, FrontSystem):  # the section represents the whole a little longer
            found = replace(system, section=replace(system.section, work=0))
        elif system.section.looked is not None:
            found = replace(found, drift=system.section.looked.drift.renewed())
        self.state = replace(self.state, system=found)

    # -- one task -----------------------------------------------------------------------------

    def _look_at(self, task: Task) -> None:
        """Let those observations of a task, and of waiting ones, enter that are determined."""
        ledger, system = self.state.ledger, self.state.system
        rows = ledger.rows.among(task.rows, "waiting")  # an earlier task may have taken some in
        if not len(rows):
            return
        candidates = Candidates(ledger, known_in(system), rows)
        begins = system is None and self.rules.datum == "free"
        ready = NO_ROWS if begins else candidates.ready
        late = rows if begins else candidates.late
        if self._enters_at_once(task, candidates):
            return
        found = self._found(task, candidates, late, "free" if begins else "given")
        if begins and len(found) > 1:  # a free network is one connected part
            found = [max(found, key=lambda e: ledger.n_scalars(e.rows))]
        if found or (len(ready) and system is not None):
            self._enter(task, ready, found)
        elif len(ready):  # beside weighted unknowns, if there are any
            with suppress(AdjustmentError):
                self._enter(task, ready, found)

    def _enters_at_once(self, task: Task, candidates: Candidates) -> bool:
        """Let a task enter a tree without a local adjustment, if all of it fits there."""
        system, ready, late = self.state.system, candidates.ready, candidates.late
        if system is None or system.engine == "fronts" or self.start is not None or not len(late):
            return False
        before = self.state
        found = self._found(task, candidates, late, "given", at_once=True)
        coming = np.concatenate([NO_ROWS, *(e.rows for e in found)])
        if np.isin(late, coming).all():
            fixed = np.append(task.fixed, self.fixed)
            entering = Entry(before.ledger, system, ready, found, fixed, self.rules, self.given)
            with suppress(AdjustmentError):
                if (result := entering.at_once()) is not None:
                    self._entered(task, ready, found, result)
                    return True
        self.state = before
        return False

    def _found(
        self,
        task: Task,
        candidates: Candidates,
        late: Index,
        datum: DatumChoice,
        *,
        at_once: bool = False,
    ) -> list[Enterable]:
        """Return which observations with open variables, and which waiting ones, may enter.

        Args:
            task: the task.
            candidates: its observations.
            late: those with open variables.
            datum: ``free`` for the beginning of a free network.
            at_once: whether only those are asked for that need no adjustment of their own.
        """
        if not len(late):
            return []
        ledger = self.state.ledger
        several = late
        if task.most == np.inf:
            coming = np.concatenate([candidates.rows, *(t.rows for t in self.tasks if t.asked)])
            waiting = np.setdiff1d(ledger.having("waiting"), coming)
            several = np.union1d(late, waiting)
        lacks: dict[Variable | str, str] = {}
        touched = candidates.only(late).counts
        left = DeterminabilitySearch(candidates.only(several), datum, lacks).counted(touched)
        parts = [p for p in left.only(left.late).parts() if np.isin(p, late).any()]
        if at_once:
            ready = candidates.ready if len(parts) == 1 else NO_ROWS
            found = [
                DeterminabilitySearch(left.only(p), datum, lacks).at_once(ready) for p in parts
            ]
        else:
            found = determined_in_parts(
                left,
                parts,  # those with an observation that has just arrived
                datum,
                lacks,
                start=self.start,
            )
        self.state = replace(self.state, ledger=ledger.with_lacks(lacks))
        return found

    def _enter(self, task: Task, ready: Index, found: list[Enterable]) -> None:
        """Let observations enter with those that depend on them; see `entry`."""
        before = self.state
        fixed = np.append(task.fixed, self.fixed)
        entering = Entry(before.ledger, before.system, ready, found, fixed, self.rules, self.given)
        try:
            result = entering.run()
        except InputError as error:
            if task.asked or not self._impossible(task, ready, error):
                raise
            return
        if isinstance(result, EntryResult):
            self._entered(task, ready, found, result)
        elif result.loses_datum and self.may_restart and before.system is not None:
            self._restart(task, result.noticing)
        else:
            self._wait_on(task, ready, found)

    def _entered(
        self, task: Task, ready: Index, found: list[Enterable], result: EntryResult
    ) -> None:
        """Take over what has entered, and examine the waiting observations that it joins."""
        before = self.state
        self.verdicts |= {v.id: v for v in result.verdicts}
        self.state = IncrementalState(_with_oriented(result, found), result.system, settled=False)
        if result.system is None:
            return
        # Observations between constants have waited for anything, and those with unknowns of
        # their own for a minimum.
        if before.system is None or (before.system.doubt and not result.system.doubt):
            self.tasks.append(Task(result.ledger.having("waiting")))
        else:
            self._awake(result.new)
        if found and len(ready):
            self.tasks.insert(0, Task(ready, task.fixed))  # those that still wait

    def _impossible(self, task: Task, ready: Index, error: InputError) -> bool:
        """Let observations with degenerate geometry wait; return whether there are any."""
        ledger = self.state.ledger
        about: dict[str, str] = {}
        for p in error.problems:  # they name an observation, or one of its components
            where = p.where or ""
            about |= {where: str(p), where.rpartition(" ")[0]: str(p)}
        lacks: dict[Variable | str, str] = {}
        bad: list[int] = []
        for row, unit in zip(ready.tolist(), ledger.units(ready), strict=True):
            reasons = [about[o.label()] for o in unit.observations if o.label() in about]
            if reasons:
                lacks[unit.ids[0]] = reasons[0]
                bad.append(row)
        if bad:
            self.state = replace(self.state, ledger=ledger.with_lacks(lacks))
            self.tasks.insert(0, task._replace(rows=np.setdiff1d(task.rows, bad)))
        return bool(bad)

    def _awake(self, new: Collection[Variable]) -> None:
        """Examine waiting observations that touch variables that have become known."""
        if not new:
            return
        ledger = self.state.ledger
        waiting = Candidates(ledger, known_in(self.state.system), ledger.having("waiting"))
        if len(touching := waiting.touching(new)):
            self.tasks.append(Task(touching))

    def _wait_on(self, task: Task, ready: Index, found: Sequence[Enterable]) -> None:
        """Let entering observations wait; try the ready ones alone, and the others in parts."""
        ledger, system = self.state.ledger, self.state.system
        entering = np.unique(np.concatenate([NO_ROWS, *(e.rows for e in found)]))
        if len(ready) and found:
            self.tasks.insert(0, Task(ready, task.fixed))
        candidates = Candidates(ledger, known_in(system), entering)
        lacks = dict.fromkeys(candidates.counts, _why_no_solution(candidates))
        self.state = replace(self.state, ledger=ledger.with_lacks(lacks))
        doubted = system is not None and bool(system.doubt)
        # Fewer each time, or it would not end; without a minimum before, nothing helps.
        if not doubted and len(entering) < task.most:
            for part in self._fewer(candidates, found):
                self.tasks.append(Task(part, task.fixed, most=len(entering)))

    @staticmethod
    def _fewer(candidates: Candidates, found: Sequence[Enterable]) -> list[Index]:
        """Split a task without a solution: well-determined part first, or in halves."""
        parts = [p for e in found for p in e.parts]
        if len(parts) > 1:
            half = len(parts) // 2
            return [np.concatenate(some) for some in (parts[:half], parts[half:])]
        inside = well_determined(candidates)
        return [inside, np.setdiff1d(candidates.rows, inside)] if len(inside) else []

    # -- starting again -----------------------------------------------------------------------

    def _restart(self, task: Task, noticing: Index) -> None:
        """Examine determinability again, since an observation is sensitive to motions left open.

        Parts of a free network without such observations are loose then.
        """
        self.over = StateBeforeRestart(
            self.state, dict(self.verdicts), self.tasks, self.fixed, task, noticing
        )
        self.may_restart = False
        ledger = self.state.ledger
        inside = ledger.having("accepted")
        self.fixed = np.append(self.fixed, inside)
        ledger = ledger.moved(inside, "waiting", "anew")
        self.state = IncrementalState(ledger, None, settled=False)
        self.tasks = [Task(ledger.having("waiting"))]

    def _decide_on_restart(self) -> None:
        """Keep the result of the restart where more is determined than before.

        Otherwise the observations sensitive to motions left open wait, and the rest is examined.
        """
        assert self.over is not None
        (before, verdicts, tasks, fixed, task, noticing), self.over = self.over, None
        was, now = (s.ledger.n_scalars(s.ledger.having("accepted")) for s in (before, self.state))
        if now > was and self.state.system is not None:
            return
        self.verdicts, self.fixed, self.tasks = verdicts, fixed, tasks
        ledger = before.ledger
        lacks = {ledger.rows.ids(ledger.names, row)[0]: OPEN for row in noticing.tolist()}
        self.state = replace(before, ledger=ledger.with_lacks(lacks))
        if len(noticing):
            self.tasks.insert(0, task._replace(rows=np.setdiff1d(task.rows, noticing)))


def _why_no_solution(candidates: Candidates) -> str:
    """Return why no solution was reached with observations, by their number.

    Where there are more than their unknowns need, these are not weak: something is wrong, such as a
    gross error of given coordinates that all of them contradict.
    """
    ledger = candidates.ledger
    opened = candidates.counts
    spare = ledger.n_scalars(candidates.rows) - sum(ledger.needs(v)[0] for v in opened)
    points = ledger.network.points
    touched = (name for kind, name in candidates.links.variables if kind == "point")
    given = [name for name in touched if name in points and all(points[name].fixed)]
    if spare <= 0 or not given:
        return TOO_WEAK
    listed = known(map(repr, given), most=MAX_GIVEN_POINTS_NAMED)
    return (
        f"no solution was reached with it, though there are {spare} more readings than it takes: "
        f"given coordinates ({listed}), a name or a reading may be grossly wrong"
    )


def _with_oriented(result: EntryResult, found: Sequence[Enterable]) -> Ledger:
    """Return the ledger with the ways in which the photos that have entered were oriented."""
    entered = {name for kind, name in result.new if kind == "pose"}
    how = {name: words for e in found for name, words in e.oriented.items() if name in entered}
    ledger = result.ledger
    return replace(ledger, oriented={**ledger.oriented, **how}) if how else ledger
