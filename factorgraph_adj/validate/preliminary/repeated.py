"""Readings of the same thing, forth, back or again: they must agree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations, pairwise

import numpy as np

from ...frames import MEAN_EARTH_RADIUS
from ...network.network import Network
from ...observations import (
    HorizontalDistance,
    Observation,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from ...observations.weights import Along
from ...quality.distributions import poisson_from
from ...stochastic import StandardDeviation
from ...types import Array
from .finding import TIMES, Finding

REFRACTION = 0.13
"""Coefficient of refraction with which height differences forth and back are compared."""
DOUBT = 0.3
"""Standard deviation of it, for the tolerance."""

CHANCE = 0.05
"""Probability with which so many equal readings are no copies, above which nothing is doubted."""
STEPS = 2.0
"""Scatter of repeated readings in steps of their resolution, below which equal ones are common."""
UNITS = (1.0, np.pi / 200, np.pi / 180, np.pi / 648000)
"""Metre, gon, degree and second: in one of them readings are rounded."""
DECIMALS = 8
"""Number of decimals that are tried."""
FINEST = 1e-9
"""Resolution of readings that are rounded in no unit."""
ROUNDING = 1e-4
"""Distance from a whole number of steps that is rounding of double precision."""


def size_of(o: Observation, length: float) -> float:
    """Return the standard deviation of a reading over a sight of a length, unit of its value.

    Vectors of one component state it, or their covariance, for each component.
    """
    sigma = o.sigma  # type: ignore[attr-defined]
    if sigma is None:
        return float(np.sqrt(np.ravel(o.covariance)[0]))  # type: ignore[attr-defined]
    if not isinstance(sigma, StandardDeviation):
        return float(np.ravel(sigma)[0])
    weight = o.record.weight
    assert weight is not None
    return float(np.sqrt(weight.variance([sigma], Along(max(length, 1e-3)))[0]))


def repeated(network: Network) -> Iterator[Finding]:
    """Iterate over readings of the same thing that do not agree."""
    yield from _duplicates(network)
    yield from _distances(network)
    yield from _heights(network)


def _duplicates(network: Network) -> Iterator[Finding]:
    """Rows that are there twice more often than independent readings would be equal.

    Two readings with resolution u and standard deviation s are equal with p ≈ u / (2 √π s); of n
    readings n (n − 1) / 2 pairs may be. Where repeated readings differ by some steps of their
    resolution only, equal ones say nothing.
    """
    by_kind: dict[str, dict[tuple[object, ...], list[Observation]]] = {}
    for o in network.observations.values():
        key = (o.names(), repr(getattr(o, "sigma", None)), getattr(o, "set", None))
        by_kind.setdefault(o.kind, defaultdict(list))[key].append(o)
    for kind, again in by_kind.items():
        pairs = [pair for some in again.values() for pair in pairwise(_sorted(some))]
        copies = [(a, b) for a, b in pairs if np.array_equal(reading(a), reading(b))]
        if not copies:
            continue
        groups = [np.array([reading(o) for o in some]) for some in again.values()]
        step = resolution(np.concatenate([x.ravel() for x in groups]))
        scatter = scatter_of(groups)
        if scatter is not None and scatter < STEPS * step:
            continue
        expected = 0.0
        for some in again.values():
            expected += len(some) * (len(some) - 1) / 2 * chance_of_equal(some[0], step, scatter)
        if expected and poisson_from(len(copies), expected) > CHANCE:
            continue
        (first, second), n = copies[0], len(copies) - 1
        more = f", and {n} more of kind {kind}" if n else ""
        yield Finding(
            f"{second.label()} has the same names, value and σ as {first.label()}{more}",
            "remove one if the reading was copied: two of them make the result look more "
            "precise than it is",
        )


def reading(o: Observation) -> Array:
    """Return the observed values (q,); what has no value equals itself alone."""
    return np.atleast_1d(np.asarray(getattr(o, "value", np.nan), dtype=float)).ravel()


def _sorted(some: list[Observation]) -> list[Observation]:
    return sorted(some, key=lambda o: tuple(reading(o)))


def scatter_of(groups: list[Array]) -> float | None:
    """Return the standard deviation of repeated readings within their groups; none: all are equal.

    Copies are counted once, as they would make it smaller.
    """
    different = [np.unique(x, axis=0) for x in groups]
    number = sum((len(x) - 1) * x.shape[1] for x in different)
    if not number:
        return None
    return float(np.sqrt(sum(np.sum((x - x.mean(axis=0)) ** 2) for x in different) / number))


def chance_of_equal(o: Observation, step: float, scatter: float | None) -> float:
    """Return the probability with which a second reading equals this one; 0 if σ is not known.

    Of the stated σ and the scatter of repeated readings the smaller one counts: where the σ are
    stated too large, honest readings are equal more often than these say.
    """
    values = reading(o)
    known = [scatter] if scatter is not None else []
    if len(values) == 1:
        known.append(size_of(o, float(abs(values[0]))))
    if not known:
        return 0.0
    s = min(known)
    return float(min(1.0, step / (2 * np.sqrt(np.pi) * s)) ** len(values)) if s > 0 else 1.0


def resolution(readings: Array) -> float:
    """Return the coarsest decimal step of readings, in metres, gon, degrees or seconds."""
    finite = readings[np.isfinite(readings)]
    tried = (u * m / 10.0**d for u in UNITS for d in range(DECIMALS) for m in (5.0, 2.0, 1.0))
    fits = [s for s in tried if np.all(np.abs(finite / s - np.round(finite / s)) < ROUNDING)]
    return max([FINEST, *fits])


def _distances(network: Network) -> Iterator[Finding]:
    """The same distance with the same heights, and horizontal distances forth and back."""
    same: dict[tuple[object, ...], list[SlopeDistance]] = defaultdict(list)
    for o in network.observations.values():
        if isinstance(o, HorizontalDistance):
            same["horizontal", *sorted((o.station, o.target))].append(o)
        elif isinstance(o, SlopeDistance):
            ends = sorted(((o.station, o.instrument_height), (o.target, o.target_height)))
            same["slope", *ends].append(o)
    for group in same.values():
        for a, b in combinations(group, 2):
            w = a.value - b.value
            limit = TIMES * float(np.hypot(size_of(a, a.value), size_of(b, b.value)))
            if abs(w) > limit:
                yield Finding(
                    f"{a.label()} and {b.label()} differ",
                    "look for a wrong reading or name",
                    1e3 * w,
                    1e3 * limit,
                    "mm",
                )


def _elevations(network: Network) -> Iterator[tuple[VerticalAngle, float, float]]:
    """Iterate over vertical angles: a reading, the elevation in radians, and its σ as a part of σ.

    An index error that is unknown cancels in the mean of both faces of a sight, and explains any
    difference of readings in one face; so does a deflection of the vertical.
    """
    faces: dict[tuple[object, ...], list[ZenithAngle]] = defaultdict(list)
    for o in network.observations.values():
        if not isinstance(o, VerticalAngle) or o.station in network.verticals:
            continue
        if not isinstance(o, ZenithAngle):
            yield o, float(o.value), 1.0
        elif o.index_error is None:
            yield o, np.pi / 2 - o.in_face_one, 1.0
        else:
            sight = o.station, o.target, o.instrument_height, o.target_height, o.index_error
            faces[sight].append(o)
    for some in faces.values():
        first, second = ([o.in_face_one for o in some if o.face == face] for face in (1, 2))
        if first and second:
            mean = (np.mean(first) + np.mean(second)) / 2
            part = float(np.sqrt(1 / len(first) + 1 / len(second)) / 2)
            yield some[0], np.pi / 2 - float(mean), part


def _heights(network: Network) -> Iterator[Finding]:
    """Height differences and horizontal distances from zenith angles forth and back."""
    lengths: dict[tuple[str, str, float, float], float] = {}
    for o in network.observations.values():
        if isinstance(o, SlopeDistance) and not isinstance(o, HorizontalDistance):
            lengths[o.station, o.target, o.instrument_height, o.target_height] = o.value
    rises: dict[tuple[str, str], list[tuple[Observation, float, float, float]]] = defaultdict(list)
    for o, up, part in _elevations(network):
        s = lengths.get((o.station, o.target, o.instrument_height, o.target_height))
        if s is None:
            continue
        bend = (s * np.cos(up)) ** 2 / (2 * MEAN_EARTH_RADIUS)
        curved = getattr(network.frame, "curvature", True)
        rise = s * np.sin(up) + ((1.0 - REFRACTION) * bend if curved else 0.0)
        rise += o.instrument_height - o.target_height
        sigma = float(np.hypot(s * np.cos(up) * part * size_of(o, s), DOUBT * bend))
        rises[o.station, o.target].append((o, float(rise), sigma, s))
    for (a, b), there in rises.items():
        for back in rises.get((b, a), ()) if a < b else ():
            for forth in there:
                w = forth[1] + back[1]
                limit = TIMES * float(np.hypot(forth[2], back[2]))
                if abs(w) > limit:
                    yield Finding(
                        f"the height differences of {forth[0].label()} and {back[0].label()}, "
                        "forth and back, do not cancel",
                        "look for a wrong height of instrument or target, or zenith angle",
                        1e3 * w,
                        1e3 * limit,
                        "mm",
                    )
