"""A file that was read twice is doubted, in the batch and as it arrives; repeated sets are not."""

from __future__ import annotations

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.report.doubtful_results import doubts_of_network
from factorgraph_adj.service.stream import Stream
from factorgraph_adj.validate.repeated_readings import copied_blocks

LINES = 7


def network_with(readings, *, sigma=0.002):
    """Return lines of which the distances were read in the order of the rows of (line, value)."""
    network = fga.Network("lines")
    for line in range(LINES):
        network.add_point(f"A{line}", (0.0, float(line), 0.0), fixed="xyz")
        network.add_point(f"B{line}", (50.0, float(line), 0.0), fixed="yz")
    for line, value in readings:
        network.add(fga.SlopeDistance(f"A{line}", f"B{line}", float(value), sigma=sigma))
    return network


def one_round(rng, scatter=0.002, step=1e-4):
    return [(k, np.round((50 + rng.normal(0, scatter)) / step) * step) for k in range(LINES)]


def test_a_block_that_repeats_an_earlier_one_is_doubted_once_with_its_lines():
    first = one_round(np.random.default_rng(1))
    second = one_round(np.random.default_rng(2))
    (told,) = copied_blocks(network_with([*first, *second, *first]))
    assert told.startswith("7 readings in a row, slope_distance A0 B0 (id 15) to slope_distance A6")
    assert "repeat slope_distance A0 B0 (id 1) to slope_distance A6 B6 (id 7) in all digits" in told
    assert told in doubts_of_network(network_with([*first, *second, *first]))


@pytest.mark.parametrize("change", ["order", "four", "digit"])
def test_other_readings_are_not(change):
    first = one_round(np.random.default_rng(1))
    again = {
        "order": first[::-1],
        "four": first[:4],
        "digit": [(k, v + 1e-4 * (k % 3 == 0)) for k, v in first],
    }[change]
    assert not copied_blocks(network_with([*first, *again]))


def test_sets_that_repeat_within_the_rounding_of_the_display_are_not():
    """Readings to 1 mm with a scatter of 0.2 mm are nearly all equal."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        rounds = [r for _ in range(4) for r in one_round(rng, 2e-4, step=1e-3)]
        assert not copied_blocks(network_with(rounds))


def test_few_vectors_are_many_numbers():
    network = fga.Network("vectors")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    for name in "BC":
        network.add_point(name, (50.0, 10.0, 5.0))
    values = {"B": (50.0123, 10.0456, 5.0789), "C": (50.0321, 10.0654, 5.0987)}
    for name in "BCBC":
        network.add(fga.GnssVector("A", name, values[name], sigma=(0.005,) * 3))
    (told,) = copied_blocks(network)
    assert told.startswith("2 readings in a row")


@pytest.mark.parametrize("n", [LINES, 4])
def test_adjust_ends_with_doubt_and_says_so(n, tmp_path, capsys):
    first = one_round(np.random.default_rng(1))
    fga.write_project(network_with([*first, *first[:n]]), tmp_path / "project.toml")
    code = main(["adjust", str(tmp_path)])
    said = capsys.readouterr()
    copied = f"{n} readings in a row, observations.csv:9" in (said.out + said.err).replace("\n", "")
    assert copied is (n == LINES)
    assert code == int(copied)


def test_arrivals_that_repeat_a_block_are_doubted_until_they_leave(tmp_path):
    first = one_round(np.random.default_rng(1))
    network = network_with([])
    inc = fga.IncrementalAdjustment(network, journal=tmp_path / "day.jsonl")
    stream = Stream(inc)
    counts = []
    for line, value in [*first, *first]:
        record = {"kind": "slope_distance", "station": f"A{line}", "target": f"B{line}"}
        record |= {"value": value, "sigma_mm": 2}
        answer = stream.answer(json.dumps(record), 1)
        counts.append(answer["counts"]["doubts"])
    assert counts == [0] * 11 + [1] * 3
    (told,) = stream.answer('{"do": "doubts"}', 1)["doubts"]
    assert told.startswith("7 readings in a row, '8' to '14', repeat '1' to '7'")
    del inc, stream
    again = fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert again.doubts == (told,)
    again.remove([str(i) for i in range(8, 15)])
    assert not again.doubts
