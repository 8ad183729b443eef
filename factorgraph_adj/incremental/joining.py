"""Observations that enter with new variables, or so many that they make a new base.

They are judged on linear forms before anything moves, as a gross error bends everything that it
touches; then everything is adjusted, and they are judged once more. What is left without a test
of its own, because two observations contradict each other, waits on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..solve.solution import Solution
from ..types import Array
from .candidates import Candidates, known_in
from .deciding import Decision, accepted, by_id, decide, verdict
from .finding import LIMITS
from .forms import Item, items_of, together
from .inspected import Inspected
from .ledger import Ledger, Some
from .rebasing import Draft, Failure, with_doubt
from .rules import Rules
from .system import System
from .units import Variable
from .verdicts import Gain, Verdict

MOST_JUDGED = 5
"""Number of times that what enters together is judged, each time without what did not fit."""
CONTRADICT = "its observations contradict each other, and nothing tells yet which of them is wrong"
PARALLEL = "its rays are parallel by now: there is no minimum at a finite distance"
DISAGREE = "what enters together does not agree"
NO_SOLUTION = "no solution is reached with it: is it near to where its kind has no answer?"


class Entry(NamedTuple):
    """Observations that may enter, and where what enters with them is."""

    some: Some
    """The observations."""
    solution: Solution
    """Their adjustment with what is known held."""


@dataclass(frozen=True, eq=False)
class Entered:
    """Observations have entered."""

    ledger: Ledger
    """The ledger with them."""
    system: System
    """The system with them."""
    verdicts: tuple[Verdict, ...]
    """Verdicts on those that were tested."""
    new: frozenset[Variable]
    """Variables that have become known."""


@dataclass(frozen=True)
class Refused:
    """No solution was reached; nothing has changed."""

    failure: Failure
    """Why."""
    loses_datum: bool
    """Whether parts of a free network are not determined any more with what enters."""


def enter(
    ledger: Ledger,
    system: System | None,
    ready: Some,
    found: Sequence[Entry],
    fixed: Collection[str],
    rules: Rules,
    given: Collection[str],
) -> Entered | Refused:
    """Put observations in with what enters with them, and make a new base.

    Args:
        ledger: where they wait.
        system: where everything is; none: nothing is known.
        ready: observations between known variables.
        found: observations with variables that enter.
        fixed: ids of observations that are in without a test.
        rules: the options.
        given: ids of observations that did not wait before.

    Raises:
        InputError: names observations between known variables whose geometry has no answer.
    """
    return _Entering(ledger, system, ready, found, fixed, rules, given).run()


@dataclass
class _Entering:
    """Observations on their way."""

    ledger: Ledger
    system: System | None
    ready: Some
    found: Sequence[Entry]
    fixed: Collection[str]
    rules: Rules
    given: Collection[str]
    stay: list[Item] = field(default_factory=list)
    """Items that are still in."""
    new: set[Variable] = field(default_factory=set)
    """Variables that enter."""
    dropped: set[Variable] = field(default_factory=set)
    """Variables that are not known any more."""
    verdicts: list[Verdict] = field(default_factory=list)
    """Verdicts on what was left out."""

    def run(self) -> Entered | Refused:
        """Put everything in, and test it, until nothing is left out."""
        before = self.ledger
        entering = Some.of([self.ready, *(e.some for e in self.found)])
        for e in self.found:
            self._take_new(e.some)
        self._fill()
        self.ledger = self.ledger.moved(entering, "accepted", "arrival")
        self.stay = items_of(self.ledger, entering)
        starts = [e.solution for e in self.found]
        tests = any(self.rules.tests(i, self.fixed) for i in self.stay)
        doubted = self.system is not None and bool(self.system.doubt)
        base = self.system
        if tests and not doubted and not self._agrees(starts):
            held = starts[0] if base is None else base.base
            for _ in range(MOST_JUDGED):
                if not self._judged_before(self._draft(base, starts), held):
                    break
        for _ in range(MOST_JUDGED):
            if not self.stay and self.system is not None:
                return Entered(self.ledger, self.system, tuple(self.verdicts), frozenset())
            result = self._draft(base, starts).adjusted(self.rules.datum, doubted=doubted)
            if isinstance(result, System) and self.found and not result.base.converged:
                result = Failure(result.base.reason, None)  # it misses its inner constraints
            if isinstance(result, Failure):
                if not doubted and self._let_go(result):
                    continue
                return self._refused(before, result)
            base = result
            if not tests or not self._judged_after(base):
                self.verdicts += self._accepted(base)
                return Entered(self.ledger, base, tuple(self.verdicts), frozenset(self.new))
        return self._refused(before, Failure(DISAGREE, None))

    def _agrees(self, starts: Sequence[Solution]) -> bool:
        """Return whether what looked disturbed beside known variables agrees where they move too.

        Known variables may be so weak that holding them, for a start, contradicts what enters.
        """
        if self.system is None or all(s.sigma0 <= LIMITS.disturbed for s in starts):
            return False
        found = self._draft(self.system, starts).adjusted(self.rules.datum)
        return isinstance(found, System) and bool(found.base.sigma0 <= LIMITS.disturbed)

    def _draft(self, base: System | None, starts: Sequence[Solution]) -> Draft:
        return Draft.of(
            self.ledger,
            base,
            self.rules.datum,
            new=self.new,
            dropped=self.dropped,
            found=starts,
        )

    def _take_new(self, some: Some) -> None:
        self.new |= Candidates(self.ledger, known_in(self.system), some).rows.keys()

    def _fill(self) -> None:
        """Write approximate values that were found into the ledger, where none were given."""
        for e in self.found:
            unknowns = e.solution.equations.unknowns
            for kind in ("point", "pose"):
                table = unknowns[kind]
                values = {
                    n: e.solution.start[kind][table.number[n]]
                    for k, n in self.new
                    if k == kind and n in table.number
                }
                self.ledger = self.ledger.with_values(kind, values)

    # -- judging ------------------------------------------------------------------------------

    def _judged_before(self, draft: Draft, held: Solution) -> bool:
        """Judge on linear forms before anything moves; return whether anything was left out."""
        if not self.stay:
            return False
        try:
            normal, constraint = draft.normal(held)
            factor = normal.factorise(constraint)
            inspected = Inspected.of(normal, factor, self.stay)
            return self._leave_out(inspected, moved=False)
        except AdjustmentError:
            return False  # the adjustment says what is wrong

    def _judged_after(self, base: System) -> bool:
        """Judge at the minimum; return whether anything was left out."""
        return self._leave_out(self._inspected(base), moved=True)

    def _inspected(self, base: System) -> Inspected:
        return Inspected.of(base.base.normal(), base.base.factor, self.stay)

    def _leave_out(self, inspected: Inspected, *, moved: bool) -> bool:
        tested = inspected.tested(moved=moved)
        fixed = np.array([not self.rules.tests(i, self.fixed) for i in self.stay])
        held_by = inspected.held_by(dict.fromkeys(self.new))
        decision = decide(
            tested, inspected.raw, self.rules.alpha, fixed, held_by, inspected.variables
        )
        if decision.unchanged:
            return False
        self._apply(decision)
        return True

    def _apply(self, decision: Decision) -> None:
        told = []
        for i, (figures, critical) in decision.out.items():
            entered = self.stay[i].ids[0] not in self.given
            told += verdict(
                self.stay[i], self.rules.failed, figures, 0, critical=critical, entered=entered
            )
        out = together([self.stay[i] for i in decision.out])
        self.ledger = self.ledger.moved(out, self.rules.failed, "test", verdicts=by_id(told))
        back = together([self.stay[i] for i in decision.back])
        self.ledger = self.ledger.moved(back, "waiting", "contradict")
        self.ledger = self.ledger.with_lacks(dict.fromkeys(decision.loose, CONTRADICT))
        self.verdicts += told
        self.stay = [self.stay[i] for i in sorted(decision.stay)]
        known = known_in(self.system)
        observed = Candidates(self.ledger, known, together(self.stay)).rows.keys()
        lost = decision.loose | (self.new - observed)
        self.dropped |= lost
        self.new -= lost

    def _accepted(self, base: System) -> Iterator[Verdict]:
        """Iterate over the verdicts on what stays."""
        if not self.stay:
            return
        inspected = self._inspected(base)
        tested = inspected.tested(moved=True)

        def gains(i: int, m: Array) -> tuple[Gain, ...]:
            return inspected.gains(i, m, lambda n: np.diag(base.base.covariance(n)))

        asked = gains if self.rules.datum == "given" else None
        alpha = self.rules.alpha
        yield from accepted(self.stay, tested, inspected.raw, alpha, self.given, asked)

    # -- where there is no solution -----------------------------------------------------------

    def _let_go(self, failure: Failure) -> bool:
        """Let points wait whose rays run parallel; return whether there were any.

        Two rays on a short base meet somewhere until the photos turn by a little more. Other
        observations give a point a place, wherever a wild reading takes the network.
        """
        some = rays_alone(self.ledger, failure.loose or ())
        if not some:
            return False
        names = self.ledger.names
        points = np.unique(self.ledger.rays.point[some.rays]).tolist()
        self.dropped |= {("point", names.points[p]) for p in points}
        self.ledger = self.ledger.moved(some, "waiting", "parallel")
        self.ledger = self.ledger.with_lacks(dict.fromkeys(self.dropped, PARALLEL))
        left = set(some.rays.tolist())
        self.stay = [i for i in self.stay if i.row not in left]
        self.new -= self.dropped
        return True

    def _refused(self, before: Ledger, failure: Failure) -> Entered | Refused:
        """Return what becomes of observations without a solution."""
        if self.found or self.system is None:
            free = self.rules.datum == "free" and failure.loose is not None
            return Refused(failure, free)
        if self.rules.datum == "free" and failure.loose is not None:
            return Refused(failure, True)
        items = items_of(before, self.ready)
        if self.system.doubt:
            ledger = before.moved(self.ready, "accepted", "arrival")
            return Entered(ledger, self.system, (), frozenset())
        tested = [i for i in items if self.rules.tests(i, self.fixed)]
        if not tested:
            ledger = before.moved(self.ready, "accepted", "arrival")
            return Entered(ledger, with_doubt(self.system, failure.reason), (), frozenset())
        told = [
            Verdict(i, o.kind, o.label(), self.rules.failed, lacks=NO_SOLUTION, points=item.points)
            for item in tested
            for i, o in zip(item.ids, item.observations, strict=True)
        ]
        ledger = before.moved(
            together(tested), self.rules.failed, "no solution", verdicts=by_id(told)
        )
        return Entered(ledger, self.system, tuple(told), frozenset())


def rays_alone(ledger: Ledger, variables: Iterable[Variable]) -> Some:
    """Return the image points in the graph of those variables that only image points determine."""
    points = {n for kind, n in variables if kind == "point"}
    points = {n for n in points if ledger.network.points[n].sigma is None}
    for entry in ledger.entries.values() if points else ():
        if entry.outcome == "accepted":
            points.difference_update(n for kind, n in entry.unit.variables if kind == "point")
    numbers = np.array([ledger.names.point[n] for n in points], dtype=np.intp)
    inside = ledger.rays.having("accepted") & np.isin(ledger.rays.point, numbers)
    return Some((), np.flatnonzero(inside))
