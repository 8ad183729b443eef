"""Answers of the stream as JSON: verdicts, estimates, reliability, causes, snooping, refusals.

The names are those of the CSV tables of a solution (`factorgraph_adj.report.result_files`). The
stream writes numbers that are not finite as null.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ..errors import MEANT, AdjustmentError, InputError, Problem
from ..incremental.adjustment import IncrementalAdjustment
from ..incremental.arrival import Arrival, Waiting
from ..io.numbers import Units, write_quantity
from ..ledger.verdicts import Gain, Verdict
from ..observations import ImagePoint, observation_kind
from ..planning.next_sight import ExpectedFigure, NextSight, NextSights, noun_of
from ..quality.causes.cause_search import Causes
from ..quality.rejections import Rejected, Snooping, Unresolved
from ..quality.reliability import Reliability
from ..report import image_axes
from ..report.adjustment_report import Report
from ..report.observation_rows import Row, Scale, image_scale, observation_scale
from ..report.options import ReportOptions
from ..solve.estimates import CalibrationEstimate, PoseEstimate
from ..solve.solution import Solution
from ..types import Array
from ..units import ANGLE, LENGTH

Answer = dict[str, Any]
MAX_WAITING_LISTED = 20
"""Largest number of waiting observations in an answer; ``waiting`` returns all of them."""
MAX_PROBLEMS_IN_ANSWER = 100
"""Largest number of problems in an answer."""
MAX_LETTERS_OF_PROBLEM = 600
"""Largest number of characters of one problem; a message may quote a line of any length."""


@dataclass(frozen=True)
class Answers:
    """Converts the results of an adjustment to answers."""

    adjustment: IncrementalAdjustment
    """The adjustment."""
    units: Units
    """Units of the project."""

    # -- arrivals -----------------------------------------------------------------------------

    def arrival(self, found: Arrival, *, touched: Iterable[str] = ()) -> Answer:
        """Return verdicts, points and waiting observations.

        Args:
            found: the result of the arrival.
            touched: affected points besides those of the arrived observations.
        """
        again = self.points_of(found.waits)
        points, lost = self.points(dict.fromkeys((*found.points, *touched, *again)))
        return {
            "verdicts": [self.verdict(v) for v in found.verdicts if not v.entered],
            "entered": [self.verdict(v) for v in found.verdicts if v.entered],
            "points": points,
            "points_lost": lost,
            "waits_again": list(found.waits),
            **({"oriented": dict(found.oriented)} if found.oriented else {}),
            "waiting": self.latest_waiting(),
        }

    def arrivals(
        self, found: Arrival, sizes: Sequence[int], listed: Sequence[bool]
    ) -> list[Answer]:
        """Return an answer to each of several lines that came together.

        Each has its own verdict, or verdicts of a group, and the points that these touch. What else
        has changed is in the last answer.

        Args:
            found: the result of their arrival.
            sizes: number of observations of each line.
            listed: whether the verdict of a line with one observation is a list, too.
        """
        whole = self.arrival(found)
        verdicts, points = whole.pop("verdicts"), {p["name"]: p for p in whole.pop("points")}
        given = [v for v in found.verdicts if not v.entered]
        assert len(given) == sum(sizes), "each given observation has a verdict"
        nothing = {n: type(what)() for n, what in whole.items() if n != "waiting"}
        out, end = [], 0
        for size, is_list in zip(sizes, listed, strict=True):
            begin, end = end, end + size
            touched = (n for v in given[begin:end] if v.verdict == "accepted" for n in v.points)
            own = [points[n] for n in dict.fromkeys(touched) if n in points]
            one = size == 1 and not is_list
            said = verdicts[begin] if one else {"verdicts": verdicts[begin:end]}
            out.append(said | nothing | {"points": own, "waiting": whole["waiting"]})
        shown = {p["name"] for answer in out for p in answer["points"]}
        others = [p for n, p in points.items() if n not in shown]
        out[-1] |= whole | {"points": [*out[-1]["points"], *others]}
        return out

    def points_of(self, ids: Iterable[str]) -> list[str]:
        """Return the points of observations."""
        names = (n for i in ids for n in self.adjustment.observation(i).points())
        return list(dict.fromkeys(n for n in names if n is not None))

    def points(self, names: Iterable[str]) -> tuple[list[Answer], list[str]]:
        """Return the free points with coordinates, and the names of the undetermined ones."""
        found, lost = [], []
        for name in names:
            if all(self.adjustment.entities.points[name].fixed):
                continue
            try:
                found.append(self.estimate(name))
            except InputError:
                lost.append(name)
        return found, lost

    def estimate(self, name: str) -> Answer:
        """Return the present estimate of a point.

        Raises:
            InputError: the point is unknown or not determined.
        """
        inc = self.adjustment
        return self.point(name, inc.estimate(name), inc.standard_deviations(name))

    def latest_waiting(self) -> list[Answer]:
        """Return the waiting observations, the latest first, at most `MAX_WAITING_LISTED`."""
        return [self.waiting(w) for w in self.adjustment.latest_waiting(MAX_WAITING_LISTED)]

    def counts(self) -> Answer:
        """Return the numbers of observations by state, the redundancy and σ̂0."""
        inc = self.adjustment
        return {
            "observations": len(inc),
            "waiting": inc.n_waiting,
            "suspects": len(inc.suspects),
            "rejected": len(inc.rejected),
            "doubts": len(inc.doubts),
            "redundancy": inc.redundancy,
            "sigma0": rounded_figure(inc.sigma0),
        }

    # -- verdicts -----------------------------------------------------------------------------

    def verdict(self, v: Verdict) -> Answer:
        """Return the verdict about one observation; σ and w of a waiting one are unknown."""
        out = fields_of(v, "id", "kind", "label", "verdict")
        if v.cause:
            out["cause"] = v.cause
        if v.doubt:
            out["doubt"] = v.doubt
        if v.verdict == "waiting":
            return out | {"lacks": v.lacks}
        if v.innovation is None:  # data snooping gave the verdict instead of a test on arrival
            return out
        assert v.sigma is not None and v.w is not None and v.redundancy_numbers is not None
        scale = self._scale(v)
        sign = np.array([scale.sign(c) for c in v.components])
        return out | {
            "test": rounded_figure(v.test),
            "t2": rounded_figure(v.t2),
            "dof": v.dof,
            "critical": rounded_figure(v.critical),
            "controlled": bool(v.controlled),
            "components": list(v.components),
            "innovation": rounded_figures(sign * v.innovation / scale.size),
            "innovation_sigma": rounded_figures(v.sigma / scale.size),
            "small_unit": scale.small,
            "w": rounded_figures(sign * v.w),
            "redundancy_number": rounded_figures(v.redundancy_numbers),
            "gains": [self.gain(g) for g in v.gains],
        }

    def _test_value(self, found: Rejected | Unresolved) -> float:
        return rounded_figure(self._scale(found).sign(found.component) * found.test)

    def _scale(self, v: Verdict | Rejected | Unresolved) -> Scale:
        """Return the units of an observation."""
        network = self.adjustment.entities
        unit = observation_kind(v.kind).unit
        if unit == "image" and network.cameras:
            scales = {image_scale(c) for c in network.cameras.values()}
            if len(scales) > 1:  # looking up an image point takes longer than its verdict
                photo = cast(ImagePoint, self.adjustment.observation(v.id)).photo
                scales = {image_scale(network.cameras[network.photos[photo].camera])}
            return scales.pop()
        return observation_scale(unit, self.units)

    def gain(self, g: Gain) -> Answer:
        """Return σ of a point before and after an observation."""
        unit = self.units.sigma_length
        before, after = self._xyz("before_", g.before, unit), self._xyz("after_", g.after, unit)
        return {"point": g.point, **before, **after}

    def waiting(self, w: Waiting) -> Answer:
        """Return a waiting observation and the support that it lacks."""
        return fields_of(w, "id", "kind", "label", "lacks")

    # -- unknowns -----------------------------------------------------------------------------

    def point(self, name: str, coordinates: Array, sigma: Array) -> Answer:
        """Return a point: coordinates in the unit of lengths, σ in the unit of σ of lengths."""
        at = zip("xyz", np.asarray(coordinates).tolist(), strict=True)
        out: Answer = {"name": name}
        out |= {a: self.length(v) for a, v in at}
        return out | self._xyz("sigma_", sigma, self.units.sigma_length)

    def photo(self, name: str, pose: PoseEstimate) -> Answer:
        """Return a photo: projection centre, ω φ κ and σ; σ of the attitude are about its axes."""
        small = self.units.sigma_angle
        out: Answer = {"name": name}
        out |= {a: self.length(v) for a, v in zip("xyz", pose.position.tolist(), strict=True)}
        about = zip(("omega", "phi", "kappa"), pose.omega_phi_kappa.tolist(), strict=True)
        out |= {a: self.angle(v) for a, v in about}
        out |= self._xyz("sigma_", pose.sigmas[3:], self.units.sigma_length)
        turns = zip(("rx", "ry", "rz"), pose.sigmas[:3].tolist(), strict=True)
        return out | {f"sigma_{a}_{small}": rounded_figure(s / ANGLE[small]) for a, s in turns}

    def calibration(self, name: str, e: CalibrationEstimate) -> Answer:
        """Return a calibration in units and axes of the camera's files."""
        e = image_axes.calibration_in_files(self.adjustment.entities, name, e)
        return {
            "name": name,
            "unit": e.unit,
            "parameters": {n: float(v) for n, v in zip(e.names, e.values, strict=True)},
            "sigma": {n: rounded_figure(float(s)) for n, s in zip(e.names, e.sigmas, strict=True)},
        }

    def length(self, metres: float) -> float:
        """Return a length in the project's unit."""
        unit = self.units.length
        return float(metres) if unit == "m" else float(f"{metres / LENGTH[unit]:.15g}")

    def angle(self, radians: float) -> float | str:
        """Return an angle in the project's unit; degrees-minutes-seconds are text."""
        text = write_quantity(radians, self.units.angle)
        return text if self.units.angle == "dms" else float(text)

    def _xyz(self, prefix: str, sigma: Iterable[float] | Array, unit: str) -> Answer:
        return {
            f"{prefix}{a}_{unit}": rounded_figure(float(s) / LENGTH[unit])
            for a, s in zip("xyz", sigma, strict=True)
        }

    # -- whole adjustments --------------------------------------------------------------------

    def solution(self, s: Solution) -> Answer:
        """Return a solution: figures of the adjustment, points, photos, calibrations."""
        report = Report(s, ReportOptions(self.units))
        at = s.state["point"]
        return {
            "name": s.network.name,
            **fields_of(s, "converged", "reason", "n_observations", "n_unknowns"),
            **fields_of(s, "datum_defect", "redundancy", "second_places"),
            "vtpv": rounded_figure(s.vtpv),
            "sigma0": rounded_figure(s.sigma0),
            "points": [
                self.point(n, at[i], report.sigmas[i]) for i, n in enumerate(s.network.points)
            ],
            "photos": [self.photo(n, s.pose(n)) for n in s.network.photos],
            "calibrations": [self.calibration(n, s.calibration(n)) for n in report.calibrations],
        }

    def reliability(self, rel: Reliability, most: int) -> Answer:
        """Return the reliability: redundancy, uncontrolled, weakest and suspect observations."""
        report, r = Report(rel.solution, ReportOptions(self.units)), rel.redundancy_numbers
        uncontrolled = report.rows.at(np.flatnonzero(~rel.controlled).tolist())
        smallest = np.argsort(np.where(rel.controlled, r, np.inf), kind="stable")
        weakest = [int(i) for i in smallest[: min(most, int(rel.controlled.sum()))]]
        suspects = rel.suspects(most, critical=rel.critical_w)
        largest = [
            int(g.rows[np.argmax(np.where(rel.controlled[g.rows], rel.mdb[g.rows], -1.0))])
            for g in report.rows.groups()
            if rel.controlled[g.rows].any()
        ]
        sharing = {s.row: list(s.inseparable) for s in suspects}
        labels = rel.solution.equations.label
        return {
            "alpha": rel.alpha,
            "power": rel.power,
            "critical_w": rounded_figure(rel.critical_w),
            "sum": rounded_figure(float(r.sum()) + rel.redundancy_of_extra_factors),
            "redundancy": rel.solution.redundancy,
            "uncontrolled": [_which(row) for row in uncontrolled],
            "weakest": [self._reliable(rel, row) for row in report.rows.at(weakest)],
            "largest_mdb": [self._reliable(rel, row) for row in report.rows.at(largest)],
            "suspects": [
                self._reliable(rel, row)
                | {
                    "not_told_apart_from": [
                        {"label": labels(i), "correlation": rounded_figure(rho)}
                        for i, rho in sharing[row.number]
                    ]
                }
                for row in report.rows.at([s.row for s in suspects])
            ],
        }

    def _reliable(self, rel: Reliability, row: Row) -> Answer:
        i = row.number
        return _which(row) | {
            "redundancy_number": rounded_figure(rel.redundancy_numbers[i]),
            "w": rounded_figure(row.sign * rel.w[i]),
            "mdb": rounded_figure(rel.mdb[i] / row.scale.size),
            "estimated_error": rounded_figure(row.sign * rel.estimated_errors[i] / row.scale.size),
            "small_unit": row.scale.small,
            "delta_bar": rounded_figure(rel.delta_bar[i]),
        }

    def causes(self, found: Causes | None) -> Answer:
        """Return the causes of misfits; empty where nothing misfits.

        Errors and their σ are in SI, image units or ppm, by the quantity of each.
        """
        if found is None:
            return {"most_probable": None, "undecided": [], "causes": []}
        return {
            "most_probable": None if found.most_probable is None else str(found.most_probable),
            "undecided": list(found.undecided),
            "causes": [
                fields_of(c, "cause", "where", "t2", "dof", "critical")
                | {"components": list(c.components), "quantities": list(c.sizes)}
                | {"error": c.error.tolist(), "sigma": c.sigma.tolist(), "ids": list(c.ids)}
                for c in found.found
            ],
        }

    def next_sights(self, found: NextSights) -> Answer:
        """Return the best next sights with their figures."""
        return {
            "examined": found.examined,
            "figures": [self._expected(f, ("now",), (f.before,)) for f in found.figures],
            "sights": [self._sight(s) for s in found.sights],
            "determining": list(found.determining),
        }

    def _sight(self, s: NextSight) -> Answer:
        first = next(iter(s.candidate.single))
        return {
            "sentence": s.sentence(self.units.sigma_length),
            "name": s.candidate.name,
            "station": getattr(first, "station", None),
            "target": getattr(first, "target", None) or getattr(first, "point", None),
            "kinds": list(dict.fromkeys(o.kind for o in s.candidate.single)),
            "gain": rounded_figure(s.gain),
            "cost": s.cost,
            "incomplete": s.lacks,
            "figures": [
                self._expected(f, ("before", "after"), (f.before, f.after)) for f in s.figures
            ],
        }

    def _expected(self, f: ExpectedFigure, names: Sequence[str], values: Sequence[float]) -> Answer:
        unit = self.units.sigma_length
        size, end = (LENGTH[unit], f"_{unit}") if f.is_length else (1.0, "")
        shown = {f"{n}{end}": rounded_figure(v / size) for n, v in zip(names, values, strict=True)}
        return {"item": f.item, "what": noun_of(f.target), **shown}

    def snooping(self, found: Snooping, came_back: Arrival) -> Answer:
        """Return the set-aside, readmitted and unresolved observations of data snooping.

        Args:
            found: the result of the search.
            came_back: what fits without what was rejected.
        """
        return {
            "reason": found.reason,
            "critical": rounded_figure(found.critical),
            "sigma0": rounded_figure(found.solution.sigma0),
            "set_aside": [
                _which(r) | {"round": r.round, "test_value": self._test_value(r)}
                for r in found.rejected
            ],
            "rejected_points": [
                {"name": p.name, "rays": list(p.rays), "reason": p.reason}
                for p in found.rejected_points
            ],
            "readmitted": list(found.readmitted),
            "unresolved": [
                _which(u) | {"test_value": self._test_value(u), "reason": u.reason}
                for u in found.unresolved
            ],
            "entered": [self.verdict(v) for v in came_back.verdicts],
        }


def fields_of(record: object, *names: str) -> Answer:
    """Return fields of a record by name, in this order."""
    return {name: getattr(record, name) for name in names}


def _which(row: Row | Rejected | Unresolved) -> Answer:
    return fields_of(row, "id", "kind", "component")


def rounded_figure(value: float) -> float:
    """Return a derived figure with enough digits for further use."""
    return float(f"{value:.9g}") + 0.0


def rounded_figures(values: Sequence[float] | Array) -> list[float]:
    """Return derived figures as `figure` does."""
    return [rounded_figure(v) for v in np.asarray(values, dtype=float).tolist()]


# -- errors ----------------------------------------------------------------------------------------


def refusal(number: int, error: AdjustmentError) -> Answer:
    """Return the answer to a faulty line."""
    problems: tuple[Problem, ...] = getattr(error, "problems", (Problem(str(error)),))
    listed = [
        {"where": cut_short(p.where), "what": cut_short(p.what)}
        for p in problems[:MAX_PROBLEMS_IN_ANSWER]
    ]
    if len(problems) > MAX_PROBLEMS_IN_ANSWER:
        listed.append({"where": "", "what": f"… and {len(problems) - MAX_PROBLEMS_IN_ANSWER} more"})
    return {"line": number, "ok": False, "error": listed}


def fault(number: int, error: Exception) -> Answer:
    """Return the answer to a line on which the program itself failed."""
    what = f"a fault of the program, not of the line: {type(error).__name__}: {error}"
    return refusal(number, InputError(what))


def cut_short(text: str) -> str:
    """Return a text of at most about `MAX_LETTERS_OF_PROBLEM` characters.

    What may have been meant stands at the end of a list of valid names, and is kept.
    """
    if len(text) <= MAX_LETTERS_OF_PROBLEM:
        return text
    begin, meant, name = text.rpartition(MEANT)
    if not meant or len(name) > MAX_LETTERS_OF_PROBLEM // 4:
        return text[:MAX_LETTERS_OF_PROBLEM] + "…"
    # The last name of the list is not cut in two.
    shown = begin[:MAX_LETTERS_OF_PROBLEM].rpartition(", ")[0] or begin[:MAX_LETTERS_OF_PROBLEM]
    return f"{shown}, …{meant}{name}"
