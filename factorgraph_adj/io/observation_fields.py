"""Fields of observations in files, from the records of kinds: columns, σ, defaults, image axes.

The names follow from the records of the kinds, see `factorgraph_adj.observations.registry`; a new
kind needs no change in this module. A project states defaults for fields that records omit: units,
standard deviations, image axes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache, lru_cache
from itertools import product
from typing import Any

import numpy as np

from ..errors import known, similar
from ..models.unknown_registry import Quantity
from ..observations import KINDS, Observation, observation_kind
from ..types import Array
from ..units import ANGLE, LENGTH
from .numbers import Units

NAME_FIELDS = ("station", "target", "target2", "point", "photo")
"""Fields that name points and photos, in the order of the package's own kinds."""
HEIGHT_FIELDS = ("instrument_height", "target_height", "target2_height")
"""Fields of lengths that several kinds share."""
TEXT_FIELDS = ("set", "instrument", "refraction", "axes")
"""Fields of text that several kinds share."""
PART_COLUMNS = {
    "ppm": "ppm",
    "per_sqrt_km": "sqrt_km",
    "centring_instrument": "centring_instrument",
    "centring_target": "centring_target",
    "vertical_instrument": "vertical_instrument",
    "vertical_target": "vertical_target",
}
"""Columns of the parts of a standard deviation, without the endings of their units."""
VECTOR_AXES = tuple("xyzenu")
"""Axes of vectors."""
AXIS_PAIRS = tuple(a + b for axes in ("xyz", "enu") for a, b in product(axes, repeat=2))
"""Pairs of axes in names of covariances."""


@dataclass(frozen=True)
class ImageAxes:
    """Unit, direction of y and default σ of one camera's image coordinates in files."""

    unit: str = "mm"
    """Unit: px or a length."""
    y_down: bool = False
    """Whether y points down in files (pixels from the upper left corner); networks have y up."""
    sigma: Mapping[str, object] = field(default_factory=dict)
    """Fields of the default standard deviation, for records that state none."""


def signs_in_files(axes: Iterable[ImageAxes]) -> Array:
    """Return the signs of x and y in files of each image point, (2n,): −1 where y points down."""
    return np.array([sign for a in axes for sign in (1.0, -1.0 if a.y_down else 1.0)])


@dataclass(frozen=True)
class RecordContext:
    """Defaults of a project for records that do not state these things themselves."""

    units: Units = field(default_factory=Units)
    """Units of values."""
    sigma: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Fields of the default standard deviation by kind, for records that state none."""
    images: Mapping[str, ImageAxes] = field(default_factory=dict)
    """Axes of image coordinates by photo."""
    cameras: Mapping[str, ImageAxes] = field(default_factory=dict)
    """Axes of image coordinates by camera, for photos that are added later."""

    def axes_of(self, photo: str) -> ImageAxes:
        """Return the axes of the image coordinates of a photo."""
        return self.images.get(photo, ImageAxes())


def is_angle(kind: str) -> bool:
    """Return whether the value of a kind is an angle."""
    return observation_kind(kind).unit == "rad"


def is_in_image(kind: str) -> bool:
    """Return whether the value of a kind is in units of a camera, as plain numbers.

    Image coordinates have tables of their own, with a unit in the names of their columns.
    """
    return observation_kind(kind).unit == "image" and kind != "image"


def kind_attributes(kind: str) -> frozenset[str]:
    """Return the names of the attributes of a kind of observation."""
    return observation_kind(kind).attributes


def vector_components(kind: str) -> tuple[str, ...]:
    """Return the columns of a vector, empty for a kind with a single value."""
    record = observation_kind(kind)
    if "covariance" not in record.attributes:
        return ()
    stated = tuple(record.observation.components)
    return stated if len(stated) > 1 else ("x", "y", "z")


def component_pair(a: str, b: str) -> str:
    """Return the name of the covariance of two components: ``xy``, ``roll_pitch``."""
    return a + b if len(a) == len(b) == 1 else f"{a}_{b}"


def has_sigma_parts(kind: str) -> bool:
    """Return whether the standard deviation of a kind may have several parts."""
    return observation_kind(kind).weight is not None


def sigma_parts(kind: str) -> dict[str, str]:
    """Return the parts of a standard deviation that a kind uses, and their columns."""
    weight = observation_kind(kind).weight
    used = () if weight is None else weight.parts
    return {part: column for part, column in PART_COLUMNS.items() if part in used}


def name_fields(kind: str) -> tuple[str, ...]:
    """Return the fields of a kind that name points and photos."""
    own = observation_kind(kind).named
    return (*(n for n in NAME_FIELDS if n in own), *(n for n in own if n not in NAME_FIELDS))


def text_fields(kind: str) -> tuple[str, ...]:
    """Return the fields of a kind that name other unknowns or choose among forms, and ``axes``."""
    record = observation_kind(kind)
    own = (*record.texts, *record.choices, *(("axes",) if "axes" in record.attributes else ()))
    return (*(n for n in TEXT_FIELDS if n in own), *(n for n in own if n not in TEXT_FIELDS))


def number_fields(kind: str) -> dict[str, Quantity]:
    """Return the numbers of a kind besides its value, with their physical quantities.

    A constant of a model is a length unless the metadata of its field states a ``quantity``.
    """
    own = {n: q for n, q in _constants_of(kind).items() if not _is_vector(kind, n)}
    own |= {n: "number" for n in ("condition",) if n in kind_attributes(kind)}
    ordered = [*(n for n in HEIGHT_FIELDS if n in own), *(n for n in own if n not in HEIGHT_FIELDS)]
    return {n: own[n] for n in ordered}


def vector_fields(kind: str) -> dict[str, Quantity]:
    """Return the vectors of a kind besides its value, such as a lever arm, with their quantities.

    Their columns end in x, y, z, see `vector_columns`.
    """
    return {n: q for n, q in _constants_of(kind).items() if _is_vector(kind, n)}


def vector_columns(name: str) -> tuple[str, ...]:
    """Return the columns of a vector: ``lever_arm_x`` …."""
    return tuple(f"{name}_{a}" for a in "xyz")


def _constants_of(kind: str) -> dict[str, Quantity]:
    """Return the fields of a kind that its model takes, with their physical quantities."""
    record = observation_kind(kind)
    stated = _class_quantities(record.observation)  # type: ignore[arg-type]  # classes are hashable
    return {n: stated[n][0] for n in record.constants if n in stated}


def _is_vector(kind: str, name: str) -> bool:
    """Return whether a field holds several numbers; postponed annotations are strings."""
    of_class = observation_kind(kind).observation
    found = _class_quantities(of_class).get(name)  # type: ignore[arg-type]  # classes are hashable
    return found is not None and found[1]


@cache
def _class_quantities(observation: type[Observation]) -> dict[str, tuple[Quantity, bool]]:
    """Return the fields of a class: their physical quantity, and whether they are tuples."""
    return {
        f.name: (f.metadata.get("quantity", "length"), str(f.type).startswith("tuple"))
        for f in fields(observation)
    }


def sigma_units(kind: str) -> tuple[str, ...]:
    """Return the units in which the standard deviation of a kind may be stated."""
    return ("image",) if is_in_image(kind) else tuple(ANGLE) if is_angle(kind) else tuple(LENGTH)


@lru_cache
def sigma_fields(kind: str) -> tuple[str, ...]:
    """Return the fields that can state the standard deviation or covariance of a kind."""
    if kind == "image":
        units: Iterable[str] = ("px", *LENGTH)
        return tuple(f"sigma{axis}_{u}" for axis in ("", "_x", "_y") for u in units)
    units = sigma_units(kind)
    out = [f"sigma_{u}" for u in units]
    for part, column in sigma_parts(kind).items():
        out += ["ppm"] if part == "ppm" else [f"{column}_{u}" for u in LENGTH]
    if "covariance" in kind_attributes(kind):
        sets = (vector_components(kind), "enu") if observation_kind(kind).by_axis else ()
        for names in sets or (vector_components(kind),):
            out += [f"sigma_{a}_{u}" for a in names for u in units]
        for names in sets or (vector_components(kind),):
            pairs = product(names, repeat=2)
            out += [f"covariance_{component_pair(a, b)}_{u}2" for a, b in pairs for u in units]
    return tuple(out)


def combine_fields(kind: str) -> tuple[str, ...]:
    """Return the fields that state how the parts of a standard deviation combine."""
    return ("combine",) if has_sigma_parts(kind) else ()


def placeholder_sigma(kind: str) -> dict[str, object]:
    """Return a valid standard deviation of a kind to replace one that is wrong."""
    units = ("px", "m") if kind == "image" else sigma_units(kind)[:1]
    return {f"sigma_{u}": 1.0 for u in units}


def turn_y(kind: str, axes: ImageAxes, arguments: dict[str, Any]) -> None:
    """Turn y of a vector in an image, where files have y down: its value and its covariance."""
    if axes.y_down:
        sign = np.array([-1.0 if c == "y" else 1.0 for c in vector_components(kind)])
        arguments["value"] = tuple((sign * arguments["value"]).tolist())
        if arguments.get("covariance") is not None:
            arguments["covariance"] = sign[:, None] * arguments["covariance"] * sign


@lru_cache
def plain_fields(kind: str) -> tuple[str, ...]:
    """Return the fields of a kind without those of its standard deviation."""
    have = kind_attributes(kind)
    out = ["kind", "id", *name_fields(kind)]
    if kind == "image":
        return (*out, "x", "y", "correlation")
    out += vector_components(kind) or ["value"]
    out += ["unit", *number_fields(kind), *text_fields(kind)]
    out += ["length_km"] if "length_km" in have else []
    out += [c for name in vector_fields(kind) for c in vector_columns(name)]
    return tuple(out)


def known_fields(kind: str | None = None) -> frozenset[str]:
    """Return every field that records of a kind may have; without ``kind``, of all kinds."""
    return _known_fields((kind,) if kind else tuple(KINDS))


@lru_cache
def _known_fields(kinds: tuple[str, ...]) -> frozenset[str]:
    return frozenset(
        f for k in kinds for f in (*plain_fields(k), *sigma_fields(k), *combine_fields(k), "remark")
    )


def observation_columns() -> tuple[str, ...]:
    """Return the columns of observations.csv in the order in which they are written."""
    further = dict.fromkeys(
        n for k in KINDS for n in (*name_fields(k), *text_fields(k), *number_fields(k))
    )
    known = {*NAME_FIELDS, *TEXT_FIELDS, *HEIGHT_FIELDS}
    own = dict.fromkeys(c for k in KINDS for c in vector_components(k) if c not in VECTOR_AXES)
    stated = dict.fromkeys(f for k in KINDS if k != "image" for f in sigma_fields(k))
    first = dict.fromkeys(
        (
            *(f"sigma{axis}_{u}" for axis in ("", *(f"_{a}" for a in VECTOR_AXES)) for u in LENGTH),
            *(f"sigma_{u}" for u in (*ANGLE, "px")),
        )
    )
    vectors = dict.fromkeys(c for k in KINDS for v in vector_fields(k) for c in vector_columns(v))
    pairs = [f"covariance_{pair}_{u}2" for pair in AXIS_PAIRS for u in LENGTH]
    last = [f for f in stated if f not in first and f.startswith(("sigma_", "covariance_"))]
    return (
        *("kind", "id", *NAME_FIELDS, "value", "x", "y", "z", *own, "unit", "axes"),
        *("set", "instrument", "refraction", *HEIGHT_FIELDS, "length_km"),
        *(n for n in further if n not in known),
        *first,
        *("combine", "ppm"),
        *(f"{c}_{u}" for part, c in PART_COLUMNS.items() if part != "ppm" for u in LENGTH),
        *dict.fromkeys((*pairs, *last)),
        *vectors,
    )


def unknown_field_message(name: str, valid: Iterable[str]) -> str | None:
    """Return the message about an unknown column or key; None if the name is known."""
    names = set(valid)
    if name in names:
        return None
    stem, _, unit = name.rpartition("_")
    units = sorted({n.rpartition("_")[2] for n in names if n.rpartition("_")[0] == stem and stem})
    if stem and len(units) > 1:
        order = [u for u in (*LENGTH, *ANGLE, "px", *(f"{u}2" for u in LENGTH)) if u in units]
        return f"unknown unit {unit!r} in {name!r}; valid: {', '.join(order)}"
    if units := [n.rpartition("_")[2] for n in names if n.rpartition("_")[0] == name]:
        return f"unknown column {name!r}: its unit ends its name{_with_usual_unit(name, units)}"
    if meant := similar(name, names):
        return f"unknown column {name!r}{meant}"
    stems = {n.rpartition("_")[0] for n in names if n.rpartition("_")[2] in (*LENGTH, *ANGLE)}
    short = sorted({n for n in names if n.rpartition("_")[0] not in stems})
    every = [*short, *sorted(s + "_…" for s in stems)]
    return f"unknown column {name!r}; known: {known(every, most=40)}"


def _with_usual_unit(stem: str, units: Collection[str]) -> str:
    """Return which units a column may have, and the column with the usual one."""
    order = [u for u in (*LENGTH, *ANGLE, "px", *(f"{u}2" for u in LENGTH)) if u in units]
    order += sorted(set(units).difference(order))
    small = ("mm", "mm2", "mgon") if stem.startswith(("sigma", "covariance")) else ("m", "gon")
    usual = next((u for u in small if u in order), order[0])
    return f" ({', '.join(order)}); did you mean {f'{stem}_{usual}'!r}?"


def fields_message(kind: str) -> str:
    """Return the fields of a kind for a message, each standard deviation in one unit only."""
    unit = "mgon" if is_angle(kind) else "mm"
    shown = ("_mm", f"_{unit}", "_mm2", "ppm", "_image", "_image2")
    stated = [f for f in sigma_fields(kind) if f.endswith(shown)]
    return ", ".join([*plain_fields(kind), *stated, *combine_fields(kind)])
