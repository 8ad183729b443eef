"""The report in a browser without a network: clicks, sorting, filters, zoom, 3-D, keyboard, CSV."""

import csv
import io
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.html.page import adjustment_html, write_report
from tests.networks.adjusted import ADJUSTED
from tests.networks.image_blocks import aerial
from tests.networks.mapped import geocentric
from tests.networks.reported import (
    NASTY,
    heights_alone,
    levelled_field,
    nasty_names,
    three_points,
)
from tests.networks.simulated import free_block
from tests.support.pages import Opened, chromium, opened
from tests.support.places import EXAMPLES

LONG = pytest.mark.slow(
    "pages of every kind of result in a browser; short tests read the pages as text"
)
TOOLS = pytest.mark.slow(
    "every tool of a page in a browser; short tests look at the text of one page there"
)

PLACE = """(div, [meta, number]) => {
  const trace = div.data.find(t => t.meta === meta && t.customdata.includes(number)
    && (meta !== "points" || t.mode === "lines"));
  const i = trace.customdata.indexOf(number) + 4;
  const {xaxis, yaxis} = div._fullLayout, box = div.getBoundingClientRect();
  return [box.x + xaxis._offset + xaxis.l2p(trace.x[i]),
    box.y + yaxis._offset + yaxis.l2p(trace.y[i])];
}"""
"""Where a place of a line of the plan is on the screen: of an ellipse, or of an observation."""
RANGE = "div => [...div._fullLayout.xaxis.range, ...div._fullLayout.yaxis.range].map(Number)"
WIDEST = "Math.max(...[...document.querySelectorAll('.plot .main-svg')].map(s => s.clientWidth))"
"""Width of the widest figure, pixels."""
DRAWN = (
    "div => div.data.filter(t => t.meta === 'points' && t.mode === 'markers').map(t => t.x.length)"
)


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Reports by name; the block has a gross error."""
    at = tmp_path_factory.mktemp("reports")
    network = fga.read_project(EXAMPLES / "industry_block")
    network.images.columns()[2][7] += 0.05
    solution = fga.adjust(network)
    options = fga.ReportOptions(confidence=0.95, relative="observed")
    write_report(solution, at / "block.html", options=options)
    write_report(fga.adjust(three_points()), at / "three.html", language="de")
    write_report(fga.adjust(heights_alone()), at / "heights.html")
    write_report(fga.adjust(nasty_names()), at / "nasty.html")
    write_report(fga.adjust(levelled_field()), at / "field.html")
    write_report(fga.adjust(network, max_iterations=1), at / "failed.html")
    write_report(fga.adjust(free_block()), at / "free.html")
    write_report(fga.adjust(geocentric()), at / "geocentric.html")
    write_report(fga.adjust(aerial(1, control=12).truth), at / "aerial.html")
    return at


@pytest.fixture(scope="module")
def block():
    network = fga.read_project(EXAMPLES / "industry_block")
    network.images.columns()[2][7] += 0.05
    return Report(fga.adjust(network))


def _click(found: Opened, what: str, number: int) -> None:
    """Click on an ellipse or a marked observation of the plan."""
    found.page.evaluate("document.getElementById('plan').scrollIntoView({behavior: 'instant'})")
    x, y = found.page.eval_on_selector("#plan", PLACE, [what, number])
    found.page.mouse.move(x - 3, y)
    found.page.mouse.move(x, y)
    found.page.mouse.click(x, y)


def _window(found: Opened) -> list[float]:
    """Return the limits of the plan."""
    limits: list[float] = found.page.eval_on_selector("#plan", RANGE)
    return limits


def _key(found: Opened) -> str | None:
    """Return the text of the bar that shows the scale of the plan."""
    text: str | None = found.page.locator("#plan .annotation-text").first.text_content()
    return text


def _colours(found: Opened) -> list[float]:
    """Return the figures by which the points of the plan are coloured."""
    script = "d => d.data.find(t => t.marker?.showscale)?.marker.color ?? []"
    return [c for c in found.page.eval_on_selector("#plan", script) if c is not None]


def _are_within(least: float, most: float, figures: list[float]) -> bool:
    return bool(figures) and least <= min(figures) and max(figures) <= most


SORTS = ("three", "heights", "nasty", "block", "failed", "free", "geocentric", "aerial")
"""Plan, heights and space; a gross error, no minimum, no datum, on the Earth, from the air."""


@LONG
@pytest.mark.parametrize("name", SORTS)
def test_a_page_says_nothing_and_asks_for_its_own_file_only(browser, folder, name):
    file = folder / f"{name}.html"
    with opened(browser, file) as found:
        found.ready()
        for table in found.page.locator("table.sheet").all():
            found.alive(table.get_attribute("data-sheet"))
        assert found.said == []
        assert found.requests[0] == file.as_uri()
        others = [r for r in found.requests[1:] if not r.startswith(("blob:", "data:"))]
        assert others == []
        assert found.page.locator("#failed").is_hidden()


@TOOLS
def test_a_click_on_an_ellipse_shows_its_row(browser, folder, block):
    names = list(block.network.points)
    number = names.index("P52")  # on the third page of the table
    with opened(browser, folder / "block.html") as found:
        found.ready()
        _click(found, "points", number)
        assert found.chosen()[0] == "P52"
        assert found.page.evaluate("document.activeElement.closest('table').id") == "table-points"


@TOOLS
def test_a_click_finds_its_row_behind_a_filter(browser, folder, block):
    number = list(block.network.points).index("P52")
    with opened(browser, folder / "block.html") as found:
        found.ready()
        table = found.alive("points")
        table.locator(".filters input").first.fill("P01")
        assert [r[0] for r in found.rows("points")] == ["P01"]
        _click(found, "points", number)
        assert found.chosen()[0] == "P52"
        assert table.locator(".filters input").first.input_value() == ""


@TOOLS
def test_a_click_on_a_marked_observation_shows_its_row(browser, folder, block):
    rel = fga.reliability(block.solution)
    worst = int(np.argmax(np.abs(rel.w)))
    with opened(browser, folder / "block.html") as found:
        found.ready()
        _click(found, "js_doubts", worst)
        row = found.chosen()
    assert row[0] in {r.what for r in block.rows.all() if abs(rel.w[r.number]) > rel.critical_w}


@TOOLS
def test_a_table_sorts_and_filters(browser, folder, block):
    sigma = 1e3 * np.array([block.solution.standard_deviations(n)[0] for n in block.network.points])
    with opened(browser, folder / "block.html") as found:
        found.ready()
        table = found.alive("points")
        heads = table.locator("thead tr").first.locator("th")
        titles = [t.split("[")[0].strip() for t in heads.all_text_contents()]
        column = titles.index("σx")
        heads.nth(column).click()
        shown = [float(r[column]) for r in found.rows("points")]
        assert shown == sorted(shown, reverse=True)
        assert shown[0] == pytest.approx(sigma.max(), abs=0.005)
        limit = float(np.median(sigma)) + 0.0005
        table.locator(".filters input").nth(column).fill(f"> {limit}")
        status = found.page.locator("#points [role=status]").text_content()
        assert f"of {int(np.sum(sigma.round(2) > limit))}, filtered from {len(sigma)}" in status


@TOOLS
def test_a_wide_table_scrolls_under_its_first_column_and_one_row_has_no_filters(browser, folder):
    with opened(browser, folder / "block.html") as found:
        found.page.set_viewport_size({"width": 700, "height": 800})
        found.ready()
        found.alive("observations")
        place = """t => { const cell = t.tBodies[0].rows[0].cells[0], box = t.parentElement;
        const before = cell.getBoundingClientRect().left; box.scrollLeft = 200;
        return [box.scrollLeft, before, cell.getBoundingClientRect().left]; }"""
        scrolled, before, after = found.page.eval_on_selector("#table-observations", place)
        assert scrolled == 200 and after == before
        assert found.page.locator("#table-observations .filters").count() == 1
    with opened(browser, folder / "heights.html") as found:
        found.ready()
        found.alive("groups")
        table = found.page.locator("#table-groups")
        assert table.get_attribute("data-rows") == "1"
        assert table.locator(".filters").count() == 0


@TOOLS
def test_a_filtered_table_goes_into_a_file(browser, folder):
    with opened(browser, folder / "nasty.html", accept_downloads=True) as found:
        found.ready()
        found.alive("points")
        with found.page.expect_download() as download:
            found.page.locator("#points .sheetbar button").first.click()
        text = Path(download.value.path()).read_bytes().decode("utf-8-sig")
        rows = list(csv.reader(io.StringIO(text, newline="")))
        assert [r[0] for r in rows[1:]] == ["BM", *NASTY]
        assert download.value.suggested_filename == "points.csv"
        found.page.locator("#points .sheetbar input").first.fill("script")
        with found.page.expect_download() as download:
            found.page.locator("#points .sheetbar button").first.click()
        text = Path(download.value.path()).read_text(encoding="utf-8-sig")
        assert len(list(csv.reader(io.StringIO(text)))) == 1 + 2


def test_names_stay_text_in_plans_and_tables(browser, folder):
    with opened(browser, folder / "nasty.html") as found:
        found.page.on("dialog", lambda d: found.said.append(f"dialog {d.message}"))
        found.ready()
        assert [r[0] for r in found.rows("points")] == ["BM", *NASTY]
        drawn = found.page.locator("#plan text").all_text_contents()
        assert "<script>alert(1)</script>" in drawn and "Größe Ω 点 🚩" in drawn
        assert found.said == []


@TOOLS
def test_the_plan_zooms_by_buttons_and_finds_points(browser, folder):
    with opened(browser, folder / "block.html") as found:
        found.ready()
        first, key = _window(found), _key(found)
        for _ in range(3):
            found.page.locator("#plan-in").click()
        eighth = pytest.approx((first[1] - first[0]) / 8, rel=0.02)
        found.until(lambda: _window(found), lambda now: now[1] - now[0] == eighth)
        found.until(lambda: _key(found), lambda now: now != key)
        found.page.get_by_label("Find point").fill("p52")
        found.page.keyboard.press("Enter")
        status = found.page.get_by_text("Point P52 is marked.")
        status.wait_for()
        found.page.locator("#plan-all").click()
        found.until(lambda: _window(found), lambda now: np.allclose(now, first, rtol=0.02))


@TOOLS
def test_points_are_coloured_by_their_tests_and_redundancy(browser, folder):
    with opened(browser, folder / "block.html") as found:
        found.ready()
        for value, least, most in (("test", 0.0, 20.0), ("r", 0.0, 1.0)):
            found.page.get_by_label("Colour by").select_option(value)
            colours = found.until(lambda: _colours(found), partial(_are_within, least, most))
            assert len(colours) == 70 and len(set(colours)) > 10


@TOOLS
def test_of_many_points_some_are_drawn_and_all_in_a_smaller_window(browser, folder):
    with opened(browser, folder / "field.html") as found:
        found.ready()
        assert sum(found.page.eval_on_selector("#plan", DRAWN)) in range(1400, 1501)
        assert "of 2025 points in the window are drawn" in found.page.text_content("#plan-told")
        for _ in range(2):
            found.page.locator("#plan-in").click()
        found.until(lambda: found.page.text_content("#plan-told"), lambda now: now == "")
        x0, x1, y0, y1 = _window(found)
        side = 100.0 * np.arange(45)
        inside = np.sum((side >= x0) & (side <= x1)) * np.sum((side >= y0) & (side <= y1))
        found.until(
            lambda: sum(found.page.eval_on_selector("#plan", DRAWN)), lambda now: now == inside
        )


@TOOLS
def test_the_view_in_three_dimensions_is_drawn_when_asked_for(browser, folder):
    with opened(browser, folder / "block.html") as found:
        found.ready()
        assert found.page.locator("#scene").is_hidden()
        found.page.get_by_role("button", name="Show the 3-D view").click()
        found.page.wait_for_selector("#scene[data-made]")
        points = "d => d.data.filter(t => t.meta === 'points').map(t => t.z.length)"
        assert found.page.eval_on_selector("#scene", points) == [70]
        pixels = """d => { const c = d.querySelector('canvas'), g = c.getContext('webgl');
          return g !== null && c.width > 300; }"""
        assert found.page.eval_on_selector("#scene", pixels)
        assert not [s for s in found.said if s.startswith("error")]


@TOOLS
def test_a_keyboard_is_enough(browser, folder):
    with opened(browser, folder / "block.html") as found:
        found.ready()
        found.page.keyboard.press("Tab")
        assert found.page.evaluate("document.activeElement.className") == "skip"
        style = "getComputedStyle(document.activeElement).outlineStyle"
        assert found.page.evaluate(style) == "solid"
        found.page.keyboard.press("Enter")
        assert found.page.evaluate("document.activeElement.id") == "main"
        table = found.alive("points")
        table.locator("thead [role=button]").first.focus()
        assert found.page.evaluate("document.activeElement.closest('th') !== null")
        found.page.keyboard.press("Enter")
        found.page.keyboard.press("Enter")
        assert [r[0] for r in found.rows("points")][:2] == ["P70", "P69"]
        unnamed = """[...document.querySelectorAll('input, select, button')].filter(e =>
          !e.textContent.trim() && !e.labels?.length && !e.getAttribute('aria-label')).length"""
        assert found.page.evaluate(unnamed) == 0


@TOOLS
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_tables_and_plans_take_the_colours_of_the_scheme(browser, folder, scheme):
    with opened(browser, folder / "three.html", color_scheme=scheme) as found:
        found.ready()
        found.alive("points")
        script = """s => { const e = document.querySelector(s), c = getComputedStyle(e);
          return [c.color, c.backgroundColor]; }"""
        for cell in (
            "#table-points tbody tr:nth-child(1)",
            "#table-points tbody tr:nth-child(2) td",
        ):
            ink, back = (_grey(c) for c in found.page.evaluate(script, cell))
            assert abs(ink - back) > 150 and (ink > back) == (scheme == "dark")
        axis = found.page.eval_on_selector("#plan", "d => d.layout.font.color")
        assert (int(axis[1:3], 16) > 128) == (scheme == "dark")


def _grey(colour: str) -> float:
    return float(np.mean([float(v) for v in colour[colour.index("(") + 1 : -1].split(",")[:3]]))


@TOOLS
def test_paper_has_the_plan_and_the_first_rows_and_no_tools(browser, folder):
    with opened(browser, folder / "block.html", color_scheme="dark") as found:
        found.ready()
        found.page.emulate_media(media="print", color_scheme="dark")
        for hidden in ("nav", ".tools", "#scene-part"):
            assert found.page.locator(hidden).first.is_hidden()
        assert found.page.locator("#plan .main-svg").first.is_visible()
        assert _grey(found.page.evaluate("getComputedStyle(document.body).backgroundColor")) == 255
        ink = "d => d.layout.font.color"
        begin = "dispatchEvent(new Event('beforeprint'))"
        shown = found.page.eval_on_selector(
            "#plan", f"d => {{ const r = ({RANGE})(d); {begin}; return r; }}"
        )
        assert found.page.eval_on_selector("#plan", ink) == "#000000"
        # A4 has 186 mm, 703 pixels, between the margins: no figure is wider, no number is broken.
        assert found.page.evaluate(WIDEST) <= 703
        cell = "getComputedStyle(document.querySelector('td.number')).whiteSpace"
        assert found.page.evaluate(cell) == "nowrap"
        found.page.emulate_media(media="screen", color_scheme="dark")
        found.page.evaluate("dispatchEvent(new Event('afterprint'))")
        assert found.page.eval_on_selector("#plan", ink) == "#e8eaed"
        # The screen has its width and its part of the plan again.
        found.page.wait_for_function(f"{WIDEST} > 703")
        found.until(lambda: _window(found), lambda now: now == pytest.approx(shown, rel=1e-9))
        printed = "addEventListener('beforeprint', () => (document.title = 'printed'))"
        found.page.evaluate(printed)
        paper = found.page.pdf(format="A4")
        assert found.page.title() == "printed"
        assert len(re.findall(rb"/Type\s*/Page\b", paper)) > 3


@TOOLS
def test_without_a_script_the_page_still_has_its_words(browser, folder):
    with opened(browser, folder / "block.html", java_script_enabled=False) as found:
        assert found.page.locator("noscript").text_content().startswith("The script of this page")
        rows = found.page.locator("#table-points tbody tr")
        assert rows.count() == 25


@TOOLS
def test_a_browser_that_cannot_unpack_says_so(browser, folder, tmp_path):
    text = (folder / "three.html").read_text(encoding="utf-8")
    broken = tmp_path / "broken.html"
    broken.write_text(text.replace('id="data-plan">', 'id="data-plan">A'), encoding="utf-8")
    with opened(browser, broken) as found:
        found.page.wait_for_selector("#failed:not([hidden])")
        words = found.page.text_content("#failed")
        assert words.startswith("Diese Seite konnte nicht gezeichnet werden:")


@pytest.mark.slow("that a report of 26 321 points and 181 122 rows is small and soon ready")
def test_the_report_of_roma_is_small_and_soon_ready(browser, folder, tmp_path):
    """Costs are compared with those of a report of three points: its libraries load in both."""
    solution = fga.adjust(ADJUSTED["Roma"]())
    file = tmp_path / "roma.html"
    write_report(solution, file)
    assert file.stat().st_size < 30e6
    small, large = [], []
    for _ in range(2):  # in turn, and the lesser of two, because other work disturbs one of them
        with opened(browser, folder / "three.html") as found:
            found.page.wait_for_selector("html[data-ready]", state="attached")
            small.append(found.seconds())
        with opened(browser, file) as found:
            found.page.wait_for_selector("html[data-ready]", state="attached")
            large.append(found.seconds())
            # Rows are drawn as they come into view: each has more elements than there may be.
            assert found.page.locator("*").count() < 26_321
    assert min(large) < 4.0 * min(small)  # about 1.8 times
    with opened(browser, file) as found:
        found.page.get_by_label("Find point").fill("11806")
        found.page.keyboard.press("Enter")
        found.page.get_by_text("Point 11806 is marked.").wait_for()
        found.alive("observations")
        before = found.seconds()
        found.page.locator("#observations .filters input").nth(1).fill("/11806")
        status = found.page.locator("#observations [role=status]").text_content()
        assert "filtered from 181122" in status
        assert found.seconds() - before < min(large)  # about a twelfth
        assert found.said == []


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
def test_the_text_of_a_page_is_the_same_as_the_file(folder):
    report = Report(fga.adjust(three_points()))
    assert (folder / "three.html").read_text(encoding="utf-8") == adjustment_html(
        report, language="de"
    )
