"""The campaign: seeds, and what became of each."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .damage import damaged
from .judge import Outcome, checked, run
from .sources import sources


@dataclass(frozen=True)
class Case:
    """One damaged input."""

    seed: int
    """Its seed."""
    source: str
    """The format."""
    done: str
    """How it was damaged."""
    outcome: Outcome
    """What became of it."""

    @property
    def told(self) -> str:
        """The sort of outcome."""
        if self.outcome.fault:
            return "FAULTS"
        return {0: "adjusted", 1: "adjusted, told doubtful", 2: "refused"}[self.outcome.code]


def campaign(first: int, n: int, folder: Path) -> Iterator[Case]:
    """Damage inputs, and see what becomes of them.

    Args:
        first: the first seed.
        n: number of inputs.
        folder: an empty folder.
    """
    every = sources(folder / "sources")
    for seed in range(first, first + n):
        rng = np.random.default_rng([seed, 4])
        source = every[int(rng.integers(len(every)))]
        here = folder / "damaged"
        done = damaged(rng, source.files, here)
        piped = here / source.piped if source.piped else None
        outcome = run(source.command(here), piped)
        adjusted = not source.piped and not source.name.endswith(("check", "snoop"))
        if outcome.code == 0 and adjusted:
            network = next(here.glob("*.gkf"), next(here.glob("problem.txt"), here))
            outcome = checked(outcome, network)
        yield Case(seed, source.name, done, outcome)
        shutil.rmtree(here)
