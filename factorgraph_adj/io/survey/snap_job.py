"""Job of SNAP: its stations, files, parameters, and the commands that concern them.

Format: LINZ, SNAP help, "Alphabetical list of commands", and ``control.c`` of the program (BSD-3).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..source import TextSource
from .snap_commands import Mode, StationCommand
from .snap_coordinates import SnapStations
from .snap_displacements import Displacements
from .snap_parameters import JobParameters
from .snap_readings import SnapSet
from .snap_recoding import Recodings
from .snap_selections import JobLine, ObservationTest


@dataclass(frozen=True)
class StationStatement:
    """A command that concerns stations, with the errors of floated ones in force there."""

    command: StationCommand
    at: JobLine
    horizontal: float
    vertical: float


@dataclass(frozen=True)
class ObservationStatement:
    """A command that concerns observations."""

    command: str
    test: ObservationTest
    factor: float = 1.0
    """Factor of errors; of an option 1 or 0, whether it holds; height of an antenna, metres; of a
    further error its standard deviation in plan, metres."""
    by_set: bool = False
    vertical: float = 0.0
    """Standard deviation in height of a further error, metres."""


@dataclass(frozen=True)
class DataFile:
    """An observation file of a job."""

    name: str
    """Its name in the job."""
    sets: tuple[SnapSet, ...]
    """What it has."""
    factor: float
    """Factor of its standard errors."""
    recodings: Recodings | None
    """Codes of its own."""


@dataclass
class SnapJob:
    """What the command file of a job states."""

    source: TextSource
    """The command file, with the problems of all files."""
    stations: SnapStations | None = None
    files: list[DataFile] = field(default_factory=list)
    mode: Mode = "adjustment"
    dimension: str = "3d"
    station_statements: list[StationStatement] = field(default_factory=list)
    observation_statements: list[ObservationStatement] = field(default_factory=list)
    parameters: JobParameters = field(default_factory=JobParameters)
    recodings: Recodings = field(default_factory=Recodings)
    ignore_all_missing: bool = False
    """Whether observations of unknown stations are left out."""
    ignored_codes: set[str] = field(default_factory=set)
    """Codes, in capital letters, of stations that may be unknown."""
    ratios: bool = True
    """Whether distance ratios have an unknown scale."""
    deformation: str = "datum"
    """Which deformation model applies: of the datum, none, or one that the job describes."""
    displacements: Displacements = field(default_factory=Displacements)
    """Where stations were at the dates of readings."""
    use_datum: bool = True
    """Whether projections of bearings must have the datum of the stations."""
