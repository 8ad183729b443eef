"""Coordinate file of SNAP (``.crd``): stations with geoid heights, deflections, classifications.

Format: LINZ, SNAP help, "SNAP station coordinate file format", and ``networkr.c`` of the program.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...types import Array
from ...units import ANGLE, ARCSEC
from ..source import Field, Problems, TextSource
from .snap_lines import records
from .snap_systems import SnapSystem, SystemCode, read_system

OPTION_WORDS = {
    "geoid": ("deflections", "geoid_heights"),
    "deflections": ("deflections",),
    "geoid_heights": ("geoid_heights",),
    "degrees": ("degrees",),
    "ellipsoidal_heights": ("ellipsoidal_heights",),
    "orthometric_heights": ("orthometric_heights",),
}
"""What the words of the options line switch on; with ``no_`` in front they switch it off."""
WITHOUT_OPTIONS = frozenset(("deflections", "geoid_heights"))
"""Columns of files without ``options``."""
ORDER = "order"
"""Classification of the option ``station_orders``."""
DMS_FIELDS = ("degrees", "minutes", "seconds", "hemisphere")
HEMISPHERES = {"latitude": {"N": 1.0, "S": -1.0}, "longitude": {"E": 1.0, "W": -1.0}}


@dataclass(frozen=True)
class SnapStation:
    """A station."""

    code: str
    """Its code."""
    latitude: float
    """Geodetic latitude φ, radians."""
    longitude: float
    """Geodetic longitude λ, radians."""
    height: float
    """Ellipsoidal height h, metres."""
    undulation: float
    """Geoid height N, metres."""
    xi: float
    """Deflection ξ, radians, north positive."""
    eta: float
    """Deflection η, radians, east positive."""
    classes: tuple[tuple[str, str], ...]
    """Names of classifications in small letters, and the values of the station."""
    name: str
    """Name in words."""
    xyz: tuple[float, float, float]
    """Geocentric X, Y, Z, metres."""
    place: str
    """File and line."""

    @property
    def orthometric(self) -> float:
        """Height above the geoid, h − N, metres."""
        return self.height - self.undulation


@dataclass
class SnapStations:
    """Stations of a job; codes are found whatever the case of their letters."""

    system: SnapSystem
    """Coordinate system of the file."""
    title: str
    """Name of the network."""
    by_code: dict[str, SnapStation]
    """Stations by code in capital letters."""
    recoded: set[str] = field(default_factory=set)
    """Codes of stations that recodings have added."""

    def find(self, code: str) -> SnapStation | None:
        """Return the station of a code; None if there is none."""
        return self.by_code.get(code.upper())

    def geodetic(self, codes: Sequence[str]) -> tuple[Array, Array, Array]:
        """Return φ, λ (n,) rad and h (n,) m of stations."""
        at = [self.by_code[c.upper()] for c in codes]
        values = np.array([(s.latitude, s.longitude, s.height) for s in at])
        return values[:, 0], values[:, 1], values[:, 2]

    def up(self, code: str) -> Array:
        """Return the normal of the ellipsoid at a station, (3,)."""
        return np.asarray(self.enu(code)[2])

    def enu(self, code: str) -> Array:
        """Return unit vectors east, north, up of the ellipsoid at a station as rows, (3, 3)."""
        s = self.by_code[code.upper()]
        return horizon(s.latitude, s.longitude)


def horizon(latitude: float, longitude: float) -> Array:
    """Return unit vectors east, north and up as rows, (3, 3)."""
    sp, cp, sl, cl = (f(v) for v in (latitude, longitude) for f in (math.sin, math.cos))
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


def dms_angle(fields: Sequence[Field]) -> float:
    """Return the angle of fields degrees, minutes and seconds, radians; NaN after a problem."""
    degrees, minutes, seconds = (f.number(least=0.0) for f in fields)
    for f, value in zip(fields[1:], (minutes, seconds), strict=True):
        if value >= 60.0:
            f.wrong(f"must be less than 60, not {f.value}")
            return math.nan
    return (degrees * 3600.0 + minutes * 60.0 + seconds) * ARCSEC


def read_coordinate_file(path: Path, problems: Problems) -> SnapStations | None:
    """Return the stations of a coordinate file; None after a problem of its header."""
    source = TextSource(path, problems, code_page="cp1252")
    lines = list(records(source))
    if len(lines) < 2:
        source.wrong(0, "needs a title and the code of a coordinate system in its first lines")
        return None
    (_, title), (line, text) = lines[:2]
    stated = read_station_system(source, line, text)
    if stated is None:
        return None
    rest = lines[2:]
    has: set[str] = set(WITHOUT_OPTIONS)
    classes: list[str] = []
    if rest and rest[0][1].split()[0].lower() in ("options", "no_geoid"):
        line, text = rest.pop(0)
        has, classes = _options(source, line, text.split())
    if stated.vertical and "geoid_heights" not in has:
        source.wrong(
            line,
            f"geoid heights of {stated.vertical} are in a grid of SNAP that is not read; valid: "
            "geoid heights and deflections in this file, as snapgeoid writes them",
        )
    system = stated.system
    orthometric = "orthometric_heights" in has and system.form != "geocentric"
    if stated.vertical and "ellipsoidal_heights" not in has:
        orthometric = True
    reader = _StationLines(source, system, has, classes)
    for line, text in rest:
        reader.read(line, text)
    made = stations_of_rows(source, system, reader.rows, orthometric=orthometric)
    return SnapStations(system, title.strip(), made)


def read_station_system(source: TextSource, line: int, code: str) -> SystemCode | None:
    """Return the system of stations; None after a problem."""
    stated = read_system(source.field(line, code, "coordinate system"))
    if stated is not None and stated.system.bearings_only:
        source.wrong(
            line,
            f"coordinates of {stated.system.code} have in SNAP a unit of 0.999998261 m, which EPSG "
            "does not have; valid: coordinates of NZGD1949, converted by snapconv",
        )
        return None
    return stated


def _options(source: TextSource, line: int, words: list[str]) -> tuple[set[str], list[str]]:
    """Return what the columns of an options line are, and its classifications."""
    first = words[0].lower()
    has: set[str] = set() if first == "options" else set(WITHOUT_OPTIONS)
    classes: list[str] = []
    for word in words[1:] if first == "options" else words:
        low = word.lower()
        name = low.removeprefix("no_")
        if low.startswith("c=") and len(low) > 2:
            classes.append(low[2:])
        elif name == "station_orders":
            classes += [ORDER] if low == name else []
        elif name in OPTION_WORDS:
            change = has.update if low == name else has.difference_update
            change(OPTION_WORDS[name])
            if name.endswith("_heights") and name != "geoid_heights":
                has -= {"ellipsoidal_heights", "orthometric_heights"} - {name}
        else:
            valid = {*OPTION_WORDS, *(f"no_{n}" for n in OPTION_WORDS), "station_orders", "c=NAME"}
            source.field(line, low, "option").word(sorted(valid))
    return has, list(dict.fromkeys(classes))


@dataclass(frozen=True)
class StationRow:
    """A station as a file states it."""

    line: int
    """Line of the file."""
    code: str
    """Its code."""
    coordinates: list[float]
    """φ, λ (radians) and height; X, Y, Z; or easting, northing, height; metres."""
    geoid: list[float]
    """Deflections ξ, η (radians), geoid height (metres)."""
    classes: tuple[tuple[str, str], ...]
    """Names of classifications in small letters, and their values."""
    name: str
    """Name in words."""


class StationRows:
    """Rows of a file by code, which it states once."""

    def __init__(self, source: TextSource) -> None:
        """Start without rows."""
        self.source = source
        self.by_code: dict[str, StationRow] = {}
        """Rows by code in capital letters."""

    def add(self, row: StationRow) -> None:
        """Add a row."""
        first = self.by_code.setdefault(row.code.upper(), row)
        if first is not row:
            already = f"station {row.code!r} is there already, in line {first.line}"
            self.source.wrong(row.line, already)


class _StationLines:
    """Reads lines of stations."""

    def __init__(
        self, source: TextSource, system: SnapSystem, has: set[str], classes: list[str]
    ) -> None:
        """Take what columns the lines have."""
        self.source = source
        self.system = system
        self.has = has
        self.classes = classes
        self.rows = StationRows(source)

    def read(self, line: int, text: str) -> None:
        """Read one line: code, coordinates, deflections, geoid height, classes, name."""
        words = text.split()
        code = words.pop(0)
        before = self.source.problems.count
        coordinates = self._coordinates(line, words)
        geoid = [0.0, 0.0, 0.0]
        for column, places, unit in (("deflections", (0, 1), ARCSEC), ("geoid_heights", (2,), 1.0)):
            if column in self.has:
                for i in places:
                    what = ("deflection xi", "deflection eta", "geoid height")[i]
                    geoid[i] = self._next(line, words, what).number(scale=unit)
        classes = [self._next(line, words, f"classification {c}").name() for c in self.classes]
        if self.source.problems.count > before:
            return
        name = " ".join(words) or code
        of_classes = tuple(zip(self.classes, classes, strict=True))
        self.rows.add(StationRow(line, code, coordinates, geoid, of_classes, name))

    def _next(self, line: int, words: list[str], what: str) -> Field:
        return self.source.field(line, words.pop(0) if words else None, what)

    def _coordinates(self, line: int, words: list[str]) -> list[float]:
        """Return φ, λ (rad), h of a line; X, Y, Z; or E, N, H."""
        form = self.system.form
        if form == "geocentric":
            return [self._next(line, words, axis).number() for axis in "XYZ"]
        if form == "projection":
            names = ("easting", "northing", "height")
            return [self._next(line, words, name).number() for name in names]
        out = []
        for what, signs in HEMISPHERES.items():
            if "degrees" in self.has:
                out.append(self._next(line, words, what).number(scale=ANGLE["deg"]))
                continue
            fields = [self._next(line, words, f"{part} of {what}") for part in DMS_FIELDS]
            angle = dms_angle(fields[:3])
            fields[3].value = str(fields[3].value or "").upper()
            sign = fields[3].choice(signs)
            out.append(angle * (math.nan if sign is None else sign))
        if abs(out[0]) > math.pi / 2:
            self.source.wrong(line, "the latitude must be from -90 to 90 degrees")
        return [*out, self._next(line, words, "height").number()]


def stations_of_rows(
    source: TextSource, system: SnapSystem, given: StationRows, *, orthometric: bool
) -> dict[str, SnapStation]:
    """Return the stations of rows by code in capital letters; what is wrong is noted.

    Args:
        source: the file.
        system: system of the coordinates.
        given: the rows.
        orthometric: whether heights are above the geoid.
    """
    rows = list(given.by_code.values())
    if not rows:
        return {}
    values = np.array([row.coordinates for row in rows])
    ell = system.ellipsoid
    try:
        if system.form == "projection":
            level = np.column_stack([values[:, :2], np.zeros(len(rows))])
            checked = system.reference_system.checked()
            latitude, longitude, _ = checked.to_geodetic(level, [row.code for row in rows])
            height = values[:, 2]
        elif system.form == "geocentric":
            latitude, longitude, height = ell.to_geodetic(values)
        else:
            latitude, longitude, height = values.T
    except InputError as error:
        lines = {f"point {row.code!r}": row.line for row in rows}
        for p in error.problems:
            source.wrong(lines.get(p.where, 0), p.what)
        return {}
    if orthometric:
        height = height + np.array([row.geoid[2] for row in rows])
    xyz = ell.to_cartesian(latitude, longitude, height).tolist()
    return {
        row.code.upper(): SnapStation(
            row.code,
            float(latitude[i]),
            float(longitude[i]),
            float(height[i]),
            row.geoid[2],
            row.geoid[0],
            row.geoid[1],
            row.classes,
            row.name,
            tuple(xyz[i]),
            source.place(row.line),
        )
        for i, row in enumerate(rows)
    }
