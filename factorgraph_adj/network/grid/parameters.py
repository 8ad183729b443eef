"""Unknowns besides points and photos of a grid in a frame on the Earth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import InputError, Problem
from ...models.variables import UNKNOWNS, UnknownKind
from ...rotation import exp_rotation, log_rotation
from ..entities import Key, Parameter, parameter_name
from .move import GridMove, Moved, no_place

Convert = Callable[[Parameter, GridMove, Moved, int], Parameter]
"""(parameter, change of frames, places of points, row of its point or −1) → the parameter."""


def moved_parameter(
    kind: UnknownKind,
    key: Key,
    parameter: Parameter,
    move: GridMove,
    places: Moved,
    point_number: Mapping[str, int],
) -> Parameter:
    """Return an unknown of the grid in the frame.

    Raises:
        InputError: its values count from axes of the grid and are held or weighted, or its kind
            moves with the object and nothing says how it is converted.
    """
    where = f"{kind.noun} {parameter_name(key)!r}"
    convert = CONVERSIONS.get(kind.name)
    if convert is None and kind.motions is None:
        return parameter
    if convert is None:
        what = (
            f"a {kind.noun} counts from axes of the network, and cannot be converted from a grid: "
            "state it in a topocentric frame"
        )
        raise InputError(Problem(what, where))
    name = key if isinstance(key, str) else key[0]
    try:
        return convert(parameter, move, places, point_number.get(name, -1))
    except InputError as error:
        raise InputError(p.at(where) for p in error.problems) from None


def _kept(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    return parameter


def _without_curvature(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Refraction: κ = k − 1 of a flat frame has the curvature of the Earth in it, k has not.

    In a flat frame a zenith angle above the curved Earth takes κ = k − 1; the new frame is curved
    by itself, and the curvature would count twice. A coefficient below ``CURVATURE_WITHIN`` is
    taken for k − 1; one above it is k already.
    """
    kappa = parameter.values[0]
    return replace(parameter, values=(kappa + 1.0,)) if kappa < CURVATURE_WITHIN else parameter


def _stated(parameter: Parameter) -> bool:
    """Return whether any component is held or weighted at a value that is not 0."""
    rows = zip(parameter.values, parameter.fixed, parameter.sigma, strict=True)
    return any((fixed or np.isfinite(s)) and v != 0 for v, fixed, s in rows)


def _turned(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Orientations count from north: o = o_grid + γ."""
    if row < 0 or not places.there(row):
        if np.isnan(parameter.values[0]):
            return parameter
        raise InputError(no_place(""))
    value = np.mod(parameter.values[0] + places.convergence[row], 2.0 * np.pi)
    return replace(parameter, values=(float(value),))


def _axes_alike(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Shifts along axes: the same in all axes, or none at all, stays as axes turn."""
    values = np.array(parameter.values).reshape(-1, 3)
    sigma = np.array(parameter.sigma).reshape(-1, 3)
    fixed = np.array(parameter.fixed).reshape(-1, 3)
    alike = all((a == a[:, :1]).all() for a in (sigma, fixed)) and not np.nan_to_num(values).any()
    if alike:
        return parameter
    what = (
        "has components along axes of the grid that are others in the frame: state values 0, and "
        "the same standard deviation in all axes"
    )
    raise InputError(Problem(what))


def _frame(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Frames of their own: R and O are turned and moved at O, or in the middle of the network."""
    values: Any = np.array(parameter.values, dtype=float)
    constants = np.array(parameter.constants, dtype=float)
    turns = values[:3]
    if np.isnan(values[:6]).all() and (parameter.origin or not constants[:3].any()):
        return parameter
    held = np.array(parameter.fixed[:6]) | np.isfinite(parameter.sigma[:6])
    motion = replace(
        parameter,
        values=parameter.values[:6],
        fixed=parameter.fixed[:6],
        sigma=parameter.sigma[:6],
    )
    if held.any() and _stated(motion):
        what = "is held or weighted in axes of the grid: state it in a topocentric frame"
        raise InputError(Problem(what))
    if not parameter.origin:
        at = move.places(constants[None, :3])
        constants[:3] = at.xyz[0]
        turn = at.turn[0]
    else:
        middle = np.nanmean(places.xyz, axis=0)
        turn = places.turn[int(np.nanargmin(np.linalg.norm(places.xyz - middle, axis=1)))]
    if constants[3]:  # R leads to the horizon: from that of the grid to the true one
        turn = move.new.basis(constants[None, :3], np.zeros((1, 2))).enu[0] @ turn
    if np.isfinite(turns).all():
        values[:3] = log_rotation((turn @ exp_rotation(turns[None])[0])[None])[0]
    return replace(parameter, values=tuple(values.tolist()), constants=tuple(constants.tolist()))


CURVATURE_WITHIN = -0.5
"""Coefficients of refraction below are k − 1: halfway between the usual k of 0 to 0.2 and it."""

CONVERSIONS: dict[str, Convert] = {
    "refraction": _without_curvature,
    "orientation": _turned,
    "vertical": _kept,
    "edm": _kept,
    "frame": _frame,
    "mount": _kept,
    "drift": _axes_alike,
    "attitude_drift": _axes_alike,
    "size": _kept,
    "level": _kept,
    "profile": _kept,
    "gyro": _kept,
}
"""How unknowns that move with the object are converted, by kind; those that are kept count from
the vertical, from north, or along nothing. Heights of levels and profiles stay above the geoid,
because their observations get its undulation."""
assert set(CONVERSIONS) <= set(UNKNOWNS)
