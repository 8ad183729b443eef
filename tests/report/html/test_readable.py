"""Contrasts of the colours, and what a screen reader and a keyboard need."""

import re
from itertools import pairwise
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.epochs_report import EpochsReport
from factorgraph_adj.report.html import page as page_module
from factorgraph_adj.report.html.epochs_page import epochs_html
from factorgraph_adj.report.html.page import adjustment_html
from tests.networks import moved
from tests.networks.small_block import small_block
from tests.support.pages import elements

STYLE = (Path(page_module.__file__).parent / "template" / "style.css").read_text(encoding="utf-8")
TEXT, GRAPHIC = 4.5, 3.0
"""Smallest contrasts of text and of graphics, WCAG 2.2, 1.4.3 and 1.4.11."""
PAIRS = [
    *((ink, back, TEXT) for ink in ("ink", "soft", "link") for back in ("page", "band")),
    *((c, back, TEXT) for c in ("green", "amber", "red", "none") for back in ("page", f"{c}-back")),
    *(("ink", f"{c}-back", TEXT) for c in ("green", "amber", "red")),
    *(("link", f"{c}-back", TEXT) for c in ("green", "amber", "red")),
    ("ink", "mark", TEXT),
    ("focus", "page", GRAPHIC),
    *((c, "page", GRAPHIC) for c in ("point", "held", "ellipse", "photo", "doubt", "selected")),
    *((c, "page", GRAPHIC) for c in ("sight", "sight2", "sight3", "shape")),
]


def themes() -> dict[str, dict[str, str]]:
    """Return the colours of the page, of the dark page, and of paper."""
    found = [dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", b)) for b in STYLE.split(":root")[1:]]
    light, dark, paper, printed = (f for f in found if f)
    assert paper == printed, "the script and the printer have the same colours"
    return {"light": light, "dark": {**light, **dark}, "paper": {**light, **paper}}


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: str, b: str) -> float:
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_contrast_of_black_and_white_is_21():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.005)  # a known limit case


@pytest.mark.parametrize("theme", ["light", "dark", "paper"])
def test_text_and_graphics_stand_out(theme):
    colours = themes()[theme]
    weak = [
        (ink, back, round(contrast(colours[ink], colours[back]), 2))
        for ink, back, least in PAIRS
        if back in colours and contrast(colours[ink], colours[back]) < least
    ]
    assert not weak


PAGES = {
    "adjustment": lambda: adjustment_html(Report(fga.adjust(small_block()))),
    "epochs": lambda: epochs_html(EpochsReport(moved.in_plan(), (moved.block(),))),
}


@pytest.mark.parametrize("page", PAGES)
def test_the_structure_is_that_of_a_document(page):
    found = elements(PAGES[page]())
    tags = [e.tag for e in found]
    assert tags.count("h1") == tags.count("main") == tags.count("header") == tags.count("nav") == 1
    levels = [int(t[1]) for t in tags if re.fullmatch(r"h[1-6]", t)]
    assert all(b - a <= 1 for a, b in pairwise(levels))
    ids = [e.attributes["id"] for e in found if "id" in e.attributes]
    assert len(ids) == len(set(ids))
    for e in found:
        for name in ("aria-labelledby", "aria-controls"):
            for ident in e.attributes.get(name, "").split():
                assert ident in ids, e
        if e.attributes.get("href", "").startswith("#"):
            assert e.attributes["href"][1:] in ids, e


@pytest.mark.parametrize(("page", "most", "figures"), [("adjustment", 8, 5), ("epochs", 5, 1)])
def test_tables_have_captions_and_scopes_and_plots_have_words(page, most, figures):
    found = elements(PAGES[page]())
    tables = sum(e.tag == "table" for e in found)
    assert tables == sum(e.tag == "caption" and bool(e.text.strip()) for e in found) > most
    for e in found:
        if e.tag == "th":
            assert e.attributes.get("scope") in ("col", "row"), e
        if e.tag == "section":
            assert "aria-labelledby" in e.attributes
        if "plot" in e.attributes.get("class", "").split():
            assert e.attributes["role"] == "group" and e.attributes["aria-labelledby"]
    captions = [e.text.strip() for e in found if e.tag == "figcaption"]
    assert len(captions) >= figures and all(len(c) > 40 for c in captions)


def test_the_first_link_leads_to_the_content():
    found = elements(adjustment_html(Report(fga.adjust(small_block()))))
    first = next(e for e in found if e.tag == "a")
    assert first.attributes == {"class": "skip", "href": "#main"}
    main = next(e for e in found if e.tag == "main")
    assert main.attributes["id"] == "main" and main.attributes["tabindex"] == "-1"
