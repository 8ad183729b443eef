"""Every observation of the graph in its linear form, kind by kind, and how far that holds.

A row of the store is one factor of iSAM2: v ≈ c + Σ A δ, whitened, made at some earlier state and
in the charts of the `Register`. Compared with the model at the present state,

    Δv = v(x) − c − A δ            what the linear form misses,
    ρ  = ‖ΔA D‖                    change of its partials, D = diag of the standard deviations,

the step that is left is dx = −Q g, g = Σ (AᵀΔv + ΔAᵀv), and by Cauchy-Schwarz no estimate moves by
more than √(gᵀQg) of its own standard deviation. A standard deviation is wrong by no more than about
√Σρ², as ‖A Q^½‖ ≤ 1. Members of correlated groups keep v and A raw; their group whitens them.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy, deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import gtsam
import numpy as np

from ..frames import Frame
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.keys import KeyMap
from ..graph.weights import weigh
from ..models.variables import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import observation_kind
from ..rotation import right_jacobian_inverse
from ..stochastic import StandardDeviation
from ..types import Array, Index, Mask
from .growing import Growing
from .register import Register

Place: TypeAlias = "tuple[Rows, int]"
UNIT = {d: gtsam.noiseModel.Unit.Create(d) for d in range(1, 10)}
MOST_KEYS = 3
"""Keys that the JacobianFactor constructor takes in Python."""


class Rows:
    """Observations of one kind, all with the same variables."""

    def __init__(self, block: Block, partials: tuple[Array, ...]) -> None:
        """Start without rows, like ``block``."""
        self.template = replace(
            block,
            variables=tuple((kind, index[:0]) for kind, index in block.variables),
            observed=block.observed[:0],
            sigma=block.sigma[:0],
            ids=[],
            labels=str,
            whitener=None,
            constants={},
            axes=None,
        )
        self.index = [Growing(index[:0]) for _, index in block.variables]
        self.observed, self.sigma = Growing(block.observed[:0]), Growing(block.sigma[:0])
        self.whitener = None if block.whitener is None else Growing(block.whitener[:0])
        self.constants = {k: Growing(np.asarray(v)[:0]) for k, v in block.constants.items()}
        self.ids: list[str] = []
        self.labels: list[str] = []
        self.axes: list[str] | None = None if block.axes is None else []
        self.a = [Growing(a[:0]) for a in partials]
        self.c = Growing(block.observed[:0])
        self.slot = Growing(np.zeros(0, dtype=np.intp))
        """Number of the factor in iSAM2, −1 where it has none (groups, constants)."""
        self.group = Growing(np.zeros(0, dtype=np.intp))
        """Correlated group, −1 without."""
        self.alive = Growing(np.zeros(0, dtype=bool))
        self.off = Growing(np.zeros(0))
        """|Δv|² + ρ²|v|²."""
        self.turned = Growing(np.zeros(0))
        """ρ."""
        self.gap = [Growing(a[:0, 0]) for a in partials]
        """AᵀΔv + ΔAᵀv of each variable, (n, k)."""
        self.varies = False
        """Whether standard deviations depend on the geometry."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Rows:
        """Copy arrays and lists; what they hold, and the template, is never changed."""
        out = copy(self)
        memo[id(self)] = out
        for name, value in vars(self).items():
            if isinstance(value, Growing):
                setattr(out, name, deepcopy(value, memo))
        out.index = [deepcopy(g, memo) for g in self.index]
        out.a = [deepcopy(g, memo) for g in self.a]
        out.gap = [deepcopy(g, memo) for g in self.gap]
        out.constants = {k: deepcopy(g, memo) for k, g in self.constants.items()}
        out.ids, out.labels = [*self.ids], [*self.labels]
        out.axes = None if self.axes is None else [*self.axes]
        return out

    @property
    def n(self) -> int:
        """Number of rows, dead ones among them."""
        return self.c.n

    @property
    def n_scalars(self) -> int:
        """Number of scalar rows that are alive."""
        return int(self.alive.view.sum()) * self.template.dimension

    @property
    def kinds(self) -> tuple[VariableKind, ...]:
        """Kinds of the variables."""
        return tuple(kind for kind, _ in self.template.variables)

    def block(self) -> Block:
        """Return the rows as a block whose variables are numbered as in the register."""
        t = self.template
        return Block(
            t.kind,
            t.unit,
            tuple((k, i.view) for k, i in zip(self.kinds, self.index, strict=True)),
            self.observed.view,
            self.sigma.view,
            self.ids,
            t.components,
            self.labels.__getitem__,
            None if self.whitener is None else self.whitener.view,
            t.model,
            t.lens,
            {k: v.view for k, v in self.constants.items()},
            prior=t.prior,
            fixes=t.fixes,
            by_axis=t.by_axis,
            axes=self.axes,
            widths=t.widths,
        )

    def append(self, block: Block, numbers: dict[VariableKind, Index], group: Index) -> Index:
        """Append the rows of a block; return their places. Their linear form is still to come."""
        first, n = self.n, block.n
        for mine, (kind, index) in zip(self.index, block.variables, strict=True):
            mine.append(numbers[kind][index])
        self.observed.append(block.observed)
        self.sigma.append(block.sigma)
        if self.whitener is not None:
            assert block.whitener is not None
            self.whitener.append(block.whitener)
        for name, values in block.constants.items():
            self.constants[name].append(np.asarray(values))
        self.ids += list(block.ids)
        self.labels += [block.labels(i) for i in range(n)]
        if self.axes is not None:
            assert block.axes is not None
            self.axes += list(block.axes)
        d = block.dimension
        for a, gap in zip(self.a, self.gap, strict=True):
            a.append(np.zeros((n, d, a.view.shape[2])))
            gap.append(np.zeros((n, a.view.shape[2])))
        self.c.append(np.zeros((n, d)))
        self.slot.append(np.full(n, -1))
        self.group.append(group)
        self.alive.append(np.ones(n, dtype=bool))
        self.off.append(np.zeros(n))
        self.turned.append(np.zeros(n))
        return np.arange(first, first + n)

    def columns(self) -> list[Growing]:
        """All arrays."""
        out = [*self.index, self.observed, self.sigma, *self.constants.values(), *self.a]
        out += [self.c, self.slot, self.group, self.alive, self.off, self.turned, *self.gap]
        return out if self.whitener is None else [*out, self.whitener]

    def truncate(self, n: int) -> None:
        """Forget the rows from n on."""
        for column in self.columns():
            column.truncate(n)
        del self.ids[n:], self.labels[n:]
        if self.axes is not None:
            del self.axes[n:]

    def keep(self, rows: Index) -> None:
        """Keep some rows, in their order."""
        for column in self.columns():
            column.keep(rows)
        chosen = rows.tolist()
        self.ids = [self.ids[i] for i in chosen]
        self.labels = [self.labels[i] for i in chosen]
        if self.axes is not None:
            self.axes = [self.axes[i] for i in chosen]


@dataclass
class Group:
    """Correlated rows: one factor."""

    whitener: Array
    """W with W Σ Wᵀ = I, (k, k)."""
    members: list[tuple[Rows, Index]] = field(default_factory=list)
    """Where its scalar rows stand: rows of a store, in the order of the group's components."""
    order: list[Index] = field(default_factory=list)
    """Places of their components within the group, (rows × d)."""
    slot: int = -1


@dataclass
class Misfit:
    """What the linear forms of n rows miss at a state."""

    missed: Array
    """|Δv|², (n,)."""
    square: Array
    """|v|², (n,)."""
    turned: Array
    """ρ², (n,)."""
    gaps: list[Array]
    """AᵀΔv + ΔAᵀv of each variable, (n, k)."""


@dataclass
class Piece:
    """What one arrival brought."""

    rows: list[tuple[Rows, Index]]
    """Its rows."""
    groups: list[int]
    """Its correlated groups."""


class Store:
    """All rows of the graph."""

    def __init__(self, frame: Frame, register: Register) -> None:
        """Start empty."""
        self.frame, self.register = frame, register
        self.kinds: dict[tuple[object, ...], Rows] = {}
        self.groups: dict[int, Group] = {}
        self._next_group = 0
        self.places: dict[str, list[Place]] = {}
        """Rows by id of the observation."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Store:
        """Copy the rows, and where they are."""
        out = copy(self)
        memo[id(self)] = out
        out.register = deepcopy(self.register, memo)
        out.kinds = {k: deepcopy(r, memo) for k, r in self.kinds.items()}
        out.groups = deepcopy(self.groups, memo)
        out.places = {i: [(memo[id(r)], n) for r, n in at] for i, at in self.places.items()}
        return out

    # -- coming and going ---------------------------------------------------------------------

    def absorb(self, equations: Equations, numbers: dict[VariableKind, Index]) -> Piece:
        """Append all rows of some equations; `linearise` them afterwards.

        Args:
            equations: the rows.
            numbers: the register's number of each of their variables.
        """
        piece = Piece([], [])
        group_of: dict[int, int] = {}
        for cluster in equations.clusters:
            for row in cluster.rows.tolist():
                group_of[row] = self._next_group
            self.groups[self._next_group] = Group(cluster.whitener)
            piece.groups.append(self._next_group)
            self._next_group += 1
        for block in equations.blocks:
            if not block.n:
                continue
            d = block.dimension
            group = np.full(block.n, -1)
            if group_of:
                firsts = range(block.first_row, block.first_row + block.n * d, d)
                group = np.array([group_of.get(r, -1) for r in firsts])
            rows = self._rows_like(block, equations)
            rows.varies = rows.varies or _varies(block, equations.network)
            at = rows.append(block, numbers, group)
            piece.rows.append((rows, at))
            for i, ident in zip(at.tolist(), block.ids, strict=True):
                self.places.setdefault(ident, []).append((rows, i))
        for number, cluster in zip(piece.groups, equations.clusters, strict=True):
            whole = self.groups[number]
            self._fill(whole, cluster.rows, equations, piece)
            # With all others of its group given: what correlated weights are at least worth.
            alone = 1.0 / np.linalg.norm(whole.whitener, axis=0)
            for (rows, at), order in zip(whole.members, whole.order, strict=True):
                rows.sigma.view[at] = alone[order]
        return piece

    def _rows_like(self, block: Block, equations: Equations) -> Rows:
        widths = tuple(_width(equations, block, j) for j in range(len(block.variables)))
        signature = (
            *(block.kind, block.lens, block.dimension, block.components, widths),
            *(block.whitener is None, block.axes is None),
            tuple(kind for kind, _ in block.variables),
        )
        found = self.kinds.get(signature)
        if found is None:
            d = block.dimension
            found = Rows(block, tuple(np.zeros((0, d, k)) for k in widths))
            self.kinds[signature] = found
        return found

    @staticmethod
    def _fill(group: Group, wanted: Index, equations: Equations, piece: Piece) -> None:
        place = {int(r): i for i, r in enumerate(wanted)}
        blocks = [b for b in equations.blocks if b.n]
        for block, (rows, at) in zip(blocks, piece.rows, strict=True):
            d = block.dimension
            inside = [i for i in range(block.n) if block.first_row + i * d in place]
            if inside:
                group.members.append((rows, at[inside]))
                group.order.append(
                    np.array(
                        [[place[block.first_row + i * d + j] for j in range(d)] for i in inside]
                    )
                )

    def marks(self) -> tuple[dict[int, int], int]:
        """Return how much there is, for `forget`."""
        return {id(r): r.n for r in self.kinds.values()}, self._next_group

    def forget(self, marks: tuple[dict[int, int], int]) -> None:
        """Drop what came after ``marks``."""
        counts, first = marks
        for rows in self.kinds.values():
            n = counts.get(id(rows), 0)
            fresh = np.arange(n, rows.n)
            self._add_weight(rows, fresh[rows.alive.view[fresh]], -1.0)
            for ident in dict.fromkeys(rows.ids[n:]):
                self._forget_id(ident, rows, n)
            rows.truncate(n)
        for number in [g for g in self.groups if g >= first]:
            del self.groups[number]
        self._next_group = first

    def _forget_id(self, ident: str, rows: Rows, n: int) -> None:
        left = [(r, i) for r, i in self.places.get(ident, []) if r is not rows or i < n]
        if left:
            self.places[ident] = left
        else:
            self.places.pop(ident, None)

    def drop(self, ids: Iterable[str]) -> list[int]:
        """Drop observations, with the correlated groups they are in; return their slots."""
        slots: list[int] = []
        for ident in ids:
            for rows, i in self.places.pop(ident, []):
                if not rows.alive.view[i]:
                    continue
                rows.alive.view[i] = False
                self._add_weight(rows, np.array([i]), -1.0)
                rows.off.view[i] = rows.turned.view[i] = 0.0
                for gap in rows.gap:
                    gap.view[i] = 0.0
                if rows.slot.view[i] >= 0:
                    slots.append(int(rows.slot.view[i]))
                number = int(rows.group.view[i])
                group = self.groups.pop(number, None)
                if group is not None and group.slot >= 0:
                    slots.append(group.slot)
        return slots

    def compact(self) -> None:
        """Give the room of dropped rows back where they are more than the others."""
        for rows in self.kinds.values():
            alive = np.flatnonzero(rows.alive.view)
            if rows.n < 64 or 2 * len(alive) > rows.n:
                continue
            anew = np.cumsum(rows.alive.view) - 1
            rows.keep(alive)
            for ident in dict.fromkeys(rows.ids):
                self.places[ident] = [
                    (r, int(anew[i]) if r is rows else i) for r, i in self.places[ident]
                ]
            for group in self.groups.values():
                group.members = [(r, anew[at] if r is rows else at) for r, at in group.members]

    def n_rows_of(self, ids: Iterable[str]) -> int:
        """Return the number of scalar rows of some ids."""
        return sum(r.template.dimension for i in ids for r, _ in self.places[i])

    @property
    def n_scalars(self) -> int:
        """Number of scalar rows."""
        return sum(r.n_scalars for r in self.kinds.values())

    def everything(self) -> Piece:
        """All rows that are alive."""
        rows = [(r, np.flatnonzero(r.alive.view)) for r in self.kinds.values()]
        return Piece([(r, at) for r, at in rows if len(at)], list(self.groups))

    # -- linear forms -------------------------------------------------------------------------

    def evaluate(self, rows: Rows, at: Index) -> tuple[Array, list[Array]]:
        """Return v (n, d) and partials (n, d, k) in the charts at the present state.

        Whitened outside groups.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        part = rows.block().select(at)
        raw, jacobians = part.evaluate(self.frame, self.register.state)
        v = part.whiten(raw)
        grouped = rows.group.view[at] >= 0
        if grouped.any():
            v[grouped] = raw[grouped]
        out = []
        for (kind, index), jacobian in zip(part.variables, jacobians, strict=True):
            table = self.register[kind]
            k = jacobian.shape[2]
            inside = table.place.view[index, :k] >= 0
            if not inside.any():
                out.append(np.zeros_like(jacobian))
                continue
            a = part.whiten(jacobian)
            if grouped.any():
                a[grouped] = jacobian[grouped]
            if UNKNOWNS[kind].rotates:
                turn = table.delta.view[index, :3]
                if turn.any():
                    a[:, :, :3] = a[:, :, :3] @ np.linalg.inv(right_jacobian_inverse(turn))
            if not inside.all():
                a = np.where(inside[:, None, :], a, 0.0)
            out.append(a)
        return v, out

    def linear(self, rows: Rows, at: Index) -> Array:
        """Return c + A δ of the linear forms, (n, d)."""
        return np.asarray(rows.c.view[at] + self._product(rows, at))

    def _product(self, rows: Rows, at: Index, partials: list[Array] | None = None) -> Array:
        out = np.zeros(rows.c.view[at].shape)
        for j, (kind, index) in enumerate(zip(rows.kinds, rows.index, strict=True)):
            a = rows.a[j].view[at] if partials is None else partials[j]
            delta = self.register[kind].delta.view[index.view[at], : a.shape[2]]
            out += np.einsum("ndk,nk->nd", a, delta)
        return out

    def reweigh(self, piece: Piece, network: Network) -> None:
        """Renew standard deviations that depend on the geometry."""
        for rows, at in piece.rows:
            if rows.varies:
                sigma = self._sigma_now(rows, at, network)
                self._add_weight(rows, at, -1.0)
                for a in rows.a:
                    a.view[at] = 0.0  # the linear forms are made anew
                rows.sigma.view[at] = sigma

    def _sigma_now(self, rows: Rows, at: Index, network: Network) -> Array:
        now = weigh(network, rows.block().select(at), self.register.state)
        return np.asarray(now.sigma)

    def linearise(self, piece: Piece) -> None:
        """Give rows the linear form of the present state.

        Raises:
            InputError: names observations whose geometry has no answer; nothing has changed then.
        """
        found = [self.evaluate(rows, at) for rows, at in piece.rows]
        for (rows, at), (v, partials) in zip(piece.rows, found, strict=True):
            self._add_weight(rows, at, -1.0)
            for mine, a in zip(rows.a, partials, strict=True):
                mine.view[at] = a
            rows.c.view[at] = v - self._product(rows, at, partials)
            rows.off.view[at] = rows.turned.view[at] = 0.0
            for gap in rows.gap:
                gap.view[at] = 0.0
            self._add_weight(rows, at, 1.0)

    def _add_weight(self, rows: Rows, at: Index, sign: float) -> None:
        scale: Array | float = 1.0
        if (rows.group.view[at] >= 0).any():
            scale = np.where(rows.group.view[at][:, None] >= 0, rows.sigma.view[at], 1.0) ** -2
        for kind, index, a in zip(rows.kinds, rows.index, rows.a, strict=True):
            values = a.view[at]
            square = (
                np.einsum("ndk,ndk->nk", values, values)
                if isinstance(scale, float)
                else np.einsum("ndk,nd->nk", values**2, scale)
            )
            weight = self.register[kind].weight.view
            touched = index.view[at]
            np.add.at(weight[:, : square.shape[1]], touched, sign * square)
            weight[touched] = np.maximum(weight[touched], 0.0)

    def compare(self, moved: dict[VariableKind, Mask], network: Network) -> None:
        """Compare the rows of variables that moved with their models.

        Args:
            moved: which variables moved.
            network: has the observations, whose standard deviations may depend on the geometry.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        for rows in self.kinds.values():
            touched = np.zeros(rows.n, dtype=bool)
            for kind, index in zip(rows.kinds, rows.index, strict=True):
                if kind in moved:
                    touched |= moved[kind][index.view]
            at = np.flatnonzero(touched & rows.alive.view)
            if len(at):
                self._compare(rows, at, network)
        self.register.looked_at(moved)

    def _compare(self, rows: Rows, at: Index, network: Network) -> None:
        found = self.misfit(rows, at)
        turned = found.turned
        if rows.varies:
            # Weights that change turn partials and residuals alike: −2 c Aᵀv.
            change = self._sigma_now(rows, at, network) / rows.sigma.view[at] - 1.0
            turned = turned + np.sum(change**2, axis=1)
            v = -2.0 * change * self.linear(rows, at)
            for a, gap in zip(rows.a, found.gaps, strict=True):
                gap += np.einsum("ndk,nd->nk", a.view[at], v)
        rows.turned.view[at] = np.sqrt(turned)
        rows.off.view[at] = found.missed + turned * found.square
        for mine, gap in zip(rows.gap, found.gaps, strict=True):
            mine.view[at] = gap

    def misfit(self, rows: Rows, at: Index) -> Misfit:
        """Return how far the linear forms of rows are from their models at the present state.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        v, partials = self.evaluate(rows, at)
        missed = v - self.linear(rows, at)
        scale: Array = np.ones((len(at), 1))
        grouped = rows.group.view[at] >= 0
        if grouped.any():
            scale = np.where(grouped[:, None], rows.sigma.view[at], 1.0)
            missed, v = missed / scale, v / scale
        turned = np.zeros(len(at))
        gaps = []
        for j, (kind, index) in enumerate(zip(rows.kinds, rows.index, strict=True)):
            a = rows.a[j].view[at] / scale[:, :, None]
            change = partials[j] / scale[:, :, None] - a
            table, numbers = self.register[kind], index.view[at]
            variance = table.variance.view[numbers, : a.shape[2]]
            turned += np.einsum("ndk,nk->n", change**2, variance)
            gaps.append(np.einsum("ndk,nd->nk", a, missed) + np.einsum("ndk,nd->nk", change, v))
        return Misfit(np.sum(missed**2, axis=1), np.sum(v**2, axis=1), turned, gaps)

    def turned(self) -> float:
        """Return Σρ²."""
        each = (r.turned.view[r.alive.view] for r in self.kinds.values())
        return sum(float(t @ t) for t in each)

    def gradient(self) -> Array:
        """Return g = Σ (AᵀΔv + ΔAᵀv), (n_places,): the step that is left is −Q g."""
        out = np.zeros(self.register.n_places)
        for rows in self.kinds.values():
            at = np.flatnonzero((rows.off.view > 0) & rows.alive.view)
            if len(at):
                self.add_gradient(out, rows, at, [g.view[at] for g in rows.gap])
        return out

    def add_gradient(self, out: Array, rows: Rows, at: Index, gaps: list[Array]) -> None:
        """Add the parts of some rows to a gradient (n_places,)."""
        for kind, index, gap in zip(rows.kinds, rows.index, gaps, strict=True):
            place = self.register[kind].place.view[index.view[at], : gap.shape[1]]
            on = place >= 0
            if on.any():
                out += np.bincount(place[on], weights=gap[on], minlength=len(out))

    def vtpv(self) -> float:
        """Return vᵀPv of the linear forms at the present state."""
        total = 0.0
        raw: dict[int, Array] = {}
        for rows in self.kinds.values():
            at = np.flatnonzero(rows.alive.view)
            if not len(at):
                continue
            v = self.linear(rows, at)
            free = rows.group.view[at] < 0
            total += float(np.sum(v[free] ** 2))
        for number, group in self.groups.items():
            raw[number] = self.group_residual(group)
            total += float(raw[number] @ raw[number])
        return total

    def group_residual(self, group: Group) -> Array:
        """Return W v of a group, from its linear forms."""
        v = np.zeros(len(group.whitener))
        for (rows, at), order in zip(group.members, group.order, strict=True):
            v[order] = self.linear(rows, at)
        return np.asarray(group.whitener @ v)

    # -- factors ------------------------------------------------------------------------------

    def factors(self, piece: Piece) -> tuple[list[gtsam.NonlinearFactor], list[tuple[object, int]]]:
        """Return factors for iSAM2, and what each of them belongs to, for `number`."""
        out: list[gtsam.NonlinearFactor] = []
        owners: list[tuple[object, int]] = []
        for rows, at in piece.rows:
            single = at[rows.group.view[at] < 0]
            self._row_factors(rows, single, out, owners)
        for number in piece.groups:
            group = self.groups[number]
            factor = self._group_factor(group)
            if factor is not None:
                out.append(factor)
                owners.append((group, number))
        return out, owners

    @staticmethod
    def number(owners: list[tuple[object, int]], slots: Iterable[int]) -> None:
        """Note the slots that iSAM2 gave to factors."""
        for (owner, i), slot in zip(owners, slots, strict=True):
            if isinstance(owner, Rows):
                owner.slot.view[i] = slot
            else:
                assert isinstance(owner, Group)
                owner.slot = slot

    def _row_factors(
        self,
        rows: Rows,
        at: Index,
        out: list[gtsam.NonlinearFactor],
        owners: list[tuple[object, int]],
    ) -> None:
        """Add one factor for each row, by which components are unknown."""
        if not len(at):
            return
        masks = [
            self.register[kind].place.view[index.view[at], : a.view.shape[2]] >= 0
            for kind, index, a in zip(rows.kinds, rows.index, rows.a, strict=True)
        ]
        pattern = np.concatenate(masks, axis=1)
        _, code = np.unique(pattern, axis=0, return_inverse=True)
        unit = UNIT[rows.template.dimension]
        for number in range(int(code.max()) + 1):
            chosen = np.flatnonzero(code == number)
            slots = [j for j, m in enumerate(masks) if m[chosen[0]].any()]
            if not slots:
                rows.slot.view[at[chosen]] = -1
                continue
            where = at[chosen]
            keys = [
                (KeyMap.of(rows.kinds[j], 0) + rows.index[j].view[where]).tolist() for j in slots
            ]
            a = [
                list(
                    np.asfortranarray(
                        rows.a[j].view[where][:, :, masks[j][chosen[0]]].transpose(1, 2, 0)
                    ).transpose(2, 0, 1)
                )
                for j in slots
            ]
            b = list(-rows.c.view[where])
            for i, row in enumerate(where.tolist()):
                terms = [(k[i], m[i]) for k, m in zip(keys, a, strict=True)]
                out.append(_factor(terms, b[i], unit))
                owners.append((rows, row))

    def _group_factor(self, group: Group) -> gtsam.NonlinearFactor | None:
        size = len(group.whitener)
        pieces: dict[int, Array] = {}
        c = np.zeros(size)
        for (rows, at), order in zip(group.members, group.order, strict=True):
            c[order] = rows.c.view[at]
            for kind, index, a in zip(rows.kinds, rows.index, rows.a, strict=True):
                table = self.register[kind]
                for i, number in enumerate(index.view[at].tolist()):
                    inside = table.place.view[number, : a.view.shape[2]] >= 0
                    if inside.any():
                        key = KeyMap.of(kind, number)
                        term = pieces.setdefault(key, np.zeros((size, int(inside.sum()))))
                        term[order[i]] += a.view[at[i]][:, inside]
        if not pieces:
            return None
        terms = [(k, np.asfortranarray(group.whitener @ a)) for k, a in pieces.items()]
        return _factor(terms, -group.whitener @ c, gtsam.noiseModel.Unit.Create(size))


def _varies(block: Block, network: Network) -> bool:
    if block.prior or block.lens is not None or observation_kind(block.kind).weight is None:
        return False
    return any(
        isinstance(getattr(network.observations[i], "sigma", None), StandardDeviation)
        for i in block.ids
    )


def _width(equations: Equations, block: Block, j: int) -> int:
    kind, index = block.variables[j]
    if kind == "calibration" and block.lens is not None:
        return len(block.lens.names)
    table = equations.unknowns[kind]
    return int(table.size[index[0]]) if UNKNOWNS[kind].variable_size else table.free.shape[1]


def _factor(
    terms: list[tuple[int, Array]], b: Array, unit: gtsam.noiseModel.Diagonal
) -> gtsam.LinearContainerFactor:
    merged = _merged(terms)
    if len(merged) <= MOST_KEYS:
        flat = [x for term in merged for x in term]
        return gtsam.LinearContainerFactor(gtsam.JacobianFactor(*flat, b, unit))  # type: ignore[call-overload]
    return gtsam.LinearContainerFactor(gtsam.GaussianConditional(merged, 1, b, unit))


def _merged(terms: list[tuple[int, Array]]) -> list[tuple[int, Array]]:
    """Return the terms with those of one key added up."""
    if len({k for k, _ in terms}) == len(terms):
        return terms
    out: dict[int, Array] = {}
    for key, a in terms:
        out[key] = out[key] + a if key in out else a
    return list(out.items())
