"""Counts of observations: points, photos, frames and shapes with too few of them.

Sufficient counts are necessary for a solution; only the rank shows that a solution exists. A shape
is counted by its conditions from points, against the unknowns of its frame and its sizes. Problems
name the file and the line of the unknowns concerned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ..errors import Problem, known
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import calibration_name
from ..models.shapes import Shape
from ..models.variables import UNKNOWNS, VariableKind
from ..observations import KINDS
from ..types import Array, Mask

Sources: TypeAlias = Mapping[tuple[str, str], str]
"""File and line by noun (point, photo) and name."""
MIN_COUNTED_ENTITIES = 5
"""Free networks with fewer points and photos are exempt from the count for each point."""


def located_names(noun: str, names: Sequence[str], at: Sources) -> str:
    """Return file and line of the first name, and the names."""
    source = at.get((noun, names[0]))
    where = "" if source is None else f"{source}: "
    if len(names) == 1:
        return f"{where}{noun} {names[0]!r}"
    return f"{where}{noun}s {known(map(repr, names))}"


def problems_with_lines(problems: Sequence[Problem], at: Sources) -> list[Problem]:
    """Return problems of single unknowns with the file and line that state them, where known."""
    lines = {f"{noun} {name!r}": source for (noun, name), source in at.items()}
    return [
        replace(p, where=f"{lines[p.where]}: {p.where}") if p.where in lines else p
        for p in problems
    ]


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
            "no observation: observe it, hold it (column fixed), take it out, or "
            "adjust --leave-out-undetermined",
            located_names("point", idle, at),
        )
    if network.datum == "free" and len(network.points) + len(network.photos) < MIN_COUNTED_ENTITIES:
        return
    groups: dict[tuple[int, str], list[str]] = {}
    for i in np.flatnonzero((rows > 0) & (rows < free)):
        groups.setdefault((int(free[i]), _counted(counts[i])), []).append(table.names[i])
    for (unknown, have), names in groups.items():
        yield Problem(
            f"{have} for {unknown} free coordinates: observe it more, give control, "
            "hold coordinates (column fixed), or adjust --leave-out-undetermined",
            located_names("point", names, at),
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
                located_names("photo", [name], at),
            )


def frame_problems(equations: Equations) -> Iterator[Problem]:
    """Find frames with fewer places that are common with the rest than their unknowns need.

    A place is common if something else is known of it: it is held, or another observation or
    another frame has it. The origin of a frame whose offset is held is one of its places.
    """
    table = equations.unknowns["frame"]
    unknown = table.free & np.isinf(table.sigma)
    seen, elsewhere = common_frame_places(equations, unknown)
    times = np.bincount([p for places in seen for p in places], minlength=len(elsewhere))
    names = [*equations.unknowns["point"].names, *equations.unknowns["pose"].names]
    shapes = shape_frames(equations)
    for f, places in enumerate(seen):
        if not places or not unknown[f].any() or f in shapes:
            continue
        common = sorted(p for p in places if elsewhere[p] or times[p] > 1)
        if not common and equations.network.datum == "free":
            continue  # the frame may be all that there is
        turns = int(unknown[f, :3].sum())
        need = 3 if turns > 1 else 2 if turns or unknown[f, 6] else 1
        stated = equations.network.frames[table.names[f]]
        need -= not stated.origin and not unknown[f, 3:6].any()
        if len(common) < need:
            which = f" ({known([names[p] for p in common])})" if common else ""
            verb = "is" if len(common) == 1 else "are"
            line = " that do not lie in one line" if need == 3 else ""
            yield Problem(
                f"only {len(common)} of its {len(places)} places {verb} common with the rest of "
                f"the network{which}, and its {int(unknown[f].sum())} unknowns need {need}{line}: "
                "observe more of them from elsewhere, or hold some of its components",
                f"frame {table.names[f]!r}",
            )


def shape_blocks(equations: Equations) -> list[Block]:
    """Return the observations of points on shapes."""
    records = ((b, KINDS.get(b.kind)) for b in equations.blocks if not b.prior)
    return [b for b, k in records if k is not None and isinstance(k.model, Shape)]


def shape_frames(equations: Equations) -> set[int]:
    """Return the numbers of the frames of shapes."""
    return {f for b in shape_blocks(equations) for f in b.variables[0][1].tolist()}


def common_frame_places(equations: Equations, unknown: Mask) -> tuple[list[set[int]], Mask]:
    """Return the places of every frame, and whether something outside of frames knows a place.

    Photos are numbered behind the points. ``unknown`` are the components without a given value.
    """
    points, poses = equations.unknowns["point"], equations.unknowns["pose"]
    first = {"point": 0, "pose": len(points.names)}
    held = [~points.free.any(axis=1), ~poses.free[:, 3:].any(axis=1)]
    elsewhere = np.concatenate(held)
    seen: list[set[int]] = [set() for _ in unknown]
    for block in equations.blocks:
        index = next((i for what, i in block.variables if what == "frame"), None)
        for number, (what, place) in enumerate(block.variables):
            if what not in first:
                continue
            if index is None:
                elsewhere[place + first[what]] = True
                continue
            for f, p in zip(index.tolist(), (place + first[what]).tolist(), strict=True):
                # Behind its frame and its place stands the point at the origin of the frame.
                if number < 2 or not unknown[f, 3:6].any():
                    seen[f].add(p)
    return seen, elsewhere


def unobserved_problems(equations: Equations) -> Iterator[Problem]:
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


def shape_problems(equations: Equations) -> Iterator[Problem]:
    """Find shapes with fewer conditions than unknowns.

    A condition counts if something else is known of its point: the point is held, or another
    observation or another frame has it. Unknowns are the components of the frame without a given
    value, and the sizes that nothing else depends on.
    """
    table = equations.unknowns["frame"]
    unknown = table.free & np.isinf(table.sigma)
    seen, elsewhere = common_frame_places(equations, unknown)
    times = np.bincount([p for places in seen for p in places], minlength=len(elsewhere))
    common: Mask = elsewhere | (times > 1)
    sizes = _sizes(equations)
    for f in sorted(shape_frames(equations)):
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
    on_shapes = {id(b) for b in shape_blocks(equations)}
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
    on_shapes = {id(b) for b in shape_blocks(equations)}
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
