"""Two strips of a lunar orbiter: photos of two arcs, from 46 km, over points of a sphere.

The camera is the one of 80 mm of the Lunar Orbiter missions. The axes turn with the Moon; control
stands at the beginning of the strips only, so that their ends lean on the orbits.
"""

from __future__ import annotations

import numpy as np

from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.models.arcs import arc_places
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.types import Array

GM_MOON, SPIN_MOON = 4.9028e12, 2.6617e-6
"""Gravitational parameter, m³/s², and rate of turn, rad/s."""
RADIUS, ALTITUDE = 1_737_400.0, 46_000.0
FOCAL, HALF = 80.0, (32.0, 27.0)
"""Principal distance and half the format along and across the strip, mm."""
SIGMA_MM, SIGMA_CONTROL = 0.01, 10.0
INTERVAL = 9.0
"""Time between exposures, seconds: 15 km of way, 60 % overlap."""
SIGMA_ARC = 3.0
"""By how much photos may differ from their arcs, metres."""
INCLINATIONS = (0.2, 0.22)


def lunar_strips(
    photos: int = 8,
    points: int = 90,
    *,
    arcs: bool = True,
    control: bool = True,
    gm: float = GM_MOON,
    spin: float = SPIN_MOON,
) -> Network:
    """Return the strips with their true values.

    Args:
        photos: photos of each strip.
        points: points on the ground, some of which no two photos see.
        arcs: whether photos are tied to their arcs.
        control: whether there is control at the beginning of the strips.
        gm: gravitational parameter; 0: the photos are tied to polynomials of the second power.
        spin: rate at which the axes turn.
    """
    network = Network("lunar strips", frame=GeocentricFrame("Moon"))
    network.add_camera("camera", NoDistortion(), {"c": FOCAL}, format=(2 * HALF[0], 2 * HALF[1]))
    rng = np.random.default_rng([photos, points])
    time = INTERVAL * (np.arange(photos) - (photos - 1) / 2.0)
    passes: list[tuple[Array, Array, Array]] = []
    for i, inclination in enumerate(INCLINATIONS):
        at = (RADIUS + ALTITUDE) * np.array([1.0, 0.0, 0.008 * (i - 0.5)])
        ahead = np.array([0.0, np.cos(inclination), np.sin(inclination)])
        velocity = np.sqrt(GM_MOON / np.linalg.norm(at)) * ahead
        arc = np.array([*at, *velocity, GM_MOON, spin])
        places = arc_places(network.frame, np.tile(arc, (photos, 1)), time)[0]
        passes.append((arc, places, _nadir(places, velocity)))
    ways = np.concatenate([places for _, places, _ in passes])
    middle = np.array([0.0, np.cos(INCLINATIONS[0]), np.sin(INCLINATIONS[0])])
    along = ways @ middle
    drawn = rng.uniform(along.min() - 8e3, along.max() + 8e3, points)
    across = np.array([0.0, -middle[2], middle[1]])
    ground = drawn[:, None] * middle + rng.uniform(-2.2e4, 2.2e4, (points, 1)) * across
    ground[:, 0] = np.sqrt(RADIUS**2 - np.sum(ground**2, axis=1))
    ground *= 1.0 + rng.normal(0.0, 600.0, (points, 1)) / RADIUS
    views = [
        _inside(ground, at, rotation)
        for _, places, turns in passes
        for at, rotation in zip(places, turns, strict=True)
    ]
    seen = np.array(views)
    used = np.flatnonzero(seen.sum(axis=0) >= 2)
    names = [f"P{i}" for i in range(points)]
    for i in used.tolist():
        network.add_point(names[i], ground[i])
    for number, (arc, places, turns) in enumerate(passes):
        strip = {}
        for i in range(photos):
            photo, inside = f"F{number}{i}", seen[number * photos + i]
            network.add_photo(photo, "camera", position=places[i], rotation=turns[i])
            own = [names[j] for j in used.tolist() if inside[j]]
            network.add_image_points(photo, own, np.zeros((len(own), 2)), sigma=SIGMA_MM)
            strip[photo] = float(time[i])
        if arcs and gm:
            values = dict(zip(("x", "y", "z", "x_t", "y_t", "z_t"), arc[:6].tolist(), strict=True))
            network.add_arc(
                f"pass {number}", strip, sigma=SIGMA_ARC, gm=gm, spin=spin, values=values
            )
        elif arcs:
            network.add_arc(f"pass {number}", strip, sigma=SIGMA_ARC, power=2)
    if control:
        first = sorted(used.tolist(), key=lambda i: drawn[i])[:6]
        for i in first:
            sigma = (SIGMA_CONTROL,) * 3
            network.add(ControlPoint(names[i], (0.0, 0.0, 0.0), sigma=sigma))
    return network


def _nadir(places: Array, velocity: Array) -> Array:
    """Return rotations (n, 3, 3) of cameras that look down, x to the front."""
    down = -places / np.linalg.norm(places, axis=1, keepdims=True)
    ahead = velocity - (down @ velocity)[:, None] * down
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.stack([ahead, np.cross(down, ahead), down], axis=2)


def _inside(ground: Array, at: Array, rotation: Array) -> Array:
    p = (ground - at) @ rotation
    return np.asarray((np.abs(FOCAL * p[:, :2] / p[:, 2:]) < HALF).all(axis=1))


def measured(plan: Network, seed: int) -> Network:
    """Return the strips with measuring errors and rough start values, arcs fitted to them."""
    network = disturb(measure(plan, seed=seed), seed=seed, points=300, centres=300, attitudes=0.003)
    for name, arc in plan.of_kind("arc").items():
        times = {o.photo: o.time for o in plan.observations.values() if _on(o, name)}
        rough = network.copy()
        rough.add_arc(f"rough {name}", times, sigma=1.0, gm=arc.values[6], spin=arc.values[7])
        start = rough.of_kind("arc")[f"rough {name}"]
        network.set_unknown("arc", name, start.values, fixed=("gm", "spin"))
    return network


def _on(observation: object, name: str) -> bool:
    return getattr(observation, "arc", None) == name
