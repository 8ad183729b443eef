"""Blocks of models in plan and in height, against the simultaneous solution."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.triangulation.independent_models import FRAME_COMPONENTS
from factorgraph_adj.triangulation.plan_blocks import an_block, plan_height
from tests.loaders.tsaiyoung import read_strip
from tests.networks.strip import block_of_models, relatively_oriented
from tests.support.places import data_dir


def models(
    relief: float, *, tilt: float = 0.0, centres: bool = False, every: int = 2, seed: int = 1
) -> fga.Network:
    """Return four measured models of 1 km with uncorrelated coordinates.

    Args:
        relief: heights of points lie between ± this, metres.
        tilt: standard deviation of the tilts of the models, radians.
        centres: whether projection centres are points of the models.
        every: columns of points from one pair of control points to the next.
        seed: seed of the measurement.
    """
    network = fga.Network("models")
    rng = np.random.default_rng(5)
    for i in range(9):
        for j in range(4):
            held = i % every == 0 and j in (0, 3)
            at = (500.0 * i, 400.0 * j, float(rng.uniform(-1, 1)) * relief)
            network.add_point(f"{i}-{j}", at, fixed="xyz" if held else "")
    for i in range(5):
        if centres:
            network.add_point(f"C{i}", (1000.0 * i, 600.0, 1500.0 + float(rng.normal(0, 20))))
    for k in range(4):
        turn = [*rng.normal(0.0, tilt, 2), float(rng.normal(0.0, 0.1))]
        values = dict(zip(FRAME_COMPONENTS, (*turn, 0.0, 0.0, 0.0, 0.1 * k), strict=True))
        network.add_frame(
            f"M{k}", free=FRAME_COMPONENTS, values=values, origin=(1000.0 * k + 500, 600.0, 0.0)
        )
        for i in range(2 * k, 2 * k + 3):
            for j in range(4):
                sigma = (0.05, 0.05, 0.08)
                network.add(fga.FrameCoordinate(f"M{k}", f"{i}-{j}", (0, 0, 0), sigma=sigma))
        for i in (k, k + 1) if centres else ():
            network.add(fga.FrameCoordinate(f"M{k}", f"C{i}", (0, 0, 0), sigma=(0.2, 0.2, 0.1)))
    return measure(network, seed=seed)


def test_an_an_block_is_the_plan_of_seven_parameters_where_tilts_are_small() -> None:
    """On flat ground, with tilts of some seconds of arc: equal to a thousandth of σ."""
    network = models(0.0, tilt=2e-5)
    seven = fga.adjust(network, tolerance=1e-8)
    plan = fga.adjust(an_block(network), tolerance=1e-8)
    assert plan.n_unknowns == 4 * 4 + 2 * 26
    for name in network.points:
        sigma = seven.standard_deviations(name)[:2]
        off = np.abs(plan.point(name) - seven.point(name))[:2]
        assert np.all(off <= 1e-3 * sigma)
        np.testing.assert_allclose(plan.standard_deviations(name)[:2], sigma, rtol=1e-3)


def test_relief_and_tilts_part_them() -> None:
    """Models that were not levelled are no maps: three minutes of arc in 150 m of relief."""
    network = models(150.0, tilt=1e-3)
    bare = an_block(network)
    for f in bare.frames.values():
        assert f.fixed[:2] == (True, True)
    for name, f in [*bare.frames.items()]:
        bare.of_kind("frame")[name] = type(f)(
            (0.0, 0.0, *f.values[2:]), f.fixed, f.sigma, f.constants, f.origin
        )
    seven = fga.adjust(network)
    off = [
        (fga.adjust(bare).point(n) - seven.point(n))[:2] / seven.standard_deviations(n)[:2]
        for n in ("1-1", "3-2", "5-1")
    ]
    assert np.abs(off).max() > 0.3


def test_plan_and_height_in_turn_end_at_the_simultaneous_solution_on_flat_ground() -> None:
    found = plan_height(models(0.0, tilt=1e-4))
    assert found.equal
    assert "equals" in found.headline()


def test_in_relief_they_end_elsewhere() -> None:
    """They converge in four rounds, but not to the simultaneous solution: relief decides."""
    low, high = (plan_height(models(r, tilt=1e-4)) for r in (30.0, 300.0))
    for found in (low, high):
        assert found.steps[4:].max() < 1e-3
        assert not found.equal
    # 0.04 and 0.35 σ.
    assert 4 < high.differences[-1].max() / low.differences[-1].max() < 20


def test_with_projection_centres_they_end_elsewhere_even_on_flat_ground() -> None:
    """Plan discrepancies of the centres belong to plan and tilts together: 0.2 and 0.4 σ."""
    found = plan_height(models(0.0, tilt=1e-4, centres=True))
    assert found.steps[4:].max() < 1e-3
    assert 0.05 < found.differences[-1].max() < 1.0


def test_heights_of_models_without_projection_centres_need_control_at_every_joint() -> None:
    """Flat models hinge about the line that they share; their projection centres stiffen it."""
    hinge, stiff = models(0.0, every=4), models(0.0, every=4, centres=True)
    with pytest.raises(fga.DatumError, match=r"frame 'M.' is not determined .*: z"):
        fga.adjust(hinge)
    assert fga.adjust(stiff).converged
    assert fga.adjust(an_block(hinge)).converged


@pytest.mark.published
def test_the_real_strip_in_plan_and_height() -> None:
    strip = read_strip(data_dir("tsaiyoung_strip"))
    network = block_of_models(strip, tuple(relatively_oriented(p) for p in strip.pairs))
    # Projection centres are points here.
    found = plan_height(network)
    assert found.steps[-1].max() < found.steps[0].max()
    assert len(found.first_rows().header) == 5


def test_other_observations_are_refused() -> None:
    network = models(0.0)
    network.add(fga.SlopeDistance("0-0", "1-1", 500.0, sigma=0.1))
    with pytest.raises(fga.InputError, match=r"slope_distance 0-0 1-1.*coordinates in frames"):
        an_block(network)
