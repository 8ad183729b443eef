"""Readings in two faces of a total station, reduced to means, index errors and collimation errors.

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
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import hypot, pi, sin, sqrt
from typing import Any

import numpy as np

from ..errors import InputError, Problem
from ..models.base import wrap
from ..observations import Direction, Observation, SlopeDistance, ZenithAngle
from ..shown import Rows, Shown

LARGE = 0.2 * pi / 200.0
"""Index or collimation error beyond which a set-up is doubted whatever its targets say: 0.2 gon.
An instrument in order has less; readings of two targets, or of a circle that was turned, more."""
TIMES = 3.29
"""Tolerance of a difference, in its standard deviations: exceeded by chance once in 1000."""


@dataclass(frozen=True, kw_only=True)
class FaceReading:
    """One sight in one face, as it stands in the field book."""

    station: str
    """Point of the instrument."""
    target: str
    """Point of the target."""
    face: int
    """1 or 2."""
    direction: float | None = None
    """Horizontal reading, radians."""
    zenith: float | None = None
    """Zenith reading, radians: from 0 to π in face 1, from π to 2π in face 2."""
    distance: float | None = None
    """Slope distance, metres."""
    set: str = "1"
    """Set of the readings; the sets of a station are set-ups of their own."""
    instrument_height: float = 0.0
    """Height of the instrument, metres."""
    target_height: float = 0.0
    """Height of the target, metres."""
    source: str | None = None
    """File and line from which the reading was read."""

    def label(self) -> str:
        """Return a readable name."""
        text = f"{self.station} – {self.target}, face {self.face}"
        return f"{self.source}: {text}" if self.source else text


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
    sigma_direction: float,
    sigma_zenith: float,
    sigma_distance: float,
) -> ReducedFaces:
    """Reduce readings in two faces to observations.

    Args:
        readings: the field book.
        sigma_direction: standard deviation of a horizontal reading in one face, radians.
        sigma_zenith: standard deviation of a zenith reading in one face, radians.
        sigma_distance: standard deviation of a distance, metres; the mean of two has σ/√2.

    Raises:
        InputError: a face that is neither 1 nor 2, a zenith reading that belongs to the other
            face, a target read twice in a face of a set, σ that are not greater than zero: all.
    """
    given = list(readings)
    _refuse(given, (sigma_direction, sigma_zenith, sigma_distance))
    groups: dict[tuple[str, str], dict[str, dict[int, FaceReading]]] = defaultdict(
        lambda: defaultdict(dict)
    )
    for r in given:
        groups[r.station, r.set][r.target][r.face] = r
    observations: list[Observation] = []
    setups: list[SetUp] = []
    doubts: list[Problem] = []
    for (station, number), targets in groups.items():
        index = _errors(targets, "zenith", sigma_zenith, doubts)
        collimation = _errors(targets, "direction", sigma_direction, doubts)
        doubts += _large(station, number, index[0], collimation[0])
        doubts += _distances(targets, sigma_distance)
        both = sum(len(t) == 2 for t in targets.values())
        setups.append(SetUp(station, number, both, *index, *collimation))
        for faces in targets.values():
            observations += _observations(
                faces, index, collimation, (sigma_direction, sigma_zenith, sigma_distance)
            )
    return ReducedFaces(tuple(observations), tuple(setups), tuple(doubts))


def _refuse(given: Sequence[FaceReading], sigmas: tuple[float, float, float]) -> None:
    problems: list[Problem] = []
    names = ("sigma_direction", "sigma_zenith", "sigma_distance")
    for name, sigma in zip(names, sigmas, strict=True):
        if not sigma > 0:
            problems.append(Problem(f"{name} must be greater than zero, not {sigma}"))
    seen: set[tuple[str, str, str, int]] = set()
    heights: dict[tuple[str, str, str], tuple[float, float]] = {}
    for r in given:
        if r.face not in (1, 2):
            problems.append(Problem(f"the face must be 1 or 2, not {r.face!r}", r.label()))
            continue
        key = (r.station, r.set, r.target, r.face)
        if key in seen:
            what = "is read twice in this face: give the second reading another set"
            problems.append(Problem(what, r.label()))
        seen.add(key)
        own = r.instrument_height, r.target_height
        if heights.setdefault(key[:3], own) != own:
            what = "its heights differ from those of the other face: give it another set"
            problems.append(Problem(what, r.label()))
        if r.zenith is not None and not (r.face - 1) * pi <= r.zenith <= r.face * pi:
            what = f"a zenith reading of {r.zenith * 200 / pi:.4f} gon belongs to the other face"
            problems.append(Problem(what, r.label()))
    if problems:
        raise InputError(problems)


def _large(station: str, number: str, index: float, collimation: float) -> Iterator[Problem]:
    """Iterate over errors of the instrument that it cannot have."""
    for noun, value in (("index", index), ("collimation", collimation)):
        if abs(value) > LARGE:
            text = f"the two faces give {noun} {value * 200 / pi:.3f} gon: look at its readings"
            yield Problem(text, f"station {station!r}, set {number!r}")


def _distances(targets: dict[str, dict[int, FaceReading]], sigma: float) -> Iterator[Problem]:
    """Iterate over targets whose distances in the two faces differ by more than chance allows."""
    for name, faces in targets.items():
        one, two = (getattr(faces.get(f), "distance", None) for f in (1, 2))
        limit = TIMES * sigma * sqrt(2.0)
        if one is not None and two is not None and abs(one - two) > limit:
            first = faces[1]
            text = (
                f"its distances differ by {1e3 * (two - one):.1f} mm, tolerance "
                f"{1e3 * limit:.1f} mm: look at them"
            )
            where = f"station {first.station!r}, set {first.set!r}, target {name!r}"
            yield Problem(text, where)


def _wrapped(angle: float) -> float:
    """Return an angle in (−π, π]."""
    return float(wrap(np.asarray(angle)))


def _zenith(faces: dict[int, FaceReading]) -> float:
    """Return the zenith angle of a target as far as it is known; π/2 without a reading."""
    read = {f: r.zenith for f, r in faces.items() if r.zenith is not None}
    values = [z if f == 1 else 2 * pi - z for f, z in read.items()]
    return sum(values) / len(values) if values else pi / 2


def _errors(
    targets: dict[str, dict[int, FaceReading]],
    what: str,
    sigma: float,
    doubts: list[Problem],
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
    mean, total = float(weight @ value / weight.sum()), float(weight.sum())
    noun = "index" if what == "zenith" else "collimation"
    for i, name in enumerate(found):
        if len(found) < 2:
            break
        others = total - weight[i]
        rest = (mean * total - weight[i] * value[i]) / others
        limit = TIMES * hypot(float(own[i]), 1.0 / sqrt(others))
        if abs(value[i] - rest) > limit:
            first = next(iter(targets[name].values()))
            gon = 200e3 / pi
            text = (
                f"its two faces give {noun} {value[i] * gon:.1f} mgon, the others "
                f"{rest * gon:.1f} mgon, tolerance {limit * gon:.1f} mgon: look at its readings"
            )
            where = f"station {first.station!r}, set {first.set!r}, target {name!r}"
            doubts.append(Problem(text, where))
    return mean, 1.0 / sqrt(total)


def _observations(
    faces: dict[int, FaceReading],
    index: tuple[float, float],
    collimation: tuple[float, float],
    sigmas: tuple[float, float, float],
) -> list[Observation]:
    """Return the observations of a target."""
    first = next(iter(faces.values()))
    heights: dict[str, Any] = {
        "instrument_height": first.instrument_height,
        "target_height": first.target_height,
        "source": first.source,
    }
    out: list[Observation] = []
    z = _zenith(faces)
    read = {f: r.direction for f, r in faces.items() if r.direction is not None}
    if read:
        value, sigma = _direction(read, collimation, sin(z), sigmas[0])
        ends = (first.station, first.target)
        out.append(Direction(*ends, value % (2 * pi), sigma=sigma, set=first.set, **heights))
    read = {f: r.zenith for f, r in faces.items() if r.zenith is not None}
    if read:
        value, sigma = _of_zenith(read, index, sigmas[1])
        out.append(ZenithAngle(first.station, first.target, value, sigma=sigma, **heights))
    lengths = [r.distance for r in faces.values() if r.distance is not None]
    if lengths:
        mean, sigma = sum(lengths) / len(lengths), sigmas[2] / sqrt(len(lengths))
        out.append(SlopeDistance(first.station, first.target, mean, sigma=sigma, **heights))
    return out


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
