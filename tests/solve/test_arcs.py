"""Strips of a lunar orbiter on arcs: gain, datum, gross errors, plans, arrivals, files, report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.network.network import Network
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.text import render_text
from factorgraph_adj.simulation.measurement import measure
from tests.networks.lunar_strips import GM_MOON, SIGMA_ARC, lunar_strips, measured

CONFIDENCE = 0.999


@pytest.fixture(scope="module")
def network() -> Network:
    return measured(lunar_strips(), 2)


@pytest.fixture(scope="module")
def solution(network: Network) -> fga.Solution:
    return fga.adjust(network)


def spread(plan: Network) -> dict[str, float]:
    """Return the standard deviation of each point of a plan."""
    solution = fga.plan(plan).solution
    return {p: float(np.sqrt(np.trace(solution.covariance(p)))) for p in solution.network.points}


def far_end(plan: Network) -> list[str]:
    """Return the points that are farthest from the control."""
    along = {name: p.coordinates[1] for name, p in plan.points.items()}
    return sorted(along, key=lambda p: -along[p])[:10]


def test_orbits_improve_every_point_and_tracked_ones_the_far_end_most() -> None:
    alone, tied = lunar_strips(arcs=False), lunar_strips()
    free, on_arcs = spread(alone), spread(tied)
    assert all(on_arcs[p] <= free[p] * (1.0 + 1e-9) for p in free)
    ratio = np.mean([on_arcs[p] / free[p] for p in far_end(alone)])
    assert ratio < 0.88
    tracked = lunar_strips()
    for name, arc in tracked.of_kind("arc").items():
        sigma = dict.fromkeys(("x", "y", "z"), 30.0) | dict.fromkeys(("x_t", "y_t", "z_t"), 0.03)
        tracked.set_unknown("arc", name, arc.values, fixed=("gm", "spin"), sigma=sigma)
    known = spread(tracked)
    assert np.mean([known[p] / free[p] for p in far_end(alone)]) < 0.15


def test_an_orbit_is_found_from_photos_that_are_known_roughly(
    network: Network, solution: fga.Solution
) -> None:
    plan = lunar_strips()
    lower, upper = stats.chi2.ppf([0.0005, 0.9995], solution.redundancy)
    assert lower < solution.vtpv < upper
    for name in plan.of_kind("arc"):
        found = solution.unknown("arc", name)
        error = (np.array(found.values) - plan.of_kind("arc")[name].values)[:6]
        assert (np.abs(error) < 4.0 * np.array(found.sigmas)[:6]).all()
        assert found.values[6] == GM_MOON


def errors_of(plan: Network, solution: fga.Solution) -> tuple[float, float]:
    """Return Σ eᵀ Q⁻¹ e of some points and of the arcs."""
    points = 0.0
    for p in list(plan.points)[::9]:
        e = np.array(solution.point(p)) - np.array(plan.points[p].coordinates)
        points += float(e @ np.linalg.solve(solution.covariance(p), e))
    arcs = 0.0
    for name, true in plan.of_kind("arc").items():
        key = ("arc", name)
        e = (np.array(solution.unknown("arc", name).values) - true.values)[:6]
        q = solution.variable_covariance(key, key)[:6, :6]
        arcs += float(e @ np.linalg.solve(q, e))
    return points, arcs


@pytest.mark.parametrize(
    "seeds",
    [
        8,
        pytest.param(
            200, marks=pytest.mark.slow("200 repetitions; eight show an error of the model only")
        ),
    ],
)
def test_points_and_orbits_scatter_as_their_covariances_say(seeds: int) -> None:
    plan = lunar_strips()
    vtpv = points = arcs = 0.0
    for seed in range(seeds):
        solution = fga.adjust(measured(plan, seed))
        vtpv += solution.vtpv
        more = errors_of(plan, solution)
        points, arcs = points + more[0], arcs + more[1]
    n_arcs = seeds * 6 * len(plan.of_kind("arc"))
    for total, n in ((vtpv, seeds * solution.redundancy), (arcs, n_arcs)):
        lower, upper = stats.chi2.ppf([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], n)
        assert lower < total < upper
    # Points of a strip err together: their sum scatters as one with fewer degrees of freedom.
    n = seeds * 3 * len(list(plan.points)[::9])
    assert total > 0.0 and abs(points / n - 1.0) < 6.0 / np.sqrt(seeds)


@pytest.mark.parametrize(
    ("options", "missing"),
    [
        ({"arcs": False}, 7),
        ({"gm": 0.0, "spin": 0.0}, 7),
        # GM tells scale and centre of the orbits; radially so weakly that it counts as missing.
        ({"spin": 0.0}, 4),
    ],
)
def test_gm_determines_scale_and_centre_and_no_rotation(
    options: dict[str, object], missing: int
) -> None:
    plan = lunar_strips(control=False, **options)  # type: ignore[arg-type]
    free = fga.adjust(measure(plan, seed=2), datum="free")
    assert free.datum_defect == missing
    with pytest.raises(fga.DatumError, match=r"missing (rotation about|shift in) x"):
        fga.adjust(measure(plan, seed=2))


def test_a_free_network_turns_with_its_orbits() -> None:
    """vᵀPv does not depend on the direction of the network."""
    plan = lunar_strips(control=False, gm=0.0, spin=0.0)
    one = measure(plan, seed=3)
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    other = one.copy()
    for name, p in one.points.items():
        x, y, z = (rotation @ p.coordinates).tolist()
        other.points[name] = replace(p, coordinates=(x, y, z))
    for name, f in one.photos.items():
        assert f.position is not None and f.rotation is not None
        x, y, z = (rotation @ f.position).tolist()
        other.photos[name] = replace(f, position=(x, y, z), rotation=rotation @ f.rotation)
    for name, arc in one.of_kind("arc").items():
        vectors = np.array(arc.values).reshape(-1)
        for first in (0, 3, 8):
            vectors[first : first + 3] = rotation @ vectors[first : first + 3]
        other.set_unknown("arc", name, vectors.tolist(), fixed=("gm", "spin"))
    found = [fga.adjust(n, datum="free") for n in (one, other)]
    assert found[0].datum_defect == found[1].datum_defect == 7
    assert found[0].vtpv == pytest.approx(found[1].vtpv, rel=1e-6)


def test_a_wrong_time_is_found(network: Network, solution: fga.Solution) -> None:
    """A photo that is dated 0.1 s late is 160 m off along the orbit, and that is found."""
    ident, late = next(
        (i, o) for i, o in network.observations.items() if getattr(o, "photo", "") == "F04"
    )
    wrong = without(network, [ident])
    wrong.add(replace(late, time=late.time + 0.1))
    by_chance = {r.id for r in fga.snoop(network).rejected}
    rejected = fga.snoop(wrong).rejected
    new = [r for r in rejected if r.id not in by_chance]
    assert len(new) == 1
    assert "F04" in str(new[0])


def test_an_altimeter_and_a_tracking_station_are_observations_that_exist(network: Network) -> None:
    """Altimeters are heights of photos above the sphere, or ranges from photos to points."""
    plan = lunar_strips()
    plan.set_profile("altimeter", free=("height",))
    for f in plan.photos:
        plan.add(fga.ProfileHeight(None, 0.0, photo=f, sigma=5.0, profile="altimeter"))
    before, after = spread(lunar_strips()), spread(plan)
    assert np.mean([after[p] / before[p] for p in before]) < 0.97
    ranged = lunar_strips()
    for f in ranged.photos:
        nearest = min(
            ranged.points,
            key=lambda p: np.linalg.norm(
                np.subtract(ranged.points[p].coordinates, ranged.photos[f].position)
            ),
        )
        ranged.add(fga.PhotoRange(nearest, f, 0.0, sigma=2.0))
    assert np.mean([spread(ranged)[p] / before[p] for p in before]) < 0.97
    found = fga.adjust(measure(ranged, seed=1))
    assert found.converged


def test_the_altimeter_between_photos_is_a_photo_without_an_image() -> None:
    plan = lunar_strips()
    sight = plan.photos["F03"]
    plan.add_photo(
        "shot",
        "camera",
        position=sight.position,
        rotation=sight.rotation,
        fixed=(True,) * 3 + (False,) * 3,
    )
    plan.add(fga.PhotoOnArc("shot", "pass 0", time=1.0, sigma=(SIGMA_ARC,) * 3))
    plan.add(fga.ProfileHeight(None, 46_000.0, photo="shot", sigma=5.0))
    found = fga.plan(plan).solution
    assert found.pose("shot").sigmas[3] < 6.0  # radially


def test_a_plan_has_the_precision_that_the_adjustment_has() -> None:
    plan = lunar_strips()
    made = fga.adjust(measure(plan, seed=1, noise=False))
    for name in plan.of_kind("arc"):
        planned, found = (s.unknown("arc", name) for s in (fga.plan(plan).solution, made))
        np.testing.assert_allclose(planned.sigmas, found.sigmas, rtol=1e-6)


def test_photos_arrive_on_their_arcs(network: Network, solution: fga.Solution) -> None:
    late = [i for i, o in network.observations.items() if getattr(o, "photo", "") == "F16"]
    points = [o for o in network.image_points() if o.photo == "F16"]
    first = without(network, [*late, *(f"F16/{o.point}" for o in points)])
    growing = fga.IncrementalAdjustment(first)
    growing.add([*points, *(network.observations[i] for i in late)])
    found = growing.solution()
    for p in list(network.points)[::7]:
        np.testing.assert_allclose(found.point(p), solution.point(p), atol=1e-2)
    np.testing.assert_allclose(
        found.unknown("arc", "pass 1").values[:6],
        solution.unknown("arc", "pass 1").values[:6],
        rtol=1e-7,
        atol=1e-4,
    )


def test_projects_keep_arcs(tmp_path: Path, network: Network, solution: fga.Solution) -> None:
    fga.write_project(network, tmp_path / "project.toml")
    back = fga.read_project(tmp_path / "project.toml")
    assert back.of_kind("arc") == network.of_kind("arc")
    assert fga.adjust(back).vtpv == pytest.approx(solution.vtpv, rel=1e-9)


def test_the_report_has_the_arc_with_velocities_per_second(solution: fga.Solution) -> None:
    text = render_text(Report(solution))
    assert "arc pass 0" in text
    assert "x_t [m/s]" in text


def test_a_wrong_call_adds_nothing_and_lists_every_problem() -> None:
    plan = lunar_strips(arcs=False)
    before = (dict(plan.observations), dict(plan.parameters))
    with pytest.raises(fga.InputError) as error:
        times, strange = {"F00": 0.0, "F9": np.nan}, {"q": 1.0}
        plan.add_arc("x", times, sigma=1.0, gm=-1.0, power=7, sigma_components=strange)
    text = str(error.value)
    for part in ("unknown photo 'F9'", "finite", "power must be 1 to 5", "negative", "'q'"):
        assert part in text
    assert (dict(plan.observations), dict(plan.parameters)) == before
    plan.photos["F00"] = replace(plan.photos["F00"], position=None)
    with pytest.raises(fga.InputError, match="give values of x, y, z"):
        plan.add_arc("x", {"F00": 0.0, "F01": 1.0}, sigma=1.0, gm=GM_MOON)
