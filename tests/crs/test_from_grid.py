"""A network in grid coordinates is the same network as in geocentric ones."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.statistical_tests import global_test
from tests.networks.grid_site import NAMES, UNDULATION, Site, geocentric, in_grid
from tests.networks.grids import GRIDS

LONG = pytest.mark.slow("every network in each grid; short tests convert points")

pytest.importorskip("pyproj", reason="the extra crs is not installed")

HUNDREDTH_MM = 1e-5


@LONG
@pytest.mark.parametrize("frame", ["topocentric", "geocentric"])
@pytest.mark.parametrize("grid", GRIDS)
def test_a_network_in_a_grid_is_the_same_as_in_geocentric_coordinates(
    grid: str, frame: str
) -> None:
    """Points, covariances, photos, vᵀPv: control, GNSS positions and photos come in E, N, H."""
    site = Site(GRIDS[grid])
    system = fga.ReferenceSystem(GRIDS[grid].code, geoid=UNDULATION)
    network = fga.from_grid(in_grid(site), system, frame=frame)  # type: ignore[arg-type]
    one, two = fga.adjust(network), fga.adjust(geocentric(site))
    assert one.converged
    assert one.redundancy == two.redundancy
    assert one.vtpv == pytest.approx(two.vtpv, rel=1e-6)
    to_geocentric = getattr(network.frame, "to_geocentric", lambda x: x)
    found = to_geocentric(np.array([one.point(n) for n in NAMES]))
    expected = np.array([two.point(n) for n in NAMES])
    np.testing.assert_allclose(found, expected, rtol=0, atol=HUNDREDTH_MM)
    coordinates = fga.grid_coordinates(one)
    np.testing.assert_allclose(
        coordinates.coordinates, site.to_grid(expected), rtol=0, atol=HUNDREDTH_MM
    )
    for i, name in enumerate(NAMES):
        k = site.partials(expected[i]) @ site.enu(expected[i])
        np.testing.assert_allclose(
            coordinates.covariances[i], k @ two.covariance(name) @ k.T, rtol=1e-5, atol=1e-12
        )
    for i in range(6):
        turned = network.frame.basis(one.pose(f"{i}").position[None], np.zeros((1, 2))).enu[0]
        there = site.frame.basis(two.pose(f"{i}").position[None], np.zeros((1, 2))).enu[0]
        np.testing.assert_allclose(
            turned @ one.pose(f"{i}").rotation, there @ two.pose(f"{i}").rotation, atol=1e-8
        )


def test_taking_the_grid_for_cartesian_is_wrong_by_decimetres() -> None:
    """What the conversion is for: UTM has 0.9996 here, and 3 km of the Earth are curved."""
    site = Site(GRIDS["UTM 32"])
    grid = in_grid(site)
    flat = fga.adjust(grid)
    system = fga.ReferenceSystem("EPSG:25832", geoid=UNDULATION)
    adjusted = fga.adjust(fga.from_grid(grid, system))
    right = fga.grid_coordinates(adjusted)
    away = np.array([flat.point(n) for n in NAMES]) - right.coordinates
    assert np.abs(away).max() > 0.1
    assert flat.sigma0 > 5.0
    assert global_test(adjusted).accepted


def test_covariances_in_the_grid_are_those_of_a_monte_carlo() -> None:
    """20 000 draws of a correlated position: entries agree within 4 of their standard errors."""
    site = Site(GRIDS["UTM 33 south"])
    system = fga.ReferenceSystem("EPSG:32733", geoid=UNDULATION)
    solution = fga.adjust(fga.from_grid(in_grid(site), system))
    rng = np.random.default_rng(1)
    n = 20_000
    row = list(solution.network.points).index("P")
    sigma = 1e4 * solution.covariance("P")  # metres and not millimetres
    sigma = sigma + 50.0 * np.outer([1.0, 0.4, -0.6], [1.0, 0.4, -0.6])
    draws = rng.multivariate_normal(solution.point("P"), sigma, n)
    sample = np.cov(system.from_frame(solution.network.frame, draws).T)
    j = fga.grid_coordinates(solution).places.jacobians[row]
    expected = j @ sigma @ j.T
    v = np.diag(expected)
    error = np.sqrt((np.outer(v, v) + expected**2) / n)
    assert np.all(np.abs(sample - expected) < 4.0 * error)
    turned = np.abs(
        j - solution.network.frame.basis(solution.point("P")[None], np.zeros((1, 2))).enu
    )
    assert turned.max() > 0.01  # it is not the identity
