"""Stereo-radial pairs, triplets and larger units in plan against all directions at once."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.triangulation.plan_blocks import plan_station, radial_observations
from factorgraph_adj.triangulation.plan_units import radial_units
from tests.networks.strip_of_photos import FOCAL, HALF, SIGMA_IMAGE, strip_plan, units

TIGHT = 1e-8


def with_centres(plan: fga.Network) -> fga.Network:
    """Return the plan with the place below each photo, which its neighbours show."""
    photos = list(plan.photos.values())
    for k, below in enumerate(photos):
        x, y, _ = below.position
        plan.add_point(plan_station(below.name), (x, y, 20.0))
        for other in photos[max(k - 1, 0) : k + 2]:
            if other is not below:
                p = (np.array([x, y, 20.0]) - other.position) @ other.rotation
                xy = FOCAL * p[:2] / p[2] * [1.0, -1.0]
                assert np.abs(xy).max() < HALF
                plan.add_image_points(
                    other.name, [plan_station(below.name)], [xy], sigma=SIGMA_IMAGE
                )
    return plan


def free_points(network: fga.Network, plan: fga.Network) -> list[str]:
    return [n for n, p in network.points.items() if n in plan.points and not all(p.fixed)]


PAIRS = [(f"{i}", f"{i + 1}") for i in range(5)]
TRIPLETS = [(f"{i}", f"{i + 1}", f"{i + 2}") for i in range(4)]


@pytest.mark.parametrize(
    ("split", "centres"),
    [(PAIRS, True), (TRIPLETS, False), ([tuple("012345")], False)],
    ids=["pairs", "triplets", "six"],
)
def test_without_errors_units_have_the_plan_of_the_ground(split, centres: bool) -> None:
    plan = strip_plan(6, overlap=0.65)
    plan = with_centres(plan) if centres else plan
    network = radial_units(measure(plan, seed=0, noise=False), split)
    assert list(network.frames) == ["-".join(unit) for unit in split]
    solution = fga.adjust(network, tolerance=TIGHT)
    assert solution.vtpv < 1e-6
    for name in free_points(network, plan):
        np.testing.assert_allclose(
            solution.point(name)[:2], plan.points[name].coordinates[:2], atol=1e-3
        )


def test_units_without_a_common_photo_are_all_directions_at_once() -> None:
    """Every direction is in one unit: coordinates with covariance hold all that they say.

    At the truth σ agree; with errors, points below the line of flight are not linear.
    """
    split = units(6, 3)
    plan = strip_plan(6, overlap=0.8, whole=split)
    for noise in (False, True):
        read = measure(plan, seed=3, noise=noise)
        joint = fga.adjust(radial_observations(read), tolerance=TIGHT)
        block = fga.adjust(radial_units(read, split), tolerance=TIGHT)
        names = free_points(block.network, plan)
        assert len(names) > 30
        of_joint, of_block = (
            np.array([s.standard_deviations(n)[:2] for n in names]) for s in (joint, block)
        )
        if not noise:
            np.testing.assert_allclose(of_block, of_joint, rtol=1e-5)
            continue
        moved = np.array([block.point(n)[:2] - joint.point(n)[:2] for n in names])
        assert np.median(np.abs(moved) / of_joint) < 0.1


def test_the_images_of_radial_centres_are_directions_between_stations() -> None:
    plan = with_centres(strip_plan(3, overlap=0.65))
    network = radial_observations(measure(plan, seed=0, noise=False))
    between = {
        (o.station, o.target)
        for o in network.observations.values()
        if o.target.startswith("centre")
    }
    near = [(0, 1), (1, 0), (1, 2), (2, 1)]
    assert between == {(plan_station(f"{i}"), plan_station(f"{j}")) for i, j in near}
    solution = fga.adjust(network, tolerance=TIGHT)
    assert solution.vtpv < 1e-6
    without = fga.adjust(
        radial_observations(measure(strip_plan(3, overlap=0.65), seed=0, noise=False))
    )
    assert solution.redundancy == without.redundancy + len(near)


@pytest.mark.parametrize("seed", range(5))
def test_stated_standard_deviations_of_stereo_radial_pairs_hold(seed: int) -> None:
    """Pairs that share no photo: χ² of the points that two units join or control, 99.9 %."""
    split = [("0", "1"), ("2", "3")]
    plan = with_centres(strip_plan(4, overlap=0.75))
    solution = fga.adjust(radial_units(measure(plan, seed=seed), split), tolerance=TIGHT)
    low, high = 0.2, 2.5
    assert solution.redundancy > 10
    assert low < solution.vtpv / solution.redundancy < high


def test_a_pair_without_the_images_of_its_centres_is_refused() -> None:
    read = measure(strip_plan(3, overlap=0.65), seed=0)
    with pytest.raises(fga.InputError, match=r"unit '0-1'.*unknowns.*of 'centre 1' in photo '0'"):
        radial_units(read, [("0", "1")])
    with pytest.raises(fga.InputError, match="unknown photo 'x'"):
        radial_units(read, [("0", "x")])
    with pytest.raises(fga.InputError, match="different photos, two or more"):
        radial_units(read, [("0",)])
