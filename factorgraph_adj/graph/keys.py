"""How the unknowns of a network appear in GTSAM: keys, values and the tangent of poses.

A key is ``gtsam.symbol(char, number)``: the character tells the kind, the number counts the
variables of that kind in the order in which the network got them. Variables that are held
altogether are constants of the factors and have no key.

The tangent of a pose is the one thing that differs. Ours is [ω, δ]: R ← R Exp(ω), X₀ ← X₀ + δ
in object axes; GTSAM's is [ω, v] with v = Rᵀ δ to first order.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np

from ..errors import InputError, Problem, known
from ..models.registry import VariableKind
from ..types import Array
from .equations import Equations
from .variables import State, Unknowns

CHARS: dict[VariableKind, str] = {
    "point": "p",
    "pose": "c",
    "calibration": "k",
    "orientation": "o",
    "refraction": "r",
    "vertical": "v",
    "edm": "e",
}
"""Character of the keys of each kind of variable."""
_KINDS: dict[int, VariableKind] = {ord(char): kind for kind, char in CHARS.items()}
_SHIFT = 56
"""A gtsam.Symbol keeps its character in the highest of eight bytes."""
_NUMBER = (1 << _SHIFT) - 1


class KeyMap:
    """Names of variables ↔ keys of the graph."""

    def __init__(self, unknowns: Unknowns) -> None:
        """Map the variables of ``unknowns`` that have a free component."""
        self.unknowns = unknowns

    def key(self, kind: VariableKind, name: str) -> int:
        """Return the key of a variable.

        Args:
            kind: point, pose, calibration, orientation, refraction, vertical or edm.
            name: of the point, photo (its pose), camera (``camera@photo`` where each photo has a
                calibration of its own), set (``station/set``), refraction group, station
                or distance meter.

        Raises:
            InputError: the network has no such variable, or it is held altogether.
        """
        if kind not in CHARS:
            raise InputError(f"unknown kind of variable {kind!r}; valid: {', '.join(CHARS)}")
        table = self.unknowns[kind]
        number = table.number.get(name)
        if number is None:
            raise InputError(f"unknown {kind} {name!r}; known: {known(table.names)}")
        if table.offset[number] < 0:
            raise InputError(
                Problem("is held altogether: a constant without a key", f"{kind} {name!r}")
            )
        return self.of(kind, number)

    def name(self, key: int) -> str:
        """Return the name of the variable with this key; InputError if there is none."""
        kind, number = self.variable(key)
        return self.unknowns[kind].names[number]

    def kind(self, key: int) -> VariableKind:
        """Return the kind of the variable with this key; InputError if there is none."""
        return self.variable(key)[0]

    def variable(self, key: int) -> tuple[VariableKind, int]:
        """Return kind and number of the variable with this key.

        Raises:
            InputError: no variable of the network has the key, or it is held altogether.
        """
        kind = _KINDS.get(key >> _SHIFT)
        number = key & _NUMBER
        shown = gtsam.DefaultKeyFormatter(key)
        if kind is None or number >= len(self.unknowns[kind].names):
            held = ", ".join(f"{char} {k}" for k, char in CHARS.items())
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
        return (ord(CHARS[kind]) << _SHIFT) | int(number)

    def __len__(self) -> int:
        """Return the number of keys."""
        return sum(int(np.sum(t.offset >= 0)) for t in self.unknowns.tables.values())


def insert(
    values: gtsam.Values,
    unknowns: Unknowns,
    state: State,
    variables: Iterable[tuple[VariableKind, int]],
) -> None:
    """Put variables of ``state`` into ``values``: poses as Pose3, all others as vectors."""
    for kind, number in variables:
        row = state[kind][number]
        key = KeyMap.of(kind, number)
        if kind == "pose":
            values.insert(key, gtsam.Pose3(gtsam.Rot3(row[:9].reshape(3, 3)), row[9:]))
        else:
            values.insert(key, row[: unknowns[kind].size[number]])


def values_of(equations: Equations, state: State) -> gtsam.Values:
    """Return the variables with keys as gtsam.Values.

    Poses are ``gtsam.Pose3`` (world_T_camera, x right, y down, z forward), points 3-vectors, all
    others vectors (of length 1 for scalars).
    """
    values = gtsam.Values()
    insert(values, equations.unknowns, state, equations.unknowns.active())
    return values


def state_of(equations: Equations, values: gtsam.Values) -> State:
    """Return the state that ``values`` describe; held variables keep what the network gives.

    Raises:
        InputError: ``values`` lack a variable; all that are missing are named.
    """
    unknowns = equations.unknowns
    missing = [
        Problem("has no value", f"{kind} {unknowns[kind].names[number]!r}")
        for kind, number in unknowns.active()
        if not values.exists(KeyMap.of(kind, number))
    ]
    if missing:
        raise InputError(missing)
    state = unknowns.start()
    for kind, table in unknowns.tables.items():
        rows = np.flatnonzero(table.offset >= 0)
        keys = [KeyMap.of(kind, i) for i in rows.tolist()]
        if kind == "pose":
            state[kind][rows] = pose_rows([values.atPose3(k) for k in keys])
        elif kind == "calibration":
            for i, k in zip(rows, keys, strict=True):
                state[kind][i, : table.size[i]] = values.atVector(k)
        elif len(rows):
            state[kind][rows] = [values.atVector(k) for k in keys]
    return state


def pose_rows(poses: Sequence[gtsam.Pose3]) -> Array:
    """Return poses as rows of 9 of rotation and 3 of centre, (n, 12)."""
    out = np.empty((len(poses), 12))
    for i, pose in enumerate(poses):
        out[i, :9] = pose.rotation().matrix().ravel()
        out[i, 9:] = pose.translation()
    return out


def pose_from_gtsam(jacobian: Array, rotation: Array) -> Array:
    """Return partials (m, 6) by our tangent [ω, δ] of those by GTSAM's [ω, v]: v = Rᵀ δ."""
    return np.hstack([jacobian[:, :3], jacobian[:, 3:] @ rotation.T])


def pose_to_gtsam(jacobian: Array, rotation: Array) -> Array:
    """Return partials (m, 6) by GTSAM's tangent [ω, v] of those by ours [ω, δ]: δ = R v."""
    return np.hstack([jacobian[:, :3], jacobian[:, 3:] @ rotation])
