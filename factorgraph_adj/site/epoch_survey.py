"""Survey of an epoch that has ended: findings, alarms, and what it changes in later epochs.

Late readings give an epoch another result. The monitor is then made again from all results, and
what it finds in later epochs may be another, too: their recorded findings are replaced, with
``revised``, the number of the epoch whose late readings did it. So are alarms of that time: one
that was raised and cleared in the meantime is recorded and told, one that never was is withdrawn,
and times are those of the epochs as they are known now.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from ..errors import AdjustmentError
from ..monitoring.monitor import Findings
from ..report.layout import finite_json
from .alarm_log import reconcile, revise
from .database import DatabaseAway
from .live_epochs import LiveEpoch
from .monitor_states import write_state
from .posting_transactions import Batch
from .result_columns import write_result
from .surveillance import COMPARED_LATER, Surveillance

if TYPE_CHECKING:
    from sqlalchemy import Connection

Answer = dict[str, Any]
Rows = list[dict[str, Any]]
REVISED = "revised"
"""Field of findings: number of the epoch whose late readings changed them."""


def surveyed(
    survey: Surveillance,
    network: int,
    read: Callable[[], Rows],
    epoch: LiveEpoch,
    result: Answer,
    batch: Batch,
    ended: int,
) -> Answer:
    """Return what an epoch tells; alarms and later epochs change with the transaction.

    Where many epochs are to be compared again, a revision does it
    (`factorgraph_adj.site.epoch_revision`), and what the epoch tells says so.

    Args:
        survey: the surveillance of the network.
        network: id of the network.
        read: reads the rows of all epochs, with their results.
        epoch: the epoch.
        result: its new result, with its estimate.
        batch: what the transaction will hold.
        ended: number of epochs that have ended.
    """

    def rows() -> Rows:
        # Epochs that end in the same transaction have no result in the database yet.
        return [row | {"result": batch.results.get(row["number"], row["result"])} for row in read()]

    survey.resume()
    before = survey.against
    try:
        every = survey.findings(rows, epoch, result, ended=ended)
    except DatabaseAway:
        raise
    except AdjustmentError as error:
        survey.drop(again=True)
        batch.steps.append(partial(write_state, network=network, digest="", state=None))
        return {"problem": str(error)}
    at, name, rules = float(result["time"]), survey.settings.name, [r.name for r in survey.rules]
    found = every.get(epoch.number, Findings(epoch.number, at, problem=str(result["problem"])))
    if found.problem == COMPARED_LATER:
        batch.steps.append(state_of(survey, network))
        return survey.shown(found)
    later = {n: f for n, f in every.items() if n > epoch.number}
    standing = [] if later else survey.standing(found)
    episodes = survey.episodes(f for _, f in sorted(every.items())) if later else []

    def alarms(connection: Connection) -> None:
        if later:
            changes = revise(connection, network, name, rules, episodes, at, epoch.number)
        else:
            changes = reconcile(connection, network, name, rules, standing, at)
        batch.events += [("alarm", {"alarm": alarm}) for alarm in changes.events]

    if later or survey.against != before:
        _revise_epochs(survey, later, rows(), epoch.number, batch)
    batch.steps += [alarms, state_of(survey, network)]
    return survey.shown(found)


def state_of(survey: Surveillance, network: int) -> Callable[[Connection], None]:
    """Return the step of a transaction that writes the state of the monitor as it is now."""
    return partial(write_state, network=network, digest=survey.digest, state=survey.state)


def _revise_epochs(
    survey: Surveillance, later: Mapping[int, Findings], rows: Rows, by: int, batch: Batch
) -> None:
    """Replace the findings of other epochs that are others now."""
    # A reference that the site file states does not change with readings.
    against = survey.against if survey.settings.reference is None else None
    for row in rows:
        number, result = row["number"], row["result"]
        recorded = None if result is None else result["findings"]
        if recorded is None or number == by:
            continue
        found = later.get(number)
        if found is None and was_compared(recorded, number, against):
            # It is before the reference now: the first whole epoch has become another one.
            found = Findings(number, float(result["time"]))
        if found is None:
            continue
        revise_epoch(survey, row, found, by, batch)


def revise_epoch(survey: Surveillance, row: Answer, found: Findings, by: int, batch: Batch) -> None:
    """Replace the recorded findings of an epoch where they are others now.

    Args:
        survey: the surveillance that has found them.
        row: row of the epoch with its result.
        found: its findings.
        by: number of the epoch that has changed them; it is not noted at this one itself.
        batch: what the transaction will hold.
    """
    number, recorded = row["number"], row["result"]["findings"]
    now = survey.shown(found)
    if _as_recorded(now) == _as_recorded({k: v for k, v in recorded.items() if k != REVISED}):
        return
    noted = {} if number == by else {REVISED: by}
    batch.results[number] = row["result"] | {"findings": now | noted}
    batch.steps.append(partial(write_result, epoch=row["id"], result=batch.results[number]))
    summary = {n: row[n] for n in ("number", "begin", "end", "state", "revision")}
    batch.events.append(("epoch", {"epoch": number, "what": "revised", "by": by, **summary}))


def was_compared(recorded: Mapping[str, Any], number: int, against: int | None) -> bool:
    """Return whether an epoch before the reference was compared with an earlier one."""
    before = recorded.get("against")
    return against is not None and before is not None and before <= number < against


def _as_recorded(findings: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(finite_json(findings)))
