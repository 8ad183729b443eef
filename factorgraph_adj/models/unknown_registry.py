"""The kinds of unknowns by name, built-in ones and others; `register_unknown` adds a kind.

The fields of `UnknownKind` are the components and their units, stored form and tangent, the change
in a motion of the whole object, the key in the graph, the place in the elimination, the table in a
project and the name in messages. `register_unknown` adds a kind. The batch adjustment, the free
network, covariances, reliability, the incremental adjustment, projects and reports then treat the
new kind like a built-in kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ..errors import InputError, Problem, known
from . import datum_motions
from .deformation import COEFFICIENTS, DEFORMATIONS
from .rolling_shutter import HIGHEST_POWER, MOTION
from .unknown import ENTITIES, ROTATION, Component, MoveBy, Quantity, UnknownKind, UnknownTable

__all__ = [
    "ENTITIES",
    "ROTATION",
    "UNKNOWNS",
    "Component",
    "MoveBy",
    "Quantity",
    "UnknownKind",
    "UnknownTable",
    "VariableKind",
    "parameter_kinds",
    "register_unknown",
    "unknown_kind",
]

VariableKind: TypeAlias = str
"""Name of a kind of unknowns: a key of `UNKNOWNS`."""

LARGEST_LN = 10.0
"""Largest error of the logarithm of a scale: a factor of 22 000, more than that of any two units in
which one measures."""

UNKNOWNS: dict[str, UnknownKind] = {}
"""Registered kinds of unknowns by name, in the order of their columns."""
_ATTITUDE = tuple(Component(f"r{a}", "angle", np.nan) for a in "xyz")
RATES = (
    "drifts per unit of time need observations at different times: `time` is 0 in those that leave "
    "it out"
)
"""What helps where drifts are not determined."""


def register_unknown(kind: UnknownKind) -> UnknownKind:
    """Add a kind of unknowns.

    Args:
        kind: record of the kind.

    Returns:
        The record.

    Raises:
        InputError: the record has errors, or another kind has its name, letter or table; all
            are listed.
    """
    found = kind.problems()
    if kind.name in UNKNOWNS:
        found.append("a kind of this name is registered already")
    for other in UNKNOWNS.values():
        if other.name == kind.name:
            continue
        if other.letter == kind.letter:
            found.append(f"its letter {kind.letter!r} belongs to the kind {other.name!r}")
        file = None if kind.table is None else kind.table.file
        if file is not None and other.table is not None and file == other.table.file:
            found.append(f"its table {file!r} belongs to the kind {other.name!r}")
    if found:
        raise InputError([Problem(what, f"kind of unknowns {kind.name!r}") for what in found])
    UNKNOWNS[kind.name] = kind
    return kind


def unknown_kind(name: str) -> UnknownKind:
    """Return the record of a kind; InputError if no kind has this name."""
    found = UNKNOWNS.get(name)
    if found is None:
        raise InputError(f"unknown kind of unknowns {name!r}; valid: {known(UNKNOWNS, meant=name)}")
    return found


def parameter_kinds() -> tuple[UnknownKind, ...]:
    """Return the kinds whose unknowns a network states as `Parameter`, in order."""
    return tuple(k for k in UNKNOWNS.values() if k.name not in ENTITIES)


_MOVED: tuple[tuple[Quantity, tuple[str, ...]], ...] = (
    ("length", ("x", "y", "z")),
    ("angle", ("rx", "ry", "rz")),
)
"""Quantity and axes of the parts of a motion."""


def _xyz(*, start: float = np.nan) -> tuple[Component, ...]:
    return tuple(Component(a, "length", start) for a in "xyz")


_BUILT_IN: Sequence[UnknownKind] = (
    UnknownKind("point", "point", "p", _xyz(), motions=datum_motions.of_points, connects=True),
    UnknownKind(
        "orientation",
        "orientation of set",
        "o",
        (
            Component(
                "orientation",
                "angle",
                np.nan,
                column="value",
                plain=True,
                circular=True,
                planned=0.0,
            ),
        ),
        motions=datum_motions.of_orientations,
        connects=True,
        table=UnknownTable("orientations", ("station", "set"), key_default="1"),
        absent="found",
        at_point=True,
    ),
    UnknownKind(
        "refraction",
        "refraction group",
        "r",
        (Component("kappa", "number", 0.13, sign="κ", column="value"),),
        short="refraction",
        late=2,
        table=UnknownTable("refractions"),
        default=(0.0,),
        additional=True,
        reference="given",
    ),
    UnknownKind(
        "vertical",
        "vertical of station",
        "v",
        (Component("xi", "angle", sign="ξ"), Component("eta", "angle", sign="η")),
        short="vertical of",
        motions=datum_motions.of_verticals,
        connects=True,
        across=True,
        table=UnknownTable("verticals", ("station",)),
        default=(0.0, 0.0),
        absent="default",
        at_point=True,
    ),
    UnknownKind(
        "edm",
        "distance meter",
        "e",
        (Component("scale", "ppm"), Component("zero", "length", sign="zero constant")),
        motions=datum_motions.of_scales,
        late=2,
        table=UnknownTable("distance_meters", held_unless_free=True),
        default=(0.0, 0.0),
        additional=True,
        instrument=True,
    ),
    UnknownKind(
        "index_error",
        "index error",
        "i",
        (Component("index", "angle", sign="i", column="value"),),
        table=UnknownTable("index_errors"),
        default=(0.0,),
        additional=True,
    ),
    UnknownKind(
        "collimation_error",
        "collimation error",
        "l",
        (Component("collimation", "angle", sign="c", column="value"),),
        table=UnknownTable("collimation_errors"),
        default=(0.0,),
        additional=True,
    ),
    UnknownKind(
        "pose",
        "photo",
        "c",
        (*_ATTITUDE, *_xyz()),
        rotates=True,
        motions=datum_motions.of_poses,
        connects=True,
        late=1,
    ),
    UnknownKind(
        "photo_motion",
        "motion of photo",
        "x",
        tuple(
            Component(f"{a}_{'t' * power}", quantity, whole=True, power=power, time="s")
            for power in range(1, HIGHEST_POWER + 1)
            for quantity, axes in _MOVED
            for a in axes
        ),
        short="motion",
        variable_size=True,
        motions=datum_motions.of_photo_motions,
        late=1,
        table=UnknownTable("photo_motions", ("photo",)),
        default=(0.0,) * MOTION,
        absent="default",
        in_photo=True,
        remedy=(
            "the image points of a photo tell its motion only where they fill the rows of the "
            "image and their distances differ: give the motion standard deviations, or tie it to "
            "the neighbouring photos"
        ),
        titles={"de": "Bewegung"},
    ),
    UnknownKind(
        "calibration",
        "calibration of camera",
        "k",
        short="camera",
        variable_size=True,
        late=2,
        additional=True,
    ),
    UnknownKind(
        "frame",
        "frame",
        "f",
        (
            *(replace(c, whole=True) for c in _ATTITUDE),
            *(replace(c, whole=True, planned=0.0) for c in _xyz()),
            Component("ln_scale", largest_error=LARGEST_LN),
        ),
        rotates=True,
        single_turns=True,
        constants=("origin_x", "origin_y", "origin_z", "level"),
        words={
            "rotation": ("rx", "ry", "rz"),
            "offset": ("x", "y", "z"),
            "scale": ("ln_scale",),
        },
        motions=datum_motions.of_frames,
        held_motions=datum_motions.without_held,
        connects=True,
        late=1,
        table=UnknownTable("frames", held_unless_free=True),
    ),
    UnknownKind(
        "mount",
        "mount",
        "m",
        tuple(replace(c, whole=True, start=0.0) for c in (*_ATTITUDE, *_xyz())),
        rotates=True,
        single_turns=True,
        motions=datum_motions.of_mounts,
        late=2,
        table=UnknownTable("mounts", held_unless_free=True),
        default=(0.0,) * 6,
        additional=True,
        reference="given",
        instrument=True,
        remedy=(
            "what all mounts of a rig share cannot be separated from the poses of its carriers: "
            "hold one mount, that of a reference member, or observe the carriers; a member without "
            "observations of its own cannot have a free mount"
        ),
    ),
    UnknownKind(
        "drift",
        "drift",
        "d",
        tuple(
            Component(a + power, "length", power=i)
            for i, power in enumerate(("", "_t", "_tt"))
            for a in "xyz"
        ),
        motions=datum_motions.of_drifts,
        shifts=True,
        late=2,
        table=UnknownTable("drifts", held_unless_free=True),
        default=(0.0,) * 9,
        additional=True,
        remedy=RATES,
    ),
    UnknownKind(
        "attitude_drift",
        "drift of attitudes",
        "a",
        tuple(
            Component(f"r{a}{power}", "angle", power=i)
            for i, power in enumerate(("", "_t"))
            for a in "xyz"
        ),
        motions=datum_motions.of_attitude_drifts,
        late=2,
        table=UnknownTable("attitude_drifts", held_unless_free=True),
        default=(0.0,) * 6,
        additional=True,
        remedy=RATES,
    ),
    UnknownKind(
        "shutter",
        "shutter",
        "t",
        (Component("error", "number", sign="time error (s)", column="error_s", plain=True),),
        late=2,
        table=UnknownTable("shutters"),
        default=(0.0,),
        additional=True,
        instrument=True,
    ),
    UnknownKind(
        "size",
        "size",
        "s",
        (Component("size", "length", np.nan, column="value", whole=True),),
        motions=datum_motions.of_sizes,
        late=1,
        table=UnknownTable("sizes"),
        default=(0.0,),
    ),
    UnknownKind(
        "angle",
        "angle",
        "n",
        (Component("angle", "angle", np.nan, column="value", whole=True),),
        late=1,
        table=UnknownTable("angles"),
    ),
    UnknownKind(
        "level",
        "level surface",
        "w",
        (Component("height", "length", np.nan, column="value", whole=True),),
        short="level",
        motions=datum_motions.of_levels,
        connects=True,
        late=1,
        table=UnknownTable("levels"),
        on_earth=True,
    ),
    UnknownKind(
        "profile",
        "height profile",
        "b",
        (
            Component("height", "length", whole=True),
            Component("height_t", "length", power=1),
            Component("height_tt", "length", power=2),
            Component("scale", "ppm"),
        ),
        short="profile",
        motions=datum_motions.of_profiles,
        connects=True,
        late=2,
        table=UnknownTable("profiles", held_unless_free=True),
        on_earth=True,
        default=(0.0,) * 4,
        additional=True,
        instrument=True,
        remedy=RATES,
    ),
    UnknownKind(
        "gyro",
        "gyrotheodolite",
        "g",
        (Component("constant", "angle", np.nan, sign="E", column="value", planned=0.0),),
        motions=datum_motions.of_orientations,
        connects=True,
        at_stations=True,
        late=1,
        table=UnknownTable("gyros"),
        on_earth=True,
        default=(0.0,),
        additional=True,
        instrument=True,
    ),
    UnknownKind(
        "polynomial",
        "strip polynomial",
        "y",
        tuple(Component(name, "length") for name in COEFFICIENTS),
        short="strip",
        variable_size=True,
        motions=datum_motions.of_polynomials,
        late=2,
        table=UnknownTable("polynomials", held_unless_free=True),
    ),
    UnknownKind(
        "model_deformation",
        "model deformation",
        "h",
        tuple(Component(name, "length") for name in DEFORMATIONS),
        late=2,
        table=UnknownTable("model_deformations", held_unless_free=True),
        default=(0.0,) * len(DEFORMATIONS),
        additional=True,
    ),
)
for _kind in _BUILT_IN:
    register_unknown(_kind)
