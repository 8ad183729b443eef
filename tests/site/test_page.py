"""The page of a site in a browser: every button, reconnection, two browsers, keyboard, phones."""

import re

import pytest

pytest.importorskip("starlette", reason="the service of a site needs the extra serve")
pytest.importorskip("uvicorn", reason="the service of a site needs the extra serve")

from factorgraph_adj.site.alarm_log import MAX_SILENCE_HOURS
from tests.site.browsers import DESK, PHONE, VIEWS, visit
from tests.site.page_audits import audit

LONG = pytest.mark.slow("every view in both languages, themes and sizes; short tests see one")

NAMELESS = """() => [...document.querySelectorAll('button, a, input, select, canvas, summary')]
  .filter(e => e.offsetParent !== null)
  .filter(e => !(e.getAttribute('aria-label') || e.textContent.trim() || e.title
    || [...(e.labels ?? [])].some(l => l.textContent.trim())))
  .map(e => e.outerHTML)"""
"""Controls without a name for a screen reader."""
UNCOVERED = """() => [...document.querySelectorAll('.banner:not([hidden]), main h1, .light h2')]
  .filter(e => { const b = e.getBoundingClientRect();
    return !e.contains(document.elementFromPoint(b.left + 4, b.top + b.height / 2)); })
  .map(e => e.outerHTML)"""
"""Titles and banners that something else covers."""


def _enter(visitor, role):
    visitor.page.locator("input[name=token]").fill(f"{role}-token")
    visitor.press("Log in")
    visitor.page.wait_for_selector("#view")


# -- the whole page -------------------------------------------------------------------------------

CASES = [
    pytest.param(DESK, "en-GB", "light", id="desk"),
    pytest.param(PHONE, "de-DE", "dark", id="phone-de-dark"),
    pytest.param(DESK, "de-DE", "dark", id="desk-de-dark", marks=LONG),
    pytest.param(PHONE, "en-GB", "light", id="phone", marks=LONG),
]


@pytest.mark.parametrize(("size", "language", "scheme"), CASES)
def test_every_view_is_quiet_named_and_as_wide_as_the_screen(
    browser, server, size, language, scheme
):
    server.site.raise_alarm()
    for state in ("accepted", "suspect", "rejected", "waiting"):
        server.site.arrive(state=state)
    with visit(browser, server, size=size, language=language, scheme=scheme) as v:
        assert v.page.evaluate("document.documentElement.lang") == language[:2]
        assert v.page.evaluate("document.documentElement.dataset.theme") == scheme
        places = (
            *VIEWS,
            "points/D3",
            "epochs/10",
            *(f"verdicts/{t}" for t in ("causes", "doubts")),
        )
        for place in places:
            v.go(place)
            v.holds("() => !/ …$/m.test(document.querySelector('#view').innerText.trim())")
            assert v.page.evaluate(NAMELESS) == [], place
            assert audit(v.page, phone=size == PHONE) == [], place
            assert v.page.evaluate(UNCOVERED) == [], place
            assert "⟨" not in v.page.evaluate("document.body.innerText"), place
            assert v.page.locator("h1").count() == 1
        assert v.complaints == []
        assert {re.match(r"\w+://[^/]+/", r)[0] for r in v.requests} == {server.url}


def test_times_are_local_and_have_utc_in_their_titles(browser, server):
    with visit(browser, server) as v:
        v.go("instruments")
        time = v.sees("time")
        assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC", time.get_attribute("title"))
        v.go("more")
        v.sees("#view .note", re.compile(r"local times of this device \(\w+"))


def test_language_and_colours_are_switched_and_remembered(browser, server):
    with visit(browser, server) as v:
        v.go("more")
        v.page.locator("[data-setting=language]").select_option("de")
        v.sees("h1", "Mehr")
        v.page.locator("[data-setting=theme]").select_option("dark")
        assert v.page.evaluate("document.documentElement.dataset.theme") == "dark"
        v.page.reload()
        v.sees("h1", "Mehr")
        assert v.page.evaluate("document.documentElement.dataset.theme") == "dark"
        assert v.page.evaluate("document.documentElement.lang") == "de"
        v.page.locator("[data-setting=theme]").select_option("")
        assert v.page.evaluate("document.documentElement.dataset.theme") == "light"
        assert v.complaints == []


# -- the light and alarms -------------------------------------------------------------------------


def test_the_light_says_why(browser, server):
    site = server.site
    for row in site.networks["small"].observations.values():
        row["state"] = "accepted"
    with visit(browser, server) as v:
        v.sees(".light.ok", "observations fit together")
        row = site.arrive(state="suspect")
        v.sees(".light.doubts", "One suspect observation waits")
        v.sees("#lamp", "Check")
        site.fail_instrument("ts1", "connecting", "connection refused")
        v.sees(".light.doubts", "ts1")
        site.raise_alarm()
        v.sees(".light.alarm", "crest: displacement of D3 since")
        v.sees(".light.alarm", "12.3 mm, test value 31.25, limit 25.56")
        assert v.page.title().startswith("⚠")
        assert v.page.evaluate(UNCOVERED) == []
        v.holds("() => /crest/.test(document.getElementById('say-alarm').textContent)")
        assert v.page.locator("#say-alarm").get_attribute("role") == "alert"
        assert row["id"] in site.networks["small"].observations


def test_late_readings_of_an_ended_epoch_leave_the_figures_of_the_present_one(browser, server):
    site, net = server.site, server.site.networks["small"]
    figure = "[data-figure=observations] dd"
    with visit(browser, server) as v:
        v.sees(figure, str(net.counts()["observations"]))
        late = net.counts() | {"observations": 7777}
        site.tell("arrival", "small", epoch=net.epochs[-1]["number"] - 1, ok=True, counts=late)
        site.arrive()
        v.sees(figure, str(net.counts()["observations"]))
        assert "7777" not in v.text("#view")


def test_figures_that_belong_together_are_of_one_answer(browser, server):
    site, net = server.site, server.site.networks["small"]
    figure = "[data-figure=redundancy] dd"
    with visit(browser, server) as v:
        before = str(net.counts()["redundancy"])
        v.sees(figure, before)
        v.sees("[data-figure=sigma0] .note", "0.87")
        site.hanging = "networks/small"
        row = site.arrive()
        other = net.counts() | {"redundancy": 8}
        site.tell("arrival", "small", epoch=net.epochs[-1]["number"], ok=True, counts=other)
        came = "m.context.log.some(e => e.data?.counts?.redundancy === 8)"
        v.holds(f"() => import('/page/live.js').then(m => {came})")
        # The limits are those of the former redundancy: it stays until both are read.
        assert (v.text(figure), row["state"]) == (before, "accepted")
        site.hanging = "?"
        v.sees(figure, str(net.counts()["redundancy"]))
        v.go("points/D3")
        v.sees("[data-figure=ellipse] dd", "mm")
        v.page.route("**/networks/small/points", lambda r: None)  # no answer
        site.arrive(target="D3")
        v.sees("[data-figure=ellipse] dd", re.compile("^–$"))
        v.page.unroute("**/networks/small/points")


def test_an_epoch_of_the_project_without_readings_is_not_listed(browser, server):
    net = server.site.networks["small"]
    assert net.epochs[0]["number"] == 0
    with visit(browser, server) as v:
        v.go("epochs")
        v.sees("tr[data-name='0']")
        net.epochs[0] |= {"sigma0": None, "counts": {"observations": 0}}
        v.page.reload()
        v.sees("tr[data-name='1']")
        assert not v.page.locator("tr[data-name='0']").count()


def test_words_of_the_service_are_marked_as_english(browser, server):
    with visit(browser, server, language="de-DE") as v:
        v.go("points/D4")
        told = v.sees(".cards strong[lang=en][title]").get_attribute("title")
        assert told.startswith("aim at ")
        answers = {"error": [{"where": "", "what": "the database is away"}]}
        v.page.route("**/postings", lambda r: r.fulfill(status=503, json=answers))
        v.go("verdicts/suspects")
        v.sees("[data-act=accept]").click()
        v.sees(".problem", "Nicht ausgeführt: der Dienst kann das jetzt nicht")
        v.sees(".problem span[lang=en]", "(the database is away)")


def test_what_could_not_be_read_makes_no_green_light(browser, server):
    for row in server.site.networks["small"].observations.values():
        row["state"] = "accepted"
    with visit(browser, server, wait=False) as v:
        answers = {"error": [{"where": "", "what": "broken"}]}
        v.page.route("**/api/v1/alarms?*", lambda r: r.fulfill(status=500, json=answers))
        v.page.reload()
        v.sees(".light.doubts", "Alarms could not be read")
        v.page.unroute("**/api/v1/alarms?*")
        v.page.route("**/api/v1/alarms?*", lambda r: r.fulfill(status=404, json=answers))
        v.page.reload()
        v.sees(".light.ok", "no rules for alarms")


def test_problems_of_the_service_are_told(browser, server):
    server.site.tell("problem", None, what="a message to chief@example.org is given up")
    with visit(browser, server) as v:
        v.sees("#problems li", "given up")
        server.site.tell("problem", None, what="https://example.org/hook answers 500")
        v.sees("#problems li:first-child", "answers 500")


def test_an_alarm_leads_to_its_points_and_stays_when_it_has_ended(browser, server):
    alarm = server.site.raise_alarm(points=["D4", "D3"])
    with visit(browser, server) as v:
        links = v.page.locator(f"[data-alarm='{alarm['id']}'] a")
        links.first.wait_for()
        assert links.all_inner_texts() == ["D4", "D3", "10"]
        v.sees(".alarmbar a").click()
        v.sees("h1", "D4")
        v.go("overview")
        v.sees("#alarms [data-alarm]")
        assert v.page.locator("#ended-alarms").is_hidden()
        alarm |= {"state": "closed", "until": alarm["since"] + 20}
        server.site.tell("alarm", "small", alarm=alarm)
        v.sees("#ended-alarms summary", "1 alarm has ended and was not acknowledged").click()
        v.sees("#ended-alarms a", "D4")


@pytest.mark.parametrize("language", ["en-GB", "de-DE"])
def test_alarms_that_have_ended_are_acknowledged_by_keys_on_a_phone(browser, server, language):
    """Each leaves what wants attention; the log of its point keeps it, with who and why."""
    first, other = (server.site.raise_alarm(r, points=["D4"]) for r in ("crest", "wall"))
    for alarm in (first, other):
        alarm |= {"state": "closed", "until": alarm["since"] + 20}
    texts = {
        "en-GB": ("2 alarms have ended", "1 alarm has ended", "which has ended", "Remark"),
        "de-DE": ("2 Alarme sind beendet", "1 Alarm ist beendet", "der beendet ist", "Bemerkung"),
    }
    several, one, asked, remark = texts[language]
    with visit(browser, server, size=PHONE, language=language) as v:
        v.sees("#ended-alarms summary", several).focus()
        v.page.keyboard.press("Enter")
        v.page.keyboard.press("Tab")
        v.page.locator(f"[data-key=ack-{first['id']}]").focus()
        v.page.keyboard.press("Enter")
        v.sees("dialog", asked)
        assert audit(v.page, phone=True) == []
        v.page.get_by_label(remark).fill("survey of the crest: nothing moved")
        v.page.keyboard.press("Enter")
        v.sees("#ended-alarms summary", one)
        assert first["acknowledged"] and first["state"] == "closed" and not other["acknowledged"]
        v.holds("key => document.activeElement.dataset.key === key", f"ack-{other['id']}")
        v.page.keyboard.press("Enter")
        v.sees("dialog", asked)
        v.page.keyboard.press("Enter")
        v.page.wait_for_selector("#ended-alarms[hidden]", state="attached")
        assert other["acknowledged"] and "remark" not in other
        v.go("points/D4")
        v.sees(f"[data-alarm='{first['id']}'] .why", "survey of the crest: nothing moved")
        v.sees(f"[data-alarm='{first['id']}'] .why", first["by"])
        assert v.page.locator("[data-alarm] [data-key^=ack]").count() == 0
        assert v.complaints == []


def test_alarms_are_acknowledged_and_silenced(browser, server):
    alarm = server.site.raise_alarm()
    with visit(browser, server) as v:
        v.press("Silence", within="#alarms")
        field = v.page.locator("dialog input")
        field.press("2")
        assert field.input_value() == "2", "what is typed replaces what is offered"
        for wrong in ("0", f"{MAX_SILENCE_HOURS + 1:g}"):
            field.fill(wrong)
            v.press("Silence", within="dialog")
            v.sees("dialog .problem", f"above 0, and {MAX_SILENCE_HOURS:g} at most")
        v.page.locator("dialog input").fill("2.5")
        v.press("Silence", within="dialog")
        v.sees("[data-alarm] .pill.silenced")
        assert alarm["state"] == "silenced"
        v.press("Acknowledge", within="#alarms")
        v.sees("dialog", "Acknowledge alarm")
        v.page.evaluate("location.hash = '#/small/points'")  # what is asked does not stay
        v.page.wait_for_selector("dialog", state="detached")
        v.go("overview")
        v.press("Acknowledge", within="#alarms")
        v.page.get_by_label("Remark").fill("a crane stands there")
        v.press("Acknowledge", within="dialog")
        v.sees("[data-alarm] .why", "a crane stands there")
        v.sees("[data-alarm] .why", "acknowledged")  # and still silent
        v.sees(".light.doubts", "Silenced, still standing")
        assert alarm["acknowledged"] and alarm["state"] == "silenced"
        other = server.site.raise_alarm("wall")
        mine = f"[data-alarm='{other['id']}']"
        v.press("Acknowledge", within=mine)
        v.press("Acknowledge", within="dialog")
        v.sees(f"{mine} .pill.acknowledged")
        v.sees(".light.doubts", "Acknowledged, still standing")
        assert v.page.locator(mine).get_by_role("button", name="Acknowledge").count() == 0
        assert v.complaints == []


# -- verdicts -------------------------------------------------------------------------------------


def test_a_verdict_is_decided_by_every_button(browser, server):
    rows = server.site.networks["small"].observations
    with visit(browser, server) as v:
        v.go("verdicts/suspects")
        v.sees("[data-id=s0] .why", "exceeds 1")
        v.page.locator("[data-id=s0] [data-act=accept]").click()
        v.sees("#say", "is accepted")
        v.page.wait_for_selector("[data-id=s0]", state="detached")
        v.page.locator("[data-id=s1] [data-act=reject]").click()
        v.sees("#view", "Epoch 11: no observation is suspect.")
        assert (rows["s0"]["state"], rows["s1"]["state"]) == ("accepted", "rejected")
        v.go("verdicts/rejected")
        v.sees("[data-id=s1] .why", "rejected by")
        v.page.locator("[data-id=s1] [data-act=revoke]").click()
        v.press("Take back", within="dialog")
        v.page.wait_for_selector("[data-id=s1]", state="detached")
        assert rows["s1"]["state"] == "suspect"
        v.go("verdicts/suspects")
        v.page.locator("[data-id=s1] [data-act=reject]").click()
        v.sees("#view", "Epoch 11: no observation is suspect.")
        v.go("verdicts/rejected")
        v.page.locator("[data-id=s1] [data-act=accept]").click()
        v.page.wait_for_selector("[data-id=s1]", state="detached")
        v.go("verdicts/waiting")
        v.sees("[data-id=s3] .why", "Lacks coordinates of D9")
        v.page.locator("[data-id=s3] [data-act=remove]").click()
        v.sees("dialog", "in no list afterwards")
        v.press("Cancel", within="dialog")
        assert rows["s3"]["state"] == "waiting"
        v.page.locator("[data-id=s3] [data-act=remove]").click()
        v.press("Remove", within="dialog")
        v.sees("#view", "Epoch 11: no observation waits.")
        assert rows["s3"]["state"] == "gone"


def test_sigma_and_values_are_changed(browser, server):
    row = server.site.arrive()
    with visit(browser, server) as v:
        v.go("verdicts")
        one = f"[data-id={row['id']}]"
        v.page.locator(f"{one} [data-act=sigma]").click()
        v.page.locator("dialog input").fill("-1")
        v.press("Change", within="dialog")
        v.sees("dialog .problem")
        v.page.locator("dialog input").fill("2")
        v.press("Change", within="dialog")
        v.sees("#say", "2 times")
        assert row["record"]["sigma_mm"] == pytest.approx(3.0)
        v.page.locator(f"{one} [data-act=replace]").first.click()
        v.page.locator("dialog input[name=value]").fill("x")
        v.press("Replace", within="dialog")
        v.sees("dialog .problem", "value")
        v.page.locator("dialog input[name=value]").fill("124,5")
        v.press("Replace", within="dialog")
        v.sees(f"[data-id={row['id']}b]")
        new = server.site.networks["small"].observations[f"{row['id']}b"]
        assert new["record"]["value"] == 124.5
        assert new["record"]["station"] == "P1"
        v.sees(f"{one} .pill.gone")


def test_what_arrives_is_listed_held_and_sifted(browser, server):
    site = server.site
    with visit(browser, server) as v:
        v.go("verdicts")
        first = site.arrive()
        v.sees(f"[data-id={first['id']}]")
        v.press("Hold the list")
        second = site.arrive(state="suspect")
        v.sees("#view", "1 new")
        assert v.page.locator(f"[data-id={second['id']}]").count() == 0
        v.press("Hold the list")
        v.sees(f"[data-id={second['id']}]")
        v.page.get_by_label("only what did not fit").check()
        assert v.page.locator(f"[data-id={first['id']}]").is_hidden()
        site.tell("refused", "small", answer={"error": [{"where": "value", "what": "no number"}]})
        v.sees("[data-verdict=refused]", "value: no number")
        v.page.reload()
        v.sees(f"[data-id={second['id']}]")  # from the log of the service


def test_a_refused_command_says_why(browser, server):
    with visit(browser, server) as v:
        v.go("verdicts/suspects")
        v.sees("[data-id=s0]")
        del server.site.networks["small"].observations["s0"]
        v.page.locator("[data-id=s0] [data-act=accept]").click()
        v.sees("[data-id=s0] .problem", "unknown observation s0")
        assert v.page.locator("[data-id=s0] [data-act=accept]").is_enabled()


def test_a_verdict_in_one_browser_is_seen_in_the_other(browser, server):
    with visit(browser, server) as one, visit(browser, server, size=PHONE) as two:
        row = server.site.arrive(state="suspect")
        for v in (one, two):
            v.go("verdicts")
            v.sees(f"[data-id={row['id']}] [data-act=accept]")
        one.page.locator(f"[data-id={row['id']}] [data-act=accept]").first.click()
        two.sees(f"[data-id={row['id']}][data-now=accepted]")
        two.go("overview")
        one.go("overview")
        for v in (one, two):
            v.holds("() => document.querySelector('[data-figure=suspects] a')?.textContent === '2'")


def test_causes_and_doubts_are_shown(browser, server):
    site = server.site
    site.doubts = ["The side of D9 is told by one observation alone."]
    cause = {"cause": "height of instrument", "where": "P1", "error": [0.1], "sigma": [0.002]}
    cause |= {"t2": 2500.0, "dof": 1, "critical": 10.8, "ids": ["s0", "s1"]}
    site.causes = {"most_probable": "The height of the instrument at P1 is wrong by 100 mm."}
    site.causes |= {"undecided": [], "causes": [cause]}
    with visit(browser, server) as v:
        v.go("verdicts/causes")
        v.sees("#view", "wrong by 100 mm")
        v.sees("#view li", "height of instrument P1")
        v.go("verdicts/doubts")
        v.sees("#view li", "The side of D9")


# -- connection -----------------------------------------------------------------------------------


def test_figures_without_a_connection_are_not_shown_as_current(browser, server):
    with visit(browser, server) as v:
        v.sees(".light.doubts")
        v.go("verdicts")
        before = server.site.arrive()
        v.sees(f"[data-id={before['id']}]")
        server.stop()
        v.sees(".banner", "Connection lost since")
        v.sees(".fresh", "NOT CURRENT")
        v.sees("#lamp", "Unknown")
        v.go("overview")
        v.sees(".light.unknown", "The connection to the service is lost")
        assert "alarm" not in v.text("#lamp").lower()
        missed = server.site.arrive(state="suspect")
        server.start()
        v.page.wait_for_selector(".banner", state="hidden")
        v.go("verdicts")
        v.sees(f"[data-id={missed['id']}]")
        assert v.page.locator(f"[data-id={missed['id']}]").count() == 1
        assert v.page.locator(f"[data-id={before['id']}]").count() == 1
        v.sees(".fresh", "Current at")


SHOWN = "[...document.querySelectorAll('#view li[data-id]')].map(e => e.dataset.id)"
"""Rows of the page, the newest first."""


def test_what_was_missed_comes_in_its_order(browser, server):
    """More than the log of the service has at once, and slower than the log is read."""
    with visit(browser, server) as v:
        v.go("verdicts")
        server.stop()
        v.sees(".banner", "Connection lost since")
        missed = [server.site.arrive()["id"] for _ in range(140)]
        server.site.pace = 0.05
        server.start()
        v.holds(f"n => {SHOWN}.filter(id => n.includes(id)).length === n.length", missed)
        shown = v.page.evaluate(SHOWN)
        assert shown[: len(missed)] == missed[::-1]
        log = "async () => (await import('/page/live.js')).context.log.map(e => Number(e.id))"
        numbers = v.page.evaluate(log)
        assert numbers == sorted(set(numbers))


def test_stale_figures_tell_their_time_themselves(browser, server):
    with visit(browser, server) as v:
        v.sees("[data-figure=sigma0] dd")
        script = """() => getComputedStyle(document.querySelector('[data-figure=sigma0] dd'),
          '::after').content"""
        assert v.page.evaluate(script) == "none"
        server.stop()
        v.sees(".banner", "Connection lost")
        assert "of " in v.page.evaluate(script)
        v.go("plan")
        v.holds("() => window.planForTests?.stale.includes('NOT CURRENT')")
        server.start()


def test_a_connection_that_hangs_is_noticed(browser, server):
    with visit(browser, server) as v:
        v.sees(".fresh", "Current at")
        server.site.beating = False
        v.sees(".banner", "Connection lost")
        server.site.beating = True
        v.page.wait_for_selector(".banner", state="hidden")


def test_a_service_without_its_database_is_waited_for(browser, server):
    with visit(browser, server) as v:
        v.go("points")
        v.sees("tr[data-name=D3]")
        server.site.away = True
        v.sees(".banner", "Connection lost")
        v.go("epochs")
        v.sees("#view .problem", "the database is away")
        server.site.away = False
        v.sees("tr[data-name='10']")
        v.page.wait_for_selector(".banner", state="hidden")


# -- points, epochs, instruments, files -----------------------------------------------------------


def _column(v, number):
    script = (
        "([n]) => [...document.querySelectorAll('#view tbody tr')].map(r => r.cells[n].innerText)"
    )
    return v.page.evaluate(script, [number])


def test_points_are_sorted_filtered_and_opened(browser, server):
    with visit(browser, server) as v:
        v.go("points")
        v.sees("tr[data-name=D3]")
        sigma = v.page.get_by_role("columnheader", name="max. σ [mm]")
        sigma.get_by_role("button").click()
        assert sigma.get_attribute("aria-sort") == "descending"
        found = [float(t) for t in _column(v, 7) if t != "–"]
        assert found == sorted(found, reverse=True)
        assert _column(v, 7)[-1] == "–"
        v.page.get_by_label("Filter: z [m]").fill("> 119")
        assert set(_column(v, 0)) == {"D1", "D2", "D3", "D4"}
        v.page.get_by_label("Search: Points").fill("d3")
        assert _column(v, 0) == ["D3"]
        v.page.locator("tr[data-name=D3] td").nth(3).click()
        v.sees("h1", "D3")


def test_the_page_of_a_point_has_all_of_it(browser, server):
    site = server.site
    site.raise_alarm()
    row = site.arrive(target="D3")
    with visit(browser, server, at="#/small/points/D3") as v:
        v.sees("#view", "Protection level, risk 0.001")
        v.sees("[data-figure=protection] dd", "horizontal 7.1 mm, vertical 9.3 mm")
        v.sees("#view", "least controlled: slope distance P1 D3")
        v.sees("#view", "Error of position now 1.80 mm")
        v.sees("#view li", "P2 → D3")
        v.sees("#view li", "then 1.24 mm, gain 31.0 %")
        v.sees("[data-alarm]", "crest")
        v.sees(f"[data-id={row['id']}]")
        v.page.wait_for_selector(".plot[data-made]")
        names = (
            "() => document.querySelector('.plot').data.filter(t => t.showlegend).map(t => t.name)"
        )
        wanted = {"± σ", "detectable displacement", "motion model", "displacement"}
        assert set(v.page.evaluate(names)) == wanted
        assert "crest" in v.page.evaluate(
            "document.querySelector('.plot').layout.annotations[0].text"
        )
        v.sees("#view", "significant (above 3 σ)")
        v.page.get_by_text("Values of the time series").first.click()
        v.sees("details table tbody tr")
        before = v.text("[data-figure=x] dd")
        site.networks["small"].points[5]["x"] += 0.0123
        site.arrive(target="D3")
        v.holds("old => document.querySelector('[data-figure=x] dd').textContent !== old", before)
        v.go("points/nobody")
        v.sees("#view .problem", "no point nobody")
        v.go("points/D4")
        v.sees("[data-figure=protection] dd", "vertical ∞")  # nothing controls it
        v.go("points/D9")
        v.sees("#view", "undetermined")
        assert v.complaints == []


def test_epochs_are_opened_and_ended(browser, server):
    with visit(browser, server) as v:
        v.go("epochs")
        v.sees("tr[data-name='10'] .pill.moved", "2 points moved")
        v.sees("tr[data-name='8'] .pill.stable")
        v.sees("tr[data-name='4'] .pill.moved", "shape changed")
        v.page.wait_for_selector(".plot[data-made]")
        assert len(v.page.evaluate("document.querySelector('.plot').data.map(t => t.name)")) == 4
        v.press("End the present epoch")
        v.press("End the present epoch", within="dialog")
        v.sees("tr[data-name='12']")
        assert server.site.networks["small"].epochs[-1]["number"] == 12
        v.page.locator("tr[data-name='10'] a").first.click()
        v.sees("#view", "The reference points are congruent with epoch 0")
        v.sees("#view", "Block 1")
        v.sees("tr[data-name=D3] .pill.moved")
        v.page.locator("tr[data-name=D3] a").click()
        v.sees("h1", "D3")


def test_instruments_show_their_health(browser, server):
    with visit(browser, server) as v:
        v.go("instruments")
        v.sees("[data-instrument=ts1] .pill.ok")
        v.sees("[data-instrument=ts1]", "Refused lines")
        assert "Late" not in v.text("[data-instrument=ts1]")  # what has not happened
        v.page.locator("[data-instrument=ts1] summary").click()
        v.sees("[data-instrument=ts1] li", "no line for 61 s")
        server.site.fail_instrument("ts1", "connecting", "connection refused by 10.0.0.12:4001")
        v.sees("[data-instrument=ts1] .pill.faulty", "no connection")
        v.sees("[data-instrument=ts1] .problem", "connection refused")
        assert v.page.locator("[data-instrument=ts2]").count() == 0  # of another network


def test_files_are_downloaded(browser, server):
    with visit(browser, server) as v:
        v.go("downloads")
        for name in ("report.html", "results.json", "network.gpkg", "project.zip"):
            with v.page.expect_download() as waiting:
                v.page.get_by_role("link", name=name, exact=True).click()
            assert waiting.value.suggested_filename == f"small-{name}"


def test_networks_are_changed(browser, server):
    with visit(browser, server) as v:
        v.page.get_by_label("Network", exact=True).select_option("tunnel")
        v.sees(".light.doubts", "Instrument ts2: silent")
        v.go("instruments", network="tunnel")
        v.sees("[data-instrument=ts2]", "connection refused")
        v.page.goto(server.url)
        v.sees("#view")
        assert v.page.evaluate("location.hash") == "#/tunnel/overview"  # remembered
        server.site.arrive("small")
        row = server.site.arrive("tunnel")
        v.go("verdicts", network="tunnel")
        v.sees(f"[data-id={row['id']}]")
        assert v.page.locator(".verdicts > li").count() == 1


# -- login and roles ------------------------------------------------------------------------------


def test_a_token_is_asked_for_and_a_lost_session_too(browser, guarded):
    with visit(browser, guarded, wait=False) as v:
        v.sees("h1", "Monitoring site")
        v.page.locator("input[name=token]").fill("guess")
        v.press("Log in")
        v.sees(".problem", "does not know this token")
        _enter(v, "surveyor")
        cookie = next(c for c in v.page.context.cookies() if c["name"] == "session")
        assert cookie["httpOnly"] and cookie["sameSite"] == "Strict"
        v.go("more")
        v.sees("#view", "Your role: surveyor")
        del guarded.site.tokens["surveyor-token"]
        v.page.evaluate("location.hash = '#/small/points'")
        v.sees(".problem", "session has ended")
        _enter(v, "viewer")
        v.go("more")
        v.press("Log out")
        v.sees("h1", "Monitoring site")
        v.page.reload()
        v.sees("h1", "Monitoring site")


@pytest.mark.parametrize(
    ("role", "decides", "rules"),
    [("viewer", False, False), ("surveyor", True, False), ("admin", True, True)],
)
def test_buttons_that_a_role_may_not_use_are_absent(browser, guarded, role, decides, rules):
    guarded.site.raise_alarm()
    with visit(browser, guarded, wait=False) as v:
        v.sees("h1", "Monitoring site")
        _enter(v, role)
        v.sees("[data-alarm]")
        assert (v.page.locator("[data-alarm] button").count() > 0) == decides
        v.go("verdicts/suspects")
        v.sees("[data-id=s0]")
        assert (v.page.locator("[data-act]").count() > 0) == decides
        v.go("epochs")
        v.sees("tr[data-name='10']")
        assert (v.page.get_by_role("button", name="End the present").count() > 0) == decides
        v.go("downloads")
        v.sees("#view a")
        assert (v.page.locator("#tokens").count() > 0) == rules


def test_tokens_are_made_and_removed(browser, guarded):
    with visit(browser, guarded, wait=False) as v:
        v.sees("h1", "Monitoring site")
        _enter(v, "admin")
        v.go("downloads")
        v.press("New token", within="#tokens")
        v.press("Make it", within="dialog")
        v.sees("dialog .problem", "whose token")
        v.page.locator("dialog input").fill("gate")
        v.page.locator("dialog select").select_option("viewer")
        v.press("Make it", within="dialog")
        secret = v.sees(".secret").text_content()
        assert guarded.site.tokens[secret]["role"] == "viewer"
        v.sees("#tokens tbody tr", "gate")
        v.press("Remove: gate", within="#tokens")
        v.press("Remove", within="dialog")
        v.holds("() => !/gate/.test(document.querySelector('#tokens tbody').innerText)")
        assert secret not in guarded.site.tokens
