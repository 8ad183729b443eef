"""Late readings of an early epoch, after many: the others are compared again between postings."""

from __future__ import annotations

import pytest
from sqlalchemy import delete

from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.monitor import Monitor
from factorgraph_adj.site import epoch_revision, surveillance
from factorgraph_adj.site.surveillance import COMPARED_LATER
from factorgraph_adj.site.tables import monitors
from tests.support.sites import ALARM, readings, site_of, until, yard_of

pytestmark = pytest.mark.usefixtures("store")
LAST = 9
"""Number of epochs, of which the last one is open."""


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Three epochs are many, and a step has two."""
    monkeypatch.setattr(surveillance, "EPOCHS_AT_ONCE", 3)
    monkeypatch.setattr(epoch_revision, "EPOCHS_OF_STEP", 2)


def play(live, *hours, risen=(), seed=0):
    for hour in hours:
        for record in readings(hour, 0.01 if hour in risen else 0.0, seed):
            assert live.submit(record).result(30)["ok"]


def findings(live):
    rows = [r for r in live.epochs(results=True) if r["result"] and r["number"]]
    return {
        r["number"]: {k: v for k, v in r["result"]["findings"].items() if k != "revised"}
        for r in rows
    }


def revised(live):
    rows = [r for r in live.epochs(results=True) if r["result"] and r["number"]]
    return {r["number"]: r["result"]["findings"].get("revised") for r in rows}


def all_in_time(folder, risen=(), last=LAST):
    """Return findings and alarms of a site to which all readings came in time."""
    folder.mkdir()
    with site_of(folder, epochs="1 h", more=ALARM) as site:
        play(yard_of(site), *range(last), risen=risen)
        return findings(yard_of(site)), site.alarms.listed(state="all")


def same(found, expected):
    for number in expected:
        for what in ("problem", "against", "displacements", "motions", "tests", "congruence"):
            assert found[number][what] == expected[number][what], (number, what)


def held_up(live, monkeypatch):
    """Let the thread of a network make no step of a revision, until the context ends."""
    monkeypatch.setattr("factorgraph_adj.site.live_network.revise_some", lambda *_: None)


def test_late_readings_change_later_epochs_between_postings(tmp_path, monkeypatch):
    expected, alarms = all_in_time(tmp_path / "timely", risen=(4, 5))
    late = tmp_path / "late"
    late.mkdir()
    with site_of(late, epochs="1 h", more=ALARM) as site:
        live = yard_of(site)
        play(live, *(h for h in range(LAST - 1) if h != 2), risen=(4, 5))
        with monkeypatch.context() as context:
            held_up(live, context)
            play(live, 2)
            until(lambda: live.surveillance.revise_from == 3)
            assert findings(live)[3]["problem"] == COMPARED_LATER
            play(live, LAST - 1)  # others are answered, and an epoch ends
            until(lambda: LAST - 1 in findings(live))
            assert findings(live)[LAST - 1]["displacements"]
        live.close_stale()
        same(findings(live), expected)
        marks = revised(live)
        assert [marks[n] for n in (1, 2, 3)] == [None] * 3
        assert {marks[n] for n in range(5, LAST)} == {3}
        assert live.surveillance.revise_from is None
        told = [e.data["epoch"] for e in site.events.after(0) if e.data.get("what") == "revised"]
        assert told == [n for n in range(3, LAST) if n == 3 or marks[n] == 3]
        mine = site.alarms.listed(state="all")
        names = ("rule", "points", "since", "until", "state", "epoch")
        assert [[a[n] for n in names] for a in mine] == [[a[n] for n in names] for a in alarms]
        play(live, LAST)
        live.close_stale()
        assert findings(live)[LAST]["displacements"] and revised(live)[LAST] is None


def test_a_revision_begins_again_after_a_restart_and_after_further_late_readings(
    tmp_path, monkeypatch
):
    expected, _ = all_in_time(tmp_path / "timely")
    late = tmp_path / "late"
    late.mkdir()
    with site_of(late, epochs="1 h", more=ALARM) as site:
        live = yard_of(site)
        play(live, *(h for h in range(LAST) if h not in (2, 4)))
        with monkeypatch.context() as context:
            held_up(live, context)
            play(live, 4)
            until(lambda: live.surveillance.revise_from == 5)
            live.stop()
    with site_of(late) as site:
        live = yard_of(site)
        until(lambda: live.surveillance.revise_from is None)
        assert all(f["problem"] != COMPARED_LATER for f in findings(live).values())
        assert revised(live)[7] == 5
        play(live, 2)
        live.close_stale()
        same(findings(live), expected)
        assert revised(live)[7] == 3


def test_an_epoch_waits_where_many_must_be_compared_before_it(tmp_path):
    """There is no state: settings were changed, or the database is older."""
    expected, _ = all_in_time(tmp_path / "timely", last=LAST + 2)
    other = tmp_path / "other"
    other.mkdir()
    with site_of(other, epochs="1 h", more=ALARM) as site:
        play(yard_of(site), *range(LAST))
        with site.database.writing() as connection:
            connection.execute(delete(monitors))
    with site_of(other) as site:
        live = yard_of(site)
        play(live, LAST)
        live.close_stale()
        play(live, LAST + 1)
        live.close_stale()
        same(findings(live), expected)
        assert set(revised(live).values()) == {None}


def test_late_readings_of_the_last_epoch_replay_no_other(tmp_path, monkeypatch):
    expected, _ = all_in_time(tmp_path / "timely")
    late = tmp_path / "late"
    late.mkdir()
    with site_of(late, epochs="1 h", more=ALARM) as site:
        live = yard_of(site)
        play(live, *range(LAST - 2))
        some = readings(LAST - 2)
        for record in (*some[:-1], *readings(LAST - 1)):
            assert live.submit(record).result(30)["ok"]
        given, add = [], Monitor.add
        monkeypatch.setattr(Monitor, "add", lambda m, e: given.append(e.number) or add(m, e))
        assert live.submit(some[-1]).result(30)["ok"]
        live.close_stale()
        assert given == [LAST - 1]
        of = live.epochs(results=True)[LAST - 1]
        assert of["revision"] == 2 and of["result"]["counts"]["observations"] == len(some)
        found = findings(live)
        for name in ("T", "dz_mm"):
            (mine,), (other,) = (
                [d[name] for d in f[LAST - 1]["displacements"] if d["name"] == "C"]
                for f in (found, expected)
            )
            assert mine == pytest.approx(other, rel=1e-6, abs=1e-6)


def test_a_revision_that_fails_is_told(tmp_path, monkeypatch):
    def refused(*_):
        raise InputError("no monitor today")

    with site_of(tmp_path, epochs="1 h", more=ALARM) as site:
        live = yard_of(site)
        play(live, *(h for h in range(LAST) if h != 2))
        with monkeypatch.context() as broken:
            broken.setattr(Monitor, "add", refused)
            play(live, 2)
            live.close_stale()
        assert findings(live)[3]["problem"] == "no monitor today"
        assert live.surveillance.revise_from is None
        play(live, LAST)
        live.close_stale()
        assert findings(live)[LAST]["displacements"]
