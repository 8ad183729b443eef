"""Heights above the ellipsoid beside heights above a geoid: both tens of metres apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...errors import AdjustmentError
from ...frames import LocalFrame
from ...network.network import Network
from ...observations.positions import ControlPoint, GnssPosition
from ...types import Array
from .finding import Finding
from .given_rows import BETTER, median

LEAST_POINTS = 2
"""Smallest number of control points that GNSS has measured, of which the same offset is told."""
LEAST_OFFSET = 1.0
"""Smallest offset of heights, metres, that is told: undulations of a few decimetres are rare, and
so are errors of heights of a metre that all control points share."""
NEAR = 0.1
"""Part of the undulation by which an offset may differ from it and be explained by it: a geoid of
one site is not that of the datum."""


def mixed_heights(network: Network) -> Iterator[Finding]:
    """Tell that positions of GNSS lie above or below control points, and agree with them in plan.

    Control points are those that are held, and those with observed coordinates of another origin.
    """
    weighted = {
        o.point
        for o in network.observations.values()
        if isinstance(o, ControlPoint) and not isinstance(o, GnssPosition)
    }
    ids, observed, given = [], [], []
    for ident, o in network.observations.items():
        if not isinstance(o, GnssPosition) or o.axes != "xyz":
            continue
        point = network.points[o.point]
        if all(point.fixed) or point.sigma is not None or o.point in weighted:
            ids.append(ident)
            observed.append(o.value)
            given.append(point.coordinates)
    at = np.array(given, dtype=float).reshape(-1, 3)
    d = np.array(observed, dtype=float).reshape(-1, 3) - at
    there = np.isfinite(at).all(axis=1)
    if there.sum() < LEAST_POINTS:
        return
    at, d = at[there], d[there]
    d = np.einsum("nij,nj->ni", network.frame.basis(at, np.zeros((len(at), 2))).enu, d)
    offset = float(np.median(d[:, 2]))
    rest = max(median(np.hypot(d[:, 0], d[:, 1])), median(d[:, 2] - offset))
    if abs(offset) < LEAST_OFFSET or rest * BETTER > abs(offset):
        return
    side = "below" if offset < 0 else "above"
    yield Finding(
        f"{len(at)} GNSS positions are {side} the given heights of their points, and agree with "
        f"them in plan{_undulation(network, at, offset)}",
        "heights above the ellipsoid and above a geoid are mixed: state for the reference system "
        "which of them the given heights are",
        abs(offset),
        rest,
        "m",
        ids=tuple(i for i, t in zip(ids, there.tolist(), strict=True) if t),
    )


def _undulation(network: Network, at: Array, offset: float) -> str:
    """Return that the offset is the undulation of the reference system, where it is."""
    if network.crs is None or isinstance(network.frame, LocalFrame):
        return ""
    try:
        latitude, longitude, _ = network.crs.geodetic(network.frame, at)
        found = network.crs.geoid_at(latitude, longitude).undulation
    except AdjustmentError:  # the geoid ends before
        return ""
    undulation = float(np.median(found))
    if abs(abs(offset) - abs(undulation)) > NEAR * abs(undulation):
        return ""
    return f" (the undulation is {undulation:.2f} m there)"
