"""One thing that a preliminary check finds."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

from ...units import significant


@dataclass(frozen=True)
class Finding:
    """A doubt about readings or given values; nothing has been changed."""

    what: str
    """What does not fit, with the readings concerned."""
    remedy: str
    """What to look at, or to do."""
    size: float = nan
    """How large the misfit is, in ``unit``; NaN if it has no size."""
    tolerance: float = nan
    """How large it may be: `TIMES` its standard deviation, in ``unit``; NaN if there is none."""
    unit: str = ""
    """Unit of both."""
    ids: tuple[str, ...] = ()
    """Ids of the observations that share the mistake; empty where a finding is of something else,
    or of one reading alone."""
    cause: str = ""
    """The one mistake of those that people make that explains the misfit; empty: none does."""

    def __str__(self) -> str:
        """Return the finding as text."""
        size = ""
        if self.size == self.size:
            large = self.unit == "mm" and abs(self.size) >= METRES
            one, unit = (1e-3, "m") if large else (1.0, self.unit)
            size = f": {significant(one * self.size, 4)} {unit}".rstrip()
        if self.tolerance == self.tolerance:
            size += f", tolerance {significant(self.tolerance, 3)} {self.unit}".rstrip()
        return f"{self.what}{size}; {self.remedy}"


METRES = 1e5
"""Size in millimetres from which a misfit is told in metres."""
TIMES = 3.29
"""Tolerance of a misclosure, in its standard deviations: exceeded by chance once in 1000."""
CONTRADICTS = 6.0
"""Multiple of its standard deviation from which a reading contradicts given coordinates. Smaller
misfits are for the adjustment to judge, with all other readings."""
