"""Shapes with columns in the frame: points, ellipses, footprints, observations, differences.

A footprint is where the edge of the sensor meets the ground. Observations are lines and places,
each with its residual and its test value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..frames import Frame
from ..graph.blocks import Block
from ..graph.variables import calibration_name
from ..models.inverse_lens import sight_lines
from ..models.unknown_registry import VariableKind
from ..quality.error_ellipses import ErrorEllipse, error_ellipses
from ..report.adjusted_photos import image_statistics_by_photo
from ..report.adjustment_report import Report
from ..report.html.estimates import point_states
from ..report.observation_rows import Row, kind_name
from ..report.plots.drawing_plane import FramePlaces, instrument_place
from ..report.plots.image_residuals import ImageRows, image_rows
from ..report.plots.observation_lines import observation_ends
from ..solve.solution import Solution
from ..types import Array, Index
from ..units import MILLIMETRE

PARTS_OF_SENSOR_EDGE = 8
"""Parts of each edge of the sensor: the distortion bends the edges of a footprint."""
MIN_SINE_TO_GROUND = 0.05
"""Smallest sine of the angle between a ray and the ground; beyond it the photo looks over the
horizon, and has no footprint."""
VERTICES_OF_RING = 72
"""Vertices of a ring; the axes of the ellipse end at four of them."""


@dataclass(frozen=True, eq=False)
class Footprints:
    """Footprints of the photos that have one."""

    names: list[str]
    """Names of the photos."""
    cameras: list[str]
    """Names of their cameras."""
    rings: list[Array | None]
    """Closed rings (m, 3), counter-clockwise seen from above, metres in the frame."""


def footprints(solution: Solution) -> Footprints:
    """Return the footprints of photos on the ground.

    The ground of a photo is the plane level at the mean of its object points, at the median of
    their heights. A photo without points has none, and so have photos that look along the ground
    (terrestrial and oblique ones with the horizon in the picture). The sensor is that of the
    camera, or the area of its image points where no format is stated.
    """
    network = solution.network
    rows = image_rows(solution)
    points = solution.state["point"]
    found = Footprints([], [], [])
    order = np.argsort(rows.photo, kind="stable")
    start = np.searchsorted(rows.photo[order], np.arange(len(network.photos) + 1))
    number = solution.equations.unknowns["pose"].number
    edges = {name: _edge(rows, name) for name in network.cameras}
    for name, photo in network.photos.items():
        i = number[name]
        seen = points[rows.point[order[start[i] : start[i + 1]]]]
        seen = seen[np.isfinite(seen).all(axis=1)]
        edge = edges[photo.camera]
        if not len(seen) or edge is None:
            continue
        ring = _ring(solution, name, i, edge, seen)
        if ring is not None:
            found.names.append(name)
            found.cameras.append(photo.camera)
            found.rings.append(ring)
    return found


def _edge(rows: ImageRows, camera: str) -> Array | None:
    """Return points of the edge of the sensor, (4 STEPS, 2) image units."""
    stated = rows.solution.network.cameras[camera]
    corners = stated.corners() or rows.areas.get(camera)
    if corners is None or not np.all(corners[1] > corners[0]):
        return None
    (left, low), (right, high) = corners
    around = np.array([[left, low], [right, low], [right, high], [left, high], [left, low]])
    t = np.arange(PARTS_OF_SENSOR_EDGE) / PARTS_OF_SENSOR_EDGE
    return np.concatenate([a + t[:, None] * (b - a) for a, b in pairwise(around)])


def _ring(solution: Solution, name: str, pose: int, edge: Array, seen: Array) -> Array | None:
    """Return the footprint of a photo; None if a ray does not meet the ground.

    A photo of a rolling shutter has that of its middle row.
    """
    network, state = solution.network, solution.state
    lens = network.cameras[network.photos[name].camera].lens
    number = solution.number("calibration", calibration_name(network, name))
    k = state["calibration"][None, number, : len(lens.names)]
    stored = state["pose"][pose]
    starts, rays = (x @ stored[:9].reshape(3, 3).T for x in sight_lines(lens, edge, k))
    middle = seen.mean(axis=0)
    east, north, up = network.frame.basis(middle[None], np.zeros((1, 2))).enu[0]
    ground = float(np.median((seen - middle) @ up))
    centres = stored[9:12] + starts
    down = rays @ up
    below = ground - (centres - middle) @ up
    with np.errstate(divide="ignore", invalid="ignore"):
        t = below / down
    if not (np.isfinite(t).all() and (t > 0).all() and (np.abs(down) > MIN_SINE_TO_GROUND).all()):
        return None
    ring = centres + t[:, None] * rays
    x, y = (ring - middle) @ east, (ring - middle) @ north
    if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0:
        ring = ring[::-1]
    return np.asarray(np.concatenate([ring, ring[:1]]))


@dataclass(frozen=True, eq=False)
class FrameShapes:
    """Shapes in the frame of a network, with columns of data."""

    shapes: list[Array | None]
    """Places (m, 3) metres of each shape; None for what has no place."""
    columns: Mapping[str, Sequence[Any]]
    """Data of each shape."""


def observation_shapes(report: Report) -> dict[str, FrameShapes]:
    """Return the scalar observations by layer, those with the largest test values last.

    Layers are ``image_points`` (from photo to point), ``observations`` (from place to place; an
    angle goes from target over station to target) and ``observations_at_points`` (of one place, and
    given values of unknowns, which have none).
    """
    rows = report.rows.all()
    values = report.tests[0]
    size = np.abs(values) if len(values) else np.full(len(rows), np.nan)
    order = np.argsort(np.where(np.isfinite(size), size, -1.0), kind="stable")
    found = _places(report.solution)
    columns = _columns(report, rows)
    out = {}
    for name in ("image_points", "observations", "observations_at_points"):
        chosen = [i for i in order.tolist() if found[i][0] == name]
        if chosen:
            own = {c: [v[i] for i in chosen] for c, v in columns.items()}
            out[name] = FrameShapes([found[i][1] for i in chosen], own)
    return out


def _columns(report: Report, rows: Sequence[Row]) -> dict[str, Sequence[Any]]:
    """Return what identifies each row, v, σ, and the figures of reliability."""
    columns: dict[str, Sequence[Any]] = dict(report.rows.identities)
    columns["kind"] = [r.kind_name for r in rows]
    size = np.array([r.scale.size for r in rows], dtype=float)
    sign = np.array([r.sign for r in rows], dtype=float)
    table = report.solution.observations
    columns |= {
        "residual": (sign * table.residuals / size).tolist(),
        "sigma": (table.sigmas / size).tolist(),
        "small_unit": [r.scale.small for r in rows],
        "normalised": (sign * table.normalised).tolist(),
    }
    rel = report.reliability
    if rel is not None:
        values, critical = report.tests
        columns |= {
            "redundancy_number": rel.redundancy_numbers.tolist(),
            "w": (sign * rel.w).tolist(),
            "tau": (sign * rel.tau).tolist(),
            "suspect": (np.abs(np.nan_to_num(values)) > critical).tolist(),
            "mdb": (rel.mdb / size).tolist(),
            "estimated_error": (sign * rel.estimated_errors / size).tolist(),
        }
    columns["source"] = [r.source for r in rows]
    return columns


def _places(solution: Solution) -> list[tuple[str, Array | None]]:
    """Return layer and places of every scalar row."""
    out: list[tuple[str, Array | None]] = []
    for block in solution.equations.blocks:
        ends = [_at(solution, kind, index) for kind, index in _path(block)]
        name = "observations_at_points"
        shapes: list[Array | None] = [None] * block.n
        if ends:
            shapes = list(np.stack(ends, axis=1))
        if len(ends) > 1:
            name = "observations" if block.lens is None else "image_points"
        out += [(name, s) for s in shapes for _ in range(block.dimension)]
    return out


def _path(block: Block) -> list[tuple[VariableKind, Index]]:
    """Return the places of a block in the order in which a line joins them."""
    ends = observation_ends(block)
    if len(ends) == 3 and instrument_place(block) is not None:
        return [ends[1], ends[0], ends[2]]
    return ends


def _at(solution: Solution, kind: VariableKind, index: Index) -> Array:
    """Return places of variables, (n, 3) metres in the frame of the network."""
    if kind == "frame":
        frames = FramePlaces(solution)
        own, back = np.unique(index, return_inverse=True)
        return np.array([frames.places(f, np.zeros((1, 3)))[0] for f in own.tolist()])[back]
    state = solution.state[kind]
    return np.asarray(state[index][:, 9:12] if kind == "pose" else state[index])


def coordinate_differences(solution: Solution) -> FrameShapes:
    """Return vectors adjusted − given, in true size, of check points and of control.

    A component that is not given has no difference.
    """
    names: list[str] = []
    what: list[str] = []
    places: list[Array] = []
    shifts: list[Array] = []
    number = solution.equations.unknowns["point"].number
    for name, given in solution.network.points.items():
        if given.check is None:
            continue
        at = solution.state["point"][number[name]]
        names.append(name)
        what.append("check point")
        places.append(at)
        shifts.append(np.nan_to_num(at - np.array(given.check, dtype=float)))
    residuals = solution.observations.residuals
    points = list(solution.network.points)
    for block in solution.equations.blocks:
        if not block.by_axis:
            continue
        v = residuals[block.rows]
        by_id: dict[tuple[str, int], Array] = {}
        for i, (ident, point) in enumerate(
            zip(block.ids, block.variables[0][1].tolist(), strict=True)
        ):
            # The ids of given coordinates name their axis.
            of = "" if block.prior else str(ident)
            shift = by_id.setdefault((of, point), np.zeros(3))
            # Components are along axes of the frame, or along east, north and up.
            shift += v[i] * block.constants["axis"][i]
        for (_, point), shift in by_id.items():
            names.append(points[point])
            what.append(kind_name(block.kind, weighted=block.prior))
            places.append(solution.state["point"][point])
            shifts.append(shift)
    d = np.array(shifts).reshape(-1, 3)
    ends = np.array(places).reshape(-1, 3)
    columns: dict[str, Sequence[Any]] = {"name": names, "kind": what}
    columns |= {f"d{a}_mm": (d[:, i] / MILLIMETRE).tolist() for i, a in enumerate("xyz")}
    return FrameShapes(list(np.stack([ends - d, ends], axis=1)), columns)


def point_data(report: Report) -> dict[str, Sequence[Any]]:
    """Return name, status, coordinates, σ, σ along east, north, up, and check differences."""
    solution, given = report.solution, report.network.points
    xyz = solution.state["point"]
    columns: dict[str, Sequence[Any]] = {"name": list(given), "status": point_states(report)}
    columns |= {a: xyz[:, i].tolist() for i, a in enumerate("xyz")}
    if not report.singular:
        covariances = solution.point_covariances
        enu = report.network.frame.basis(xyz, np.zeros((len(xyz), 2))).enu
        along = np.einsum("nai,nij,naj->na", enu, covariances, enu)
        for names, variances in (
            ("xyz", np.einsum("nii->ni", covariances)),
            (("east", "north", "up"), along),
        ):
            sigma = np.sqrt(np.maximum(variances, 0.0)) / MILLIMETRE
            columns |= {f"sigma_{a}_mm": sigma[:, i].tolist() for i, a in enumerate(names)}
    check = [p.check for p in given.values()]
    if any(c is not None for c in check):
        nothing = (np.nan,) * 3
        known = np.array([nothing if c is None else c for c in check], dtype=float)
        off = (xyz - known.reshape(-1, 3)) / MILLIMETRE
        columns |= {f"check_d{a}_mm": off[:, i].tolist() for i, a in enumerate("xyz")}
    return columns


def photo_data(report: Report) -> dict[str, Sequence[Any]]:
    """Return name, camera, projection centre, angles, σ, and the image points of each photo."""
    photos = report.network.photos
    names = list(photos)
    counts, norms = image_statistics_by_photo(report)
    number = report.solution.equations.unknowns["pose"].number
    stored = report.solution.state["pose"][[number[n] for n in names]]
    columns: dict[str, Sequence[Any]] = {
        "name": names,
        "camera": [f.camera for f in photos.values()],
    }
    columns |= {a: stored[:, 9 + i].tolist() for i, a in enumerate("xyz")}
    if not report.singular:
        poses = [report.poses[n] for n in names]
        angles = np.degrees([p.angles for p in poses])
        off = np.array([p.sigma_position for p in poses]) / MILLIMETRE
        turned = np.degrees([p.sigma_angles for p in poses])
        about = ("omega", "phi", "kappa")
        columns |= {f"{a}_deg": angles[:, i].tolist() for i, a in enumerate(about)}
        columns |= {f"sigma_{a}_mm": off[:, i].tolist() for i, a in enumerate("xyz")}
        columns |= {f"sigma_{a}_deg": turned[:, i].tolist() for i, a in enumerate(about)}
    columns["image_points"] = [counts[n] for n in names]
    columns["normalised_rms"] = [norms[n] for n in names]
    return columns


@dataclass(frozen=True, eq=False)
class EllipseShapes:
    """Error ellipses of the points that have one."""

    names: list[str]
    """Names of the points."""
    centres: Array
    """Adjusted places, (n, 3) metres in the frame."""
    semi_axes: Array
    """Semi-major and semi-minor axes, (n, 2) metres."""
    azimuths: Array
    """Azimuths of the major axes, clockwise from north, (n,) radians."""
    axes: Array
    """Unit vectors along the major axis, and 90° counter-clockwise from it, (n, 2, 3) in the
    frame."""

    def columns(self) -> dict[str, Sequence[Any]]:
        """Return name, semi-axes and azimuth of each ellipse."""
        return {
            "name": self.names,
            "semi_major_mm": (self.semi_axes[:, 0] / MILLIMETRE).tolist(),
            "semi_minor_mm": (self.semi_axes[:, 1] / MILLIMETRE).tolist(),
            "azimuth_deg": np.degrees(self.azimuths).tolist(),
        }

    def rings(self, factor: float) -> list[Array]:
        """Return closed rings, counter-clockwise from the end of the major axis, in the frame."""
        t = np.linspace(0.0, 2.0 * np.pi, VERTICES_OF_RING + 1)
        t[-1] = 0.0
        turn = np.stack([np.cos(t), np.sin(t)], axis=1)
        scaled = factor * self.semi_axes[:, :, None] * self.axes
        return list(self.centres[:, None] + np.einsum("mk,nki->nmi", turn, scaled))


def ellipse_shapes(solution: Solution, confidence: float | None) -> EllipseShapes:
    """Return the error ellipses of all points whose plan position is not held."""
    return ellipses_with_size(
        error_ellipses(solution, confidence=confidence), solution.network.frame
    )


def ellipses_with_size(ellipses: Sequence[ErrorEllipse], frame: Frame) -> EllipseShapes:
    """Return those of some ellipses in a frame that have a size."""
    found = [e for e in ellipses if e.semi_axes[0] > 0]
    centres = np.array([e.centre for e in found]).reshape(-1, 3)
    azimuths = np.array([e.azimuth for e in found])
    enu = frame.basis(centres, np.zeros((len(centres), 2))).enu
    sine, cosine = np.sin(azimuths)[:, None], np.cos(azimuths)[:, None]
    east, north = enu[:, 0], enu[:, 1]
    axes = np.stack([sine * east + cosine * north, sine * north - cosine * east], axis=1)
    sizes = np.array([e.semi_axes for e in found]).reshape(-1, 2)
    return EllipseShapes([str(e.a) for e in found], centres, sizes, azimuths, axes)
