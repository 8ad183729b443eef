"""A distance network
==================

Two pillars are known and four points are new. A plane network of distances is adjusted, and the
script prints the usual results: coordinates with their error ellipses, residuals, test
values and smallest detectable errors. The readings are simulated with σ = 2 mm + 2 ppm.
"""

import argparse

import factorgraph_adj as fga
from factorgraph_adj.observations import HorizontalDistance
from factorgraph_adj.units import GON

SIGMA = fga.StandardDeviation(0.002, ppm=2)
KNOWN = {"A": (1000.000, 2000.000), "B": (1412.316, 2055.402)}
ROUGH = {"1": (1105, 2290), "2": (1390, 2310), "3": (1230, 1840), "4": (1260, 2120)}
READINGS = """
A B 416.0216   A 1 308.6442   A 2 498.4920   A 3 280.3378   A 4 286.7026
B 1 386.4478   B 2 255.4433   B 3 282.6395   B 4 165.4061   1 2 285.8161
1 4 229.7968   2 3 497.0253   2 4 229.9657   3 4 282.4764
"""

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the network with its error ellipses")
options = parser.parse_args()

# %%
# The network, with two pillars that are held.
network = fga.Network("six points, distances")
for name, (east, north) in KNOWN.items():
    network.add_point(name, (east, north, 0.0), fixed="xyz")
for name, (east, north) in ROUGH.items():
    network.add_point(name, (east, north, 0.0), fixed="z")
words = READINGS.split()
for a, b, length in zip(words[::3], words[1::3], words[2::3], strict=True):
    network.add(HorizontalDistance(a, b, float(length), sigma=SIGMA, id=f"{a}-{b}"))

solution = fga.adjust(network, variance="a-posteriori")
rel = fga.reliability(solution)
print(f"{solution.n_observations} distances, {solution.n_unknowns} unknown coordinates")
print(f"σ̂0 {solution.sigma0:.3f} with a redundancy of {solution.redundancy}; {solution.reason}\n")

# %%
# Coordinates, their standard deviations and error ellipses of 95 %.
print("point     east, m    north, m    σE, mm  σN, mm   95 % ellipse, mm   azimuth, gon")
for name in ROUGH:
    (east, north, _), (se, sn, _) = solution.point(name), 1e3 * solution.standard_deviations(name)
    ellipse = fga.error_ellipse(solution, name)
    a, b = (1e3 * axis for axis in ellipse.semi_axes)
    print(
        f"{name:5}{east:12.4f}{north:12.4f}{se:10.2f}{sn:8.2f}{a:11.2f} × {b:5.2f}"
        f"{ellipse.azimuth / GON:15.1f}"
    )

# %%
# The reliability of each distance.
print("\nline      observed, m   v, mm   σ, mm     r    τ   smallest detectable error, mm")
for row, o in enumerate(solution.observations):
    r, tau, least = rel.redundancy_numbers[row], rel.tau[row], 1e3 * rel.mdb[row]
    print(
        f"{o.id:8}{o.observed:13.4f}{1e3 * o.residual:8.2f}{1e3 * o.sigma:8.2f}"
        f"{r:6.2f}{tau:5.1f}{least:8.1f}"
    )
print(f"critical value of |τ| at {100 * rel.alpha:g} %: {rel.critical_tau:.2f}")

# %%
# The picture.
if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(solution).savefig(options.plot, dpi=150)
    print(f"\n{options.plot}: the network with its ellipses of 95 %")
