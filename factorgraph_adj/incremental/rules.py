"""The options of an incremental adjustment."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ..network.network import DatumChoice
from .forms import Item
from .verdicts import Outcome, Policy


@dataclass(frozen=True)
class Rules:
    """The options of an incremental adjustment."""

    policy: Policy
    """What becomes of an observation beyond the critical value."""
    alpha: float
    """Probability of a false alarm of one test."""
    accuracy: float
    """Largest deviation from the batch adjustment, relative to σ."""
    datum: DatumChoice
    """Datum of the network."""

    @property
    def failed(self) -> Outcome:
        """What becomes of an observation that fails its test."""
        return "rejected" if self.policy == "reject" else "suspect"

    def tests(self, item: Item, fixed: Collection[str]) -> bool:
        """Return whether an item may be left out, given the ids of those that are in untested."""
        return self.policy != "accept" and item.ids[0] not in fixed
