"""Revision of many epochs: they are compared again a few at a time, between postings.

Late readings of an early epoch change what later ones tell. Where many have ended, comparing them
again takes minutes. A revision gives them to a new monitor, `EPOCHS_OF_STEP` in a transaction, and
replaces the findings that have changed; postings are answered between its steps. Epochs that end
meanwhile are tested by the monitor that is there, and the revision comes to them as well. When it
has come to the last one, its monitor takes over, and alarms are made those of the epochs as they
are known now. Its begin is recorded with the state of the monitor: after a restart it begins again.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Any

from ..errors import AdjustmentError
from ..monitoring.monitor import Findings
from .alarm_log import Raised, reconcile, revise
from .database import DatabaseAway
from .epoch_survey import revise_epoch, state_of, was_compared
from .posting_transactions import Batch
from .reference_epoch import ReferenceEpoch, reference_epoch
from .surveillance import COMPARED_LATER, Surveillance

if TYPE_CHECKING:
    from sqlalchemy import Connection

Rows = list[dict[str, Any]]
ReadAfter = Callable[[int, int], Rows]
"""Gives the rows of epochs with results after a number, at most so many, in order."""
EPOCHS_OF_STEP = 5
"""Number of epochs that are compared in a transaction."""


class EpochRevision:
    """A revision that goes on."""

    def __init__(self, survey: Surveillance, read: ReadAfter) -> None:
        """Begin with the reference.

        Args:
            survey: the surveillance whose findings wait.
            read: reads rows of epochs.
        """
        assert survey.revise_from is not None
        self.since: int = survey.revise_from
        """Number of the first epoch whose findings wait."""
        self.last = -1
        """Number of the last epoch that was compared."""
        self.survey = survey.anew()
        """Surveillance with the new monitor."""
        self.survey.begin()
        self.survey.reference = _reference(self.survey, read)
        self.episodes: list[Raised] = []
        """Alarms of the epochs so far."""
        self.at = 0.0
        """Time of the first epoch whose findings wait, seconds UTC."""
        self.latest = Findings(0, 0.0)
        """Findings of the last epoch that was compared."""

    def compare(self, row: dict[str, Any], batch: Batch) -> None:
        """Compare an epoch, and replace its findings where they are others."""
        survey, number, result = self.survey, row["number"], row["result"]
        self.last, against = number, self.survey.against
        recorded, found = result["findings"], None
        if number >= self.since and not self.at:
            self.at = float(result["time"])
        if against is not None and number >= against and result.get("estimate"):
            found = self.latest = survey.added(number, result)
            survey.continue_episodes(self.episodes, found)
        waits = recorded.get("problem") == COMPARED_LATER
        if found is None and (waits or was_compared(recorded, number, against)):
            found = Findings(number, float(result["time"]), problem=str(result["problem"]))
        if found is not None and (waits or number >= self.since):
            revise_epoch(survey, row, found, self.since, batch)


def revise_some(survey: Surveillance, network: int, read: ReadAfter, batch: Batch) -> None:
    """Compare some further epochs where findings wait, and end the revision after the last one.

    Args:
        survey: the surveillance of the network.
        network: id of the network.
        read: reads rows of epochs; all results must be in the database.
        batch: what the transaction will hold.
    """
    try:
        revision = survey.revision
        if (
            not isinstance(revision, EpochRevision)
            or min(survey.late, default=inf) <= revision.last
        ):
            revision = survey.revision = EpochRevision(survey, read)
        revision.since = min(revision.since, survey.revise_from or revision.since)
        survey.late.clear()
        rows = read(revision.last, EPOCHS_OF_STEP)
        for row in rows:
            revision.compare(row, batch)
    except DatabaseAway:
        raise
    except AdjustmentError as error:
        _give_up(survey, network, str(error), read, batch)
        return
    if len(rows) == EPOCHS_OF_STEP:
        return
    survey.adopt(revision.survey)
    name, rules = survey.settings.name, [rule.name for rule in survey.rules]
    is_last = revision.since >= revision.latest.number
    standing = survey.standing(revision.latest)

    def alarms(connection: Connection) -> None:
        if is_last:
            changes = reconcile(connection, network, name, rules, standing, revision.at)
        else:
            since = revision.since
            changes = revise(
                connection, network, name, rules, revision.episodes, revision.at, since
            )
        batch.events += [("alarm", {"alarm": alarm}) for alarm in changes.events]

    batch.steps += [alarms, state_of(survey, network)]


def _give_up(survey: Surveillance, network: int, why: str, read: ReadAfter, batch: Batch) -> None:
    """Note at the epoch whose findings wait why the epochs cannot be compared."""
    since = survey.revise_from
    survey.drop(again=True)
    batch.steps.append(state_of(survey, network))
    for row in [] if since is None else read(since - 1, 1):
        revise_epoch(survey, row, Findings(since or 0, 0.0, problem=why), row["number"], batch)


def _reference(survey: Surveillance, read: ReadAfter) -> ReferenceEpoch | None:
    """Return the reference epoch, from no more epochs than it takes."""
    settings, last = survey.settings, -1
    timed = settings.epochs.length is not None
    records: dict[int, dict[str, Any]] = {}
    while rows := read(last, EPOCHS_OF_STEP):
        last = rows[-1]["number"]
        records |= {r["number"]: r["result"] for r in rows}
        found = reference_epoch(records, settings.reference, timed=timed)
        # The next epoch says whether it is whole.
        if found is not None and any(
            n > found.number and r.get("estimate") for n, r in records.items()
        ):
            return found
    return reference_epoch(records, settings.reference, timed=timed)
