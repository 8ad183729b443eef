"""Field book of total stations and levels as a network: set-ups, rounds, sights, accuracies.

Readers of field books fill it with what they read: points, set-ups, sights and levelled height
differences; a network is made from it. A target that is read again in the same face of a set-up
begins another round. Every round is a set of directions with an orientation unknown of its own,
since nothing in a field book says whether the circle was turned between rounds. Field books have no
accuracies: `Accuracies` states them, and how readings in two faces are reduced.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, get_args

from ...errors import InputError, Problem, known
from ...frames import LocalFrame
from ...network.face_readings import FaceReading
from ...network.face_reduction import FacesChoice, ReducedFaces, reduce_faces
from ...network.network import Network
from ...observations import HeightDifference, HorizontalDistance, Observation
from ...stochastic_model import StandardDeviation
from ...units import ANGLE, LENGTH
from ..source import Source

DEFAULT_DIRECTION_MGON, DEFAULT_ZENITH_MGON = 1.0, 1.0
"""Default σ of a reading of a circle in one face, milligons: an instrument of 3″."""
DEFAULT_DISTANCE_MM, DEFAULT_DISTANCE_PPM = 2.0, 2.0
"""Default σ of a distance: 2 mm + 2 ppm, usual for total stations with prisms."""
DEFAULT_CENTRING_MM = 1.0
"""Default σ of the centring of instrument and of target, millimetres: tribrach and tripod."""
DEFAULT_LEVELLING_MM = 1.0
"""Default σ of one kilometre of levelled line, millimetres."""
DEFAULT_REFRACTION = 0.13
"""Default coefficient of refraction k (Gauss)."""


STATED_SIGMAS = ("sigma_direction_mgon", "sigma_zenith_mgon", "sigma_distance_mm")
"""Standard deviations that a file may state."""
MAX_COORDINATE_DIFFERENCE_M = 1e-4
"""Coordinates of a point that is stated twice differ by less, metres."""
UNKNOWN_COORDINATES = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Accuracies:
    """Standard deviations of the readings of a field book, and how they are reduced.

    Every reader of field books takes them as ``accuracies``, because the files do not have them.
    `factorgraph_adj.read` and the commands (``--set``) also take each field as an option of its
    own.

    Raises:
        InputError: numbers that are no standard deviations, all of them.
    """

    sigma_direction_mgon: float | None = None
    """σ of a horizontal reading in one face, mgon; None: that of the file, which JobXML may have,
    or 1."""
    sigma_zenith_mgon: float | None = None
    """σ of a zenith reading in one face, mgon; None: that of the file, or 1."""
    sigma_distance_mm: float | None = None
    """Constant part of σ of a distance, mm; None: that of the file, which then has no part that
    grows, or 2."""
    ppm: float = DEFAULT_DISTANCE_PPM
    """Part of σ of a distance that grows with it, mm/km."""
    centring_mm: float | None = None
    """σ of the centring of instrument and of target, mm; None: 1, and 0 for both faces."""
    sigma_levelling_mm: float = DEFAULT_LEVELLING_MM
    """σ of one kilometre of levelled line, mm."""
    faces: FacesChoice = "means"
    """Means of two faces, or both readings, see `factorgraph_adj.reduce_faces`."""
    refraction: float | None = DEFAULT_REFRACTION
    """Coefficient of refraction k. None: heights are above a plane, neither curvature nor
    refraction."""

    def __post_init__(self) -> None:
        """Refuse numbers that are no standard deviations."""
        problems = []
        for name in (*STATED_SIGMAS, "sigma_levelling_mm"):
            value = getattr(self, name)
            if not (value is None and name in STATED_SIGMAS) and not _is_within(value, 1e-9, 1e6):
                problems.append(_range_problem(name, "a number > 0", value))
        for name in ("ppm", "centring_mm"):
            value = getattr(self, name)
            if not (value is None and name == "centring_mm") and not _is_within(value, 0.0, 1e6):
                problems.append(_range_problem(name, "a number ≥ 0", value))
        if self.faces not in (valid := get_args(FacesChoice)):
            problems.append(_range_problem("faces", known(valid, meant=self.faces), self.faces))
        if self.refraction is not None and not _is_within(self.refraction, -10.0, 10.0):
            problems.append(_range_problem("refraction", "a number such as 0.13", self.refraction))
        if problems:
            raise InputError(problems)

    @property
    def centring(self) -> float:
        """σ of the centring of instrument and of target, metres."""
        usual = DEFAULT_CENTRING_MM if self.faces == "means" else 0.0
        return (usual if self.centring_mm is None else self.centring_mm) * LENGTH["mm"]

    def direction(self, stated: float | None) -> float | StandardDeviation:
        """Return σ of a horizontal reading, with the centring of both ends.

        Args:
            stated: σ that the file states, radians; it counts where none is given.
        """
        return self._angle(self.sigma_direction_mgon, stated, DEFAULT_DIRECTION_MGON)

    def zenith(self, stated: float | None) -> float | StandardDeviation:
        """Return σ of a zenith reading as `direction` does."""
        return self._angle(self.sigma_zenith_mgon, stated, DEFAULT_ZENITH_MGON)

    def _angle(
        self, given: float | None, stated: float | None, usual: float
    ) -> float | StandardDeviation:
        c = self.centring
        constant = (usual if given is None else given) * ANGLE["mgon"]
        if given is None and stated is not None:
            constant = stated
        if c == 0.0:
            return constant
        return StandardDeviation(constant, centring_instrument=c, centring_target=c)

    def distance(self, stated: float | None) -> StandardDeviation:
        """Return σ of a distance, with the centring of both ends.

        Args:
            stated: σ that the file states, metres; it has no part that grows, and counts where
                none is given.
        """
        c, given = self.centring, self.sigma_distance_mm
        constant = (DEFAULT_DISTANCE_MM if given is None else given) * LENGTH["mm"]
        ppm = self.ppm
        if given is None and stated is not None:
            constant, ppm = stated, 0.0
        return StandardDeviation(constant, ppm=ppm, centring_instrument=c, centring_target=c)

    def levelling(self) -> StandardDeviation:
        """Return σ of a levelled height difference."""
        return StandardDeviation(per_sqrt_km=self.sigma_levelling_mm * LENGTH["mm"])


def name_list(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return names; those in a text are separated by commas."""
    if isinstance(given, str):
        return tuple(n for part in given.split(",") if (n := part.strip()))
    if isinstance(given, int | float):  # a name that the command line took for a number
        return (str(given),)
    return tuple(str(n) for n in given)


def _is_within(value: object, low: float, high: float) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) and low <= value <= high


def _range_problem(name: str, valid: str, value: object) -> Problem:
    return Problem(f"must be {valid}, not {value!r}", name)


DEFAULT_ACCURACIES = Accuracies()
"""Accuracies of an instrument of 3″ and 2 mm + 2 ppm on tripods, and means of both faces."""


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


@dataclass(frozen=True)
class StatedSigmas:
    """Standard deviations that a file states for a sight: radians, radians, metres."""

    direction: float | None = None
    zenith: float | None = None
    distance: float | None = None


class FieldBook:
    """Points, set-ups, sights and height differences of a file."""

    def __init__(
        self, source: Source, accuracies: Accuracies, fixed: str | Iterable[str] = ()
    ) -> None:
        """Start an empty book of a file.

        Args:
            source: the file.
            accuracies: standard deviations, and how readings are reduced.
            fixed: names of the points that are held at the coordinates of the file; in a text
                they are separated by commas.
        """
        self.source = source
        self.held = name_list(fixed)
        self.accuracies = accuracies
        self.points: dict[str, tuple[float, float, float]] = {}
        self.said: dict[str, int] = {}
        self.levelled_points: set[str] = set()
        self.sighted: set[str] = set()
        self.current: SetUp | None = None
        self.without_station: list[int] = []
        """Lines of sights before any set-up."""
        self.setups: dict[str, int] = defaultdict(int)
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

        Coordinates that are stated first count. Others are a problem if they ought to ``agree``,
        and ignored if they are results of the instrument, which differ from sight to sight.
        """
        if not name:
            return
        e, n, u = (math.nan if v is None else v for v in (east, north, up))
        given, new = self.points.get(name), (e, n, u)
        if given is None:
            self.points[name], self.said[name] = new, line
            return
        both = [(a, b) for a, b in zip(given, new, strict=True) if a == a and b == b]
        if agree and any(abs(a - b) > MAX_COORDINATE_DIFFERENCE_M for a, b in both):
            first = self.said[name]
            self.source.wrong(
                line, f"coordinates of point {name!r} differ from those of line {first}"
            )
        e, n, u = (b if math.isnan(a) else a for a, b in zip(given, new, strict=True))
        self.points[name] = (e, n, u)
        self.said[name] = self.said[name] if given != UNKNOWN_COORDINATES else line

    def begin(self, line: int, station: str, height: float | None = None) -> None:
        """Begin a set-up on a point; `set_height` may give the height of the instrument later."""
        self.point(line, station)
        self.setups[station] += 1
        self.current = SetUp(station, height, str(self.setups[station]), line)

    def set_height(self, line: int, height: float) -> None:
        """Give the height of the instrument of the present set-up, before or after its sights."""
        at = self.current
        if at is None:
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
        stated: StatedSigmas = StatedSigmas(),
    ) -> None:
        """Note the readings of one target in one face of the present set-up, SI units.

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
        """
        at = self.current
        if at is None:
            self.without_station.append(line)
        if at is None or not at.station or not target:
            return  # what is no name has been noted
        self.point(line, target)
        self.sighted |= {at.station, target}
        target_height = target_height or 0.0
        read = (direction, zenith, distance, horizontal, target_height, at.height)
        if self.source.problems.count and any(v is not None and math.isnan(v) for v in read):
            return  # what is no number has been noted
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
        at.sets.add(name)
        self.readings.setdefault((at.station, name), []).append((line, reading, stated))

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
            # Without lengths of sights a set-up counts as 60 m of line.
            sigma = StandardDeviation(sigma.per_sqrt_km * math.sqrt(0.06))
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

    # -- the network ------------------------------------------------------------------------------

    def network(self, *, hint: str = "") -> Network:
        """Return the network.

        Args:
            hint: what may be done about sights before any station.

        Raises:
            InputError: the problems that were noted, and those of the readings, all of them.
        """
        if self.without_station:
            n = len(self.without_station)
            what = "1 sight from here has" if n == 1 else f"{n} sights from here have"
            self.source.wrong(self.without_station[0], f"{what} no station{hint}")
        reduced = [self._reduced(k, list(v)) for k, v in self.readings.items()]
        if not self.source.problems.count and not reduced and not self.others and not self.points:
            self.source.wrong(1, "holds neither points nor observations")
        held = self.held
        for name in held:
            if name not in self.points:
                names = known(self.points, meant=name)
                self.source.wrong(1, f"fixed: there is no point {name!r}; known: {names}")
            elif all(math.isnan(v) for v in self.points[name]):
                self.source.wrong(1, f"fixed: the file has no coordinates of point {name!r}")
        self.source.raise_all()
        stem = self.source.path.stem
        network = Network(stem, frame=LocalFrame(), datum="given" if held else "free")
        self._add_points(network, held)
        if self.accuracies.refraction is not None and reduced:
            # Heights follow the curved Earth while the frame is flat: κ = k − 1 does both.
            network.set_refraction(value=self.accuracies.refraction - 1.0, fixed=True)
        network.add(*self.others)
        for r in reduced:
            if r is not None:
                r.add_to(network)
        self.source.problems.finish(network)
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
        self, key: tuple[str, str], found: list[tuple[int, FaceReading, StatedSigmas]]
    ) -> ReducedFaces | None:
        """Return the observations of a set; a reading in one face alone needs no σ of its own."""
        a = self.accuracies
        stated = [s for _, _, s in found]
        try:
            return reduce_faces(
                [r for _, r, _ in found],
                sigma_direction=a.direction(_root_mean_square([s.direction for s in stated])),
                sigma_zenith=a.zenith(_root_mean_square([s.zenith for s in stated])),
                sigma_distance=a.distance(_root_mean_square([s.distance for s in stated])),
                faces=a.faces,
            )
        except InputError as error:
            lines = {r.label(): line for line, r, _ in found}
            for p in error.problems:
                of = next((n for label, n in lines.items() if p.where == label), found[0][0])
                self.source.wrong(of, f"station {key[0]!r}, set {key[1]!r}: {p.what}")
            return None


def _root_mean_square(stated: list[float | None]) -> float | None:
    """Return the root mean square of standard deviations; None where there is none."""
    given = [s for s in stated if s is not None]
    return math.sqrt(sum(s * s for s in given) / len(given)) if given else None
