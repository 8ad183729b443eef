"""Comp3D: a real network of total stations, and deflections of the vertical."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io.survey.comp3d_grid import Comp3dOrigin
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.start.approximate_values import approximate
from factorgraph_adj.units import ARCSEC, GON
from tests.loaders import comp3d
from tests.networks.comp3d import LATITUDE, deflected, network_of_topo
from tests.support.places import data_dir

pytestmark = pytest.mark.published

MICROMETRE = 1e-6
AXES = ("x", "y", "z")


def expected(name, file):
    return comp3d.read_table(data_dir(name) / file)


@pytest.fixture(scope="module")
def topo():
    return adjust(network_of_topo())


def test_all_points_are_found_from_the_one_weighted_point():
    """The .cor has two points: one is weighted, the other a guess 27 m off, 90° round.

    The guess stays, as everything given does; but the search notices that it contradicts and
    builds on the other alone.
    """
    network = network_of_topo()
    state = approximate(compile_network(network))
    rows = {row["point"]: row for row in expected("comp3d_topo", "expected_points.csv")}
    for number, name in enumerate(network.points):
        truth = Comp3dOrigin(LATITUDE).to_cartesian(printed(rows[name]))
        error = np.linalg.norm(state["point"][number] - truth)
        if name == "HLLPI0083":
            assert error > 20.0
        else:
            assert error < 0.02


def test_sigma0_and_redundancy_without_approximate_coordinates(topo):
    assert topo.converged
    assert (topo.n_observations, topo.n_unknowns, topo.redundancy) == (536, 262, 274)
    assert topo.sigma0 == pytest.approx(0.896161, abs=5e-7)


def printed(row):
    return np.array([float(row[a]) for a in "XYZ"])


def test_coordinates_to_a_twentieth_of_a_micrometre(topo):
    """The printed X, Y, Z are a projection, see the loader."""
    for row in expected("comp3d_topo", "expected_points.csv"):
        np.testing.assert_allclose(
            topo.point(row["point"]),
            Comp3dOrigin(LATITUDE).to_cartesian(printed(row)),
            rtol=0,
            atol=MICROMETRE / 20,
        )


def test_printed_cartesian_coordinates_are_those_on_the_ellipsoid():
    for row in expected("comp3d_topo", "expected_points.csv"):
        np.testing.assert_allclose(
            Comp3dOrigin(LATITUDE).on_ellipsoid(printed(row)),
            [float(row[f"{a}_cart"]) for a in AXES],
            rtol=0,
            atol=MICROMETRE / 30,
        )


def test_standard_deviations_of_coordinates(topo):
    """Those of Comp3D are scaled by its σ0."""
    rows = expected("comp3d_topo", "expected_points.csv")
    for row in rows:
        sigmas = [float(row[f"s{a}"]) for a in AXES]
        found = topo.sigma0 * topo.standard_deviations(row["point"])
        np.testing.assert_allclose(found, sigmas, rtol=1e-5)
    assert len(rows) == 85


def test_residuals_of_all_observations(topo):
    """The same sign as ours: computed minus observed."""
    rows = {
        row["line"]: row
        for row in expected("comp3d_topo", "expected_obs.csv")
        if row["active"] == "True" and int(row["code"]) > 0
    }
    found = {r.id: r for r in topo.observations if r.id in rows}
    assert len(found) == len(rows) == 533
    for line, row in rows.items():
        unit = GON if row["unit_str"] == "g" else 1.0
        assert found[line].residual / unit == pytest.approx(
            float(row["residual"]), abs=1e-4 * float(row["sigma_total"])
        )


def test_a_topocentric_frame_needs_no_reduction_of_the_azimuth():
    """And gives the printed cartesian coordinates, which are on the ellipsoid.

    Comp3D takes verticals from the sphere, which differ by 0.2 % of 100 m/R, 3·10⁻⁸ rad: that is
    1 µm over sights of 30 m.
    """
    on_ellipsoid = adjust(network_of_topo("ellipsoid"))
    for row in expected("comp3d_topo", "expected_points.csv"):
        np.testing.assert_allclose(
            on_ellipsoid.point(row["point"]),
            [float(row[f"{a}_cart"]) for a in AXES],
            rtol=0,
            atol=MICROMETRE,
        )


# -- deflections of the vertical --------------------------------------------------------------


@pytest.fixture(scope="module")
def vertical() -> Solution:
    return adjust(deflected())


def rows_of_deflected():
    """Return the rows of distances, directions and zenith angles by line."""
    return {
        row["line"]: row
        for row in expected("comp3d_dev_vert", "expected_obs.csv")
        if int(row["code"]) in (3, 5, 6, 7)
    }


def test_corrections_for_deflections_have_the_published_signs_and_sizes(vertical):
    """``deflection_correction``: computed without the deflection minus computed with it.

    Comp3D's correction is linear in the deflection δ, ours is the rotation itself; they differ
    by up to δ² (1 + cot²z), with δ = 31″ 1.4·10⁻⁶ gon where cot z < 1, and where no deflection
    is by nothing.
    """
    undeflected = vertical.state | {"vertical": np.zeros_like(vertical.state["vertical"])}
    frame = vertical.network.frame
    rows = rows_of_deflected()
    found, largest = 0, 0.0
    for block in vertical.equations.blocks:
        if block.kind not in ("direction", "zenith_angle"):
            continue
        with_it, without = (
            block.evaluate(frame, s, jacobians=False).residual[:, 0] / GON
            for s in (vertical.state, undeflected)
        )
        for ident, correction, zenith in zip(
            block.ids,
            without - with_it,
            [float(rows[i]["obs_zen"]) if i in rows else np.nan for i in block.ids],
            strict=True,
        ):
            if ident not in rows:
                continue
            eta_xi = {"S0": 0.0, "S1": 10.0, "S2": 20.0, "S3": np.hypot(30.0, 8.0)}
            delta = eta_xi[rows[ident]["from"]] * ARCSEC
            second_order = delta**2 * (1 + 1 / np.tan(zenith) ** 2) / GON
            theirs = float(rows[ident]["deflection_correction"])
            assert correction == pytest.approx(theirs, abs=second_order + 1e-9)
            found += 1
            largest = max(largest, abs(theirs))
    assert found == 192
    assert largest > 0.009


PUBLISHED = 0.0278052
"""σ0, of residuals near zero in units of 1 µm and 0.0001 gon."""
STEP = 2.0**-30
"""Resolution of Comp3D's heights, metres, see the loader."""
SIGHT, CONTROL = 1e-4 * GON * 1.0, 1e-6
"""Standard deviations of a zenith angle across the shortest sight (1 m), and of a point, metres."""
OF_RESIDUALS = STEP / SIGHT
"""What the resolution makes of a normalised residual at most: half a step at either end."""
OF_SIGMA0 = STEP / np.sqrt(12 * 355) * np.sqrt(29 / CONTROL**2 + 96 * 2 / SIGHT**2)
"""What rounding by STEP/√12 makes of √(vᵀPv/355): 29 heights, 96 zenith angles with 2 ends."""


def test_first_order_corrections_give_the_published_residuals_and_sigma0():
    """All 447 observations, the 72 of a sub-frame among them."""
    network = deflected()
    network.verticals = {"basc": network.verticals["basc"]}
    rows = rows_of_deflected()
    for ident, row in rows.items():
        if row["unit_str"] == "g":
            o = network.observations[ident]
            corrected = o.value + float(row["deflection_correction"]) * GON
            network.observations[ident] = replace(o, value=corrected)
    solution = adjust(network)
    assert solution.converged
    assert (solution.n_observations, solution.n_unknowns) == (447, 92)
    found = {r.id: r for r in solution.observations if r.id in rows}
    assert len(found) == 288
    for ident, row in rows.items():
        assert found[ident].residual / found[ident].sigma == pytest.approx(
            float(row["normalized_residual"]), abs=2 * OF_RESIDUALS
        )
    assert solution.sigma0 == pytest.approx(PUBLISHED, abs=OF_SIGMA0)


def test_rigorous_deflections_fit_as_well(vertical):
    """The rotation itself instead of its first order: 10⁻⁶ gon, a hundredth of σ."""
    assert vertical.converged
    assert (vertical.n_observations, vertical.n_unknowns) == (447, 92)
    assert vertical.sigma0 == pytest.approx(PUBLISHED, abs=OF_SIGMA0)


@pytest.mark.parametrize("sign", [-1.0, 0.0])
def test_deflections_of_the_wrong_sign_or_none_do_not_fit(sign):
    network = deflected()
    network.verticals = {
        name: replace(p, values=tuple(sign * v for v in p.values))
        for name, p in network.verticals.items()
    }
    assert adjust(network).sigma0 > 1.0
