"""The industry block
==================

Photos, taped distances and levelling are adjusted together, with self-calibration. The industry
block of El-Hakim & Faig (1981), simulated: 70 points in 15 × 15 m, 7 photos, 150 distances and all
heights with σ 0.5 mm.
"""

import numpy as np

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block

simulated = simulate_industry_block(seed=2)
solution = fga.adjust(simulated.network)
print(simulated.network)
print(f"{solution.iterations} iterations, {solution.reason}")
print(f"σ̂0 {solution.sigma0:.3f}, redundancy {solution.redundancy}")

camera = solution.calibration("P31")
for name in ("c", "x0", "y0"):
    print(f"{name} {camera[name]:.4f} ± {camera.sigma(name):.4f} mm")

x, y, z = solution.point("P35")
sx, sy, sz = 1000 * solution.standard_deviations("P35")
print(f"P35 {x:.4f} {y:.4f} {z:.4f} m ± {sx:.2f} {sy:.2f} {sz:.2f} mm")

# %%
# The same photos without tape and level.
photos_alone = fga.adjust(simulate_industry_block(seed=2, terrestrial=False).network)
for what, result in (("combined", solution), ("photos alone", photos_alone)):
    sigma = np.mean([result.standard_deviations(p) for p in result.network.points])
    errors = [result.point(p) - true for p, true in simulated.truth.points.items()]
    rms = np.sqrt(np.mean(np.square(errors)))
    print(f"{what}: mean σ {1000 * sigma:.2f} mm, RMS error {1000 * rms:.2f} mm")
