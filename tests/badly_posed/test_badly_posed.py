"""A seeded part of the campaign: what has converged is a minimum, and as near as it says."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import GnssVector, HeightDifference, SlopeDistance, VerticalAngle
from factorgraph_adj.solve.solution import solution_at
from factorgraph_adj.stochastic_model import StandardDeviation

from .campaign import campaign, judged
from .draw import FAMILIES, badly_posed
from .exact import nearest

LONG = pytest.mark.slow(
    "a badly posed network with very many iterations; short tests take those that end soon"
)

N = 15 * len(FAMILIES)
"""Networks in the test."""


@pytest.mark.slow("many networks at the border of being determined; short tests take single ones")
def test_badly_posed_networks_end_where_they_say() -> None:
    found = list(campaign(0, N))
    assert [f"seed {c.seed}: {c.fault}" for c in found if c.fault] == []
    told = Counter((c.family, c.told) for c in found)
    for family in FAMILIES:
        assert told[family, "converged"] >= 5, told


@pytest.mark.parametrize("seed", [20, 46, 109, 496])
def test_a_prediction_and_few_digits_do_not_end_an_adjustment(seed: int) -> None:
    """Version 0.6 before it: 1e-5 σ was told; it was 3e-3, 1.7e-3, 2.6e-4 and 1.6e-4 of a σ."""
    case = judged(seed)
    assert (case.told, case.fault) == ("converged", "")


def creeping(seed: int) -> fga.Network:
    """Return points between two stations each, across whose line a weak σ holds them.

    The distances are too long, so that vᵀPv is flatter across the line than N says: Gauss-Newton
    steps leave a share of the way, of up to 0.995, that differs from point to point.
    """
    rng = np.random.default_rng(seed)
    rates = rng.uniform(0.3, 0.995, int(rng.integers(1, 14)))
    far, sigma = 10 ** rng.uniform(2.0, 6.8), 10 ** rng.uniform(-6.0, -4.0)
    weak = sigma * 10 ** rng.uniform(1.0, 3.0)
    network = fga.Network("creeping")
    for i, rate in enumerate(rates.tolist()):
        x, y = far + 10 * i, far + weak * rng.uniform(-10.0, 10.0)
        network.add_point(f"A{i}", (x - 1.0, far, 0.0), fixed="xyz")
        network.add_point(f"B{i}", (x + 1.0, far, 0.0), fixed="xyz")
        network.add_point(f"P{i}", (x, y, 0.0), fixed="z", sigma=(np.inf, weak, np.inf))
        longer = rate * sigma**2 / weak**2 / 2
        for station in "AB":
            network.add(SlopeDistance(f"{station}{i}", f"P{i}", 1.0 + longer, sigma=sigma))
    return network


@LONG
def test_where_steps_shrink_slowly_the_bound_is_that_of_the_way_left() -> None:
    """The last step was 1e-5 σ, and the minimum up to 1.5e-4 σ away, with and without digits."""
    found = []
    for seed in range(12):
        solution = fga.adjust(creeping(seed))
        if solution.converged:
            found.append(nearest(solution).unknown / solution.within)
    assert len(found) >= 10
    assert max(found) < 2.0


def test_the_reference_finds_what_is_moved_away() -> None:
    """A solution that is moved by a hundredth of its σ is a hundredth of its σ away."""
    solution = fga.adjust(badly_posed(12).network)
    assert nearest(solution).unknown < 1e-6
    unknowns = solution.equations.unknowns
    name = next(n for n, p in solution.network.points.items() if not all(p.fixed))
    number = unknowns["point"].number[name]
    state = dict(solution.state)
    state["point"] = state["point"].copy()
    sigma = solution.standard_deviations(name)[0]
    state["point"][number, 0] += 0.01 * sigma
    assert nearest(solution_at(solution, state)).unknown == pytest.approx(0.01, rel=1e-3)


# -- a place between two ---------------------------------------------------------------------------


def in_the_plane(height: float, *, second: bool = False) -> fga.Network:
    """Return points 12 m above four stations, given at a height with a weak σ."""
    network = fga.Network("plane")
    corners = [(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)]
    for i, (x, y) in enumerate(corners):
        network.add_point(f"S{i}", (x, y, 10.0), fixed="xyz")
    for name, (e, n) in {"P": (40.0, 55.0), **({"Q": (70.0, 30.0)} if second else {})}.items():
        network.add_point(name, (e, n, height), sigma=(np.inf, np.inf, 1000.0))
        for i, (x, y) in enumerate(corners):
            d = float(np.sqrt((x - e) ** 2 + (y - n) ** 2 + 12.0**2)) + 1e-4 * (-1) ** i
            network.add(SlopeDistance(f"S{i}", name, d, sigma=0.001))
    return network


def test_a_point_in_the_plane_of_its_stations_goes_to_its_place_and_tells_of_the_other() -> None:
    solution = fga.adjust(in_the_plane(10.0))
    beside = fga.adjust(in_the_plane(11.0))
    assert solution.converged and beside.converged
    assert abs(solution.point("P")[2] - 10.0) == pytest.approx(12.0, abs=0.01)
    assert solution.vtpv == pytest.approx(beside.vtpv, abs=1e-4)  # but for the weak weight
    other = 20.0 - solution.point("P")[2]
    assert (
        f"point 'P' fits equally well at 40.0000, 55.0000, {other:.4f}" in solution.second_places[0]
    )
    assert len(beside.second_places) == 1
    assert "DOUBTFUL RESULT: point 'P' fits equally well" in fga.text_report(solution)[:300]
    assert "fits equally well" in repr(solution)


def test_two_such_points_both_go() -> None:
    solution = fga.adjust(in_the_plane(10.0, second=True))
    for name in "PQ":
        assert abs(solution.point(name)[2] - 10.0) == pytest.approx(12.0, abs=0.01)
        assert any(f"point {name!r} fits equally" in told for told in solution.second_places)


def test_where_the_other_place_is_worse_it_is_not_told() -> None:
    """A levelled height of 100 mm tells them apart, and is much weaker than the distances."""
    network = in_the_plane(10.0)
    network.add(HeightDifference("S0", "P", 12.0, sigma=0.1))
    solution = fga.adjust(network)
    assert solution.point("P")[2] == pytest.approx(22.0, abs=0.02)
    assert not solution.second_places


def test_a_weak_height_alone_is_no_place_between_two() -> None:
    """A height with a weak weight that nothing else determines stays where it is."""
    network = in_the_plane(10.0)
    for ident in list(network.observations):
        network.observations.pop(ident)
    for i in range(4):
        x, y = network.points[f"S{i}"].coordinates[:2]
        d = float(np.hypot(x - 40.0, y - 55.0)) + 1e-4 * (-1) ** i
        network.add(fga.observations.HorizontalDistance(f"S{i}", "P", d, sigma=0.001))
    solution = fga.adjust(network)
    assert solution.converged and solution.point("P")[2] == 10.0
    assert not solution.second_places


def test_many_such_points_all_go_at_once() -> None:
    network = in_the_plane(10.0)
    rng = np.random.default_rng(4)
    for i in range(12):
        e, n = rng.uniform(20.0, 80.0, 2)
        up = rng.uniform(5.0, 30.0)
        network.add_point(f"M{i}", (e, n, 10.0), sigma=(np.inf, np.inf, 1000.0))
        for j in range(4):
            x, y = network.points[f"S{j}"].coordinates[:2]
            d = float(np.sqrt((x - e) ** 2 + (y - n) ** 2 + up**2))
            network.add(SlopeDistance(f"S{j}", f"M{i}", d, sigma=0.01))
    solution = fga.adjust(network)
    assert solution.converged and solution.vtpv < 1.0
    assert len(solution.second_places) == 13
    assert all(abs(solution.point(f"M{i}")[2] - 10.0) > 4.9 for i in range(12))


def test_the_other_side_has_iterations_of_its_own() -> None:
    """As many as are needed for one side leave none for the other."""
    needed = fga.adjust(in_the_plane(10.0)).iterations
    solution = fga.adjust(in_the_plane(10.0), max_iterations=needed)
    assert solution.converged and len(solution.second_places) == 1
    assert not fga.adjust(in_the_plane(10.0), max_iterations=needed - 2).converged


def test_a_second_place_is_told_where_weights_depend_on_lengths() -> None:
    network = in_the_plane(10.0)
    sigma = StandardDeviation(1.5, centring_target=30.0)
    network.add(VerticalAngle("S0", "P", 0.0, sigma=sigma))
    assert len(fga.adjust(network).second_places) == 1


def test_a_free_network_chooses_its_minimal_datum_anew() -> None:
    """σ are those from a start beside the plane; several minimal datums would hold the network."""

    def network(height: float) -> fga.Network:
        rng = np.random.default_rng(1)
        out = fga.Network("free", datum="free")
        corners = np.array([[0, 0, 10.0], [100, 0, 10], [100, 100, 10], [0, 100, 10]])
        for i, x in enumerate(corners):
            out.add_point(f"S{i}", x)
        out.add_point("P", (45.0, 55.0, height))
        for i in range(4):
            for j in range(i + 1, 4):
                d = corners[j] - corners[i] + 0.01 * np.array([1, 1, 0]) * rng.normal(size=3)
                out.add(GnssVector(f"S{i}", f"S{j}", tuple(d), sigma=(0.01,) * 3))
            length = float(np.linalg.norm((45.0, 55.0, 40.0) - corners[i]))
            out.add(SlopeDistance(f"S{i}", "P", length + 0.003 * rng.normal(), sigma=0.003))
        out.add(HeightDifference("S0", "P", 0.0, sigma=1000.0))
        return out

    between, beside = fga.adjust(network(10.0)), fga.adjust(network(38.0))
    assert between.converged and between.vtpv == pytest.approx(beside.vtpv)
    for name in ("S0", "S2", "P"):
        ours, theirs = (s.standard_deviations(name) for s in (between, beside))
        np.testing.assert_allclose(ours, theirs, rtol=1e-5)


@pytest.mark.parametrize("order", [1, -1])
def test_a_factor_counts_whatever_the_order_of_its_columns(order: int) -> None:
    """Three distances are observations, the fourth is a user's factor."""
    network = in_the_plane(10.0)
    _, last = network.observations.popitem()
    network.points["S3"] = replace(network.points["S3"], fixed=(False,) * 3, sigma=(1e-6,) * 3)
    keys = fga.build_graph(network).keys
    ends = [keys.key("point", name) for name in ("S3", "P")][::order]
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.001)
    factor = gtsam.RangeFactor3(*ends, last.value, noise)
    solution = fga.adjust(network, extra_factors=[factor])
    assert solution.converged
    assert abs(solution.point("P")[2] - 10.0) == pytest.approx(12.0, abs=0.01)
