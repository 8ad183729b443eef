"""GeoPackage: the layers of a solution in one file for QGIS and other geographic programs.

OGC 12-128 (GeoPackage Encoding Standard 1.3): a SQLite database whose tables of features have a
geometry in the form "GP", version, flags, reference system, envelope, WKB. The styles of the layers
stand in the table ``layer_styles``, where QGIS looks for them.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..io.atomic import write_files
from ..quality.levels import CONFIDENCE
from ..types import Array
from .layer import Drawn, Geometry, Layer, plain
from .layers import Map, Result, map_of, report_of
from .placing import Placing, map_placing
from .qgis import style_of

APPLICATION, VERSION = 0x47504B47, 10300
"""Mark "GPKG" and version 1.3 in the header of the file."""
CODES: dict[Geometry, int] = {"POINT": 1001, "LINESTRING": 1002, "POLYGON": 1003}
"""Codes of geometries with heights in ISO WKB."""
CARTESIAN, GEOGRAPHIC = -1, 0
"""Identifiers of the undefined reference systems that every GeoPackage has."""
OWN = 100_000
"""Identifier of a reference system without an EPSG code."""
NO_DATE = "1970-01-01T00:00:00.000Z"
"""Time of files whose run has no date: the library looks at no clock."""
WGS84 = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,'
    'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,'
    'AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],'
    'AUTHORITY["EPSG","4326"]]'
)
TABLES = """
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


def write_geopackage(
    result: Result,
    path: str | Path,
    *,
    confidence: float | None = CONFIDENCE,
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
    drawn = Drawn(confidence, exaggeration, vector_exaggeration)
    report = report_of(result)
    found = map_of(report, map_placing(report.network), drawn)
    file = Path(path)
    write_files(file.parent, {file.name: geopackage(found, _date(report.provenance.run.date))})


def geopackage(found: Map, date: str = NO_DATE) -> bytes:
    """Return layers as the bytes of a GeoPackage.

    Args:
        found: the layers.
        date: time of change, in the form of ISO 8601 that GeoPackage demands.
    """
    connection = sqlite3.connect(":memory:")
    try:
        connection.execute(f"PRAGMA application_id = {APPLICATION}")
        connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.executescript(TABLES)
        srs = _add_systems(connection, found.placing)
        for layer in found.layers:
            _add_layer(connection, layer, srs, date)
        facts = [(n, None if plain(v) is None else str(plain(v))) for n, v in found.facts.items()]
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


def _add_systems(connection: sqlite3.Connection, placing: Placing) -> int:
    """Add the reference systems that every file has, and that of the map; return its identifier."""
    undefined = "undefined", "undefined coordinate reference system"
    rows = [
        ("Undefined Cartesian SRS", CARTESIAN, "NONE", CARTESIAN, *undefined),
        ("Undefined geographic SRS", GEOGRAPHIC, "NONE", GEOGRAPHIC, *undefined),
        ("WGS 84 geodetic", 4326, "EPSG", 4326, WGS84, "longitude, latitude; heights ellipsoidal"),
    ]
    srs = {"plane": CARTESIAN, "ellipsoid": GEOGRAPHIC, "wgs84": 4326, "grid": OWN}[placing.kind]
    if placing.kind == "grid" and placing.system is not None:
        code = placing.system.epsg
        srs = OWN if code is None else code
        owner = ("NONE", OWN) if code is None else ("EPSG", code)
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
    bounds = [plain(v) for v in (*every.min(axis=0).tolist(), *every.max(axis=0).tolist())]
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
            for shape, record in zip(blobs(layer.shapes, layer.geometry, srs), records, strict=True)
        ),
    )
    connection.execute(
        "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, "
        "f_geometry_column, styleName, styleQML, styleSLD, useAsDefault, description, owner, "
        "update_time) VALUES ('', '', ?, 'geom', ?, ?, '', 1, ?, '', ?)",
        (layer.name, layer.name, style_of(layer.name), layer.title, date),
    )


def blobs(shapes: Sequence[Array | None], geometry: Geometry, srs: int) -> list[bytes | None]:
    """Return shapes as `blob` does, those with equal numbers of vertices at once."""
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


def blob(shape: Array, geometry: Geometry, srs: int) -> bytes:
    """Return a shape (m, 3) as a geometry of GeoPackage, little-endian, with heights.

    Lines and polygons have the envelope min x, max x, min y, max y; points have none.
    """
    return bytes(_blobs(np.ascontiguousarray(shape, dtype="<f8")[None], geometry, srs).tobytes())


def _blobs(xyz: Array, geometry: Geometry, srs: int) -> NDArray[np.uint8]:
    """Return the bytes (n, size) of n shapes (n, m, 3) of equally many vertices."""
    flags = 1 if geometry == "POINT" else 3
    parts = [_repeated(struct.pack("<2sBBi", b"GP", 0, flags, srs), len(xyz))]
    if geometry != "POINT":
        low, high = xyz.min(axis=1), xyz.max(axis=1)
        box = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
        parts.append(_bytes_of(box))
    head = struct.pack("<BI", 1, CODES[geometry])
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
