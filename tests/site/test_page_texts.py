"""Texts and colours of the page of a site, without a browser."""

import json
import re

import pytest

from tests.support.places import ROOT

PAGE = ROOT / "factorgraph_adj" / "site" / "page"
CATALOGUES = {
    code: json.loads((PAGE / f"{code}.json").read_text(encoding="utf-8")) for code in ("en", "de")
}
SOURCE = "\n".join(f.read_text(encoding="utf-8") for f in sorted(PAGE.glob("*.js")))
SAME = {"Plan", "Name", "Token", "Alarm", "Alarme", "Filter", "Redundanz", "Revision", "± σ", "3-D"}


def test_both_languages_have_the_same_texts_and_figures():
    en, de = CATALOGUES["en"], CATALOGUES["de"]
    assert list(en) == list(de)
    for key, text in en.items():
        figures = set(re.findall(r"\{\w+\}", text))
        assert figures == set(re.findall(r"\{\w+\}", de[key])), key


def test_every_text_is_used_and_every_used_text_is_there():
    stated = set(re.findall(r"""["'`]([a-z][a-z0-9_]*)["'`]""", SOURCE))
    asked = set(re.findall(r"""\bt\("([a-z0-9_]+)\"""", SOURCE))
    begun = set(re.findall(r"""\bt\(`([a-z0-9_]+_)\$\{""", SOURCE)) | {
        "state_",
        "test_",
        "policy_",
        "datum_",
        "why_",
    }
    texts = CATALOGUES["en"]
    assert not asked - set(texts)
    for key in texts:
        plain = key.removesuffix("_one")
        assert plain in stated or plain.startswith(tuple(begun)), key


def _luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    r, g, b = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of WCAG 2."""
    low, high = sorted((_luminance(one), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_texts_have_a_contrast_of_at_least_four_and_a_half(theme):
    style = (PAGE / "style.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root(?:\[data-theme=\"dark\"\])? \{([^}]*)\}", style)
    colours = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", blocks[theme == "dark"]))
    pairs = [(ink, back) for ink in ("ink", "soft", "link") for back in ("page", "band", "raised")]
    pairs += [(c, f"{c}-back") for c in ("green", "amber", "red", "none")]
    pairs += [("ink", f"{c}-back") for c in ("green", "amber", "red", "none")]
    pairs += [(c, "page") for c in ("green", "amber", "red", "none", "moved")]
    pairs += [("on-main", "main"), ("ink", "mark"), ("link", "mark"), ("page", "ink")]
    low = {p: contrast(colours[p[0]], colours[p[1]]) for p in pairs}
    assert min(low.values()) >= 4.5, min(low.items(), key=lambda i: i[1])
    # Lines, shapes and borders of controls: 3 is what WCAG asks of graphics.
    shapes = ("edge", "point", "held", "ellipse", "photo", "sight", "sight2", "doubt", "moved")
    drawn = {c: contrast(colours[c], colours["page"]) for c in (*shapes, "aside", "selected")}
    assert min(drawn.values()) >= 3, min(drawn.items(), key=lambda i: i[1])


def test_the_page_names_nothing_outside_its_server():
    for file in PAGE.iterdir():
        text = file.read_text(encoding="utf-8")
        found = set(re.findall(r"https?://[^\s\"'`<>)]+", text)) - {"http://www.w3.org/2000/svg"}
        assert not found, file.name
        assert "innerHTML" not in text and "eval(" not in text, file.name
