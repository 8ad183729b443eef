"""Monitoring of an object: epoch after epoch against a reference, with motions and alarms.

The first epochs are the reference, as their mean. Every later epoch is

1. compared with the reference by `factorgraph_adj.epochs.congruence.compare_epochs`: reference
   points are tested, and objects have their displacements against those that kept their shape,
2. compared with the mean of all earlier epochs, whose innovations go into cumulative sums,
3. compared with the mean of the last n epochs, where that is wanted,
4. and given to the motion filter of each point.

The rules then test, and raise, continue and clear alarms. The same epochs give the same findings.
What a monitor knows of them does not grow with their number: `Monitor.to_json` has it, and a
monitor that has resumed it finds the same in later epochs, in all digits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from ..blas_threads import with_one_thread
from ..epochs.comparison_result import Displacement, EpochComparison
from ..epochs.congruence import compare_epochs
from ..epochs.congruence_tests import motion_basis, weight_of_differences
from ..errors import AdjustmentError, InputError, Problem
from ..types import Array
from .alarm_levels import RuleLevels
from .alarm_rules import (
    OF_REFERENCE,
    AlarmEvent,
    AlarmRule,
    AlarmState,
    TestedEpoch,
    epochs_per_month,
    matches,
    next_alarm,
    outcome_of,
    rules_named_once,
    sentence_of,
)
from .cumulative_sums import next_sum
from .epoch_estimates import EpochEstimate
from .mean_estimates import MeanEstimate, mean_estimate
from .motion_filter import DAY_S, Motion, MotionModel

MAX_REFERENCE_ALPHA = 1e-4
"""Largest probability with which reference points that kept their places are searched for one that
moved, in an epoch."""
REFERENCE_PART = 0.1
"""Largest number of such searches in a month, relative to the lowest stated rate. A point that
leaves by chance has the largest error of all, and takes the displacements of the objects with
it."""
_LEVELS = tuple(f.name for f in fields(RuleLevels))


@dataclass(frozen=True, eq=False)
class PointFinding:
    """What an epoch tells of an object."""

    displacement: Displacement
    """Displacement against the reference, with its covariance."""
    of_epoch: Array
    """Part of the epoch in its covariance, (k, k) metres²: the reference has the rest."""
    motion: Motion
    """State of the motion filter after the epoch."""
    tests: tuple[TestedEpoch, ...]
    """What the rules found."""

    @property
    def velocity_mm_per_day(self) -> Array:
        """Velocity of the filter, (k,) mm/day."""
        return 1e3 * DAY_S * self.motion.velocity

    @property
    def velocity_sigmas_mm_per_day(self) -> Array:
        """Its σ, (k,) mm/day."""
        return 1e3 * DAY_S * np.sqrt(np.diag(self.motion.velocity_covariance))


@dataclass(frozen=True, eq=False)
class Findings:
    """What an epoch tells."""

    number: int
    """Number of the epoch."""
    time: float
    """Its time, seconds since 1970 UTC."""
    comparison: EpochComparison | None = None
    """Comparison with the reference; None for epochs of the reference, and with a problem."""
    recent: EpochComparison | None = None
    """Comparison with the mean of the last epochs, where it is wanted and there are so many."""
    points: Mapping[str, PointFinding] = field(default_factory=dict)
    """The objects."""
    reference_tests: tuple[TestedEpoch, ...] = ()
    """What rules of congruence tests found."""
    alarms: tuple[AlarmEvent, ...] = ()
    """Alarms that were raised or cleared, or that continue."""
    problem: str = ""
    """Why the epoch could not be compared; it then counts in no test."""

    @property
    def raised(self) -> tuple[AlarmEvent, ...]:
        """Alarms that this epoch raised."""
        return tuple(a for a in self.alarms if a.change == "raised")

    @property
    def cleared(self) -> tuple[AlarmEvent, ...]:
        """Alarms that this epoch cleared."""
        return tuple(a for a in self.alarms if a.change == "cleared")


class Monitor:
    """Compares epochs with a reference, and raises alarms by rules.

    Args:
        rules: the rules.
        interval: time from one epoch to the next, seconds.
        objects: names or patterns of points that may move; all others with unknown coordinates are
            reference points. Without such points, as by default, the reference is the datum alone:
            the points that the epochs hold.
        reference_epochs: number of the first epochs whose mean is the reference.
        motion: how objects are thought to move; None: ``MotionModel()``, a constant velocity.
        last: number of epochs before the added one with whose mean it is compared, too; 0: none.

    Raises:
        InputError: two rules have one name, the numbers are not positive, or a rule tests the
            velocity of points that have none.
    """

    def __init__(
        self,
        rules: Sequence[AlarmRule],
        *,
        interval: float,
        objects: Sequence[str] = ("*",),
        reference_epochs: int = 1,
        motion: MotionModel | None = None,
        last: int = 0,
    ) -> None:
        self.rules = rules_named_once(rules)
        if not interval > 0 or reference_epochs < 1 or last < 0:
            raise InputError(
                "a monitor has an interval > 0, reference_epochs ≥ 1 and last ≥ 0; not "
                f"{interval}, {reference_epochs}, {last}"
            )
        if isinstance(objects, str):
            raise InputError(f"objects must be a list of names or patterns, not {objects!r}")
        self.interval, self.objects, self.last = float(interval), tuple(objects), last
        self.reference_epochs = reference_epochs
        self.motion = MotionModel() if motion is None else motion
        if self.motion.kind != "velocity":
            wrong = [r.name for r in self.rules if r.test == "velocity"]
            what = f"tests a velocity, and points of the motion {self.motion.kind!r} have none"
            if wrong:
                raise InputError(Problem(what, f"alarm {name!r}") for name in wrong)
        self._reference = MeanEstimate()
        self._base: EpochEstimate | None = None
        self._mean = MeanEstimate()
        self._recent: list[EpochEstimate] = []
        self._levels: RuleLevels | None = None
        self._motions: dict[str, Motion] = {}
        self._sums: dict[tuple[str, str], Array] = {}
        self._alarms: dict[tuple[str, str], AlarmState] = {}
        self._time = -np.inf

    @classmethod
    def of(
        cls, epochs: Iterable[EpochEstimate], rules: Sequence[AlarmRule], **options: object
    ) -> Monitor:
        """Return a monitor that has seen some epochs, as after a restart.

        Args:
            epochs: the epochs, in time.
            rules: the rules.
            options: those of a monitor.
        """
        found = cls(rules, **options)  # type: ignore[arg-type]
        for epoch in epochs:
            found.add(epoch)
        return found

    def to_json(self) -> dict[str, Any]:
        """Return what the monitor knows of its epochs as values of JSON, all digits."""
        levels = self._levels
        return {
            "reference": None if self._base is not None else self._reference.to_json(),
            "base": None if self._base is None else self._base.to_json(),
            "mean": self._mean.to_json(),
            "recent": [e.to_json() for e in self._recent],
            "levels": None if levels is None else {n: dict(getattr(levels, n)) for n in _LEVELS},
            "motions": {name: motion.to_json() for name, motion in self._motions.items()},
            "sums": [[*key, s.tolist()] for key, s in self._sums.items()],
            "alarms": [asdict(a) for a in self._alarms.values()],
            "time": self._time,
        }

    def resume(self, record: Mapping[str, Any]) -> None:
        """Know what another monitor with the same rules and options knew.

        Args:
            record: its record of `to_json`.
        """
        base, levels = record["base"], record["levels"]
        self._base = None if base is None else EpochEstimate.from_json(base)
        if base is None:
            self._reference = MeanEstimate.from_json(record["reference"])
        self._mean = MeanEstimate.from_json(record["mean"])
        self._recent = [EpochEstimate.from_json(e) for e in record["recent"]]
        self._levels = None if levels is None else RuleLevels(**levels)
        self._motions = {
            name: Motion.from_json(m, self.motion) for name, m in record["motions"].items()
        }
        self._sums = {(rule, point): np.array(s, float) for rule, point, s in record["sums"]}
        states = [AlarmState(**a | {"exceeded": tuple(a["exceeded"])}) for a in record["alarms"]]
        self._alarms = {(a.rule, a.point): a for a in states}
        self._time = float(record["time"])

    @property
    def reference(self) -> EpochEstimate | None:
        """The reference; None before its last epoch."""
        return self._base

    @property
    def open_alarms(self) -> tuple[AlarmState, ...]:
        """Alarms that are raised."""
        return tuple(a for a in self._alarms.values() if a.raised)

    @property
    def levels(self) -> RuleLevels | None:
        """Critical values of the rules; None before the first epoch after the reference."""
        return self._levels

    @with_one_thread
    def add(self, epoch: EpochEstimate) -> Findings:
        """Add an epoch and return what it tells.

        Raises:
            InputError: it is not later than the last one; a rule has no points, or its rate cannot
                be kept; an epoch of the reference has another frame than the others, or holds
                other coordinates. A later epoch that cannot be compared raises nothing: `Findings`
                have the reason as ``problem``.
        """
        if not epoch.time > self._time:
            raise InputError(
                Problem(
                    f"its time {epoch.time} is not after that of the last epoch, {self._time}: "
                    "a monitor takes epochs in time; give all of them to a new one",
                    f"epoch {epoch.number}",
                )
            )
        self._time = epoch.time
        if self._base is None:
            self._reference.add(epoch)
            self._mean.add(epoch)
            self._recent = [*self._recent, epoch][-self.last :] if self.last else []
            if len(self._reference) == self.reference_epochs:
                self._base = self._reference.estimate(epoch.number)
            return Findings(epoch.number, epoch.time)
        try:
            found = self._compared(self._base, epoch)
            innovations = self._compared(self._mean.estimate(), epoch, stable=found.stable)
            recent = self._compared_with_last(epoch)
        except AdjustmentError as error:
            return Findings(epoch.number, epoch.time, problem=str(error))
        findings = self._tested(self._base, epoch, found, innovations, recent)
        self._mean.add(epoch)
        self._recent = [*self._recent, epoch][-self.last :] if self.last else []
        return findings

    def _compared(
        self, first: EpochEstimate, second: EpochEstimate, stable: Sequence[str] | None = None
    ) -> EpochComparison:
        """Compare two epochs; ``stable``: reference points that kept their places."""
        free = set(np.array(second.names)[second.free.any(axis=1)].tolist())
        both = [n for n, f in zip(first.names, first.free, strict=True) if f.any() and n in free]
        objects = [n for n in both if matches(n, self.objects)]
        reference = [n for n in both if n not in objects] if stable is None else list(stable)
        if not objects:
            raise InputError("none of the objects is in the epoch and in the reference")
        return compare_epochs(
            first,
            second,
            reference=reference,
            objects=objects,
            variance="a-priori",
            alpha=self._reference_alpha() if stable is None else 1e-9,
        )

    def _reference_alpha(self) -> float:
        rates = [r.false_alarms_per_month for r in self.rules]
        lowest = REFERENCE_PART * min(rates, default=1.0) / epochs_per_month(self.interval)
        return min(MAX_REFERENCE_ALPHA, lowest)

    def _compared_with_last(self, epoch: EpochEstimate) -> EpochComparison | None:
        if not self.last or len(self._recent) < self.last:
            return None
        return self._compared(mean_estimate(self._recent[-self.last :]), epoch)

    def _tested(
        self,
        base: EpochEstimate,
        epoch: EpochEstimate,
        found: EpochComparison,
        innovations: EpochComparison,
        recent: EpochComparison | None,
    ) -> Findings:
        """Return what an epoch tells once it is compared."""
        parts = covariance_parts(found, base)
        objects = [n for n in found.displacements if matches(n, self.objects) and n in parts]
        if self._levels is None:
            self._levels = RuleLevels.of(
                self.rules,
                found,
                {n: parts[n] for n in objects},
                base,
                self.interval,
                self.motion,
                self.objects,
            )
        self._levels = self._levels.with_shape(self.rules, found, base, self.interval)
        points: dict[str, PointFinding] = {}
        events: list[AlarmEvent] = []
        axes = ["xyz".index(a) for a in found.differences.axes]
        for name in objects:
            of_epoch, of_reference = parts[name]
            x = found.displacements[name]
            state = self._motions.get(name) or Motion.at(base.time, of_reference, self.motion)
            state = self._motions[name] = state.updated(epoch.time, x.vector[axes], of_epoch)
            tests = tuple(
                self._point_test(rule, x, state, innovations.displacements[name], axes)
                for rule in self.rules
                if rule.test != "congruence" and rule.covers(name)
            )
            points[name] = PointFinding(x, of_epoch, state, tests)
            events += self._alarmed(name, tests, epoch.number)
        of_shape = self._shape_tests(found)
        events += self._alarmed(OF_REFERENCE, of_shape, epoch.number)
        return Findings(epoch.number, epoch.time, found, recent, points, of_shape, tuple(events))

    def _point_test(
        self,
        rule: AlarmRule,
        x: Displacement,
        state: Motion,
        innovation: Displacement,
        axes: list[int],
    ) -> TestedEpoch:
        """Return what a rule finds for a point."""
        assert self._levels is not None
        levels, h = self._levels, len(axes)
        names = ["xyz"[a] for a in axes]
        if rule.test == "displacement":
            value = x.test.value * x.test.freedom[0]
            sigma = float(np.sqrt(np.linalg.eigvalsh(x.covariance)[-1]))
            detectable = 1e3 * levels.detectable(rule, x.name, h) * sigma
            parts = zip(names, 1e3 * x.vector[axes], strict=True)
            critical = levels.critical(rule, h)
            return outcome_of(rule, value, critical, 1e3 * x.length, detectable, parts)
        if rule.test == "velocity":
            sigma = float(np.sqrt(np.linalg.eigvalsh(state.steady_velocity_covariance)[-1]))
            per_day = 1e3 * DAY_S
            size = per_day * float(np.linalg.norm(state.velocity))
            detectable = per_day * sigma * levels.detectable(rule, x.name, h)
            parts = zip(names, per_day * state.velocity, strict=True)
            critical = levels.critical(rule, h)
            return outcome_of(rule, state.velocity_test(), critical, size, detectable, parts)
        q = innovation.covariance[np.ix_(axes, axes)]
        u = np.linalg.solve(np.linalg.cholesky(q), innovation.vector[axes])
        before = self._sums.get((rule.name, x.name), np.zeros(h))
        s = self._sums[rule.name, x.name] = next_sum(before, u, rule.allowance)
        size = 1e3 * innovation.length
        parts = zip(names, 1e3 * innovation.vector[axes], strict=True)
        critical = levels.critical(rule, h)
        return outcome_of(rule, float(np.linalg.norm(s)), critical, size, np.nan, parts)

    def _shape_tests(self, found: EpochComparison) -> tuple[TestedEpoch, ...]:
        assert self._levels is not None
        test = found.global_test
        if test is None or test.freedom[0] == 0:
            return ()
        h = test.freedom[0]
        return tuple(
            outcome_of(rule, test.value * h, self._levels.critical(rule, h), 0.0, np.nan)
            for rule in self.rules
            if rule.test == "congruence" and rule.name in self._levels.levels
        )

    def _alarmed(self, point: str, tests: Sequence[TestedEpoch], epoch: int) -> list[AlarmEvent]:
        """Give tests to the alarms of a point, and return what changed."""
        events = []
        rules = {r.name: r for r in self.rules}
        for found in tests:
            rule = rules[found.rule]
            before = self._alarms.get((rule.name, point), AlarmState(rule.name, point))
            after, change = next_alarm(before, rule.life, found, epoch)
            self._alarms[rule.name, point] = after
            if change is None:
                continue
            if change == "cleared":
                self._sums.pop((rule.name, point), None)
            since = after.since if after.since is not None else before.since
            assert since is not None
            said = sentence_of(rule, point, change, found, after)
            events.append(AlarmEvent(change, rule.name, point, epoch, since, said))
        return events


def covariance_parts(
    found: EpochComparison, first: EpochEstimate
) -> dict[str, tuple[Array, Array]]:
    """Return what the second and the first epoch have in the cofactors of displacements.

    The displacements of points that are not stable are A (x₂ − x₁), A = (CᵀWC)⁻¹CᵀW.

    Args:
        found: the comparison.
        first: its first epoch.

    Returns:
        A Q₂ Aᵀ and A Q₁ Aᵀ of each point, (k, k) metres², by its name.
    """
    k = len(found.differences.axes)
    loose = [n for n, x in found.displacements.items() if not x.stable]
    rows = found.differences.rows((*found.stable, *loose))
    g = motion_basis(found.differences.motions[rows])
    w = weight_of_differences(found.differences.cofactor[np.ix_(rows, rows)], g)
    a = found.joint @ w[len(found.stable) * k :]
    number = {n: i for i, n in enumerate(first.names)}
    axes = np.array(["xyz".index(x) for x in found.differences.axes])
    at = np.array([number[n] for n in (*found.stable, *loose)], dtype=np.intp)
    q = first.cofactors_of((3 * at[:, None] + axes).ravel())
    out = {}
    for i, name in enumerate(loose):
        own = slice(i * k, (i + 1) * k)
        of_first = a[own] @ q @ a[own].T
        out[name] = found.joint[own, own] - of_first, (of_first + of_first.T) / 2.0
    return out
