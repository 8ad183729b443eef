"""Observations from and to records of text, as in tables and JSON: names, values, σ, covariances.

The fields are the columns of ``observations.csv`` and ``images.csv``, and the keys of JSON
Lines. A record fills the fields of its kind:

- ``kind``, ``id``, and the names ``station``, ``target``, ``target2``, ``point``, ``photo``;
- ``value``, or ``x``, ``y``, ``z`` of vectors and positions, in ``unit`` or the project's;
- σ with its unit in the name: ``sigma_mm``, ``sigma_mgon``, ``sigma_x_mm`` …, and the parts
  ``ppm``, ``sqrt_km_mm``, ``centring_instrument_mm``, ``centring_target_mm``; or covariances
  ``covariance_xy_mm2`` …;
- the other fields of the dataclass of its kind: ``set``, ``instrument``, ``instrument_height`` ….
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, cast

import numpy as np

from ..errors import InputError, Problem, known
from ..models.unknown_registry import Quantity
from ..observations import KINDS, ImagePoint, Observation
from ..observations.registry import IN_MEMORY
from ..stochastic_model import COMBINATIONS, Combine, StandardDeviation
from ..types import Array
from ..units import ANGLE, LENGTH
from . import numbers
from .covariance_tables import image_correlation
from .csv_tables import FieldRow
from .numbers import Units
from .observation_fields import (
    NAME_FIELDS,
    ImageAxes,
    RecordContext,
    combine_fields,
    component_pair,
    fields_message,
    is_angle,
    is_in_image,
    kind_attributes,
    known_fields,
    name_fields,
    number_fields,
    sigma_fields,
    sigma_parts,
    sigma_units,
    text_fields,
    turn_y,
    unknown_field_message,
    vector_columns,
    vector_components,
    vector_fields,
)

NO_PARTS = StandardDeviation(1.0)
"""A constant standard deviation, whose other parts are not stated."""


def record_with_reading(record: Mapping[str, object]) -> dict[str, object]:
    """Return a record with zero for a missing reading, as plans need no readings."""
    kind = record.get("kind")
    names: tuple[str, ...] = ("x", "y") if kind == "image" else ("value",)
    if isinstance(kind, str) and kind in KINDS:
        names = vector_components(kind) or names
    return {**dict.fromkeys(names, 0.0), **record}


# -- record → observation -------------------------------------------------------------------------


def observation_from_record(
    record: Mapping[str, object], *, context: RecordContext | None = None, source: str = "record"
) -> Observation:
    """Return the observation that a record describes.

    Args:
        record: the fields, text or numbers; empty ones and None count as absent.
        context: defaults of the project.
        source: place of the record, for messages: file:line; may be empty.

    Raises:
        InputError: all problems of the record: unknown kind or field, missing field, unreadable
            number, σ ≤ 0, no σ, bad covariance, station and target are the same point.
    """
    problems: list[Problem] = []
    context = context or RecordContext()
    row = FieldRow(record, source, problems)
    kind = row.text("kind", required=True)
    row.of = record_label(record) if kind is not None else ""
    if kind == "kind":
        row.wrong("this row is the header again: remove it")
    elif kind is not None and kind not in KINDS:
        row.wrong(f"unknown kind {kind!r}; valid: {known(KINDS, meant=kind, most=80)}")
    if row.failed or kind is None:
        raise InputError(problems)
    cls = KINDS[kind].observation
    arguments: dict[str, Any] = {"id": row.text("id"), "source": source or None}
    for name in name_fields(kind):
        arguments[name] = row.text(name, required=name not in KINDS[kind].may_lack)
    if cls is ImagePoint:
        _take_image(row, context, arguments)
    else:
        _take_values(row, kind, context, arguments)
    own = known_fields(kind)
    for name in row.left():
        if name in own and not row.failed:
            row.wrong(f"{name} has no use here")
        elif name in own:
            continue  # the field that it belongs to was wrong
        elif unknown_field_message(name, known_fields()) is None:
            row.wrong(f"{name} does not apply to {kind}; it takes: {fields_message(kind)}")
        else:
            row.wrong(str(unknown_field_message(name, own)))
    found = None
    try:
        # After a problem, a stand-in shows further problems that the class finds.
        found = placeholder_observation(record, source=source) if problems else cls(**arguments)
    except InputError as error:
        row.wrong_all(error)
    if problems or found is None:
        raise InputError(problems)
    return found


def placeholder_observation(
    record: Mapping[str, object], *, source: str = "record"
) -> Observation | None:
    """Return an observation with the names of a record and invented numbers.

    The stand-in replaces a record with bad numbers in checks of the structure; None if kind or
    names are missing.

    Raises:
        InputError: the names themselves are wrong, such as the same point as station and target.
    """
    kind = record.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        return None
    names = name_fields(kind)
    arguments: dict[str, Any] = {
        n: str(record[n])
        for n in (*names, *KINDS[kind].texts, *KINDS[kind].choices)
        if record.get(n)
    }
    record_of_kind = KINDS[kind]
    needed = [n for n in names if n not in record_of_kind.may_lack]
    texts = (*record_of_kind.texts, *record_of_kind.choices)
    needed += [n for n in texts if n not in record_of_kind.optional]
    if any(n not in arguments for n in needed):
        return None
    arguments |= {n: None for n in names if n not in arguments}
    arguments |= {
        n: (1.0, 0.0, 0.0) for n in vector_fields(kind) if n not in record_of_kind.optional
    }
    size = len(vector_components(kind))
    if kind == "image":
        arguments |= {"x": 0.0, "y": 0.0}
    else:
        # Components of a unit vector must be below 1.
        arguments["value"] = (0.5,) * size if size else 0.5
        required = (n for n in number_fields(kind) if n not in record_of_kind.optional)
        arguments |= dict.fromkeys(required, 1.0)
    arguments["sigma"] = (1.0,) * size if size else 1.0
    make: Callable[..., Observation] = record_of_kind.observation
    arguments |= dict.fromkeys(
        sorted(record_of_kind.attributes - record_of_kind.optional - {*arguments}), 0.0
    )
    return make(**arguments, source=source or None)


def _reading(row: FieldRow, name: str, unit: str, optional: frozenset[str]) -> float | None:
    """Return the observed value in a field, which is 0 if the kind has a default for values."""
    found = row.number(name, unit, required="value" not in optional)
    return 0.0 if found is None and name not in row and "value" in optional else found


def _project_unit(quantity: Quantity, units: Units) -> str:
    """Return the project's unit for a number without a unit of its own."""
    return {"length": units.length, "angle": units.angle, "ppm": "ppm"}.get(quantity, "")


def record_label(record: Mapping[str, object]) -> str:
    """Return a readable name of a record: kind, points and id."""
    kind = record.get("kind")
    there = isinstance(kind, str) and kind in KINDS
    own = name_fields(str(kind)) if there else ()
    frames = KINDS[str(kind)].frames if there else ()
    names = (*frames, *NAME_FIELDS, *(n for n in own if n not in NAME_FIELDS))
    parts = [str(record[n]) for n in ("kind", *names) if record.get(n) not in (None, "")]
    ident = record.get("id")
    return " ".join(parts) + (f" (id {ident})" if ident not in (None, "") else "")


def _take_values(
    row: FieldRow, kind: str, context: RecordContext, arguments: dict[str, Any]
) -> None:
    units, have = context.units, kind_attributes(kind)
    angle = is_angle(kind)
    unit = row.choice(
        "unit",
        numbers.ANGLE_UNITS if angle else LENGTH,
        units.angle if angle else units.length,
    )
    optional = KINDS[kind].optional
    for name, quantity in number_fields(kind).items():
        found = row.number(name, _project_unit(quantity, units), required=name not in optional)
        if found is not None:
            arguments[name] = found
    for name in (*KINDS[kind].texts, *KINDS[kind].choices):
        if name in row or name not in optional:
            arguments[name] = row.text(name, required=name not in optional)
    if "length_km" in have:
        arguments["length_km"] = row.number("length_km", positive=True)
    for name, quantity in vector_fields(kind).items():
        own = vector_columns(name)
        if name not in optional or any(n in row for n in own):
            # Lengths beside a length have its unit.
            of = unit if quantity == "length" and not angle else _project_unit(quantity, units)
            arguments[name] = tuple(row.number(n, of, required=True) for n in own)
    if "covariance" not in have:
        unit = "" if is_in_image(kind) else unit
        arguments["value"] = _reading(row, "value", unit, optional)
        place = f"[sigma.{kind}] of the project"
        arguments["sigma"] = scalar_sigma(row, kind, context.sigma.get(kind, {}), place)
        return
    names = vector_components(kind)
    if "axes" in have:
        axes = "".join(row.letters("axes", "xyzenu")) or KINDS[kind].defaults["axes"]
        names, arguments["axes"] = tuple(axes), axes
    whole = bool(set(names) & set("enu"))
    unit = "" if is_in_image(kind) else unit
    arguments["value"] = tuple(
        _reading(row, a, unit, optional) for a in ("xyz" if whole else names)
    )
    _take_vector_sigma(row, kind, names, context, arguments)
    if is_in_image(kind) and not row.failed:
        turn_y(kind, context.images.get(arguments["photo"], ImageAxes()), arguments)


def _sigma_row(
    row: FieldRow, kind: str, default: Mapping[str, object], place: str
) -> FieldRow | None:
    """Return the row that states the standard deviation: the row itself, or the default row."""
    if any(f in row for f in sigma_fields(kind)):
        return row
    own = FieldRow(default, row.where, row.problems, row.of)
    if any(f in own for f in sigma_fields(kind)):
        return own
    unit = "mgon (or another unit)" if is_angle(kind) else "mm (or another unit)"
    unit = "image" if is_in_image(kind) else unit
    row.wrong(f"no standard deviation: give sigma_{unit} here or in {place}")
    return None


def scalar_sigma(
    row: FieldRow, kind: str, default: Mapping[str, object], place: str
) -> float | StandardDeviation | None:
    """Return a scalar standard deviation with one or several parts; None after a problem.

    Args:
        row: the row of the observation, which may state it; problems are noted there.
        kind: kind of the observation.
        default: standard deviation of rows that state none.
        place: where the default is stated, for the message that there is none.
    """
    stated = _sigma_row(row, kind, default, place)
    if stated is None:
        return None
    parts = {}
    for part, column in sigma_parts(kind).items():
        value = stated.number("ppm") if part == "ppm" else stated.quantity(column, LENGTH)
        if value is not None and value < 0:
            row.wrong(f"{column} must not be negative")
        elif value is not None:
            parts[part] = value
    combine = stated.choice("combine", COMBINATIONS, "mixed") if combine_fields(kind) else "mixed"
    if is_in_image(kind):
        return stated.number("sigma_image", positive=True)
    constant = stated.quantity("sigma", ANGLE if is_angle(kind) else LENGTH)
    if constant is not None and (constant < 0 or (constant == 0 and not any(parts.values()))):
        found = stated.present("sigma", ANGLE if is_angle(kind) else LENGTH)
        name = found[0] if found else "sigma"
        row.wrong(f"{name} must be greater than zero, not {stated.fields.get(name)}")
        return None
    if row.failed:
        return None
    if any(parts.values()):
        return StandardDeviation(constant or 0.0, **parts, combine=cast(Combine, combine))
    if constant is None:
        row.wrong("the standard deviation is zero: all its parts are")
    return constant


def _take_vector_sigma(
    row: FieldRow,
    kind: str,
    axes: tuple[str, ...],
    context: RecordContext,
    arguments: dict[str, Any],
) -> None:
    """Read σ of each component, or a covariance."""
    stated = _sigma_row(row, kind, context.sigma.get(kind, {}), f"[sigma.{kind}] of the project")
    if stated is None:
        return
    units = sigma_units(kind)
    if any(f.startswith("covariance_") for f in stated.fields):
        arguments["covariance"] = _take_covariance(stated, axes, units)
        return
    for_all = stated.quantity("sigma", units, positive=True)
    sigma = [stated.quantity(f"sigma_{a}", units, positive=True) for a in axes]
    shown = "image" if is_in_image(kind) else "mgon" if is_angle(kind) else "mm"
    for a, s in zip(axes, sigma, strict=True):
        if s is None and for_all is None and not row.failed:
            other = "xyz" if set(axes) <= set("enu") else "enu"
            given = [f for f in stated.fields if f.startswith(tuple(f"sigma_{b}_" for b in other))]
            belongs = f"; {given[0]} belongs to axes {other}: state axes = {other}" if given else ""
            row.wrong(
                f"no standard deviation of {a}: give sigma_{a}_{shown} or sigma_{shown}{belongs}"
            )
    if not row.failed:
        arguments["sigma"] = tuple(for_all if s is None else s for s in sigma)


def _take_covariance(row: FieldRow, axes: tuple[str, ...], units: tuple[str, ...]) -> Array:
    size = len(axes)
    out = np.zeros((size, size))
    squared = [f"{u}2" for u in units]
    shown = next((u for u in squared if u in ("mgon2", "mm2")), squared[0])
    for i, j in product(range(size), repeat=2):
        name, mirrored = component_pair(axes[i], axes[j]), component_pair(axes[j], axes[i])
        value = row.quantity(f"covariance_{name}", squared)
        if value is None and i != j and row.present(f"covariance_{name}", squared) is None:
            value = row.quantity(f"covariance_{mirrored}", squared)
        if i == j and row.present(f"covariance_{name}", squared) is None:
            row.wrong(f"the variance covariance_{name}_{shown} is missing")
        out[i, j] = value or 0.0
    return out


def _take_image(row: FieldRow, context: RecordContext, arguments: dict[str, Any]) -> None:
    axes = context.axes_of(arguments["photo"] or "")
    arguments |= {name: row.number(name, required=True) for name in ("x", "y")}
    arguments["correlation"] = image_correlation(row, axes)
    if axes.y_down and arguments["y"] is not None:
        arguments["y"] = -arguments["y"]
    arguments["sigma"] = image_sigma(row, axes, context.sigma.get("image", {}))


def image_sigma(
    row: FieldRow, axes: ImageAxes, default: Mapping[str, object]
) -> tuple[float, float] | None:
    """Return σ of x and y in units of the camera; on failure note a problem and return None."""
    place = "the camera or [sigma.image] of the project"
    stated = _sigma_row(row, "image", {**(axes.sigma or default)}, place)
    if stated is None:
        return None
    units = ("px",) if axes.unit == "px" else tuple(LENGTH)
    for_all = _image_quantity(stated, "sigma", axes.unit, units)
    sigma = [_image_quantity(stated, f"sigma_{a}", axes.unit, units) for a in "xy"]
    x, y = (for_all if s is None else s for s in sigma)
    if x is None or y is None:
        if not row.failed:
            valid = ", ".join(f"sigma_{u}" for u in units)
            row.wrong(f"no standard deviation in a unit of the camera ({axes.unit}): give {valid}")
        return None
    return x, y


def _image_quantity(row: FieldRow, prefix: str, unit: str, units: tuple[str, ...]) -> float | None:
    """Return a standard deviation in the unit of the camera, exactly as written."""
    found = row.present(prefix, units)
    if found is None:
        return None
    value = row.number(found[0], found[1], positive=True)
    if value is None or unit == "px":
        return value
    if found[1] == unit:
        return numbers.parse_quantity(row.fields[found[0]])
    return float(numbers.write_quantity(value, unit))


# -- observation → record -------------------------------------------------------------------------


def observation_record(
    found: Observation,
    *,
    id: str | None = None,
    units: Units | None = None,
    axes: ImageAxes | None = None,
) -> dict[str, str]:
    """Return the record of an observation; `observation` reads it back to the bit.

    Args:
        found: the observation.
        id: name in the network, for an observation without its own id.
        units: units of the record.
        axes: unit and direction of y in files, for image coordinates.
    """
    if found.kind in IN_MEMORY:
        what = (
            f"no file can hold a {found.kind}: leave it out (fga.without), or register what it "
            "observes as a kind of observation (register_observation)"
        )
        raise InputError(Problem(what, found.label()))
    units, given = units or Units(), cast(Any, found)
    kind, have = found.kind, kind_attributes(found.kind)
    out = {"kind": kind, "id": given.id or id or ""}
    for name in (*name_fields(kind), *text_fields(kind)):
        out[name] = getattr(found, name) or ""
    if isinstance(found, ImagePoint):
        return out | _image_record(found, axes or ImageAxes())
    unit = "" if is_in_image(kind) else units.angle if is_angle(kind) else units.length
    for name, quantity in number_fields(kind).items():
        number = getattr(found, name)
        default = KINDS[kind].defaults.get(name)
        if default is None or repr(float(number)) != repr(float(default)):
            out[name] = numbers.write_quantity(float(number), _project_unit(quantity, units))
    if "length_km" in have and given.length_km is not None:
        out["length_km"] = numbers.write_quantity(given.length_km)
    for name, quantity in vector_fields(kind).items():
        vector = getattr(found, name)
        if name not in KINDS[kind].optional or any(vector):
            beside = quantity == "length" and not is_angle(kind)
            size = unit if beside else _project_unit(quantity, units)
            each = zip(vector_columns(name), vector, strict=True)
            out |= {n: numbers.write_quantity(v, size) for n, v in each}
    if "covariance" not in have:
        out["value"] = numbers.write_quantity(given.value, unit)
        return out | _sigma_record(given.sigma, kind, units)
    names = tuple(given.axes) if "axes" in have else vector_components(kind)
    of = vector_components(kind) if set(names) & set("enu") else names
    turned = {"value": given.value, "covariance": given.covariance}
    if is_in_image(kind):
        turn_y(kind, axes or ImageAxes(), turned)
    out |= {a: numbers.write_quantity(v, unit) for a, v in zip(of, turned["value"], strict=True)}
    return out | _vector_sigma_record(kind, given.sigma, turned["covariance"], names, units)


def _sigma_record(sigma: float | StandardDeviation, kind: str, units: Units) -> dict[str, str]:
    unit = units.sigma_angle if is_angle(kind) else units.sigma_length
    if is_in_image(kind):
        return {"sigma_image": numbers.write_quantity(float(cast(float, sigma)))}
    if not isinstance(sigma, StandardDeviation):
        return {f"sigma_{unit}": numbers.write_quantity(sigma, unit)}
    out = {}
    if sigma.constant > 0:
        out[f"sigma_{unit}"] = numbers.write_quantity(sigma.constant, unit)
    if sigma.combine != "mixed":
        out["combine"] = sigma.combine
    for part, column in sigma_parts(kind).items():
        value = getattr(sigma, part)
        if value == getattr(NO_PARTS, part):  # 0 is a height that is known exactly
            continue
        if part == "ppm":
            out[column] = numbers.write_quantity(value)
        else:
            out[f"{column}_{units.sigma_length}"] = numbers.write_quantity(
                value, units.sigma_length
            )
    return out


def _vector_sigma_record(
    kind: str,
    sigma: Sequence[float] | None,
    covariance: Array | None,
    axes: tuple[str, ...],
    units: Units,
) -> dict[str, str]:
    unit = units.sigma_angle if is_angle(kind) else units.sigma_length
    unit = "image" if is_in_image(kind) else unit
    if sigma is not None:
        if len(set(sigma)) == 1:
            return {f"sigma_{unit}": numbers.write_quantity(sigma[0], unit)}
        by_axis = zip(axes, sigma, strict=True)
        return {f"sigma_{a}_{unit}": numbers.write_quantity(s, unit) for a, s in by_axis}
    covariance = np.asarray(covariance, dtype=float)
    out = {}
    for i, j in product(range(len(axes)), repeat=2):
        if j >= i or covariance[i, j] != covariance[j, i]:
            name = f"covariance_{component_pair(axes[i], axes[j])}_{unit}2"
            out[name] = numbers.write_quantity(float(covariance[i, j]), f"{unit}2")
    return out


def _image_record(found: ImagePoint, axes: ImageAxes) -> dict[str, str]:
    sx, sy = found.sigma if isinstance(found.sigma, tuple) else (found.sigma,) * 2
    y = -found.y if axes.y_down else found.y
    out = {"x": numbers.write_quantity(found.x), "y": numbers.write_quantity(y)}
    if rho := -found.correlation if axes.y_down else found.correlation:
        out["correlation"] = numbers.write_quantity(rho)
    if sx == sy:
        return out | {f"sigma_{axes.unit}": numbers.write_quantity(sx)}
    return out | {
        f"sigma_x_{axes.unit}": numbers.write_quantity(sx),
        f"sigma_y_{axes.unit}": numbers.write_quantity(sy),
    }
