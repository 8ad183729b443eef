"""Routes of a network: postings, points, observations, epochs, downloads."""

from __future__ import annotations

import asyncio
import zipfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from io import BytesIO
from typing import Annotated, Any

from fastapi import APIRouter, Body, Query, Response
from fastapi.responses import JSONResponse

from ..errors import InputError, Problem
from ..io.project_writer import network_files
from ..report.layout import finite_json
from .decisions import epoch_decisions, standing_decisions
from .dependencies import EpochNumber, Network, Poster, Reader, TheSite
from .epoch_downloads import epoch_file
from .epoch_search import SEARCHER
from .live_network import LiveNetwork, Overloaded
from .observation_list import ObservationList, observation_list
from .postings import COMMANDS_THAT_CHANGE
from .site import Site
from .views import EpochView

network_router = APIRouter(prefix="/networks/{name}", tags=["network"])
MAX_POSTINGS = 1000
"""Largest number of postings in one request."""
ANSWER_SECONDS = 120.0
"""Time after which a request gives up waiting; a posting in hand is executed nevertheless, seconds.
"""
Answer = dict[str, Any]
Posting = dict[str, Any]
Names = Annotated[str, Query(max_length=20_000)]


def _seen(network: LiveNetwork, what: Callable[[EpochView], Any], number: int | None = None) -> Any:
    with network.reading(number) as epoch:
        return finite_json(what(EpochView(epoch, network.settings.objects)))


@network_router.get("")
def summary(network: Network, caller: Reader) -> Answer:
    """Return what there is, in which units, and the present epoch."""
    return summary_of(network)


def summary_of(network: LiveNetwork) -> Answer:
    """Return what there is of a network."""
    own: Answer = {"name": network.settings.name, "last_arrival": network.last_arrival}
    own |= _seen(network, EpochView.summary)
    return own


@network_router.post("/postings")
async def post(
    network: Network,
    site: TheSite,
    caller: Poster,
    body: Annotated[Posting | list[Posting], Body()],
) -> JSONResponse:
    """Execute a posting, or several in their order; each gets its answer when it is on the disk.

    A posting is an object of the stream protocol, with ``time`` and ``request``. Where its request
    was used for another content, its answer has ``conflict``; one posting alone then has status
    409.
    """
    postings = body if isinstance(body, list) else [body]
    if len(postings) > MAX_POSTINGS:
        raise InputError(f"{len(postings)} postings; at most {MAX_POSTINGS} in one request")
    for posting in postings:
        do = posting.get("do", "add")
        if do != "add":
            changes = isinstance(do, str) and do in COMMANDS_THAT_CHANGE
            site.access.require(caller, "decide" if changes else "read")
    futures: list[Future[Answer]] = []
    try:
        futures += (network.submit(p, caller.name) for p in postings)
    except Overloaded:
        for future in futures:
            future.cancel()
        raise
    answers = await answered(futures)
    # Answers are plain JSON already: nothing has to be looked through again.
    if isinstance(body, list):
        return JSONResponse(answers)
    return JSONResponse(answers[0], 409 if "conflict" in answers[0] else 200)


async def answered(futures: Sequence[Future[Answer]]) -> list[Answer]:
    """Return the answers to postings of one network when all are on the disk.

    They are answered in their order: where the last one has its answer, all have.

    Raises:
        Overloaded: they do not come in time.
    """
    try:
        async with asyncio.timeout(ANSWER_SECONDS):
            for future in reversed(futures):
                if not future.done():
                    await asyncio.wrap_future(future)
    except BaseException as error:
        for future in futures:
            future.cancel()
        if not isinstance(error, TimeoutError):
            raise
        what = f"the network has not answered within {ANSWER_SECONDS:g} s: ask again"
        raise Overloaded(what) from None
    return [future.result() for future in futures]


@network_router.get("/points")
def points(network: Network, caller: Reader) -> list[Answer]:
    """Return all points with coordinates, σ and error ellipses."""
    return list(_seen(network, EpochView.points))


@network_router.get("/photos")
def photos(network: Network, caller: Reader) -> list[Answer]:
    """Return the photos with their poses and the points that they see."""
    return list(_seen(network, EpochView.photos))


@network_router.get("/sights")
def sights(network: Network, caller: Reader) -> list[Answer]:
    """Return the observations between two places, with their test values."""
    return list(_seen(network, lambda view: observation_list(view.epoch).sights()))


@network_router.get("/observations")
def observations(
    network: Network,
    site: TheSite,
    caller: Reader,
    state: str = "accepted",
    limit: Annotated[int, Query(ge=1, le=10_000)] = 200,
    after: str = "",
    point: str = "",
    q: str = "",
    epoch: EpochNumber = None,
) -> Answer:
    """Return a page of the observations of a state, in the present epoch or in another one.

    Each has the last ``decision`` that names it; ``revocable``: it can be taken back.
    """

    def page(view: EpochView) -> Answer:
        listed = observation_list(view.epoch)
        found = listed.page(state, limit=limit, after=after, point=point, text=q)
        return _with_decisions(network, site, view, found)

    found: Answer = _seen(network, page, epoch)
    return found


def _with_decisions(network: LiveNetwork, site: Site, view: EpochView, found: Answer) -> Answer:
    """Return rows of observations with what people have decided about each."""
    decided = epoch_decisions(site.database, network.settings.name, view.epoch.number)
    last, standing = {i: d for d in decided for i in d.ids}, standing_decisions(decided)
    there = view.adjustment.decided
    for row in found["rows"]:
        if (ident := row["id"]) in last:
            row["decision"] = last[ident].shown(standing)
            top = standing.get(ident, ())[-1:]
            row["revocable"] = ident in there and any(d.by != SEARCHER for d in top)
    return found


def _others(network: LiveNetwork, site: Site, state: str, number: int | None) -> Answer:
    """Return what is left out of an epoch, with the last decision about each by name.

    Where the epoch is named, also with ``now``, tests against everything that it has in.
    """

    def rows(view: EpochView) -> Answer:
        listed = ObservationList(view.epoch, None)
        tested = {} if number is None else listed.tested_now()
        others = listed.others(state)
        now = [row | ({"now": tested[row["id"]]} if row["id"] in tested else {}) for row in others]
        found = {"epoch": view.epoch.number, "rows": now}
        return _with_decisions(network, site, view, found)

    found: Answer = _seen(network, rows, number)
    return found


@network_router.get("/waiting")
def waiting(network: Network, site: TheSite, caller: Reader, epoch: EpochNumber = None) -> Answer:
    """Return the observations that wait, and what they lack."""
    return _others(network, site, "waiting", epoch)


@network_router.get("/suspects")
def suspects(network: Network, site: TheSite, caller: Reader, epoch: EpochNumber = None) -> Answer:
    """Return the observations that wait for a decision."""
    return _others(network, site, "suspect", epoch)


@network_router.get("/rejected")
def rejected(network: Network, site: TheSite, caller: Reader, epoch: EpochNumber = None) -> Answer:
    """Return the rejected observations, each with the last decision that names it."""
    return _others(network, site, "rejected", epoch)


@network_router.get("/doubts")
def doubts(network: Network, caller: Reader) -> Answer:
    """Return why verdicts or the result may be wrong, in sentences."""
    return answer_of(network, {"do": "doubts"})


@network_router.get("/causes")
def causes(network: Network, caller: Reader) -> Answer:
    """Return what several observations that misfit may have in common."""
    return answer_of(network, {"do": "causes"})


@network_router.get("/reliability")
def reliability(
    network: Network, caller: Reader, most: Annotated[int, Query(ge=1, le=10_000)] = 10
) -> Answer:
    """Return redundancy, uncontrolled and weakest observations, largest detectable errors."""
    return answer_of(network, {"do": "reliability", "most": most})


def answer_of(network: LiveNetwork, record: Posting) -> Answer:
    """Return the answer of the stream to a command that changes nothing."""
    with network.reading() as epoch:
        answer = epoch.stream.answer_record(record, 0)
    if not answer["ok"]:
        raise InputError([Problem(e["what"], e["where"]) for e in answer["error"]])
    return {k: v for k, v in answer.items() if k not in ("line", "ok", "do", "seconds", "counts")}


@network_router.get("/events")
def latest_events(
    network: Network, site: TheSite, caller: Reader, most: Annotated[int, Query(ge=1, le=200)] = 100
) -> list[Answer]:
    """Return the latest events of the network, the oldest first."""
    names = {live.id: name for name, live in site.networks.items()}
    found = site.events.latest(network.id, most)
    return [{"id": e.id, "event": e.kind, "data": e.shown(names)} for e in found]


@network_router.get("/covariance")
def covariance(network: Network, caller: Reader, points: Names) -> Answer:
    """Return the joint covariance of points, names with commas between them."""
    names = [n for n in points.split(",") if n]
    found: Answer = _seen(network, lambda view: view.covariance(names))
    return found


# -- downloads -------------------------------------------------------------------------------------


def _file_name(network: LiveNetwork, extension: str, epoch: int | None) -> str:
    """Return the name of a file of a network; that of a stated epoch tells its number."""
    return f"{network.settings.name}{'' if epoch is None else f'-epoch-{epoch}'}{extension}"


def _download(kind: type[Response], data: bytes, name: str) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return kind(data, headers=headers)


class HtmlFile(Response):
    """A page."""

    media_type = "text/html"


class JsonFile(Response):
    """A file of JSON."""

    media_type = "application/json"


class GeoPackageFile(Response):
    """A GeoPackage."""

    media_type = "application/geopackage+sqlite3"


class ZipFile(Response):
    """An archive."""

    media_type = "application/zip"


@network_router.get("/report.html", response_class=HtmlFile)
def report(network: Network, site: TheSite, caller: Reader, epoch: EpochNumber = None) -> Response:
    """Return the report of an epoch as one HTML file."""
    data = epoch_file(network, site, "report.html", epoch)
    return _download(HtmlFile, data, _file_name(network, ".html", epoch))


@network_router.get(
    "/results.json",
    response_class=JsonFile,
    responses={200: {"content": {"application/json": {"schema": {"type": "object"}}}}},
)
def results(network: Network, site: TheSite, caller: Reader, epoch: EpochNumber = None) -> Response:
    """Return the results of an epoch as JSON."""
    data = epoch_file(network, site, "results.json", epoch)
    return _download(JsonFile, data, _file_name(network, ".json", epoch))


@network_router.get("/network.gpkg", response_class=GeoPackageFile)
def geopackage(
    network: Network, site: TheSite, caller: Reader, epoch: EpochNumber = None
) -> Response:
    """Return an epoch as a GeoPackage."""
    data = epoch_file(network, site, "network.gpkg", epoch)
    return _download(GeoPackageFile, data, _file_name(network, ".gpkg", epoch))


@network_router.get("/project.zip", response_class=ZipFile)
def project(network: Network, caller: Reader, epoch: EpochNumber = None) -> Response:
    """Return what is in the graph of an epoch as a project."""
    with network.reading(epoch) as found:
        inc, units = found.stream.adjustment, found.stream.context.units
        files = network_files(inc.network(), units=units, toml="project.toml")
    target = BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(f"{network.settings.name}/{name}", text)
    return _download(ZipFile, target.getvalue(), _file_name(network, ".zip", epoch))
