"""Readings of wires, water and inclinometers arrive, are removed, and stand in a journal."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import IncrementalAdjustment, Network, Observation
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from tests.networks.alignment import body, measured, offsets, tunnel
from tests.support.studies import cases

PERCENT = 0.01
"""Share of a standard deviation within which an incremental adjustment is at the minimum."""


def split(network: Network, every: int, which: int) -> tuple[Network, list[Observation]]:
    """Return the network without some of its observations, and these."""
    begun, later = network.copy(), []
    for number, (ident, o) in enumerate(network.observations.items()):
        if number % every == which:
            later.append(replace(o, id=ident))
            del begun.observations[ident]
    return begun, later


def assert_same(inc: IncrementalAdjustment, expected: fga.Solution) -> None:
    solution = inc.solution()
    for kind in ("point", "frame", "size", "level"):
        for name in expected.equations.unknowns[kind].names:
            e = expected.unknown(kind, name)
            off = np.abs(solution.unknown(kind, name).values - e.values)
            assert (off <= PERCENT * e.sigmas + 1e-9).all(), (kind, name)


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
@pytest.mark.parametrize(
    ("make", "which"),
    cases(product([tunnel, offsets, body], [1, 4]), [(tunnel, 1), (offsets, 4), (body, 1)]),
)
def test_readings_arrive_in_any_order(make: Callable[[], Network], which: int, tmp_path) -> None:
    network = measured(make())
    begun, later = split(network, 7, which)
    inc = IncrementalAdjustment(begun, journal=tmp_path / "day.jsonl")
    order = np.random.default_rng(which).permutation(len(later))
    for i in order.tolist():
        inc.add(observation_from_record(json.loads(json.dumps(observation_record(later[i])))))
    assert_same(inc, fga.adjust(network))
    del inc
    assert_same(IncrementalAdjustment.resume(tmp_path / "day.jsonl"), fga.adjust(network))


def test_a_reading_is_removed_again() -> None:
    network = measured(tunnel())
    begun, later = split(network, 11, 2)
    inc = IncrementalAdjustment(network)
    for o in later:
        inc.remove(o.id)
    assert_same(inc, fga.adjust(begun))


def test_a_gross_reading_that_arrives_is_rejected_under_its_name() -> None:
    network = measured(tunnel())
    begun, later = split(network, 7, 3)
    inc = IncrementalAdjustment(begun, policy="reject")
    first, *rest = (o for o in later if o.kind == "wire_reading")
    inc.add([o for o in later if o.kind != "wire_reading"])
    inc.add(rest)
    inc.add(replace(first, value=(first.value[0] + 0.001, first.value[1]), id="wrong"))
    assert [v.id for v in inc.rejected] == ["wrong"]
