"""Readings in two faces, one of them wrong
========================================

A total station with an index and a collimation error reads six targets in both faces. One zenith
reading of one face is wrong by 10 mgon. The reduction to means names the target, since its faces
disagree with those of the others; half of the error stays in its mean. With both faces as
observations, index and collimation error are unknowns, the reading has its own test value, and
data snooping rejects it alone.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.units import GON

MGON = GON / 1000
INDEX, COLLIMATION, WRONG = 2.0 * MGON, -3.0 * MGON, 10.0 * MGON
TARGETS = {"A": (0.0, 0.0, 100.0), "B": (61.0, 4.0, 106.0), "C": (55.0, 48.0, 111.0)}
TARGETS |= {"D": (9.0, 57.0, 103.0), "E": (-20.0, 30.0, 95.0), "F": (31.0, -25.0, 98.0)}
STATION = np.array((25.0, 20.0, 101.5))

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the network with the wrong reading")
options = parser.parse_args()

# The field book: every target in both faces.
rng = np.random.default_rng(4)
book = []
for target, at in TARGETS.items():
    d = np.array(at) - STATION
    length = np.linalg.norm(d)
    circle, zenith = np.arctan2(d[0], d[1]) + 70.0 * GON, np.arccos(d[2] / length)
    c = COLLIMATION / np.sin(zenith)
    readings = {1: (circle - c, zenith + INDEX), 2: (circle + c + np.pi, -zenith + INDEX)}
    for face, angles in readings.items():
        horizontal, vertical = (np.array(angles) + MGON * rng.normal(size=2)) % (2 * np.pi)
        distance = length + 0.002 * rng.normal()
        vertical += WRONG if (target, face) == ("C", 2) else 0.0
        reading = {"direction": horizontal, "zenith": vertical, "distance": distance}
        book.append(fga.FaceReading(station="S", target=target, face=face, **reading))

for faces in ("means", "both"):
    sigmas = {"sigma_direction": MGON, "sigma_zenith": MGON, "sigma_distance": 0.002}
    reduced = fga.reduce_faces(book, faces=faces, **sigmas)
    network = fga.Network(f"two faces: {faces}")
    for name, xyz in TARGETS.items():
        network.add_point(name, xyz, fixed="xyz")
    network.add_point("S")
    reduced.add_to(network)
    found = fga.snoop(network)
    print(f"\n{faces}: {len(network.observations)} observations")
    for doubt in reduced.doubts:
        print(f"  doubt: {doubt}")
    for r in found.rejected:
        print(f"  rejected: {r.label}, error {r.estimated_error / MGON:.1f} mgon, w {r.test:.1f}")
    print(f"  doubts that are left: {len(found.solution.network.doubts)}")
    error = 1e3 * (found.solution.point("S") - STATION)
    print("  S − true: " + " ".join(f"{e:.2f}" for e in error) + " mm")

for kind, true in (("index_error", INDEX), ("collimation_error", COLLIMATION)):
    e = found.solution.unknown(kind, "S/1")
    value, sigma = e.values[0] / MGON, e.sigmas[0] / MGON
    print(f"{kind} {value:.2f} ± {sigma:.2f} mgon (true: {true / MGON:.1f})")

if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(found.solution).savefig(options.plot, dpi=150)
    print(f"{options.plot}: the network with its ellipses of 95 %")
