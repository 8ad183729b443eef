"""Postings of instruments, ``add`` with observations alone, arrive together as readings do."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.service.stream import Stream
from factorgraph_adj.site import postings
from tests.networks.yard import ARRIVALS, WRONG
from tests.support.sites import BEGIN, site_of, until, yard_of

BARE = [{k: v for k, v in a.items() if k != "id"} for a in ARRIVALS]
pytestmark = pytest.mark.usefixtures("store")


def added(*records, **more):
    return {"do": "add", "observations": list(records), "time": BEGIN + 60.0, **more}


def measured(number, instrument="ts1"):
    return {
        "instrument": instrument,
        "begin": BEGIN + 10.0 * number,
        "end": BEGIN + 10.0 * number + 9,
    }


@pytest.fixture
def together(monkeypatch):
    """List of how many lines arrived together each time."""
    numbers, of_stream = [], Stream.answer_together

    def counted(self, records, *rest, **options):
        numbers.append(len(records))
        return of_stream(self, records, *rest, **options)

    monkeypatch.setattr(Stream, "answer_together", counted)
    return numbers


def submitted(live, *records):
    """Post records while the network's thread is held up: they wait together."""
    with live.reading():
        live.submit({"do": "waiting"})
        until(lambda: not live.waiting_postings)
        futures = [live.submit(r, "ts1") for r in records]
    return [f.result(30) for f in futures]


SETS = [
    added(*BARE[:3], measured=measured(0), request="s0", remark="faces differ"),
    added(BARE[3], measured=measured(1), request="s1"),
    {**BARE[4], "time": BEGIN + 60.0},
    added(*BARE[5:], measured=measured(2), request="s2"),
]


def test_sets_that_wait_arrive_together_with_readings_and_are_answered_as_before(
    tmp_path, together
):
    alone, lot = tmp_path / "alone", tmp_path / "lot"
    for folder in (alone, lot):
        folder.mkdir()
    with site_of(alone) as site:
        live = yard_of(site)
        expected = [live.submit(r).result(30) for r in SETS]
        with live.reading() as epoch:
            estimate = epoch.stream.adjustment.estimate("C")
            sigma = epoch.stream.adjustment.standard_deviations("C")
    assert together == [1] * len(SETS)
    together.clear()
    with site_of(lot) as site:
        live = yard_of(site)
        answers = submitted(live, *SETS)
        assert together == [len(SETS)]
        events = [e.data for e in site.events.after(0) if e.kind == "arrival"]
        assert len(events) == len(SETS) and {e["do"] for e in events} == {"add"}
        again = submitted(live, *SETS)
        assert [a.get("repeated", False) for a in again] == [True, True, False, True]
        with live.reading() as epoch:
            assert np.all(np.abs(epoch.stream.adjustment.estimate("C") - estimate) < 0.3 * sigma)
    for mine, other in zip(answers, expected, strict=True):
        assert mine["ok"] and mine.keys() == other.keys()
        kinds = [[v["kind"] for v in a.get("verdicts", [a])] for a in (mine, other)]
        assert kinds[0] == kinds[1]
        assert all(v["verdict"] == "accepted" for v in mine.get("verdicts", [mine]))
    assert answers[-1]["counts"]["observations"] == len(ARRIVALS)


def test_sets_that_exclude_each_other_do_not_arrive_together(tmp_path, together):
    """Of two that overlap the first one enters; where it is refused, the second one does."""
    first = added(BARE[0], measured=measured(0))
    second = added(BARE[1], measured={**measured(0), "end": BEGIN + 5.0})
    other = added(BARE[2], measured=measured(0, "ts2"))
    wrong = added({**BARE[0], "target": "NOWHERE"}, measured=measured(5))
    right = added(BARE[0], measured={**measured(5), "end": BEGIN + 52.0})
    with site_of(tmp_path) as site:
        answers = submitted(yard_of(site), first, other, second, wrong, right)
        assert [a["ok"] for a in answers] == [True, True, False, False, True]
        assert "cannot have measured" in answers[2]["error"][0]["what"]
        assert "NOWHERE" in str(answers[3]["error"])
        refused = [e.data["by"] for e in site.events.after(0) if e.kind == "refused"]
        assert refused == ["ts1", "ts1"]


def test_what_adds_more_than_observations_arrives_alone(tmp_path, together):
    point = {"name": "D", "x": 10.0, "y": 10.0, "z": 100.0}
    with site_of(tmp_path) as site:
        answers = submitted(
            yard_of(site), added(BARE[0]), added(BARE[1], points=[point]), added(BARE[2]), added()
        )
        assert [a["ok"] for a in answers] == [True, True, True, False]
    assert together == [1, 1]


def test_large_sets_do_not_make_an_arrival_that_lacks_its_gains(tmp_path, together, monkeypatch):
    monkeypatch.setattr(postings, "MAX_READINGS_OF_LOT", 5)
    with site_of(tmp_path) as site:
        sets = [added(*BARE[:3]), added(*BARE[3:5]), added(*BARE), added(WRONG)]
        answers = submitted(yard_of(site), *sets)
        assert together == [2, 1, 1]
        assert [v["verdict"] for v in answers[3]["verdicts"]] == ["rejected"]
