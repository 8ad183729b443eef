"""Misclosures of traverses, before an adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.observations import (
    Direction,
    HorizontalAngle,
    HorizontalDistance,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.validate.findings import Finding
from factorgraph_adj.validate.traverse_misclosures import Traverse, TraverseReadings, open_traverses

SIGMA_ANGLE, SIGMA_DISTANCE = 1.5e-5, 0.003
"""Standard deviations: radians (1 mgon), metres."""
MGON = np.pi / 200e3
OPEN = ("A", "1", "2", "3", "4", "B")
"""Points of a traverse between two held points; V and W are their backsights."""
AT = {
    "V": (-210.0, 130.0, 3.0),
    "A": (0.0, 0.0, 0.0),
    "1": (120.0, 45.0, 4.0),
    "2": (230.0, -20.0, 9.0),
    "3": (340.0, 60.0, 6.0),
    "4": (455.0, 10.0, 2.0),
    "B": (560.0, 75.0, 1.0),
    "W": (700.0, -160.0, 5.0),
}
"""East, north, up, metres."""
HEIGHT, TARGET = 1.52, 1.37


def sighted(
    station: str, targets: Sequence[str], rng: np.random.Generator, *, far: Sequence[str] = ()
) -> list[Any]:
    """Return directions, and zenith angles and distances to targets that are not far."""
    orientation = rng.uniform(0.0, 2 * np.pi)
    out: list[Any] = []
    for target in (*targets, *far):
        d = np.array(AT[target]) - AT[station] + [0.0, 0.0, TARGET - HEIGHT]
        length = float(np.linalg.norm(d))
        e = rng.normal(size=3)
        heights: dict[str, Any] = {"instrument_height": HEIGHT, "target_height": TARGET}
        direction = (np.arctan2(d[0], d[1]) - orientation + SIGMA_ANGLE * e[0]) % (2 * np.pi)
        out.append(Direction(station, target, float(direction), sigma=SIGMA_ANGLE, **heights))
        if target not in far:
            zenith = float(np.arccos(d[2] / length) + SIGMA_ANGLE * e[1])
            slope = length + SIGMA_DISTANCE * float(e[2])
            out.append(ZenithAngle(station, target, zenith, sigma=SIGMA_ANGLE, **heights))
            out.append(SlopeDistance(station, target, slope, sigma=SIGMA_DISTANCE, **heights))
    return out


def between(
    seed: int = 0, *, backsights: Sequence[str] = ("V", "W"), axes: Any = "en"
) -> tuple[fga.Network, list[Any]]:
    """Return a traverse from A to B, and its readings."""
    rng = np.random.default_rng(seed)
    network = fga.Network("a traverse", frame=LocalFrame(axes=axes))
    turn = network.frame.east_north  # type: ignore[union-attr]
    for name, at in AT.items():
        held = name in "VABW"
        x, y = np.array(at[:2]) @ turn[:, :2]
        network.add_point(name, (x, y, at[2]) if held else None, fixed="xy" if held else "")
    readings: list[Any] = []
    for i, station in enumerate(OPEN):
        beside = [OPEN[j] for j in (i - 1, i + 1) if 0 <= j < len(OPEN)]
        far = [{"A": "V", "B": "W"}.get(station, "")]
        readings += sighted(station, beside, rng, far=[n for n in far if n in backsights])
    return network, readings


def found(network: fga.Network, readings: Sequence[Any]) -> list[Finding]:
    """Return what the traverses of a network tell."""
    out = network.copy()
    out.add(*readings)
    return list(open_traverses(out))


def changed(readings: Sequence[Any], kind: Any, station: str, target: str, by: float) -> list[Any]:
    """Return the readings, one of them too large."""
    return [
        replace(o, value=o.value + by)
        if isinstance(o, kind) and (o.station, o.target) == (station, target)
        else o
        for o in readings
    ]


@pytest.mark.parametrize("axes", ["en", "nw", "ne"])
@pytest.mark.parametrize("backsights", [("V", "W"), ("V",), ("W",), ()])
def test_a_good_traverse_closes(axes: str, backsights: Sequence[str]) -> None:
    for seed in range(20):
        assert not found(*between(seed, backsights=backsights, axes=axes))


def test_a_wrong_direction_is_told_with_its_station() -> None:
    network, readings = between()
    (finding,) = found(network, changed(readings, Direction, "3", "4", 40.0 * MGON))
    assert "the angles of the traverse 'A' – '1' – '2' – '3' – '4' – 'B' (5 legs)" in finding.what
    assert finding.size == pytest.approx(40.0, abs=3.29 * np.sqrt(12))
    assert finding.tolerance == pytest.approx(3.29 * np.sqrt(12) * SIGMA_ANGLE / MGON)
    assert finding.unit == "mgon" and "a wrong angle at '3' explains it" in finding.remedy


@pytest.mark.parametrize("backsights", [("V", "W"), ("V",), ("W",)])
def test_a_wrong_distance_is_told_with_its_leg(backsights: Sequence[str]) -> None:
    network, readings = between(backsights=backsights)
    for station, target in (("2", "3"), ("3", "2")):
        readings = changed(readings, SlopeDistance, station, target, 0.5)
    (finding,) = found(network, readings)
    assert "does not close" in finding.what and finding.unit == "mm"
    assert finding.size == pytest.approx(500.0, abs=15.0)
    assert finding.tolerance < 60.0
    # The last leg runs in the same direction.
    legs = ("'2' – '3' or '4' – 'B'", "'B' – '4' or '3' – '2'")
    assert any(f"a wrong distance {leg} explains it" in finding.remedy for leg in legs)


def test_a_traverse_without_azimuths_is_as_long_as_its_ends_are_apart() -> None:
    network, readings = between(backsights=())
    for station, target in (("2", "3"), ("3", "2")):
        readings = changed(readings, SlopeDistance, station, target, 0.5)
    (finding,) = found(network, readings)
    assert "is not as long as its ends are apart" in finding.what
    assert 300.0 < finding.size < 500.0


def test_the_misclosure_has_the_standard_deviation_that_it_says() -> None:
    """Of 400 good traverses w²/σ² has the mean 1, for angles, components and lengths."""
    angular, directed, length = [], [], []
    for seed in range(400):
        network, readings = between(seed)
        network.add(*readings)
        t = Traverse(TraverseReadings.of(network), OPEN)
        closure, linear = t.angular(), t.linear()
        assert closure is not None and linear is not None and linear[2]
        angular.append((closure[0] / closure[1]) ** 2)
        directed.append(float(linear[0] @ np.linalg.solve(linear[1], linear[0])) / 2)
        network, readings = between(seed, backsights=())
        network.add(*readings)
        linear = Traverse(TraverseReadings.of(network), OPEN).linear()
        assert linear is not None and not linear[2]
        w, covariance, _ = linear
        length.append(float(w @ w) ** 2 / float(w @ covariance @ w))
    for ratios in (angular, directed, length):
        assert 0.8 < np.mean(ratios) < 1.2


def ring(seed: int = 0) -> tuple[fga.Network, list[Any]]:
    """Return a closed traverse without a held point, measured with angles."""
    rng = np.random.default_rng(seed)
    names = ("1", "2", "3", "4", "W")
    network = fga.Network("a ring")
    for name in names:
        network.add_point(name)
    readings: list[Any] = []
    for i, station in enumerate(names):
        before, after = names[i - 1], names[(i + 1) % len(names)]
        to = [np.array(AT[n])[:2] - AT[station][:2] for n in (before, after)]
        azimuth = [np.arctan2(*d) for d in to]
        angle = (azimuth[1] - azimuth[0] + SIGMA_ANGLE * rng.normal()) % (2 * np.pi)
        length = float(np.hypot(*to[1]) + SIGMA_DISTANCE * rng.normal())
        readings.append(HorizontalAngle(station, before, after, float(angle), sigma=SIGMA_ANGLE))
        readings.append(HorizontalDistance(station, after, length, sigma=SIGMA_DISTANCE))
    return network, readings


def test_a_closed_traverse_is_tested_without_coordinates() -> None:
    for seed in range(20):
        assert not found(*ring(seed))
    network, readings = ring()
    (finding,) = found(network, changed(readings, HorizontalAngle, "3", "2", 0.01))
    assert "the angles of the traverse" in finding.what
    assert abs(finding.size) == pytest.approx(0.01 / MGON, abs=20.0)
    (finding,) = found(network, changed(readings, HorizontalDistance, "2", "3", 0.3))
    assert finding.size == pytest.approx(300.0, abs=30.0)
    legs = ("'2' – '3'", "'3' – '2'")
    assert any(f"a wrong distance {leg} explains it" in finding.remedy for leg in legs)


def test_distances_with_a_free_meter_make_no_traverse() -> None:
    network, readings = ring()
    network.set_distance_meter("edm", scale=0.0, zero=0.0, free=("scale",))
    readings = [
        replace(o, instrument="edm") if isinstance(o, HorizontalDistance) else o
        for o in changed(readings, HorizontalDistance, "2", "3", 0.3)
    ]
    assert not found(network, readings)


def test_preliminary_tells_of_traverses() -> None:
    network, readings = between()
    network.add(*changed(readings, Direction, "3", "4", 40.0 * MGON))
    (finding,) = [f for f in fga.preliminary(network) if "traverse" in f.what]
    assert finding.size == pytest.approx(40.0, abs=12.0)
