"""Markers, tie points and scale bars of a Metashape chunk."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ...errors import InputError, Problem
from ...network.network import Network
from ...observations import ControlPoint, SlopeDistance
from ...types import Array
from ..left_out import Reason
from .metashape_context import Context, cameras_of, listed, off
from .metashape_source import Place
from .ply import read_vertices
from .reading import FEW_RAYS, TIE, ImagePoints, finite

LOCATION_WITHOUT_PHOTO = Reason(
    "locations of markers", "their cameras are switched off or not aligned"
)
LOCATION_NOT_VALID = Reason("locations of markers", "the file says that they are not valid")
FILES_WITHOUT_PHOTO = Reason(
    "files of projections", "their cameras are switched off or not aligned"
)
BAR_NOT_USED = Reason("scale bars", "they are switched off, or have no length")

Numbers = npt.NDArray[np.int64]


def add_markers(context: Context, network: Network) -> dict[str, str]:
    """Add control and check points; return the names of all markers by their ids."""
    chunk, reading = context.source.chunk, context.reading
    out: dict[str, str] = {}
    labels: set[str] = set()
    for marker in listed(chunk.element, "markers", "marker"):
        ident, where = marker.attributes.get("id", ""), chunk.where(marker)
        label = marker.attributes.get("label", "") or f"marker {ident}"
        if ident in out or label in labels:
            reading.wrong(f"marker {label!r} is defined twice", where)
            continue
        out[ident] = label
        labels.add(label)
        element = marker.first("reference")
        if element is None or "x" not in element.attributes:
            continue
        found = context.given(element, "markers", where)
        if found is None:
            continue
        at, covariance = found
        with reading.at(where):
            if off(element):
                network.add_point(label, check=at)
                continue
            network.add_point(label, at)
            network.add(control_point(label, at, covariance, where))
    return out


def control_point(
    name: str, at: tuple[float, float, float], covariance: Array, source: str
) -> ControlPoint:
    """Return a control point, with standard deviations where its covariance has no correlation."""
    variance = np.diag(covariance)
    if (covariance - np.diag(variance)).any():
        return ControlPoint(name, at, covariance=covariance, source=source)
    return ControlPoint(name, at, sigma=tuple(np.sqrt(variance).tolist()), source=source)


def gather_locations(
    context: Context,
    images: ImagePoints,
    cameras: Mapping[str, str],
    markers: Mapping[str, str],
) -> None:
    """Gather the locations of markers in the photos that are read."""
    frame, reading = context.source.frame, context.reading
    if frame is None:
        return
    sigma = (context.accuracy["projections"],)
    known = _camera_ids(context)
    for marker in listed(frame.element, "markers", "marker"):
        ident = marker.attributes.get("marker_id", "")
        if ident not in markers:
            reading.wrong(f"unknown marker {ident!r}", frame.where(marker))
            continue
        for location in marker.all("location"):
            camera = location.attributes.get("camera_id", "")
            if camera not in known:
                reading.wrong(f"location in the unknown camera {camera!r}", frame.where(location))
            photo = cameras.get(camera)
            where = frame.where(location)
            if photo is None or location.attributes.get("valid") in ("false", "0"):
                why = LOCATION_WITHOUT_PHOTO if photo is None else LOCATION_NOT_VALID
                reading.leave_out(why, f"{markers[ident]} in camera {camera}", where)
                continue
            texts = [location.attributes.get(a) for a in "xy"]
            xy = reading.numbers(texts, 2, "location", where)
            if xy is not None:
                images.add(photo, markers[ident], (xy[0], -xy[1]), sigma, where)


def add_ties(
    context: Context,
    network: Network,
    ties: Place,
    images: ImagePoints,
    cameras: Mapping[str, str],
) -> None:
    """Add the tie points that two photos see at least, and gather their projections.

    Raises:
        InputError: a file is missing or damaged.
    """
    element = ties.element.first("points")
    if element is None:
        return
    content, file = ties.read(element)
    table = _columns(read_vertices(content, file), ("id", "x", "y", "z"), file)
    number = table["id"].astype(np.int64)
    xyz = np.stack([table[a].astype(float) for a in "xyz"], 1)
    if not finite(xyz):
        raise InputError(Problem("coordinates must be finite", file))
    if len(np.unique(number)) < len(number):
        raise InputError(Problem("a tie point has coordinates twice", file))
    placed = context.placed(_component(context))
    xyz = np.full_like(xyz, np.nan) if placed is None else placed.points(xyz)
    known = _camera_ids(context)
    for strange in ties.element.all("projections"):
        if (camera := strange.attributes.get("camera_id", "")) not in known:
            what = f"projections in the unknown camera {camera!r}"
            raise InputError(Problem(what, ties.where(strange)))
    projected = list(_projections(ties, cameras))
    seen = np.concatenate([np.unique(names) for _, names, _, _ in projected] or [number[:0]])
    values, counts = np.unique(seen, return_counts=True)
    used = np.isin(number, values[counts >= 2])
    for n in number[~used].tolist():
        context.reading.leave_out(FEW_RAYS, f"{TIE}{n}", file)
    for element in ties.element.all("projections"):
        if (camera := element.attributes.get("camera_id", "")) not in cameras:
            context.reading.leave_out(FILES_WITHOUT_PHOTO, f"camera {camera}", ties.where(element))
    network.add_points([f"{TIE}{n}" for n in number[used].tolist()], xyz[used])
    sigma = (context.accuracy["tiepoints"],)
    for photo, names, xy, where in projected:
        kept = np.isin(names, number[used])
        for n, (x, y) in zip(names[kept].tolist(), xy[kept].tolist(), strict=True):
            images.add(photo, f"{TIE}{n}", (x, -y), sigma, where)


def _camera_ids(context: Context) -> set[str]:
    """Return the ids of all cameras of the chunk, also of those that are not read."""
    return {c.attributes.get("id", "") for c in cameras_of(context.source.chunk.element)}


def _component(context: Context) -> str | None:
    """Return the id of the component whose transformation holds for tie points."""
    components = context.source.chunk.element.first("components")
    if components is None:
        return None
    first = components.first("component")
    alone = None if first is None else first.attributes.get("id")
    return components.attributes.get("active_id", alone)


def _projections(
    ties: Place, cameras: Mapping[str, str]
) -> Iterator[tuple[str, Numbers, Array, str]]:
    """Yield photo, numbers of tie points, coordinates (n, 2) and file of each photo."""
    for element in ties.element.all("projections"):
        photo = cameras.get(element.attributes.get("camera_id", ""))
        if photo is None:
            continue
        content, file = ties.read(element)
        table = _columns(read_vertices(content, file), ("x", "y", "id"), file)
        xy = np.stack([table["x"].astype(float), table["y"].astype(float)], 1)
        if not finite(xy):
            raise InputError(Problem("image coordinates must be finite", file))
        yield photo, table["id"].astype(np.int64), xy, file


def _columns(
    table: Mapping[str, npt.NDArray[np.generic]], names: Sequence[str], file: str
) -> dict[str, npt.NDArray[np.generic]]:
    """Return columns of a PLY table.

    Raises:
        InputError: one is missing, or holds numbers that are none.
    """
    absent = [n for n in names if n not in table]
    if absent:
        what = f"has no property {', '.join(absent)}; it has {', '.join(table)}"
        raise InputError(Problem(what, file))
    out = {n: table[n] for n in names}
    if not finite(np.asarray(out["id"], dtype=float)):
        raise InputError(Problem("numbers of tie points must be finite", file))
    return out


def add_scale_bars(context: Context, network: Network, markers: Mapping[str, str]) -> None:
    """Add the enabled scale bars between markers."""
    chunk, reading = context.source.chunk, context.reading
    for bar in listed(chunk.element, "scalebars", "scalebar"):
        element, where = bar.first("reference"), chunk.where(bar)
        if element is None or off(element) or "distance" not in element.attributes:
            name = bar.attributes.get("label", "") or bar.attributes.get("id", "")
            reading.leave_out(BAR_NOT_USED, name, where)
            continue
        said = element.attributes
        value = reading.number(said["distance"], "distance", where, positive=True)
        sigma: float | None = context.accuracy["scalebars"]
        text = said.get("accuracy", said.get("sd"))
        if text is not None and "scalebars" not in context.overridden:
            sigma = reading.number(text, "accuracy", where, positive=True)
        ends = [bar.attributes.get(k, "") for k in ("start_marker_id", "end_marker_id")]
        names = [markers[e] for e in ends if e in markers]
        if len(names) < 2:
            reading.wrong("a scale bar must join two markers, by start_marker_id …", where)
        elif value is not None and sigma is not None:
            with reading.at(where):
                bar_length = SlopeDistance(names[0], names[1], value, sigma=sigma, source=where)
                network.add(bar_length)
