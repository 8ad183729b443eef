"""Choice of the section of a large network to adjust, or of the whole; pieces of an arrival."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..graph.equations import Equations, compile_network
from ..ledger.excerpts import excerpt
from ..ledger.ledger import Ledger
from ..ledger.row_store import NO_PHOTO
from ..ledger.waiting_observations import Candidates, NothingKnown
from ..models.unknown_registry import VariableKind
from ..solve.added_factors import marginal_prior
from ..types import Array, Index
from .front_system import FrontSystem
from .section import Looked, Section

MAX_SECTION_UNKNOWNS = 600
"""Largest number of unknowns of the reduced system in a section: their cofactors are dense."""
MIN_SIZE_RATIO = 3
"""Smallest ratio of the rays of the whole network to those of a section."""
MIN_NETWORK_RAYS = 10_000
"""Smallest number of rays of a network that is adjusted in sections: in smaller ones the whole is
adjusted about as fast."""
MAX_SECTION_WORK = 1.0
"""Ratio of the rays of all sections adjusted since the whole was, to those of the whole, from which
the whole is adjusted again."""
MAX_RAYS_PER_PIECE = 1_000
"""Number of rays in one piece of an arrival in a large network, to the end of a photo: the time of
a search for gross errors among new rays grows faster than their number."""


def in_pieces(ledger: Ledger, n_rays: int, rows: Index) -> list[Index]:
    """Divide an arrival in a large network into pieces of one or a few photos.

    Other observations belong to the piece of the last photo that they name, or to the last piece.

    Args:
        ledger: where the observations are stored.
        n_rays: number of image points in the graph.
        rows: the arriving observations.

    Returns:
        The pieces, in the order in which the photos arrived; one of everything in small networks.
    """
    rays = ledger.rows.images(rows)
    if (
        n_rays < MIN_NETWORK_RAYS
        or len(rays) <= MAX_RAYS_PER_PIECE
        or MIN_SIZE_RATIO * len(rays) > n_rays
    ):
        return [rows]
    photos, first, counts = np.unique(
        ledger.rows.photo[rays], return_index=True, return_counts=True
    )
    order = np.argsort(first)
    number = np.full(len(ledger.names.photos), np.iinfo(np.intp).max)
    number[photos[order]] = np.cumsum(counts[order]) // MAX_RAYS_PER_PIECE
    piece = np.full(len(rows), number.max())
    is_ray = ledger.rows.photo[rows] != NO_PHOTO
    piece[is_ray] = number[ledger.rows.photo[rows[is_ray]]]
    places = np.flatnonzero(~is_ray)
    for place, (_, unit) in zip(places.tolist(), ledger.rows.units(rows), strict=True):
        poses = [ledger.names.photo[name] for kind, name in unit.variables if kind == "pose"]
        piece[place] = max((number[f] for f in poses), default=piece[place])
    return [rows[piece == k] for k in np.unique(piece).tolist()]


def is_due(section: Section) -> bool:
    """Return whether the whole has to be adjusted again."""
    return section.work > MAX_SECTION_WORK * section.base.equations.n_rays


class UnknownsOfRest:
    """Unknowns whose weights are in the information of the rest."""

    def __init__(self, outer: FrontSystem, inside: set[tuple[VariableKind, str]]) -> None:
        """Store the unknowns of a network without those of its section."""
        self.outer, self.inside = outer, inside

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether the rest knows an unknown."""
        return (kind, name) in self.inside

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return the value of an unknown in the rest; None: the rest does not know it."""
        return self.outer.value(kind, name) if self.known(kind, name) else None


def section_of(ledger: Ledger, system: FrontSystem) -> tuple[Equations, Section] | None:
    """Return the section of what has arrived; None where the whole has to be adjusted.

    Args:
        ledger: the ledger.
        system: the known variables.
    """
    outer = system.whole
    rows, n = ledger.rows, ledger.rows.n
    if not len(outer.rows) or system.doubt or outer.doubt or outer.base.datum is not None:
        return None
    if not outer.lifted.slots or (outer.update.signs < 0).any():
        return None
    all_rays = outer.base.equations.n_rays
    if all_rays < MIN_NETWORK_RAYS:
        return None
    inside, before = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    inside[ledger.having("accepted")] = True
    before[outer.rows] = True
    rays = rows.photo != NO_PHOTO
    changed = inside != before
    if (changed & before & ~rays).any():
        return None  # the information of the rest has changed
    unknowns = outer.unknowns
    points = {ledger.names.points[p] for p in np.unique(rows.point[changed & rays]).tolist()}
    units = [u for _, u in rows.units(np.flatnonzero(changed))]
    points |= {name for u in units for name in u.points}
    table = unknowns["point"]
    known = [name for name in points if name in table.number]
    first = table.offset[[table.number[name] for name in known]]
    reduced = first >= 0
    reduced[reduced] = outer.lifted.place[first[reduced]] < 0
    seen = [name for name, on in zip(known, reduced.tolist(), strict=True) if on]
    of_points = np.zeros(len(ledger.names.points), dtype=bool)
    of_points[[ledger.names.point[name] for name in seen]] = True
    if (changed & before & ~of_points[rows.point]).any():
        return None  # the information of the rest on them has changed
    mine = inside & (changed | (rays & of_points[rows.point]))
    own = set(seen)
    mine[[row for row, u in rows.units(np.flatnonzero(inside)) if own & {*u.points}]] = True
    size = int((mine & rays).sum())
    work = size + (system.section.work if system.section else 0)
    if MIN_SIZE_RATIO * size > all_rays:
        return None
    looked = system.section.looked if system.section else None
    if looked is not None:
        looked = Looked(looked.movement, looked.drift)
    elif outer.drift is not None:
        looked = Looked(None, outer.drift)
    return _joined(ledger, outer, np.flatnonzero(mine), own, work, looked, system.section)


def _joined(
    ledger: Ledger,
    outer: FrontSystem,
    rows: Index,
    points: set[str],
    work: int,
    looked: Looked | None,
    before: Section | None,
) -> tuple[Equations, Section] | None:
    """Return a section of some rows; None: it is too large.

    Args:
        ledger: the ledger.
        outer: the whole network.
        rows: the rows.
        points: the points P.
        work: see `Section`.
        looked: see `Section`.
        before: the section until now; None: there was none.
    """
    unknowns, base = outer.unknowns, outer.base
    table = unknowns["point"]
    numbers = np.array(sorted(table.number[name] for name in points), dtype=np.intp)
    of_points = base.equations.touching("point", numbers)
    touched: Index = np.unique(base.normal().system.sparse(of_points).indices).astype(np.intp)
    known = set(unknowns.owners(touched[outer.lifted.place[touched] >= 0]))
    for kind, name in Candidates(ledger, NothingKnown(), rows).links.variables:
        number = unknowns[kind].number.get(name, -1)
        if number >= 0 and unknowns[kind].offset[number] >= 0:
            known.add((kind, name))
    known -= {("point", name) for name in points}
    columns: Index = np.sort(np.concatenate([touched[:0], *(outer.columns(*v) for v in known)]))
    if len(columns) > MAX_SECTION_UNKNOWNS:
        return None
    network = excerpt(ledger, UnknownsOfRest(outer, known), rows, hold=False)
    try:
        equations = compile_network(network)
    except InputError:
        return None
    if any(name not in equations.unknowns[kind].number for kind, name in known):
        return None
    spread = _spread(outer, columns, before)
    found = marginal_prior(
        base.normal(),
        columns,
        spread[outer.lifted.place[columns]],
        table.offset[numbers][:, None] + np.arange(3),
        of_points,
    )
    if found is None:
        return None
    section = Section(
        base, outer.lifted, outer.rows, outer.drift, columns, spread, found, of_points, work, looked
    )
    return equations, section


def _spread(outer: FrontSystem, columns: Index, before: Section | None) -> Array:
    """Return the cofactors of all coordinates with T (size, m), keeping those computed before."""
    out = np.empty((outer.lifted.size, len(columns)))
    kept = np.zeros(len(columns), dtype=bool)
    if before is not None and before.lifted is outer.lifted:
        kept = np.isin(columns, before.columns)
        out[:, kept] = before.spread[:, np.searchsorted(before.columns, columns[kept])]
    at = outer.lifted.place[columns[~kept]]
    if len(at):
        out[:, ~kept] = outer.lifted.times(at, np.eye(len(at)))
    return out
