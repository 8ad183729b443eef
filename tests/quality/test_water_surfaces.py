"""A lake bottom and a camera in a housing: depths, start values, gross errors, arrivals, plans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.atmosphere import water_index
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import GeocentricFrame, LocalFrame
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.positions import heights
from tests.networks.lake_bottom import (
    INDEX,
    Flight,
    as_in_air,
    housing,
    lake,
    under_water,
)

NANOMETRE = 1e-9
UNKNOWN = Flight(gauge=True, level={}, index={"sigma": 0.005})
"""A flight that finds the height of the lake, and improves the index."""


def depths(solution: fga.Solution, plan: fga.Network) -> np.ndarray:
    """Return true depths by adjusted ones."""
    names = under_water(plan)
    true = np.array([plan.points[n].coordinates[2] for n in names])
    return np.asarray(true / [solution.point(n)[2] for n in names])


def test_a_bottom_that_is_taken_as_seen_in_air_is_too_shallow_by_the_index_at_least() -> None:
    """Near the vertical the factor is the index, for oblique rays more; with refraction it is 1."""
    plan = lake()
    plan.photos = {n: replace(f, fixed=(True,) * 6) for n, f in plan.photos.items()}
    measured = fga.measure(plan, seed=1, noise=False)
    factor = depths(fga.adjust(as_in_air(measured)), plan)
    assert (factor > INDEX).all()
    assert factor.min() < 1.40 < factor.max() < 1.6
    found = fga.adjust(measured)
    for name, point in plan.points.items():
        np.testing.assert_allclose(found.point(name), point.coordinates, atol=10 * NANOMETRE)


def test_index_and_level_are_found_with_their_uncertainty() -> None:
    plan = lake(UNKNOWN)
    solution = fga.adjust(fga.measure(plan, seed=1))
    for kind, name, true in (("level", "lake", 0.0), ("refractive_index", "water", INDEX)):
        found = solution.unknown(kind, name)
        assert abs(found.values[0] - true) < 3 * found.sigmas[0]
    planned = fga.plan(plan)
    of_plan = planned.solution.unknown("level", "lake").sigmas
    np.testing.assert_allclose(of_plan, solution.unknown("level", "lake").sigmas, rtol=0.05)
    reliability = fga.reliability(solution)
    assert reliability.redundancy_numbers.sum() == pytest.approx(solution.redundancy)


def test_a_known_height_under_water_determines_the_index_better() -> None:
    """Near-vertical rays tell the apparent depth alone; the index is weak without a height."""
    without = fga.plan(lake(Flight(index={}, level={}, gauge=True))).solution
    known = Flight(index={}, level={}, gauge=True, bottom_control=6)
    with_heights = fga.plan(lake(known)).solution
    weak, strong = (
        s.unknown("refractive_index", "water").sigmas[0] for s in (without, with_heights)
    )
    assert strong < 0.7 * weak


def test_a_medium_that_no_point_is_in_is_named_as_undetermined() -> None:
    network = fga.measure(lake(), seed=1)
    network.set_refractive_index("oil")
    with pytest.raises(fga.AdjustmentError, match="refractive index 'oil'"):
        fga.adjust(network)


def test_points_under_water_start_where_they_seem_to_be() -> None:
    network = fga.measure(lake(UNKNOWN), seed=1)
    blank = network.copy()
    blank.points = {
        n: p if all(p.fixed) else replace(p, coordinates=(np.nan,) * 3)
        for n, p in network.points.items()
    }
    assert fga.adjust(blank).vtpv == pytest.approx(fga.adjust(network).vtpv, rel=1e-8)


def test_gross_errors_of_refracted_image_points_are_found() -> None:
    network = fga.measure(lake(UNKNOWN), seed=1)
    ident = [i for i, x in network.observations.items() if x.kind == "image_through_level"][40]
    x: Any = network.observations[ident]
    network.observations[ident] = replace(x, value=(x.value[0], x.value[1] - 9.0))
    first = fga.snoop(network).rejected[0]
    assert (first.id, first.component) == (ident, "y")
    assert first.final_error == pytest.approx(-9.0, abs=3 * first.final_sigma)


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_refracted_image_points_arrive(engine: Literal["isam2", "fronts"]) -> None:
    network = fga.measure(lake(UNKNOWN), seed=1)
    batch = fga.adjust(network)
    late = [i for i, x in network.observations.items() if x.kind == "image_through_level"][-60:]
    first = network.copy()
    first.observations = {i: x for i, x in network.observations.items() if i not in late}
    graph = fga.IncrementalAdjustment(first, engine=engine)
    for begin in (0, 30):
        some = late[begin : begin + 30]
        graph.add([replace(network.observations[i], id=i) for i in some])
    graph.settle(all=True)
    found = graph.solution()
    assert found.vtpv == pytest.approx(batch.vtpv, rel=1e-5)
    for kind, name in (("level", "lake"), ("refractive_index", "water")):
        mine, whole = found.unknown(kind, name), batch.unknown(kind, name)
        assert abs(mine.values[0] - whole.values[0]) < 1e-2 * whole.sigmas[0]
        assert mine.sigmas[0] == pytest.approx(whole.sigmas[0], rel=1e-2)


def test_a_project_and_a_report_have_the_water(tmp_path: Path) -> None:
    network = fga.measure(lake(UNKNOWN), seed=1)
    fga.write_project(network, tmp_path / "project.toml")
    solution = fga.adjust(fga.read_project(tmp_path))
    assert solution.vtpv == fga.adjust(network).vtpv
    text = fga.text_report(solution)
    assert "image through level" in text
    assert "water" in text
    assert "refractive index" in text


@pytest.mark.parametrize("frame", [LocalFrame(curvature=True), GeocentricFrame()])
def test_a_level_is_curved_in_frames_that_are(frame: Any) -> None:
    """1 km from the origin the surface of a curved frame lies 8 cm below its plane."""
    network = fga.Network("far", frame=frame)
    if isinstance(frame, GeocentricFrame):

        def at(h: float) -> Any:
            place = (np.radians([47.0]), np.radians([11.0]), np.array([h]))
            return ellipsoid("GRS80").to_cartesian(*place)[0]
    else:

        def at(h: float) -> Any:
            return np.array([1000.0, 0.0, h - 1000.0**2 / (2 * frame.radius)])

    assert heights(frame, at(-5.0)[None])[0][0] == pytest.approx(-5.0, abs=1e-6)
    network.add_camera("c", NoDistortion(), {"c": 1000.0})
    up = heights(frame, at(0.0)[None])[1][0]
    east = np.cross([0.3, 0.2, 0.9], up)
    east /= np.linalg.norm(east)
    for i in range(3):
        rotation = np.stack([east, np.cross(-up, east), -up], axis=1)
        place = at(50.0) + 15.0 * (i - 1) * east + 3.0 * i * np.cross(up, east)
        network.add_photo(f"F{i}", "c", position=place.tolist(), rotation=rotation, fixed=True)
        network.photos[f"F{i}"] = replace(network.photos[f"F{i}"], fixed=(True,) * 6)
    network.add_point("P", at(-5.0).tolist())
    network.set_level("lake", 0.0, fixed=True)
    network.set_refractive_index("water", 1.34, fixed=True)
    for f in network.photos:
        network.add_image_points(f, ["P"], np.zeros((1, 2)), sigma=0.1)
    network.refract_images(medium="water", level="lake")
    measured = fga.measure(network, seed=1, noise=False)
    # In plain vectors: the ray that Snell's law bends at the surface above the point.
    x: Any = next(iter(measured.observations.values()))
    photo = network.photos["F0"]
    ray = np.asarray(photo.rotation) @ [x.value[0], -x.value[1], 1000.0]
    ray /= np.linalg.norm(ray)
    surface = np.asarray(photo.position) + (50.0 / -(ray @ up)) * ray
    inside = ray / 1.34 + (np.sqrt(1 - (1 - (ray @ up) ** 2) / 1.34**2) + (ray @ up) / 1.34) * -up
    reached = surface + 5.0 / -(inside @ up) * inside
    np.testing.assert_allclose(reached, at(-5.0), atol=1e-4)


def test_a_port_is_calibrated_from_targets_under_water() -> None:
    plan = housing()
    network = fga.measure(plan, seed=2)
    solution = fga.adjust(network)
    port = solution.unknown("port", "port")
    true = np.array(plan.of_kind("port")["port"].values)
    off = (np.array(port.values) - true)[:3] / np.array(port.sigmas)[:3]
    assert np.abs(off).max() < 3.5
    assert port.sigmas[2] < 1e-4
    # As a pinhole with a longer principal distance the same camera misfits: it has no centre.
    air = as_in_air(network)
    camera = air.cameras["diver"]
    free = tuple(n not in ("c", "k1", "k2", "k3") for n in camera.lens.names)
    values = (1.34 * camera.values[0], *camera.values[1:])
    air.cameras["diver"] = replace(camera, fixed=free, values=values)
    pinhole = fga.adjust(air)
    assert pinhole.vtpv > 1.3 * solution.vtpv
    assert pinhole.unknown("calibration", "diver").values[0] == pytest.approx(
        1.34 * 2800.0, rel=0.02
    )


def test_targets_before_and_after_the_water_came_are_one_network() -> None:
    network = fga.measure(housing(in_air=True), seed=3)
    assert network.n_image_points
    solution = fga.adjust(network)
    assert abs(solution.unknown("refractive_index", "water").values[0] - 1.34) < 5e-4


def test_covariances_of_image_points_go_with_them_through_the_port() -> None:
    network = as_in_air(fga.measure(housing(), seed=1))
    network.set_port("port", distance=0.06)
    network.set_refractive_index("water", 1.34)
    points = list(network.image_points())
    alone, a, b, *rest = points
    correlated = replace(alone, sigma=(0.3, 0.5), correlation=0.4)
    root = np.random.default_rng(1).normal(size=(4, 4))
    joint = root @ root.T + np.eye(4)
    network.images = network.images.kept(np.zeros(len(points), dtype=bool))
    network.add(correlated, *rest, o.Correlated((a, b), joint))
    (photo,) = {a.photo, b.photo}
    some = network.copy()
    with pytest.raises(fga.InputError, match=f"{photo}/{a.point} have a joint covariance with "):
        some.refract_images(medium="water", port="port", points=[a.point])
    assert some.n_image_points == len(points)
    ids = network.refract_images(medium="water", port="port")
    assert len(ids) == len(points) and not network.n_image_points
    seen: Any = {(x.photo, x.point): x for x in network.observations.values()}
    found = seen[alone.photo, alone.point].covariance
    np.testing.assert_allclose(found, [[0.09, 0.06], [0.06, 0.25]])
    ((members, covariance),) = network.clusters
    of = [network.observations[i] for i in members]
    assert [(x.photo, x.point) for x in of] == [(x.photo, x.point) for x in (a, b)]
    np.testing.assert_array_equal(covariance, joint)


def test_refract_images_says_what_is_wrong() -> None:
    network = housing()
    with pytest.raises(fga.InputError, match="one of level, plane and port"):
        network.refract_images(medium="water")
    with pytest.raises(fga.InputError, match="no image point"):
        network.refract_images(medium="water", port="port")
    again = as_in_air(fga.measure(network, seed=1))
    again.set_port("port", distance=0.06)
    before = again.n_image_points
    with pytest.raises(fga.InputError, match="unknown refractive index 'milk'"):
        again.refract_images(medium="milk", port="port")
    assert again.n_image_points == before
    with pytest.raises(fga.InputError, match="distance and glass_index must be greater than zero"):
        again.set_port("p", distance=0.0)
    with pytest.raises(fga.InputError, match="valid: slope_x"):
        again.set_port("p", distance=0.1, free=("tilt",))
    with pytest.raises(fga.InputError, match=r"between 0\.1 and 10"):
        again.set_refractive_index("p", -1.3)
    with pytest.raises(fga.InputError, match="medium must be the name"):
        o.ImageThroughPort("f", "p", (0.0, 0.0), sigma=1.0, port="w", medium="")


def test_the_index_of_water_is_that_of_two_published_sets() -> None:
    """Fresh water, sodium light, 20 °C: 1.33299 (CRC Handbook); Parrish 2020: 540 nm, 1.3·10⁻⁴.

    Parrish's polynomials of the same data, n = a T² + b λ² + c T + d λ + e, are in his repository
    (hokiespurs/water_ior).
    """
    assert water_index(temperature=20.0, wavelength=589.3) == pytest.approx(1.33299, abs=3e-5)
    fresh = (-1.97812e-6, 1.03223e-7, -8.58125e-6, -1.54834e-4, 1.38919)
    sea = (-1.50156e-6, 1.07085e-7, -4.27594e-5, -1.60476e-4, 1.39807)
    for salinity, (a, b, c, d, e) in ((0.0, fresh), (35.0, sea)):
        for t in (0.0, 10.0, 20.0, 30.0):
            for w in (450.0, 540.0, 650.0):
                n = a * t**2 + b * w**2 + c * t + d * w + e
                found = water_index(temperature=t, salinity=salinity, wavelength=w)
                assert found == pytest.approx(n, abs=5e-4)
    with pytest.raises(fga.InputError, match="salinity must be from 0 to 35 g/kg, not 350"):
        water_index(salinity=350.0)
