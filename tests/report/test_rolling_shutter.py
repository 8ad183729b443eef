"""Motions of photos in text, tables, results for programs and the page: m/s and deg/s."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.html.page import write_report
from factorgraph_adj.report.options import ReportOptions
from factorgraph_adj.report.result_files import write_tables
from factorgraph_adj.report.text import render_text
from tests.networks.rolling_drone import flown, measured

OPTIONS = ReportOptions(units=Units(angle="deg"))


@pytest.fixture(scope="module")
def solution() -> fga.Solution:
    return fga.adjust(measured(flown(3, 1, 160), 1))


def test_velocities_are_in_metres_and_turns_in_degrees_per_second(
    solution: fga.Solution, tmp_path: Path
) -> None:
    found = solution.unknown("photo_motion", "F1")
    values, sigmas = np.array(found.values), np.array(found.sigmas)
    in_units = np.array([1.0] * 3 + [np.degrees(1.0)] * 3)
    write_tables(Report(solution, OPTIONS), tmp_path)
    with (tmp_path / "unknowns.csv").open(encoding="utf-8") as stream:
        rows = [
            r for r in csv.DictReader(stream) if (r["kind"], r["name"]) == ("photo_motion", "F1")
        ]
    assert [r["component"] for r in rows] == ["x_t", "y_t", "z_t", "rx_t", "ry_t", "rz_t"]
    assert [r["unit"] for r in rows] == ["m/s"] * 3 + ["deg/s"] * 3
    np.testing.assert_allclose([float(r["value"]) for r in rows], values * in_units, rtol=1e-9)
    np.testing.assert_allclose([float(r["sigma"]) for r in rows], sigmas * in_units, rtol=1e-6)
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    others = [u for u in results["others"] if (u["kind"], u["name"]) == ("photo_motion", "F1")]
    np.testing.assert_allclose([u["value"] for u in others], values, rtol=1e-9)  # SI
    np.testing.assert_allclose([u["sigma"] for u in others], sigmas, rtol=1e-6)


def test_the_text_says_what_motions_count_from(solution: fga.Solution) -> None:
    text = render_text(Report(solution, OPTIONS))
    assert "motion F1  x_t [m/s]" in text
    assert "motion F1  rz_t [deg/s]" in text
    assert "t of units" not in text


def test_the_page_has_them_in_english_and_german(solution: fga.Solution, tmp_path: Path) -> None:
    pytest.importorskip("jinja2", reason="the extra report is not installed")
    for language, title in (("en", "motion"), ("de", "Bewegung")):
        path = tmp_path / f"{language}.html"
        write_report(solution, path, language=language, options=OPTIONS)  # type: ignore[arg-type]
        page = path.read_text(encoding="utf-8")
        assert f'<td class="">{title}</td><td class="">F1</td><td class="">x_t</td>' in page
        assert page.count('<td class="">m/s</td>') == page.count('<td class="">deg/s</td>') == 9
