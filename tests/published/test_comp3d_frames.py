"""Comp3D: sub-frames, levelled and free, centring, and points with a joint covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.survey.comp3d_grid import Comp3dOrigin
from factorgraph_adj.observations import FrameCoordinate
from tests.loaders import comp3d
from tests.support.places import data_dir

pytestmark = pytest.mark.published

ORIGIN = Comp3dOrigin(48.8)
"""Of all these projects (their files ex_ref.comp)."""
TEN_NANOMETRES = 1e-8
STOPPED = 5e-8
"""What Comp3D may leave in σ0: its last iteration changes it by 1.5e-8, and by less after it."""


@dataclass(frozen=True)
class Project:
    """A project with sub-frames, and what Comp3D prints for it."""

    folder: str
    result: str
    n: int
    u: int
    sigma0: float

    def network(self, earth="ellipsoid") -> fga.Network:
        """Return the network of the project."""
        return fga.read_comp3d(data_dir("comp3d_frames") / self.folder / self.result, earth=earth)

    def printed(self, coordinates: str) -> dict[str, np.ndarray]:
        """Return adjusted coordinates of the points from the result of Comp3D."""
        points = comp3d.read_result(data_dir("comp3d_frames") / self.folder / self.result)["points"]
        return {name: np.array(p[coordinates]) for name, p in points.items()}


CHANGE = Project("changement_de_repere", "ex_ref.comp", 816, 414, 1.6832661098)
LEVELLED = Project("bascule", "ex_ref.comp", 144, 98, 463.1069692648)
UNCERTAIN = Project("ex_basc_incertitude", "new.comp", 105, 53, 0.9830600923)


def assert_counts(solution: fga.Solution, project: Project) -> None:
    assert solution.converged
    assert (solution.n_observations, solution.n_unknowns) == (project.n, project.u)
    printed = comp3d.read_result(data_dir("comp3d_frames") / project.folder / project.result)
    assert printed["computation"]["all_sigma0"][-1] == pytest.approx(project.sigma0, abs=1e-10)


# -- a free sub-frame -----------------------------------------------------------------------------


def test_a_free_subframe_of_136_points_has_the_published_sigma0_and_coordinates():
    """Version 5.15, on the sphere. Its station has an approximate place only, its rotation none."""
    solution = fga.adjust(CHANGE.network("sphere"))
    assert_counts(solution, CHANGE)
    assert solution.sigma0 == pytest.approx(CHANGE.sigma0, abs=STOPPED)
    printed = CHANGE.printed("coord_compensated_stereographic")
    assert set(printed) == set(solution.network.points)
    errors = [solution.point(n) - ORIGIN.to_cartesian(x) for n, x in printed.items()]
    far = [n for n, x in printed.items() if abs(x[2]) > 100.0]
    assert far == ["17"]  # its residuals are those for which Comp3D would need one more iteration
    assert max(np.abs(e).max() for e in errors) < 10 * TEN_NANOMETRES
    assert np.sqrt(np.mean(np.square(errors))) < TEN_NANOMETRES


# -- levelled sub-frames --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def levelled() -> fga.Solution:
    return fga.adjust(LEVELLED.network())


def test_the_inverse_projection_gives_the_printed_cartesian_coordinates():
    """10 km high and 1.1 km from the origin, on the ellipsoid."""
    georef = LEVELLED.printed("coord_compensated_georef")
    for name, cartesian in LEVELLED.printed("coord_compensated_cartesian").items():
        found = ORIGIN.on_ellipsoid(georef[name])
        np.testing.assert_allclose(found, cartesian, rtol=0, atol=TEN_NANOMETRES)


def test_levelled_subframes_on_comp3ds_horizons_have_the_published_sigma0(levelled):
    """Five levelled sub-frames of 4 and one free of 6 unknowns; the residuals are gross on purpose.

    Half of the last of the digits 463.10697 that the description of the data states.
    """
    tilted = fga.adjust(comp3d.tilted_as_comp3d(levelled))
    assert_counts(tilted, LEVELLED)
    assert tilted.sigma0 == pytest.approx(LEVELLED.sigma0, abs=5e-6)
    for name, cartesian in LEVELLED.printed("coord_compensated_cartesian").items():
        np.testing.assert_allclose(tilted.point(name), cartesian, rtol=0, atol=1e-6)


def test_levelled_subframes_as_polar_observations(levelled):
    """Direction, zenith angle and distance instead of coordinates, which the weights make equal.

    What is left is the curvature of circles, the square of residuals over lengths: residuals are
    gross here, up to 0.16 m of 100 m, and σ0 is 463.10648 instead of 463.10697.
    """
    tilted = comp3d.tilted_as_comp3d(levelled)
    polar = fga.adjust(comp3d.as_polar(tilted))
    assert_counts(polar, LEVELLED)
    coordinates = fga.adjust(tilted)
    v = coordinates.equations.residuals(coordinates.state, whitened=False)
    bound = (np.abs(v).max() / 100.0) ** 2
    assert 1e-7 < bound < 1e-5
    assert polar.sigma0 == pytest.approx(LEVELLED.sigma0, rel=bound)
    for name in tilted.points:
        np.testing.assert_allclose(polar.point(name), coordinates.point(name), rtol=0, atol=1e-7)
    off = np.abs(polar.point_covariances - coordinates.point_covariances)
    # Standard deviations of angles follow from lengths that are 0.16 m off.
    assert off.max() < 4e-3 * coordinates.point_covariances.max()


def test_comp3d_tilts_horizons_to_the_east_by_the_longitude(levelled):
    """The printed R_global2instr of station 4, 1000 m east of the origin: Δλ, not Δλ cosφ."""
    points = comp3d.read_result(data_dir("comp3d_frames") / "bascule" / "ex_ref.comp")["points"]
    rotation = points["4"]["stations"][0]["params_rot"]["R_global2instr"]
    latitude, longitude = ORIGIN.geodetic(np.array(points["4"]["coord_compensated_georef"]))
    assert -rotation[2] == pytest.approx(longitude, rel=1e-6)
    tilt = levelled.network.frame.basis(levelled.point("4")[None], np.zeros((1, 2))).enu[0, 2, 0]
    assert tilt == pytest.approx(longitude * np.cos(latitude), rel=1e-6)


def test_true_horizons_fit_better(levelled):
    """The points lie at equal heights, and so do the coordinates in their sub-frames."""
    assert_counts(levelled, LEVELLED)
    assert levelled.sigma0 == pytest.approx(462.2413754, abs=1e-6)


# -- standard deviations by axis ------------------------------------------------------------------


def test_subframes_with_standard_deviations_by_axis():
    """Seven free sub-frames at two stations, a difference of heights between two bench marks.

    n: 30 coordinates of ten points, the heights of two, 72 in sub-frames, one difference; u: 30,
    two heights, 21 rotations. Most of vᵀPv is the difference, which misses by 7 σ ("for sigma0=1").
    Comp3D linearises before its last step, which turns a sub-frame by some 10⁻⁶: between axes with
    σ 0.0001 and 1.0001 that changes standard deviations by up to 1.2·10⁻⁴ of themselves.
    """
    solution = fga.adjust(UNCERTAIN.network())
    assert_counts(solution, UNCERTAIN)
    assert solution.sigma0 == pytest.approx(UNCERTAIN.sigma0, abs=STOPPED)
    for name, cartesian in UNCERTAIN.printed("coord_compensated_cartesian").items():
        np.testing.assert_allclose(solution.point(name), cartesian, rtol=0, atol=TEN_NANOMETRES)
    points = comp3d.read_result(data_dir("comp3d_frames") / UNCERTAIN.folder / UNCERTAIN.result)
    for name, point in points["points"].items():
        found = solution.sigma0 * solution.standard_deviations(name)
        np.testing.assert_allclose(found, point["ellips"]["sigmas"], rtol=2e-4, atol=1e-12)


# -- covariances of points, centring --------------------------------------------------------------


def test_points_with_a_joint_covariance():
    """The heights of A and B are correlated so closely that their difference has σ 0.01 m.

    The covariance is that of projected coordinates; its axes are turned by 2·10⁻⁵ on the ground.
    """
    folder = data_dir("comp3d_frames") / "corcov"
    network = fga.read_comp3d(folder / "ex_ref.comp", earth="ellipsoid")
    solution = fga.adjust(network)
    assert (solution.n_observations, solution.n_unknowns) == (7, 6)
    printed = comp3d.read_result(folder / "ex_ref.comp")
    assert solution.sigma0 == pytest.approx(printed["computation"]["sigma_0_final"], rel=1e-6)
    for name, point in printed["points"].items():
        expected = ORIGIN.on_ellipsoid(np.array(point["coord_compensated_georef"]))
        np.testing.assert_allclose(solution.point(name), expected, rtol=0, atol=1e-7)


def test_centring_is_a_levelled_frame_whose_north_is_given():
    """ΔN = 0 ± 0.001 between projected coordinates that differ by 1 m, and Δh = 0 (codes 9, 4).

    Both are y and z in a levelled frame at the first point; the curvature of 1 m is nothing.
    """
    folder = data_dir("comp3d_frames") / "centering"
    network = fga.read_comp3d(folder / "ex_ref.comp")
    network.observations.clear()
    network.add_frame("at 1a", free=(), origin="1a", level=True)
    sigma = (0.001, 0.001)
    network.add(FrameCoordinate("at 1a", "1b", (0.0, 0.0), axes="yz", sigma=sigma))
    solution = fga.adjust(network)
    printed = comp3d.read_result(folder / "ex_ref.comp")
    assert (solution.n_observations, solution.n_unknowns) == (8, 6)
    assert solution.sigma0 == pytest.approx(printed["computation"]["sigma_0_final"], rel=2e-5)
    for name, point in printed["points"].items():
        expected = ORIGIN.to_cartesian(np.array(point["coord_compensated_georef"]))
        np.testing.assert_allclose(solution.point(name), expected, rtol=0, atol=20e-6)


def test_a_subframe_whose_points_nothing_else_places_is_refused_by_name(tmp_path):
    """The project same_init_coords, which Comp3D does not adjust either."""
    folder = data_dir("comp3d_frames") / "same_init_coords"
    printed = comp3d.read_result(folder / "ex_ref.comp")["computation"]
    assert not printed["compensation_done"]
    observations = tmp_path / "obs.obs"
    observations.write_text("11 center_subframe @subframe.xyz\n", encoding="utf-8")
    (tmp_path / "subframe.xyz").write_bytes((folder / "origin" / "subframe.xyz").read_bytes())
    points = tmp_path / "points.cor"
    points.write_text("1 A 100 100 100 0 0 0\n", encoding="utf-8")
    network = fga.read_comp3d(observations, latitude=48.8, earth="ellipsoid")
    with pytest.raises(fga.AdjustmentError) as error:
        fga.adjust(network)
    for name in ("subframe", "center_subframe", "B1", "B2", "B3", "B4"):
        assert name in str(error.value)
