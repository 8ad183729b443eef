"""A day of the survey vehicle: ``python -m tests.benchmarks.vehicle_day [HOURS [keep=N] [rays=N]
[together=S] [journal=FILE]]``.

The events are those of `tests.benchmarks.vehicle`, a photo every second: 86 400 in 24 hours, of
which the last ``keep`` are kept. The clock of the drive does not wait: all events of ``together``
seconds are one arrival, and the next one follows at once, so that the day is over when all of them
are computed. Every hour of the drive has a line: how long its arrivals took (a retirement belongs
to the arrival that made it due), memory, and how large the journal and the archive of what was
retired are. Nothing of the hours before is kept.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np

import factorgraph_adj as fga

from ..support.soak import resident
from .vehicle import Drive, Event

HOURS, KEEP, RAYS, TOGETHER = 24.0, 32, 12, 4
HOUR = 3600.0


class Hour(NamedTuple):
    """What was measured in one hour of the drive."""

    photos: int
    """Photos that arrived in it."""
    median: float
    """Median of the CPU times of its arrivals, seconds."""
    high: float
    """95 % of them take no longer."""
    longest: float
    """The longest one."""
    cpu: float
    """Their sum."""
    wall: float
    """Time that they took, seconds."""
    memory: float
    """Memory at its end, MB."""


def arrivals(events: Iterator[Event], together: float) -> Iterator[tuple[float, list[Event]]]:
    """Iterate over the events of each interval, with its end in seconds."""
    for number, some in groupby(events, lambda e: int(e.time // together)):
        yield (number + 1) * together, list(some)


def study(hours: float, keep: int, rays: int, together: float, journal: str | None) -> list[Hour]:
    """Drive, and print a line for each hour; return what was measured."""
    road = Drive(hours * HOUR, rays=rays)
    inc = fga.IncrementalAdjustment(road.network(), keep=keep, journal=journal)
    print(
        f"  {'h':>5}{'photos':>8}{'median':>8}{'95 %':>7}{'max s':>7}{'CPU s':>8}{'wall s':>8}"
        f"{'MB':>6}{'journal':>9}{'archive':>9}{'in graph':>9}{'wait':>5}{'suspects':>9}"
        f"{'bound σ':>9}",
        flush=True,
    )
    out: list[Hour] = []
    times: list[float] = []
    photos, wall = 0, 0.0
    shown = HOUR if hours > 1.0 else hours * HOUR / 4
    for end, some in arrivals(road.events(), together):
        observations = [o for e in some for o in e.observations]
        began, cpu = perf_counter(), process_time()
        inc.add(
            observations,
            points=[p for e in some for p in e.points],
            photos=[f for e in some for f in e.photos],
        )
        times.append(process_time() - cpu)
        wall += perf_counter() - began
        photos += sum(len(e.photos) for e in some)
        for name in list(road.true)[: -2 * keep]:  # or the harness itself would grow
            del road.true[name]
        if end >= shown * (len(out) + 1):
            median, high = np.quantile(times, (0.5, 0.95)).tolist()
            out.append(Hour(photos, median, high, max(times), sum(times), wall, resident()))
            _tell(out, end / HOUR, inc, journal)
            times, photos, wall = [], 0, 0.0
    _compare(out)
    print(f"  {inc!r}")
    return out


def _tell(
    out: list[Hour], hour: float, inc: fga.IncrementalAdjustment, journal: str | None
) -> None:
    """Print the line of an hour."""
    last, retired = out[-1], inc.retired
    archive = bound = 0.0
    if retired is not None:
        bound = inc.missed_step
        archive = retired.archive.size / 1e6
    written = 0.0 if journal is None else Path(journal).stat().st_size / 1e6
    print(
        f"  {hour:5.2f}{last.photos:8d}{last.median:8.3f}{last.high:7.3f}{last.longest:7.3f}"
        f"{last.cpu:8.1f}{last.wall:8.1f}{last.memory:6.0f}{written:9.1f}{archive:9.1f}"
        f"{len(inc):9d}{inc.n_waiting:5d}{len(inc.suspects):9d}{bound:9.1e}",
        flush=True,
    )


def _compare(out: list[Hour]) -> None:
    """Print what the last hour took, relative to the second one."""
    if len(out) < 3:
        return
    second, last = out[1], out[-1]
    told = ", ".join(
        f"{name} {getattr(last, name) / getattr(second, name):.2f}"
        for name in ("median", "high", "longest", "cpu", "memory")
    )
    print(f"  last hour / second: {told}", flush=True)


if __name__ == "__main__":
    words = dict(w.split("=", 1) for w in sys.argv[1:] if "=" in w)
    plain = [w for w in sys.argv[1:] if "=" not in w]
    study(
        float(plain[0]) if plain else HOURS,
        int(words.get("keep", KEEP)),
        int(words.get("rays", RAYS)),
        float(words.get("together", TOGETHER)),
        words.get("journal"),
    )
