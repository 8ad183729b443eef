"""Points that their observations leave free in a direction, or determine at two places.

At the given coordinates the partials J of all observations of a point, whitened, say how well they
determine it if everything else is known: σ of its weakest direction d is 1/√λ with the smallest
eigenvalue λ of JᵀJ. In truth it is no better. Where stations lie in a plane with the point, or in
line with it, λ is zero across the plane, or along the line.

Distances change with the square of a step across the plane of their stations. With a = J d and the
second derivatives b along d, a step t changes the observations by a t + b t²/2: at the step
t = −2 (a·b)/|b|² they are as they were. A point near the plane has this second place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import wrap
from ..models.unknown_registry import UNKNOWNS
from ..observations import KINDS
from ..statistical_tests import TOLERANCE_IN_SIGMAS
from ..types import Array, Mask
from .findings import Finding

MIN_TOLERANCE_SHARE = 0.05
"""Smallest tolerance along the weakest direction, relative to the distance of the nearest point
with which it is observed, of a point that is reported."""
MAX_SECOND_PLACE_SHARE = 0.05
"""Largest distance of a second place that is reported, relative to the same: approximate
coordinates distinguish places that are farther from each other."""
MAX_SECOND_PLACE_MISFIT_RATIO = 0.1
"""Largest misfit at a second place, relative to that of the linear model there."""
DIFFERENCE_STEP_SHARE = 1e-3
"""Step of the second differences, relative to the same."""
SINGULAR_EIGENVALUE_RATIO = 1e-12
"""Smallest eigenvalue, relative to the largest, that is not zero but for rounding."""
UNDETERMINED_REMEDY = (
    "observe it from a station that is not in a plane or in line with it and the others, or "
    "another quantity (height, direction, distance)"
)
MIN_VERTICAL_COMPONENT = 0.9
"""Smallest vertical component of a direction that is called the height."""


def weakly_determined_points(equations: Equations) -> Iterator[Finding]:
    """Iterate over points that are undetermined, or have two places, by given coordinates.

    Only points are looked at of which everything that they are observed with has coordinates.
    Points of photos are left out: far ones intersect poorly.
    """
    table = equations.unknowns["point"]
    of = _Observed.of(equations)
    numbers = np.flatnonzero(of.whole & table.free.any(axis=1))
    if not len(numbers):
        return
    normal = of.normal[numbers]
    # A held component has no row and no column, and is no weak direction.
    held = ~table.free[numbers]
    normal[held] = 0.0
    np.swapaxes(normal, 1, 2)[held] = 0.0
    which, axis = np.nonzero(held)
    normal[which, axis, axis] = np.trace(normal, axis1=1, axis2=2)[which]
    values, vectors = np.linalg.eigh(normal)
    weak = values[:, 0] <= SINGULAR_EIGENVALUE_RATIO * values[:, -1]
    sigma = 1.0 / np.sqrt(np.where(weak, np.nan, values[:, 0]))
    sigma = np.where(weak, np.inf, sigma)
    nearest = of.nearest[numbers]
    # A weighted coordinate may be as poor as that on purpose, unless it says nothing.
    part = np.where(of.weighted[numbers], 1.0, MIN_TOLERANCE_SHARE)
    free = TOLERANCE_IN_SIGMAS * sigma > part * nearest
    step = np.zeros((len(table.names), 3))
    step[numbers] = vectors[:, :, 0] * nearest[:, None]
    way, misfit = of.second_places(step)
    apart = np.abs(way[numbers])
    with np.errstate(invalid="ignore"):
        straight = np.square(apart * nearest / sigma)  # the misfit there if nothing were curved
    two = (
        ~free
        & (apart < MAX_SECOND_PLACE_SHARE)
        & (
            misfit[numbers]
            < np.minimum(TOLERANCE_IN_SIGMAS**2, MAX_SECOND_PLACE_MISFIT_RATIO * straight)
        )
    )
    for i in np.flatnonzero(free | two).tolist():
        name, at = table.names[numbers[i]], table.values[numbers[i]]
        if free[i]:
            along = _named(equations, at, vectors[i, :, 0])
            yield Finding(
                f"by the given coordinates, what is observed of point {name!r} determines it "
                f"{'not' if weak[i] else 'hardly'} {along}",
                UNDETERMINED_REMEDY,
                np.nan if weak[i] else TOLERANCE_IN_SIGMAS * float(sigma[i]),
                unit="m",
            )
        else:
            there = at + way[numbers[i]] * step[numbers[i]]
            place = ", ".join(f"{x:.2f}" for x in there)
            yield Finding(
                f"by the given coordinates, what is observed of point {name!r} fits as well near "
                f"({place}), on the other side of the plane or line of its stations",
                f"make sure on which side it lies, or {UNDETERMINED_REMEDY}",
                float(apart[i] * nearest[i]),
                unit="m",
            )


def _named(equations: Equations, at: Array, direction: Array) -> str:
    """Return a direction in words."""
    enu = equations.network.frame.basis(at[None, :], np.zeros((1, 2))).enu[0] @ direction
    if abs(enu[2]) > MIN_VERTICAL_COMPONENT:
        return "in height"
    east, north, up = np.round(enu * np.sign(enu[np.argmax(np.abs(enu))]), 2) + 0.0
    return f"along east {east:.2f}, north {north:.2f}, up {up:.2f}"


@dataclass(frozen=True)
class _Ends:
    """Observations at one of the points that they join."""

    block: Block
    """The observations, (n, d)."""
    place: int
    """Place of the point among the variables of the model."""


@dataclass(frozen=True)
class _Observed:
    """What is observed of the points; arrays over all points."""

    equations: Equations
    """The observation equations."""
    state: State
    """Given values; 0 for unknown parameters."""
    ends: tuple[_Ends, ...]
    """The observations of the points."""
    whole: Mask
    """Whether a point has coordinates, and everything that it is observed with, (p,)."""
    weighted: Mask
    """Whether a coordinate is a weighted unknown, (p,)."""
    normal: Array
    """JᵀJ, (p, 3, 3)."""
    nearest: Array
    """Distance of the nearest point that a point is observed with, (p,) metres."""

    @classmethod
    def of(cls, equations: Equations) -> _Observed:
        """Return what is observed of the points of a network."""
        given = equations.unknowns.start()
        state = {k: np.nan_to_num(v) for k, v in given.items()}
        n = len(given["point"])
        there: Mask = np.asarray(np.isfinite(given["point"]).all(axis=1))
        whole, weighted = there.copy(), np.zeros(n, dtype=bool)
        normal, nearest = np.zeros((n, 3, 3)), np.full(n, np.inf)
        ends: list[_Ends] = []
        for block in equations.blocks:
            points = [(j, i) for j, (kind, i) in enumerate(block.variables) if kind == "point"]
            fine = np.ones(block.n, dtype=bool)
            for kind, index in block.variables:
                if kind == "point":
                    fine &= there[index]
                elif UNKNOWNS[kind].rotates:  # without its rotation nothing can be computed
                    fine &= np.isfinite(given[kind][index]).all(axis=1) & (kind != "pose")
            for _, index in points:
                whole[index[~fine]] = False
                weighted[index] |= block.prior
            rows = np.flatnonzero(fine)
            if not points or not len(rows):
                continue
            part = block.select(rows)
            try:
                jacobians = part.evaluate(equations.network.frame, state).jacobians
            except InputError:  # a sight without length, which `check` refuses
                for _, index in points:
                    whole[index] = False
                continue
            for j, index in points:
                a = part.whiten(jacobians[j])
                np.add.at(normal, index[rows], np.einsum("ndi,ndj->nij", a, a))
                # What is linear says nothing of planes and lines of stations, however near it is.
                straight = block.kind in KINDS and KINDS[block.kind].linear
                away = [
                    np.linalg.norm(state["point"][index] - state["point"][other], axis=1)[rows]
                    for k, other in points
                    if k != j and not straight
                ]
                others = np.min(away, axis=0) if away else np.full(len(rows), np.inf)
                np.minimum.at(nearest, index[rows], others)
                ends.append(_Ends(part, j))
        whole &= np.isfinite(nearest) & (nearest > 0.0)
        return cls(equations, state, tuple(ends), whole, weighted, normal, nearest)

    def second_places(self, step: Array) -> tuple[Array, Array]:
        """Return where observations are as they are, along a step, and their misfit there.

        Args:
            step: a step of each point, (p, 3) metres; 0 for points that are not asked for.

        Returns:
            Multiples of the step, (p,), infinite where there are none, and the square sum of the
            changes of the whitened observations there, (p,).
        """
        n = len(step)
        along, curved, misfit = np.zeros(n), np.zeros(n), np.zeros(n)
        asked = np.any(step != 0.0, axis=1)
        small = DIFFERENCE_STEP_SHARE * step
        for e in self.ends:
            forth, back = (self._change(e, asked, way) for way in (small, -small))
            index = e.block.variables[e.place][1]
            a, b = (
                0.5 * (forth - back) / DIFFERENCE_STEP_SHARE,
                (forth + back) / DIFFERENCE_STEP_SHARE**2,
            )
            np.add.at(along, index, np.sum(a * b, axis=1))
            np.add.at(curved, index, np.sum(b * b, axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            way = np.where(curved > 0.0, -2.0 * along / curved, np.inf)
        near = asked & (np.abs(way) < MAX_SECOND_PLACE_SHARE)
        for e in self.ends:
            change = self._change(e, near, np.where(near, way, 0.0)[:, None] * step)
            np.add.at(misfit, e.block.variables[e.place][1], np.sum(change * change, axis=1))
        return way, misfit

    def _change(self, e: _Ends, asked: Mask, step: Array) -> Array:
        """Return by how much whitened observations change if their points move, (n, d)."""
        out = np.zeros(e.block.observed.shape)
        rows = np.flatnonzero(asked[e.block.variables[e.place][1]])
        if not len(rows):
            return out
        part = e.block.select(rows)
        n = len(step)
        variables = list(part.variables)
        variables[e.place] = ("point", variables[e.place][1] + n)
        moved = replace(part, variables=tuple(variables))
        points = self.state["point"]
        state = {**self.state, "point": np.concatenate([points, points + step])}
        frame = self.equations.network.frame
        change = (
            moved.evaluate(frame, state, jacobians=False).residual
            - part.evaluate(frame, state, jacobians=False).residual
        )
        out[rows] = part.whiten(wrap(change) if part.unit == "rad" else change)
        return out
