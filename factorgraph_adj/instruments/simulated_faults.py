"""Faults of a simulated total station and movements of its object, switched on by words.

    gross-error target=D3 reading=zenith size_mgon=10 at=2h
    displacement point=D5 dy_mm=-4

A fault begins at once, or ``at`` a time after the begin of the simulation, and lasts for its own
number of sights or lines, or for ``length``. `FAULTS` has the words.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError, Problem, known
from ..units import ANGLE, LENGTH
from .instrument_settings import duration

READINGS = ("direction", "zenith", "distance")
MOVES = {f"d{axis}_mm": LENGTH["mm"] for axis in "xyz"}
"""Fields of a movement, and metres of their unit."""
NUMBERS = {
    "size_mgon": ANGLE["mgon"],
    "size_mm": LENGTH["mm"],
    "size": 1.0,
    "sights": 1.0,
    "lines": 1.0,
    **MOVES,
}
"""Fields of numbers, and the SI size of their unit."""
NAMES = ("target", "read", "point")
DURATIONS = ("at", "length", "jump")


@dataclass(frozen=True)
class FaultKind:
    """A sort of fault."""

    what: str
    """What it does, in words."""
    needed: tuple[str, ...] = ()
    """Fields that it must have."""
    usual: Mapping[str, Any] = field(default_factory=dict)
    """Fields that it may have, with the values of absent ones."""
    moves: bool = False
    """Whether the object moves, and not the instrument that errs."""


FAULTS = {
    "gross-error": FaultKind(
        "the next readings of a target in either face are off by size_mgon or size_mm",
        ("target", "reading"),
        {"size_mgon": 0.0, "size_mm": 0.0, "sights": 1.0},
    ),
    "wrong-target": FaultKind(
        "the next sights of a target read another one", ("target", "read"), {"sights": 2.0}
    ),
    "refraction": FaultKind(
        "the coefficient of refraction is larger by size", ("size",), {"length": 0.0}
    ),
    "clock-jump": FaultKind("the clock of the instrument jumps by a duration", ("jump",)),
    "doubled": FaultKind("the next lines are sent twice", (), {"lines": 1.0}),
    "garbage": FaultKind("the next lines arrive damaged", (), {"lines": 1.0}),
    "gap": FaultKind("nothing is measured for some time", ("length",)),
    "outage": FaultKind(
        "there is no connection for some time; what was measured then is sent afterwards",
        ("length",),
    ),
    "displacement": FaultKind(
        "a point moves at once", ("point",), dict.fromkeys(MOVES, 0.0), moves=True
    ),
    "creep": FaultKind(
        "a point moves by so much each day", ("point",), dict.fromkeys(MOVES, 0.0), moves=True
    ),
}
"""Faults by their words."""


@dataclass
class Fault:
    """A fault that is switched on."""

    word: str
    begin: float
    """Simulated time, seconds since 1970 UTC."""
    values: dict[str, Any]
    """Its fields, in SI."""
    left: int = 0
    """Sights or lines that it still concerns."""

    @property
    def length(self) -> float:
        """Seconds that it lasts; infinite where it has no end."""
        return float(self.values.get("length") or float("inf"))

    def is_on(self, time: float) -> bool:
        """Return whether a time is within it."""
        return self.begin <= time < self.begin + self.length


def parse_fault(text: str) -> tuple[str, dict[str, str]]:
    """Return word and fields of a fault.

    Raises:
        InputError: a field has no ``=``, or stands twice.
    """
    word, *rest = text.split() or [""]
    fields: dict[str, str] = {}
    for part in rest:
        name, sign, value = part.partition("=")
        if not sign or name in fields:
            raise InputError(Problem(f"{part!r} must be NAME=VALUE, each name once", word))
        fields[name] = value
    return word, fields


def fault(
    word: str,
    fields: Mapping[str, object],
    *,
    now: float,
    begin: float,
    targets: tuple[str, ...],
    points: tuple[str, ...],
) -> Fault:
    """Return a fault.

    Args:
        word: one of `FAULTS`.
        fields: its fields, texts or numbers in the units of their names.
        now: simulated time, at which it begins without ``at``.
        begin: simulated time at which the simulation began.
        targets: names of the targets of the instrument.
        points: names of the points that can move.

    Raises:
        InputError: all problems.
    """
    if word not in FAULTS:
        raise InputError(f"unknown fault {word!r}; valid: {known(FAULTS, meant=word, most=20)}")
    kind, problems = FAULTS[word], list[Problem]()
    valid = ("at", *kind.needed, *kind.usual)
    values: dict[str, Any] = dict(kind.usual)
    for name, value in fields.items():
        if name not in valid:
            problems.append(Problem(f"unknown field {name!r}; valid: {known(valid, meant=name)}"))
            continue
        try:
            values[name] = _value(name, value, targets, points)
        except ValueError as error:
            problems.append(Problem(f"{name} {error}"))
    problems += [Problem(f"{name} is missing") for name in kind.needed if name not in fields]
    if word == "gross-error" and not problems:
        unit = "size_mm" if values["reading"] == "distance" else "size_mgon"
        if not values[unit]:
            problems.append(Problem(f"an error of a {values['reading']} needs {unit}"))
    if kind.moves and not problems and not any(values[m] for m in MOVES):
        problems.append(Problem(f"give one of {', '.join(MOVES)}"))
    if problems:
        raise InputError([p.at(word) for p in problems])
    at = values.pop("at", None)
    left = int(values.pop("sights", 0) or values.pop("lines", 0))
    return Fault(word, now if at is None else begin + at, values, left)


def _value(name: str, value: object, targets: tuple[str, ...], points: tuple[str, ...]) -> Any:
    """Return the value of a field; ValueError says what is wrong with it."""
    if name in DURATIONS:
        text = str(value) if not isinstance(value, int | float) else value
        return duration(text)
    if name in NUMBERS:
        try:
            return float(str(value)) * NUMBERS[name]
        except ValueError:
            raise ValueError(f"must be a number, not {value!r}") from None
    choices = {"reading": READINGS, "point": points}.get(name, targets)
    if value not in choices:
        raise ValueError(f"must be one of {known(choices, meant=value)}, not {value!r}")
    return value
