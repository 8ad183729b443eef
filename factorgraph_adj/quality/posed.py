"""Places that belong to a frame of its own, with their precision in the frame of the network.

A place that keeps its coordinates q in a frame moves with the frame, its origin and the vertical
there, from the one definition of q (`factorgraph_adj.models.sub_frame`):

    q(X) = q₀              dX = −(∂q/∂X)⁻¹ ∂q/∂(frame, origin, vertical)

The place q₀ = 0 is where the instrument of a frame stands, X = O + Eᵀ e^ℓ R c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..frames import Frame
from ..models.sub_frame import InFrame, from_frame, horizons, in_frame, split_frame
from ..models.variables import VariableKind
from ..solve.estimates import Estimate
from ..solve.solution import Solution
from ..types import Array

POSED = ("frame", "point", "vertical")
"""Kinds of the variables that give a frame its place."""
PLACE = ("X", "Y", "Z")
"""Names of the coordinates of a place in the frame of the network."""


@dataclass(frozen=True, eq=False)
class Posed:
    """A frame of its own after the adjustment."""

    frame: Frame
    """Frame of the network."""
    state: dict[VariableKind, Array]
    """Stored values (1, s) of frame, origin and vertical, as far as the frame has them."""

    def there(self, place: Array) -> InFrame:
        """Return a place (3,) in the frame, with partials."""
        get = self.state.get
        return in_frame(self.frame, self.state["frame"], place[None], get("point"), get("vertical"))

    @property
    def origin(self) -> Array:
        """O, (3,) metres."""
        constant = split_frame(self.state["frame"]).origin
        return np.asarray(self.state.get("point", constant)[0])

    @property
    def place(self) -> Array:
        """The place of q = 0 in the frame of the network, (3,) metres."""
        at, stored = self.origin[None], self.state["frame"]
        vertical = self.state.get("vertical", np.zeros((1, 2)))
        level = split_frame(stored).level
        horizon = np.eye(3)[None]
        if level.any():
            horizon = horizons(self.frame.basis(at, vertical), level)
        return np.asarray(from_frame(stored, np.zeros((1, 3)), at, horizon)[0])

    def moves(self, place: Array, kind: VariableKind) -> Array:
        """Return ∂X/∂(variable) (3, k) of a place that keeps its coordinates q in the frame."""
        found = self.there(place)
        by = {"frame": found.by_frame, "point": found.by_origin, "vertical": found.by_vertical}
        return np.asarray(-np.linalg.solve(found.by_place[0], by[kind][0]))


def place_of_frame(solution: Solution, name: str) -> Estimate:
    """Return where a frame of its own has its zero: the place of a scanner, tracker or station.

    Args:
        solution: an adjusted network.
        name: name of the frame.

    Returns:
        X, Y, Z in the frame of the network, metres, with standard deviations and correlations.

    Raises:
        InputError: no frame has this name; the error lists those that are there.
    """
    number = solution.number("frame", name)
    stated, unknowns = solution.network.frames[name], solution.equations.unknowns
    variables = [("frame", number)]
    if stated.origin:
        variables.append(("point", unknowns["point"].number[stated.origin]))
        vertical = unknowns["vertical"].number.get(stated.origin)
        if vertical is not None:
            variables.append(("vertical", vertical))
    posed = Posed(
        solution.network.frame, {kind: solution.state[kind][[n]] for kind, n in variables}
    )
    place = posed.place
    names = [(kind, unknowns[kind].names[n]) for kind, n in variables]
    joint = np.block([[solution.variable_covariance(a, b) for b in names] for a in names])
    by = np.concatenate([posed.moves(place, kind) for kind, _ in variables], axis=1)
    covariance = by @ joint @ by.T
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(sigmas > 0, sigmas, 1.0)
    return Estimate(PLACE, place, sigmas, covariance / np.outer(safe, safe))
