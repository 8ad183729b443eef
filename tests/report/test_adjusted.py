"""The run, weighted coordinates, adjusted observations by station, and adjusted lines."""

from __future__ import annotations

import csv
import io
import json
from functools import cache

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, Direction, HeightDifference, SlopeDistance
from factorgraph_adj.quality.derived_quantities import adjusted_lines, observed_pairs
from factorgraph_adj.quality.error_ellipses import error_ellipse, height_interval
from factorgraph_adj.quality.point_precision import distance_precision
from factorgraph_adj.report.options import Provenance, ReportOptions, Run
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.report.text import text_report
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.units import CC, TURN
from tests.networks.small_block import small_block
from tests.support.printed import assert_printed, row, section

MM, MGON = 1e-3, 10 * CC
BY_STATION = "Adjusted observations, station by station"
WEIGHTED = "Weighted coordinates"
LINES = "Adjusted lines, from mark to mark"


@cache
def square() -> Solution:
    """Adjust a square of distances and directions, with a weighted and an observed control."""
    network = Network("square")
    for name, at in {"A": (0, 0, 0), "B": (100, 0, 1), "C": (100, 80, 2), "D": (0, 80, 3)}.items():
        network.add_point(name, at, fixed="xyz" if name == "A" else "")
    network.points.pop("B")
    network.add_point("B", (100.0, 0.0, 1.0), sigma=(0.002, 0.003, 0.004))
    for a, b in ("AB", "BC", "CD", "DA", "AC", "BD"):
        network.add(SlopeDistance(a, b, 1.0, sigma=0.002), HeightDifference(a, b, 0, sigma=0.001))
        network.add(Direction(a, b, 0.0, sigma=5 * CC), Direction(b, a, 0.0, sigma=5 * CC))
    network.add(ControlPoint("C", (100.0, 80.0, 2.0), sigma=(0.005, 0.006, 0.007)))
    for station in "ABCD":
        network.set_orientation(station, value=0.001)
    return adjust(measure(network, seed=7))


def test_every_observation_stands_under_its_station_with_its_correction():
    s = square()
    rows = section(text_report(s), BY_STATION)[2:-1]
    shown = {}
    station = ""
    for words in rows:
        if words[0] in "ABCD" and words[1] in "ABCD":
            station, words = words[0], words[1:]
        shown.setdefault((station, words[0], words[1]), words)
    of = {(o.station, o.target, o.kind.split("_")[0]): i for i, o in _sights(s)}
    assert set(shown) == set(of)
    for key, ident in of.items():
        record = s.observations[s.observations.row(ident)]
        words = shown[key][2 + (key[2] != "direction") - 0 :]
        turned, size = (MGON * 1000, MGON) if key[2] == "direction" else (1.0, MM)
        observed, v, adjusted = words[0], words[2], words[4]
        assert_printed(observed, record.observed / turned)
        assert_printed(v, record.residual / size)
        total = record.observed + record.residual
        assert_printed(adjusted, (total % TURN if key[2] == "direction" else total) / turned)


def _sights(s: Solution):
    return [(i, o) for i, o in s.network.observations.items() if o.kind != "control"]


def test_an_adjusted_direction_lies_in_the_first_turn(tmp_path):
    """Directions to a target near zero are adjusted across it."""
    s = square()
    write_solution(s, tmp_path)
    for record in csv.DictReader(io.StringIO((tmp_path / "observations.csv").read_text())):
        adjusted = float(record["adjusted"])
        scale = {"mm": 1000.0, "mgon": 1000.0}[record["small_unit"]]
        expected = float(record["observed"]) + float(record["residual"]) / scale
        if record["kind"] == "direction":
            assert 0.0 <= adjusted < 400.0
            expected %= 400.0
        assert adjusted == pytest.approx(expected, abs=1e-8)


def test_weighted_coordinates_show_given_value_correction_and_both_sigmas():
    s = square()
    rows = {(w[0], w[1]): w for w in section(text_report(s), WEIGHTED)[2:]}
    for i, axis in enumerate("xyz"):
        words = rows["B", axis]
        given = s.network.points["B"]
        found = s.point("B")[i]
        assert_printed(words[2], given.coordinates[i])
        assert_printed(words[3], (found - given.coordinates[i]) / MM)
        assert_printed(words[4], found)
        assert_printed(words[5], given.sigma[i] / MM)
        assert_printed(words[6], s.standard_deviations("B")[i] / MM)
        words = rows["C", axis]
        assert words[2] == "(control)"
        assert_printed(words[7], s.standard_deviations("C")[i] / MM)


def test_a_line_has_the_figures_of_its_parts():
    """Distance, ellipse and height difference are those of the functions for each of them."""
    s = square()
    lines = adjusted_lines(s)
    assert [(x.a, x.b) for x in lines] == [tuple(p) for p in ("AB", "BC", "CD", "DA", "AC", "BD")]
    for x in lines:
        d = distance_precision(s, x.a, x.b)
        assert (x.distance, x.sigma_distance) == pytest.approx((d.distance, d.sigma))
        e = error_ellipse(s, x.a, x.b)
        assert (*x.ellipse.semi_axes, x.ellipse.azimuth) == pytest.approx((*e.semi_axes, e.azimuth))
        h = height_interval(s, x.a, x.b)
        assert x.sigma_rise == pytest.approx(h.sigma)
        delta = s.point(x.b) - s.point(x.a)
        assert x.rise == pytest.approx(delta[2])
        assert x.azimuth == pytest.approx(np.arctan2(delta[0], delta[1]) % TURN)


def test_sigma_of_an_azimuth_is_that_of_its_partials():
    """Numerical partials of atan2 by both points, with their joint covariance."""
    s = square()
    (line,) = adjusted_lines(s, [("B", "D")])
    both = s.covariance(["B", "D"])
    at = np.concatenate([s.point("B"), s.point("D")])

    def azimuth(x):
        return np.arctan2(x[3] - x[0], x[4] - x[1])

    step = 1e-3
    g = [(azimuth(at + step * u) - azimuth(at - step * u)) / (2 * step) for u in np.eye(6)]
    assert line.sigma_azimuth == pytest.approx(np.sqrt(g @ both @ g), rel=1e-6)


def test_a_plumb_line_has_no_azimuth_and_held_points_no_line():
    network = Network("plumb")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (0, 0, 5), fixed="xy")
    network.add_point("H", (9, 0, 0), fixed="xyz")
    network.add(HeightDifference("A", "B", 5.0, sigma=0.001))
    network.add(HeightDifference("A", "H", 0.0, sigma=0.001))
    network.add(HeightDifference("B", "H", -5.001, sigma=0.001))
    assert observed_pairs(network) == [("A", "B"), ("B", "H")]
    s = adjust(network)
    plumb, _ = adjusted_lines(s)
    assert np.isnan([plumb.azimuth, plumb.sigma_azimuth]).all()
    text = text_report(s, ReportOptions(relative="observed"))
    assert "azimuth [gon]" not in text, "only heights are unknown"
    assert row(text, LINES, "B")[1] == "H"


def test_lines_stand_in_the_report_the_table_and_the_file_for_programs(tmp_path):
    s = square()
    options = ReportOptions(relative=[("A", "C"), ("B", "D")], confidence=0.95)
    lines = adjusted_lines(s, options.relative, confidence=0.95)
    words = row(text_report(s, options), LINES, "B")
    assert_printed(words[2], lines[1].distance)
    assert_printed(words[5], lines[1].azimuth / (1000 * MGON))
    assert_printed(words[9], lines[1].ellipse.semi_axes[0] / MM)
    write_solution(s, tmp_path, options)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "relative.csv").read_text())))
    assert [(r["from"], r["to"]) for r in rows] == [("A", "C"), ("B", "D")]
    assert float(rows[1]["azimuth_gon"]) == pytest.approx(lines[1].azimuth / (1000 * MGON))
    assert float(rows[1]["ellipse_minor_mm"]) == pytest.approx(lines[1].ellipse.semi_axes[1] / MM)
    found = json.loads((tmp_path / "results.json").read_text())["relative"]
    assert found[1]["sigma_azimuth"] == lines[1].sigma_azimuth
    assert found[1]["ellipse"]["confidence"] == 0.95
    write_solution(s, tmp_path)
    assert not (tmp_path / "relative.csv").exists()


def test_a_line_may_end_at_a_projection_centre():
    s = adjust(small_block())
    (line,) = adjusted_lines(s, [("S1", ("pose", "F1"))])
    assert line.distance == pytest.approx(np.linalg.norm(s.pose("F1").position - s.point("S1")))
    with pytest.raises(InputError, match="unknown point 'nobody'"):
        adjusted_lines(s, [("S1", "nobody")])


# -- the run --------------------------------------------------------------------------------------


def test_a_report_opens_with_what_is_said_of_the_run():
    run = Run("square.toml", "2026-01-02 10:20", "--snoop")
    lines = text_report(square(), provenance=Provenance(run=run)).splitlines()
    said = [line.split(maxsplit=1) for line in lines[2:6]]
    assert [name for name, _ in said] == ["program", "file", "date", "options"]
    assert [text for _, text in said[1:]] == ["square.toml", "2026-01-02 10:20", "--snoop"]


def test_the_library_looks_at_no_clock():
    assert text_report(square()) == text_report(square())
    assert "  date " not in text_report(square())


PROJECT = {
    "project.toml": 'name = "loop"\ndimension = 1\n[adjust]\nvariance = "a-posteriori"\n',
    "points.csv": "name,z,fixed\nA,0,z\nB,1,\nC,2,\n",
    "observations.csv": "kind,station,target,value,sigma_mm\n"
    "height_difference,A,B,1.0002,1\nheight_difference,B,C,0.9999,1\n"
    "height_difference,C,A,-2.0004,1\n",
}


@pytest.fixture
def project(tmp_path, monkeypatch):
    for name, text in PROJECT.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def printed(capsys, *arguments: str, code: int = 0) -> tuple[str, str]:
    """Run the command, check its exit code, and return what it prints."""
    assert main(["adjust", "project.toml", *arguments]) == code
    return capsys.readouterr()


def test_the_command_says_file_date_and_options(project, capsys):
    text = printed(capsys, "--full", "--date", "2026-01-02", "--alpha", "0.01").out
    assert "  file           project.toml\n" in text
    assert "  date           2026-01-02\n" in text
    assert "--alpha 0.01; of the project: variance a-posteriori" in text
    out = printed(capsys, "--full", "--date", "none", "--out", "out").out
    assert "  date " not in out
    assert "date" not in json.loads((project / "out" / "results.json").read_text())["run"]
    assert "  date           20" in printed(capsys, "--full").out


def test_the_command_lists_lines_between_all_or_two_points(project, capsys):
    every = printed(capsys, "--full", "--relative").out
    assert [w[:2] for w in section(every, LINES)[2:5]] == [["A", "B"], ["B", "C"], ["C", "A"]]
    one = printed(capsys, "--full", "--between", "C,B").out
    assert [w[:2] for w in section(one, LINES)[2:3]] == [["C", "B"]]
    refused = printed(capsys, "--between", "C,X", "--between", "C", code=2).err
    assert "--between C,X: unknown 'X'; known: A, B, C" in refused
    assert "--between C: needs two places" in refused
    both = printed(capsys, "--between", "C,B", "--relative", code=2).err
    assert "--relative lists all pairs" in both
