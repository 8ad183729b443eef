"""Epochs of a site are compared; a point that moves raises an alarm, which is cleared again."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from sqlalchemy import select

from factorgraph_adj.epochs.block_motion import BlockMotion
from factorgraph_adj.epochs.congruence_tests import HypothesisTest
from factorgraph_adj.errors import InputError
from factorgraph_adj.quality.protection_levels import protection_levels
from factorgraph_adj.site import surveillance
from factorgraph_adj.site.alarm_notices import body_of
from factorgraph_adj.site.alarm_tables import SilenceRule, read_alarms
from factorgraph_adj.site.site_file import read_site
from factorgraph_adj.site.tables import actions, notices
from tests.support.sites import (
    ADDRESS,
    ALARM,
    BEGIN,
    HOUR,
    readings,
    served,
    site_of,
    yard_of,
    yard_site,
)


def post(client, records):
    answers = client.post(f"{ADDRESS}/postings", json=records).json()
    assert all(a["ok"] for a in answers), answers


@pytest.fixture
def moved(tmp_path):
    """Eight epochs of an hour; C rises by 10 mm in the fifth and sixth."""
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(8):
            post(client, readings(hour, 0.01 if hour in (4, 5) else 0.0))
        yield client


def test_a_displacement_raises_an_alarm_that_is_cleared_when_it_is_gone(moved):
    alarms = moved.get("/api/v1/alarms", params={"state": "all"}).json()
    assert [a["points"] for a in alarms] == [["C"]]
    (alarm,) = alarms
    assert alarm["rule"] == "wall" and alarm["network"] == "yard"
    assert alarm["epoch"] == 5 and alarm["value"] > alarm["limit"]
    assert alarm["since"] == BEGIN + 4.5 * HOUR, "the time of an epoch is its middle"
    assert alarm["epoch_begin"] == BEGIN + 4 * HOUR and alarm["epoch_end"] == BEGIN + 5 * HOUR
    assert "since: the epoch from 2023-11-15 03:00:00 UTC to 2023-11-15 04:00:00 UTC (epoch 5)" in (
        body_of(alarm)
    )
    assert "C" in alarm["text"]
    events = moved.get(f"{ADDRESS}/events").json()
    told = [e["data"]["alarm"]["state"] for e in events if e["event"] == "alarm"]
    assert told in (["open"], ["open", "closed"])


def test_an_epoch_that_ends_with_a_late_reading_keeps_its_alarm(tmp_path):
    with site_of(tmp_path, epochs="1 h", more=ALARM) as site:
        live = yard_of(site)
        for hour in range(5):
            for record in readings(hour, 0.01 if hour == 4 else 0.0):
                assert live.submit(record).result(30)["ok"]
        live.stop()
        # One transaction: a late reading of epoch 3, and the end of epoch 5, in which C moved.
        late = readings(2, seed=7)[0]
        answers = [live.submit(r) for r in (late, *readings(5, 0.01))]
        live._tasks.put(None)
        live._run()
        assert all(a.result(0)["ok"] for a in answers)
        rows = {row["number"]: row for row in live.epochs()}
        assert rows[3]["revision"] == 2 and rows[5]["state"] == "closed"
        (alarm,) = site.alarms.listed()
        assert alarm["points"] == ["C"] and alarm["epoch"] == 5


def test_the_reference_is_the_mean_of_the_stated_number_of_epochs(tmp_path):
    text = (yard_site(tmp_path, epochs="1 h") / "site.toml").read_text()
    (tmp_path / "site.toml").write_text(text + "reference_epochs = 3\n")
    with site_of(tmp_path) as site:
        live = yard_of(site)
        for hour in range(6):
            for record in readings(hour):
                assert live.submit(record).result(30)["ok"]
        of = {r["number"]: r["result"] for r in live.epochs(results=True) if r["result"]}
        moved = {n: bool((r["findings"] or {}).get("displacements")) for n, r in of.items()}
    assert [moved[n] for n in range(1, 6)] == [False, False, False, True, True]


@pytest.mark.parametrize("stated", ["1.5", "0"])
def test_a_number_of_reference_epochs_that_is_none_is_refused(tmp_path, stated):
    text = (yard_site(tmp_path, epochs="1 h") / "site.toml").read_text()
    (tmp_path / "site.toml").write_text(text + f"reference_epochs = {stated}\n")
    with pytest.raises(InputError, match="reference_epochs"):
        read_site(tmp_path)


def test_displacements_are_in_the_epoch_and_in_the_series(moved):
    epoch = moved.get(f"{ADDRESS}/epochs/5").json()
    (c,) = [d for d in epoch["displacements"] if d["name"] == "C"]
    assert c["moved"] and abs(c["dz_mm"] - 10.0) < 4.0 * c["sigma_dz_mm"]
    (series,) = moved.get(f"{ADDRESS}/series", params={"points": "C"}).json()
    dz = dict(zip(series["epochs"], series["dz_mm"], strict=True))
    assert dz[5] > 8.0 and abs(dz[3]) < 3.0
    lengths = {k: len(v) for k, v in series.items() if isinstance(v, list) and k != "alarms"}
    assert len(set(lengths.values())) == 1, lengths
    assert [a["epoch"] for a in series["alarms"]][:2] == [5, 6]


def test_an_alarm_is_acknowledged_and_silenced(tmp_path):
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(6):
            post(client, readings(hour, 0.01 if hour >= 3 else 0.0))
        (alarm,) = client.get("/api/v1/alarms").json()
        address = f"/api/v1/alarms/{alarm['id']}"
        assert alarm["state"] == "open"
        assert client.post(f"{address}/acknowledge").json()["state"] == "acknowledged"
        silenced = client.post(f"{address}/silence", json={"hours": 2}).json()
        assert silenced["state"] == "silenced" and silenced["silenced_by"] == "loopback"
        assert client.post(f"{address}/silence", json={"hours": 1e6}).status_code == 422
        assert client.post("/api/v1/alarms/99/acknowledge").status_code == 422


def test_who_silences_an_alarm_has_not_acknowledged_it(tmp_path):
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(6):
            post(client, readings(hour, 0.01 if hour >= 3 else 0.0))
        site = client.app.state.site
        (alarm,) = site.alarms.listed()
        silenced = site.alarms.silence(alarm["id"], "Ada", 1.0)
        assert (silenced["by"], silenced["acknowledged"]) == (None, None)
        first = site.alarms.acknowledge(alarm["id"], "Ben")
        assert (first["by"], first["silenced_by"]) == ("Ben", "Ada")
        again = site.alarms.silence(alarm["id"], "Cyd", 2.0)
        assert (again["by"], again["silenced_by"]) == ("Ben", "Cyd")
        with pytest.raises(InputError, match="was acknowledged by Ben"):
            site.alarms.acknowledge(alarm["id"], "Dan")
        later = site.alarms.acknowledge(alarm["id"], "Ben", "crane")  # tried again, or remarked
        assert (later["acknowledged"], later["remark"]) == (first["acknowledged"], "crane")


def test_an_alarm_that_ended_is_acknowledged_with_a_remark(tmp_path):
    """Then it wants no attention any more; the log and the events keep who, when and why."""
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(9):
            post(client, readings(hour, 0.01 if 3 <= hour < 6 else 0.0))
        assert client.get("/api/v1/alarms").json() == []
        (alarm,) = client.get("/api/v1/alarms", params={"state": "ended"}).json()
        assert alarm["state"] == "closed" and alarm["acknowledged"] is None
        address, before = f"/api/v1/alarms/{alarm['id']}", time.time()
        too_long = client.post(f"{address}/acknowledge", json={"remark": 501 * "x"})
        assert too_long.status_code == 422 and "500 characters" in too_long.text
        told = client.post(
            f"{address}/acknowledge", json={"remark": " crane\nmoved \x00 it "}
        ).json()
        assert told["remark"] == "crane moved \\x00 it" and told["by"] == "loopback"
        assert told["state"] == "closed" and before <= told["acknowledged"] <= time.time()
        assert told | {"remark": None} == alarm | {k: told[k] for k in ("by", "acknowledged")} | {
            "remark": None
        }
        assert client.get("/api/v1/alarms", params={"state": "ended"}).json() == []
        assert client.get("/api/v1/alarms", params={"state": "all"}).json() == [told]
        assert client.get("/api/v1/alarms", params={"point": "C"}).json() == [told]
        event = [e for e in client.get(f"{ADDRESS}/events").json() if e["event"] == "alarm"][-1]
        assert event["data"]["alarm"] == told
        with client.app.state.site.database.reading() as connection:
            (action,) = connection.execute(select(actions)).all()
        said = {"alarm": alarm["id"], "remark": told["remark"]}
        assert (action.who, json.loads(action.data)) == ("loopback", said)
        again = client.post(f"{address}/acknowledge")
        assert again.status_code == 422 and "was acknowledged" in again.text
        assert client.post(f"{address}/silence", json={"hours": 1}).status_code == 422
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        late = {**readings(3)[0], "id": "late"}
        post(client, [late])
        yard_of(client.app.state.site).close_stale()
        (alarm,) = client.get("/api/v1/alarms", params={"state": "all"}).json()
        assert alarm["remark"] == told["remark"] and alarm["acknowledged"] == told["acknowledged"]


def test_a_restart_continues_the_monitoring(tmp_path):
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(4):
            post(client, readings(hour))
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(4, 8):
            post(client, readings(hour, 0.01))
        assert len(client.get("/api/v1/alarms").json()) == 1
        live = yard_of(client.app.state.site)
        assert live.surveillance.against == 1


def test_readings_that_come_late_are_judged_again(tmp_path):
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(6):
            if hour != 3:
                post(client, readings(hour))
        assert client.get("/api/v1/alarms").json() == []
        post(client, readings(3, 0.01))  # a gap in the line to the instrument
        yard_of(client.app.state.site).close_stale()
        epochs = {e["number"]: e for e in client.get(f"{ADDRESS}/epochs").json()}
        assert epochs[4]["congruence"]["moved"] == ["C"]


def test_kinds_of_observations_have_their_precision(moved):
    rows = moved.get(f"{ADDRESS}/variance-components").json()
    groups = {g["name"]: g for g in rows[-1]["groups"]}
    assert set(groups) == {"height_difference", "slope_distance", "direction"}
    assert sum(g["redundancy"] for g in groups.values()) == pytest.approx(rows[-1]["redundancy"])


def test_all_problems_of_alarms_are_told():
    tables = [
        {"name": "a", "test": "displacment", "notify": ["carrier pigeon"]},
        {"name": "a", "network": "other"},
        {"test": "silence", "after": -1},
    ]
    with pytest.raises(InputError) as error:
        read_alarms(tables, where="site.toml", networks=["dam"])
    said = str(error.value)
    for part in ("displacment", "is no address", "'other'", "name is missing", "after must"):
        assert part in said
    (alarm,) = read_alarms(
        [{"name": "s", "test": "silence", "points": ["ts*"], "after": 60}],
        where="site.toml",
        networks=["dam"],
        instruments=["ts1"],
    )
    assert isinstance(alarm.rule, SilenceRule) and alarm.rule.covers("ts1")


def test_protection_levels_name_what_nothing_controls(moved):
    found = moved.get(f"{ADDRESS}/protection-levels", params={"risk": 0.01, "faults": "1"}).json()
    rows = {r["name"]: r for r in found["rows"]}
    assert rows["A"]["space_mm"] == 0.0
    assert rows["C"]["vertical_mm"] > 0.5 and rows["C"]["weakest"]


@pytest.mark.parametrize("policy", ["reject", "flag", "accept"])
def test_protection_levels_share_the_risk_among_what_may_have_been_rejected(tmp_path, policy):
    folder = yard_site(tmp_path)
    text = (folder / "site.toml").read_text()
    (folder / "site.toml").write_text(text.replace('"reject"', f'"{policy}"'))

    def heights(client):
        found = client.get(f"{ADDRESS}/protection-levels", params={"faults": "1"}).json()
        return found, {r["name"]: r["vertical_mm"] for r in found["rows"]}["C"]

    def expected(client, rejected):
        with yard_of(client.app.state.site).reading() as epoch:
            solution = epoch.stream.adjustment.solution()
        levels = protection_levels(solution, faults=1, alpha=0.001, rejected=rejected)
        return pytest.approx(1e3 * levels.level("C", "vertical"))

    with served(folder) as client:
        post(client, readings(0))
        found, height = heights(client)
        m = None if policy == "accept" else 0
        assert found["rejected"] == m and height == expected(client, m)
        post(client, [{**r, "value": r["value"] + 0.1} for r in readings(0)[:1]])
        found, after = heights(client)
        m = None if policy == "accept" else 1
        assert found["rejected"] == m and after == expected(client, m)
        assert found["accepted"] == (policy != "accept")
        if m is not None:
            assert after > height > expected(client, None).expected


@pytest.mark.parametrize("value", [1.0, 9.0])
def test_a_block_has_its_motion_with_precision_and_its_verdict(monkeypatch, value):
    test = HypothesisTest(value, 3.0, (3, np.inf), 0.1)
    names, p = ("tx", "ty", "rz"), np.array([0.01, 0.0, np.pi / 200_000])
    q = np.diag([4e-6, 1e-6, p[2] ** 2])
    block = BlockMotion(("C", "D"), "rigid", p, names, p, q, 1.0, np.zeros((2, 2)), None, test)
    monkeypatch.setattr(surveillance, "block_motion", lambda *_: block)
    (told,) = surveillance._blocks(None, ["C", "D"])
    assert told["translation_mm"] == [10.0, 0.0, None]
    assert told["sigma_translation_mm"] == [2.0, 1.0, None]
    assert told["rotation_mgon"] == told["sigma_rotation_mgon"] == [None, None, 1.0]
    assert told["moved"] == (value > 3.0)


def test_a_block_without_a_motion_tells_why(monkeypatch):
    def none(*_):
        raise InputError("not determined")

    monkeypatch.setattr(surveillance, "block_motion", none)
    assert surveillance._blocks(None, ["C"]) == [{"points": ["C"], "problem": "not determined"}]


def hours_but(client, last, left_out, risen=()):
    for hour in range(last):
        if hour != left_out:
            post(client, readings(hour, 0.01 if hour in risen else 0.0))


def epochs_of(client):
    numbers = [e["number"] for e in client.get(f"{ADDRESS}/epochs").json()]
    return {n: client.get(f"{ADDRESS}/epochs/{n}").json() for n in numbers}


def test_late_readings_change_what_is_recorded_of_later_epochs(tmp_path):
    """Records are those of a site to which all readings came in time."""
    late, timely = tmp_path / "late", tmp_path / "timely"
    for folder in (late, timely):
        folder.mkdir()
    with served(late, epochs="1 h", more=ALARM) as client:
        hours_but(client, 7, 2)
        before = epochs_of(client)
        post(client, readings(2))
        yard_of(client.app.state.site).close_stale()
        found = epochs_of(client)
        events = client.get(f"{ADDRESS}/events").json()
    with served(timely, epochs="1 h", more=ALARM) as client:
        hours_but(client, 7, None)
        expected = epochs_of(client)
    for number in range(1, 7):
        for what in ("displacements", "motions", "tests"):
            assert found[number][what] == expected[number][what], (number, what)
    assert found[5]["motions"] != before[5]["motions"]
    assert [found[n]["revised"] for n in (2, 4, 5, 6)] == [None, 3, 3, 3]
    told = [e["data"]["epoch"] for e in events if e["data"].get("what") == "revised"]
    assert told == [4, 5, 6]


def test_an_alarm_that_began_and_ended_in_the_meantime_is_recorded_and_withdrawn(tmp_path):
    """By readings that came late, and by their removal."""
    with served(tmp_path, epochs="1 h", more=ALARM) as client:

        def alarms():
            yard_of(client.app.state.site).close_stale()
            return client.get("/api/v1/alarms", params={"state": "all"}).json()

        hours_but(client, 8, 3)
        assert alarms() == []
        answers = client.post(f"{ADDRESS}/postings", json=readings(3, 0.01)).json()
        (alarm,) = alarms()
        times = {n: e["time"] for n, e in epochs_of(client).items()}
        assert (alarm["since"], alarm["until"]) == (times[4], times[6])
        assert alarm["state"] == "closed" and alarm["epoch"] == 4 and alarm["value"] > 0
        assert alarm["revised"] == "revised after late readings of epoch 4, or decisions about it"
        ids = [a["id"] for a in answers]
        time = readings(3)[0]["time"]
        removed = client.post(
            f"{ADDRESS}/postings", json={"do": "remove", "ids": ids, "time": time}
        ).json()
        assert removed["ok"]
        (alarm,) = alarms()
        assert alarm["state"] == "closed" and alarm["text"].startswith("withdrawn: wall: C lies")
        with client.app.state.site.database.reading() as connection:
            assert len(connection.execute(select(notices)).all()) == 1, "it was told once"
        post(client, readings(3, 0.01))
        (alarm,) = alarms()
        assert alarm["text"].startswith("wall: C lies"), "it is the same alarm again"


def test_an_alarm_that_stands_has_the_times_of_its_epochs(tmp_path):
    """Readings of the epoch in which it began come late: it began earlier than was known."""
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        hours_but(client, 7, 3, risen=(3, 4, 5, 6))
        (alarm,) = client.get("/api/v1/alarms").json()
        assert alarm["epoch"] == 5 and "revised" not in alarm
        post(client, readings(3, 0.01))
        yard_of(client.app.state.site).close_stale()
        (alarm,) = client.get("/api/v1/alarms").json()
        times = {n: e["time"] for n, e in epochs_of(client).items()}
        assert alarm["epoch"] == 4 and alarm["since"] == times[4] and alarm["revised"]
        post(client, readings(7, 0.01))  # the end of epoch 7: it continues, and is not revised
        assert client.get("/api/v1/alarms").json()[0]["latest"]["epoch"] == 7
