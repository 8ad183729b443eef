"""Photos that move while a rolling shutter reads them: times of rows, partials, poses of rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.graph.equations import compile_network
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


@pytest.mark.parametrize("powers", [2, 3])
@pytest.mark.parametrize("lens", ["line", "cylindrical", "brown", "fisheye"])
def test_partials_of_higher_powers_of_time_are_right(lens: str, powers: int) -> None:
    equations, steps = every_kind.moving_image_equations(lens, "down", powers)
    state = equations.unknowns.start()
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)
    lines, steps = every_kind.moving_line_equations("down", powers)
    state = lines.unknowns.start()
    assert_partials_are_right(observed_as_computed(lines, state), state, steps)


@pytest.mark.parametrize("towards", ["down", "right"])
def test_partials_of_lines_in_images_are_right(towards: Towards) -> None:
    equations, steps = every_kind.moving_line_equations(towards)
    state = equations.unknowns.start()
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)


def test_points_of_lines_are_seen_from_the_pose_at_the_time_of_their_row() -> None:
    """A line that many rows cross: its points are off the line of a photo that stands still."""
    equations, _ = every_kind.moving_line_equations("down")
    network = equations.network
    pose, motion = network.photos["f"], network.of_kind("photo_motion")["f"].values
    rows = [b for b in equations.blocks if b.kind == "image_line"]
    found = np.concatenate(
        [b.evaluate(network.frame, equations.unknowns.start()).residual for b in rows]
    )
    expected = []
    for line in (o for o in network.observations.values() if o.kind == "image_line"):
        t = -every_kind.READOUT * line.y / 24.0  # type: ignore[attr-defined]
        moved = network.copy()
        moved.parameters.pop("photo_motion")
        moved.photos["f"] = replace(
            pose,
            position=tuple(np.array(pose.position) + t * np.array(motion[:3])),
            rotation=pose.rotation @ exp_rotation(t * np.array(motion[3:])),
        )
        there = compile_network(moved)
        blocks = [b for b in there.blocks if b.kind == "image_line"]
        residuals = [b.evaluate(moved.frame, there.unknowns.start()).residual for b in blocks]
        expected.append(np.concatenate(residuals)[len(expected)])
    np.testing.assert_allclose(found, expected, atol=1e-10)
    still = network.copy()
    still.parameters.pop("photo_motion")
    there = compile_network(still)
    blocks = [b for b in there.blocks if b.kind == "image_line"]
    without = np.concatenate(
        [b.evaluate(still.frame, there.unknowns.start()).residual for b in blocks]
    )
    assert np.abs(found - without).max() > 0.01


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
