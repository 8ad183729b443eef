"""JSON records of points, photos, cameras, unknowns, observations and networks, there and back.

The fields are the columns of the CSV tables and the keys of [[camera]], see
`factorgraph_adj.io.observation_records`, `factorgraph_adj.io.unknowns_tables` and
`factorgraph_adj.io.project`; this module converts them to and from JSON values. Written records
are in metres and radians, with ``unit`` where the name of a field has no unit, so that they can be
read without a project. Read records may hold numbers, text, true and false in any unit.

Observations with a joint covariance are ``{"kind": "correlated", "observations": [fields, …],
"covariance_si": [[…], …]}``: the covariance of all components in order, metres and radians; of
image points in the unit of their image, x right and y as the coordinates have it.

One `InputError` lists all problems of a record; the place of each begins with the source that
the reader states. Every float is read back to the bit.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..entities import Camera, Key, Parameter, Photo, Point, parameter_name
from ..errors import InputError, Problem, known, system_reason
from ..frames import Frame
from ..models.lens import NoDistortion
from ..models.unknown_registry import UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import Network
from ..observations import KINDS, AnyObservation, Correlated, Observation
from ..types import Array
from . import numbers, observation_records
from .camera_records import read_camera_record
from .covariance_tables import signs_in_group
from .csv_tables import REMARK_COLUMNS, FieldRow
from .numbers import Units
from .observation_fields import (
    ImageAxes,
    RecordContext,
    combine_fields,
    is_angle,
    is_in_image,
    name_fields,
    number_fields,
    sigma_fields,
    text_fields,
    unknown_field_message,
)
from .parameter_tables import parameter_columns, parameter_records, parameter_table, read_parameter
from .project import load_project
from .project_writer import camera_record, network_files, photo_record, point_record
from .text_files import parse_toml
from .unknowns_tables import PHOTO_COLUMNS, POINT_COLUMNS, UnknownsReader

JsonFields = dict[str, object]
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
CORRELATED_KIND = "correlated"
"""Value of ``kind`` for observations with a joint covariance."""
SI_UNITS = Units("m", "rad", "rad", "m", "rad")
"""Units of written records."""
_CORRELATED_KEYS = ("kind", "observations", "covariance_si", *REMARK_COLUMNS)
_Found = TypeVar("_Found")
_TEXTS = frozenset({"name", "camera", "fixed"})


def plain_record(record: Mapping[str, str], texts: Iterable[str]) -> JsonFields:
    """Return the filled fields of a record in SI; text of numbers becomes numbers."""
    return {k: v if k in texts else float(v) for k, v in record.items() if v}


def checked_record(fields: object, source: str) -> Mapping[str, object]:
    """Return the fields; InputError if they are not a JSON object."""
    if isinstance(fields, Mapping):
        return fields
    raise InputError(Problem(f"a record must be an object {{…}}, not {fields!r}", source))


def observation_fields(
    item: AnyObservation, *, id: str | Sequence[str] | None, unit: str = "mm"
) -> JsonFields:
    """Return the record of an observation, without its source.

    Args:
        item: the observation, or several with a joint covariance.
        id: name in the network, for an observation without its own id; for correlated
            observations a sequence with one name for each.
        unit: unit of the camera, for image coordinates: px or a length; it ends the name of σ.

    Raises:
        InputError: the id or the name of a set is empty, or no part of the standard deviation
            applies: a record cannot state these.
    """
    if not isinstance(item, Correlated):
        return _single_fields(item, id if isinstance(id, str) else None, unit)
    ids: Sequence[str | None] = [None] * len(item.observations)
    if id is not None:
        ids = [id] if isinstance(id, str) else id
    return {
        "kind": CORRELATED_KIND,
        "observations": [
            _single_fields(o, i, unit) for o, i in zip(item.observations, ids, strict=True)
        ],
        "covariance_si": np.asarray(item.covariance, dtype=float).tolist(),
    }


def _single_fields(item: Observation, id: str | None, unit: str) -> JsonFields:
    # An empty field counts as absent; reading it would give another observation.
    stated = {n: getattr(item, n, None) for n in ("id", *item.record.texts)}
    problems = [
        Problem(f"{name} must be text that is not empty, not {value!r}", item.label())
        for name, value in stated.items()
        if value is not None and (not isinstance(value, str) or not value)
    ]
    record = observation_records.observation_record(
        item, id=id, units=SI_UNITS, axes=ImageAxes(unit)
    )
    kind = item.kind
    out = plain_record(
        record, {"kind", "id", *name_fields(kind), *text_fields(kind), *combine_fields(kind)}
    )
    if problems:
        raise InputError(problems)
    # ``unit`` is that of the value; angles beside it are read in gon.
    angles = [n for n, quantity in number_fields(kind).items() if quantity == "angle" and n in out]
    # Text keeps all digits, a number in gon would be rounded.
    out |= {n: numbers.write_quantity(getattr(item, n), "gon") for n in angles}
    if item.record.unit != "image":
        out["unit"] = "rad" if is_angle(item.kind) else "m"
    return out


def observation_of(
    fields: Mapping[str, object], *, context: RecordContext | None = None, source: str = ""
) -> AnyObservation:
    """Return the observation that a record describes.

    Args:
        fields: the record, as `json.loads` gives it.
        context: defaults of the project. Without a context, lengths are metres and angles gon
            where the record states no ``unit``, heights of instruments and targets are metres,
            and image coordinates have the unit that σ names. Records of `observation_fields`
            are read without a context.
        source: place of the record, for messages and for the observation.

    Raises:
        InputError: all problems of the record, as `records.observation` lists them; for
            correlated observations also an empty or malformed list, and a covariance that is
            not square, symmetric, positive definite or of the size of their components.
    """
    fields = checked_record(fields, source)
    if fields.get("kind") == CORRELATED_KIND:
        return _correlated_of(fields, context, source)
    return _single_of(fields, context, source)


def _single_of(
    fields: Mapping[str, object], context: RecordContext | None, source: str
) -> Observation:
    if context is None and fields.get("kind") == "image":
        context = RecordContext(images={str(fields.get("photo")): _own_axes(fields)})
    return observation_records.observation_from_record(fields, context=context, source=source)


def _own_axes(fields: Mapping[str, object]) -> ImageAxes:
    """Return image axes with the unit that the name of a record's σ states."""
    named = [f.rpartition("_")[2] for f in sigma_fields("image") if f in fields]
    return ImageAxes(named[0]) if named else ImageAxes()


def _correlated_of(
    fields: Mapping[str, object], context: RecordContext | None, source: str
) -> Correlated:
    problems: list[Problem] = []
    row = FieldRow(fields, source, problems, CORRELATED_KIND)
    for name in row.fields:
        if name not in _CORRELATED_KEYS:
            row.wrong(
                f"unknown field {name!r}; known: {known(_CORRELATED_KEYS, meant=name, most=40)}"
            )
    covariance = _matrix(row)
    given = row.take("observations", required=True)
    if given is not None and not isinstance(given, list):
        row.wrong(f"observations must be a list of records, not {given!r}")
    members: list[Observation] = []
    begin = 0
    for number, entry in enumerate(given if isinstance(given, list) else (), start=1):
        where = ", ".join(part for part in (source, f"observation {number}") if part)
        try:
            record = checked_record(entry, where)
            if record.get("kind") == CORRELATED_KIND:
                raise InputError(Problem("a group cannot be in a correlated group", where))
            if covariance is not None:
                record = _with_sigma(record, np.diag(covariance)[begin:])
            members.append(replace(_single_of(record, context, where), source=source or None))
            begin += _size(record)
        except InputError as error:
            problems.extend(error.problems)
            # The places of the following members in the covariance are unknown now.
            covariance = None
    if isinstance(given, list) and not given:
        row.wrong("observations must be one record or more")
    if problems or covariance is None:
        raise InputError(problems)
    try:
        if context is not None:
            covariance *= signs_in_group(members, context.axes_of)
        return Correlated(tuple(members), covariance)
    except InputError as error:
        row.wrong_all(error)
        raise InputError(problems) from None


def _matrix(row: FieldRow) -> Array | None:
    """Return the covariance; None, noted in the row, if it is not a square matrix of numbers."""
    given = row.take("covariance_si", required=True)
    if given is None:
        return None
    if not isinstance(given, list) or not all(
        isinstance(line, list) and len(line) == len(given) for line in given
    ):
        row.wrong("covariance_si must be a square matrix: a list of rows as long as itself")
        return None
    try:
        return np.array([[numbers.parse_quantity(v) for v in line] for line in given])
    except ValueError as error:
        row.wrong(f"covariance_si: {error}")
        return None


def _axes(record: Mapping[str, object]) -> tuple[str, ...]:
    """Return the components of a record, which is not checked yet."""
    kind = KINDS.get(str(record.get("kind")))
    if kind is not None and "axes" in kind.attributes:
        return tuple(str(record.get("axes") or "xyz").replace(" ", ""))
    return () if kind is None else kind.observation.components


def _size(record: Mapping[str, object]) -> int:
    return len(_axes(record))


def _with_sigma(record: Mapping[str, object], variances: Array) -> Mapping[str, object]:
    """Give a member without a standard deviation the variances of the group, as tables do."""
    kind, axes = str(record.get("kind")), _axes(record)
    if kind not in KINDS or any(record.get(f) is not None for f in sigma_fields(kind)):
        return record
    unit = "image" if is_in_image(kind) else "rad" if is_angle(kind) else "m"
    own = zip(axes, variances.tolist(), strict=False)
    stated = {f"sigma_{a}_{unit}" if a else f"sigma_{unit}": v**0.5 for a, v in own if v > 0}
    return {**record, **stated}


# -- points, photos, cameras ----------------------------------------------------------------------


def point_fields(point: Point) -> JsonFields:
    """Return the record of a point, metres."""
    flags = {"datum": point.datum, "side_shot": point.side_shot}
    out = plain_record(point_record(point, SI_UNITS) | dict.fromkeys(flags, ""), _TEXTS)
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
        source: place of the record, for messages.

    Raises:
        InputError: everything that is wrong with it.
    """
    network = Network(frame=frame)

    def read(row: FieldRow, name: str, reader: UnknownsReader) -> Point:
        _columns_of_record(row, POINT_COLUMNS)
        reader.point(row, name)
        return network.points[name]

    return _entity(fields, "point", network, context, source, read)


def photo_fields(photo: Photo) -> JsonFields:
    """Return the record of a photo, metres and radians, with its rotation as a matrix."""
    return plain_record(photo_record(photo, SI_UNITS, angles=False), _TEXTS)


def photo_of(
    fields: Mapping[str, object],
    *,
    context: RecordContext | None = None,
    frame: Frame | None = None,
    source: str = "",
) -> Photo:
    """Return the photo that a record describes; its camera is not searched for.

    Args:
        fields: the record, with the columns of photos.csv.
        context: units of fields without a unit in their name; metres and gon by default.
        frame: frame of the network; photos need a right-handed frame.
        source: place of the record, for messages.

    Raises:
        InputError: everything that is wrong with it.
    """
    network = Network(frame=frame)

    def read(row: FieldRow, name: str, reader: UnknownsReader) -> Photo:
        _columns_of_record(row, PHOTO_COLUMNS)
        if "camera" in row:
            network.add_camera(str(row.fields["camera"]), NoDistortion(), {"c": 1.0})
        reader.photo(row, name)
        return network.photos[name]

    return _entity(fields, "photo", network, context, source, read)


def camera_fields(camera: Camera) -> JsonFields:
    """Return the record of a camera, with the keys of [[camera]], in image units."""
    return camera_record(camera)


def camera_of(fields: Mapping[str, object], *, source: str = "") -> Camera:
    """Return the camera that a record describes.

    Args:
        fields: the record, with the keys of [[camera]]. A σ of image coordinates has no effect
            here; `factorgraph_adj.io.camera_records.read_camera_record` returns it.
        source: place of the record, for messages.

    Raises:
        InputError: everything that is wrong with it.
    """
    network = Network()

    def read(row: FieldRow, name: str, reader: UnknownsReader) -> Camera:
        read_camera_record(row, name, network)
        return network.cameras[name]

    return _entity(fields, "camera", network, None, source, read)


def unknown_fields(kind: VariableKind, key: Key, p: Parameter) -> JsonFields:
    """Return the record of an unknown besides points, photos and cameras, SI."""
    record, network = UNKNOWNS[kind], Network()
    network.of_kind(kind)[key] = p
    (fields,) = parameter_records(network, record, SI_UNITS)
    texts = {*parameter_table(record).keys, "free", "fixed", "origin", "level"}
    return {"kind": kind, **plain_record(fields, texts)}


def unknown_of(
    fields: Mapping[str, object], *, context: RecordContext | None = None, source: str = ""
) -> tuple[VariableKind, Key, Parameter]:
    """Return kind, name and unknown of a record, whose fields are ``kind`` and those of its table.

    Args:
        fields: for example ``{"kind": "level", "name": "lake", "value_m": 371.2}``.
        context: units of values without a unit of their own.
        source: place of the record.

    Raises:
        InputError: an unknown kind or field, or a value that is wrong; all problems are listed.
    """
    given = dict(checked_record(fields, source))
    name, kinds = given.pop("kind", None), {k.name: k for k in parameter_kinds()}
    if not isinstance(name, str) or name not in kinds:
        what = "kind of unknowns is missing" if name is None else f"unknown kind {name!r}"
        raise InputError(Problem(f"{what}; valid: {known(kinds, meant=name, most=40)}", source))
    kind, problems = kinds[name], list[Problem]()
    row = FieldRow(given, source, problems, kind.noun)
    _columns_of_record(row, parameter_columns(kind))
    stated = parameter_table(kind)
    nameless = stated.keys == ("name",) and kind.default is not None
    first = row.text(stated.keys[0], required=not nameless) or ""
    others = [row.text(k, default=stated.key_default) or "" for k in stated.keys[1:]]
    key: Key = (first, *others) if others else first
    network = Network()
    origin = row.fields.get("origin")
    for point in dict.fromkeys((first * kind.at_point, origin)):
        if point and isinstance(point, str):  # whether there is one is not checked
            network.add_point(point, (0.0, 0.0, 0.0))
    if first and kind.in_photo:
        network.photos[first] = Photo(first, "")
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
    read: Callable[[FieldRow, str, UnknownsReader], _Found],
) -> _Found:
    """Read one named entity into an otherwise empty network."""
    fields = checked_record(fields, source)
    problems: list[Problem] = []
    of = f"{what} {fields['name']!r}" if fields.get("name") not in (None, "") else what
    row = FieldRow(fields, source, problems, of)
    name = row.text("name", required=True) or what
    units = context.units if context is not None else Units()
    found = read(row, name, UnknownsReader(network, units, 3, problems))
    if problems:
        raise InputError(problems)
    return found


def _columns_of_record(row: FieldRow, columns: Iterable[str]) -> None:
    for name in row.fields:
        wrong = unknown_field_message(name, (*columns, *REMARK_COLUMNS))
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
            what = f"must be text, not {text!r}"  # type: ignore[unreachable]  # JSON has any value
            problems.append(Problem(what, f"files: {name!r}"))
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
