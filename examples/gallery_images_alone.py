"""A block from images alone
=========================

Fourteen photos of an object without poses or control points, with an approximate principal
distance, one scale bar, and image points of which one in twenty belongs to another point. The
start finds the block and names the mismatches; the picture shows the adjusted photos and points.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--plot", help="file of the picture")
options, _ = parser.parse_known_args()

rng = np.random.default_rng(5)
HALF = np.array([18.0, 12.0])

# %%
# The object, and cameras that look at it from all sides: principal distance 28 mm, some distortion.
points = rng.uniform(-1, 1, (120, 3)) * [1.0, 0.8, 0.6]
bar = np.array([[-0.5, -0.9, 0.0], [0.5, -0.9, 0.0]])
points[:2] = bar
network = fga.Network("object", datum="free")
network.add_camera(
    "camera", BrownLens(), {"c": 40.0}, free=("c", "x0", "y0", "k1"), format=tuple(2 * HALF)
)
for i in range(len(points)):
    network.add_point(f"P{i}")
mixed = set()
for f in range(14):
    turn = 2 * np.pi * f / 14
    centre = np.array([4 * np.cos(turn), 4 * np.sin(turn), 0.5 + (f % 3)])
    forward = -centre / np.linalg.norm(centre)
    aside = np.cross(forward, [0, 0, 1.0])
    aside /= np.linalg.norm(aside)
    p = (points - centre) @ np.stack([aside, np.cross(forward, aside), forward], 1)
    ideal = 28.0 * np.stack([p[:, 0] / p[:, 2], -p[:, 1] / p[:, 2]], 1)
    xy = ideal * (1 - 4e-5 * (ideal**2).sum(axis=1, keepdims=True))
    xy += rng.normal(0, 0.003, xy.shape)
    wrong = rng.random(len(points)) < 0.05
    xy[wrong] = rng.uniform(-HALF, HALF, (wrong.sum(), 2))
    network.add_photo(f"F{f}", "camera")
    seen = np.flatnonzero((np.abs(xy) < HALF).all(axis=1))
    network.add_image_points(f"F{f}", [f"P{i}" for i in seen], xy[seen], sigma=0.003)
    mixed |= {f"F{f}/P{i}" for i in seen[wrong[seen]]}
network.add(fga.SlopeDistance("P0", "P1", 1.0, sigma=0.0001, id="bar"))

# %%
# The start: the guess of 40 mm does not fit, and 28 mm is found.
found = fga.orient(network)
print(*found.sentences(most=3), sep="\n")
named = mixed & set(found.doubtful)
print(f"mismatches: {len(mixed)}, named: {len(named)}, others: {len(found.doubtful) - len(named)}")

# %%
# The adjustment without them, and a test of every remaining image point.
clean = fga.snoop(found.without_doubtful(), start=found.start, variance="a-posteriori")
solution = clean.solution
calibration = solution.calibration("camera")
print(f"σ̂0 {solution.sigma0:.2f}, rejected {len(clean.rejected)}")
print(f"principal distance {calibration['c']:.3f} ± {calibration.sigma('c'):.3f} mm (true: 28)")

if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(solution).savefig(options.plot, dpi=150)
    print(f"{options.plot}: photos and points as they were found from the images")
