"""Factors that a user's function makes, by the names of unknowns instead of numbered keys.

A key counts the unknowns of one network. Where a network grows, a function that asks for keys by
names says what its factor depends on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import gtsam
import numpy as np

from ..errors import InputError, Problem
from ..models.base import DegenerateError, Linearised
from ..models.variables import ENTITIES, UNKNOWNS, VariableKind
from ..network.entities import Key, parameter_name
from ..network.network import Network
from ..observations.own import OwnFactor
from ..types import Array
from .extra import linear_rows
from .keys import KeyMap, from_gtsam, is_pose, pose_of
from .variables import Unknowns


class KeyOf(Protocol):
    """Function that returns the key of an unknown by its kind and name, as `KeyMap.key`."""

    def __call__(self, kind: VariableKind, name: str) -> int:
        """Return the key."""
        ...

    def scale(self, kind: VariableKind, name: str) -> Array:
        """Return what values in the graph are multiplied by to be given ones, `KeyMap.scale`."""
        ...


MakesFactor: TypeAlias = Callable[[KeyOf], gtsam.NonlinearFactor]
"""A user's function: it is given a `KeyOf`, and returns a factor over keys that it asked for."""


def made(name: str, make: MakesFactor, keys: KeyMap) -> gtsam.NonlinearFactor:
    """Return the factor that a user's function makes with the keys of a network.

    Raises:
        InputError: the network has no unknown of a name that the function asks for, or what the
            function returns is no factor.
    """
    try:
        factor = make(keys)
    except InputError as error:
        where = f"factor {name!r}"
        raise InputError([Problem(str(p), where) for p in error.problems]) from None
    if not isinstance(factor, gtsam.NonlinearFactor):
        kind = type(factor).__name__
        what = f"its function must return a `gtsam.NonlinearFactor`, not {kind}"
        raise InputError(Problem(what, f"factor {name!r}"))
    return factor


def observation_of(name: str, make: MakesFactor, network: Network) -> OwnFactor:
    """Return a factor as an observation, which finds its unknowns by their names.

    Args:
        name: id of the observation.
        make: function that makes the factor.
        network: network with the unknowns that the factor depends on.

    Raises:
        InputError: as `made`; the factor has a key that its function did not ask for, or no noise
            model: what it observes then cannot be tested when it arrives.
    """
    where = f"factor {name!r}"
    if not callable(make):
        kind = type(make).__name__
        what = (
            "give a function of key(kind, name) that makes the factor, such as lambda key: "
            f"gtsam.RangeFactor3(key('point', 'A'), key('point', 'B'), …), not {kind}: the keys of "
            "a factor count the unknowns of one network, and this network grows"
        )
        raise InputError(Problem(what, where))
    keys = KeyMap(Unknowns(network))
    asked: dict[int, tuple[VariableKind, str]] = {}

    class Asked(KeyMap):
        """Notes the keys that are asked for."""

        def key(self, kind: VariableKind, name: str) -> int:
            found = super().key(kind, name)
            asked[found] = (kind, name)
            return found

    factor = made(name, make, Asked(keys.unknowns))
    own = list(dict.fromkeys(factor.keys()))
    if strange := [k for k in own if k not in asked]:
        shown = gtsam.DefaultKeyFormatter(strange[0])
        what = f"its function must ask key(kind, name) for every key; it did not for {shown}"
        raise InputError(Problem(what, where))
    if not isinstance(factor, gtsam.NoiseModelFactor):
        what = (
            f"a {type(factor).__name__} has no noise model, so that it cannot be tested when it "
            "arrives; hand it to adjust(…, extra_factors=…)"
        )
        raise InputError(Problem(what, where))
    if isinstance(factor.noiseModel(), gtsam.noiseModel.Robust):
        what = (
            "has a robust noise model, whose weight depends on the residual, so that it cannot be "
            "tested when it arrives; give the model that it wraps"
        )
        raise InputError(Problem(what, where))
    unknowns = tuple((kind, _key_in(network, kind, n)) for kind, n in (asked[k] for k in own))
    kinds = tuple(kind for kind, _ in unknowns)
    numbers = [keys.unknowns[kind].number[n] for kind, n in (asked[k] for k in own)]
    scales = tuple(map(keys.unknowns.graph_scale, kinds, numbers))
    model = FactorModel(factor, tuple(own), kinds, scales, where)
    return OwnFactor(unknowns, model, factor.dim(), id=name, source=type(factor).__name__)


def _key_in(network: Network, kind: VariableKind, name: str) -> Key:
    """Return the key under which a network states an unknown."""
    if kind in ENTITIES:
        return name
    return next((k for k in network.of_kind(kind) if parameter_name(k) == name), name)


@dataclass(frozen=True, eq=False)
class FactorModel:
    """Model of a factor: residuals and partials in standard deviations of its noise model.

    GTSAM cannot pickle factors of every type. What is pickled has lost its factor, and says so
    where it is evaluated; copies share the factor.
    """

    factor: gtsam.NoiseModelFactor | None
    """The factor; none after pickling."""
    keys: tuple[int, ...]
    """Its keys."""
    kinds: tuple[VariableKind, ...]
    """Kind of the unknown of each."""
    scales: tuple[Array | None, ...]
    """Scale of each, see `Unknowns.graph_scale`."""
    where: str
    """Name of the factor, for messages."""

    def __call__(self, frame: object, *values: Array, observed: Array) -> Linearised:
        """Return residuals (1, d) and partials of the unknowns whose stored values are given.

        Raises:
            InputError: the factor was lost in pickling, or is not finite.
            DegenerateError: the factor is inactive.
        """
        del frame
        if self.factor is None:
            what = "was left behind when its network was pickled: add it again"
            raise InputError(Problem(what, self.where))
        given = gtsam.Values()
        for key, kind, scale, row in zip(self.keys, self.kinds, self.scales, values, strict=True):
            if is_pose(kind):
                given.insert(key, pose_of(row[0]))
            else:
                stated = UNKNOWNS[kind].given(row)[0]
                given.insert(key, stated if scale is None else stated / scale)
        found = linear_rows(self.factor, given, self.where)
        if found is None:
            raise DegenerateError(np.zeros(1, dtype=np.intp), "the factor is inactive here")
        order, a, r = found
        if r.shape != (observed.shape[1],):
            what = f"has {len(r)} residuals here, and was to have {observed.shape[1]}"
            raise InputError(Problem(what, self.where))
        by_key = dict(zip(order, np.split(a, self._ends(order, values), axis=1), strict=True))
        partials = tuple(
            from_gtsam(kind, by_key[key], row[0], scale)[None]
            for key, kind, scale, row in zip(
                self.keys, self.kinds, self.scales, values, strict=True
            )
        )
        return Linearised(r[None], partials)

    def _ends(self, order: list[int], values: tuple[Array, ...]) -> Array:
        """Return where the columns of each key end, but for the last."""
        size = {
            key: UNKNOWNS[kind].given(row).shape[1]
            for key, kind, row in zip(self.keys, self.kinds, values, strict=True)
        }
        return np.cumsum([size[key] for key in order])[:-1]

    def __deepcopy__(self, memo: Mapping[int, Any]) -> FactorModel:
        """Return the object itself: it is immutable."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: everything but the factor."""
        return {**vars(self), "factor": None}
