"""States of the page of a site over canned data: how each comes about, and how it is opened."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import time
from typing import Any

from tests.site.browsers import Visitor, visit
from tests.site.canned_server import CannedServer
from tests.site.canned_site import CannedSite, instrument

Act = Callable[[Visitor], None]
Prepare = Callable[[CannedSite], None]
SETTLED = """() => !document.querySelector('#view')
  || ![...document.querySelectorAll('#view .plot')].some(p => p.offsetParent && !p.dataset.made
       && !p.textContent.trim())
  && !/ …$/m.test(document.querySelector('#view').innerText.trim())"""
"""Whether what a view reads has come and its figures are drawn."""
ERRORS = {
    403: "a viewer may not do this",
    429: "more than 200 requests a second; try again in 3 s",
    500: "a fault of the program",
    503: "the database is away",
}


def _nothing(_: Any) -> None:
    pass


@dataclass(frozen=True)
class PageState:
    """A state of the page."""

    name: str
    """What it shows."""
    place: str = "overview"
    """View and what it is about, as in the address."""
    network: str = "small"
    """Network."""
    prepare: Prepare = _nothing
    """What has happened at the site."""
    act: Act = _nothing
    """What the visitor does."""
    role: str = ""
    """Role of the visitor; empty: the site has no tokens."""
    before: Act | None = None
    """What is done before the page is opened, such as answers that fail; nothing is waited for."""

    @contextmanager
    def opened(self, browser: Any, server: CannedServer, **look: Any) -> Iterator[Visitor]:
        """Open the page in this state, over a server that is prepared.

        Args:
            browser: browser.
            server: the canned service.
            look: size, language and scheme, see `visit`.
        """
        at = f"#/{self.network}/{self.place}"
        with visit(browser, server, at=at, wait=False, blank=True, **look) as v:
            if self.role:
                v.page.context.add_cookies(
                    [{"name": "session", "value": f"{self.role}-token", "url": server.url}]
                )
            if self.before is not None:
                self.before(v)
            v.page.goto(server.url + at)
            v.page.wait_for_selector("h1" if self.before is None else "main")
            if self.before is None:
                v.holds(SETTLED)
            self.act(v)
            v.page.wait_for_timeout(350)
            yield v


# -- what has happened ---------------------------------------------------------------------------


def arrivals(site: CannedSite) -> None:
    """Let one observation of each verdict arrive, and a refused line."""
    for state in ("accepted", "suspect", "waiting", "rejected", "accepted"):
        site.arrive(state=state)
    error = [{"where": "value", "what": "no number: 12,x4"}]
    site.tell("refused", "small", answer={"error": error}, by="ts1")


def well(site: CannedSite) -> None:
    """Let every observation be accepted."""
    for row in site.networks["small"].observations.values():
        row["state"] = "accepted"


def alarmed(site: CannedSite) -> None:
    """Raise an alarm."""
    site.raise_alarm()


def known(site: CannedSite) -> None:
    """Raise three alarms: one stands, one is acknowledged, one is silent."""
    site.raise_alarm()
    site.decide_alarm(site.raise_alarm("wall", points=["D4"])["id"], "acknowledge", "office")
    more = {"points": [], "instrument": "ts1", "test": "silence", "unit": "s", "size_mm": None}
    more |= {"value": 2410, "limit": 1800, "text": "ts1 has sent nothing for 40 min"}
    more |= {"false_alarms_per_month": None, "epoch": None}
    site.decide_alarm(site.raise_alarm("quiet", **more)["id"], "silence", "office", 8.0)


def left_out(site: CannedSite) -> None:
    """Let an epoch that has ended have left observations out."""
    site.leave_out()


def dropped(site: CannedSite) -> None:
    """Let an epoch that has left observations out have lost its readings."""
    site.leave_out()
    site.networks["small"].epochs[10]["state"] = "dropped"


def cleared(site: CannedSite) -> None:
    """Raise an alarm that has ended."""
    site.raise_alarm(state="closed", until=time() - 20)


def ended(site: CannedSite) -> None:
    """Raise alarms that have ended before anybody acknowledged them."""
    for rule, point in (("crest", "D3"), ("wall", "D4")):
        site.raise_alarm(rule, points=[point], state="closed", until=time() - 20)


def instruments(site: CannedSite) -> None:
    """Let instruments be well, silent, without connection, stopped, and have troubles."""
    now = time()
    site.instruments = [
        instrument("ts1", "small", "ok", now - 2)
        | {"grammar": "gsi-online", "problem_time": now - 9000}
        | {"problem": "the clock of the instrument jumped back by 3600.0 s"},
        instrument("ts2", "small", "ok", now - 9)
        | {
            "lag_s": -18_400.0,
            "clock_jumps": 1,
            "clock_offset_s": 3599.6,
            "doubled": 4,
            "late": 12,
            "gaps": 3,
        }
        | {
            "events": [
                {"time": now - 900, "count": "clock_jumps", "what": "the clock jumped by 3600 s"},
                {"time": now - 90, "count": "gaps", "what": "no line for 61 s"},
            ]
        },
        instrument("level", "small", "silent", now - 86_400 * 3)
        | {"lag_s": 5400.0}
        | {"problem": "no line for 3 d", "problem_time": now - 4000},
        instrument("gnss-east", "small", "faulty", now - 700)
        | {"connection": "connecting", "problem": "connection refused by 10.0.0.12:4001"}
        | {"problem_time": now - 640, "source": "tcp://10.0.0.12:4001", "grammar": "nmea"},
        instrument("piezometer", "small", "stopped", now - 7000),
    ]


def causes(site: CannedSite) -> None:
    """Let a cause be found, and doubts."""
    site.doubts = ["The side of D9 is told by one observation alone."]
    cause = {"cause": "height of instrument", "where": "P1", "error": [0.1], "sigma": [0.002]}
    cause |= {
        "quantities": ["length"],
        "components": [],
        "t2": 2500.0,
        "dof": 1,
        "critical": 10.8,
        "ids": ["s0", "s1"],
    }
    site.causes = {"most_probable": "The height of the instrument at P1 is wrong by 100 mm."}
    site.causes |= {"undecided": [], "causes": [cause]}


def problems(site: CannedSite) -> None:
    """Let a message be given up."""
    site.tell("problem", None, what="a message to chief@example.org is given up after 3 days")


def photographed(site: CannedSite) -> None:
    """Let a photo arrive in the tunnel."""
    site.add_photo("tunnel", "F99", (0.0, 33.0, 2.0))


def without_networks(site: CannedSite) -> None:
    """Take all networks away."""
    site.networks = {}


def begun(site: CannedSite) -> None:
    """Let nothing have been measured yet."""
    net = site.networks["small"]
    net.observations, net.sights, net.sigma0 = {}, [], None
    net.epochs = net.epochs[-1:]
    net.epochs[0] |= {"number": 0, "sigma0": None, "redundancy": None, "time": None}
    for p in net.points:
        if not p["fixed"]:
            p |= {"x": None, "y": None, "z": None, "determined": False}
            p |= {f"sigma_{a}_mm": None for a in "xyz"} | {"ellipse": None}
    site.instruments = []


def failed_epoch(site: CannedSite) -> None:
    """Let an epoch have no result."""
    e = site.networks["small"].epochs[9]
    e |= {"problem": "D1, D2: not determined by the observations of the epoch"}
    e |= {"congruence": None, "sigma0": None}


def hanging(path: str) -> Prepare:
    """Return what lets requests of a path have no answer."""

    def prepare(site: CannedSite) -> None:
        site.hanging = path

    return prepare


# -- what the visitor does -----------------------------------------------------------------------


def clicks(*selectors: str) -> Act:
    """Return clicks on elements, one after the other."""

    def act(v: Visitor) -> None:
        for selector in selectors:
            v.page.locator(selector).first.click()

    return act


def fails(pattern: str, status: int, *, first: Act = _nothing) -> Act:
    """Return an act after which addresses answer with an error."""

    def act(v: Visitor) -> None:
        body = {"error": [{"where": "", "what": ERRORS[status]}]}
        headers = {"Retry-After": "3"} if status in (429, 503) else {}
        v.page.route(pattern, lambda r: r.fulfill(status=status, json=body, headers=headers))
        first(v)

    return act


def then(*acts: Act) -> Act:
    """Return acts one after the other."""

    def act(v: Visitor) -> None:
        for each in acts:
            each(v)

    return act


def _lost(v: Visitor) -> None:
    v.server.stop()
    v.sees(".banner")


def _chosen(v: Visitor) -> None:
    v.holds("() => window.planForTests?.points.names.length > 0")
    v.page.wait_for_timeout(200)
    v.page.evaluate("planForTests.choose(planForTests.points.index.get('D3'))")


def _drawn(v: Visitor) -> None:
    v.holds("() => window.planForTests?.points.names.length > 0")
    v.page.wait_for_timeout(600)


def _turned_3d(v: Visitor) -> None:
    v.page.wait_for_selector(".plot[data-made]")
    v.page.wait_for_timeout(800)


def _searched(v: Visitor) -> None:
    _drawn(v)
    v.page.locator(".search input").fill("d")
    v.page.locator(".search input").press("ArrowDown")


def _held(v: Visitor) -> None:
    v.page.locator("#view .row button").first.click()
    for _ in range(3):
        v.server.site.arrive()
    v.page.wait_for_timeout(200)


def _opened_values(v: Visitor) -> None:
    v.page.locator("#view details summary").first.click()


def _opened(part: str) -> Act:
    """Return the opening of a part of an epoch."""
    return clicks(f"[data-part={part}] > summary")


def _wrong_token(v: Visitor) -> None:
    v.page.locator("input[name=token]").fill("guess")
    v.page.locator("button[type=submit]").click()
    v.page.wait_for_selector(".problem:not(:empty)")


def _wrong_value(v: Visitor) -> None:
    v.page.locator("[data-act=replace]").first.click()
    v.page.locator("dialog input[name=value]").fill("x")
    v.page.locator("dialog button.main").click()


def _new_token(v: Visitor) -> None:
    v.page.locator("#tokens .row button").first.click()
    v.page.locator("dialog input").fill("gate")
    v.page.locator("dialog button.main").click()
    v.page.wait_for_selector(".secret")


def _accepted(v: Visitor) -> None:
    v.page.locator("[data-act=accept]").first.click()
    v.page.wait_for_selector("#say:not(:empty), .problem:not(:empty)")


_suspect = "[data-id=s0] [data-act={}]"
STATES = (
    PageState("sign-in", act=lambda v: v.sees("input[name=token]") and None, role="nobody"),
    PageState("sign-in-wrong-token", act=_wrong_token, role="nobody"),
    PageState("no-networks", prepare=without_networks),
    PageState("begun-overview", prepare=begun),
    PageState("begun-plan", "plan", prepare=begun),
    PageState("begun-3d", "plan/3d", prepare=begun, act=_turned_3d),
    PageState("begun-verdicts", "verdicts", prepare=begun),
    PageState("begun-epochs", "epochs", prepare=begun),
    PageState("begun-point", "points/D1", prepare=begun),
    PageState("begun-instruments", "instruments", prepare=begun),
    PageState("overview-ok", prepare=well),
    PageState("overview-doubts"),
    PageState("overview-alarm", prepare=alarmed),
    PageState("overview-alarms-known", prepare=known),
    PageState("overview-alarms-ended", prepare=ended, act=clicks("#ended-alarms summary")),
    PageState("overview-problems", prepare=problems),
    PageState("overview-instruments", prepare=instruments),
    PageState("plan", "plan", act=_drawn),
    PageState("plan-chosen", "plan", act=_chosen),
    PageState("plan-search", "plan", act=_searched),
    PageState("plan-alarm", "plan", prepare=known, act=_drawn),
    PageState("plan-tunnel-photos", "plan", "tunnel", photographed, act=_drawn),
    PageState("plan-10000-points", "plan", "large", act=_drawn),
    PageState("plan-levelling", "plan", "levelling"),
    PageState("plan-heights-compared", "plan", "heights", act=_chosen),
    PageState("plan-north-first-mm", "plan", "north", act=_chosen),
    PageState("plan-geocentric", "plan", "world", act=_chosen),
    PageState("3d", "plan/3d", act=_turned_3d),
    PageState("3d-levelling", "plan/3d", "levelling"),
    PageState("3d-geocentric", "plan/3d", "world", act=_turned_3d),
    PageState("3d-tunnel-photos", "plan/3d", "tunnel", photographed, act=_turned_3d),
    PageState("3d-10000-points", "plan/3d", "large", act=_turned_3d),
    PageState("verdicts-live", "verdicts", prepare=arrivals),
    PageState("verdicts-held", "verdicts", prepare=arrivals, act=_held),
    PageState("verdicts-suspects", "verdicts/suspects"),
    PageState("verdicts-accepted-by-hand", "verdicts/suspects", act=_accepted),
    PageState("verdicts-waiting", "verdicts/waiting"),
    PageState("verdicts-rejected", "verdicts/rejected"),
    PageState("verdicts-causes", "verdicts/causes", prepare=causes),
    PageState("verdicts-no-causes", "verdicts/causes"),
    PageState("verdicts-doubts", "verdicts/doubts", prepare=causes),
    PageState("verdicts-no-suspects", "verdicts/suspects", prepare=well),
    PageState("points", "points", prepare=alarmed),
    PageState("points-10000", "points", "large"),
    PageState("point", "points/D3", prepare=alarmed),
    PageState("points-levelling", "points", "levelling"),
    PageState("points-north-first-mm", "points", "north"),
    PageState("points-geocentric", "points", "world"),
    PageState("point-levelling", "points/D3", "levelling"),
    PageState("point-north-first-mm", "points/D3", "north"),
    PageState("point-geocentric", "points/D3", "world"),
    PageState("point-values", "points/D3", act=_opened_values),
    PageState("point-uncontrolled", "points/D4"),
    PageState("point-undetermined", "points/D9"),
    PageState("point-fixed", "points/P1"),
    PageState("point-unknown", "points/nobody"),
    PageState("point-alarm-cleared", "points/D3", prepare=cleared),
    PageState("epochs", "epochs"),
    PageState("epoch-moved", "epochs/10"),
    PageState("epoch-turned-blocks", "epochs/9"),
    PageState("epoch-heights-compared", "epochs/10", "heights"),
    PageState("epoch-geocentric", "epochs/10", "world"),
    PageState("epoch-stable", "epochs/5"),
    PageState("epoch-changed", "epochs/4"),
    PageState("epoch-open", "epochs/11"),
    PageState("epoch-left-out", "epochs/10", prepare=left_out),
    PageState("epoch-rejected", "epochs/10", prepare=left_out, act=_opened("rejected")),
    PageState("epoch-suspects", "epochs/10", prepare=left_out, act=_opened("suspects")),
    PageState("epoch-decisions", "epochs/10", prepare=left_out, act=_opened("decisions")),
    PageState("epoch-dropped", "epochs/10", prepare=dropped),
    PageState(
        "dialog-accept-ended",
        "epochs/10",
        prepare=left_out,
        act=then(_opened("rejected"), clicks("[data-id=e0] [data-act=accept]")),
    ),
    PageState(
        "dialog-revoke-ended",
        "epochs/10",
        prepare=left_out,
        act=then(_opened("decisions"), clicks("[data-act=revoke]")),
    ),
    PageState("epoch-failed", "epochs/9", prepare=failed_epoch),
    PageState("instruments", "instruments", prepare=instruments),
    PageState("instrument-events", "instruments", prepare=instruments, act=_opened_values),
    PageState("downloads-viewer", "downloads", role="viewer"),
    PageState("downloads-admin", "downloads", role="admin"),
    PageState("token-made", "downloads", role="admin", act=_new_token),
    PageState("more", "more", role="surveyor"),
    PageState("verdicts-viewer", "verdicts/suspects", role="viewer"),
    PageState("dialog-replace", "verdicts/suspects", act=clicks(_suspect.format("replace"))),
    PageState("dialog-replace-wrong", "verdicts/suspects", act=_wrong_value),
    PageState("dialog-sigma", "verdicts", prepare=arrivals, act=clicks("[data-act=sigma]")),
    PageState("dialog-remove", "verdicts/waiting", act=clicks("[data-act=remove]")),
    PageState("dialog-epoch", "epochs", act=clicks("#view .row button")),
    PageState("dialog-acknowledge", prepare=alarmed, act=clicks("[data-key^=ack]")),
    PageState(
        "dialog-acknowledge-ended",
        prepare=ended,
        act=clicks("#ended-alarms summary", "#ended-alarms [data-key^=ack]"),
    ),
    PageState("dialog-silence", prepare=alarmed, act=clicks("[data-key^=silence]")),
    PageState("dialog-token", "downloads", role="admin", act=clicks("#tokens .row button")),
    PageState("dialog-token-remove", "downloads", role="admin", act=clicks("#tokens tbody button")),
    PageState("error-403", "verdicts/suspects", act=fails("**/postings", 403, first=_accepted)),
    PageState("error-429", "points", before=fails("**/networks/small/points", 429)),
    PageState("error-500", "epochs", before=fails("**/networks/small/epochs", 500)),
    PageState("error-503", "points/D3", before=fails("**/networks/small/*", 503)),
    PageState("error-no-service", before=fails("**/api/v1/site", 503)),
    PageState("error-no-plotly", "points/D3", before=fails("**/plotly.min.js", 500)),
    PageState("unknown-network", "overview", "nowhere"),
    PageState("lost-overview", act=_lost, prepare=alarmed),
    PageState("lost-plan", "plan", act=then(_drawn, _lost)),
    PageState("lost-point", "points/D3", act=_lost),
    PageState("lost-verdicts", "verdicts", act=_lost, prepare=arrivals),
    PageState("loading-overview", prepare=hanging("/networks/small"), before=_nothing),
    PageState(
        "loading-points", "points", prepare=hanging("/networks/small/points"), before=_nothing
    ),
    PageState("loading-plan", "plan", prepare=hanging("/networks/small/points"), before=_nothing),
    PageState("loading-epoch", "epochs/10", prepare=hanging("/epochs/10"), before=_nothing),
)
