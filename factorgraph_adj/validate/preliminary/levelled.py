"""Frames that are stated to be level, and are not: places in them fit others only when tilted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ...errors import known
from ...quality.distributions import chi2_upper_quantile
from ...types import Array
from ...units import GON
from .finding import Finding
from .gross_places import ALPHA, GIVEN
from .similar import Similarity, System, common

BETTER = 5.0
"""How many times better places must fit with a tilt for it to be told."""
LEAST = 1e-3
"""Smallest tilt that is told, radians: the horizons of places within six kilometres differ by less,
and levels of instruments are off by less."""


def not_level(systems: Sequence[System], given: System) -> tuple[set[str], list[Finding]]:
    """Return the names of frames that are stated to be level and are not, and what to say of them.

    A frame is compared with the given coordinates in its horizon, and with other level frames. The
    given coordinates are right; of two frames that one is meant of which more others tell.

    Args:
        systems: places in frames; those that are upright in a horizon are stated to be level.
        given: the given coordinates.
    """
    level = [s for s in systems if s.upright and s.horizon is not None]
    found: dict[tuple[str, str], float] = {}
    few: dict[tuple[str, str], float] = {}
    for number, first in enumerate(level):
        assert first.horizon is not None
        in_horizon = System(
            given.name, given.keys, given.x @ first.horizon.T, given.sigma, True, given.fixed_scale
        )
        for second in (*level[number + 1 :], in_horizon):
            pair = common(first, second)
            if pair is None or pair.size < 3 or len(pair.a) < pair.size:
                continue
            fit = pair.fitted()
            size = tilt(fit)
            if size > LEAST and fit.rms * BETTER < _upright_rms(fit) and _significant(fit):
                # A tilt makes three places fit of which the height of one is wrong.
                enough = len(pair.a) > pair.size
                (found if enough else few)[first.name, second.name] = size
    doubtful = {n for pair in found for n in pair}
    found |= {p: t for p, t in few.items() if GIVEN in p and not doubtful.isdisjoint(p)}
    named: set[str] = set()
    findings = []
    while found:
        counts = Counter(n for pair in found for n in pair if n != GIVEN)
        sure = [n for pair in found if GIVEN in pair for n in pair if n != GIVEN]
        most = [n for n, c in counts.items() if c == max(counts.values())]
        names = sure[:1] or most[:1] if len(most) < 2 or sure else most[:2]
        own = {p: t for p, t in found.items() if set(p) & set(names)}
        other = [n for p in own for n in p if n not in names]
        one = f"{names[0]} is" if len(names) == 1 else f"one of {' and '.join(names)} is"
        against = f"those of {known(other)}" if len(names) == 1 else "each other"
        findings.append(
            Finding(
                f"{one} stated to be level, but its places fit {against} only with a tilt",
                "state that it is not level and let its rotation free, or look for an instrument "
                "whose compensator was off",
                float(np.median(list(own.values()))) / (GON / 1e3),
                LEAST / (GON / 1e3),
                "mgon",
            )
        )
        named |= set(names)
        found = {p: t for p, t in found.items() if p not in own}
    return named, findings


def tilt(fit: Similarity) -> float:
    """Return the angle between the third axes of two systems, radians."""
    return float(np.arctan2(np.hypot(*fit.rotation[:2, 2]), fit.rotation[2, 2]))


def _significant(fit: Similarity) -> bool:
    """Return whether a tilt is larger than chance makes it."""
    x, y = fit.rotation[:2, 2]
    about: Array = np.array([-y, x])  # t × e_z = (t_y, −t_x)
    covariance = fit.turn()[1][:2, :2]
    limit = float(chi2_upper_quantile(ALPHA, np.array([2]))[0])
    return bool(about @ np.linalg.solve(covariance, about) > limit)


def _upright_rms(fit: Similarity) -> float:
    """Return the root mean square of the residuals with a turn about the vertical alone."""
    a, b = (x - x.mean(axis=0) for x in (fit.pair.a, fit.pair.b))
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    cosine = float(np.sum(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]))
    c, s = np.array([cosine, sine]) / max(np.hypot(sine, cosine), 1e-300)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return float(np.sqrt(np.mean((b - fit.scale * (a @ turn.T)) ** 2)))
