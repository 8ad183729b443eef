"""Variables on which observations depend, in one network or two; their free components."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from itertools import chain
from typing import TypeAlias

import numpy as np

from ..entities import FREE_ORIENTATION, Parameter, parameter_name
from ..errors import Problem
from ..frames import LocalFrame
from ..models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind
from ..network.additions import UnknownsGiven
from ..network.network import Network
from ..observations import KINDS, Observation, observation_kind
from ..types import Array
from .block_construction import ABSENT, attribute_keys, variable_name
from .variables import camera_of_calibration

Variable: TypeAlias = tuple[VariableKind, str]
"""Kind and name."""
TRIANGLE = np.array([[0.0, 0.0, 0.0], [60.0, 80.0, 25.0], [-70.0, 45.0, 10.0]])
"""Points of a sight, metres, for which it is worked out which verticals it notices."""
ROUNDING = 1e-9
"""Largest partial by a vertical, metres or radians per radian, that is nothing but rounding."""


def variables_of(network: Network, o: Observation) -> Iterator[Variable]:
    """Return what an observation depends on: verticals only where their partials are not zero."""
    kind = o.record
    upright: frozenset[str] = frozenset()
    if network.verticals and kind.model is not None:
        raised = tuple(bool(np.any(getattr(o, c))) for c in kind.constants)
        upright = _upright(kind.name, raised)
    for what, attribute in kind.variables:
        if what == "vertical" and attribute in upright:
            continue
        name = variable_name(network, what, attribute, o)
        if name != ABSENT or what not in ENTITIES:
            yield what, name
    yield from ((what, parameter_name(key)) for what, key in o.further)


def variables_of_each(
    network: Network, observations: Sequence[Observation]
) -> list[tuple[Variable, ...]]:
    """Return what each of many observations depends on, as `variables_of` does, each once.

    Names are looked up once for all observations of a kind in which the same attributes are equal.
    """
    groups: dict[str, list[int]] = {}
    for i, o in enumerate(observations):
        groups.setdefault(o.kind, []).append(i)
    out: list[tuple[Variable, ...]] = [()] * len(observations)
    for name, places in groups.items():
        own = [observations[i] for i in places]
        kind = observation_kind(name)
        alike = not (network.verticals and kind.model is not None)
        if alike and kind.variables and not any(o.further for o in own):
            columns = (variables_by_attribute(network, *v, own) for v in kind.variables)
            for i, row in zip(places, zip(*columns, strict=True), strict=True):
                out[i] = tuple(dict.fromkeys(v for v in row if v is not None))
        else:
            for i, o in zip(places, own, strict=True):
                out[i] = tuple(dict.fromkeys(variables_of(network, o)))
    return out


def variables_by_attribute(
    network: Network, what: VariableKind, attribute: str, observations: Sequence[Observation]
) -> list[Variable | None]:
    """Return the variable to which an attribute of each observation refers; none: it is absent."""
    found: dict[object, Variable | None] = {}
    keys = attribute_keys(what, attribute, observations)
    for key, o in dict(zip(keys, observations, strict=True)).items():
        name = variable_name(network, what, attribute, o)
        found[key] = (what, name) if name != ABSENT or what not in ENTITIES else None
    return [found[key] for key in keys]


@cache
def _upright(name: str, raised: tuple[bool, ...]) -> frozenset[str]:
    """Return the points of a kind of observation whose verticals it does not notice.

    A slope distance between the marks themselves is the same in every horizon: its partials by
    verticals are nothing but rounding. They are worked out for one sight. The vertical at the
    origin of a frame counts always: it matters where the frame is level.

    Args:
        name: of the kind.
        raised: which of its constants, the heights of instrument and target, are not zero.
    """
    kind = KINDS[name]
    if not any(what == "vertical" and "." not in a for what, a in kind.variables):
        return frozenset()
    points = [attribute for what, attribute in kind.variables if what == "point"]
    values = [
        TRIANGLE[[points.index(attribute)]] if what == "point" else _zero(what)
        for what, attribute in kind.variables
    ]
    heights = {c: np.array([float(on)]) for c, on in zip(kind.constants, raised, strict=True)}
    assert kind.model is not None
    partials = kind.model(LocalFrame(), *values, observed=np.zeros((1, 1)), **heights).jacobians
    return frozenset(
        attribute
        for (what, attribute), a in zip(kind.variables, partials, strict=True)
        if what == "vertical" and "." not in attribute and float(np.abs(a).max()) < ROUNDING
    )


def _zero(kind: VariableKind) -> Array:
    """Return the stored values (1, s) of an unknown whose components and constants are zero."""
    record = UNKNOWNS[kind]
    values = record.store(np.zeros((1, record.size)))
    return np.concatenate([values, np.zeros((1, len(record.constants)))], axis=1)


def variables_in_both(
    before: Network, after: Network
) -> Iterator[tuple[str, Collection[Variable]]]:
    """Yield each observation of a network by id, with its variables there and in another one."""
    images = ((f"{o.photo}/{o.point}", o) for o in before.image_points())
    for ident, o in chain(before.observations.items(), images):
        yield ident, {*variables_of(before, o), *variables_of(after, o)}


def stated_late(
    unknowns: UnknownsGiven, touched: Iterable[tuple[str, Collection[Variable]]]
) -> Iterator[Problem]:
    """Yield unknowns that need not be stated, where earlier observations depend on them.

    Their rows have the default value of such an unknown as a constant.

    Args:
        unknowns: what is stated, by kind and key.
        touched: id of each earlier observation, and the variables that it depends on before or
            after the unknowns are stated; not asked for where all unknowns have to be stated.
    """
    late = {
        (kind, parameter_name(key)): UNKNOWNS[kind].noun
        for kind, given in unknowns.items()
        if kind in UNKNOWNS
        for key in given
        if UNKNOWNS[kind].absent != "refused" or not key
    }
    for ident, variables in touched if late else ():
        for v in late.keys() & set(variables):
            what = (
                f"observation {ident!r} depends on it: state it before the first one that does, "
                "or remove these, and add them again"
            )
            yield Problem(what, f"{late.pop(v)} {v[1]!r}")


def components(network: Network, variable: Variable) -> tuple[int, int]:
    """Return how many free components a variable has, and how many of them are weighted."""
    kind, name = variable
    fixed: tuple[bool, ...]
    sigma: tuple[float, ...]
    if kind == "point":
        point = network.points[name]
        if point.sigma is None:
            return 3 - sum(point.fixed), 0
        fixed, sigma = point.fixed, point.sigma
    elif kind == "pose":
        photo = network.photos[name]
        attitude = np.inf if photo.sigma_attitude is None else photo.sigma_attitude
        fixed = photo.fixed
        sigma = (*(attitude,) * 3, *(photo.sigma_position or (np.inf,) * 3))
    elif kind == "calibration":
        camera = camera_of_calibration(network, name)
        fixed, sigma = camera.fixed, camera.sigma
    else:
        parameter = small_unknown(network, kind, name)
        if parameter is None:
            return 0, 0
        fixed, sigma = parameter.fixed, parameter.sigma
    weighted = sum(not f and bool(np.isfinite(s)) for f, s in zip(fixed, sigma, strict=True))
    return len(fixed) - sum(fixed), weighted


def small_unknown(network: Network, kind: VariableKind, name: str) -> Parameter | None:
    """Return what was stated of a small unknown; none where it is a constant of all."""
    given = network.of_kind(kind)
    if UNKNOWNS[kind].table.keys[1:]:  # type: ignore[union-attr]
        # A name may have a slash of its own.
        at = name.find("/")
        while at >= 0:
            found = given.get((name[:at], name[at + 1 :]))
            if found is not None:
                return found
            at = name.find("/", at + 1)
    elif name in given:
        return given[name]
    return FREE_ORIENTATION if UNKNOWNS[kind].absent == "found" else None
