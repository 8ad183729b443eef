"""HTTP API of a site: the application with its errors, its access and its page."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..errors import AdjustmentError, InputError, Problem
from ..version import __version__
from .access import NotAllowed, TooFast
from .database import DatabaseAway
from .dependencies import caller_of, token_of
from .epoch_routes import epoch_router
from .live_network import Overloaded
from .network_routes import network_router
from .postings import OtherRequest
from .site import NoSuchThing, Site
from .site_routes import site_router

API = "/api/v1"
"""Where the API of version 1 is."""
PAGE_FOLDER = Path(__file__).parent / "page"
"""Files of the page."""
MAX_BODY = 1 << 24
"""Largest body of a request: 16 MB, bytes."""
TOO_LARGE = f"the body is larger than {MAX_BODY >> 20} MB: send fewer postings at once"
"""Message about a larger one."""
MAX_BODY_OF_STRANGERS = 1 << 12
"""Largest body of a request whose caller is not known, bytes: a log-in needs less."""
UNREAD = {"Connection": "close"}
"""Headers of an answer that leaves the rest of a body unread."""
SECONDS_TO_RETRY = 2
"""When to try again, seconds."""
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
"""Headers of every answer."""
REFUSAL = {
    "type": "object",
    "required": ["error"],
    "properties": {
        "error": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["where", "what"],
                "properties": {"where": {"type": "string"}, "what": {"type": "string"}},
            },
        }
    },
}
"""Schema of the answer to a request that is refused: all that is wrong, each with its place."""
REFUSALS: dict[int | str, dict[str, Any]] = {
    status: {"description": description, "content": {"application/json": {"schema": REFUSAL}}}
    for status, description in {
        400: "The body is no JSON.",
        401: "A token is needed, or it is unknown, has expired or was revoked.",
        403: "The role of the token lacks the right.",
        404: "There is no such network, epoch or route.",
        409: "The request was used for another posting; in a list, its answer has conflict.",
        413: "The body is too large.",
        422: "What is asked for, or posted, is wrong.",
        429: "The caller makes too many requests: wait for Retry-After.",
        503: "The database is away, or too much waits: wait for Retry-After.",
    }.items()
}
"""Refusals of every route, for its description."""
STATUS: tuple[tuple[type[AdjustmentError], int], ...] = (
    (NoSuchThing, 404),
    (OtherRequest, 409),
    (TooFast, 429),
    (Overloaded, 503),
    (DatabaseAway, 503),
    (AdjustmentError, 422),
)
"""Status of HTTP by the kind of an error, the first that fits."""


def problem_answer(status: int, problems: list[Problem]) -> JSONResponse:
    """Return an answer with what is wrong, as those of the stream have it."""
    headers = {"Retry-After": str(SECONDS_TO_RETRY)} if status in (429, 503) else {}
    if status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    listed = [{"where": p.where, "what": p.what} for p in problems]
    return JSONResponse({"error": listed}, status, headers)


def problem_of(error: HTTPException) -> JSONResponse:
    """Return the answer to an error of HTTP."""
    answer = problem_answer(error.status_code, [Problem(str(error.detail))])
    answer.headers.update(error.headers or {})
    return answer


class Guard:
    """Refuses bodies that are too large, and gives every answer `HEADERS`.

    A body is read before the route knows its caller. More than `MAX_BODY_OF_STRANGERS` bytes of it
    are read only where the caller is known.

    It is plain ASGI: a middleware of functions would run every request in a task group of its own.
    """

    def __init__(self, app: ASGIApp, site: Site) -> None:
        """Take the application, and the site that knows its callers."""
        self._app, self._site = app, site

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the application answer a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        read, is_known = 0, False

        async def allow(length: int) -> None:
            nonlocal is_known
            if length > MAX_BODY_OF_STRANGERS and not is_known:
                try:
                    await caller_of(self._site.access, token_of(Request(scope)))
                except NotAllowed as error:
                    raise HTTPException(error.status, str(error), UNREAD) from None
                except DatabaseAway as error:
                    raise HTTPException(503, str(error), UNREAD) from None
                is_known = True
            if length > MAX_BODY:
                raise HTTPException(413, TOO_LARGE, UNREAD)

        async def received() -> Message:
            nonlocal read
            message = await receive()
            read += len(message.get("body", b""))
            await allow(read)  # a body in chunks states no length
            return message

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        length = Headers(scope=scope).get("content-length", "0")
        try:
            await allow(int(length) if length.isdecimal() else MAX_BODY + 1)
        except HTTPException as error:
            await problem_of(error)(scope, receive, sent)
            return
        await self._app(scope, received, sent)


def application(site: Site, *, lifespan: bool = True) -> FastAPI:
    """Return the application of a site.

    Args:
        site: the site.
        lifespan: whether the site starts and stops with the application.
    """

    @asynccontextmanager
    async def running(_: FastAPI) -> AsyncIterator[None]:
        if lifespan:
            site.start()
        yield
        if lifespan:
            site.stop()

    app = FastAPI(
        title="factorgraph_adj site",
        version=__version__ or "0",
        openapi_url=f"{API}/openapi.json",
        docs_url=None,
        redoc_url=None,
        lifespan=running,
    )
    app.state.site = site

    @app.exception_handler(AdjustmentError)
    async def refused(_: Request, error: AdjustmentError) -> JSONResponse:
        problems = getattr(error, "problems", (Problem(str(error)),))
        if isinstance(error, NotAllowed):
            return problem_answer(error.status, list(problems))
        status = next(code for kind, code in STATUS if isinstance(error, kind))
        return problem_answer(status, list(problems))

    @app.exception_handler(RequestValidationError)
    async def malformed(asked: Request, error: RequestValidationError) -> JSONResponse:
        problems = [
            Problem(str(e["msg"]), ".".join(str(part) for part in e["loc"])) for e in error.errors()
        ]
        kind = asked.headers.get("content-type", "")
        if "json" not in kind and any(p.where.startswith("body") for p in problems):
            what = f"the body is {kind or 'of no stated type'}: send JSON, with the header"
            problems = [Problem(f"{what} Content-Type: application/json", "body")]
        return problem_answer(422, problems)

    @app.exception_handler(HTTPException)
    async def plain(_: Request, error: HTTPException) -> JSONResponse:
        return problem_of(error)

    app.add_middleware(Guard, site=site)
    for router in (site_router, network_router, epoch_router):
        app.include_router(router, prefix=API, responses=REFUSALS)
    _add_page(app)
    return app


def _add_page(app: FastAPI) -> None:
    """Add the page, and the library that draws its figures."""
    if not PAGE_FOLDER.exists():
        return

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        return FileResponse(PAGE_FOLDER / "index.html")

    @app.get("/page/plotly.min.js", include_in_schema=False)
    async def plotly() -> FileResponse:
        try:
            import plotly
        except ImportError:
            raise InputError("figures need plotly: pip install 'factorgraph_adj[serve]'") from None
        return FileResponse(Path(plotly.__file__).parent / "package_data" / "plotly.min.js")

    app.mount("/page", StaticFiles(directory=PAGE_FOLDER), name="page")
