"""Alignment: two wires and a water tube in a tunnel, a body with sensors, offsets at a station."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array

LENGTH = 60.0
"""Length of the wires, metres."""
SENSORS = 7
MICRON = 1e-6
OF_WIRE, OF_WATER = 10 * MICRON, 5 * MICRON
"""Standard deviations of readings, metres."""
WIRES = {"W1": (0.02, 0.05, 0.012), "W2": (-0.15, 0.12, 0.020)}
"""Offset across and height at the start, and sag, metres."""
SIGHTED = {"K0": (8.0, 14.0, 1.0), "K1": (-5.0, 17.0, 0.4), "K2": (11.0, 6.0, 2.0)}
"""Points that are free in the network of offsets."""


def _sensor(i: int) -> Array:
    """Return the place of a sensor, metres."""
    return np.array([0.03 * np.sin(2.0 * i), LENGTH * i / (SENSORS - 1), 0.02 * np.cos(1.3 * i)])


def tunnel(*, held: bool = True, water: bool = True, body: bool = False) -> fga.Network:
    """Return sensors of two wires and a water tube, of which the first and the last are held.

    Args:
        held: whether they are; otherwise the network is free.
        water: whether the heights are read at water.
        body: whether a body carries sensors, an inclinometer and a camera too.
    """
    network = fga.Network("tunnel", datum="given" if held else "free")
    origin = None if held else "S0"
    for i in range(SENSORS):
        end = i in (0, SENSORS - 1)
        network.add_point(f"S{i}", _sensor(i), fixed="xyz" if end and held else "y")
    for name, (across, height, sag) in WIRES.items():
        _wire(network, name, across, height, sag, origin)
        for i in range(0 if held else 1, SENSORS):
            network.add(
                o.WireReading(
                    name, f"S{i}", (0.0, 0.0), sag=name, length=LENGTH, sigma=(OF_WIRE,) * 2
                )
            )
    if water:
        network.set_level("tube", 0.15)
        network.set_mount("S3 cup", values={"z": 0.01}, sigma={"z": 20 * MICRON})
        for i in range(SENSORS):
            mount = "S3 cup" if i == 3 else None
            network.add(o.HydrostaticReading(f"S{i}", "tube", 0.1, mount=mount, sigma=OF_WATER))
    if body:
        _body(network)
    return network


def free_tunnel() -> fga.Network:
    """Return the tunnel without datum, its sensors joined by distances.

    The wires begin at the first sensor: from a place in space they would hold the network along y.
    """
    network = tunnel(held=False)
    for name, p in network.points.items():
        network.points[name] = replace(p, fixed=(False,) * 3)
    for i in range(SENSORS):
        for j in range(i + 1, min(i + 3, SENSORS)):
            network.add(o.SlopeDistance(f"S{i}", f"S{j}", 1.0, sigma=1e-4))
    return network


def _wire(
    network: fga.Network, name: str, across: float, height: float, sag: float, origin: str | None
) -> None:
    """Add a wire, from a place or from a point, with which it moves in a free network."""
    values = {"rz": -0.001, "rx": 0.0005, "ry": 0.0, "x": across, "z": height}
    at = origin or (0.0, 0.0, 0.0)
    network.add_frame(name, free=list(values), values=values, origin=at, level=True)
    network.add(o.FrameRoll(name, "S0", 0.0, sigma=1e-4))  # its roll has no effect
    network.set_size(name, sag)


def _body(network: fga.Network) -> None:
    """Add a body with two sensors of wires, an inclinometer, and a camera that sees targets."""
    turns = {"rx": 0.004, "ry": -0.003, "rz": 0.01}
    network.add_frame(
        "girder",
        free=(*turns, "x", "y", "z"),
        values={**turns, "x": 0.01, "y": -0.02, "z": 0.01},
        origin=(0.3, 31.0, 0.3),
    )
    on_it = {"G0": (-0.2, -1.5, -0.2), "G1": (-0.2, 1.5, -0.2), "G2": (0.4, 0.1, 0.3)}
    for name, at in on_it.items():
        network.add_point(name, np.array([0.3, 31.0, 0.3]) + at)
        q = (0.0, 0.0, 0.0)
        network.add(o.FrameCoordinate("girder", name, q, sigma=(20 * MICRON,) * 3))
    network.set_mount("eye", values={"rx": 0.02, "ry": 0.01, "rz": -0.3})
    for name in ("G0", "G1"):
        for wire in WIRES:
            network.add(
                o.WireReadingOnBody(
                    wire,
                    name,
                    (0.0, 0.0),
                    body="girder",
                    mount="eye",
                    sag=wire,
                    length=LENGTH,
                    sigma=(OF_WIRE, OF_WIRE),
                )
            )
    second = 5e-6
    network.add(o.FrameInclination("girder", "G2", 0.0, sigma=second))
    network.add(o.FrameRoll("girder", "G2", 0.0, mount="eye", sigma=second))
    for i, at in enumerate([(1.0, 28.0, 9.0), (-2.0, 33.0, 8.0), (2.5, 36.0, 10.0)]):
        network.add_point(f"T{i}", at, fixed="xyz")
        network.add(
            o.UnitVector("girder", "G2", f"T{i}", (0.0, 0.0), sigma=(1e-5, 1e-5), mount="eye")
        )
        network.add(o.SlopeDistance("G2", f"T{i}", 1.0, sigma=1e-4))


def offsets() -> fga.Network:
    """Return points with offsets from a plane, a plumb line, a line, and sights of a theodolite."""
    network = fga.Network("offsets")
    for name, at in {"A": (0, 0, 0), "B": (0, 20, 1), "C": (15, 12, 0.5)}.items():
        network.add_point(name, at, fixed="xyz")
    network.add_frame(
        "plane", free=("rz", "x"), values={"rz": 0.3, "x": 0.5}, origin=(3.0, 8.0, 0.0), level=True
    )
    network.add_frame(
        "plumb", free=("x", "y"), values={"x": 0.2, "y": -0.4}, origin=(2.0, 9.0, 0.0), level=True
    )
    network.set_orientation("A", value=0.0)
    for target in ("B", "C"):
        network.add(o.Direction("A", target, 0.0, sigma=1e-5))
    mm = 1e-3
    for number, (name, at) in enumerate(SIGHTED.items()):
        network.add_point(name, at)
        network.add(o.ControlPoint(name, at, sigma=(5 * mm, 5 * mm, 5 * mm)))
        azimuth = float(np.arctan2(at[0], at[1]))
        for frame, kind in (("plane", o.PlaneOffset), ("plumb", o.PlumbOffset)):
            network.add(kind(frame, name, 1.0, sigma=mm))
        network.add(
            o.LineOffset(name, "A", "B", 1.0, sigma=mm),
            o.SightPlaneOffset("A", name, 0.0, horizontal=azimuth + 0.02, sigma=mm),
            o.SightOffset("A", name, 1.0, horizontal=azimuth - 0.3, zenith=1.4, sigma=mm),
            o.RadialOffset(
                name, 0.0, bearing=1.0 + number, reference_x=at[0], reference_y=at[1], sigma=mm
            ),
        )
    for name in ("A", "B", "C"):
        for frame, kind in (("plane", o.PlaneOffset), ("plumb", o.PlumbOffset)):
            network.add(kind(frame, name, 1.0, sigma=mm))
    return network


def body() -> fga.Network:
    """Return the tunnel with the body."""
    return tunnel(body=True)


def measured(network: fga.Network, seed: int = 1, *, noise: bool = True) -> fga.Network:
    """Return the network with readings drawn for a seed."""
    return measure(network, seed=seed, noise=noise)
