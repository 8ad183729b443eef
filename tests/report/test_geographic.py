"""Networks on an ellipsoid have latitude, longitude, height and σ in east, north, up."""

from __future__ import annotations

import csv
import io
import json
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.frames import Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.io.numbers import Units, parse_quantity
from factorgraph_adj.io.project import read_project
from factorgraph_adj.io.project_writer import write_project
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import GnssVector
from factorgraph_adj.report.options import ReportOptions
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.report.text import text_report
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.estimates import geodetic_coordinates
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.units import ANGLE, parse_angle
from tests.support.printed import row, section

DEG, MM, ARCSEC = ANGLE["deg"], 1e-3, ANGLE["arcsec"]
TITLE = "Latitude, longitude and ellipsoidal height (GRS80)"
TOPOCENTRIC = TopocentricFrame(46.95 * DEG, -7.44 * DEG, 550.0)
EAST_NORTH_UP = {
    "A": (0.0, 0.0, 0.0),
    "B": (200.0, 3000.0, 40.0),
    "C": (2500.0, 300.0, 80.0),
    "D": (900.0, 1100.0, 30.0),
}
SIGMA = (0.003, 0.004, 0.008)


def vectors(frame: Frame) -> Network:
    """Return GNSS vectors between four points, in a frame."""
    network = Network("vectors", frame=frame)
    at = np.array(list(EAST_NORTH_UP.values()))
    if isinstance(frame, GeocentricFrame):
        at = TOPOCENTRIC.to_geocentric(at)
    for name, xyz in zip(EAST_NORTH_UP, at, strict=True):
        network.add_point(name, xyz, fixed="xyz" if name == "A" else "")
    for a, b in combinations(EAST_NORTH_UP, 2):
        network.add(GnssVector(a, b, (0.0, 0.0, 0.0), sigma=SIGMA))
    return measure(network, seed=4)


@cache
def solution(frame: Frame) -> Solution:
    return adjust(vectors(frame))


ON_AN_ELLIPSOID = pytest.mark.parametrize("frame", [TOPOCENTRIC, GeocentricFrame()], ids=type)


@ON_AN_ELLIPSOID
def test_latitude_longitude_and_height_lead_back_to_the_coordinates(frame):
    s = solution(frame)
    table = s.point_table()
    xyz = GeocentricFrame().ellipsoid.to_cartesian(
        table["latitude"], table["longitude"], table["height"]
    )
    at = s.state["point"]
    expected = at if isinstance(frame, GeocentricFrame) else frame.to_geocentric(at)
    assert xyz == pytest.approx(expected, abs=0.01 * MM)
    assert table["longitude"][0] == pytest.approx(-7.44 * DEG, abs=1e-12)


def test_sigma_in_east_north_up_is_that_of_the_topocentric_axes_at_their_origin():
    """At the origin the axes of the frame are east, north and up; elsewhere they are tilted."""
    covariance = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -2.0], [0.5, -2.0, 25.0]]) * MM**2
    found = geodetic_coordinates(TOPOCENTRIC, np.zeros((1, 3)), covariance[None])
    assert found.sigma[0] / MM == pytest.approx([2.0, 3.0, 5.0], abs=1e-9)


def test_sigma_in_east_north_up_is_the_same_in_geocentric_axes():
    covariance = np.diag([4.0, 9.0, 25.0]) * MM**2
    rows = GeocentricFrame().basis(TOPOCENTRIC.to_geocentric(np.zeros((1, 3))), np.zeros((1, 2)))
    turned = rows.enu[0].T @ covariance @ rows.enu[0]
    at = TOPOCENTRIC.to_geocentric(np.zeros((1, 3)))
    found = geodetic_coordinates(GeocentricFrame(), at, turned[None])
    assert found.sigma[0] / MM == pytest.approx([2.0, 3.0, 5.0], abs=1e-6)


@ON_AN_ELLIPSOID
@pytest.mark.parametrize("unit", ["deg", "dms", "gon"])
def test_the_report_states_the_unit_and_shows_a_tenth_of_a_millimetre(frame, unit):
    s = solution(frame)
    text = text_report(s, ReportOptions(Units(geographic=unit)))
    words = row(text, TITLE, "B")
    table = s.point_table()
    for word, name in zip(words[1:3], ("latitude", "longitude"), strict=True):
        value = parse_angle(word, unit)
        assert value == pytest.approx(table[name][1], abs=0.1 * MM / 6.3e6)
    assert float(words[3]) == pytest.approx(table["height"][1], abs=0.06 * MM)
    assert [float(w) for w in words[4:]] == pytest.approx(
        [table[f"sigma_{a}"][1] / MM for a in ("east", "north", "up")], abs=0.051
    )
    assert f"latitude [{unit}]" in text
    assert row(text, TITLE, "A")[-3:] == ["held"] * 3
    assert section(text, "Adjusted coordinates"), "X, Y, Z stand there as well"


@ON_AN_ELLIPSOID
def test_the_tables_and_the_file_for_programs_have_them(frame, tmp_path):
    s = solution(frame)
    write_solution(s, tmp_path, ReportOptions(Units(geographic="dms")))
    table = s.point_table()
    found = json.loads((tmp_path / "results.json").read_text())["points"]
    rows = csv.DictReader(io.StringIO((tmp_path / "points.csv").read_text()))
    for i, record in enumerate(rows):
        assert record["geographic_unit"] == "dms"
        for name in ("latitude", "longitude"):
            assert parse_angle(record[name], "dms") == pytest.approx(table[name][i], abs=1e-15)
            assert found[record["name"]][name] == table[name][i]
        assert float(record["height"]) == pytest.approx(table["height"][i], abs=5.001e-9)
        assert found[record["name"]]["height"] == table["height"][i]
        sigma = [table[f"sigma_{a}"][i] for a in ("east", "north", "up")]
        assert found[record["name"]]["sigma_east_north_up"] == sigma
        printed = [float(record[f"sigma_{a}_mm"]) * MM for a in ("east", "north", "up")]
        assert printed == pytest.approx(sigma, rel=1e-8)


def test_a_project_can_be_given_the_latitudes_that_came_out(tmp_path):
    """The columns have the names by which points.csv of a project reads them."""
    s = solution(TOPOCENTRIC)
    write_project(vectors(TOPOCENTRIC), tmp_path / "project.toml")
    write_solution(s, tmp_path / "out")
    columns = ("name", "latitude", "longitude", "height")
    rows = csv.DictReader(io.StringIO((tmp_path / "out" / "points.csv").read_text()))
    lines = [",".join((*columns, "fixed"))]
    lines += [",".join([*(r[c] for c in columns), "xyz" * (r["name"] == "A")]) for r in rows]
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n")
    again = read_project(tmp_path)
    for name, point in again.points.items():
        assert point.coordinates == pytest.approx(s.point(name), abs=1e-8)


def test_a_local_network_has_no_latitudes(tmp_path):
    s = solution(LocalFrame())
    assert "latitude" not in s.point_table()
    assert "Latitude" not in text_report(s)
    write_solution(s, tmp_path)
    assert "latitude" not in (tmp_path / "points.csv").read_text()
    assert "latitude" not in (tmp_path / "results.json").read_text()


@ON_AN_ELLIPSOID
@pytest.mark.parametrize(
    "unit, latitude, longitude",
    [("dms", "46-57-0", "7-26-24"), ("deg", "46.95", "7.44"), ("gon", "52.1666", "8.2666")],
)
def test_tables_have_given_geographic_coordinates_without_the_noise_of_x_y_z(
    frame, unit, latitude, longitude, tmp_path
):
    network = Network("as given", frame=frame)
    at = [parse_quantity(text, unit) for text in (latitude, longitude)]
    for name, height in (("A", 600.0), ("B", 600.5)):
        xyz = GeocentricFrame().ellipsoid.to_cartesian(*(np.array([v]) for v in (*at, height)))
        if isinstance(frame, TopocentricFrame):
            xyz = frame.from_geocentric(xyz)
        network.add_point(name, xyz[0], fixed="xyz" if name == "A" else "")
    a, b = (p.coordinates for p in network.points.values())
    network.add(GnssVector("A", "B", tuple(np.subtract(b, a)), sigma=(MM, MM, MM)))
    write_solution(adjust(network), tmp_path, ReportOptions(Units(geographic=unit)))
    rows = csv.DictReader(io.StringIO((tmp_path / "points.csv").read_text()))
    found = [(r["latitude"], r["longitude"], r["height"]) for r in rows]
    assert found == [(latitude, longitude, "600"), (latitude, longitude, "600.5")]
