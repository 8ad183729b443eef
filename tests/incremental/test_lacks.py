"""Why something waits is as it was after a journal has been read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import HeightDifference, SlopeDistance


def waiting(inc: fga.IncrementalAdjustment) -> dict[str, str]:
    """Return what each observation lacks."""
    return {w.id: w.lacks for w in inc.waiting}


def test_a_journal_keeps_what_is_lacking(tmp_path: Path) -> None:
    """Of points with too few readings, of readings that contradict, and of what enters later."""
    network = fga.Network("waiting")
    for name, x in (("A", 0.0), ("B", 60.0)):
        network.add_point(name, (x, 0.0, 100.0), fixed="xyz")
    for name in ("P", "Q"):
        network.add_point(name, (np.nan, np.nan, np.nan))
    journal = tmp_path / "day.jsonl"
    inc = fga.IncrementalAdjustment(network, journal=journal)
    inc.add(SlopeDistance("A", "P", 56.6131, sigma=0.002, id="s1"))
    inc.add(SlopeDistance("B", "P", 44.7316, sigma=0.002, id="s2"))
    inc.add(HeightDifference("A", "Q", 1.0, sigma=0.001, id="h1"))
    inc.add(HeightDifference("A", "P", 2.0, sigma=0.001, id="h2"))
    before = waiting(inc)
    assert set(before) == {"s1", "s2", "h1", "h2"}
    assert "two" in before["s1"] and "1 height difference" in before["h1"]
    del inc
    inc = fga.IncrementalAdjustment.resume(journal)
    assert waiting(inc) == before
    inc.add(points=fga.Point("P", (40.0, 40.0, 102.0)))
    before = waiting(inc)
    assert set(before) == {"h1"}
    del inc
    assert waiting(fga.IncrementalAdjustment.resume(journal)) == before
