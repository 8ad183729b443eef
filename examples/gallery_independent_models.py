"""Independent models, strips and directions from one block
========================================================

What does a block lose if photos are first made into models? Three strips of photos are adjusted
as a bundle, as triplets, as pairs, as strips that polynomials bend, and as directions in plan. All
start from the same image coordinates; film and lens deform them in the same way.
"""

import argparse

from examples.papers.methods_1980 import run_methods
from examples.papers.methods_1980_block import simulated_block

SHOWN = {28: "bundle, film unknown", 25: "bundle", 21: "triplets", 24: "pairs"}
SHOWN |= {23: "pairs, film unknown", 18: "strips, degree 2", 16: "directions in plan"}

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the errors at check points")
options = parser.parse_args()

table = run_methods(simulated_block(), numbers=SHOWN)
print("method                  unknowns  redundancy     σ̂0    E    N    H, cm at check points")
for number, name in SHOWN.items():
    ran = table.of(number)
    o = ran.outcome
    errors = "".join("    –" if e != e else f"{100 * e:5.1f}" for e in ran.rms)
    print(f"{name:24}{o.u:8}{o.r:12}{o.sigma0:7.2f}{errors}")

if options.plot:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    axes = figure.subplots()
    names = list(SHOWN.values())
    for k, (axis, colour) in enumerate((("E", "C0"), ("N", "C1"), ("H", "C2"))):
        lengths = [100 * table.of(n).rms[k] for n in SHOWN]
        places = [i + 0.25 * (k - 1) for i in range(len(names))]
        axes.barh(places, lengths, height=0.22, color=colour, label=axis)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlabel("RMS error at check points [cm]")
    axes.legend()
    figure.savefig(options.plot, dpi=150)
    print(f"{options.plot}: errors of the methods")
