"""The search of data snooping: its state and its rounds.

A round takes observations out of the present solution in one of three ways:

1. Few rows leave by a low-rank update of the factor (`UpdatedTests`), as long as what the linear
   model leaves out cannot change the choice of the next round.
2. The weights of more rows become negligible, and the equations are adjusted with the structure
   that they have (`readjust`).
3. Before anything is put back, at the end, and for members of clusters, the network without the
   observations is adjusted anew.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import AdjustmentError, InputError
from ..graph.equations import compile_network
from ..network.network import Network
from ..network.selection import without
from ..solve.batch import adjust, readjust
from ..solve.solution import Solution
from ..types import Array, Index
from .candidates import Choice, Outlier, Units, choose
from .distributions import chi2_quantile, fisher_quantile, normal_quantile
from .prediction import Prediction, Predictor
from .rejections import PointSetAside, Rejected, Round, Snooping, Test, Unresolved
from .reliability import Reliability, critical_tau, reliability
from .updated_tests import UpdatedTests

NEGLIGIBLE = 1e-20
"""Factor on the weight of a withdrawn observation: below the rounding of all others, yet a point
without other observations keeps its place."""


MOST_UPDATED = 64
"""Largest number of rows that leave by an update: with as many right sides, solution and products
cost less than half of what weights cost in Roma, and a tenth in a grid of 10 000 points."""
MOST_LEFT_OUT = 0.01
"""Largest length of what the linear model leaves out of the whitened residuals in an update. Test
values change by about this length, so that the margin of a choice, which is relative to test values
of 3 and more, must exceed the length too."""


class CannotSettle(Exception):
    """The network cannot be adjusted without the observations that rounds have withdrawn."""


class SnoopingSearch:
    """State of a search."""

    def __init__(
        self,
        solution: Solution,
        test: Test,
        alpha: float,
        power: float,
        options: dict[str, Any],
        *,
        withdrawing: bool = True,
    ) -> None:
        """Begin with an adjusted network.

        Args:
            solution: the adjustment of the whole network.
            test: the test that decides.
            alpha: probability α0 of a false alarm of one test.
            power: power of the tests.
            options: options of every adjustment.
            withdrawing: whether rounds withdraw observations; false: every round adjusts the
                network without them anew.
        """
        self.network = solution.network
        self.start = solution.start["point"]
        self.equations = solution.equations
        if solution.weights is not None:
            self.equations = compile_network(self.network)
        self.test: Test = test
        self.alpha, self.power, self.options = alpha, power, options
        self.solution = solution
        self.reliability = reliability(solution, alpha=alpha, power=power)
        self.withdrawing = withdrawing
        self.weights: Array | None = None
        """Factors on the weights of the present solution; none: no observation is withdrawn."""
        self.updated: UpdatedTests | None = None
        """Update of the present solution; none: no observation has left it."""
        self.withdrawn = 0
        """Redundancy that withdrawn observations, and those of the update, have taken along."""
        self.aside: dict[str, Rejected] = {}
        self.points: dict[str, PointSetAside] = {}
        self.readmitted: list[str] = []
        self.stuck: dict[str, str] = {}
        self.place: dict[str, int] = {}
        """Component with the largest test value, by id of the observation set aside."""
        self.coordinates: dict[str, Array] = {}
        """Coordinates of each removed point at its removal, (3,) metres."""
        self.rounds: list[Round] = []
        self._predicted: tuple[Solution, Prediction | None] | None = None

    def begin(self, values: Array, progress: Callable[[Round], None] | None) -> None:
        """Set aside the outliers of a robust adjustment, by test values (n,) for σ0 = 1."""
        critical = normal_quantile(1.0 - self.alpha / 2.0)
        chosen = choose(
            self.reliability, values, scale=1.0, critical=critical, share=0.0, every=True
        ).chosen
        sigma0, size = self.solution.sigma0, self._largest(values)
        gone = 0
        while chosen and not gone:
            gone = self._set_aside(chosen, 0)
            chosen = chosen[: len(chosen) // 2]
        if not gone:
            failure = self._adjust((), ())
            if failure is not None:
                raise failure
        self._note(
            Round(0, sigma0, float(size.max()), int((size > critical).sum()), gone, 0), progress
        )

    def run(self, share: float, max_rounds: int, progress: Callable[[Round], None] | None) -> str:
        """Run rounds until nothing changes; return the reason why the search ended."""
        for number in range(1, max_rounds + 1):
            choice = self._choice(share)
            if choice.chosen and self._doubtful(choice):
                if not self._withdraw(()):
                    raise CannotSettle
                choice = self._choice(share)
            if self._unsettled and not choice.chosen:
                self._settle()
                choice = self._choice(share)
            sigma0, size, critical = self.sigma0, self._largest(self.values), self.critical
            gone = self._reject(choice, share, number)
            back = 0 if gone else self._readmit()
            suspects = int((size > critical).sum())
            self._note(Round(number, sigma0, float(size.max()), suspects, gone, back), progress)
            if not gone and not back:
                if suspects:
                    return "what is still above the critical value cannot be set aside"
                if not np.isfinite(critical):
                    f = self.solution.redundancy
                    return f"no test: with a redundancy of {f} Pope's has no critical value"
                if not self.reliability.controlled.any():
                    return "no test: no observation is controlled by others"
                return "no test value is above the critical value, nothing set aside fits again"
        self._settle()
        return f"stopped after {max_rounds} rounds"

    @property
    def tested(self) -> Reliability | UpdatedTests:
        """Test values of the present solution."""
        return self.reliability if self.updated is None else self.updated

    @property
    def _unsettled(self) -> bool:
        """Whether observations are out of the solution that are in its network."""
        return self.weights is not None or self.updated is not None

    def _doubtful(self, choice: Choice) -> bool:
        """Return whether an adjustment might choose otherwise than the update."""
        return self.updated is not None and choice.margin <= self.updated.left_out

    @property
    def redundancy(self) -> int:
        """Redundancy without the withdrawn observations."""
        return self.solution.redundancy - self.withdrawn

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight without the withdrawn observations."""
        f = self.redundancy
        vtpv = self.solution.vtpv if self.updated is None else self.updated.vtpv
        return float(np.sqrt(vtpv / f)) if f > 0 else np.nan

    @property
    def values(self) -> Array:
        """The test values that decide, (n,): w, or τ = w/σ̂0; NaN where vᵀPv vanishes."""
        w = self.tested.w
        if self.test == "baarda":
            return w
        return w / self.sigma0 if self.sigma0 > 0 else np.full(len(w), np.nan)

    @property
    def critical(self) -> float:
        """Critical value of the test values."""
        if self.test == "baarda":
            return self.reliability.critical_w
        return critical_tau(self.alpha, self.redundancy)

    def _largest(self, values: Array) -> Array:
        return Units.of(self.solution.equations).largest(values)

    def _note(self, done: Round, progress: Callable[[Round], None] | None) -> None:
        self.rounds.append(done)
        if progress is not None:
            progress(done)

    # -- setting aside --------------------------------------------------------------------------

    def _reject(self, choice: Choice, share: float, number: int) -> int:
        """Set aside the worst observations; return their number."""
        while chosen := choice.chosen:
            gone = self._set_aside(chosen, number) or self._set_aside(chosen[:1], number)
            if gone:
                return gone
            choice = self._choice(share)
        return 0

    def _choice(self, share: float) -> Choice:
        return choose(
            self.tested,
            self.values,
            scale=1.0 if self.test == "baarda" else self.sigma0,
            critical=self.critical,
            share=share,
            stuck=self._units(self.stuck),
            gone=() if self.updated is None else self._units_of(self.updated.gone),
        )

    def _set_aside(self, chosen: Sequence[Outlier], number: int) -> int:
        """Adjust without the chosen outliers; return the number removed, 0 after a failure."""
        aside = {r.id: r for c in chosen if c.point is None for r in [self._rejected(c, number)]}
        lost = {p.name: p for c in chosen if c.point is not None for p in [self._point(c, number)]}
        points = [*self.points, *lost]
        failure = None
        if not self._take_out(chosen) and not self._withdraw(chosen):
            failure = self._adjust([*self.aside, *aside], points)
        if failure is None:
            self.aside |= aside
            self.points |= lost
            return len(aside) + sum(len(p.rays) for p in lost.values())
        if len(chosen) == 1:
            ident = self.solution.equations.id(chosen[0].row)
            self.stuck[ident] = f"without it the adjustment fails: {failure}"
        return 0

    def _rows(self, chosen: Sequence[Outlier]) -> Index | None:
        """Return the rows of outliers, (k,), with all rays of points that are set aside.

        None for members of clusters: the weights of the other members depend on them.
        """
        equations, units = self.solution.equations, Units.of(self.solution.equations)
        rows = [np.zeros(0, dtype=np.intp)]
        rows += [units.rows(c.unit) for c in chosen if c.point is None]
        for c in chosen:
            if c.point is not None:
                rows.append((self._rays(c.point)[:, None] + np.arange(2)).ravel())
        out = np.concatenate(rows)
        joint = np.concatenate([np.zeros(0, dtype=np.intp), *(c.rows for c in equations.clusters)])
        return None if np.isin(out, joint).any() else out

    def _take_out(self, chosen: Sequence[Outlier]) -> bool:
        """Update the test values for outliers that leave; return whether that is possible."""
        own = self.solution.weights is None or self.weights is not None
        rows = self._rows(chosen)
        if (
            not self.withdrawing
            or not own
            or rows is None
            or any(c.point is not None for c in chosen)
        ):
            return False
        before = UpdatedTests.of(self.reliability) if self.updated is None else self.updated
        if len(before.gone) + len(rows) > MOST_UPDATED:
            return False
        after = before.without(rows)
        if after is None or after.left_out > MOST_LEFT_OUT:
            return False
        self.updated = after
        self.withdrawn += len(rows)
        return True

    def _withdraw(self, chosen: Sequence[Outlier]) -> bool:
        """Adjust with negligible weights of outliers, and of what has left by an update.

        Returns:
            Whether that is possible.
        """
        rows, equations = self._rows(chosen), self.solution.equations
        if not self.withdrawing or rows is None:
            return False
        weights = np.ones(equations.n_rows) if self.weights is None else self.weights.copy()
        if self.updated is not None:
            weights[self.updated.gone] = NEGLIGIBLE
        rows = rows[weights[rows] == 1.0]
        weights[rows] = NEGLIGIBLE
        try:
            solution = readjust(self.solution, weights, datum=self.options["datum"])
            if not solution.converged:
                return False
            rel = reliability(solution, alpha=self.alpha, power=self.power)
        except AdjustmentError:
            return False
        self.solution, self.reliability, self.weights = solution, rel, weights
        self.updated = None
        self.withdrawn += len(rows) - 3 * sum(c.point is not None for c in chosen)
        return True

    def _settle(self) -> None:
        """Adjust the network anew without the observations that are withdrawn.

        Raises:
            CannotSettle: the adjustment fails.
        """
        if self._unsettled:
            failure = self._adjust(self.aside, self.points)
            if failure is not None:
                raise CannotSettle from failure

    def _adjust(self, ids: Iterable[str], points: Iterable[str]) -> AdjustmentError | None:
        """Adjust without observations and points; after a failure keep the state and return it."""
        try:
            network = without(self.network, ids, points=points)
            solution = adjust(network, start=self.solution, **self.options)
            if not solution.converged and self.solution.converged:
                return AdjustmentError(solution.reason)
            rel = reliability(solution, alpha=self.alpha, power=self.power)
        except AdjustmentError as error:
            return error
        self.solution, self.reliability = solution, rel
        self.weights, self.updated, self.withdrawn = None, None, 0
        return None

    def _units(self, ids: Collection[str]) -> list[int]:
        """Return the numbers of the observations with these ids in the solution."""
        found = self.solution.equations.find(list(ids))
        return self._units_of(np.array([rows[0] for rows in found if len(rows)], dtype=np.intp))

    def _units_of(self, rows: Index) -> list[int]:
        """Return the numbers of the observations with these rows."""
        number = self.solution.equations.observation_of_row
        return [int(n) for n in number[rows]]

    def _rejected(self, c: Outlier, number: int) -> Rejected:
        equations = self.solution.equations
        label, record = equations.label, self.solution.observations[c.row]
        self.place[record.id] = c.row - int(Units.of(equations).first[c.unit])
        return Rejected(
            record.id,
            record.kind,
            label(c.row),
            record.component,
            c.test,
            float(self.tested.estimated_errors[c.row]),
            number,
            np.nan,
            np.nan,
            np.nan,
            tuple((label(row), rho) for row, rho in c.inseparable),
        )

    def _rays(self, point: int) -> Index:
        """Return the first row of every ray to a point, (k,)."""
        return np.concatenate(
            [
                block.first_row + 2 * np.flatnonzero(block.variables[2][1] == point)
                for block in self.solution.equations.blocks
                if block.kind == "image"
            ]
        )

    def _point(self, c: Outlier, number: int) -> PointSetAside:
        equations = self.solution.equations
        assert c.point is not None
        ids = [equations.id(int(row)) for row in self._rays(c.point)]
        rays = [ident for ident in ids if ident not in self.aside]
        name = equations.unknowns["point"].names[c.point]
        self.coordinates[name] = self.solution.point(name)
        return PointSetAside(
            name,
            tuple(rays),
            equations.label(c.row),
            c.test,
            number,
            f"its {len(rays)} rays do not fit, and without {equations.id(c.row)!r} the others do "
            "not determine it",
        )

    # -- putting back ---------------------------------------------------------------------------

    def _readmit(self) -> int:
        """Put back observations and points that fit, each once; return how many observations."""
        ids, points = self._fitting(), self._fitting_points()
        rays = [ray for name in points for ray in self.points[name].rays]
        if not ids and not points:
            return 0
        if points:
            self.network = self._with_start(points)
        self.readmitted += [*ids, *rays]
        aside = [i for i in self.aside if i not in ids]
        if self._adjust(aside, [p for p in self.points if p not in points]) is not None:
            return 0
        for ident in ids:
            del self.aside[ident]
        for name in points:
            del self.points[name]
        return len(ids) + len(rays)

    def _with_start(self, points: Collection[str]) -> Network:
        """Return the network with the first start coordinates of the points.

        The inner constraints refer to these coordinates.
        """
        network = self.network.copy()
        for name, x in zip(network.points, self.start.tolist(), strict=True):
            if name in points:
                network.points[name] = replace(network.points[name], coordinates=tuple(x))
        return network

    def _fitting(self) -> list[str]:
        """Return the removed observations whose predicted test value passes the test."""
        prediction = self._prediction()
        if prediction is None:
            return []
        test, critical = self._if_put_back(prediction)
        fits = np.maximum.reduceat(np.abs(test), prediction.first) <= critical
        fitting = [i for i, ok in zip(prediction.ids, fits, strict=True) if ok]
        return [i for i in fitting if i not in self.readmitted]

    def _fitting_points(self) -> list[str]:
        """Return the removed points whose rays intersect: T² of the intersection passes."""
        predictor = Predictor(self.equations, self.solution)
        pope, f = self.test == "pope", self.solution.redundancy
        out = []
        for name, point in self.points.items():
            rows = np.sort(np.concatenate(self.equations.find(point.rays)))
            if len(rows) <= 3 or set(point.rays) & set(self.readmitted):
                continue
            try:
                found = predictor.intersect(name, self.coordinates[name], rows)
            except InputError:
                continue
            limit = chi2_quantile(1.0 - self.alpha, found.dof)
            if pope:
                quantile = fisher_quantile(1.0 - self.alpha, found.dof, f)
                limit = quantile * found.dof * self.solution.sigma0**2
            if found.t2 <= limit:
                out.append(name)
        return out

    def _prediction(self) -> Prediction | None:
        """Return the prediction of the observations set aside; a solution makes it once."""
        if self._predicted is None or self._predicted[0] is not self.solution:
            self._predicted = self.solution, self._predict()
        return self._predicted[1]

    def _predict(self) -> Prediction | None:
        """Predict the observations set aside that the solution determines."""
        found = [rows for rows in self.equations.find(list(self.aside)) if len(rows)]
        if not found:
            return None
        predictor = Predictor(self.equations, self.solution)
        rows = np.sort(np.concatenate(found))
        number = self.equations.observation_of_row[rows]
        rows = rows[~np.isin(number, number[~predictor.known(rows)])]
        return predictor.predict(rows) if len(rows) else None

    def _if_put_back(self, prediction: Prediction) -> tuple[Array, Array]:
        """Return test values (k,) and critical values (m,) of observations put back.

        For Pope's test vᵀPv increases by T², and the redundancy by the number of components.
        """
        if self.test == "baarda":
            return prediction.w, np.full(len(prediction.first), self.critical)
        f = self.solution.redundancy + prediction.size
        sigma0 = np.sqrt((self.solution.vtpv + prediction.t2) / f)
        critical = np.array([critical_tau(self.alpha, int(k)) for k in f])
        return prediction.w / np.repeat(sigma0, prediction.size), critical

    # -- result ---------------------------------------------------------------------------------

    def result(self, reason: str) -> Snooping:
        """Return the result, with final errors from the clean solution."""
        return Snooping(
            self.solution,
            self.reliability,
            self._with_final_errors(),
            tuple(self.readmitted),
            tuple(self.points.values()),
            self._unresolved(),
            tuple(self.rounds),
            self.critical,
            self.test,
            reason,
        )

    def _with_final_errors(self) -> tuple[Rejected, ...]:
        prediction = self._prediction()
        if prediction is None:
            return tuple(self.aside.values())
        test, _ = self._if_put_back(prediction)
        out = dict(self.aside)
        for number, ident in enumerate(prediction.ids):
            at = int(prediction.first[number]) + self.place[ident]
            out[ident] = replace(
                out[ident],
                final_error=-float(prediction.innovation[at]),
                final_sigma=float(prediction.sigma[at]),
                final_test=float(test[at]),
            )
        return tuple(out.values())

    def _unresolved(self) -> tuple[Unresolved, ...]:
        """Return the observations above the critical value at the end, the largest first."""
        units = Units.of(self.solution.equations)
        size = units.largest(self.values)
        order = np.argsort(-size, kind="stable")
        above = order[size[order] > self.critical].tolist()
        last = self._choice(share=1.0) if above else Choice((), ())
        blocked = {c.unit for c in last.blocked}
        out = []
        for unit in above:
            rows = units.rows(unit)
            row = int(rows[np.argmax(np.nan_to_num(np.abs(self.values[rows])))])
            record = self.solution.observations[row]
            reason = self.stuck.get(record.id)
            if unit in blocked:
                reason = "without it something would be undetermined"
            elif reason is None and last.chosen:
                reason = "the search stopped before it was its turn"
            elif reason is None:
                reason = "a larger one that stays may explain it"
            out.append(
                Unresolved(
                    record.id,
                    record.kind,
                    self.solution.equations.label(row),
                    record.component,
                    float(self.values[row]),
                    float(self.reliability.estimated_errors[row]),
                    reason,
                )
            )
        return tuple(out)
