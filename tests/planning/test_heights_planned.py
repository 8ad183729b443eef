"""Auxiliary data of heights and attitudes as candidates of a design, and as what may be spared."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.planning.targets import PointPrecision
from factorgraph_adj.simulation.measurement import measure
from tests.networks.aerial_heights import Aerial, plan_of

AUXILIARY = Aerial(
    strips=2,
    photos=4,
    statoscope=("height",),
    lake=True,
    recorder=("height",),
    tilts=("rx", "ry"),
    sights=("rx", "ry", "rz"),
)
NAMES = ("statoscope", "shore", "recorder", "tilt", "sun")


def design() -> tuple[fga.Network, list[fga.Candidate]]:
    """Return a block with control alone, and the auxiliary data as candidates."""
    whole = plan_of(AUXILIARY)
    network = whole.copy()
    own = {n: [o for i, o in whole.observations.items() if i.startswith(n)] for n in NAMES}
    aside = {o.id for group in own.values() for o in group}
    # What is kept determines the additional unknowns; all else may be added.
    kept = {o.id for group in own.values() for o in group[::4]}
    network.observations = {
        i: o for i, o in whole.observations.items() if i not in aside or i in kept
    }
    return network, [
        fga.Candidate(n, tuple(o for o in group if o.id not in kept), cost=cost)
        for (n, group), cost in zip(own.items(), (2.0, 1.0, 4.0, 3.0, 3.0), strict=True)
    ]


@pytest.fixture(scope="module")
def known() -> tuple[fga.Network, list[fga.Candidate], fga.Network]:
    network, candidates = design()
    full = network.copy()
    for c in candidates:
        full.add(*c.observations)
    return network, candidates, full


def test_a_plan_has_the_precision_of_its_adjustment(known) -> None:
    network, _, full = known
    low, high = fga.plan(network).solution, fga.plan(full).solution
    names = list(network.points)
    before, after = (np.array([s.standard_deviations(n)[2] for n in names]) for s in (low, high))
    assert (after <= before * (1 + 1e-9)).all()
    assert after.mean() < 0.95 * before.mean()
    measured = fga.adjust(measure(full, seed=1))
    found = np.array([measured.standard_deviations(n)[2] for n in names])
    np.testing.assert_allclose(found, after, rtol=0.01)


@pytest.mark.slow(
    "whole proposals are compared with the cheapest ones; short tests take single steps of a plan"
)
def test_auxiliary_data_are_proposed_where_they_meet_a_target(known) -> None:
    network, candidates, full = known
    names = list(network.points)
    worst = [
        max(fga.plan(n).solution.standard_deviations(p)[2] for p in names) for n in (network, full)
    ]
    target = PointPrecision(0.5 * sum(worst), axes="z")
    proposal = fga.propose(network, candidates, target)
    assert 0 < len(proposal.names) < len(candidates)
    chosen = network.copy()
    for c in candidates:
        if c.name in proposal.names:
            chosen.add(*c.observations)
    found = fga.plan(chosen).solution
    assert max(found.standard_deviations(p)[2] for p in names) <= target.at_most
