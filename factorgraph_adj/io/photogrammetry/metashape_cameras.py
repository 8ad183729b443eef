"""Sensors of Metashape as cameras, its cameras as photos with positions; calibrations both ways.

Metashape and PhotoScan distort the ideal coordinates (x, y) of a ray, y down, r² = x² + y²:

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + d_x,   y' = y (1 + …) + d_y

Since PhotoScan 1.3 a calibration has ``<f>``; the principal point counts from the image centre:

    u = w/2 + cx + x' f + x' b1 + y' b2,   v = h/2 + cy + y' f
    d_x = p1 (r² + 2x²) + 2 p2 x y,   d_y = p2 (r² + 2y²) + 2 p1 x y

Before it had ``<fx>`` and ``<fy>``, an absolute principal point, a skew, and p1 and p2 exchanged:

    u = cx + x' fx + y' skew,   v = cy + y' fy
    d_x = p2 (r² + 2x²) + 2 p1 x y,   d_y = p1 (r² + 2y²) + 2 p2 x y
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from ...models.lens import Lens, NormalisedLens
from ...models.normalised_lens import AffineNormalisedLens, RationalLens
from ...models.ray_lens import FisheyeLens
from ...network.network import Network
from ...observations import PhotoPosition
from ...rotation import log_rotation
from ...types import Array
from ..source import Problems, is_unread
from ..xml_files import Element
from .block_source import (
    PHOTOS_SWITCHED_OFF,
    PHOTOS_WITHOUT_POSE,
    add_pixel_camera,
    rotation_and_scale,
)
from .metashape_reference import ChunkContext, chunk_cameras, is_disabled, listed_elements
from .rolling_shutters import ShutterMotions

CURRENT_PARAMETERS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
OLD_PARAMETERS = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
FISHEYE_TYPES = ("fisheye", "equidistant_fisheye")
"""Types whose distortion is applied to θ (x, y)/r, θ = atan r, in place of (x, y)."""
CALIBRATION_TYPES = ("frame", *FISHEYE_TYPES)
UNREAD_CALIBRATION_ELEMENTS = ("resolution", "date")
"""Children of a calibration besides its numbers."""
AFFINITY_PARAMETERS = ("k4", "b1", "b2")
"""Parameters that need the model with an affinity."""
LENS_PARAMETER_NAMES = {
    **{"f": "c", "fx": "c", "fy": "c", "cx": "x0", "cy": "y0", "aspect": "b1", "skew": "b2"},
    **{k: k for k in ("k1", "k2", "k3", "k4", "b1", "b2")},
}
"""Our names of the parameters but p1 and p2, which depend on the version."""
LOST_PARAMETERS: Mapping[type[Lens], tuple[str, ...]] = MappingProxyType(
    {
        Lens: (),
        NormalisedLens: (),
        AffineNormalisedLens: (),
        RationalLens: ("k4", "k5", "k6"),
        FisheyeLens: ("s1", "s2"),
    }
)
"""Lens models that are the same function as one of Metashape's, where these parameters are zero."""
CalibrationUnknowns: TypeAlias = Literal["optimised", "held"] | Sequence[str]
"""Which calibration parameters are unknown."""
MOTION_SIZES = {"rotation": 9, "location": 3, "translation": 3}
"""Numbers of the parts of the motion of a camera during the readout. PlaCamera reads the shift as
``location``, EasyIDP as ``translation``; no public file with one was found."""
JOINED_PARAMETERS = {"cxcy": ["cx", "cy"], "k1k2k3": ["k1", "k2", "k3"], "p1p2": ["p1", "p2"]}
"""Parameters of PhotoScan's flags before 1.2.4 that represent several."""


@dataclass(frozen=True)
class PixelCalibration:
    """A calibration in pixels from the upper left corner, y up."""

    lens: Lens
    """The lens model."""
    values: dict[str, float]
    """Parameters by name."""
    size: tuple[float, float]
    """Width and height of the image, pixels."""
    free: tuple[str, ...]
    """Parameters that are unknown."""


def read_calibration(
    problems: Problems,
    element: Element,
    where: str,
    *,
    size: tuple[float, float],
    free: Collection[str],
) -> PixelCalibration | None:
    """Read a calibration; None after a problem.

    Args:
        problems: where problems go.
        element: the element ``<calibration>``.
        where: file and line.
        size: width and height of the image, pixels.
        free: parameters that are unknown, by Metashape's names.
    """
    kind = element.attributes.get("type", "frame")
    if kind not in CALIBRATION_TYPES:
        types = ", ".join(CALIBRATION_TYPES)
        problems.wrong(f"a calibration of type {kind!r} cannot be read; valid: {types}", where)
        return None
    given = {c.tag: c for c in element.children if c.tag not in UNREAD_CALIBRATION_ELEMENTS}
    old = "f" not in given and ("fx" in given or "fy" in given)
    valid = OLD_PARAMETERS if old else CURRENT_PARAMETERS
    n = problems.count
    value = {}
    for name, child in given.items():
        if name not in valid:
            what = f"unknown parameter <{name}> of a calibration; valid: {', '.join(valid)}"
            problems.wrong(what, where)
            continue
        value[name] = problems.field(child.text, f"<{name}>", where).number()
    for name in ("p3", "p4"):
        if abs(value.get(name, 0.0)) > 0:  # not for NaN, which is a problem already
            problems.wrong(f"<{name}> is {value[name]:g}; this lens model has no {name}", where)
    main = ("fx", "fy") if old else ("f",)
    for name in main:
        if name not in value:
            problems.wrong(f"the calibration has no <{name}>", where)
        elif value[name] <= 0:
            problems.wrong(f"<{name}> must be greater than zero, not {value[name]:g}", where)
    if problems.count > n:
        return None
    p1, p2 = value.get("p1", 0.0), value.get("p2", 0.0)
    out = {k: value.get(k, 0.0) for k in ("k1", "k2", "k3", "k4")}
    if old:
        out |= {"c": value["fy"], "b1": value["fx"] - value["fy"], "b2": -value.get("skew", 0.0)}
        out |= {"x0": value.get("cx", size[0] / 2), "y0": -value.get("cy", size[1] / 2)}
        out |= {"p1": p2, "p2": -p1}
    else:
        out |= {"c": value["f"], "b1": value.get("b1", 0.0), "b2": -value.get("b2", 0.0)}
        out |= {"x0": size[0] / 2 + value.get("cx", 0.0), "y0": -size[1] / 2 - value.get("cy", 0.0)}
        out |= {"p1": p1, "p2": -p2}
    names = LENS_PARAMETER_NAMES | ({"p1": "p2", "p2": "p1"} if old else {"p1": "p1", "p2": "p2"})
    wanted = {names[n] for n in free if n in names}
    if kind in FISHEYE_TYPES:
        out |= {"b1": out["b1"] / out["c"], "b2": out["b2"] / out["c"]}
        fisheye = FisheyeLens()
        values = {n: out.get(n, 0.0) for n in fisheye.names}
        return PixelCalibration(
            fisheye, values, size, tuple(n for n in fisheye.names if n in wanted)
        )
    plain = not any(out[n] or n in wanted for n in AFFINITY_PARAMETERS)
    lens: Lens = NormalisedLens() if plain else AffineNormalisedLens()
    values = {n: out[n] for n in lens.names}
    return PixelCalibration(lens, values, size, tuple(n for n in lens.names if n in wanted))


def sensor_type(lens: Lens) -> str:
    """Return Metashape's type of a sensor with a lens that it has."""
    return FISHEYE_TYPES[0] if type(lens) is FisheyeLens else CALIBRATION_TYPES[0]


def calibration_parameters(
    lens: Lens, values: Mapping[str, float], size: tuple[float, float]
) -> dict[str, float] | None:
    """Return Metashape's parameters of a lens in pixels; None if it has no such parameters.

    Args:
        lens: the lens model.
        values: its parameters by name, from the upper left corner, y up.
        size: width and height of the image, pixels.
    """
    lost = LOST_PARAMETERS.get(type(lens))
    if lost is None or any(values.get(n, 0.0) for n in lost):
        return None
    k = {n: values.get(n, 0.0) for n in AffineNormalisedLens().names}
    if "b1" in lens.names and type(lens) is not AffineNormalisedLens:  # relative to c
        k |= {"b1": k["b1"] * k["c"], "b2": k["b2"] * k["c"]}
    out = {"f": k["c"], "cx": k["x0"] - size[0] / 2, "cy": -k["y0"] - size[1] / 2}
    out |= {"b1": k["b1"], "b2": -k["b2"] if k["b2"] else 0.0}
    out |= {n: k[n] for n in ("k1", "k2", "k3", "k4")}
    out |= {"p1": k["p1"], "p2": -k["p2"] if k["p2"] else 0.0}
    return out


def add_sensors(
    context: ChunkContext,
    network: Network,
    choice: CalibrationUnknowns,
    motions: ShutterMotions,
) -> dict[str, str]:
    """Add the sensors that cameras use; return their names by their ids."""
    chunk, problems = context.source.chunk, context.problems
    out: dict[str, str] = {}
    used = {c.attributes.get("sensor_id", "") for c in chunk_cameras(chunk.element)}
    for sensor in listed_elements(chunk.element, "sensors", "sensor"):
        ident, where = sensor.attributes.get("id", ""), chunk.where(sensor)
        if ident in out:
            problems.wrong(f"sensor {ident!r} is defined twice", where)
        if ident in out or ident not in used:
            continue
        if "master_id" in sensor.attributes:
            problems.wrong("belongs to a rig of several sensors; valid: single sensors", where)
        found = _calibration(context, sensor, where, choice)
        if found is None:
            continue
        label = sensor.attributes.get("label", "") or "camera"
        out[ident] = label if label not in network.cameras else f"{label} ({ident})"
        if _has_rolling_shutter(sensor):
            motions.read_by_row.append(out[ident])
        with problems.collect(where):
            add_pixel_camera(
                network,
                out[ident],
                found.lens,
                found.values,
                size=found.size,
                free=found.free,
            )
    return out


def _has_rolling_shutter(sensor: Element) -> bool:
    """Return whether Metashape models the rolling shutter of a sensor.

    ``rolling_shutter`` tells; without it ``rolling_shutter_flags``, the parameters that it
    estimates (3: *Regularized*, 63: all).
    """
    said = {p.attributes.get("name"): p.attributes.get("value") for p in sensor.all("property")}
    flags = said.get("rolling_shutter_flags", "0")
    return said.get("rolling_shutter", "false" if flags == "0" else "true") in ("true", "1")


def _calibration(
    context: ChunkContext, sensor: Element, where: str, choice: CalibrationUnknowns
) -> PixelCalibration | None:
    """Return the adjusted calibration of a sensor, otherwise the initial one."""
    problems = context.problems
    kind = sensor.attributes.get("type", "frame")
    if kind not in CALIBRATION_TYPES:
        valid = ", ".join(CALIBRATION_TYPES)
        problems.wrong(f"a sensor of type {kind!r} cannot be read; valid: {valid}", where)
        return None
    resolution = sensor.first("resolution")
    if resolution is None:
        problems.wrong("the sensor has no <resolution>", where)
        return None
    size = [
        problems.field(resolution.attributes.get(n), n, where).number(above=0.0)
        for n in ("width", "height")
    ]
    every = list(sensor.all("calibration"))
    adjusted = [c for c in every if c.attributes.get("class") == "adjusted"]
    if not every:
        problems.wrong("the sensor has no <calibration>", where)
    if is_unread(*size) or not every:
        return None
    chosen = (adjusted or every)[0]
    if choice == "optimised":
        free: Sequence[str] = _optimised(context, sensor, adjusted[0] if adjusted else None)
    elif choice == "held":
        free = ()
    else:
        free = choice
    place = context.source.chunk.where(chosen)
    return read_calibration(problems, chosen, place, size=(size[0], size[1]), free=free)


def _optimised(context: ChunkContext, sensor: Element, adjusted: Element | None) -> list[str]:
    """Return the parameters that Metashape optimised, by its names.

    The covariance of the sensor lists them; before Metashape the settings of the last
    optimisation did; otherwise they are those that the adjusted calibration states.
    """
    said = {p.attributes.get("name"): p.attributes.get("value") for p in sensor.all("property")}
    if said.get("fixed") in ("true", "1") or adjusted is None:
        return []
    params = next(listed_elements(sensor, "covariance", "params"), None)
    if params is not None:
        return params.text.split()
    out: list[str] = []
    for p in listed_elements(context.source.chunk.element, "meta", "property"):
        name, value = p.attributes.get("name", ""), p.attributes.get("value", "")
        flag = name.removeprefix("optimize/fit_")
        if flag == "flags":
            out += value.split()
        elif flag != name and value in ("1", "true"):
            out += JOINED_PARAMETERS.get(flag, [flag])
    return out or [c.tag for c in adjusted.children]


def add_cameras(
    context: ChunkContext,
    network: Network,
    sensors: Mapping[str, str],
    motions: ShutterMotions,
    *,
    unaligned: bool,
) -> dict[str, str]:
    """Add photos and observed projection centres; return the names of the photos by their ids."""
    chunk, problems = context.source.chunk, context.problems
    out: dict[str, str] = {}
    ids: set[str] = set()
    for camera in chunk_cameras(chunk.element):
        ident, where = camera.attributes.get("id", ""), chunk.where(camera)
        if ident in ids:
            problems.wrong(f"camera {ident!r} is defined twice", where)
            continue
        ids.add(ident)
        label = camera.attributes.get("label", "") or f"camera {ident}"
        if is_disabled(camera):
            problems.leave_out(PHOTOS_SWITCHED_OFF, label, where)
            continue
        aligned, rotation, centre = _pose(context, camera, where)
        if not (aligned or unaligned):
            problems.leave_out(PHOTOS_WITHOUT_POSE, label, where)
            continue
        sensor = camera.attributes.get("sensor_id", "")
        if sensor not in sensors:
            if not problems.count:
                problems.wrong(f"camera {label!r} has the unknown sensor {sensor!r}", where)
            continue
        position = None if centre is None else centre.tolist()
        with problems.collect(where):
            network.add_photo(label, sensors[sensor], position=position, rotation=rotation)
            out[ident] = label
            _observe_position(context, network, camera, label, where)
            _add_motion(context, camera, label, rotation, motions, where)
    return out


def _add_motion(
    context: ChunkContext,
    camera: Element,
    photo: str,
    rotation: Array | None,
    motions: ShutterMotions,
    where: str,
) -> None:
    """Take the motion of a camera during the readout: a rotation and a location in its axes.

    A ray p in the axes of the pose is seen along Rˢ (p − s t) where s is 0 in the middle row and 1
    in the last one: this is how PlaCamera, an open library, projects with Metashape's motions.
    """
    shutter = camera.first("rolling_shutter")
    if shutter is None or not shutter.children:
        return
    parts = {}
    for child in shutter.children:
        if child.tag not in MOTION_SIZES:
            what = f"unknown element <{child.tag}> of a rolling shutter; valid: "
            context.problems.wrong(what + ", ".join(f"<{n}>" for n in MOTION_SIZES), where)
            return
        found = context.problems.field(child.text.split(), f"<{child.tag}>", where).numbers(
            MOTION_SIZES[child.tag]
        )
        if is_unread(found):
            return
        name = "location" if child.tag == "translation" else child.tag
        if name in parts:
            context.problems.wrong(f"<{child.tag}> states the {name} a second time", where)
            return
        parts[name] = np.array(found)
    turned = rotation_and_scale(parts.get("rotation", np.eye(3)).reshape(3, 3))
    if turned is None or abs(turned[1] - 1.0) > 1e-4:
        context.problems.wrong("<rotation> of a rolling shutter is no rotation", where)
        return
    turn = -log_rotation(turned[0][None])[0]
    placed = context.placed(camera.attributes.get("component_id"))
    shift = np.zeros(3)
    if rotation is not None and placed is not None:
        shift = placed.scale * rotation @ parts.get("location", shift)
    if shift.any() or turn.any():
        motions.add(photo, where, shift, turn)


def _pose(
    context: ChunkContext, camera: Element, where: str
) -> tuple[bool, Array | None, Array | None]:
    """Return whether a camera is aligned, and its rotation and centre in the frame if known."""
    element = camera.first("transform")
    if element is None or not element.text.strip():
        return False, None, None
    found = context.problems.field(element.text, "<transform>", where).numbers(16)
    if is_unread(found):
        return False, None, None
    matrix = np.array(found).reshape(4, 4)
    split = rotation_and_scale(matrix[:3, :3])
    if split is None or np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-9:
        context.problems.wrong("<transform> is no rotation and translation", where)
        return False, None, None
    placed = context.placed(camera.attributes.get("component_id"))
    if placed is None:
        return True, None, None
    centre = placed.points(matrix[None, :3, 3])[0]
    return True, placed.rotation @ split[0], centre


def _observe_position(
    context: ChunkContext, network: Network, camera: Element, photo: str, where: str
) -> None:
    """Observe the projection centre that the reference of a camera states."""
    element = camera.first("reference")
    if element is None or is_disabled(element) or "x" not in element.attributes:
        return
    found = context.given(element, "cameras", where)
    if found is not None:
        at, covariance = found
        network.add(PhotoPosition(photo, at, covariance=covariance, source=where))
