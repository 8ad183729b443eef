"""Known variables; waiting observations: what they lack, their parts; excerpts as networks.

Candidates are counted in arrays. An excerpt is the part of a network that some observations touch,
as a network of its own: the models, the search for approximate values and the adjustment of small
parts are thus those of every network.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import NamedTuple, Protocol

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from ..entities import FREE_ORIENTATION, Camera, Parameter, parameter_name
from ..graph.dependence import Variable
from ..graph.variables import calibration_name, camera_of_calibration
from ..models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import DatumChoice, Network
from ..solve.added_factors import Prior
from ..types import NO_ROWS, Array, Index, Mask
from .ledger import Ledger
from .row_store import insert_units

HELD = (True, True, True)
"""Flags of a point that is held altogether."""


class Known(Protocol):
    """Variables whose values are known."""

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether a variable is known."""
        ...

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return the value of a variable as in a state; None: it is not known."""
        ...


def excerpt(
    ledger: Ledger, known: Known, rows: Index, *, datum: DatumChoice = "given", hold: bool = True
) -> Network:
    """Return the network of some observations, with known variables at their values.

    A camera with a calibration for each photo becomes one camera for each photo, of the name
    that its calibration has among the unknowns.

    Args:
        ledger: everything that was described.
        known: what is known.
        rows: the observations.
        datum: datum of the network.
        hold: whether known variables are held. Otherwise they are as they were described, without
            weights; what is not known must then be held in any case.
    """
    return _Excerpt(ledger, known, datum, hold).of(rows)


class _Excerpt:
    """A network that is put together."""

    def __init__(self, ledger: Ledger, known: Known, datum: DatumChoice, hold: bool) -> None:
        self.ledger, self.network, self.known, self.hold = ledger, ledger.network, known, hold
        self.out = Network(
            self.network.name, frame=self.network.frame, datum=datum, crs=self.network.crs
        )

    def of(self, chosen: Index) -> Network:
        """Return the network of some rows."""
        out, network, rows, names = self.out, self.network, self.ledger.rows, self.ledger.names
        units = [unit for _, unit in rows.units(chosen)]
        poses: dict[str, None] = {}
        for kind, name in dict.fromkeys(v for u in units for v in u.variables):
            if kind == "point":
                self._point(name)
            elif kind == "pose":
                poses[name] = None
            elif kind == "calibration":
                self._lens(camera_of_calibration(network, name), name)
            elif kind not in ENTITIES and UNKNOWNS[kind].absent != "found":
                self._stated(kind, name)
        rays = rows.images(chosen)
        for number in np.unique(rows.point[rays]).tolist():
            self._point(names.points[number])
        poses |= {names.photos[f]: None for f in np.unique(rows.photo[rays]).tolist()}
        for name in out.verticals:  # a vertical needs its station; horizons turn with it
            self._point(name)
        for name in poses:
            self._photo(name)
        insert_units(out, units)
        out.images = rows.table(rays)
        for column, all_names, number_of in (
            (out.images.photo, names.photos, out.photo_number),
            (out.images.point, names.points, out.point_number),
        ):
            every, place = np.unique(column[0], return_inverse=True)
            new = np.array([number_of[all_names[i]] for i in every.tolist()], dtype=np.intp)
            column[0] = new[place]
        for kind in (k.name for k in parameter_kinds() if k.absent == "found"):
            found, given = out.of_kind(kind), network.of_kind(kind)
            for key in found:
                stated = given.get(key, FREE_ORIENTATION)
                found[key] = self._parameter(kind, parameter_name(key), stated)
        return out

    def _stated(self, kind: VariableKind, name: str) -> None:
        given = self.network.of_kind(kind)
        compound = (k for k in given if not isinstance(k, str) and parameter_name(k) == name)
        key = name if name in given else next(compound, None)
        if key is not None:
            self.out.of_kind(kind)[key] = self._parameter(kind, name, given[key])

    def _point(self, name: str) -> None:
        if name in self.out.points:
            return
        point = self.network.points[name]
        value = self.known.value("point", name)
        if value is not None:
            at = tuple(value.tolist())
            point = replace(
                point, coordinates=at, sigma=None, fixed=HELD if self.hold else point.fixed
            )
        self.out.points[name] = point
        self.out.point_number[name] = len(self.out.point_number)

    def _photo(self, name: str) -> None:
        photo = self.network.photos[name]
        camera = self.network.cameras[photo.camera]
        calibration = f"{camera.name}@{name}" if camera.per_photo else camera.name
        self._lens(camera, calibration)
        value = self.known.value("pose", name)
        if value is not None:
            photo = replace(
                photo,
                position=tuple(value[9:].tolist()),
                rotation=value[:9].reshape(3, 3),
                fixed=(True,) * 6 if self.hold else photo.fixed,
                sigma_position=None,
                sigma_attitude=None,
            )
        self.out.photos[name] = replace(photo, camera=calibration)
        self.out.photo_number[name] = len(self.out.photo_number)

    def _lens(self, camera: Camera, name: str) -> None:
        if name not in self.out.cameras:
            self.out.cameras[name] = self._camera(camera, name)

    def _camera(self, camera: Camera, name: str) -> Camera:
        value = self.known.value("calibration", name)
        out = replace(camera, name=name, per_photo=False)
        if value is None:
            return out
        k = len(camera.values)
        fixed = (True,) * k if self.hold else camera.fixed
        return replace(out, values=tuple(value[:k].tolist()), fixed=fixed, sigma=(np.inf,) * k)

    def _parameter(self, kind: VariableKind, name: str, given: Parameter) -> Parameter:
        value = self.known.value(kind, name)
        if value is None:
            return given
        k = len(given.values)
        value = UNKNOWNS[kind].given(value[None])[0]
        fixed = (True,) * k if self.hold else given.fixed
        values = tuple(value[:k].tolist())
        return replace(given, values=values, fixed=fixed, sigma=(np.inf,) * k)


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
