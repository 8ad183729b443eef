"""Checks of counts of shapes: conditions from points, and unknowns of a shape and its sizes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import Problem
from ..graph.equations import Equations
from ..models.variables import UNKNOWNS
from ..types import Mask
from .counts import blocks_of_shapes, frames_of_shapes, places_of_frames


def shape_problems(equations: Equations) -> Iterator[Problem]:
    """Find shapes with fewer conditions than unknowns.

    A condition counts if something else is known of its point: the point is held, or another
    observation or another frame has it. Unknowns are the components of the frame without a given
    value, and the sizes that nothing else depends on.
    """
    table = equations.unknowns["frame"]
    unknown = table.free & np.isinf(table.sigma)
    seen, elsewhere = places_of_frames(equations, unknown)
    times = np.bincount([p for places in seen for p in places], minlength=len(elsewhere))
    common: Mask = elsewhere | (times > 1)
    sizes = _sizes(equations)
    for f in sorted(frames_of_shapes(equations)):
        names = [c for c, u in zip(UNKNOWNS["frame"].names(), unknown[f], strict=True) if u]
        names += [UNKNOWNS[kind].noun for (kind, _), users in sizes.items() if users == {f}]
        rows, points = _conditions(equations, f, common)
        if rows < len(names):
            n = int(common[sorted(points)].sum())
            yield Problem(
                f"{n} of its {len(points)} points {'is' if n == 1 else 'are'} determined "
                f"otherwise, which is {rows} condition{'s' * (rows != 1)} for {len(names)} "
                f"unknowns ({', '.join(names)}): observe more points, or hold some of its "
                "components",
                f"shape {table.names[f]!r}",
            )


def _conditions(equations: Equations, f: int, common: Mask) -> tuple[int, set[int]]:
    """Return the number of conditions of a shape, and the numbers of its points."""
    rows, points = 0, set[int]()
    on_shapes = {id(b) for b in blocks_of_shapes(equations)}
    for block in equations.blocks:
        if id(block) in on_shapes:
            own = block.variables[1][1][block.variables[0][1] == f]
            points |= set(own.tolist())
            rows += block.dimension * int(common[own].sum())
        else:
            rows += sum(
                block.dimension * int(np.count_nonzero(index == f))
                for kind, index in block.variables
                if kind == "frame"
            )
    return rows, points


def _sizes(equations: Equations) -> dict[tuple[str, int], set[int]]:
    """Return the shapes that depend on each unknown size; −1 stands for any other observation."""
    users: dict[tuple[str, int], set[int]] = {}
    on_shapes = {id(b) for b in blocks_of_shapes(equations)}
    own = dict.fromkeys(
        kind
        for b in equations.blocks
        if id(b) in on_shapes
        for kind, _ in b.variables[2:]
        if kind not in ("point", "vertical")
    )
    for block in equations.blocks:
        for kind, index in block.variables:
            if kind not in own:
                continue
            frames = block.variables[0][1] if id(block) in on_shapes else np.full_like(index, -1)
            for i, f in zip(index.tolist(), frames.tolist(), strict=True):
                if equations.unknowns[kind].free[i].any():
                    users.setdefault((kind, i), set()).add(f)
    return users
