"""The lens of film: transformations of the plane, and distortion tables of certificates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.film_lens import FilmLens
from factorgraph_adj.models.inverse_lens import directions, tangents
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.simulation.systematic_errors import LensDistortion

C = 152.0
RADII = tuple(range(10, 151, 10))
AVIOGON = (0.5, 1.0, 1.8, 2.6, 3.2, 3.6, 3.4, 2.6, 1.2, -0.6, -2.4, -3.8, -4.4, -3.6, -1.0)
"""A curve with the shape of a wide-angle aerial lens, µm at every 10 mm."""
UM = 1e-3


def image_of(lens, places, **values):
    """Return the measured coordinates of ideal places (n, 2), image units."""
    k = np.array([[{"c": C, **values}.get(n, 0.0) for n in lens.names]])
    zero = np.zeros((len(places), 2))
    return lens.residual(*(places / C).T, zero, k, jacobians=False)[0]


def around(radii, turn=0.3):
    return np.stack([radii * np.cos(turn), radii * np.sin(turn)], axis=1)


def test_measured_radii_have_the_distortion_of_the_table():
    """r is measured: the ideal radius is r − Δr, at every node and in every direction."""
    radii, distortion = np.array(RADII, dtype=float), UM * np.array(AVIOGON)
    lens = FilmLens(1.0, RADII, (tuple(distortion.tolist()),))
    for turn in (0.0, 1.0, 3.0, -2.0):
        seen = image_of(lens, around(radii - distortion, turn))
        np.testing.assert_allclose(seen, around(radii, turn), rtol=0, atol=1e-12)


def test_between_its_radii_the_table_is_scipys_natural_spline():
    radii, distortion = np.array([0.0, *RADII]), UM * np.array([0.0, *AVIOGON])
    lens = FilmLens(1.0, tuple(radii.tolist()), (tuple(distortion.tolist()),))
    ideal = np.linspace(0.0, 149.9, 400)
    expected = CubicSpline(radii - distortion, distortion, bc_type="natural")(ideal)
    seen = np.linalg.norm(image_of(lens, around(ideal)), axis=1) - ideal
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-13)
    straight = replace(lens, between="linear")
    seen = np.linalg.norm(image_of(straight, around(ideal)), axis=1) - ideal
    expected = np.interp(ideal, radii - distortion, distortion)
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-13)


def test_a_table_in_pixels_is_that_in_millimetres():
    radii, distortion = np.array(RADII, dtype=float), (tuple(UM * np.array(AVIOGON)),)
    mm = image_of(FilmLens(1.0, RADII, distortion), around(radii))
    lens = FilmLens(0.015, RADII, distortion)
    k = np.array([[{"c": C / 0.015}.get(n, 0.0) for n in lens.names]])
    zero = np.zeros((len(radii), 2))
    px = lens.residual(*(around(radii) / C).T, zero, k, jacobians=False)[0]
    np.testing.assert_allclose(0.015 * px, mm, rtol=0, atol=1e-10)


def test_a_table_by_angles_belongs_to_its_principal_distance():
    """Ideal radii are c tan α exactly."""
    angles = np.radians([7.5, 15.0, 22.5, 30.0, 37.5, 42.5])
    distortion = UM * np.array([1.0, 2.5, 3.0, 1.0, -4.0, -2.0])
    lens = FilmLens.of_angles(C, angles, [distortion])
    ideal = C * np.tan(angles)
    seen = np.linalg.norm(image_of(lens, around(ideal)), axis=1)
    np.testing.assert_allclose(seen - ideal, distortion, rtol=0, atol=1e-12)
    assert FilmLens.of_angles(C, angles, distortion[None]) == lens


def test_half_diagonals_and_tangential_distortion():
    """On its half diagonal each row counts alone, between two of them their mean."""
    corners = tuple(np.radians([45.0, 135.0, 225.0, 315.0]).tolist())
    radial = tuple((0.0, 2.0 * i * UM) for i in range(4))
    tangential = tuple((0.0, -3.0 * i * UM) for i in range(4))
    lens = FilmLens(1.0, (0.0, 100.0), radial, tangential, corners, "linear")

    def at(turn):
        ideal = around(np.array([50.0]), turn)
        d = (image_of(lens, ideal) - ideal)[0]
        return d @ [np.cos(turn), np.sin(turn)], d @ [-np.sin(turn), np.cos(turn)]

    for i, turn in enumerate(corners):
        assert at(turn) == pytest.approx((i * UM, -1.5 * i * UM), abs=2e-7)
    assert at(np.pi / 2) == pytest.approx((0.5 * UM, -0.75 * UM), abs=2e-7)
    assert at(0.0) == pytest.approx((1.5 * UM, -2.25 * UM), abs=2e-7)  # of the fourth and the first


def test_beyond_its_last_radius_a_table_goes_on_level():
    lens = FilmLens(1.0, (0.0, 50.0, 100.0), ((0.0, 1.0, 3.0),))
    seen = np.linalg.norm(image_of(lens, around(np.array([150.0, 200.0]))), axis=1)
    assert seen == pytest.approx([153.0, 203.0])


def test_a_boundary_layer_lies_on_top_of_a_table():
    distortion = (tuple((UM * np.array(AVIOGON)).tolist()),)
    both = FilmLens(1.0, RADII, distortion, between="linear").plus((50.0, 150.0), (-1e-3, -6e-3))
    radii = np.array([50.0, 100.0, 150.0])
    ideal = np.linalg.norm(image_of(both, around(radii)), axis=1) - radii
    expected = UM * np.array([AVIOGON[4], AVIOGON[9], AVIOGON[14]]) + [-1e-3, -3.5e-3, -6e-3]
    np.testing.assert_allclose(ideal, expected, rtol=0, atol=2e-6)
    alone = FilmLens().plus((100.0,), (2e-3,))
    assert alone.radial == ((2e-3,),)


@pytest.mark.parametrize("turn", [0.0, 1.5, 3.1, -2.0])
def test_rays_of_measured_coordinates_are_found_however_a_photo_lies_in_the_scanner(turn):
    lens = FilmLens(1.0, RADII, (tuple((UM * np.array(AVIOGON)).tolist()),))
    values = {"x0": 300.0, "y0": -200.0, "m": np.cos(turn) - 1.0, "r": np.sin(turn)}
    values |= {"b1": 1e-3, "g1": 1e-7, "h2": -1e-7}
    places = np.array([(3.0, 4.0), (-100.0, 80.0), (90.0, -100.0)])
    seen = image_of(lens, places, **values)
    k = np.array([[{"c": C, **values}.get(n, 0.0) for n in lens.names]])
    np.testing.assert_allclose(tangents(lens, seen, k) * C, places, rtol=0, atol=1e-5)
    rays = directions(lens, seen, k)
    np.testing.assert_allclose(C * rays[:, :2] / rays[:, 2:], places * [1, -1], rtol=0, atol=1e-5)


def test_the_table_of_a_certificate_removes_the_curve_of_a_lens():
    """An aerial block whose images have the curve, nine times σ at its largest."""
    plan = simulate_aerial_block(1, image_points=1500, points_per_photo=100).network
    camera = next(iter(plan.cameras.values()))
    c = camera.values[0]
    share = c / C
    network = measure(plan, seed=4)
    _, _, xy, sigma = network.images.columns()
    size = 9.0 * float(sigma.max()) / share / (4.4 * UM)
    values = tuple(size * v for v in AVIOGON)
    curve = LensDistortion(radii_mm=RADII, distortion_um=values).curve
    middle = np.array(camera.values[1:3])
    r = np.linalg.norm(xy - middle, axis=1, keepdims=True)
    bent = xy + (xy - middle) / np.maximum(r, 1e-9) * curve(r / share) * share
    network.images = network.images.with_columns(xy=bent)
    rows = (tuple((UM * np.array(values)).tolist()),)
    # The simulated curve is a function of the ideal radius, the table one of the measured radius.
    ideal = np.array(RADII) + rows[0]
    lens = FilmLens(1.0 / share, tuple(ideal.tolist()), rows)
    found = []
    for model in (FilmLens(), lens):
        own = network.copy()
        del own.cameras[camera.name]
        own.add_camera(camera.name, model, {"c": c, "x0": middle[0], "y0": middle[1]})
        found.append(fga.adjust(own).sigma0)
    assert found[1] == pytest.approx(1.0, abs=0.05)
    assert found[0] > 1.2


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"pixel": 0.0}, "pixel must be a length"),
        ({"radii": (1.0, 1.0), "radial": ((0.0, 0.0),)}, "distances that increase"),
        ({"radii": (1.0, 2.0), "radial": ((0.0,),)}, "1 row, one for each direction, of 2 values"),
        ({"radii": (1.0,), "radial": ((0.0,),), "directions": (0.0, 1.0)}, "2 rows"),
        ({"radii": (0.0, 1.0), "radial": ((0.1, 0.2),)}, "zero at the principal point"),
        ({"radii": (1.0,)}, "radial or tangential must be stated"),
        ({"between": "cubic"}, "spline or linear"),
        (
            {"radii": (1.0,), "radial": ((0.0,), (0.0,)), "directions": (2.0, 1.0)},
            "directions must increase",
        ),
    ],
)
def test_tables_that_are_none_are_refused(options, says):
    with pytest.raises(InputError, match=says):
        FilmLens(**options)


def test_image_points_beyond_the_table_are_told():
    network = fga.Network("table")
    lens = FilmLens(1.0, (0.0, 50.0), ((0.0, 1e-3),))
    network.add_camera("C", lens, {"c": C, "x0": 200.0}, free=("x0",))
    network.add_photo("F", "C", position=(0, 0, 0), omega_phi_kappa=(0, 0, 0), fixed=True)
    for name, x in (("in", 49.0), ("out", 51.0)):
        network.add_point(name, (x, 0.0, -C), fixed="xyz")
        network.add(fga.ImagePoint("F", name, 200.0 + x, 0.0, sigma=0.01))
    found = [f for f in fga.preliminary(network) if "table of distortions" in str(f)]
    assert len(found) == 1
    assert found[0].ids == ("F/out",)
    assert "1 image points lie beyond" in str(found[0])


@pytest.mark.parametrize(
    ("lens", "says"),
    [
        (FilmLens(1.0, (0.0, 25.0, 50.0), ((0.0, -4.0, 7.0),)), "has distortions of up to 7"),
        (FilmLens(1.0, (0.0, 49.9, 50.0), ((0.0, -0.4, 0.4),)), "the same image at several"),
        (FilmLens(0.005, (0.0, 50.0), ((0.0, 1e-3),)), "goes far beyond the image"),
        (FilmLens(1.0, (0.0, 25.0, 50.0), ((0.0, -4e-3, 7e-3),)), None),
    ],
)
def test_tables_in_another_unit_than_the_image_are_told(lens, says):
    network = fga.Network("table")
    network.add_camera("C", lens, {"c": C, "x0": 200.0}, free=("x0",))
    network.add_photo("F", "C", position=(0, 0, 0), omega_phi_kappa=(0, 0, 0), fixed=True)
    for name, x in (("near", 10.0), ("far", 49.0)):
        network.add_point(name, (x, 0.0, -C), fixed="xyz")
        network.add(fga.ImagePoint("F", name, 200.0 + x, 0.0, sigma=0.01))
    found = [str(f) for f in fga.preliminary(network) if "table of distortions, to" in str(f)]
    assert len(found) == (says is not None)
    assert says is None or (says in found[0] and "one unit of length" in found[0])
