"""The page of two epochs says what the comparison found, in both languages, and in a browser."""

from __future__ import annotations

import re

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.epochs_report import EpochsReport
from factorgraph_adj.report.html.epochs_page import epochs_html
from factorgraph_adj.report.html.verdict import epochs_verdict
from tests.networks import moved
from tests.support.pages import chromium, data_of, elements, opened

LONG = pytest.mark.slow(
    "clicks in a browser on the page of two epochs; short tests read the page as text"
)

EN, DE = Texts("en"), Texts("de")


def plan_report():
    return EpochsReport(moved.in_plan(), (moved.block(),))


@pytest.fixture(scope="module")
def page():
    return epochs_html(plan_report())


def lights(found, *blocks):
    """Return colours by title."""
    verdict = epochs_verdict(EpochsReport(found, blocks), EN)
    return verdict.colour, {light.title: light.colour for light in verdict.lights}


def test_the_verdict_has_the_colour_of_what_was_found():
    whole, each = lights(moved.kept())
    assert whole == "green"
    assert each["Reference points"] == each["Displacements"] == each["Variances"] == "green"
    whole, each = lights(moved.in_plan(), moved.block())
    assert whole == "amber"
    assert each["Reference points"] == each["Displacements"] == "amber"
    whole, each = lights(moved.doubtful())
    assert whole == "red"
    assert each["Variances"] == "red"
    assert each["Global tests"] == "amber"
    spoiled = fga.congruence(*moved.doubtful().solutions, objects=["P", "Q"], variance="a-priori")
    assert lights(spoiled)[1]["Global tests"] == "red"
    stopped = [fga.adjust(s.network, max_iterations=1) for s in moved.kept().solutions]
    if not all(s.converged for s in stopped):
        assert lights(fga.congruence(*stopped, objects=["P", "Q"]))[1]["Iteration"] == "red"


def test_the_verdict_tells_the_figures():
    verdict = epochs_verdict(plan_report(), EN)
    told = " ".join(light.text for light in verdict.lights)
    found = moved.in_plan()
    assert "3 points moved" in verdict.text
    assert "Without B the others kept theirs." in told
    assert f"T = {found.global_test.value:.2f}" in told
    assert f"{1000 * found.displacement('B').length:.1f} mm (B)" in told
    best = min(x.detectable for x in found.displacements.values() if not x.stable)
    assert f"{1000 * best:.2f} mm" in told
    assert "P, Q: moved as a block (rigid)." in told


def column(text, sheet, title):
    """Return a column of a table from the packed data, by its heading."""
    found = elements(text)
    at = next(i for i, e in enumerate(found) if e.attributes.get("id") == f"table-{sheet}")
    heads = []
    for e in found[at + 1 :]:
        if e.tag == "table":
            break
        if e.tag == "th":
            heads.append(e.text.split(" [")[0])
    return data_of(text, f"sheet-{sheet}")["columns"][heads.index(title)]


def test_the_tables_have_the_comparison(page):
    found = moved.in_plan()
    every = list(found.displacements.values())
    assert column(page, "displacements", "point") == [x.name for x in every]
    assert column(page, "displacements", "T") == [f"{x.test.value:.2f}" for x in every]
    assert [float(v) for v in column(page, "displacements", "dx")] == pytest.approx(
        [1000 * x.vector[0] for x in every], abs=0.0051
    )
    assert [float(v) for v in column(page, "displacements", "detectable")] == pytest.approx(
        [1000 * x.detectable for x in every], abs=0.0051
    )
    assert column(page, "steps", "T") == [f"{s.test.value:.2f}" for s in found.steps]
    assert column(page, "steps", "points tested") == ["5", "4"]
    assert column(page, "motions", "parameter") == list(moved.block().names)
    assert column(page, "ratio", "critical") == [f"{found.ratio.critical:.3f}"]
    assert column(page, "adjustments", "σ̂0") == [f"{s.sigma0:.4f}" for s in found.solutions]
    affine, motion = moved.strained()
    text = epochs_html(EpochsReport(affine, (motion,)))
    assert [float(v) for v in column(text, "strains", "strain")] == pytest.approx(
        1e6 * motion.principal_strains()[0], abs=0.0051
    )


def test_the_plan_has_the_displacements(page):
    plan, found = data_of(page, "plan"), moved.in_plan()
    every = list(found.displacements.values())
    assert plan["points"]["names"] == [x.name for x in every]
    assert (
        pytest.approx(np.array([x.vector[:2] for x in every]), rel=1e-3)
        == np.array(plan["points"]["vectors"]).T
    )
    assert plan["points"]["moved"] == [x.moved for x in every]
    assert [s["name"] for s in plan["shapes"]] == ["block", "block after its common motion"]


def test_pages_of_heights_and_of_space_are_made():
    for found, schematic in (
        (moved.heights(), False),
        (moved.heights(plan=False), True),
        (moved.in_space(), False),
        (moved.in_space(geocentric=True), False),
    ):
        plan = data_of(epochs_html(EpochsReport(found)), "plan")
        assert plan["schematic"] == schematic
        assert len(plan["points"]["vectors"][0]) == 7


def test_a_german_page_is_german():
    text = epochs_html(plan_report(), language="de")
    found = elements(text)
    assert found[0].attributes["lang"] == "de"
    assert "Zwei Epochen: epoch 20 bis epoch 21" in text
    own = [e for e in found if e.tag in ("h2", "th", "caption", "dt", "button", "figcaption")]
    english = set(re.findall(r"\w+", "the of and is point moved displacement displacements with"))
    for e in own:
        assert not set(re.findall(r"[a-zäöüß]+", e.text.lower())) & english, e


def test_write_report_takes_a_comparison(tmp_path):
    file = tmp_path / "moved.html"
    options = fga.ReportOptions(confidence=0.9)
    how = {"blocks": [moved.block()], "options": options}
    fga.write_report(moved.in_plan(), file, **how)
    text = file.read_text(encoding="utf-8")
    assert data_of(text, "plan")["level"] == "90 %"
    fga.write_report(
        moved.in_plan(), tmp_path / "again.html", blocks=[moved.block()], options=options
    )
    assert (tmp_path / "again.html").read_bytes() == file.read_bytes()
    with pytest.raises(InputError, match="blocks belong to the report of two epochs"):
        fga.write_report(moved.in_plan().solutions[0], file, blocks=[moved.block()])


@LONG
def test_a_click_on_a_displacement_shows_its_row(tmp_path):
    file = tmp_path / "moved.html"
    fga.write_report(moved.in_plan(), file, blocks=[moved.block()])
    number = list(moved.in_plan().displacements).index("Q")
    tip = """(div, i) => {
      const trace = div.data.find(t => t.name.startsWith("significant displacement"));
      const at = trace.customdata.indexOf(i) + 1;
      const {xaxis, yaxis} = div._fullLayout, box = div.getBoundingClientRect();
      return [box.x + xaxis._offset + xaxis.l2p(trace.x[at]),
        box.y + yaxis._offset + yaxis.l2p(trace.y[at])];
    }"""
    with chromium() as browser, opened(browser, file, color_scheme="dark") as found:
        found.ready()
        found.page.evaluate("document.getElementById('plan').scrollIntoView({behavior: 'instant'})")
        x, y = found.page.eval_on_selector("#plan", tip, number)
        found.page.mouse.move(x - 3, y)
        found.page.mouse.move(x, y)
        found.page.mouse.click(x, y)
        assert found.chosen()[:2] == ["Q", "moved"]
        found.page.fill("#plan-find", "B")
        found.page.press("#plan-find", "Enter")
        found.page.get_by_text("Point B is marked.").wait_for()
        for table in found.page.locator("table.sheet").all():
            found.alive(table.get_attribute("data-sheet"))
        assert found.said == []
        others = [r for r in found.requests[1:] if not r.startswith(("blob:", "data:"))]
        assert others == []
        assert found.page.locator("#failed").is_hidden()
