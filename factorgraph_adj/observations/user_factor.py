"""A user's factor as an observation: residuals and partials by a function of its unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from ..entities import Key
from ..models.base import Linearised
from .base import Observation
from .registry import ObservationKind, register_in_memory


@dataclass(frozen=True)
class OwnFactor(Observation):
    """A user's factor, by the names of its unknowns.

    It is in memory alone: no file can hold its function.
    """

    kind: ClassVar[str] = "factor"
    unknowns: tuple[tuple[str, Key], ...]
    """Kind of each unknown of the function, and its key in a network, in order."""
    model: Callable[..., Linearised]
    """(frame, *values of the unknowns, observed=zeros) → residuals (n, d) in standard deviations,
    and partials."""
    dimension: int
    """Number d of residuals."""
    _: KW_ONLY
    sigma: float = 1.0
    """Factor of the standard deviations."""
    source: str | None = None
    """Type of the factor, for messages."""

    @property
    def further(self) -> tuple[tuple[str, Key], ...]:
        """Kind and key of every unknown that it depends on."""
        return self.unknowns

    def component_names(self) -> tuple[str, ...]:
        """Return the numbers of the residuals from 1; a single one has an empty name."""
        return ("",) if self.dimension == 1 else tuple(str(i + 1) for i in range(self.dimension))

    def _check(self) -> None:
        """Check the number of residuals; the rest was checked when the factor was made."""
        if self.dimension < 1:
            self._fail("a factor must have a residual")


register_in_memory(ObservationKind(OwnFactor, (), None, unit="mixed"))
