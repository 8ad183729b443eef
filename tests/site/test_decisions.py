"""Decisions about observations of epochs: by whom, about which epoch, and what they change."""

from __future__ import annotations

import pytest
from sqlalchemy import update

from factorgraph_adj.site.decisions import (
    Decision,
    accepted_by_people,
    last_decisions,
    standing_decisions,
)
from factorgraph_adj.site.tables import actions
from tests.networks.yard import ARRIVALS, WRONG
from tests.support.sites import ADDRESS, ALARM, HOUR, readings, served, site_of, yard_of

pytestmark = pytest.mark.usefixtures("store")
BLUNDER = 0.25
"""Of a distance, metres."""


def posted(client, *records):
    answers = client.post(f"{ADDRESS}/postings", json=[*records]).json()
    assert all(a["ok"] for a in answers), answers
    return answers


def played(client, hours, wrong, *, rise=0.0):
    """Post hours of readings, one after the other; one distance of ``wrong`` has a gross error.

    Return the answer to it.
    """
    out = None
    for hour in range(hours):
        given = readings(hour, rise if hour == wrong else 0.0)
        posted(client, *given)
        if hour == wrong:
            distance = next(r for r in given if r["kind"] == "slope_distance")
            value = distance["value"] + BLUNDER
            (out,) = posted(client, {**distance, "value": value, "id": "wrong"})
    return out


def listed(client, epoch, what="rejected"):
    return client.get(f"{ADDRESS}/{what}", params={"epoch": epoch}).json()["rows"]


def decided(client, do, epoch, *ids, **more):
    (answer,) = posted(client, {"do": do, "epoch": epoch, "ids": [*ids], **more})
    yard_of(client.app.state.site).close_stale()
    return answer


def test_an_ended_epoch_lists_what_it_has_rejected_with_reasons(tmp_path):
    with served(tmp_path, epochs="1 h") as client:
        assert played(client, 4, 1)["verdict"] == "rejected"
        (row,) = listed(client, 2)
        assert row["id"] == "wrong" and row["epoch"] == 2 and row["state"] == "rejected"
        assert row["test"] > 1.0 and row["critical"] > 1.0 and row["small_unit"] == "mm"
        assert row["innovation"][0] == pytest.approx(-1e3 * BLUNDER, abs=10.0)
        assert "decision" not in row, "a test has rejected it, and nobody else"
        now = row["now"]
        assert now["test"] > 1.0 and now["innovation"] == pytest.approx(row["innovation"], abs=5.0)
        assert listed(client, 3) == [] and listed(client, 2, "suspects") == []
        rows = client.get(f"{ADDRESS}/observations", params={"epoch": 2, "state": "rejected"})
        assert [r["id"] for r in rows.json()["rows"]] == ["wrong"]
        assert client.get(f"{ADDRESS}/rejected").json()["rows"] == [], "the present epoch has none"
        answer = client.get(f"{ADDRESS}/rejected", params={"epoch": 9})
        assert answer.status_code == 422 and "has no epoch 9" in answer.text


def test_a_decision_about_an_ended_epoch_revises_it_and_later_ones(tmp_path):
    """The reference gets another estimate: what later epochs are compared with changes."""
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        played(client, 5, 0)
        before = client.get(f"{ADDRESS}/epochs/4").json()
        answer = decided(client, "accept", 1, "wrong")
        assert answer["epoch"] == 1 and answer["verdicts"][0]["verdict"] == "accepted"
        epochs = {e["number"]: e for e in client.get(f"{ADDRESS}/epochs").json()}
        assert [epochs[n]["revision"] for n in (1, 2, 3, 4)] == [2, 1, 1, 1]
        assert epochs[1]["counts"]["rejected"] == 0 and epochs[5]["state"] == "open"
        after = client.get(f"{ADDRESS}/epochs/4").json()
        assert after["revised"] == 1 and after["displacements"] != before["displacements"]
        # It can be taken back: the result is that of before.
        decided(client, "remove", 1, "wrong")
        again = client.get(f"{ADDRESS}/epochs/4").json()
        for a, b in zip(again["displacements"], before["displacements"], strict=True):
            assert a["name"] == b["name"] and a["dz_mm"] == pytest.approx(b["dz_mm"], abs=0.01)
        events = client.get(f"{ADDRESS}/events").json()
        told = [e["data"]["what"] for e in events if e["event"] == "epoch"]
        assert told[-10:] == ["reopened", *["revised"] * 3, "result"] * 2
        found = client.get(f"{ADDRESS}/epochs/1").json()["decisions"]
        assert [(d["do"], d["ids"], d["by"]) for d in found] == [
            ("accept", ["wrong"], "loopback"),
            ("remove", ["wrong"], "loopback"),
        ]
        # What has been removed keeps its name here.
        assert all(d["labels"] == {"wrong": found[0]["labels"]["wrong"]} for d in found)
        assert found[0]["labels"]["wrong"].startswith("slope_distance A C")


def shown(client, epoch):
    """Return what is in and out of an epoch, with its result and estimates."""
    lists = {what: listed(client, epoch, what) for what in ("rejected", "suspects", "waiting")}
    for row in (row for rows in lists.values() for row in rows):
        row.pop("decision", None), row.pop("revocable", None), row.pop("now", None)
    accepted = client.get(f"{ADDRESS}/observations", params={"epoch": epoch, "limit": 1000}).json()
    lists["accepted"] = sorted(row["id"] for row in accepted["rows"])
    return lists


def heights(client, epoch):
    rows = client.get(f"{ADDRESS}/epochs/{epoch}").json()["points"]
    return {r["name"]: (r["z"], r["sigma_z_mm"]) for r in rows if r.get("sigma_z_mm")}


@pytest.mark.parametrize("epoch", [2, 4], ids=["ended", "present"])
def test_every_decision_of_people_is_taken_back_completely(tmp_path, epoch):
    """Also after a restart between the two."""
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        ident = played(client, 4, epoch - 1)["id"]
        before = shown(client, epoch)
        result = client.get(f"{ADDRESS}/epochs/3").json()
        places = heights(client, epoch) if epoch == 2 else None
        assert [r["id"] for r in before["rejected"]] == [ident]
    good = before["accepted"][:3]
    for do, back in [("accept", "rejected"), *[("discard", "observations")] * 3]:
        ids = [ident] if do == "accept" else [good.pop()]
        with served(tmp_path, epochs="1 h", more=ALARM) as client:
            decided(client, do, epoch, *ids)
            where = "observations" if do == "accept" else "rejected"
            (row,) = (r for r in listed(client, epoch, where) if r["id"] == ids[0])
            assert row["revocable"] and row["decision"]["do"] == do
            assert row["decision"]["by"] == "loopback"
        with served(tmp_path, epochs="1 h", more=ALARM) as client:
            decided(client, "revoke", epoch, *ids)
            (row,) = (r for r in listed(client, epoch, back) if r["id"] == ids[0])
            assert not row["revocable"] and row["decision"]["do"] == "revoke"
            assert shown(client, epoch) == before
            if places is not None:
                for name, (z, sigma) in heights(client, epoch).items():
                    assert abs(z - places[name][0]) <= 1e-9 * 1e-3 * sigma
            after = client.get(f"{ADDRESS}/epochs/3").json()
            for a, b in zip(after["displacements"], result["displacements"], strict=True):
                assert a["name"] == b["name"] and a["dz_mm"] == pytest.approx(b["dz_mm"], abs=1e-6)
            (answer,) = client.post(
                f"{ADDRESS}/postings", json=[{"do": "revoke", "epoch": epoch, "ids": ids}]
            ).json()
            assert not answer["ok"] and "no decision by hand" in answer["error"][0]["what"]
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        found = client.get(f"{ADDRESS}/epochs/{epoch}").json().get("decisions", [])
        assert [d["do"] for d in found] == ["accept", "revoke", *["discard", "revoke"] * 3]
        assert all(d["revocable"] == [] for d in found)


def test_what_people_took_back_binds_no_search(tmp_path):
    with served(tmp_path, epochs="1 h") as client:
        ident, database = played(client, 4, 1)["id"], client.app.state.site.database
        for do in ("accept", "discard", "revoke"):
            decided(client, do, 2, ident)
        assert accepted_by_people(database, "yard", 2) == {ident}
        found = client.get(f"{ADDRESS}/epochs/2").json()["decisions"]
        assert [d["revocable"] for d in found] == [[ident], [], []]
        decided(client, "revoke", 2, ident)
        assert accepted_by_people(database, "yard", 2) == frozenset()


def test_a_decision_about_an_ended_epoch_raises_and_withdraws_alarms(tmp_path):
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(6):
            moved = 0.01 if hour == 3 else 0.0
            rows = [
                {**r, "id": f"{r['kind']} {n}"} if hour == 3 else r
                for n, r in enumerate(readings(hour, moved))
            ]
            posted(client, *rows)
        (alarm,) = client.get("/api/v1/alarms", params={"state": "all"}).json()
        assert alarm["epoch"] == 4
        levelled = [f"height_difference {n}" for n in range(3)]
        decided(client, "remove", 4, *levelled)
        (alarm,) = client.get("/api/v1/alarms", params={"state": "all"}).json()
        assert alarm["withdrawn"]
        assert alarm["revised"] == "revised after late readings of epoch 4, or decisions about it"


def test_a_decision_names_who_made_it(tmp_path):
    with served(tmp_path, epochs="1 h") as client:
        site = client.app.state.site
        text = site.access.add("office", "surveyor")
        site.access.add("chief", "admin")
        headers = {"Authorization": f"Bearer {text}"}
        yard = tmp_path / "site.toml"
        yard.write_text(yard.read_text().replace('policy = "reject"', 'policy = "flag"'))
    with served(tmp_path, epochs="1 h") as client:
        client.headers.update(headers)
        for hour in range(3):
            posted(client, *readings(hour))
        late = {**readings(1)[3], "value": 59.0, "id": "wrong"}
        (answer,) = posted(client, late)
        assert (answer["verdict"], answer["epoch"]) == ("suspect", 2)
        yard_of(client.app.state.site).close_stale()
        (suspect,) = listed(client, 2, "suspects")
        assert suspect["id"] == "wrong"
        decided(client, "discard", 2, "wrong")
        (row,) = listed(client, 2)
        assert row["cause"] == "discarded"
        assert (row["decision"]["do"], row["decision"]["by"]) == ("discard", "office")


def test_a_decision_without_a_time_is_about_the_present_epoch(tmp_path):
    """However the clock of the instruments differs from that of the machine."""
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        for record in ARRIVALS:
            live.submit({**record, "time": 1_700_000_000.0}).result(30)
        answer = live.submit({**WRONG, "time": 1_700_000_001.0}).result(30)
        assert answer["verdict"] == "rejected"
        answer = live.submit({"do": "accept", "ids": [answer["id"]]}).result(30)
        assert answer["ok"] and answer["epoch"] == 1
        assert live.clock.latest == 1_700_000_001.0, "a decision is no reading of an instrument"
        before = live.clock.now()
    with site_of(tmp_path, epochs="1 h") as site:
        assert yard_of(site).clock.now() - before < 600.0


def test_a_decision_about_an_epoch_that_ended_by_hand_revises_it(tmp_path):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        for record in (*ARRIVALS, WRONG):
            answer = live.submit(record).result(30)
        live.close_epoch().result(30)
        # There is no present epoch that is open: the last one is meant, whether it is named or not.
        for named in ({}, {"epoch": 1}):
            do = "remove" if named else "accept"
            found = live.submit({"do": do, "ids": [answer["id"]], **named}).result(30)
            assert found["ok"] and found["epoch"] == 1
            live.close_stale()
        assert [(r["number"], r["revision"]) for r in live.epochs()] == [(1, 3)]


@pytest.mark.parametrize(
    ("epoch", "said"), [(7, "has no epoch 7"), ("1", "must be the number"), (True, "must be")]
)
def test_a_decision_about_no_epoch_is_refused(tmp_path, epoch, said):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        live.submit(ARRIVALS[0]).result(30)
        answer = live.submit({"do": "accept", "ids": ["x"], "epoch": epoch}).result(30)
        assert not answer["ok"] and said in answer["error"][0]["what"]
        for ids in (5, [5], [["x"]], {"x": 1}):
            answer = live.submit({"do": "accept", "ids": ids}).result(30)
            assert not answer["ok"] and answer["error"][0]["where"], answer
        reading = live.submit({**ARRIVALS[1], "epoch": 1}).result(30)
        assert not reading["ok"], "a reading belongs to the epoch of its time"


def test_what_people_accept_while_the_service_ends_is_not_searched(tmp_path):
    """The decision and the search that it forbids share a transaction."""
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        given = [r for r in readings(0) if r["kind"] == "direction"] + [readings(0)[0]]
        distance = next(r for r in readings(0) if r["kind"] == "slope_distance")
        off = [{**distance, "value": distance["value"] + x} for x in (0.0, 0.0, 0.0, 0.5, 0.2)]
        for record in (*given, *off[:3], {**off[3], "id": "odd"}):
            live.submit(record).result(30)
        live.submit(readings(2)[0]).result(30)
        live.stop()
        late = [live.submit(off[4]) for _ in range(3)]
        accepted = live.submit({"do": "accept", "ids": ["odd"], "epoch": 1})
        live._tasks.put(None)
        live._run()
        assert [a.result(0)["verdict"] for a in late] == ["rejected"] * 3
        assert accepted.result(0)["ok"] and live.epochs()[1]["revision"] == 2
        assert live.epochs(results=True)[1]["result"]["doubts"], "three of seven are out"
        assert "site" not in [e.data["by"] for e in site.events.after(0) if e.kind == "arrival"]
    with site_of(tmp_path, epochs="1 h") as site:
        assert accepted_by_people(site.database, "yard", 1) == {"odd"}


def test_records_of_older_services_count_for_every_epoch(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        for record in (*ARRIVALS, WRONG):
            answer = live.submit({**record, "time": 1_700_000_000.0 + HOUR}).result(30)
        live.submit({"do": "accept", "ids": [answer["id"]]}).result(30)
        named = {"yard": True, "other": False}
        for name, there in named.items():
            assert bool(accepted_by_people(site.database, name, 1)) == there
        with site.database.writing() as connection:
            older = f'{{"do": "accept", "ids": ["{answer["id"]}"]}}'
            connection.execute(update(actions).values(data=older))
        assert accepted_by_people(site.database, "yard", 5) == {answer["id"]}


def test_decisions_about_a_group_stand_as_one():
    """Who accepts one of a group may take it back by naming another one."""

    def decided(do, *ids, labels=()):
        named = {"do": do, "ids": list(ids), "labels": dict.fromkeys(labels, "a height difference")}
        return Decision.of({"at": 1.0, "who": "office", "action": do}, named)

    accepted = decided("accept", "g4", labels=("g4", "g5"))
    assert accepted.ids == ("g4", "g5")
    standing = standing_decisions([accepted])
    assert standing == {"g4": (accepted,), "g5": (accepted,)}
    assert accepted.shown(standing)["revocable"] == ["g4", "g5"]
    revoked = decided("revoke", "g5", labels=("g4", "g5"))
    assert not any(standing_decisions([accepted, revoked]).values())
    assert last_decisions([accepted, revoked]) == {}
    rejected = decided("discard", "g4", labels=("g4", "g5"))
    assert last_decisions([rejected, accepted, revoked]) == {"g4": rejected, "g5": rejected}
    for do in ("remove", "replace", "reweight"):  # it is another observation then
        assert not standing_decisions([accepted, decided(do, "g4", labels=("g4", "g5"))])
