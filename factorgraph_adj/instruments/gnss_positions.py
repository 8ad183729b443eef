"""Readings of GNSS receivers: averages of positions of a mark, which the mapping places in a frame.

Options of grammars that read positions (``nmea``, ``ros``):

    point = "G1"                   # the mark; without it the topic of the message is its name
    antenna_height = 1.234         # m, above the mark
    average = "60 s"               # period, from multiples of it; 0: every position is observed
    correlation_time = "100 s"     # see `position_averages`; 0: positions are independent
    least_quality = "fixed"        # or float, differential, single: lower ones are left out
    max_age = "10 s"               # of the corrections
    sigma_mm = [8, 8, 15]          # σ of east, north, up of a position, if it states none
    sigma_factor = 1.0             # factor of σ that receivers state, which are often too small

An average is observed at the mean time of its positions, in UTC by the receiver: the rules for
clocks of instruments do not apply to it. A period is complete when a position of a later one comes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np

from ..crs.reference_system import ReferenceSystem
from ..errors import InputError, known
from ..frames import Frame
from ..types import Array
from .gnss_fixes import GnssFix, Quality, position_record
from .instrument_settings import duration
from .position_averages import PositionAverages
from .readings import Reading

USABLE: tuple[Quality, ...] = ("single", "differential", "float", "fixed")
"""Qualities that ``least_quality`` may name."""


@dataclass(frozen=True, kw_only=True)
class AntennaPosition(Reading):
    """The position of an antenna; ``stamped`` is UTC."""

    point: str
    """Name of the mark."""
    fix: GnssFix
    """The position with its covariance."""
    antenna_height: float
    """Height of the antenna above the mark, metres."""

    def record(self, point: str, frame: Frame, system: ReferenceSystem | None) -> dict[str, Any]:
        """Return the record of the ``gnss_position``, see `gnss_fixes.position_record`.

        Args:
            point: name of the mark in the network.
            frame: frame of the network.
            system: its reference system.
        """
        return position_record(self.fix, point, frame, system, antenna_height=self.antenna_height)


@dataclass(frozen=True)
class PositionOptions:
    """Options of positions, see the module."""

    point: str = ""
    antenna_height: float = 0.0
    average: float | str = 60.0
    correlation_time: float | str = 100.0
    least_quality: str = "fixed"
    max_age: float | str = 10.0
    sigma_mm: float | list[float] | None = None
    sigma_factor: float = 1.0

    def __post_init__(self) -> None:
        """Check the options."""
        problems = []
        for name in ("average", "correlation_time", "max_age"):
            try:
                found = duration(getattr(self, name))
            except ValueError as error:
                problems.append(f"{name} {error}")
                continue
            if found < 0.0:
                problems.append(f"{name} must not be negative")
            object.__setattr__(self, name, found)
        if self.least_quality not in USABLE:
            valid = known(USABLE, meant=self.least_quality)
            problems.append(f"least_quality must be one of {valid}, not {self.least_quality!r}")
        if self.sigma_factor <= 0.0:
            problems.append("sigma_factor must be greater than zero")
        sigma = self.sigma_mm if isinstance(self.sigma_mm, list) else [self.sigma_mm]
        given = [s for s in sigma if s is not None]
        if self.sigma_mm is not None and (
            len(given) not in (1, 3)
            or not all(isinstance(s, int | float) and not isinstance(s, bool) for s in given)
            or not all(s > 0.0 for s in given)
        ):
            problems.append("sigma_mm must be one number above zero, or three: east, north, up")
        if problems:
            raise InputError("; ".join(problems))

    @property
    def covariance(self) -> Array | None:
        """Covariance of a position that states none, (3, 3) m²; None: not stated."""
        if self.sigma_mm is None:
            return None
        return np.diag(np.square(1e-3 * np.broadcast_to(self.sigma_mm, (3,)).astype(float)))


USUAL_POSITIONS = PositionOptions()
"""The options where nothing is stated."""


@dataclass
class PositionSeries:
    """Positions of a receiver, to readings of its mark."""

    options: PositionOptions
    point: str
    averages: PositionAverages = field(init=False)

    def __post_init__(self) -> None:
        """Start without positions."""
        o = self.options
        quality = next(q for q in get_args(Quality) if q == o.least_quality)
        self.averages = PositionAverages(
            float(o.average), float(o.correlation_time), quality, float(o.max_age)
        )

    def readings(self, fixes: Iterable[GnssFix]) -> list[Reading]:
        """Return the averages that positions complete.

        Raises:
            InputError: a position has no covariance and none is stated, or a period that ends has
                no average; further positions count nevertheless.
        """
        out: list[Reading] = []
        problems: list[str] = []
        for fix in fixes:
            try:
                average = self.averages.take(self._weighted(fix))
            except InputError as error:
                problems.append(str(error))
                continue
            if average is not None:
                out.append(
                    AntennaPosition(
                        point=self.point,
                        fix=average.fix,
                        antenna_height=self.options.antenna_height,
                        stamped=average.fix.time,
                        in_utc=True,
                        identity=f"{average.fix.time:.3f}",
                    )
                )
        if problems:
            raise InputError("; ".join(problems))
        return out

    def _weighted(self, fix: GnssFix) -> GnssFix:
        """Return a position with the covariance that counts."""
        if not fix.is_at_least(self.averages.least_quality):
            return fix
        if fix.covariance is not None:
            return replace(fix, covariance=self.options.sigma_factor**2 * fix.covariance)
        if self.options.covariance is None:
            raise InputError("a position without a standard deviation: send GST, or state sigma_mm")
        return replace(fix, covariance=self.options.covariance)
