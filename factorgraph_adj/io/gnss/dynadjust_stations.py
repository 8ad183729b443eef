"""Stations of DynAdjust as points: coordinates of every type, geoid, constraints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...crs import proj
from ...crs.geoid import Geoid, GeoidValues
from ...ellipsoid import Ellipsoid
from ...errors import InputError
from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import ControlPoint
from ...types import Array
from ..numbers import PACKED_DEGREES
from ..source import Field, LeftOutReason, Problems, is_unread
from .dynadjust_records import StationRecord

STATION_TYPES = ("LLH", "LLh", "XYZ", "UTM")
"""Types of coordinates; the heights of LLH and UTM are orthometric."""
ORTHOMETRIC_TYPES = ("LLH", "UTM")
CONSTRAINED_AXES = {"LLH": "neu", "LLh": "neu", "UTM": "enu", "XYZ": "xyz"}
"""Axes of the three letters of constraints by type: those of the coordinates in their order."""
CONSTRAINED_SIGMA_M = 1e-6
"""Standard deviation of constrained components of a station that is free in others, metres:
DynAdjust's own default."""
NO_GEOID = (
    "and the file has no geoid: state geoid, a grid (.gsb, .gtx) or a constant undulation in "
    "metres; heights='ellipsoidal' takes undulations as zero"
)
REPEATED_STATIONS = LeftOutReason(
    "repeated stations", "the first record of a name counts, and both are free"
)
Heights = Literal["refuse", "ellipsoidal"]


@dataclass(frozen=True)
class _Place:
    """A station with its coordinates as they are read."""

    record: StationRecord
    name: str
    constraints: str
    kind: str
    geodetic: Array
    """Latitude, longitude (rad), and height as in the file; of XYZ above the ellipsoid."""
    xyz: Array | None
    """Geocentric coordinates of XYZ."""


class DynadjustStations:
    """The stations of a network, with the geoid at each."""

    def __init__(
        self, network: Network, problems: Problems, geoid: Geoid | None, heights: Heights
    ) -> None:
        """Take the network, which has no points yet.

        Args:
            network: gets the points.
            problems: those of all files.
            geoid: gives undulations and deflections; None: there is none.
            heights: what to do with orthometric heights without a geoid.
        """
        assert isinstance(network.frame, GeocentricFrame)
        self.network = network
        self.problems = problems
        self.geoid = geoid
        self.heights = heights
        self.ellipsoid: Ellipsoid = network.frame.ellipsoid
        self.undulations: dict[str, float] = {}
        """N, metres, by station; empty without a geoid."""
        self.deflections: dict[str, tuple[float, float]] = {}
        """ξ and η, radians, by station; empty without a geoid."""

    @property
    def takes_orthometric(self) -> bool:
        """Whether orthometric heights can be used."""
        return self.geoid is not None or self.heights == "ellipsoidal"

    def read(self, records: Sequence[StationRecord]) -> None:
        """Add all stations as points."""
        first: dict[str, _Place] = {}
        for place in filter(None, map(self._place, records)):
            known = first.setdefault(place.name, place)
            if known is not place:
                self._repeated(known, place)
        places = list(first.values())
        if self.geoid is not None and places:
            self._find_geoid(places)
        for place in places:
            self._add(place)

    def _place(self, record: StationRecord) -> _Place | None:
        before = self.problems.count
        name = record.name.name()
        constraints = record.constraints.name("FFF").upper()
        kind = record.kind.name("LLH")
        if len(constraints) != 3 or set(constraints) - {"C", "F"}:
            record.constraints.wrong(f"must be three of C and F, such as CCF, not {constraints!r}")
        if kind == "ENU":
            record.kind.wrong(
                "ENU has no origin in the file, and DynAdjust does not transform it either; "
                f"valid: {', '.join(STATION_TYPES)}"
            )
        elif kind not in STATION_TYPES:
            record.kind.wrong(f"{kind!r} is not read; valid: {', '.join(STATION_TYPES)}")
        if self.problems.count > before:
            return None
        if constraints[2] == "C" and kind in ORTHOMETRIC_TYPES and not self.takes_orthometric:
            record.kind.wrong(f"{kind} has an orthometric height, which is constrained, {NO_GEOID}")
        geodetic, xyz = np.full(3, np.nan), None
        if kind == "XYZ":
            xyz = np.array([f.number() for f in record.coordinates])
            if np.isfinite(xyz).all():
                geodetic = np.array([float(v) for v in self.ellipsoid.to_geodetic(xyz)])
        elif kind == "UTM":
            geodetic = self._of_grid(record)
        else:
            geodetic = read_geodetic(record.coordinates)
        if self.problems.count > before:
            return None
        return _Place(record, name, constraints, kind, geodetic, xyz)

    def _repeated(self, known: _Place, place: _Place) -> None:
        """Leave a second record of a free station out, as DynAdjust does; refuse others."""
        source, line = place.record.source, place.record.line
        if known.constraints == place.constraints == "FFF":
            source.leave_out(line, REPEATED_STATIONS, place.name)
            return
        where = known.record.source.place(known.record.line)
        source.wrong(
            line, f"station {place.name[:40]!r} stands in {where}, and one of both is constrained"
        )

    def _of_grid(self, record: StationRecord) -> Array:
        """Return latitude, longitude and height of easting, northing and height."""
        east, north, height = (f.number() for f in record.coordinates)
        zone, south = read_zone(record.zone)
        if zone is None or is_unread(east, north, height):
            return np.full(3, np.nan)
        e = self.ellipsoid
        found = record.source.attempt(
            record.line,
            lambda: proj.transformed(
                proj.pipeline(
                    f"+proj=utm +zone={zone}{' +south' if south else ''} +a={e.a!r} "
                    f"+rf={e.inverse_flattening!r}",
                    what="UTM",
                ),
                np.array([[east, north, height]]),
                what="UTM",
                inverse=True,
            ),
        )
        if found is None:
            return np.full(3, np.nan)
        return np.array([math.radians(found[0, 1]), math.radians(found[0, 0]), height])

    def _find_geoid(self, places: Sequence[_Place]) -> None:
        """Note undulations and deflections of the stations."""
        assert self.geoid is not None
        at = np.array([p.geodetic for p in places])
        names = [p.name for p in places]
        try:
            found: GeoidValues = self.geoid.at(at[:, 0], at[:, 1], names)
        except InputError as error:
            lines = {f"point {p.name!r}": p.record for p in places}
            for problem in error.problems:
                record = lines.get(problem.where)
                where = record.source.place(record.line) if record else problem.where
                self.problems.wrong(problem.what, f"{where}: {problem.where}" if record else where)
            return
        self.undulations = dict(zip(names, found.undulation.tolist(), strict=True))
        both = zip(names, found.xi.tolist(), found.eta.tolist(), strict=True)
        self.deflections = {n: (x, y) for n, x, y in both if math.isfinite(x) and math.isfinite(y)}

    def _add(self, place: _Place) -> None:
        record, before = place.record, self.problems.count
        xyz = place.xyz
        if xyz is None:
            height = place.geodetic[2]
            if place.kind in ORTHOMETRIC_TYPES:
                height += self.undulations.get(place.name, 0.0)
            xyz = geocentric(self.ellipsoid, place.geodetic[0], place.geodetic[1], height)
        order = CONSTRAINED_AXES[place.kind]
        axes = "".join(a for a, c in zip(order, place.constraints, strict=True) if c == "C")
        held = axes if place.kind == "XYZ" else "xyz" if len(axes) == 3 else ""
        record.source.attempt(
            record.line, self.network.add_point, place.name, xyz.tolist(), fixed=held
        )
        if not axes or held or self.problems.count > before:
            return
        made = record.source.attempt(
            record.line,
            ControlPoint,
            place.name,
            tuple(xyz.tolist()),
            axes=axes,
            sigma=(CONSTRAINED_SIGMA_M,) * len(axes),
            source=record.source.place(record.line),
        )
        if made is not None:
            record.source.attempt(record.line, self.network.add, made)


def read_geodetic(fields: Sequence[Field]) -> Array:
    """Return latitude, longitude (rad) and height (m) of fields in packed degrees, (3,)."""
    latitude, longitude = (f.number(PACKED_DEGREES) for f in fields[:2])
    height = fields[2].number()
    if abs(latitude) > math.pi / 2:
        fields[0].wrong("must be a latitude from -90 to 90 degrees")
    return np.array([latitude, longitude, height])


def read_zone(field: Field) -> tuple[int | None, bool]:
    """Return the zone of UTM, None after a problem, and whether it is the southern one.

    A letter before the number is the hemisphere; without one it is the southern, as that of
    DynAdjust, whose projection is the Map Grid of Australia.
    """
    text = field.name()
    letter = text[:1].upper() if text[:1].isalpha() else ""
    digits = text[len(letter) :].strip()
    if text and (letter not in ("", "N", "S") or not digits.isascii() or not digits.isdigit()):
        field.wrong(f"must be a zone from 1 to 60, S or N before it, not {text[:20]!r}")
        return None, True
    zone = int(digits) if digits else 0
    if text and not 1 <= zone <= 60:
        field.wrong(f"must be a zone from 1 to 60, not {text[:20]!r}")
    return (zone if 1 <= zone <= 60 else None), letter != "N"


def geocentric(ellipsoid: Ellipsoid, latitude: float, longitude: float, height: float) -> Array:
    """Return X, Y, Z (3,) of one place."""
    at = (np.array([latitude]), np.array([longitude]), np.array([height]))
    return np.asarray(ellipsoid.to_cartesian(*at)[0])
