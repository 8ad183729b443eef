"""Users' GTSAM factors: made for named unknowns, linearised into columns, and as observations.

A key counts the unknowns of one network. Where a network grows, a function that asks for keys by
names says what its factor depends on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import gtsam
import numpy as np

from ..entities import Key, parameter_name
from ..errors import InputError, Problem
from ..models.base import DegenerateError, Linearised
from ..models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations.user_factor import OwnFactor
from ..types import Array, Index
from .equations import Equations
from .keys import KeyMap, from_gtsam, insert, is_pose, pose_of
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


class KeyOf(Protocol):
    """Function that returns the key of an unknown by its kind and name, as `KeyMap.key`."""

    def __call__(self, kind: VariableKind, name: str) -> int:
        """Return the key."""
        ...

    def scale(self, kind: VariableKind, name: str) -> Array:
        """Return what values in the graph are multiplied by to be given ones, `KeyMap.scale`."""
        ...


MakesFactor: TypeAlias = Callable[[KeyOf], gtsam.NonlinearFactor]
"""A user's function: it is given a `KeyOf`, and returns a factor over keys that it asked for."""


def made(name: str, make: MakesFactor, keys: KeyMap) -> gtsam.NonlinearFactor:
    """Return the factor that a user's function makes with the keys of a network.

    Raises:
        InputError: the network has no unknown of a name that the function asks for, or what the
            function returns is no factor.
    """
    try:
        factor = make(keys)
    except InputError as error:
        where = f"factor {name!r}"
        raise InputError([Problem(str(p), where) for p in error.problems]) from None
    if not isinstance(factor, gtsam.NonlinearFactor):
        kind = type(factor).__name__
        what = f"its function must return a `gtsam.NonlinearFactor`, not {kind}"
        raise InputError(Problem(what, f"factor {name!r}"))
    return factor


def observation_of(name: str, make: MakesFactor, network: Network) -> OwnFactor:
    """Return a factor as an observation, which finds its unknowns by their names.

    Args:
        name: id of the observation.
        make: function that makes the factor.
        network: network with the unknowns that the factor depends on.

    Raises:
        InputError: as `made`; the factor has a key that its function did not ask for, or no noise
            model: what it observes then cannot be tested when it arrives.
    """
    where = f"factor {name!r}"
    if not callable(make):
        kind = type(make).__name__
        what = (
            "give a function of key(kind, name) that makes the factor, such as lambda key: "
            f"gtsam.RangeFactor3(key('point', 'A'), key('point', 'B'), …), not {kind}: the keys of "
            "a factor count the unknowns of one network, and this network grows"
        )
        raise InputError(Problem(what, where))
    keys = KeyMap(Unknowns(network))
    asked: dict[int, tuple[VariableKind, str]] = {}

    class Asked(KeyMap):
        """Notes the keys that are asked for."""

        def key(self, kind: VariableKind, name: str) -> int:
            found = super().key(kind, name)
            asked[found] = (kind, name)
            return found

    factor = made(name, make, Asked(keys.unknowns))
    own = list(dict.fromkeys(factor.keys()))
    if strange := [k for k in own if k not in asked]:
        shown = gtsam.DefaultKeyFormatter(strange[0])
        what = f"its function must ask key(kind, name) for every key; it did not for {shown}"
        raise InputError(Problem(what, where))
    if not isinstance(factor, gtsam.NoiseModelFactor):
        what = (
            f"a {type(factor).__name__} has no noise model, so that it cannot be tested when it "
            "arrives; hand it to adjust(…, extra_factors=…)"
        )
        raise InputError(Problem(what, where))
    if isinstance(factor.noiseModel(), gtsam.noiseModel.Robust):
        what = (
            "has a robust noise model, whose weight depends on the residual, so that it cannot be "
            "tested when it arrives; give the model that it wraps"
        )
        raise InputError(Problem(what, where))
    unknowns = tuple((kind, _key_in(network, kind, n)) for kind, n in (asked[k] for k in own))
    kinds = tuple(kind for kind, _ in unknowns)
    numbers = [keys.unknowns[kind].number[n] for kind, n in (asked[k] for k in own)]
    scales = tuple(map(keys.unknowns.graph_scale, kinds, numbers))
    model = FactorModel(factor, tuple(own), kinds, scales, where)
    return OwnFactor(unknowns, model, factor.dim(), id=name, source=type(factor).__name__)


def _key_in(network: Network, kind: VariableKind, name: str) -> Key:
    """Return the key under which a network states an unknown."""
    if kind in ENTITIES:
        return name
    return next((k for k in network.of_kind(kind) if parameter_name(k) == name), name)


@dataclass(frozen=True, eq=False)
class FactorModel:
    """Model of a factor: residuals and partials in standard deviations of its noise model.

    GTSAM cannot pickle factors of every type. What is pickled has lost its factor, and says so
    where it is evaluated; copies share the factor.
    """

    factor: gtsam.NoiseModelFactor | None
    """The factor; none after pickling."""
    keys: tuple[int, ...]
    """Its keys."""
    kinds: tuple[VariableKind, ...]
    """Kind of the unknown of each."""
    scales: tuple[Array | None, ...]
    """Scale of each, see `Unknowns.graph_scale`."""
    where: str
    """Name of the factor, for messages."""

    def __call__(self, frame: object, *values: Array, observed: Array) -> Linearised:
        """Return residuals (n, d) and partials of the unknowns whose stored values are given.

        Raises:
            InputError: the factor was lost in pickling, or is not finite.
            DegenerateError: the factor is inactive.
        """
        del frame
        every = [
            self._linearised([v[i : i + 1] for v in values], observed.shape[1])
            for i in range(len(observed))
        ]
        inactive = [i for i, found in enumerate(every) if found is None]
        if inactive:
            raise DegenerateError(np.array(inactive, dtype=np.intp), "the factor is inactive here")
        residuals, partials = zip(*(found for found in every if found is not None), strict=True)
        return Linearised(np.array(residuals), tuple(map(np.array, zip(*partials, strict=True))))

    def _linearised(self, values: Sequence[Array], size: int) -> tuple[Array, list[Array]] | None:
        """Return residuals (d,) and partials (d, k) at values (1, s); None: it is inactive."""
        if self.factor is None:
            what = "was left behind when its network was pickled: add it again"
            raise InputError(Problem(what, self.where))
        given = gtsam.Values()
        for key, kind, scale, row in zip(self.keys, self.kinds, self.scales, values, strict=True):
            if is_pose(kind):
                given.insert(key, pose_of(row[0]))
            else:
                stated = UNKNOWNS[kind].given(row)[0]
                given.insert(key, stated if scale is None else stated / scale)
        found = linear_rows(self.factor, given, self.where)
        if found is None:
            return None
        order, a, r = found
        if r.shape != (size,):
            what = f"has {len(r)} residuals here, and was to have {size}"
            raise InputError(Problem(what, self.where))
        by_key = dict(zip(order, np.split(a, self._ends(order, values), axis=1), strict=True))
        return r, [
            from_gtsam(kind, by_key[key], row[0], scale)
            for key, kind, scale, row in zip(
                self.keys, self.kinds, self.scales, values, strict=True
            )
        ]

    def _ends(self, order: list[int], values: Sequence[Array]) -> Array:
        """Return where the columns of each key end, but for the last."""
        size = {
            key: UNKNOWNS[kind].given(row).shape[1]
            for key, kind, row in zip(self.keys, self.kinds, values, strict=True)
        }
        return np.cumsum([size[key] for key in order])[:-1]

    def __deepcopy__(self, memo: Mapping[int, Any]) -> FactorModel:
        """Return the object itself: it is immutable."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: everything but the factor."""
        return {**vars(self), "factor": None}
