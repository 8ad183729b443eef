"""Zenith angles of both faces with an unknown index error, forth and back."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError, Problem
from factorgraph_adj.observations import SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import measure

INDEX = 3e-4
"""Index error, radians."""


def sights(wrong: float, faces: tuple[int, ...] = (1, 2)) -> fga.Network:
    """Return sights from A to B and back, the height of the instrument at B wrong by metres."""
    network = fga.Network("forth and back")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (80.0, 0.0, 5.0), fixed="xyz")
    for a, b, rise, height in (("A", "B", 5.0, 1.5), ("B", "A", -5.0, 1.6)):
        up = rise + 0.2 - height
        zenith, length = np.arctan2(80.0, up), float(np.hypot(80.0, up))
        stated = height + (wrong if a == "B" else 0.0)
        how = {"instrument_height": stated, "target_height": 0.2}
        network.add(SlopeDistance(a, b, length, sigma=0.001, **how))
        network.set_unknown("index_error", a)
        for face in faces:
            read = zenith + INDEX if face == 1 else 2 * np.pi - zenith + INDEX
            network.add(ZenithAngle(a, b, read, sigma=1e-5, face=face, index_error=a, **how))
    return network


@pytest.mark.parametrize("wrong", [0.0, 0.1])
def test_the_index_error_cancels_and_a_wrong_height_is_found(wrong: float) -> None:
    found = [f for f in fga.preliminary(sights(wrong)) if "forth and back" in f.what]
    assert len(found) == (wrong > 0)
    if found:
        assert abs(found[0].size) == pytest.approx(100.0, abs=1.0)  # mm


def test_readings_in_one_face_may_have_any_index_error() -> None:
    assert not [f for f in fga.preliminary(sights(0.1, (1,))) if "forth and back" in f.what]


@pytest.mark.parametrize("curvature", [False, True])
def test_long_sights_forth_and_back_bend_as_the_network_says(curvature: bool) -> None:
    """Over 1 km, error-free readings with k = 0.13: 2 (1 − k) d²/2R is 136 mm."""
    network = fga.Network("long", frame=fga.LocalFrame(curvature))
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (1000.0, 0.0, 30.0), fixed="xy")
    network.set_refraction(value=0.13 if curvature else 0.13 - 1.0, fixed=True)
    for a, b in (("A", "B"), ("B", "A")):
        network.add(SlopeDistance(a, b, 1.0, sigma=0.002))
        network.add(ZenithAngle(a, b, 1.5, sigma=1e-6))
    read = measure(network, seed=1, noise=False)
    assert not [f for f in fga.preliminary(read) if "forth and back" in f.what]
    read.set_refraction(value=1.5, fixed=True)  # no sight bends so
    assert [f for f in fga.preliminary(read) if "forth and back" in f.what]


def test_a_long_list_stands_once_and_every_name_that_is_meant_stays() -> None:
    valid = ", ".join(f"kind_{i}" for i in range(20))
    rows = [
        Problem(f"unknown kind 'knd_{i}'; valid: {valid}; did you mean 'kind_{i}'?", f"a.csv:{i}")
        for i in (2, 3)
    ]
    first, second = InputError(rows).problems
    assert valid in first.what and "did you mean 'kind_2'?" in first.what
    assert second.what == "unknown kind 'knd_3'; valid: as above; did you mean 'kind_3'?"


def test_a_report_is_no_solution_and_says_so(tmp_path) -> None:
    report = tmp_path / "results.json"
    report.write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match=r"is a report; `Solution.save` writes the file"):
        fga.load_solution(report)


@pytest.mark.parametrize("given", [{"b": "x"}, ["x"]])
def test_what_is_no_factor_is_named(given) -> None:
    network = sights(0.0)
    with pytest.raises(InputError, match=r"NonlinearFactor.*not str"):
        fga.adjust(network, extra_factors=given)
