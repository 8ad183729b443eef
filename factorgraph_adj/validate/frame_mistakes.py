"""Frames of their own that do not fit: mirrored, far origins, scales, gross places, open loops.

Pairs of frames with common places, and frames with the given coordinates, are compared by a
similarity, see `common_places`; no adjustment is needed. (Bouloucos, pre-adjustment detection of
gross errors; FRAMES F1.7.)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..errors import known
from ..graph.equations import Equations
from ..observations import KINDS
from ..rotation import log_rotation
from ..start.frame_places import read_sights
from ..statistical_tests import chi2_upper_quantile
from ..types import Array, Index
from ..units import ANGLE, significant
from .common_places import (
    ALPHA_OF_PLACES,
    GIVEN_COORDINATES,
    MIN_THIRD_EXTENT_RATIO,
    CommonPlaces,
    MisfittingPlace,
    PlaceSimilarity,
    PlaceSystem,
    accusations,
    common_places,
    gross_places,
    ids_of_systems,
    similarity_without_gross_errors,
    with_exchanges_undone,
)
from .contradicting_groups import MIN_SCALE_DIFFERENCE, factor_meaning
from .findings import Finding
from .instrument_axes import left_handed_frames, tilted_frames, wrong_circle_units
from .loop_misclosures import MAX_LISTED_MISCLOSURES, MAX_OBSERVATIONS_OF_LOOP, closed_loops

MIN_MIRROR_IMPROVEMENT = 5.0
"""How many times better places must fit with a mirror for it to be reported."""
MAX_ORIGIN_EXTENT_RATIO = 1000.0
"""Distance of an origin from the middle of its places, in their extent, beyond which it is
reported: the correlation of offset and rotation is nearer to one than a millionth then."""
MAX_COMPARED_PAIRS = 2000
"""Largest number of pairs that are compared; those with the most common places come first."""


def misfitting_frames(
    equations: Equations, length: str = "m", angle: str = "gon"
) -> Iterator[Finding]:
    """Iterate over doubts about places in frames.

    Args:
        equations: the network.
        length: unit of lengths in its files.
        angle: unit of angles in its files.
    """
    given = _given(equations)
    systems = _systems(equations, given)
    if not systems:
        return
    yield from _far_origins(equations, systems, given)
    yield from left_handed_frames(equations.network)
    if equations.network.frame.left_handed:
        given = replace(given, horizon=_horizon(equations, np.zeros(3)))
    network = equations.network
    mirrored, findings = _mirrored([*systems.values(), given])
    yield from (replace(f, ids=ids_of_systems(network, mirrored)) for f in findings)
    scaled, findings = _scaled([*systems.values(), given], length)
    yield from (replace(f, ids=ids_of_systems(network, scaled)) for f in findings)
    turned, findings = wrong_circle_units(equations, [*systems.values(), given], angle)
    yield from findings
    clean = [s for s in systems.values() if s.name not in mirrored | scaled | turned]
    tilted, findings = tilted_frames(clean, given)
    yield from (replace(f, ids=ids_of_systems(network, tilted)) for f in findings)
    clean = [replace(s, upright=s.upright and s.name not in tilted) for s in clean]
    fits, wrong = _compared([*clean, given])
    exchanges = [w for w in wrong if w.other is not None]
    if exchanges:
        # An exchange that many places show is put right before few places are compared.
        clean = [with_exchanges_undone(s, exchanges) for s in clean]
        fits, wrong = _compared([*clean, given])
        known_ones = {frozenset((w.key, w.other)) for w in exchanges}
        further = [w for w in wrong if frozenset((w.key, w.other)) not in known_ones]
        wrong = [*exchanges, *further]
    yield from gross_places(equations, wrong)
    yield from _open_loops(fits)


# -- what was measured ----------------------------------------------------------------------------


def _systems(equations: Equations, given: PlaceSystem) -> dict[int, PlaceSystem]:
    """Return the places of each frame by its number; photos follow the points.

    A sight with direction, zenith angle and distance gives a place.
    """
    n_points = len(equations.unknowns["point"].names)
    table = equations.unknowns["frame"]
    parts: list[tuple[Index, Index, Array, Array]] = []
    for block in equations.blocks:
        record = KINDS.get(block.kind)
        if block.prior or record is None or record.in_frame != "coordinates":
            continue
        (_, frame), (what, place) = block.variables[:2]
        q, sigma = np.full((2, block.n, 3), np.nan)
        columns = ["xyz".index(a) for a in block.components]
        q[:, columns], sigma[:, columns] = block.observed, block.sigma
        key = place + (n_points if what == "pose" else 0)
        parts.append((frame, key, q, np.sqrt(np.nanmean(sigma**2, axis=1))))
    sights = read_sights(equations)
    on = np.flatnonzero(sights.whole)
    if len(on):
        parts.append((sights.frame[on], sights.point[on], sights.q[on], sights.spread[on]))
    if not parts:
        return {}
    frame, key, q, sigma = (np.concatenate(c) for c in zip(*parts, strict=True))
    level = [bool(p.constants[-1]) for p in equations.network.frames.values()]
    out = {}
    for f in np.unique(frame).tolist():
        rows = np.flatnonzero((frame == f) & np.isfinite(q[:, :2]).all(axis=1))
        keys, first = np.unique(key[rows], return_index=True)
        rows = rows[first]
        scale = np.nan if table.free[f, 6] else float(table.values[f, 12])
        upright = not table.free[f, :2].any()
        name = f"frame {table.names[f]!r}"
        at = _origin(equations, f, keys, given) if level[f] else None
        horizon = None if at is None else _horizon(equations, at)
        out[f] = PlaceSystem(name, keys, q[rows], sigma[rows], upright, scale, horizon)
    return out


def _origin(equations: Equations, f: int, keys: Index, given: PlaceSystem) -> Array | None:
    """Return the origin of a frame; if it is not known the middle of its places, if they are."""
    stated = equations.network.frames[equations.unknowns["frame"].names[f]]
    if not stated.origin:
        return np.array(stated.constants[:3])
    points = equations.unknowns["point"]
    at = points.values[points.number[stated.origin]]
    if np.isfinite(at).all():
        return np.asarray(at)
    places = given.x[np.isin(given.keys, keys)]
    return np.asarray(places.mean(axis=0)) if len(places) else None


def _horizon(equations: Equations, at: Array) -> Array:
    """Return east, north and up (3, 3) at a place (3,)."""
    return np.asarray(equations.network.frame.basis(at[None], np.zeros((1, 2))).enu[0])


def _given(equations: Equations) -> PlaceSystem:
    """Return the points and projection centres with given coordinates.

    Held and weighted ones have a standard deviation, those that are only approximate have none.
    """
    points, poses = equations.unknowns["point"], equations.unknowns["pose"]
    x = np.concatenate([points.values, poses.values[:, 9:]])
    free = np.concatenate([points.free, poses.free[:, 3:]])
    stated = np.concatenate([points.sigma, poses.sigma[:, 3:]])
    sigma = np.sqrt(np.mean(np.where(free, stated, 0.0) ** 2, axis=1))
    rows = np.flatnonzero(np.isfinite(x).all(axis=1))
    rough = np.where(np.isfinite(sigma), sigma, np.nan)
    return PlaceSystem(GIVEN_COORDINATES, rows, x[rows], rough[rows], True, 0.0)


def _pairs(systems: list[PlaceSystem], *, rough: bool = False) -> list[CommonPlaces]:
    """Return the pairs of systems with common places, those with the most first."""
    by_place: dict[int, list[int]] = {}
    for number, system in enumerate(systems):
        for key in system.keys.tolist():
            by_place.setdefault(key, []).append(number)
    counts = Counter(p for numbers in by_place.values() for p in combinations(numbers, 2))
    enough = [p for p, n in counts.most_common(MAX_COMPARED_PAIRS) if n >= 2]
    found = (
        common_places(systems[i], _to_the_horizon(systems[i], systems[j]), rough=rough)
        for i, j in enough
    )
    return [pair for pair in found if pair is not None]


def _to_the_horizon(first: PlaceSystem, second: PlaceSystem) -> PlaceSystem:
    """Return the second system; the given coordinates as they are in the horizon of the first.

    Compared with a frame that is not level, left-handed coordinates are in a horizon too.
    """
    if second.name != GIVEN_COORDINATES:
        return second
    horizon = second.horizon if first.horizon is None else first.horizon
    return second if horizon is None else replace(second, x=second.x @ horizon.T)


# -- origins and axes -----------------------------------------------------------------------------


def _far_origins(
    equations: Equations, systems: Mapping[int, PlaceSystem], given: PlaceSystem
) -> Iterator[Finding]:
    """Frames with an offset and a turn to be found whose constant origin is far from its places."""
    table = equations.unknowns["frame"]
    stated = list(equations.network.frames.values())
    for f, system in systems.items():
        free = table.free[f] & np.isinf(table.sigma[f])
        x = given.x[np.isin(given.keys, system.keys)]
        if stated[f].origin or len(x) < 2 or not (free[:3].any() and free[3:6].any()):
            continue
        middle = x.mean(axis=0)
        extent = float(np.sqrt(np.mean(np.sum((x - middle) ** 2, axis=1))))
        away = float(np.linalg.norm(middle - table.values[f, 13:16]))
        if extent > 0 and away > MAX_ORIGIN_EXTENT_RATIO * extent:
            place = " ".join(f"{v:.0f}" for v in middle)
            yield Finding(
                f"the origin of {system.name} is far from its places, which extend over "
                f"{extent:.3g} m: its offset and its rotation are hardly separable",
                f"give it a constant origin near the middle of its places, {place}",
                away / 1e3,
                MAX_ORIGIN_EXTENT_RATIO * extent / 1e3,
                "km",
            )


def _mirrored(systems: list[PlaceSystem]) -> tuple[set[str], list[Finding]]:
    """Return the names of frames with left-handed axes, and what to say of them.

    Of two frames that mirror each other the one that mirrors more others is meant; the given
    coordinates are right.
    """
    found: dict[tuple[str, str], float] = {}
    for pair in _pairs(systems, rough=True):
        extents = pair.extents()
        if len(pair.a) <= pair.size or extents[-1] < MIN_THIRD_EXTENT_RATIO * extents[0]:
            continue
        usual, mirror = pair.fitted().rms, pair.fitted(mirrored=True).rms
        if mirror * MIN_MIRROR_IMPROVEMENT < usual:
            found[pair.first.name, pair.second.name] = usual / max(mirror, 1e-12)
    named: set[str] = set()
    findings = []
    for names, own in accusations(found):
        other = known([n for p in own for n in p if n not in names]) if len(names) == 1 else ""
        times = float(np.median(list(own.values())))
        one = "its axes are" if len(names) == 1 else "the axes of one of them are"
        against = f"those of {other}" if other else "each other"
        findings.append(
            Finding(
                f"the places of {' and '.join(names)} fit {against} {times:.0f} times better with "
                f"a mirror: {one} left-handed",
                "exchange x and y, or change the sign of one axis",
            )
        )
        named |= set(names)
    return named, findings


def _scaled(systems: list[PlaceSystem], length: str) -> tuple[set[str], list[Finding]]:
    """Return the names of frames whose scale is held and does not fit, and what to say of them.

    The given coordinates are right; of two frames, the one that more others contradict.
    """
    found: dict[tuple[str, str], float] = {}
    times: dict[tuple[str, str], float] = {}
    for pair in _pairs(systems, rough=True):
        if len(pair.a) <= pair.size or np.isnan(pair.first.fixed_scale - pair.second.fixed_scale):
            continue
        held, free = pair.fitted(), pair.of_unknown_scale().fitted()
        ln_factor = float(np.log(free.scale / held.scale)) if free.scale > 0 else 0.0
        if (
            free.rms * MIN_MIRROR_IMPROVEMENT < held.rms
            and abs(np.expm1(ln_factor)) > MIN_SCALE_DIFFERENCE
        ):
            names = pair.first.name, pair.second.name
            found[names], times[names] = ln_factor, held.rms / max(free.rms, 1e-12)
    named: set[str] = set()
    findings = []
    for (name,), pairs in accusations(found, alternatives=False):
        own = {p: f if p[0] == name else -f for p, f in pairs.items()}
        factor = float(np.exp(np.median(list(own.values()))))
        others = [n for p in own for n in p if n not in (name, GIVEN_COORDINATES)]
        against = " and ".join(
            [
                *([f"those of {known(others)}"] if others else []),
                *([GIVEN_COORDINATES] if any(GIVEN_COORDINATES in p for p in own) else []),
            ]
        )
        better = float(np.median([times[p] for p in own]))
        findings.append(
            Finding(
                f"the places of {name} fit {against} {better:.0f} times better with the "
                f"factor {significant(factor, 4)}{factor_meaning(factor, length)}",
                f"state the unit of its places, or that of the coordinates ({length} is stated), "
                "or let the scale of the frame free",
            )
        )
        named.add(name)
    return named, findings


def _compared(systems: list[PlaceSystem]) -> tuple[list[PlaceSimilarity], list[MisfittingPlace]]:
    """Return the similarities of frames, and the places that do not fit in any two systems."""
    fits: list[PlaceSimilarity] = []
    wrong: list[MisfittingPlace] = []
    for pair in _pairs(systems):
        fit = similarity_without_gross_errors(pair, wrong)
        if fit is not None and GIVEN_COORDINATES not in (pair.first.name, pair.second.name):
            fits.append(fit)
    return fits, wrong


# -- loops ----------------------------------------------------------------------------------------


def _open_loops(fits: list[PlaceSimilarity]) -> Iterator[Finding]:
    """Loops of frames whose turns, Log(R₁₂ R₂₃ R₃₁), or scales do not close.

    The similarities are taken as independent. Those of a loop that share places of a frame agree
    better than that, so that the tolerance is on the safe side.
    """
    names = list(dict.fromkeys(n for f in fits for n in (f.pair.first.name, f.pair.second.name)))
    start, end = (
        np.array([names.index(n) for n in each], dtype=np.intp)
        for each in (
            [f.pair.first.name for f in fits],
            [f.pair.second.name for f in fits],
        )
    )
    found: list[tuple[float, Finding]] = []
    for loop in closed_loops(start, end):
        along, w, covariance = _around(fits, loop, start, end)
        named = known((names[i] for i in along), most=MAX_OBSERVATIONS_OF_LOOP)
        for part, what, size, unit in (
            (slice(0, 3), "turns", ANGLE["mgon"], "mgon"),
            (slice(3, 4), "scales", 1e-6, "ppm"),
        ):
            test, freedom = _misclosure_test(w[part], covariance[part, part])
            if not freedom:
                continue
            share = test / float(chi2_upper_quantile(ALPHA_OF_PLACES, freedom))
            off = float(np.linalg.norm(w[part]))
            if share > 1.0:
                finding = Finding(
                    f"the {what} of the loop of {named} do not close",
                    "look for names confused in one of them",
                    off / size,
                    off / size / float(np.sqrt(share)),
                    unit,
                    statistic=test,
                    freedom=freedom,
                )
                found.append((share, finding))
    found.sort(key=lambda each: -each[0])
    for _, finding in found[:MAX_LISTED_MISCLOSURES]:
        yield finding


def _around(
    fits: list[PlaceSimilarity], loop: list[tuple[int, int]], start: Index, end: Index
) -> tuple[list[int], Array, Array]:
    """Return the systems of a loop in order, its misclosure (4,), and the covariance (4, 4).

    The misclosure is the rotation vector, radians, and ln of the scale.
    """
    rest = dict(loop)
    at, along = int(start[loop[0][0]]), []
    rotation, ln_scale, covariance = np.eye(3), 0.0, np.zeros((4, 4))
    while rest:
        number = next(n for n in rest if at in (start[n], end[n]))
        del rest[number]
        fit = fits[number]
        turn, own = fit.turn()
        along.append(at)
        if at == start[number]:
            at, sign = int(end[number]), 1.0
        else:
            at, sign, turn = int(start[number]), -1.0, turn.T
            own[:3, :3] = turn @ own[:3, :3] @ turn.T
        covariance[:3, :3] = turn @ covariance[:3, :3] @ turn.T + own[:3, :3]
        covariance[3, 3] += own[3, 3]
        rotation = turn @ rotation
        ln_scale += sign * float(np.log(fit.scale))
    w = np.append(log_rotation(rotation[None])[0], ln_scale)
    return along, w, covariance


def _misclosure_test(w: Array, covariance: Array) -> tuple[float, int]:
    """Return the test value of a misclosure, and its degrees of freedom."""
    values, vectors = np.linalg.eigh(covariance)
    known_ones = values > 1e-12 * values[-1]
    test = np.sum((vectors.T @ w)[known_ones] ** 2 / values[known_ones])
    return float(test), int(known_ones.sum())
