"""Mistakes that all readings of a staff, a set-up, long sights or a prism share."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.quality.causes.cause_search import Causes
from factorgraph_adj.quality.causes.readings import Readings
from factorgraph_adj.quality.causes.shared_errors import shared_error_columns
from tests.networks.mistaken import MISTAKES, levelling, long_sights

MORE = pytest.mark.slow("ten more seeds of each mistake; short tests take the first ten of each")
SEEDS = (range(10), pytest.param(range(10, 20), marks=MORE))


def causes_of(network: fga.Network) -> Causes:
    """Return the causes of misfits of a network."""
    return fga.causes(fga.reliability(fga.adjust(network)))


def named(found: Causes) -> tuple[str, ...]:
    """Return the most probable cause, or all errors between which nothing tells."""
    first = found.most_probable
    return found.undecided if first is None else (f"{first.cause} {first.where}",)


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("cause", MISTAKES)
def test_a_mistake_of_all_readings_is_named_with_its_size(cause: str, seeds: range) -> None:
    """Alone, or with what nothing tells from it; its size is right to 4 σ.

    One percent of it is left to the curvature of the model.
    """
    make, size, where = MISTAKES[cause]
    text, alone = f"{cause} {where}", 0
    for seed in seeds:
        found = causes_of(make(seed, size))
        assert text in named(found), seed
        alone += found.most_probable is not None
        mine = next(c for c in found.found if f"{c.cause} {c.where}" == text)
        assert abs(mine.error[0] - size) < 4.0 * mine.sigma[0] + 0.01 * size
    assert alone >= 9


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("cause", MISTAKES)
def test_without_the_mistake_nothing_is_named(cause: str, seeds: range) -> None:
    make, _, _ = MISTAKES[cause]
    for seed in seeds:
        assert not causes_of(make(seed, 0.0)).more_probable, seed


def test_height_differences_in_feet_are_a_scale_of_any_size() -> None:
    """Recorded 1 / 0.3048 times too large, by 228 %."""
    first = causes_of(levelling(3, 1.0 / 0.3048 - 1.0)).most_probable
    assert first is not None
    assert first.cause.startswith("the scale of levelled height differences")
    assert abs(first.error[0] - (1.0 / 0.3048 - 1.0)) < 4.0 * first.sigma[0]


def test_refraction_with_the_wrong_sign_has_twice_its_coefficient() -> None:
    first = causes_of(long_sights(2, -0.26)).most_probable
    assert first is not None
    assert first.cause == "the curvature of the Earth or refraction"
    assert abs(first.error[0] + 0.26) < 4.0 * first.sigma[0]


def test_the_curvature_of_the_earth_changes_readings_in_both_faces_and_vertical_angles() -> None:
    """C is what a reading is too large by with s = 1: ± h / 2R."""
    equations = fga.adjust(long_sights(0, 0.0)).equations
    readings = Readings.of(equations, equations.unknowns.start())
    every = (h for h in shared_error_columns(readings) if h.cause.startswith("the curvature"))
    (found,) = (h for h in every if h.where == ("everywhere",))
    for sign, name in ((1, "H0"), (-1, "H3"), (-1, "H4")):
        station = equations.unknowns["point"].number[name]
        at = np.isin(readings.quantity, ("zenith angle", "vertical angle"))
        r = readings.only(at & (readings.station == station))
        d = r.state["point"][r.target] - r.state["point"][r.station]
        expected = sign * np.hypot(d[:, 0], d[:, 1]) / (2 * equations.network.frame.radius)
        assert np.allclose(found.columns[r.row].toarray()[:, 0], expected, rtol=1e-12)


def levelled_loops(seed: int, held: int, relief: float) -> fga.Network:
    """Return clean lines between eight points; the first few are held."""
    rng, network = np.random.default_rng(seed), fga.Network("levels")
    heights = rng.uniform(-relief, relief, 8)
    for i, h in enumerate(heights):
        network.add_point(f"P{i}", (50.0 * i, 0.0, h), fixed="xyz" if i < held else "xy")
    for _ in range(2):
        for i in range(8):
            j = (i + 3) % 8
            rise = heights[j] - heights[i] + 0.0003 * rng.normal()
            network.add(fga.HeightDifference(f"P{i}", f"P{j}", rise, sigma=0.0003))
    return network


@pytest.mark.parametrize("estimated", [False, True])
@pytest.mark.parametrize(("held", "relief"), [(1, 0.02), (1, 5.0), (2, 0.01), (3, 0.002)])
def test_errors_of_readings_are_no_scale(held: int, relief: float, *, estimated: bool) -> None:
    """With one held height nothing tells a scale; errors of readings are not in its column."""
    for seed in range(5):
        rel = fga.reliability(fga.adjust(levelled_loops(seed, held, relief)))
        found = fga.causes(rel, estimated=estimated)
        assert not [c for c in found.more_probable if "levelled height" in c.cause], seed
        if held == 1:
            assert not [c for c in found.found if "levelled height" in c.cause], seed
