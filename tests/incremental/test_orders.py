"""The end depends neither on the order of arrivals nor on what arrives together.

Random small networks with every kind of observation arrive one by one in several orders, in
groups, all together, handed over with the network, and with a part of them handed over. In the end
the same observations and unknowns are in, and settled the results are those of the batch. With
gross errors only errors of the program count.

These are the quick ones of ``python -m tests.benchmarks orders``, which has 5 000.
"""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj import IncrementalAdjustment, Network
from factorgraph_adj.ledger.verdicts import Policy
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import (
    BUILT_IN,
    GnssVector,
    HeightDifference,
    PhotoPosition,
    SlopeDistance,
)
from tests.networks.random_small import random_network
from tests.support.arrivals import ids_of
from tests.support.orders import AT_REST, LONGEST, Way, arrive, errors, limited, study

MM = 1e-3
SMALL_PART = "a part of a free network that could be one alone is in only where it came first"
NETWORKS: dict[int, str | None] = {
    **dict.fromkeys((0, 3, 10, 15, 19, 9003)),
    12: SMALL_PART,
}
"""Seeds of networks, and what is wrong with some of them; 12 and 19 are free ones."""
GROSS = (0, 1, 3, 10, 15, 17, 24, 30, 1280)
"""Seeds of networks with gross errors; an adjustment of 1280 ends where a sight is vertical."""


def cases(seeds: dict[int, str | None]) -> list[object]:
    """Return the seeds as parameters, those with known defects marked."""
    return [
        pytest.param(seed, marks=pytest.mark.xfail(strict=True, reason=why) if why else ())
        for seed, why in seeds.items()
    ]


@pytest.mark.slow(
    "many orders and groupings of whole days, with gross errors, end alike; short tests "
    "take one order of each kind"
)
@pytest.mark.parametrize("seed", cases(NETWORKS))
def test_the_end_depends_neither_on_order_nor_on_grouping(seed: int) -> None:
    result = study(random_network(seed))
    assert not result.findings, "\n".join(map(str, result.findings))
    assert max(result.from_batch, result.between) <= AT_REST


@pytest.mark.slow(
    "many orders and groupings of whole days, with gross errors, end alike; short tests "
    "take one order of each kind"
)
@pytest.mark.parametrize("seed", GROSS)
def test_gross_errors_end_in_no_error_of_the_program(seed: int) -> None:
    assert not errors(seed)


@pytest.mark.parametrize("policy", ["flag", "reject"])
def test_first_readings_may_contradict_each_other(policy: Policy) -> None:
    """Without the vector, which is the worst, nothing says where the point is: all of it waits."""
    network = Network("contradiction")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("P", (20.0, 15.0, 10.0))
    adjustment = IncrementalAdjustment(network, policy=policy)
    vector = GnssVector("A", "P", (20.0, 15.0, 10.0), sigma=(3 * MM,) * 3, id="v")
    heights = [HeightDifference("A", "P", h, sigma=MM, id=f"{h}") for h in (11.0, 11.0005)]
    adjustment.add([vector, *heights])
    assert len(adjustment) + adjustment.n_waiting + len(adjustment.suspects) <= 3
    adjustment.settle()


@pytest.mark.parametrize("held", [True, False])
def test_the_position_of_a_photo_may_come_before_its_image_points(held: bool) -> None:
    network = Network("antenna")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("P", (10.0, 0.0, 0.0), fixed="yz")
    network.add_camera("cam", NoDistortion(), {"c": 28.0}, sigma={"c": 0.02})
    where = (0.0, -50.0, 30.0)
    weights = {} if held else {"sigma_position": 0.05, "sigma_attitude": 1e-3}
    network.add_photo("F", "cam", position=where, rotation=np.eye(3), fixed=held, **weights)
    adjustment = IncrementalAdjustment(network, policy="accept")
    adjustment.add(SlopeDistance("A", "P", 10.002, sigma=2 * MM))
    adjustment.add(PhotoPosition("F", where, sigma=(0.02,) * 3))
    assert len(adjustment) == 2
    adjustment.settle()


def test_a_network_without_unknowns_may_be_handed_over() -> None:
    network = Network("constants")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (20.0, 15.0, 10.0), fixed="xyz")
    network.add(HeightDifference("A", "B", 10.0, sigma=MM))
    with limited(LONGEST):
        assert IncrementalAdjustment(network, policy="accept").n_waiting == 1


def test_the_networks_have_something_in_and_something_waiting() -> None:
    """Networks of which everything waited, or nothing, would prove little."""
    networks = [random_network(seed) for seed in (0, 15)]
    ends = [arrive(drawn, Way("together", (), (tuple(drawn.items),))) for drawn in networks]
    inside = sum(len(end.inside) for end in ends)
    every = sum(len(ids_of(item)) for drawn in networks for item in drawn.items)
    assert 0 < inside < every


def test_every_kind_is_drawn() -> None:
    kinds: set[str] = set()
    datums: set[str] = set()
    for seed in range(60):
        drawn = random_network(seed)
        datums.add(drawn.bare.datum)
        kinds |= {getattr(item, "kind", "correlated") for item in drawn.items}
    assert datums == {"given", "free"}
    assert kinds == {*BUILT_IN, "correlated"}
