"""Command ``refine``: image coordinates corrected for refraction and curvature of the Earth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from ..adjustment import adjust
from ..atmosphere import SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE
from ..errors import InputError
from ..io.csv_tables import write_columns
from ..io.file_transaction import one_transaction, write_files
from ..io.project_writer import write_project
from ..models.image_refraction import Atmosphere, RefractionModel
from ..report.layout import figures, table
from ..triangulation.image_refinement import RefinedImages, refine_images
from .input import add_project, read_input
from .messages import EXIT_CODES, EXIT_FINE
from .options import add_leave_out, adjust_determined, problems_of_outputs

ZERO_CELSIUS = 273.15
"""0 °C in kelvin."""


def add_refine(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.epilog = EXIT_CODES
    add_project(parser)
    parser.add_argument(
        "--refraction",
        choices=("none", *get_args(RefractionModel)),
        default="integral",
        help="model of the refraction of rays from the air (integral)",
    )
    parser.add_argument(
        "--curvature",
        action="store_true",
        help="correct for the curvature of the Earth: the frame is a map plane",
    )
    parser.add_argument(
        "--air",
        nargs=3,
        type=float,
        metavar=("HPA", "CELSIUS", "METRES"),
        help="pressure and temperature, and the height above sea level at which both were read, "
        "for the models integral and traced (the standard atmosphere)",
    )
    parser.add_argument(
        "--geoid-height",
        type=float,
        default=0.0,
        metavar="METRES",
        help="height of the geoid above the ellipsoid, for geocentric and topocentric frames (0)",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="write the project with refined images, and refinement.csv",
    )
    add_leave_out(parser)
    parser.set_defaults(run=_refine)


def _refine(options: argparse.Namespace) -> int:
    """Refine the images of a project with the poses and points of its adjustment."""
    if problems := list(problems_of_outputs(options)):
        raise InputError(problems)
    air = None
    if options.air is not None:
        pressure, celsius, height = options.air
        air = Atmosphere(100.0 * pressure, ZERO_CELSIUS + celsius, height)
    project = read_input(options)
    project, solution = adjust_determined(project, adjust, leave_out=options.leave_out_undetermined)
    found = refine_images(
        project.network,
        refraction=None if options.refraction == "none" else options.refraction,
        curvature=options.curvature,
        atmosphere=air,
        solution=solution,
        geoid=options.geoid_height,
    )
    text = _text(found, options.refraction, air)
    if options.out is not None:
        out = Path(options.out)
        with one_transaction():
            write_project(found.network, out / "project.toml", units=project.units)
            write_files(out, {"refinement.csv": _table(found)})
    print(text, end="", flush=True)
    return EXIT_FINE


def _text(found: RefinedImages, model: str, air: Atmosphere | None) -> str:
    """Return the corrections of each photo as text, in the units of their cameras."""
    rows = found.first_rows()
    cells = [[f"{c:.4g}" if isinstance(c, float) else str(c) for c in row] for row in rows.cells]
    lines = [f"Image refinement of {found.network.name}", ""]
    if "refraction" in found.corrections:
        here = air or Atmosphere(SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE)
        own = model in ("integral", "traced")
        lines.append(
            f"refraction: {model}"
            + (
                f", {here.pressure / 100:.1f} hPa and {here.temperature - ZERO_CELSIUS:.1f} °C at "
                f"{here.height:.0f} m above sea level"
                if own
                else ", with an atmosphere of its own"
            )
        )
    if "curvature" in found.corrections:
        lines.append(f"curvature: radius of the Earth {found.network.frame.radius:.0f} m")
    lines += ["", *table(rows.header, cells), ""]
    return "\n".join(lines)


def _table(found: RefinedImages) -> str:
    """Return the corrections of each image point and their sum as CSV."""
    columns: dict[str, list[str]] = {"photo": list(found.photo), "point": list(found.point)}
    for cause, values in {**found.corrections, "sum": found.sum}.items():
        columns |= {f"{cause}_{a}": figures(values[:, i]) for i, a in enumerate("xy")}
    return write_columns(columns)
