"""The smallest detectable displacement of a design is that of two epochs of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.planning.candidates import Candidate, identified, with_candidates
from factorgraph_adj.planning.targets import DetectableDisplacement, RedundancyNumber, for_points
from tests.networks.epochs import PLACES, detectable_shift, epoch, solved

LONG = pytest.mark.slow("observations spared one by one; short tests plan single ones")


def planned(network, **target):
    """Return the figures of a target by the names of its points."""
    return dict(zip(*fga.plan(network).figures(DetectableDisplacement(1.0, **target)), strict=True))


def levelled(seed=None, rise=0.0, *, datum="given"):
    """A levelling loop with a bench mark; P rises between epochs."""
    rng = np.random.default_rng(seed)
    heights = {"B": 100.0, "C": 103.0, "P": 101.0 + rise, "Q": 99.0}
    network = fga.Network("levelled", datum=datum)
    for i, (n, z) in enumerate(heights.items()):
        held = "xyz" if n == "B" and datum == "given" else "xy"
        network.add_point(n, (100.0 * i, 0.0, z if n != "P" else 101.0), fixed=held)
    for a, b in ("BC", "CP", "PQ", "QB", "BP"):
        error = 0.0 if seed is None else rng.normal(0, 1e-3)
        dh = heights[b] - heights[a] + error
        network.add(fga.HeightDifference(a, b, dh, sigma=1e-3))
    return network


def test_a_height_by_hand():
    """P by B-P, B-C-P and B-Q-P: the weight 1 + ½ + ½ of 1 mm; two epochs, 1.96 + 0.84."""
    figure = planned(levelled(), points="P", reference=())["P"]
    assert figure == pytest.approx(np.sqrt(2 / 2.0) * 1e-3 * (1.959964 + 0.841621), rel=1e-4)


@pytest.mark.parametrize("names", [("P", "Q"), ("P",), ("A", "P")])
def test_figures_are_those_of_the_congruence_of_two_epochs(names):
    found = fga.congruence(solved(1), solved(2), objects=list(names), variance="a-priori")
    assert found.global_test.accepted  # so that all reference points are stable
    figures = planned(epoch(1), points=names)
    assert list(figures) == [n for n in PLACES if n in names]
    for n in names:
        # Both epochs are linearised at their estimates, the plan at the given coordinates.
        assert figures[n] == pytest.approx(found.displacement(n).detectable, rel=2e-4)


def test_fewer_reference_points_find_less():
    every = planned(epoch(1), points=("P", "Q"))["P"]
    three = planned(epoch(1), points=("P", "Q"), reference=("A", "B", "C"))["P"]
    found = fga.congruence(
        solved(1), solved(2), reference=["A", "B", "C"], objects=["P"], variance="a-priori"
    )
    assert three > 1.02 * every
    assert three == pytest.approx(found.displacement("P").detectable, rel=2e-4)


def test_the_figure_of_one_design_does_not_depend_on_its_datum():
    one = planned(epoch(1), points="P", reference=tuple("ABCDE"))
    given = fga.Network("design", datum="free")
    for n, p in epoch(1).points.items():
        given.add_point(n, p.coordinates, fixed="z", datum=n in "AB")
    given.add(*epoch(1).observations.values())
    two = planned(given, points="P", reference=tuple("ABCDE"))
    assert two["P"] == pytest.approx(one["P"], rel=1e-7)


def test_dimensions_have_their_noncentrality():
    """A point that GNSS gives with 1 mm in each free coordinate: ∇ = √(2 λ) mm."""
    for fixed in ("", "z", "xy"):
        network = fga.Network("gnss")
        network.add_point("P", (1.0, 2.0, 3.0), fixed=fixed)
        network.add(fga.GnssPosition("P", (1.0, 2.0, 3.0), covariance=1e-6 * np.eye(3)))
        k = 3 - len(fixed)
        found = planned(network, points="P", reference=(), alpha=0.01, power=0.9)["P"]
        lam = (found / 1e-3) ** 2 / 2.0
        assert ncx2.sf(chi2.ppf(0.99, k), k, lam) == pytest.approx(0.9, abs=1e-6)


@pytest.mark.slow(
    "whole proposals are compared with the cheapest ones; short tests take single steps of a plan"
)
def test_a_displacement_of_this_size_is_found_with_the_power():
    """60 pairs of levelled epochs in which P rises by what the design finds with 80 %."""
    rise = planned(levelled(), points="P", reference=())["P"]
    tests = {"reference": [], "objects": ["P"], "variance": "a-priori"}

    def moved(seed, by):
        first, second = (fga.adjust(levelled(2 * seed + i, i * by)) for i in (0, 1))
        return fga.congruence(first, second, **tests).displacement("P").moved

    power = np.mean([moved(1000 + seed, rise) for seed in range(60)])
    assert 0.62 <= power <= 0.95  # 3.5 standard deviations
    size = np.mean([moved(3000 + seed, 0.0) for seed in range(60)])
    assert size <= 0.16  # 3 are expected, more than 9 with a probability of 1e-3


def test_the_simulated_power_of_the_congruence_is_that_of_the_plan():
    """`test_size_and_power_of_a_few_epochs` and its command simulate this displacement."""
    figure = planned(epoch(1), points=("P", "Q"))["P"]
    assert figure == pytest.approx(np.hypot(*detectable_shift()), rel=2e-4)


def thinned():
    """The network of two epochs without the sights of P, which are candidates."""
    whole = epoch(1)
    design = fga.Network("design", datum="free")
    for n, p in whole.points.items():
        design.add_point(n, p.coordinates, fixed="z")
    sights = []
    for o in whole.observations.values():
        if "P" in (o.station, o.target) and {o.station, o.target} & set("BCDEQ"):
            sights.append(o)
        else:
            design.add(replace(o, id=None))
    return design, sights


def test_a_proposal_meets_the_target():
    design, sights = thinned()
    design.add(fga.HorizontalDistance("P", "B", 200.0, sigma=0.002))
    before = planned(design, points="P")["P"]
    candidates = [
        Candidate(f"{o.kind} {o.station}-{o.target}", (replace(o, id=None),)) for o in sights
    ]
    target = DetectableDisplacement(0.7 * before, points=("P",))
    found = fga.propose(design, candidates, target)
    assert 0 < len(found.steps) < len(candidates)
    figure = dict(zip(*found.plan.figures(target), strict=True))["P"]
    assert figure <= target.at_most
    assert planned(found.plan.network, points="P")["P"] == pytest.approx(figure, rel=1e-9)
    # Without any one of them the target is missed.
    for unknowns_left_out in found.steps:
        rest = [s.candidate for s in found.steps if s is not unknowns_left_out]
        assert planned(with_candidates(design, identified(rest)), points="P")["P"] > target.at_most


@LONG
def test_observations_are_spared_while_the_target_is_met():
    whole = epoch(1)
    before = planned(whole, points=("P", "Q"))
    target = DetectableDisplacement(1.15 * max(before.values()), points=("P", "Q"))
    kind = "horizontal_distance"
    spared = fga.find_sparable(whole, [target, RedundancyNumber(0.1)], observations=kind)
    assert len(spared.ids) > 5
    assert spared.plan.met
    assert max(planned(spared.plan.network, points=("P", "Q")).values()) <= target.at_most


def test_wrong_targets_are_all_told():
    network = epoch(1)
    bad = [
        DetectableDisplacement(-1.0, points="P"),
        DetectableDisplacement(1e-3, points="X*"),
        DetectableDisplacement(1e-3, points="P", reference="Y"),
        DetectableDisplacement(1e-3, points="P", alpha=0.9),
    ]
    with pytest.raises(InputError) as caught:
        fga.plan(network, bad)
    said = [str(p) for p in caught.value.problems]
    for part in ("greater than zero", "'X*'", "'Y'", "0 < alpha < power < 1"):
        assert any(part in s for s in said), (part, said)
    with pytest.raises(InputError, match="no reference points"):
        fga.plan(network, DetectableDisplacement(1e-3))
    with pytest.raises(InputError, match="not enough reference points"):
        fga.plan(network, DetectableDisplacement(1e-3, points="P", reference="A"))
    with pytest.raises(InputError, match="'A': is held"):
        fga.plan(epoch(1, datum="given"), DetectableDisplacement(1e-3, points=("A", "P")))


def test_names_of_a_target_are_no_patterns_once_they_are_chosen():
    found = for_points(DetectableDisplacement(1.0, points="P*"), ["P1", "P2", "A"])
    assert found.points == ("P1", "P2") and found.reference == ("P1", "P2", "A")


def test_a_target_stands_in_a_file_and_the_command_checks_it(tmp_path, capsys):
    fga.write_project(epoch(1), tmp_path / "project.toml")
    figure = planned(epoch(1), points=("P", "Q"))
    worst = max(figure, key=lambda n: figure[n])
    text = """[[target]]
kind = "detectable_displacement"
at_most_mm = {}
points = ["P", "Q"]
reference = ["A", "B", "C", "D", "E"]
alpha = 0.05
power = 0.8
"""
    wishes = tmp_path / "targets.toml"
    for factor, code in ((1.01, 0), (0.99, 1)):
        wishes.write_text(text.format(1000 * factor * figure[worst]), encoding="utf-8")
        assert main(["plan", str(tmp_path), "--targets", str(wishes)]) == code
        said = capsys.readouterr().out
        assert "smallest detectable displacement between two epochs" in said
        assert (f"{worst}: {1000 * figure[worst]:.3g} mm" in said) == bool(code)
    wishes.write_text(text.format(3).replace("reference", "refrence"), encoding="utf-8")
    assert main(["plan", str(tmp_path), "--targets", str(wishes)]) == 2
    assert "unknown key 'refrence'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("target", "named"),
    [
        ({"reference": ["A", "B"]}, ["A", "B"]),
        ({"reference": ["A", "P"], "points": ["P", "Q"]}, ["P"]),
        ({"reference": ["Q*"], "points": ["P", "Q"]}, ["Q*"]),
    ],
)
def test_a_reference_without_effect_is_refused(target, named):
    """It names only points that may move, all of them where ``points`` is missing."""
    with pytest.raises(InputError) as caught:
        fga.plan(epoch(1), [DetectableDisplacement(0.01, **target)])
    said = [str(p) for p in caught.value.problems]
    assert len(said) == len(named)
    for text, name in zip(said, named, strict=True):
        assert f"the reference {name!r} has no effect" in text
        assert "name in points those that may move" in text
