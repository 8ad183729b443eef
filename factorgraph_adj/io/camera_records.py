"""Cameras of projects and records: lens, calibration, sensor and shutter from their keys."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, cast

from ..entities import ORIGINS, Camera, Origin
from ..errors import InputError, known
from ..models.lens import Lens
from ..models.lens_registry import LENSES
from ..models.rolling_shutter import TOWARDS, Towards
from ..network.network import Network
from ..units import LENGTH
from .csv_tables import FieldRow
from .observation_fields import ImageAxes, placeholder_sigma, sigma_fields

CAMERA_KEYS = (
    "name",
    "lens",
    "unit",
    "y_axis",
    "per_photo",
    "format",
    "origin",
    "readout_s",
    "readout_towards",
    "parameters",
)
"""Keys of a camera, beside the standard deviations of its image coordinates."""


def refuse_other_keys(row: FieldRow, keys: tuple[str, ...]) -> None:
    """Note the keys of a table that are none of those known."""
    for name in row.fields:
        if name not in keys:
            row.wrong(f"unknown key {name!r}; known: {known(keys, meant=name, most=40)}")


def read_camera_record(row: FieldRow, name: str, network: Network) -> ImageAxes:
    """Add a camera, or a stand-in for a camera with problems.

    Args:
        row: keys of the camera, from a table [[camera]] or a record; problems are noted here.
        name: name of the camera.
        network: the network to which the camera is added.

    Returns:
        The axes of its image coordinates in files.
    """
    unit = row.choice("unit", ("px", *LENGTH), "mm")
    y_down = row.choice("y_axis", ("up", "down"), "up") == "down"
    sigma = {k: v for k, v in row.fields.items() if k in sigma_fields("image")}
    refuse_other_keys(row, (*CAMERA_KEYS, *sigma_fields("image")))
    check_positive(row, sigma)
    axes = ImageAxes(unit, y_down, placeholder_sigma("image") if row.failed else sigma)
    lens = _lens(row)
    values, free, weights = _parameters(row, y_down)
    per_photo = row.flag("per_photo")
    sides, origin = _format(row, y_down)
    readout, towards = _readout(row, sides is not None)
    if not row.failed:
        try:
            network.add_camera(
                name,
                lens,
                values,
                free=free,
                sigma=weights,
                unit=unit,
                per_photo=per_photo,
                format=sides,
                origin=origin,
                y_down_in_files=y_down,
                readout=readout,
                readout_towards=towards,
            )
        except InputError as error:
            row.wrong_all(error)
    if name not in network.cameras:
        n = len(lens.names)
        network.cameras[name] = Camera(
            name,
            lens,
            (1.0,) * n,
            (True,) * n,
            (float("inf"),) * n,
            unit,
            format=sides or (1.0, 1.0),
            readout=readout,
        )
    return axes


def _format(row: FieldRow, y_down: bool) -> tuple[tuple[float, float] | None, Origin]:
    """Return width and height of the sensor, and where the image coordinates have their origin."""
    given = row.take("format")
    usual: Origin = "upper left" if y_down else "centre"
    if given is None:
        if "origin" in row:
            row.wrong("origin says where on the sensor x = y = 0 is: it needs format")
        return None, "centre"
    if not (isinstance(given, list) and len(given) == 2):
        row.wrong(f"format must be [width, height] in the unit of the camera, not {given!r}")
        return None, "centre"
    found = {"width": given[0], "height": given[1]}
    inside = FieldRow(found, row.where, row.problems, f"{row.of} format")
    sides = [inside.number(n, required=True, positive=True) or 1.0 for n in ("width", "height")]
    origin = cast(Origin, row.choice("origin", ORIGINS, usual))
    return (sides[0], sides[1]), origin


def _readout(row: FieldRow, has_format: bool) -> tuple[float | None, Towards]:
    """Return the readout time of a rolling shutter, seconds, and the side to which it proceeds."""
    readout = row.number("readout_s", positive=True)
    if "readout_towards" in row and "readout_s" not in row:
        row.wrong("readout_towards says how rows follow each other: it needs readout_s")
    elif readout is not None and not has_format:
        row.wrong("readout_s is the time from the first to the last row: it needs format")
    return readout, cast(Towards, row.choice("readout_towards", TOWARDS, "down"))


def _lens(row: FieldRow, key: str = "lens") -> Lens:
    """Return the lens model: a name, or a table with ``model`` and its options."""
    given = row.take(key)
    table = {"model": given} if isinstance(given, str) else given
    if not isinstance(table, dict):
        table = {} if table is None else {"model": table}
    inside = FieldRow(table, row.where, row.problems, f"{row.of} {key}")
    cls = LENSES[inside.choice("model", LENSES, "none")]
    options = {f.name: f.type for f in fields(cls)}
    if inside.failed:
        return cls()
    refuse_other_keys(inside, ("model", *options))
    chosen: dict[str, Any] = {}
    for name, kind in options.items():
        if name in inside:
            chosen[name] = READ_OPTION.get(str(kind), FieldRow.text)(inside, name)
    if any(value is None for value in chosen.values()):  # its problem is noted
        return cls()
    try:
        return cls(**chosen)
    except InputError as error:
        inside.wrong_all(error)
        return cls()


def _numbers(row: FieldRow, name: str) -> tuple[float, ...] | None:
    """Return a list of finite numbers."""
    given = row.take(name)
    found = _finite(given)
    if found is None:
        row.wrong(f"{name} must be a list of numbers")
    return found


def _rows_of_numbers(row: FieldRow, name: str) -> tuple[tuple[float, ...], ...] | None:
    """Return a list of lists of finite numbers."""
    given = row.take(name)
    found = [_finite(each) for each in given] if isinstance(given, list | tuple) else [None]
    if any(each is None for each in found):
        row.wrong(f"{name} must be a list of rows, each a list of numbers")
        return None
    return tuple(each for each in found if each is not None)


def _finite(given: object) -> tuple[float, ...] | None:
    """Return finite numbers; None if something else is given."""
    if not isinstance(given, list | tuple):
        return None
    good = all(type(v) in (int, float) and math.isfinite(v) for v in given)
    return tuple(float(v) for v in given) if good else None


READ_OPTION: dict[str, Callable[[FieldRow, str], Any]] = {
    "float": FieldRow.number,
    "Lens": _lens,
    "tuple[float, ...]": _numbers,
    "tuple[tuple[float, ...], ...]": _rows_of_numbers,
}
"""How options of lens models are read, by their type; others are texts."""


def _parameters(
    row: FieldRow, y_down: bool
) -> tuple[dict[str, float], list[str], dict[str, float]]:
    """Return values, free names, standard deviations; y0 changes its sign where y points down."""
    table = row.take("parameters", required=True)
    if not isinstance(table, dict):
        if table is not None:
            row.wrong("parameters must be a table such as c = { value = 100.0, free = true }")
        return {"c": 1.0}, [], {}
    values: dict[str, float] = {}
    free: list[str] = []
    weights: dict[str, float] = {}
    for name, given in table.items():
        entry = given if isinstance(given, dict) else {"value": given}
        inside = FieldRow(entry, row.where, row.problems, f"{row.of} parameter {name}")
        refuse_other_keys(inside, ("value", "free", "sigma"))
        unknown = name == "c" and bool(entry.get("free"))  # it is searched for
        value = inside.number("value", required=not unknown)
        sigma = inside.number("sigma", positive=True)
        if value is not None or not unknown:
            values[name] = 0.0 if value is None else value
        if y_down and name == "y0":
            values[name] = -values[name]
        if sigma is not None:
            weights[name] = sigma
            if inside.flag("free"):
                inside.wrong("either free or sigma, not both")
        elif inside.flag("free"):
            free.append(name)
    return values, free, weights


def check_positive(row: FieldRow, sigma: Mapping[str, object]) -> None:
    """Note standard deviations of a default that are not numbers > 0."""
    for name in sigma:
        row.number(name, positive=True)
