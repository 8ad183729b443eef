"""Feasible states: points ahead of cameras, bounded principal distances, starts off offset lines.

Steps keep points in front of their cameras, and solutions are checked for it. Steps keep the sign
of principal distances, too, and take no more than half of one: with c = 0 all image points are at
the principal point, which is a minimum of its own, and beyond it images are mirrored.

A start, or a step, may leave a point behind a camera that sees it. The formula of its image is then
still valid, but vᵀPv has no way back: the point would have to pass infinity or the focal plane. The
point is placed again instead: where its rays meet, or on one of them at the depth of the other
points of that photo; whichever place lies ahead of most of its cameras, and nearest to its rays.

The distance from a line has a value on the line, zero, but no partials there: every direction
across the line is the same. Nominal coordinates are just that. A start is moved aside by some
micrometres, and an adjustment with little weight on such offsets brings it to the side where the
other observations have it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, Problem
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..models.image import in_front
from ..models.inverse_lens import directions
from ..models.lens import Lens
from ..observations import KINDS
from ..start.image_rays import nearest_to_rays
from ..types import Array, Index, Mask

MAX_PRINCIPAL_DISTANCE_CUT = 0.5
"""Largest part of a principal distance that a step may take."""
MOVE_SIGMA = 1e-6
"""Standard deviation of a move, metres or radians: a thousand times the resolution of a geocentric
coordinate, and far below what offsets measure."""
DIRECTIONLESS_WEIGHT_FACTOR = 1e-6
"""Factor on the weights of offsets without a direction, while others bring the start to a side."""
MAX_ITERATIONS_OFF_LINES = 20
"""Largest number of iterations for that."""
MAX_MOVES_OFF_LINES = 4
"""Largest number of moves; more do not help where all that is free stays on the line."""


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays of points that lie behind one of their cameras."""

    point: Index
    """Number of the point, (n,)."""
    pose: Array
    """Stored pose of the photo, (n, 12)."""
    direction: Array
    """Unit vector of the ray, (n, 3)."""
    reach: Array
    """Median distance of the points ahead of the camera, metres, (n,)."""
    lens: tuple[Lens, ...]
    """Lens of each ray."""

    @classmethod
    def joined(cls, parts: Sequence[_Rays]) -> _Rays:
        """Return the rays of several blocks whose directions are known."""
        point, pose, direction, reach = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("point", "pose", "direction", "reach")
        )
        lenses = tuple(lens for part in parts for lens in part.lens)
        known = np.flatnonzero(np.isfinite(direction).all(axis=1))
        return cls(point, pose, direction, reach, lenses).some(known)

    def some(self, rows: Index) -> _Rays:
        """Return some of the rays."""
        lenses = tuple(self.lens[i] for i in rows.tolist())
        return _Rays(
            self.point[rows], self.pose[rows], self.direction[rows], self.reach[rows], lenses
        )

    def by_point(self) -> Iterator[_Rays]:
        """Iterate over the rays of each point."""
        order = np.argsort(self.point, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(self.point[order])) + 1):
            if len(rows):
                yield self.some(rows)

    def n_behind(self, places: Array) -> Array:
        """Return the number of cameras that do not have a place ahead of them, of places (k, 3)."""
        out = np.zeros(len(places))
        for pose, lens in zip(self.pose, self.lens, strict=True):
            out += in_front(np.tile(pose, (len(places), 1)), places, lens) <= 0.0
        return out


def with_points_pulled_ahead(equations: Equations, state: State, may_move: Mask) -> State:
    """Return a state with fewer points behind cameras; the same object if none can be moved.

    Args:
        equations: the network.
        state: values of all variables.
        may_move: which points only cameras see, (points,); the others are held by more.
    """
    every = _rays_of_points_behind(equations, state, may_move)
    if every is None:
        return state
    points = state["point"].copy()
    changed = False
    for rays in every.by_point():
        number = int(rays.point[0])
        c, d = rays.pose[:, 9:], rays.direction
        meeting = nearest_to_rays(c, d, np.zeros(len(d), dtype=np.intp), 1)[0]
        places = np.concatenate([points[number][None], c + rays.reach[:, None] * d, meeting])
        places = places[np.isfinite(places).all(axis=1)]
        behind = rays.n_behind(places)
        to = places[:, None] - c
        along = np.einsum("kni,ni->kn", to, d)
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = np.nan_to_num(along / np.linalg.norm(to, axis=2), nan=-1.0)
        # Rays that miss by much count little: one of them may be a mismatch.
        misses = np.sum(np.sqrt(np.maximum(1.0 - cosine, 0.0)), axis=1)
        best = int(np.lexsort((misses, behind))[0])
        if behind[best] < behind[0]:
            points[number], changed = places[best], True
    return {**state, "point": points} if changed else state


def _rays_of_points_behind(equations: Equations, state: State, may_move: Mask) -> _Rays | None:
    """Return the rays of all points that lie behind one of their cameras; None: there are none."""
    found, depths = [], []
    behind = np.zeros(len(state["point"]), dtype=bool)
    for place, chunks in equations.images.items():
        block = equations.blocks[place]
        photo, camera, point = (block.variables[k][1] for k in range(3))
        z = chunks.depths(state)
        behind[point[z <= 0]] = True
        found.append((block, photo, camera, point))
        depths.append((photo, z))
    behind &= may_move
    if not behind.any():
        return None
    every_photo, z = (np.concatenate(x) for x in zip(*depths, strict=True))
    usual = np.median(np.abs(z))
    reach = np.full(len(state["pose"]), usual)
    for i in np.unique(every_photo[z > 0]).tolist():
        reach[i] = np.median(z[(every_photo == i) & (z > 0)])
    parts = []
    for block, photo, camera, point in found:
        rows = np.flatnonzero(behind[point])
        if not len(rows):
            continue
        assert block.lens is not None
        calibration = state["calibration"][camera[rows], : len(block.lens.names)]
        seen = directions(block.lens, block.observed[rows], calibration)
        pose = state["pose"][photo[rows]]
        ray = np.einsum("nij,nj->ni", pose[:, :9].reshape(-1, 3, 3), seen)
        lenses = (block.lens,) * len(rows)
        parts.append(_Rays(point[rows], pose, ray, reach[photo[rows]], lenses))
    return _Rays.joined(parts)


def is_behind_camera(equations: Equations, state: State) -> Mask:
    """Return whether each image point has its object point behind the camera, block by block."""
    out = [np.zeros(0, dtype=bool)]
    out += [chunks.depths(state) <= 0 for chunks in equations.images.values()]
    return np.concatenate(out)


def with_points_held_in_front(equations: Equations, state: State, moved: State) -> State | None:
    """Hold points that a step would take from the front of a camera to behind it.

    Such a step passes the focal plane or infinity, where vᵀPv does not descend continuously.

    Args:
        equations: the network.
        state: the state before the step.
        moved: the state after the step.

    Returns:
        The state after the step; None: the cameras themselves pass points, or shorten too much.
    """
    if not _keeps_principal_distances(equations, state, moved):
        return None
    now = is_behind_camera(equations, moved)
    if not now.any():
        return moved
    passes = now & ~is_behind_camera(equations, state)
    if not passes.any():
        return moved
    point = np.concatenate([b.variables[2][1] for b in equations.blocks if b.image])
    held = np.unique(point[passes])
    points = moved["point"].copy()
    points[held] = state["point"][held]
    kept: State = {**moved, "point": points}
    still = is_behind_camera(equations, kept) & ~is_behind_camera(equations, state)
    return None if still.any() else kept


def _keeps_principal_distances(equations: Equations, state: State, moved: State) -> bool:
    """Return whether a step leaves enough of each principal distance."""
    unknowns, before = equations.unknowns, state["calibration"]
    if not (equations.images and before.size):
        return True
    ratio = moved["calibration"][:, 0] / np.where(before[:, 0] == 0.0, np.nan, before[:, 0])
    shorter = np.flatnonzero(ratio < 1.0 - MAX_PRINCIPAL_DISTANCE_CUT).tolist()
    return not any(unknowns.component_names("calibration", i)[0] == "c" for i in shorter)


def describe_points_behind(equations: Equations, start: State, state: State) -> str:
    """Say which points an iteration has taken behind cameras that saw them; empty: none.

    Args:
        equations: the network.
        start: the state in which it began.
        state: the state in which it ended.
    """
    labels = []
    for place, chunks in equations.images.items():
        passed = np.flatnonzero((chunks.depths(state) <= 0) & (chunks.depths(start) > 0))
        labels += [equations.blocks[place].labels(i) for i in passed[:1].tolist()] * len(passed)
    if not labels:
        return ""
    if len(labels) == 1:
        return f"the point of {labels[0]} ended behind the camera, which saw it at the start"
    what = (
        f"the points of {len(labels)} image points ended behind cameras that saw them at the start"
    )
    return f"{what}, such as {labels[0]}"


def refuse_points_behind(equations: Equations, state: State) -> None:
    """Raise an error that names image points whose object point lies behind the camera."""
    problems = []
    for place, chunks in equations.images.items():
        block = equations.blocks[place]
        photo = block.variables[0][1]
        wrong = chunks.depths(state) <= 0
        for number in np.unique(photo[wrong]).tolist():
            rows = np.flatnonzero(photo == number)
            name = equations.unknowns["pose"].names[number]
            if wrong[rows].all():
                problems.append(
                    Problem(
                        f"all {len(rows)} points lie behind it: is its attitude, or the direction"
                        " of the camera's axes, as it should be?",
                        f"photo {name!r}",
                    )
                )
                continue
            problems += [
                Problem("the adjusted point lies behind the camera", block.labels(int(i)))
                for i in rows[wrong[rows]]
            ]
    if problems:
        raise InputError(problems)


def state_off_lines(equations: Equations, state: State) -> State:
    """Return the state with unknowns moved off the lines that offsets were measured from.

    Of each offset without a direction its points are moved, and where none is free, or that is not
    enough, all of its unknowns. Where nothing is free the state stays, and its evaluation says so.
    """
    blocks = _one_sided(equations)
    rng, frame = np.random.default_rng(1), equations.network.frame
    for moves in range(MAX_MOVES_OFF_LINES):
        columns = [
            _moving(equations.unknowns, block, rows, every=moves > 0)
            for block in blocks
            if len(rows := block.without_direction(frame, state))
        ]
        if not columns:
            break
        own = np.unique(np.concatenate(columns))
        step = np.zeros(equations.unknowns.n_columns)
        step[own] = MOVE_SIGMA * rng.standard_normal(len(own))
        state = equations.unknowns.retract(state, step)
    return state


def offset_rows_on_lines(equations: Equations, state: State) -> Mask:
    """Return the rows of offsets that have no direction, (n_rows,)."""
    out = np.zeros(equations.n_rows, dtype=bool)
    for block in _one_sided(equations):
        rows = block.without_direction(equations.network.frame, state)
        out[block.first_row + block.dimension * rows] = True
    return out


def _one_sided(equations: Equations) -> list[Block]:
    return [b for b in equations.blocks if b.kind in KINDS and KINDS[b.kind].one_sided]


def _moving(unknowns: Unknowns, block: Block, rows: Index, *, every: bool) -> Index:
    """Return free columns of some observations: of their points, or of ``every`` unknown."""
    out: list[Index] = [np.zeros(0, dtype=np.intp)]
    for row in rows.tolist():
        own = [(kind, unknowns.columns(kind, int(index[row]))) for kind, index in block.variables]
        free = [(kind, columns[unknowns.free[columns]]) for kind, columns in own]
        points = [columns for kind, columns in free if kind == "point" and len(columns)]
        out += points if points and not every else [columns for _, columns in free]
    return np.concatenate(out)
