"""Checks of the given approximate values for geometry that no observation can have."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import InputError, Problem
from ..frames import GeocentricFrame
from ..graph.equations import Equations
from ..network.network import Network
from .where import Sources, listed

LEAST_RADIUS = 6_300_000.0
"""Smallest distance from the centre of the Earth, metres; measured points are farther away."""
PLACES = ("point", "pose", "frame", "size")
"""Kinds of variables without which an observation has no geometry: zeros do not stand for them."""


def inside_the_earth(network: Network, at: Sources) -> Iterator[Problem]:
    """Find local coordinates in a geocentric frame, where such coordinates have no latitude."""
    if not isinstance(network.frame, GeocentricFrame):
        return
    for p in network.points.values():
        distance = float(np.linalg.norm(p.coordinates))
        if distance < LEAST_RADIUS:
            yield Problem(
                f"it lies {distance / 1000:.3f} km from the centre of the Earth: a geocentric "
                "frame needs geocentric coordinates",
                listed("point", [p.name], at),
            )


def geometry_problems(equations: Equations) -> Iterator[Problem]:
    """Compute the observations whose points and photos have given values.

    Yields:
        Problems of geometry that a model refuses (a sight without length, an azimuth of a vertical
        sight).
    """
    state = equations.unknowns.start()
    filled = {k: v if k in PLACES else np.nan_to_num(v, nan=0.0) for k, v in state.items()}
    for block in equations.blocks:
        known_rows = np.ones(block.n, dtype=bool)
        for kind, index in block.variables:
            known_rows &= np.isfinite(filled[kind][index]).all(axis=1)
        rows = np.flatnonzero(known_rows)
        if not len(rows):
            continue
        some = block.select(rows)
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # coordinates of 1e200 are damage
                some.evaluate(equations.network.frame, filled, jacobians=False)
        except InputError as error:
            yield from error.problems
