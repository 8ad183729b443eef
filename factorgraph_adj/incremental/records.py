"""What stands in the lines of a journal, and how they are read back.

The first line has the options and the network at the start as the files of a project. Every other
line is one change that counts: what was asked (``do``), new points, photos and cameras, the
observations that are new or changed, the ids that became ``gone``, ``accepted``, ``waiting``,
``suspect`` or ``rejected``, and why (``causes``). Image points stand in ``images``, those of a
photo with the same outcome together. Reading back needs no test again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
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
from ..network.entities import Camera, ImageTable, Photo, Point
from ..network.network import Network
from ..observations import Correlated, ImagePoint, Observation
from ..types import Array, Index
from .ledger import Ledger, Some
from .rays import GONE
from .units import Unit, identity, unit_of
from .verdicts import OUTCOMES, Outcome, Verdict

_FIGURES = ("innovation", "sigma", "w", "redundancy_numbers")
_TOLD = ("suspect", "rejected")
"""Outcomes whose lines have the figures of verdicts."""


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


# -- writing --------------------------------------------------------------------------------------


def difference(before: Ledger, after: Ledger) -> dict[str, Any]:
    """Return what a line says of a change: everything that is not where or what it was.

    Args:
        before: the ledger of the last line.
        after: the ledger now, with its changes since then.
    """
    out: dict[str, Any] = {}
    causes: dict[str, str] = {}
    defined: dict[str, Unit] = {}
    rows = np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *(c.rays for c in after.changes)]))
    units = dict.fromkeys(i for c in after.changes for u in c.units for i in u.ids)
    for change in after.changes:
        causes |= dict.fromkeys((i for u in change.units for i in u.ids), change.cause)
    for ident in units:
        was, now = before.entry(ident), after.entry(ident)
        if now is None:
            if was is not None:
                out.setdefault("gone", []).append(ident)
            continue
        redefined = was is None or was.unit is not now.unit
        if redefined:
            defined[now.unit.ids[0]] = now.unit
        elif was is not None and was.outcome == now.outcome:
            continue
        told = next((figures(v) for v in now.verdicts if v.id == ident), {})
        _tell(out, now.outcome, ident, told)
    images = _images(before, after, rows, out)
    if defined:
        out["observations"] = [definition(u) for u in defined.values()]
    if images:
        out["images"] = images
    moved = {i for name in (*OUTCOMES, "gone") for i in out.get(name, ())}
    why = {i: c for i, c in causes.items() if i in moved and c != "arrival"}
    if why:
        out["causes"] = {c: [i for i, x in why.items() if x == c] for c in set(why.values())}
    if after.filled:
        out["found"] = {kind: dict(values) for kind, values in after.filled.items()}
    if after.unweighted:
        out["unweighted"] = list(after.unweighted)
    return out


def _tell(out: dict[str, Any], outcome: Outcome, ident: str, told: Mapping[str, Any]) -> None:
    where = out.setdefault(outcome, {} if outcome in _TOLD else [])
    if isinstance(where, dict):
        where[ident] = told
    else:
        where.append(ident)


def _images(
    before: Ledger, after: Ledger, rows: Index, out: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return the image points that changed, by photo and outcome; tell the figures of tests."""
    rays, names = after.rays, after.names
    was = np.full(len(rows), GONE)
    old = rows < before.rays.n
    was[old] = before.rays.status[rows[old]]
    now = rays.status[rows]
    changed = rows[was != now]
    new = set(rows[~old].tolist())
    records = []
    key = [(rays.photo[r], int(rays.status[r]), r in new) for r in changed.tolist()]
    for photo, status, is_new in dict.fromkeys(key):
        mine = changed[[k == (photo, status, is_new) for k in key]]
        record: dict[str, Any] = {
            "photo": names.photos[photo],
            "outcome": "gone" if status == GONE else OUTCOMES[status],
            "points": [names.points[p] for p in rays.point[mine].tolist()],
        }
        if is_new:
            record |= {"xy": rays.xy[mine].tolist(), "sigma": rays.sigma[mine].tolist()}
            own = {str(i): rays.ids[r] for i, r in enumerate(mine.tolist()) if r in rays.ids}
            record |= {"ids": own} if own else {}
        told = [figures(rays.verdicts[r]) if r in rays.verdicts else {} for r in mine.tolist()]
        if any(told):
            record["figures"] = told
        records.append(record)
    return records


def definition(unit: Unit) -> dict[str, Any]:
    """Return the fields of a unit, with the ids of its observations."""
    ids = unit.ids if isinstance(unit.item, Correlated) else unit.ids[0]
    return dict(observation_fields(unit.item, id=ids if isinstance(ids, str) else list(ids)))


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


# -- reading back ---------------------------------------------------------------------------------


def replay(line: Mapping[str, Any], ledger: Ledger, *, where: str) -> Ledger:
    """Return the ledger after a line.

    Raises:
        InputError: it names observations that no line before it has, or something is wrong with
            what it defines.
    """
    cameras = [camera_of(c) for c in line.get("cameras", ())]
    points = [point_of(p, frame=ledger.network.frame) for p in line.get("points", ())]
    photos = [photo_of(f, frame=ledger.network.frame) for f in line.get("photos", ())]
    if cameras or points or photos:
        ledger = ledger.with_entities(points, photos, cameras)
    units: dict[str, Unit] = {}
    rays: dict[str, ImagePoint] = {}
    for fields in line.get("observations", ()):
        item = observation_of(fields)
        if isinstance(item, ImagePoint):  # as journals of version 1 have them
            rays[identity(item) or ""] = item
            continue
        members = item.observations if isinstance(item, Correlated) else (item,)
        covariance = np.asarray(item.covariance) if isinstance(item, Correlated) else None
        unit = unit_of(ledger.network, members, covariance)
        units.update(dict.fromkeys(unit.ids, unit))
    replaced = Some.none()
    for ident in (*units, *rays):
        replaced = replaced.joined(ledger.find([ident]))
    gone = ledger.find(line.get("gone", ()))
    moved = {i: u for u in replaced.joined(gone).units for i in u.ids}
    ledger = ledger.moved(replaced.joined(gone), None, "journal")
    known: dict[str, Unit] = moved | units
    for outcome in OUTCOMES:
        told = line.get(outcome, ())
        ledger = _moved(ledger, outcome, told, known, rays, where)
    for record in line.get("images", ()):
        ledger = _replay_images(ledger, record, where)
    if line.get("unweighted"):
        ledger = ledger.without_weights(line["unweighted"])
    for kind, values in line.get("found", {}).items():
        found = {n: np.array(v, dtype=float) for n, v in values.items()}
        ledger = ledger.with_values(kind, found)
    return replace(ledger.recorded(), next=_next(ledger))


def _next(ledger: Ledger) -> int:
    """Return the number after the largest id that is one."""
    recent = [i for c in ledger.changes for u in c.units for i in u.ids if i.isdecimal()]
    return max([ledger.next, *(int(i) + 1 for i in recent)])


def _moved(
    ledger: Ledger,
    outcome: Outcome,
    told: Sequence[str] | Mapping[str, Any],
    known: Mapping[str, Unit],
    rays: Mapping[str, ImagePoint],
    where: str,
) -> Ledger:
    """Return the ledger where the observations of a list have an outcome."""
    units: dict[str, Unit] = {}
    rows: list[int] = []
    fresh: list[str] = []
    for ident in told:
        if ident in known:
            units[known[ident].ids[0]] = known[ident]
        elif ident in rays:
            fresh.append(ident)
        else:
            some = ledger.find([ident])
            if not some:
                what = f"observation {ident!r} is not known here: a line before is missing"
                raise InputError(Problem(what, where))
            units |= {u.ids[0]: u for u in some.units}
            rows += some.rays.tolist()
    verdicts: dict[str, Verdict] = {}
    if isinstance(told, Mapping):
        for unit in units.values():
            for i, o in zip(unit.ids, unit.observations, strict=True):
                verdicts[i] = _verdict(i, o, unit.points, outcome, told.get(i, {}))
        for row in rows:
            ray = ledger.rays.observation(ledger.names, row)
            i = ledger.rays.name(ledger.names, row)
            verdicts[i] = _verdict(i, ray, (ray.point,), outcome, told.get(i, {}))
    some = Some(tuple(units.values()), np.unique(np.array(rows, dtype=np.intp)))
    ledger = ledger.moved(some, outcome, "journal", verdicts=verdicts)
    if fresh:
        ledger, taken = ledger.taken([rays[i] for i in fresh])
        if isinstance(told, Mapping):
            verdicts = {i: _verdict(i, rays[i], (rays[i].point,), outcome, told[i]) for i in fresh}
        ledger = ledger.moved(taken, outcome, "journal", verdicts=verdicts)
    return ledger


def _replay_images(ledger: Ledger, record: Mapping[str, Any], where: str) -> Ledger:
    """Return the ledger after a record of image points."""
    names = ledger.names
    unknown = [n for n in record["points"] if n not in names.point]
    if record["photo"] not in names.photo or unknown:
        what = f"photo {record['photo']!r} or a point of its is not known: a line before is missing"
        raise InputError(Problem(what, where))
    photo = names.photo[record["photo"]]
    points = np.array([names.point[n] for n in record["points"]], dtype=np.intp)
    if "xy" in record:
        table = ImageTable()
        xy, sigma = (np.array(record[c], dtype=float) for c in ("xy", "sigma"))
        table.append(np.full(len(points), photo), points, xy, sigma)
        table.ids = {int(i): name for i, name in record.get("ids", {}).items()}
        first = ledger.rays.n
        ledger = replace(ledger, rays=ledger.rays.with_table(table, "waiting"))
        rows = np.arange(first, first + len(points))
    else:
        found = ledger.rays.measured(photo, points)
        place = {int(p): int(r) for p, r in zip(ledger.rays.point[found], found, strict=True)}
        if any(int(p) not in place for p in points):
            what = f"an image point in {record['photo']!r} is not known: a line before is missing"
            raise InputError(Problem(what, where))
        rows = np.array([place[int(p)] for p in points], dtype=np.intp)
    outcome = record["outcome"]
    verdicts = {}
    for row, told in zip(rows.tolist(), record.get("figures", ()), strict=False):
        ray, i = ledger.rays.observation(names, row), ledger.rays.name(names, row)
        verdicts[i] = _verdict(i, ray, (ray.point,), outcome, told)
    some = Some((), np.sort(rows))
    return ledger.moved(some, None if outcome == "gone" else outcome, "journal", verdicts=verdicts)


def _verdict(
    ident: str, o: Observation, points: tuple[str, ...], outcome: Outcome, given: Mapping[str, Any]
) -> Verdict:
    known: dict[str, Any] = {name: _array(given.get(name)) for name in _FIGURES}
    if known["sigma"] is not None:
        known["sigma"] = np.where(np.isnan(known["sigma"]), np.inf, known["sigma"])
    return Verdict(
        ident,
        o.kind,
        o.label(),
        outcome,
        tuple(given.get("components", ())),
        t2=given.get("t2", np.nan),
        dof=given.get("dof", 0),
        critical=given.get("critical", np.nan),
        points=points,
        **known,
    )


def _array(values: Sequence[float | None] | None) -> Array | None:
    if values is None:
        return None
    return np.array([np.nan if x is None else x for x in values], dtype=float)
