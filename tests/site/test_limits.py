"""Limits of rate and size: who is refused, with which words, and what a client makes of it."""

from __future__ import annotations

import json
import socket
import time

import pytest

from factorgraph_adj.site import access
from factorgraph_adj.site.api import MAX_BODY, MAX_BODY_OF_STRANGERS, SECONDS_TO_RETRY
from factorgraph_adj.site.client import Client
from tests.networks.yard import ARRIVALS
from tests.support.site_processes import SiteProcess
from tests.support.sites import ADDRESS, served, yard_site

POSTINGS = f"{ADDRESS}/postings"
JSON = {"Content-Type": "application/json"}


class Clock:
    """A clock that goes on when a test says so."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def time(self) -> float:
        return time.time()


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(access, "clock", made)
    return made


def asked(client, token=None):
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    return client.get("/api/v1/site", headers=headers)


def statuses(client, number, token=None):
    return [asked(client, token).status_code for _ in range(number)]


def test_each_token_has_a_limit_of_its_own(tmp_path, clock):
    with served(tmp_path) as client:
        site = client.app.state.site
        site.access.per_second = 0.3
        busy, calm = (site.access.add(name, "viewer") for name in ("busy", "calm"))
        assert statuses(client, 5, busy) == [200] * 3 + [429] * 2
        answer = asked(client, busy)
        assert answer.headers["retry-after"] == str(SECONDS_TO_RETRY)
        (said,) = answer.json()["error"]
        assert said["what"] == "busy makes more than 0.3 requests a second"
        assert statuses(client, 3, calm) == [200] * 3
        clock.now += 1.01 / 0.3
        assert statuses(client, 2, busy) == [200, 429]
        clock.now += 1e4  # what was not used is not kept for more than ten seconds
        assert statuses(client, 4, busy) == [200] * 3 + [429]


def test_what_comes_too_fast_is_not_executed(tmp_path, clock):
    with served(tmp_path) as client:
        access = client.app.state.site.access
        access.per_second = 0.1
        assert statuses(client, 20) == [200] * 20  # without tokens there is no limit
        client.headers["Authorization"] = f"Bearer {access.add('office', 'admin')}"
        assert client.post(POSTINGS, json=ARRIVALS[0]).status_code == 200
        answer = client.post(POSTINGS, json=ARRIVALS[1])
        assert answer.status_code == 429 and "retry-after" in answer.headers
        assert client.get("/api/v1/health").status_code == 200
        clock.now += 1e4
        page = client.get(f"{ADDRESS}/observations", params={"state": "accepted"}).json()
        assert [o["id"] for o in page["rows"]] == [ARRIVALS[0]["id"]]


def test_a_client_waits_as_long_as_a_busy_site_says(tmp_path, clock):
    waited = []

    def wait(seconds):
        waited.append(seconds)
        clock.now += seconds
        return False

    with served(tmp_path) as http:
        access = http.app.state.site.access
        access.per_second = 0.2  # two at once, then one in 5 s
        token = access.add("ts1", "instrument")
        client = Client("http://testserver", token=token, transport=http._transport)
        client._stopped.wait = wait
        for record in ARRIVALS[:4]:
            assert client.post("yard", record)["ok"]
    assert sum(waited) >= 10.0 - 1e-9
    assert min(waited) >= SECONDS_TO_RETRY


@pytest.mark.parametrize("chunked", [False, True])
def test_a_body_that_is_too_large_is_refused(tmp_path, chunked):
    body = b"[" + b" " * (MAX_BODY + 1) + b"]"
    with served(tmp_path) as client:
        largest = body[: MAX_BODY - 1] + b"]"
        assert client.post(POSTINGS, content=largest, headers=JSON).json() == []
        answer = client.post(POSTINGS, content=iter([body]) if chunked else body, headers=JSON)
        assert answer.status_code == 413
        assert "larger than 16 MB" in answer.json()["error"][0]["what"]


@pytest.mark.parametrize("chunked", [False, True])
def test_a_stranger_sends_no_large_body(tmp_path, chunked):
    body = b"[" + b" " * MAX_BODY_OF_STRANGERS + b"]"
    with served(tmp_path) as client:
        token = client.app.state.site.access.add("ts1", "instrument")

        def posted(who):
            sent = iter([body]) if chunked else body
            return client.post(POSTINGS, content=sent, headers=JSON | who)

        for stranger in ({}, {"Authorization": "Bearer fga_no"}):
            assert posted(stranger).status_code == 401
        assert posted({"Authorization": f"Bearer {token}"}).json() == []


def test_a_body_without_end_is_not_read_to_its_end(tmp_path):
    """A sender that states no length sends on: the service answers, and reads no more."""
    site = SiteProcess(yard_site(tmp_path))
    site.start()
    try:
        with socket.create_connection(("127.0.0.1", site.port), 60.0) as connection:
            head = f"POST {POSTINGS} HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
            connection.sendall(head.encode())
            part, sent = b" " * (1 << 20), 0
            try:
                while sent < 20 * MAX_BODY:
                    connection.sendall(b"%x\r\n%s\r\n" % (len(part), part))
                    sent += len(part)
            except OSError:  # it has closed the connection
                pass
            assert sent < 4 * MAX_BODY
        with Client(site.url) as client:
            assert client.post("yard", ARRIVALS[0])["ok"]
        with socket.create_connection(("127.0.0.1", site.port), 60.0) as connection:
            length = json.dumps(MAX_BODY + 1)
            head = f"POST {POSTINGS} HTTP/1.1\r\nHost: x\r\nContent-Length: {length}\r\n\r\n"
            connection.sendall(head.encode())
            assert connection.recv(100).startswith(b"HTTP/1.1 413")
    finally:
        site.end()
