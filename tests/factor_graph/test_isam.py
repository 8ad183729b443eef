"""A network in iSAM2: the figures of the batch, stable keys, and nothing changed by an error."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.made import KeyOf
from factorgraph_adj.network.entities import Photo, Point
from factorgraph_adj.network.selection import without
from factorgraph_adj.observations import SlopeDistance
from tests.networks.building_site import site
from tests.networks.simulated import simulate_industry_block
from tests.networks.small_block import small_block
from tests.support.arrivals import ids_of, items

PROMISE, AT_REST = 0.01, 1e-6


def site_network(seed: int = 3) -> fga.Network:
    described, readings, _ = site(seed)
    described.add(*readings)
    return described


def apart(isam: fga.Isam, solution: fga.Solution) -> tuple[float, float]:
    """Return the largest difference of coordinates and of covariances of points, relative to σ."""
    moved = scatter = 0.0
    state = isam.state
    table = solution.equations.unknowns["point"]
    for name, number in table.number.items():
        sigma = solution.standard_deviations(name)
        on = sigma > 0.0
        if table.offset[number] < 0 or not on.any():
            continue
        gap = state["point"][isam.keys.unknowns["point"].number[name]] - solution.point(name)
        moved = max(moved, float((np.abs(gap)[on] / sigma[on]).max()))
        both = isam.covariance("point", name) - solution.covariance(name)
        scaled = np.abs(both)[np.ix_(on, on)] / np.outer(sigma[on], sigma[on])
        scatter = max(scatter, float(scaled.max()))
    return moved, scatter


@pytest.mark.parametrize("make", [site_network, small_block])
def test_after_settling_it_is_the_batch(make) -> None:
    network = make()
    solution = fga.adjust(network, tolerance=1e-9)
    isam = fga.Isam(network)
    isam.settle()
    moved, scatter = apart(isam, solution)
    assert moved < AT_REST
    assert scatter < AT_REST


def test_a_free_network_has_its_inner_constraints() -> None:
    network = without(site_network(), [])
    network.datum = "free"
    solution = fga.adjust(network, tolerance=1e-9)
    isam = fga.Isam(network)
    isam.settle()
    assert isam.graph.error(isam.values) == pytest.approx(0.5 * solution.vtpv, rel=1e-6)


def test_tests_are_those_of_the_batch() -> None:
    network = site_network()
    isam = fga.Isam(network)
    isam.settle()
    rel = fga.reliability(fga.adjust(network, tolerance=1e-9))
    some = list(network.observations)[::7]
    found = isam.test(some)
    for i, name in enumerate(some):
        row = int(rel.solution.equations.find([name])[0][0])
        own = int(found.rows[i][0])
        if len(found.rows[i]) > 1:
            continue
        assert found.redundancy_numbers[own] == pytest.approx(rel.redundancy_numbers[row], abs=1e-6)
        if rel.controlled[row]:
            assert found.w[own] == pytest.approx(rel.w[row], abs=1e-4)
            assert found.t2[i] == pytest.approx(rel.w[row] ** 2, abs=1e-3)


def test_observations_arrive_with_new_points_and_keys_stay() -> None:
    network = site_network()
    solution = fga.adjust(network, tolerance=1e-9)
    late = "T9"
    own = [i for i, o in network.observations.items() if late in o.names()]
    begun = without(network, own, points=[late])
    isam = fga.Isam(begun)
    before = {
        n: isam.keys.key("point", n)
        for n in begun.points
        if n[0] == "T" and not any(begun.points[n].fixed)
    }
    isam.new_factors()
    point = replace(network.points[late], coordinates=None)
    arriving = [replace(network.observations[i], id=i) for i in own]
    names = isam.add(arriving, points=[point])
    assert set(names) >= set(own)
    assert {n: isam.keys.key("point", n) for n in before} == before
    graph, values = isam.new_factors()
    assert graph.size() == len(names)
    assert isam.keys.key("point", late) in list(values.keys())
    assert isam.new_factors()[0].size() == 0
    moved, _ = apart(isam, solution)
    assert moved < PROMISE
    isam.settle()
    assert apart(isam, solution)[0] < AT_REST


def test_a_photo_arrives_with_its_rays() -> None:
    network = small_block()
    solution = fga.adjust(network, tolerance=1e-9)
    late = list(network.photos)[-1]
    isam = fga.Isam(without(network, [], photos=[late]))
    rays = [o for o in items(network) if getattr(o, "photo", None) == late]
    photo: Photo = network.photos[late]
    isam.add(rays, photos=[photo])
    isam.settle()
    assert apart(isam, solution)[0] < AT_REST


def test_an_outlier_is_found_by_the_update_and_taken_out_again() -> None:
    network = site_network()
    isam = fga.Isam(network)
    isam.settle()
    before = isam.covariance("point", "T8")
    ident, o = next((i, o) for i, o in network.observations.items() if o.kind == "slope_distance")
    wrong = replace(o, value=o.value + 0.05, id="wrong")
    names = isam.add(wrong)
    assert isam.test(names).suspects == ("wrong",)
    verdict = fga.IncrementalAdjustment(network).add(wrong).verdicts[0]
    (w,) = isam.test(names).w
    assert w == pytest.approx(float(verdict.w[0]), rel=1e-3)
    isam.remove("wrong")
    isam.settle()
    np.testing.assert_allclose(isam.covariance("point", "T8"), before, rtol=1e-6)
    assert ident in isam.names


def test_native_factors_go_straight_in() -> None:
    network = simulate_industry_block(seed=2).network
    isam = fga.Isam(network)
    distance = np.linalg.norm(
        np.subtract(*(isam.state["point"][isam.keys.unknowns["point"].number[n]] for n in PAIR))
    )
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.001)

    def tape(key: KeyOf) -> gtsam.NonlinearFactor:
        return gtsam.RangeFactor3(*(key("point", n) for n in PAIR), float(distance) + 0.02, noise)

    assert isam.add(factors={"tape": tape}) == ("tape",)
    assert isam.test("tape").suspects == ("tape",)
    batch = fga.reliability(fga.adjust(network, extra_factors={"tape": tape})).factor("tape")
    assert isam.test("tape").w[0] == pytest.approx(float(batch.w[0]), rel=0.01)


PAIR = ("P35", "P36")


def test_what_it_has_goes_into_an_isam2_of_your_own() -> None:
    isam = fga.Isam(site_network())
    graph, values = isam.new_factors()
    own = gtsam.ISAM2()
    own.update(graph, values)
    key = isam.keys.key("point", "T8")
    there = own.calculateEstimate().atVector(key)
    assert np.linalg.norm(there - isam.values.atVector(key)) < 1e-3


def test_an_error_changes_nothing() -> None:
    isam = fga.Isam(site_network())
    names, here = isam.names, isam.values
    with pytest.raises(fga.InputError, match="nowhere"):
        isam.add(SlopeDistance("S0", "nowhere", 1.0, sigma=0.001))
    loose = [SlopeDistance("S0", "new", 12.0, sigma=0.001, id="d")]
    with pytest.raises(fga.AdjustmentError, match="not determined"):
        isam.add(loose, points=[Point("new", (1.0, 2.0, 3.0))])
    with pytest.raises(fga.InputError, match="is no factor here"):
        isam.remove("nothing")
    with pytest.raises(fga.AdjustmentError, match="not determined"):
        isam.remove([i for i in names if "T8" in i or i in ids_touching(isam, "T8")][1:])
    assert isam.names == names
    assert isam.values.equals(here, 0.0)
    assert "T8" in isam.network.points


def ids_touching(isam: fga.Isam, point: str) -> list[str]:
    return [
        i for o in items(isam.network) for i in ids_of(o) if point in getattr(o, "names", list)()
    ]
