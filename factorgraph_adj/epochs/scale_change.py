"""A common scale of the reference points of two free epochs.

    d = s r + noise,  s = rᵀWd/(rᵀWr),  T = s² rᵀWr,

with r from the middle of the points, in space or in plan, whichever fits better (levelled heights
have the scale of the staffs), and d and W of `factorgraph_adj.epochs.hypotheses`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..frames import Frame
from .differences import Differences
from .hypotheses import Scale, Test, spanning, weight

OPEN = 1e-6
"""Part of r outside of the open motions below which no observation tells the scale."""


@dataclass(frozen=True)
class ScaleChange:
    """A common scale of the second epoch relative to the first."""

    value: float
    """The scale s: lengths of the second epoch are 1 + s times as long."""
    sigma: float
    """Its standard deviation."""
    test: Test
    """Test of the hypothesis s = 0."""
    rest: Test
    """Congruence test of the reference points once s is taken off."""
    in_plan: bool
    """Whether it is one of plan alone, which fits better than one of space."""

    @property
    def significant(self) -> bool:
        """Whether the epochs differ in scale, if nothing moved."""
        return not self.test.accepted

    def __str__(self) -> str:
        """Say how large it is."""
        return f"{1e6 * self.value:+.1f} ± {1e6 * self.sigma:.1f} ppm" + " in plan" * self.in_plan


def scale_change(
    found: Differences, reference: Sequence[str], frame: Frame, scale: Scale, alpha: float
) -> ScaleChange | None:
    """Return the common scale of the reference points; none: nothing tells it.

    Args:
        found: the differences of the epochs.
        reference: the reference points.
        frame: their frame, which knows what is up.
        scale: variance of unit weight.
        alpha: probability of a false alarm of the tests.
    """
    if not reference or not found.motions.size:
        return None
    rows = found.rows(reference)
    numbers = [found.names.index(n) for n in reference]
    axes = ["xyz".index(a) for a in found.axes]
    places = found.places[numbers]
    r = places - places.mean(axis=0)
    up = frame.basis(places, np.zeros((len(places), 2))).enu[:, 2]
    flat = r - np.sum(r * up, axis=1, keepdims=True) * up
    g = spanning(found.motions[rows])
    w, d = weight(found.cofactor[np.ix_(rows, rows)], g), found.d[rows]
    h = len(rows) - g.shape[1] - 1
    out = []
    for by, in_plan in ((r[:, axes].ravel(), False), (flat[:, axes].ravel(), True)):
        if np.linalg.norm(by - g @ (g.T @ by)) <= OPEN * np.linalg.norm(by):
            continue
        normal = float(by @ w @ by)
        s = float(by @ w @ d) / normal
        omega = s**2 * normal
        rest = max(float(d @ w @ d) - omega, 0.0)
        sigma = float(np.sqrt(scale.variance / normal))
        tests = scale.test(omega, 1, alpha), scale.test(rest, h, alpha)
        out.append(ScaleChange(s, sigma, *tests, in_plan))
    return min(out, key=lambda c: c.rest.value, default=None)
