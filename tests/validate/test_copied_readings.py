"""Equal readings are doubted where independent ones would not be equal so often, and only there."""

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.observations.relations import CoordinateDifference
from factorgraph_adj.validate.repeated_readings import differing_repetitions


def network_of(readings, *, sigma=0.002, kind=fga.SlopeDistance):
    """Repeated readings of lines, one list for each line."""
    network = fga.Network("repeated")
    for line, values in enumerate(readings):
        for name, x in ((f"A{line}", 0.0), (f"B{line}", 50.0)):
            network.add_point(name, (x, float(line), 0.0), fixed="xyz")
        for value in values:
            network.add(kind(f"A{line}", f"B{line}", float(value), sigma=sigma))
    return network


def doubts(network):
    return [f for f in differing_repetitions(network) if "has the same names" in str(f)]


def lines(rng, scatter, *, n=100, times=2, step=1e-4):
    true = rng.uniform(20, 80, n)
    readings = true[:, None] + rng.normal(0, scatter, (n, times))
    return np.round(readings / step) * step


def test_a_copied_reading_is_doubted():
    assert len(doubts(network_of([[50.1233, 50.1233]]))) == 1


def test_copied_lines_are_doubted_once_with_their_number():
    rng = np.random.default_rng(1)
    readings = lines(rng, 0.002)
    readings[:30, 1] = readings[:30, 0]
    (found,) = doubts(network_of(readings))
    assert "29 more" in str(found) or "30 more" in str(found) or "31 more" in str(found)


@pytest.mark.parametrize("scatter", [3e-5, 6e-5, 1e-4])
def test_readings_that_repeat_within_their_resolution_are_not(scatter):
    rng = np.random.default_rng(2)
    readings = lines(rng, scatter)
    assert np.sum(readings[:, 0] == readings[:, 1]) > 10
    assert not doubts(network_of(readings))


def test_equal_readings_that_chance_makes_are_not():
    """400 lines of σ 2 mm read to 1 mm: 14 % are equal."""
    rng = np.random.default_rng(3)
    readings = lines(rng, 0.002, n=400, step=1e-3)
    assert np.sum(readings[:, 0] == readings[:, 1]) > 30
    assert not doubts(network_of(readings))


def test_false_alarms_are_as_rare_as_stated():
    rng = np.random.default_rng(4)
    alarms = sum(bool(doubts(network_of(lines(rng, 0.002, n=20, step=5e-4)))) for _ in range(100))
    assert alarms <= 6  # 5 % expected at most


@pytest.mark.parametrize(("times", "step"), [(3, 1e-4), (6, 2e-4), (8, 2e-4), (6, 5e-4)])
@pytest.mark.parametrize("stated", [1.0, 2.0])
def test_lines_that_are_read_many_times_have_more_pairs_that_may_be_equal(times, step, stated):
    rng = np.random.default_rng(8)
    alarms = sum(
        bool(
            doubts(
                network_of(lines(rng, 0.002, n=10, times=times, step=step), sigma=stated * 0.002)
            )
        )
        for _ in range(40)
    )
    assert alarms <= 4  # 5 % are 2


def test_angles_in_gon_have_the_resolution_of_gon():
    mgon = np.pi / 200e3
    rng = np.random.default_rng(5)
    readings = lines(rng, 0.3 * mgon, n=100, step=0.1 * mgon) % 1.5
    clean = network_of(np.round(readings / mgon, 1) * mgon, sigma=0.3 * mgon, kind=fga.ZenithAngle)
    assert not doubts(clean)


def test_a_fit_that_is_too_good_is_a_note_and_no_doubt(tmp_path, capsys):
    network, rng = fga.Network("good"), np.random.default_rng(6)
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (0, 0, 1), fixed="xy")
    for _ in range(40):
        network.add(fga.HeightDifference("A", "B", 1.0 + rng.normal(0, 1e-4), sigma=0.01))
    fga.write_project(network, tmp_path / "p" / "project.toml")
    assert main(["adjust", str(tmp_path / "p")]) == 0
    printed = capsys.readouterr()
    assert "the readings fit better than their σ say" in printed.err
    assert "the readings fit better than their σ say" in printed.out.replace("\n  ", " ")
    assert "DOUBTFUL" not in printed.out


@pytest.mark.parametrize("stated", [{"sigma": 0.002}, {"covariance": np.array([[4e-6]])}])
def test_a_copied_vector_of_one_component_is_doubted(stated):
    network = network_of([])
    for name, x in (("A", 0.0), ("B", 50.0)):
        network.add_point(name, (x, 0.0, 0.0), fixed="xyz")
    for _ in range(2):
        network.add(CoordinateDifference("A", "B", (50.0012,), axes="x", **stated))
    assert len(doubts(network)) == 1
