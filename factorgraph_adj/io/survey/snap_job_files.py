"""Command file of SNAP (``.snp``): files, includes, mode, stations, parameters, selections.

Format: LINZ, SNAP help, "Alphabetical list of commands", and ``control.c`` of the program (BSD-3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ..source import Problems, TextSource, is_unread
from .snap_commands import (
    ANTENNA,
    CENTROID_ERROR,
    DEFORMING_DATUMS,
    DIMENSIONS,
    FURTHER_ERROR_UNITS,
    HARMLESS,
    INCLUDED_DEPTH,
    ITERATION,
    LISTING,
    MODES,
    OBSERVATION_COMMANDS,
    OBSERVATION_OPTIONS,
    OF_COMPUTATION,
    OF_LISTING,
    OFFSET_ERROR,
    REFUSED,
    STATION_COMMANDS,
    StationCommand,
)
from .snap_coordinates import SnapStations, read_coordinate_file
from .snap_csv_formats import CsvOptions, read_definition
from .snap_csv_observations import read_csv_observations
from .snap_csv_stations import read_csv_stations
from .snap_displacements import (
    read_offsets,
    read_velocities,
    refuse_other_datum,
)
from .snap_job import DataFile, ObservationStatement, SnapJob, StationStatement
from .snap_lines import found_file, read_epoch, records, words_of
from .snap_parameters import DEFAULT_REFRACTION
from .snap_readings import read_data_file
from .snap_recoding import Recodings
from .snap_selections import JobLine, observation_test
from .snap_sinex import SinexOptions, read_sinex_set


class _JobReader:
    """Reads command files."""

    def __init__(self, source: TextSource) -> None:
        """Start with the command file."""
        self.job = SnapJob(source)
        self.problems = source.problems
        self.horizontal, self.vertical = 1.0, 1.0
        self.default_refraction = DEFAULT_REFRACTION
        self.waiting: list[tuple[str, JobLine, Callable[[SnapStations], None]]] = []
        self.by_name: dict[str, Callable[[JobLine], None]] = {
            "deformation": self._deformation,
            "station_offset_file": self._offsets,
            "coordinate_file": self._coordinates,
            "add_coordinate_file": self._more_coordinates,
            "data_file": self._data,
            "include": self._include,
            "configuration": self._include,
            "mode": self._mode,
            "horizontal_float_error": self._horizontal,
            "vertical_float_error": self._vertical,
            "refraction_coefficient": lambda at: self.job.parameters.refraction.state(
                at, self.default_refraction
            ),
            "default_refraction_coefficient": self._default_refraction,
            "distance_scale_error": lambda at: self.job.parameters.distance_scale.state(at, 0.0),
            "bearing_orientation_error": lambda at: self.job.parameters.bearing_error.state(
                at, 0.0
            ),
            "reference_frame": self.job.parameters.state_frame,
            "classification": self._classification,
            "set_observation_option": self._option,
            "recode": self._recode,
            "ignore_missing_stations": self._missing,
            "use_distance_ratios": self._ratios,
            "proj_bearing_use_datum": self._use_datum,
            **{name: self._station_command(name) for name in STATION_COMMANDS},
            **{name: self._observation_command(name) for name in OBSERVATION_COMMANDS},
        }
        self.folders: list[Path] = []
        """Folders of the command files that are being read, the innermost first."""

    def read(self, source: TextSource) -> None:
        """Read a command file; what is wrong is noted."""
        self.folders.insert(0, source.path.parent)
        for line, text in records(source):
            words = words_of(text)
            name = words.pop(0).lower()
            at = JobLine(source, line, tuple(words))
            if name in LISTING or name in ITERATION:
                source.leave_out(line, OF_LISTING if name in LISTING else OF_COMPUTATION, name)
            elif name in REFUSED:
                if not words or words[0].lower() != HARMLESS.get(name):
                    stated = " ".join(words)[:40] or "no name"
                    source.wrong(line, f"{name}: {REFUSED[name].format(stated)}")
            else:
                act = source.field(line, name, "command").choice(self.by_name)
                if act is not None:
                    act(at)
        self.folders.pop(0)

    def finish(self) -> SnapJob:
        """Return the job, after what needs all files is read."""
        if self.job.stations is None:
            if not self.problems.count:
                self.job.source.wrong(0, "needs coordinate_file, the file of its stations")
            return self.job
        for _, _, act in self.waiting:
            act(self.job.stations)
        return self.job

    def refuse_deformation(self) -> None:
        """Refuse the deformation model that applies, if there is any."""
        stations, stated = self.job.stations, self.job.deformation
        if stations is None or stated.lower() == "none" or self.job.displacements.velocities:
            return
        model = DEFORMING_DATUMS.get(stations.system.datum, "")
        if stated.lower() != "datum":
            model = f"the deformation model {stated[:60]}"
        if model:
            self.job.source.wrong(
                0,
                f"{model} applies, which is not read; valid: observations of the epoch of the "
                "coordinates, with the command deformation none or the option deformation='none'",
            )

    # -- files ------------------------------------------------------------------------------------

    def _file(self, at: JobLine, suffix: str, what: str) -> Path | None:
        """Return the file of the first word."""
        if not at.words:
            at.wrong(f"{what} needs the name of a file")
            return None
        found = found_file(at.folder, at.words[0], suffix)
        if found is None:
            at.wrong(f"the {what} {at.words[0]!r} is not there; names count from {at.folder.name}/")
        return found

    def _only_file(self, at: JobLine, suffix: str, what: str) -> Path | None:
        """Return the file of the only word."""
        if len(at.words) > 1:
            at.wrong(f"the {what} is the only word, not {' '.join(at.words[1:])[:40]!r} behind it")
        return self._file(at, suffix, what)

    def _deformation(self, at: JobLine) -> None:
        """Take ``none``, ``datum``, or ``type=velocity model=FILE epoch=YEAR``."""
        self.job.deformation = " ".join(at.words)
        stated = {n.lower(): v for n, _, v in (word.partition("=") for word in at.words)}
        if stated.get("type", "").lower() != "velocity":
            return
        path = found_file(at.folder, stated.pop("model", ""), ".grd")
        epoch = read_epoch(at.source.field(at.line, stated.pop("epoch", None), "epoch"))
        if set(stated) != {"type"}:
            at.wrong("deformation must be none, datum, or type=velocity model=FILE epoch=YEAR")
        grid = read_velocities(at, path)
        if grid is not None and not is_unread(epoch):
            found = self.job.displacements
            found.velocities, found.epoch = grid, epoch
            self.waiting.append(
                ("deformation", at, lambda stations: refuse_other_datum(at, grid, stations))
            )

    def _offsets(self, at: JobLine) -> None:
        path = self._only_file(at, ".sto", "station offset file")
        if path is not None:
            found = self.job.displacements
            self.waiting.append(
                ("offsets", at, lambda stations: read_offsets(path, at, stations, found))
            )

    def _station_file(self, at: JobLine) -> SnapStations | None:
        """Return the stations of the file of the words ``FILE [csv [NAME=VALUE …]]``."""
        path = self._file(at, ".crd", "coordinate file")
        form, *more = at.words[1:] or ("",)
        options = CsvOptions()
        wrong = [word for word in more if not options.take(at, word)]
        if form.lower() not in ("", "csv") or wrong:
            at.wrong(
                f"coordinate_file as {' '.join((form, *wrong))[:40]!r} is not read; valid: the "
                "coordinate file of SNAP (.crd), or csv, format=NAME and options of the format"
            )
            return None
        if path is None or not form:
            return None if path is None else read_coordinate_file(path, self.problems)
        definition = read_definition(at, path, options, self.folders, "stn")
        return None if definition is None else read_csv_stations(path, definition)

    def _coordinates(self, at: JobLine) -> None:
        found = self._station_file(at)
        if found is None:
            return
        if self.job.stations is None:
            self.job.stations = found
        else:
            self._join(at, found, "stations")

    def _more_coordinates(self, at: JobLine) -> None:
        words = list(at.words)
        if "from" not in [w.lower() for w in words]:
            at.wrong("add_coordinate_file needs what it adds, 'from' and the name of a file")
            return
        where = [w.lower() for w in words].index("from")
        kinds, rest = [w.lower() for w in words[:where]], words[where + 1 :]
        valid = {k: k for k in ("stations", "coordinates", "classes", "existing_classes")}
        for kind in kinds:
            at.source.field(at.line, kind, "what add_coordinate_file adds").choice(valid)
        found = self._station_file(replace(at, words=tuple(rest)))
        if found is None:
            return
        if self.job.stations is None:
            at.wrong("add_coordinate_file comes after coordinate_file")
            return
        for kind in kinds:
            self._join(at, found, kind)

    def _join(self, at: JobLine, more: SnapStations, what: str) -> None:
        """Add stations of a further file, or change what is there."""
        stations = self.job.stations
        assert stations is not None
        if more.system.datum != stations.system.datum:
            at.wrong(
                f"coordinates in {more.system.code} and in {stations.system.code}: no "
                "transformation between datums is read"
            )
            return
        for code, station in more.by_code.items():
            own = stations.by_code.get(code)
            if own is None:
                if what == "stations":
                    stations.by_code[code] = station
            elif what == "coordinates":
                stations.by_code[code] = replace(station, classes=own.classes, name=own.name)
            elif what.endswith("classes"):
                known = dict(own.classes)
                changed = {
                    k: v for k, v in station.classes if k in known or what != "existing_classes"
                }
                stations.by_code[code] = replace(own, classes=tuple((known | changed).items()))

    def _data(self, at: JobLine) -> None:
        path = self._file(at, ".dat", "data file")
        words = list(at.words[1:])
        form = words[0].lower() if words else ""
        options = {"sinex": SinexOptions, "csv": CsvOptions}.get(form, lambda: None)()
        words = words if options is None else words[1:]
        factor, own = 1.0, None
        while words:
            word = words.pop(0)
            low = word.lower()
            if low == "error_factor":
                text = words.pop(0) if words else None
                factor = at.source.field(at.line, text, "error_factor").number(above=0.0)
            elif low == "recode" and words:
                own = Recodings()
                own.read_file(at, words.pop(0))
            elif options is None or not options.take(at, word):
                at.wrong(
                    f"data_file as {word[:40]!r} is not read; valid: the observation file of SNAP "
                    "(.dat), or sinex, code=, ref_frame=, date=, or csv, format=NAME and options "
                    "of the format; error_factor, recode"
                )
                return
        if path is None or is_unread(factor):
            return
        if isinstance(options, SinexOptions):
            sets = read_sinex_set(at, path, options)
        elif isinstance(options, CsvOptions):
            definition = read_definition(at, path, options, self.folders, "obs")
            sets = [] if definition is None else read_csv_observations(path, definition)
        else:
            sets = read_data_file(path, self.problems)
        self.job.files.append(DataFile(at.words[0], tuple(sets), factor, own))

    def _include(self, at: JobLine) -> None:
        path = self._only_file(at, ".inc", "included file")
        if path is None:
            return
        if len(self.folders) > INCLUDED_DEPTH:
            at.wrong(f"more than {INCLUDED_DEPTH} files include one another: {at.words[0]!r}")
            return
        self.read(TextSource(path, self.problems, code_page="cp1252"))

    # -- statements -------------------------------------------------------------------------------

    def _mode(self, at: JobLine) -> None:
        if not at.words:
            at.wrong(f"mode needs some of {', '.join((*DIMENSIONS, *MODES))}")
        for word in at.words:
            low = word.lower()
            if low in DIMENSIONS:
                self.job.dimension = DIMENSIONS[low]
            else:
                found = at.source.field(at.line, low, "mode").choice(MODES)
                self.job.mode = found or self.job.mode

    def _sigma(self, at: JobLine) -> float:
        text = " ".join(at.words)
        return at.source.field(at.line, text, "error of floated stations").sigma()

    def _horizontal(self, at: JobLine) -> None:
        self.horizontal = self._sigma(at)

    def _vertical(self, at: JobLine) -> None:
        self.vertical = self._sigma(at)

    def _default_refraction(self, at: JobLine) -> None:
        text = " ".join(at.words)
        value = at.source.field(at.line, text, "default_refraction_coefficient").number()
        self.default_refraction = self.job.parameters.refraction.default = value

    def _station_command(self, name: StationCommand) -> Callable[[JobLine], None]:
        def take(at: JobLine) -> None:
            self.job.station_statements.append(
                StationStatement(name, at, self.horizontal, self.vertical)
            )

        return take

    def _observation_command(self, name: str) -> Callable[[JobLine], None]:
        def take(at: JobLine) -> None:
            words, factor, by_set = list(at.words), 1.0, False
            if words and words[0].lower() in (OFFSET_ERROR, CENTROID_ERROR):
                self._further_error(at, words)
                return
            if name == "reweight_observations":
                by_set = bool(words) and words[0].lower() == "by_set"
                words = words[1:] if by_set else words
                text = words.pop(0) if words else None
                factor = at.source.field(at.line, text, "factor of errors").number(above=0.0)
            elif name == ANTENNA:
                text = words.pop(0) if words else None
                factor = at.source.field(at.line, text, "height of the antenna").number()
                unit = words.pop(0) if words else None
                at.source.field(at.line, unit, "unit of the height").word(("m",))
            self._add_observation_statement(at, name, words, factor, by_set)

        return take

    def _further_error(self, at: JobLine, words: list[str]) -> None:
        """Take ``reweight_observations offset_error H [V] m|mm criteria``."""
        name = words.pop(0).lower()
        end = next((i for i, w in enumerate(words) if w.lower() in FURTHER_ERROR_UNITS), 0)
        if end not in (1, 2):
            at.wrong(f"{name} needs one or two values and m or mm, such as {name} 0.01 0.02 m")
            return
        scale = FURTHER_ERROR_UNITS[words[end].lower()]
        fields = (at.source.field(at.line, word, name) for word in words[:end])
        values = [f.number(scale=scale, least=0.0) for f in fields]
        self._add_observation_statement(at, name, words[end + 1 :], values[0], False, values[-1])

    def _add_observation_statement(
        self,
        at: JobLine,
        name: str,
        words: Sequence[str],
        factor: float,
        by_set: bool,
        vertical: float = 0.0,
    ) -> None:
        files = [f.name for f in self.job.files]

        def act(stations: SnapStations) -> None:
            test = observation_test(at, words, stations, files)
            stated = ObservationStatement(name, test, factor, by_set, vertical)
            self.job.observation_statements.append(stated)

        self.waiting.append((name, at, act))

    def _classification(self, at: JobLine) -> None:
        """Take ``classification TYPE [ignore] [reject] NAME [error_factor VALUE]``."""
        words = list(at.words)
        class_name = words.pop(0) if words else ""
        actions = []
        while words and words[0].lower() in ("ignore", "reject"):
            actions.append(f"{words.pop(0).lower()}_observations")
        if not class_name or not words:
            at.wrong("classification needs a classification, ignore or reject, and a value")
            return
        value = words.pop(0)
        # A slash is a part of the value here.
        quote = "" if class_name.lower() in ("data_type", "data_file") else '"'
        criterion = [f"{class_name}={quote}{value}{quote}"]
        for name in actions:
            self._add_observation_statement(at, name, criterion, 1.0, False)
        if words and words[0].lower() == "error_factor":
            text = words[1] if len(words) > 1 else None
            factor = at.source.field(at.line, text, "error_factor").number(above=0.0)
            self._add_observation_statement(at, "reweight_observations", criterion, factor, False)
            words = words[2:]
        if words:
            at.wrong(f"classification: {words[0][:40]!r} is unknown; valid: error_factor")

    def _option(self, at: JobLine) -> None:
        """Take ``set_observation_option [no_]OPTION criteria``."""
        words = list(at.words)
        word = words.pop(0).lower() if words else ""
        option = word.removeprefix("no_")
        kind = at.source.field(at.line, option, "option").choice(OBSERVATION_OPTIONS)
        if kind is not None:
            criteria = [f"data_type={kind}", *words]
            factor = 0.0 if word.startswith("no_") else 1.0
            self._add_observation_statement(at, option, criteria, factor, False)

    def _recode(self, at: JobLine) -> None:
        self.job.recodings.state(at, self.waiting)

    def _missing(self, at: JobLine) -> None:
        codes = []
        stated = False
        for word in at.words:
            low = word.lower()
            if low in ("yes", "no"):
                self.job.ignore_all_missing = low == "yes"
                stated = True
            elif not low.startswith("report_"):
                codes.append(word.upper())
        self.job.ignored_codes |= set(codes)
        if not codes and not stated:
            self.job.ignore_all_missing = True

    def _ratios(self, at: JobLine) -> None:
        text = " ".join(at.words)
        self.job.ratios = at.source.field(at.line, text, "use_distance_ratios").flag()

    def _use_datum(self, at: JobLine) -> None:
        text = " ".join(at.words)
        self.job.use_datum = at.source.field(at.line, text, "proj_bearing_use_datum").flag()


def read_job(path: Path, problems: Problems, *, deformed: bool) -> SnapJob:
    """Return what a command file and all its files state; what is wrong is noted.

    Args:
        path: the command file.
        problems: gets what is wrong.
        deformed: whether a deformation model that applies is a problem.
    """
    source = TextSource(path, problems, code_page="cp1252")
    reader = _JobReader(source)
    reader.read(source)
    if deformed:
        reader.refuse_deformation()
    return reader.finish()
