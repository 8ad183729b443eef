"""Shapes in the report and in their table."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.quality.derived_quantities import adjusted_shapes
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.frames_and_shapes import shapes_table
from factorgraph_adj.report.options import ReportOptions
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.report.tables import as_html
from tests.networks.hall import hall
from tests.networks.on_shapes import MM, measured, on_shape

LONG = pytest.mark.slow("reports of a whole network of shapes; short tests print single tables")

GON = np.pi / 200


@cache
def solution() -> fga.Solution:
    return fga.adjust(hall())


@cache
def text() -> str:
    return fga.text_report(solution())


def section(words: str, heading: str) -> list[str]:
    """Return the lines of the first section whose heading begins so."""
    lines = words.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(heading))
    return lines[start : lines.index("", start)]


def cells(line: str) -> list[str]:
    return [c.strip() for c in line.split("  ") if c.strip()]


def of_shape(name: str, words: str | None = None) -> tuple[list[str], list[str]]:
    """Return the cells of the two lines of a shape."""
    lines = section(words or text(), "Shapes")
    at = next(i for i, line in enumerate(lines) if line.startswith(f"  {name} "))
    return cells(lines[at]), cells(lines[at + 1])


def test_a_cylinder_stands_with_axis_tilt_azimuth_and_radius() -> None:
    found = {f.name: f for f in adjusted_shapes(solution())}["pipe"]
    values, sigmas = of_shape("pipe")
    assert section(text(), "Shapes")[0] == "Shapes (m, gon; v, σ: mm, mgon)"
    assert values[:2] == ["pipe", "7"]
    assert float(values[2]) == pytest.approx(1e3 * found.largest, rel=5e-3)
    assert np.array(values[3:6], dtype=float) == pytest.approx(found.place, abs=1e-5)
    assert np.array(values[6].split(), dtype=float) == pytest.approx(found.axis, abs=1e-5)
    assert float(values[7]) * GON == pytest.approx(found.tilt, abs=1e-3 * GON)
    assert float(values[8]) * GON == pytest.approx(found.azimuth, abs=1e-2 * GON)
    assert values[9] == "radius 0.59876 m"
    assert sigmas[0] == "cylinder, σ"
    expected = [*1e3 * np.sqrt(np.diag(found.covariance))]
    expected += [1e3 * found.sigma_tilt / GON, 1e3 * found.sigma_azimuth / GON]
    expected += [1e3 * found.sizes[0].sigma]
    figures = [*sigmas[1:-1], sigmas[-1].removesuffix(" mm")]
    assert np.array(figures, dtype=float) == pytest.approx(expected, rel=5e-3)


def test_a_sphere_has_no_axis() -> None:
    values, sigmas = of_shape("ball")
    assert len(values) == 7
    assert values[-1] == "radius 0.7989 m"
    assert len(sigmas) == 5


def test_a_shape_stands_in_no_other_table() -> None:
    frames = section(text(), "Frames")
    assert not any(line.startswith(f"  {n} ") for line in frames for n in ("floor", "pipe", "ball"))
    assert "size pipe" not in text()
    assert section(text(), "Distance meters, level, mount")


@LONG
def test_a_frame_of_shapes_alone_makes_no_table_of_frames() -> None:
    words = fga.text_report(fga.adjust(measured("torus", 1)))
    assert "\nFrames\n" not in words
    values, _ = of_shape("S", words)
    assert [v.split()[0] for v in values[-2:]] == ["radius", "ring"]


def test_a_frame_counts_its_places_and_not_its_observations() -> None:
    """The tracker of the hall has three readings to each of fourteen points, and one to others."""
    network = solution().network
    lines = section(text(), "Frames")
    for name in ("scan", "tracker", "model"):
        own = [ob.points() for ob in network.observations.values() if ob.frames() == (name,)]
        words = cells(next(line for line in lines if line.startswith(f"  {name} ")))
        assert int(words[3]) == len(set(own))
    assert len([1 for ob in network.observations.values() if ob.frames() == ("tracker",)]) > 35


def test_what_is_held_is_told_and_what_is_open_is_not_shown_as_a_number() -> None:
    x = np.array([[np.cos(t), np.sin(t), float(t)] for t in range(8)])
    network = on_shape("cylinder", x, level=True, free=("x", "y"), origin=(0.0, 0.0, 0.0))
    values, sigmas = of_shape("S", fga.text_report(fga.adjust(network)))
    assert values[6] == "0.00000 0.00000 1.00000"
    assert values[7] == "0.0000"  # the tilt, and no azimuth
    assert values[8].startswith("radius")
    assert sigmas[3:5] == ["–", "held"]


def test_an_azimuth_that_is_not_known_is_not_shown() -> None:
    """A floor within the noise of the horizon: its normal may point anywhere."""
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.uniform(0, 0.01, (6, 2)), np.zeros(6)])
    network = on_shape("plane", x, origin=(0.0, 0.0, 0.0))
    values, _ = of_shape("S", fga.text_report(fga.adjust(network)))
    assert len(values) == 8  # up to the tilt


def test_the_table_brings_every_figure_back(tmp_path) -> None:
    s = solution()
    write_solution(s, tmp_path)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "shapes.csv").read_text("utf-8"))))
    for row, f in zip(rows, adjusted_shapes(s), strict=True):
        assert (row["name"], row["shape"], int(row["points"])) == (f.name, f.shape, f.points)
        place = [float(row[a]) for a in "xyz"]
        assert place == pytest.approx(f.place, rel=1e-14, abs=1e-15)
        sigmas = [float(row[f"sigma_{a}_mm"]) for a in "xyz"]
        assert sigmas == pytest.approx(1e3 * np.sqrt(np.diag(f.covariance)), rel=1e-8)
        assert float(row["largest_mm"]) == pytest.approx(1e3 * f.largest, rel=1e-8)
        if f.shape == "sphere":
            assert row["axis_x"] == row["tilt_gon"] == ""
        else:
            assert float(row["axis_z"]) == pytest.approx(f.axis[2], rel=1e-8)
            assert float(row["tilt_gon"]) * GON == pytest.approx(f.tilt, rel=1e-8)
        for size in f.sizes:
            assert (row["size"], row["unit_of_value"]) == (size.attribute, "m")
            assert float(row["value"]) == pytest.approx(size.value, rel=1e-14)
            assert float(row["sigma_value"]) == pytest.approx(size.sigma, rel=1e-8)


def test_the_table_is_in_the_units_that_are_asked_for(tmp_path) -> None:
    s = fga.adjust(measured("cone", 1))
    (f,) = adjusted_shapes(s)
    units = replace(Units(angle="deg"), length="mm", sigma_length="um")
    write_solution(s, tmp_path, ReportOptions(units=units))
    (row,) = csv.DictReader(io.StringIO((tmp_path / "shapes.csv").read_text("utf-8")))
    assert float(row["x"]) == pytest.approx(1e3 * f.place[0], rel=1e-13)
    assert float(row["sigma_x_um"]) == pytest.approx(1e6 * f.covariance[0, 0] ** 0.5, rel=1e-8)
    assert (row["size"], row["unit_of_value"]) == ("angle", "deg")
    assert float(row["value"]) == pytest.approx(np.degrees(f.sizes[0].value), rel=1e-13)


def test_a_page_has_what_the_text_has_of_a_shape() -> None:
    sheet = as_html(shapes_table(Report(solution())), Texts("de"))
    assert sheet is not None
    cells = dict(zip((c.title for c in sheet.columns), zip(*sheet.first, strict=True), strict=True))
    values, sigmas = of_shape("pipe")
    at = cells["Form"].index("pipe")
    assert cells["Art"][at] == "Zylinder"
    for title, value in zip(("X [m]", "Y [m]", "Z [m]", "Achse"), values[3:7], strict=True):
        assert cells[title][at] == value
    assert cells["Neigung [gon]"][at] == values[7]
    assert cells["Größe"][at] == values[9]
    assert cells["σ X [mm]"][at] == sigmas[1]


def test_networks_without_shapes_have_no_table(tmp_path) -> None:
    network = fga.Network("line")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (1, 0, 0), fixed="yz")
    network.add(
        fga.SlopeDistance("A", "B", 1.0, sigma=MM), fga.SlopeDistance("A", "B", 1.0, sigma=MM)
    )
    write_solution(fga.adjust(network), tmp_path)
    assert not (tmp_path / "shapes.csv").exists()
