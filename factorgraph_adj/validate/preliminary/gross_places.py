"""Places that do not fit in two systems: gross errors, and two places that are exchanged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...errors import known
from ...graph.equations import Equations
from ...network.network import Network
from ...quality.distributions import chi2_upper_quantile
from ...types import Array
from .closures import WORST
from .finding import Finding
from .similar import Pair, Similarity, System

ALPHA = 0.001
"""Probability that a comparison of two systems, or a loop, is told although nothing is wrong."""
LEAST = 4
"""Smallest number of common places of which one can be wrong."""
TRIED = 8
"""Number of places, those that fit worst, of which two are tried as exchanged."""
GIVEN = "the given coordinates"
"""Name of the system of the given coordinates."""


@dataclass(frozen=True)
class Wrong:
    """A place that does not fit in a pair of systems."""

    key: int
    """Number of the place."""
    systems: tuple[str, str]
    """Names of both systems."""
    size: float
    """Its error if it alone is wrong, unit of the second system."""
    tolerance: float
    """The size that would be tolerated."""
    other: int | None = None
    """Number of the place with which it is exchanged; None: it is wrong by itself."""


def _inside(own: list[Wrong]) -> list[str]:
    """Return the systems in which what is wrong with a place is: one, or two that contradict."""
    counts = Counter(n for w in own for n in w.systems)
    worst = max(own, key=lambda w: w.size / w.tolerance)
    shared = [n for n, c in counts.items() if c == len(own) > 1 and n != GIVEN]
    return shared or [n for n in worst.systems if n != GIVEN]


def put_right(system: System, exchanges: list[Wrong]) -> System:
    """Return a system with the exchanges of places undone that are in it."""
    x, sigma = system.x.copy(), system.sigma.copy()
    for pair in {frozenset((w.key, w.other)) for w in exchanges}:
        own = [w for w in exchanges if frozenset((w.key, w.other)) == pair]
        rows = np.flatnonzero(np.isin(system.keys, [w.key for w in own]))
        if _inside(own)[0] == system.name and len(rows) == len(pair):
            x[rows], sigma[rows] = x[rows[::-1]], sigma[rows[::-1]]
    return replace(system, x=x, sigma=sigma)


def without_gross(pair: Pair, wrong: list[Wrong]) -> Similarity | None:
    """Return the similarity of the places that fit, none if they fix none; note the others.

    Two places that fit when they are exchanged are no gross errors but an exchange.
    """
    while pair.determined:
        fit = pair.fitted()
        if len(pair.a) < LEAST:
            return fit
        error, share = _shares(fit)
        worst = int(np.argmax(share))
        if share[worst] <= 1.0:
            return fit
        names = (pair.first.name, pair.second.name)
        sizes = np.linalg.norm(error, axis=1)
        tolerances = sizes / np.sqrt(np.maximum(share, 1e-300))
        exchanged = _exchanged(pair, share)
        if exchanged is not None:
            for i, j in (sorted(exchanged), sorted(exchanged)[::-1]):
                size = float(np.linalg.norm(pair.b[i] - pair.b[j]))
                own = float(tolerances[i])
                wrong.append(Wrong(int(pair.keys[i]), names, size, own, int(pair.keys[j])))
            pair = pair.exchanged(*exchanged)
            continue
        wrong.append(
            Wrong(int(pair.keys[worst]), names, float(sizes[worst]), float(tolerances[worst]))
        )
        pair = pair.without(worst)
    return None


def _shares(fit: Similarity) -> tuple[Array, Array]:
    """Return ∇ (n, d) of every place and its test value in units of its limit, (n,)."""
    error, test, freedom = fit.tests()
    limit = chi2_upper_quantile(ALPHA / len(test), np.maximum(freedom, 1))
    return error, np.where(freedom > 0, test / limit, 0.0)


def _exchanged(pair: Pair, share: Array) -> tuple[int, int] | None:
    """Return two places that fit when they are exchanged; none: no two do.

    They must be controlled, and the worst of the others must not fit worse than before.
    """
    if len(pair.a) <= LEAST:
        return None
    tried = np.argsort(-share, kind="stable")[:TRIED].tolist()
    best: tuple[float, tuple[int, int]] | None = None
    for i, j in combinations(tried, 2):
        if max(share[i], share[j]) <= 1.0:
            continue
        _, other = _shares(pair.exchanged(i, j).fitted())
        left = float(other.max())
        if max(other[i], other[j]) <= 1.0 and left < share.max():
            best = min(best or (left, (i, j)), (left, (i, j)))
    return None if best is None else best[1]


def ids_in(
    network: Network, systems: Collection[str], places: Collection[str] | None = None
) -> tuple[str, ...]:
    """Return the ids of what was observed in some systems, of all places or of some.

    Args:
        network: the network.
        systems: names of systems, as findings say them.
        places: names of places, as findings say them; none: all.
    """
    return tuple(
        i
        for i, o in network.observations.items()
        if any(f"frame {f!r}" in systems for f in o.frames())
        and (
            places is None
            or any(f"point {p!r}" in places for p in o.points())
            or any(f"photo {p!r}" in places for p in o.photos())
        )
    )


def gross_places(equations: Equations, wrong: list[Wrong]) -> Iterator[Finding]:
    """Places that do not fit, each once: in the frame that all its comparisons share."""
    unknowns = equations.unknowns
    names = [f"point {n!r}" for n in unknowns["point"].names]
    names += [f"photo {n!r}" for n in unknowns["pose"].names]
    found: list[tuple[float, Finding]] = []
    told: set[tuple[int, int | None]] = set()
    for key, other in dict.fromkeys((w.key, w.other) for w in wrong):
        if other is not None and (other, key) in told:
            continue
        told.add((key, other))
        own = [w for w in wrong if (w.key, w.other) == (key, other)]
        counts = Counter(n for w in own for n in w.systems)
        worst = max(own, key=lambda w: w.size / w.tolerance)
        inside = _inside(own)
        others = [n for n in counts if n not in inside]
        between = f"beside {known(others)}" if others else "each other"
        verb = "does" if others or len(inside) == 1 else "do"
        if other is None:
            what = f"{names[key]} in {' and '.join(inside)} {verb} not fit {between}, by the places"
            what += " that they have in common"
            remedy = "look for a wrong reading, or for a name confused with another"
        else:
            where = inside[0] if len(inside) == 1 else f"one of {' and '.join(inside)}"
            what = f"{names[key]} and {names[other]} are exchanged in {where}: they fit {between}"
            what += " with the names of each other, apart"
            remedy = "exchange their names"
        size, most = 1e3 * worst.size, 1e3 * worst.tolerance
        ids: tuple[str, ...] = ()
        if other is not None:
            ids = ids_in(equations.network, inside, {names[key], names[other]})
        finding = Finding(what, remedy, size, most, "mm", ids)
        found.append((worst.size / worst.tolerance, finding))
    found.sort(key=lambda each: -each[0])
    for _, finding in found[:WORST]:
        yield finding
