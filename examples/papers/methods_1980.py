"""Ayeni (1980), tables 1 and 3: thirty methods of phototriangulation on one block.

Table 1 describes thirty methods, table 3 has the published accuracy at check points of seven of
them, each on another block. Here all feasible methods are run on one block, and table 3 is
completed: errors at check points, redundancy, unknowns, time, or why a method is not run.

`simulated_block` is described in `methods_1980_block`. Any network of photos with held control and
check points can take its place: ``run_methods(MethodBlock(network, network))``.

    python -m examples.papers.methods_1980                    # the simulated block
    python -m examples.papers.methods_1980 --methods 12 25    # two methods
    python -m examples.papers.methods_1980 PROJECT            # a project with photos
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Literal

import numpy as np

from factorgraph_adj.errors import AdjustmentError, ApproximationError, DatumError, InputError
from factorgraph_adj.io.project import read_project
from factorgraph_adj.report import layout
from factorgraph_adj.types import Array

from . import methods_1980_run as run
from .methods_1980_block import MethodBlock, simulated_block
from .methods_1980_run import Method, Outcome

GRAPHICAL = "graphical or mechanical; its equations are those of 16"
INSTRUMENT = "instrumental: errors are prorated in the plotter; as an adjustment it is 8"

Needed = Literal["", "terrestrial", "statoscope", "tilts"]
"""A part of a block."""
NEEDED = {
    "terrestrial": "distances and azimuths",
    "statoscope": "statoscope",
    "tilts": "measured tilts",
}
"""Names of parts of a block."""


@dataclass(frozen=True)
class Row:
    """A method of table 1."""

    number: int
    """Number in the table."""
    name: str
    """Name."""
    method: Method | None
    """Function that runs it; None: it is not run."""
    reason: str = ""
    """Reason why it is not run."""
    needs: Needed = ""
    """Part of the block that it needs besides photos and control."""


METHODS: tuple[Row, ...] = (
    Row(1, "radial line, graphical", None, GRAPHICAL),
    Row(2, "slotted templates", None, GRAPHICAL),
    Row(3, "mechanical templates", None, GRAPHICAL),
    Row(4, "ITC-Jerie: section templates", run.section_templates),
    Row(5, "stereo-templates", run.models_in_plan),
    Row(6, "multiple projectors", None, INSTRUMENT),
    Row(7, "two projectors", None, INSTRUMENT),
    Row(8, "aeropolygon", run.joined_strips),
    Row(
        9,
        "aerolevelling, heights in corners",
        lambda b: run.aerolevelled(b.plotter, b, practice=True),
        needs="statoscope",
    ),
    Row(10, "models, geodetic control", run.geodetic_control, needs="terrestrial"),
    Row(11, "models, polynomials", lambda b: run.bent_strips(b.plotter, b)),
    Row(12, "models, plan and height", lambda b: run.in_turn(b.plotter, b)),
    Row(13, "models, an-block", run.models_in_plan),
    Row(14, "models, tilts, heights in corners", run.tilted, needs="tilts"),
    Row(15, "semi-analytical bundle", run.pseudo_images),
    Row(16, "numerical radial", run.radial),
    Row(
        17,
        "bundle, geodetic control",
        partial(run.bundle, terrestrial=True, control="one"),
        needs="terrestrial",
    ),
    Row(18, "IMT, polynomials", lambda b: run.bent_strips(b.network, b)),
    Row(19, "IMT, plan and height", lambda b: run.in_turn(b.network, b)),
    Row(20, "IMT, collocation", run.collocated),
    Row(21, "IMT, triplets", lambda b: run.simultaneous(b, run.triplets(b.network))),
    Row(
        22,
        "IMT, statoscope, heights in corners",
        lambda b: run.aerolevelled(b.network, b, practice=False),
        needs="statoscope",
    ),
    Row(23, "IMT, additional parameters", partial(run.simultaneous, deformed=True)),
    Row(24, "IMT, simultaneous", run.simultaneous),
    Row(25, "bundle", run.bundle),
    Row(
        26,
        "SAPGO, plan of corners held",
        partial(run.bundle, terrestrial=True, control="corners"),
        needs="terrestrial",
    ),
    Row(27, "bundle, collocation", run.bundle_with_signals),
    Row(28, "bundle, additional parameters", partial(run.bundle, lens="ebner")),
    Row(29, "self-calibration", partial(run.bundle, lens="brown", priors=True)),
    Row(30, "28 and 29 together", partial(run.bundle, lens="both", priors=True)),
)
"""The methods of table 1 in order; one line for each method."""

REPORTED: dict[int, str] = {
    12: "Zürich 42.2 plan, 46.7 height",
    19: "Appenweier 5.3; with collocation (20) 4.4",
    23: "Frankfurt 28.0 without, 17.6 with parameters",
    25: "Ålborg 5.0 plan",
    27: "Casa Grande 2.2 plan, 1.6 height",
    28: "Jämijärvi 2.3 plan, 3.0 height",
    30: "Atlanta 7.0, 3.0",
}
"""Errors printed in table 3, cm, by method; each on another block."""


@dataclass(frozen=True, eq=False)
class Ran:
    """A row of table 3."""

    row: Row
    """The method."""
    outcome: Outcome | None
    """Its results; None: it was not run."""
    seconds: float = np.nan
    """Time of all its steps, seconds."""
    reason: str = ""
    """Reason why it was not run."""

    @property
    def rms(self) -> Array:
        """RMS errors at check points in x, y, z, metres, (3,); NaN where it gives none."""
        if self.outcome is None or not len(self.outcome.errors):
            return np.full(3, np.nan)
        return np.asarray(np.sqrt(np.mean(self.outcome.errors**2, axis=0)))


@dataclass(frozen=True, eq=False)
class Table3:
    """Methods, or programs, on one block."""

    title: str
    """Title."""
    rows: tuple[Ran, ...]
    """The rows in the order of the table of the paper."""

    def of(self, number: int) -> Ran:
        """Return the row with a number."""
        return next(r for r in self.rows if r.row.number == number)

    def __str__(self) -> str:
        """Return the table as text."""
        header = ["", "method", "n", "u", "r", "σ̂0", "E cm", "N cm", "H cm", "k", "s"]
        lines, left = [], []
        for r in self.rows:
            head = [f"{r.row.number}", r.row.name]
            if r.outcome is None:
                left.append(f"{r.row.number} {r.row.name}: {r.reason}.")
                continue
            o = r.outcome
            figures = [_cell(100 * x, 1) for x in r.rms]
            counts = [f"{o.n}", f"{o.u}", f"{o.r}", _cell(o.sigma0, 2)]
            lines.append([*head, *counts, *figures, f"{len(o.errors)}", _cell(r.seconds, 2)])
        said = (
            "n, u and r are those of the last adjustment; relative orientations come before. RMS "
            "errors at k check points."
        )
        if left:
            said = f"{said} Not run: {' '.join(left)}"
        table = layout.table(header, lines)
        return "\n".join([*layout.title(self.title), *table, "", *layout.paragraph(said)])


def _cell(value: float, digits: int) -> str:
    return "–" if value != value else f"{value:.{digits}f}"


def run_methods(
    block: MethodBlock, *, title: str | None = None, numbers: Collection[int] | None = None
) -> Table3:
    """Run all methods that a block has the data for.

    Args:
        block: the block.
        title: title of the table; by default the name of the network.
        numbers: numbers of the methods; by default all.
    """
    rows = [ran(row, block) for row in METHODS if numbers is None or row.number in numbers]
    name = block.network.name if title is None else title
    return Table3(f"Ayeni (1980), table 3: {name}", tuple(rows))


def ran(row: Row, block: MethodBlock) -> Ran:
    """Run a method, or say why it is not run."""
    if row.method is None:
        return Ran(row, None, reason=row.reason)
    if row.needs and not getattr(block, row.needs):
        return Ran(row, None, reason=f"the block has no {NEEDED[row.needs]}")
    begin = perf_counter()
    try:
        found = row.method(block)
    except (InputError, DatumError, ApproximationError, AdjustmentError) as error:
        first, *more = (line.strip() for line in str(error).splitlines())
        return Ran(row, None, reason=": ".join([first, *more[:1]]))
    return Ran(row, found, perf_counter() - begin)


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = argparse.ArgumentParser(prog="python -m examples.papers.methods_1980")
    add_block_options(parser)
    parser.add_argument(
        "--methods",
        nargs="+",
        type=int,
        choices=[r.number for r in METHODS],
        metavar="N",
        help="numbers of the methods to run (all)",
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Print table 3 for the simulated block, or for a project."""
    options = command_parser().parse_args(arguments)
    print(run_methods(chosen_block(options), numbers=options.methods))
    return 0


def add_block_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a block."""
    parser.add_argument("project", nargs="?", help="a project with photos, control, check points")
    parser.add_argument("--seed", type=int, default=1980, help="of the simulated block (1980)")


def chosen_block(options: argparse.Namespace) -> MethodBlock:
    """Return the block of a project, or the simulated one."""
    if options.project is None:
        return simulated_block(options.seed)
    network = read_project(options.project)
    return MethodBlock(network, network)


if __name__ == "__main__":
    raise SystemExit(main())
