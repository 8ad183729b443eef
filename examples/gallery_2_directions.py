"""Directions in sets and refraction
=================================

A triangulation of 2 to 4 km with simulated readings: no distance is measured, the scale comes from
two known points. Each station turned its circle twice, so that it has two orientation unknowns. The
coefficient of refraction of the day is an unknown of the network, found from zenith angles.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, ZenithAngle
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.units import GON

MGON = GON / 1000
TRUE_KAPPA = 0.17
POINTS = {"Church": (0.0, 0.0, 412.0), "Hill": (3120.0, 240.0, 655.0)}
POINTS |= {"Ridge": (2500.0, 2710.0, 801.0), "Tower": (310.0, 2390.0, 498.0)}
POINTS |= {"Quarry": (1490.0, 1260.0, 447.0)}
KNOWN, SETS = ("Church", "Hill"), ("1", "2")

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the network with its error ellipses")
options = parser.parse_args()

# A plan with true values, measured.
frame = fga.TopocentricFrame(np.deg2rad(47.0), np.deg2rad(11.0), 0.0)
plan = fga.Network("triangulation", frame=frame)
for name, xyz in POINTS.items():
    plan.add_point(name, xyz, fixed="xyz" if name in KNOWN else "")
plan.set_refraction(value=TRUE_KAPPA)
for number, station in enumerate(POINTS):
    for circle, name in enumerate(SETS):
        plan.set_orientation(station, set=name, value=(37.0 * number + 100.0 * circle) * GON)
    for target in POINTS:
        if target != station:
            plan.add(*(Direction(station, target, 0.0, sigma=0.6 * MGON, set=s) for s in SETS))
            plan.add(ZenithAngle(station, target, 0.0, sigma=0.8 * MGON))
network = disturb(measure(plan, seed=3), seed=3, points=1.0)
network.set_refraction(value=0.13)

solution = fga.adjust(network)
print(network)
print(f"{solution.n_unknowns} unknowns, redundancy {solution.redundancy}, σ̂0 {solution.sigma0:.3f}")

print("\npoint        east, m    north, m   height, m   σE, mm  σN, mm  σH, mm      error, mm")
for name in (p for p in POINTS if p not in KNOWN):
    at, sigma = solution.point(name), 1e3 * solution.standard_deviations(name)
    error = 1e3 * (at - POINTS[name])
    print(
        f"{name:8}"
        + "".join(f"{v:12.4f}" for v in at)
        + " "
        + "".join(f"{s:8.1f}" for s in sigma)
        + "   "
        + "".join(f"{e:+7.1f}" for e in error)
    )

print("\norientation of set      gon     σ, mgon")
for station in POINTS:
    for name in SETS:
        o = solution.orientation(station, name)
        value, sigma = o.values[0] % (400 * GON) / GON, o.sigmas[0] / MGON
        print(f"{station:8} set {name}{value:14.4f}{sigma:12.2f}")

kappa = solution.refraction()
print(f"\nrefraction κ {kappa.values[0]:.3f} ± {kappa.sigmas[0]:.3f} (true: {TRUE_KAPPA})")

if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(solution).savefig(options.plot, dpi=150)
    print(f"{options.plot}: the network with its ellipses of 95 %")
