"""Search for gross errors in an epoch that ends, where correct readings may have been rejected.

Each reading is tested against those that came before it. A wrong one that is the first of its point
is accepted, as nothing controls it; correct ones that come later then fail their tests, and are
rejected one by one. An epoch that ends has all of them: where a large share of the readings of a
point was rejected, all of them enter, and data snooping finds the wrong ones among them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from ..incremental.adjustment import IncrementalAdjustment
from ..ledger.verdicts import SNOOPED
from ..service.answers import Answer
from ..service.stream import Stream

MIN_REJECTED, DOUBTFUL_SHARE = 3, 0.25
"""Readings of a point that were rejected at least, and their share, where its place is doubtful."""
SEARCHER = "site"
"""Who accepts and searches here, in events and among the decisions."""


def doubtful_points(inc: IncrementalAdjustment) -> dict[str, tuple[int, int]]:
    """Return how many readings of doubtful points were rejected, and how many there are, by points.

    Readings count that tests on their arrival or a search have rejected, not those that people have
    taken out.
    """
    out = Counter(p for v in inc.rejected if v.cause in ("", SNOOPED) for p in v.points)
    held = {name for name, point in inc.described.points.items() if all(point.fixed)}
    suspected = {p for p, n in out.items() if n >= MIN_REJECTED and p not in held}
    if not suspected:
        return {}
    there = Counter(
        p for o in inc.described.observations.values() for p in suspected.intersection(o.points())
    )
    return {
        p: (out[p], out[p] + there[p])
        for p in sorted(suspected)
        if out[p] > DOUBTFUL_SHARE * (out[p] + there[p])
    }


def rejection_doubts(inc: IncrementalAdjustment) -> list[str]:
    """Return doubts about points of which a large share of the readings is rejected."""
    on_arrival = {p for v in inc.rejected if not v.cause for p in v.points}
    why = {
        True: "one that came before them may be wrong; accept them, and search for gross errors "
        "(snoop)",
        False: "it may have moved within the epoch, or several of the others are wrong",
    }
    return [
        f"{out} of {every} readings of {p} were rejected: {why[p in on_arrival]}"
        for p, (out, every) in doubtful_points(inc).items()
    ]


def search_again(
    stream: Stream, decided: Callable[[], frozenset[str]]
) -> Iterator[tuple[dict[str, Any], Answer]]:
    """Let readings of doubtful points enter that were rejected on arrival, and search all again.

    Nothing is done where people have accepted readings of the epoch, whose decisions a search could
    undo, where readings have been retired, and under other policies than ``reject``: a doubt then
    stays in the result.

    Args:
        stream: the settled adjustment.
        decided: gives the ids of the readings that people have accepted.

    Yields:
        The commands with their answers; the last one may be a refusal.
    """
    inc = stream.adjustment
    if inc.policy != "reject" or inc.retired is not None or not doubtful_points(inc):
        return
    ids = [v.id for v in inc.rejected if not v.cause]
    if not ids or decided().intersection(inc.described.observations):
        return
    for command in ({"do": "accept", "ids": ids}, {"do": "snoop"}):
        answer = stream.answer_record(command, 0)
        yield command, answer
        if not answer["ok"]:
            return
    inc.settle()
