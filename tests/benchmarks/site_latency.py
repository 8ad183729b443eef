"""Time from a line at a serial port to its verdict in a browser.

``python -m tests.benchmarks.site_latency [SIGHTS] [SIDE]`` serves a network of SIDE² points (32)
as a process, with a total station whose lines come through a pseudo-terminal that the service opens
as a serial port, and opens the list of arriving verdicts in Chromium. It writes SIGHTS lines (100)
one after the other, and takes the time until the verdicts of each are in the page. Every sight
is posted at once.
"""

from __future__ import annotations

import argparse
import os
import pty
import tempfile
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.instruments.simulated_total_station import (
    SimulatedObject,
    SimulatedTotalStation,
)
from factorgraph_adj.io.project_writer import network_files
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import measure
from tests.support.pages import chromium
from tests.support.site_processes import SiteProcess

SPACING, REACH = 20.0, 50.0
"""Distance of neighbouring points, and the farthest that a station reads, metres."""
STATION = "S1"
"""Point of the instrument whose lines come."""
SITE = """\
[site]
name = "Grid"
database = "site.sqlite"
[[network]]
name = "grid"
project = "project.toml"
policy = "reject"
epochs = "by hand"
[[instrument]]
name = "ts1"
network = "grid"
source = "serial:{port}?baud=115200"
grammar = "gsi-online"
station = "S1"
post = "sights"
clock = "receipt"
[instrument.accuracies]
sigma_direction_mgon = 0.3
sigma_zenith_mgon = 0.3
sigma_distance_mm = 0.6
ppm = 1.0
centring_mm = 0.0
"""
WATCH = """() => {
  window.heard = [];
  new MutationObserver(changes => {
    const now = Date.now();
    for (const c of changes) for (const n of c.addedNodes)
      if (n.dataset?.verdict) window.heard.push([n.dataset.verdict, now]);
  }).observe(document.querySelector("ol.verdicts"), { childList: true });
}"""


def grid(side: int) -> fga.Network:
    """Return a measured network of side² points around fixed stations."""
    plan = fga.Network("grid", frame=fga.LocalFrame(), datum="given")
    rng = np.random.default_rng(7)
    places = {
        f"P{i}-{k}": np.array([SPACING * i, SPACING * k, 100.0 + rng.uniform(-5.0, 5.0)])
        for i in range(side)
        for k in range(side)
    }
    for name, xyz in places.items():
        plan.add_point(name, xyz.tolist())
    names, xyz = list(places), np.array(list(places.values()))
    count, n = 0, side * SPACING
    for x in np.arange(2.2 * SPACING, n, 3.0 * SPACING):
        for y in np.arange(2.2 * SPACING, n, 3.0 * SPACING):
            count += 1
            station, place = f"S{count}", np.array([x, y, 102.0])
            plan.add_point(station, place.tolist(), fixed="xyz")
            for j in np.flatnonzero(np.linalg.norm(xyz - place, axis=1) < REACH):
                plan.add(
                    Direction(station, names[j], 0.0, sigma=5e-6, set="1"),
                    ZenithAngle(station, names[j], 1.0, sigma=5e-6),
                    SlopeDistance(station, names[j], 1.0, sigma=1e-3),
                )
    return measure(plan, seed=1)


def sights(network: fga.Network) -> Iterator[bytes]:
    """Yield lines of the instrument, without an end."""
    at = np.array(network.points[STATION].coordinates)
    near = tuple(
        name
        for name, p in network.points.items()
        if not name.startswith("S") and np.linalg.norm(np.array(p.coordinates) - at) < REACH
    )
    station = SimulatedTotalStation(
        SimulatedObject(network), STATION, near, begin=1.79e9, interval=3600.0
    )
    for line in station.lines():
        yield line.text + b"\r\n"


@contextmanager
def serial_port() -> Iterator[tuple[int, str]]:
    """Give a pseudo-terminal: the end of the instrument, and the name of the port."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        os.close(master)
        os.close(slave)


def latencies(folder: Path, *, number: int, side: int) -> list[float]:
    """Return the times from line to verdict in the browser, seconds."""
    network = grid(side)
    rng, lines = np.random.default_rng(3), sights(network)
    out: list[float] = []
    with serial_port() as (master, port), chromium() as browser:
        for name, text in {**network_files(network), "site.toml": SITE.format(port=port)}.items():
            (folder / name).write_text(text)
        site = SiteProcess(folder)
        site.start()
        page = browser.new_page()
        page.set_default_timeout(120_000)
        page.goto(f"{site.url}#/grid/verdicts")
        page.wait_for_selector("ol.verdicts", state="attached")
        page.evaluate(WATCH)
        os.write(master, next(lines))  # the first sights give the orientation of the set-up
        page.wait_for_function("() => window.heard.length > 0")
        for _ in range(number):
            time.sleep(float(rng.uniform(0.2, 0.6)))
            page.evaluate("() => { window.heard = []; }")
            sent = time.time()
            os.write(master, next(lines))
            page.wait_for_function("() => window.heard.length > 0")
            out.append(1e-3 * page.evaluate("() => window.heard[0][1]") - sent)
        page.close()
        site.stop()
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sights", type=int, nargs="?", default=100)
    parser.add_argument("side", type=int, nargs="?", default=32)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ms = 1e3 * np.array(latencies(Path(folder), number=options.sights, side=options.side))
    print(
        f"{options.side**2} points, {len(ms)} sights: from the line at a serial port to its "
        f"verdicts in the browser median {np.median(ms):.0f} ms, 99 % {np.quantile(ms, 0.99):.0f} "
        f"ms, maximum {ms.max():.0f} ms"
    )


if __name__ == "__main__":
    main()
