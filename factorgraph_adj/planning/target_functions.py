"""Targets as linear functions of the unknowns: their figures before and after more observations.

A target concerns functions F of the unknowns: the coordinates of a point, or the rows of an
observation. Rows A that join change their cofactors B = F Q Fᵀ by the loss

    N (I + A Q Aᵀ)⁻¹ Nᵀ,   N = F Q Aᵀ,

and the figure of the target follows from B: of points as in `factorgraph_adj.planning.targets`; of
observations with the whitened rows A_i, Σ = L Lᵀ and M = I − A_i Q A_iᵀ, the redundancy numbers
(L M L⁻¹)_ii and the smallest detectable errors δ0/√(L⁻ᵀ M L⁻¹)_ii. The smallest detectable
displacement of a point is that of its coordinates where the reference points are held, because its
test takes them as stable (`factorgraph_adj.planning.plan`): Q is then that with F_R x as
constraints without error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..epochs.congruence_tests import UnitVariance, motion_basis, motion_rank
from ..errors import InputError, Problem
from ..graph.equations import compile_rows
from ..ledger.excerpts import excerpt
from ..ledger.ledger import Ledger
from ..linear_system.cofactor_columns import UNKNOWN, CofactorColumns, WithRows
from ..linear_system.linear_system import LinearForms, LinearSystem
from ..models.unknown_registry import VariableKind
from ..quality.reliability import noncentrality
from ..types import Array, Index
from .sight_templates import Places
from .targets import (
    LEAST,
    MOST,
    DetectableDisplacement,
    DetectableError,
    PointTarget,
    RedundancyNumber,
    Target,
    UndetectedShift,
    at_least,
    describe,
    lacking,
    matching,
    point_figures,
    unlike,
)

POINT = 3


@dataclass(frozen=True, eq=False)
class TargetItem:
    """An item of a target: a point, or a component of an observation."""

    target: Target
    """The target."""
    name: str
    """Name of the point, or label of the observation."""
    at: Index
    """Its functions among those of the group, (k,)."""
    figures: Callable[[Array], Array]
    """Returns figures (c,) for cofactors (c, k, k) of its functions."""


@dataclass(frozen=True, eq=False)
class TargetFunctions:
    """Functions of the unknowns with their items, and the cofactors in which they count."""

    cofactors: CofactorColumns
    """Cofactors; of displacements with the reference points held."""
    rows: Array
    """Fᵀ, (n, t)."""
    items: tuple[TargetItem, ...]
    """The items."""

    def carried(self, change: Callable[[CofactorColumns], CofactorColumns]) -> TargetFunctions:
        """Return the functions in cofactors that have changed."""
        return TargetFunctions(change(self.cofactors), self.rows, self.items)


def gains(target: Target, before: float, after: Array) -> Array:
    """Return ln(before/after) of figures (c,), or ln(after/before) where they should grow."""
    if at_least(target):
        return np.asarray(np.log(np.maximum(after, LEAST) / max(before, LEAST)))
    safe = np.where(np.isfinite(after), np.maximum(after, 1e-300), MOST)
    start = before if np.isfinite(before) else MOST
    return np.asarray(np.log(max(start, 1e-300) / safe))


MAX_FUNCTION_BYTES = 512 * 1024**2
"""Largest memory of the coordinates of a target's points as functions of all unknowns, bytes."""


class TargetReader:
    """Makes functions of targets."""

    def __init__(
        self,
        ledger: Ledger,
        system: LinearSystem,
        places: Places,
        alpha: float,
        power: float,
    ) -> None:
        """Take the network over.

        Args:
            ledger: what has arrived.
            system: the linear system.
            places: values and columns.
            alpha: probability of a false alarm of the test of an observation.
            power: power of the test.
        """
        self.ledger, self.system, self.places = ledger, system, places
        self.delta0 = noncentrality(alpha, power)
        self.problems: list[Problem] = []

    def functions(self, targets: Sequence[Target]) -> list[TargetFunctions]:
        """Return the functions of targets.

        Raises:
            InputError: unknown names, points that are not determined, observations that are not in
                the graph, and targets that no single observation can be judged by.
        """
        out = []
        for t in targets:
            if isinstance(t, UndetectedShift):
                self._wrong(t, "is no target of single observations: take detectable errors")
            elif isinstance(t, DetectableDisplacement):
                out.append(self._displacement(t))
            elif isinstance(t, RedundancyNumber | DetectableError):
                out.append(self._rows(t))
            else:
                out.append(self._points(t))
        if self.problems:
            raise InputError(self.problems)
        return [f for f in out if f is not None]

    def _wrong(self, target: Target, what: str) -> None:
        self.problems.append(Problem(what, describe(target)))

    def _chosen(self, target: Target, patterns: Sequence[str]) -> list[int]:
        """Return the numbers of determined points of a target."""
        names = self.places.names
        each = [matching(names, (p,)) for p in patterns]
        if not each or not all(m.any() for m in each):
            for what in unlike("point", patterns, names):
                self._wrong(target, what)
            return []
        on = np.flatnonzero(np.any(each, axis=0))
        columns = self.places.columns
        lost = [i for i in on.tolist() if (columns[i] == UNKNOWN).any()]
        if len(lost) == len(on):
            for i in lost:
                why = self.ledger.lacks.get(("point", names[i]), "no observation has determined it")
                self.problems.append(Problem(f"is not determined: {why}", f"point {names[i]!r}"))
        out = [i for i in on.tolist() if i not in lost and (columns[i] >= 0).any()]
        if not out and not lost:
            self._wrong(target, "all of its points are held: nothing improves them")
        most = MAX_FUNCTION_BYTES // (8 * POINT * max(self.places.cofactors.size, 1))
        if len(out) > most:
            self._wrong(target, f"has {len(out)} points, of at most {most} here: name fewer")
            return []
        return out

    def _coordinates(self, points: Sequence[int]) -> Array:
        """Return the coordinates of points as functions, (n, 3 m)."""
        out = np.zeros((self.places.cofactors.size, POINT * len(points)))
        columns = self.places.columns[np.array(points, dtype=np.intp)].ravel()
        on = np.flatnonzero(columns >= 0)
        out[columns[on], on] = 1.0
        return out

    def _points(self, target: PointTarget) -> TargetFunctions | None:
        points = self._chosen(target, target.points)
        frame = self.places.equations.network.frame
        at = self.places.coordinates[points]
        horizon = frame.basis(at, np.zeros((len(at), 2))).enu[:, :2] if len(at) else at

        def figures(i: int) -> Callable[[Array], Array]:
            def of_blocks(blocks: Array) -> Array:
                return point_figures(target, blocks, horizon[i][None])

            return of_blocks

        items = tuple(
            TargetItem(target, self.places.names[p], POINT * i + np.arange(POINT), figures(i))
            for i, p in enumerate(points)
        )
        return TargetFunctions(self.places.cofactors, self._coordinates(points), items)

    def _displacement(self, target: DetectableDisplacement) -> TargetFunctions | None:
        points = self._chosen(target, target.points)
        names, columns = self.places.names, self.places.columns
        on = matching(names, target.points)
        stable = matching(names, target.reference) & ~on & (columns >= 0).any(axis=1)
        reference = np.flatnonzero(stable).tolist()
        held, cofactors = self._coordinates(reference), self.places.cofactors
        held = held[:, held.any(axis=0)]
        motions = motion_basis(cofactors.motions)
        if motions.shape[1] and motion_rank(held.T @ motions) < motions.shape[1]:
            self._wrong(target, "its reference points leave motions of the whole open")
            return None
        if held.shape[1]:
            cofactors = WithRows(cofactors, held, held=True)
        known = UnitVariance(1.0, float("inf"))
        items = []
        for i, p in enumerate(points):
            free = np.flatnonzero(columns[p] >= 0)
            size = 2.0 * known.noncentrality(target.alpha, target.power, len(free))

            def figures(blocks: Array, size: float = size) -> Array:
                largest = np.linalg.eigvalsh(blocks)[:, -1]
                return np.asarray(np.sqrt(np.maximum(size * largest, 0.0)))

            items.append(TargetItem(target, names[p], POINT * i + free, figures))
        return TargetFunctions(cofactors, self._coordinates(points), tuple(items))

    def _rows(self, target: RedundancyNumber | DetectableError) -> TargetFunctions | None:
        ledger = self.ledger
        inside = ledger.having("accepted")
        patterns = [str(p) for p in target.observations]
        exact = ledger.find(patterns)
        rows = exact[np.isin(exact, inside)] if len(exact) == len(set(patterns)) else None
        if rows is None or not len(rows):
            each = [(int(r), i) for r in inside.tolist() for i in ledger.rows.ids(ledger.names, r)]
            kinds = {r: unit.observations[0].kind for r, unit in ledger.rows.units(inside)}
            names = [i for _, i in each]
            of_kind = [kinds.get(r, "image") for r, _ in each]
            wrong = unlike("observation", target.observations, [*dict.fromkeys(of_kind), *names])
            for what in wrong:
                self._wrong(target, what)
            if wrong:
                return None
            on = matching(names, target.observations) | matching(of_kind, target.observations)
            rows = np.unique([each[i][0] for i in np.flatnonzero(on)]).astype(np.intp)
        equations = compile_rows(excerpt(ledger, self.system, rows, hold=False))
        cofactors = self.places.cofactors

        def columns(kind: VariableKind, name: str) -> Index:
            table = equations.unknowns[kind]
            size = int(table.size[table.number[name]])
            return np.asarray(cofactors.columns(kind, [name], size)[0], dtype=np.intp)

        units = ledger.units(rows)
        forms = LinearForms.of(
            units, equations, columns, lambda c: np.zeros(len(c)), equations.unknowns.start()
        )
        out = np.zeros((cofactors.size, len(forms.a)))
        on = forms.columns >= 0
        out[forms.columns[on]] = forms.a[:, on].T
        items = []
        for unit, own, root in zip(units, forms.rows, forms.raw, strict=True):
            inverse, sigma = np.linalg.inv(root), np.sqrt(np.sum(root**2, axis=1))
            weight = np.sum(inverse**2, axis=0)
            labels = [
                f"{o.label()} {c}".strip() for o in unit.observations for c in o.component_names()
            ]
            for i in range(len(own)):
                spread = float(weight[i]), float(sigma[i])
                figures = self._row_figures(target, i, root, inverse, *spread)
                items.append(TargetItem(target, labels[i], own, figures))
        return TargetFunctions(cofactors, out, tuple(items))

    def _row_figures(
        self,
        target: RedundancyNumber | DetectableError,
        i: int,
        root: Array,
        inverse: Any,
        weight: float,
        sigma: float,
    ) -> Callable[[Array], Array]:
        delta0 = self.delta0

        def redundancy(blocks: Array) -> Array:
            m = np.eye(blocks.shape[1]) - blocks
            return np.asarray(np.einsum("j,cjk,k->c", root[i], m, inverse[:, i]))

        def error(blocks: Array) -> Array:
            m = np.eye(blocks.shape[1]) - blocks
            precision = np.einsum("j,cjk,k->c", inverse[:, i], m, inverse[:, i])
            controlled = precision > LEAST * weight
            safe = np.where(controlled, precision, 1.0)
            return np.where(controlled, delta0 / np.sqrt(safe) / sigma, np.inf)

        return redundancy if isinstance(target, RedundancyNumber) else error


def lack_of(item: TargetItem, figure: float) -> float:
    """Return the lack of an item, see `factorgraph_adj.planning.targets.lacking`."""
    return float(lacking(item.target, np.array([figure]))[0])
