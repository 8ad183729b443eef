"""A dam that is watched: epochs of three total stations, GNSS and weekly levelling.

Twelve points on two levels of an arch of 200 m, three pillars with total stations and four more
reference points on the banks. Weather changes the scale of distances and the refraction of every
epoch, both unknown with a weight; stations and GNSS are out at times.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import factorgraph_adj as fga

R = 6_371_000.0
"""Radius of the Earth of the refraction, metres."""
OBJECTS = tuple(f"D{i}" for i in range(1, 13))
STATIONS = ("T1", "T2", "T3")
BANKS = ("R1", "R2", "R3", "R4")
PLACES = {
    **{
        f"D{6 * level + i + 1}": np.array(
            [-100.0 + 40.0 * i, 30.0 * (1.0 - ((i - 2.5) / 2.5) ** 2), 20.0 + 25.0 * level]
        )
        for level in range(2)
        for i in range(6)
    },
    "T1": np.array([-90.0, -150.0, 10.0]),
    "T2": np.array([10.0, -220.0, 5.0]),
    "T3": np.array([110.0, -140.0, 12.0]),
    "R1": np.array([-200.0, -40.0, 40.0]),
    "R2": np.array([-180.0, -260.0, 22.0]),
    "R3": np.array([190.0, -250.0, 25.0]),
    "R4": np.array([210.0, -30.0, 45.0]),
}
"""Coordinates, metres."""
MGON = np.pi / 200_000.0
SIGMA_DIRECTION, SIGMA_ZENITH, SIGMA_DISTANCE = 0.15 * MGON, 0.25 * MGON, 0.0006
SIGMA_GNSS, SIGMA_LEVELLING = 0.002, 0.0003
SIGMA_SCALE, SIGMA_REFRACTION = 3e-6, 0.2
"""σ of the scale of distances, and of κ, by the weather of an epoch."""


@dataclass(frozen=True)
class Weather:
    """What is measured in an epoch."""

    stations: tuple[str, ...] = STATIONS
    """Total stations that measure."""
    gnss: bool = True
    """Whether the GNSS vectors are there."""
    levelling: bool = False
    """Whether heights are levelled."""


def drawn_weather(rng: np.random.Generator, number: int, per_week: int) -> Weather | None:
    """Return what an epoch has; None: the epoch is lost."""
    if rng.random() < 0.02:
        return None
    there = tuple(s for s in STATIONS if rng.random() >= 0.04)
    return Weather(
        there if len(there) >= 2 else STATIONS[:2],
        rng.random() >= 0.05,
        number % per_week == per_week - 1,
    )


def dam_epoch(
    rng: np.random.Generator,
    moved: dict[str, np.ndarray] | None = None,
    weather: Weather | None = None,
    noise: float = 1.0,
) -> fga.Network:
    """Return the network of an epoch.

    Args:
        rng: source of the errors.
        moved: how far points have moved, metres.
        weather: what is measured; None: all but the levels.
        noise: factor on the errors.
    """
    weather = Weather() if weather is None else weather
    true = {n: x + (moved or {}).get(n, 0.0) for n, x in PLACES.items()}
    network = fga.Network("dam", datum="free")
    for n, x in PLACES.items():
        network.add_point(n, tuple(x), datum=n not in OBJECTS)
    scale = noise * SIGMA_SCALE * rng.standard_normal()
    kappa = 0.13 + noise * SIGMA_REFRACTION * rng.standard_normal()
    network.set_distance_meter("edm", sigma_scale=SIGMA_SCALE)
    network.set_refraction("air", value=0.13, sigma=SIGMA_REFRACTION)
    for s in weather.stations:
        turn = rng.uniform(0.0, 2.0 * np.pi)
        targets = [n for n in PLACES if n != s]
        e = noise * rng.standard_normal((len(targets), 3))
        for n, (e1, e2, e3) in zip(targets, e, strict=True):
            d = true[n] - true[s]
            h, length = float(np.hypot(d[0], d[1])), float(np.linalg.norm(d))
            reading = (np.arctan2(d[0], d[1]) - turn + SIGMA_DIRECTION * e1) % (2.0 * np.pi)
            network.add(fga.Direction(s, n, float(reading), sigma=SIGMA_DIRECTION))
            z = np.pi / 2.0 - np.arctan2(d[2], h) - kappa * h / (2.0 * R) + SIGMA_ZENITH * e2
            network.add(fga.ZenithAngle(s, n, float(z), sigma=SIGMA_ZENITH, refraction="air"))
            network.add(
                fga.SlopeDistance(
                    s,
                    n,
                    (1.0 + scale) * length + SIGMA_DISTANCE * float(e3),
                    sigma=SIGMA_DISTANCE,
                    instrument="edm",
                )
            )
    if weather.gnss:
        for n in (*STATIONS[1:], *BANKS):
            d = true[n] - true["T1"] + noise * SIGMA_GNSS * rng.standard_normal(3)
            network.add(fga.GnssVector("T1", n, tuple(d.tolist()), sigma=(SIGMA_GNSS,) * 3))
    if weather.levelling:
        line = ("R1", *OBJECTS[:6], "R4", *OBJECTS[:5:-1], "R1")
        for a, b in pairwise(line):
            d = float((true[b] - true[a])[2]) + noise * SIGMA_LEVELLING * rng.standard_normal()
            network.add(fga.HeightDifference(a, b, float(d), sigma=SIGMA_LEVELLING))
    return network
