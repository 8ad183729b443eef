"""Arriving units beside a system: between known variables, or with new ones."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..graph.dependence import Variable
from ..quality.leave_out import Tested
from ..solve.update import Update
from ..types import Array, Index
from .border import Watched
from .forms import Forms
from .judging import MOVES, Place
from .system import System
from .units import Unit


@dataclass(frozen=True, eq=False)
class Beside:
    """Units as rows beside a system, as `judging.Joint`."""

    system: System
    """The system without them."""
    forms: Forms
    """Their linear forms."""
    slots: Mapping[int, int]
    """Slots of the system's points with theirs."""
    update: Update
    """The update with all of them."""

    @classmethod
    def of(cls, system: System, forms: Forms) -> Beside | None:
        """Put forms beside a system; none where a new base has to take them in."""
        own = forms.columns[forms.columns < system.unknowns.n_columns]
        slots = system.lifted.with_slots(own, system.slots)
        too_many = len(system.update.signs) + len(forms.v) > system.most_beside
        if too_many or not system.has_room(slots):
            return None
        f = replace(system, slots=slots).expand(forms.columns, forms.a)
        update = system.update.with_rows(f.at, f.b, forms.residuals)
        return cls(system, forms, slots, update) if update.trusted else None

    def some(self, chosen: Sequence[int]) -> Beside | None:
        """Return some of the units beside the system."""
        if len(chosen) == len(self.units):
            return self
        return Beside.of(self.system, self.forms.some(chosen))

    @cached_property
    def after(self) -> System:
        """The system with the units."""
        before = len(self.system.update.signs)
        new = {
            unit.ids[0]: before + own for unit, own in zip(self.units, self.forms.rows, strict=True)
        }
        joined = {**self.system.joined, **new}
        system = replace(self.system, update=self.update, joined=joined, slots=self.slots)
        if not system.border.unknowns:
            return system
        watched = Watched.of(self.forms, system.border, system.unknowns.n_columns)
        return replace(system, border=system.border.watching(watched))

    @property
    def units(self) -> tuple[Unit, ...]:
        """The units."""
        return self.forms.units

    @property
    def raw(self) -> tuple[Array, ...]:
        """L of each unit with Σ = L Lᵀ."""
        return self.forms.raw

    def tested(self) -> Tested:
        """Return the units, to be tested against everything else."""
        new = len(self.system.update.signs) + np.arange(len(self.forms.v))
        inverse = self.update.inverse
        m = inverse[np.ix_(new, new)]
        return Tested(self.forms.rows, inverse[new] @ self.update.residuals, lambda u: m[:, u])

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns with the rows of a unit, (m, d)."""
        rows: Index = len(self.system.update.signs) + self.forms.rows[i]
        f = self.after.expand(columns, np.eye(len(columns)))
        return self.update.gain(f.at, f.b)[:, rows]

    def place(self, name: str) -> Place:
        """Return a point with all units in."""
        point: Variable = ("point", name)
        columns = self.after.columns(*point)
        variance = np.diag(self.after.cofactors(point, point)) if len(columns) else np.zeros(0)
        return Place(columns, self.after.free(columns), variance)

    def held_by(self, i: int, combinations: Array, new: Collection[Variable]) -> set[Variable]:
        """Return which of new variables combinations (d, n) of a unit's rows determine.

        What was known stays known without them.
        """
        system, rows = self.system, len(self.system.update.signs) + self.forms.rows[i]
        out: set[Variable] = set()
        for variable in set(new) & system.border.unknowns.keys():
            columns = system.border.unknowns[variable].columns
            place = system.border.place[columns]
            place = place[place >= 0]
            motion = self.update.parts.k[np.ix_(place, rows)] @ combinations
            weight = np.linalg.norm(self.update.border[:, place], axis=0)
            if (np.abs(motion).max(axis=1) * weight > MOVES).any():
                out.add(variable)
        return out
