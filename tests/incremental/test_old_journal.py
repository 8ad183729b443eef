"""Journals of version 1, which 0.4 and 0.5 wrote, open.

``version_1.jsonl`` was written by version 0.5.0: the small block of the tests, photo by photo, with
a gross error in one image point; then a removal, a reweighting, a suspect that was discarded, and
`settle`. What the adjustment answered at the end is typed in here.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import SlopeDistance

JOURNAL = Path(__file__).with_name("version_1.jsonl")


def test_it_is_as_it_was_and_goes_on(tmp_path: Path) -> None:
    journal = Path(shutil.copy(JOURNAL, tmp_path))
    inc = fga.IncrementalAdjustment.resume(journal)
    assert not inc.resumed
    assert (len(inc), inc.n_waiting, inc.redundancy) == (93, 0, 73)
    assert [v.id for v in inc.rejected] == ["F2/P3"]
    assert inc.rejected[0].test > 1
    assert inc.sigma0 == pytest.approx(1.031238041618281, rel=1e-9)
    assert inc.estimate("P1") == pytest.approx([-2.915961, -2.41598, 0.084213], abs=1e-6)
    inc.accept("F2/P3")
    inc.add(SlopeDistance("P1", "P6", 5.0, sigma=5.0, id="tape"))
    n, at = len(inc), inc.estimate("P1")
    assert n == 95
    del inc  # which lets go of the journal
    again = fga.IncrementalAdjustment.resume(journal)
    assert len(again) == n
    assert not again.rejected
    assert again.estimate("P1") == pytest.approx(at, abs=1e-5)
