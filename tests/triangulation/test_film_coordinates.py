"""Film coordinates by marks and by réseau patches: laws, and scatter of simulated measurements."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.film_lens import TRANSFORMATIONS, FilmLens
from factorgraph_adj.triangulation.film_coordinates import film_coordinates, fit_marks

RESEAU = np.stack(np.meshgrid(*[np.arange(-100.0, 101.0, 25.0)] * 2), -1).reshape(-1, 2)
"""Crosses every 25 mm of a format of 23 cm."""
TRUE = {
    "conformal": {"x0": 120.0, "y0": -118.0, "m": 3e-4, "r": 1.3},
    "affine": {"b1": 2e-4, "b2": -1e-4},
    "bilinear": {"h1": 3e-7, "h2": -5e-7},
    "projective": {"g1": 2e-7, "g2": -4e-7},
}
BOTH = [("affine", "four"), ("affine", "five")]
SIGMA = 0.003
"""Standard deviation of measured coordinates, mm."""


def scanned(film, **parameters):
    """Return where a scanner sees film coordinates (n, 2)."""
    lens = FilmLens()
    k = np.array([[parameters.get(n, 0.0) for n in lens.names]])
    return np.stack(lens.scanned(film[:, 0], film[:, 1], k)[0], axis=1)


def parameters_of(transformation):
    own = set(TRANSFORMATIONS[transformation])
    return {n: v for group in TRUE.values() for n, v in group.items() if n in own}


@pytest.mark.parametrize("transformation", TRANSFORMATIONS)
def test_exact_marks_give_exact_film_coordinates(transformation):
    points = np.array([(3.0, 4.0), (-88.0, 71.0), (110.0, -110.0)])
    true = parameters_of(transformation)
    found = film_coordinates(
        RESEAU,
        scanned(RESEAU, **true),
        scanned(points, **true),
        transformation=transformation,
        sigma_marks=SIGMA,
        sigma=SIGMA,
    )
    np.testing.assert_allclose(found.xy, points, rtol=0, atol=1e-9)
    assert found.fits[0].redundancy == 2 * len(RESEAU) - len(TRANSFORMATIONS[transformation])


@pytest.mark.parametrize(
    ("transformation", "reseau"), [("affine", None), ("projective", None), *BOTH]
)
def test_covariance_is_that_of_repeated_measurements(transformation, reseau):
    """Three points in one patch and one in another, whose errors are correlated by their marks."""
    points = np.array([(3.0, 4.0), (20.0, 21.0), (11.0, 2.0), (28.0, 12.0)])
    true = parameters_of("affine")
    at, seen = scanned(RESEAU, **true), scanned(points, **true)
    rng = np.random.default_rng(11)
    how = {"transformation": transformation, "reseau": reseau}
    how |= {"sigma_marks": 2 * SIGMA, "sigma": SIGMA}
    plan = film_coordinates(RESEAU, at, seen, **how)
    repetitions = 400
    errors = np.array(
        [
            film_coordinates(
                RESEAU,
                at + 2 * SIGMA * rng.normal(size=at.shape),
                seen + SIGMA * rng.normal(size=seen.shape),
                **how,
            ).xy
            - points
            for _ in range(repetitions)
        ]
    ).reshape(repetitions, -1)
    z = np.linalg.solve(np.linalg.cholesky(plan.covariance), errors.T)
    n = z.size
    low, high = stats.chi2.ppf([0.0005, 0.9995], n)
    assert low < np.sum(z**2) < high
    products = z @ z.T / np.sqrt(repetitions)
    assert np.abs(products[np.triu_indices(len(z), 1)]).max() < 4.5


def test_patches_follow_a_film_that_no_transformation_of_the_whole_follows():
    """Film with waves of 60 µm: patches of 25 mm leave little of what an affine leaves."""

    def bent(film):
        return film + 0.06 * np.sin(film[:, ::-1] / 30.0)

    rng = np.random.default_rng(5)
    points = rng.uniform(-95.0, 95.0, (200, 2))
    rms = {}
    for reseau in (None, "four", "five"):
        found = film_coordinates(
            RESEAU,
            bent(RESEAU),
            bent(points),
            reseau=reseau,
            sigma_marks=SIGMA,
            sigma=SIGMA,
        )
        rms[reseau] = float(np.sqrt(np.mean((found.xy - points) ** 2)))
    assert rms[None] > 0.03
    assert rms["four"] < 0.15 * rms[None]
    assert rms["five"] < 0.25 * rms[None]


def test_a_wrong_cross_is_found_by_the_affine_patches_alone():
    at = scanned(RESEAU, **parameters_of("affine"))
    wrong = 40  # the middle one
    at[wrong, 0] += 20 * SIGMA
    points = RESEAU[wrong] + np.array([[9.0, 8.0]])
    seen = scanned(points, **parameters_of("affine"))
    by = {"sigma_marks": SIGMA, "sigma": SIGMA}
    five = film_coordinates(RESEAU, at, seen, reseau="five", **by).fits[0]
    four = film_coordinates(RESEAU, at, seen, reseau="four", **by).fits[0]
    worst = np.unravel_index(np.nanargmax(np.abs(five.test_values)), (5, 2))
    assert (int(five.marks[worst[0]]), worst[1]) == (wrong, 0)
    assert np.abs(five.test_values[worst]) > 4.0
    assert four.redundancy == 0
    assert np.isnan(four.test_values).all()
    assert np.isnan(four.sigma0)


def test_redundancy_numbers_and_sums_agree_with_the_network():
    """The fit alone, and the same marks as observations of a network with a photo that is held."""
    rng = np.random.default_rng(3)
    marks = np.array([(x, y) for x in (-106.0, 0.0, 106.0) for y in (-106.0, 0.0, 106.0)])
    at = scanned(marks, **parameters_of("projective")) + SIGMA * rng.normal(size=marks.shape)
    fit = fit_marks(marks, at, transformation="projective", sigma=SIGMA)
    network = fga.Network("plate")
    free = TRANSFORMATIONS["projective"]
    network.add_camera("plate", FilmLens(), {"c": 150.0}, free=free, per_photo=True)
    network.add_photo("1", "plate", position=(0, 0, 0), omega_phi_kappa=(0, 0, 0), fixed=True)
    for i, (film, xy) in enumerate(zip(marks.tolist(), at.tolist(), strict=True)):
        place = {"film_x": film[0], "film_y": film[1]}
        network.add(fga.FiducialMark("1", f"{i}", tuple(xy), sigma=(SIGMA, SIGMA), **place))
    solution = fga.adjust(network)
    assert solution.redundancy == fit.redundancy == 10
    assert solution.sigma0 == pytest.approx(fit.sigma0, rel=1e-9)
    numbers = fga.reliability(solution).redundancy_numbers
    np.testing.assert_allclose(numbers, fit.redundancy_numbers.ravel(), rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("transformation", "marks", "says"),
    [
        ("affine", [(0, 0), (1, 1)], "needs 3 marks"),
        ("affine", [(0, 0), (1, 1), (2, 2), (3, 3)], "not all near one line"),
        ("bilinear", [(0, 0), (1, 0), (0, 1)], "needs 4 marks"),
        ("helmert", [(0, 0), (1, 0), (0, 1)], "conformal"),
    ],
)
def test_marks_that_determine_no_transformation_are_refused(transformation, marks, says):
    film = np.array(marks, dtype=float)
    with pytest.raises(InputError, match=says):
        fit_marks(film, film, transformation=transformation)


def test_an_unknown_patch_is_refused():
    with pytest.raises(InputError, match="valid: four, five"):
        film_coordinates(RESEAU, RESEAU, RESEAU, reseau="six", sigma_marks=SIGMA, sigma=SIGMA)


def test_points_outside_all_crosses_are_in_the_patch_at_the_edge():
    points = np.array([(104.0, 3.0), (-103.0, -105.0)])
    true = parameters_of("bilinear")
    at, seen = scanned(RESEAU, **true), scanned(points, **true)
    found = film_coordinates(RESEAU, at, seen, reseau="four", sigma_marks=SIGMA, sigma=SIGMA)
    np.testing.assert_allclose(found.xy, points, rtol=0, atol=1e-9)
    patches = [sorted(map(tuple, RESEAU[f.marks].tolist())) for f in found.fits]
    assert patches[0] == [(75.0, 0.0), (75.0, 25.0), (100.0, 0.0), (100.0, 25.0)]
    assert patches[1] == [(-100.0, -100.0), (-100.0, -75.0), (-75.0, -100.0), (-75.0, -75.0)]


def test_marks_in_another_camera_are_refused():
    network = fga.Network("digital")
    network.add_camera("C", fga.BrownLens(), {"c": 100.0}, free=("x0",))
    network.add_photo("1", "C", position=(0, 0, 0), omega_phi_kappa=(0, 0, 0), fixed=True)
    network.add(fga.FiducialMark("1", "A", (0.0, 0.0), film_x=1.0, film_y=1.0, sigma=(1, 1)))
    with pytest.raises(InputError, match="lens model 'film'"):
        fga.adjust(network)


def test_a_measurement_in_pixels_has_sigma_in_pixels_and_gives_that_of_the_film():
    pixels = 1000.0 / 15.0  # a millimetre
    points = np.array([(3.0, 4.0), (-88.0, 71.0)])
    true = parameters_of("affine")
    at, seen = scanned(RESEAU, **true), scanned(points, **true)
    by_unit = [
        film_coordinates(RESEAU, at * u, seen * u, sigma_marks=SIGMA * u, sigma=SIGMA * u)
        for u in (1.0, pixels)
    ]
    np.testing.assert_allclose(by_unit[1].xy, points, rtol=0, atol=1e-9)
    np.testing.assert_allclose(by_unit[1].sigmas, by_unit[0].sigmas, rtol=1e-9)


@pytest.mark.parametrize("shape", [slice(7), (slice(None), slice(1))])
def test_marks_without_a_measurement_are_refused(shape):
    with pytest.raises(InputError, match=r"of the same marks, \(n, 2\), not \(81, 2\) and \("):
        film_coordinates(RESEAU, RESEAU[shape], RESEAU[:2], sigma_marks=SIGMA, sigma=SIGMA)
    with pytest.raises(InputError, match="of the same marks"):
        fit_marks(RESEAU, RESEAU[shape])
