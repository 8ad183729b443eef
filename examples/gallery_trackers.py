"""Laser trackers in one network
=============================

Four laser trackers around a machine sight the same targets. No target is known, no
tracker is levelled: each has its own frame with six unknowns, and the datum is that of inner
constraints over the targets. In industry this is a unified spatial metrology network.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import FrameDirection, FrameDistance, FrameZenith
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.units import ARCSEC

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--plot", help="file of the picture")
options, _ = parser.parse_known_args()

MM = 1e-3
ANGLE = fga.StandardDeviation(constant=1.0 * ARCSEC, centring_target=0.01 * MM)
DISTANCE = fga.StandardDeviation(constant=0.01 * MM, ppm=0.4)

rng = np.random.default_rng(3)
plan = fga.Network("four trackers", datum="free")
for i in range(40):
    angle, height = 2.4 * i, 0.07 * i
    plan.add_point(f"P{i}", (2.2 * np.cos(angle), 2.2 * np.sin(angle), height))
for k in range(4):
    at = 6.0 * np.array([np.cos(1.6 * k), np.sin(1.6 * k), 0.25])
    turns = dict(zip(("rx", "ry", "rz"), rng.uniform(-0.2, 0.2, 3).tolist(), strict=True))
    values = {**turns, "rz": float(rng.uniform(-3, 3)), "x": 0.0, "y": 0.0, "z": 0.0}
    plan.add_frame(f"T{k}", values=values, origin=at.tolist())
    for i in range(40):
        if (i + k) % 4:  # some targets are hidden
            plan.add(
                FrameDirection(f"T{k}", f"P{i}", 0.0, sigma=ANGLE),
                FrameZenith(f"T{k}", f"P{i}", 1.0, sigma=ANGLE),
                FrameDistance(f"T{k}", f"P{i}", 1.0, sigma=DISTANCE),
            )

# %%
# The measurements are simulated. Tracker T2 is worse than its specification: its directions have
# three times the standard deviation that is stated. Only the readings are kept.
true = plan.copy()
for ident, o in plan.observations.items():
    if (o.frame, o.kind) == ("T2", "frame_direction"):
        true.observations[ident] = replace(o, sigma=ANGLE.scaled(3.0))
network = measure(true, seed=5)
for ident, o in network.observations.items():
    network.observations[ident] = replace(o, sigma=plan.observations[ident].sigma)
network.points = {name: fga.Point(name, (np.nan,) * 3) for name in network.points}
for name in list(network.frames):
    origin = network.frames.pop(name).constants[:3]
    network.add_frame(name, origin=origin)

solution = fga.adjust(network)
print(f"n {solution.n_observations}, u {solution.n_unknowns}, defects {solution.datum_defect}")
print(f"σ̂0 with the stated specifications: {solution.sigma0:.2f}")

# %%
# Each instrument gets its own factors for directions, zenith angles and distances.
found = fga.estimate_variance_components(network, groups="frame")
for component in found.components:
    if component.name.startswith("frame_direction"):
        print(f"{component.name}: σ × {component.factor:.2f} ± {component.sigma:.2f}")
print(f"σ̂0 with these: {found.solution.sigma0:.2f}")
sigmas = np.sqrt(np.einsum("pii->pi", found.solution.point_covariances))
print(f"targets: {1e6 * np.median(sigmas):.0f} µm (median of σx, σy, σz)")

if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(found.solution).savefig(options.plot, dpi=150)
    print(f"{options.plot}: the network with its ellipses of 95 %")
