"""Comparison of two epochs by `congruence`: variance ratio, reference test, search, displacements.

The two epochs are compared in four steps (Pelzer 1971; Niemeier, Ausgleichungsrechnung, 2008):

1. σ̂0² of both adjustments are compared, F = σ̂²_larger/σ̂²_smaller, and pooled.
2. The reference points, see `factorgraph_adj.epochs.differences`, are tested for a change of their
   shape: T = Ω/(h σ0²) ~ F(h, r₁ + r₂), with Ω and h of `factorgraph_adj.epochs.congruence_tests`,
   which no datum changes.
3. Where it rejects, the points that moved are searched for. The second epoch of a free network is
   then moved onto the stable points, and 2 and 3 repeated.
4. Every other point is tested against the points that stayed: under the hypothesis that only the
   stable points kept their places, ∇ is the displacement of the others, with its cofactors.
   Step 4 equals an adjustment of both epochs in one, in which a stable point stands once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import AdjustmentError, DatumError, InputError, SingularError, taking
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_MODEL, POWER_OF_TEST, fisher_quantile
from ..types import Array, Index
from .alternative_explanations import alternative_explanations, not_comparable
from .comparison_result import (
    Congruence,
    Displacement,
    EpochComparison,
    VarianceRatioTest,
    reference_scale_change,
)
from .congruence_tests import (
    LocalisationMethod,
    LocalisationStep,
    UnitVariance,
    displacement_of_rows,
    held_and_open_directions,
    localise,
    motion_basis,
    motion_rank,
    weight_of_differences,
)
from .differences import (
    Differences,
    differences_between,
    differences_within,
    point_roles,
    point_roles_in_one,
)
from .epoch_coordinates import EpochCoordinates, SolutionCoordinates

MAX_REPEATED_SEARCHES = 3
"""Largest number of searches after the first one, each with the second epoch moved onto the points
that were stable before."""


@taking(Solution)
@with_one_thread
def congruence(
    first: Solution,
    second: Solution | None = None,
    *,
    reference: Sequence[str] | None = None,
    objects: Sequence[str] | None = None,
    pairs: Mapping[str, str] | None = None,
    method: LocalisationMethod = "combinations",
    variance: Literal["pooled", "a-priori"] = "pooled",
    alpha: float = ALPHA_OF_MODEL,
    power: float = POWER_OF_TEST,
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
        method: how moved reference points are found, see `factorgraph_adj.epochs.congruence_tests`.
        variance: ``pooled``: the tests divide by σ̂0² = (v₁ᵀP₁v₁ + v₂ᵀP₂v₂)/(r₁ + r₂);
            ``a-priori``: σ0 = 1 is known.
        alpha: probability of a false alarm of each test.
        power: power of the smallest detectable displacements.

    Raises:
        InputError: unknown, held or repeated points, different frames, nothing to compare, no
            redundancy for a pooled variance.
        DatumError: the reference points do not determine the motions that are open, such as those
            on one line the rotation about it.
        AdjustmentError: an adjustment that did not converge has singular normal equations.
    """
    _refuse_levels(alpha, power)
    options = _Options(method, variance, alpha, power)
    estimated = variance == "pooled"

    def compare(
        one: Solution,
        two: Solution | None,
        others: Mapping[str, str] | None,
        roles: _Named = (None, None),
    ) -> Congruence:
        places = SolutionCoordinates(one), None if two is None else SolutionCoordinates(two)
        found = _compared(*places, *roles, others, options)
        of_both = {f.name: getattr(found, f.name) for f in fields(found)}
        return Congruence(**of_both, solutions=(one,) if two is None else (one, two))

    try:
        found = compare(first, second, pairs, (reference, objects))
    except SingularError as error:
        solutions = (first,) if second is None else (first, second)
        raise AdjustmentError(not_comparable(solutions, estimated=estimated)) from error

    return replace(
        found, alternatives=alternative_explanations(found, compare, estimated=estimated)
    )


@with_one_thread
def compare_epochs(
    first: EpochCoordinates,
    second: EpochCoordinates | None = None,
    *,
    reference: Sequence[str] | None = None,
    objects: Sequence[str] | None = None,
    pairs: Mapping[str, str] | None = None,
    method: LocalisationMethod = "combinations",
    variance: Literal["pooled", "a-priori"] = "pooled",
    alpha: float = ALPHA_OF_MODEL,
    power: float = POWER_OF_TEST,
) -> EpochComparison:
    """Compare the coordinates of two epochs as `congruence` compares their adjustments.

    What needs the observations is not done: no search for other explanations.

    Args:
        first: the first epoch, or both epochs of one adjustment.
        second: the second epoch; None: ``first`` has both.
        reference: as in `congruence`.
        objects: as in `congruence`.
        pairs: as in `congruence`.
        method: as in `congruence`.
        variance: as in `congruence`.
        alpha: probability of a false alarm of each test.
        power: power of the smallest detectable displacements.

    Raises:
        InputError: as `congruence`.
        DatumError: as `congruence`.
    """
    _refuse_levels(alpha, power)
    options = _Options(method, variance, alpha, power)
    return _compared(first, second, reference, objects, pairs, options)


def _refuse_levels(alpha: float, power: float) -> None:
    if not 0 < alpha < power < 1:
        raise InputError(f"alpha and power must be 0 < alpha < power < 1, not {alpha}, {power}")


_Named: TypeAlias = tuple[Sequence[str] | None, Sequence[str] | None]


class _Options(NamedTuple):
    """Options of a comparison, as those of `congruence`."""

    method: LocalisationMethod
    variance: str
    alpha: float
    power: float


def _compared(
    first: EpochCoordinates,
    second: EpochCoordinates | None,
    reference: Sequence[str] | None,
    objects: Sequence[str] | None,
    pairs: Mapping[str, str] | None,
    options: _Options,
) -> EpochComparison:
    """Compare two epochs without a look at what else may explain their differences."""
    method, variance, alpha, power = options
    if second is None:
        roles = point_roles_in_one(reference, objects, pairs)
    else:
        roles = point_roles(first, second, reference, objects, pairs or {})
    some, others = roles.reference, roles.objects
    named = {n: (pairs or {}).get(n, n) for n in (*some, *others)}
    found = (
        differences_within(first, named)
        if second is None
        else differences_between(first, second, named)
    )
    scale = _scale(found, variance)
    steps: tuple[LocalisationStep, ...] = ()
    stable: tuple[str, ...] = ()
    if some:
        search = localise(found, some, scale, alpha=alpha, method=method)
        for _ in range(MAX_REPEATED_SEARCHES):
            if second is None or not found.motions.size:
                break
            # Points that moved far would turn the second epoch by more than its linear motions.
            before = search.stable
            found = differences_between(first, second, named, onto=before)
            search = localise(found, some, scale, alpha=alpha, method=method)
            if search.stable == before:
                break
        stable, steps = search.stable, search.steps
    displacements, joint = _displacements(found, some, stable, scale, alpha, power)
    return EpochComparison(
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
        reference_scale_change(found, some, scale, alpha) if second is not None else None,
    )


def _scale(found: Differences, variance: str) -> UnitVariance:
    if variance == "a-priori":
        return UnitVariance(1.0, float("inf"))
    if variance != "pooled":
        raise InputError(f"variance must be pooled or a-priori, not {variance!r}")
    freedom = sum(found.redundancy)
    if freedom < 1:
        raise InputError("the epochs have no redundancy: take variance='a-priori'")
    return UnitVariance(sum(found.vtpv) / freedom, float(freedom))


def _ratio(found: Differences, alpha: float) -> VarianceRatioTest | None:
    """Compare the variances; None where an epoch has no redundancy."""
    if min(found.redundancy) < 1:
        return None
    s = [v / r for v, r in zip(found.vtpv, found.redundancy, strict=True)]
    larger = int(np.argmax(s))
    r = found.redundancy
    ratio = s[larger] / s[1 - larger] if s[1 - larger] > 0 else float("inf")
    critical = fisher_quantile(1.0 - alpha / 2.0, r[larger], r[1 - larger])
    return VarianceRatioTest(
        (float(np.sqrt(s[0])), float(np.sqrt(s[1]))), (r[0], r[1]), ratio, critical
    )


def _displacements(
    found: Differences,
    reference: tuple[str, ...],
    stable: tuple[str, ...],
    scale: UnitVariance,
    alpha: float,
    power: float,
) -> tuple[dict[str, Displacement], Array]:
    """Return the displacements of all points against the stable ones, and joint cofactors."""
    k = len(found.axes)
    order = (*reference, *(n for n in found.names if n not in reference))
    loose = tuple(n for n in order if n not in stable)
    rows = found.rows((*stable, *loose))
    g = motion_basis(found.motions[rows])
    if not stable and g.shape[1]:
        raise InputError(
            "the epochs have no stable points in common, and the observations leave motions "
            "between them open: name reference points"
        )
    left = g.shape[1] - motion_rank(g[: len(stable) * k])
    if left:
        raise DatumError(
            f"the stable points {', '.join(stable)} leave {left} of {g.shape[1]} motions of the "
            "other points open: take more reference points, not on one line",
            defect=left,
        )
    w = weight_of_differences(found.cofactor[np.ix_(rows, rows)], g)
    d = found.d[rows]
    columns = np.arange(len(stable) * k, len(rows))
    if len(columns):
        nabla, joint, _ = displacement_of_rows(w, d, columns)
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
            seen, loosely = held_and_open_directions(g[own], g[others])
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
