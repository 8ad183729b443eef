"""Ids name one observation each, image points among them, live and after the journal is read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import ImagePoint, SlopeDistance
from factorgraph_adj.simulation.measurement import measure
from tests.networks.small_block import plan
from tests.support.arrivals import bare, items

LONG = pytest.mark.slow(
    "journals of blocks with rejected image points; short tests take terrestrial readings"
)

MM = 1e-3


def block(journal: Path | None = None) -> tuple[fga.IncrementalAdjustment, ImagePoint]:
    """Return a block without one of its image points, and that image point."""
    network = measure(plan(), seed=3)
    every = items(network)
    (ray, *_) = [i for i in every if isinstance(i, ImagePoint)]
    inc = fga.IncrementalAdjustment(bare(network), journal=journal)
    inc.add([i for i in every if i is not ray])
    return inc, ray


def test_an_image_point_with_the_id_of_another_observation_is_refused() -> None:
    """And so is an observation with the id of an image point; nothing changes."""
    inc, ray = block()
    other = next(iter(inc.network().observations))
    there = next(iter(inc.network().image_points()))
    n = len(inc)
    with pytest.raises(fga.InputError, match=f"duplicate id '{other}'"):
        inc.add(replace(ray, id=other))
    taken = replace(inc.observation(other), id=f"{there.photo}/{there.point}")  # type: ignore[call-arg]
    with pytest.raises(fga.InputError, match="duplicate id"):
        inc.add(taken)
    assert len(inc) == n
    assert inc.observation(other) is not None
    inc.add(replace(ray, id="q"))
    with pytest.raises(fga.InputError, match="duplicate id 'q'"):
        inc.add(SlopeDistance(there.point, ray.point, 1.0, sigma=MM, id="q"))


@LONG
@pytest.mark.parametrize("own", ["first", "again"])
def test_the_journal_tells_a_rejected_image_point_from_its_repetition(
    own: str, tmp_path: Path
) -> None:
    """One of the two has an id of its own."""
    journal = tmp_path / "block.jsonl"
    inc, ray = block(journal)
    wrong = replace(ray, x=ray.x + 0.5, id="wrong" if own == "first" else None, source="card 7")
    (verdict,) = inc.add(wrong).verdicts
    assert verdict.verdict == "suspect"
    inc.discard(verdict.id)
    inc.add(replace(ray, id="right" if own == "again" else None))
    resumed = fga.IncrementalAdjustment.resume(_closed(inc, journal))
    assert resumed.observation(verdict.id).source == "card 7"
    del resumed
    inc = fga.IncrementalAdjustment.resume(journal)
    inc.remove(verdict.id)
    n = len(inc)
    del inc
    after = fga.IncrementalAdjustment.resume(journal)
    assert len(after) == n
    assert not after.rejected
    right = "right" if own == "again" else f"{ray.photo}/{ray.point}"
    assert after.observation(right).x == ray.x  # type: ignore[attr-defined]


def _closed(inc: fga.IncrementalAdjustment, journal: Path) -> Path:
    assert inc._journal is not None
    inc._journal.close()
    return journal


def test_a_suspect_is_not_let_in_while_what_contradicts_it_is_changed() -> None:
    """Neither by other weights nor by another value of the good one."""
    for change in ("reweight", "replace"):
        network = fga.Network("a line")
        network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
        network.add_point("B", (10.0, 0.0, 0.0), fixed="yz", sigma=(0.1, np.inf, np.inf))
        inc = fga.IncrementalAdjustment(network)
        inc.add(SlopeDistance("A", "B", 10.000, sigma=2 * MM, id="good"))
        inc.add(SlopeDistance("A", "B", 10.050, sigma=2 * MM, id="bad"))
        if change == "reweight":
            inc.reweight("good", 1.0)
        else:
            inc.replace("good", SlopeDistance("A", "B", 10.0001, sigma=2 * MM))
        assert [v.id for v in inc.suspects] == ["bad"]
        assert len(inc) == 1


def test_what_waits_is_tested_after_its_weights_have_changed() -> None:
    """It is not let in because it was asked for by name."""
    network = fga.Network("a line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (10.0, 0.0, 0.0), fixed="yz", sigma=(0.1, np.inf, np.inf))
    network.add_point("C", (20.0, 0.0, 0.0), fixed="z")
    inc = fga.IncrementalAdjustment(network)
    inc.add(SlopeDistance("A", "B", 10.000, sigma=2 * MM, id="AB"))
    assert (
        inc.add(SlopeDistance("B", "C", 10.0, sigma=MM, id="BC")).verdicts[0].verdict == "waiting"
    )
    (verdict,) = inc.reweight("BC", 4.0).verdicts
    assert verdict.verdict == "waiting"
    with pytest.raises(fga.InputError, match="weighted point B x: is a given value with its own σ"):
        inc.reweight("point B x", 2.0)
