"""Months of a dam through the whole service: ``python -m tests.benchmarks.site_months [N]``.

Plays N = 5 months of `tests.benchmarks.monitoring` (``--days`` of each, seeds from ``--seed`` on)
by a served site with daily epochs and the same rules: each total station, and GNSS with levelling,
post from an outbox of their own; a sender is out for a day at times and then sends everything; the
service is killed at random moments and started again; a server takes the messages of alarms.
Afterwards the estimate of every epoch, and the tests of the rules, are compared with those of the
engine that played the same readings, and the alarms and messages are counted.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from scipy.stats import poisson

import factorgraph_adj as fga
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.io.observation_records import observation_record
from factorgraph_adj.io.project_writer import write_project
from factorgraph_adj.monitoring.epoch_estimates import EpochEstimate
from factorgraph_adj.monitoring.monitor import Findings, Monitor
from factorgraph_adj.monitoring.motion_filter import DAY_S
from factorgraph_adj.site.client import Client
from factorgraph_adj.site.outbox import Outbox
from tests.benchmarks.monitoring import (
    CREEP_FROM,
    CREEP_MM_PER_DAY,
    CREEPING,
    EPOCHS,
    FACTORS,
    FIRST_MOVE,
    LAST_MOVE,
    RATE,
    REFERENCE,
    RULES,
)
from tests.networks.dam import STATIONS, dam_epoch, drawn_weather
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import new_database, site_of, storing_in

BEGIN = 19_700 * DAY_S
"""Begin of the first day, seconds UTC."""
SENDERS = (*STATIONS, "GNSS")
OUT = 0.03
"""Probability that a sender is out for a day, of whose readings the site hears a day late."""
WITHIN = 1e-6
"""Largest difference of coordinates from the engine, in σ, and of tests, relative to them."""


@dataclass
class Month:
    """Readings of a month, and what the engine makes of them."""

    readings: list[dict[str, list[dict[str, object]]]] = field(default_factory=list)
    """Postings of each day, by senders."""
    estimates: dict[int, EpochEstimate] = field(default_factory=dict)
    """Estimates by days."""
    findings: dict[int, Findings] = field(default_factory=dict)
    """Findings by days."""
    moves: dict[str, int] = field(default_factory=dict)
    """Day on which each point moves, or begins to creep."""
    network: fga.Network = field(default_factory=lambda: fga.Network("dam"))
    """The network without observations."""

    def raised(self) -> set[tuple[str, str, int]]:
        """Return rule, point and day of the alarms."""
        return {(a.rule, a.point, d) for d, f in self.findings.items() for a in f.raised}


def drawn_month(seed: int, days: int) -> Month:
    """Return a month; the displacements have the sizes of `tests.benchmarks.monitoring`."""
    rng, out = np.random.default_rng([42, seed]), Month()
    monitor = Monitor(RULES, interval=DAY_S, objects=["D*"], reference_epochs=REFERENCE)
    first = min(FIRST_MOVE, days - 3)
    last = max(min(LAST_MOVE, days - 4), first + 1)
    out.moves = {n: int(rng.integers(first, last)) for n in FACTORS}
    shifts: dict[str, np.ndarray] = {}
    before: Findings | None = None
    for day in range(days):
        for name in (n for n, at in out.moves.items() if at <= day and n not in shifts):
            if before is not None:
                x = before.points[name]
                size = FACTORS[name] * next(t.detectable_mm for t in x.tests if t.rule == "2 of 3")
                shifts[name] = 1e-3 * size * x.displacement.hardest
                out.moves[name] = day
        moved = dict(shifts)
        if day > CREEP_FROM:
            moved[CREEPING] = np.array([0.0, 1e-3 * CREEP_MM_PER_DAY * (day - CREEP_FROM), 0.0])
        weather = drawn_weather(rng, day, 7)
        of_day: dict[str, list[dict[str, object]]] = {s: [] for s in SENDERS}
        out.readings.append(of_day)
        if weather is None:
            continue
        network = dam_epoch(rng, moved, weather)
        out.network = without(network, list(network.observations))
        for i, (name, o) in enumerate(network.observations.items()):
            sender = "GNSS" if o.kind in ("gnss_vector", "height_difference") else o.station
            record = {k: v for k, v in observation_record(o).items() if v}
            stamp = {"id": f"d{day}-{name}", "time": BEGIN + DAY_S * day + 21_600.0 + 60.0 * i}
            of_day[sender].append({**record, **stamp})
        out.estimates[day] = EpochEstimate.of(fga.adjust(network), day, DAY_S * day)
        out.findings[day] = monitor.add(out.estimates[day])
        before = out.findings[day] if out.findings[day].points else before
    out.moves[CREEPING] = CREEP_FROM + 1
    return out


@contextmanager
def receiver() -> Iterator[tuple[str, list[dict[str, object]]]]:
    """Give the address of a server for messages, and the alarms that it was told of."""
    told: list[dict[str, object]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            told.append(json.loads(body)["alarm"])
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/", told
    finally:
        server.shutdown()
        server.server_close()


def write_site(folder: Path, month: Month, hook: str) -> Path:
    """Write the dam as a site, and return the folder."""
    write_project(month.network, folder / "dam")
    lines = ["[site]", f'database = "{new_database(folder)}"', "[[network]]", 'name = "dam"']
    lines += ['project = "dam"', 'policy = "accept"', 'epochs = "1 d"', 'objects = ["D*"]']
    lines += [f"reference_epochs = {REFERENCE}", "reference = 1"]  # as that of the engine
    for rule in RULES:
        lines += ["[[alarm]]", f'name = "{rule.name}"', f'test = "{rule.test}"']
        lines += [f"k = {rule.life.k}", f"n = {rule.life.n}", f'notify = ["{hook}"]']
        lines += [f"clear_after = {rule.life.clear_after}", f"false_alarms_per_month = {RATE}"]
        lines += ['points = ["D*"]'] if rule.test != "congruence" else []
    (folder / "site.toml").write_text("\n".join(lines) + "\n")
    return folder


@dataclass
class Served:
    """What became of a month that was served."""

    alarms: list[dict[str, object]]
    """Alarms of the site."""
    told: list[dict[str, object]]
    """Messages that came."""
    readings: int = 0
    """Readings that were put and acknowledged."""
    kills: int = 0
    outages: int = 0
    coordinates: float = 0.0
    """Largest difference of a coordinate from the engine, in its σ."""
    tests: float = 0.0
    """Largest relative difference of a test of a closed epoch."""
    stale: int = 0
    """Epochs whose recorded tests are of before late readings of an earlier epoch."""

    def raised(self) -> set[tuple[str, str, int]]:
        """Return rule, point and day of the alarms."""
        return {
            (str(a["rule"]), "".join(a["points"]), round((a["since"] - BEGIN) / DAY_S - 0.5))
            for a in self.alarms
        }


def serve_month(folder: Path, month: Month, *, seed: int, kills: int) -> Served:
    """Play a month by a served site, and compare it with the engine."""
    rng = np.random.default_rng([43, seed])
    days = len(month.readings)
    killed = Counter(rng.integers(1, days, kills).tolist())
    with receiver() as (hook, told):
        site = SiteProcess(write_site(folder, month, hook))
        site.start()
        out = Served([], told)
        outboxes = {s: Outbox(folder / f"{s}.outbox") for s in SENDERS}
        acknowledged: Counter[str] = Counter()
        problems: list[object] = []
        lock = threading.Lock()

        def answered(kept, answer) -> None:
            with lock:
                acknowledged[kept.record["id"]] += 1
                if not answer["ok"]:
                    problems.append(answer)

        def send(outbox: Outbox) -> None:
            try:
                with Client(site.url, patience=HANGS) as client:
                    client.send(outbox, answered=answered)
            except BaseException as error:
                problems.append(error)

        put: set[str] = set()
        for day, of_day in enumerate(month.readings):
            threads = []
            for sender, records in of_day.items():
                outboxes[sender].put("dam", *records)
                put |= {str(r["id"]) for r in records}
                if rng.random() < OUT and day < days - 1:
                    out.outages += 1
                    continue
                threads.append(threading.Thread(target=send, args=(outboxes[sender],)))
            for thread in threads:
                thread.start()
            for _ in range(killed[day]):
                time.sleep(float(rng.uniform(0.0, 1.0)))
                site.kill()
                site.begin()
                out.kills += 1
                site.wait()
            for thread in threads:
                thread.join(HANGS)
            assert not problems, problems
        assert set(acknowledged) == put and set(acknowledged.values()) == {1}
        out.readings = len(put)
        with Client(site.url, patience=HANGS) as client:
            client.close_epoch("dam")
            until = time.monotonic() + HANGS
            while any(e["state"] != "closed" for e in client.epochs("dam")):
                assert time.monotonic() < until, "an epoch stays open"
                time.sleep(0.2)
            out.alarms = client._got("/alarms", state="all")
        wanted = {(a["id"], s) for a in out.alarms for s in _states(a)}
        while not wanted <= {(a["id"], a["state"] == "closed") for a in told}:
            assert time.monotonic() < until, "a message was not sent"
            time.sleep(0.2)
        site.stop()
        for outbox in outboxes.values():
            outbox.close()
    _compare(folder, month, put, out)
    return out


def _states(alarm: dict[str, object]) -> tuple[bool, ...]:
    """Return of what there is a message: raised (False), cleared (True)."""
    return (False, True) if alarm["until"] is not None else (False,)


def _compare(folder: Path, month: Month, put: set[str], out: Served) -> None:
    """Compare journals, estimates and tests with what was sent and with the engine."""
    there: Counter[str] = Counter()
    days = set()
    with site_of(folder) as site:
        live = site.networks["dam"]
        for row in live.epochs(results=True):
            if row["number"] == 0:
                continue
            day = round((row["begin"] - BEGIN) / DAY_S)
            days.add(day)
            with live.reading(row["number"]) as epoch:  # read from its journal, with its chain
                there.update([*epoch.stream.adjustment.network().observations])
            mine, engine = EpochEstimate.from_json(row["result"]["estimate"]), month.estimates[day]
            assert mine.names == engine.names and mine.redundancy == engine.redundancy
            off = _off(mine, engine)
            out.coordinates = max(out.coordinates, off)
            tests = {
                (t["rule"], t["point"]): t["value"] for t in row["result"]["findings"]["tests"]
            }
            found = month.findings[day]
            theirs = {(t.rule, n): t.value for n, p in found.points.items() for t in p.tests}
            theirs |= {(t.rule, ""): t.value for t in found.reference_tests}
            worst = max(
                (abs(tests.get(k, np.inf) - v) / max(v, 1.0) for k, v in theirs.items()),
                default=0.0,
            )
            out.stale += worst > WITHIN
            out.tests = max(out.tests, worst if worst <= WITHIN else 0.0)
    assert days == set(month.estimates)
    assert set(there) == put and set(there.values()) == {1}
    assert out.coordinates <= WITHIN, out.coordinates


def _off(mine: EpochEstimate, engine: EpochEstimate) -> float:
    """Return the largest difference of coordinates in σ, whatever the datum of either.

    A free datum follows from the coordinates with which an epoch begins. It is turned about the
    vertical as a whole: motions of the first order alone leave L θ²/2, with 10⁻⁵ rad and 300 m
    3·10⁻⁵ of a σ of 0.5 mm.
    """
    x = mine.coordinates
    motions = engine.motions
    assert motions.shape[1] <= 4, "translations, and the turn about the vertical"
    if motions.shape[1] == 4:
        free = engine.free.all(axis=1)
        a, b = (e.coordinates[free] - e.coordinates[free].mean(axis=0) for e in (mine, engine))
        turn = np.angle(np.sum((b[:, 0] + 1j * b[:, 1]) * (a[:, 0] - 1j * a[:, 1])))
        around = mine.coordinates[free].mean(axis=0)
        c, s = np.cos(turn), np.sin(turn)
        x = (x - around) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + around
    apart = (x - engine.coordinates)[engine.free]
    g = np.linalg.qr(motions)[0] if motions.shape[1] else motions
    apart = apart - g @ (g.T @ apart)
    return float(np.max(np.abs(apart) / np.sqrt(np.diag(engine.cofactors))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("months", type=int, nargs="?", default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--days", type=int, default=EPOCHS)
    parser.add_argument("--kills", type=int, default=6)
    parser.add_argument("--postgresql", action="store_true")
    options = parser.parse_args()
    store = "postgresql" if options.postgresql else "sqlite"
    false: Counter[str] = Counter()
    for seed in range(options.seed, options.seed + options.months):
        begun = time.monotonic()
        month = drawn_month(seed, options.days)
        with storing_in(store), tempfile.TemporaryDirectory() as folder:
            out = serve_month(Path(folder), month, seed=seed, kills=options.kills)
        mine, engine = out.raised(), month.raised()
        for rule, point, day in mine:
            false[rule] += day < month.moves.get(point, options.days)
        found = {}
        for point, at in month.moves.items():
            days = sorted(d for _, p, d in mine if p == point and d >= at)
            found[point] = days[0] - at + 1 if days else None
        print(
            f"month {seed}, {time.monotonic() - begun:.0f} s on {store}: {out.readings} readings "
            f"acknowledged, each there once; {out.kills} kills, {out.outages} outages of a sender; "
            f"coordinates within {out.coordinates:.1e} σ of the engine, tests {out.tests:.1e}, "
            f"{out.stale} epochs with tests of before late readings; alarms {len(mine)}, of the "
            f"engine {len(engine)}, of both {len(mine & engine)}, cleared "
            f"{sum(a['until'] is not None for a in out.alarms)}; messages {len(out.told)}; days to "
            f"the first alarm {found}",
            flush=True,
        )
    mean = RATE * options.months * (options.days - REFERENCE) * DAY_S / (30.4375 * DAY_S)
    low, high = poisson.ppf(0.005, mean), poisson.ppf(0.995, mean)
    for rule in RULES:
        print(
            f"false alarms, {rule.name}: {false[rule.name]}, stated at most {mean:.1f}, "
            f"99 % {low:.0f} to {high:.0f}"
        )


if __name__ == "__main__":
    main()
