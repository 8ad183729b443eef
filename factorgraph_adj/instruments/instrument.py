"""An instrument: lines from its source, readings by its grammar, postings by its mapping.

    [instrument] = read_instruments(document["instrument"], where="site.toml")
    Instrument(instrument, units=project.units).run(post, stop)

`Instrument.take` is the whole of it without a thread: a line in, postings out.
"""

from __future__ import annotations

import hashlib
import time as clock
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import fields, replace
from threading import Event
from typing import Any

from ..errors import AdjustmentError, InputError, system_reason
from ..io.numbers import Units
from ..io.observation_records import observation_from_record, observation_record
from ..network.network import Network
from ..observations import Observation
from .distance_corrections import SensorBoard, velocity_factor
from .gnss_positions import AntennaPosition
from .health import Health
from .instrument_settings import InstrumentSettings
from .line_log import LineLog
from .line_sources import LineSource, shown
from .message_rules import InstrumentClock, MessageGaps, RepeatedLines, iso
from .readings import (
    InstrumentHeight,
    Observed,
    Occupation,
    Posting,
    Reading,
    ReceivedLine,
    SensorValues,
    Sight,
)
from .set_formation import FormedSet, SetFormation

RETRY_S = 5.0
"""Seconds before a posting that failed is tried again."""
MAX_APPLIED_PPM = 0.05
"""Largest atmospheric correction, ppm, that a distance may have already where it is corrected."""


class Instrument:
    """An instrument of a site; one thread drives it, others may read its health."""

    def __init__(
        self,
        settings: InstrumentSettings,
        *,
        units: Units | None = None,
        sensors: SensorBoard | None = None,
        source: LineSource | None = None,
        network: Network | None = None,
        refuse_ahead: Callable[[float, float], None] = lambda time, received: None,
    ) -> None:
        """Start without lines.

        Args:
            settings: its table [[instrument]].
            units: units of the network's project, in which records are; default: metres and gon.
            sensors: values that the instruments of a site share.
            source: instead of that of the settings.
            network: the network, whose frame and reference system place positions of GNSS.
            refuse_ahead: takes the time of a reading and of its receipt, seconds UTC; raises
                `InputError` where the former is still to come.
        """
        self.settings = settings
        self.units = units or Units()
        self.sensors = SensorBoard() if sensors is None else sensors
        self.source = settings.make_source() if source is None else source
        self.network, self._refuse_ahead = network, refuse_ahead
        self.grammar = settings.make_grammar()
        self.health = Health(settings.name)
        self.sets = SetFormation(settings)
        self.clock = InstrumentClock(
            self.health, offset=-settings.utc_offset, tolerance=settings.clock_tolerance
        )
        self.repeated = RepeatedLines(settings.doubled_within)
        self.gaps = MessageGaps(self.health, settings.silent_after)
        self.log = None if settings.keep_lines is None else LineLog(settings.keep_lines_at)
        self._set_up: dict[str, ReceivedLine] = {}
        """Lines that state station and height of the instrument."""
        self._waiting: deque[Posting] = deque()
        """Postings that are not posted yet, in their order."""
        self._is_begun = False
        """Whether the log was read."""
        self._is_kept = False
        """Whether the source is read again after a restart."""
        self._late = False

    # -- lines to postings ------------------------------------------------------------------------

    def take(self, line: ReceivedLine) -> list[Posting]:
        """Take a line; return the postings that it completes. A wrong line is told, not raised."""
        self.health.count("lines")
        self.gaps.message(line.received)
        out: list[Posting] = []
        try:
            readings = list(self.grammar.read(line))
        except InputError as error:
            self._refuse(line, error)
            return out
        if readings and self.repeated.is_doubled(line, readings):
            self.health.tell("doubled", f"came twice: {self._place(line)}", line.received)
            return out
        if not readings:
            self.health.count("without_reading")
        for reading in readings:
            self.health.count("readings")
            try:
                out += self._postings(line, reading)
            except InputError as error:
                self._refuse(line, error)
        return out

    def pause(self, now: float) -> list[Posting]:
        """Note that no line has come until now; return the sets that the pause ends."""
        self.gaps.pause(now)
        return self._of_sets(self.sets.pause(now))

    def finish(self) -> list[Posting]:
        """Return the sets that are open at the end of the lines."""
        return self._of_sets(self.sets.finish())

    def _postings(self, line: ReceivedLine, reading: Reading) -> Iterator[Posting]:
        time = self._time(line, reading)
        if not isinstance(reading, Occupation | InstrumentHeight):  # these hold whenever they were
            self._refuse_ahead(time, line.received)
        match reading:
            case Occupation():
                self._set_up = {"station": line}
                station = self._name(reading.station)
                yield from self._of_sets(self.sets.occupy(station, reading.instrument_height))
            case InstrumentHeight():
                self._set_up["height"] = line
                self.sets.set_height(reading.height)
            case Sight():
                sight = self._corrected(line, reading, time)
                if sight is not None:
                    yield from self._of_sets(self.sets.sight(line, sight, time))
            case SensorValues():
                self.sensors.note(self.settings.name, reading.values, time)
            case Observed():
                renamed = [self._renamed(o) for o in reading.observations]
                yield self._posting(renamed, time, reading.stamped, [line])
            case AntennaPosition():
                yield self._posting([self._position(reading)], time, reading.stamped, [line])

    def _time(self, line: ReceivedLine, reading: Reading) -> float:
        """Return when a reading was measured; tell that it is late."""
        if reading.in_utc and reading.stamped is not None:
            time = reading.stamped
        elif reading.stamped is None or self.settings.clock == "receipt":
            return line.received
        elif self.settings.clock == "stated":
            return reading.stamped - self.settings.utc_offset
        else:
            time = self.clock.time(reading.stamped, line.received)
        late = line.received - time > self.settings.late_after
        if late and not self._late and not line.place:
            what = f"late by {line.received - time:.0f} s: {self._place(line)}"
            self.health.tell("late", what, line.received)
        elif late:
            self.health.count("late")
        self._late = late
        return time

    def _name(self, name: str) -> str:
        return self.settings.rename.get(name, name)

    def _renamed(self, o: Observation) -> Observation:
        """Return an observation with the names of the network."""
        own = {f.name for f in fields(o)}
        names = [n for n in ("station", "target", "target2", "point") if n in own]
        return replace(o, **{n: self._name(getattr(o, n)) for n in names}, source=None)

    def _position(self, reading: AntennaPosition) -> Observation:
        """Return the observation of a position in the frame of the network."""
        if self.network is None:
            raise InputError(
                "a position of GNSS needs the frame of the network, which is not known"
            )
        name = self._name(reading.point)
        return observation_from_record(
            reading.record(name, self.network.frame, self.network.crs), source=""
        )

    def _corrected(self, line: ReceivedLine, sight: Sight, time: float) -> Sight | None:
        """Return a sight with the names of the network and corrected distances; None: left out."""
        s, name = self.settings, self._name(sight.target)
        if s.only_targets and name not in s.targets:
            self.health.count("left_out")
            return None
        changed: dict[str, Any] = {"target": name}
        if sight.target_height is None:
            changed["target_height"] = s.target_heights.of(name)
        factor = self._factor(line, sight, time)
        for what in ("distance", "horizontal"):
            value = getattr(sight, what)
            if value is not None:
                ok = factor is not None
                changed[what] = factor * value + s.prisms.of(name) if factor is not None else None
                if not ok:
                    self.health.count("left_out")
        corrected = replace(sight, **changed)
        given = (corrected.direction, corrected.zenith, corrected.distance, corrected.horizontal)
        return corrected if any(v is not None for v in given) else None

    def _factor(self, line: ReceivedLine, sight: Sight, time: float) -> float | None:
        """Return the factor of the first velocity correction; None: the distance is left out."""
        air = self.settings.atmosphere
        if air is None or (sight.distance is None and sight.horizontal is None):
            return 1.0
        if abs(sight.applied_ppm or 0.0) > MAX_APPLIED_PPM:
            raise InputError(
                f"the instrument has corrected {sight.applied_ppm:g} ppm already: set 0 ppm there, "
                "or remove [instrument.atmosphere]"
            )
        factor = velocity_factor(air, self.sensors, time)
        if factor is None:
            what = f"distance left out: {air.sensor!r} has no temperature and pressure of the last "
            what += f"{air.max_age:.0f} s: {self._place(line)}"
            self.health.trouble(what, line.received)
        return factor

    def _of_sets(self, formed: Iterable[FormedSet]) -> list[Posting]:
        out = []
        for found in formed:
            for doubt in found.doubts:  # events have times of receipt, as all others
                self.health.tell("doubtful_faces", str(doubt), found.of.lines[-1].received)
            remark = "; ".join(str(d) for d in found.doubts)
            of = found.of
            posting = self._posting(found.observations, found.time, of.stamped, of.lines, remark)
            out.append(replace(posting, measured=self._measured(found)))
        return out

    def _measured(self, found: FormedSet) -> dict[str, Any] | None:
        """Return when a set was measured; None: its sights are posted one by one."""
        s, (begin, end) = self.settings, found.period
        if s.post == "sights":
            return None
        if s.clock == "instrument":  # two sets may come closer by what the clock is uncertain
            end = max(begin, end - s.clock_tolerance)
        return {"instrument": s.name, "begin": begin, "end": end, "round": found.round}

    def _posting(
        self,
        observations: Iterable[Observation],
        time: float,
        stamped: float | None,
        lines: list[ReceivedLine],
        remark: str = "",
    ) -> Posting:
        """Return observations as a posting."""
        records = [observation_record(o, units=self.units) for o in observations]
        record: dict[str, Any] = {"do": "add", "observations": records}
        if remark:
            record["remark"] = remark
        digest = hashlib.sha256(b"\n".join(line.text for line in lines)).hexdigest()[:16]
        # The clock of the instrument, or the line of a file, is the same after a restart.
        at = lines[0].place or iso(lines[0].received) if stamped is None else iso(stamped)
        request = f"{self.settings.name} {at} {digest}"
        numbers = tuple(line.number for line in lines)
        self.health.count("postings")
        return Posting(record, self.settings.network, time, request, numbers)

    def _refuse(self, line: ReceivedLine, error: InputError) -> None:
        said = "; ".join(p.what for p in error.problems)
        self.health.tell("refused", f"{self._place(line)}: {said}", line.received)

    def _place(self, line: ReceivedLine) -> str:
        return f"{line.place or f'line {line.number}'} {shown(line.text)}"

    # -- a thread ---------------------------------------------------------------------------------

    def postings(self, stop: Event) -> Generator[Posting | None]:
        """Yield postings as lines come, None while nothing does, until ``stop`` is set.

        Sets that are open then are not posted where their lines come again after a restart: those
        of a file, and those of `LineLog`.

        Raises:
            InputError: the log of lines cannot be read.
        """
        if self.log is not None and not self._is_begun:
            for line in self.log.lines():
                yield from self.pause(line.received)
                yield from self.take(line)
        self._is_begun = True
        yield None
        for found in self.source.lines(stop, self.health):
            if found is None:
                yield from self.pause(clock.time())
            else:
                self._keep(found)
                yield from self.take(found)
            yield None
        yield from self._rest() if stop.is_set() else self.finish()
        self.health.set_state("stopped")

    def _rest(self) -> list[Posting]:
        """Return the sets that are open when the program ends, if their lines do not come again."""
        return [] if self._is_kept or self.log is not None else self.finish()

    def _keep(self, line: ReceivedLine) -> None:
        """Write a line of a live source to the log."""
        self._is_kept = bool(line.place)
        if self.log is None or self._is_kept:
            return
        try:
            self.log.append(line)
        except OSError as error:
            self.health.count("not_kept")
            what = f"lines are not kept: {self.log.path}: {system_reason(error)}"
            self.health.trouble(what, line.received)

    def _forget_posted(self) -> None:
        """Leave in the log what a restart still needs, after all else was posted."""
        if self.log is None or self.sets.sets:
            return
        if self.health.counts["not_kept"]:
            self.log.number = -1  # what the file has is not known
        lines = sorted(dict.fromkeys(self._set_up.values()), key=lambda x: x.received)
        try:
            self.log.keep(lines)
        except OSError as error:
            what = f"{self.log.path} keeps lines that were posted: {system_reason(error)}"
            self.health.trouble(what, clock.time())

    def run(self, post: Callable[[Posting], object], stop: Event) -> None:
        """Post until ``stop`` is set.

        Args:
            post: sends a posting, and returns when it is durable; what an `AdjustmentError` says
                is refused and told, after any other exception the posting is tried again, in its
                order, after `RETRY_S` seconds.
            stop: ends the run, within a second.
        """
        waiting, again = self._waiting, 0.0
        # A source that keeps what is not posted is asked for more only when all of it is.
        keeps = getattr(self.source, "keeps_lines", False)
        with closing(self.postings(stop)) as postings:
            for found in postings:
                waiting += [found] if found is not None else []
                while waiting and (clock.monotonic() >= again or keeps):
                    if keeps and stop.wait(max(0.0, again - clock.monotonic())):
                        break
                    if self._post(post, waiting[0]):
                        waiting.popleft()
                        continue
                    again = clock.monotonic() + RETRY_S
                    if not keeps:
                        break
                if keeps and waiting:  # they come again
                    waiting.clear()
                    waiting += self._rest()
                    break
                if found is None and not waiting:
                    self._forget_posted()
        while waiting and self._post(post, waiting[0]):
            waiting.popleft()
        self.health.set_state("stopped")

    def _post(self, post: Callable[[Posting], object], posting: Posting) -> bool:
        """Return whether a posting is done with."""
        try:
            post(posting)
        except AdjustmentError as error:
            what = f"the network refused {posting.request}: {error}"
            self.health.tell("refused_postings", what, clock.time())
        except Exception as error:
            what = f"{posting.request} was not posted: {error}; tried again in {RETRY_S:.0f} s"
            self.health.tell("not_posted", what, clock.time())
            return False
        return True
