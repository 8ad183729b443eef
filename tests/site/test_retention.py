"""What a site keeps no longer leaves; results stay, and repetitions still change nothing."""

from __future__ import annotations

import time

import pytest
from sqlalchemy import func, select

from factorgraph_adj.errors import InputError
from factorgraph_adj.site.retention import Retention
from factorgraph_adj.site.retention_settings import DAY_S, RetentionSettings, read_retention
from factorgraph_adj.site.tables import events, journal
from tests.networks.yard import ARRIVALS
from tests.support.sites import site_of, yard_of

HOUR = 3600.0
BEGIN = 1_700_002_800.0


def posted(live, *records):
    return [f.result(60) for f in [live.submit(r) for r in records]]


def hours(n):
    for hour in range(n):
        for k, record in enumerate(ARRIVALS):
            yield {**record, "time": BEGIN + HOUR * hour + 60.0, "request": f"{hour}.{k}"}


def test_readings_of_old_epochs_leave_and_their_results_stay(tmp_path, store):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        posted(live, *hours(6))
        kept = Retention(RetentionSettings(journals=2.5 * HOUR), site.database, [live])
        assert kept.apply(time.time())["epochs"] == 1
        states = {r["number"]: r["state"] for r in live.epochs()}
        # Epoch 1 is the reference, epoch 2 has left, the others are young; 5 waits for late ones.
        assert states == {
            0: "closed",
            **{1: "closed", 2: "dropped", 3: "closed", 4: "closed", 5: "open", 6: "open"},
        }
        late = {"kind": "height_difference", "station": "A", "target": "C", "value": 1.5}
        refused, taken = posted(
            live, {**late, "time": BEGIN + 1.5 * HOUR}, {**late, "time": BEGIN + 3.5 * HOUR}
        )
        assert not refused["ok"] and "[retention]" in refused["error"][0]["what"]
        assert taken["ok"] and taken["epoch"] == 4
        (again,) = posted(live, next(hours(1)))
        assert again["repeated"]
    with site_of(tmp_path) as site:  # a restart
        rows = {r["number"]: r for r in yard_of(site).epochs(results=True)}
        assert rows[2]["result"]["converged"] and rows[2]["state"] == "dropped"
        with site.database.reading() as connection:
            lines = (
                select(func.count()).select_from(journal).where(journal.c.epoch == rows[2]["id"])
            )
            assert connection.execute(lines).scalar() == 0


def test_old_events_leave_and_numbers_go_on(tmp_path):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        posted(live, *ARRIVALS)
        kept = Retention(RetentionSettings(events=DAY_S), site.database, [live])
        assert kept.apply(time.time())["events"] == 0
        assert kept.apply(time.time() + 2 * DAY_S)["events"] == len(ARRIVALS) - 1
        _, last = site.events.bounds()
        posted(live, {**ARRIVALS[0], "id": "again"})
        assert [e.id for e in site.events.after(last)] == [last + 1]
        with site.database.reading() as connection:
            assert connection.execute(select(func.count()).select_from(events)).scalar() == 2


def test_answers_are_shortened_and_repetitions_known(tmp_path):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        first = posted(live, *hours(1))
        kept = Retention(RetentionSettings(), site.database, [live])
        assert kept.apply(time.time() + 8 * DAY_S)["answers"] == len(ARRIVALS)
        assert kept.apply(time.time() + 8 * DAY_S)["answers"] == 0
        again = posted(live, *hours(1))
        assert [a["verdict"] for a in again] == [a["verdict"] for a in first]
        assert all(a["repeated"] and a["shortened"] for a in again)
        with live.reading() as epoch:
            assert len(epoch.stream.adjustment) == len(ARRIVALS)


def test_problems_of_retention_are_told():
    with pytest.raises(InputError) as error:
        read_retention({"journals": "soon", "event": "1 d", "answers": "for ever"}, "site.toml")
    assert "journals" in str(error.value) and "'event'" in str(error.value)
    assert read_retention({"answers": "for ever"}, "site.toml").answers is None
