"""Protection levels: bounds of errors of points that hold with up to two undetected gross errors.

The protection level L of a coordinate with the integrity risk ρ is the smallest bound with

    P(|error| > L, and no test of data snooping rejects an observation) ≤ ρ

for gross errors of any sizes in any one or two readings; a reading is what data snooping rejects as
one, see `factorgraph_adj.quality.fault_modes`. The statement is conditional on the faults: it holds
if they are there, whatever their probability is. So it also holds where they are not. The levels of
lengths of vectors, horizontal and in space, hold alike.

The tests are Baarda's w of each scalar observation and T² of each joint reading, with the level
α0 of a single test; σ0 = 1. `factorgraph_adj.quality.integrity_risk` has the law of the risk,
`factorgraph_adj.quality.fault_modes` the worst fault.

After data snooping. Let S be the observations that data snooping rejected, m of N. The search ends
when no test rejects another one, so that a result without S that is wrong by more than its level
L_S is an event of the adjustment without S. With an adjusted network for each S that might have
been rejected, and with the risk of each,

    P(|error| > L_S of what was rejected) ≤ Σ_S P(|error_S| > L_S, no test without S rejects)
                                          ≤ Σ_S ρ_S = ρ,    ρ_S = ρ 2^−(m+1) / (N over m).

This holds for every rule that chooses S, also where it rejects right observations instead of wrong
ones: whatever gross errors stay are at most two. It is the bound of the DIA estimator (Teunissen
2018) by the sum over its outcomes, as of fault exclusion in RAIM (Joerger & Pervan 2016): there are
(N over m) sets S of m observations, which together have ρ 2^−(m+1), and Σ_m 2^−(m+1) ≤ 1. Without
data snooping, an adjustment that a test rejects is not used, and the only outcome has all of ρ.

An incremental adjustment that rejects observations as they come is such a rule, too, whatever it
rejected, readmitted and in which order: ``rejected`` states m, also where it is 0. N counts what is
in the adjustment and what is rejected.

Not covered are errors of held coordinates, of conditions and of factors that a user adds, more than
two gross errors, and σ that are stated too small. With an estimated σ0 there are no levels, because
the law of the tests is another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import gammaln

from ..blas_threads import with_one_thread
from ..errors import InputError, Problem, taking
from ..result_display import FIRST, Rows, Shown
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from ..types import Array, Index
from .fault_modes import FaultModes, WorstModes
from .integrity_risk import SMALLEST_RISK, protection_level, vector_level
from .rejections import Snooping
from .reliability import Reliability, reliability

RISK = 1e-3
"""Integrity risk where none is stated."""
FIGURES = ("x", "y", "z", "horizontal", "vertical", "space")
"""What each point has a level of: its coordinates, its error in plan, its height, the length of its
error in space."""
Figure: TypeAlias = Literal["x", "y", "z", "horizontal", "vertical", "space"]
"""One of `FIGURES`."""
MAX_EFFECT_ELEMENTS = 20_000_000
"""Number of effects of readings on figures that are kept at once."""
SAME_AXES = 1e-12
"""Difference of directions that is rounding."""


@dataclass(frozen=True)
class FaultMode:
    """Gross errors in one reading or in two."""

    rows: tuple[int, ...]
    """First row of each reading."""
    ids: tuple[str, ...]
    """Ids of the observations."""
    labels: tuple[str, ...]
    """Readable names of the observations, with their sources."""

    def __str__(self) -> str:
        """Return the names."""
        return " and ".join(self.labels)


@dataclass(frozen=True, eq=False, repr=False)
class ProtectionLevels(Shown):
    """Protection levels of points; arrays (n,) or (n, 6) in the order of `FIGURES`, metres."""

    solution: Solution
    """The adjustment."""
    names: tuple[str, ...]
    """Names of the points, n."""
    risk: float
    """Integrity risk ρ, for each level by itself."""
    faults: int
    """Largest number of readings with gross errors."""
    alpha: float
    """Probability α0 of a false alarm of one test."""
    outcome_risk: float
    """Risk of this outcome of data snooping; ρ without data snooping."""
    rejected: int | None
    """Number of observations that were rejected, m; None: an adjustment without data snooping."""
    accepted: bool
    """Whether no test rejects an observation of the adjustment. Otherwise the levels are those that
    an accepted result of this design would have."""
    levels: Array
    """The levels, (n, 6), metres; zero of held coordinates, infinite where nothing controls an
    error, or two."""
    sigmas: Array
    """Standard deviations of coordinates, of vectors the largest one of any direction, (n, 6)."""
    slopes: Array
    """Slopes G of the worst fault mode, metres for each unit of noncentrality, (n, 6)."""
    modes: Index
    """First rows of the readings of this mode, (n, 6, 2); −1: the mode has one reading."""

    def headline(self) -> str:
        """Return what the levels are, and how large."""
        level = self.space
        known = level[np.isfinite(level) & (level > 0.0)]
        faults = "1 gross error" if self.faults == 1 else f"{self.faults} gross errors"
        out = f"ProtectionLevels: {len(level)} points, risk {self.risk:g}, up to {faults}"
        if len(known):
            out += f", median {1e3 * np.median(known):.1f} mm, largest {1e3 * known.max():.1f} mm"
        lost = int(np.isinf(level).sum())
        if lost:
            out += f", {lost} infinite"
        return out + ("" if self.accepted else ", NOT ACCEPTED: a test rejects an observation")

    def first_rows(self) -> Rows:
        """Return the points with the largest levels."""
        order = np.argsort(-np.where(np.isnan(self.space), 0.0, self.space), kind="stable")
        return Rows(
            ("point", *FIGURES, "weakest"),
            (
                (self.names[i], *map(float, self.levels[i]), self._weakest(i, 5))
                for i in order[:FIRST].tolist()
            ),
            len(self.names),
        )

    @property
    def coordinates(self) -> Array:
        """Levels of x, y, z, (n, 3), metres."""
        return self.levels[:, :3]

    @property
    def horizontal(self) -> Array:
        """Levels of the length of the error in plan, (n,), metres."""
        return self.levels[:, 3]

    @property
    def vertical(self) -> Array:
        """Levels of the height, (n,), metres."""
        return self.levels[:, 4]

    @property
    def space(self) -> Array:
        """Levels of the length of the error in space, (n,), metres."""
        return self.levels[:, 5]

    @cached_property
    def number(self) -> dict[str, int]:
        """Number of each point."""
        return {name: i for i, name in enumerate(self.names)}

    def level(self, point: str, figure: Figure = "space") -> float:
        """Return a level of a point, metres.

        Raises:
            InputError: no such point, or no such figure.
        """
        return float(self.levels[self._place(point), self._figure(figure)])

    def weakest(self, point: str, figure: Figure = "space") -> FaultMode | None:
        """Return the fault mode that makes the level; None: no error moves the point.

        Raises:
            InputError: no such point, or no such figure.
        """
        return self._weakest(self._place(point), self._figure(figure))

    def _weakest(self, i: int, figure: int) -> FaultMode | None:
        if not self.slopes[i, figure] > 0.0:
            return None
        rows = tuple(r for r in self.modes[i, figure].tolist() if r >= 0)
        equations = self.solution.equations
        return FaultMode(
            rows, tuple(equations.id(r) for r in rows), tuple(equations.label(r) for r in rows)
        )

    def _place(self, point: str) -> int:
        if point not in self.number:
            self.solution.number("point", point)  # refuses unknown names
            raise InputError(Problem("has no level: it was not asked for", f"point {point!r}"))
        return self.number[point]

    def _figure(self, figure: str) -> int:
        if figure not in FIGURES:
            raise InputError(f"unknown figure {figure!r}; valid: {', '.join(FIGURES)}")
        return FIGURES.index(figure)


@taking(Solution | Reliability | Snooping)
@with_one_thread
def protection_levels(
    result: Solution | Reliability | Snooping,
    *,
    risk: float = RISK,
    faults: Literal[1, 2] = 2,
    alpha: float | None = None,
    points: Sequence[str] | None = None,
    rejected: int | None = None,
) -> ProtectionLevels:
    """Return bounds of the errors of points that hold with up to two undetected gross errors.

    The statement and its limits stand at the top of the module: the probability that an error is
    larger than its level, and that no test rejects an observation, is at most ``risk``, whatever
    the sizes of the gross errors. Of a `Snooping` the levels are those of its result, and hold for
    whatever it may have rejected.

    Args:
        result: an adjustment, its reliability, or data snooping.
        risk: integrity risk ρ of each level, a probability from 10⁻⁶⁰ to 1; 10⁻³ unless it is
            stated. Where tests have rejected many readings, the share of their outcome may be
            less: its levels are infinite.
        faults: largest number of readings with gross errors.
        alpha: probability α0 of a false alarm of one test; None: that of the reliability or of data
            snooping, 0.1 % for an adjustment alone.
        points: names of points; None: all points.
        rejected: number of observations that tests have rejected and that the adjustment lacks, 0
            among them; None: an adjustment that is not used where a test rejects. A `Snooping`
            knows its own.

    Returns:
        Levels in metres of x, y, z in the axes of the frame, and of the errors in plan, in height
        and in space, with plan and height as of the horizon of each point.

    Raises:
        InputError: a risk outside [10⁻⁶⁰, 1), another number of faults, unknown points, an
            estimated σ0, covariances that refer to other points (`s_transform`), a negative number
            of rejected observations, or one beside a `Snooping`.
        AdjustmentError: as `reliability`.
    """
    snooping = result if isinstance(result, Snooping) else None
    rel = _reliability(result, alpha)
    solution = rel.solution
    _refuse(solution, snooping, risk, faults, rejected)
    if snooping is not None:
        rejected = _n_rejected(snooping)
    names = tuple(solution.network.points) if points is None else tuple(points)
    numbers = np.array([solution.number("point", name) for name in names], dtype=np.intp)
    modes = FaultModes(rel, faults=faults)
    share = risk if rejected is None else risk * _outcome_share(solution, rejected)
    n = len(names)
    out = ProtectionLevels(
        solution,
        names,
        risk,
        faults,
        rel.alpha,
        share,
        rejected,
        _accepted(rel, modes) and (snooping is None or not snooping.unresolved),
        np.zeros((n, 6)),
        np.zeros((n, 6)),
        np.zeros((n, 6)),
        np.full((n, 6, 2), -1, dtype=np.intp),
    )
    at_once = max(1, MAX_EFFECT_ELEMENTS // (18 * max(1, len(modes.readings.order))))
    for begin in range(0, n, at_once):
        _fill(out, modes, numbers, slice(begin, min(n, begin + at_once)))
    return out


def _reliability(result: Solution | Reliability | Snooping, alpha: float | None) -> Reliability:
    """Return the reliability with the α0 of the tests."""
    if isinstance(result, Snooping):
        result = result.reliability
    if isinstance(result, Solution):
        return reliability(result, alpha=ALPHA_OF_OBSERVATION if alpha is None else alpha)
    if alpha is None or alpha == result.alpha:
        return result
    return reliability(result.solution, alpha=alpha, power=max(result.power, POWER_OF_TEST))


def _refuse(
    solution: Solution, snooping: Snooping | None, risk: float, faults: int, rejected: int | None
) -> None:
    """Raise InputError where there are no levels."""
    problems = []
    if rejected is not None and (snooping is not None or rejected < 0):
        problems.append(
            f"rejected is {rejected}: give a number from 0 with an adjustment, and none with the "
            "result of data snooping, which knows its own"
        )
    if not SMALLEST_RISK <= risk < 1.0:
        problems.append(f"risk must lie between {SMALLEST_RISK:g} and 1, not {risk:g}")
    if faults not in (1, 2):
        problems.append(f"faults must be 1 or 2, not {faults}")
    if solution.variance == "a-posteriori" or (snooping is not None and snooping.test == "pope"):
        problems.append(
            "there are no protection levels with an estimated σ0: adjust with "
            'variance="a-priori", and test with test="baarda"'
        )
    if solution.reference is not None:
        problems.append(
            "errors of points refer to the datum of the adjustment, and covariances to other "
            "points: take the solution before s_transform"
        )
    if problems:
        raise InputError([Problem(p) for p in problems])


def _n_rejected(snooping: Snooping) -> int:
    """Return the number of observations and factors that data snooping rejected."""
    return len(set(snooping.rejected_ids)) + len(snooping.rejected_factors)


def _outcome_share(solution: Solution, m: int) -> float:
    """Return 2^−(m+1)/(N over m), the part of the risk that one set of m rejected readings has."""
    own = solution.equations.observation_of_row
    n = m + len(np.unique(own)) + len(solution.normal().system.extra)
    ways = gammaln(n + 1.0) - gammaln(m + 1.0) - gammaln(n - m + 1.0)
    return float(np.exp(-ways - (m + 1.0) * np.log(2.0)))


def _accepted(rel: Reliability, modes: FaultModes) -> bool:
    """Return whether no test rejects an observation."""
    r = modes.readings
    size = np.diff(np.append(r.first, len(r.order)))
    single = r.order[~np.repeat(r.joint, size)]
    if np.nanmax(np.abs(rel.w[single]), initial=0.0) > rel.critical_w:
        return False
    joint = {tuple(sorted(r.rows(unit).tolist())) for unit in np.flatnonzero(r.joint).tolist()}
    return not any(
        g.dof and g.test > g.critical
        for g in (rel.groups if joint else ())
        if tuple(sorted(g.rows.tolist())) in joint
    )


def _fill(out: ProtectionLevels, modes: FaultModes, numbers: Index, part: slice) -> None:
    """Write the levels of some points."""
    solution, some = out.solution, numbers[part]
    table = solution.equations.unknowns["point"]
    k = len(some)
    unit = np.zeros((solution.equations.unknowns.n_columns, k, 3))
    free = table.free[some] & (table.offset[some] >= 0)[:, None]
    i, axis = np.nonzero(free)
    unit[table.offset[some[i]] + axis, i, axis] = 1.0
    moved = solution.cofactor_times(unit.reshape(len(unit), -1)) if free.any() else unit
    moved = moved.reshape(len(unit), k, 3)
    q = np.zeros((k, 3, 3))
    for a in range(3):
        on = np.flatnonzero(free[:, a])
        q[on, a] = moved[table.offset[some[on]] + a, on]
    q = np.where(free[:, :, None] & free[:, None, :], 0.5 * (q + q.transpose(0, 2, 1)), 0.0)
    enu = solution.network.frame.basis(solution.state["point"][some], np.zeros((k, 2))).enu
    effects, unseen = (x.reshape(len(x), k, 3) for x in modes.effects(moved.reshape(len(unit), -1)))
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", q), 0.0))
    local = enu @ q @ enu.transpose(0, 2, 1)
    in_plan = np.sqrt(np.maximum(np.linalg.eigvalsh(local[:, :2, :2]), 0.0))
    in_space = np.sqrt(np.maximum(np.linalg.eigvalsh(q), 0.0))
    up = np.sqrt(np.maximum(local[:, 2, 2], 0.0))
    largest = np.concatenate([sigma, in_plan[:, -1:], up[:, None], in_space[:, -1:]], axis=1)
    worst = modes.worst(_figures(effects, enu), _figures(unseen, enu), largest.reshape(-1))
    slopes = worst.slope.reshape(k, 6)
    level = np.empty((k, 6))
    for f in range(6):
        if f in (3, 5):
            axes = in_plan if f == 3 else in_space
            level[:, f] = vector_level(
                axes, slopes[:, f], out.outcome_risk, out.alpha, dof=modes.dof
            )
        else:
            level[:, f] = protection_level(
                largest[:, f], slopes[:, f], out.outcome_risk, out.alpha, dof=modes.dof
            )
    out.levels[part], out.sigmas[part], out.slopes[part] = level, largest, slopes
    out.modes[part] = _first_rows(modes, worst).reshape(k, 6, 2)


def _figures(effects: Array, enu: Array) -> Array:
    """Return effects (n, points, 3) on the axes of each figure, (n, 6 points, 3)."""
    n, k = effects.shape[:2]
    local = np.einsum("nka,kba->nkb", effects, enu)
    out = np.zeros((n, k, 6, 3))
    for a in range(3):
        out[:, :, a, 0] = effects[:, :, a]
    out[:, :, 3, :2] = local[:, :, :2]
    out[:, :, 4, 0] = local[:, :, 2]
    out[:, :, 5] = effects
    return out.reshape(n, 6 * k, 3)


def _first_rows(modes: FaultModes, worst: WorstModes) -> Index:
    """Return the first row of each reading of the modes, (m, 2); −1 for none."""
    r = modes.readings
    rows = r.order[r.first]
    second = np.where(worst.second >= 0, rows[np.maximum(worst.second, 0)], -1)
    return np.stack([rows[worst.first], second], axis=1)
