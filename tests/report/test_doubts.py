"""Doubts: what makes a result doubtful, and what chance alone makes."""

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import GnssPosition
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.doubtful_results import exceedance_doubts, exceeded_by_chance
from factorgraph_adj.report.html.verdict import adjustment_verdict

CRITICAL, ALPHA = 3.2905, 0.001
FOOT = 0.3048


def test_good_test_values_seldom_raise_a_doubt():
    """One in a hundred by their number and one in a hundred by the largest, at the most."""
    rng = np.random.default_rng(7)
    doubted = above = 0
    for _ in range(1000):
        values = rng.normal(size=4000)
        above += bool(np.any(np.abs(values) > CRITICAL))
        doubted += bool(exceedance_doubts(values, CRITICAL, "w", ALPHA))
    assert above > 950
    assert 3 <= doubted <= 30


@pytest.mark.parametrize("wrong", [[6.0], np.linspace(3.35, 3.45, 15)], ids=["one large", "many"])
def test_one_gross_error_and_many_small_ones_raise_a_doubt(wrong):
    values = np.random.default_rng(1).uniform(-2.0, 2.0, 4000)
    values[: len(wrong)] = wrong
    (text,) = exceedance_doubts(values, CRITICAL, "w", ALPHA)
    assert text.startswith(f"{len(wrong)} test value")
    largest = ", but not the largest, 6.00" if len(wrong) == 1 else ""
    assert text.endswith(f"above the critical |w| 3.29 (chance makes about 4{largest})")


def test_a_good_small_network_seldom_raises_a_doubt():
    """However few the test values are, one or two clean networks in a hundred are doubtful."""
    rng = np.random.default_rng(8)
    for tested in (10, 60, 150, 900):
        values = rng.normal(size=(2000, tested))
        doubted = sum(bool(exceedance_doubts(row, CRITICAL, "w", ALPHA)) for row in values)
        assert 10 <= doubted <= 45, tested


def test_what_chance_does_not_make_is_a_doubt_in_a_small_network_too():
    values = np.linspace(0.1, 1.9, 150)
    values[3] = 3.4
    assert exceeded_by_chance(values, CRITICAL, ALPHA)
    assert not exceedance_doubts(values, CRITICAL, "w", ALPHA)
    values[3] = 4.2
    assert exceedance_doubts(values, CRITICAL, "w", ALPHA)
    values[:5] = np.linspace(3.3, 3.4, 5)
    assert exceedance_doubts(values, CRITICAL, "w", ALPHA)
    values[:] = np.nan
    assert not exceeded_by_chance(values, CRITICAL, ALPHA)
    assert not exceedance_doubts(values, CRITICAL, "w", ALPHA)


def test_a_gross_error_is_a_doubt_where_sigma0_is_estimated():
    """Pope's τ cannot exceed √r = 3: 2.99 is t = 34, and no chance; 2.62 is t = 5.07."""
    values = np.linspace(0.1, 1.5, 16)
    for tau, doubted in ((2.62, False), (2.99, True), (3.0, True)):
        values[3] = tau
        assert bool(exceedance_doubts(values, 2.61, "τ", ALPHA, 9)) is doubted


def test_readings_that_nothing_tells_apart_count_once():
    """Each of 50 sections has three lines, whose test values are equal."""
    rng = np.random.default_rng(9)
    values = np.repeat(rng.normal(size=(2000, 50)), 3, axis=1)
    doubted = sum(bool(exceedance_doubts(row, CRITICAL, "w", ALPHA)) for row in values)
    assert 10 <= doubted <= 45
    wrong = np.linspace(0.1, 1.9, 150)
    wrong[:3] = 4.2
    assert exceedance_doubts(wrong, CRITICAL, "w", ALPHA)


def test_a_report_with_chance_values_is_not_doubtful():
    """1 500 heights, with the largest test values that chance makes: a green light that says so."""
    rng = np.random.default_rng(5)
    network = fga.Network("levels")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (9, 0, 1), fixed="xy")
    for error in rng.normal(0.0, 0.001, 1500):
        network.add(fga.HeightDifference("A", "B", 1.0 + error, sigma=0.001))
    report = Report(fga.adjust(network))
    above = int(np.sum(np.abs(report.tests[0]) > report.tests[1]))
    assert above
    assert not report.doubts
    light = next(
        x for x in adjustment_verdict(report, Texts("en")).lights if x.title == "Test values"
    )
    assert light.colour == "green"
    assert light.text.startswith(f"{above} observation")
    assert light.text.endswith("Chance makes about 1." if 1500 * ALPHA < 1.5 else "about 2.")


def checked(off: float, *, datum: str = "given") -> Report:
    """Return positions with one check point of which the height is off, σ = 5 mm."""
    network = fga.Network("check", datum=datum)
    for name, at in {"A": (0, 0, 0), "B": (10, 0, 5), "C": (3, 9, 7)}.items():
        check = (3.0, 9.0, 7.0 + off) if name == "C" else None
        network.add_point(name, at, check=check)
        network.add(GnssPosition(name, at, sigma=(0.005, 0.005, 0.005)))
    return Report(fga.adjust(network))


def test_a_check_point_far_off_is_a_doubt():
    assert not checked(0.045).doubts
    report = checked(0.9)
    assert report.doubts == [
        "1 check point lies more than 10 standard deviations off: C by 0.900 m in z, σ 0.005 m"
    ]
    found = adjustment_verdict(report, Texts("en"))
    light = next(x for x in found.lights if x.title == "Check points")
    assert (light.colour, light.told, found.colour) == ("red", report.doubts[0], "red")
    # No second light says the same.
    assert sum(x.told == report.doubts[0] for x in found.lights) == 1


def surveyed(unit: float, n: int = 6) -> fga.Network:
    """Return distances between all of n points that have weighted coordinates in another unit."""
    rng = np.random.default_rng(3)
    places = {f"P{i}": rng.uniform(-50, 50, 3) for i in range(n)}
    network = fga.Network("control in another unit")
    for name, at in places.items():
        network.add_point(name, (at + rng.normal(0, 0.01, 3)) / unit, sigma=0.01)
    for a in places:
        for b in places:
            if a < b:
                d = float(np.linalg.norm(places[a] - places[b])) + rng.normal(0, 0.002)
                network.add(fga.SlopeDistance(a, b, d, sigma=0.002))
    return network


def test_control_that_data_snooping_has_used_up_is_a_doubt():
    """With control in feet the rest of it fits, since it only places the network."""
    good, feet = surveyed(1.0), surveyed(FOOT)
    found = fga.snoop(good)
    assert not Report(found.solution, provenance=fga.Provenance(found, good)).doubts
    found = fga.snoop(feet)
    kept = found.solution.equations.blocks
    left = sum(b.n for b in kept if b.fixes == "coordinates")
    doubts = Report(found.solution, provenance=fga.Provenance(found, feet)).doubts
    assert any(
        f"{18 - left} given coordinates were rejected, and the {left} left place the network "
        "without control" in doubt
        for doubt in doubts
    ), doubts
