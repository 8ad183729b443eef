"""Listed points: coordinates of a list that no observation concerns, which are no unknowns.

Lists of coordinates hold more points than were observed: old marks, control for later, the design
of a whole site. `with_listed_points_apart` moves those that nothing says anything about from the
points of a network to its ``listed_points``, where they keep what is stated of them; the adjustment
has no unknowns of them, a project that is written has them among its points again.

A point is listed if no observation, image point or unknown names it, some of its coordinates are
free, none is weighted, and it is no datum point. A datum point, and a station of which another
unknown is stated, are meant to take part: without an observation they are a problem.
"""

from __future__ import annotations

from ..models.unknown_registry import parameter_kinds
from ..network.network import Network
from .observation_selection import without


def listed_points(network: Network) -> list[str]:
    """Return the names of the points that only a list has."""
    loose = {
        name: None
        for name, p in network.points.items()
        if not all(p.fixed) and p.sigma is None and not p.datum
    }
    if not loose:
        return []
    names = list(network.points)
    for number in set(network.images.columns()[1].tolist()):
        loose.pop(names[number], None)
    for o in network.observations.values():
        if not loose:  # in most networks soon
            return []
        for name in o.points():
            loose.pop(name, None)
    for kind in parameter_kinds():
        for key, stated in network.of_kind(kind.name).items():
            loose.pop(stated.origin or "", None)
            if kind.at_point:
                loose.pop(key if isinstance(key, str) else key[0], None)
    return list(loose)


def with_listed_points_apart(network: Network) -> Network:
    """Return a network whose listed points are no unknowns; itself, if it has none.

    A network of which everything is listed stays as it is: it has nothing to adjust.
    """
    names = listed_points(network)
    if not names or len(names) == len(network.points):
        return network
    out = without(network, (), points=names)
    out.listed_points |= {name: network.points[name] for name in names}
    return out
