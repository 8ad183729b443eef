"""Observations that may enter: what of theirs is not known, counted over units and image points."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..graph.variables import calibration_name
from ..models.variables import VariableKind
from ..types import Array, Index, Mask
from .excerpt import Known
from .ledger import Ledger, Some
from .units import Variable, components

OF_RAYS: tuple[VariableKind, ...] = ("pose", "calibration", "point")
"""Kinds of the variables of an image point."""


class Nothing:
    """Knows no variable."""

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return no value."""
        del kind, name
        return None


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

    def joined_with(self, others: Candidates) -> list[Some]:
        """Return these in parts that hang together by open variables, with others that do.

        Args:
            others: further observations; those that hang together with none of these are left.
        """
        mine, theirs = _Graph(self), _Graph(others)
        out: list[Some] = []
        units, rays = mine.nothing, mine.no_rays
        while (seed := mine.next(units, rays)) is not None:
            reached: set[Variable] = set()
            frontier = seed
            found = [np.zeros_like(mine.nothing), np.zeros_like(mine.no_rays)]
            beside = [np.zeros_like(theirs.nothing), np.zeros_like(theirs.no_rays)]
            alone = mine.first(units, rays)
            while frontier:
                reached |= frontier
                more: set[Variable] = set()
                for graph, (u, r) in ((mine, found), (theirs, beside)):
                    new_units, new_rays = graph.touched(frontier)
                    new_units, new_rays = new_units & ~u, new_rays & ~r
                    more |= graph.variables(new_units, new_rays)
                    u |= new_units
                    r |= new_rays
                frontier = more - reached
            if not reached:  # no open variable at all
                found[0], found[1] = alone
            out.append(mine.some(*found).joined(theirs.some(*beside)))
            units, rays = units | found[0], rays | found[1]
        return out


class _Graph:
    """Which candidates touch which open variables."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        self.nothing: Mask = np.zeros(len(candidates.some.units), dtype=bool)
        self.no_rays: Mask = np.zeros(len(candidates.some.rays), dtype=bool)
        self.of: dict[Variable, list[int]] = {}
        for i, variables in enumerate(candidates.of_units):
            for v in variables:
                self.of.setdefault(v, []).append(i)
        self.number = [
            {v: i for i, v in enumerate(every) if is_open[i]}
            for every, _, is_open in candidates.of_rays
        ]

    def first(self, units: Mask, rays: Mask) -> tuple[Mask, Mask]:
        """Return the first candidate that is not yet in a part, as flags."""
        u, r = np.zeros_like(units), np.zeros_like(rays)
        left = np.flatnonzero(~units)
        if len(left):
            u[left[0]] = True
        else:
            r[np.flatnonzero(~rays)[0]] = True
        return u, r

    def next(self, units: Mask, rays: Mask) -> set[Variable] | None:
        """Return the open variables of the first candidate that is not yet in a part."""
        if units.all() and rays.all():
            return None
        return self.variables(*self.first(units, rays))

    def variables(self, units: Mask, rays: Mask) -> set[Variable]:
        """Return the open variables of candidates."""
        out = {v for i in np.flatnonzero(units) for v in self.candidates.of_units[i]}
        if rays.any():
            for every, index, is_open in self.candidates.of_rays:
                used = np.zeros(len(every), dtype=bool)
                used[index[rays]] = True
                out.update(every[i] for i in np.flatnonzero(used & is_open).tolist())
        return out

    def touched(self, variables: Collection[Variable]) -> tuple[Mask, Mask]:
        """Return which candidates touch some variables."""
        units, rays = self.nothing.copy(), self.no_rays.copy()
        for v in variables:
            units[self.of.get(v, [])] = True
        for (every, index, _), number in zip(self.candidates.of_rays, self.number, strict=True):
            at = [number[v] for v in variables if v in number]
            if at:
                used = np.zeros(len(every), dtype=bool)
                used[at] = True
                rays |= used[index]
        return units, rays

    def some(self, units: Mask, rays: Mask) -> Some:
        """Return flagged candidates."""
        chosen = self.candidates.some
        return Some(
            tuple(chosen.units[i] for i in np.flatnonzero(units).tolist()), chosen.rays[rays]
        )
