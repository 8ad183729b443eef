"""Data snooping: find gross errors, set them aside, adjust again, until nothing is found.

A round adjusts the network, tests every observation (Baarda's w, or Pope's τ where σ0 is not
known), and sets aside the worst by the rule of `candidates`. Where a round finds nothing more,
those set aside are predicted from the clean solution: what fits is re-admitted, once, and the
search goes on. An image point goes with x and y, a vector with all its components; what counts is
the largest test value of the components.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from scipy.stats import norm

from ..errors import AdjustmentError, InputError
from ..graph.equations import compile_network
from ..network import DatumChoice, Network
from ..selection import without
from ..solve.batch import adjust
from ..types import Array
from .candidates import Candidate, Choice, Units, choose
from .prediction import Prediction, Predictor
from .rejections import PointSetAside, Rejected, Round, Snooping, Test, Unresolved
from .reliability import critical_tau, reliability
from .robust import ESTIMATORS, Estimator
from .robust import robust as robust_adjustment
from .solution import Solution


def snoop(
    network: Network,
    *,
    alpha: float = 0.001,
    power: float = 0.80,
    test: Test = "baarda",
    sidak: bool = False,
    share: float = 0.4,
    robust: Estimator | None = None,
    max_rounds: int = 100,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | None = None,
    progress: Callable[[Round], None] | None = None,
) -> Snooping:
    """Find gross errors by iterated tests.

    Every observation can be set aside, control points and weighted unknowns among them: a
    weighted unknown without its given value is free. One without which something would not be
    determined stays in, and is listed as unresolved; but a point that only images see goes with
    all its rays where the other rays alone do not determine it.

    Args:
        network: what was measured; it is not changed.
        alpha: probability α0 of a false alarm of one test.
        power: power of the tests, for the reliability of each round.
        test: ``baarda`` where σ0 = 1 is known, ``pope`` where it is estimated.
        sidak: ``alpha`` is that of all n tests together: α0 = 1 − (1 − α)^(1/n).
        share: observations with test values from this part of the largest on may go in the same
            round, see `candidates`; 1: only the largest of each round.
        robust: set aside what this M-estimator finds first, then snoop: for many gross errors.
        max_rounds: adjustments after which the search stops.
        datum: as for `adjust`.
        variance: as for `adjust`.
        start: an earlier solution of the network to start from.
        progress: called after each round; an exception in it ends the search.

    Raises:
        InputError: unknown choices, probabilities or shares outside (0, 1]; what `adjust` raises.
        DatumError, ApproximationError: as `adjust`, for the whole network.
        AdjustmentError: as `reliability`.
    """
    problems = []
    if test not in ("baarda", "pope"):
        problems.append(f"unknown test {test!r}; valid: baarda, pope")
    if robust is not None and robust not in ESTIMATORS:
        problems.append(f"unknown estimator {robust!r}; valid: {', '.join(ESTIMATORS)}")
    if not 0 < alpha < power < 1:
        problems.append(
            f"alpha and power must lie between 0 and 1, alpha below power: {alpha}, {power}"
        )
    if not 0 < share <= 1:
        problems.append(f"share must lie between 0 and 1, not {share}")
    if max_rounds < 1:
        problems.append(f"max_rounds must be 1 or more, not {max_rounds}")
    if problems:
        raise InputError("; ".join(problems))
    if robust is None:
        solution = adjust(network, datum=datum, variance=variance, start=start)
        values = None
    else:
        scale: Literal["a-priori", "median"] = "a-priori" if test == "baarda" else "median"
        found = robust_adjustment(network, estimator=robust, scale=scale, datum=datum, start=start)
        solution, values = found.solution, found.test_values / found.scale
    if sidak:
        alpha = float(1.0 - (1.0 - alpha) ** (1.0 / solution.equations.n_rows))
    search = _Search(solution, test, alpha, power, {"datum": datum, "variance": variance})
    if values is not None:
        search.begin(values, progress)
    reason = search.run(share, max_rounds, progress)
    return search.result(reason)


class _Search:
    """Where a search stands."""

    def __init__(
        self, solution: Solution, test: Test, alpha: float, power: float, options: dict[str, Any]
    ) -> None:
        self.network = solution.network
        self.equations = compile_network(self.network)
        self.test: Test = test
        self.alpha, self.power, self.options = alpha, power, options
        self.solution = solution
        self.reliability = reliability(solution, alpha=alpha, power=power)
        self.aside: dict[str, Rejected] = {}
        self.points: dict[str, PointSetAside] = {}
        self.readmitted: list[str] = []
        self.stuck: dict[str, str] = {}
        self.place: dict[str, int] = {}
        """Which component of what was set aside had the largest test value."""
        self.rounds: list[Round] = []

    def begin(self, values: Array, progress: Callable[[Round], None] | None) -> None:
        """Set aside what stands out in a robust adjustment, by test values (n,) for σ0 = 1."""
        critical = float(norm.ppf(1.0 - self.alpha / 2.0))
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
        """Go on until nothing is found; return why it ended."""
        for number in range(1, max_rounds + 1):
            sigma0, size, critical = self.solution.sigma0, self._largest(self.values), self.critical
            gone = self._reject(share, number)
            back = 0 if gone else self._readmit()
            suspects = int((size > critical).sum())
            self._note(Round(number, sigma0, float(size.max()), suspects, gone, back), progress)
            if not gone and not back:
                if suspects:
                    return "what is still above the critical value cannot be set aside"
                return "no test value is above the critical value, nothing set aside fits again"
        return f"stopped after {max_rounds} rounds"

    @property
    def values(self) -> Array:
        """The test values that decide, (n,)."""
        return self.reliability.w if self.test == "baarda" else self.reliability.tau

    @property
    def critical(self) -> float:
        """Their critical value."""
        rel = self.reliability
        return rel.critical_w if self.test == "baarda" else rel.critical_tau

    def _largest(self, values: Array) -> Array:
        return Units.of(self.solution.equations).largest(values)

    def _note(self, done: Round, progress: Callable[[Round], None] | None) -> None:
        self.rounds.append(done)
        if progress is not None:
            progress(done)

    # -- setting aside --------------------------------------------------------------------------

    def _reject(self, share: float, number: int) -> int:
        """Set aside the worst; return how many observations."""
        while chosen := self._choice(share).chosen:
            gone = self._set_aside(chosen, number) or self._set_aside(chosen[:1], number)
            if gone:
                return gone
        return 0

    def _choice(self, share: float) -> Choice:
        return choose(
            self.reliability,
            self.values,
            scale=1.0 if self.test == "baarda" else self.solution.sigma0,
            critical=self.critical,
            share=share,
            stuck=self._units(self.stuck),
        )

    def _set_aside(self, chosen: Sequence[Candidate], number: int) -> int:
        """Adjust without them; return how many observations went, 0 if that failed."""
        aside = {r.id: r for c in chosen if c.point is None for r in [self._rejected(c, number)]}
        lost = {p.name: p for c in chosen if c.point is not None for p in [self._point(c, number)]}
        points = [*self.points, *lost]
        failure = self._adjust([*self.aside, *aside], points)
        if failure is None:
            self.aside |= aside
            self.points |= lost
            return len(aside) + sum(len(p.rays) for p in lost.values())
        if len(chosen) == 1:
            ident = self.solution.equations.id(chosen[0].row)
            self.stuck[ident] = f"without it the adjustment fails: {failure}"
        return 0

    def _adjust(self, ids: Iterable[str], points: Iterable[str]) -> AdjustmentError | None:
        """Adjust without these; return what went wrong, and stay where we were."""
        try:
            network = without(self.network, ids, points=points)
            solution = adjust(network, start=self.solution, **self.options)
            if not solution.converged and self.solution.converged:
                return AdjustmentError(solution.reason)
            rel = reliability(solution, alpha=self.alpha, power=self.power)
        except AdjustmentError as error:
            return error
        self.solution, self.reliability = solution, rel
        return None

    def _units(self, ids: Collection[str]) -> list[int]:
        """Return the numbers of observations of the solution, by id."""
        number = self.solution.equations.observation_of_row
        found = self.solution.equations.find(list(ids))
        return [int(number[rows[0]]) for rows in found if len(rows)]

    def _rejected(self, c: Candidate, number: int) -> Rejected:
        equations = self.solution.equations
        label, record = equations.label, self.solution.observations[c.row]
        self.place[record.id] = c.row - int(Units.of(equations).first[c.unit])
        return Rejected(
            record.id,
            record.kind,
            label(c.row),
            record.component,
            c.test,
            float(self.reliability.estimated_errors[c.row]),
            number,
            np.nan,
            np.nan,
            np.nan,
            tuple((label(row), rho) for row, rho in c.inseparable),
        )

    def _point(self, c: Candidate, number: int) -> PointSetAside:
        equations = self.solution.equations
        rays: list[str] = []
        for block in equations.blocks:
            if block.kind == "image":
                at = np.flatnonzero(block.variables[2][1] == c.point)
                rays += [block.ids[int(i)] for i in at]
        assert c.point is not None
        return PointSetAside(
            equations.unknowns["point"].names[c.point],
            tuple(rays),
            equations.label(c.row),
            c.test,
            number,
            f"its {len(rays)} rays do not fit, and without {equations.id(c.row)!r} the others do "
            "not determine it",
        )

    # -- putting back ---------------------------------------------------------------------------

    def _readmit(self) -> int:
        """Put back what fits the solution again, once each; return how many observations."""
        prediction = self._predicted([i for i in self.aside if i not in self.readmitted])
        if prediction is None:
            return 0
        test, critical = self._if_put_back(prediction)
        largest = np.maximum.reduceat(np.abs(test), prediction.first)
        fits = [i for i, ok in zip(prediction.ids, largest <= critical, strict=True) if ok]
        if not fits:
            return 0
        self.readmitted += fits
        if self._adjust([i for i in self.aside if i not in fits], self.points) is not None:
            return 0
        for ident in fits:
            del self.aside[ident]
        return len(fits)

    def _predicted(self, ids: Sequence[str]) -> Prediction | None:
        """Predict observations that were set aside, as far as the solution determines them."""
        found = [rows for rows in self.equations.find(ids) if len(rows)]
        if not found:
            return None
        predictor = Predictor(self.equations, self.solution)
        rows = np.sort(np.concatenate(found))
        number = self.equations.observation_of_row[rows]
        rows = rows[~np.isin(number, number[~predictor.known(rows)])]
        return predictor.predict(rows) if len(rows) else None

    def _if_put_back(self, prediction: Prediction) -> tuple[Array, Array]:
        """Return the test values (k,) that observations would have in the adjustment.

        Also the critical value for each of them, (m,). For Pope's test, vᵀPv grows by T² and the
        redundancy by the number of components.
        """
        if self.test == "baarda":
            return prediction.w, np.full(len(prediction.first), self.critical)
        f = self.solution.redundancy + prediction.size
        sigma0 = np.sqrt((self.solution.vtpv + prediction.t2) / f)
        critical = np.array([critical_tau(self.alpha, int(k)) for k in f])
        return prediction.w / np.repeat(sigma0, prediction.size), critical

    # -- what was found -------------------------------------------------------------------------

    def result(self, reason: str) -> Snooping:
        """Return it, with what was set aside predicted from the clean solution."""
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
        prediction = self._predicted(list(self.aside))
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
        """Return what is above the critical value at the end, the largest first."""
        units = Units.of(self.solution.equations)
        size = units.largest(self.values)
        above = [int(u) for u in np.argsort(-size, kind="stable") if size[u] > self.critical]
        blocked = {c.unit for c in self._choice(share=1.0).blocked} if above else set()
        out = []
        for unit in above:
            rows = units.rows(unit)
            row = int(rows[np.argmax(np.nan_to_num(np.abs(self.values[rows])))])
            record = self.solution.observations[row]
            reason = self.stuck.get(record.id, "the search stopped before it was its turn")
            if unit in blocked:
                reason = "without it something would be undetermined"
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
