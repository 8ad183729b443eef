"""Redundancy numbers, tests and detectable errors as other programs print them.

- AICON 3D Studio (aicon_jaicov): r and τ of 9972 image points, two decimals.
- Comp3D (comp3d_topo): r, σ of adjusted values and of residuals, w, ∇ and the "probable error" of
  536 observations.
- An independent computation for dbat_sxb and dbat_camcal: r, w, τ, ∇, δ̄ of 6582 observations.
- GNU Gama: r, test value and estimated error of every observation of 31 networks.
- SNAP (testrc): σ of residuals and flags of weak redundancy. Its refraction coefficient and σ are
  compared in test_snap.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

import factorgraph_adj as fga
from factorgraph_adj.observations import Azimuth, Direction, HorizontalDistance
from factorgraph_adj.solve.solution import solution_at
from factorgraph_adj.types import Array, Index, Mask
from factorgraph_adj.units import ARCSEC, CC, GON
from tests.loaders import comp3d, snap
from tests.loaders.gama_result import GamaObservation
from tests.loaders.snap import radius_in_azimuth
from tests.networks import aicon, dbat
from tests.networks.comp3d import network_of_topo
from tests.networks.gama import (
    FOLDER,
    GAMA_STOPS,
    LINEARISED_ELSEWHERE,
    MICROMETRE_START,
    Case,
    solved,
    state_at,
)
from tests.support.dbat_report import read_reliability
from tests.support.dense import DenseReliability
from tests.support.places import data_dir

LONG = pytest.mark.slow(
    "all 5 000 redundancy numbers of a real block; short tests take those of smaller networks"
)

pytestmark = pytest.mark.published

TWO_DECIMALS, THREE_DECIMALS = 0.5e-2, 0.5e-3
"""Half of the last printed digit."""

# -- AICON ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def close_range() -> fga.Reliability:
    network = aicon.read_aicon(data_dir("aicon_jaicov"), start="photos astray")
    return fga.reliability(fga.adjust(network, variance="a-posteriori"))


@pytest.fixture(scope="module")
def image_points(close_range: fga.Reliability) -> tuple[Index, Array]:
    """Rows (9972, 2) of the image points, and what is printed for each of them."""
    photos, points, table = aicon.image_reference(data_dir("aicon_jaicov"))
    of_point = {f"{f}/{p}": row for f, p, row in zip(photos, points, table, strict=True)}
    block = next(b for b in close_range.solution.equations.blocks if b.kind == "image")
    assert len(of_point) == block.n == 9972
    rows = block.first_row + np.arange(block.observed.size).reshape(-1, 2)
    return rows, np.array([of_point[i] for i in block.ids])


@LONG
def test_aicon_every_redundancy_number_is_the_printed_one(
    close_range: fga.Reliability, image_points: tuple[Index, Array]
) -> None:
    """Printed to two decimals; to six by an independent computation."""
    rows, printed = image_points
    r = close_range.redundancy_numbers[rows]
    assert np.abs(r - printed[:, 6:8]).max() < TWO_DECIMALS
    assert np.abs(r - printed[:, 12:14]).max() < 0.5e-6


def test_aicon_every_test_value_is_the_printed_one(
    close_range: fga.Reliability, image_points: tuple[Index, Array]
) -> None:
    """|v| / (S0 √r), S0 estimated: |τ|. To two decimals; to four by an independent computation."""
    rows, printed = image_points
    tau = np.abs(close_range.tau[rows])
    assert np.abs(tau - printed[:, 8:10]).max() < TWO_DECIMALS
    assert np.abs(tau - printed[:, 14:16]).max() < 0.5e-4


def test_aicon_nothing_controls_the_scale_bar(close_range: fga.Reliability) -> None:
    row = close_range.row("Scalebar")
    assert abs(close_range.redundancy_numbers[row]) < 1e-9
    assert not close_range.controlled[row]
    assert close_range.mdb[row] == np.inf and close_range.delta_bar[row] == np.inf
    assert np.isnan(close_range.w[row]) and np.isnan(close_range.tau[row])
    assert close_range.controlled.sum() == len(close_range.w) - 1


def test_aicon_a_wrong_scale_bar_scales_the_block_and_shows_nowhere(
    close_range: fga.Reliability,
) -> None:
    """1 mm in 1389.688 mm: every distance between points grows by as much."""
    moved = {
        effect.name: effect.values
        for effect in close_range.effect_on("Scalebar", error=1e-3)
        if effect.kind == "point"
    }
    solution = close_range.solution
    names = list(moved)
    rng = np.random.default_rng(2)
    for a, b in rng.choice(names, (20, 2)).tolist():
        if a == b:
            continue
        before = solution.point(b) - solution.point(a)
        along = before @ (moved[b] - moved[a]) / np.linalg.norm(before)
        assert along / np.linalg.norm(before) == pytest.approx(1e-3 / 1.389688, rel=1e-6)


# -- Comp3D ---------------------------------------------------------------------------------------

DELTA0_OF_COMP3D, LIMIT_OF_COMP3D = 4.1, 2.5
"""Its ∇ = 4.1 σ/√r, and the |w| from which on it states a probable error."""
LEAST_OF_COMP3D = 1.0
"""Per cent of redundancy up to which it states no tests."""
SAME_NETWORK = 1e-6
"""Relative: all digits are printed, but Comp3D projects (see the loader): sights agree to 10⁻⁷."""
SAME_RESIDUALS = 2e-5
"""Part of σ to which residuals agree, see the loader."""


@pytest.fixture(scope="module")
def total_stations() -> fga.Reliability:
    network = network_of_topo()
    power = float(norm.cdf(DELTA0_OF_COMP3D - norm.isf(0.005)))
    return fga.reliability(fga.adjust(network), alpha=0.01, power=power)


@pytest.fixture(scope="module")
def listed(total_stations: fga.Reliability) -> list[tuple[int, float, dict[str, str]]]:
    """Row, unit and line of the table for each active observation, weighted coordinates too.

    The unit of projected X and Y is that on the ground, see `read_points`.
    """
    network = total_stations.solution.network
    out = []
    for line in comp3d.read_table(data_dir("comp3d_topo") / "expected_obs.csv"):
        if line["active"] != "True":
            continue
        axis = {"-1": "x", "-2": "y", "-3": "z"}.get(line["code"])
        unit = GON if line["unit_str"] == "g" else 1.0
        if axis in ("x", "y"):
            height = network.points[line["from"]].coordinates[2]
            unit = 1.0 + height / network.frame.radius
        ident = line["line"] if axis is None else f"point {line['from']} {axis}"
        out.append((total_stations.row(ident), unit, line))
    assert sorted(row for row, _, _ in out) == list(range(536))
    return out


def test_comp3d_redundancy_numbers_and_standard_deviations_are_the_printed_ones(
    total_stations: fga.Reliability, listed: list[tuple[int, float, dict[str, str]]]
) -> None:
    """R in per cent; σ of the adjusted observation σ √(1 − r) and of the residual σ √r, σ0 = 1."""
    sigmas = total_stations.solution.observations.sigmas
    total = 0.0
    for row, unit, line in listed:
        r, sigma = total_stations.redundancy_numbers[row], sigmas[row] / unit
        total += float(line["obs_redondancy"])
        assert 100.0 * r == pytest.approx(float(line["obs_redondancy"]), abs=100 * SAME_NETWORK)
        adjusted = sigma * math.sqrt(min(1.0 - r, 1.0))
        assert adjusted == pytest.approx(float(line["sigma_a_posteriori"]), rel=SAME_NETWORK)
        if line["sigma_residual"]:
            of_residual = sigma * math.sqrt(r)
            assert of_residual == pytest.approx(float(line["sigma_residual"]), rel=SAME_NETWORK)
    assert total == pytest.approx(27400.0, abs=1e-3)


def test_comp3d_tests_and_detectable_errors_are_the_printed_ones(
    total_stations: fga.Reliability, listed: list[tuple[int, float, dict[str, str]]]
) -> None:
    """Standardized residual = w, a priori; nabla = 4.1 σ/√r. None is printed for r ≤ 1 %."""
    rel = total_stations
    assert rel.delta0 == pytest.approx(DELTA0_OF_COMP3D, rel=1e-12)
    tested, weak = 0, []
    for row, unit, line in listed:
        if not line["standardized_residual"]:
            assert float(line["obs_redondancy"]) < LEAST_OF_COMP3D
            if rel.controlled[row]:
                weak.append(line["line"])
            continue
        tested += 1
        off = SAME_RESIDUALS / math.sqrt(rel.redundancy_numbers[row])
        assert rel.w[row] == pytest.approx(float(line["standardized_residual"]), abs=off)
        assert rel.mdb[row] / unit == pytest.approx(float(line["nabla"]), rel=SAME_NETWORK)
    assert tested == 463
    # Three between 0.1 % and 1 % are tested here and not there; 70 are not controlled at all.
    assert weak == ["140", "480", "500"]
    assert np.sum(~rel.controlled) == 536 - 463 - 3
    assert np.nanmax(np.abs(rel.w)) == pytest.approx(3.82, abs=0.5e-2)


def test_comp3d_the_five_probable_errors_are_the_suspects(
    total_stations: fga.Reliability, listed: list[tuple[int, float, dict[str, str]]]
) -> None:
    """Of all |w| > 2.5; probable_error = −v/r, observed − true."""
    rel = total_stations
    published = {
        row: float(line["probable_error"]) * unit
        for row, unit, line in listed
        if line["probable_error"]
    }
    assert len(published) == 5
    assert {s.row for s in rel.suspects(critical=LIMIT_OF_COMP3D)} == set(published)
    for row, error in published.items():
        r, sigma = rel.redundancy_numbers[row], rel.solution.observations.sigmas[row]
        off = SAME_RESIDUALS * sigma / r
        assert rel.estimated_errors[row] == pytest.approx(error, abs=off)


# -- DBAT's blocks, by an independent computation -------------------------------------------------

DELTA0_OF_REFERENCE = 4.132
SHORT_OF_MINIMUM = 1.5e-7
"""Part of σ by which its residuals, printed to 1e-8 of σ, may be short of the minimum."""


@pytest.mark.parametrize(
    ("name", "read"), [("dbat_sxb", dbat.read_sxb), ("dbat_camcal", dbat.read_camcal)]
)
def test_dbat_every_figure_is_that_of_the_independent_computation(name: str, read) -> None:  # type: ignore[no-untyped-def]
    """To the printed digits; its own δ0 is 4.132, 3.6e-5 less than 4.132148."""
    solution = fga.adjust(read(data_dir(name)))
    rel = fga.reliability(solution)
    keys, printed = read_reliability(data_dir(name))
    row_of = {}
    for row, record in enumerate(solution.observations):
        if record.kind == "image":
            photo, point = record.id.split("/")
            row_of[photo, point, record.component] = row
        else:
            (point,) = solution.network.observations[record.id].names()
            row_of["", point, "XYZ"[row % 3]] = row
    rows = np.array([row_of[key] for key in keys])
    assert sorted(rows.tolist()) == list(range(len(solution.observations)))
    # v is computed − observed in both, and y points up.
    scale = DELTA0_OF_REFERENCE / rel.delta0
    sigmas = solution.observations.sigmas
    ours = np.stack(
        [
            solution.observations.normalised,
            rel.redundancy_numbers,
            rel.w,
            rel.tau,
            scale * rel.mdb / sigmas,
            scale * rel.delta_bar,
        ],
        axis=1,
    )[rows]
    halves = np.array([0.5e-8, 0.5e-8, 0.5e-6, 0.5e-6, 0.5e-5, 0.5e-5])
    short = SHORT_OF_MINIMUM / np.sqrt(ours[:, 1:2]) * np.array([1.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    short[:, 1] = 1e-2 * SHORT_OF_MINIMUM  # partials follow the unknowns
    worst = (np.abs(ours - printed) - short).max(axis=0) / halves
    assert np.all(worst <= 1.0), worst


# -- GNU Gama -------------------------------------------------------------------------------------

UNIT = {"direction": CC, "angle": CC, "azimuth": CC, "zenith-angle": CC}
"""Of Gama's residuals and errors; lengths have mm."""


@cache
def gama(name: str) -> fga.Reliability:
    return fga.reliability(solved(name).solution)


@pytest.fixture(params=sorted(FOLDER))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def pairs(case: Case) -> list[tuple[int, GamaObservation]]:
    """Return the rows of our observations with Gama's, which are in the order of the file."""
    rows: dict[str, list[int]] = {ident: [] for ident in case.network.observations}
    for row, ident in enumerate(case.solution.observations.ids):
        rows[ident].append(row)
    in_order = [row for own in rows.values() for row in own]
    return list(zip(in_order, case.result.observations, strict=True))


def correlated(solution: fga.Solution) -> Mask:
    """Return which rows are correlated with others, (n,)."""
    out = np.zeros(len(solution.observations), dtype=bool)
    for block in solution.equations.blocks:
        out[block.rows] = block.whitener is not None
    for cluster in solution.equations.clusters:
        out[cluster.rows] = True
    return out


def test_gama_redundancy_numbers_where_it_linearises_are_the_printed_ones(name: str) -> None:
    """F = 100 (1 − √(1 − r)) and q_rr = r σ²/m0², both to 0.001, before Gama's last step.

    ``err-obs`` and ``std-residual`` belong to its adjusted coordinates, see below.
    """
    case = solved(name)
    state = state_at(case.equations, case.result.approximate)
    there = solution_at(case.solution, state)
    r = fga.reliability(there).redundancy_numbers
    skip = correlated(case.solution)
    sigmas = case.solution.observations.sigmas
    for row, theirs in pairs(case):
        if skip[row]:
            continue
        f = 100.0 * (1.0 - math.sqrt(min(max(1.0 - r[row], 0.0), 1.0)))
        assert f == pytest.approx(theirs.f, abs=1.0002 * THREE_DECIMALS + 100 * MICROMETRE_START)
        q = r[row] * (sigmas[row] / UNIT.get(theirs.kind, 1e-3) / case.result.apriori) ** 2
        off = 1.0002 * THREE_DECIMALS + 10 * MICROMETRE_START * q
        assert q == pytest.approx(theirs.qrr, abs=off)


def test_gama_test_values_are_the_printed_ones(name: str) -> None:
    """std-residual = |v| / (m √q_vv), m the a-priori or a-posteriori m0 as the file asks.

    Not so for correlated observations, the vectors of tst-tetrahedron-2: what Gama prints there
    is |v_i| / (m σ_i √(1 − H_ii)) with H = L⁻¹ A Q Aᵀ L⁻ᵀ of the homogenised system, Σ = L Lᵀ.
    That is neither the test of an error of the component, |(Pv)_i| over its σ (for dy of vector
    1-3 0.888, printed 0.139), nor the residual over its own σ (for dy of 1-4 2.112, printed
    2.171), and depends on the order of the components. Its σ of the adjusted dy of 1-4 comes from
    there too: 22.680 mm, while the σ of y of point 4 in its own covariance matrix is 22.319 mm,
    and y of point 1 is held.
    """
    case, rel = solved(name), gama(name)
    result = case.result
    m = result.aposteriori / result.apriori if result.used == "aposteriori" else 1.0
    ours = np.abs(rel.w)
    if correlated(case.solution).any():
        homogenise(ours, rel)
    n = 0
    for row, theirs in pairs(case):
        if theirs.standardised is not None:
            off = THREE_DECIMALS + LINEARISED_ELSEWHERE * theirs.standardised
            assert ours[row] / m == pytest.approx(theirs.standardised, abs=off)
            n += 1
    assert n


def homogenise(tests: Array, rel: fga.Reliability) -> None:
    """Put |v_i| / (σ_i √(1 − H_ii)) in the place of the tests (n,) of correlated rows."""
    equations = rel.solution.equations
    groups = [(c.rows, c.whitener) for c in equations.clusters]
    for block in equations.blocks:
        for i, whitener in enumerate([] if block.whitener is None else block.whitener):
            first = block.first_row + block.dimension * i
            groups.append((first + np.arange(block.dimension), whitener))
    precision = DenseReliability.of(rel.solution).precision
    residuals, sigmas = rel.solution.observations.residuals, rel.solution.observations.sigmas
    for rows, whitener in groups:
        root = np.linalg.cholesky(np.linalg.inv(whitener.T @ whitener))
        unseen = root.T @ precision[np.ix_(rows, rows)] @ root  # I − H
        tests[rows] = np.abs(residuals[rows]) / sigmas[rows] / np.sqrt(np.diag(unseen))


def test_gama_estimated_errors_are_the_printed_ones(name: str) -> None:
    """err-obs = v/r, mm or cc: true − observed, the negative of ours.

    Gama's last step, 0.5 µm at most, matters across the shortest sight, and 1/r as much.
    """
    case, rel = solved(name), gama(name)
    skip = correlated(case.solution)
    n = 0
    for row, theirs in pairs(case):
        if theirs.error is None or skip[row]:
            continue
        unit, stops = UNIT.get(theirs.kind, 1e-3), GAMA_STOPS
        if theirs.kind in UNIT:
            at, *to = (case.solution.point(p) for p in theirs.names)
            stops /= min(float(np.linalg.norm(t - at)) for t in to)
        off = THREE_DECIMALS + LINEARISED_ELSEWHERE * abs(theirs.error)
        off += stops / unit / rel.redundancy_numbers[row]
        assert -rel.estimated_errors[row] / unit == pytest.approx(theirs.error, abs=off)
        n += 1
    assert n or skip.all()


# -- SNAP -----------------------------------------------------------------------------------------

PLAN1 = ("PLAN1", "PLAN_B1", "PLAN_B2")
"""Corrections of bearings that are one unknown in testrc."""


def whole_of_testrc(folder: Path) -> tuple[fga.Network, list[tuple[str, snap.ListedResidual]]]:
    """Return testrc with counterparts of its distances and bearings, and ids with SNAP's lines.

    Distances along the ellipsoid between stations with held positions become horizontal ones
    with the scale of their distance meter; bearings of a common unknown correction become a set of
    directions, those of a given one azimuths. Redundancy depends on which unknown is whose only.
    """
    listed = snap.read_residuals(folder / "expected/testrc/testrc.lst")
    radius = radius_in_azimuth(snap.read_zenith_angles(folder / "in"))
    network = snap.read_zenith_angles(folder / "in", radius=radius)
    angles = [i for i, o in network.observations.items() if o.kind == "zenith_angle"]
    lines = [line.split() for line in (folder / "in/testrc.dat").read_text().splitlines()]
    # 1 2 889.26 0.5 edm1, and 1 2 40.510 plan1
    groups = [
        part[-1].upper() for part in lines if part[:2] == ["1", "2"] and part[-1][0].isalpha()
    ]
    out = list(zip(angles, listed[: len(angles)], strict=True))
    at = {n: np.array(network.points[n].coordinates) for n in "12"}
    e, n, _ = snap.FRAME.basis(at["1"][None], np.zeros((1, 2))).enu[0] @ (at["2"] - at["1"])
    for line, group in zip(listed[len(angles) :], groups, strict=True):
        if line.kind == "ED":
            free = ["scale"] if group.startswith("EDM_K") else []
            network.set_distance_meter(group, free=free)
            value = math.hypot(e, n) + line.residual
            o = HorizontalDistance("1", "2", value, sigma=line.sigma, instrument=group)
        else:
            value = math.atan2(e, n) + line.residual * ARCSEC
            sigma = line.sigma * ARCSEC
            if group == "PLAN_ABC":
                o = Azimuth("1", "2", value, sigma=sigma)
            else:
                o = Direction("1", "2", value, set="1" if group in PLAN1 else "2", sigma=sigma)
        out += [(ident, line) for ident in network.add(o)]
    return network, out


def test_snap_standard_deviations_of_residuals_and_weak_observations_are_the_printed_ones() -> None:
    """R = (σ_v/σ)²: σ_v to a tenth of a second or of a millimetre, flags for r < 0.10."""
    network, listed = whole_of_testrc(data_dir("snap_obs_equations"))
    solution = fga.adjust(network)
    rel = fga.reliability(solution)
    assert len(listed) == 23
    flagged = []
    for ident, line in listed:
        r = rel.redundancy_numbers[rel.row(ident)]
        half = 0.5e-4 if line.kind == "ED" else 0.05
        assert line.sigma * math.sqrt(max(r, 0.0)) == pytest.approx(line.sigma_residual, abs=half)
        held = 1e-4 if line.kind == "ED" else 0.0  # σ of positions that SNAP holds, metres
        assert line.sigma * math.sqrt(min(1 - r, 1.0)) == pytest.approx(
            line.sigma_adjusted, abs=half + held
        )
        assert (r < 0.10) == line.weak
        assert bool(rel.controlled[rel.row(ident)]) == (line.standardised is not None)
        flagged += [ident] if line.weak else []
    assert len(flagged) == 3


def test_snap_test_values_of_zenith_angles_are_the_printed_ones() -> None:
    """S.R. = |w|, to 0.01."""
    network, listed = whole_of_testrc(data_dir("snap_obs_equations"))
    rel = fga.reliability(fga.adjust(network))
    angles = [(ident, line) for ident, line in listed if line.kind == "ZD"]
    assert len(angles) == 12
    for ident, line in angles:
        assert abs(rel.w[rel.row(ident)]) == pytest.approx(line.standardised, abs=TWO_DECIMALS)
