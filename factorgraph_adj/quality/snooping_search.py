"""Rounds of data snooping: rejection and readmission of observations, points, users' factors.

A round takes observations out of the present solution (`SnoopingState`). Before anything is put
back, at the end, and for members of clusters, the network without the observations is adjusted
again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ..adjustment import adjust
from ..errors import AdjustmentError
from ..graph.equations import compile_network
from ..graph.observation_selection import without
from ..network.network import Network
from ..solve.solution import Solution
from ..statistical_tests import chi2_quantile, descending, fisher_quantile, normal_quantile
from ..types import Array
from .causes.cause_search import Causes, causes, every_mistaken_identity
from .causes.mistaken_identity import MistakenIdentity, merged_exchanges
from .group_tests import Test
from .joint_readings import fitting_readings
from .prediction import Prediction, Predictor
from .rejections import Rejected, RejectedFactor, RejectedPoint, Round, Snooping, Unresolved
from .reliability import Reliability, critical_tau, reliability
from .snooping_candidates import Choice, Outlier, RowGroups, choose_outliers, stated_conditions
from .snooping_state import FactorSearch, SnoopingState, rejected_components


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
                network without them again.
        """
        self.network = solution.network
        self.start = solution.start["point"]
        self.equations = solution.equations
        if solution.weights is not None:
            self.equations = compile_network(self.network)
        self.test: Test = test
        self.alpha, self.power, self.options = alpha, power, options
        self.first = reliability(solution, alpha=alpha, power=power)
        self.whole = solution if solution.weights is None else None
        self.present = SnoopingState(self.first, test)
        self.factors = FactorSearch(solution.extra, test, alpha)
        self.withdrawing = withdrawing and not self.factors
        self.aside: dict[str, Rejected] = {}
        self.points: dict[str, RejectedPoint] = {}
        self.readmitted: list[str] = []
        self.stuck: dict[str, str] = {}
        self.components: dict[str, tuple[Rejected, ...]] = {}
        """All components of the rejected observations, by id."""
        self.coordinates: dict[str, Array] = {}
        """Coordinates of each removed point at its removal, (3,) metres."""
        self.rounds: list[Round] = []
        self.exchanged: tuple[MistakenIdentity, ...] = ()
        """Exchanges found before the search."""
        self._predicted: tuple[Solution, Prediction | None] | None = None
        self._matched: tuple[Solution, tuple[MistakenIdentity, ...]] | None = None

    @property
    def solution(self) -> Solution:
        """The present solution."""
        return self.present.solution

    @property
    def reliability(self) -> Reliability:
        """Reliability of the present solution."""
        return self.present.reliability

    def begin(self, values: Array, progress: Callable[[Round], None] | None) -> None:
        """Reject the outliers of a robust adjustment, by test values (n,) for σ0 = 1."""
        critical = normal_quantile(1.0 - self.alpha / 2.0)
        chosen = choose_outliers(
            self.reliability, values, scale=1.0, critical=critical, share=0.0, every=True
        ).chosen
        sigma0, size = self.solution.sigma0, RowGroups.of(self.solution.equations).largest(values)
        gone = 0
        while chosen and not gone:
            gone = self._set_aside(chosen, 0, values)
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
            if choice.chosen and self.present.doubtful(choice):
                if not self._withdraw(()):
                    raise CannotSettle
                choice = self._choice(share)
            if self.present.unsettled and not choice.chosen:
                self._settle()
                choice = self._choice(share)
            here = self.present
            sigma0, size, critical = here.sigma0, here.largest, here.critical
            suspects = int((size > critical).sum()) + self.factors.suspects(self.reliability)
            gone = self._reject_factor(float(size.max()) / critical, number)
            gone = gone or self._reject(choice, share, number)
            back = 0 if gone else self._readmit() + self._readmit_factors()
            self._note(Round(number, sigma0, float(size.max()), suspects, gone, back), progress)
            if not gone and not back:
                if suspects:
                    return "what is still above the critical value cannot be rejected"
                if not np.isfinite(critical):
                    f = self.solution.redundancy
                    return f"no test: with a redundancy of {f} Pope's has no critical value"
                if not self.reliability.controlled.any():
                    return "no test: no observation is controlled by others"
                return "no test value is above the critical value, nothing rejected fits again"
        self._settle()
        return f"stopped after {max_rounds} rounds"

    def _note(self, done: Round, progress: Callable[[Round], None] | None) -> None:
        self.rounds.append(done)
        if progress is not None:
            progress(done)

    # -- rejection ------------------------------------------------------------------------------

    def _reject(self, choice: Choice, share: float, number: int) -> int:
        """Reject the worst observations; return their number."""
        while chosen := choice.chosen:
            gone = self._set_aside(chosen, number) or self._set_aside(chosen[:1], number)
            if gone:
                return gone
            choice = self._choice(share)
        return 0

    def _reject_factor(self, largest: float, number: int) -> int:
        """Reject the worst factor where no observation is further beyond; return how many.

        Args:
            largest: largest test value of an observation, relative to the critical value.
            number: number of the round.
        """
        while True:
            name, ratio = self.factors.worst(self.reliability)
            if not name or ratio < largest:
                return 0
            self.factors.aside[name] = RejectedFactor(name, ratio, number, np.nan)
            failure = self._adjust(self.aside, self.points)
            if failure is None:
                return 1
            del self.factors.aside[name]
            self.factors.stuck[name] = f"without it the adjustment fails: {failure}"

    def _readmit_factors(self) -> int:
        """Put factors back that fit, each once; return how many."""
        factors, back = self.factors, 0
        for name in [n for n in factors.aside if n not in factors.readmitted]:
            before, was = self.present, factors.aside.pop(name)
            if self._adjust(self.aside, self.points) is None and self._fits(name):
                factors.readmitted.append(name)
                back += 1
            else:
                self.present, factors.aside[name] = before, was
        return back

    def _fits(self, name: str) -> bool:
        return self.factors.ratios(self.reliability).get(name, 0.0) <= 1.0

    def _final_factors(self) -> Iterator[RejectedFactor]:
        """Iterate over the factors rejected, each with its test where it is put back."""
        clean, factors = self.present, self.factors
        for name, was in list(factors.aside.items()):
            del factors.aside[name]
            final = np.nan
            if self._adjust(self.aside, self.points) is None:
                final = factors.ratios(self.reliability).get(name, np.nan)
            self.present, factors.aside[name] = clean, was
            yield replace(was, final_test=final)

    def _choice(self, share: float) -> Choice:
        return self.present.choice(share, self.stuck)

    def _set_aside(self, chosen: Sequence[Outlier], number: int, tests: Array | None = None) -> int:
        """Adjust without the chosen outliers; return the number removed, 0 after a failure."""
        tests = self.present.values if tests is None else tests
        alone = [r for c in chosen if c.point is None for r in self._rejected(c, number, tests)]
        aside = {r.id: r for r in alone}
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

    def _take_out(self, chosen: Sequence[Outlier]) -> bool:
        """Update the test values for outliers that leave; return whether that is possible."""
        found = self.present.updated_without(chosen) if self.withdrawing else None
        self.present = self.present if found is None else found
        return found is not None

    def _withdraw(self, chosen: Sequence[Outlier]) -> bool:
        """Withdraw outliers, and what has left by an update; return whether that is possible."""
        found = None
        if self.withdrawing:
            found = self.present.reweighted_without(chosen, self.options["datum"])
        self.present = self.present if found is None else found
        return found is not None

    def _settle(self) -> None:
        """Adjust the network again without the observations that are withdrawn.

        Raises:
            CannotSettle: the adjustment fails.
        """
        if self.present.unsettled:
            failure = self._adjust(self.aside, self.points)
            if failure is not None:
                raise CannotSettle from failure

    def _adjust(self, ids: Iterable[str], points: Iterable[str]) -> AdjustmentError | None:
        """Adjust without observations and points; after a failure keep the state and return it."""
        try:
            network = without(self.network, ids, points=points)
            factors = self.factors.without(self.factors.aside)
            solution = adjust(network, start=self.solution, extra_factors=factors, **self.options)
            if not solution.converged and self.solution.converged:
                return AdjustmentError(solution.reason)
            rel = reliability(solution, alpha=self.alpha, power=self.power)
        except AdjustmentError as error:
            return error
        self.present = SnoopingState(rel, self.test)
        return None

    def _rejected(self, c: Outlier, number: int, tests: Array) -> Iterator[Rejected]:
        """Iterate over the observations of an outlier, each with its worst component."""
        equations, errors = self.solution.equations, self.present.tested.estimated_errors
        inseparable = tuple((equations.label(row), rho) for row, rho in c.inseparable)
        rows = RowGroups.of(equations).rows(c.unit)
        of_row = equations.observation_of_row[rows]
        for own in (rows[of_row == n] for n in dict.fromkeys(of_row.tolist())):
            every = rejected_components(equations, own, tests, errors, number, inseparable)
            self.components[every[0].id] = every
            size = np.nan_to_num(np.abs(tests[own]))
            yield every[c.row - int(own[0]) if c.row in own else int(descending(size)[0])]

    def _point(self, c: Outlier, number: int) -> RejectedPoint:
        equations = self.solution.equations
        assert c.point is not None
        ids = [equations.id(int(row)) for row in self.present.rays(c.point)]
        rays = [ident for ident in ids if ident not in self.aside]
        name = equations.unknowns["point"].names[c.point]
        self.coordinates[name] = self.solution.point(name)
        return RejectedPoint(
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
        fitting = dict(zip(prediction.ids, fits.tolist(), strict=True))
        fitting |= fitting_readings(prediction, self.solution, self.test, self.alpha)
        return [i for i, ok in fitting.items() if ok and i not in self.readmitted]

    def _fitting_points(self) -> list[str]:
        """Return the removed points whose rays intersect: T² of the intersection passes."""
        predictor = Predictor(self.equations, self.solution)
        pope, f = self.test == "pope", self.solution.redundancy
        wanted = {}
        for name, point in self.points.items():
            rows = np.sort(np.concatenate(self.equations.find(point.rays)))
            if len(rows) > 3 and not set(point.rays) & set(self.readmitted):
                wanted[name] = self.coordinates[name], rows
        out = []
        for name, found in predictor.intersections(wanted).items():
            if found is None:
                continue
            limit = chi2_quantile(1.0 - self.alpha, found.dof)
            if pope:
                quantile = fisher_quantile(1.0 - self.alpha, found.dof, f)
                limit = quantile * found.dof * self.solution.sigma0**2
            if found.t2 <= limit:
                out.append(name)
        return out

    def _prediction(self) -> Prediction | None:
        """Return the prediction of the observations rejected; a solution makes it once."""
        if self._predicted is None or self._predicted[0] is not self.solution:
            self._predicted = self.solution, self._predict()
        return self._predicted[1]

    def _predict(self) -> Prediction | None:
        """Predict the observations rejected that the solution determines."""
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
            return prediction.w, np.full(len(prediction.first), self.present.critical)
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
            (*self.readmitted, *self.factors.readmitted),
            tuple(self.points.values()),
            (*self._unresolved(), *self.factors.unresolved(self.reliability)),
            tuple(self.rounds),
            self.present.critical,
            self.test,
            reason,
            tuple(self._final_factors()),
            self.whole,
            self._causes,
        )

    def _causes(self) -> Causes | None:
        """Return what may have caused the misfits; None where no test of a known σ0 is critical."""
        first = self.first
        if self.whole is None:  # a robust start hides causes that several share
            first = self.reliability  # where nothing is bent, if the whole has no minimum
            with suppress(AdjustmentError):
                options = {**self.options, "extra_factors": self.factors.given}
                plain = adjust(self.network, start=self.solution, **options)
                if plain.converged:
                    first = reliability(plain, alpha=self.alpha, power=self.power)
        largest, pope = float(np.nanmax(np.abs(first.w), initial=0.0)), self.test == "pope"
        if not pope and not self.ids_aside() and not largest > self.present.critical:
            return None
        return causes(first, self.matches(), estimated=pope)

    def matches(self) -> tuple[MistakenIdentity, ...]:
        """Return identities under which rejected observations fit, computed once for a solution."""
        if self._matched is None or self._matched[0] is not self.solution:
            explained = {i for m in self.exchanged for i in m.ids}
            bad = [i for i in self.ids_aside() if i not in explained], self._above()
            again, pope = not self.factors.given.factors, self.test == "pope"
            found = every_mistaken_identity(
                self.equations, self.solution, *bad, self.alpha, again=again, estimated=pope
            )
            self._matched = self.solution, tuple(merged_exchanges([*self.exchanged, *found]))
        return self._matched[1]

    def _above(self) -> list[str]:
        """Return the ids of observations above the critical value that have stayed."""
        rows = np.flatnonzero(np.abs(self.present.values) > self.present.critical)
        return [self.solution.equations.id(int(row)) for row in rows]

    def ids_aside(self) -> list[str]:
        """Return the ids of all observations rejected, with the rays of points."""
        return [*self.aside, *(i for p in self.points.values() for i in p.rays)]

    def _with_final_errors(self) -> tuple[Rejected, ...]:
        prediction = self._prediction()
        if prediction is None:
            return tuple(self.aside.values())
        test, _ = self._if_put_back(prediction)
        out = dict(self.aside)
        for number, ident in enumerate(prediction.ids):
            first, size = int(prediction.first[number]), int(prediction.size[number])
            # Gross errors bend the adjustment with them; the clean one tells components apart.
            place = int(descending(np.nan_to_num(np.abs(test[first : first + size])))[0])
            at = first + place
            out[ident] = replace(
                self.components[ident][place],
                final_error=-float(prediction.innovation[at]),
                final_sigma=float(prediction.sigma[at]),
                final_test=float(test[at]),
            )
        return tuple(out.values())

    def _unresolved(self) -> tuple[Unresolved, ...]:
        """Return the observations above the critical value at the end, the largest first."""
        units, size = RowGroups.of(self.solution.equations), self.present.largest
        order = descending(size)
        above = order[size[order] > self.present.critical].tolist()
        last = self._choice(share=1.0) if above else Choice((), ())
        blocked = {c.unit for c in last.blocked}
        protected = stated_conditions(self.solution.equations, units)
        out = []
        for unit in above:
            row = units.worst_row(unit, self.present.values)
            record = self.solution.observations[row]
            reason = self.stuck.get(record.id)
            if protected[unit]:
                reason = "it is a condition, which is never rejected"
            elif unit in blocked:
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
                    float(np.copysign(size[unit], self.present.values[row])),
                    float(self.reliability.estimated_errors[row]),
                    reason,
                )
            )
        return tuple(out)
