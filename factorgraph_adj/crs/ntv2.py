"""Geoid grids in the format NTv2 (.gsb) with undulation and deflections, as AUSGeoid has them.

The file has 11 records of 16 bytes for the whole, then for each sub-grid 11 records of its limits
and one record of four 4-byte floats for each node: N in metres, ξ and η in seconds of arc, and a
fourth number that is not used here. Rows go from south to north, and within a row from east to
west: longitudes count positive to the west. Source: Natural Resources Canada, NTv2 developer's
guide; Geoscience Australia, AUSGeoid technical documentation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import InputError, Problem
from ..files import read_bytes
from ..types import Array

RECORD = 16
RECORDS = 11
UNITS = {"SECONDS": np.pi / 648000.0, "MINUTES": np.pi / 10800.0, "DEGREES": np.pi / 180.0}
"""Units of limits and steps, radians."""
ARCSEC = np.pi / 648000.0
MOST_NODES = 200_000_000
"""Largest number of nodes of a sub-grid; a larger one is a damaged file."""


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
        in the same way.

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
    if data[:8] != b"NUM_OREC" or _whole(data, 0, order) != RECORDS:
        raise ValueError("the first record must be NUM_OREC with 11")
    unit = _text(data, 3)
    if unit not in UNITS:
        raise ValueError(f"unknown unit GS_TYPE {unit!r}; valid: {', '.join(UNITS)}")
    out, at = [], RECORDS * RECORD
    for _ in range(_whole(data, 2, order)):
        head = data[at : at + RECORDS * RECORD]
        if head[:8] != b"SUB_NAME":
            raise ValueError("the header of a sub-grid is missing")
        limits = [_real(head, k, order) * UNITS[unit] for k in range(4, 10)]
        south, north, east, west, dlat, dlon = limits
        count = _whole(head, 10, order)
        if not (np.isfinite(limits).all() and dlat > 0 and dlon > 0 and 0 < count <= MOST_NODES):
            raise ValueError("limits, steps or number of nodes of a sub-grid are damaged")
        if max(abs(north - south) / dlat, abs(west - east) / dlon) > MOST_NODES:
            raise ValueError("limits, steps or number of nodes of a sub-grid are damaged")
        rows = round((north - south) / dlat) + 1
        columns = round((west - east) / dlon) + 1
        if rows * columns != count or min(rows, columns) < 2:
            raise ValueError(f"{count} nodes are not {rows} rows of {columns}")
        at += len(head)
        size = count * RECORD
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
    at = record * RECORD + 8
    return int(np.frombuffer(data[at : at + 4], dtype=f"{order}i4")[0])


def _real(data: bytes, record: int, order: str) -> float:
    at = record * RECORD + 8
    return float(np.frombuffer(data[at : at + 8], dtype=f"{order}f8")[0])


def _text(data: bytes, record: int) -> str:
    at = record * RECORD + 8
    return data[at : at + 8].split(b"\0")[0].decode("ascii", "replace").strip()
