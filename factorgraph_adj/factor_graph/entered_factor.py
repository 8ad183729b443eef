"""A factor of a network in iSAM2, with what is to be known of it later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from ..graph.factors import Part
from ..types import Array


@dataclass(frozen=True, eq=False)
class EnteredFactor:
    """A factor in iSAM2."""

    factor: gtsam.NonlinearFactor
    """The factor."""
    arrival: int
    """Number of the update with which it came."""
    ids: tuple[str, ...] = ()
    """Ids of its observations; none of your own factors."""
    sigmas: tuple[Array, ...] = ()
    """Their standard deviations with the lengths of sights at which the factor was made."""
    keeps: int | None = None
    """Key of the variable whose held components it keeps."""
    slot: int = -1
    """Index in iSAM2."""

    def weighs_as(self, parts: Sequence[Part]) -> bool:
        """Return whether its standard deviations are those of observations, within 1e-7."""
        return all(
            np.allclose(a, b, rtol=1e-7, atol=0.0)
            for a, b in zip(self.sigmas, sigmas_of(parts), strict=True)
        )


def sigmas_of(parts: Sequence[Part]) -> tuple[Array, ...]:
    """Return the standard deviations of observations, part by part."""
    return tuple(part.block.sigma[part.chosen] for part in parts)
