"""The monitor: a dam whose points move, epochs of all kinds, and the same after a restart."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.alarm_rules import AlarmRule
from factorgraph_adj.monitoring.epoch_estimates import EpochEstimate
from factorgraph_adj.monitoring.monitor import Monitor, covariance_parts
from factorgraph_adj.monitoring.motion_filter import DAY_S, MotionModel
from factorgraph_adj.monitoring.raise_rates import AlarmLife
from tests.benchmarks.monitoring import Played, play, rows
from tests.networks.dam import OBJECTS, Weather, dam_epoch
from tests.networks.epochs import epoch

RULES = (
    AlarmRule("place", life=AlarmLife(2, 3, clear_after=3), false_alarms_per_month=0.1),
    AlarmRule("drift", "cusum", false_alarms_per_month=0.1),
    AlarmRule("shape", "congruence", false_alarms_per_month=0.1),
)
OPTIONS = {"interval": DAY_S, "objects": ["D*"], "reference_epochs": 3}


@cache
def templates():
    """Return two estimates of the dam: of everything, and without a station, GNSS and levels."""
    rng = np.random.default_rng(1)
    some = Weather(("T1", "T3"), gnss=False)
    return tuple(
        EpochEstimate.of(fga.adjust(dam_epoch(rng, None, w, noise=0.0)), 0, 0.0)
        for w in (Weather(levelling=True), some)
    )


def drawn(rng, number, moved=None, kind=0):
    """Return an epoch of the dam whose coordinates scatter as their cofactors say."""
    estimate = templates()[kind]
    values, vectors = np.linalg.eigh(estimate.cofactors)
    x = estimate.coordinates.copy()
    x[estimate.free] += vectors @ (np.sqrt(values.clip(0.0)) * rng.standard_normal(len(values)))
    for name, by in (moved or {}).items():
        x[estimate.names.index(name)] += by
    vtpv = float(rng.chisquare(estimate.redundancy))
    return replace(estimate, number=number, time=DAY_S * number, coordinates=x, vtpv=vtpv)


def series(seed, n, moved=lambda i: {}, kinds=(0,)):
    rng = np.random.default_rng(seed)
    return [drawn(rng, i, moved(i), kinds[i % len(kinds)]) for i in range(n)]


def test_a_displacement_is_found_and_told():
    def moved(i):
        return {"D4": np.array([0.0, 0.004, 0.0])} if i >= 8 else {}

    monitor = Monitor(RULES, last=2, **OPTIONS)
    found = [monitor.add(e) for e in series(5, 14, moved, kinds=(0, 0, 0, 1))]
    assert [bool(f.points) for f in found] == [False] * 3 + [True] * 11
    raised = [a for f in found for a in f.raised if a.rule == "place"]
    assert [(a.point, a.epoch) for a in raised] == [("D4", 9)]
    assert "place: D4 lies" in raised[0].sentence
    assert "2 of the last" in raised[0].sentence
    assert found[-1].comparison.moved == ("D4",)
    x = found[-1].points["D4"]
    assert x.displacement.vector == pytest.approx([0, 0.004, 0], abs=0.002)
    assert {a.point for a in monitor.open_alarms if a.rule == "place"} == {"D4"}
    (place, drift) = x.tests
    assert place.exceeds and place.value > place.critical > 0
    assert 1.0 < place.detectable_mm < 4.0
    assert np.isnan(drift.detectable_mm)
    # Against the last two epochs nothing moved, once both are of the new place.
    assert found[8].recent.moved == ("D4",)
    assert "D4" not in found[13].recent.moved or found[13].recent.displacements["D4"].length < 2e-3


def test_findings_are_those_of_a_comparison_with_the_first_epoch():
    first, second = (EpochEstimate.of(fga.adjust(epoch(i)), i, DAY_S * i) for i in (1, 2))
    monitor = Monitor(RULES[:1], interval=DAY_S, objects=["P", "Q"])
    with pytest.raises(InputError, match="alarm 'place': none of the objects is X"):
        wrong = Monitor([AlarmRule("place", points=("X",))], interval=DAY_S, objects=["P", "Q"])
        wrong.add(first)
        wrong.add(second)
    monitor.add(first)
    found = monitor.add(second)
    solutions = [fga.adjust(epoch(i)) for i in (1, 2)]
    expected = fga.congruence(*solutions, objects=["P", "Q"], variance="a-priori", alpha=1e-4)
    for name in ("P", "Q"):
        a, b = found.points[name].displacement, expected.displacements[name]
        assert a.vector == pytest.approx(b.vector, abs=1e-9)
        assert a.test.value == pytest.approx(b.test.value, rel=1e-6)


def test_parts_of_the_covariance():
    one, two = series(2, 2)
    monitor = Monitor(RULES[:1], interval=DAY_S, objects=["D*"])
    monitor.add(one)
    found = monitor.add(two)
    parts = covariance_parts(found.comparison, monitor.reference)
    assert set(parts) == set(OBJECTS)
    for name, (of_epoch, of_reference) in parts.items():
        total = found.comparison.displacements[name].covariance
        assert of_epoch + of_reference == pytest.approx(total, abs=1e-15)
        # Both epochs are alike.
        assert of_epoch == pytest.approx(of_reference, rel=1e-4, abs=1e-11)
    assert monitor.levels.shares["D1"] == pytest.approx(0.5, abs=1e-4)


def test_a_restart_continues():
    def moved(i):
        return {"D7": np.array([0.001 * max(i - 4, 0), 0.0, 0.0])}

    epochs = series(7, 10, moved)
    whole = Monitor(RULES, **OPTIONS)
    before = [whole.add(e) for e in epochs]
    stored = [EpochEstimate.from_json(e.to_json()) for e in epochs]
    again = Monitor.of(stored[:-1], RULES, **OPTIONS)
    last = again.add(stored[-1])
    assert last.alarms == before[-1].alarms
    assert again.open_alarms == whole.open_alarms
    assert len(last.alarms) >= 1
    for name, x in last.points.items():
        assert x.tests == before[-1].points[name].tests
        np.testing.assert_array_equal(x.motion.mean, before[-1].points[name].motion.mean)


@pytest.mark.parametrize("last", [0, 3])
@pytest.mark.parametrize("seen", [1, 2, 3, 5, 12])
def test_a_monitor_that_has_resumed_a_state_finds_the_same_in_all_digits(seen, last):
    """In the reference, at its last epoch, at the first test, and while alarms stand."""

    def moved(i):
        return {"D7": np.array([0.001 * max(i - 4, 0), 0.0, 0.0])}

    epochs = [EpochEstimate.from_json(e.to_json()) for e in series(7, 14, moved, kinds=(0, 1))]
    options = {**OPTIONS, "last": last}
    whole = Monitor(RULES, **options)
    for e in epochs[:seen]:
        whole.add(e)
    again = Monitor(RULES, **options)
    again.resume(json.loads(json.dumps(whole.to_json())))
    assert again.open_alarms == whole.open_alarms
    for e in epochs[seen:]:
        found, expected = again.add(e), whole.add(e)
        assert found.alarms == expected.alarms and found.problem == expected.problem
        assert found.reference_tests == expected.reference_tests
        assert found.points.keys() == expected.points.keys()
        for name, x in found.points.items():
            assert x.tests == expected.points[name].tests
            for what in ("mean", "covariance", "static_covariance", "response"):
                mine, other = (getattr(y.motion, what) for y in (x, expected.points[name]))
                np.testing.assert_array_equal(mine, other)
    assert json.dumps(again.to_json()) == json.dumps(whole.to_json())


def test_the_state_of_a_monitor_does_not_grow():
    monitor, sizes = Monitor(RULES, **OPTIONS), []
    for e in series(7, 30):
        monitor.add(e)
        sizes.append(len(json.dumps(monitor.to_json())))
    assert max(sizes[10:]) < 1.05 * sizes[9]


def test_a_creep_has_its_velocity():
    def moved(i):
        return {"D2": np.array([0.0, 0.0, -0.0005 * i])}

    rule = AlarmRule("speed", "velocity", points=("D1", "D2"), false_alarms_per_month=2.0)
    options = OPTIONS | {"motion": MotionModel(noise=0.0)}
    monitor = Monitor([rule], **options)
    for e in series(11, 12, moved):
        found = monitor.add(e)
    x = found.points["D2"]
    assert x.velocity_mm_per_day == pytest.approx(
        [0, 0, -0.5], abs=4 * x.velocity_sigmas_mm_per_day.max()
    )
    assert found.points["D1"].velocity_mm_per_day == pytest.approx([0, 0, 0], abs=0.3)
    assert [a.point for a in monitor.open_alarms] == ["D2"]
    assert 0 < monitor.levels.relative_errors["speed"] < 0.1
    assert x.tests[0].detectable_mm < 0.5
    assert found.points["D3"].tests == ()


def test_a_reference_point_that_moved_leaves_the_reference():
    def moved(i):
        return {"R2": np.array([0.02, 0.0, 0.0])} if i >= 5 else {}

    monitor = Monitor(RULES, **OPTIONS)
    found = [monitor.add(e) for e in series(3, 9, moved)]
    raised = [(a.rule, a.point, a.epoch) for f in found for a in f.raised]
    assert raised == [("shape", "", 5)]
    assert "R2" not in found[5].comparison.stable
    assert not [a for f in found for a in f.alarms if a.rule == "place"]


def test_epochs_that_tell_nothing_count_in_no_test():
    rng = np.random.default_rng(6)
    monitor = Monitor(RULES, **OPTIONS)
    for i in range(4):
        monitor.add(drawn(rng, i))
    points_alone = drawn(rng, 4)
    keep = [i for i, n in enumerate(points_alone.names) if n in ("D1", "R1")]
    rows_kept = np.array([3 * i + a for i in keep for a in range(3)])
    few = replace(
        points_alone,
        names=tuple(points_alone.names[i] for i in keep),
        coordinates=points_alone.coordinates[keep],
        components=np.arange(6),
        cofactors=points_alone.cofactors_of(rows_kept),
        motions=points_alone.motions_of(rows_kept),
    )
    found = monitor.add(few)
    assert found.problem
    assert not found.points
    assert not found.alarms
    assert monitor.add(drawn(rng, 5)).points
    with pytest.raises(InputError, match=r"epoch 5: its time .* is not after"):
        monitor.add(drawn(rng, 5))


def test_the_shape_is_tested_from_the_first_epoch_that_has_one():
    """The first epoch after the reference lacks reference points; later ones have them again."""
    rule = AlarmRule("shape", "congruence", false_alarms_per_month=0.1)
    some = (None, ("A", "C", "P", "Q"), None)
    monitor = Monitor([rule], interval=DAY_S, objects=["P", "Q"])
    tests = []
    for i, points in enumerate(some):
        solution = fga.adjust(epoch(i, datum="given"))
        found = monitor.add(EpochEstimate.of(solution, i, DAY_S * i, points=points))
        assert not found.problem
        tests.append(found.reference_tests)
    assert tests[:2] == [(), ()]
    assert tests[2][0].critical > tests[2][0].value > 0


def test_wrong_monitors_are_refused():
    speed = AlarmRule("speed", "velocity")
    with pytest.raises(InputError, match="alarm 'speed': tests a velocity, and points of the moti"):
        Monitor([speed], interval=DAY_S, motion=MotionModel("random walk", noise=0.1))
    with pytest.raises(InputError, match="interval > 0"):
        Monitor([], interval=0.0)
    with pytest.raises(InputError, match="objects must be a list"):
        Monitor([], interval=1.0, objects="D*")


def test_the_benchmark_counts():
    played = Played()
    play(1, played, 16)
    table = rows(played)
    assert len(table) == 5 + 8
    assert all(row[4] == "yes" for row in table if row[0].startswith("false"))
    assert played.problems == 0
