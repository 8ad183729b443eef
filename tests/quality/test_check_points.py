"""Check points: differences, their standard deviations, and root mean squares."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import GnssPosition, HeightDifference
from factorgraph_adj.quality.point_precision import check_points
from factorgraph_adj.report.text import text_report
from tests.networks.dbat import read_sxb
from tests.networks.small_block import CHECKED, small_block
from tests.networks.total_station import POINTS, total_station
from tests.support.places import data_dir

NAN = math.nan


def by_hand() -> Network:
    """Return three positioned points with known coordinates, one known in height only."""
    network = Network("check")
    for name, check in {
        "A": (0.003, 0.0, -0.010),
        "B": (9.999, 0.002, 5.0),
        "C": (NAN, NAN, 7.004),
        "D": None,
    }.items():
        at = {"A": (0, 0, 0), "B": (10, 0, 5), "C": (3, 3, 7), "D": (1, 1, 1)}[name]
        network.add_point(name, at, check=check)
        network.add(GnssPosition(name, at, sigma=(0.001, 0.002, 0.005)))
    return network


def test_figures_computed_by_hand():
    found = check_points(fga.adjust(by_hand()))
    assert found.names == ("A", "B", "C")
    np.testing.assert_allclose(
        found.differences,
        [[-0.003, 0.0, 0.010], [0.001, -0.002, 0.0], [NAN, NAN, -0.004]],
        atol=1e-12,
    )
    np.testing.assert_allclose(found.sigmas, [[0.001, 0.002, 0.005]] * 3, rtol=1e-9)
    np.testing.assert_allclose(
        found.normalised, [[-3, 0, 2], [1, -1, 0], [NAN, NAN, -0.8]], atol=1e-9
    )
    assert found.counts == (2, 2, 3)
    mm = 1e3 * found.rms
    assert mm == pytest.approx([math.sqrt(5), math.sqrt(2), math.sqrt(116 / 3)])
    assert 1e3 * found.mean == pytest.approx([-1.0, -1.0, 2.0])
    assert 1e3 * found.rms_sigma == pytest.approx([1.0, 2.0, 5.0])


def test_a_held_coordinate_has_a_difference_but_no_normalised_one():
    network = Network("levels")
    network.add_point("A", (0, 0, 1), fixed="xyz")
    network.add_point("B", (5, 0, 2), fixed="xy", check=(5.001, 0, 2.003))
    network.add(HeightDifference("A", "B", 1.0, sigma=0.001))
    found = check_points(fga.adjust(network))
    np.testing.assert_allclose(found.differences, [[-0.001, 0, -0.003]], atol=1e-12)
    assert found.sigmas[0].tolist() == pytest.approx([0, 0, 0.001])
    assert np.isnan(found.normalised[0, :2]).all()
    assert found.normalised[0, 2] == pytest.approx(-3.0)


def test_without_check_points_there_is_nothing_to_compare():
    found = check_points(fga.adjust(total_station(1, coarse=0.1)))
    assert found.names == ()
    assert found.differences.shape == found.sigmas.shape == found.normalised.shape == (0, 3)
    assert found.counts == (0, 0, 0)
    assert np.isnan(found.rms).all()
    assert np.isnan(found.mean).all()


@pytest.mark.slow(
    "many simulated blocks, for the law of the differences; the figures themselves have short tests"
)
def test_differences_of_simulated_blocks_scatter_as_their_standard_deviations_say():
    """40 seeded blocks, three check points of three coordinates: Σ(d/σ)² of one is not χ² of 9,
    as points are correlated, but its mean is 9."""
    squares = []
    for seed in range(40):
        found = check_points(fga.adjust(small_block(seed)))
        assert found.names == CHECKED
        squares.append(float(np.sum(found.normalised**2)))
    spread = np.std(squares) / math.sqrt(len(squares))
    assert np.mean(squares) == pytest.approx(9.0, abs=3.5 * spread)
    assert spread < 1.5


def test_the_report_prints_these_figures():
    solution = fga.adjust(small_block())
    found = check_points(solution)
    text = text_report(solution)
    section = text[text.index("Check points") :].split("\n\n")[0]
    for label, values in (("RMS ", found.rms), ("RMS σ", found.rms_sigma)):
        line = next(row for row in section.splitlines() if row.strip().startswith(label))
        printed = [float(v) for v in line.split()[-3:]]
        assert printed == pytest.approx((1e3 * values).tolist(), abs=0.005)


def test_in_a_free_network_the_differences_belong_to_its_datum():
    """Inner constraints over all points leave no mean difference to what they refer to."""
    network = total_station(3, coarse=0.0)
    for name, x in POINTS.items():
        network.points[name] = replace(network.points[name], check=tuple(x.tolist()))
    found = check_points(fga.adjust(network))
    assert len(found.names) == len(POINTS)
    np.testing.assert_allclose(found.mean, 0.0, atol=1e-9)
    assert found.rms.min() > 1e-5


def test_the_check_points_of_an_aerial_block():
    """DBAT's differences, their RMS in space and its a-posteriori standard deviations, metres."""
    solution = fga.adjust(read_sxb(data_dir("dbat_sxb")), variance="a-posteriori")
    found = check_points(solution)
    order = [found.names.index(n) for n in ("351", "410")]
    assert len(found.names) == 2
    published = [[0.167, 0.008, -0.459], [0.096, -0.296, 0.136]]
    np.testing.assert_allclose(found.differences[order], published, rtol=0, atol=0.5e-3)
    sigmas = [[0.0551, 0.0347, 0.240], [0.0345, 0.0356, 0.180]]
    half = [[0.5e-4, 0.5e-4, 0.5e-3]] * 2
    assert (np.abs(found.sigmas[order] - sigmas) < half).all()
    assert math.sqrt(np.sum(found.rms**2)) == pytest.approx(0.421, abs=0.5e-3)
