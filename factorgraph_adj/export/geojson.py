"""GeoJSON (RFC 7946): the layers of a solution in WGS 84 for web maps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..io.atomic import write_files
from ..quality.levels import CONFIDENCE
from ..types import Array
from .antimeridian import parts_of_line, parts_of_ring
from .layer import Drawn, Geometry, plain
from .layers import Map, Result, map_of, report_of
from .placing import wgs84_placing


def write_geojson(
    result: Result,
    path: str | Path,
    *,
    confidence: float | None = CONFIDENCE,
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
    placing = wgs84_placing(report.network, "GeoJSON")
    found = map_of(report, placing, Drawn(confidence, exaggeration, vector_exaggeration))
    file = Path(path)
    text = json.dumps(collection(found), ensure_ascii=False, allow_nan=False) + "\n"
    write_files(file.parent, {file.name: text})


def collection(found: Map) -> dict[str, Any]:
    """Return layers whose coordinates are longitude, latitude, height as a FeatureCollection."""
    return {
        "type": "FeatureCollection",
        "name": found.name,
        "adjustment": {name: plain(value) for name, value in found.facts.items()},
        "features": [
            {
                "type": "Feature",
                "geometry": None if shape is None else geometry_of(shape, layer.geometry),
                "properties": {"layer": layer.name, **record},
            }
            for layer in found.layers
            for shape, record in zip(layer.shapes, layer.records(), strict=True)
        ],
    }


def geometry_of(shape: Array, geometry: Geometry) -> dict[str, Any]:
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
