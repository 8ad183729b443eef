"""Intervals of heights and ellipses in the horizon of free geocentric networks, by dense algebra.

The covariance by inner constraints is the pseudo-inverse of the normal equations of the points,
whose null vectors are the datum defect. The horizon is that of GRS 80, from latitude and longitude.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.stats import chi2, f

import factorgraph_adj as fga
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.observations import (
    Direction,
    GnssVector,
    HeightDifference,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.quality.error_ellipses import error_ellipse, height_interval
from factorgraph_adj.simulation.measurement import measure

LATITUDE, LONGITUDE = np.radians(47.3), np.radians(11.2)
N = 5


def network_of(kinds: str) -> fga.Network:
    """Return a free network of some kinds of observation between all points, measured."""
    rng, grs80 = np.random.default_rng(36), ellipsoid("GRS80")
    network = fga.Network("free", frame=GeocentricFrame(), datum="free")
    for i in range(N):
        at = np.array([LATITUDE, LONGITUDE]) + rng.uniform(-1e-3, 1e-3, 2)
        height = np.array([300.0 + rng.uniform(-300.0, 300.0)])
        network.add_point(f"P{i}", grs80.to_cartesian(at[:1], at[1:], height)[0])
    for i in range(N):
        for j in range(N):
            a, b = f"P{i}", f"P{j}"
            if i != j and "direction" in kinds:
                network.add(Direction(a, b, 1.0, sigma=1e-5))
            if i != j and "zenith" in kinds:
                network.add(ZenithAngle(a, b, 1.5, sigma=2e-5))
            if i < j and "distance" in kinds:
                network.add(SlopeDistance(a, b, 1.0, sigma=2e-3))
            if i < j and "levelling" in kinds:
                network.add(HeightDifference(a, b, 1.0, sigma=3e-3))
            if i < j and "vector" in kinds:
                network.add(GnssVector(a, b, (1.0, 1.0, 1.0), sigma=(0.003, 0.004, 0.005)))
    return measure(network, seed=36)


@pytest.mark.parametrize("variance", ["a-priori", "a-posteriori"])
@pytest.mark.parametrize(
    ("kinds", "defect"),
    [
        ("distance", 6),
        ("distance levelling", 4),
        ("distance direction zenith", 4),
        ("vector", 3),
    ],
)
def test_intervals_and_ellipses_are_those_of_the_pseudo_inverse(
    kinds: str, defect: int, variance: Literal["a-priori", "a-posteriori"]
) -> None:
    solution = fga.adjust(network_of(kinds), variance=variance)
    assert solution.datum_defect == defect
    r = solution.redundancy
    unknowns = solution.equations.unknowns
    a = solution.normal().system.times(np.eye(unknowns.n_columns))
    columns = np.concatenate([unknowns.columns("point", i) for i in range(N)])
    others = np.setdiff1d(np.arange(a.shape[1]), columns)
    b, c = a[:, columns], a[:, others]
    if len(others):
        b = b - c @ np.linalg.lstsq(c, b, rcond=None)[0]
    values, vectors = np.linalg.eigh(b.T @ b)
    v = vectors[:, defect:]
    q = (v / values[defect:]) @ v.T
    square = 1.0
    if variance == "a-posteriori":
        residual = solution.normal().system.residual
        square = float(residual @ residual) / r
        factor = {1: np.sqrt(f.ppf(0.95, 1, r)), 2: np.sqrt(2.0 * f.ppf(0.95, 2, r))}
    else:
        factor = {d: np.sqrt(chi2.ppf(0.95, d)) for d in (1, 2)}
    grs80 = ellipsoid("GRS80")
    for i in range(N):
        latitude, longitude, _ = (
            float(x[0]) for x in grs80.to_geodetic(solution.point(f"P{i}")[None])
        )
        east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
        up = np.array([np.cos(latitude) * np.cos(longitude), 0.0, np.sin(latitude)])
        up[1] = np.cos(latitude) * np.sin(longitude)
        own = np.array([east, np.cross(up, east), up])
        local = square * own @ q[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] @ own.T
        interval = height_interval(solution, f"P{i}", confidence=0.95)
        assert interval.half_width == pytest.approx(factor[1] * np.sqrt(local[2, 2]), rel=1e-6)
        ellipse = error_ellipse(solution, f"P{i}", confidence=0.95)
        axes = factor[2] * np.sqrt(np.linalg.eigvalsh(local[:2, :2])[::-1])
        np.testing.assert_allclose(ellipse.semi_axes, axes, rtol=1e-6)
