"""A model of COLMAP with fisheye cameras
======================================

Two fisheye cameras of 200° look to opposite sides from one pole, as in a 360° camera, and are
carried through a hall. The sparse model is written as COLMAP writes it, in its own system and
without any standard deviation; then it is read with five control points, adjusted, and written
again for dense matching. The measurements are simulated with σ = 0.5 px.
"""

import tempfile
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.ray_lens import FisheyeLens
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.rotation import TURN_ABOUT_X, exp_rotation
from factorgraph_adj.simulation.measurement import measure

rng, folder = np.random.default_rng(7), Path(tempfile.mkdtemp())
HALL, CORNER = np.array([24.0, 14.0, 6.0]), np.array([2500.0, 4800.0, 310.0])
LENS = {"c": 610.0, "x0": 960.0, "y0": -960.0, "k1": 0.03, "k2": -0.01}
PIXELS = {"unit": "px", "format": (1920, 1920), "origin": "upper left", "y_down_in_files": True}
MOUNT = {"rx": 0.0, "ry": np.pi, "rz": 0.01, "x": 0.0, "y": 0.0, "z": 0.03}

# %%
# The hall: points on walls, floor and ceiling, and the two cameras at twelve places.
plan = fga.Network("hall", datum="free")
for i in range(150):
    at = rng.uniform(0.0, 1.0, 3)
    at[i % 3] = i // 3 % 2
    plan.add_point(str(i), CORNER + HALL * at)
for camera in "12":
    plan.add_camera(camera, FisheyeLens(), LENS, free=("c", "k1", "k2"), **PIXELS)
plan.set_mount("back", free=tuple(MOUNT), values=MOUNT)
b = TURN_ABOUT_X @ exp_rotation(np.array([[MOUNT[r] for r in ("rx", "ry", "rz")]]))[0]
arm = TURN_ABOUT_X @ [MOUNT[x] for x in "xyz"]
for i in range(12):
    inside = (2.0 + 1.8 * i, 7.0 + 3.0 * np.sin(0.7 * i), 1.7 + 0.3 * (i % 2))
    at = CORNER + inside
    r = exp_rotation(np.array([[0.1, -0.2, 0.4 * i]]))[0] @ exp_rotation(np.array([[1.6, 0, 0]]))[0]
    front, back = f"front/{i:02}.jpg", f"back/{i:02}.jpg"
    plan.add_photo(front, "1", position=at, rotation=r)
    pose = {"position": at + r @ arm, "rotation": r @ b @ TURN_ABOUT_X}
    plan.add_photo(back, "2", **pose, carrier=front, mount="back")
behind = 0
for name, photo in plan.photos.items():
    for point in plan.points.values():
        ray = photo.rotation.T @ (np.array(point.coordinates) - photo.position)
        if np.linalg.norm(ray) < 12.0 and ray[2] > np.cos(np.radians(100)) * np.linalg.norm(ray):
            behind += ray[2] < 0
            plan.add(ImagePoint(name, point.name, 0.0, 0.0, sigma=0.5))
measured = measure(plan, seed=1)
print(f"{measured.n_image_points} image points, {behind} of them at more than 90° to the axis")

# %%
# COLMAP's files, and the control points in a table: names that are numbers of 3-D points.
fga.write_colmap(measured, folder / "sparse", shift=CORNER)
rows = "name,x,y,z,sigma_mm"
for name in ("0", "13", "58", "91", "143"):
    x, y, z = plan.points[name].coordinates + rng.normal(0.0, 0.003, 3)
    rows += f"\n{name},{x:.4f},{y:.4f},{z:.4f},3"
(folder / "control.csv").write_text(rows)
network = fga.read_colmap(folder / "sparse", sigma=0.5, control=folder / "control.csv")
solution = fga.adjust(network)
print(f"n {solution.n_observations}, u {solution.n_unknowns}, σ̂0 {solution.sigma0:.3f}")

# %%
# The standard deviations, and the errors against the truth, in mm; the adjusted model.
sigmas = np.array([1e3 * solution.standard_deviations(p) for p in plan.points])
off = np.array([1e3 * (solution.point(p) - plan.points[p].coordinates) for p in plan.points])
rms = np.sqrt(np.mean((off / sigmas) ** 2))
print(f"points: median σ {np.median(sigmas):.2f} mm, rms of off/σ {rms:.2f}")
mount = solution.unknown("mount", "rig 1 camera 2")
for i, name in enumerate("xyz", start=3):
    value, sigma = 1e3 * mount.values[i], 1e3 * mount.sigmas[i]
    print(f"arm {name}: {value:.2f} ± {sigma:.2f} mm (true: {1e3 * MOUNT[name]:.0f})")
fga.write_colmap(solution, folder / "adjusted", shift=CORNER)  # for dense matching
