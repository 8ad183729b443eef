"""What is headlined as the most probable cause: what it leaves, and sizes that people make."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import GnssPosition, GnssVector
from factorgraph_adj.observations.registry import TOTAL_STATION_QUANTITIES
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.misfit_causes import most_probable_cause
from tests.benchmarks.causes import adjusted
from tests.networks.building_site import site

LONG = pytest.mark.slow(
    "vectors with exchanged axes in whole networks; short tests print single headlines"
)


def spoiled(seed: int, heights: dict[str, float]) -> fga.Network:
    """Return a building site whose recorded heights of instruments are multiplied by a factor."""
    network, readings, _ = site(seed)
    out = adjusted(network, readings)
    for ident, o in out.observations.items():
        if o.record.quantity in TOTAL_STATION_QUANTITIES and o.station in heights:  # type: ignore[attr-defined]
            height = o.instrument_height * heights[o.station]  # type: ignore[attr-defined]
            out.observations[ident] = replace(o, instrument_height=height)  # type: ignore[call-arg]
    return out


@pytest.mark.parametrize("seed", [1, 3])
def test_one_error_is_the_likeliest_cause_and_several_are_told_apart(seed: int) -> None:
    """σ̂0 with the cause as an unknown is that of an adjustment with the height put right."""
    single = fga.adjust(spoiled(seed, {"S1": 1.05}))
    found = fga.causes(fga.reliability(single))
    first = found.most_probable
    assert first is not None
    assert found.alone(first)
    left, r = found.left(first)
    assert np.sqrt(left / r) == pytest.approx(fga.adjust(spoiled(seed, {})).sigma0, rel=0.05)
    assert most_probable_cause(Report(single)).startswith(
        "most probable cause: the height of the instrument"
    )
    several = fga.adjust(spoiled(seed, {"S1": 1.05, "S2": 0.95, "S4": 1.06}))
    text = most_probable_cause(Report(several))
    assert text.startswith("one of several errors: the height of the instrument")
    assert " % of what vᵀPv is too large by" in text


@pytest.mark.parametrize(
    ("factor", "unit"), [(100.0, "centimetres"), (1000.0, "millimetres"), (3.28084, "feet")]
)
def test_a_height_in_another_unit_is_named_with_it(factor: float, unit: str) -> None:
    """No instrument stands so high, so that an error of that size is plausible."""
    found = fga.causes(fga.reliability(fga.adjust(spoiled(2, {"S3": factor}))))
    places = ("instrument at 'S3'", "'S3' (")
    named = [c for c in found.more_probable if any(p in c.where for p in places)]
    assert named
    assert named[0].other_unit
    assert f"m if it was recorded in {unit}" in str(named[0])


@LONG
@pytest.mark.parametrize("seed", [1, 2, 5])
def test_x_and_y_of_a_vector_and_of_a_position_are_found_exchanged(seed: int) -> None:
    for kind in (GnssVector, GnssPosition):
        network, readings, true = site(seed)
        out = adjusted(network, readings)
        for name in ("T4", "T5", "T6"):
            out.add(GnssPosition(name, tuple(true[name].tolist()), sigma=(0.005, 0.005, 0.01)))
        wrong: Any = next(o for o in out.observations.values() if type(o) is kind)
        x, y, z = wrong.value
        out.observations[wrong.id] = replace(wrong, value=(y, x, z))
        found = fga.snoop(out).causes
        assert found is not None
        assert found.most_probable is not None
        assert found.most_probable.cause == "x and y, exchanged,"
        assert found.most_probable.ids == (wrong.id,)
