"""A comparison of two epochs, with what was asked of its points, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...epochs.blocks import BlockMotion
from ...epochs.comparison import Congruence
from ...io.numbers import Units
from ...network.network import Network
from ...quality.ellipses import ErrorEllipse
from ...quality.levels import CONFIDENCE
from ...solve.solution import Solution
from ...types import Array
from ..doubts import unknowns_left_out
from ..options import Provenance

EPOCHS = {1: ("common",), 2: ("first", "second")}
"""Words for the adjustments, by their number."""


@dataclass(frozen=True, eq=False)
class EpochsReport:
    """What protocol, figures, pages and exports of two epochs need."""

    found: Congruence
    """The comparison."""
    blocks: Sequence[BlockMotion] = ()
    """Common motions of points."""
    provenance: Provenance = field(default_factory=Provenance)
    """The run."""
    confidence: float | None = CONFIDENCE
    """Probability of the ellipses of displacements; None: standard ellipses."""
    units: Units = field(default_factory=Units)
    """Units of figures that people read."""

    @property
    def network(self) -> Network:
        """The network of the first epoch."""
        return self.found.network

    @property
    def unknowns_left_out(self) -> tuple[str, ...]:
        """Sentences on what nothing determines, and was left out of each epoch."""
        return left_out_of_epochs(self.found.solutions)

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Why the displacements are doubtful; empty if nothing speaks against them."""
        return tuple(_doubts(self.found))

    @cached_property
    def ellipses(self) -> tuple[ErrorEllipse, ...]:
        """Ellipses of the displacements in plan, in the order of the displacements."""
        return self.found.ellipses(confidence=self.confidence)

    @property
    def names(self) -> list[str]:
        """Names of the points, in the first epoch."""
        return list(self.found.displacements)

    @cached_property
    def places(self) -> Array:
        """Places of the points in the first epoch, (n, 3) metres."""
        every = self.found.displacements.values()
        return np.array([x.place for x in every]).reshape(-1, 3)

    @cached_property
    def vectors(self) -> Array:
        """Displacements, (n, 3) metres."""
        every = self.found.displacements.values()
        return np.array([x.vector for x in every]).reshape(-1, 3)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """What each point is, one of `STATES`."""
        found = self.found
        out = []
        for name, x in found.displacements.items():
            if x.stable:
                out.append("stable")
            elif name in found.reference:
                out.append("left")
            else:
                out.append("moved" if x.moved else "kept")
        return tuple(out)


STATES = ("stable", "left", "moved", "kept")
"""A point of a comparison is a stable reference point, a reference point that left the reference,
an object point that moved, or one that did not move significantly."""


def left_out_of_epochs(solutions: Sequence[Solution]) -> tuple[str, ...]:
    """Return sentences on the unknowns that were left out of each epoch."""
    return tuple(
        f"{which} epoch: {said}"
        for which, solution in zip(EPOCHS[len(solutions)], solutions, strict=True)
        for said in unknowns_left_out(solution.network)
    )


def _doubts(found: Congruence) -> Iterator[str]:
    for which, solution in zip(EPOCHS[len(found.solutions)], found.solutions, strict=True):
        if not solution.converged:
            yield f"the {which} adjustment did not converge: {solution.reason}"
    ratio = found.ratio
    if ratio is not None and not ratio.accepted:
        yield (
            f"the variances of the epochs do not agree, F {ratio.ratio:.2f} > {ratio.critical:.2f}"
        )
    for name, size in found.held_apart.items():
        yield (
            f"point {name!r} is held in both epochs, {1000 * size:.2f} mm apart: all "
            "displacements refer to it"
        )
    yield from found.alternatives
    if found.steps and not found.steps[-1].test.accepted:
        yield "no set of reference points kept its shape"
