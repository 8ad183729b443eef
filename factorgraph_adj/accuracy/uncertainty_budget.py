"""Uncertainty budgets by the GUM: of a function of inputs, and of a quantity of an adjustment.

For y = f(x₁ … x_N) with standard uncertainties u_i, degrees of freedom ν_i and correlations r_ij
(JCGM 100:2008, 5.1.2, 5.2.2, G.4.1, 6.2):

    c_i = ∂f/∂x_i,  u²(y) = Σ_i Σ_j c_i c_j u_i u_j r_ij
    ν_eff = u⁴(y) / Σ_i (c_i u_i)⁴ / ν_i      (Welch–Satterthwaite, without correlations)
    U = k u(y),  k = t_{(1+p)/2}(ν_eff)       ν_eff to one decimal, cut (G.4.1, note 1)

The budget of a quantity q with gradient g of an adjustment gives the share of each observation.
With Ã the whitened observation equations and Q the cofactors of the unknowns,

    a = Ã Q g,   Σ a² = gᵀ Q g = u²(q)

so that the sum of a² over the rows of a group is its share. The shares of weighted unknowns (zero
corrections, refraction, verticals, control) are those of their given values, type B.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..errors import InputError, Problem, known, taking
from ..quality.observation_groups import GroupChoice, observation_groups
from ..quality.point_precision import Place, place_position, place_variable
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..statistical_tests import normal_quantile, student_quantile
from ..types import Array

Evaluation = Literal["A", "B"]
"""How an uncertainty was evaluated: by statistics of observations (A), by other means (B)."""
STEP_OF_UNCERTAINTY = 0.01
"""Step of the numerical partial derivatives, in standard uncertainties."""


@dataclass(frozen=True)
class BudgetInput:
    """An input quantity of a budget.

    Raises:
        InputError: the uncertainty is negative or not finite, or the degrees of freedom are not
            positive.
    """

    name: str
    """Its name."""
    value: float
    """Its estimate."""
    uncertainty: float
    """Its standard uncertainty, in the unit of the value."""
    freedom: float = math.inf
    """Degrees of freedom of the uncertainty; infinite: it is known exactly."""
    evaluation: Evaluation = "B"
    """How the uncertainty was evaluated."""

    def __post_init__(self) -> None:
        """Refuse numbers that are no uncertainty."""
        problems = []
        if not (math.isfinite(self.uncertainty) and self.uncertainty >= 0):
            what = f"uncertainty must be a number ≥ 0, not {self.uncertainty!r}"
            problems.append(Problem(what, self.name))
        if not self.freedom > 0:
            problems.append(Problem(f"freedom must be > 0, not {self.freedom!r}", self.name))
        if problems:
            raise InputError(problems)

    @classmethod
    def rectangular(
        cls, name: str, value: float, half_width: float, freedom: float = math.inf
    ) -> BudgetInput:
        """Return an input that lies anywhere in value ± half_width: u = a/√3 (GUM 4.3.7)."""
        return cls(name, value, half_width / math.sqrt(3), freedom)

    @classmethod
    def triangular(
        cls, name: str, value: float, half_width: float, freedom: float = math.inf
    ) -> BudgetInput:
        """Return an input with a triangular distribution: u = a/√6 (GUM 4.3.9)."""
        return cls(name, value, half_width / math.sqrt(6), freedom)

    @classmethod
    def arcsine(
        cls, name: str, value: float, half_width: float, freedom: float = math.inf
    ) -> BudgetInput:
        """Return an input that swings by ± half_width: u = a/√2 (GUM H.1.3.4)."""
        return cls(name, value, half_width / math.sqrt(2), freedom)

    @classmethod
    def observed(cls, name: str, readings: Sequence[float]) -> BudgetInput:
        """Return the mean of readings, u = s/√n with n − 1 degrees of freedom (GUM 4.2.3).

        Raises:
            InputError: fewer than two readings.
        """
        x = np.asarray(readings, dtype=float)
        if x.ndim != 1 or len(x) < 2:
            raise InputError(Problem(f"needs two readings, not {x.size}", name))
        s = float(np.std(x, ddof=1)) / math.sqrt(len(x))
        return cls(name, float(x.mean()), s, len(x) - 1, "A")


@dataclass(frozen=True)
class Share:
    """Share of an input, or of a group of observations, in an uncertainty."""

    name: str
    """Name of the input or group."""
    evaluation: Evaluation
    """A or B."""
    contribution: float
    """|c_i| u_i, in the unit of the result; of a group, the square root of its sum of squares."""
    percent: float
    """Part of u² in per cent; without correlations the parts sum to 100."""
    value: float = math.nan
    """Estimate of the input; NaN of a group."""
    uncertainty: float = math.nan
    """Standard uncertainty of the input; NaN of a group."""
    sensitivity: float = math.nan
    """c_i; NaN of a group."""
    freedom: float = math.inf
    """Degrees of freedom."""

    @property
    def amounts(self) -> tuple[float, float]:
        """Contribution and per cent."""
        return self.contribution, self.percent


@dataclass(frozen=True, repr=False)
class UncertaintyBudget(Shown):
    """Budget of one quantity."""

    quantity: str
    """What it is."""
    value: float
    """Its estimate, SI; NaN of a position."""
    uncertainty: float
    """Combined standard uncertainty u(y), in the unit of the value."""
    freedom: float
    """Effective degrees of freedom ν_eff."""
    shares: tuple[Share, ...]
    """Shares of inputs or groups."""
    unit: str = ""
    """Unit of value and u; empty: that of the function."""

    def coverage_factor(self, probability: float = 0.95) -> float:
        """Return k of a probability, of Student's distribution with ν_eff cut."""
        p = (1.0 + probability) / 2.0
        if math.isinf(self.freedom):
            return normal_quantile(p)
        return student_quantile(p, max(math.floor(round(self.freedom, 1)), 1))

    def expanded(self, probability: float = 0.95) -> float:
        """Return the expanded uncertainty U = k u(y)."""
        return self.coverage_factor(probability) * self.uncertainty

    def headline(self) -> str:
        """Return value, u and ν_eff."""
        value = "" if math.isnan(self.value) else f" {self.value:.9g}"
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"UncertaintyBudget: {self.quantity}{value}{unit}, u {self.uncertainty:.4g}{unit}, "
            f"{self.freedom:.4g} degrees of freedom"
        )

    def first_rows(self) -> Rows:
        """Return the shares."""
        return Rows(
            ("quantity", "value", "u", "type", "c", "|c| u", "%"),
            [
                (s.name, s.value, s.uncertainty, s.evaluation, s.sensitivity, *s.amounts)
                for s in self.shares
            ],
            len(self.shares),
        )


def uncertainty_budget(
    function: Callable[..., float],
    inputs: Sequence[BudgetInput],
    *,
    correlations: Mapping[tuple[str, str], float] | None = None,
    quantity: str = "y",
) -> UncertaintyBudget:
    """Return the budget of a function of inputs, GUM 5 and G.4.

    Args:
        function: f of the values of the inputs in their order. Partial derivatives are central
            differences over ± 0.01 u_i.
        inputs: the inputs.
        correlations: correlation coefficients by pairs of names; ν_eff is then that of the inputs
            with finite degrees of freedom only if these are uncorrelated with all others,
            otherwise the least of theirs, as GUM H.2.4 has it for inputs that were read together.
        quantity: name of the result.

    Raises:
        InputError: no input, a name twice, an unknown name, a correlation beyond ±1, correlations
            that contradict one another, or a value of the function that is not finite.
    """
    names = [i.name for i in inputs]
    problems = [] if inputs else [Problem("there are no inputs")]
    problems += [Problem("is named twice", n) for n in dict.fromkeys(names) if names.count(n) > 1]
    r = np.eye(len(inputs))
    for pair, value in (correlations or {}).items():
        unknown = [n for n in pair if n not in names]
        problems += [Problem(f"no input {n!r}; valid: {known(names, meant=n)}") for n in unknown]
        if not abs(value) <= 1:
            problems.append(Problem(f"correlation {value!r} is beyond ±1", " ".join(pair)))
        elif not unknown:
            a, b = (names.index(n) for n in pair)
            r[a, b] = r[b, a] = value
    if not problems and np.linalg.eigvalsh(r).min() < -1e-6:
        problems.append(Problem("correlations contradict one another: they are not semidefinite"))
    if problems:
        raise InputError(problems)
    x = [i.value for i in inputs]
    y = _finite(function, x)
    c = np.array([_partial(function, x, k, own.uncertainty) for k, own in enumerate(inputs)])
    part = c * np.array([i.uncertainty for i in inputs])
    variance = float(part @ r @ part)
    freedom = _effective_freedom(inputs, part, r, variance)
    shares = tuple(
        Share(
            i.name,
            i.evaluation,
            abs(float(p)),
            100.0 * float(p * (r[k] @ part)) / variance if variance > 0 else 0.0,
            i.value,
            i.uncertainty,
            float(c[k]),
            i.freedom,
        )
        for k, (i, p) in enumerate(zip(inputs, part, strict=True))
    )
    return UncertaintyBudget(quantity, y, math.sqrt(variance), freedom, shares)


def _finite(function: Callable[..., float], x: Sequence[float]) -> float:
    y = float(function(*x))
    if not math.isfinite(y):
        raise InputError(f"the function is {y!r} at {tuple(x)}")
    return y


def _partial(function: Callable[..., float], x: Sequence[float], k: int, u: float) -> float:
    """Return ∂f/∂x_k by a central difference; the step is relative to x where u is 0."""
    step = STEP_OF_UNCERTAINTY * u or 1e-6 * max(abs(x[k]), 1.0)
    ahead, behind = list(x), list(x)
    ahead[k], behind[k] = x[k] + step, x[k] - step
    return (_finite(function, ahead) - _finite(function, behind)) / (ahead[k] - behind[k])


def _effective_freedom(
    inputs: Sequence[BudgetInput], part: Array, r: Array, variance: float
) -> float:
    """Return ν_eff of Welch and Satterthwaite, see `uncertainty_budget`."""
    finite = [k for k, i in enumerate(inputs) if math.isfinite(i.freedom) and part[k] != 0.0]
    if not finite:
        return math.inf
    joint = [k for k in finite if np.any(np.delete(r[k], k) != 0.0)]
    if joint:
        return min(inputs[k].freedom for k in joint)
    total = sum(part[k] ** 4 / inputs[k].freedom for k in finite)
    return variance**2 / float(total)


@taking(Solution)
def solution_budget(
    solution: Solution,
    quantity: str | tuple[Place, Place],
    component: Literal["x", "y", "z", "position", "distance"] | None = None,
    *,
    groups: GroupChoice = "kind",
) -> UncertaintyBudget:
    """Return the shares of groups of observations in the uncertainty of an adjusted quantity.

    The uncertainty u is in metres and a priori, that of the stated σ with σ0 = 1, whatever the
    variance of the adjustment; ``solution.sigma0`` times it is a posteriori. The percentages are
    the same.

    Args:
        solution: an adjustment.
        quantity: name of a point, or two places.
        component: of a point, its coordinate x, y or z, or its ``position``, u² = σx² + σy² + σz²;
            of two places, their ``distance``. None: position of a point, distance of two places.
        groups: a rule for groups, see `factorgraph_adj.estimate_variance_components`; given values
            of weighted unknowns and weighted coordinates are groups of type B.

    Raises:
        InputError: an unknown name, a component that does not fit, or an unknown rule.
    """
    if component is None:
        component = "position" if isinstance(quantity, str) else "distance"
    gradient, value, name = _gradient(solution, quantity, component)
    cofactors = solution.cofactor_times(gradient)
    a = solution.normal().system.times(cofactors)
    variance = float(np.sum(gradient * cofactors))
    found = observation_groups(solution, groups)
    n = solution.equations.n_rows
    squares = found.sums(np.sum(a[:n] ** 2, axis=1))
    given = _given_rows(solution)
    parts: list[tuple[str, Evaluation, float]] = [
        (name_, "B" if given[found.of_row == k].all() else "A", float(squares[k]))
        for k, name_ in enumerate(found.names)
    ]
    rest = variance - sum(square for _, _, square in parts)
    if rest > 1e-9 * variance:
        parts.append(("rows of no group", "B", rest))
    shares = [
        Share(n_, e, math.sqrt(max(s, 0.0)), 100.0 * s / variance if variance > 0 else 0.0)
        for n_, e, s in parts
    ]
    shares.sort(key=lambda share: -share.contribution)
    return UncertaintyBudget(name, value, math.sqrt(variance), math.inf, tuple(shares), "m")


def _given_rows(solution: Solution) -> Array:
    """Return whether each row is a given value of a weighted unknown, (n_rows,)."""
    out = np.zeros(solution.equations.n_rows, dtype=bool)
    for block in solution.equations.blocks:
        out[block.rows] = block.prior
    return out


def _gradient(
    solution: Solution, quantity: str | tuple[Place, Place], component: str
) -> tuple[Array, float, str]:
    """Return the gradient of a quantity, (n_columns, k) for k parts, its value and its name."""
    size = solution.equations.unknowns.n_columns
    if component in ("x", "y", "z", "position") and isinstance(quantity, str):
        axes = range(3) if component == "position" else ["xyz".index(component)]
        parts = np.zeros((len(axes), size))
        for part, axis in zip(parts, axes, strict=True):
            _add_gradient(solution, part, quantity, np.eye(3)[axis])
        at = place_position(solution, quantity)
        value = math.nan if component == "position" else float(at[axes[0]])
        return parts.T, value, f"{component} of point {quantity!r}"
    if component == "distance" and isinstance(quantity, tuple) and len(quantity) == 2:
        a, b = quantity
        out = np.zeros(size)
        d = place_position(solution, b) - place_position(solution, a)
        length = float(np.linalg.norm(d))
        if length == 0.0:
            raise InputError(f"{a!r} and {b!r} coincide: their distance has no gradient")
        _add_gradient(solution, out, b, d / length)
        _add_gradient(solution, out, a, -d / length)
        return out[:, None], length, f"distance of {a!r} and {b!r}"
    raise InputError(
        f"component {component!r} of {quantity!r}: a point has x, y, z, position; two places have "
        "distance"
    )


def _add_gradient(solution: Solution, out: Array, place: Place, g: Array) -> None:
    """Add the gradient by the coordinates of a place to the columns of all unknowns."""
    kind, name = place_variable(place)
    number = solution.number(kind, name)
    columns = solution.equations.unknowns.columns(kind, number)[-3:]
    if len(columns):  # otherwise the place is held
        free = solution.equations.unknowns[kind].free[number][-3:]
        out[columns[free]] += g[free]
