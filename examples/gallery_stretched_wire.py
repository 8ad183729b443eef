"""A stretched wire
================

Seven sensors along 60 m read where a wire passes, across and in height, and the height of the water
of a tube above them; they are levelled and surveyed too. The first and the last are known; the
others, bearing, slope and sag of the wire and the level of the water are unknown, and data
snooping names a bad reading. The simulated σ are 10 µm for the wire and 5 µm for the water.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.simulation.measurement import measure

LENGTH, SENSORS, UM = 60.0, 7, 1e-6

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw heights of wire, sensors and water")
options = parser.parse_args()

# The frame of the wire has its y axis along the chord. Free are its bearing rz, its slope rx, and
# where it begins, x and z; the sag is a size. A roll of the frame about the wire has no effect on
# its readings: an observed roll of zero fixes it.
tunnel = fga.Network("tunnel")
rng = np.random.default_rng(5)
for i in range(SENSORS):
    at = (0.02 * rng.normal(), LENGTH * i / (SENSORS - 1), 0.01 * rng.normal())
    tunnel.add_point(f"S{i}", at, fixed="xyz" if i in (0, SENSORS - 1) else "y")
slope = {"rx": 0.0005, "ry": 0.0, "rz": -0.001, "x": 0.01, "z": 0.08}
tunnel.add_frame("wire", free=list(slope), values=slope, origin=(0, 0, 0), level=True)
tunnel.add(o.FrameRoll("wire", "S0", 0.0, sigma=1e-4, id="roll"))
tunnel.set_size("sag", 0.012)
tunnel.set_level("tube", 0.15)
for i in range(SENSORS):
    wire = {"id": f"wire {i}", "sag": "sag", "length": LENGTH, "sigma": (10 * UM, 10 * UM)}
    tunnel.add(
        o.WireReading("wire", f"S{i}", (0.0, 0.0), **wire),
        o.HydrostaticReading(f"S{i}", "tube", 0.1, sigma=5 * UM, id=f"water {i}"),
    )
    if 0 < i < SENSORS - 1:
        tunnel.add(o.ControlPoint(f"S{i}", (0.0,), axes="x", sigma=(50 * UM,), id=f"survey {i}"))
for i in range(SENSORS - 1):
    tunnel.add(o.HeightDifference(f"S{i}", f"S{i + 1}", 0.0, sigma=5 * UM, id=f"step {i}"))
day = measure(tunnel, seed=7)

# The wire is read too high at sensor 3, by 0.2 mm.
good = day.observations["wire 3"]
day.observations["wire 3"] = replace(good, value=(good.value[0], good.value[1] + 200 * UM))
found = fga.snoop(day)
print("rejected:", *(r.id for r in found.rejected))
solution = found.solution
print(f"redundancy {solution.redundancy}, σ̂0 {solution.sigma0:.2f}")
sag = solution.unknown("size", "sag")
water = solution.unknown("level", "tube")
print(f"sag   {1e3 * sag.values[0]:8.3f} ± {1e3 * sag.sigmas[0]:.3f} mm")
print(f"water {1e3 * water.values[0]:8.3f} ± {1e3 * water.sigmas[0]:.3f} mm")
for i in range(1, SENSORS - 1):
    x, _, z = solution.point(f"S{i}")
    sx, _, sz = solution.unknown("point", f"S{i}").sigmas
    print(f"S{i}  x {1e3 * x:8.3f} ± {1e3 * sx:.3f} mm   z {1e3 * z:8.3f} ± {1e3 * sz:.3f} mm")

if options.plot:
    from matplotlib.figure import Figure

    axes = (figure := Figure(figsize=(7.0, 3.2), layout="constrained")).subplots()
    y = np.linspace(0, LENGTH, 200)
    wire = solution.unknown("frame", "wire").values
    hanging = wire[5] + y * wire[0] + 4 * sag.values[0] * ((y / LENGTH) ** 2 - y / LENGTH)
    places = np.array([solution.point(f"S{i}") for i in range(SENSORS)])
    axes.plot(y, 1e3 * hanging, label="wire")
    axes.plot(places[:, 1], 1e3 * places[:, 2], "s", label="sensors")
    axes.axhline(1e3 * water.values[0], color="tab:cyan", label="water")
    axes.set(xlabel="along the tunnel [m]", ylabel="height [mm]")
    axes.legend()
    figure.savefig(options.plot)
