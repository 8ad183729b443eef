"""Records as plain JSON: the entries of a journal and the requests of a stream.

The fields are the columns of the CSV tables and the keys of [[camera]], see
`factorgraph_adj.io.records`, `factorgraph_adj.io.read_unknowns` and
`factorgraph_adj.io.project`; this module converts them to and from JSON values. Written records
are in metres and radians, with ``unit`` where the name of a field has no unit, so that they can be
read without a project. Read records may hold numbers, text, true and false in any unit.

Observations with a joint covariance are ``{"kind": "correlated", "observations": [fields, …],
"covariance_si": [[…], …]}``: the covariance of all components in order, metres and radians.

One `InputError` lists all problems of a record; the place of each begins with the source that
the reader states. Every float is read back to the bit.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from ..errors import InputError, Problem, known, system_reason
from ..frames import Frame
from ..models.lens import NoDistortion
from ..models.variables import UNKNOWNS, VariableKind, parameter_kinds
from ..network.entities import Camera, Key, Parameter, Photo, Point, parameter_name
from ..network.network import Network
from .context import RecordContext
from .fields import unknown_field
from .json_observations import SI, Fields, checked, observation_fields, observation_of, plain
from .numbers import Units
from .parameter_tables import columns_of, parameter_records, read_parameter, table_of
from .project import load_project, read_camera
from .read_unknowns import PHOTO_COLUMNS, POINT_COLUMNS, UnknownsReader
from .tables import IGNORED, Row
from .text import parse_toml
from .write_project import network_files, photo_record, point_record
from .write_toml import camera_record

__all__ = [
    "camera_fields",
    "camera_of",
    "network_files",
    "network_of",
    "observation_fields",
    "observation_of",
    "photo_fields",
    "photo_of",
    "point_fields",
    "point_of",
    "unknown_fields",
    "unknown_of",
]

_Found = TypeVar("_Found")
_TEXTS = frozenset({"name", "camera", "fixed"})


# -- points, photos, cameras ----------------------------------------------------------------------


def point_fields(point: Point) -> Fields:
    """Return the record of a point, metres."""
    flags = {"datum": point.datum, "side_shot": point.side_shot}
    out = plain(point_record(point, SI) | dict.fromkeys(flags, ""), _TEXTS)
    return out | {name: True for name, flag in flags.items() if flag}


def point_of(
    fields: Mapping[str, object],
    *,
    context: RecordContext | None = None,
    frame: Frame | None = None,
    source: str = "",
) -> Point:
    """Return the point that a record describes.

    Args:
        fields: the record, with the columns of points.csv.
        context: units of fields without a unit in their name; metres and degrees by default.
        frame: frame of the network, for points given by latitude, longitude and height.
        source: where the record stands, for messages.

    Raises:
        InputError: everything that is wrong with it.
    """
    network = Network(frame=frame)

    def read(row: Row, name: str, reader: UnknownsReader) -> Point:
        _known(row, POINT_COLUMNS)
        reader.point(row, name)
        return network.points[name]

    return _entity(fields, "point", network, context, source, read)


def photo_fields(photo: Photo) -> Fields:
    """Return the record of a photo, metres and radians, with its rotation as a matrix."""
    return plain(photo_record(photo, SI, angles=False), _TEXTS)


def photo_of(
    fields: Mapping[str, object],
    *,
    context: RecordContext | None = None,
    frame: Frame | None = None,
    source: str = "",
) -> Photo:
    """Return the photo that a record describes; its camera is not looked up.

    Args:
        fields: the record, with the columns of photos.csv.
        context: units of fields without a unit in their name; metres and gon by default.
        frame: frame of the network; photos need a right-handed frame.
        source: where the record stands, for messages.

    Raises:
        InputError: everything that is wrong with it.
    """
    network = Network(frame=frame)

    def read(row: Row, name: str, reader: UnknownsReader) -> Photo:
        _known(row, PHOTO_COLUMNS)
        if "camera" in row:
            network.add_camera(str(row.fields["camera"]), NoDistortion(), {"c": 1.0})
        reader.photo(row, name)
        return network.photos[name]

    return _entity(fields, "photo", network, context, source, read)


def camera_fields(camera: Camera) -> Fields:
    """Return the record of a camera, with the keys of [[camera]], in image units."""
    return camera_record(camera)


def camera_of(fields: Mapping[str, object], *, source: str = "") -> Camera:
    """Return the camera that a record describes.

    Args:
        fields: the record, with the keys of [[camera]]. A σ of image coordinates has no effect
            here; `factorgraph_adj.io.project.read_camera` returns it.
        source: where the record stands, for messages.

    Raises:
        InputError: everything that is wrong with it.
    """
    network = Network()

    def read(row: Row, name: str, reader: UnknownsReader) -> Camera:
        read_camera(row, name, network)
        return network.cameras[name]

    return _entity(fields, "camera", network, None, source, read)


def unknown_fields(kind: VariableKind, key: Key, p: Parameter) -> Fields:
    """Return the record of an unknown besides points, photos and cameras, SI."""
    record, network = UNKNOWNS[kind], Network()
    network.of_kind(kind)[key] = p
    (fields,) = parameter_records(network, record, SI)
    texts = {*table_of(record).keys, "free", "fixed", "origin", "level"}
    return {"kind": kind, **plain(fields, texts)}


def unknown_of(
    fields: Mapping[str, object], *, context: RecordContext | None = None, source: str = ""
) -> tuple[VariableKind, Key, Parameter]:
    """Return kind, name and unknown of a record, whose fields are ``kind`` and those of its table.

    Args:
        fields: for example ``{"kind": "level", "name": "lake", "value_m": 371.2}``.
        context: units of values without a unit of their own.
        source: where the record stands.

    Raises:
        InputError: an unknown kind or field, or a value that is wrong; all problems are listed.
    """
    given = dict(checked(fields, source))
    name, kinds = given.pop("kind", None), {k.name: k for k in parameter_kinds()}
    if not isinstance(name, str) or name not in kinds:
        what = "kind of unknowns is missing" if name is None else f"unknown kind {name!r}"
        raise InputError(Problem(f"{what}; valid: {known(kinds, meant=name, most=40)}", source))
    kind, problems = kinds[name], list[Problem]()
    row = Row(given, source, problems, kind.noun)
    _known(row, columns_of(kind))
    stated = table_of(kind)
    nameless = stated.keys == ("name",) and kind.default is not None
    first = row.text(stated.keys[0], required=not nameless) or ""
    others = [row.text(k, default=stated.key_default) or "" for k in stated.keys[1:]]
    key: Key = (first, *others) if others else first
    network = Network()
    origin = row.fields.get("origin")
    for point in dict.fromkeys((first * kind.at_point, origin)):
        if point and isinstance(point, str):  # whether there is one is not looked up
            network.add_point(point, (0.0, 0.0, 0.0))
    if first or nameless:
        row.of = f"{kind.noun} {parameter_name(key)!r}"
        units = context.units if context is not None else Units()
        read_parameter(row, kind, key, network, units)
    if problems:
        raise InputError(problems)
    return kind.name, key, network.of_kind(kind.name)[key]


def _entity(
    fields: Mapping[str, object],
    what: str,
    network: Network,
    context: RecordContext | None,
    source: str,
    read: Callable[[Row, str, UnknownsReader], _Found],
) -> _Found:
    """Read one named entity into an otherwise empty network."""
    fields = checked(fields, source)
    problems: list[Problem] = []
    of = f"{what} {fields['name']!r}" if fields.get("name") not in (None, "") else what
    row = Row(fields, source, problems, of)
    name = row.text("name", required=True) or what
    units = context.units if context is not None else Units()
    found = read(row, name, UnknownsReader(network, units, 3, problems))
    if problems:
        raise InputError(problems)
    return found


def _known(row: Row, columns: Iterable[str]) -> None:
    for name in row.fields:
        wrong = unknown_field(name, (*columns, *IGNORED))
        if wrong is not None:
            row.wrong(wrong.replace("column", "field", 1))


# -- networks -------------------------------------------------------------------------------------


def network_of(
    files: Mapping[str, str],
    *,
    home: Path | None = None,
    geoids: Collection[str] = (),
    allow_outside: bool = False,
) -> Network:
    """Return the network whose project files are given; the inverse of `network_files`.

    Args:
        files: texts by file name, the TOML as ``project.toml``.
        home: folder in which the geoid may lie: that of the file that has these texts.
        geoids: further paths of geoids that may be read.
        allow_outside: whether the geoid may lie anywhere.

    Raises:
        InputError: a name is not a plain file name, ``project.toml`` is missing, a value is not
            text, or `read_project` finds problems.
    """
    problems = []
    if "project.toml" not in files:
        problems.append(Problem("project.toml is missing", "files"))
    for name, text in files.items():
        if name in ("", ".", "..") or any(c in name for c in "/\\\0"):
            problems.append(Problem("must be a plain file name", f"files: {name!r}"))
        elif not isinstance(text, str):
            problems.append(Problem(f"must be text, not {text!r}", f"files: {name!r}"))
    if problems:
        raise InputError(problems)
    try:
        with tempfile.TemporaryDirectory(prefix="network-") as folder:
            for name, text in files.items():
                # A lone surrogate becomes a byte that is not UTF-8, which the reader names.
                Path(folder, name).write_bytes(text.encode("utf-8", "surrogatepass"))
            own = _geoids(files["project.toml"], home, allow_outside)
            return load_project(folder, geoids=[*geoids, *own]).network
    except OSError as error:
        where = str(error.filename or tempfile.gettempdir())
        raise InputError(Problem(f"cannot be written: {system_reason(error)}", where)) from None


def _geoids(text: str, home: Path | None, anywhere: bool) -> list[str]:
    """Return the path of the geoid that a project states, if it may be read."""
    section = parse_toml(text, "project.toml").get("crs")
    stated = section.get("geoid") if isinstance(section, Mapping) else None
    if not isinstance(stated, str) or not Path(stated).is_absolute():
        return []
    near = home is not None and Path(stated).resolve().is_relative_to(home.resolve())
    return [stated] if anywhere or near else []
