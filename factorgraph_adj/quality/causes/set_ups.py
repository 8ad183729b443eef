"""Set-ups with their sights, and where the targets are by what was read there."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...graph.equations import Equations
from ...graph.variables import State
from ...solve.solution import Solution
from ...types import Array
from .hypotheses import INCLINATIONS, SIGHTS
from .readings import HEIGHT, Readings


@dataclass(frozen=True)
class SetUp:
    """A set-up: the station, and the height of the instrument."""

    station: int
    """Number of the station."""
    height: float
    """Height of the instrument, metres."""


@dataclass(frozen=True)
class Sight:
    """All that was read from a set-up to a target."""

    readings: tuple[tuple[int, int], ...]
    """Place of the block and number of the observation in it, of each reading."""
    ids: tuple[str, ...]
    """Ids of the readings."""
    heights: tuple[float, ...]
    """Heights of the target recorded with them."""


def sights_of(equations: Equations, solution: Solution) -> dict[SetUp, dict[int, Sight]]:
    """Return the sights of each set-up by the number of the target."""
    r = Readings.of(equations, solution.state).of_kinds(
        *(k for k in SIGHTS if k != "horizontal_angle")
    )
    above, target_height = r.constant("instrument_height"), r.constant(HEIGHT)
    inclined = np.isin(r.kind, INCLINATIONS)
    heights: dict[int, set[float]] = defaultdict(set)
    for station, height in zip(r.station[inclined].tolist(), above[inclined].tolist(), strict=True):
        heights[station].add(height)
    rows: dict[tuple[SetUp, int], list[int]] = defaultdict(list)
    ends = zip(r.station.tolist(), r.target.tolist(), above.tolist(), strict=True)
    for i, (station, target, height) in enumerate(ends):
        known = heights[station]
        # Directions are often recorded without a height: they belong to all of the station.
        for h in [height] if height in known else known or {0.0}:
            rows[SetUp(station, h), target].append(i)
    out: dict[SetUp, dict[int, Sight]] = defaultdict(dict)
    for (set_up, target), at in rows.items():
        out[set_up][target] = Sight(
            tuple((int(r.block[i]), int(r.number[i])) for i in at),
            tuple(r.equations.id(int(r.row[i])) for i in at),
            tuple(dict.fromkeys(float(h) for h in target_height[at])),
        )
    return out


def places_seen(
    equations: Equations, state: State, station: int, above: float, targets: Mapping[int, Sight]
) -> dict[int, Array]:
    """Return the places (3,) of the targets of a set-up, metres.

        X = X_i + h_i u + D (e sin A sin z + n cos A sin z + u cos z) − h_t u

    Without refraction, so that they are good to centimetres. NaN: the readings, the orientation or
    the station do not give it; without an inclination the height alone is NaN.

    Args:
        equations: the equations with the readings.
        state: values of the station and of the orientations.
        station: number of the station.
        above: height of the instrument, metres.
        targets: sights by the number of the target.
    """
    at = state["point"][station]
    if not np.isfinite(at).all():
        return {t: np.full(3, np.nan) for t in targets}
    e, n, u = equations.network.frame.basis(at[None], np.zeros((1, 2))).enu[0]
    out: dict[int, Array] = {}
    for target, sight in targets.items():
        azimuth, slope, plan, zenith, height = [], [], [], [], []
        for place, number in sight.readings:
            block = equations.blocks[place]
            value = float(block.observed[number, 0])
            if block.kind == "direction":
                index = next(i for kind, i in block.variables if kind == "orientation")
                azimuth.append(value + float(state["orientation"][index[number], 0]))
            elif block.kind == "azimuth":
                azimuth.append(value)
            elif block.kind == "slope_distance":
                slope.append(value)
            elif block.kind == "horizontal_distance":
                plan.append(value)
            elif block.kind == "zenith_angle":
                zenith.append(value)
            elif block.kind == "vertical_angle":
                zenith.append(0.5 * np.pi - value)
            if block.kind in ("zenith_angle", "vertical_angle"):
                height.append(float(block.constants[HEIGHT][number]))
        z = zenith[0] if zenith else 0.5 * np.pi
        across = slope[0] * np.sin(z) if slope else plan[0] if plan else np.nan
        bearing = azimuth[0] if azimuth else np.nan
        rise = across / np.tan(z) + above - height[0] if zenith else np.nan
        flat = at + across * (e * np.sin(bearing) + n * np.cos(bearing))
        out[target] = flat + rise * u if zenith else flat + np.array([0.0, 0.0, np.nan])
    return out
