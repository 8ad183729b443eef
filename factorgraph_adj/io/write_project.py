"""Write a network as a project; reading the project gives the same network to the bit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..control_characters import problems_of_names
from ..errors import InputError, Problem
from ..models.variables import UnknownKind, parameter_kinds
from ..network.entities import Photo, Point, parameter_key
from ..network.network import Network
from ..rotation import TURN_ABOUT_X, omega_phi_kappa, world_R_camera
from ..types import Array
from ..units import LENGTH
from . import numbers, records
from .atomic import write_files
from .context import ImageAxes
from .fields import columns as observation_columns
from .numbers import Units
from .parameter_tables import columns_of, parameter_records, table_of
from .read_observations import COVARIANCE_COLUMNS, DOUBT_COLUMNS, IMAGE_COLUMNS
from .read_unknowns import (
    ANGLES,
    CHECK,
    PHOTO_COLUMNS,
    POINT_COLUMNS,
    POSE_PARTS,
    POSE_WORDS,
    ROTATION,
)
from .tables import write_table
from .write_toml import toml_lines

Records = Iterator[dict[str, str]]


def write_project(network: Network, path: str | Path, *, units: Units | None = None) -> None:
    """Write a network as a TOML file with CSV tables beside it; an error writes no file.

    `read_project` gives back the same points, unknowns and observations in the same order,
    every float64 to the bit, whatever the units.

    Args:
        network: the network.
        path: the TOML file; the tables go into its folder, which is created if missing.
        units: units of the files; metres, gon and degrees by default.

    Raises:
        InputError: a name or a unit cannot be written to a file, or the folder cannot be
            written to; no file has changed.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise InputError(Problem("a project is a .toml file", str(path)))
    files = network_files(network, units=units, toml=path.name, folder=path.parent)
    write_files(path.parent, files)


def network_files(
    network: Network,
    *,
    units: Units | None = None,
    toml: str = "project.toml",
    folder: Path | None = None,
) -> dict[str, str]:
    """Return the project files of a network: texts by file name.

    Args:
        network: the network; it may have no observations.
        units: units of the files; metres, gon and degrees by default.
        toml: name of the TOML file.
        folder: where the files will be; a geoid there is named without its folder.

    Raises:
        InputError: a name or a unit cannot be written to a file.
    """
    units = units or Units()
    check_names(network)
    files: dict[str, str] = {}
    for name, columns, rows in (
        ("points", POINT_COLUMNS, (point_record(p, units) for p in network.points.values())),
        ("photos", PHOTO_COLUMNS, (photo_record(f, units) for f in network.photos.values())),
        ("images", IMAGE_COLUMNS, _images(network)),
        ("observations", observation_columns(), _observations(network, units)),
        ("covariances", COVARIANCE_COLUMNS, _covariances(network)),
        ("doubts", DOUBT_COLUMNS, _doubts(network)),
        *(
            (table_of(k).file, columns_of(k), _parameters(network, k, units))
            for k in parameter_kinds()
        ),
    ):
        found = list(rows)
        if found or name == "points":
            files[f"{name}.csv"] = write_table(columns, found)
    files[toml] = "\n".join(toml_lines(network, units, list(files), folder)) + "\n"
    return files


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


def _sigmas(
    sigma: Iterable[float] | None, axes: Iterable[str], unit: str, prefix: str = "sigma"
) -> dict[str, str]:
    """Return σ columns of weighted components: one common column if all σ are equal."""
    given = dict(zip(axes, sigma or (), strict=False))
    if given and len(set(given.values())) == 1 and math.isfinite(next(iter(given.values()))):
        return {f"{prefix}_{unit}": numbers.write(next(iter(given.values())), unit)}
    return {
        f"{prefix}_{a}_{unit}": numbers.write(s, unit) for a, s in given.items() if math.isfinite(s)
    }


def _filled(names: Iterable[str], values: Iterable[float], unit: str) -> dict[str, str]:
    """Return the fields of the known values."""
    return {
        n: numbers.write(v, unit) for n, v in zip(names, values, strict=True) if not math.isnan(v)
    }


def point_record(point: Point, units: Units) -> dict[str, str]:
    """Return the fields of a point, a row of points.csv; some may be empty."""
    out = {"name": point.name, **_filled("xyz", point.coordinates, units.length)}
    out["fixed"] = point.held
    out["datum"] = "yes" if point.datum else ""
    out["side_shot"] = "yes" if point.side_shot else ""
    out |= _sigmas(point.sigma, "xyz", units.sigma_length)
    if point.check is not None:
        out |= _filled(CHECK, point.check, units.length)
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
        out |= _filled("xyz", photo.position, units.length)
    if photo.rotation is not None:
        turned = exact_angles(photo.rotation) if angles else None
        if turned is not None:
            out |= _filled(ANGLES, turned, units.angle)
        else:
            out |= _filled(ROTATION, photo.rotation.ravel().tolist(), "")
    held = tuple(part for part, fixed in zip(POSE_PARTS, photo.fixed, strict=True) if fixed)
    words = {parts: word for word, parts in POSE_WORDS.items()}
    out["fixed"] = words.get(held, " ".join(held))
    out |= _sigmas(photo.sigma_position, "xyz", units.sigma_length)
    if photo.sigma_attitude is not None:
        name = f"sigma_attitude_{units.sigma_angle}"
        out[name] = numbers.write(photo.sigma_attitude, units.sigma_angle)
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
    written = {s: numbers.write(s) for s in {s for pair in sigma for s in pair}}
    for row, (f, p, (x, y), (sx, sy)) in enumerate(zip(photo, point, xy, sigma, strict=True)):
        out = {"photo": photos[f], "point": points[p], "x": repr(x), "y": repr(up[f] * y)}
        if sx == sy:
            out[f"sigma_{unit[f]}"] = written[sx]
        else:
            out[f"sigma_x_{unit[f]}"], out[f"sigma_y_{unit[f]}"] = written[sx], written[sy]
        ident = network.images.ids.get(row)
        yield out if ident is None else out | {"id": ident}


def _observations(network: Network, units: Units) -> Records:
    for ident, o in network.observations.items():
        yield records.record(o, id=ident, units=units, axes=ImageAxes())


def _covariances(network: Network) -> Records:
    for number, (ids, covariance) in enumerate(network.clusters, start=1):
        members = [(i, c) for i in ids for c in network.observations[i].component_names()]
        for i, (id1, c1) in enumerate(members):
            for j, (id2, c2) in enumerate(members):
                value = float(covariance[i, j])
                mirrored = float(covariance[j, i])
                if j < i and value == mirrored:
                    continue
                if value == 0 and mirrored == 0 and i != j:
                    continue
                yield {
                    "cluster": str(number),
                    "id": id1,
                    "component": c1,
                    "id2": id2,
                    "component2": c2,
                    "covariance_si": numbers.write(value),
                }


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
