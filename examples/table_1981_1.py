"""El-Hakim & Faig (1981), table 1
===============================

Terrestrial observations replace control in the ISP block. The scan of the paper has the table only
as a picture; its text states that the improvement over reduced control is significant and depends
on number and distribution. ``examples.papers.tables_1981`` describes the geometry.
"""

import argparse

from examples.papers.comparison import Comparison, compared
from examples.papers.tables_1981 import ISP_CASES, isp_trial
from factorgraph_adj.experiment.runs import Experiment, run

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the table into FILE")
parser.add_argument("--repetitions", type=int, default=3, help="of each case (3)")
options = parser.parse_args()

experiment = Experiment("ISP block", isp_trial, {"case": ISP_CASES}, seed=1981)
summary = run(experiment, options.repetitions).summary()
figures = ("x", "y", "z", "sigma_x", "sigma_y", "sigma_z")
rows = [compared(case, None, [summary.of(f, case=case).rms for f in figures]) for case in ISP_CASES]
table = Comparison(
    "1981, table 1: RMS error and standard deviation of 47 check points",
    ("X mm", "Y mm", "Z mm", "σ X mm", "σ Y mm", "σ Z mm"),
    tuple(rows),
    digits=0,
    note="Nothing is printed that can be read. 25 photos 1:10 000; full control: 30 points on the "
    "edge; reduced: the corners. Layouts of distances, directions, azimuths, vertical angles, "
    "levelling, Φ and Λ with reduced control: 1, all 30 lines of the edge; 2, every second; 3, a "
    "cross through the middle.",
)
print(table)
if options.plot:
    from examples.papers.comparison_plot import plot_comparison

    plot_comparison([table]).savefig(options.plot, dpi=150)
