"""Proposals: the cheapest additions that make a design meet its targets, each choice planned.

The search is greedy by gain per cost. The gain of a candidate is the decrease of the lack of the
targets (the sum over all items of |ln(figure/limit)|); `factorgraph_adj.planning.candidate_search`
updates the covariances for each candidate. Then superfluous candidates are removed, and single
candidates and pairs are exchanged for cheaper ones. A separate plan checks each proposal.

If a choice does not meet the targets, the search starts again: either it also watches the
observations of the design that fail because of the choice, or it excludes one candidate, the one
whose own observations fail most or else the last. Candidates that only together determine a new
point are not found.

In a free network, rows B that determine a motion G of its datum, BG ≠ 0, would remove its datum
defect. Then Q' is not the update of the Q of the inner constraints, and the candidate is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..adjustment import determined_part
from ..blas_threads import with_one_thread
from ..errors import DatumError, InputError, Problem, taking
from ..graph.equations import compile_network
from ..network.network import Network
from ..result_display import Rows, Shown
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from .candidate_search import CandidateSearch
from .candidates import Candidate, as_candidates, as_planned, dependent, with_candidates
from .plan import Plan, realised
from .targets import (
    MAX_SHORTFALLS_LISTED,
    RedundancyNumber,
    Shortfall,
    Target,
    UndetectedShift,
    as_targets,
    for_points,
    lacking,
    limit_problems,
    observation_problems,
)

MAX_PLANS_OF_ATTEMPT = 10
"""Maximum number of rounds, each with a plan, of one attempt to meet the targets."""
MAX_ATTEMPTS = 12
"""Maximum number of attempts of a proposal."""
MAX_PRUNED_CANDIDATES = 40
"""Largest number of candidates in a proposal of several rounds for which the removal of each
candidate is tried with a plan."""
NOTICED = 1e-6
"""BG of whitened rows and motions, relative to the largest element of B times that of G, above
which the rows determine the motion; for undetermined motions rounding leaves up to 1e-7."""


@dataclass(frozen=True)
class Step:
    """A proposed candidate."""

    candidate: Candidate
    """The candidate."""
    gain: float
    """Decrease of the lack by the candidate; negative if its own observations add a larger lack."""
    lack: float
    """Lack of a plan with all candidates up to this one; 0: all targets are met."""
    cost: float
    """Cost of all candidates up to this one."""


@dataclass(frozen=True, eq=False, repr=False)
class Proposal(Shown):
    """Proposed additions to a design."""

    steps: tuple[Step, ...]
    """Candidates in the order of gain per cost."""
    plan: Plan
    """Plan of the design with the candidates; its targets are met."""
    before: Plan
    """Plan of the design without the candidates."""

    @property
    def cost(self) -> float:
        """Total cost."""
        return self.steps[-1].cost if self.steps else 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates."""
        return tuple(s.candidate.name for s in self.steps)

    def headline(self) -> str:
        """Return the number of candidates and their total cost."""
        return f"Proposal: {len(self.steps)} candidates, cost {self.cost:g}"

    def first_rows(self) -> Rows:
        """Return the steps."""
        return Rows(
            ("candidate", "cost", "together", "gain", "lack"),
            (
                (s.candidate.name, float(s.candidate.cost), float(s.cost), s.gain, s.lack)
                for s in self.steps
            ),
            len(self.steps),
        )

    def __str__(self) -> str:
        """Tabulate the steps."""
        if not self.steps:
            return "All targets are met: nothing has to be added."
        width = max(9, *(len(n) for n in self.names))
        lines = [f"{'candidate':{width}}      cost  together      gain      lack"]
        lines += [
            f"{s.candidate.name:{width}}{s.candidate.cost:10g}{s.cost:10g}{s.gain:10.3f}{s.lack:10.3f}"
            for s in self.steps
        ]
        return "\n".join(lines)


@taking(Network)
@with_one_thread
def propose(
    network: Network,
    candidates: Iterable[Candidate],
    targets: Sequence[Target] | Target,
    *,
    alpha: float = ALPHA_OF_OBSERVATION,
    power: float = POWER_OF_TEST,
    leave_out_undetermined: bool = False,
) -> Proposal:
    """Propose the cheapest additions that make a design meet its targets.

    Candidates must be complete by themselves: candidates that only together determine a new point
    are not found. More observations do not always reduce undetected shifts, so that a choice may
    be missed for such targets.

    Args:
        network: the design, determined by its own observations; see `plan`. The datum points of
            a free network stay those of the design.
        candidates: possible additions, each with a cost.
        targets: targets for the points of the design, and for all observations, including those of
            the candidates.
        alpha: as in `plan`.
        power: as in `plan`.
        leave_out_undetermined: whether what the design does not determine is left out first, see
            `determined_part`; ``plan.network.unknowns_left_out`` names it. Targets concern the
            rest, and candidates that name what was left out are refused.

    Raises:
        InputError: no targets; invalid candidates or targets; candidates that need another
            candidate, leave their new entities undetermined, or determine the datum of a free
            network; targets that all candidates together do not meet, by item; no choice found.
        DatumError: the design itself is not determined.
    """
    wanted = as_targets(targets)
    problems = limit_problems(wanted, list(network.points))
    if leave_out_undetermined:
        network = determined_part(as_planned(network))
        problems = problems or limit_problems(wanted, list(network.points))
    if not wanted:
        problems.append(Problem("there are no targets: what is to be achieved?"))
    try:
        every = as_candidates(candidates)
        needy = dependent(every, network)
        problems += needy
        # An entity of another candidate is reported as a dependency, so it is not unknown here.
        lost = {p.where for p in needy}
        alone = [c for c in every if f"candidate {c.name!r}" not in lost]
        whole = with_candidates(network, alone)
    except InputError as error:
        raise InputError([*problems, *error.problems]) from None
    planner = _Planner(network, alpha, power)
    before = planner(wanted, (), problems)
    problems += _unlike(wanted, before, whole)
    if problems:
        raise InputError(problems)
    # Targets apply to the points of the design, not to stations and other points of candidates.
    wanted = tuple(for_points(t, list(before.network.points)) for t in wanted)
    before = Plan(before.solution, before.reliability, wanted)
    if before.met:
        return Proposal((), before, before)
    _refuse_datum_changes(before, every)
    try:
        best = planner(wanted, every)
    except DatumError as error:
        raise _undetermined(error, before, every) from None
    _refuse_unobserved(best, every)
    _refuse_unreachable(before, best)
    chosen, design = _choose(planner, before, every)
    if not design.met:
        why = (
            "no choice of candidates was found that meets it (candidates that only together "
            "determine a new point, or meet a target only together, are not found)"
        )
        raise InputError([Problem(why, str(s)) for s in design.shortfalls[:MAX_SHORTFALLS_LISTED]])
    return Proposal(_steps(planner, before, _ordered(before, chosen), design), design, before)


@dataclass(frozen=True, eq=False)
class _Planner:
    """Plans of a design with candidates."""

    network: Network
    alpha: float
    power: float

    def __call__(
        self,
        targets: Sequence[Target],
        chosen: Sequence[Candidate],
        problems: Sequence[Problem] = (),
    ) -> Plan:
        """Plan the design with the chosen candidates."""
        network = with_candidates(self.network, chosen)
        return realised(network, targets, problems, alpha=self.alpha, power=self.power)


def _unlike(targets: Sequence[Target], design: Plan, whole: Network) -> list[Problem]:
    """Return patterns that match no observation of the design or of a candidate."""
    equations = design.solution.equations
    problems = observation_problems(targets, equations)
    if problems:
        problems = observation_problems(targets, equations, compile_network(as_planned(whole)))
    return problems


def _undetermined(error: DatumError, before: Plan, candidates: Sequence[Candidate]) -> Exception:
    """Return an error that names the candidates whose new entities are undetermined."""
    kinds = {"pose": "photo", "calibration": "camera"}
    named = {(kinds.get(kind, kind), name.split("@")[0]) for kind, name in error.unknowns}
    search = CandidateSearch.of(before, candidates, before.targets)
    problems = []
    for n, c in enumerate(candidates):
        lost = c.brings if search.told(n, search.known) is None else c.brings & named
        if lost:
            problems.append(_incomplete(c, lost))
    return InputError(problems) if problems else error


def _refuse_unobserved(best: Plan, candidates: Sequence[Candidate]) -> None:
    """Raise an error for candidates that bring points which nothing observes."""
    listed = {("point", name) for name in best.network.listed_points}
    problems = [_incomplete(c, lost) for c in candidates if (lost := c.brings & listed)]
    if problems:
        raise InputError(problems)


def _incomplete(candidate: Candidate, lost: set[tuple[str, str]]) -> Problem:
    """Return the problem that a candidate does not determine what it brings."""
    what = ", ".join(f"{kind} {name!r}" for kind, name in sorted(lost))
    return Problem(
        f"its observations do not determine what it brings ({what}); candidates must be complete "
        "by themselves",
        f"candidate {candidate.name!r}",
    )


def _refuse_datum_changes(before: Plan, candidates: Sequence[Candidate]) -> None:
    """Raise an error for candidates that determine a motion of the free datum."""
    if before.solution.datum is None:
        return
    motions = before.solution.datum.motions
    search = CandidateSearch.of(before, candidates, before.targets)
    design = np.full(len(search.start.q), -1, dtype=np.intp)
    places = search.place[search.linear.column]
    design[places[places >= 0]] = np.flatnonzero(places >= 0)
    problems = []
    for n, c in enumerate(candidates):
        found = search.told(n, search.known)
        if found is None:
            continue
        g = motions[design[found.at]]
        # Relative to the largest row, because small rows may be only rounding.
        size = np.abs(search.linear.rows[n].a).max() * np.abs(motions).max(axis=0)
        noticed = np.abs(found.b @ g) > NOTICED * size
        if noticed.any():
            problems.append(
                Problem(
                    "it determines position, orientation or scale of a free network, which its "
                    "datum leaves open, and so would change the figures of all points: make it "
                    "part of the design, or leave it out",
                    f"candidate {c.name!r}",
                )
            )
    if problems:
        raise InputError(problems)


def _refuse_unreachable(before: Plan, best: Plan) -> None:
    """Raise an error for items of the design that fail their targets with all candidates.

    The check covers only figures that more observations never make worse. Undetected shifts, and
    redundancy numbers of correlated observations, which are no quadratic forms, are left out.
    """
    equations = best.solution.equations
    correlated = {equations.label(int(i)) for c in equations.clusters for i in c.rows}
    own = {s.item for s in before.shortfalls}
    hopeless = [
        s
        for s in best.shortfalls
        if s.item in own
        and not isinstance(s.target, UndetectedShift)
        and not (isinstance(s.target, RedundancyNumber) and s.item in correlated)
    ]
    if hopeless:
        raise InputError(
            [
                Problem(f"cannot be met: {_of(s)} with all candidates together", s.item)
                for s in hopeless[:MAX_SHORTFALLS_LISTED]
            ]
        )


def _of(s: Shortfall) -> str:
    return str(s).removeprefix(f"{s.item}: ")


def _choose(
    planner: _Planner, before: Plan, every: Sequence[Candidate]
) -> tuple[list[Candidate], Plan]:
    """Return a choice that meets the targets, or else the one with the least lack, and its plan."""
    design_rows = _labels(before)
    left_out: set[str] = set()
    watched: set[str] = set()
    nearest: tuple[list[Candidate], Plan] = [], before
    for _ in range(MAX_ATTEMPTS):
        among = [c for c in every if c.name not in left_out]
        chosen, design = _attempt(planner, before, among, watched)
        if design.met:
            return chosen, design
        if design.lack < nearest[1].lack:
            nearest = chosen, design
        if not chosen:
            break
        spoilt = {s.item for s in design.shortfalls} & design_rows
        spoilt -= watched | {s.item for s in before.shortfalls}
        if spoilt:
            watched |= spoilt
        else:
            left_out.add(_in_the_way(design, chosen).name)
    return nearest


def _labels(design: Plan) -> set[str]:
    equations = design.solution.equations
    return {equations.label(i) for i in range(equations.n_rows)}


def _attempt(
    planner: _Planner, before: Plan, among: Sequence[Candidate], watched: set[str]
) -> tuple[list[Candidate], Plan]:
    """Return the candidates chosen round by round, and their plan."""
    design, chosen, rounds = before, [], 0  # type: ignore[var-annotated]
    for rounds in range(1, MAX_PLANS_OF_ATTEMPT + 1):  # noqa: B007
        taken = {c.name for c in chosen}
        left = [c for c in among if c.name not in taken]
        search = CandidateSearch.of(design, left, before.targets, watched)
        picked = search.cheapest()
        chosen += [left[n] for n in picked]
        if picked:
            design = planner(before.targets, chosen)
        if design.met or not picked:
            break
    if design.met and rounds > 1 and len(chosen) <= MAX_PRUNED_CANDIDATES:
        # A later round may have made a candidate of an earlier round superfluous.
        for c in sorted(chosen, key=lambda c: -c.cost):
            rest = [other for other in chosen if other is not c]
            found = planner(before.targets, rest)
            if found.met:
                chosen, design = rest, found
    return chosen, design


def _in_the_way(design: Plan, chosen: Sequence[Candidate]) -> Candidate:
    """Return the candidate whose own observations fail most, or else the last candidate."""
    equations = design.solution.equations
    failing = {s.item: float(lacking(s.target, np.array([s.figure]))[0]) for s in design.shortfalls}
    lack = [
        sum(failing.get(equations.label(int(i)), 0.0) for r in equations.find(c.ids) for i in r)
        for c in chosen
    ]
    return chosen[int(np.argmax(lack))] if max(lack) > 0 else chosen[-1]


def _ordered(before: Plan, chosen: Sequence[Candidate]) -> list[Candidate]:
    """Return the chosen candidates in the order of gain per cost."""
    search = CandidateSearch.of(before, list(chosen), before.targets)
    state, known = search.start.copy(), search.known.copy()
    left, out = list(range(len(chosen))), []  # type: ignore[var-annotated]
    while left:
        best = search.best(state, known, left)
        if best is None:
            # A candidate without a gain was chosen for observations of other candidates.
            best = next((n for n in left if search.told(n, known) is not None), None)
        if best is None:
            return out + [chosen[n] for n in left]
        known = search.take(state, known, best)
        left.remove(best)
        out.append(chosen[best])
    return out


def _steps(
    planner: _Planner, before: Plan, chosen: Sequence[Candidate], last: Plan
) -> tuple[Step, ...]:
    """Return the steps, with a separate plan for each."""
    steps: list[Step] = []
    lack, cost = before.lack, 0.0
    for n, c in enumerate(chosen, 1):
        found = last if n == len(chosen) else planner(before.targets, chosen[:n])
        cost += c.cost
        steps.append(Step(c, lack - found.lack, found.lack, cost))
        lack = found.lack
    return tuple(steps)
