"""The cheapest additions that make a design meet its targets.

Greedy by gain for cost: how much nearer a candidate brings the targets (the sum over all items of
the logarithm of figure and limit), divided by its cost, with the covariances brought up to date
for each candidate by `factorgraph_adj.planning.covariances`, not solved anew. Then what turned
out superfluous is left out, and single and pairs of candidates are exchanged for cheaper ones.
Each proposal is checked by a plan of its own.

Where a choice leads nowhere it starts again: with an eye on observations of the design that the
choice made fail, or else without the candidate that stands in the way, one whose own observations
fail or the last. Not found are candidates that only together determine a new point.

In a free network rows B that notice a motion G of its datum, BG ≠ 0, would take its defect away:
Q' is then not Q of the inner constraints brought up to date, and the candidate is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import DatumError, InputError, Problem
from ..graph.equations import compile_network
from ..network.network import Network
from ..quality.levels import ALPHA, POWER
from ..shown import Rows, Shown
from .candidates import (
    Candidate,
    as_candidates,
    dependent,
    with_candidates,
)
from .plan import Plan, realised
from .readings import as_planned
from .search import CandidateSearch
from .targets import (
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

MOST_CHECKS = 10
"""Plans until a proposal has met its targets."""
MOST_STARTS = 12
"""Times that a proposal starts again after a choice that leads nowhere."""
MOST_PRUNED = 40
"""Candidates of a proposal of several rounds up to which each is tried without, by a plan."""
NOTICED = 1e-6
"""BG of whitened rows and motions, relative to the largest of B and of G, from which a motion is
noticed: what the datum takes for one goes unnoticed to 1e-7."""
LISTED = 12
"""Shortfalls that a message lists."""


@dataclass(frozen=True)
class Step:
    """A candidate that is proposed."""

    candidate: Candidate
    """It."""
    gain: float
    """How much nearer it brought the targets; negative where its own observations fail more."""
    lack: float
    """How far a plan with it and those before is from them; 0: met."""
    cost: float
    """Cumulative cost."""


@dataclass(frozen=True, eq=False, repr=False)
class Proposal(Shown):
    """What to add to a design."""

    steps: tuple[Step, ...]
    """Candidates in the order of gain for cost."""
    plan: Plan
    """The design with them; its targets are met."""
    before: Plan
    """The design without them."""

    @property
    def cost(self) -> float:
        """Cost of all together."""
        return self.steps[-1].cost if self.steps else 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates."""
        return tuple(s.candidate.name for s in self.steps)

    def headline(self) -> str:
        """Say how many candidates, and what they cost."""
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


def propose(
    network: Network,
    candidates: Iterable[Candidate],
    targets: Sequence[Target] | Target,
    *,
    alpha: float = ALPHA,
    power: float = POWER,
) -> Proposal:
    """Propose the cheapest additions that make a design meet its targets.

    Candidates must be complete by themselves: those that only together determine a new point are
    not found. Undetected shifts need not become smaller by more observations, so that with such
    targets a choice may be missed.

    Args:
        network: the design, determined by its own observations; see `plan`. The datum points of
            a free network stay those of the design.
        candidates: what could be added, each with a cost.
        targets: what is to be achieved; of the points of the design, and of all observations,
            those of candidates among them.
        alpha: as in `plan`.
        power: as in `plan`.

    Raises:
        InputError: no targets; bad candidates or targets; candidates that need another one, do
            not determine what they bring, or determine the datum of a free network; targets that
            all candidates together do not meet, by item; no choice was found.
        DatumError: the design itself is not determined.
    """
    wanted = as_targets(targets)
    problems = limit_problems(wanted, list(network.points))
    if not wanted:
        problems.append(Problem("there are no targets: what is to be achieved?"))
    try:
        every = as_candidates(candidates)
        needy = dependent(every, network)
        problems += needy
        # What depends on another candidate is told as such, not as unknown.
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
    # Stations and other points that come with candidates are no targets themselves.
    wanted = tuple(for_points(t, list(network.points)) for t in wanted)
    before = Plan(before.solution, before.reliability, wanted)
    if before.met:
        return Proposal((), before, before)
    _refuse_datum_changes(before, every)
    try:
        best = planner(wanted, every)
    except DatumError as error:
        raise _undetermined(error, before, every) from None
    _refuse_unreachable(before, best)
    chosen, design = _choose(planner, before, every)
    if not design.met:
        why = (
            "no choice of candidates was found that meets it (candidates that only together "
            "determine a new point, or meet a target only together, are not found)"
        )
        raise InputError([Problem(why, str(s)) for s in design.shortfalls[:LISTED]])
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
        """Plan the design with some candidates."""
        network = with_candidates(self.network, chosen)
        return realised(network, targets, problems, alpha=self.alpha, power=self.power)


def _unlike(targets: Sequence[Target], design: Plan, whole: Network) -> list[Problem]:
    """Return patterns that neither the design nor a candidate has."""
    equations = design.solution.equations
    problems = observation_problems(targets, equations)
    if problems:
        problems = observation_problems(targets, equations, compile_network(as_planned(whole)))
    return problems


def _undetermined(error: DatumError, before: Plan, candidates: Sequence[Candidate]) -> Exception:
    """Return what names the candidates that do not determine what they bring."""
    kinds = {"pose": "photo", "calibration": "camera"}
    named = {(kinds.get(kind, kind), name.split("@")[0]) for kind, name in error.unknowns}
    search = CandidateSearch.of(before, candidates, before.targets)
    problems = []
    for n, c in enumerate(candidates):
        lost = c.brings if search.told(n, search.known) is None else c.brings & named
        if lost:
            what = ", ".join(f"{kind} {name!r}" for kind, name in sorted(lost))
            problems.append(
                Problem(
                    f"its observations do not determine what it brings ({what}); candidates must "
                    "be complete by themselves",
                    f"candidate {c.name!r}",
                )
            )
    return InputError(problems) if problems else error


def _refuse_datum_changes(before: Plan, candidates: Sequence[Candidate]) -> None:
    """Raise the candidates that notice what the datum of a free network leaves open."""
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
        # By the largest row: what is left of others may be rounding.
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
    """Raise what fails the targets with all candidates, and is the design's own.

    Only what more observations cannot make worse: neither undetected shifts, nor redundancy
    numbers of correlated observations, which are no quadratic forms.
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
                for s in hopeless[:LISTED]
            ]
        )


def _of(s: Shortfall) -> str:
    return str(s).removeprefix(f"{s.item}: ")


def _choose(
    planner: _Planner, before: Plan, every: Sequence[Candidate]
) -> tuple[list[Candidate], Plan]:
    """Return a choice that meets the targets, and its plan; the nearest one where none does."""
    design_rows = _labels(before)
    left_out: set[str] = set()
    watched: set[str] = set()
    nearest: tuple[list[Candidate], Plan] = [], before
    for _ in range(MOST_STARTS):
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
    """Return what is chosen round by round, and its plan."""
    design, chosen, rounds = before, [], 0  # type: ignore[var-annotated]
    for rounds in range(1, MOST_CHECKS + 1):  # noqa: B007
        taken = {c.name for c in chosen}
        left = [c for c in among if c.name not in taken]
        search = CandidateSearch.of(design, left, before.targets, watched)
        picked = search.cheapest()
        chosen += [left[n] for n in picked]
        if picked:
            design = planner(before.targets, chosen)
        if design.met or not picked:
            break
    if design.met and rounds > 1 and len(chosen) <= MOST_PRUNED:
        # What an earlier round chose may be superfluous beside what a later one did.
        for c in sorted(chosen, key=lambda c: -c.cost):
            rest = [other for other in chosen if other is not c]
            found = planner(before.targets, rest)
            if found.met:
                chosen, design = rest, found
    return chosen, design


def _in_the_way(design: Plan, chosen: Sequence[Candidate]) -> Candidate:
    """Return the candidate whose own observations fail most, otherwise the last."""
    equations = design.solution.equations
    failing = {s.item: float(lacking(s.target, np.array([s.figure]))[0]) for s in design.shortfalls}
    lack = [
        sum(failing.get(equations.label(int(i)), 0.0) for r in equations.find(c.ids) for i in r)
        for c in chosen
    ]
    return chosen[int(np.argmax(lack))] if max(lack) > 0 else chosen[-1]


def _ordered(before: Plan, chosen: Sequence[Candidate]) -> list[Candidate]:
    """Return what was chosen by gain for cost."""
    search = CandidateSearch.of(before, list(chosen), before.targets)
    state, known = search.start.copy(), search.known.copy()
    left, out = list(range(len(chosen))), []  # type: ignore[var-annotated]
    while left:
        best = search.best(state, known, left)
        if best is None:
            # What gains nothing was chosen for observations of other candidates.
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
    """Return the steps, each with a plan of its own."""
    steps: list[Step] = []
    lack, cost = before.lack, 0.0
    for n, c in enumerate(chosen, 1):
        found = last if n == len(chosen) else planner(before.targets, chosen[:n])
        cost += c.cost
        steps.append(Step(c, lack - found.lack, found.lack, cost))
        lack = found.lack
    return tuple(steps)
