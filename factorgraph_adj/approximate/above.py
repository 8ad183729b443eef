"""Heights of points above level surfaces and surfaces of pressure, as arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..types import Array, Index


@dataclass(frozen=True)
class AboveSurfaces:
    """Heights of points above surfaces, the heights of which may be unknown."""

    point: Index
    """Numbers of the points, (n,)."""
    surface: Index
    """Number of the surface of each, among those of all kinds, (n,)."""
    above: Array
    """Height of the point above the surface, metres, (n,)."""
    height: Array
    """Heights of the surfaces, metres; NaN where they are not given, (k,)."""


def _above_level(block: Block, levels: Array) -> Array:
    c = block.constants
    return np.asarray(block.observed[:, 0] + c["slope"] * c["along"] + c["geoid"])


def _above_profile(block: Block, profiles: Array) -> Array:
    """Return the reading in metres of height, and what the surface rises along the profile."""
    own, t = np.nan_to_num(profiles[block.variables[-1][1]]), block.constants["time"]
    return np.asarray(block.observed[:, 0] / (1.0 + own[:, 3]) + own[:, 1] * t + own[:, 2] * t**2)


_KINDS: dict[str, tuple[str, Callable[[Block, Array], Array]]] = {
    "level_height": ("level", _above_level),
    "profile_height": ("profile", _above_profile),
}
"""Kind of the surface, and the heights above it, by the kind of observations."""


def read_surfaces(equations: Equations) -> AboveSurfaces:
    """Read the heights of points above surfaces; a free height of a surface is not given."""
    none, nobody = np.zeros(0), np.zeros(0, dtype=np.intp)
    points, surfaces, above, height = [nobody], [nobody], [none], [none]
    for name, (kind, value) in _KINDS.items():
        table, first = equations.unknowns[kind], sum(len(h) for h in height)
        for block in equations.blocks:
            if block.kind == name and block.variables[0][0] == "point":
                points.append(block.variables[0][1])
                surfaces.append(first + block.variables[-1][1])
                above.append(value(block, table.values))
        loose = table.free[:, 0] & np.isinf(table.sigma[:, 0])
        height.append(np.where(loose, np.nan, table.values[:, 0]))
    return AboveSurfaces(
        np.concatenate(points),
        np.concatenate(surfaces),
        np.concatenate(above),
        np.concatenate(height),
    )
