"""Tables ``[[alarm]]`` of a site file: rules of monitoring, silent instruments, who is told.

    [[alarm]]
    name = "crest"
    network = "dam"
    test = "displacement"            # velocity, cusum, congruence; silence of instruments
    points = ["D*"]                  # names or patterns; of silence: names of instruments
    k = 2                            # in k of the last n epochs
    n = 3
    false_alarms_per_month = 0.1
    after = "30 min"                 # of silence: time without a line, also a number of seconds
    notify = ["mailto:chief@example.org", "https://example.org/hook", "mqtt://127.0.0.1/alarms"]

``env:NAME`` is an address that stands in an environment variable, such as that of a webhook whose
path is a secret. The other keys are those of `factorgraph_adj.monitoring.alarm_rules.AlarmRule`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ..errors import InputError, Problem, known, similar
from ..instruments.instrument_settings import (
    duration,
    refuse_names_twice,
    refuse_other_networks,
)
from ..instruments.mqtt import mqtt_address
from ..io.csv_tables import FieldRow, rows_of_tables
from ..monitoring.alarm_rules import AlarmRule, matches

ADDRESSES = {
    "mailto": "mailto:NAME@HOST",
    "http": "http://HOST/PATH",
    "https": "https://HOST/PATH",
    "mqtt": "mqtt://HOST/TOPIC",
    "mqtts": "mqtts://HOST/TOPIC",
    "env": "env:VARIABLE",
}
"""Forms of the addresses that are told of alarms, by scheme."""
SILENCE = "silence"
"""Test of a rule that watches instruments."""
_VARIABLE = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_HOST = re.compile(r"//(?:[^/?#]*@)?((?:\[[\d:.a-fA-F]*\]|[\w.-]*)(?::\d+)?)")
"""Host and port; what else stands there may be a secret."""
_MAIL = re.compile(r"[^@\s,]+@[^@\s,]+(,[^@\s,]+@[^@\s,]+)*")
DEFAULT_SILENCE = 1800.0
"""Time without a line after which an instrument is silent, seconds."""


@dataclass(frozen=True)
class SilenceRule:
    """Raises an alarm when an instrument is silent."""

    name: str
    """Name of the rule."""
    instruments: tuple[str, ...] = ("*",)
    """Names or patterns of instruments."""
    after: float = DEFAULT_SILENCE
    """Time without a line, seconds."""

    def covers(self, instrument: str) -> bool:
        """Whether the rule watches an instrument."""
        return matches(instrument, self.instruments)


@dataclass(frozen=True)
class SiteAlarm:
    """A rule with its network and those who are told."""

    rule: AlarmRule | SilenceRule
    """The rule."""
    network: str
    """Name of the network; of a silent instrument nothing stands for all networks."""
    notify: tuple[str, ...] = ()
    """Addresses that are told."""


def read_alarms(
    tables: object,
    *,
    where: str,
    networks: Sequence[str],
    instruments: Sequence[str] = (),
    folder: Path = Path(),
    mail: bool = True,
) -> list[SiteAlarm]:
    """Return the alarms of a site file.

    Args:
        tables: value of ``alarm`` in the document.
        where: name of the file.
        networks: names of the networks of the site.
        instruments: names of the instruments of the site.
        folder: folder of the site file, for files with passwords.
        mail: whether the site file has a mail server.

    Raises:
        InputError: all problems of all tables.
    """
    problems: list[Problem] = []
    rows = rows_of_tables(tables, "alarm", where, problems)
    out = []
    for row in rows:
        silence = row.fields.get("test") == SILENCE
        network = _network(row, networks, needed=not silence)
        notify = row.texts("notify", "addresses", '["mailto:chief@example.org"]') or ()
        for address in notify:
            row.made(partial(check_address, address, folder, mail), "notify: ")
        rule = _silence(row, instruments) if silence else AlarmRule.of_row(row, (SILENCE,))
        row.refuse_left()
        if rule is not None:
            out.append(SiteAlarm(rule, network, notify))
    refuse_names_twice(rows)
    if problems:
        raise InputError(problems)
    return out


def _network(row: FieldRow, networks: Sequence[str], *, needed: bool) -> str:
    """Return the network of an alarm; the only one of the site need not be stated."""
    only = networks[0] if len(set(networks)) == 1 else ""
    name = row.text("network", default=only) or ""
    if name:
        refuse_other_networks(row, name, networks)
    elif needed and networks and "network" not in row:
        row.wrong(f"network is missing; known: {known(dict.fromkeys(networks))}")
    return name


def shown_address(address: str) -> str:
    """Return an address without what may be a secret: that of a webhook stands in its path.

    >>> shown_address("https://example.org/hooks/T0/B0"), shown_address("mailto:chief@example.org")
    ('https://example.org/…', 'mailto:chief@example.org')
    """
    scheme, colon, rest = address.partition(":")
    if scheme in ("mailto", "env"):
        return address
    if not colon:
        return address if _MAIL.fullmatch(address) else "…"
    host = _HOST.match(rest)
    return f"{scheme[:10]}:…" if host is None else f"{scheme[:10]}://{host[1]}/…"


def check_address(address: str, folder: Path = Path(), mail: bool = True) -> None:
    """Check an address that is told of alarms; messages have no secret of it.

    Args:
        address: the address.
        folder: folder of the site file, for files with passwords.
        mail: whether the site file has a mail server.

    Raises:
        InputError: what is wrong with it.
    """
    scheme, colon, rest = address.partition(":")
    shown = shown_address(address)
    if not colon or scheme not in ADDRESSES:
        valid = ", ".join(dict.fromkeys(ADDRESSES.values()))
        plain = f"mailto:{address}" if _MAIL.fullmatch(address) else ""
        meant = f"; did you mean {plain!r}?" if plain else similar(scheme, ADDRESSES)
        raise InputError(f"{shown!r} is no address; valid: {valid}{meant}")
    if scheme == "env":
        if not _VARIABLE.fullmatch(rest):
            raise InputError(f"{shown!r} names no environment variable; valid: {ADDRESSES[scheme]}")
        return
    try:
        parts = urlsplit(address)
        host = parts.hostname if parts.port != 0 else None
    except ValueError:
        host = None
    if scheme == "mailto" and not _MAIL.fullmatch(unquote(rest)):
        raise InputError(f"{shown!r} is no address of e-mail; valid: {ADDRESSES[scheme]}")
    if scheme == "mailto" and not mail:
        raise InputError(
            f"{shown!r} needs a mail server, which the file does not have: write a table [smtp] "
            "with host and sender"
        )
    if scheme in ("http", "https"):
        if not host or not address.isascii() or not address.isprintable() or " " in address:
            raise InputError(f"{shown!r} is no address; valid: {ADDRESSES[scheme]}")
        if parts.username is not None:
            what = "a user and a password before the host are not sent: a secret stands in the path"
            raise InputError(f"{shown!r}: {what}")
    if scheme in ("mqtt", "mqtts"):
        topics = mqtt_address(address, folder).topics
        if wild := [t for t in topics if "+" in t or "#" in t]:
            raise InputError(f"{wild[0]!r} is no topic of a message: + and # are for subscriptions")


def _silence(row: FieldRow, instruments: Sequence[str]) -> SilenceRule | None:
    """Return a rule about silent instruments; None after problems, which are noted."""
    name, _ = row.text("name", required=True), row.take("test")
    stated = row.texts("points", "names or patterns of instruments", '["ts*"]')
    for pattern in stated or ():
        if not any(matches(own, (pattern,)) for own in instruments):
            listed = known(instruments, meant=pattern)
            row.wrong(f"points: there is no instrument {pattern!r}; known: {listed}")
    after = DEFAULT_SILENCE
    if (text := row.take("after")) is not None:
        try:
            after = duration(text)
            if after <= 0.0:
                row.wrong(f"after must be greater than zero, not {text!r}")
        except ValueError as error:
            row.wrong(f"after {error}")
    if row.failed or name is None:
        return None
    return SilenceRule(name, ("*",) if stated is None else stated, after)
