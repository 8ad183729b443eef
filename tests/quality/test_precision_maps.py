"""Precision maps against the adjustment itself, numerical partials and repeated adjustments."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.models.image import image
from factorgraph_adj.quality.precision_maps import neighbours
from factorgraph_adj.quality.visible_rays import Visibility
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.simulated_blocks import (
    SIGMA_IMAGE_MM,
    simulate_aerial_block,
)
from tests.benchmarks.precision_maps import ratios, repeated, simulated_cloud

REPETITIONS = 100
FALSE_ALARM = 1e-4
"""Probability of a bound of one figure; there are six of them, two-sided."""
FORMAT_MM = (37.0, 25.0)
"""Format of the camera: that of the simulation, and its distortion at the border."""


@cache
def network():
    """Return a small aerial block whose camera has its format."""
    out = simulate_aerial_block(1, image_points=900, points_per_photo=90).network
    (name,) = out.cameras
    out.cameras[name] = replace(out.cameras[name], format=FORMAT_MM)
    return out


@cache
def block():
    """Return the block, adjusted."""
    return fga.adjust(network())


@cache
def cloud():
    """Return points that two or more photos see."""
    x = simulated_cloud(block(), 300, 1)
    return x[fga.precision_map(block(), x).determined]


def measured(solution):
    """Return which photos measured which points, (points, photos)."""
    out = np.zeros((len(solution.network.points), len(solution.network.photos)), dtype=bool)
    photo, point, *_ = solution.network.images.columns()
    out[point, photo] = True
    return out


@pytest.mark.parametrize("variance", ["a-priori", "a-posteriori"])
def test_a_point_with_the_rays_of_a_tie_point_has_its_covariance(variance):
    s = fga.adjust(network(), variance=variance)
    tie = fga.precision_map(s)
    assert np.array_equal(tie.covariances, s.point_covariances)
    assert np.array_equal(tie.photos, measured(s).sum(axis=1))
    found = fga.precision_map(s, s.state["point"], visible=measured(s))
    control = {o.point for o in s.network.observations.values() if isinstance(o, fga.ControlPoint)}
    same = np.array([n not in control for n in s.network.points]) & (found.photos == tie.photos)
    assert len(control) == 4 and same.sum() == len(same) - 4
    scale = np.abs(tie.covariances[same]).max(axis=(1, 2), keepdims=True)
    assert np.abs((found.covariances - tie.covariances)[same] / scale).max() < 1e-7


def test_the_same_holds_in_a_free_network_and_on_other_datum_points():
    """Points of the datum are left out: their own rays have moved the photos with them."""
    plan = network().copy()
    plan.observations = {}
    names = list(plan.points)
    for name in names[::3]:
        plan.points[name] = replace(plan.points[name], datum=True)
    for name, camera in plan.cameras.items():
        plan.cameras[name] = replace(camera, fixed=(True,) * len(camera.fixed))
    free = fga.adjust(plan, datum="free")
    assert free.datum is not None
    moved = fga.s_transform(block(), names[::3])
    assert moved.reference is not None
    for s in (free, moved):
        tie = fga.precision_map(s)
        found = fga.precision_map(s, s.state["point"], visible=measured(s))
        control = {
            o.point for o in s.network.observations.values() if isinstance(o, fga.ControlPoint)
        }
        others = np.array([n not in control for n in names]) & (found.photos == tie.photos)
        others[::3] = False
        assert others.sum() > 0.6 * len(names)
        scale = np.abs(tie.covariances[others]).max(axis=(1, 2), keepdims=True)
        assert np.abs((found.covariances - tie.covariances)[others] / scale).max() < 1e-6


def test_the_part_of_the_block_is_that_of_numerical_partials():
    """Each unknown of photos and camera is moved by itself, and the point intersected again."""
    s = block()
    x = cloud()[:1]
    rays = Visibility(s).rays(x)
    lens = next(iter(s.network.cameras.values())).lens
    pose = s.state["pose"][rays.photo]
    k = s.state["calibration"][rays.calibration]

    def partials(pose, k, at, xy):
        points = np.repeat(at, len(xy), axis=0)
        return image(s.network.frame, pose, k, points, observed=xy, lens=lens)

    def intersected(pose, k, xy):
        at = x.copy()
        for _ in range(6):
            found = partials(pose, k, at, xy)
            b = found.jacobians[2].reshape(-1, 3)
            at = at - np.linalg.lstsq(b, found.residual.ravel(), rcond=None)[0]
        return at[0]

    xy = partials(pose, k, x, np.zeros((len(pose), 2))).residual
    variables = [("pose", list(s.network.photos)[i]) for i in rays.photo]
    variables.append(("calibration", next(iter(s.network.cameras))))
    columns = []
    for number, (kind, _) in enumerate(variables):
        width = 6 if kind == "pose" else k.shape[1]
        for component in range(width):
            ends = []
            step = 1e-6 if kind == "pose" else 1e-6 * max(abs(k[0, component]), 1e-5)
            for sign in (1.0, -1.0):
                moved, lens_values = pose.copy(), k.copy()
                if kind == "calibration":
                    lens_values[:, component] += sign * step
                elif component < 3:
                    turn = np.zeros(3)
                    turn[component] = sign * step
                    r = moved[number, :9].reshape(3, 3) @ exp_rotation(turn)
                    moved[number, :9] = r.ravel()
                else:
                    moved[number, 6 + component] += sign * step
                ends.append(intersected(moved, lens_values, xy))
            columns.append((ends[0] - ends[1]) / (2.0 * step))
    g = np.array(columns).T
    joint = np.block([[s.variable_covariance(a, b) for b in variables] for a in variables])
    b = partials(pose, k, x, xy).jacobians[2].reshape(-1, 3) / SIGMA_IMAGE_MM
    expected = np.linalg.inv(b.T @ b) + g @ joint @ g.T
    found = fga.precision_map(s, x)
    assert found.photos[0] == len(rays.photo) >= 2
    assert np.abs(found.covariances[0] - expected).max() < 1e-4 * np.abs(expected).max()


def test_repeated_adjustments_scatter_as_the_map_says():
    """The bound is that of one coordinate, as if all points of the block moved together."""
    errors = repeated(block(), cloud(), REPETITIONS, 1)
    bounds = stats.chi2.ppf([FALSE_ALARM / 2, 1.0 - FALSE_ALARM / 2], REPETITIONS) / REPETITIONS
    for e, found in (
        (errors.dense, fga.precision_map(block(), cloud())),
        (errors.tie, fga.precision_map(block())),
    ):
        mean = np.mean(ratios(e, found.sigmas) ** 2, axis=0)
        assert ((mean > bounds[0]) & (mean < bounds[1])).all(), (mean, bounds)


def test_image_sigmas_matter_as_stated():
    s, x = block(), cloud()
    plain = fga.precision_map(s, x)
    assert np.array_equal(
        plain.covariances, fga.precision_map(s, x, sigma=SIGMA_IMAGE_MM).covariances
    )
    twice = fga.precision_map(s, x, matching_factor=2.0)
    stated = fga.precision_map(s, x, sigma=2.0 * SIGMA_IMAGE_MM)
    assert np.allclose(twice.covariances, stated.covariances, rtol=1e-12)
    four = fga.precision_map(s, x, matching_factor=4.0)
    # Σ = f² N⁻¹ + what the block adds.
    own = (twice.covariances - plain.covariances) / 3.0
    assert np.allclose(four.covariances, plain.covariances + 15.0 * own, rtol=1e-6, atol=1e-12)


def test_photos_see_what_is_in_front_inside_the_format_and_not_turned_away():
    s, x = block(), cloud()
    photos = list(s.as_network().photos.values())
    lens = next(iter(s.network.cameras.values())).lens
    k = np.repeat(s.state["calibration"], len(x), axis=0)
    counts = np.zeros(len(x), dtype=int)
    for pose, f in zip(s.state["pose"], photos, strict=True):
        zero = np.zeros((len(x), 2))
        stored = np.tile(pose, (len(x), 1))
        xy = image(s.network.frame, stored, k, x, observed=zero, lens=lens, jacobians=False)
        inside = (np.abs(xy.residual) <= np.array(FORMAT_MM) / 2).all(axis=1)
        counts += inside & ((x - f.position) @ f.rotation[:, 2] > 0)
    found = fga.precision_map(s, x)
    assert np.array_equal(found.photos, counts)
    above = x + np.array([0.0, 0.0, 1000.0])
    assert not fga.precision_map(s, above).photos.any(), "behind all photos"
    up = np.tile([0.0, 0.0, 5.0], (len(x), 1))
    everything = fga.precision_map(s, x, normals=up, largest_angle=np.pi / 2)
    assert np.array_equal(everything.photos, found.photos)
    steep = fga.precision_map(s, x, normals=up, largest_angle=np.deg2rad(15.0))
    centres = np.array([f.position for f in photos])
    d = centres - x[:, None]
    near = d[..., 2] >= np.cos(np.deg2rad(15.0)) * np.linalg.norm(d, axis=2)
    assert (steep.photos <= near.sum(axis=1)).all() and (steep.photos < found.photos).any()
    assert not fga.precision_map(s, x, normals=-up, largest_angle=1.5).photos.any()


def test_points_of_one_photo_have_no_covariance():
    s, x = block(), cloud()
    one = np.zeros((len(x), len(s.network.photos)), dtype=bool)
    one[:, 0] = True
    found = fga.precision_map(s, x, visible=one)
    assert found.photos.max() == 1
    assert not found.determined.any() and np.isnan(found.sigmas).all()
    assert f"{len(x)} not determined" in repr(found)


def test_interpolated_maps_state_their_error():
    s = block()
    x = simulated_cloud(s, 3000, 2)
    whole, part = fga.precision_map(s, x), fga.precision_map(s, x, nodes=1000)
    assert whole.error is None and part.error is not None and part.nodes < 2500
    both = whole.determined & part.determined
    same = np.isclose(whole.sigmas[both], part.sigmas[both], rtol=1e-9).all(axis=1)
    assert same.sum() >= 0.8 * part.nodes, "nodes are computed"
    ratio = (part.sigmas[both] / whole.sigmas[both] - 1.0)[~same]
    assert np.isclose(np.sqrt(np.mean(ratio**2)), part.error.rms, rtol=0.4)
    assert "interpolated from" in repr(part) and "σx" in part._repr_html_()


def test_groups_of_neighbours_have_every_point_once():
    x = np.random.default_rng(3).normal(size=(1001, 3))
    groups = list(neighbours(x, 100))
    assert sorted(np.concatenate(groups).tolist()) == list(range(1001))
    assert max(map(len, groups)) <= 100
    assert list(neighbours(x[:0], 100)) == []
    assert len(list(neighbours(np.ones((300, 3)), 100))) >= 3, "all at one place"


@pytest.mark.parametrize(
    ("points", "options", "said"),
    [
        (
            np.zeros((2, 2)),
            {},
            r"points is not an \(n, 3\) array of finite numbers: its shape is \(2, 2\)",
        ),
        ([[0.0, 0.0, np.nan]], {}, "points: 1 rows are not finite, the first is row 0"),
        ([["a", "b", "c"]], {}, r"points is not an \(n, 3\) array of finite numbers"),
        (None, {"sigma": 1.0, "nodes": 9}, "sigma, nodes: only for further points"),
        (None, {"matching_factor": 2.0}, "matching_factor: only for further points"),
        ([[0.0] * 3], {"sigma": 0.0}, "sigma must be greater than zero, not 0.0"),
        ([[0.0] * 3], {"matching_factor": np.inf}, "matching_factor must be greater than zero"),
        ([[0.0] * 3], {"visible": np.ones((1, 2), dtype=bool)}, "visible must be an array of bool"),
        ([[0.0] * 3], {"normals": [[0.0, 0.0, 1.0]]}, "belong together"),
        (
            [[0.0] * 3],
            {"normals": [[0.0] * 3], "largest_angle": 1.0},
            "normals: 1 rows are zero",
        ),
        (
            [[0.0] * 3],
            {"normals": [[0.0, 0.0, 1.0]], "largest_angle": 60.0},
            "largest_angle must be greater than 0",
        ),
        ([[0.0] * 3], {"nodes": 2}, "nodes must be 4 or more"),
    ],
)
def test_wrong_arguments_are_refused(points, options, said):
    with pytest.raises(fga.InputError, match=said):
        fga.precision_map(block(), points, **options)


def test_a_network_without_photos_and_one_without_solution_are_refused():
    plain = fga.Network("levels")
    plain.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    plain.add_point("B", (0.0, 0.0, 1.0), fixed="xy")
    plain.add(fga.HeightDifference("A", "B", 1.0, sigma=0.001))
    with pytest.raises(fga.InputError, match="no photos"):
        fga.precision_map(fga.adjust(plain), [[0.0, 0.0, 0.0]])
    with pytest.raises(fga.InputError, match="precision_map takes a Solution, not an object"):
        fga.precision_map(plain)
