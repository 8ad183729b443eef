"""Determinability of waiting unknowns: which may enter, their start values, reasons of the others.

A waiting variable enters with all observations that join it to known or entering variables. Counts
of observations come first, then approximate values, then the rank: with known variables held, the
partials by the others must have full column rank, because nothing else can hold them. Variables
that the null space moves stay, with their observations, and the rest is examined again. So does a
point that may be anywhere, see `factorgraph_adj.solve.doubtful_points`.

The result is the largest set of variables that determines itself. It does not depend on the order
in which its observations arrived: more observations make it larger, never smaller.

"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError, DatumError, InputError, Problem, Unreached
from ..graph.dependence import Variable
from ..graph.equations import Equations, compile_network, compile_rows
from ..graph.variables import State
from ..ledger.excerpts import excerpt
from ..ledger.waiting_observations import Candidates, NothingKnown
from ..models.unknown_registry import UNKNOWNS
from ..network.network import DatumChoice, Network
from ..orientation.block_start import BlockStart
from ..orientation.choice_of_start import choose_start
from ..solve.doubtful_points import vague_points, vague_points_at
from ..solve.feasible_states import state_off_lines
from ..solve.linearised_equations import LinearisedEquations
from ..solve.minimum import adjust_from_start
from ..solve.normal_equations import NormalEquations, Solver
from ..solve.solution import Solution
from ..solve.undetermined_unknowns import (
    IS_NOT_DETERMINED,
    MAX_DENSE_COLUMNS,
    undetermined_variables,
)
from ..start.approximate_values import partial_approximation
from ..start.start_values import Start
from ..types import NO_ROWS, Index
from .local_network import (
    DISAGREES,
    LIMITS,
    MISMATCH,
    gauss_newton_steps,
    has_datum,
    is_undisturbed,
    may_have_datum,
    orientation_methods,
    oriented_block,
    without_blunders,
)

ABSURD = "some value is absurdly large"
RUNS_AWAY = "its observations hardly determine it: their adjustment runs away"
NOWHERE = "has no datum yet: nothing that it is connected with is known, held or weighted"


@dataclass(frozen=True)
class Enterable:
    """Observations and unknowns that may enter."""

    rows: Index
    """Observations that may enter; empty: none."""
    solution: Solution | None
    """Their adjustment with what is known held; None: there is none, or nothing enters."""
    lacks: Mapping[Variable | str, str]
    """What the waiting variables lack that do not enter, and observations, by first ids."""
    oriented: Mapping[str, str] = field(default_factory=dict)
    """How the photos without poses were oriented that enter, by name."""
    start: Start | None = None
    """Where they are; None: nothing enters."""
    parts: tuple[Index, ...] = ()
    """The observations, in unconnected parts."""
    equations: Equations | None = None
    """These and the observations between known variables that enter too, with known variables as
    they were described; None: not compiled."""

    @property
    def is_disturbed(self) -> bool:
        """Whether gross errors, or weak variables that were held, have displaced it."""
        return self.solution is not None and self.solution.sigma0 > LIMITS.disturbed

    def without_blunders(self, alpha: float) -> Enterable:
        """Return it with start values from an adjustment without significant observations.

        Args:
            alpha: probability of a false alarm of the tests that find them.
        """
        if self.solution is None or not self.is_disturbed:
            return self
        clean = without_blunders(self.solution, alpha)
        return replace(self, solution=clean, start=Start.of(clean))


class ApproximateNetwork(NamedTuple):
    """A network with approximate values at which it is determined."""

    equations: Equations
    """The network."""
    state: State
    """The values."""
    solver: Solver | None
    """Its elimination, with its normal equations at the values; None: the network is small."""
    rows: Index
    """Its observations."""


@dataclass
class DeterminabilitySearch:
    """A search among observations that open variables join."""

    left: Candidates
    """The observations that may still enter."""
    datum: DatumChoice
    """``free`` for the beginning of a free network."""
    lacks: dict[Variable | str, str]
    """What variables lack that do not enter, and observations, by their first ids."""
    several: bool = False
    """Whether there are several parts, none of which is connected with another."""
    block: BlockStart | None = None
    """Photos that were oriented from image points; None: there was no need, or no way."""
    _reached: ApproximateNetwork | None = None
    """The local network with its approximate values; None: something has none."""

    def find(self, *, start: Solution | None) -> Enterable | None:
        """Find what may enter, and its values.

        None: one of several parts disagrees, or is disturbed, and each has to be examined
            separately.

        Args:
            start: the solution before, if there was one; None: approximate values are computed.
        """
        while len(self.counted().rows):
            local = self._excerpt()
            if local is None:
                self.lacks |= dict.fromkeys(self.left.counts, NOWHERE)
                break
            lost: set[Variable] = set()
            whys: dict[Variable, str] = {}
            bad = NO_ROWS
            try:
                equations = compile_rows(local)
                lost = self._unreachable(equations)
                if lost and self.several and not any(v[0] in ("point", "pose") for v in lost):
                    return None  # one part without values keeps values from the others
                if not lost and len(bad := self._mismatches()):
                    self.left = self.left.only(np.setdiff1d(self.left.rows, bad))
                    continue
                if not lost:
                    solution = self._adjusted(local, start)
                    lost = self._anywhere(solution)
                    if (
                        not lost
                        and self.several
                        and not (solution.converged and is_undisturbed(solution))
                    ):
                        return None
                    # Disagreeing observations may converge without their gross errors, slow ones
                    # where everything else moves too.
                    disturbed = solution.sigma0 > LIMITS.disturbed
                    alone = isinstance(self.left.known, NothingKnown)
                    if not lost and (solution.converged or disturbed or not alone):
                        how = orientation_methods(local, self.block)
                        return Enterable(
                            self.left.rows, solution, self.lacks, how, Start.of(solution)
                        )
                    whys = self._disagreeing(solution.reason)
            except OverflowError:
                whys = dict.fromkeys(self.left.counts, ABSURD)
            except AdjustmentError as error:
                lost, bad = self._named(error)
                why = RUNS_AWAY if isinstance(error, DatumError) else str(error)
                whys = dict.fromkeys(self.left.counts, why)
            if lost:
                self.left = self.left.without(lost)
            elif len(bad):
                self.left = self.left.only(np.setdiff1d(self.left.rows, bad))
            elif self.several:
                return None
            else:
                self.lacks |= whys
                self.left = self.left.only(well_determined(self.left))
        return Enterable(NO_ROWS, None, self.lacks)

    def at_once(self, ready: Index = NO_ROWS) -> Enterable:
        """Find what may enter without an adjustment of its own, because all of it is determined.

        Approximate values of everything follow from its readings and from known variables. Nothing
        enters where a part of it needs closer examination, and where cameras see it: see `find`.

        Args:
            ready: observations between known variables that are to be compiled with them.
        """
        nothing = Enterable(NO_ROWS, None, self.lacks)
        rows = self.left.rows
        if len(self.counted().rows) < len(rows) or len(self.left.ledger.rows.images(rows)):
            return nothing
        with suppress(AdjustmentError, OverflowError):
            known = self.left.known
            every = np.union1d(rows, ready)
            local = excerpt(self.left.ledger, known, every, datum=self.datum, hold=False)
            if not (has_datum(local) or len(self.left.beside_known)):
                return nothing
            compiled = compile_rows(local)
            held = compiled.unknowns.holding(known.known)
            equations = replace(compiled, unknowns=held)
            origin, problems = partial_approximation(equations, datum=self.datum)
            if problems:
                return nothing
            state = state_off_lines(equations, origin)
            system = LinearisedEquations(equations.weighted_at(state), state)
            weak = undetermined_variables(
                system, state, free=False, least=LIMITS.share
            ) or vague_points_at(system)
            if not weak:
                with np.errstate(over="ignore", invalid="ignore"):
                    near = gauss_newton_steps(system)
                if near is None:
                    return nothing
                start = Start(held, near, origin)
                return Enterable(rows, None, self.lacks, start=start, equations=compiled)
        return nothing

    def determined(self) -> tuple[Candidates, ApproximateNetwork | None]:
        """Return observations whose variables have full rank together, at approximate values.

        Whether their adjustment converges is not examined. The others may still be determined
        among themselves: `find` examines them more closely.

        Returns:
            The observations; their network, None where photos were oriented.
        """
        if self.datum == "given":
            self._leave_out_unplaced()
        with suppress(AdjustmentError, OverflowError):  # `find` names the observations
            while len((left := self.counted(())).rows):
                equations = compile_rows(self._local())
                lost = self._unreachable(equations)
                if lost:
                    self.left = left.without(lost)
                elif len(bad := self._mismatches()):
                    self.left = left.only(np.setdiff1d(left.rows, bad))
                else:
                    return left, self._reached
        return self.left.only(NO_ROWS), None

    def counted(self, about: Collection[Variable] | None = None) -> Candidates:
        """Let those wait whose open variables have fewer rows than components; return the rest.

        about: variables for which a reason is recorded; None: all.
            about: variables of which it is said what they lack; None: all.
        """
        first, needs = self.left, self.left.ledger.needs
        self.left, few = first.counted()
        for v, n in few.items():
            if about is None or v in about:
                size, own = needs(v)
                between = " are between things that can be determined"
                of_known = "" if first.counts[v] == n else between
                need = f"{n + own} of the {size} readings that it needs{of_known}"
                self.lacks[v] = f"{_noun(v)} has {first.describe(v)}: {need}"
        return self.left

    # -- steps --------------------------------------------------------------------------------

    def _excerpt(self) -> Network | None:
        """Return the local network; None where nothing determines its position."""
        local = self._local()
        return local if self.datum == "free" or has_datum(local) else None

    def _local(self) -> Network:
        return excerpt(self.left.ledger, self.left.known, self.left.rows, datum=self.datum)

    def _leave_out_unplaced(self) -> None:
        """Leave out the parts whose position nothing determines: they need no search."""
        left = self.counted(())
        parts = left.parts(by_geometry=True)
        if len(parts) < 2:
            return
        of_each = (excerpt(left.ledger, left.known, part) for part in parts)
        stay = [p for p, n in zip(parts, of_each, strict=True) if has_datum(n) or may_have_datum(n)]
        self.left = left.only(np.sort(np.concatenate([NO_ROWS, *stay])))

    def _adjusted(self, local: Network, start: Solution | None) -> Solution:
        """Adjust from the solution before; from approximate values where that fails."""
        tolerance = LIMITS.at_rest if self.datum == "free" else 1e-4
        if start is not None:
            with suppress(AdjustmentError):
                solution = self._adjusted_from(local, start, tolerance)
                if solution.converged:
                    return solution
        return self._adjusted_from(local, self._begun(), tolerance)

    def _begun(self) -> Start | None:
        """Return the start values from image points; None: approximate values are computed."""
        return None if self.block is None else self.block.start

    def _mismatches(self) -> Index:
        """Return the image points that do not agree with the block that was oriented."""
        doubtful = () if self.block is None else self.block.doubtful
        found = np.intersect1d(self.left.ledger.find(doubtful), self.left.rows)
        self.lacks |= dict.fromkeys(self.left.ledger.ids_of(found), MISMATCH)
        return found

    def _adjusted_from(
        self, local: Network, start: Solution | Start | None, bound: float
    ) -> Solution:
        equations, free = compile_network(local), self.datum == "free"
        begin = choose_start(equations, self.datum, start)
        return adjust_from_start(equations, begin, free=free, tolerance=bound)

    def _anywhere(self, solution: Solution) -> set[Variable]:
        """Return waiting points whose readings do not determine where they are."""
        lost: set[Variable] = set()
        for point in vague_points(solution):
            if not self.left.known.known("point", point.name):
                lost.add(("point", point.name))
                self.lacks["point", point.name] = str(point)
        return lost

    def _disagreeing(self, reason: str) -> dict[Variable, str]:
        """Return the reasons of the variables whose observations do not converge together.

        They have approximate values, which lead to no minimum: one observation may be grossly
            wrong.
        """
        return {
            v: f"{_noun(v)} has {self.left.describe(v)}, which agree nowhere: {reason}"
            for v in self.left.counts
        }

    def _unreachable(self, equations: Equations) -> set[Variable]:
        """Return variables without approximate values, or that the observations do not determine.

        What the null space moves stays undetermined without the others, too. In a free network the
        largest part that it moves as a whole is the network itself.
        """
        state, problems = partial_approximation(equations, datum=self.datum, apart=self.several)
        self._reached = None
        lost: set[Variable]
        if problems:
            state, problems, lost = self._oriented(equations, state, problems)
            if lost:
                return lost
        lost = {
            (kind, table.names[i])
            for kind, table in (equations.unknowns.tables if problems else {}).items()
            for i in np.flatnonzero(np.isnan(state[kind]).any(axis=1)).tolist()
        }
        lost = {v for v in lost if v[0] in ("point", "pose")} or lost
        self.lacks |= {v: _why(problems, v) for v in lost}
        if lost:
            return lost
        weighted = equations.weighted_at(beside := state_off_lines(equations, state))
        solver = Solver.of(weighted) if equations.unknowns.n_columns > MAX_DENSE_COLUMNS else None
        normal = None if solver is None else NormalEquations(solver, beside)
        system = LinearisedEquations(weighted, beside) if normal is None else normal.system
        found = undetermined_variables(
            system, beside, free=self.datum == "free", least=LIMITS.share, normal=normal
        )
        if not problems and self.block is None:
            if solver is not None and not found:
                solver.made = normal
            self._reached = ApproximateNetwork(equations, state, solver, self.left.rows)
        for v, why in found.items():
            by = f" by {self.left.describe(v)}" if why == IS_NOT_DETERMINED else ""
            self.lacks[v] = f"{_noun(v)} {why}{by}"
        return set(found)

    def _oriented(
        self, equations: Equations, state: State, problems: list[Problem]
    ) -> tuple[State, list[Problem], set[Variable]]:
        """Return a state from image points, variables without a value, and those not oriented."""
        begun = self._begun()
        if (found := None if begun is None else begun.for_unknowns(equations.unknowns)) is not None:
            return found.state, [], set()
        self.block = block = oriented_block(equations, self.datum, state, problems)
        if block is None:
            return state, problems, set()
        lost: set[Variable] = {("pose", name) for name in block.unoriented}
        lost |= {("point", name) for name in block.unreached}
        lost &= self.left.counts.keys()
        self.lacks |= {v: f"{_noun(v)}: {block.unoriented.get(v[1], DISAGREES)}" for v in lost}
        if block.start is None:
            self.block = None
            return state, problems, lost
        return block.start.state, [], lost

    def _named(self, error: AdjustmentError) -> tuple[set[Variable], Index]:
        """Return the waiting points that an error names; observations without such points."""
        lost: set[Variable] = set()
        bad: list[int] = []
        if isinstance(error, DatumError):
            lost = _points_first(self.left.counts.keys() & set(error.unknowns))
            for v in lost:
                self.lacks[v] = f"{_noun(v)} {IS_NOT_DETERMINED} by {self.left.describe(v)}"
        elif isinstance(error, InputError):
            about = _labels(self.left)
            for p in error.problems:
                where = p.where or ""
                # The observation, or one of its components.
                row, points = about.get(where, about.get(where.rpartition(" ")[0], (-1, set())))
                lost |= points
                self.lacks |= dict.fromkeys(points, str(p))
                if row >= 0 and not points:
                    bad.append(row)
                    self.lacks[self.left.ledger.ids_of(np.array([row]))[0]] = str(p)
        return lost, np.array(bad, dtype=np.intp)


def determined_in_parts(
    every: Candidates,
    parts: Sequence[Index],
    datum: DatumChoice,
    lacks: dict[Variable | str, str],
    *,
    start: Solution | None,
) -> list[Enterable]:
    """Find what may enter of parts that open variables join; see `DeterminabilitySearch`.

    Small ones beside known variables are examined together, and in halves where that fails.
    """
    beside = every.beside_known
    small = [
        datum == "given" and len(p) <= LIMITS.small and bool(np.isin(p, beside).any())
        for p in parts
    ]
    todo = [[p] for p, together in zip(parts, small, strict=True) if not together]
    if any(small):
        todo.append([p for p, together in zip(parts, small, strict=True) if together])
    out = []
    while todo:
        some, own = todo.pop(0), dict[Variable | str, str]()
        rows = every.only(np.sort(np.concatenate(some)))
        search = DeterminabilitySearch(rows, datum, own, several=len(some) > 1)
        found = search.find(start=start)
        if found is None:
            half = len(some) // 2
            todo[:0] = [some[:half], some[half:]]
            continue
        lacks |= own
        if found.solution is not None:
            left = (p[np.isin(p, found.rows)] for p in some)
            out.append(replace(found, parts=tuple(p for p in left if len(p))))
    return out


def well_determined(left: Candidates) -> Index:
    """Return candidates without those of points that have hardly more readings than they need.

    These readings add next to nothing to what else enters, and a wrong one prevents a solution of
    all of it. Nothing is returned where there are no such points, or nothing else.
    """
    weak = set()
    for v, n in left.counts.items():
        if v[0] == "point":
            size, own = left.ledger.needs(v)
            if n + own <= size + LIMITS.spare:
                weak.add(v)
    rest = left.without(weak)
    return rest.rows if weak and rest.counts else NO_ROWS


def _noun(variable: Variable) -> str:
    return f"{UNKNOWNS[variable[0]].noun} {variable[1]!r}"


def _points_first(variables: Iterable[Variable]) -> set[Variable]:
    """Return the points of variables, if any: a photo may do without one of its points."""
    found = set(variables)
    return {v for v in found if v[0] == "point"} or found


def _why(problems: Sequence[Problem], variable: Variable) -> str:
    """Return the reason that names a variable."""
    kind, name = variable
    for p in problems:
        if isinstance(p, Unreached):
            if name in p.names and p.noun in UNKNOWNS[kind].noun:
                return p.of(name)
        elif name in (p.where or ""):
            return str(p)
    return str(problems[0])


def _labels(left: Candidates) -> dict[str, tuple[int, set[Variable]]]:
    """Return the row of every observation by its label, and its open points; photos by name."""
    out: dict[str, tuple[int, set[Variable]]] = {}
    for row, variables in zip(left.rows.tolist(), left.lacking(), strict=True):
        points = {v for v in variables if v[0] == "point"}
        out |= {o.label(): (row, points) for o in left.ledger.unit(row).observations}
    return out | {f"photo {v[1]!r}": (-1, {v}) for v in left.counts if v[0] == "pose"}
