"""A GNSS network with full and cluster covariances against DynAdjust's listing.

The listing's column "Measured" is not the measurement file: baselines of ITRF2008 and ITRF2014
are transformed to GDA2020 first, by up to 2 mm: those of ITRF2008 by way of GDA94 (Dawson and
Woods), those of ITRF2014 with the plate motion model of Australia. `read_dynaml` does the same with
``reference_frames="by GDA94"``: every value is that of the column within its rounding, and vᵀPv is
the published 336.64. By way of ITRF2014, as the GDA2020 manual has it, it is 337.28, and without a
transformation 335.45. From the printed column, rounded to 0.1 mm, it is 336.76; the rounding alone
moves it by ±0.7 (weights reach 1/(0.6 mm)²).
"Rigorous Sigma Zero" is vᵀPv/r, the square of σ̂0.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.adjustment import adjust
from factorgraph_adj.graph.equations import Equations
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array
from tests.loaders.dynadjust import Measurement, Station, read_listing
from tests.support.places import data_dir

pytestmark = pytest.mark.published

FRAME = fga.GeocentricFrame("GRS80")
PRINTED = 0.5e-4
"""Half of the last printed digit, metres."""
ROUNDED = 1e-4 / np.sqrt(12.0)
"""Standard deviation of a number rounded to 0.1 mm, metres."""
CHI_SQUARED = 336.64
"""Published."""


@pytest.fixture(scope="module")
def folder() -> Path:
    return data_dir("dynadjust_gnss")


@pytest.fixture(scope="module")
def listing(folder: Path) -> tuple[list[Measurement], dict[str, Station]]:
    return read_listing(folder / "gnss.simult.adj.expected")


@pytest.fixture(scope="module")
def measurements(listing: tuple[list[Measurement], dict[str, Station]]) -> list[Measurement]:
    return listing[0]


@pytest.fixture(scope="module")
def stations(listing: tuple[list[Measurement], dict[str, Station]]) -> dict[str, Station]:
    return listing[1]


STATIONS = "gnss-networkstn.xml"


@pytest.fixture(scope="module")
def solution(folder: Path) -> Solution:
    """The network with the values that DynAdjust adjusted."""
    return adjust(fga.read_dynaml(folder / STATIONS, reference_frames="by GDA94"))


def weights(equations: Equations) -> Array:
    """Return P over all rows, (417, 417)."""
    w = np.zeros((equations.n_rows, equations.n_rows))
    for block in equations.blocks:
        for i in range(block.n if block.whitener is not None else 0):
            own = slice(block.first_row + 3 * i, block.first_row + 3 * i + 3)
            w[own, own] = block.whitener[i]
    for cluster in equations.clusters:
        w[cluster.rows] = 0.0
        w[np.ix_(cluster.rows, cluster.rows)] = cluster.whitener
    return np.asarray(w.T @ w)


def test_columns_have_the_network_of_the_elements(folder: Path) -> None:
    """gnss-network.stn and .msr are the files of DynAdjust from which its DynaML was written."""
    options = {"reference_frames": "by GDA94"}
    columns = fga.read(folder / "gnss-network.stn", **options)
    elements = fga.read(folder / STATIONS, **options)
    assert list(columns.points) == list(elements.points)
    for a, b in zip(columns.observations.values(), elements.observations.values(), strict=True):
        assert (a.kind, a.names()) == (b.kind, b.names())
        np.testing.assert_array_equal(a.value, b.value)  # type: ignore[attr-defined]
    assert adjust(columns).vtpv == pytest.approx(CHI_SQUARED, abs=0.005)


def test_everything_of_the_listing_is_read(
    measurements: list[Measurement], stations: dict[str, Station]
) -> None:
    assert [sum(m.kind == kind for m in measurements) for kind in "GXY"] == [129, 4, 6]
    assert len(stations) == 43


def test_counts_are_dynadjusts(solution: Solution) -> None:
    assert solution.converged
    assert (solution.n_observations, solution.n_unknowns) == (417, 129)
    assert (solution.redundancy, solution.datum_defect) == (288, 0)


def test_measurements_are_transformed_as_by_dynadjust(
    solution: Solution, measurements: list[Measurement]
) -> None:
    for o, m in zip(solution.network.observations.values(), measurements, strict=True):
        np.testing.assert_allclose(o.value, m.measured, rtol=0, atol=1.001 * PRINTED)  # type: ignore[attr-defined]


def test_sum_of_squares_is_the_published_one(solution: Solution) -> None:
    assert solution.vtpv == pytest.approx(CHI_SQUARED, abs=0.005)
    assert solution.sigma0**2 == pytest.approx(1.169, abs=0.0005)


def test_sum_of_squares_of_the_printed_values_is_the_published_one_within_rounding(
    folder: Path, measurements: list[Measurement]
) -> None:
    """∂(vᵀPv)/∂l = −2 Pv at the minimum, so rounded observations move it by 2 |Pv| 0.03 mm."""
    network = fga.read_dynaml(folder / STATIONS)
    for (ident, o), m in zip(list(network.observations.items()), measurements, strict=True):
        network.observations[ident] = replace(o, value=tuple(m.measured.tolist()))  # type: ignore[call-arg]
    solution = adjust(network)
    v = solution.equations.residuals(solution.state, whitened=False)
    rounding = 2.0 * float(np.linalg.norm(weights(solution.equations) @ v)) * ROUNDED
    assert rounding < 1.0
    assert solution.vtpv == pytest.approx(CHI_SQUARED, abs=rounding)
    assert solution.vtpv == pytest.approx(336.76, abs=0.005)


def test_other_transformations_to_gda2020_give_other_sums_of_squares(
    folder: Path, measurements: list[Measurement]
) -> None:
    assert adjust(fga.read_dynaml(folder / STATIONS)).vtpv == pytest.approx(337.28, abs=0.005)
    network = fga.read_dynaml(folder / STATIONS, reference_frames="as is")
    assert adjust(network).vtpv == pytest.approx(335.45, abs=0.005)
    file = [np.array(o.value) for o in network.observations.values()]  # type: ignore[attr-defined]
    moved = [np.abs(a - m.measured).max() for a, m in zip(file, measurements, strict=True)]
    assert 0.001 < max(moved) < 0.002


def test_adjusted_coordinates_are_dynadjusts(
    solution: Solution, stations: dict[str, Station]
) -> None:
    for name, station in stations.items():
        np.testing.assert_allclose(solution.point(name), station.xyz, rtol=0, atol=1.001 * PRINTED)


def test_standard_deviations_east_north_up_are_dynadjusts(
    solution: Solution, stations: dict[str, Station]
) -> None:
    for name, station in stations.items():
        basis = FRAME.basis(station.xyz[None], np.zeros((1, 2))).enu[0]
        sigma = np.sqrt(np.diag(basis @ solution.covariance(name) @ basis.T))
        np.testing.assert_allclose(sigma, station.sigma_enu, rtol=0, atol=PRINTED, err_msg=name)


def test_adjusted_baselines_and_their_standard_deviations_are_dynadjusts(
    solution: Solution, measurements: list[Measurement]
) -> None:
    """σ of an adjusted baseline needs the covariance between its two stations."""
    for m in measurements:
        *others, last = m.stations
        adjusted, covariance = solution.point(last), solution.covariance(last)
        for first in others:
            adjusted = adjusted - solution.point(first)
            both = solution.covariance(first, last)
            covariance = covariance + solution.covariance(first) - both - both.T
        np.testing.assert_allclose(adjusted, m.adjusted, rtol=0, atol=1.01 * PRINTED)
        np.testing.assert_allclose(
            np.sqrt(np.diag(covariance)), m.adjusted_sigma, rtol=0, atol=PRINTED
        )


def test_standard_deviations_of_observations_are_dynadjusts(
    solution: Solution, measurements: list[Measurement]
) -> None:
    """Those of the clusters among them: the diagonal of their covariance."""
    sigma: dict[str, list[float]] = {}
    for record in solution.observations:
        sigma.setdefault(record.id, []).append(record.sigma)
    for ident, m in zip(solution.network.observations, measurements, strict=True):
        np.testing.assert_allclose(sigma[ident], m.sigma, rtol=0, atol=PRINTED)
