"""Plans, proposals and what can be left out, against adjustments and exhaustive search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import factorgraph_adj as fga
from examples.published_blocks.el_hakim_1986 import aerial_1986_plan, close_range_1986_plan
from examples.published_blocks.industry_1981 import industry_block_plan
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import (
    ControlPoint,
    Correlated,
    GnssVector,
    HeightDifference,
    ImagePoint,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.planning.candidate_search import CandidateSearch
from factorgraph_adj.planning.candidates import identified, with_candidates
from factorgraph_adj.planning.targets import (
    DetectableError,
    PointPrecision,
    RedundancyNumber,
    SemiAxis,
    Shortfall,
    Target,
    UndetectedShift,
    for_points,
    lacking,
    point_figures,
)
from factorgraph_adj.quality.error_ellipses import confidence_factor
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import look_at, measure
from tests.networks.small_block import CENTRES, FOCAL, box
from tests.support.studies import cases

TARGETS: tuple[Target, ...] = (
    SemiAxis(1.5e-3),
    SemiAxis(2e-3, dimension=3, points=("P1*", "P6?")),
    PointPrecision(8e-4, axes="z"),
    RedundancyNumber(0.3, observations=("image", "slope_distance")),
    DetectableError(9.0, observations=("image",)),
    UndetectedShift(3e-3),
)


@pytest.fixture(scope="module")
def industry() -> fga.Network:
    return industry_block_plan()


def trilateration(seed: int) -> tuple[fga.Network, list[fga.Candidate]]:
    """A small network of distances, and distances that could be added."""
    rng = np.random.default_rng(seed)
    network = fga.Network("trilateration")
    for name, x, y in (("A", 0.0, 0.0), ("B", 100.0, 0.0), ("C", 50.0, 90.0)):
        network.add_point(name, (x, y, 0.0), fixed="xyz")
    points = [f"P{i}" for i in range(5)]
    for p in points:
        x, y = rng.uniform(0.0, 100.0, 2)
        network.add_point(p, (x, y, 0.0), fixed="z")
        for q in rng.choice(list("ABC"), 2, replace=False):
            network.add(SlopeDistance(str(q), p, 0.0, sigma=5e-3, id=f"{q}-{p}"))
    candidates: dict[str, fga.Candidate] = {}
    while len(candidates) < 8:
        a, b = (str(n) for n in rng.choice([*"ABC", *points], 2, replace=False))
        if (a in "ABC" and b in "ABC") or f"{b}={a}" in candidates:
            continue
        distance = SlopeDistance(a, b, 0.0, sigma=3e-3)
        cost = float(rng.integers(1, 6))
        candidates[f"{a}={b}"] = fga.Candidate(f"{a}={b}", (distance,), cost)
    return network, list(candidates.values())


def targets_for(network: fga.Network, candidates: list[fga.Candidate], seed: int) -> list[Target]:
    """Targets that all candidates together meet, and the network alone does not."""
    full = fga.plan(with_candidates(network, identified(candidates)))
    before = fga.plan(network)
    axis = SemiAxis(1.0)
    worst = [float(p.figures(axis)[1].max()) for p in (before, full)]
    out: list[Target] = [SemiAxis(0.5 * sum(worst))]
    own = ("?-P?",)
    r = float(full.figures(RedundancyNumber(0.5, observations=own))[1].min())
    if seed % 2 and r > 0.02:
        out.append(RedundancyNumber(0.5 * r, observations=own))
    shift = float(full.figures(UndetectedShift(1.0, observations=own))[1].max())
    if seed % 3 == 0 and np.isfinite(shift):
        out.append(UndetectedShift(1.3 * shift, observations=own))
    return out


# -- plans -------------------------------------------------------------------------------------


@pytest.mark.parametrize("block", [aerial_1986_plan, close_range_1986_plan])
def test_a_plan_is_the_reliability_of_a_realisation_at_truth(
    block: Callable[[], fga.Network],
) -> None:
    """Readings with errors, linearised where the plan is, have its figures to 1e-9."""
    design = block()
    found = fga.plan(design)
    measured = measure(design, seed=3)
    there = fga.adjust(measured, start=found.solution, max_iterations=0)
    rel = fga.reliability(there)
    own = found.reliability
    assert np.allclose(rel.redundancy_numbers, own.redundancy_numbers, rtol=0, atol=1e-9)
    assert np.allclose(rel.mdb, own.mdb, rtol=1e-9)
    assert np.allclose(rel.delta_bar, own.delta_bar, rtol=1e-8)
    assert np.allclose(
        there.point_covariances, found.solution.point_covariances, rtol=1e-9, atol=1e-18
    )


def test_observed_values_do_not_matter(industry: fga.Network) -> None:
    other = industry.copy()
    other.observations = {
        i: replace(o, value=7.0) if isinstance(o, HeightDifference) else o
        for i, o in industry.observations.items()
    }
    a, b = fga.plan(industry, TARGETS), fga.plan(other, TARGETS)
    assert [str(s) for s in a.shortfalls] == [str(s) for s in b.shortfalls]
    assert a.shortfalls


def test_shortfalls_are_what_the_figures_say(industry: fga.Network) -> None:
    """Each against figures from the solution, one by one."""
    found = fga.plan(industry, TARGETS)
    rel, solution = found.reliability, found.solution
    for s in found.shortfalls:
        t = s.target
        if isinstance(t, SemiAxis) and t.dimension == 2:
            want = fga.error_ellipse(solution, s.item, confidence=0.95).semi_axes[0]
        elif isinstance(t, SemiAxis):
            want = fga.error_ellipsoid(solution, s.item, confidence=0.95).semi_axes[0]
        elif isinstance(t, PointPrecision):
            want = solution.standard_deviations(s.item)[2]
        else:
            labels = [solution.equations.label(i) for i in range(solution.n_observations)]
            rows = [i for i, label in enumerate(labels) if label == s.item]
            if isinstance(t, RedundancyNumber):
                values = rel.redundancy_numbers[rows]
            elif isinstance(t, DetectableError):
                values = rel.mdb[rows] / solution.observations.sigmas[rows]
            else:
                continue
            want = values[np.argmin(np.abs(values - s.figure))]
        assert s.figure == pytest.approx(want, rel=1e-9)
    shifts = [s for s in found.shortfalls if isinstance(s.target, UndetectedShift)]
    assert shifts
    for s in shifts[:3]:
        if not np.isfinite(s.figure):
            continue
        rows = [i for i in range(solution.n_observations) if solution.equations.label(i) == s.item]
        far = [
            np.linalg.norm(e.values)
            for i in rows
            for e in rel.effect_on(i, list(found.network.points))  # type: ignore[union-attr]
        ]
        assert min(abs(f - s.figure) for f in far) < 1e-9


def test_every_point_and_photo_without_a_place_is_named() -> None:
    network = fga.Network()
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("P", (np.nan, np.nan, np.nan))
    network.add_point("Q", (1.0, np.nan, 0.0))
    network.add(SlopeDistance("A", "P", 0.0, sigma=1e-3), SlopeDistance("A", "Q", 0.0, sigma=1e-3))
    with pytest.raises(fga.InputError) as error:
        fga.plan(network)
    assert "'P'" in str(error.value)
    assert "'Q'" in str(error.value)


def test_bad_targets_are_told_all_at_once(industry: fga.Network) -> None:
    bad = (SemiAxis(-1.0), RedundancyNumber(1.5), SemiAxis(1e-3, points=("nobody",)))
    with pytest.raises(fga.InputError) as error:
        fga.plan(industry, bad)
    text = str(error.value)
    assert "greater than zero" in text
    assert "between 0 and 1" in text
    assert "'nobody'" in text


# -- proposals ---------------------------------------------------------------------------------


@pytest.mark.slow(
    "whole proposals are compared with the cheapest ones; short tests take single steps of a plan"
)
@pytest.mark.parametrize("seed", cases(range(6), [0, 1]))
def test_a_proposal_is_within_5_percent_of_the_cheapest(seed: int) -> None:
    """Against all subsets of eight candidates, each planned anew."""
    network, candidates = trilateration(seed)
    targets = targets_for(network, candidates, seed)
    found = fga.propose(network, candidates, targets)
    assert found.plan.met
    named = identified(candidates)
    by_cost = sorted(
        (sum(c.cost for c in chosen), n, chosen)
        for n, chosen in enumerate(s for k in range(len(named) + 1) for s in combinations(named, k))
    )
    cheapest = next(
        cost
        for cost, _, chosen in by_cost
        if fga.plan(with_candidates(network, chosen), targets).met
    )
    assert found.cost <= 1.05 * cheapest
    assert found.cost == sum(s.candidate.cost for s in found.steps)
    assert found.steps[-1].lack == pytest.approx(0.0, abs=1e-8)


def test_the_gain_of_a_candidate_is_that_of_a_plan_of_its_own(industry: fga.Network) -> None:
    """Of distances, of a photo with its pose, and of a new station with its point."""
    candidates = [
        fga.Candidate("tape", (SlopeDistance("P05", "P33", 0.0, sigma=5e-4),)),
        _photo(industry),
        fga.Candidate(
            "pillar",
            tuple(
                SlopeDistance("new", p, 0.0, sigma=5e-4)
                for p in ("P12", "P35", "P52", "P68", "P70")
            ),
            points=(Point("new", (7.0, 7.0, 3.0)),),
        ),
    ]
    candidates = identified(candidates)
    before = fga.plan(industry, TARGETS)
    search = CandidateSearch.of(before, candidates, TARGETS)
    own = sum(float(lacking(t, before.figures(t)[1]).sum()) for t in TARGETS)
    assert search.start.lack() == pytest.approx(own, rel=1e-9)
    items = {t: set(before.figures(t)[0]) for t in TARGETS}
    failing = {str(s.item) for s in before.shortfalls}
    for n, candidate in enumerate(candidates):
        told = search.told(n, search.known)
        assert told is not None
        after = fga.plan(with_candidates(industry, [candidate]), TARGETS)
        want = 0.0
        for t in TARGETS:
            names, figures = after.figures(t)
            lack = lacking(t, figures)
            want += sum(
                float(x)
                for name, x in zip(names, lack, strict=True)
                if name in items[t] and (name in failing or name in industry.points)
            )
        predicted = search.start.lack(search.start.update(told))
        assert predicted == pytest.approx(want, abs=1e-7)
        state = search.start.copy()
        search.take(state, search.known, n)
        assert state.lack() == pytest.approx(predicted, abs=1e-9)


def _photo(network: fga.Network) -> fga.Candidate:
    first = network.photos["photo 1"]
    assert first.position is not None
    photo = replace(first, name="extra", position=tuple(np.add(first.position, (1.5, 0.4, 0.3))))
    seen = [o.point for o in network.image_points() if o.photo == "photo 1"][::2]
    images = tuple(ImagePoint("extra", p, 0.0, 0.0, sigma=0.006) for p in seen)
    assert isinstance(photo, Photo)
    return fga.Candidate("photo", images, 4.0, photos=(photo,))


def test_a_target_that_no_candidate_can_meet_is_named() -> None:
    network, candidates = trilateration(1)
    with pytest.raises(fga.InputError) as error:
        fga.propose(network, candidates, [SemiAxis(1e-6, points=("P2",))])
    assert "P2" in str(error.value)
    assert "cannot be met" in str(error.value)


def test_bad_candidates_are_told_all_at_once() -> None:
    network, candidates = trilateration(1)
    bad = [
        *candidates,
        candidates[0],
        fga.Candidate("free", (SlopeDistance("A", "P1", 0.0, sigma=1e-3, id="x"),), 0.0),
        fga.Candidate("unknown", (SlopeDistance("A", "nowhere", 0.0, sigma=1e-3),)),
        fga.Candidate("empty", ()),
    ]
    with pytest.raises(fga.InputError) as error:
        fga.propose(network, bad, [SemiAxis(1e-2)])
    text = str(error.value)
    for part in ("two of this name", "greater than zero", "nowhere", "has no observations"):
        assert part in text


# -- what can be left out ----------------------------------------------------------------------


def grid(turn: float) -> fga.Network:
    """Sixteen points in a square, with the four-fold symmetry of a square, distances between all
    neighbours, turned about the z axis.
    """
    network = fga.Network("grid")
    c, s = np.cos(turn), np.sin(turn)
    places = [(i, j) for i in range(4) for j in range(4)]
    for i, j in places:
        x, y = 100.0 * i, 100.0 * j
        fixed = "xyz" if i in (0, 3) and j in (0, 3) else "z"
        network.add_point(f"P{i}{j}", (c * x - s * y, s * x + c * y, 0.0), fixed=fixed)
    for i, j in places:
        for k, m in ((i + 1, j), (i, j + 1), (i + 1, j + 1), (i + 1, j - 1)):
            if (k, m) in places:
                ident = f"{i}{j}-{k}{m}"
                network.add(SlopeDistance(f"P{i}{j}", f"P{k}{m}", 0.0, sigma=3e-3, id=ident))
    return network


def test_of_observations_that_are_worth_the_same_the_first_goes() -> None:
    """What rounding says of equal ones, another in each turn of the axes, does not matter."""
    first = fga.find_sparable(grid(0.0), SemiAxis(8e-3))
    assert len(first.ids) > 4
    for turn in (0.3, 1.1, 2.0):
        assert fga.find_sparable(grid(turn), SemiAxis(8e-3)).ids == first.ids


def test_what_is_spared_is_not_missed() -> None:
    """The targets are met without it, and not without any one more."""
    network, candidates = trilateration(2)
    network = with_candidates(network, identified(candidates))
    full = fga.plan(network)
    targets = [
        SemiAxis(1.3 * float(full.figures(SemiAxis(1.0))[1].max())),
        RedundancyNumber(0.5 * float(full.reliability.redundancy_numbers.min())),
    ]
    found = fga.find_sparable(network, targets)
    assert found.ids
    assert found.saved == len(found.ids)
    left = fga.without(network, found.ids)
    assert fga.plan(left, targets).met
    for ident in left.observations:
        try:
            assert not fga.plan(fga.without(left, [ident]), targets).met
        except fga.DatumError:
            continue


def test_what_fails_with_everything_cannot_spare_anything() -> None:
    network, _ = trilateration(2)
    with pytest.raises(fga.InputError, match="fails already"):
        fga.find_sparable(network, [SemiAxis(1e-6)])


# -- what planning anew says -------------------------------------------------------------------

FIELD = {
    "A": (0.0, 0.0, 10.0),
    "B": (90.0, 5.0, 22.0),
    "C": (80.0, 95.0, 15.0),
    "D": (-10.0, 85.0, 28.0),
    "P": (40.0, 35.0, 19.0),
    "Q": (55.0, 60.0, 12.0),
    "R": (20.0, 62.0, 16.0),
}
"""Points with distances between all of them."""


def field(*, free: bool = True, skip: tuple[tuple[str, str], ...] = ()) -> fga.Network:
    network = fga.Network("field", datum="free" if free else "given")
    for name, xyz in FIELD.items():
        network.add_point(name, xyz, fixed="" if free or name not in "ABC" else "xyz")
    for a, b in combinations(FIELD, 2):
        if (a, b) not in skip and (free or not (a in "ABC" and b in "ABC")):
            network.add(SlopeDistance(a, b, 0.0, sigma=3e-3, id=f"{a}-{b}"))
    return network


def pillar(name: str, at: tuple[float, float, float], to: str, cost: float = 1.0) -> fga.Candidate:
    sights = tuple(SlopeDistance(name, k, 0.0, sigma=1e-3) for k in to)
    return fga.Candidate(name, sights, cost, points=(Point(name, at),))


def levels(held: str = "A", free: str = "P") -> fga.Network:
    """Points of known place whose heights are asked for."""
    network = fga.Network("levels")
    for i, name in enumerate(held):
        network.add_point(name, (50.0 * i, 0.0, 0.0), fixed="xyz")
    for i, name in enumerate(free):
        network.add_point(name, (10.0 * i, 0.0, 1.0), fixed="xy")
    return network


def level(a: str, b: str, sigma: float, ident: str | None = None) -> HeightDifference:
    return HeightDifference(a, b, 0.0, sigma=sigma, id=ident)


def cheapest(
    network: fga.Network, candidates: list[fga.Candidate], targets: list[Target]
) -> float | None:
    """Cost of the cheapest of all subsets, each planned anew; none where none meets them."""
    best: float | None = None
    for k in range(len(candidates) + 1):
        for chosen in combinations(identified(candidates), k):
            cost = sum(c.cost for c in chosen)
            if (best is None or cost < best) and fga.plan(
                with_candidates(network, chosen), targets
            ).met:
                best = cost
    return best


def assert_predicted(
    network: fga.Network, candidates: list[fga.Candidate], targets: tuple[Target, ...]
) -> None:
    """What candidates leave lacking of the design's items is that of a plan with each."""
    before = fga.plan(with_candidates(network, []), targets)
    every = identified(candidates)
    targets = tuple(for_points(t, list(network.points)) for t in targets)
    search = CandidateSearch.of(before, every, targets)
    for n, candidate in enumerate(every):
        told = search.told(n, search.known)
        assert told is not None
        after, want = fga.plan(with_candidates(network, [candidate]), targets), 0.0
        for t in targets:
            # Where labels are shared the figures of what fails are all asked for.
            old = set(before.figures(t)[0])
            names, figures = after.figures(t)
            lack = lacking(t, figures)
            want += sum(float(x) for name, x in zip(names, lack, strict=True) if name in old)
        assert search.start.lack(search.start.update(told)) == pytest.approx(want, rel=1e-9)


HARD: tuple[Target, ...] = (
    SemiAxis(1e-7),
    SemiAxis(1e-7, dimension=3),
    RedundancyNumber(0.9999),
    UndetectedShift(1e-8),
)
"""All items fail them, so that all are compared."""


def block(**camera: object) -> fga.Network:
    network = fga.Network("block")
    for i, (name, at) in enumerate(box().items()):
        network.add_point(name, at, fixed="xyz" if i in (0, 4, 7) else "")
    network.add_camera("D3", BrownLens(), {"c": FOCAL, "k1": 1e-4}, **camera)  # type: ignore[arg-type]
    for i, centre in enumerate(CENTRES[:3]):
        turn = look_at(np.array(centre), np.array([0, 0, 1.0]))
        turn = turn @ exp_rotation(np.array([0, 0, 1.5 * i]))
        network.add_photo(f"F{i}", "D3", position=centre, rotation=turn)
        for p in network.points:
            network.add(ImagePoint(f"F{i}", p, 0.0, 0.0, sigma=0.006))
    return network


def photo_of(network: fga.Network, count: int = 99, **weights: float) -> fga.Candidate:
    other, centre = network.copy(), CENTRES[3]
    turn = look_at(np.array(centre), np.array([0, 0, 1.0]))
    other.add_photo("X", "D3", position=centre, rotation=turn, **weights)  # type: ignore[arg-type]
    seen = list(network.points)[:count]
    images = tuple(ImagePoint("X", p, 0.0, 0.0, sigma=0.006) for p in seen)
    return fga.Candidate("X", images, photos=(other.photos["X"],))


@pytest.mark.parametrize(
    ("camera", "weights"),
    [
        ({"free": ("c",)}, {"sigma_position": 0.01, "sigma_attitude": 1e-3}),
        ({"sigma": {"c": 0.01, "x0": 0.02}, "per_photo": True}, {}),
        ({"sigma": {"c": 0.01, "x0": 0.02}}, {}),
    ],
)
def test_weights_of_a_photo_that_is_added_count(
    camera: dict[str, object], weights: dict[str, float]
) -> None:
    """Of its pose, and of its own camera."""
    network = block(**camera)
    assert_predicted(network, [photo_of(network, **weights)], HARD)


def test_a_photo_with_a_known_pose_needs_few_points() -> None:
    """Two image points do not determine a pose, but that is weighted."""
    network = block()
    candidate = photo_of(network, 2, sigma_position=1e-3, sigma_attitude=1e-5)
    point = str(list(network.points)[1])
    axis = SemiAxis(1.0, points=(point,), dimension=3)
    plans = [fga.plan(with_candidates(network, c)) for c in ([], [candidate])]
    limit = 0.5 * sum(float(p.figures(axis)[1][0]) for p in plans)
    assert fga.propose(network, [candidate], [replace(axis, at_most=limit)]).names == ("X",)


def test_the_datum_of_a_free_network_stays_that_of_the_design() -> None:
    """A new point has no part in it, flagged or not."""
    network = field()
    new = pillar("N", (30.0, 20.0, 35.0), "ABCPQR")
    other = pillar("M", (30.0, 40.0, 5.0), "ABCPQR")
    flagged = replace(other, points=(replace(other.points[0], datum=True),))
    assert_predicted(network, [new, flagged], HARD)
    found = with_candidates(network, identified([flagged]))
    assert {n for n, p in found.points.items() if p.datum} == set(FIELD)
    assert not any(p.datum for p in network.points.values()), "the design is not changed"


@pytest.mark.parametrize("seed", [9, 13])
def test_a_proposal_for_a_free_network_is_the_cheapest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    network = field(skip=(("A", "P"), ("B", "P"), ("D", "Q")))
    candidates = []
    for i in range(3):
        at = tuple(rng.uniform([-30, -30, 0], [120, 120, 60]).tolist())
        to = "".join(rng.choice(list(FIELD), 5, replace=False))
        candidates.append(pillar(f"N{i}", at, to, float(rng.integers(1, 4))))
    for a, b in ("AP", "RP", "DQ"):
        tape = SlopeDistance(a, b, 0.0, sigma=1e-3)
        candidates.append(fga.Candidate(f"t{a}{b}", (tape,), float(rng.integers(1, 4))))
    worst = float(fga.plan(network).figures(SemiAxis(1.0))[1].max())
    targets: list[Target] = [SemiAxis(0.85 * worst)]
    found = fga.propose(network, candidates, targets)
    assert found.plan.met
    assert found.cost == cheapest(network, candidates, targets)
    assert found.steps[-1].lack == 0.0


def test_what_determines_the_datum_of_a_free_network_is_refused() -> None:
    """Control, vectors and directions of gravity by name; a distance between points is none."""
    sight = {"target": "B", "value": 0.0, "sigma": 1e-5}
    candidates = [
        fga.Candidate("tape", (SlopeDistance("P", "Q", 0.0, sigma=1e-3),)),
        fga.Candidate(
            "pillar",
            pillar("N", (30.0, 20.0, 35.0), "ABCPQR").observations,
            points=(Point("N", (30.0, 20.0, 35.0)),),
        ),
        fga.Candidate("control", (ControlPoint("P", (0, 0, 0), sigma=(1e-3,) * 3),)),
        fga.Candidate("vector", (GnssVector("A", "P", (0, 0, 0), covariance=1e-6 * np.eye(3)),)),
        fga.Candidate("plumb", (ZenithAngle("P", **sight),)),  # type: ignore[arg-type]
    ]
    targets = [SemiAxis(1e-3)]
    with pytest.raises(fga.InputError) as error:
        fga.propose(field(), candidates, targets)
    named = [p.where for p in error.value.problems]
    assert named == ["candidate 'control'", "candidate 'vector'", "candidate 'plumb'"]
    assert "leaves open" in str(error.value)


def test_a_flat_region_is_one_whatever_rounding_leaves() -> None:
    """Three datum points: the ellipsoid of each is an ellipse, its third axis ±1e-13."""
    network = field()
    for name in "ABC":
        network.points[name] = replace(network.points[name], datum=True)
    factors = []
    for ident in list(network.observations)[:8]:
        found = fga.plan(fga.without(network, [ident]))
        figures = found.figures(SemiAxis(1.0, points=("A", "B", "C"), dimension=3))[1]
        blocks = found.solution.point_covariances[:3]
        largest = np.linalg.eigvalsh(blocks)[:, -1]
        factors.append(figures / np.sqrt(largest))
    assert np.allclose(factors, confidence_factor(2, 0.95), rtol=1e-6)
    tilted = np.diag([4.0, 1.0, 6e-13])
    figure = point_figures(SemiAxis(1.0, dimension=3), tilted[None], np.zeros((1, 2, 3)))
    assert figure[0] == pytest.approx(2 * confidence_factor(2, 0.95))


# -- choices -----------------------------------------------------------------------------------


def test_a_candidate_whose_own_observations_fail_does_not_block_others() -> None:
    network = levels()
    network.add(*(level("A", "P", 3e-3, f"d{i}") for i in range(3)))
    strong = fga.Candidate("strong", (level("A", "P", 2e-4),), 1.0)
    three = fga.Candidate("three", tuple(level("A", "P", 1.5e-3) for _ in range(3)), 2.0)
    targets: list[Target] = [PointPrecision(1e-3, axes="z"), RedundancyNumber(0.3)]
    found = fga.propose(network, [strong, three], targets)
    assert found.names == ("three",)
    assert found.cost == cheapest(network, [strong, three], targets)


def tied() -> tuple[fga.Network, fga.Candidate]:
    """A point Q whose strong observation nothing much controls, and a tie that carries it to P."""
    network = levels("AB", "PQ")
    network.add(level("A", "P", 1e-3, "a1"), level("A", "P", 1e-3, "a2"))
    network.add(level("B", "Q", 1e-4, "l1"), level("B", "Q", 0.01, "l2"))
    return network, fga.Candidate("tie", (level("P", "Q", 1e-4),), 1.0)


def test_a_candidate_that_carries_errors_to_a_point_does_not_block_others() -> None:
    network, tie = tied()
    good = fga.Candidate("good", tuple(level("A", "P", 3e-4) for _ in range(2)), 3.0)
    targets: list[Target] = [
        PointPrecision(4e-4, axes="z", points=("P",)),
        UndetectedShift(1e-4, points=("P",), observations=("l1",)),
    ]
    found = fga.propose(network, [tie, good], targets)
    assert found.names == ("good",)
    assert found.cost == cheapest(network, [tie, good], targets)


def test_shifts_that_fail_with_all_candidates_are_not_hopeless() -> None:
    network, tie = tied()
    more = fga.Candidate("more", tuple(level("B", "Q", 1e-4) for _ in range(2)), 1.0)
    targets: list[Target] = [
        UndetectedShift(1e-3, points=("Q",), observations=("l1",)),
        UndetectedShift(1e-5, points=("P",), observations=("l1",)),
    ]
    assert fga.plan(with_candidates(network, identified([tie, more])), targets).shortfalls
    found = fga.propose(network, [tie, more], targets)
    assert found.names == ("more",)
    assert found.cost == cheapest(network, [tie, more], targets)


def test_candidates_that_need_another_are_named_with_it() -> None:
    network = field(free=False)
    first = pillar("N", (30.0, 20.0, 35.0), "ABC")
    second = fga.Candidate("second", (SlopeDistance("N", "P", 0.0, sigma=1e-4),))
    for order in ([first, second], [second, first]):
        with pytest.raises(fga.InputError) as error:
            fga.propose(network, order, [SemiAxis(1e-3)])
        (problem,) = error.value.problems
        assert problem.where == "candidate 'second'"
        assert "point 'N', which candidate 'N' brings" in problem.what


def test_a_candidate_that_does_not_determine_its_point_is_named() -> None:
    """With too few sights, or none; the others are complete."""
    weak = pillar("N", (30.0, 20.0, 35.0), "AB")
    good = pillar("M", (30.0, 20.0, 35.0), "ABC")
    tape = (SlopeDistance("P", "Q", 0.0, sigma=1e-3),)
    unseen = fga.Candidate("unseen", tape, points=(Point("U", (1.0, 2.0, 3.0)),))
    for bad, point in ((weak, "N"), (unseen, "U")):
        with pytest.raises(fga.InputError) as error:
            fga.propose(field(free=False), [good, bad], [SemiAxis(1e-3)])
        (problem,) = error.value.problems
        assert problem.where == f"candidate {bad.name!r}"
        assert f"do not determine what it brings (point {point!r})" in problem.what


@pytest.mark.parametrize("unit", [1e-10, 1e9])
def test_costs_are_in_any_unit(unit: float) -> None:
    network, candidates = trilateration(0)
    targets = targets_for(network, candidates, 0)
    want = fga.propose(network, candidates, targets)
    scaled = [replace(c, cost=c.cost * unit) for c in candidates]
    assert fga.propose(network, scaled, targets).names == want.names


def test_gains_and_lacks_are_those_of_plans_with_all_observations() -> None:
    """A station's own sights count: what mends only them has a gain."""
    network = levels("A", "PQ")
    network.add(*(level("A", p, 1e-3, f"{p}{i}") for p in "PQ" for i in range(4)))
    tie = fga.Candidate("tie", (level("P", "Q", 2e-4),), 1.0)
    again = fga.Candidate("again", (level("P", "Q", 2e-4),), 1.0)
    targets: list[Target] = [SemiAxis(1.0), PointPrecision(4e-4, axes="z"), RedundancyNumber(0.2)]
    found = fga.propose(network, [tie, again], targets)
    assert len(found.steps) == 2
    chosen = [s.candidate for s in found.steps]
    lack = fga.plan(network, targets).lack
    for n, step in enumerate(found.steps, 1):
        after = fga.plan(with_candidates(network, chosen[:n]), targets)
        assert step.lack == pytest.approx(after.lack, rel=1e-9)
        assert step.gain == pytest.approx(lack - after.lack, rel=1e-9)
        assert (step.lack == 0.0) == after.met
        lack = after.lack
    assert found.steps[0].lack > 0
    text = str(found)
    assert all(word in text for word in ("cost", "together", "gain", "lack", "tie", "again"))
    assert len(repr(found)) < 80


# -- what names nothing, and what is no number -------------------------------------------------


@pytest.mark.parametrize(
    ("target", "part"),
    [
        (RedundancyNumber(0.9, observations=("slope_distanc",)), "'slope_distanc'; there are: sl"),
        (DetectableError(0.1, observations="imag*"), "'imag*'"),
        (UndetectedShift(1e-9, observations=("dist",)), "'dist'"),
        (RedundancyNumber(0.9, observations=()), "names no observations"),
        (SemiAxis(1e-9, points=()), "names no points"),
        (SemiAxis(1e-9, points="X*"), "'X*'; there are: A, B"),
        (UndetectedShift(1e-9, points=("A", "B")), "all its points are held"),
        (SemiAxis(1e-9, dimension=4), "dimension must be 2 or 3"),  # type: ignore[arg-type]
        (SemiAxis(1e-9, dimension=1), "dimension must be 2 or 3"),  # type: ignore[arg-type]
        (SemiAxis(1e-9, confidence=95), "probability between 0 and 1, not 95"),
        (SemiAxis("1mm"), "must be a number, not '1mm'"),  # type: ignore[arg-type]
        (RedundancyNumber(1e-7), "[1e-06, 1)"),
        (RedundancyNumber(1.0), "[1e-06, 1)"),
    ],
)
def test_a_target_that_asks_nothing_is_told(target: Target, part: str) -> None:
    network, candidates = trilateration(1)
    for call in (
        lambda: fga.plan(network, [target]),
        lambda: fga.propose(network, candidates, [target]),
        lambda: fga.find_sparable(network, [target]),
    ):
        with pytest.raises(fga.InputError) as error:
            call()
        assert part in str(error.value)
        assert "target 1" in str(error.value)
        assert "9500 %" not in str(error.value)


def test_a_target_may_ask_for_observations_of_candidates_alone() -> None:
    network, candidates = trilateration(1)
    dearer = [
        replace(c, observations=[replace(c.observations[0], id=f"new {c.name}")])
        for c in candidates
    ]  # type: ignore[type-var]
    worst = float(fga.plan(network).figures(SemiAxis(1.0))[1].max())
    targets = [SemiAxis(0.95 * worst), RedundancyNumber(1e-6, observations=("new *",))]
    assert fga.propose(network, dearer, targets).plan.met  # type: ignore[arg-type]


def test_a_string_is_one_pattern_and_a_target_alone_a_sequence() -> None:
    network, candidates = trilateration(1)
    assert RedundancyNumber(0.2, observations="image").observations == ("image",)
    assert SemiAxis(1.0, points="P*").points == ("P*",)  # type: ignore[arg-type]
    one, many = fga.plan(network, SemiAxis(1e-6)), fga.plan(network, [SemiAxis(1e-6)])
    assert [str(s) for s in one.shortfalls] == [str(s) for s in many.shortfalls]
    with pytest.raises(fga.InputError, match="is no target"):
        fga.plan(network, (SemiAxis,))  # type: ignore[arg-type]
    with pytest.raises(fga.InputError, match="must be a sequence"):
        fga.plan(network, 3)  # type: ignore[arg-type]
    for call in (
        lambda: fga.propose(network, candidates, ()),
        lambda: fga.find_sparable(network, ()),
    ):
        with pytest.raises(fga.InputError, match="no targets"):
            call()


def test_brackets_in_names_stand_for_themselves() -> None:
    network = levels("A", ["P[1]", "P1", "P*"])  # type: ignore[arg-type]
    for name, sigma in (("P[1]", 1e-3), ("P1", 2e-3), ("P*", 3e-3)):
        network.add(level("A", name, sigma))
    found = fga.plan(network)
    assert found.figures(PointPrecision(1.0, ("P[1]",)))[0] == ["P[1]"]
    assert found.figures(PointPrecision(1.0, ("P?1*",)))[0] == ["P[1]"]
    written = for_points(PointPrecision(1.0, ("P[*", "P?")), ["P[1]", "P*"])
    assert found.figures(written)[0] == ["P[1]", "P*"]


def test_a_candidate_may_have_one_observation_without_a_tuple() -> None:
    network, candidates = trilateration(1)
    (distance,) = candidates[0].observations
    assert fga.Candidate("a", distance).observations == (distance,)  # type: ignore[arg-type]
    bad: list[object] = [fga.Candidate("a", distance, "2 h"), fga.Candidate("b", "x")]  # type: ignore[arg-type]
    with pytest.raises(fga.InputError, match="must be a number, not '2 h'"):
        fga.propose(network, bad[:1], [SemiAxis(1e-3)])  # type: ignore[arg-type]
    with pytest.raises(fga.InputError, match="candidate 'b': is no observation: 'x'"):
        fga.propose(network, bad, [SemiAxis(1e-3)])  # type: ignore[arg-type]
    with pytest.raises(fga.InputError, match="is no Candidate"):
        fga.propose(network, [distance], [SemiAxis(1e-3)])  # type: ignore[list-item]


def test_a_shortfall_differs_from_its_limit_in_print() -> None:
    text = str(Shortfall(RedundancyNumber(0.15), "l", 0.149998))
    assert text == "l: redundancy number 0.149998 < 0.15"
    assert str(Shortfall(SemiAxis(1e-3), "P", 2e-3)).endswith("0.002 > 0.001")


# -- what is spared ----------------------------------------------------------------------------


@pytest.mark.parametrize("own_ids", [False, True])
def test_image_points_are_spared_whatever_their_names(own_ids: bool) -> None:
    """Photos with a slash in their names, and image points with ids of their own."""
    network = fga.Network("aerial")
    for i, (name, at) in enumerate(box().items()):
        network.add_point(name, at, fixed="xyz" if i in (0, 4, 7) else "")
    network.add_camera("D3", BrownLens(), {"c": FOCAL})
    for i, centre in enumerate(CENTRES[:3]):
        turn = look_at(np.array(centre), np.array([0, 0, 1.0]))
        network.add_photo(f"1/{i}", "D3", position=centre, rotation=turn)
        for p in network.points:
            ident = f"i{i}{p}" if own_ids else None
            network.add(ImagePoint(f"1/{i}", p, 0.0, 0.0, sigma=0.006, id=ident))
    found = fga.find_sparable(network, [SemiAxis(100.0)])
    assert found.ids
    assert all(i.startswith("i" if own_ids else "1/") for i in found.ids)
    assert fga.plan(fga.without(network, found.ids)).network.n_image_points == (
        network.n_image_points - len(found.ids)
    )


def test_what_saves_most_for_what_it_takes_is_spared_first() -> None:
    """Eight weak observations for 8, not the strong one for 1.5, however many others there are."""
    others = [f"F{i}" for i in range(10)]
    network = levels("A", ["P", *others])  # type: ignore[arg-type]
    network.add(*(level("A", f, 1e-3, f"f{f}") for f in others))
    network.add(level("A", "P", 1e-3, "big"))
    network.add(*(level("A", "P", 3e-3, f"s{i}") for i in range(8)))
    targets = [
        PointPrecision(1e-3 / np.sqrt(0.88), axes="z", points=("P",)),
        PointPrecision(1.01e-3, axes="z", points=("F*",)),
    ]
    found = fga.find_sparable(network, targets, cost={"big": 1.5})
    assert set(found.ids) == {f"s{i}" for i in range(8)}
    assert found.saved == 8.0
    assert "s0" in str(found)
    assert repr(found) == "<Spared: 8 observations, cost 8>"


def test_bad_costs_and_patterns_of_what_may_go_are_told_all_at_once() -> None:
    network = levels()
    network.add(*(level("A", "P", 1e-3, f"p{i}") for i in range(3)))
    with pytest.raises(fga.InputError) as error:
        fga.find_sparable(
            network,
            [PointPrecision(2e-3, axes="z")],
            observations=("zzz", "p0"),
            cost={"p9": 1.0, "p*": 1.0, "p0": 0.0, "p1": -5.0, "p2": np.nan},
        )
    text = str(error.value)
    assert "like 'zzz'; there are: height_difference, p0" in text
    for ident in ("p9", "p*", "p0", "p1", "p2"):
        assert f"cost of {ident!r}" in text
    with pytest.raises(fga.InputError, match="names no observations"):
        fga.find_sparable(network, [PointPrecision(2e-3, axes="z")], observations=())
    found = fga.find_sparable(network, PointPrecision(2e-3, axes="z"), observations="p0")
    assert found.ids == ("p0",)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0), (2, 1, 0)])
def test_the_order_of_a_correlated_group_need_not_be_that_of_the_rows(
    order: tuple[int, ...],
) -> None:
    """The order was taken for that of the rows: `propose` failed, or gave wrong figures."""
    joint = 1e-6 * np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -2.0], [0.5, -2.0, 6.0]])
    network = fga.Network("group")
    for name, at in (("A", (0, 0, 0)), ("B", (90, 5, 3)), ("C", (30, 80, 6))):
        network.add_point(name, at, fixed="xyz")
    network.add_point("P", (40.0, 30.0, 2.0))
    network.add(level("C", "P", 0.01, "first"))
    group = (
        level("A", "P", 1.0, "h"),
        SlopeDistance("A", "P", 0.0, sigma=1.0, id="a"),
        SlopeDistance("B", "P", 0.0, sigma=1.0, id="b"),
    )
    members = tuple(group[i] for i in order)
    network.add(Correlated(members, joint[np.ix_(order, order)]))
    network.add(SlopeDistance("C", "P", 0.0, sigma=0.02, id="c"))
    candidates = [
        fga.Candidate("weak", (SlopeDistance("C", "P", 0.0, sigma=5e-3),), cost=1.0),
        fga.Candidate("first", (SlopeDistance("B", "P", 0.0, sigma=2e-3),), cost=2.0),
        fga.Candidate("second", (SlopeDistance("A", "P", 0.0, sigma=2e-3),), cost=3.0),
        fga.Candidate("third", (level("C", "P", 2e-3),), cost=2.5),
    ]
    targets: list[Target] = [RedundancyNumber(0.4, observations=("h", "a", "b"))]
    assert fga.plan(network, targets).shortfalls
    found = fga.propose(network, candidates, targets)
    assert found.cost == cheapest(network, candidates, targets)
    assert found.plan.met
