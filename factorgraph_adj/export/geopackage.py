"""GeoPackage: map layers of a result in one SQLite file, with their styles for QGIS (QML).

OGC 12-128 (GeoPackage Encoding Standard 1.3): a SQLite database whose tables of features have a
geometry in the form "GP", version, flags, reference system, envelope, WKB. The styles of the layers
(QML, as QGIS writes it since version 3) are in the table ``layer_styles``, where QGIS looks for
them: a renderer of rules, each with a filter, a label and a symbol.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from ..errors import taking
from ..io.file_transaction import write_files
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..types import Array
from .map_coordinates import MapCoordinates, best_map_coordinates
from .map_layers import (
    ExportedResult,
    Geometry,
    Layer,
    MapScaling,
    SolutionMap,
    plain_value,
    report_of,
    solution_map,
)

BLACK, GREY, BLUE = "0,0,0,255", "110,110,110,255", "0,114,178,255"
VERMILLION, GREEN, CLEAR = "213,94,0,255", "0,158,115,255", "0,0,0,0"
"""Colours that people with any kind of sight tell apart (Okabe and Ito), and none."""
QML_DOCTYPE = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
SYMBOL_CLASSES = {"marker": "SimpleMarker", "line": "SimpleLine", "fill": "SimpleFill"}
"""Class of the symbol layer of each kind of symbol."""
OWN_SYSTEM_ID = 100_000
"""Identifier of a reference system without an EPSG code."""
NO_DATE = "1970-01-01T00:00:00.000Z"
"""Time of files whose run has no date: the library looks at no clock."""
GEOPACKAGE_APPLICATION_ID, GEOPACKAGE_VERSION = 0x47504B47, 10300
"""Mark "GPKG" and version 1.3 in the header of the file."""
WKB_CODES: dict[Geometry, int] = {"POINT": 1001, "LINESTRING": 1002, "POLYGON": 1003}
"""Codes of geometries with heights in ISO WKB."""
UNDEFINED_CARTESIAN, UNDEFINED_GEOGRAPHIC = -1, 0
"""Identifiers of the undefined reference systems that every GeoPackage has."""
WGS84_WKT = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,'
    'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,'
    'AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],'
    'AUTHORITY["EPSG","4326"]]'
)
GEOPACKAGE_TABLES = """
CREATE TABLE gpkg_spatial_ref_sys (
  srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (
  table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '',
  last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL,
  srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
  CONSTRAINT uk_gc_table_name UNIQUE (table_name),
  CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
  CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id));
CREATE TABLE layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256),
  f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
  styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT,
  owner TEXT(30), ui TEXT(30),
  update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')));
CREATE TABLE adjustment (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, name TEXT NOT NULL, value TEXT);
"""
"""Tables that every file has."""


@dataclass(frozen=True)
class StyleRule:
    """One rule of a renderer."""

    label: str
    """Text in the legend."""
    filter: str
    """Expression of QGIS; empty: all features."""
    properties: Mapping[str, str]
    """Properties of the symbol layer."""


@dataclass(frozen=True)
class LayerStyle:
    """Style of a layer."""

    symbol: str
    """Kind of symbol: marker, line, fill."""
    rules: tuple[StyleRule, ...]
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


def _observed(width: float, colour: str) -> tuple[StyleRule, ...]:
    return (
        StyleRule("accepted", 'not coalesce("suspect", false)', _line(colour, width)),
        StyleRule("above the critical value", '"suspect"', _line(VERMILLION, 3 * width)),
    )


LAYER_STYLES: dict[str, LayerStyle] = {
    "points": LayerStyle(
        "marker",
        (
            StyleRule("held", "\"status\" = 'held'", _marker("triangle", BLACK, 3.2)),
            StyleRule("held in part", "\"status\" = 'part'", _marker("triangle", GREEN, 2.8)),
            StyleRule("known", "\"status\" IN ('known', 'datum')", _marker("triangle", BLUE, 2.8)),
            StyleRule("check point", "\"status\" = 'check'", _marker("diamond", VERMILLION, 2.8)),
            StyleRule(
                "station", "\"status\" = 'station'", _marker("circle", BLACK, 2.6, filled=False)
            ),
            StyleRule("side shot", "\"status\" = 'side_shot'", _marker("cross", BLACK, 2.0)),
            StyleRule("new point", "\"status\" = 'new'", _marker("circle", BLACK, 1.4)),
            StyleRule("stable", "\"status\" = 'stable'", _marker("triangle", BLUE, 2.8)),
            StyleRule(
                "reference, not stable",
                "\"status\" = 'left'",
                _marker("triangle", VERMILLION, 2.8, filled=False),
            ),
            StyleRule("moved", "\"status\" = 'moved'", _marker("circle", VERMILLION, 2.0)),
            StyleRule("not significant", "\"status\" = 'kept'", _marker("circle", BLACK, 1.4)),
        ),
        "name",
    ),
    "ellipses": LayerStyle("fill", (StyleRule("error ellipse", "", _fill(BLUE, 0.3)),)),
    "observations": LayerStyle("line", _observed(0.2, GREY)),
    "image_points": LayerStyle("line", _observed(0.1, "110,110,110,70")),
    "observations_at_points": LayerStyle(
        "marker",
        (
            StyleRule(
                "above the critical value",
                '"suspect"',
                _marker("circle", VERMILLION, 4.5, filled=False),
            ),
        ),
    ),
    "photos": LayerStyle("marker", (StyleRule("photo", "", _marker("square", BLUE, 1.8)),), "name"),
    "footprints": LayerStyle("fill", (StyleRule("footprint", "", _fill(GREEN, 0.2)),)),
    "vectors": LayerStyle("line", (StyleRule("adjusted − given", "", _line(VERMILLION, 0.5)),)),
    "displacements": LayerStyle(
        "line",
        (
            StyleRule("significant", '"moved"', _line(VERMILLION, 0.6)),
            StyleRule("not significant", 'not "moved"', _line(GREY, 0.4)),
        ),
    ),
    "displacement_ellipses": LayerStyle(
        "fill",
        (
            StyleRule("significant", '"moved"', _fill(VERMILLION, 0.3)),
            StyleRule("not significant", 'not "moved"', _fill(GREY, 0.3)),
        ),
    ),
}
"""Style of each layer."""


def layer_qml(layer: str) -> str:
    """Return the style of a layer as QML."""
    style = LAYER_STYLES[layer]
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
        part = {"class": SYMBOL_CLASSES[style.symbol], "enabled": "1", "locked": "0", "pass": "0"}
        _properties(ET.SubElement(symbol, "layer", part), rule.properties)
    if style.label:
        _labels(root, style.label)
    ET.SubElement(root, "layerGeometryType").text = str(
        ("marker", "line", "fill").index(style.symbol)
    )
    ET.indent(root, " ")
    return QML_DOCTYPE + ET.tostring(root, encoding="unicode") + "\n"


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


@taking(ExportedResult)
def write_geopackage(
    result: ExportedResult,
    path: str | Path,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
    exaggeration: float | None = None,
    vector_exaggeration: float | None = None,
) -> None:
    """Write a solution as a GeoPackage, with styles for QGIS.

    Layers are ``points``, ``ellipses`` (polygons), ``observations`` (lines, with v, r, w, τ),
    ``observations_at_points``, ``image_points`` (rays), ``photos``, ``footprints`` and ``vectors``
    (adjusted − given coordinates of check points and control), and the table ``adjustment`` with
    σ̂0, exaggerations and what the coordinates are. Coordinates are easting, northing, height in
    the grid of the network's reference system (always in this order, metres); in WGS 84 if the
    system has no grid; and without a reference system east, north, up of the frame with the
    identifier −1 (undefined Cartesian), or longitude and latitude with the identifier 0 (undefined
    geographic) if the frame is geocentric.

    Args:
        result: the result of `adjust`, or its report with data snooping; or of `congruence`, or its
            report with blocks.
        path: the file, such as ``network.gpkg``; one that is there is replaced.
        confidence: probability of the error ellipses; None: standard ellipses.
        exaggeration: factor of the ellipses; None: a round number that makes them visible; 1: true
            size. The column ``exaggeration`` states it.
        vector_exaggeration: the same for vectors.

    Raises:
        InputError: pyproj or a geoid is missing, an option is out of range, or the file cannot be
            written.
    """
    drawn = MapScaling(confidence, exaggeration, vector_exaggeration)
    report = report_of(result)
    found = solution_map(report, best_map_coordinates(report.network), drawn)
    file = Path(path)
    write_files(file.parent, {file.name: geopackage(found, _date(report.provenance.run.date))})


def geopackage(found: SolutionMap, date: str = NO_DATE) -> bytes:
    """Return layers as the bytes of a GeoPackage.

    Args:
        found: the layers.
        date: time of change, in the form of ISO 8601 that GeoPackage demands.
    """
    connection = sqlite3.connect(":memory:")
    try:
        connection.execute(f"PRAGMA application_id = {GEOPACKAGE_APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {GEOPACKAGE_VERSION}")
        connection.executescript(GEOPACKAGE_TABLES)
        srs = _add_systems(connection, found.placing)
        for layer in found.layers:
            _add_layer(connection, layer, srs, date)
        facts = [
            (n, None if plain_value(v) is None else str(plain_value(v)))
            for n, v in found.facts.items()
        ]
        connection.executemany("INSERT INTO adjustment (name, value) VALUES (?, ?)", facts)
        for table in ("adjustment", "layer_styles"):
            connection.execute(
                "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change) "
                "VALUES (?, 'attributes', ?, ?)",
                (table, table, date),
            )
        connection.commit()
        return bytes(connection.serialize())
    finally:
        connection.close()


def _date(text: str) -> str:
    """Return the date of a run in the form that GeoPackage demands."""
    try:
        found = datetime.strptime(text, "%Y-%m-%d %H:%M %z").astimezone(UTC)
    except ValueError:
        return NO_DATE
    return found.strftime("%Y-%m-%dT%H:%M:%S.000Z")


# -- reference systems ----------------------------------------------------------------------------


def _add_systems(connection: sqlite3.Connection, placing: MapCoordinates) -> int:
    """Add the reference systems that every file has, and that of the map; return its identifier."""
    undefined = "undefined", "undefined coordinate reference system"
    rows = [
        ("Undefined Cartesian SRS", UNDEFINED_CARTESIAN, "NONE", UNDEFINED_CARTESIAN, *undefined),
        (
            "Undefined geographic SRS",
            UNDEFINED_GEOGRAPHIC,
            "NONE",
            UNDEFINED_GEOGRAPHIC,
            *undefined,
        ),
        (
            "WGS 84 geodetic",
            4326,
            "EPSG",
            4326,
            WGS84_WKT,
            "longitude, latitude; heights ellipsoidal",
        ),
    ]
    srs = {
        "plane": UNDEFINED_CARTESIAN,
        "ellipsoid": UNDEFINED_GEOGRAPHIC,
        "wgs84": 4326,
        "grid": OWN_SYSTEM_ID,
    }[placing.kind]
    if placing.kind == "grid" and placing.system is not None:
        code = placing.system.epsg
        srs = OWN_SYSTEM_ID if code is None else code
        owner = ("NONE", OWN_SYSTEM_ID) if code is None else ("EPSG", code)
        words = f"easting, northing; heights: {placing.heights}"
        rows.append((placing.system.plan.name, srs, *owner, placing.system.wkt1, words))
    connection.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", rows)
    return srs


# -- layers ---------------------------------------------------------------------------------------


def _add_layer(connection: sqlite3.Connection, layer: Layer, srs: int, date: str) -> None:
    records = layer.records()
    types = {name: _type_of([r[name] for r in records]) for name in layer.columns}
    columns = "".join(f", {_quoted(name)} {kind}" for name, kind in types.items())
    connection.execute(
        f"CREATE TABLE {_quoted(layer.name)} (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, "
        f"geom {layer.geometry}{columns})"
    )
    places = [s for s in layer.shapes if s is not None]
    every = np.concatenate(places)[:, :2] if places else np.full((1, 2), np.nan)
    bounds = [plain_value(v) for v in (*every.min(axis=0).tolist(), *every.max(axis=0).tolist())]
    connection.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, ?, ?, ?, ?, ?, ?, ?)",
        (layer.name, layer.name, layer.title, date, *bounds, srs),
    )
    connection.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 1, 0)",
        (layer.name, layer.geometry, srs),
    )
    names = ", ".join(map(_quoted, ("geom", *types)))
    marks = ", ".join("?" * (1 + len(types)))
    connection.executemany(
        f"INSERT INTO {_quoted(layer.name)} ({names}) VALUES ({marks})",
        (
            (shape, *record.values())
            for shape, record in zip(
                geometry_blobs(layer.shapes, layer.geometry, srs), records, strict=True
            )
        ),
    )
    connection.execute(
        "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, "
        "f_geometry_column, styleName, styleQML, styleSLD, useAsDefault, description, owner, "
        "update_time) VALUES ('', '', ?, 'geom', ?, ?, '', 1, ?, '', ?)",
        (layer.name, layer.name, layer_qml(layer.name), layer.title, date),
    )


def geometry_blobs(
    shapes: Sequence[Array | None], geometry: Geometry, srs: int
) -> list[bytes | None]:
    """Return shapes (m, 3) as geometries of GeoPackage, little-endian, with heights.

    Lines and polygons have the envelope min x, max x, min y, max y; points have none. Shapes with
    equal numbers of vertices are written at once.
    """
    out: list[bytes | None] = [None] * len(shapes)
    by_size: dict[int, list[int]] = {}
    for i, shape in enumerate(shapes):
        if shape is not None:
            by_size.setdefault(len(shape), []).append(i)
    for numbers in by_size.values():
        xyz = np.ascontiguousarray([shapes[i] for i in numbers], dtype="<f8")
        made = _blobs(xyz, geometry, srs)
        size = made.shape[1]
        text = made.tobytes()
        for n, i in enumerate(numbers):
            out[i] = text[n * size : (n + 1) * size]
    return out


def _blobs(xyz: Array, geometry: Geometry, srs: int) -> NDArray[np.uint8]:
    """Return the bytes (n, size) of n shapes (n, m, 3) of equally many vertices."""
    flags = 1 if geometry == "POINT" else 3
    parts = [_repeated(struct.pack("<2sBBi", b"GP", 0, flags, srs), len(xyz))]
    if geometry != "POINT":
        low, high = xyz.min(axis=1), xyz.max(axis=1)
        box = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
        parts.append(_bytes_of(box))
    head = struct.pack("<BI", 1, WKB_CODES[geometry])
    if geometry == "POLYGON":
        head += struct.pack("<I", 1)
    if geometry != "POINT":
        head += struct.pack("<I", xyz.shape[1])
    parts += [_repeated(head, len(xyz)), _bytes_of(xyz.reshape(len(xyz), -1))]
    return np.concatenate(parts, axis=1)


def _repeated(text: bytes, n: int) -> NDArray[np.uint8]:
    return np.tile(np.frombuffer(text, dtype=np.uint8), (n, 1))


def _bytes_of(numbers: Array) -> NDArray[np.uint8]:
    return np.ascontiguousarray(numbers, dtype="<f8").view(np.uint8)


def _type_of(values: Sequence[Any]) -> str:
    """Return the type of a column of texts, truth values, whole numbers or numbers."""
    known = {type(v) for v in values if v is not None}
    for kind, name in ((str, "TEXT"), (float, "DOUBLE"), (int, "INTEGER"), (bool, "BOOLEAN")):
        if kind in known:
            return name
    return "DOUBLE"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
