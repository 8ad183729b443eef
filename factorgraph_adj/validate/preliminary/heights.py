"""Heights of instruments and targets that differ, or are missing, within a set-up."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

from ...network.network import Network
from ...observations import (
    Direction,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    VerticalAngle,
)
from .finding import Finding

MOST = 0.5
"""Part of the set-ups whose heights must differ, and be the same exchanged, to be exchanged."""


def exchanged_heights(network: Network) -> Iterator[Finding]:
    """Find the heights of instruments and targets exchanged: whole columns of them.

    An instrument stands at one height while it turns to targets of several heights. Exchanged, the
    height of the instrument changes from sight to sight, and that of all targets is the same.
    """
    setups, _ = _set_ups(network)
    seen = [
        tuple({getattr(o, f"{name}_height") for o in readings} for name in ("instrument", "target"))
        for readings in setups.values()
        if len(readings) > 1
    ]
    differ = [targets for instruments, targets in seen if len(instruments) > 1]
    if len(differ) < 2 or len(differ) < MOST * len(seen):
        return
    if any(len(targets) > 1 for _, targets in seen) or not any(any(t) for t in differ):
        return
    yield Finding(
        f"at {len(differ)} of {len(seen)} stations the height of the instrument changes from sight "
        "to sight, and that of all targets is the same: the heights of instruments and targets are "
        "exchanged",
        "exchange the columns instrument_height and target_height",
    )


def heights(network: Network) -> Iterator[Finding]:
    """Iterate over set-ups with several heights of the instrument, or with some missing."""
    setups, sets = _set_ups(network)
    for (station, number), readings in setups.items():
        counts = Counter(o.instrument_height for o in readings)  # type: ignore[attr-defined]
        if len(counts) < 2:
            continue
        usual, _ = counts.most_common(1)[0]
        others = [o for o in readings if o.instrument_height != usual]  # type: ignore[attr-defined]
        where = f"station {station!r}" + (f", set {number!r}" if len(sets[station]) > 1 else "")
        missing = all(o.instrument_height == 0.0 for o in others)  # type: ignore[attr-defined]
        told = "no height of the instrument" if missing else "another height of the instrument"
        first = others[0]
        yield Finding(
            f"{len(others)} of {len(readings)} readings at {where} have {told} than the usual "
            f"{usual:g} m, the first {first.label()} ({first.instrument_height:g} m)"  # type: ignore[attr-defined]
            if not missing
            else f"{len(others)} of {len(readings)} readings at {where} have {told}, the others "
            f"{usual:g} m; the first is {first.label()}",
            "give the height that was measured, or another set to another set-up",
        )


def _set_ups(
    network: Network,
) -> tuple[dict[tuple[str, str], list[Observation]], dict[str, set[str]]]:
    """Return the readings of set-ups by station and set, and the sets of stations.

    The readings of a set of directions belong to one set-up. Other readings at a station count to
    its set-up if it has one set. Directions without heights, as formats have them that give heights
    to distances and zenith angles alone, are no doubt: they do not depend on heights.
    """
    setups: dict[tuple[str, str], list[Observation]] = defaultdict(list)
    sets: dict[str, set[str]] = defaultdict(set)
    for o in network.observations.values():
        if isinstance(o, Direction):
            sets[o.station].add(o.set)
            if o.instrument_height != 0.0:
                setups[o.station, o.set].append(o)
    for o in network.observations.values():
        if isinstance(o, SlopeDistance | VerticalAngle) and not isinstance(o, HorizontalDistance):
            mine = sets[o.station]
            if len(mine) <= 1:
                setups[o.station, next(iter(mine), "")].append(o)
    return setups, sets
