"""English and German say the same, and each says it in its own words."""

import re
from dataclasses import replace
from pathlib import Path
from string import Formatter

import factorgraph_adj as fga
from factorgraph_adj.models.variables import UNKNOWNS
from factorgraph_adj.observations import KINDS as OBSERVED
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.html import english, german
from factorgraph_adj.report.html.page import adjustment_html
from factorgraph_adj.report.html.rendering import Texts
from tests.benchmarks.causes import adjusted
from tests.networks.building_site import site
from tests.networks.reported import three_points
from tests.networks.small_block import small_block
from tests.support.pages import elements

ENGLISH = set(
    re.findall(
        r"\w+",
        "the of and is are was were which with from that this not by for has have its their them "
        "they it no each than above below between points observation observations rows click",
    )
)
"""Words of which no German sentence has one."""
SAME = {"Iteration", "Parameter", "Filter", "Data Snooping", "robust", "Datum", "Tests", "Block"}
"""Texts that are the same word in both languages."""
FOLDER = Path(english.__file__).parent


def words(text: str) -> set[str]:
    return set(re.findall(r"[a-zäöüß]+", re.sub(r"\{\w+\}", "", text).lower()))


def test_both_languages_have_the_same_texts_with_the_same_figures():
    assert list(english.ENGLISH_TEXTS) == list(german.GERMAN_TEXTS)
    for key, text in english.ENGLISH_TEXTS.items():
        figures = {name for _, name, _, _ in Formatter().parse(text) if name}
        other = {name for _, name, _, _ in Formatter().parse(german.GERMAN_TEXTS[key]) if name}
        assert figures == other, key


def test_no_text_is_left_in_english():
    for key, text in german.GERMAN_TEXTS.items():
        assert not words(text) & ENGLISH, (key, text)
        if len(words(text)) > 1 or len(max(words(text), default="")) > 4:
            same = english.ENGLISH_TEXTS[key].lower() == text.lower()
            assert not same or text in SAME or key.startswith(("variance.", "col.", "symbol.")), (
                key,
                text,
            )


def test_every_kind_has_a_german_name():
    t = Texts("de")
    for kind in (*OBSERVED, "weighted_coordinates"):
        assert t.kind(kind.replace("_", " ")) != kind.replace("_", " "), kind
    for record in UNKNOWNS.values():
        if record.title not in ("drift",):
            assert t.kind(record.title) != record.title, record.title
        weighted = f"weighted {record.name.replace('_', ' ')}"
        assert t.kind(weighted).startswith("gewichtet"), weighted
    assert t.kind("image, P31") == "Bild, P31"
    assert Texts("en").kind("image, P31") == "image, P31"


def test_every_text_is_used_and_every_used_text_is_there():
    sources = [*FOLDER.glob("*.py"), *(FOLDER / "template").iterdir()]
    text = "\n".join(
        p.read_text(encoding="utf-8")
        for p in sources
        if not p.stem.startswith(("english", "german"))
    )
    said = set(re.findall(r"""["']([a-z0-9_]+(?:\.[a-z0-9_]+)*)["']""", text))
    # Keys that are put together: of a number, and of what is in braces.
    begun = tuple(re.findall(r"""["'`]((?:[a-z]+\.)+)(?:\{|["'] ~)""", text))
    for key in english.ENGLISH_TEXTS:
        plain = re.sub(r"\.(one|many)$", "", key)
        assert key in said or plain in said or key.startswith(begun), f"{key} is not used"
    for key in said:
        if (
            key.split(".")[0] in {k.split(".")[0] for k in english.ENGLISH_TEXTS if "." in k}
            and "." in key
        ):
            known = key in english.ENGLISH_TEXTS or f"{key}.one" in english.ENGLISH_TEXTS
            assert known or key.endswith((".csv", ".js", "table.sheet")), key


def test_a_german_page_has_german_words_alone():
    for network in (three_points(), small_block()):
        found = elements(adjustment_html(Report(fga.adjust(network)), language="de"))
        assert found[0].attributes["lang"] == "de"
        for e in found:
            if e.tag in ("h1", "h2", "h3", "th", "caption", "dt", "label", "button", "figcaption"):
                own = e.text.replace(network.name, "")
                assert not words(own) & ENGLISH, e
            for name in ("title", "aria-label"):
                assert not words(e.attributes.get(name, "")) & ENGLISH, e


def test_sentences_of_the_adjustment_are_marked_as_english():
    solution = fga.adjust(small_block(), max_iterations=1)
    found = elements(adjustment_html(Report(solution), language="de"))
    told = [e for e in found if e.text.strip() == solution.reason]
    assert told and told[-1].attributes["lang"] == "en"
    assert next(e for e in found if e.tag == "pre").attributes["lang"] == "en"


def test_causes_are_announced_in_german_and_marked_as_english():
    network, readings, _ = site(1)
    wrong = adjusted(network, readings)
    for ident, o in wrong.observations.items():
        factor = {"S1": 1.05, "S2": 0.95, "S4": 1.06}.get(getattr(o, "station", ""))
        if factor and getattr(o, "instrument_height", None):
            wrong.observations[ident] = replace(o, instrument_height=factor * o.instrument_height)
    page = adjustment_html(Report(fga.adjust(wrong)), language="de")
    assert "Einer von mehreren Fehlern" in page
    cells = [e for e in elements(page) if e.tag in ("td", "q")]
    said = [e for e in cells if words(e.text) & (ENGLISH - {"observations", "points"})]
    assert any("the height of the instrument at" in e.text for e in said)
    assert {e.attributes.get("lang") for e in said} == {"en"}
