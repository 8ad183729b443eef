"""Whether the covariances of a factorisation are right, told by a few random probes.

With white noise Z of the whitened observations, X = Q Aᵀ Z are estimates whose covariance is
Q N Q = Q, and A X = H Z with H = A Q Aᵀ. H is a projector, whatever the datum: N Q N = N and
H H = H are the same. Rounding in the factorisation gives H other eigenvalues 1 − ε instead of
ones, and ε is the relative error of the variance of the function of the estimates that belongs
to it; the variance of no function is off by more than the largest |ε|. Each column of H H Z − H Z
holds every ε times a standard normal number, so that its length shows the largest. Two columns
suffice where they show next to nothing; otherwise many are taken.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

from ..types import Array, Index
from .datum import FreeDatum
from .factor import Factor
from .linear import LinearSystem

FEW = 2
"""Number of probes of a first look. The chance that both show less than ε/1000 is 6e-7."""
CLEAN = 4e-7
"""Largest |H H z − H z| in a first look after which no other follows: variances are off by less
than 4e-4 of their value, standard deviations by half of that, with the probability of `FEW`."""
MANY = 8
"""Number of probes of a second look. The chance that all of them show less than ε/5 is 4e-7."""
TRUSTED = 1e-4
"""Largest |H H z − H z| in a second look with which covariances are given out: variances are off
by less than 5e-4 of their value with the probability of `MANY`."""
SAMPLES = 4
"""Number of estimates from white noise whose root mean squares stand for standard deviations."""
SEED = 1
"""Seed of the probes: the same network gives the same figures."""
HELD_STILL = 1e-6
"""Standard deviation of an unknown relative to the one it had if all others were held, which is
none: where a datum holds it, rounding alone is left."""
WEAKEST = 5
"""Number of unknowns that a refusal names."""


def sample(system: LinearSystem, factor: Factor, n: int) -> Array:
    """Return n estimates X = Q AᵀZ from white noise of the observations, (n_columns, n).

    Args:
        system: the linearised network.
        factor: its normal equations, factorised, with a minimal datum where it has a defect.
        n: number of estimates.
    """
    rows = system.equations.n_rows + sum(len(e.residual) for e in system.extra)
    noise = np.random.default_rng(SEED).standard_normal((rows, n))
    return factor.solve(system.transposed(noise))


def uncertainty(system: LinearSystem, factor: Factor) -> float:
    """Return the relative error of variances from a factorisation: the largest |H H z − H z|.

    Covariances may be given out where it is at most `TRUSTED`. It costs two solutions with `FEW`
    right sides where there is no error.

    Args:
        system: the linearised network.
        factor: its normal equations, factorised, with a minimal datum where it has a defect.
    """
    found = _error(system, factor, FEW)
    return found if found <= CLEAN else _error(system, factor, MANY)


def _error(system: LinearSystem, factor: Factor, n: int) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        once = system.times(sample(system, factor, n))
        twice = system.times(factor.solve(system.transposed(once)))
        error = np.linalg.norm(twice - once, axis=0).max(initial=0.0)
    return float(error) if np.isfinite(error) else np.inf


def held_well(datum: FreeDatum, steps: Array, diagonal: Array) -> tuple[Index, float]:
    """Choose the minimal datum that enlarges no standard deviation much.

    Rounding in Q grows with the squares of what the minimal datum adds to two things: to the
    estimates on inner constraints over all unknowns in the metric of the diagonal of N, which
    rounding of N acts on, and to those on the constraints of the datum, which the
    S-transformation takes as a small difference. Let σ be the smaller one of the two standard
    deviations of each unknown. Holding the components h adds −G G_h⁻¹ x_h. Where the rows
    g_i / σ_i of h span the largest volume, no element of σ_i⁻¹ g_i G_h⁻¹ σ_h is above one.
    Pivoting comes close to that.

    Args:
        datum: what the observations leave undetermined, and the inner constraints.
        steps: estimates from white noise on any minimal datum, (n_columns, k); their root mean
            squares stand for standard deviations.
        diagonal: that of N, (n_columns,).

    Returns:
        The columns to hold (d,), and the largest factor by which the minimal datum of ``steps``
        enlarges a σ.
    """
    candidates = np.flatnonzero(np.any(datum.basis != 0.0, axis=1) & (diagonal > 0.0))
    g, x, root = datum.basis[candidates], steps[candidates], np.sqrt(diagonal[candidates, None])
    over_all, _ = np.linalg.qr(root * g)
    inner = _size(x - over_all @ (over_all.T @ (root * x)) / root)
    on_datum = _size(x - g @ (datum.masked.T @ steps))
    sigma = np.maximum(np.minimum(inner, on_datum), HELD_STILL / root[:, 0])
    spanned, _ = np.linalg.qr(g / sigma[:, None])
    _, _, order = qr(spanned.T, mode="economic", pivoting=True)
    enlarged = float((_size(x) / sigma).max(initial=1.0))
    return np.asarray(candidates[order[: g.shape[1]]], dtype=np.intp), enlarged


def _size(x: Array) -> Array:
    """Return the root mean square of each row."""
    return np.asarray(np.sqrt(np.mean(x**2, axis=1)))


def refusal(system: LinearSystem, factor: Factor, diagonal: Array) -> str:
    """Say why no covariance is given, and name the unknowns that are determined worst.

    Args:
        system: the linearised network.
        factor: its most precise factorisation, which is not precise enough.
        diagonal: that of N, (n_columns,).
    """
    unknowns = system.unknowns
    weakness = _size(sample(system, factor, SAMPLES)) * np.sqrt(diagonal)
    worst = sorted(
        ((float(weakness[unknowns.columns(k, i)].max()), k, i) for k, i in unknowns.active()),
        key=lambda item: -item[0],
    )
    names = ", ".join(f"{k} {unknowns[k].names[i]!r}" for _, k, i in worst[:WEAKEST])
    return (
        "no covariances: the normal equations are so close to singular that rounding would change"
        f" variances by {factor.uncertainty:.1g} of their value ({TRUSTED:.0e} is allowed); weakest"
        f" are {names}: observe them better (longer bases, more rays, distances), or hold them"
    )
