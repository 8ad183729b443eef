"""New base of a linear system: batch adjustment of accepted observations, or of a section."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array

from ..errors import AdjustmentError, DatumError, SingularError
from ..graph.dependence import Variable, components
from ..graph.equations import Equations, compile_network
from ..graph.observation_selection import filtered
from ..graph.variables import MaskState, State, Unknowns
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import DatumChoice, Network
from ..orientation.choice_of_start import choose_start
from ..solve.added_factors import NO_ADDED_FACTORS, AddedFactors, Prior
from ..solve.adjustment_run import ShapeMisfit
from ..solve.datum_defects import FreeDatum, extent_of, generators
from ..solve.doubtful_points import points_with_narrow_rays, vague_points
from ..solve.given_state import solution_at_given_values
from ..solve.linearised_equations import LinearisedEquations
from ..solve.minimum import NOT_ON_INNER_CONSTRAINTS, adjust_from_start
from ..solve.normal_equations import NormalEquations, Solver
from ..solve.second_minimum import describe_other_minimum, mirror_midpoints, points_without_rays
from ..solve.solution import Solution
from ..start.start_values import Start
from ..types import Array, Index
from .front_system import FrontSystem
from .linear_system import LinearSystem
from .section import Section
from .section_choice import section_of

MIN_NOTICED_MOTION = 1e-6
"""|A g| relative to Σ|A||g| from which a row is sensitive to a motion g of a free network."""


@dataclass(frozen=True)
class Effort:
    """Convergence bounds and numbers of iterations of a new base."""

    close: float = 1e-4
    """Bound of the last step relative to σ after an arrival."""
    again: float = 1e-2
    """The same where the whole is adjusted again at values that its sections have found: such a
    step leaves an error of less than a tenth of its length."""
    at_rest: tuple[float, ...] = (1e-7, 1e-6, 1e-5)
    """Bounds that are tried one after the other to settle: rounding may keep weak networks from
    smaller ones."""
    most: int = 200
    """Largest number of iterations."""
    quick: int = 20
    """Number of iterations after which points with narrow rays are left out, if there are any."""
    few: int = 20
    """Minimum number of iterations of an adjustment that starts without an earlier minimum."""
    work: int = 60_000
    """Iterations times unknowns of such an adjustment, by which small networks may have more."""


EFFORT = Effort()
"""Bounds of every new base."""


@dataclass(frozen=True)
class NoMinimum:
    """No minimum was found."""

    reason: str
    """Why."""
    loose: tuple[Variable, ...] | None = None
    """Variables that are not determined, if that is the reason."""
    singular: bool = False
    """Whether they are undetermined even to first order."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A network to be adjusted, and its start values."""

    equations: Equations
    """The network."""
    start: Start
    """Values of its unknowns."""
    rows: Index
    """Rows of the ledger in it."""
    section: Section | None = None
    """Information of the rest on it, if it is a section of the network; None: it is the whole."""
    looked: Mapping[str, ShapeMisfit] = field(default_factory=dict)
    """Shapes that were fitted again in vain before, by name, see `solve.shape_minimum`; empty:
    every shape that does not fit is fitted again."""
    extra: AddedFactors = NO_ADDED_FACTORS
    """Linear information beside the observations: that of the rest on a section, which includes
    retired observations, or that of retired observations on the whole."""

    @classmethod
    def of(
        cls,
        ledger: Ledger,
        system: LinearSystem | None,
        datum: DatumChoice,
        *,
        new: Collection[Variable] = (),
        dropped: Collection[Variable] = (),
        found: Sequence[Solution | Start] = (),
        there: Mapping[Variable, Array] | None = None,
    ) -> Draft:
        """Compile the observations in the graph.

        Args:
            ledger: the ledger.
            system: the system with the known variables; None: nothing is known.
            datum: given or free.
            new: variables that enter.
            dropped: variables that are not known any more.
            found: start values of those that enter.
            there: values of variables that nothing else gives; None: there are none.

        Raises:
            InputError: there is nothing to adjust.
            ApproximationError: a variable has no approximate value.
        """
        extra = NO_ADDED_FACTORS if ledger.retired is None else ledger.retired.prior
        there = there or {}
        if isinstance(extra, Prior):
            there = {**extra.references(), **there}
            new, dropped = {*new, *there}, {*dropped} - {*there}
        network = known_network(ledger, system, new=new, dropped=dropped)
        equations = compile_network(network)
        start = _started(equations, datum, system, found, there)
        looked = {} if system is None else system.looked
        return cls(equations, start, ledger.having("accepted"), looked=looked, extra=extra)

    @classmethod
    def of_section(
        cls,
        ledger: Ledger,
        system: FrontSystem | None,
        *,
        new: Collection[Variable] = (),
        dropped: Collection[Variable] = (),
        found: Sequence[Solution | Start] = (),
    ) -> Draft | None:
        """Compile what arrivals touch; None where the whole has to be adjusted; see `of`."""
        if system is None or any(system.whole.known(*v) for v in dropped):
            return None
        made = section_of(ledger, system)
        if made is None:
            return None
        equations, section = made
        unknowns = equations.unknowns
        if any(name not in unknowns[kind].number for kind, name in new):
            return None
        try:
            start = _started(equations, "given", system, found)
        except AdjustmentError:
            return None
        return cls(equations, start, section.inside, section, extra=section.known.prior)

    def normal(self, constraint: Solution | None) -> tuple[NormalEquations, np.ndarray]:
        """Return the normal equations at the start, and the addition of a minimal datum.

        Args:
            constraint: a solution whose minimal datum holds a free network; None: there is none.
        """
        equations, state = self.equations.weighted_at(self.start.state), self.start.state
        rows = self.extra.at(equations, state).rows
        normal = NormalEquations(Solver.of(equations, rows), state, rows)
        if constraint is None:
            return normal, np.zeros(equations.unknowns.n_columns)
        return normal, self._carried(constraint.equations.unknowns, constraint.run.constraint)

    def _carried(self, there: Unknowns, values: Array) -> Array:
        """Return values (n_columns,) of the columns of another network's unknowns, by name."""
        unknowns = self.equations.unknowns
        out = np.zeros(unknowns.n_columns)
        for column in np.flatnonzero(values).tolist():
            kind, name, _ = there.describe(column)
            table, old = unknowns[kind], there[kind]
            if name in table.number:
                component = column - int(old.offset[old.number[name]])
                out[int(table.offset[table.number[name]]) + component] = values[column]
        return out

    def inner_constraints(self, base: Solution) -> FreeDatum | None:
        """Return the inner constraints of a free network at the start; None: the datum is given."""
        if base.datum is None:
            return None
        about = extent_of(base.state)
        before = generators(base.equations, base.state, about)
        amounts = np.linalg.lstsq(before, base.datum.motions, rcond=None)[0]
        motions = generators(self.equations, self.start.state, about) @ amounts
        chosen = self._carried(base.equations.unknowns, base.datum.columns.astype(float))
        return FreeDatum(motions, chosen > 0.0)

    def noticing(self, base: Solution, ids: Sequence[Sequence[str]]) -> list[bool]:
        """Return which units are sensitive to a motion left open by a free network's datum.

        Args:
            base: the free network without them.
            ids: ids of each unit.
        """
        datum = self.inner_constraints(base)
        assert datum is not None
        system = LinearisedEquations(self.equations.weighted_at(self.start.state), self.start.state)
        out = []
        for unit in ids:
            a = system.sparse(np.concatenate(self.equations.find(unit)))
            out.append(notices_motion(a, datum.motions))
        return out

    def adjusted(
        self,
        datum: DatumChoice,
        *,
        tolerances: Sequence[float] = (EFFORT.close,),
        doubted: bool = False,
        other_sides: bool = True,
        solver: Solver | None = None,
    ) -> FrontSystem | NoMinimum:
        """Adjust; a failure says why there is no minimum.

        Args:
            datum: given or free.
            tolerances: bounds of the last step, tried one after the other until one is reached.
            doubted: whether there was no minimum before, and nothing has left since.
            other_sides: whether points may go to their other sides where vᵀPv is smaller there.
            solver: the network in the order of its elimination; None: not ordered yet.
        """
        n = self.equations.unknowns.n_columns
        most = EFFORT.most
        if doubted:
            most = min(max(EFFORT.few, EFFORT.work // n), EFFORT.most)
        start, slow = self.start, bool(self.equations.images)
        for tolerance in (tolerances[0], *tolerances) if slow else tolerances:
            try:
                solution = adjust_from_start(
                    self.equations,
                    start,
                    free=datum == "free",
                    extra=self.extra,
                    tolerance=tolerance,
                    max_iterations=EFFORT.quick if slow else most,
                    looked=self.looked,
                    other_sides=other_sides,
                    solver=solver,
                )
                # The position of a free network changes no observation.
                if solution.converged or solution.reason == NOT_ON_INNER_CONSTRAINTS:
                    return FrontSystem.of(solution, rows=self.rows, section=self.section)
            except DatumError as error:
                return NoMinimum(str(error), tuple(error.unknowns), singular=True)
            except (AdjustmentError, SingularError) as error:
                return NoMinimum(str(error))
            start = Start(solution.equations.unknowns, solution.state, solution.start)
            layers = solution.run.solver.layers
            if slow and (
                points := points_with_narrow_rays(solution.equations, solution.state, layers)
            ):
                # With nearly parallel rays the reason are those of points that ran away.
                away = [p for p in _vague(solution) if p in points]
                return NoMinimum(solution.reason, tuple(("point", n) for n in away or points))
            slow = False
        vague = tuple(("point", name) for name in _vague(solution))
        return NoMinimum(solution.reason, solution.run.drifting or vague or None)


def _vague(solution: Solution) -> list[str]:
    """Return the points that may be anywhere; none where an observation is degenerate."""
    with suppress(AdjustmentError):
        return [p.name for p in vague_points(solution)]
    return []


def _started(
    equations: Equations,
    datum: DatumChoice,
    system: LinearSystem | None,
    found: Sequence[Solution | Start],
    there: Mapping[Variable, Array] | None = None,
) -> Start:
    """Return values of the unknowns: known, computed before, or approximate.

    Variables have the values of ``there`` where nothing else gives them.

    Raises:
        ApproximationError: something has no approximate value.
    """
    unknowns = equations.unknowns
    state = origin = unknowns.start()
    moving = unknowns.moving()  # an excerpt need not know the constants of the network
    state = _placed(unknowns, state, moving, there or {})
    origin = {k: np.where(np.isnan(x), state[k], x) for k, x in origin.items()}
    starts = (Start.of(s) for s in found)
    sources = [(s.unknowns, s.state, s.origin) for s in starts]
    if system is not None:
        sources += system.places()
    for table, values, given in sources:
        state = unknowns.carried(state, table, values, where=moving)
        origin = unknowns.carried(origin, table, given, where=moving)
    if system is not None:
        state, origin = system.carried(unknowns, state), system.carried(unknowns, origin)
    if any(np.isnan(x).any() for s in (state, origin) for x in s.values()):
        return choose_start(equations, datum, Start(unknowns, state, origin))
    return Start(unknowns, state, origin)


def _placed(
    unknowns: Unknowns, state: State, moving: MaskState, there: Mapping[Variable, Array]
) -> State:
    """Return a state with the movable values of some variables at given ones."""
    out = {kind: values.copy() for kind, values in state.items()} if there else state
    for (kind, name), value in there.items():
        number = unknowns[kind].number[name]
        width = min(len(value), out[kind].shape[1])
        on = moving[kind][number, :width]
        out[kind][number, :width] = np.where(on, value[:width], out[kind][number, :width])
    return out


def known_network(
    ledger: Ledger,
    system: LinearSystem | None,
    *,
    new: Collection[Variable] = (),
    dropped: Collection[Variable] = (),
    rows: Index | None = None,
) -> Network:
    """Return the network of the observations in the graph, without undetermined variables.

    Args:
        ledger: the ledger.
        system: the known variables; None: only ``new``.
        new: variables that enter.
        dropped: variables that are not known any more.
        rows: observations of the network; None: those in the graph.
    """
    network = ledger.described if rows is None else ledger.with_rows(rows)
    inside: dict[VariableKind, set[str]] = {kind: set() for kind in UNKNOWNS}
    if system is not None:
        inside = {kind: system.names(kind) for kind in UNKNOWNS}
    for kind, name in new:
        inside[kind].add(name)
    for kind, name in dropped:
        inside[kind].discard(name)

    def determined(kind: VariableKind, name: str) -> bool:
        """Return whether an unknown needs no observation: all of it is held or weighted."""
        if kind == "point" and (point := network.points[name]).sigma is None:
            return all(point.fixed)
        free, weighted = components(network, (kind, name))
        return free == weighted

    return filtered(network, determined, inside=inside)


def solution_of(ledger: Ledger, system: LinearSystem, rules: Options) -> Solution:
    """Return the solution as it is; a free network's on its inner constraints.

    All observations are linearised there. Where the remaining step is larger than promised, or
    observations are a little sensitive to the motion onto the inner constraints, as verticals on
    the curved Earth are, it is adjusted from there; so it is where points may fit on their other
    sides, see `solve.second_minimum`, which the solution names.
    """
    if (adjusted := system.adjusted_solution) is not None:
        return adjusted
    draft = Draft.of(ledger, system, rules.datum)
    held = system.datum_solution
    constraint = None if held is None else draft.normal(held)[1]
    found = solution_at_given_values(
        draft.equations,
        draft.start,
        constraint,
        reason=f"within {rules.accuracy:.0%} of each σ of the minimum",
        within=rules.accuracy,
        doubt=system.doubt,
        extra=draft.extra,
    )
    if system.doubt:
        return found
    far = found.reason == NOT_ON_INNER_CONSTRAINTS or _left(found) > rules.accuracy
    images = mirror_midpoints(found.equations, found.state, points_without_rays(found.equations))
    if far or images:
        with suppress(AdjustmentError):
            again = adjust_from_start(
                draft.equations,
                draft.start,
                free=rules.datum == "free",
                tolerance=EFFORT.close,
                extra=draft.extra,
            )
            if again.converged:
                return again if far else _with_second_places(found, again, images)
    return found


def _with_second_places(
    ours: Solution, adjusted: Solution, images: Mapping[int, Array]
) -> Solution:
    """Return a solution that names points that fit as well, or better, on their other sides.

    Args:
        ours: the present estimates.
        adjusted: the adjustment from these, which may have gone to the other side of points.
        images: middles between points and their other sides, by number.
    """
    here, there = ours.state["point"], adjusted.state["point"]
    aside = [
        np.linalg.norm(there[n] - here[n]) > np.linalg.norm(middle - here[n])
        for n, middle in images.items()
    ]
    places = (describe_other_minimum(ours, adjusted),) if any(aside) else adjusted.second_places
    return replace(ours, second_places=places)


def _left(solution: Solution) -> float:
    """Return a bound √(gᵀQg) of the remaining step of every unknown, relative to its σ.

    Where residuals are large the minimum is further away, see `linearisation_error.STEP_SHARE`.
    """
    g = solution.normal().gradient
    left = float(np.sqrt(max(float(g @ solution.factor.solve(g[:, None])[:, 0]), 0.0)))
    r = solution.redundancy
    return left * max(1.0, float(np.sqrt(solution.vtpv / r)) if r > 0 else 1.0)


def notices_motion(a: Array | csr_array, motions: Array) -> bool:
    """Return whether rows are sensitive to motions: |A g| > `MIN_NOTICED_MOTION` Σ|A||g|.

    Args:
        a: partials of the rows, (k, m).
        motions: the motions, (m, d).
    """
    return bool(
        np.any(np.abs(a @ motions) > MIN_NOTICED_MOTION * (abs(a) @ np.abs(motions)) + 1e-300)
    )


def with_doubt(system: FrontSystem, reason: str) -> FrontSystem:
    """Return a system that is not the minimum of all observations in the graph, with the reason."""
    return replace(system, doubt=reason)
