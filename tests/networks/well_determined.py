"""Two points by four distances each, and what can be hung on them."""

import numpy as np

import factorgraph_adj as fga

PLACES = {
    **{"A": (0, 0, 0), "B": (100, 0, 1), "C": (90, 80, 2), "D": (5, 70, 9)},
    **{"P": (40, 50, 3), "Q": (60, 20, 1), "X": (10, 90, 4), "Y": (10, 95, 4), "Z": (15, 95, 5)},
}


def distance(network, a, b, rng):
    true = np.linalg.norm(np.subtract(PLACES[a], PLACES[b]))
    network.add(fga.SlopeDistance(a, b, float(true + rng.normal(0, 0.002)), sigma=0.002))


def rise(network, a, b):
    network.add(fga.HeightDifference(a, b, PLACES[b][2] - PLACES[a][2], sigma=0.002))


def well_determined():
    """Two points by four distances each."""
    network, rng = fga.Network("well determined"), np.random.default_rng(4)
    for name in "ABCD":
        network.add_point(name, PLACES[name], fixed="xyz")
    for name in "PQ":
        network.add_point(name, PLACES[name])
        for station in "ABCD":
            distance(network, station, name, rng)
    return network


def seen_once(network, rng):
    network.add_point("X", PLACES["X"])
    distance(network, "P", "X", rng)
    return {"X"}
