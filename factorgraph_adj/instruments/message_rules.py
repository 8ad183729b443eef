"""Rules for the times of messages, doubled messages, late ones and gaps.

**Time.** With ``clock = "receipt"``, and for lines without a time, a reading was measured when its
line came. Otherwise it was measured at stamp + offset, where the offset (UTC minus clock of the
instrument) is what the mapping states by ``utc_offset`` at first, and the smallest difference of
receipt and stamp of the last `OFFSET_MEMORY` messages that came in time afterwards: a delay makes a
difference larger, never smaller. With ``clock = "stated"`` the offset is that of the mapping, and
nothing is compared with the receipt: lines that are played at speed, or read long afterwards.

**Clock jump.** A stamp that is later than its receipt by more than ``clock_tolerance`` cannot be a
delay: the clock jumped forward, or was wrong, and the offset is new. Stamps that are earlier are a
delay, unless `AGREEING` messages in succession, whose receipts are further apart than the
tolerance, have the same difference within it: then the clock jumped back. An outage after which an
instrument sends everything at once has stamps that advance while receipts do not, and is none.

**Late.** A reading whose measurement is more than ``late_after`` before its receipt is posted with
its own time, counted and told once in a row.

**Doubled.** A line with a number or time of its own whose bytes are among the last `MEMORY` is
doubled. A line without them is doubled if its bytes came within ``doubled_within`` seconds before,
in less time than an instrument needs to measure again; lines of a file without them never are.

**Gap.** Longer than ``silent_after`` without a line: told when it begins and when it ends. A number
of a block that does not follow the one before: told with how many are missing.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from datetime import UTC, datetime

from .health import Health
from .readings import Reading, ReceivedLine

OFFSET_MEMORY = 50
"""Number of messages whose differences give the offset of a clock."""
AGREEING = 3
"""Number of messages that show a jump of the clock to an earlier time."""
MEMORY = 2000
"""Number of lines that are remembered."""


def iso(time: float) -> str:
    """Return a time in words: ``2026-11-29T00:25:31Z``, to the second."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class InstrumentClock:
    """Offset of the clock of an instrument, which may jump."""

    def __init__(self, health: Health, *, offset: float, tolerance: float) -> None:
        """Start with a stated offset.

        Args:
            health: where jumps are told.
            offset: UTC minus clock, seconds.
            tolerance: seconds by which clock and receipt may differ.
        """
        self.health, self.offset, self.tolerance = health, offset, tolerance
        self.differences: deque[float] = deque(maxlen=OFFSET_MEMORY)
        self.delayed: list[tuple[float, float]] = []
        """Receipt and difference of the last messages, all of them delayed."""

    def time(self, stamped: float, received: float) -> float:
        """Return the time of a measurement, seconds since 1970 UTC."""
        difference = received - stamped
        if difference < self.offset - self.tolerance:
            self._jump(difference, received)
        elif difference <= self.offset + self.tolerance:
            self.delayed.clear()
            self.differences.append(difference)
            self.offset = min(self.differences)
        else:
            self.delayed.append((received, difference))
            last = self.delayed[-AGREEING:]
            apart = last[-1][0] - last[0][0]
            spread = max(d for _, d in last) - min(d for _, d in last)
            if len(last) == AGREEING and spread <= self.tolerance < apart:
                self._jump(min(d for _, d in last), received)
            del self.delayed[:-AGREEING]
        self.health.clock_offset = self.offset
        return stamped + self.offset

    def _jump(self, offset: float, received: float) -> None:
        size = self.offset - offset
        way = "forward" if size > 0 else "back"
        what = f"the clock of the instrument jumped {way} by {abs(size):.1f} s"
        self.health.tell("clock_jumps", what, received)
        self.offset = offset
        self.differences.clear()
        self.differences.append(offset)
        self.delayed.clear()


class RepeatedLines:
    """The last lines, among which a doubled one is found."""

    def __init__(self, within: float) -> None:
        """Start without lines; ``within``: seconds, see the rule."""
        self.within = within
        self._seen: OrderedDict[tuple[str, str], float] = OrderedDict()

    def is_doubled(self, line: ReceivedLine, readings: list[Reading]) -> bool:
        """Return whether a line came before, and remember it."""
        key = (line.channel, line.digest)
        before = self._seen.pop(key, None)
        self._seen[key] = line.received
        if len(self._seen) > MEMORY:
            self._seen.popitem(last=False)
        if before is None:
            return False
        if all(r.identity for r in readings):
            return True
        return not line.place and line.received - before <= self.within


class MessageGaps:
    """Pauses between messages, and numbers that are missing between them."""

    def __init__(self, health: Health, silent_after: float) -> None:
        """Start without messages."""
        self.health, self.silent_after = health, silent_after
        self.last: float | None = None
        self.silent = False

    def message(self, received: float) -> None:
        """Note a message."""
        self._check(received)
        if self.silent:
            assert self.last is not None
            what = f"messages again after {received - self.last:.0f} s of silence"
            self.health.tell("gaps", what, received, problem=False)
            self.health.counts["gaps"] -= 1  # the gap was counted when it began
            self.silent = False
        self.last = received
        self.health.last_message = received
        self.health.set_state("receiving")

    def pause(self, now: float) -> None:
        """Note that there is no message."""
        if self.last is None:
            self.last = now  # silence begins with the start
        self._check(now)
        if self.silent and self.health.state == "receiving":
            self.health.set_state("silent")

    def _check(self, now: float) -> None:
        if self.last is not None and not self.silent and now - self.last > self.silent_after:
            self.silent = True
            what = f"no message since {iso(self.last)}, for more than {self.silent_after:.0f} s"
            self.health.tell("gaps", what, now)
