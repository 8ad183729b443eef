"""The record of results tells every bit that changes."""

import gzip
import json

import numpy as np
import pytest

from tests.benchmarks.results_record import adjusted, compare, difference
from tests.networks.small import small


def written(path, network, change=0.0):
    found = adjusted("small 1", network)
    if change:
        found.values["points.x"][-1] = float(np.nextafter(found.values["points.x"][-1], change))
    with gzip.open(path, "wt", encoding="utf-8") as out:
        out.write(json.dumps(vars(found)) + "\n")
    return path


def test_results_of_the_same_code_are_equal_to_the_last_bit(tmp_path):
    one, other = (written(tmp_path / name, small(1)) for name in ("a.gz", "b.gz"))
    assert compare(one, other) == []


def test_one_bit_is_reported_with_its_quantity_and_network(tmp_path):
    one, other = written(tmp_path / "a.gz", small(1)), written(tmp_path / "b.gz", small(1), 1e9)
    (line,) = compare(one, other)
    assert line.startswith("points.x: 1 of 1 networks differ (small 1: ")


@pytest.mark.parametrize(
    ("a", "b", "apart"),
    [
        ([1.0, np.nan], [1.0, np.nan], 0.0),
        ([1.0, np.nan], [1.0, 2.0], np.inf),
        ([1.0], [1.0, 2.0], np.inf),
        ([4.0, 1.0], [4.0, 2.0], 0.25),
        ([], [], 0.0),
    ],
)
def test_differences_are_relative_to_the_largest_number(a, b, apart):
    assert difference(a, b) == apart
