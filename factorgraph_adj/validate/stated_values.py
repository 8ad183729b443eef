"""Doubts: lengths of levelled lines; set-up heights exchanged, differing; surfaces by points.

Heights of instruments and targets may differ, or be missing, within a set-up.

A reading whose residual at the stated values is v, with the partial J by the height of a surface,
puts the surface −v/J higher. The median over its points is compared with the standard deviation of
the stated height, and with how well the points agree with one another.

Intervals of motions in seconds are wrong where 1 s stands for an unknown readout time. A table of
distortions says nothing beyond its last radius, and rational polynomials nothing far outside their
range.

Lengths of levelled lines may contradict the places of their ends: metres for kilometres. Where the
places of the ends are not known, other lines bound their distance: the ends of a line lie no
further apart than the shortest way along the stated lengths of the others.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ..errors import InputError, known
from ..frames import GeocentricFrame, TopocentricFrame
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.film_lens import FilmLens
from ..models.inverse_lens import tangents
from ..models.rolling_shutter import UNKNOWN_READOUT
from ..models.rpc_lens import RpcLens, normalised_plan
from ..models.unknown import UnknownKind
from ..models.unknown_registry import UNKNOWNS
from ..network.network import Network
from ..observations import Observation
from ..observations.base import of_quantities
from ..observations.registry import INCLINATION_QUANTITIES, Quantity
from ..statistical_tests import SIGMA_PER_MEDIAN_DEVIATION, TOLERANCE_IN_SIGMAS
from ..types import Array, Index
from ..units import significant
from .findings import MIN_FIT_IMPROVEMENT, Finding

MIN_LENGTH_RATIO = 100.0
"""Ratio of the stated length to the distance of the ends, or its inverse, from which it is doubted:
no line is shorter than the straight one, and none takes a hundred times the way."""
MIN_LINE_DISTANCE_M = 1.0
"""Smallest horizontal distance of ends that is compared, metres."""
MIN_EXCHANGED_SHARE = 0.5
"""Part of the set-ups whose heights must differ, and be the same exchanged, to be exchanged."""
APPROXIMATE_HEIGHT_ERROR_M = 1.0
"""Error of approximate heights that is nothing unusual, metres."""


@dataclass(frozen=True)
class _Lines:
    """Levelled lines with stated lengths."""

    ends: Index
    """Numbers of their points, (n, 2)."""
    stated: Array
    """Their lengths, (n,) metres."""
    labels: list[str]
    """Their names, (n,)."""


def wrong_line_lengths(equations: Equations, state: State) -> list[str]:
    """Return doubts about stated lengths of levelled lines.

    Args:
        equations: the network.
        state: coordinates of all points, adjusted or approximate.
    """
    lines = _stated(equations)
    if not len(lines.stated):
        return []
    apart = _distances(equations, state, lines)
    apart[~(apart > MIN_LINE_DISTANCE_M)] = np.nan
    around = np.where(np.isnan(apart), _ways_around(lines), np.nan)
    return [
        *_length_texts(lines, apart, "{:.1f} m apart"),
        *_length_texts(lines, around, "that other lines join over {:.0f} m"),
    ]


def _stated(equations: Equations) -> _Lines:
    """Return the lines whose lengths are stated."""
    ends, stated, labels = [np.zeros((0, 2), dtype=np.intp)], [np.zeros(0)], []
    for block in equations.blocks:
        points = [index for kind, index in block.variables if kind == "point"]
        if block.prior or len(points) < 2:
            continue
        found = (equations.network.observations.get(i) for i in block.ids)
        km = np.array([getattr(o, "length_km", None) or np.nan for o in found], dtype=float)
        rows = np.flatnonzero(np.isfinite(km))
        ends.append(np.column_stack([points[0][rows], points[1][rows]]))
        stated.append(1e3 * km[rows])
        labels += [block.labels(int(i)) for i in rows]
    return _Lines(np.concatenate(ends), np.concatenate(stated), labels)


def _distances(equations: Equations, state: State, lines: _Lines) -> Array:
    """Return the horizontal distances of the ends, (n,) metres; NaN: an end has no place.

    Points of levelling networks without a place in plan are at x = y = 0.
    """
    start, end = (state["point"][lines.ends[:, i]] for i in (0, 1))
    enu = equations.network.frame.basis(start, np.zeros((len(start), 2))).enu
    apart = np.hypot(*np.einsum("nij,nj->ni", enu, end - start)[:, :2].T)
    placed = start[:, :2].any(axis=1) & end[:, :2].any(axis=1)
    return np.where(placed, apart, np.nan)


def _ways_around(lines: _Lines) -> Array:
    """Return the shortest ways along other lines, (n,) metres; NaN: not much shorter than it."""
    out = np.full(len(lines.stated), np.nan)
    long = np.flatnonzero(lines.stated > MIN_LENGTH_RATIO * lines.stated.min())
    if not len(long):
        return out
    used, at = np.unique(lines.ends, return_inverse=True)
    at = at.reshape(-1, 2)
    key = np.sort(at, axis=1) @ np.array([len(used), 1])
    order = np.lexsort((lines.stated, key))
    shortest = order[np.unique(key[order], return_index=True)[1]]  # of lines with the same ends
    a, b = at[shortest].T
    graph = coo_array((lines.stated[shortest], (a, b)), shape=(len(used), len(used))).tocsr()
    roots, root = np.unique(at[long, 0], return_inverse=True)
    way = dijkstra(graph, directed=False, indices=roots)[root, at[long, 1]]
    # A way as long as the line is the line itself.
    out[long] = np.where((way < lines.stated[long]) & (way > MIN_LINE_DISTANCE_M), way, np.nan)
    return out


def _length_texts(lines: _Lines, apart: Array, where: str) -> list[str]:
    """Return what is said of lengths that contradict; nothing if none does.

    Args:
        lines: the lines.
        apart: how far apart their ends are, or are at most, (n,) metres; NaN: nobody knows.
        where: what it says of the points.
    """
    ratio = lines.stated / apart
    wrong = np.flatnonzero((ratio > MIN_LENGTH_RATIO) | (ratio < 1.0 / MIN_LENGTH_RATIO))
    if not len(wrong):
        return []
    first = int(wrong[0])
    unit = "metres" if ratio[first] > MIN_LENGTH_RATIO else "thousands of kilometres"
    told = (
        f"the lengths of {len(wrong)} lines contradict the places of their ends, the first"
        if len(wrong) > 1
        else "the length of a line contradicts the places of its ends,"
    )
    return [
        f"{told} {lines.labels[first]}: {lines.stated[first] / 1e3:g} km between points "
        f"{where.format(apart[first])}; is it in {unit}? The weight of a line depends on its length"
    ]


def exchanged_heights(network: Network) -> Iterator[Finding]:
    """Find the heights of instruments and targets exchanged: whole columns of them.

    An instrument stands at one height while it turns to targets of several heights. Exchanged, the
    height of the instrument changes from sight to sight, and that of all targets is the same.
    """
    setups, _ = _set_ups(network)
    seen = [
        tuple({getattr(o, f"{name}_height") for o in readings} for name in ("instrument", "target"))
        for readings in setups.values()
        if len(readings) > 1
    ]
    differ = [targets for instruments, targets in seen if len(instruments) > 1]
    if len(differ) < 2 or len(differ) < MIN_EXCHANGED_SHARE * len(seen):
        return
    if any(len(targets) > 1 for _, targets in seen) or not any(any(t) for t in differ):
        return
    yield Finding(
        f"at {len(differ)} of {len(seen)} stations the height of the instrument changes from sight "
        "to sight, and that of all targets is the same: the heights of instruments and targets are "
        "exchanged",
        "exchange the columns instrument_height and target_height",
    )


def differing_heights(network: Network) -> Iterator[Finding]:
    """Iterate over set-ups with several heights of the instrument, or with some missing."""
    setups, sets = _set_ups(network)
    for (station, number), readings in setups.items():
        counts = Counter(o.instrument_height for o in readings)  # type: ignore[attr-defined]
        if len(counts) < 2:
            continue
        usual, _ = counts.most_common(1)[0]
        others = [o for o in readings if o.instrument_height != usual]  # type: ignore[attr-defined]
        where = f"station {station!r}" + (f", set {number!r}" if len(sets[station]) > 1 else "")
        missing = all(o.instrument_height == 0.0 for o in others)  # type: ignore[attr-defined]
        told = "no height of the instrument" if missing else "another height of the instrument"
        first = others[0]
        yield Finding(
            f"{len(others)} of {len(readings)} readings at {where} have {told} than the usual "
            f"{usual:g} m, the first {first.label()} ({first.instrument_height:g} m)"  # type: ignore[attr-defined]
            if not missing
            else f"{len(others)} of {len(readings)} readings at {where} have {told}, the others "
            f"{usual:g} m; the first is {first.label()}",
            "give the height that was measured, or another set to another set-up",
        )


def _set_ups(
    network: Network,
) -> tuple[dict[tuple[str, str], list[Observation]], dict[str, set[str]]]:
    """Return the readings of set-ups by station and set, and the sets of stations.

    The readings of a set of directions belong to one set-up. Other readings at a station count to
    its set-up if it has one set. Directions without heights, as formats have them that give heights
    to distances and zenith angles alone, are no doubt: they do not depend on heights.
    """
    setups: dict[tuple[str, str], list[Observation]] = defaultdict(list)
    sets: dict[str, set[str]] = defaultdict(set)
    for o in of_quantities(network.observations.values(), "direction"):
        sets[o.station].add(o.set)
        if o.instrument_height != 0.0:
            setups[o.station, o.set].append(o)
    inclined: frozenset[Quantity] = INCLINATION_QUANTITIES | {"slope distance"}
    for o in of_quantities(network.observations.values(), *inclined):
        mine = sets[o.station]
        if len(mine) <= 1:
            setups[o.station, next(iter(mine), "")].append(o)
    return setups, sets


def contradicting_surfaces(equations: Equations) -> Iterator[Finding]:
    """Iterate over surfaces whose stated height is far from that of the points on them."""
    for kind in UNKNOWNS.values():
        first = kind.components[0] if kind.components else None
        if first is None or not (kind.connects and kind.on_earth and first.whole):
            continue
        if first.quantity == "length" and len(equations.unknowns[kind.name].names):
            yield from _of_kind(equations, kind)


def _of_kind(equations: Equations, kind: UnknownKind) -> Iterator[Finding]:
    table = equations.unknowns[kind.name]
    parts = [
        _implied(equations, block, place)
        for block in equations.blocks
        if not block.prior
        for place, (what, _) in enumerate(block.variables)
        if what == kind.name
    ]
    if not parts:
        return
    number, higher, sigma, rough = (np.concatenate([p[i] for p in parts]) for i in range(4))
    labels = [name for p in parts for name in p[4]]
    for n in np.unique(number).tolist():
        stated = float(table.values[n, 0])
        free, weight = bool(table.free[n, 0]), float(table.sigma[n, 0])
        approximate = free and not np.isfinite(weight)
        # A height of exactly zero that is only approximate is one that was not stated.
        if not np.isfinite(stated) or (approximate and stated == 0.0):
            continue
        rows = np.flatnonzero(number == n)
        sure = rows[~rough[rows].astype(bool)]
        own = sure if len(sure) else rows
        off = float(np.median(higher[own]))
        apart = SIGMA_PER_MEDIAN_DEVIATION * float(np.median(np.abs(higher[own] - off)))
        spread = max(apart, float(np.median(sigma[own])))
        limit = TOLERANCE_IN_SIGMAS * float(
            np.hypot(spread, weight if free and not approximate else 0.0)
        )
        if approximate or not len(sure):
            limit = max(limit, MIN_FIT_IMPROVEMENT * max(spread, APPROXIMATE_HEIGHT_ERROR_M))
        if abs(off) <= limit:
            continue
        how = "approximate" if approximate else "weighted" if free else "held"
        on = known([labels[i] for i in own.tolist()], most=3)
        yield Finding(
            f"{kind.noun} {table.names[n]!r}: its {how} height of {significant(stated, 7)} m "
            f"contradicts the given heights of the {len(own)} points on it, by which it is "
            f"{significant(stated + off, 7)} m ({on})",
            "look at its value, and at the heights of these points",
            -off,
            limit,
            "m",
        )


def _implied(
    equations: Equations, block: Block, place: int
) -> tuple[Index, Array, Array, Array, list[str]]:
    """Return surfaces, by how much higher they are, σ, whether by rough points, and labels."""
    state = equations.unknowns.start()
    fine = np.ones(block.n, dtype=bool)
    rough, given = np.zeros((2, block.n))
    for what, index in block.variables:
        fine &= np.isfinite(state[what][index]).all(axis=1)
        if what in ("point", "pose"):
            table = equations.unknowns[what]
            unsure = table.free[index] & ~np.isfinite(table.sigma[index])
            rough = np.maximum(rough, unsure.any(axis=1))
            weights = np.where(np.isfinite(table.sigma[index]), table.sigma[index], 0.0)
            given = np.hypot(given, np.where(table.free[index], weights, 0.0).max(axis=1))
    rows = np.flatnonzero(fine)
    number = block.variables[place][1]
    part = block.select(rows)
    try:
        found = part.evaluate(equations.network.frame, state)
    except InputError:
        rows, found = rows[:0], None
    if found is None or not len(rows):
        none = np.zeros(0)
        return number[:0], none, none, none, []
    partial = found.jacobians[place][:, 0, 0]
    seen = partial != 0.0
    higher = -found.residual[seen, 0] / partial[seen]
    sigma = np.hypot(part.sigma[seen, 0] / np.abs(partial[seen]), given[rows[seen]])
    rows = rows[seen]
    return number[rows], higher, sigma, rough[rows], [block.labels(int(i)) for i in rows]


def intervals_without_readout(network: Network) -> Iterator[Finding]:
    """Yield cameras whose readout time of 1 s stands for an unknown one, if intervals need it."""
    own: dict[str, list[str]] = defaultdict(list)
    for ident, o in network.observations.items():
        if "interval" in o.record.constants:
            for kind, attribute in o.record.parameters:
                if UNKNOWNS[kind].in_photo:
                    own[network.photos[getattr(o, attribute)].camera].append(ident)
    for name, ids in own.items():
        if network.cameras[name].readout == UNKNOWN_READOUT:
            yield Finding(
                f"camera {name!r} has a readout time of 1 s, which stands for an unknown one, and "
                f"{len(ids)} observations of its motions have intervals in this unit",
                "state the true readout time if the intervals are in seconds",
                ids=tuple(ids),
            )


def doubtful_distortion_tables(equations: Equations) -> Iterator[Finding]:
    """Yield cameras whose table of distortions, or its unit of length, is not that of a lens."""
    calibrations = equations.unknowns["calibration"].values
    reach: dict[FilmLens, float] = {}
    for block in equations.blocks:
        lens = block.lens
        if isinstance(lens, FilmLens) and lens.radii and len(block.observed):
            at = block.observed - calibrations[block.variables[1][1], 1:3]
            far = lens.pixel * float(np.linalg.norm(at, axis=1).max())
            reach[lens] = max(far, reach.get(lens, 0.0))
    for lens, far in reach.items():
        cameras = [repr(n) for n, c in equations.network.cameras.items() if c.lens == lens]
        radii, radial = np.array(lens.radii), np.atleast_2d(np.array(lens.radial or 0.0))
        found = []
        if np.abs(radial).max() > MAX_DISTORTION_SHARE * radii[-1]:
            found.append(f"has distortions of up to {np.abs(radial).max():g}")
        if np.any(np.diff(radii - radial, axis=1) <= 0):
            found.append("has the same image at several distances from the principal point")
        if radii[-1] > FAR_RADII * far > 0:
            found.append(f"goes far beyond the image, in which points are within {far:.4g}")
        if found:
            yield Finding(
                f"camera {known(cameras)}: the table of distortions, to radius {radii[-1]:g}, "
                f"{' and '.join(found)}",
                "state pixel, radii and distortions in one unit of length on the film",
            )


def places_beyond_coefficients(equations: Equations) -> Iterator[Finding]:
    """Yield cameras with points far outside the range of their rational polynomials."""
    network, unknowns = equations.network, equations.unknowns
    if not isinstance(network.frame, GeocentricFrame | TopocentricFrame):
        return
    given = unknowns["point"].values
    for block in equations.blocks:
        if not isinstance(block.lens, RpcLens):
            continue
        number = dict(block.variables)["point"]
        at = given[number]
        on = np.flatnonzero(np.isfinite(at).all(axis=1))
        if isinstance(network.frame, TopocentricFrame):
            at = network.frame.to_geocentric(at)
        k = unknowns["calibration"].values[np.asarray(block.variables[1][1])]
        far = on[np.abs(normalised_plan(at[on], k[on])).max(axis=1, initial=0.0) > FAR_NORMALISED]
        if len(far):
            yield Finding(
                f"{len(far)} points lie far outside the range of the rational polynomials of their "
                f"images, first {block.labels(int(far[0]))}",
                "look whether latitude and longitude are exchanged, in points or coefficients",
                ids=tuple(str(block.ids[i]) for i in far[:MOST_NAMED].tolist()),
            )


MAX_DISTORTION_SHARE = 0.02
"""Radial distortion relative to the largest radius from which a table is doubted."""
FAR_RADII = 10.0
"""Largest radius of a table relative to that of image points from which its unit is doubted."""
FAR_NORMALISED = 1.5
"""Normalised latitude or longitude from which a point is outside the range of coefficients."""


def places_beyond_tables(equations: Equations) -> Iterator[Finding]:
    """Yield cameras with image points beyond the last radius of the table of their lens."""
    calibrations = equations.unknowns["calibration"].values
    for block in equations.blocks:
        lens = block.lens
        if not isinstance(lens, FilmLens) or not lens.radii:
            continue
        number = block.variables[1][1]
        k = calibrations[number, : len(lens.names)]
        at = tangents(lens, block.observed, k) * k[:, :1]
        beyond = np.flatnonzero(lens.pixel * np.linalg.norm(at, axis=1) > lens.radii[-1])
        if len(beyond):
            yield Finding(
                f"the table of distortions ends at {lens.radii[-1]:g}, and {len(beyond)} image "
                f"points lie beyond it, first {block.labels(int(beyond[0]))}: the distortion of "
                "the last radius counts for them",
                "state the table to the corners of the image",
                ids=tuple(str(block.ids[i]) for i in beyond[:MOST_NAMED].tolist()),
            )


MOST_NAMED = 20
"""Largest number of image points beyond a table that a finding names."""
