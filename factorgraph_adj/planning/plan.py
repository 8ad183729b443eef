"""Precision, reliability, detectable displacements of a design before readings; unmet targets.

Covariances, redundancy numbers, smallest detectable errors and their effects depend only on
geometry and weights. Therefore the readings are computed from the given values of the network, and
the network is adjusted.

Both epochs are measured as the design says, so that differences of coordinates have Q_d = 2 Q. A
point is tested against the reference points, which are taken as stable, by the test of
`factorgraph_adj.epochs.congruence` with known σ0: with Q_∇ of its displacement (k, k)

    ∇ = √(λ(α, β, k) · largest eigenvalue of Q_∇)

is found with the probability 1 − β in the direction in which it is hardest to find; λ is the
noncentrality of χ² with k degrees of freedom. k counts the free coordinates of the point: 1 for a
height, 2 in plan, 3 in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..adjustment import adjust
from ..blas_threads import with_one_thread
from ..epochs.congruence_tests import UnitVariance, motion_basis, motion_rank, weight_of_differences
from ..errors import AdjustmentError, InputError, Problem, taking
from ..graph.listed_points import with_listed_points_apart
from ..network.network import Network
from ..quality.error_effects import unit_error_shifts
from ..quality.reliability import Reliability, check_probabilities, reliability
from ..result_display import Rows, Shown
from ..solve.solution import Solution, cofactors_at
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from ..types import Array, Index, Mask
from .candidates import as_planned
from .targets import (
    DetectableDisplacement,
    DetectableError,
    RedundancyNumber,
    RowTarget,
    Shortfall,
    Target,
    as_targets,
    describe,
    lacking,
    limit_problems,
    matching,
    observation_problems,
    point_figures,
)

CHUNK = 500
"""Number of observations whose effects are computed together."""


@dataclass(frozen=True, eq=False)
class DisplacementItems:
    """The points to which a target applies, and their reference points."""

    target: DetectableDisplacement
    """The target."""
    names: tuple[str, ...]
    """Names of the m points."""
    columns: Index
    """Columns of the free coordinates of the reference points, and then of the points, (n,)."""
    owner: Index
    """Number of the point of each of these columns; −1 for reference points, (n,)."""
    motions: Array
    """Motions that the observations leave open, (n, g)."""

    @cached_property
    def noncentralities(self) -> dict[int, float]:
        """Noncentrality λ of the test of a point by its number of free coordinates."""
        known, counts = UnitVariance(1.0, float("inf")), np.bincount(self.owner[self.owner >= 0])
        alpha, power = self.target.alpha, self.target.power
        return {k: known.noncentrality(alpha, power, k) for k in np.unique(counts).tolist()}

    def figures(self, q: Array) -> Array:
        """Return the smallest detectable displacements of the points, (m,) metres.

        Args:
            q: cofactors of the columns, (n, n).

        Raises:
            InputError: coordinates depend on each other beyond the open motions.
        """
        if not len(self.names):
            return np.zeros(0)
        w = weight_of_differences(2.0 * q, self.motions)
        loose = self.owner >= 0
        moved = np.linalg.inv(w[np.ix_(loose, loose)])
        own = self.owner[loose]
        out = np.zeros(len(self.names))
        for i in range(len(self.names)):
            at = own == i
            largest = float(np.linalg.eigvalsh(moved[np.ix_(at, at)])[-1])
            out[i] = np.sqrt(self.noncentralities[int(at.sum())] * max(largest, 0.0))
        return out


def displacement_items(solution: Solution, target: DetectableDisplacement) -> DisplacementItems:
    """Return the points of a target and their reference points, in the columns of a solution.

    Raises:
        InputError: points are held; observations leave motions open, and the reference points do
            not determine them.
    """
    table = solution.equations.unknowns["point"]
    names = list(table.names)
    on = matching(names, target.points)
    free = table.free & (table.offset >= 0)[:, None]
    held = [n for n, o, f in zip(names, on, free, strict=True) if o and not f.any()]
    if held:
        raise InputError(
            Problem(f"is held: it cannot be seen to move; {describe(target)}", f"point {n!r}")
            for n in held
        )
    stable = matching(names, target.reference) & ~on & free.any(axis=1)
    order = [*np.flatnonzero(stable).tolist(), *np.flatnonzero(on).tolist()]
    columns, owner = [], []
    for number in order:
        own = table.offset[number] + np.flatnonzero(free[number])
        columns += own.tolist()
        owner += [-1 if stable[number] else order.index(number) - int(stable.sum())] * len(own)
    at = np.array(columns, dtype=np.intp)
    motions = [np.zeros((len(at), 0)), *(d.motions[at] for d in solution.defects)]
    g = motion_basis(np.hstack(motions))
    if g.shape[1] and not stable.any():
        raise InputError(
            Problem(
                "the observations leave motions of the whole open, and the target has no reference "
                "points: name some in reference, and others in points",
                describe(target),
            )
        )
    left = g.shape[1] - motion_rank(g[np.array(owner) < 0])
    if left:
        raise InputError(
            Problem(
                f"it has not enough reference points: they leave {left} of {g.shape[1]} motions of "
                "the whole open; name more of them",
                describe(target),
            )
        )
    points = tuple(names[i] for i in np.flatnonzero(on).tolist())
    return DisplacementItems(target, points, at, np.array(owner, dtype=np.intp), g)


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """A design, adjusted at its planned values; σ0 = 1."""

    solution: Solution
    """Adjustment of the design, with the expected covariances."""
    reliability: Reliability
    """Expected reliability of the observations."""
    targets: tuple[Target, ...]
    """Targets of the design."""

    @property
    def network(self) -> Network:
        """The design, with readings computed from its given values."""
        return self.solution.network

    @cached_property
    def shortfalls(self) -> tuple[Shortfall, ...]:
        """Items that fail the targets, the worst of each target first."""
        out: list[Shortfall] = []
        for t in self.targets:
            names, figures = self.figures(t)
            lack = lacking(t, figures)
            order = np.argsort(-lack, kind="stable")
            out += [Shortfall(t, names[i], float(figures[i])) for i in order[lack[order] > 0]]
        return tuple(out)

    @property
    def met(self) -> bool:
        """Whether all targets are met."""
        return not self.shortfalls

    @cached_property
    def lack(self) -> float:
        """Lack of the design: the sum of |ln(figure/limit)| over all items that fail a target."""
        return sum(float(lacking(t, self.figures(t)[1]).sum()) for t in self.targets)

    def figures(self, target: Target) -> tuple[list[str], Array]:
        """Return the items of a target by name, and their figures."""
        if isinstance(target, RowTarget):
            return self._of_rows(target)
        if isinstance(target, DetectableDisplacement):
            moved = displacement_items(self.solution, target)
            return list(moved.names), moved.figures(cofactors_at(self.solution, moved.columns))
        names = list(self.network.points)
        on = matching(names, target.points)
        points = np.flatnonzero(on)
        blocks = self.solution.point_covariances[points]
        horizon = horizons(self.network, names)[points]
        return [names[i] for i in points], point_figures(target, blocks, horizon)

    def _of_rows(self, target: RowTarget) -> tuple[list[str], Array]:
        rel, equations = self.reliability, self.solution.equations
        on = rows_like(self.solution, target.observations)
        rows = np.flatnonzero(on)
        labels = [equations.label(i) for i in rows.tolist()]
        if isinstance(target, RedundancyNumber):
            return labels, rel.redundancy_numbers[rows]
        if isinstance(target, DetectableError):
            return labels, rel.mdb[rows] / self.solution.observations.sigmas[rows]
        out = np.full(len(rows), np.inf)
        known = np.isfinite(rel.mdb[rows])
        table = equations.unknowns["point"]
        chosen = matching(table.names, target.points) & (table.offset >= 0)
        columns = table.offset[chosen, None] + np.arange(3)
        for part in np.array_split(rows[known], max(1, int(known.sum()) // CHUNK)):
            moved = unit_error_shifts(self.solution, part)[columns] * rel.mdb[part]
            far = np.sqrt(np.sum(moved**2, axis=1)).max(axis=0, initial=0.0)
            out[np.isin(rows, part)] = far
        return labels, out

    def headline(self) -> str:
        """Return the sizes of the design and its number of shortfalls."""
        gone = len(self.network.unknowns_left_out)
        return (
            f"Plan of {self.network.name!r}: {self.solution.n_observations} observations, "
            f"redundancy {self.solution.redundancy}, {len(self.targets)} targets, "
            f"{len(self.shortfalls)} shortfalls"
            + (f", {gone} undetermined unknown{'s' * (gone > 1)} left out" if gone else "")
        )

    def first_rows(self) -> Rows:
        """Return the shortfalls."""
        return Rows(
            ("shortfall",),
            ((str(s),) for s in self.shortfalls),
            len(self.shortfalls),
        )


@taking(Network)
@with_one_thread
def plan(
    network: Network,
    targets: Sequence[Target] | Target = (),
    *,
    alpha: float = ALPHA_OF_OBSERVATION,
    power: float = POWER_OF_TEST,
    leave_out_undetermined: bool = False,
) -> Plan:
    """Compute the expected precision and reliability of a design.

    Args:
        network: points, photos and cameras as planned, held, weighted or free, and observations
            with their standard deviations; the observed values are ignored.
        targets: targets of the design, see `factorgraph_adj.planning.targets`.
        alpha: probability α0 of a false alarm of one test.
        power: probability with which an error of the smallest detectable size is found.
        leave_out_undetermined: whether what the observations do not determine is left out, see
            `determined_part`; ``network.unknowns_left_out`` of the plan names it. Targets concern
            the rest, and one that names nothing else is refused.

    Raises:
        InputError: points without coordinates, photos without orientation, frames and other
            unknowns without the values that a plan needs, invalid targets, targets without any
            item; all at once.
        DatumError: the observations leave unknowns undetermined; the error names them.
    """
    wanted = as_targets(targets)
    problems = limit_problems(wanted, list(network.points))
    found = realised(
        network,
        wanted,
        problems,
        alpha=alpha,
        power=power,
        leave_out_undetermined=leave_out_undetermined,
    )
    if not problems:
        problems = limit_problems(wanted, list(found.network.points))
    problems += observation_problems(wanted, found.solution.equations)
    problems = problems or _displacement_problems(found)
    if problems:
        raise InputError(problems)
    return found


def _displacement_problems(found: Plan) -> list[Problem]:
    """Return why displacements cannot be judged."""
    problems: list[Problem] = []
    for t in found.targets:
        if isinstance(t, DetectableDisplacement):
            try:
                found.figures(t)
            except InputError as error:
                problems += error.problems
    return problems


def realised(
    network: Network,
    targets: Sequence[Target],
    problems: Sequence[Problem] = (),
    *,
    alpha: float,
    power: float,
    leave_out_undetermined: bool = False,
) -> Plan:
    """Return the plan of a network for targets that were checked before.

    Args:
        network: as for `plan`.
        targets: the checked targets.
        problems: errors found before, which are raised together with those of the network.
        alpha: as for `plan`.
        power: as for `plan`.
        leave_out_undetermined: as for `plan`.
    """
    check_probabilities(alpha, power)
    try:
        network = with_listed_points_apart(network)
        solution = adjust(as_planned(network), leave_out_undetermined=leave_out_undetermined)
    except InputError as error:
        raise InputError([*problems, *error.problems]) from None
    except AdjustmentError:
        if problems:
            raise InputError(problems) from None
        raise
    return Plan(solution, reliability(solution, alpha=alpha, power=power), tuple(targets))


def horizons(network: Network, names: Sequence[str]) -> Array:
    """Return unit vectors east and north at points, in the frame of the network, (n, 2, 3)."""
    at = np.array([network.points[n].coordinates for n in names]).reshape(-1, 3)
    return network.frame.basis(at, np.zeros((len(at), 2))).enu[:, :2]


def rows_like(solution: Solution, patterns: Sequence[str]) -> Mask:
    """Return which scalar observations have an id or a kind that matches a pattern, (n,)."""
    table = solution.observations
    return matching([o.id for o in table], patterns) | matching([o.kind for o in table], patterns)
