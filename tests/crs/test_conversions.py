"""What counts from axes of the grid is converted, one kind after the other, or refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.network.grid.observations import converted
from factorgraph_adj.observations import KINDS
from factorgraph_adj.observations.offsets import HydrostaticReading
from factorgraph_adj.observations.relations import CoordinateDifference, PointDirection
from factorgraph_adj.rotation import omega_phi_kappa
from tests.networks.every_kind import OBSERVED
from tests.networks.grid_site import NAMES, UNDULATION, Site
from tests.networks.grids import GRIDS

pytest.importorskip("pyproj", reason="the extra crs is not installed")

SYSTEM = fga.ReferenceSystem("EPSG:25832", geoid=UNDULATION)
TENTH_MM = 1e-4


@pytest.fixture(scope="module")
def site() -> Site:
    return Site(GRIDS["UTM 32"])


def in_grid(site: Site, *observations: fga.Observation) -> fga.Network:
    """Return points and photos at their true places in the grid, with observations."""
    network = fga.Network("one kind")
    network.add_camera("c", fga.models.lens.NoDistortion(), {"c": 100.0})
    at = site.to_grid(np.array(list(site.points.values())))
    for name, enh in zip(NAMES, at, strict=True):
        network.add_point(name, enh)
    for i, enh in enumerate(site.to_grid(site.centres)):
        network.add_photo(f"{i}", "c", position=enh, omega_phi_kappa=site.angles[i])
    network.add(*observations)
    return network


def residual(network: fga.Network) -> np.ndarray:
    """Return computed − observed of everything at the given coordinates."""
    from factorgraph_adj.graph.equations import compile_network

    equations = compile_network(network)
    return equations.residuals(equations.unknowns.start(), whitened=False)


def gamma(site: Site, name: str) -> float:
    """Return the convergence at a point, from the series."""
    k = site.partials(site.points[name])
    return float(np.arctan2(k[1, 0], k[0, 0]))


def test_attitudes_in_the_grid_are_those_of_the_photos(site: Site) -> None:
    sigma = (1e-5, 1e-5, 2e-5)
    o = fga.PhotoAttitude("2", tuple(site.angles[2]), sigma=sigma)
    made = fga.from_grid(in_grid(site, o), SYSTEM)
    np.testing.assert_allclose(residual(made), 0.0, atol=1e-9)
    # σ of angles follow by the partials: against draws of the angles.
    rng = np.random.default_rng(5)
    turn = made.photos["2"].rotation @ np.linalg.inv(fga.rotation.world_R_camera(*site.angles[2]))
    draws = site.angles[2] + rng.normal(0, 1, (4000, 3)) * sigma
    found = np.cov(
        np.array([omega_phi_kappa(turn @ fga.rotation.world_R_camera(*d)) for d in draws]).T
    )
    expected = made.observations["1"].covariance  # type: ignore[attr-defined]
    v = np.diag(expected)
    assert np.all(np.abs(found - expected) < 4 * np.sqrt((np.outer(v, v) + expected**2) / 4000))
    about_body = fga.PhotoAttitude("2", tuple(site.angles[2]), sigma=sigma, about="body")
    kept = fga.from_grid(in_grid(site, about_body), SYSTEM).observations["1"]
    np.testing.assert_allclose(kept.covariance, np.diag(np.square(sigma)))  # type: ignore[attr-defined]


def test_azimuths_count_from_grid_north_or_from_true_north(site: Site) -> None:
    """The bearing is that of the straight line in the grid: t − T is 2″ here."""
    d = site.points["R"] - site.points["A"]
    e, n, _ = site.enu(site.points["A"])
    azimuth = float(np.arctan2(d @ e, d @ n))
    true = fga.Azimuth("A", "R", azimuth, sigma=1e-5)
    a, b = site.to_grid(np.array([site.points["A"], site.points["R"]]))[:, :2]
    t = float(np.arctan2(*(b - a)))
    assert np.radians(1 / 3600) < abs(t - (azimuth - gamma(site, "A"))) < np.radians(5 / 3600)
    bearing = replace(true, value=t)
    geodetic = fga.GeodeticAzimuth("A", "R", azimuth, sigma=1e-5)
    for o, count in ((true, "true"), (bearing, "grid"), (geodetic, None)):
        made = fga.from_grid(in_grid(site, o), SYSTEM, azimuths=count)  # type: ignore[arg-type]
        np.testing.assert_allclose(residual(made), 0.0, atol=1e-9)
        assert made.observations["1"].kind == o.kind and not made.remarks
    with pytest.raises(InputError, match=r"azimuth A R: .*grid north or from true north"):
        fga.from_grid(in_grid(site, true), SYSTEM)


def test_a_bearing_at_a_station_with_deflections_is_geodetic(site: Site) -> None:
    a, b = site.to_grid(np.array([site.points["A"], site.points["B"]]))[:, :2]
    network = in_grid(site, fga.Azimuth("A", "B", float(np.arctan2(*(b - a))), sigma=1e-5))
    network.set_vertical("A", xi=5e-5, eta=5e-5)
    made = fga.from_grid(network, SYSTEM, azimuths="grid")
    assert made.observations["1"].kind == "geodetic_azimuth"
    assert made.observations["1"].sigma == 1e-5  # type: ignore[attr-defined]
    np.testing.assert_allclose(residual(made), 0.0, atol=1e-9)


def test_a_bearing_to_a_point_without_coordinates_is_turned_by_the_convergence(site: Site) -> None:
    network = in_grid(site)
    network.add_point("far")
    network.add(fga.Azimuth("A", "far", 1.0, sigma=1e-5))
    made = fga.from_grid(network, SYSTEM, azimuths="grid")
    found = made.observations["1"].value  # type: ignore[attr-defined]
    assert found == pytest.approx(1.0 + gamma(site, "A"), abs=1e-9)
    (remark,) = made.remarks
    assert "far has no approximate coordinates, so that t − T" in remark


@pytest.mark.parametrize("frame", ["topocentric", "geocentric"])
def test_gnss_vectors_are_geocentric_or_along_the_grid(site: Site, frame: str) -> None:
    d = site.points["Q"] - site.points["P"]
    c, s = np.cos(gamma(site, "P")), np.sin(gamma(site, "P"))
    grid_R_enu = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    covariance = np.diag([1.0, 4.0, 9.0]) * 1e-6
    turn = grid_R_enu @ site.enu(site.points["P"])
    geocentric = fga.GnssVector("P", "Q", tuple(d), covariance=covariance)
    along = fga.GnssVector("P", "Q", tuple(turn @ d), covariance=turn @ covariance @ turn.T)
    for o, axes in ((geocentric, "geocentric"), (along, "grid")):
        made = fga.from_grid(in_grid(site, o), SYSTEM, frame=frame, vectors=axes)  # type: ignore[arg-type]
        np.testing.assert_allclose(residual(made), 0.0, atol=TENTH_MM / 10)
        found = made.observations["1"].covariance  # type: ignore[attr-defined]
        rows = np.eye(3)
        if frame == "topocentric":
            rows = made.frame.axes_in_geocentric  # type: ignore[union-attr]
        np.testing.assert_allclose(rows.T @ found @ rows, covariance, rtol=0, atol=1e-12)
    with pytest.raises(InputError, match="vectors = 'geocentric' or 'grid'"):
        fga.from_grid(in_grid(site, geocentric), SYSTEM)


def test_a_cluster_of_vectors_keeps_its_covariance(site: Site) -> None:
    rng = np.random.default_rng(1)
    a = rng.normal(0, 1e-3, (6, 6))
    covariance = a @ a.T + 1e-6 * np.eye(6)
    members = tuple(
        fga.GnssVector("P", q, tuple(site.points[q] - site.points["P"]), sigma=(1.0, 1.0, 1.0))
        for q in "QR"
    )
    network = in_grid(site)
    network.add(fga.Correlated(members, covariance))
    made = fga.from_grid(network, SYSTEM, vectors="geocentric")
    ids, found = made.clusters[0]
    assert ids == ("1", "2")
    rows = np.kron(np.eye(2), made.frame.axes_in_geocentric)  # type: ignore[union-attr]
    np.testing.assert_allclose(found, rows @ covariance @ rows.T, rtol=0, atol=1e-15)


def test_control_observations_in_any_order_of_axes_keep_their_covariance(site: Site) -> None:
    at = site.to_grid(np.array([site.points["P"]]))[0]
    covariance = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 0.2], [0.5, 0.2, 16.0]]) * 1e-6
    k = site.partials(site.points["P"])
    expected = np.linalg.inv(k) @ covariance @ np.linalg.inv(k).T
    ordered = fga.GnssPosition("P", tuple(at), covariance=covariance)
    made = fga.from_grid(in_grid(site, ordered), SYSTEM)
    np.testing.assert_allclose(
        made.observations["1"].covariance,
        expected,
        rtol=1e-6,
        atol=1e-13,  # type: ignore[attr-defined]
    )
    p = [1, 2, 0]
    turned = fga.GnssPosition("P", tuple(at[p]), axes="yzx", covariance=covariance[np.ix_(p, p)])
    made = fga.from_grid(in_grid(site, turned), SYSTEM)
    o = made.observations["1"]
    assert isinstance(o, fga.GnssPosition)
    np.testing.assert_allclose(o.covariance, expected, rtol=1e-6, atol=1e-13)
    np.testing.assert_allclose(o.value, made.points["P"].coordinates, rtol=0, atol=1e-6)
    local = fga.ControlPoint("P", tuple(at), axes="enu", covariance=covariance)
    o = fga.from_grid(in_grid(site, local), SYSTEM).observations["1"]
    np.testing.assert_allclose(o.covariance, expected, rtol=1e-6, atol=1e-13)  # type: ignore[attr-defined]
    height = fga.ControlPoint("P", (at[2],), axes="z", sigma=(0.01,))
    o = fga.from_grid(in_grid(site, height), SYSTEM).observations["1"]
    assert isinstance(o, fga.ProfileHeight)
    assert o.value == pytest.approx(at[2] + UNDULATION, abs=1e-9)
    plan = fga.ControlPoint("P", tuple(at[:2] + 0.01), axes="xy", sigma=(0.01, 0.02))
    made = fga.from_grid(in_grid(site, plan), SYSTEM)
    assert made.observations["1"].axes == "en"  # type: ignore[attr-defined]
    shift = -np.linalg.inv(k)[:2, :2] @ [0.01, 0.01]
    np.testing.assert_allclose(residual(made), shift, rtol=0, atol=1e-6)


@pytest.mark.parametrize("where", ["ellipsoid", "sea_level", "grid"])
@pytest.mark.parametrize("height", [0.0, 4000.0])
def test_reduced_distances_become_arcs(site: Site, where: str, height: float) -> None:
    """Against geodesics, at the undulation, and the length in the grid, 26 km and 4 km up."""
    import pyproj

    at = np.array([site.points["A"], site.points["R"]])
    at[1] += 25e3 * site.enu(at[0])[1] + height * site.enu(at[0])[2]
    phi, lam, _ = site.ellipsoid.to_geodetic(at)
    geod = pyproj.Geod(ellps="GRS80")
    lon, lat = np.degrees(lam), np.degrees(phi)
    azimuth, _, s = geod.inv(lon[0], lat[0], lon[1], lat[1])
    if where == "sea_level":
        m, n = site.ellipsoid.radii(phi.mean(keepdims=True))
        alpha = np.radians(azimuth)
        s *= 1.0 + UNDULATION / float(
            m[0] * n[0] / (n[0] * np.cos(alpha) ** 2 + m[0] * np.sin(alpha) ** 2)
        )
    if where == "grid":
        s = float(np.linalg.norm(np.diff(site.to_grid(at)[:, :2], axis=0)))
    network = in_grid(site)
    for name, enh in zip(("a", "r"), site.to_grid(at), strict=True):
        network.add_point(name, enh)
    o = fga.HorizontalDistance("a", "r", s, sigma=0.001, id="reduced")
    network.add(o)
    made = fga.from_grid(network, SYSTEM, horizontal_distances=where)  # type: ignore[arg-type]
    np.testing.assert_allclose(residual(made), 0.0, atol=TENTH_MM)
    assert made.observations["reduced"].kind == "ellipsoid_distance"
    measured = fga.from_grid(network, SYSTEM)
    assert abs(residual(measured)[0]) > 0.1


def test_heights_of_water_and_readings_get_the_undulation(site: Site) -> None:
    h = float(site.to_grid(np.array([site.points["P"]]))[0, 2])
    network = in_grid(
        site,
        fga.ProfileHeight("P", h, sigma=0.1),
        fga.ProfileHeight(None, 2000.0, photo="1", sigma=0.1),
    )
    network.set_level("lake", h - 2.0, fixed=True)
    network.add(fga.LevelHeight("P", "lake", 2.0, sigma=0.01))
    network.add(HydrostaticReading("P", "lake", -2.0, sigma=0.01))
    made = fga.from_grid(network, SYSTEM)
    photo = float(site.to_grid(site.centres[1:2])[0, 2])
    v = residual(made)
    np.testing.assert_allclose(np.sort(v), [0.0, 0.0, 0.0, photo - 2000.0], rtol=0, atol=1e-6)


def test_directions_and_differences_along_axes_are_turned(site: Site) -> None:
    c, s = np.cos(gamma(site, "P")), np.sin(gamma(site, "P"))
    grid_R_enu = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    d = grid_R_enu @ site.enu(site.points["P"]) @ (site.points["Q"] - site.points["P"])
    ux, uy, uz = d
    made = fga.from_grid(
        in_grid(
            site,
            PointDirection("P", "Q", ux, uy, uz, sigma=1e-4),
            CoordinateDifference("P", "Q", tuple(d), sigma=0.01),
            CoordinateDifference("P", "Q", tuple(d[:2]), axes="xy", horizon=True, sigma=0.01),
            CoordinateDifference("P", "Q", (d[2],), axes="z", horizon=True, sigma=0.01),
        ),
        SYSTEM,
    )
    np.testing.assert_allclose(residual(made), 0.0, atol=1e-5)


def test_weighted_orientations_turn_with_north(site: Site) -> None:
    network = in_grid(site)
    network.add(fga.Direction("P", "Q", 0.3, sigma=1e-5))
    network.set_orientation("P", value=1.0, sigma=1e-4)
    made = fga.from_grid(network, SYSTEM)
    found = made.of_kind("orientation")["P", "1"]
    assert found.values[0] == pytest.approx(1.0 + gamma(site, "P"), abs=1e-9)


def test_photos_with_a_weighted_position_are_observed(site: Site) -> None:
    network = in_grid(site)
    at = network.photos["3"]
    network.photos["3"] = replace(at, sigma_position=(0.1, 0.2, 0.3))
    network.photos["4"] = replace(network.photos["4"], fixed=(True,) * 6)
    made = fga.from_grid(network, SYSTEM)
    o = made.observations["3 position"]
    assert isinstance(o, fga.PhotoPosition)
    assert made.photos["3"].sigma_position is None
    assert made.photos["4"].fixed == (True,) * 6
    local = made.frame.basis(np.array([o.value]), np.zeros((1, 2))).enu[0]
    partials = site.partials(site.centres[3])
    back = partials @ local @ o.covariance @ local.T @ partials.T
    np.testing.assert_allclose(back, np.diag([0.01, 0.04, 0.09]), rtol=0, atol=1e-7)


def _observed(*observations: fga.Observation) -> Callable[[fga.Network], object]:
    return lambda network: network.add(*observations)


REFUSED: dict[str, Callable[[fga.Network], object]] = {
    "easting and northing are known together": lambda n: n.add_point(
        "X", (7e5, 5.3e6, 1.0), fixed="x"
    ),
    "omega alone cannot be turned": _observed(fga.PhotoAngle("1", 0.1, angle="omega", sigma=1e-3)),
    "antenna vector counts from axes": _observed(
        fga.AntennaVector("1", (0.0, 0.0, 1.0), sigma=(1.0,) * 3, lever_arm=(0.0, 0.0, 1.0))
    ),
    "easting, northing and height together": _observed(
        fga.PhotoPosition("1", (7e5, 5.3e6), axes="xy", sigma=(1.0, 1.0))
    ),
    "along axes of the grid": lambda n: n.set_drift("d", values={"x": 0.1}, sigma={"x": 0.1}),
    "strip polynomial counts from axes": lambda n: n.set_polynomial("s"),
    "check coordinates without one component": lambda n: n.add_point(
        "X", (np.nan,) * 3, check=(7e5, 5.3e6, np.nan)
    ),
    "its position are held all together": lambda n: n.photos.update(
        {"1": replace(n.photos["1"], fixed=(False, False, False, True, False, False))}
    ),
    "needs approximate coordinates": lambda n: n.add_photo(
        "X", "c", omega_phi_kappa=(0.0, 0.0, 0.0)
    ),
    "give x, y and z, or with horizon": _observed(
        CoordinateDifference("P", "Q", (1.0,), axes="x", sigma=0.01)
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_converted_is_refused(site: Site, message: str) -> None:
    network = in_grid(site)
    REFUSED[message](network)
    with pytest.raises(InputError, match=message):
        fga.from_grid(network, SYSTEM)


def test_every_kind_that_counts_from_axes_is_converted_or_refused() -> None:
    """A kind that fixes coordinates, direction or attitude never passes unchanged by default."""
    default, refused = converted.dispatch(object), set()
    context: Any = None  # what refuses looks at no place
    for kind in KINDS.values():
        if kind.fixes != "nothing" and converted.dispatch(kind.observation) is default:
            refused.add(kind.name)
            for o in OBSERVED[kind.name]():
                with pytest.raises(InputError, match="and cannot be converted from a grid"):
                    default(o, context, context, 0)
    assert {"antenna_vector", "radial_offset", "strip_coordinate"} <= refused
    assert not {"azimuth", "gyro_azimuth", "control", "gnss_position", "photo_attitude"} & refused


def test_a_network_on_the_earth_is_no_network_in_a_grid(site: Site) -> None:
    made = fga.from_grid(in_grid(site), SYSTEM)
    with pytest.raises(InputError, match="in a frame on the Earth already"):
        fga.from_grid(made)
    with pytest.raises(InputError, match="has no reference system"):
        fga.from_grid(in_grid(site))
    with pytest.raises(InputError, match="unknown azimuths 'north'; valid: true, grid"):
        fga.from_grid(in_grid(site), SYSTEM, azimuths="north")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="has the ellipsoid WGS84"):
        fga.from_grid(in_grid(site), SYSTEM, frame=fga.GeocentricFrame("WGS84"))
    with pytest.raises(InputError, match="geoid_offset must be a positive"):
        fga.from_grid(in_grid(site), SYSTEM, geoid_offset=-1.0)
    with pytest.raises(InputError, match="σ of deflections"):
        fga.from_grid(in_grid(site), SYSTEM, deflections=0.0)
