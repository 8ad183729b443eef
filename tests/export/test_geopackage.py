"""A GeoPackage holds the solution: places, ellipses, observations, photos, styles."""

from __future__ import annotations

import sqlite3
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.export.geopackage import NO_DATE, write_geopackage
from factorgraph_adj.export.map_shapes import VERTICES_OF_RING
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.options import Provenance, ReportOptions, Run
from tests.networks.mapped import geocentric, in_plane, in_utm, mapped
from tests.networks.small_block import blundered
from tests.support.geometries import area, decoded, rows_of

NANOMETRE = 1e-9
GRID_DIGITS = 5e-9
"""What float64 resolves of a northing of 5 000 km, several times."""


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    file = tmp_path_factory.mktemp("plane") / "block.gpkg"
    write_geopackage(in_plane(), file, exaggeration=1.0)
    return file


@pytest.fixture(scope="module")
def utm(tmp_path_factory):
    pytest.importorskip("pyproj")
    file = tmp_path_factory.mktemp("utm") / "block.gpkg"
    write_geopackage(in_utm(), file)
    return file


def read(file, query):
    connection = sqlite3.connect(file)
    try:
        return connection.execute(query).fetchall()
    finally:
        connection.close()


def test_the_file_is_a_geopackage_of_version_1_3(plane):
    assert read(plane, "PRAGMA application_id") == [(0x47504B47,)]
    assert read(plane, "PRAGMA user_version") == [(10300,)]
    assert read(plane, "PRAGMA integrity_check") == [("ok",)]
    assert read(plane, "PRAGMA foreign_key_check") == []
    systems = {r[0] for r in read(plane, "SELECT srs_id FROM gpkg_spatial_ref_sys")}
    assert systems == {-1, 0, 4326}
    contents = read(plane, "SELECT table_name, data_type, last_change FROM gpkg_contents")
    tables = {r[0] for r in read(plane, "SELECT name FROM sqlite_master WHERE type = 'table'")}
    own = {t for t in tables if not t.startswith(("gpkg_", "sqlite_"))}
    assert {t for t, _, _ in contents} == own, "a table that contents do not list is no layer"
    features = {t for t, kind, _ in contents if kind == "features"}
    listed = read(plane, "SELECT table_name, geometry_type_name, z, m FROM gpkg_geometry_columns")
    assert {(t, z, m) for t, _, z, m in listed} == {(t, 1, 0) for t in features}
    assert all(date == NO_DATE for *_, date in contents), "the library looks at no clock"


def test_extents_are_those_of_the_geometries(plane):
    query = "SELECT table_name, min_x, min_y, max_x, max_y FROM gpkg_contents WHERE srs_id = -1"
    for layer, *bounds in read(plane, query):
        shapes = [decoded(r["geom"])[2] for r in rows_of(plane, layer) if r["geom"] is not None]
        if shapes:
            every = np.concatenate(shapes)[:, :2]
            assert bounds == [*every.min(axis=0), *every.max(axis=0)]


def test_points_stand_where_they_were_adjusted(plane):
    s = in_plane()
    found = rows_of(plane, "points")
    assert [r["name"] for r in found] == list(s.network.points)
    for r in found:
        srs, kind, xyz = decoded(r["geom"])
        assert (srs, kind) == (-1, "POINT")
        assert xyz[0].tolist() == [r["x"], r["y"], r["z"]] == s.point(r["name"]).tolist()
        sigma = [r[f"sigma_{a}_mm"] for a in "xyz"]
        assert np.allclose(sigma, s.standard_deviations(r["name"]) * 1e3, rtol=1e-12)
    assert {r["name"]: r["status"] for r in found} | {"S1": "held", "P3": "check"} == {
        r["name"]: r["status"] for r in found
    }
    checked = next(r for r in found if r["name"] == "P8")
    known = s.network.points["P8"].check
    off = s.point("P8") - known
    assert np.allclose([checked[f"check_d{a}_mm"] for a in "xyz"], off * 1e3)
    assert next(r for r in found if r["name"] == "P1")["check_dx_mm"] is None


def test_ellipses_are_the_ellipses(plane):
    """Axes and azimuth of the vertices, and the area of a polygon in an ellipse."""
    s = in_plane()
    expected = {e.a: e for e in (fga.error_ellipse(s, n) for n in s.network.points if n != "S1")}
    found = rows_of(plane, "ellipses")
    assert {r["name"] for r in found} == set(expected), "a held point has none"
    for r in found:
        e = expected[r["name"]]
        _, kind, ring = decoded(r["geom"])
        assert kind == "POLYGON" and len(ring) == VERTICES_OF_RING + 1
        assert np.array_equal(ring[0], ring[-1]), "rings are closed"
        a, b = e.semi_axes
        part = VERTICES_OF_RING / 2 * np.sin(2 * np.pi / VERTICES_OF_RING)
        assert area(ring) == pytest.approx(part * a * b, rel=1e-6, abs=1e-15)
        away = np.linalg.norm(ring - s.point(r["name"]), axis=1)
        assert away.max() == pytest.approx(a, rel=1e-9)
        assert away.min() == pytest.approx(b, rel=1e-9, abs=1e-14)
        major = ring[0] - s.point(r["name"])
        azimuth = np.arctan2(major[0], major[1]) % np.pi
        turned = (azimuth - e.azimuth + np.pi / 2) % np.pi - np.pi / 2
        assert abs(turned) < 1e-6 or a == pytest.approx(b)
        assert r["semi_major_mm"] == pytest.approx(a * 1e3)
        assert r["exaggeration"] == 1.0


def test_vertices_of_an_ellipse_have_the_distance_of_the_confidence_level(plane):
    """(x − x̂)ᵀ Σ⁻¹ (x − x̂) = χ²(95 %, 2) at every vertex: 5.991 is in every table."""
    s = in_plane()
    for r in rows_of(plane, "ellipses"):
        if r["name"].startswith("P"):
            _, _, ring = decoded(r["geom"])
            d = (ring - s.point(r["name"]))[:, :2]
            weight = np.linalg.inv(s.covariance(r["name"])[:2, :2])
            assert np.allclose(np.einsum("ni,ij,nj->n", d, weight, d), 5.991465, rtol=1e-6)


def test_the_exaggeration_is_stated_and_made(tmp_path, plane):
    file = tmp_path / "large.gpkg"
    write_geopackage(in_plane(), file, exaggeration=250.0, confidence=None)
    one = {r["name"]: r for r in rows_of(plane, "ellipses")}
    k = np.sqrt(5.991464547107979)
    for r in rows_of(file, "ellipses"):
        assert r["exaggeration"] == 250.0
        ring, true = decoded(r["geom"])[2], decoded(one[r["name"]]["geom"])[2]
        assert area(ring) == pytest.approx(area(true) * 250.0**2 / k**2, rel=1e-6, abs=1e-15)
    facts = {r["name"]: r["value"] for r in rows_of(file, "adjustment")}
    assert facts["exaggeration_of_ellipses"] == "250.0"
    assert facts["confidence_of_ellipses"] == "standard ellipses"
    with pytest.raises(fga.InputError, match="exaggeration must be a number greater than zero"):
        write_geopackage(in_plane(), file, exaggeration=0.0)


def test_a_chosen_exaggeration_makes_ellipses_visible_and_keeps_them_apart(tmp_path):
    write_geopackage(in_plane(), tmp_path / "a.gpkg")
    shapes = [decoded(r["geom"])[2] for r in rows_of(tmp_path / "a.gpkg", "ellipses")]
    xyz = in_plane().state["point"]
    extent = float(np.ptp(xyz[:, :2], axis=0).max())
    sizes = [float(np.ptp(s[:, :2], axis=0).max()) for s in shapes]
    assert 0.01 * extent < np.median(sizes) < 0.15 * extent


def test_observations_are_lines_with_v_r_w(plane):
    s = in_plane()
    rel = fga.reliability(s)
    rows = {(o.id, o.component): i for i, o in enumerate(s.observations)}
    found = [
        *((r, 2) for layer in ("observations", "image_points") for r in rows_of(plane, layer)),
        *((r, 1) for r in rows_of(plane, "observations_at_points")),
    ]
    assert len(found) == len(s.observations), "each scalar observation once"
    for r, size in found:
        i = rows[r["id"], r["component"]]
        scale = {"mm": 1e-3, "mgon": np.pi / 200e3, "um": 1e-3, "": 1.0}[r["small_unit"]]
        assert r["residual"] * scale == pytest.approx(s.observations.residuals[i], rel=1e-9)
        assert r["redundancy_number"] == pytest.approx(rel.redundancy_numbers[i], rel=1e-9)
        assert r["w"] == pytest.approx(rel.w[i], rel=1e-9)
        if r["geom"] is not None:
            _, _, line = decoded(r["geom"])
            assert len(line) == size
    line = next(r for r in rows_of(plane, "observations") if r["kind"] == "slope distance")
    _, _, ends = decoded(line["geom"])
    assert np.array_equal(ends, [s.point(line["station"]), s.point(line["target"])])
    ray = rows_of(plane, "image_points")[0]
    _, _, ends = decoded(ray["geom"])
    assert np.array_equal(ends, [s.pose(ray["photo"]).position, s.point(ray["point"])])


def test_the_worst_observations_are_drawn_last(tmp_path):
    write_geopackage(fga.adjust(blundered()), tmp_path / "a.gpkg")
    for layer in ("observations", "image_points"):
        values = [abs(r["w"]) for r in rows_of(tmp_path / "a.gpkg", layer)]
        assert values == sorted(values)
        assert rows_of(tmp_path / "a.gpkg", layer)[-1]["suspect"] == 1
    assert rows_of(tmp_path / "a.gpkg", "image_points")[-1]["id"] == "F1/P6"


def test_an_angle_goes_over_its_station(tmp_path):
    network = fga.Network("angle")
    for name, at in (("A", (0.0, 0.0, 0.0)), ("B", (100.0, 0.0, 0.0)), ("C", (0.0, 90.0, 0.0))):
        network.add_point(name, at, fixed="xyz" if name != "C" else "z")
    network.add(fga.HorizontalAngle("A", "C", "B", np.pi / 2, sigma=1e-5))
    network.add(fga.HorizontalDistance("A", "C", 90.01, sigma=0.01))
    network.add(fga.HorizontalDistance("B", "C", 134.54, sigma=0.01))
    write_geopackage(fga.adjust(network), tmp_path / "a.gpkg")
    angle = next(r for r in rows_of(tmp_path / "a.gpkg", "observations") if r["target2"])
    _, _, line = decoded(angle["geom"])
    assert np.allclose(line[[0, 1]], [[0, 90, 0], [0, 0, 0]], atol=0.1)
    assert line[2].tolist() == [100.0, 0.0, 0.0]


def test_vectors_are_adjusted_minus_given(tmp_path):
    s = in_plane()
    write_geopackage(s, tmp_path / "a.gpkg", vector_exaggeration=1000.0)
    found = {(r["name"], r["kind"]): r for r in rows_of(tmp_path / "a.gpkg", "vectors")}
    assert {k for k in found if k[1] == "check point"} == {
        (n, "check point") for n in ("P3", "P8", "P10")
    }
    for (name, kind), r in found.items():
        _, _, (start, end) = decoded(r["geom"])
        given = s.network.points[name]
        known = np.array(given.check if kind == "check point" else given.coordinates)
        if kind == "weighted coordinates":
            known[given.fixed.index(True)] = s.point(name)[given.fixed.index(True)]
        shift = s.point(name) - known
        assert np.allclose(start, known, atol=NANOMETRE)
        assert np.allclose(end - start, 1000.0 * shift, atol=1e-6)
        assert np.allclose([r[f"d{a}_mm"] for a in "xyz"], 1e3 * shift, atol=1e-6)
    assert ("S2", "weighted coordinates") in found


def test_grid_coordinates_have_the_code_of_the_reference_system(utm):
    s = in_utm()
    (system,) = [r for r in rows_of(utm, "gpkg_spatial_ref_sys") if r["srs_id"] == 25832]
    assert (system["organization"], system["organization_coordsys_id"]) == ("EPSG", 25832)
    import pyproj

    assert pyproj.CRS(system["definition"]).to_epsg() == 25832
    expected = fga.grid_coordinates(s)
    found = rows_of(utm, "points")
    at = np.array([decoded(r["geom"])[2][0] for r in found])
    assert {decoded(r["geom"])[0] for r in found} == {25832}
    assert np.abs(at - expected.coordinates).max() < GRID_DIGITS
    assert np.allclose(at[0, :2], (691_600, 5_334_800), atol=20_000), "east first, then north"


def test_ellipses_in_the_grid_have_its_scale_and_convergence(tmp_path):
    pytest.importorskip("pyproj")
    s = in_utm()
    write_geopackage(s, tmp_path / "a.gpkg", exaggeration=1000.0)
    places = fga.grid_coordinates(s).places
    number = {n: i for i, n in enumerate(s.network.points)}
    for r in rows_of(tmp_path / "a.gpkg", "ellipses"):
        i, e = number[r["name"]], fga.error_ellipse(s, r["name"])
        _, _, ring = decoded(r["geom"])
        centre = places.coordinates[i]
        part = VERTICES_OF_RING / 2 * np.sin(2 * np.pi / VERTICES_OF_RING)
        true = part * e.semi_axes[0] * e.semi_axes[1] * 1e6
        assert area(ring) == pytest.approx(true * places.combined[i] ** 2, rel=1e-5, abs=1e-9)
        bearing = np.arctan2(*(ring[0] - centre)[:2])
        turned = (bearing - (e.azimuth - places.convergence[i]) + np.pi / 2) % np.pi - np.pi / 2
        assert abs(turned) < 1e-5
    assert abs(places.convergence[0]) > 0.03, "the place has a convergence that the test sees"


def test_a_footprint_is_where_the_corners_of_the_sensor_meet_the_ground(tmp_path):
    """A vertical photo over flat ground: a rectangle of h/c times the sensor."""
    network = fga.Network("nadir")
    network.add_camera("c", NoDistortion(), {"c": 50.0}, format=(36.0, 24.0))
    for i, (x, y) in enumerate([(0, 0), (10, 0), (10, 10), (0, 10), (5, 5)]):
        network.add_point(f"P{i}", (x, y, 2.0), fixed="xyz")
    rotation = np.diag([1.0, -1.0, -1.0])
    network.add_photo("down", "c", position=(5.0, 5.0, 102.0), rotation=rotation)
    network.add_photo("level", "c", position=(5.0, -60.0, 4.0), rotation=LEVEL)
    for photo, turn in (("down", rotation), ("level", LEVEL)):
        centre = np.array(network.photos[photo].position)
        for p in network.points.values():
            q = (np.array(p.coordinates) - centre) @ turn
            network.add(
                fga.ImagePoint(photo, p.name, 50 * q[0] / q[2], -50 * q[1] / q[2], sigma=0.005)
            )
    write_geopackage(fga.adjust(network), tmp_path / "a.gpkg")
    (only,) = rows_of(tmp_path / "a.gpkg", "footprints")
    assert only["name"] == "down", "a level photo looks over the horizon"
    _, _, ring = decoded(only["geom"])
    assert area(ring) == pytest.approx(72.0 * 48.0, rel=1e-6)
    assert np.allclose(ring[:, 2], 2.0, atol=1e-6)
    low, high = ring.min(axis=0), ring.max(axis=0)
    assert np.allclose([*low[:2], *high[:2]], [5 - 36, 5 - 24, 5 + 36, 5 + 24], atol=1e-5)
    assert len(rows_of(tmp_path / "a.gpkg", "photos")) == 2


LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""world_R_camera of a photo that looks north: x east, y down, z north."""


def test_each_vertex_of_a_footprint_is_seen_at_the_edge_of_the_sensor(plane):
    """The lens sees the vertices where image points end: v = 0 at some point of the edge."""
    s = in_plane()
    lens, k = s.network.cameras["D3"].lens, s.calibration("D3").values[None]
    xy = np.array([(o.x, o.y) for o in s.network.image_points()])
    (left, low), (right, high) = xy.min(axis=0), xy.max(axis=0)
    t = np.arange(8) / 8
    across, up = left + t * (right - left), low + t * (high - low)
    back, down = right - t * (right - left), high - t * (high - low)
    x = np.concatenate([across, right + 0 * t, back, left + 0 * t])
    y = np.concatenate([low + 0 * t, up, high + 0 * t, down])
    edge = np.column_stack([x, y])
    found = rows_of(plane, "footprints")
    assert [r["name"] for r in found] == ["F1", "F2"], "F3 and F4 see the horizon in a corner"
    for r in found:
        _, _, ring = decoded(r["geom"])
        pose = s.pose(r["name"])
        q = (ring[:-1] - pose.position) @ pose.rotation
        assert len(q) == len(edge) and (q[:, 2] > 0).all()
        for tx, ty in np.column_stack([q[:, 0] / q[:, 2], -q[:, 1] / q[:, 2]]):
            tangent = np.full(len(edge), tx), np.full(len(edge), ty)
            v, _, _ = lens.residual(*tangent, edge, k, jacobians=False)
            assert np.linalg.norm(v, axis=1).min() < 1e-9
        assert np.ptp(ring[:, 2]) < 1e-9, "the ground is level"


def test_a_geocentric_network_without_a_system_is_geographic_of_unknown_datum(tmp_path):
    write_geopackage(fga.adjust(geocentric()), tmp_path / "a.gpkg")
    point = next(r for r in rows_of(tmp_path / "a.gpkg", "points") if r["name"] == "A")
    srs, _, at = decoded(point["geom"])
    assert srs == 0
    assert at[0].tolist() == pytest.approx([11.575, 48.137, 520.0], abs=1e-8)


def test_a_system_without_a_grid_gives_wgs84(tmp_path):
    pytest.importorskip("pyproj")
    network = geocentric()
    network.crs = fga.ReferenceSystem("EPSG:4936")
    write_geopackage(fga.adjust(network), tmp_path / "a.gpkg")
    point = next(r for r in rows_of(tmp_path / "a.gpkg", "points") if r["name"] == "A")
    srs, _, at = decoded(point["geom"])
    assert srs == 4326
    assert at[0, :2].tolist() == pytest.approx([11.575, 48.137], abs=1e-8)


def test_a_system_without_a_code_brings_its_definition(tmp_path):
    pytest.importorskip("pyproj")
    site = "+proj=tmerc +lat_0=48 +lon_0=11.5 +k=1.0001 +x_0=1000 +y_0=2000 +ellps=GRS80 +units=m"
    network = mapped(fga.ReferenceSystem(site, heights="ellipsoidal"))
    write_geopackage(fga.adjust(network), tmp_path / "a.gpkg")
    (system,) = [
        r for r in rows_of(tmp_path / "a.gpkg", "gpkg_spatial_ref_sys") if r["srs_id"] > 5000
    ]
    assert (system["organization"], system["srs_id"]) == ("NONE", 100_000)
    assert "48" in system["definition"] and "Transverse_Mercator" in system["definition"]


def test_axes_of_a_local_frame_are_turned_to_east_and_north(tmp_path):
    network = fga.Network("north first", frame=fga.LocalFrame(axes="ne"))
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (500.0, 20.0, 0.0), fixed="xyz")
    network.add_point("P", (250.0, 300.0, 0.0), fixed="z")
    for name, d in (("A", 390.5), ("B", 375.4)):
        network.add(fga.HorizontalDistance(name, "P", d, sigma=0.01))
    write_geopackage(fga.adjust(network), tmp_path / "a.gpkg", exaggeration=10.0)
    at = {r["name"]: decoded(r["geom"])[2][0] for r in rows_of(tmp_path / "a.gpkg", "points")}
    assert at["B"].tolist() == [20.0, 500.0, 0.0]
    (ellipse,) = rows_of(tmp_path / "a.gpkg", "ellipses")
    assert area(decoded(ellipse["geom"])[2]) > 0, "counter-clockwise on the map"


def test_every_layer_has_a_style_whose_filters_name_its_columns(plane):
    styles = {r["f_table_name"]: r for r in rows_of(plane, "layer_styles")}
    layers = {r[0] for r in read(plane, "SELECT table_name FROM gpkg_geometry_columns")}
    assert set(styles) == layers
    for layer, style in styles.items():
        assert style["useAsDefault"] == 1 and style["f_geometry_column"] == "geom"
        root = ET.fromstring(style["styleQML"])
        columns = set(rows_of(plane, layer)[0])
        rules, symbols = root.findall(".//rule"), root.findall(".//symbol")
        assert {r.get("symbol") for r in rules} == {s.get("name") for s in symbols}
        for rule in rules:
            named = (rule.get("filter") or "").split('"')[1::2]
            assert set(named) <= columns, layer
            if rule.get("filter"):
                condition = rule.get("filter").replace("false", "0")
                read(plane, f'SELECT count(*) FROM "{layer}" WHERE {condition}')


def test_the_rules_of_points_take_each_point_once(plane):
    styles = {r["f_table_name"]: r["styleQML"] for r in rows_of(plane, "layer_styles")}
    for layer in ("points", "observations"):
        rules = [r.get("filter") for r in ET.fromstring(styles[layer]).findall(".//rule")]
        counts = [read(plane, f'SELECT count(*) FROM "{layer}" WHERE {r}')[0][0] for r in rules]
        assert sum(counts) == len(rows_of(plane, layer))


def test_the_same_solution_gives_the_same_file(tmp_path, plane):
    write_geopackage(in_plane(), tmp_path / "again.gpkg", exaggeration=1.0)
    assert (tmp_path / "again.gpkg").read_bytes() == plane.read_bytes()


def test_the_date_of_a_run_is_the_date_of_the_layers(tmp_path):
    run = Provenance(run=Run(date="2026-03-01 01:30 +0200"))
    write_geopackage(Report(in_plane(), ReportOptions(), run), tmp_path / "a.gpkg")
    dates = {r["last_change"] for r in rows_of(tmp_path / "a.gpkg", "gpkg_contents")}
    assert dates == {"2026-02-28T23:30:00.000Z"}


def test_names_with_quotes_stay_themselves(tmp_path):
    network = fga.Network('it\'s "quoted"')
    name = 'P"; DROP TABLE points; --'
    network.add_point("A'ä", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point(name, (9.0, 0.0, 0.0), fixed="yz")
    network.add(fga.SlopeDistance("A'ä", name, 10.0, sigma=0.01))
    write_geopackage(fga.adjust(network), tmp_path / "a.gpkg")
    assert [r["name"] for r in rows_of(tmp_path / "a.gpkg", "points")] == ["A'ä", name]
    assert rows_of(tmp_path / "a.gpkg", "observations")[0]["w"] is None, "w of r = 0 is unknown"
    facts = {r["name"]: r["value"] for r in rows_of(tmp_path / "a.gpkg", "adjustment")}
    assert facts["sigma0"] is None


def test_control_along_east_north_and_up_gives_vectors_in_the_frame(tmp_path):
    network = geocentric()
    given = np.array(network.points["P"].coordinates)
    network.add(fga.ControlPoint("P", tuple(given + 0.004), axes="enu", sigma=(0.01, 0.01, 0.02)))
    s = fga.adjust(network)
    write_geopackage(s, tmp_path / "a.gpkg", vector_exaggeration=1.0)
    (found,) = rows_of(tmp_path / "a.gpkg", "vectors")
    shift = [found[f"d{a}_mm"] for a in "xyz"]
    assert np.allclose(shift, 1e3 * (s.point("P") - given - 0.004), atol=1e-5)
