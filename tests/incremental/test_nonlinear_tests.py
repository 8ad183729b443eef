"""What bends within σ of a weak unknown is tested by adjusting with it and without."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import HeightDifference, SlopeDistance

LONG = pytest.mark.slow(
    "twelve starts on either side of the stations; short tests take single arrivals"
)

STATIONS = {"A": (0, 0, 0.0), "B": (100, 0, 0.0), "C": (60, 90, 0.0), "D": (0, 80, 0.0)}
TRUE = np.array([45.0, 40.0, 12.0])
SIGMA = 0.002


def distances(noise: int | None = None) -> dict[str, SlopeDistance]:
    e = np.zeros(4) if noise is None else np.random.default_rng(noise).standard_normal(4)
    return {
        k: SlopeDistance(
            k, "P", float(np.linalg.norm(TRUE - x)) + SIGMA * e[n], sigma=SIGMA, id=f"{k}P"
        )
        for n, (k, x) in enumerate(STATIONS.items())
    }


def near_the_plane(z: float, weight: float) -> fga.Network:
    """Return four held stations in a plane, and P near it; its height has a weak weight."""
    net = fga.Network("plane")
    for k, x in STATIONS.items():
        net.add_point(k, tuple(float(v) for v in x), fixed="xyz")
    net.add_point("P", (45.5, 39.6, z), sigma=(np.inf, np.inf, weight))
    return net


def assert_right(inc: fga.IncrementalAdjustment) -> None:
    assert not inc.suspects
    assert len(inc) == 4
    at = inc.estimate("P")
    at[2] = abs(at[2])  # the other side fits as well, but for the weak weight
    assert at == pytest.approx(TRUE, abs=0.03)
    batch = fga.adjust(inc.network(), start=inc.solution())
    moved = np.abs(inc.estimate("P") - batch.point("P")) / batch.standard_deviations("P")
    assert moved.max() < 0.01
    assert inc.standard_deviations("P") == pytest.approx(batch.standard_deviations("P"), rel=0.01)


@LONG
@pytest.mark.parametrize("weight", [10.0, 1000.0])
@pytest.mark.parametrize("z", [-5.0, -1.0, 0.0, 0.5, 2.0, 5.0])
def test_from_any_start_all_four_readings_are_accepted(z, weight):
    inc = fga.IncrementalAdjustment(near_the_plane(z, weight))
    verdicts = [v for o in distances(4).values() for v in inc.add(o).verdicts]
    assert "suspect" not in {v.verdict for v in verdicts}
    assert_right(inc)
    inc.settle()
    assert_right(inc)


@pytest.mark.parametrize("order", list(permutations("ABCD"))[::5])
def test_in_any_order(order):
    inc = fga.IncrementalAdjustment(near_the_plane(0.0, 1000.0))
    every = distances(7)
    for name in order:
        inc.add(every[name])
    assert_right(inc)


def test_together_and_in_two_parts():
    every = list(distances(2).values())
    for parts in ([every], [every[:2], every[2:]], [every[:3], every[3:]]):
        inc = fga.IncrementalAdjustment(near_the_plane(0.0, 1000.0))
        for part in parts:
            inc.add(part)
        assert_right(inc)


def test_with_the_journal_it_is_the_same(tmp_path):
    inc = fga.IncrementalAdjustment(near_the_plane(0.0, 10.0), journal=tmp_path / "day.jsonl")
    for o in distances(3).values():
        inc.add(o)
    assert_right(inc)
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert_right(again)


@pytest.mark.parametrize("policy", ["flag", "reject"])
def test_a_gross_error_is_still_found(policy):
    """The fifth distance is wrong by 25 σ: no place of P explains it with the others."""
    net = near_the_plane(1.0, 1000.0)
    net.add_point("E", (110.0, 70.0, 3.0), fixed="xyz")
    inc = fga.IncrementalAdjustment(net, policy=policy)
    for o in distances(5).values():
        inc.add(o)
    wrong = float(np.linalg.norm(TRUE - (110.0, 70.0, 3.0))) + 25 * SIGMA
    (v,) = inc.add(SlopeDistance("E", "P", wrong, sigma=SIGMA, id="wrong")).verdicts
    assert inc.estimate("P")[2] > 0
    assert v.verdict == ("suspect" if policy == "flag" else "rejected")
    if policy == "flag":
        inc.discard("wrong")
    assert_right(inc)


def test_what_contradicts_the_weight_itself_stays_a_suspect():
    """With σ of 1 cm the height of the start is known, and no reading moves it by 12 m."""
    inc = fga.IncrementalAdjustment(near_the_plane(0.0, 0.01))
    found = [v.verdict for o in distances().values() for v in inc.add(o).verdicts]
    assert found[-1] == "suspect"
    assert abs(inc.estimate("P")[2]) < 0.1


def test_suspects_that_fit_after_settling_come_back():
    """A levelled height was wrong; without it the two suspects fit at once, with it none."""
    net = near_the_plane(0.0, 1000.0)
    inc = fga.IncrementalAdjustment(net)
    inc.add(HeightDifference("A", "P", 0.0, sigma=0.001, id="wrong"))
    for o in distances(1).values():
        inc.add(o)
    assert {v.id for v in inc.suspects} == {"CP", "DP"}
    inc.remove("wrong")
    inc.settle()
    assert_right(inc)


ABOVE = (20.0, 20.0, 30.0)
"""A station above the plane."""


def other_side() -> fga.IncrementalAdjustment:
    """Return a day on which four distances have put P below the plane; it is above."""
    network = near_the_plane(-10.0, np.inf)
    network.add_point("Q", ABOVE, fixed="xyz")
    inc = fga.IncrementalAdjustment(network)
    for o in distances().values():
        inc.add(o)
    assert inc.estimate("P") == pytest.approx(TRUE * (1.0, 1.0, -1.0), abs=0.01)
    return inc


TELLING = {
    "a levelled height": HeightDifference("A", "P", 12.0, sigma=SIGMA),
    "a distance from above": SlopeDistance(
        "Q", "P", float(np.linalg.norm(TRUE - ABOVE)), sigma=SIGMA
    ),
}
"""Readings that say on which side of the plane P is."""


@pytest.mark.parametrize("what", TELLING)
def test_a_reading_that_tells_the_side_moves_the_point_there(what):
    inc = other_side()
    (v,) = inc.add(TELLING[what]).verdicts
    assert v.verdict == "accepted"
    assert inc.estimate("P") == pytest.approx(TRUE, abs=0.01)
    assert not inc.suspects


def test_a_reading_that_fits_on_neither_side_is_a_suspect():
    inc = other_side()
    (v,) = inc.add(HeightDifference("A", "P", 11.9, sigma=SIGMA)).verdicts
    assert v.verdict == "suspect"
    assert inc.estimate("P")[2] == pytest.approx(-12.0, abs=0.01)


def test_the_solution_tells_of_the_other_side_before_settling():
    inc = other_side()
    (told,) = inc.solution().second_places
    assert "point 'P' fits equally well at 45.0000, 40.0000, 12.0000" in told
    inc.add(SlopeDistance("B", "P", 69.0, sigma=1.0))
    assert inc.solution().second_places


def test_a_station_may_stand_where_the_image_of_a_point_is():
    """The reading has no answer at the image: it is judged, and ends in no error."""
    network = near_the_plane(-10.0, np.inf)
    network.add_point("Q", TRUE, fixed="xyz")
    inc = fga.IncrementalAdjustment(network)
    for o in distances().values():
        inc.add(o)
    (v,) = inc.add(SlopeDistance("Q", "P", 20.0, sigma=SIGMA)).verdicts
    assert v.verdict == "suspect"
    assert inc.estimate("P")[2] == pytest.approx(-12.0, abs=0.01)


WRONG = HeightDifference("A", "P", -12.0, sigma=SIGMA, id="wrong")
"""A levelled height with the wrong sign."""


def right_side() -> fga.IncrementalAdjustment:
    """Return a day on which four distances have put P above the plane, where it is."""
    network = near_the_plane(10.0, np.inf)
    network.add_point("Q", ABOVE, fixed="xyz")
    inc = fga.IncrementalAdjustment(network)
    inc.add(list(distances().values()))
    return inc


def test_a_reading_that_alone_tells_the_side_is_accepted_with_a_doubt():
    inc = right_side()
    (v,) = inc.add(WRONG).verdicts
    assert v.verdict == "accepted"
    assert v.doubt == "moves 'P' by 24 m to its other side; no other reading determines the side"
    (doubt,) = inc.doubts
    assert doubt.startswith(
        "'wrong' alone determines the side of point 'P': without it, 45.0000, 40.0"
    )
    assert doubt in repr(inc)
    assert doubt in inc.solution().second_places


@pytest.mark.parametrize("what", TELLING)
def test_a_suspect_names_the_reading_that_alone_tells_the_side(what, tmp_path):
    network = near_the_plane(10.0, np.inf)
    network.add_point("Q", ABOVE, fixed="xyz")
    inc = fga.IncrementalAdjustment(network, journal=tmp_path / "day.jsonl")
    inc.add(list(distances().values()))
    inc.add(WRONG)
    (v,) = inc.add(replace(TELLING[what], id="right")).verdicts
    assert v.verdict == "suspect"
    assert v.doubt == "fits without 'wrong', which alone determines the side of 'P'"
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert [s.doubt for s in again.suspects] == [v.doubt]
    assert len(again.doubts) == 1
    again.remove("wrong")
    assert not again.suspects
    assert again.estimate("P") == pytest.approx(TRUE, abs=0.01)
    assert [d.partition(" ")[0] for d in again.doubts] == ["'right'"]  # it is alone now


def test_the_doubt_ends_once_another_reading_tells_the_side_and_begins_again_without_it():
    inc = other_side()
    names = list(TELLING)
    (v,) = inc.add(TELLING[names[0]]).verdicts
    assert v.doubt and inc.doubts
    (second,) = inc.add(replace(TELLING[names[1]], id="second")).verdicts
    assert second.verdict == "accepted" and not second.doubt
    assert not inc.doubts
    inc.remove("second")
    assert len(inc.doubts) == 1
    inc.remove(v.id)
    assert not inc.doubts


def test_two_readings_that_tell_the_side_together_are_in_no_doubt():
    inc = other_side()
    verdicts = inc.add(list(TELLING.values())).verdicts
    assert {(v.verdict, v.doubt) for v in verdicts} == {("accepted", "")}
    assert not inc.doubts


@pytest.mark.slow("150 simulated days: the size of the test on the other side, which one day hides")
def test_a_right_reading_on_the_other_side_fails_with_the_probability_alpha():
    alpha, days, failed, doubted = 0.1, 150, 0, 0
    for seed in range(days):
        network = near_the_plane(-10.0, np.inf)
        inc = fga.IncrementalAdjustment(network, alpha=alpha)
        inc.add(list(distances(seed).values()))
        if inc.suspects:
            continue
        noise = SIGMA * np.random.default_rng(1000 + seed).standard_normal()
        (v,) = inc.add(HeightDifference("A", "P", 12.0 + noise, sigma=SIGMA)).verdicts
        failed += v.verdict == "suspect"
        doubted += bool(v.doubt)
    assert doubted + failed > 0.85 * days
    assert failed / (doubted + failed) == pytest.approx(alpha, abs=3 * np.sqrt(0.09 / days))


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_a_suspect_that_does_not_bend_is_left_without_fronts_of_the_whole_network(engine):
    network = fga.Network("grid")
    for i, at in enumerate(((0.0, 0.0), (90.0, 0.0), (90.0, 80.0), (0.0, 80.0))):
        network.add_point(f"A{i}", (*at, 0.0), fixed="xyz")
    network.add_point("P", (40.0, 30.0, 0.0), fixed="z")
    place = np.array([40.0, 30.0, 0.0])
    inc = fga.IncrementalAdjustment(network, engine=engine)
    for i in range(4):
        true = float(np.linalg.norm(np.array(network.points[f"A{i}"].coordinates) - place))
        inc.add(SlopeDistance(f"A{i}", "P", true, sigma=0.002, id=f"s{i}"))
    (verdict,) = inc.add(SlopeDistance("A0", "P", 51.0, sigma=0.002, id="bad")).verdicts
    assert verdict.verdict == "suspect"
    assert "fronts" not in vars(inc._state.system)
