"""Geoids that tests make."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

LATITUDE, LONGITUDE = 48.0, 11.5
"""Place where the undulation of `tilted` is `HERE`, degrees."""
HERE = 46.0
NORTH, EAST = 0.9, -1.8
"""Slopes of `tilted`, metres per degree."""


def tilted(latitude_deg: float, longitude_deg: float) -> float:
    """Return N of a geoid that is a plane in latitude and longitude, metres."""
    return HERE + NORTH * (latitude_deg - LATITUDE) + EAST * (longitude_deg - LONGITUDE)


def write_gtx(path: Path, *, step: float = 0.05, size: int = 41) -> Path:
    """Write `tilted` as a GTX grid around the place; bilinear interpolation is exact."""
    south, west = LATITUDE - step * (size // 2), LONGITUDE - step * (size // 2)
    nodes = np.array(
        [[tilted(south + i * step, west + j * step) for j in range(size)] for i in range(size)]
    )
    head = struct.pack(">4d2i", south, west, step, step, size, size)
    path.write_bytes(head + nodes.astype(">f4").tobytes())
    return path


def write_ntv2(path: Path, *, order: str = "<", step: float = 180.0, size: int = 21) -> Path:
    """Write `tilted` as an NTv2 grid with its deflections, seconds."""
    south = LATITUDE * 3600.0 - step * (size // 2)
    east = -(LONGITUDE * 3600.0 + step * (size // 2))

    def record(name: str, value: bytes) -> bytes:
        return name.ljust(8).encode() + value.ljust(8, b"\0")

    def whole(value: int) -> bytes:
        return struct.pack(f"{order}i", value)

    def real(value: float) -> bytes:
        return struct.pack(f"{order}d", value)

    out = [
        record("NUM_OREC", whole(11)),
        record("NUM_SREC", whole(11)),
        record("NUM_FILE", whole(1)),
        record("GS_TYPE", b"SECONDS "),
        *(record(f"HEAD{i}", b"") for i in range(7)),
        record("SUB_NAME", b"TILTED  "),
        record("PARENT", b"NONE    "),
        record("CREATED", b""),
        record("UPDATED", b""),
        record("S_LAT", real(south)),
        record("N_LAT", real(south + step * (size - 1))),
        record("E_LONG", real(east)),
        record("W_LONG", real(east + step * (size - 1))),
        record("LAT_INC", real(step)),
        record("LONG_INC", real(step)),
        record("GS_COUNT", whole(size * size)),
    ]
    radian = np.degrees(1.0) / 6_371_000.0 * 648_000.0 / np.pi
    xi, eta = -NORTH * radian, -EAST * radian / np.cos(np.radians(LATITUDE))
    for i in range(size):
        for j in range(size):
            n = tilted((south + i * step) / 3600.0, -(east + j * step) / 3600.0)
            out.append(struct.pack(f"{order}4f", n, xi, eta, 0.0))
    path.write_bytes(b"".join(out))
    return path
