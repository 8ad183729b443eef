"""Units of circles of instruments in frames of their own, told by the places that they sight.

Angles in a wrong unit bend the places of a frame, so that no similarity carries them to those of
other frames or to the given coordinates. With the angles in the right unit one does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...approximate.in_frames import SIGHTED, Sights, read_sights
from ...errors import known
from ...graph.equations import Equations
from ...models.frame_sights import place_of_sight
from ...observations import KINDS
from ...types import Array
from ...units import ANGLE, decimal_angle
from .finding import Finding
from .given_units import NOUNS
from .similar import System, common

BETTER = 20.0
"""How many times better places must fit with angles in another unit for it to be told."""
CIRCLES: tuple[tuple[tuple[int, ...], str], ...] = (
    ((0, 1), "directions and zenith angles"),
    ((0,), "directions"),
    ((1,), "zenith angles"),
)
"""Columns of `Sights.value` that are tried in another unit, and their name."""


def wrong_circles(
    equations: Equations, systems: Sequence[System], angle: str
) -> tuple[set[str], list[Finding]]:
    """Return the names of frames with angles in a wrong unit, and what to say of them.

    Args:
        equations: the network.
        systems: places in frames, and the given coordinates.
        angle: unit of angles in the files.
    """
    sights = read_sights(equations)
    names = equations.unknowns["frame"].names
    named: set[str] = set()
    findings = []
    for f in np.unique(sights.frame[sights.whole]).tolist():
        own = f"frame {names[f]!r}"
        system = next((s for s in systems if s.name == own), None)
        others = [s for s in systems if s.name != own]
        if system is None:
            continue
        now = _misfits(system, others)
        best, told = 1.0 / BETTER, None
        for columns, what, unit, changed in _changed(sights, f, system, angle):
            left = _misfits(changed, others)
            shares = {n: left[n] / max(now[n], 1e-300) for n in now if n in left}
            share = float(np.median(list(shares.values()))) if shares else np.inf
            if share < best:
                best, told = share, (columns, what, unit, list(shares))
        if told is None:
            continue
        columns, what, unit, against = told
        stated = NOUNS.get(decimal_angle(angle), decimal_angle(angle))
        named.add(own)
        findings.append(
            Finding(
                f"the places of {own} fit those of {known(against)} {1.0 / best:.0f} times better "
                f"with its {what} in {NOUNS[unit]}, not in {stated}",
                "state the unit in which they were read",
                ids=_ids(equations, names[f], columns),
            )
        )
    return named, findings


def _changed(
    sights: Sights, f: int, system: System, angle: str
) -> Iterator[tuple[tuple[int, ...], str, str, System]]:
    """Iterate over the places of a frame with some of its angles in other units."""
    stated = decimal_angle(angle)
    rows = np.flatnonzero((sights.frame == f) & sights.whole & np.isin(sights.point, system.keys))
    at = np.searchsorted(system.keys, sights.point[rows])
    for unit in NOUNS:
        if unit == stated:
            continue
        for columns, what in CIRCLES:
            value: Array = sights.value[rows].copy()
            value[:, columns] *= ANGLE[unit] / ANGLE[stated]
            x = system.x.copy()
            x[at] = place_of_sight(*value.T)
            yield columns, what, unit, replace(system, x=x)


def _misfits(system: System, others: Sequence[System]) -> dict[str, float]:
    """Return the root mean square misfit to each other system that controls the places."""
    found = ((o.name, common(system, o, rough=True)) for o in others)
    return {n: p.fitted().rms for n, p in found if p is not None and len(p.a) > p.size}


def _ids(equations: Equations, frame: str, columns: Sequence[int]) -> tuple[str, ...]:
    """Return the ids of the readings of some circles in a frame."""
    read = {SIGHTED[c] for c in columns}
    observed = equations.network.observations.items()
    return tuple(i for i, o in observed if frame in o.frames() and KINDS[o.kind].tells in read)
