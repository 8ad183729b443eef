"""What the API shows of an epoch: points with ellipses, sights with test values, observations."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from ..errors import AdjustmentError, InputError, known
from ..io.numbers import write_quantity
from ..quality.error_ellipses import error_ellipses
from ..quality.reliability import Reliability
from ..report.adjustment_report import Report
from ..report.observation_rows import Row
from ..report.options import ReportOptions
from ..service.answers import fields_of, rounded_figure
from ..solve.solution import Solution
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..units import LENGTH
from .live_epochs import LiveEpoch

STATES = ("accepted", "waiting", "suspect", "rejected")
"""States of observations."""

Answer = dict[str, Any]


class EpochView:
    """An epoch as the API shows it; its lock is held meanwhile."""

    def __init__(self, epoch: LiveEpoch, objects: Sequence[str] = ()) -> None:
        """Take an epoch.

        Args:
            epoch: the epoch.
            objects: patterns of names of points that may move.
        """
        self.epoch, self.objects = epoch, objects
        self.stream, self.adjustment = epoch.stream, epoch.stream.adjustment
        self.answers = epoch.stream.answers

    def summary(self) -> Answer:
        """Return what there is, and in which units."""
        network, ready = self.adjustment.described, self.stream.ready()
        out = {n: ready[n] for n in ("units", "policy", "alpha", "power", "counts")}
        out |= {"points": len(network.points), "photos": len(network.photos)}
        crs = None if network.crs is None else network.crs.name
        out |= {"datum": network.datum, "crs": crs, "axes": list("xyz")}
        return out | {"title": network.name, "epoch": self.epoch.summary()}

    def solution(self) -> Solution | None:
        """Return the solution; None where nothing is determined."""
        try:
            return self.adjustment.solution()
        except AdjustmentError:
            return None

    def points(self) -> list[Answer]:
        """Return all points, with coordinates where there are any."""
        network, solution = self.adjustment.described, self.solution()
        unit = self.stream.context.units.sigma_length
        size = LENGTH[unit]
        found: dict[str, Answer] = {}
        if solution is not None:
            found = {p["name"]: p for p in self.answers.solution(solution)["points"]}
            places = [n for n in found if n in solution.network.points]
            for ellipse in error_ellipses(solution, places, confidence=CONFIDENCE_OF_REGION):
                a, b = (rounded_figure(s / size) for s in ellipse.semi_axes)
                azimuth = rounded_figure(float(np.degrees(ellipse.azimuth)))
                found[str(ellipse.a)]["ellipse"] = {
                    f"a_{unit}": a,
                    f"b_{unit}": b,
                    "azimuth_deg": azimuth,
                    "level": CONFIDENCE_OF_REGION,
                }
        out = []
        for name, point in network.points.items():
            mine = found.get(name)
            if mine is None:
                at = zip("xyz", point.coordinates, strict=True)
                mine = {"name": name} | {
                    a: self.answers.length(v) if np.isfinite(v) else None for a, v in at
                }
            mine |= {"fixed": point.held, "determined": name in found, "datum": point.datum}
            mine["object"] = any(fnmatchcase(name, pattern) for pattern in self.objects)
            out.append(mine)
        return out

    def photos(self) -> list[Answer]:
        """Return the photos that are determined, with the points that they see."""
        network, out = self.adjustment.described, []
        solution = self.solution()
        if solution is None:
            return []
        rays: dict[str, list[str]] = {}
        for ray in solution.network.image_points():
            rays.setdefault(ray.photo, []).append(ray.point)
        for name in solution.network.photos:
            shown = self.answers.photo(name, solution.pose(name))
            out.append(shown | {"camera": network.photos[name].camera, "rays": rays.get(name, [])})
        return out

    # -- observations -----------------------------------------------------------------------------

    def report(self) -> Report | None:
        """Return the report of the solution; None where nothing is determined."""
        solution = self.solution()
        if solution is None:
            return None
        reliability = self.adjustment.reliability(power=self.stream.power)
        return Report(solution, ReportOptions(self.stream.context.units), known=reliability)

    def sights(self) -> list[Answer]:
        """Return the observations between two places, each with its largest test value."""
        report, out = self.report(), []
        if report is not None:
            assert report.known is not None
            w, r = report.known.w, report.known.redundancy_numbers
            for group in _by_id(report.rows.all()):
                row = group[0]
                ends = [*row.points[:2]] if len(row.points) > 1 else [row.photo, *row.points]
                if len(ends) < 2 or not all(ends):
                    continue
                worst = max(group, key=lambda x: abs(w[x.number]))
                out.append(
                    fields_of(row, "id", "kind")
                    | {"from": ends[0], "to": ends[1], "state": "accepted"}
                    | {"w": rounded_figure(worst.sign * float(w[worst.number]))}
                    | {"r": rounded_figure(float(min(r[x.number] for x in group)))}
                )
        for state in STATES[1:]:
            for ident in self._ids(state):
                o = self.adjustment.observation(ident)
                ends = [*o.photos(), *(p for p in o.points() if p is not None)][:2]
                if len(ends) == 2:
                    mine = {"id": ident, "kind": o.kind, "from": ends[0], "to": ends[1]}
                    out.append(mine | {"state": state, "w": None, "r": None})
        return out

    def observations(
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
        rows = self._accepted() if state == "accepted" else self._others(state)
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
        more = first + limit < len(rows)
        return {"total": len(rows), "observations": page, "next": page[-1]["id"] if more else None}

    def _ids(self, state: str) -> list[str]:
        inc = self.adjustment
        if state == "waiting":
            return [w.id for w in inc.waiting]
        return [v.id for v in (inc.suspects if state == "suspect" else inc.rejected)]

    def _others(self, state: str) -> list[Answer]:
        inc = self.adjustment
        if state == "waiting":
            rows = [self.answers.waiting(w) for w in inc.waiting]
        else:
            rows = [
                self.answers.verdict(v)
                for v in (inc.suspects if state == "suspect" else inc.rejected)
            ]
        for row in rows:
            o = inc.observation(row["id"])
            row["points"] = [p for p in o.points() if p is not None]
            row["state"] = state
        return rows

    def _accepted(self) -> list[Answer]:
        report = self.report()
        if report is None or report.known is None:
            return []
        known_ = report.known
        out = []
        for group in _by_id(report.rows.all()):
            row = group[0]
            out.append(
                fields_of(row, "id", "kind")
                | {"label": row.what, "state": "accepted", "points": list(row.points)}
                | {"photo": row.photo, "unit": row.scale.unit, "small_unit": row.scale.small}
                | {"components": [_component(x, known_) for x in group]}
            )
        return out

    def covariance(self, names: Sequence[str]) -> Answer:
        """Return the joint covariance of points, metres².

        Raises:
            InputError: a point is unknown or not determined.
        """
        inc = self.adjustment
        blocks = [[np.asarray(inc.covariance(a, b)) for b in names] for a in names]
        matrix = np.block(blocks) if names else np.zeros((0, 0))
        rows = [f"{n} {axis}" for n in names for axis in "xyz"]
        return {"unit": "m²", "rows": rows, "covariance": matrix.tolist()}


def _component(row: Row, found: Reliability) -> Answer:
    i, scale = row.number, row.scale
    figures: dict[str, float] = {
        "v": row.residual / scale.size,
        "sigma": row.sigma / scale.size,
        "w": row.sign * float(found.w[i]),
        "redundancy_number": float(found.redundancy_numbers[i]),
        "mdb": float(found.mdb[i]) / scale.size,
    }
    unit = scale.unit
    value = row.observed if scale.image or not unit else write_quantity(row.observed, unit)
    shown: Answer = {n: rounded_figure(v) for n, v in figures.items()}
    return {"component": row.component, "value": value} | shown


def _by_id(rows: Sequence[Row]) -> list[list[Row]]:
    """Return the rows of each observation together."""
    out: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        out.setdefault((row.kind, row.id), []).append(row)
    return list(out.values())
