"""Places of instruments in the frame of the network, and their precision."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.quality.derived_quantities import place_of_frame
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array
from tests.networks.three_frames import FRAMES, MIDDLE, three_frames

STEP = 1e-6
"""Step of central differences, radians and metres."""


@cache
def solution() -> fga.Solution:
    return fga.adjust(three_frames())


def zero_of(stored: Array) -> Array:
    """Return O + e^ℓ R c of a frame that is not level."""
    rotation, offset, ln_scale = stored[:9].reshape(3, 3), stored[9:12], stored[12]
    return np.asarray(MIDDLE + np.exp(ln_scale) * rotation @ offset)


@pytest.mark.parametrize("name", ["scan", "model"])
def test_the_place_of_a_frame_has_the_sigma_of_the_whole_frame(name: str) -> None:
    """Rotation, offset and scale with their covariance, by central differences."""
    s, kind = solution(), UNKNOWNS["frame"]
    stored = s.state["frame"][s.number("frame", name)]
    by = np.stack(
        [
            (
                zero_of(kind.retract(stored[None], STEP * e[None])[0])
                - zero_of(kind.retract(stored[None], -STEP * e[None])[0])
            )
            / (2 * STEP)
            for e in np.eye(7)
        ],
        axis=1,
    )
    expected = by @ s.variable_covariance(("frame", name)) @ by.T
    found = place_of_frame(s, name)
    np.testing.assert_allclose(found.values, zero_of(stored), atol=1e-12)
    np.testing.assert_allclose(found.sigmas, np.sqrt(np.diag(expected)), rtol=1e-6)
    turn, offset, scale = FRAMES[name]
    true = MIDDLE + scale * exp_rotation(np.array([turn]))[0] @ offset
    assert np.all(np.abs(found.values - true) < 4 * found.sigmas)


def test_a_station_on_a_point_has_the_place_and_sigma_of_the_point() -> None:
    s = solution()
    found = place_of_frame(s, "station")
    np.testing.assert_allclose(found.values, s.point("T"), atol=1e-12)
    np.testing.assert_allclose(found.sigmas, s.standard_deviations("T"), rtol=1e-6)


def test_report_and_table_state_the_places(tmp_path: Path) -> None:
    s = solution()
    text = fga.text_report(s)
    heading = next(line for line in text.splitlines() if line.split()[:2] == ["frame", "X"])
    lines = text[text.index(heading) :].splitlines()
    write_solution(s, tmp_path)
    with open(tmp_path / "unknowns.csv", encoding="utf-8") as file:
        rows = {(r["name"], r["component"]): r for r in csv.DictReader(file)}
    for name in FRAMES:
        e = place_of_frame(s, name)
        at = next(i for i, line in enumerate(lines) if line.startswith(f"  {name} "))
        shown = [float(v) for v in lines[at].split()[1:]]
        sigmas = [float(v) for v in lines[at + 1].split()[-3:]]
        assert shown == pytest.approx(e.values, abs=1e-4)
        assert sigmas == pytest.approx(1e3 * e.sigmas, rel=6e-3)
        for component, value, sigma in zip("XYZ", e.values, e.sigmas, strict=True):
            row = rows[name, component]
            assert float(row["value"]) == pytest.approx(value, abs=1e-12)
            assert float(row["sigma"]) == pytest.approx(sigma, rel=1e-8)
            assert (row["unit"], row["state"]) == ("m", "computed")


def test_an_unknown_frame_is_refused() -> None:
    with pytest.raises(fga.InputError, match="unknown frame 'scam'; known"):
        place_of_frame(solution(), "scam")
