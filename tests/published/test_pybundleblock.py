"""Interior orientation and bundle of two scanned photos, against pyBundleBlock's own results."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.film_lens import FilmLens
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.triangulation.film_coordinates import film_coordinates, fit_marks
from tests.loaders.pybundleblock import FOCAL_LENGTH, PHOTOS, PIXEL, read_block
from tests.support.places import data_dir

pytestmark = pytest.mark.published

AFFINE = {
    "P62_15": (
        *(66.61293866337196, -0.00021141713263505418, 7560.9712308987155),
        *(0.0007862412608935117, 66.61124134150894, -7561.032576056914),
    ),
    "P63_15": (
        *(66.61525435210064, 0.0011011889169450784, 7560.971205616725),
        *(0.00164178183005382, 66.61541520819117, -7561.178858453192),
    ),
}
"""a … f of AffineLSQ/Result.txt: column = a x + b y + c, row = d x + e y + f, x and y in mm."""
RESIDUALS = {  # computed − measured, pixels
    "P62_15": ((-0.1, 0.1), (-0.2, 0), (-0.1, 0.1), (0.3, -0.3), (0.1, 0), (0, 0.2), (0.1, -0.1)),
    "P63_15": ((0, 0), (-0.4, -0.2), (0.1, 0), (0.5, -0.4), (0, 0.1), (0, 0.4), (0.2, 0)),
}
POINTS = {
    "t1": ((3881.978, 1486.193, 205.402), (0.034, 0.040, 0.096)),
    "t2": ((4199.243, 1737.684, 244.341), (0.028, 0.033, 0.093)),
    "t3": ((4442.128, 1628.684, 256.297), (0.030, 0.036, 0.096)),
    "t4": ((4273.924, 2111.275, 212.606), (0.028, 0.030, 0.095)),
    "t5": ((4129.187, 2192.282, 208.918), (0.029, 0.030, 0.095)),
    "t6": ((4083.634, 2591.685, 309.608), (0.031, 0.038, 0.092)),
}
"""Coordinates and precision of README.md, metres."""
HALF_MM = 0.56e-3
"""Metres: the README gives σ in whole millimetres, of a minimum that it stops near."""
LM_TOLERANCE = 2.1e-3
"""Metres: its Levenberg-Marquardt stops there, at a fiftieth of σ in height."""


@pytest.fixture(scope="module")
def block():
    return read_block(data_dir("pybundleblock"))


def coefficients(k, scale=1.0):
    """Return a … f of parameters of the film lens."""
    x0, y0, m, r, b1, b2 = k[1:7]
    at = ((1 + m + b1) / scale, (b2 - r) / scale, x0, r / scale, (1 + m) / scale, y0)
    return np.array(at)


@pytest.mark.parametrize("photo", PHOTOS)
def test_affine_transformations_of_the_marks(block, photo):
    """Fitted around the middle of the marks, so that the last digits of c and f move with it."""
    measured, film = map(np.array, zip(*block.marks[photo].values(), strict=True))
    fit = fit_marks(film / PIXEL, measured)
    found = coefficients(fit.parameters, PIXEL)
    a, b, c, d, e, f = AFFINE[photo]
    turned = np.array([[a, b], [d, e]])
    at_zero = found[[2, 5]] - turned @ (fit.middle * PIXEL)
    np.testing.assert_allclose(found[[0, 1, 3, 4]], [a, b, d, e], rtol=0, atol=1e-9)
    np.testing.assert_allclose(at_zero, [c, f], rtol=0, atol=1e-8)
    np.testing.assert_allclose(fit.residuals[:7], RESIDUALS[photo], rtol=0, atol=0.0501)
    assert fit.redundancy == 10
    assert fit.test_values[3, 0] == np.nanmax(fit.test_values)  # F4 in x, the largest residual


def test_bundle_with_film_coordinates(block):
    """As its authors did it: affine first, then a bundle in millimetres."""
    network = fga.Network("in mm")
    network.add_camera("RC-30", NoDistortion(), {"c": FOCAL_LENGTH})
    for name, at in block.control.items():
        network.add_point(name, at, fixed="xyz")
    for photo in PHOTOS:
        network.add_photo(photo, "RC-30")
        measured, film = map(np.array, zip(*block.marks[photo].values(), strict=True))
        names = list(block.images[photo])
        xy = np.array([block.images[photo][name] for name in names])
        found = film_coordinates(film / PIXEL, measured, xy, sigma_marks=0.2, sigma=0.1)
        for name, at in zip(names, (found.xy * PIXEL).tolist(), strict=True):
            if name not in network.points:
                network.add_point(name)
            network.add(fga.ImagePoint(photo, name, *at, sigma=0.0015))
        # README: P62_15 40401 34.2148 77.8308
        if photo == "P62_15":
            np.testing.assert_allclose(found.xy[0] * PIXEL, [34.2148, 77.8308], atol=5.1e-5, rtol=0)
    solution = fga.adjust(network, variance="a-posteriori")
    assert solution.redundancy == 18
    for name, (at, sigma) in POINTS.items():
        np.testing.assert_allclose(solution.point(name), at, rtol=0, atol=LM_TOLERANCE)
        own = np.sqrt(np.diag(solution.covariance(name)))
        np.testing.assert_allclose(own, sigma, rtol=0, atol=HALF_MM)


def test_marks_in_the_network_give_both_steps_at_once(block):
    """With exact marks it is the bundle in two steps; the marks have redundancy of their own."""
    held = fga.adjust(block.network("affine", sigma_marks=1e-4))
    for name, (at, _) in POINTS.items():
        np.testing.assert_allclose(held.point(name), at, rtol=0, atol=LM_TOLERANCE)
    for photo, expected in AFFINE.items():
        k = held.unknown("calibration", f"RC-30@{photo}").values
        np.testing.assert_allclose(coefficients(k, PIXEL), expected, rtol=0, atol=2e-5)
    assert held.redundancy == 18 + 2 * 10


def test_uncertain_marks_take_part_in_the_precision_of_points(block):
    """σ of marks as their residuals show it, twice that of image points, and ten times worse.

    The exterior orientation takes up most of an affine transformation: σ of points grow by 4 % at
    most, and by 16 % where marks are ten times worse.
    """
    exact, both, poor = (
        fga.adjust(block.network("affine", sigma_marks=s)) for s in (1e-4, 0.2, 2.0)
    )
    for name in POINTS:
        a, b, c = (np.sqrt(np.diag(s.covariance(name))) for s in (exact, both, poor))
        print(name, both.point(name) - exact.point(name), b / a, c / a)


def test_a_wrong_mark_is_named_by_photo_and_mark(block):
    network = block.network("affine", sigma_marks=0.25, sigma=0.15)
    wrong = next(
        i
        for i, o in network.observations.items()
        if isinstance(o, fga.FiducialMark) and (o.photo, o.mark) == ("P63_15", "F7")
    )
    o = network.observations[wrong]
    x, y = o.value
    network.observations[wrong] = o.__class__(
        o.photo, o.mark, (x + 4.0, y), film_x=o.film_x, film_y=o.film_y, sigma=o.sigma
    )
    found = fga.snoop(network)
    assert [r.id for r in found.rejected] == [wrong]
    assert network.observations[wrong].names() == ("P63_15", "F7")


def test_the_unit_of_marks_is_an_option_of_the_lens(block):
    assert FilmLens(pixel=PIXEL).pixel == PIXEL
    assert (
        block.network("affine", sigma_marks=0.2).cameras["RC-30"].values[0] == FOCAL_LENGTH / PIXEL
    )
