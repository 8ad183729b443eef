"""Reader of projects: a TOML file (frame, units, cameras, σ, options) with its CSV tables.

The TOML file states name, datum, frame, units, cameras, standard deviations by kind, and options.
The tables have one entity or observation in each row; `factorgraph_adj.io.unknowns_tables` and
`factorgraph_adj.io.observation_fields` define their columns.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

from ..ellipsoid import ELLIPSOIDS
from ..errors import InputError, Problem, known, similar
from ..files import astray
from ..frames import MEAN_EARTH_RADIUS, Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from ..models.unknown_registry import parameter_kinds
from ..network.network import Network
from ..observations import KINDS
from ..stochastic_model import COMBINATIONS
from ..validate.network_structure import check
from .adjustment_options import AdjustOptions, adjust_options
from .camera_records import check_positive, read_camera_record, refuse_other_keys
from .crs_section import read_crs_section
from .csv_tables import CsvTable, FieldRow, read_table
from .numbers import Units
from .observation_fields import (
    ImageAxes,
    RecordContext,
    combine_fields,
    placeholder_sigma,
    sigma_fields,
    unknown_field_message,
)
from .observation_tables import ObservationsReader, without_observations
from .parameter_tables import parameter_table
from .readings_table import read_readings
from .text_files import read_toml
from .transaction_folders import recover_folder
from .unknowns_tables import Dimension, UnknownsReader

MIN_NAME_SIMILARITY = 0.8
"""Similarity (of difflib) from which a file's name is nearly that of a table: one letter of six is
missing, wrong or too many."""
PROJECT_KEYS = (
    *("name", "datum", "dimension", "frame", "crs", "units", "files", "camera", "sigma"),
    *("readings", "adjust"),
)
FRAME_KEYS = {
    "local": ("curvature", "radius", "origin", "axes"),
    "geocentric": ("ellipsoid", "radius"),
    "topocentric": ("latitude", "longitude", "height", "ellipsoid", "radius"),
}
"""Keys of [frame] by kind of frame."""
TABLE_ENDINGS = ("csv", "txt", "csv.txt")
"""Endings of names of files that may be meant as tables."""


def project_table_names() -> tuple[str, ...]:
    """Return the names of a project's tables; without [files], each is a file NAME.csv."""
    parameters = (parameter_table(k).file for k in parameter_kinds())
    named = ("points", "photos", "images", "observations", "covariances", "doubts", "readings")
    return (*named, *parameters)


@dataclass(frozen=True)
class Project:
    """A project as read: its network, and settings for files and reports."""

    network: Network
    """Observations and unknowns."""
    path: Path
    """The file that was read."""
    context: RecordContext = field(default_factory=RecordContext)
    """Defaults for further records of this project."""
    options: AdjustOptions = field(default_factory=AdjustOptions)
    """Options of the adjustment."""
    sources: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """File and line by entity (point, photo) and name."""
    warnings: tuple[Problem, ...] = ()
    """Files of the folder that are not read, but are named like a table, or nearly."""

    @property
    def units(self) -> Units:
        """Units of the project's files and reports."""
        return self.context.units

    def network_alone(self) -> Network:
        """Return the network without the project; a remark names the options that it leaves."""
        if self.options != AdjustOptions():
            self.network.remarks.append(self.options.remark)
        return self.network


def read_project(path: str | Path, *, allow_outside: bool = False) -> Network:
    """Read the network of a project.

    What ``[adjust]`` states, such as ``variance = "a-posteriori"``, is for the command: `adjust`
    and the other functions take it as arguments. A remark of the network says so, which reports
    print.

    Args:
        path: the TOML file, or the folder that has it as ``project.toml``.
        allow_outside: whether the project may name tables and a geoid outside its folder; through
            symbolic links it never may.

    Raises:
        InputError: all problems, each with file and line or key.
    """
    return load_project(path, allow_outside=allow_outside).network_alone()


def load_project(
    path: str | Path,
    *,
    readings: bool = True,
    allow_outside: bool = False,
    geoids: Collection[str] = (),
) -> Project:
    """Read a project: its network, units and options. Raises as `read_project` does.

    Args:
        path: as in `read_project`.
        readings: whether observations need observed values; a plan does not.
        allow_outside: as in `read_project`.
        geoids: paths of geoids that may lie outside the folder.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "project.toml"
    recover_folder(path.parent)
    problems: list[Problem] = []
    document, places = read_toml(path)
    top = FieldRow(document, path.name, problems)
    for key in (k for k in document if k not in PROJECT_KEYS):
        top.wrong(f"unknown key {key!r}; known: {known(PROJECT_KEYS, meant=key, most=40)}")
    units = _units(_table(document, "units", path.name, problems))
    datum = top.choice("datum", ("given", "free"), "given")
    frame = _frame(_table(document, "frame", path.name, problems), units)
    crs = _table(document, "crs", path.name, problems)
    section = read_crs_section(
        crs,
        path.parent,
        stated="crs" in document,
        allow_outside=allow_outside,
        geoids=geoids,
    )
    if section.grid and "frame" in document and isinstance(frame, LocalFrame):
        crs.wrong("coordinates of a grid need a topocentric or geocentric [frame], or none")
    network = Network(
        top.text("name", default="" if document.get("name") == "" else path.stem, title=True) or "",
        frame=section.frame if section.grid else frame,
        datum=cast(Literal["given", "free"], datum),
        crs=section.system,
    )
    dimension = top.take("dimension")
    if section.grid and dimension in (1, 2):
        crs.wrong(f"coordinates of a grid need all three dimensions, not dimension = {dimension}")
    if dimension not in (None, 1, 2, 3):
        top.wrong(f"unknown dimension {dimension!r}; valid: 1 (heights), 2 (plane), 3")
        dimension = 3
    axes = _cameras(document, network, path.name, problems)
    sigma = _sigma_defaults(document, path.name, problems)
    adjust = _table(document, "adjust", path.name, problems)
    refuse_other_keys(adjust, tuple(f.name for f in fields(AdjustOptions)))
    options = adjust_options(adjust)
    found_tables = _tables(_table(document, "files", path.name, problems), path, allow_outside)
    reader = UnknownsReader(network, units, cast(Dimension, dimension or 3), problems)
    reader.cameras_named = _names_cameras(document)
    readers: list[tuple[str, Callable[[CsvTable], None]]] = [
        ("points", reader.points),
        ("photos", reader.photos),
        *((parameter_table(k).file, partial(reader.parameters, kind=k)) for k in parameter_kinds()),
    ]
    for name, read in readers:
        table = found_tables.get(name)
        if table is not None:
            read(table)
        elif name in found_tables:
            reader.unreadable.add(name.removesuffix("s"))
    reader.carriers()
    images = {f.name: axes[f.camera] for f in network.photos.values() if f.camera in axes}
    context = RecordContext(units, sigma, images, axes)
    observations = ObservationsReader(network, context, problems, reader.unreadable, readings)
    if found_tables.get("images") is not None:
        observations.images(cast(CsvTable, found_tables["images"]))
    observations.with_covariances(found_tables.get("observations"), found_tables.get("covariances"))
    if found_tables.get("doubts") is not None:
        observations.doubts(cast(CsvTable, found_tables["doubts"]))
    stated = _table(document, "readings", path.name, problems)
    refuse_other_keys(stated, ("faces",))
    faces = stated.choice("faces", ("means", "both"), "means")
    if found_tables.get("readings") is not None:
        book = cast(CsvTable, found_tables["readings"])
        observations.complete &= read_readings(network, book, context, faces, problems)
    network.without_observations = without_observations(path, found_tables, "files" in document)
    warnings = tuple(_tables_not_read(path, found_tables, document.get("files")))
    with places.placing():
        if problems:
            # The structure can be checked in the same run only if every name is known.
            whole = reader.complete and observations.complete and None not in found_tables.values()
            found = check(network, sources=reader.sources) if whole else ()
            raise InputError([*warnings, *problems, *found])
        if section.grid:
            own = frame if "frame" in document else None
            network = section.moved(network, own, reader.sources)
    return Project(network, path, context, options, reader.sources, warnings)


# -- TOML -----------------------------------------------------------------------------------------


def _table(document: dict[str, Any], key: str, file: str, problems: list[Problem]) -> FieldRow:
    """Return a table of the document; a value that is not a table is noted and counts as empty."""
    value = document.get(key, {})
    if not isinstance(value, dict):
        problems.append(Problem(f"must be a table [{key}], not {value!r}", f"{file}: {key}"))
        value = {}
    return FieldRow(value, file, problems, f"[{key}]")


def _units(row: FieldRow) -> Units:
    known = tuple(f.name for f in fields(Units))
    refuse_other_keys(row, known)
    chosen = {k: row.text(k) for k in known if k in row}
    try:
        return Units(**{k: v for k, v in chosen.items() if v is not None})
    except InputError as error:
        for p in error.problems:
            row.wrong(f"{p.where}: {p.what}")
        return Units()


def _frame(row: FieldRow, units: Units) -> Frame:
    kind = row.choice("kind", FRAME_KEYS, "local")
    refuse_other_keys(row, ("kind", *FRAME_KEYS[kind]))
    name = row.choice("ellipsoid", ELLIPSOIDS, "GRS80")
    radius = row.number("radius", positive=True) or MEAN_EARTH_RADIUS
    try:
        if kind == "geocentric":
            return GeocentricFrame(name, radius)
        if kind == "topocentric":
            latitude = row.number("latitude", units.geographic, required=True)
            longitude = row.number("longitude", units.geographic, required=True)
            height = row.number("height", units.length)
            return TopocentricFrame(latitude or 0.0, longitude or 0.0, height or 0.0, name, radius)
        origin = row.take("origin")
        at = [0.0, 0.0, 0.0]
        if origin is not None:
            numbers = origin if isinstance(origin, list) else []
            inside = FieldRow(
                dict(zip("xyz", numbers, strict=False)), row.where, row.problems, row.of
            )
            at = [inside.number(a, units.length, required=True) or 0.0 for a in "xyz"]
            if len(numbers) > 3:
                row.wrong("origin must be three numbers x, y, z")
        axes = row.text("axes", default="en")
        return LocalFrame(row.flag("curvature"), radius, (at[0], at[1], at[2]), cast(Any, axes))
    except InputError as error:
        row.wrong_all(error)
        return LocalFrame()


def _cameras(
    document: dict[str, Any], network: Network, file: str, problems: list[Problem]
) -> dict[str, ImageAxes]:
    """Add the cameras; return the axes of their image coordinates in files."""
    entries = document.get("camera", [])
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        problems.append(Problem("cameras must be tables [[camera]]", f"{file}: camera"))
        return {}
    out: dict[str, ImageAxes] = {}
    for number, entry in enumerate(entries, start=1):
        row = FieldRow(entry, file, problems, f"[[camera]] {entry.get('name', number)!r}")
        name = row.text("name", required=True) or f"camera {number}"
        out[name] = read_camera_record(row, name, network)
    return out


def _names_cameras(document: dict[str, Any]) -> bool:
    """Return whether all cameras have names; those under a key that is misspelt have none."""
    entries = document.get("camera", [])
    if any(key not in PROJECT_KEYS and similar(key, ("camera",)) for key in document):
        return False
    return isinstance(entries, list) and all(
        isinstance(e, dict) and isinstance(e.get("name"), str) for e in entries
    )


def _sigma_defaults(
    document: dict[str, Any], file: str, problems: list[Problem]
) -> dict[str, dict[str, object]]:
    out: dict[str, dict[str, object]] = {}
    whole = _table(document, "sigma", file, problems)
    for kind, given in whole.fields.items():
        if kind not in KINDS:
            whole.wrong(f"unknown kind {kind!r}; valid: {known(KINDS, meant=kind, most=80)}")
            continue
        if not isinstance(given, dict):
            whole.wrong(f"{kind} must be a table [sigma.{kind}]")
            continue
        row = FieldRow(given, file, problems, f"[sigma.{kind}]")
        for name in given:
            what = unknown_field_message(name, (*sigma_fields(kind), *combine_fields(kind)))
            if what is not None:
                row.wrong(what.replace("column", "key"))
        check_positive(row, {k: v for k, v in given.items() if k in sigma_fields(kind)})
        row.choice("combine", COMBINATIONS, "mixed")
        # A bad default is noted once; the stand-in avoids a message for every row that uses it.
        out[kind] = placeholder_sigma(kind) if row.failed else given
    if whole.failed:
        return {kind: placeholder_sigma(kind) for kind in KINDS} | out
    return out


def _tables(row: FieldRow, path: Path, allow_outside: bool) -> dict[str, CsvTable | None]:
    """Read the tables that [files] names; without [files], those whose default file exists."""
    refuse_other_keys(row, project_table_names())
    stated = bool(row.fields)
    out: dict[str, CsvTable | None] = {}
    for name in project_table_names():
        needed = name == "points"
        file = row.text(name, default=None if stated and not needed else f"{name}.csv")
        if file is None or not (stated or needed or (path.parent / file).exists()):
            continue
        out[name] = None
        if why := astray(path.parent, file, allow_outside=allow_outside):
            row.wrong(f"{name} = {file!r} {why}")
        else:
            out[name] = read_table(path.parent / file, row.problems)
    return out


def _tables_not_read(
    path: Path, found: Mapping[str, CsvTable | None], named: object
) -> Iterator[Problem]:
    """Iterate over files that are named like a table that the project does not have, or nearly.

    Args:
        path: the TOML file of the project.
        found: the tables that the project has.
        named: [files] of the project; without it every table of its own name is read.
    """
    paths = named.values() if isinstance(named, dict) else ()
    read = {Path(p.replace("\\", "/")).as_posix() for p in paths if isinstance(p, str)}
    files = sorted({f.name for f in path.parent.iterdir()} - read)
    valid = project_table_names()
    missing = [name for name in valid if found.get(name) is None and f"{name}.csv" not in files]
    for file in files:
        stem, _, end = file.casefold().partition(".")
        own = file.removesuffix(".csv")
        if own in valid and own != file and own not in found:
            yield Problem(f"{file} is not read: [files] does not name it", f"{path.name}: [files]")
        if own in valid or end not in TABLE_ENDINGS:
            continue  # readings.csv is near to headings.csv, and a table of its own
        close = get_close_matches(stem, missing, 1, MIN_NAME_SIMILARITY)
        if close:
            yield Problem(f"is not read: the table is named {close[0]}.csv", file)
