"""Mapping of an instrument to a network: the tables [[instrument]] of a site file.

    [[instrument]]
    name = "ts1"                       # of the instrument, in requests, sets and health
    network = "dam"
    source = "tcp://10.0.0.5:4001"     # see `line_sources`
    grammar = "gsi-online"             # see `grammars`; its options are further keys
    station = "P1"                     # where no line states the station
    instrument_height = 1.534          # m, where no line states it
    post = "sets"                      # or "sights": every sight at once
    targets = ["D1", "D2"]             # a set ends when these are read in all faces
    faces = 2                          # faces of a target in a set
    readings = 1                       # readings of a target in each face, one after the other
    set_pause = "5 min"                # pause that ends a set, whatever it lacks
    distance_meter = "edm"             # name in the network of scale and zero of distances
    refraction = "ts1"                 # name in the network of the coefficient of refraction
    only_targets = false               # true: sights of other targets are left out
    keep_lines = "ts1.lines"           # file of lines that are not posted yet, for a restart
    clock = "instrument"               # or "receipt", or "stated", see `message_rules`
    utc_offset = "1 h"                 # clock of the instrument minus UTC
    clock_tolerance = "5 s"
    late_after = "2 min"
    silent_after = "30 min"
    doubled_within = "2 s"
    [instrument.rename]                # names of the instrument = names of the network
    "101" = "D1"
    [instrument.prisms]                # mm, added to distances as they come, by name of the network
    default = 0.0
    D1 = -17.5
    [instrument.target_heights]        # m, where no line states them
    default = 0.0
    [instrument.accuracies]            # the fields of `factorgraph_adj.Accuracies`
    sigma_direction_mgon = 0.3
    [instrument.atmosphere]            # first velocity correction, see `distance_corrections`
    wavelength_nm = 658
    reference_index = 1.0002863
    temperature_c = 15.0
    pressure_hpa = 950.0
    humidity_percent = 60
    sensor = "weather"                 # an instrument whose lines have temperature and pressure
    max_age = "30 min"

Durations are texts with the units s, min, h, d, or numbers of seconds.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args

from ..errors import InputError, Problem, known
from ..io.csv_tables import FieldRow, rows_of_tables
from ..io.field_books.accuracies import DEFAULT_ACCURACIES, Accuracies
from ..io.format_options import fitting_options
from .distance_corrections import AtmosphereSettings
from .grammars import Grammar, grammar_record, grammar_words
from .line_sources import LineSource, line_source

ClockChoice = Literal["instrument", "receipt", "stated"]
PostChoice = Literal["sets", "sights"]
DURATION_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
"""Seconds of the units of durations."""
MAX_READINGS = 20
"""Largest number of readings of a target in each face of a set."""
MAX_DURATION_S = 400 * 86400.0
DEFAULT = "default"
"""Key of [instrument.prisms] and [instrument.target_heights] for all other targets."""
_DURATION = re.compile(r"([+-]?[0-9]+(?:\.[0-9]+)?)\s*(s|min|h|d)")


@dataclass(frozen=True)
class ByTarget:
    """A length for each target, metres."""

    default: float | None = None
    """That of targets which have none of their own."""
    own: Mapping[str, float] = field(default_factory=dict)
    """By name of the network."""

    def of(self, target: str) -> float:
        """Return that of a target; 0 without any."""
        return self.own.get(target, self.default or 0.0)


@dataclass(frozen=True)
class InstrumentSettings:
    """One table [[instrument]]; times in seconds, lengths in metres."""

    name: str
    network: str
    source: str
    grammar: str
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the grammar."""
    folder: Path = Path()
    """Folder of the site file."""
    station: str | None = None
    instrument_height: float | None = None
    post: PostChoice = "sets"
    targets: tuple[str, ...] = ()
    only_targets: bool = False
    faces: int = 2
    readings: int = 1
    set_pause: float = 300.0
    distance_meter: str | None = None
    refraction: str | None = None
    keep_lines: str | None = None
    clock: ClockChoice = "instrument"
    utc_offset: float = 0.0
    clock_tolerance: float = 5.0
    late_after: float = 120.0
    silent_after: float = 1800.0
    doubled_within: float = 2.0
    rename: Mapping[str, str] = field(default_factory=dict)
    prisms: ByTarget = field(default_factory=ByTarget)
    target_heights: ByTarget = field(default_factory=ByTarget)
    accuracies: Accuracies = DEFAULT_ACCURACIES
    atmosphere: AtmosphereSettings | None = None

    @property
    def keep_lines_at(self) -> Path:
        """File of the log of lines."""
        return self.folder / (self.keep_lines or "")

    def make_source(self) -> LineSource:
        """Return the source."""
        return line_source(self.source, self.folder)

    def make_grammar(self) -> Grammar:
        """Return a parser."""
        return grammar_record(self.grammar).parser(self.options)


DURATIONS = (
    *("set_pause", "utc_offset", "clock_tolerance", "late_after", "silent_after"),
    "doubled_within",
)
SECTIONS = ("rename", "prisms", "target_heights", "accuracies", "atmosphere")


def duration(text: object) -> float:
    """Return seconds.

    >>> duration("10 min"), duration(2.5)
    (600.0, 2.5)

    Raises:
        ValueError: the text is no duration.
    """
    if isinstance(text, int | float) and not isinstance(text, bool):
        found = float(text)
    else:
        match = _DURATION.fullmatch(text.strip()) if isinstance(text, str) else None
        if match is None:
            raise ValueError(f"must be a duration such as '10 min', '2 s' or '1 d', not {text!r}")
        found = float(match[1]) * DURATION_UNITS[match[2]]
    if not abs(found) <= MAX_DURATION_S:
        raise ValueError(f"must be at most 400 days, not {text!r}")
    return found


def read_instruments(
    tables: object, *, where: str, folder: Path = Path(), networks: Sequence[str] | None = None
) -> list[InstrumentSettings]:
    """Return the instruments of a site file.

    Args:
        tables: value of ``instrument`` in the document.
        where: name of the file; `factorgraph_adj.io.text_files.TomlPlaces` gives the lines.
        folder: folder of the file.
        networks: names of the networks of the site; None: any.

    Raises:
        InputError: all problems of all tables.
    """
    problems: list[Problem] = []
    rows = rows_of_tables(tables, "instrument", where, problems)
    out = [_instrument(row, folder, networks) for row in rows]
    names = [str(row.fields["name"]) for row in rows if "name" in row]
    refuse_names_twice(rows)
    # "a.log" and "./a.log" are one file.
    files = [Path(k) for row in rows if isinstance(k := row.fields.get("keep_lines"), str)]
    for row in rows:
        kept, air = row.fields.get("keep_lines"), row.fields.get("atmosphere")
        if isinstance(kept, str) and files.count(Path(kept)) > 1:
            row.wrong(f"keep_lines: {kept!r} is that of another instrument, too")
        sensor = air.get("sensor") if isinstance(air, dict) else None
        if sensor is not None and sensor not in names:
            listed = known(names, meant=sensor)
            row.wrong(f"sensor: there is no instrument {sensor!r}; known: {listed}")
    if problems:
        raise InputError(problems)
    return [settings for settings in out if settings is not None]


def refuse_names_twice(rows: Sequence[FieldRow]) -> None:
    """Note every table whose name an earlier one has."""
    first: dict[object, str] = {}
    for row in rows:
        name = row.fields.get("name")
        if isinstance(name, str) and name in first:
            row.wrong(f"name {name!r} stands twice: it is that of {first[name]}, too")
        elif isinstance(name, str):
            first[name] = row.of


def refuse_other_networks(row: FieldRow, name: str, networks: Sequence[str]) -> None:
    """Note a name of a network that the site does not have; nothing where it has none at all."""
    if networks and name not in networks:
        listed = known(dict.fromkeys(networks), meant=name)
        row.wrong(f"network: there is no network {name!r}; known: {listed}")


def _instrument(
    row: FieldRow, folder: Path, networks: Sequence[str] | None
) -> InstrumentSettings | None:
    """Return one table; None after problems, which are noted in the row."""
    out: dict[str, Any] = {"folder": folder}
    for name in ("name", "network", "source", "grammar"):
        out[name] = row.text(name, required=True) or ""
    if out["network"] and networks is not None:
        refuse_other_networks(row, out["network"], networks)
    for name in ("station", "distance_meter", "refraction", "keep_lines"):
        out[name] = row.text(name)
    out["instrument_height"] = row.number("instrument_height")
    out["post"] = row.choice("post", get_args(PostChoice), "sets")
    out["clock"] = row.choice("clock", get_args(ClockChoice), "instrument")
    out["only_targets"] = row.flag("only_targets")
    for name, most in (("faces", 2), ("readings", MAX_READINGS)):
        if (number := row.whole(name, least=1, most=most)) is not None:
            out[name] = number
    for name in DURATIONS:
        if (text := row.take(name)) is not None:
            try:
                out[name] = duration(text)
                if out[name] < 0 and name != "utc_offset":
                    row.wrong(f"{name} must not be negative")
            except ValueError as error:
                row.wrong(f"{name} {error}")
    out["targets"] = _names(row, "targets")
    if out["only_targets"] and not row.fields.get("targets"):
        row.wrong("only_targets needs targets")
    sections = {name: _section(row, name) for name in SECTIONS}
    out["rename"] = _renamed(row, sections["rename"])
    out["prisms"] = _by_target(row, sections["prisms"], "prisms", "mm")
    out["target_heights"] = _by_target(row, sections["target_heights"], "target_heights", "m")
    out["accuracies"] = _accuracies(row, sections["accuracies"])
    if row.take("atmosphere") is not None:
        inner = FieldRow(sections["atmosphere"], row.where, row.problems, f"{row.of}: atmosphere")
        out["atmosphere"] = AtmosphereSettings.read(inner, duration)
    out["options"] = _grammar_options(row, out["grammar"])
    if out["source"]:
        row.made(lambda: line_source(out["source"], folder), "source: ")
    return None if row.failed else InstrumentSettings(**out)


def _grammar_options(row: FieldRow, word: str) -> dict[str, Any]:
    """Return the options of the grammar: the keys that nothing else has taken."""
    record = row.made(lambda: grammar_record(word)) if word else None
    if record is None:
        # The keys of a grammar that is not known are not known either.
        every = [n for w in grammar_words() for n in grammar_record(w).options]
        for key in (k for k in row.left() if k in every):
            row.take(key)
        row.refuse_left()
        return {}
    given = {key: row.take(key) for key in row.left() if key in record.options}
    row.refuse_left(record.options)
    options = row.made(
        lambda: fitting_options(record.make, given, doing=f"grammar {word}", where="")
    )
    if options is not None:
        row.made(lambda: record.parser(options), f"grammar {word}: ")
    return options or {}


def _section(row: FieldRow, name: str) -> dict[str, Any]:
    found = row.take(name)
    if found is not None and not isinstance(found, dict):
        row.wrong(f"{name} must be a table [instrument.{name}]")
    return found if isinstance(found, dict) else {}


def _names(row: FieldRow, name: str) -> tuple[str, ...]:
    found = row.texts(name, "names", '["A", "B"]') or ()
    twice = sorted({n for n in found if found.count(n) > 1})
    if twice:
        row.wrong(f"{name}: {known(twice)} more than once")
    return found


def _renamed(row: FieldRow, given: Mapping[str, object]) -> dict[str, str]:
    """Return the names of the network by those of the instrument; no two become one."""
    first: dict[str, str] = {}
    for name, new in given.items():
        if not isinstance(new, str) or not new:
            row.wrong(f"rename: {name} must become a name, not {new!r}")
        elif new in first:
            row.wrong(f"rename: {first[new]!r} and {name!r} both become {new!r}")
        else:
            first[new] = name
    return {name: new for new, name in first.items()}


def _by_target(row: FieldRow, given: Mapping[str, object], name: str, unit: str) -> ByTarget:
    inner = FieldRow(given, row.where, row.problems, f"{row.of}: {name}")
    values = {key: inner.number(key, unit) for key in given}
    found = {key: v for key, v in values.items() if v is not None}
    return ByTarget(found.pop(DEFAULT, None), found)


def _accuracies(row: FieldRow, given: Mapping[str, Any]) -> Accuracies:
    valid = [f.name for f in fields(Accuracies) if f.name != "refraction"]
    for key in given:
        if key == "refraction":
            row.wrong("accuracies: refraction is of the network, not of an instrument")
        elif key not in valid:
            row.wrong(f"accuracies: unknown key {key!r}; valid: {known(valid, meant=key)}")
    stated = {k: v for k, v in given.items() if k in valid}
    found = row.made(lambda: Accuracies(**stated), "accuracies: ")
    return DEFAULT_ACCURACIES if found is None else found
