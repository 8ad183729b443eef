"""Verdicts of the same day on two engines: equal, with equal test values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from factorgraph_adj import IncrementalAdjustment
from factorgraph_adj.incremental.arrival import Arrival
from factorgraph_adj.ledger.verdicts import Verdict

NEAR = 1e-3
"""Largest difference of test values, in units of the critical value or of a larger one; verdicts
may differ so near to the critical value."""


class Recorded(IncrementalAdjustment):
    """An incremental adjustment that keeps what each command came to."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Begin as `IncrementalAdjustment`."""
        self.arrivals: list[Arrival] = []
        super().__init__(*arguments, **options)

    def _changed(self, *arguments: Any, **fields: Any) -> Arrival:
        self.arrivals.append(super()._changed(*arguments, **fields))
        return self.arrivals[-1]


@dataclass(frozen=True)
class Pair:
    """Verdicts on an observation in the same command on two engines."""

    command: int
    """Number of the command."""
    id: str
    """Of the observation."""
    verdicts: tuple[str, str]
    """What became of it; empty: nothing was said of it."""
    tests: tuple[float, float]
    """Test values in units of the critical value; NaN where nothing controls it."""

    @property
    def difference(self) -> float:
        """How far the test values are apart; 0 where neither has one, infinite where one has."""
        a, b = self.tests
        if a != a or b != b:
            return 0.0 if a != a and b != b else float("inf")
        return abs(a - b) / max(1.0, a, b)

    @property
    def same(self) -> bool:
        """Whether the verdicts are equal."""
        return self.verdicts[0] == self.verdicts[1]

    @property
    def critical(self) -> bool:
        """Whether a test value is so near to the critical value that either verdict is right."""
        return min(abs(t - 1.0) if t == t else float("inf") for t in self.tests) <= NEAR


def pairs(one: Sequence[Arrival], other: Sequence[Arrival]) -> Iterator[Pair]:
    """Return verdicts side by side until they differ: what comes later is then another day."""
    for number, (a, b) in enumerate(zip(one, other, strict=False)):
        mine, theirs = ({v.id: v for v in arrival.verdicts} for arrival in (a, b))
        differ = False
        for name in dict.fromkeys((*mine, *theirs)):
            pair = Pair(number, name, *zip(_of(mine.get(name)), _of(theirs.get(name)), strict=True))
            differ |= not pair.same
            yield pair
        if differ:
            return


def _of(verdict: Verdict | None) -> tuple[str, float]:
    return ("", float("nan")) if verdict is None else (verdict.verdict, verdict.test)
