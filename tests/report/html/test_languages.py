"""English and German say the same, and each says it in its own words."""

import re
from dataclasses import replace
from pathlib import Path
from string import Formatter

import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import KINDS as OBSERVED
from factorgraph_adj.report import catalogue
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.catalogue import KINDS_BY_LANGUAGE, TEXTS_BY_LANGUAGE, Texts
from factorgraph_adj.report.html.page import adjustment_html
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
ENGLISH_TEXTS, GERMAN_TEXTS = (TEXTS_BY_LANGUAGE[language] for language in ("en", "de"))
FOLDER = Path(catalogue.__file__).parent


def words(text: str) -> set[str]:
    return set(re.findall(r"[a-zäöüß]+", re.sub(r"\{\w+\}", "", text).lower()))


def test_both_languages_have_the_same_texts_with_the_same_figures():
    assert list(ENGLISH_TEXTS) == list(GERMAN_TEXTS)
    for key, text in ENGLISH_TEXTS.items():
        figures = {name for _, name, _, _ in Formatter().parse(text) if name}
        other = {name for _, name, _, _ in Formatter().parse(GERMAN_TEXTS[key]) if name}
        assert figures == other, key


def test_no_text_is_left_in_english():
    for key, text in GERMAN_TEXTS.items():
        assert not words(text) & ENGLISH, (key, text)
        if len(words(text)) > 1 or len(max(words(text), default="")) > 4:
            same = ENGLISH_TEXTS[key].lower() == text.lower()
            assert not same or text in SAME or key.startswith(("variance_", "col_", "symbol_")), (
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
    sources = [*FOLDER.rglob("*.py"), *(FOLDER / "html" / "template").iterdir()]
    text = "\n".join(p.read_text(encoding="utf-8") for p in sources)
    said = set(re.findall(r"""["'`]([a-z][a-z0-9_]+)["'`]""", text))
    # Identifiers that are put together: of a number, of what is in braces, of a table or a column.
    begun = set(re.findall(r"""["'`]((?:[a-z0-9]+_)+)(?:\{|["'] ~)""", text)) - {"col_"}
    made = {
        f"{part}{name}{end}"
        for name in said
        for part, end in (("col_", ""), ("help_", ""), ("", "_caption"))
    }
    for key in ENGLISH_TEXTS:
        plain = re.sub(r"_(one|many)$", "", key)
        used = key in said or plain in said or key in made
        assert used or key.startswith(tuple(begun)), f"{key} is not used"
    asked = re.findall(r"""(?:\bt|tell|WORDS|t\.number)\(\s*["'`]([a-z0-9_]*[a-z0-9])["'`]""", text)
    assert len(asked) > 200
    for key in asked:
        assert key in ENGLISH_TEXTS or f"{key}_one" in ENGLISH_TEXTS, key


def test_an_identifier_that_one_language_lacks_is_found(monkeypatch):
    monkeypatch.delitem(GERMAN_TEXTS, "unnamed")
    with pytest.raises(KeyError, match="unnamed"):
        Texts("de")("unnamed")
    with pytest.raises(AssertionError):
        test_both_languages_have_the_same_texts_with_the_same_figures()


def test_identifiers_are_short_and_no_sentences():
    for language in ("en", "de"):
        for key in (*TEXTS_BY_LANGUAGE[language], *KINDS_BY_LANGUAGE[language]):
            assert re.fullmatch(r"[a-z0-9_]+", key) and len(key) <= 40, key


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
    begun = solution.reason[0].upper() + solution.reason[1:]  # it begins a sentence
    told = [e for e in found if e.text.strip() == begun]
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
