"""Comp3D: its adjusted points and observations (.csv, .comp), and what it computes in other ways.

The horizon of a levelled sub-frame is tilted wrongly in it: at a station of longitude Δλ east of
the origin by Δλ towards the east instead of Δλ cosφ, as if meridians did not converge. Its
``R_global2instr`` at stations 4 and 6 of ``bascule``, x = 1000 m, prints 2.3757e-4 where
x/N = 1.5649e-4 = 2.3757e-4 cos 48.8°. Deflections η = Δλ (1 − cosφ) that are held at the stations
do the same (`tilted_as_comp3d`). Its heights come in steps of 2⁻³⁰ m = 0.93 nm, the resolution of
doubles at the radius of the Earth, through which its coordinates pass.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import FrameCoordinate, FrameDirection, FrameDistance, FrameZenith
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array


def as_polar(network: Network) -> Network:
    """Return the network with coordinates of sub-frames as direction, zenith angle, distance.

    Their standard deviations are those of the coordinates, which must be equal in all axes: σ/h of
    the direction, σ/S of the zenith angle and σ of the distance.
    """
    polar = network.copy()
    polar.observations = {}
    for o in network.observations.values():
        if not isinstance(o, FrameCoordinate):
            polar.add(o)
            continue
        assert o.sigma is not None and o.point is not None and len(set(o.sigma)) == 1
        x, y, z = o.value
        sigma, across, length = o.sigma[0], np.hypot(x, y), float(np.linalg.norm(o.value))
        polar.add(
            FrameDirection(o.frame, o.point, np.arctan2(x, y) % (2 * np.pi), sigma=sigma / across),
            FrameZenith(o.frame, o.point, float(np.arctan2(across, z)), sigma=sigma / length),
            FrameDistance(o.frame, o.point, length, sigma=sigma),
        )
    return polar


def tilted_as_comp3d(solution: Solution) -> Network:
    """Return the network with the horizons that Comp3D gives levelled sub-frames.

    Δλ (1 − cosφ) is what its tilt to the east has too much; a micrometre in the place of a station
    is nothing in it.
    """
    network = solution.network.copy()
    for frame in network.frames.values():
        if frame.constants[-1]:
            at = network.frame.geodetic(solution.point(frame.origin)[None])
            assert at is not None
            latitude, longitude, _ = (float(v[0]) for v in at)
            eta = longitude * (1.0 - np.cos(latitude))
            network.set_vertical(frame.origin, eta=eta, fixed=True)
    return network


def read_table(path: Path) -> list[dict[str, str]]:
    """Read a table of results."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def read_result(path: Path) -> dict[str, Any]:
    """Read a result (.comp): JSON behind ``data=``."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return dict(json.loads(text[text.index("{") :]))


@dataclass(frozen=True)
class Ellipsoid:
    """A standard error ellipsoid as Comp3D prints it, scaled by its σ0."""

    axes: Array
    """Semi-axis (m), azimuth and inclination (gon, both from 0 to 200) of each axis, (3, 3)."""


def read_ellipsoids(path: Path) -> dict[str, Ellipsoid]:
    """Read the ellipsoids of the points of a result (.comp)."""
    points = read_result(path)["points"]
    return {n: Ellipsoid(np.array(p["ellips"]["axes"])) for n, p in points.items()}
