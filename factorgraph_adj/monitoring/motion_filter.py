"""Motion of a point: a Kalman filter of position and velocity over its displacements.

Displacements y_t of k coordinates against one reference follow

    y_t = s_t + b + e_t,  e_t ~ N(0, R_t),  b ~ N(0, B),  s = 0 at the time of the reference,

where b is the error of the reference, which every epoch has in common: it is an unknown of the
filter, so that the errors of the y_t depend on each other as they do. Three models:

- velocity: ds = v dt, v changes by white noise of density q² (metres² per second³)
- random walk: s changes by white noise of density q² (metres² per second)
- static: s = 0

With q = 0 the filter is the least-squares line through all epochs and the reference.

`Motion.static_covariance` is what the estimates scatter while the point keeps its place: the test
of the velocity takes it, T = vᵀ Σ_v⁻¹ v with χ², since the covariance of the filter also has the
motion that q expects. The test of an innovation takes that of the filter.

The innovations v are independent while the point moves as the model says: T = Σ vᵀ S⁻¹ v has χ²
with as many degrees of freedom as coordinates in all epochs. Where it exceeds its critical value
(`Motion.fits`), displacement and velocity of the filter, and their σ, are not those of the point:
after a jump, for example, the velocity of a line through all epochs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ..errors import InputError, known
from ..statistical_tests import chi2_upper_probability, chi2_upper_quantile
from ..types import Array

MotionKind: TypeAlias = Literal["velocity", "random walk", "static"]
"""How a point is thought to move."""
DAY_S = 86400.0
"""Length of a day, seconds."""
_ARRAYS = ("mean", "covariance", "static_covariance", "response", "innovation")
ALPHA_OF_MODEL = 0.001
"""Probability that a point which moves as its model says is told not to."""
_NUMBERS = ("time", "begun", "innovation_test", "model_test", "n_innovations")


@dataclass(frozen=True)
class MotionModel:
    """How points are thought to move."""

    kind: MotionKind = "velocity"
    """The model."""
    noise: float = 0.0
    """q of the process noise: mm/day per √day for ``velocity``, mm per √day for ``random walk``."""
    start_velocity: float = 10.0
    """σ of the velocity before any epoch, mm/day."""

    def __post_init__(self) -> None:
        """Check the model."""
        if self.kind not in get_args(MotionKind):
            raise InputError(f"unknown motion {self.kind!r}; valid: {known(get_args(MotionKind))}")
        if not (0 <= self.noise < np.inf and 0 < self.start_velocity < np.inf):
            raise InputError(
                "the process noise of a motion must be at least 0, and the σ of the velocity "
                f"positive; not {self.noise}, {self.start_velocity}"
            )

    def noise_of(self, dt: float) -> tuple[Array, Array]:
        """Return the transition of (s, v, b) and the covariance of the process noise, (3, 3)."""
        f, q = np.eye(3), np.zeros((3, 3))
        if self.kind == "velocity":
            f[0, 1] = dt
            density = (1e-3 * self.noise / DAY_S) ** 2 / DAY_S
            q[:2, :2] = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        elif self.kind == "random walk":
            q[0, 0] = (1e-3 * self.noise) ** 2 / DAY_S * dt
        return f, q


@dataclass(frozen=True, eq=False)
class Motion:
    """State of a point: displacement s, velocity v and error b of the reference, k coordinates."""

    model: MotionModel
    """How it is thought to move."""
    time: float
    """Time of the state, seconds."""
    mean: Array
    """s, v, b, (3 k,) metres, metres per second, metres."""
    covariance: Array
    """Their covariance, (3 k, 3 k)."""
    static_covariance: Array
    """Covariance of their errors while the point keeps its place, (3 k, 3 k)."""
    begun: float
    """Time of the reference, seconds."""
    response: Array
    """What the mean is for a unit velocity since the reference and no errors, (3 k, k): the rows of
    v are below 1 while the σ of the velocity before any epoch still holds the estimate at 0."""
    innovation: Array
    """Last innovation, (k,) metres; empty before the first epoch."""
    innovation_test: float
    """Probability of a larger last innovation."""
    model_test: float = 0.0
    """T = Σ vᵀ S⁻¹ v of all innovations."""
    n_innovations: int = 0
    """Number of their coordinates, the degrees of freedom of T."""

    @classmethod
    def at(cls, time: float, reference: Array, model: MotionModel) -> Motion:
        """Return the state at the time of the reference, whose displacements have B (k, k)."""
        k = len(reference)
        p = np.zeros((3 * k, 3 * k))
        m = np.zeros((3 * k, 3 * k))
        p[2 * k :, 2 * k :] = m[2 * k :, 2 * k :] = reference
        if model.kind == "velocity":
            p[k : 2 * k, k : 2 * k] = (1e-3 * model.start_velocity / DAY_S) ** 2 * np.eye(k)
        return cls(model, time, np.zeros(3 * k), p, m, time, np.zeros((3 * k, k)), np.zeros(0), 1.0)

    def to_json(self) -> dict[str, Any]:
        """Return the state as values of JSON, all digits, without its model."""
        arrays = {name: getattr(self, name).tolist() for name in _ARRAYS}
        return arrays | {name: getattr(self, name) for name in _NUMBERS}

    @classmethod
    def from_json(cls, record: Mapping[str, Any], model: MotionModel) -> Motion:
        """Return the state of a record of `to_json`."""
        fields: dict[str, Any] = {name: np.array(record[name], dtype=float) for name in _ARRAYS}
        return cls(model=model, **fields, **{name: record[name] for name in _NUMBERS})

    @property
    def model_critical(self) -> float:
        """Critical value of `model_test`, χ² at `ALPHA_OF_MODEL`; infinite before any epoch."""
        n = self.n_innovations
        return float(chi2_upper_quantile(ALPHA_OF_MODEL, n)) if n else np.inf

    @property
    def fits(self) -> bool:
        """Whether the point moves as the model says, as far as `model_test` tells."""
        return self.model_test <= self.model_critical

    @property
    def _k(self) -> int:
        return len(self.mean) // 3

    @property
    def displacement(self) -> Array:
        """Displacement s since the reference, (k,) metres."""
        return self.mean[: self._k]

    @property
    def displacement_covariance(self) -> Array:
        """Its covariance, (k, k) metres²."""
        return self.covariance[: self._k, : self._k]

    @property
    def velocity(self) -> Array:
        """Velocity, (k,) metres per second."""
        return self.mean[self._k : 2 * self._k]

    @property
    def velocity_covariance(self) -> Array:
        """Its covariance, (k, k)."""
        return self.covariance[self._k : 2 * self._k, self._k : 2 * self._k]

    @property
    def static_velocity_covariance(self) -> Array:
        """Covariance of the estimated velocity while the point keeps its place, (k, k)."""
        return self.static_covariance[self._k : 2 * self._k, self._k : 2 * self._k]

    @property
    def steady_velocity_covariance(self) -> Array:
        """Covariance of a velocity since the reference as the test sees it, (k, k).

        With R, the rows of v of `response`, a velocity v makes T noncentral by
        vᵀ (R⁻¹ Σ_v R⁻ᵀ)⁻¹ v.
        """
        back = np.linalg.inv(self.response[self._k : 2 * self._k])
        return np.asarray(back @ self.static_velocity_covariance @ back.T)

    def velocity_test(self) -> float:
        """Return T = vᵀ Σ_v⁻¹ v, which has χ² with k degrees of freedom while nothing moves."""
        if self.model.kind != "velocity" or not len(self.innovation):
            return 0.0
        v = self.velocity
        return float(v @ np.linalg.solve(self.static_velocity_covariance, v))

    def predicted(self, time: float) -> Motion:
        """Return the state at a later time, without an observation.

        Raises:
            InputError: the time is an earlier one.
        """
        dt = time - self.time
        if dt < 0:
            raise InputError(f"epochs of a motion go on in time: {time} is before {self.time}")
        k = self._k
        small, noise = self.model.noise_of(dt)
        f, q = np.kron(small, np.eye(k)), np.kron(noise, np.eye(k))
        return Motion(
            self.model,
            time,
            f @ self.mean,
            f @ self.covariance @ f.T + q,
            f @ self.static_covariance @ f.T,
            self.begun,
            f @ self.response,
            self.innovation,
            self.innovation_test,
            self.model_test,
            self.n_innovations,
        )

    def updated(self, time: float, displacement: Array, covariance: Array) -> Motion:
        """Return the state after one more displacement.

        Args:
            time: its time, seconds; not before that of the state.
            displacement: y, (k,) metres, against the reference.
            covariance: R, (k, k) metres²: that of the epoch alone, without the reference.

        Raises:
            InputError: the time is an earlier one.
        """
        there, k = self.predicted(time), self._k
        h = np.hstack([np.eye(k), np.zeros((k, k)), np.eye(k)])
        if self.model.kind == "static":
            h[:, :k] = 0.0
        v = displacement - h @ there.mean
        s = h @ there.covariance @ h.T + covariance
        gain = np.linalg.solve(s, h @ there.covariance).T
        squares = float(v @ np.linalg.solve(s, v))
        left = np.eye(3 * k) - gain @ h
        of_epoch = gain @ covariance @ gain.T
        p, m = (left @ x @ left.T + of_epoch for x in (there.covariance, there.static_covariance))
        return Motion(
            self.model,
            time,
            there.mean + gain @ v,
            (p + p.T) / 2.0,
            (m + m.T) / 2.0,
            self.begun,
            there.response + gain @ ((time - self.begun) * np.eye(k) - h @ there.response),
            v,
            chi2_upper_probability(squares, k),
            self.model_test + squares,
            self.n_innovations + k,
        )


def smoothed(states: list[Motion]) -> list[tuple[Array, Array]]:
    """Return estimates and covariances of all states with all epochs (Rauch–Tung–Striebel).

    Args:
        states: states after each epoch, one after the other in time.
    """
    out = [(s.mean, s.covariance) for s in states]
    for i in range(len(states) - 2, -1, -1):
        state, k = states[i], states[i]._k
        there = state.predicted(states[i + 1].time)
        f = np.kron(state.model.noise_of(states[i + 1].time - state.time)[0], np.eye(k))
        gain = np.linalg.lstsq(there.covariance, f @ state.covariance, rcond=None)[0].T
        mean, p = out[i + 1]
        out[i] = (
            state.mean + gain @ (mean - there.mean),
            state.covariance + gain @ (p - there.covariance) @ gain.T,
        )
    return out
