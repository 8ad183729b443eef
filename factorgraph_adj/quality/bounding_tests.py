"""Bounding tests: the tests that bound the bias of a fault mode best, by the dual simplex method.

The largest bias that no test sees is a linear programme with the responses r_k of all tests to an
error n of the fault mode, and its dual

    max γᵀn,  |r_kᵀn| ≤ 1       =       min Σ|y_k|,  Σ y_k r_k = γ.

Any m tests with independent responses, the rows of R, give an upper bound Σ|y|, y = R⁻ᵀγ. A step
finds the test that sees most of the error n = R⁻¹ sign(y), which the m tests allow, and puts it in
the place of that test which first loses its part of γ. The bound falls until no test sees more.
"""

from __future__ import annotations

import numpy as np

from ..types import Array, Index

MAX_STEPS = 60
"""Largest number of exchanges; each stage is an upper bound."""
SEEN = 1.0 + 1e-9
"""Response above which a test sees an error that is at the limit of others."""
LEAST_PART = 1e-12
"""Share of a response that is rounding."""


def bounding_tests(responses: Array, own: Index, effect: Array) -> Array | None:
    """Return R⁻ᵀ of the tests that bound a bias best, (m, m); None: no better ones than ``own``.

    Args:
        responses: responses of all tests to the errors of the mode, (tests, m).
        own: numbers of the tests of the mode itself, (m,).
        effect: γ, (m,).
    """
    chosen = own.copy()
    changed = False
    for _ in range(MAX_STEPS):
        inverse = np.linalg.inv(responses[chosen])
        y = effect @ inverse
        sign = np.where(y < 0.0, -1.0, 1.0)
        seen = responses @ (inverse @ sign)
        most = int(np.argmax(np.abs(seen)))
        if not abs(seen[most]) > SEEN:
            break
        part = sign * np.sign(seen[most]) * (responses[most] @ inverse)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(part > LEAST_PART, np.abs(y) / part, np.inf)
        leaving = int(np.argmin(ratio))
        if not np.isfinite(ratio[leaving]):
            break
        chosen[leaving] = most
        changed = True
    if not changed:
        return None
    try:
        return np.asarray(np.linalg.inv(responses[chosen]).T)
    except np.linalg.LinAlgError:
        return None
