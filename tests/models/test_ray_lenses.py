"""Lens models of rays: at 90° to the axis and behind, their limits, and their inverse."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.models.base import DegenerateError
from factorgraph_adj.models.image import image_line
from factorgraph_adj.models.inverse_lens import directions, tangents
from factorgraph_adj.models.lens import NoDistortion, NormalisedLens
from factorgraph_adj.models.normalised_lens import RationalLens
from factorgraph_adj.models.ray_lens import EquirectangularLens, FovLens, RayLens, UnifiedLens
from factorgraph_adj.types import Array
from tests.networks.every_kind import LENSES_USED

PANORAMAS = ("equirectangular", "cylindrical")
"""Models that have images of rays behind the camera, and none of its vertical axis."""
RAY_LENSES = [n for n, used in LENSES_USED.items() if isinstance(used.lens, RayLens)]
WIDEST = {"eucm": 105.0, "fov, narrow": 80.0}
"""Angle to the axis, degrees, up to which a model of this table has images; others: 170."""


def rays(name: str, n: int = 60) -> Array:
    """Return rays (n, 3) of all lengths up to the widest angle of a model, one at 90° if it can."""
    rng = np.random.default_rng(4)
    angle = np.radians(rng.uniform(0.0, WIDEST.get(name, 170.0), n))
    angle[-1] = np.radians(min(90.0, WIDEST.get(name, 170.0)))
    turn = rng.uniform(0.0, 2 * np.pi, n)
    d = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], 1)
    return d * rng.uniform(0.1, 100.0, (n, 1))


def calibration(name: str) -> Array:
    used = LENSES_USED[name]
    return np.array([[used.values.get(n, 0.0) for n in used.lens.names]])


@pytest.mark.parametrize("name", RAY_LENSES)
def test_partials_of_rays_up_to_nearly_backwards_are_right(name: str) -> None:
    lens, k, p = LENSES_USED[name].lens, calibration(name), rays(name)
    zero = np.zeros(len(p))

    def image(at: Array, values: Array) -> Array:
        v = lens.seen((at[:, 0], at[:, 1], at[:, 2]), zero, zero, values, jacobians=False).v
        return np.stack(v, axis=1)

    found = lens.seen((p[:, 0], p[:, 1], p[:, 2]), zero, zero, k)
    np.testing.assert_array_equal(np.stack(found.v, 1), image(p, k))
    length = np.linalg.norm(p, axis=1)
    for j, pair in enumerate(found.by_p):
        step = np.zeros((1, 3))
        step[0, j] = 1e-6
        step = step * length[:, None]
        slope = (image(p + step, k) - image(p - step, k)) / (2e-6 * length[:, None])
        largest = np.abs(slope * length[:, None]).max() / length
        np.testing.assert_array_less(np.abs(np.stack(pair, 1) - slope).max(axis=1), 1e-6 * largest)
    for j, pair in enumerate(found.by_k):
        step = np.zeros_like(k)
        step[0, j] = 1e-6
        slope = (image(p, k + step) - image(p, k - step)) / 2e-6
        by = np.stack(np.broadcast_arrays(*pair, zero)[:2], 1)
        np.testing.assert_allclose(by, slope, atol=2e-7 * max(np.abs(slope).max(), 1.0))


@pytest.mark.parametrize("name", RAY_LENSES)
def test_image_does_not_depend_on_the_length_of_a_ray(name: str) -> None:
    lens, k, p = LENSES_USED[name].lens, calibration(name), rays(name)
    zero = np.zeros(len(p))
    v = np.array(lens.seen(tuple(p.T), zero, zero, k, jacobians=False).v)
    long = np.array(lens.seen(tuple(1e6 * p.T), zero, zero, k, jacobians=False).v)
    np.testing.assert_allclose(long, v, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", RAY_LENSES)
def test_rays_come_back_from_their_images(name: str) -> None:
    """The fisheye of the table folds at about 150°; its rays end before."""
    lens, k, p = LENSES_USED[name].lens, calibration(name), rays(name)
    if name == "fisheye":
        p = p[np.degrees(np.arccos(p[:, 2] / np.linalg.norm(p, axis=1))) < 130.0]
    zero = np.zeros(len(p))
    xy = np.stack(lens.seen(tuple(p.T), zero, zero, k, jacobians=False).v, axis=1)
    found = directions(lens, xy, k)
    unit = p / np.linalg.norm(p, axis=1, keepdims=True)
    np.testing.assert_allclose(found, unit, atol=2e-9)


@pytest.mark.parametrize(
    "lens, values",
    [(FovLens(), {"w": 0.0}), (FovLens(), {"w": 1e-4}), (UnifiedLens(), {"beta": 1.0})],
)
def test_limits_of_ray_models_are_the_pinhole(lens: RayLens, values: dict[str, float]) -> None:
    p = rays("", 40)
    p[:, 2] = np.abs(p[:, 2]) + 0.2 * np.linalg.norm(p, axis=1)
    zero = np.zeros(len(p))
    k = np.array([[({"c": 24.0, "x0": 0.3} | values).get(n, 0.0) for n in lens.names]])
    ours = lens.seen(tuple(p.T), zero, zero, k, jacobians=False).v
    pinhole = NoDistortion().seen(tuple(p.T), zero, zero, k[:, :3], jacobians=False).v
    np.testing.assert_allclose(ours, pinhole, rtol=2e-7, atol=1e-9)


def test_rational_lens_without_its_denominator_is_the_normalised_lens() -> None:
    rng = np.random.default_rng(7)
    t, xy = rng.uniform(-0.8, 0.8, (2, 30)), rng.uniform(-9.0, 9.0, (30, 2))
    values = {"c": 24.0, "x0": 0.3, "y0": -0.2, "k1": -0.2, "k2": 0.05, "k3": 0.01, "p1": 1e-3}
    v = []
    for lens in (NormalisedLens(), RationalLens()):
        k = np.array([[values.get(n, 0.0) for n in lens.names]])
        v.append(lens.residual(*t, xy, k, jacobians=False)[0])
    np.testing.assert_allclose(v[0], v[1], atol=1e-13)


@pytest.mark.parametrize("name", [n for n in RAY_LENSES if n not in PANORAMAS])
def test_ray_exactly_backwards_is_refused(name: str) -> None:
    lens = LENSES_USED[name].lens
    p = np.array([[0.1, 0.1, 1.0], [0.0, 0.0, -2.0]])
    with pytest.raises(DegenerateError, match="no image") as error:
        lens.seen(tuple(p.T), np.zeros(2), np.zeros(2), calibration(name))
    assert error.value.rows.tolist() == [1]


def test_panorama_takes_the_shorter_way_round() -> None:
    lens, k = EquirectangularLens(), np.array([[100.0, 0.0, 0.0]])
    p = np.array([[-0.01, 0.0, -1.0]])  # just left of backwards: λ = −π + 0.01
    v = lens.seen(tuple(p.T), np.array([314.0]), np.array([0.0]), k, jacobians=False).v
    assert v[0][0] == pytest.approx(100 * (np.pi + np.arctan(0.01)) - 314.0, abs=1e-9)


def test_line_in_a_wide_image_is_measured_by_its_angle() -> None:
    """A point of the line at 100° to the axis has v = 0, and one off by an angle c sin(angle)."""
    lens = LENSES_USED["fisheye"].lens
    k = np.zeros((1, len(lens.names)))
    k[0, 0] = 10.0
    pose = np.concatenate([np.eye(3).ravel(), np.zeros(3)])[None]
    stored = np.concatenate([np.eye(3).ravel(), [2.0, 0.0, 0.0], [0.0], np.zeros(4)])[None]
    angle = np.radians(100.0)
    off = np.radians(0.5)
    for turned, expected in ((0.0, 0.0), (off, 10.0 * np.sin(off) * np.sin(angle))):
        x, y = 10.0 * angle * np.cos(turned), -10.0 * angle * np.sin(turned)
        v = image_line(
            LocalFrame(),
            pose,
            k,
            stored,
            None,
            None,
            observed=np.zeros((1, 1)),
            x=np.array([x]),
            y=np.array([y]),
            lens=lens,
        ).residual
        assert abs(v[0, 0]) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("k1", [0.3, 0.6, 1.5])
def test_tangents_behind_a_strong_pincushion_distortion(k1: float) -> None:
    """Where the distortion stretches by more than 2, the steps t − v/c lead away from the ray."""
    lens = NormalisedLens()
    values = {"c": 1000.0, "x0": 12.0, "y0": -7.0, "k1": k1, "k2": 0.1, "p1": 1e-3, "p2": -2e-3}
    k = np.array([[values.get(n, 0.0) for n in lens.names]])
    t = np.array([[0.0, 0.0], [0.3, -0.2], [0.8, 0.5], [-1.2, 0.9]])
    xy = lens.residual(t[:, 0], t[:, 1], np.zeros_like(t), k, jacobians=False)[0]
    assert tangents(lens, xy, k) == pytest.approx(t, abs=1e-7)
    assert tangents(lens, xy, np.repeat(k, len(t), axis=0)) == pytest.approx(t, abs=1e-7)
