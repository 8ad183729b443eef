"""Weak configurations of photo flights, FRAMES 3: refused, or told with the names of unknowns.

What nothing determines is an error that names it. What is nearly undetermined has an answer with
large standard deviations; `significance` names what cannot be told apart.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.small_flight import (
    EVERY,
    OFFSETS,
    RATE,
    SHIFT,
    TURNS,
    Plan,
    errors,
    observed,
    plan_of,
)

Pair = frozenset[tuple[str, str, str]]


def flown(plan: Plan) -> fga.Solution:
    return fga.adjust(observed(plan_of(plan), 1))


def pairs(solution: fga.Solution) -> dict[Pair, float]:
    """Return the inseparable pairs of parameters with their correlations."""
    found = fga.significance(solution, ties=False).correlations
    return {frozenset((c.a, c.b)): c.value for c in found}


@pytest.mark.parametrize("drift", [SHIFT, (*SHIFT, *RATE)])
@pytest.mark.parametrize("attitudes", [True, False])
def test_a_shift_of_every_strip_without_control_is_refused(drift, attitudes) -> None:
    plan = Plan(control=0, drift=drift)
    if not attitudes:
        plan = Plan(control=0, drift=drift, attitudes=None)
    with pytest.raises(fga.DatumError) as caught:
        flown(plan)
    text = str(caught.value)
    assert caught.value.defect == 3
    assert "missing shift in x, shift in y, shift in z" in text
    assert "do not hold it: free shift of drift 'strip 0', drift 'strip 1'" in text
    assert "give control" in text


def test_one_control_point_determines_shifts_but_hardly_drifts() -> None:
    shifted = flown(Plan(control=1, drift=SHIFT))
    assert shifted.unknown("drift", "strip 0").sigmas[:3].max() < 0.3
    plan = Plan(control=1, drift=(*SHIFT, *RATE), attitudes=None)
    drifting = flown(plan)
    assert drifting.unknown("drift", "strip 0").sigmas[3:6].min() > 1.0
    for rate in RATE:
        both = frozenset((("drift", "strip 0", rate), ("drift", "strip 1", rate)))
        assert pairs(drifting)[both] < -0.99  # the strips run in opposite directions
    held = flown(Plan(control=8, drift=(*SHIFT, *RATE), attitudes=None, crossing=2))
    assert held.unknown("drift", "strip 0").sigmas[3:6].max() < 0.06


def test_an_arm_and_a_shift_of_every_strip_that_all_run_one_way() -> None:
    one_way = flown(Plan(mount=OFFSETS, drift=SHIFT, to_and_fro=False))
    sigmas = one_way.unknown("mount", "imu").sigmas[3:]
    assert sigmas.min() > 0.5
    found = pairs(one_way)
    # The strips fly along x: x of the camera, to its right, is −y of the frame.
    for arm, shift in (("x", "y"), ("z", "z")):
        assert frozenset((("mount", "imu", arm), ("drift", "strip 0", shift))) in found
    # Strips to and fro that share a shift determine the horizontal arm, but not the vertical one.
    shared = flown(Plan(mount=OFFSETS, drift=SHIFT, one_drift=True))
    horizontal = shared.unknown("mount", "imu").sigmas[3:5]
    assert horizontal.max() < 0.06
    both = frozenset((("mount", "imu", "z"), ("drift", "strip 0", "z")))
    assert abs(pairs(shared)[both]) > 0.99


def test_vertical_arm_principal_distance_and_shift_in_height() -> None:
    two = Plan(drift=("z",), one_drift=True, calibration=("c",))
    both = frozenset((("calibration", "camera", "c"), ("drift", "strip 0", "z")))
    assert pairs(flown(two))[both] < -0.95
    three = flown(Plan(mount=("z",), drift=("z",), one_drift=True, calibration=("c",)))
    assert not pairs(three)  # no two of the three
    sentences = fga.significance(three, ties=False).overparametrised
    assert len(sentences) == 1
    assert "z of drift 'strip 0' is explained to 99." in sentences[0]
    assert "z of mount 'imu', c of camera 'camera' together" in sentences[0]
    shown = fga.text_report(three)
    assert "z of mount 'imu', c of camera 'camera' together" in " ".join(shown.split())


def test_boresight_in_heading_and_drift_of_headings() -> None:
    solution = flown(Plan(mount=TURNS, turning=("rz",)))
    found = pairs(solution)
    for strip in ("strip 0", "strip 1"):
        both = frozenset((("mount", "imu", "rz"), ("attitude_drift", strip, "rz")))
        assert found[both] > 0.99
    # Only the tilts of the boresight are determined if everything else turns too.
    sigmas = flown(Plan(mount=TURNS, turning=("rz",))).unknown("mount", "imu").sigmas
    assert sigmas[2] > 5 * sigmas[:2].max()


def test_boresight_and_principal_point_of_a_narrow_camera() -> None:
    """Both turn with the camera: strips to and fro do not tell them apart, a wide image does."""
    narrow = {"relief": 1.0, "half_format": 30.0, "points": 12, "exposures": 6}
    for to_and_fro in (False, True):
        plan = Plan(mount=TURNS, calibration=("x0", "y0"), to_and_fro=to_and_fro, **narrow)
        found = pairs(flown(plan))
        for turn, shift in (("ry", "x0"), ("rx", "y0")):
            both = frozenset((("mount", "imu", turn), ("calibration", "camera", shift)))
            assert abs(found[both]) > 0.99
    assert not pairs(flown(Plan(mount=TURNS, calibration=("x0", "y0"))))


def test_a_mount_that_nothing_observes_is_named() -> None:
    with pytest.raises(fga.DatumError, match="mount 'imu' is not determined") as caught:
        flown(Plan(mount=EVERY, attitudes=None))
    assert ("mount", "imu") in caught.value.unknowns


@pytest.mark.parametrize("seed", [1, 2])
def test_true_values_come_back(seed: int) -> None:
    plan = plan_of(Plan(mount=EVERY, drift=RATE, turning=("rx_t", "ry_t", "rz_t"), shutter=True))
    found = np.array(list(errors(fga.adjust(observed(plan, seed)), plan).values()))
    assert len(found) == 6 + 6 + 6 + 1
    assert np.abs(found).max() < 3.5
    assert np.sqrt(np.mean(found**2)) < 1.5
