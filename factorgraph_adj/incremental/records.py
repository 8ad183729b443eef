"""What stands in the lines of a journal, and how they are read back.

The first line has the options and the network at the start as the files of a project. Every
other line is one change that counts: what was asked (``do``), new points, photos and cameras,
the observations that are new or changed, and the ids that became ``accepted``, ``waiting``,
``suspect``, ``rejected`` or ``gone``, in that order. Reading back needs no test again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import InputError, Problem
from ..io.json_records import (
    camera_fields,
    camera_of,
    network_files,
    network_of,
    observation_fields,
    observation_of,
    photo_fields,
    photo_of,
    point_fields,
    point_of,
)
from ..network.entities import Camera, Photo, Point
from ..network.network import Network
from ..observations import Correlated, ImagePoint
from ..types import Array
from .book import Book
from .units import Unit, unit_of
from .verdicts import Verdict

OUTCOMES = ("accepted", "waiting", "suspect", "rejected", "gone")
_FIGURES = ("innovation", "sigma", "w", "redundancy_numbers")


def header(network: Network, options: Mapping[str, object]) -> dict[str, Any]:
    """Return the first line."""
    return {"options": dict(options), "files": network_files(network)}


def start_of(line: Mapping[str, Any]) -> tuple[Network, dict[str, Any]]:
    """Return network and options of the first line."""
    return network_of(line["files"]), dict(line["options"])


def entities(
    points: Iterable[Point], photos: Iterable[Photo], cameras: Iterable[Camera]
) -> dict[str, Any]:
    """Return the fields of what is new beside observations."""
    found = {
        "cameras": [camera_fields(c) for c in cameras],
        "points": [point_fields(p) for p in points],
        "photos": [photo_fields(f) for f in photos],
    }
    return {k: v for k, v in found.items() if v}


def definition(network: Network, unit: Unit) -> dict[str, Any]:
    """Return the fields of a unit, with the ids of its observations."""
    item = unit.item
    if isinstance(item, Correlated):
        return dict(observation_fields(item, id=list(unit.ids)))
    unit_name = "mm"
    if isinstance(item, ImagePoint):
        unit_name = network.cameras[network.photos[item.photo].camera].unit
        own = None if item.id is None else unit.ids[0]
        return dict(observation_fields(item, id=own, unit=unit_name))
    return dict(observation_fields(item, id=unit.ids[0], unit=unit_name))


def figures(verdict: Verdict) -> dict[str, Any]:
    """Return the numbers of a verdict; those that are not finite are left out."""
    out: dict[str, Any] = {"components": list(verdict.components), "dof": verdict.dof}
    for name in _FIGURES:
        values = getattr(verdict, name)
        if values is not None:
            out[name] = [x if math.isfinite(x) else None for x in values.tolist()]
    for name in ("t2", "critical"):
        value = getattr(verdict, name)
        if math.isfinite(value):
            out[name] = value
    return out


def outcome(
    network: Network,
    units: Sequence[Unit],
    verdicts: Iterable[Verdict],
) -> dict[str, Any]:
    """Return what a line says of an arrival."""
    out: dict[str, Any] = {"observations": [definition(network, u) for u in units]}
    for v in verdicts:
        where = out.setdefault(v.verdict, {} if v.verdict in ("suspect", "rejected") else [])
        if isinstance(where, dict):
            where[v.id] = figures(v)
        else:
            where.append(v.id)
    return out


def difference(before: Book, after: Book) -> dict[str, Any]:
    """Return what a line says of a change: everything that is not where or what it was."""
    out: dict[str, Any] = {}
    changed: dict[str, Unit] = {}
    for ident, (old, new) in after.changed.items():
        status = after.status(ident)
        was = before.status(ident)
        if new is None:
            if was != "gone":
                out.setdefault("gone", []).append(ident)
            continue
        redefined = old is None or not _same(old, new)
        if was == "gone" or redefined:
            changed[new.ids[0]] = new
        if status == was and not redefined:
            continue
        where = out.setdefault(status, {} if status in ("suspect", "rejected") else [])
        if isinstance(where, dict):
            kept = (after.suspects if status == "suspect" else after.rejected)[new.ids[0]]
            where[ident] = next((figures(v) for v in kept[1] if v.id == ident), {})
        else:
            where.append(ident)
    if changed:
        out["observations"] = [definition(after.network, u) for u in changed.values()]
    if after.filled:
        out["found"] = after.filled
    if after.unweighted:
        out["unweighted"] = after.unweighted
    return out


def _same(a: Unit, b: Unit) -> bool:
    if a is b:
        return True
    if a.ids != b.ids or not _same_covariance(a.covariance, b.covariance):
        return False
    return all(
        _same_observation(vars_of(x), vars_of(y))
        for x, y in zip(a.observations, b.observations, strict=True)
    )


def _same_covariance(a: Array | None, b: Array | None) -> bool:
    return a is b if a is None or b is None else np.array_equal(a, b)


def vars_of(o: object) -> dict[str, Any]:
    """Return the fields of a frozen dataclass."""
    return {k: getattr(o, k) for k in o.__dataclass_fields__}  # type: ignore[attr-defined]


def _same_observation(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    return a.keys() == b.keys() and all(
        np.array_equal(a[k], b[k]) if isinstance(a[k], np.ndarray) else a[k] == b[k] for k in a
    )


def replay(line: Mapping[str, Any], book: Book, *, where: str) -> None:
    """Bring a line into the book.

    Raises:
        InputError: it names observations that no line before it has, or something is wrong with
            what it defines.
    """
    cameras = [camera_of(c) for c in line.get("cameras", ())]
    points = [point_of(p, frame=book.network.frame) for p in line.get("points", ())]
    photos = [photo_of(f, frame=book.network.frame) for f in line.get("photos", ())]
    if cameras or points or photos:
        book.network = book.with_entities(points, photos, cameras)
    units: dict[str, Unit] = {}
    for fields in line.get("observations", ()):
        item = observation_of(fields)
        members = item.observations if isinstance(item, Correlated) else (item,)
        covariance = np.asarray(item.covariance) if isinstance(item, Correlated) else None
        unit = unit_of(book.network, members, covariance)
        units.update(dict.fromkeys(unit.ids, unit))
    moved: dict[str, Unit] = {}
    parted: list[str] = []
    for name in OUTCOMES:
        for ident in line.get(name, ()):
            book.note_number(ident)
            found = book.pull(ident)
            if found is None and ident not in moved and book.in_graph(ident):
                found = book.unit(ident)
                book.remove(found)
                if name == "waiting" and line.get("observations"):
                    parted.append(found.ids[0])
            if found is not None:
                moved.update({i: found for i in found.ids if i not in moved})
    done: set[str] = set()
    for name in OUTCOMES[:4]:
        told = line.get(name, ())
        for ident in told:
            if ident in done:
                continue
            known = units.get(ident) or moved.get(ident)
            if known is None:
                what = f"observation {ident!r} is not known here: a line before is missing"
                raise InputError(Problem(what, where))
            unit = known
            done.update(unit.ids)
            if name == "accepted":
                book.enter(unit)
            elif name == "waiting":
                book.wait([unit])
            else:
                verdicts = tuple(
                    _verdict(unit, i, name, told.get(member, {}))
                    for i, member in enumerate(unit.ids)
                )
                if name == "suspect":
                    book.suspect(unit, verdicts)
                else:
                    book.reject([unit], verdicts)
    if parted:
        book.retries.let_go(parted, 0, line.get("accepted", ()))
    if line.get("unweighted"):
        book.unweight(line["unweighted"])
    for kind, values in line.get("found", {}).items():
        for name, value in values.items():
            book.fill_value(kind, name, np.array(value, dtype=float))


def _verdict(unit: Unit, i: int, outcome: str, given: Mapping[str, Any]) -> Verdict:
    o = unit.observations[i]
    known: dict[str, Any] = {name: _array(given.get(name)) for name in _FIGURES}
    if known["sigma"] is not None:
        known["sigma"] = np.where(np.isnan(known["sigma"]), np.inf, known["sigma"])
    return Verdict(
        unit.ids[i],
        o.kind,
        o.label(),
        outcome,  # type: ignore[arg-type]
        tuple(given.get("components", ())),
        t2=given.get("t2", np.nan),
        dof=given.get("dof", 0),
        critical=given.get("critical", np.nan),
        points=unit.points,
        **known,
    )


def _array(values: Sequence[float | None] | None) -> Array | None:
    if values is None:
        return None
    return np.array([np.nan if x is None else x for x in values], dtype=float)
