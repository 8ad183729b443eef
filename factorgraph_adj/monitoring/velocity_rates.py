"""How often the test of a velocity raises an alarm by chance: seeded simulation of its filter.

Estimates of a velocity in epochs after each other have most of their observations in common, and
the error of the reference in all of them. The number of alarms is therefore counted in simulated
months of one point that keeps its place: the filter of
`factorgraph_adj.monitoring.motion_filter` runs over errors with the variance of an epoch and of the
reference from the time of the reference on. The critical value is the one for which the counted
number is the stated one; every month that may raise an alarm at it is kept whole. The relative
standard deviation of the rate is stated with it, 4 % where the stated rate allows so many months.
The filter runs for coordinates with one variance: those of other shape differ where the process
noise, relative to them, makes the filter forget sooner or later, not for q = 0.

The same simulation with a velocity that begins some epochs after the reference gives the power and
the time to detection.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..errors import InputError
from ..statistical_tests import chi2_upper_probability, chi2_upper_quantile, root
from ..types import Array, Index
from .motion_filter import Motion, MotionModel
from .raise_rates import AlarmLife

RAISINGS = 600
"""Number of raisings that the simulation aims at."""
MAX_SIMULATED = 1.2e8
"""Largest number of simulated coordinates of epochs: a low rate of many epochs then has a larger
error, which is told."""
CHUNK = 2e6
"""Number of coordinates that are simulated at once."""
KEPT_PART = 6.0
"""Number of kept months relative to that of months with an alarm."""
MIN_RAISINGS = 100
"""Smallest number of raisings that a calibration needs."""


@dataclass(frozen=True)
class SimulatedLevel:
    """A level, and how exactly its rate is known."""

    level: float
    """Probability α of a single test."""
    relative_error: float
    """Relative standard deviation of the rate of false alarms at the level, by the simulation."""


@dataclass(frozen=True)
class VelocityRate:
    """Alarms of the velocity of one point."""

    freedom: int
    """Number of coordinates."""
    share: float
    """Share of the reference in the variance of a difference."""
    sigma: float
    """σ of a coordinate of an epoch, without the reference, metres."""
    interval: float
    """Time from one epoch to the next, seconds."""
    model: MotionModel
    """How points are thought to move."""

    def _filter(self, epochs: int) -> tuple[Array, Array]:
        """Return the gains (epochs, 3) of s, v and b, and the static σ of v (epochs,)."""
        reference = np.array([[self.sigma**2 * self.share / (1.0 - self.share)]])
        state = Motion.at(0.0, reference, self.model)
        r = np.array([[self.sigma**2]])
        gains, sigmas = np.empty((epochs, 3)), np.empty(epochs)
        for i in range(epochs):
            time = (i + 1) * self.interval
            there = state.predicted(time)
            column = there.covariance[:, 0] + there.covariance[:, 2]
            gains[i] = column / (column[0] + column[2] + r[0, 0])
            state = state.updated(time, np.zeros(1), r)
            sigmas[i] = np.sqrt(state.static_covariance[1, 1])
        return gains, sigmas

    def simulated(
        self,
        trials: int,
        epochs: int,
        rng: np.random.Generator,
        velocity: float = 0.0,
        begin: int = 0,
    ) -> Array:
        """Return T of simulated points, (trials, epochs).

        Args:
            trials: number of points.
            epochs: number of epochs after the reference.
            rng: source of the errors.
            velocity: metres per second, along the first coordinate.
            begin: number of the epoch after which the point moves.
        """
        gains, sigmas = self._filter(epochs)
        shape = (trials, self.freedom)
        of_reference = self.sigma * np.sqrt(self.share / (1.0 - self.share))
        b_true = of_reference * rng.standard_normal(shape, dtype=np.float32)
        s, v, b = (np.zeros(shape, dtype=np.float32) for _ in range(3))
        out = np.empty((trials, epochs), dtype=np.float32)
        dt = np.float32(self.interval)
        for i in range(epochs):
            y = b_true + np.float32(self.sigma) * rng.standard_normal(shape, dtype=np.float32)
            if velocity and i >= begin:
                y[:, 0] += np.float32(velocity * (i + 1 - begin) * self.interval)
            s += dt * v
            innovation = y - s - b
            for x, gain in zip((s, v, b), gains[i].astype(np.float32), strict=True):
                x += gain * innovation
            out[:, i] = np.sum((v / np.float32(sigmas[i])) ** 2, axis=1)
        return np.asarray(out, dtype=float)

    def detection(
        self,
        level: float,
        life: AlarmLife,
        velocity: float,
        begin: int,
        epochs: int,
        *,
        trials: int = 20_000,
        seed: int = 1,
    ) -> Array:
        """Return the probability that a velocity has raised an alarm by each epoch after begin.

        Args:
            level: probability α of a single test.
            life: when an alarm is raised and cleared.
            velocity: metres per second.
            begin: number of the epoch after which the point moves.
            epochs: number of epochs after it.
            trials: number of simulated points.
            seed: seed of the simulation.

        Returns:
            Probabilities (epochs,) of points that had no alarm when the motion began.
        """
        rng = np.random.default_rng(seed)
        t = self.simulated(trials, begin + epochs, rng, velocity, begin)
        begun = raisings(t, float(chi2_upper_quantile(level, self.freedom)), life)
        calm = ~begun[:, :begin].any(axis=1)
        return np.asarray(np.maximum.accumulate(begun[calm, begin:], axis=1).mean(axis=0))

    def level(self, number: float, life: AlarmLife, epochs: int, seed: int = 1) -> SimulatedLevel:
        """Return the level with a number of raisings of one point in some epochs.

        Raises:
            InputError: too few raisings can be simulated, or there is no such level.
        """
        return _level(self, number, life, epochs, seed)


@lru_cache(maxsize=128)
def _level(
    rate: VelocityRate, number: float, life: AlarmLife, epochs: int, seed: int
) -> SimulatedLevel:
    most = MAX_SIMULATED / (epochs * rate.freedom)
    trials = int(np.ceil(min(max(RAISINGS / number, 2000.0), most)))
    if trials * number < MIN_RAISINGS:
        raise InputError(
            f"{number:.3g} false alarms of a velocity in {epochs} epochs of a point: too few to "
            "simulate; state a higher rate, or longer epochs"
        )
    rng = np.random.default_rng(seed)
    chunk = max(int(CHUNK / (epochs * rate.freedom)), 500)
    kept: list[Array] = []
    done, least = 0, -np.inf
    while done < trials:
        t = rate.simulated(min(chunk, trials - done), epochs, rng)
        done += len(t)
        t = t[t.max(axis=1) > least]
        kept.append(t[_highest(t, life) > least])
        if sum(map(len, kept)) > 3 * KEPT_PART * number * done + 1000:
            every = np.concatenate(kept)
            high = _highest(every, life)
            # What a month needs to be among the highest of all that were simulated.
            keep = min(len(high), int(KEPT_PART * number * done) + 500)
            least = max(least, float(np.partition(high, len(high) - keep)[len(high) - keep]))
            kept = [every[high > least]]
    every = np.concatenate(kept)

    def counts(log: float) -> Array:
        critical = float(chi2_upper_quantile(float(np.exp(log)), rate.freedom))
        return np.asarray(raisings(every, critical, life).sum(axis=1), dtype=float)

    highest = max(least, 1e-6)
    top = np.log(min(chi2_upper_probability(highest, rate.freedom), 0.5))
    low = np.log(1e-15)
    if counts(top).sum() < number * done:
        raise InputError(
            f"{number:.3g} false alarms of a velocity in {epochs} epochs of a point are more than "
            "its test can raise: state a lower rate"
        )
    log = root(
        lambda x: float(counts(x).sum()) / (number * done) - 1.0 + 1e-12, low, top, tolerance=1e-3
    )
    each = counts(log)
    return SimulatedLevel(float(np.exp(log)), float(np.sqrt((each**2).sum()) / each.sum()))


def _highest(t: Array, life: AlarmLife) -> Array:
    """Return the highest critical value at which each series (n, epochs) raises an alarm, (n,)."""
    if life.n == 1:
        return np.asarray(t.max(axis=1))
    padded = np.concatenate([np.zeros((len(t), life.n - 1), dtype=t.dtype), t], axis=1)
    windows = sliding_window_view(padded, life.n, axis=1)
    return np.asarray(np.sort(windows, axis=2)[:, :, life.n - life.k].max(axis=1))


def raisings(t: Array, critical: float, life: AlarmLife) -> Index:
    """Return in which epochs series of T (n, epochs) raise an alarm, (n, epochs) flags."""
    begun = np.zeros(t.shape, dtype=bool)
    seen = np.zeros((len(t), life.n), dtype=bool)
    active = np.zeros(len(t), dtype=bool)
    calm = np.zeros(len(t), dtype=np.intp)
    for i in range(t.shape[1]):
        seen[:, i % life.n] = t[:, i] > critical
        begun[:, i] = ~active & seen[:, i % life.n] & (seen.sum(axis=1) >= life.k)
        calm = np.where(active & (t[:, i] <= life.release**2 * critical), calm + 1, 0)
        cleared = active & (calm >= life.clear_after)
        active = (active | begun[:, i]) & ~cleared
        calm[cleared] = 0
        seen[cleared] = False
    return begun
