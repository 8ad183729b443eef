"""Misclosures of traverses, of angles and coordinates, and the reading that explains one.

A traverse runs along legs whose distance is measured, between held points or round back to where it
began; at each station between, the angle from one leg to the next is measured. From the azimuth α
of its first leg, the angles β and the horizontal distances d,

    α_{i+1} = α_i + π + β_i,   x_{i+1} = x_i + d_i sin α_i,   y_{i+1} = y_i + d_i cos α_i

up to the last point, and to the azimuth at its end. A traverse whose ends have no azimuth must be
as long, from end to end, as the held points are apart. Their standard deviations follow from those
of the angles and the distances. Approximate coordinates take no part, but held heights reduce slope
distances to the horizontal where no zenith angle does.

The places are found as surveyors find them: with a wrong angle, the coordinates computed from
either end agree at its station; with a wrong distance, the misclosure runs along its leg.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..frames import LocalFrame
from ..models.base import wrap
from ..network.network import Network
from ..observations import Sight
from ..observations.base import of_quantities
from ..observations.registry import DISTANCE_QUANTITIES, INCLINATION_QUANTITIES
from ..statistical_tests import TOLERANCE_IN_SIGMAS
from ..types import Array
from ..units import ANGLE
from .findings import Finding
from .loop_misclosures import MAX_LISTED_MISCLOSURES, closed_loops
from .repeated_readings import reading_sigma

MAX_TRAVERSE_STARTS = 200
"""Largest number of held points from which traverses are looked for."""
MAX_POINTS_OF_TRAVERSE = 8
"""Largest number of points of a traverse that are named."""
PLANE_TOLERANCE_FACTOR = float(np.sqrt(-2.0 * np.log(0.001)))
"""Tolerance of a misclosure in the plane, in semi-axes of its ellipse: exceeded by chance once in
1000, as `TOLERANCE_IN_SIGMAS` is by a single value."""


@dataclass(frozen=True)
class MeanReading:
    """A measured quantity: the mean of all its readings."""

    value: float
    """Value, metres or radians."""
    variance: float
    """Variance."""


@dataclass(frozen=True)
class TraverseReadings:
    """What traverses are made of."""

    held: Mapping[str, Array]
    """East and north (2,) of the held points, metres."""
    legs: Mapping[str, Mapping[str, MeanReading]]
    """Horizontal distances, by both ends."""
    angles: Mapping[str, Mapping[tuple[str, str], MeanReading]]
    """Angles clockwise, from one target to another, by station."""

    @classmethod
    def of(cls, network: Network) -> TraverseReadings:
        """Return the distances and angles of a network in a local frame.

        Only between held points and points on which an instrument stood, so that details measured
        from a station do not count.
        """
        frame = network.frame
        assert isinstance(frame, LocalFrame)
        turn = frame.east_north
        held = {
            name: turn @ np.nan_to_num(p.coordinates)  # heights may be unknown
            for name, p in network.points.items()
            if p.fixed[0] and p.fixed[1]
        }
        horizontal = of_quantities(network.observations.values(), "direction", "horizontal angle")
        occupied = {o.station for o in horizontal}
        legs = _legs(network, frame, occupied.union(held))
        return cls(held, legs, _angles(network, legs, held))

    def angle(self, at: str, start: str, end: str) -> MeanReading | None:
        """Return the angle at a station from one target to another; none: it is not measured."""
        return self.angles.get(at, {}).get((start, end))

    def azimuth(self, at: str, to: str) -> MeanReading | None:
        """Return the azimuth from a held point, by the angle at the longest backsight.

        None: no other held point was sighted in the same set.
        """
        best: tuple[float, MeanReading] | None = None
        for (back, target), angle in self.angles.get(at, {}).items():
            if target == to and back in self.held and back != to:
                d = self.held[back] - self.held[at]
                length = float(np.hypot(*d))
                if length and (best is None or length > best[0]):
                    known = float(np.arctan2(d[0], d[1]))
                    best = length, MeanReading(known + angle.value, angle.variance)
        return None if best is None else best[1]


def _mean(readings: Sequence[MeanReading], *, circle: bool = False) -> MeanReading:
    """Return the mean of readings of one quantity."""
    value = np.array([r.value for r in readings])
    if circle:
        value = value[0] + wrap(value - value[0])
    n = len(readings)
    return MeanReading(float(value.mean()), sum(r.variance for r in readings) / n**2)


def _legs(
    network: Network, frame: LocalFrame, between: Collection[str]
) -> dict[str, dict[str, MeanReading]]:
    """Return the horizontal distances between some points, by both ends."""
    up = {
        (o.station, o.target, o.instrument_height, o.target_height): o
        for o in of_quantities(network.observations.values(), *INCLINATION_QUANTITIES)
    }
    found: dict[tuple[str, str], list[MeanReading]] = defaultdict(list)
    for o in of_quantities(network.observations.values(), *DISTANCE_QUANTITIES):
        if o.station in between and o.target in between:
            key = (o.station, o.target, o.instrument_height, o.target_height)
            reading = _horizontal(network, frame, o, up.get(key))
            if reading is not None:
                a, b = sorted((o.station, o.target))
                found[a, b].append(reading)
    out: dict[str, dict[str, MeanReading]] = defaultdict(dict)
    for (a, b), readings in found.items():
        out[a][b] = out[b][a] = _mean(readings)
    return out


def _horizontal(
    network: Network, frame: LocalFrame, o: Any, inclined: Sight | None
) -> MeanReading | None:
    """Return a distance in the horizon; none: its meter has unknowns, or its slope is not known.

    Args:
        network: the network.
        frame: its frame.
        o: the distance.
        inclined: the vertical or zenith angle of the same sight; none: held heights determine the
        slope.
    """
    meter = None if o.instrument is None else network.distance_meters.get(o.instrument)
    if meter is not None and not all(meter.fixed):
        return None
    scale, zero = (0.0, 0.0) if meter is None else meter.values
    length = (o.value - zero) / (1.0 + scale)
    sigma = reading_sigma(o, length)
    if o.record.quantity == "horizontal distance":
        return MeanReading(length, sigma**2)
    if inclined is not None:
        zenith = inclined.record.quantity == "zenith angle"
        slope = np.pi / 2 - inclined.value if zenith else inclined.value
        rise = length * float(np.sin(slope))
        doubt = np.hypot(reading_sigma(inclined, length), _tilt(network, frame, o.station))
        sigma = float(np.hypot(np.cos(slope) * sigma, rise * doubt))
    else:
        start, end = (network.points[n] for n in (o.station, o.target))
        if not (start.fixed[2] and end.fixed[2]):
            return None
        rise = end.coordinates[2] + o.target_height - start.coordinates[2] - o.instrument_height
    if not abs(rise) < length or not np.isfinite(sigma):
        return None
    return MeanReading(float(np.sqrt(length**2 - rise**2)), sigma**2)


def _tilt(network: Network, frame: LocalFrame, station: str) -> float:
    """Return the angle between the vertical of a station and Z, radians; infinite: not known."""
    if not frame.curvature:
        return 0.0
    d = np.array(network.points[station].coordinates)[:2] - frame.origin[:2]
    return float(np.nan_to_num(np.hypot(*d) / frame.radius, nan=np.inf))


def _angles(
    network: Network, legs: Mapping[str, Mapping[str, MeanReading]], held: Mapping[str, Array]
) -> dict[str, dict[tuple[str, str], MeanReading]]:
    """Return the angles between targets that are legs, or held points."""
    found: dict[tuple[str, str, str], list[MeanReading]] = defaultdict(list)
    sets: dict[tuple[str, str], list[Sight]] = defaultdict(list)
    for o in of_quantities(network.observations.values(), "direction", "horizontal angle"):
        if o.record.quantity == "horizontal angle":
            near = min(_length(legs, held, o.station, t) for t in (o.target, o.target2))
            variance = reading_sigma(o, near) ** 2
            found[o.station, o.target, o.target2].append(MeanReading(o.value, variance))
            found[o.station, o.target2, o.target].append(MeanReading(-o.value, variance))
        elif o.target in legs.get(o.station, {}) or o.target in held:
            sets[o.station, o.set].append(o)
    for (station, _), readings in sets.items():
        variance_of = [
            reading_sigma(o, _length(legs, held, station, o.target)) ** 2 for o in readings
        ]
        for a, va in zip(readings, variance_of, strict=True):
            for b, vb in zip(readings, variance_of, strict=True):
                if a.target != b.target:
                    angle = MeanReading(b.value - a.value, va + vb)
                    found[station, a.target, b.target].append(angle)
    out: dict[str, dict[tuple[str, str], MeanReading]] = defaultdict(dict)
    for (station, a_, b_), measured in found.items():
        out[station][a_, b_] = _mean(measured, circle=True)
    return out


def _length(
    legs: Mapping[str, Mapping[str, MeanReading]], held: Mapping[str, Array], a: str, b: str
) -> float:
    """Return the length of a sight, on which the effect of centring depends.

    1 km where neither a distance nor held coordinates determine it.
    """
    leg = legs.get(a, {}).get(b)
    if leg is not None:
        return leg.value
    if a in held and b in held:
        return float(np.hypot(*(held[b] - held[a])))
    return 1000.0


@dataclass(frozen=True)
class Traverse:
    """A traverse: a way along legs, with the angles between them."""

    survey: TraverseReadings
    """Where its readings are."""
    points: tuple[str, ...]
    """Its points, (n + 1,); the last is the first one if it is closed."""

    @property
    def closed(self) -> bool:
        """Whether it ends where it began, and is tested without held points."""
        return self.points[0] == self.points[-1]

    def start(self) -> MeanReading | None:
        """Return the azimuth of the first leg; 0 of a closed traverse."""
        if self.closed:
            return MeanReading(0.0, 0.0)
        return self.survey.azimuth(self.points[0], self.points[1])

    def angular(self) -> tuple[float, float] | None:
        """Return the angular misclosure and its standard deviation, radians; none: no test."""
        first, angles = self.start(), self._angles()
        if self.closed:
            last = self.survey.angle(self.points[0], self.points[-2], self.points[1])
        else:
            # The azimuth back along the last leg, from a held point at the end.
            back = self.survey.azimuth(self.points[-1], self.points[-2])
            last = None if back is None else MeanReading(-back.value, back.variance)
        if first is None or last is None:
            return None
        parts = [first, *angles, last]
        total = sum(m.value for m in parts) + np.pi * (len(angles) + 1)
        sigma = np.sqrt(sum(m.variance for m in parts))
        return float(wrap(np.array(total))), float(sigma)

    def _angles(self) -> list[MeanReading]:
        """Return the angles between its legs, (n − 1,)."""
        found = []
        for a, at, b in zip(self.points, self.points[1:], self.points[2:], strict=False):
            angle = self.survey.angle(at, a, b)
            assert angle is not None
            found.append(angle)
        return found

    def computed(self) -> tuple[Array, Array, Array]:
        """Return coordinates (n + 1, 2) from its first point, azimuths (n,), and Σ of the last.

        Without an azimuth at its start it begins towards north, and only its length has a meaning.
        """
        first = self.start() or MeanReading(0.0, 0.0)
        angles = self._angles()
        legs = [self.survey.legs[a][b] for a, b in pairwise(self.points)]
        azimuth = first.value + np.cumsum([0.0, *(a.value + np.pi for a in angles)])
        along = np.column_stack([np.sin(azimuth), np.cos(azimuth)])
        begin = np.zeros(2) if self.closed else self.survey.held[self.points[0]]
        lengths = np.array([d.value for d in legs])
        x = begin + np.vstack([np.zeros(2), np.cumsum(lengths[:, None] * along, axis=0)])
        arm = (x[-1] - x[:-1]) @ np.array([[0.0, -1.0], [1.0, 0.0]])  # ∂x/∂α = y, ∂y/∂α = −x
        turns = np.array([first.variance, *(a.variance for a in angles)])
        stretch = np.array([d.variance for d in legs])
        covariance = (arm.T * turns) @ arm + (along.T * stretch) @ along
        return x, azimuth, covariance

    def linear(self) -> tuple[Array, Array, bool] | None:
        """Return the misclosure (2,), its Σ, and whether it has a direction; none: no test.

        Without an azimuth it is the difference of lengths, in the direction of the traverse.
        """
        x, _, covariance = self.computed()
        if self.closed:
            return x[-1], covariance, True
        end = self.survey.held[self.points[-1]]
        if self.start() is not None:
            return x[-1] - end, covariance, True
        begin = self.survey.held[self.points[0]]
        there, length = x[-1] - begin, float(np.hypot(*(end - begin)))
        reached = float(np.hypot(*there))
        if not reached:
            return None
        return there * (1.0 - length / reached), covariance, False

    def backwards(self) -> Traverse:
        """Return it from its end."""
        return Traverse(self.survey, self.points[::-1])

    def __str__(self) -> str:
        """Return its points."""
        shown = [repr(p) for p in self.points]
        if len(shown) > MAX_POINTS_OF_TRAVERSE:
            shown = [*shown[: MAX_POINTS_OF_TRAVERSE - 2], "…", *shown[-2:]]
        return f"the traverse {' – '.join(shown)} ({len(self.points) - 1} legs)"


def open_traverses(network: Network) -> Iterator[Finding]:
    """Iterate over traverses that do not close within the tolerance, the worst first."""
    if not isinstance(network.frame, LocalFrame):
        return
    survey = TraverseReadings.of(network)
    found: list[tuple[float, Finding]] = []
    for t in [*traverses_between_held_points(survey), *_polygons(survey)]:
        finding = _tested(t)
        if finding is not None:
            found.append((abs(finding.size) / finding.tolerance, finding))
    found.sort(key=lambda f: -f[0])
    for _, finding in found[:MAX_LISTED_MISCLOSURES]:
        yield finding


def traverses_between_held_points(survey: TraverseReadings) -> Iterator[Traverse]:
    """Iterate over the shortest traverses between held points."""
    order = {name: i for i, name in enumerate(survey.held)}
    for begin in [name for name in survey.held if name in survey.legs][:MAX_TRAVERSE_STARTS]:
        above: dict[str, str] = {begin: ""}
        waiting = deque([begin])
        while waiting:
            at = waiting.popleft()
            for other in survey.legs[at]:
                if other in above or (at != begin and not survey.angle(at, above[at], other)):
                    continue
                above[other] = at
                if other not in survey.held:
                    waiting.append(other)
                elif at != begin and order[other] > order[begin]:
                    way = [other]
                    while way[-1] != begin:
                        way.append(above[way[-1]])
                    t = Traverse(survey, tuple(way[::-1]))
                    yield t if t.start() is not None else t.backwards()


def _polygons(survey: TraverseReadings) -> Iterator[Traverse]:
    """Iterate over traverses that close, all of whose angles are measured."""
    names = [name for name in survey.legs if name in survey.angles]
    number = {name: i for i, name in enumerate(names)}
    ends = [(a, b) for a in names for b in survey.legs[a] if number[a] < number.get(b, -1)]
    start, end = (np.array([number[e[i]] for e in ends], dtype=np.intp) for i in range(2))
    for loop in closed_loops(start, end):
        way = _way([ends[i] for i, _ in loop])
        turns = zip(way, way[1:], [*way[2:], way[1]], strict=False)
        if len(loop) > 2 and all(survey.angle(at, a, b) for a, at, b in turns):
            yield Traverse(survey, tuple(way))


def _way(legs: Sequence[tuple[str, str]]) -> list[str]:
    """Return the points along legs that close, the first one again at the end."""
    left = list(legs[1:])
    out = list(legs[0])
    while left:
        following = next(leg for leg in left if out[-1] in leg)
        left.remove(following)
        out.append(following[1] if following[0] == out[-1] else following[0])
    return out


def _tested(t: Traverse) -> Finding | None:
    """Return what does not close; none: all is within the tolerance."""
    angular = t.angular()
    if angular is not None and abs(angular[0]) > TOLERANCE_IN_SIGMAS * angular[1]:
        return Finding(
            f"the angles of {t} do not close",
            _where_angle(t) + "look for a wrong direction or name, or at the held points",
            angular[0] / ANGLE["mgon"],
            TOLERANCE_IN_SIGMAS * angular[1] / ANGLE["mgon"],
            "mgon",
        )
    linear = t.linear()
    if linear is None:
        return None
    w, covariance, directed = linear
    size = float(np.hypot(*w))
    if not size:
        return None
    if directed:  # the ellipse of Σ, in the direction of w
        limit = PLANE_TOLERANCE_FACTOR * size / float(np.sqrt(w @ np.linalg.solve(covariance, w)))
    else:
        limit = TOLERANCE_IN_SIGMAS * float(np.sqrt(w @ covariance @ w)) / size
    if size <= limit:
        return None
    what = "does not close" if directed else "is not as long as its ends are apart"
    return Finding(
        f"{t} {what}",
        (_where_leg(t, w) if directed else "")
        + "look for a wrong distance, height of instrument or name, or at the held points",
        1e3 * size,
        1e3 * limit,
        "mm",
    )


def _where_angle(t: Traverse) -> str:
    """Return at which station a wrong angle explains everything; empty: at none or at several."""
    if t.closed:
        return ""
    forth, back = t.computed()[0], t.backwards().computed()[0][::-1]
    apart = np.hypot(*(forth - back).T)
    best = int(np.argmin(apart))
    others = np.delete(apart, best)
    if apart[best] * 5.0 < others.min():
        return f"a wrong angle at {t.points[best]!r} explains it; "
    return ""


def _where_leg(t: Traverse, w: Array) -> str:
    """Return the legs of which one wrong distance explains everything; empty: none, or most."""
    _, azimuth, covariance = t.computed()
    across = np.column_stack([np.cos(azimuth), -np.sin(azimuth)])
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", across, covariance, across))
    fits = np.flatnonzero(np.abs(across @ w) < TOLERANCE_IN_SIGMAS * sigma).tolist()
    if not fits or 2 * len(fits) > len(azimuth):
        return ""
    legs = " or ".join(f"{t.points[i]!r} – {t.points[i + 1]!r}" for i in fits)
    return f"a wrong distance {legs} explains it; "
