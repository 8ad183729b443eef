"""Construction of points, cameras, photos, frames and image points from checked arguments."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..control_characters import refuse_control_characters
from ..entities import ORIGINS, Camera, Origin, Parameter, Photo, Point, parameter, sigmas, triple
from ..errors import InputError, Problem, known, similar, unknown_name
from ..frames import Frame
from ..models.lens import Lens
from ..models.place_lens import PlaceLens
from ..models.rolling_shutter import TOWARDS, Towards
from ..models.unknown_registry import UNKNOWNS, UnknownKind
from ..rotation import nearest_rotation, world_R_camera
from ..types import Array

ROUGH = 5e-4
"""Largest deviation from orthogonality that few digits explain: those of four."""
SINGLE = 1e-6
"""Deviation from orthogonality that is always taken: matrices in single precision have 1e-7."""
ASSUMED_DISTANCE = 1.2
"""Principal distance of a camera of which none is known, parts of the longer side of the image: an
angle of view of 45°."""


def checked_point(
    name: str,
    coordinates: Sequence[float] | None,
    *,
    fixed: str,
    sigma: float | Sequence[float] | None,
    datum: bool,
    check: Sequence[float] | None,
    side_shot: bool = False,
) -> Point:
    """Return a point; arguments and errors are those of `Network.add_point`."""
    where = f"point {name!r}"
    if not isinstance(fixed, str) or not set(fixed) <= set("xyz"):
        raise InputError(Problem(f"fixed must be some of x, y, z, not {fixed!r}", where))
    unknown = (np.nan, np.nan, np.nan)
    xyz = unknown if coordinates is None else triple(coordinates, "coordinates", where)
    held = ("x" in fixed, "y" in fixed, "z" in fixed)
    weights = None if sigma is None else sigmas(sigma, 3, where)
    for i, axis in enumerate("xyz"):
        if np.isnan(xyz[i]) and (held[i] or (weights is not None and weights[i] < np.inf)):
            raise InputError(Problem(f"{axis} is held or weighted but has no value", where))
    return Point(
        name,
        xyz,
        held,
        weights,  # type: ignore[arg-type]
        datum,
        None if check is None else triple(check, "check coordinates", where),
        side_shot,
    )


def checked_camera(
    name: str,
    lens: Lens,
    values: Mapping[str, float] | Sequence[float],
    free: Iterable[str],
    sigma: Mapping[str, float] | None,
    unit: str,
    per_photo: bool,
    format: Sequence[float] | None,
    origin: Origin,
    y_down_in_files: bool,
    readout: float | None,
    readout_towards: Towards,
) -> Camera:
    """Return a camera; arguments and errors are those of `Network.add_camera`."""
    where = f"camera {name!r}"
    if not isinstance(lens, Lens):
        what = f"lens must be a lens model such as BrownLens(), not {lens!r}"
        raise InputError(Problem(what, where))
    names, free = lens.names, set(free)
    weights = dict(sigma or {})
    unknown = [
        n
        for n in (*(values if isinstance(values, Mapping) else ()), *free, *weights)
        if n not in names
    ]
    if unknown:
        raise InputError(
            Problem(
                f"unknown calibration parameter {', '.join(unknown)} of lens model "
                f"{lens.kind!r}; known: {known(names, meant=unknown[0], most=40)}",
                where,
            )
        )
    if isinstance(values, Mapping) and (missing := [n for n in lens.given if n not in values]):
        what = f"lens model {lens.kind!r} needs {known(missing)}: they come with the image"
        raise InputError(Problem(what, where))
    given = [values.get(n, 0.0) for n in names] if isinstance(values, Mapping) else values
    try:
        numbers = [float(v) for v in given]
    except (TypeError, ValueError):
        numbers = []
    known_distance = not isinstance(values, Mapping) or "c" in values
    if numbers and not known_distance and names[0] == "c" and "c" in free and format is not None:
        numbers[0] = ASSUMED_DISTANCE * max(_sides(format, where))
    if len(numbers) != len(names) or not np.all(np.isfinite(numbers)):
        raise InputError(
            Problem(f"values must be {len(names)} finite numbers ({', '.join(names)})", where)
        )
    if not numbers[0] > 0:
        raise InputError(
            Problem(
                f"the principal distance must be positive, not {numbers[0]}; one that is unknown "
                "may be left out if it is free and the format is given",
                where,
            )
        )
    bad = [n for n, s in weights.items() if not s > 0]
    if bad:
        raise InputError(Problem(f"sigma of {', '.join(bad)} must be > 0", where))
    if origin not in ORIGINS:
        raise InputError(Problem(f"unknown origin {origin!r}; valid: {', '.join(ORIGINS)}", where))
    if readout is not None:
        _check_readout(readout, readout_towards, format is not None, where)
    return Camera(
        name,
        lens,
        tuple(numbers),
        tuple(n not in free and n not in weights for n in names),
        tuple(float(weights.get(n, np.inf)) for n in names),
        unit,
        per_photo,
        None if format is None else _sides(format, where),
        origin,
        y_down_in_files,
        None if readout is None else float(readout),
        readout_towards,
    )


def _check_readout(readout: float, towards: Towards, has_format: bool, where: str) -> None:
    """Refuse a readout that gives no times of rows."""
    if not (np.isfinite(readout) and readout > 0):
        what = f"readout must be a time greater than zero, seconds, not {readout}"
        raise InputError(Problem(what, where))
    if towards not in TOWARDS:
        what = f"unknown side {towards!r} of readout_towards; valid: {', '.join(TOWARDS)}"
        raise InputError(Problem(what, where))
    if not has_format:
        what = "a readout time needs the format of the sensor, in which its rows are"
        raise InputError(Problem(what, where))


def _sides(format: Sequence[float], where: str) -> tuple[float, float]:
    """Return the two sides of a sensor.

    Raises:
        InputError: they are not two finite numbers > 0.
    """
    try:
        width, height = (float(side) for side in format)
        right = 0 < width < np.inf and 0 < height < np.inf
    except (TypeError, ValueError):
        right = False
    if not right:
        what = f"format must be width and height, two numbers > 0, not {format!r}"
        raise InputError(Problem(what, where))
    return width, height


def _checked_rotation(matrix: Array, where: str) -> Array:
    """Return the rotation nearest to a matrix, which is orthogonal to the digits that it has.

    Raises:
        InputError: it is none; the message states by how much.
    """
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise InputError(Problem("rotation must be a 3 × 3 rotation matrix", where))
    with np.errstate(over="ignore"):
        off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
        digits = next((k for k in range(1, 15) if np.array_equal(np.round(matrix, k), matrix)), 15)
    # Errors of half a digit in each element: 2 · 3 · 0.5, and a little for their squares.
    if off > max(SINGLE, min(3.5 * 10.0**-digits, ROUGH)):
        what = (
            f"rotation must be a rotation matrix: R Rᵀ differs from the identity by {off:.2g}, "
            f"more than the {digits} decimals of its elements explain"
        )
        raise InputError(Problem(what, where))
    if np.linalg.det(matrix) < 0:
        what = "rotation must be a rotation matrix: its determinant is −1, it mirrors one axis"
        raise InputError(Problem(what, where))
    if off <= 1e-14:  # it stays bit-identical
        return matrix
    return nearest_rotation(matrix)


def checked_photo(
    name: str,
    camera: str,
    *,
    position: Sequence[float] | None,
    omega_phi_kappa: Sequence[float] | None,
    rotation: Array | None,
    fixed: bool | Sequence[bool],
    sigma_position: float | Sequence[float] | None,
    sigma_attitude: float | None,
    lens: Lens,
    frame: Frame,
) -> Photo:
    """Return a photo; arguments and errors are those of `Network.add_photo`.

    Args:
        name: as there, like all that follow.
        camera: name of its camera.
        position: projection centre.
        omega_phi_kappa: attitude.
        rotation: the same as a matrix.
        fixed: held components.
        sigma_position: standard deviations of the centre.
        sigma_attitude: standard deviation of the attitude.
        lens: the lens model of its camera. In parallel projection the coordinate that is nearest
            to the viewing axis is held, unless six flags or ``sigma_position`` are given.
        frame: frame of the network.
    """
    where = f"photo {name!r}"
    at = None if position is None else triple(position, "position", where)
    if at is not None and any(np.isnan(v) for v in at):
        raise InputError(Problem(f"position must be finite or none, not {at}", where))
    if rotation is None and omega_phi_kappa is not None:
        rotation = world_R_camera(*triple(omega_phi_kappa, "omega_phi_kappa", where))
    if rotation is not None:
        rotation = _checked_rotation(np.asarray(rotation, dtype=float), where)
    held = (bool(fixed),) * 6 if isinstance(fixed, bool) else tuple(map(bool, fixed))
    if isinstance(lens, PlaceLens):
        try:
            pose = lens.stated_pose(frame)
        except InputError as error:
            raise InputError(Problem(str(error), where)) from error
        if pose is not None:
            return Photo(name, camera, tuple(pose[0].tolist()), pose[1], (True,) * 6)
        if at is None or rotation is None:
            what = (
                f"lens model {lens.kind!r} has no rays, by which a resection could find a photo: "
                "give its approximate position and attitude"
            )
            raise InputError(Problem(what, where))
        if fixed is False and sigma_position is None:
            held = tuple(i == 3 + axis_along_view(rotation) for i in range(6))
    if len(held) != 6:
        raise InputError(Problem("fixed must be true, false or six flags", where))
    if any(held[:3]) != all(held[:3]):
        raise InputError(
            Problem("hold all three rotations of a photo or none: they do not commute", where)
        )
    weighted = sigma_position is not None or sigma_attitude is not None
    if (any(held) or weighted) and (at is None or rotation is None):
        raise InputError(Problem("a held or weighted photo needs its orientation", where))
    if sigma_attitude is not None and not sigma_attitude > 0:
        raise InputError(Problem("sigma_attitude must be > 0", where))
    return Photo(
        name,
        camera,
        at,
        rotation,
        held,
        None if sigma_position is None else sigmas(sigma_position, 3, where),  # type: ignore[arg-type]
        sigma_attitude,
    )


def axis_along_view(rotation: Array) -> int:
    """Return the number of the coordinate axis that is nearest to the viewing axis of a photo."""
    return int(np.argmax(np.abs(rotation[:, 2])))


def free_components(kind: UnknownKind, free: Iterable[str], where: str) -> list[str]:
    """Return the components that ``free`` lists, by name or by the words of the kind.

    Args:
        kind: record of the kind.
        free: names and words; a text has them separated by blanks, as the tables of projects do.
        where: what is stated, for the message.

    Raises:
        InputError: a name that is neither a component nor a word.
    """
    wanted = free.split() if isinstance(free, str) else list(free)
    valid = [*kind.words, *kind.names()]
    wrong = next((w for w in wanted if w not in valid), None)
    if wrong is not None:
        apart = wrong.replace(",", " ").replace(";", " ").split()
        if len(apart) > 1 and set(apart) <= set(valid):
            asked = f"; write a list of them, or blanks between them: {' '.join(apart)!r}"
        else:
            asked = similar(wrong, valid)
        what = f"free must be some of {', '.join(valid)}, not {wrong!r}{asked}"
        raise InputError(Problem(what, where))
    return list(dict.fromkeys(n for w in wanted for n in kind.words.get(w, (w,))))


def refuse_wrong_parts(
    names: Sequence[str],
    free: Sequence[str],
    values: Mapping[str, float],
    sigma: Mapping[str, float],
    where: str,
) -> None:
    """Refuse components that are none of ``names``, and those that are both free and weighted."""
    unknown = [n for n in (*free, *values, *sigma) if n not in names]
    if unknown:
        what = f"unknown component {unknown[0]!r}; valid: {known(names, meant=unknown[0])}"
        raise InputError(Problem(what, where))
    both = [n for n in free if n in sigma]
    if both:
        raise InputError(Problem(f"{', '.join(both)}: either free or sigma, not both", where))


def checked_frame(
    name: str,
    free: Iterable[str],
    values: Mapping[str, float],
    sigma: Mapping[str, float],
    origin: str | Sequence[float],
    level: bool,
    known_points: Mapping[str, Point],
) -> Parameter:
    """Return a frame; arguments and errors are those of `Network.add_frame`."""
    where, kind = f"frame {name!r}", UNKNOWNS["frame"]
    names, wanted = kind.names(), free_components(kind, free, where)
    refuse_wrong_parts(names, wanted, values, sigma, where)
    station = origin if isinstance(origin, str) else ""
    if station and station not in known_points:
        raise InputError(Problem(unknown_name("point", station, known_points), where))
    at = (0.0, 0.0, 0.0) if isinstance(origin, str) else triple(origin, "origin", where)
    if np.isnan(at).any():
        raise InputError(Problem(f"origin must be finite, not {at}", where))
    found = [n for n in wanted if n != "ln_scale"]
    start = [values.get(n, np.nan if n in found else 0.0) for n in names]
    held = [n for n in names if n not in wanted and n not in sigma]
    stated = parameter(kind, start, held, sigma, where)
    alone = [n for n in names[:3] if n in held]
    if len(alone) == 1 and alone != ["rz"] and "rx" not in sigma:
        what = (
            f"hold two of the rotations rx, ry, rz, or rz alone, not {alone[0]} alone: turns about "
            "the other two axes do not commute, and would turn it too"
        )
        raise InputError(Problem(what, where))
    return replace(stated, constants=(*at, float(level)), origin=station)


def checked_image_points(
    photo: str,
    points: Sequence[str],
    xy: Array,
    *,
    sigma: float | Sequence[float] | Array,
    correlation: float | Array,
    known_points: Mapping[str, int],
) -> tuple[Array, Array, Array]:
    """Return coordinates and σ, (n, 2) each, and correlations (n,) of image points of one photo.

    Arguments and errors are those of `Network.add_image_points`.
    """
    where = f"photo {photo!r}"
    measured = np.array(xy, dtype=float).reshape(-1, 2)
    weights = np.array(np.broadcast_to(np.asarray(sigma, dtype=float), measured.shape))
    rho = np.array(np.broadcast_to(np.asarray(correlation, dtype=float), len(measured)))
    if len(measured) != len(points):
        raise InputError(Problem(f"{len(points)} points but {len(measured)} rows", where))
    problems = [
        Problem(
            unknown_name("point", p, known_points),
            f"image point {photo}/{p}",
        )
        for p in points
        if p not in known_points
    ]
    for bad, what in (
        (~np.isfinite(measured).all(axis=1), "coordinates must be finite numbers"),
        (~(weights > 0).all(axis=1), "sigma must be greater than zero"),
        (~np.isfinite(weights).all(axis=1), "sigma must be a finite number"),
        (~(np.abs(rho) < 1), "correlation must be between −1 and 1"),
    ):
        problems += [
            Problem(what, f"image point {photo}/{points[i]}") for i in np.flatnonzero(bad).tolist()
        ]
    if problems:
        raise InputError(problems)
    return measured, weights, rho


def problems_of_times(
    times: Mapping[str, float], photos: Collection[str], where: str
) -> list[Problem]:
    """Return the photos that are unknown, and those whose time is no finite number."""
    lost = [Problem(unknown_name("photo", f, photos), where) for f in times if f not in photos]
    what = "its time must be a finite number, not {!r}"
    return lost + [
        Problem(what.format(t), f"photo {f!r}") for f, t in times.items() if not np.isfinite(t)
    ]


def refuse_duplicate(name: str, names: Mapping[str, object], what: str) -> None:
    """Refuse a name that is there already, or is none, or has control characters."""
    if not isinstance(name, str) or not name:
        raise InputError(Problem(f"the name of a {what} must be non-empty text, not {name!r}"))
    refuse_control_characters((name,), what)
    if name in names:
        raise InputError(Problem(f"duplicate name of a {what}", f"{what} {name!r}"))


def required(
    name: str, names: Mapping[Any, object], what: str, where: str, advice: str = ""
) -> None:
    """Refuse a name that is not there; ``advice`` follows where no known name is like it."""
    if name not in names:
        unknown = unknown_name(what, name, names)
        raise InputError(Problem(unknown + advice * ("; did you mean" not in unknown), where))
