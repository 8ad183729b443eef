"""Data snooping of a block that was oriented from image points alone.

The start of such a block names the image points that do not agree with it. With them the network
has no minimum: a point of two rays that do not meet lies at infinity or behind a photo. So they are
set aside before the first round, and are looked at afterwards as all other observations that were
set aside: what fits the clean solution is put back.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..graph.equations import Equations, compile_network
from ..network.network import Network
from ..network.selection import without
from ..solve.batch import adjust
from ..solve.solution import Solution
from ..solve.start import Start
from ..types import Array
from .rejections import PointSetAside, Rejected, Test
from .snooping_search import SnoopingSearch

WHY = "fewer than two of its rays agree with the others"
"""Reason that a point is removed at the start."""


def clean_adjustment(network: Network, start: Start, options: dict[str, Any]) -> Solution:
    """Adjust a network without the image points that do not agree with its start."""
    lost = _lost(network, start)
    equations = compile_network(network)
    rays = _rays(equations, lost)
    gone = {ray for own in rays.values() for ray in own}
    ids = [i for i in start.doubtful if i not in gone]
    return adjust(without(network, ids, points=lost), start=start, **options)


def search_beside(
    network: Network,
    start: Start,
    clean: Solution,
    *,
    test: Test,
    alpha: float,
    power: float,
    options: dict[str, Any],
    withdrawing: bool,
) -> SnoopingSearch:
    """Return a search of data snooping that begins with a clean adjustment.

    Args:
        network: the whole network.
        start: its start, which names the image points that do not agree.
        clean: its adjustment without them, see `clean_adjustment`.
        test: as for `SnoopingSearch`.
        alpha: as there.
        power: as there.
        options: as there.
        withdrawing: as there.
    """
    search = SnoopingSearch(clean, test, alpha, power, options, withdrawing=withdrawing)
    equations = compile_network(network)
    moved = start.carried_to(equations.unknowns)
    assert moved is not None
    with np.errstate(all="ignore"):
        v = np.nan_to_num(equations.residuals(moved.state))
        raw = np.nan_to_num(equations.residuals(moved.state, whitened=False))
    rays = _rays(equations, _lost(network, start))
    of_points = {ray for own in rays.values() for ray in own}
    search.network, search.equations, search.whole = network, equations, None
    search.start = moved.origin["point"]
    for ident in start.doubtful:
        if ident not in of_points:
            search.aside[ident], search.place[ident] = _rejected(equations, ident, v, raw)
    for name, own in rays.items():
        rows = np.concatenate(equations.find(own))
        worst = int(rows[np.argmax(np.abs(v[rows]))])
        number = equations.unknowns["point"].number[name]
        search.coordinates[name] = moved.state["point"][number]
        label = equations.label(worst)
        search.points[name] = PointSetAside(name, own, label, float(v[worst]), 0, WHY)
    return search


def _rejected(equations: Equations, ident: str, v: Array, raw: Array) -> tuple[Rejected, int]:
    """Return an observation that does not agree with the start, and its worst component."""
    (rows,) = equations.find([ident])
    place = int(np.argmax(np.abs(v[rows])))
    row = int(rows[place])
    nan = float("nan")
    block = next(b for b in equations.blocks if b.rows.start <= row < b.rows.stop)
    found = Rejected(
        ident,
        block.kind,
        equations.label(row),
        block.components[place],
        float(v[row]),
        float(-raw[row]),
        0,
        nan,
        nan,
        nan,
        (),
    )
    return found, place


def _lost(network: Network, start: Start) -> tuple[str, ...]:
    """Return the points that leave with all their rays: nothing else observes them."""
    observed = {p for o in network.observations.values() for p in o.points()}
    return tuple(p for p in start.unreached if p not in observed)


def _rays(equations: Equations, points: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the ids of the image points of each of some points."""
    number = equations.unknowns["point"].number
    out: dict[int, list[str]] = {number[p]: [] for p in points}
    for block in equations.blocks if points else ():
        if block.kind != "image":
            continue
        at = block.variables[2][1]
        for i in np.flatnonzero(np.isin(at, list(out))).tolist():
            out[int(at[i])].append(equations.id(block.first_row + 2 * i))
    return {p: tuple(out[number[p]]) for p in points}
