"""Write the project `examples/industry_block`: measured values as in a field book.

python -m examples.make_industry_block [FOLDER]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.rotation import omega_phi_kappa
from factorgraph_adj.units import GON

CENTIMETRE, HUNDREDTH_MM, TENTH_UM_IN_MM = 2, 5, 4
"""Decimals of approximate coordinates and lengths in metres, image coordinates in mm."""
CHECK_POINTS = ("P14", "P27", "P36", "P45", "P58")

simulated = simulate_industry_block(seed=2)
given = simulated.network
book = fga.Network("Industry block, simulated after El-Hakim & Faig 1981")
for name, point in given.points.items():
    axes = "".join(axis for axis, held in zip("xyz", point.fixed, strict=True) if held)
    true = np.round(simulated.truth.points[name], HUNDREDTH_MM)
    rounded = np.where(
        point.fixed, point.coordinates, np.round(point.coordinates, CENTIMETRE) + 0.0
    )
    check = true.tolist() if name in CHECK_POINTS else None
    book.add_point(name, rounded.tolist(), fixed=axes, check=check)
for name, camera in given.cameras.items():
    values = [float(f"{v:.4g}" if abs(v) < 1 else f"{v:.4f}") for v in camera.values]
    sigma = {n: s for n, s in zip(camera.lens.names, camera.sigma, strict=True) if np.isfinite(s)}
    book.add_camera(name, camera.lens, values, sigma=sigma, format=camera.format)
for name, photo in given.photos.items():
    angles = GON * np.round(np.array(omega_phi_kappa(photo.rotation)) / GON)
    position = np.round(photo.position, CENTIMETRE).tolist()
    book.add_photo(name, photo.camera, position=position, omega_phi_kappa=angles.tolist())
for observation in given.observations.values():
    book.add(replace(observation, value=round(observation.value, HUNDREDTH_MM)))
for image_point in given.image_points():
    x, y = round(image_point.x, TENTH_UM_IN_MM), round(image_point.y, TENTH_UM_IN_MM)
    book.add(replace(image_point, x=x, y=y))

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "industry_block"
fga.write_project(book, folder / "project.toml")
print(f"{folder / 'project.toml'}: {book}")
