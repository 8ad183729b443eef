"""El-Hakim & Faig (1981), table 2
===============================

Accuracy of the adjustments of the industry block.
``examples.published_blocks.industry_1981`` describes the geometry.
"""

import argparse
from math import nan

from examples.papers.comparison import Comparison, compared
from examples.papers.tables_1981 import INDUSTRY_CASES, industry_figures

PRINTED = {
    "a": (0.6, 0.4, 0.8, 1.6),
    "b": (5.0, 3.5, 1.7, 3.3),
    "c": (4.4, 3.1, nan, 3.3),
    "d": (3.4, 2.4, nan, 2.7),
}
WHAT = {
    "a": "a all data",
    "b": "b 4 photos, no self-calibration",
    "c": "c 4 photos",
    "d": "d 7 photos",
}

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the tables into FILE")
options = parser.parse_args()

found = {case: industry_figures(case) for case in INDUSTRY_CASES}
rows = [
    compared(WHAT[k], PRINTED[k], (f.discrepancy, f.coordinate_error, f.sigma, f.semi_major))
    for k, f in found.items()
]
table = Comparison(
    "1981, table 2: industry block, mm",
    ("distances RMS", "that / √2", "mean σ", "axis 95 %"),
    tuple(rows),
    note="70 points in 15 × 15 m, P31 on a crane 10 m up, 150 distances and all heights with "
    "σ 0.5 mm; mean of 20 simulations. Printed discrepancies without distances are twice "
    "what the printed ellipses allow; ours are not.",
)
ratios = Comparison(
    "Ratios of the distance discrepancies",
    ("ratio",),
    tuple(
        compared(
            f"{k} → {m}",
            [PRINTED[k][0] / PRINTED[m][0]],
            [found[k].discrepancy / found[m].discrepancy],
        )
        for k, m in ("bc", "cd")
    ),
    note="√(7/4) = 1.32 is to be expected of c → d.",
)
print(table, ratios, sep="\n\n")
if options.plot:
    from examples.papers.comparison_plot import plot_comparison

    plot_comparison([table, ratios]).savefig(options.plot, dpi=150)
