"""Photos that move while a rolling shutter reads them: times of rows, partials, poses of rows."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.models.image import image
from factorgraph_adj.models.lens import BrownForwardLens, BrownLens
from factorgraph_adj.models.rolling_shutter import TOWARDS, Readout, Towards
from factorgraph_adj.rotation import (
    exp_rotation,
    log_rotation,
    right_jacobian,
    right_jacobian_inverse,
    world_R_camera,
)
from tests.networks import every_kind
from tests.networks.every_kind import LENSES_USED
from tests.support.differences import assert_partials_are_right, observed_as_computed
from tests.support.studies import cases

POSITION, ANGLES = np.array([3.0, -2.0, 40.0]), (0.1, -0.2, 0.7)
MOTION = np.array([12.0, -3.0, 1.5, 0.4, -0.6, 0.5])
READOUT = 0.03
TESTED = ["fisheye", "brown", "brown forward"]
"""Lens models of rays, from measured to ideal coordinates, and back."""


@pytest.mark.parametrize("towards", TOWARDS)
@pytest.mark.parametrize("lens", cases(LENSES_USED, TESTED))
def test_partials_are_right(lens: str, towards: Towards) -> None:
    equations, steps = every_kind.moving_image_equations(lens, towards)
    state = equations.unknowns.start()
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)


@pytest.mark.parametrize(
    ("towards", "first", "last"),
    [
        ("down", (0.0, 12.0), (0.0, -12.0)),
        ("up", (0.0, -12.0), (0.0, 12.0)),
        ("right", (-18.0, 0.0), (18.0, 0.0)),
        ("left", (18.0, 0.0), (-18.0, 0.0)),
    ],
)
@pytest.mark.parametrize("origin", ["centre", "upper left"])
def test_rows_are_read_within_half_the_readout_time_of_the_middle_row(
    towards: Towards, first: tuple[float, float], last: tuple[float, float], origin: str
) -> None:
    network = fga.Network()
    network.add_camera(
        "camera",
        BrownLens(),
        {"c": 30.0},
        format=(36.0, 24.0),
        origin=origin,  # type: ignore[arg-type]
        readout=READOUT,
        readout_towards=towards,
    )
    readout = network.cameras["camera"].times()
    assert readout is not None
    corner = np.array([18.0, -12.0]) if origin == "upper left" else np.zeros(2)
    x, y = (np.array([first, (0.0, 0.0), last]) + corner).T
    np.testing.assert_allclose(readout.times(x, y), [-0.015, 0.0, 0.015], atol=1e-17)


def test_image_points_are_those_of_the_pose_at_the_time_of_their_row() -> None:
    rotation = world_R_camera(*ANGLES)
    readout = Readout.of(READOUT, "down", np.array([-18.0, -12.0]), np.array([18.0, 12.0]))
    xy = np.array([[4.0, 11.0], [-9.0, 0.0], [13.0, -8.0]])
    times = READOUT * np.array([-11.0, 0.0, 8.0]) / 24.0
    points = POSITION + np.array([[5.0, 6.0, -40.0], [-9.0, 1.0, -38.0], [12.0, -8.0, -44.0]])
    calibration = np.array([[30.0, 0.1, -0.2]])
    lens = fga.models.lens.Lens()
    stored = np.concatenate([rotation.ravel(), POSITION])
    found = image(
        LocalFrame(),
        np.tile(stored, (3, 1)),
        calibration,
        points,
        np.tile(MOTION, (3, 1)),
        observed=xy,
        lens=lens,
        readout=readout,
    ).residual
    for i, t in enumerate(times.tolist()):
        turned = rotation @ exp_rotation(MOTION[3:] * t)
        pose = np.concatenate([turned.ravel(), POSITION + MOTION[:3] * t])[None]
        at_row = image(
            LocalFrame(), pose, calibration, points[i, None], observed=xy[i, None], lens=lens
        )
        np.testing.assert_allclose(found[i], at_row.residual[0], rtol=0, atol=1e-12)
    still = image(
        LocalFrame(), np.tile(stored, (3, 1)), calibration, points, observed=xy, lens=lens
    ).residual
    assert (np.abs(found - still).max(axis=1) > 0.1)[[0, 2]].all()
    np.testing.assert_allclose(found[1], still[1], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.9e-4, 1.1e-4, 0.5, 3.0])
def test_the_right_jacobian_is_that_of_the_exponential_map(angle: float) -> None:
    w = angle * np.array([[0.48, -0.6, 0.64]])
    np.testing.assert_allclose(
        right_jacobian(w) @ right_jacobian_inverse(w), np.eye(3)[None], atol=1e-12
    )
    step = 1e-6 * np.eye(3)
    back = np.swapaxes(exp_rotation(w), 1, 2)
    by = log_rotation(back @ exp_rotation(w + step)) - log_rotation(back @ exp_rotation(w - step))
    np.testing.assert_allclose(by.T / 2e-6, right_jacobian(w)[0], atol=1e-8)


def test_a_readout_is_a_time_of_a_sensor_of_known_size() -> None:
    network = fga.Network()
    lens, values = BrownForwardLens(), {"c": 30.0}
    with pytest.raises(fga.InputError, match="a readout time needs the format of the sensor"):
        network.add_camera("camera", lens, values, readout=READOUT)
    with pytest.raises(fga.InputError, match=r"a time greater than zero, seconds, not -0\.03"):
        network.add_camera("camera", lens, values, format=(36, 24), readout=-READOUT)
    with pytest.raises(fga.InputError, match="unknown side 'back' of readout_towards; valid: down"):
        network.add_camera(
            "camera",
            lens,
            values,
            format=(36, 24),
            readout=READOUT,
            readout_towards="back",  # type: ignore[arg-type]
        )
    with pytest.raises(fga.InputError, match="unknown photo 'F'"):
        network.set_unknown("photo_motion", "F")
