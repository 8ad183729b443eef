"""Candidates for additions to a design: cost, readings, partials; difference of two designs.

The readings of a candidate are computed from the given values of the network.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import coo_array, csr_array

from ..entities import Camera, Key, Parameter, Photo, Point, parameter_name
from ..errors import InputError, Problem, known
from ..graph.equations import Equations, compile_network
from ..graph.variables import calibration_name
from ..models.unknown_registry import VariableKind
from ..network.additions import add_entities
from ..network.network import Network
from ..observations import AnyObservation, Correlated, Observation
from ..observations.ids import identity, named
from ..simulation.measurement import measure
from ..solve.linearised_equations import LinearisedEquations
from ..types import Array, Index


def as_planned(network: Network) -> Network:
    """Return the network with all readings computed from its given values.

    Args:
        network: coordinates and places as planned; the observed values are ignored.

    Raises:
        InputError: points, photos and other unknowns without the values that a plan needs, as
            `factorgraph_adj.simulation.planned_values.with_given_values`.
    """
    return measure(network, seed=0, noise=False)


Named: TypeAlias = tuple[str, str]
"""Kind of an entity or unknown (point, photo, camera, level …), and its name."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Observations that are made only together, with the new entities that they need.

    A station is a candidate with all its sights, and with its point if the point is new. A photo is
    a candidate with all its image points. A candidate is complete by itself: its observations
    determine its new entities. A single observation, point, photo or camera needs no tuple.
    """

    name: str
    """Name of the candidate."""
    observations: tuple[AnyObservation, ...]
    """Observations of the candidate; the observed values are ignored."""
    cost: float = 1.0
    """Cost of the candidate, in any unit."""
    points: tuple[Point, ...] = ()
    """New points, with planned coordinates."""
    photos: tuple[Photo, ...] = ()
    """New photos, with planned position and rotation."""
    cameras: tuple[Camera, ...] = ()
    """New cameras."""
    unknowns: Mapping[VariableKind, Mapping[Key, Parameter]] = field(default_factory=dict)
    """New unknowns by kind and name: the level of a lake, the drift of a flight, a mount."""

    def __post_init__(self) -> None:
        """Convert single entities to tuples of one."""
        for name in ("observations", "points", "photos", "cameras"):
            given: Any = getattr(self, name)
            single = isinstance(given, str) or not isinstance(given, Iterable)
            object.__setattr__(self, name, (given,) if single else tuple(given))

    @property
    def single(self) -> Iterator[Observation]:
        """Observations, with those of correlated groups one by one."""
        for item in self.observations:
            yield from item.observations if isinstance(item, Correlated) else (item,)

    @property
    def ids(self) -> list[str]:
        """Ids of the observations."""
        return [identity(o) or "" for o in self.single]

    @property
    def brings(self) -> set[Named]:
        """New points, photos, cameras and other unknowns."""
        kinds = (("point", self.points), ("photo", self.photos), ("camera", self.cameras))
        out = {(kind, item.name) for kind, items in kinds for item in items}
        return out | {
            (kind, parameter_name(key)) for kind, given in self.unknowns.items() for key in given
        }

    @property
    def needs(self) -> set[Named]:
        """What the observations name and is not new: points, photos, cameras, other unknowns."""
        out: set[Named] = {("camera", f.camera) for f in self.photos}
        for o in self.single:
            named_by = ((kind, getattr(o, attribute)) for kind, attribute in o.record.parameters)
            out |= {(kind, name) for kind, name in named_by if isinstance(name, str)}
            out |= {("point", name) for name in o.points()}
            out |= {("photo", name) for name in o.photos()}
        return out - self.brings


def as_candidates(given: Any) -> list[Candidate]:
    """Return candidates whose observations have ids; a single candidate gives a list of one.

    Raises:
        InputError: a value that is no candidate.
    """
    if isinstance(given, Candidate):
        given = (given,)
    try:
        every = list(given)
    except TypeError:
        raise InputError(f"candidates must be a sequence of Candidate, not {given!r}") from None
    problems = [
        Problem(f"is no Candidate: {c!r}", f"candidate {n}")
        for n, c in enumerate(every, 1)
        if not isinstance(c, Candidate)
    ]
    problems += [
        Problem(f"is no observation: {o!r}", f"candidate {c.name!r}")
        for c in every
        if isinstance(c, Candidate)
        for o in c.single
        if not isinstance(o, Observation)
    ]
    if problems:
        raise InputError(problems)
    return identified(every)


def dependent(candidates: Sequence[Candidate], network: Network) -> list[Problem]:
    """Return a problem for each candidate that needs a new entity of another candidate.

    Args:
        candidates: all candidates.
        network: the design.
    """
    there = {("point", n) for n in network.points}
    there |= {("photo", n) for n in network.photos} | {("camera", n) for n in network.cameras}
    there |= {(k, parameter_name(n)) for k, given in network.parameters.items() for n in given}
    bringer = {what: c.name for c in reversed(candidates) for what in c.brings}
    return [
        Problem(
            f"it needs {kind} {name!r}, which candidate {bringer[kind, name]!r} brings; "
            "candidates must be complete by themselves: join the two into one",
            f"candidate {c.name!r}",
        )
        for c in candidates
        for kind, name in sorted(c.needs - there)
        if (kind, name) in bringer
    ]


def identified(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates with ids for all observations; default: candidate and number."""
    return [
        replace(
            c,
            observations=tuple(
                _identified(item, f"{c.name}/{n}") for n, item in enumerate(c.observations, 1)
            ),
        )
        for c in candidates
    ]


def _identified(item: AnyObservation, ident: str) -> AnyObservation:
    if isinstance(item, Correlated):
        members = tuple(_identified(o, f"{ident}.{n}") for n, o in enumerate(item.observations, 1))
        return Correlated(members, item.covariance)  # type: ignore[arg-type]
    if identity(item) is not None:
        return item
    return named(item, ident)


def with_candidates(network: Network, candidates: Sequence[Candidate]) -> Network:
    """Return the network with the candidates added.

    A free network keeps its datum points. If none of its points is flagged, all its points are
    flagged as datum points, and the points of candidates are not.

    Raises:
        InputError: all errors of the candidates, by candidate: equal names, invalid costs, ids
            that exist already, unknown points and photos.
    """
    problems: list[Problem] = []
    names: set[str] = set()
    free = network.datum == "free"
    out = _flagged(network) if free else network.copy()
    for c in candidates:
        where = f"candidate {c.name!r}"
        if c.name in names:
            problems.append(Problem("there are two of this name", where))
        names.add(c.name)
        if isinstance(c.cost, bool) or not isinstance(c.cost, int | float | np.number):
            problems.append(Problem(f"its cost must be a number, not {c.cost!r}", where))
        elif not (np.isfinite(c.cost) and c.cost > 0):
            problems.append(Problem(f"its cost must be greater than zero, not {c.cost}", where))
        if not c.observations:
            problems.append(Problem("it has no observations", where))
        points = [replace(p, datum=False) if free and isinstance(p, Point) else p for p in c.points]
        found = add_entities(
            out, points=points, photos=c.photos, cameras=c.cameras, unknowns=c.unknowns
        )
        for item in c.observations:
            if not isinstance(item, Observation | Correlated):
                found.append(Problem(f"is no observation: {item!r}", "observations"))
                continue
            try:
                out.add(item)
            except InputError as error:
                found += error.problems
        problems += [Problem(p.what, f"{where}, {p.where}") for p in found]
    if problems:
        raise InputError(problems)
    return out


def _flagged(network: Network) -> Network:
    """Return a free network whose datum points are flagged."""
    out = network.copy()
    if not any(p.datum for p in out.points.values()):
        # Held points are not flagged, because they cannot be datum points.
        for name, p in out.points.items():
            if not all(p.fixed):
                out.points[name] = replace(p, datum=True)
    return out


@dataclass(frozen=True, eq=False)
class CandidateRows:
    """The rows of a candidate: whitened partials by the unknowns that the candidate observes."""

    a: Array
    """Partials, (k, m)."""
    columns: Index
    """Columns of the equations with all candidates, (m,)."""
    new: Index
    """Places among the m columns of those that belong to new unknowns."""


@dataclass(frozen=True, eq=False)
class LinearCandidates:
    """A design and its candidates, linearised at the given values."""

    equations: Equations
    """Equations of the network with all candidates."""
    column: Index
    """Column of ``equations`` for each column of the design, (n_columns of the design,)."""
    rows: tuple[CandidateRows, ...]
    """Rows of each candidate."""


def linearise(
    design: Equations, network: Network, candidates: Sequence[Candidate]
) -> LinearCandidates:
    """Linearise candidates at their planned values.

    Args:
        design: equations of the design.
        network: the design with all candidates.
        candidates: all candidates.
    """
    equations = compile_network(as_planned(network))
    state = equations.unknowns.start()
    equations = equations.weighted_at(state)
    a = partials(LinearisedEquations(equations, state))
    column = np.full(design.unknowns.n_columns, -1, dtype=np.intp)
    for kind, table in design.unknowns.tables.items():
        other = equations.unknowns[kind]
        for number, name in enumerate(table.names):
            there = equations.unknowns.columns(kind, other.number[name])
            column[design.unknowns.columns(kind, number)] = there
    old = np.zeros(equations.unknowns.n_columns, dtype=bool)
    old[column] = True
    owner = owners(equations, candidates)
    out = []
    for n in range(len(candidates)):
        part = a[np.flatnonzero(owner == n)]
        columns = np.unique(part.indices).astype(np.intp)
        columns = columns[equations.unknowns.free[columns]]
        dense = np.asarray(part[:, columns].todense())
        out.append(CandidateRows(dense, columns, np.flatnonzero(~old[columns])))
    return LinearCandidates(equations, column, tuple(out))


def owners(equations: Equations, candidates: Sequence[Candidate]) -> Index:
    """Return the number of the candidate of each row, −1 for rows of the design, (n_rows,).

    The rows of a weighted unknown have no id of an observation; they belong to the candidate that
    adds the unknown.
    """
    owner = np.full(equations.n_rows, -1, dtype=np.intp)
    bringer: dict[tuple[str, str], int] = {}
    network = equations.network
    for n, c in enumerate(candidates):
        for rows in equations.find(c.ids):
            owner[rows] = n
        bringer |= {("point", p.name): n for p in c.points}
        bringer |= {("calibration", k.name): n for k in c.cameras if not k.per_photo}
        for f in c.photos:
            bringer["pose", f.name] = n
            if network.cameras[f.camera].per_photo:
                bringer["calibration", calibration_name(network, f.name)] = n
        for kind, given in c.unknowns.items():
            bringer |= {(kind, parameter_name(key)): n for key in given}
    if bringer:
        for block in equations.blocks:
            if len(block.variables) > 1:
                continue
            ((kind, index),) = block.variables
            names = equations.unknowns[kind].names
            of = np.array([bringer.get((kind, name), -1) for name in names], dtype=np.intp)
            rows = block.first_row + np.arange(len(index) * block.dimension)
            brought = np.repeat(of[index], block.dimension)
            owner[rows] = np.where(owner[rows] < 0, brought, owner[rows])
    return owner


def partials(system: LinearisedEquations) -> csr_array:
    """Return the whitened partials of all rows, (n_rows, n_columns)."""
    equations = system.equations
    values: list[Array] = []
    rows: list[Index] = []
    columns: list[Index] = []
    grouped = np.zeros(equations.n_rows, dtype=bool)
    for c in equations.clusters:
        grouped[c.rows] = True
    for lb in system.blocks:
        n, d = lb.block.observed.shape
        own = lb.block.first_row + np.arange(n * d).reshape(n, d)
        for offset, a in zip(lb.offsets, lb.a, strict=True):
            if not len(a):
                continue
            on = ((offset >= 0)[:, None] & ~grouped[own])[:, :, None]
            full = np.broadcast_to(on, a.shape)
            at = np.broadcast_to((offset[:, None] + np.arange(a.shape[2]))[:, None, :], a.shape)
            values.append(a[full])
            rows.append(np.broadcast_to(own[:, :, None], a.shape)[full])
            columns.append(at[full])
    for cluster, (at, a) in zip(equations.clusters, system.cluster_rows(), strict=True):
        values.append(a.ravel())
        rows.append(np.repeat(cluster.rows, len(at)))
        columns.append(np.tile(at, len(cluster.rows)))
    none = [np.zeros(0)]
    places = (np.concatenate(rows or none), np.concatenate(columns or none))
    shape = (equations.n_rows, equations.unknowns.n_columns)
    out = coo_array((np.concatenate(values or none), places), shape=shape).tocsr()
    out.eliminate_zeros()
    return out


def difference(name: str, design: Network, larger: Network, *, cost: float = 1.0) -> Candidate:
    """Return as a candidate what a larger design adds to a design.

    Both may come from specs, the larger one with further parts behind those of the other: GNSS on
    the photos, a statoscope, a cross strip, a lake. The candidate has the observations, points,
    photos, cameras and other unknowns that the design lacks. Values are those of the larger
    design for what is new, and those of the design for the rest.

    Args:
        name: name of the candidate.
        design: the design.
        larger: the design with the additions. Observations are the same if their ids are.
        cost: cost of the additions.

    Raises:
        InputError: what the design has and the larger one lacks, or holds when the other does
            not: a candidate only adds.
    """
    problems = _lost(design, larger)
    if problems:
        raise InputError(problems)
    grouped = {i for ids, _ in larger.clusters for i in ids}
    groups: list[AnyObservation] = []
    for ids, covariance in larger.clusters:
        new = [i for i in ids if i not in design.observations]
        if new and len(new) < len(ids):
            there = known([i for i in ids if i not in new])
            what = f"is correlated with observations of the design ({there}); add it alone"
            raise InputError(Problem(what, f"observation {new[0]!r}"))
        if new:
            members = tuple(_unnumbered(larger.observations[i]) for i in ids)
            groups.append(Correlated(members, covariance))
    single = [
        _unnumbered(o)
        for i, o in larger.observations.items()
        if i not in design.observations and i not in grouped
    ]
    photo, point, *_ = design.images.columns()
    photos, points = list(design.photos), list(design.points)
    imaged = {(photos[f], points[p]) for f, p in zip(photo.tolist(), point.tolist(), strict=True)}
    images = [
        o
        for o in larger.image_points(np.flatnonzero(~larger.images.is_joint))
        if (o.photo, o.point) not in imaged
    ]
    for group in larger.image_groups():
        members = group.observations
        seen = [o.label() for o in members if (o.photos()[0], o.points()[0]) in imaged]
        if not seen:
            groups.append(group)
        elif len(seen) < len(members):
            what = f"are correlated with image points of the design ({known(seen)}); add all alone"
            raise InputError(Problem(what, f"image points of photo {members[0].photos()[0]!r}"))
    unknowns = {
        kind: {key: p for key, p in given.items() if key not in design.of_kind(kind)}
        for kind, given in larger.parameters.items()
    }
    return Candidate(
        name,
        (*groups, *single, *images),
        cost=cost,
        points=tuple(p for n, p in larger.points.items() if n not in design.points),
        photos=tuple(f for n, f in larger.photos.items() if n not in design.photos),
        cameras=tuple(c for n, c in larger.cameras.items() if n not in design.cameras),
        unknowns={kind: given for kind, given in unknowns.items() if given},
    )


def _unnumbered(o: Observation) -> Observation:
    """Return an observation without an id that is a number, which other candidates have too."""
    ident = o.id
    return replace(o, id=None) if ident is not None and ident.isdecimal() else o


def _lost(design: Network, larger: Network) -> list[Problem]:
    """Return what a design has and another one lacks or holds otherwise."""
    lacks = "is in the design alone; the larger one must have it too"
    problems = []
    for what, mine, other in (
        ("point", design.points, larger.points),
        ("photo", design.photos, larger.photos),
        ("camera", design.cameras, larger.cameras),
        ("observation", design.observations, larger.observations),
    ):
        problems += [Problem(lacks, f"{what} {n!r}") for n in mine if n not in other]
    for n, p in design.points.items():
        other_point = larger.points.get(n)
        if other_point is not None and not np.array_equal(p.fixed, other_point.fixed):
            what = "is held in one of the designs alone; a candidate adds observations of it"
            problems.append(Problem(what, f"point {n!r}"))
    return problems
