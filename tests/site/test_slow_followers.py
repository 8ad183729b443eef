"""Followers of events that do not read: nobody waits for them, and they learn what they miss."""

from __future__ import annotations

import asyncio
import time

from factorgraph_adj.site.client import Client, _events
from factorgraph_adj.site.event_log import EventLog
from factorgraph_adj.site.retention import Retention
from factorgraph_adj.site.retention_settings import DAY_S, RetentionSettings
from tests.networks.yard import ARRIVALS
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import site_of, yard_of, yard_site
from tests.support.slow_followers import SlowFollower


def parsed(piece):
    """Return the events of a text of server-sent events."""
    return [e for e in _events(iter(piece.decode().splitlines())) if e is not None]


LONG = "i" * 40_000
"""Begin of the ids of readings, whose events are thus long: sockets do not hold them all."""
READINGS, SOCKET_BYTES = 150, 8 << 20
"""Number of readings, and more than the buffers of a connection hold."""


def test_a_follower_that_does_not_read_hinders_nobody_and_catches_up(tmp_path):
    site = SiteProcess(yard_site(tmp_path))
    site.start()
    slow = SlowFollower(site.port)
    sent = len(ARRIVALS) + READINGS
    with Client(site.url) as client:
        client.post_all("yard", ARRIVALS)
        for n in range(READINGS):
            client.post("yard", {**ARRIVALS[-1], "id": f"{LONG}{n}"})
        quick = client.events(after=0)
        events = [next(quick) for _ in range(sent)]
    assert [event.id for event in events] == list(range(1, sent + 1))
    assert sum(len(str(event.data)) for event in events) > SOCKET_BYTES
    assert not slow.numbers
    slow.read(sent, HANGS)
    assert slow.numbers == list(range(1, sent + 1)) and not slow.lost
    slow.close()
    again = SlowFollower(site.port, after=sent // 3)
    again.read(sent, HANGS)
    assert again.numbers == list(range(sent // 3 + 1, sent + 1))
    again.close()
    stalled = SlowFollower(site.port)
    begun = time.monotonic()
    site.stop()  # does not wait for who does not read
    assert time.monotonic() - begun < HANGS / 2
    stalled.close()


def test_a_follower_is_told_when_events_left_before_it_read_them(tmp_path):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        for record in ARRIVALS:
            live.submit(record).result(HANGS)

        async def followed():
            follower = site.events.follow(0, names={live.id: "yard"})
            first = await anext(follower)
            # It has one page of events in hand; what comes after that page leaves meanwhile.
            for n in range(2):
                record = {**ARRIVALS[3], "id": f"later {n}"}
                await asyncio.to_thread(live.submit(record).result, HANGS)
            kept = Retention(RetentionSettings(events=DAY_S), site.database, [live])
            await asyncio.to_thread(kept.apply, time.time() + 2 * DAY_S)
            told = await asyncio.wait_for(anext(follower), HANGS)
            live.submit({**ARRIVALS[4], "id": "last"})
            return first, told, await asyncio.wait_for(anext(follower), HANGS)

        first, told, after = (parsed(piece) for piece in asyncio.run(followed()))
    number = len(ARRIVALS)
    assert [event.id for event in first] == list(range(1, number + 1))
    assert [(event.id, event.data["lost"]) for event in told] == [(number + 2, True)]
    assert [(event.id, event.data["id"]) for event in after] == [(number + 3, "last")]
    assert {event.data["network"] for event in (*first, *after)} == {"yard"}


def test_followers_that_wait_for_the_same_events_share_one_reading(tmp_path, monkeypatch):
    read, of_log = [], EventLog._rows_after

    def counted(self, *asked):
        read.append(asked)
        return of_log(self, *asked)

    monkeypatch.setattr(EventLog, "_rows_after", counted)
    with site_of(tmp_path) as site:
        live = yard_of(site)

        async def all_followed():
            followers = [site.events.follow(0, names={live.id: "yard"}) for _ in range(20)]
            pieces = [asyncio.create_task(anext(f)) for f in followers]
            await asyncio.sleep(0.5)  # all wait
            leaves = pieces.pop()
            leaves.cancel()
            read.clear()
            await asyncio.to_thread(live.submit(ARRIVALS[0]).result, HANGS)
            return await asyncio.gather(*pieces)

        pieces = asyncio.run(all_followed())
    assert [[e.data["id"] for e in parsed(piece)] for piece in pieces] == [["r1"]] * 19
    assert len(read) <= 2
