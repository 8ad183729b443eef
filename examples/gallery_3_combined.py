"""Total station, level and photos in one adjustment
=================================================

What does each instrument add? The industry block of El-Hakim & Faig (1981), simulated: 70 points on
a floor of 15 × 15 m, those at the corners known. The same readings are adjusted three times, with
more of them each time.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import CAMERA, CORNERS, industry_block_plan
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import Truth, disturb, measure
from factorgraph_adj.units import GON

MM = 1e-3
SIGHTS = {Direction: 3e-3 * GON, ZenithAngle: 3e-3 * GON, SlopeDistance: 1 * MM}
STATIONS, CASES = ("P12", "P36"), ("total station", "and level", "and photos")

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the combined network")
options = parser.parse_args()


def planned(case: str) -> fga.Network:
    """Return the plan of a case with true values."""
    plan = industry_block_plan()
    for corner in CORNERS:
        plan.points[corner] = replace(plan.points[corner], fixed=(True, True, True))
    levelled = [o for o in plan.observations.values() if isinstance(o, HeightDifference)]
    plan.observations = {}
    for number, station in enumerate(STATIONS):
        plan.set_orientation(station, value=1.0 + number)
        for target in (p for p in plan.points if p != station):
            plan.add(*(kind(station, target, 0.0, sigma=s) for kind, s in SIGHTS.items()))
    if case != CASES[0]:
        plan.add(*levelled)
    if case != CASES[2]:
        plan.image_mask(np.zeros(plan.n_image_points, dtype=bool))
        plan.photos, plan.cameras = {}, {}
    return plan


print("readings        scalars  redundancy     σ̂0   mean σ of x, y, z, mm     RMS error, mm")
for case in CASES:
    plan = planned(case)
    network = disturb(measure(plan, seed=5), seed=5, points=0.1, centres=0.3, attitudes=0.02)
    solution = fga.adjust(network)
    truth = Truth.of(plan).points
    sigma = np.mean([solution.standard_deviations(p) for p in truth], axis=0) / MM
    errors = np.array([solution.point(p) - xyz for p, xyz in truth.items()]) / MM
    rms = np.sqrt(np.mean(errors**2, axis=0))
    print(
        f"{case:16}{solution.n_observations:7}{solution.redundancy:12}{solution.sigma0:7.3f}  "
        + "".join(f"{s:8.2f}" for s in sigma)
        + "  "
        + "".join(f"{e:7.2f}" for e in rms)
    )

table, rel = solution.observations, fga.reliability(solution)
print("\nin the last one          scalars   mean r     RMS of v/σ")
for kind in dict.fromkeys(table.kinds):
    rows = np.array(table.kinds) == kind
    r, v = rel.redundancy_numbers[rows], table.normalised[rows]
    print(f"{kind:22}{rows.sum():10}{r.mean():9.2f}{np.sqrt(np.mean(v**2)):13.2f}")
camera = solution.calibration(CAMERA)
for name in ("c", "x0", "y0"):
    error = camera[name] - Truth.of(plan).calibration(CAMERA, name)
    print(f"camera {name:3}{camera[name]:10.4f} ± {camera.sigma(name):.4f} mm, off {error:+.4f} mm")

if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(solution).savefig(options.plot, dpi=150)
    print(f"{options.plot}: the combined network with its ellipses of 95 %")
