"""Ebner's 12 and Grün's 44 parameters: published form, orthogonality, and aerial blocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.lens import BrownLens, Lens, NoDistortion
from factorgraph_adj.models.orthogonal_lens import (
    EbnerLens,
    GruenLens,
    OrthogonalLens,
    gram_polynomials,
)
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, PhotoPosition
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.types import Array

MICROMETRE = 1e-3
"""In mm, the image unit here."""

# -- the sets as published ------------------------------------------------------------------------


def correction(lens: OrthogonalLens, parameters: Mapping[str, float], x: Array, y: Array) -> Array:
    """Return dV (n, 2) at image coordinates relative to the principal point."""
    k = np.array([[100.0, 0.0, 0.0, *(parameters.get(n, 0.0) for n in lens.names[3:])]])
    zero = np.zeros_like(x)
    v, _, _ = lens.residual(zero, zero, np.stack([x, y], 1), k, jacobians=False)
    return -v - np.stack([x, y], 1)


def normalised(lens: OrthogonalLens, published: Mapping[str, float]) -> dict[str, float]:
    """Return our parameters for published coefficients: times b^degree."""
    return {n: a * lens.image_base ** lens.degree_of(n) for n, a in published.items()}


image_positions = st.tuples(st.floats(-115.0, 115.0), st.floats(-115.0, 115.0))
bases = st.floats(40.0, 120.0)


@given(image_positions, bases, st.integers(0, 2**32 - 1))
def test_ebners_set_is_the_published_one_term_by_term(
    at: tuple[float, float], b: float, seed: int
) -> None:
    x, y = at
    lens = EbnerLens(image_base=b, residuals="ideal")
    degrees = [1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4]
    assert [lens.degree_of(f"b{i + 1}") for i in range(12)] == degrees
    c = np.random.default_rng(seed).normal(size=12) / b ** np.array(degrees)
    b1, b2, b3, b4, b5, b6, b7, b8, b9, b10, b11, b12 = c
    square, four = 2 * b**2 / 3, 4 * b**2 / 3
    dx = b1 * x + b2 * y - b3 * (2 * x**2 - four) + b4 * x * y + b5 * (y**2 - square)
    dx += b7 * x * (y**2 - square) + b9 * y * (x**2 - square)
    dx += b11 * (x**2 - square) * (y**2 - square)
    dy = -b1 * y + b2 * x + b3 * x * y - b4 * (2 * y**2 - four) + b6 * (x**2 - square)
    dy += b8 * y * (x**2 - square) + b10 * x * (y**2 - square)
    dy += b12 * (x**2 - square) * (y**2 - square)
    ours = normalised(lens, {f"b{i + 1}": a for i, a in enumerate(c.tolist())})
    found = correction(lens, ours, np.array([x]), np.array([y]))[0]
    np.testing.assert_allclose(found, [dx, dy], atol=1e-10)


@given(image_positions, bases, st.integers(0, 2**32 - 1))
def test_gruens_set_is_made_of_his_polynomials(
    at: tuple[float, float], b: float, seed: int
) -> None:
    """Written out with the polynomials and fractions of the 5 × 5 grid, degree by degree."""
    x, y = at
    k, el = x**2 - b**2 / 2, y**2 - b**2 / 2
    p, q = x * (x**2 - 17 / 20 * b**2), y * (y**2 - 17 / 20 * b**2)
    r = x**2 * (x**2 - 31 / 28 * b**2) + 9 / 70 * b**4
    s = y**2 * (y**2 - 31 / 28 * b**2) + 9 / 70 * b**4
    alone = {
        **{"14": p, "23": y * k, "32": x * el, "41": q},
        **{"15": r, "24": y * p, "33": k * el, "42": x * q, "51": s},
        **{"25": y * r, "34": el * p, "43": k * q, "52": x * s},
        **{"35": el * r, "44": p * q, "53": k * s},
        **{"45": q * r, "54": p * s},
        "55": r * s,
    }
    effects = {
        "a12": (x, -y),
        "a21": (y, x),
        "a22": (x * y, -10 / 7 * el),
        "b22": (-10 / 7 * k, x * y),
        "a31": (el, 0.0),
        "b13": (0.0, k),
        **{f"a{i}": (value, 0.0) for i, value in alone.items()},
        **{f"b{i}": (0.0, value) for i, value in alone.items()},
    }
    lens = GruenLens(image_base=b, residuals="ideal")
    assert set(effects) == set(lens.names[3:])
    rng = np.random.default_rng(seed)
    published = {n: rng.normal() / b ** (int(n[1]) + int(n[2]) - 2) for n in effects}
    expected = sum(published[n] * np.array(effects[n]) for n in effects)
    found = correction(lens, normalised(lens, published), np.array([x]), np.array([y]))[0]
    np.testing.assert_allclose(found, expected, atol=1e-10)


# -- orthogonality --------------------------------------------------------------------------------

SETS: dict[str, tuple[Callable[..., OrthogonalLens], int, int]] = {
    "ebner": (EbnerLens, 3, 12),
    "gruen": (GruenLens, 5, 44),
}
"""Lens, points of the grid along a side, number of parameters."""


def columns(lens: OrthogonalLens, x: Array, y: Array) -> Array:
    """Return the effects of all parameters at points, (2 n, parameters)."""
    return np.stack([correction(lens, {n: 1.0}, x, y).ravel() for n in lens.names[3:]], 1)


@pytest.mark.parametrize("name", SETS)
def test_the_parameters_are_orthogonal_over_their_grid_to_one_another_and_to_the_orientation(
    name: str,
) -> None:
    """The six: two shifts, scale, rotation, and the effects of two tilts less their means."""
    make, side, number = SETS[name]
    b = 85.0
    lens = make(image_base=b, residuals="ideal")
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-b, b, side)] * 2))
    one, zero = np.ones_like(x), np.zeros_like(x)
    tilt = x * x - np.mean(x * x), y * y - np.mean(y * y)
    six = [(one, zero), (zero, one), (x, y), (-y, x), (tilt[0], x * y), (x * y, tilt[1])]
    a = columns(lens, x, y)
    everything = np.column_stack([a, *(np.stack(e, 1).ravel() for e in six)])
    length = np.linalg.norm(everything, axis=0)
    cosines = everything.T @ everything / np.outer(length, length)
    assert a.shape[1] == number
    assert np.abs(cosines - np.eye(number + 6)).max() < 1e-12
    # Together they take any correction of the points of the grid.
    assert number + 6 == 2 * side**2


@pytest.mark.parametrize("m", [2, 3, 4, 6])
def test_gram_polynomials_are_orthogonal_over_equidistant_points_and_lead_with_one(m: int) -> None:
    t = np.linspace(-1.0, 1.0, m + 1)
    p, _ = gram_polynomials(t, m)
    gram = p @ p.T
    assert np.abs(gram - np.diag(np.diag(gram))).max() < 1e-12
    for degree, values in enumerate(p):
        assert np.polyfit(t, values, m)[m - degree] == pytest.approx(1.0)


@pytest.mark.parametrize("name", SETS)
def test_parameters_change_with_the_unit_of_the_image_as_its_coordinates_do(name: str) -> None:
    make, *_ = SETS[name]
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-100.0, 100.0, (2, 20))
    values = dict(zip(make().names[3:], rng.normal(size=44), strict=False))
    pixels = 125.0
    in_mm = correction(make(image_base=92.0), values, x, y)
    in_px = correction(
        make(image_base=92.0 * pixels),
        {n: pixels * v for n, v in values.items()},
        pixels * x,
        pixels * y,
    )
    np.testing.assert_allclose(in_px, pixels * in_mm, rtol=1e-12)


@pytest.mark.parametrize("base", [0.0, -92.0, np.nan, np.inf])
def test_an_image_base_that_is_no_length_is_refused(base: float) -> None:
    with pytest.raises(InputError, match="image_base must be positive, not"):
        EbnerLens(image_base=base)


# -- aerial blocks --------------------------------------------------------------------------------

BASE = 92.0
"""Image base, mm: 60 % overlap of 23 cm photos."""
FOCAL, SCALE = 153.0, 5000.0
"""Principal distance, mm, and scale number of the photos."""
SIGMA_IMAGE = 4 * MICROMETRE
INTERIOR = {"c": FOCAL, "x0": 0.012, "y0": -0.021}


def aerial_plan(lens: Lens, parameters: Mapping[str, float]) -> Network:
    """Return five strips of five photos of flat ground, 60 % overlap along and across.

    Points lie BASE/4 apart in the image; twelve of them are control; the positions of the photos
    are measured; every other photo is turned by 90°, as in cross strips. The interior orientation
    is held, the additional parameters are free.
    """
    network = Network("aerial block")
    metres = 1e-3 * SCALE
    base = BASE * metres
    rng = np.random.default_rng(44)
    network.add_camera("camera", lens, {**INTERIOR, **parameters}, free=lens.names[3:])
    along = np.arange(-4, 21) * base / 4
    ground = np.stack([*np.meshgrid(along, along), rng.normal(0.0, 10.0, (25, 25))], 2)
    ground = ground.reshape(-1, 3)
    names = [f"P{i}" for i in range(len(ground))]
    seen: dict[str, Array] = {}
    for strip in range(5):
        for k in range(5):
            photo = f"{strip}.{k}"
            centre = np.array([k * base, strip * base, FOCAL * metres]) + rng.normal(0.0, 8.0, 3)
            omega, phi, kappa = rng.normal(0.0, np.deg2rad(1.0), 3)
            kappa += np.pi * (strip % 2) + np.pi / 2 * ((strip + k) % 2)
            rotation = world_R_camera(omega, phi, kappa)
            network.add_photo(photo, "camera", position=centre.tolist(), rotation=rotation)
            p = (ground - centre) @ rotation
            seen[photo] = np.abs(FOCAL * p[:, :2] / p[:, 2:]).max(axis=1) < 1.1 * BASE
    used = np.sum(list(seen.values()), axis=0) >= 2
    for i in np.flatnonzero(used):
        network.add_point(names[i], ground[i], check=ground[i])
    for photo, inside in seen.items():
        chosen = [names[i] for i in np.flatnonzero(used & inside)]
        network.add_image_points(photo, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE)
        network.add(PhotoPosition(photo, (0.0, 0.0, 0.0), sigma=(0.05, 0.05, 0.05)))
    for i in np.flatnonzero(used)[:: used.sum() // 12]:
        network.add(ControlPoint(names[i], tuple(ground[i].tolist()), sigma=(0.01, 0.01, 0.01)))
    return network


def with_lens(network: Network, lens: Lens, *, interior: tuple[str, ...] = ()) -> Network:
    """Return the network with another lens, its additional parameters and ``interior`` free."""
    other = network.copy()
    del other.cameras["camera"]
    other.add_camera("camera", lens, INTERIOR, free=(*interior, *lens.names[3:]))
    return other


@pytest.mark.parametrize("name", SETS)
def test_known_parameters_of_an_aerial_block_are_recovered_within_their_precision(
    name: str,
) -> None:
    """dᵀ Σ⁻¹ d of the parameters is χ² with as many degrees of freedom: inside 0.1 to 99.9 %."""
    make, _, number = SETS[name]
    lens = make(image_base=BASE)
    rng = np.random.default_rng(12)
    true = dict(zip(lens.names[3:], rng.normal(0.0, 15 * MICROMETRE, number), strict=True))
    measured = measure(aerial_plan(lens, true), seed=1)
    solution = adjust(with_lens(disturb(measured, seed=1, points=0.5, centres=0.5), lens))
    assert solution.converged, solution.reason
    estimate = solution.calibration("camera")
    off = estimate.values[3:] - np.array(list(true.values()))
    covariance = solution.variable_covariance(("calibration", "camera"))[3:, 3:]
    low, high = chi2.ppf([0.001, 0.999], number)
    assert low < off @ np.linalg.solve(covariance, off) < high


def test_an_affine_deformation_is_two_parameters_of_ebners_set() -> None:
    """Affinity and shear b1 x + b2 y in x alone are half a scale and half a rotation besides.

    Scale and rotation go into flying height and kappa; with the heights of the photos measured,
    what is left in them is the scale times the principal distance.
    """
    b1, b2 = 2e-4, -1.5e-4
    brown = BrownLens()
    plan = aerial_plan(brown, {"b1": b1, "b2": b2})
    lens = EbnerLens(image_base=BASE)
    network = with_lens(measure(plan, seed=3), lens, interior=("c",))
    estimate = adjust(network).calibration("camera")
    expected = {"c": FOCAL / (1 + b1 / 2), "b1": BASE * b1 / 2, "b2": BASE * b2 / 2}
    assert estimate.sigma("c") < 0.2 * FOCAL * b1 / 2
    for parameter, value in expected.items():
        assert abs(estimate[parameter] - value) < 4 * estimate.sigma(parameter), parameter
    rest = [n for n in lens.names[3:] if n not in expected]
    assert max(abs(estimate[n]) / estimate.sigma(n) for n in rest) < 4


def smooth(xy: Array) -> Array:
    """Return a deformation of no polynomial form, (n, 2) mm: waves of film and a bent lens."""
    x, y = (xy / BASE).T
    wave = np.sin(1.4 * x + 0.9 * y + 0.3), np.cos(1.2 * x - 1.6 * y)
    bend = np.exp(-(x**2 + y**2) / 2)
    return 20 * MICROMETRE * np.stack([wave[0] + x * bend, wave[1] + y * bend], 1)


def test_the_sets_take_a_smooth_deformation_that_they_do_not_contain() -> None:
    """20 µm waves against σ = 4 µm: VᵀPv/r, and the errors of coordinates of tie points.

    Ebner's set takes nine tenths of what the deformation adds to σ̂0²; Grün's leaves less than
    the standard deviation √(2/r) of σ̂0², and the points as good as without deformation.
    """
    plan = aerial_plan(NoDistortion(), {})
    network = measure(plan, seed=5)
    photo, point, xy, sigma = network.images.columns()
    deformed = network.copy()
    deformed.images = type(network.images)()
    deformed.images.append(photo, point, xy - smooth(xy), sigma)
    controlled = {o.point for o in plan.observations.values() if isinstance(o, ControlPoint)}
    variance, error, redundancy = {}, {}, 0
    cases: dict[str, tuple[Network, Lens]] = {
        "gruen": (deformed, GruenLens(image_base=BASE)),
        "ebner": (deformed, EbnerLens(image_base=BASE)),
        "none": (deformed, NoDistortion()),
        "not deformed": (network, NoDistortion()),
    }
    for case, (measured, lens) in cases.items():
        solution = adjust(with_lens(measured, lens, interior=("c", "x0", "y0")))
        assert solution.converged, solution.reason
        variance[case], redundancy = solution.sigma0**2, solution.redundancy
        off = [
            solution.point(n) - np.array(p.check)
            for n, p in plan.points.items()
            if n not in controlled
        ]
        error[case] = float(np.sqrt(np.mean(np.square(off))))
    added = {case: v - variance["not deformed"] for case, v in variance.items()}
    assert variance["none"] > 4.0
    assert added["ebner"] < 0.1 * added["none"]
    assert abs(added["gruen"]) < np.sqrt(2 / redundancy)
    assert error["none"] > 3 * error["not deformed"]
    assert error["gruen"] < 1.05 * error["not deformed"] < error["ebner"] < 0.5 * error["none"]
