"""The page of a report: what it says is what the solution and its tables say, and nothing else."""

import csv
import hashlib
import io
import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.adjusted_observations import observations_csv
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.html.page import adjustment_html, write_report
from factorgraph_adj.report.html.rendering import ROWS_PER_PAGE
from factorgraph_adj.report.html.verdict import adjustment_verdict
from factorgraph_adj.report.text import render_text
from tests.networks.reported import NASTY, heights_alone, nasty_names, three_points
from tests.networks.small_block import small_block
from tests.support.pages import data_of, elements
from tests.support.places import EXAMPLES, ROOT

LONG = pytest.mark.slow("pages of many solutions; short tests make those of one")

EN = Texts("en")


@cache
def industry() -> Report:
    solution = fga.adjust(fga.read_project(EXAMPLES / "industry_block"))
    return Report(solution, fga.ReportOptions(confidence=0.95, relative="observed"))


@cache
def page(language: str = "en") -> str:
    return adjustment_html(industry(), language=language, files=[EXAMPLES / "industry_block"])


@cache
def spoiled() -> Report:
    """The industry block with a gross error, as adjusted, not snooped."""
    network = fga.read_project(EXAMPLES / "industry_block")
    network.images.columns()[2][7] += 0.05
    return Report(fga.adjust(network))


@cache
def snooped() -> Report:
    network = spoiled().network
    found = fga.snoop(network)
    return Report(found.solution, provenance=fga.Provenance(found, network))


def column(text: str, sheet: str, title: str) -> list[str]:
    """Return a column of a table from the packed data, by its heading."""
    table = next(e for e in elements(text) if e.attributes.get("id") == f"table-{sheet}")
    found = [e for e in elements(text) if e.tag in ("table", "th")]
    start = next(i for i, e in enumerate(found) if e.attributes == table.attributes)
    heads = []
    for e in found[start + 1 :]:
        if e.tag == "table":
            break
        heads.append(e.text)
    return data_of(text, f"sheet-{sheet}")["columns"][heads.index(title)]


def test_the_tables_hold_every_row_with_the_figures_of_the_solution():
    text, solution = page(), industry().solution
    assert column(text, "points", "point") == list(solution.network.points)
    x = np.array(column(text, "points", "x [m]"), dtype=float)
    np.testing.assert_allclose(x, solution.state["point"][:, 0], atol=0.5e-5)
    sigmas = column(text, "points", "σx [mm]")
    for name, shown in zip(solution.network.points, sigmas, strict=True):
        sigma = 1e3 * solution.standard_deviations(name)[0]
        assert shown == "held" if sigma == 0 else abs(float(shown) - sigma) <= 0.005
    assert len(column(text, "observations", "v")) == solution.n_observations


def test_observations_are_those_of_the_csv_table():
    text = page()
    rows = list(csv.DictReader(io.StringIO(observations_csv(industry()))))
    for title, name in (("v", "residual"), ("r", "redundancy_number"), ("w", "w"), ("∇", "mdb")):
        shown = np.array(column(text, "observations", title), dtype=float)
        known = np.array([float(r[name]) for r in rows])
        # Three significant digits, or two decimals.
        np.testing.assert_allclose(shown, known, rtol=0.005, atol=0.00501)
    observed = np.array(column(text, "observations", "observed"), dtype=float)
    np.testing.assert_allclose(observed, [float(r["observed"]) for r in rows], atol=0.6e-4)


def test_the_page_has_the_first_rows_of_each_table_without_a_script():
    found = elements(page())
    names = [e.attributes["data-sheet"] for e in found if "data-sheet" in e.attributes]
    assert {"groups", "worst", "points", "check", "photos", "observations", "lines"} <= set(names)
    cells = [e for e in found if e.tag == "td"]
    assert len(cells) > 1000
    rows = data_of(page(), "sheet-observations")["columns"]
    for shown, whole in zip(rows, rows, strict=True):
        assert shown[:ROWS_PER_PAGE] == whole[:ROWS_PER_PAGE]
    assert f"The first {ROWS_PER_PAGE} of {industry().solution.n_observations} rows." in page()


def test_the_same_call_gives_the_same_file():
    again = adjustment_html(
        Report(industry().solution, industry().options), files=[EXAMPLES / "industry_block"]
    )
    assert again == page()


def test_nothing_is_asked_of_a_network():
    text = page()
    for e in elements(text):
        for name in ("src", "href", "action", "data", "srcset"):
            if name in e.attributes:
                assert e.attributes[name].startswith(("#", "data:")), e
    policy = next(e for e in elements(text) if "http-equiv" in e.attributes)
    assert policy.attributes["content"].startswith("default-src 'none'")
    assert "http" not in policy.attributes["content"]


def test_the_input_files_have_the_hashes_of_their_bytes():
    folder = EXAMPLES / "industry_block"
    names, digests = (column(page(), "files", t) for t in ("file", "SHA-256"))
    assert names == [str(p) for p in sorted(folder.iterdir()) if p.is_file()]
    for name, digest in zip(names, digests, strict=True):
        assert digest == hashlib.sha256(Path(name).read_bytes()).hexdigest()


# -- verdict --------------------------------------------------------------------------------------


@LONG
def test_a_good_result_is_green_and_a_doubtful_one_red_as_in_the_report():
    assert adjustment_verdict(industry(), EN).colour == "green"
    assert adjustment_verdict(snooped(), EN).colour == "amber"
    assert adjustment_verdict(spoiled(), EN).colour == "red"
    for report in (industry(), snooped(), spoiled()):
        doubtful = "DOUBTFUL RESULT" in fga.text_report(
            report.solution, report.options, report.provenance
        )
        assert (adjustment_verdict(report, EN).colour == "red") == doubtful


def test_a_light_says_how_many_test_values_are_above_the_critical_one():
    rel = fga.reliability(spoiled().solution)
    above = int(np.sum(np.abs(rel.w) > rel.critical_w))
    light = next(x for x in adjustment_verdict(spoiled(), EN).lights if x.title == "Test values")
    assert light.colour == "red" and light.text.startswith(f"{above} observation")
    text = adjustment_html(spoiled())
    assert f"of {above} test values above" in text or f"{above} of {above} test values" in text


def test_the_worst_observation_is_the_spoiled_one_with_its_error():
    kinds = column(adjustment_html(spoiled()), "worst", "observation")
    errors = column(adjustment_html(spoiled()), "worst", "estimated error")
    assert kinds[0].startswith("photo 1/P12")
    assert abs(abs(float(errors[0])) - 50.0) < 4 * 7.25


def test_what_was_set_aside_stands_in_its_table_and_in_the_plan():
    text = adjustment_html(snooped())
    (what,) = column(text, "rejected", "observation")
    assert what.startswith("photo 1/P12")
    (aside,) = data_of(text, "plan")["aside"]
    assert aside["id"] == "photo 1/P12" and len(aside["lines"]) == 1
    assert "1 observation rejected." in text


def test_an_iteration_that_did_not_end_is_said_first():
    solution = fga.adjust(fga.read_project(EXAMPLES / "industry_block"), max_iterations=1)
    found = adjustment_verdict(Report(solution), EN)
    assert found.colour == "red" and found.lights[0].colour == "red"
    assert found.lights[0].told == solution.reason


def test_observations_that_nothing_controls_are_counted():
    network = fga.Network("line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (0.0, 0.0, 1.0), fixed="xy")
    network.add(fga.HeightDifference("A", "B", 1.0, sigma=0.001))
    report = Report(fga.adjust(network))
    colours = {x.title: x.colour for x in adjustment_verdict(report, EN).lights}
    assert colours["Global test"] == "amber" and colours["Controlled observations"] == "amber"
    assert adjustment_html(report)


@pytest.mark.parametrize(("sigma_mm", "colour"), [(5.0, "green"), (30.0, "amber")])
def test_control_in_name_only_is_no_praise(sigma_mm: float, colour: str) -> None:
    """Redundancy numbers of two levellings are σ² shares: 1/26 and 1/901 of the precise one."""
    network = fga.Network("two levellings")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (0.0, 0.0, 1.0), fixed="xy")
    network.add(fga.HeightDifference("A", "B", 1.0, sigma=0.001))
    network.add(fga.HeightDifference("A", "B", 1.001, sigma=1e-3 * sigma_mm))
    report = Report(fga.adjust(network))
    (light,) = (
        x for x in adjustment_verdict(report, EN).lights if x.title == "Controlled observations"
    )
    assert light.colour == colour
    assert ("0.0385" if colour == "green" else "redundancy number of 0.00111") in light.text
    said = " ".join(render_text(report).split())
    hardly = "hardly controlled, r < 0.01 (1 scalar observation): smallest detectable errors above"
    assert (f"{hardly} 41 σ; smallest r: height difference A B 0.00111" in said) == (
        colour == "amber"
    )


# -- plan -----------------------------------------------------------------------------------------


def test_the_ellipses_of_the_plan_are_those_of_the_library():
    drawn = data_of(page(), "plan")["points"]
    report = industry()
    a, b, direction = (np.array(v, dtype=float) for v in drawn["ellipses"])
    for i, name in enumerate(drawn["names"]):
        e = fga.error_ellipse(report.solution, name, confidence=0.95)
        np.testing.assert_allclose((a[i], b[i]), e.semi_axes, rtol=1e-3, atol=1e-9)
        if e.semi_axes[0] > 1.01 * e.semi_axes[1]:
            turned = (np.pi / 2 - e.azimuth - direction[i]) / np.pi
            assert abs(turned - round(turned)) < 1e-3


def test_the_plan_marks_the_observations_above_the_critical_value():
    report = spoiled()
    rel, drawn = fga.reliability(report.solution), data_of(adjustment_html(report), "plan")
    rows = [d["row"] for d in drawn["doubts"]]
    assert sorted(rows) == np.flatnonzero(np.abs(rel.w) > rel.critical_w).tolist()
    assert drawn["doubtful"] and not data_of(page(), "plan")["doubtful"]


def test_heights_alone_are_drawn_as_heights():
    report = Report(fga.adjust(heights_alone()))
    text = adjustment_html(report)
    drawn = data_of(text, "plan")
    assert drawn["schematic"] and max(drawn["points"]["height"]) > 0
    assert drawn["points"]["xy"][1] == np.round(report.solution.state["point"][:, 2], 4).tolist()
    assert "data-scene" not in text


def test_a_point_has_the_largest_test_value_of_its_observations():
    drawn = data_of(page(), "plan")["points"]
    solution = industry().solution
    rel, largest = fga.reliability(solution), dict.fromkeys(drawn["names"], 0.0)
    for row in industry().rows.all():
        for name in row.points:
            largest[name] = max(largest[name], abs(float(rel.w[row.number])))
    for name, shown in zip(drawn["names"], drawn["test"], strict=True):
        assert shown == pytest.approx(largest[name], rel=1e-3)


# -- names ----------------------------------------------------------------------------------------


def test_names_are_text_wherever_they_stand():
    text = adjustment_html(Report(fga.adjust(nasty_names())))
    found = elements(text)
    scripts = [e.attributes.get("type") for e in found if e.tag == "script"]
    assert set(scripts) == {"application/json", "text/plain", "module"}
    assert scripts.count("module") == 1
    assert not [e for e in found if e.tag in ("b", "i")]
    cells = {e.text for e in found if e.tag == "td"}
    assert set(NASTY) <= cells
    assert column(text, "points", "point") == ["BM", *NASTY]
    assert next(e for e in found if e.tag == "title").text.endswith("alert('name')</script>")


# -- errors and files -----------------------------------------------------------------------------


def test_without_the_extra_the_error_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setattr(
        "factorgraph_adj.report.html.rendering.find_spec", lambda n: None if n == "plotly" else n
    )
    with pytest.raises(fga.InputError, match=r"plotly.*pip install 'factorgraph_adj\[report\]'"):
        write_report(industry().solution, tmp_path / "r.html")
    assert not list(tmp_path.iterdir())


def test_an_unknown_language_is_refused(tmp_path):
    with pytest.raises(fga.InputError, match="unknown language 'fr'; valid: en, de"):
        write_report(industry().solution, tmp_path / "r.html", language="fr")


def test_input_files_that_are_not_there_are_told_all_at_once(tmp_path):
    with pytest.raises(fga.InputError) as caught:
        write_report(industry().solution, tmp_path / "r.html", files=["no1.txt", "no2.txt"])
    assert "no1.txt" in str(caught.value) and "no2.txt" in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_the_file_is_written_and_replaced_whole(tmp_path):
    solution = fga.adjust(three_points())
    file = tmp_path / "new" / "report.html"
    fga.write_report(solution, file, language="de")
    first = file.read_text(encoding="utf-8")
    assert '<html lang="de">' in first
    fga.write_report(solution, file)
    assert '<html lang="en">' in file.read_text(encoding="utf-8")
    assert [p.name for p in file.parent.iterdir()] == ["report.html"]
    with pytest.raises(fga.InputError, match="cannot be written"):
        fga.write_report(solution, file / "below.html")


def test_a_small_network_makes_a_small_file():
    assert len(adjustment_html(Report(fga.adjust(three_points())))) < 2.5e6


def test_every_file_of_the_page_goes_into_the_wheel():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (globs,) = re.findall(r"^factorgraph_adj = \[(.*)\]$", text, re.MULTILINE)
    kept = {p for g in re.findall(r'"([^"]+)"', globs) for p in (ROOT / "factorgraph_adj").glob(g)}
    folder = ROOT / "factorgraph_adj" / "report" / "html" / "template"
    assert {p for p in folder.rglob("*") if p.is_file()} <= kept


@LONG
def test_reports_of_other_solutions_are_made_too():
    """A-posteriori σ, a combined block with stations and check points, a solution read back."""
    network = small_block()
    for variance in ("a-priori", "a-posteriori"):
        text = adjustment_html(Report(fga.adjust(network, variance=variance)))
        name = "w" if variance == "a-priori" else "τ"
        assert column(text, "observations", name)
        assert column(text, "orientations", "station")
    report = Report(fga.adjust(network))
    units = replace(report.options.units, length="mm", angle="dms", sigma_length="um")
    text = adjustment_html(replace(report, options=replace(report.options, units=units)))
    assert column(text, "points", "x [mm]")
