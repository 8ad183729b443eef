"""A served site for a day at speed, or for an hour: ``python -m tests.benchmarks.site_soak``.

``site_soak [--observations 1000000] [--hours 24]`` serves the yard as a process. Four senders post
levelled differences, distances and now and then a set of directions, each reading with a request
of its own, 50 in one HTTP request. Times of readings run through the hours: the site ends an epoch
each ten minutes and compares it, C sinks by 4 mm in the middle, one reading in 5 000 is wrong by
50 mm, sets are retired after four minutes, and journals, answers and events leave by stated rules.
A client follows all events. Every 20 000 readings a line has memory and CPU time of the service,
size of the database and latency. At the end every reading that was acknowledged is recorded once,
and is in the epoch of its time or was dropped with its journal; the memory has its slope over the
last three quarters. ``--minutes`` ends the sending earlier. With ``--slow 20`` so many followers
read nothing from a third of the readings on, and catch up at the end: without gap, or they are told
that events have left.

``--real --minutes 60`` plays the demonstration of a dam in real time: ``simulate-instrument`` has
three total stations on TCP ports, each with a set of 18 targets in two faces every 20 s, and faults
are switched on now and then; the site has epochs of ten minutes. Two pages of a browser are open,
one with the verdicts as they arrive, one that goes from view to view; a client follows all events.
Every 30 s a line has memory and CPU time of the service, events and readings, and another one the
memory of the pages and the number of their errors. At the end every reading of the events is in an
epoch.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.site.client import ServiceAway
from tests.benchmarks.site_load import Sender, cpu_seconds, resident_mb
from tests.support.pages import chromium
from tests.support.places import ROOT
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import BEGIN, HOUR, site_of, yard_of, yard_site
from tests.support.slow_followers import SlowFollower

FAULTS = (
    "gross-error target=D3 reading=zenith size_mgon=10",
    "doubled lines=3",
    "gross-error target=D8 reading=distance size_mm=15 sights=2",
    "garbage lines=2",
    "ts2 outage length=60s",
    "displacement point=D5 dy_mm=-4",
    "wrong-target target=R1 read=R2",
    "ts3 gap length=90s",
    "gross-error target=D11 reading=direction size_mgon=20",
    "ts1 clock-jump jump=30s",
)
"""Faults that are switched on in turn."""
VIEWS = ("overview", "plan", "points", "verdicts", "epochs", "instruments")
"""Views through which one of the pages goes."""
FAULT_SECONDS, LINE_SECONDS = 90.0, 30.0
"""Time between two faults, and between two lines, seconds."""


@dataclass
class Follower:
    """A client that follows all events."""

    url: str
    kinds: Counter[str] = field(default_factory=Counter)
    """Number of events by kind."""
    gaps: int = 0
    """Numbers of events that were not received."""
    last: int | None = None
    """Number of the last event."""
    readings: int = 0
    """Readings that the arrivals name."""
    verdicts: Counter[str] = field(default_factory=Counter)
    """Verdicts of these."""
    refused: list[Any] = field(default_factory=list)
    """Answers that refuse."""
    lags: list[float] = field(default_factory=list)
    """From when events were recorded to when they came, seconds."""

    def run(self) -> None:
        """Follow until the client is closed."""
        with self.client, suppress(ServiceAway):  # it ends with the service
            for event in self.client.events():
                if self.last is not None:
                    self.gaps += event.id - self.last - 1
                self.last = event.id
                self.kinds[event.kind] += 1
                self.lags.append(time.time() - event.data["at"])
                if event.kind == "arrival":
                    told = event.data.get("verdicts", [event.data])
                    self.readings += len(told)
                    self.verdicts.update(str(t.get("verdict")) for t in told)
                    self.verdicts.update(
                        f"later {t['verdict']}" for t in event.data.get("entered", [])
                    )
                elif event.kind == "refused":
                    self.refused.append(event.data["answer"])

    def start(self) -> None:
        """Follow in a thread."""
        self.client = fga.site.Client(self.url)
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()


def now() -> str:
    """Return the time of day."""
    return f"{datetime.now(UTC):%H:%M:%S}"


STATES = ("observations", "waiting", "suspects", "rejected")
"""What becomes of readings."""


def print_epochs(client: fga.site.Client, network: str) -> int:
    """Print what epochs and alarms say, and return the number of their readings."""
    total = 0
    for epoch in client.epochs(network):
        counts = epoch["counts"] or {}
        total += sum(counts.get(state, 0) for state in STATES)
        print(
            f"epoch {epoch['number']} {epoch['state']}, result {epoch['revision']}: {counts}, "
            f"sigma0 {epoch['sigma0']}, congruence {epoch['congruence']} {epoch['problem'] or ''}"
        )
    return total


# -- at speed --------------------------------------------------------------------------------------

TABLES = """
[[alarm]]
name = "objects"
network = "yard"
test = "displacement"
points = ["C"]
false_alarms_per_month = 0.1

[retention]
journals = "2 h"
answers = "10 min"
events = "5 min"
"""
"""What the site file of the yard has besides."""
EPOCH = 600.0
"""Length of an epoch, seconds."""
KEEP_SECONDS = 240.0
"""Time after which what nothing touches is retired, seconds."""
READINGS = (
    ("height_difference", "A", 1.4996, 0.0005, -1.0),
    ("height_difference", "B", 0.4996, 0.0005, -1.0),
    ("slope_distance", "A", 58.3268, 0.002, 0.0),
    ("slope_distance", "B", 70.7141, 0.002, 0.0),
)
"""Readings to C in turn: kind, station, value, standard deviation, and its change by a metre that
C sinks (the sights are level)."""
DIRECTIONS = (("B", 0.0), ("C", 334.4035))
"""Targets of a set on A with their directions, gon."""
SENDERS, TOGETHER = 4, 50
"""Number of senders, and readings in one request."""
LISTS_FROM_SET_TO_SET = 60
SINKING, WRONG, READINGS_FOR_ONE_WRONG = 0.004, 0.05, 5000
"""By how much C sinks, and by how much one of so many readings is wrong, metres."""


@dataclass
class Soak:
    """A day at speed."""

    observations: int
    """Readings to send."""
    hours: float
    """Time through which they run, hours."""
    acknowledged: np.ndarray = field(init=False)
    """How often the answer to each reading came."""
    wrong: list[object] = field(default_factory=list)
    """Answers that no reading should get."""
    latencies: list[float] = field(default_factory=list)
    """From request to answer since the last line, seconds."""
    closes: int = 0
    """How often an epoch was ended by request."""
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """Number of readings and resident memory of the service (MiB) of each line."""

    def __post_init__(self) -> None:
        """Begin without readings."""
        self.acknowledged = np.zeros(self.observations, dtype=np.int8)
        self.lists, self.lock = itertools.count(), threading.Lock()
        self.until = float("inf")

    def time(self, number: int) -> float:
        """Return when a reading was measured, seconds UTC."""
        return BEGIN + 1.0 + (HOUR * self.hours - 2.0) * number / self.observations

    def postings(self, part: int) -> list[dict[str, Any]]:
        """Return a list of readings."""
        rng, first = np.random.default_rng((7, part)), part * TOGETHER
        noise, turn = rng.normal(size=TOGETHER), float(rng.uniform(0.0, 400.0))
        out: list[dict[str, Any]] = []
        for i, number in enumerate(range(first, min(first + TOGETHER, self.observations))):
            at = self.time(number)
            sunk = SINKING if at > BEGIN + 0.5 * HOUR * self.hours else 0.0
            kind, station, value, sigma, change = READINGS[number % len(READINGS)]
            error = WRONG if number % READINGS_FOR_ONE_WRONG == READINGS_FOR_ONE_WRONG - 1 else 0.0
            value += change * sunk + sigma * float(noise[i]) + error
            posting = {"kind": kind, "station": station, "target": "C", "value": round(value, 6)}
            if part % LISTS_FROM_SET_TO_SET == 0 and i < len(DIRECTIONS):
                target, direction = DIRECTIONS[i]
                value = (direction + turn + 0.001 * float(noise[i])) % 400.0
                posting = {"kind": "direction", "station": "A", "target": target, "set": f"{part}"}
                posting |= {"value": round(value, 6)}
            out.append(posting | {"id": f"k{number}", "request": f"k{number}", "time": at})
        return out

    def send(self, port: int) -> None:
        """Post lists until all are sent."""
        sender = Sender(port, "")
        for part in self.lists:
            postings = self.postings(part)
            if not postings or time.monotonic() > self.until:
                break
            while True:
                sent = time.monotonic()
                status, wait, said = sender.post(postings)
                if status not in (429, 503):
                    break
                time.sleep(wait)
            with self.lock:
                self.latencies.append(time.monotonic() - sent)
                for posting, answer in zip(postings, said, strict=True):
                    self.acknowledged[int(posting["id"][1:])] += 1
                    if status != 200 or not answer["ok"] or answer.get("repeated"):
                        self.wrong.append(answer)
        sender.connection.close()

    def run(self, folder: Path, *, minutes: float, every: int, slow: int) -> None:
        """Serve the yard, send, and print lines."""
        yard_site(folder, epochs=f"{EPOCH:g} s", more=TABLES)
        text = (folder / "site.toml").read_text()
        text = text.replace("objects =", f"keep_seconds = {KEEP_SECONDS}\nobjects =", 1)
        (folder / "site.toml").write_text(text)
        site = SiteProcess(folder)
        site.start()
        assert site.process is not None
        process, begun = site.process.pid, time.monotonic()
        follower = Follower(site.url)
        follower.start()
        self.until = begun + 60.0 * minutes
        senders = [threading.Thread(target=self.send, args=(site.port,)) for _ in range(SENDERS)]
        for sender in senders:
            sender.start()
        due, before = every, 0.0
        stalled: list[SlowFollower] = []
        while any(s.is_alive() for s in senders):
            time.sleep(0.1)
            done = int(np.count_nonzero(self.acknowledged))
            if slow and not stalled and done >= self.observations // 3:
                stalled = [SlowFollower(site.port, after=follower.last or 0) for _ in range(slow)]
            if done < due:
                continue
            due += every
            with self.lock:
                ms, self.latencies = 1e3 * np.array(self.latencies), []
            lags, follower.lags = follower.lags, []
            cpu = cpu_seconds(process)
            self.rows.append((done, resident_mb(process)))
            size = sum(f.stat().st_size for f in folder.glob("site.sqlite*")) / 2**20
            print(
                f"{now()} {time.monotonic() - begun:.0f} s: {done} readings, hour "
                f"{(self.time(done) - BEGIN) / HOUR:.1f}, RSS {self.rows[-1][1]:.1f} MiB, database "
                f"{size:.0f} MiB, request to answer median {np.median(ms):.0f} ms, 99 % "
                f"{np.quantile(ms, 0.99):.0f} ms, to the follower median "
                f"{1e3 * np.median(lags):.0f} ms, slow ones {len(stalled)}, CPU "
                f"{1e3 * (cpu - before) / every:.2f} ms a reading; events "
                f"{sum(follower.kinds.values())}, gaps {follower.gaps}, epochs "
                f"{follower.kinds['epoch']}, alarms {follower.kinds['alarm']}",
                flush=True,
            )
            before = cpu
        self.let_catch_up(stalled, follower.last or 0)
        with fga.site.Client(site.url) as client:
            while any(e["state"] == "open" for e in client.epochs("yard")):
                client.close_epoch("yard")
                self.closes += 1
            print_epochs(client, "yard")
            print("alarms:", client._got("/alarms", state="all"))
        site.stop()
        assert not self.wrong, self.wrong[:3]
        assert not follower.gaps

    def let_catch_up(self, stalled: list[SlowFollower], last: int) -> None:
        """Let followers read on until an event, and compare what they got."""
        for one in stalled:
            begun = time.monotonic()
            one.read(last, HANGS)
            whole = [*range(one.numbers[0], one.numbers[-1] + 1)]
            assert one.lost or one.numbers == whole
            said = f"told {one.lost} times that events have left" if one.lost else "without gap"
            print(
                f"a follower that read nothing: {len(one.numbers)} events {said} in "
                f"{time.monotonic() - begun:.1f} s"
            )
            one.close()

    def assert_everything_is_there(self, folder: Path) -> None:
        """Compare the database with what was acknowledged."""
        sent = {f"k{n}" for n in np.flatnonzero(self.acknowledged)}
        assert self.acknowledged.max() == 1
        with sqlite3.connect(folder / "site.sqlite") as connection:
            recorded = [r[0] for r in connection.execute("SELECT request FROM requests")]
        # Each "end the present epoch" has a request, too.
        assert len(recorded) == len(set(recorded)) == len(sent) + self.closes
        assert sent <= set(recorded)
        numbers = {
            n: int((self.time(n) - BEGIN) // EPOCH) + 1 for n in np.flatnonzero(self.acknowledged)
        }
        dropped, whole = 0, 0
        with site_of(folder) as site:
            live = yard_of(site)
            for row in live.epochs(results=True):
                number = row["number"]
                own = {f"k{n}" for n, k in numbers.items() if k == number}
                counts = row["result"]["counts"]
                there = sum(counts[state] for state in STATES)
                if row["state"] == "dropped":
                    # What was retired before the epoch ended is not among its counts.
                    sets = sum(1 for n in own if self.is_direction(int(n[1:])))
                    assert len(own) - sets <= there <= len(own), (number, there, len(own))
                    dropped += 1
                    continue
                with live.reading(number) as epoch:
                    inc = epoch.stream.adjustment
                    found = {*inc.network().observations}
                    found |= {v.id for v in (*inc.waiting, *inc.suspects, *inc.rejected)}
                assert found == own, (number, len(found), len(own))
                whole += 1
        print(
            f"all {len(sent)} acknowledged readings are recorded once; {whole} epochs have theirs,"
            f" of {dropped} the readings left as [retention] says"
        )

    def is_direction(self, number: int) -> bool:
        """Return whether a reading is a direction."""
        part, i = divmod(number, TOGETHER)
        return part % LISTS_FROM_SET_TO_SET == 0 and i < len(DIRECTIONS)

    def print_slope(self) -> None:
        """Print the slope of the memory over the last three quarters of the readings."""
        table = np.array(self.rows)
        table = table[table[:, 0] > 0.25 * table[-1, 0]]
        x, y = 1e-5 * table[:, 0], table[:, 1]
        a = np.stack([np.ones_like(x), x - x.mean()], axis=1)
        (level, slope), *_ = np.linalg.lstsq(a, y, rcond=None)
        v = y - a @ (level, slope)
        sigma = float(np.sqrt(v @ v / (len(x) - 2) / ((x - x.mean()) @ (x - x.mean()))))
        print(
            f"RSS over the last three quarters: {y.min():.1f} to {y.max():.1f} MiB, mean "
            f"{level:.1f}; slope {slope:+.2f} ± {sigma:.2f} MiB per 100 000 readings"
        )


# -- in real time ----------------------------------------------------------------------------------


@dataclass
class Page:
    """A page of the browser."""

    page: Any
    said: list[str] = field(default_factory=list)
    """Errors of the page."""

    def __post_init__(self) -> None:
        """Listen to what the page says."""
        self.page.on("pageerror", lambda e: self.said.append(str(e)))
        self.page.on("console", lambda m: self.said.append(m.text) if m.type == "error" else None)
        self.session = self.page.context.new_cdp_session(self.page)
        self.session.send("Performance.enable")

    def memory(self) -> str:
        """Return heap, nodes and listeners after a collection of garbage."""
        self.session.send("HeapProfiler.collectGarbage")
        found = {
            m["name"]: m["value"] for m in self.session.send("Performance.getMetrics")["metrics"]
        }
        return (
            f"{found['JSHeapUsedSize'] / 2**20:.1f} MiB/{found['Nodes']:.0f} nodes/"
            f"{found['JSEventListeners']:.0f} listeners"
        )


@contextmanager
def simulated_dam(
    folder: Path, *, interval: float, sight: float
) -> Iterator[subprocess.Popen[str]]:
    """Give a running simulation of the dam, whose site is written into a folder."""
    command = [sys.executable, "-m", "factorgraph_adj", "simulate-instrument", "--demo", "dam"]
    command += ["--write", str(folder), "--port", "0", "--seed", "5"]
    command += ["--interval", f"{interval}s", "--sight-time", f"{sight}s"]
    process = subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None and process.stdout is not None
    lines = process.stdout
    while "ts3 on" not in (line := lines.readline()):
        assert line, "the simulation has ended"
    drain = threading.Thread(target=lambda: [None for _ in lines], daemon=True)
    drain.start()
    try:
        yield process
    finally:
        process.terminate()
        process.wait(30.0)


def real_time(folder: Path, *, minutes: float, interval: float, sight: float) -> None:
    """Serve the dam in real time, and print what it takes."""
    with ExitStack() as stack:
        simulation = stack.enter_context(simulated_dam(folder, interval=interval, sight=sight))
        browser = stack.enter_context(chromium())
        text = (folder / "site.toml").read_text()
        assert 'epochs = "1 h"' in text
        (folder / "site.toml").write_text(text.replace('epochs = "1 h"', 'epochs = "10 min"'))
        site = SiteProcess(folder)
        site.start()
        stack.callback(site.stop)
        assert site.process is not None and simulation.stdin is not None
        follower = Follower(site.url)
        follower.start()
        watching, walking = Page(browser.new_page()), Page(browser.new_page())
        watching.page.goto(f"{site.url}#/dam/verdicts")
        walking.page.goto(f"{site.url}#/dam/overview")
        over, begun = threading.Event(), time.monotonic()
        process, before = site.process.pid, cpu_seconds(site.process.pid)

        def attend() -> None:
            """Switch faults on and print lines; no browser that has no time holds this up."""
            assert simulation.stdin is not None
            number, fault, line = 0, FAULT_SECONDS, LINE_SECONDS
            while not over.wait(0.5):
                at = time.monotonic() - begun
                if at >= fault:
                    simulation.stdin.write(FAULTS[number % len(FAULTS)] + "\n")
                    simulation.stdin.flush()
                    number, fault = number + 1, fault + FAULT_SECONDS
                if at >= line:
                    print(
                        f"{now()} {at / 60:5.1f} min RSS {resident_mb(process):.1f} MiB CPU "
                        f"{cpu_seconds(process) - before:.1f} s; events {dict(follower.kinds)}, "
                        f"gaps {follower.gaps}; readings {follower.readings} "
                        f"{dict(follower.verdicts)}, refused {len(follower.refused)}; faults "
                        f"{number}",
                        flush=True,
                    )
                    line += LINE_SECONDS

        attendant = threading.Thread(target=attend)
        attendant.start()
        stack.callback(over.set)
        for view in itertools.cycle(VIEWS):
            if (at := time.monotonic() - begun) >= 60.0 * minutes:
                break
            walking.page.evaluate(f"location.hash = '#/dam/{view}'")
            walking.page.wait_for_timeout(1000.0 * min(LINE_SECONDS, 60.0 * minutes - at))
            print(
                f"{now()} pages {watching.memory()}, {walking.memory()}; errors "
                f"{len(watching.said)}, {len(walking.said)}",
                flush=True,
            )
        over.set()
        attendant.join()
        for said in (*watching.said[:20], *walking.said[:20]):
            print("page:", said)
        for answer in follower.refused[:20]:
            print("refused:", json.dumps(answer)[:300])
        simulation.terminate()
        simulation.wait(30.0)
        time.sleep(5.0)
        with fga.site.Client(site.url) as client:
            while any(e["state"] == "open" for e in client.epochs("dam")):
                client.close_epoch("dam")
            there = print_epochs(client, "dam")
            for alarm in client._got("/alarms"):
                print("alarm:", json.dumps(alarm)[:300])
        print(f"readings in epochs: {there}; of the events: {follower.readings}")
        assert there == follower.readings and not follower.gaps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--observations", type=int, default=1_000_000)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--every", type=int, default=20_000, help="readings from line to line")
    parser.add_argument("--slow", type=int, default=0, help="followers that read nothing")
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--minutes", type=float, help="of real time; the longest time at speed")
    parser.add_argument("--interval", type=float, default=20.0, help="real time: from set to set")
    parser.add_argument("--sight-time", type=float, default=0.5, help="real time: between sights")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.real:
            real_time(
                folder,
                minutes=options.minutes or 60.0,
                interval=options.interval,
                sight=options.sight_time,
            )
            return
        soak = Soak(options.observations, options.hours)
        soak.run(
            folder, minutes=options.minutes or float("inf"), every=options.every, slow=options.slow
        )
        soak.print_slope()
        soak.assert_everything_is_there(folder)


if __name__ == "__main__":
    main()
