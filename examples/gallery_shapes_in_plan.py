"""Scanners and shapes in plan
===========================

Three scanners that are not levelled sight points of a tank, a ball and the
floor of a plant. The places of the scanners and the place, direction and size of the shapes are
unknown. The plan shows the scanners with their sights, the adjusted shapes, and all error ellipses.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.units import ARCSEC

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--plot", help="file of the picture")
options, _ = parser.parse_known_args()

MM = 1e-3
rng = np.random.default_rng(4)

# %%
# The true plant: a tank of 1.5 m radius that leans, a ball of 1 m, the floor, four known marks.
plant = fga.Network("plant")
for i, at in enumerate([(0.0, 0.0, 2.0), (14.0, 0.0, 1.0), (14.0, 9.0, 2.5), (0.0, 9.0, 1.5)]):
    plant.add_point(f"M{i}", at, fixed="xyz")
lean = {"rx": 0.01, "ry": 0.02}
plant.add_shape("tank", "cylinder", origin=(4.0, 4.5, 0.0), values={**lean, "x": 0.0, "y": 0.0})
plant.add_shape("ball", "sphere", origin=(10.0, 5.5, 1.0), values={"x": 0.0, "y": 0.0, "z": 0.0})
plant.add_shape("floor", "plane", origin=(7.0, 4.5, 0.0), values={"rx": 0.0, "ry": 0.0, "z": 0.0})
plant.set_size("tank", 1.5)
plant.set_size("ball", 1.0)
for i in range(14):
    turn, up = 2.4 * i, 0.3 + 0.2 * i
    wall = (4.0 + 0.02 * up + 1.5 * np.cos(turn), 4.5 - 0.01 * up + 1.5 * np.sin(turn), up)
    side = np.sqrt(1.0 - (0.1 * i - 0.6) ** 2)
    ball = (10.0 + side * np.cos(turn), 5.5 + side * np.sin(turn), 0.4 + 0.1 * i)
    floor = (*rng.uniform((1.0, 0.5), (13.0, 8.5)), 0.0)
    for name, at in ((f"W{i}", wall), (f"B{i}", ball), (f"F{i}", floor)):
        plant.add_point(name, at)
    plant.add(
        o.OnCylinder("tank", f"W{i}", sigma=1 * MM),
        o.OnSphere("ball", f"B{i}", sigma=1 * MM),
        o.OnPlane("floor", f"F{i}", sigma=1 * MM),
    )

# %%
# The scanners, and what they read: directions, zenith angles and distances with their errors.
stands = {"scan 1": (1.0, 2.0, 1.6), "scan 2": (7.0, 8.0, 1.7), "scan 3": (12.5, 2.0, 1.5)}
for number, (scan, at) in enumerate(stands.items()):
    turns = dict(zip(("rx", "ry", "rz"), (0.05, -0.03, 1.2 * number), strict=True))
    plant.add_frame(scan, values={**turns, "x": 0.0, "y": 0.0, "z": 0.0}, origin=at)
    for point in list(plant.points):
        plant.add(
            o.FrameDirection(scan, point, 0.0, sigma=10 * ARCSEC),
            o.FrameZenith(scan, point, 1.0, sigma=10 * ARCSEC),
            o.FrameDistance(scan, point, 1.0, sigma=2 * MM),
        )
solution = fga.adjust(measure(plant, seed=2))
print(f"n {solution.n_observations}, u {solution.n_unknowns}, σ̂0 {solution.sigma0:.2f}")
for name in ("tank", "ball"):
    size = solution.unknown("size", name)
    print(f"radius of the {name}: {size.values[0]:.4f} ± {size.sigmas[0]:.4f} m")

if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(solution).savefig(options.plot, dpi=150)
    print(f"{options.plot}: the plan with scanners, shapes and ellipses of 95 %")
