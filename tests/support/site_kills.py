"""Campaigns in which a served site and its senders are killed while a page and a follower listen.

Senders are processes with an outbox each (`tests.support.sending_process`). The site is killed at
random moments, while it starts among them, and senders now and then. In the end the site has each
reading that a sender had on its disk, once; the page shows the state of the service.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.site.client import Client
from tests.networks.yard import ARRIVALS
from tests.support.pages import chromium
from tests.support.places import ROOT
from tests.support.processes import HANGS
from tests.support.sending_process import BEGIN, ENOUGH, LONGEST_WAIT, listed
from tests.support.site_processes import SiteProcess
from tests.support.sites import site_of, yard_of, yard_site

PAUSE = 0.2
"""Least real time between two readings of a sender, seconds."""
RUNS = 1.5
"""Longest time for which a site runs after its first answer, seconds."""
SENDER_KILLS = 0.15
"""Share of the kills of the site with which a sender is killed too."""
WITHIN = 1e-6
"""Differences from a batch adjustment, relative to σ: both are at rest."""
WAITS = 60.0
"""Time for which follower and page may lag behind in the end, seconds."""
LATEST = 200
"""Number of events that are compared with those of the page."""
ROWS = 30
"""Number of rows of the page that are compared; their events are among the latest ones."""


@dataclass
class Campaign:
    """What happened in a campaign."""

    kills: int = 0
    sender_kills: int = 0
    put: set[str] = field(default_factory=set)
    """Ids of observations that senders had in their outboxes."""
    acknowledged: set[str] = field(default_factory=set)
    """Ids whose answer came."""
    repeated: set[str] = field(default_factory=set)
    """Ids that the site had when they came again: it was killed between its disk and its answer."""
    refused: list[str] = field(default_factory=list)
    seen: Counter[str] = field(default_factory=Counter)
    """How often the follower saw each arrive."""
    numbers: list[int] = field(default_factory=list)
    """Numbers of the events of the follower."""
    lost_track: int = 0
    """How often the follower was told to read everything again."""
    restarts: list[float] = field(default_factory=list)
    """Times from a start of the process to its first answer, seconds."""
    page: dict[str, Any] = field(default_factory=dict)
    """What the page knew in the end; empty: there was none."""
    service: dict[str, Any] = field(default_factory=dict)
    """The same, as the service says it."""


class Sender:
    """A sender as a process."""

    def __init__(self, url: str, folder: Path, number: int, seed: int) -> None:
        self.folder, self.number = folder, number
        self.log = folder / f"sender{number}.log"
        """What it prints."""
        self.arguments = [url, str(folder), str(number), str(seed), str(PAUSE)]
        self.begin()

    def begin(self) -> None:
        """Start the process."""
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.support.sending_process", *self.arguments],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )

    def noted(self, name: str) -> list[str]:
        """Return a list of the sender."""
        return listed(self.folder, name, self.number)

    def kill(self) -> None:
        """Kill the process at once."""
        self.process.kill()
        self.process.wait(HANGS)


def campaign(
    folder: Path,
    *,
    kills: int,
    seed: int,
    senders: int = 3,
    page: bool = False,
    until: float = 0.0,
    told: Callable[[Campaign], None] = lambda found: None,
) -> Campaign:
    """Kill a site at random moments, and return what senders, a follower and a page saw.

    Args:
        folder: folder of the site, which is made there.
        kills: how often the process is killed.
        seed: of the moments and the readings.
        senders: number of senders.
        page: whether a browser has the page open.
        until: time at which no further kill begins, seconds since 1970; 0: there is none.
        told: takes what was found so far, after each kill.
    """
    rng = np.random.default_rng(seed)
    out, enough = Campaign(), threading.Event()
    site = SiteProcess(yard_site(folder, epochs="1 h"))
    problems: list[BaseException] = []

    def follow(client: Client) -> None:
        try:
            for event in client.events(after=0):
                out.numbers.append(event.id)
                out.lost_track += event.kind == "hello"
                if event.kind == "arrival":
                    said = event.data.get("answer", event.data)
                    verdicts = said.get("verdicts", [said])
                    out.seen.update(v["id"] for v in verdicts)
        except AdjustmentError as error:
            if not enough.is_set():
                problems.append(error)
        except BaseException as error:
            problems.append(error)

    with ExitStack() as stack:
        stack.callback(site.end)
        site.start()
        with Client(site.url) as client:
            for record in ARRIVALS:
                assert client.post("yard", {**record, "time": BEGIN + 1.0})["ok"]
        follower = Client(site.url, patience=HANGS, longest_wait=LONGEST_WAIT)
        stack.callback(follower.close)
        stack.callback(enough.set)
        threading.Thread(target=follow, args=(follower,), daemon=True).start()
        browser = _page(stack, site.url) if page else None
        running = [Sender(site.url, folder, k, seed) for k in range(senders)]
        for sender in running:
            stack.callback(sender.kill)
        while out.kills < kills and (not until or time.time() < until):
            if rng.random() < 0.3:  # while it starts, or just after
                time.sleep(float(rng.uniform(0.0, 1.5 * np.median([2.0, *out.restarts]))))
            else:
                begun = time.monotonic()
                site.wait()
                out.restarts.append(time.monotonic() - begun)
                time.sleep(float(rng.uniform(0.0, RUNS)))
            site.kill()
            out.kills += 1
            assert not problems, problems
            if rng.random() < SENDER_KILLS:
                chosen = running[int(rng.integers(senders))]
                assert chosen.process.poll() is None, chosen.log.read_text()
                chosen.kill()
                chosen.begin()
                out.sender_kills += 1
            site.begin()
            _note(out, running)
            told(out)
        site.wait()
        (folder / ENOUGH).touch()
        for sender in running:
            assert sender.process.wait(HANGS) == 0, sender.log.read_text()
        _note(out, running)
        _wait(lambda: out.put <= out.seen.copy().keys())
        enough.set()
        if browser is not None:
            _wait(lambda: _states(browser, site.url, out))
        follower.close()
        assert site.stop() in (0, -signal.SIGTERM), site.log.read_text()
    assert not problems, problems
    return out


def _note(out: Campaign, senders: Sequence[Sender]) -> None:
    """Note what senders have listed."""
    out.put = {i for s in senders for i in s.noted("put")}
    out.acknowledged = {i for s in senders for i in s.noted("acknowledged")}
    out.repeated = {i for s in senders for i in s.noted("repeated")}
    out.refused = [r for s in senders for r in s.noted("refused")]


def _wait(happens: Any) -> None:
    """Wait until something happens; what does not is found by who compares afterwards."""
    until = time.monotonic() + WAITS
    while time.monotonic() < until and not happens():
        time.sleep(0.2)


# -- the page --------------------------------------------------------------------------------------

PAGE_STATE = """async () => {
  const {context, connection} = await import('/page/live.js');
  return {
    connection: connection.state,
    events: context.log.map(e => Number(e.id)),
    rows: [...document.querySelectorAll('#view li[data-id]')]
      .map(e => `${e.dataset.id} ${e.dataset.verdict}`),
  };
}"""
"""What the page knows, and the rows that it shows."""


def _page(stack: ExitStack, url: str) -> Any:
    """Return a page in a browser, at its verdicts."""
    page = stack.enter_context(chromium()).new_page()
    page.set_default_timeout(1000 * HANGS)
    page.goto(f"{url}#/yard/verdicts")
    page.wait_for_selector("#view[data-view=verdicts]", state="attached")
    return page


def _states(page: Any, url: str, out: Campaign) -> bool:
    """Read what page and service know; return whether it is the same."""
    out.page = page.evaluate(PAGE_STATE)
    with Client(url, patience=HANGS) as client:
        latest = client._http.get("/networks/yard/events", params={"most": LATEST})
    arrived = [e["data"] for e in latest.json() if e["event"] == "arrival"]
    verdicts = [v for a in arrived for v in [*a.get("verdicts", [a]), *a.get("entered", [])]]
    out.service = {"events": [e["id"] for e in latest.json()]}
    out.service["rows"] = [f"{v['id']} {v['verdict']}" for v in verdicts]
    return not differences_of_page(out)


def differences_of_page(found: Campaign) -> list[str]:
    """Return in what the page and the service differ."""
    page, service, out = found.page, found.service, []
    if page["connection"] != "live":
        out.append(f"connection {page['connection']}")
    if len(set(page["events"])) != len(page["events"]):
        out.append("doubled events")
    latest = page["events"][-LATEST:]
    if latest != (stated := service["events"][-len(latest) :]):
        lacks, more = sorted({*stated} - {*latest}), sorted({*latest} - {*stated})
        out.append(f"events: the page lacks {lacks} and has {more} more, in order {latest}")
    # The order of the verdicts of one answer is that of the page; all that both have are the same.
    rows, stated = Counter(page["rows"][:ROWS]), Counter(service["rows"])
    if not rows or set(rows.values()) != {1} or not rows <= stated:
        out.append(f"rows {rows - stated or rows}")
    return out


def assert_nothing_is_lost_or_doubled(folder: Path, found: Campaign) -> None:
    """Compare what the site has with what was acknowledged, and with batch adjustments."""
    sent = {r["id"] for r in ARRIVALS} | found.put
    assert not found.refused
    assert found.acknowledged <= found.put
    # A sender that was killed with an answer in its hand has not noted it, and asks no more.
    assert len(found.put - found.acknowledged) <= 100 * found.sender_kills
    assert not found.page or not differences_of_page(found), differences_of_page(found)
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
