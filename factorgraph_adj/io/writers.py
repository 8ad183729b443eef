"""Table of the formats of networks by suffix or name, and writing of a network in any of them.

A new format needs one module with a function that writes a network, and one line in `WRITERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem, known
from ..network.network import Network
from .field_books.landxml import write_landxml
from .format_options import fitting_options, options_of, refuse_unknown_options
from .gnss.dynaml_writer import write_dynaml
from .gnss.gvx import write_gvx
from .gnss.sinex import write_sinex
from .photogrammetry.colmap_writer import write_colmap
from .photogrammetry.metashape_writer import write_metashape
from .photogrammetry.opencv import write_opencv
from .photogrammetry.opf_writer import write_opf
from .project_writer import write_project
from .robotics.g2o_writer import write_g2o
from .robotics.trajectory_writer import write_trajectory
from .survey.jag3d import write_jag3d
from .survey.star_net_writer import write_star_net


@dataclass(frozen=True)
class Writer:
    """Writer of one format.

    An adjusted network is written as `Solution.as_network`.
    """

    name: str
    """Word for the format in the option ``--to`` and in messages: ``colmap``."""
    suffixes: tuple[str, ...]
    """Suffixes of file names, with dots, that mean this format; empty for a format that is a
    folder, or whose suffix belongs to another one."""
    description: str
    """Name of the format for help and messages."""
    write: Callable[..., object]
    """Function of a network and a path that writes files; its keyword-only arguments are options.
    It raises InputError for everything of the network that the format cannot express, and leaves
    no file behind then."""

    alone: str = ""
    """What it writes, where that is a part of the network; empty: everything."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the keyword-only arguments of the function."""
        return options_of(self.write)


@dataclass(frozen=True)
class Writers:
    """A table of writers; its text lists their suffixes and descriptions."""

    entries: tuple[Writer, ...]
    """One writer for each format."""

    def __str__(self) -> str:
        """Return the suffixes with the names of their formats."""
        return ", ".join(
            f"{', '.join(w.suffixes) or f'--to {w.name}'} ({w.description})" for w in self.entries
        )

    def of(self, path: Path, format: str | None = None) -> Writer:
        """Return the writer of a format by its name, or by the longest suffix of a file.

        Raises:
            InputError: no writer has the name, or the suffix.
        """
        if format is not None:
            for writer in self.entries:
                if writer.name == format:
                    return writer
            names = known([w.name for w in self.entries], meant=format)
            raise InputError(f"no format {format!r} can be written; valid: {names}")
        end = "".join(path.suffixes).casefold()
        ends = [(len(s), w) for w in self.entries for s in w.suffixes if end.endswith(s)]
        if not ends:
            raise InputError(Problem(f"unknown kind of file to write; valid: {self}", str(path)))
        return max(ends, key=lambda entry: entry[0])[1]

    def write(
        self,
        network: Network,
        path: str | Path,
        *,
        format: str | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a network.

        Args:
            network: the network; that of an adjustment is `Solution.as_network`.
            path: file or folder.
            format: name of the format; None: it follows from the suffix.
            options: options of the function that writes this format, by name.

        Raises:
            InputError: no writer has the suffix or the name, the writer has no such option, or
                the format cannot express something of the network (all is listed). No file has
                changed then.
        """
        writer = self.of(Path(path), format)
        given = dict(options or {})
        doing = f"writing {writer.description}"
        refuse_unknown_options(given, writer.options, doing=doing, where=str(path))
        given = fitting_options(writer.write, given, doing=doing, where=str(path))
        writer.write(network, Path(path), **given)


WRITERS = Writers(
    (
        Writer("project", (".toml",), "project", write_project),
        Writer("colmap", (), "COLMAP", write_colmap),
        Writer("opencv", (".yml", ".yaml"), "calibration of OpenCV", write_opencv, "1 camera"),
        Writer("opf", (".opf",), "Open Photogrammetry Format", write_opf),
        Writer("sinex", (".snx",), "SINEX", write_sinex),
        Writer("dynaml", (), "DynaML of DynAdjust", write_dynaml),
        Writer("gvx", (".gvx",), "GNSS Vector Exchange", write_gvx),
        Writer("metashape", (), "cameras and markers of Metashape (.xml)", write_metashape),
        Writer("star-net", (".dat",), "STAR*NET", write_star_net),
        Writer("jag3d", (), "flat files of JAG3D", write_jag3d),
        Writer("g2o", (".g2o",), "pose graph of g2o", write_g2o),
        Writer(
            "trajectory",
            (".tum",),
            "trajectory of TUM or KITTI",
            write_trajectory,
            "poses of photos or vehicles",
        ),
        Writer("landxml", (".xml",), "points in LandXML", write_landxml),
    )
)
"""The formats that can be written."""
