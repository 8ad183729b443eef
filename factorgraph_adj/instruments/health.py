"""Health of an instrument: state of its connection, last message, counts, events with times."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, field
from threading import RLock
from typing import Any, Literal, TypeAlias

State: TypeAlias = Literal["starting", "connecting", "receiving", "silent", "stopped"]
MAX_KEPT_EVENTS = 200
"""Number of events that are kept; counts go on."""
COUNTS = (
    *("lines", "readings", "without_reading", "refused", "doubled", "late", "gaps"),
    *("clock_jumps", "connections", "restarts_of_file", "doubtful_faces", "left_out"),
    *("postings", "not_posted", "refused_postings", "not_kept"),
)
"""What is counted: lines that came; readings in them; lines of the grammar without a reading;
lines that are no text of the grammar; lines that came twice; lines that came late; pauses that
were too long; jumps of the clock; connections that were made; files that were rotated or
truncated; readings whose faces do not agree; readings that the mapping leaves out; postings;
attempts to post that failed, and postings that the network refused."""


@dataclass(frozen=True)
class HealthEvent:
    """Something that a rule found, in a sentence."""

    time: float
    """Seconds since 1970 UTC."""
    count: str
    """Its count, one of `COUNTS`."""
    what: str
    """The sentence, which names the line or the set."""


@dataclass
class Health:
    """State, counts and events of an instrument; several threads may use it."""

    name: str
    """Name of the instrument."""
    state: State = "starting"
    """``starting``; ``connecting`` (no connection, or the file is not there); ``receiving``;
    ``silent`` (connected, and longer without a message than the mapping allows); ``stopped``."""
    last_message: float | None = None
    """Receipt of the last line, seconds since 1970 UTC."""
    clock_offset: float | None = None
    """UTC minus clock of the instrument, seconds; None: lines have no times."""
    lag: float | None = None
    """Time from the end of the measurement of the last posting to its record, seconds; negative
    where the clock of the instrument runs ahead; None: none was recorded."""
    problem: str = ""
    """The last problem, in a sentence."""
    problem_time: float | None = None
    """When it was."""
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))
    """Counts, see `COUNTS`."""
    events: deque[HealthEvent] = field(default_factory=lambda: deque(maxlen=MAX_KEPT_EVENTS))
    """The latest events, the oldest first."""

    def __post_init__(self) -> None:
        """Make the lock."""
        self._lock = RLock()

    def count(self, name: str, number: int = 1) -> None:
        """Count something."""
        with self._lock:
            self.counts[name] += number

    def tell(self, name: str, what: str, time: float, *, problem: bool = True) -> None:
        """Count something and keep a sentence about it.

        Args:
            name: its count.
            what: the sentence.
            time: when it was, seconds since 1970 UTC.
            problem: whether it is the last problem from now on.
        """
        with self._lock:
            self.counts[name] += 1
            self.events.append(HealthEvent(time, name, what))
            if problem:
                self.problem, self.problem_time = what, time

    def trouble(self, what: str, time: float) -> None:
        """Keep a problem that has no count; the same one again is kept once."""
        with self._lock:
            self.problem, self.problem_time = what, time

    def set_state(self, state: State) -> None:
        """Change the state."""
        self.state = state

    def snapshot(self) -> dict[str, Any]:
        """Return all of it for JSON: times in seconds since 1970 UTC."""
        with self._lock:
            names = ("name", "state", "last_message", "clock_offset", "lag", "problem")
            out = {k: getattr(self, k) for k in (*names, "problem_time")}
            return {**out, **self.counts, "events": [asdict(e) for e in self.events]}
