"""Set-ups whose stations no record of a field book states: their sights, and where they stood.

Files of instruments begin with sights where the surveyor entered the station before the job was
begun. The coordinates that an instrument writes beside polar readings give the station: the plane
similarity of scale 1 that carries the polar places of three or more targets to their coordinates
has the station as its shift, and the mean difference of heights is the height of the tilting axis.
A set-up goes on as long as readings and coordinates agree. Where no coordinates are beside readings
and the file has no station at all, the sights are one set-up unless they contradict it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...models.similarity import fit_similarity
from ...types import Array
from ..source import LeftOutReason
from .stated_coordinates import UNKNOWN_COORDINATES, Place

WITHOUT_STATION = LeftOutReason("sights", "no station is known for them")
UNNAMED_STATION = "station"
"""Name of a station that the file does not name."""
MIN_TARGETS = 3
"""Number of targets whose coordinates and polar readings give a station."""
MIN_EXTENT_M = 1.0
"""Extent of targets below which their coordinates, rounded to mm, do not orient a set-up."""
MAX_MISFIT_M, MAX_MISFIT_RATIO = 0.05, 1e-3
"""Difference of coordinates and readings of one set-up, metres, and its part that grows with the
distance, which scales of projections have."""
SAME_PLACE_M = 0.01
"""Distance in plan below which a point of the file is the computed station."""
MAX_INSTRUMENT_HEIGHT_M = 3.0
"""Largest plausible height of an instrument."""
MAX_REPEATED_DISTANCE_M = 0.1
MAX_REPEATED_ANGLE_RAD = 0.01
"""Differences of distances and zenith readings beyond which a target that is read again in the
same face is seen from another station."""


@dataclass(frozen=True)
class UnnamedSight:
    """A sight before any station."""

    line: int
    target: str
    coordinates: Place
    """Coordinates beside the readings; NaN: unknown."""
    readings: Mapping[str, Any]
    """Arguments of `FieldBook.sight`."""

    def polar_place(self) -> Place | None:
        """Return the target's foot from the tilting axis in a frame of the circle, metres.

        None: a reading or a coordinate is missing.
        """
        hz, z, s = (self.readings[n] for n in ("direction", "zenith", "distance"))
        if hz is None or z is None or s is None or any(math.isnan(v) for v in self.coordinates):
            return None
        if z > math.pi:  # face 2
            hz, z = hz - math.pi, 2 * math.pi - z
        level = s * math.sin(z)
        up = s * math.cos(z) - (self.readings["target_height"] or 0.0)
        return level * math.sin(hz), level * math.cos(hz), up


@dataclass(frozen=True, eq=False)
class StationFit:
    """A station that coordinates beside readings give."""

    axis: Place
    """East, north and height of the tilting axis, metres."""
    misfits: Array
    """Distances of the places that readings give from the coordinates, metres, (n,)."""
    limits: Array
    """Largest distances of readings of one set-up, metres, (n,)."""
    sights: Sequence[UnnamedSight]
    """The sights that have coordinates."""

    @property
    def fits(self) -> bool:
        """Whether all sights are of one set-up."""
        return bool(np.all(self.misfits < self.limits))

    def __str__(self) -> str:
        """Say how well it fits."""
        worst = int(np.argmax(self.misfits))
        rms = float(np.sqrt(np.mean(self.misfits**2)))
        return (
            f"differ by {rms:.4f} m (root mean square), most at {self.sights[worst].target!r}, "
            f"by {self.misfits[worst]:.4f} m"
        )


def fit_station(sights: Sequence[UnnamedSight]) -> StationFit | None:
    """Return the station that coordinates beside readings give; None: too few have them."""
    used = [s for s in sights if s.polar_place() is not None]
    if len({s.target for s in used}) < MIN_TARGETS:
        return None
    polar, known = (
        np.array([s.polar_place() for s in used]),
        np.array([s.coordinates for s in used]),
    )
    if np.ptp(known[:, :2], axis=0).max() < MIN_EXTENT_M:
        return None
    plan = fit_similarity(polar[:, :2], known[:, :2], scale=1.0)
    axis = float(np.mean(known[:, 2] - polar[:, 2]))
    computed = np.column_stack([plan.of(polar[:, :2]), polar[:, 2] + axis])
    misfits = np.linalg.norm(computed - known, axis=1)
    limits = MAX_MISFIT_M + MAX_MISFIT_RATIO * np.hypot(*polar[:, :2].T)
    e, n = map(float, plan.shift)
    return StationFit((e, n, axis), misfits, limits, used)


@dataclass(frozen=True)
class FoundSetUp:
    """A set-up of sights that no record opens."""

    station: str
    sights: Sequence[UnnamedSight]
    coordinates: Place = UNKNOWN_COORDINATES
    height: float | None = None
    """Height of the instrument that follows from the height of the point; None: none does."""
    remark: str = ""


@dataclass
class UnnamedSights:
    """Sights before any station, and heights of the instrument among them."""

    name: str
    """Name of the only station that the user states; empty: none."""
    sights: list[UnnamedSight] = field(default_factory=list)
    heights: list[tuple[int, float]] = field(default_factory=list)
    """Lines and heights of the instrument."""

    def add(self, line: int, target: str, coordinates: Place, **readings: Any) -> None:
        """Note a sight."""
        self.sights.append(UnnamedSight(line, target, coordinates, readings))

    def heights_of(self, sights: Sequence[UnnamedSight]) -> list[tuple[int, float]]:
        """Return the heights of the instrument among some sights, with their lines."""
        first, last = sights[0].line, sights[-1].line
        return [(line, h) for line, h in self.heights if first <= line <= last]

    def why_unknown(self) -> str:
        """Say why sights whose coordinates give no station are not one set-up; empty: they are."""
        first: dict[tuple[str, bool], UnnamedSight] = {}
        limits = {"distance": MAX_REPEATED_DISTANCE_M, "zenith": MAX_REPEATED_ANGLE_RAD}
        for s in self.sights:
            zenith = s.readings["zenith"]
            other = first.setdefault((s.target, zenith is not None and zenith > math.pi), s)
            for name, limit in limits.items():
                a, b = s.readings[name], other.readings[name]
                if a is not None and b is not None and abs(a - b) > limit:
                    return f", and more than one: line {s.line} has other readings of {s.target!r}"
        return ""

    def setups(self, points: Mapping[str, Place], place: Callable[[int], str]) -> list[FoundSetUp]:
        """Return the set-ups whose coordinates give their stations, or the one that is named.

        Args:
            points: coordinates of all points of the file.
            place: returns file and line.
        """
        if self.name:
            fit = fit_station(self.sights)
            if fit is None or not fit.fits:
                return [FoundSetUp(self.name, self.sights)]
            return [self._at(fit, self.sights, points, place)]
        out: list[FoundSetUp] = []
        for run, fit in _runs(self.sights):
            of_runs = {found.station: found.coordinates for found in out}
            out.append(self._at(fit, run, {**of_runs, **points}, place))
        return out

    def the_only(self, points: Collection[str], place: Callable[[int], str]) -> FoundSetUp:
        """Return all sights as the set-up of a station that has no name in the file."""
        name = _new_name(points)
        what = f"{_said(self.sights, place)}: they are one set-up, whose station is called {name!r}"
        return FoundSetUp(name, self.sights, remark=what + _NAMING)

    def _at(
        self,
        fit: StationFit,
        sights: Sequence[UnnamedSight],
        points: Mapping[str, Place],
        place: Callable[[int], str],
    ) -> FoundSetUp:
        """Return the set-up at a tilting axis, which is above a point of the file or a new one."""
        e, n, axis = fit.axis
        targets = {s.target for s in sights}
        near = {
            name: d
            for name, (x, y, _) in points.items()
            if name not in targets and (d := math.hypot(x - e, y - n)) < SAME_PLACE_M
        }
        name = self.name or min(near, key=lambda p: near[p], default="") or _new_name(points)
        stated = [h for _, h in self.heights_of(sights)]
        what = f"{_said(sights, place)}: coordinates beside {len(fit.sights)} of them give {name!r}"
        what += f" at {e:.3f} {n:.3f} m, and {fit}"
        foot, height = axis - (stated[0] if stated else 0.0), None
        known = points.get(name, UNKNOWN_COORDINATES)[2]
        if not stated and 0.0 <= axis - known <= MAX_INSTRUMENT_HEIGHT_M:
            foot, height = known, axis - known
            what += f"; the instrument is {height:.3f} m above the point"
        elif not stated:
            what += "; its height is that of the tilting axis"
        what += _NAMING * (not self.name and name not in points)
        return FoundSetUp(name, sights, (e, n, foot), height, what)


_NAMING = "; station=NAME (--set station=NAME) names it"


def _said(sights: Sequence[UnnamedSight], place: Callable[[int], str]) -> str:
    count = "1 sight" if len(sights) == 1 else f"{len(sights)} sights"
    return f"no record states the station of {count} from {place(sights[0].line)}"


def _runs(sights: Sequence[UnnamedSight]) -> list[tuple[list[UnnamedSight], StationFit]]:
    """Return runs of sights whose coordinates and readings agree, with their stations.

    A sight with which no run begins is in none.
    """
    out, begin = [], 0
    while begin < len(sights):
        run, fit = list[UnnamedSight](), None
        for s in sights[begin:]:
            extended = fit_station([*run, s]) if s.polar_place() is not None else fit
            if extended is not None and not extended.fits:
                break
            run, fit = [*run, s], extended
        if fit is None:
            begin += 1
        else:
            out.append((run, fit))
            begin += len(run)
    return out


def _new_name(points: Collection[str]) -> str:
    """Return a name that no point has."""
    name, number = UNNAMED_STATION, 1
    while name in points:
        number += 1
        name = f"{UNNAMED_STATION}_{number}"
    return name
