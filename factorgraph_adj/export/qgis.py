"""Styles of layers for QGIS (QML), which a GeoPackage holds.

A style is a renderer of rules: each rule has a filter, a label and a symbol, and a symbol is one
symbol layer with properties, as QGIS writes them since version 3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

BLACK, GREY, BLUE = "0,0,0,255", "110,110,110,255", "0,114,178,255"
VERMILLION, GREEN, CLEAR = "213,94,0,255", "0,158,115,255", "0,0,0,0"
"""Colours that people with any kind of sight tell apart (Okabe and Ito), and none."""
HEAD = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
CLASSES = {"marker": "SimpleMarker", "line": "SimpleLine", "fill": "SimpleFill"}
"""Class of the symbol layer of each kind of symbol."""


@dataclass(frozen=True)
class Rule:
    """One rule of a renderer."""

    label: str
    """Text in the legend."""
    filter: str
    """Expression of QGIS; empty: all features."""
    properties: Mapping[str, str]
    """Properties of the symbol layer."""


@dataclass(frozen=True)
class Style:
    """Style of a layer."""

    symbol: str
    """Kind of symbol: marker, line, fill."""
    rules: tuple[Rule, ...]
    """The rules."""
    label: str = ""
    """Column whose text stands beside a feature; empty: none."""


def _marker(name: str, colour: str, size: float, *, filled: bool = True) -> dict[str, str]:
    return {
        "name": name,
        "color": colour if filled else CLEAR,
        "outline_color": colour,
        "outline_style": "solid",
        "outline_width": "0.3",
        "outline_width_unit": "MM",
        "size": f"{size:g}",
        "size_unit": "MM",
    }


def _line(colour: str, width: float) -> dict[str, str]:
    return {
        "line_color": colour,
        "line_style": "solid",
        "line_width": f"{width:g}",
        "line_width_unit": "MM",
        "capstyle": "round",
    }


def _fill(colour: str, width: float) -> dict[str, str]:
    return {
        "color": CLEAR,
        "style": "no",
        "outline_color": colour,
        "outline_style": "solid",
        "outline_width": f"{width:g}",
        "outline_width_unit": "MM",
    }


def _observed(width: float, colour: str) -> tuple[Rule, ...]:
    return (
        Rule("accepted", 'not coalesce("suspect", false)', _line(colour, width)),
        Rule("above the critical value", '"suspect"', _line(VERMILLION, 3 * width)),
    )


STYLES: dict[str, Style] = {
    "points": Style(
        "marker",
        (
            Rule("held", "\"status\" = 'held'", _marker("triangle", BLACK, 3.2)),
            Rule("held in part", "\"status\" = 'part'", _marker("triangle", GREEN, 2.8)),
            Rule("known", "\"status\" IN ('known', 'datum')", _marker("triangle", BLUE, 2.8)),
            Rule("check point", "\"status\" = 'check'", _marker("diamond", VERMILLION, 2.8)),
            Rule("station", "\"status\" = 'station'", _marker("circle", BLACK, 2.6, filled=False)),
            Rule("side shot", "\"status\" = 'side_shot'", _marker("cross", BLACK, 2.0)),
            Rule("new point", "\"status\" = 'new'", _marker("circle", BLACK, 1.4)),
            Rule("stable", "\"status\" = 'stable'", _marker("triangle", BLUE, 2.8)),
            Rule(
                "reference, not stable",
                "\"status\" = 'left'",
                _marker("triangle", VERMILLION, 2.8, filled=False),
            ),
            Rule("moved", "\"status\" = 'moved'", _marker("circle", VERMILLION, 2.0)),
            Rule("not significant", "\"status\" = 'kept'", _marker("circle", BLACK, 1.4)),
        ),
        "name",
    ),
    "ellipses": Style("fill", (Rule("error ellipse", "", _fill(BLUE, 0.3)),)),
    "observations": Style("line", _observed(0.2, GREY)),
    "image_points": Style("line", _observed(0.1, "110,110,110,70")),
    "observations_at_points": Style(
        "marker",
        (
            Rule(
                "above the critical value",
                '"suspect"',
                _marker("circle", VERMILLION, 4.5, filled=False),
            ),
        ),
    ),
    "photos": Style("marker", (Rule("photo", "", _marker("square", BLUE, 1.8)),), "name"),
    "footprints": Style("fill", (Rule("footprint", "", _fill(GREEN, 0.2)),)),
    "vectors": Style("line", (Rule("adjusted − given", "", _line(VERMILLION, 0.5)),)),
    "displacements": Style(
        "line",
        (
            Rule("significant", '"moved"', _line(VERMILLION, 0.6)),
            Rule("not significant", 'not "moved"', _line(GREY, 0.4)),
        ),
    ),
    "displacement_ellipses": Style(
        "fill",
        (
            Rule("significant", '"moved"', _fill(VERMILLION, 0.3)),
            Rule("not significant", 'not "moved"', _fill(GREY, 0.3)),
        ),
    ),
}
"""Style of each layer."""


def style_of(layer: str) -> str:
    """Return the style of a layer as QML."""
    style = STYLES[layer]
    root = ET.Element("qgis", version="3.28.0", styleCategories="Symbology|Labeling")
    renderer = ET.SubElement(
        root,
        "renderer-v2",
        type="RuleRenderer",
        symbollevels="0",
        enableorderby="0",
        forceraster="0",
    )
    rules = ET.SubElement(renderer, "rules", key="root")
    symbols = ET.SubElement(renderer, "symbols")
    for i, rule in enumerate(style.rules):
        attributes = {"key": f"rule{i}", "symbol": str(i), "label": rule.label}
        ET.SubElement(rules, "rule", attributes | ({"filter": rule.filter} if rule.filter else {}))
        symbol = ET.SubElement(
            symbols,
            "symbol",
            type=style.symbol,
            name=str(i),
            alpha="1",
            clip_to_extent="1",
            force_rhr="0",
        )
        part = {"class": CLASSES[style.symbol], "enabled": "1", "locked": "0", "pass": "0"}
        _properties(ET.SubElement(symbol, "layer", part), rule.properties)
    if style.label:
        _labels(root, style.label)
    ET.SubElement(root, "layerGeometryType").text = str(
        ("marker", "line", "fill").index(style.symbol)
    )
    ET.indent(root, " ")
    return HEAD + ET.tostring(root, encoding="unicode") + "\n"


def _properties(parent: ET.Element, properties: Mapping[str, str]) -> None:
    options = ET.SubElement(parent, "Option", type="Map")
    for name, value in properties.items():
        ET.SubElement(options, "Option", type="QString", name=name, value=value)


def _labels(root: ET.Element, column: str) -> None:
    labeling = ET.SubElement(root, "labeling", type="simple")
    settings = ET.SubElement(labeling, "settings", calloutType="simple")
    look: Sequence[tuple[str, str]] = (
        ("fieldName", column),
        ("fontFamily", "Sans Serif"),
        ("fontSize", "8"),
        ("fontSizeUnit", "Point"),
        ("textColor", BLACK),
    )
    ET.SubElement(settings, "text-style", dict(look))
    ET.SubElement(settings, "placement", placement="0", dist="1", distUnits="MM")
