"""Check of the Jacobians of users' factors by central differences at the start values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import gtsam
import numpy as np

from ..errors import InputError, Problem
from ..types import Array
from ..units import significant
from .equations import Equations
from .keys import KeyMap, insert, is_pose
from .user_factors import dimension, each_once, variables_of
from .variables import State

STEPS = (1e-4, 1e-5)
"""Steps of the differences, metres, radians, image units: what two of them give tells how far they
can be trusted. The resolution of a geocentric coordinate, 1e-9 m, is a ten-thousandth of the
smaller one."""
WRONG = 0.01
"""Relative error from which a partial is wrong; what is left out on purpose is smaller."""
SMALL = 1e-3
"""Size of an error, relative to the largest partial by the same variable, that is passed over."""
TIMES = 10.0
"""Factor on the difference of the two steps."""
MOST = 100
"""Largest number of factors that are compared: those of one function are wrong alike."""


def refuse_wrong_partials(
    factors: Mapping[str, gtsam.NonlinearFactor],
    equations: Equations,
    state: State,
    keys: KeyMap | None = None,
) -> None:
    """Refuse factors whose Jacobians contradict their errors.

    With a wrong Jacobian an iteration ends beside the minimum, or nowhere. Factors without a
    Jacobian, with a robust noise model, or with hard constraints are not compared.

    Args:
        factors: the factors by name.
        equations: the equations of the network.
        state: where they are linearised.
        keys: the keys of the factors; none: those of ``equations``.

    Raises:
        InputError: the worst partial of each such factor; or keys as in `linearise_extra`.
    """
    unknowns = equations.unknowns
    keys = keys or KeyMap(unknowns)
    problems = []
    for name, factor in islice(factors.items(), MOST):
        values = gtsam.Values()
        variables = variables_of(factor, keys, unknowns, name)
        for key, variable in variables.items():
            insert(values, unknowns, state, [variable], [key])
        if _is_robust(factor):
            continue
        worst, what = 1.0, ""
        for one in _compared(factor, values):
            kind, number = variables[one.key]
            used = np.ones(one.stated.shape[1], dtype=bool)
            if not is_pose(kind):
                used = unknowns.free[unknowns.columns(kind, number)]
            times = np.where(used, one.times, 0.0)
            if not times.max(initial=0.0) > worst:
                continue
            worst = float(times.max())
            i, j = (int(n) for n in np.unravel_index(times.argmax(), times.shape))
            what = one.told(i, j, f"{kind} {keys.name(one.key)!r}")
        if what:
            problems.append(Problem(what, name))
    if problems:
        raise InputError(problems)


def _is_robust(factor: gtsam.NonlinearFactor) -> bool:
    """Return whether residuals of a factor are weighted by their size."""
    noise = factor.noiseModel() if hasattr(factor, "noiseModel") else None
    return isinstance(noise, gtsam.noiseModel.Robust)


def _whitened(
    factor: gtsam.NonlinearFactor, values: gtsam.Values
) -> tuple[list[int], Array, Array] | None:
    """Return keys, whitened partials and whitened residuals; None if it has no Jacobian."""
    try:
        linear = factor.linearize(values)
    except RuntimeError:  # is told where the factor is linearised for the adjustment
        return None
    if not isinstance(linear, gtsam.JacobianFactor) or linear.isConstrained():
        return None
    a, b = (np.array(x, dtype=float) for x in linear.jacobian())
    return *each_once(list(linear.keys()), a.reshape(len(b), -1), values), -b


@dataclass(frozen=True, eq=False)
class _Partials:
    """Whitened partials of a factor by one variable, (m, size)."""

    key: int
    """The variable."""
    stated: Array
    """What the factor states."""
    found: Array
    """Central differences."""
    times: Array
    """Their difference, in what is allowed."""

    def told(self, i: int, j: int, variable: str) -> str:
        """Return what is wrong with an element."""
        a, d = float(self.stated[i, j]), float(self.found[i, j])
        wrong = "the sign of its Jacobian" if abs(a + d) <= WRONG * abs(d) else "its Jacobian"
        return (
            f"its partial in row {i + 1} by component {j + 1} of {variable} is "
            f"{significant(a, 4)}, but differences of its error at the start values give "
            f"{significant(d, 4)} (both in σ of its noise model): {wrong} is wrong; H must be the "
            "derivative of the error that the factor returns"
        )


def _compared(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> Iterator[_Partials]:
    """Iterate over the variables of a factor whose partials can be judged."""
    stated = _whitened(factor, values)
    if stated is None:
        return
    order, partials, _ = stated
    sizes = [dimension(values, key) for key in order]
    if partials.shape[1] != sum(sizes):
        return
    for key, begin, size in zip(order, np.cumsum([0, *sizes]), sizes, strict=False):
        a = partials[:, begin : begin + size]
        coarse, fine = (_differences(factor, values, key, size, step) for step in STEPS)
        if coarse is None or fine is None or not np.isfinite(coarse + fine).all():
            continue
        element = np.maximum(np.abs(a), np.abs(fine))
        allowed = WRONG * element + SMALL * element.max(axis=1, keepdims=True)
        allowed += TIMES * np.abs(coarse - fine) + np.finfo(float).tiny
        yield _Partials(key, a, fine, np.abs(a - fine) / allowed)


def _differences(
    factor: gtsam.NonlinearFactor, values: gtsam.Values, key: int, size: int, step: float
) -> Array | None:
    """Return central differences of the whitened residuals by one variable, (m, size)."""
    columns = []
    for j in range(size):
        ends = []
        for h in (step, -step):
            move = gtsam.VectorValues()
            move.insert(key, h * np.eye(size)[j])
            there = _whitened(factor, values.retract(move))
            if there is None:
                return None
            ends.append(there[2])
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.column_stack(columns)
