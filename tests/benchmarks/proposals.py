"""A round of `propose` over 1 000 candidates, against planning anew with each of them.

``python -m tests.benchmarks.proposals ROUNDS`` prints one line of JSON.
"""

from __future__ import annotations

import json
import statistics
import sys
from dataclasses import asdict, dataclass
from time import perf_counter

import numpy as np

from examples.published_blocks.industry_1981 import industry_block_plan
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.planning.candidate_search import CandidateSearch
from factorgraph_adj.planning.candidates import Candidate, identified, with_candidates
from factorgraph_adj.planning.plan import plan
from factorgraph_adj.planning.proposals import propose
from factorgraph_adj.planning.targets import SemiAxis, UndetectedShift, lacking

CANDIDATES = 1_000
SAMPLE = 10
"""Candidates that are planned anew in each round: all of them take minutes."""
TARGETS = (SemiAxis(1.5e-3), UndetectedShift(3e-3))


@dataclass(frozen=True)
class Proposed:
    """What a comparison came to."""

    candidates: int
    round: list[float]
    """Seconds for the gains of all candidates, in each round."""
    anew: list[float]
    """Seconds for one candidate planned anew, mean of a sample, in each round."""
    ratio: float
    """Of all candidates planned anew to a round, median."""
    difference: float
    """Largest difference of what is still lacking with a candidate."""
    whole: float
    """Seconds of the whole proposal,"""
    steps: int
    """and its steps."""


def candidates() -> list[Candidate]:
    """Return seeded distances between points of the industry block, with costs."""
    names = list(industry_block_plan().points)
    rng = np.random.default_rng(1)
    pairs: dict[tuple[str, str], None] = {}
    while len(pairs) < CANDIDATES:
        a, b = rng.choice(len(names), 2, replace=False).tolist()
        pairs[names[a], names[b]] = None
    return [
        Candidate(
            f"{a}={b}",
            (SlopeDistance(a, b, 1.0, sigma=5e-4),),
            cost=float(rng.integers(1, 4)),
        )
        for a, b in pairs
    ]


def measure(rounds: int) -> Proposed:
    """Compare, alternating."""
    design, every = industry_block_plan(), identified(candidates())
    together, anew, off = [], [], 0.0
    for number in range(rounds):
        begin = perf_counter()
        search = CandidateSearch.of(plan(design, TARGETS), every, TARGETS)
        search.best(search.start, search.known, range(len(every)))
        together.append(perf_counter() - begin)
        some = range(number * SAMPLE, (number + 1) * SAMPLE)
        begin = perf_counter()
        for i in some:
            found = plan(with_candidates(design, [every[i]]), TARGETS)
            lack = sum(float(lacking(t, found.figures(t)[1]).sum()) for t in TARGETS)
            told = search.told(i, search.known)
            assert told is not None
            off = max(off, abs(search.start.lack(search.start.change(told)) - lack))
        anew.append((perf_counter() - begin) / SAMPLE)
    begin = perf_counter()
    proposal = propose(design, every, TARGETS)
    whole = perf_counter() - begin
    ratio = statistics.median(len(every) * a / t for a, t in zip(anew, together, strict=True))
    return Proposed(len(every), together, anew, ratio, off, whole, len(proposal.steps))


if __name__ == "__main__":
    print(json.dumps(asdict(measure(int(sys.argv[1])))))
