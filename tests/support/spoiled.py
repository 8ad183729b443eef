"""Readings of the building site with one cause of misfits, of a given size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Direction,
    GnssVector,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.types import Array
from tests.networks.building_site import CONTROL

TERRESTRIAL = (Direction, ZenithAngle, SlopeDistance)


@dataclass
class Spoiled:
    """A site whose readings, or given values, have one error."""

    network: Network
    """The points."""
    readings: list[Observation]
    """The readings."""
    true: dict[str, Array]
    """True coordinates (3,), metres."""
    rng: np.random.Generator
    """What chooses the place."""
    cause: str = ""
    """What is to be found."""
    where: str = ""
    """Where it is to be found; a part of the text."""

    def some(self, names: Sequence[str]) -> str:
        """Choose a name."""
        return str(self.rng.choice(sorted(names)))

    def change(self, chosen: Callable[[Any], bool], change: Callable[[Any], Any]) -> None:
        """Change some readings."""
        self.readings = [change(o) if chosen(o) else o for o in self.readings]

    def targets(self, station: str) -> list[str]:
        """Return the targets of a station."""
        sights = (o for o in self.readings if isinstance(o, Direction))
        return [o.target for o in sights if o.station == station]

    @property
    def stations(self) -> list[str]:
        """The stations."""
        return sorted({o.station for o in self.readings if isinstance(o, Direction)})


def instrument_height(s: Spoiled, size: float) -> None:
    """The recorded height of an instrument is too large."""
    at = s.some(s.stations)
    s.cause, s.where = "the height of the instrument", f"at {at!r}"
    s.change(
        lambda o: isinstance(o, TERRESTRIAL) and o.station == at,
        lambda o: replace(o, instrument_height=o.instrument_height + size),
    )


def target_height(s: Spoiled, size: float) -> None:
    """The recorded height of a target is too large at one of the stations that see it."""
    at = s.some(s.stations)
    to = s.some([t for t in s.targets(at) if t not in CONTROL])
    s.cause, s.where = "the height of the target", f"at {to!r}"
    s.change(
        lambda o: isinstance(o, TERRESTRIAL) and (o.station, o.target) == (at, to),
        lambda o: replace(o, target_height=o.target_height + size),
    )


def index_error(s: Spoiled, size: float) -> None:
    """All zenith angles of a station are too large."""
    at = s.some(s.stations)
    s.cause, s.where = "the index error of the vertical circle", f"at station {at!r}"
    s.change(
        lambda o: isinstance(o, ZenithAngle) and o.station == at,
        lambda o: replace(o, value=o.value + size),
    )


def zero_constant(s: Spoiled, size: float) -> None:
    """All distances of a station are too long."""
    at = s.some(s.stations)
    s.cause, s.where = "the zero constant (prism constant) of distances", f"at station {at!r}"
    s.change(
        lambda o: isinstance(o, SlopeDistance) and o.station == at,
        lambda o: replace(o, value=o.value + size),
    )


def scale(s: Spoiled, size: float) -> None:
    """All distances of a station are too long in proportion; ppm."""
    at = s.some(s.stations)
    s.cause, s.where = "the scale of distances", f"at station {at!r}"
    s.change(
        lambda o: isinstance(o, SlopeDistance) and o.station == at,
        lambda o: replace(o, value=o.value * (1.0 + 1e-6 * size)),
    )


def _moved(s: Spoiled, o: Any, by: Array) -> Any:
    """Return a reading as from a place beside the station."""
    up = np.array([0.0, 0.0, o.target_height - o.instrument_height])
    d = s.true[o.target] - s.true[o.station] + up
    there = d - by
    if isinstance(o, Direction):
        turn = np.arctan2(there[0], there[1]) - np.arctan2(d[0], d[1])
        return replace(o, value=float((o.value + turn) % (2 * np.pi)))
    length, before = (float(np.linalg.norm(x)) for x in (there, d))
    if isinstance(o, ZenithAngle):
        return replace(
            o, value=o.value + float(np.arccos(there[2] / length) - np.arccos(d[2] / before))
        )
    return replace(o, value=o.value + length - before)


def centring(s: Spoiled, size: float) -> None:
    """The instrument stands beside the mark."""
    at, turn = s.some(s.stations), s.rng.uniform(0.0, 2 * np.pi)
    by = size * np.array([np.cos(turn), np.sin(turn), 0.0])
    s.cause, s.where = "the centring of the instrument", f"at {at!r}"
    s.change(lambda o: isinstance(o, TERRESTRIAL) and o.station == at, lambda o: _moved(s, o, by))


def disturbed_set(s: Spoiled, size: float) -> None:
    """The tripod has turned on the way: all later directions of the set are too large."""
    at = s.some(s.stations)
    mine = [o for o in s.readings if isinstance(o, Direction) and o.station == at]
    late = mine[int(s.rng.integers(3, len(mine) - 2)) :]
    s.cause = "the orientation, turned on the way,"
    s.where = f"from target {late[0].target!r} on"
    s.change(lambda o: o in late, lambda o: replace(o, value=(o.value + size) % (2 * np.pi)))


def given_value(s: Spoiled, size: float) -> None:
    """A held coordinate is too large."""
    at, axis = s.some(CONTROL), int(s.rng.integers(3))
    s.cause, s.where = "the given x, y, z", f"of point {at!r}"
    point = s.network.points[at]
    moved = np.array(point.coordinates) + size * np.eye(3)[axis]
    s.network.points[at] = replace(point, coordinates=tuple(moved.tolist()))


def antenna_height(s: Spoiled, size: float) -> None:
    """The recorded height of the antenna of a base is too large."""
    at = s.some({o.station for o in s.readings if isinstance(o, GnssVector)})
    s.cause, s.where = "the height of the antenna", f"at {at!r}"
    s.change(
        lambda o: isinstance(o, GnssVector) and o.station == at,
        lambda o: replace(o, instrument_height=o.instrument_height + size),
    )


def exchanged_targets(s: Spoiled, _: float) -> None:
    """The readings to two targets of a station are exchanged."""
    at = s.some(s.stations)
    a, b = sorted(s.rng.choice(sorted(s.targets(at)), 2, replace=False).tolist())
    other = {a: b, b: a}
    s.cause, s.where = "two targets, exchanged:", f"{a!r} and {b!r} seen from {at!r}"
    s.change(
        lambda o: isinstance(o, TERRESTRIAL) and o.station == at and o.target in other,
        lambda o: replace(o, target=other[o.target]),
    )


def confused_point(s: Spoiled, _: float) -> None:
    """A target bears the name of another point of the list."""
    at = s.some(s.stations)
    right = s.some(s.targets(at))
    wrong = s.some(set(s.true) - {at, *s.targets(at)})
    s.cause = "the name of the target"
    s.where = f"{wrong!r} seen from {at!r}, which is {right!r}"
    s.change(
        lambda o: isinstance(o, TERRESTRIAL) and (o.station, o.target) == (at, right),
        lambda o: replace(o, target=wrong),
    )


def reversed_vector(s: Spoiled, _: float) -> None:
    """Start and end of a GNSS vector are exchanged."""
    every = [o for o in s.readings if isinstance(o, GnssVector)]
    one = every[int(s.rng.integers(len(every)))]
    s.cause = "start and end, exchanged,"
    s.where = f"of vector {one.station!r} – {one.target!r}"
    s.change(lambda o: o is one, lambda o: replace(o, value=tuple(-v for v in o.value)))


def wrong_face(s: Spoiled, _: float) -> None:
    """A direction was read in the other face."""
    every = [o for o in s.readings if isinstance(o, Direction)]
    one = every[int(s.rng.integers(len(every)))]
    s.cause = "the face of the circle"
    s.where = f"of the sight {one.station!r} – {one.target!r}"
    s.change(lambda o: o is one, lambda o: replace(o, value=(o.value + np.pi) % (2 * np.pi)))


SIZED: dict[str, Callable[[Spoiled, float], None]] = {
    f.__name__: f
    for f in (
        instrument_height,
        target_height,
        index_error,
        zero_constant,
        scale,
        centring,
        disturbed_set,
        given_value,
        antenna_height,
    )
}
"""Causes with a size."""
EXCHANGES: dict[str, Callable[[Spoiled, float], None]] = {
    f.__name__: f for f in (exchanged_targets, confused_point, reversed_vector, wrong_face)
}
"""Causes without one."""
