"""Observed positions, attitudes, angles and ranges of photos arrive, leave, stand in journals."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from factorgraph_adj import IncrementalAdjustment, Network, Observation, Solution, adjust
from factorgraph_adj.io.json_records import observation_fields, observation_of
from factorgraph_adj.observations import NavigationAttitude, PhotoAttitude
from tests.networks.small_flight import EVERY, TILTED, Plan, observed, plan_of

PERCENT = 0.01
"""Share of a standard deviation within which an incremental adjustment is at the minimum."""
KINDS = ("photo_angle", "photo_range", "photo_base", "antenna_vector")
PLANS = {
    "in the frame": Plan(mount=EVERY, turning=("rz_t",), drift=("x_t",), extra=KINDS, points=4),
    "in horizons": Plan(
        TILTED, mount=EVERY, attitudes=NavigationAttitude, shutter=True, extra=KINDS, points=4
    ),
}


def begun(network: Network, photo: str) -> tuple[Network, list[Observation]]:
    """Return the network without what was observed in a photo beside images, and these."""
    later = [o for o in network.observations.values() if photo in o.photos()]
    here = network.copy()
    here.observations = {i: o for i, o in network.observations.items() if o not in later}
    return here, later


def assert_same(inc: IncrementalAdjustment, s: Solution) -> None:
    found = inc.solution()
    for kind in ("mount", "drift", "attitude_drift", "shutter"):
        for name in s.network.of_kind(kind):
            e = s.unknown(kind, name)
            off = np.abs(found.unknown(kind, name).values - e.values)
            assert (off <= PERCENT * e.sigmas + 1e-12).all()
    assert found.vtpv == pytest.approx(s.vtpv, rel=1e-4)


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("seed", [1, 2])
def test_observations_of_a_flight_arrive_in_any_order(plan: str, seed: int, tmp_path) -> None:
    whole = observed(plan_of(PLANS[plan]), 1)
    network, later = begun(whole, "1b")
    assert {o.kind for o in later} >= {*KINDS, "photo_position"}
    inc = IncrementalAdjustment(network, journal=tmp_path / "day.jsonl")
    for i in np.random.default_rng(seed).permutation(len(later)).tolist():
        line = json.loads(json.dumps(observation_fields(later[i], id=later[i].id)))
        inc.add(observation_of(line))
    batch = adjust(whole)
    assert_same(inc, batch)
    del inc
    assert_same(IncrementalAdjustment.resume(tmp_path / "day.jsonl"), batch)


def test_observations_of_a_flight_are_removed() -> None:
    whole = observed(plan_of(PLANS["in the frame"]), 1)
    network, later = begun(whole, "0c")
    inc = IncrementalAdjustment(whole)
    inc.remove([i for i, o in whole.observations.items() if "0c" in o.photos()])
    assert later
    assert_same(inc, adjust(network))


def test_a_gross_attitude_that_arrives_is_rejected_under_its_name() -> None:
    whole = observed(plan_of(PLANS["in the frame"]), 1)
    network, later = begun(whole, "1c")
    inc = IncrementalAdjustment(network, policy="reject")
    wrong = next(o for o in later if isinstance(o, PhotoAttitude))
    omega, phi, kappa = wrong.value
    inc.add([o for o in later if o is not wrong])
    inc.add(replace(wrong, value=(omega, phi, kappa + 0.01), id="wrong"))
    assert [v.id for v in inc.rejected] == ["wrong"]
