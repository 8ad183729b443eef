"""A served site for hours: ``python -m tests.benchmarks.site_soak --real --minutes 60``.

``--real`` plays the demonstration of a dam in real time: ``simulate-instrument`` has three total
stations on TCP ports, each with a set of 18 targets in two faces every 20 s, and faults are switched
on now and then; the site has epochs of ten minutes. Two pages of a browser are open, one with the
verdicts as they arrive, one that goes from view to view; a client follows all events. Every 30 s a
line has the memory and CPU time of the service, events, readings, the memory of the pages and what
they complain of. At the end every reading of a set is in an epoch, or was refused with a reason.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any


import factorgraph_adj as fga
from tests.benchmarks.site_load import cpu_seconds, resident_mb
from tests.support.pages import chromium
from tests.support.places import ROOT
from tests.support.site_processes import SiteProcess

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

    def run(self) -> None:
        """Follow until the client is closed."""
        with self.client:
            for event in self.client.events():
                if self.last is not None:
                    self.gaps += event.id - self.last - 1
                self.last = event.id
                self.kinds[event.kind] += 1
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


def now() -> str:
    """Return the time of day."""
    return f"{datetime.now(UTC):%H:%M:%S}"


STATES = ("observations", "waiting", "suspects", "rejected")
"""What becomes of readings."""


def print_epochs(client: fga.site.Client) -> int:
    """Print what epochs and alarms say, and return the number of their readings."""
    total = 0
    for epoch in client.epochs("dam"):
        counts = epoch["counts"] or {}
        total += sum(counts.get(state, 0) for state in STATES)
        print(
            f"epoch {epoch['number']} {epoch['state']}, result {epoch['revision']}: {counts}, sigma0 "
            f"{epoch['sigma0']}, congruence {epoch['congruence']} {epoch['problem'] or ''}"
        )
    return total


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
        begun, fault, line = time.monotonic(), FAULT_SECONDS, LINE_SECONDS
        number = 0
        before = cpu_seconds(site.process.pid)
        while (at := time.monotonic() - begun) < 60.0 * minutes:
            # Playwright hands over events of the page only while one of its calls runs.
            watching.page.wait_for_timeout(500)
            if at >= fault:
                simulation.stdin.write(FAULTS[number % len(FAULTS)] + "\n")
                simulation.stdin.flush()
                number, fault = number + 1, fault + FAULT_SECONDS
            if at >= line:
                walking.page.evaluate(
                    f"location.hash = '#/dam/{VIEWS[int(line / 30) % len(VIEWS)]}'"
                )
                walking.page.wait_for_timeout(1000)
                cpu = cpu_seconds(site.process.pid) - before
                print(
                    f"{now()} {at / 60:5.1f} min RSS {resident_mb(site.process.pid):.1f} MiB CPU "
                    f"{cpu:.1f} s; events {sum(follower.kinds.values())} {dict(follower.kinds)} gaps "
                    f"{follower.gaps}; readings {follower.readings} {dict(follower.verdicts)} "
                    f"refused {len(follower.refused)}; faults {number}; pages "
                    f"{watching.memory()}, {walking.memory()}; errors "
                    f"{len(watching.said)}, {len(walking.said)}",
                    flush=True,
                )
                line += LINE_SECONDS
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
            there = print_epochs(client)
            for alarm in client._got("/alarms"):
                print("alarm:", json.dumps(alarm)[:300])
        print(f"readings in epochs: {there}; of the events: {follower.readings}")
        assert there == follower.readings and not follower.gaps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--interval", type=float, default=20.0)
    parser.add_argument("--sight-time", type=float, default=0.5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        real_time(
            Path(folder),
            minutes=options.minutes,
            interval=options.interval,
            sight=options.sight_time,
        )


if __name__ == "__main__":
    main()
