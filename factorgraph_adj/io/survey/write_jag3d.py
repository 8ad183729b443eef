"""Writer of flat files of JAG3D."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import InputError, Problem
from ...frames import LocalFrame
from ...models.variables import UNKNOWNS
from ...network.entities import Parameter, Point
from ...network.network import Network
from ...observations import (
    CoordinateDifference,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ..atomic import write_files
from ..numbers import write
from .jag3d_flat import FILE_KINDS, MOST_NAME
from .jag3d_model import KINDS
from .sigmas import sigmas_of

INSTRUMENTS = ("index_error", "collimation_error")
"""Attributes of observations that name errors of the instrument which JAG3D does not have."""
HEADS = {
    "points_1d": "name y x z [σ]",
    "points_2d": "name y x [σ_y σ_x]",
    "points_3d": "name y x z [σ_y σ_x σ_z]",
    "deflections": "name r_y r_x [σ_y σ_x]",
}
_DIRECTIONS = re.compile(r"directions_\d+\.txt")


def write_jag3d(network: Network, path: str | Path) -> None:
    """Write flat files of JAG3D into a folder, one for each kind of points and observations.

    Lengths are metres, angles and their σ gons, each row has its σ. Import each file in the menu
    of its kind: ``reference_points_3d.txt``, ``new_points_3d.txt``, ``slope_distances.txt`` …;
    ``directions.txt`` with "separate by station", ``directions_2.txt`` for second sets of a
    station. Files of these names from an earlier run are replaced or removed. Points that are held
    in plan become 1-D points, in height 2-D points. Standard deviations with parts that depend on
    lengths are written as they are at the coordinates of the network; an adjusted one is
    `Solution.as_network`.

    Args:
        network: the network.
        path: the folder.

    Raises:
        InputError: everything that flat files cannot hold, all at once: another frame than a flat
            local one with axes en or ne, cameras and photos, correlations, other kinds than
            directions, distances, zenith angles, height differences, GNSS vectors and differences
            of coordinates, parameters that have an effect (refraction, distance meters, held
            orientations), points without coordinates, check points, held points in a free network,
            names with spaces or semicolons, σ of 1 and more, which JAG3D takes for lengths.
            Nothing is written then.
    """
    writer = _Writer(network)
    files = writer.files()
    if writer.problems:
        raise InputError(writer.problems)
    target = Path(path)
    old = [f"{kind}.txt" for kind in FILE_KINDS]
    if target.is_dir():
        old += [f.name for f in target.iterdir() if _DIRECTIONS.fullmatch(f.name)]
    write_files(target, {**dict.fromkeys(old), **files})


class _Writer:
    def __init__(self, network: Network) -> None:
        self.network = network
        self.problems: list[Problem] = []
        self.lines: dict[str, list[str]] = {}

    def refuse(self, what: str, where: str = "") -> None:
        self.problems.append(Problem(f"flat files of JAG3D cannot hold {what}", where))

    def files(self) -> dict[str, str | bytes | None]:
        """Return the files; what they cannot hold is noted."""
        network, frame = self.network, self.network.frame
        if not isinstance(frame, LocalFrame) or frame.curvature or frame.axes not in ("en", "ne"):
            self.refuse("this frame: it takes a flat local one with axes en or ne", network.name)
            self.order: tuple[int, ...] = (0, 1, 2)
        else:
            self.order = (0, 1, 2) if frame.axes == "en" else (1, 0, 2)
        for many, noun in ((network.cameras, "cameras"), (network.photos, "photos")):
            if many:
                self.refuse(f"{noun} ({len(many)})", network.name)
        if network.clusters:
            self.refuse(f"correlated observations ({len(network.clusters)} clusters)", network.name)
        if not network.points:
            self.refuse("a network without points", network.name)
        for p in network.points.values():
            self._point(p)
        self._unknowns()
        self._observations()
        return {
            f"{kind}.txt": "\n".join([f"# {self._head(kind)}", *rows]) + "\n"
            for kind, rows in self.lines.items()
        }

    @staticmethod
    def _head(kind: str) -> str:
        for end, head in HEADS.items():
            if kind.endswith(end):
                return head
        known = KINDS["directions" if kind.startswith("directions") else kind]
        if known.axes:
            return f"station target {' '.join('Δ' + a for a in known.axes)} [σ …]"
        return f"station target [ih th] value [{'gon' if known.angle else 'm'}] σ"

    def _add(self, kind: str, *words: str) -> None:
        self.lines.setdefault(kind, []).append(" ".join(words))

    # -- points and unknowns ----------------------------------------------------------------------

    def _point(self, p: Point) -> None:
        where = f"point {p.name!r}"
        odd = [c for c in p.name if c.isspace() or c == ";" or not c.isprintable()]
        if odd or p.name.startswith("#") or len(p.name) > MOST_NAME:
            self.refuse(f"a name with {odd[0]!r}" if odd else "such a name", where)
        if p.check is not None:
            self.refuse("check points", where)
        if np.isnan(p.coordinates).any():
            self.refuse("a point without coordinates: write the adjusted network", where)
            return
        free = self.network.datum == "free"
        dimension = {"": 3, "xyz": 3, "xy": 1, "z": 2}.get(p.held)
        if dimension is None:
            self.refuse(f"a point that is held in {p.held} alone", where)
            return
        axes = {1: "z", 2: "xy", 3: "xyz"}[dimension]
        sigma = [math.inf if p.sigma is None else p.sigma["xyz".index(a)] for a in axes]
        weighted = [math.isfinite(s) for s in sigma]
        everyone = not any(q.datum for q in self.network.points.values())
        if p.held == "xyz":
            status = "reference"
        elif any(weighted):
            status = "stochastic"
            if not all(weighted):
                self.refuse("a point of which some coordinates are weighted", where)
        else:
            status = "datum" if free and (p.datum or everyone) else "new"
        if free and status in ("reference", "stochastic"):
            self.refuse(f"a {status} point in a free network: JAG3D would leave it out", where)
        shown = [p.coordinates[k] for k in self.order][: 2 if dimension == 2 else 3]
        words = [write(v) for v in shown]
        if status == "stochastic":
            of = self.order if dimension == 3 else self.order[:2] if dimension == 2 else (2,)
            assert p.sigma is not None
            words += [write(p.sigma[k]) for k in of]
        self._add(f"{status}_points_{dimension}d", p.name, *words)

    def _unknowns(self) -> None:
        for kind, table in self.network.parameters.items():
            for key, unknown in table.items():
                where = f"{UNKNOWNS[kind].noun} {key!r}"
                if kind == "vertical":
                    self._vertical(str(key), unknown, where)
                elif kind == "orientation":
                    if unknown.fixed[0] or math.isfinite(unknown.sigma[0]):
                        self.refuse("an orientation that is held or weighted", where)
                elif any(unknown.values) or not all(unknown.fixed):
                    self.refuse("a stated unknown of this kind", where)

    def _vertical(self, name: str, unknown: Parameter, where: str) -> None:
        xi, eta = unknown.values
        weighted = [math.isfinite(s) for s in unknown.sigma]
        if len(set(unknown.fixed)) > 1 or len(set(weighted)) > 1:
            self.refuse("a deflection of which one component is held or weighted", where)
            return
        status = "reference" if unknown.fixed[0] else "stochastic" if weighted[0] else "unknown"
        words = [write(-xi, "gon"), write(eta, "gon")]
        if status == "stochastic":
            words += [write(s, "gon") for s in unknown.sigma]
        self._add(f"{status}_deflections", name, *words)

    # -- observations -----------------------------------------------------------------------------

    def _observations(self) -> None:
        before = len(self.problems)
        for o in self.network.observations.values():
            if type(o) not in _FORMS:
                self.refuse(f"a {o.kind.replace('_', ' ')}", o.label())
            elif any(getattr(o, a, None) for a in INSTRUMENTS):
                self.refuse("unknowns of instruments", o.label())
            elif isinstance(o, Direction) and o.face != 1:
                self.refuse("directions of the second face", o.label())
        if len(self.problems) > before or not self.network.observations:
            return
        sigmas = sigmas_of(self.network)
        sets: dict[str, list[str]] = {}
        ordered = sorted(
            self.network.observations.items(),
            key=lambda item: (
                (item[1].station, item[1].set) if isinstance(item[1], Direction) else ("", "")
            ),
        )
        for ident, o in ordered:
            sigma = sigmas[ident]
            if math.isnan(sigma):
                what = "a σ that depends on unknown coordinates: write the adjusted network"
                self.refuse(what, o.label())
                continue
            kind, words = _FORMS[type(o)](self, o, sigma)
            if isinstance(o, Direction):
                of_station = sets.setdefault(o.station, [])
                if o.set not in of_station:
                    of_station.append(o.set)
                n = of_station.index(o.set) + 1
                kind = "directions" if n == 1 else f"directions_{n}"
            self._add(kind, o.station, o.target, *words)  # type: ignore[attr-defined]

    def scalar(self, o: Observation, value: float, sigma: float, unit: str = "") -> list[str]:
        """Return heights, value and σ of an observation."""
        ih, th = o.instrument_height, o.target_height  # type: ignore[attr-defined]
        error = write(sigma, unit)
        if float(error) >= 1.0:
            self.refuse(f"a σ of {error} {unit or 'm'}: JAG3D takes it for a length", o.label())
        heights = [write(ih), write(th)] if ih or th else []
        return [*heights, write(value, unit), error]

    def vector(self, o: Observation, axes: str) -> tuple[str, list[str]]:
        """Return kind and numbers of a difference of coordinates."""
        covariance = getattr(o, "covariance", None)
        if covariance is not None and np.any(covariance - np.diag(np.diag(covariance))):
            self.refuse("correlated components", o.label())
        sigma = o.sigma if covariance is None else np.sqrt(np.diag(covariance))  # type: ignore[attr-defined]
        if getattr(o, "instrument_height", 0.0) or getattr(o, "target_height", 0.0):
            self.refuse("heights of antennas", o.label())
        if getattr(o, "horizon", False) or getattr(o, "condition", False):
            self.refuse("a difference in a horizon, or a condition", o.label())
        kind = {"z": "gnss_1d", "xy": "gnss_2d", "xyz": "gnss_3d"}.get("".join(sorted(axes)))
        if kind is None:
            self.refuse(f"differences of {axes} alone", o.label())
            return "gnss_3d", []
        of = [axes.index("xyz"[k]) for k in self.order if "xyz"[k] in axes]
        value = o.value  # type: ignore[attr-defined]
        return kind, [write(float(part[k])) for part in (value, sigma) for k in of]


_FORMS: dict[type, Callable[..., tuple[str, list[str]]]] = {
    Direction: lambda w, o, s: ("directions", w.scalar(o, o.value, s, "gon")),
    ZenithAngle: lambda w, o, s: ("zenith_angles", w.scalar(o, o.in_face_one, s, "gon")),
    SlopeDistance: lambda w, o, s: ("slope_distances", w.scalar(o, o.value, s)),
    HorizontalDistance: lambda w, o, s: ("horizontal_distances", w.scalar(o, o.value, s)),
    HeightDifference: lambda w, o, s: ("levelling", w.scalar(o, o.value, s)),
    GnssVector: lambda w, o, _: w.vector(o, "xyz"),
    CoordinateDifference: lambda w, o, _: w.vector(o, o.axes),
}
"""Kind of file and numbers of each kind of observation."""
