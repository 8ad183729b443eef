"""From groups of JAG3D to a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...errors import InputError, Problem
from ...network.network import Network
from ..collected import MOST_LISTED
from .jag3d_conversion import Conversion
from .jag3d_kinds import MAKE, STATE
from .jag3d_model import POINT_SIGMA, Deflection, Group, PointRow, Reduction, Row


def as_network(
    name: str,
    points: Sequence[PointRow],
    groups: Sequence[Group],
    *,
    deflections: Sequence[Deflection] = (),
    reduction: Reduction | None = None,
    point_sigma: float = POINT_SIGMA,
    problems: Sequence[Problem] = (),
    where: str,
) -> Network:
    """Return the network of groups of points and observations.

    Args:
        name: its name.
        points: the points.
        groups: the groups of observations; their names are sets of directions, distance meters
            and groups of refraction.
        deflections: deflections of the vertical.
        reduction: reductions that JAG3D applies.
        point_sigma: σ of stochastic points that state none, metres.
        problems: problems found so far.
        where: names of the files, for what concerns all of them.

    Raises:
        InputError: all problems.
    """
    made = Conversion(name, reduction or Reduction(), point_sigma, list(problems))
    made.add_points(points)
    made.add_deflections(deflections)
    for group in groups:
        _add_group(made, group)
    if not made.problems and not made.network.points:
        made.problems.append(Problem("there are no points", where))
    if made.problems:
        rest = len(made.problems) - MOST_LISTED
        more = [Problem(f"and {rest} further problems", where)] if rest > 0 else []
        raise InputError([*made.problems[:MOST_LISTED], *more])
    return made.network


def _add_group(made: Conversion, group: Group) -> None:
    """Add the observations of a group, and its parameters."""
    a = group.uncertainty[0]
    if not a > 0 or any(not part >= 0 for part in group.uncertainty):
        what = f"group {group.name!r}: the constant part of σ must be > 0, the others ≥ 0"
        made.refuse(what, group.source)
        return
    make = MAKE[group.kind.name]
    before = len(made.problems)
    STATE[group.kind.name](made, group)
    if len(made.problems) > before:
        return
    for row in group.rows:
        if _ends(made, group, row):
            made.attempt(
                row.source,
                lambda row=row: made.network.add(make(made, group, row)),  # type: ignore[misc]
            )


def _ends(made: Conversion, group: Group, row: Row) -> bool:
    """Return whether both points of a row are known and may have such an observation."""
    valid = group.kind.dimensions
    good = True
    for name in (row.start, row.end):
        point = made.rows.get(name)
        if point is None:
            made.refuse(f"unknown point {name!r}: no file or group of points has it", row.source)
            good = False
        elif point.dimension not in valid:
            what = (
                f"{group.kind.name} join points of {' or '.join(map(str, valid))} dimensions, "
                f"{name!r} has {point.dimension}: JAG3D leaves this row out"
            )
            made.refuse(what, row.source)
            good = False
    return good


def with_set_names(groups: Sequence[Group]) -> list[Group]:
    """Return the groups with names of which none stands twice."""
    seen: dict[str, int] = {}
    out = []
    for group in groups:
        seen[group.name] = n = seen.get(group.name, 0) + 1
        out.append(group if n == 1 else replace(group, name=f"{group.name} ({n})"))
    return out
