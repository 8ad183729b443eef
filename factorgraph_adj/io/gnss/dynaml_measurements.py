"""Measurements of DynaML as read: sights, sets of directions, GNSS clusters with covariances."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import date
from typing import Any

import numpy as np

from ...crs.terrestrial_frames import TERRESTRIAL_FRAMES, frame_transformation
from ...errors import known
from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import (
    AnyObservation,
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    ControlPoint,
    Correlated,
    Direction,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    Observation,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from ...types import Array
from ...units import ARCSEC
from ..numbers import PACKED_DEGREES
from ..source import ROWS_SWITCHED_OFF
from ..xml_files import Element
from ..xml_source import XmlSource

SIGHT_KINDS = {
    "S": SlopeDistance,
    "V": ZenithAngle,
    "Z": VerticalAngle,
    "B": Azimuth,
    "K": Azimuth,
    "L": HeightDifference,
}
"""Types of measurements between two stations with one value."""
STATION_MEASUREMENTS = "HRIJPQ"
REFUSED_TYPES = {
    "C": "a chord between points on the ellipsoid",
    "E": "an arc along the ellipsoid",
    "M": "an arc at sea level",
}
"""Types without a counterpart: reduce them to slope distances (S)."""


def _type_and_points(file: XmlSource, element: Element, kind: str) -> str:
    """Return the type of a measurement and its points."""
    ends = (file.inside(element, tag).name("") for tag in ("First", "Second", "Third"))
    return " ".join((kind, *filter(None, ends)))


class DynamlMeasurements:
    """Adds measurements to a network that has the stations."""

    def __init__(self, network: Network, frame: str, heights: str, *, by_gda94: bool) -> None:
        """Take the network.

        Args:
            network: with its points.
            frame: reference frame into which vectors are brought; empty: none.
            heights: what to do with orthometric heights: "refuse", "ellipsoidal".
            by_gda94: whether ITRF2008 is connected by GDA94.
        """
        self.network = network
        self.frame = frame
        self.heights = heights
        self.by_gda94 = by_gda94
        self.sets: dict[str, int] = {}

    def read(self, file: XmlSource, element: Element) -> None:
        """Add one ``<DnaMeasurement>``; problems are noted in the file."""
        kind = file.inside(element, "Type").name()
        if file.inside(element, "Ignore").name("") == "*":
            file.leave_out(element.line, ROWS_SWITCHED_OFF, _type_and_points(file, element, kind))
            return
        if kind in REFUSED_TYPES:
            what = f"type {kind} is {REFUSED_TYPES[kind]}, which has no counterpart here: give S"
            file.wrong(element.line, what)
        elif kind in ("L", "H") and self.heights == "refuse":
            what = f"type {kind} is an orthometric height, and the file has no geoid"
            file.wrong(element.line, f"{what}; heights='ellipsoidal' takes undulations as zero")
        elif kind in ("G", "X", "Y"):
            self._gnss(file, element, kind)
        elif kind == "D":
            self._directions(file, element)
        elif kind == "A" or kind in SIGHT_KINDS:
            self._sight(file, element, kind)
        elif kind and kind in STATION_MEASUREMENTS:
            self._of_a_station(file, element, kind)
        elif kind:
            valid = (*"GXYAD", *SIGHT_KINDS, *STATION_MEASUREMENTS)
            file.wrong(element.line, f"unknown type {kind[:20]!r}; valid: {', '.join(valid)}")

    def _add(
        self,
        file: XmlSource,
        line: int,
        make: Callable[..., AnyObservation],
        *args: Any,
        **more: Any,
    ) -> None:
        made = file.attempt(line, make, *args, **more)
        if made is not None:
            file.attempt(line, self.network.add, made)

    # -- GNSS -------------------------------------------------------------------------------------

    def _gnss(self, file: XmlSource, element: Element, kind: str) -> None:
        before = file.problems.count
        nodes = list(element.all("Clusterpoint" if kind == "Y" else "GPSBaseline"))
        firsts = [e.text.strip() for e in element.all("First")]
        seconds = [e.text.strip() for e in element.all("Second")]
        wanted = [firsts] if kind == "Y" else [firsts, seconds]
        if not nodes or any(len(names) != len(nodes) for names in wanted):
            counts = f"{len(firsts)} <First>, {len(seconds)} <Second>, {len(nodes)} measured"
            file.wrong(element.line, f"type {kind} needs as many stations as vectors: {counts}")
            return
        if kind == "G" and len(nodes) != 1:
            file.wrong(element.line, f"type G has one vector, not {len(nodes)}: give type X")
            return
        if "Total" in [e.tag for e in element.children]:
            total = file.inside(element, "Total").name("")
            if total and total != str(len(nodes)):
                file.wrong(element.line, f"<Total> is {total[:20]!r}, but there are {len(nodes)}")
        values = self._values(file, element, kind, nodes)
        covariance = self._covariance(file, nodes)
        if file.problems.count > before:
            return
        covariance = self._scaled(file, element, firsts, covariance)
        values, covariance = self._brought(file, element, kind, values, covariance)
        if file.problems.count > before:
            return
        members: list[Observation] = []
        for i, node in enumerate(nodes):
            own = slice(3 * i, 3 * i + 3)
            names = (firsts[i],) if kind == "Y" else (firsts[i], seconds[i])
            made = file.attempt(
                node.line,
                GnssPosition if kind == "Y" else GnssVector,
                *names,
                tuple(values[i].tolist()),
                covariance=covariance[own, own],
                source=file.place(node.line),
            )
            if made is not None:
                members.append(made)
        if file.problems.count > before:
            return
        if len(members) > 1:
            self._add(file, element.line, Correlated, tuple(members), covariance)
        else:
            file.attempt(element.line, self.network.add, *members)

    def _values(self, file: XmlSource, element: Element, kind: str, nodes: list[Element]) -> Array:
        coordinates = file.inside(element, "Coords").name("XYZ") if kind == "Y" else "XYZ"
        if coordinates == "XYZ":
            return np.array([[file.inside(n, a).number() for a in "XYZ"] for n in nodes])
        if coordinates not in ("LLH", "LLh"):
            what = f"<Coords> {coordinates[:20]!r} is unknown; valid: XYZ, LLH, LLh"
            file.wrong(element.line, what)
            return np.zeros((len(nodes), 3))
        if coordinates == "LLH" and self.heights == "refuse":
            what = "points in LLH have orthometric heights, and the file has no geoid"
            file.wrong(element.line, f"{what}; heights='ellipsoidal' takes undulations as zero")
        angles = np.array([[file.inside(n, a).number(PACKED_DEGREES) for a in "XY"] for n in nodes])
        height = np.array([file.inside(n, "Z").number() for n in nodes])
        frame = self.network.frame
        assert isinstance(frame, GeocentricFrame)
        return frame.ellipsoid.to_cartesian(angles[:, 0], angles[:, 1], height)

    @staticmethod
    def _covariance(file: XmlSource, nodes: list[Element]) -> Array:
        """Return the covariance over all members; cross blocks follow each member."""
        n = len(nodes)
        out = np.zeros((3 * n, 3 * n))
        for i, node in enumerate(nodes):
            own = out[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
                own[a, b] = own[b, a] = file.inside(node, f"Sigma{'XYZ'[a]}{'XYZ'[b]}").number()
            crosses = [e for e in node.children if e.tag in ("GPSCovariance", "PointCovariance")]
            if len(crosses) not in (0, n - 1 - i):
                what = f"has {len(crosses)} covariances with the following {n - 1 - i}"
                file.wrong(node.line, f"<{node.tag}> {i + 1} of {n} {what}")
                continue
            for j, cross in enumerate(crosses, start=i + 1):
                block = [
                    [file.inside(cross, f"m{r}{c}").number() for c in (1, 2, 3)] for r in (1, 2, 3)
                ]
                out[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
                out[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = np.transpose(block)
        return out

    def _scaled(
        self, file: XmlSource, element: Element, firsts: list[str], covariance: Array
    ) -> Array:
        """Return the covariance with its scales: V of all, P, L, H of north, east, up."""
        whole = file.inside(element, "Vscale").number(default=1.0, above=0.0)
        parts = [file.inside(element, f"{a}scale").number(default=1.0, above=0.0) for a in "LPH"]
        if parts == [1.0, 1.0, 1.0]:
            return whole * covariance
        stations = [self._at(file, element.line, name) for name in firsts]
        if any(at is None for at in stations):
            return covariance
        enu = self.network.frame.basis(np.array(stations), np.zeros((len(stations), 2))).enu
        by = np.zeros_like(covariance)
        for i, rows in enumerate(enu):
            own = slice(3 * i, 3 * i + 3)
            by[own, own] = rows.T @ np.diag(np.sqrt(parts)) @ rows
        return whole * by @ covariance @ by.T

    def _brought(
        self, file: XmlSource, element: Element, kind: str, values: Array, covariance: Array
    ) -> tuple[Array, Array]:
        """Return values and covariance in the reference frame of the stations."""
        name = file.inside(element, "ReferenceFrame").name("").upper()
        if not self.frame or not name or name == self.frame:
            return values, covariance
        if name not in TERRESTRIAL_FRAMES:
            what = f"reference frame {name[:20]!r} is not known; known: {known(TERRESTRIAL_FRAMES)}"
            file.wrong(
                element.line, f"{what}; reference_frames='as is' takes the numbers as they are"
            )
            return values, covariance
        epoch = _year(file, element)
        if math.isnan(epoch) or self.frame not in TERRESTRIAL_FRAMES:
            return values, covariance
        matrix, shift = frame_transformation(name, self.frame, epoch, by_gda94=self.by_gda94)
        every = np.kron(np.eye(len(values)), matrix)
        moved = values @ matrix.T + (shift if kind == "Y" else 0.0)
        return moved, every @ covariance @ every.T

    # -- terrestrial ------------------------------------------------------------------------------

    def _at(self, file: XmlSource, line: int, name: str) -> Array | None:
        point = self.network.points.get(name)
        if point is None:
            what = known(self.network.points, meant=name)
            file.wrong(line, f"unknown station {name[:40]!r}; known: {what}")
            return None
        return np.array(point.coordinates)

    def _sight(self, file: XmlSource, element: Element, kind: str) -> None:
        before = file.problems.count
        names = [file.inside(element, tag).name() for tag in ("First", "Second")]
        heights = {
            "instrument_height": file.inside(element, "InstHeight").number(default=0.0),
            "target_height": file.inside(element, "TargHeight").number(default=0.0),
        }
        metric = kind in ("S", "L")
        value = (
            file.inside(element, "Value").number()
            if metric
            else file.inside(element, "Value").number(PACKED_DEGREES)
        )
        unit = 1.0 if metric else ARCSEC
        sigma = unit * file.inside(element, "StdDev").sigma()
        third = file.inside(element, "Third").name() if kind == "A" else ""
        if file.problems.count > before:
            return
        more = {"sigma": sigma, "source": file.place(element.line)}
        if kind == "A":
            self._add(file, element.line, HorizontalAngle, *names, third, value, **more)
        else:
            self._add(file, element.line, SIGHT_KINDS[kind], *names, value, **more, **heights)

    def _directions(self, file: XmlSource, element: Element) -> None:
        before = file.problems.count
        station = file.inside(element, "First").name()
        self.sets[station] = self.sets.get(station, 0) + 1
        further = list(element.all("Directions"))
        total = file.inside(element, "Total").name("")
        if total and total != str(len(further)):
            what = f"<Total> is {total[:20]!r}, but there are {len(further)} <Directions>"
            file.wrong(element.line, what)
        rows = [(element, "Second"), *((e, "Target") for e in further)]
        made: list[Direction] = []
        for row, tag in rows:
            if file.inside(row, "Ignore").name("") == "*":
                name = f"D {station} {file.inside(row, tag).name('')}"
                file.leave_out(row.line, ROWS_SWITCHED_OFF, name)
                continue
            target = file.inside(row, tag).name()
            value = file.inside(row, "Value").number(PACKED_DEGREES)
            sigma = file.inside(row, "StdDev").sigma() * ARCSEC
            if file.problems.count > before:
                continue
            one = file.attempt(
                row.line,
                Direction,
                station,
                target,
                value,
                sigma=sigma,
                set=str(self.sets[station]),
                source=file.place(row.line),
            )
            if one is not None:
                made.append(one)
        if file.problems.count == before:
            for one in made:
                file.attempt(element.line, self.network.add, one)

    def _of_a_station(self, file: XmlSource, element: Element, kind: str) -> None:
        before = file.problems.count
        name = file.inside(element, "First").name()
        at = self._at(file, element.line, name)
        metric = kind in "HR"
        value = (
            file.inside(element, "Value").number()
            if metric
            else file.inside(element, "Value").number(PACKED_DEGREES)
        )
        sigma = file.inside(element, "StdDev").sigma() * (1.0 if metric else ARCSEC)
        if at is None or file.problems.count > before:
            return
        source = file.place(element.line)
        if kind in "IJ":
            astronomic = AstronomicLatitude if kind == "I" else AstronomicLongitude
            self._add(file, element.line, astronomic, name, value, sigma=sigma, source=source)
            return
        frame = self.network.frame
        assert isinstance(frame, GeocentricFrame)
        geodetic = [float(v) for v in frame.ellipsoid.to_geodetic(at)]
        number = {"P": 0, "Q": 1}.get(kind, 2)
        m, n = (float(v) for v in frame.ellipsoid.radii(np.array(geodetic[0])))
        radius = [m + geodetic[2], (n + geodetic[2]) * math.cos(geodetic[0]), 1.0][number]
        geodetic[number] = value
        xyz = frame.ellipsoid.to_cartesian(*(np.array([g]) for g in geodetic))[0]
        self._add(
            file,
            element.line,
            ControlPoint,
            name,
            tuple(xyz.tolist()),
            axes="neu"[number],
            sigma=(sigma * radius,),
            source=source,
        )


def _year(file: XmlSource, element: Element) -> float:
    """Return the epoch dd.mm.yyyy of a measurement, years."""
    text = file.inside(element, "Epoch").name()
    try:
        day, month, year = (int(p) for p in text.split("."))
        at = date(year, month, day)
        begin, end = date(year, 1, 1), date(year + 1, 1, 1)
    except ValueError:
        if text:
            file.wrong(element.line, f"<Epoch> must be dd.mm.yyyy, not {text[:20]!r}")
        return math.nan
    return year + (at - begin) / (end - begin)
