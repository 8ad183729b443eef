"""The similarity start: given poses and tie points moved as a whole to what is known of the frame.

Programs of structure from motion deliver poses and points that agree with each other, in axes and
with a scale of their own. The rays of known points are intersected in these axes, and the block is
brought into the frame of the network like a part that was oriented from image points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..approximate.rounds import approximate, reach
from ..errors import ApproximationError
from ..graph.equations import Equations
from ..graph.variables import State
from ..network.network import DatumChoice
from ..rotation import log_rotation
from ..types import Mask
from .assemble import Assembly
from .build import Part
from .growth import RULES, Growth
from .known import Known, given
from .place import Placed
from .similarity import Similarity
from .start_misfit import GROSS
from .views import Views


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
    block = _Block.of(equations, bare, state, datum)
    growth = block.growth
    if not growth.posed.any():
        return
    part = Part(growth, ("", ""), growth.fitting())
    placed = Assembly(bare, growth.views, [part], datum).placed(bare)[0]
    for scaled in (True, False):
        moved = block.moved(state, placed.to_frame, scaled=scaled)
        if moved is None:
            continue
        yield SimilarityStart(moved, _words(placed))
        if not block.armed.any():
            return


@dataclass(frozen=True, eq=False)
class _Block:
    """Photos and points that move."""

    equations: Equations
    datum: DatumChoice
    growth: Growth
    """Given poses and tie points, and known points where their rays meet."""
    known: Known
    """What is known in the frame of the network."""
    armed: Mask
    """Mounts with a free arm that join photos, (mounts,)."""

    @classmethod
    def of(cls, equations: Equations, bare: Equations, state: State, datum: DatumChoice) -> _Block:
        """Return the part of a block that given poses and tie points make up."""
        views = Views.of(equations.network)
        growth = Growth.empty(views, views.calibrations(), np.ones(views.n, dtype=bool))
        open_ = np.isnan(bare.unknowns["pose"].values).all(axis=1)
        growth.pose[open_] = state["pose"][open_]
        known = given(bare)
        surveyed = _surveyed(equations)
        if (surveyed & np.isnan(known.point).any(axis=1)).any():
            found, _ = reach(bare, datum=datum)
            known = Known(np.where(np.isnan(known.point), found["point"], known.point), known.pose)
        ties = np.isnan(known.point).all(axis=1) & ~surveyed
        growth.point[ties] = state["point"][ties]
        # Wrong marks fall out with the narrow limit; rough poses need the wide one.
        narrow = growth.limit
        for limit in (narrow, narrow * GROSS / RULES.widest):
            growth.limit = limit
            growth.intersect(parallax=RULES.least_parallax)
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


def _words(placed: Placed) -> str:
    by = placed.to_frame
    turn = float(np.rad2deg(np.linalg.norm(log_rotation(by.rotation[None])[0])))
    return f"from {placed.words}: scale {by.scale:.4g}, rotation by {turn:.3g}°"
