"""Entries of a journal: a change of the ledger as one line, and its replay; packed numbers.

The first line has the options and the network at the start as the files of a project. Every other
line is one change: the command (``do``), the ``time`` of an arrival, new points, photos, cameras
and other ``unknowns`` (records with their ``kind``), new or changed observations, the ids that
became ``gone``, ``accepted``, ``waiting``, ``suspect`` or ``rejected``, and why (``causes``);
verdicts on those of the accepted that a decision by hand let in (``decided``), each with the one
that it has replaced (``former``), as all verdicts after such decisions have it; what waiting
observations and unknowns lack (``lacks``); how photos without poses were oriented (``oriented``);
readings that have moved points to their other sides (``sides``, all of them where that has
changed); what was retired (``retired``), or that all of it was taken back (``taken_back``), see
`retirement`; ``estimates`` of unknowns, by kind and name, and ``vtpv``, see
`incremental.resumption`. The first line has the result of its network in ``start``, with the same
fields. Image points are in ``images``, those of a photo with the same outcome together. Replay
needs no tests.
"""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, asdict, fields, replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from ..entities import ImageTable, Key, Parameter
from ..errors import InputError, Problem, known
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
    unknown_fields,
    unknown_of,
)
from ..models.unknown_registry import VariableKind
from ..network.network import Network
from ..observations import Correlated, Observation
from ..observations.ids import identity, number_beyond
from ..types import Array, Index
from .command_input import Input, Options
from .ledger import Ledger
from .row_store import REMOVED, RowStore, Unit
from .verdicts import OUTCOMES, STATED_CAUSES, Outcome, Side, Verdict

_FIGURES = ("innovation", "sigma", "w", "redundancy_numbers")
FIELDS = (
    *("do", "time", "cameras", "points", "unknowns", "photos", "observations", "images"),
    *("gone", *OUTCOMES, "decided", "causes", "lacks", "found", "unweighted", "oriented"),
    *("sides", "retired", "taken_back", "estimates", "vtpv"),
)
"""Fields of a line after the first."""
OUTCOMES_WITH_FIGURES = ("suspect", "rejected")
"""Outcomes whose lines have the figures of verdicts."""
THREE_DIGITS, SEVEN_DIGITS, ALL_DIGITS = "<f2", "<f4", "<f8"
"""Types of the numbers in text: little-endian, of half, single and double precision."""


def header(network: Network, options: Mapping[str, object]) -> dict[str, Any]:
    """Return the first line."""
    return {"options": dict(options), "files": network_files(network)}


def start_of(
    line: Mapping[str, Any], where: str, folder: Path, geoids: Collection[str], allow_outside: bool
) -> tuple[Network, Options]:
    """Return network and options of the first line.

    Args:
        line: the first line.
        where: file and line.
        folder: folder of the journal, in which a geoid may lie.
        geoids: further paths of geoids that may be read.
        allow_outside: whether the geoid may lie anywhere.

    Raises:
        InputError: the line has no network or options, or wrong ones.
    """
    files, options = (line.get(part) for part in ("files", "options"))
    wanted = {f.name for f in fields(Options)}
    if not isinstance(files, Mapping):
        raise InputError(Problem("the line has no files of a network", where))
    optional = {f.name for f in fields(Options) if f.default is not MISSING}
    if not isinstance(options, Mapping) or not wanted - optional <= set(options) <= wanted:
        what = f"the options must be {', '.join(sorted(wanted))}, not {options!r:.80}"
        raise InputError(Problem(what, where))
    network = network_of(files, home=folder, geoids=geoids, allow_outside=allow_outside)
    return network, Options(**options)


def entities(before: Network, after: Network, given: Input) -> dict[str, Any]:
    """Return the fields of new entities beside observations, as a network has checked them.

    Args:
        before: the network before.
        after: the network with the new entities.
        given: the new entities, and approximate values of points that were there.
    """
    new = [after.points[p.name] for p in given.points if p.name not in before.points]
    found = {
        "cameras": [camera_fields(after.cameras[c.name]) for c in given.cameras],
        "points": [point_fields(p) for p in new],
        "unknowns": [
            unknown_fields(kind, key, p)
            for kind, of in given.unknowns.items()
            for key, p in of.items()
        ],
        "photos": [photo_fields(after.photos[f.name]) for f in given.photos],
    }
    return {k: v for k, v in found.items() if v}


# -- writing --------------------------------------------------------------------------------------


def difference(before: Ledger, after: Ledger) -> dict[str, Any]:
    """Return the fields of a change: everything whose outcome or definition differs.

    Args:
        before: the ledger of the last line.
        after: the ledger now, with its changes since then.
    """
    n, rows = before.rows.n, after.rows
    was = np.append(before.rows.status, np.full(rows.n - n, REMOVED, dtype=np.int8))
    changed = np.flatnonzero(was != rows.status)
    out: dict[str, Any] = {}
    defined: list[dict[str, Any]] = []
    causes: dict[str, list[str]] = {}
    for row, unit in rows.units(changed):
        code, cause = int(rows.status[row]), after.causes[row]
        ids = list(unit.ids) if code != REMOVED else after.missing(unit.ids)
        if row >= n:
            defined.append(definition(unit))
        outcome = "gone" if code == REMOVED else OUTCOMES[code]
        if outcome in OUTCOMES_WITH_FIGURES:
            recorded = {v.id: figures(v) for v in rows.verdicts.get(row, ())}
            out.setdefault(outcome, {}).update({i: recorded.get(i, {}) for i in ids})
        elif ids:
            out.setdefault(outcome, []).extend(ids)
            if recorded := {v.id: figures(v) for v in rows.verdicts.get(row, ())}:
                out.setdefault("decided", {}).update(recorded)
        if ids and cause != "arrival":
            causes.setdefault(cause, []).extend(ids)
    images = _images(after, rows.images(changed), n)
    more = {"observations": defined, "images": images, "causes": causes}
    more["found"] = {kind: dict(values) for kind, values in after.filled.items()}
    more["unweighted"] = list(after.unweighted)
    more["oriented"] = dict(after.oriented)
    more["lacks"] = _lacks(before, after)
    if after.sides != before.sides:
        out["sides"] = {ident: asdict(side) for ident, side in after.sides.items()}
    return out | {name: found for name, found in more.items() if found}


def everything_of(
    ledger: Ledger, rows: Index, points: Collection[str], photos: Collection[str]
) -> dict[str, Any]:
    """Return the line that adds some rows, points and photos again, as they are.

    Args:
        ledger: the ledger with them.
        rows: the rows.
        points: names of the points.
        photos: names of the photos.
    """
    status = np.full(ledger.rows.n, REMOVED, dtype=np.int8)
    status[rows] = ledger.rows.status[rows]
    recorded = ledger.rows.verdicts
    causes = {r: recorded[r][0].cause if recorded.get(r) else "" for r in rows.tolist()}
    mine = replace(
        ledger,
        rows=replace(ledger.rows, status=status),
        causes={r: cause or "arrival" for r, cause in causes.items()},
        filled={},
        unweighted=(),
        oriented={},
    )
    network = ledger.network
    found = {
        "points": [point_fields(p) for n, p in network.points.items() if n in points],
        "photos": [photo_fields(f) for n, f in network.photos.items() if n in photos],
        "unknowns": [
            unknown_fields(kind, key, network.of_kind(kind)[key])
            for photo in photos
            for kind, key in network.of_photo(photo)
        ],
    }
    return {k: v for k, v in found.items() if v} | difference(replace(mine, rows=RowStore()), mine)


def _lacks(before: Ledger, after: Ledger) -> list[list[str]]:
    """Return why variables (kind, name, why) and observations (id, why) wait, where that is new.

    The reason is empty where there is none any more.
    """
    was, now = before.lacks, after.lacks
    if was is now:
        return []
    changed = {key: why for key, why in now.items() if was.get(key) != why}
    changed |= dict.fromkeys(was.keys() - now.keys(), "")
    return [[*((key,) if isinstance(key, str) else key), why] for key, why in changed.items()]


def _images(after: Ledger, changed: Index, first: int) -> list[dict[str, Any]]:
    """Return the image points that changed, by photo, outcome and cause.

    Args:
        after: the ledger now.
        changed: rows of the image points.
        first: the first row that is not in the last line.
    """
    rows, names = after.rows, after.names
    parts: dict[tuple[int, int, str, bool], list[int]] = {}
    for row in changed.tolist():
        key = int(rows.photo[row]), int(rows.status[row]), after.causes[row], row >= first
        parts.setdefault(key, []).append(row)
    records = []
    for (photo, status, cause, is_new), mine in parts.items():
        record: dict[str, Any] = {
            "photo": names.photos[photo],
            "outcome": "gone" if status == REMOVED else OUTCOMES[status],
            "points": [names.points[p] for p in rows.point[mine].tolist()],
        }
        if cause != "arrival":
            record["cause"] = cause
        if is_new:
            record |= {"xy": rows.xy[mine].tolist(), "sigma": rows.sigma[mine].tolist()}
            if rows.correlation[mine].any():
                record["correlation"] = rows.correlation[mine].tolist()
            sources = rows.room.sources
            given = {str(i): sources[r] for i, r in enumerate(mine) if r in sources}
            record |= {"sources": given} if given else {}
        own = {str(i): rows.room.ids[r] for i, r in enumerate(mine) if r in rows.room.ids}
        record |= {"ids": own} if own else {}
        recorded = [figures(v) for r in mine for v in rows.verdicts.get(r, (None,))]
        if any(recorded):
            record["figures"] = recorded
        records.append(record)
    return records


def definition(unit: Unit) -> dict[str, Any]:
    """Return the fields of a unit, with the ids of its observations."""
    ids = unit.ids if isinstance(unit.item, Correlated) else unit.ids[0]
    return dict(observation_fields(unit.item, id=ids if isinstance(ids, str) else list(ids)))


def figures(verdict: Verdict | None) -> dict[str, Any]:
    """Return the numbers of a verdict, if there is one; those that are not finite are left out."""
    if verdict is None:
        return {}
    out: dict[str, Any] = {"components": list(verdict.components), "dof": verdict.dof}
    for name in _FIGURES:
        values = getattr(verdict, name)
        if values is not None:
            out[name] = [x if math.isfinite(x) else None for x in values.tolist()]
    for name in ("t2", "critical"):
        value = getattr(verdict, name)
        if math.isfinite(value):
            out[name] = value
    if verdict.doubt:
        out["doubt"] = verdict.doubt
    if verdict.following:
        out["following"] = [list(one) for one in verdict.following]
    if (former := verdict.former) is not None:
        own = {"verdict": former.verdict, "cause": former.cause}
        out["former"] = own | figures(former)
    return out


# -- reading back ---------------------------------------------------------------------------------


def replay(line: Mapping[str, Any], ledger: Ledger, *, where: str) -> Ledger:
    """Return the ledger after a line.

    Raises:
        InputError: it has an unknown field, names observations that no earlier line has, or a
            definition in it is wrong.
    """
    if unknown := [name for name in line if name not in FIELDS]:
        raise InputError(
            Problem(f"unknown field {name!r}; valid: {known(FIELDS, meant=name)}", where)
            for name in unknown
        )
    with reading(where):
        return _after(line, ledger, where)


def ids_of(line: Mapping[str, Any]) -> list[str]:
    """Return the ids of the observations that a line defines."""
    out: list[str] = []
    for given in line.get("observations", ()):
        item = observation_of(given)
        members = item.observations if isinstance(item, Correlated) else (item,)
        out += [identity(o) or "" for o in members]
    for record in line.get("images", ()):
        if "xy" in record:
            own, photo = record.get("ids", {}), record["photo"]
            out += [own.get(str(n), f"{photo}/{p}") for n, p in enumerate(record["points"])]
    return out


@contextmanager
def reading(where: str) -> Iterator[None]:
    """Name the place of the line that is read in every error.

    Raises:
        InputError: what is wrong with the line.
    """
    try:
        yield
    except InputError as error:
        problems = [p if p.where.startswith(where) else p.at(where) for p in error.problems]
        raise InputError(problems) from None
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        what = f"the line is damaged: {type(error).__name__} {error!s:.80}"
        raise InputError(Problem(what, where)) from error


def _after(line: Mapping[str, Any], ledger: Ledger, where: str) -> Ledger:
    if "time" in line:
        ledger = ledger.at(line["time"])
    cameras = [camera_of(c) for c in line.get("cameras", ())]
    points = [point_of(p, frame=ledger.network.frame) for p in line.get("points", ())]
    photos = [photo_of(f, frame=ledger.network.frame) for f in line.get("photos", ())]
    unknowns: dict[VariableKind, dict[Key, Parameter]] = {}
    for record in line.get("unknowns", ()):
        kind, key, stated = unknown_of(record)
        unknowns.setdefault(kind, {})[key] = stated
    if cameras or points or photos or unknowns:
        ledger = ledger.with_entities(points, photos, cameras, unknowns)
    items = [observation_of(fields) for fields in line.get("observations", ())]
    members = [o for i in items for o in (i.observations if isinstance(i, Correlated) else (i,))]
    for o in members:
        ledger.network.check_names(o, set())
    ids = [identity(o) or "" for o in members]
    ledger = ledger.moved(ledger.find([*ids, *line.get("gone", ())]), None, "journal")
    ledger, _ = ledger.appended(items, "journal")
    rays = [i for record in line.get("images", ()) for i in record.get("ids", {}).values()]
    ledger = replace(ledger, next=number_beyond([*ids, *rays], ledger.next))
    causes = {i: cause for cause, ids in line.get("causes", {}).items() for i in ids}
    for outcome in OUTCOMES:
        changed = line.get(outcome, ())
        if missing := ledger.missing(changed):
            what = f"observation {missing[0]!r} is not known here: a line before is missing"
            raise InputError(Problem(what, where))
        ledger = _moved(ledger, ledger.find(changed), outcome, changed, causes)
    if "decided" in line:
        decided = line["decided"]
        ledger = _moved(ledger, ledger.find(decided), "accepted", decided, causes)
    for record in line.get("images", ()):
        ledger = _replay_images(ledger, record, where)
    if line.get("unweighted"):
        ledger = ledger.without_weights(line["unweighted"])
    for kind, values in line.get("found", {}).items():
        ledger = ledger.with_values(kind, {n: [float(x) for x in v] for n, v in values.items()})
    changed = {tuple(key) if len(key) > 1 else key[0]: why for *key, why in line.get("lacks", ())}
    kept = {key: why for key, why in ({**ledger.lacks, **changed}).items() if why}
    if "sides" in line:
        ledger = replace(ledger, sides={i: _side(s) for i, s in line["sides"].items()})
    return replace(ledger, lacks=kept).recorded()[0]


def _side(given: Mapping[str, Any]) -> Side:
    x, y, z = (float(value) for value in given["other"])
    return Side(str(given["point"]), (x, y, z), float(given["moved"]), bool(given["alone"]))


def _moved(
    ledger: Ledger,
    rows: Index,
    outcome: Outcome,
    changed: Mapping[str, Any] | Sequence[str],
    causes: Mapping[str, str],
) -> Ledger:
    """Return the ledger where rows have an outcome, with the figures and causes of verdicts."""
    verdicts: dict[str, Verdict] = {}
    figures_of = changed if isinstance(changed, Mapping) else {}
    for unit in ledger.units(rows) if figures_of else ():
        for i, o in zip(unit.ids, unit.observations, strict=True):
            if outcome not in OUTCOMES_WITH_FIGURES and not figures_of.get(i):
                continue
            found = _verdict(i, o, unit.points, outcome, figures_of.get(i, {}))
            cause = causes.get(i, "")
            verdicts[i] = replace(found, cause=cause) if cause in STATED_CAUSES else found
    return ledger.moved(rows, outcome, "journal", verdicts)


def _replay_images(ledger: Ledger, record: Mapping[str, Any], where: str) -> Ledger:
    """Return the ledger after a record of image points."""
    names, photo = ledger.names, record["photo"]
    points = [names.point.get(n, -1) for n in record["points"]]
    if photo not in names.photo or -1 in points:
        what = f"photo {photo!r} or one of its points is not known: a line before is missing"
        raise InputError(Problem(what, where))
    if "xy" in record:
        table = ImageTable()
        xy, sigma = (np.array(record[c], dtype=float) for c in ("xy", "sigma"))
        of_photo = np.full(len(points), names.photo[photo], dtype=np.intp)
        rho = np.array(record["correlation"], dtype=float) if "correlation" in record else None
        table.append(of_photo, np.array(points, dtype=np.intp), xy, sigma, rho)
        table.ids = {int(i): name for i, name in record.get("ids", {}).items()}
        table.sources = {int(i): name for i, name in record.get("sources", {}).items()}
        ledger, rows = ledger.with_images(table, "journal")
    else:
        measured = ledger.rows.measured(names.photo[photo], np.array(points, dtype=np.intp))
        # A point may have been measured again after it was rejected: ids distinguish the two.
        own = ledger.rows.room.ids
        row_of = {(int(ledger.rows.point[r]), own.get(r)): r for r in measured.tolist()}
        given = record.get("ids", {})
        keys = [(p, given.get(str(i))) for i, p in enumerate(points)]
        if not row_of.keys() >= set(keys):
            what = f"an image point in {photo!r} is not known: a line before is missing"
            raise InputError(Problem(what, where))
        rows = np.array([row_of[k] for k in keys], dtype=np.intp)
    if record["outcome"] == "gone":
        return ledger.moved(rows, None, "journal")
    ids = ledger.ids_of(rows)
    recorded = dict(zip(ids, record.get("figures", ()), strict=False))
    causes = dict.fromkeys(ids, record.get("cause", ""))
    return _moved(ledger, rows, record["outcome"], recorded or (), causes)


def _verdict(
    ident: str, o: Observation, points: tuple[str, ...], outcome: Outcome, given: Mapping[str, Any]
) -> Verdict:
    known: dict[str, Any] = {name: _array(given.get(name)) for name in _FIGURES}
    if known["sigma"] is not None:
        known["sigma"] = np.where(np.isnan(known["sigma"]), np.inf, known["sigma"])
    if (was := given.get("former")) is not None:
        former = _verdict(ident, o, points, was["verdict"], was)
        known["former"] = replace(former, cause=str(was["cause"]))
    return Verdict(
        ident,
        o.kind,
        o.label(),
        outcome,
        tuple(given.get("components", ())),
        t2=given.get("t2", np.nan),
        dof=given.get("dof", 0),
        critical=given.get("critical", np.nan),
        doubt=str(given.get("doubt", "")),
        points=points,
        following=tuple((str(i), int(n)) for i, n in given.get("following", ())),
        **known,
    )


def _array(values: Sequence[float | None] | None) -> Array | None:
    if values is None:
        return None
    return np.array([np.nan if x is None else x for x in values], dtype=float)


def packed(a: Array, digits: str = SEVEN_DIGITS) -> str:
    """Return numbers as text, with seven digits each or with all of them."""
    return b64encode(np.asarray(a, dtype=digits).tobytes()).decode("ascii")


def unpacked(text: str, *shape: int, digits: str = SEVEN_DIGITS) -> Array:
    """Return the numbers of a text, in a shape."""
    return np.frombuffer(b64decode(text), dtype=digits).astype(float).reshape(shape)


def packed_symmetric(a: Array) -> tuple[float, str]:
    """Return the largest number of a tensor (k, k, k), and all numbers as text, relative to it.

    The tensor is symmetric in all its indices; numbers have three digits.
    """
    most = float(np.abs(a).max(initial=0.0))
    each = a[_places(len(a))] / (most or 1.0)
    return most, b64encode(each.astype(THREE_DIGITS).tobytes()).decode("ascii")


def unpacked_symmetric(most: float, text: str, k: int) -> Array:
    """Return the tensor, (k, k, k)."""
    out, places = np.empty((k, k, k)), _places(k)
    each = most * np.frombuffer(b64decode(text), dtype=THREE_DIGITS).astype(float)
    for order in permutations(places):
        out[order] = each
    return out


def _places(k: int) -> tuple[Index, ...]:
    """Return the indices of the numbers of a symmetric tensor that differ."""
    i = np.arange(k)
    return np.nonzero((i[:, None, None] <= i[:, None]) & (i[:, None] <= i))
