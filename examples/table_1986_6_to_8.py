"""El-Hakim (1986), tables 6 to 8
==============================

Remaining systematic errors in the images of the 52-photo block. ``table_1986_6_to_8.py 6``
prints table 6; without a number all tables are printed.
``examples.papers.systematic_errors_1986`` describes the geometry.
"""

import argparse

from examples.papers import systematic_errors_1986 as left_in
from examples.papers.comparison import Comparison, compared

XYZ = ("X mm", "Y mm", "Z mm")
SYSTEMATIC = "No noise; curve, layout and make-up of the deformation are chosen, not printed."


def table_6():
    """Overall effect of systematic errors."""
    rows = []
    for n, test in left_in.TABLE_6.items():
        found = left_in.effect(n)
        rows.append(compared(test.label, test.printed, (*found.residuals, *found.rms)))
    title = "1986, table 6: systematic errors, RMS of residuals and of object points"
    columns = ("v x µm", "v y µm", *XYZ)
    return Comparison(title, columns, tuple(rows), digits=1, note=SYSTEMATIC)


def at_points(title, printed):
    """Return a table of points: as many of ours on short and long sides as there are printed."""
    there = left_in.layout()
    ours = (*there.along_y[:2], *there.along_x[:3])
    rows = [
        compared(f"test {n}: point {p}, ours {q}", figures, left_in.effect(n).errors[q])
        for n, points in printed.items()
        for (p, figures), q in zip(points.items(), ours, strict=True)
    ]
    note = f"{SYSTEMATIC} 68 and 82: on a short side, the others on a long one."
    return Comparison(title, XYZ, tuple(rows), digits=0, note=note)


def table_7():
    """Points under radial distortion."""
    return at_points("1986, table 7: some points, radial distortion", left_in.TABLE_7)


def table_8():
    """Points under affine deformation."""
    return at_points("1986, table 8: some points, affine deformation", left_in.TABLE_8)


TABLES = dict(enumerate((table_6, table_7, table_8), start=6))

parser = argparse.ArgumentParser()
parser.add_argument("table", nargs="?", type=int, choices=TABLES, help="its number (all)")
parser.add_argument("--plot", metavar="FILE", help="draw the tables into FILE")
options = parser.parse_args()
tables = [TABLES[n]() for n in ([options.table] if options.table else TABLES)]
print(*tables, sep="\n\n")
if options.plot:
    from examples.papers.comparison_plot import plot_comparison

    plot_comparison(tables).savefig(options.plot, dpi=150)
