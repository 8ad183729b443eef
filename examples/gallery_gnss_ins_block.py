"""A photo flight with GNSS and an inertial platform
=================================================

Three strips are flown in alternating directions, with the position of the antenna and with roll,
pitch and heading at every exposure. The boresight, and a shift and drift of the positions of each
strip are unknown. The flight is simulated; the adjustment recovers the simulated errors.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.report.plots import plot_network
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import measure

(parser := argparse.ArgumentParser()).add_argument("--plot", help="file of the picture")
options, _ = parser.parse_known_args()
STRIPS, EXPOSURES, ARM = 3, 8, (0.35, -0.22, 1.1)
FREE, TURNS = ("x", "y", "z", "x_t", "y_t", "z_t"), {"rx": 0.002, "ry": -0.0014, "rz": 0.0044}
rng = np.random.default_rng(11)

# %%
# The flight with true values, which are those of a plan; readings are drawn later.
frame = fga.TopocentricFrame(np.radians(43.6), np.radians(4.5), 50.0)
plan = fga.Network("flight", frame=frame)
plan.add_camera("camera", NoDistortion(), {"c": 100.0})
plan.set_mount("imu", free=TURNS, values=TURNS)
east, north = np.arange(0.0, 3300.0, 225.0), np.arange(-500.0, 2300.0, 250.0)
ground = np.array([(x, y, rng.normal(0, 40)) for x in east for y in north])
for i, at in enumerate(ground):
    plan.add_point(f"{i}", at)
for i in (0, 11, 84, 90, 168, 179):
    plan.add(fga.ControlPoint(f"{i}", tuple(ground[i]), sigma=(0.02,) * 3, id=f"control {i}"))
for photo in [f"{s}-{i}" for s in range(STRIPS) for i in range(EXPOSURES)]:
    strip, time = int(photo[0]), int(photo[2]) - (EXPOSURES - 1) / 2
    at = np.array((1575.0 + 450.0 * (-time if strip % 2 else time), 800.0 * strip, 1500.0))
    rotation = world_R_camera(*rng.normal(0, 0.02, 2), np.pi * (strip % 2) - np.pi / 2)
    plan.add_photo(photo, "camera", position=at, rotation=rotation)
    if f"strip {strip}" not in plan.drifts:
        drawn = dict(zip(FREE, rng.normal(0.0, [0.2] * 3 + [0.01] * 3), strict=True))
        plan.set_drift(f"strip {strip}", free=FREE, values=drawn)
    zero, sigma = (0.0, 0.0, 0.0), tuple(np.radians((0.005, 0.005, 0.01)))
    own = {"drift": f"strip {strip}", "time": time, "lever_arm": ARM, "id": f"GNSS {photo}"}
    plan.add(fga.PhotoPosition(photo, zero, sigma=(0.05,) * 3, **own))
    plan.add(fga.NavigationAttitude(photo, zero, sigma=sigma, mount="imu", id=f"INS {photo}"))
    x, y, z = rotation.T @ (ground - at).T
    seen = np.flatnonzero(np.maximum(np.abs(x), np.abs(y)) < 0.6 * z)
    xy = 100.0 * np.stack([x / z, -y / z], axis=1)[seen]
    plan.add_image_points(photo, [f"{n}" for n in seen], xy, sigma=0.003)

# %%
# Unknowns start at zero. A position has a gross error of 0.4 m in height, and is found.
flight = measure(plan, seed=7)
flight.set_mount("imu", free=TURNS)
for name in plan.drifts:
    flight.set_drift(name, free=FREE)
wrong = flight.observations["GNSS 1-4"]
flight.observations["GNSS 1-4"] = wrong.with_reading(np.add(wrong.value, (0, 0, 0.4)), frame)
found = fga.snoop(flight)
print("rejected:", ", ".join(r.id for r in found.rejected))
imu = found.solution.unknown("mount", "imu")
for name, true, value, sigma in zip(TURNS, TURNS.values(), imu.values, imu.sigmas, strict=False):
    print(f"{name} {1e6 * value:7.0f} ± {1e6 * sigma:2.0f} µrad, true {1e6 * true:5.0f}")
pairs = [(found.solution.unknown("drift", n), p) for n, p in plan.drifts.items()]
w = np.array([(d.values - p.values)[:6] / d.sigmas[:6] for d, p in pairs])
print(f"{w.size} shifts and drifts: largest error {np.abs(w).max():.2f} σ, rms {w.std():.2f} σ")

if options.plot:
    plot_network(found.solution).savefig(options.plot, dpi=150)

# %%
# Without control, the shifts absorb the datum.
try:
    fga.adjust(fga.without(flight, [i for i in flight.observations if i.startswith("control")]))
except fga.DatumError as refused:
    print(f"without control: {refused}")
