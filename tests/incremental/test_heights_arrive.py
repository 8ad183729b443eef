"""Heights above surfaces, tilts, sights and azimuths of gyros arrive, and are removed."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from factorgraph_adj.simulation.measurement import measure
from tests.networks.aerial_heights import Aerial, plan_of, unknown_values

LONG = pytest.mark.slow(
    "heights in the air against the batch; short tests let single heights arrive"
)

PERCENT = 0.01
"""Share of a standard deviation within which an incremental adjustment is at the minimum."""
BLOCK = Aerial(
    strips=2,
    photos=3,
    statoscope=("height", "height_t"),
    lake=True,
    recorder=("height", "height_t"),
    tilts=("rx", "ry"),
    sights=("rx", "ry", "rz"),
)
LATE = ("statoscope 01", "statoscope 12", "shore", "recorder", "tilt 10", "sun 11", "gyro")


@cache
def whole() -> fga.Network:
    """Return the block, and azimuths of a gyrotheodolite between control points."""
    plan = plan_of(BLOCK).copy()
    plan.set_gyro("gyro", 0.02)
    names = list(plan.points)
    for i, (a, b) in enumerate(((0, 40), (40, 0), (7, 33), (20, 50))):
        a, b = (names[k % len(names)] for k in (a, b))
        plan.add(o.GyroAzimuth(a, b, 0.0, gyro="gyro", sigma=3e-5, id=f"gyro {i}"))
    return unknown_values(measure(plan, seed=4))


def begun() -> tuple[fga.Network, list[fga.Observation]]:
    """Return the network without what arrives late, and that."""
    network = whole().copy()
    later = [x for i, x in network.observations.items() if i.startswith(LATE)]
    late = {x.id for x in later[::2]} | {x.id for x in later if x.id.startswith("statoscope")}
    kept = {i: x for i, x in network.observations.items() if i not in late}
    network.observations = kept
    return network, [x for x in whole().observations.values() if x.id in late]


def assert_same(inc: fga.IncrementalAdjustment, s: fga.Solution) -> None:
    unknowns = (("level", "lake"), ("profile", "strip 0"), ("profile", "recorder"))
    for kind, name in (*unknowns, ("mount", "star tracker"), ("gyro", "gyro")):
        e = s.unknown(kind, name)
        off = np.abs(inc.solution().unknown(kind, name).values - e.values)
        assert (off <= PERCENT * e.sigmas + 1e-12).all(), name


@LONG
def test_what_arrives_ends_where_the_batch_adjustment_does(tmp_path) -> None:
    network, later = begun()
    assert {x.kind for x in later} >= {"profile_height", "level_height", "gyro_azimuth"}
    inc = fga.IncrementalAdjustment(network, journal=tmp_path / "day.jsonl")
    for x in later:
        inc.add(observation_from_record(json.loads(json.dumps(observation_record(x)))))
    assert_same(inc, fga.adjust(whole()))
    del inc
    assert_same(fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl"), fga.adjust(whole()))


@pytest.mark.parametrize("ident", ["statoscope 11", "tilt 01", "sun 12", "gyro 2"])
def test_what_is_removed_is_gone(ident: str) -> None:
    inc = fga.IncrementalAdjustment(whole().copy())
    inc.remove([ident])
    assert_same(inc, fga.adjust(fga.without(whole(), [ident])))


def test_a_gross_reading_of_a_statoscope_is_rejected_under_its_name() -> None:
    network, later = begun()
    inc = fga.IncrementalAdjustment(network, policy="reject")
    wrong = next(x for x in later if x.id == "statoscope 12")
    inc.add([x for x in later if x is not wrong])
    inc.add(replace(wrong, value=wrong.value + 8.0))
    assert [v.id for v in inc.rejected] == ["statoscope 12"]
