"""DynAdjust: its adjustment listing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factorgraph_adj.types import Array


@dataclass(frozen=True)
class Measurement:
    """One baseline or point of the listing."""

    kind: str
    """G, X or Y."""
    stations: tuple[str, ...]
    """From and to, or the point."""
    measured: Array
    """X, Y, Z, metres."""
    adjusted: Array
    """The same, adjusted."""
    sigma: Array
    """Standard deviations of the measured components."""
    adjusted_sigma: Array
    """Standard deviations of the adjusted components."""


@dataclass(frozen=True)
class Station:
    """An adjusted station of the listing."""

    xyz: Array
    """X, Y, Z, metres."""
    sigma_enu: Array
    """Standard deviations east, north, up, metres."""


def read_listing(path: Path) -> tuple[list[Measurement], dict[str, Station]]:
    """Return the measurements in the order of the files, and the stations."""
    lines = path.read_text().splitlines()
    measurements: list[Measurement] = []
    components: list[list[float]] = []
    stations: dict[str, Station] = {}
    for line in lines:
        if line[:2] in ("G ", "X ", "Y ") and line[65:68].strip() in ("X", "Y", "Z"):
            components.append([float(v) for v in line[68:].split()[:5]])
            if len(components) == 3:
                measured, adjusted, _, sigma, adjusted_sigma = np.array(components).T
                names = tuple(n for n in (line[2:22].strip(), line[22:42].strip()) if n)
                measurements.append(
                    Measurement(line[0], names, measured, adjusted, sigma, adjusted_sigma)
                )
                components = []
        elif line[20:23] == "FFF":
            numbers = [float(v) for v in line[23:].split()[:10]]
            stations[line[:20].strip()] = Station(np.array(numbers[4:7]), np.array(numbers[7:10]))
    return measurements, stations
