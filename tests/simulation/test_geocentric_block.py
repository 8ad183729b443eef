"""A geocentric block with every kind of observation and unknown: truth, order, frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest
from scipy import stats

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.models.unknown_registry import VariableKind
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    ControlPoint,
    Correlated,
    GnssVector,
    Observation,
    PhotoPosition,
)
from factorgraph_adj.simulation.measurement import SimulatedNetwork, Truth
from factorgraph_adj.simulation.simulated_blocks import (
    DISTANCE_METER,
    DRONE_CALIBRATION,
    DRONE_CAMERA,
    PILLARS,
    QUARRY,
    REFRACTION,
    simulate_geocentric_block,
)
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array
from tests.support.arrivals import bare, chunks

pytestmark = pytest.mark.slow(
    "the scatter of a whole simulated block; short tests simulate each of its parts"
)

CONFIDENCE = 0.999
SEEDS = [
    4,
    pytest.param(
        20,
        marks=pytest.mark.slow(
            "sees variances of single points that are wrong by a factor of two; four repetitions "
            "see those that are wrong by a factor of four"
        ),
    ),
]
ROUNDING = 2e-9
"""Metres: two units in the last place of a geocentric coordinate."""
PART_OF_SIGMA = 1e-6
RESIDUAL_OF_ROUNDING = 1e-5
"""2 nm in an observation of σ 0.2 mm, the smallest here."""
T = TypeVar("T")


@pytest.fixture(scope="module")
def simulated() -> SimulatedNetwork:
    return simulate_geocentric_block(0)


@pytest.fixture(scope="module")
def solution(simulated: SimulatedNetwork) -> Solution:
    return adjust(simulated.network)


@pytest.mark.parametrize(
    "seed",
    [
        4,
        *(
            pytest.param(
                seed,
                marks=pytest.mark.slow(
                    "other two thirds, where other points are hardly determined"
                ),
            )
            for seed in (5, 8, 9, 10, 18)
        ),
    ],
)
def test_two_thirds_of_it_come_to_rest_as_near_as_the_coordinates_allow(
    simulated: SimulatedNetwork, seed: int
) -> None:
    """Steps of 1e-3 σ are not lost among the digits of geocentric coordinates."""
    network = bare(simulated.network)
    arrivals = chunks(simulated.network, seed)
    for together in arrivals[: len(arrivals) * 2 // 3]:
        network.add(*together)
    at_rest = adjust(network)
    for tolerance in (1e-7, 1e-9):  # the second is less than a unit in their last place
        nearer = adjust(network, tolerance=tolerance)
        assert nearer.converged, nearer.reason
        assert nearer.vtpv == pytest.approx(at_rest.vtpv, rel=1e-9)


# -- truth --------------------------------------------------------------------------------------


OF_STATIONS_AND_PHOTOS = {
    *("slope_distance", "horizontal_distance", "vertical_angle", "zenith_angle", "direction"),
    *("horizontal_angle", "azimuth", "height_difference", "astronomic_latitude"),
    *("astronomic_longitude", "gnss_vector", "gnss_position", "control", "photo_position", "image"),
}
"""Kinds of observation of stations and photos; random networks have those of frames and rigs."""


def unknowns(solution: Solution, truth: Truth) -> Iterator[tuple[VariableKind, str, Array, Array]]:
    """Yield kind, name, error and a mask of the free components of every physical unknown."""
    for name, true in truth.points.items():
        yield "point", name, solution.point(name) - true, np.ones(3, dtype=bool)
    for name in PILLARS:
        error = solution.vertical(name).values - truth.verticals[name].values
        yield "vertical", name, error, np.ones(2, dtype=bool)
    for name in REFRACTION:
        error = solution.refraction(name).values - truth.refractions[name].values
        yield "refraction", name, error, np.ones(1, dtype=bool)
    meter = solution.distance_meter(DISTANCE_METER).values
    error = meter - truth.distance_meters[DISTANCE_METER].values
    yield "edm", DISTANCE_METER, error, np.ones(2, dtype=bool)
    camera = truth.cameras[DRONE_CAMERA]
    error = solution.calibration(DRONE_CAMERA).values - camera.values
    yield "calibration", DRONE_CAMERA, error, np.isin(camera.lens.names, list(DRONE_CALIBRATION))


def test_every_kind_of_observation_and_unknown_takes_part(simulated: SimulatedNetwork) -> None:
    network = simulated.network
    kinds = {o.kind for o in network.observations.values()} | {"image"}
    assert kinds == OF_STATIONS_AND_PHOTOS
    assert network.clusters
    assert all(not any(p.fixed) for p in network.verticals.values())
    assert all(not any(p.fixed) for p in network.refractions.values())
    assert network.n_image_points > 100
    sets = {s for _, s in network.orientations}
    assert sets == {"1", "2"}


def test_all_unknowns_together_are_true_within_their_joint_covariance(
    simulated: SimulatedNetwork, solution: Solution
) -> None:
    """EᵀΣ⁻¹e over points, deflections, refraction, distance meter and calibration is χ².

    One figure for 141 unknowns with all their correlations, two-sided at 99.9 %.
    """
    assert solution.converged
    listed = list(unknowns(solution, simulated.truth))
    error = np.concatenate([e[free] for _, _, e, free in listed])
    sizes = np.cumsum([0, *(int(free.sum()) for _, _, _, free in listed)])
    covariance = np.zeros((sizes[-1], sizes[-1]))
    for i, (kind, name, _, free) in enumerate(listed):
        for j, (kind2, name2, _, free2) in enumerate(listed[: i + 1]):
            block = solution.variable_covariance((kind, name), (kind2, name2))
            block = block[np.ix_(free, free2)]
            covariance[sizes[i] : sizes[i + 1], sizes[j] : sizes[j + 1]] = block
            covariance[sizes[j] : sizes[j + 1], sizes[i] : sizes[i + 1]] = block.T
    scale = np.sqrt(np.diag(covariance))
    normalised = error / scale
    total = normalised @ np.linalg.solve(covariance / np.outer(scale, scale), normalised)
    tail = (1 - CONFIDENCE) / 2
    assert stats.chi2.ppf(tail, len(error)) < total < stats.chi2.isf(tail, len(error))


@pytest.fixture(scope="module", params=SEEDS)
def scatter(request: pytest.FixtureRequest) -> dict[tuple[str, str], tuple[float, int]]:
    """Return Σ eᵀΣ⁻¹e over the seeds, and its degrees of freedom, for each unknown."""
    sums: dict[tuple[str, str], tuple[float, int]] = {("vtpv", ""): (0.0, 0)}
    for seed in range(request.param):
        simulated = simulate_geocentric_block(seed)
        solution = adjust(simulated.network)
        assert solution.converged
        for kind, name, error, free in unknowns(solution, simulated.truth):
            covariance = solution.variable_covariance((kind, name))[np.ix_(free, free)]
            scale = np.sqrt(np.diag(covariance))
            e = error[free] / scale
            total, n = sums.get((kind, name), (0.0, 0))
            total += float(e @ np.linalg.solve(covariance / np.outer(scale, scale), e))
            sums[kind, name] = total, n + len(e)
        total, n = sums["vtpv", ""]
        sums["vtpv", ""] = total + solution.vtpv, n + solution.redundancy
    return sums


def test_each_unknown_scatters_as_its_covariance_says(
    scatter: dict[tuple[str, str], tuple[float, int]],
) -> None:
    """Over the repetitions, each point, deflection, refraction coefficient … and vᵀPv is χ²."""
    tail = (1 - CONFIDENCE) / 2 / len(scatter)
    for (kind, name), (total, n) in scatter.items():
        assert stats.chi2.ppf(tail, n) < total < stats.chi2.isf(tail, n), (kind, name)


# -- order and frame ----------------------------------------------------------------------------


def rebuilt(network: Network, *, topocentric: bool = False, seed: int | None = None) -> Network:
    """Return the same network in the frame of the quarry, or added in an order of its own.

    Points, photos, groups and observations are shuffled by ``seed``.
    """
    rng = None if seed is None else np.random.default_rng(seed)
    rotation = east_north_up() if topocentric else np.eye(3)

    def order(items: Iterable[T]) -> list[T]:
        listed = list(items)
        return listed if rng is None else [listed[i] for i in rng.permutation(len(listed))]

    def at(xyz: Sequence[float]) -> tuple[float, ...]:
        there = np.array(xyz)
        return tuple(QUARRY.from_geocentric(there).tolist() if topocentric else there.tolist())

    def moved(ident: str) -> Observation:
        o = replace(network.observations[ident], id=ident)
        if isinstance(o, GnssVector):
            o = replace(o, value=tuple((rotation @ np.array(o.value)).tolist()))
        elif isinstance(o, ControlPoint | PhotoPosition):
            o = replace(o, value=at(o.value))
        if getattr(o, "covariance", None) is not None:
            o = replace(o, covariance=rotation @ o.covariance @ rotation.T)
        return o

    out = Network(network.name, frame=QUARRY if topocentric else network.frame)
    for point in order(network.points.values()):
        out.add_point(point.name, at(point.coordinates))
    for name, camera in network.cameras.items():
        out.add_camera(name, camera.lens, camera.values, free=DRONE_CALIBRATION)
    for photo in order(network.photos.values()):
        turned = rotation @ photo.rotation
        out.add_photo(photo.name, photo.camera, position=at(photo.position), rotation=turned)
    out.verticals = dict(order(network.verticals.items()))
    out.refractions = dict(order(network.refractions.items()))
    out.distance_meters = dict(network.distance_meters)
    clustered = {ident for ids, _ in network.clusters for ident in ids}
    items = [moved(ident) for ident in network.observations if ident not in clustered]
    for ids, covariance in network.clusters:
        turn = np.kron(np.eye(len(ids)), rotation)
        items.append(Correlated(tuple(moved(i) for i in ids), turn @ covariance @ turn.T))
    out.add(*order(items), *order(network.image_points()))
    return out


def east_north_up() -> Array:
    """Return e, n, u of the quarry in geocentric axes, (3, 3), from its φ and λ."""
    phi, lam = QUARRY.latitude, QUARRY.longitude
    sp, cp, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


def assert_other_unknowns_agree(a: Solution, b: Solution) -> None:
    """Assert that what has no frame is the same to `PART_OF_SIGMA`, precision included."""
    pairs = [(a.calibration(DRONE_CAMERA), b.calibration(DRONE_CAMERA))]
    pairs += [(a.vertical(p), b.vertical(p)) for p in PILLARS]
    pairs += [(a.refraction(g), b.refraction(g)) for g in REFRACTION]
    pairs.append((a.distance_meter(DISTANCE_METER), b.distance_meter(DISTANCE_METER)))
    pairs += [(a.orientation(*k), b.orientation(*k)) for k in a.network.orientations]
    for mine, other in pairs:
        assert np.all(np.abs(mine.values - other.values) <= PART_OF_SIGMA * other.sigmas)
        assert np.allclose(mine.sigmas, other.sigmas, rtol=PART_OF_SIGMA, atol=0)


def test_the_order_of_observations_does_not_matter(
    simulated: SimulatedNetwork, solution: Solution
) -> None:
    """Shuffled points, photos, groups and observations change nothing but rounding.

    Geocentric coordinates are stored to 1 nm, half a millionth of their σ.
    """
    again = adjust(rebuilt(simulated.network, seed=1))
    assert list(again.network.observations) != list(simulated.network.observations)
    assert again.vtpv == pytest.approx(solution.vtpv, rel=PART_OF_SIGMA)
    for name in simulated.truth.points:
        assert np.allclose(again.point(name), solution.point(name), rtol=0, atol=ROUNDING)
        a, b = again.covariance(name), solution.covariance(name)
        assert np.abs(a - b).max() < PART_OF_SIGMA * np.trace(b)
    assert_other_unknowns_agree(again, solution)


def test_the_result_is_the_same_in_the_topocentric_frame(
    simulated: SimulatedNetwork, solution: Solution
) -> None:
    """Coordinates turned into east, north, up at the quarry: equal results, turned back.

    Points agree to 2 nm of rounding, covariances, residuals and all other unknowns to a
    millionth of their σ.
    """
    local = adjust(rebuilt(simulated.network, topocentric=True))
    rotation = east_north_up()
    assert local.redundancy == solution.redundancy
    assert local.vtpv == pytest.approx(solution.vtpv, rel=PART_OF_SIGMA)
    for name in simulated.truth.points:
        there = QUARRY.to_geocentric(local.point(name))
        assert np.allclose(there, solution.point(name), rtol=0, atol=ROUNDING)
        turned, b = rotation.T @ local.covariance(name) @ rotation, solution.covariance(name)
        assert np.abs(turned - b).max() < PART_OF_SIGMA * np.trace(b)
    assert_other_unknowns_agree(local, solution)
    # Residuals that do not turn with the frame.
    a, b = local.observations, solution.observations
    scalar = [i for i, r in enumerate(b) if not r.component and r.kind != "gnss_position"]
    assert [a[i].id for i in scalar] == [b[i].id for i in scalar]
    assert np.abs((a.normalised - b.normalised)[scalar]).max() < RESIDUAL_OF_ROUNDING
