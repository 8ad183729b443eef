"""The page of a site with the service itself: the yard, its observations and its epochs."""

from __future__ import annotations

import json
import re

import pytest

pytest.importorskip("fastapi", reason="the service of a site needs the extra serve")
pytest.importorskip("uvicorn", reason="the service of a site needs the extra serve")

from tests.networks.yard import ARRIVALS, WRONG
from tests.site.browsers import PHONE, visit
from tests.site.yard_server import YardServer
from tests.support.sites import ALARM, readings


@pytest.fixture
def yard(tmp_path):
    made = YardServer(tmp_path)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """Six epochs of an hour that are compared; C rises by 10 mm in the fifth and stays there."""
    made = YardServer(tmp_path_factory.mktemp("watched"), epochs="1 h", more=ALARM)
    for hour in range(6):
        answers = made.post(*readings(hour, 0.01 if hour >= 4 else 0.0))
        assert all(a["ok"] for a in answers), answers
    yield made
    made.stop()


def _go(v, place):
    v.go(place, network="yard")


def test_verdicts_of_the_service_are_seen_and_decided(browser, yard):
    with visit(browser, yard) as one, visit(browser, yard, size=PHONE, language="de-DE") as two:
        for v in (one, two):
            _go(v, "verdicts")
        yard.post(*ARRIVALS)
        for v in (one, two):
            v.sees("#view li.accepted")
        (answer,) = yard.post(WRONG)
        assert answer["verdict"] == "rejected"
        mine = f"[data-id='{answer['id']}']"
        for v in (one, two):
            v.sees(f"{mine}[data-verdict=rejected]")
        one.sees(f"{mine} .why", "exceeds 1")
        two.sees(f"{mine} .why", "überschreitet 1")
        two.sees(f"{mine} strong", "Schrägstrecke")
        one.page.locator(f"{mine} [data-act=accept]").click()
        one.sees("#say", "is accepted")
        two.sees(f"{mine}[data-now=accepted]")
        two.page.locator(f"{mine} [data-act=remove]").first.click()
        two.press("Entfernen", within="dialog")
        two.sees("#say", "ist entfernt")
        one.sees(f"{mine}[data-now=gone]")
        assert one.complaints == two.complaints == []


def test_every_view_of_the_service_is_quiet(browser, yard):
    yard.post(*ARRIVALS, WRONG)
    with visit(browser, yard) as v:
        v.sees("[data-figure=observations] dd", str(len(ARRIVALS)))
        _go(v, "plan")
        v.holds("() => planForTests.points.names.includes('C')")
        v.holds("() => planForTests.points.a[planForTests.points.index.get('C')] > 0")
        v.holds("() => planForTests.sights.some(s => s.length > 0)")
        _go(v, "verdicts/rejected")
        v.sees("#view li.rejected")
        _go(v, "verdicts/causes")
        v.sees("#view ol, #view .note")
        _go(v, "points")
        v.sees("tr[data-name=C]")
        _go(v, "points/C")
        v.sees("[data-figure=x] dd", "σ")
        v.sees("#view li.accepted [data-act=replace]")
        _go(v, "epochs")
        v.press("End the present epoch")
        v.press("End the present epoch", within="dialog")
        v.sees("tbody tr", "closed")
        v.page.locator("tbody tr a").first.click()
        v.sees("#view dd", "closed")
        _go(v, "instruments")
        v.sees("#view", "No instrument is connected")
        _go(v, "downloads")
        with v.page.expect_download() as waiting:
            v.page.get_by_role("link", name="results.json", exact=True).click()
        assert json.loads(waiting.value.path().read_text(encoding="utf-8"))
        assert [s for s in v.complaints if "Content Security" in s or "error" in s] == []


def test_a_value_is_replaced_in_the_service(browser, yard):
    yard.post(*ARRIVALS)
    with visit(browser, yard, at="#/yard/points/C") as v:
        v.page.locator("#view li.accepted [data-act=replace]").first.click()
        field = v.page.locator("dialog input[name=value]")
        value = float(field.input_value())
        field.fill(f"{value + 0.0001:.4f}")
        v.press("Replace", within="dialog")
        v.sees("#say", "is replaced")


def test_a_service_that_was_away_is_caught_up_with(browser, yard):
    with visit(browser, yard) as v:
        _go(v, "verdicts")
        taken = yard.post(*ARRIVALS)
        for answer in taken:  # they are drawn one after another
            v.sees(f"[data-id='{answer['id']}'].accepted")
        yard.stop()
        v.sees(".banner", "Connection lost since")
        yard.start()
        (answer,) = yard.post(WRONG)
        v.sees(f"[data-id='{answer['id']}'][data-verdict=rejected]")
        v.page.wait_for_selector(".banner", state="hidden")
        assert v.page.locator("#view li.accepted").count() == len(taken)


def test_a_displacement_is_seen_in_its_epoch_and_in_the_series(browser, watched):
    with visit(browser, watched) as v:
        told = v.sees(".light.alarm", "wall: displacement of C since epoch 5").inner_text()
        # The whole epoch of an hour, not its middle.
        begin, end = re.search(r"since epoch 5, \S+ (\d\d:00) to \S+ (\d\d:00)", told).groups()
        assert (int(end[:2]) - int(begin[:2])) % 24 == 1
        _go(v, "epochs")
        v.sees("tr[data-name='5'] .pill.moved", "one point moved")
        v.sees("tr[data-name='4'] .pill.stable")
        v.page.wait_for_selector(".plot[data-made]")
        names = v.page.evaluate("document.querySelector('.plot').data.map(t => t.name)")
        assert sorted(names) == ["direction", "height difference", "slope distance", "σ̂0"]
        v.page.locator("tr[data-name='5'] a").first.click()
        v.sees("tr[data-name=C] .pill.moved")
        v.sees("caption", "Displacements against epoch 1")
        dz = float(v.page.locator("tr[data-name=C] td").nth(2).inner_text())
        assert 8.0 < dz < 12.0
        _go(v, "points/C")
        v.page.wait_for_selector(".plot[data-made]")
        shown = v.page.evaluate("document.querySelector('.plot').data.map(t => t.name)")
        parts = {"± σ", "detectable displacement", "motion model", "displacement"}
        assert parts <= set(shown)
        script = """document.querySelector('.plot').data
          .filter(t => t.name === 'displacement' && t.yaxis === 'y3')[0].y"""
        shift = [z for z in v.page.evaluate(script) if z is not None]
        assert shift[-1] == pytest.approx(dz, abs=0.01) and abs(shift[-2]) < 3.0
        labels = "document.querySelector('.plot').layout.annotations.map(a => a.text)"
        assert v.page.evaluate(labels) == ["⚠ wall"]
        v.sees("#view", "Velocity z")
        assert v.complaints == []


def test_next_sights_and_protection_levels_of_a_point_are_shown(browser, watched):
    with visit(browser, watched, at="#/yard/points/C") as v:
        v.sees("[data-figure=protection] dd", " mm")
        v.sees("#view", "Protection level, least controlled")
        v.sees("#view", "Error of position now")
        v.sees("#view li.card", "→")
        v.sees("#view li.card", "gain")
        assert v.complaints == []


def test_an_alarm_of_the_service_is_acknowledged_and_silenced(browser, watched):
    with visit(browser, watched) as one, visit(browser, watched, size=PHONE) as two:
        one.sees("[data-alarm] .pill.open")
        one.sees("[data-alarm]", "stated rate 0.01 false alarms a month")
        one.press("Acknowledge", within="#alarms")
        one.press("Acknowledge", within="dialog")
        for v in (one, two):
            v.sees("[data-alarm] .pill.acknowledged")
            v.sees(".light.doubts", "Acknowledged, still standing")
        two.press("Silence", within="#alarms")
        two.page.locator("dialog input").fill("2.5")
        two.press("Silence", within="dialog")
        for v in (one, two):
            v.sees("[data-alarm] .pill.silenced")
            v.sees("[data-alarm] .why", "by loopback")
        assert one.complaints == two.complaints == []
