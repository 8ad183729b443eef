"""Horizontal distances and angles, of which traverses are made."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...frames import LocalFrame
from ...models.base import wrap
from ...network.network import Network
from ...observations import (
    Direction,
    HorizontalAngle,
    HorizontalDistance,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from ...types import Array
from .repeated import size_of


@dataclass(frozen=True)
class Measured:
    """A measured quantity: the mean of all its readings."""

    value: float
    """Value, metres or radians."""
    variance: float
    """Variance."""


@dataclass(frozen=True)
class Survey:
    """What traverses are made of."""

    held: Mapping[str, Array]
    """East and north (2,) of the held points, metres."""
    legs: Mapping[str, Mapping[str, Measured]]
    """Horizontal distances, by both ends."""
    angles: Mapping[str, Mapping[tuple[str, str], Measured]]
    """Angles clockwise, from one target to another, by station."""

    @classmethod
    def of(cls, network: Network) -> Survey:
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
        occupied = {
            o.station
            for o in network.observations.values()
            if isinstance(o, Direction | HorizontalAngle)
        }
        legs = _legs(network, frame, occupied.union(held))
        return cls(held, legs, _angles(network, legs, held))

    def angle(self, at: str, start: str, end: str) -> Measured | None:
        """Return the angle at a station from one target to another; none: it is not measured."""
        return self.angles.get(at, {}).get((start, end))

    def azimuth(self, at: str, to: str) -> Measured | None:
        """Return the azimuth from a held point, by the angle at the longest backsight.

        None: no other held point was sighted in the same set.
        """
        best: tuple[float, Measured] | None = None
        for (back, target), angle in self.angles.get(at, {}).items():
            if target == to and back in self.held and back != to:
                d = self.held[back] - self.held[at]
                length = float(np.hypot(*d))
                if length and (best is None or length > best[0]):
                    known = float(np.arctan2(d[0], d[1]))
                    best = length, Measured(known + angle.value, angle.variance)
        return None if best is None else best[1]


def _mean(readings: Sequence[Measured], *, circle: bool = False) -> Measured:
    """Return the mean of readings of one quantity."""
    value = np.array([r.value for r in readings])
    if circle:
        value = value[0] + wrap(value - value[0])
    n = len(readings)
    return Measured(float(value.mean()), sum(r.variance for r in readings) / n**2)


def _legs(
    network: Network, frame: LocalFrame, between: Collection[str]
) -> dict[str, dict[str, Measured]]:
    """Return the horizontal distances between some points, by both ends."""
    up = {
        (o.station, o.target, o.instrument_height, o.target_height): o
        for o in network.observations.values()
        if isinstance(o, VerticalAngle)
    }
    found: dict[tuple[str, str], list[Measured]] = defaultdict(list)
    for o in network.observations.values():
        if isinstance(o, SlopeDistance) and o.station in between and o.target in between:
            key = (o.station, o.target, o.instrument_height, o.target_height)
            reading = _horizontal(network, frame, o, up.get(key))
            if reading is not None:
                a, b = sorted((o.station, o.target))
                found[a, b].append(reading)
    out: dict[str, dict[str, Measured]] = defaultdict(dict)
    for (a, b), readings in found.items():
        out[a][b] = out[b][a] = _mean(readings)
    return out


def _horizontal(
    network: Network, frame: LocalFrame, o: SlopeDistance, inclined: VerticalAngle | None
) -> Measured | None:
    """Return a distance in the horizon; none: its meter has unknowns, or its slope is not known.

    Args:
        network: the network.
        frame: its frame.
        o: the distance.
        inclined: the vertical or zenith angle of the same sight; none: held heights tell the slope.
    """
    meter = None if o.instrument is None else network.distance_meters.get(o.instrument)
    if meter is not None and not all(meter.fixed):
        return None
    scale, zero = (0.0, 0.0) if meter is None else meter.values
    length = (o.value - zero) / (1.0 + scale)
    sigma = size_of(o, length)
    if isinstance(o, HorizontalDistance):
        return Measured(length, sigma**2)
    if inclined is not None:
        zenith = isinstance(inclined, ZenithAngle)
        slope = np.pi / 2 - inclined.value if zenith else inclined.value
        rise = length * float(np.sin(slope))
        doubt = np.hypot(size_of(inclined, length), _tilt(network, frame, o.station))
        sigma = float(np.hypot(np.cos(slope) * sigma, rise * doubt))
    else:
        start, end = (network.points[n] for n in (o.station, o.target))
        if not (start.fixed[2] and end.fixed[2]):
            return None
        rise = end.coordinates[2] + o.target_height - start.coordinates[2] - o.instrument_height
    if not abs(rise) < length or not np.isfinite(sigma):
        return None
    return Measured(float(np.sqrt(length**2 - rise**2)), sigma**2)


def _tilt(network: Network, frame: LocalFrame, station: str) -> float:
    """Return the angle between the vertical of a station and Z, radians; infinite: not known."""
    if not frame.curvature:
        return 0.0
    d = np.array(network.points[station].coordinates)[:2] - frame.origin[:2]
    return float(np.nan_to_num(np.hypot(*d) / frame.radius, nan=np.inf))


def _angles(
    network: Network, legs: Mapping[str, Mapping[str, Measured]], held: Mapping[str, Array]
) -> dict[str, dict[tuple[str, str], Measured]]:
    """Return the angles between targets that are legs, or held points."""
    found: dict[tuple[str, str, str], list[Measured]] = defaultdict(list)
    sets: dict[tuple[str, str], list[Direction]] = defaultdict(list)
    for o in network.observations.values():
        if isinstance(o, HorizontalAngle):
            near = min(_length(legs, held, o.station, t) for t in (o.target, o.target2))
            variance = size_of(o, near) ** 2
            found[o.station, o.target, o.target2].append(Measured(o.value, variance))
            found[o.station, o.target2, o.target].append(Measured(-o.value, variance))
        elif isinstance(o, Direction) and (o.target in legs.get(o.station, {}) or o.target in held):
            sets[o.station, o.set].append(o)
    for (station, _), readings in sets.items():
        variance_of = [size_of(o, _length(legs, held, station, o.target)) ** 2 for o in readings]
        for a, va in zip(readings, variance_of, strict=True):
            for b, vb in zip(readings, variance_of, strict=True):
                if a.target != b.target:
                    angle = Measured(b.value - a.value, va + vb)
                    found[station, a.target, b.target].append(angle)
    out: dict[str, dict[tuple[str, str], Measured]] = defaultdict(dict)
    for (station, a_, b_), measured in found.items():
        out[station][a_, b_] = _mean(measured, circle=True)
    return out


def _length(
    legs: Mapping[str, Mapping[str, Measured]], held: Mapping[str, Array], a: str, b: str
) -> float:
    """Return the length of a sight, on which the effect of centring depends.

    1 km where neither a distance nor held coordinates tell it.
    """
    leg = legs.get(a, {}).get(b)
    if leg is not None:
        return leg.value
    if a in held and b in held:
        return float(np.hypot(*(held[b] - held[a])))
    return 1000.0
