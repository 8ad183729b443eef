"""GeoJSON after RFC 7946: longitude first, WGS 84, rings by the right hand, cut at 180°."""

from __future__ import annotations

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.export.geojson_kml import parts_of_line, parts_of_ring, write_geojson
from tests.networks.mapped import in_plane, in_utm, mapped
from tests.support.geometries import area

pytest.importorskip("pyproj", reason="the extra crs is not installed")

DEPTH = {"Point": 1, "LineString": 2, "Polygon": 3, "MultiLineString": 3, "MultiPolygon": 4}
"""Levels of lists of the coordinates of each type of geometry."""


def positions(coordinates, depth):
    """Return all positions (n, 3) of nested lists."""
    if depth == 1:
        return np.array([coordinates])
    return np.concatenate([positions(c, depth - 1) for c in coordinates])


def rings(geometry):
    """Return the rings of a polygon or of several."""
    if geometry["type"] == "Polygon":
        return geometry["coordinates"]
    return [r for p in geometry["coordinates"] for r in p]


@pytest.fixture(scope="module")
def utm(tmp_path_factory):
    file = tmp_path_factory.mktemp("utm") / "block.geojson"
    write_geojson(in_utm(), file)
    return json.loads(file.read_text(encoding="utf-8"))


def test_the_file_is_a_collection_of_features(utm):
    assert utm["type"] == "FeatureCollection"
    assert "crs" not in utm, "RFC 7946 removed it"
    for feature in utm["features"]:
        assert set(feature) == {"type", "geometry", "properties"}
        assert feature["type"] == "Feature"
        g = feature["geometry"]
        if g is not None:
            assert set(g) == {"type", "coordinates"}
            at = positions(g["coordinates"], DEPTH[g["type"]])
            assert at.shape[1] == 3, "longitude, latitude, height"


def test_longitude_stands_before_latitude_and_heights_are_ellipsoidal(utm):
    s = in_utm()
    expected = fga.wgs84_coordinates(s)
    points = [f for f in utm["features"] if f["properties"]["layer"] == "points"]
    at = np.array([f["geometry"]["coordinates"] for f in points])
    assert np.abs(at[:, 0] - expected.longitude_deg).max() < 1e-12
    assert np.abs(at[:, 1] - expected.latitude_deg).max() < 1e-12
    assert np.abs(at[:, 2] - expected.height).max() < 1e-8
    assert np.allclose(at[:, :2], [11.575, 48.137], atol=0.001)
    assert utm["adjustment"]["operation_to_wgs84"] == expected.operation
    assert utm["adjustment"]["accuracy_of_operation_m"] == expected.accuracy


def test_rings_are_closed_and_counter_clockwise(utm):
    found = [f for f in utm["features"] if f["geometry"] and "Polygon" in f["geometry"]["type"]]
    assert {f["properties"]["layer"] for f in found} == {"ellipses", "footprints"}
    for feature in found:
        for ring in rings(feature["geometry"]):
            assert ring[0] == ring[-1] and len(ring) >= 4
            assert area(np.array(ring)) > 0


def test_an_ellipse_has_its_axes_in_metres(utm):
    s = in_utm()
    expected = {n: fga.error_ellipse(s, n).semi_axes for n in s.network.points if n != "S1"}
    radii = fga.TopocentricFrame(0.0, 0.0).geocentric.ellipsoid.radii(np.radians([48.137]))
    for f in utm["features"]:
        p = f["properties"]
        if p["layer"] == "ellipses":
            ring = np.array(f["geometry"]["coordinates"][0])[:, :2]
            metres = np.radians(ring - (ring[0] + ring[36]) / 2) * [
                (radii[1][0] + 520) * np.cos(np.radians(48.137)),
                radii[0][0] + 520,
            ]
            away = np.linalg.norm(metres, axis=1) / p["exaggeration"]
            assert away.max() == pytest.approx(expected[p["name"]][0], rel=1e-5)
            assert away.min() == pytest.approx(expected[p["name"]][1], rel=1e-5, abs=1e-9)


def test_a_network_of_unknown_place_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(fga.InputError, match=r"GeoJSON has .* WGS 84 only; .*no reference system"):
        write_geojson(in_plane(), tmp_path / "a.geojson")
    assert not list(tmp_path.iterdir())


def test_what_crosses_the_meridian_of_180_degrees_is_cut_there(tmp_path):
    """Fiji: the axis of the block is the meridian."""
    system = fga.ReferenceSystem("EPSG:32760", heights="ellipsoidal", datum=None)
    network = mapped(system, (-16.8, 180.0, 30.0))
    network.frame = fga.TopocentricFrame(np.radians(-16.8), np.pi, 30.0, "WGS84")
    write_geojson(fga.adjust(network), tmp_path / "a.geojson")
    found = json.loads((tmp_path / "a.geojson").read_text())["features"]
    kinds = {f["geometry"]["type"] for f in found if f["geometry"]}
    assert {"MultiLineString", "Point", "Polygon", "LineString"} <= kinds
    crossed = 0
    for f in found:
        g = f["geometry"]
        if g is None or g["type"] == "Point":
            continue
        parts = g["coordinates"] if g["type"].startswith("Multi") else [g["coordinates"]]
        for part in parts:
            at = positions(part, DEPTH[g["type"].removeprefix("Multi")])
            assert np.abs(at[:, 0]).max() <= 180.0
            assert np.ptp(at[:, 0]) < 0.01, "no part goes round the Earth"
        crossed += len(parts) > 1
    assert crossed > 10


def test_parts_of_a_ring_have_its_area_together():
    t = np.linspace(0, 2 * np.pi, 73)
    ring = np.column_stack([179.9 + 0.3 * np.cos(t), -17 + 0.2 * np.sin(t), 5.0 + 0 * t])
    ring[-1] = ring[0]
    jumping = ring.copy()
    jumping[:, 0] = (jumping[:, 0] + 180) % 360 - 180
    parts = parts_of_ring(jumping)
    assert len(parts) == 2
    assert sum(area(p) for p in parts) == pytest.approx(area(ring), rel=1e-9)
    assert all(area(p) > 0 and np.array_equal(p[0], p[-1]) for p in parts)
    assert np.array_equal(parts_of_ring(ring - [5, 0, 0])[0], ring - [5, 0, 0])


def test_a_line_is_cut_with_the_height_of_the_crossing():
    first, second = parts_of_line(np.array([[179.0, 0.0, 0.0], [-178.0, 3.0, 300.0]]))
    assert np.allclose(first, [[179, 0, 0], [180, 1, 100]])
    assert np.allclose(second, [[-180, 1, 100], [-178, 3, 300]])
    (whole,) = parts_of_line(np.array([[1.0, 0.0, 0.0], [2.0, 3.0, 300.0]]))
    assert len(whole) == 2
