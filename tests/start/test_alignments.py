"""Start values of planes, plumb lines, wires and water, and what their readings leave open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.rotation import exp_rotation
from tests.networks.alignment import LENGTH, SENSORS, WIRES, measured, tunnel

MILLIMETRE = 1e-3


def held_tunnel() -> fga.Network:
    """Return the tunnel, all of whose sensors are held."""
    network = tunnel()
    for name, p in network.points.items():
        network.points[name] = replace(p, fixed=(True,) * 3)
    return network


def without_values(network: fga.Network) -> fga.Network:
    """Return the network without values of its wires, sags and water."""
    out = network.copy()
    for name, p in network.frames.items():
        given = [v if h else np.nan for v, h in zip(p.values, p.fixed, strict=True)]
        out.frames[name] = replace(p, values=tuple(given))
    for name in WIRES:
        out.set_size(name)
    out.set_level("tube")
    return out


def test_wires_and_water_start_from_held_sensors() -> None:
    true = fga.adjust(measured(held_tunnel(), noise=False))
    found = fga.adjust(without_values(measured(held_tunnel(), noise=False)))
    for kind, names in (("frame", WIRES), ("size", WIRES), ("level", ["tube"])):
        for name in names:
            a, b = (s.unknown(kind, name).values for s in (true, found))
            assert np.allclose(a, b, rtol=0, atol=1e-6), (kind, name)  # a roll of wires is free


@pytest.mark.parametrize("bearing", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
def test_a_plane_starts_at_any_bearing(bearing: float) -> None:
    rng = np.random.default_rng(2)
    network = fga.Network("wall")
    network.add_frame("wall", free=("rz", "x"), origin=(0.0, 0.0, 0.0), level=True)
    normal = exp_rotation(np.array([[0.0, 0.0, bearing]]))[0][:, 0]
    for i in range(5):
        at = rng.uniform(-10, 10, 3)
        network.add_point(f"P{i}", at, fixed="xyz")
        network.add(o.PlaneOffset("wall", f"P{i}", float(normal @ at) - 3.0, sigma=MILLIMETRE))
    found = fga.adjust(network).unknown("frame", "wall").values
    assert np.cos(found[2] - bearing) == pytest.approx(1.0, abs=1e-12)
    assert found[3] == pytest.approx(3.0, abs=1e-6)


PLUMB = {"P0": (3.0, 4.0, 5.0), "P1": (0.0, 4.0, 4.0), "P2": (5.0, 0.0, 5.0)}
"""Plan of points, and their distances from a plumb line in the origin."""


def plumb_line(points: int, **values: float) -> fga.Network:
    network = fga.Network("plumb line")
    network.add_frame("line", free=("x", "y"), origin=(0, 0, 0), level=True, values=values)
    for name, (x, y, d) in list(PLUMB.items())[:points]:
        network.add_point(name, (x, y, 1.0), fixed="xyz")
        network.add(o.PlumbOffset("line", name, d, sigma=MILLIMETRE))
    return network


def test_a_plumb_line_starts_from_three_points() -> None:
    found = fga.adjust(plumb_line(3)).unknown("frame", "line").values
    assert np.allclose(found[3:5], 0.0, rtol=0, atol=1e-9)


def test_two_offsets_leave_two_plumb_lines() -> None:
    with pytest.raises(fga.ApproximationError, match="'line': two positions fit equally well"):
        fga.adjust(plumb_line(2))
    found = fga.adjust(plumb_line(2, x=0.5, y=-0.5)).unknown("frame", "line").values
    assert np.allclose(found[3:5], 0.0, rtol=0, atol=1e-9)


def test_one_offset_leaves_a_plumb_line_open() -> None:
    why = "frame 'line': .* 1 readings at known points cannot give its 2 unknowns"
    with pytest.raises(fga.ApproximationError, match=why):
        fga.adjust(plumb_line(1))
    with pytest.raises(fga.DatumError, match=r"frame 'line' is not determined \(1 plumb offset"):
        fga.adjust(plumb_line(1, x=0.5, y=-0.5))


def one_wire(sensors: tuple[int, ...], *, sag: float | None = None) -> fga.Network:
    """Return a wire with readings at some sensors; the sag is free, or held at a value."""
    network = held_tunnel()
    network.parameters["frame"].pop("W2")
    network.parameters["size"].pop("W2")
    network.parameters["mount"].clear()
    network.parameters["level"].clear()
    network.observations = {
        i: x
        for i, x in measured(held_tunnel()).observations.items()
        if getattr(x, "frame", "") == "W1"
        and (x.kind == "frame_roll" or int(x.point[1:]) in sensors)
    }
    if sag is not None:
        network.set_size("W1", sag, fixed=True)
    return network


def test_two_readings_leave_the_sag_open() -> None:
    """Two sensors read the chord, whatever its sag."""
    with pytest.raises(fga.DatumError, match=r"(frame|size) 'W1' is not determined"):
        fga.adjust(one_wire((0, 6)))
    network = one_wire((0, 6))
    network.set_size("W1")
    p = network.frames["W1"]
    values = [v if h else np.nan for v, h in zip(p.values, p.fixed, strict=True)]
    network.frames["W1"] = replace(p, values=tuple(values))
    with pytest.raises(fga.ApproximationError, match=r"5 readings .* its 6 unknowns .*size 'W1'"):
        fga.adjust(network)
    assert fga.adjust(one_wire((0, 6), sag=WIRES["W1"][2])).redundancy == 0
    assert fga.adjust(one_wire((0, 3, 6))).redundancy == 1


def test_water_alone_leaves_its_height_open() -> None:
    network = fga.Network("tube")
    network.set_level("tube", 0.15)
    for i in range(SENSORS):
        network.add_point(f"S{i}", (0.0, LENGTH * i, 0.0), fixed="xy")
        network.add(o.HydrostaticReading(f"S{i}", "tube", 0.15, sigma=MILLIMETRE))
    with pytest.raises(fga.DatumError, match="missing shift in z"):
        fga.adjust(network)
    free = fga.adjust(network, datum="free")
    assert free.redundancy == 0
    network.points["S0"] = replace(network.points["S0"], fixed=(True,) * 3)
    assert fga.adjust(network).redundancy == 0


def test_a_tube_that_nothing_joins_to_the_others_is_named() -> None:
    network = tunnel()
    network.set_level("other", 0.3)
    network.add_point("X", (5.0, 5.0, 0.1), fixed="xy")
    network.add(o.HydrostaticReading("X", "other", 0.2, sigma=MILLIMETRE))
    with pytest.raises(fga.DatumError, match="of the part with X: missing shift in z"):
        fga.adjust(measured(network))
