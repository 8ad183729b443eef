"""The terrestrial side in dense fronts is what GTSAM eliminates by QR.

Large networks are eliminated so; here every network is, whatever its size.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import Direction, HeightDifference, PhotoPosition, SlopeDistance
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.elimination_layers import RULE
from tests.benchmarks.grids import simulate_grid, simulate_mixed
from tests.networks.adjusted import ADJUSTED
from tests.networks.small_block import small_block
from tests.support.elimination_rules import everything_by_qr, set_rule

LARGE = ("AICON", "Roma", "Ladybug, a cut")
"""Networks whose terrestrial side is empty or small; the others show more in less time."""
NAMES = [name for name in ADJUSTED if name not in LARGE]
TREE_OF_PHOTOS = {"images, free", "aerial block", "camcal, free", "held photos"}
"""Networks without a terrestrial side."""


@pytest.fixture
def by_cholesky(monkeypatch: pytest.MonkeyPatch) -> None:
    set_rule(monkeypatch, max_qr_variables=0)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("name", NAMES)
def test_every_network_has_the_same_adjustment(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Estimates to 1e-6 σ, covariances to 1e-6, redundancy numbers and their parts to 1e-8."""
    network = ADJUSTED[name]()
    with everything_by_qr():
        by_qr = fga.adjust(network)
        expected = fga.reliability(by_qr)
        covariances = by_qr.point_covariances
    set_rule(monkeypatch, max_qr_variables=0)
    solution = fga.adjust(network)
    assert solution.converged == by_qr.converged
    assert not solution.run.solver.qr_everywhere
    found = fga.reliability(solution)
    sigma = np.sqrt(np.einsum("pii->pi", covariances))
    moved = np.abs(solution.state["point"] - by_qr.state["point"])
    assert np.all(moved <= 1e-6 * sigma + 1e-11 * (1.0 + np.abs(by_qr.state["point"])))
    scale = np.maximum(sigma[:, :, None] * sigma[:, None, :], np.max(sigma) ** 2 * 1e-6)
    assert np.max(np.abs(solution.point_covariances - covariances) / scale, initial=0.0) < 1e-6
    for a, b in (
        (found.redundancy_numbers, expected.redundancy_numbers),
        (found.e1, expected.e1),
        (found.e2, expected.e2),
    ):
        np.testing.assert_allclose(a, b, atol=1e-8)


def test_some_of_these_networks_have_a_terrestrial_side(by_cholesky: None) -> None:
    """Otherwise the comparison would show nothing."""
    count = 0
    for name in ("gnss", "total station, free, verticals", "combined block", "own cameras"):
        solution = fga.adjust(ADJUSTED[name]())
        count += not solution.run.solver.layers.by_qr
    assert count == 4


@pytest.mark.parametrize("datum", ["given", "free"])
def test_a_grid_is_cut_into_small_fronts(datum: str, by_cholesky: None) -> None:
    network = simulate_grid(1, points=900).network
    if datum == "free":
        network.points = {n: fga.Point(p.name, p.coordinates) for n, p in network.points.items()}
        network.datum = "free"
    solution = fga.adjust(network)
    assert solution.converged
    fronts = solution.factor.fronts
    assert len(fronts.fronts) > 30 and max(f.size for f in fronts.fronts) < 90
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-7)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
def test_photos_over_a_grid_share_its_fronts(by_cholesky: None) -> None:
    """Terrestrial points tie photos that are far from one another."""
    network = simulate_mixed(1, points=200).network
    solution = fga.adjust(network)
    assert solution.converged and not solution.run.solver.layers.by_qr
    a = solution.normal().system.times(np.eye(solution.equations.unknowns.n_columns))
    free = solution.equations.unknowns.free
    q = np.linalg.inv(a[:, free].T @ a[:, free])
    hat = np.einsum("ij,jk,ik->i", a[:, free], q, a[:, free], optimize=True)
    found = fga.reliability(solution).redundancy_numbers
    np.testing.assert_allclose(found, 1.0 - hat, atol=1e-8)


def test_what_is_not_determined_is_named(by_cholesky: None) -> None:
    network = fga.Network("traverse")
    for name, at in (("A", (0.0, 0.0, 0.0)), ("B", (100.0, 0.0, 0.0)), ("C", (50.0, 80.0, 0.0))):
        network.add_point(name, at, fixed="xyz" if name != "C" else "z")
    network.add_point("D", (150.0, 80.0, 0.0), fixed="z")
    for target in "BC":
        network.add(Direction("A", target, 0.5, sigma=1e-5))
    network.add(SlopeDistance("A", "C", 94.0, sigma=0.001))
    network.add(SlopeDistance("C", "D", 100.0, sigma=0.001))
    with pytest.raises(fga.DatumError, match=r"point 'D' is not determined \(1 slope distance"):
        fga.adjust(network)
    levels = fga.Network("levels")
    for name in "AB":
        levels.add_point(name, (0.0, 0.0, 5.0), fixed="xy")
    levels.add(HeightDifference("A", "B", 0.0, sigma=0.001))
    with pytest.raises(fga.DatumError, match="missing shift in z"):
        fga.adjust(levels)


def test_photos_without_rays_and_cameras_without_photos_are_unknowns_too(by_cholesky: None) -> None:
    """A photo with a weighted pose and an observed position, a weighted camera that nobody uses."""
    network = small_block(4)
    network.add_camera("spare", BrownLens(), {"c": 30.0}, free=("c",), sigma={"c": 0.5})
    at = (5.0, 5.0, 9.0)
    network.add_photo(
        "G", "spare", position=at, rotation=np.eye(3), sigma_position=0.05, sigma_attitude=1e-3
    )
    network.add(PhotoPosition("G", (5.15, 5.0, 9.0), sigma=(0.05,) * 3))
    solution = fga.adjust(network)
    assert solution.converged and not solution.run.solver.layers.by_qr
    # Both say the same of x, with equal weights.
    np.testing.assert_allclose(solution.pose("G").position, [5.075, 5.0, 9.0], atol=1e-9)
    found = solution.variable_covariance(("pose", "G"))
    np.testing.assert_allclose(np.sqrt(np.diag(found)[3:]), 0.05 / np.sqrt(2.0), rtol=1e-9)
    assert solution.calibration("spare").sigmas[0] == pytest.approx(0.5)
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-8)


def stations(*, held: bool, sets: int) -> fga.Network:
    """Return twelve stations around points, with several sets of directions at each."""
    rng = np.random.default_rng(4)
    network = fga.Network("sets")
    points = rng.uniform(-20.0, 20.0, (15, 2))
    for i, (x, y) in enumerate(points.tolist()):
        network.add_point(f"P{i}", (x, y, 0.0), fixed="z")
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    for k, (x, y) in enumerate(60.0 * np.stack([np.cos(turn), np.sin(turn)], 1)):
        fixed = "xyz" if held or k < 3 else "z"
        network.add_point(f"S{k}", (float(x), float(y), 0.0), fixed=fixed)
        for number in range(sets):
            name = f"{number}"
            network.set_orientation(f"S{k}", set=name, value=0.3 * number)
            some = range(number % 3, 15, 3) if sets > 1 else range(15)
            for i in some:
                network.add(Direction(f"S{k}", f"P{i}", 0.0, sigma=1e-5, set=name))
    return measure(network, seed=2)


@pytest.mark.parametrize("sets", [1, 30])
@pytest.mark.parametrize("held", [True, False])
def test_many_sets_make_many_nodes_and_none_of_them_wide(
    held: bool, sets: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = stations(held=held, sets=sets)
    by_qr = fga.adjust(network)
    expected = fga.reliability(by_qr).redundancy_numbers
    set_rule(monkeypatch, max_qr_variables=0)
    solution = fga.adjust(network)
    nodes = solution.factor.nodes
    assert nodes.width <= RULE.max_point_node_columns and nodes.side == 0
    found = fga.reliability(solution).redundancy_numbers
    np.testing.assert_allclose(found, expected, atol=1e-9)
    for name in ("S0", "S5"):
        a, b = (s.orientation(name, "0").sigmas for s in (solution, by_qr))
        np.testing.assert_allclose(a, b, rtol=1e-8)
