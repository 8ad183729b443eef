"""Followers of events that do not read: nobody waits for them, and they learn what they miss."""

from __future__ import annotations

import asyncio
import time

from factorgraph_adj.site.client import Client
from factorgraph_adj.site.retention import Retention
from factorgraph_adj.site.retention_settings import DAY_S, RetentionSettings
from tests.networks.yard import ARRIVALS
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import site_of, yard_of, yard_site
from tests.support.slow_followers import SlowFollower

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
            follower = site.events.follow(0)
            first = await anext(follower)
            # It has one page of events in hand; what comes after that page leaves meanwhile.
            for n in range(2):
                record = {**ARRIVALS[3], "id": f"later {n}"}
                await asyncio.to_thread(live.submit(record).result, HANGS)
            kept = Retention(RetentionSettings(events=DAY_S), site.database, [live])
            await asyncio.to_thread(kept.apply, time.time() + 2 * DAY_S)
            out = [first]
            while out[-1].kind != "hello":
                out.append(await asyncio.wait_for(anext(follower), HANGS))
            live.submit({**ARRIVALS[4], "id": "last"})
            out.append(await asyncio.wait_for(anext(follower), HANGS))
            return out

        *before, told, after = asyncio.run(followed())
    number = len(ARRIVALS)
    assert [e.id for e in before] == list(range(1, number + 1))
    assert told.data == {"lost": True} and told.id == number + 2
    assert after.id == number + 3 and after.data["id"] == "last"
