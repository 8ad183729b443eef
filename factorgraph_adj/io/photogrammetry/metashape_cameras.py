"""Sensors and cameras of a Metashape chunk as cameras and photos of a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np

from ...network.network import Network
from ...observations import PhotoPosition
from ...types import Array
from ..xml_tree import Element
from .metashape_context import Context, cameras_of, listed, off
from .metashape_lens import TYPES, Calibration, read_calibration
from .pixel import add_pixel_camera
from .reading import PHOTOS_WITHOUT_POSE, SWITCHED_OFF, rotation_of

Choice: TypeAlias = Literal["optimised", "held"] | Sequence[str]
"""Which calibration parameters are unknown."""


def add_sensors(context: Context, network: Network, choice: Choice) -> dict[str, str]:
    """Add the sensors that cameras use; return their names by their ids."""
    chunk, reading = context.source.chunk, context.reading
    out: dict[str, str] = {}
    used = {c.attributes.get("sensor_id", "") for c in cameras_of(chunk.element)}
    for sensor in listed(chunk.element, "sensors", "sensor"):
        ident, where = sensor.attributes.get("id", ""), chunk.where(sensor)
        if ident in out:
            reading.wrong(f"sensor {ident!r} is defined twice", where)
        if ident in out or ident not in used:
            continue
        if "master_id" in sensor.attributes:
            reading.wrong("belongs to a rig of several sensors; valid: single sensors", where)
        found = _calibration(context, sensor, where, choice)
        if found is None:
            continue
        label = sensor.attributes.get("label", "") or "camera"
        out[ident] = label if label not in network.cameras else f"{label} ({ident})"
        with reading.at(where):
            add_pixel_camera(
                network, out[ident], found.lens, found.values, size=found.size, free=found.free
            )
    return out


def _calibration(
    context: Context, sensor: Element, where: str, choice: Choice
) -> Calibration | None:
    """Return the adjusted calibration of a sensor, otherwise the initial one."""
    reading = context.reading
    kind = sensor.attributes.get("type", "frame")
    if kind not in TYPES:
        valid = ", ".join(TYPES)
        reading.wrong(f"a sensor of type {kind!r} cannot be read; valid: {valid}", where)
        return None
    resolution = sensor.first("resolution")
    if resolution is None:
        reading.wrong("the sensor has no <resolution>", where)
        return None
    size = [
        reading.number(resolution.attributes.get(n), n, where, positive=True)
        for n in ("width", "height")
    ]
    every = list(sensor.all("calibration"))
    adjusted = [c for c in every if c.attributes.get("class") == "adjusted"]
    if not every:
        reading.wrong("the sensor has no <calibration>", where)
    if size[0] is None or size[1] is None or not every:
        return None
    chosen = (adjusted or every)[0]
    if choice == "optimised":
        free: Sequence[str] = _optimised(context, sensor, adjusted[0] if adjusted else None)
    elif choice == "held":
        free = ()
    else:
        free = choice
    place = context.source.chunk.where(chosen)
    return read_calibration(reading, chosen, place, size=(size[0], size[1]), free=free)


def _optimised(context: Context, sensor: Element, adjusted: Element | None) -> list[str]:
    """Return the parameters that Metashape optimised, by its names.

    The covariance of the sensor lists them; before Metashape the settings of the last
    optimisation did; otherwise they are those that the adjusted calibration states.
    """
    said = {p.attributes.get("name"): p.attributes.get("value") for p in sensor.all("property")}
    if said.get("fixed") in ("true", "1") or adjusted is None:
        return []
    params = next(listed(sensor, "covariance", "params"), None)
    if params is not None:
        return params.text.split()
    out: list[str] = []
    for p in listed(context.source.chunk.element, "meta", "property"):
        name, value = p.attributes.get("name", ""), p.attributes.get("value", "")
        flag = name.removeprefix("optimize/fit_")
        if flag == "flags":
            out += value.split()
        elif flag != name and value in ("1", "true"):
            out += JOINED.get(flag, [flag])
    return out or [c.tag for c in adjusted.children]


JOINED = {"cxcy": ["cx", "cy"], "k1k2k3": ["k1", "k2", "k3"], "p1p2": ["p1", "p2"]}
"""Parameters of PhotoScan's flags before 1.2.4 that stand for several."""


def add_cameras(
    context: Context, network: Network, sensors: Mapping[str, str], *, unaligned: bool
) -> dict[str, str]:
    """Add photos and observed projection centres; return the names of the photos by their ids."""
    chunk, reading = context.source.chunk, context.reading
    out: dict[str, str] = {}
    ids: set[str] = set()
    for camera in cameras_of(chunk.element):
        ident, where = camera.attributes.get("id", ""), chunk.where(camera)
        if ident in ids:
            reading.wrong(f"camera {ident!r} is defined twice", where)
            continue
        ids.add(ident)
        label = camera.attributes.get("label", "") or f"camera {ident}"
        if off(camera):
            reading.leave_out(SWITCHED_OFF, label, where)
            continue
        aligned, rotation, centre = _pose(context, camera, where)
        if not (aligned or unaligned):
            reading.leave_out(PHOTOS_WITHOUT_POSE, label, where)
            continue
        sensor = camera.attributes.get("sensor_id", "")
        if sensor not in sensors:
            if not reading.problems:
                reading.wrong(f"camera {label!r} has the unknown sensor {sensor!r}", where)
            continue
        position = None if centre is None else centre.tolist()
        with reading.at(where):
            network.add_photo(label, sensors[sensor], position=position, rotation=rotation)
            out[ident] = label
            _observe_position(context, network, camera, label, where)
    return out


def _pose(context: Context, camera: Element, where: str) -> tuple[bool, Array | None, Array | None]:
    """Return whether a camera is aligned, and its rotation and centre in the frame if known."""
    shutter = camera.first("rolling_shutter")
    if shutter is not None and shutter.children:
        context.reading.wrong("has a rolling shutter; valid: photos with one pose", where)
    element = camera.first("transform")
    if element is None or not element.text.strip():
        return False, None, None
    found = context.reading.numbers(element.text.split(), 16, "<transform>", where)
    if found is None:
        return False, None, None
    matrix = np.array(found).reshape(4, 4)
    split = rotation_of(matrix[:3, :3])
    if split is None or np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-9:
        context.reading.wrong("<transform> is no rotation and translation", where)
        return False, None, None
    placed = context.placed(camera.attributes.get("component_id"))
    if placed is None:
        return True, None, None
    centre = placed.points(matrix[None, :3, 3])[0]
    return True, placed.rotation @ split[0], centre


def _observe_position(
    context: Context, network: Network, camera: Element, photo: str, where: str
) -> None:
    """Observe the projection centre that the reference of a camera states."""
    element = camera.first("reference")
    if element is None or off(element) or "x" not in element.attributes:
        return
    found = context.given(element, "cameras", where)
    if found is not None:
        at, covariance = found
        network.add(PhotoPosition(photo, at, covariance=covariance, source=where))
