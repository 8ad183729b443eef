"""A site under load: single readings of many senders, readers that take nothing."""

from __future__ import annotations

import socket
import time

import pytest

pytest.importorskip("fastapi", reason="the service of a site needs the extra serve")
pytest.importorskip("uvicorn", reason="the service of a site needs the extra serve")

from factorgraph_adj.site.database import Database
from factorgraph_adj.site.event_log import EventLog
from tests.benchmarks.site_load import assert_everything_is_there_once, load, resident_mb
from tests.support.site_processes import SiteProcess
from tests.support.sites import database_of, yard_site

EVENTS, SIZE = 2000, 20_000
"""Events of a slow reader, and characters of each: 40 MB."""
ROOM_MB = 20.0
"""What a slow reader may hold: a page of events, several times over (text, lines, buffers)."""


@pytest.mark.parametrize("together", [1, 5])
def test_readings_of_many_senders_are_there_once(tmp_path, together):
    found = load(tmp_path, senders=6, rate=10.0, seconds=1.0, together=together)
    assert len(found.acknowledged) == 60
    assert not found.refused
    assert_everything_is_there_once(tmp_path, found)


def test_readings_that_are_piped_to_commands_are_there_once(tmp_path):
    found = load(tmp_path, senders=2, rate=20.0, seconds=1.0, command=True)
    assert len(found.acknowledged) == 40 and found.cpu_of_senders > 0.0
    assert_everything_is_there_once(tmp_path, found)


def _record(folder, number):
    database = Database(database_of(folder), serve=False)
    log = EventLog(database)
    for k in range(number):
        log.record("problem", {"what": "x" * SIZE, "n": k}, at=1.0, network=None)
    database.close()


def test_a_reader_that_takes_nothing_holds_no_memory_and_slows_nobody(tmp_path):
    yard_site(tmp_path)
    Database(database_of(tmp_path)).close()
    _record(tmp_path, EVENTS)
    site = SiteProcess(tmp_path)
    site.start()
    assert site.process is not None
    asked = b"GET /api/v1/events?after=0 HTTP/1.1\r\nHost: x\r\n\r\n"
    with socket.create_connection(("127.0.0.1", site.port)) as quick:  # so that all is loaded
        quick.sendall(asked)
        assert _drained(quick, b'"n": 99}')
    before = resident_mb(site.process.pid)
    slow = [socket.create_connection(("127.0.0.1", site.port)) for _ in range(3)]
    for each in slow:
        each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        each.sendall(asked)
    time.sleep(1.0)
    with socket.create_connection(("127.0.0.1", site.port)) as quick:
        quick.sendall(asked)
        assert _drained(quick, f'"n": {EVENTS - 1}}}'.encode())
    grown = resident_mb(site.process.pid) - before
    for each in slow:
        each.close()
    site.stop()
    assert grown < ROOM_MB * (len(slow) + 1), grown
    assert EVENTS * SIZE * len(slow) > 1e6 * ROOM_MB * (len(slow) + 1)


def _drained(reader, last):
    """Read until bytes have come."""
    reader.settimeout(60.0)
    tail = b""
    while last not in tail:
        chunk = reader.recv(1 << 16)
        if not chunk:
            return False
        tail = tail[-100:] + chunk
    return True
