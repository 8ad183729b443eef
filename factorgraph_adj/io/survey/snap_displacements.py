"""Displacements of SNAP's stations in time: offset files, and grids of velocities.

Format: LINZ, SNAP help, "SNAP station offset file format", "The deformation command" and "Grid file
format", and ``stnoffset.c``, ``grddeform.c``, ``griddata.c`` of the program (BSD-3).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from ...errors import InputError, Problem
from ...files import read_bytes
from ...frames import Frame
from ...models.unknown_registry import UNKNOWNS
from ...observations import Observation
from ...types import Array
from ..source import LeftOutReason, TextSource
from .snap_coordinates import SnapStations
from .snap_lines import decimal_year, parsed_date
from .snap_selections import JobLine
from .snap_systems import read_system

Mode: TypeAlias = Literal["step", "velocity", "time_series"]
COORDINATES = {"enu": 3, "xyz": 3, "height": 1}
"""Number of values of an offset by their sort."""
KINDS_OF_OFFSETS = {"offset": False, "deformation": True}
"""Whether an offset stands for the deformation model of its station."""
MODES: tuple[Mode, ...] = ("step", "velocity", "time_series")
DAYS_OF_YEAR = 365.25
"""Days of a year of velocities of offsets."""
OF_NO_STATION = LeftOutReason("offsets of stations", "the coordinate file does not have them")
GRID_FORMATS = {
    b"SNAP geoid binary file\r\n\x1a": 0,
    b"SNAP grid binary v1.0 \r\n\x1a": 1,
    b"SNAP grid binary v2.0 \r\n\x1a": 2,
}
"""Versions of grid files by their first bytes; rows of 2 are packed."""
UNDEFINED = {1: 0x7F, 2: 0x7FFF, 4: 0x7FFFFFFF}
"""Value of a node without one, by the number of bytes."""
LEAST_NODES = 4
"""Smallest number of rows and columns of a grid."""


@dataclass(frozen=True)
class StationOffset:
    """One offset of a station: its values are east, north, up or X, Y, Z, metres (a year)."""

    geocentric: bool
    """Whether the values are geocentric."""
    mode: Mode
    """How they depend on time."""
    before: tuple[float, ...]
    """Values of a time series before its first date; those of a step or velocity."""
    series: tuple[tuple[datetime, tuple[float, ...]], ...]
    """Dates with the values after them; of a step or velocity the date alone."""

    def at(self, date: datetime) -> Array:
        """Return its values at a date, (3,) metres."""
        before = np.array(self.before)
        (first, value), *_ = self.series
        if self.mode == "step":
            return before if date >= first else np.zeros(3)
        if self.mode == "velocity":
            return np.asarray(before * ((date - first).total_seconds() / 86400.0 / DAYS_OF_YEAR))
        if date < first:
            return before
        known, last = first, np.array(value)
        for then, values in self.series[1:]:
            if date < then:
                part = (date - known) / (then - known)
                return np.asarray(last + part * (np.array(values) - last))
            known, last = then, np.array(values)
        return last


@dataclass
class Displacements:
    """Where stations were at a date, beside their coordinates."""

    offsets: dict[str, list[StationOffset]] = field(default_factory=dict)
    """Offsets by code in capital letters."""
    replaced: set[str] = field(default_factory=set)
    """Codes of stations that no deformation model concerns."""
    velocities: VelocityGrid | None = None
    """Grid of velocities; None: there is none."""
    epoch: float = 0.0
    """Epoch of the coordinates, years."""

    def concerns(self, code: str) -> bool:
        """Return whether a station moves."""
        moving = self.velocities is not None and code.upper() not in self.replaced
        return moving or code.upper() in self.offsets

    def of(self, code: str, date: datetime, stations: SnapStations) -> Array:
        """Return the displacement of a station at a date, geocentric (3,), metres.

        Raises:
            InputError: the station is outside of the grid.
        """
        axes = stations.enu(code)
        out = np.zeros(3)
        if self.velocities is not None and code.upper() not in self.replaced:
            station = stations.by_code[code.upper()]
            moved = self.velocities.at(station.latitude, station.longitude, code)
            out += (decimal_year(date) - self.epoch) * (axes.T @ moved)
        for offset in self.offsets.get(code.upper(), ()):
            values = offset.at(date)
            out += values if offset.geocentric else axes.T @ values
        return out


# -- offsets --------------------------------------------------------------------------------------


def read_offsets(path: Path, at: JobLine, stations: SnapStations, found: Displacements) -> None:
    """Read a file of offsets; what is wrong is noted.

    Args:
        path: the file.
        at: the line of the job that names it.
        stations: stations of the job; offsets of others are left out.
        found: gets the offsets.
    """
    source = TextSource(path, at.source.problems, code_page="cp1252")
    for line, text in source.filled():
        if text.strip().startswith("!"):
            continue
        code, *words = text.split()
        before = source.problems.count
        sort = words.pop(0).lower() if words and words[0].lower() in COORDINATES else "enu"
        known = bool(words) and words[0].lower() in KINDS_OF_OFFSETS
        replaces = KINDS_OF_OFFSETS[words.pop(0).lower()] if known else False
        stated = words[0].lower() if words else ""
        mode: Mode = next((m for m in MODES if m == stated), "step")
        words = words[1:] if stated in MODES else words
        offset = _offset(source, line, sort, mode, words)
        if offset is None or source.problems.count > before:
            continue
        if stations.find(code) is None:
            source.leave_out(line, OF_NO_STATION, code)
            continue
        found.offsets.setdefault(code.upper(), []).append(offset)
        if replaces:
            found.replaced.add(code.upper())


def _offset(
    source: TextSource, line: int, sort: str, mode: Mode, words: list[str]
) -> StationOffset | None:
    """Return the offset of the words behind its sort; None after a problem."""
    size = COORDINATES[sort]

    def values() -> tuple[float, ...]:
        given = [words.pop(0) if words else None for _ in range(size)]
        out = [source.field(line, w, f"offset in {sort}").number() for w in given]
        return (0.0, 0.0, *out) if size == 1 else tuple(out)

    def date() -> datetime | None:
        text = words.pop(0) if words else ""
        # The date and the hour have a colon between them.
        made = parsed_date(text.replace(":", "T", 1))
        if made is None:
            valid = "2005-03-02, 2005-03-02:12:00:00"
            source.wrong(line, f"date {text[:40]!r} is none; valid: {valid}")
        return made

    series: list[tuple[datetime, tuple[float, ...]]] = []
    start = values() if mode == "time_series" else ()
    while words or not series:
        then = date()
        if then is None:
            return None
        if series and then <= series[-1][0]:
            source.wrong(line, f"the date {then:%Y-%m-%d} must be later than the one before")
        series.append((then, values()))
        if mode != "time_series":
            start = series[0][1]
            break
    if words:
        source.wrong(line, f"has {len(words)} words too many, from {words[0][:40]!r}")
        return None
    return StationOffset(sort == "xyz", mode, start, tuple(series))


# -- velocities -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class VelocityGrid:
    """Velocities at the nodes of a grid."""

    name: str
    """Name of the file."""
    system: str
    """Code of its coordinate system."""
    south: float
    """Latitude of the first row, degrees."""
    north: float
    """Latitude of the last row, degrees."""
    west: float
    """Longitude of the first column, degrees."""
    east: float
    """Longitude of the last column, degrees."""
    values: Array
    """East, north and, of three, up at the nodes from south and west, (rows, columns, 2 or 3),
    metres a year; NaN where a node has none."""

    def at(self, latitude: float, longitude: float, code: str) -> Array:
        """Return east, north, up of a place by bilinear interpolation, (3,) metres a year.

        Raises:
            InputError: the place is outside of the grid, or a node has no value.
        """
        rows, columns, size = self.values.shape
        y = (math.degrees(latitude) - self.south) / (self.north - self.south) * (rows - 1)
        turned = (math.degrees(longitude) - self.west) % 360.0
        x = turned / (self.east - self.west) * (columns - 1)
        if not (0.0 <= y <= rows - 1 and 0.0 <= x <= columns - 1):
            raise InputError(Problem(f"station {code!r} is outside of the grid {self.name}"))
        i, j = min(int(y), rows - 2), min(int(x), columns - 2)
        a, b = y - i, x - j
        corner = self.values[i : i + 2, j : j + 2]
        weights = np.array([[(1 - a) * (1 - b), (1 - a) * b], [a * (1 - b), a * b]])
        # A corner without a weight need not have a value.
        found = np.einsum("ij,ijk->k", weights, np.where(weights[..., None] > 0, corner, 0.0))
        if np.isnan(found).any():
            raise InputError(Problem(f"the grid {self.name} has no value at station {code!r}"))
        return np.concatenate([found, np.zeros(3 - size)])


class _GridBytes:
    """Bytes of a grid file, read one after another."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.place = 0

    def take(self, form: str) -> tuple[Any, ...]:
        out = struct.unpack_from(f"<{form}", self.data, self.place)
        self.place += struct.calcsize(f"<{form}")
        return out

    def text(self) -> str:
        (size,) = self.take("h")
        (text,) = self.take(f"{max(size, 0)}s")
        return str(text.split(b"\0")[0].decode("cp1252", errors="replace"))


def read_velocity_grid(path: Path) -> VelocityGrid:
    """Read a grid of velocities in SNAP's binary format (``.grd``, GRID1L and GRID2L).

    Raises:
        InputError: it is another file, is cut off, or has not two or three values a node.
    """
    data = read_bytes(path, path.name)
    version = next((v for begin, v in GRID_FORMATS.items() if data.startswith(begin)), 0)
    where = path.name
    if not version:
        what = "is no binary grid of SNAP with velocities; valid: GRID1L or GRID2L of makegrid"
        raise InputError(Problem(what, where))
    try:
        return _grid(_GridBytes(data), where, version)
    except (struct.error, ValueError) as error:
        raise InputError(Problem(f"the grid is damaged: {error}", where)) from None


def _grid(file: _GridBytes, where: str, version: int) -> VelocityGrid:
    """Return the grid of bytes, whose first ones are known."""
    file.place = len(next(iter(GRID_FORMATS)))
    (file.place,) = file.take("i")
    south, north, west, east, step = file.take("5d")
    # The last number says whether the grid may go around the Earth.
    rows, columns, size, _ = file.take("4h")
    if size not in (2, 3) or min(rows, columns) < LEAST_NODES:
        what = f"has {rows} × {columns} nodes of {size} values"
        valid = f"2 or 3 values (velocities), {LEAST_NODES} × {LEAST_NODES} nodes at least"
        raise InputError(Problem(f"{what}; valid: {valid}", where))
    if not (south < north and west < east and step > 0.0):
        raise ValueError("its limits are not in order")
    _, _, _, system = (file.text() for _ in range(4))
    places = file.take(f"{rows}i")
    read = _plain_row if version == 1 else _packed_row
    values = np.empty((rows, columns, size))
    for i, place in enumerate(places):
        file.place = place
        values[i] = read(file, columns, size)
    return VelocityGrid(where, system, south, north, west, east, step * values)


def _plain_row(file: _GridBytes, columns: int, size: int) -> Array:
    """Return a row of 16-bit integers, (columns, size); NaN where a node has no value."""
    found = np.array(file.take(f"{columns * size}h"), dtype=float).reshape(columns, size)
    return np.where(found == UNDEFINED[2], np.nan, found)


def _packed_row(file: _GridBytes, columns: int, size: int) -> Array:
    """Return a row in sections of values or their first or second differences, (columns, size)."""
    out = np.full((columns, size), np.nan)
    for component in range(size):
        begin, goes_on = 0, True
        while goes_on:
            (form,) = file.take("h")
            part, goes_on = bool(form & 1), bool(form & 2)
            differences, width = form >> 2 & 3, form >> 4
            if differences > 2 or width not in UNDEFINED:
                raise ValueError(f"a row has the form {form}")
            if goes_on and not part:  # the rest of the row has no values
                break
            first, last = file.take("2h") if part else (begin, columns - 1)
            if not begin <= first <= last < columns:
                raise ValueError(f"a section from {first} to {last} of {columns} columns")
            starts = [file.take("i")[0] for _ in range(differences)]
            letter = {1: "b", 2: "h", 4: "i"}[width]
            given = file.take(f"{last + 1 - first}{letter}")
            out[first : last + 1, component] = _summed(given, starts, UNDEFINED[width])
            begin = last + 1
    return out


def _summed(given: tuple[int, ...], starts: list[int], undefined: int) -> list[float]:
    """Return the values of a section; that of its first node is stated where it has differences."""
    if not starts:
        return [math.nan if v == undefined else float(v) for v in given]
    value, *slope = starts
    out = [float(value)]
    for v in given[1:]:
        if v == undefined:
            out.append(math.nan)
            continue
        if slope:
            slope[0] += v
        value += slope[0] if slope else v
        out.append(float(value))
    return out


def read_velocities(at: JobLine, path: Path | None) -> VelocityGrid | None:
    """Return the grid of a job; None after a problem, which is noted."""
    if path is None:
        at.wrong("the velocity grid (model=FILE) is not there")
        return None
    return at.source.attempt(at.line, read_velocity_grid, path)


def refuse_other_datum(at: JobLine, grid: VelocityGrid, stations: SnapStations) -> None:
    """Refuse a grid in another datum than that of the stations."""
    system = read_system(at.source.field(at.line, grid.system, "coordinate system of the grid"))
    if system is None:
        return
    if system.system.form != "geodetic":
        at.wrong(f"velocities in {grid.system}; valid: in latitude and longitude")
    if system.system.datum != stations.system.datum:
        at.wrong(
            f"velocities in {grid.system} and stations in {stations.system.code}: no "
            "transformation between datums is read"
        )


# -- readings -------------------------------------------------------------------------------------


def at_epoch(observation: Observation, frame: Frame, moved: Callable[[str], Array]) -> Observation:
    """Return an observation as if its stations had not been displaced.

    Its value v becomes v − (f(X + d) − f(X)), with f at the approximate coordinates X: the change
    of d with them is of the second order, d·dX/S.

    Args:
        observation: the observation, with stations whose coordinates ``moved`` knows.
        frame: frame of the network.
        moved: coordinates (3,), displacement (3,) and deflections ξ, η (2,) of a station, (8,).
    """
    record = observation.record
    assert record.model is not None  # readings of SNAP have one
    number = float(observation.value)  # type: ignore[attr-defined]
    value = np.array([number])
    constants = {c: np.array([getattr(observation, c)], dtype=float) for c in record.constants}
    computed = []
    for share in (0.0, 1.0):
        arrays: list[Array | None] = []
        for kind, attribute in record.variables:
            name = getattr(observation, attribute)
            if kind in ("point", "vertical"):
                station = moved(name)
                at = station[:3] + share * station[3:6] if kind == "point" else station[6:]
                arrays.append(at[None])
            else:
                # Scales, refraction and orientations are small, or the same at both places.
                unknown = UNKNOWNS[kind]
                size = len(unknown.components) + len(unknown.constants)
                arrays.append(np.zeros((1, size)))
        found = record.model(frame, *arrays, observed=value[None], **constants)
        computed.append(found.residual[0])
    change = computed[1] - computed[0]
    if record.circular:
        change = np.remainder(change + np.pi, 2.0 * np.pi) - np.pi
    (corrected,) = (value - change).tolist()
    return replace(observation, value=corrected)  # type: ignore[call-arg]
