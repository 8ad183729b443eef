"""Observations that may enter: what of theirs is not known, counted over units and image points."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..graph.variables import calibration_name
from ..models.variables import VariableKind
from ..types import Array, Index, Mask
from .excerpt import Known
from .ledger import Ledger, Some
from .units import Variable, components


class Nothing:
    """Knows no variable."""

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return no value."""
        del kind, name
        return None


def known_in(system: Known | None) -> Known:
    """Return what knows the variables of a system; none: nothing is known."""
    return Nothing() if system is None else system


@dataclass(frozen=True, eq=False)
class Candidates:
    """Some observations, and which of their variables are open: neither known nor constants."""

    ledger: Ledger
    """Where they stand."""
    known: Known
    """What is known."""
    some: Some
    """The observations."""

    @cached_property
    def of_rays(self) -> tuple[tuple[list[Variable], Index, Mask], ...]:
        """Pose, calibration and point of the rays.

        For each kind: the variables, the number of each ray's among them (m,), and which are open.
        """
        rays, names, rows = self.ledger.rays, self.ledger.names, self.some.rays
        photos, photo = np.unique(rays.photo[rows], return_inverse=True)
        points, point = np.unique(rays.point[rows], return_inverse=True)
        poses: list[Variable] = [("pose", names.photos[f]) for f in photos.tolist()]
        lenses = [calibration_name(self.ledger.network, name) for _, name in poses]
        number = {name: i for i, name in enumerate(dict.fromkeys(lenses))}
        of_photo = np.array([number[name] for name in lenses], dtype=np.intp)
        cameras: list[Variable] = [("calibration", name) for name in number]
        places: list[Variable] = [("point", names.points[p]) for p in points.tolist()]
        return tuple(
            (every, index, np.array([self._open(v) for v in every], dtype=bool))
            for every, index in ((poses, photo), (cameras, of_photo[photo]), (places, point))
        )

    def _open(self, variable: Variable) -> bool:
        if self.known.value(*variable) is not None:
            return False
        return components(self.ledger.network, variable)[0] > 0

    @cached_property
    def of_units(self) -> tuple[tuple[Variable, ...], ...]:
        """The open variables of every unit."""
        return tuple(
            tuple(v for v in u.unknowns if self.known.value(*v) is None) for u in self.some.units
        )

    @cached_property
    def rows(self) -> Mapping[Variable, int]:
        """Number of scalar rows of every open variable."""
        out: dict[Variable, int] = {}
        for unit, variables in zip(self.some.units, self.of_units, strict=True):
            for v in variables:
                out[v] = out.get(v, 0) + unit.n_scalars
        for every, index, is_open in self.of_rays:
            counts = 2 * np.bincount(index, minlength=len(every))
            for i in np.flatnonzero(is_open).tolist():
                out[every[i]] = out.get(every[i], 0) + int(counts[i])
        return out

    @cached_property
    def _observing(self) -> Mapping[Variable, dict[str, int]]:
        """Number of observations of every open variable by their kind."""
        out: dict[Variable, dict[str, int]] = {}
        for unit, variables in zip(self.some.units, self.of_units, strict=True):
            for v in variables:
                counts = out.setdefault(v, {})
                for o in unit.observations:
                    counts[o.kind] = counts.get(o.kind, 0) + 1
        for every, index, is_open in self.of_rays:
            n = np.bincount(index, minlength=len(every))
            for i in np.flatnonzero(is_open).tolist():
                out.setdefault(every[i], {})["image"] = int(n[i])
        return out

    def describe(self, variable: Variable) -> str:
        """Say what observes an open variable: ``2 image rays, 1 direction``."""
        words = {"image": "image ray" if variable[0] == "point" else "image point"}
        return ", ".join(
            f"{n} {words.get(k, k.replace('_', ' '))}{'s' * (n > 1)}"
            for k, n in self._observing.get(variable, {}).items()
        )

    @cached_property
    def waiting(self) -> Mask:
        """Which rays have an open variable, (m,)."""
        out = np.zeros(len(self.some.rays), dtype=bool)
        for _, index, is_open in self.of_rays:
            out |= is_open[index]
        return out

    @property
    def ready(self) -> Some:
        """The observations without an open variable."""
        units = (u for u, v in zip(self.some.units, self.of_units, strict=True) if not v)
        return Some(tuple(units), self.some.rays[~self.waiting])

    @property
    def late(self) -> Some:
        """The other observations."""
        units = (u for u, v in zip(self.some.units, self.of_units, strict=True) if v)
        return Some(tuple(units), self.some.rays[self.waiting])

    # -- parts --------------------------------------------------------------------------------

    def only(self, some: Some) -> Candidates:
        """Return other candidates of the same state."""
        return Candidates(self.ledger, self.known, some)

    def touching(self, variables: Collection[Variable]) -> Some:
        """Return the observations that touch any of some variables."""
        wanted = set(variables)
        units = tuple(u for u in self.some.units if not wanted.isdisjoint(u.variables))
        return Some(units, self.some.rays[self._touched(wanted)])

    def _touched(self, wanted: Collection[Variable]) -> Mask:
        out = np.zeros(len(self.some.rays), dtype=bool)
        for every, index, _ in self.of_rays:
            out |= np.array([v in wanted for v in every], dtype=bool)[index]
        return out

    def without(self, variables: Collection[Variable]) -> Candidates:
        """Return the candidates that touch none of some variables."""
        return self.only(self.some.less(self.touching(variables)))

    def parts(self) -> list[Some]:
        """Return the candidates in parts that hang together by open variables."""
        if not self.some:
            return []
        number: dict[Variable, int] = {}
        edges: list[tuple[Index, Index]] = []  # candidate and open variable
        for i, variables in enumerate(self.of_units):
            for v in variables:
                edges.append((np.array([i]), np.array([number.setdefault(v, len(number))])))
        first = len(self.some.units)
        for every, index, is_open in self.of_rays:
            own = np.array([number.setdefault(v, len(number)) for v in every], dtype=np.intp)
            on = np.flatnonzero(is_open[index])
            edges.append((first + on, own[index[on]]))
        n = first + len(self.some.rays)
        own, variable = (np.concatenate(x) for x in zip(*edges, strict=True))
        shape = (n + len(number),) * 2
        graph = coo_array((np.ones(len(own)), (own, n + variable)), shape=shape)
        label = connected_components(graph, directed=False)[1][:n]
        return [self._chosen(np.flatnonzero(label == k)) for k in dict.fromkeys(label.tolist())]

    def _chosen(self, numbers: Index) -> Some:
        """Return candidates by their numbers, units before rays."""
        first = len(self.some.units)
        units = tuple(self.some.units[i] for i in numbers[numbers < first].tolist())
        return Some(units, self.some.rays[numbers[numbers >= first] - first])
