"""The client of a site: tries again what is safe, resumes events, keeps postings in an outbox."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import threading
import time

import httpx2
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.site import client as client_module
from factorgraph_adj.site.client import Client, ServiceAway
from factorgraph_adj.site.outbox import IN_MEMORY, Outbox
from tests.networks.yard import ARRIVALS, WRONG
from tests.support.places import ROOT
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import until, yard_site

OK = {"ok": True}


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(client_module, "FIRST_WAIT", 0.001)


def client_of(answers, seen):
    """Return a client of a service that gives answers in turn: statuses, or errors."""
    given = iter(answers)

    def handle(request):
        seen.append(request)
        answer = next(given)
        if isinstance(answer, Exception):
            raise answer
        if isinstance(answer, str):
            return httpx2.Response(200, text=answer)
        body = [OK] if answer == 200 else {"error": [{"where": "", "what": f"said {answer}"}]}
        return httpx2.Response(answer, json=body)

    return Client("http://site/", token="fga_x", transport=httpx2.MockTransport(handle), patience=5)


def test_a_posting_is_tried_again_under_the_same_request():
    seen = []
    lost = httpx2.ReadError("the connection broke")
    client = client_of([503, lost, 429, 502, 200], seen)
    assert client.post("yard", ARRIVALS[0]) == OK
    bodies = {request.content for request in seen}
    assert len(seen) == 5 and len(bodies) == 1
    (record,) = json.loads(bodies.pop())
    assert record["request"] and {k: v for k, v in record.items() if k != "request"} == ARRIVALS[0]
    assert seen[0].headers["authorization"] == "Bearer fga_x"


def test_an_epoch_is_ended_by_one_request_however_often_it_is_tried():
    seen = []
    lost = httpx2.ReadError("the connection broke")
    client = client_of([lost, 503, '{"state": "closed"}'], seen)
    assert client.close_epoch("yard") == {"state": "closed"}
    bodies = {request.content for request in seen}
    assert len(seen) == 3 and len(bodies) == 1 and json.loads(bodies.pop())["request"]


@pytest.mark.parametrize("status", [401, 403, 404, 409, 413, 422, 500])
def test_what_another_try_does_not_mend_is_told_at_once(status):
    seen = []
    with pytest.raises(InputError, match=f"said {status}"):
        client_of([status], seen).post("yard", ARRIVALS[0])
    assert len(seen) == 1


def test_a_site_that_stays_away_is_told_after_the_time_allowed(monkeypatch):
    client = client_of([httpx2.ConnectError("refused")] * 1000, [])
    client.patience = 0.05
    with pytest.raises(ServiceAway, match="refused"):
        client.post("yard", ARRIVALS[0])


def test_events_go_on_where_a_connection_broke():
    seen = []
    first = 'retry: 2000\n\nid: 7\nevent: arrival\ndata: {"a": 1}\n\nevent: beat\ndata: {}\n\n'
    second = 'id: 8\nevent: epoch\ndata: {"b":\ndata: 2}\n\nid: 9\nevent: arr'
    client = client_of([first, 503, httpx2.ConnectError("refused"), second], seen)
    events = client.events(networks=["yard"])
    assert [next(events), next(events)] == [(7, "arrival", {"a": 1}), (8, "epoch", {"b": 2})]
    assert "last-event-id" not in seen[0].headers
    assert [r.headers["last-event-id"] for r in seen[1:]] == ["7"] * 3
    assert all(r.url.params["network"] == "yard" for r in seen)
    client.close()


@pytest.mark.parametrize("url", ["site.example.org", "ftp://x", ""])
def test_what_is_no_address_is_refused(url):
    with pytest.raises(InputError, match="no address"):
        Client(url)


def test_an_outbox_keeps_order_times_and_requests_after_it_was_opened_again(tmp_path):
    outbox = Outbox(tmp_path / "out.sqlite")
    for n, record in enumerate(ARRIVALS):
        outbox.put("yard" if n < 5 else "dam", record)
    first = outbox.first(100)
    outbox.close()
    outbox = Outbox(tmp_path / "out.sqlite")
    assert outbox.first(100) == first and len(outbox) == len(ARRIVALS)
    assert [k.record["id"] for k in first] == [a["id"] for a in ARRIVALS[:5]]
    assert len({k.record["request"] for k in first}) == 5
    times = [k.record["kept"] for k in first]
    assert times == sorted(times) and times[0] > 1.7e9
    refused = {"ok": False, "error": [{"where": "", "what": "no"}]}
    outbox.done(first, [OK, refused, OK, OK, OK])
    assert [k.network for k in outbox.first(100)] == ["dam", "dam"]
    assert [(k.record["id"], a) for k, a in outbox.refused()] == [("r2", refused)]
    outbox.close()


def answering(seen):
    """Return a client of a service that takes everything; ``seen`` gets the lists."""

    def handle(request):
        seen.append(json.loads(request.content))
        return httpx2.Response(200, json=[OK] * len(seen[-1]))

    return Client("http://site/", transport=httpx2.MockTransport(handle))


def filled(outbox, number, pause):
    """Fill an outbox by and by in a thread; return what is set at the end."""
    ended = threading.Event()

    def fill():
        for n in range(number):
            outbox.put(f"net{n % 2}", {"n": n})
            time.sleep(pause)
        ended.set()
        outbox.wake()

    threading.Thread(target=fill).start()
    return ended


@pytest.mark.parametrize("name", ["out.sqlite", IN_MEMORY])
def test_readings_that_come_fast_share_requests_in_their_order(tmp_path, name):
    seen, told, begun = [], [], time.monotonic()
    outbox = Outbox(name if name == IN_MEMORY else tmp_path / name)
    ended = filled(outbox, 60, 0.01)
    number = answering(seen).forward(outbox, ended, answered=lambda k, a: told.append(k.network))
    spent = time.monotonic() - begun
    assert len(seen) <= 2 * (spent / client_module.REQUEST_SECONDS + 2)  # of two networks
    assert (number, len(outbox), len(told)) == (60, 0, 60)
    sent = [record["n"] for records in seen for record in records]
    assert sorted(sent) == list(range(60))
    assert all([n for n in sent if n % 2 == k] == list(range(k, 60, 2)) for k in (0, 1))
    assert all(("kept" in record) == outbox.on_disk for records in seen for record in records)
    outbox.close()


def test_the_first_reading_after_a_quiet_time_is_sent_at_once(monkeypatch):
    monkeypatch.setattr(client_module, "REQUEST_SECONDS", HANGS)
    seen, outbox, ended = [], Outbox(IN_MEMORY), threading.Event()
    thread = threading.Thread(target=answering(seen).forward, args=(outbox, ended))
    thread.start()
    time.sleep(0.05)
    outbox.put("yard", {"n": 0})
    until(lambda: seen)
    ended.set()
    thread.join(HANGS)
    assert not thread.is_alive()


def test_an_outbox_on_a_disk_waits_for_a_site_that_is_away(tmp_path):
    seen, away, ended = [], httpx2.ConnectError("refused"), threading.Event()
    client, outbox = client_of([away, 503, away, 200, away], seen), Outbox(tmp_path / "out.sqlite")
    client.patience = 0.0
    outbox.put("yard", ARRIVALS[0])
    told = client.forward(outbox, ended, answered=lambda kept, answer: ended.set())
    assert (told, len(seen), len(outbox)) == (1, 4, 0)
    outbox.put("yard", ARRIVALS[1])
    with pytest.raises(ServiceAway, match="refused"):  # nothing more comes
        client.forward(outbox, ended)
    assert len(outbox) == 1
    outbox.close()


def test_an_outbox_in_memory_does_not_wait_for_longer_than_its_client():
    client, outbox = client_of([httpx2.ConnectError("refused")], []), Outbox(IN_MEMORY)
    client.patience = 0.0
    outbox.put("yard", ARRIVALS[0])
    with pytest.raises(ServiceAway, match="refused"):
        client.forward(outbox, threading.Event())
    outbox.close()


def test_a_file_that_is_no_outbox_is_refused(tmp_path):
    (tmp_path / "x").write_text("name,x,y\n" * 100)
    with pytest.raises(InputError, match="outbox"):
        Outbox(tmp_path / "x")


@pytest.fixture(scope="module")
def served_yard(tmp_path_factory):
    site = SiteProcess(yard_site(tmp_path_factory.mktemp("site")))
    site.start()
    yield site
    site.stop()


def sent(site, *arguments, lines=()):
    """Run the command ``send``; return its exit code, answers and messages."""
    text = "".join(line if isinstance(line, str) else json.dumps(line) + "\n" for line in lines)
    done = subprocess.run(
        [sys.executable, "-m", "factorgraph_adj", "send", site.url, *arguments],
        input=text,
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=HANGS,
    )
    answers = [json.loads(line) for line in io.StringIO(done.stdout)]
    return done.returncode, answers, done.stderr


def test_what_is_sent_is_on_the_site(served_yard, tmp_path):
    """Lines of a file, a posting of the client, what was kept during an outage: all are there."""
    path, outbox = tmp_path / "lines.jsonl", str(tmp_path / "out.sqlite")
    path.write_text("".join(json.dumps(a) + "\n" for a in ARRIVALS[:4]))
    code, answers, told = sent(served_yard, "yard", str(path))
    assert (code, told) == (0, "4 lines sent, 0 refused\n")
    assert all(a["ok"] for a in answers) and len(answers) == 4
    away = SiteProcess(tmp_path, port=9)  # where nobody listens
    kept = ["--outbox", outbox, "--patience", "0.5"]
    code, answers, told = sent(away, "yard", *kept, lines=ARRIVALS[4:6])
    assert code == 1 and not answers and "2 postings kept in" in told
    code, answers, told = sent(served_yard, "yard", *kept, lines=[ARRIVALS[6]])
    assert code == 0 and len(answers) == 3
    nowhere = {**WRONG, "id": "n", "target": "NOWHERE"}
    code, answers, _ = sent(served_yard, "yard", "--quiet", *kept, lines=[WRONG, nowhere])
    assert code == 1 and [a["ok"] for a in answers] == [False]
    with fga.site.Client(served_yard.url) as client:
        assert client.site()["name"] == "Yard" and client.network("yard")["points"] == 3
        there = {o["id"] for o in client.observations("yard")}
        assert there == {a["id"] for a in ARRIVALS}
        assert [o["id"] for o in client.observations("yard", state="rejected")] == ["s3"]
        assert {p["name"] for p in client.points("yard") if p["determined"]} >= {"C"}
        arrivals = [e for e, _ in zip(client.events(after=0), range(8), strict=False)]
        assert [e.kind for e in arrivals].count("arrival") == 8
        client.download("yard", "results.json", tmp_path / "results.json")
        assert json.loads((tmp_path / "results.json").read_text())
        assert client.close_epoch("yard")["state"] == "closed"
        assert client.epoch("yard", client.epochs("yard")[0]["number"])["points"]


@pytest.mark.parametrize(
    ("network", "line", "message"),
    [
        ("yard", "no json\n", "standard input:1: is no JSON"),
        ("yard", "[1]\n", "standard input:1: is no JSON object"),
        ("dam", ARRIVALS[0], "no network 'dam'"),
    ],
)
def test_what_cannot_be_sent_is_told(served_yard, network, line, message):
    code, answers, told = sent(served_yard, network, lines=[line])
    assert code == 2 and not answers and message in told
    assert told.startswith("nothing was acknowledged by the site\n")


def test_a_site_that_is_not_there_has_got_nothing(tmp_path):
    away = SiteProcess(tmp_path, port=9)  # where nobody listens
    code, answers, told = sent(away, "yard", "--patience", "0.1", lines=ARRIVALS[:2])
    assert code == 2 and not answers and "does not answer" in told
    assert told.startswith("nothing was acknowledged by the site\n")


def test_lines_before_a_faulty_one_are_sent(served_yard, tmp_path):
    lines = [json.dumps({**ARRIVALS[0], "id": f"f{n}"}) + "\n" for n in range(3)]
    path = tmp_path / "lines.jsonl"
    bad = '{"do": "retract"}\n'
    path.write_text("".join([lines[0], "\n", lines[1], bad, "no json\n", lines[2]]))
    code, answers, told = sent(served_yard, "yard", str(path))
    assert code == 2 and [a.get("id") for a in answers] == ["f0", "f1", None]
    assert told.startswith("3 postings sent, 1 refused\n")
    assert f"{path}:5: is no JSON" in told


def test_a_line_without_an_end_is_sent_as_others(served_yard):
    line = json.dumps({**ARRIVALS[0], "id": "last", "remark": "x" * 200_000})
    code, answers, _ = sent(served_yard, "yard", lines=[line])
    assert code == 0 and [a["id"] for a in answers] == ["last"]
