"""Flights in UTM: the grid is no Cartesian system
===============================================

Photos with GNSS have their control and their projection centres in UTM, with heights above a geoid,
as they are delivered. A kilometre of the ground is 0.4 m shorter in the grid on the central
meridian, and 0.7 m longer 300 km away, while heights stay as they are. Adjusted as if the grid were
Cartesian, the camera absorbs the difference: its principal distance is wrong by up to 40 standard
deviations, and by another amount in every place. In a topocentric frame nothing needs a correction,
and results return in the grid with their covariances.
"""

import argparse
from itertools import product

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import measure

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the principal distances")
options = parser.parse_args()

system = fga.ReferenceSystem("EPSG:25832", geoid=47.3)
rng = np.random.default_rng(3)
results = []
for easting in (500e3, 400e3, 320e3, 250e3, 200e3):
    # The truth: 5 × 5 photos, 1500 m above the ground.
    plan = product(np.linspace(-1800, 1800, 13), np.linspace(-1800, 1800, 13))
    grid = np.array([(easting + e, 5400e3 + n, 350 + rng.uniform(-60, 60)) for e, n in plan])
    frame = system.frame_at(grid)
    points = system.to_frame(frame, grid)
    truth = fga.Network("truth", frame=frame)
    truth.add_camera("camera", NoDistortion(), {"c": 100.0})
    truth.add_points([f"{i}" for i in range(len(grid))], points)
    for at in product(np.linspace(-1500, 1500, 5), np.linspace(-1500, 1500, 5), [1500.0]):
        name, rotation = f"{at[0]:.0f} {at[1]:.0f}", world_R_camera(*rng.normal(0, 0.02, 2), 1.6)
        truth.add_photo(name, "camera", position=at, rotation=rotation)
        q = (points - at) @ rotation
        xy = 100.0 * q[:, :2] / q[:, 2:] * (1, -1)
        seen = np.flatnonzero(np.abs(xy).max(axis=1) < 65.0)
        truth.add_image_points(name, [f"{n}" for n in seen], xy[seen], sigma=0.002)

    # Delivered in the grid: control in the corners and in the middle, GNSS, images.
    flight = fga.Network("flight in UTM")
    flight.add_camera("camera", NoDistortion(), {"c": 100.0}, free=["c"])
    for i, at in enumerate(grid):
        control = {"coordinates": at + 0.02 * rng.normal(size=3), "sigma": 0.02}
        flight.add_point(f"{i}", **(control if i in (0, 12, 84, 156, 168) else {}))
    centres = system.from_frame(frame, np.array([p.position for p in truth.photos.values()]))
    centres += 0.05 * rng.normal(size=centres.shape)
    for name, at in zip(truth.photos, centres, strict=True):
        flight.add_photo(name, "camera", position=at, omega_phi_kappa=(0, 0, 1.6))
        flight.add(fga.PhotoPosition(name, tuple(at), sigma=(0.05,) * 3))
    flight.images = measure(truth, seed=7).images

    wrong, right = fga.adjust(flight), fga.adjust(fga.from_grid(flight, system))
    found = fga.grid_coordinates(right)
    c = [s.calibration("camera") for s in (wrong, right)]
    ratio = np.sqrt(np.mean(((found.coordinates - grid) / found.places.sigma) ** 2))
    results.append((1e6 * (found.places.scale.mean() - 1), *(e.values[0] - 100 for e in c)))
    print(f"E {easting / 1e3:.0f} km, scale {results[-1][0]:+.0f} ppm:", end=" ")
    print("c", *(f"{e.values[0]:.4f} ± {e.sigmas[0]:.4f}" for e in c), end=", ")
    print(f"error / σ of E, N, H {ratio:.2f}")

if options.plot:
    import matplotlib.pyplot as plt

    ppm, *errors = np.array(results).T
    figure, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    for label, e in zip(("the grid taken for Cartesian", "topocentric"), errors, strict=True):
        ax.errorbar(ppm, 1e3 * e, 1e3 * c[1].sigmas[0], fmt="o", label=label)
    ax.set(xlabel="scale of the grid − 1 [ppm]", ylabel="error of the principal distance [µm]")
    ax.legend()
    figure.savefig(options.plot, dpi=150)
