"""Generated additions to a block as candidates: GNSS and INS, statoscope, cross strip, lake."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import Correlated, LevelHeight
from factorgraph_adj.planning.candidates import difference, with_candidates
from factorgraph_adj.planning.targets import PointPrecision
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.flight_observations import Gnss, Lake, Statoscope
from factorgraph_adj.simulation.generate.photo_blocks import Aerial, CrossStrips
from factorgraph_adj.simulation.generate.rigs_and_models import Rig
from factorgraph_adj.simulation.generate.scene import Part
from factorgraph_adj.simulation.generate.terrestrial_additions import Distances
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.simulation.spec import Spec, design

SPEC = Spec(
    parts=(Aerial(strips=3, photos_per_strip=6, points_per_photo=12, scale=10_000.0),),
    control=Control(),
)
GNSS = Gnss(shift_mm=100.0, sigma_horizontal_mm=50.0, sigma_vertical_mm=80.0)
ADDITIONS: dict[str, tuple[Part, float]] = {
    "GNSS and INS": (GNSS, 20.0),
    "statoscope": (Statoscope(sigma=0.15, slope=0.5, profiles="weighted", height=0.5), 3.0),
    "cross strip": (CrossStrips(), 4.0),
    "lake": (Lake(), 1.0),
}
"""Additions and what they cost."""


def with_parts(*parts: Part) -> fga.Network:
    return design(SPEC.varied({"parts": (*SPEC.parts, *parts)}))


def sigmas(network: fga.Network, names: list[str]) -> np.ndarray:
    solution = fga.plan(network).solution
    return np.array([solution.standard_deviations(n) for n in names])


@pytest.fixture(scope="module")
def block() -> fga.Network:
    return design(SPEC)


@pytest.fixture(scope="module")
def candidates(block: fga.Network) -> list[fga.Candidate]:
    return [
        difference(name, block, with_parts(part), cost=cost)
        for name, (part, cost) in ADDITIONS.items()
    ]


@pytest.fixture(scope="module")
def combined(
    block: fga.Network, candidates: list[fga.Candidate]
) -> dict[tuple[str, ...], tuple[float, float]]:
    """Return cost and largest σ of a height of all sixteen combinations, planned one by one."""
    return {
        tuple(c.name for c in chosen): (
            sum(c.cost for c in chosen),
            float(sigmas(with_candidates(block, chosen), list(block.points))[:, 2].max()),
        )
        for n in range(len(candidates) + 1)
        for chosen in combinations(candidates, n)
    }


@pytest.mark.parametrize("part", [*(p for p, _ in ADDITIONS.values()), Rig(members=2), Distances()])
def test_a_design_with_a_difference_is_the_larger_design(block: fga.Network, part: Part) -> None:
    """To the height of the shore of a lake, by up to 10 m of 1500."""
    larger = with_parts(part)
    joined = with_candidates(block, [difference("addition", block, larger)])
    assert joined.points.keys() == larger.points.keys()
    assert joined.photos.keys() == larger.photos.keys()
    assert joined.n_image_points == larger.n_image_points
    assert len(joined.observations) == len(larger.observations)
    assert joined.parameters == larger.parameters
    names, tolerance = list(larger.points), 0.02 if isinstance(part, Lake) else 1e-6
    np.testing.assert_allclose(sigmas(joined, names), sigmas(larger, names), rtol=tolerance)


def test_candidates_bring_the_unknowns_that_they_need(candidates: list[fga.Candidate]) -> None:
    brought = {c.name: {kind for kind, _ in c.brings} for c in candidates}
    assert brought == {
        "GNSS and INS": {"mount", "drift", "attitude_drift"},
        "statoscope": {"profile"},
        "cross strip": {"photo"},
        "lake": {"level"},
    }


@pytest.mark.slow(
    "whole proposals are compared with the cheapest ones; short tests take single steps of a plan"
)
@pytest.mark.parametrize("limit", [1.2, 0.85, 0.7, 0.3])
def test_the_cheapest_additions_that_reach_a_height_are_proposed(
    block: fga.Network,
    candidates: list[fga.Candidate],
    combined: dict[tuple[str, ...], tuple[float, float]],
    limit: float,
) -> None:
    """Of all sixteen combinations, each planned by itself."""
    reach = {names: cost for names, (cost, worst) in combined.items() if worst <= limit}
    proposal = fga.propose(block, candidates, PointPrecision(limit, axes="z"))
    assert len(proposal.names) > 0
    assert tuple(sorted(proposal.names)) in {tuple(sorted(r)) for r in reach}
    assert proposal.cost == min(reach.values())


def test_a_proposal_has_the_precision_of_its_measurements(
    block: fga.Network, candidates: list[fga.Candidate]
) -> None:
    proposal = fga.propose(block, candidates, PointPrecision(0.85, axes="z"))
    chosen = with_candidates(block, [c for c in candidates if c.name in proposal.names])
    names = list(block.points)
    measured = fga.adjust(measure(chosen, seed=2))
    found = np.array([measured.standard_deviations(n) for n in names])
    np.testing.assert_allclose(found, sigmas(chosen, names), rtol=0.02)
    assert found[:, 2].max() <= 0.87


def test_a_correlated_group_is_added_as_a_group(block: fga.Network) -> None:
    larger = with_parts(Lake(count=4))
    ids = [i for i in larger.observations if i not in block.observations]
    members = [larger.observations[i] for i in ids]
    covariance = 0.01 * (np.eye(4) + 0.5)
    grouped = larger.copy()
    for i in ids:
        del grouped.observations[i]
    grouped.add(Correlated(tuple(members), covariance))  # type: ignore[arg-type]
    (group,) = difference("lake", block, grouped).observations
    assert isinstance(group, Correlated)
    assert np.array_equal(group.covariance, covariance)
    assert [o.id for o in group.observations] == ids  # type: ignore[attr-defined]


def test_what_a_candidate_brings_and_does_not_determine_is_named(block: fga.Network) -> None:
    larger = with_parts(Lake())
    found = difference("lake", block, larger)
    alone = replace(found, observations=())
    with pytest.raises(InputError, match="it has no observations"):
        fga.propose(block, [alone], PointPrecision(0.1))
    other = next(n for n in block.points)
    unseen = replace(found, observations=(LevelHeight(other, "pond", sigma=0.1),))
    with pytest.raises(InputError, match="unknown level surface 'pond'; known: lake"):
        fga.propose(block, [unseen], PointPrecision(0.1))
    water = found.unknowns["level"]["lake"]
    free = replace(found, unknowns={"level": {"lake": water, "pond": water}})
    with pytest.raises(InputError, match=r"do not determine what it brings \(level 'pond'\)"):
        fga.propose(block, [free], PointPrecision(0.1))


def test_unknowns_of_candidates_are_checked(block: fga.Network) -> None:
    lake = difference("lake", block, with_parts(Lake()))
    with pytest.raises(InputError, match="level surface 'lake': is stated already"):
        with_candidates(with_parts(Lake()), [replace(lake, observations=())])
    given = lake.unknowns["level"]
    with pytest.raises(InputError, match=r"unknown kind 'levels'; valid: .*level"):
        with_candidates(block, [replace(lake, unknowns={"levels": given})])
    with pytest.raises(InputError, match="is no Parameter: 3"):
        with_candidates(block, [replace(lake, unknowns={"level": {"lake": 3.0}})])  # type: ignore[dict-item]


def test_a_candidate_that_needs_the_lake_of_another_is_refused(block: fga.Network) -> None:
    lake = difference("lake", block, with_parts(Lake()))
    more = fga.Candidate("more", (LevelHeight(next(iter(block.points)), "lake", sigma=0.1),))
    with pytest.raises(InputError, match="needs level 'lake', which candidate 'lake' brings"):
        fga.propose(block, [lake, more], PointPrecision(0.1))


def test_a_design_that_is_not_part_of_the_larger_one_is_refused(block: fga.Network) -> None:
    with pytest.raises(InputError, match="in the design alone"):
        difference("none", with_parts(Lake()), block)
    held = block.copy()
    name = next(n for n, p in block.points.items() if not any(p.fixed))
    held.points[name] = replace(held.points[name], fixed=(True, True, True))
    with pytest.raises(InputError, match="is held in one of the designs"):
        difference("control", block, held)
