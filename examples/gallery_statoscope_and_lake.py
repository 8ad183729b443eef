"""Heights of a block from a statoscope and a lake
===============================================

Two strips cross a valley without height control. At every exposure a statoscope reads the height of
the aircraft above a surface of equal pressure, whose height is unknown in each strip. A lake,
whose level a gauge gives, makes that absolute: its shore lines are points of one height. The crab
angles of the aircraft give the wind, and the wind the slope of the surface of pressure. One reading
is wrong by half a hectopascal; data snooping finds it.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.atmosphere import pressure_height, pressure_slope, standard_pressure
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import measure

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the standard deviations of the heights")
options = parser.parse_args()

# The truth: the values that a plan gives are true ones.
rng = np.random.default_rng(3)
plan = fga.Network("a valley with a lake")
plan.add_camera("RMK", NoDistortion(), {"c": 150.0})
plan.set_level("lake", 412.0, sigma=0.05)
for i, x in enumerate(np.linspace(-100, 3700, 13)):
    for j, y in enumerate(np.linspace(-800, 2600, 9)):
        shore = abs(x - 1800) < 1000 and 400 < y < 1400
        z = 412.0 if shore else 460.0 + 40.0 * np.sin(x / 700) * np.cos(y / 500)
        plan.add_point(f"{i}-{j}", (x, y, z))
        if shore:
            plan.add(fga.LevelHeight(f"{i}-{j}", "lake", sigma=0.1, id=f"shore {i}-{j}"))
for corner in ("0-0", "12-0", "0-8", "12-8"):
    place = plan.points[corner].coordinates[:2]
    plan.add(fga.ControlPoint(corner, place, axes="xy", sigma=(0.1, 0.1)))
# Two strips in opposite directions, 48° north, 40 m/s: the nose is 15° to the left, then right.
for strip, crab in (("1", np.radians(15.0)), ("2", np.radians(-15.0))):
    slope = 1000 * pressure_slope(np.radians(48.0), 40.0 * np.sin(crab))  # metres per kilometre
    known = {"height": 8.0 if strip == "1" else 3.0, "height_t": slope}
    plan.set_profile(strip, free=["height"], values=known, sigma={"height_t": 0.1})
    for k in range(5):
        at = np.array([900 * k, 0, 1950] if strip == "1" else [900 * (4 - k), 1800, 1950])
        at = at + rng.normal(0, 15, 3)
        photo, rotation = f"{strip}{k}", world_R_camera(0.01, -0.01, 0.0 if strip == "1" else np.pi)
        plan.add_photo(photo, "RMK", position=at, rotation=rotation)
        seen = (np.array([p.coordinates for p in plan.points.values()]) - at) @ rotation
        inside = np.all(np.abs(seen[:, :2] / seen[:, 2:]) < 115 / 150, axis=1)
        names = [n for n, there in zip(plan.points, inside, strict=True) if there]
        plan.add_image_points(photo, names, np.zeros((len(names), 2)), sigma=0.006)
        where = {"photo": photo, "profile": strip, "time": 0.9 * (k - 2)}
        plan.add(fga.ProfileHeight(None, 0.0, **where, sigma=0.3, id=f"statoscope {photo}"))

# The measurements; a pressure of the statoscope is wrong.
network = measure(plan, seed=1)
wrong = network.observations["statoscope 22"]
pressure = standard_pressure(wrong.value) - 50.0
network.observations[wrong.id] = replace(wrong, value=float(pressure_height(pressure)))
try:
    fga.adjust(fga.without(network, [i for i in network.observations if "shore" in i]))
except fga.DatumError as error:
    print("without the lake:", str(error).splitlines()[1].strip())
found = fga.snoop(network)
for r in found.rejected:
    print(f"rejected: {r.label}, error {r.estimated_error:.1f} m, w {r.test:.1f}")
for name in network.profiles:
    e = found.solution.unknown("profile", name)
    a, b, *_ = (f"{v:.2f} ± {s:.2f}" for v, s in zip(e.values, e.sigmas, strict=True))
    print(f"strip {name}: surface of pressure at {a} m, slope {b} m/km")
off = [found.solution.point(n)[2] - p.coordinates[2] for n, p in plan.points.items()]
print(f"heights: rms error {np.sqrt(np.mean(np.square(off))):.2f} m in {len(off)} points")
if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(found.solution).savefig(options.plot, dpi=150)
