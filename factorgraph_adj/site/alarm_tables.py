"""Tables ``[[alarm]]`` of a site file: rules of monitoring, silent instruments, who is told.

    [[alarm]]
    name = "crest"
    network = "dam"
    test = "displacement"            # velocity, cusum, congruence; silence of instruments
    points = ["D*"]                  # names or patterns; of silence: names of instruments
    k = 2                            # in k of the last n epochs
    n = 3
    false_alarms_per_month = 0.1
    notify = ["mailto:chief@example.org", "https://example.org/hook", "mqtt://127.0.0.1/alarms"]

The other keys are those of `factorgraph_adj.monitoring.alarm_rules.AlarmRule`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from ..errors import InputError, Problem, known
from ..monitoring.alarm_rules import AlarmRule, matches

SCHEMES = ("mailto", "http", "https", "mqtt", "mqtts")
"""Schemes of addresses that are told of alarms."""
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


def read_alarms(tables: object, *, where: str, networks: Sequence[str]) -> list[SiteAlarm]:
    """Return the alarms of a site file.

    Args:
        tables: value of ``alarm`` in the document.
        where: name of the file.
        networks: names of the networks of the site.

    Raises:
        InputError: all problems of all tables.
    """
    if tables is None:
        return []
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise InputError(Problem("alarms must be tables [[alarm]]", where))
    out: list[SiteAlarm] = []
    problems: list[Problem] = []
    for number, table in enumerate(tables, 1):
        place = f"{where}: [[alarm]] {table.get('name', number)!r}"
        try:
            out.append(_alarm(table, networks))
        except InputError as error:
            problems += [Problem(p.what, place) for p in error.problems]
    names = [a.rule.name for a in out]
    problems += [
        Problem(f"two alarms have the name {name!r}", where)
        for name in sorted({n for n in names if names.count(n) > 1})
    ]
    if problems:
        raise InputError(problems)
    return out


def _alarm(table: Mapping[str, Any], networks: Sequence[str]) -> SiteAlarm:
    """Return one alarm."""
    record = dict(table)
    problems: list[Problem] = []
    network = record.pop("network", networks[0] if len(networks) == 1 else "")
    silence = record.get("test") == "silence"
    if network not in networks and not (silence and network == ""):
        problems.append(Problem(f"no network {network!r}; known: {known(networks)}"))
    notify = record.pop("notify", [])
    if not isinstance(notify, list) or not all(isinstance(a, str) for a in notify):
        problems.append(Problem('notify must be a list of addresses, such as ["mailto:a@b.org"]'))
        notify = []
    for address in notify:
        try:
            parts = urlsplit(address)
        except ValueError:
            parts = urlsplit("")
        if parts.scheme not in SCHEMES or not (parts.netloc or parts.path):
            what = f"{address!r} is no address of {', '.join(SCHEMES)}"
            problems.append(Problem(what))
    rule: AlarmRule | SilenceRule | None = None
    try:
        rule = _silence(record) if silence else AlarmRule.of_record(record)
    except InputError as error:
        problems += error.problems
    if problems or rule is None:
        raise InputError(problems)
    return SiteAlarm(rule, str(network), tuple(notify))


def _silence(record: Mapping[str, Any]) -> SilenceRule:
    """Return a rule about silent instruments."""
    keys = ("name", "test", "points", "after")
    problems = [
        Problem(f"unknown field {k!r}; valid: {known(keys, meant=k)}")
        for k in record
        if k not in keys
    ]
    name, points = record.get("name"), record.get("points", ["*"])
    after = record.get("after", DEFAULT_SILENCE)
    if not isinstance(name, str) or not name:
        problems.append(Problem("has no name"))
    if not isinstance(points, list) or not all(isinstance(p, str) for p in points):
        problems.append(Problem("points must be a list of names of instruments"))
    if isinstance(after, bool) or not isinstance(after, int | float) or not after > 0:
        problems.append(Problem(f"after must be a positive number of seconds, not {after!r}"))
    if problems:
        raise InputError(problems)
    return SilenceRule(str(name), tuple(points), float(after))
