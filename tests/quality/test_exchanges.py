"""Exchanged names without good approximate values, lost control, and errors nothing tells apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.quality.causes.mistaken_identity import EXCHANGED_TARGETS
from factorgraph_adj.quality.rejections import lost_control
from tests.benchmarks.exchanges import Counts, count, dense, doubts
from tests.networks.exchanged_day import day
from tests.networks.small import small

LONG = pytest.mark.slow(
    "exchanges in seeded days of many set-ups; short tests exchange targets in the field mistakes"
)


@LONG
@pytest.mark.parametrize("seed", [1, 2, 6, 14])
def test_an_exchange_is_named_first_with_and_without_approximate_coordinates(seed: int) -> None:
    """Both names and the station come first, where two others tell of one of the points."""
    case, counts = day(seed, most=25), Counts()
    assert count(case, counts) == ""
    assert counts.told
    assert counts.first == counts.told


@LONG
@pytest.mark.parametrize("seed", [7, 30, 53, 61, 257])
def test_exchanges_that_concern_one_another_are_named_first(seed: int) -> None:
    """Levelling joins two of them (30), or they share a point, also a controlled one (53, 7)."""
    case, counts = day(seed), Counts()
    assert count(case, counts) == ""
    assert counts.first == counts.told > 0


@LONG
@pytest.mark.parametrize("seed", [1, 2, 6])
def test_an_exchange_is_named_first_where_sigma0_is_estimated(seed: int) -> None:
    """All σ are five times too small: T² refers to the estimate, and so do the tests of names."""
    case = day(seed, most=25)
    known = fga.snoop(case.network).causes
    network = case.network.copy()
    for ident, o in network.observations.items():
        sigma: Any = np.asarray(o.sigma) / 5.0  # type: ignore[attr-defined]
        sigma = float(sigma) if not sigma.ndim else tuple(sigma.tolist())
        network.observations[ident] = replace(o, sigma=sigma)  # type: ignore[call-arg]
    found = fga.snoop(network, test="pope", variance="a-posteriori").causes
    assert known is not None
    assert found is not None
    a, b = known.found[0], found.found[0]
    assert (a.cause, a.where, a.ids) == (b.cause, b.where, b.ids)
    assert a.cause == EXCHANGED_TARGETS
    assert 0.5 < b.t2 / a.t2 < 2.0


@LONG
def test_an_exchange_that_two_set_ups_may_have_is_named_at_both() -> None:
    """With two set-ups the exchange at either makes all readings fit: nothing tells which."""
    for seed in range(40):
        case = day(seed, exchanges=1, most=15)
        (e,) = case.exchanged
        if not e.told:
            break
    found = fga.snoop(case.network)
    assert found.causes is not None
    first = found.causes.found[0]
    assert first.cause == EXCHANGED_TARGETS
    both = [first.where, *first.same]
    a, b = e.pair
    assert f"{a!r} and {b!r} seen from {e.station!r}" in both
    assert len(both) == 2
    assert doubts(found, case.network)


def test_what_gross_errors_leave_without_control_is_doubtful() -> None:
    """Of three distances to a point one is wrong: whichever goes, nothing controls the others."""
    network = small(1)
    found = fga.snoop(network)
    assert len(found.rejected) == 1
    lost = lost_control(found, network)
    if found.solution.redundancy:
        assert lost is None
    else:
        assert lost is not None
        assert lost.points == ("P",)
        assert doubts(found, network)


@pytest.mark.parametrize("seed", range(12))
def test_no_cause_is_named_where_the_redundancy_tells_none_apart(seed: int) -> None:
    """With a redundancy of 1 all test values have a correlation of one: the whole set is named."""
    solution = fga.adjust(small(seed))
    found = fga.causes(fga.reliability(solution))
    if solution.redundancy > 1:
        assert found.most_probable is None or found.most_probable.t2 > found.single + 11
        return
    assert found.most_probable is None
    a, _ = dense(solution)
    q = np.eye(len(a)) - a @ np.linalg.pinv(a)
    controlled = np.flatnonzero(np.diag(q) > 1e-6)
    labels = {solution.equations.label(int(row)) for row in controlled}
    if found.single > 25:
        assert labels == set(found.readings)
        assert labels <= set(found.undecided)


def test_a_set_with_one_reading_too_many_tells_of_no_cause_whatever_rounding_does() -> None:
    """Thirty copies of one network, turned by a little, say the same."""
    said = set()
    for turn in np.linspace(0.0, 6.0, 30):
        network = fga.Network("three distances")
        c, s = np.cos(turn), np.sin(turn)
        places = {"A": (0.0, 0.0), "B": (100.0, 0.0), "C": (50.0, 90.0), "P": (30.0, 40.0)}
        for name, (x, y) in places.items():
            at = (c * x - s * y, s * x + c * y, 0.0)
            network.add_point(name, at, fixed="z" if name == "P" else "xyz")
        for name, length in {"A": 50.001, "B": 80.6226, "C": 54.8516}.items():
            network.add(fga.observations.HorizontalDistance(name, "P", length, sigma=0.002))
        found = fga.causes(fga.reliability(fga.adjust(network)))
        assert found.most_probable is None
        said.add(frozenset(t for t in found.undecided if "horizontal_distance" in t))
    assert len(said) == 1
    assert len(said.pop()) == 3
