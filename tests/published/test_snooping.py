"""Data snooping against published figures: Ghilani 21.1, and a block of AICON 3D Studio."""

from __future__ import annotations

from pathlib import Path

import pytest
from scipy.stats import norm

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.rejections import Snooping
from factorgraph_adj.quality.reliability import reliability
from factorgraph_adj.quality.robust_estimation import ESTIMATORS
from factorgraph_adj.quality.snooping import snoop
from tests.networks.aicon import read_aicon, rejected_image_points
from tests.support.places import data_dir

pytestmark = pytest.mark.published
LONG = pytest.mark.slow(
    "58 gross errors among 10 030 real image points, one after the other; short tests have a few "
    "in small networks"
)

# -- Ghilani, Adjustment Computations, example 21.1: two blunders planted ------------------------


@pytest.fixture(scope="module")
def ghilani() -> Network:
    return read_gama(data_dir("krumm_textbook") / "Ghilani21_1.gkf")


def test_ghilani_21_1_gives_its_blunders_away_in_the_published_order(ghilani: Network) -> None:
    """Largest |w| and m0 of the three steps: README there."""
    found = snoop(ghilani)
    first, second = found.rejected
    assert ghilani.observations[first.id].names() == ("3", "4")
    assert first.kind == "horizontal_distance"
    assert ghilani.observations[second.id].names() == ("103", "102", "1")
    assert second.kind == "horizontal_angle"
    assert (abs(first.test), abs(second.test)) == (
        pytest.approx(1802.59, abs=0.005),
        pytest.approx(110.40, abs=0.005),
    )
    assert (first.round, second.round) == (1, 2)
    sigma0 = [r.sigma0 for r in found.rounds]
    assert sigma0[0] == pytest.approx(482.68, abs=0.005)
    assert sigma0[1] == pytest.approx(30.627, abs=0.0005)
    assert sigma0[2] == pytest.approx(1.1470, abs=5e-5)
    assert found.rounds[2].largest == pytest.approx(3.246, abs=0.0005)
    assert found.critical == pytest.approx(3.29, abs=0.005)
    assert len(found.rounds) == 3
    assert not found.unresolved
    assert not found.readmitted


def test_ghilani_21_1_has_the_published_redundancy_numbers_on_the_way(ghilani: Network) -> None:
    network = ghilani.copy()
    for names, r in ((("3", "4"), 0.6224), (("103", "102", "1"), 0.0316)):
        rel = reliability(adjust(network))
        worst = rel.suspects(1)[0].row
        ident = rel.solution.observations[worst].id
        assert rel.redundancy_numbers[worst] == pytest.approx(r, abs=5e-5)
        assert network.observations[ident].names() == names
        del network.observations[ident]


def test_the_largest_test_value_left_in_ghilani_21_1_is_that_of_fourteen(ghilani: Network) -> None:
    """3.246 belongs to the angle at 2001 (r = 0.0104), as the README says, and to 13 others.

    One redundant observation is all that these 14 share: their test values are the same to seven
    digits and correlated by ±1, so that none of them can be told from the others, and which one
    comes first is a matter of rounding.
    """
    found = snoop(ghilani)
    rel = found.reliability
    worst = rel.suspects(1)[0]
    assert abs(worst.value) == pytest.approx(3.246, abs=0.0005)
    alike = [worst.row, *(row for row, _ in worst.inseparable)]
    assert len(alike) == 14
    assert max(abs(rel.w[alike])) - min(abs(rel.w[alike])) < 1e-5
    names = [ghilani.observations[found.solution.observations.ids[row]].names() for row in alike]
    angle = alike[names.index(("2001", "2000", "201"))]
    assert rel.redundancy_numbers[angle] == pytest.approx(0.0104, abs=0.00005)


def test_the_blunder_of_ghilanis_distance_is_50_metres(ghilani: Network) -> None:
    """Estimated with the other blunder still in, and in the clean network to 3 cm."""
    distance = snoop(ghilani).rejected[0]
    assert distance.estimated_error == pytest.approx(50.0, abs=0.5)
    assert abs(distance.final_error - 50.0) < 3 * distance.final_sigma
    assert distance.final_sigma < 0.03


@pytest.mark.parametrize("estimator", [e for e in ESTIMATORS if e != "danish"])
def test_a_robust_start_ends_at_the_same_two(ghilani: Network, estimator: str) -> None:
    """Huber, IGG III and Tukey set two good angles aside as well, which then fit again.

    The Danish method ends elsewhere: three observations of the traverse that nearly cannot be
    told from the angle at 103 explain it too.
    """
    found = snoop(ghilani, robust=estimator)  # type: ignore[arg-type]
    plain = snoop(ghilani)
    assert {r.id for r in found.rejected} == {r.id for r in plain.rejected}
    assert len(found.readmitted) == 2
    assert found.solution.vtpv == pytest.approx(plain.solution.vtpv, rel=1e-6)


# -- AICON 3D Studio: 58 real gross errors put back ----------------------------------------------

CRITICAL = 4.706214
"""Of the report's test of outliers, |v|/(S0 √r)."""
FOUND_BY_REFERENCE = 52
"""Of 58, by an independent computation: README there."""


@pytest.fixture(scope="module")
def folder() -> Path:
    return data_dir("aicon_jaicov")


@pytest.fixture(scope="module")
def rejected(folder: Path) -> frozenset[str]:
    return frozenset(f"{f}/{p}" for f, p, _, _ in rejected_image_points(folder))


@pytest.fixture(scope="module")
def aicon(folder: Path) -> Snooping:
    """The test is Pope's: S0 is estimated, 0.81 of what σ says."""
    network = read_aicon(folder, with_rejected=True)
    assert network.n_image_points == 10030
    return snoop(network, test="pope", alpha=2 * float(norm.sf(CRITICAL)))


@LONG
def test_most_of_what_aicon_rejected_is_found_and_nothing_else(
    aicon: Snooping, rejected: frozenset[str]
) -> None:
    """53 of 58, none of the 9972 others; the reference found 52, and rejected 3 others.

    One of the 53 was put back when it fitted, and rejected no more.
    """
    assert len(rejected) == 58
    found = {r.id for r in aicon.rejected}
    assert len(found & rejected) >= FOUND_BY_REFERENCE
    assert not found - rejected
    assert not aicon.rejected_points
    assert not aicon.unresolved


@LONG
def test_s0_is_back_where_aicons_is(aicon: Snooping) -> None:
    """0.000406 mm as the reference's, 0.000405 without all 58."""
    assert aicon.rounds[0].sigma0 > 60.0
    assert aicon.solution.sigma0 * 0.0005 < 0.0004065
    assert aicon.critical == pytest.approx(CRITICAL, abs=0.002)  # τ of 18 814 is almost normal


@LONG
def test_what_stays_of_aicons_gross_errors_does_not_stand_out(
    aicon: Snooping, rejected: frozenset[str]
) -> None:
    """Five of them have test values from 3.3 to 4.7: real ones need not be large."""
    left = rejected - {r.id for r in aicon.rejected}
    number = aicon.solution.equations.find(sorted(left))
    largest = [float(abs(aicon.reliability.tau[rows]).max()) for rows in number]
    assert all(t < aicon.critical for t in largest)
    assert min(largest) > 3.29
