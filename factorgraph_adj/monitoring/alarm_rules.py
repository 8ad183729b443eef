"""Rules of alarms: a test, its points, and the number of false alarms in a month that is kept.

The critical value of a rule follows from its stated rate, the time between epochs, the number of
points and k of n epochs:

- displacement, congruence: from `factorgraph_adj.monitoring.raise_rates`, exactly, with the error
  of the reference that all epochs have in common.
- cusum: from the average run length of an integral equation, see
  `factorgraph_adj.monitoring.cumulative_sums`, exactly; the innovations have no reference in
  common. It is the rate in the long run: the sums begin at 0, and raise fewer in the first weeks.
- velocity: from a seeded simulation, see `factorgraph_adj.monitoring.velocity_rates`, with its
  relative standard deviation.

A false alarm is one alarm of one point that is raised while nothing moved. The expected number of
all points is the sum of theirs, whatever their datum makes them have in common: they are raised at
the same time where it is much. What the rates suppose: σ of the observations are right (σ0 = 1),
errors of different epochs do not depend on each other, and the reference points do not move. A
rule with a size raises fewer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any, Literal, TypeAlias, get_args

from ..errors import InputError, Problem, known
from ..io.csv_tables import FieldRow
from ..statistical_tests import POWER_OF_TEST
from .raise_rates import MAX_WINDOW, MONTH_S, AlarmLife

AlarmTest: TypeAlias = Literal["displacement", "velocity", "cusum", "congruence"]
"""What a rule tests: the displacement of a point against the reference in one epoch, its velocity,
the cumulative sum of its innovations, or the shape of the reference points."""
AlarmChange: TypeAlias = Literal["raised", "continues", "cleared"]
"""What an epoch does to an alarm."""
OF_REFERENCE = ""
"""Stands for the point of an alarm of a congruence test."""


@dataclass(frozen=True)
class AlarmRule:
    """What is tested, and how many false alarms are allowed.

    Raises:
        InputError: all fields that are wrong; a ``cusum`` whose ``life`` is not 1 of 1 epochs.
    """

    name: str
    """Name of the rule."""
    test: AlarmTest = "displacement"
    """What it tests."""
    points: tuple[str, ...] = ("*",)
    """Names or patterns of the objects, at least one; ``congruence`` takes no notice of them."""
    false_alarms_per_month: float = 0.1
    """Expected number of false alarms of all its points, in a month of 30.44 days."""
    size_mm: float = 0.0
    """Smallest length of the displacement (mm), of a ``velocity`` in mm/day, with which an alarm is
    raised, beside the test; of a ``cusum`` that of the present innovation (mm)."""
    life: AlarmLife = field(default_factory=AlarmLife)
    """k of n epochs, and when it is cleared."""
    allowance: float = 0.5
    """κ of a ``cusum``, in σ of an innovation: half of the shift that it shall find soonest."""
    power: float = POWER_OF_TEST
    """Power of the smallest detectable displacements."""

    def __post_init__(self) -> None:
        """Check the rule."""
        wrong = []
        if self.test not in (valid := get_args(AlarmTest)):
            wrong.append(f"unknown test {self.test!r}; valid: {known(valid, meant=self.test)}")
        if isinstance(self.points, str) or not self.points:
            wrong.append(f"points must be a list of names or patterns, not {self.points!r}")
        if not 0 < self.false_alarms_per_month < 1e4:
            wrong.append(
                "false_alarms_per_month must be positive and below 10000, not "
                f"{self.false_alarms_per_month}"
            )
        if not 0 <= self.size_mm < 1e6:
            wrong.append(f"size_mm must be at least 0, not {self.size_mm}")
        if not 0 < self.power < 1:
            wrong.append(f"power must lie between 0 and 1, not {self.power}")
        if self.test == "cusum" and not self.allowance > 0:
            wrong.append(f"allowance must be positive, not {self.allowance}")
        if self.test == "cusum" and (self.life.k, self.life.n) != (1, 1):
            wrong.append("a cusum sums over epochs itself: k and n must be 1")
        if wrong:
            raise InputError(Problem(what, f"alarm {self.name!r}") for what in wrong)

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> AlarmRule:
        """Return the rule of a table ``[[alarm]]``.

        Fields are those of the rule, and ``k``, ``n``, ``release``, ``clear_after`` beside them;
        ``clear_after`` is n, at least 2, unless it is stated.

        Raises:
            InputError: unknown fields, or wrong values.
        """
        row = FieldRow(record, "", [], f"alarm {record.get('name', '')!r}")
        rule = cls.of_row(row)
        row.refuse_left()
        if rule is None or row.problems:
            raise InputError(row.problems)
        return rule

    @classmethod
    def of_row(cls, row: FieldRow, others: Sequence[str] = ()) -> AlarmRule | None:
        """Return the rule of a table; None after problems, all of which are noted in the row.

        Args:
            row: the fields, see `of_record`; the caller refuses those that are left.
            others: values of ``test`` that are valid beside those of a rule, for messages.
        """
        stated: dict[str, Any] = {"name": row.text("name", required=True) or ""}
        stated["test"] = row.choice("test", (*get_args(AlarmTest), *others), "displacement")
        stated["points"] = row.texts("points", "names or patterns of points", '["D*", "E1"]')
        for name in ("false_alarms_per_month", "size_mm", "allowance", "power"):
            stated[name] = row.number(name)
        k = row.whole("k", least=1, most=MAX_WINDOW) or 1
        # Without a valid n, no later message is about it.
        n = row.whole("n", least=1, most=MAX_WINDOW) or (k if "n" in row else 1)
        clear_after = row.whole("clear_after", least=1) or max(2, n)
        release = row.number("release")
        release = AlarmLife.release if release is None else release
        life = row.made(lambda: AlarmLife(k, n, release, clear_after))
        stated["life"] = life or AlarmLife(min(k, n), n, clear_after=max(2, n))
        try:
            rule = cls(**{key: v for key, v in stated.items() if v is not None})
        except InputError as error:
            for p in error.noted:
                row.wrong(p.what)  # the row names the alarm
        return None if row.failed else rule

    def covers(self, point: str) -> bool:
        """Whether the rule watches a point."""
        return matches(point, self.points)

    def false_alarms_in(self, epochs: int, interval: float) -> float:
        """Return the stated number of false alarms in some epochs ``interval`` seconds apart."""
        return self.false_alarms_per_month * epochs * interval / MONTH_S


def matches(name: str, patterns: Iterable[str]) -> bool:
    """Return whether a name is one of some names or patterns such as ``D*``."""
    return any(name == p or fnmatchcase(name, p) for p in patterns)


def epochs_per_month(interval: float) -> int:
    """Return the number of epochs in a month, at least 1.

    Args:
        interval: time from one epoch to the next, seconds.
    """
    return max(round(MONTH_S / interval), 1)


@dataclass(frozen=True)
class AlarmState:
    """What is known of the alarm of a rule and a point after some epochs."""

    rule: str
    """Name of the rule."""
    point: str
    """The point; nothing for a congruence test."""
    since: int | None = None
    """Number of the epoch in which it was raised; None: it is not raised."""
    exceeded: tuple[bool, ...] = ()
    """Which of the last epochs exceeded, up to n, the latest last."""
    calm: int = 0
    """Number of epochs in a row below the release value since it was raised."""

    @property
    def raised(self) -> bool:
        """Whether it is raised."""
        return self.since is not None


@dataclass(frozen=True)
class TestedEpoch:
    """What the test of a rule found for a point in an epoch."""

    __test__ = False  # no test case of pytest

    rule: str
    """Name of the rule."""
    test: AlarmTest
    """What it tests."""
    value: float
    """T: a sum of squares in σ²; of a cusum |S|."""
    critical: float
    """Its critical value; H of a cusum."""
    size_mm: float
    """Displacement in mm, velocity in mm/day; of a cusum the displacement; 0 for congruence."""
    detectable_mm: float
    """Displacement (mm) or velocity (mm/day) that raises an alarm with the power of the rule in the
    direction in which it is hardest to see: of a displacement in the first n epochs after it, of a
    velocity since the reference in one epoch; NaN for a cusum and for congruence."""
    exceeds: bool
    """Whether value and size are beyond theirs."""
    calm: bool
    """Whether the value is below the release value."""
    components: tuple[tuple[str, float], ...] = ()
    """Axes that are compared, with the components of the size, mm or mm/day; nothing for
    congruence."""


@dataclass(frozen=True)
class AlarmEvent:
    """What an epoch did to an alarm, with a sentence for people."""

    change: AlarmChange
    """What it did."""
    rule: str
    """Name of the rule."""
    point: str
    """The point; nothing for a congruence test."""
    epoch: int
    """Number of the epoch."""
    since: int
    """Number of the epoch in which it was raised."""
    sentence: str
    """Why."""


def outcome_of(
    rule: AlarmRule,
    value: float,
    critical: float,
    size_mm: float,
    detectable_mm: float,
    components: Iterable[tuple[str, float]] = (),
) -> TestedEpoch:
    """Return what a test found; the release value is that of the life of the rule."""
    # T is a square, |S| of a cusum is not.
    release = rule.life.release if rule.test == "cusum" else rule.life.release**2
    return TestedEpoch(
        rule.name,
        rule.test,
        value,
        critical,
        size_mm,
        detectable_mm,
        value > critical and size_mm >= rule.size_mm,
        value <= release * critical,
        tuple((axis, float(x)) for axis, x in components),
    )


def next_alarm(
    state: AlarmState, life: AlarmLife, found: TestedEpoch, epoch: int
) -> tuple[AlarmState, AlarmChange | None]:
    """Return the state of an alarm after one more epoch, and what changed.

    Args:
        state: the state before.
        life: when it is raised and cleared.
        found: what the test found.
        epoch: number of the epoch.
    """
    seen = (*state.exceeded, found.exceeds)[-life.n :]
    if not state.raised:
        if found.exceeds and sum(seen) >= life.k:
            return replace(state, since=epoch, exceeded=seen, calm=0), "raised"
        return replace(state, exceeded=seen), None
    calm = state.calm + 1 if found.calm else 0
    if calm >= life.clear_after:
        return AlarmState(state.rule, state.point), "cleared"
    return replace(state, exceeded=seen, calm=calm), "continues"


def sentence_of(
    rule: AlarmRule, point: str, change: AlarmChange, found: TestedEpoch, state: AlarmState
) -> str:
    """Return what happened to an alarm, and why, as a sentence."""
    life, value = rule.life, f"T {found.value:.1f}, critical {found.critical:.1f}"
    times = f"{sum(state.exceeded)} of the last {len(state.exceeded)} epochs"
    of_n = f"; beyond it in {times}" if life.n > 1 and change == "raised" else ""
    rate = f"{rule.false_alarms_per_month:g} false alarms per month"
    digits = 3 if rule.test == "velocity" else 2
    parts = ", ".join(f"d{axis} {x:+.{digits}f}" for axis, x in found.components)
    of_axes = f" ({parts})" if parts else ""
    what = {
        "displacement": f"{point} lies {found.size_mm:.2f} mm{of_axes} from its place of reference",
        "velocity": f"{point} moves by {found.size_mm:.3f} mm a day{of_axes}",
        "cusum": f"{point} drifts from its mean place, now by {found.size_mm:.2f} mm{of_axes}",
        "congruence": "the reference points changed their shape",
    }[rule.test]
    if rule.test == "cusum":
        value = f"cumulative sum {found.value:.1f}, limit {found.critical:.1f}"
    if change == "cleared":
        whose = point or "the reference points"
        return (
            f"{rule.name}: {whose}, {rule.test} cleared after {life.clear_after} epochs below the "
            f"release value ({value})"
        )
    again = "still " if change == "continues" else ""
    return f"{rule.name}: {again}{what} ({value}{of_n}; stated: {rate})"


def rules_named_once(rules: Sequence[AlarmRule]) -> tuple[AlarmRule, ...]:
    """Return the rules.

    Raises:
        InputError: two rules have one name.
    """
    names = [r.name for r in rules]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(Problem("is the name of several rules", f"alarm {n!r}") for n in twice)
    return tuple(rules)
