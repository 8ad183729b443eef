"""A site with many ended epochs: ``python -m tests.benchmarks.site_epochs [N]``.

Makes the database of a dam with N = 1000 ended daily epochs, whose estimates scatter as their
cofactors say, and measures: a restart; the end of the first epoch after it, with the state of the
monitor and without; a late reading of an early epoch, and how long others wait meanwhile; the
answers of the API about epochs.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient
from sqlalchemy import delete, func, insert, select

from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.io.observation_records import observation_record
from factorgraph_adj.io.project_writer import write_project
from factorgraph_adj.monitoring.epoch_estimates import EpochEstimate
from factorgraph_adj.monitoring.motion_filter import DAY_S
from factorgraph_adj.site.api import application
from factorgraph_adj.site.live_network import LiveNetwork
from factorgraph_adj.site.monitor_states import write_state
from factorgraph_adj.site.result_columns import write_result
from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import read_site
from factorgraph_adj.site.tables import epochs, journal, monitors
from tests.networks.dam import Weather, dam_epoch

BEGIN = 15_000 * DAY_S
"""Begin of the first day, seconds UTC."""
FIRST = 3
"""Epochs that are measured; further ones are drawn."""
LATE = 2
"""Epoch of the late reading."""
HANGS = 7200.0
SITE = """\
[site]
name = "Dam"
[[network]]
name = "dam"
project = "dam"
epochs = "1 d"
objects = ["D*"]
[[alarm]]
name = "place"
network = "dam"
false_alarms_per_month = 0.1
k = 2
n = 3
[[alarm]]
name = "drift"
network = "dam"
test = "cusum"
false_alarms_per_month = 0.1
"""


def day(number: int) -> list[dict[str, object]]:
    """Return the readings of an epoch."""
    rng = np.random.default_rng([3, number])
    network = dam_epoch(rng, {}, Weather(levelling=True))
    time_of_day = BEGIN + DAY_S * (number - 1) + 21_600.0
    return [
        {k: v for k, v in observation_record(o).items() if v}
        | {"id": f"d{number}-{name}", "time": time_of_day + i}
        for i, (name, o) in enumerate(network.observations.items())
    ]


def post(live: LiveNetwork, records: list[dict[str, object]]) -> None:
    """Post readings, and wait for their answers."""
    for answer in [live.submit(r) for r in records]:
        said = answer.result(HANGS)
        assert said["ok"], said


def make(folder: Path, number: int) -> None:
    """Write the site, and the database with its ended epochs."""
    rng = np.random.default_rng(5)
    network = dam_epoch(rng, {}, Weather(levelling=True))
    write_project(without(network, list(network.observations)), folder / "dam")
    (folder / "site.toml").write_text(SITE)
    with site_of(folder) as site:
        live = site.networks["dam"]
        for n in range(1, FIRST + 1):
            post(live, day(n))
        live.close_epoch().result(HANGS)
        survey, last = live.surveillance, live.epochs(results=True)[-1]
        of = EpochEstimate.from_json(last["result"]["estimate"])
        values, vectors = np.linalg.eigh(of.cofactors)
        rows = []
        for n in range(FIRST + 1, number + 1):
            x = of.coordinates.copy()
            scatter = np.sqrt(values.clip(0.0)) * rng.standard_normal(len(values))
            x[of.free] += vectors @ scatter
            at = BEGIN + DAY_S * (n - 0.5)
            estimate = of.to_json() | {"number": n, "time": at, "coordinates": x.tolist()}
            result = last["result"] | {"time": at, "estimate": estimate}
            found = survey.findings(list, _Numbered(n), result)[n]
            result["findings"] = survey.shown(found)
            row = {"network": live.id, "number": n, "state": "closed", "revision": 1}
            row |= {"begin": at - DAY_S / 2, "end": at + DAY_S / 2}
            rows.append((row, result))
        with site.database.writing() as connection:
            for row, result in rows:
                key = connection.execute(insert(epochs).values(**row)).inserted_primary_key[0]
                write_result(connection, key, result)
            newest = select(func.max(epochs.c.id)).scalar_subquery()
            columns = newest, journal.c.line, journal.c.text
            lines = select(*columns).where(journal.c.epoch == last["id"])
            connection.execute(insert(journal).from_select(["epoch", "line", "text"], lines))
            write_state(connection, live.id, survey.digest, survey.state)


class _Numbered:
    """An epoch of which the number alone counts."""

    def __init__(self, number: int) -> None:
        self.number = number


@contextmanager
def site_of(folder: Path) -> Any:
    """Give a running site."""
    site = Site(read_site(folder))
    site.start()
    try:
        yield site
    finally:
        site.stop()


def timed(what: str, do: Callable[[], object]) -> None:
    """Tell how long something takes."""
    begun = time.perf_counter()
    do()
    print(f"{what:60} {time.perf_counter() - begun:9.3f} s", flush=True)


def compared(live: LiveNetwork) -> None:
    """Return when no findings wait for a revision."""
    while live.surveillance.revise_from is not None:
        time.sleep(0.2)


def waits(live: LiveNetwork, stop: threading.Event, out: list[float]) -> None:
    """Ask the network again and again, as a page does, and note how long the answers take."""
    while not stop.is_set():
        begun = time.perf_counter()
        with live.reading() as epoch:
            len(epoch.stream.adjustment)
        out.append(time.perf_counter() - begun)
        stop.wait(0.02)


def main(given: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("number", nargs="?", type=int, default=1000)
    parser.add_argument("--late", action="store_true", help="also a late reading")
    options = parser.parse_args(given)
    n = options.number
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        timed(f"making {n} epochs", lambda: make(folder, n))
        for state in ("with", "without"):
            if state == "without":
                site = Site(read_site(folder))
                with site.database.writing() as connection:
                    connection.execute(delete(monitors))
                site.database.close()
            begun = time.perf_counter()
            with site_of(folder) as site:
                print(f"{'start of the service':60} {time.perf_counter() - begun:9.3f} s")
                live = site.networks["dam"]
                n += 1
                timed("posting an epoch", lambda live=live, n=n: post(live, day(n)))
                ends = lambda live=live: live.close_epoch().result(HANGS)  # noqa: E731
                timed(f"end of the first epoch, {state} a state of the monitor", ends)
                timed("until no findings wait", lambda live=live: compared(live))
                if state == "with":
                    n += 1
                    post(live, day(n))
                    timed("end of the next epoch", ends)
        with TestClient(application(Site(read_site(folder)))) as client:
            live = client.app.state.site.networks["dam"]
            for route in ("epochs", f"epochs/{n}", "series?points=D1", "variance-components"):
                for _ in range(2):
                    address = f"/api/v1/networks/dam/{route}"
                    timed(f"GET {route}", lambda a=address, c=client: c.get(a).raise_for_status())
            post(live, day(n + 1))
            took: list[float] = []
            stop = threading.Event()
            watcher = threading.Thread(target=waits, args=(live, stop, took))
            watcher.start()
            late = {**day(LATE)[0], "id": "late"}

            def comes_late() -> None:
                post(live, [late])
                while any(r["state"] == "reopened" for r in live.epochs()):
                    time.sleep(0.2)
                compared(live)

            if options.late:
                timed(f"a late reading of epoch {LATE}, until all is compared", comes_late)
            stop.set()
            watcher.join()
            print(
                f"others waited at most {max(took):.3f} s, median {statistics.median(took):.4f} s"
            )


if __name__ == "__main__":
    main()
