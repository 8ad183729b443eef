"""A tank and its floor
====================

A total station at two places in an oil tank reads targets on the wall, a cylinder, and
on the floor, a plane. Their axes are compared, and the deviations of the wall, which has a bulge,
are drawn unrolled. Data snooping finds a point of the floor that lies on a stone.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.units import GON

RADIUS, FORM, MGON = 12.0, 0.003, 1e-3 * GON
LEAN = exp_rotation(np.array([[0.002, -0.001, 0.0]]))[0]  # the tank leans by 2.2 mm/m
STATIONS = {"S1": (-4.0, -2.0, 1.6), "S2": (5.0, 3.0, 1.6)}

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the deviations of the wall, unrolled")
options, rng = parser.parse_args(), np.random.default_rng(2)
turn, up = (a.ravel() for a in np.meshgrid(np.linspace(0, 2 * np.pi, 25)[:-1], (1, 3, 5, 7, 9)))
bulge = 0.012 * np.exp(-(((turn - 2.0) / 0.35) ** 2) - ((up - 5.0) / 2.0) ** 2)
out = RADIUS + bulge + 0.001 * rng.normal(size=len(turn))
wall = np.column_stack([out * np.cos(turn), out * np.sin(turn), up]) @ LEAN.T
floor = np.column_stack([rng.uniform(-8, 8, (20, 2)), 0.001 * rng.normal(size=20)])
floor[7, 2] += 0.025  # a stone

network = fga.Network("tank")
for name, xyz in STATIONS.items():
    network.add_point(name, xyz, fixed="xyz")
network.add_shape("wall", "cylinder", origin=(0.0, 0.0, 4.0))
network.add_shape("floor", "plane", origin=(0.0, 0.0, 0.0))
for shape, kind, points in (("wall", o.OnCylinder, wall), ("floor", o.OnPlane, floor)):
    for i, at in enumerate(points):
        name = f"{shape[0].upper()}{i}"
        network.add_point(name)
        network.add(kind(shape, name, sigma=FORM))
        for station, stand in STATIONS.items():
            d = at - stand
            length = np.linalg.norm(d)
            azimuth = (np.arctan2(d[0], d[1]) + MGON * rng.normal()) % (2 * np.pi)
            zenith = np.arccos(d[2] / length) + MGON * rng.normal()
            network.add(
                o.Azimuth(station, name, azimuth, sigma=MGON),
                o.ZenithAngle(station, name, zenith, sigma=MGON),
                o.SlopeDistance(station, name, length + 1e-3 * rng.normal(), sigma=1e-3),
            )

found = fga.snoop(network)
for r in found.rejected:
    if r.kind == "on_plane":
        print(f"rejected: {r.label}, {1e3 * abs(r.final_error):.0f} ± {1e3 * r.final_sigma:.1f} mm")
solution = found.solution
radius = solution.unknown("size", "wall")
print(f"radius {radius.values[0]:.4f} ± {radius.sigmas[0]:.4f} m (true: {RADIUS})")
frames = solution.equations.unknowns["frame"].number
wall_frame, floor_frame = (solution.state["frame"][frames[n]] for n in ("wall", "floor"))
lean = 1e3 * np.arccos(abs(wall_frame[2:9:3] @ floor_frame[2:9:3]))
print(f"the axis of the wall leans by {lean:.2f} mm/m against the floor (true: 2.24)")
q = np.array([solution.point(f"W{i}") for i in range(len(wall))]) - wall_frame[13:16]
q = q @ wall_frame[:9].reshape(3, 3) - wall_frame[9:12]
deviation = 1e3 * (np.hypot(q[:, 0], q[:, 1]) - radius.values[0])
print(f"largest deviation of the wall: {deviation.max():.1f} mm at {up[deviation.argmax()]} m")

if options.plot:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.4), layout="constrained")
    axes = figure.add_subplot(xlabel="along the wall [m]", ylabel="height [m]")
    shown = (a.reshape(5, -1) for a in (RADIUS * turn, up, deviation))
    filled = axes.contourf(*shown, np.arange(-12, 13, 1.5), cmap="RdBu_r", extend="both")
    figure.colorbar(filled, ax=axes, label="outwards [mm]")
    figure.savefig(options.plot, dpi=150)
