"""MMVII survey measurements: points and observations in a subset of Comp3D's format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    ControlPoint,
    Direction,
    HeightDifference,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.units import GON

DISTANCE, HEIGHT_DIFFERENCE, DIRECTION, ZENITH, NEW_ROUND = 3, 4, 5, 6, 7


def observe(code: int, station: str, target: str, value: float, sigma: float) -> Observation:
    """Return an observation of a code; m or gon."""
    if code == DISTANCE:
        return SlopeDistance(station, target, value, sigma=sigma)
    if code == HEIGHT_DIFFERENCE:
        return HeightDifference(station, target, value, sigma=sigma)
    if code == ZENITH:
        return ZenithAngle(station, target, value * GON, sigma=sigma * GON)
    if code in (DIRECTION, NEW_ROUND):
        return Direction(station, target, value * GON, sigma=sigma * GON)
    raise ValueError(f"code {code}")


def read_network(
    coordinates: Path, measurements: Path, *, sigma: float, approximate: bool = True
) -> Network:
    """Read a survey with one round of directions at each station, in a flat local frame.

    Args:
        coordinates: code, name, X, Y, Z; code 1: given with ``sigma``, metres; code 0: approximate.
            Large coordinates are shortened by whole kilometres.
        measurements: code, station, target, value, standard deviation.
        sigma: of given points, metres.
        approximate: whether to read the coordinates of the others.
    """
    network = Network(measurements.stem, frame=LocalFrame())
    for line in _lines(coordinates):
        code, name, *xyz = line.split()[:5]
        at = np.array(xyz, dtype=float) - (657_000.0, 6_860_000.0, 0.0)
        network.add_point(name, at if code == "1" or approximate else None)
        if code == "1":
            network.add(ControlPoint(name, tuple(at), sigma=(sigma,) * 3))
    for line in _lines(measurements):
        code, station, target, value, s = line.split()[:5]
        network.add(observe(int(code), station, target, float(value), float(s)))
    return network


def _lines(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    lines = [line.split("*")[0].split("#")[0].strip() for line in text.splitlines()]
    return [line for line in lines if line]
