"""Reference epoch of a network: the one that is stated, or the first that is whole.

A site often begins in the middle of an epoch, and its points are observed one after the other. Such
an epoch has fewer points or readings than the next one; as reference, its errors would be in all
displacements for years. Without a statement, the reference is therefore the first epoch that has at
least as many points as the next one, and `PART_OF_NEXT` of its readings. Later epochs do not change
it. Epochs that end by hand or with the last set are as whole as somebody wanted them: there the
first one is the reference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, TypeAlias

PART_OF_NEXT = 0.75
"""Part of the readings of the next epoch that a whole epoch has at least: with it, σ of the
reference are at most 1.15 times as large."""
Why: TypeAlias = Literal["stated", "first", "whole"]


@dataclass(frozen=True)
class ReferenceEpoch:
    """The first epoch of the reference, and why it is."""

    number: int
    """Its number."""
    why: Why
    """``stated`` in the site file; ``first``: the first one; ``whole``: the first that is whole."""
    poorer: bool = False
    """Whether the next epoch has more points or many more readings."""

    def shown(self, epochs: int) -> dict[str, Any]:
        """Return what the API shows; ``epochs``: how many the reference is the mean of."""
        return {"epoch": self.number, "epochs": epochs, "why": self.why, "poorer": self.poorer}


def reference_epoch(
    results: Mapping[int, Mapping[str, Any]], stated: int | None, *, timed: bool
) -> ReferenceEpoch | None:
    """Return the reference epoch; None: no epoch has an estimate yet.

    Args:
        results: results of epochs by number; those without an estimate do not count.
        stated: number that the site file states; where that epoch has no estimate, the next one.
        timed: whether epochs have a length.
    """
    numbers = sorted(
        n for n, r in results.items() if r.get("estimate") and (stated is None or n >= stated)
    )
    if not numbers:
        return None
    poorer = {
        a: _is_poorer(results[a]["estimate"], results[b]["estimate"]) for a, b in pairwise(numbers)
    }
    first = numbers[0]
    if stated is not None or not timed:
        why: Why = "first" if stated is None else "stated"
        return ReferenceEpoch(first, why, poorer.get(first, False))
    whole = next(n for n in numbers if not poorer.get(n, False))
    return ReferenceEpoch(whole, "first" if whole == first else "whole")


def _is_poorer(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether an epoch has fewer free coordinates, or many fewer readings, than another."""
    fewer = len(one["components"]) < len(other["components"])
    return fewer or one["n_observations"] < PART_OF_NEXT * other["n_observations"]
