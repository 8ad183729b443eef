"""What an epoch of the page has left out, why, and what people decide about it."""

import re

import pytest

pytest.importorskip("fastapi", reason="the service of a site needs the extra serve")
pytest.importorskip("uvicorn", reason="the service of a site needs the extra serve")

from tests.site.browsers import DESK, PHONE, visit
from tests.site.page_audits import audit
from tests.site.yard_server import YardServer
from tests.support.sites import readings

OPENED = "[data-part={}] > summary"


def _open(v, part):
    v.page.locator(OPENED.format(part)).click()


def test_every_reason_is_told_with_who_decided(browser, server):
    server.site.leave_out()
    with visit(browser, server, at="#/small/epochs/10") as v:
        v.sees(OPENED.format("rejected"), "Rejected (3)")
        v.sees("#view .note", "later epochs and alarms are revised")
        assert not [r for r in v.requests if "rejected?epoch" in r], "read when it is opened"
        _open(v, "rejected")
        tested = v.sees("[data-id=e0]").inner_text().replace("\u00a0", " ")
        for part in ("gross error", "mm", "critical value 3.29", "exceeds 1", "by its test when"):
            assert part in tested, part
        assert "Against the epoch as it is now" in tested and "it fits" in tested
        v.sees("[data-id=e1]", "found by the search for gross errors")
        v.sees("[data-id=e1]", "it does not fit")
        v.sees("[data-id=e2]", "rejected by office")
        assert v.page.locator("[data-id=e0] a").all_inner_texts() == ["P2", "D1"]
        _open(v, "suspects")
        v.sees("[data-id=e3]", "nobody has decided yet")
        _open(v, "waiting")
        v.sees("[data-id=e4]", "Lacks coordinates of D9")
        _open(v, "decisions")
        v.sees("[data-decision=snoop]", "by the site itself")
        v.sees("[data-decision=accept]", "slope distance P2 D4")
        assert v.complaints == []


def test_an_ended_epoch_is_read_again_for_what_concerns_it(browser, server):
    """The service reads its journal for it; what arrives belongs to the present epoch."""
    server.site.leave_out()
    with visit(browser, server, at="#/small/epochs/10") as v:
        _open(v, "rejected")
        v.sees("[data-id=e0]")

        def times():
            return len([r for r in v.requests if "rejected?epoch" in r])

        before, row = times(), server.site.arrive()
        heard = "id => import('/page/live.js').then(m => m.stateOf(11, id) === 'accepted')"
        v.holds(heard, row["id"])
        v.page.wait_for_timeout(700)
        assert times() == before
        server.site.post("small", {"do": "accept", "ids": ["e0"], "epoch": 10}, "office")
        v.page.wait_for_selector("[data-part=rejected] [data-id=e0]", state="detached")
        v.sees(OPENED.format("rejected"), "Rejected (2)")
        assert times() > before


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_decision_is_made_by_keyboard_on_a_phone_in_german(browser, server, scheme):
    server.site.leave_out()
    options = {"size": PHONE, "language": "de-DE", "scheme": scheme}
    with visit(browser, server, at="#/small/epochs/10", **options) as v:
        v.page.locator(OPENED.format("rejected")).focus()
        v.page.keyboard.press("Enter")
        v.sees("[data-id=e0]", "grober Fehler")
        assert audit(v.page, phone=True) == []
        v.page.locator("[data-id=e0] [data-act=accept]").focus()
        v.page.keyboard.press("Enter")
        v.sees("dialog", "Sie kommt in Epoche 10, die beendet ist")
        v.page.keyboard.press("Escape")
        assert server.site.networks["small"].observations["e0"]["state"] == "rejected"
        v.page.keyboard.press("Enter")
        v.press("Annehmen", within="dialog")
        v.sees("#say", "ist angenommen")
        v.sees(OPENED.format("rejected"), "Verworfen (2)")
        v.sees(OPENED.format("decisions"), "Entscheidungen (4)")
        assert server.site.networks["small"].observations["e0"]["state"] == "accepted"
        assert v.complaints == []


def test_a_rejection_is_taken_back_by_keyboard_on_a_phone_in_german(browser, server):
    server.site.leave_out()
    options = {"size": PHONE, "language": "de-DE"}
    with visit(browser, server, at="#/small/epochs/10", **options) as v:
        v.page.locator(OPENED.format("rejected")).focus()
        v.page.keyboard.press("Enter")
        v.sees("[data-id=e2]", "verworfen durch office")
        assert not v.page.locator("[data-id=e0] [data-act=revoke]").count(), "a test rejected it"
        v.page.locator("[data-part=rejected] [data-id=e2] [data-act=revoke]").focus()
        v.page.keyboard.press("Enter")
        v.sees("dialog", "wieder wie vor der Entscheidung")
        v.sees("dialog", "Epoche 10 ist beendet")
        assert audit(v.page, phone=True) == []
        v.press("Zurücknehmen", within="dialog")
        v.sees("#say", "ist zurückgenommen")
        v.sees(OPENED.format("rejected"), "Verworfen (2)")
        assert server.site.networks["small"].observations["e2"]["state"] == "accepted"
        assert v.complaints == []


def test_a_viewer_reads_reasons_and_decides_nothing(browser, guarded):
    guarded.site.leave_out()
    with visit(browser, guarded, wait=False, blank=True) as v:
        cookie = {"name": "session", "value": "viewer-token", "url": guarded.url}
        v.page.context.add_cookies([cookie])
        v.page.goto(guarded.url + "#/small/epochs/10")
        v.sees(OPENED.format("rejected"))
        _open(v, "rejected")
        v.sees("[data-id=e0]", "gross error")
        assert v.page.locator("[data-act]").count() == 0


def test_the_list_of_epochs_says_which_have_left_something_out(browser, server):
    server.site.leave_out()
    with visit(browser, server, at="#/small/epochs") as v:
        v.sees("tr[data-name='10']")
        heads = v.page.locator("#view thead th").all_inner_texts()
        column = next(n for n, text in enumerate(heads) if text.startswith("Left out"))
        for name, expected in (("10", "4"), ("5", "0"), ("11", "–")):
            row = v.page.locator(f"tr[data-name='{name}']")
            assert row.evaluate("(row, n) => row.cells[n].textContent", column) == expected


def test_a_standard_deviation_outside_its_limits_is_marked(browser, server):
    epochs = server.site.networks["small"].epochs
    for number, sigma0 in ((7, 1.9), (8, 0.4), (9, 1.2)):
        epochs[number] |= {"sigma0": sigma0, "sigma0_limits": [0.52, 1.48]}
    with visit(browser, server, at="#/small/epochs") as v:
        v.sees("tr[data-name='7'] .pill", "above its limits")
        v.sees("tr[data-name='8'] .pill", "below its limits")
        for name in ("9", "6"):  # inside; an older result has no limits
            assert not v.page.locator(f"tr[data-name='{name}'] .pill.doubts").count()
        v.go("epochs/7")
        v.sees("[data-figure=sigma0] .note", re.compile("0.52\\s…\\s1.48"))
        v.sees("[data-figure=sigma0] .pill", "above its limits")
        v.go("epochs/6")
        assert v.sees("[data-figure=sigma0] dd").inner_text() == f"{epochs[6]['sigma0']:.3f}"


def test_lists_of_verdicts_say_of_which_epoch_they_are(browser, server):
    server.site.leave_out()
    with visit(browser, server, at="#/small/verdicts/rejected") as v:
        v.sees("#verdict-panel .note", "Epoch 11")
        v.page.get_by_role("link", name="what epoch 10 has left out").click()
        v.sees(OPENED.format("rejected"), "Rejected (3)")


def test_of_an_epoch_whose_readings_were_dropped_it_is_told_that_it_is_over(browser, server):
    server.site.leave_out()
    server.site.networks["small"].epochs[10]["state"] = "dropped"
    with visit(browser, server, at="#/small/epochs/10", size=DESK) as v:
        v.sees("#view .note", "nothing can be decided about its 3 rejected ones")
        assert v.page.locator(OPENED.format("rejected")).is_hidden()


def test_an_epoch_that_uses_everything_says_so(browser, server):
    with visit(browser, server, at="#/small/epochs/5") as v:
        v.sees("#view .note", "Every observation of this epoch is used.")


# -- the service ----------------------------------------------------------------------------------


@pytest.fixture
def ended(tmp_path):
    """Four epochs of an hour; a distance of the second one has a gross error."""
    made = YardServer(tmp_path, epochs="1 h")
    for hour in range(4):
        given = readings(hour)
        wrong = {**given[3], "value": given[3]["value"] + 0.25, "id": "wrong"}
        answers = made.post(*given, *([wrong] if hour == 1 else []))
        assert all(a["ok"] for a in answers), answers
    yield made
    made.stop()


def test_a_reading_of_an_ended_epoch_of_the_service_is_accepted_and_taken_back(browser, ended):
    with visit(browser, ended, at="#/yard/epochs/2") as v, visit(browser, ended) as other:
        _open(v, "rejected")
        told = v.sees("[data-id=wrong]").inner_text().replace("\u00a0", " ")
        assert "gross error 2" in told and "it does not fit" in told, told
        v.page.locator("[data-id=wrong] [data-act=accept]").click()
        v.press("Accept", within="dialog")
        v.sees("#say", "is accepted")
        v.sees("#view dl", "Revision2")
        _open(v, "decisions")
        item = v.sees("[data-decision=accept] [data-id=wrong]")
        assert "slope distance A C" in item.inner_text()
        v.page.locator("[data-decision=accept] [data-act=revoke]").click()
        v.sees("dialog", "The observation is as it was before the decision")
        v.sees("dialog", "accepted by loopback")
        v.sees("dialog", "Epoch 2 has ended")
        v.press("Take back", within="dialog")
        v.sees("#say", "is taken back")
        v.sees("#view dl", "Revision3")
        v.sees("[data-decision=revoke]", "slope_distance A C")
        again = v.sees("[data-part=rejected] [data-id=wrong]").inner_text().replace("\u00a0", " ")
        assert "gross error 2" in again and "decision taken back by loopback" in again, again
        assert "rejected by its test when it arrived" in again
        v.sees("[data-part=rejected] [data-id=wrong] [data-act=accept]")
        other.go("epochs/3", network="yard")
        assert v.complaints == other.complaints == []


def test_a_verdict_is_decided_in_its_own_epoch(browser, ended):
    """Names of observations may be the same in several epochs."""
    reading = readings(3)[3]
    ended.post({**reading, "value": reading["value"] + 0.25, "id": "wrong"})
    with visit(browser, ended, at="#/yard/verdicts") as v:
        both = v.page.locator("[data-id=wrong][data-verdict=rejected]")
        v.sees("[data-id=wrong][data-verdict=rejected] >> nth=1")
        both.last.locator("[data-act=accept]").click()
        v.sees("dialog", "epoch 2, which has ended")
        v.press("Accept", within="dialog")
        v.sees("[data-id=wrong][data-verdict=rejected][data-now=accepted]")
        assert both.first.get_attribute("data-now") == "rejected", "that of the present epoch"
        both.first.locator("[data-act=accept]").click()
        v.sees("[data-id=wrong][data-verdict=rejected][data-now=accepted] >> nth=1")
        assert v.complaints == []


def test_an_ended_epoch_has_its_files(browser, server):
    with visit(browser, server, at="#/small/epochs/10") as v:
        link = v.page.get_by_role("link", name="report.html")
        assert link.get_attribute("href").endswith("/networks/small/report.html?epoch=10")
        assert link.get_attribute("download") == "small-epoch-10-report.html"
        v.go("epochs/11")
        v.sees("h1", "Epoch 11")
        assert v.page.get_by_role("link", name="report.html").count() == 0  # it is open
