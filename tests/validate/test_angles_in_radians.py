"""An angle that a program gives in gon or degrees: the finding says that radians are expected."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga


def findings(value: float, source: str | None = None) -> str:
    """Return the findings about one direction."""
    network = fga.Network("n")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (10.0, 0.0, 0.0))
    network.add(fga.Direction("A", "B", value, sigma=1e-3 * fga.GON, source=source))
    return "\n".join(str(f) for f in fga.preliminary(network))


@pytest.mark.parametrize(
    ("value", "typed", "meant"),
    [
        (100, "100", "it looks like gon or degrees: multiply it by fga.GON, or use math.radians"),
        (-90.5, "-90.5", "it looks like gon or degrees: multiply it by fga.GON"),
        (399.1234, "399.1234", "it looks like gon: multiply it by fga.GON, or look for"),
        (500, "500", "convert it (gon: multiply by fga.GON; degrees: math.radians)"),
    ],
)
def test_value_as_typed(value, typed, meant):
    found = findings(value)
    assert f"an angle in radians is expected; {typed} is more than the full circle" in found
    assert meant in found
    assert "state the unit" not in found


def test_file_has_its_unit():
    found = findings(500 * fga.GON, "observations.csv:2")
    assert "500.0000 gon is more than the full circle of 400 gon" in found
    assert "state the unit in which it was read" in found


@pytest.mark.parametrize("value", [100 * fga.GON, math.radians(90.0), 2 * math.pi])
def test_radians_are_fine(value):
    assert "full circle" not in findings(value)
