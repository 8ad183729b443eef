"""Reliability and gross errors of a traverse
==========================================

How reliable is a network? A traverse with cross sights is simulated. Two readings are
then made wrong, and data snooping finds them.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, HorizontalDistance
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.units import GON

MM, MGON, SIGMA = 1e-3, GON / 1000, fga.StandardDeviation(0.002, ppm=2)
UNITS = {"direction": (MGON, "mgon"), "horizontal_distance": (MM, "mm")}
POINTS = {"A": (0, 0), "B": (900, 60), "1": (180, 140), "2": (330, -40), "3": (480, 170)}
POINTS |= {"4": (640, -20), "5": (760, 190)}
REACH = 340.0
WRONG = {"r 2-3": 12 * MGON, "s 3-5": -25 * MM}

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the redundancy numbers")
options = parser.parse_args()

plan = fga.Network("traverse")
for name, (east, north) in POINTS.items():
    plan.add_point(name, (east, north, 0.0), fixed="xyz" if name in "AB" else "z")
for number, station in enumerate(POINTS):
    plan.set_orientation(station, value=0.5 + number)
    for target in (p for p in POINTS if p != station):
        length = np.hypot(*np.subtract(POINTS[target], POINTS[station]))
        if length < REACH:
            sight = f"{station}-{target}"
            plan.add(Direction(station, target, 0.0, sigma=1 * MGON, id=f"r {sight}"))
            if station < target:
                plan.add(HorizontalDistance(station, target, 0.0, sigma=SIGMA, id=f"s {sight}"))
network = disturb(measure(plan, seed=8), seed=8, points=0.5)

solution = fga.adjust(network)
rel = fga.reliability(solution)
print(f"{solution.n_observations} observations, redundancy {solution.redundancy}")
print(
    f"tests at {100 * rel.alpha:g} % with a power of {100 * rel.power:g} %, δ0 {rel.delta0:.2f}\n"
)
print("id         r    smallest detectable error   moves a point by   δ̄")
for row in np.argsort(-rel.delta_bar)[:8].tolist():
    o = solution.observations[row]
    size, unit = UNITS[o.kind]
    print(
        f"{o.id:7}{rel.redundancy_numbers[row]:6.2f}{rel.mdb[row] / size:14.1f} {unit:4}"
        f"{rel.largest_effect[row] / MM:22.1f} mm{rel.delta_bar[row]:11.1f}"
    )

spoiled = network.copy()
for ident, by in WRONG.items():
    good = spoiled.observations[ident]
    spoiled.observations[ident] = replace(good, value=good.value + by)
print(f"\nwith two gross errors: σ̂0 {fga.adjust(spoiled).sigma0:.2f}")
found = fga.snoop(spoiled)
for r in found.rejected:
    size, unit = UNITS[r.kind]
    made = f"{WRONG[r.id] / size:+.1f} {unit}" if r.id in WRONG else "none"
    print(
        f"round {r.round}: {r.id:6} w {r.test:6.1f}, error {r.final_error / size:+6.1f} ± "
        f"{r.final_sigma / size:.1f} {unit} (made: {made})"
    )
print(f"without them: σ̂0 {found.solution.sigma0:.2f}; {found.reason}")
moved = max(np.linalg.norm(found.solution.point(p) - solution.point(p)) for p in POINTS)
print(f"no point is further than {moved / MM:.1f} mm from where it was without gross errors")

if options.plot:
    from factorgraph_adj.report.plots import plot_redundancy

    plot_redundancy(rel).savefig(options.plot, dpi=150)
    print(f"{options.plot}: redundancy numbers by kind")
