"""Photos that arrive without poses: they wait, or are oriented from image points."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.image_blocks import ImageBlock, aerial, ring

LONG = pytest.mark.slow("a free block photo by photo; short tests orient the first photos")

SAME = 1e-9
"""Relative difference of vᵀPv of two adjustments that end at one minimum."""


def rays(network: fga.Network) -> dict[str, list]:
    out: dict[str, list] = {name: [] for name in network.photos}
    for i in network.image_points():
        out[i.photo].append(i)
    return out


def empty(block: ImageBlock, **options) -> fga.IncrementalAdjustment:
    """Return an adjustment that has the cameras and the names of points only."""
    network = fga.Network("arrivals", datum=block.network.datum)
    network.cameras = dict(block.network.cameras)
    inc = fga.IncrementalAdjustment(network, **options)
    inc.add(points=block.network.points.values())
    return inc


@LONG
@pytest.mark.parametrize("kind", ["ring", "aerial"])
def test_photos_one_by_one_begin_a_free_block_and_end_at_its_minimum(kind):
    if kind == "ring":
        block = ring(1, photos=7, control=0)
    else:
        block = aerial(2, strips=2, photos=4, n_points=200, control=0)
    inc = empty(block, policy="accept")
    told: dict[str, str] = {}
    for name, own in rays(block.network).items():
        told |= inc.add(own, photos=block.network.photos[name]).oriented
    assert set(told) == set(block.network.photos)
    assert "from image points among 2 photos" in told["F0"] and "F0, F1" in told["F1"]
    assert all("by resection from" in told[f] for f in list(told)[2:])
    inc.settle()
    assert not inc.n_waiting
    assert inc.solution().vtpv == pytest.approx(fga.adjust(block.truth).vtpv, rel=SAME)


@LONG
def test_a_block_waits_for_its_control_and_the_journal_says_how_it_was_oriented(tmp_path):
    block = ring(1, photos=6, control=3)
    inc = empty(block, policy="accept", journal=tmp_path / "journal.jsonl")
    for name, own in rays(block.network).items():
        arrival = inc.add(own, photos=block.network.photos[name])
        assert {v.verdict for v in arrival.verdicts} == {"waiting"}
    arrival = inc.add(list(block.network.observations.values()))
    assert set(arrival.oriented) == set(block.network.photos)
    assert "6 photos" in arrival.oriented["F0"] and "3 known points" in arrival.oriented["F0"]
    inc.settle()
    assert inc.solution().vtpv == pytest.approx(fga.adjust(block.truth).vtpv, rel=SAME)
    lines = [json.loads(line) for line in (tmp_path / "journal.jsonl").read_text().splitlines()]
    assert [line["oriented"] for line in lines if "oriented" in line] == [dict(arrival.oriented)]
    vtpv = inc.solution().vtpv
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal.jsonl")
    assert again.solution().vtpv == pytest.approx(vtpv, rel=SAME)


def test_a_photo_with_few_common_points_waits_and_says_what_it_lacks():
    block = ring(2, photos=4, control=0)
    inc = empty(block)
    own = rays(block.network)
    inc.add(own["F0"][:7], photos=block.network.photos["F0"])
    arrival = inc.add(own["F1"][:7], photos=block.network.photos["F1"])
    assert not arrival.oriented and inc.n_waiting == 14
    assert all(w.lacks for w in inc.waiting)
    arrival = inc.add([*own["F0"][7:40], *own["F1"][7:40]])
    assert set(arrival.oriented) == {"F0", "F1"} and not inc.n_waiting


def test_a_photo_is_oriented_against_photos_that_stand():
    """It shares new points with two photos that are known, and not one known point."""
    block = ring(3, photos=5, control=0)
    network = block.network
    network.datum = "given"
    inc = empty(block, policy="accept")
    own = rays(network)
    for name in ("F0", "F1"):
        truth = block.truth.photos[name]
        inc.add(photos=replace(truth, fixed=(True,) * 6))
    arrival = inc.add(own["F2"], photos=network.photos["F2"])
    assert not arrival.oriented
    arrival = inc.add([*own["F0"][:20], *own["F1"][20:40]])
    words = arrival.oriented["F2"]
    assert "1 of which had poses" in words
    inc.settle()
    at = inc.solution().pose("F2").position
    assert np.linalg.norm(at - block.centres[2]) < 0.05


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
def test_mismatches_of_photos_that_come_without_poses_end_as_suspects():
    block = ring(1, photos=5, control=0, mismatches=0.03)
    inc = empty(block, policy="flag")
    for name, own in rays(block.network).items():
        inc.add(own, photos=block.network.photos[name])
    inc.settle()
    unknowns_left_out = {v.id for v in inc.suspects} | {w.id for w in inc.waiting}
    assert block.mismatched <= unknowns_left_out
    n_good = block.network.n_image_points - len(block.mismatched)
    assert len(unknowns_left_out - block.mismatched) < 0.002 * n_good + 4 * np.sqrt(0.002 * n_good)
    assert 0.95 < inc.solution().sigma0 < 1.05
