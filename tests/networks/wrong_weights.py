"""Industry blocks whose tape and level claim other standard deviations than they have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from examples.published_blocks.industry_1981 import MICROMETRE, simulate_industry_block
from factorgraph_adj.network.network import Network
from factorgraph_adj.solve.estimates import ObservationRecord

WRONG = {"slope_distance": 0.5, "height_difference": 2.0}
"""What the industry block's tape and level claim of their σ, relative to the truth."""
TRUE = {"slope_distance": 2.0, "height_difference": 0.5, "image": 1.0}
"""The factors that make the claims true."""


def rescaled(network: Network, factors: Mapping[str, float]) -> Network:
    """Multiply what is said of the precision of observations by id, in place."""
    for ident, factor in factors.items():
        o = network.observations[ident]
        network.observations[ident] = replace(o, sigma=o.sigma * factor)  # type: ignore[attr-defined, call-arg]
    return network


def measured_kinds(record: ObservationRecord) -> str | None:
    """Group by kind; the calibration certificate keeps its weight."""
    return None if record.kind.startswith("weighted") else record.kind


def industry_block(seed: int) -> Network:
    """Return a simulated block of four photos with a tape and a level of `WRONG` claims."""
    network = simulate_industry_block(seed, photos=4, sigma_image=2 * MICROMETRE).network
    return rescaled(network, {i: WRONG[o.kind] for i, o in network.observations.items()})
