"""Members of rigs and odometry arrive, leave, and stand in a journal."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from factorgraph_adj import IncrementalAdjustment, Network, Observation, Solution, adjust
from factorgraph_adj.graph.observation_selection import filtered
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from factorgraph_adj.simulation.measurement import measure
from tests.networks.odometry import odometry
from tests.networks.rigs import MOUNTS, rig

LONG = pytest.mark.slow(
    "an epoch of a whole rig against the batch; short tests let single photos arrive"
)

PERCENT = 0.01
"""Share of a standard deviation within which an incremental adjustment is at the minimum."""


def begun(network: Network, last: str) -> tuple[Network, list[Observation]]:
    """Return a rig without the epoch ``last``, and all its observations."""
    late = [i for i, o in network.observations.items() if any(last in f for f in o.photos())]
    later: list[Observation] = [network.observations[i] for i in late]
    rays = [o for o in network.image_points() if last in o.photo]
    out = network.copy()
    out.observations = {i: o for i, o in network.observations.items() if i not in late}
    photos = list(network.photos)
    out.image_mask(np.array([last not in photos[f] for f in network.images.columns()[0]]))
    return out, [*rays, *later]


def assert_same(inc: IncrementalAdjustment, whole: Solution, kind: str, names: list[str]) -> None:
    for name in names:
        e = whole.unknown(kind, name)
        off = np.abs(inc.solution().unknown(kind, name).values - e.values)
        assert (off <= PERCENT * e.sigmas + 1e-9).all(), (name, off / e.sigmas)


@LONG
def test_an_epoch_of_a_rig_arrives_and_ends_where_the_batch_adjustment_does(tmp_path: Path) -> None:
    network = measure(rig(5, held_points=30), seed=1)
    first, later = begun(network, "E4")
    inc = IncrementalAdjustment(first, journal=tmp_path / "day.jsonl")
    for o in later:
        inc.add(observation_from_record(json.loads(json.dumps(observation_record(o)))))
    assert not inc.rejected
    whole = adjust(network)
    assert_same(inc, whole, "mount", list(MOUNTS))
    assert_same(inc, whole, "pose", ["E0", "E4", "E4 back"])
    del inc
    again = IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert_same(again, whole, "mount", list(MOUNTS))


def test_the_observations_of_an_epoch_are_removed_again() -> None:
    network = measure(rig(5, held_points=30), seed=1)
    first, later = begun(network, "E4")
    inc = IncrementalAdjustment(network)
    inc.remove([o.id or f"{o.photo}/{o.point}" for o in later])  # type: ignore[attr-defined]
    rest = filtered(first, lambda kind, name: kind != "pose" or "E4" not in name)
    assert_same(inc, adjust(rest), "mount", list(MOUNTS))


def test_an_odometry_step_that_arrives_wrong_is_rejected_under_its_name() -> None:
    network = measure(odometry(joint=False), seed=2)
    late = network.observations["step 0 6"]
    network.observations = {i: o for i, o in network.observations.items() if i != "step 0 6"}
    inc = IncrementalAdjustment(network, policy="reject")
    x, y, z = late.value  # type: ignore[attr-defined]
    inc.add(replace(late, value=(x + 0.5, y, z)))  # type: ignore[call-arg]
    assert [v.id for v in inc.rejected] == ["step 0 6"]
