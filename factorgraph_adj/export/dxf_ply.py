"""DXF drawings (extra ``dxf``) of points, ellipses and observations; PLY of points and photos."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, taking
from ..io.file_transaction import write_files
from ..network.network import Network
from ..report.adjustment_report import Report
from ..report.geodetic_coordinates import frame_in_words
from ..report.html.estimates import point_states
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..types import Array
from ..version import __version__
from .map_coordinates import drawing_coordinates
from .map_layers import (
    ExportedResult,
    Layer,
    MapScaling,
    SolutionMap,
    adjustment_of,
    report_of,
    solution_map,
)
from .map_shapes import VERTICES_OF_RING

EZDXF_MISSING = "a drawing needs ezdxf: pip install 'factorgraph_adj[dxf]'"
DXF_RELEASE = "R2010"
"""Version of the format: the first years whose files every CAD program of today reads, in UTF-8."""
DXF_UNIT_METRES = 6
"""Code of the unit of the drawing."""
MIN_RATIO_OF_AXES = 1e-6
"""Smallest ratio of the axes that DXF allows for an ellipse; a thinner one is a line."""
TEXT_HEIGHT_SHARE = 1 / 120
"""Height of texts, in the larger side of the drawing."""
POINT_DISPLAY_CROSS = 2
"""Display of points: a cross."""
DXF_LAYERS: dict[str, tuple[str, int]] = {
    "points": ("POINTS", 7),
    "names": ("POINT_NAMES", 7),
    "ellipses": ("ELLIPSES", 5),
    "observations": ("OBSERVATIONS", 8),
    "suspects": ("SUSPECTS", 1),
    "image_points": ("IMAGE_RAYS", 9),
    "photos": ("PHOTOS", 4),
    "photo_names": ("PHOTO_NAMES", 4),
    "footprints": ("FOOTPRINTS", 3),
    "vectors": ("VECTORS", 30),
    "displacements_moved": ("DISPLACEMENTS", 1),
    "displacements_kept": ("DISPLACEMENTS_NOT_SIGNIFICANT", 8),
    "notes": ("NOTES", 7),
}
"""Layer of the drawing and its colour (AutoCAD colour index) for each look of a layer of a map."""
ARROW_HEAD_SHARE = 0.2
"""Length of the two strokes of an arrow head, in the length of the arrow."""
PLY_VERTEX = np.dtype(
    [
        *((a, "<f8") for a in ("x", "y", "z")),
        *((f"sigma_{a}", "<f4") for a in "xyz"),
        *((c, "u1") for c in ("red", "green", "blue")),
        ("kind", "u1"),
    ]
)
"""One vertex; σ in metres, NaN where unknown."""
PLY_TYPES = {"<f8": "double", "<f4": "float", "|u1": "uchar"}
"""Names of the types of `PLY_VERTEX` in PLY."""
PLY_POINT_COLOURS = {
    "held": (0, 158, 115),
    "part": (0, 158, 115),
    "known": (0, 158, 115),
    "datum": (0, 158, 115),
    "check": (213, 94, 0),
    "station": (204, 121, 167),
    "new": (200, 200, 200),
    "side_shot": (240, 228, 66),
}
"""Colours of points by what they are."""
PLY_PHOTO_COLOUR = (0, 114, 178)
"""Colour of projection centres."""


@taking(ExportedResult)
def write_dxf(
    result: ExportedResult,
    path: str | Path,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
    exaggeration: float | None = None,
    vector_exaggeration: float | None = None,
    text_height: float | None = None,
    rays: bool = False,
) -> None:
    """Write a solution as a drawing: DXF of AutoCAD 2010, in metres.

    Layers are POINTS (POINT entities with heights), POINT_NAMES (TEXT), ELLIPSES (ELLIPSE entities;
    a LINE where the ellipse is one), OBSERVATIONS and SUSPECTS (LINE, once for each pair of
    places; suspects have a test value above the critical one), VECTORS (adjusted − given of check
    points and control), PHOTOS, PHOTO_NAMES and FOOTPRINTS, and NOTES with σ̂0, exaggerations and
    what the coordinates are. Coordinates are easting, northing, height of the reference system, or
    east, north, up of the frame.

    Args:
        result: the result of `adjust`, or its report with data snooping; or of `congruence`, or its
            report with blocks.
        path: the file, such as ``network.dxf``.
        confidence: as in `write_geopackage`.
        exaggeration: as in `write_geopackage`.
        vector_exaggeration: as in `write_geopackage`.
        text_height: height of texts, metres; None: in proportion to the drawing.
        rays: whether to draw image rays, on the layer IMAGE_RAYS.

    Raises:
        InputError: ezdxf is missing; the network is geocentric and its reference system has no
            grid; an option is out of range; or the file cannot be written.
    """
    report = report_of(result)
    refuse_drawing(report.network)
    placing = drawing_coordinates(report.network, "DXF")
    if text_height is not None and not text_height > 0:
        raise InputError(f"text_height must be greater than zero, not {text_height!r}")
    found = solution_map(report, placing, MapScaling(confidence, exaggeration, vector_exaggeration))
    file = Path(path)
    write_files(file.parent, {file.name: dxf_text(found, text_height, rays=rays)})


def refuse_drawing(network: Network) -> None:
    """Raise what forbids a drawing of a network.

    Raises:
        InputError: ezdxf is missing; the network is geocentric and has no grid.
    """
    if find_spec("ezdxf") is None:
        raise InputError(EZDXF_MISSING)
    drawing_coordinates(network, "DXF")


def dxf_text(found: SolutionMap, text_height: float | None = None, *, rays: bool = False) -> str:
    """Return layers in metres as the text of a DXF file."""
    import ezdxf

    # No dates and no random identifiers: the same solution gives the same file.
    before = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True
    try:
        return _drawn(ezdxf.new(DXF_RELEASE), found, text_height, rays=rays)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = before


def _drawn(document: Any, found: SolutionMap, text_height: float | None, *, rays: bool) -> str:
    document.units = DXF_UNIT_METRES
    pen = _Pen(document, _box(found), text_height)
    for layer in found.layers:
        if layer.name == "image_points" and not rays:
            continue
        _DRAW[layer.name](pen, layer)
    pen.notes([f"{n}: {v}" for n, v in found.facts.items()])
    stream = StringIO()
    document.write(stream)
    return stream.getvalue()


class _Pen:
    """Draws into a document of ezdxf."""

    def __init__(self, document: Any, box: tuple[Array, Array], text_height: float | None) -> None:
        """Prepare the layers; ``box`` has the corners of the drawing, metres."""
        self.space = document.modelspace()
        self.document, self.box = document, box
        extent = float(np.max((box[1] - box[0])[:2]))
        self.height = text_height or (TEXT_HEIGHT_SHARE * extent if extent > 0 else 1.0)
        document.header["$PDMODE"] = POINT_DISPLAY_CROSS
        document.header["$PDSIZE"] = 0.6 * self.height
        for name, colour in DXF_LAYERS.values():
            document.layers.add(name, color=colour)

    def line(self, layer: str, a: Array, b: Array) -> None:
        """Draw a line."""
        self.space.add_line(a.tolist(), b.tolist(), dxfattribs=_on(layer))

    def text(self, layer: str, text: str, at: Array) -> None:
        """Write a text right of a place."""
        shift = at + 0.6 * self.height * np.array([1.0, 1.0, 0.0])
        attributes = _on(layer) | {"height": self.height, "insert": tuple(shift.tolist())}
        self.space.add_text(" ".join(text.split()), dxfattribs=attributes)

    def notes(self, lines: list[str]) -> None:
        """Write lines below the drawing."""
        low, _ = self.box
        for i, text in enumerate(lines):
            at = np.array([low[0], low[1] - (4.0 + 1.8 * i) * self.height, 0.0])
            self.text("notes", text, at)


def _on(layer: str) -> dict[str, Any]:
    return {"layer": DXF_LAYERS[layer][0]}


def _points(pen: _Pen, layer: Layer) -> None:
    names = {"points": "names", "photos": "photo_names"}
    for shape, name in zip(layer.shapes, layer.columns["name"], strict=True):
        if shape is not None:
            pen.space.add_point(shape[0].tolist(), dxfattribs=_on(layer.name))
            pen.text(names[layer.name], str(name), shape[0])


def _ellipses(pen: _Pen, layer: Layer) -> None:
    for number, ring in enumerate(layer.shapes):
        if ring is None:
            continue
        look = layer.look(number)
        # The axes end at the first vertex, and at those a quarter and a half of the ring later.
        centre = (ring[0] + ring[VERTICES_OF_RING // 2]) / 2.0
        major = ring[0] - centre
        minor = ring[VERTICES_OF_RING // 4] - centre
        major[2] = 0.0
        size = float(np.hypot(*major[:2]))
        ratio = float(np.hypot(*minor[:2])) / size if size > 0 else 0.0
        if ratio < MIN_RATIO_OF_AXES:
            pen.line(look, ring[0], ring[VERTICES_OF_RING // 2])
            continue
        pen.space.add_ellipse(
            centre.tolist(), major.tolist(), min(ratio, 1.0), dxfattribs=_on(look)
        )


def _observations(pen: _Pen, layer: Layer) -> None:
    """Draw each line once; a suspect on it decides on its layer."""
    suspects = layer.columns.get("suspect", [False] * len(layer))
    lines: dict[tuple[Any, ...], tuple[Array, bool]] = {}
    for shape, suspect in zip(layer.shapes, suspects, strict=True):
        if shape is None:
            continue
        for a, b in pairwise(shape):
            key = tuple(sorted((tuple(a.tolist()), tuple(b.tolist()))))
            known = lines.get(key)
            lines[key] = (np.array([a, b]), bool(suspect) or (known is not None and known[1]))
    own = "image_points" if layer.name == "image_points" else "observations"
    for ends, suspect in lines.values():
        pen.line("suspects" if suspect else own, *ends)


def _lines(pen: _Pen, layer: Layer) -> None:
    for shape in layer.shapes:
        if shape is not None:
            pen.line(layer.name, shape[0], shape[1])


def _arrows(pen: _Pen, layer: Layer) -> None:
    """Draw lines with heads at their ends."""
    for number, shape in enumerate(layer.shapes):
        if shape is None:
            continue
        look, (a, b) = layer.look(number), shape
        pen.line(look, a, b)
        along, across = b - a, np.array([a[1] - b[1], b[0] - a[0], 0.0])
        for side in (0.5, -0.5):
            pen.line(look, b, b - ARROW_HEAD_SHARE * (along + side * across))


def _rings(pen: _Pen, layer: Layer) -> None:
    for ring in layer.shapes:
        if ring is not None:
            pen.space.add_polyline3d(ring[:-1].tolist(), close=True, dxfattribs=_on(layer.name))


def _nothing(pen: _Pen, layer: Layer) -> None:
    """Leave out observations of one place: the drawing has the point already."""


_DRAW: dict[str, Callable[[_Pen, Layer], None]] = {
    "points": _points,
    "photos": _points,
    "ellipses": _ellipses,
    "observations": _observations,
    "image_points": _observations,
    "observations_at_points": _nothing,
    "vectors": _lines,
    "footprints": _rings,
    "displacements": _arrows,
    "displacement_ellipses": _ellipses,
}


def _box(found: SolutionMap) -> tuple[Array, Array]:
    """Return the corners of what is drawn around the points and ellipses, metres."""
    shown = ("points", "ellipses", "photos", "displacement_ellipses")
    near = [x for x in found.layers if x.name in shown]
    places = [s for x in near for s in x.shapes if s is not None]
    every = np.concatenate(places) if places else np.zeros((1, 3))
    return every.min(axis=0), every.max(axis=0)


@taking(ExportedResult)
def write_ply(result: ExportedResult, path: str | Path, *, binary: bool = True) -> None:
    """Write adjusted points, and then projection centres, as the vertices of a PLY file.

    Vertices have x, y, z in the frame of the network (double, metres), sigma_x, sigma_y, sigma_z
    (float, metres), a colour, and ``kind``: 0 a point, 1 a projection centre. They are in the order
    of the network: PLY has no texts, and so no names. Grid coordinates are not Cartesian; use
    `write_geopackage` for them.

    Args:
        result: the result of `adjust`, or its report.
        path: the file, such as ``points.ply``.
        binary: whether numbers are binary (little-endian), or text with all digits.

    Raises:
        InputError: the result is a comparison of two epochs, or the file cannot be written.
    """
    report = adjustment_of(result, "PLY")
    file = Path(path)
    write_files(file.parent, {file.name: ply_content(report, binary=binary)})


def ply_content(report: Report, *, binary: bool = True) -> bytes:
    """Return the content of a PLY file."""
    solution, network = report.solution, report.network
    number = solution.equations.unknowns["pose"].number
    poses = solution.state["pose"][[number[n] for n in network.photos]]
    n = len(network.points)
    out = np.zeros(n + len(poses), dtype=PLY_VERTEX)
    xyz = np.concatenate([solution.state["point"], poses[:, 9:12]])
    sigmas = np.full(xyz.shape, np.nan)
    if not report.singular:
        sigmas[:n] = report.sigmas
        photos = [report.poses[p].sigma_position for p in network.photos]
        sigmas[n:] = np.array(photos).reshape(-1, 3)
    for i, a in enumerate("xyz"):
        out[a], out[f"sigma_{a}"] = xyz[:, i], sigmas[:, i]
    colours = [PLY_POINT_COLOURS[s] for s in point_states(report)] + [PLY_PHOTO_COLOUR] * len(poses)
    for i, colour in enumerate(("red", "green", "blue")):
        out[colour] = [c[i] for c in colours]
    out["kind"][n:] = 1
    head = [
        "ply",
        f"format {'binary_little_endian' if binary else 'ascii'} 1.0",
        f"comment factorgraph_adj {__version__}: {' '.join(network.name.split())}",
        "comment metres in the frame of the network; kind 0 point, 1 projection centre",
        f"comment frame: {frame_in_words(network.frame)}",
        f"element vertex {len(out)}",
        *(f"property {PLY_TYPES[PLY_VERTEX[c].str]} {c}" for c in PLY_VERTEX.names or ()),
        "end_header",
    ]
    start = ("\n".join(head) + "\n").encode("ascii", "replace")
    if binary:
        return start + out.tobytes()
    lines = (" ".join(str(v) for v in row) for row in out.tolist())
    return start + "".join(f"{line}\n" for line in lines).encode("ascii")
