"""Geoids: undulations N = h − H and deflections of the vertical at places.

A geoid is a grid (GTX or GeoTIFF through PROJ, NTv2 with deflections), a table of points, or a
stated constant. Interpolation is bilinear in the grids that PROJ reads, and bicubic in NTv2.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import InputError, Problem, known
from ..files import opened, read_bytes
from ..types import Array
from . import proj
from .ntv2 import ARCSEC, SubGrid, read_ntv2

SUFFIXES = (".gtx", ".tif", ".tiff", ".gsb", ".csv", ".geo")
"""Suffixes of files of geoids."""
SLOPE_STEP = 1e-4
"""Half the distance of the places between which a slope of the geoid is taken, radians: 640 m."""
COLUMNS = ("point", "n", "xi", "eta")
MOST_UNDULATION = 200.0
"""Largest undulation that is believed, metres; on the Earth it stays within about ±110 m."""


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
        proj.refuse(
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
        d, cosine = SLOPE_STEP, np.cos(latitude)
        there = np.isfinite(n)
        xi, eta = np.full(len(n), np.nan), np.full(len(n), np.nan)
        for out, by in ((xi, (d, np.zeros_like(cosine))), (eta, (0.0, d / cosine))):
            sides = [
                self.operation.transform(
                    np.degrees(longitude + s * by[1]),
                    np.degrees(latitude + s * by[0]),
                    np.zeros(len(n)),
                )[2]
                for s in (1.0, -1.0)
            ]
            slope = (np.asarray(sides[0]) - np.asarray(sides[1])) / (2.0 * d * 6_371_000.0)
            good = there & np.isfinite(slope)
            out[good] = -slope[good]
        return GeoidValues(n, xi, eta)


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
        proj.refuse(
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
        proj.refuse(
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
    path = _found(Path(stated))
    if not path.is_file():
        raise InputError(
            Problem(
                "no such file of a geoid; grids are at https://cdn.proj.org and at the authorities "
                "that publish the geoid; or give a constant undulation in metres",
                stated,
            )
        )
    status = path.stat()
    return _read(str(path.absolute()), status.st_mtime_ns, status.st_size)


def _found(path: Path) -> Path:
    """Return the file; one that is named without a folder may lie in a folder of PROJ."""
    if path.is_file() or path.name != str(path):
        return path
    folders = proj.pyproj().datadir.get_data_dir().split(os.pathsep)
    folders.append(proj.pyproj().datadir.get_user_data_dir())
    there = (Path(folder) / path for folder in folders)
    return next((file for file in there if file.is_file()), path)


@lru_cache(maxsize=8)
def _read(path: str, changed: int, size: int) -> Geoid:
    """Return the geoid of a file; a changed file is read again."""
    end = Path(path).suffix.lower()
    if end == ".gsb":
        return Ntv2Geoid(path, read_ntv2(Path(path)))
    if end in (".csv", ".geo"):
        return PointGeoid(path, _points(Path(path)))
    if end in (".gtx", ".tif", ".tiff"):
        with opened(Path(path)):  # PROJ opens what it is, but says less of it
            pass
        return ProjGeoid(path, _shift(path))
    raise InputError(
        Problem(f"unknown kind of geoid file {end!r}; valid: {', '.join(SUFFIXES)}", path)
    )


def _shift(path: str) -> proj.Operation:
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
    order: tuple[str, ...] = COLUMNS
    first = True
    for line, row in enumerate(text.splitlines(), start=1):
        if not row.strip() or row.lstrip().startswith(("#", "!", "*")):
            continue
        where = f"{path}:{line}"
        cells = _cells(row, path.suffix.lower() == ".geo")
        if first and cells[0].casefold() in ("point", "name"):
            order = tuple("point" if c == "name" else c for c in map(str.casefold, cells))
            strange = [c for c in order if c not in COLUMNS]
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
        if not all(map(math.isfinite, found.values())) or abs(found["n"]) > MOST_UNDULATION:
            problems.append(Problem(f"N must be within ±{MOST_UNDULATION:g} m: {row!r}", where))
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
