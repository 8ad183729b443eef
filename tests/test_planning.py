"""Plans, proposals and what can be left out, against adjustments and exhaustive search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli import main
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.experiment.el_hakim_1986 import aerial_1986_plan, close_range_1986_plan
from factorgraph_adj.experiment.industry_block import industry_block_plan
from factorgraph_adj.experiment.simulate import measure
from factorgraph_adj.observations import HeightDifference, ImagePoint, SlopeDistance
from factorgraph_adj.planning.candidates import identified, with_candidates
from factorgraph_adj.planning.propose import _Search
from factorgraph_adj.planning.targets import (
    DetectableError,
    PointPrecision,
    RedundancyNumber,
    SemiAxis,
    Target,
    UndetectedShift,
    lacking,
)

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


@pytest.mark.parametrize("seed", range(6))
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
    search = _Search.of(before, candidates, TARGETS)
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
        predicted = search.start.lack(search.start.change(told))
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


def test_what_is_spared_is_not_missed() -> None:
    """The targets are met without it, and not without any one more."""
    network, candidates = trilateration(2)
    network = with_candidates(network, identified(candidates))
    full = fga.plan(network)
    targets = [
        SemiAxis(1.3 * float(full.figures(SemiAxis(1.0))[1].max())),
        RedundancyNumber(0.5 * float(full.reliability.redundancy_numbers.min())),
    ]
    found = fga.spare(network, targets)
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
        fga.spare(network, [SemiAxis(1e-6)])


# -- commands ----------------------------------------------------------------------------------

POINTS = """name,x,y,z,fixed
A,0,0,0,xyz
B,100,0,0,xyz
P1,40,60,5,
P2,70,50,8,
"""
OBSERVATIONS = """kind,station,target,sigma_mm
slope_distance,A,P1,1
slope_distance,B,P1,1
height_difference,A,P1,1
slope_distance,A,P2,1
slope_distance,B,P2,1
height_difference,B,P2,1
"""
WISHES = """
[[target]]
kind = "semi_axis"
at_most = 0.0022
[[candidate]]
name = "set-up C"
cost = 5
points = [{name = "C", x = 50, y = 120, z = 0}]
observations = [
  {kind = "slope_distance", station = "C", target = "A", sigma_mm = 1.0},
  {kind = "slope_distance", station = "C", target = "B", sigma_mm = 1.0},
  {kind = "slope_distance", station = "C", target = "P1", sigma_mm = 1.0},
  {kind = "slope_distance", station = "C", target = "P2", sigma_mm = 1.0},
  {kind = "height_difference", station = "A", target = "C", sigma_mm = 1.0},
]
[files]
candidates = "more.csv"
"""
MORE = """candidate,cost,kind,station,target,sigma_mm
tape,2,slope_distance,P1,P2,0.5
level,3,height_difference,B,P1,1
level,3,height_difference,P1,P2,1
"""


@pytest.fixture
def dam(tmp_path: Path) -> Path:
    (tmp_path / "project.toml").write_text(
        'name = "dam"\n[files]\npoints = "points.csv"\nobservations = "observations.csv"\n'
    )
    (tmp_path / "points.csv").write_text(POINTS)
    (tmp_path / "observations.csv").write_text(OBSERVATIONS)
    (tmp_path / "wishes.toml").write_text(WISHES)
    (tmp_path / "more.csv").write_text(MORE)
    return tmp_path


def test_the_command_plans_without_readings(dam: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(dam), "--targets", str(dam / "wishes.toml")]) == 1
    out = capsys.readouterr().out
    assert "6 observations, 6 unknowns, redundancy 0" in out
    assert "2 fail" in out
    assert main(["adjust", str(dam)]) == 2, "an adjustment needs them"


def test_the_command_proposes(dam: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["propose", str(dam), str(dam / "wishes.toml")])
    out = capsys.readouterr().out
    assert code == 0, out
    assert "To be added, cost" in out
    assert ": met" in out


def test_the_command_tells_everything_that_is_wrong_with_a_file(
    dam: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (dam / "wishes.toml").write_text(
        '[[target]]\nkind = "beauty"\n[[target]]\nkind = "semi_axis"\nat_mots = 1\n'
        '[[candidate]]\nname = "x"\nobservations = [{kind = "slope_distance", station = "A"}]\n'
        '[files]\ncandidates = "more.csv"\n'
    )
    (dam / "more.csv").write_text(MORE.replace("level,3,height_difference,P1", "level,4,height,P1"))
    assert main(["propose", str(dam), str(dam / "wishes.toml")]) == 2
    err = capsys.readouterr().err
    for part in ("'beauty'", "'at_mots'", "at_most is missing", "target is missing", "more.csv:4"):
        assert part in err
