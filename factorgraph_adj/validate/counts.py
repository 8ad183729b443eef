"""Checks of counts: unknowns without observations or with too few observations.

Sufficient counts are necessary for a solution; only the rank shows that a solution exists.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import Problem
from ..graph.equations import Equations
from ..graph.variables import calibration_name
from ..models.variables import UNKNOWNS, VariableKind
from ..types import Array
from .where import Sources, listed

TINY = 5
"""Free networks with fewer points and photos are exempt from the count for each point."""


def _touching(equations: Equations, kind: VariableKind) -> tuple[Array, list[dict[str, int]]]:
    """Return numbers of scalar observations of each variable, and of observations by kind."""
    n = len(equations.unknowns.tables[kind].names)
    rows = np.zeros(n)
    counts: list[dict[str, int]] = [{} for _ in range(n)]
    for block in equations.blocks:
        for what, index in block.variables:
            if what != kind:
                continue
            times = np.bincount(index, minlength=n)
            rows += block.dimension * times
            name = block.kind.removeprefix("weighted_")
            for i in np.flatnonzero(times):
                counts[i][name] = counts[i].get(name, 0) + int(times[i])
    return rows, counts


def point_problems(equations: Equations, at: Sources) -> Iterator[Problem]:
    """Find points without observations or with fewer observations than unknowns."""
    network, table = equations.network, equations.unknowns["point"]
    rows, counts = _touching(equations, "point")
    free = table.free.sum(axis=1)
    idle = [table.names[i] for i in np.flatnonzero((rows == 0) & (free > 0))]
    if idle:
        yield Problem(
            "no observation: observe it, hold it (column fixed), or take it out",
            listed("point", idle, at),
        )
    if network.datum == "free" and len(network.points) + len(network.photos) < TINY:
        return
    groups: dict[tuple[int, str], list[str]] = {}
    for i in np.flatnonzero((rows > 0) & (rows < free)):
        groups.setdefault((int(free[i]), _counted(counts[i])), []).append(table.names[i])
    for (unknown, have), names in groups.items():
        yield Problem(
            f"{have} for {unknown} free coordinates: observe it more, give control, "
            "or hold coordinates (column fixed)",
            listed("point", names, at),
        )


def _counted(counts: dict[str, int]) -> str:
    words = {"image": "image ray"}
    each = [(n, words.get(k, k).replace("_", " ")) for k, n in counts.items()]
    return "only " + ", ".join(f"{n} {word}{'s' * (n > 1)}" for n, word in each)


def photo_problems(equations: Equations, at: Sources) -> Iterator[Problem]:
    """Find photos with fewer image points than their unknowns need."""
    network, table = equations.network, equations.unknowns["pose"]
    rows, counts = _touching(equations, "pose")
    calibrations = equations.unknowns["calibration"]
    for i, name in enumerate(table.names):
        unknown = int(table.free[i].sum())
        camera = network.cameras[network.photos[name].camera]
        if camera.per_photo:
            own = calibrations.number[calibration_name(network, name)]
            unknown += int((calibrations.free[own] & ~np.isfinite(calibrations.sigma[own])).sum())
        if rows[i] < unknown:
            n = counts[i].get("image", 0)
            needed = n + int(np.ceil((unknown - rows[i]) / 2))
            yield Problem(
                f"{n} image point{'s' * (n != 1)}: its {unknown} unknowns need at least {needed}",
                listed("photo", [name], at),
            )


def other_problems(equations: Equations) -> Iterator[Problem]:
    """Find unknowns without observations, other than points and photos."""
    for kind, table in equations.unknowns.tables.items():
        if kind in ("point", "pose"):
            continue  # these kinds have their own checks
        rows, _ = _touching(equations, kind)
        for i in np.flatnonzero((rows == 0) & table.free.any(axis=1)):
            yield Problem(
                "it is unknown, but no observation depends on it: hold it, or take it out",
                f"{UNKNOWNS[kind].noun} {table.names[i]!r}",
            )
