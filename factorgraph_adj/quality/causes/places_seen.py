"""Where the targets of a set-up are, by a direction, a distance and an inclination."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...graph.equations import Equations
from ...graph.variables import State
from ...types import Array
from .readings import HEIGHT

if TYPE_CHECKING:
    from .exchanged_targets import Sight


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
