"""GNSS networks of DynAdjust: DynaML measurements and stations, and the adjustment listing.

G is a baseline with a 3 × 3 covariance, X a cluster of baselines and Y a cluster of points,
each with one covariance over all of them. Every covariance is multiplied by ``Vscale``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Correlated, GnssPosition, GnssVector
from factorgraph_adj.types import Array

FRAME = GeocentricFrame("GRS80")


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


def _number(node: ElementTree.Element, tag: str) -> float:
    return float(node.findtext(tag, "nan"))


def _triple(node: ElementTree.Element) -> tuple[float, float, float]:
    return _number(node, "X"), _number(node, "Y"), _number(node, "Z")


def _own(node: ElementTree.Element) -> Array:
    xx, xy, xz, yy, yz, zz = (
        _number(node, f"Sigma{c}") for c in ("XX", "XY", "XZ", "YY", "YZ", "ZZ")
    )
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _covariance(nodes: list[ElementTree.Element], scale: float) -> Array:
    """Return the covariance over all members of a cluster; cross blocks follow each member."""
    out = np.zeros((3 * len(nodes), 3 * len(nodes)))
    for i, node in enumerate(nodes):
        out[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = _own(node)
        crosses = [*node.findall("GPSCovariance"), *node.findall("PointCovariance")]
        for j, cross in enumerate(crosses, start=i + 1):
            block = np.array([[_number(cross, f"m{r}{c}") for c in (1, 2, 3)] for r in (1, 2, 3)])
            out[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
            out[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = block.T
    return scale * out


def _degrees(packed: str) -> float:
    """Return radians of degrees.mmsssss, as stations are given."""
    value = abs(float(packed))
    degrees, rest = divmod(value, 1.0)
    minutes, seconds = divmod(rest * 100.0, 1.0)
    angle = float(np.radians(degrees + minutes / 60.0 + seconds * 100.0 / 3600.0))
    return -angle if packed.strip().startswith("-") else angle


def read_dynaml(
    folder: Path, *, measured: Mapping[tuple[str, ...], list[Array]] | None = None
) -> Network:
    """Return the GNSS network.

    Args:
        folder: of the data set.
        measured: values to take instead of the file's, by stations, each in order of the file.
    """
    network = Network("gnss-network", frame=FRAME)
    for station in ElementTree.parse(folder / "gnss-networkstn.xml").iter("DnaStation"):
        at = station.find("StationCoord")
        assert at is not None
        angles = [np.array([_degrees(at.findtext(tag, ""))]) for tag in ("XAxis", "YAxis")]
        xyz = FRAME.ellipsoid.to_cartesian(*angles, np.array([_number(at, "Height")]))[0]
        network.add_point(station.findtext("Name", ""), xyz)
    left = {k: list(v) for k, v in (measured or {}).items()}

    def value(stations: tuple[str, ...], node: ElementTree.Element) -> tuple[float, float, float]:
        return tuple(left[stations].pop(0)) if measured else _triple(node)

    for entry in ElementTree.parse(folder / "gnss-networkmsr.xml").iter("DnaMeasurement"):
        kind, scale = entry.findtext("Type"), _number(entry, "Vscale")
        firsts = [n.text or "" for n in entry.findall("First")]
        seconds = [n.text or "" for n in entry.findall("Second")]
        if kind == "Y":
            nodes = entry.findall("Clusterpoint")
            members = [
                GnssPosition(a, value((a,), n), covariance=scale * _own(n))
                for a, n in zip(firsts, nodes, strict=True)
            ]
        else:
            nodes = entry.findall("GPSBaseline")
            members = [
                GnssVector(a, b, value((a, b), n), covariance=scale * _own(n))
                for a, b, n in zip(firsts, seconds, nodes, strict=True)
            ]
        if kind == "G":
            network.add(*members)
        else:
            network.add(Correlated(tuple(members), _covariance(nodes, scale)))
    return network
