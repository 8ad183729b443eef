"""Instruments whose position is not determined are named; free networks of them have a datum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import FrameDirection, FrameDistance, FrameZenith, Observation
from factorgraph_adj.simulation.measurement import measure
from tests.networks.instruments import room_of

TARGETS = {"A": (10.0, 0, 1), "B": (-5.0, 8, 2), "C": (3.0, -9, 0), "D": (7.0, 7, 4)}
VALUES = {"rx": 0.1, "ry": -0.2, "rz": 1.0, "x": 0.1, "y": 0.2, "z": 0.3}
LEVELLED = ("rz", "x", "y", "z")


def one_instrument(targets: str, observes: str, **frame: Any) -> fga.Network:
    """Return an instrument that sights held points; dzs are its kinds of sights."""
    network = fga.Network("one instrument")
    for name in targets:
        network.add_point(name, TARGETS[name], fixed="xyz")
    free = frame.pop("free", tuple(VALUES))
    network.add_frame("scan", free=free, values={k: VALUES[k] for k in free}, **frame)
    for name in targets:
        sights: dict[str, Observation] = {
            "d": FrameDirection("scan", name, 0.0, sigma=1e-5),
            "z": FrameZenith("scan", name, 1.0, sigma=1e-5),
            "s": FrameDistance("scan", name, 1.0, sigma=1e-3),
        }
        network.add(*(sights[o] for o in observes))
    return measure(network, seed=1)


@pytest.mark.parametrize(
    ("targets", "observes", "frame", "defects", "seen"),
    [
        ("AB", "dzs", {}, 1, "2 frame directions, 2 frame zeniths, 2 frame distances"),
        ("A", "dzs", {"free": LEVELLED, "level": True}, 1, "1 frame direction, 1 frame zenith"),
        ("AB", "dz", {}, 2, "2 frame directions, 2 frame zeniths"),
        ("ABCD", "s", {}, 3, "4 frame distances"),
    ],
    ids=[
        "two points, which it may turn about",
        "one point, levelled",
        "two points without distances",
        "distances alone",
    ],
)
def test_a_frame_that_is_not_determined_is_named(
    targets: str, observes: str, frame: dict[str, Any], defects: int, seen: str
) -> None:
    with pytest.raises(fga.DatumError) as error:
        fga.adjust(one_instrument(targets, observes, **frame))
    text = str(error.value)
    assert f"{defects} defect" in text
    assert "frame 'scan' is not determined" in text and seen in text


@pytest.mark.parametrize(
    ("targets", "observes", "frame", "redundancy"),
    [
        ("ABC", "dzs", {}, 3),
        ("ABC", "dz", {}, 0),
        ("AB", "dzs", {"free": LEVELLED, "level": True}, 2),
        ("AB", "dz", {"free": LEVELLED, "level": True}, 0),
    ],
)
def test_one_target_more_determines_it(
    targets: str, observes: str, frame: dict[str, Any], redundancy: int
) -> None:
    solution = fga.adjust(one_instrument(targets, observes, **frame))
    assert solution.redundancy == redundancy


def test_theodolites_alone_have_no_scale() -> None:
    """Seven defects without distances, six with those of one instrument: its scale is held."""
    without = fga.adjust(room_of(21, ["theodolite"] * 3, coarse=0.1))
    assert without.datum_defect == 7
    (defect,) = without.defects
    assert "scale" in defect.names()
    one = fga.adjust(room_of(21, ["theodolite"] * 2 + ["tracker"], coarse=0.1))
    assert one.datum_defect == 6
    for solution in (without, one):
        r = fga.reliability(solution).redundancy_numbers
        assert r.sum() == pytest.approx(solution.redundancy, abs=1e-6)


def test_a_target_at_the_instrument_or_on_its_axis_is_named() -> None:
    network = one_instrument("ABC", "dzs")
    network.add_point("Z", fga.adjust(network).point("A"))
    network.add_frame("theodolite", free=["rz"], values={"rz": 0.1}, origin="A", level=True)
    network.add(FrameDistance("theodolite", "Z", 1.0, sigma=1e-3))
    with pytest.raises(fga.InputError, match=r"frame_distance theodolite Z.*has no length"):
        fga.adjust(network)
    network = one_instrument("ABC", "dzs")
    network.add_frame("theodolite", free=["rz"], values={"rz": 0.1}, origin="A", level=True)
    above = np.add(TARGETS["A"], (0.0, 0.0, 2.0))
    network.add_point("Z", above, fixed="xyz")
    network.add(FrameDirection("theodolite", "Z", 1.0, sigma=1e-5))
    with pytest.raises(fga.InputError, match=r"frame_direction theodolite Z.*no direction"):
        fga.adjust(network)


def test_an_instrument_without_start_values_says_what_they_need() -> None:
    network = one_instrument("AB", "dz")
    free = network.frames.pop("scan")
    network.add_frame("scan", origin=(0.0, 0.0, 0.0))
    assert free.values != network.frames["scan"].values
    with pytest.raises(fga.ApproximationError, match=r"four with direction and zenith angle"):
        fga.adjust(network)
