"""Which stations a job of SNAP adjusts: fixed, free, floated, rejected, and those it cannot locate.

Source: LINZ, SNAP help, "The fix command", and ``control.c``, ``autofix.c`` of the program (BSD-3).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from .snap_data_commands import POINT_KINDS
from .snap_job import SnapJob, StationStatement
from .snap_readings import SnapReading
from .snap_recoding import Colocation
from .snap_selections import station_test

PLAN, HEIGHT = "plan", "height"
PARTS = {"horizontal": (PLAN,), "2d": (PLAN,), "vertical": (HEIGHT,), "1d": (HEIGHT,)}
BOTH: tuple[str, ...] = (PLAN, HEIGHT)
_PLAN_READ, _HEIGHT_READ = "plan matters", "height matters"
_DISTANCE, _BEARING, _LATITUDE, _LONGITUDE, _HEIGHT = (
    "distance",
    "bearing",
    "latitude",
    "longitude",
    "height",
)
_ALL = frozenset((_LATITUDE, _LONGITUDE, _HEIGHT, _PLAN_READ, _HEIGHT_READ))
LOCATES: dict[str, frozenset[str]] = {
    **dict.fromkeys(("GB", "GX"), _ALL),
    **dict.fromkeys(("SD", "HD", "MD", "DR"), frozenset((_DISTANCE, _PLAN_READ, _HEIGHT_READ))),
    "ED": frozenset((_DISTANCE, _PLAN_READ)),
    **dict.fromkeys(("HA", "AZ", "PB"), frozenset((_BEARING, _PLAN_READ))),
    "ZD": frozenset((_HEIGHT, _PLAN_READ, _HEIGHT_READ)),
    **dict.fromkeys(("LV", "OH", "EH"), frozenset((_HEIGHT, _HEIGHT_READ))),
    "LT": frozenset((_LATITUDE, _PLAN_READ)),
    "LN": frozenset((_LONGITUDE, _PLAN_READ)),
}
"""What a reading says of the place of its stations, by kind."""


@dataclass
class Located:
    """What the readings of a station say of its place."""

    by: set[str] = field(default_factory=set)
    """Words of `LOCATES`."""
    seen_from: set[str] = field(default_factory=set)
    """Stations from which distances and bearings lead to it."""

    @property
    def in_plan(self) -> bool:
        """Whether they locate it in plan: both coordinates, polar, or from two stations."""
        polar = {_DISTANCE, _BEARING}
        from_two = bool(self.by & polar) and len(self.seen_from) > 1
        return {_LATITUDE, _LONGITUDE} <= self.by or polar <= self.by or from_two

    @property
    def in_height(self) -> bool:
        """Whether they locate it in height."""
        return _HEIGHT in self.by

    @property
    def without_effect(self) -> tuple[str, ...]:
        """The parts on which no reading depends, of which SNAP fixes the last automatically."""
        if _HEIGHT_READ not in self.by:
            return (HEIGHT,)
        return (PLAN,) if _PLAN_READ not in self.by else ()


@dataclass
class AdjustedStation:
    """How a station takes part."""

    adjusted: set[str] = field(default_factory=lambda: set(BOTH))
    """Parts that are adjusted."""
    floated: dict[str, float] = field(default_factory=dict)
    """Standard deviations of parts that are observed where they stand, metres."""
    rejected: bool = False
    """Whether a command rejects or ignores it."""
    unlocated: bool = False
    """Whether its readings do not locate it."""
    colocated: bool = False
    """Whether it is observed at the place of another station."""


def located_stations(readings: Iterable[SnapReading]) -> dict[str, Located]:
    """Return what readings that take part say, by code in capital letters."""
    out: dict[str, Located] = {}
    for r in readings:
        says = LOCATES[r.kind]
        if r.kind in POINT_KINDS:
            out.setdefault((r.target or r.station).upper(), Located()).by |= says
            continue
        ends = r.station.upper(), r.target.upper()
        for own, other in (ends, ends[::-1]):
            at = out.setdefault(own, Located())
            at.by |= says
            if says & {_DISTANCE, _BEARING}:
                at.seen_from.add(other)
    return out


def rejected_stations(job: SnapJob) -> dict[str, AdjustedStation]:
    """Return the stations of a job after the commands that reject some."""
    assert job.stations is not None
    out = {code: AdjustedStation() for code in job.stations.by_code}
    for statement in job.station_statements:
        if statement.command in ("reject", "ignore", "accept"):
            test = station_test(statement.at, statement.at.words, job.stations)
            for code, station in job.stations.by_code.items():
                if test(station):
                    out[code].rejected = statement.command != "accept"
    return out


def colocate(
    found: Sequence[Colocation],
    states: dict[str, AdjustedStation],
    located: dict[str, Located],
) -> None:
    """Let stations that are at one place have the readings of each other."""
    for c in found:
        states[c.code].colocated = True
        own, other = (located.setdefault(n, Located()) for n in (c.code, c.other))
        for a, b in ((other, own), (own, other)):
            a.by |= b.by
            a.seen_from |= b.seen_from


def settle(job: SnapJob, states: dict[str, AdjustedStation], located: dict[str, Located]) -> None:
    """Apply the commands that fix, free and float stations; find those that are not located."""
    assert job.stations is not None
    for statement in job.station_statements:
        if statement.command in ("fix", "free", "float"):
            _apply(job, statement, states, located)
    for code, state in states.items():
        if job.dimension == "1d" or job.mode == "data_check":
            state.adjusted.discard(PLAN)
        if job.dimension == "2d" or job.mode == "data_check":
            state.adjusted.discard(HEIGHT)
        if job.mode == "free" and job.dimension == "3d":
            state.adjusted, state.floated = set(BOTH), {}
        for part in set(state.floated) - state.adjusted:
            del state.floated[part]
        found = located.get(code, Located())
        unlocated = {
            part
            for part, there in ((PLAN, found.in_plan), (HEIGHT, found.in_height))
            if part in state.adjusted
            and part not in state.floated
            and not (there or state.colocated)
        }
        state.unlocated = bool(unlocated) and not state.rejected


def _apply(
    job: SnapJob,
    statement: StationStatement,
    states: dict[str, AdjustedStation],
    located: dict[str, Located],
) -> None:
    """Apply one command to its stations."""
    assert job.stations is not None
    words, parts, automatically, every = list(statement.at.words), BOTH, False, False
    while words and words[0].lower() in ("automatically", "all", "3d", *PARTS):
        word = words.pop(0).lower()
        if word == "automatically":
            automatically = True
        elif word == "all":
            every = True
        else:
            parts = PARTS.get(word, BOTH)
    if not words and not every:
        statement.at.wrong(f"{statement.command} needs stations, or all")
        return
    listed = (["all"] if every else []) + words
    test = station_test(statement.at, listed, job.stations)
    errors = {PLAN: statement.horizontal, HEIGHT: statement.vertical}
    for code, station in job.stations.by_code.items():
        if not test(station):
            continue
        state = states[code]
        chosen = set(parts)
        if automatically:
            chosen &= set(located.get(code, Located()).without_effect)
        for part in chosen:
            if statement.command == "fix":
                state.adjusted.discard(part)
                state.floated.pop(part, None)
            else:
                state.adjusted.add(part)
                state.floated.pop(part, None)
                if statement.command == "float":
                    state.floated[part] = errors[part]
