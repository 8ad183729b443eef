"""Gross errors of positions and attitudes are found, with the power that reliability predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import PhotoAttitude, PhotoPosition
from tests.networks.small_flight import EVERY, RATE, Plan, observed, plan_of

FLIGHT = Plan(mount=EVERY, drift=RATE, control=4)
REPETITIONS = 60


def shifted(network: fga.Network, ident: str, component: int, by: float) -> fga.Network:
    """Return the network with an error in one component of a reading."""
    out = network.copy()
    o = network.observations[ident]
    value = list(o.value)
    value[component] += by
    out.observations[ident] = replace(o, value=tuple(value))
    return out


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize(("ident", "component"), [("GNSS 1b", 2), ("INS 0c", 0)])
def test_the_smallest_detectable_error_is_found_in_80_per_cent(ident: str, component: int) -> None:
    plan = plan_of(FLIGHT)
    true = fga.adjust(observed(plan, 0))
    rel = fga.reliability(true)
    name = ("x", "y", "z") if ident.startswith("GNSS") else ("omega", "phi", "kappa")
    row = rel.row(ident, name[component])
    found = 0
    for seed in range(REPETITIONS):
        wrong = shifted(observed(plan, seed), ident, component, float(rel.mdb[row]))
        w = fga.reliability(fga.adjust(wrong, start=true)).w[row]
        found += abs(w) > rel.critical_w
    # Three standard deviations of a binomial distribution.
    off = 3 * np.sqrt(0.8 * 0.2 / REPETITIONS)
    assert abs(found / REPETITIONS - 0.8) < off


@pytest.mark.parametrize("seed", range(3))
def test_a_shift_of_one_position_is_snooped(seed: int) -> None:
    network = shifted(observed(plan_of(FLIGHT), seed), "GNSS 1b", 1, 0.9)
    first, *others = fga.snoop(network).rejected
    assert first.id == "GNSS 1b"
    assert len(others) < 2  # of 350 tests, one in three seeds has a false alarm
    assert isinstance(network.observations["GNSS 1b"], PhotoPosition)


def test_a_wrong_heading_is_snooped() -> None:
    network = shifted(observed(plan_of(FLIGHT), 4), "INS 0b", 2, np.radians(0.3))
    assert fga.snoop(network).rejected[0].id == "INS 0b"
    assert isinstance(network.observations["INS 0b"], PhotoAttitude)


def test_redundancy_and_shares_of_errors_add_up() -> None:
    """Mounts and drifts count as orientations."""
    rel = fga.reliability(fga.adjust(observed(plan_of(FLIGHT), 1)))
    assert rel.redundancy_numbers.sum() == pytest.approx(rel.solution.redundancy, abs=1e-6)
    total = rel.redundancy_numbers + rel.e1 + rel.e2 + rel.e12
    np.testing.assert_allclose(total, 1.0, rtol=0, atol=1e-8)


def test_variance_components_find_what_was_stated_too_small() -> None:
    plan = plan_of(replace(FLIGHT, exposures=6, strips=3, points=8))
    network = observed(plan, 2)
    for ident, o in network.observations.items():
        if isinstance(o, PhotoPosition):
            network.observations[ident] = replace(o, sigma=(0.02,) * 3)
    found = fga.estimate_variance_components(network)
    group = next(c for c in found.components if "position" in c.name)
    assert abs(group.factor - 2.5) < 2.5 * group.sigma
    assert group.factor > 1.5
