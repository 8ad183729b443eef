"""Records of stations and measurements of DynAdjust, whatever the syntax of their file.

DynaML and the files of fixed columns have the same records: `dynaml` and `dynadjust` take their
fields from elements and from columns, `dynadjust_measurements` makes observations of them. Angles
are packed degrees in both.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..source import Field, Source


@dataclass(frozen=True, eq=False)
class StationRecord:
    """A station."""

    source: Source
    """Its file."""
    line: int
    """Line of the record."""
    name: Field
    """Name."""
    constraints: Field
    """Three of C and F: coordinates that are constrained or free, in their order."""
    kind: Field
    """LLH, LLh, XYZ, UTM or ENU."""
    coordinates: tuple[Field, Field, Field]
    """Latitude, easting or X; longitude, northing or Y; height or Z."""
    zone: Field
    """Hemisphere and zone of UTM."""


@dataclass(frozen=True, eq=False)
class MemberRecord:
    """A vector or a position of a cluster."""

    line: int
    """Its line."""
    first: Field
    """Station."""
    second: Field
    """Target of a vector."""
    value: tuple[Field, Field, Field]
    """X, Y, Z, or latitude, longitude, height."""
    own: tuple[Field, Field, Field, Field, Field, Field]
    """Covariance xx, xy, xz, yy, yz, zz."""
    crosses: tuple[tuple[Field, ...], ...]
    """Covariances with each of the members that follow, nine by rows."""


@dataclass(frozen=True, eq=False)
class DirectionRecord:
    """A direction of a set."""

    line: int
    """Its line."""
    ignored: bool
    """Whether it is switched off."""
    target: Field
    """Target."""
    value: Field
    """Reading, packed degrees."""
    sigma: Field
    """Standard deviation, seconds of arc."""


@dataclass(frozen=True, eq=False)
class MeasurementRecord:
    """A measurement, a set of directions or a cluster."""

    source: Source
    """Its file."""
    line: int
    """Line of the record."""
    kind: str
    """Letter of its type."""
    ignored: bool
    """Whether it is switched off."""
    stations: tuple[Field, Field, Field]
    """Station, target, second target."""
    value: Field
    """Length, or angle in packed degrees."""
    sigma: Field
    """Standard deviation, metres or seconds of arc."""
    heights: tuple[Field, Field]
    """Heights of instrument and target."""
    frame: Field
    """Reference frame of a vector or a position."""
    epoch: Field
    """Epoch of it, dd.mm.yyyy."""
    scales: tuple[Field, Field, Field, Field]
    """Factors V of the covariance, and P, L, H of its north, east and up."""
    coordinates: Field
    """XYZ, LLH or LLh, of positions."""
    total: Field
    """Number of members, or of directions after the first."""
    members: tuple[MemberRecord, ...]
    """Vectors or positions."""
    directions: tuple[DirectionRecord, ...]
    """Directions of a set, the first one included."""

    @property
    def label(self) -> str:
        """Type and stations, for messages."""
        ends = (f.value for f in self.stations)
        return " ".join((self.kind, *(str(v) for v in ends if v)))


@dataclass(frozen=True, eq=False)
class RecordFile:
    """The records of one file."""

    source: Source
    """The file."""
    frame: str
    """Reference frame that its head states; '' where it states none."""
    stations: tuple[StationRecord, ...]
    """Stations."""
    measurements: tuple[MeasurementRecord, ...]
    """Measurements."""
