"""The latest arrivals as a low-rank part beside a factorised system: no tree is touched.

With N = L Lᵀ factorised once and Q₀ = N⁻¹, rows A that arrive since then give

    Q = Q₀ − G Gᵀ,    G ← [G, Q Aᵀ R⁻¹],    RᵀR = I + A Q Aᵀ        (Sherman, Morrison, Woodbury)

so that Q Aᵀ of an arriving row, its test, the step of all unknowns and the loss of all variances
cost one solution and products with the thin G. An arrival that is not kept has changed nothing.
After `MOST` rows they go into iSAM2, which holds the whole system, and N is factorised again.

What the linear forms miss by then is estimated from what they miss at one trial state, where every
unknown is away by its conditional standard deviation: up to there gᵀQg and Σρ² grow at least with
the square of that distance (`factorgraph_adj.incremental.rows`).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from ..errors import InputError
from ..models.variables import VariableKind
from ..types import Array, Index
from .register import Register
from .rows import Store

MOST = 128
"""Rows of the low-rank part."""
FEW = 0.05
"""Part of the unknowns that are picked out of it, and not gone through one and all."""
PRECISE = 1e-6
"""Relative residual of a solution up to which the factorisation is trusted."""
REFINED = 1e-12
"""That from which on the solution is refined."""
SEED = 1986
"""Of the directions of the trial state."""


class Recent:
    """Q of a system, and of what has arrived since."""

    def __init__(
        self, store: Store, held: list[tuple[int, float]], order: Index | None = None
    ) -> None:
        """Factorise the normal equations of all rows.

        Args:
            store: the rows.
            held: place and weight of what carries a minimal datum.
            order: places in the order of their elimination; none: by minimum degree, which is
                quick only where no unknown has thousands of observations.

        Raises:
            RuntimeError: they are singular to working precision.
        """
        register = store.register
        a = sparse_rows(store)
        n = register.n_places
        extra = np.zeros(n)
        for place, weight in held:
            extra[place] += weight**2
        normal = csc_array(a.T @ a) + diags_array(extra)
        self.normal = csc_array(normal)
        diagonal = self.normal.diagonal()
        if not np.all(diagonal > 0):
            raise RuntimeError("an unknown without rows")
        self.scale = 1.0 / np.sqrt(diagonal)
        scaled = csc_array(diags_array(self.scale) @ self.normal @ diags_array(self.scale))
        self.order = np.arange(n) if order is None else order
        self.factor = splu(
            scaled if order is None else csc_array(scaled[order][:, order]),
            permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        self.g = np.zeros((MOST, n)).T  # columns lie together: the first are all that is read
        self.used = 0
        self.precise = True
        self._probe(store)

    def full(self, rows: int) -> bool:
        """Return whether there is no room for some more rows."""
        return self.used + rows > MOST

    def times(self, b: Array) -> Array:
        """Return Q b, (n, k)."""
        size = np.linalg.norm(b, axis=0)
        x = self._solve(b)
        left = b - self.normal @ x
        if not np.all(np.linalg.norm(left, axis=0) <= REFINED * size):
            x += self._solve(left)
            left = b - self.normal @ x
        self.precise = bool(np.all(np.linalg.norm(left, axis=0) <= PRECISE * size))
        g = self.g[:, : self.used]
        rows = np.flatnonzero(b.any(axis=1))
        few = len(rows) < FEW * len(b)  # as of a row that arrives
        return np.asarray(x - g @ (g[rows].T @ b[rows] if few else g.T @ b))

    def _solve(self, b: Array) -> Array:
        x = np.empty_like(b)
        x[self.order] = self.factor.solve((self.scale[:, None] * b)[self.order])
        return np.asarray(self.scale[:, None] * x)

    def absorb(self, y: Array, d: Array) -> Array:
        """Add rows with y = Q Aᵀ (n, k) and D = I + A Q Aᵀ; return the loss of all variances."""
        upper = np.linalg.cholesky(d).T
        new = y @ np.linalg.inv(upper)
        k = y.shape[1]
        self.g[:, self.used : self.used + k] = new
        self.used += k
        return np.asarray(np.sum(new**2, axis=1))

    # -- how far the linear forms hold --------------------------------------------------------

    def _probe(self, store: Store) -> None:
        """Find what the linear forms of each variable's rows miss one conditional σ away."""
        register = store.register
        rng = np.random.default_rng(SEED)
        here = register.vector()
        weight = np.zeros(register.n_places)
        for table in register.tables.values():
            inside = table.place.view >= 0
            weight[table.place.view[inside]] = table.weight.view[inside]
        step = rng.choice([-1.0, 1.0], size=len(here)) / np.sqrt(np.maximum(weight, 1e-300))
        gradient = np.zeros(register.n_places)
        self.turned: dict[VariableKind, Array] = {
            kind: np.zeros(table.n) for kind, table in register.tables.items()
        }
        try:
            register.move_to(here + step)
            for rows, at in store.everything().rows:
                found = store.misfit(rows, at)
                store.add_gradient(gradient, rows, at, found.gaps)
                for kind, index in zip(rows.kinds, rows.index, strict=True):
                    np.add.at(self.turned[kind], index.view[at], found.turned)
        except InputError as error:
            raise RuntimeError(f"the trial state has no answer: {error}") from None
        finally:
            register.move_to(here)
        self.share = self._shares(register, gradient - store.gradient())
        self.missed_before = self.bound(store.gradient())
        self.turned_before = store.turned()

    def _shares(self, register: Register, gradient: Array) -> dict[VariableKind, Array]:
        """Return each variable's share of gᵀQg at the trial state."""
        each = gradient**2 * register.all_variances()
        total = float(each.sum())
        if total > 0:
            each *= self.bound(gradient) ** 2 / total
        padded = np.append(each, 0.0)
        return {
            kind: padded[table.place.view].sum(axis=1) for kind, table in register.tables.items()
        }

    def bound(self, gradient: Array) -> float:
        """Return √(gᵀQg)."""
        q = self.times(gradient[:, None])[:, 0]
        return float(np.sqrt(max(float(gradient @ q), 0.0)))

    def holds(self, register: Register, step: float, turned: float) -> bool:
        """Return whether what the linear forms can miss by now stays below bounds.

        Args:
            register: where the variables are.
            step: bound of the step that is left, relative to σ.
            turned: bound of √Σρ².
        """
        left, change = 0.0, self.turned_before
        for kind, table in register.tables.items():
            n = len(self.share[kind])
            if not n:
                continue
            far = table.far_from(table.lined)[:n]
            left += float(self.share[kind] @ far**2)
            change += float(self.turned[kind] @ far**2)
        return self.missed_before + np.sqrt(left) <= step and change <= turned**2


def sparse_rows(store: Store) -> csc_array:
    """Return the whitened partials of all rows, (rows, n_places)."""
    values: list[Array] = []
    row: list[Index] = []
    column: list[Index] = []
    register = store.register
    first = 0
    for rows, at in store.everything().rows:
        d = rows.template.dimension
        own = first + np.arange(len(at) * d).reshape(len(at), d)
        first += len(at) * d
        grouped = rows.group.view[at] >= 0
        for kind, index, a in zip(rows.kinds, rows.index, rows.a, strict=True):
            partials = a.view[at]
            k = partials.shape[2]
            place = register[kind].place.view[index.view[at], :k]
            on = (place >= 0) & ~grouped[:, None]
            full = np.broadcast_to(on[:, None, :], partials.shape)
            values.append(partials[full])
            row.append(np.broadcast_to(own[:, :, None], partials.shape)[full])
            column.append(np.broadcast_to(place[:, None, :], partials.shape)[full])
    for group in store.groups.values():
        size = len(group.whitener)
        dense: dict[int, Array] = {}
        for (rows, at), order in zip(group.members, group.order, strict=True):
            for kind, index, a in zip(rows.kinds, rows.index, rows.a, strict=True):
                for i, number in enumerate(index.view[at].tolist()):
                    places = register[kind].place.view[number, : a.view.shape[2]]
                    for j, place in enumerate(places.tolist()):
                        if place >= 0:
                            part = dense.setdefault(place, np.zeros(size))
                            part[order[i]] += a.view[at[i]][:, j]
        if dense:
            columns = np.array(list(dense), dtype=np.intp)
            whole = group.whitener @ np.stack(list(dense.values()), axis=1)
            values.append(whole.ravel())
            row.append(np.repeat(first + np.arange(size), len(columns)))
            column.append(np.tile(columns, size))
        first += size
    none = [np.zeros(0)]
    places = (np.concatenate(row or none), np.concatenate(column or none))
    shape = (first, register.n_places)
    return csc_array(coo_array((np.concatenate(values or none), places), shape=shape))
