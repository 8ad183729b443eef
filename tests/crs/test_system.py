"""Grid coordinates to frames and back, against formulas of their own and published figures."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.crs.grid_places import grid_places, wgs84_places
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import LocalFrame
from tests.loaders import lambert_93
from tests.networks.grids import GRIDS
from tests.support.places import data_dir

pytest.importorskip("pyproj", reason="the extra crs is not installed")

HUNDREDTH_MM = 1e-5
PRINTED = 0.5e-4
"""Half of the last printed digit of a listing, metres."""


@pytest.mark.parametrize("grid", GRIDS)
def test_transverse_mercator_grids_agree_with_the_series_of_redfearn(grid: str) -> None:
    tm = GRIDS[grid]
    name, (latitude, longitude) = tm.ellipsoid, tm.place
    system = fga.ReferenceSystem(tm.code, heights="ellipsoidal")
    phi = np.radians(latitude + np.array([0.0, 0.02, -0.03]))
    lam = np.radians(longitude + np.array([0.0, 0.05, 0.04]))
    h = np.array([100.0, 850.0, -20.0])
    expected = tm.to_grid(phi, lam)
    frame = system.frame_at(np.column_stack([expected, h]))
    assert frame.ellipsoid_name == name
    xyz = frame.from_geocentric(ellipsoid(name).to_cartesian(phi, lam, h))
    np.testing.assert_allclose(
        system.to_frame(frame, np.column_stack([expected, h])), xyz, rtol=0, atol=HUNDREDTH_MM
    )
    back = system.from_frame(frame, xyz)
    np.testing.assert_allclose(back[:, :2], expected, rtol=0, atol=HUNDREDTH_MM)
    np.testing.assert_allclose(back[:, 2], h, rtol=0, atol=HUNDREDTH_MM)


def test_lambert_93_agrees_with_the_formulas_of_ign() -> None:
    system = fga.ReferenceSystem("EPSG:2154", heights="ellipsoidal")
    grid = np.array([[657723.0, 6860710.0, 120.0], [1050000.0, 6250000.0, 2900.0]])
    phi, lam = lambert_93.from_grid(grid[:, 0], grid[:, 1])
    frame = system.geocentric_frame()
    xyz = ellipsoid("GRS80").to_cartesian(phi, lam, grid[:, 2])
    np.testing.assert_allclose(system.to_frame(frame, grid), xyz, rtol=0, atol=HUNDREDTH_MM)
    places = grid_places(system, frame, xyz)
    gamma = lambert_93.EXPONENT * (lam - lambert_93.CENTRAL_MERIDIAN)
    np.testing.assert_allclose(places.convergence, gamma, rtol=0, atol=1e-9)
    np.testing.assert_allclose(places.scale, lambert_93.scale(phi), rtol=0, atol=1e-9)


def test_convergence_and_scale_are_those_of_proj() -> None:
    import pyproj

    system = fga.ReferenceSystem("EPSG:32733", heights="ellipsoidal")
    grid = np.array([[300000.0, 6200000.0, 1500.0], [710000.0, 6300000.0, 0.0]])
    frame = system.geocentric_frame()
    places = grid_places(system, frame, system.to_frame(frame, grid))
    phi, lam, h = system.to_geodetic(grid)
    found = pyproj.Proj("EPSG:32733").get_factors(np.degrees(lam), np.degrees(phi))
    np.testing.assert_allclose(
        np.degrees(places.convergence), found.meridian_convergence, atol=1e-8
    )
    np.testing.assert_allclose(places.scale, found.meridional_scale, rtol=0, atol=1e-9)
    m, n = ellipsoid("WGS84").radii(phi)
    lower = places.scale * np.sqrt(m * n / ((m + h) * (n + h)))
    np.testing.assert_allclose(places.combined, lower, rtol=0, atol=1e-9)


def test_seven_parameters_lead_to_the_datum_of_the_frame() -> None:
    """Two ways: parameters of one's own, and +towgs84; heights are above the geoid of the frame."""
    seven = (598.1, 73.7, 418.2, 0.202, 0.045, -2.455, 6.7)
    grid = np.array([[3520000.0, 5500000.0, 300.0], [3521000.0, 5503000.0, 410.0]])
    system = fga.ReferenceSystem(
        "EPSG:31467", geoid=46.9, datum="EPSG:4258", parameters=fga.SevenParameters(*seven)
    )
    bound = fga.ReferenceSystem(
        "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=3500000 +ellps=bessel +type=crs +towgs84="
        + ",".join(map(str, seven)),
        geoid=46.9,
        datum="EPSG:4258",
    )
    phi, lam, h = system.to_geodetic(grid)
    assert system.ellipsoid.name == "GRS80"
    np.testing.assert_allclose(h, grid[:, 2] + 46.9, rtol=0, atol=1e-9)
    np.testing.assert_allclose(bound.to_geodetic(grid), (phi, lam, h), rtol=0, atol=1e-9)
    # By hand: the height above Bessel's ellipsoid follows from the one above GRS80.
    there = ellipsoid("GRS80").to_cartesian(phi, lam, h)
    turn = np.radians(np.array(seven[3:6]) / 3600.0)
    x, y, z = turn
    matrix = (1 + seven[6] * 1e-6) * np.array([[1, -z, y], [z, 1, -x], [-y, x, 1]])
    bessel = np.linalg.solve(matrix, (there - seven[:3]).T).T
    phi0, lam0, _ = ellipsoid("Bessel1841").to_geodetic(bessel)
    expected = GRIDS["Gauss-Krüger 3"].to_grid(phi0, lam0)
    np.testing.assert_allclose(grid[:, :2], expected, rtol=0, atol=HUNDREDTH_MM)
    np.testing.assert_allclose(system.from_geodetic(phi, lam, h), grid, rtol=0, atol=HUNDREDTH_MM)


@pytest.mark.parametrize("code", ["EPSG:31256", "EPSG:2056", "EPSG:5514"])
def test_a_datum_by_a_rotation_of_proj_is_inverted_exactly(code: str) -> None:
    """PROJ inverts small rotations by the transpose, which is wrong by tenths of a millimetre."""
    at = {"EPSG:31256": (1e4, 3e5), "EPSG:2056": (2683e3, 1248e3), "EPSG:5514": (-6e5, -1.16e6)}
    system = fga.ReferenceSystem(code, geoid=45.0, datum="EPSG:4258")
    grid = np.array([[*at[code], 300.0]])
    back = system.from_geodetic(*system.to_geodetic(grid))
    np.testing.assert_allclose(back, grid, rtol=0, atol=HUNDREDTH_MM)


# -- what is refused ------------------------------------------------------------------------------


def test_a_missing_geoid_is_an_error_that_names_the_grid_and_never_an_ellipsoidal_height() -> None:
    with pytest.raises(InputError, match=r"de_bkg_gcg2016\.tif \(https://cdn\.proj\.org/de_bkg"):
        fga.ReferenceSystem("EPSG:25832+7837").to_geodetic(np.array([[5e5, 5.4e6, 300.0]]))


@pytest.mark.parametrize(
    ("code", "options", "message"),
    [
        ("EPSG:25832", {}, "does not tell what heights are"),
        ("EPSG:31467+5784", {}, "PROJ knows no operation"),
        ("EPSG:2046", {"heights": "ellipsoidal"}, "axes south and west"),
        ("EPSG:2263", {"heights": "ellipsoidal"}, "counts in US survey foot"),
        ("EPSG:99999", {}, "unknown reference system 'EPSG:99999'"),
        ("EPSG:25832+7837", {"heights": "ellipsoidal"}, "leave heights = 'ellipsoidal' out"),
        ("EPSG:25832", {"geoid": 47.0, "datum": "EPSG:9988"}, "ITRF2020 moves with the plates"),
        ("EPSG:4258", {"heights": "ellipsoidal"}, "has no grid coordinates"),
    ],
)
def test_what_does_not_tell_everything_is_refused(
    code: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        fga.ReferenceSystem(code, **options).to_geodetic(np.array([[5e5, 5.4e6, 0.0]]))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"geoid": 47.0, "heights": "ellipsoidal"}, "either ellipsoidal or above a geoid"),
        ({"geoid": float("nan")}, "must be finite"),
        ({"geoid": True}, "path or a number"),
        ({"heights": "orthometric"}, "unknown heights 'orthometric'; valid: ellipsoidal"),
        ({"parameters": fga.SevenParameters(1, 2, 3)}, "state it"),
    ],
)
def test_options_that_contradict_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        fga.ReferenceSystem("EPSG:25832", **options)  # type: ignore[arg-type]


def test_exchanged_coordinates_are_an_error_with_their_points() -> None:
    system = fga.ReferenceSystem("EPSG:25832", heights="ellipsoidal")
    with pytest.raises(InputError, match=r"point 'B'.*easting and\s+northing exchanged") as error:
        system.to_geodetic(np.array([[5e5, 5.3e6, 0.0], [5.3e6, 5e5, 0.0]]), ["A", "B"])
    assert len(error.value.problems) == 1


def test_points_without_coordinates_stay_without() -> None:
    system = fga.ReferenceSystem("EPSG:25832", geoid=47.0)
    frame = system.frame_at(np.array([[5e5, 5.3e6, 0.0], [np.nan] * 3]))
    out = system.to_frame(frame, np.array([[5e5, 5.3e6, 0.0], [np.nan] * 3]))
    assert np.isfinite(out[0]).all()
    assert np.isnan(out[1]).all()


# -- maps -----------------------------------------------------------------------------------------


def test_wgs84_tells_its_operation_and_its_accuracy() -> None:
    system = fga.ReferenceSystem("EPSG:25832", geoid=47.0)
    grid = np.array([[6.8e5, 5.33e6, 500.0]])
    frame = system.frame_at(grid)
    sigma = np.diag([1.0, 4.0, 9.0])[None] * 1e-6
    found = wgs84_places(system, frame, system.to_frame(frame, grid), sigma)
    phi, lam, _ = system.to_geodetic(grid)
    # ETRS89 → WGS 84 is the identity, to a metre.
    np.testing.assert_allclose(found.longitude_deg, np.degrees(lam), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.latitude_deg, np.degrees(phi), rtol=0, atol=1e-12)
    assert found.height == pytest.approx(547.0, abs=1e-6)
    assert found.accuracy == 1.0
    assert "ETRS89 to WGS 84" in found.operation
    np.testing.assert_allclose(found.covariances_enu, sigma, rtol=0, atol=1e-10)


def test_a_network_in_grid_axes_has_its_coordinates_as_they_are() -> None:
    """A local frame with a reference system holds grid coordinates; its σ turn by convergence."""
    system = fga.ReferenceSystem("EPSG:25832", geoid=47.0)
    grid = np.array([[6.8e5, 5.33e6, 500.0]])
    sigma = np.diag([1.0, 4.0, 9.0])[None]
    frame = LocalFrame()
    places = grid_places(system, frame, grid, sigma)
    np.testing.assert_array_equal(places.coordinates[:, :2], grid[:, :2])
    np.testing.assert_allclose(places.covariances, sigma)
    found = wgs84_places(system, frame, grid, sigma)
    turn = float(places.convergence[0])
    r = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    np.testing.assert_allclose(
        found.covariances_enu[0, :2, :2], r @ np.diag([1.0, 4.0]) @ r.T, atol=1e-12
    )
    turned = LocalFrame(axes="nw")
    xyz = np.array([[5.33e6, -6.8e5, 500.0]])
    np.testing.assert_allclose(
        wgs84_places(system, turned, xyz).longitude_deg, found.longitude_deg, atol=1e-12
    )


def test_a_geocentric_system_has_no_grid_and_is_on_the_map() -> None:
    system = fga.ReferenceSystem("EPSG:4978")
    xyz = np.array([[4.2e6, 1.7e5, 4.78e6]])
    found = wgs84_places(system, system.geocentric_frame(), xyz)
    phi, lam, h = ellipsoid("WGS84").to_geodetic(xyz)
    np.testing.assert_allclose(found.latitude_deg, np.degrees(phi), atol=1e-12)
    np.testing.assert_allclose(found.longitude_deg, np.degrees(lam), atol=1e-12)
    np.testing.assert_allclose(found.height, h, atol=1e-6)
    assert not system.projected
    with pytest.raises(InputError, match="has no grid coordinates"):
        grid_places(system, system.geocentric_frame(), xyz)


UTM_WKT = """PROJCS["UTM 32",GEOGCS["ETRS89",DATUM["European_Terrestrial_Reference_System_1989",
SPHEROID["GRS 1980",6378137,298.257222101]],PRIMEM["Greenwich",0],
UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],
PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],
PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]]"""


@pytest.mark.parametrize("options", [{"heights": "ellipsoidal"}, {"geoid": 46.0}])
@pytest.mark.parametrize(
    ("definition", "message"),
    [
        (UTM_WKT.replace("Transverse_Mercator", "Nobody_1900"), "PROJ knows no such projection"),
        ("+proj=nobody +ellps=GRS80", "unknown reference system '.proj=nobody"),
        ("+proj=utm +zone=99", "unknown reference system"),
        ("+proj=lcc +lat_1=0 +lat_2=0", "unknown reference system"),
        ("+proj=tmerc +a=0", "unknown reference system"),
        ('LOCAL_CS["Local Coordinates (m)",UNIT["metre",1]]', "is not tied to the Earth"),
        ("EPSG:7837", "is not tied to the Earth"),
        ("PROJCS[" + "x" * 5000, "unknown reference system 'PROJCS.x{113}…'"),
        ("+proj=affine", "is no place on the Earth"),
    ],
)
def test_systems_that_proj_cannot_use_are_errors_for_people(
    definition: str, message: str, options: dict[str, object]
) -> None:
    grid = np.array([[5e5, 5.4e6, 0.0]])
    with pytest.raises(InputError, match=message) as caught:
        fga.ReferenceSystem(definition, **options).checked().to_geodetic(grid)  # type: ignore[arg-type]
    assert len(str(caught.value)) < 1000


@pytest.mark.slow("200 damages; short tests name single ones")
def test_200_damaged_definitions_are_used_or_refused() -> None:
    rng = np.random.default_rng(22)
    whole = (UTM_WKT, "+proj=tmerc +lon_0=9 +k=0.9996 +x_0=500000 +ellps=GRS80", "EPSG:25832+7837")
    used = 0
    for _ in range(200):
        text = list(whole[rng.integers(3)])
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(len(text)))
            text[at : at + int(rng.integers(0, 12))] = rng.choice(list('[]",0 9eAé+='), 1).tolist()
        try:
            system = fga.ReferenceSystem("".join(text), geoid=46.0).checked()
            _ = system.name, system.vertical, system.epsg, system.wkt, system.wkt1
            grid = np.array([[5e5, 5.4e6, 300.0]])
            np.testing.assert_allclose(
                system.from_geodetic(*system.to_geodetic(grid)), grid, rtol=0, atol=1e-4
            )
            used += 1
        except InputError:
            continue
    assert 0 < used < 100


# -- geoids ---------------------------------------------------------------------------------------


def test_raf20_through_proj_is_the_bilinear_interpolation_of_its_nodes() -> None:
    pytest.importorskip("PIL")
    from tests.loaders.borea import Geoid

    file = data_dir("borea") / "fr_ign_RAF20.tif"
    own = Geoid(file)
    system = fga.ReferenceSystem("EPSG:2154", geoid=str(file))
    grid = np.array([[657723.0, 6860710.0, 100.0], [1000123.0, 6301234.0, 800.0]])
    phi, lam, h = system.to_geodetic(grid)
    np.testing.assert_allclose(h - grid[:, 2], own(phi, lam), rtol=0, atol=1e-6)
    np.testing.assert_allclose(system.from_geodetic(phi, lam, h), grid, rtol=0, atol=1e-6)
    # Slopes are taken over ±640 m; the nodes are 2.8 km apart.
    found = system.geoid_at(phi, lam)
    d = 1e-4
    by_hand = (own(phi - d, lam) - own(phi + d, lam)) / (2 * d * 6_371_000.0)
    np.testing.assert_allclose(found.xi, by_hand, rtol=0, atol=1e-9)


def test_a_place_outside_of_the_geoid_is_an_error_with_its_point() -> None:
    file = data_dir("borea") / "fr_ign_RAF20.tif"
    system = fga.ReferenceSystem("EPSG:2154", geoid=str(file))
    with pytest.raises(InputError, match=r"point 'Q': is outside of the geoid grid .*RAF20"):
        system.to_geodetic(np.array([[6.5e5, 6.8e6, 0.0], [1.5e6, 6.0e6, 0.0]]), ["P", "Q"])


def test_undulations_of_ausgeoid_are_those_of_dynadjust() -> None:
    """H and h of the listing at 43 stations, both to 0.1 mm.

    Bilinear interpolation would be up to 3.3 mm away, a cubic spline 0.9 mm, Lagrange's 0.5 mm.
    """
    from tests.loaders.dynadjust import read_listing

    folder = data_dir("dynadjust_gnss")
    _, stations = read_listing(folder / "gnss.simult.adj.expected")
    printed = {
        line[:20].strip(): [float(v) for v in line[23:].split()[2:4]]
        for line in (folder / "gnss.simult.adj.expected").read_text().splitlines()
        if line[20:23] == "FFF"
    }
    system = fga.ReferenceSystem("EPSG:7855", geoid=str(folder / "gnss-network-geoid.gsb"))
    frame = system.geocentric_frame()
    xyz = np.array([s.xyz for s in stations.values()])
    places = grid_places(system, frame, xyz, names=list(stations))
    wanted = np.array([printed[n][1] - printed[n][0] for n in stations])
    np.testing.assert_allclose(places.undulation, wanted, rtol=0, atol=2 * PRINTED)
    heights = np.array([printed[n][0] for n in stations])
    # X, Y, Z are rounded too.
    np.testing.assert_allclose(places.coordinates[:, 2], heights, rtol=0, atol=3 * PRINTED)
