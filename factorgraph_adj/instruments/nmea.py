"""Positions in NMEA 0183: GGA and GNS with GST, Leica's LLQ; dates by ZDA.

=====  ============================================================================================
GGA    time of day, latitude, longitude, quality, satellites, HDOP, height above the geoid (m),
       undulation (m), age of the corrections (s), reference station
GNS    the same, with one letter of quality for each satellite system instead of the number
GST    time of day, RMS of the ranges (not used), semi-axes of the error ellipse (m) and azimuth
       of the major one (degrees from true north), σ of latitude, longitude and height (m)
LLQ    time of day, date, easting, northing of a grid, quality, satellites, coordinate quality
       (m), height (m)
ZDA    time of day, day, month, year
=====  ============================================================================================

The ellipsoidal height is height + undulation, whatever the geoid of the receiver is; a GGA without
an undulation is an error. Other sentences are checked and passed over.

**Covariance** (e, n, u) of GST: variances σ² of longitude, latitude and height; the correlation of
e and n is that of the ellipse, (a² − b²) sin θ cos θ / √(c_ee c_nn), if the variances
c_ee = a² sin² θ + b² cos² θ and c_nn = a² cos² θ + b² sin² θ of the ellipse agree with the stated
ones within `ELLIPSE_TOLERANCE`, and 0 otherwise: receivers exist that do not fill the ellipse. A
GST of zero σ is an error. LLQ states one coordinate quality q for the position: σ of height is
taken to be twice those of east and north, q² = σ² + σ² + (2σ)².

**Date**: GGA, GNS and GST state the time of day alone. Its day is the one that is nearest to the
last ZDA, or to the arrival of the line if there was none. LLQ states its date, month first as Leica
writes it, or day first as receivers of Trimble do: see `NmeaPositions`.

**Pairs**: a GST belongs to the position of the same time of day, whichever comes first. A position
whose GST has not come when the next one is there has no covariance. A receiver that sends GGA and
GNS, or a sentence for each of several talkers, states a position again: the first one is taken.

Not read: GLL and RMC (no height, no σ), GGK, GGQ, LLK (proprietary, no covariance).

Sources: NMEA 0183 version 4.11 as published in receiver manuals: Trimble, "NMEA-0183 messages: GGA,
GNS, GST, LLQ, ZDA" (receiverhelp.trimble.com); Leica iCON gps 80 user manual, A.13 LLQ. Tried on
the examples of these manuals.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal, get_args

import numpy as np

from ..errors import InputError, known
from ..io.source import Field, Problems, is_unread
from ..types import Array
from .gnss_fixes import QUALITIES, GnssFix, Quality
from .gnss_positions import USUAL_POSITIONS, PositionOptions, PositionSeries
from .grammars import GrammarRecord
from .nmea_sentences import Sentence, angle_of, sentence_of, time_of_day
from .readings import Reading, ReceivedLine

DAY = 86_400.0
"""Seconds of a day."""
ELLIPSE_TOLERANCE = 0.25
"""Largest relative difference of the variances of the ellipse and of those that are stated: σ of
millimetres are printed with two or three digits."""
ROUNDED_SIGMA_M = 0.002
"""Difference of σ of the ellipse and the stated ones that rounding explains, metres."""
GGA_QUALITY: dict[str, Quality] = {
    "0": "none",
    "1": "single",
    "2": "differential",
    "3": "differential",
    "4": "fixed",
    "5": "float",
    "6": "estimated",
    "7": "manual",
    "8": "simulated",
    "9": "differential",
}
"""Quality of a position by the number in GGA; 3 is PPS, 9 is SBAS in receivers of NovAtel."""
GNS_QUALITY: dict[str, Quality] = {
    "N": "none",
    "A": "single",
    "D": "differential",
    "P": "differential",
    "R": "fixed",
    "F": "float",
    "E": "estimated",
    "M": "manual",
    "S": "simulated",
}
"""Quality of the satellites of a system by the letter in GNS; that of a position is the lowest of
the systems that are used."""
LLQ_QUALITY: dict[str, Quality] = {
    "0": "none",
    "1": "single",
    "2": "differential",
    "3": "fixed",
    "5": "float",
}
"""Quality by the number in LLQ."""
HEIGHT_RATIO = 2.0
"""σ of the height over σ of east and of north where one coordinate quality is stated."""
CovarianceChoice = Literal["gst", "stated"]
"""Where σ comes from."""
LlqDate = Literal["mmddyy", "ddmmyy"]
"""Order of month and day in the date of LLQ."""
FieldAt = Callable[[int, str], Field]
"""Field of a sentence by its number from 1 and its name in messages."""

_DATE = re.compile(r"[0-9]{6}", re.ASCII)


def covariance_of_gst(
    major: float | None,
    minor: float | None,
    azimuth: float | None,
    sigma: tuple[float, float, float],
) -> Array:
    """Return the covariance of east, north, up, (3, 3) m².

    >>> (1e6 * covariance_of_gst(0.02, 0.01, np.pi / 4, (0.0158, 0.0158, 0.03))).round(0).tolist()
    [[250.0, 150.0, 0.0], [150.0, 250.0, 0.0], [0.0, 0.0, 900.0]]

    Args:
        major: major semi-axis of the ellipse, metres; None: not stated.
        minor: minor semi-axis, metres; None: not stated.
        azimuth: azimuth of the major semi-axis, radians; None: not stated.
        sigma: σ of east (longitude), north (latitude) and height, metres.
    """
    out = np.diag(np.square(sigma))
    if major is None or minor is None or azimuth is None:
        return out
    s, c = math.sin(azimuth), math.cos(azimuth)
    east, north = (major * s) ** 2 + (minor * c) ** 2, (major * c) ** 2 + (minor * s) ** 2
    if east <= 0.0 or north <= 0.0:
        return out
    for variance, stated in ((east, sigma[0]), (north, sigma[1])):
        far = abs(variance / stated**2 - 1.0) > ELLIPSE_TOLERANCE
        if far and abs(math.sqrt(variance) - stated) > ROUNDED_SIGMA_M:
            return out
    # Rounded semi-axes of which one is zero would give a singular matrix.
    rho = (major**2 - minor**2) * s * c / math.sqrt(east * north)
    out[0, 1] = out[1, 0] = min(max(rho, -0.99), 0.99) * sigma[0] * sigma[1]
    return out


@dataclass
class _Waiting:
    """What has come for one time of day."""

    fix: GnssFix | None = None
    """The position."""
    covariance: Array | None = None
    """The covariance of GST."""


@dataclass
class NmeaPositions:
    """Sentences in the order in which they come, to positions with covariances."""

    covariances: CovarianceChoice = "gst"
    """``stated``: positions do not wait for a GST, as the user states σ."""
    llq_date: LlqDate = "mmddyy"
    """Order of month and day in the date of LLQ."""
    passed_over: Counter[str] = field(default_factory=Counter)
    """Number of sentences that hold no position, by their types."""
    _date: float | None = None
    """Time of the last ZDA, seconds since 1970 UTC."""
    _waiting: dict[float, _Waiting] = field(default_factory=dict)
    """What waits for its other half, by the time of day."""
    _paired_last: float | None = None
    """Time of day of the last position that had its covariance."""

    def take(self, line: str, arrival: float | None = None) -> list[GnssFix]:
        """Return the positions that a line completes, usually none or one.

        Args:
            line: a sentence, with or without the ends of lines.
            arrival: when it came, seconds since 1970 UTC; None: unknown, as in a file.

        Raises:
            InputError: the line is no sentence, or what it holds cannot be read: all problems.
        """
        sentence = sentence_of(line)
        read = {
            "GGA": self._position,
            "GNS": self._position,
            "GST": self._gst,
            "LLQ": self._llq,
            "ZDA": self._zda,
        }.get(sentence.type)
        if read is None or sentence.talker == "P":
            self.passed_over[sentence.type] += 1
            return []
        problems = Problems()

        def at(number: int, what: str) -> Field:
            return problems.field(sentence.text(number), what, sentence.type)

        found = read(sentence, at, problems, arrival)
        problems.raise_all()
        return found

    def rest(self) -> list[GnssFix]:
        """Return positions whose GST has not come, and forget what waits: the stream has ended."""
        found = [w.fix for w in self._waiting.values() if w.fix is not None]
        self._waiting.clear()
        return found

    # -- sentences ------------------------------------------------------------------------------

    def _zda(
        self, sentence: Sentence, at: FieldAt, problems: Problems, arrival: float | None
    ) -> list[GnssFix]:
        if not any(sentence.fields):
            return []
        seconds = time_of_day(at(1, "time"))
        day, month, year = (
            at(i, what).integer(least=least, largest=largest)
            for i, what, least, largest in (
                (2, "day", 1, 31),
                (3, "month", 1, 12),
                (4, "year", 1980, 9999),
            )
        )
        if day is None or month is None or year is None or is_unread(seconds):
            return []
        midnight = _midnight(year, month, day, at(2, "day"))
        if not is_unread(midnight):
            self._date = midnight + seconds
        return []

    def _position(
        self, sentence: Sentence, at: FieldAt, problems: Problems, arrival: float | None
    ) -> list[GnssFix]:
        gns = sentence.type == "GNS"
        quality = _gns_quality(at(6, "mode")) if gns else at(6, "quality").choice(GGA_QUALITY)
        seconds = time_of_day(at(1, "time")) if sentence.text(1) or quality != "none" else math.nan
        if quality == "none" and is_unread(seconds):
            return [GnssFix(arrival or math.nan, None, quality="none")]
        if quality is None or is_unread(seconds):
            return []
        time = self._time(seconds, arrival, at(1, "time"))
        if quality == "none":
            return self._complete(seconds, GnssFix(time, None, quality="none"))
        latitude = angle_of(at(2, "latitude"), at(3, "hemisphere (N, S)"), "NS", 90.0)
        longitude = angle_of(at(4, "longitude"), at(5, "hemisphere (E, W)"), "EW", 180.0)
        height, undulation, age = (9, 10, 11) if gns else (9, 11, 13)
        h = at(height, "height above the geoid").number()
        n = at(undulation, "undulation of the geoid").number()
        if not gns:
            for number, what in ((10, "unit of the height"), (12, "unit of the undulation")):
                at(number, what).choice({"M": "M"})
        satellites = at(7, "number of satellites").integer(largest=999, default=None)
        seconds_old = at(age, "age of the corrections").number(least=0.0, default=math.nan)
        if problems.count:
            return []
        fix = GnssFix(
            time,
            (latitude, longitude, h + n),
            quality=quality,
            satellites=satellites,
            age=None if math.isnan(seconds_old) else seconds_old,
        )
        return self._complete(seconds, fix)

    def _gst(
        self, sentence: Sentence, at: FieldAt, problems: Problems, arrival: float | None
    ) -> list[GnssFix]:
        if not any(sentence.fields[1:]):
            return []  # the receiver has no position
        seconds = time_of_day(at(1, "time"))
        north, east, up = (
            at(i, f"σ of {what}").sigma()
            for i, what in ((6, "latitude"), (7, "longitude"), (8, "height"))
        )
        major, minor, azimuth = (
            at(i, what).number_or_none(unit)
            for i, what, unit in (
                (3, "semi-major axis", ""),
                (4, "semi-minor axis", ""),
                (5, "azimuth of the semi-major axis", "deg"),
            )
        )
        if problems.count or self.covariances == "stated":
            return []
        if seconds == self._paired_last:
            self.passed_over["GST again"] += 1
            return []
        waiting = self._waiting.setdefault(seconds, _Waiting())
        waiting.covariance = covariance_of_gst(major, minor, azimuth, (east, north, up))
        return self._paired(seconds)

    def _llq(
        self, sentence: Sentence, at: FieldAt, problems: Problems, arrival: float | None
    ) -> list[GnssFix]:
        if not sentence.text(7) and not sentence.text(3):
            # With several systems, Leica sends one LLQ of each, with the number of satellites.
            self.passed_over["LLQ without a position"] += 1
            return []
        quality = at(7, "quality").choice(LLQ_QUALITY)
        seconds, date = time_of_day(at(1, "time")), at(2, "date")
        midnight = self._llq_midnight(date)
        if quality == "none" and not problems.count:
            return [GnssFix(midnight + seconds, None, quality="none")]
        east, north, height = (
            at(i, what).number() for i, what in ((3, "easting"), (5, "northing"), (10, "height"))
        )
        for number, what in ((4, "unit of the easting"), (6, "unit of the northing")):
            at(number, what).choice({"M": "M"})
        at(11, "unit of the height").choice({"M": "M"})
        q = at(9, "coordinate quality").number_or_none()
        satellites = at(8, "number of satellites").integer(largest=999, default=None)
        if problems.count or quality is None:
            return []
        covariance = None
        if q is not None and q > 0.0 and self.covariances != "stated":
            variance = q * q / (2.0 + HEIGHT_RATIO**2)
            covariance = np.diag([variance, variance, HEIGHT_RATIO**2 * variance])
        return [
            GnssFix(
                midnight + seconds,
                (east, north, height),
                grid=True,
                quality=quality,
                satellites=satellites,
                covariance=covariance,
            )
        ]

    def _llq_midnight(self, date: Field) -> float:
        text = str(date.value or "")
        if _DATE.fullmatch(text) is None:
            date.wrong(f"must be six digits ({self.llq_date}), not {text[:20]!r}")
            return math.nan
        a, b, year = int(text[:2]), int(text[2:4]), 2000 + int(text[4:])
        month, day = (a, b) if self.llq_date == "mmddyy" else (b, a)
        return _midnight(year, month, day, date)

    # -- times and pairs ------------------------------------------------------------------------

    def _time(self, seconds: float, arrival: float | None, where: Field) -> float:
        """Return the time, seconds since 1970 UTC, of a time of day."""
        near = self._date if self._date is not None else arrival
        if near is None:
            where.wrong("is a time of day without a date: neither ZDA nor its arrival is known")
            return math.nan
        return seconds + DAY * round((near - seconds) / DAY)

    def _complete(self, seconds: float, fix: GnssFix) -> list[GnssFix]:
        """Return positions that are complete now that a further one has come."""
        if self.covariances == "stated" or fix.position is None:
            return [*self._others(seconds), fix]
        if seconds == self._paired_last:
            self.passed_over["position again"] += 1
            return []
        waiting = self._waiting.setdefault(seconds, _Waiting())
        waiting.fix = fix
        return self._paired(seconds)

    def _paired(self, seconds: float) -> list[GnssFix]:
        """Return the positions that wait no longer once something has come for a time."""
        found = self._others(seconds)
        waiting = self._waiting[seconds]
        if waiting.fix is not None and waiting.covariance is not None:
            del self._waiting[seconds]
            self._paired_last = seconds
            found.append(replace(waiting.fix, covariance=waiting.covariance))
        return found

    def _others(self, seconds: float) -> list[GnssFix]:
        """Return positions of other times, which have no covariance: theirs did not come."""
        found = []
        for other in [s for s in self._waiting if s != seconds]:
            fix = self._waiting.pop(other).fix
            if fix is not None:
                found.append(fix)
        return found


def _gns_quality(mode: Field) -> Quality | None:
    """Return the lowest quality of the systems that are used; None after a problem."""
    letters = str(mode.value or "")
    if not letters or set(letters) - set(GNS_QUALITY):
        mode.wrong(f"must be letters of {''.join(GNS_QUALITY)}, not {letters[:20]!r}")
        return None
    used = [GnssFix.RANKS[GNS_QUALITY[letter]] for letter in letters if letter != "N"]
    return QUALITIES[min(used, default=0)]


def _midnight(year: int, month: int, day: int, where: Field) -> float:
    """Return the seconds from 1970 to the beginning of a day; NaN after a problem."""
    try:
        return datetime(year, month, day, tzinfo=UTC).timestamp()
    except ValueError:
        where.wrong(f"is no date: day {day}, month {month}, year {year}")
        return math.nan


class Nmea:
    """Grammar of receivers that send NMEA 0183: averages of positions of a mark.

    Each topic or connection has its own dates, pairs and averages. Lines of files have no arrival:
    their dates come from ZDA or LLQ.
    """

    def __init__(
        self,
        *,
        covariances: CovarianceChoice = "gst",
        llq_date: LlqDate = "mmddyy",
        positions: PositionOptions = USUAL_POSITIONS,
    ) -> None:
        """Take the options of [[instrument]].

        Args:
            covariances: ``stated``: do not wait for GST, as ``sigma_mm`` states σ.
            llq_date: order of month and day in the date of LLQ.
            positions: see `gnss_positions`.

        Raises:
            InputError: an option is wrong, or ``stated`` has no ``sigma_mm``.
        """
        for name, value, choice in (
            ("covariances", covariances, CovarianceChoice),
            ("llq_date", llq_date, LlqDate),
        ):
            if value not in get_args(choice):
                raise InputError(f"{name} must be one of {known(get_args(choice))}, not {value!r}")
        if covariances == "stated" and positions.sigma_mm is None:
            raise InputError("covariances = 'stated' needs sigma_mm")
        self.covariances, self.llq_date, self.positions = covariances, llq_date, positions
        self._channels: dict[str, tuple[NmeaPositions, PositionSeries]] = {}

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return the averages that a sentence completes.

        Raises:
            InputError: the line is no sentence that can be read, the mark has no name, or the
                period that it ends has no position.
        """
        point = self.positions.point or line.channel
        if not point:
            raise InputError("the mark has no name: state point")
        if line.channel not in self._channels:
            sentences = NmeaPositions(self.covariances, self.llq_date)
            self._channels[line.channel] = sentences, PositionSeries(self.positions, point)
        sentences, series = self._channels[line.channel]
        arrival = None if line.place else line.received
        return series.readings(sentences.take(line.decoded(), arrival))


GRAMMAR = GrammarRecord("nmea", "GGA, GNS, GST, LLQ and ZDA of NMEA 0183 of GNSS receivers", Nmea)
