"""Positions of GNSS receivers as observations of a network: frames, grids, antenna heights.

A fix has geodetic coordinates, or easting, northing and height of a grid. Its datum is that of the
corrections that the receiver used, and has to be that of the frame of the network; nothing is
transformed between datums, since neither a receiver nor NMEA states it.

======================  ==============================  ==========================================
frame of the network    geodetic fix                    fix in a grid
======================  ==============================  ==========================================
geocentric              X of φ, λ, h                    by the reference system of the network
topocentric             X, turned into the frame        by the reference system of the network
local                   by the reference system of the  easting, northing and height along the
                        network: grid coordinates       axes of the frame
======================  ==============================  ==========================================

The covariance is along east, north, up at the place (``axes = enu`` of a ``gnss_position``). The
mark lies the antenna height below the antenna, along the normal of the ellipsoid, or along z of a
local frame. The antenna height is that of the point which the receiver refers positions to,
usually the antenna reference point.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from ..crs.grid_places import grid_places
from ..crs.reference_system import ReferenceSystem
from ..errors import InputError
from ..frames import Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from ..types import Array

Quality = Literal[
    "none", "simulated", "manual", "estimated", "single", "differential", "float", "fixed"
]
"""How a position was found: of carrier phases with fixed or float ambiguities, of code ranges with
or without corrections, by dead reckoning, typed or simulated."""
QUALITIES: tuple[Quality, ...] = get_args(Quality)
"""Qualities from the lowest."""


@dataclass(frozen=True)
class GnssFix:
    """A position of an antenna."""

    RANKS: ClassVar[Mapping[Quality, int]] = {q: i for i, q in enumerate(QUALITIES)}
    """Order of qualities from the lowest."""

    time: float
    """Seconds since 1970 UTC."""
    position: tuple[float, float, float] | None
    """Latitude, longitude (radians) and ellipsoidal height (metres), or easting, northing and
    height (metres); None: the receiver has no position."""
    grid: bool = False
    """Whether the position has grid coordinates."""
    quality: Quality = "none"
    """How it was found."""
    satellites: int | None = None
    """Number of satellites; None: not stated."""
    age: float | None = None
    """Age of the corrections, seconds; None: not stated."""
    covariance: Array | None = None
    """Covariance along east, north, up, (3, 3) metres²; None: not stated."""

    def is_at_least(self, quality: Quality) -> bool:
        """Return whether it has a position of this quality or a better one."""
        return self.position is not None and self.RANKS[self.quality] >= self.RANKS[quality]


def position_in_frame(
    fix: GnssFix,
    frame: Frame,
    system: ReferenceSystem | None = None,
    *,
    antenna_height: float = 0.0,
) -> Array:
    """Return the place of the mark in the frame of a network, (3,) metres.

    Args:
        fix: a fix that has a position.
        frame: the frame.
        system: reference system of the network, see the table of the module.
        antenna_height: height of the antenna above the mark, metres.

    Raises:
        InputError: the frame needs a reference system, or the place is outside of it.
    """
    assert fix.position is not None
    a, b, height = fix.position
    at = np.array([[a, b, height - antenna_height]])
    if fix.grid:
        if isinstance(frame, LocalFrame):
            return np.asarray(at[0] @ np.vstack([frame.east_north, [0.0, 0.0, 1.0]]))
        return np.asarray(_needed(system, "a position in a grid").to_frame(frame, at)[0])
    if isinstance(frame, LocalFrame):
        known = _needed(system, "a geodetic position in a local frame")
        grid = known.from_geodetic(at[:, 0], at[:, 1], at[:, 2])
        return np.asarray(known.to_frame(frame, grid)[0])
    earth = frame if isinstance(frame, GeocentricFrame) else frame.geocentric
    xyz = earth.ellipsoid.to_cartesian(at[:, 0], at[:, 1], at[:, 2])
    if isinstance(frame, TopocentricFrame):
        xyz = frame.from_geocentric(xyz)
    return np.asarray(xyz[0])


def _needed(system: ReferenceSystem | None, what: str) -> ReferenceSystem:
    if system is None:
        raise InputError(f"{what} needs the reference system of the network: give it [crs]")
    return system


def position_record(
    fix: GnssFix,
    point: str,
    frame: Frame,
    system: ReferenceSystem | None = None,
    *,
    antenna_height: float = 0.0,
    sigma: tuple[float, float, float] | None = None,
) -> dict[str, Any]:
    """Return the record of a ``gnss_position``, in metres, with its covariance in mm².

    Args:
        fix: the fix.
        point: name of the mark.
        frame: frame of the network.
        system: reference system of the network, see `position_in_frame`.
        antenna_height: height of the antenna above the mark, metres.
        sigma: σ of east, north, up, metres, in the place of the covariance of the fix.

    Raises:
        InputError: see `position_in_frame`; or neither the fix nor ``sigma`` states σ.
    """
    if fix.position is None:
        raise InputError("the receiver had no position")
    covariance = fix.covariance if sigma is None else np.diag(np.square(sigma))
    if covariance is None:
        raise InputError(
            "no standard deviation: the receiver states none (send GST), and the instrument has "
            "none; give sigma_mm"
        )
    xyz = position_in_frame(fix, frame, system, antenna_height=antenna_height)
    if not fix.grid and isinstance(frame, LocalFrame):
        covariance = _in_grid(covariance, xyz, frame, _needed(system, "a local frame"))
    x, y, z = (float(v) for v in xyz)
    record: dict[str, Any] = {"kind": "gnss_position", "point": point, "axes": "enu", "unit": "m"}
    record |= {"x": x, "y": y, "z": z}
    for i, a in enumerate("enu"):
        for j, b in enumerate("enu"[: i + 1]):
            record[f"covariance_{b}{a}_mm2"] = float(1e6 * covariance[i, j])
    return record


def _in_grid(covariance: Array, xyz: Array, frame: LocalFrame, system: ReferenceSystem) -> Array:
    """Return a covariance along true east and north along those of the grid, by the convergence."""
    gamma = float(grid_places(system, frame, xyz[None]).convergence[0])
    s, c = math.sin(gamma), math.cos(gamma)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ covariance @ turn.T)
