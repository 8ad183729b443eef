"""KML 2.2 (OGC 07-147r2): the layers of a solution for Google Earth."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from ..io.atomic import write_files
from ..quality.levels import CONFIDENCE
from ..types import Array
from .layer import Drawn, Geometry, Layer, plain
from .layers import Map, Result, map_of, report_of
from .placing import wgs84_placing

SPACE = "http://www.opengis.net/kml/2.2"
ICON = "http://maps.google.com/mapfiles/kml/shapes/placemark_circle.png"
COLOURS = {
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
HIDDEN = ("image_points", "observations_at_points")
"""Layers that are not shown until somebody asks for them."""
ALLOWED = {9, 10, 13}
"""Control characters that XML has."""


def write_kml(
    result: Result,
    path: str | Path,
    *,
    confidence: float | None = CONFIDENCE,
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
    placing = wgs84_placing(report.network, "KML")
    found = map_of(report, placing, Drawn(confidence, exaggeration, vector_exaggeration))
    file = Path(path)
    write_files(file.parent, {file.name: document(found)})


def document(found: Map) -> bytes:
    """Return layers whose coordinates are longitude, latitude, height as a document of KML."""
    root = ET.Element("kml", xmlns=SPACE)
    top = ET.SubElement(root, "Document")
    _text(top, "name", found.name)
    facts = ((n, plain(v)) for n, v in found.facts.items())
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
    _text(icon, "color", COLOURS[name])
    _text(icon, "scale", "0.5")
    _text(ET.SubElement(icon, "Icon"), "href", ICON)
    line = ET.SubElement(style, "LineStyle")
    _text(line, "color", COLOURS[name])
    _text(line, "width", "1.5")
    _text(ET.SubElement(style, "PolyStyle"), "fill", "0")


def _folder(top: ET.Element, layer: Layer) -> None:
    folder = ET.SubElement(top, "Folder")
    _text(folder, "name", layer.name)
    _text(folder, "visibility", "0" if layer.name in HIDDEN else "1")
    _text(folder, "description", layer.title)
    every = zip(layer.shapes, layer.records(), strict=True)
    for number, (shape, record) in enumerate(every):
        mark = ET.SubElement(folder, "Placemark")
        _text(mark, "name", str(record.get("name", record.get("id", ""))))
        _text(mark, "visibility", "0" if layer.name in HIDDEN else "1")
        _text(mark, "styleUrl", f"#{layer.look(number)}")
        data = ET.SubElement(mark, "ExtendedData")
        if shape is not None and layer.geometry == "POINT":
            record["height_ellipsoidal_m"] = plain(float(shape[0, 2]))
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
    element.text = "".join(c if ord(c) >= 32 or ord(c) in ALLOWED else "\ufffd" for c in text)
