"""Campaigns in which a served site is killed while senders post and a follower listens."""

from __future__ import annotations

import signal
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.site.client import Client
from factorgraph_adj.site.outbox import Outbox
from tests.networks.yard import ARRIVALS
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import site_of, yard_of, yard_site

BEGIN = 1_700_002_800.0
"""Begin of the first epoch, seconds UTC: a full hour."""
STEP = 40.0
"""Time between two readings of a sender, seconds: ninety in an epoch."""
PAUSE = 0.02
"""Least real time between two readings of a sender, seconds."""
LATE_SHARE = 0.02
"""Share of readings that come an epoch too late."""
NOISE = 0.0004
"""Standard deviation of the readings, metres."""
WITHIN = 1e-6
"""Differences from a batch adjustment, relative to σ: both are at rest."""


@dataclass
class Campaign:
    """What happened in a campaign."""

    kills: int = 0
    put: set[str] = field(default_factory=set)
    """Ids of observations that senders have put into their outboxes."""
    acknowledged: Counter[str] = field(default_factory=Counter)
    """How often the answer to each came."""
    refused: list[object] = field(default_factory=list)
    seen: Counter[str] = field(default_factory=Counter)
    """How often the follower saw each arrive."""
    numbers: list[int] = field(default_factory=list)
    """Numbers of the events of the follower."""
    lost_track: int = 0
    """How often the follower was told to read everything again."""
    restarts: list[float] = field(default_factory=list)
    """Times from a start of the process to its first answer, seconds."""


def campaign(folder: Path, *, kills: int, seed: int, senders: int = 3) -> Campaign:
    """Kill a site at random moments, and return what senders and a follower saw.

    Args:
        folder: folder of the site, which is made there.
        kills: how often the process is killed.
        seed: of the moments and the readings.
        senders: number of senders.
    """
    rng = np.random.default_rng(seed)
    out, lock, enough = Campaign(), threading.Lock(), threading.Event()
    site = SiteProcess(yard_site(folder, epochs="1 h"))
    site.start()
    for record in ARRIVALS:
        with Client(site.url) as client:
            assert client.post("yard", {**record, "time": BEGIN + 1.0})["ok"]
    problems: list[BaseException] = []

    def send(number: int) -> None:
        own = np.random.default_rng((seed, number))
        outbox, n = Outbox(folder / f"outbox{number}.sqlite"), 0

        def answered(kept, answer) -> None:
            with lock:
                out.acknowledged[kept.record["id"]] += 1
                if not answer["ok"]:
                    out.refused.append(answer)

        with Client(site.url, patience=HANGS) as client:
            while not enough.is_set() or len(outbox):
                if not enough.is_set():
                    n += 1
                    ident, at = f"k{number}-{n}", BEGIN + 2.0 + n * STEP
                    if own.random() < LATE_SHARE:
                        at = max(BEGIN + 2.0, at - 3600.0)
                    value = round(1.4996 + float(own.normal(0.0, NOISE)), 6)
                    rise = {"kind": "height_difference", "station": "A", "target": "C"}
                    with lock:
                        out.put.add(ident)
                    outbox.put("yard", {**rise, "id": ident, "value": value, "time": at})
                client.send(outbox, answered=answered)
                time.sleep(PAUSE)
        outbox.close()

    def follow(client: Client) -> None:
        for event in client.events(after=0):
            out.numbers.append(event.id)
            out.lost_track += event.kind == "hello"
            if event.kind == "arrival":
                said = event.data.get("answer", event.data)
                verdicts = said.get("verdicts", [said])
                out.seen.update(v["id"] for v in verdicts)

    def guarded(what, *arguments) -> None:
        try:
            what(*arguments)
        except AdjustmentError as error:
            if what is send or not enough.is_set():
                problems.append(error)
        except BaseException as error:
            problems.append(error)

    follower = Client(site.url, patience=HANGS)
    threads = [threading.Thread(target=guarded, args=(send, k)) for k in range(senders)]
    threads.append(threading.Thread(target=guarded, args=(follow, follower), daemon=True))
    for thread in threads:
        thread.start()
    while out.kills < kills:
        if rng.random() < 0.3:  # while it starts, or just after
            time.sleep(float(rng.uniform(0.0, 1.5 * np.median([2.0, *out.restarts]))))
        else:
            begun = time.monotonic()
            site.wait()
            out.restarts.append(time.monotonic() - begun)
            time.sleep(float(rng.uniform(0.0, 0.7)))
        site.kill()
        out.kills += 1
        assert not problems, problems
        site.begin()
    site.wait()
    enough.set()
    for thread in threads[:-1]:
        thread.join(HANGS)
        assert not thread.is_alive(), "a sender hangs"
    until = time.monotonic() + HANGS
    while time.monotonic() < until and not out.put <= out.seen.copy().keys():
        time.sleep(0.05)
    follower.close()
    assert site.stop() in (0, -signal.SIGTERM), site.log.read_text()
    assert not problems, problems
    return out


def assert_nothing_is_lost_or_doubled(folder: Path, found: Campaign) -> None:
    """Compare what the site has with what was acknowledged, and with batch adjustments."""
    sent = {r["id"] for r in ARRIVALS} | found.put
    assert not found.refused
    assert set(found.acknowledged) == found.put
    assert set(found.acknowledged.values()) <= {1}
    assert set(found.seen) == sent and set(found.seen.values()) == {1}
    assert not found.lost_track
    assert found.numbers == sorted(set(found.numbers))
    there: Counter[str] = Counter()
    with site_of(folder) as site:  # whose journals are read, with their chains
        live = yard_of(site)
        time.sleep(1.0)  # epochs that late readings had opened are computed
        rows = live.epochs(results=True)
        for row in rows:
            with live.reading(row["number"]) as epoch:
                inc = epoch.stream.adjustment
                own = [*inc.network().observations]
                own += [v.id for v in (*inc.waiting, *inc.suspects, *inc.rejected)]
                there.update(own)
                if row["result"] is not None and row["result"]["counts"]:
                    counts = row["result"]["counts"]
                    assert row["state"] == "closed"
                    assert counts["observations"] == len(inc), row["number"]
                if row["number"] > 0 and len(inc):
                    inc.settle()
                    _assert_is_batch(inc)
    assert set(there) == sent and set(there.values()) == {1}


def _assert_is_batch(inc: fga.IncrementalAdjustment) -> None:
    solution, batch = inc.solution(), fga.adjust(inc.network())
    for name in batch.network.points:
        sigma = batch.standard_deviations(name)
        free = sigma > 1e-9
        apart = np.abs(solution.point(name) - batch.point(name))
        assert np.all(apart[free] <= WITHIN * sigma[free]), name
