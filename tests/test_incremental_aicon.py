"""Real arrivals: a close-range block photo by photo, with 58 real gross errors in the stream.

AICON 3D Studio rejected 58 of 10 030 image points of this block, in the finished adjustment. Here
they arrive with the others, photo after photo in the order of the file, and each is tested
against what is there by then: early photos have little to be compared with. What passes on
arrival is found, or not, by data snooping in the evening.

AICON's limit is |v|/(S0 √r) = 4.706 with its S0 of 0.81; in a-priori σ that is 3.82 for each
coordinate. The probability of that is the α of arrivals here, for both coordinates together (T²).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from arrivals import bare
from conftest import data_dir
from loaders.aicon import read_aicon, rejected_image_points
from scipy.stats import norm

from factorgraph_adj import IncrementalAdjustment, Network, adjust
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.quality.rejections import Snooping
from factorgraph_adj.solve.batch import Solution

CRITICAL = 4.706214
"""Of the report's test of outliers, |v|/(S0 √r)."""
S0 = 0.810728
"""Of the reference, without the 58."""
ALPHA = 2 * float(norm.sf(CRITICAL * S0))
FOUND_IN_BATCH = 53
"""Of the 58, by snooping in the whole block: tests/test_snooping_published.py."""


@dataclass(frozen=True)
class Day:
    """What became of the stream."""

    network: Network
    """With the 58."""
    bad: frozenset[str]
    """Ids of the 58."""
    on_arrival: frozenset[str]
    """Rejected as they arrived."""
    waiting: int
    """What waits when all has come."""
    evening: Snooping
    """What snooping found after that."""
    inc: IncrementalAdjustment


@pytest.fixture(scope="module")
def folder() -> Path:
    return data_dir("aicon_jaicov")


@pytest.fixture(scope="module")
def day(folder: Path) -> Day:
    network = read_aicon(folder, with_rejected=True)
    inc = IncrementalAdjustment(bare(network), policy="reject", alpha=ALPHA)
    inc.add(list(network.observations.values()))
    of_photo: dict[str, list[ImagePoint]] = {}
    for o in network.image_points():
        of_photo.setdefault(o.photo, []).append(o)
    for rays in of_photo.values():
        inc.add(rays)
    rejected = frozenset(v.id for v in inc.rejected)
    waiting = inc.n_waiting
    evening = inc.snoop(test="pope", alpha=2 * float(norm.sf(CRITICAL)))
    inc.settle()
    bad = frozenset(f"{f}/{p}" for f, p, _, _ in rejected_image_points(folder))
    return Day(network, bad, rejected, waiting, evening, inc)


def test_everything_has_entered_or_was_rejected(day: Day) -> None:
    assert day.waiting == 0
    assert len(day.bad) == 58
    assert day.network.n_image_points == 10030
    assert len(day.inc) + len(day.inc.rejected) == 10031
    assert day.inc.suspects == ()
