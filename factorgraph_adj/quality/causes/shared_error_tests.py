"""T² tests of errors with given columns, alone or conditional; held given values; axis scales.

Where observations l have an error C ∇ with unknown ∇ (q,), the model is f(x) + C ∇ = l. With the
residuals v and P Q_vv P = P − P A Q AᵀP of the adjustment without ∇,

    u = CᵀP v,   S = CᵀP Q_vv P C
    ∇̂ = −S⁻¹ u,   Σ_∇ = S⁻¹,   T² = uᵀ S⁻¹ u,

T² is χ² with q degrees of freedom without an error, and vᵀPv decreases by T² where ∇ is an unknown
(Baarda 1968; Teunissen 2006). Nothing is adjusted again.

A held component of a point, a photo, a calibration or a parameter is one more column of A, tested
as if it had been given with σ → ∞: its error is ∇ = given − true.

A board whose spacing is not the same along its axes, or heights of another unit, make all given
coordinates along an axis wrong in the same ratio s from their centre: given − true = s (x − x̄). The
column of s is that of the given coordinates times x − x̄.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array, diags_array

from ...graph.equations import Equations
from ...graph.variables import DEFAULT, Unknowns
from ...models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind
from ...solve.linearised_equations import LinearisedEquations
from ...solve.solution import Solution
from ...types import NO_ROWS, Array, Index, Mask
from ..group_tests import MIN_CONTROLLED_SHARE
from .shared_errors import ErrorQuantity

MAX_TESTED_ELEMENTS = 4_000_000
"""Largest number of elements of the dense right-hand sides that are solved at once."""
MAX_ROWS_IN_MEMORY = 100_000
"""Number of rows whose partials are in memory at once."""
MAX_RAYS_OF_FIXED_CALIBRATION = 2_000_000
"""Largest number of image points with which held values of calibrations are tested: each touches
all of them."""
MAX_RELATIVE_ERROR_OF_C = 0.5
"""Largest error of a principal distance, relative to it: the partials hold for no larger one."""
MIN_SCALED_COORDINATES = 4
"""Smallest number of held coordinates with a scale of their own: that of fewer is the error of any
of them."""
SCALE_AXES = "xyz"


@dataclass(frozen=True)
class SharedErrorTest:
    """What an error with q components explains."""

    error: Array
    """Estimated error ∇̂, (q,); NaN for components that the residuals do not determine."""
    sigma: Array
    """Its standard deviations for σ0 = 1, (q,); infinite for such components."""
    t2: float
    """T²; NaN if the residuals determine no component."""
    dof: int
    """Number of components that the residuals determine."""


def whitening_matrix(equations: Equations) -> csr_array:
    """Return W with W Σ Wᵀ = I of all observations, (n_rows, n_rows)."""
    diagonal = 1.0 / equations.sigmas()
    parts: list[tuple[Array, Index, Index]] = []
    for place, block in enumerate(equations.blocks):
        if block.whitener is None:
            continue
        alone = np.setdiff1d(np.arange(block.n), equations.in_cluster.get(place, NO_ROWS))
        rows = np.arange(block.rows.start, block.rows.stop).reshape(block.observed.shape)[alone]
        diagonal[rows] = 0.0
        i, j = np.broadcast_arrays(rows[:, :, None], rows[:, None, :])
        parts.append((block.whitener[alone].ravel(), i.ravel(), j.ravel()))
    for c in equations.clusters:
        diagonal[c.rows] = 0.0
        i, j = np.broadcast_arrays(c.rows[:, None], c.rows[None, :])
        parts.append((c.whitener.ravel(), i.ravel(), j.ravel()))
    out = csr_array(diags_array(diagonal))
    if parts:
        values, i, j = (np.concatenate(x) for x in zip(*parts, strict=True))
        out = out + csr_array(coo_array((values, (i, j)), shape=out.shape))
    return csr_array(out)


def shared_error_tests(
    solution: Solution, columns: csc_array, groups: Sequence[Index]
) -> list[SharedErrorTest]:
    """Test errors that several observations share.

    Args:
        solution: the adjustment without them.
        columns: W C of all of them beside one another, (n_rows, k).
        groups: the columns of each error.
    """

    def pieces(at: Index) -> Iterator[tuple[Index, csr_array]]:
        z = csr_array(columns[:, at])
        for rows in row_pieces(np.flatnonzero(np.diff(z.indptr))):
            yield rows, csr_array(z[rows])

    return piecewise_error_tests(solution, pieces, groups)


def row_pieces(rows: Index) -> list[Index]:
    """Divide rows so that their partials take bounded memory."""
    return np.array_split(rows, -(-len(rows) // MAX_ROWS_IN_MEMORY)) if len(rows) else []


def piecewise_error_tests(
    solution: Solution,
    pieces: Callable[[Index], Iterator[tuple[Index, csr_array]]],
    groups: Sequence[Index],
) -> list[SharedErrorTest]:
    """Test errors whose columns are made piece by piece.

    Args:
        solution: the adjustment without them.
        pieces: (columns, (k,)) → rows (r,), and W C of these rows and columns, (r, k); rows where
            all of them are zero may be left out.
        groups: the columns of each error.
    """
    most = max(1, MAX_TESTED_ELEMENTS // max(solution.equations.unknowns.n_columns, 1))
    out: list[SharedErrorTest] = []
    part: list[Index] = []
    for group in groups:
        if part and sum(map(len, part)) + len(group) > most:
            out += _error_tests(solution, pieces, part)
            part = []
        part.append(group)
    return out + (_error_tests(solution, pieces, part) if part else [])


def _error_tests(
    solution: Solution,
    pieces: Callable[[Index], Iterator[tuple[Index, csr_array]]],
    groups: Sequence[Index],
) -> list[SharedErrorTest]:
    system = solution.normal().system
    at = np.concatenate(groups)
    k = len(at)
    u, total = np.zeros(k), csr_array((k, k))
    y = np.zeros((solution.equations.unknowns.n_columns, k))
    for rows, z in pieces(at):
        u += z.T @ system.residual[rows]
        total = total + z.T @ z
        y += system.sparse(rows).T @ z.toarray()
    q = solution.cofactor_times(y)
    first, out = 0, []
    for group in groups:
        own = slice(first, first + len(group))
        mine = total[own][:, own].toarray()
        s = mine - y[:, own].T @ q[:, own]
        out.append(_error_test(u[own], s, np.diag(mine)))
        first += len(group)
    return out


def t2_of_errors(solution: Solution, columns: csc_array, q: int) -> Array:
    """Return T² of errors with q components each, (h,); 0 where the residuals determine none.

    Args:
        solution: the adjustment without them.
        columns: W C of all of them beside one another, (n_rows, h q).
        q: number of components.
    """
    system = solution.normal().system
    rows: Index = np.unique(columns.indices).astype(np.intp)
    a, v = system.sparse(rows), system.residual[rows]
    at_once = max(1, MAX_TESTED_ELEMENTS // max(q * a.shape[1], 1)) * q
    out = []
    for first in range(0, columns.shape[1], at_once):
        z = csr_array(columns[:, first : first + at_once])[rows]
        y = (a.T @ z).toarray()
        s = -np.einsum(
            "uhi,uhj->hij",
            y.reshape(len(y), -1, q),
            solution.cofactor_times(y).reshape(len(y), -1, q),
        )
        for i in range(q):
            for j in range(q):
                s[:, i, j] += np.asarray(z[:, i::q].multiply(z[:, j::q]).sum(axis=0)).ravel()
        total = np.asarray(z.multiply(z).sum(axis=0)).reshape(-1, q)
        scale = np.sqrt(np.where(total > 0, total, 1.0))
        values, vectors = np.linalg.eigh(s / (scale[:, :, None] * scale[:, None, :]))
        along = np.einsum("hij,hi->hj", vectors, (z.T @ v).reshape(-1, q) / scale)
        seen = values > MIN_CONTROLLED_SHARE
        out.append(np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1))
    return np.concatenate(out) if out else np.zeros(0)


def conditional_error_tests(
    solution: Solution, columns: csc_array, one: Index, other: Index
) -> tuple[SharedErrorTest, SharedErrorTest, Array]:
    """Return what one error explains, what another one explains beside it, and S of the latter.

    With u and S of both together, the other one has, with the first as an unknown,

        u₂₁ = u₂ − S₂₁ S₁₁⁻¹ u₁,   S₂₂₁ = S₂₂ − S₂₁ S₁₁⁻¹ S₁₂.

    Args:
        solution: the adjustment without them.
        columns: W C of both beside one another, (n_rows, k).
        one: columns of the first; the residuals determine all its components.
        other: columns of the other.
    """
    system = solution.normal().system
    rows: Index = np.unique(columns.indices).astype(np.intp)
    z = csr_array(columns)[rows]
    y = system.sparse(rows).T @ z.toarray()
    total = (z.T @ z).toarray()
    u, s = z.T @ system.residual[rows], total - y.T @ solution.cofactor_times(y)
    own, size = s[np.ix_(one, one)], np.diag(total)
    moved = np.linalg.solve(own, np.column_stack([u[one], s[np.ix_(one, other)]]))
    left = s[np.ix_(other, other)] - s[np.ix_(other, one)] @ moved[:, 1:]
    rest = u[other] - s[np.ix_(other, one)] @ moved[:, 0]
    return _error_test(u[one], own, size[one]), _error_test(rest, left, size[other]), left


def _error_test(u: Array, s: Array, total: Array) -> SharedErrorTest:
    """Return what one error explains, from u, S and the diagonal of CᵀPC."""
    scale = np.sqrt(np.where(total > 0, total, 1.0))
    values, vectors = np.linalg.eigh(0.5 * (s + s.T) / np.outer(scale, scale))
    seen = values > MIN_CONTROLLED_SHARE
    along = vectors[:, seen].T @ (u / scale)
    t2 = float(np.sum(along**2 / values[seen])) if seen.any() else np.nan
    error = -(vectors[:, seen] @ (along / values[seen])) / scale
    sigma = np.sqrt(np.sum(vectors[:, seen] ** 2 / values[seen], axis=1)) / scale
    # An undetermined component has a part in the directions that are not seen.
    open_ = np.sum(vectors[:, ~seen] ** 2, axis=1) > MIN_CONTROLLED_SHARE
    return SharedErrorTest(
        np.where(open_, np.nan, error), np.where(open_, np.inf, sigma), t2, int(seen.sum())
    )


@dataclass(frozen=True)
class GivenValue:
    """A held unknown, tested as if its held components had been given with σ → ∞."""

    kind: VariableKind
    """Kind of the unknown."""
    name: str
    """Its name."""
    components: tuple[str, ...]
    """Names of its held components, (q,)."""
    sizes: tuple[ErrorQuantity, ...]
    """Their quantities, (q,)."""
    together: SharedErrorTest
    """All of its held components together: T² and the errors given − true, in metres, radians or
    image units."""
    apart: tuple[SharedErrorTest, ...]
    """Each of them alone, the others held."""
    possible: bool = True
    """Whether errors of this size are made: a principal distance that is another one altogether, or
    a factor between any two units, explains nothing."""

    @property
    def w(self) -> Array:
        """Test values of the single components, √T² with the sign of −∇̂, (q,)."""
        sign = np.array([-np.sign(e.error[0]) for e in self.apart])
        return np.asarray(sign * np.sqrt([e.t2 for e in self.apart]))


def given_values(solution: Solution) -> tuple[GivenValue, ...]:
    """Test every held unknown that observations touch.

    Args:
        solution: result of `adjust`.

    Returns:
        Points, photos, calibrations and parameters with held components, in the order of the
        network; no calibrations with more than `MAX_RAYS_OF_FIXED_CALIBRATION` image points, and
        nothing where the user added factors, whose partials by held components are not known.

    Raises:
        SingularError: the normal equations are singular at the solution.
    """
    if solution.extra.n_rows:
        return ()
    held = fixed_components(solution.equations)
    unknowns = solution.equations.unknowns.freed(held)
    equations = replace(solution.equations, unknowns=unknowns)
    system = LinearisedEquations(equations, solution.state)
    # What no observation depends on, such as x and y in levelling, was not given.
    noticed = system.diagonal() > 0
    named = [
        (kind, number, which)
        for kind, flags in held.items()
        for number in np.flatnonzero(flags.any(axis=1)).tolist()
        if len(which := _noticed(unknowns, kind, number, np.flatnonzero(flags[number]), noticed))
    ]
    if not named:
        return ()
    columns, groups = _columns(unknowns, named)
    alone = [np.array([column]) for group in groups for column in group.tolist()]
    touched = [equations.touching(k, np.array([n for o, n, _ in named if o == k])) for k in held]
    rows = np.unique(np.concatenate(touched))

    def pieces(at: Index) -> Iterator[tuple[Index, csr_array]]:
        for some in row_pieces(rows):
            # f(x) computes with the given value, which is larger than the true one by ∇.
            yield some, csr_array(-csc_array(system.sparse(some))[:, columns[at]])

    found = piecewise_error_tests(solution, pieces, [*groups, *alone])
    together, apart = found[: len(groups)], iter(found[len(groups) :])
    out = []
    for (kind, number, which), whole in zip(named, together, strict=True):
        names = unknowns.component_names(kind, number)
        out.append(
            GivenValue(
                kind,
                unknowns[kind].names[number],
                tuple(names[i] for i in which.tolist()),
                _sizes(kind, which),
                whole,
                tuple(next(apart) for _ in which),
                _possible(equations, kind, number, which, whole.error),
            )
        )
    return tuple(out)


def _noticed(
    unknowns: Unknowns, kind: VariableKind, number: int, held: Index, noticed: Mask
) -> Index:
    """Return the held components of a variable on which an observation depends."""
    return held[noticed[unknowns.columns(kind, number)[held]]]


def _possible(
    equations: Equations, kind: VariableKind, number: int, which: Index, error: Array
) -> bool:
    """Return whether errors (q,) of held components have a size in which they are made."""
    table, components = equations.unknowns[kind], UNKNOWNS[kind].components
    if components:
        largest = np.array([components[i].largest_error for i in which.tolist()])
        return not bool(np.any(np.abs(error) > largest))
    lengths = [equations.unknowns.component_names(kind, number)[i] == "c" for i in which.tolist()]
    given = np.abs(table.values[number][which])
    return not bool(np.any(np.asarray(lengths) & (np.abs(error) > MAX_RELATIVE_ERROR_OF_C * given)))


def _sizes(kind: VariableKind, which: Index) -> tuple[ErrorQuantity, ...]:
    components = UNKNOWNS[kind].components
    if not components:  # of a calibration
        image: ErrorQuantity = "image"
        return (image,) * len(which)
    return tuple(components[i].quantity for i in which.tolist())


def fixed_components(equations: Equations) -> dict[VariableKind, Mask]:
    """Return the held components that observations touch, (n, largest size), by kind."""
    unknowns = equations.unknowns
    out: dict[VariableKind, Mask] = {}
    for kind, table in unknowns.tables.items():
        touched = np.zeros(len(table.names), dtype=bool)
        for block in equations.blocks:
            for what, index in block.variables:
                if what == kind and not block.prior:
                    touched[index] = True
        if kind not in ENTITIES and DEFAULT in table.number and UNKNOWNS[kind].default is not None:
            # What is not named was not given.
            touched[table.number[DEFAULT]] = False
        if kind == "calibration" and equations.n_rays > MAX_RAYS_OF_FIXED_CALIBRATION:
            continue
        there = np.arange(table.free.shape[1]) < table.size[:, None]
        held = ~table.free & there & touched[:, None]
        if held.any():
            out[kind] = held
    return out


def _columns(
    unknowns: Unknowns, named: Sequence[tuple[VariableKind, int, Index]]
) -> tuple[Index, list[Index]]:
    """Return the columns of held components, (k,), and which of them each unknown has."""
    groups, parts, first = [], [], 0
    for kind, number, which in named:
        parts.append(unknowns.columns(kind, number)[which])
        groups.append(first + np.arange(len(which)))
        first += len(which)
    return np.concatenate(parts), groups


@dataclass(frozen=True)
class AxisScale:
    """A scale of all given coordinates along an axis."""

    axis: str
    """Name of the axis."""
    points: int
    """Number of held points."""
    found: SharedErrorTest
    """What it explains; its error is s = 1 − true / given."""


def axis_scales(solution: Solution) -> list[AxisScale]:
    """Test the scale of given coordinates along each axis.

    Args:
        solution: result of `adjust`.

    Returns:
        The axes along which `MIN_SCALED_COORDINATES` points with coordinates of their own are held;
        none where the user added factors, whose partials by held components are not known.

    Raises:
        SingularError: the normal equations are singular at the solution.
    """
    held = fixed_components(solution.equations).get("point")
    if solution.extra.n_rows or held is None:
        return []
    at = solution.state["point"]
    wide = [
        a
        for a in range(len(SCALE_AXES))
        if len(np.unique(at[held[:, a], a])) >= MIN_SCALED_COORDINATES
    ]
    if not wide:
        return []
    unknowns = solution.equations.unknowns.freed({"point": held})
    equations = replace(solution.equations, unknowns=unknowns)
    system = LinearisedEquations(equations, solution.state)
    points = np.flatnonzero(held.any(axis=1))
    first = np.array([unknowns.columns("point", p)[0] for p in points.tolist()])
    ratio = [np.where(held[points, a], at[points, a], np.nan) for a in wide]
    ratio = [np.nan_to_num(r - np.nanmean(r)) for r in ratio]
    rows = np.unique(equations.touching("point", points))

    def pieces(which: Index) -> Iterator[tuple[Index, csr_array]]:
        for some in row_pieces(rows):
            a = csc_array(system.sparse(some))
            # f(x) computes with the given values, which are larger than the true ones by s (x − x̄).
            columns = [-(a[:, first + wide[i]] @ ratio[i]) for i in which.tolist()]
            yield some, csr_array(np.stack(columns, axis=1))

    groups: list[Index] = [np.array([i]) for i in range(len(wide))]
    explained = piecewise_error_tests(solution, pieces, groups)
    return [
        AxisScale(SCALE_AXES[a], int(held[:, a].sum()), e)
        for a, e in zip(wide, explained, strict=True)
    ]
