"""The page of a site by keyboard alone."""

import pytest

pytest.importorskip("starlette", reason="the service of a site needs the extra serve")
pytest.importorskip("uvicorn", reason="the service of a site needs the extra serve")

from tests.site.browsers import PHONE, visit

FOCUS = """() => { const e = document.activeElement;
  return e.getAttribute('aria-label') || e.textContent.trim() || e.id || e.tagName; }"""
OUTLINE = """() => { const s = getComputedStyle(document.activeElement);
  return s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 2; }"""


def _tab_to(v, name, most=60):
    """Press Tab until a control with this name has the focus, which must be visible on all."""
    for _ in range(most):
        v.page.keyboard.press("Tab")
        if v.page.evaluate("document.activeElement !== document.body"):
            assert v.page.evaluate(OUTLINE), v.page.evaluate(FOCUS)
        if v.page.evaluate(FOCUS).startswith(name):
            return
    raise AssertionError(f"no {name} within {most} steps")


def test_a_suspect_is_decided_by_keys_alone(browser, server):
    rows = server.site.networks["small"].observations
    with visit(browser, server) as v:
        keys = v.page.keyboard
        _tab_to(v, "Skip to the content")
        _tab_to(v, "Verdicts")
        keys.press("Enter")
        v.sees("h1", "Verdicts")
        _tab_to(v, "Arriving")
        keys.press("ArrowRight")
        v.sees("[data-id=s0]")
        v.holds("() => document.activeElement.id === 'tab-suspects'")
        _tab_to(v, "Accept: ")
        keys.press("Enter")
        v.page.wait_for_selector("[data-id=s0]", state="detached")
        assert rows["s0"]["state"] == "accepted"
        _tab_to(v, "Replace: ")
        keys.press("Enter")
        v.sees("dialog")
        keys.press("Escape")
        v.page.wait_for_selector("dialog", state="detached")
        assert v.page.evaluate(FOCUS).startswith("Replace: ")  # the focus comes back
        assert rows["s1"]["state"] == "suspect"


def test_the_content_is_reached_at_once(browser, server):
    with visit(browser, server) as v:
        v.page.keyboard.press("Tab")
        v.page.keyboard.press("Enter")
        assert v.page.evaluate("document.activeElement.id") == "main"


def test_rows_are_walked_through_and_opened(browser, server):
    with visit(browser, server, at="#/small/points") as v:
        v.sees("tr[data-name=D3]")
        keys = v.page.keyboard
        _tab_to(v, "P1")
        assert v.page.evaluate("document.activeElement.dataset.name") == "P1"
        for _ in range(5):
            keys.press("ArrowDown")
        assert v.page.evaluate("document.activeElement.dataset.name") == "D3"
        server.site.arrive(target="D3")  # the table is drawn again under the focus
        v.page.wait_for_timeout(2500)
        assert v.page.evaluate("document.activeElement.dataset.name") == "D3"
        keys.press("End")
        assert v.page.evaluate("document.activeElement.dataset.name") == "D9"
        keys.press("Home")
        keys.press("ArrowDown")
        keys.press("Enter")
        v.sees("h1", "P2")
        assert v.page.evaluate("document.activeElement.tagName") == "H1"


def test_an_alarm_is_acknowledged_by_keys_alone(browser, server):
    alarm = server.site.raise_alarm()
    with visit(browser, server, size=PHONE) as v:
        v.sees("[data-alarm]")
        _tab_to(v, "Acknowledge")
        v.page.keyboard.press("Space")
        v.sees("dialog", "Acknowledge alarm")
        v.page.keyboard.press("Enter")
        v.sees("[data-alarm] .pill.acknowledged")
        assert alarm["state"] == "acknowledged"


def test_the_plan_lets_the_focus_go_on(browser, server):
    with visit(browser, server, at="#/small/plan") as v:
        v.sees("canvas")
        _tab_to(v, "Plan of the network")
        v.page.keyboard.press("n")
        v.sees(".planbox .chosen", "P1")
        _tab_to(v, "Time series, observations")
        v.page.keyboard.press("Enter")
        v.sees("h1", "P1")
