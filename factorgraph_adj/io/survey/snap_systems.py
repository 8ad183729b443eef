"""Coordinate systems of SNAP by their codes: ellipsoid, form of the coordinates, EPSG code.

The table has the systems of New Zealand and the global ones of ``coordsys.def`` of LINZ (BSD-3)
that EPSG has with the same parameters: latitude and longitude of the origin within 2·10⁻⁶ degrees,
scale and false origin equal. Circuits of NZGD1949 have in SNAP a unit of 0.999998261 m, in EPSG
metres: bearings are the same in both, coordinates are not.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ...crs.reference_system import ReferenceSystem
from ...ellipsoid import Ellipsoid, ellipsoid
from ...errors import known
from ...types import Array
from ..source import Field

Form: TypeAlias = Literal["geodetic", "geocentric", "projection"]
"""What coordinates of a system are: latitude, longitude; X, Y, Z; easting, northing."""
_CODE = re.compile(
    r"(?P<name>\w+)(?:\((?P<version>\w+)\))?(?:/(?P<vertical>\w+))?(?:@(?P<epoch>[\w.\-]+))?"
)
"""Code of a system: version of its deformation model, vertical datum, epoch."""


@dataclass(frozen=True)
class SnapSystem:
    """A coordinate system."""

    code: str
    """Code in SNAP."""
    form: Form
    """Form of its coordinates."""
    ellipsoid_name: str
    """Name of its ellipsoid, see `factorgraph_adj.ellipsoid.ELLIPSOIDS`."""
    datum: str
    """Code of its datum."""
    epsg: int | None = None
    """EPSG code of a projection."""
    bearings_only: bool = False
    """Whether EPSG's coordinates have another unit than SNAP's."""

    @property
    def ellipsoid(self) -> Ellipsoid:
        """The ellipsoid."""
        return ellipsoid(self.ellipsoid_name)

    @cached_property
    def reference_system(self) -> ReferenceSystem:
        """The reference system of a projection, with ellipsoidal heights."""
        return ReferenceSystem(f"EPSG:{self.epsg}", heights="ellipsoidal")

    def grid(self, latitude: Array, longitude: Array) -> Array:
        """Return easting, northing, 0 in the projection of places (n,) rad, (n, 3) metres.

        Raises:
            InputError: pyproj is missing, or a place is outside of the projection.
        """
        level = np.zeros(len(latitude))
        return self.reference_system.from_geodetic(latitude, longitude, level)


CIRCUITS = (
    *("EDEN", "PLEN", "POVE", "HAWK", "TARA", "TUHI", "WANG", "WAIR", "WELL", "COLL", "NELS"),
    *("KARA", "BULL", "GREY", "AMUR", "MARL", "HOKI", "OKAR", "JACK", "PLEA", "GAWL", "TIMA"),
    *("LIND", "NICH", "YORK", "OBSE", "TAIE", "BLUF"),
)
"""Meridional circuits of New Zealand in the order of EPSG 2105 to 2132 and 27205 to 27232."""
FIRST_CIRCUIT_2000, FIRST_CIRCUIT_1949 = 2105, 27205
PROJECTIONS_2000 = {
    "NZTM": 2193,
    "CITM2000": 3793,
    "AITM2000": 3790,
    "AKTM2000": 3788,
    "CATM2000": 3789,
    "RITM2000": 3791,
    "UTM58": 2133,
    "UTM59": 2134,
    "UTM60": 2135,
}
"""EPSG codes of projections of NZGD2000."""
PROJECTIONS_1949 = {
    "NZMG": 27200,
    "UTM58_NZGD49": 27258,
    "UTM59_NZGD49": 27259,
    "UTM60_NZGD49": 27260,
}
"""EPSG codes of projections of NZGD1949 in metres."""
ELLIPSOIDS_OF_DATUMS = {
    "NZGD2000": "GRS80",
    "NZGD1949": "International1924",
    "RSRGD2000": "GRS80",
    "CHAT1979": "International1924",
    "CAMPAREA": "International1924",
    "GDA94": "GRS80",
    "AGD84": "ANS",
    "AGD66": "ANS",
    "WGS72": "WGS72",
    **{
        f"ITRF{year}": "GRS80"
        for year in (88, 89, 90, 91, 92, 93, 94, 96, 97, 2000, 2005, 2008, 2014)
    },
    **{f"WGS84_{week}": "WGS84" for week in ("D", "G730", "G873", "G1150", "G1674", "G1762")},
}
"""Ellipsoids of SNAP's datums."""
OTHER_NAMES = {"NZGD49": "NZGD1949", "WGS84": "WGS84_G1762"}
VERSIONED_DATUM = re.compile(r"(?P<name>NZGD2000|NZTM)_\d{8}")
"""A datum with the version of its deformation model in its code."""


def _systems() -> dict[str, SnapSystem]:
    """Return all systems by code."""
    out: list[SnapSystem] = []
    for datum, name in ELLIPSOIDS_OF_DATUMS.items():
        out.append(SnapSystem(datum, "geodetic", name, datum))
        out.append(SnapSystem(f"{datum}_XYZ", "geocentric", name, datum))
    for datum, table in (("NZGD2000", PROJECTIONS_2000), ("NZGD1949", PROJECTIONS_1949)):
        name = ELLIPSOIDS_OF_DATUMS[datum]
        out += [SnapSystem(code, "projection", name, datum, epsg) for code, epsg in table.items()]
    for i, circuit in enumerate(CIRCUITS):
        new = FIRST_CIRCUIT_2000 + i
        out.append(SnapSystem(f"{circuit}TM2000", "projection", "GRS80", "NZGD2000", new))
        old = ("projection", "International1924", "NZGD1949", FIRST_CIRCUIT_1949 + i, True)
        out += [SnapSystem(code, *old) for code in (f"{circuit}TM1949", circuit)]  # type: ignore[arg-type]
    return {s.code: s for s in out}


SNAP_SYSTEMS = _systems()
"""Systems by code."""


@dataclass(frozen=True)
class SystemCode:
    """A code of a system as a file states it."""

    system: SnapSystem
    """The system."""
    vertical: str = ""
    """Code of a vertical datum; empty: none."""


def read_system(field: Field) -> SystemCode | None:
    """Return the system of a code such as ``NZGD2000(20160701)``; None after a problem.

    The version in brackets and the epoch behind @ are those of a deformation model, which moves
    coordinates from one system to another: coordinates of one system need none.
    """
    text = field.name().upper()
    if not text:
        return None
    found = _CODE.fullmatch(text)
    name = text if found is None else found["name"]
    versioned = VERSIONED_DATUM.fullmatch(name)
    name = name if versioned is None else versioned["name"]
    system = SNAP_SYSTEMS.get(OTHER_NAMES.get(name, name))
    if found is None or system is None:
        field.wrong(f"{text[:40]!r} is unknown; valid: {known(SNAP_SYSTEMS, meant=name, most=12)}")
        return None
    return SystemCode(system, found["vertical"] or "")
