"""Frames in a left-handed network, frames stated level but tilted, circles in a wrong unit.

The axes of a frame may be left-handed, so that no rotation leads to those of the network; a frame
that is stated to be level may be tilted. Angles in a wrong unit bend the places of a frame, so that
no similarity carries them to those of other frames or to the given coordinates. With the angles in
the right unit one does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..errors import known
from ..graph.equations import Equations
from ..models.sub_frame import place_of_sight
from ..network.network import Network
from ..observations import KINDS, Observation
from ..start.frame_places import SIGHT_COMPONENTS, Sights, read_sights
from ..statistical_tests import chi2_upper_quantile
from ..types import Array
from ..units import ANGLE, decimal_angle
from .common_places import (
    ALPHA_OF_PLACES,
    GIVEN_COORDINATES,
    PlaceSimilarity,
    PlaceSystem,
    accusations,
    common_places,
)
from .findings import Finding
from .wrong_units import ANGLE_UNIT_NAMES

MIN_TILT_IMPROVEMENT = 5.0
"""How many times better places must fit with a tilt for it to be reported."""
MIN_TILT_RAD = 1e-3
"""Smallest tilt that is reported, radians: the horizons of places within six kilometres differ by
less, and levels of instruments are off by less."""
MIN_CIRCLE_IMPROVEMENT = 20.0
"""How many times better places must fit with angles in another unit for it to be reported."""
CIRCLE_COLUMNS: tuple[tuple[tuple[int, ...], str], ...] = (
    ((0, 1), "directions and zenith angles"),
    ((0,), "directions"),
    ((1,), "zenith angles"),
)
"""Columns of `Sights.value` that are tried in another unit, and their name."""


def left_handed_frames(network: Network) -> Iterator[Finding]:
    """Report frames with places that no rotation leads to, as the network is left-handed.

    The axes of a level frame are those of the horizon, east, north, up, whatever the axes of the
    network; those of any other frame are turned from the axes of the network.
    """
    if not network.frame.left_handed:
        return
    seen = {f for o in network.observations.values() if _places(o) for f in o.frames()}
    names = [n for n, frame in network.frames.items() if n in seen and not frame.constants[-1]]
    if names:
        yield Finding(
            f"the axes of the network are left-handed, and frames are not level: {known(names)}; "
            "no rotation leads from one to the other",
            "choose axes en, nw, ws or se of the network, or state that the frames are level",
        )


def _places(o: Observation) -> bool:
    """Return whether an observation is of a place in a frame of its own."""
    record = KINDS.get(o.kind)
    return record is not None and record.in_frame != "nothing"


def tilted_frames(
    systems: Sequence[PlaceSystem], given: PlaceSystem
) -> tuple[set[str], list[Finding]]:
    """Return the names of frames that are stated to be level and are not, and what to say of them.

    A frame is compared with the given coordinates in its horizon, and with other level frames. The
    given coordinates are right; of two frames, the one that more others contradict is meant.

    Args:
        systems: places in frames; those that are upright in a horizon are stated to be level.
        given: the given coordinates.
    """
    level = [s for s in systems if s.upright and s.horizon is not None]
    found: dict[tuple[str, str], float] = {}
    few: dict[tuple[str, str], float] = {}
    for number, first in enumerate(level):
        assert first.horizon is not None
        in_horizon = PlaceSystem(
            given.name, given.keys, given.x @ first.horizon.T, given.sigma, True, given.fixed_scale
        )
        for second in (*level[number + 1 :], in_horizon):
            pair = common_places(first, second)
            if pair is None or pair.size < 3 or len(pair.a) < pair.size:
                continue
            fit = pair.fitted()
            size = frame_tilt(fit)
            if (
                size > MIN_TILT_RAD
                and fit.rms * MIN_TILT_IMPROVEMENT < _upright_rms(fit)
                and _significant(fit)
            ):
                # A tilt makes three places fit of which the height of one is wrong.
                enough = len(pair.a) > pair.size
                (found if enough else few)[first.name, second.name] = size
    doubtful = {n for pair in found for n in pair}
    found |= {p: t for p, t in few.items() if GIVEN_COORDINATES in p and not doubtful.isdisjoint(p)}
    named: set[str] = set()
    findings = []
    for names, own in accusations(found):
        other = [n for p in own for n in p if n not in names]
        one = f"{names[0]} is" if len(names) == 1 else f"one of {' and '.join(names)} is"
        against = f"those of {known(other)}" if len(names) == 1 else "each other"
        findings.append(
            Finding(
                f"{one} stated to be level, but its places fit {against} only with a tilt",
                "state that it is not level and let its rotation free, or look for an instrument "
                "whose compensator was off",
                float(np.median(list(own.values()))) / ANGLE["mgon"],
                MIN_TILT_RAD / ANGLE["mgon"],
                "mgon",
            )
        )
        named |= set(names)
    return named, findings


def frame_tilt(fit: PlaceSimilarity) -> float:
    """Return the angle between the third axes of two systems, radians."""
    return float(np.arctan2(np.hypot(*fit.rotation[:2, 2]), fit.rotation[2, 2]))


def _significant(fit: PlaceSimilarity) -> bool:
    """Return whether a tilt is larger than chance makes it."""
    x, y = fit.rotation[:2, 2]
    about: Array = np.array([-y, x])  # t × e_z = (t_y, −t_x)
    covariance = fit.turn()[1][:2, :2]
    limit = float(chi2_upper_quantile(ALPHA_OF_PLACES, np.array([2]))[0])
    return bool(about @ np.linalg.solve(covariance, about) > limit)


def _upright_rms(fit: PlaceSimilarity) -> float:
    """Return the root mean square of the residuals with a turn about the vertical alone."""
    a, b = (x - x.mean(axis=0) for x in (fit.pair.a, fit.pair.b))
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    cosine = float(np.sum(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]))
    c, s = np.array([cosine, sine]) / max(np.hypot(sine, cosine), 1e-300)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return float(np.sqrt(np.mean((b - fit.scale * (a @ turn.T)) ** 2)))


def wrong_circle_units(
    equations: Equations, systems: Sequence[PlaceSystem], angle: str
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
        best, told = 1.0 / MIN_CIRCLE_IMPROVEMENT, None
        for columns, what, unit, changed in _changed(sights, f, system, angle):
            left = _misfits(changed, others)
            shares = {n: left[n] / max(now[n], 1e-300) for n in now if n in left}
            share = float(np.median(list(shares.values()))) if shares else np.inf
            if share < best:
                best, told = share, (columns, what, unit, list(shares))
        if told is None:
            continue
        columns, what, unit, against = told
        stated = ANGLE_UNIT_NAMES.get(decimal_angle(angle), decimal_angle(angle))
        named.add(own)
        findings.append(
            Finding(
                f"the places of {own} fit those of {known(against)} {1.0 / best:.0f} times better "
                f"with its {what} in {ANGLE_UNIT_NAMES[unit]}, not in {stated}",
                "state the unit in which they were read",
                ids=_ids_of_circles(equations, names[f], columns),
            )
        )
    return named, findings


def _changed(
    sights: Sights, f: int, system: PlaceSystem, angle: str
) -> Iterator[tuple[tuple[int, ...], str, str, PlaceSystem]]:
    """Iterate over the places of a frame with some of its angles in other units."""
    stated = decimal_angle(angle)
    rows = np.flatnonzero((sights.frame == f) & sights.whole & np.isin(sights.point, system.keys))
    at = np.searchsorted(system.keys, sights.point[rows])
    for unit in ANGLE_UNIT_NAMES:
        if unit == stated:
            continue
        for columns, what in CIRCLE_COLUMNS:
            value: Array = sights.value[rows].copy()
            value[:, columns] *= ANGLE[unit] / ANGLE[stated]
            x = system.x.copy()
            x[at] = place_of_sight(*value.T)
            yield columns, what, unit, replace(system, x=x)


def _misfits(system: PlaceSystem, others: Sequence[PlaceSystem]) -> dict[str, float]:
    """Return the root mean square misfit to each other system that controls the places."""
    found = ((o.name, common_places(system, o, rough=True)) for o in others)
    return {n: p.fitted().rms for n, p in found if p is not None and len(p.a) > p.size}


def _ids_of_circles(equations: Equations, frame: str, columns: Sequence[int]) -> tuple[str, ...]:
    """Return the ids of the readings of some circles in a frame."""
    read = {SIGHT_COMPONENTS[c] for c in columns}
    observed = equations.network.observations.items()
    return tuple(i for i, o in observed if frame in o.frames() and KINDS[o.kind].in_frame in read)
