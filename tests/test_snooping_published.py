"""Data snooping against published searches: AICON's rejected points, Ghilani's two blunders."""

from __future__ import annotations

import pytest
from conftest import data_dir
from loaders.aicon import SIGMA, read_aicon, rejected_image_points
from scipy.stats import norm

import factorgraph_adj as fga
from factorgraph_adj.io.gama import read_gama

CRITICAL = 4.706214
"""Of the test values in AICON's report."""


@pytest.fixture(scope="module")
def aicon():
    folder = data_dir("aicon_jaicov")
    network = read_aicon(folder, with_rejected=True)
    rejected = {f"{row[0]}/{row[1]}" for row in rejected_image_points(folder)}
    # AICON estimates σ0; τ with 18 000 redundant observations is normal to four digits.
    found = fga.snoop(network, alpha=2.0 * norm.sf(CRITICAL), test="pope")
    return rejected, found


def test_at_least_52_of_the_58_points_that_aicon_rejected_are_found(aicon) -> None:
    rejected, found = aicon
    assert len(rejected) == 58
    ours = {r.id for r in found.rejected}
    ours |= {ray for p in found.points_set_aside for ray in p.rays}
    assert len(ours & rejected) >= 52
    assert len(ours - rejected) <= 3  # as many as the reference takes wrongly


def test_without_them_the_block_is_as_good_as_aicon_says(aicon) -> None:
    """0.000406 mm without what the search sets aside.

    With all 58 the README beside the data has S0 = 0.0641 mm. Ours is 0.0335 mm, with the same
    weights and at rest; the greater of two values is not at the minimum.
    """
    _, found = aicon
    assert found.rounds[0].sigma0 * SIGMA < 0.0641
    assert found.solution.sigma0 * SIGMA == pytest.approx(0.000406, abs=0.5e-6)
    assert found.solution.converged and not found.unresolved


def test_ghilani_21_1_loses_its_two_blunders_in_order_and_no_more() -> None:
    """Figures of the README beside the data: |w| 1802.59 and 110.40, then at most 3.246."""
    network = read_gama(data_dir("krumm_textbook") / "Ghilani21_1.gkf")
    found = fga.snoop(network)
    assert [network.observations[r.id].names() for r in found.rejected] == [
        ("3", "4"),
        ("103", "102", "1"),
    ]
    assert [abs(r.test) for r in found.rejected] == [
        pytest.approx(1802.59, abs=0.005),
        pytest.approx(110.40, abs=0.005),
    ]
    assert [r.round for r in found.rejected] == [1, 2]
    assert [r.sigma0 for r in found.rounds[:3]] == [
        pytest.approx(482.68, abs=0.005),
        pytest.approx(30.627, abs=0.0005),
        pytest.approx(1.1470, abs=0.00005),
    ]
    assert found.solution.redundancy == 12 and not found.unresolved


def test_the_largest_test_value_left_in_ghilani_21_1_is_that_of_fourteen() -> None:
    """3.246 belongs to the angle at 2001 (r = 0.0104), as the README says, and to 13 others.

    One redundant observation is all that these 14 share: their test values are the same to seven
    digits and correlated by ±1, so that none of them can be told from the others.
    """
    network = read_gama(data_dir("krumm_textbook") / "Ghilani21_1.gkf")
    found = fga.snoop(network)
    rel = found.reliability
    worst = rel.suspects(1)[0]
    assert abs(worst.value) == pytest.approx(3.246, abs=0.0005)
    alike = [worst.row, *(row for row, _ in worst.inseparable)]
    assert len(alike) == 14
    assert max(abs(rel.w[alike])) - min(abs(rel.w[alike])) < 1e-5
    names = [network.observations[found.solution.observations.ids[row]].names() for row in alike]
    angle = alike[names.index(("2001", "2000", "201"))]
    assert rel.redundancy_numbers[angle] == pytest.approx(0.0104, abs=0.00005)
