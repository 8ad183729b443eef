"""Rows of the design matrix, a refraction coefficient and a reference frame as SNAP prints them.

The observations are made of the listings by `tests.loaders.snap`, with kinds that SNAP does not
define in the same way (horizontal distances, height differences); bearings on a map projection
(PB) and distances along the ellipsoid (ED) and the geoid (MD) are left out. Whole jobs, with these,
are compared in tests/io/survey/test_snap.py.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import GnssVector
from factorgraph_adj.types import Array
from tests.loaders import snap
from tests.loaders.snap import FRAME, Row, dms, radius_in_azimuth
from tests.support.differences import columns_of
from tests.support.places import data_dir

pytestmark = pytest.mark.published

PRINTED_ANGLE = np.radians(0.5e-7)
"""Half the last digit of the listed observations, degrees with 7 decimals."""
TENTH_MICROMETRE = 1e-7
"""Observed lengths are exact; coordinates of 6·10⁶ m, in SNAP carried as latitude and
longitude, are not."""
SIGNIFICANT = 9
"""Digits of the listed partials."""


@pytest.fixture(scope="module")
def folder() -> Path:
    return data_dir("snap_obs_equations")


class Rows:
    """Ours beside SNAP's."""

    def __init__(self, folder: Path, test: str) -> None:
        self.stations = snap.read_stations(folder / "in" / "test1.crd")
        self.rows = snap.read_rows(folder / "expected" / test, self.stations)
        self.equations: Equations = compile_network(snap.network_of(self.stations, self.rows))
        self.state = self.equations.unknowns.start()
        self.state["orientation"][:] = 0.0
        self.v: dict[str, list[float]] = {}
        self.a: dict[str, list[Array]] = {}
        for block in self.equations.blocks:
            v, partials = block.evaluate(FRAME, self.state)
            a = columns_of(self.equations.unknowns, block, partials)
            for i, ident in enumerate(block.ids):
                own = slice(i * block.dimension, (i + 1) * block.dimension)
                self.v.setdefault(ident, []).extend(v.ravel()[own])
                self.a.setdefault(ident, []).extend(a[own])

    def of(self, *kinds: str) -> list[Row]:
        return [row for row in self.rows if row.kind in kinds]

    def by(self, row: Row, station: str, *, turning: bool = True) -> Array:
        """Return our partials by east, north, up of a station, (d, 3).

        Args:
            row: the observation.
            station: the station.
            turning: whether the horizon turns with the station as it moves. SNAP neglects
                that for observations in the horizon.
        """
        unknowns = self.equations.unknowns
        number = unknowns["point"].number[station]
        a = np.array(self.a[row.ident])
        by_position = a[:, unknowns.columns("point", number)]
        basis = FRAME.basis(self.stations[station][None], np.zeros((1, 2)))
        if not turning:
            by_vertical = a[:, unknowns.columns("vertical", unknowns["vertical"].number[station])]
            by_angles = by_vertical @ np.linalg.inv(basis.angles_by_vertical[0])
            by_position = by_position - by_angles @ basis.angles_by_position[0]
        return np.asarray(by_position @ basis.enu[0].T)


@pytest.fixture(scope="module")
def rows(folder: Path) -> Rows:
    return Rows(folder, "test1b")


def half_last_digit(printed: Array) -> Array:
    """Return half of the last digit of numbers printed with nine significant ones."""
    magnitude = np.floor(np.log10(np.maximum(np.abs(printed), 1e-6)))
    return np.asarray(0.5 * 10.0 ** (magnitude - SIGNIFICANT + 1))


def assert_partials_printed(ours: Array, printed: Array, what: str) -> None:
    wrong = np.abs(ours - printed) > 1.02 * half_last_digit(printed)
    assert not wrong.any(), f"{what}: {ours[wrong]} is not {printed[wrong]}"


def test_every_type_of_the_listing_is_compared_or_has_no_counterpart(rows: Rows) -> None:
    assert Counter(r.kind for r in rows.rows) == {
        "HA": 18, "AZ": 6, "PB": 6, "SD": 6, "ED": 4, "MD": 4, "HD": 2, "DR": 2,
        "ZD": 4, "LV": 4, "LN": 6, "LT": 6, "OH": 2, "EH": 2, "GB": 21, "GX": 21,
    }  # fmt: skip
    without = {r.kind for r in rows.rows if r.observation is None}
    assert without == set(snap.NO_COUNTERPART)


@pytest.mark.parametrize("kind", ["SD", "DR", "LT", "LN", "GB", "GX", "EH", "OH"])
def test_rows_agree_to_every_printed_digit(rows: Rows, kind: str) -> None:
    for row in rows.of(kind):
        for station, printed in row.by_station.items():
            ours = rows.by(row, station)
            assert_partials_printed(ours, printed, f"{kind} {row.ident} by {station}")


@pytest.mark.parametrize("kind", ["HA", "AZ", "ZD"])
def test_rows_in_the_horizon_agree_where_the_horizon_does_not_turn(rows: Rows, kind: str) -> None:
    """SNAP leaves out how the horizon of a station turns as the station moves.

    The part left out is of the order of 1/R = 1.6e-7 rad/m, 1.5e-4 of the partials of a sight
    of 1 km. Ours have it, and agree with numerical derivatives (test_jacobians); without it
    every printed digit is the same.
    """
    left_out = []
    for row in rows.of(kind):
        for station, printed in row.by_station.items():
            frozen = rows.by(row, station, turning=False)
            assert_partials_printed(frozen, printed, f"{kind} {row.ident} by {station}")
            left_out.append(np.abs(rows.by(row, station) - printed).max())
    assert 1e-7 < max(left_out) < 2e-7


@pytest.mark.parametrize("test", ["test1", "test1b"])
def test_residuals_agree_to_every_printed_digit(folder: Path, test: str) -> None:
    """v = computed − observed is the negative of SNAP's value."""
    rows = Rows(folder, test)
    compared = 0
    for row in rows.of("AZ", "ZD", "LT", "LN", "SD", "DR", "GB", "GX", "EH", "OH"):
        angle = row.kind in ("AZ", "ZD", "LT", "LN")
        allowed = PRINTED_ANGLE if angle else TENTH_MICROMETRE
        np.testing.assert_allclose(
            -np.array(rows.v[row.ident]), row.residual, rtol=0, atol=allowed, err_msg=row.ident
        )
        compared += len(row.residual)
    assert compared >= 150


@pytest.mark.parametrize("test", ["test1", "test1b"])
def test_directions_agree_within_their_sets(folder: Path, test: str) -> None:
    """SNAP takes the orientation of a set from its first direction."""
    rows = Rows(folder, test)
    sets: dict[str, list[Row]] = {}
    for row in rows.of("HA"):
        sets.setdefault(row.group, []).append(row)
    for first, *others in sets.values():
        for row in others:
            ours = rows.v[first.ident][0] - rows.v[row.ident][0]
            ours = (ours + np.pi) % (2 * np.pi) - np.pi
            theirs = float(row.residual[0] - first.residual[0])
            assert ours == pytest.approx(theirs, abs=2 * PRINTED_ANGLE)


def test_implicit_parameters_are_orientations_and_a_scale(rows: Rows) -> None:
    unknowns = rows.equations.unknowns
    scale = unknowns.columns("edm", unknowns["edm"].number[snap.RATIO])[0]
    for row in rows.of("DR"):
        in_ppm = 1e-6 * rows.a[row.ident][0][scale]
        assert_partials_printed(np.array([in_ppm]), np.array([row.by_implicit]), f"DR {row.ident}")
    for row in rows.of("HA"):
        station = row.observation.names()[0]
        number = unknowns["orientation"].number[f"{station}/{row.group}"]
        # A direction is α − R here; SNAP adds its orientation to the observation.
        assert rows.a[row.ident][0][unknowns.columns("orientation", number)[0]] == -1.0
        assert row.by_implicit == 1.0


def test_a_height_difference_differs_from_that_of_ellipsoidal_heights_by_second_order(
    rows: Rows,
) -> None:
    """SNAP's LV is h_j − h_i; ours is ½(u_i + u_j)·d = (h_j − h_i)(1 − θ²/4).

    θ is the angle between the verticals, S/R: 0.5 µm for 100 m over 900 m. The partials
    differ by θ²/4 in height and Δh θ/2R in position.
    """
    for row in rows.of("LV"):
        i, j = row.observation.names()
        up = [FRAME.basis(rows.stations[n][None], np.zeros((1, 2))).enu[0, 2] for n in (i, j)]
        theta = float(np.linalg.norm(up[0] - up[1]))
        rise = row.observation.value + float(row.residual[0])
        ours = row.observation.value + rows.v[row.ident][0]
        assert ours - rise == pytest.approx(-rise * theta**2 / 4, rel=0.05)
        for station, printed in row.by_station.items():
            difference = rows.by(row, station) - printed
            assert abs(difference[0, 2]) <= 1.05 * theta**2 / 4
            sideways = 1.05 * abs(rise) * theta / (2 * FRAME.radius)
            assert np.linalg.norm(difference[0, :2]) <= sideways


def test_the_horizontal_distance_of_snap_is_another_one(rows: Rows) -> None:
    """SNAP's HD is √(S² − Δh²), as in a plane; ours lies in the horizon of the station.

    They differ by Δh S/2R, 7 mm for 100 m over 900 m. From our own S and Δh SNAP's value
    comes out to a micrometre, its partials to Δh/2R.
    """
    network = snap.network_of(rows.stations, [])
    for row in rows.of("HD"):
        i, j = row.observation.names()
        network.add(
            snap.SlopeDistance(i, j, 0.0, sigma=1.0, id=f"S {row.ident}"),
            snap.HeightDifference(i, j, 0.0, sigma=1.0, id=f"h {row.ident}"),
        )
    equations = compile_network(network)
    state = equations.unknowns.start()
    computed, partials = {}, {}
    for block in equations.blocks:
        v, parts = block.evaluate(FRAME, state)
        a = columns_of(equations.unknowns, block, parts)
        computed |= dict(zip(block.ids, v[:, 0], strict=True))
        partials |= dict(zip(block.ids, a, strict=True))
    for row in rows.of("HD"):
        s, h = computed[f"S {row.ident}"], computed[f"h {row.ident}"]
        level = float(np.sqrt(s * s - h * h))
        snaps = row.observation.value - row.residual[0]
        assert level == pytest.approx(snaps, abs=1e-6)
        ours = row.observation.value + rows.v[row.ident][0]
        assert ours - level == pytest.approx(h * s / (2 * FRAME.radius), rel=0.05)
        by = (s * partials[f"S {row.ident}"] - h * partials[f"h {row.ident}"]) / level
        for station, printed in row.by_station.items():
            number = equations.unknowns["point"].number[station]
            basis = FRAME.basis(rows.stations[station][None], np.zeros((1, 2))).enu[0]
            local = by[equations.unknowns.columns("point", number)] @ basis.T
            # Here, too, SNAP leaves out that the horizon turns.
            np.testing.assert_allclose(local, printed[0], atol=1.05 * abs(h) / (2 * FRAME.radius))


# -- refraction -----------------------------------------------------------------------------------


def test_a_refraction_coefficient_is_found_as_snap_finds_it(folder: Path) -> None:
    """SNAP prints k = 0.48471 ± 0.07513; κ = 2 k where R is the radius that SNAP uses.

    Bomford's k bends the ray by k S/R, ours by κ S/2R. SNAP takes for R Euler's radius in the
    azimuth of each sight (6379.05 km here, weighted by S²), the library one radius, 6371 km
    unless told otherwise: with that k is 0.48410, smaller in the ratio of the radii.
    """
    radius = radius_in_azimuth(snap.read_zenith_angles(folder / "in"))
    for given, ratio in ((radius, 1.0), (FRAME.radius, radius / FRAME.radius)):
        solution = adjust(snap.read_zenith_angles(folder / "in", radius=given))
        assert solution.converged
        estimate = solution.refraction("TEST")
        assert estimate.values[0] / 2 * ratio == pytest.approx(0.48471, abs=0.5e-5)
        assert estimate.sigmas[0] / 2 * ratio == pytest.approx(0.07513, abs=0.5e-5)


def test_heights_from_zenith_angles_agree_with_snap(folder: Path) -> None:
    """Adjusted heights and their standard deviations; k of DEFAULT is held at 0.075."""
    solution = adjust(snap.read_zenith_angles(folder / "in"))
    for name, height, sigma in (
        ("2", 249.9370, 0.0154),
        ("3", 69.8955, 0.0198),
        ("12", 249.9370, 0.0109),
        ("13", 69.8955, 0.0140),
    ):
        at = solution.point(name)
        up = FRAME.basis(at[None], np.zeros((1, 2))).enu[0, 2]
        assert float(FRAME.ellipsoid.to_geodetic(at)[2]) == pytest.approx(height, abs=0.5e-4)
        found = float(np.sqrt(up @ solution.covariance(name) @ up))
        assert found == pytest.approx(sigma, abs=0.5e-4)


def test_sum_of_squares_of_zenith_angles_agrees_with_snap(folder: Path) -> None:
    """The whole of testrc has 81.17685; bearings and distances, between held points, take the rest.

    Of these SNAP prints calculated values: the bearing error PLAN1 = −18.38293″ is the mean of
    three observations less the bearing, which so is known; the distance is 889.2687 m.
    """
    radius = radius_in_azimuth(snap.read_zenith_angles(folder / "in"))
    solution = adjust(snap.read_zenith_angles(folder / "in", radius=radius))
    plan = np.array([40.510, 40.510, 40.512]) * 3600.0
    bearing = plan.mean() + 18.38293
    fixed = np.array([40.512, 40.515]) * 3600.0 - (bearing + 10.0)
    bearings = (np.sum((plan - plan.mean()) ** 2) + np.sum(fixed**2)) / 10.0**2
    length = 889.2687
    held = np.array([889.26, 889.29, 889.28]) - length * np.array([1.0, 1.0, 1.0 + 5e-6])
    distances = float(np.sum(held**2)) / 0.5**2
    expected = 81.17685 - bearings - distances
    # One mean radius stands for those of two azimuths, 4 km apart from it: 0.001″ of refraction.
    assert solution.vtpv == pytest.approx(expected, abs=1e-3)


# -- a reference frame ----------------------------------------------------------------------------


def test_the_translation_of_a_reference_frame_is_a_vector_from_a_free_point(folder: Path) -> None:
    """testgx3, frame GPS_T: X + T observed at three held stations, σ 40, 60, 120 mm in e, n, u.

    SNAP prints T = (1.2000, −0.3000, 15.8000) m ± (0.0563, 0.0248, 0.0505) and correlations
    −0.3303, 0.5771, −0.2299. Here a free point, A − T for a constant A, is where the vectors to
    the stations start.
    """
    stations = snap.read_stations(folder / "in" / "testgx3.crd")
    network = Network("GPS_T", frame=FRAME)
    a = stations["1"]
    network.add_point("shifted", a)
    observed = {
        "1": (-4787263.3200, 560595.2704, -4163666.0023),
        "2": (-5257413.5321, 614999.4244, -3547268.5627),
        "3": (-4617768.4931, 1382498.4666, -4163194.4858),
    }
    for name, at in observed.items():
        network.add_point(name, stations[name], fixed="xyz")
        basis = FRAME.basis(stations[name][None], np.zeros((1, 2))).enu[0]
        covariance = basis.T @ np.diag(np.square([0.040, 0.060, 0.120])) @ basis
        network.add(GnssVector("shifted", name, tuple(at - a), covariance=covariance))
    solution = adjust(network)
    half = 0.5e-4
    np.testing.assert_allclose(a - solution.point("shifted"), [1.2, -0.3, 15.8], atol=half)
    covariance = solution.covariance("shifted")
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(sigma, [0.0563, 0.0248, 0.0505], atol=half)
    correlation = covariance / np.outer(sigma, sigma)
    printed = [-0.3303, 0.5771, -0.2299]
    np.testing.assert_allclose(correlation[[1, 2, 2], [0, 0, 1]], printed, atol=half)


def test_seconds_of_arc_are_read(folder: Path) -> None:
    assert dms("41", "00", "46.8", "S") == pytest.approx(np.radians(-41.013), abs=1e-15)
    assert len(snap.read_stations(folder / "in" / "test1.crd")) == 5
