"""El-Hakim (1986), tables 1 to 5
==============================

Redundancy numbers, and the effect of errors of 100 µm in the images. ``table_1986_1_to_5.py 2``
prints table 2; without a number all tables are printed.
``examples.published_blocks.el_hakim_1986`` and ``examples.papers.tables_1986`` describe the
geometry.
"""

import argparse

from examples.papers import tables_1986 as paper
from examples.papers.comparison import Comparison, compared

XYZ = ("X mm", "Y mm", "Z mm")
BLOCK = "52 photos, 1:4400; points on the edge with the printed number of rays and like r."
FLOOR = "D to H: 4 photos of a P31. Signs depend on the side of the photo."
CASES = paper.AERIAL | paper.CLOSE_RANGE


def before_and_after(name):
    """Return the reliability without and with the distances of a case."""
    if name in paper.AERIAL:
        return paper.aerial(), paper.aerial(distances=True)
    return paper.close_range(), paper.close_range(CASES[name].lines)


def table_1():
    """Redundancy numbers by rays."""
    rows = [
        compared(f"{block}, {n} rays", row, paper.averages(block, n))
        for block, rows in paper.TABLE_1.items()
        for n, row in rows.items()
    ]
    columns = ("r x", "r y", "e2 x", "e2 y")
    return Comparison("1986, table 1: redundancy numbers by rays", columns, tuple(rows))


def table_2():
    """Effect of distances on r."""
    rows = [
        compared(f"{k} {c.rays} rays, {len(c.ends)} dist.", (c.before, c.after), map(c.r, two))
        for k, c in CASES.items()
        if (two := before_and_after(k))
    ]
    title = "1986, table 2: r without and with distances"
    return Comparison(title, ("without", "with"), tuple(rows), note=BLOCK)


def table_3():
    """Effect of an image error on coordinates."""
    rows = []
    for k, c in CASES.items():
        without, with_distances = before_and_after(k)
        rows.append(compared(f"{k} without", c.effect_before, c.effect(without)))
        rows.append(compared(f"{k} with distances", c.effect_after, c.effect(with_distances)))
    title = "1986, table 3: effect of 100 µm in an image"
    return Comparison(title, XYZ, tuple(rows), digits=0, note=f"{BLOCK} {FLOOR}")


def table_4():
    """Height differences and r."""
    stages = (paper.aerial(), paper.aerial(distances=True), paper.aerial(True, True))
    rows = []
    for k, last in paper.WITH_HEIGHTS.items():
        c = paper.AERIAL[k]
        rows.append(compared(k, (c.before, c.after, last), [c.r(rel) for rel in stages]))
    columns = ("photos", "distances", "and heights")
    return Comparison("1986, table 4: r with height differences", columns, tuple(rows), note=BLOCK)


def table_5():
    """Height differences and an image error."""
    rows = []
    for k, last in paper.EFFECT_WITH_HEIGHTS.items():
        c = paper.AERIAL[k]
        rows.append(compared(f"{k} photos", c.effect_before, c.effect(paper.aerial())))
        rows.append(
            compared(f"{k} distances", c.effect_after, c.effect(paper.aerial(distances=True)))
        )
        rows.append(compared(f"{k} and heights", last, c.effect(paper.aerial(True, True))))
    title = "1986, table 5: effect of 100 µm with height differences"
    return Comparison(title, XYZ, tuple(rows), digits=0, note=BLOCK)


TABLES = dict(enumerate((table_1, table_2, table_3, table_4, table_5), start=1))

parser = argparse.ArgumentParser()
parser.add_argument("table", nargs="?", type=int, choices=TABLES, help="its number (all)")
parser.add_argument("--plot", metavar="FILE", help="draw the tables into FILE")
options = parser.parse_args()
tables = [TABLES[n]() for n in ([options.table] if options.table else TABLES)]
print(*tables, sep="\n\n")
if options.plot:
    from examples.papers.comparison_plot import plot_comparison

    plot_comparison(tables).savefig(options.plot, dpi=150)
