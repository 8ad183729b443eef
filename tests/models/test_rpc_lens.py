"""Rational polynomials: their formula, partials, inverse, frames; refinement against a sensor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.models.inverse_lens import sight_lines
from factorgraph_adj.models.rpc_lens import BIAS, RpcLens
from factorgraph_adj.quality.causes.cause_search import causes
from tests.networks.satellites import (
    CONTROL,
    DELIVERED,
    EXTENT,
    PLACE,
    POINTS,
    fitted,
    geocentric,
    satellites,
)
from tests.support.arrivals import (
    assert_any_order_ends_at_the_batch,
)
from tests.support.scatter import (
    assert_estimates_scatter_as_their_covariance_says,
    assert_the_variance_of_unit_weight_follows_its_distribution,
    few,
)

LENS = RpcLens()
TOPOCENTRIC = TopocentricFrame(np.radians(46.6), np.radians(6.3), 700.0)
VALUES = {"c": 1.001, "x0": 3.0, "y0": -4.0, "b1": 2e-4, "b2": -3e-4, "b3": 1e-4}


def parameters(name: str = "ahead", **bias: float) -> np.ndarray:
    """Return the parameters of an image as one row."""
    given = {**dict.fromkeys(BIAS, 0.0), "c": 1.0, **fitted(DELIVERED[name]), **bias}
    return np.array([[given[n] for n in LENS.names]])


def places(n: int = 20) -> np.ndarray:
    """Return longitudes, latitudes, heights in the scene, (n, 3)."""
    return PLACE + np.random.default_rng(3).uniform(-1.0, 1.0, (n, 3)) * EXTENT


def seen(at: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return image coordinates of geocentric places."""
    zero = np.zeros(len(at))
    return np.stack(LENS.seen(tuple(at.T), zero, zero, k, jacobians=False).v, axis=1)


def polynomial(c: np.ndarray, p: np.ndarray, l: np.ndarray, h: np.ndarray) -> np.ndarray:  # noqa: E741
    """RPC00B as STDI-0002 writes it."""
    return (
        *(c[0] + c[1] * l + c[2] * p + c[3] * h + c[4] * l * p + c[5] * l * h + c[6] * p * h,),
        *(c[7] * l**2 + c[8] * p**2 + c[9] * h**2 + c[10] * p * l * h + c[11] * l**3,),
        *(c[12] * l * p**2 + c[13] * l * h**2 + c[14] * l**2 * p + c[15] * p**3,),
        *(c[16] * p * h**2 + c[17] * l**2 * h + c[18] * p**2 * h + c[19] * h**3,),
    )


def test_image_follows_the_formula_of_rpc00b() -> None:
    rng = np.random.default_rng(1)
    k = parameters()
    k[:, 16:] += rng.normal(0.0, 0.02, (1, 80))
    lonlath = places()
    named = dict(zip(LENS.names, k[0], strict=True))
    lph = {
        name: (lonlath[:, i] - named[f"{name}_off"]) / named[f"{name}_scale"]
        for i, name in enumerate(("long", "lat", "height"))
    }

    def ratio(what: str) -> np.ndarray:
        top, below = (
            sum(
                polynomial(
                    np.array([named[f"{what}_{part}_{i}"] for i in range(1, 21)]),
                    lph["lat"],
                    lph["long"],
                    lph["height"],
                )
            )
            for part in ("num", "den")
        )
        return named[f"{what}_off"] + named[f"{what}_scale"] * top / below

    expected = np.stack([ratio("samp"), -ratio("line")], axis=1)
    np.testing.assert_allclose(seen(geocentric(lonlath), k), expected, atol=1e-6)


def test_partials_are_right() -> None:
    k, at = parameters(**VALUES), geocentric(places())
    zero = np.zeros(len(at))
    found = LENS.seen(tuple(at.T), zero, zero, k)
    for axis, pair in enumerate(found.by_p):
        step = 5.0 * np.eye(3)[axis]
        slope = (seen(at + step, k) - seen(at - step, k)) / 10.0
        np.testing.assert_allclose(np.stack(pair, 1), slope, atol=1e-8)
    for j, (name, pair) in enumerate(zip(LENS.names, found.by_k, strict=True)):
        step = np.zeros_like(k)
        step[0, j] = 1e-5 * max(abs(k[0, j]), 1.0 if "_off" not in name else 1e-3)
        slope = (seen(at, k + step) - seen(at, k - step)) / (2.0 * step[0, j])
        by = np.stack(np.broadcast_arrays(*pair, zero)[:2], axis=1)
        np.testing.assert_allclose(by, slope, atol=3e-6 * max(np.abs(slope).max(), 1.0))


def test_lines_pass_the_places_that_they_image() -> None:
    """The ray of a line is straight; that of polynomials bends by 0.1 mm over 1000 m of height."""
    k, at = parameters(**VALUES), geocentric(places())
    start, direction = sight_lines(LENS, seen(at, k), k)
    assert (np.einsum("ni,ni->n", at - start, direction) > 0.0).all()
    away = np.linalg.norm(np.cross(at - start, direction), axis=1)
    assert away.max() < 1e-3


def test_scene_on_the_meridian_of_180_degrees_is_whole() -> None:
    k = parameters()
    k[0, LENS.names.index("long_off")] = 179.99
    here, there = geocentric([(179.98, 46.6, 700.0)]), geocentric([(-179.98, 46.6, 700.0)])
    apart = np.abs(seen(there, k) - seen(here, k))
    assert 3_000 < apart.max() < 4_000


def test_all_frames_have_the_same_adjustment() -> None:
    ours, theirs = (fga.adjust(satellites(frame=f)[0]) for f in (None, TOPOCENTRIC))
    np.testing.assert_allclose(ours.vtpv, theirs.vtpv, rtol=1e-6)
    for name in ours.network.points:
        at = TOPOCENTRIC.to_geocentric(theirs.point(name)[None])[0]
        np.testing.assert_allclose(ours.point(name), at, atol=2e-4)


@pytest.mark.parametrize(
    ("frame", "why"),
    [(LocalFrame(), "need a geocentric"), (GeocentricFrame("Bessel1841"), "not on the ellipsoid")],
)
def test_frame_without_latitude_longitude_and_height_of_wgs_84_is_refused(frame, why) -> None:
    network = fga.Network(frame=frame)
    network.add_camera("c", LENS, parameters()[0].tolist())
    with pytest.raises(fga.InputError, match=why):
        network.add_photo("f", "c")


def check(free: tuple[str, ...], seed: int) -> tuple[fga.Solution, np.ndarray]:
    """Return the adjustment of the scenes, and errors of points that are not control (n, 3)."""
    network, true = satellites(free=free, frame=TOPOCENTRIC, seed=seed)
    solution = fga.adjust(network)
    found = np.array([solution.point(f"P{i}") for i in range(CONTROL, POINTS)])
    return solution, found - true[CONTROL:]


def test_bias_terms_bring_scenes_to_the_exact_sensor() -> None:
    """As delivered points miss by 16 m; a shift leaves rates of attitude and turns of 20 µrad."""
    rms = {}
    for free in ((), ("x0", "y0"), BIAS):
        _, error = check(free, 1)
        rms[len(free)] = np.sqrt(np.mean(error**2, axis=0))
    assert rms[0].max() > 10.0
    assert rms[2].max() < 1.5
    assert rms[6].max() < 0.95
    # σ̂0 tells that a shift is not enough.
    shifted, whole = (check(free, 1)[0] for free in (("x0", "y0"), BIAS))
    assert stats.chi2.sf(shifted.vtpv, shifted.redundancy) < 1e-3
    assert 0.01 < stats.chi2.sf(whole.vtpv, whole.redundancy) < 0.99


def test_errors_against_the_exact_sensor_are_those_of_the_covariance() -> None:
    """Of 20 seeds; the χ² of all check points of a seed, two-sided at 99.9 % over all."""
    values = []
    for seed in range(1, 21):
        solution, error = check(BIAS, seed)
        for i, e in zip(range(CONTROL, POINTS), error, strict=True):
            q = solution.covariance(f"P{i}")
            values.append(e @ np.linalg.solve(q, e))
    # Errors of a seed share those of the bias: the mean of a seed has a wider distribution.
    mean = np.array(values).reshape(20, -1).mean(axis=1)
    assert abs(mean.mean() - 3.0) < 3.3 * mean.std(ddof=1) / np.sqrt(20)
    assert stats.kstest(np.array(values)[:: POINTS - CONTROL], "chi2", args=(3,)).pvalue > 1e-3


def test_blunder_across_the_track_is_found() -> None:
    """Along the track two of three images have height and plan: there redundancy is small."""
    network, _ = satellites(free=BIAS, seed=2)
    network.images.xy[0][20] += (12.0, 0.0)
    assert [r.id for r in fga.snoop(network).rejected] == ["ahead/P20"]


def test_estimates_scatter_as_their_covariance_says() -> None:
    found = few("image, rational polynomials")
    assert_estimates_scatter_as_their_covariance_says(found)
    assert_the_variance_of_unit_weight_follows_its_distribution(found)


def test_weighted_shift_adjusts_scenes_without_control() -> None:
    network, true = satellites(free=(), frame=TOPOCENTRIC, placed=True)
    for camera in list(network.cameras.values()):
        del network.cameras[camera.name]
        values = dict(zip(LENS.names, camera.values, strict=True))
        sigma = {"x0": 15.0, "y0": 15.0}
        network.add_camera(camera.name, LENS, values, sigma=sigma, unit="px", format=camera.format)
    for name in list(network.points):
        network.points[name] = fga.Point(name, network.points[name].coordinates)
    solution = fga.adjust(network)
    error = np.array([solution.point(n) for n in network.points]) - true
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 25.0
    sigmas = solution.standard_deviations("P20")
    assert (sigmas > 5.0).all() and (sigmas < 40.0).all()


def test_project_and_plan_have_the_images(tmp_path) -> None:
    network, _ = satellites(free=BIAS, placed=True)
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path / "project.toml")
    assert again.cameras == network.cameras
    ours, theirs = fga.adjust(network), fga.adjust(again)
    np.testing.assert_allclose(ours.vtpv, theirs.vtpv, rtol=1e-5)
    planned = fga.plan(again).solution.standard_deviations("P20")
    np.testing.assert_allclose(planned, ours.standard_deviations("P20"), rtol=1e-3)


def test_report_lists_the_bias_alone() -> None:
    text = fga.text_report(fga.adjust(satellites(free=BIAS)[0]))
    assert "x0" in text
    assert "line_num_1" not in text


def test_arrivals_in_any_order_end_at_the_adjustment_of_all() -> None:
    assert_any_order_ends_at_the_batch(satellites(free=("x0", "y0"))[0])


def test_missing_coefficients_are_named_and_points_outside_their_range_told() -> None:
    network, shown = satellites(seed=None)
    values = {**dict.fromkeys(BIAS, 0.0), "c": 1.0, **fitted(DELIVERED["ahead"])}
    del values["lat_scale"], values["height_off"]
    with pytest.raises(fga.InputError, match="needs height_off, lat_scale"):
        fga.Network("n", frame=GeocentricFrame()).add_camera("a", LENS, values)
    assert not [f for f in fga.preliminary(network) if "far outside the range" in str(f)]
    ellipsoid = GeocentricFrame("WGS84").ellipsoid
    for name, at in zip(list(network.points)[:CONTROL], shown, strict=False):
        latitude, longitude, height = ellipsoid.to_geodetic(at[None])
        swapped = ellipsoid.to_cartesian(longitude, latitude, height)[0]
        network.points[name] = fga.Point(name, tuple(swapped.tolist()), network.points[name].fixed)
    found = [str(f) for f in fga.preliminary(network) if "far outside the range" in str(f)]
    assert found and "latitude and longitude are exchanged" in found[0]


def test_a_cause_names_the_coefficients_as_such() -> None:
    network, _ = satellites(free=())
    found = causes(fga.reliability(fga.adjust(network))).found
    of_cameras = [c for c in found if "'down'" in c.where and c.cause == "the coefficients"]
    assert len(of_cameras) == 1 and of_cameras[0].where == "of camera 'down'"
    assert "line_num" not in str(of_cameras[0]) and "T² " in str(of_cameras[0])
