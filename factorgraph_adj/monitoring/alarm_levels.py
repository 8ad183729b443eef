"""Critical values of the rules of alarms for one object, from the stated rates.

They are found once, at the first epoch after the reference (those of congruence tests at the first
one that has reference points enough), for the points of the reference and the share that its error
has in the differences. How exact they are is told in
`factorgraph_adj.monitoring.alarm_rules`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ..epochs.comparison_result import EpochComparison
from ..epochs.congruence_tests import UnitVariance, motion_basis, weight_of_differences
from ..errors import InputError, Problem
from ..statistical_tests import chi2_upper_quantile
from ..types import Array
from .alarm_rules import AlarmRule, epochs_per_month, matches
from .cumulative_sums import limit_of_run_length
from .epoch_estimates import EpochEstimate
from .motion_filter import MotionModel
from .raise_rates import RaiseRate, level_of_rate
from .velocity_rates import VelocityRate

Parts = Mapping[str, tuple[Array, Array]]
"""Covariances of displacements by names of points: what the epoch and the reference have in it."""


@dataclass(frozen=True, eq=False)
class RuleLevels:
    """Levels of rules."""

    levels: Mapping[str, float]
    """Probability α of a single test, by the names of the rules; of a cusum the average run length
    of a point."""
    relative_errors: Mapping[str, float]
    """Relative standard deviation of the rates that were simulated, by the names of the rules."""
    shares: Mapping[str, float]
    """Share of the reference in the variance of the displacements, by points."""

    @classmethod
    def of(
        cls,
        rules: Sequence[AlarmRule],
        found: EpochComparison,
        parts: Parts,
        base: EpochEstimate,
        interval: float,
        motion: MotionModel,
        objects: Sequence[str],
    ) -> RuleLevels:
        """Return the levels.

        Args:
            rules: the rules.
            found: a comparison with the reference.
            parts: its `covariance_parts` of the objects.
            base: the reference.
            interval: time from one epoch to the next, seconds.
            motion: how objects are thought to move.
            objects: names or patterns of the objects.

        Raises:
            InputError: a rate cannot be kept, or a rule has no points.
        """
        h, epochs = len(found.differences.axes), epochs_per_month(interval)
        shares = {n: float(np.trace(np.linalg.solve(a + b, b))) / h for n, (a, b) in parts.items()}
        usual = float(np.median(list(shares.values())))
        every = [
            n for n, f in zip(base.names, base.free, strict=True) if f.any() and matches(n, objects)
        ]
        shares = {n: shares.get(n, usual) for n in every}
        levels: dict[str, float] = {}
        errors: dict[str, float] = {}
        for rule in rules:
            number = rule.false_alarms_in(epochs, interval)
            names = [n for n in every if rule.covers(n)]
            if rule.test != "congruence" and not names:
                raise InputError(
                    Problem(
                        f"none of the objects is {', '.join(rule.points)}", f"alarm {rule.name!r}"
                    )
                )
            try:
                if rule.test == "displacement":
                    of_points = tuple(sorted(shares[n] for n in names))
                    levels[rule.name] = level_of_rate(number, h, of_points, rule.life, epochs)
                elif rule.test == "congruence":
                    continue  # see `with_shape`
                elif rule.test == "cusum":
                    levels[rule.name] = epochs * len(names) / number
                    limit_of_run_length(h, rule.allowance, levels[rule.name])
                else:
                    sigmas = [np.linalg.det(a) ** (0.5 / h) for a, _ in parts.values()]
                    each = VelocityRate(
                        h, round(usual, 3), _rounded(float(np.median(sigmas))), interval, motion
                    ).level(number / len(names), rule.life, epochs)
                    levels[rule.name], errors[rule.name] = each.level, each.relative_error
            except InputError as error:
                raise InputError(Problem(str(error), f"alarm {rule.name!r}")) from error
        return cls(levels, errors, shares)

    def with_shape(
        self,
        rules: Sequence[AlarmRule],
        found: EpochComparison,
        base: EpochEstimate,
        interval: float,
    ) -> RuleLevels:
        """Return the levels with those of congruence tests.

        The first epoch with a shape to test gives them: others may lack reference points.

        Args:
            rules: as in `of`.
            found: as there.
            base: as there.
            interval: as there.

        Raises:
            InputError: a rate cannot be kept.
        """
        lacking = [r for r in rules if r.test == "congruence" and r.name not in self.levels]
        freedom, share = _reference_share(found, base) if lacking else (0, 0.0)
        if not freedom:
            return self
        epochs, levels = epochs_per_month(interval), dict(self.levels)
        for rule in lacking:
            number = rule.false_alarms_in(epochs, interval)
            try:
                levels[rule.name] = level_of_rate(number, freedom, (share,), rule.life, epochs)
            except InputError as error:
                raise InputError(Problem(str(error), f"alarm {rule.name!r}")) from error
        return replace(self, levels=levels)

    def critical(self, rule: AlarmRule, freedom: int) -> float:
        """Return the critical value of T of a rule; of a cusum the limit H.

        Args:
            rule: the rule.
            freedom: degrees of freedom of the test.
        """
        level = self.levels[rule.name]
        if rule.test == "cusum":
            return limit_of_run_length(freedom, rule.allowance, level)
        return float(chi2_upper_quantile(level, freedom))

    def detectable(self, rule: AlarmRule, point: str, freedom: int) -> float:
        """Return what raises an alarm with the power of the rule, in σ.

        Args:
            rule: the rule, of displacements or velocities.
            point: the object.
            freedom: degrees of freedom of the test.
        """
        level = self.levels[rule.name]
        if rule.test == "velocity":
            return _of_one_epoch(level, rule.power, freedom)
        share = round(self.shares[point], 3)
        return _of_displacement(RaiseRate(freedom, share, rule.life), level, rule.power)

    def rate(self, rule: AlarmRule, point: str, freedom: int) -> RaiseRate:
        """Return chance and power of the alarms of a displacement of a point."""
        return RaiseRate(freedom, round(self.shares[point], 3), rule.life)


@lru_cache(maxsize=1024)
def _of_displacement(rate: RaiseRate, level: float, power: float) -> float:
    return rate.detectable(level, power)


@lru_cache(maxsize=256)
def _of_one_epoch(level: float, power: float, freedom: int) -> float:
    return float(np.sqrt(UnitVariance(1.0, np.inf).noncentrality(level, power, freedom)))


def _rounded(x: float) -> float:
    """Return a number with three digits: simulations of nearly equal σ are one."""
    return float(f"{x:.3g}")


def _reference_share(found: EpochComparison, base: EpochEstimate) -> tuple[int, float]:
    """Return degrees of freedom of the shape of the reference points, and the share of the base."""
    if not found.reference:
        return 0, 0.0
    rows = found.differences.rows(found.reference)
    g = motion_basis(found.differences.motions[rows])
    w = weight_of_differences(found.differences.cofactor[np.ix_(rows, rows)], g)
    number = {n: i for i, n in enumerate(base.names)}
    at = np.array([number[n] for n in found.reference], dtype=np.intp)
    axes = np.array(["xyz".index(a) for a in found.differences.axes])
    q = base.cofactors_of((3 * at[:, None] + axes).ravel())
    h = len(rows) - g.shape[1]
    return h, float(np.sum(w * q)) / h if h else 0.0
