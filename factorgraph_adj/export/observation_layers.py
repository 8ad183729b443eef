"""Observations as lines and places, each with its residual and its test value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..graph.blocks import Block
from ..models.variables import VariableKind
from ..report.context import Report
from ..report.plots.in_frames import FramePlaces, instrument_of
from ..report.plots.sights import ends_of
from ..report.rows import Row, kind_name
from ..solve.solution import Solution
from ..types import Array, Index

MM = 1e-3
"""Millimetre, metres."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes in the frame of a network, with columns of data."""

    shapes: list[Array | None]
    """Places (m, 3) metres of each shape; None for what has no place."""
    columns: Mapping[str, Sequence[Any]]
    """Data of each shape."""


def observation_shapes(report: Report) -> dict[str, Shapes]:
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
            out[name] = Shapes([found[i][1] for i in chosen], own)
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
    ends = ends_of(block)
    if len(ends) == 3 and instrument_of(block) is not None:
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


def shift_shapes(solution: Solution) -> Shapes:
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
    columns |= {f"d{a}_mm": (d[:, i] / MM).tolist() for i, a in enumerate("xyz")}
    return Shapes(list(np.stack([ends - d, ends], axis=1)), columns)
