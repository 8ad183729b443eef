"""What arrives together or not at all: an observation, or a correlated group."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeAlias

import numpy as np

from ..frames import LocalFrame
from ..graph.make_blocks import variable_name
from ..models.variables import UNKNOWNS, VariableKind
from ..network.entities import FREE_ORIENTATION, Parameter
from ..network.network import Network
from ..observations import KINDS, AnyObservation, Correlated, ImagePoint, Observation
from ..types import Array

Variable: TypeAlias = tuple[VariableKind, str]
"""Kind and name."""
TRIANGLE = np.array([[0.0, 0.0, 0.0], [60.0, 80.0, 25.0], [-70.0, 45.0, 10.0]])
"""Points of a sight, metres, for which it is worked out which verticals it notices."""
ROUNDING = 1e-9
"""Largest partial by a vertical, metres or radians per radian, that is nothing but rounding."""


@dataclass(frozen=True, eq=False)
class Unit:
    """One observation, or a correlated group."""

    ids: tuple[str, ...]
    """Ids of its observations."""
    observations: tuple[Observation, ...]
    """They, each with its id (image points: where it has one of its own)."""
    covariance: Array | None
    """Joint covariance of a group."""
    variables: tuple[Variable, ...]
    """What they depend on."""
    unknowns: tuple[Variable, ...]
    """Those of them that have a free component."""

    @property
    def n_scalars(self) -> int:
        """Number of scalar rows."""
        return sum(len(o.component_names()) for o in self.observations)

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the points that it touches."""
        return tuple(name for kind, name in self.variables if kind == "point")

    @property
    def item(self) -> AnyObservation:
        """The observation or group, as the network takes it."""
        if self.covariance is None:
            return self.observations[0]
        return Correlated(self.observations, self.covariance)

    def without(self, network: Network, gone: set[str]) -> Unit | None:
        """Return what remains of a group; none where nothing does."""
        stays = [i not in gone for i in self.ids]
        if not any(stays):
            return None
        assert self.covariance is not None
        sizes = [len(o.component_names()) for o in self.observations]
        rows = np.flatnonzero(np.repeat(stays, sizes))
        left = [o for o, s in zip(self.observations, stays, strict=True) if s]
        return unit_of(network, left, self.covariance[np.ix_(rows, rows)])


def identity(o: Observation) -> str | None:
    """Return the id of an observation, none where the network has to number it."""
    own: str | None = getattr(o, "id", None)
    if own is None and isinstance(o, ImagePoint):
        return f"{o.photo}/{o.point}"
    return own


def named(o: Observation, ident: str) -> Observation:
    """Return the observation with its id; image points keep photo/point as theirs."""
    if isinstance(o, ImagePoint) and ident == f"{o.photo}/{o.point}":
        return o
    return o if getattr(o, "id", None) == ident else replace(o, id=ident)  # type: ignore[call-arg]


def unit_of(
    network: Network, observations: Iterable[Observation], covariance: Array | None
) -> Unit:
    """Return the unit of observations that bear their ids."""
    found = tuple(observations)
    variables = dict.fromkeys(v for o in found for v in variables_of(network, o))
    ids = tuple(identity(o) or "" for o in found)
    unknowns = tuple(v for v in variables if components(network, v)[0])
    return Unit(ids, found, covariance, tuple(variables), unknowns)


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
        yield what, variable_name(network, what, attribute, o)


@cache
def _upright(name: str, raised: tuple[bool, ...]) -> frozenset[str]:
    """Return the points of a kind of observation whose verticals it does not notice.

    A slope distance between the marks themselves is the same in every horizon: its partials by
    verticals are nothing but rounding. They are worked out for one sight.

    Args:
        name: of the kind.
        raised: which of its constants, the heights of instrument and target, are not zero.
    """
    kind = KINDS[name]
    if not any(what == "vertical" for what, _ in kind.variables):
        return frozenset()
    points = [attribute for what, attribute in kind.variables if what == "point"]
    values = [
        TRIANGLE[[points.index(attribute)]]
        if what == "point"
        else UNKNOWNS[what].store(np.zeros((1, UNKNOWNS[what].size)))
        for what, attribute in kind.variables
    ]
    heights = {c: np.array([float(on)]) for c, on in zip(kind.constants, raised, strict=True)}
    assert kind.model is not None
    partials = kind.model(LocalFrame(), *values, observed=np.zeros((1, 1)), **heights).jacobians
    return frozenset(
        attribute
        for (what, attribute), a in zip(kind.variables, partials, strict=True)
        if what == "vertical" and float(np.abs(a).max()) < ROUNDING
    )


def components(network: Network, variable: Variable) -> tuple[int, int]:
    """Return how many free components a variable has, and how many of them are weighted."""
    kind, name = variable
    fixed: tuple[bool, ...]
    sigma: tuple[float, ...]
    if kind == "point":
        point = network.points[name]
        fixed, sigma = point.fixed, point.sigma or (np.inf,) * 3
    elif kind == "pose":
        photo = network.photos[name]
        attitude = np.inf if photo.sigma_attitude is None else photo.sigma_attitude
        fixed = photo.fixed
        sigma = (*(attitude,) * 3, *(photo.sigma_position or (np.inf,) * 3))
    elif kind == "calibration":
        camera = network.cameras.get(name) or network.cameras[name.split("@")[0]]
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
