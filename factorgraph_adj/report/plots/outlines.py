"""Shapes and wires in a plan or a view: their outlines, from the estimates and their points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...graph.blocks import Block
from ...models.outlines import Outline, Seen
from ...solve.singular import SingularError
from ...solve.solution import Solution
from ...types import Array, Index
from .in_frames import FramePlaces, points_of, record_of, variables_of
from .plan import DrawingPlane
from .style import SKY, wrapped

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

DASHES = ("-", (0, (6, 2)), (0, (4, 1.5, 1, 1.5)), (0, (1.5, 1.5)))
"""Line styles of outlines, in the order of the legend."""
LARGEST = 2.0
"""Largest outline that the window is enlarged for, as a multiple of the extent of the points."""

MARGIN = 0.03
"""Room between such an outline and the edge of the window, as a fraction of the extent."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """A shape in a plan."""

    name: str
    """What it is."""
    lines: list[Array]
    """Its lines, each (k, 2) metres."""
    frame: int
    """Number of its frame."""
    places: Array
    """Places in its frame whose precision is shown, (k, 3)."""
    place: str
    """What each of them is."""


def outlines_in(solution: Solution, frames: FramePlaces, plan: DrawingPlane) -> list[Drawn]:
    """Return the shapes of a solution; those that are not known in full are left out."""
    points: dict[tuple[Outline, int, tuple[float, ...]], list[Index]] = {}
    for block in solution.equations.blocks:
        record = record_of(block)
        if record is None or record.outline is None:
            continue
        frame = variables_of(block)["frame", record.frames[0]]
        values = np.column_stack([frame, _values(solution, block, record.outline)])
        found, group = np.unique(values, axis=0, return_inverse=True)
        for i, row in enumerate(found.tolist()):
            key = (record.outline, int(row[0]), tuple(row[1:]))
            points.setdefault(key, []).append(points_of(block)[group.ravel() == i])
    out: list[Drawn] = []
    for (outline, f, values_), numbers in points.items():
        xyz = solution.state["point"][np.unique(np.concatenate(numbers))]
        if not (np.isfinite(xyz).all() and np.isfinite([*values_]).all()):
            continue
        turn = frames.rotation(f)
        seen = Seen(
            frames.coordinates(f, xyz),
            np.asarray(plan.axes[2] @ turn),
            frames.up(f, xyz.mean(axis=0)),
        )
        lines = [
            plan.coordinates(frames.places(f, q))[:, :2] for q in outline.lines(seen, *values_)
        ]
        if all(np.isfinite(line).all() for line in lines):
            out.append(Drawn(outline.name, lines, f, outline.places(*values_), outline.place))
    return out


def _values(solution: Solution, block: Block, outline: Outline) -> Array:
    """Return the values that the lines of an outline take, (n, k)."""
    by_name = {a: (kind, i) for (kind, a), i in variables_of(block).items()}
    columns = []
    for name in outline.takes:
        if name in block.constants:
            columns.append(block.constants[name])
        else:
            kind, numbers = by_name[name]
            columns.append(solution.state[kind][numbers, 0])
    return np.array(columns).reshape(len(outline.takes), block.n).T


def draw_outlines(axes: Axes, drawn: list[Drawn]) -> list[Artist]:
    """Draw shapes; return the entries of the legend, one for each sort of shape."""
    from matplotlib.collections import LineCollection

    found: list[Artist] = []
    for i, name in enumerate(dict.fromkeys(each.name for each in drawn)):
        own = [each for each in drawn if each.name == name]
        lines = LineCollection(
            [line for each in own for line in each.lines],
            colors=SKY,
            linestyles=[DASHES[i % len(DASHES)]],
            linewidths=1.8,
            zorder=0.8,
            label=wrapped(f"{name} ({len(own)})"),
            gid=f"outline: {name}",
        )
        axes.add_collection(lines, autolim=False)
        found.append(lines)
    return found


def places_with_precision(
    frames: FramePlaces, plan: DrawingPlane, drawn: list[Drawn]
) -> list[tuple[str, Array, Array]]:
    """Return the centres, apexes and ends of shapes in a plan.

    Returns:
        What they are, their places (k, 2) and covariances (k, 3, 3); none without regular normal
        equations. Places of one frame that coincide, such as centres of circles, stand once.
    """
    at: dict[str, list[Array]] = {}
    sigma: dict[str, list[Array]] = {}
    every = {(each.frame, each.places.tobytes()): each for each in drawn if len(each.places)}
    for each in every.values():
        try:
            covariances = frames.covariances(each.frame, each.places)
        except SingularError:
            return []
        places = plan.coordinates(frames.places(each.frame, each.places))[:, :2]
        at.setdefault(each.place, []).append(places)
        sigma.setdefault(each.place, []).append(plan.covariance(covariances))
    return [(place, np.concatenate(at[place]), np.concatenate(sigma[place])) for place in at]


def around(at: Array, drawn: list[Drawn]) -> Array:
    """Return places (n, 2) that a window must hold: points, and outlines that are not too large.

    A short arc of a large circle does not shrink its points to a dot.
    """
    extent = max(float(np.max(np.ptp(at, axis=0))), 1e-9)
    lines = [line for each in drawn for line in each.lines]
    fits = [each for each in lines if float(np.max(np.ptp(each, axis=0))) <= LARGEST * extent]
    edge = MARGIN * extent * np.array([[-1.0, -1.0], [1.0, 1.0]])
    return np.concatenate([at, *((each[:, None] + edge).reshape(-1, 2) for each in fits)])
