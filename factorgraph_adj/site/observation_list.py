"""Lists of observations that the API shows: of every state, in pages, with figures and records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..errors import InputError, known
from ..io.numbers import write_quantity
from ..io.observation_records import observation_record
from ..quality.reliability import Reliability
from ..report.adjustment_report import Report
from ..report.observation_rows import Row
from ..report.options import ReportOptions
from ..service.answers import rounded_figure
from .live_epochs import LiveEpoch

STATES = ("accepted", "waiting", "suspect", "rejected")
"""States of observations."""
TESTED = (
    *("test", "t2", "dof", "critical", "controlled", "components", "innovation"),
    *("innovation_sigma", "small_unit", "w", "redundancy_number"),
)
"""Figures of a test."""

Answer = dict[str, Any]


class ObservationList:
    """The observations of an epoch, whose lock is held meanwhile."""

    def __init__(self, epoch: LiveEpoch, report: Report | None) -> None:
        """Take an epoch.

        Args:
            epoch: the epoch.
            report: its report with reliability; None: nothing is determined.
        """
        self.epoch, self.adjustment = epoch, epoch.stream.adjustment
        self._report = report

    def sights(self) -> list[Answer]:
        """Return the observations between two places, each with its largest test value."""
        out = []
        for group in self._groups():
            row, found = group[0], self._reliability
            ends = [*row.points[:2]] if len(row.points) > 1 else [row.photo, *row.points]
            if len(ends) < 2 or not all(ends):
                continue
            figures = _largest(group, found)
            mine: Answer = {"id": row.id, "kind": row.kind, "from": ends[0], "to": ends[1]}
            out.append(mine | {"state": "accepted", "w": figures["w"], "r": figures["r"]})
        for state in STATES[1:]:
            for ident in self._ids(state):
                o = self.adjustment.observation(ident)
                ends = [*o.photos(), *(p for p in o.points() if p is not None)][:2]
                if len(ends) == 2:
                    mine = {"id": ident, "kind": o.kind, "from": ends[0], "to": ends[1]}
                    out.append(mine | {"state": state, "w": None, "r": None})
        return out

    def page(
        self,
        state: str = "accepted",
        *,
        limit: int = 200,
        after: str = "",
        point: str = "",
        text: str = "",
    ) -> Answer:
        """Return a page of observations of a state.

        Args:
            state: one of `STATES`.
            limit: largest number of them.
            after: id of the last observation of the page before.
            point: only those of this point.
            text: only those whose label has this text.

        Raises:
            InputError: unknown state or id.
        """
        if state not in STATES:
            raise InputError(f"unknown state {state!r}; valid: {known(STATES, meant=state)}")
        rows = self._accepted() if state == "accepted" else self.others(state)
        if point:
            rows = [r for r in rows if point in r["points"]]
        if text:
            rows = [r for r in rows if text.lower() in r["label"].lower()]
        first = 0
        if after:
            ids = [r["id"] for r in rows]
            if after not in ids:
                raise InputError(f"no observation {after!r} on the page before")
            first = len(ids) - ids[::-1].index(after)
        page = rows[first : first + limit]
        for row in page:
            row |= self._recorded(row["id"])
        more = first + limit < len(rows)
        return {"total": len(rows), "rows": page, "next": page[-1]["id"] if more else None}

    def others(self, state: str) -> list[Answer]:
        """Return the observations that wait, are suspect or rejected, with their verdicts."""
        inc, answers = self.adjustment, self.epoch.stream.answers
        if state == "waiting":
            rows = [answers.waiting(w) | {"verdict": state} for w in inc.waiting]
        else:
            found = inc.suspects if state == "suspect" else inc.rejected
            rows = [answers.verdict(v) for v in found]
        for row in rows:
            o = inc.observation(row["id"])
            row["points"] = [p for p in o.points() if p is not None]
            row |= {"state": state, "epoch": self.epoch.number}
        return rows

    def tested_now(self) -> dict[str, Answer]:
        """Return the tests of what is left out against everything that is in, by ids."""
        answers = self.epoch.stream.answers
        found = {v.id: answers.verdict(v) for v in self.adjustment.tested_now()}
        return {i: {n: f[n] for n in TESTED if n in f} for i, f in found.items()}

    def _ids(self, state: str) -> Iterable[str]:
        inc = self.adjustment
        if state == "waiting":
            return [w.id for w in inc.waiting]
        return [v.id for v in (inc.suspects if state == "suspect" else inc.rejected)]

    @property
    def _reliability(self) -> Reliability:
        assert self._report is not None and self._report.known is not None
        return self._report.known

    def _groups(self) -> list[list[Row]]:
        """Return the rows of each accepted observation together."""
        out: dict[tuple[str, str], list[Row]] = {}
        for row in self._report.rows.all() if self._report is not None else ():
            out.setdefault((row.kind, row.id), []).append(row)
        return list(out.values())

    def _accepted(self) -> list[Answer]:
        out = []
        for group in self._groups():
            row = group[0]
            mine: Answer = {"id": row.id, "kind": row.kind, "label": row.what, "state": "accepted"}
            mine |= {"points": list(row.points), "photo": row.photo, "epoch": self.epoch.number}
            mine |= {"value": " ".join(_value(x) for x in group), "small_unit": row.scale.small}
            out.append(mine | _largest(group, self._reliability))
        return out

    def _recorded(self, ident: str) -> Answer:
        """Return the record to replace an observation; a weighted unknown has none."""
        units = self.epoch.stream.context.units
        try:
            o = self.adjustment.observation(ident)
            return {"record": {k: v for k, v in observation_record(o, units=units).items() if v}}
        except InputError:
            return {"record": None}


def observation_list(epoch: LiveEpoch) -> ObservationList:
    """Return the observations of an epoch, with the reliability of its solution."""
    stream = epoch.stream
    try:
        solution = stream.adjustment.solution()
    except InputError:
        return ObservationList(epoch, None)
    reliability = stream.adjustment.reliability(power=stream.power)
    options = ReportOptions(stream.context.units)
    return ObservationList(epoch, Report(solution, options, known=reliability))


def _largest(group: Sequence[Row], found: Reliability) -> Answer:
    """Return the figures of the component with the largest test value."""
    w = np.abs([found.w[x.number] for x in group])
    row = group[int(np.argmax(np.where(np.isfinite(w), w, -1.0)))]
    i, size = row.number, row.scale.size
    figures = {
        "v": row.residual / size,
        "sigma": row.sigma / size,
        "w": row.sign * float(found.w[i]),
        "r": float(found.redundancy_numbers[i]),
        "mdb": float(found.mdb[i]) / size,
    }
    return {n: rounded_figure(v) for n, v in figures.items()} | {"component": row.component}


def _value(row: Row) -> str:
    """Return an observed value with its unit."""
    scale = row.scale
    if scale.image or not scale.unit:
        return f"{row.observed:.10g} {scale.unit}".strip()
    return f"{write_quantity(row.observed, scale.unit)} {scale.unit}"
