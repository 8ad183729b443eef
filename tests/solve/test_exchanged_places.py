"""Names that are exchanged in all readings: only approximate coordinates can tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.building_site import site

ENDS = ("station", "target")
FREE = [f"T{i}" for i in range(4, 12)]


def renamed(names: dict[str, str], near: float = 0.05) -> fga.Network:
    """Return a site whose readings have other names of targets; coordinates stay as given."""
    described, readings, true = site(5)
    rng = np.random.default_rng(2)
    for name in FREE:
        at = true[name] + rng.normal(0.0, near, 3)
        described.points[name] = replace(described.points[name], coordinates=tuple(at.tolist()))
    described.add(
        *(
            replace(
                o, **{a: names.get(getattr(o, a), getattr(o, a)) for a in ("station", "target")}
            )
            if hasattr(o, "target")
            else o
            for o in readings
        )
    )
    return described


@pytest.mark.parametrize("ring", [("T5", "T8"), ("T5", "T8", "T10")])
def test_points_at_one_anothers_given_coordinates_are_a_doubt(ring) -> None:
    names = dict(zip(ring, (*ring[1:], ring[0]), strict=True))
    solution = fga.adjust(renamed(names))
    assert solution.converged
    (told,) = solution.second_places
    assert all(repr(n) in told for n in ring)
    assert "exchanged in all readings" in told


@pytest.mark.parametrize("near", [0.05, 5.0])
def test_right_names_raise_none(near) -> None:
    assert fga.adjust(renamed({}, near)).second_places == ()


def test_approximate_coordinates_that_are_not_that_good_tell_nothing() -> None:
    solution = fga.adjust(renamed({"T5": "T8", "T8": "T5"}, near=20.0))
    assert solution.second_places == ()
