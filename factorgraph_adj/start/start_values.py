"""`Start`: values from which an adjustment begins, by kind and name; from a solution or given.

A start holds the values from which the iteration begins, the values x₀ to which the inner
constraints of a free network refer, and sentences on how both were found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..network.network import DatumChoice
from .approximate_values import approximate


class AdjustedValues(Protocol):
    """What a start takes from a solution: the state, and what its adjustment began from."""

    @property
    def equations(self) -> Equations:
        """The equations that were adjusted."""
        ...

    @property
    def state(self) -> State:
        """The adjusted values."""
        ...

    @property
    def start(self) -> State:
        """The values x₀ that its inner constraints refer to."""
        ...

    @property
    def begun(self) -> tuple[str, ...]:
        """Sentences on how its start was found."""
        ...


@dataclass(frozen=True, eq=False)
class Start:
    """Start values of unknowns, identified by kind and name, of this or another network."""

    unknowns: Unknowns
    """The unknowns to which the values belong."""
    state: State
    """Values from which the iteration starts."""
    origin: State
    """Values x₀ that the inner constraints of a free network refer to."""
    words: tuple[str, ...] = ()
    """Sentences on how the values were found; none for given and approximate values."""
    doubtful: tuple[str, ...] = ()
    """Ids of image points that do not agree with the values, if they were found from images."""
    unreached: tuple[str, ...] = ()
    """Points of which fewer than two image points agree."""
    instead_of: State | None = None
    """Given values that this start has replaced, as they grossly misfit; none: it has not."""

    @classmethod
    def of(cls, given: AdjustedValues | Start) -> Start:
        """Return the values of a solution as start: a similar adjustment needs a step or two."""
        if isinstance(given, Start):
            return given
        return cls(given.equations.unknowns, given.state, given.start, given.begun)

    def for_unknowns(self, unknowns: Unknowns) -> Start | None:
        """Return the start for the unknowns of another network; none: values are missing.

        Values that the other network gives, for held components or as x₀, are kept.
        """
        given = unknowns.start()
        missing = {kind: np.isnan(values) for kind, values in given.items()}
        origin = unknowns.carried(given, self.unknowns, self.origin, where=missing)
        if _incomplete(origin):
            return None
        moving = unknowns.moving()
        state = unknowns.carried(origin, self.unknowns, self.state, where=moving)
        instead_of = self.instead_of
        if instead_of is not None:
            instead_of = unknowns.carried(origin, self.unknowns, instead_of, where=moving)
        return replace(self, unknowns=unknowns, state=state, origin=origin, instead_of=instead_of)


def approximate_start(
    equations: Equations, datum: DatumChoice, given: AdjustedValues | Start | None
) -> Start:
    """Return the start of an adjustment: the given values, otherwise approximate values.

    Raises:
        ApproximationError: the unknowns that it names have no approximate values.
    """
    unknowns = equations.unknowns
    if given is not None:
        found = Start.of(given).for_unknowns(unknowns)
        if found is not None:
            return found
    origin = unknowns.start()
    if _incomplete(origin):
        origin = approximate(equations, datum=datum)
    return Start(unknowns, origin, origin)


def _incomplete(state: State) -> bool:
    return any(bool(np.isnan(values).any()) for values in state.values())
