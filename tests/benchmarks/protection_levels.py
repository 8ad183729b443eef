"""Do protection levels hold? ``python -m tests.benchmarks.protection_levels [TRIALS [NETWORK …]]``.

Networks of public data sets and simulated ones, in the linear model: errors of all observations are
drawn, gross errors are added to one reading or two, all tests of data snooping are made, and the
errors of the coordinates follow. For each risk, 10⁻² to 10⁻⁴, and one and two faults the command
counts the trials in which an error exceeds its level and no test rejects. Faults are

``worst``        the fault mode that the level names, in its worst direction and size
``adversarial``  the fault with the largest probability that a search over modes, directions and
                 sizes finds, by trials of the tests and the law of the error
``random``       random readings and sizes; the largest share of any coordinate

and after data snooping (``snooping``): a random fault of random size, readings with the largest
|w| are rejected one after the other as long as a test rejects, at most two, and the error of the
adjusted rest counts against the level of that outcome.

Every share is to be at most the risk; its 99 % interval (Clopper and Pearson) stands beside it.
``tight`` is the level that these trials would have kept, over the level; with few exceedances it is
that of a smaller risk. The equations are dense and apart from those of the package. Exit code 1: a
share exceeds the risk, with its whole interval.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np
from scipy.optimize import linprog
from scipy.stats import beta, norm

import factorgraph_adj as fga
from factorgraph_adj.quality.causes.shared_error_tests import whitening_matrix
from factorgraph_adj.quality.protection_levels import FIGURES, ProtectionLevels
from factorgraph_adj.types import Array, Index
from tests.networks.dam import Weather, dam_epoch
from tests.networks.free import levelled
from tests.support.places import DATA
from tests.support.scatter import NETWORKS, measure

RISKS = (1e-2, 1e-3, 1e-4)
TRIALS = 1_000_000
AT_ONCE = 50_000
"""Trials in one product of matrices."""
GAMA = {
    "levelling (Štroner)": "gama_levelling/stroner-levelling-a.gkf",
    "Niemeier in plan": "krumm_textbook/Niemeier_DistanceDirection_fix.gkf",
    "Ghilani 16.2": "krumm_textbook/Ghilani16_2_DistanceAngleAzimuth_fix.gkf",
}
"""Networks of public files, by name."""
SIMULATED = {
    "distances": "slope_distance",
    "directions": "direction",
    "GNSS vectors": "gnss_vector",
    "control": "control",
}
"""Simulated ones, kinds of `tests.support.scatter`."""
SIZES = np.arange(0.25, 7.1, 0.25)
"""Noncentralities that the search tries."""
SEARCH_TRIALS = 4_000
"""Trials of each of the best candidates of the search."""
MOST_REJECTED = 2
"""Largest number of observations that data snooping rejects in a trial; others are not accepted."""
CANDIDATES = 24
"""Number of these."""
LEAST_SINGULAR = 1e-9
"""Singular value, relative to the largest, of A with columns of unit length: an open datum."""


def networks() -> dict[str, Callable[[], fga.Network]]:
    """Return the networks of the command; those without files are left out."""
    out: dict[str, Callable[[], fga.Network]] = {}
    for name, file in GAMA.items():
        path = DATA / file
        if path.is_file():
            out[name] = lambda path=path: fga.read(path)
    for name, kind in SIMULATED.items():
        out[name] = lambda kind=kind: measure(NETWORKS[kind](), seed=0)
    out["dam, free datum"] = lambda: dam_epoch(
        np.random.default_rng(1), weather=Weather(levelling=True)
    )
    out["levelling, free datum"] = free_levelling
    return out


def free_levelling() -> fga.Network:
    """Return five points with all lines between them, and no height that is given."""
    network = levelled()
    network.datum = "free"
    return network


@dataclass(frozen=True, eq=False)
class DenseModel:
    """The linear model of an adjustment: tests and errors as products with whitened errors."""

    solution: fga.Solution
    alpha: float

    @cached_property
    def partials(self) -> Array:
        """Whitened A (n, u)."""
        rows = np.arange(self.solution.equations.n_rows)
        free = self.solution.equations.unknowns.free
        return self.solution.normal().system.sparse(rows).toarray()[:, free]

    @cached_property
    def _decomposition(self) -> tuple[Array, Array, Array]:
        """U of the column space of A, its A⁺ and open motions N, from columns of unit length.

        A QR decomposition without pivoting would span too much where a datum is open.
        """
        size = np.linalg.norm(self.partials, axis=0)
        u, s, vt = np.linalg.svd(self.partials / size, full_matrices=True)
        rank = int(np.sum(s > LEAST_SINGULAR * s[0]))
        inverse = (vt[:rank].T / s[:rank]) @ u[:, :rank].T
        return u[:, :rank], inverse / size[:, None], vt[rank:].T / size[:, None]

    @cached_property
    def projector(self) -> Array:
        """I − A A⁺, (n, n)."""
        u = self._decomposition[0]
        return np.eye(len(u)) - u @ u.T

    @cached_property
    def inverse(self) -> Array:
        """Errors of unknowns from whitened errors, (u, n), least squares of datum points."""
        _, inverse, open_ = self._decomposition
        if not open_.shape[1]:
            return inverse
        solution = self.solution
        unknowns = solution.equations.unknowns
        place = np.cumsum(unknowns.free) - 1
        points = solution.network.points
        chosen = [n for n, point in points.items() if point.datum] or list(points)
        numbers = [
            first + axis
            for name in chosen
            for first in [int(unknowns["point"].offset[solution.number("point", name)])]
            for axis in range(3)
            if first >= 0 and unknowns.free[first + axis]
        ]
        on = place[np.array(numbers)]
        return inverse - open_ @ np.linalg.lstsq(open_[on], inverse[on], rcond=None)[0]

    @cached_property
    def whitener(self) -> Array:
        """W of the observations, (n, n)."""
        return whitening_matrix(self.solution.equations).toarray()

    @cached_property
    def tests(self) -> Array:
        """The w of all controlled rows from whitened errors, (tests, n)."""
        response = self.whitener.T @ self.projector
        rows = self.tested_rows
        return response[rows] / np.linalg.norm(response[rows], axis=1, keepdims=True)

    @cached_property
    def tested_rows(self) -> Index:
        """Rows that other observations control."""
        size = np.linalg.norm(self.whitener.T @ self.projector, axis=1)
        return np.flatnonzero(size > 1e-3 * np.linalg.norm(self.whitener, axis=0))

    @property
    def critical(self) -> float:
        """Critical value of |w|."""
        return float(norm.isf(self.alpha / 2.0))

    @cached_property
    def readings(self) -> list[Index]:
        """Rows of each reading."""
        number = self.solution.equations.reading_of_row
        return [np.flatnonzero(number == k) for k in range(int(number.max()) + 1)]

    def axes(self, point: str) -> Array:
        """Return errors of x, y, z from whitened errors, (3, n)."""
        unknowns = self.solution.equations.unknowns
        place = np.cumsum(unknowns.free) - 1
        first = int(unknowns["point"].offset[self.solution.number("point", point)])
        out = np.zeros((3, len(self.partials)))
        for a in range(3):
            if first >= 0 and unknowns.free[first + a]:
                out[a] = self.inverse[place[first + a]]
        return out

    def figure(self, point: str, figure: str) -> Array:
        """Return the axes of a figure of a point, (1 to 3, n): the length of the vector counts."""
        x = self.axes(point)
        at = self.solution.point(point)[None]
        enu = self.solution.network.frame.basis(at, np.zeros((1, 2))).enu[0]
        return {
            "x": x[:1],
            "y": x[1:2],
            "z": x[2:],
            "horizontal": enu[:2] @ x,
            "vertical": enu[2:] @ x,
            "space": x,
        }[figure]


@dataclass(frozen=True)
class Count:
    """Trials with an error beyond its level that no test shows."""

    network: str
    faults: int
    risk: float
    way: str
    exceeded: int
    trials: int
    tight: float

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of 99 % of the probability (Clopper and Pearson)."""
        k, n = self.exceeded, self.trials
        low = float(beta.ppf(0.005, k, n - k + 1)) if k else 0.0
        return low, float(beta.ppf(0.995, k + 1, n - k)) if k < n else 1.0

    @property
    def holds(self) -> bool:
        """Whether the risk is kept, as far as the trials show."""
        return self.interval[0] <= self.risk

    def __str__(self) -> str:
        """Return a line of the table."""
        low, high = self.interval
        return (
            f"{self.network:22} {self.faults} {self.risk:8.0e}  {self.way:12}"
            f"{self.exceeded / self.trials:11.2e}  [{low:.2e}, {high:.2e}]"
            f"{self.trials:10d}   {self.tight:5.2f}  {'' if self.holds else 'EXCEEDED'}"
        )


def trials(
    model: DenseModel, axes: Array, fault: Array, number: int, rng: np.random.Generator
) -> Array:
    """Return the sizes of errors of the trials in which no test rejects.

    Args:
        model: the linear model.
        axes: the axes of a figure, (k, n).
        fault: whitened gross errors, (n,).
        number: number of trials.
        rng: source of errors.
    """
    out = []
    for begin in range(0, number, AT_ONCE):
        errors = rng.standard_normal((min(AT_ONCE, number - begin), len(fault))) + fault
        quiet = np.all(np.abs(errors @ model.tests.T) <= model.critical, axis=1)
        out.append(np.linalg.norm(errors[quiet] @ axes.T, axis=1))
    return np.concatenate(out)


def tightness(errors: Array, level: float, number: int, risk: float) -> float:
    """Return the smallest bound that the trials would have kept with the risk, over the level."""
    most = int(risk * number)
    if len(errors) <= most:
        return 0.0
    return float(np.sort(errors)[len(errors) - 1 - most] / level)


def worst_errors(model: DenseModel, axes: Array, rows: Index) -> Array:
    """Return the gross errors of rows with the largest bias at noncentrality 1, whitened, (n,).

    It is the exact optimum over all tests, by linear programming; of a vector along its main axis.
    """
    unit = model.whitener[:, rows]
    effect, seen = axes @ unit, model.tests @ unit
    scale = np.abs(seen).max(axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    along = np.linalg.svd(effect / scale)[0][:, 0]
    found = linprog(
        -(along @ effect) / scale,
        A_ub=np.vstack([seen, -seen]) / scale,
        b_ub=np.ones(2 * len(seen)),
        bounds=(None, None),
    )
    return unit @ (found.x / scale) if found.status == 0 else np.full(len(unit), np.nan)


def adversary(
    model: DenseModel, axes: Array, level: float, faults: int, rng: np.random.Generator
) -> Array:
    """Return the fault with the largest probability that a search finds, whitened, (n,)."""
    covariance = axes @ axes.T
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    directions = []
    every = combinations(range(len(model.readings)), faults)
    chosen = [tuple(p) for p in every]
    if len(chosen) > 400:
        chosen = [chosen[i] for i in rng.choice(len(chosen), 400, replace=False)]
    for mode in chosen:
        rows = np.concatenate([model.readings[k] for k in mode])
        directions.append(worst_errors(model, axes, rows))
        for _ in range(3):
            fault = model.whitener[:, rows] @ (
                rng.standard_normal(len(rows)) * model.solution.equations.sigmas()[rows]
            )
            size = np.abs(model.tests @ fault).max()
            if size > 1e-6:
                directions.append(fault / size)
    directions = [d for d in directions if np.isfinite(d).all()]
    directions.sort(key=lambda d: -float(np.linalg.norm(axes @ d)))
    noise = rng.standard_normal((SEARCH_TRIALS, len(model.tests.T))) @ model.tests.T
    best, most = directions[0], -1.0
    for fault in directions[:CANDIDATES]:
        # Tails of errors by their law: few trials tell the probability that no test rejects.
        seen, bias = model.tests @ fault, float(np.linalg.norm(axes @ fault))
        for size in SIZES.tolist():
            quiet = np.mean(np.all(np.abs(noise + size * seen) <= model.critical, axis=1))
            far = norm.sf((level - size * bias) / sigma) + norm.sf((level + size * bias) / sigma)
            if quiet * far > most:
                best, most = size * fault, float(quiet * far)
    return best


def some_figures(levels: ProtectionLevels) -> list[tuple[str, str]]:
    """Return the figures with the largest finite level, relative to σ, and one of a length."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = levels.levels / levels.sigmas
    ratio = np.where(np.isfinite(ratio), ratio, -1.0)
    out = []
    for part in ((0, 1, 2), (3, 5)):
        i, f = np.unravel_index(int(np.argmax(ratio[:, part])), (len(ratio), len(part)))
        if ratio[i, part[int(f)]] > 0.0:
            out.append((levels.names[int(i)], FIGURES[part[int(f)]]))
    return out


def of_mode(
    name: str, model: DenseModel, levels: ProtectionLevels, number: int, rng: np.random.Generator
) -> Iterator[Count]:
    """Count with the worst and the adversary's faults."""
    risk, faults = levels.risk, levels.faults
    for point, figure in some_figures(levels):
        axes, level = model.figure(point, figure), levels.level(point, figure)
        mode = levels.weakest(point, figure)
        assert mode is not None
        number_of_row = model.solution.equations.reading_of_row
        rows = np.concatenate([model.readings[number_of_row[r]] for r in mode.rows])
        fault = worst_errors(model, axes, rows)
        if np.isfinite(fault).all():
            # The size that is worst by the law of one test.
            sigma = float(np.sqrt(np.linalg.eigvalsh(axes @ axes.T)[-1]))
            bias = np.linalg.norm(axes @ fault) * SIZES
            quiet = norm.cdf(model.critical - SIZES) - norm.cdf(-model.critical - SIZES)
            size = SIZES[np.argmax(quiet * norm.sf((level - bias) / sigma))]
            errors = trials(model, axes, size * fault, number, rng)
            tight = tightness(errors, level, number, risk)
            exceeded = int(np.sum(errors > level))
            yield Count(name, faults, risk, f"worst {figure[:3]}", exceeded, number, tight)
        fault = adversary(model, axes, level, faults, rng)
        errors = trials(model, axes, fault, number, rng)
        tight = tightness(errors, level, number, risk)
        exceeded = int(np.sum(errors > level))
        yield Count(name, faults, risk, f"advers. {figure[:3]}", exceeded, number, tight)


def at_random(
    name: str, model: DenseModel, levels: ProtectionLevels, number: int, rng: np.random.Generator
) -> Count | None:
    """Count with random faults, another one for each trial; None: every level is infinite."""
    axes, bounds = [], []
    for i, point in enumerate(levels.names):
        for a, figure in enumerate("xyz"):
            if levels.levels[i, a] > 0.0 and np.isfinite(levels.levels[i, a]):
                axes.append(model.figure(point, figure)[0])
                bounds.append(levels.levels[i, a])
    if not axes:
        return None
    joint = np.array(axes)
    exceeded, largest = np.zeros(len(axes), dtype=int), np.zeros(len(axes))
    n = len(model.projector)
    member = np.zeros((len(model.readings), n))
    for k, rows in enumerate(model.readings):
        member[k, rows] = 1.0
    sigma = model.solution.equations.sigmas()
    for begin in range(0, number, AT_ONCE):
        m = min(AT_ONCE, number - begin)
        chosen = rng.integers(len(model.readings), size=(m, levels.faults))
        wrong = sum(member[chosen[:, k]] for k in range(levels.faults))
        size = rng.uniform(0.0, 15.0, (m, 1)) * rng.standard_normal((m, n))
        errors = rng.standard_normal((m, n)) + (wrong * size * sigma) @ model.whitener.T
        quiet = np.all(np.abs(errors @ model.tests.T) <= model.critical, axis=1)
        found = np.abs(errors[quiet] @ joint.T)
        exceeded += np.sum(found > np.array(bounds), axis=0)
        largest = np.maximum(largest, found.max(axis=0, initial=0.0))
    worst = int(np.argmax(exceeded))
    tight = float(np.max(largest / np.array(bounds))) if not exceeded.any() else 1.0
    return Count(name, levels.faults, levels.risk, "random", int(exceeded[worst]), number, tight)


class Outcomes:
    """The adjusted networks without what data snooping rejects, and their levels."""

    def __init__(self, network: fga.Network, solution: fga.Solution, risk: float) -> None:
        """Begin with the whole network."""
        self.network, self.solution, self.risk = network, solution, risk
        equations = solution.equations
        self.ids = [equations.id(row) for row in range(equations.n_rows)]
        self.found: dict[tuple[str, ...], tuple[DenseModel, Array, ProtectionLevels] | None] = {}

    def without(self, gone: tuple[str, ...]) -> tuple[DenseModel, Array, ProtectionLevels] | None:
        """Return the linear model, errors of x, y, z of all points, and levels; None: none left."""
        if gone not in self.found:
            self.found[gone] = self._without(gone)
        return self.found[gone]

    def _without(self, gone: tuple[str, ...]) -> tuple[DenseModel, Array, ProtectionLevels] | None:
        try:
            rest = fga.without(self.network, gone)
            solution = fga.adjust(rest, start=self.solution, variance="a-priori")
            n, m = len(set(self.ids)), len(gone)
            share = self.risk / (2 ** (m + 1) * comb(n, m))
            levels = fga.protection_levels(solution, risk=share)
        except fga.AdjustmentError:
            return None
        equations = solution.equations
        kept = [i for i in self.ids if i not in gone]
        assert kept == [equations.id(row) for row in range(equations.n_rows)]
        model = DenseModel(solution, levels.alpha)
        axes = np.concatenate([model.axes(point) for point in levels.names])
        return model, axes, levels


def after_snooping(
    name: str, network: fga.Network, number: int, risk: float, rng: np.random.Generator
) -> Count:
    """Count with two random faults and data snooping that rejects at most two observations."""
    solution = fga.adjust(network, variance="a-priori")
    outcomes = Outcomes(network, solution, risk)
    ids = np.array(outcomes.ids, dtype=object)
    sigma, n = solution.equations.sigmas(), len(outcomes.ids)
    exceeded: Array = np.zeros(1)
    for begin in range(0, number, AT_ONCE):
        m = min(AT_ONCE, number - begin)
        errors = rng.standard_normal((m, n))
        for _ in range(2):
            errors[np.arange(m), rng.integers(n, size=m)] += rng.uniform(-15.0, 15.0, m)
        errors *= sigma
        groups: dict[tuple[str, ...], Index] = {(): np.arange(m)}
        for depth in range(MOST_REJECTED + 1):
            after: dict[tuple[str, ...], list[Index]] = {}
            for gone, those in groups.items():
                found = outcomes.without(gone)
                if found is None:
                    continue
                model, axes, levels = found
                white = errors[those][:, ~np.isin(ids, gone)] @ model.whitener.T
                w = np.abs(white @ model.tests.T)
                fires = w.max(axis=1) > model.critical
                beyond = np.abs(white[~fires] @ axes.T) > levels.coordinates.ravel() + 1e-12
                exceeded = exceeded + beyond.sum(axis=0)
                if depth == MOST_REJECTED or not fires.any():
                    continue
                kept = [i for i in outcomes.ids if i not in gone]
                worst = model.tested_rows[np.argmax(w[fires], axis=1)]
                for row in np.unique(worst).tolist():
                    key = tuple(sorted((*gone, kept[row])))
                    after.setdefault(key, []).append(those[fires][worst == row])
            groups = {key: np.concatenate(parts) for key, parts in after.items()}
    return Count(name, 2, risk, "snooping", int(exceeded.max()), number, np.nan)


def measured(
    name: str, network: fga.Network, number: int, *, risks: tuple[float, ...] = RISKS
) -> Iterator[Count]:
    """Count for all risks and numbers of faults of one network."""
    solution = fga.adjust(network, variance="a-priori")
    rng = np.random.default_rng(1)
    for faults in (1, 2):
        for risk in risks:
            levels = fga.protection_levels(solution, risk=risk, faults=faults)
            model = DenseModel(solution, levels.alpha)
            yield from of_mode(name, model, levels, number, rng)
            found = at_random(name, model, levels, number, rng)
            if found is not None:
                yield found
    solitary = all(len(rows) == 1 for rows in DenseModel(solution, 1e-3).readings)
    for risk in risks if solitary else ():
        yield after_snooping(name, network, number, risk, rng)


def main(arguments: list[str]) -> int:
    """Run the command."""
    number = int(arguments[0]) if arguments else TRIALS
    chosen = arguments[1:]
    bad = 0
    heads = ("network", "faults", "risk", "fault", "share", "interval of 99 %", "trials", "tight")
    print("  ".join(heads))
    for name, make in networks().items():
        if chosen and not any(c in name for c in chosen):
            continue
        began = time.perf_counter()
        for count in measured(name, make(), number):
            print(count, flush=True)
            bad += not count.holds
        print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
