"""Search for observations of a design that can be left out while its targets are still met.

This is the reverse of `factorgraph_adj.planning.proposals`. Observations are removed one by one,
each time the observation with the largest cost per loss; the loss is the change of the sum of
figure/limit over all items. `Update` of `factorgraph_adj.solve.low_rank_update` gives the changes
by the removal of rows from the cofactors h = A Q Aᵀ of all observed functions. For an observation
that some unknown needs to be determined, h has an eigenvalue 1: the update is not reliable, and the
observation stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ..blas_threads import with_one_thread
from ..errors import InputError, Problem, known, taking
from ..graph.observation_selection import without
from ..network.network import Network
from ..observations.registry import in_image_table
from ..quality.error_effects import whitened_unit_error
from ..result_display import Rows, Shown
from ..solve.low_rank_update import Update
from ..solve.solution import cofactors_at
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from ..types import Array, Index, Mask
from .candidates import partials
from .plan import DisplacementItems, Plan, displacement_items, horizons, plan, realised, rows_like
from .targets import (
    MAX_SHORTFALLS_LISTED,
    DetectableDisplacement,
    DetectableError,
    RedundancyNumber,
    RowTarget,
    Target,
    UndetectedShift,
    as_targets,
    limit_of,
    matching,
    names_of,
    patterns_of,
    point_figures,
    unlike,
)

LARGEST = 6000
"""Largest number of scalar observations of a design; A Q Aᵀ is kept in memory as a whole."""
ROUNDED_LOSS = 1e-9
"""Loss up to which the loss is rounding error."""
EQUAL = 1e-6
"""Relative difference up to which the costs per loss of two observations count as equal.

For losses near zero, rounding errors reach this size. Of observations with equal values, as in a
symmetric design, the first one is removed.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Spared(Shown):
    """Observations that can be left out."""

    ids: tuple[str, ...]
    """Ids of the observations, in the order in which they were taken out."""
    saved: float
    """Cost of these observations."""
    plan: Plan
    """Plan of the design without these observations; its targets are met."""

    def headline(self) -> str:
        """Return the number of observations and their cost."""
        return f"Spared: {len(self.ids)} observations, cost {self.saved:g}"

    def first_rows(self) -> Rows:
        """Return the observations that can be left out."""
        return Rows(
            ("observation",),
            ((i,) for i in self.ids),
            len(self.ids),
        )

    def __str__(self) -> str:
        """List the observations."""
        if not self.ids:
            return "Nothing can be left out."
        lines = [f"{len(self.ids)} observations can be left out, cost {self.saved:g}:"]
        return "\n".join([*lines, *(f"  {i}" for i in self.ids)])


@taking(Network)
@with_one_thread
def find_sparable(
    network: Network,
    targets: Sequence[Target] | Target,
    *,
    observations: Sequence[str] | str = ("*",),
    cost: Mapping[str, float] | None = None,
    alpha: float = ALPHA_OF_OBSERVATION,
    power: float = POWER_OF_TEST,
) -> Spared:
    """Find observations that can be left out while the targets are met.

    Args:
        network: the design; see `plan`.
        targets: targets of the design.
        observations: ids or kinds, or patterns, of observations that may be left out; members of
            correlated groups always stay.
        cost: costs of observations by id, greater than zero; 1 for all others.
        alpha: as in `plan`.
        power: as in `plan`.

    Raises:
        InputError: the design does not meet its targets, by item; the design is too large; no
            targets, or invalid ones; invalid costs; patterns without a matching observation.
    """
    wanted = as_targets(targets)
    if not wanted:
        raise InputError("there are no targets: what is to remain?")
    may_go, prices = patterns_of(observations), dict(cost or {})
    whole = plan(network, wanted, alpha=alpha, power=power)
    names = names_of(whole.solution.equations)
    problems = [Problem(what, "observations") for what in unlike("observation", may_go, names)]
    problems += _wrong_prices(prices, [o.id for o in whole.solution.observations])
    if problems:
        raise InputError(problems)
    if whole.shortfalls:
        raise InputError(
            [
                Problem("fails already with everything", str(s))
                for s in whole.shortfalls[:MAX_SHORTFALLS_LISTED]
            ]
        )
    if whole.solution.n_observations > LARGEST:
        raise InputError(
            f"{whole.solution.n_observations} scalar observations; up to {LARGEST} are looked at"
        )
    out: list[str] = []
    search = _SpareSearch(whole, wanted, may_go)
    if not search.rows:
        raise InputError(
            Problem(
                "they are weighted unknowns or members of correlated groups, which stay",
                f"observations {', '.join(may_go)}",
            )
        )
    while True:
        best = search.best(prices)
        if best is None:
            break
        # A separate plan checks the predicted figures before the observation is removed.
        found = realised(without(network, [*out, best]), wanted, alpha=alpha, power=power)
        search.take(best, leave=not found.met)
        if found.met:
            out.append(best)
            whole = found
    return Spared(tuple(out), sum(prices.get(i, 1.0) for i in out), whole)


def _wrong_prices(prices: Mapping[str, Any], ids: Sequence[str]) -> list[Problem]:
    there = dict.fromkeys(ids)
    problems = []
    for ident, price in prices.items():
        wrong = []
        if ident not in there:
            wrong.append(f"no observation has this id; there are: {known(there, meant=ident)}")
        if isinstance(price, bool) or not isinstance(price, int | float | np.number):
            wrong.append(f"it must be a number, not {price!r}")
        elif not (np.isfinite(price) and price > 0):
            wrong.append(f"it must be greater than zero, not {price}")
        problems += [Problem(what, f"cost of {ident!r}") for what in wrong]
    return problems


class _SpareSearch:
    """Cofactors of a design from which observations are removed."""

    def __init__(self, design: Plan, targets: Sequence[Target], may_go: Sequence[str]) -> None:
        solution = design.solution
        self.design, self.targets = design, targets
        equations = solution.equations
        a: csr_array = partials(solution.normal().system)
        n = equations.n_rows
        self.a = np.asarray(a.todense())
        self.qa = solution.cofactor_times(np.asarray(self.a.T.copy()))
        self.h = self.a @ self.qa
        self.present = np.ones(n, dtype=bool)
        clustered = {int(r) for c in equations.clusters for r in c.rows}
        on = rows_like(solution, may_go)
        rows: dict[str, list[int]] = {}
        for i, o in enumerate(solution.observations):
            # Weighted unknowns are excluded, because they are not measured.
            own = in_image_table(o.kind) or o.id in design.network.observations
            if on[i] and i not in clustered and own:
                rows.setdefault(o.id, []).append(i)
        self.rows = {k: np.array(v, dtype=np.intp) for k, v in rows.items()}
        single = np.array([len(whitened_unit_error(equations, i)[0]) == 1 for i in range(n)])
        self.single: Mask = single
        self.asked: dict[Target, Mask] = {
            t: rows_like(solution, t.observations) & single
            for t in targets
            if isinstance(t, RowTarget)
        }
        self.points: dict[Target, Index] = {
            t: np.flatnonzero(matching(list(equations.unknowns["point"].names), t.points))
            for t in targets
            if not isinstance(t, RedundancyNumber | DetectableError | DetectableDisplacement)
        }
        self.moved: dict[Target, DisplacementItems] = {
            t: displacement_items(solution, t)
            for t in targets
            if isinstance(t, DetectableDisplacement)
        }
        self.joint = {t: cofactors_at(solution, m.columns) for t, m in self.moved.items()}
        self.sigma = solution.observations.sigmas
        self.delta0 = design.reliability.delta0
        table = equations.unknowns["point"]
        self.names = list(table.names)
        self.offset = table.offset
        self.free = np.asarray(equations.unknowns.free)
        self.horizon = horizons(design.network, self.names)
        self.blocks = solution.point_covariances.copy()

    def best(self, prices: Mapping[str, float]) -> str | None:
        """Return the removable observation with the largest cost per loss."""
        chosen, value = None, 0.0
        before = self._figures()
        for ident, rows in self.rows.items():
            loss = self._loss(rows, before)
            if loss is None:
                continue
            worth = prices.get(ident, 1.0) / (max(loss, 0.0) + ROUNDED_LOSS)
            if worth > value * (1.0 + EQUAL):
                chosen, value = ident, worth
        return chosen

    def _without(self, rows: Index) -> Update:
        """Return the update of h by the removal of rows; its spread covers all observations."""
        return Update.of(self.h).with_rows(rows, np.eye(len(rows)), sign=-1)

    def _figures(self) -> dict[Target, Array]:
        """Return the present figure/limit of all scalar observations or points, by target."""
        none = np.zeros(0, dtype=np.intp)
        out = {}
        for t in self.targets:
            items, found = self._ratios(t, none, self._without(none), self.present)
            out[t] = np.zeros(max(len(self.present), len(self.names)))
            out[t][items] = found
        return out

    def _loss(self, rows: Index, before: Mapping[Target, Array]) -> float | None:
        """Return the loss by the removal of rows; None if a figure exceeds its limit."""
        update = self._without(rows)
        if not update.trusted:
            return None
        present = self.present.copy()
        present[rows] = False
        total = 0.0
        for t in self.targets:
            items, found = self._ratios(t, rows, update, present)
            if len(found) and found.max() > 1.0 - 1e-9:
                return None
            # Only remaining items count: the figures of the removed rows are gone.
            total += float((found - before[t][items]).sum())
        return total

    def _ratios(self, t: Target, rows: Index, update: Update, present: Mask) -> tuple[Index, Array]:
        """Return the items and figure/limit (or limit/figure) after the removal of rows."""
        if isinstance(t, RowTarget):
            on = np.flatnonzero(self.asked[t] & present)
            r = 1.0 - np.diag(self.h)[on] + update.losses(update.spread[on])
            safe = np.maximum(r, 1e-12)
            if isinstance(t, RedundancyNumber):
                return on, np.asarray(t.at_least / safe)
            if isinstance(t, DetectableError):
                return on, np.asarray(self.delta0 / np.sqrt(safe) / t.at_most)
            return self._shifts(t, on, rows, update, safe)
        if isinstance(t, DetectableDisplacement):
            moved = self.moved[t]
            q = self.joint[t] - update.loss(self.qa[moved.columns][:, rows])
            names = np.array([self.names.index(n) for n in moved.names], dtype=np.intp)
            return names, moved.figures(q) / limit_of(t)
        points = self.points[t]
        blocks = self.blocks[points] - update.loss(self._of_points(points, rows))
        return points, np.asarray(point_figures(t, blocks, self.horizon[points]) / limit_of(t))

    def _of_points(self, points: Index, rows: Index) -> Array:
        """Return Q Aᵀ of coordinates and rows, zero for held coordinates, (n, 3, k)."""
        columns = np.where(self.offset[points, None] >= 0, self.offset[points, None], 0)
        columns = columns + np.arange(3)
        on = (self.offset[points, None] >= 0) & self.free[columns]
        return np.asarray(np.where(on[:, :, None], self.qa[columns][:, :, rows], 0.0))

    def _shifts(
        self, t: UndetectedShift, on: Index, rows: Index, update: Update, r: Array
    ) -> tuple[Index, Array]:
        points = self.points[t]
        points = points[self.offset[points] >= 0]
        if not len(points) or not len(on):
            return on[:0], np.zeros(0)
        moved = self._of_points(points, on)
        moved = moved - update.loss(self._of_points(points, rows), update.spread[on])
        far = np.sqrt(np.sum(moved**2, axis=1)).max(axis=0)
        return on, np.asarray(far * self.delta0 / np.sqrt(r) / t.at_most)

    def take(self, ident: str, *, leave: bool) -> None:
        """Remove an observation, or keep it permanently."""
        rows = self.rows.pop(ident)
        if leave:
            return
        update = self._without(rows)
        every = np.arange(len(self.names))
        self.blocks = self.blocks - update.loss(self._of_points(every, rows))
        for t, moved in self.moved.items():
            self.joint[t] = self.joint[t] - update.loss(self.qa[moved.columns][:, rows])
        self.qa = self.qa - update.loss(self.qa[:, rows], update.spread)
        self.h = self.a @ self.qa
        self.present[rows] = False
