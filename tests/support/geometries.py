"""Geometries of GeoPackage, decoded independently of the writer."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path

import numpy as np


def decoded(blob: bytes) -> tuple[int, str, np.ndarray]:
    """Return reference system, kind and vertices (m, 3) of a geometry after OGC 12-128, 2.1.3."""
    magic, version, flags, srs = struct.unpack_from("<2sBBi", blob)
    assert (magic, version, flags & 1) == (b"GP", 0, 1)
    size = {0: 0, 1: 4}[flags >> 1 & 7]
    envelope = struct.unpack_from(f"<{size}d", blob, 8)
    at = 8 + 8 * size
    order, code = struct.unpack_from("<BI", blob, at)
    assert order == 1 and code // 1000 == 1, "little-endian, with Z"
    at += 5
    n = 1
    if code % 1000 == 3:
        (rings,) = struct.unpack_from("<I", blob, at)
        assert rings == 1
        at += 4
    if code % 1000 > 1:
        (n,) = struct.unpack_from("<I", blob, at)
        at += 4
    xyz = np.frombuffer(blob, "<f8", 3 * n, at).reshape(n, 3)
    assert len(blob) == at + 24 * n
    if envelope:
        low, high = xyz.min(axis=0), xyz.max(axis=0)
        assert envelope == (low[0], high[0], low[1], high[1])
    return srs, {1: "POINT", 2: "LINESTRING", 3: "POLYGON"}[code % 1000], xyz


def rows_of(file: Path, layer: str) -> list[dict[str, object]]:
    """Return the rows of a table of a GeoPackage by column."""
    connection = sqlite3.connect(file)
    try:
        connection.row_factory = sqlite3.Row
        return [dict(r) for r in connection.execute(f'SELECT * FROM "{layer}"')]
    finally:
        connection.close()


def area(ring: np.ndarray) -> float:
    """Return the area of a ring, positive if it is counter-clockwise."""
    x, y = (ring - ring[0])[:, :2].T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) / 2.0)
