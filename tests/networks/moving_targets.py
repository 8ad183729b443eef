"""A target in free fall that theodolites follow, and two strips of a side-looking radar."""

from __future__ import annotations

import numpy as np

from factorgraph_adj import observations as o
from factorgraph_adj.network.network import Network

GRAVITY = 9.81
MUZZLE, VELOCITY = (0.0, 0.0, 20.0), (180.0, 60.0, 210.0)
"""Place and velocity of the target at the time zero, metres and m/s."""
TIMES = tuple(float(t) for t in range(1, 13))
STATIONS = {"W": (-900.0, -300.0, 35.0), "N": (600.0, 2200.0, 60.0), "S": (1500.0, -1400.0, 25.0)}
ANGLE = 5e-5
"""Standard deviation of azimuths and zenith angles, radians."""


def missile(*, lost: float = 0.02) -> Network:
    """Return a plan: azimuths and zenith angles from three stations to a target in free fall.

    Args:
        lost: standard deviation of the target about its trajectory, metres.
    """
    network = Network("missile")
    for name, at in STATIONS.items():
        network.add_point(name, at, fixed="xyz")
    network.add_point("muzzle", MUZZLE)
    network.set_unknown("point_motion", "flight", (*VELOCITY, 0, 0, 0), fixed=HELD)
    for t in TIMES:
        at = np.array(MUZZLE) + np.array(VELOCITY) * t - [0.0, 0.0, 0.5 * GRAVITY * t * t]
        name = f"at {t:g} s"
        network.add_point(name, at.tolist())
        network.add(
            o.MovedPoint(
                "muzzle", name, sigma=(lost,) * 3, motion="flight", time=t, gravity=GRAVITY
            )
        )
        for station in STATIONS:
            network.add(o.Azimuth(station, name, 0.0, sigma=ANGLE))
            network.add(o.ZenithAngle(station, name, 1.0, sigma=ANGLE))
    return network


HELD = ("x_tt", "y_tt", "z_tt")
STRIPS = {
    "left": ((-2500.0, -4500.0, 3000.0), (8.0, 100.0, 1.0)),
    "right": ((2600.0, 4400.0, 3400.0), (-3.0, -110.0, 0.5)),
}
"""Place of the sensor at the time zero, metres, and its velocity, m/s."""
CONTROL, POINTS = 5, 14


def radar() -> Network:
    """Return a plan: two strips on both sides of a terrain, whose images have zero Doppler."""
    rng = np.random.default_rng(4)
    network = Network("radar")
    places = rng.uniform((-1200.0, -3500.0, 0.0), (1200.0, 3500.0, 300.0), (POINTS, 3))
    for i, at in enumerate(places.tolist()):
        network.add_point(f"P{i}", at, fixed="xyz" if i < CONTROL else "")
    for strip, (at, velocity) in STRIPS.items():
        network.add_point(strip, at)
        network.set_unknown("point_motion", strip, (*velocity, 0, 0, 0), fixed=HELD)
        v = np.array(velocity)
        for i, place in enumerate(places):
            # zero Doppler: the sensor is abeam of the point
            time = float((place - at) @ v / (v @ v))
            given = {"motion": strip, "time": time}
            network.add(
                o.RadarRange(strip, f"P{i}", 1.0, sigma=1.0, **given),
                o.RadarSquint(strip, f"P{i}", 0.0, sigma=2e-4, **given),
            )
    return network
