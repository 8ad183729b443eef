"""Values that an adjustment starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..network.network import DatumChoice
from .solution import Solution


@dataclass(frozen=True, eq=False)
class Start:
    """Values of unknowns, which are found by kind and name, of this or another network."""

    unknowns: Unknowns
    """The unknowns whose values they are."""
    state: State
    """Values to start from."""
    origin: State
    """Values x₀ that the inner constraints of a free network refer to."""

    @classmethod
    def of(cls, given: Solution | Start) -> Start:
        """Return where a solution is: an adjustment of nearly the same needs a step or two."""
        if isinstance(given, Start):
            return given
        return cls(given.equations.unknowns, given.state, given.start)

    def carried_to(self, unknowns: Unknowns) -> Start | None:
        """Return the same for the unknowns of another network; none where values are missing.

        Values that the other network gives of what it holds, or of its unknowns as x₀, stay.
        """
        given = unknowns.start()
        missing = {kind: np.isnan(values) for kind, values in given.items()}
        origin = unknowns.carried(given, self.unknowns, self.origin, where=missing)
        if _incomplete(origin):
            return None
        moving = unknowns.moving()
        state = unknowns.carried(origin, self.unknowns, self.state, where=moving)
        return Start(unknowns, state, origin)


def start_of(equations: Equations, datum: DatumChoice, given: Solution | Start | None) -> Start:
    """Return where an adjustment starts: what is given, else approximate values.

    Raises:
        ApproximationError: there are no approximate values for what it names.
    """
    unknowns = equations.unknowns
    if given is not None:
        found = Start.of(given).carried_to(unknowns)
        if found is not None:
            return found
    origin = unknowns.start()
    if _incomplete(origin):
        from ..approximate import approximate

        origin = approximate(equations, datum=datum)
    return Start(unknowns, origin, origin)


def _incomplete(state: State) -> bool:
    return any(bool(np.isnan(values).any()) for values in state.values())
