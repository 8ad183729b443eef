"""The place of a part of a block in the frame of the network, and how it was found.

Known coordinates, attitudes, lengths and rays to known points come first. Otherwise a similarity X
= c + s R (x − x̄) is fitted to all observations but image coordinates that touch points and photos
of the part, by the models of the library: heights, GNSS vectors, levelled differences, zenith
angles, azimuths, distances, known components. What they leave open stays as it was; the rank of
their partials by the seven parameters says how much that is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError
from ..frames import Frame
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import Linearised
from ..models.similarity import Similarity, fit_similarity
from ..models.unknown_registry import VariableKind
from ..observations.registry import KINDS
from ..rotation import exp_rotation, nearest_rotation, right_jacobian, skew
from ..start.damped_fit import DampedFit, damped_fits
from ..start.polar_points import orient_sets_by_model
from ..types import NO_ROWS, Array, Index, Mask
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
MAX_ROUGH_STEPS, MAX_FINE_STEPS = 10, 60
"""Largest numbers of steps of a fit, from every rotation and from the best ones."""
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
    # The identity comes first: what nothing determines stays as it was.
    bases = np.array(even_rotations()) @ first.rotation
    rough = rows.fitted(bases, np.zeros((len(bases), 7)), first, MAX_ROUGH_STEPS)
    order = np.argsort([f.cost for f in rough], kind="stable")[:MAX_REFINED_ROTATIONS]
    bases = bases[order]
    fine = rows.fitted(bases, np.array([rough[i].values for i in order]), first, MAX_FINE_STEPS)
    best = 0
    for i, found in enumerate(fine):
        if found.cost < (1.0 - 1e-6) * fine[best].cost:
            best = i
    if not np.isfinite(fine[best].cost):
        return None
    values = np.linalg.svd(fine[best].partials, compute_uv=False)
    rank = int((values > MIN_SINGULAR_RATIO_OF_PLACEMENT * values[0]).sum()) if values[0] > 0 else 0
    if not rank:
        return None
    scale, rotation, shift = rows.similarities(fine[best].values[None], bases[best][None], first)
    return FittedPlacement(Similarity(float(scale[0]), rotation[0], shift[0]), 7 - rank, rows.words)


@dataclass(eq=False)
class _PlacementRows:
    """Observations of a part, and known places."""

    frame: Frame
    chosen: list[Block]
    """Rows of blocks."""
    orienting: list[Block]
    """Directions that give the orientations of sets."""
    state: State
    """Values of their variables; those of the part are replaced."""
    point: Array
    """These points in the axes of the part, (points, 3), NaN where the part does not have them."""
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

    def similarities(self, p: Array, base: Array, first: Similarity) -> tuple[Array, Array, Array]:
        """Return scales (k,), rotations (k, 3, 3) and shifts (k, 3) of seven parameters (k, 7).

        The parameters are a rotation about a base (k, 3, 3), a change of scale, and a shift.
        """
        rotation = base @ exp_rotation(p[:, :3])
        scale = first.scale * (1.0 + p[:, 3])
        centre = first.of(self.middle[None]) + first.scale * self.size * p[:, 4:]
        return scale, rotation, centre - scale[:, None] * (rotation @ self.middle)

    def fitted(self, base: Array, p: Array, first: Similarity, most: int) -> list[DampedFit[Array]]:
        """Minimise the misfits from rotations (k, 3, 3) and parameters (k, 7)."""

        def system(p: Array, start: Index) -> tuple[Array, Array]:
            return self.misfits(p, base[start], first)

        return damped_fits(p, system, most, bound=MAX_QUADRATIC_RESIDUAL)

    def misfits(self, p: Array, base: Array, first: Similarity) -> tuple[Array, Array]:
        """Return whitened residuals (k, n) and their partials (k, n, 7) by the parameters (k, 7).

        Residuals are infinite where they cannot be computed.
        """
        with suppress(AdjustmentError):
            return self._misfits(p, base, first)
        if len(p) == 1:
            return np.full((1, self.n), np.inf), np.zeros((1, self.n, 7))
        half = len(p) // 2
        halves = (self.misfits(p[at], base[at], first) for at in (slice(half), slice(half, None)))
        v, a = zip(*halves, strict=True)
        return np.concatenate(v), np.concatenate(a)

    @property
    def n(self) -> int:
        """Number of residuals."""
        read = sum(b.observed.size for b in self.chosen)
        return read + self.attitudes[1].size + int(np.isfinite(self.places[1]).sum())

    def _misfits(self, p: Array, base: Array, first: Similarity) -> tuple[Array, Array]:
        k = len(p)
        scale, rotation, shift = self.similarities(p, base, first)
        turning = right_jacobian(p[:, :3])

        def moved(x: Array) -> tuple[Array, Array]:
            """Return places (k, m, 3) of places (m, 3), and their partials (k, m, 3, 7)."""
            turned = x @ rotation.swapaxes(1, 2)
            by = np.zeros((k, len(x), 3, 7))
            arm = skew(x - self.middle)
            by[..., :3] = -scale[:, None, None, None] * rotation[:, None] @ arm @ turning[:, None]
            by[..., 3] = first.scale * (turned - (rotation @ self.middle)[:, None])
            by[..., 4:] = first.scale * self.size * np.eye(3)
            return scale[:, None, None] * turned + shift[:, None], by

        sizes = {kind: len(values) for kind, values in self.state.items()}
        state = {kind: np.tile(values, (k, 1)) for kind, values in self.state.items()}
        partials: dict[VariableKind, Array] = {
            "point": np.zeros((k * len(self.point), 3, 7)),
            "pose": np.zeros((k * len(self.pose), 6, 7)),
        }
        for kind, values in (("point", self.point), ("pose", self.pose)):
            own = np.isfinite(values[:, -1])
            of_each = state[kind].reshape(k, *values.shape)
            by = partials[kind].reshape(k, len(values), *partials[kind].shape[1:])
            of_each[:, own, -3:], by[:, own, -3:] = moved(values[own, -3:])
            if kind == "pose":
                attitude = values[own, :9].reshape(-1, 3, 3)
                of_each[:, own, :9] = (rotation[:, None] @ attitude).reshape(k, -1, 9)
                by[:, own, :3, :3] = attitude.swapaxes(1, 2) @ turning[:, None]
        self._orient_sets(k, state, partials)
        v, a = [], []
        for block in (b.copies(k, sizes) for b in self.chosen):
            found = block.evaluate(self.frame, state)
            v.append(block.whiten(found.residual).reshape(k, -1))
            by = block.whiten(_by_parameters(block, found, partials))
            a.append(by.reshape(k, -1, 7))
        turned, given = self.attitudes
        off = (rotation[:, None] @ turned - given) / RELATIVE_SIGMA_OF_KNOWN_PLACE
        by = np.zeros((*off.shape, 7))
        # Each column of R is a vector t that turns: ∂(R t)/∂ω = −R [t]×.
        columns = skew(turned.swapaxes(1, 2))
        turns = -rotation[:, None, None] @ columns @ turning[:, None, None]
        by[..., :3] = turns.swapaxes(2, 3) / RELATIVE_SIGMA_OF_KNOWN_PLACE
        v.append(off.reshape(k, -1))
        a.append(by.reshape(k, -1, 7))
        x, y = self.places
        sigma = RELATIVE_SIGMA_OF_KNOWN_PLACE * first.scale * self.size
        there = np.isfinite(y)
        to, by = moved(x)
        v.append((to - y)[:, there] / sigma)
        a.append(by[:, there] / sigma)
        every = np.clip(np.nan_to_num(np.concatenate(v, axis=1), nan=1e9), -1e9, 1e9)
        return np.where(scale[:, None] > 0.0, every, np.inf), np.concatenate(a, axis=1)

    def _orient_sets(self, k: int, state: State, partials: dict[VariableKind, Array]) -> None:
        """Fill orientations, and their partials, which are those of the mean of the set."""
        if not self.orienting:
            return
        unknown = np.isnan(state["orientation"][:, 0])
        sizes = {kind: len(values) // k for kind, values in state.items()}
        blocks = [b.copies(k, sizes) for b in self.orienting]
        orient_sets_by_model(blocks, self.frame, state)
        state["orientation"] = np.nan_to_num(state["orientation"])
        total, count = np.zeros((len(unknown), 1, 7)), np.zeros(len(unknown))
        for block in blocks:
            group = block.variables[4][1]
            by = _by_parameters(block, block.evaluate(self.frame, state), partials)
            np.add.at(total, group, by)
            np.add.at(count, group, 1.0)
        total /= np.maximum(count, 1.0)[:, None, None]
        partials["orientation"] = np.where(unknown[:, None, None], total, 0.0)


def _by_parameters(
    block: Block, found: Linearised, partials: Mapping[VariableKind, Array]
) -> Array:
    """Return partials (n, d, 7) by parameters, given those of the variables (m, s, 7)."""
    out = np.zeros((*found.residual.shape, 7))
    for (kind, index), by in zip(block.variables, found.jacobians, strict=True):
        if kind in partials:
            out += by @ partials[kind][index]
    return out


def _placement_rows(
    growth: PartialBlock, equations: Equations, known: KnownPlaces
) -> _PlacementRows | None:
    """Return what is observed of a part; none: nothing is."""
    start = equations.unknowns.start()
    state = {**start, "vertical": np.nan_to_num(start["vertical"])}
    there = {"point": growth.placed, "pose": growth.posed}
    counted: Counter[str] = Counter()
    chosen: list[Block] = []
    orienting: list[Block] = []
    for block in equations.blocks:
        if block.lens is not None or block.model is None:
            continue
        whole, usable, own = (np.full(block.n, flag) for flag in (True, True, False))
        for kind, index in block.variables:
            finite = np.isfinite(state[kind][index]).all(axis=1)
            if kind in there:
                whole &= there[kind][index]
                usable &= there[kind][index] | finite
                own |= there[kind][index]
            elif kind != "orientation":
                whole &= finite
                usable &= finite
        rows = np.flatnonzero(whole & own)
        if not len(rows):
            continue
        if block.quantity == "direction":
            group = block.variables[4][1]
            of_sets = np.isin(group, group[rows])
            orienting.append(block.select(np.flatnonzero(usable & of_sets)))
        if len(rows) > MAX_FITTED_OBSERVATIONS:
            rows = rows[np.linspace(0, len(rows) - 1, MAX_FITTED_OBSERVATIONS).astype(int)]
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
    blocks, state, used = _compact([*chosen, *orienting], state)
    return _PlacementRows(
        equations.network.frame,
        blocks[: len(chosen)],
        blocks[len(chosen) :],
        state,
        growth.point[used["point"]],
        growth.pose[used["pose"]],
        (x[places], y[places]),
        attitudes,
        middle,
        size,
        words,
    )


def _compact(
    blocks: Sequence[Block], state: State
) -> tuple[list[Block], State, dict[VariableKind, Index]]:
    """Return blocks with the values of their variables alone, and the numbers of these before."""
    every: dict[VariableKind, list[Index]] = {"point": [], "pose": []}
    for block in blocks:
        for kind, index in block.variables:
            every.setdefault(kind, []).append(index)
    used = {kind: np.unique(np.concatenate([NO_ROWS, *of_kind])) for kind, of_kind in every.items()}
    out = [
        replace(b, variables=tuple((k, np.searchsorted(used[k], i)) for k, i in b.variables))
        for b in blocks
    ]
    return out, {kind: state[kind][numbers] for kind, numbers in used.items()}, used


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
