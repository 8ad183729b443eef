"""Reduction of readings in two faces: index, collimation, means with σ from given ones; doubts.

With horizontal readings d₁, d₂ and zenith readings z₁, z₂ of a target in faces 1 and 2,

    direction    d = (d₁ + d₂ − π)/2        collimation    c = (d₂ − d₁ − π)/2 · sin z
    zenith       z = (z₁ − z₂ + 2π)/2       index          i = (z₁ + z₂ − 2π)/2

so that d₁ = d − c/sin z, d₂ = d + c/sin z + π, z₁ = z + i, z₂ = 2π − z + i. Index and collimation
belong to a set-up: their means over its targets have the standard deviation σ/√(2n), and a target
whose own differs from that of the others by more than chance allows is named. A reading in one face
alone is freed of the means of its set-up; without any it keeps the errors of the instrument.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from math import hypot, pi, sin, sqrt
from typing import Any, Literal, TypeAlias

import numpy as np

from ..errors import Doubt, InputError, Problem
from ..models.base import wrap
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..observations import Direction, Observation, SlopeDistance, ZenithAngle
from ..result_display import Rows, Shown
from ..statistical_tests import TOLERANCE_IN_SIGMAS
from ..stochastic_model import StandardDeviation
from ..types import Array
from .face_readings import FaceReading, checked_readings
from .network import Network

SigmaOfReading: TypeAlias = "float | StandardDeviation"
TargetReadings: TypeAlias = dict[int, FaceReading]
"""The readings of a target by face."""
FacesChoice: TypeAlias = Literal["means", "both"]
"""Treatment of the two faces of a target: one mean, or two observations."""
KINDS_OF_CIRCLE_ERRORS = ("index_error", "collimation_error")
"""Kinds of unknowns that observations of both faces name."""

MAX_CIRCLE_ERROR_RAD = 0.2 * pi / 200.0
"""Index or collimation error beyond which a set-up is doubted whatever its targets say: 0.2 gon.
An instrument in order has less; readings of two targets, or of a circle that was turned, more."""


@dataclass(frozen=True)
class SetUp:
    """Errors of the instrument in a set-up."""

    station: str
    """The station."""
    set: str
    """The set."""
    targets: int
    """Number of targets in both faces."""
    index: float
    """Index error of the vertical circle i, radians; NaN without zenith readings in both faces."""
    sigma_index: float
    """Its standard deviation."""
    collimation: float
    """Collimation error c, radians; NaN without horizontal readings in both faces."""
    sigma_collimation: float
    """Its standard deviation."""


@dataclass(frozen=True, repr=False)
class ReducedFaces(Shown):
    """Observations from readings in two faces."""

    observations: tuple[Observation, ...]
    """Directions, zenith angles and slope distances, for `Network.add`."""
    setups: tuple[SetUp, ...]
    """Index and collimation errors."""
    doubts: tuple[Problem, ...]
    """Targets whose faces differ by more than chance allows."""
    doubted: tuple[tuple[int, ...], ...] = ()
    """Positions in ``observations`` of what each doubt is about; empty for a whole set-up."""

    def add_to(self, network: Network) -> list[str]:
        """Add the observations to a network; return their ids.

        Index and collimation errors that the observations name, and the network does not state,
        become free unknowns; those for which no target was read in both faces are doubted. The
        network keeps the doubts, which `factorgraph-adj check` and the
        report of the adjustment state.

        Raises:
            InputError: names that the network does not have, all of them; nothing is added.
        """
        changed = network.copy()
        faces: dict[tuple[VariableKind, str], dict[tuple[str, ...], set[int]]] = {}
        for o in self.observations:
            for kind, attribute in o.record.parameters:
                name = getattr(o, attribute)
                if (
                    kind in KINDS_OF_CIRCLE_ERRORS
                    and name is not None
                    and name not in network.of_kind(kind)
                ):
                    changed.set_unknown(kind, name)
                    of_targets = faces.setdefault((kind, name), {})
                    of_targets.setdefault(o.points(), set()).add(getattr(o, "face", 1))
        ids = changed.add(*self.observations)
        changed.doubts += [
            Doubt(p.what, p.where, tuple(ids[i] for i in about))
            for p, about in zip(self.doubts, self.doubted, strict=True)
        ]
        changed.doubts += _in_one_face(faces)
        vars(network).update(vars(changed))
        return ids

    def headline(self) -> str:
        """Return the numbers."""
        return (
            f"ReducedFaces: {len(self.observations)} observations of {len(self.setups)} set-ups, "
            f"{len(self.doubts)} doubts"
        )

    def first_rows(self) -> Rows:
        """Return index and collimation errors, milligons."""
        gon = 200e3 / pi
        rows = (
            (s.station, s.set, s.targets, s.index * gon, s.collimation * gon) for s in self.setups
        )
        header = ("station", "set", "targets", "index mgon", "collimation mgon")
        return Rows(header, rows, len(self.setups))


def reduce_faces(
    readings: Iterable[FaceReading],
    *,
    sigma_direction: SigmaOfReading,
    sigma_zenith: SigmaOfReading,
    sigma_distance: SigmaOfReading,
    faces: FacesChoice = "means",
) -> ReducedFaces:
    """Reduce readings in two faces to observations.

    The constant part of σ is that of a reading in one face; the mean of two has 1/√2 of it. Parts
    that the two faces of a target share, such as centring and ppm, remain as they are.

    Args:
        readings: the field book.
        sigma_direction: standard deviation of a horizontal reading in one face, radians.
        sigma_zenith: standard deviation of a zenith reading in one face, radians.
        sigma_distance: standard deviation of a distance in one face, metres.
        faces: ``means``: one direction and one zenith angle for each target, the means of its
            faces. ``both``: every reading is an observation that knows its face, and index and
            collimation errors are unknowns of the network, one of each for an ``instrument`` or,
            without one, for a set-up (``station/set``). Distances are means in both ways.

    Raises:
        InputError: all problems: those of `checked_readings`; a constant part of σ that is not
            greater than zero; centring together with both faces, which share it, so that two
            observations would count it as independent.
    """
    sigmas = _Sigmas(sigma_direction, sigma_zenith, sigma_distance)
    problems = sigmas.problems(faces)
    try:
        given = checked_readings(readings)
    except InputError as error:
        problems += error.problems
    if problems:
        raise InputError(problems)
    groups: dict[tuple[str, str], dict[str, TargetReadings]] = defaultdict(
        lambda: defaultdict(dict)
    )
    for r in given:
        groups[r.station, r.set][r.target][r.face or 1] = r
    observations: list[Observation] = []
    setups: list[SetUp] = []
    found: list[_Doubted] = []
    doubted: list[tuple[int, ...]] = []
    for (station, number), targets in groups.items():
        doubts: list[_Doubted] = []
        index = _errors(targets, "zenith", constant_part(sigma_zenith), doubts)
        collimation = _errors(targets, "direction", constant_part(sigma_direction), doubts)
        large = list(_large(station, number, index[0], collimation[0]))
        # In another unit no two faces agree: the unit is the reason, and is reported alone.
        doubts = large[:1] if _unit(index[0]) else [*doubts, *large]
        doubts += _distances(targets, constant_part(sigma_distance))
        both = sum(len(t) == 2 for t in targets.values())
        setups.append(SetUp(station, number, both, *index, *collimation))
        begin = len(observations)
        for target in targets.values():
            if faces == "both":
                observations += _as_read(target, sigmas)
            else:
                observations += _means(target, index, collimation, sigmas)
            observations += _distance(target, sigmas.distance)
        of_setup = list(enumerate(observations[begin:], start=begin))
        doubted += (tuple(i for i, o in of_setup if d.concerns(o)) for d in doubts)
        found += doubts
    problems = [d.problem for d in found]
    return ReducedFaces(tuple(observations), tuple(setups), tuple(problems), tuple(doubted))


def _in_one_face(
    faces: Mapping[tuple[VariableKind, str], Mapping[tuple[str, ...], set[int]]],
) -> Iterator[Doubt]:
    """Iterate over free errors of circles for which no target was read in both faces."""
    for (kind, name), of_targets in faces.items():
        if all(len(read) == 1 for read in of_targets.values()):
            noun = UNKNOWNS[kind].noun
            text = (
                "no target was read in both faces: only the geometry of the network determines "
                f"this {noun}; read targets in both faces, weight or hold it, or use means"
            )
            yield Doubt(text, f"{noun} {name!r}")


@dataclass(frozen=True)
class _Doubted:
    """A doubt, and the readings of the set-up that it is about."""

    problem: Problem
    kind: str = ""
    """Kind of the observations made from them."""
    targets: tuple[str, ...] = ()
    """Their targets; empty for the whole set-up."""

    def concerns(self, o: Observation) -> bool:
        """Return whether an observation of the set-up is made from these readings."""
        return o.kind == self.kind and getattr(o, "target", None) in self.targets


def constant_part(sigma: SigmaOfReading) -> float:
    """Return the constant part of a standard deviation."""
    return sigma.constant if isinstance(sigma, StandardDeviation) else float(sigma)


def _with_constant(sigma: SigmaOfReading, own: float) -> SigmaOfReading:
    """Return a standard deviation with another constant part."""
    return replace(sigma, constant=own) if isinstance(sigma, StandardDeviation) else own


@dataclass(frozen=True)
class _Sigmas:
    """Standard deviations of readings in one face."""

    direction: SigmaOfReading
    zenith: SigmaOfReading
    distance: SigmaOfReading

    def problems(self, faces: FacesChoice) -> list[Problem]:
        """Return what is wrong with them."""
        out = []
        if faces not in ("means", "both"):
            out.append(Problem(f"unknown faces {faces!r}; valid: means, both"))
        for f in fields(self):
            sigma = getattr(self, f.name)
            if not constant_part(sigma) > 0:
                of = "the constant part of " * isinstance(sigma, StandardDeviation)
                what = f"{of}sigma_{f.name} must be greater than zero, not {constant_part(sigma)}"
                out.append(Problem(what))
            shared = isinstance(sigma, StandardDeviation) and f.name != "distance"
            if faces == "both" and shared:
                what = (
                    f"sigma_{f.name} has centring, which the two faces of a target share: "
                    "observations of both faces would count it as independent; use means, or a σ "
                    "without centring"
                )
                out.append(Problem(what))
        return out


def _large(station: str, number: str, index: float, collimation: float) -> Iterator[_Doubted]:
    """Iterate over errors of the instrument that it cannot have."""
    for noun, value in (("index", index), ("collimation", collimation)):
        if abs(value) > MAX_CIRCLE_ERROR_RAD:
            text = f"the two faces give {noun} {value * 200 / pi:.3f} gon"
            text += _unit(value) * (noun == "index")
            yield _Doubted(Problem(text, f"station {station!r}, set {number!r}"))


def _unit(index: float) -> str:
    """Return the unit in which an index error is none: both faces add up to a full circle."""
    for read, stated, ratio in (("gon", "degrees", 10 / 9), ("degrees", "gon", 9 / 10)):
        if abs(index - pi * (ratio - 1.0)) < MAX_CIRCLE_ERROR_RAD:
            return f": both add up to a circle of {read}, not of {stated}; state their unit"
    return ""


def _distances(targets: dict[str, TargetReadings], sigma: float) -> Iterator[_Doubted]:
    """Iterate over targets whose distances in the two faces differ by more than chance allows."""
    for name, faces in targets.items():
        one, two = (getattr(faces.get(f), "distance", None) for f in (1, 2))
        limit = TOLERANCE_IN_SIGMAS * sigma * sqrt(2.0)
        if one is not None and two is not None and abs(one - two) > limit:
            first = faces[1]
            text = (
                f"its distances differ by {1e3 * (two - one):.1f} mm, tolerance "
                f"{1e3 * limit:.1f} mm"
            )
            where = f"station {first.station!r}, set {first.set!r}, target {name!r}"
            yield _Doubted(Problem(text, where), SlopeDistance.kind, (name,))


def _wrapped(angle: float) -> float:
    """Return an angle in (−π, π]."""
    return float(wrap(np.asarray(angle)))


def _zenith(faces: TargetReadings) -> float:
    """Return the zenith angle of a target as far as it is known; π/2 without a reading."""
    read = {f: r.zenith for f, r in faces.items() if r.zenith is not None}
    values = [z if f == 1 else 2 * pi - z for f, z in read.items()]
    return sum(values) / len(values) if values else pi / 2


def _errors(
    targets: dict[str, TargetReadings],
    what: str,
    sigma: float,
    doubts: list[_Doubted],
) -> tuple[float, float]:
    """Return index or collimation error of a set-up and its σ; add targets that do not agree."""
    found: dict[str, tuple[float, float]] = {}
    for name, faces in targets.items():
        one, two = (getattr(faces.get(f), what, None) for f in (1, 2))
        if one is None or two is None:
            continue
        steep = sin(_zenith(faces))
        if what == "zenith":
            found[name] = 0.5 * _wrapped(one + two), 1.0
        elif steep > 0.0:
            found[name] = 0.5 * _wrapped(two - one - pi) * steep, steep
    if not found:
        return np.nan, np.nan
    value = np.array([v for v, _ in found.values()])
    own = sigma / sqrt(2.0) * np.array([s for _, s in found.values()])
    weight = 1.0 / np.square(own)
    names, noun, gon = list(found), "index" if what == "zenith" else "collimation", 200e3 / pi
    kind = ZenithAngle.kind if what == "zenith" else Direction.kind
    for i, rest, limit in _outlying(value, weight):
        first = next(iter(targets[names[i]].values()))
        text = (
            f"its two faces give {noun} {value[i] * gon:.1f} mgon, the others "
            f"{rest * gon:.1f} mgon, tolerance {limit * gon:.1f} mgon"
        )
        where = f"station {first.station!r}, set {first.set!r}, target {names[i]!r}"
        # Of two values that differ, either may be the wrong one.
        wrong = (names[i],) if len(names) > 2 else tuple(names)
        doubts.append(_Doubted(Problem(text, where), kind, wrong))
    return float(weight @ value / weight.sum()), 1.0 / sqrt(float(weight.sum()))


def _outlying(value: Array, weight: Array) -> Iterator[tuple[int, float, float]]:
    """Yield values that differ from the mean of the others, that mean, and the tolerance.

    The worst one no longer takes part in the mean with which the next ones are compared. Of two
    values nobody knows which is the wrong one: both are.
    """
    left = list(range(len(value)))
    while len(left) > 1:
        v, w = value[left], weight[left]
        others = w.sum() - w
        rest = (w @ v - w * v) / others
        limit = TOLERANCE_IN_SIGMAS * np.sqrt(1.0 / w + 1.0 / others)
        times = np.abs(v - rest) / limit
        worst = int(times.argmax())
        if not times[worst] > 1.0:
            return
        named = range(2) if len(left) == 2 else [worst]
        yield from ((left[k], float(rest[k]), float(limit[k])) for k in named)
        if len(left) == 2:
            return
        del left[worst]


def _of_sight(r: FaceReading) -> dict[str, Any]:
    """Return what all observations of a sight share."""
    return {
        "station": r.station,
        "target": r.target,
        "instrument_height": r.instrument_height,
        "target_height": r.target_height,
        "source": r.source,
    }


def _read(target: TargetReadings, what: str) -> dict[int, float]:
    """Return the readings of a circle by face."""
    return {f: getattr(r, what) for f, r in target.items() if getattr(r, what) is not None}


def _distance(target: TargetReadings, sigma: SigmaOfReading) -> Iterator[Observation]:
    """Yield the mean of the distances of a target, if there is one."""
    first = next(iter(target.values()))
    lengths = list(_read(target, "distance").values())
    if lengths:
        n = len(lengths)
        own = _with_constant(sigma, constant_part(sigma) / sqrt(n))
        of_sight = {**_of_sight(first), "instrument": first.distance_meter}
        yield SlopeDistance(value=sum(lengths) / n, sigma=own, **of_sight)


def _as_read(target: TargetReadings, sigmas: _Sigmas) -> Iterator[Observation]:
    """Yield every reading of a target as an observation that knows its face."""
    for face, r in sorted(target.items()):
        of_sight = {**_of_sight(r), "face": face}
        name = r.instrument or f"{r.station}/{r.set}"
        if r.direction is not None:
            yield Direction(
                value=r.direction % (2 * pi),
                sigma=sigmas.direction,
                set=r.set,
                collimation_error=name,
                **of_sight,
            )
        if r.zenith is not None:
            yield ZenithAngle(
                value=r.zenith,
                sigma=sigmas.zenith,
                refraction=r.refraction,
                index_error=name,
                **of_sight,
            )


def _means(
    target: TargetReadings,
    index: tuple[float, float],
    collimation: tuple[float, float],
    sigmas: _Sigmas,
) -> Iterator[Observation]:
    """Yield direction and zenith angle of a target, the means of its faces."""
    first = next(iter(target.values()))
    if read := _read(target, "direction"):
        steep = sin(_zenith(target))
        value, own = _direction(read, collimation, steep, constant_part(sigmas.direction))
        sigma = _with_constant(sigmas.direction, own)
        yield Direction(value=value % (2 * pi), sigma=sigma, set=first.set, **_of_sight(first))
    if read := _read(target, "zenith"):
        value, own = _of_zenith(read, index, constant_part(sigmas.zenith))
        sigma = _with_constant(sigmas.zenith, own)
        yield ZenithAngle(value=value, sigma=sigma, refraction=first.refraction, **_of_sight(first))


def _direction(
    read: dict[int, float], collimation: tuple[float, float], steep: float, sigma: float
) -> tuple[float, float]:
    if len(read) == 2:
        return read[1] + 0.5 * _wrapped(read[2] - read[1] - pi), sigma / sqrt(2.0)
    ((face, value),) = read.items()
    value -= pi * (face - 1)
    c, own = collimation
    if np.isnan(c) or not steep > 0.0:
        return value, sigma
    return value + (c if face == 1 else -c) / steep, hypot(sigma, own / steep)


def _of_zenith(
    read: dict[int, float], index: tuple[float, float], sigma: float
) -> tuple[float, float]:
    if len(read) == 2:
        return 0.5 * (read[1] - read[2]) + pi, sigma / sqrt(2.0)
    ((face, value),) = read.items()
    i, own = index
    free = value if np.isnan(i) else value - i
    zenith = free if face == 1 else 2 * pi - free
    # Next to the zenith the index error may lead to its other side: it is as near as that.
    return min(max(zenith, 0.0), pi), (sigma if np.isnan(i) else hypot(sigma, own))
