"""Routes of the site: what it is, its events, its sessions and tokens, its health."""

from __future__ import annotations

import functools
import time as clock
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Body, Header, Query, Request, Response
from fastapi.responses import StreamingResponse

from ..observations.registry import KINDS
from ..report.catalogue import TEXTS_BY_LANGUAGE, Texts
from .access import RIGHTS, Caller
from .dependencies import COOKIE, Decider, Manager, Reader, RowNumber, TheSite
from .event_log import HEARTBEAT_SECONDS
from .network_routes import summary_of
from .site import Site

site_router = APIRouter(tags=["site"])
SESSION_SECONDS = 30 * 86400
"""How long a browser stays logged in, seconds."""
Answer = dict[str, Any]


class EventStream(StreamingResponse):
    """Server-sent events."""

    media_type = "text/event-stream"


@site_router.get("/site")
def the_site(site: TheSite, caller: Reader) -> Answer:
    """Return name, version, networks, and what the caller may do."""
    rights = sorted(RIGHTS[caller.role])
    return {**site.summary(), "caller": caller.name, "role": caller.role, "rights": rights} | {
        "networks": [summary_of(live) for live in site.networks.values()],
        "tokens": not site.access.open,
        "beat_s": HEARTBEAT_SECONDS,
        "kinds": kind_names(),
    }


@functools.cache
def kind_names() -> dict[str, dict[str, str]]:
    """Return the names of the kinds of observations in all languages, as reports have them."""
    texts = [Texts(code) for code in TEXTS_BY_LANGUAGE]
    return {kind: {t.language: t.kind(kind.replace("_", " ")) for t in texts} for kind in KINDS}


@site_router.get(
    "/health", responses={503: {"model": Answer, "description": "Something does not run."}}
)
def health(site: TheSite, response: Response) -> Answer:
    """Return whether everything runs; 503 where something does not. Anybody may ask."""
    found = site.health()
    if not found["ok"]:
        response.status_code = 503
    return found if site.access.open else {"ok": found["ok"]}


@site_router.get("/events", response_class=EventStream)
async def events(
    site: TheSite,
    caller: Reader,
    network: Annotated[list[str] | None, Query()] = None,
    last_event_id: Annotated[int | None, Header(ge=0, le=1 << 62)] = None,
    after: Annotated[int | None, Query(ge=0, le=1 << 62)] = None,
) -> StreamingResponse:
    """Follow what happens, as server-sent events; ``Last-Event-ID`` or ``after`` resumes."""
    names = {live.id: name for name, live in site.networks.items()}
    wanted = None if network is None else site.ids(network)
    last = last_event_id if last_event_id is not None else after

    async def lines() -> AsyncIterator[bytes]:
        yield b"retry: 2000\n\n"
        async for piece in site.events.follow(last, wanted, names=names):
            yield piece

    return EventStream(lines(), headers={"X-Accel-Buffering": "no"})


@site_router.get("/instruments")
def instruments(site: TheSite, caller: Reader) -> list[Answer]:
    """Return the health of the instruments, with the latest events of each."""
    return site.instruments.health()


# -- alarms ----------------------------------------------------------------------------------------


@site_router.get("/alarms")
def alarms(
    site: TheSite, caller: Reader, state: str = "standing", network: str = "", point: str = ""
) -> list[Answer]:
    """Return alarms: ``state`` standing, ended or all; of a network; the log of a point.

    Those of ``ended`` have been cleared before anybody acknowledged them.
    """
    of = site.network(network).id if network else None
    return site.alarms.listed(state=state, network=of, point=point)


@site_router.post("/alarms/{alarm}/acknowledge")
def acknowledge(
    site: TheSite,
    caller: Decider,
    alarm: RowNumber,
    remark: Annotated[str, Body(embed=True)] = "",
) -> Answer:
    """Note that the caller knows of an alarm that stands, or has ended, and what he remarks."""
    found = site.alarms.acknowledge(alarm, caller.name, remark)
    return _changed_alarm(site, caller, "acknowledge", found)


@site_router.post("/alarms/{alarm}/silence")
def silence(
    site: TheSite, caller: Decider, alarm: RowNumber, hours: Annotated[float, Body(embed=True)]
) -> Answer:
    """Send no messages about an alarm for some hours."""
    found = site.alarms.silence(alarm, caller.name, hours)
    return _changed_alarm(site, caller, "silence", found)


def _changed_alarm(site: Site, caller: Caller, action: str, alarm: Answer) -> Answer:
    """Record a decision about an alarm, and tell all readers."""
    said = {k: alarm[k] for k in ("remark",) if k in alarm and action == "acknowledge"}
    site.record_action(caller.name, f"{action} alarm", {"alarm": alarm["id"], **said})
    network = site.network(alarm["network"]).id if alarm["network"] else None
    site.events.record("alarm", {"alarm": alarm}, at=clock.time(), network=network)
    return alarm


# -- sessions and tokens ---------------------------------------------------------------------------


@site_router.post("/session")
def log_in(
    site: TheSite,
    request: Request,
    response: Response,
    token: Annotated[str, Body(embed=True, max_length=200, pattern=r"^[!-~]+$")],
) -> Answer:
    """Log a browser in with a token, which a cookie then holds that no script can read."""
    caller = site.access.caller(token)
    site.access.require(caller, "read")
    secure = request.url.scheme == "https"
    response.set_cookie(
        COOKIE, token, max_age=SESSION_SECONDS, httponly=True, samesite="strict", secure=secure
    )
    return {"caller": caller.name, "role": caller.role}


@site_router.delete("/session")
def log_out(response: Response) -> Answer:
    """Log a browser out."""
    response.delete_cookie(COOKIE)
    return {}


@site_router.get("/tokens")
def tokens(site: TheSite, caller: Manager) -> list[Answer]:
    """Return the tokens, without their texts."""
    return site.access.listed()


@site_router.post("/tokens")
def new_token(
    site: TheSite,
    caller: Manager,
    name: Annotated[str, Body()],
    role: Annotated[str, Body()],
    days: Annotated[float | None, Body()] = None,
) -> Answer:
    """Make a token; its text is in this answer alone."""
    site.access.refuse_other_first_token(role, days)
    text = site.access.add(name, role, days=days)
    site.record_action(caller.name, "new token", {"name": name, "role": role})
    return {"name": name, "role": role, "token": text}


@site_router.delete("/tokens/{token}")
def revoke_token(site: TheSite, caller: Manager, token: RowNumber) -> Answer:
    """Revoke a token by its id."""
    site.access.refuse_last_admin(token)
    name = site.access.revoke(token)
    site.record_action(caller.name, "revoke token", {"name": name})
    return {}
