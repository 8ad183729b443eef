"""Misfit and cost of a start, and starts with the block moved by the similarity that fits.

Programs of structure from motion deliver poses and points that agree with each other, in axes and
with a scale of their own. The rays of known points are intersected in these axes, and the block is
brought into the frame of the network like a part that was oriented from image points.

Two measures say how far a start is from what control, positions, lengths and rays say. The relative
misfit is cheap and has no unit: a sample of every kind of observation shows whether a start is
grossly wrong. The robust cost compares starts of one network with each other, and takes every
observation once.

The relative misfit of an observation is |v| / ‖∂v/∂s‖, where s are the seven parameters of a
similarity of the photos and points that move: a shift in units of the typical depth, rotations in
radians, and the logarithm of the scale, all about the middle of these photos and points. It is the
part of the depth, of a radian or of a length by which the start is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError, ApproximationError
from ..frames import Frame
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import MaskState, State
from ..models.image import in_front
from ..models.similarity import Similarity
from ..network.network import DatumChoice
from ..rotation import exp_rotation, log_rotation
from ..start.approximate_values import approximate, partial_approximation
from ..types import Array, Index, Mask
from .block_growth import BlockPart
from .block_input import KnownPlaces, Views, given_places
from .block_orientation import Assembly
from .block_placement import PartPlacement
from .partial_block import GROWTH, PartialBlock

GROSS_START_MISFIT = 0.05
"""Median relative misfit of the observations of a kind above which a start is grossly wrong: 3° of
a ray, or 5 % of a length. An iteration converges from smaller ones."""
MAX_SAMPLED_OBSERVATIONS = 300
"""Largest number of observations of a kind from which its misfit is found."""
MIN_SIGNIFICANT_RESIDUAL = 30.0
"""Residual, in standard deviations, up to which an observation says nothing of a start. An
astronomic latitude hardly depends on its place: a vertical that is a few seconds off would count
as a gross misfit of the block."""
SIMILARITY_STEP = 1e-4
"""Change of the parameters of a similarity by which residuals are differentiated."""
MIN_RELATIVE_SENSITIVITY = 1e-9
"""Sensitivity, relative to the residual, below which a similarity does not change a residual."""
CAUCHY_RESIDUAL = 3.0
"""Residual, in standard deviations, from which an observation counts by the logarithm."""
RESIDUAL_BEHIND_CAMERA = 1e5
"""Residual, in standard deviations, of an image point whose object point is behind its camera."""
SMALL_SIMILARITIES: tuple[tuple[Array, Array, float], ...] = (
    *((np.zeros(3), e, 1.0) for e in np.eye(3) * SIMILARITY_STEP),
    *((e, np.zeros(3), 1.0) for e in np.eye(3) * SIMILARITY_STEP),
    (np.zeros(3), np.zeros(3), 1.0 + SIMILARITY_STEP),
)
"""Rotation, shift in typical depths and scale of each of the seven small similarities."""


@dataclass(frozen=True)
class StartMisfit:
    """The median relative misfit of observations of one kind."""

    what: str
    """The observations, in words."""
    median: float
    """Median of the relative misfits; infinite: most points are behind their cameras."""


def start_misfits(equations: Equations, state: State, static: MaskState) -> tuple[StartMisfit, ...]:
    """Return the median relative misfit of each kind of observation of a block of photos.

    Args:
        equations: the network in arrays.
        state: values of all unknowns; points with known coordinates have these.
        static: photos and points, (n, 1) each, whose places are known; all others move.
    """
    depth = typical_depth(equations, state)
    out = []
    for block in equations.blocks:
        if block.lens is not None:
            known: Mask = static["point"][block.variables[2][1], 0]
            for rows, what in ((known, "rays to known points"), (~known, "rays to tie points")):
                out.append(_misfit(equations, block, rows, state, {"pose": static["pose"]}, depth))
                out[-1] = out[-1] and replace(out[-1], what=what)
        elif not block.prior:
            moves = np.zeros(block.n, dtype=bool)
            for kind, index in block.variables:
                if kind in static:
                    moves |= ~static[kind][index, 0]
            out.append(_misfit(equations, block, moves, state, static, depth))
    return tuple(m for m in out if m is not None)


def typical_depth(equations: Equations, state: State) -> float:
    """Return the median distance of points from the photos that see them, metres."""
    found = [np.ones(0)]
    for block in equations.blocks:
        if block.lens is not None:
            rows = _sampled(np.arange(block.n))
            photo, point = block.variables[0][1][rows], block.variables[2][1][rows]
            found.append(np.linalg.norm(state["point"][point] - state["pose"][photo, 9:], axis=1))
    every = np.concatenate(found)
    return float(np.median(every)) if len(every) else 1.0


def robust_cost(equations: Equations, state: State) -> float:
    """Return Σ ln(1 + (v/3σ)²) over all observations; infinite: one cannot be computed.

    The logarithm orders starts that are far from a solution, where a sum of squares is that of the
    worst observation, and one wrong observation weighs no more than some small residuals.
    """
    try:
        v = equations.residuals(state)
    except AdjustmentError:
        return np.inf
    for place, chunks in equations.images.items():
        behind = np.flatnonzero(chunks.depths(state) <= 0)
        first = equations.blocks[place].first_row
        v[first + 2 * behind] = v[first + 2 * behind + 1] = RESIDUAL_BEHIND_CAMERA
    cost = float(
        np.log1p(np.square(np.minimum(np.abs(v), RESIDUAL_BEHIND_CAMERA) / CAUCHY_RESIDUAL)).sum()
    )
    return cost if np.isfinite(cost) else np.inf


def _sampled(rows: Index) -> Index:
    """Return at most `MAX_SAMPLED_OBSERVATIONS` of some rows, evenly spread."""
    if len(rows) <= MAX_SAMPLED_OBSERVATIONS:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, MAX_SAMPLED_OBSERVATIONS).astype(np.intp)])


def _misfit(
    equations: Equations, block: Block, rows: Mask, state: State, static: MaskState, depth: float
) -> StartMisfit | None:
    """Return the misfit of some rows of a block; none: they do not depend on its place."""
    chosen = _sampled(np.flatnonzero(rows))
    if not len(chosen):
        return None
    sample = _Sample.of(block.select(chosen), state, static)
    frame = equations.network.frame
    try:
        with np.errstate(all="ignore"):
            v = sample.residual(frame, None, depth)
            slopes = [
                (sample.residual(frame, m, depth) - v) / SIMILARITY_STEP for m in SMALL_SIMILARITIES
            ]
    except AdjustmentError:
        return None
    size = np.linalg.norm(v, axis=1)
    slope = np.sqrt(sum(np.square(s).sum(axis=1) for s in slopes))
    normalised = np.linalg.norm(sample.block.whiten(v), axis=1)
    tells = slope > MIN_RELATIVE_SENSITIVITY * (1.0 + size)
    found = np.where(np.isfinite(size), size / np.maximum(slope, 1e-300), np.inf)
    found[normalised < MIN_SIGNIFICANT_RESIDUAL] = 0.0
    found[sample.behind()] = np.inf
    if not tells.any():
        return None
    return StartMisfit(block.kind.replace("_", " "), float(np.median(found[tells])))


@dataclass(frozen=True)
class _Sample:
    """Observations with a copy of their variables for each, which moves with its own middle."""

    block: Block
    """The observations; row i has the values i of its variables."""
    state: State
    """Values of the variables."""
    moves: dict[str, Mask]
    """Points and photos that move, among the values."""
    middle: dict[str, Array]
    """About which they move, (n, 3)."""

    @classmethod
    def of(cls, block: Block, state: State, static: MaskState) -> _Sample:
        """Give each row of a block variables of its own."""
        values: dict[str, list[Array]] = {}
        moves: dict[str, list[Mask]] = {}
        variables = []
        total, count = np.zeros((block.n, 3)), np.zeros(block.n)
        for kind, index in block.variables:
            before = values.setdefault(kind, [])
            variables.append((kind, np.arange(block.n) + block.n * len(before)))
            before.append(state[kind][index])
            if kind in static:
                own = ~static[kind][index, 0]
                moves.setdefault(kind, []).append(own)
                total[own] += before[-1][own, -3:]
                count += own
        middle = total / np.maximum(count, 1.0)[:, None]
        return cls(
            replace(block, variables=tuple(variables)),
            {kind: np.concatenate(v) for kind, v in values.items()},
            {kind: np.concatenate(m) for kind, m in moves.items()},
            {kind: np.tile(middle, (len(m), 1)) for kind, m in moves.items()},
        )

    def residual(self, frame: Frame, by: tuple[Array, Array, float] | None, depth: float) -> Array:
        """Return residuals (n, d), after a small similarity about the middles."""
        state = dict(self.state)
        if by is not None:
            turn, shift, scale = by
            small = Similarity(scale, exp_rotation(turn), depth * shift)
            for kind, own in self.moves.items():
                values, middle = state[kind].copy(), self.middle[kind][own]
                if kind == "pose":
                    values[own, :9] = small.of_poses(values[own])[:, :9]
                values[own, -3:] = small.of(values[own, -3:] - middle) + middle
                state[kind] = values
        return self.block.evaluate(frame, state, jacobians=False).residual

    def behind(self) -> Mask:
        """Return the image points whose object points are behind their cameras, (n,)."""
        if self.block.lens is None:
            return np.zeros(self.block.n, dtype=bool)
        return np.asarray(in_front(self.state["pose"], self.state["point"], self.block.lens) <= 0)


@dataclass(frozen=True, eq=False)
class SimilarityStart:
    """Values of all unknowns with the block moved, and how it was moved."""

    state: State
    """Values of all unknowns."""
    words: str
    """What the similarity was found from, and its parameters."""


def similarity_starts(
    equations: Equations, bare: Equations, state: State, datum: DatumChoice
) -> Iterator[SimilarityStart]:
    """Iterate over starts whose photos and tie points are moved by the similarity that fits.

    There are two where cameras have arms on carriers: in the units of the poses, and in metres.

    Args:
        equations: the network in arrays.
        bare: the same without approximate values of photos and points.
        state: the given start.
        datum: given or free.
    """
    block = _MovedBlock.of(equations, bare, state, datum)
    growth = block.growth
    if not growth.posed.any():
        return
    part = BlockPart(growth, ("", ""), growth.fitting())
    placed = Assembly(bare, growth.views, [part], datum).placed(bare)[0]
    for scaled in (True, False):
        moved = block.moved(state, placed.to_frame, scaled=scaled)
        if moved is None:
            continue
        yield SimilarityStart(moved, _words(placed))
        if not block.armed.any():
            return


@dataclass(frozen=True, eq=False)
class _MovedBlock:
    """Photos and points that move."""

    equations: Equations
    datum: DatumChoice
    growth: PartialBlock
    """Given poses and tie points, and known points where their rays meet."""
    known: KnownPlaces
    """What is known in the frame of the network."""
    armed: Mask
    """Mounts with a free arm that join photos, (mounts,)."""

    @classmethod
    def of(
        cls, equations: Equations, bare: Equations, state: State, datum: DatumChoice
    ) -> _MovedBlock:
        """Return the part of a block that given poses and tie points make up."""
        views = Views.of(equations.network)
        growth = PartialBlock.empty(views, views.calibrations(), np.ones(views.n, dtype=bool))
        open_ = np.isnan(bare.unknowns["pose"].values).all(axis=1)
        growth.pose[open_] = state["pose"][open_]
        known = given_places(bare)
        surveyed = _surveyed(equations)
        if (surveyed & np.isnan(known.point).any(axis=1)).any():
            found, _ = partial_approximation(bare, datum=datum)
            known = KnownPlaces(
                np.where(np.isnan(known.point), found["point"], known.point), known.pose
            )
        ties = np.isnan(known.point).all(axis=1) & ~surveyed
        growth.point[ties] = state["point"][ties]
        # Wrong marks fall out with the narrow limit; rough poses need the wide one.
        narrow = growth.limit
        for limit in (narrow, narrow * GROSS_START_MISFIT / GROWTH.widest):
            growth.limit = limit
            growth.intersect(parallax=GROWTH.least_parallax)
        return cls(equations, datum, growth, known, _armed(equations))

    def moved(self, state: State, by: Similarity, *, scaled: bool) -> State | None:
        """Return a state with the block moved; none: other unknowns have no values with it.

        Args:
            state: the state before.
            by: the similarity.
            scaled: whether the arms of cameras on carriers have the scale of the block.
        """
        growth, unknowns = self.growth, self.equations.unknowns
        out = unknowns.start()
        rough = unknowns.rough()
        points = np.where(growth.placed[:, None], growth.point, state["point"])
        points = by.of(points)
        points = np.where(np.isfinite(self.known.point), self.known.point, points)
        out["point"] = np.where(rough["point"], points, state["point"])
        out["pose"] = state["pose"].copy()
        out["pose"][growth.posed] = by.of_poses(state["pose"][growth.posed])
        if scaled:
            out["mount"][self.armed, -3:] *= by.scale
        try:
            return approximate(
                replace(self.equations, unknowns=unknowns.starting_at(out)), datum=self.datum
            )
        except ApproximationError:
            return None


def _surveyed(equations: Equations) -> Mask:
    """Return the points that observations besides image coordinates touch, (points,)."""
    out = np.zeros(len(equations.unknowns["point"].names), dtype=bool)
    for block in equations.blocks:
        if block.lens is None:
            for kind, index in block.variables:
                if kind == "point":
                    out[index] = True
    return out


def _armed(equations: Equations) -> Mask:
    """Return the mounts with free arms that observations between two photos use, (mounts,)."""
    table = equations.unknowns["mount"]
    out = np.zeros(len(table.names), dtype=bool)
    for block in equations.blocks:
        kinds = [kind for kind, _ in block.variables]
        if kinds.count("pose") == 2 and "mount" in kinds:
            out[block.variables[kinds.index("mount")][1]] = True
    return out & (table.free[:, 3:6] & ~np.isfinite(table.sigma[:, 3:6])).all(axis=1)


def _words(placed: PartPlacement) -> str:
    by = placed.to_frame
    turn = float(np.rad2deg(np.linalg.norm(log_rotation(by.rotation[None])[0])))
    return f"from {placed.words}: scale {by.scale:.4g}, rotation by {turn:.3g}°"
