"""Reader of site files: networks of a site with their epochs, database, instruments, alarms."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar, cast, get_args

from ..errors import InputError, Problem, known
from ..instruments.instrument_settings import (
    InstrumentSettings,
    duration,
    read_instruments,
    refuse_names_twice,
)
from ..io.csv_tables import FieldRow, row_of_table, rows_of_tables
from ..io.text_files import read_toml
from ..ledger.verdicts import Policy
from ..statistical_tests import POWER_OF_TEST
from .alarm_notices import MailServer, read_mail_server
from .alarm_tables import SiteAlarm, read_alarms
from .epoch_schedule import EpochSchedule
from .retention_settings import RetentionSettings, read_retention

SITE_KEYS = ("site", "network", "instrument", "alarm", "smtp", "retention")
"""Tables of a site file."""
NETWORK_NAME = re.compile(r"[\w.~-]{1,100}", re.ASCII)
"""Names of networks stand in addresses."""
DEFAULT_ALPHA = 0.001
"""Probability of a false alarm of one test of an arriving observation."""
Clock: TypeAlias = Literal["machine", "readings"]
MAX_AHEAD: dict[Clock, float] = {"machine": 600.0, "readings": 366 * 86400.0}
"""Time by which a reading may be ahead of the clock where the site file states none, seconds: as in
databases of time series, and for networks that are played a year, beyond which it is an error."""
SITE_FILE = "site.toml"
"""Name of a site file in a folder."""
Found = TypeVar("Found")
DATABASE_FILE = "site.sqlite"
"""Name of the database where none is stated."""


@dataclass(frozen=True)
class NetworkSettings:
    """One network of a site."""

    name: str
    """Name, as in addresses."""
    project: Path
    """Its project, or a file of another format."""
    policy: Policy = "reject"
    """Treatment of observations beyond the critical value."""
    alpha: float = DEFAULT_ALPHA
    """Probability of a false alarm of the test of one arriving observation."""
    power: float = POWER_OF_TEST
    """Power of the test for smallest detectable errors."""
    epochs: EpochSchedule = field(default_factory=EpochSchedule)
    """When its epochs end."""
    reference: int | None = None
    """Number of the reference epoch; None: the first that is whole, see
    `factorgraph_adj.site.reference_epoch`."""
    objects: tuple[str, ...] = ()
    """Patterns of names of points that may move, such as ``D*``."""
    keep_seconds: float | None = None
    """Time for which observations of an open epoch are kept before they are retired, seconds."""
    reference_epochs: int = 1
    """Number of the first epochs whose mean is the reference."""
    clock: Clock = "machine"
    """Clock with which times of readings are compared: that of this machine, or in a network that
    is played, whose time runs ahead of it, that of its readings."""
    max_ahead: float = MAX_AHEAD["machine"]
    """Time by which a reading may be ahead of the clock, seconds; others are refused."""


@dataclass(frozen=True)
class SiteSettings:
    """What a site file says."""

    name: str
    """Name of the site."""
    path: Path
    """The file."""
    database: str
    """Path of a file, or address of a PostgreSQL database."""
    networks: tuple[NetworkSettings, ...]
    """Its networks."""
    instruments: tuple[InstrumentSettings, ...] = ()
    """Its instruments."""
    alarms: tuple[SiteAlarm, ...] = ()
    """Its alarms, with those who are told."""
    mail_server: MailServer | None = None
    """What sends messages by e-mail; None: nothing does."""
    retention: RetentionSettings = field(default_factory=RetentionSettings)
    """For how long things are kept."""


def read_site(path: str | Path) -> SiteSettings:
    """Return the settings of a site.

    Args:
        path: a site file, a folder that has one, or a project, which is a site of one network.

    Raises:
        InputError: all problems of the file.
    """
    settings, problems = site_and_problems(path)
    if problems:
        raise InputError(problems)
    return settings


def site_and_problems(path: str | Path) -> tuple[SiteSettings, list[Problem]]:
    """Return the settings of a site as far as they can be read, and all problems of its file.

    Tables of instruments and alarms that have problems are not in the settings; networks are, with
    the fields that are right.

    Args:
        path: as for `read_site`.

    Raises:
        InputError: there is no such file, or it is no TOML.
    """
    path = Path(path)
    if path.is_dir() and (path / SITE_FILE).exists():
        path = path / SITE_FILE
    if not path.exists():
        raise InputError(Problem("no such file or folder", str(path)))
    if path.is_dir() or path.suffix != ".toml" or not _is_site(path):
        return _site_of_project(path), []
    document, places = read_toml(path)
    problems: list[Problem] = []
    top = FieldRow(document, path.name, problems)
    for key in (k for k in document if k not in SITE_KEYS):
        top.wrong(f"unknown table {key!r}; valid: {known(SITE_KEYS, meant=key, most=20)}")
    name, database = path.resolve().parent.name, DATABASE_FILE
    site = row_of_table(document.get("site", {}), "site", path.name, problems)
    if site is not None:
        name = site.text("name", default=name, title=True) or ""
        database = site.text("database", default=database) or DATABASE_FILE
        site.refuse_left()
    rows = rows_of_tables(document.get("network"), "network", path.name, problems)
    networks = [_network(row, path.parent) for row in rows]
    names = [n.name for n in networks if n.name]
    refuse_names_twice(rows)
    if "network" not in document or document["network"] == []:
        top.wrong("no [[network]]: state at least one, with name and project")

    def read(key: str, reader: Callable[[object], Found], default: Found) -> Found:
        """Return what a further table states; its problems are noted."""
        try:
            return reader(document.get(key))
        except InputError as error:
            problems.extend(error.noted)
            return default

    def read_all(key: str, reader: Callable[[object], Sequence[Found]]) -> list[Found]:
        """Return what a list of tables states; of a list with problems, the tables without."""
        try:
            return [*reader(document.get(key))]
        except InputError as error:
            problems.extend(error.noted)
        good: list[Found] = []
        for table in _tables(document, key):
            with suppress(InputError):
                good += reader([table])
        return good

    where, folder = path.name, path.parent
    instruments = read_all(
        "instrument", lambda t: read_instruments(t, where=where, folder=folder, networks=names)
    )
    watched = [str(t["name"]) for t in _tables(document, "instrument") if "name" in t]
    alarms = read_all(
        "alarm",
        lambda t: read_alarms(
            t,
            where=where,
            networks=names,
            instruments=watched,
            folder=folder,
            mail="smtp" in document,
        ),
    )
    server = read("smtp", lambda t: read_mail_server(t, where), None)
    retention = read("retention", lambda t: read_retention(t, where), RetentionSettings())
    if "://" not in database:
        database = str(folder / database)
    settings = SiteSettings(
        *(name, path, database, tuple(networks)),
        *(tuple(instruments), tuple(alarms), server, retention),
    )
    return settings, places.in_order(problems)


def _is_site(path: Path) -> bool:
    """Return whether a TOML file states a site."""
    document, _ = read_toml(path)
    return "site" in document or "network" in document


def is_site(path: str | Path) -> bool:
    """Return whether a path is a site file, or a folder that has one.

    Raises:
        InputError: the file is no TOML.
    """
    path = Path(path)
    if path.is_dir():
        return (path / SITE_FILE).exists()
    return path.suffix == ".toml" and path.exists() and _is_site(path)


def _site_of_project(path: Path) -> SiteSettings:
    """Return the site of one project, with its database beside it."""
    folder = path if path.is_dir() else path.parent
    name = (path if path.is_dir() else path.parent if path.stem == "project" else path).resolve()
    plain = re.sub(r"[^\w.~-]+", "-", name.stem, flags=re.ASCII).strip("-") or "network"
    network = NetworkSettings(plain[:100], path)
    return SiteSettings(name.stem, path, str(folder / DATABASE_FILE), (network,))


def _tables(document: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    """Return the tables of a list of tables, whatever is wrong with them."""
    given = document.get(key)
    return [t for t in given if isinstance(t, dict)] if isinstance(given, list) else []


def _network(row: FieldRow, folder: Path) -> NetworkSettings:
    """Return the settings of a network; problems are noted in the row."""
    name = row.text("name", required=True) or ""
    if name and not NETWORK_NAME.fullmatch(name):
        row.wrong(f"name {name!r} stands in addresses: letters, digits, - _ . ~ alone")
    project = row.text("project", required=True) or ""
    path = folder / project
    if project and not path.exists():
        row.wrong(f"project {project!r}: no such file or folder")
    policy = row.choice("policy", get_args(Policy), "reject")
    alpha = row.number("alpha", positive=True)
    power = row.number("power", positive=True)
    alpha = DEFAULT_ALPHA if alpha is None else alpha
    power = POWER_OF_TEST if power is None else power
    if not alpha < power < 1.0:
        row.wrong(f"0 < alpha < power < 1 is needed, not alpha {alpha:g}, power {power:g}")
    epochs = EpochSchedule()
    try:
        epochs = EpochSchedule.of(row.text("epochs", default="by hand") or "by hand")
    except InputError as error:
        row.wrong_all(error)
    reference, keep = row.whole("reference"), row.number("keep_seconds", positive=True)
    several = row.whole("reference_epochs", least=1)
    objects = row.texts("objects", "names or patterns of points", '["D*", "E1"]')
    clock = cast(Clock, row.choice("clock", get_args(Clock), "machine"))
    ahead = _max_ahead(row, MAX_AHEAD[clock])
    row.refuse_left()
    return NetworkSettings(
        *(name, path, cast(Policy, policy), alpha, power, epochs),
        reference,
        objects or (),
        keep,
        several or 1,
        clock,
        ahead,
    )


def _max_ahead(row: FieldRow, default: float) -> float:
    """Return by how much readings may be ahead, seconds; problems are noted in the row."""
    given = row.take("max_ahead")
    try:
        found = default if given is None else duration(given)
    except ValueError as error:
        row.wrong(f"max_ahead {error}")
        return default
    if found < 0.0:
        row.wrong(f"max_ahead must not be negative, not {given!r}")
    return found
