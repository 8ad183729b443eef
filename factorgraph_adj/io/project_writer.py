"""Writer of projects, TOML and CSV tables: a project read again is the same network to the bit."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import fields
from decimal import Decimal
from pathlib import Path
from typing import cast

import numpy as np

from ..control_characters import problems_of_names
from ..entities import Camera, Photo, Point, parameter_key
from ..errors import InputError, Problem, taking
from ..frames import Frame, GeocentricFrame, LocalFrame
from ..models.lens import Lens
from ..models.unknown_registry import UnknownKind, parameter_kinds
from ..network.network import Network
from ..rotation import TURN_ABOUT_X, omega_phi_kappa, world_R_camera
from ..types import Array
from ..units import LENGTH
from . import numbers, observation_records
from .covariance_tables import COVARIANCE_COLUMNS, covariance_records
from .crs_section import crs_section_lines
from .csv_tables import write_table
from .file_transaction import write_files
from .numbers import Units
from .observation_fields import (
    ImageAxes,
    combine_fields,
    observation_columns,
    sigma_fields,
)
from .observation_tables import DOUBT_COLUMNS, IMAGE_COLUMNS
from .parameter_tables import parameter_columns, parameter_records, parameter_table
from .unknowns_tables import (
    ATTITUDE_COLUMNS,
    CHECK_COLUMNS,
    PHOTO_COLUMNS,
    POINT_COLUMNS,
    POSE_PARTS,
    POSE_WORDS,
    ROTATION_COLUMNS,
)

Records = Iterator[dict[str, str]]


MIN_COMMON_SHARE = 0.5
"""Least share of the rows of a kind that state one σ, which then stands in [sigma.KIND]."""
Sigmas = dict[str, dict[str, str]]
"""Fields of standard deviations by kind of observation."""


def project_toml_lines(
    network: Network,
    units: Units,
    files: Iterable[str],
    folder: Path | None = None,
    *,
    sigmas: Sigmas | None = None,
    heading: Iterable[str] = (),
) -> Iterator[str]:
    """Return the lines of the TOML file of a project.

    Args:
        network: the network.
        units: units of the files.
        files: names of its tables.
        folder: its folder.
        sigmas: standard deviations of rows that state none.
        heading: lines of a comment at the beginning.
    """
    yield from (f"# {line}".rstrip() for line in heading)
    yield f"name = {_text(network.name)}"
    yield f"datum = {_text(network.datum)}"
    yield ""
    yield "[frame]"
    yield from _frame(network.frame, units)
    yield from crs_section_lines(network.crs, _text, folder)
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
    for kind, stated in (sigmas or {}).items():
        yield ""
        yield f"[sigma.{kind}]"
        for name, text in stated.items():
            yield f"{name} = {_stated_number(text)}"


def _stated_number(text: str) -> str:
    """Return a number of a table as TOML; a text if a float does not have all its digits."""
    try:
        value = float(text)
    except ValueError:
        return _text(text)
    exact = Decimal(text) == Decimal(repr(value))
    return toml_value(value) if exact else _text(text)


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
        yield f"latitude = {_text(numbers.write_quantity(frame.latitude, units.geographic))}"
        yield f"longitude = {_text(numbers.write_quantity(frame.longitude, units.geographic))}"
        yield f"height = {_decimal(frame.height, units.length)}"


def _decimal(value: float, unit: str) -> str:
    """Return a TOML number, or quoted text if a float cannot hold all digits."""
    text = numbers.write_quantity(value, unit)
    return repr(float(text)) if numbers.parse_quantity(float(text), unit) == value else _text(text)


def camera_record(camera: Camera) -> dict[str, object]:
    """Return the keys of a camera, a table [[camera]]; a held parameter is written as a number."""
    lens = camera.lens
    out: dict[str, object] = {
        "name": camera.name,
        "lens": _lens_record(lens),
        "unit": camera.unit,
    }
    if camera.y_down_in_files:
        out["y_axis"] = "down"
    if camera.per_photo:
        out["per_photo"] = True
    if camera.format is not None:
        out |= {"format": list(camera.format), "origin": camera.origin}
    if camera.readout is not None:
        out |= {"readout_s": camera.readout, "readout_towards": camera.readout_towards}
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


def _lens_record(lens: Lens) -> object:
    """Return a lens model: its name, or a table with its options."""
    options: dict[str, object] = {}
    for f in fields(lens):
        value = getattr(lens, f.name)
        inside = _lens_record(value) if isinstance(value, Lens) else value
        options[f.name] = float(value) if type(value) is int else inside
    return {"model": lens.kind, **options} if options else lens.kind


def _camera(camera: Camera) -> Iterator[str]:
    record = camera_record(camera)
    parameters = cast(dict[str, object], record.pop("parameters"))
    yield "[[camera]]"
    yield from (f"{name} = {toml_value(value)}" for name, value in record.items())
    yield "[camera.parameters]"
    yield from (f"{name} = {toml_value(value)}" for name, value in parameters.items())


def toml_value(value: object) -> str:
    """Return a value as TOML: text, true or false, a number, a list, or an inline table."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    return _text(value) if isinstance(value, str) else _float(cast(float, value))


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _float(value: float) -> str:
    return repr(float(value))


@taking(Network)
def write_project(
    network: Network,
    path: str | Path,
    *,
    units: Units | None = None,
    heading: Iterable[str] = (),
) -> None:
    """Write a network as a TOML file with CSV tables beside it; an error writes no file.

    `read_project` gives back the same points, unknowns and observations in the same order,
    every float64 to the bit, whatever the units.

    Args:
        network: the network.
        path: the TOML file, or a folder for project.toml; the tables go into the folder, which is
            created if missing.
        units: units of the files; metres, gon and degrees by default.
        heading: lines of a comment at the beginning of the TOML file.

    Raises:
        InputError: a name or a unit cannot be written to a file, or the folder cannot be
            written to; no file has changed.
    """
    path = Path(path)
    if not path.suffix or path.is_dir():
        path = path / "project.toml"
    if path.suffix != ".toml":
        raise InputError(Problem("a project is a .toml file or a folder", str(path)))
    files = network_files(network, units=units, toml=path.name, folder=path.parent, heading=heading)
    write_files(path.parent, files)


def network_files(
    network: Network,
    *,
    units: Units | None = None,
    toml: str = "project.toml",
    folder: Path | None = None,
    heading: Iterable[str] = (),
) -> dict[str, str]:
    """Return the project files of a network: texts by file name.

    Args:
        network: the network; it may have no observations.
        units: units of the files; metres, gon and degrees by default.
        toml: name of the TOML file.
        folder: where the files will be; a geoid there is named without its folder.
        heading: lines of a comment at the beginning of the TOML file.

    Raises:
        InputError: a name or a unit cannot be written to a file.
    """
    units = units or Units()
    network = network.with_listed_points()
    check_names(network)
    files: dict[str, str] = {}
    observations = list(_observations(network, units))
    sigmas = _common_sigmas(network, observations)
    for name, columns, rows in (
        ("points", POINT_COLUMNS, (point_record(p, units) for p in network.points.values())),
        ("photos", PHOTO_COLUMNS, (photo_record(f, units) for f in network.photos.values())),
        ("images", IMAGE_COLUMNS, _images(network)),
        ("observations", observation_columns(), iter(observations)),
        ("covariances", COVARIANCE_COLUMNS, covariance_records(network)),
        ("doubts", DOUBT_COLUMNS, _doubts(network)),
        *(
            (parameter_table(k).file, parameter_columns(k), _parameters(network, k, units))
            for k in parameter_kinds()
        ),
    ):
        found = list(rows)
        if found or name == "points":
            files[f"{name}.csv"] = write_table(columns, found)
    lines = project_toml_lines(network, units, list(files), folder, sigmas=sigmas, heading=heading)
    files[toml] = "\n".join(lines) + "\n"
    return files


def _common_sigmas(network: Network, rows: list[dict[str, str]]) -> Sigmas:
    """Return the σ that most rows of a kind share, and take it from these rows.

    A kind of which any row states no σ of its own, as members of a joint covariance, keeps all: a
    row without one would have the common one.
    """
    joint = {ident for ids, _ in network.clusters for ident in ids}
    of_kind: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        of_kind.setdefault(row["kind"], []).append(row)
    out: Sigmas = {}
    for kind, own in of_kind.items():
        names = {*sigma_fields(kind), *combine_fields(kind)}
        stated = [tuple((n, v) for n, v in row.items() if v and n in names) for row in own]
        if not all(stated) or any(row["id"] in joint for row in own):
            continue
        common, count = Counter(stated).most_common(1)[0]
        matrix = any(name.startswith("covariance") for name, _ in common)
        if 1 < count >= MIN_COMMON_SHARE * len(own) and not matrix:
            out[kind] = dict(common)
            for row, found in zip(own, stated, strict=True):
                if found == common:
                    for name, _ in common:
                        del row[name]
    return out


def check_names(network: Network) -> None:
    """Refuse names that a CSV cell cannot hold, and units that readers do not know."""
    named: tuple[tuple[str, Iterable[str]], ...] = (
        ("point", network.points),
        ("photo", network.photos),
        ("camera", network.cameras),
        *(
            (k.noun, (n if isinstance(n, str) else n[-1] for n in network.of_kind(k.name)))
            for k in parameter_kinds()
        ),
        ("observation", network.observations),
        ("image point", network.images.ids.values()),
    )
    problems = [
        Problem("a name with blanks at its ends cannot be written", f"{what} {n!r}")
        for what, names in named
        for n in names
        if n != n.strip()
    ]
    problems += [p for what, names in named for p in problems_of_names(names, what)]
    problems += [
        Problem(
            f"unit {c.unit!r} cannot be written; valid: px, {', '.join(LENGTH)}", f"camera {n!r}"
        )
        for n, c in network.cameras.items()
        if c.unit not in ("px", *LENGTH)
    ]
    if problems:
        raise InputError(problems)


# -- tables ---------------------------------------------------------------------------------------


def _sigma_columns(
    sigma: Iterable[float] | None, axes: Iterable[str], unit: str, prefix: str = "sigma"
) -> dict[str, str]:
    """Return σ columns of weighted components: one common column if all σ are equal."""
    given = dict(zip(axes, sigma or (), strict=False))
    if given and len(set(given.values())) == 1 and math.isfinite(next(iter(given.values()))):
        return {f"{prefix}_{unit}": numbers.write_quantity(next(iter(given.values())), unit)}
    return {
        f"{prefix}_{a}_{unit}": numbers.write_quantity(s, unit)
        for a, s in given.items()
        if math.isfinite(s)
    }


def _known_fields(names: Iterable[str], values: Iterable[float], unit: str) -> dict[str, str]:
    """Return the fields of the known values."""
    return {
        n: numbers.write_quantity(v, unit)
        for n, v in zip(names, values, strict=True)
        if not math.isnan(v)
    }


def point_record(point: Point, units: Units) -> dict[str, str]:
    """Return the fields of a point, a row of points.csv; some may be empty."""
    out = {"name": point.name, **_known_fields("xyz", point.coordinates, units.length)}
    out["fixed"] = point.held
    out["datum"] = "yes" if point.datum else ""
    out["side_shot"] = "yes" if point.side_shot else ""
    out |= _sigma_columns(point.sigma, "xyz", units.sigma_length)
    if point.check is not None:
        out |= _known_fields(CHECK_COLUMNS, point.check, units.length)
    return out


def photo_record(photo: Photo, units: Units, *, angles: bool = True) -> dict[str, str]:
    """Return the fields of a photo, a row of photos.csv; some may be empty.

    Args:
        photo: the photo.
        units: units of the fields.
        angles: write the rotation as ω, φ, κ if they reproduce it to the bit; otherwise write
            the matrix.
    """
    out = {"name": photo.name, "camera": photo.camera}
    if photo.position is not None:
        out |= _known_fields("xyz", photo.position, units.length)
    if photo.rotation is not None:
        turned = exact_angles(photo.rotation) if angles else None
        if turned is not None:
            out |= _known_fields(ATTITUDE_COLUMNS, turned, units.angle)
        else:
            out |= _known_fields(ROTATION_COLUMNS, photo.rotation.ravel().tolist(), "")
    held = tuple(part for part, fixed in zip(POSE_PARTS, photo.fixed, strict=True) if fixed)
    words = {parts: word for word, parts in POSE_WORDS.items()}
    out["fixed"] = words.get(held, " ".join(held))
    out |= _sigma_columns(photo.sigma_position, "xyz", units.sigma_length)
    if photo.sigma_attitude is not None:
        name = f"sigma_attitude_{units.sigma_angle}"
        out[name] = numbers.write_quantity(photo.sigma_attitude, units.sigma_angle)
    return out


def exact_angles(rotation: Array) -> tuple[float, float, float] | None:
    """Return ω, φ, κ (rad) that reproduce this world_R_camera to the bit; None if none do.

    Angles computed from a matrix are correct to a few units of the last place. If the matrix was
    made from angles, these angles are among the neighbouring floats.
    """
    start = omega_phi_kappa(rotation)
    near = [a + np.arange(-4, 5) * np.spacing(abs(a)) for a in start]
    r = rotation @ TURN_ABOUT_X
    cosine = np.cos(near[1])
    for phi, c in zip(near[1], cosine, strict=True):
        if np.sin(phi) != r[0, 2]:
            continue
        kappas = near[2][(c * np.cos(near[2]) == r[0, 0]) & (-c * np.sin(near[2]) == r[0, 1])]
        omegas = near[0][(-np.sin(near[0]) * c == r[1, 2]) & (np.cos(near[0]) * c == r[2, 2])]
        for omega in omegas.tolist():
            for kappa in kappas.tolist():
                if np.array_equal(world_R_camera(omega, float(phi), kappa), rotation):
                    return omega, float(phi), kappa
    return None


def _images(network: Network) -> Records:
    photos, points = list(network.photos), list(network.points)
    cameras = [network.cameras[f.camera] for f in network.photos.values()]
    unit = [c.unit for c in cameras]
    up = [-1.0 if c.y_down_in_files else 1.0 for c in cameras]
    photo, point, xy, sigma = (c.tolist() for c in network.images.columns())
    correlation = network.images.correlation.tolist()
    written = {s: numbers.write_quantity(s) for s in {s for pair in sigma for s in pair}}
    for row, (f, p, (x, y), (sx, sy)) in enumerate(zip(photo, point, xy, sigma, strict=True)):
        out = {"photo": photos[f], "point": points[p], "x": repr(x), "y": repr(up[f] * y)}
        if sx == sy:
            out[f"sigma_{unit[f]}"] = written[sx]
        else:
            out[f"sigma_x_{unit[f]}"], out[f"sigma_y_{unit[f]}"] = written[sx], written[sy]
        if rho := correlation[row]:
            out["correlation"] = numbers.write_quantity(up[f] * rho)
        ident = network.images.ids.get(row)
        yield out if ident is None else out | {"id": ident}


def _observations(network: Network, units: Units) -> Records:
    for ident, o in network.observations.items():
        axes = ImageAxes(y_down=any(_camera_of(network, f).y_down_in_files for f in o.photos()))
        yield observation_records.observation_record(o, id=ident, units=units, axes=axes)


def _camera_of(network: Network, photo: str) -> Camera:
    return network.cameras[network.photos[photo].camera]


def _doubts(network: Network) -> Records:
    """Write each doubt in its first row, and an observation that it is about in each row."""
    for number, doubt in enumerate(network.doubts, start=1):
        said = {"where": doubt.where, "what": doubt.what}
        for ident in doubt.ids or ("",):
            yield {"doubt": str(number), "id": ident, **said}
            said = {}


def _parameters(network: Network, kind: UnknownKind, units: Units) -> Records:
    """Write all unknowns of a kind in order, unless the observations imply the same free ones."""
    stated = network.of_kind(kind.name)
    if kind.absent == "found" and all(math.isnan(p.values[0]) for p in stated.values()):
        found = [
            parameter_key(kind, attribute, o)
            for o in network.observations.values()
            for name, attribute in o.record.parameters
            if name == kind.name
        ]
        if list(dict.fromkeys(found)) == list(stated):
            return
    yield from parameter_records(network, kind, units)
