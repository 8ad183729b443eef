"""What was left out comes back after a command where it fits by now; gross errors stay out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ledger.verdicts import Policy
from factorgraph_adj.linear_system.front_system import FrontSystem
from factorgraph_adj.linear_system.isam2_system import ISAM2System
from factorgraph_adj.linear_system.predictions import UNANSWERED
from factorgraph_adj.observations import HeightDifference
from factorgraph_adj.types import Array, Index

MM = 1e-3
GOOD = tuple(f"good {i}" for i in range(11))


def levelled(ident: str, value: float, sigma: float = MM) -> HeightDifference:
    """Return a reading of the one height difference."""
    return HeightDifference("A", "B", value, sigma=sigma, id=ident)


def bare() -> fga.Network:
    """Return a benchmark, and a point without a height."""
    network = fga.Network("two points")
    network.add_point("A", (0.0, 0.0, 100.0), fixed="xyz")
    network.add_point("B", (100.0, 0.0, np.nan), fixed="xy")
    return network


def misled(policy: Policy = "reject", journal: Path | None = None) -> fga.IncrementalAdjustment:
    """Return an adjustment whose unchecked first reading is 20 mm off, and which rejected others.

    Ten coarse readings are in: each alone agrees with the first one, all together do not.
    """
    rng = np.random.default_rng(1)
    inc = fga.IncrementalAdjustment(bare(), policy=policy, journal=journal)
    inc.add(levelled("wrong", 1.020))
    for i, e in enumerate(rng.uniform(-8 * MM, 8 * MM, 10)):
        assert inc.add(levelled(f"coarse {i}", 1.0 + e, 8 * MM)).verdicts[0].verdict == "accepted"
    for ident, e in zip(GOOD, rng.normal(0.0, MM, len(GOOD)), strict=True):
        assert inc.add(levelled(ident, 1.0 + e)).verdicts[0].verdict != "accepted"
    inc.add([levelled("bad", 0.9), levelled("slightly bad", 1.006)])
    return inc


def same_as_batch(inc: fga.IncrementalAdjustment) -> None:
    """Compare with the batch adjustment of what is in."""
    inc.settle()
    batch = fga.adjust(inc.network())
    assert inc.estimate("B")[2] == pytest.approx(batch.point("B")[2], abs=1e-9)
    assert inc.standard_deviations("B")[2] == pytest.approx(
        batch.standard_deviations("B")[2], rel=1e-6
    )
    assert inc.solution().vtpv == pytest.approx(batch.vtpv, rel=1e-6)


def test_good_readings_come_back_when_snooping_has_named_the_first_one(tmp_path: Path) -> None:
    journal = tmp_path / "day.jsonl"
    inc = misled(journal=journal)
    assert {v.id for v in inc.rejected} == {*GOOD, "bad", "slightly bad"}
    found = inc.snoop()
    assert [r.id for r in found.rejected] == ["wrong"]
    assert [v.id for v in inc.latest.verdicts] == list(GOOD)
    for v in inc.latest.verdicts:
        assert v.verdict == "accepted" and v.entered and v.controlled and v.test < 1.0
        assert v.cause == "came back after snoop()"
    causes = {v.id: v.cause for v in inc.rejected}
    assert causes == {"bad": "", "slightly bad": "", "wrong": "snooping"}
    assert inc.estimate("B")[2] == pytest.approx(101.0, abs=1 * MM)
    told = sorted(inc.rejected, key=lambda v: v.id)
    same_as_batch(inc)
    right = bare()
    for o in inc.network().observations.values():
        right.add(o)
    assert inc.estimate("B")[2] == pytest.approx(fga.adjust(right).point("B")[2], abs=1e-9)
    before = inc.network()
    del inc
    again = fga.IncrementalAdjustment.resume(journal)
    assert list(again.network().observations) == list(before.observations)
    for one, other in zip(told, sorted(again.rejected, key=lambda v: v.id), strict=True):
        assert (one.id, one.cause, one.verdict) == (other.id, other.cause, other.verdict)
        np.testing.assert_equal((one.t2, one.critical), (other.t2, other.critical))
    arrival = again.remove("coarse 0")
    assert not arrival.verdicts and {v.id for v in again.rejected} == {v.id for v in told}


@pytest.mark.parametrize("policy", ["reject", "flag"])
def test_good_readings_come_back_when_the_first_one_is_removed(policy: Policy) -> None:
    inc = misled(policy)
    arrival = inc.remove("wrong")
    assert [v.id for v in arrival.verdicts] == list(GOOD)
    assert {v.cause for v in arrival.verdicts} == {"came back after remove()"}
    assert {v.id for v in (*inc.rejected, *inc.suspects)} == {"bad", "slightly bad"}
    same_as_batch(inc)


def test_others_come_back_when_some_are_accepted_by_hand() -> None:
    """Eight against the wrong one: the other three fit what is in then, the bad ones do not."""
    inc = misled()
    arrival = inc.accept(GOOD[:8])
    assert [v.id for v in arrival.verdicts] == list(GOOD)
    assert [v.cause for v in arrival.verdicts[8:]] == ["came back after accept()"] * 3
    assert {v.id for v in inc.rejected} == {"bad", "slightly bad"}
    found = inc.snoop()
    assert [r.id for r in found.rejected] == ["wrong"]
    assert not inc.latest.verdicts
    same_as_batch(inc)


def test_readings_come_back_together_where_the_wrong_one_alone_determined_their_point() -> None:
    inc = fga.IncrementalAdjustment(bare(), policy="reject")
    for ident, value in (("wrong", 1.02), ("first", 1.0), ("second", 1.001), ("bad", 0.9)):
        inc.add(levelled(ident, value))
    arrival = inc.remove("wrong")
    assert {v.id for v in arrival.verdicts} == {"first", "second"}
    assert all(v.controlled and v.cause for v in arrival.verdicts)
    assert [v.id for v in inc.rejected] == ["bad"]
    same_as_batch(inc)


def test_what_nothing_tests_stays_rejected() -> None:
    """Nothing says that the reading that was removed was the wrong one."""
    inc = fga.IncrementalAdjustment(bare(), policy="reject")
    inc.add(levelled("first", 1.0))
    inc.add(levelled("bad", 1.5))
    arrival = inc.remove("first")
    assert not arrival.verdicts and not inc.n_waiting
    assert [v.id for v in inc.rejected] == ["bad"]
    assert not inc.determined("B")
    (verdict,) = inc.add(levelled("repeated", 1.0)).verdicts
    assert verdict.verdict == "accepted"
    assert inc.accept("bad").verdicts[0].verdict == "accepted"


def test_several_that_agree_do_not_outvote_what_is_in() -> None:
    """Each would fit among the others; with what is in alone none does."""
    inc = fga.IncrementalAdjustment(bare(), policy="reject")
    inc.add([levelled("first", 1.0), levelled("second", 1.0)])
    for i in range(20):
        inc.add(levelled(f"bad {i}", 1.006))
    inc.add(levelled("third", 1.0))
    assert not inc.remove("third").verdicts
    assert len(inc.rejected) == 20


def test_what_was_discarded_by_hand_stays_out() -> None:
    inc = misled("flag")
    inc.discard(GOOD[0])
    assert {v.cause for v in inc.rejected} == {"discarded"}
    inc.remove("wrong")
    assert [v.id for v in inc.rejected] == [GOOD[0]]


@pytest.mark.parametrize("policy", ["accept", "flag", "reject"])
def test_another_command_does_not_undo_a_strict_search(tmp_path: Path, policy: Policy) -> None:
    """2.6 σ: beyond the 5 % of the search, within the 0.1 % of arrivals."""
    journal = tmp_path / "day.jsonl"
    inc = fga.IncrementalAdjustment(bare(), policy=policy, journal=journal)
    inc.add([levelled(f"right {i}", 1.0) for i in range(8)] + [levelled("odd", 1.0026)])
    assert [r.id for r in inc.snoop(alpha=0.05).rejected] == ["odd"]
    del inc
    inc = fga.IncrementalAdjustment.resume(journal)
    assert not inc.remove("right 0").verdicts
    assert [v.id for v in inc.rejected] == ["odd"]
    assert inc.rejected[0].critical == pytest.approx(1.96**2, rel=1e-3)
    assert not inc.snoop(alpha=0.05).rejected


@pytest.mark.parametrize("policy", ["accept", "flag", "reject"])
def test_what_a_search_threw_out_comes_back_when_its_cause_has_left(policy: Policy) -> None:
    """Two wrong ones that agree are set against one right one, which comes back without them."""
    inc = fga.IncrementalAdjustment(bare(), policy=policy)
    inc.add([levelled("wrong 1", 1.02), levelled("wrong 2", 1.02)])
    inc.add([levelled("coarse", 1.0, 7 * MM), levelled("right", 1.0)])
    if policy != "accept":
        inc.accept("right")
    assert [r.id for r in inc.snoop().rejected] == ["right"]
    arrival = inc.remove(["wrong 1", "wrong 2"])
    assert [(v.id, v.verdict) for v in arrival.verdicts] == [("right", "accepted")]
    assert not inc.rejected


def line_of(seed: int) -> tuple[fga.Network, list[HeightDifference], set[str]]:
    """Return a levelling network of 12 points, 40 readings in random order, and three bad ones."""
    rng = np.random.default_rng(seed)
    z = rng.normal(0.0, 5.0, 12)
    network = fga.Network("levelling")
    for i, h in enumerate(z.tolist()):
        held = i < 2
        network.add_point(
            f"P{i}", (10.0 * i, 0.0, h if held else np.nan), fixed="xyz" if held else "xy"
        )
    pairs = [(int(rng.integers(0, i)), i) for i in range(2, 12)]
    pairs += [tuple(rng.choice(12, 2, replace=False).tolist()) for _ in range(30)]
    rng.shuffle(pairs)
    bad = set(rng.choice(40, 3, replace=False).tolist())
    readings = []
    for number, (a, b) in enumerate(pairs):
        e = MM * (rng.normal() + (rng.uniform(20.0, 100.0) if number in bad else 0.0))
        height = float(z[b] - z[a] + e)
        readings.append(HeightDifference(f"P{a}", f"P{b}", height, sigma=MM, id=str(number)))
    return network, readings, {str(i) for i in bad}


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 7, 9, 10])
def test_all_good_readings_are_in_when_the_bad_ones_are_removed(seed: int) -> None:
    """Bad ones that came early led to good ones being rejected; bad ones that came late are out."""
    network, readings, bad = line_of(seed)
    inc = fga.IncrementalAdjustment(network, policy="reject")
    for reading in readings:
        inc.add(reading)
    out = {v.id for v in inc.rejected}
    assert bad - out and out - bad
    inc.remove(bad - out)
    assert {v.id for v in inc.rejected} == bad & out
    for o in readings:
        if o.id not in bad:
            network.add(o)
    batch = fga.adjust(network)
    inc.settle()
    for name in network.points:
        assert inc.estimate(name)[2] == pytest.approx(batch.point(name)[2], abs=1e-8)


def test_what_has_no_test_says_so_until_it_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cofactors that rounding has spoiled: nothing comes back by them, and verdicts say why."""

    def spoiled(_: object, touched: object, a: Array, groups: Sequence[Index]) -> list[Array]:
        return [-2.0 * np.eye(len(rows)) for rows in groups]

    inc = misled("reject")
    out = {v.id for v in inc.rejected}
    with monkeypatch.context() as broken:
        for system in (FrontSystem, ISAM2System):
            broken.setattr(system, "function_cofactors", spoiled)
        inc.remove("wrong")
        assert {v.id for v in inc.rejected} == out
        assert all(v.doubt == UNANSWERED for v in inc.rejected)
    inc.settle()
    assert {"bad", "slightly bad"} >= {v.id for v in inc.rejected}
    assert not any(v.doubt for v in inc.rejected)
