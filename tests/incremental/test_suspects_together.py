"""Suspects that agree name what they contradict, or the error that they share."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental import state_queries
from factorgraph_adj.observations import (
    ControlPoint,
    Direction,
    HeightDifference,
    Observation,
    SlopeDistance,
    ZenithAngle,
)

MM = 1e-3
ANGLE = 1e-5
TARGETS = {
    f"T{i}": np.array([60.0 * np.cos(i), 60.0 * np.sin(i), 5.0 * np.sin(2.3 * i)]) for i in range(8)
}


def levelled(a: str, b: str, value: float, ident: str) -> HeightDifference:
    """Return a height difference of a millimetre."""
    return HeightDifference(a, b, value, sigma=MM, id=ident)


def heights(*readings: HeightDifference) -> fga.IncrementalAdjustment:
    """Return two heights of which readings arrived one by one."""
    network = fga.Network("levelling")
    network.add_point("A", (0.0, 0.0, 100.0), fixed="xyz")
    for name in "BC":
        network.add_point(name, (100.0, 0.0, np.nan), fixed="xy")
    inc = fga.IncrementalAdjustment(network)
    inc.add(levelled("A", "C", 2.0, "elsewhere"))
    for o in readings:
        inc.add(o)
    return inc


def test_a_wrong_reading_that_came_first_is_named_by_those_that_agree_without_it() -> None:
    """From the second one on; what is wrong itself is not among them."""
    wrong, first = levelled("A", "B", 1.5, "wrong"), levelled("A", "B", 1.0, "first")
    assert not heights(wrong, first).doubts
    inc = heights(wrong, first, levelled("A", "B", 1.2, "bad"))
    assert not inc.doubts
    inc.add(levelled("C", "B", -1.0, "second"))
    (doubt,) = inc.doubts
    assert doubt.startswith("suspects 'first', 'second' fit without 'wrong', which is in: ")
    assert doubt in repr(inc)
    inc.remove("wrong")
    assert [v.id for v in inc.suspects] == ["bad"] and not inc.doubts


def test_a_reading_that_others_confirm_is_not_named() -> None:
    """Two wrong readings that agree against two right ones."""
    wrong = [levelled("A", "B", 1.5, f"wrong {i}") for i in range(2)]
    right = [levelled("A", "B", 1.0, f"right {i}") for i in range(2)]
    inc = heights(*right, *wrong)
    assert len(inc.suspects) == 2
    assert not any("without" in d for d in inc.doubts)


def test_it_is_looked_for_when_others_are_suspects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not with each arrival, and after each command that may take a reading out."""
    inc = heights(*(levelled("A", "B", 1.0 - 0.5 * i, f"{i}") for i in range(3)))
    looks: list[int] = []
    monkeypatch.setattr(state_queries.doubts, "suspects_doubts", lambda *_: looks.append(1) or ())
    for i in range(3):
        _ = inc.doubts
        inc.add(levelled("A", "C", 2.0, f"good {i}"))
    assert len(looks) == 1
    inc.add(levelled("A", "C", 3.0, "bad"))
    _ = inc.doubts, inc.doubts
    inc.reweight("good 1", 0.5)
    _ = inc.doubts
    assert len(looks) == 3


def station(height: float) -> fga.IncrementalAdjustment:
    """Return three set-ups, the last of which arrives reading by reading.

    Args:
        height: recorded height of the last instrument, which is 1.5 m.
    """
    rng = np.random.default_rng(2)
    places = {"S1": (0.0, 0.0, 0.0), "S2": (15.0, 8.0, 1.0), "S3": (-9.0, 12.0, 1.0)}
    network = fga.Network("three set-ups")
    for name, at in TARGETS.items():
        network.add_point(name, tuple(at), fixed="xyz" if name in ("T0", "T3", "T6") else "")
    for name, place in places.items():
        network.add_point(name, place)
    inc = fga.IncrementalAdjustment(network)
    for i in range(2):
        off = rng.normal(0.0, 2 * MM, 3)
        at = tuple(np.array(places["S3"]) + off)
        inc.add(ControlPoint("S3", at, sigma=(2 * MM,) * 3, id=f"position {i}"))
    for s, told in zip(places, (1.5, 1.5, height), strict=True):
        sights: list[Observation] = []
        for name, target in TARGETS.items():
            d = target - places[s] - [0.0, 0.0, 1.5]
            length = float(np.linalg.norm(d))
            horizontal = float(np.arctan2(d[0], d[1])) + rng.normal(0.0, ANGLE)
            zenith = float(np.arccos(d[2] / length)) + rng.normal(0.0, ANGLE)
            given = {"instrument_height": told, "target_height": 0.0}
            sights.append(Direction(s, name, horizontal % (2 * np.pi), sigma=ANGLE, set=s))
            sights.append(ZenithAngle(s, name, zenith, sigma=ANGLE, **given))
            length += rng.normal(0.0, MM)
            sights.append(SlopeDistance(s, name, length, sigma=MM, **given))
        for part in [sights] if s != "S3" else sights:
            inc.add(part)
    return inc


def test_a_wrong_height_of_an_instrument_is_named_by_the_causes() -> None:
    """As in batch, of accepted readings and suspects together."""
    inc = station(1.6)
    assert len(inc.suspects) > 9
    (doubt,) = inc.doubts
    assert "touch point 'S3'" in doubt and "causes() looks for an error" in doubt
    n = len(inc)
    found = inc.causes()
    assert found is not None and found.most_probable is not None
    first = found.most_probable
    assert (first.cause, first.where) == ("the height of the instrument", "at 'S3' (1.6 m)")
    assert abs(first.error[0] - 0.1) < 3.0 * first.sigma[0]
    assert len(inc) == n and len(inc.suspects) > 9, "nothing has changed"
    every = inc.network()
    for v in inc.suspects:
        every.add(inc.observation(v.id))
    batch = fga.snoop(every, alpha=inc.alpha).causes
    assert batch is not None and batch.most_probable is not None
    assert first.t2 == pytest.approx(batch.most_probable.t2, rel=1e-6)
    assert [c.cause for c in found.found] == [c.cause for c in batch.found]


def test_where_nothing_misfits_there_is_no_cause() -> None:
    inc = station(1.5)
    assert not inc.suspects and not inc.doubts
    found = inc.causes()
    assert found is None or found.most_probable is None


def test_causes_of_nothing_and_beside_what_was_retired_are_refused() -> None:
    empty = fga.IncrementalAdjustment(fga.Network("nothing"))
    with pytest.raises(fga.InputError, match="nothing is determined yet"):
        empty.causes()
    inc = heights(levelled("A", "B", 1.0, "first"), levelled("A", "B", 1.0, "second"))
    inc.retire(points="B")
    with pytest.raises(fga.InputError, match=r"settle\(all=True\) first"):
        inc.causes()
