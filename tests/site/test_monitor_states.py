"""A service that begins again goes on from the state of its monitor, and finds the same."""

from __future__ import annotations

import json

import pytest
from sqlalchemy import delete, event, select

from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.monitor import Monitor
from factorgraph_adj.report.layout import finite_json
from factorgraph_adj.site.database import DatabaseAway
from factorgraph_adj.site.surveillance import Surveillance
from factorgraph_adj.site.tables import monitors
from tests.support.sites import ALARM, readings, site_of, yard_of, yard_site

pytestmark = pytest.mark.usefixtures("store")
RISEN = (4, 5, 6)
MORE = ALARM + ALARM.partition("[smtp]")[0].replace('"wall"', '"drift"\ntest = "cusum"')


def play(site, *hours):
    live = yard_of(site)
    for hour in hours:
        for record in readings(hour, 0.01 if hour in RISEN else 0.0):
            assert live.submit(record).result(30)["ok"]
    return live


def findings(live):
    return {r["number"]: r["result"]["findings"] for r in live.epochs(results=True) if r["result"]}


@pytest.fixture
def added(monkeypatch):
    """List of the numbers of the epochs that monitors are given."""
    numbers, add = [], Monitor.add

    def noted(self, epoch):
        numbers.append(epoch.number)
        return add(self, epoch)

    monkeypatch.setattr(Monitor, "add", noted)
    return numbers


def replayed(site, live):
    """Return the findings of a monitor that is given all epochs at once, as they are recorded."""
    rows = live.epochs(results=True)
    last = next(r for r in reversed(rows) if r["result"])
    survey = Surveillance(live.settings, site.settings.alarms, lambda digest: None)
    with live.reading(last["number"]) as epoch:
        found = survey.findings(lambda: rows, epoch, last["result"])
    return {n: json.loads(json.dumps(finite_json(survey.shown(f)))) for n, f in found.items()}


def test_restarts_change_no_result_and_replay_no_epoch(tmp_path, added):
    for hour in range(9):
        with site_of(tmp_path, epochs="1 h", more=MORE) as site:
            live = play(site, hour)
            assert live.surveillance.against == (None if hour == 0 else 1)
    # The second epoch, which says whether the first one is whole, alone makes the monitor anew.
    assert added == [1, *range(1, 9)]
    with site_of(tmp_path) as site:
        live = yard_of(site)
        assert live.surveillance.against == 1, "the reference is known before an epoch ends"
        found = findings(live)
        expected = replayed(site, live)
        assert [n for n in found if n > 0] == list(expected) == [*range(1, 9)]
        assert {n: found[n] for n in expected if n > 1} == {n: expected[n] for n in found if n > 1}
        assert {a["rule"] for a in site.alarms.listed(state="all")} == {"wall", "drift"}


@pytest.mark.parametrize("change", ["settings", "older database"])
def test_epochs_are_replayed_once_where_there_is_no_state(tmp_path, added, change):
    with site_of(tmp_path, epochs="1 h", more=MORE) as site:
        expected = findings(play(site, *range(6)))
        if change == "older database":
            with site.database.writing() as connection:
                connection.execute(delete(monitors))
    if change == "settings":
        file = yard_site(tmp_path) / "site.toml"
        file.write_text(file.read_text().replace("0.01", "0.02"))
    added.clear()
    with site_of(tmp_path) as site:
        live = play(site, 6)
        assert added == [1, 2, 3, 4, 5, 6]
        assert {n: f for n, f in findings(live).items() if n < 6} == expected
    with site_of(tmp_path) as site:
        play(site, 7)
        assert added == [1, 2, 3, 4, 5, 6, 7]


def test_the_state_is_written_with_the_result_or_not_at_all(tmp_path):
    with site_of(tmp_path, epochs="1 h", more=MORE) as site:
        live = play(site, *range(5))
        before = findings(live)

        def full(connection, cursor, statement, *rest):
            if statement.startswith("INSERT INTO monitors"):
                driver = site.database.engine.dialect.loaded_dbapi
                raise driver.OperationalError("database or disk is full")

        event.listen(site.database.engine, "before_cursor_execute", full)
        with pytest.raises(DatabaseAway, match="full"):
            live.close_epoch().result(30)
        assert findings(live) == before
        event.remove(site.database.engine, "before_cursor_execute", full)
        play(site, 5, 6)
        found = findings(live)
    other = tmp_path / "other"
    other.mkdir()
    with site_of(other, epochs="1 h", more=MORE) as site:
        assert found == findings(play(site, *range(7)))


def test_an_epoch_that_the_monitor_refuses_leaves_no_state(tmp_path, added, monkeypatch):
    with site_of(tmp_path, epochs="1 h", more=MORE) as site:
        live = play(site, *range(4))

        def refused(*_):
            raise InputError("no monitor today")

        with monkeypatch.context() as broken:
            broken.setattr(Monitor, "add", refused)
            play(site, 4)
            live.close_epoch().result(30)
        assert findings(live)[5] == {"problem": "no monitor today"}
        with site.database.reading() as connection:
            assert connection.execute(select(monitors)).all() == []
        added.clear()
        play(site, 5, 6)
        assert added[:6] == [1, 2, 3, 4, 5, 6]
