"""Blunders of sights in frames, and variance components of each instrument."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.simulation.measurement import measure
from tests.networks.instruments import room_of

SEEDS = 60
"""Repetitions of the trial of the power."""


def scans(seed: int, **options: object) -> fga.Network:
    return room_of(seed, ["scanner", "scanner", "tracker"], points=12, held=3, **options)


def test_a_target_confused_in_one_scan_is_found() -> None:
    """P7 was sighted and written down as P8: its direction, zenith angle and distance are wrong."""
    network = scans(11)
    kinds = ("frame_direction", "frame_zenith", "frame_distance")
    sights = {
        (o.kind, o.point): i for i, o in network.observations.items() if o.frame == "scanner 0"
    }
    wrong = []
    for kind in kinds:
        there, here = sights[kind, "P7"], sights[kind, "P8"]
        value = network.observations[there].value
        network.observations[here] = replace(network.observations[here], value=value)
        wrong.append(here)
    found = fga.snoop(network)
    assert {r.id for r in found.rejected} == set(wrong)
    right = fga.adjust(scans(11))
    moved = np.abs(found.solution.point("P8") - right.point("P8"))
    assert np.all(moved < 4 * right.standard_deviations("P8"))


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("kind", ["frame_direction", "frame_zenith", "frame_distance"])
def test_smallest_detectable_errors_are_detected_as_often_as_predicted(kind: str) -> None:
    """The test of the wrong reading exceeds its limit with the probability of the mdb, 80 %."""
    plan = fga.adjust(scans(12)).as_network()
    solution = fga.adjust(measure(plan, seed=0, noise=False))
    rel = fga.reliability(solution)
    ids = [i for i, o in plan.observations.items() if o.kind == kind]
    ident = ids[len(ids) // 2]
    (row,) = solution.equations.find([ident])[0].tolist()
    error = float(rel.mdb[row])
    found = 0
    for seed in range(SEEDS):
        noisy = measure(plan, seed=seed)
        o = noisy.observations[ident]
        noisy.observations[ident] = replace(o, value=o.value + error)
        again = fga.reliability(fga.adjust(noisy, start=solution))
        found += bool(abs(again.w[row]) > rel.critical_w)
    low, high = stats.binom.interval(0.999, SEEDS, rel.power)
    assert low <= found <= high


def test_every_instrument_gets_its_variance_components() -> None:
    """The tracker's directions are three times as good as stated, a scanner's distances half."""
    factors = {("tracker 5", "frame_direction"): 1 / 3, ("scanner 0", "frame_distance"): 2.0}
    plan = fga.adjust(room_of(13, ["scanner"] * 5 + ["tracker"], points=60, held=8)).as_network()
    true = plan.copy()
    for ident, o in plan.observations.items():
        factor = factors.get((o.frame, o.kind), 1.0)
        true.observations[ident] = replace(o, sigma=factor * o.sigma)
    noisy = measure(true, seed=5)
    for ident, o in noisy.observations.items():
        noisy.observations[ident] = replace(o, sigma=plan.observations[ident].sigma)
    found = fga.estimate_variance_components(noisy, groups="frame")
    assert len(found.components) == 18
    for component in found.components:
        kind, frame = component.name.split(" in ")
        factor = factors.get((frame, kind), 1.0)
        share = component.sigma / component.factor  # relative, as that of the true factor is
        assert abs(component.factor / factor - 1.0) < 3.5 * share, component.name
        assert share < 0.25, component.name
