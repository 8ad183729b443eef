"""Everything that has arrived and what became of it: in the graph, waiting, suspect, rejected."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ..errors import InputError, Problem, known
from ..graph.image_blocks import find_images
from ..graph.variables import calibration_name
from ..models.variables import UNKNOWNS, VariableKind
from ..network.additions import add_entities
from ..network.entities import Camera, Photo, Point
from ..network.network import Network
from ..network.selection import without
from ..observations import AnyObservation, Correlated, ImagePoint
from ..types import Array
from .local import filtered
from .register import Register
from .retries import Retries
from .units import (
    Unit,
    Variable,
    components,
    identity,
    named,
    pending,
    unit_of,
    variables_of,
)
from .verdicts import Verdict

Kept: TypeAlias = dict[str, tuple[Unit, tuple[Verdict, ...]]]
"""Units that are left out, by their first id, and their verdicts."""


class Book:
    """What there is; the graph has the observations of ``network``."""

    def __init__(self, network: Network) -> None:
        """Start with a network."""
        self.network = network
        self.pool: dict[str, Unit] = {}
        """Units that wait, by their first id."""
        self.suspects: Kept = {}
        self.rejected: Kept = {}
        self.lacks: dict[Variable, str] = {}
        """Why variables are not determined."""
        self.retries = Retries()
        """When what waits was looked at."""
        self.groups: dict[str, Unit] = {}
        """Correlated groups of the graph, by the id of each member."""
        self._place: dict[str, str] = {}
        """First id of the unit that an id belongs to, for what is not in the graph."""
        self._waiting_for: dict[Variable, dict[str, None]] = {}
        """Units in the pool, by what they depend on."""
        self._rays: set[tuple[str, str]] = set()
        """Photo and point of all image points but the rejected ones."""
        self._next = 1
        self.inside: set[str] = set()
        """Ids of the graph."""
        self.changed: dict[str, tuple[Unit | None, Unit | None]] = {}
        """Ids that went somewhere since `watch`: their units then and now."""
        self.filled: dict[VariableKind, dict[str, list[float]]] = {}
        """Approximate values that were written into the network since `watch`."""
        self.unweighted: list[str] = []
        """Weighted unknowns that lost their weights since `watch`."""
        self._index_network()

    def _index_network(self) -> None:
        network = self.network
        photos, points = list(network.photos), list(network.points)
        of_photo, of_point, *_ = network.images.columns()
        self._rays = {
            (photos[f], points[p])
            for f, p in zip(of_photo.tolist(), of_point.tolist(), strict=True)
        }
        self.inside = {*network.observations}
        self.inside |= {identity(o) or "" for o in network.image_points()}
        for ids, covariance in network.clusters:
            members = [named(network.observations[i], i) for i in ids]
            unit = unit_of(network, members, covariance)
            self.groups.update(dict.fromkeys(ids, unit))

    def copy(self) -> Book:
        """Return a book of its own; units are frozen and shared."""
        out = Book.__new__(Book)
        for name, value in vars(self).items():
            setattr(out, name, value.copy() if isinstance(value, dict | set | list) else value)
        out.network, out.retries = self.network.copy(), self.retries.copy()
        out._waiting_for = {v: dict(u) for v, u in self._waiting_for.items()}
        return out

    def watch(self) -> None:
        """Note changes from now on."""
        self.changed, self.filled, self.unweighted = {}, {}, []

    def _note(self, unit: Unit, now: bool) -> None:
        """Note where a unit is taken from, or that it is put somewhere."""
        for i in unit.ids:
            then = self.changed.get(i, (None if now else unit, None))[0]
            self.changed[i] = then, unit if now else None

    # -- what arrives -------------------------------------------------------------------------

    def with_entities(
        self, points: Sequence[Point], photos: Sequence[Photo], cameras: Sequence[Camera]
    ) -> Network:
        """Return the network with new points, cameras and photos.

        Raises:
            InputError: every name that there is already, and unknown cameras.
        """
        out = self.network.copy()
        problems = add_entities(out, points=points, photos=photos, cameras=cameras)
        if problems:
            raise InputError(problems)
        return out

    def units(self, network: Network, observations: Sequence[AnyObservation]) -> list[Unit]:
        """Return the units of new observations, each with its id.

        Raises:
            InputError: unknown names, ids that there are, points measured twice in a photo: all.
        """
        problems: list[Problem] = []
        seen: set[str] = set()
        rays: set[tuple[str, str]] = set()
        for item in observations:
            for o in item.observations if isinstance(item, Correlated) else (item,):
                try:
                    network._check_names(o, seen)
                except InputError as error:
                    problems.extend(error.problems)
                ident = identity(o)
                if isinstance(o, ImagePoint):
                    ray = o.photo, o.point
                    if ray in self._rays or ray in rays:
                        problems.append(
                            Problem("the point is measured in this photo already", o.label())
                        )
                    rays.add(ray)
                elif ident in self._place and ident not in self._rejected_ids():
                    problems.append(Problem(f"duplicate id {ident!r}", o.label()))
        if problems:
            raise InputError(problems)
        out = []
        for item in observations:
            members = item.observations if isinstance(item, Correlated) else (item,)
            covariance = np.asarray(item.covariance) if isinstance(item, Correlated) else None
            out.append(
                unit_of(
                    network,
                    [named(o, identity(o) or self._number(seen)) for o in members],
                    covariance,
                )
            )
        return out

    def _rejected_ids(self) -> set[str]:
        return {i for unit, _ in self.rejected.values() for i in unit.ids}

    def _number(self, taken: set[str]) -> str:
        while (ident := str(self._next)) in self.network.observations or (
            ident in self._place or ident in taken
        ):
            self._next += 1
        self._next += 1
        return ident

    def note_number(self, ident: str) -> None:
        """Note an id that was given out, so that it is not given out again."""
        if ident.isdecimal():
            self._next = max(self._next, int(ident) + 1)

    def joined(
        self, late: Sequence[Unit], register: Register, *, without: Collection[str] = ()
    ) -> list[list[Unit]]:
        """Return new units with those of the pool that hang together by what is not known.

        Args:
            late: new units.
            register: what is known.
            without: first ids of units of the pool that are left alone.
        """
        new = {u.ids[0]: u for u in late}
        of: dict[Variable, list[str]] = {}
        for key, unit in new.items():
            for v in pending(register, unit):
                of.setdefault(v, []).append(key)
        done: set[str] = set()
        seen: set[Variable] = set()
        out = []
        for key in new:
            if key in done:
                continue
            found: dict[str, Unit] = {}
            stack = [key]
            while stack:
                k = stack.pop()
                if k in found:
                    continue
                unit = new.get(k) or self.pool[k]
                found[k] = unit
                for v in pending(register, unit):
                    if v in seen:
                        continue
                    seen.add(v)
                    stack += [n for n in of.get(v, ()) if n not in found]
                    others = self._waiting_for.get(v, ())
                    stack += [n for n in others if n not in found and n not in without]
            done |= found.keys()
            order = [k for k in self.pool if k in found and k not in new]
            order += [k for k in new if k in found]
            out.append([found[k] for k in order])
        return out

    def beside(self, ids: Iterable[str], register: Register) -> list[Unit]:
        """Return the other units of the pool that hang together with those of some ids."""
        keys = {self._place[i] for i in ids if i in self._place}
        going = [self.pool[k] for k in self.pool if k in keys]
        return [u for some in self.joined(going, register) for u in some if u.ids[0] not in keys]

    def awake(
        self, register: Register, variables: Iterable[Variable], spared: Collection[str]
    ) -> list[Unit]:
        """Return the units of the pool that touch variables and may enter by now.

        Args:
            register: what is known.
            variables: what has become known.
            spared: keys of units that were not looked at.
        """
        keys = dict.fromkeys(k for v in variables for k in self._waiting_for.get(v, ()))
        return [self.pool[k] for k in keys if k in spared or not pending(register, self.pool[k])]

    def waiting_for(self, variables: Iterable[Variable]) -> set[str]:
        """Return the keys of the units of the pool that depend on some variables."""
        return {k for v in variables for k in self._waiting_for.get(v, ())}

    @property
    def n_rows_waiting(self) -> int:
        """Number of scalar rows that wait."""
        return sum(u.n_scalars for u in self.pool.values())

    # -- where it goes ------------------------------------------------------------------------

    def enter(self, unit: Unit) -> None:
        """Put a unit into the network."""
        for i in unit.ids:
            if i in self._place:
                self.pull(i)
        self.network.add(unit.item)
        self.inside.update(unit.ids)
        self._note(unit, True)
        if unit.covariance is not None:
            self.groups.update(dict.fromkeys(unit.ids, unit))
        self._see(unit, True)

    def wait(self, units: Iterable[Unit]) -> None:
        """Put units into the pool."""
        for unit in units:
            if self.pool.get(unit.ids[0]) is unit:
                continue
            self._take_from_rejected(unit)
            self.pool[unit.ids[0]] = unit
            self._note(unit, True)
            self._place.update(dict.fromkeys(unit.ids, unit.ids[0]))
            self._see(unit, True)
            for v in unit.variables:
                self._waiting_for.setdefault(v, {})[unit.ids[0]] = None

    def reject(self, units: Iterable[Unit], verdicts: tuple[Verdict, ...] = ()) -> None:
        """Put units among the rejected ones."""
        for unit in units:
            told = verdicts or tuple(
                Verdict(i, o.kind, o.label(), "rejected", points=unit.points)
                for i, o in zip(unit.ids, unit.observations, strict=True)
            )
            self._leave_out(self.rejected, unit, told)
            self._see(unit, False)

    def _take_from_rejected(self, unit: Unit) -> None:
        """Forget what was rejected under the ids of a unit that comes in its place."""
        for i in unit.ids:
            if self._place.get(i) in self.rejected:
                self.pull(i)

    def _leave_out(self, where: Kept, unit: Unit, verdicts: tuple[Verdict, ...]) -> None:
        for i in unit.ids:  # it may have waited
            self.pull(i)
        where[unit.ids[0]] = unit, verdicts
        self._note(unit, True)
        self._place.update(dict.fromkeys(unit.ids, unit.ids[0]))
        self._see(unit, True)

    def suspect(self, unit: Unit, verdicts: tuple[Verdict, ...]) -> None:
        """Put a unit among the suspects."""
        self._leave_out(self.suspects, unit, verdicts)

    def _see(self, unit: Unit, there: bool) -> None:
        for o in unit.observations:
            if isinstance(o, ImagePoint):
                (self._rays.add if there else self._rays.discard)((o.photo, o.point))

    def pull(self, ident: str) -> Unit | None:
        """Take the unit of an id out of pool, suspects or rejected ones; none if it is in none."""
        key = self._place.get(ident)
        if key is None:
            return None
        unit = self.pool.pop(key, None)
        if unit is not None:
            self.retries.forget(key)
            for v in unit.variables:
                self._waiting_for[v].pop(key, None)
                if not self._waiting_for[v]:
                    del self._waiting_for[v]
        else:
            kept = self.suspects.pop(key, None) or self.rejected.pop(key, None)
            assert kept is not None
            unit = kept[0]
        for i in unit.ids:
            del self._place[i]
        self._note(unit, False)
        self._see(unit, False)
        return unit

    def remove(self, unit: Unit) -> None:
        """Take a unit out of the network."""
        network = self.network
        self._note(unit, False)
        self.inside.difference_update(unit.ids)
        self._see(unit, False)
        if unit.covariance is not None:
            for i in unit.ids:
                del self.groups[i]
            network.clusters = [c for c in network.clusters if c[0] != unit.ids]
        for i, o in zip(unit.ids, unit.observations, strict=True):
            if i in network.observations:
                del network.observations[i]
            else:
                assert isinstance(o, ImagePoint)
                photo, point, *_ = network.images.columns()
                network.image_mask(
                    (photo != network._photo_number[o.photo])
                    | (point != network._point_number[o.point])
                )

    def take_all(self) -> list[Unit]:
        """Take every observation out of the network; return their units."""
        network = self.network
        out: dict[str, Unit] = {}
        for ident, o in network.observations.items():
            unit = self.groups.get(ident)
            if unit is None:
                unit = unit_of(network, [named(o, ident)], None)
            out.setdefault(unit.ids[0], unit)
        for image in network.image_points():
            unit = unit_of(network, [image], None)
            out[unit.ids[0]] = unit
        for unit in out.values():
            self._note(unit, False)
        self.inside = set()
        network.observations, network.clusters = {}, []
        network.image_mask(np.zeros(network.n_image_points, dtype=bool))
        self.groups = {}
        return list(out.values())

    def unweight(self, ids: Sequence[str]) -> None:
        """Take the weights of weighted unknowns, named as in ``solution.observations``."""
        self.network = without(self.network, ids)
        self.unweighted += ids

    # -- finding ------------------------------------------------------------------------------

    def in_graph(self, ident: str) -> bool:
        """Return whether an observation of this id is in the graph."""
        return ident in self.inside

    def has(self, ident: str) -> bool:
        """Return whether there is an observation of this id anywhere."""
        return ident in self._place or self.in_graph(ident)

    def _image_row(self, ident: str) -> int | None:
        network = self.network
        if not network.n_image_points:
            return None
        photo, point, *_ = network.images.columns()
        own = {name: row for row, name in network.images.ids.items()}
        row = int(
            find_images(photo, point, list(network.photos), list(network.points), own, [ident])[0]
        )
        return row if row >= 0 else None

    def unit(self, ident: str) -> Unit:
        """Return the unit of an id, wherever it is."""
        found = self.unit_or_none(ident)
        if found is None:
            raise InputError(Problem("unknown observation", f"observation {ident!r}"))
        return found

    def unit_or_none(self, ident: str) -> Unit | None:
        """Return the unit of an id; none where there is no such observation."""
        key = self._place.get(ident)
        if key is not None:
            if key in self.pool:
                return self.pool[key]
            return (self.suspects.get(key) or self.rejected[key])[0]
        if ident in self.groups:
            return self.groups[ident]
        network = self.network
        if ident in network.observations:
            return unit_of(network, [named(network.observations[ident], ident)], None)
        row = self._image_row(ident)
        if row is None:
            return None
        photo, point, xy, sigma = (c[row] for c in network.images.columns())
        image = ImagePoint(
            list(network.photos)[photo],
            list(network.points)[point],
            float(xy[0]),
            float(xy[1]),
            sigma=(float(sigma[0]), float(sigma[1])),
            id=network.images.ids.get(row),
            source=network.images.sources.get(row),
        )
        return unit_of(network, [image], None)

    def why(self, unit: Unit, register: Register) -> str:
        """Return what a unit of the pool lacks."""
        found = dict.fromkeys(
            self.lacks.get(v) or f"{UNKNOWNS[v[0]].noun} {v[1]!r} is not determined yet"
            for v in pending(register, unit)
        )
        return "; ".join(found)

    # -- deciding later -----------------------------------------------------------------------

    def forget(self, ids: set[str]) -> list[Unit]:
        """Drop ids from pool, suspects and rejected ones; return what remains of their groups."""
        left = []
        for ident in sorted(ids):
            unit = self.pull(ident)
            if unit is None:
                continue
            for v in unit.variables:
                if v not in self._waiting_for:  # nothing lacks anything of it
                    self.lacks.pop(v, None)
            if unit.covariance is not None:
                rest = unit.without(self.network, ids)
                if rest is not None:
                    left.append(rest)
        return left

    def release(self, ids: Sequence[str]) -> list[Unit]:
        """Take suspects or rejected ones out of their list, to be put in.

        Raises:
            InputError: ids that are neither.
        """
        problems = [
            Problem("is neither suspect nor rejected", f"observation {i!r}")
            for i in ids
            if self._place.get(i) not in self.suspects | self.rejected
        ]
        problems += [
            Problem("the point has been measured in this photo again since", f"observation {i!r}")
            for i in ids
            if not problems
            and self._place[i] in self.rejected
            and any(
                isinstance(o, ImagePoint) and (o.photo, o.point) in self._rays
                for o in self.rejected[self._place[i]][0].observations
            )
        ]
        if problems:
            raise InputError(problems)
        return [unit for i in ids if (unit := self.pull(i)) is not None]

    def discard(self, ids: Sequence[str]) -> None:
        """Move suspects to the rejected ones.

        Raises:
            InputError: ids that are no suspects.
        """
        suspects = [i for u, _ in self.suspects.values() for i in u.ids]
        problems = [
            Problem(
                f"is no suspect; suspects: {known(suspects)}",
                f"observation {i!r}",
            )
            for i in ids
            if self._place.get(i) not in self.suspects
        ]
        if problems:
            raise InputError(problems)
        for i in ids:
            key = self._place.get(i)
            if key in self.suspects:
                unit, told = self.suspects[key]
                self.pull(i)
                self.reject([unit], tuple(replace(v, verdict="rejected") for v in told))

    # -- the network --------------------------------------------------------------------------

    def fill(self, register: Register) -> None:
        """Write approximate values that were found into the network, where none were given."""
        kinds: tuple[VariableKind, ...] = ("point", "pose")
        for kind in kinds:
            table = register[kind]
            for number, name in enumerate(table.names):
                if self._lacks_value(kind, name):
                    self.fill_value(kind, name, table.given.view[number])

    def _lacks_value(self, kind: VariableKind, name: str) -> bool:
        if kind == "point":
            x, y, z = self.network.points[name].coordinates
            return x != x or y != y or z != z
        photo = self.network.photos[name]
        return photo.position is None or photo.rotation is None

    def fill_value(self, kind: VariableKind, name: str, value: Array) -> None:
        """Write an approximate value of a point or photo where none is given."""
        if kind == "point":
            point = self.network.points[name]
            given = np.array(point.coordinates)
            if np.isnan(given).any():
                found = np.where(np.isnan(given), value, given)
                self.network.points[name] = replace(point, coordinates=tuple(found.tolist()))
                self.filled.setdefault(kind, {})[name] = found.tolist()
        else:
            photo = self.network.photos[name]
            if photo.position is None or photo.rotation is None:
                self.filled.setdefault(kind, {})[name] = np.array(value).tolist()
            if photo.position is None:
                photo = replace(photo, position=tuple(value[9:].tolist()))
            if photo.rotation is None:
                photo = replace(photo, rotation=np.array(value[:9]).reshape(3, 3))
            self.network.photos[name] = photo

    def adjustable(self) -> Network:
        """Return the network without unknowns that none of its observations touches."""
        network = self.network
        touched = {v for o in network.observations.values() for v in variables_of(network, o)}
        photos, points = list(network.photos), list(network.points)
        of_photo, of_point, *_ = network.images.columns()
        for i in np.unique(of_photo).tolist():
            touched |= {("pose", photos[i]), ("calibration", calibration_name(network, photos[i]))}
        touched.update(("point", points[i]) for i in np.unique(of_point).tolist())

        def stays(kind: VariableKind, name: str) -> bool:
            free, weighted = components(network, (kind, name))
            return free == weighted or (kind, name) in touched

        return filtered(network, stays)

    def status(self, ident: str) -> str:
        """Return what became of an id: ``gone`` where there is none."""
        key = self._place.get(ident)
        if key is not None:
            if key in self.pool:
                return "waiting"
            return "suspect" if key in self.suspects else "rejected"
        return "accepted" if ident in self.inside else "gone"
