"""GeoJSON (RFC 7946), cut at 180°, and KML 2.2 (OGC 07-147r2): layers in WGS 84 for web maps.

GeoJSON shapes that cross the meridian of 180° are cut there, as RFC 7946 (3.1.9) asks for.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ..errors import taking
from ..io.file_transaction import write_files
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..types import Array
from .map_coordinates import wgs84_map_coordinates
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

CIRCLE_DEG, HALF_CIRCLE_DEG = 360.0, 180.0
"""The circle and its half, degrees."""
KML_NAMESPACE = "http://www.opengis.net/kml/2.2"
KML_ICON = "http://maps.google.com/mapfiles/kml/shapes/placemark_circle.png"
KML_COLOURS = {
    "points": "ff000000",
    "ellipses": "ffb27200",
    "observations": "ff6e6e6e",
    "image_points": "466e6e6e",
    "observations_at_points": "ff005ed5",
    "photos": "ffb27200",
    "footprints": "ff739e00",
    "vectors": "ff005ed5",
    "displacements_moved": "ff005ed5",
    "displacements_kept": "ff8c8c8c",
}
"""Colour of each look of a layer as alpha, blue, green, red."""
HIDDEN_LAYERS = ("image_points", "observations_at_points")
"""Layers that are not shown until somebody asks for them."""
XML_CONTROL_CHARACTERS = {9, 10, 13}
"""Control characters that XML has."""


def parts_of_line(shape: Array) -> list[Array]:
    """Return the parts of a line (m, 3) on either side of the meridian of 180°.

    Neighbouring vertices that are more than 180° apart are joined across it. A part begins at +180
    or −180 with the height of the crossing.
    """
    x = _continued(shape)
    side = np.floor((x[:, 0] + HALF_CIRCLE_DEG) / CIRCLE_DEG)
    parts, current = [], [x[0]]
    for a, b, sa, sb in zip(x, x[1:], side, side[1:], strict=False):
        if sa != sb:
            at = HALF_CIRCLE_DEG + CIRCLE_DEG * min(sa, sb)
            crossing = a + (at - a[0]) / (b[0] - a[0]) * (b - a)
            parts.append(_within_circle([*current, crossing], sa))
            current = [crossing]
        current.append(b)
    parts.append(_within_circle(current, side[-1]))
    return [p for p in parts if len(p) > 1]


def parts_of_ring(ring: Array) -> list[Array]:
    """Return the parts of a convex or simple closed ring (m, 3) on either side of 180°.

    The order of the vertices, and so the side on which the area is, stays.
    """
    x = _continued(ring)
    sides = np.unique(np.floor((x[:, 0] + HALF_CIRCLE_DEG) / CIRCLE_DEG))
    if len(sides) == 1:
        return [_within_circle(list(x), sides[0])]
    out = []
    for side in sides:
        part = list(x[:-1])
        for edge, sign in (
            (CIRCLE_DEG * side - HALF_CIRCLE_DEG, 1.0),
            (CIRCLE_DEG * side + HALF_CIRCLE_DEG, -1.0),
        ):
            part = _clipped(part, edge, sign)
        if len(part) > 2:
            out.append(_within_circle([*part, part[0]], side))
    return out


def _continued(shape: Array) -> Array:
    """Return vertices whose longitudes go on beyond 180° instead of jumping."""
    out = np.array(shape, dtype=float)
    out[:, 0] = np.unwrap(out[:, 0], period=CIRCLE_DEG)
    return out


def _within_circle(part: list[Array], side: float) -> Array:
    out = np.array(part)
    out[:, 0] -= CIRCLE_DEG * side
    return out


def _clipped(ring: list[Array], edge: float, sign: float) -> list[Array]:
    """Return the part of an open ring where sign (x − edge) ≥ 0 (Sutherland and Hodgman)."""
    out: list[Array] = []
    for a, b in zip([*ring[-1:], *ring[:-1]], ring, strict=True):
        da, db = sign * (a[0] - edge), sign * (b[0] - edge)
        if (da < 0) != (db < 0):
            out.append(a + (edge - a[0]) / (b[0] - a[0]) * (b - a))
        if db >= 0:
            out.append(b)
    return out


@taking(ExportedResult)
def write_geojson(
    result: ExportedResult,
    path: str | Path,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
    exaggeration: float | None = None,
    vector_exaggeration: float | None = None,
) -> None:
    """Write a solution as GeoJSON: one collection of the layers of `write_geopackage`.

    Positions are longitude, latitude in degrees and the height above the ellipsoid WGS 84 in
    metres, all digits. The property ``layer`` of a feature names its layer, further ones are its
    columns. The member ``adjustment`` of the collection has σ̂0, exaggerations, and the operation
    from the datum of the network to WGS 84 with its accuracy (metres; often much coarser than σ).
    Rings are counter-clockwise; what crosses the meridian of 180° is cut there.

    Args:
        result: the result of `adjust`, or its report with data snooping; or of `congruence`, or its
            report with blocks.
        path: the file, such as ``network.geojson``.
        confidence: as in `write_geopackage`.
        exaggeration: as in `write_geopackage`.
        vector_exaggeration: as in `write_geopackage`.

    Raises:
        InputError: the network has no reference system, pyproj or a geoid is missing, an option is
            out of range, or the file cannot be written.
    """
    report = report_of(result)
    placing = wgs84_map_coordinates(report.network, "GeoJSON")
    found = solution_map(report, placing, MapScaling(confidence, exaggeration, vector_exaggeration))
    file = Path(path)
    text = json.dumps(feature_collection(found), ensure_ascii=False, allow_nan=False) + "\n"
    write_files(file.parent, {file.name: text})


def feature_collection(found: SolutionMap) -> dict[str, Any]:
    """Return layers whose coordinates are longitude, latitude, height as a FeatureCollection."""
    return {
        "type": "FeatureCollection",
        "name": found.name,
        "adjustment": {name: plain_value(value) for name, value in found.facts.items()},
        "features": [
            {
                "type": "Feature",
                "geometry": None if shape is None else geojson_geometry(shape, layer.geometry),
                "properties": {"layer": layer.name, **record},
            }
            for layer in found.layers
            for shape, record in zip(layer.shapes, layer.records(), strict=True)
        ],
    }


def geojson_geometry(shape: Array, geometry: Geometry) -> dict[str, Any]:
    """Return a shape (m, 3) as a geometry; one that crosses 180° has several parts."""
    if geometry == "POINT":
        return {"type": "Point", "coordinates": shape[0].tolist()}
    if geometry == "LINESTRING":
        lines = [p.tolist() for p in parts_of_line(shape)]
        one, several = "LineString", "MultiLineString"
    else:
        lines = [[p.tolist()] for p in parts_of_ring(shape)]
        one, several = "Polygon", "MultiPolygon"
    if len(lines) == 1:
        return {"type": one, "coordinates": lines[0]}
    return {"type": several, "coordinates": lines}


@taking(ExportedResult)
def write_kml(
    result: ExportedResult,
    path: str | Path,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
    exaggeration: float | None = None,
    vector_exaggeration: float | None = None,
) -> None:
    """Write a solution as KML: a folder for each of the layers of `write_geopackage`.

    Everything lies on the ground. Altitudes of KML are above the geoid EGM96, and heights above the
    ellipsoid would be tens of metres off: they stand in the data of points and photos as
    ``height_ellipsoidal_m``. A network of a mine or a tunnel is shown above it.

    Args:
        result: the result of `adjust`, or its report with data snooping; or of `congruence`, or its
            report with blocks.
        path: the file, such as ``network.kml``.
        confidence: as in `write_geopackage`.
        exaggeration: as in `write_geopackage`.
        vector_exaggeration: as in `write_geopackage`.

    Raises:
        InputError: as `write_geojson`.
    """
    report = report_of(result)
    placing = wgs84_map_coordinates(report.network, "KML")
    found = solution_map(report, placing, MapScaling(confidence, exaggeration, vector_exaggeration))
    file = Path(path)
    write_files(file.parent, {file.name: kml_document(found)})


def kml_document(found: SolutionMap) -> bytes:
    """Return layers whose coordinates are longitude, latitude, height as a document of KML."""
    root = ET.Element("kml", xmlns=KML_NAMESPACE)
    top = ET.SubElement(root, "Document")
    _text(top, "name", found.name)
    facts = ((n, plain_value(v)) for n, v in found.facts.items())
    _text(top, "description", "\n".join(f"{n}: {v}" for n, v in facts if v is not None))
    for look in dict.fromkeys(x.look(i) for x in found.layers for i in range(len(x))):
        _style(top, look)
    # What is drawn last is on top; people look for points first.
    for layer in reversed(found.layers):
        _folder(top, layer)
    ET.indent(root, " ")
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _style(top: ET.Element, name: str) -> None:
    style = ET.SubElement(top, "Style", id=name)
    icon = ET.SubElement(style, "IconStyle")
    _text(icon, "color", KML_COLOURS[name])
    _text(icon, "scale", "0.5")
    _text(ET.SubElement(icon, "Icon"), "href", KML_ICON)
    line = ET.SubElement(style, "LineStyle")
    _text(line, "color", KML_COLOURS[name])
    _text(line, "width", "1.5")
    _text(ET.SubElement(style, "PolyStyle"), "fill", "0")


def _folder(top: ET.Element, layer: Layer) -> None:
    folder = ET.SubElement(top, "Folder")
    _text(folder, "name", layer.name)
    _text(folder, "visibility", "0" if layer.name in HIDDEN_LAYERS else "1")
    _text(folder, "description", layer.title)
    every = zip(layer.shapes, layer.records(), strict=True)
    for number, (shape, record) in enumerate(every):
        mark = ET.SubElement(folder, "Placemark")
        _text(mark, "name", str(record.get("name", record.get("id", ""))))
        _text(mark, "visibility", "0" if layer.name in HIDDEN_LAYERS else "1")
        _text(mark, "styleUrl", f"#{layer.look(number)}")
        data = ET.SubElement(mark, "ExtendedData")
        if shape is not None and layer.geometry == "POINT":
            record["height_ellipsoidal_m"] = plain_value(float(shape[0, 2]))
        for name, value in record.items():
            if value is not None and value != "":
                _text(ET.SubElement(data, "Data", name=name), "value", str(value))
        if shape is not None:
            _geometry(mark, shape, layer.geometry)


def _geometry(mark: ET.Element, shape: Array, geometry: Geometry) -> None:
    """Add a geometry on the ground: longitude,latitude of each vertex."""
    names = {"POINT": "Point", "LINESTRING": "LineString", "POLYGON": "Polygon"}
    element = ET.SubElement(mark, names[geometry])
    if geometry != "POINT":
        _text(element, "tessellate", "1")
    _text(element, "altitudeMode", "clampToGround")
    if geometry == "POLYGON":
        element = ET.SubElement(ET.SubElement(element, "outerBoundaryIs"), "LinearRing")
    _text(element, "coordinates", " ".join(f"{x!r},{y!r}" for x, y, _ in shape.tolist()))


def _text(parent: ET.Element, tag: str, text: str) -> None:
    """Add an element with a text, without the characters that XML cannot hold."""
    element = ET.SubElement(parent, tag)
    element.text = "".join(
        c if ord(c) >= 32 or ord(c) in XML_CONTROL_CHARACTERS else "\ufffd" for c in text
    )
