"""Names of new points that may be typing errors of the name of a known point.

A typing error makes a new point of a known one. It is observed in one set-up alone, nothing depends
on it, and it comes to lie where the other point is: with the difference d of their n unknown
coordinates and the sum Σ of their covariances dᵀ Σ⁻¹ d follows χ² with n degrees of freedom. Two
points that are read in one set-up, such as the two edges of a kerb, may lie beside one another and
have numbers in a row: there only names that look alike are reported.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations, compile_rows
from ..graph.variables import State
from ..network.network import Network
from ..statistical_tests import chi2_upper_quantile
from ..types import Array, Index, Mask

LOOKALIKE_CHARACTERS = str.maketrans("Il|iOoQDSsBZzG", "11110000558226")
"""Characters that are taken for one another, each as the digit that it looks like."""
ALPHA_OF_SAME_PLACE = 1e-4
"""Probability that one point seems to lie elsewhere because of its observations' errors."""
START_SIGMA_FACTOR = 3.0
"""Factor on standard deviations of start values, of which each rests on other start values."""
MAX_REGION_SHARE = 0.02
"""Largest extent of the region in which two points count as one, relative to the distance of the
nearest point from which they are observed: a poorly determined point coincides with anything."""
SINGULAR_TRACE_SHARE = 1e-12
"""Smallest eigenvalue, relative to the trace, that is not zero but for rounding."""
MIN_PAIRS_OF_CONVENTION = 3
"""Number of pairs with the same difference from which on it is a rule of naming."""
MAX_MISTYPED_IN_REPORT = 6
"""Largest number of pairs that are named."""


@dataclass(frozen=True)
class MistypedName:
    """A name that may be a typing error."""

    name: str
    """The name that is used in one set-up alone."""
    other: str
    """Name of the point that lies in the same place."""
    distance: float
    """Distance of the two, metres."""
    tolerance: float
    """Distance within which they count as one point, in the direction of the difference, metres."""
    first: str
    """The first observation with the name."""

    def __str__(self) -> str:
        """Return the doubt as text."""
        size, most = (f"{1e3 * x:.3g} mm" for x in (self.distance, self.tolerance))
        return (
            f"point {self.name!r} may be point {self.other!r}, mistyped: it is observed in one "
            f"set-up alone and lies in the same place, {size} apart, tolerance {most} (first in "
            f"{self.first}); correct the name, or remove one of the points"
        )


def mistyped_at_start(network: Network, state: State) -> list[str]:
    """Return the doubts about names, by the start values of an adjustment.

    Args:
        network: the network.
        state: start values of all its unknowns.
    """
    equations = compile_rows(network)
    return listed_doubts(
        mistyped_names(
            equations, state, _local_covariances(equations, state), times=START_SIGMA_FACTOR
        )
    )


@dataclass(frozen=True)
class _Once:
    """A point that is observed in one set-up alone."""

    point: int
    """Its number."""
    station: int
    """Number of the point from which it is observed; itself where it is the station."""
    nearest: int
    """Number of a point that it is observed with."""
    label: str
    """Its first observation."""


def mistyped_names(
    equations: Equations, state: State, covariances: Callable[[Index], Array], *, times: float = 1.0
) -> list[MistypedName]:
    """Return the names that may be typing errors.

    Points of photos are left out: tie points have numbers, not names.

    Args:
        equations: the network.
        state: coordinates of all points, adjusted or approximate.
        covariances: returns the covariances (k, 3, 3) of points by their numbers, metres²; asked
            only where names are similar.
        times: factor on these standard deviations.
    """
    once = {o.point: o for o in _observed_once(equations)}
    table, xyz = equations.unknowns["point"], state["point"]
    pairs = [(once[a], b) for a, b in _similar(table.names, sorted(once))]
    # Near enough to be one point, whatever the standard deviations are.
    near = [
        (o, b)
        for o, b in pairs
        if np.linalg.norm(xyz[o.point] - xyz[b]) < MAX_REGION_SHARE * _reach(xyz, o)
    ]
    if not near:
        return []
    sighted = _sighted(equations)
    numbers = np.unique([(o.point, b) for o, b in near])
    of = dict(zip(numbers.tolist(), covariances(numbers), strict=True))
    found: dict[frozenset[int], tuple[MistypedName, str]] = {}
    in_a_row: set[frozenset[int]] = set()
    for o, b in near:
        free = table.free[o.point] & np.isfinite(xyz[o.point] + xyz[b])
        if not free[:2].all():
            continue  # heights of marks are equal by chance
        in_space = bool(free[2])
        if not sighted[o.point] and not sighted[b]:
            continue  # two free stations: an instrument is set up twice in one place on purpose
        seen_beside = _seen_from(equations, b, o.station)
        if not in_space and seen_beside:
            continue  # two floors of a building have points one above the other
        d = (xyz[o.point] - xyz[b])[free]
        sigma = times**2 * (of[o.point] + of[b])[np.ix_(free, free)]
        if not np.isfinite(sigma).all():
            continue
        limit = float(chi2_upper_quantile(ALPHA_OF_SAME_PLACE, len(d)))
        extent = np.sqrt(limit * float(np.linalg.eigvalsh(sigma)[-1]))
        test = float(d @ np.linalg.pinv(sigma, hermitian=True) @ d)
        if extent > MAX_REGION_SHARE * _reach(xyz, o) or test > limit:
            continue
        apart = float(np.linalg.norm(d))
        most = apart * np.sqrt(limit / test) if test > 0.0 else extent
        a, other = table.names[o.point], table.names[b]
        key = frozenset((o.point, b))
        found.setdefault(
            key, (MistypedName(a, other, apart, float(most), o.label), _change(a, other))
        )
        if seen_beside and _plain(a) != _plain(other):
            in_a_row.add(key)
    rules = Counter(change for _, change in found.values())
    named = [
        m
        for key, (m, change) in found.items()
        if rules[change] < MIN_PAIRS_OF_CONVENTION and key not in in_a_row
    ]
    if not named:
        return []
    within = max(m.tolerance for m in named)
    by_chance = _coincident_with_other_names(table.names, xyz, once, within)
    return named if len(named) > by_chance else []


def _coincident_with_other_names(
    names: Sequence[str], xyz: Array, once: Iterable[int], within: float
) -> int:
    """Return the number of pairs of points in one place whose names are not similar.

    Where a network has them, places are shared on purpose, and say nothing about names.
    """
    from scipy.spatial import cKDTree  # it takes long to import, and few networks need it

    there = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    tree = cKDTree(xyz[there])
    pairs = set()
    for a in once:
        if np.isfinite(xyz[a]).all():
            for b in there[tree.query_ball_point(xyz[a], within)].tolist():
                if b != a and not _names_alike(names[a], names[b]):
                    pairs.add(frozenset((a, b)))
    return len(pairs)


def _sighted(equations: Equations) -> Mask:
    """Return which points are observed from another one, and are not stations alone."""
    out = np.zeros(len(equations.unknowns["point"].names), dtype=bool)
    for block in equations.blocks:
        ends = [index for kind, index in block.variables if kind == "point"]
        for index in ends[1:]:
            out[index] = True
    return out


def _reach(xyz: Array, o: _Once) -> float:
    """Return the distance from which a point is observed."""
    return float(np.linalg.norm(np.nan_to_num(xyz[o.point] - xyz[o.nearest])))


def _observed_once(equations: Equations) -> Iterator[_Once]:
    """Iterate over the unknown points that are observed in one set-up, and not in photos."""
    table = equations.unknowns["point"]
    n = len(table.names)
    station, nearest = np.full(n, -1), np.full(n, -1)
    several = np.zeros(n, dtype=bool)
    first: dict[int, tuple[int, int]] = {}
    for place, block in enumerate(equations.blocks):
        ends = [index for kind, index in block.variables if kind == "point"]
        if len(ends) < 2:  # a photo, or a given value
            for index in ends:
                several[index] |= block.lens is not None
            continue
        for j, index in enumerate(ends):
            other = ends[1] if j == 0 else ends[0]
            by = np.where(station[index] < 0, ends[0], station[index])
            several[index[by != ends[0]]] = True
            # Rows of one point within the block may differ from one another as well.
            order = np.argsort(index, kind="stable")
            same = index[order][1:] == index[order][:-1]
            apart = ends[0][order][1:] != ends[0][order][:-1]
            several[index[order][1:][same & apart]] = True
            station[index], nearest[index] = ends[0], other
            for i, p in enumerate(index.tolist()):
                first.setdefault(p, (place, i))
    alone = (station >= 0) & ~several & table.free.any(axis=1)
    for p in np.flatnonzero(alone).tolist():
        place, i = first[p]
        yield _Once(p, int(station[p]), int(nearest[p]), equations.blocks[place].labels(i))


def _seen_from(equations: Equations, point: int, station: int) -> bool:
    """Return whether a point is observed from a station."""
    for block in equations.blocks:
        ends = [index for kind, index in block.variables if kind == "point"]
        for other in ends[1:]:
            if np.any((ends[0] == station) & (other == point)):
                return True
    return False


def _similar(names: Sequence[str], some: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Iterate over pairs of names that look alike or differ by one edit, the first among some."""
    keys: dict[str, list[int]] = defaultdict(list)
    for i, name in enumerate(names):
        for key in _keys(name):
            keys[key].append(i)
    for a in some:
        others = {b for key in _keys(names[a]) for b in keys[key] if b != a}
        for b in sorted(others):
            if _names_alike(names[a], names[b]):
                yield a, b


def _plain(name: str) -> str:
    """Return a name as it looks at a glance."""
    return name.translate(LOOKALIKE_CHARACTERS).casefold()


def _keys(name: str) -> set[str]:
    """Return what a name shares with all names that look alike or are one edit away."""
    plain = _plain(name)
    return {plain, *(plain[:i] + plain[i + 1 :] for i in range(len(plain)))}


def _names_alike(a: str, b: str) -> bool:
    """Return whether two names look alike, or differ by one edit or two exchanged characters."""
    a, b = _plain(a), _plain(b)
    if a == b:
        return True
    x, y = _differing(a, b)
    return max(len(x), len(y)) == 1 or (len(x) == len(y) == 2 and x == y[::-1])


def _differing(a: str, b: str) -> tuple[str, str]:
    """Return two names without what they begin and end with in common."""
    i = 0
    while i < min(len(a), len(b)) and a[i] == b[i]:
        i += 1
    j = 0
    while j < min(len(a), len(b)) - i and a[-1 - j] == b[-1 - j]:
        j += 1
    return a[i : len(a) - j], b[i : len(b) - j]


def _change(a: str, b: str) -> str:
    """Return how two names differ, digits and letters as such.

    An epoch in each name, or a letter for each round of readings, is a rule of naming.
    """
    parts = (re.sub(r"\d", "#", part) for part in _differing(a, b))
    return " ".join(re.sub(r"[^\W_]", "@", part) for part in parts)


def _local_covariances(equations: Equations, state: State) -> Callable[[Index], Array]:
    """Return covariances of points if all else is known: the inverses of their own JᵀJ.

    A direction that nothing determines has an infinite variance.
    """

    def covariances(numbers: Index) -> Array:
        n = len(equations.unknowns["point"].names)
        wanted = np.zeros(n, dtype=bool)
        wanted[numbers] = True
        normal = np.zeros((n, 3, 3))
        for block in equations.weighted_at(state).blocks:
            places = [j for j, (kind, _) in enumerate(block.variables) if kind == "point"]
            touched = [wanted[block.variables[j][1]] for j in places]
            if not touched or block.lens is not None:
                continue
            rows = np.flatnonzero(np.logical_or.reduce(touched))
            if not len(rows):
                continue
            part = block.select(rows)
            jacobians = part.evaluate(equations.network.frame, state).jacobians
            for j in places:
                a = part.whiten(jacobians[j])
                np.add.at(normal, part.variables[j][1], np.einsum("ndi,ndj->nij", a, a))
        free = equations.unknowns["point"].free[numbers]
        both = free[:, :, None] & free[:, None, :]
        # A held component has no row and no column, and is no weak direction.
        size = np.maximum(np.trace(normal[numbers] * both, axis1=1, axis2=2), 1e-300)
        own = normal[numbers] * both + np.where(free, 0.0, size[:, None])[:, :, None] * np.eye(3)
        values, vectors = np.linalg.eigh(own)
        weak = np.any(values <= SINGULAR_TRACE_SHARE * size[:, None], axis=1)
        inverse = 1.0 / np.where(weak[:, None], 1.0, values)
        found = np.einsum("nij,nj,nkj->nik", vectors, inverse, vectors) * both
        found[weak & free.any(axis=1)] = np.inf
        return np.asarray(found)

    return covariances


def listed_doubts(found: Sequence[MistypedName]) -> list[str]:
    """Return the doubts, the first few."""
    out = [str(m) for m in found[:MAX_MISTYPED_IN_REPORT]]
    if len(found) > MAX_MISTYPED_IN_REPORT:
        out[-1] += f" (and {len(found) - MAX_MISTYPED_IN_REPORT} more such points)"
    return out
