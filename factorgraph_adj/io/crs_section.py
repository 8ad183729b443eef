"""Section [crs] of a project, read and written: system, geoid, seven parameters, axes of a grid."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, cast

from ..crs.reference_system import ReferenceSystem
from ..crs.transformation_chain import SevenParameters
from ..errors import InputError, Problem, known
from ..files import astray
from ..frames import Frame, LocalFrame
from ..network.grid.conversion import from_grid
from ..network.network import Network
from ..units import ANGLE, LENGTH
from .csv_tables import FieldRow

GRID_AXES = ("en", "ne")
"""Where x and y of a grid point: east and north, or north and east."""
GEOID_TABLE_SUFFIXES = (".csv", ".geo")
"""Suffixes of geoids whose messages show cells of the file."""
CRS_KEYS = (
    *("system", "geoid", "heights", "datum", "parameters", "coordinates", "axes"),
    *("deflections", "sigma_deflections_arcsec", "geoid_offset", "sigma_geoid_mm"),
    *("azimuths", "vectors", "horizontal_distances"),
)


@dataclass(frozen=True)
class CrsSection:
    """The section [crs] as read."""

    system: ReferenceSystem | None = None
    """The reference system; None: the project has none."""
    grid: bool = False
    """Whether coordinates of tables are those of the grid."""
    axes: str = "en"
    """Where x and y of the grid point."""
    options: Mapping[str, Any] | None = None
    """Options of `from_grid`."""

    @property
    def frame(self) -> LocalFrame:
        """The frame in which tables of a grid are read."""
        return LocalFrame(axes=cast(Any, self.axes))

    def moved(
        self, network: Network, frame: Frame | None, sources: Mapping[tuple[str, str], str]
    ) -> Network:
        """Return the network in a frame on the Earth.

        Args:
            network: the network as its tables have it, in the grid.
            frame: the frame that the project states; None: a topocentric one.
            sources: file and line by kind and name.

        Raises:
            InputError: as `from_grid`, with file and line of points and photos.
        """
        assert self.system is not None
        try:
            return from_grid(
                network,
                self.system,
                frame="topocentric" if frame is None else frame,
                sources=sources,
                **(self.options or {}),
            )
        except InputError as error:
            raise InputError(
                _problem_with_source(p, sources, network) for p in error.problems
            ) from None


def _problem_with_source(
    p: Problem, sources: Mapping[tuple[str, str], str], network: Network
) -> Problem:
    """Return a problem with the file and line of its point, photo or observation."""
    for (kind, name), place in sources.items():
        if p.where == f"{kind} {name!r}":
            return p.at(place)
    return p if p.where else Problem(p.what, "[crs]")


def read_crs_section(
    row: FieldRow, folder: Path, *, stated: bool, allow_outside: bool, geoids: Collection[str] = ()
) -> CrsSection:
    """Read the section; problems are noted in ``row``.

    Args:
        row: the table [crs].
        folder: folder of the project, to which a relative path of a geoid belongs.
        stated: whether the project has the section.
        allow_outside: whether the file of a geoid may lie outside of the folder.
        geoids: paths of geoids that may lie outside.
    """
    if not stated:
        return CrsSection()
    before = len(row.problems)
    system = row.text("system", required=True) or ""
    geoid = _geoid(row, folder, allow_outside, geoids)
    heights = row.text("heights")
    datum = row.text("datum")
    seven = _parameters(row)
    grid = row.choice("coordinates", ("grid", "frame"), "grid") == "grid"
    axes = row.choice("axes", GRID_AXES, "en")
    options = _options(row)
    for name in row.left():
        row.wrong(f"unknown key {name!r}; known: {known(CRS_KEYS, meant=name, most=40)}")
    if len(row.problems) > before:
        return CrsSection()
    try:
        found = ReferenceSystem(system, geoid, cast(Any, heights), datum, seven)
        if grid:
            found.checked()
    except InputError as error:
        row.wrong_all(error)
        return CrsSection()
    return CrsSection(found, grid, axes, options)


def _geoid(
    row: FieldRow, folder: Path, allow_outside: bool, geoids: Collection[str]
) -> str | float | None:
    given = row.fields.get("geoid")
    if given is None:
        return None
    if isinstance(given, int | float) and not isinstance(given, bool):
        return row.number("geoid")
    text = row.text("geoid")
    if text is None:
        return None
    if text in geoids:
        return text
    if why := astray(folder, text, allow_outside=allow_outside):
        row.wrong(f"geoid = {text!r} {why}")
        return None
    file = Path(text)
    here = folder / file
    of_proj = (
        file.name == text and file.suffix.lower() not in GEOID_TABLE_SUFFIXES and not here.is_file()
    )
    return text if of_proj else str(here.absolute())


def _parameters(row: FieldRow) -> SevenParameters | None:
    given = row.take("parameters")
    if given is None:
        return None
    fine = isinstance(given, list) and all(
        isinstance(v, int | float) and not isinstance(v, bool) for v in given
    )
    if not fine or len(cast(list[float], given)) not in (3, 7):
        row.wrong(
            "parameters must be [tx, ty, tz, rx, ry, rz, m]: metres, seconds of arc (position "
            f"vector), ppm; not {given!r}"
        )
        return None
    try:
        return SevenParameters(*(float(v) for v in cast(list[float], given)))
    except InputError as error:
        row.wrong_all(error)
        return None


def _options(row: FieldRow) -> dict[str, Any]:
    """Return the options of `from_grid` that are stated."""
    out: dict[str, Any] = {}
    sigma = row.quantity("sigma_deflections", ANGLE, positive=True)
    chosen = row.choice("deflections", ("none", "held", "weighted"), "none")
    if (sigma is not None) != (chosen == "weighted") and not row.failed:
        row.wrong(
            "deflections = 'weighted' and sigma_deflections_arcsec are given together, or neither"
        )
    out["deflections"] = sigma if sigma is not None else chosen
    offset = row.choice("geoid_offset", ("none", "free", "weighted"), "none")
    common = row.quantity("sigma_geoid", LENGTH, positive=True)
    if (common is not None) != (offset == "weighted") and not row.failed:
        row.wrong("geoid_offset = 'weighted' and sigma_geoid_mm are given together, or neither")
    out["geoid_offset"] = float("inf") if offset == "free" else common
    for name, valid in (
        ("azimuths", ("true", "grid")),
        ("vectors", ("geocentric", "grid")),
        ("horizontal_distances", ("measured", "ellipsoid", "sea_level", "grid")),
    ):
        if name in row:
            out[name] = row.choice(name, valid, valid[0])
    return out


def crs_section_lines(
    system: ReferenceSystem | None, text: Any, folder: Path | None
) -> Iterator[str]:
    """Return the lines of the section of a network whose tables have coordinates of its frame.

    Args:
        system: the reference system; None: no lines.
        text: function that quotes text for TOML.
        folder: folder of the project; a geoid in it is written by its name.
    """
    if system is None:
        return
    yield ""
    yield "[crs]"
    yield f"system = {text(system.definition)}"
    if isinstance(system.geoid, str):
        file = Path(system.geoid)
        own = folder is not None and file.is_absolute() and file.parent == folder.absolute()
        there = str(file.absolute()) if file.is_file() else system.geoid
        yield f"geoid = {text(file.name if own else there)}"
    elif system.geoid is not None:
        yield f"geoid = {float(system.geoid)!r}"
    if system.heights is not None:
        yield f"heights = {text(system.heights)}"
    if system.datum is not None:
        yield f"datum = {text(system.datum)}"
    if system.parameters is not None:
        yield f"parameters = {list(map(float, astuple(system.parameters)))!r}"
    yield 'coordinates = "frame"'
