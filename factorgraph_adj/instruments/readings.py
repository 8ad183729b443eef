"""Readings of instruments as grammars return them: lines, sights, stations, sensors, postings.

A source (`factorgraph_adj.instruments.line_sources`) yields a `ReceivedLine` for each line or
message. A grammar (`factorgraph_adj.instruments.grammars`) makes `Reading`s of it, in metres,
radians, kelvin and pascal. The mapping of an instrument makes `Posting`s of the readings.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..observations import Observation


@dataclass(frozen=True)
class ReceivedLine:
    """A line of text, or a message, as it came."""

    text: bytes
    """Its bytes, without the end of the line."""
    received: float
    """Time of the receipt, seconds since 1970 UTC."""
    number: int
    """Number of the line among those of the source, from 1."""
    place: str = ""
    """Place where the line is kept, such as ``line 12``, for sources that are read again after a
    restart; empty: the source is live, and says each line once."""
    channel: str = ""
    """Topic of a message, or name of the connection; empty: the source has one."""
    content: Any = None
    """The decoded message, for sources whose messages are no text."""

    @property
    def digest(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of its bytes."""
        return hashlib.sha256(self.text).hexdigest()[:16]

    def decoded(self) -> str:
        """Return the text; bytes that are no ASCII become U+FFFD, which no grammar has."""
        return self.text.decode("ascii", errors="replace")


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What a line says."""

    stamped: float | None = None
    """Time by the clock of the instrument, seconds since 1970 UTC; None: the line has none."""
    in_utc: bool = False
    """Whether ``stamped`` is UTC whatever the rules for clocks are, as of GNSS."""
    identity: str = ""
    """Number or time by which the line differs from all others of the instrument; empty: it has
    none, so that two readings of the same values may be the same text."""


@dataclass(frozen=True, kw_only=True)
class Occupation(Reading):
    """An instrument is set up on a station."""

    station: str
    """Name of the point."""
    instrument_height: float | None = None
    """Height of the instrument, metres; None: the mapping states it, or a later reading."""


@dataclass(frozen=True, kw_only=True)
class InstrumentHeight(Reading):
    """The height of the instrument of the present set-up."""

    height: float
    """Height, metres."""


@dataclass(frozen=True, kw_only=True)
class Sight(Reading):
    """The readings of a target in one face."""

    target: str
    """Name of the target; empty: the line has none, and the mapping states it."""
    direction: float | None = None
    """Horizontal reading, radians."""
    zenith: float | None = None
    """Zenith reading, radians, in face 2 from π to 2π."""
    distance: float | None = None
    """Slope distance, metres."""
    horizontal: float | None = None
    """Horizontal distance, metres, which counts where there is no slope distance."""
    target_height: float | None = None
    """Height of the target, metres; None: that of the mapping."""
    face: int | None = None
    """Face, 1 or 2; None: the zenith reading determines it."""
    applied_ppm: float | None = None
    """Atmospheric correction that is in the distance, millionths; None: the line does not say."""


@dataclass(frozen=True, kw_only=True)
class SensorValues(Reading):
    """Values of a sensor by quantity, in SI: kelvin, pascal, ratio, metres, radians."""

    values: Mapping[str, float]
    """Values by quantity; those of the atmosphere are ``temperature`` (K), ``pressure`` (Pa) and
    ``humidity`` (ratio from 0 to 1)."""


@dataclass(frozen=True, kw_only=True)
class Observed(Reading):
    """Observations that a grammar makes itself, such as positions of GNSS."""

    observations: tuple[Observation, ...]
    """The observations; names of points are those of the instrument, which the mapping renames."""


@dataclass(frozen=True)
class Posting:
    """One object of the stream protocol, with when it was measured and a name of its own."""

    record: dict[str, Any]
    """The object: ``{"do": "add", "observations": […]}``, see `factorgraph_adj.service.stream`."""
    network: str
    """Name of the network."""
    time: float
    """Time of the measurement, seconds since 1970 UTC."""
    request: str
    """Text that is the same whenever the same readings are posted: instrument, time or line of
    the first reading, digest of all its lines."""
    lines: tuple[int, ...] = field(default=(), compare=False)
    """Numbers of the lines of which it was made."""
    measured: dict[str, Any] | None = field(default=None, compare=False)
    """Instrument, begin, end and round of a set, see `factorgraph_adj.site.measured_sets`; None:
    it is no set."""
