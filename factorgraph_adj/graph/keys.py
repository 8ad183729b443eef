"""Keys of unknowns in GTSAM, their values in gtsam.Values, and tangents of both libraries.

A key is ``gtsam.symbol(char, number)``: the character tells the kind, the number counts the
variables of that kind in the order in which the network got them. Completely held variables are
constants of the factors and have no key.

A rotation with a shift is a ``gtsam.Pose3``, every other unknown is a vector of its given values;
the vector of an unknown with a rotation begins with the rotation vector. Values of calibrations are
divided by scales, see `scales`. The tangents of this
library and of GTSAM differ for two types. For a pose, this library has [ω, δ]: R ← R Exp(ω),
X₀ ← X₀ + δ in object axes; GTSAM has [ω, v] with v = Rᵀ δ to first order. For a rotation vector r,
this library has ω = J_r(r) dr; GTSAM has dr.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import gtsam
import numpy as np

from ..errors import AdjustmentError, InputError, Problem, similar, unknown_name
from ..models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind
from ..rotation import log_rotation, right_jacobian_inverse
from ..types import Array
from .equations import Equations
from .variables import State, Unknowns

_SHIFT = 56
"""Bits below the character of a gtsam.Symbol, which is the highest of eight bytes."""
_NUMBER = (1 << _SHIFT) - 1


_VARIABLE = re.compile(r"\bvariable\s+(\d+)\b")
"""Where an error of GTSAM has the key of a variable."""


def variable_in_error(
    error: RuntimeError, numbers: Mapping[VariableKind, Mapping[str, int]]
) -> str:
    """Return the variable near which GTSAM found a system indeterminate: ``point 'P'``.

    Empty where the error has none.

    Args:
        error: the error.
        numbers: number of each variable in its key, by kind and name.
    """
    if (found := _VARIABLE.search(str(error))) is None:
        return ""
    letter, number = divmod(int(found[1]), 1 << _SHIFT)
    for kind, own in numbers.items():
        if ord(UNKNOWNS[kind].letter) == letter:
            names = (name for name, n in own.items() if n == number)
            return next((f"{UNKNOWNS[kind].noun} {name!r}" for name in names), "")
    return ""


class KeyMap:
    """Names of variables ↔ keys of the graph."""

    def __init__(
        self, unknowns: Unknowns, numbers: Mapping[VariableKind, Mapping[str, int]] | None = None
    ) -> None:
        """Map the variables of ``unknowns`` that have a free component.

        Args:
            unknowns: the variables.
            numbers: number of each variable in its key, by kind and name; none: that which it has
                among the unknowns.
        """
        self.unknowns = unknowns
        self._numbers = numbers
        self._names: dict[VariableKind, dict[int, str]] = {
            kind: {n: name for name, n in own.items()} for kind, own in (numbers or {}).items()
        }

    def key(self, kind: VariableKind, name: str) -> int:
        """Return the key of a variable.

        Args:
            kind: a kind of unknowns, such as point, pose, calibration, orientation or edm.
            name: name of the point, photo (for its pose), camera (``camera@photo`` if each photo
                has a calibration of its own), set (``station/set``), refraction group, station
                or distance meter.

        Raises:
            InputError: the network has no such variable, or the variable is completely held.
        """
        if kind not in UNKNOWNS:
            valid = f"valid: {', '.join(UNKNOWNS)}{similar(kind, UNKNOWNS)}"
            raise InputError(f"unknown kind of variable {kind!r}; {valid}")
        table = self.unknowns[kind]
        number = table.number.get(name)
        if number is None:
            raise InputError(unknown_name(kind, name, table.names))
        if table.offset[number] < 0:
            raise InputError(
                Problem("is held altogether: a constant without a key", f"{kind} {name!r}")
            )
        return self.at(kind, number)

    def at(self, kind: VariableKind, number: int) -> int:
        """Return the key of a variable by its number among the unknowns, without a check."""
        if self._numbers is not None:
            number = self._numbers[kind][self.unknowns[kind].names[number]]
        return self.of(kind, number)

    def __call__(self, kind: VariableKind, name: str) -> int:
        """Return the key of a variable, as `key`."""
        return self.key(kind, name)

    def scale(self, kind: VariableKind, name: str) -> Array:
        """Return what a value in the graph is multiplied by to be the given one, (size,).

        It is 1 but for calibrations, whose raw values GTSAM's solvers cannot take, see `scales`:

            given = scale * values.atVector(key),    covariance of given = S Σ S,  S = diag(scale)

        Raises:
            InputError: as `key`.
        """
        self.key(kind, name)
        number = self.unknowns[kind].number[name]
        scale = self.unknowns.graph_scale(kind, number)
        return np.ones(int(self.unknowns[kind].size[number])) if scale is None else scale

    def covariance(
        self, kind: VariableKind, name: str, marginal: Array, values: gtsam.Values
    ) -> Array:
        """Return the covariance of a variable by the tangent of this library, (size, size).

            Σ = D Σ_GTSAM Dᵀ,    D = ∂(our tangent) / ∂(GTSAM's)

        It is in the units and axes of `Solution.covariance`: poses have [ω, δ] with the shift in
        object axes, calibrations the given units. Held components have zeros.

        Args:
            kind: kind of the variable.
            name: its name.
            marginal: GTSAM's marginal covariance, (size, size).
            values: where it was computed.

        Raises:
            InputError: as `key`.
        """
        key = self.key(kind, name)
        number = self.unknowns[kind].number[name]
        scale = self.unknowns.graph_scale(kind, number)
        row = stored_row(values, kind, key, scale)
        by = to_gtsam(kind, np.eye(len(marginal)), row, scale)
        free = self.unknowns.free[self.unknowns.columns(kind, number)]
        return np.where(np.outer(free, free), by @ marginal @ by.T, 0.0)

    def name(self, key: int) -> str:
        """Return the name of the variable with this key; InputError for an unknown key."""
        kind, number = self.variable(key)
        return self.unknowns[kind].names[number]

    def kind(self, key: int) -> VariableKind:
        """Return the kind of the variable with this key; InputError for an unknown key."""
        return self.variable(key)[0]

    def variable(self, key: int) -> tuple[VariableKind, int]:
        """Return kind and number of the variable with this key.

        Raises:
            InputError: no variable of the network has the key, or the variable is completely held.
        """
        kind = next((k.name for k in UNKNOWNS.values() if ord(k.letter) == key >> _SHIFT), None)
        number = key & _NUMBER
        if kind is not None and self._names:
            name = self._names.get(kind, {}).get(number, "")
            number = self.unknowns[kind].number.get(name, _NUMBER)
        shown = gtsam.DefaultKeyFormatter(key)
        if kind is None or number >= len(self.unknowns[kind].names):
            names = sorted(UNKNOWNS, key=lambda name: name not in ENTITIES)
            held = ", ".join(f"{UNKNOWNS[name].letter} {name}" for name in names)
            raise InputError(f"key {shown} belongs to no variable of the network (keys: {held})")
        table = self.unknowns[kind]
        if table.offset[number] < 0:
            raise InputError(
                f"key {shown} is the {kind} {table.names[number]!r}, which is held altogether: "
                "a constant cannot take part in a factor"
            )
        return kind, number

    @staticmethod
    def of(kind: VariableKind, number: int) -> int:
        """Return the key of a variable by its number, without a check."""
        return (ord(UNKNOWNS[kind].letter) << _SHIFT) | int(number)

    def __len__(self) -> int:
        """Return the number of keys."""
        return sum(int(np.sum(t.offset >= 0)) for t in self.unknowns.tables.values())


def is_pose(kind: VariableKind) -> bool:
    """Return whether unknowns of a kind are poses in GTSAM: a rotation and a shift."""
    record = UNKNOWNS[kind]
    return record.rotates and record.size == 6


def insert(
    values: gtsam.Values,
    unknowns: Unknowns,
    state: State,
    variables: Iterable[tuple[VariableKind, int]],
    keys: Sequence[int] | None = None,
) -> None:
    """Put variables of ``state`` into ``values``: poses as Pose3, all others as vectors.

    Args:
        values: the values.
        unknowns: the unknowns of ``state``.
        state: values of all variables.
        variables: kind and number of each variable.
        keys: the key of each variable; none: its own.
    """
    for place, (kind, number) in enumerate(variables):
        key = KeyMap.of(kind, number) if keys is None else keys[place]
        if is_pose(kind):
            values.insert(key, pose_of(state[kind][number]))
        else:
            given, scale = unknowns.given(state, kind, number), unknowns.graph_scale(kind, number)
            values.insert(key, given if scale is None else given / scale)


def pose_of(row: Array) -> gtsam.Pose3:
    """Return the pose of a stored value."""
    return gtsam.Pose3(gtsam.Rot3(row[:9].reshape(3, 3)), row[9:])


def stored_row(
    values: gtsam.Values, kind: VariableKind, key: int, scale: Array | None = None
) -> Array:
    """Return the stored form of one variable of ``values``; scale as of `Unknowns.graph_scale`."""
    if is_pose(kind):
        return np.asarray(pose_rows([values.atPose3(key)])[0])
    given = values.atVector(key)
    if scale is not None:
        given = given * scale
    if UNKNOWNS[kind].rotates and float(np.linalg.norm(given[:3])) > np.pi:
        raise AdjustmentError(
            f"{gtsam.DefaultKeyFormatter(key)}: its rotation vector {given[:3]} is longer than π; "
            "give the same rotation by the vector of the opposite turn"
        )
    return np.asarray(UNKNOWNS[kind].store(given[None])[0])


def values_of(equations: Equations, state: State) -> gtsam.Values:
    """Return the variables with keys as gtsam.Values.

    Poses are ``gtsam.Pose3`` (world_T_camera, x right, y down, z forward), points 3-vectors, all
    others vectors (of length 1 for scalars).
    """
    values = gtsam.Values()
    insert(values, equations.unknowns, state, equations.unknowns.active())
    return values


def state_of(
    equations: Equations,
    values: gtsam.Values,
    keys: KeyMap | None = None,
    *,
    partly: bool = False,
) -> State:
    """Return the state that ``values`` describe; held variables keep their given values.

    Args:
        equations: the network.
        values: values of its variables.
        keys: their keys; none: as `values_of` gives them.
        partly: whether variables that ``values`` lack keep their start values.

    Raises:
        InputError: ``values`` lack variables; the message names all of them.
    """
    unknowns = equations.unknowns
    keys = KeyMap(unknowns) if keys is None else keys
    state = unknowns.start()
    missing = []
    for kind, number in unknowns.active():
        key = keys.at(kind, number)
        if values.exists(key):
            row = stored_row(values, kind, key, unknowns.graph_scale(kind, number))
            state[kind][number, : len(row)] = row
        elif not partly:
            missing.append(Problem("has no value", f"{kind} {unknowns[kind].names[number]!r}"))
    if missing:
        raise InputError(missing)
    return state


def pose_rows(poses: Sequence[gtsam.Pose3]) -> Array:
    """Return poses as rows (n, 12): 9 elements of the rotation, 3 of the centre."""
    out = np.empty((len(poses), 12))
    for i, pose in enumerate(poses):
        out[i, :9] = pose.rotation().matrix().ravel()
        out[i, 9:] = pose.translation()
    return out


def from_gtsam(
    kind: VariableKind, jacobian: Array, row: Array, scale: Array | None = None
) -> Array:
    """Convert partials (m, k) by GTSAM's tangent to ours, at the stored value ``row``."""
    if scale is not None:
        return jacobian / scale
    if is_pose(kind):
        return np.hstack([jacobian[:, :3], jacobian[:, 3:] @ row[:9].reshape(3, 3).T])
    if UNKNOWNS[kind].rotates:
        return np.hstack([jacobian[:, :3] @ _by_turn(row), jacobian[:, 3:]])
    return jacobian


def to_gtsam(kind: VariableKind, jacobian: Array, row: Array, scale: Array | None = None) -> Array:
    """Convert partials (m, k) by our tangent to GTSAM's, at the stored value ``row``."""
    if scale is not None:
        return jacobian * scale
    if is_pose(kind):
        return np.hstack([jacobian[:, :3], jacobian[:, 3:] @ row[:9].reshape(3, 3)])
    if UNKNOWNS[kind].rotates:
        return np.hstack([jacobian[:, :3] @ np.linalg.inv(_by_turn(row)), jacobian[:, 3:]])
    return jacobian


def _by_turn(row: Array) -> Array:
    """Return J_r⁻¹ = ∂r/∂ω (3, 3) of the rotation vector r of a stored value."""
    turn = log_rotation(row[:9].reshape(1, 3, 3))
    return np.asarray(right_jacobian_inverse(turn)[0])
