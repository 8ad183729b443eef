"""Rarer states of the page of a site: how they look on a phone, and that they say what is so."""

import re

import pytest

pytest.importorskip("starlette", reason="the service of a site needs the extra serve")
pytest.importorskip("uvicorn", reason="the service of a site needs the extra serve")

from tests.site.browsers import DESK, PHONE, visit
from tests.site.canned_site import LAG
from tests.site.page_audits import audit
from tests.site.page_catalogue import STATES

NAMED = {s.name: s for s in STATES}


def _opened(browser, server, name, **look):
    NAMED[name].prepare(server.site)
    return NAMED[name].opened(browser, server, **look)


# -- how it looks ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["verdicts-held", "dialog-replace-wrong", "epoch-moved", "points-geocentric", "no-networks"],
)
def test_a_state_is_readable_and_wide_enough_for_a_finger(browser, server, name):
    with _opened(browser, server, name, size=PHONE, language="de-DE", scheme="dark") as v:
        assert audit(v.page, phone=True) == []


# -- what it says ---------------------------------------------------------------------------------


def test_an_epoch_without_observations_is_not_called_well(browser, server):
    with _opened(browser, server, "begun-overview", size=DESK) as v:
        v.sees(".light.unknown", "The present epoch has no observation yet.")
        v.sees("#lamp", "Unknown")


def test_a_network_that_the_site_does_not_have_is_told(browser, server):
    with _opened(browser, server, "unknown-network", size=DESK) as v:
        v.sees("#say", "This site has no network nowhere; Dam crest is shown.")


def test_a_page_that_waits_for_its_first_answer_says_so(browser, server):
    with _opened(browser, server, "loading-overview", size=PHONE) as v:
        v.sees("main", "Reading …")
        v.sees("#lamp", "Unknown")
    with _opened(browser, server, "loading-plan", size=PHONE) as v:
        v.sees(".planbox .told", "Reading …")


def test_of_a_point_that_is_unknown_nothing_else_is_said(browser, server):
    with _opened(browser, server, "point-unknown", size=DESK) as v:
        v.sees("#view .problem", "The network has no point nobody.")
        assert v.page.locator("#view h2:visible").count() == 0


def test_causes_have_sizes_in_the_units_of_the_page(browser, server):
    with _opened(browser, server, "verdicts-causes", size=DESK) as v:
        v.sees("#view li", "Size 100 ± 2.00 mm, T² 2500.0")


def test_a_velocity_of_a_point_that_has_jumped_is_not_called_significant(browser, server):
    with _opened(browser, server, "point", size=PHONE) as v:
        v.sees("#view .figures", "significant (above 3 σ)")
        assert v.page.locator("#view p.problem", has_text="constant velocity").count() == 0
        server.site.jumped = {"D3"}
        v.page.reload()
        v.sees("#view p.problem", "does not move at a constant velocity (T 900.0, limit ")
        assert "above 3 σ" not in v.page.locator("#view").inner_text()


def test_an_instrument_that_is_well_has_its_problem_in_the_past(browser, server):
    with _opened(browser, server, "instruments", size=DESK) as v:
        told = v.sees("[data-instrument=ts1] .note", "Last problem (")
        assert "3 h ago): the clock of the instrument jumped back" in told.inner_text()
        assert v.page.locator("[data-instrument=ts1] .problem").count() == 0
        v.sees("[data-instrument=gnss-east] .problem", "11 min ago): connection refused")
        v.go("overview")
        v.sees("#view .card .note", "Last problem (")
        v.sees("#view .card .problem", "connection refused")


def test_how_long_readings_take_to_arrive_is_told(browser, server):
    with _opened(browser, server, "instruments", size=PHONE) as v:
        for name, lag in (
            ("ts1", "45 s"),
            ("ts2", "the clock runs 5 h ahead"),
            ("level", "90 min"),
        ):
            v.sees(f"[data-instrument={name}] [data-figure=lag]", lag)


def test_verdicts_say_when_they_were_measured_and_when_they_came(browser, server):
    with visit(browser, server, at="#/small/verdicts") as v:
        row = server.site.arrive()
        told = v.sees(f"[data-id={row['id']}] .head").inner_text()
        assert re.search(r"measured \d\d:\d\d:\d\d · came \d\d:\d\d:\d\d · ts1", told), told
        times = v.page.eval_on_selector_all(
            f"[data-id={row['id']}] time", "all => all.map(t => Date.parse(t.dateTime) / 1000)"
        )
        assert times[1] - times[0] == pytest.approx(LAG, abs=1.0)
        server.site.post("small", {"do": "remove", "ids": [row["id"]]}, "office")
        v.sees("[data-verdict=command] .note", "office")
        suspect = server.site.arrive(state="suspect")
        v.sees(f"[data-id={suspect['id']}]")
        v.go("verdicts/suspects")
        v.sees(f"[data-id={suspect['id']}] .head", "measured")


def test_displacements_in_height_alone_are_told_as_such(browser, server):
    with _opened(browser, server, "plan-heights-compared", size=DESK) as v:
        v.sees(".planbox .chosen", re.compile(r"Moved, significant: \+\d+\.\d\s?mm in height"))
        (vector,) = v.page.evaluate("planForTests.vectors.filter(d => d.name === 'D3')")
        assert vector["dx"] is None and vector["up"] > 0.005
        v.go("points/D3", network="heights")
        v.page.wait_for_selector(".plot[data-made]")
        titles = "Object.keys(document.querySelector('.plot').layout).filter(k => /^yaxis/.test(k))"
        assert v.page.evaluate(titles) == ["yaxis"]


def test_a_network_of_heights_has_no_plan(browser, server):
    for name in ("plan-levelling", "3d-levelling"):
        with _opened(browser, server, name, size=DESK) as v:
            v.sees("#view .note", "heights only")
            assert v.page.locator("canvas:visible").count() == 0


def test_a_network_of_heights_shows_no_other_coordinates(browser, server):
    with _opened(browser, server, "points-levelling", size=DESK) as v:
        v.sees("thead", "z [m]")
        heads = v.page.locator("thead th").all_text_contents()
        assert not any(h.startswith(("x", "y", "σ x", "σ y")) for h in heads), heads
        row = v.page.locator("tbody tr", has_text="undetermined").locator("td").all_text_contents()
        assert row[:3] == ["–", "–", "–"]  # no σ of 0 for what nothing determines
    with _opened(browser, server, "point-levelling", size=DESK) as v:
        v.sees("[data-figure=z]", "σ")
        assert v.page.locator("[data-figure=x], [data-figure=y]").count() == 0


@pytest.mark.parametrize(
    ("network", "note", "figure"),
    [
        ("north", "x north, y east, z up", "x, north [mm]"),
        ("world", "in the axes of the frame; the plan is drawn in east, north and up", "x [m]"),
    ],
)
def test_axes_of_coordinates_are_named(browser, server, network, note, figure):
    with visit(browser, server, at=f"#/{network}/points") as v:
        v.sees("#view .note", note)
        v.go("points/D3", network=network)
        assert v.sees("[data-figure=x] dt").text_content() == figure
        v.sees("#view", note)
