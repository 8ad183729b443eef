"""The report of HANNA of a network at the lock Uelzen: two epochs in one free adjustment.

Directions, horizontal distances reduced to the datum surface, approximate coordinates, and what the
program printed of every observation and of the cofactors. Standard deviations are printed with one
or two digits; those of distances follow √(a² + (b D)²) with a and b of the group.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import factorgraph_adj as fga

GON, MGON, MM = np.pi / 200, np.pi / 200_000, 1e-3
DATUM = ("904", "905", "907", "908", "909", "910", "911")
"""The seven datum points: those that stand in both epochs at the edge of the network."""
PARTS = {
    0: (2.0, 1.5),
    1: (1.8, 1.0),
    2: (2.4, 1.5),
    3: (3.0, 1.0),
    4: (1.85, 1.0),
    5: (2.8, 1.0),
    6: (6.5, 1.0),
}
"""a and b of the groups of distances, mm and mm/km. The report states those of group 5; those of
the others follow from its redundancy numbers and the standard deviations of its groups."""


@dataclass(frozen=True)
class Printed:
    """What the report prints of one observation."""

    station: str
    target: str
    v: float
    """Residual, metres or radians."""
    r: float
    """Redundancy number."""
    nabla: float
    """Smallest detectable error, metres or radians."""
    w: float
    """Normalised residual without sign."""
    group: tuple[int, int]
    """Sort of the observation, 1 direction or 3 distance, and number of its group."""


@dataclass(frozen=True)
class Component:
    """What the report prints of one variance component."""

    group: tuple[int, int]
    """Sort and number of the group."""
    reach: tuple[float, float]
    """Class of distances, metres."""
    vtpv: float
    """vᵀPv of the group."""
    redundancy: float
    """Sum of its redundancy numbers."""
    n: int
    """Number of its observations."""
    given: float
    """Standard deviation a priori, metres or radians."""
    estimated: float
    """Estimated standard deviation, metres or radians."""


@dataclass(frozen=True)
class Hanna:
    """The network and its report."""

    network: fga.Network
    printed: tuple[Printed, ...]
    coordinates: dict[str, tuple[float, float]]
    """Adjusted y (east), x (north)."""
    cofactor: np.ndarray
    """Q of y, x of all points in the order of `coordinates`, mm²."""
    components: tuple[Component, ...]
    """The variance components."""
    critical: float
    """Critical value of data snooping."""


def read_hanna(path: Path) -> Hanna:
    """Read the report."""
    lines = path.read_text(encoding="latin-1").splitlines()
    network = fga.Network("lock Uelzen", datum="free")
    for name, y, x in _approximate(lines):
        network.add_point(name, (y, x, 0.0), fixed="z", datum=name in DATUM)
    printed = _printed(lines)
    directions, distances = _directions(lines), _distances(lines)
    assert len(directions) + len(distances) == len(printed)
    for n, (station, number, target, value, sigma) in enumerate(directions, 1):
        network.add(
            fga.Direction(
                station, target, value * GON, sigma=sigma * MGON, set=str(number), id=str(n)
            )
        )
    for n, (a, b, value, printed_sigma, group) in enumerate(distances, len(directions) + 1):
        constant, by_length = PARTS[group]
        sigma = np.hypot(constant, by_length * 1e-3 * value)
        if abs(sigma - printed_sigma) > 0.1:  # stated for this distance alone
            sigma = printed_sigma
        network.add(fga.HorizontalDistance(a, b, value, sigma=sigma * MM, id=str(n)))
    limit = next(t for t in lines if "GRENZWERT FUER DATA-SNOOPING" in t)
    return Hanna(
        network,
        printed,
        _adjusted(lines),
        _cofactor(lines),
        _components(lines),
        float(limit.split()[-1]),
    )


def _approximate(lines: list[str]) -> list[tuple[str, float, float]]:
    start = next(i for i, t in enumerate(lines) if "VERZEICHNIS DER NEUPUNKTE" in t)
    row = re.compile(r"\s+\d+\s+(\d+)\s+([\d.]+)\s+([\d.]+)\s+[\d.]+\s*$")
    found = [m for t in lines[start : start + 40] if (m := row.match(t))]
    return [(m[1], float(m[2]), float(m[3])) for m in found]


def _directions(lines: list[str]) -> list[tuple[str, int, str, float, float]]:
    """Return station, set, target, direction (gon) and σ (mgon); a station begins a set."""
    start = next(i for i, t in enumerate(lines) if "RED.RICHTUNG" in t)
    end = next(i for i, t in enumerate(lines) if "RED.ZENITW." in t)
    station, out, sets = "", [], 0
    for text in lines[start:end]:
        words = text.replace("+", " ", 1).split()
        if re.fullmatch(r"\s+\d+\s*", text):
            station, sets = words[0], sets + 1
        elif len(words) == 9 and re.fullmatch(r"\d+", words[0]):
            out.append((station, sets, words[0], float(words[5]), float(words[7])))
    return out


def _distances(lines: list[str]) -> list[tuple[str, str, float, float, int]]:
    start = next(i for i, t in enumerate(lines) if "REDUZIERTE STD. STR GR RD" in t)
    end = next(i for i, t in enumerate(lines) if "BEARBEITUNGSPROTOKOLL" in t)
    row = re.compile(r"\s+(\d+)\s+(\d+)((?:\s+-?[\d.]+){8})\s+([\d.]+)\s+\d+\s+(\d+)\s+\w*\s*$")
    found = [m for t in lines[start:end] if (m := row.match(t))]
    return [(m[1], m[2], float(m[3].split()[7]), float(m[4]), int(m[5])) for m in found]


def _printed(lines: list[str]) -> tuple[Printed, ...]:
    start = next(i for i, t in enumerate(lines) if "VERZEICHNIS AUSGEGLICHENER BEOB" in t)
    end = next(i for i, t in enumerate(lines) if "STATISTIK DER REDUNDANZANTEILE" in t)
    out, station = [], ""
    for text in lines[start:end]:
        words = text.replace("*GF*", " ").replace("-NT-", " ").split()
        if not re.match(r"\s+\d+\s", text) or len(words) not in (10, 11):
            continue
        if len(words) == 11:
            station = words.pop(1)
        unit = MM if words[8] == "3" else MGON
        v, _, r, nabla, w = map(float, words[3:8])
        group = (abs(int(words[8])), int(words[9]))
        out.append(Printed(station, words[1], v * unit, r, nabla * unit, w, group))
    return tuple(out)


def _components(lines: list[str]) -> tuple[Component, ...]:
    """Return the variance components; a row without a sort or a class has that of the last row."""
    start = next(i for i, t in enumerate(lines) if "VARIANZ-KOMPONENTEN-SCHAETZUNG:" in t)
    out, sort = [], 0
    for text in lines[start + 7 :]:
        words = text.split()
        if not words or not words[0].isdigit() or "UNIV" in text:
            break
        if text[:8].strip():
            sort = int(words.pop(0))
        number = int(words.pop(0))
        reach = (0.0, np.inf)
        if sort == 3:
            reach = (1000 * float(words.pop(0)), 1000 * float(words.pop(0)))
        vtpv, r, n, given, estimated = (float(x) for x in words)
        unit = MM if sort == 3 else MGON
        out.append(
            Component((sort, number), reach, vtpv, r, int(n), given * unit, estimated * unit)
        )
    return tuple(out)


def _adjusted(lines: list[str]) -> dict[str, tuple[float, float]]:
    start = next(i for i, t in enumerate(lines) if "AUSGEGLICHENE KOORDINATEN:" in t)
    row = re.compile(r"\s+(\d+)\s+([\d.]+)\s+[\d.]+\s+([\d.]+)\s+[\d.]+\s+[\d.]+\s+\S+\s+\d+\s*$")
    found = [m for t in lines[start : start + 40] if (m := row.match(t))]
    return {m[1]: (float(m[2]), float(m[3])) for m in found}


def _cofactor(lines: list[str]) -> np.ndarray:
    q = np.zeros((38, 38))
    row = re.compile(r"\s+CNQ\(\s*(\d+):\s*(\d+)\)((?:\s+-?[.\d]+E[+-]\d+)+)")
    for m in filter(None, map(row.match, lines)):
        i, first = int(m[1]) - 1, int(m[2])
        if i >= len(q):  # the next block: the essential eigenvector
            continue
        for j, text in enumerate(m[3].split(), first):
            q[i, j] = q[j, i] = float(text)
    return q
