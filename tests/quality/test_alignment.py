"""Wires and water levels: blunders, laws of reliability, free networks, recovery of the truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.simulation.measurement import measure
from tests.networks.alignment import (
    WIRES,
    body,
    free_tunnel,
    measured,
    offsets,
    tunnel,
)

LONG = pytest.mark.slow("alignments that are simulated and found again; short tests adjust one")

SEEDS = 60
ALL_SEEDS = 200


@cache
def planned() -> fga.Solution:
    return fga.adjust(measured(tunnel(), noise=False))


def reading(kind: str, point: str) -> str:
    """Return the id of the first reading of a kind at a point."""
    every = planned().network.observations.items()
    return next(i for i, x in every if x.kind == kind and x.point == point)


BLUNDERS = {"a wire": ("wire_reading", "S3", "z"), "water": ("hydrostatic_reading", "S2", "")}


def blundered(network: fga.Network, where: tuple[str, str, str], error: float) -> fga.Network:
    kind, point, axis = where
    ident = reading(kind, point)
    o = network.observations[ident]
    if axis:
        o = replace(o, value=(o.value[0], o.value[1] + error))
    else:
        o = replace(o, value=o.value + error)
    out = network.copy()
    out.observations[ident] = o
    return out


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("where", BLUNDERS)
def test_a_blunder_at_the_limit_is_seen_as_often_as_predicted(where: str) -> None:
    kind, point, axis = BLUNDERS[where]
    plan = fga.reliability(planned())
    row = plan.row(reading(kind, point), axis or None)
    seen = 0
    for seed in range(SEEDS):
        network = blundered(measured(tunnel(), seed), BLUNDERS[where], float(plan.mdb[row]))
        rel = fga.reliability(fga.adjust(network, start=planned()))
        seen += bool(abs(rel.w[row]) > rel.critical_w)
    low, high = stats.binom(SEEDS, plan.power).ppf([5e-4, 1 - 5e-4])
    assert low <= seen <= high


@pytest.mark.parametrize("where", BLUNDERS)
def test_a_large_blunder_is_found_under_its_name(where: str) -> None:
    kind, point, axis = BLUNDERS[where]
    plan = fga.reliability(planned())
    row = plan.row(reading(kind, point), axis or None)
    network = blundered(measured(tunnel(), 3), BLUNDERS[where], 3 * float(plan.mdb[row]))
    found = fga.snoop(network)
    assert [r.id for r in found.rejected] == [reading(kind, point)]


@pytest.mark.parametrize("make", [tunnel, offsets, body, free_tunnel])
def test_redundancy_numbers_add_up(make) -> None:
    s = fga.adjust(measured(make()))
    rel = fga.reliability(s)
    assert rel.redundancy_numbers.sum() == pytest.approx(s.redundancy, abs=1e-5)
    total = rel.redundancy_numbers + rel.e1 + rel.e2 + rel.e12
    assert np.allclose(total, 1.0, rtol=0, atol=1e-6)


@pytest.mark.parametrize("make", [tunnel, offsets, body, free_tunnel])
def test_the_order_of_observations_does_not_matter(make) -> None:
    network = measured(make())
    turned = network.copy()
    turned.observations = dict(reversed(network.observations.items()))
    a, b = fga.adjust(network), fga.adjust(turned)
    for name in network.points:
        assert np.allclose(a.point(name), b.point(name), rtol=0, atol=1e-8)
    assert a.vtpv == pytest.approx(b.vtpv, rel=1e-6)


def test_a_free_tunnel_is_as_good_as_one_with_its_least_datum() -> None:
    """The datum changes neither residuals nor figures that do not depend on it."""
    free = fga.adjust(measured(free_tunnel()))
    held = measured(free_tunnel())
    held.datum = "given"
    held.points["S0"] = replace(held.points["S0"], fixed=(True, True, True))
    held.points["S6"] = replace(held.points["S6"], fixed=(True, False, False))
    other = fga.adjust(held)
    assert (free.redundancy, free.vtpv) == (other.redundancy, pytest.approx(other.vtpv, rel=1e-5))
    for wire in WIRES:
        a, b = (s.unknown("size", wire) for s in (free, other))
        assert a.values[0] == pytest.approx(b.values[0], abs=1e-8)
        assert a.sigmas[0] == pytest.approx(b.sigmas[0], rel=1e-4)


def shares(seeds: int) -> list[float]:
    """Return how often each parameter of the body's network is within 2.5 σ of its truth."""
    true = fga.adjust(measured(body(), noise=False))
    unknowns = [("frame", n) for n in (*WIRES, "girder")]
    unknowns += [("size", n) for n in WIRES] + [("level", "tube")]
    within: dict[tuple[str, str, int], int] = {}
    for seed in range(seeds):
        found = fga.adjust(measure(body(), seed=seed), start=true)
        for kind, name in unknowns:
            a, b = (s.unknown(kind, name) for s in (found, true))
            off = np.abs(a.values - b.values)
            for c in np.flatnonzero(a.sigmas > 0).tolist():
                key = (kind, name, c)
                within[key] = within.get(key, 0) + bool(off[c] <= 2.5 * a.sigmas[c])
    return [n / seeds for n in within.values()]


@LONG
def test_parameters_come_back() -> None:
    """Of normal errors 98.8 % are within 2.5 σ."""
    found = shares(SEEDS // 2)
    assert np.mean(found) > 0.95
    assert min(found) > 0.85


@pytest.mark.slow("shows the share of each single parameter, which a few seeds cannot show")
def test_parameters_come_back_in_most_of_all_seeds() -> None:
    assert min(shares(ALL_SEEDS)) >= 0.95
