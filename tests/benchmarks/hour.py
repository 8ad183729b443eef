"""A survey vehicle: ``python -m tests.benchmarks.hour [SECONDS [cpu] [gross] [keep=N] [rays=N]]``.

The events are those of `tests.benchmarks.vehicle`. The clock is virtual: it goes on by what each
arrival takes, and stands at the next time stamp while nothing is there. What has arrived while the
program was busy is taken together as the next arrival, as the stream service takes it. With ``cpu``
an arrival takes its CPU seconds, which others who use the machine do not change; with ``gross``
some rays are grossly wrong; ``rays`` of a photo are 500 unless it is told. With ``keep`` the last
photos are kept, and others are retired: latency and memory of every interval are then compared with
those of the second one. A day is ``86400 cpu keep=60``.

The latency of an event is the time from its time stamp to the end of the arrival that took it; the
backlog is how many photos an arrival finds waiting. Where the program keeps up the backlog does not
grow: in the last third of the drive it is no larger on average than in the middle one, but for one
photo.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import ImagePoint

from ..support.soak import resident
from .timing import Spread, peak
from .vehicle import Drive, Event

SECONDS = 3600
"""Duration of the stream."""
GROSS = 0.005
"""Part of the rays that are grossly wrong, where that is asked for."""
EVERY = 300
"""Seconds of the stream between two lines."""


@dataclass(frozen=True)
class Taken:
    """One arrival."""

    start: float
    """When it began, seconds of the virtual clock."""
    end: float
    """When it ended."""
    photos: int
    """Photos in it."""
    rays: int
    """Image points in it."""
    latencies: tuple[float, ...]
    """Latency of each of its events, seconds."""


class Interval(NamedTuple):
    """What was measured in one interval."""

    latency: Spread
    """Latencies, seconds."""
    busy: float
    """Time that the arrivals took, seconds."""
    memory: float
    """Memory at its end, MB."""


@dataclass
class Kept:
    """What was measured."""

    arrivals: list[Taken] = field(default_factory=list)
    """Every arrival."""
    intervals: list[Interval] = field(default_factory=list)
    """What was measured in every interval."""

    def between(self, first: float, last: float) -> list[Taken]:
        """Return the arrivals that began in an interval."""
        return [a for a in self.arrivals if first <= a.start < last]

    def backlog(self, first: float, last: float) -> float:
        """Return the mean number of photos that an arrival with photos found waiting."""
        found = [a.photos for a in self.between(first, last) if a.photos]
        return float(np.mean(found)) if found else 0.0

    def kept_up(self, seconds: float) -> bool:
        """Return whether the backlog did not grow."""
        third = seconds / 3
        last = self.backlog(2 * third, np.inf)
        return last <= self.backlog(third, 2 * third) + 1.0


def together(
    events: Iterator[Event],
    inc: fga.IncrementalAdjustment,
    *,
    timer: Callable[[], float] = perf_counter,
) -> Iterator[Taken]:
    """Let events arrive on a virtual clock; iterate over the arrivals.

    Args:
        events: in the order of their time stamps.
        inc: takes them.
        timer: returns seconds; the virtual clock goes on by their differences.
    """
    clock = 0.0
    waiting = next(events, None)
    while waiting is not None:
        clock = max(clock, waiting.time)
        taken: list[Event] = []
        while waiting is not None and waiting.time <= clock:
            taken.append(waiting)
            waiting = next(events, None)
        start = clock
        observations = [o for e in taken for o in e.observations]
        points = [p for e in taken for p in e.points]
        photos = [f for e in taken for f in e.photos]
        begin = timer()
        inc.add(observations, points=points, photos=photos)
        clock += timer() - begin
        rays = sum(isinstance(o, ImagePoint) for o in observations)
        yield Taken(start, clock, len(photos), rays, tuple(clock - e.time for e in taken))


def drive(
    seconds: float,
    *,
    rays: int = 500,
    gross: float = 0.0,
    every: float = EVERY,
    timer: Callable[[], float] = perf_counter,
    keep: int | None = None,
) -> Kept:
    """Drive, and print a line for each interval.

    Args:
        seconds: duration.
        rays: rays of each photo.
        gross: part of them that are grossly wrong.
        every: seconds of the stream between two lines.
        timer: see `together`.
        keep: number of photos that are kept; none: all are.
    """
    road = Drive(seconds, rays=rays, gross=gross)
    inc = fga.IncrementalAdjustment(road.network(), keep=keep)
    kept = Kept()
    shown = every
    print(
        f"  idle {resident():.0f} MB\n"
        f"  {'s':>6}{'photos':>8}{'rays':>9}{'arrivals':>9}{'median s':>9}{'99 % s':>8}{'max s':>8}"
        f"{'backlog':>8}{'MB':>7}{'peak':>7}{'in':>9}{'wait':>7}{'suspects':>9}",
        flush=True,
    )

    def line(until: float) -> None:
        part = kept.between(until - every, until)
        found = Spread.of([t for a in part for t in a.latencies])
        done = [a for a in kept.arrivals if a.start < until]
        photos, n = (sum(getattr(a, what) for a in done) for what in ("photos", "rays"))
        kept.intervals.append(Interval(found, sum(a.end - a.start for a in part), resident()))
        print(
            f"  {until:6.0f}{photos:8d}{n:9d}{len(part):9d}{found.median:9.3f}{found.high:8.3f}"
            f"{found.longest:8.3f}{kept.backlog(until - every, until):8.2f}{resident():7.0f}"
            f"{peak():7.0f}{len(inc):9d}{inc.n_waiting:7d}{len(inc.suspects):9d}",
            flush=True,
        )

    for taken in together(road.events(), inc, timer=timer):
        if taken.start >= shown:
            while taken.start >= shown:
                line(shown)
                shown += every
        kept.arrivals.append(taken)
    while shown - every < kept.arrivals[-1].start:
        line(shown)
        shown += every
    _tell_end(kept, seconds, road, inc)
    if keep is not None and len(kept.intervals) > 2:
        _compare(kept.intervals[1], kept.intervals[-2 if part_left(seconds, every) else -1])
        print(f"  {inc!r}")
    return kept


def part_left(seconds: float, every: float) -> bool:
    """Return whether the last interval is only a part of one."""
    return seconds % every > 0


def _compare(second: Interval, last: Interval) -> None:
    """Print what the last interval took, relative to the second one."""
    pairs = {
        "median latency": (second.latency.median, last.latency.median),
        "99 % latency": (second.latency.high, last.latency.high),
        "busy": (second.busy, last.busy),
        "memory": (second.memory, last.memory),
    }
    told = ", ".join(f"{name} {b / a:.2f}" for name, (a, b) in pairs.items())
    print(f"  last whole interval / second: {told}")


def _tell_end(kept: Kept, seconds: float, road: Drive, inc: fga.IncrementalAdjustment) -> None:
    """Print whether it kept up, and how good the result is."""
    last = kept.arrivals[-1]
    print(
        f"  ended {max(0.0, last.end - seconds):.1f} s after the stream; "
        f"{'kept up' if kept.kept_up(seconds) else 'did not keep up'}"
    )
    every = Spread.of([t for a in kept.arrivals for t in a.latencies])
    busy = sum(a.end - a.start for a in kept.arrivals)
    print(f"  latency: {every}; busy {busy / seconds:.0%} of the time")
    solution = inc.solution()
    unknowns = solution.equations.unknowns["pose"]
    off = [
        solution.state["pose"][number, 9:] - road.true[name]
        for name, number in unknowns.number.items()
    ]
    sent = {i for i in road.wrong if i.partition("/")[0] in road.true}
    wrong = {v.id for v in inc.suspects} & sent
    print(
        f"  σ̂0 {solution.sigma0:.4f}, photos off by "
        f"{np.sqrt(np.mean(np.square(off))) * 1e3:.1f} mm (rms of a coordinate); "
        f"{len(inc.suspects)} suspects, {len(wrong)} of {len(sent)} gross errors among them"
    )


if __name__ == "__main__":
    given = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    words = sys.argv[2:]
    numbers = {name: int(n) for name, sign, n in (w.partition("=") for w in words) if sign}
    drive(
        given,
        rays=numbers.get("rays", 500),
        gross=GROSS if "gross" in words else 0.0,
        every=min(float(numbers.get("every", EVERY)), given / 5),
        timer=process_time if "cpu" in words else perf_counter,
        keep=numbers.get("keep"),
    )
