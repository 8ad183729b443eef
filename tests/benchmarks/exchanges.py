"""Exchanged targets and small networks: ``python -m tests.benchmarks.exchanges [DAYS [MOST]]``.

A day has 10 to 60 targets (MOST), seen from two to four set-ups, with one to three exchanges; half
of the days have approximate coordinates. Counts how often the exchanges of which two others tell
come first among the causes, by both names and the station; whether one of which nothing tells is
named all the same; and whether a day ends with exit code 0 though a point is off by more than 5 σ.

Clean days are counted as false alarms if a cause, or that nothing tells, is said. Small networks
have a redundancy of 1 or 2 and one error of 20 σ: a cause that is named must explain more than
every reading and every other cause, which a dense computation checks.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.quality.causes.cause_search import Causes
from factorgraph_adj.quality.causes.mistaken_identity import EXCHANGED_TARGETS
from factorgraph_adj.quality.rejections import Snooping
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.doubtful_results import doubts_of_network, doubts_of_solution
from factorgraph_adj.report.options import Provenance, ReportOptions
from tests.networks.exchanged_day import MOST, Day, day
from tests.networks.small import small

DAYS, CLEAN, SMALL = 1000, 500, 300
"""Numbers of days with exchanges, of clean ones, and of small networks."""
OFF = 5.0
"""Error of a coordinate, in its standard deviations, with which a result is wrong."""


@dataclass
class Counts:
    """What became of days with exchanges."""

    told: int = 0
    """Exchanges of which others tell."""
    first: int = 0
    """Those that come first."""
    untold: int = 0
    """Exchanges of which nothing tells."""
    guessed: int = 0
    """Those of which one place is named all the same, and the wrong one."""
    wrong: int = 0
    """Days with exit code 0 and a point that is off."""
    refused: int = 0
    """Days that end with an error."""


def doubts(found: Snooping, network: fga.Network) -> list[str]:
    """Return what makes ``adjust --snoop`` end with exit code 1."""
    report = Report(found.solution, ReportOptions(), Provenance(found, network))
    own = [
        *doubts_of_solution(found.solution),
        *doubts_of_network(found.solution.network),
        *report.shared_error_doubts,
    ]
    return own + [u.label for u in found.unresolved]


def off(found: Snooping, case: Day) -> bool:
    """Return whether a point is off by more than 5 σ."""
    return any(
        np.max(
            np.abs(found.solution.point(p) - case.true[p]) / found.solution.standard_deviations(p)
        )
        > OFF
        for p in found.solution.network.points
    )


def count(case: Day, counts: Counts) -> str:
    """Add a day to the counts, and return what went wrong with it; empty for nothing."""
    try:
        found = fga.snoop(case.network)
    except fga.AdjustmentError as error:
        counts.refused += 1
        return str(error).splitlines()[-1]
    said = found.causes
    causes = () if said is None else said.found[: len(case.exchanged)]
    failed = []
    for e in case.exchanged:
        a, b = e.pair
        own = f"{a!r} and {b!r} seen from {e.station!r}"
        named = [
            c for c in causes if c.cause == EXCHANGED_TARGETS and (c.where == own or own in c.same)
        ]
        if e.told:
            counts.told += 1
            right = any(not c.same for c in named)
            counts.first += right
            failed += [] if right else [own]
            continue
        counts.untold += 1
        guessed = any(
            c.cause == EXCHANGED_TARGETS
            and not c.same
            and c.where != own
            and f"{a!r} and {b!r}" in c.where
            for c in causes
        )
        counts.guessed += guessed
        failed += [f"guessed: {own}"] if guessed else []
    if off(found, case) and not doubts(found, case.network):
        counts.wrong += 1
        failed.append("exit 0 with a point off")
    return "; ".join(failed)


def exchanged(days: int, *, most: int = MOST) -> Counts:
    """Return what became of days with exchanges."""
    counts = Counts()
    for seed in range(days):
        if failed := count(day(seed, most=most), counts):
            print(f"  day {seed}: {failed}", file=sys.stderr)
    return counts


def false_alarms(days: int, *, most: int = MOST) -> int:
    """Return in how many clean days a cause is named, or nothing tells between several."""
    out = 0
    for seed in range(days):
        found = fga.snoop(day(seed, exchanges=0, most=most).network).causes
        if found is not None and (found.more_probable or found.undecided):
            out += 1
            told = found.undecided or found.more_probable[0]
            print(f"  clean day {seed}: {told}", file=sys.stderr)
    return out


def named_by_chance(networks: int) -> tuple[int, int]:
    """Return in how many small networks a cause is named, and in how many that is a guess."""
    named = guessed = 0
    for seed in range(networks):
        solution = fga.adjust(small(seed))
        found = fga.causes(fga.reliability(solution))
        if found.most_probable is not None:
            named += 1
            guessed += not explains_most(found)
    return named, guessed


def explains_most(found: Causes) -> bool:
    """Return whether the named cause explains more than every reading, by dense algebra."""
    (first, *rest) = [c.t2 for c in found.more_probable]
    a, v = dense(found.solution)
    q = np.eye(len(v)) - a @ np.linalg.pinv(a)
    r = np.diag(q)
    w2 = np.where(r > 1e-6, np.square(v) / np.where(r > 1e-6, r, 1.0), 0.0)
    others = [w2.max(), *(rest[:1])]
    return found.solution.redundancy > 1 and first > max(others) + 5.5


def dense(solution: fga.Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return the whitened design (n, u) and residuals (n,)."""
    system = solution.normal().system
    rows = np.arange(solution.equations.n_rows)
    return system.sparse(rows).toarray(), system.residual


def main() -> None:
    """Print the counts."""
    days = int(sys.argv[1]) if len(sys.argv) > 1 else DAYS
    most = int(sys.argv[2]) if len(sys.argv) > 2 else MOST
    c = exchanged(days, most=most)
    print(f"{days} days with exchanges: {c.first} of {c.told} that others tell of come first")
    print(f"  of {c.untold} that nothing tells of, {c.guessed} are named at the wrong set-up alone")
    print(f"  exit 0 with a point off by more than {OFF:g} σ: {c.wrong}; refused: {c.refused}")
    clean = max(1, days * CLEAN // DAYS)
    print(f"{clean} clean days: {false_alarms(clean, most=most)} with a cause")
    few = max(1, days * SMALL // DAYS)
    named, guessed = named_by_chance(few)
    print(f"{few} networks of redundancy 1 and 2: {named} causes named, {guessed} without a reason")


if __name__ == "__main__":
    main()
