"""What the API shows of an epoch: figures, points with error ellipses, photos, covariances."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from ..errors import AdjustmentError
from ..frames import GeocentricFrame
from ..quality.error_ellipses import error_ellipses
from ..report.plots.drawing_plane import drawing_plane_of
from ..service.answers import rounded_figure
from ..solve.solution import Solution
from ..statistical_tests import CONFIDENCE_OF_REGION, normal_quantile
from ..units import LENGTH
from .epoch_results import sigma0_limits
from .live_epochs import LiveEpoch

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
        """Return what there is, in which units, and the bounds of tests."""
        network, ready = self.adjustment.entities, self.stream.ready()
        out = {n: ready[n] for n in ("units", "policy", "alpha", "power", "counts")}
        out |= {"points": len(network.points), "photos": len(network.photos)}
        held = [np.array(p.fixed) for p in network.points.values()]
        open_axes = ~np.all(held, axis=0) if held else np.ones(3, dtype=bool)
        out |= {
            "dimension": int(open_axes.sum()),
            "critical_w": normal_quantile(1.0 - 0.5 * out["alpha"]),
        }
        out["sigma0_limits"] = sigma0_limits(self.adjustment)
        out |= {"length_m": LENGTH[self.stream.context.units.length], "plane": self.plane()}
        geocentric = isinstance(network.frame, GeocentricFrame)
        xy = np.array([p.coordinates[:2] for p in network.points.values()]).reshape(-1, 2)
        flat = not len(xy) or not np.ptp(xy, axis=0).any()
        without_plan = bool(held) and not geocentric and not open_axes[:2].any()
        out["heights_only"] = bool(without_plan and flat and not network.photos)
        crs = None if network.crs is None else network.crs.name
        out |= {"datum": network.datum, "crs": crs, "axes": list("xyz")}
        return out | {"title": network.name, "epoch": self.epoch.summary()}

    def plane(self) -> Answer | None:
        """Return the plane of drawings, (e, n, u) = axes · (X − origin); None: no place is known.

        Its origin is in metres.
        """
        network = self.adjustment.entities
        xyz = np.array([p.coordinates for p in network.points.values()]).reshape(-1, 3)
        xyz = xyz[np.isfinite(xyz).all(axis=1)]
        if isinstance(network.frame, GeocentricFrame) and not len(xyz):
            solution = self.solution()
            if solution is None or not len(solution.state["point"]):
                return None
            xyz = solution.state["point"]
        plane = drawing_plane_of(network.frame, xyz)
        return {"origin": plane.origin.tolist(), "axes": plane.axes.tolist(), "note": plane.note}

    def solution(self) -> Solution | None:
        """Return the solution; None where nothing is determined."""
        try:
            return self.adjustment.solution()
        except AdjustmentError:
            return None

    def points(self) -> list[Answer]:
        """Return all points, with coordinates where there are any."""
        network, solution = self.adjustment.entities, self.solution()
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
        network, out = self.adjustment.entities, []
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
