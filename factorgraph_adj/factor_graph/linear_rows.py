"""Linear rows v(θ) + A(θ) δ of observations: what they miss, diagonal of N, marks for undoing.

Rows of one sort are evaluated at once, whenever they have arrived. An unknown is the movement δ of
a variable from its point of linearisation θ, with x = θ ⊞ δ. What the linear rows miss is measured
and not supposed: the gap r = v(x) − (v(θ) + A(θ) δ) of whitened rows moves no estimate by more than
|r| times its standard deviation, as |Q^½ Aᵀ r| ≤ |r|. The whole gradient that they miss, by the
change dA of their partials too, is g = Σ (dAᵀ v(x) + Aᵀ r), with signs over all rows: it moves no
estimate by more than √gᵀQg ≤ Σ|g_c| σ_c standard deviations, to the first order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from weakref import WeakSet

import numpy as np

from ..errors import InputError
from ..frames import Frame
from ..types import NO_ROWS, Array, Index, Mask
from .correlated_units import CorrelatedUnits, Stacked, WideForm, correlated_units, wide_form
from .linearisation_points import LinearisationPoints
from .row_arrays import Arriving, Grown, Mark, Rows, Sort, WholeBlockError, sort_of

SIGMA_CHANGE_SHARE = 0.5
"""What the change of a standard deviation, relative to itself, counts in a gap."""
PROBE = 0.1
"""Step of a column, in conditional standard deviations 1/√N_jj, with which it is measured how much
rows bend."""
UNBOUNDED, TINY = 1e9, 1e-300
"""Curvature of a row for which it is not known; and a divisor in the place of 0."""


class LinearRows(LinearisationPoints):
    """Observations as linear rows."""

    def __init__(self, frame: Frame) -> None:
        """Begin with nothing.

        Args:
            frame: frame of the coordinates.
        """
        super().__init__()
        self.frame = frame
        self.sorts: dict[Sort, int] = {}
        """Number of each sort."""
        self.rows: list[Rows] = []
        """Observations of each sort."""
        self.unit: dict[str, int] = {}
        """Unit of the observation with an id; of weighted unknowns, by their names."""
        self._named: list[tuple[str, int, int | None]] = []
        """Ids in the order in which they got units, with these and the units before."""
        self._members = Grown(2, dtype=np.intp)
        """Sort and row of each observation, by units."""
        self._first_member = Grown(dtype=np.intp)
        """First member of each unit; its last is before the first of the next unit."""
        self._whitener: dict[int, Array] = {}
        """What whitens a correlated unit."""
        self._gap = Grown()
        """Square of the gap of each unit."""
        self._inside = Grown(dtype=bool)
        """Whether each unit is in."""
        self._marks: WeakSet[Mark] = WeakSet()
        """Marks that may be gone back to."""

    # -- observations and variables that are added, and dropped ----------------------------------

    def _place(self, arriving: Arriving, new: dict[int, list[Index]]) -> None:
        """Give observations their places, and note their rows by sort."""
        equations, state = arriving
        tables = equations.unknowns.tables
        places = {
            kind: self._numbers(kind, table, state[kind])
            for kind, table in tables.items()
            if table.names
        }
        group = np.full(equations.n_rows, -1)
        for number, cluster in enumerate(equations.clusters):
            group[cluster.rows] = number
        begin, of_unit = self._first_member.n, dict[str | int, int]()
        unit, member = [NO_ROWS], [np.zeros((0, 2), dtype=np.intp)]
        for block in equations.blocks:
            if not block.n:
                continue
            sort = self.sorts.setdefault(sort_of(block), len(self.rows))
            if sort == len(self.rows):
                self.rows.append(Rows(block))
            joint = group[block.rows].reshape(block.n, -1)[:, 0]
            # Several axes of an observation of coordinates are one unit, and so is a group.
            names = (
                f"{block.kind} {ident}" if number < 0 else number
                for ident, number in zip(block.ids, joint.tolist(), strict=True)
            )
            found = [of_unit.setdefault(name, begin + len(of_unit)) for name in names]
            for ident, number in dict(zip(block.ids, found, strict=True)).items():
                self._named.append((ident, number, self.unit.get(ident)))
                self.unit[ident] = number
            units = np.array(found, dtype=np.intp)
            numbers = [places[kind][index] for kind, index in block.variables]
            at = self.rows[sort].extend(block, numbers, units, joint >= 0, equations.network)
            new.setdefault(sort, []).append(at)
            unit.append(units)
            member.append(np.stack([np.full(block.n, sort), at], axis=1))
        units = np.concatenate(unit)
        order = np.argsort(units, kind="stable")
        count = np.bincount(units - begin, minlength=len(of_unit))
        self._first_member.extend(self._members.n + np.cumsum(count) - count)
        self._members.extend(np.concatenate(member)[order])
        for number, cluster in enumerate(equations.clusters):
            self._whitener[of_unit[number]] = cluster.whitener[:, np.argsort(cluster.rows)]

    def _forget(self, n: int) -> None:
        """Drop all units but the first n, which are out."""
        for rows in self.rows:
            rows.cut(int(np.searchsorted(rows.unit.values, n)))
        while self._named and self._named[-1][1] >= n:
            ident, _, before = self._named.pop()
            if before is None:
                del self.unit[ident]
            else:
                self.unit[ident] = before
        for unit in [u for u in self._whitener if u >= n]:
            del self._whitener[unit]
        if n < self._first_member.n:
            self._members.cut(int(self._first_member.values[n]))
            self._first_member.cut(n)

    # -- rows ------------------------------------------------------------------------------------

    def _members_of(self, units: Index) -> tuple[Index, Index, Index]:
        """Return the members of units: place of the unit, sort and row, by unit."""
        ends = np.append(self._first_member.values[1:], self._members.n)
        first = self._first_member.values[units]
        count = ends[units] - first
        place = np.repeat(np.arange(len(units)), count)
        at = np.arange(len(place)) + (first - np.cumsum(count) + count)[place]
        sort, row = self._members.values[at].T
        return place, sort, row

    def _by_sort(self, sort: Index, row: Index) -> Iterable[tuple[int, Index, Index]]:
        """Iterate over sorts with their rows, and the places of these."""
        for each in np.unique(sort).tolist():
            at = np.flatnonzero(sort == each)
            yield each, row[at], at

    def _forms(self, sort: int, rows: Index) -> Iterable[tuple[Array, Index]]:
        """Iterate over the partials (k, d, s) and columns (k, s), −1 held, of each variable."""
        own = self.rows[sort]
        for j, kind in enumerate(own.kinds):
            a = own.a[j].values[rows] if own.a else np.zeros((len(rows), 1, 0))
            columns = self.tables[kind].column.values[own.index.values[rows, j]]
            yield a, columns[:, : a.shape[2]]

    def _linear(self, sort: int, rows: Index) -> Array:
        """Return v + A δ of rows, (k, d), whitened as `Rows.v`."""
        out: Array = self.rows[sort].v.values[rows].copy()
        for a, at in self._forms(sort, rows):
            out += np.einsum("nij,nj->ni", a, np.where(at >= 0, self._delta.values[at], 0.0))
        return out

    def _weigh(self, sort: int, rows: Index, sign: float) -> None:
        """Add rows to the diagonal of N, or take them from it; groups are for `_weigh_groups`."""
        rows = rows[~self.rows[sort].joint.values[rows]]
        for a, columns in self._forms(sort, rows):
            on = columns >= 0
            np.add.at(self._diagonal.values, columns[on], sign * (a**2).sum(axis=1)[on])

    def _groups(self, units: Index) -> list[int]:
        """Return which of some units are correlated."""
        return [u for u in units.tolist() if u in self._whitener] if self._whitener else []

    def _weigh_groups(self, units: Index, sign: float) -> None:
        """Add correlated units to the diagonal of N, or take them from it."""
        for group in self._correlated(np.array(self._groups(units), dtype=np.intp)):
            square = sign * (group.a**2).sum(axis=1)
            for on, columns in group.columns(self._first.values):
                np.add.at(self._diagonal.values, columns, square[:, on])

    def _sequences(self, units: Index) -> Iterable[tuple[Index, tuple[int, ...], Index]]:
        """Iterate over units whose members have the same sorts in the same order.

        Returns:
            Places of the units, the sorts, and the rows of the members, (n, members).
        """
        place, sort, row = self._members_of(units)
        begin = np.searchsorted(place, np.arange(len(units)))
        of_sorts: dict[tuple[int, ...], list[int]] = {}
        for i, own in enumerate(np.split(sort, begin[1:])):
            of_sorts.setdefault(tuple(own.tolist()), []).append(i)
        for sorts, some in of_sorts.items():
            at = np.array(some, dtype=np.intp)
            yield at, sorts, row[begin[at][:, None] + np.arange(len(sorts))]

    def _whiteners(self, units: Index, size: int) -> Array:
        """Return W of units, (n, k, k); what is not correlated is whitened."""
        one = np.eye(size)
        return np.array([self._whitener.get(u, one) for u in units.tolist()])

    def _correlated(self, units: Index) -> Iterable[CorrelatedUnits]:
        """Iterate over units of several rows, whitened, those of one pattern together."""
        if not len(units):
            return
        for at, sorts, rows in self._sequences(units):
            v = [self.rows[s].v.values[own] for s, own in zip(sorts, rows.T, strict=True)]
            forms = [self._wide_forms(s, own) for s, own in zip(sorts, rows.T, strict=True)]
            whiteners = self._whiteners(units[at], sum(part.shape[1] for part in v))
            yield from correlated_units(units[at], whiteners, v, forms)

    def _wide_forms(self, sort: int, rows: Index) -> list[WideForm]:
        """Return the partials of rows by all columns of each variable."""
        return [
            wide_form(a, columns, self._key.values, self._first.values, self._size.values)
            for a, columns in self._forms(sort, rows)
        ]

    def _stacked(self, units: Index) -> Stacked:
        """Return units as one system of rows."""
        place, sort, row = self._members_of(units)
        size = np.array([own.v.values.shape[1] for own in self.rows], dtype=np.intp)[sort]
        ends = np.cumsum(size)
        v, found = np.zeros(int(size.sum())), list[tuple[Index, Array, Index]]()
        touched = np.zeros(self._first.n, dtype=bool)
        for each, rows, at in self._by_sort(sort, row):
            lines = (ends - size)[at][:, None] + np.arange(size[at[0]])
            v[lines] = self.rows[each].v.values[rows]
            for a, columns in self._forms(each, rows):
                touched[self._key.values[columns[columns >= 0]]] = True
                found.append((lines, a, columns))
        every = np.flatnonzero(touched[self._key.values])
        out = np.zeros((len(v), len(every)))
        for lines, a, columns in found:
            i, j = np.nonzero(columns >= 0)
            out[lines[i], np.searchsorted(every, columns[i, j])[:, None]] += a[i, :, j]
        last = np.cumsum(np.bincount(place, size, minlength=len(units))).astype(np.intp)
        rows_of = np.split(np.arange(len(v)), last[:-1]) if len(units) else []
        if self._whitener:
            for unit, own in zip(units.tolist(), rows_of, strict=True):
                if (w := self._whitener.get(unit)) is not None:
                    out[own], v[own] = w @ out[own], w @ v[own]
        return Stacked(out, v, every, rows_of)

    def _measure_curvatures(self, bounds: Callable[[Index], Array]) -> None:
        """Measure how much rows bend that have entered since this was done last.

        A step h of column j changes the partials of a row by dA. In units of the row's σ,

            q_j = Σ_k |dA_k/h| σ_k

        is what a unit of δ_j changes of the row's contribution to standard deviations, see
        `_measure_gaps`, and times |δ_k|/σ_k ≤ t it is what a unit of δ_j adds to the gap.

        Args:
            bounds: returns upper bounds of the standard deviations of columns.
        """
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        for sort, own in enumerate(self.rows):
            if not own.curvature:
                continue
            new = self._inside.values[own.unit.values]
            new &= np.any([np.isnan(b.values).any(axis=1) for b in own.curvature], axis=0)
            rows = np.flatnonzero(new)
            if not len(rows):
                continue
            forms = list(self._forms(sort, rows))
            steps, sigma = list[Array](), list[Array]()
            for j, (kind, (_, at)) in enumerate(zip(own.kinds, forms, strict=True)):
                columns = self.tables[kind].column.values[own.index.values[rows, j]]
                some = weight[columns] * (columns >= 0) > 0.0 if len(weight) else columns < -1
                h = np.zeros(columns.shape)
                h[some] = PROBE / weight[columns[some]]
                h[:, at.shape[1] :] = 0.0
                steps.append(h)
                size = np.zeros(at.shape)
                size[at >= 0] = bounds(at[at >= 0]) / self._loosened
                sigma.append(size)
            scale = np.where(own.joint.values[rows][:, None], own.weight(rows), 1.0)
            found = [np.zeros(at.shape) for _, at in forms]
            try:
                for j, c, partials in own.displaced(rows, self.frame, self._theta(), steps):
                    s = sum(
                        np.einsum("nij,nj->ni", np.abs(after - a), size)
                        for (a, _), after, size in zip(forms, partials, sigma, strict=True)
                    )
                    h = np.where(steps[j][:, c] > 0.0, steps[j][:, c], np.inf)
                    found[j][:, c] = np.linalg.norm(scale * s, axis=1) / h
            except (InputError, WholeBlockError):  # how much they bend is not known
                found = [np.where(at >= 0, UNBOUNDED, 0.0) for _, at in forms]
            for mine, q in zip(own.curvature, found, strict=True):
                mine.values[rows] = q

    def _curvatures(self) -> Array:
        """Return what a unit of movement of each column makes its rows miss at most, Σqw.

        In a row, w = max(|v|, ½) + t: of the change of its partials, see `_measure_gaps`, and of
        its gap. The errors of rows may have one direction: those of one kind between the same
        points, with residuals of one sign, do.
        """
        n = self._delta.n
        out = np.zeros(n + 1)  # the last one is held
        bound = np.fmax(np.nan_to_num(self._bound.values, nan=np.inf), TINY)
        far = np.append(np.abs(self._delta.values) / bound, 0.0)
        for sort, own in enumerate(self.rows):
            if not own.curvature:
                continue
            on = np.flatnonzero(self._inside.values[own.unit.values])
            columns = [at for _, at in self._forms(sort, on)]
            t = np.max([far[at].max(axis=1, initial=0.0) for at in columns], axis=0)
            w = np.maximum(np.linalg.norm(own.v.values[on], axis=1), SIGMA_CHANGE_SHARE) + t
            for b, at in zip(own.curvature, columns, strict=True):
                q = b.values[on] * (w * self._loosened)[:, None]
                out += np.bincount(np.where(at >= 0, at, n).ravel(), q.ravel(), n + 1)
        return out[:-1]

    def _unmeasured(self, curvatures: Array) -> Array:
        """Return squares of what rows miss by the movement of each column since its look.

        Movements of several columns of a row count as independent: an upper bound of all that is
        missed would be the sum times their number. `_curvatures` is an upper bound of each.
        """
        return np.asarray(((self._delta.values - self._measured_at.values) * curvatures) ** 2)

    def _measure_gaps(self, columns: Mask, bounds: Callable[[Index], Array]) -> None:
        """Measure the gaps of rows that touch some columns.

        Partials change too, by dA. With s = |dA Q^½| of a row, it changes standard deviations by no
        more than s of themselves, and moves estimates by no more than s|v|: its gap has both. Over
        all rows √Σs² bounds the change of standard deviations, but √Σs²v² not that of estimates,
        as residuals may have one sign: what each row adds to the missed gradient is noted as well,
        see `_gradient_errors`.

        Args:
            columns: which.
            bounds: returns upper bounds of the standard deviations of columns.
        """
        if not columns.any():
            return
        self._measured_at.values[columns] = self._delta.values[columns]
        state = self.state()
        joint: dict[int, tuple[Index, Array, Array, Array, list[Array]]] = {}
        for sort, rows in self._touching(columns):
            own = self.rows[sort]
            units = own.unit.values[rows]
            v, partials = own.evaluated(rows, self.frame, state)
            alone = ~own.joint.values[rows]
            scale = np.where(alone[:, None], 1.0, own.weight(rows))
            s = np.zeros_like(v)
            for (a, at), new in zip(self._forms(sort, rows), partials, strict=True):
                change = np.where((at >= 0)[:, None, :], np.abs(new - a), 0.0)
                some = (change > 0.0).any(axis=1)
                bound = np.zeros(at.shape)
                bound[some] = bounds(at[some])
                s += scale * np.einsum("nij,nj->ni", change, bound)
            far = np.linalg.norm(s, axis=1)
            far *= np.maximum(np.linalg.norm(scale * v, axis=1), SIGMA_CHANGE_SHARE)
            linear = self._linear(sort, rows)
            gap = v - linear
            whole = np.linalg.norm(gap, axis=1) + far
            self._gap.values[units[alone]] = whole[alone] ** 2
            self._record_gradient_errors(
                sort, rows[alone], [a[alone] for a in partials], v[alone], linear[alone]
            )
            joint[sort] = rows, gap, far, v, partials
        self._measure_gaps_of_groups(joint)

    def _measure_gaps_of_groups(
        self, joint: dict[int, tuple[Index, Array, Array, Array, list[Array]]]
    ) -> None:
        """Measure the gaps of correlated units.

        Args:
            joint: of rows of each sort their numbers, ascending, gaps, misses of partials, v(x) and
                A(x); correlated units are there with all of their rows.
        """
        of_rows = [self.rows[sort].unit.values[rows] for sort, (rows, *_) in joint.items()]
        every = np.unique(np.concatenate([NO_ROWS, *of_rows]))
        units = np.array(self._groups(every), dtype=np.intp)
        if not len(units):
            return
        for at, sorts, rows in self._sequences(units):
            own = units[at]
            places = [np.searchsorted(joint[s][0], r) for s, r in zip(sorts, rows.T, strict=True)]
            gap, far, v = (
                np.concatenate(
                    [
                        joint[s][k][p].reshape(len(p), -1)
                        for s, p in zip(sorts, places, strict=True)
                    ],
                    axis=1,
                )
                for k in (1, 2, 3)
            )
            w = self._whiteners(own, v.shape[1])
            whole = np.linalg.norm((w @ gap[:, :, None])[:, :, 0], axis=1)
            self._gap.values[own] = (whole + np.linalg.norm(far, axis=1)) ** 2
            weight = w.transpose(0, 2, 1) @ w
            weighed, linear = ((weight @ x[:, :, None])[:, :, 0] for x in (v, v - gap))
            first = 0
            for s, r, p in zip(sorts, rows.T, places, strict=True):
                mine = slice(first, first + joint[s][3].shape[1])
                first = mine.stop
                partials = [a[p] for a in joint[s][4]]
                self._record_gradient_errors(s, r, partials, weighed[:, mine], linear[:, mine])

    def _replace(self, grown: Grown, rows: Index, values: Array) -> None:
        """Replace values by row, and keep those before for marks."""
        for mark in self._marks:
            mark.replaced.append((grown, rows, grown.values[rows]))
        grown.values[rows] = values

    def _record_gradient_errors(
        self, sort: int, rows: Index, partials: list[Array], v: Array, linear: Array
    ) -> None:
        """Note what rows add to the gradient that is missed, A(x)ᵀ v(x) − Aᵀ (v + A δ).

        Args:
            sort: their sort.
            rows: their numbers.
            partials: A(x) by the variable of each slot.
            v: v(x); of correlated rows, times their weights.
            linear: v + A δ, likewise.
        """
        own = self.rows[sort]
        for missed, a, new in zip(own.gradient_error, own.a, partials, strict=True):
            g = np.einsum("nij,ni->nj", new, v) - np.einsum("nij,ni->nj", a.values[rows], linear)
            self._replace(missed, rows, g)

    def _gradient_errors(self) -> tuple[Array, Array]:
        """Return the gradient that rows miss, by column, and Σ|g| over their rows."""
        n = self._delta.n
        g, sizes = np.zeros(n + 1), np.zeros(n + 1)  # the last one is held
        for _, missed, at in self._gradient_errors_by_row():
            at = np.where(at >= 0, at, n).ravel()
            g += np.bincount(at, missed.ravel(), n + 1)
            sizes += np.bincount(at, np.abs(missed).ravel(), n + 1)
        return g[:-1], sizes[:-1]

    def _gradient_error_shares(self, figure: Array) -> Array:
        """Return shares of units in a figure of each column, by what they add to its gradient."""
        out, figure = np.zeros(self._gap.n), np.append(figure, 0.0)
        for units, missed, at in self._gradient_errors_by_row():
            out += np.bincount(units, (np.abs(missed) * figure[at]).sum(axis=1), len(out))
        return out

    def _gradient_errors_by_row(self) -> Iterable[tuple[Index, Array, Index]]:
        """Iterate over units (k,), what is missed (k, s) and columns (k, s) of rows with gaps."""
        for own in self.rows:
            rows = np.flatnonzero(self._gap.values[own.unit.values] > 0.0)
            if not len(rows):
                continue
            units, index = own.unit.values[rows], own.index.values[rows]
            for j, (kind, missed) in enumerate(zip(own.kinds, own.gradient_error, strict=True)):
                columns = self.tables[kind].column.values[index[:, j]]
                yield units, missed.values[rows], columns[:, : missed.values.shape[1]]

    def _touching(self, columns: Mask) -> Iterable[tuple[int, Index]]:
        """Iterate over the rows inside that touch flagged columns, by sort; groups as wholes."""
        touched = {
            kind: ((table.column.values >= 0) & columns[table.column.values]).any(axis=1)
            for kind, table in self.tables.items()
        }
        hits = []
        grouped = np.zeros(self._inside.n, dtype=bool)
        for own in self.rows:
            index = own.index.values
            hit = np.zeros(len(index), dtype=bool)
            for j, kind in enumerate(own.kinds):
                hit |= touched[kind][index[:, j]]
            hits.append(hit)
            if self._whitener:
                grouped[own.unit.values[hit & own.joint.values]] = True
        for sort, (own, hit) in enumerate(zip(self.rows, hits, strict=True)):
            units = own.unit.values
            if self._whitener:
                hit = hit | grouped[units]
            rows = np.flatnonzero(hit & self._inside.values[units])
            if len(rows):
                yield sort, rows

    @property
    def n_rows(self) -> int:
        """Number of scalar rows."""
        return sum(
            int(self._inside.values[rows.unit.values].sum()) * rows.v.values.shape[1]
            for rows in self.rows
        )

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear rows."""
        total = 0.0
        for sort, own in enumerate(self.rows):
            on = self._inside.values[own.unit.values] & ~own.joint.values
            total += float((self._linear(sort, np.flatnonzero(on)) ** 2).sum())
        inside = self._groups(np.flatnonzero(self._inside.values))
        for group in self._correlated(np.array(inside, dtype=np.intp)):
            v = group.v.copy()
            for on, columns in group.columns(self._first.values):
                v += (group.a[:, :, on] @ self._delta.values[columns][:, :, None])[:, :, 0]
            total += float((v**2).sum())
        return total
