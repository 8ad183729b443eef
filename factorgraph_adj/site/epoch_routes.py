"""Routes of the epochs of a network: results, displacements, series, what comes next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Query

from ..errors import InputError
from ..report.layout import finite_json
from .decisions import epoch_decisions, standing_decisions
from .dependencies import Decider, EpochInPath, Network, Reader, TheSite
from .live_epochs import no_epoch
from .live_network import LiveNetwork
from .network_routes import answer_of, answered
from .postings import OtherRequest
from .result_columns import read_points
from .site import NoSuchThing

epoch_router = APIRouter(prefix="/networks/{name}", tags=["epochs"])
AXES = "xyz"
Answer = dict[str, Any]


def _shown_row(row: Answer, summary: Answer | None) -> Answer:
    """Return an epoch without its points."""
    summary = summary or {}
    findings = summary.get("findings") or {}
    names = ("sigma0", "sigma0_limits", "redundancy", "counts", "problem", "time")
    figures = {k: summary.get(k) for k in names}
    figures["problem"] = figures["problem"] or findings.get("problem", "")
    return row | figures | {"congruence": findings.get("congruence")}


@epoch_router.get("/epochs")
def epochs(network: Network, caller: Reader) -> list[Answer]:
    """Return the epochs with their figures and congruence tests."""
    return [_shown_row(row, row.pop("summary")) for row in network.epochs(summaries=True)]


@epoch_router.get("/epochs/{number}")
def epoch(network: Network, site: TheSite, caller: Reader, number: EpochInPath) -> Answer:
    """Return an epoch with its points, displacements, blocks, tests and decisions."""
    for row in network.epochs(results=True, number=number):
        result = row.pop("result") or {}
        findings = result.get("findings") or {}
        out = _shown_row(row, result) | {"points": result.get("points", [])}
        out |= {"doubts": result.get("doubts", []), "groups": result.get("groups", [])}
        names = ("against", "reference", "revised", "displacements", "blocks", "motions", "tests")
        decided = epoch_decisions(site.database, network.settings.name, number)
        standing = standing_decisions(decided)
        out["decisions"] = [d.shown(standing) for d in decided]
        return out | {name: findings.get(name) for name in names}
    there = [row["number"] for row in network.epochs()]
    raise NoSuchThing(no_epoch(network.settings.name, number, there))


@epoch_router.post("/epochs")
async def close_epoch(
    network: Network,
    caller: Decider,
    close: Annotated[bool, Body()],
    request: Annotated[str | None, Body()] = None,
) -> Answer:
    """End the present epoch; the next posting begins another one.

    A ``request`` is executed once, like that of a posting, and answered again.
    """
    if not close:
        raise InputError('close must be true: {"close": true} ends the present epoch')
    (answer,) = await answered([network.close_epoch(caller.name, request)])
    if not answer["ok"]:
        kind = OtherRequest if "conflict" in answer else InputError
        raise kind(answer["error"][0]["what"])
    return answer


@epoch_router.get("/series")
def series(
    network: Network,
    site: TheSite,
    caller: Reader,
    points: Annotated[str, Query(max_length=20_000)],
    begin: Annotated[float | None, Query(alias="from")] = None,
    to: float | None = None,
) -> list[Answer]:
    """Return coordinates, displacements and motions of points over the closed epochs."""
    wanted = [n for n in points.split(",") if n]
    times = {row["number"]: row["summary"]["time"] for row in _with_results(network)}
    times = {number: time for number, time in times.items() if _between(time, begin, to)}
    with site.database.reading() as connection:
        found = read_points(connection, network.id, wanted)
    return [_series_of(name, times, found[name]) for name in wanted]


def _with_results(network: LiveNetwork) -> list[Answer]:
    """Return the rows of epochs that have results, with their summaries."""
    return [row for row in network.epochs(summaries=True) if row["summary"] is not None]


def _between(time: float, begin: float | None, to: float | None) -> bool:
    return (begin is None or time >= begin) and (to is None or time <= to)


def _series_of(name: str, times: Mapping[int, float], parts: Mapping[int, Answer]) -> Answer:
    """Return the series of a point; null where it has no value in an epoch.

    Args:
        name: the point.
        times: times of the epochs by number, seconds UTC.
        parts: what the results of epochs say of it, see `factorgraph_adj.site.result_columns`.
    """
    out: Answer = {"name": name, "epochs": [], "times": [], "alarms": []}
    motion: Answer = {"times": []}
    for number, time in times.items():
        part = parts.get(number, {})
        point, moved = (_first(part.get(k)) for k in ("points", "displacements"))
        out["epochs"].append(number)
        out["times"].append(time)
        names = [*AXES, *(k for k in point if k.startswith("sigma_"))]
        figures = {k: point.get(k) for k in names}
        figures |= {k: v for k, v in moved.items() if k.startswith(("d", "sigma_d", "alarm_d"))}
        _append(out, figures, len(out["times"]))
        if "motions" in part:
            motion["times"].append(time)
            _append(motion, part["motions"], len(motion["times"]))
        out["alarms"] += [
            {"rule": test["rule"], "epoch": number, "time": time}
            for _, test in part.get("tests", ())
            if test["exceeds"]
        ]
    return out | {"motion": motion}


def _first(placed: list[tuple[int, Answer]] | None) -> Answer:
    """Return the first record of a point; an empty one where there is none."""
    return placed[0][1] if placed else {}


def _append(columns: Answer, figures: Answer, length: int) -> None:
    """Append one row to columns of equal length, null where a column has no value."""
    own = [k for k, v in columns.items() if isinstance(v, list) and k not in ("alarms",)]
    for key in dict.fromkeys([*own, *figures]):
        column = columns.setdefault(key, [None] * (length - 1))
        if len(column) < length:
            column.append(figures.get(key))


@epoch_router.get("/variance-components")
def variance_components(network: Network, caller: Reader) -> list[Answer]:
    """Return σ̂0 of every closed epoch, and σ̂ of the observations of each kind in their σ."""
    out = []
    for row in _with_results(network):
        summary = row["summary"]
        figures = {"epoch": row["number"], "time": summary["time"]}
        figures |= {k: summary.get(k) for k in ("sigma0", "redundancy")}
        out.append(figures | {"groups": summary.get("groups", [])})
    return out


@epoch_router.get("/next-sights")
def next_sights(
    network: Network,
    caller: Reader,
    target: Annotated[str, Query(max_length=2000)],
    most: Annotated[int, Query(ge=1, le=100)] = 10,
    station: str = "",
) -> Answer:
    """Return the sights that would improve points most, the best first."""
    record: Answer = {"do": "next_sights", "points": target.split(","), "most": most}
    if station:
        record["stations"] = [station]
    return answer_of(network, record)


@epoch_router.get("/protection-levels")
def protection_levels(
    network: Network,
    caller: Reader,
    risk: Annotated[float, Query(gt=0.0, lt=0.5)] = 1e-3,
    faults: Literal["1", "2"] = "2",
    points: Annotated[str, Query(max_length=20_000)] = "",
) -> Answer:
    """Return bounds of the errors of points that hold under undetected gross errors, in mm.

    A level is null where it is infinite: nothing controls the errors of ``weakest``. ``rejected``
    readings of the epoch, suspects among them, share the risk; null: the policy rejects none.
    """
    from ..quality.protection_levels import protection_levels as levels

    with network.reading() as epoch:
        adjustment = epoch.stream.adjustment
        solution = adjustment.solution()
        left_out = len(adjustment.rejected) + len(adjustment.suspects)
    found = levels(
        solution,
        risk=risk,
        faults=1 if faults == "1" else 2,
        alpha=adjustment.alpha,
        points=[n for n in points.split(",") if n] or None,
        # Where tests do not reject, the levels hold for results that no test rejects.
        rejected=None if adjustment.policy == "accept" and not left_out else left_out,
    )
    rows = []
    for i, name in enumerate(found.names):
        mode = found.weakest(name)
        row: Answer = {"name": name, "weakest": None if mode is None else list(mode.labels)}
        for what in ("horizontal", "vertical", "space"):
            row[f"{what}_mm"] = 1e3 * float(getattr(found, what)[i])
        rows.append(row)
    out: Answer = {"risk": risk, "faults": found.faults, "rejected": found.rejected}
    out |= {"accepted": found.accepted, "rows": rows}
    return dict(finite_json(out))
