"""Sights in frames arrive one after the other, leave again, and stand in a journal."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from tests.networks.instruments import room_of

PERCENT = 0.01
"""Share of a standard deviation within which an incremental adjustment is at the minimum."""


def network() -> fga.Network:
    instruments = ["scanner", "levelled theodolite", "on a tripod"]
    return room_of(31, instruments, points=8, held=4, constants=True, coarse=0.05)


def assert_same(inc: fga.IncrementalAdjustment, s: fga.Solution) -> None:
    for frame in s.network.frames:
        e = s.unknown("frame", frame)
        off = np.abs(inc.solution().unknown("frame", frame).values - e.values)
        assert (off <= PERCENT * e.sigmas + 1e-12).all()


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
@pytest.mark.parametrize("seed", range(3))
def test_sights_arrive_in_any_order_and_end_where_the_batch_adjustment_does(seed, tmp_path) -> None:
    whole = network()
    batch = fga.adjust(whole)
    begin = whole.copy()
    later = [i for i, o in whole.observations.items() if getattr(o, "point", "") in ("P6", "P7")]
    begin.observations = {i: o for i, o in whole.observations.items() if i not in later}
    inc = fga.IncrementalAdjustment(begin, journal=tmp_path / "day.jsonl")
    order = np.random.default_rng(seed).permutation(len(later))
    for i in order.tolist():
        o = replace(whole.observations[later[i]], id=f"late {later[i]}")
        inc.add(observation_from_record(json.loads(json.dumps(observation_record(o)))))
    assert_same(inc, batch)
    first = f"late {later[0]}"
    inc.remove([first])
    short = whole.copy()
    del short.observations[later[0]]
    assert_same(inc, fga.adjust(short))
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert_same(again, fga.adjust(short))


def test_a_gross_sight_that_arrives_is_rejected_under_its_name() -> None:
    whole = network()
    ident, last = next(
        (i, o) for i, o in reversed(whole.observations.items()) if o.kind == "frame_distance"
    )
    del whole.observations[ident]
    inc = fga.IncrementalAdjustment(whole, policy="reject")
    inc.add(replace(last, value=last.value + 0.05, id="wrong"))
    assert [v.id for v in inc.rejected] == ["wrong"]
