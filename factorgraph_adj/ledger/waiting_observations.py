"""Waiting observations: the unknowns that they lack, their counts of rows, and connected parts.

A waiting observation depends on an open variable, neither known nor constant. `Candidates` are
some observations with their open variables, counted in arrays.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from ..graph.dependence import Variable
from ..graph.variables import calibration_name
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..solve.added_factors import Prior
from ..types import NO_ROWS, Array, Index, Mask
from .excerpts import Known
from .ledger import Ledger


class NothingKnown:
    """Knows no variable."""

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return no."""
        del kind, name
        return False

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return no value."""
        del kind, name
        return None


def known_in(system: Known | None) -> Known:
    """Return a system, or, if it is None, an object that knows no variable."""
    return NothingKnown() if system is None else system


class RetiredValues(NothingKnown):
    """Knows what retired observations say of, where it was when they were retired."""

    def __init__(self, prior: Prior) -> None:
        """Know the unknowns of a prior."""
        self.there: dict[Variable, Array] = prior.references()

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether the prior has a variable."""
        return (kind, name) in self.there

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return the value of a variable as in a state; None: the prior does not have it."""
        return self.there.get((kind, name))


class Links(NamedTuple):
    """Which candidates depend on which variables, a pair in each place."""

    variables: tuple[Variable, ...]
    """All variables."""
    number: Mapping[Variable, int]
    """Their numbers."""
    candidate: Index
    """Numbers of candidates, (e,)."""
    variable: Index
    """Numbers of variables, (e,)."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Some observations, and which of their variables are open: neither known nor constants."""

    ledger: Ledger
    """Where they are stored."""
    known: Known
    """What is known."""
    rows: Index
    """Their rows."""

    def __post_init__(self) -> None:
        """Know what was known when others were retired, where nothing else is."""
        if self.ledger.retired is not None and type(self.known) is NothingKnown:
            object.__setattr__(self, "known", RetiredValues(self.ledger.retired.prior))

    @cached_property
    def links(self) -> Links:
        """Which candidates depend on which variables."""
        rows, names = self.ledger.rows, self.ledger.names
        number: dict[Variable, int] = {}
        is_ray = rows.photo[self.rows] >= 0
        units = [unit.variables for _, unit in rows.units(self.rows)]
        to = [number.setdefault(v, len(number)) for v in chain.from_iterable(units)]
        size = np.fromiter(map(len, units), dtype=np.intp, count=len(units))
        candidate = [np.repeat(np.flatnonzero(~is_ray), size)]
        variable = [np.array(to, dtype=np.intp)]
        at = np.flatnonzero(is_ray)
        photos, photo = np.unique(rows.photo[self.rows[at]], return_inverse=True)
        points, point = np.unique(rows.point[self.rows[at]], return_inverse=True)
        poses: list[Variable] = [("pose", names.photos[f]) for f in photos.tolist()]
        lens = [calibration_name(self.ledger.network, name) for _, name in poses]
        of_photo: list[Variable] = [("calibration", name) for name in lens]
        places_of: list[Variable] = [("point", names.points[p]) for p in points.tolist()]
        for every, index in ((poses, photo), (of_photo, photo), (places_of, point)):
            numbers = [number.setdefault(v, len(number)) for v in every]
            candidate.append(at)
            variable.append(np.array(numbers, dtype=np.intp)[index])
        for f, (_, name) in enumerate(poses):
            own = at[photo == f]
            for v in self.ledger.network.of_photo(name):
                candidate.append(own)
                variable.append(np.full(len(own), number.setdefault(v, len(number))))
        return Links(tuple(number), number, np.concatenate(candidate), np.concatenate(variable))

    @cached_property
    def open(self) -> Mask:
        """Which variables are open."""
        known, needs = self.known.known, self.ledger.needs
        every = (not known(*v) and needs(v)[0] > 0 for v in self.links.variables)
        return np.fromiter(every, dtype=bool, count=len(self.links.variables))

    @cached_property
    def scalars(self) -> Index:
        """Number of scalar rows of every candidate."""
        out = np.full(len(self.rows), 2, dtype=np.intp)
        rows = self.ledger.rows
        at = np.flatnonzero(rows.photo[self.rows] < 0)
        out[at] = [u.n_scalars for _, u in rows.units(self.rows)]
        return out

    @cached_property
    def _n_scalars(self) -> Index:
        """Number of scalar rows of every variable."""
        links = self.links
        weights = self.scalars[links.candidate]
        n = np.bincount(links.variable, weights=weights, minlength=len(links.variables))
        return n.astype(np.intp)

    @cached_property
    def counts(self) -> Mapping[Variable, int]:
        """Number of scalar rows of every open variable."""
        every, n = self.links.variables, self._n_scalars.tolist()
        return {every[i]: n[i] for i in np.flatnonzero(self.open).tolist()}

    @cached_property
    def _by_variable(self) -> csr_array:
        links = self.links
        shape = len(links.variables), len(self.rows)
        return csr_array((np.ones(len(links.variable)), (links.variable, links.candidate)), shape)

    def counted(self) -> tuple[Candidates, dict[Variable, int]]:
        """Leave out the open variables that have fewer rows than components, with their rows.

        Where a row is left out, other variables lose it.

        Returns:
            The candidates that are left, and how many rows each variable had when it was left out.
        """
        open_, every = self.open, self.links.variables
        needs = [self.ledger.needs(v) for v in every]
        missing = np.where(open_, [size - own for size, own in needs], 0)
        n, few = self._n_scalars.copy(), np.zeros(len(every), dtype=bool)
        there, rows_of = np.ones(len(self.rows), dtype=bool), self._by_variable
        variables_of, lost = rows_of.T.tocsr(), dict[Variable, int]()
        while len(found := np.flatnonzero(open_ & ~few & (n > 0) & (n < missing))):
            few[found] = True
            lost |= {every[i]: int(n[i]) for i in found.tolist()}
            gone = np.unique(rows_of[found].indices)
            gone = gone[there[gone]]
            there[gone] = False
            less = variables_of[gone].T @ self.scalars[gone]
            n -= less.astype(np.intp)
        return (self if there.all() else self._some(there)), lost

    def _some(self, there: Mask) -> Candidates:
        """Return some of the candidates, (n,), with their links."""
        out, links = Candidates(self.ledger, self.known, self.rows[there]), self.links
        on = there[links.candidate]
        used, variable = np.unique(links.variable[on], return_inverse=True)
        variables = tuple(links.variables[i] for i in used.tolist())
        number = {v: i for i, v in enumerate(variables)}
        candidate = (np.cumsum(there) - 1)[links.candidate[on]]
        out.__dict__["links"] = Links(variables, number, candidate, variable)
        out.__dict__["open"], out.__dict__["scalars"] = self.open[used], self.scalars[there]
        return out

    @cached_property
    def _n_rays(self) -> Index:
        """Number of image points of every variable."""
        links = self.links
        is_ray = self.ledger.rows.photo[self.rows] >= 0
        of_rays = links.variable[is_ray[links.candidate]]
        return np.bincount(of_rays, minlength=len(links.variables))

    def describe(self, variable: Variable) -> str:
        """Say what observes a variable: ``2 image rays, 1 direction``."""
        number, found = self.links.number.get(variable), self._by_variable
        if number is None:
            return ""
        rays = int(self._n_rays[number])
        first, last = found.indptr[number], found.indptr[number + 1]
        own = self.rows[found.indices[first:last]] if rays < last - first else NO_ROWS
        units = self.ledger.rows.units(own)
        counts = Counter(o.kind for _, unit in units for o in unit.observations)
        if rays:
            counts["image ray" if variable[0] == "point" else "image point"] += rays
        return ", ".join(f"{n} {k.replace('_', ' ')}{'s' * (n > 1)}" for k, n in counts.items())

    @cached_property
    def blocked(self) -> Mask:
        """Which candidates have an open variable."""
        out = np.zeros(len(self.rows), dtype=bool)
        out[self.links.candidate[self.open[self.links.variable]]] = True
        return out

    @property
    def ready(self) -> Index:
        """The candidates without an open variable."""
        return np.asarray(self.rows[~self.blocked])

    @property
    def late(self) -> Index:
        """The other candidates."""
        return np.asarray(self.rows[self.blocked])

    @property
    def beside_known(self) -> Index:
        """The candidates that touch a known point or photo."""
        links, known = self.links, self.known.known
        every = (kind in ("point", "pose") and known(kind, n) for kind, n in links.variables)
        there = np.fromiter(every, dtype=bool, count=len(links.variables))
        return np.unique(self.rows[links.candidate[there[links.variable]]])

    def lacking(self) -> list[list[Variable]]:
        """Return the open variables of every candidate."""
        links = self.links
        out: list[list[Variable]] = [[] for _ in self.rows]
        on = self.open[links.variable]
        for i, v in zip(links.candidate[on].tolist(), links.variable[on].tolist(), strict=True):
            out[i].append(links.variables[v])
        return out

    # -- parts --------------------------------------------------------------------------------

    def only(self, rows: Index) -> Candidates:
        """Return other candidates of the same state."""
        return Candidates(self.ledger, self.known, rows)

    def touching(self, variables: Collection[Variable]) -> Index:
        """Return the candidates that touch any of some variables."""
        links = self.links
        wanted = np.zeros(len(links.variables), dtype=bool)
        wanted[[links.number[v] for v in variables if v in links.number]] = True
        return np.unique(self.rows[links.candidate[wanted[links.variable]]])

    def without(self, variables: Collection[Variable]) -> Candidates:
        """Return the candidates that touch none of some variables."""
        return self._some(~np.isin(self.rows, self.touching(variables)))

    def parts(self, *, by_geometry: bool = False) -> list[Index]:
        """Return the candidates in parts that open variables join.

        Args:
            by_geometry: whether variables that carry no datum, such as calibrations, do not count.
        """
        n, links = len(self.rows), self.links
        if not n:
            return []
        on = self.open[links.variable]
        if by_geometry:
            joins = [UNKNOWNS[kind].connects for kind, _ in links.variables]
            on &= np.array(joins, dtype=bool)[links.variable]
        ends = links.candidate[on], n + links.variable[on]
        graph = csr_array((np.ones(len(ends[0])), ends), (n + len(links.variables),) * 2)
        label = connected_components(graph, directed=False)[1][:n]
        order = np.argsort(label, kind="stable")
        return np.split(self.rows[order], np.flatnonzero(np.diff(label[order])) + 1)
