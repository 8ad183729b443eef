"""Result of an epoch in the database: what lists show, what concerns one point, and the rest.

A result is large: the estimate has the cofactors of all coordinates. Lists of many epochs and
series of points read a small part of it. Each part is therefore kept by itself, and once: the
column ``summary`` of an epoch, a row of the table ``point_results`` for each point, and the column
``result`` with everything else. `joined` puts them together again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from ..report.layout import finite_json

if TYPE_CHECKING:
    from sqlalchemy import Connection, Select

Result = dict[str, Any]
SUMMARY = (
    *("time", "problem", "counts", "converged", "reason", "sigma0", "sigma0_limits"),
    *("redundancy", "groups"),
)
"""Fields of a result that lists show."""
SUMMARY_OF_FINDINGS = ("problem", "congruence")
"""Fields of its ``findings`` that lists show."""
LISTS_OF_POINTS = (("points", "name"), ("displacements", "name"), ("tests", "point"))
"""Lists of records, each with the field that names its point; the first one is of the result, the
others are of its findings."""
MOTIONS = "motions"
"""Field of the findings with the motions by points."""


def parted(result: Result) -> tuple[Result, dict[str, Result], Result]:
    """Return summary, parts of points by name, and the rest of a result.

    A part has the records of its point in each of `LISTS_OF_POINTS`, with their places there, and
    its motion.
    """
    findings = dict(result.get("findings") or {})
    summary = {k: result[k] for k in SUMMARY if k in result}
    summary["findings"] = {k: findings[k] for k in SUMMARY_OF_FINDINGS if k in findings}
    rest = {k: v for k, v in result.items() if k not in SUMMARY}
    points: dict[str, Result] = {}
    for name, key in LISTS_OF_POINTS:
        of = rest if name == "points" else findings
        for place, record in enumerate(of.get(name) or ()):
            points.setdefault(record[key], {}).setdefault(name, []).append([place, record])
        if name in of:
            of[name] = []
    for point, motion in (findings.get(MOTIONS) or {}).items():
        points.setdefault(point, {})[MOTIONS] = motion
    if MOTIONS in findings:
        findings[MOTIONS] = {}
    if "findings" in result:
        kept = {k: v for k, v in findings.items() if k not in SUMMARY_OF_FINDINGS}
        rest["findings"] = kept
    return summary, points, rest


def joined(summary: Result, points: Mapping[str, Result], rest: Result) -> Result:
    """Return the result of which these are the parts, see `parted`."""
    result = rest | {k: v for k, v in summary.items() if k != "findings"}
    findings = result.get("findings")
    if findings is not None:
        findings = result["findings"] = findings | summary["findings"]
    for name, _ in LISTS_OF_POINTS:
        of = result if name == "points" else findings
        placed = [pair for part in points.values() for pair in part.get(name, ())]
        if of is not None and placed:
            of[name] = [record for _, record in sorted(placed, key=lambda pair: pair[0])]
    if findings is not None and MOTIONS in findings:
        findings[MOTIONS] = {p: part[MOTIONS] for p, part in points.items() if MOTIONS in part}
    return result


def written_result(epoch: int, result: Result) -> tuple[dict[str, str], list[dict[str, Any]]]:
    """Return the columns of an epoch with a result, and its rows of ``point_results``.

    Args:
        epoch: id of the row of the epoch.
        result: the result.
    """
    summary, points, rest = parted(finite_json(result))
    rows = [{"epoch": epoch, "point": n, "data": _text(part)} for n, part in points.items()]
    return {"summary": _text(summary), "result": _text(rest)}, rows


def write_result(
    connection: Connection, epoch: int, result: Result, *, revision: int | None = None
) -> None:
    """Write the result of an epoch in a transaction.

    Args:
        connection: connection of the transaction.
        epoch: id of the row of the epoch.
        result: the result.
        revision: its number, with which the epoch is closed; None: state and revision stay, as the
            findings alone have changed.
    """
    from sqlalchemy import delete, insert, update

    from .tables import epochs, point_results

    columns, rows = written_result(epoch, result)
    closed = {} if revision is None else {"state": "closed", "revision": revision}
    connection.execute(update(epochs).where(epochs.c.id == epoch).values(**columns, **closed))
    connection.execute(delete(point_results).where(point_results.c.epoch == epoch))
    if rows:
        connection.execute(insert(point_results), rows)


def read_results(
    connection: Connection, rows: Iterable[Mapping[str, Any]], ids: Select[Any]
) -> Iterator[Result | None]:
    """Yield the results of rows of epochs, None where there is none.

    Args:
        connection: a connection that reads as of one moment.
        rows: rows with ``id``, ``summary`` and ``result``.
        ids: selects the ids of these rows.
    """
    from sqlalchemy import select

    from .tables import point_results

    wanted = select(point_results).where(point_results.c.epoch.in_(ids))
    points: dict[int, dict[str, Result]] = {}
    for epoch, point, data in connection.execute(wanted):
        points.setdefault(epoch, {})[point] = json.loads(data)
    for row in rows:
        if row["result"] is None:
            yield None
            continue
        summary, rest = json.loads(row["summary"]), json.loads(row["result"])
        yield joined(summary, points.get(row["id"], {}), rest)


def read_points(
    connection: Connection, network: int, names: Iterable[str]
) -> dict[str, dict[int, Result]]:
    """Return the parts of some points, by name and number of the epoch.

    Args:
        connection: a connection.
        network: id of the row of the network.
        names: names of the points.
    """
    from sqlalchemy import select

    from .tables import epochs, point_results

    columns = epochs.c.number, point_results.c.data
    of_network = select(*columns).join(point_results).where(epochs.c.network == network)
    out: dict[str, dict[int, Result]] = {}
    for name in dict.fromkeys(names):
        mine = of_network.where(point_results.c.point == name)
        out[name] = {number: json.loads(data) for number, data in connection.execute(mine)}
    return out


def _text(part: Result) -> str:
    return json.dumps(part, ensure_ascii=False)
