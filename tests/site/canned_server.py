"""An HTTP server for a `CannedSite`: the API of the service, and the files of its page."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import mimetypes
from collections.abc import AsyncIterator
from pathlib import Path
from time import sleep, time
from typing import Any

from tests.site.canned_site import CannedSite, Refused
from tests.support.places import ROOT
from tests.support.thread_server import ThreadServer

PAGE = ROOT / "factorgraph_adj" / "site" / "page"
BEAT = 1.0
"""Seconds between two beats."""
CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self'; form-action 'none'; base-uri 'none'; "
    "frame-ancestors 'none'"
)
RANKS = {"instrument": 0, "viewer": 1, "surveyor": 2, "admin": 3}


def plotly_file() -> Path | None:
    """Return the library of figures, where plotly is installed."""
    found = importlib.util.find_spec("plotly")
    if found is None or found.origin is None:
        return None
    file = Path(found.origin).parent / "package_data" / "plotly.min.js"
    return file if file.is_file() else None


def application(site: CannedSite, *, tokens: bool) -> Any:
    """Return the ASGI application.

    Args:
        site: what it tells.
        tokens: whether a caller needs a session; otherwise everybody is an administrator.
    """
    from starlette.applications import Starlette
    from starlette.responses import JSONResponse, Response, StreamingResponse
    from starlette.routing import Route

    from factorgraph_adj.site.site_routes import kind_names

    def role(request: Any) -> str | None:
        if not tokens:
            return "admin"
        key = request.cookies.get("session", "")
        return site.tokens[key]["role"] if key in site.tokens else None

    def told(status: int, what: str, where: str = "") -> Any:
        return JSONResponse({"error": [{"where": where, "what": what}]}, status)

    def route(path: str, act: Any, needed: str = "viewer", methods: tuple[str, ...] = ("GET",)):
        async def endpoint(request: Any) -> Any:
            if site.away:
                return JSONResponse(
                    {"error": [{"where": "", "what": "the database is away"}]},
                    503,
                    {"Retry-After": "1"},
                )
            own = role(request)
            if own is None:
                return told(401, "no session")
            if RANKS[own] < RANKS[needed]:
                return told(403, f"a {own} may not do this")
            while request.url.path.endswith(site.hanging):
                await asyncio.sleep(0.02)
            name = request.path_params.get("network")
            if name is not None and name not in site.networks:
                return told(404, f"unknown network {name}", "network")
            try:
                found = act(request)
                if asyncio.iscoroutine(found):
                    found = await found
            except Refused as error:
                return JSONResponse({"error": [error.problem]}, error.status)
            return found if isinstance(found, Response) else JSONResponse(found)

        return Route(f"/api/v1/{path}", endpoint, methods=list(methods))

    def net(request: Any) -> Any:
        return site.networks[request.path_params["network"]]

    def observations(*states: str) -> Any:
        def rows(request: Any) -> Any:
            asked = request.query_params.get("state")
            point = request.query_params.get("point")
            among = (asked,) if asked else states
            asked_epoch = request.query_params.get("epoch")
            number = net(request).epochs[-1]["number"] if asked_epoch is None else int(asked_epoch)
            found = [
                o
                for o in net(request).of_epoch(number)
                if o["state"] in among and (point is None or point in o["points"])
            ]
            return {"epoch": number, "rows": found, "total": len(found), "next": None}

        return rows

    async def post(request: Any) -> Any:
        posting = await request.json()
        own = role(request) or ""
        if "do" in posting and RANKS[own] < RANKS["surveyor"]:
            return told(403, f"a {own} may give no commands")
        return site.post(request.path_params["network"], posting, own)

    async def alarm(request: Any) -> Any:
        what, body = request.path_params["what"], await request.json()
        return site.decide_alarm(int(request.path_params["id"]), what, role(request) or "", **body)

    def alarms(request: Any) -> Any:
        point = request.query_params.get("point")
        if point is not None:
            return [a for a in site.alarms if point in a["points"]]
        if request.query_params["state"] == "ended":
            closed = [a for a in site.alarms if a["state"] == "closed"]
            return [a for a in closed if a["acknowledged"] is None]
        return [a for a in site.alarms if a["state"] != "closed"]

    async def close(request: Any) -> Any:
        site.close_epoch(request.path_params["network"])
        return {"ok": True}

    async def session(request: Any) -> Any:
        if request.method == "DELETE":
            out = JSONResponse({"ok": True})
            out.delete_cookie("session")
            return out
        key = (await request.json()).get("token", "")
        if key not in site.tokens:
            return told(401, "unknown token", "token")
        site.tokens[key]["last_used"] = time()
        out = JSONResponse({"ok": True, "role": site.tokens[key]["role"]})
        out.set_cookie("session", key, httponly=True, samesite="strict")
        return out

    async def make_token(request: Any) -> Any:
        body = await request.json()
        key = f"secret-{len(site.tokens)}"
        site.tokens[key] = {"id": f"k{len(site.tokens)}", **body, "created": time()}
        site.tokens[key]["last_used"] = None
        return {"name": body["name"], "role": body["role"], "token": key}

    def drop_token(request: Any) -> Any:
        for key, held in list(site.tokens.items()):
            if held["id"] == request.path_params["id"]:
                del site.tokens[key]
        return {"ok": True}

    def components(request: Any) -> Any:
        return [
            {"epoch": e["number"], "time": e["time"], "sigma0": e["sigma0"]}
            | {
                "redundancy": e["redundancy"],
                "groups": [
                    {"name": n, "component": e["sigma0"] * f, "n": 40, "redundancy": 25}
                    for n, f in (("slope_distance", 0.9), ("direction", 1.1), ("zenith_angle", 1))
                ],
            }
            for e in net(request).epochs
            if e["state"] == "closed"
        ]

    def next_sights(request: Any) -> Any:
        return site.next_sights(request.query_params["target"])

    def levels(request: Any) -> Any:
        wanted = [n for n in request.query_params.get("points", "").split(",") if n]
        return site.protection_levels(net(request).name, wanted)

    async def events(request: Any) -> Any:
        network = request.query_params.get("network")
        last = request.headers.get("last-event-id") or request.query_params.get("after")
        begin = len(site.log) if last is None else int(last)

        async def stream() -> AsyncIterator[str]:
            at, beaten = begin, 0.0
            while not site.away:
                for e in site.after(at, network):
                    yield f"id: {e['id']}\nevent: {e['event']}\ndata: {json.dumps(e['data'])}\n\n"
                    await asyncio.sleep(site.pace)
                at = max(at, len(site.log))
                if site.beating and time() - beaten > BEAT:
                    beaten = time()
                    yield f'event: beat\ndata: {{"at": {beaten}}}\n\n'
                await asyncio.sleep(0.02)

        return StreamingResponse(stream(), media_type="text/event-stream")

    def whole(file: Path, headers: dict[str, str]) -> Any:
        # At once: a browser that goes away leaves no open file.
        kind = mimetypes.guess_type(file.name)[0]
        return Response(file.read_bytes(), headers=headers, media_type=kind)

    async def static(request: Any) -> Any:
        name = request.path_params.get("file", "index.html")
        file = PAGE / name
        if not file.is_file():
            return told(404, f"no file {name}")
        headers = {"Content-Security-Policy": CSP, "Cache-Control": "no-cache"}
        return whole(file, headers)

    async def library(request: Any) -> Any:
        file = plotly_file()
        return told(404, "no plotly") if file is None else whole(file, {})

    def file(request: Any) -> Any:
        return Response(f"{request.path_params['file']} of {net(request).name}")

    n = "networks/{network}"
    routes = [
        Route("/", static),
        Route("/page/plotly.min.js", library),
        Route("/page/{file}", static),
        Route("/api/v1/session", session, methods=["POST", "DELETE"]),
        route(
            "site",
            lambda r: {
                "name": "Canned site",
                "version": "0",
                "role": role(r),
                "tokens": tokens,
                "beat_s": BEAT,
                "kinds": kind_names(),
                "networks": [m.summary() for m in site.networks.values()],
            },
        ),
        route(n, lambda r: net(r).summary()),
        route(f"{n}/postings", post, "instrument", ("POST",)),
        route(f"{n}/points", lambda r: net(r).points),
        route(f"{n}/sights", lambda r: net(r).sights),
        route(f"{n}/photos", lambda r: net(r).photos),
        route(f"{n}/observations", observations("accepted", "waiting", "suspect", "rejected")),
        route(f"{n}/waiting", observations("waiting")),
        route(f"{n}/suspects", observations("suspect")),
        route(f"{n}/rejected", observations("rejected")),
        route(f"{n}/doubts", lambda r: {"doubts": site.doubts}),
        route(f"{n}/causes", lambda r: site.causes),
        route(f"{n}/epochs", lambda r: net(r).listed_epochs()),
        route(f"{n}/epochs", close, "surveyor", ("POST",)),
        route(f"{n}/epochs/{{k:int}}", lambda r: site.epoch(net(r).name, r.path_params["k"])),
        route(f"{n}/series", lambda r: [site.series(net(r).name, r.query_params["points"])]),
        route(f"{n}/variance-components", components),
        route(f"{n}/next-sights", next_sights),
        route(f"{n}/protection-levels", levels),
        route(f"{n}/events", lambda r: site.after(max(len(site.log) - 100, 0), net(r).name)),
        route("events", events),
        route("instruments", lambda r: site.instruments),
        route("alarms", alarms),
        route("alarms/{id}/{what}", alarm, "surveyor", ("POST",)),
        route("tokens", lambda r: list(site.tokens.values()), "admin"),
        route("tokens", make_token, "admin", ("POST",)),
        route("tokens/{id}", drop_token, "admin", ("DELETE",)),
        route(f"{n}/{{file}}", file),
    ]
    return Starlette(routes=routes)


class CannedServer(ThreadServer):
    """A canned site, which is the same after it was stopped and started again."""

    def __init__(self, *, tokens: bool = False, port: int = 0) -> None:
        self.site, self.tokens = CannedSite(), tokens
        super().__init__(port)

    def application(self) -> Any:
        return application(self.site, tokens=self.tokens)


if __name__ == "__main__":
    import argparse

    parser = argparse.ArgumentParser(description="Serve canned data, for work on the page.")
    parser.add_argument("--port", type=int, default=8123)
    parser.add_argument("--tokens", action="store_true")
    given = parser.parse_args()
    served = CannedServer(tokens=given.tokens, port=given.port)
    print(served.url, flush=True)
    while True:
        sleep(2)
        served.site.arrive(state=served.site.draw.choices(("accepted", "suspect"), (9, 1))[0])
