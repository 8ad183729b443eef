"""A gross error of a whole GNSS position is no cause that its point's sights share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import GnssPosition
from factorgraph_adj.quality.causes.separability import best_whole_observation
from tests.networks.mistaken import YARD, yard

SIGMA = (0.006, 0.006, 0.01)


def positioned(seed: int, error: float) -> fga.Network:
    """Return the yard with GNSS positions in place of held points; that of K2 has an error."""
    rng = np.random.default_rng([seed, 76])
    network = yard(seed)
    direction = rng.normal(0.0, 1.0, 3)
    wrong = error * direction / np.linalg.norm(direction)
    for name, at in YARD.items():
        network.points[name] = replace(network.points[name], fixed=(False, False, False))
        if name[0] == "K":
            value = np.array(at) + SIGMA * rng.normal(0.0, 1.0, 3) + (name == "K2") * wrong
            network.add(GnssPosition(name, tuple(value.tolist()), sigma=SIGMA))
    return network


def test_a_wrong_position_is_not_called_a_centring_of_its_target() -> None:
    """Its three components together explain as much, and each alone explains less."""
    more = 0
    for seed in range(4):
        solution = fga.adjust(positioned(seed, 0.4))
        rel = fga.reliability(solution)
        found = fga.causes(rel)
        assert not found.more_probable
        first = found.found[0]
        assert first.cause.startswith("the centring of the target") and "'K2'" in first.where
        more += first.t2 > found.single + 11.0
        w = np.where(rel.controlled, np.nan_to_num(rel.w), 0.0)
        best = best_whole_observation(rel, w, estimated=False)
        assert best.likelihood >= first.likelihood - 1e-9
    assert more >= 2


def test_the_evidence_of_a_whole_observation_is_that_of_an_adjustment_without_it() -> None:
    """vᵀPv is less by T² without the observation."""
    network = positioned(3, 0.4)
    solution = fga.adjust(network)
    rel = fga.reliability(solution)
    w = np.where(rel.controlled, np.nan_to_num(rel.w), 0.0)
    best = best_whole_observation(rel, w, estimated=False)
    positions = {i: o for i, o in network.observations.items() if isinstance(o, GnssPosition)}
    (wrong,) = (i for i, o in positions.items() if o.point == "K2")
    del network.observations[wrong]
    t2 = solution.vtpv - fga.adjust(network).vtpv
    # Of one unknown −ln P(χ² > T²) is half of T² and a small logarithm.
    assert best.likelihood == pytest.approx(0.5 * t2, rel=0.01)
    assert best.evidence < best.likelihood
