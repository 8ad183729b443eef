"""The place of a part by everything that is observed between its points and photos.

A similarity X = c + s R (x − x̄) is fitted to all observations but image coordinates that touch
points and photos of the part, by the models of the library: heights, GNSS vectors, levelled
differences, zenith angles, azimuths, distances, known components. What they leave open stays as it
was; the rank of their partials by the seven parameters says how much that is.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ..approximate.orientation import orient_by_model
from ..errors import AdjustmentError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import DegenerateError
from ..observations.registry import KINDS
from ..rotation import exp_rotation
from ..types import Array, Mask
from .growth import Growth
from .known import Known
from .similarity import Similarity, even_rotations

OF_SIZE = 1e-4
"""Standard deviation of a known coordinate, part of the extent of the block."""
ROBUST = 10.0
"""Multiple of the standard deviation beyond which a residual counts by its size."""
RANK = 1e-7
"""Smallest singular value of the partials, relative to the largest, of a parameter that is
determined; columns are scaled to the size of the block first."""
ROUGH, FINE = 10, 60
"""Largest numbers of evaluations of a fit, from every rotation and from the best ones."""
REFINED = 4
"""Number of rotations from which the fit goes on."""
MOST = 400
"""Largest number of observations of a block of the equations that are fitted."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A similarity that was fitted to observations."""

    to_frame: Similarity
    """From the axes of the part to those of the network."""
    open: int
    """Number of the seven parameters that the observations leave open."""
    words: str
    """What it was fitted to."""


def fit(growth: Growth, equations: Equations, known: Known, first: Similarity) -> Fitted | None:
    """Fit the place of a part to the observations that touch it.

    Args:
        growth: the part.
        equations: the network in arrays.
        known: coordinates and attitudes, NaN where unknown.
        first: scale and shift from which the fit starts; what is not determined stays.

    Returns:
        None: nothing is observed that depends on the place of the part.
    """
    rows = _rows(growth, equations, known)
    if rows is None:
        return None
    trials = [
        found
        for turn in even_rotations()
        if (found := rows.solved(turn @ first.rotation, np.zeros(7), first, ROUGH)) is not None
    ]
    # The identity comes first: what nothing determines stays as it was.
    best: _Trial | None = None
    for rough in sorted(trials, key=lambda f: f.cost)[:REFINED]:
        found = rows.solved(rough.base, rough.p, first, FINE)
        if found is not None and (best is None or found.cost < (1.0 - 1e-6) * best.cost):
            best = found
    if best is None:
        return None
    base, p, jacobian = best.base, best.p, best.jacobian
    values = np.linalg.svd(jacobian, compute_uv=False)
    rank = int((values > RANK * values[0]).sum()) if values[0] > 0 else 0
    if not rank:
        return None
    return Fitted(rows.similarity(p, base, first), 7 - rank, rows.words)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A fit from one rotation."""

    cost: float
    base: Array
    """Rotation about which the parameters turn, (3, 3)."""
    p: Array
    """Parameters, (7,)."""
    jacobian: Array


@dataclass(eq=False)
class _Rows:
    """Observations of a part, and known places."""

    equations: Equations
    state: State
    """Values of all variables; those of the part are replaced."""
    chosen: list[Block]
    """Rows of blocks."""
    oriented: bool
    """Whether there are directions."""
    point: Array
    """Points in the axes of the part, (points, 3), NaN where the part does not have them."""
    pose: Array
    """Stored poses in these axes, (photos, 12)."""
    places: tuple[Array, Array]
    """Known places in the axes of the part and in the frame, (k, 3) each, NaN where unknown."""
    attitudes: tuple[Array, Array]
    """Known attitudes in the axes of the part and in the frame, (k, 3, 3) each."""
    middle: Array
    """x̄, (3,)."""
    size: float
    """Extent of the part."""
    words: str

    def similarity(self, p: Array, base: Array, first: Similarity) -> Similarity:
        """Return the similarity of seven parameters: rotation, change of scale, shift."""
        rotation = base @ exp_rotation(p[:3])
        scale = first.scale * (1.0 + p[3])
        centre = first.of(self.middle[None])[0] + first.scale * self.size * p[4:]
        return Similarity(scale, rotation, centre - scale * rotation @ self.middle)

    def solved(self, base: Array, p: Array, first: Similarity, most: int) -> _Trial | None:
        """Minimise the misfits from a rotation and parameters; none: nothing can be computed."""
        from scipy.optimize import least_squares  # local, because it takes long to import

        try:
            found = least_squares(
                self.misfit,
                p,
                args=(base, first),
                loss="soft_l1",
                f_scale=ROBUST,
                x_scale="jac",
                max_nfev=most,
            )
        except (AdjustmentError, DegenerateError, ValueError):
            return None
        if found.x[3] <= -1.0 or not np.isfinite(found.cost):
            return None
        return _Trial(float(found.cost), base, found.x, np.asarray(found.jac, dtype=float))

    def misfit(self, p: Array, base: Array, first: Similarity) -> Array:
        """Return the whitened residuals of all rows."""
        at = self.similarity(p, base, first)
        state = dict(self.state)
        own = np.isfinite(self.point[:, 0])
        state["point"] = state["point"].copy()
        state["point"][own] = at.of(self.point[own])
        own = np.isfinite(self.pose[:, 0])
        state["pose"] = state["pose"].copy()
        state["pose"][own] = at.of_poses(self.pose[own])
        if self.oriented:
            orient_by_model(self.equations, state)
        state["orientation"] = np.nan_to_num(state["orientation"])
        out = []
        for block in self.chosen:
            v = block.evaluate(self.equations.network.frame, state, jacobians=False).residual
            out.append(block.whiten(v).ravel())
        turned, given = self.attitudes
        out.append(((at.rotation @ turned - given) / OF_SIZE).ravel())
        x, y = self.places
        off = (at.of(x) - y) / (OF_SIZE * first.scale * self.size)
        out.append(off[np.isfinite(off)])
        return np.clip(np.nan_to_num(np.concatenate(out), nan=1e9, posinf=1e9), -1e9, 1e9)


def _rows(growth: Growth, equations: Equations, known: Known) -> _Rows | None:
    """Return what is observed of a part; none: nothing is."""
    start = equations.unknowns.start()
    state = {kind: values.copy() for kind, values in start.items()}
    state["vertical"] = np.nan_to_num(state["vertical"])
    there = {"point": growth.placed, "pose": growth.posed}
    counted: Counter[str] = Counter()
    chosen: list[Block] = []
    for block in equations.blocks:
        if block.lens is not None or block.model is None:
            continue
        fine = np.ones(block.n, dtype=bool)
        own = np.zeros(block.n, dtype=bool)
        for kind, index in block.variables:
            if kind in there:
                fine &= there[kind][index]
                own |= there[kind][index]
            elif kind != "orientation":
                fine &= np.all(np.isfinite(state[kind][index]), axis=1)
        rows = np.flatnonzero(fine & own)
        if len(rows) > MOST:
            rows = rows[np.linspace(0, len(rows) - 1, MOST).astype(int)]
        if len(rows):
            chosen.append(block.select(rows))
            counted[_noun(block.kind, prior=block.prior)] += len(rows)
    x = np.concatenate([growth.point, growth.pose[:, 9:]])
    y = np.concatenate([known.point, known.pose[:, 9:]])
    places: Mask = np.isfinite(x).all(axis=1) & np.isfinite(y).any(axis=1)
    if not chosen:
        return None
    attitude: Mask = np.asarray(np.isfinite(known.pose[:, :9]).all(axis=1))
    posed = growth.posed & attitude
    attitudes = (growth.pose[posed, :9].reshape(-1, 3, 3), known.pose[posed, :9].reshape(-1, 3, 3))
    # A part may consist of photos alone, whose rays meet nowhere yet.
    at = growth.point[growth.placed] if growth.placed.any() else growth.pose[growth.posed, 9:]
    middle = np.median(at, axis=0)
    size = float(np.median(np.linalg.norm(at - middle, axis=1))) or 1.0
    if places.any():
        counted["places with known coordinates"] = int(places.sum())
    words = ", ".join(f"{n} {what}" for what, n in counted.items())
    return _Rows(
        equations,
        state,
        chosen,
        any(b.kind == "direction" for b in chosen),
        growth.point,
        growth.pose,
        (x[places], y[places]),
        attitudes,
        middle,
        size,
        words,
    )


def _noun(kind: str, *, prior: bool) -> str:
    if prior or kind not in KINDS:
        return "given values"
    return f"{kind.replace('_', ' ')} observations"
