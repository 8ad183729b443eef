"""False alarms and detections of a dam: ``python -m tests.benchmarks.monitoring [N [SEED]]``.

Plays N = 200 times, with seeds from SEED = 0 on, thirty days of the dam of `tests.networks.dam`, an
epoch every day through `adjust`, with weather, refraction and outages, two displacements of 1.5
times the detectable size, one of exactly the detectable size, and one slow creep. The first four
days are the reference.
Prints how many false alarms every rule raised and how often it found what moved, beside what it
states, with the interval in which 99 % of such counts lie (Poisson, binomial); what there is after
every tenth part of N goes to standard error.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from time import process_time

import numpy as np
from scipy.stats import binom, poisson

import factorgraph_adj as fga
from factorgraph_adj.monitoring.alarm_rules import AlarmRule
from factorgraph_adj.monitoring.cumulative_sums import limit_of_run_length, next_sum
from factorgraph_adj.monitoring.epoch_estimates import EpochEstimate
from factorgraph_adj.monitoring.monitor import Findings, Monitor
from factorgraph_adj.monitoring.motion_filter import DAY_S
from factorgraph_adj.monitoring.raise_rates import AlarmLife, RaiseRate
from factorgraph_adj.monitoring.velocity_rates import VelocityRate, raisings
from factorgraph_adj.statistical_tests import chi2_upper_quantile
from tests.networks.dam import OBJECTS, dam_epoch, drawn_weather

REPETITIONS = 200
INTERVAL = DAY_S
"""Seconds."""
EPOCHS, REFERENCE = 30, 4
"""Epochs of thirty days, and those of the reference among them."""
RATE = 0.5
"""False alarms of each rule in a month."""
RULES = (
    AlarmRule("one epoch", false_alarms_per_month=RATE),
    AlarmRule("2 of 3", false_alarms_per_month=RATE, life=AlarmLife(2, 3, clear_after=3)),
    AlarmRule("velocity", "velocity", false_alarms_per_month=RATE),
    AlarmRule("cusum", "cusum", false_alarms_per_month=RATE),
    AlarmRule("reference", "congruence", false_alarms_per_month=RATE),
)
FACTORS = {"D3": 1.5, "D8": 1.5, "D11": 1.0}
"""Displaced points, and the size relative to the detectable one of the rule 2 of 3."""
CREEPING, CREEP_MM_PER_DAY, CREEP_FROM = "D5", 0.04, 8
"""The point that creeps, along y, and the epoch after which it begins."""
FIRST_MOVE, LAST_MOVE = 10, 26
"""Epochs between which displacements fall."""


@dataclass
class Played:
    """What the repetitions came to, by rules."""

    repetitions: int = 0
    false: dict[str, list[int]] = field(default_factory=dict)
    """False alarms of each repetition."""
    expected: dict[str, float] = field(default_factory=dict)
    """Their expected number in all repetitions."""
    found: dict[tuple[str, str], list[int]] = field(default_factory=dict)
    """Epochs to the alarm of what moved, by rule and point; −1: none by the end."""
    powers: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    """Stated probability that it is found, in n epochs for a displacement, else by the end."""
    problems: int = 0
    """Epochs that could not be compared."""
    lost: int = 0
    """Epochs that were lost."""


def _estimate(
    rng: np.random.Generator, number: int, moved: dict[str, np.ndarray], per_week: int = 7
) -> EpochEstimate | None:
    weather = drawn_weather(rng, number, per_week)
    if weather is None:
        return None
    return EpochEstimate.of(fga.adjust(dam_epoch(rng, moved, weather)), number, INTERVAL * number)


def play(seed: int, played: Played, epochs: int = EPOCHS) -> None:
    """Play one repetition, and add what it came to."""
    rng = np.random.default_rng([41, seed])
    monitor = Monitor(RULES, interval=INTERVAL, objects=["D*"], reference_epochs=REFERENCE)
    moves = {n: int(rng.integers(FIRST_MOVE, min(LAST_MOVE, epochs - 4))) for n in FACTORS}
    shifts: dict[str, np.ndarray] = {}
    before: Findings | None = None
    raised: dict[tuple[str, str], list[int]] = {}
    tested: list[Findings] = []
    for number in range(epochs):
        for name, at in moves.items():
            if number == at and before is not None:
                x = before.points[name]
                size = FACTORS[name] * next(t.detectable_mm for t in x.tests if t.rule == "2 of 3")
                shifts[name] = 1e-3 * size * x.displacement.hardest
        moved = dict(shifts)
        days = (number - CREEP_FROM) * INTERVAL / DAY_S
        if days > 0:
            moved[CREEPING] = np.array([0.0, 1e-3 * CREEP_MM_PER_DAY * days, 0.0])
        epoch = _estimate(rng, number, moved)
        if epoch is None:
            played.lost += 1
            continue
        found = monitor.add(epoch)
        played.problems += bool(found.problem)
        if not found.points:
            continue
        tested.append(found)
        before = found
        for a in found.raised:
            raised.setdefault((a.rule, a.point), []).append(number)
    _count(monitor, tested, moves, shifts, raised, played)


def _count(
    monitor: Monitor,
    tested: Sequence[Findings],
    moves: dict[str, int],
    shifts: dict[str, np.ndarray],
    raised: dict[tuple[str, str], list[int]],
    played: Played,
) -> None:
    """Count the false alarms and the detections of a repetition."""
    played.repetitions += 1
    numbers = [f.number for f in tested]
    until = {**moves, CREEPING: CREEP_FROM + 1}
    levels = monitor.levels
    assert levels is not None
    for rule in RULES:
        false, expected = 0, 0.0
        points = [""] if rule.test == "congruence" else OBJECTS
        for point in points:
            end = until.get(point, EPOCHS)
            false += sum(n < end for n in raised.get((rule.name, point), ()))
            watched = sum(n < end for n in numbers)
            expected += _expected(rule, levels.levels[rule.name], watched, len(points))
        played.false.setdefault(rule.name, []).append(false)
        played.expected[rule.name] = played.expected.get(rule.name, 0.0) + expected
    for point, at in until.items():
        for rule in RULES:
            if rule.test == "congruence" or (point != CREEPING and rule.test == "velocity"):
                continue
            after = [n for n in numbers if n >= at]
            alarms = raised.get((rule.name, point), ())
            times = [sum(a <= n for a in after) for n in alarms if n >= at]
            early = [n for n in alarms if n < at]
            if early and max(early) > at - 4:
                continue  # an alarm that was on already says nothing of the motion
            key = rule.name, point
            played.found.setdefault(key, []).append(times[0] if times else -1)
            if point != CREEPING and rule.test == "displacement":
                size = _size_in_sigmas(tested, point, shifts[point], after[: rule.life.n])
                rate = levels.rate(rule, point, 3)
                power = rate.power(levels.levels[rule.name], size)
                played.powers.setdefault(key, []).append(power)
            elif point == CREEPING and rule.test in ("velocity", "cusum"):
                of_y = [np.linalg.inv(f.points[point].of_epoch)[1, 1] ** -0.5 for f in tested]
                sigma = round(float(np.mean(of_y)), 5)
                power = _creep_power(rule, levels.levels[rule.name], len(after), sigma)
                played.powers.setdefault(key, []).append(power)


def _size_in_sigmas(
    tested: Sequence[Findings], point: str, shift: np.ndarray, epochs: Sequence[int]
) -> float:
    sizes = [
        float(np.sqrt(shift @ np.linalg.solve(f.points[point].displacement.covariance, shift)))
        for f in tested
        if f.number in epochs and point in f.points
    ]
    return float(np.mean(sizes))


@cache
def _expected(rule: AlarmRule, level: float, epochs: int, points: int) -> float:
    """Return the expected number of false alarms of one point in its first epochs."""
    share = 1.0 / (1.0 + REFERENCE)
    if rule.test == "cusum":
        return float(_cusum_raisings(rule, level)[:epochs].sum())
    if rule.test == "velocity":
        return float(_velocity_raisings(rule, level)[:epochs].sum())
    freedom = 3 * 7 - 3 if rule.test == "congruence" else 3
    return RaiseRate(freedom, share, rule.life).expected_raisings(level, epochs)


@cache
def _cusum_raisings(rule: AlarmRule, level: float) -> np.ndarray:
    """Return the expected number of false alarms of the sums of a point from 0 on, by epochs."""
    limit = limit_of_run_length(3, rule.allowance, level)
    rng, n = np.random.default_rng(8), 100_000
    s, out = np.zeros((n, 3)), np.zeros(EPOCHS - REFERENCE)
    for i in range(len(out)):
        s = next_sum(s, rng.standard_normal(s.shape), rule.allowance)
        beyond = np.linalg.norm(s, axis=1) > limit
        out[i] = beyond.sum() / n
        s = s[~beyond]
    return out


@cache
def _velocity_raisings(rule: AlarmRule, level: float) -> np.ndarray:
    """Return the expected number of false alarms of the velocity of a point, by epochs."""
    rng = np.random.default_rng(7)
    t = _velocity_rate(0.00036).simulated(100_000, EPOCHS - REFERENCE, rng)
    begun = raisings(t, float(chi2_upper_quantile(level, 3)), rule.life)
    return np.asarray(begun.mean(axis=0))


def _velocity_rate(sigma: float) -> VelocityRate:
    from factorgraph_adj.monitoring.motion_filter import MotionModel

    return VelocityRate(3, round(1.0 / (1.0 + REFERENCE), 3), sigma, INTERVAL, MotionModel())


@cache
def _creep_power(rule: AlarmRule, level: float, epochs: int, sigma: float) -> float:
    """Return the probability that a rule finds the creep by the end; σ of an epoch along it."""
    begin = CREEP_FROM - REFERENCE
    per_second = 1e-3 * CREEP_MM_PER_DAY / DAY_S
    if rule.test == "velocity":
        by = _velocity_rate(sigma).detection(level, rule.life, per_second, begin, epochs)
        return float(by[-1])
    limit = limit_of_run_length(3, rule.allowance, level)
    rng = np.random.default_rng(3)
    n, total = 20_000, begin + epochs
    path = np.maximum(np.arange(total) + 1 - begin, 0) * per_second * INTERVAL / sigma
    mean = rng.standard_normal((n, 3)) / np.sqrt(REFERENCE)
    s, out, early = np.zeros((n, 3)), np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    for i in range(total):
        y = rng.standard_normal((n, 3))
        y[:, 0] += path[i]
        weight = REFERENCE + i
        s = next_sum(s, (y - mean) / np.sqrt(1.0 + 1.0 / weight), rule.allowance)
        mean += (y - mean) / (weight + 1.0)
        beyond = np.linalg.norm(s, axis=1) > limit
        if i < begin:
            early |= beyond
        else:
            out |= beyond
    return float(out[~early].mean())


def rows(played: Played) -> list[tuple[str, ...]]:
    """Return the table: what, counted, stated, 99 % interval, and whether it lies within."""
    out: list[tuple[str, ...]] = []
    for rule in RULES:
        n, mean = sum(played.false[rule.name]), played.expected[rule.name]
        low, high = poisson.ppf(0.005, mean), poisson.ppf(0.995, mean)
        each = np.array(played.false[rule.name])
        spread = float(each.var() / max(each.mean(), 1e-9))
        out.append(
            (
                f"false alarms, {rule.name}",
                f"{n}",
                f"{mean:.1f}",
                f"{low:.0f} to {high:.0f}",
                "yes" if low <= n <= high else "NO",
                f"variance/mean {spread:.2f}",
            )
        )
    for (rule_name, point), times in sorted(played.found.items()):
        powers = played.powers.get((rule_name, point))
        if powers is None:
            continue
        rule = next(r for r in RULES if r.name == rule_name)
        within = rule.life.n if point != CREEPING else EPOCHS
        n, p = sum(0 < t <= within for t in times), float(np.mean(powers))
        low, high = binom.ppf(0.005, len(times), p), binom.ppf(0.995, len(times), p)
        ever = sorted(t for t in times if t > 0)
        median = ever[len(ever) // 2] if ever else -1
        out.append(
            (
                f"found, {rule_name}, {point}",
                f"{n} of {len(times)}",
                f"{len(times) * p:.1f} ({p:.4f})",
                f"{low:.0f} to {high:.0f}",
                "yes" if low <= n <= high else "NO",
                f"median {median} epochs, mean {np.mean(ever) if ever else -1:.1f}",
            )
        )
    return out


def main(argv: Sequence[str]) -> None:
    """Play, and print the table."""
    n = int(argv[0]) if argv else REPETITIONS
    first = int(argv[1]) if len(argv) > 1 else 0
    played, begin = Played(), process_time()
    for done in range(1, n + 1):
        play(first + done - 1, played)
        if done % max(n // 10, 1) == 0 and done < n:
            print(told(played), file=sys.stderr, flush=True)
    print(told(played))
    print(f"{process_time() - begin:.0f} s of processor time")


def told(played: Played) -> str:
    """Return the table as text."""
    lines = [
        f"{played.repetitions} times {EPOCHS} epochs; {played.lost} lost, "
        f"{played.problems} not compared",
        "| what | counted | stated | 99 % | within | |",
        "| --- | --- | --- | --- | --- | --- |",
        *("| " + " | ".join(row) + " |" for row in rows(played)),
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main(sys.argv[1:])
