"""The place of a part of a block in the frame of the network, and how it was found.

Known coordinates, attitudes, lengths and rays to known points come first. Otherwise a similarity X
= c + s R (x − x̄) is fitted to all observations but image coordinates that touch points and photos
of the part, by the models of the library: heights, GNSS vectors, levelled differences, zenith
angles, azimuths, distances, known components. What they leave open stays as it was; the rank of
their partials by the seven parameters says how much that is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import AdjustmentError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import DegenerateError
from ..models.similarity import Similarity, fit_similarity
from ..observations.registry import KINDS
from ..rotation import exp_rotation, nearest_rotation
from ..start.polar_points import orient_sets_by_model
from ..types import Array, Mask
from .block_input import KnownLength, KnownPlaces
from .partial_block import PartialBlock
from .robust_similarity import (
    even_rotations,
    in_one_line,
    robust_similarity,
    scales_by_rays,
    similarity_from_components,
    similarity_from_rays,
    similarity_with_rotation,
)

RELATIVE_SIGMA_OF_KNOWN_PLACE = 1e-4
"""Standard deviation of a known coordinate, part of the extent of the block."""
MAX_QUADRATIC_RESIDUAL = 10.0
"""Multiple of the standard deviation beyond which a residual counts by its size."""
MIN_SINGULAR_RATIO_OF_PLACEMENT = 1e-7
"""Smallest singular value of the partials, relative to the largest, of a parameter that is
determined; columns are scaled to the size of the block first."""
MAX_ROUGH_EVALUATIONS, MAX_FINE_EVALUATIONS = 10, 60
"""Largest numbers of evaluations of a fit, from every rotation and from the best ones."""
MAX_REFINED_ROTATIONS = 4
"""Number of rotations from which the fit goes on."""
MAX_FITTED_OBSERVATIONS = 400
"""Largest number of observations of a block of the equations that are fitted."""
MIN_POINTS_OF_ROTATION = 3
"""Number of known points, not in one line, that give the rotation of a part."""
OPEN_PARAMETERS_WITH_SCALE = 6
"""Number of open parameters of a part of which only the scale is known."""
UNIT_BASE_IN_WORDS = "the base of the start pair has the length 1"
NO_COORDINATES_IN_WORDS = "no known coordinates"


@dataclass(frozen=True, eq=False)
class FittedPlacement:
    """A similarity that was fitted to observations."""

    to_frame: Similarity
    """From the axes of the part to those of the network."""
    open: int
    """Number of the seven parameters that the observations leave open."""
    words: str
    """What it was fitted to."""


def fit_placement(
    growth: PartialBlock, equations: Equations, known: KnownPlaces, first: Similarity
) -> FittedPlacement | None:
    """Fit the place of a part to the observations that touch it.

    Args:
        growth: the part.
        equations: the network in arrays.
        known: coordinates and attitudes, NaN where unknown.
        first: scale and shift from which the fit starts; what is not determined stays.

    Returns:
        None: nothing is observed that depends on the place of the part.
    """
    rows = _placement_rows(growth, equations, known)
    if rows is None:
        return None
    trials = [
        found
        for turn in even_rotations()
        if (found := rows.solved(turn @ first.rotation, np.zeros(7), first, MAX_ROUGH_EVALUATIONS))
        is not None
    ]
    # The identity comes first: what nothing determines stays as it was.
    best: _Trial | None = None
    for rough in sorted(trials, key=lambda f: f.cost)[:MAX_REFINED_ROTATIONS]:
        found = rows.solved(rough.base, rough.p, first, MAX_FINE_EVALUATIONS)
        if found is not None and (best is None or found.cost < (1.0 - 1e-6) * best.cost):
            best = found
    if best is None:
        return None
    base, p, jacobian = best.base, best.p, best.jacobian
    values = np.linalg.svd(jacobian, compute_uv=False)
    rank = int((values > MIN_SINGULAR_RATIO_OF_PLACEMENT * values[0]).sum()) if values[0] > 0 else 0
    if not rank:
        return None
    return FittedPlacement(rows.similarity(p, base, first), 7 - rank, rows.words)


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
class _PlacementRows:
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
                f_scale=MAX_QUADRATIC_RESIDUAL,
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
            orient_sets_by_model(self.equations, state)
        state["orientation"] = np.nan_to_num(state["orientation"])
        out = []
        for block in self.chosen:
            v = block.evaluate(self.equations.network.frame, state, jacobians=False).residual
            out.append(block.whiten(v).ravel())
        turned, given = self.attitudes
        out.append(((at.rotation @ turned - given) / RELATIVE_SIGMA_OF_KNOWN_PLACE).ravel())
        x, y = self.places
        off = (at.of(x) - y) / (RELATIVE_SIGMA_OF_KNOWN_PLACE * first.scale * self.size)
        out.append(off[np.isfinite(off)])
        return np.clip(np.nan_to_num(np.concatenate(out), nan=1e9, posinf=1e9), -1e9, 1e9)


def _placement_rows(
    growth: PartialBlock, equations: Equations, known: KnownPlaces
) -> _PlacementRows | None:
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
        if len(rows) > MAX_FITTED_OBSERVATIONS:
            rows = rows[np.linspace(0, len(rows) - 1, MAX_FITTED_OBSERVATIONS).astype(int)]
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
    return _PlacementRows(
        equations,
        state,
        chosen,
        any(b.quantity == "direction" for b in chosen),
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


@dataclass(frozen=True, eq=False)
class PartPlacement:
    """The transformation of a part, and what it was found from."""

    to_frame: Similarity
    """From the axes of the part to those of the network."""
    words: str
    """What gave scale, rotation and shift."""
    complete: bool
    """Whether scale, rotation and shift were all found."""
    misfits: Array
    """Distance of each known place from its given one, metres, (points + photos,); NaN: unknown."""


def place_part(
    growth: PartialBlock,
    equations: Equations,
    known: KnownPlaces,
    lengths: Sequence[KnownLength],
    joined: Mask,
) -> PartPlacement:
    """Find the transformation of a part into the frame of the network.

    Args:
        growth: the part.
        equations: the network in arrays.
        known: coordinates and attitudes, NaN where unknown.
        lengths: known lengths.
        joined: known points that earlier parts found, (points,), for the words.

    Returns:
        The best transformation; what nothing gives is left as it is in the part.
    """
    x = np.concatenate([growth.point, growth.pose[:, 9:]])
    y = np.concatenate([known.point, known.pose[:, 9:]])
    there = np.isfinite(x).all(axis=1)
    full = there & np.isfinite(y).all(axis=1)
    some = there & np.isfinite(y).any(axis=1)
    words = _counted(full, len(growth.point), joined)
    found: Similarity | None = None
    complete = True
    if (
        full.sum() >= MIN_POINTS_OF_ROTATION
        and (robust := robust_similarity(x[full], y[full])) is not None
    ):
        found = robust[0]
    if found is None and (rotation := _known_rotation(growth, known)) is not None:
        found = similarity_with_rotation(x[some], y[some], rotation)
        words = f"attitudes, and {words}"
        if found is None:
            by_rays: list[float] = []
            if full.any():
                at = int(np.flatnonzero(full)[0])
                by_rays = scales_by_rays(growth, known, rotation, (x[at], y[at]))
            found, said = _by_lengths(growth, lengths, rotation, x[full], y[full], by_rays)
            words, complete = f"{words}; {said}", bool(full.any()) and said != UNIT_BASE_IN_WORDS
    if found is None and (found := similarity_from_components(x[some], y[some])) is not None:
        words = f"{int(np.isfinite(y[some]).sum())} known coordinates of {int(some.sum())} places"
    if found is None and (by_single := similarity_from_rays(growth, known)) is not None:
        found, n_rays = by_single
        words = f"{n_rays} rays to known points"
    if found is None:
        complete = False
        found, words = _incomplete(growth, lengths, x[full], y[full], words)
    fitted = None if complete else fit_placement(growth, equations, known, found)
    if fitted is not None and fitted.open < OPEN_PARAMETERS_WITH_SCALE:
        found, complete = fitted.to_frame, fitted.open == 0
        words = fitted.words if complete else f"{fitted.words}; {fitted.open} of 7 stay open"
    misfits = np.full(len(x), np.nan)
    misfits[full] = np.linalg.norm(found.of(x[full]) - y[full], axis=1)
    return PartPlacement(found, words, complete, misfits)


def _incomplete(
    growth: PartialBlock, lengths: Sequence[KnownLength], x: Array, y: Array, words: str
) -> tuple[Similarity, str]:
    """Return scale and shift from what there is, and words."""
    if len(x) >= 2 and in_one_line(y) and (pair := fit_similarity(x, y)).scale > 0:
        return pair, f"{words} in one line, which leave a rotation open"
    found, said = _by_lengths(growth, lengths, np.eye(3), x, y)
    return found, f"{words}; {said}"


def _by_lengths(
    growth: PartialBlock,
    lengths: Sequence[KnownLength],
    rotation: Array,
    x: Array,
    y: Array,
    by_rays: Sequence[float] = (),
) -> tuple[Similarity, str]:
    """Return a transformation with the scale of known lengths, or of rays, and words."""
    ratios = []
    for length in lengths:
        at = growth.point if length.between == "point" else growth.pose[:, 9:]
        size = float(np.linalg.norm(at[length.ends[0]] - at[length.ends[1]]))
        if np.isfinite(size) and size > 0:
            ratios.append(length.value / size)
    scale, said = 1.0, UNIT_BASE_IN_WORDS
    if ratios:
        scale = float(np.median(ratios))
        said = f"scale from {len(ratios)} known length{'s' * (len(ratios) > 1)}"
    elif by_rays:
        scale, said = float(np.median(by_rays)), f"scale from {len(by_rays)} rays that leave it"
    shift = np.zeros(3)
    if len(x):
        shift = (y - scale * x @ rotation.T).mean(axis=0)
    return Similarity(scale, rotation, shift), said


def _known_rotation(growth: PartialBlock, known: KnownPlaces) -> Array | None:
    """Return the rotation of a part from photos with known attitude; none: there are none."""
    rows = np.flatnonzero(growth.posed & np.isfinite(known.pose[:, :9]).all(axis=1))
    if not len(rows):
        return None
    ours = growth.pose[rows, :9].reshape(-1, 3, 3)
    theirs = known.pose[rows, :9].reshape(-1, 3, 3)
    return nearest_rotation((theirs @ ours.transpose(0, 2, 1)).mean(axis=0))


def _counted(full: Mask, n_points: int, joined: Mask) -> str:
    """Return how many known points and photos there are."""
    points = full[:n_points]
    own, shared = int((points & ~joined).sum()), int((points & joined).sum())
    parts = []
    if own:
        parts.append(f"{own} known point{'s' * (own > 1)}")
    if shared:
        parts.append(f"{shared} point{'s' * (shared > 1)} of the parts before")
    if n := int(full[n_points:].sum()):
        parts.append(f"{n} known projection centre{'s' * (n > 1)}")
    return " and ".join(parts) or NO_COORDINATES_IN_WORDS
