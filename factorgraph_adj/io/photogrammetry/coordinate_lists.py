"""Lists of coordinates in a named reference system: positions of photos, and places in a frame.

A list names its system in the first line as ODM and OpenSfM do: ``WGS84``, ``EPSG:…``,
``WGS84 UTM 32N``, ``+proj=…``; longitude or easting comes first. Positions of photos are read from

- geo.txt of ODM: the system; then image, x, y, z, yaw, pitch, roll, horizontal and vertical
  accuracy and further text, with blanks between, of which what is at the end may be absent;
- tables with a header, with commas, semicolons or tabs: references of Metashape, whose first line
  may be ``# CoordinateSystem: `` with WKT, geolocations of Pix4D, ``exiftool -csv`` of photos of
  drones. `COLUMN_NAMES` has the names of columns.

Angles of drones are not read: bundle adjustment determines them better by far.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem
from ...frames import TopocentricFrame
from ...types import Array
from ..source import LeftOutReason, Problems, TextSource, is_unread

ANGLES_NOT_READ = LeftOutReason(
    "yaw, pitch and roll of photos", "bundle adjustment determines them better by far"
)
POSITIONS_WITHOUT_PHOTO = LeftOutReason("positions", "their images are not in the model")
LOST_POSITIONS = LeftOutReason(
    "positions of photos",
    "their images are not in the model, while images of it have no position",
    doubtful=True,
    kept=lambda network: sum(o.kind == "photo_position" for o in network.observations.values()),
)
COLUMN_NAMES = {
    "photo": ("label", "image", "imagename", "image name", "sourcefile", "filename", "photo"),
    "longitude": ("x/longitude", "longitude", "gpslongitude", "lon"),
    "latitude": ("y/latitude", "latitude", "gpslatitude", "lat"),
    "x": ("x/east", "x", "east", "easting"),
    "y": ("y/north", "y", "north", "northing"),
    "z": ("z/altitude", "z", "altitude", "gpsaltitude", "alt", "height"),
    "sigma_x": ("x accuracy", "accuracy_x_(m)", "rtkstdlon"),
    "sigma_y": ("y accuracy", "accuracy_y_(m)", "rtkstdlat"),
    "sigma_z": ("z accuracy", "accuracy_z_(m)", "rtkstdhgt", "accuracy vertical"),
    "sigma_plan": ("accuracy horizontal", "horizontal accuracy"),
    "sigma": ("accuracy_(m)", "accuracy (m)", "accuracy"),
    "angles": (
        *("yaw", "pitch", "roll", "omega", "phi", "kappa", "flightyawdegree"),
        *("gimbalyawdegree", "gimbalpitchdegree", "gimbalrolldegree"),
    ),
}
"""Names of columns in small letters, by what they are."""
WKT_LINE = "coordinatesystem:"
"""Beginning of the line in which Metashape states its system, behind #."""
DEGREES_IN_WORDS = re.compile(r"(\d+(?:\.\d+)?) deg (\d+(?:\.\d+)?)' (\d+(?:\.\d+)?)\"\s*([NSEW]?)")
"""Degrees as exiftool writes them: 44 deg 42' 4.14" N."""
HEIGHT_IN_WORDS = re.compile(r"([-+]?\d+(?:\.\d+)?)(?: m)?(?: (Above|Below) Sea Level)?")
"""Height as exiftool writes it."""


@dataclass(frozen=True)
class ListSystem:
    """Reference system of a list."""

    grid: ReferenceSystem | None = None
    """The projected system; None: longitude and latitude of WGS84, degrees."""

    def frame(self, places: Array) -> TopocentricFrame:
        """Return a topocentric frame in the middle of places (n, 3).

        Raises:
            InputError: a latitude or longitude is none.
        """
        if self.grid is not None:
            return self.grid.frame_at(places)
        for place in places:
            self._check(place)
        at = (places.min(axis=0) + places.max(axis=0)) / 2.0
        longitude, latitude = (math.radians(round(float(v), 6)) for v in at[:2])
        return TopocentricFrame(latitude, longitude, float(round(at[2])), "WGS84")

    def place(self, frame: TopocentricFrame, xyz: tuple[float, float, float]) -> Array:
        """Return the place (3,) in a frame of longitude, latitude, height, or of a grid place.

        Raises:
            InputError: a latitude or longitude is none.
        """
        at = np.array([xyz])
        if self.grid is not None:
            return np.asarray(self.grid.to_frame(frame, at)[0])
        self._check(at[0])
        ellipsoid = frame.geocentric.ellipsoid
        latitude, longitude = np.deg2rad(at[:, 1]), np.deg2rad(at[:, 0])
        there = frame.from_geocentric(ellipsoid.to_cartesian(latitude, longitude, at[:, 2]))
        return np.asarray(there[0])

    @staticmethod
    def _check(at: Array) -> None:
        if not (abs(at[1]) <= 90 and abs(at[0]) <= 360):
            raise InputError(Problem(f"latitude {at[1]:g}°, longitude {at[0]:g}° are none"))


def list_system(system: str) -> ListSystem:
    """Return the reference system that a list names.

    Raises:
        InputError: the system is unknown, or pyproj is missing.
    """
    words = system.upper().split()
    if words in (["WGS84"], ["EPSG:4326"]) or _is_wgs84(words):
        return ListSystem()
    if words[:2] == ["WGS84", "UTM"] and len(words) == 3:
        zone, south = words[2].rstrip("NS"), words[2].endswith("S")
        if zone.isascii() and zone.isdigit() and 1 <= int(zone[:3]) <= 60:
            code = (32700 if south else 32600) + int(zone)
            return ListSystem(ReferenceSystem(f"EPSG:{code}", heights="ellipsoidal").checked())
    wkt = re.match(r"(PROJCS|PROJCRS|GEOGCS|GEOGCRS|GEODCRS|LOCAL_CS)\[", system.strip())
    if wkt is not None and wkt[1].startswith("GEO") and re.search(r'"WGS[ _]?(19)?84"', system):
        return ListSystem()
    if not (words and (words[0].startswith("EPSG:") or "+PROJ" in words[0] or wkt is not None)):
        what = f"unknown reference system {system!r}; valid: WGS84, WGS84 UTM 32N, EPSG:…, +proj=…"
        raise InputError(Problem(what))
    return ListSystem(ReferenceSystem(system, heights="ellipsoidal").checked())


def _is_wgs84(words: list[str]) -> bool:
    """Return whether words are those of longitude and latitude of WGS84 in PROJ."""
    geographic = any(w in ("+PROJ=LONGLAT", "+PROJ=LATLONG") for w in words)
    return geographic and any(w in ("+DATUM=WGS84", "+ELLPS=WGS84") for w in words)


@dataclass(frozen=True)
class ListedPosition:
    """Position of a photo in a list."""

    photo: str
    """Name of the photo."""
    xyz: tuple[float, float, float]
    """Longitude, latitude, degrees, or easting and northing; height; NaN: unknown."""
    sigma: tuple[float, float, float] | None
    """Standard deviations in east, north, up, metres; None: the list has none."""
    where: str
    """File and line."""


@dataclass(frozen=True)
class PositionList:
    """List of positions of photos."""

    system: ListSystem
    """Its reference system."""
    positions: list[ListedPosition]
    """The positions."""


def read_positions(path: Path, problems: Problems, *, system: str | None = None) -> PositionList:
    """Read a list of positions of photos: geo.txt, or a table with a header.

    Args:
        path: the file.
        problems: gets what is wrong, each with file and line.
        system: reference system of a table that states none; longitude and latitude of WGS84 are
            taken from their own columns.

    Raises:
        InputError: the file cannot be read, or its system is unknown.
    """
    source = TextSource(path, problems)
    rows = list(source.filled())
    stated = system
    if rows and rows[0][1].lstrip("# ").lower().startswith(WKT_LINE):
        stated = system or rows[0][1].split(":", 1)[1].strip()
        rows = rows[1:]
    header = rows[0][1] if rows else ""
    separator = next((s for s in (";", "\t", ",") if s in header), "")
    if separator and not header.lstrip().startswith("+proj"):
        return _of_table(source, rows, separator, stated)
    rows = [(line, text) for line, text in rows if not text.lstrip().startswith("#")]
    if not rows:
        source.wrong(0, "is empty: the first line names the reference system, such as EPSG:4326")
        source.raise_all()
    line, text = rows[0]
    found = source.attempt(line, list_system, text.strip())
    source.raise_all()
    assert found is not None
    return PositionList(found, [p for row in rows[1:] if (p := _of_geo_line(source, *row))])


def _of_geo_line(source: TextSource, line: int, text: str) -> ListedPosition | None:
    """Return the position of a line of geo.txt; None after a problem."""
    words = text.split()
    if len(words) < 3:
        source.wrong(line, f"a row has image x y [z] …, not {len(words)} fields")
        return None
    x, y = (source.field(line, w, a).number() for a, w in zip("xy", words[1:3], strict=True))
    z = source.field(line, words[3], "z").number() if len(words) > 3 else math.nan
    if len(words) > 6:
        for word, what in zip(words[4:7], ("yaw", "pitch", "roll"), strict=True):
            source.field(line, word, what).number()
        source.leave_out(line, ANGLES_NOT_READ, words[0])
    sigma = None
    if len(words) > 8:
        h, v = (
            source.field(line, w, f"{what} accuracy").sigma()
            for w, what in zip(words[7:9], ("horizontal", "vertical"), strict=True)
        )
        sigma = None if is_unread(h, v) else (h, h, v)
    if is_unread(x, y):
        return None
    return ListedPosition(words[0], (x, y, z), sigma, source.place(line))


def _of_table(
    source: TextSource, rows: list[tuple[int, str]], separator: str, system: str | None
) -> PositionList:
    """Return the positions of a table with a header.

    Raises:
        InputError: the header lacks what is needed.
    """
    cells = [
        (line, [c.strip() for c in found])
        for line, text in rows
        if (found := next(csv.reader([text], delimiter=separator), []))
    ]
    line, titles = cells[0]
    column: dict[str, int] = {}
    for i, title in enumerate(titles):
        plain = title.lstrip("#").strip().lower()
        for name, spellings in COLUMN_NAMES.items():
            if plain in spellings:
                column.setdefault(name, i)
    geographic = "longitude" in column and "latitude" in column
    plan = ("longitude", "latitude") if geographic else ("x", "y")
    lacking = [n for n in ("photo", *plan) if n not in column]
    if lacking:
        known = "; ".join(f"{n}: {', '.join(COLUMN_NAMES[n])}" for n in lacking)
        source.wrong(line, f"the header has no column for {', '.join(lacking)}; valid: {known}")
    if not geographic and system is None:
        what = "the table states no reference system; valid: positions_system='EPSG:…'"
        source.wrong(line, what)
    source.raise_all()
    used = source.attempt(line, list_system, system or "WGS84")
    source.raise_all()
    assert used is not None
    if geographic and used.grid is not None:
        source.wrong(line, "longitude and latitude are in no projected system")
        source.raise_all()
    out = []
    for number, values in cells[1:]:
        if values[0].startswith("#"):
            continue  # a comment, such as the sums behind Metashape's rows
        given = {n: values[i] for n, i in column.items() if i < len(values)}
        position = _of_row(source, number, given, plan)
        if position is not None:
            out.append(position)
    return PositionList(used, out)


def _of_row(
    source: TextSource, line: int, given: dict[str, str], plan: tuple[str, str]
) -> ListedPosition | None:
    """Return the position of a row; None after a problem, or without one."""
    name = source.field(line, Path(given.get("photo", "").replace("\\", "/")).name, "photo").name()
    if not any(given.get(n) for n in plan):
        source.leave_out(line, LeftOutReason("rows", "they have no position"), name)
        return None
    x, y = (_degrees(source, line, given.get(n, ""), n) for n in plan)
    z = math.nan
    if given.get("z"):
        words = HEIGHT_IN_WORDS.fullmatch(given["z"])
        z = source.field(line, words[1] if words else given["z"], "height").number()
        z = -z if words is not None and words[2] == "Below" else z
    if given.get("angles"):
        source.leave_out(line, ANGLES_NOT_READ, name)
    both = given.get("sigma_plan") or given.get("sigma")
    texts = [
        given.get("sigma_x") or both,
        given.get("sigma_y") or both,
        given.get("sigma_z") or given.get("sigma"),
    ]
    sigma = None
    if all(texts):
        found = [source.field(line, t, "accuracy").sigma() for t in texts]
        sigma = None if is_unread(*found) else (found[0], found[1], found[2])
    if is_unread(name, x, y):
        return None
    return ListedPosition(name, (x, y, z), sigma, source.place(line))


def _degrees(source: TextSource, line: int, text: str, what: str) -> float:
    """Return a coordinate: a number, or degrees in words."""
    found = DEGREES_IN_WORDS.fullmatch(text)
    if found is None:
        return source.field(line, text, what).number()
    value = float(found[1]) + float(found[2]) / 60.0 + float(found[3]) / 3600.0
    return -value if found[4] in ("S", "W") else value
