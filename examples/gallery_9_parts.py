"""A network in parts
==================

Three offices measure neighbouring parts of one network. Each keeps its own observations, and none
sends them to the others: every part is eliminated by itself and gives the normal equations of its
junctions.
"""

from functools import partial

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import GnssVector

SIDE, SPACING = 9, 1000.0
SIGMA = (0.004, 0.004, 0.008)


def office(number):
    """Return the three columns of stations of an office, with the vectors that begin there."""
    network = fga.Network(f"office {number + 1}")
    rng = np.random.default_rng(number)
    for i in range(3 * number, min(3 * number + 4, SIDE)):
        for j in range(SIDE):
            held = (i, j) in ((0, 0), (SIDE - 1, SIDE - 1))
            at = (SPACING * i, SPACING * j, 10.0 * np.sin(i + 2 * j))
            network.add_point(f"{i}-{j}", at, fixed="xyz" if held else "")
    for i in range(3 * number, 3 * number + 3):
        for j in range(SIDE):
            for a, b in ((i + 1, j), (i, j + 1)):
                if max(a, b) < SIDE and f"{a}-{b}" in network.points:
                    way = np.subtract(
                        network.points[f"{a}-{b}"].coordinates,
                        network.points[f"{i}-{j}"].coordinates,
                    )
                    value = tuple(way + rng.normal(0.0, SIGMA))
                    network.add(GnssVector(f"{i}-{j}", f"{a}-{b}", value, sigma=SIGMA))
    return network


parts = [fga.Part(f"office {k + 1}", partial(office, k)) for k in range(3)]
together = fga.adjust_parts(parts, name="three offices")
print(together)
print(f"junctions: {together.junctions.by_kind()['point']} points")
print(f"redundancy {together.redundancy}, sum {together.sum_of_redundancy_numbers:.6f}")

# %%
# The middle office alone has no bench mark. In the whole network its stations have these
# standard deviations; its redundancy numbers show what the other parts control.
middle = together.part("office 2")
sigmas = np.sqrt(np.einsum("nii->ni", middle.covariances["point"]))
names = middle.equations.unknowns["point"].names
east, north, up = 1e3 * sigmas[names.index("4-4")]
print(f"station 4-4: {east:.2f} {north:.2f} {up:.2f} mm")
print(f"Σr of office 2: {middle.redundancy_numbers.sum():.2f} of {len(middle.w)} observations")
