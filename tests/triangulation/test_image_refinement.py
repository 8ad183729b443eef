"""Refraction and curvature of rays from the air, of vertical and of oblique images."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.atmosphere import standard_pressure
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import MEAN_EARTH_RADIUS
from factorgraph_adj.models.grid_lens import GridLens
from factorgraph_adj.models.image_refraction import (
    Atmosphere,
    in_map_plane,
    map_height,
    ray_refraction,
    refraction_constant,
)
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.scanner_lens import LineLens
from factorgraph_adj.triangulation.image_refinement import refine_images

TABLE = {  # H, h in km; K in 10⁻⁶ rad
    "traced": (12.66, 21.27, 30.69, 45.91, 54.32, 70.14),
    "bertram": (9.84, 17.88, 29.71, 48.70, 64.24, 78.03),
    "wolf": (12.40, 21.00, 30.90, 47.08, 57.34, 71.36),
    "saastamoinen": (12.48, 21.09, 30.68, 46.22, 54.60, 69.61),
}
"""The table of FRAMES F15.2, which an independent script computed at 30°, in plane layers."""
CAMERAS = 1000.0 * np.array([1.0, 1.8, 3.0, 5.0, 7.0, 9.0])
GROUND = 1000.0 * np.array([0.0, 0.05, 0.3, 0.5, 1.0, 0.5])


@pytest.mark.parametrize("model", TABLE)
def test_refraction_is_that_of_the_table(model):
    """Spherical layers differ from plane ones by 0.1 % at 30°."""
    angle = np.full(6, np.radians(30.0))
    k = 1e6 * ray_refraction(angle, CAMERAS, GROUND, model=model) / np.tan(angle)
    close = 0.08 if model == "traced" else 0.0051
    np.testing.assert_allclose(k, TABLE[model], rtol=0, atol=close)


def test_the_integral_is_saastamoinens_closed_form():
    """In kilometres of the standard atmosphere: 2335 … and 277.0 have four digits."""
    top, h = CAMERAS / 1000.0, GROUND / 1000.0
    powers = [(1 - 0.02257 * z) ** 5.256 for z in (h, top)]
    k = 2335 * (powers[0] - powers[1]) / (top - h) - 277.0 * (1 - 0.02257 * top) ** 4.256
    # Both terms are about twenty times their difference.
    np.testing.assert_allclose(1e6 * refraction_constant(CAMERAS, GROUND), k, rtol=0, atol=0.5)


@pytest.mark.parametrize("degrees", [5.0, 30.0, 60.0, 80.0])
def test_traced_rays_obey_snells_law_in_thin_shells(degrees):
    """Against a ray that is bent at each of 40 000 shells of 0.1 m."""
    top, low = 4200.0, 200.0
    edges = np.linspace(top, low, 40001)
    air = Atmosphere()
    n = 1.0 + air.refractivity(0.5 * (edges[1:] + edges[:-1]))
    n_top = 1.0 + air.refractivity(np.array([top]))[0]
    radius = MEAN_EARTH_RADIUS + edges
    invariant = n_top * radius[0] * np.sin(np.radians(degrees)) / n
    # In a shell a ray is straight: its nadir angle grows by the angle at the centre of the Earth.
    turn = np.sum(np.arcsin(invariant / radius[1:]) - np.arcsin(invariant / radius[:-1]))
    true = np.arctan2(radius[-1] * np.sin(turn), radius[0] - radius[-1] * np.cos(turn))
    found = ray_refraction(np.radians([degrees]), np.array([top]), np.array([low]), model="traced")[
        0
    ]
    assert found == pytest.approx(np.radians(degrees) - true, rel=1e-4)


def test_pressure_and_temperature_at_any_height_are_one_atmosphere():
    """Read at 1500 m in the standard atmosphere they give the standard refraction."""
    there = Atmosphere(float(standard_pressure(1500.0)), 288.15 - 0.0065 * 1500.0, 1500.0)
    standard = refraction_constant(CAMERAS, GROUND)
    np.testing.assert_allclose(
        refraction_constant(CAMERAS, GROUND, atmosphere=there), standard, rtol=1e-9
    )
    warm = refraction_constant(CAMERAS, GROUND, atmosphere=Atmosphere(temperature=308.15))
    assert (warm < 0.97 * standard).all()


def test_curvature_is_the_formula_of_vertical_images_to_first_order():
    height, c = 5000.0, 150.0
    angles = np.radians([10.0, 30.0, 45.0])
    top, low = np.full(3, height), np.zeros(3)
    grown = c * (np.tan(in_map_plane(angles, top, low, MEAN_EARTH_RADIUS)) - np.tan(angles))
    r = c * np.tan(angles)
    np.testing.assert_allclose(grown, height * r**3 / (2 * MEAN_EARTH_RADIUS * c**2), rtol=2e-3)


def curved_block(tilt):
    """Return a photo in a map plane as space shows it, its points, and its images in the map.

    The images are those of a point in space: of the arc s from the nadir and the height h.
    """
    network = fga.Network("map")
    network.add_camera("C", NoDistortion(), {"c": 10_000.0}, unit="px")
    top = 6000.0
    network.add_photo("F", "C", position=(0, 0, top), omega_phi_kappa=(tilt, 0.1, 0.7), fixed=True)
    turn = network.photos["F"].rotation
    rng = np.random.default_rng(1)
    in_map = []
    for i in range(12):
        ray = turn @ [*rng.uniform(-0.5, 0.5, 2), 1.0]
        height = rng.uniform(0.0, 400.0)
        s = ray[:2] / -ray[2] * (top - height)
        arc = np.linalg.norm(s) / MEAN_EARTH_RADIUS
        out = (MEAN_EARTH_RADIUS + height) * np.sin(arc) / np.linalg.norm(s)
        down = (MEAN_EARTH_RADIUS + height) * np.cos(arc) - MEAN_EARTH_RADIUS - top
        network.add_point(f"P{i}", (*s, height), fixed="xyz")
        for place, images in (((*(out * s), down), None), ((*s, height - top), in_map)):
            p = turn.T @ place
            at = (1e4 * p[0] / p[2], -1e4 * p[1] / p[2])
            if images is None:
                network.add(fga.ImagePoint("F", f"P{i}", *at, sigma=1.0))
            else:
                images.append(at)
    return network, np.array(in_map)


@pytest.mark.parametrize("tilt", [0.0, 0.4, 0.75])
def test_curvature_takes_images_from_space_to_the_map_whatever_their_tilt(tilt):
    network, in_map = curved_block(tilt)
    refined = refine_images(network, refraction=None, curvature=True)
    found = refined.network.images.columns()[2]
    measured = network.images.columns()[2]
    assert np.abs(in_map - measured).max() > 0.6
    np.testing.assert_allclose(found, in_map, rtol=0, atol=1e-6)
    np.testing.assert_allclose(refined.sum, found - measured, rtol=0, atol=1e-9)
    assert set(refined.corrections) == {"curvature"}


@pytest.mark.parametrize("lens", [NoDistortion(), fga.BrownLens()])
def test_refraction_of_oblique_images_is_towards_the_nadir(lens):
    """Each ray turns in its vertical plane by its own Δ; a vertical image shrinks radially."""
    network, _ = curved_block(0.6)
    del network.cameras["C"]
    network.add_camera("C", lens, {"c": 10_000.0} | ({"k1": 1e-10} if lens.kind == "brown" else {}))
    refined = refine_images(network)
    turn = network.photos["F"].rotation
    for xy, corrected in zip(
        network.images.columns()[2], refined.network.images.columns()[2], strict=True
    ):
        if lens.kind == "none":
            before, after = (
                turn @ (np.array([x / 1e4, -y / 1e4, 1.0]) / np.hypot(1.0, np.hypot(x, y) / 1e4))
                for x, y in (xy, corrected)
            )
            assert np.cross(before, after)[2] == pytest.approx(0.0, abs=1e-10)
            nadir = [np.arctan2(np.hypot(p[0], p[1]), -p[2]) for p in (before, after)]
            assert 0 < nadir[0] - nadir[1] < 3e-4
        assert np.linalg.norm(corrected - xy) > 0.05
    assert "refraction" in repr(refined)
    assert len(list(refined.first_rows().cells)) == 1


def test_a_frame_in_which_the_earth_is_curved_needs_no_curvature():
    network, _ = curved_block(0.0)
    for frame, says in (
        (fga.TopocentricFrame(0.8, 0.1), "topocentric"),
        (fga.GeocentricFrame(), "geocentric"),
        (fga.LocalFrame(curvature=True), "has the curvature of the Earth"),
    ):
        other = network.copy()
        other.frame = frame
        with pytest.raises(InputError, match=says):
            refine_images(other, curvature=True)


def test_points_that_are_not_below_are_named():
    network, _ = curved_block(0.0)
    network.add_point("high", (10.0, 10.0, 7000.0), fixed="xyz")
    network.add(fga.ImagePoint("F", "high", 5.0, 5.0, sigma=1.0))
    with pytest.raises(InputError, match=r"below the camera.*7000\.0 m") as error:
        refine_images(network)
    assert "image F high" in str(error.value)


@pytest.mark.parametrize("lens", [LineLens(), GridLens(LineLens())])
def test_images_whose_y_is_time_are_refused(lens):
    network, _ = curved_block(0.0)
    network.add_camera("spare", lens, {"c": 100.0})
    assert refine_images(network).sum.any(), "no image point is of the camera"
    del network.cameras["C"]
    network.add_camera("C", lens, {"c": 10_000.0}, unit="px")
    with pytest.raises(InputError, match="is the time of a line of the image") as error:
        refine_images(network)
    assert "camera 'C'" in str(error.value)


@pytest.mark.parametrize("joint", [False, True])
def test_images_seen_through_water_are_to_be_refined_before(joint):
    network, _ = curved_block(0.0)
    if joint:
        points = [fga.ImagePoint("F", f"P{i}", 5.0 * i, 9.0, sigma=1.0) for i in range(2)]
        network.image_mask(network.images.columns()[1] >= 2)
        network.add(fga.Correlated(tuple(points), np.eye(4) + 0.1))
    refined = refine_images(network)
    network.set_level("lake", 500.0)
    network.set_refractive_index("water", fixed=True)
    through = {"medium": "water", "level": "lake", "points": ["P0", "P1"]}
    refined.network.set_level("lake", 500.0)
    refined.network.set_refractive_index("water", fixed=True)
    assert len(refined.network.refract_images(**through)) == 2
    network.refract_images(**through)
    with pytest.raises(InputError, match="refine the image points first") as error:
        refine_images(network)
    assert len(error.value.problems) == 2
    assert "P0" in str(error.value) and "P1" in str(error.value)


def test_image_points_whose_corrected_ray_has_no_image_are_named():
    """With ideal residuals the steps alternate and grow where B > 2: at r > 5773 px."""
    network = fga.Network("strong distortion")
    lens = fga.BrownLens(residuals="ideal")
    network.add_camera("C", lens, {"c": 10_000.0, "k1": 1e-8}, unit="px")
    network.add_photo("F", "C", position=(0, 0, 6000.0), omega_phi_kappa=(0, 0, 0), fixed=True)
    for name, x in (("near", 3000.0), ("far", 7000.0), ("farther", -7500.0)):
        ideal = x * (1.0 + 1e-8 * x**2)
        network.add_point(name, (0.6 * ideal, 0.0, 0.0), fixed="xyz")
        network.add(fga.ImagePoint("F", name, x, 0.0, sigma=1.0))
    with pytest.raises(InputError, match="has no image that") as error:
        refine_images(network)
    assert [p.where for p in error.value.problems] == ["image F far", "image F farther"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"refraction": None}, "nothing to correct"),
        ({"refraction": "schut"}, "unknown model"),
        ({"refraction": "bertram", "atmosphere": Atmosphere()}, "atmosphere of its own"),
    ],
)
def test_wrong_options_are_refused(options, says):
    with pytest.raises(InputError, match=says):
        refine_images(curved_block(0.0)[0], **options)


@pytest.mark.parametrize(
    ("options", "says"),
    [({"pressure": 1013.25}, "1 hPa is 100 Pa"), ({"temperature": 15.0}, "kelvin")],
)
def test_pressure_and_temperature_in_other_units_are_refused(options, says):
    with pytest.raises(InputError, match=says):
        Atmosphere(**options)


def test_heights_beyond_the_first_layer_are_refused():
    with pytest.raises(InputError, match="heights are metres"):
        refraction_constant(np.array([12_000.0]), np.array([0.0]))


def test_heights_of_cameras_grow_with_the_map():
    assert map_height(np.array([1770.0]), 50.0, 1.0003)[0] == pytest.approx(1770.516)
