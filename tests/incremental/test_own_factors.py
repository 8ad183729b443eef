"""A user's factor arrives like an observation, and the adjustment is that of the batch with it."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.entities import Point
from factorgraph_adj.graph.user_factors import KeyOf
from factorgraph_adj.observations import Direction, HorizontalDistance, SlopeDistance

PLACES = {
    "A": (0.0, 0.0),
    "B": (100.0, 0.0),
    "C": (0.0, 80.0),
    "P": (40.0, 30.0),
    "Q": (70.0, 60.0),
}
SIGMA = 0.002
ONE_PERCENT, MICRO = 0.01, 1e-6


def known_points() -> fga.Network:
    """Return three known points of a plane."""
    network = fga.Network("a plane")
    for name in "ABC":
        network.add_point(name, (*PLACES[name], 0.0), fixed="xyz")
    return network


def new_points() -> list[Point]:
    """Return two new points of the plane, roughly."""
    rough = np.array([0.4, -0.3])
    held = (False, False, True)
    return [Point(n, (*np.add(PLACES[n], rough).tolist(), 0.0), fixed=held) for n in "PQ"]


def distance(a: str, b: str) -> float:
    return float(np.linalg.norm(np.subtract(PLACES[a], PLACES[b])))


def readings() -> list[SlopeDistance]:
    """Return distances from the known points, with errors of a standard deviation."""
    rng = np.random.default_rng(5)
    return [
        SlopeDistance(a, b, distance(a, b) + SIGMA * rng.standard_normal(), sigma=SIGMA, id=a + b)
        for a in "ABC"
        for b in "PQ"
    ]


def tape(error: float = 0.0) -> Callable[[KeyOf], gtsam.NonlinearFactor]:
    """Return what makes a taped distance between the two new points."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, SIGMA)

    def make(key: KeyOf) -> gtsam.NonlinearFactor:
        ends = key("point", "P"), key("point", "Q")
        return gtsam.RangeFactor3(*ends, distance("P", "Q") + error, noise)

    return make


def whole() -> fga.Network:
    """Return everything but the factor at once."""
    network = known_points()
    for p in new_points():
        network.add_point(p.name, p.coordinates, fixed="z")
    network.add(*readings())
    return network


def assert_as_batch(
    inc: fga.IncrementalAdjustment, batch: fga.Solution, points: str, part: float
) -> None:
    """Compare coordinates and standard deviations with a batch adjustment, relative to σ."""
    assert inc.redundancy == batch.redundancy
    for p in points:
        sigma = batch.standard_deviations(p)[:2]
        assert np.all(np.abs(inc.estimate(p) - batch.point(p))[:2] < part * sigma)
        assert np.all(np.abs(inc.standard_deviations(p)[:2] - sigma) < part * sigma)


@pytest.mark.parametrize("when", [0, 2, 3, 6])
def test_the_adjustment_is_that_of_the_batch_whenever_the_factor_arrives(when: int) -> None:
    """It waits for its points; after three distances it determines the second one with another."""
    batch = fga.adjust(whole(), extra_factors={"tape": tape(0.003)})
    (wanted,) = fga.reliability(batch).factors
    inc = fga.IncrementalAdjustment(known_points(), policy="accept")
    inc.add(points=new_points())
    arriving = readings()
    inc.add(arriving[:when])
    first = inc.add(factors={"tape": tape(0.003)}).verdicts[0]
    assert first.points == ("P", "Q")
    assert first.verdict == ("waiting" if when < 3 else "accepted")
    if when == 0:
        assert "point 'Q' has 1 factor: 1 of the 2 readings that it needs" in first.lacks
    for o in arriving[when:]:
        inc.add(o)
    assert not inc.waiting
    assert_as_batch(inc, batch, "PQ", ONE_PERCENT)
    if when == 6:
        assert first.test == pytest.approx(wanted.test, rel=ONE_PERCENT)
        assert first.redundancy_numbers == pytest.approx(wanted.redundancy_numbers, rel=ONE_PERCENT)
    inc.settle()
    assert_as_batch(inc, batch, "PQ", MICRO)
    found = inc.reliability()
    assert found.w[found.row("tape")] == pytest.approx(wanted.w[0], rel=1e-5)
    again = fga.adjust(inc.network())
    assert again.vtpv == pytest.approx(batch.vtpv, rel=1e-8)


def test_points_that_come_later_do_not_change_what_a_factor_means() -> None:
    network = known_points()
    network.add_point("P", (40.4, 29.7, 0.0), fixed="z")
    inc = fga.IncrementalAdjustment(network)
    noise = gtsam.noiseModel.Isotropic.Sigma(1, SIGMA)
    taped = {
        "tape": lambda key: gtsam.RangeFactor3(
            key("point", "P"), key("point", "Q"), distance("P", "Q"), noise
        )
    }
    inc.add([o for o in readings() if o.target == "P"])
    inc.add(points=[p for p in new_points() if p.name == "Q"], factors=taped)
    inc.add([o for o in readings() if o.target == "Q"])
    inc.add(points=Point("R", (10.0, 10.0, 0.0), fixed=(False, False, True)))
    for a in "AB":
        inc.add(HorizontalDistance(a, "R", 20.0, sigma=SIGMA))
    inc.remove([o.id or "" for o in readings() if o.target == "P" and o.station == "A"])
    network = whole()
    del network.observations["AP"]
    batch = fga.adjust(network, extra_factors=taped)
    for p in "PQ":
        off = np.abs(inc.estimate(p) - batch.point(p))[:2]
        assert np.all(off < ONE_PERCENT * batch.standard_deviations(p)[:2])


@pytest.mark.parametrize("policy", ["flag", "reject"])
def test_a_wrong_factor_is_left_out_and_a_right_one_comes_back_with_its_point(policy: str) -> None:
    inc = fga.IncrementalAdjustment(whole(), policy=policy)  # type: ignore[arg-type]
    before = inc.solution()
    (verdict,) = inc.add(factors={"misread": tape(0.05)}).verdicts
    assert verdict.verdict == ("suspect" if policy == "flag" else "rejected")
    assert verdict.kind == "factor" and verdict.test > 2
    inc.accept("misread")
    assert [r.id for r in inc.snoop().rejected] == ["misread"]
    inc.add(factors={"tape": tape()})
    waits = inc.remove([o.id or "" for o in readings() if o.target == "Q"]).waits
    assert waits == ("tape",)
    inc.add(readings()[1::2])
    assert not inc.waiting
    inc.remove("tape")
    inc.settle()
    assert_as_batch(inc, before, "PQ", MICRO)


def test_a_reweighted_factor_is_that_of_another_noise_model() -> None:
    inc = fga.IncrementalAdjustment(whole())
    inc.add(factors={"tape": tape(0.003)})
    inc.reweight("tape", 4.0)
    noise = gtsam.noiseModel.Isotropic.Sigma(1, SIGMA / 2)

    def finer(key: KeyOf) -> gtsam.NonlinearFactor:
        ends = key("point", "P"), key("point", "Q")
        return gtsam.RangeFactor3(*ends, distance("P", "Q") + 0.003, noise)

    assert_as_batch(inc, fga.adjust(whole(), extra_factors={"t": finer}), "PQ", ONE_PERCENT)


def test_poses_calibrations_and_orientations_take_part() -> None:
    """A prior of a pose, a line of a camera in Python, and an orientation before its directions."""
    network = simulate_industry_block(seed=2).network
    photo, camera = next(iter(network.photos)), next(iter(network.cameras))
    network.add(Direction("P35", "P36", 0.1, sigma=1e-3, set="s"))
    plain = fga.adjust(network)
    there = plain.pose(photo)
    pose = gtsam.Pose3(gtsam.Rot3(there.rotation), there.position + 0.002)
    orientation = plain.unknown("orientation", "P35/s").values[0]

    def prior(key: KeyOf) -> gtsam.NonlinearFactor:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e-3] * 3 + [0.002] * 3))
        return gtsam.PriorFactorPose3(key("pose", photo), pose, noise)

    def lens(key: KeyOf) -> gtsam.NonlinearFactor:
        own, scale = key("calibration", camera), key.scale("calibration", camera)

        def error(this: object, values: gtsam.Values, jacobians: list[np.ndarray] | None) -> object:
            v = values.atVector(own)
            if jacobians is not None:
                jacobians[0] = np.eye(2, len(v)) * scale
            return (v * scale)[:2] - (100.01, 0.005)

        return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(2, 0.01), [own], error)

    def north(key: KeyOf) -> gtsam.NonlinearFactor:
        noise = gtsam.noiseModel.Isotropic.Sigma(1, 1e-3)
        return gtsam.PriorFactorVector(
            key("orientation", "P35/s"), np.array([orientation + 5e-4]), noise
        )

    factors = {"prior": prior, "lens": lens, "north": north}
    batch = fga.adjust(network, extra_factors=factors)
    wanted = fga.reliability(batch)
    inc = fga.IncrementalAdjustment(network)
    (of_pose, of_lens, of_set) = inc.add(factors=factors).verdicts
    assert of_lens.components == ("1", "2")
    assert inc.redundancy == batch.redundancy == plain.redundancy + 9
    for verdict in (of_pose, of_lens, of_set):
        assert verdict.test == pytest.approx(wanted.factor(verdict.id).test, rel=ONE_PERCENT)
    inc.settle()
    found = inc.solution()
    assert found.vtpv == pytest.approx(batch.vtpv, rel=1e-9)
    off = np.abs(found.pose(photo).position - batch.pose(photo).position)
    assert np.all(off < MICRO * batch.pose(photo).sigmas[3:])
    assert " factor  " in fga.text_report(found)
    assert not any("factor" in str(f) for f in fga.preliminary(inc.network()))
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.point("P36"), found.point("P36"))
    with pytest.raises(fga.InputError, match="left behind when its network was pickled"):
        fga.adjust(again.network)


def test_what_cannot_arrive_is_refused_by_name(tmp_path: Path) -> None:
    inc = fga.IncrementalAdjustment(whole())
    ready = tape()(fga.build_graph(whole()).keys)
    unit = gtsam.noiseModel.Unit.Create(3)
    wrong: dict[str, object] = {
        "factor 'x': give a function of key": ready,
        "factor 'x': unknown point 'Z'": lambda key: key("point", "Z"),
        "factor 'x': point 'A': is held altogether": lambda key: key("point", "A"),
        "factor 'x': its function must return": lambda key: None,
        "factor 'x': its function must ask key.kind, name. for every key": lambda key: ready,
        "factor 'x': a LinearContainerFactor has no noise model": lambda key: (
            gtsam.LinearContainerFactor(
                gtsam.JacobianFactor(key("point", "P"), np.eye(3), np.zeros(3), unit)
            )
        ),
    }
    for message, make in wrong.items():
        with pytest.raises(fga.InputError, match=message):
            inc.add(factors={"x": make})  # type: ignore[dict-item]
    with pytest.raises(fga.InputError, match="give factors by name"):
        inc.add(factors=[tape()])  # type: ignore[arg-type]
    inc.add(factors={"tape": tape()})
    with pytest.raises(fga.InputError, match="duplicate id 'tape'"):
        inc.add(factors={"tape": tape()})
    with pytest.raises(fga.InputError, match="no file can hold a factor"):
        fga.write_project(inc.network(), tmp_path / "project" / "project.toml")
    assert not (tmp_path / "project").exists()
    with pytest.raises(fga.InputError, match="no file can hold a factor"):
        inc.solution().save(tmp_path / "solution")
    kept = fga.IncrementalAdjustment(whole(), journal=tmp_path / "day.jsonl")
    with pytest.raises(fga.InputError, match="keeps a journal, which cannot hold a factor"):
        kept.add(factors={"tape": tape()})
    assert len(kept) == len(readings())


def test_copies_of_a_factor_have_the_residuals_and_partials_of_their_own_values() -> None:
    """So a fit evaluates it at many starts at once."""
    inc = fga.IncrementalAdjustment(whole())
    inc.add(factors={"tape": tape()})
    equations = inc.solution().equations
    (block,) = (b for b in equations.blocks if b.kind == "factor")
    points = equations.unknowns.start()["point"]
    rng = np.random.default_rng(6)
    states = [{"point": points + rng.normal(0.0, 0.5, points.shape)} for _ in range(3)]
    frame = equations.network.frame
    together = block.copies(3, {"point": len(points)}).evaluate(
        frame, {"point": np.concatenate([s["point"] for s in states])}
    )
    for i, state in enumerate(states):
        alone = block.evaluate(frame, state)
        np.testing.assert_array_equal(together.residual[i], alone.residual[0])
        for all_of_them, own in zip(together.jacobians, alone.jacobians, strict=True):
            np.testing.assert_array_equal(all_of_them[i], own[0])
