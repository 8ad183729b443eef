"""The congruence of two epochs: which points kept their places, and how far the others moved.

The two epochs are compared in four steps (Pelzer 1971; Niemeier, Ausgleichungsrechnung, 2008):

1. σ̂0² of both adjustments are compared, F = σ̂²_larger/σ̂²_smaller, and pooled.
2. The reference points, which `factorgraph_adj.epochs.roles` chooses, are tested for a change of
   their shape: T = Ω/(h σ0²) ~ F(h, r₁ + r₂), with Ω and h of `factorgraph_adj.epochs.hypotheses`,
   which no datum changes.
3. Where it rejects, the points that moved are searched for (`factorgraph_adj.epochs.localise`).
   The second epoch of a free network is then moved onto the stable points, and 2 and 3 repeated.
4. Every other point is tested against the points that stayed: under the hypothesis that only the
   stable points kept their places, ∇ is the displacement of the others, with its cofactors.
   Step 4 equals an adjustment of both epochs in one, in which a stable point stands once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..columns import Columns
from ..errors import DatumError, InputError, known
from ..network.network import Network
from ..quality.distributions import fisher_quantile
from ..quality.ellipses import ErrorEllipse, ellipses_in
from ..quality.levels import ALPHA_OF_MODEL, POWER
from ..shown import Rows, Shown
from ..solve.solution import Solution
from ..types import Array, Index
from .differences import Differences, between, within
from .hypotheses import Scale, Test, moved, rank, spanning, unheld, weight
from .localise import Method, Step, localise
from .roles import Roles, roles_in_one, roles_of

MOST_SEARCHES = 3
"""Largest number of searches after the first one, each with the second epoch moved onto the points
that were stable before."""
SAME_PLACE = 1e-5
"""Distance, metres, below which the coordinates of a point held in both epochs are the same: what
files with five decimals round."""
LEAST_OPEN = 1e-7
"""Part of an axis in an open direction below which the direction is across the axis."""


@dataclass(frozen=True)
class RatioTest:
    """Comparison of the variances of unit weight of two adjustments."""

    sigma0: tuple[float, float]
    """σ̂0 of the first and the second epoch."""
    redundancy: tuple[int, int]
    """Redundancies."""
    ratio: float
    """The larger variance divided by the smaller one."""
    critical: float
    """Critical value of the ratio, two-sided."""

    @property
    def accepted(self) -> bool:
        """Whether the epochs can have the same accuracy relative to their weights."""
        return self.ratio <= self.critical


@dataclass(frozen=True, eq=False)
class Displacement:
    """Displacement of a point against the points that stayed.

    A stable point is compared with the other stable points. These may be too few to hold every
    motion that the observations leave open; ``open`` then has the directions in which the point
    cannot be seen to move, and the rest is the part of the displacement across them.
    """

    name: str
    """Name in the first epoch."""
    stable: bool
    """Whether the point is one of the stable reference points."""
    place: Array
    """Coordinates of the first epoch, (3,) metres."""
    vector: Array
    """Displacement, (3,) metres; zero in coordinates that are not compared."""
    covariance: Array
    """Covariance of the displacement, (3, 3) metres², with the σ0² of the tests."""
    test: Test
    """Test of the hypothesis that the point kept its place."""
    detectable: float
    """Smallest displacement that the test finds with the power asked for, in the direction in
    which it finds it hardest, metres."""
    hardest: Array
    """That direction, a unit vector (3,)."""
    open: Array
    """Directions in which the displacement is not determined, (3, m) unit vectors; m = 0 for all
    points but stable ones of a small reference. The detectable displacement is infinite then."""

    @property
    def moved(self) -> bool:
        """Whether the displacement is significant."""
        return not self.test.accepted

    @property
    def verdict(self) -> Literal["untested", "stable", "moved", "kept"]:
        """What the test says: nothing, if the point cannot be seen to move in any direction."""
        if self.test.freedom[0] == 0:
            return "untested"
        if self.stable:
            return "stable"
        return "moved" if self.moved else "kept"

    @property
    def length(self) -> float:
        """Length of the displacement, metres."""
        return float(np.linalg.norm(self.vector))

    @property
    def sigmas(self) -> Array:
        """Standard deviations of the components, (3,) metres; infinite where they are open."""
        told = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.where(np.abs(self.open).max(axis=1, initial=0.0) > LEAST_OPEN, np.inf, told)


@dataclass(frozen=True, eq=False, repr=False)
class Congruence(Shown):
    """Result of the comparison of two epochs."""

    solutions: tuple[Solution, ...]
    """The adjustments: of the first and the second epoch, or of both in one."""
    differences: Differences
    """What was compared."""
    ratio: RatioTest | None
    """Comparison of the two variances; None for both epochs in one adjustment."""
    scale: Scale
    """Variance of unit weight of all tests."""
    roles: Roles
    """What each point is: reference, object, held, or not compared."""
    stable: tuple[str, ...]
    """Reference points that are taken as stable."""
    steps: tuple[Step, ...]
    """The congruence tests of the reference points; empty without reference points."""
    displacements: Mapping[str, Displacement]
    """Displacement of every point by its name, reference points first."""
    joint: Array
    """Joint cofactors of the displacements of the points that are not stable, in the order of
    `displacements`, (n k, n k) metres²."""
    alpha: float
    """Probability of a false alarm of each test."""
    power: float
    """Power of the smallest detectable displacements."""

    @property
    def network(self) -> Network:
        """The network of the first epoch."""
        return self.solutions[0].network

    @property
    def reference(self) -> tuple[str, ...]:
        """Reference points that were tested for their shape."""
        return self.roles.reference

    @property
    def held_apart(self) -> Mapping[str, float]:
        """Held points with other coordinates in the second epoch, and how far they are, metres.

        Points whose coordinates no open motion moves are compared: others have a datum of their
        own in each epoch.
        """
        if self.differences.motions.size:
            return {}
        axes = ["xyz".index(a) for a in self.differences.axes]
        apart = {n: float(np.linalg.norm(v[axes])) for n, v in self.roles.held.items()}
        return {n: size for n, size in apart.items() if size > SAME_PLACE}

    @property
    def fine(self) -> bool:
        """Whether the adjustments converged, variances agree, and stable and held points fit."""
        fine = all(s.converged for s in self.solutions) and not self.held_apart
        fine &= self.ratio is None or self.ratio.accepted
        return fine and (not self.steps or self.steps[-1].test.accepted)

    def ellipses(self, *, confidence: float | None = None) -> tuple[ErrorEllipse, ...]:
        """Return the ellipses of the displacements in plan, at the ends of their vectors.

        They lie in the horizon of each point. A displacement in plan is significant if and only if
        its beginning is outside of its ellipse with the confidence 1 − α of the tests.

        Args:
            confidence: probability of the ellipses; None: 1 − α of the tests.
        """
        every = list(self.displacements.values())
        return ellipses_in(
            self.network.frame,
            [(x.name, None) for x in every],
            np.array([x.place + x.vector for x in every]).reshape(-1, 3),
            np.array([x.covariance for x in every]).reshape(-1, 3, 3),
            1.0 - self.alpha if confidence is None else confidence,
            redundancy=None if np.isinf(self.scale.freedom) else int(self.scale.freedom),
        )

    @property
    def global_test(self) -> Test | None:
        """Congruence test of all reference points; None without reference points."""
        return self.steps[0].test if self.steps else None

    @property
    def moved(self) -> tuple[str, ...]:
        """Names of the points whose displacement is significant, reference points first."""
        return tuple(n for n, x in self.displacements.items() if x.moved and not x.stable)

    def displacement(self, name: str) -> Displacement:
        """Return the displacement of a point.

        Raises:
            InputError: the point was not compared.
        """
        if name not in self.displacements:
            raise InputError(
                f"point {name!r} was not compared; known: {known(self.displacements, meant=name)}"
            )
        return self.displacements[name]

    def table(self) -> Columns:
        """Return the displacements as columns; metres."""
        every = list(self.displacements.values())
        vectors = np.array([x.vector for x in every]).reshape(-1, 3)
        sigmas = np.array([x.sigmas for x in every]).reshape(-1, 3)
        columns = {"name": np.array([x.name for x in every], dtype=object)}
        columns["stable"] = np.array([x.stable for x in every])
        for i, axis in enumerate("xyz"):
            columns[f"d{axis}"] = vectors[:, i]
            columns[f"sigma_d{axis}"] = sigmas[:, i]
        columns["length"] = np.array([x.length for x in every])
        columns["test_value"] = np.array([x.test.value for x in every])
        columns["critical"] = np.array([x.test.critical for x in every])
        columns["moved"] = np.array([x.moved for x in every])
        columns["detectable"] = np.array([x.detectable for x in every])
        return Columns("displacements", columns)

    def headline(self) -> str:
        """Return what moved."""
        points = f"{len(self.displacements)} points of two epochs"
        objects = f"{len(self.moved)} points moved"
        if self.global_test is None:
            return f"{points}: {objects}"
        same = "kept" if self.global_test.accepted else "changed"
        shape = f"{len(self.reference)} reference points {same} their shape"
        tested = len(self.stable) < len(self.displacements)
        return f"{points}: {shape}, {objects if tested else 'no objects were tested'}"

    def first_rows(self) -> Rows:
        """Return the first displacements."""
        rows = (
            (x.name, *(1000.0 * x.vector), x.test.value, x.test.critical, x.moved)
            for x in self.displacements.values()
        )
        header = ("point", "dx [mm]", "dy [mm]", "dz [mm]", "T", "critical", "moved")
        return Rows(header, rows, len(self.displacements))


def congruence(
    first: Solution,
    second: Solution | None = None,
    *,
    reference: Sequence[str] | None = None,
    objects: Sequence[str] | None = None,
    pairs: Mapping[str, str] | None = None,
    method: Method = "combinations",
    variance: Literal["pooled", "a-priori"] = "pooled",
    alpha: float = ALPHA_OF_MODEL,
    power: float = POWER,
) -> Congruence:
    """Compare two epochs: test the reference points, find what moved, and by how much.

    Args:
        first: solution of the first epoch, or of both epochs in one adjustment.
        second: solution of the second epoch; None: ``first`` has both epochs, and ``pairs`` names
            the two places of each point.
        reference: points that are thought to be stable, by their names in the first epoch. None:
            with two solutions all points that both determine and that are not named in
            ``objects``, whatever carries the datum; with one solution none, where the common
            points of the adjustment are the reference. An empty list: the datum alone, with the
            points that both epochs hold, is the reference.
        objects: points that may have moved; None: all other points that are in both.
        pairs: names in the second epoch by names in the first, where they differ.
        method: how moved reference points are found, see `factorgraph_adj.epochs.localise`.
        variance: ``pooled``: the tests divide by σ̂0² = (v₁ᵀP₁v₁ + v₂ᵀP₂v₂)/(r₁ + r₂);
            ``a-priori``: σ0 = 1 is known.
        alpha: probability of a false alarm of each test.
        power: power of the smallest detectable displacements.

    Raises:
        InputError: unknown, held or repeated points, different frames, nothing to compare, no
            redundancy for a pooled variance.
        DatumError: the reference points do not determine the motions that are open, such as those
            on one line the rotation about it.
    """
    if not 0 < alpha < power < 1:
        raise InputError(f"alpha and power must be 0 < alpha < power < 1, not {alpha}, {power}")
    if second is None:
        roles = roles_in_one(first, reference, objects, pairs)
    else:
        roles = roles_of(first, second, reference, objects, pairs or {})
    some, others = roles.reference, roles.objects
    named = {n: (pairs or {}).get(n, n) for n in (*some, *others)}
    found = within(first, named) if second is None else between(first, second, named)
    scale = _scale(found, variance)
    steps: tuple[Step, ...] = ()
    stable: tuple[str, ...] = ()
    if some:
        search = localise(found, some, scale, alpha=alpha, method=method)
        for _ in range(MOST_SEARCHES):
            if second is None or not found.motions.size:
                break
            # Points that moved far would turn the second epoch by more than its linear motions.
            before = search.stable
            found = between(first, second, named, onto=before)
            search = localise(found, some, scale, alpha=alpha, method=method)
            if search.stable == before:
                break
        stable, steps = search.stable, search.steps
    displacements, joint = _displacements(found, some, stable, scale, alpha, power)
    return Congruence(
        (first,) if second is None else (first, second),
        found,
        None if second is None else _ratio(found, alpha),
        scale,
        roles,
        stable,
        steps,
        displacements,
        joint,
        alpha,
        power,
    )


def _scale(found: Differences, variance: str) -> Scale:
    if variance == "a-priori":
        return Scale(1.0, float("inf"))
    if variance != "pooled":
        raise InputError(f"variance must be pooled or a-priori, not {variance!r}")
    freedom = sum(found.redundancy)
    if freedom < 1:
        raise InputError("the epochs have no redundancy: take variance='a-priori'")
    return Scale(sum(found.vtpv) / freedom, float(freedom))


def _ratio(found: Differences, alpha: float) -> RatioTest | None:
    """Compare the variances; None where an epoch has no redundancy."""
    if min(found.redundancy) < 1:
        return None
    s = [v / r for v, r in zip(found.vtpv, found.redundancy, strict=True)]
    larger = int(np.argmax(s))
    r = found.redundancy
    ratio = s[larger] / s[1 - larger] if s[1 - larger] > 0 else float("inf")
    critical = fisher_quantile(1.0 - alpha / 2.0, r[larger], r[1 - larger])
    return RatioTest((float(np.sqrt(s[0])), float(np.sqrt(s[1]))), (r[0], r[1]), ratio, critical)


def _displacements(
    found: Differences,
    reference: tuple[str, ...],
    stable: tuple[str, ...],
    scale: Scale,
    alpha: float,
    power: float,
) -> tuple[dict[str, Displacement], Array]:
    """Return the displacements of all points against the stable ones, and joint cofactors."""
    k = len(found.axes)
    order = (*reference, *(n for n in found.names if n not in reference))
    loose = tuple(n for n in order if n not in stable)
    rows = found.rows((*stable, *loose))
    g = spanning(found.motions[rows])
    if not stable and g.shape[1]:
        raise InputError(
            "the epochs have no stable points in common, and the observations leave motions "
            "between them open: name reference points"
        )
    left = g.shape[1] - rank(g[: len(stable) * k])
    if left:
        raise DatumError(
            f"the stable points {', '.join(stable)} leave {left} of {g.shape[1]} motions of the "
            "other points open: take more reference points, not on one line",
            defect=left,
        )
    w = weight(found.cofactor[np.ix_(rows, rows)], g)
    d = found.d[rows]
    columns = np.arange(len(stable) * k, len(rows))
    if len(columns):
        nabla, joint, _ = moved(w, d, columns)
    else:
        nabla, joint = np.zeros(0), np.zeros((0, 0))
    lam = scale.noncentrality(alpha, power, k)
    axes = ["xyz".index(a) for a in found.axes]
    out: dict[str, Displacement] = {}
    for name in order:
        seen, loosely = np.eye(k), np.zeros((k, 0))
        if name in stable:
            own = np.arange(k) + stable.index(name) * k
            others = np.setdiff1d(np.arange(len(stable) * k), own)
            seen, loosely = unheld(g[own], g[others])
            part, q = _against(w, d, own, seen, columns)
        else:
            own = np.arange(k) + loose.index(name) * k
            part, q = nabla[own], joint[np.ix_(own, own)]
        full, covariance, hardest = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
        full[axes] = seen @ part
        covariance[np.ix_(axes, axes)] = scale.variance * seen @ q @ seen.T
        free = np.zeros((3, loosely.shape[1]))
        free[axes] = loosely
        if free.shape[1]:
            detectable, hardest = float("inf"), free[:, 0]
        else:
            values, axes_of_q = np.linalg.eigh(q)
            detectable = float(np.sqrt(lam * scale.variance * values[-1]))
            hardest[axes] = axes_of_q[:, -1]
        out[name] = Displacement(
            name,
            name in stable,
            found.places[found.names.index(name)],
            full,
            covariance,
            scale.test(float(part @ np.linalg.solve(q, part)), len(part), alpha),
            detectable,
            hardest,
            free,
        )
    return out, joint


def _against(w: Array, d: Array, own: Index, seen: Array, loose: Index) -> tuple[Array, Array]:
    """Return the displacement of a stable point along ``seen``, and its cofactors.

    Args:
        w: the weight W, (n, n).
        d: differences, (n,).
        own: rows of the point, (k,).
        seen: directions in which it can be seen to move, (k, f).
        loose: rows of the points that are not stable.
    """
    columns = np.zeros((len(d), seen.shape[1] + len(loose)))
    columns[own, : seen.shape[1]] = seen
    columns[loose, np.arange(seen.shape[1], columns.shape[1])] = 1.0
    f = seen.shape[1]
    if f == 0:
        return np.zeros(0), np.zeros((0, 0))
    q = np.linalg.inv(columns.T @ w @ columns)
    return (q @ (columns.T @ (w @ d)))[:f], ((q + q.T) / 2.0)[:f, :f]
