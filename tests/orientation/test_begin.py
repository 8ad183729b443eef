"""One place where a start is found: everything that adjusts begins from images as `adjust` does."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.parts.part_files import RunFolder
from factorgraph_adj.parts.whole_network import cut_network
from tests.networks.image_blocks import ImageBlock, aerial, ring
from tests.support.studies import cases

LONG = pytest.mark.slow(
    "every computation that begins from images; short tests begin arrivals and what fits again"
)

SAME = 1e-9
"""Relative difference of vᵀPv of two adjustments that end at one minimum."""


@pytest.fixture(scope="module")
def free() -> ImageBlock:
    """Return a ring without control."""
    return ring(1, photos=8, control=0)


@pytest.fixture(scope="module")
def held() -> ImageBlock:
    """Return a ring with three control points: no photo can be resected from four."""
    return ring(2, photos=8, control=3)


@LONG
def test_robust_adjustment_begins_from_images(free):
    found = fga.robust_adjust(free.network)
    assert found.converged
    start = fga.adjust(free.truth)
    again = fga.robust_adjust(free.truth, start=start)
    assert found.solution.vtpv == pytest.approx(again.solution.vtpv, rel=1e-4)  # weights: 1 %
    assert found.solution.begun


@LONG
def test_variance_components_begin_from_images(held):
    found = fga.estimate_variance_components(held.network)
    true = fga.estimate_variance_components(held.truth)
    assert found.converged
    for ours, theirs in zip(found.components, true.components, strict=True):
        assert ours.factor == pytest.approx(theirs.factor, rel=1e-3)


def test_snooping_begins_from_images_and_tests_as_from_the_truth(free):
    found, true = fga.snoop(free.network), fga.snoop(free.truth)
    assert set(found.rejected_ids) == set(true.rejected_ids)
    assert found.solution.vtpv == pytest.approx(true.solution.vtpv, rel=SAME)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize(
    ("kind", "control"), cases(product([ring, aerial], [0, 8]), [(ring, 0), (aerial, 8)])
)
def test_snooping_sets_mismatches_aside_and_only_a_few_others(kind, control):
    """A block with mismatches has no minimum, or a bent one: the search begins without them.

    Good image points that are rejected are false alarms, with a probability of 0.1 % of each of
    two components, or belong to a point whose other image points are mismatches.
    """
    block = kind(3, control=control, mismatches=0.05)
    found = fga.snoop(block.network)
    gone = set(found.rejected_ids)
    assert block.mismatched <= gone
    _, point, _, _ = block.network.images.columns()
    names = list(block.network.points)
    n_bad = dict.fromkeys(names, 0)
    for ident in block.mismatched:
        n_bad[ident.split("/")[1]] += 1
    rays = np.bincount(point, minlength=len(names))
    alone = {n for i, n in enumerate(names) if rays[i] - n_bad[n] < 2}
    alarms = {i for i in gone - block.mismatched if i.split("/")[1] not in alone}
    mean = 0.002 * block.network.n_image_points
    assert len(alarms) < mean + 4 * np.sqrt(mean)
    assert not found.unresolved
    assert 0.95 < found.solution.sigma0 < 1.05
    assert all(np.isfinite(r.test) for r in found.rejected)


def test_what_fits_comes_back():
    """Good image points that are doubted at the start come back by the tests, each once."""
    block = ring(4, photos=8, control=0, mismatches=0.03)
    start = fga.orient(block.network).start
    assert start is not None
    names = [f"{i.photo}/{i.point}" for i in block.network.image_points()]
    good = [n for n in names if n not in block.mismatched][::150]
    doubting = replace(start, doubtful=(*start.doubtful, *good))
    from factorgraph_adj.quality.snooping import clean_adjustment, clean_search

    clean = clean_adjustment(block.network, doubting, {})
    search = clean_search(
        block.network,
        doubting,
        clean,
        test="baarda",
        alpha=0.001,
        power=0.8,
        options={},
        withdrawing=True,
    )
    assert set(good) <= set(search.ids_aside())
    search.run(0.4, 100, None)
    assert set(good) <= set(search.readmitted)
    assert not set(good) & set(search.ids_aside())
    assert block.mismatched <= set(search.ids_aside())


@LONG
def test_robust_adjustment_of_a_block_with_mismatches():
    block = ring(2, control=0, mismatches=0.05)
    found = fga.robust_adjust(block.network)
    assert found.converged
    light = {o.id for o, g in zip(found.solution.observations, found.weights, strict=True) if g < 1}
    assert block.mismatched <= light
    clean = fga.orient(block.network).without_doubtful()
    true = fga.adjust(clean, start=found.solution)
    moved = np.linalg.norm(found.solution.point("P3") - true.point("P3"))
    assert moved < 3 * np.sqrt(np.trace(true.covariance("P3")))


@LONG
def test_a_point_whose_two_rays_do_not_meet_is_named_with_the_way_out():
    block = aerial(5, strips=2, photos=4, n_points=300, control=0, mismatches=0.1)
    solution = fga.adjust(block.network)
    assert not solution.converged
    assert "gross errors" in solution.reason and "adjust --snoop" in solution.reason
    with pytest.raises(fga.DatumError, match=r"is not determined(.|\n)*fga.snoop"):
        fga.robust_adjust(block.network)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
def test_snooping_begins_from_images_where_resections_led_nowhere():
    """Eight control points, one image of them a mismatch: a resection from them is wrong."""
    block = aerial(3, mismatches=0.05)
    assert not fga.adjust(block.network).converged
    found = fga.snoop(block.network)
    assert block.mismatched <= set(found.rejected_ids)
    assert found.solution.begun


@LONG
def test_parts_begin_from_images(held, tmp_path):
    parts = cut_network(held.network, 2, RunFolder(tmp_path / "parts").made())
    found = fga.adjust_parts(parts, folder=tmp_path / "run", name="ring")
    assert found.vtpv == pytest.approx(fga.adjust(held.truth).vtpv, rel=SAME)


def test_arrivals_begin_from_images(free):
    adjustment = fga.IncrementalAdjustment(free.network)
    assert adjustment.solution().vtpv == pytest.approx(fga.adjust(free.truth).vtpv, rel=SAME)


def test_memory_is_estimated_from_images(free):
    assert fga.memory_needed(free.network).total > 0


@LONG
def test_a_plan_begins_from_images_that_were_taken(held):
    """The precision of a plan is that of the adjustment of the same photos."""
    planned, real = fga.plan(held.network), fga.adjust(held.network)
    a, b = planned.solution.standard_deviations("P3"), real.standard_deviations("P3")
    np.testing.assert_allclose(a, b, rtol=0.01)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
def test_commands_begin_from_images(free, held, tmp_path, capsys):
    mixed = aerial(3, strips=2, photos=4, n_points=300, control=0, mismatches=0.05)
    for name, network in (("free", free.network), ("held", held.network), ("bad", mixed.network)):
        fga.write_project(network, tmp_path / name / "project.toml")
    at = {name: str(tmp_path / name) for name in ("free", "held", "bad")}
    assert main(["adjust", at["free"], "--variance-components", "kind", "--quiet"]) == 0
    assert main(["plan", at["held"]]) == 0
    assert main(["compare", at["free"], at["free"]]) == 0
    assert main(["adjust", at["bad"]]) == 2
    assert "adjust --snoop" in capsys.readouterr().err
    assert main(["adjust", at["bad"], "--snoop", "--quiet"]) == 0
    assert "observations rejected" in capsys.readouterr().err
