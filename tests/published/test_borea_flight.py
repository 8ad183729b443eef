"""The aerial block of IGN with GNSS and inertial observations: FRAMES 6.1.

Centres (σ 0.05 m) and attitudes (σ 0.004°) are the delivered ones with errors; arms, boresights,
shifts and drifts are put on. Images are measured, or simulated at the same places. Printed figures
are those of an independent computation with errors of its own, so that parameters agree to about a
standard deviation, and standard deviations to their printed digits.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.loaders.borea import Block, read_borea
from tests.networks.borea_flight import (
    ARM,
    BORESIGHT,
    OFFSETS,
    SHIFTED,
    TURNS,
    Flight,
    errors_of,
    flown,
    plan_of,
)
from tests.support.places import data_dir

pytestmark = [
    pytest.mark.published,
    pytest.mark.slow("a real flight with drifts of its positions; short tests take simulated ones"),
]

EVERY = (*TURNS, *OFFSETS)
SEED = 1
APART = 3.0
"""Difference of two estimates from other drawn errors, in standard deviations of one."""


@pytest.fixture(scope="module")
def block() -> Block:
    return read_borea(data_dir("borea"))


def adjusted(block: Block, flight: Flight, *, measured: bool = True) -> fga.Solution:
    plan = plan_of(block, flight)
    solution = fga.adjust(flown(plan, SEED, measured_images=measured))
    assert solution.converged
    return solution


def test_a_bundle_with_observed_orientation(block: Block) -> None:
    solution = adjusted(block, Flight())
    found = (solution.n_observations, solution.n_unknowns, solution.redundancy)
    assert found == (29268, 9429, 19839)
    # 414 of 29268 observations have drawn errors: they move σ̂0 by 0.0008.
    assert solution.sigma0 == pytest.approx(0.9159, abs=3 * 0.0008)


def test_an_arm_and_a_boresight_come_back(block: Block) -> None:
    mount = adjusted(block, Flight(mount=EVERY)).unknown("mount", "imu")
    np.testing.assert_allclose(mount.sigmas[3:], [0.009, 0.009, 0.034], rtol=0, atol=6e-4)
    sigmas = np.degrees(mount.sigmas[:3])
    np.testing.assert_allclose(sigmas, [0.0005, 0.0005, 0.0007], rtol=0, atol=6e-5)
    printed = np.array([*np.radians((0.1216, -0.0802, 0.2539)), 0.332, -0.270, 0.171])
    assert (np.abs(mount.values - printed) < APART * mount.sigmas).all()


def test_an_arm_and_a_boresight_with_eleven_control_points(block: Block) -> None:
    mount = adjusted(block, Flight(mount=EVERY, control=11)).unknown("mount", "imu")
    printed = np.array([*np.radians((0.1215, -0.0802, 0.2517)), 0.339, -0.264, 0.041])
    assert (np.abs(mount.values - printed) < APART * mount.sigmas).all()
    # Control fixes the height of the arm, and the measured images turn κ by several σ.
    assert abs(mount.values[5] - ARM[2]) < 2.5 * mount.sigmas[5]
    assert (np.abs(mount.values[:2] - BORESIGHT[:2]) < 4 * mount.sigmas[:2]).all()


def test_navigation_angles_give_the_same_as_those_of_the_frame(block: Block) -> None:
    """Over 20 km the horizon tilts by 0.003 rad, forty times the standard deviation."""
    found = adjusted(block, Flight(mount=EVERY, control=11, navigation=True))
    mount = found.unknown("mount", "imu")
    same = adjusted(block, Flight(mount=EVERY, control=11)).unknown("mount", "imu")
    assert found.sigma0 == pytest.approx(0.914, abs=3 * 0.0008)
    # Axes of the body differ: what is drawn for x and y is not the same.
    assert (np.abs(mount.values - same.values) < APART * np.sqrt(2) * mount.sigmas).all()


def test_shifts_and_drifts_of_five_strips_with_simulated_images(block: Block) -> None:
    plan = plan_of(block, Flight(control=11, drift=SHIFTED, sigma_image=0.15))
    errors = []
    for seed in range(1, 4):
        solution = fga.adjust(flown(plan, seed))
        # The square of σ̂0 scatters by √(2/r), and about the printed one by √2 more.
        assert solution.sigma0 == pytest.approx(0.9971, abs=3 / np.sqrt(solution.redundancy))
        found = errors_of(solution, plan, "drift")
        assert len(found) == 30
        errors.append(found)
    every = np.abs(np.concatenate(errors))
    assert np.mean(every < 2.5) >= 0.95
    assert every.max() < 4.0
    assert np.sqrt(np.mean(every**2)) == pytest.approx(1.0, abs=0.25)


def test_shifts_and_drifts_with_measured_images_differ_by_their_systematic_parts(
    block: Block,
) -> None:
    flight = Flight(control=11, drift=SHIFTED)
    solution = adjusted(block, flight)
    plan = plan_of(block, flight)
    errors = errors_of(solution, plan, "drift")
    assert 2.0 < np.abs(errors).max() < 7.0
    shift = np.array([solution.unknown("drift", n).values[:3] for n in plan.drifts])
    shift -= np.array([p.values[:3] for p in plan.drifts.values()])
    rms = np.sqrt(np.mean(shift**2, axis=0))
    # Printed: 0.042, 0.080 and 0.040 m.
    assert (rms < 0.1).all()
