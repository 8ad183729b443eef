"""Lists of coordinates in a named reference system: positions of photos, and places in a frame.

A list names its system in the first line as ODM and OpenSfM do: ``WGS84``, ``EPSG:…``,
``WGS84 UTM 32N``, ``+proj=…``; longitude or easting comes first. Positions of photos are read from

- geo.txt of ODM: the system; then image, x, y, z, yaw, pitch, roll, horizontal and vertical
  accuracy and further text, with blanks between, of which what is at the end may be absent;
- .MRK of DJI (Timestamp.MRK): number of the photo in its folder, time, offsets of the antenna that
  are applied already, latitude, longitude, ellipsoidal height of the camera, σ in north, east and
  elevation (m), RTK status (manuals of DJI, such as that of Zenmuse P1, Data Storage);
- tables with a header, with commas, semicolons or tabs: references of Metashape, whose first line
  may be ``# CoordinateSystem: `` with WKT, geolocations of Pix4D, ``exiftool -csv`` of photos of
  drones. `COLUMN_NAMES` has the names of columns.

Angles of drones are not read: bundle adjustment determines them better by far.

Ground control and positions come with the same mistakes: another zone or system, and x and y in the
other order. A place far from the frame of a block shows the first. The second makes a mirror image
of the figure that the block has of the same places, which a similarity fits badly, and well after
an exchange.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem
from ...frames import TopocentricFrame
from ...models.similarity import extent_ratio, fit_similarity, near_median, reduced
from ...types import Array
from ..format_options import option_text
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
MAX_DISTANCE_FROM_FRAME_M = 100e3
"""Largest level distance of a listed place from the origin of the frame of its block, metres."""
METRES_OF_DEGREE = 111e3
"""Length of a degree of latitude, metres, roughly."""
MIN_PLACES_OF_ORDER = 3
"""Smallest number of places that show an exchange: of three, degrees of unlike length do."""
MAX_MISFIT_SHARE_OF_THREE = 0.03
"""As `MAX_MISFIT_SHARE_EXCHANGED`, for three places, which chance makes fit more easily."""
MIN_MISFIT_OF_ORDER = 1e-3
"""Smallest misfit, relative to the extent of the places, that an exchange may explain."""
MAX_MISFIT_SHARE_EXCHANGED = 0.3
"""Largest share of the misfit that is left after an exchange that explains it. Errors of positions
leave as much in both orders: they make no share smaller than about 1."""
ORDER_OF_LINES = (
    "longitude or easting comes first, and the first line of the list names the system and its zone"
)
"""What tells the coordinates of a list of lines apart."""
ORDER_OF_COLUMNS = (
    "columns named longitude and latitude, or x (easting) and y (northing); the system and its "
    "zone are those of the first line, or of positions_system"
)
"""The same of a table with a header."""
ORDER_OF_MRK = "degrees marked Lat and Lon"
"""The same of .MRK."""
MRK_ROW = re.compile(
    r"(\d+)\s+[\d.]+\s+\[\d+\]\s+(\S+),N\s+(\S+),E\s+(\S+),V\s+(\S+),Lat\s+(\S+),Lon\s+"
    r"(\S+),Ellh\s+([^\s,]+),\s*([^\s,]+),\s*([^\s,]+)\s+(\d+),Q"
)
"""Row of .MRK."""
MRK_BEGINNING = re.compile(r"\d+\s+[\d.]+\s+\[\d+\]\s+\S+,N\s")
"""Beginning of its first row."""
MRK_NO_POSITION, MRK_FIXED = 0, 50
"""RTK status without a position, and of fixed ambiguities, whose σ are accuracies."""
MRK_WITHOUT_POSITION = LeftOutReason("positions", "their RTK status is 0: there was no position")
WGS84_GEODETIC = "EPSG:4326"
"""Geodetic system of frames on the ellipsoid WGS84."""
NUMBER_IN_HEADER = re.compile(r"[-+]?\d+\.\d+")
"""A coordinate where the name of a column should be."""
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
        """Return a topocentric frame in the middle of places (n, 3), but for those far off.

        Raises:
            InputError: a latitude or longitude is none.
        """
        if self.grid is not None:
            return self.grid.frame_at(near_median(places, MAX_DISTANCE_FROM_FRAME_M))
        for place in places:
            self._check(place)
        places = near_median(places, MAX_DISTANCE_FROM_FRAME_M / METRES_OF_DEGREE)
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
            return np.asarray(_grid_for(self.grid, frame.ellipsoid_name).to_frame(frame, at)[0])
        self._check(at[0])
        ellipsoid = frame.geocentric.ellipsoid
        latitude, longitude = np.deg2rad(at[:, 1]), np.deg2rad(at[:, 0])
        there = frame.from_geocentric(ellipsoid.to_cartesian(latitude, longitude, at[:, 2]))
        return np.asarray(there[0])

    def exchanged(self, frame: TopocentricFrame, places: Array) -> Array:
        """Return places in a frame (n, 3) with x and y of the list exchanged; NaN: invalid."""
        if self.grid is not None:
            listed = _grid_for(self.grid, frame.ellipsoid_name).from_frame(frame, places)
        else:
            geodetic = frame.geodetic(places)
            assert geodetic is not None
            latitude, longitude, height = geodetic
            listed = np.column_stack([np.rad2deg(longitude), np.rad2deg(latitude), height])
        out = np.full(places.shape, np.nan)
        for i, (x, y, z) in enumerate(listed.tolist()):
            try:
                out[i] = self.place(frame, (y, x, z))
            except InputError:  # it is no place in the system
                break
        return out

    @staticmethod
    def _check(at: Array) -> None:
        if not (abs(at[1]) <= 90 and abs(at[0]) <= 360):
            raise InputError(Problem(f"latitude {at[1]:g}°, longitude {at[0]:g}° are none"))


@lru_cache(maxsize=16)
def _grid_for(grid: ReferenceSystem, ellipsoid_name: str) -> ReferenceSystem:
    """Return the system of a list for a frame on an ellipsoid.

    Lists in ETRS89 and other systems lead to a frame of WGS84, such as that of OpenSfM, by PROJ's
    best operation, which is that of no change for ETRS89.
    """
    if ellipsoid_name == "WGS84" and grid.ellipsoid.name != ellipsoid_name:
        return replace(grid, datum=WGS84_GEODETIC).checked()
    return grid


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
class ListedSystem:
    """System and order of the coordinates of a list, for places of a block."""

    system: ListSystem
    """The reference system."""
    order: str
    """What says which coordinate is which, and in which system they are, in words."""
    where: str
    """Name of the file."""

    def place(
        self, frame: TopocentricFrame, xyz: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """Return a listed place in the frame of a block.

        Raises:
            InputError: it is no place, or more than `MAX_DISTANCE_FROM_FRAME_M` away.
        """
        x, y, z = self.system.place(frame, xyz).tolist()
        if not np.hypot(x, y) <= MAX_DISTANCE_FROM_FRAME_M:
            away = np.linalg.norm([x, y, z]) / 1e3
            origin = f"{np.rad2deg(frame.latitude):g}°, {np.rad2deg(frame.longitude):g}°"
            what = f"lies {away:.0f} km from latitude, longitude {origin} of the frame"
            valid = f"up to {MAX_DISTANCE_FROM_FRAME_M / 1e3:.0f} km; {self.order}"
            raise InputError(Problem(f"{what}; valid: {valid}"))
        return x, y, z

    def remark(self, frame: TopocentricFrame) -> tuple[str, ...]:
        """Return what a reader of a network in a frame is to know of the system; () if nothing."""
        grid = self.system.grid
        if grid is None or _grid_for(grid, frame.ellipsoid_name) is grid:
            return ()
        return (
            f"{self.where}: places were carried from {grid.name} to WGS 84 by PROJ's best "
            "operation, whose accuracy may be metres, the same for all places",
        )

    def problem_of_order(self, frame: TopocentricFrame, block: Array, listed: Array) -> str:
        """Return what shows that x and y of the list are exchanged; empty: nothing does.

        Args:
            frame: frame of the listed places.
            block: places as the block has them, of any scale and place, (n, 3).
            listed: the same places as the list has them, in the frame, (n, 3).
        """
        if len(block) < MIN_PLACES_OF_ORDER or not extent_ratio(block) > MIN_MISFIT_OF_ORDER:
            return ""
        stated = _relative_misfit(block, listed)
        other = _relative_misfit(block, self.system.exchanged(frame, listed))
        three = len(block) == MIN_PLACES_OF_ORDER
        share = MAX_MISFIT_SHARE_OF_THREE if three else MAX_MISFIT_SHARE_EXCHANGED
        if not (stated > MIN_MISFIT_OF_ORDER and other < share * stated):
            return ""
        return (
            f"its {len(block)} places fit those of the block to {100 * stated:.2g} % of their "
            f"extent, and with x and y exchanged to {100 * other:.2g} %; valid: {self.order}"
        )


def _relative_misfit(x: Array, to: Array) -> float:
    """Return the root mean square misfit of a similarity, relative to the extent of the places."""
    if not np.isfinite(to).all():
        return np.inf
    by = fit_similarity(x, to)
    size = float(np.linalg.norm(reduced(to)))
    return float(np.linalg.norm(by.of(x) - to)) / size if size > 0 and by.scale > 0 else np.inf


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
    why_no_sigma: str = ""
    """Why there are no standard deviations."""


@dataclass(frozen=True)
class PositionList:
    """List of positions of photos."""

    listed: ListedSystem
    """Its reference system, and the order of its coordinates."""
    positions: list[ListedPosition]
    """The positions."""
    by_number: bool = False
    """Whether a photo is named by the number in the name of its file, such as 7 of …_0007.JPG."""


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
    if MRK_BEGINNING.match(header.strip()):
        listed = ListedSystem(ListSystem(), ORDER_OF_MRK, path.name)
        marked = [p for row in rows if (p := _of_mrk_row(source, *row))]
        return PositionList(listed, marked, by_number=True)
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
    listed = ListedSystem(found, ORDER_OF_LINES, path.name)
    return PositionList(listed, [p for row in rows[1:] if (p := _of_geo_line(source, *row))])


def _of_mrk_row(source: TextSource, line: int, text: str) -> ListedPosition | None:
    """Return the position of a row of .MRK; None after a problem, or without a position."""
    found = MRK_ROW.fullmatch(text.strip())
    if found is None:
        what = "a row has number, time, [week], …,N …,E …,V …,Lat …,Lon …,Ellh σ, σ, σ …,Q"
        source.wrong(line, what)
        return None
    name, *texts, status = found.groups()
    for word, what in zip(texts[:3], ("offset N", "offset E", "offset V"), strict=True):
        source.field(line, word, what).number()
    at = [
        source.field(line, t, w).number()
        for t, w in zip(texts[3:6], ("latitude", "longitude", "height"), strict=True)
    ]
    if int(status) == MRK_NO_POSITION:
        source.leave_out(line, MRK_WITHOUT_POSITION, name)
        return None
    sigma = [
        source.field(line, t, w).sigma()
        for t, w in zip(texts[6:], ("σ north", "σ east", "σ elevation"), strict=True)
    ]
    if is_unread(*at, *sigma):
        return None
    xyz, where = (at[1], at[0], at[2]), source.place(line)
    if int(status) != MRK_FIXED:
        why = f"RTK status {status} is not {MRK_FIXED}, fixed: its σ are no accuracies"
        return ListedPosition(name, xyz, None, where, why)
    return ListedPosition(name, xyz, (sigma[1], sigma[0], sigma[2]), where)


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
        what = f"the header has no column for {', '.join(lacking)}; valid: {known}"
        if any(NUMBER_IN_HEADER.fullmatch(t) for t in titles):
            what += (
                "; a table without a header, as Pix4D writes it, needs one, such as "
                "image,latitude,longitude,altitude"
            )
        source.wrong(line, what)
    if not geographic and system is None:
        option = option_text("positions_system", "EPSG:…")
        what = f"the table states no reference system; valid: {option}"
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
    return PositionList(ListedSystem(used, ORDER_OF_COLUMNS, source.path.name), out)


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
