"""Verdict on an arriving observation: outcome, cause, test values, gain and side of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ..statistical_tests import ChiSquareTest
from ..types import Array

Policy: TypeAlias = Literal["accept", "flag", "reject"]
"""Treatment of an observation whose test value is beyond the critical value."""
Outcome: TypeAlias = Literal["accepted", "suspect", "rejected", "waiting"]
SNOOPED = "snooping"
"""Cause of observations that data snooping rejected."""
REST = "rest of a group"
"""Cause of observations left over from a correlated group when one of its members was taken out."""
DISCARDED = "discarded"
"""Cause of observations that were rejected by hand: they are not readmitted automatically."""
STATED_CAUSES = (DISCARDED, SNOOPED, REST)
"""Causes that the verdicts on left-out observations state."""
OUTCOMES: tuple[Outcome, ...] = ("accepted", "waiting", "suspect", "rejected")
"""Every outcome, in the order in which a line of the journal lists them."""


@dataclass(frozen=True)
class Gain:
    """Gain in precision of a point by an observation."""

    point: str
    """Name of the point."""
    before: Array
    """Standard deviations without the observation, metres (3,); infinite where it is new."""
    after: Array
    """Standard deviations with the observation, (3,)."""


@dataclass(frozen=True)
class Side:
    """A point that a reading has moved to its other side."""

    point: str
    """Its name."""
    other: tuple[float, float, float]
    """Where it was before, metres."""
    moved: float
    """By how much it moved, metres."""
    alone: bool = True
    """Whether nothing but the reading determines the side."""

    def __str__(self) -> str:
        """Return the move, and whether no other reading determines the side."""
        moves = f"moves {self.point!r} by {self.moved:.3g} m to its other side"
        return moves + "; no other reading determines the side" * self.alone


@dataclass(frozen=True, eq=False)
class Verdict(ChiSquareTest):
    """Verdict on an observation: its outcome and tests; arrays over its k scalar components.

    Figures are None where nothing was tested: while the observation waits, and after `snoop`.
    """

    id: str
    """Its id."""
    kind: str
    """Its kind."""
    label: str
    """Readable name, with its source."""
    verdict: Outcome
    """``waiting``: something that it depends on is not determined yet."""
    components: tuple[str, ...] = ()
    """Names of the components."""
    innovation: Array | None = None
    """Computed from everything else − observed, SI or image units, (k,)."""
    sigma: Array | None = None
    """Standard deviations of the innovation (k,); infinite where nothing else controls it."""
    w: Array | None = None
    """Test values v/(σ√r), (k,); NaN where nothing else controls it."""
    redundancy_numbers: Array | None = None
    """The redundancy numbers that it has, or would have, (k,)."""
    t2: float = np.nan
    """T² of all components; of a correlated group, of all its observations."""
    dof: int = 0
    """Degrees of freedom of T²."""
    critical: float = np.nan
    """Critical value of T²; for data snooping, the square of its limit of |w|."""
    entered: bool = False
    """Whether it had been waiting, or left out."""
    lacks: str = ""
    """Reason of a waiting observation."""
    points: tuple[str, ...] = ()
    """Points that it touches."""
    cause: str = ""
    """Why it is out, or in, where no test on its arrival is the reason: ``discarded``, ``snooping``
    or ``rest of a group``, or ``came back after snoop()`` or another command."""
    doubt: str = ""
    """Why the verdict may be wrong: an accepted observation that moved a point to its other side,
    which nothing else determines; one that failed, and fits without such an observation; or one
    that rounding has left without a test when it was examined again."""
    gains: tuple[Gain, ...] = ()
    """Gain of each of its points; empty for observations that are left out, and in free networks
    (there the standard deviations refer to all datum points together)."""
    former: Verdict | None = None
    """Verdict that a decision by hand has replaced, which `revoke` restores; None: it was none."""
    following: tuple[tuple[str, int], ...] = ()
    """Decisions by hand about other observations that let it come back, as one: the id of each, and
    how many decisions about it stood then; empty where the decision was about itself."""
