"""Common places of two systems: similarity, gross and exchanged places, the system to blame.

A system is what was measured in one frame, or the given coordinates of the network. With common
places a_i, b_i (n, d), d = 3 or, where heights are missing, 2,

    b ≈ t + s R a,   v_i = b_i − t − s R a_i,   S_i = P_i⁻¹ − A_i N⁻¹ A_iᵀ,   ∇_i = P_i⁻¹ S_i⁻¹ v_i

with the covariance S_i of v_i, weights P_i = 1/(s² σ_a² + σ_b²), and the error ∇_i that place i
has if it alone is wrong. v_iᵀ S_i⁻¹ v_i then follows χ² with d degrees of freedom. A place that
does not fit has a gross error, or is exchanged with another one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ..errors import known
from ..graph.equations import Equations
from ..models.similarity import fit_similarity, reduced
from ..network.network import Network
from ..rotation import skew
from ..statistical_tests import chi2_upper_quantile
from ..types import Array, Index
from .findings import Finding
from .loop_misclosures import MAX_LISTED_MISCLOSURES

MIN_SECOND_EXTENT_RATIO = 1e-3
"""Smallest ratio of the second extent of places to the first at which they fix all turns."""
MIN_THIRD_EXTENT_RATIO = 1e-2
"""Smallest ratio of the third extent to the first at which a mirror is distinguished from a
rotation."""
MIN_PLACE_REDUNDANCY = 1e-3
"""Redundancy below which a direction of a place counts as not controlled."""
ALPHA_OF_PLACES = 0.001
"""Probability that a comparison of two systems, or a loop, is reported although nothing is
wrong."""
MIN_CONTROLLED_PLACES = 4
"""Smallest number of common places of which one can be wrong."""
MAX_TRIED_PLACES = 8
"""Number of places, those that fit worst, of which two are tried as exchanged."""
GIVEN_COORDINATES = "the given coordinates"
"""Name of the system of the given coordinates."""


@dataclass(frozen=True, eq=False)
class PlaceSystem:
    """Places with coordinates."""

    name: str
    """Name in messages."""
    keys: Index
    """Number of each place, sorted, (n,)."""
    x: Array
    """Coordinates, (n, 3); NaN where a height is missing."""
    sigma: Array
    """Standard deviation of a coordinate of each place, (n,); NaN: roughly given."""
    upright: bool
    """Whether its z axis is upright, so that its plan can be compared alone."""
    fixed_scale: float
    """ln of the metres per unit; NaN if it is unknown."""
    horizon: Array | None = None
    """Horizon (east, north, up) from which its axes are turned, (3, 3); none: it is not level."""


@dataclass(frozen=True, eq=False)
class CommonPlaces:
    """Common places of two systems."""

    first: PlaceSystem
    """System of a."""
    second: PlaceSystem
    """System of b."""
    keys: Index
    """Numbers of the common places, (n,)."""
    a: Array
    """Coordinates in the first system, (n, d)."""
    b: Array
    """Coordinates in the second system, (n, d)."""
    variance_a: Array
    """Variances of a coordinate in the first system, (n,)."""
    variance_b: Array
    """Variances of a coordinate in the second system, (n,)."""

    @property
    def size(self) -> int:
        """Number of dimensions, 2 or 3."""
        return int(self.a.shape[1])

    def extents(self) -> Array:
        """Return the extents of the places along their principal axes, the largest first, (d,)."""
        singular = np.linalg.svd(self.b - self.b.mean(axis=0), compute_uv=False)
        return np.asarray(np.append(singular, np.zeros(self.size - len(singular))))

    @property
    def determined(self) -> bool:
        """Whether the places fix a similarity: they do not lie in one place, or in one line."""
        if len(self.a) < self.size or not np.ptp(self.a, axis=0).any():
            return False
        extents = self.extents()
        return bool(extents[self.size - 2] > MIN_SECOND_EXTENT_RATIO * extents[0])

    def of_unknown_scale(self) -> CommonPlaces:
        """Return the pair with a scale that is to be found."""
        return replace(self, first=replace(self.first, fixed_scale=float("nan")))

    def exchanged(self, i: int, j: int) -> CommonPlaces:
        """Return the pair with the places i and j of the first system exchanged."""
        rows = np.arange(len(self.a))
        rows[[i, j]] = j, i
        return replace(self, a=self.a[rows], variance_a=self.variance_a[rows])

    def without(self, i: int) -> CommonPlaces:
        """Return the pair without its place i."""
        rows = np.delete(np.arange(len(self.a)), i)
        return CommonPlaces(
            self.first,
            self.second,
            self.keys[rows],
            self.a[rows],
            self.b[rows],
            self.variance_a[rows],
            self.variance_b[rows],
        )

    def fitted(self, *, mirrored: bool = False) -> PlaceSimilarity:
        """Return the similarity a → b, with a mirror if it is asked for."""
        ln_scale = self.first.fixed_scale - self.second.fixed_scale
        given = None if np.isnan(ln_scale) else float(np.exp(ln_scale))
        variance = np.ones(len(self.a))
        for _ in range(2):  # the weights take the scale of the first fit
            weight = 1.0 / variance
            by = fit_similarity(self.a, self.b, weight, scale=given, mirrored=mirrored)
            variance = by.scale**2 * self.variance_a + self.variance_b
        turned = by.scale * reduced(self.a, weight) @ by.rotation.T
        v = reduced(self.b, weight) - turned
        return PlaceSimilarity(self, by.rotation, by.scale, turned, v, variance)


@dataclass(frozen=True, eq=False)
class PlaceSimilarity:
    """A similarity between two systems, and its residuals."""

    pair: CommonPlaces
    """The places."""
    rotation: Array
    """R, (d, d)."""
    scale: float
    """s."""
    turned: Array
    """s R (a − ā), (n, d)."""
    v: Array
    """Residuals b − t − s R a, (n, d)."""
    variance: Array
    """P⁻¹, (n,)."""

    @property
    def rms(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.v**2)))

    @cached_property
    def design(self) -> Array:
        """A (n, d, k): shifts, turn and, where it is unknown, ln of the scale."""
        n, d = self.v.shape
        shift = np.broadcast_to(np.eye(d), (n, d, d))
        turn = -skew(self.turned) if d == 3 else self.turned[:, ::-1, None] * [[-1.0], [1.0]]
        known = np.isfinite(self.pair.first.fixed_scale - self.pair.second.fixed_scale)
        scale = self.turned[:, :, None][:, :, : 0 if known else 1]
        return np.concatenate([shift, turn, scale], axis=2)

    @cached_property
    def cofactor(self) -> Array:
        """N⁻¹ (k, k)."""
        weighted = self.design / self.variance[:, None, None]
        return np.asarray(np.linalg.inv(np.einsum("nij,nik->jk", weighted, self.design)))

    def tests(self) -> tuple[Array, Array, Index]:
        """Return ∇ (n, d), its test value (n,) and its degrees of freedom (n,) of every place."""
        moved = np.einsum("nij,jk,nlk->nil", self.design, self.cofactor, self.design)
        s = self.variance[:, None, None] * np.eye(self.pair.size) - moved
        values, vectors = np.linalg.eigh(s)
        controlled = values > MIN_PLACE_REDUNDANCY * self.variance[:, None]
        inverse = np.where(controlled, 1.0 / np.where(controlled, values, 1.0), 0.0)
        along = np.einsum("nij,ni->nj", vectors, self.v)
        error = self.variance[:, None] * np.einsum("nij,nj->ni", vectors, inverse * along)
        return error, np.sum(inverse * along**2, axis=1), controlled.sum(axis=1)

    def turn(self) -> tuple[Array, Array]:
        """Return R as a rotation in space (3, 3), and the covariance of its turn and ln s (4, 4).

        The turn is about the axes of the second system; in the plane it is about z.
        """
        d, k = self.pair.size, self.cofactor.shape[0]
        rotation, covariance = np.eye(3), np.zeros((4, 4))
        rotation[:d, :d] = self.rotation
        own = [0, 1, 2, 3] if d == 3 else [2, 3]
        own = own[: k - d]
        covariance[np.ix_(own, own)] = self.cofactor[d:, d:]
        return rotation, covariance


def common_places(
    first: PlaceSystem, second: PlaceSystem, *, rough: bool = False
) -> CommonPlaces | None:
    """Return the common places of two systems; none if they fix no similarity.

    Args:
        first: system of a.
        second: system of b.
        rough: whether places without a standard deviation take part.
    """
    keys, i, j = np.intersect1d(first.keys, second.keys, assume_unique=True, return_indices=True)
    a, b = first.x[i], second.x[j]
    sound = np.isfinite(a + b)
    known = np.isfinite(first.sigma[i] + second.sigma[j]) | rough
    plan_alone = first.upright and second.upright and not sound[known, 2].any()
    d = 2 if plan_alone else 3
    rows = np.flatnonzero(sound[:, :d].all(axis=1) & known)
    variances = (np.nan_to_num(s) ** 2 for s in (first.sigma[i[rows]], second.sigma[j[rows]]))
    pair = CommonPlaces(first, second, keys[rows], a[rows, :d], b[rows, :d], *variances)
    return pair if pair.determined else None


@dataclass(frozen=True)
class MisfittingPlace:
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
    statistic: float = float("nan")
    """Its test value, χ² if nothing is wrong."""
    freedom: int = 0
    """Degrees of freedom of the test value."""


def accusations(
    found: Mapping[tuple[str, str], float], *, alternatives: bool = True
) -> Iterator[tuple[list[str], dict[tuple[str, str], float]]]:
    """Yield the systems that pairs accuse, the most accused first, and the pairs that do so.

    The given coordinates are right, so that the other system of a pair with them is wrong. Of two
    others the one that more pairs accuse is meant.

    Args:
        found: what was found wrong with each pair of systems, by their names.
        alternatives: whether two systems that equally many pairs accuse are named together.
    """
    rest = dict(found)
    while rest:
        counts = Counter(n for pair in rest for n in pair if n != GIVEN_COORDINATES)
        sure = [n for p in rest if GIVEN_COORDINATES in p for n in p if n != GIVEN_COORDINATES]
        most = [n for n, c in counts.items() if c == max(counts.values())]
        names = sure[:1] or most[: 2 if alternatives else 1]
        own = {p: v for p, v in rest.items() if set(p) & set(names)}
        yield names, own
        rest = {p: v for p, v in rest.items() if p not in own}


def _inside(own: list[MisfittingPlace]) -> list[str]:
    """Return the systems in which what is wrong with a place is: one, or two that contradict."""
    counts = Counter(n for w in own for n in w.systems)
    worst = max(own, key=lambda w: w.size / w.tolerance)
    shared = [n for n, c in counts.items() if c == len(own) > 1 and n != GIVEN_COORDINATES]
    return shared or [n for n in worst.systems if n != GIVEN_COORDINATES]


def with_exchanges_undone(system: PlaceSystem, exchanges: list[MisfittingPlace]) -> PlaceSystem:
    """Return a system with the exchanges of places undone that are in it."""
    x, sigma = system.x.copy(), system.sigma.copy()
    for pair in {frozenset((w.key, w.other)) for w in exchanges}:
        own = [w for w in exchanges if frozenset((w.key, w.other)) == pair]
        rows = np.flatnonzero(np.isin(system.keys, [w.key for w in own]))
        if _inside(own)[0] == system.name and len(rows) == len(pair):
            x[rows], sigma[rows] = x[rows[::-1]], sigma[rows[::-1]]
    return replace(system, x=x, sigma=sigma)


def similarity_without_gross_errors(
    pair: CommonPlaces, wrong: list[MisfittingPlace]
) -> PlaceSimilarity | None:
    """Return the similarity of the places that fit, none if they fix none; note the others.

    Two places that fit when they are exchanged are no gross errors but an exchange.
    """
    while pair.determined:
        fit = pair.fitted()
        if len(pair.a) < MIN_CONTROLLED_PLACES:
            return fit
        error, share = _shares(fit)
        worst = int(np.argmax(share))
        if share[worst] <= 1.0:
            return fit
        names = (pair.first.name, pair.second.name)
        _, test, freedom = fit.tests()
        sizes = np.linalg.norm(error, axis=1)
        tolerances = sizes / np.sqrt(np.maximum(share, 1e-300))
        exchanged = _exchanged(pair, share)
        if exchanged is not None:
            for i, j in (sorted(exchanged), sorted(exchanged)[::-1]):
                size = float(np.linalg.norm(pair.b[i] - pair.b[j]))
                own = float(tolerances[i])
                wrong.append(
                    MisfittingPlace(
                        int(pair.keys[i]),
                        names,
                        size,
                        own,
                        int(pair.keys[j]),
                        float(test[i]),
                        int(freedom[i]),
                    )
                )
            pair = pair.exchanged(*exchanged)
            continue
        wrong.append(
            MisfittingPlace(
                int(pair.keys[worst]),
                names,
                float(sizes[worst]),
                float(tolerances[worst]),
                statistic=float(test[worst]),
                freedom=int(freedom[worst]),
            )
        )
        pair = pair.without(worst)
    return None


def _shares(fit: PlaceSimilarity) -> tuple[Array, Array]:
    """Return ∇ (n, d) of every place and its test value in units of its limit, (n,)."""
    error, test, freedom = fit.tests()
    limit = chi2_upper_quantile(ALPHA_OF_PLACES / len(test), np.maximum(freedom, 1))
    return error, np.where(freedom > 0, test / limit, 0.0)


def _exchanged(pair: CommonPlaces, share: Array) -> tuple[int, int] | None:
    """Return two places that fit when they are exchanged; none: no two do.

    They must be controlled, and the worst of the others must not fit worse than before.
    """
    if len(pair.a) <= MIN_CONTROLLED_PLACES:
        return None
    tried = np.argsort(-share, kind="stable")[:MAX_TRIED_PLACES].tolist()
    best: tuple[float, tuple[int, int]] | None = None
    for i, j in combinations(tried, 2):
        if max(share[i], share[j]) <= 1.0:
            continue
        _, other = _shares(pair.exchanged(i, j).fitted())
        left = float(other.max())
        if max(other[i], other[j]) <= 1.0 and left < share.max():
            best = min(best or (left, (i, j)), (left, (i, j)))
    return None if best is None else best[1]


def ids_of_systems(
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


def gross_places(equations: Equations, wrong: list[MisfittingPlace]) -> Iterator[Finding]:
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
            ids = ids_of_systems(equations.network, inside, {names[key], names[other]})
        finding = Finding(
            what,
            remedy,
            size,
            most,
            "mm",
            ids,
            statistic=worst.statistic,
            freedom=worst.freedom,
        )
        found.append((worst.size / worst.tolerance, finding))
    found.sort(key=lambda each: -each[0])
    for _, finding in found[:MAX_LISTED_MISCLOSURES]:
        yield finding
