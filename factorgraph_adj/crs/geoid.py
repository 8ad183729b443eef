"""Undulations and deflections of the vertical: from grids (PROJ, NTv2), tables, a constant.

A geoid is a grid (GTX or GeoTIFF through PROJ, NTv2 with deflections), a table of points, or a
stated constant. Interpolation is bilinear in the grids that PROJ reads, and bicubic in NTv2.

A geoid in the format NTv2 (.gsb), as AUSGeoid has it, has 11 records of 16 bytes for the whole,
then for each sub-grid 11 records of its limits and one record of four 4-byte floats for each node:
N in metres, ξ and η in seconds of arc, and a fourth number that is not used here. Rows go from
south to north, and within a row from east to west: longitudes count positive to the west. Source:
Natural Resources Canada, NTv2 developer's guide; Geoscience Australia, AUSGeoid technical
documentation.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import InputError, Problem, known
from ..files import opened, read_bytes
from ..frames import MEAN_EARTH_RADIUS
from ..types import Array
from ..units import ANGLE, ARCSEC
from . import proj

NTV2_RECORD_BYTES = 16
NTV2_HEADER_RECORDS = 11
NTV2_UNITS_RAD = {"SECONDS": ARCSEC, "MINUTES": ANGLE["arcmin"], "DEGREES": ANGLE["deg"]}
"""Units of limits and steps, radians."""

MAX_NODES_OF_SUB_GRID = 200_000_000
"""Largest number of nodes of a sub-grid; a larger one is a damaged file."""
SLOPE_STEP_RAD = 1e-4
"""Half the distance of the places between which a slope of the geoid is taken, radians: 640 m."""
MAX_UNDULATION_M = 200.0
"""Largest undulation that is believed, metres; on the Earth it stays within about ±110 m."""
GEOID_SUFFIXES = (".gtx", ".tif", ".tiff", ".gsb", ".csv", ".geo")
"""Suffixes of files of geoids."""
GEOID_TABLE_COLUMNS = ("point", "n", "xi", "eta")


@dataclass(frozen=True, eq=False)
class SubGrid:
    """Nodes of one sub-grid."""

    name: str
    """Its name."""
    south: float
    """Latitude of the first row, radians."""
    east: float
    """Longitude of the first column, radians, positive to the west."""
    latitude_step: float
    """Step from row to row, radians."""
    longitude_step: float
    """Step from column to column, radians."""
    values: Array
    """N (m), ξ and η (rad) of the nodes, (rows, columns, 3)."""

    def at(self, latitude: Array, longitude: Array) -> Array:
        """Return N, ξ, η at places, (n, 3), bicubic; NaN outside.

        The polynomial of a cell has the nodes' values, and slopes that are central differences
        (Catmull and Rom 1974); beyond the edge the nodes go on linearly. DynAdjust interpolates
        in the same way where two cells and more lie between the place and the edge; nearer to it
        its slopes jump, by 4.5 mm in the undulations of its network urban.

        Args:
            latitude: (n,) radians.
            longitude: (n,) radians, positive to the east.
        """
        rows, columns, _ = self.values.shape
        v = (latitude - self.south) / self.latitude_step
        u = (np.remainder(-longitude - self.east + np.pi, 2.0 * np.pi) - np.pi) / (
            self.longitude_step
        )
        rounding = 1e-9
        inside = (v >= -rounding) & (v <= rows - 1 + rounding)
        inside &= (u >= -rounding) & (u <= columns - 1 + rounding)
        i = np.clip(np.floor(np.where(inside, v, 0.0)), 0, rows - 2).astype(np.intp)
        j = np.clip(np.floor(np.where(inside, u, 0.0)), 0, columns - 2).astype(np.intp)
        a, b, g = _cubic(v - i), _cubic(u - j), self._extended
        out = np.zeros((len(v), 3))
        for p in range(4):
            for q in range(4):
                out += (a[:, p] * b[:, q])[:, None] * g[i + p, j + q]
        return np.where(inside[:, None], out, np.nan)

    @cached_property
    def _extended(self) -> Array:
        """Values with one more row and column at each side."""
        g = self.values
        g = np.concatenate([2 * g[:1] - g[1:2], g, 2 * g[-1:] - g[-2:-1]])
        return np.concatenate([2 * g[:, :1] - g[:, 1:2], g, 2 * g[:, -1:] - g[:, -2:-1]], axis=1)


def _cubic(t: Array) -> Array:
    """Return the weights of the nodes at −1, 0, 1, 2 for places t in [0, 1], (n, 4)."""
    weights = (
        t * (t * (2 - t) - 1),
        t * t * (3 * t - 5) + 2,
        t * (t * (4 - 3 * t) + 1),
        t**3 - t**2,
    )
    return np.stack(weights, axis=1) / 2.0


def read_ntv2(path: Path) -> tuple[SubGrid, ...]:
    """Return the sub-grids of a file, the finest ones first.

    Raises:
        InputError: the file cannot be read, or is no such grid.
    """
    data = read_bytes(path)
    try:
        grids = list(_sub_grids(data))
    except (ValueError, KeyError, IndexError, OverflowError) as error:
        what = f"is no geoid grid in the format NTv2 (.gsb): {error}"
        raise InputError(Problem(what, str(path))) from None
    return tuple(sorted(grids, key=lambda g: g.latitude_step))


def _sub_grids(data: bytes) -> list[SubGrid]:
    order = "<" if data[8:12] == b"\x0b\x00\x00\x00" else ">"
    if data[:8] != b"NUM_OREC" or _whole(data, 0, order) != NTV2_HEADER_RECORDS:
        raise ValueError("the first record must be NUM_OREC with 11")
    unit = _text(data, 3)
    if unit not in NTV2_UNITS_RAD:
        raise ValueError(f"unknown unit GS_TYPE {unit!r}; valid: {', '.join(NTV2_UNITS_RAD)}")
    out, at = [], NTV2_HEADER_RECORDS * NTV2_RECORD_BYTES
    for _ in range(_whole(data, 2, order)):
        head = data[at : at + NTV2_HEADER_RECORDS * NTV2_RECORD_BYTES]
        if head[:8] != b"SUB_NAME":
            raise ValueError("the header of a sub-grid is missing")
        limits = [_real(head, k, order) * NTV2_UNITS_RAD[unit] for k in range(4, 10)]
        south, north, east, west, dlat, dlon = limits
        count = _whole(head, 10, order)
        if not (
            np.isfinite(limits).all()
            and dlat > 0
            and dlon > 0
            and 0 < count <= MAX_NODES_OF_SUB_GRID
        ):
            raise ValueError("limits, steps or number of nodes of a sub-grid are damaged")
        if max(abs(north - south) / dlat, abs(west - east) / dlon) > MAX_NODES_OF_SUB_GRID:
            raise ValueError("limits, steps or number of nodes of a sub-grid are damaged")
        rows = round((north - south) / dlat) + 1
        columns = round((west - east) / dlon) + 1
        if rows * columns != count or min(rows, columns) < 2:
            raise ValueError(f"{count} nodes are not {rows} rows of {columns}")
        at += len(head)
        size = count * NTV2_RECORD_BYTES
        if len(data) < at + size:
            raise ValueError("the file ends before the last node")
        nodes = np.frombuffer(data[at : at + size], dtype=f"{order}f4").reshape(rows, columns, 4)
        values = nodes[:, :, :3].astype(float) * [1.0, ARCSEC, ARCSEC]
        if not np.isfinite(values).all():
            raise ValueError("some nodes are no numbers")
        out.append(SubGrid(_text(head, 0), south, east, dlat, dlon, values))
        at += size
    if not out:
        raise ValueError("it has no sub-grid")
    return out


def _whole(data: bytes, record: int, order: str) -> int:
    at = record * NTV2_RECORD_BYTES + 8
    return int(np.frombuffer(data[at : at + 4], dtype=f"{order}i4")[0])


def _real(data: bytes, record: int, order: str) -> float:
    at = record * NTV2_RECORD_BYTES + 8
    return float(np.frombuffer(data[at : at + 8], dtype=f"{order}f8")[0])


def _text(data: bytes, record: int) -> str:
    at = record * NTV2_RECORD_BYTES + 8
    return data[at : at + 8].split(b"\0")[0].decode("ascii", "replace").strip()


@dataclass(frozen=True, eq=False)
class GeoidValues:
    """Geoid at n places."""

    undulation: Array
    """N, height of the geoid above the ellipsoid, (n,) metres."""
    xi: Array
    """ξ, deflection towards north, (n,) radians; NaN where the geoid has none."""
    eta: Array
    """η, deflection towards east, (n,) radians; NaN where the geoid has none."""


class Geoid(Protocol):
    """What gives undulations."""

    def at(
        self, latitude: Array, longitude: Array, names: Sequence[str] | None = None
    ) -> GeoidValues:
        """Return the geoid at places, radians; InputError for places outside, all of them."""
        ...


@dataclass(frozen=True)
class ConstantGeoid:
    """A stated undulation that holds everywhere; the verticals are the normals."""

    undulation: float
    """N, metres."""

    def at(
        self, latitude: Array, longitude: Array, names: Sequence[str] | None = None
    ) -> GeoidValues:
        """Return N and deflections 0."""
        zero = np.zeros(len(latitude))
        return GeoidValues(zero + self.undulation, zero, zero)


@dataclass(frozen=True, eq=False)
class ProjGeoid:
    """A grid of undulations that PROJ reads: GTX or GeoTIFF.

    Deflections are the slopes of the geoid, ξ = −∂N/∂s_north, η = −∂N/∂s_east, between places
    SLOPE_STEP before and behind; on a sphere of 6371 km.
    """

    path: str
    """The file."""
    operation: proj.Operation = field(repr=False)
    """Vertical shift from heights above the geoid to ellipsoidal heights, degrees."""

    def undulations(self, latitude: Array, longitude: Array, names: Sequence[str] | None) -> Array:
        """Return N, (n,) metres, of places, radians."""
        there = np.isfinite(latitude) & np.isfinite(longitude)
        x, y = np.degrees(longitude), np.degrees(latitude)
        _, _, found = self.operation.transform(x.copy(), y.copy(), np.zeros(len(x)))
        out = np.asarray(found, dtype=float)
        proj.refuse_points(
            there & ~np.isfinite(out),
            lambda i: (
                f"is outside of the geoid grid {self.path}, at latitude {y[i]:.6f}°, "
                f"longitude {x[i]:.6f}°"
            ),
            names,
        )
        return np.where(there, out, np.nan)

    def at(
        self, latitude: Array, longitude: Array, names: Sequence[str] | None = None
    ) -> GeoidValues:
        """Return the geoid at places, radians."""
        n = self.undulations(latitude, longitude, names)

        def undulation(phi: Array, lam: Array) -> Array:
            return np.asarray(
                self.operation.transform(np.degrees(lam), np.degrees(phi), np.zeros(len(n)))[2]
            )

        found = deflections(undulation, latitude, longitude, SLOPE_STEP_RAD)
        sound = (np.where(np.isfinite(n) & np.isfinite(d), d, np.nan) for d in found)
        return GeoidValues(n, *sound)


def deflections(
    undulation: Callable[[Array, Array], Array], latitude: Array, longitude: Array, step: float
) -> tuple[Array, Array]:
    """Return ξ = −∂N/∂s_north and η = −∂N/∂s_east, (n,) radians, by differences on a sphere.

    Args:
        undulation: latitude and longitude (n,), radians → N (n,), metres.
        latitude: latitudes of the places, (n,).
        longitude: their longitudes, (n,).
        step: distance of the places before and behind, radians.
    """
    zero = np.zeros_like(latitude)
    xi, eta = (
        (undulation(latitude - a, longitude - b) - undulation(latitude + a, longitude + b))
        / (2.0 * step * MEAN_EARTH_RADIUS)
        for a, b in ((step, zero), (zero, step / np.cos(latitude)))
    )
    return xi, eta


@dataclass(frozen=True, eq=False)
class Ntv2Geoid:
    """A grid of undulations and deflections in the format NTv2."""

    path: str
    """The file."""
    grids: tuple[SubGrid, ...] = field(repr=False)
    """Its sub-grids, the finest first."""

    def at(
        self, latitude: Array, longitude: Array, names: Sequence[str] | None = None
    ) -> GeoidValues:
        """Return the geoid at places, radians."""
        out = np.full((len(latitude), 3), np.nan)
        there = np.isfinite(latitude) & np.isfinite(longitude)
        for grid in self.grids:
            missing = np.flatnonzero(there & np.isnan(out[:, 0]))
            out[missing] = grid.at(latitude[missing], longitude[missing])
        proj.refuse_points(
            there & np.isnan(out[:, 0]),
            lambda i: (
                f"is outside of the geoid grid {self.path}, at latitude "
                f"{np.degrees(latitude[i]):.6f}°, longitude {np.degrees(longitude[i]):.6f}°"
            ),
            names,
        )
        return GeoidValues(out[:, 0], out[:, 1], out[:, 2])


@dataclass(frozen=True, eq=False)
class PointGeoid:
    """Undulations, and perhaps deflections, of named points."""

    path: str
    """The file."""
    values: dict[str, tuple[float, float, float]] = field(repr=False)
    """N (m), ξ and η (rad) by point; deflections NaN where the table has none."""

    def at(
        self, latitude: Array, longitude: Array, names: Sequence[str] | None = None
    ) -> GeoidValues:
        """Return the geoid at the named points."""
        if names is None:
            raise InputError(
                Problem("has undulations of named points, and the places have no names", self.path)
            )
        there = np.isfinite(latitude) & np.isfinite(longitude)
        missing = np.array([n not in self.values for n in names], dtype=bool)
        has = known(self.values)
        proj.refuse_points(
            missing & there, lambda i: f"has no row in {self.path}; it has points {has}", names
        )
        nothing = (math.nan,) * 3
        rows = [self.values.get(n, nothing) for n in names]
        out = np.array(rows, dtype=float).reshape(-1, 3)
        return GeoidValues(out[:, 0], out[:, 1], out[:, 2])


def geoid(stated: str | float) -> Geoid:
    """Return the geoid that a file has, or a constant.

    Args:
        stated: path of a grid (.gtx, .tif through PROJ; .gsb) or of a table of points (.csv,
            .geo), or N in metres.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    if not isinstance(stated, str):
        return ConstantGeoid(float(stated))
    path = _geoid_file(Path(stated))
    if not path.is_file():
        raise InputError(
            Problem(
                "no such file of a geoid; grids are at https://cdn.proj.org and at the authorities "
                "that publish the geoid; or give a constant undulation in metres",
                stated,
            )
        )
    status = path.stat()
    return _read_geoid(str(path.absolute()), status.st_mtime_ns, status.st_size)


def _geoid_file(path: Path) -> Path:
    """Return the file; one that is named without a folder may lie in a folder of PROJ."""
    if path.is_file() or path.name != str(path):
        return path
    folders = proj.pyproj().datadir.get_data_dir().split(os.pathsep)
    folders.append(proj.pyproj().datadir.get_user_data_dir())
    there = (Path(folder) / path for folder in folders)
    return next((file for file in there if file.is_file()), path)


@lru_cache(maxsize=8)
def _read_geoid(path: str, changed: int, size: int) -> Geoid:
    """Return the geoid of a file; a changed file is read again."""
    end = Path(path).suffix.lower()
    if end == ".gsb":
        return Ntv2Geoid(path, read_ntv2(Path(path)))
    if end in (".csv", ".geo"):
        return PointGeoid(path, _points(Path(path)))
    if end in (".gtx", ".tif", ".tiff"):
        with opened(Path(path)):  # PROJ opens what it is, but says less of it
            pass
        return ProjGeoid(path, _grid_operation(path))
    raise InputError(
        Problem(f"unknown kind of geoid file {end!r}; valid: {', '.join(GEOID_SUFFIXES)}", path)
    )


def _grid_operation(path: str) -> proj.Operation:
    if any(c in path for c in "\"',\n\r"):
        raise InputError(Problem("PROJ takes no path with quotes or commas: rename the file", path))
    named = f'"{path}"' if " " in path else path
    steps = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={named} +multiplier=1 "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    return proj.pipeline(steps, what=path)


def _points(path: Path) -> dict[str, tuple[float, float, float]]:
    """Read a table: a header with point, N and perhaps xi, eta (seconds), or rows without header.

    The separator is a comma or a semicolon, in files ``.geo`` blanks.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(Problem("is not UTF-8 text", str(path))) from None
    problems: list[Problem] = []
    out: dict[str, tuple[float, float, float]] = {}
    order: tuple[str, ...] = GEOID_TABLE_COLUMNS
    first = True
    for line, row in enumerate(text.splitlines(), start=1):
        if not row.strip() or row.lstrip().startswith(("#", "!", "*")):
            continue
        where = f"{path}:{line}"
        cells = _cells(row, path.suffix.lower() == ".geo")
        if first and cells[0].casefold() in ("point", "name"):
            order = tuple("point" if c == "name" else c for c in map(str.casefold, cells))
            strange = [c for c in order if c not in GEOID_TABLE_COLUMNS]
            if strange or order[:2] != ("point", "n"):
                what = f"the columns must be point, N and perhaps xi, eta, not {', '.join(cells)}"
                raise InputError(Problem(what, where))
            first = False
            continue
        first = False
        if not 2 <= len(cells) <= len(order):
            problems.append(Problem(f"a row has point, N and perhaps xi, eta, not {row!r}", where))
            continue
        try:
            found = dict(zip(order[1:], map(float, cells[1:]), strict=False))
        except ValueError:
            problems.append(Problem(f"not all of {', '.join(cells[1:])} are numbers", where))
            continue
        if cells[0] in out:
            problems.append(Problem(f"duplicate point {cells[0]!r}", where))
        if not all(map(math.isfinite, found.values())) or abs(found["n"]) > MAX_UNDULATION_M:
            problems.append(Problem(f"N must be within ±{MAX_UNDULATION_M:g} m: {row!r}", where))
        xi, eta = (found.get(a, math.nan) * ARCSEC for a in ("xi", "eta"))
        out[cells[0]] = found["n"], xi, eta
    if not out and not problems:
        problems.append(Problem("has no points", str(path)))
    if problems:
        raise InputError(problems)
    return out


def _cells(row: str, blanks: bool) -> list[str]:
    if blanks and "," not in row:
        return row.split()
    separator = ";" if ";" in row else ","
    return [c.strip() for c in next(csv.reader([row], delimiter=separator))]
