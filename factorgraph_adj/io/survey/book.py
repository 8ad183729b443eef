"""A field book of total stations and levels, from which a network is made.

Readers of field books fill it with what they read: points, set-ups, sights and levelled height
differences. A target that is read again in the same face of a set-up begins another round, and
every round is a set of directions with an orientation of its own, since nothing in a field book
tells whether the circle was turned between them.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import InputError, known
from ...field.faces import ReducedFaces, reduce_faces
from ...field.readings import FaceReading
from ...frames import LocalFrame
from ...network.network import Network
from ...observations import HeightDifference, HorizontalDistance, Observation
from ...stochastic import StandardDeviation
from ...units import LENGTH
from .accuracies import Accuracies, names_of
from .notes import Notes

UNKNOWN = (math.nan, math.nan, math.nan)
SAME = 1e-4
"""Coordinates of a point that is stated twice differ by less, metres."""


@dataclass
class SetUp:
    """An instrument on a point."""

    station: str
    height: float
    number: str
    """Number of the set-up among those of the station: a set of directions is named by it."""
    line: int
    rounds: dict[str, list[dict[int, float]]] = field(default_factory=lambda: defaultdict(list))
    """Target heights by target, round and face."""


@dataclass(frozen=True)
class Stated:
    """Standard deviations that a file states for a sight: radians, radians, metres."""

    direction: float | None = None
    zenith: float | None = None
    distance: float | None = None


class FieldBook:
    """Points, set-ups, sights and height differences of a file."""

    def __init__(self, path: Path, accuracies: Accuracies, fixed: str | Iterable[str] = ()) -> None:
        """Start an empty book of a file.

        Args:
            path: the file.
            accuracies: standard deviations, and how readings are reduced.
            fixed: names of the points that are held at the coordinates of the file; in a text
                they are separated by commas.
        """
        self.path = path
        self.held = names_of(fixed)
        self.notes = Notes(path)
        self.accuracies = accuracies
        self.points: dict[str, tuple[float, float, float]] = {}
        self.said: dict[str, int] = {}
        self.levelled_points: set[str] = set()
        self.sighted: set[str] = set()
        self.current: SetUp | None = None
        self.setups: dict[str, int] = defaultdict(int)
        self.readings: dict[tuple[str, str], list[tuple[int, FaceReading, Stated]]] = {}
        self.others: list[Observation] = []

    # -- what a reader says -----------------------------------------------------------------------

    def point(
        self,
        line: int,
        name: str,
        east: float = math.nan,
        north: float = math.nan,
        up: float = math.nan,
        *,
        agree: bool = True,
    ) -> None:
        """Note a point, with the coordinates that are known.

        Coordinates that are stated first count. Others are a problem if they ought to ``agree``,
        and ignored if they are results of the instrument, which differ from sight to sight.
        """
        if not name:
            return
        given = self.points.get(name)
        new = (east, north, up)
        if given is None:
            self.points[name], self.said[name] = new, line
            return
        both = [(a, b) for a, b in zip(given, new, strict=True) if a == a and b == b]
        if agree and any(abs(a - b) > SAME for a, b in both):
            first = self.said[name]
            self.notes.add(line, f"coordinates of point {name!r} differ from those of line {first}")
        e, n, u = (b if math.isnan(a) else a for a, b in zip(given, new, strict=True))
        self.points[name] = (e, n, u)
        self.said[name] = self.said[name] if given != UNKNOWN else line

    def begin(self, line: int, station: str, height: float) -> None:
        """Begin a set-up on a point."""
        self.point(line, station)
        self.setups[station] += 1
        self.current = SetUp(station, height, str(self.setups[station]), line)

    def sight(
        self,
        line: int,
        target: str,
        *,
        direction: float | None = None,
        zenith: float | None = None,
        distance: float | None = None,
        horizontal: float | None = None,
        target_height: float = 0.0,
        face: int | None = None,
        stated: Stated = Stated(),
    ) -> None:
        """Note the readings of one target in one face of the present set-up, SI units.

        Args:
            line: line of the file.
            target: its name.
            direction: horizontal reading.
            zenith: zenith reading, in face 2 from π to 2π.
            distance: slope distance.
            horizontal: horizontal distance, which is used where there is no slope distance.
            target_height: height of the target.
            face: face, where the file tells it; otherwise the zenith reading does.
            stated: standard deviations of the file.
        """
        at = self.current
        if at is None or not target:
            return
        self.point(line, target)
        self.sighted |= {at.station, target}
        read = (direction, zenith, distance, horizontal, target_height)
        if self.notes and any(v is not None and math.isnan(v) for v in read):
            return  # what is no number has been noted
        if face is None:
            face = 2 if zenith is not None and zenith > math.pi else 1
        place = self.notes.place(line)
        of_sight: dict[str, Any] = {"instrument_height": at.height, "target_height": target_height}
        if distance is None and horizontal is not None:
            found = self.notes.attempt(
                line,
                lambda: HorizontalDistance(
                    at.station,
                    target,
                    horizontal,
                    sigma=self.accuracies.distance(stated.distance),
                    source=place,
                    **of_sight,
                ),
            )
            self.others += [found] if found is not None else []
        if direction is None and zenith is None and distance is None:
            return
        rounds = at.rounds[target]
        number = next(
            (i for i, r in enumerate(rounds) if face not in r and target_height in r.values()),
            len(rounds),
        )
        if number == len(rounds):
            rounds.append({})
        rounds[number][face] = target_height
        name = at.number if number == 0 else f"{at.number}.{number + 1}"
        reading = FaceReading(
            station=at.station,
            target=target,
            face=face,
            direction=direction,
            zenith=zenith,
            distance=distance,
            set=name,
            source=place,
            **of_sight,
        )
        self.readings.setdefault((at.station, name), []).append((line, reading, stated))

    def levelled(self, line: int, back: str, fore: str, value: float, length: float) -> None:
        """Note a levelled height difference, metres, of a line of some length, metres."""
        for name in (back, fore):
            self.levelled_points.add(name)
            self.point(line, name)
        if self.notes and math.isnan(value):
            return  # what is no number has been noted
        known_length = length if length > 0 else None
        sigma = self.accuracies.levelling()
        if known_length is None:
            # Without lengths of sights a set-up counts as 60 m of line.
            sigma = StandardDeviation(sigma.per_sqrt_km * math.sqrt(0.06))
        found = self.notes.attempt(
            line,
            lambda: HeightDifference(
                back,
                fore,
                value,
                sigma=sigma,
                source=self.notes.place(line),
                length_km=None if known_length is None else known_length / LENGTH["km"],
            ),
        )
        self.others += [found] if found is not None else []

    # -- the network ------------------------------------------------------------------------------

    def network(self) -> Network:
        """Return the network.

        Raises:
            InputError: the problems that were noted, and those of the readings, all of them.
        """
        reduced = [self._reduced(k, list(v)) for k, v in self.readings.items()]
        if not self.notes and not reduced and not self.others and not self.points:
            self.notes.add(1, "holds neither points nor observations")
        held = self.held
        for name in held:
            if name not in self.points:
                names = known(self.points, meant=name)
                self.notes.add(1, f"fixed: there is no point {name!r}; known: {names}")
            elif all(math.isnan(v) for v in self.points[name]):
                self.notes.add(1, f"fixed: the file has no coordinates of point {name!r}")
        self.notes.raise_all()
        network = Network(self.path.stem, frame=LocalFrame(), datum="given" if held else "free")
        network.left_out += self.notes.left.told().values()
        self._add_points(network, held)
        if self.accuracies.refraction is not None and reduced:
            # Heights follow the curved Earth while the frame is flat: κ = k − 1 does both.
            network.set_refraction(value=self.accuracies.refraction - 1.0, fixed=True)
        network.add(*self.others)
        for r in reduced:
            if r is not None:
                r.add_to(network)
        return network

    def _add_points(self, network: Network, held: tuple[str, ...]) -> None:
        """Add the points; those that were only levelled are held in plan."""
        only_levelled = self.levelled_points - self.sighted
        for name, (e, n, u) in self.points.items():
            fixed = "".join(
                a for a, v in zip("xyz", (e, n, u), strict=True) if name in held and v == v
            )
            if name in only_levelled:
                e, n = (0.0 if math.isnan(v) else v for v in (e, n))
                fixed = "xy" + fixed.strip("xy")
            network.add_point(name, (e, n, u), fixed=fixed)

    def _reduced(
        self, key: tuple[str, str], found: list[tuple[int, FaceReading, Stated]]
    ) -> ReducedFaces | None:
        """Return the observations of a set; a reading in one face alone needs no σ of its own."""
        a = self.accuracies
        stated = [s for _, _, s in found]
        try:
            return reduce_faces(
                [r for _, r, _ in found],
                sigma_direction=a.direction(_mean([s.direction for s in stated])),
                sigma_zenith=a.zenith(_mean([s.zenith for s in stated])),
                sigma_distance=a.distance(_mean([s.distance for s in stated])),
                faces=a.faces,
            )
        except InputError as error:
            lines = {r.label(): line for line, r, _ in found}
            for p in error.problems:
                of = next((n for label, n in lines.items() if p.where == label), found[0][0])
                self.notes.add(of, f"station {key[0]!r}, set {key[1]!r}: {p.what}")
            return None


def _mean(stated: list[float | None]) -> float | None:
    """Return the root mean square of standard deviations; None where there is none."""
    given = [s for s in stated if s is not None]
    return math.sqrt(sum(s * s for s in given) / len(given)) if given else None
