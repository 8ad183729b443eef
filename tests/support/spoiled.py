"""Building sites and photo blocks with one cause of misfits, of a given size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

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
from tests.networks.building_site import CONTROL, site
from tests.networks.photo_block import block

TERRESTRIAL = (Direction, ZenithAngle, SlopeDistance)


@dataclass
class Spoiled:
    """A network whose readings, or given values, have one error."""

    network: Network
    """The points, and the photos with their image coordinates."""
    readings: list[Observation]
    """The other readings."""
    true: dict[str, Array]
    """True coordinates (3,), metres."""
    rng: np.random.Generator
    """What chooses the place."""
    cause: str = ""
    """What is to be found."""
    where: str = ""
    """Where it is to be found; a part of the text."""
    ids: tuple[int, ...] = ()
    """Places of the wrong readings among the readings."""

    @classmethod
    def site(cls, seed: int) -> Spoiled:
        """Return a building site without an error."""
        return cls(*site(seed), np.random.default_rng([seed, 1]))

    @classmethod
    def block(cls, seed: int) -> Spoiled:
        """Return a photo block without an error."""
        return cls(block(seed), [], {}, np.random.default_rng([seed, 1]))

    def some(self, names: Sequence[str]) -> str:
        """Choose a name."""
        return str(self.rng.choice(sorted(names)))

    def of_kinds(self, *kinds: type) -> list[Any]:
        """Return the readings of some kinds."""
        return [o for o in self.readings if isinstance(o, kinds)]

    def targets(self, station: str) -> list[str]:
        """Return the targets of a station."""
        return [o.target for o in self.of_kinds(Direction) if o.station == station]

    @property
    def stations(self) -> list[str]:
        """The stations."""
        return sorted({o.station for o in self.of_kinds(Direction)})


Place: TypeAlias = tuple[tuple[str, ...], list[Any]]
"""Names of a place, and the readings that a mistake there concerns."""
Change: TypeAlias = Callable[[Any], Any]
Mistake: TypeAlias = Callable[[Spoiled, float], None]
"""Makes a mistake of a given size, and notes its cause and its place."""


def _of_readings(
    cause: str,
    where: str,
    place: Callable[[Spoiled], Place],
    change: Callable[[Spoiled, tuple[str, ...], float], Change],
) -> Mistake:
    """Return a mistake of readings.

    Args:
        cause: what is to be found.
        where: the place, a format of its names.
        place: chooses the names and the readings.
        change: returns what becomes of a reading, by the names and the size.
    """

    def spoil(s: Spoiled, size: float) -> None:
        names, mine = place(s)
        s.cause, s.where = cause, where.format(*map(repr, names))
        to = change(s, names, size)
        s.ids = tuple(i for i, o in enumerate(s.readings) if any(o is m for m in mine))
        s.readings = [to(o) if i in s.ids else o for i, o in enumerate(s.readings)]

    return spoil


# -- places -------------------------------------------------------------------------------------


def _station(*kinds: type) -> Callable[[Spoiled], Place]:
    """Choose a set-up, and its readings of some kinds."""

    def place(s: Spoiled) -> Place:
        at = s.some(s.stations)
        return (at,), [o for o in s.of_kinds(*kinds) if o.station == at]

    return place


def _sight(s: Spoiled) -> Place:
    """Choose a sight to a point that is not held."""
    at = s.some(s.stations)
    to = s.some([t for t in s.targets(at) if t not in CONTROL])
    return (at, to), _readings_of(s, at, to)


def _two_sights(s: Spoiled) -> Place:
    """Choose two sights of a station."""
    at = s.some(s.stations)
    a, b = sorted(s.rng.choice(sorted(s.targets(at)), 2, replace=False).tolist())
    return (at, a, b), _readings_of(s, at, a, b)


def _two_heights(s: Spoiled) -> Place:
    """Choose two sights of a station, to another station and to a target: heights differ."""
    both = {at: sorted(s.targets(at)) for at in s.stations}
    kinds = {at: {t[0] for t in targets} for at, targets in both.items()}
    at = s.some([at for at, found in kinds.items() if len(found) == 2])
    a, b = (s.some([t for t in both[at] if t[0] == kind]) for kind in "ST")
    return (at, a, b), _readings_of(s, at, a, b)


def _sight_and_other(s: Spoiled) -> Place:
    """Choose a sight, and a point that its station does not see."""
    at = s.some(s.stations)
    right = s.some(s.targets(at))
    wrong = s.some(list(set(s.true) - {at, *s.targets(at)}))
    return (at, right, wrong), _readings_of(s, at, right)


def _readings_of(s: Spoiled, at: str, *targets: str) -> list[Any]:
    return [o for o in s.of_kinds(*TERRESTRIAL) if o.station == at and o.target in targets]


def _late(s: Spoiled) -> Place:
    """Choose the directions of a set from some target on."""
    at = s.some(s.stations)
    mine = [o for o in s.of_kinds(Direction) if o.station == at]
    late = mine[int(s.rng.integers(3, len(mine) - 2)) :]
    return (at, late[0].target), late


def _base(s: Spoiled) -> Place:
    """Choose a base, and the vectors from there."""
    every = s.of_kinds(GnssVector)
    at = s.some(list({o.station for o in every}))
    return (at,), [o for o in every if o.station == at]


def _one(kind: type) -> Callable[[Spoiled], Place]:
    """Choose one reading of a kind."""

    def place(s: Spoiled) -> Place:
        every = s.of_kinds(kind)
        one = every[int(s.rng.integers(len(every)))]
        return (one.station, one.target), [one]

    return place


# -- changes ------------------------------------------------------------------------------------


def _plus(field: str) -> Callable[[Spoiled, tuple[str, ...], float], Change]:
    """Return a change that makes a field larger; angles stay within the circle."""

    def change(_: Spoiled, __: tuple[str, ...], size: float) -> Change:
        def to(o: Any) -> Any:
            value = getattr(o, field) + size
            circle = field == "value" and isinstance(o, Direction)
            return replace(o, **{field: float(value % (2 * np.pi)) if circle else value})

        return to

    return change


def _scaled(_: Spoiled, __: tuple[str, ...], ppm: float) -> Change:
    return lambda o: replace(o, value=o.value * (1.0 + 1e-6 * ppm))


def _beside(s: Spoiled, _: tuple[str, ...], size: float) -> Change:
    """Return readings from a place beside the station."""
    turn = s.rng.uniform(0.0, 2 * np.pi)
    by = size * np.array([np.cos(turn), np.sin(turn), 0.0])

    def to(o: Any) -> Any:
        up = np.array([0.0, 0.0, o.target_height - o.instrument_height])
        d = s.true[o.target] - s.true[o.station] + up
        there = d - by
        if isinstance(o, Direction):
            turned = np.arctan2(there[0], there[1]) - np.arctan2(d[0], d[1])
            return replace(o, value=float((o.value + turned) % (2 * np.pi)))
        length, before = (float(np.linalg.norm(x)) for x in (there, d))
        if isinstance(o, ZenithAngle):
            steeper = float(np.arccos(there[2] / length) - np.arccos(d[2] / before))
            return replace(o, value=o.value + steeper)
        return replace(o, value=o.value + length - before)

    return to


def _exchanged(_: Spoiled, names: tuple[str, ...], __: float) -> Change:
    other = {names[1]: names[2], names[2]: names[1]}
    return lambda o: replace(o, target=other[o.target])


def _exchanged_with_heights(s: Spoiled, names: tuple[str, ...], _: float) -> Change:
    """Exchange two names; the height of the target is looked up by the wrong name."""
    other = {names[1]: names[2], names[2]: names[1]}
    height = {o.target: o.target_height for o in s.of_kinds(*TERRESTRIAL)}
    return lambda o: replace(o, target=other[o.target], target_height=height[other[o.target]])


def _renamed(_: Spoiled, names: tuple[str, ...], __: float) -> Change:
    return lambda o: replace(o, target=names[2])


def _reversed(_: Spoiled, __: tuple[str, ...], ___: float) -> Change:
    return lambda o: replace(o, value=tuple(-v for v in o.value))


def _other_face(_: Spoiled, __: tuple[str, ...], ___: float) -> Change:
    return lambda o: replace(o, value=(o.value + np.pi) % (2 * np.pi))


# -- mistakes of what is given, and of photos -----------------------------------------------------


def _given_value(s: Spoiled, size: float) -> None:
    """A held coordinate is too large."""
    at, axis = s.some(CONTROL), int(s.rng.integers(3))
    s.cause, s.where = "the given x, y, z", f"of point {at!r}"
    point = s.network.points[at]
    moved = np.array(point.coordinates) + size * np.eye(3)[axis]
    s.network.points[at] = replace(point, coordinates=tuple(moved.tolist()))


def _axes(cause: str, change: Callable[[Array], Array]) -> Mistake:
    """Return a mistake in the axes of all image coordinates of one photo."""

    def spoil(s: Spoiled, _: float) -> None:
        photo = s.some(list(s.network.photos))
        s.cause, s.where = cause, f"of photo {photo!r}"
        f, p, xy, sigma = s.network.images.columns()
        mine = f == s.network.photo_number[photo]
        names = list(s.network.points)
        s.network.image_mask(~mine)
        points = [names[i] for i in p[mine].tolist()]
        s.network.add_image_points(photo, points, change(xy[mine]), sigma=sigma[mine])

    return spoil


SIZED: dict[str, Mistake] = {
    "instrument_height": _of_readings(
        "the height of the instrument",
        "at {}",
        _station(*TERRESTRIAL),
        _plus("instrument_height"),
    ),
    "target_height": _of_readings(
        "the height of the target", "at {1}", _sight, _plus("target_height")
    ),
    "index_error": _of_readings(
        "the index error of the vertical circle",
        "at station {}",
        _station(ZenithAngle),
        _plus("value"),
    ),
    "zero_constant": _of_readings(
        "the zero constant (prism constant) of distances",
        "at station {}",
        _station(SlopeDistance),
        _plus("value"),
    ),
    "scale": _of_readings(
        "the scale of distances", "at station {}", _station(SlopeDistance), _scaled
    ),
    "centring": _of_readings(
        "the centring of the instrument", "at {}", _station(*TERRESTRIAL), _beside
    ),
    "disturbed_set": _of_readings(
        "the orientation, turned on the way,", "from target {1} on", _late, _plus("value")
    ),
    "given_value": _given_value,
    "antenna_height": _of_readings(
        "the height of the antenna", "at {}", _base, _plus("instrument_height")
    ),
}
"""Causes with a size."""
EXCHANGES: dict[str, Mistake] = {
    "exchanged_targets": _of_readings(
        "two targets, exchanged:", "{1} and {2} seen from {0}", _two_sights, _exchanged
    ),
    "exchanged_with_heights": _of_readings(
        "two targets, exchanged:",
        "{1} and {2} seen from {0}, with the height that goes with the name",
        _two_heights,
        _exchanged_with_heights,
    ),
    "confused_point": _of_readings(
        "the name of the target",
        "{2} seen from {0}, which is {1}",
        _sight_and_other,
        _renamed,
    ),
    "reversed_vector": _of_readings(
        "start and end, exchanged,", "of vector {} – {}", _one(GnssVector), _reversed
    ),
    "wrong_face": _of_readings(
        "the face of the circle", "of the sight {} – {}", _one(Direction), _other_face
    ),
}
"""Causes without one."""
PHOTOS: dict[str, Mistake] = {
    "photo_x_and_y": _axes("x and y, exchanged,", lambda xy: xy[:, ::-1]),
    "photo_y_direction": _axes("the direction of y", lambda xy: xy * [1.0, -1.0]),
}
"""Causes of photos."""
