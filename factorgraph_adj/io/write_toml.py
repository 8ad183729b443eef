"""Writer of the TOML file of a project, as `factorgraph_adj.io.project` reads it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import cast

from ..frames import Frame, GeocentricFrame, LocalFrame
from ..network.entities import Camera
from ..network.network import Network
from . import numbers
from .grid_section import grid_lines
from .numbers import Units


def toml_lines(
    network: Network, units: Units, files: Iterable[str], folder: Path | None = None
) -> Iterator[str]:
    """Return the lines of the TOML file of a project whose tables are ``files``, in a folder."""
    yield f"name = {_text(network.name)}"
    yield f"datum = {_text(network.datum)}"
    yield ""
    yield "[frame]"
    yield from _frame(network.frame, units)
    yield from grid_lines(network.crs, _text, folder)
    yield ""
    yield "[units]"
    for f in fields(Units):
        yield f"{f.name} = {_text(getattr(units, f.name))}"
    yield ""
    yield "[files]"
    for file in files:
        yield f"{file.removesuffix('.csv')} = {_text(file)}"
    for camera in network.cameras.values():
        yield ""
        yield from _camera(camera)


def _frame(frame: Frame, units: Units) -> Iterator[str]:
    if isinstance(frame, LocalFrame):
        yield 'kind = "local"'
        yield f"axes = {_text(frame.axes)}"
        yield f"curvature = {'true' if frame.curvature else 'false'}"
        yield f"radius = {_float(frame.radius)}"
        yield f"origin = [{', '.join(_decimal(v, units.length) for v in frame.origin)}]"
        return
    yield f'kind = "{"geocentric" if isinstance(frame, GeocentricFrame) else "topocentric"}"'
    yield f"ellipsoid = {_text(frame.ellipsoid_name)}"
    yield f"radius = {_float(frame.radius)}"
    if not isinstance(frame, GeocentricFrame):
        yield f"latitude = {_text(numbers.write(frame.latitude, units.geographic))}"
        yield f"longitude = {_text(numbers.write(frame.longitude, units.geographic))}"
        yield f"height = {_decimal(frame.height, units.length)}"


def _decimal(value: float, unit: str) -> str:
    """Return a TOML number, or quoted text if a float cannot hold all digits."""
    text = numbers.write(value, unit)
    return repr(float(text)) if numbers.parse(float(text), unit) == value else _text(text)


def camera_record(camera: Camera) -> dict[str, object]:
    """Return the keys of a camera, a table [[camera]]; a held parameter is written as a number."""
    lens = camera.lens
    options = {f.name: getattr(lens, f.name) for f in fields(lens)}
    options = {k: float(v) if type(v) is int else v for k, v in options.items()}
    out: dict[str, object] = {
        "name": camera.name,
        "lens": {"model": lens.kind, **options} if options else lens.kind,
        "unit": camera.unit,
    }
    if camera.y_down_in_files:
        out["y_axis"] = "down"
    if camera.per_photo:
        out["per_photo"] = True
    if camera.format is not None:
        out |= {"format": list(camera.format), "origin": camera.origin}
    parameters: dict[str, object] = {}
    rows = zip(lens.names, camera.values, camera.fixed, camera.sigma, strict=True)
    for name, value, fixed, sigma in rows:
        value = camera.sign_in_files(name) * value
        if fixed:
            parameters[name] = float(value)
        elif math.isfinite(sigma):
            parameters[name] = {"value": float(value), "sigma": float(sigma)}
        else:
            parameters[name] = {"value": float(value), "free": True}
    return out | {"parameters": parameters}


def _camera(camera: Camera) -> Iterator[str]:
    record = camera_record(camera)
    parameters = cast(dict[str, object], record.pop("parameters"))
    yield "[[camera]]"
    yield from (f"{name} = {value_text(value)}" for name, value in record.items())
    yield "[camera.parameters]"
    yield from (f"{name} = {value_text(value)}" for name, value in parameters.items())


def value_text(value: object) -> str:
    """Return a value as TOML: text, true or false, a number, a list, or an inline table."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {value_text(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(value_text, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    return _text(value) if isinstance(value, str) else _float(cast(float, value))


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _float(value: float) -> str:
    return repr(float(value))
