"""Entry of waiting observations into the linear system: tested before and after its adjustment.

They are tested on linear forms before anything moves, because a gross error displaces every unknown
that it touches; then everything is adjusted, and they are tested once more. Observations that are
left without a test of their own, because two of them contradict each other, wait on.

"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from ..errors import AdjustmentError
from ..graph.dependence import Variable
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..ledger.row_store import NO_PHOTO
from ..ledger.verdicts import Verdict
from ..ledger.waiting_observations import Candidates, known_in
from ..linear_system import engines
from ..linear_system.arrival_decisions import (
    JointTest,
    accepted_verdicts,
    decide,
    left_out,
    untested,
)
from ..linear_system.front_system import FrontSystem
from ..linear_system.joint_tests import RowsBesideBase, RowsInBase
from ..linear_system.linear_system import LinearSystem
from ..linear_system.linearisation_error import is_small, with_rest
from ..linear_system.rebase import EFFORT, Draft, NoMinimum, with_doubt
from ..linear_system.section import Attempts
from ..observations.base import is_condition
from ..quality.group_tests import LeaveOneOutTests
from ..start.start_values import Start
from ..types import NO_ROWS, Index, Mask
from .determinability import Enterable
from .local_network import LIMITS
from .nonlinear_tests import smaller_minimum

MAX_JUDGEMENTS = 5
"""Number of times that entering observations are tested, each time without those that failed."""
MAX_UNKNOWNS_ADJUSTED_FIRST = 1500
"""Largest number of unknowns of a network in which disturbed arrivals are adjusted before a search
for significant observations among them, which takes as long there."""
CONTRADICT = (
    "its observations contradict each other, and it is not known yet which of them is wrong"
)
PARALLEL = "its rays are parallel by now: there is no minimum at a finite distance"
DISAGREE = "the observations that enter together do not agree"
NO_SOLUTION = "no solution is reached with it: is its geometry nearly degenerate?"


_J = TypeVar("_J", bound=JointTest)


@dataclass(frozen=True, eq=False)
class EntryResult:
    """Observations have entered."""

    ledger: Ledger
    """The ledger with them."""
    system: LinearSystem | None
    """The system with them; None: nothing is determined."""
    verdicts: tuple[Verdict, ...]
    """Verdicts on those that were tested."""
    new: frozenset[Variable] = frozenset()
    """Variables that have become known."""


@dataclass(frozen=True)
class EntryRefusal:
    """No solution was reached; nothing has changed."""

    loses_datum: bool
    """Whether parts of a free network are no longer determined with what enters."""
    noticing: Index
    """Observations that are sensitive to motions left open by the datum."""


@dataclass
class Entry:
    """Observations that are about to enter."""

    ledger: Ledger
    """The ledger in which they wait."""
    system: LinearSystem | None
    """The system; None: nothing is known."""
    ready: Index
    """Observations between known variables."""
    found: Sequence[Enterable]
    """Observations with variables that enter."""
    fixed: Index
    """Observations that enter without a test."""
    rules: Options
    """The options."""
    given: Collection[str]
    """Ids of observations that did not wait before."""
    stay: Index = field(default_factory=lambda: NO_ROWS)
    """Observations that have not been left out."""
    new: set[Variable] = field(default_factory=set)
    """Variables that enter."""
    dropped: set[Variable] = field(default_factory=set)
    """Variables that are not known any more."""
    verdicts: list[Verdict] = field(default_factory=list)
    """Verdicts on observations that were left out."""

    def run(self) -> EntryResult | EntryRefusal:
        """Let everything enter, and test it, until nothing is left out.

        Raises:
            InputError: names observations between known variables with degenerate geometry.
        """
        before, asked = self.ledger, self.system
        self._begin()
        ahead = self._agreed(self._draft(self._fronts())) if self._agrees_first() else None
        if ahead is None:
            self._without_blunders()
            if self.system is not None and (entered := self._joined(self.system)) is not None:
                return entered
        base = self._fronts()
        doubted = base is not None and bool(base.doubt)
        if ahead is not None:
            draft = self._draft(base)
        else:
            other = None if base is asked else base
            if other is not None and (entered := self._joined(other)) is not None:
                return entered
            draft, ahead = self._prepared(base, doubted)
        for _ in range(MAX_JUDGEMENTS):
            if not len(self.stay):
                return EntryResult(self.ledger, self.system, tuple(self.verdicts))
            result = ahead or self._adjusted(draft, base, doubted)
            if isinstance(result, FrontSystem) and self.found and not result.converged:
                result = NoMinimum(result.reason)  # it misses its inner constraints
            if isinstance(result, NoMinimum):
                if doubted or not self._let_go(result):
                    return self._refused(before, result)
            else:
                base, joint = result, self._inside(result)
                if not self._tests() or not self._leave_out(joint):
                    return self._entered(base, joint)
            if len(self.stay):
                draft, ahead = self._draft(base), None
        return self._refused(before, NoMinimum(DISAGREE))

    def at_once(self) -> EntryResult | None:
        """Let everything enter without a local adjustment; None where it needs one.

        All of it is tested, whatever the policy: where something is significant, only a closer
        examination of what enters finds the reason.
        """
        assert self.system is not None
        self._begin()
        found = engines.joined_directly(
            self.system,
            self.ledger,
            self.stay,
            self._starts(),
            self.new,
            self._fits,
            self.found[0].equations if len(self.found) == 1 else None,
        )
        return None if found is None else self._entered(*found)

    def _fits(self, tested: LeaveOneOutTests) -> bool:
        return bool((tested.ratios(self.rules.alpha) <= 1.0).all())

    def _begin(self) -> None:
        """Start with all observations."""
        before = self.ledger
        for e in self.found:
            self.new |= Candidates(before, known_in(self.system), e.rows).counts.keys()
        self._fill()
        self.stay = np.unique(np.concatenate([self.ready, *(e.rows for e in self.found)]))
        self.ledger = self.ledger.moved(self.stay, "accepted", "arrival")

    def _starts(self) -> list[Start]:
        """Return the start values of the variables that enter."""
        return [e.start for e in self.found if e.start is not None]

    def _fronts(self) -> FrontSystem | None:
        """Return the network in fronts, on which everything else is based."""
        self.system = found = engines.in_fronts(self.system)
        return found

    def _joined(self, base: LinearSystem) -> EntryResult | None:
        """Join everything to a system and test it there, until nothing is left out.

        None: only a new base can take it in; everything is as it was before then.
        """
        before = replace(self, new=set(self.new), dropped=set(self.dropped), verdicts=[])
        disturbed = not base.doubt and self._tests() and self._is_disturbed()
        for _ in range(MAX_JUDGEMENTS):
            if not len(self.stay):
                return EntryResult(self.ledger, base, tuple(self.verdicts))
            try:
                found = self._agreed_beside(base) if disturbed else None
                if disturbed and found is None and is_small(base):
                    break  # a new base takes little time, and searches for other minima too
                joint = self._join(base) if found is None else None
            except AdjustmentError:
                if base.engine == "fronts" and not self.found:
                    raise  # the adjustment of all networks names what is wrong with them
                break
            with suppress(AdjustmentError):
                if joint is not None:
                    if self._tests() and self._leave_out(joint):
                        continue  # the others enter without it
                    found = self._absorbed(base, joint)
                if found is None:
                    break
                if not self._tests() or not self._leave_out(found[1]):
                    return self._entered(*found)
                continue
            break
        self.ledger, self.stay, self.verdicts = before.ledger, before.stay, []
        self.new, self.dropped = before.new, before.dropped
        return None

    def _join(self, base: LinearSystem) -> JointTest | None:
        """Join what is still in to a system, to be tested; None where the system cannot take it."""
        return engines.joined_on_trial(base, self.ledger, self.stay, self._starts(), self.new)

    def _absorbed(
        self, base: LinearSystem, joint: JointTest
    ) -> tuple[LinearSystem, JointTest] | None:
        """Return the system with what has joined it; None where a new base has to take it in.

        Observations that bring unknowns are tested at the values reached with them. Those between
        known variables are tested by their predictions, before anything moves.
        """
        found = None if base.doubt else engines.committed(base, joint, self.ledger, self.rules)
        if found is not None:
            return found, joint.renewed() if self.found else joint
        if self.found or not isinstance(joint, RowsBesideBase):
            return None
        after = joint.system if base.doubt else joint.after
        result = self._adjusted(self._draft(after), after, bool(base.doubt))
        held = result if isinstance(result, FrontSystem) else base if base.doubt else None
        return None if held is None else (held, joint)

    def _agreed_beside(self, base: LinearSystem) -> tuple[LinearSystem, JointTest] | None:
        """Return the system with what looked disturbed beside known variables; see `_agreed`."""
        vtpv, redundancy = base.vtpv, base.redundancy
        with suppress(AdjustmentError):
            joint = self._join(base)
            found = None if joint is None else self._absorbed(base, joint)
            if found is not None and _is_likely(found[0], vtpv, redundancy):
                return found
        return None

    def _prepared(
        self, base: FrontSystem | None, doubted: bool
    ) -> tuple[Draft, FrontSystem | None]:
        """Return the network to be adjusted, tested before it moves, and its base if any."""
        draft = self._draft(base)
        if doubted or not self._tests() or not self._stands_out():
            return draft, None
        agreed = None if self._agrees_first() else self._agreed(draft)
        for _ in range(MAX_JUDGEMENTS if agreed is None else 0):
            if not self._judged_before(draft, base) or not len(self.stay):
                break
            draft = self._draft(base)
        return draft, agreed

    def _agrees_first(self) -> bool:
        """Return whether disturbed observations are adjusted with everything, to see if they agree.

        In a network that is not large this takes less time than a search for significant image
        points, and a new base is needed anyway where these displace what they touch.
        """
        system = self.system
        if not isinstance(system, FrontSystem) or system.doubt or not self._tests():
            return False
        few = system.unknowns.n_columns <= MAX_UNKNOWNS_ADJUSTED_FIRST
        disturbed = [e.rows for e in self.found if e.is_disturbed]
        return few and any(len(self.ledger.rows.images(rows)) for rows in disturbed)

    def _without_blunders(self) -> None:
        """Start disturbed unknowns at their values without significant observations."""
        if self.rules.policy != "accept":
            self.found = [e.without_blunders(self.rules.alpha) for e in self.found]

    def _stands_out(self) -> bool:
        """Return whether an observation may be so wrong that it would displace what it touches."""
        solutions = [e.solution for e in self.found if e.solution is not None]
        residuals = (s.equations.residuals(s.state) for s in solutions)
        return (
            len(self.ready) > 0
            or self._is_disturbed()
            or any(np.abs(v).max() > LIMITS.gross for v in residuals)
        )

    def _entered(self, system: LinearSystem, joint: JointTest) -> EntryResult:
        gains = self.rules.datum == "given"
        verdicts = accepted_verdicts(joint, self.rules.alpha, self.given, gains=gains)
        return EntryResult(self.ledger, system, (*self.verdicts, *verdicts), frozenset(self.new))

    def _agreed(self, draft: Draft) -> FrontSystem | None:
        """Return the base where what looked disturbed beside known variables agrees with them.

        Known variables may be so weak that holding them at first contradicts what enters.
        """
        if self.system is None or not self._is_disturbed():
            return None
        found = self._adjusted(draft, self._fronts(), False)
        if not isinstance(found, FrontSystem):
            return None
        likely = _is_likely(found, self.system.vtpv, self.system.redundancy)
        return found if likely else None

    def _is_disturbed(self) -> bool:
        """Return whether what enters contradicts known variables, which are held."""
        return any(e.is_disturbed for e in self.found)

    def _draft(self, base: FrontSystem | None, *, section: bool = True) -> Draft:
        """Return the network to be adjusted: a section of a large network, if that is allowed."""
        found = self._starts()
        ledger, new, dropped = self.ledger, self.new, self.dropped
        part = None
        tries = base is None or not base.attempts.waits
        arrived = not np.isin(self.stay, self.fixed).all()  # or all was there at the start
        if section and tries and arrived and self.rules.datum == "given":
            part = Draft.of_section(ledger, base, new=new, dropped=dropped, found=found)
        if part is not None:
            return part
        return Draft.of(ledger, base, self.rules.datum, new=new, dropped=dropped, found=found)

    def _adjusted(
        self, draft: Draft, base: FrontSystem | None, doubted: bool
    ) -> FrontSystem | NoMinimum:
        """Adjust a draft; the whole network where its section is not enough."""
        attempts = Attempts() if base is None else base.attempts
        if draft.section is None:
            return _with(self._of_whole(draft, doubted), attempts.passed())
        found = draft.adjusted(self.rules.datum, doubted=doubted)
        if isinstance(found, NoMinimum) and self.found and not found.singular:
            return found  # it waits: the whole has the same values and would converge as slowly
        with suppress(AdjustmentError):  # an observation of the rest may be degenerate there
            if isinstance(found, FrontSystem) and (held := with_rest(found, self.rules.accuracy)):
                return held
        whole = self._of_whole(self._draft(base, section=False), doubted)
        return _with(whole, attempts.failed())

    def _of_whole(self, draft: Draft, doubted: bool) -> FrontSystem | NoMinimum:
        """Adjust the whole; after a period without a minimum, keep the better of two."""
        found = draft.adjusted(self.rules.datum, doubted=doubted)
        if doubted and isinstance(found, FrontSystem):
            return smaller_minimum(draft, found, self.rules.datum, tolerances=(EFFORT.close,))
        return found

    def _fill(self) -> None:
        """Write computed approximate values into the ledger, where none were given."""
        for e in self.found:
            assert e.start is not None
            for kind in ("point", "pose"):
                number = e.start.unknowns[kind].number
                start = e.start.origin[kind]
                new = [n for k, n in self.new if k == kind and n in number]
                values = {n: start[number[n]].tolist() for n in new}
                self.ledger = self.ledger.with_values(kind, values)

    # -- tests --------------------------------------------------------------------------------

    def _untested(self) -> Mask:
        """Return which observations stay whatever their tests say: conditions among them."""
        if self.rules.policy == "accept":
            return np.ones(len(self.stay), dtype=bool)
        out = np.isin(self.stay, self.fixed)
        others = np.flatnonzero(self.ledger.rows.photo[self.stay] == NO_PHOTO)
        units = self.ledger.units(self.stay[others])
        own = [any(is_condition(o) for o in unit.observations) for unit in units]
        out[others] |= np.array(own, dtype=bool)
        return np.asarray(out)

    def _tests(self) -> bool:
        return not self._untested().all()

    def _inside(self, base: FrontSystem) -> RowsInBase:
        return RowsInBase.of_system(base, self.ledger.units(self.stay))

    def _judged_before(self, draft: Draft, base: FrontSystem | None) -> bool:
        """Test on linear forms before anything moves; return whether anything was left out."""
        held = self.found[0].solution if self.found and base is None else None
        held = base.datum_solution if base is not None else held
        try:
            normal, constraint = draft.normal(held)
            factor = normal.factorise(constraint)
            return self._leave_out(RowsInBase.of(normal, factor, self.ledger.units(self.stay)))
        except AdjustmentError:
            return False  # the adjustment reports what is wrong

    def _leave_out(self, joint: JointTest) -> bool:
        """Leave out what fails its test; return whether anything was left out."""
        if not len(self.stay):
            return False
        alpha, failed = self.rules.alpha, self.rules.failed
        decision = decide(joint, alpha, self._untested(), self.new)
        if not decision.out and not decision.back:
            return False
        verdicts = list(left_out(joint, decision, failed, alpha, self.given))
        self.verdicts += verdicts
        out, back = self.stay[list(decision.out)], self.stay[decision.back]
        ledger = self.ledger.moved(out, failed, "test", {v.id: v for v in verdicts})
        ledger = ledger.moved(back, "waiting", "contradict")
        self.ledger = ledger.with_lacks(dict.fromkeys(decision.loose, CONTRADICT))
        self.stay = self.stay[sorted(decision.stay)]
        observed = Candidates(self.ledger, known_in(self.system), self.stay).counts.keys()
        lost = decision.loose | (self.new - observed)
        self.dropped |= lost
        self.new -= lost
        return True

    # -- where there is no solution -----------------------------------------------------------

    def _let_go(self, failure: NoMinimum) -> bool:
        """Let points with parallel rays wait; return whether there were any.

        Two rays on a short base intersect until the photos turn by a little more. Other
        observations determine the point, wherever a gross error takes the network.
        """
        rays = sole_rays(self.ledger, failure.loose or ())
        if not len(rays):
            return False
        names = self.ledger.names
        points = np.unique(self.ledger.rows.point[rays]).tolist()
        self.dropped |= {("point", names.points[p]) for p in points}
        self.ledger = self.ledger.moved(rays, "waiting", "parallel")
        self.ledger = self.ledger.with_lacks(dict.fromkeys(self.dropped, PARALLEL))
        self.stay = np.setdiff1d(self.stay, rays)
        self.new -= self.dropped
        return True

    def _refused(self, before: Ledger, failure: NoMinimum) -> EntryResult | EntryRefusal:
        """Return the result for observations without a solution."""
        system = self._fronts()
        free = system is not None and system.is_free
        loses_datum = free and failure.loose is not None
        if self.found or system is None or loses_datum:
            return EntryRefusal(loses_datum, self._noticing() if loses_datum else NO_ROWS)
        self.stay = self.ready
        tested = self.ready[~self._untested()]
        if system.doubt or not len(tested):
            system = system if system.doubt else with_doubt(system, failure.reason)
            kept = [v for u in before.units(self.ready) for v in untested(u, "accepted")]
            ledger = before.moved(self.ready, "accepted", "arrival")
            return EntryResult(ledger, system, tuple(kept))
        failed = self.rules.failed
        verdicts = [v for u in before.units(tested) for v in untested(u, failed, NO_SOLUTION)]
        ledger = before.moved(tested, failed, "no solution", {v.id: v for v in verdicts})
        return EntryResult(ledger, system, tuple(verdicts))

    def _noticing(self) -> Index:
        """Return the observations sensitive to motions left open by a free network's datum."""
        system = self._fronts()
        if system is None:
            return NO_ROWS
        ids = [u.ids for u in self.ledger.units(self.stay)]
        assert system.datum_solution is not None
        return self.stay[self._draft(system).noticing(system.datum_solution, ids)]


def _with(found: FrontSystem | NoMinimum, attempts: Attempts) -> FrontSystem | NoMinimum:
    """Return an adjusted network that remembers attempts to adjust sections of it."""
    return replace(found, attempts=attempts) if isinstance(found, FrontSystem) else found


def _is_likely(system: LinearSystem, vtpv: float, redundancy: int) -> bool:
    """Return whether what entered adds to vᵀPv as by chance; σ̂0 of a large network would hide it.

    Args:
        system: the system with it.
        vtpv: vᵀPv without it.
        redundancy: the redundancy without it.
    """
    spare = max(system.redundancy - redundancy, 1)
    return system.vtpv - vtpv <= LIMITS.disturbed**2 * spare


def sole_rays(ledger: Ledger, variables: Iterable[Variable]) -> Index:
    """Return the image points in the graph of those variables that only image points determine."""
    points = {n for kind, n in variables if kind == "point"}
    points = {n for n in points if ledger.network.points[n].sigma is None}
    inside = ledger.having("accepted")
    for _, unit in ledger.rows.units(inside) if points else ():
        points.difference_update(unit.points)
    numbers = np.array([ledger.names.point[n] for n in points], dtype=np.intp)
    rays = ledger.rows.images(inside)
    return np.asarray(rays[np.isin(ledger.rows.point[rays], numbers)])
