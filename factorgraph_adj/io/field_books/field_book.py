"""Field book of total stations and levels as a network: set-ups, rounds, sights, backsights.

Readers of field books fill it with what they read: points, set-ups, sights and levelled height
differences; a network is made from it. A target that is read again in the same face of a set-up
begins another round. Every round is a set of directions with an orientation unknown of its own,
since nothing in a field book says whether the circle was turned between rounds. Field books have no
accuracies: `Accuracies` states them, and how readings in two faces are reduced.

A book of directions and horizontal distances alone is a plane network, which holds all heights. The
sights before any station, where the format may lack one, are those of `unnamed_station`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from ...errors import InputError, known
from ...frames import LocalFrame
from ...network.face_readings import FaceReading
from ...network.face_reduction import ReducedFaces, reduce_faces
from ...network.network import Network
from ...observations import Azimuth, HeightDifference, HorizontalDistance, Observation
from ...stochastic_model import StandardDeviation
from ...units import LENGTH
from ..format_options import option_text
from ..source import LeftOutReason, Source
from .accuracies import DEFAULT_SETUP_M, NO_SIGMAS, Accuracies, StatedSigmas, root_mean_square
from .stated_coordinates import UNKNOWN_COORDINATES, StatedCoordinates
from .unnamed_station import WITHOUT_STATION, UnnamedSights

WITHOUT_READING = LeftOutReason("sights", "they have no reading")
OWN_TARGETS = LeftOutReason("sights", "their target has the name of the station")
REPEATED_BACKSIGHTS = LeftOutReason(
    "circle readings of backsights", "sights of their set-ups have the directions"
)


def name_list(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return names; those in a text are separated by commas."""
    if isinstance(given, str):
        return tuple(n for part in given.split(",") if (n := part.strip()))
    if isinstance(given, int | float):  # a name that the command line took for a number
        return (str(given),)
    return tuple(str(n) for n in given)


@dataclass
class SetUp:
    """An instrument on a point."""

    station: str
    height: float | None
    """Height of the instrument; None: none is given so far, it counts as 0."""
    number: str
    """Number of the set-up among those of the station: a set of directions is named by it."""
    line: int
    rounds: dict[str, list[dict[int, float]]] = field(default_factory=lambda: defaultdict(list))
    """Target heights by target, round and face."""
    sets: set[str] = field(default_factory=set)
    """Names of its sets of directions."""
    horizontals: list[tuple[int, HorizontalDistance]] = field(default_factory=list)
    """Its horizontal distances, with their places among the other observations of the book."""
    oriented: set[str] = field(default_factory=set)
    """Targets whose directions were read."""
    backsights: list[tuple[int, str, float, float | None, int | None]] = field(default_factory=list)
    """Line, target, circle reading, target height and face of records of backsights."""
    taken: int = 0
    """Number of its first rounds whose observations were taken, see `FieldBook.take_set`."""

    def set_name(self, number: int) -> str:
        """Return the name of the set of directions of a round, from 0."""
        return self.number if number == 0 else f"{self.number}.{number + 1}"


class FieldBook:
    """Points, set-ups, sights and height differences of a file."""

    def __init__(
        self,
        source: Source,
        accuracies: Accuracies,
        fixed: str | Iterable[str] = (),
        *,
        station: str | None = None,
        may_lack_station: bool = False,
        zero_is_unmeasured: bool = True,
    ) -> None:
        """Start an empty book of a file.

        Args:
            source: the file.
            accuracies: standard deviations, and how readings are reduced.
            fixed: names of the points that are held at the coordinates of the file; in a text
                they are separated by commas.
            station: name of the station of sights before any station, which options may give as
                a number; None: see ``may_lack_station``.
            may_lack_station: whether files of the format may have no record of a station: the
                reader has the option ``station``, which messages name, and sights before any
                station are `UnnamedSights`; otherwise they are a problem.
            zero_is_unmeasured: whether distances of exactly 0 were not measured, as files of
                instruments mean it.
        """
        self.source = source
        self.held = name_list(fixed)
        self.accuracies = accuracies
        self.coordinates = StatedCoordinates()
        self.points = self.coordinates.points
        self.levelled_points: set[str] = set()
        self.sighted: set[str] = set()
        self.current: SetUp | None = None
        self.may_lack_station = may_lack_station or station is not None
        self.zero_is_unmeasured = zero_is_unmeasured
        self.unnamed = UnnamedSights("" if station is None else str(station))
        """Sights before any set-up."""
        self.setups: dict[str, int] = defaultdict(int)
        self.begun: list[SetUp] = []
        self.readings: dict[tuple[str, str], list[tuple[int, FaceReading, StatedSigmas]]] = {}
        self.others: list[Observation] = []

    # -- what a reader says -----------------------------------------------------------------------

    def point(
        self,
        line: int,
        name: str,
        east: float | None = None,
        north: float | None = None,
        up: float | None = None,
        *,
        agree: bool = True,
    ) -> None:
        """Note a point, with the coordinates that are known; None or NaN: one is not.

        Coordinates that are stated first count. Others are a problem if they ought to ``agree``.
        Results of the instrument need not, as they differ from sight to sight: a remark of the
        network names the largest differences, and a doubt points at other places.
        """
        e, n, u = (math.nan if v is None else v for v in (east, north, up))
        if name:
            self.coordinates.state(self.source, line, name, (e, n, u), agree=agree)

    def begin(self, line: int, station: str, height: float | None = None) -> None:
        """Begin a set-up on a point; `set_height` may give the height of the instrument later."""
        self.point(line, station)
        self.setups[station] += 1
        self.current = SetUp(station, height, str(self.setups[station]), line)
        self.begun.append(self.current)

    def set_height(self, line: int, height: float) -> None:
        """Give the height of the instrument of the present set-up, before or after its sights."""
        at = self.current
        if at is None and self.may_lack_station:
            self.unnamed.heights.append((line, height))
        elif at is None:
            self.source.wrong(line, "a height of the instrument before any station")
        elif at.height is None:
            at.height = height
            for i, distance in at.horizontals:
                self.others[i] = replace(distance, instrument_height=height)
            for key in ((at.station, name) for name in at.sets):
                self.readings[key] = [
                    (n, replace(reading, instrument_height=height), stated)
                    for n, reading, stated in self.readings[key]
                ]
        elif abs(at.height - height) > 0:  # a NaN has been noted
            what = f"height of the instrument {height:.3f} m differs from that of the set-up, "
            what += f"{at.height:.3f} m: a new set-up needs a station"
            self.source.wrong(line, what)

    def sight(
        self,
        line: int,
        target: str,
        *,
        direction: float | None = None,
        zenith: float | None = None,
        distance: float | None = None,
        horizontal: float | None = None,
        target_height: float | None = None,
        face: int | None = None,
        stated: StatedSigmas = NO_SIGMAS,
        coordinates: tuple[float, float, float] | None = None,
    ) -> int | None:
        """Note the readings of one target in one face of the present set-up, SI units.

        A sight without any reading, or to the name of the station, is left out, and counted.

        Args:
            line: line of the file.
            target: its name.
            direction: horizontal reading.
            zenith: zenith reading, in face 2 from π to 2π.
            distance: slope distance.
            horizontal: horizontal distance, which is used where there is no slope distance.
            target_height: height of the target; None: 0.
            face: face, where the file states it; otherwise from the zenith reading.
            stated: standard deviations of the file.
            coordinates: coordinates of the target that the file has beside the readings; they are
                approximate ones, and those of three targets give a station that no record states.

        Returns:
            Number of the round, from 0, of circle readings and slope distance; None: of none.
        """
        at, given = self.current, coordinates or UNKNOWN_COORDINATES
        if self.zero_is_unmeasured:
            distance, horizontal = distance or None, horizontal or None
        if direction is None and zenith is None and distance is None and horizontal is None:
            if target:
                self.source.leave_out(line, WITHOUT_READING, target)
            return None
        if at is None:
            read_values = {"direction": direction, "zenith": zenith, "distance": distance}
            read_values |= {"horizontal": horizontal, "target_height": target_height}
            self.unnamed.add(line, target, given, **read_values, face=face, stated=stated)
            return None
        if target and target == at.station:
            self.source.leave_out(line, OWN_TARGETS, target)
            return None
        if target and given != UNKNOWN_COORDINATES:
            self.point(line, target, *given, agree=False)
        if not at.station or not target:
            return None  # what is no name has been noted
        self.point(line, target)
        self.sighted |= {at.station, target}
        target_height = target_height or 0.0
        read = (direction, zenith, distance, horizontal, target_height, at.height)
        if self.source.problems.count and any(v is not None and math.isnan(v) for v in read):
            return None  # what is no number has been noted
        if face is None:
            face = 2 if zenith is not None and zenith > math.pi else 1
        place = self.source.place(line)
        of_sight: dict[str, Any] = {
            "instrument_height": at.height or 0.0,
            "target_height": target_height,
        }
        if distance is None and horizontal is not None:
            found = self.source.attempt(
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
            if found is not None:
                at.horizontals.append((len(self.others), found))
                self.others.append(found)
        if direction is None and zenith is None and distance is None:
            return None
        if direction is not None:
            at.oriented.add(target)
        rounds = at.rounds[target]
        rounds += [{} for _ in range(at.taken - len(rounds))]
        number = next(
            (
                i
                for i, r in enumerate(rounds)
                if i >= at.taken and face not in r and target_height in r.values()
            ),
            len(rounds),
        )
        if number == len(rounds):
            rounds.append({})
        rounds[number][face] = target_height
        name = at.set_name(number)
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
        at.sets.add(name)
        self.readings.setdefault((at.station, name), []).append((line, reading, stated))
        return number

    def backsight(
        self,
        line: int,
        target: str,
        direction: float | None,
        *,
        target_height: float | None = None,
        face: int | None = None,
    ) -> None:
        """Note a record that names the backsight of the present set-up and its circle reading.

        The reading is a direction where no sight of the set-up has one of this target; otherwise
        it is left out, and counted.

        Args:
            line: line of the file.
            target: name of the backsight.
            direction: circle reading, radians; None: the record has none.
            target_height: height of the target; None: 0.
            face: face; None: 1.
        """
        if self.current is None:
            self.source.wrong(line, "a backsight before any station")
        elif direction is not None:
            self.current.backsights.append((line, target, direction, target_height, face))

    def levelled(self, line: int, back: str, fore: str, value: float, length: float) -> None:
        """Note a levelled height difference, metres, of a line of some length, metres."""
        for name in (back, fore):
            self.levelled_points.add(name)
            self.point(line, name)
        if self.source.problems.count and math.isnan(value):
            return  # what is no number has been noted
        known_length = length if length > 0 else None
        sigma = self.accuracies.levelling()
        if known_length is None:
            length_of_setup = DEFAULT_SETUP_M / LENGTH["km"]
            sigma = StandardDeviation(sigma.per_sqrt_km * math.sqrt(length_of_setup))
        found = self.source.attempt(
            line,
            lambda: HeightDifference(
                back,
                fore,
                value,
                sigma=sigma,
                source=self.source.place(line),
                length_km=None if known_length is None else known_length / LENGTH["km"],
            ),
        )
        self.others += [found] if found is not None else []

    def take_set(self, number: int) -> ReducedFaces | None:
        """Return the observations of a round of the present set-up, and forget its readings.

        Later readings belong to rounds after it. None: it has no readings, or problems.
        """
        at = self.current
        if at is None or number < at.taken:
            return None
        at.taken = number + 1
        name = at.set_name(number)
        found = self.readings.pop((at.station, name), None)
        return None if found is None else self._reduced((at.station, name), found)

    # -- the network ------------------------------------------------------------------------------

    def network(self, *, hint: str = "") -> Network:
        """Return the network.

        Args:
            hint: what may be done about sights before any station.

        Raises:
            InputError: the problems that were noted, and those of the readings, all of them.
        """
        if self.unnamed.sights:
            self._take_unnamed(hint)
        for at in self.begun:
            self._take_backsights(at)
        reduced = [self._reduced(k, list(v)) for k, v in self.readings.items()]
        if not self.source.problems.count and not reduced and not self.others and not self.points:
            left = self.source.problems.counts_left_out()
            self.source.wrong(1, "; ".join(["holds neither points nor observations", *left]))
        held = self.held
        self._check_held()
        self.source.raise_all()
        stem = self.source.path.stem
        network = Network(stem, frame=LocalFrame(), datum="given" if held else "free")
        in_plan = self._is_in_plan()
        self._add_points(network, held, in_plan=in_plan)
        if self.accuracies.refraction is not None and reduced and not in_plan:
            # Heights follow the curved Earth while the frame is flat: κ = k − 1 does both.
            network.set_refraction(value=self.accuracies.refraction - 1.0, fixed=True)
        network.add(*self.others)
        for r in reduced:
            if r is not None:
                r.add_to(network)
        network.doubts += self.coordinates.doubts()
        self._add_remarks(in_plan=in_plan)
        self.source.problems.finish(network)
        return network

    def _take_unnamed(self, hint: str) -> None:
        """Take the sights before any station as set-ups, or note why they are none."""
        unnamed, place = self.unnamed, self.source.place
        found = unnamed.setups(self.points, place) if self.may_lack_station else []
        why = "" if self.begun or not self.may_lack_station else unnamed.why_unknown()
        if not found and (self.begun or why or not self.may_lack_station):
            first, n = unnamed.sights[0].line, len(unnamed.sights)
            what = "1 sight from here has" if n == 1 else f"{n} sights from here have"
            if self.may_lack_station:
                hint += f"; give {option_text('station', 'NAME')} if all are from one point"
            self.source.wrong(first, f"{what} no station{why}{hint}")
            return
        readings, self.readings = self.readings, {}
        taken = set()
        for setup in found or [unnamed.the_only(self.points, place)]:
            line = setup.sights[0].line
            self.source.problems.remarks += [setup.remark] if setup.remark else []
            self.point(line, setup.station, *setup.coordinates, agree=False)
            self.begin(line, setup.station, setup.height)
            for at, height in unnamed.heights_of(setup.sights):
                self.set_height(at, height)
            for s in setup.sights:
                self.sight(s.line, s.target, **s.readings, coordinates=s.coordinates)
                taken.add(s.line)
        for s in unnamed.sights:
            if s.line not in taken:
                self.source.leave_out(s.line, WITHOUT_STATION, s.target)
        # The sights are the first of the file, and their sets the first of the network.
        self.readings = {**self.readings, **readings}

    def _take_backsights(self, at: SetUp) -> None:
        """Take the circle readings of the backsights of a set-up whose directions it has not."""
        now, self.current = self.current, at
        for line, target, direction, height, face in at.backsights:
            if target in at.oriented:
                self.source.leave_out(line, REPEATED_BACKSIGHTS, target)
            else:
                self.sight(line, target, direction=direction, target_height=height, face=face or 1)
        self.current = now

    def _check_held(self) -> None:
        """Note names of points to hold that the file does not have, or has without coordinates."""
        with_coordinates = [n for n, at in self.points.items() if any(v == v for v in at)]
        example = option_text("fixed", ",".join(with_coordinates[:2]))
        advice = f"; points with coordinates: {known(with_coordinates)}: give {example}"
        if not with_coordinates:
            advice = "; no point of the file has coordinates: without fixed the network is free"
        for name in self.held:
            if name not in self.points:
                names = known(self.points, meant=name)
                what = f"fixed: there is no point {name!r}; known: {names}"
                self.source.wrong(1, what + advice * bool(self.points))
            elif name not in with_coordinates:
                what = f"fixed: the file has no coordinates of point {name!r}"
                self.source.wrong(1, what + advice)

    def _is_in_plan(self) -> bool:
        """Return whether there are readings, none of which gives a height."""
        sights = [r for found in self.readings.values() for _, r, _ in found]
        if not sights and not self.others:
            return False
        return all(isinstance(o, HorizontalDistance | Azimuth) for o in self.others) and not any(
            r.zenith is not None or r.distance is not None for r in sights
        )

    def _add_remarks(self, *, in_plan: bool) -> None:
        """Say how heights that are missing and coordinates that are repeated were taken."""
        remarks = self.source.problems.remarks
        if in_plan:
            what = "no reading gives a height: the network is plane, and holds the heights of all "
            remarks.append(f"{what}points, at 0 where the file has none")
        flat = [n for n in self.held if math.isnan(self.points[n][2])]
        if flat and not in_plan:
            what = "is held in plan alone" if len(flat) == 1 else "are held in plan alone"
            remarks.append(f"{known(flat)} {what}: the file has no height")
        remarks += self.coordinates.remarks()

    def _add_points(self, network: Network, held: tuple[str, ...], *, in_plan: bool) -> None:
        """Add the points; those that were only levelled are held in plan, or all in height."""
        only_levelled = self.levelled_points - self.sighted
        for name, (e, n, u) in self.points.items():
            fixed = "".join(
                a for a, v in zip("xyz", (e, n, u), strict=True) if name in held and v == v
            )
            if name in only_levelled:
                e, n = (0.0 if math.isnan(v) else v for v in (e, n))
                fixed = "xy" + fixed.strip("xy")
            if in_plan:
                u, fixed = 0.0 if math.isnan(u) else u, fixed.strip("z") + "z"
            network.add_point(name, (e, n, u), fixed=fixed)

    def _reduced(
        self, key: tuple[str, str], found: list[tuple[int, FaceReading, StatedSigmas]]
    ) -> ReducedFaces | None:
        """Return the observations of a set; a reading in one face alone needs no σ of its own."""
        a = self.accuracies
        stated = [s for _, _, s in found]
        try:
            return reduce_faces(
                [r for _, r, _ in found],
                sigma_direction=a.direction(root_mean_square([s.direction for s in stated])),
                sigma_zenith=a.zenith(root_mean_square([s.zenith for s in stated])),
                sigma_distance=a.distance(root_mean_square([s.distance for s in stated])),
                faces=a.faces,
            )
        except InputError as error:
            lines = {r.label(): line for line, r, _ in found}
            for p in error.problems:
                of = next((n for label, n in lines.items() if p.where == label), found[0][0])
                self.source.wrong(of, f"station {key[0]!r}, set {key[1]!r}: {p.what}")
            return None
