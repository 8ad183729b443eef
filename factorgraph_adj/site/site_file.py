"""Reader of site files: networks of a site with their epochs, database, instruments, alarms."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

from ..errors import InputError, Problem, known
from ..instruments.instrument_settings import InstrumentSettings, read_instruments
from ..io.csv_tables import FieldRow
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
    """Number of the reference epoch; None: the first that was closed."""
    objects: tuple[str, ...] = ()
    """Patterns of names of points that may move, such as ``D*``."""
    keep_seconds: float | None = None
    """Time for which observations of an open epoch are kept before they are retired, seconds."""
    reference_epochs: int = 1
    """Number of the first epochs whose mean is the reference."""


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
    path = Path(path)
    if path.is_dir() and (path / SITE_FILE).exists():
        path = path / SITE_FILE
    if not path.exists():
        raise InputError(Problem("no such file or folder", str(path)))
    if path.is_dir() or path.suffix != ".toml" or not _is_site(path):
        return _site_of_project(path)
    document, places = read_toml(path)
    problems: list[Problem] = []
    top = FieldRow(document, path.name, problems)
    for key in (k for k in document if k not in SITE_KEYS):
        top.wrong(f"unknown key {key!r}; known: {known(SITE_KEYS, meant=key, most=20)}")
    given = document.get("site", {})
    site = FieldRow(given if isinstance(given, dict) else {}, f"{path.name}: [site]", problems)
    name = site.text("name", default=path.resolve().parent.name, title=True) or ""
    database = site.text("database", default=DATABASE_FILE) or DATABASE_FILE
    site_left(site)
    networks = [
        _network(FieldRow(record, f"{path.name}: [[network]] {n}", problems), path.parent)
        for n, record in enumerate(_records(document, "network", path.name, problems), 1)
    ]
    names = [n.name for n in networks]
    for twice in sorted({n for n in names if names.count(n) > 1}):
        top.wrong(f"two networks have the name {twice!r}")
    if not networks and not problems:
        top.wrong("no [[network]]: state at least one, with name and project")

    def read(key: str, reader: Callable[[object], Found], default: Found) -> Found:
        """Return what a further table states; its problems are noted."""
        try:
            return reader(document.get(key))
        except InputError as error:
            problems.extend(error.problems)
            return default

    where, folder = path.name, path.parent
    no_instruments: list[InstrumentSettings] = []
    no_alarms: list[SiteAlarm] = []
    instruments = read(
        "instrument",
        lambda t: read_instruments(t, where=where, folder=folder, networks=names),
        no_instruments,
    )
    alarms = read("alarm", lambda t: read_alarms(t, where=where, networks=names), no_alarms)
    server = read("smtp", lambda t: read_mail_server(t, where), None)
    retention = read("retention", lambda t: read_retention(t, where), RetentionSettings())
    if problems:
        raise InputError([places.placed(p) for p in problems])
    if "://" not in database:
        database = str(folder / database)
    return SiteSettings(
        *(name, path, database, tuple(networks)),
        *(tuple(instruments), tuple(alarms), server, retention),
    )


def _is_site(path: Path) -> bool:
    """Return whether a TOML file states a site."""
    document, _ = read_toml(path)
    return "site" in document or "network" in document


def _site_of_project(path: Path) -> SiteSettings:
    """Return the site of one project, with its database beside it."""
    folder = path if path.is_dir() else path.parent
    name = (path if path.is_dir() else path.parent if path.stem == "project" else path).resolve()
    plain = re.sub(r"[^\w.~-]+", "-", name.stem, flags=re.ASCII).strip("-") or "network"
    network = NetworkSettings(plain[:100], path)
    return SiteSettings(name.stem, path, str(folder / DATABASE_FILE), (network,))


def _records(
    document: Mapping[str, Any], key: str, name: str, problems: list[Problem]
) -> list[dict[str, Any]]:
    """Return the tables of a list of tables."""
    given = document.get(key, [])
    if not isinstance(given, list) or not all(isinstance(r, dict) for r in given):
        problems.append(Problem(f"{key} must be tables [[{key}]]", name))
        return []
    return given


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
    reference, keep = row.number("reference"), row.number("keep_seconds", positive=True)
    if reference is not None and (reference < 0 or not float(reference).is_integer()):
        row.wrong(f"reference {reference:g} is no number of an epoch: 0, 1, 2 …")
    several = row.number("reference_epochs", positive=True)
    if several is not None and not float(several).is_integer():
        row.wrong(f"reference_epochs {several:g} is no number of epochs: 1, 2, 3 …")
    objects = row.take("objects")
    if objects is not None and not (
        isinstance(objects, list) and all(isinstance(o, str) and o for o in objects)
    ):
        row.wrong('objects must be a list of names or patterns, such as ["D*"]')
        objects = None
    site_left(row)
    return NetworkSettings(
        *(name, path, cast(Policy, policy), alpha, power, epochs),
        None if reference is None else int(reference),
        tuple(cast(list[str], objects or ())),
        keep,
        1 if several is None else int(several),
    )


def site_left(row: FieldRow) -> None:
    """Note the fields of a table that nothing has read."""
    for name in row.left():
        valid = known(sorted(row.taken), meant=name, most=20)
        row.wrong(f"unknown key {name!r}; known: {valid}")
