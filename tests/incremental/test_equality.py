"""Observations one by one come to the same as the batch adjustment, at any time, on every network.

Every test network of the batch adjustment arrives in file order and in random ones, with
observations taken out and put in again in between (`arrivals.play`):

    at any time    estimates and standard deviations within 1 % of σ, redundancy numbers to 1e-3
    settled        all of them to 1e-6

Here every small network comes in file order and in one of three random orders, larger ones in one
order with fewer moments, photo by photo, and of the largest a sample of photos. All of them in
all four orders: ``python -m tests.benchmarks equality``.

What the networks taught about the comparison itself:

- Networks that are hardly determined yet have no batch adjustment to compare with: it ends with
  "no step decreases vᵀPv any more", or has no redundancy numbers. `WITHOUT` names them.
- Where only inner constraints hold a point, its σ may be zero: `arrivals.NOTHING`.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.networks.arriving import CASES, LARGE, ORDERS, PHOTOS, SAMPLES

SLOW = (
    "2020-barta-phase_0-1TK",
    "2020-barta-phase_0-2TK",
    "2020-barta-phase_1-1TK",
    "2020-barta-phase_1-2TK",
    "tst-tetrahedron-2",
    "local_3d",
    "Hoepke_Distance_free",
    "Wolf_DistanceDirectionAngle_free",
    *PHOTOS,
    *SAMPLES,
    "camcal, five photos",
    "Comp3D",
    "Comp3D, deflections",
    "DynAdjust",
    "total station, free",
    "total station, free, verticals",
    "combined block",
    "combined block, free",
    "images, free",
    "own cameras",
    "weighted photos",
    "held photo",
    "aerial block",
    "industry block",
    "geocentric block",
)
"""One order and few moments here, if any."""
CHOSEN = (
    "local_3d",
    "Comp3D, deflections",
    "total station, free",
    "combined block",
    "combined block, free",
    "own cameras",
    "held photo",
    "AICON, 12 photos",
)
"""Those of them that are not left to ``python -m tests.benchmarks.equality``."""
HARD = (
    ("2020-barta-phase_1-1TK", 3),
    ("2020-barta-phase_1-2TK", 1),
    ("camcal, five photos", 3),
)
"""Networks in orders in which points stand for a while with next to nothing to say where they are,
from two set-ups on the same pillar or along horizontal sights; or steps shrink by 5 % each, below
what vᵀPv can tell."""
QUICK = ("Comp3D, deflections", "held photo", "local_3d", "MMVII, Ex3")
"""Networks whose random order is quick too. All that is not chosen is quick in file order."""
LONG = pytest.mark.slow(
    "networks with hundreds of rays, free blocks, own cameras and orders in which next to nothing "
    "is determined for a while; the quick ones are surveys and small blocks"
)
SHUFFLED = pytest.mark.slow(
    "small networks in a random order, in which other points wait for longer; the quick runs have "
    "them in the order of the file"
)
WITHOUT: dict[str, str] = {}
"""Networks that have no batch adjustment to compare with at some moment, and why."""


def runs() -> Iterator[tuple[str, int | None, int]]:
    """Return networks, orders and moments of the tests."""
    for number, name in enumerate(CASES):
        if name in LARGE or (name in SLOW and name not in CHOSEN):
            continue
        if name in SLOW:
            yield name, ORDERS[number % 4], 1
        else:
            yield name, None, 5
            yield name, 1 + number % 3, 5
    for name, order in HARD:
        yield name, order, CASES[name].moments


def marked() -> Iterator[object]:
    """Return `runs`, long ones marked."""
    for name, order, moments in runs():
        if name in SLOW and (name not in QUICK or (name, order) in HARD):
            marks = (LONG,)
        else:
            marks = () if name in QUICK or order is None else (SHUFFLED,)
        yield pytest.param(name, order, moments, marks=marks)


@pytest.mark.slow("every network of the batch tests arrives; short tests compare one network")
@pytest.mark.parametrize(("name", "order", "moments"), list(marked()))
def test_what_arrives_is_the_batch_adjustment_at_any_time(
    name: str, order: int | None, moments: int
) -> None:
    found = list(CASES[name].play(order, moments))
    assert found[-1].settled
    for moment in found:
        assert moment.promise <= 1.0, moment
        if moment.no_batch:
            assert name in WITHOUT, moment
    assert not found[-1].no_batch
    assert not found[-1].n_waiting


@pytest.mark.slow(
    "ninety iterations of a free block of photos whose steps hardly shrink; short "
    "networks come to rest at once"
)
def test_a_minimum_that_takes_many_iterations_is_found_where_there_was_none() -> None:
    """Arrivals without a minimum leave everything where it was; the next one needs 93 iterations.

    Twenty, begun anew from the same place at each arrival, never came to it.
    """
    for moment in CASES["images, free"].play(None, 5):
        assert not moment.no_batch and moment.promise <= 1.0, moment
        if moment.when.endswith("what was out is back"):
            return
