"""Retirement window of photos or seconds: unknowns due, and observations between given points."""

from __future__ import annotations

import numpy as np

from ..entities import parameter_name
from ..errors import InputError, Problem
from ..graph.dependence import Variable
from ..ledger.command_input import Options, ticks
from ..ledger.ledger import Ledger
from ..ledger.row_store import REMOVED
from ..models.unknown_registry import UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import Network
from ..types import Array

BATCH_SHARE = 0.25
"""Share of the window that is retired together: each time all that remains is adjusted again."""


def untouched(ledger: Ledger, since: int, *, later: int | None = None) -> list[Variable]:
    """Return the free points, photos and orientations that nothing has touched for a time.

    A photo stays as long as one of its points does: the linear rows would join all of these.

    Args:
        ledger: the ledger.
        since: number of the command from which an observation is new.
        later: the same for photos whose points remain; None: they stay.
    """
    rows, names = ledger.rows, ledger.names
    there = np.flatnonzero(rows.status != REMOVED)
    rays = rows.images(there)
    latest: dict[Variable, int] = {}
    for row, unit in rows.units(there):
        for v in unit.variables:
            latest[v] = max(latest.get(v, 0), int(rows.arrived[row]))
    last: dict[str, Array] = {}
    for kind, numbers, every in (
        ("point", rows.point[rays], names.points),
        ("pose", rows.photo[rays], names.photos),
    ):
        when = np.zeros(len(every), dtype=np.intp)
        np.maximum.at(when, numbers, rows.arrived[rays])
        known_by_units = [latest.get((kind, n), 0) for n in every]
        last[kind] = np.maximum(when, np.array(known_by_units, dtype=np.intp))
    old = (last["point"] > 0) & (last["point"] < since)
    network = ledger.network
    for number in np.flatnonzero(old).tolist():
        name = names.points[number]
        if not ledger.needs(("point", name))[0] or stated_at(network, name):
            old[number] = False
    keeps = np.zeros(len(names.photos), dtype=np.intp)
    np.add.at(keeps, rows.photo[rays], ~old[rows.point[rays]])
    gone = (last["pose"] > 0) & (last["pose"] < since) & (keeps == 0)
    if later is not None:
        gone |= (last["pose"] > 0) & (last["pose"] < later)
    out: list[Variable] = [("point", names.points[i]) for i in np.flatnonzero(old).tolist()]
    out += [("pose", names.photos[i]) for i in np.flatnonzero(gone).tolist()]
    out += [
        v
        for v, when in latest.items()
        if UNKNOWNS[v[0]].absent == "found" and when < since and not is_stated(network, *v)
    ]
    return out


def observations_between_given(ledger: Ledger, since: int) -> list[str]:
    """Return the ids of observations in the graph that touch only what is given."""
    rows = ledger.rows
    inside = ledger.having("accepted")
    old = inside[rows.arrived[inside] < since]
    units = [u for _, u in rows.units(old)]
    return [i for u in units if not any(ledger.needs(v)[0] for v in u.variables) for i in u.ids]


def extent(ledger: Ledger, options: Options) -> float:
    """Return the length of the window: its photos, or the time of the latest arrival."""
    if options.keep_seconds is None:
        return float(len(ledger.names.photos))
    return 0.0 if ledger.time is None else ledger.time


def lot_of(options: Options) -> float:
    """Return how many photos, or the photos of how many seconds, are retired together."""
    if options.keep_seconds is not None:
        return BATCH_SHARE * options.keep_seconds
    return max(1, round(BATCH_SHARE * (options.keep or 0)))


def due_for_retirement(ledger: Ledger, options: Options) -> tuple[list[Variable], list[str]]:
    """Return the unknowns to be retired where the last photos or seconds are kept, several at once.

    Returns:
        The unknowns, and ids of observations between given points; empty where nothing is due.
    """
    if options.keep_seconds is not None:
        end, least = extent(ledger, options), 0.0
        since, later = (ticks(max(0.0, end - k * options.keep_seconds)) for k in (1, 2))
    else:
        keep, least = options.keep or 0, lot_of(options)
        if extent(ledger, options) < keep + least:
            return [], []
        since, later = (_first_of_last(ledger, k) for k in (keep, 2 * keep))
    found = untouched(ledger, since, later=later)
    if not found or sum(kind == "pose" for kind, _ in found) < least:
        return [], []
    return found, observations_between_given(ledger, since)


def _first_of_last(ledger: Ledger, photos: int) -> int:
    """Return the number of the command with which the first of the last photos came."""
    n = len(ledger.names.photos)
    if n < photos:
        return 0
    first = np.full(n, np.iinfo(np.intp).max)
    rays = ledger.rows.images(np.flatnonzero(ledger.rows.status != REMOVED))
    np.minimum.at(first, ledger.rows.photo[rays], ledger.rows.arrived[rays])
    return int(first[n - photos :].min())


def command_of(ledger: Ledger, before: str) -> int:
    """Return the number of the command with which an observation, or the first of a photo, came.

    Raises:
        InputError: there is no such observation or photo.
    """
    rows = ledger.find([before])
    number = ledger.names.photo.get(before)
    if not len(rows) and number is not None:
        rows = np.flatnonzero((ledger.rows.photo == number) & (ledger.rows.status != REMOVED))
    if not len(rows):
        problem = ledger.unknown(before)
        raise InputError(
            Problem(
                f"{problem.what}; before= takes one, or a photo with image points", problem.where
            )
        )
    return int(ledger.rows.arrived[rows].min())


def stated_at(network: Network, point: str) -> str:
    """Return what was stated for a point by something else; empty where nothing was."""
    for kind in parameter_kinds():
        for key, parameter in network.of_kind(kind.name).items():
            name = parameter_name(key)
            if parameter.origin == point:
                return f"it is the origin of {kind.noun} {name!r}"
            at = key if isinstance(key, str) else key[0]
            if kind.at_point and at == point and is_stated(network, kind.name, name):
                return f"{kind.noun} {name!r} was stated for it"
    return ""


def is_stated(network: Network, kind: VariableKind, name: str) -> bool:
    """Return whether an unknown was stated that need not be."""
    stated = [p for k, p in network.of_kind(kind).items() if parameter_name(k) == name]
    return any(any(p.fixed) or np.isfinite(p.sigma).any() for p in stated)
