"""Linearisation of a user's GTSAM factors in the columns of the unknowns of a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import gtsam
import numpy as np

from ..errors import InputError, Problem
from ..models.variables import VariableKind
from ..types import Array, Index
from .equations import Equations
from .keys import KeyMap, from_gtsam, insert
from .variables import State, Unknowns

_NOISE = 1e-12
"""Eigenvalues of a scaled information matrix that are smaller than this fraction of the largest
eigenvalue are rounding errors."""


def name_of(number: int, factor: gtsam.NonlinearFactor) -> str:
    """Return the name of a factor that the user has not named, by its number from 1."""
    return f"factor {number} ({type(factor).__name__})"


def linearise_extra(
    factors: Mapping[str, gtsam.NonlinearFactor],
    equations: Equations,
    state: State,
    keyed: Unknowns | None = None,
) -> list[tuple[str, Index, Array, Array]]:
    """Linearise factors, by their names, at ``state``.

    The factors take the values that `factorgraph_adj.graph.keys.values_of` gives: poses as
    Pose3, everything else as vectors, calibrations divided by their scales. A robust noise model
    enters with the weights that its residuals have at ``state``. A factor without a Jacobian
    (HessianFactor: smart factors, marginalised priors) enters by a square root of its information,
    whose rows serve as residuals.

    Keys number the unknowns of one network. In another network, with fewer points for instance,
    the same key may belong to another unknown: ``keyed`` are the unknowns that the keys of the
    factors belong to, which are found in ``equations`` by their names; none: those of
    ``equations``.

    Returns:
        For each factor its name, the columns (k,) of its variables among the unknowns, its whitened
        partials A (m, k), zero for held components, and its whitened residuals r (m,). The
        linear model is r + A dx; |r|² = twice the error is the factor's part of vᵀPv. Inactive
        factors have no entry.

    Raises:
        InputError: a key is unknown in the network, or its variable is held or of another type;
            a factor is a hard constraint, not finite, or has no square root.
    """
    unknowns = equations.unknowns
    keys = KeyMap(unknowns if keyed is None else keyed)
    out = []
    for where, factor in factors.items():
        values = gtsam.Values()
        for key, variable in variables_of(factor, keys, unknowns, where).items():
            insert(values, unknowns, state, [variable], [key])
        rows = linear_rows(factor, values, where)
        if rows is None:
            continue
        order, a, r = rows
        found = variables_of(factor, keys, unknowns, where)
        variables = [found[k] for k in order]
        out.append((where, *_columns(equations, state, variables, a, where), r))
    return out


def linear_rows(
    factor: gtsam.NonlinearFactor, values: gtsam.Values, where: str
) -> tuple[list[int], Array, Array] | None:
    """Return keys, whitened partials (m, k) and whitened residuals (m,) of a factor.

    A linear factor may keep its keys in another order than the factor itself; each is returned
    once. None: the factor is inactive.

    Raises:
        InputError: the values are of another type, or as `linearise_extra`.
    """
    try:
        linear = factor.linearize(values)
    except RuntimeError as error:
        if "Attempting to" not in str(error):  # is not GTSAM's message for a wrong type
            raise
        raise InputError(Problem(f"cannot be linearised: {error}", where)) from error
    if linear is None:
        return None
    a, r = _square_root(linear, where)
    return *each_once(list(linear.keys()), a, values), r


def each_once(keys: list[int], a: Array, values: gtsam.Values) -> tuple[list[int], Array]:
    """Return the keys of a factor, each once, and partials by them, given those by its slots.

    A factor with a variable in two slots has a key twice: its partial by the variable is the sum.

    Args:
        keys: the key of each slot.
        a: partials by the slots side by side, (m, k).
        values: values of the variables.
    """
    if len(set(keys)) == len(keys):
        return keys, a
    ends = np.cumsum([dimension(values, key) for key in keys])
    sums: dict[int, Array] = {}
    for key, part in zip(keys, np.split(a, ends[:-1], axis=1), strict=True):
        sums[key] = sums[key] + part if key in sums else part
    return list(sums), np.hstack(list(sums.values()))


def dimension(values: gtsam.Values, key: int) -> int:
    """Return the dimension of a variable: six for poses, which are no vectors."""
    try:
        return len(values.atVector(key))
    except RuntimeError:
        return 6


def variables_of(
    factor: gtsam.NonlinearFactor, keys: KeyMap, unknowns: Unknowns, where: str
) -> dict[int, tuple[VariableKind, int]]:
    """Return kind and number among unknowns of each key of a factor."""
    problems, found = [], {}
    for key in dict.fromkeys(factor.keys()):
        try:
            found[key] = keys.variable(key)
            if keys.unknowns is not unknowns:
                here = KeyMap(unknowns).key(keys.kind(key), keys.name(key))
                found[key] = KeyMap(unknowns).variable(here)
        except InputError as error:
            problems += [Problem(p.what, where) for p in error.problems]
    if problems:
        raise InputError(problems)
    return found


def _square_root(linear: gtsam.GaussianFactor, where: str) -> tuple[Array, Array]:
    """Return A (m, k) and r (m,) with twice the error of the linear factor = |r + A dx|²."""
    if isinstance(linear, gtsam.HessianFactor):
        return _root_of_hessian(np.array(linear.augmentedInformation()), where)
    try:
        linear = gtsam.JacobianFactor(linear)  # expression factors have the base type
    except (RuntimeError, ValueError):  # neither Jacobian nor Hessian: implicit Schur factors
        return _root_of_hessian(np.array(linear.augmentedInformation()), where)
    if linear.isConstrained():
        raise InputError(
            Problem(
                "is a hard constraint: hold the component in the network, or give it a small "
                "standard deviation",
                where,
            )
        )
    # The arrays are views of memory that the factor owns.
    a, b = (np.array(x, dtype=float) for x in linear.jacobian())
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        raise InputError(Problem("its residuals or partials are not finite", where))
    return a.reshape(len(b), -1), -b


def _root_of_hessian(augmented: Array, where: str) -> tuple[Array, Array]:
    """Return A, r of xᵀG x − 2 xᵀg + f, given [[G, g], [gᵀ, f]]: G = AᵀA, g = −Aᵀr, f = |r|².

    The rows of A are the eigenvectors of G, scaled to unit diagonal, whose eigenvalues are not
    zero. A last row without partials carries the remainder of f, if f has a remainder.
    """
    if not np.all(np.isfinite(augmented)):
        raise InputError(Problem("its information is not finite", where))
    information, g, f = augmented[:-1, :-1], augmented[:-1, -1], float(augmented[-1, -1])
    diagonal = np.diag(information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    largest = max(float(values[-1]), 0.0)
    keep = values > _NOISE * largest
    roots, basis = np.sqrt(values[keep]), vectors[:, keep]
    a = (basis * roots).T * scale
    r = -(basis.T @ (g / scale)) / roots
    rest = g / scale + (basis * roots) @ r
    if values[0] < -1e-9 * largest or np.linalg.norm(rest) > 1e-6 * np.linalg.norm(g / scale):
        raise InputError(
            Problem(
                "its information is not positive semi-definite: its error has no minimum", where
            )
        )
    left = f - float(r @ r)
    if left > _NOISE * abs(f):
        a, r = np.vstack([a, np.zeros(a.shape[1])]), np.append(r, np.sqrt(left))
    return a, r


def _columns(
    equations: Equations,
    state: State,
    variables: Sequence[tuple[VariableKind, int]],
    a: Array,
    where: str,
) -> tuple[Index, Array]:
    """Return the columns of the variables, and the partials by the tangents of this library."""
    unknowns = equations.unknowns
    sizes = [int(unknowns[kind].size[number]) for kind, number in variables]
    if a.shape[1] != sum(sizes):
        raise InputError(
            Problem(f"has {a.shape[1]} columns, its variables have {sum(sizes)} components", where)
        )
    columns = [np.zeros(0, dtype=np.intp)]
    parts = [a[:, :0]]
    first = 0
    for (kind, number), size in zip(variables, sizes, strict=True):
        part = a[:, first : first + size]
        scale = unknowns.graph_scale(kind, number)
        parts.append(from_gtsam(kind, part, state[kind][number], scale))
        columns.append(unknowns.columns(kind, number))
        first += size
    index = np.concatenate(columns)
    partials = np.hstack(parts)
    partials[:, ~unknowns.free[index]] = 0.0
    return index, partials
