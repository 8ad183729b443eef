"""What arrives together or not at all: an observation, or a correlated group."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..graph.dependence import Variable, variables_of
from ..graph.variables import calibration_name
from ..models.variables import UNKNOWNS, VariableKind
from ..network.entities import FREE_ORIENTATION, Key
from ..network.network import Network
from ..observations import AnyObservation, Correlated, ImagePoint, Observation
from ..observations.identity import identity
from ..stochastic import StandardDeviation
from ..types import Array


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

    @classmethod
    def of(
        cls, network: Network, observations: Iterable[Observation], covariance: Array | None
    ) -> Unit:
        """Return the unit of observations that bear their ids."""
        found = tuple(observations)
        variables = dict.fromkeys(v for o in found for v in variables_of(network, o))
        # A photo is in a network only with its calibration.
        photos = [name for kind, name in variables if kind == "pose"]
        variables |= {("calibration", calibration_name(network, f)): None for f in photos}
        return cls(tuple(identity(o) or "" for o in found), found, covariance, tuple(variables))

    @cached_property
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

    @cached_property
    def _found(self) -> tuple[tuple[VariableKind, Key], ...]:
        """Kind and key of the unknowns that nobody has to state, such as orientations."""
        every = (p for o in self.observations for p in o.parameters())
        return tuple((kind, key) for kind, key in every if UNKNOWNS[kind].absent == "found")

    def insert_into(self, network: Network) -> None:
        """Add the observation or group to a network; its names have been checked."""
        for kind, key in self._found:
            network.of_kind(kind).setdefault(key, FREE_ORIENTATION)
        for ident, o in zip(self.ids, self.observations, strict=True):
            if isinstance(o, ImagePoint):
                network.insert(o)
            else:
                network.observations[ident] = o
        if self.covariance is not None:
            network.clusters.append((self.ids, self.covariance))

    def without(self, network: Network, gone: set[str]) -> Unit | None:
        """Return what remains of a group without some ids; none where nothing does."""
        stays = [i not in gone for i in self.ids]
        if self.covariance is None or not any(stays):
            return None
        sizes = [len(o.component_names()) for o in self.observations]
        rows = np.flatnonzero(np.repeat(stays, sizes))
        left = [o for o, s in zip(self.observations, stays, strict=True) if s]
        return Unit.of(network, left, self.covariance[np.ix_(rows, rows)])

    def scaled(self, by: float) -> AnyObservation:
        """Return the observation or group with its standard deviations multiplied."""
        scaled = tuple(_scaled(o, by) for o in self.observations)
        if self.covariance is None:
            return scaled[0]
        return Correlated(scaled, self.covariance * by**2)


def _scaled(o: Observation, by: float) -> Observation:
    changes: dict[str, Any] = {}
    sigma = getattr(o, "sigma", None)
    if isinstance(sigma, StandardDeviation):
        changes["sigma"] = sigma.scaled(by)
    elif isinstance(sigma, tuple):
        changes["sigma"] = tuple(s * by for s in sigma)
    elif sigma is not None:
        changes["sigma"] = sigma * by
    covariance = getattr(o, "covariance", None)
    if covariance is not None:
        changes["covariance"] = np.asarray(covariance) * by**2
    return replace(o, **changes)
