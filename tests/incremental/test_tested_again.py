"""What was left out is tested again when it may fit by now, and says so when it comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import SlopeDistance

MM = 1e-3


def line(journal: Path | None = None) -> fga.IncrementalAdjustment:
    """Return two points on a line, one of them roughly known."""
    network = fga.Network("a line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (10.0, 0.0, 0.0), fixed="yz", sigma=(1.0, np.inf, np.inf))
    network.add_point("C", (5.0, 0.0, 0.0), fixed="yz")
    network.add(SlopeDistance("A", "C", 5.001, sigma=2 * MM, id="elsewhere"))
    network.add(SlopeDistance("A", "B", 10.050, sigma=2 * MM, id="wrong"))
    return fga.IncrementalAdjustment(network, journal=journal)


def measured(value: float, ident: str) -> SlopeDistance:
    """Return a distance."""
    return SlopeDistance("A", "B", value, sigma=2 * MM, id=ident)


def test_suspects_come_back_when_what_they_contradicted_has_left(tmp_path: Path) -> None:
    """Two right readings beside a wrong one that came first."""
    journal = tmp_path / "line.jsonl"
    inc = line(journal)
    for value, ident in ((10.002, "first"), (10.000, "second")):
        assert inc.add(measured(value, ident)).verdicts[0].verdict == "suspect"
    arrival = inc.remove("wrong")
    assert not arrival.waits
    assert [v.id for v in arrival.verdicts] == ["first", "second"]
    assert all(v.verdict == "accepted" and v.entered for v in arrival.verdicts)
    assert not inc.suspects
    inc.settle()
    assert inc.estimate("B")[0] == pytest.approx(10.001, abs=1e-6)
    assert inc.solution().vtpv == pytest.approx(fga.adjust(inc.network()).vtpv, rel=1e-6)
    del inc
    again = fga.IncrementalAdjustment.resume(journal)
    assert not again.suspects
    assert len(again) == 3


def test_a_suspect_that_does_not_fit_yet_keeps_its_first_figures() -> None:
    """It contradicts what is in, whatever else leaves."""
    inc = line()
    inc.add(measured(10.051, "other"))
    (suspect,) = inc.add(measured(10.002, "lone")).verdicts
    arrival = inc.remove("other")
    assert not arrival.verdicts
    (told,) = inc.suspects
    assert told.t2 == suspect.t2
