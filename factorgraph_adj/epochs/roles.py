"""What each point is in a comparison of two epochs: reference, object, held, or not compared.

One rule for every network: a point that both epochs determine and that is not named as an object
is a reference point. Reference points are tested together, and those that moved leave. It does not
matter whether held points, observations of coordinates or nothing at all carries the datum: a test
of each point against the datum alone would see as little as the datum is worth, whatever the
points tell of each other. Points that both epochs hold are part of every reference, untested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, Problem
from ..graph.variables import Variables
from ..solve.solution import Solution
from ..types import Array, Mask

ONE_EPOCH_ALONE = ("in the first epoch alone", "in the second epoch alone")
"""Why points are not compared that the other epoch lacks."""
LEFT_OUT = (
    "left out of the first epoch as undetermined",
    "left out of the second epoch as undetermined",
)
"""Why points are not compared that were left out of an epoch, see `determined_part`."""
HELD_IN_ONE = ("held in the first epoch alone", "held in the second epoch alone")
"""Why points are not compared that one epoch holds and the other determines."""
NOT_NAMED = "neither named as reference nor as object"
"""Why points are not compared if both are named."""


@dataclass(frozen=True)
class Roles:
    """Points of a comparison, by their names in the first epoch."""

    reference: tuple[str, ...]
    """Reference points: tested for a change of their shape."""
    objects: tuple[str, ...]
    """Points that are tested each against the stable reference points."""
    held: Mapping[str, Array]
    """Points that both epochs hold, which are part of the reference without a test: coordinates of
    the second epoch less those of the first, (3,) metres."""
    not_compared: Mapping[str, str]
    """Why other points are not compared, by their names; of the second epoch for those that the
    first lacks."""


def roles_of(
    first: Solution,
    second: Solution,
    reference: Sequence[str] | None,
    objects: Sequence[str] | None,
    pairs: Mapping[str, str],
) -> Roles:
    """Return what the points of two adjustments are.

    Args:
        first: solution of the first epoch.
        second: solution of the second epoch.
        reference: the reference points; None: all points that both epochs determine, without the
            objects.
        objects: the objects; None: without ``reference`` none, and otherwise all other points that
            both epochs determine.
        pairs: names in the second epoch by names in the first, where they differ.

    Raises:
        InputError: a point is named as reference and as object; names are no list.
    """
    one, two = first.equations.unknowns["point"], second.equations.unknowns["point"]
    later = {n: pairs.get(n, n) for n in one.names}
    gone = [
        [x.name for x in s.network.unknowns_left_out if x.kind == "point"] for s in (first, second)
    ]
    left_out: dict[str, str] = {}
    both: list[str] = []
    held: dict[str, Array] = {}
    for name, other in later.items():
        if other not in two.number:
            left_out[name] = LEFT_OUT[1] if other in gone[1] else ONE_EPOCH_ALONE[0]
            continue
        here, there = _free(one, name), _free(two, other)
        if here.any() and there.any():
            both.append(name)
        elif here.any() or there.any():
            left_out[name] = HELD_IN_ONE[int(here.any())]
        else:
            place = first.state["point"][one.number[name]]
            held[name] = second.state["point"][two.number[other]] - place
    reached = set(later.values())
    earlier = {b: a for a, b in pairs.items()}
    left_out |= {
        n: LEFT_OUT[0] if earlier.get(n, n) in gone[0] else ONE_EPOCH_ALONE[1]
        for n in two.names
        if n not in reached
    }
    left_out |= {n: LEFT_OUT[0] for n in gone[0] if pairs.get(n, n) in gone[1]}
    named = {*_listed("reference", reference), *_listed("objects", objects)}
    rest = tuple(n for n in both if n not in named)
    some = rest if reference is None else tuple(reference)
    if objects is not None:
        others = tuple(objects)
    else:
        others = () if reference is None else rest
    refuse_two_roles(some, others)
    compared = {*some, *others}
    left_out |= {n: NOT_NAMED for n in both if n not in compared}
    return Roles(tuple(dict.fromkeys(some)), tuple(dict.fromkeys(others)), held, left_out)


def roles_in_one(
    solution: Solution,
    reference: Sequence[str] | None,
    objects: Sequence[str] | None,
    pairs: Mapping[str, str] | None,
) -> Roles:
    """Return what the points of one adjustment of both epochs are.

    Points that stand once are the reference, and hold it as all observations together tell.

    Raises:
        InputError: no pairs, or points without a second place; as `roles_of`.
    """
    some, named = _listed("reference", reference), _listed("objects", objects)
    if not pairs:
        raise InputError(
            "one solution of both epochs needs pairs: names of the second places by names of "
            "the first"
        )
    others = tuple(named if objects is not None else [n for n in pairs if n not in some])
    missing = [n for n in (*some, *others) if n not in pairs]
    if missing:
        raise InputError(Problem("has no second place in pairs", f"point {n!r}") for n in missing)
    refuse_two_roles(some, others)
    compared = {*some, *others}
    left_out = {n: NOT_NAMED for n in pairs if n not in compared}
    return Roles(tuple(dict.fromkeys(some)), tuple(dict.fromkeys(others)), {}, left_out)


def refuse_two_roles(reference: Sequence[str], objects: Sequence[str]) -> None:
    """Raise the points that are named as reference and as object.

    Raises:
        InputError: there are such points.
    """
    twice = [n for n in dict.fromkeys(reference) if n in objects]
    if twice:
        raise InputError(
            Problem("is named as reference and as object", f"point {n!r}") for n in twice
        )


def _listed(what: str, given: Sequence[str] | None) -> tuple[str, ...]:
    if isinstance(given, str):
        raise InputError(f"{what} must be a list of names, not the one name {given!r}")
    return tuple(given or ())


def _free(table: Variables, name: str) -> Mask:
    return np.asarray(table.free[table.number[name]])
