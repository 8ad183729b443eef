"""DynAdjust: its adjustment listing."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factorgraph_adj.types import Array

CONSTRAINTS = re.compile("[CF]{3}")
SUMMARY = {
    "unknowns": "Number of unknown parameters",
    "measurements": "Number of measurements",
    "redundancy": "Degrees of freedom",
    "squares": "Chi squared",
    "variance": "Rigorous Sigma Zero",
    "pelzer": "Global (Pelzer) Reliability",
}
"""Figures of a listing and their words."""


@dataclass(frozen=True)
class Row:
    """A scalar measurement of the listing."""

    kind: str
    """Letter of its type."""
    component: str
    """X, Y, Z, P, L, H of a cluster."""
    correction: float
    """Adjusted − measured, metres or seconds of arc."""
    sigma: float
    """Standard deviation, the same."""
    statistic: float
    """N-statistic: the correction by its standard deviation."""
    pelzer: float
    """σ by the standard deviation of the correction."""


def read_summary(path: Path) -> dict[str, float]:
    """Return the figures of `SUMMARY`."""
    text = path.read_text()
    found = {k: re.search(re.escape(w) + r"\s+([\d.]+)", text) for k, w in SUMMARY.items()}
    return {k: float(m[1]) for k, m in found.items() if m}


def read_rows(path: Path) -> list[Row]:
    """Return all scalar measurements in the order of the listing."""
    lines = path.read_text().splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("M Station 1"))
    out = []
    for line in lines[head + 2 :]:
        if not line.strip():
            break
        numbers = [float(line[a:b]) for a, b in ((105, 117), (117, 130), (156, 167), (167, 179))]
        out.append(Row(line[0], line[62:67].strip(), *numbers))
    return out


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
        elif CONSTRAINTS.fullmatch(line[20:23]) and line[23:26].isspace():
            numbers = [float(v) for v in line[23:].split()[:10]]
            stations[line[:20].strip()] = Station(np.array(numbers[4:7]), np.array(numbers[7:10]))
    return measurements, stations
