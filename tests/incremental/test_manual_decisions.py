"""Decisions by hand and their opposites: the state before is restored, also after a restart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.ledger.verdicts import Policy, Verdict
from factorgraph_adj.observations import Correlated, HeightDifference
from tests.support.playing import day, morning

MM = 1e-3
ROUNDING = 1e-9
"""Of estimates, relative to σ."""
POINTS = [f"P{i}" for i in range(2, 12)]
BOTH = pytest.mark.parametrize("engine", ["isam2", "fronts"])
POLICIES = pytest.mark.parametrize("policy", ["flag", "reject"])


def levelled(
    seed: int, policy: Policy, engine: Engine, journal: Path | None = None
) -> fga.IncrementalAdjustment:
    """Return a settled levelling network of 12 points with gross errors, one of them in the first.

    Correct readings of the point with it were left out, and some come back with a decision.
    """
    rng = np.random.default_rng(seed)
    z = rng.normal(0.0, 5.0, 12)
    network = fga.Network("levelling")
    for i, h in enumerate(z.tolist()):
        held = i < 2
        place = (10.0 * i, 0.0, h if held else np.nan)
        network.add_point(f"P{i}", place, fixed="xyz" if held else "xy")
    inc = fga.IncrementalAdjustment(network, policy=policy, engine=engine, journal=journal)
    pairs = [(int(rng.integers(0, i)), i) for i in range(2, 12)]
    pairs += [tuple(rng.choice(12, 2, replace=False).tolist()) for _ in range(40)]
    for number, (a, b) in enumerate(pairs):
        off = 0.02 if number in (3, 20, 31) else 0.0
        value = z[b] - z[a] + rng.normal(0.0, MM) + off
        inc.add(HeightDifference(f"P{a}", f"P{b}", value, sigma=MM, id=f"h{number}"))
    pair = [HeightDifference("P0", f"P{b}", z[b] - z[0], sigma=MM, id=f"g{b}") for b in (4, 5)]
    inc.add(Correlated(tuple(pair), MM**2 * np.array([[1.0, 0.5], [0.5, 1.0]])))
    inc.settle()
    return inc


def told(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return everything that verdicts say."""
    return {
        v.id: {
            k: str(x.tolist()) if isinstance(x, np.ndarray) else str(x)
            for k, x in vars(v).items()
            if k not in ("entered", "gains", "former")
        }
        | {"former": v.former and told([v.former])}
        for v in verdicts
    }


def state(inc: fga.IncrementalAdjustment) -> dict[str, Any]:
    """Return what is in, and what is said about what is out."""
    waiting = {w.id: w.lacks for w in inc.waiting}
    lists = {"suspects": told(inc.suspects), "rejected": told(inc.rejected), "waiting": waiting}
    return lists | {"accepted": {*inc.network().observations}, "decided": inc.decided}


def estimates(inc: fga.IncrementalAdjustment) -> tuple[np.ndarray, np.ndarray]:
    """Return heights and their σ, NaN where there are none."""
    there = [p if inc.determined(p) else None for p in POINTS]
    z = [np.nan if p is None else inc.estimate(p)[2] for p in there]
    sigma = [np.nan if p is None else inc.standard_deviations(p)[2] for p in there]
    return np.array(z), np.array(sigma)


def same(inc: fga.IncrementalAdjustment, before: dict[str, Any], places: Any) -> None:
    """Compare a state after `settle` with that of before."""
    inc.settle()
    assert state(inc) == before
    (z, sigma), (z0, sigma0) = estimates(inc), places
    np.testing.assert_array_less(np.abs(z - z0), ROUNDING * sigma0)
    np.testing.assert_allclose(sigma, sigma0, rtol=1e-6)


@BOTH
@POLICIES
@pytest.mark.parametrize("seed", range(2))
def test_every_decision_and_its_opposite_give_the_state_before(
    seed: int, policy: Policy, engine: Engine
) -> None:
    inc = levelled(seed, policy, engine)
    before, places = state(inc), estimates(inc)
    out = [v.id for v in (*inc.suspects, *inc.rejected)]
    assert len(out) >= 3 and not inc.decided
    came_back = 0
    for do, ids in [
        *((inc.accept, [i]) for i in out),
        *((inc.discard, [v.id]) for v in inc.suspects),
        *((inc.discard, [i]) for i in [*before["accepted"]][:12]),
        *((inc.discard, [i]) for i in ("h3", "g4") if i in before["accepted"]),
        (inc.accept, out),
    ]:
        arrival = do(ids)
        came_back += sum(v.cause.startswith("came back") for v in arrival.verdicts)
        assert inc.decided >= {*ids}
        inc.revoke(ids)
        same(inc, before, places)
    assert came_back or seed, "something has come back, and has left again"


@BOTH
@POLICIES
def test_decisions_are_taken_back_in_their_order(policy: Policy, engine: Engine) -> None:
    inc = levelled(0, policy, engine)
    ident = (*inc.suspects, *inc.rejected)[0].id
    states = []
    for do in (inc.accept, inc.discard, inc.accept, inc.discard):
        states.append((state(inc), estimates(inc)))
        do(ident)
        inc.settle()
    for before, places in reversed(states):
        inc.revoke([ident])
        same(inc, before, places)
    with pytest.raises(InputError, match="no decision by hand"):
        inc.revoke(ident)


@BOTH
@POLICIES
@pytest.mark.parametrize("settled", [False, True])
def test_what_came_back_leaves_with_its_own_decision(
    policy: Policy, engine: Engine, settled: bool
) -> None:
    """A later decision about the same observation brought nothing back, and takes nothing out."""
    inc = levelled(0, policy, engine)
    before, places = state(inc), estimates(inc)
    inc.discard("h3")
    discarded = state(inc)
    came_back = discarded["accepted"] - before["accepted"]
    assert came_back
    inc.accept("h3")
    if settled:
        inc.settle()
    inc.revoke("h3")
    assert state(inc)["accepted"] >= came_back and "h3" not in state(inc)["accepted"]
    inc.revoke("h3")
    same(inc, before, places)


@BOTH
@POLICIES
def test_readings_that_came_meanwhile_are_tested_again(policy: Policy, engine: Engine) -> None:
    """A gross error that was accepted keeps correct readings out, until it is taken back."""
    inc, undisturbed = levelled(0, policy, engine), levelled(0, policy, engine)
    wrong = (*inc.suspects, *inc.rejected)[0].id
    o = inc.observation(wrong)
    assert isinstance(o, HeightDifference)
    (a, b), own = (o.station, o.target), undisturbed
    correct = own.estimate(b)[2] - own.estimate(a)[2] if a in POINTS else None
    inc.accept(wrong)
    for k in range(3):
        if correct is None:
            pytest.skip("a held point")
        reading = HeightDifference(a, b, correct + 1e-4 * k, sigma=MM, id=f"n{k}")
        inc.add(reading)
        own.add(reading)
    inc.revoke(wrong)
    inc.settle()
    own.settle()
    assert state(inc) == state(own)


@BOTH
def test_a_decision_stays_while_one_about_what_it_brought_back_stands(engine: Engine) -> None:
    inc = levelled(0, "flag", engine)
    before, places = state(inc), estimates(inc)
    inc.discard("h3")
    (first, *_) = sorted(state(inc)["accepted"] - before["accepted"])
    inc.discard(first)
    both = state(inc)
    for ids in (["h3"], ["h3", first]):
        with pytest.raises(InputError, match=f"'{first}' came back with it"):
            inc.revoke(ids)
        assert state(inc) == both
    inc.revoke(first)
    inc.revoke("h3")
    same(inc, before, places)


@BOTH
def test_decisions_and_their_opposites_survive_a_restart(tmp_path: Path, engine: Engine) -> None:
    """The journal of one that is stopped after each step leads where one goes that is not."""
    journal = tmp_path / "day.jsonl"
    whole, inc = levelled(0, "flag", engine), levelled(0, "flag", engine, journal)
    before, places = state(inc), estimates(inc)
    ident = inc.suspects[0].id
    steps = [("accept", ident), ("discard", "h5"), ("discard", "g5"), ("discard", ident)]
    steps += [("revoke", ident), ("revoke", "g4"), ("revoke", "h5"), ("revoke", ident)]
    for do, of in steps:
        getattr(whole, do)(of)
        getattr(inc, do)(of)
        del inc
        inc = fga.IncrementalAdjustment.resume(journal)
        whole.settle()
        assert state(inc) == state(whole)
    same(inc, before, places)


def test_what_was_removed_or_changed_since_has_no_decision(tmp_path: Path) -> None:
    inc = levelled(0, "reject", "auto")
    ident = inc.rejected[0].id
    inc.accept(ident)
    inc.reweight(ident, 0.5)
    with pytest.raises(InputError, match="no decision by hand about it stands"):
        inc.revoke(ident)
    inc.discard(ident)
    inc.remove(ident)
    with pytest.raises(InputError, match=ident):
        inc.revoke(ident)


def test_what_waits_again_comes_back_with_what_was_discarded() -> None:
    """A point that one reading alone determines is lost with it, and determined again."""
    inc = levelled(0, "reject", "auto")
    inc.add(points=[fga.Point("far", (0.0, 0.0, np.nan), fixed=(True, True, False))])
    inc.add(HeightDifference("P2", "far", 1.0, sigma=MM, id="alone"))
    inc.settle()
    before, places = state(inc), estimates(inc)
    inc.discard("alone")
    assert not inc.determined("far")
    assert inc.revoke("alone").verdicts[0].verdict == "accepted"
    assert inc.determined("far")
    same(inc, before, places)


def test_image_points_keep_their_decisions_in_the_journal(tmp_path: Path) -> None:
    journal = tmp_path / "day.jsonl"
    inc = fga.IncrementalAdjustment(morning(), journal=journal)
    for step in day():
        step(inc)
    inc.settle(all=True)
    inside = [f"{o.photo}/{o.point}" for o in inc.network().image_points()]
    ray = inside[len(inside) // 2]
    before = state(inc)
    for do in ("discard", "accept", "discard"):
        getattr(inc, do)(ray)
    del inc
    inc = fga.IncrementalAdjustment.resume(journal)
    for _ in range(3):
        assert inc.decided == {ray}
        inc.revoke(ray)
    inc.settle()
    assert state(inc) == before
