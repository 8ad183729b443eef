"""Formats of other programs by suffix: the table of what a solution can be written as.

A new format needs one module with a function that writes a solution, and one line in `EXPORTS`.
A solution can be written in every format of a network as well, with adjusted values for given ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..epochs.comparison import Congruence
from ..errors import InputError, Problem, known
from ..io.format_options import fitting, options_of, refuse_unknown
from ..io.writers import WRITERS
from ..network.network import Network
from ..report.context import Report
from ..report.epochs.context import EpochsReport
from .dxf import refuse_drawing, write_dxf
from .geojson import write_geojson
from .geopackage import write_geopackage
from .kml import write_kml
from .layers import Result
from .placing import refuse_no_place
from .ply import write_ply
from .results import write_results


@dataclass(frozen=True)
class Export:
    """One format of solutions."""

    name: str
    """Word for the format: ``geopackage``."""
    suffixes: tuple[str, ...]
    """Suffixes of file names, with dots."""
    description: str
    """Name of the format for help and messages."""
    write: Callable[..., object]
    """Function of a solution, or a report, and a path; its keyword-only arguments are options. It
    raises InputError and leaves no file behind where the format cannot express the solution."""

    check: Callable[[Network], object] | None = None
    """Function of the network that raises InputError for what can be known before the adjustment:
    no reference system, or an extra that is missing; None: nothing."""
    epochs: bool = True
    """Whether it can express a comparison of two epochs."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the keyword-only arguments of the function."""
        return options_of(self.write)


EXPORTS: tuple[Export, ...] = (
    Export("results", (".json",), "results for programs", write_results),
    Export("geopackage", (".gpkg",), "GeoPackage", write_geopackage),
    Export("geojson", (".geojson",), "GeoJSON", write_geojson, refuse_no_place),
    Export("kml", (".kml",), "KML", write_kml, refuse_no_place),
    Export("dxf", (".dxf",), "DXF drawing", write_dxf, refuse_drawing),
    Export("ply", (".ply",), "PLY points", write_ply, epochs=False),
)
"""The formats that a solution can be written in."""


@dataclass(frozen=True)
class Target:
    """A file to write, and the format that it gets."""

    path: Path
    """The file, or folder."""
    name: str
    """Word for the format."""
    description: str
    """Name of the format for messages."""
    options: tuple[str, ...]
    """Names of its options."""
    of_network: bool
    """Whether it is a format of networks, which gets adjusted values for given ones."""
    function: Callable[..., object]
    """The function that writes it."""
    check: Callable[[Network], object] | None = None
    """What forbids it before the adjustment, see `Export`."""
    epochs: bool = False
    """Whether it can express a comparison of two epochs."""

    def refuse_epochs(self) -> None:
        """Raise that the format cannot express a comparison of two epochs.

        Raises:
            InputError: it cannot.
        """
        if not self.epochs:
            valid = ", ".join(s for e in EXPORTS if e.epochs for s in e.suffixes)
            raise InputError(
                Problem(
                    f"{self.description} has no displacements of two epochs; write the solution "
                    f"of an epoch, or the comparison as {valid}",
                    str(self.path),
                )
            )

    def write(self, what: Network | Result, **options: Any) -> None:
        """Write a result, or a network in a format of networks.

        Raises:
            InputError: the format has no such option, is not one of networks, or cannot express
                what is written (all is listed).
        """
        doing = f"writing {self.description}"
        refuse_unknown(options, self.options, doing=doing, where=str(self.path))
        options = fitting(self.function, options, doing=doing, where=str(self.path))
        if isinstance(what, Congruence | EpochsReport):
            self.refuse_epochs()
            self.function(what, self.path, **options)
            return
        if not self.of_network:
            if isinstance(what, Network):
                raise InputError(
                    Problem(
                        f"{self.description} has results: adjust the network, and write the "
                        "solution",
                        str(self.path),
                    )
                )
            self.function(what, self.path, **options)
            return
        solution = what.solution if isinstance(what, Report) else what
        network = solution if isinstance(solution, Network) else solution.as_network()
        self.function(network, self.path, **options)


def formats() -> str:
    """Return the suffixes and names of all formats, those of solutions first."""
    own = ", ".join(f"{', '.join(e.suffixes)} ({e.description})" for e in EXPORTS)
    return f"{own}; and adjusted networks as {WRITERS}"


def target(path: str | Path, format: str | None = None) -> Target:
    """Return how a file is written: by the name of its format, or by its suffix.

    Raises:
        InputError: no format has the name, or the suffix.
    """
    file = Path(path)
    for e in EXPORTS:
        if format == e.name or (format is None and file.suffix.lower() in e.suffixes):
            return Target(file, e.name, e.description, e.options, False, e.write, e.check, e.epochs)
    names = [e.name for e in EXPORTS] + [w.name for w in WRITERS.entries]
    if format is not None and format not in names:
        valid = known(names, meant=format)
        raise InputError(f"no format {format!r} can be written; valid: {valid}")
    try:
        w = WRITERS.of(file, format)
    except InputError:
        what = f"unknown kind of file to write; valid: {formats()}"
        raise InputError(Problem(what, str(path))) from None
    return Target(file, w.name, w.description, w.options, True, w.write)


def write(
    what: Network | Result,
    path: str | Path,
    *,
    format: str | None = None,
    **options: Any,
) -> None:
    """Write a network or a result in the format that the suffix tells; `read` is the reverse.

    A solution can be written for geographic programs (GeoPackage, GeoJSON, KML), as a drawing
    (DXF), as points (PLY), as results for programs (JSON), and in every format of a network, with
    adjusted values for given ones.

    Args:
        what: a network, a solution, or a report with data snooping; or a comparison of two epochs,
            or its report with blocks, in the formats of solutions except PLY.
        path: the file, or folder.
        format: name of the format, where the suffix does not tell it.
        options: options of the function that writes the format.

    Raises:
        InputError: no format has the suffix or the name, the format has no such option, or cannot
            express what is to be written (all is listed). No file has changed then.
    """
    target(path, format).write(what, **options)
