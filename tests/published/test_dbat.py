"""Blocks of the Damped Bundle Adjustment Toolbox (DBAT) against its reports.

An aerial block with weighted control and check points, the same with observed camera
positions, the calibration of a camera with four lens models, its degenerate variants, and 60
photos with 26 321 points. Standard deviations in the reports are a posteriori. No approximate
values are given that DBAT does not have: it finds photos by resection, points by intersection.

DBAT stops where a step changes the residuals by 1e-6 of their length at most. Where the
minimum is flat, what it prints to the last digit is not the minimum to the last digit; the
comparisons allow `UNFINISHED` of the standard deviation besides half of the last digit.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import DatumError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.network.network import Network
from factorgraph_adj.report.doubtful_results import listed_points_text
from factorgraph_adj.solve.estimates import CalibrationEstimate
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.start.approximate_values import approximate
from factorgraph_adj.types import Array
from tests.networks.dbat import (
    CAMCAL,
    ROMA,
    read_camcal,
    read_camcal_export,
    read_roma,
    read_sxb,
)
from tests.support.attitude import covariance_of_angles
from tests.support.dbat_report import Printed, Report, read_report
from tests.support.places import data_dir

pytestmark = [
    pytest.mark.published,
    pytest.mark.slow(
        "real blocks of up to 60 photos with many calibrations; "
        "short tests adjust the smaller AICON block"
    ),
]

LABELS = {
    "c": "Camera Constant",
    "x0": "px",
    "y0": "py",
    "k1": "K1",
    "k2": "K2",
    "k3": "K3",
    "p1": "P1",
    "p2": "P2",
    "b1": "as",
}
"""DBAT's labels of our calibration parameters."""
DOWN = {"y0": -1.0}
"""DBAT's py points down."""
POSE = ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc")
UNFINISHED = 1e-3
"""Part of σ by which DBAT's result may be short of the minimum."""
SIGMA_UNFINISHED = 1e-5
"""The same for σ itself, relative."""

adjusted = partial(adjust, variance="a-posteriori")


def pose_and_sigmas(solution: Solution, photo: str) -> tuple[Array, Array]:
    """Return ω, φ, κ (degrees), X0, Y0, Z0 and their standard deviations."""
    pose = solution.pose(photo)
    covariance = covariance_of_angles(pose.rotation, solution.pose_covariance(photo))
    unit = np.array([180 / np.pi] * 3 + [1.0] * 3)
    values = np.concatenate([pose.omega_phi_kappa, pose.position])
    return unit * values, unit * np.sqrt(np.diag(covariance))


def check_figures(solution: Solution, report: Report) -> None:
    """Check counts, √vᵀPv and σ̂0."""
    assert solution.converged, solution.reason
    assert solution.n_observations == report.n_observations
    assert solution.n_unknowns == report.n_unknowns
    assert solution.redundancy == report.redundancy
    assert np.sqrt(solution.vtpv) == pytest.approx(
        report.last_error.value, abs=report.last_error.half
    )
    assert solution.sigma0 == pytest.approx(report.sigma0.value, abs=report.sigma0.half)


def check_value(ours: float, sigma: float, value: Printed, deviation: Printed | None) -> None:
    """Check an estimate and its standard deviation; no deviation is printed where it is held."""
    assert abs(ours - value.value) <= value.half + UNFINISHED * sigma
    if deviation is None:
        assert sigma == 0.0
    else:
        assert abs(sigma - deviation.value) <= deviation.half + SIGMA_UNFINISHED * sigma


def check_calibration(estimate: CalibrationEstimate, report: Report) -> None:
    """Check every calibration parameter."""
    for name in estimate.names:
        if name in LABELS:
            value, deviation = report.calibration[LABELS[name]]
            ours = DOWN.get(name, 1.0) * estimate[name]
            check_value(ours, estimate.sigma(name), value, deviation)


def check_photos(solution: Solution, report: Report) -> None:
    """Check exterior orientation and standard deviations of all photos."""
    assert len(report.photos) == len(solution.network.photos)
    for photo, printed in report.photos.items():
        values, sigmas = pose_and_sigmas(solution, photo)
        for label, ours, sigma in zip(POSE, values, sigmas, strict=True):
            value, deviation = printed[label]
            around = 360.0 if label in POSE[:3] else np.inf
            turns = round((ours - value.value) / around) if np.isfinite(around) else 0
            check_value(ours - (turns * around if turns else 0.0), sigma, value, deviation)


# -- aerial block ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sxb_folder() -> Path:
    return data_dir("dbat_sxb")


@pytest.fixture(scope="module")
def sxb_report(sxb_folder: Path) -> Report:
    return read_report(sxb_folder / "result/report.txt")


@pytest.fixture(scope="module")
def sxb(sxb_folder: Path) -> Solution:
    return adjusted(read_sxb(sxb_folder))


def test_the_aerial_block_has_the_published_figures(sxb: Solution, sxb_report: Report) -> None:
    check_figures(sxb, sxb_report)
    assert sxb.sigma0 == pytest.approx(1.17860, abs=0.5e-5)
    assert np.sqrt(sxb.vtpv) == pytest.approx(41.8527, abs=0.5e-4)
    assert (sxb.n_observations, sxb.n_unknowns, sxb.redundancy) == (2434, 1173, 1261)


def test_the_aerial_photos_have_the_published_orientation(
    sxb: Solution, sxb_report: Report
) -> None:
    check_photos(sxb, sxb_report)


def test_nadir_photos_cannot_tell_a_tilt_from_a_shift(sxb: Solution) -> None:
    """ρ(ω, Y0) = −1.000, ρ(φ, X0) = 0.999 in the report on photo 1."""
    covariance = covariance_of_angles(sxb.pose("1").rotation, sxb.pose_covariance("1"))
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    assert correlation[0, 4] == pytest.approx(-1.000, abs=0.5e-3)
    assert correlation[1, 3] == pytest.approx(0.999, abs=0.5e-3)


def test_control_and_check_points_have_the_published_coordinates(
    sxb: Solution, sxb_report: Report
) -> None:
    assert len(sxb_report.points) == 16
    for name, (values, deviations) in sxb_report.points.items():
        sigmas = sxb.standard_deviations(name)
        for i in range(3):
            check_value(sxb.point(name)[i], sigmas[i], values[i], deviations[i])


@pytest.mark.parametrize(
    ("name", "difference", "sigma"),
    [
        ("351", (0.167, 0.008, -0.459), (0.0551, 0.0347, 0.240)),
        ("410", (0.096, -0.296, 0.136), (0.0345, 0.0356, 0.180)),
    ],
)
def test_check_points_differ_as_published(
    sxb: Solution, name: str, difference: tuple[float, ...], sigma: tuple[float, ...]
) -> None:
    check = sxb.network.points[name].check
    assert check is not None
    assert sxb.point(name) - check == pytest.approx(difference, abs=0.5e-3)
    halves = [Printed.significant(str(s), 3).half for s in sigma]
    assert np.all(np.abs(sxb.standard_deviations(name) - sigma) <= halves)


def test_the_largest_image_residual_is_the_published_one(sxb: Solution) -> None:
    """2.729 pixels of 6 µm: point 563 on photo 5."""
    block = next(b for b in sxb.equations.blocks if b.kind == "image")
    v = np.linalg.norm(sxb.observations.residuals[block.rows].reshape(-1, 2), axis=1)
    assert block.ids[int(np.argmax(v))] == "5/563"
    assert v.max() / 0.006 == pytest.approx(2.729, abs=0.5e-3)


def test_observed_camera_positions_give_the_published_figures(sxb_folder: Path) -> None:
    report = read_report(sxb_folder / "prague2016/dbatexports/sxb-prior-eo-dbatreport.txt")
    solution = adjusted(read_sxb(sxb_folder, camera_positions=True))
    check_figures(solution, report)
    check_photos(solution, report)
    assert solution.sigma0 == pytest.approx(1.06942, abs=0.5e-5)
    assert np.sqrt(solution.vtpv) == pytest.approx(38.2458, abs=0.5e-4)
    assert solution.redundancy == 1279


# -- camera calibration ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def camcal_folder() -> Path:
    return data_dir("dbat_camcal")


@pytest.mark.parametrize(
    ("model", "sigma0", "c"),
    [
        (3, 1.6148043, 7.456995),
        (4, 1.6124744, 7.457019),
        (1, 1.6890076, 7.457396),
        (-1, 1.6216815, 7.457482),
    ],
)
def test_every_lens_model_gives_the_published_calibration(
    camcal_folder: Path, model: int, sigma0: float, c: float
) -> None:
    """σ̂0 and c to more digits than the reports print are those of an independent computation."""
    report = read_report(camcal_folder / f"dbat/dbatexports/camcal-dbatreport-model{model}.txt")
    solution = adjusted(read_camcal(camcal_folder, model=model))
    check_figures(solution, report)
    check_calibration(solution.calibration(CAMCAL), report)
    check_photos(solution, report)
    assert solution.sigma0 == pytest.approx(sigma0, abs=0.5e-7)
    assert solution.calibration(CAMCAL)["c"] == pytest.approx(c, abs=0.5e-6)


def test_radial_terms_are_correlated_as_published(camcal_folder: Path) -> None:
    estimate = adjusted(read_camcal(camcal_folder)).calibration(CAMCAL)
    k2, k3 = estimate.names.index("k2"), estimate.names.index("k3")
    assert estimate.correlation[k2, k3] == pytest.approx(-0.979, abs=0.5e-3)


def test_weighted_control_gives_the_independent_result(camcal_folder: Path) -> None:
    """Not a case of DBAT's: an independent computation has σ̂0 1.4253694, c 7.4568929."""
    solution = adjust(read_camcal(camcal_folder, control="weighted"))
    assert solution.converged, solution.reason
    assert (solution.n_observations, solution.n_unknowns) == (4160, 435)
    assert solution.sigma0 == pytest.approx(1.4253694, abs=0.5e-7)
    assert solution.calibration(CAMCAL)["c"] == pytest.approx(7.4568929, abs=0.5e-7)


def test_five_photos_of_ten_points_give_the_published_result(camcal_folder: Path) -> None:
    report = read_report(camcal_folder / "dbat/dbatexports/camcal-dbatreport5.txt")
    solution = adjusted(read_camcal_export(camcal_folder, "5"))
    check_figures(solution, report)
    check_calibration(solution.calibration(CAMCAL), report)
    check_photos(solution, report)
    assert solution.sigma0 == pytest.approx(2.80749, abs=0.5e-5)


def refusal(network: Network) -> DatumError:
    with pytest.raises(DatumError) as error:
        adjust(network)
    return error.value


def test_a_block_without_control_is_refused_and_lacks_all_seven(camcal_folder: Path) -> None:
    """DBAT: numerical rank 428 of 435, deficiency 7."""
    error = refusal(read_camcal_export(camcal_folder, "", control=False))
    assert error.defect == 7
    for missing in ("shift in x", "shift in y", "shift in z", "scale", "free network"):
        assert missing in str(error)
    for axis in "xyz":
        assert f"rotation about {axis}" in str(error)


def test_the_same_block_as_a_free_network_has_the_same_redundancy(camcal_folder: Path) -> None:
    solution = adjust(read_camcal_export(camcal_folder, "", control=False), datum="free")
    assert solution.converged, solution.reason
    assert solution.datum_defect == 7
    assert solution.redundancy == 4148 - 435 + 7


def test_points_without_any_observation_are_no_unknowns_and_named(camcal_folder: Path) -> None:
    """DBAT: structural deficiency 6, points 13 and 60. Here they stay as the list states them."""
    network = read_camcal_export(camcal_folder, "-missing-obs")
    solution = adjust(network)
    assert set(solution.network.listed_points) == {"13", "60"}
    (told,) = listed_points_text(solution.network)
    assert "13" in told and "60" in told
    alone = adjust(without(network, (), points=["13", "60"]))
    assert solution.vtpv == pytest.approx(alone.vtpv, rel=1e-12)
    assert solution.redundancy == alone.redundancy


def test_a_point_with_one_ray_is_refused_by_name(camcal_folder: Path) -> None:
    """DBAT: structural deficiency 1, point 88."""
    error = refusal(read_camcal_export(camcal_folder, "-1ray"))
    assert error.defect == 1
    assert error.names == ("88",)
    assert "'88'" in str(error) and "1 image ray" in str(error)


# -- 60 photos, 26 321 points ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def roma_folder() -> Path:
    return data_dir("dbat_roma")


@pytest.fixture(scope="module")
def roma(roma_folder: Path) -> Solution:
    return adjusted(read_roma(roma_folder))


def test_roma_begins_where_dbat_begins(roma_folder: Path) -> None:
    """DBAT intersects rays by least squares of the distances from them: √vᵀPv 8641.39."""
    equations = compile_network(read_roma(roma_folder))
    v = equations.residuals(approximate(equations))
    assert np.sqrt(v @ v) == pytest.approx(8641.39, abs=0.5e-2)


def test_roma_has_the_published_figures(roma: Solution, roma_folder: Path) -> None:
    check_figures(roma, read_report(roma_folder / "result/report.txt"))
    assert (roma.n_observations, roma.n_unknowns, roma.redundancy) == (181122, 79321, 101801)
    assert roma.datum_defect == 0
    assert np.sqrt(roma.vtpv) == pytest.approx(185.940, abs=0.5e-3)
    assert roma.sigma0 == pytest.approx(0.582769, abs=0.5e-6)


def test_roma_has_the_published_calibration(roma: Solution, roma_folder: Path) -> None:
    check_calibration(roma.calibration(ROMA), read_report(roma_folder / "result/report.txt"))


def test_all_photos_of_roma_have_the_published_orientation(
    roma: Solution, roma_folder: Path
) -> None:
    """Photo 1 is held, and Y of photo 19: those have no standard deviation."""
    check_photos(roma, read_report(roma_folder / "result/report.txt"))
    assert roma.pose("19").sigmas[4] == 0.0
    assert np.all(roma.pose("1").sigmas == 0.0)


@pytest.mark.parametrize(
    ("calibrated", "values", "report"),
    [
        ((), {"b1": 0.000998889}, "roma-dbatreport.txt"),
        (
            ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2", "b1"),
            {},
            "roma-dbatreport-selfcal.txt",
        ),
    ],
)
def test_roma_with_other_calibrations_has_the_published_figures(
    roma_folder: Path, calibrated: tuple[str, ...], values: dict[str, float], report: str
) -> None:
    """The held camera has an affinity there that the camera's file does not have."""
    solution = adjusted(read_roma(roma_folder, calibrated=calibrated, values=values))
    check_figures(solution, read_report(roma_folder / "dbat" / report))
