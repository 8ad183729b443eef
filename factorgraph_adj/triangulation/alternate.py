"""Blocks of models in plan, and in plan and height in turn (An-block, PAT-M43; FRAMES F3, F4).

An An-block has four unknowns for each model: rz, x, y and ln_scale, and the x and y of model
points. A plan-height adjustment repeats it, and between two of them adjusts the three others, rx,
ry and z, by the z of model points and by all coordinates of projection centres, whose plan the
tilts answer for.

Each half leaves out what the unknowns of the other half do to its residuals: heights of points turn
x and y with a tilt, and z with the scale. The fixed point is that of the simultaneous solution
where points lie in one plane across the z axes of the models and no projection centres are
observed; in relief it is not. `plan_height` tells by how much.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..approximate.rounds import approximate
from ..errors import InputError, Problem
from ..graph.equations import compile_network
from ..models.variables import UNKNOWNS
from ..network.network import Network
from ..observations import FrameCoordinate
from ..shown import Rows, Shown
from ..solve.batch import adjust
from ..solve.solution import Solution
from ..types import Array

IN_PLAN = ("rz", "x", "y", "ln_scale")
"""Components of a frame that the adjustment in plan estimates."""
IN_HEIGHT = ("rx", "ry", "z")
"""Components of a frame that the adjustment in height estimates."""
EQUAL = 1e-3
"""Share of a standard deviation below which two solutions are equal."""
TOLERANCE = 1e-8
"""Bound on the last step of each adjustment, relative to σ."""


@dataclass(frozen=True, repr=False, eq=False)
class PlanHeight(Shown):
    """Adjustments in plan and in height in turn, beside the simultaneous solution."""

    network: Network
    """The network after the last round, all components free again."""
    simultaneous: Solution
    """Solution with all components free."""
    differences: Array
    """Largest difference from the simultaneous solution after each round, of x or y and of z, in
    its standard deviations, (rounds, 2)."""
    steps: Array
    """Largest change of x or y and of z in each round, in the same, (rounds, 2)."""

    @property
    def equal(self) -> bool:
        """Whether it ends at the simultaneous solution, within a thousandth of σ."""
        return bool(self.differences[-1].max() < EQUAL)

    def headline(self) -> str:
        """Return the number of rounds and where they end."""
        x, z = self.differences[-1]
        said = "equals" if self.equal else "differs from"
        return (
            f"PlanHeight: {len(self.steps)} rounds; {said} the simultaneous solution "
            f"({x:.2g} σ in plan, {z:.2g} σ in height)"
        )

    def first_rows(self) -> Rows:
        """Return the differences and steps of the rounds."""
        rows = (
            (i + 1, *d, *s)
            for i, (d, s) in enumerate(zip(self.differences, self.steps, strict=True))
        )
        header = ("round", "plan [σ]", "height [σ]", "step plan [σ]", "step height [σ]")
        return Rows(header, rows, len(self.steps))


def an_block(network: Network) -> Network:
    """Return models in plan: four free components each, x and y of points, heights held.

    Args:
        network: models whose frames have seven free components, see `as_models`. Tilts and heights
            are held at their given or approximate values; projection centres leave the network.

    Raises:
        InputError: the network has observations other than coordinates in frames.
    """
    return _half(_started(network), IN_PLAN, held="z", axes=lambda o: "" if o.photo else "xy")


def height_block(network: Network) -> Network:
    """Return models in height: three free components each, z of points, plan held."""
    return _half(_started(network), IN_HEIGHT, held="xy", axes=lambda o: "xyz" if o.photo else "z")


def plan_height(network: Network, *, rounds: int = 8) -> PlanHeight:
    """Adjust models in plan and height in turn, and compare with the simultaneous solution.

    Args:
        network: models whose frames have seven free components, and held or weighted points.
        rounds: number of rounds; each has one adjustment in plan and one in height.

    Raises:
        InputError: as `an_block`.
    """
    simultaneous = adjust(network, tolerance=TOLERANCE)
    free = [n for n in network.points if simultaneous.covariance(n).any()]
    sigma = np.array([simultaneous.standard_deviations(n) for n in free])
    sigma[sigma == 0] = np.inf
    end = np.array([simultaneous.point(n) for n in free])
    now = _started(network)
    before = np.array([now.points[n].coordinates for n in free])
    differences, steps = [], []
    for _ in range(rounds):
        for half in (an_block, height_block):
            now = _taken_over(now, adjust(half(now), tolerance=TOLERANCE))
        x = np.array([now.points[n].coordinates for n in free])
        differences.append(_by_part((x - end) / sigma))
        steps.append(_by_part((x - before) / sigma))
        before = x
    return PlanHeight(now, simultaneous, np.array(differences), np.array(steps))


def _by_part(moved: Array) -> tuple[float, float]:
    return float(np.abs(moved[:, :2]).max()), float(np.abs(moved[:, 2]).max())


def _started(network: Network) -> Network:
    """Return the network with values of all frames, points and photos."""
    equations = compile_network(network)
    state = approximate(equations)
    out = network.copy()
    unknowns = equations.unknowns
    for i, name in enumerate(network.points):
        out.points[name] = replace(
            out.points[name], coordinates=tuple(unknowns.given(state, "point", i).tolist())
        )
    for i, name in enumerate(unknowns["frame"].names):
        values = tuple(unknowns.given(state, "frame", i).tolist())
        out.frames[name] = replace(out.frames[name], values=values)
    for i, name in enumerate(network.photos):
        stored = state["pose"][i]
        out.photos[name] = replace(
            out.photos[name],
            position=tuple(stored[9:].tolist()),
            rotation=stored[:9].reshape(3, 3),
        )
    return out


def _half(
    network: Network,
    free: tuple[str, ...],
    *,
    held: str,
    axes: Callable[[FrameCoordinate], str],
) -> Network:
    """Return the network with some components of its frames free and some coordinates held."""
    out = network.copy()
    for name, p in network.points.items():
        on = tuple(f or a in held for f, a in zip(p.fixed, "xyz", strict=True))
        sigma = None
        if p.sigma is not None:
            kept = [np.inf if a in held else s for s, a in zip(p.sigma, "xyz", strict=True)]
            sigma = (kept[0], kept[1], kept[2])
        out.points[name] = replace(p, fixed=(on[0], on[1], on[2]), sigma=sigma)
    names = UNKNOWNS["frame"].names()
    for name, f in network.frames.items():
        flags = tuple(h or n not in free for n, h in zip(names, f.fixed, strict=True))
        sigma_f = tuple(s if n in free else np.inf for n, s in zip(names, f.sigma, strict=True))
        out.frames[name] = replace(f, fixed=flags, sigma=sigma_f)
    rows = _cut(network, out, axes)
    out.clusters = [
        (tuple(i for i in ids if i in out.observations), c[np.ix_(keep, keep)])
        for ids, c in network.clusters
        if len(keep := _kept(network, ids, rows))
    ]
    if not any(o.photos() for o in out.observations.values()):
        out.photos, out.photo_number = {}, {}
    return out


def _cut(
    network: Network, out: Network, axes: Callable[[FrameCoordinate], str]
) -> dict[str, list[int]]:
    """Keep only some axes of the coordinates; return the rows that are kept, by id."""
    rows: dict[str, list[int]] = {}
    out.observations = {}
    for ident, o in network.observations.items():
        if not isinstance(o, FrameCoordinate):
            what = "a block in plan and height has coordinates in frames and held points alone"
            raise InputError(Problem(what, o.label()))
        wanted = axes(o)
        keep = [i for i, a in enumerate(o.axes) if a in wanted]
        rows[ident] = keep
        if not keep:
            continue
        covariance = None if o.covariance is None else o.covariance[np.ix_(keep, keep)]
        out.observations[ident] = replace(
            o,
            axes="".join(o.axes[i] for i in keep),
            value=tuple(o.value[i] for i in keep),
            sigma=None if o.sigma is None else tuple(o.sigma[i] for i in keep),
            covariance=covariance,
        )
    return rows


def _kept(network: Network, ids: tuple[str, ...], rows: dict[str, list[int]]) -> list[int]:
    """Return the rows of a correlated group that are kept."""
    found, first = [], 0
    for ident in ids:
        found += [first + i for i in rows[ident]]
        first += len(network.observations[ident].component_names())
    return found


def _taken_over(network: Network, solution: Solution) -> Network:
    """Return the network with adjusted values as given ones."""
    out, adjusted = network.copy(), solution.as_network()
    for name, p in adjusted.points.items():
        out.points[name] = replace(out.points[name], coordinates=p.coordinates)
    for name, f in adjusted.frames.items():
        out.frames[name] = replace(out.frames[name], values=f.values)
    for name, photo in adjusted.photos.items():
        out.photos[name] = replace(out.photos[name], position=photo.position)
    return out
