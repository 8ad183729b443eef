"""A network of a site: requests are executed once, epochs follow the time, nothing is lost."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import event, func, select

from factorgraph_adj.errors import InputError
from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
from factorgraph_adj.service import requests as requests_of_lines
from factorgraph_adj.service.answers import Answers
from factorgraph_adj.service.stream import Stream
from factorgraph_adj.site.database import DatabaseAway
from factorgraph_adj.site.tables import epochs, journal, requests
from tests.networks.yard import ARRIVALS, WRONG
from tests.support.sites import readings, site_of, until, yard_of, yard_site

pytestmark = pytest.mark.usefixtures("store")
HOUR = 3600.0
BARE = [{k: v for k, v in a.items() if k != "id"} for a in ARRIVALS]
"""The readings of the yard without ids of their own, so that they may come again."""
BROKEN = "h1"
"""Id of a reading with which the program fails in a test."""
BEGIN = 1_700_000_000.0 - 1_700_000_000.0 % HOUR


def posted(live, *records):
    return [f.result(30) for f in [live.submit(r) for r in records]]


def test_what_was_acknowledged_is_there_after_a_restart(tmp_path):
    with site_of(tmp_path) as site:
        answers = posted(yard_of(site), *ARRIVALS)
        assert all(a["ok"] for a in answers), answers
        with yard_of(site).reading() as epoch:
            before = epoch.stream.adjustment.estimate("C")
    with site_of(tmp_path) as site, yard_of(site).reading() as epoch:
        inc = epoch.stream.adjustment
        assert len(inc) == len(ARRIVALS)
        sigma = inc.standard_deviations("C")
        assert np.all(np.abs(inc.estimate("C") - before) < 0.02 * sigma)


def test_a_request_is_executed_once_and_answered_again(tmp_path):
    requested = [{**a, "request": f"r{n}"} for n, a in enumerate(ARRIVALS)]
    with site_of(tmp_path) as site:
        first = posted(yard_of(site), *requested, *requested[:2])
        assert [a.get("repeated", False) for a in first] == [False] * len(ARRIVALS) + [True] * 2
    with site_of(tmp_path) as site:
        live = yard_of(site)
        again = posted(live, *requested)
        assert all(a["repeated"] for a in again)
        assert [a["verdict"] for a in again] == [a["verdict"] for a in first[: len(ARRIVALS)]]
        (other,) = posted(live, {**WRONG, "request": "r0"})
        assert not other["ok"] and other["conflict"]
        with live.reading() as epoch:
            assert len(epoch.stream.adjustment) == len(ARRIVALS)


def lots(monkeypatch):
    """Return a list that takes how many readings arrived together each time."""
    together, of_stream = [], Stream.answer_together

    def counted(self, records, *rest, **options):
        together.append(len(records))
        return of_stream(self, records, *rest, **options)

    monkeypatch.setattr(Stream, "answer_together", counted)
    return together


def submitted(live, *records):
    """Post records while the network's thread is held up: they wait together."""
    with live.reading():
        live.submit({"do": "waiting"})  # the thread waits for the lock with this one
        until(lambda: not live.waiting_postings)
        futures = [live.submit(r) for r in records]
    return [f.result(30) for f in futures]


def test_readings_that_wait_together_arrive_together(tmp_path, monkeypatch):
    together = lots(monkeypatch)
    requested = [{**a, "request": f"r{n}"} for n, a in enumerate(BARE)]
    bad = {**BARE[0], "target": "NOWHERE", "request": "bad"}
    other = {**WRONG, "request": "r0"}
    with site_of(tmp_path) as site:
        live = yard_of(site)
        question = {"do": "estimate", "point": "C"}
        given = [*requested, requested[1], other, question, BARE[0]]
        answers = submitted(live, *given)
        n = len(ARRIVALS)
        assert together == [n, 1], "a repetition, another content and a question are no readings"
        assert all(a["verdict"] == "accepted" for a in answers[:n])
        assert len({a["id"] for a in answers[:n]}) == n
        assert answers[n]["repeated"] and answers[n]["id"] == answers[1]["id"]
        assert answers[n + 1]["conflict"]
        assert answers[n + 2]["name"] == "C"
        assert answers[n + 3]["counts"]["observations"] == n + 1
        with live.reading() as epoch:
            assert len(epoch.stream.adjustment) == n + 1
            estimate = epoch.stream.adjustment.estimate("C")
            sigma = epoch.stream.adjustment.standard_deviations("C")
        # A faulty one refuses itself alone.
        good = [{**a, "request": f"s{k}"} for k, a in enumerate(BARE)]
        answers = submitted(live, good[0], bad, *good[1:])
        assert [a["ok"] for a in answers] == [True, False] + [True] * (n - 1)
        assert "NOWHERE" in str(answers[1]["error"])
        events = [e.data for e in site.events.after(0) if e.kind == "arrival"]
        assert [e["id"] for e in events] == list(dict.fromkeys(e["id"] for e in events))
        assert len(events) == 2 * n + 1
    alone = tmp_path / "alone"
    alone.mkdir()
    with site_of(alone) as site:
        for record in [*requested, BARE[0]]:
            posted(yard_of(site), record)
        with yard_of(site).reading() as epoch:
            assert np.all(np.abs(epoch.stream.adjustment.estimate("C") - estimate) < 0.02 * sigma)


def test_a_wrong_reading_among_those_that_wait_is_the_one_that_is_rejected(tmp_path, monkeypatch):
    together = lots(monkeypatch)
    with site_of(tmp_path) as site:
        answers = submitted(yard_of(site), *BARE, WRONG, *BARE)
    assert together == [2 * len(ARRIVALS) + 1]
    verdicts = [a["verdict"] for a in answers]
    assert verdicts == ["accepted"] * len(ARRIVALS) + ["rejected"] + ["accepted"] * len(ARRIVALS)


def test_a_fault_with_one_of_those_that_wait_does_not_refuse_the_others(tmp_path, monkeypatch):
    """A fault of the program, too, and nothing enters twice."""
    add = IncrementalAdjustment.add

    def failing(self, given=(), **options):
        if any(o.source == "bad" for o in given):
            raise ZeroDivisionError
        return add(self, given, **options)

    of_record = requests_of_lines.observation_of_record

    def marked(fields, context):
        found = of_record(fields, context)
        return replace(found, source="bad") if fields["id"] == BROKEN else found

    monkeypatch.setattr(IncrementalAdjustment, "add", failing)
    monkeypatch.setattr(requests_of_lines, "observation_of_record", marked)
    with site_of(tmp_path) as site:
        answers = submitted(yard_of(site), *ARRIVALS)
        assert [a["ok"] for a in answers] == [a["id"] != BROKEN for a in ARRIVALS]
        with yard_of(site).reading() as epoch:
            assert len(epoch.stream.adjustment) == len(ARRIVALS) - 1


@pytest.mark.parametrize("number", [1, len(ARRIVALS)])
def test_readings_whose_answer_fails_have_not_entered(tmp_path, monkeypatch, number):
    """They are not called refused while they are in; they come again, and enter once."""

    def failing(*_):
        raise InputError("no answer")

    with site_of(tmp_path) as site:
        live = yard_of(site)
        with monkeypatch.context() as broken, pytest.raises(RuntimeError, match="has changed"):
            broken.setattr(Answers, "arrivals", failing)
            submitted(live, *ARRIVALS[:number])
        answers = submitted(live, *ARRIVALS)
        assert answers[-1]["counts"]["observations"] == len(ARRIVALS)


def test_readings_of_two_epochs_do_not_arrive_together(tmp_path, monkeypatch):
    together = lots(monkeypatch)
    first, second = readings(0), readings(1)
    with site_of(tmp_path, epochs="1 h") as site:
        answers = submitted(yard_of(site), *first, *second)
    assert together == [len(first), len(second)]
    assert [a["epoch"] for a in answers] == [1] * len(first) + [2] * len(second)


def test_a_refused_posting_may_come_again_under_the_same_request(tmp_path):
    with site_of(tmp_path) as site:
        bad, good = posted(
            yard_of(site),
            {**ARRIVALS[0], "target": "NOWHERE", "request": "r"},
            {**ARRIVALS[0], "request": "r"},
        )
        assert not bad["ok"] and good["ok"] and "repeated" not in good


@pytest.mark.parametrize(
    ("record", "where"),
    [
        ({"do": "write", "project": "x"}, "do"),
        ({"do": "stop"}, "do"),
        ({**ARRIVALS[0], "time": "noon"}, "time"),
        ({**ARRIVALS[0], "time": -1}, "time"),
        ({**ARRIVALS[0], "time": 9e10}, "time"),
        ({**ARRIVALS[0], "request": ""}, "request"),
        ({**ARRIVALS[0], "request": "x" * 201}, "request"),
    ],
)
def test_what_a_posting_must_not_say_is_refused(tmp_path, record, where):
    with site_of(tmp_path) as site:
        (answer,) = posted(yard_of(site), record)
        assert not answer["ok"] and answer["error"][0]["where"] == where


def test_epochs_follow_the_time_of_the_readings(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        for hour in range(3):  # an epoch stays open for late readings for a tenth of its length
            posted(live, *({**a, "time": BEGIN + hour * HOUR + 1800.0} for a in ARRIVALS))
        rows = live.epochs(results=True)
        assert [r["number"] for r in rows] == [0, 1, 2, 3]
        assert [r["state"] for r in rows] == ["closed", "closed", "closed", "open"]
        assert [r["begin"] for r in rows[1:]] == [BEGIN + h * HOUR for h in range(3)]
        assert [r["revision"] for r in rows] == [1, 1, 1, 0]
        c = {p["name"]: p for p in rows[1]["result"]["points"]}["C"]
        assert abs(c["z"] - 101.4996) < 1e-3


def test_the_clock_of_a_network_goes_on_after_a_restart(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        posted(yard_of(site), *({**a, "time": BEGIN + 1800.0} for a in ARRIVALS[:4]))
        before = yard_of(site).clock.now()
    with site_of(tmp_path, epochs="1 h") as site:
        assert 0.0 <= yard_of(site).clock.now() - before < 600.0
    with site_of(tmp_path, epochs="1 h") as site:  # ended by the clock of the machine long ago
        live = yard_of(site)
        posted(live, *({**a, "time": BEGIN + 1860.0} for a in ARRIVALS[4:]))
        posted(live, {**ARRIVALS[0], "time": BEGIN + 1.5 * HOUR})
        rows = live.epochs(results=True)
        assert [(r["state"], r["revision"]) for r in rows[1:]] == [("closed", 1), ("open", 0)]
        assert rows[1]["result"]["counts"]["observations"] == len(ARRIVALS)


def test_a_late_reading_opens_its_epoch_again(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        posted(live, *({**a, "time": BEGIN + 60.0} for a in ARRIVALS))
        posted(live, {**ARRIVALS[0], "time": BEGIN + 2 * HOUR})
        assert live.epochs()[1]["revision"] == 1
        late = {"kind": "height_difference", "station": "A", "target": "C", "value": 1.4999}
        (answer,) = posted(live, {**late, "time": BEGIN + 120.0})
        assert answer["ok"] and answer["epoch"] == 1
        live.stop()
        rows = live.epochs(results=True)
        assert [(r["number"], r["state"], r["revision"]) for r in rows] == [
            *((0, "closed", 1), (1, "closed", 2), (3, "open", 0)),
        ]
        assert rows[1]["result"]["counts"]["observations"] == len(ARRIVALS) + 1
        with live.reading(1) as epoch:
            assert len(epoch.stream.adjustment) == len(ARRIVALS) + 1


def wrong_first(live):
    """Post a wrong distance to C, and then correct ones, one after the other; return an answer."""
    wrong = {**BARE[3], "value": BARE[3]["value"] + 0.2, "id": "wrong"}
    for record in (*BARE[:3], wrong, *[BARE[3]] * 4):
        (answer,) = posted(live, {**record, "time": BEGIN + 60.0})
    return answer


def test_an_epoch_that_ends_gets_back_what_a_wrong_first_reading_let_be_rejected(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        assert wrong_first(live)["verdict"] == "rejected"
        result = live.close_epoch().result(30)["result"]
        assert not result["doubts"] and result["counts"]["rejected"] == 1
        with live.reading(1) as epoch:
            inc = epoch.stream.adjustment
            assert [v.id for v in inc.rejected] == ["wrong"]
            estimate = inc.estimate("C")
        events = site.events.after(0)
        told = [e.data for e in events if e.kind == "arrival" and e.data["by"] == "site"]
        assert [t["do"] for t in told] == ["accept", "snoop"] and len(told[0]["ids"]) == 4
    with site_of(tmp_path, epochs="1 h") as site, yard_of(site).reading(1) as epoch:
        again = epoch.stream.adjustment
        assert [v.id for v in again.rejected] == ["wrong"]
        assert np.allclose(again.estimate("C"), estimate, rtol=0.0, atol=1e-6)


def test_a_search_at_the_end_of_an_epoch_that_fails_is_told(tmp_path, monkeypatch):
    def failing(*_, **__):
        raise InputError("no search today")

    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        wrong_first(live)
        monkeypatch.setattr(IncrementalAdjustment, "snoop", failing)
        assert live.close_epoch().result(30)["ok"]
        told = [e for e in site.events.after(0) if e.data.get("by") == "site"]
        assert [e.kind for e in told] == ["arrival", "refused"]
        assert told[1].data["answer"]["error"][0]["what"] == "no search today"


def test_what_people_have_accepted_is_not_searched_again(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        at = {"time": BEGIN + 60.0}
        wrong_first(live)
        (out,) = posted(live, {**BARE[4], **at, "value": BARE[4]["value"] + 0.3})
        assert out["verdict"] == "rejected"
        (answer,) = posted(live, {"do": "accept", "ids": [out["id"]], **at})
        assert answer["ok"]
        result = live.close_epoch().result(30)["result"]
        (doubt,) = result["doubts"]
        assert "readings of C were rejected: one that came before" in doubt
        assert result["counts"]["doubts"] == 1


def test_an_epoch_in_which_a_point_has_moved_keeps_its_doubt(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        posted(live, *({**a, "time": BEGIN + 60.0} for a in BARE[:3]))
        for further in (0.0, 0.0, 0.0, 0.2, 0.2, 0.2):
            value = BARE[3]["value"] + further
            posted(live, {**BARE[3], "value": value, "time": BEGIN + 90.0})
        result = live.close_epoch().result(30)["result"]
        assert any("it may have moved within the epoch" in d for d in result["doubts"]), result


def test_late_readings_of_an_epoch_are_taken_though_sets_are_retired(tmp_path):
    """Two instruments whose readings come in turn, one of them half an hour late."""
    site_file = yard_site(tmp_path, epochs="1 h") / "site.toml"
    text = site_file.read_text()
    site_file.write_text(text.replace("objects", "keep_seconds = 600\nobjects", 1))
    number, each = 10, 120.0
    for begin in (0, number // 2):
        with site_of(tmp_path) as site:
            live = yard_of(site)
            for n in range(begin, begin + number // 2):
                on_time = readings(0, seed=n)
                late = [r for r in readings(0, seed=100 + n) if r["kind"] != "direction"]
                given = [{**r, "time": r["time"] + each * n + 1200.0} for r in on_time]
                given += [{**r, "time": r["time"] + each * n - 600.0} for r in late]
                directions = [{**r, "set": str(n)} for r in given if r["kind"] == "direction"]
                others = [r for r in given if r["kind"] != "direction"]
                answers = posted(live, *directions, *others)
                assert all(a["ok"] for a in answers), answers
            with live.reading() as epoch:
                inc = epoch.stream.adjustment
                assert (inc.retired is None) == (begin == 0)
    assert len(inc.network().observations) + len(inc.rejected) == number * (8 + 6)


def test_a_transaction_that_fails_changes_nothing(tmp_path):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        posted(live, *ARRIVALS[:3])

        def full(connection, cursor, statement, *rest):
            if statement.startswith("INSERT INTO journal"):
                driver = site.database.engine.dialect.loaded_dbapi
                raise driver.OperationalError("database or disk is full")

        event.listen(site.database.engine, "before_cursor_execute", full)
        failed = live.submit(ARRIVALS[3])
        with pytest.raises(DatabaseAway, match="full"):
            failed.result(30)
        assert site.health()["database"]
        event.remove(site.database.engine, "before_cursor_execute", full)
        (answer,) = posted(live, ARRIVALS[3])
        assert answer["ok"] and answer["counts"]["observations"] == 4
        assert site.health()["ok"]


def test_a_fault_of_the_program_leaves_no_lines_behind(tmp_path, monkeypatch):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        posted(live, *ARRIVALS[:3])
        with monkeypatch.context() as broken:
            broken.setattr(live, "_close_what_ended", lambda *_, **__: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                live.submit(ARRIVALS[3]).result(30)
        (answer,) = posted(live, ARRIVALS[3])
        assert answer["ok"] and answer["counts"]["observations"] == 4


def test_a_changed_line_is_found(tmp_path):
    with site_of(tmp_path) as site:
        for arrival in ARRIVALS:
            posted(yard_of(site), arrival)
        with site.database.writing() as connection:
            line = connection.execute(select(journal.c.text).where(journal.c.line == 3)).scalar()
            changed = journal.update().where(journal.c.line == 3)
            connection.execute(changed.values(text=line.replace('"do"', '"dO"')))
    with pytest.raises(InputError, match="was changed"), site_of(tmp_path):
        pass


def test_events_tell_what_happened_in_order(tmp_path):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        posted(live, *ARRIVALS, {**ARRIVALS[0], "target": "NOWHERE"})
        live.close_epoch().result(30)
        found = site.events.after(0)
        assert [e.kind for e in found] == ["arrival"] * len(ARRIVALS) + ["refused", "epoch"]
        assert [e.id for e in found] == sorted(e.id for e in found)
        with site.database.reading() as connection:
            assert connection.execute(select(func.count()).select_from(requests)).scalar() == 0
            (summary,) = connection.execute(select(epochs.c.summary)).scalars()
            assert json.loads(summary)["converged"]


def test_a_refused_posting_and_a_question_begin_no_epoch(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        refused, asked = posted(
            live,
            {**ARRIVALS[0], "target": "NOWHERE", "time": BEGIN},
            {"do": "doubts", "time": BEGIN + HOUR},
        )
        assert not refused["ok"] and asked["ok"]
        assert [r["number"] for r in live.epochs()] == [0]
        posted(live, {**ARRIVALS[0], "time": BEGIN})
        assert [r["number"] for r in live.epochs()] == [0, 1]
