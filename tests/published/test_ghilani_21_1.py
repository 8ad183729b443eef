"""Ghilani, Adjustment Computations, example 21.1: 19 distances, 17 angles, two blunders planted.

Published: adjusted coordinates and σ with the blunders in the ``.adj`` beside the network;
m0 and the iterated test of standardised residuals in the README there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.io.survey.gama import read_gama
from tests.support.dense import Dense
from tests.support.places import data_dir

pytestmark = pytest.mark.published

POINTS_OF_ADJ = ("1", "2", "3", "4", "5", "6", "102", "103", "201", "202", "203")
"""Free points in the order of the .adj, which cuts their names."""


@pytest.fixture(scope="module")
def ghilani() -> Path:
    return data_dir("krumm_textbook") / "Ghilani21_1.gkf"


def test_ghilani_21_1_with_its_blunders_is_adjusted_as_published(ghilani: Path) -> None:
    s = adjust(read_gama(ghilani), variance="a-posteriori")
    assert s.converged
    assert (s.n_observations, s.n_unknowns, s.redundancy) == (36, 22, 14)
    assert s.sigma0 == pytest.approx(482.68, abs=0.005)
    lines = ghilani.with_name("Ghilani21_1_DistanceAngle_fix.adj").read_text().splitlines()
    rows = [line.split()[1:] for line in lines if line and not line.startswith("#")]
    for point, row in zip(POINTS_OF_ADJ, rows, strict=True):
        x, _, sigma_x, y, _, sigma_y, _ = (float(w) for w in row)  # m, and σ in cm
        np.testing.assert_allclose(s.point(point)[:2], (x, y), rtol=0, atol=0.501e-4)
        np.testing.assert_allclose(
            s.standard_deviations(point)[:2] * 100, (sigma_x, sigma_y), rtol=0, atol=0.501e-3
        )


def test_ghilani_21_1_loses_its_blunders_one_by_one(ghilani: Path) -> None:
    """The greatest |v|/(σ √r) names them: distance 3-4 first, then the angle at 103."""
    network = read_gama(ghilani)
    found = []
    for _ in range(2):
        s = adjust(network)
        dense = Dense.at(s.equations, s.state)
        r = dense.redundancy_numbers()
        w = np.abs(dense.residual) / np.sqrt(r)
        worst = int(np.argmax(w))
        ident = s.observations.ids[worst]
        found.append((network.observations.pop(ident).names(), w[worst], r[worst]))
    (first, w1, r1), (second, w2, r2) = found
    assert (first, second) == (("3", "4"), ("103", "102", "1"))
    assert (w1, w2) == (pytest.approx(1802.59, abs=0.005), pytest.approx(110.40, abs=0.005))
    assert (r1, r2) == (pytest.approx(0.6224, abs=5e-5), pytest.approx(0.0316, abs=5e-5))
    s = adjust(network)
    assert (s.n_observations, s.redundancy) == (34, 12)
    assert s.sigma0 == pytest.approx(1.1470, abs=5e-5)
