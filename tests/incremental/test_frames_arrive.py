"""Coordinates in frames arrive, and stand in a journal."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from factorgraph_adj import IncrementalAdjustment, Network, Observation, Solution, adjust
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from tests.networks.three_frames import three_frames

PERCENT = 0.01
"""Share of a standard deviation within which an incremental adjustment is at the minimum."""


def begun() -> tuple[Network, list[Observation]]:
    """Return the network without the last three points, and their observations."""
    network = three_frames()
    later = [o for o in network.observations.values() if o.point in ("P5", "P6", "P7")]
    network.observations = {
        i: o for i, o in network.observations.items() if o.point not in ("P5", "P6", "P7")
    }
    return network, later


def assert_same(inc: IncrementalAdjustment, s: Solution) -> None:
    for frame in ("scan", "model", "station"):
        e = s.unknown("frame", frame)
        off = np.abs(inc.solution().unknown("frame", frame).values - e.values)
        assert (off <= PERCENT * e.sigmas + 1e-12).all()


def test_frame_coordinates_arrive_and_end_where_the_batch_adjustment_does(tmp_path) -> None:
    network, later = begun()
    inc = IncrementalAdjustment(network, journal=tmp_path / "day.jsonl")
    for o in later:
        line = json.loads(json.dumps(observation_record(o)))
        inc.add(observation_from_record(line))
    assert_same(inc, adjust(three_frames()))
    inc.settle()
    before = inc.solution().unknown("frame", "model").values
    del inc
    again = IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert_same(again, adjust(three_frames()))
    again.settle()
    assert np.allclose(again.solution().unknown("frame", "model").values, before, rtol=0, atol=1e-7)


def test_a_gross_frame_coordinate_that_arrives_is_rejected_under_its_name() -> None:
    network, later = begun()
    inc = IncrementalAdjustment(network, policy="reject")
    first, *rest = later
    inc.add(rest)
    x, y, z = first.value
    inc.add(replace(first, value=(x + 0.1, y, z), id="wrong"))
    assert [v.id for v in inc.rejected] == ["wrong"]


def test_a_point_enters_with_one_coordinate_in_a_known_frame() -> None:
    """Nothing else says where it is, and nothing else need: the frame is known."""
    network, later = begun()
    inc = IncrementalAdjustment(network)
    first = next(o for o in later if o.frame == "scan")
    inc.add(first)
    assert not inc.waiting
    assert inc.solution().standard_deviations(str(first.point)).max() < 0.01
