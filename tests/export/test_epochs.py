"""Displacements of two epochs in the formats of maps and drawings."""

from __future__ import annotations

import json
import sqlite3
from collections import Counter
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.report.epochs_report import EpochsReport
from tests.networks import moved
from tests.support.geometries import area, decoded, rows_of

MM = 1e-3


def test_a_geopackage_has_vectors_and_their_ellipses(tmp_path):
    file, found = tmp_path / "moved.gpkg", moved.in_plan()
    fga.write(found, file, exaggeration=500.0)
    rows = rows_of(file, "displacements")
    assert [r["name"] for r in rows] == list(found.displacements)
    ellipses = {e.a: e for e in found.ellipses(confidence=0.95)}
    rings = {r["name"]: decoded(r["geom"])[2] for r in rows_of(file, "displacement_ellipses")}
    for row in rows:
        x = found.displacement(row["name"])
        a, b = decoded(row["geom"])[2]
        assert a == pytest.approx(x.place, abs=1e-9)
        assert b - a == pytest.approx(500 * x.vector, abs=1e-9)
        assert row["dx_mm"] == pytest.approx(x.vector[0] / MM, rel=1e-12)
        assert (row["moved"], row["test_value"]) == (int(x.moved), x.test.value)
        assert row["detectable_mm"] == pytest.approx(x.detectable / MM, rel=1e-12)
        ring, e = rings[x.name], ellipses[x.name]
        assert ring[:-1].mean(axis=0) == pytest.approx(b, abs=1e-6)
        # A polygon of 72 corners has 0.9987 of the area of its ellipse.
        assert area(ring) == pytest.approx(0.9987 * np.pi * np.prod(e.semi_axes) * 500**2, rel=1e-3)
    status = {r["name"]: r["status"] for r in rows_of(file, "points")}
    assert (status["A"], status["B"], status["P"]) == ("stable", "left", "moved")
    connection = sqlite3.connect(file)
    try:
        facts = dict(connection.execute("SELECT name, value FROM adjustment"))
        styles = dict(connection.execute("SELECT f_table_name, styleQML FROM layer_styles"))
    finally:
        connection.close()
    assert facts["stable"] == "A, C, D, E" and facts["moved"] == "B, P, Q"
    assert facts["exaggeration"] == "500.0"
    for name in ("displacements", "displacement_ellipses"):
        filters = {
            e.attrib["filter"] for e in ET.fromstring(styles[name].split(">", 1)[1]).iter("rule")
        }
        assert filters == {'"moved"', 'not "moved"'}


def test_maps_have_longitude_and_latitude(tmp_path):
    pytest.importorskip("pyproj")
    found = moved.with_system()
    fga.write(found, tmp_path / "moved.geojson", exaggeration=1000.0)
    collection = json.loads((tmp_path / "moved.geojson").read_text(encoding="utf-8"))
    lines = {
        f["properties"]["name"]: f
        for f in collection["features"]
        if f["properties"]["layer"] == "displacements"
    }
    from pyproj import Transformer

    back = Transformer.from_crs(4258, 25832, always_xy=True)
    (a, b) = (back.transform(*v[:2]) for v in lines["P"]["geometry"]["coordinates"])
    x = found.displacement("P")
    assert np.subtract(b, a) == pytest.approx(1000 * x.vector[:2], abs=1e-3)
    assert collection["adjustment"]["moved"] == "B, P, Q"
    fga.write(found, tmp_path / "moved.kml")
    root = ET.parse(tmp_path / "moved.kml").getroot()
    space = {"k": "http://www.opengis.net/kml/2.2"}
    styles = Counter(e.text for e in root.findall(".//k:styleUrl", space))
    assert styles["#displacements_moved"] == 6 and styles["#displacements_kept"] == 8
    known = {e.attrib["id"] for e in root.findall(".//k:Style", space)}
    assert {s.removeprefix("#") for s in styles} <= known


def test_a_drawing_has_arrows_on_layers_by_significance(tmp_path):
    ezdxf = pytest.importorskip("ezdxf", reason="the extra dxf is not installed")
    fga.write(moved.in_plan(), tmp_path / "moved.dxf", exaggeration=300.0)
    document = ezdxf.readfile(tmp_path / "moved.dxf")
    assert not document.audit().errors
    found = Counter((e.dxftype(), e.dxf.layer) for e in document.modelspace())
    # An arrow has three strokes.
    assert found["LINE", "DISPLACEMENTS"] == 9
    assert found["LINE", "DISPLACEMENTS_NOT_SIGNIFICANT"] == 12
    assert found["ELLIPSE", "DISPLACEMENTS"] == 3
    assert found["POINT", "POINTS"] == 7
    x = moved.in_plan().displacement("P")
    lines = document.modelspace().query('LINE[layer=="DISPLACEMENTS"]')
    ends = [e.dxf.end for e in lines if np.allclose(e.dxf.start, x.place)]
    assert tuple(ends[0]) == pytest.approx(x.place + 300 * x.vector, abs=1e-9)


def test_heights_and_results_are_written(tmp_path):
    report = EpochsReport(moved.heights())
    fga.write(report, tmp_path / "heights.gpkg", exaggeration=10.0)
    for row in rows_of(tmp_path / "heights.gpkg", "displacements"):
        a, b = decoded(row["geom"])[2]
        assert b - a == pytest.approx(10 * moved.heights().displacement(row["name"]).vector)
    fga.write(report, tmp_path / "heights.json")
    found = json.loads((tmp_path / "heights.json").read_text(encoding="utf-8"))
    assert found["axes"] == "z"


def test_what_a_format_cannot_express_is_refused(tmp_path):
    found = moved.in_plan()
    for name, words in (
        ("moved.ply", "has no displacements of two epochs"),
        ("moved.toml", "has no displacements of two epochs"),
        ("moved.geojson", "longitude and latitude in WGS 84 only"),
    ):
        with pytest.raises(InputError, match=words):
            fga.write(found, tmp_path / name)
    with pytest.raises(InputError, match="one factor"):
        fga.write(found, tmp_path / "moved.gpkg", vector_exaggeration=10.0)
    assert not list(tmp_path.iterdir())
