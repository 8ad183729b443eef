"""Reader of projects of STAR*NET: settings, instrument library, coordinate system and data files.

A project (``.snproj``, formerly ``.prj``) is text: ``*STAR*NET`` in its first line, sections in
brackets, rows of a key and a value, comments behind ``#``. Its settings make the same record that
the option ``options`` of `read_star_net` states, `StarNetOptions`, and its data files are read by
the same function.

Source: projects and listings of STAR*NET 13.0.2 (jeelojacko/webnet, tests/fixtures), of which the
listings print the settings with their units.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...crs.reference_system import ReferenceSystem
from ...files import inside
from ...network.grid.transformation import Azimuths, Distances
from ...network.network import Network
from ..format_reader import NetworkReader, Reader
from ..source import Field, LeftOutReason, TextSource
from ..text_files import file_beginning
from .star_net import DataFiles, read_data_files
from .star_net_network import star_net_grid_system
from .star_net_options import KILOMETRE_METRES, MILE_FEET, StarNetOptions

BEGINNING = re.compile(
    rb"(?:\xef\xbb\xbf)?(?:[ \t]*+(?:#[^\r\n]*+)?(?:\r\n?+|\n))*+"
    rb"(?:\*STAR\*NET\b|\[Adjustment\][^\r\n]*[\r\n]+(?:#[^\r\n]*[\r\n]+)*adjustment_type[ \t])"
)
"""Beginning of a project, behind comments: its first line, or the first section where it lacks."""
HEADER = "*STAR*NET"
SECTION = re.compile(r"\[(\w+)\]")
KEY = re.compile(r"[A-Za-z0-9]+(?:_[A-Za-z0-9]+)+")
"""Key of a setting: versions of STAR*NET have others than those that are read."""
DATA_FILE = re.compile(r'(\d+)\s+"([^"]+)"')
IS_USED = 1
"""Bit of the number before the name of a data file: whether the project uses it."""
OUTPUT_SECTIONS = ("Listing", "Plot", "DXF", "KML", "LandXML", "USER")
"""Sections that concern what STAR*NET prints, draws and exports."""
OUTPUT_SETTINGS = LeftOutReason("sections", "they concern listings, drawings and exports")
UNKNOWN_SETTINGS = LeftOutReason("settings", "the reader does not know their keys")
UNUSED_FILES = LeftOutReason("data files", "the project does not use them")
CSRS_UTM = {
    **{zone: 3147 + zone for zone in range(7, 11)},
    **{zone: 2944 + zone for zone in range(11, 14)},
    **{zone: 3144 + zone for zone in range(14, 17)},
    **{zone: 2941 + zone for zone in range(17, 22)},
    22: 3761,
}
"""EPSG codes of NAD83(CSRS) / UTM by zone."""
NAD83_UTM = {zone: 26900 + zone for zone in range(1, 24)}
"""EPSG codes of NAD83 / UTM by zone."""
NAMED_SYSTEMS = {"NewBrunswick83": 2953}
"""EPSG codes of other coordinate systems by their name in STAR*NET."""


def read_star_net_project(
    path: str | Path,
    *,
    crs: ReferenceSystem | str | None = None,
    geoid: str | float | None = None,
    azimuths: Azimuths = "grid",
    horizontal_distances: Distances = "measured",
    readings: bool = True,
) -> Network:
    """Read a project of STAR*NET (``.snproj``, ``.prj``) with the data files that it uses.

    Read are the type of adjustment, units, orders, the coordinate system, geoid height, elevation
    and scale factor of the project, refraction and radius of the Earth, factors of GPS vectors, the
    default standard errors, the instruments of its library and the list of data files, of which
    those that the project does not use are left out. Its standard errors are in the linear unit and
    in seconds (milligons); those of levelling, per square root of one linear unit of the line.
    Settings of listings, plots and exports are left out, and so are those of the solution.

    Not read, an error if they are switched on: a geoid model (state ``geoid``), deflections of the
    vertical, centring and transformations of GPS vectors, a common elevation of a local project.
    Tried on the two projects of STAR*NET 13.0.2 that are public.

    Args:
        path: the project.
        crs: reference system of the grid instead of that of the project, whose name STAR*NET has
            of its own; UTM83 and UTM83/CSRS with a zone, and NewBrunswick83 are known.
        geoid: what elevations are above: the path of a geoid; None: the geoid height of the
            project.
        azimuths: as in `read_star_net`.
        horizontal_distances: as in `read_star_net`.
        readings: as in `read_star_net`.

    Raises:
        InputError: every problem of the project and of its data files, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    project = _Project(source)
    project.read()
    source.raise_all()
    options = StarNetOptions(**project.options())
    system = project.system(crs, geoid)
    source.raise_all()
    return read_data_files(
        DataFiles(project.files, Path(path).stem, source.problems),
        options,
        system,
        azimuths=azimuths,
        horizontal_distances=horizontal_distances,
        readings=readings,
    )


# -- settings -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ProjectSetting:
    """A row of a section."""

    option: str = ""
    """Field of `StarNetOptions`; empty: the reader itself uses the value, or nothing does."""
    read: Callable[[Field], Any] | None = None
    """Function that reads it; None: it has no influence on the network."""


def _number(field: Field) -> float:
    return field.number()


def _at_least_zero(field: Field) -> float:
    return field.number(least=0.0)


def _positive(field: Field) -> float:
    return field.number(above=0.0)


def _one_of(table: dict[str, Any]) -> Callable[[Field], Any]:
    return lambda field: field.choice(table)


def _off(advice: str) -> Callable[[Field], Any]:
    """Return a function that refuses a switch that is on."""

    def read(field: Field) -> int | None:
        value = field.integer()
        if value:
            field.wrong(f"is {value}: {advice}")
        return value

    return read


def _zero(advice: str) -> Callable[[Field], Any]:
    """Return a function that refuses a number other than 0."""

    def read(field: Field) -> float:
        value = field.number()
        if value:
            field.wrong(f"is {value:g}: {advice}")
        return value

    return read


DEFLECTIONS = "deflections of the vertical of a project are not read; valid: 0"
UNUSED = ProjectSetting()
ADJUSTMENT = {
    "adjustment_type": ProjectSetting(
        "adjustment", _one_of({"3D": "3D", "2D": "2D", "Lev": "LEV", "LEV": "LEV"})
    ),
    "linear_units": ProjectSetting(
        "linear", _one_of({w: w for w in ("Meters", "FeetUS", "FeetInt")})
    ),
    "angle_output_units": ProjectSetting("angular", _one_of({"DMS": "DMS", "GONS": "GONS"})),
    "local_or_grid_adjustment": ProjectSetting(read=_one_of({"0": "local", "1": "grid"})),
    "coordinate_system_name": ProjectSetting(read=Field.name),
    "project_elevation": ProjectSetting("elevation_of_project", _number),
    "local_default_datum": ProjectSetting(read=Field.integer),
    "common_datum_reduction": ProjectSetting(read=_number),
    "scale_factor": ProjectSetting("scale", _positive),
    "geoid_height": ProjectSetting(read=_number),
    "geoid_modeling": ProjectSetting(read=Field.integer),
    "vert_defl_modeling": ProjectSetting(read=_off(DEFLECTIONS)),
    "vert_defl_north": ProjectSetting(read=_zero(DEFLECTIONS)),
    "vert_defl_east": ProjectSetting(read=_zero(DEFLECTIONS)),
    "coordinate_order": ProjectSetting("order", _one_of({"EN": "EN", "NE": "NE"})),
    "angle_station_order": ProjectSetting(
        "stations", _one_of({"At-From-To": "AtFromTo", "From-At-To": "FromAtTo"})
    ),
    "3D_input_mode": ProjectSetting(
        "distances",
        _one_of({"Slope/Zenith": "slope", "Hor Dist/DE": "horizontal"}),
    ),
    "index_of_refraction": ProjectSetting("refraction", _number),
    "earth_radius_meters": ProjectSetting("earth_radius", _positive),
    "longitude_convention": ProjectSetting(
        "longitude", _one_of({"0": "west positive", "1": "east positive"})
    ),
    "fixed_linear_std_err": ProjectSetting("fixed_length", _positive),
    "fixed_angular_std_err": ProjectSetting("fixed_angle", _positive),
    "gps_factor": ProjectSetting(read=Field.flag),
    "gps_factor_alt_vert": ProjectSetting(read=Field.flag),
    "gps_factor_horiz": ProjectSetting(read=_positive),
    "gps_factor_vert": ProjectSetting(read=_positive),
    "gps_centering": ProjectSetting(
        read=_off("centring of GPS vectors is not read; add it to their standard errors; valid: 0")
    ),
    "gps_transformations": ProjectSetting(
        read=_off("transformations of GPS vectors are not read; see add_frame; valid: 0")
    ),
    **dict.fromkeys(
        (
            # Numbers of the system before it had a name, and what belongs to a switch above.
            *("coordinate_projection", "coordinate_zone", "coordinate_system_use_wgs84"),
            *("utm_hemisphere", "coordinate_order_north", "geoid_file_select"),
            *("vert_defl_file_select", "gps_centering_alt_vert", "gps_centering_horiz"),
            *("gps_centering_vert", "gps_transform_type", "gps_transform_scale"),
            *("gps_transform_scale_flag", "gps_transform_scale_value"),
            "gps_transform_rotations",
            *(f"gps_transform_{a}rot{w}" for a in "neu" for w in ("", "_flag", "_value")),
            # Vectors without G2 are errors, and OPUS positions are not read.
            *(f"gps_defaults{w}" for w in ("", "_stderr", "_ppm", "_alt_vert")),
            *("gps_defaults_stderr_alt_vert", "gps_defaults_ppm_alt_vert"),
            *(f"opus_{k}{w}" for k in ("factor", "centering")
              for w in ("", "_alt_vert", "_horiz", "_vert")),
            *("gps_vector_serial_id", "gps_last_import_format"),
            # The solution.
            *("converge_limit", "maximum_iterations", "chi_sqr_percent_significance"),
            *("perform_error_propagation", "ell_percent_confidence"),
        ),
        UNUSED,
    ),
}  # fmt: skip
"""Rows of [Adjustment] by their keys."""
STANDARD_ERRORS = {
    "distance_std_err": ProjectSetting("distance", _at_least_zero),
    "edm_ppm": ProjectSetting("distance_ppm", _at_least_zero),
    "angle_std_err": ProjectSetting("angle", _at_least_zero),
    "direction_std_err": ProjectSetting("direction", _at_least_zero),
    "azimuth_std_err": ProjectSetting("azimuth", _at_least_zero),
    "zenith_std_err": ProjectSetting("zenith", _at_least_zero),
    "delta_elev_std_err": ProjectSetting("elevation", _at_least_zero),
    "delta_elev_ppm": ProjectSetting("elevation_ppm", _at_least_zero),
    "instrument_centering_error": ProjectSetting("centring_instrument", _at_least_zero),
    "target_centering_error": ProjectSetting("centring_target", _at_least_zero),
    "vertical_centering_error": ProjectSetting("centring_vertical", _at_least_zero),
}
"""Rows of an instrument of [InstrumentLibrary]."""
INSTRUMENT = {
    **STANDARD_ERRORS,
    "level_section_type": ProjectSetting(
        "weight_levels_by", _one_of({"LENGTH": "length", "TURNS": "turns"})
    ),
    "level_std_err": ProjectSetting("level", _at_least_zero),
}
"""Rows of [Instrument]."""


class _Project:
    """Rows of a project, as they are read."""

    def __init__(self, source: TextSource) -> None:
        self.source = source
        self.settings: dict[str, Any] = {}
        """Values of [Adjustment] and [Instrument] by their keys."""
        self.lines: dict[str, int] = {}
        """Lines of the keys of [Adjustment] and [Instrument]."""
        self.library: dict[str, dict[str, float]] = {}
        """Standard errors of instruments by name, then by their keys."""
        self.files: list[Path] = []
        """Data files that the project uses."""

    def read(self) -> None:
        """Read every row; what is wrong is noted."""
        begun: dict[str, int] = {}
        section, instrument = "", ""
        for line, text in self._rows():
            found = SECTION.fullmatch(text)
            if found is not None:
                section = found[1]
                if section in begun:
                    what = f"section [{section}] stands twice, first in line {begun[section]}"
                    self.source.wrong(line, what)
                begun.setdefault(section, line)
                if section in OUTPUT_SECTIONS:
                    self.source.leave_out(line, OUTPUT_SETTINGS, section)
                elif section not in ("Adjustment", "Instrument", *OTHER_SECTIONS):
                    valid = ("Adjustment", "Instrument", *OTHER_SECTIONS, *OUTPUT_SECTIONS)
                    self.source.field(line, section, "section").choice(dict.fromkeys(valid, 0))
                continue
            key, _, value = (part.strip() for part in text.partition(" "))
            if section == "DataFileList":
                self._data_file(line, text)
            elif section == "InstrumentLibrary":
                instrument = self._library_row(line, instrument, key, value)
            elif section in ("Adjustment", "Instrument"):
                table = ADJUSTMENT if section == "Adjustment" else INSTRUMENT
                self._row(line, table, key, value, self.settings)
                self.lines.setdefault(key, line)
            elif not section:
                self.source.wrong(line, "a row before the first section, such as [Adjustment]")
        for name, table in (("Adjustment", ADJUSTMENT), ("Instrument", INSTRUMENT)):
            where = begun.get(name, 0)
            self._demand(where, f"section [{name}]", table, self.settings)
        for name, errors in self.library.items():
            self._demand(self.lines[f"{name}\n"], f"instrument {name!r}", STANDARD_ERRORS, errors)
        if "DataFileList" not in begun or (not self.files and not self.source.problems.count):
            self.source.wrong(begun.get("DataFileList", 0), "uses no data file: [DataFileList]")

    def _rows(self) -> Iterator[tuple[int, str]]:
        """Yield the rows besides comments and the name of the program."""
        for line, text in self.source.filled():
            text = text.strip().replace("\t", " ")
            if not text.startswith(("#", HEADER)):
                yield line, text

    def _row(
        self,
        line: int,
        table: dict[str, ProjectSetting],
        key: str,
        value: str,
        into: dict[str, Any],
    ) -> None:
        setting = table.get(key)
        if setting is None and KEY.fullmatch(key):
            self.source.leave_out(line, UNKNOWN_SETTINGS, key)
        elif setting is None:
            what = f"{key[:40]!r} is no key; valid: words joined by _, such as edm_ppm"
            self.source.wrong(line, what)
        elif key in into:
            self.source.wrong(line, f"{key} stands twice in its section")
        else:
            field = self.source.field(line, value, key)
            into[key] = None if setting.read is None else setting.read(field)

    def _library_row(self, line: int, instrument: str, key: str, value: str) -> str:
        """Read a row of the library; return the instrument to which the next ones belong."""
        if key == "instrument_name":
            name = self.source.field(line, value, key).name()
            if name in self.library:
                self.source.wrong(line, f"instrument {name!r} stands twice")
            elif name:
                self.library[name] = {}
                self.lines[f"{name}\n"] = line
            return name
        if not self.library:
            self.source.wrong(line, "a row of the library before its first instrument_name")
        elif instrument:
            self._row(line, STANDARD_ERRORS, key, value, self.library[instrument])
        return instrument

    def _data_file(self, line: int, text: str) -> None:
        found = DATA_FILE.fullmatch(text)
        if found is None:
            what = (
                f'a data file is a number and a name, such as 3 "traverse.dat", not {text[:60]!r}'
            )
            self.source.wrong(line, what)
        elif not int(found[1]) & IS_USED:
            self.source.leave_out(line, UNUSED_FILES, found[2])
        else:
            place = self.source.place(line)
            file = self.source.attempt(line, inside, self.source.path.parent, found[2], place)
            if file is not None and not file.is_file():
                self.source.wrong(line, f"there is no data file {found[2]!r}")
            elif file is not None:
                self.files.append(file)

    def _demand(
        self, line: int, what: str, table: dict[str, ProjectSetting], given: dict[str, Any]
    ) -> None:
        missing = [k for k, setting in table.items() if setting.read is not None and k not in given]
        if missing:
            self.source.wrong(line, f"{what} lacks {', '.join(missing)}")

    # -- what the settings are --------------------------------------------------------------------

    def options(self) -> dict[str, Any]:
        """Return the settings as `StarNetOptions` names them; what is wrong is noted."""
        given = self.settings
        tables = {**ADJUSTMENT, **INSTRUMENT}
        out = {s.option: given[k] for k, s in tables.items() if s.option}
        if out["weight_levels_by"] == "length":
            unit = KILOMETRE_METRES if out["linear"] == "Meters" else MILE_FEET
            out["level"] *= math.sqrt(unit)
        out["instruments"] = {
            name: {s.option: errors[k] for k, s in STANDARD_ERRORS.items()}
            for name, errors in self.library.items()
        }
        if given["gps_factor"]:
            out["gps_factor"] = given["gps_factor_horiz"]
            vertical = "gps_factor_vert" if given["gps_factor_alt_vert"] else "gps_factor_horiz"
            out["gps_factor_vertical"] = given[vertical]
        if given["local_or_grid_adjustment"] == "grid" or given["adjustment_type"] == "LEV":
            out["scale"] = 1.0
        elif given["local_default_datum"] != 1:
            what = "local_default_datum: a common elevation of a local project is not read; valid: "
            self.source.wrong(self.lines["local_default_datum"], f"{what}1, a scale factor")
        return out

    def system(
        self, crs: ReferenceSystem | str | None, geoid: str | float | None
    ) -> ReferenceSystem | None:
        """Return the reference system of a project in a grid; None for a local one."""
        given = self.settings
        if given["local_or_grid_adjustment"] == "local" or given["adjustment_type"] == "LEV":
            if crs is not None or geoid is not None:
                line = self.lines["local_or_grid_adjustment"]
                self.source.wrong(line, "a local project has no reference system: crs= and geoid=")
            return None
        if crs is None:
            crs = star_net_system_code(given["coordinate_system_name"])
        if crs is None:
            name = given["coordinate_system_name"]
            what = f"coordinate system {name!r} is unknown: state crs=, such as EPSG:2953"
            self.source.wrong(self.lines["coordinate_system_name"], what)
            return None
        if geoid is None and given["geoid_modeling"]:
            what = "geoid_modeling: the project has a geoid model: state its file, geoid="
            self.source.wrong(self.lines["geoid_modeling"], what)
            return None
        return star_net_grid_system(crs, given["geoid_height"] if geoid is None else geoid)


OTHER_SECTIONS = ("InstrumentLibrary", "DataFileList")
"""Sections that are no tables of settings."""


def star_net_system_code(name: str) -> str | None:
    """Return the EPSG code of a coordinate system by its name in STAR*NET; None: unknown."""
    zone = re.fullmatch(r"UTM83(/CSRS)?-(\d{1,2})(N?)", name)
    if zone is None:
        code = NAMED_SYSTEMS.get(name)
    else:
        code = (CSRS_UTM if zone[1] else NAD83_UTM).get(int(zone[2]))
    return None if code is None else f"EPSG:{code}"


READER = Reader(
    "star-net-project",
    (".snproj", ".prj"),
    "STAR*NET project",
    NetworkReader(read_star_net_project),
    recognises=lambda path: BEGINNING.match(file_beginning(path)) is not None,
    own_grid=True,
)
