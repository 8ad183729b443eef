"""Comp3D: rotation axes, equal distances and heights, differences of coordinates, baselines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.survey.comp3d_grid import Comp3dOrigin
from factorgraph_adj.observations import CoordinateDifference, OnCircle
from tests.loaders import comp3d
from tests.support.places import data_dir

pytestmark = pytest.mark.published

ORIGIN = Comp3dOrigin(48.8)
"""Of the projects with a stereographic projection (their files ex_ref.comp)."""
NANOMETRE = 1e-9


def folder_of(name: str) -> Path:
    return data_dir("comp3d_frames") / name


# -- axes of rotation -----------------------------------------------------------------------------


def axes(*, radial: float = 1.0) -> fga.Network:
    """Return ``axe``: two axes, each with a target that was seen in four positions.

    Args:
        radial: what the standard deviations of radii are multiplied with.
    """
    network = fga.read_comp3d(folder_of("axe") / "ex_ref.comp", earth="ellipsoid")
    for ident, o in network.observations.items():
        assert isinstance(o, OnCircle) and o.sigma is not None
        axial, across = o.sigma
        network.observations[ident] = replace(o, sigma=(axial, radial * across))
    return network


def printed(name: str) -> dict:
    return comp3d.read_result(folder_of(name) / "ex_ref.comp")


def test_axes_of_rotation_fit_better_than_in_comp3d():
    """It has four unknowns more, and four observations that normalise its axes."""
    solution = fga.adjust(axes())
    theirs = printed("axe")["computation"]
    assert (solution.n_observations + 4, solution.n_unknowns + 4) == (44, 40)
    assert (theirs["nbr_active_obs"], theirs["nbr_parameters"]) == (44, 40)
    assert solution.converged
    assert theirs["all_sigma0"][-1] == pytest.approx(0.5919214814, abs=5e-11)
    assert solution.sigma0 < theirs["all_sigma0"][-1] - 2e-4


def test_comp3d_takes_the_partials_of_radii_twice():
    """Its residuals of radii are half as large as least squares make them.

    With v of a coordinate, σ 1 mm, and of the radius, σ 0.1 mm, the sum of squares is least where
    v/σ² is the same for both. It prints 0.2486 mm and 1.243 µm at A1, whose v/σ² differ by a factor
    of two: its steps halve what is left instead of removing it, twenty times. With half the
    variance of radii least squares stop where it does; the sum with the stated variances is then
    that which it approaches, by 7 10⁻⁷ in its last steps.
    """
    solution = fga.adjust(axes(radial=np.sqrt(0.5)))
    stated = fga.adjust(axes()).equations.sigmas()
    v = solution.observations.residuals / stated
    sigma0 = float(np.sqrt(v @ v / solution.redundancy))
    history = printed("axe")["computation"]["all_sigma0"]
    assert sigma0 == pytest.approx(history[-1], abs=2 * (history[-1] - history[-3]))
    for name, point in printed("axe")["points"].items():
        if name not in solution.network.points:
            continue
        cartesian = point["coord_compensated_cartesian"]
        np.testing.assert_allclose(solution.point(name), cartesian, rtol=0, atol=20 * NANOMETRE)
    a1 = printed("axe")["points"]["A1"]
    radius = next(
        o
        for s in printed("axe")["points"]["axe1"]["stations"]
        for o in s["observations"]
        if o["code"] == 181 and o["to"] == "A1"
    )
    of_coordinate = a1["shift_from_read"][0] / a1["sigmas_init"][0] ** 2
    of_radius = radius["residual"] / radius["sigma_total"] ** 2
    assert abs(of_coordinate / of_radius) == pytest.approx(2.0, abs=1e-3)


def test_an_axis_whose_targets_coincide_is_refused_by_name(tmp_path):
    """An axis of the project same_init_coords, which Comp3D does not adjust either."""
    folder = folder_of("same_init_coords")
    assert not printed("same_init_coords")["computation"]["compensation_done"]
    for name in ("coord.cor", "axev.axe"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "obs.obs").write_text("18 axe @axev.axe\n", encoding="utf-8")
    network = fga.read_comp3d(tmp_path / "obs.obs", latitude=48.8, earth="ellipsoid")
    with pytest.raises(fga.AdjustmentError, match="shape 'axe'"):
        fga.adjust(network)


def test_axes_that_intersect_in_a_point_are_refused_by_the_reader():
    with pytest.raises(fga.InputError, match=r"obs\.obs:6: axis 'axe' .* intersect"):
        fga.read_comp3d(folder_of("same_init_coords") / "ex_ref.comp")


# -- equal distances and heights ------------------------------------------------------------------


def test_equal_distances_and_heights_have_the_published_coordinates_and_sigmas():
    """A ladder of four equal steps, and four points at equal distances on a line (codes 21, 22).

    Comp3D has the common step and the common distance as unknowns. Its last residual is rounding,
    so that σ are compared relative to its σ0.
    """
    network = fga.read_comp3d(folder_of("eq_constr") / "ex_ref.comp", earth="ellipsoid")
    for name in (f"B{i}" for i in range(1, 6)):  # Comp3D takes points over the ladder for 1-D ones
        at = ORIGIN.on_ellipsoid(np.array([100.0, 100.0, 10.0]))
        network.points[name] = replace(
            network.points[name], coordinates=tuple(at.tolist()), fixed=(True, True, False)
        )
    solution = fga.adjust(network)
    computation = printed("eq_constr")["computation"]
    assert (solution.n_observations + 2, solution.n_unknowns + 2) == (21, 20)
    assert (computation["nbr_active_obs"], computation["nbr_parameters"]) == (21, 20)
    assert solution.sigma0 < 1e-4  # what the last step leaves
    for name, point in printed("eq_constr")["points"].items():
        expected = np.array(point["ellips"]["sigmas"]) / computation["sigma_0_final"]
        np.testing.assert_allclose(
            solution.standard_deviations(name), expected, rtol=5e-5, atol=1e-9
        )
        if name.startswith("A"):
            cartesian = point["coord_compensated_cartesian"]
            np.testing.assert_allclose(solution.point(name), cartesian, rtol=0, atol=10 * NANOMETRE)


# -- differences of coordinates -------------------------------------------------------------------


def test_centring_by_a_difference_of_coordinates():
    """ΔN = 0 ± 0.001 between points that differ by 1 m, and Δh = 0 (codes 9, 4)."""
    network = fga.read_comp3d(folder_of("centering") / "ex_ref.comp")
    solution = fga.adjust(network)
    theirs = printed("centering")
    assert (solution.n_observations, solution.n_unknowns) == (8, 6)
    assert solution.sigma0 == pytest.approx(theirs["computation"]["sigma_0_final"], rel=1e-9)
    for name, point in theirs["points"].items():
        expected = ORIGIN.to_cartesian(np.array(point["coord_compensated_georef"]))
        np.testing.assert_allclose(solution.point(name), expected, rtol=0, atol=1e-8)


def assert_as_in_lambert_93(folder: str, n: int, u: int, *, metres: float, relative: float) -> None:
    """Compare an adjusted project in Lambert-93 with what Comp3D prints: all points, σ, σ0."""
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    network = fga.read_comp3d(folder_of(folder) / "ex_ref.comp")
    solution = fga.adjust(network)
    theirs = printed(folder)
    computation = theirs["computation"]
    assert (solution.n_observations, solution.n_unknowns) == (n, u)
    assert (computation["nbr_active_obs"], computation["nbr_parameters"]) == (n, u)
    assert solution.sigma0 == pytest.approx(computation["sigma_0_final"], rel=relative)
    found = fga.grid_coordinates(solution)
    assert set(theirs["points"]) == set(network.points)
    for name, point in theirs["points"].items():
        cartesian, georef = (
            np.array(point[f"coord_compensated_{system}"]) for system in ("cartesian", "georef")
        )
        np.testing.assert_allclose(solution.point(name), cartesian, rtol=0, atol=10 * NANOMETRE)
        np.testing.assert_allclose(found.point(name), georef, rtol=0, atol=metres)
        if point["ellips"] is not None:
            sigmas = solution.sigma0 * solution.standard_deviations(name)
            np.testing.assert_allclose(sigmas, point["ellips"]["sigmas"], rtol=1e-5, atol=1e-7)


def test_a_square_in_lambert_93_with_a_point_centred_on_a_corner():
    """σ̂0 11.5456: the sides of the square are 115 mm per km longer than in the projection.

    The height of the centred point has the curvature of 100 m in it: 2.5e-7 of σ0.
    """
    assert_as_in_lambert_93("geo_mini_L93", 19, 15, metres=10 * NANOMETRE, relative=1e-6)


def test_baselines_with_covariances_and_height_differences():
    """Three vectors from a held point in Lambert-93; heights disagree on purpose.

    Grid coordinates at 5 km from the centre agree to 0.04 µm.
    """
    assert_as_in_lambert_93("baselines", 12, 9, metres=100 * NANOMETRE, relative=1e-6)


def test_a_difference_of_coordinates_is_that_of_a_levelled_frame():
    """The same centring as a frame whose north is given, in the horizon of a curved network."""
    given = fga.Network("two ways", frame=ORIGIN.frame)
    given.add_point("A", (8000.0, 5000.0, 60.0), fixed="xyz")
    given.add_point("B")
    difference = CoordinateDifference("A", "B", (1.0, 2.0, 0.5), horizon=True, sigma=0.001)
    by_difference, by_frame = given.copy(), given.copy()
    by_difference.add(difference)
    by_frame.add_frame("at A", free=(), origin="A", level=True)
    by_frame.add(
        fga.FrameCoordinate("at A", "B", difference.value, sigma=difference.sigma)  # type: ignore[arg-type]
    )
    a, b = (fga.adjust(n).point("B") for n in (by_difference, by_frame))
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)
    plain = given.copy()
    plain.add(replace(difference, horizon=False))
    assert np.abs(fga.adjust(plain).point("B") - a).max() > 1e-4
