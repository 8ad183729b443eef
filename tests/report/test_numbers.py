"""Printed numbers: orientations lie in the first turn, and no zero has a sign."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.models.base import within
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Direction, SlopeDistance
from factorgraph_adj.report.observation_rows import all_digits, observation_scale
from factorgraph_adj.report.options import ReportOptions
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.report.text import text_report
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.units import CC, TURN
from tests.networks import site
from tests.networks.small_block import small_block
from tests.support.printed import row, section

SIGNED_ZERO = re.compile(r"(?<![\w.\-])-0(?:\.0*)?(?:e[+-]?\d+)?(?![\w.\-])")
"""A zero with a minus; not the start of an identifier, a date or degrees-minutes-seconds."""
POINTS = {
    "A": (0.0, 0.0, 0.0),
    "B": (100.0, 0.0, 0.0),
    "C": (0.0, 100.0, 0.0),
    "D": (-90.0, -80.0, 0.0),
}
TURNED = -0.25
"""Orientation of the sets, radians: 384.08 gon."""


def turned(orientation: float) -> Network:
    """Return directions from two stations, of sets with an orientation."""
    network = Network("turned")
    for name, at in POINTS.items():
        network.add_point(name, at, fixed="xyz" if name in "AB" else "z")
    for station in "AB":
        for target in POINTS:
            if target != station:
                network.add(
                    Direction(station, target, 0.0, sigma=3 * CC),
                    SlopeDistance(station, target, 1.0, sigma=0.001),
                )
        network.set_orientation(station, value=orientation)
    out = measure(network, seed=5)
    for station in "AB":
        out.set_orientation(station, value=orientation)
    return out


@cache
def solution() -> Solution:
    found = adjust(turned(TURNED))
    assert found.state["orientation"].max() < 0, "the iteration stays where it starts"
    return found


def test_orientations_lie_in_the_first_turn_wherever_they_are_printed(tmp_path):
    text = text_report(solution())
    expected = (TURNED + TURN) / CC / 1e4
    for words in section(text, "Orientation unknowns")[2:]:
        assert float(words[2]) == pytest.approx(expected, abs=0.01)
    write_solution(solution(), tmp_path)
    for record in csv.DictReader(io.StringIO((tmp_path / "unknowns.csv").read_text())):
        assert float(record["value"]) == pytest.approx(TURNED + TURN, abs=1e-4)
    for found in json.loads((tmp_path / "results.json").read_text())["orientations"]:
        assert found["value"] == pytest.approx(TURNED + TURN, abs=1e-4)


def test_orientations_lie_in_the_first_turn_in_python():
    s = solution()
    assert s.orientation("A").values[0] == pytest.approx(TURNED + TURN, abs=1e-4)
    table = s.unknown_table()
    of_sets = table["value"][table["kind"] == "orientation"]
    assert of_sets.tolist() == [s.orientation(n).values[0] for n in "AB"]
    given = s.as_network()
    assert given.orientations["A", "1"].values[0] == s.orientation("A").values[0]
    again = adjust(given)
    assert again.vtpv == pytest.approx(s.vtpv, rel=1e-9)
    assert again.orientation("B").values[0] == pytest.approx(s.orientation("B").values[0], abs=1e-9)


@pytest.mark.parametrize("angle", [-1e-17, -0.0, 0.0, TURN, -TURN, 3 * TURN])
def test_a_whole_turn_is_none(angle):
    wrapped = within(np.array([angle]))[0]
    assert 0.0 <= wrapped < TURN
    assert wrapped == 0.0


def test_an_orientation_of_almost_a_turn_is_printed_as_zero():
    s = adjust(turned(0.0))
    text = text_report(s, ReportOptions(Units(angle="gon")))
    for name in "AB":
        assert 0.0 <= float(row(text, "Orientation unknowns", name)[2]) < 400.0


@pytest.mark.parametrize(
    "make", [lambda: measure(site.plan(), seed=1), small_block, lambda: turned(0.0)]
)
def test_no_zero_has_a_sign(make, tmp_path):
    network = make()
    network.cameras = {
        n: replace(c, y_down_in_files=True) for n, c in network.cameras.items()
    }  # fmt: skip
    write_solution(adjust(network), tmp_path, ReportOptions(confidence=0.95))
    for file in tmp_path.iterdir():
        text = file.read_text()
        found = SIGNED_ZERO.search(text)
        assert found is None, f"{file.name}: {text[max(0, found.start() - 60) : found.end() + 20]}"


def test_the_search_for_signed_zeros_finds_them():
    for text in ("-0", "x,-0.000,y", " -0.0 ", "[-0.0]", "-0e+00"):
        assert SIGNED_ZERO.search(text), text
    for text in ("-0.001", "7-0-3", "S-0", "1e-05", "-0-00-01.5", "a-0.0"):
        assert not SIGNED_ZERO.search(text), text


def test_observed_values_are_in_the_unit_that_stands_beside_them():
    """A distance in a project of millimetres was written in metres, with mm beside it."""
    millimetres = observation_scale("m", Units(length="mm"))
    assert (millimetres.whole().exact(9.4948), millimetres.whole().shown(9.4948, 1)) == (
        "9494.8",
        "9494.8",
    )
    assert all_digits(-0.0, "m") == "0"
