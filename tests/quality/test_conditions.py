"""Shapes and relations in tests: gross errors are found, with the power that is predicted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.simulation.measurement import measure
from tests.networks import on_shapes
from tests.networks.on_shapes import MM
from tests.support.scatter import RELATIONS


def spoiled(network: fga.Network, ident: str, error: float) -> fga.Network:
    """Return a network with an error in the first component of an observation."""
    out = network.copy()
    found = out.observations[ident]
    value = found.value
    wrong = (value[0] + error, *value[1:]) if isinstance(value, tuple) else value + error
    out.observations[ident] = replace(found, value=wrong)
    return out


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("shape", SHAPES)
def test_a_point_off_its_shape_is_found(shape):
    network = measure(on_shapes.plan(shape), seed=4)
    network = on_shapes.without_shapes(spoiled(network, "on 5", 20 * MM))
    found = fga.snoop(network)
    assert [r.id for r in found.rejected] == ["on 5"]
    size = abs(found.rejected[0].final_error)
    assert size == pytest.approx(20 * MM, abs=5 * found.rejected[0].final_sigma)


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
def test_a_point_off_the_plane_is_found_with_the_power_that_is_predicted():
    """An error of the smallest detectable size is found in 80 of 100 cases, as it says."""
    plan = on_shapes.plan("plane")
    first = fga.adjust(measure(plan, seed=0, noise=False))
    rel = fga.reliability(first, alpha=0.001, power=0.8)
    row = next(i for i in range(first.n_observations) if first.equations.id(i) == "on 5")
    error = float(rel.mdb[row])
    n = 120
    hits = 0
    for seed in range(n):
        network = spoiled(measure(plan, seed=seed), "on 5", error)
        solution = fga.adjust(network, start=first)
        hits += abs(fga.reliability(solution, alpha=0.001).w[row]) > rel.critical_w
    low, high = stats.binom(n, 0.8).ppf([0.0005, 0.9995])
    assert low <= hits <= high


ALIKE = 0.01
"""Difference of test values that linearisation leaves."""


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("kind", RELATIONS)
def test_a_relation_that_does_not_hold_is_found(kind):
    network = measure(on_shapes.room(), seed=2)
    ident = next(i for i, x in network.observations.items() if x.kind == kind)
    solution = fga.adjust(network)
    rel = fga.reliability(solution)
    rows = [i for i in range(solution.n_observations) if solution.equations.id(i) == ident]
    bad = spoiled(network, ident, 4.0 * float(rel.mdb[rows[0]]))
    found = fga.snoop(bad)
    # Of equal distances nothing but the position of a corner controls one: both tests are the same.
    w = np.abs(fga.reliability(fga.adjust(bad)).w)
    same = {
        solution.equations.id(int(i)) for i in np.flatnonzero(np.abs(w - w[rows].max()) < ALIKE)
    }
    assert len(found.rejected) == 1
    assert found.rejected[0].id in same


def test_a_measured_point_beside_an_edge_is_found():
    network = measure(fga.adjust(on_shapes.edges()).as_network(), seed=3)
    ident = [i for i, x in network.observations.items() if x.kind == "image_line"][8]
    found = fga.snoop(spoiled(network, ident, 0.1))
    assert [r.id for r in found.rejected] == [ident]


def test_a_condition_is_never_set_aside():
    """Of a condition that does not hold the readings are left, and it is told that it stays."""
    network = measure(on_shapes.plan("plane"), seed=4)
    wrong = spoiled(network, "on 5", 20 * MM)
    wrong.observations["on 5"] = replace(wrong.observations["on 5"], condition=True)
    found = fga.snoop(wrong)
    assert "on 5" not in [r.id for r in found.rejected]
    told = [u for u in found.unresolved if u.id == "on 5"]
    assert not told or "condition" in told[0].reason
    alone = on_shapes.plan("plane")
    for ident, x in alone.observations.items():
        if isinstance(x, o.OnPlane):
            alone.observations[ident] = replace(x, condition=True)
    alone = measure(alone, seed=4)
    alone = spoiled(alone, "on 5", 20 * MM)
    found = fga.snoop(alone, max_rounds=1)
    assert not {r.id for r in found.rejected} & {f"on {i}" for i in range(14)}


def test_a_condition_stays_beside_arriving_readings_that_it_contradicts():
    network = measure(on_shapes.plan("plane"), seed=4)
    late = spoiled(network, "on 5", 50 * MM).observations["on 5"]
    del network.observations["on 5"]
    inc = fga.IncrementalAdjustment(network.copy(), policy="reject")
    inc.add(late)
    assert [v.id for v in inc.rejected] == ["on 5"]
    inc = fga.IncrementalAdjustment(network.copy(), policy="reject")
    inc.add(replace(late, condition=True))
    assert not [v for v in inc.rejected if v.id == "on 5"]


@pytest.mark.parametrize("shape", SHAPES)
def test_redundancy_numbers_of_shapes_add_to_the_redundancy(shape):
    """Frames and sizes count as orientations in e1, e2 and e12."""
    solution = fga.adjust(on_shapes.plan(shape))
    rel = fga.reliability(solution)
    r = rel.redundancy_numbers
    assert r.sum() == pytest.approx(solution.redundancy, abs=1e-6)
    np.testing.assert_allclose(r + rel.e1 + rel.e2 + rel.e12, 1.0, atol=1e-6)


def test_variance_components_of_form_and_coordinates_are_found():
    plan = on_shapes.plan("cylinder", n=60)
    for ident, x in plan.observations.items():
        if isinstance(x, o.OnCylinder):
            plan.observations[ident] = replace(x, sigma=3 * MM)
    network = measure(plan, seed=1)
    for ident, x in network.observations.items():
        if isinstance(x, o.OnCylinder):
            network.observations[ident] = replace(x, sigma=MM)
    found = fga.estimate_variance_components(network)
    by_group = {c.name: c.factor for c in found.components}
    form = next(f for name, f in by_group.items() if "on_cylinder" in name)
    assert form == pytest.approx(3.0, rel=0.35)
