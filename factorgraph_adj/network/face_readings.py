"""Readings in one face of a total station as the field book has them; checks of their faces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import pi

from ..constructors import ChecksArguments
from ..errors import InputError, Problem

FULL_CIRCLE_RAD = 2 * pi * (1.0 + 1e-9)
"""The full circle with what rounding adds, radians; 400 gon is a valid reading."""


@dataclass(frozen=True, kw_only=True)
class FaceReading(metaclass=ChecksArguments):
    """One sight in one face, as it is in the field book."""

    station: str
    """Point of the instrument."""
    target: str
    """Point of the target."""
    face: int | None = None
    """1 or 2; None: the zenith reading determines it."""
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
    instrument: str | None = None
    """Instrument whose index and collimation error the set-up shares with its other set-ups, where
    both readings are kept; None: the set-up has its own."""
    distance_meter: str | None = None
    """Name of the distance meter with scale and zero constant; None: both are 0."""
    refraction: str | None = None
    """Name of the refraction group; None: the group of the whole network."""
    source: str | None = None
    """File and line from which the reading was read."""

    def label(self) -> str:
        """Return a readable name."""
        face = "" if self.face is None else f", face {self.face}"
        text = f"{self.station} – {self.target}, set {self.set}{face}"
        return f"{self.source}: {text}" if self.source else text


def checked_readings(readings: Iterable[FaceReading]) -> list[FaceReading]:
    """Return readings with their faces.

    Raises:
        InputError: all problems of readings: a face that is neither 1 nor 2 or that nothing
            determines, a zenith reading of the other face or beyond the circle, nothing read, a
            target read twice in a face of a set, and what differs between the two faces of a
            target.
    """
    problems: list[Problem] = []
    out = []
    seen: dict[tuple[str, str, str, int], FaceReading] = {}
    first: dict[tuple[str, str, str], FaceReading] = {}
    for given in readings:
        what, r = _face(given)
        if r.direction is None and r.zenith is None and r.distance is None:
            what.append("nothing is read: give a direction, a zenith reading or a distance")
        if not what:
            key = (r.station, r.set, r.target)
            if (*key, r.face or 0) in seen:
                other = seen[*key, r.face or 0].source
                at = f" (first in {other})" if other else ""
                what.append(f"is read twice in this face{at}: give the second reading another set")
            seen.setdefault((*key, r.face or 0), r)
            what += _differences(r, first.setdefault(key, r))
        problems += [Problem(text, r.label()) for text in what]
        out.append(r)
    if problems:
        raise InputError(problems)
    return out


def _face(r: FaceReading) -> tuple[list[str], FaceReading]:
    """Return what is wrong with the face of a reading, and the reading with its face."""
    for noun, value in (("zenith", r.zenith), ("direction", r.direction)):
        low = 0.0 if noun == "zenith" else -FULL_CIRCLE_RAD
        if value is not None and not low <= value <= FULL_CIRCLE_RAD:
            degrees = f"{value * 180 / pi:.4f}"
            what = f"a {noun} reading lies between 0 and 400 gon, not at {_gon(value)} gon"
            what += f" (in degrees: 0 and 360, {degrees})"
            return [f"{what}: state the unit in which it was read"], r
    if r.face is None:
        if r.zenith is None:
            return ["the face is missing: give 1 or 2, or a zenith reading, which implies it"], r
        return [], replace(r, face=1 if r.zenith <= pi else 2)
    if r.face not in (1, 2):
        return [f"the face must be 1 or 2, not {r.face!r}"], r
    if r.zenith is not None and not (r.face - 1) * pi <= r.zenith <= r.face * pi:
        return [f"a zenith reading of {_gon(r.zenith)} gon belongs to the other face"], r
    return [], r


def _gon(angle: float) -> str:
    return f"{angle * 200 / pi:.4f}"


def _differences(r: FaceReading, other: FaceReading) -> list[str]:
    """Return what of a reading must be that of the other face, and is not."""
    both = ("instrument_height", "target_height", "instrument", "distance_meter", "refraction")
    differ = [name for name in both if getattr(r, name) != getattr(other, name)]
    nouns = ["heights" if n.endswith("height") else n.replace("_", " ") for n in differ]
    return [
        f"its {noun} differ{'s' * (noun != 'heights')} from those of the other face: give it "
        "another set"
        for noun in dict.fromkeys(nouns)
    ]
