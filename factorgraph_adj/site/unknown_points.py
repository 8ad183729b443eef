"""Names and patterns of a site file that match nothing, which would be of no effect in silence.

They are warnings: points may arrive later.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

from ..errors import Problem, known
from ..monitoring.alarm_rules import AlarmRule, matches
from .site_file import NetworkSettings, SiteSettings


def unknown_points(settings: SiteSettings, points: Mapping[str, Collection[str]]) -> list[Problem]:
    """Return names and patterns that match nothing.

    Args:
        settings: what the site file says.
        points: names of the points of each network; what is of others is passed over.
    """
    out: list[Problem] = []
    file = settings.path.name
    for network in (n for n in settings.networks if n.name in points):
        there = points[network.name]
        where = f"{file}: network {network.name!r}: objects"
        out += _unmatched(network.objects, there, where)
    of_network = {n.name: n for n in settings.networks}
    for alarm in (a for a in settings.alarms if a.network in points):
        where, rule = f"{file}: alarm {alarm.rule.name!r}: points", alarm.rule
        if isinstance(rule, AlarmRule) and rule.test != "congruence":
            out += _of_rule(rule, of_network[alarm.network], points[alarm.network], where)
    for instrument in (i for i in settings.instruments if i.network in points):
        where, there = f"{file}: instrument {instrument.name!r}", points[instrument.network]
        stated: dict[str, Iterable[str]] = {
            "station": [n for n in (instrument.station,) if n is not None],
            "targets": instrument.targets,
            "rename": instrument.rename.values(),
            "prisms": instrument.prisms.own,
            "target_heights": instrument.target_heights.own,
        }
        for what, names in stated.items():
            out += _unmatched(names, there, f"{where}: {what}")
    return out


def _of_rule(
    rule: AlarmRule, network: NetworkSettings, points: Collection[str], where: str
) -> Iterator[Problem]:
    """Yield patterns of a rule that match no point, or none that may move."""
    yield from _unmatched(rule.points, points, where)
    covered = [n for n in points if rule.covers(n)]
    if covered and network.objects and not any(matches(n, network.objects) for n in covered):
        what = f"{known(covered)} may not move, as the objects of the network are "
        yield Problem(f"{what}{known(network.objects)}: the rule tests nothing", where)


def _unmatched(patterns: Iterable[str], names: Collection[str], where: str) -> Iterator[Problem]:
    for pattern in patterns:
        if not any(matches(name, (pattern,)) for name in names):
            there = f"; there are {known(names, meant=pattern)}" if names else ""
            yield Problem(f"no point {pattern!r}{there}", where)
