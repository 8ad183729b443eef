"""Mean of several epochs of points that kept their places: the reference of later epochs.

Every epoch t gives the points x with cofactors Q_t and open motions G_t. With the weight W_t of
`factorgraph_adj.epochs.congruence_tests.weight_of_differences`, which no datum changes, the mean is

    x̂ = x₁ + N⁺ Σ W_t (x_t − x₁),  N = Σ W_t,  Q = N⁺

where an epoch of a free network is first moved onto the first one by what its observations leave
open. The open motions of the mean are those that every epoch leaves open. Epochs may lack points.
For the mean of all earlier epochs x_t − x̂_{t−1} are innovations: independent of each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..blas_threads import with_one_thread
from ..epochs.congruence_tests import motion_basis, weight_of_differences
from ..epochs.differences import aligned_points, epoch_places
from ..errors import InputError, Problem
from ..frames import Frame, frame_of_record, frame_record
from ..ledger.journal_entries import ALL_DIGITS, packed, unpacked
from ..types import Array, Index, Mask
from .epoch_estimates import EpochEstimate

MIN_DETERMINED = 1e-10
"""Eigenvalue of N, relative to the largest one after N was scaled to an even diagonal, below which
every epoch leaves a motion open."""
_NUMBERS = ("squares", "rows", "number", "times", "n_observations", "datum")
"""What a record of a mean has beside points, equations and frame."""


class MeanEstimate:
    """Mean of epochs, to which further ones are added."""

    def __init__(self, epochs: Iterable[EpochEstimate] = ()) -> None:
        self._frame: Frame | None = None
        self._datum = ""
        self._names: list[str] = []
        self._coordinates = np.zeros((0, 3))
        self._free = np.zeros((0, 3), dtype=bool)
        self._normal, self._right = np.zeros((0, 0)), np.zeros(0)
        self._squares = 0.0
        """Σ (vᵀPv + dᵀWd) of the epochs."""
        self._rows = 0
        """Σ (redundancy + rank W) of the epochs."""
        self._number, self._times = 0, 0.0
        """Number of the epochs, and the sum of their times."""
        self._n_observations = 0
        for epoch in epochs:
            self.add(epoch)

    def __len__(self) -> int:
        """Return the number of epochs."""
        return self._number

    @with_one_thread
    def add(self, epoch: EpochEstimate) -> None:
        """Add an epoch.

        Raises:
            InputError: its frame is another one; it holds coordinates that are unknown in others,
                or the other way round; it cannot be moved onto the first.
        """
        if self._frame is None:
            self._frame, self._datum = epoch.frame, epoch.datum
        elif epoch.frame != self._frame:
            raise InputError(
                Problem(
                    f"its frame is {epoch.frame}, that of the others {self._frame}",
                    f"epoch {epoch.number}",
                )
            )
        number = {n: i for i, n in enumerate(self._names)}
        common = [i for i, n in enumerate(epoch.names) if n in number]
        old = np.array([number[epoch.names[i]] for i in common], dtype=np.intp)
        here = np.array(common, dtype=np.intp)
        other = (epoch.free[here] != self._free[old]).any(axis=1)
        if other.any():
            raise InputError(
                Problem(
                    "is held in some epochs and unknown in others",
                    f"epoch {epoch.number}, point {epoch.names[here[i]]!r}",
                )
                for i in np.flatnonzero(other)
            )
        x, q, motions = epoch.coordinates, epoch.cofactors, epoch.motions
        if len(old) and epoch.motions.shape[1]:
            x, q, motions = self._moved(epoch, here, old)
        self._widen(epoch, x, number)
        number = {n: i for i, n in enumerate(self._names)}
        at = np.array([number[n] for n in epoch.names], dtype=np.intp)
        numbers = 3 * at[:, None] + np.arange(3)
        rows = self._free_number(numbers[epoch.free])
        g = motion_basis(_evened(motions))
        w = weight_of_differences(q, g)
        d = (x - self._coordinates[at])[epoch.free]
        self._normal[np.ix_(rows, rows)] += (w + w.T) / 2.0
        self._right[rows] += w @ d
        self._squares += epoch.vtpv + float(d @ w @ d)
        self._rows += epoch.redundancy + len(d) - g.shape[1]
        self._number += 1
        self._times += epoch.time
        self._n_observations += epoch.n_observations

    def _moved(self, epoch: EpochEstimate, here: Index, old: Index) -> tuple[Array, Array, Array]:
        """Return coordinates, Q and G of an epoch that is moved onto the first one."""
        loose = np.flatnonzero(epoch.free.any(axis=1))
        free: Mask = np.all(epoch.free[loose], axis=0)
        if not free.any():
            return epoch.coordinates, epoch.cofactors, epoch.motions
        places = epoch_places(epoch, tuple(epoch.names[i] for i in loose))
        origin = self._coordinates[old].mean(axis=0)
        onto = epoch.coordinates - origin
        onto[here] = self._coordinates[old] - origin
        x = epoch.coordinates.copy()
        moved, turn = aligned_points(
            epoch.coordinates[loose] - origin,
            onto[loose],
            places.mixture(free),
            np.isin(loose, here),
        )
        x[loose] = moved + origin
        turns = np.kron(np.eye(len(epoch.names)), turn)
        turns = turns[np.ix_(epoch.components, epoch.components)]
        return x, turns @ epoch.cofactors @ turns.T, turns @ epoch.motions

    def _widen(self, epoch: EpochEstimate, x: Array, number: dict[str, int]) -> None:
        """Make room for the points that only this epoch has."""
        new = [i for i, n in enumerate(epoch.names) if n not in number]
        if not new:
            return
        self._names += [epoch.names[i] for i in new]
        self._coordinates = np.vstack([self._coordinates, x[new]])
        self._free = np.vstack([self._free, epoch.free[new]])
        n, k = len(self._right), int(self._free.sum())
        normal, right = np.zeros((k, k)), np.zeros(k)
        normal[:n, :n], right[:n] = self._normal, self._right
        self._normal, self._right = normal, right

    def _free_number(self, coordinates: Index) -> Index:
        """Return the rows of coordinates 3·point + axis among those that are unknowns."""
        return np.asarray((np.cumsum(self._free.ravel()) - 1)[coordinates], dtype=np.intp)

    @with_one_thread
    def estimate(self, number: int = 0) -> EpochEstimate:
        """Return the mean as the estimate of one epoch, at the mean time.

        Its vᵀPv has what the epochs differ from their mean, and its redundancy counts that.

        Raises:
            InputError: no epoch was added.
        """
        if self._frame is None:
            raise InputError("the mean of no epochs: add one")
        scale = np.sqrt(np.diag(self._normal))
        even = self._normal / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(even)
        known = values > MIN_DETERMINED * values[-1]
        g = motion_basis(_evened(vectors[:, ~known] / scale[:, None]))
        # Inner constraints over all points: N + G Gᵀ is regular, and its inverse has the motions.
        size = float(scale @ scale) / len(scale)
        inverse = np.linalg.inv(self._normal + size * (g @ g.T))
        q = inverse - g @ g.T / size
        q = (q + q.T) / 2.0
        shift = q @ self._right
        x = self._coordinates.copy()
        x[self._free] += shift
        return EpochEstimate(
            number,
            self._times / self._number,
            tuple(self._names),
            x,
            np.flatnonzero(self._free),
            q,
            g,
            self._squares - float(self._right @ shift),
            self._rows - int(known.sum()),
            self._n_observations,
            (),
            "free" if g.shape[1] else self._datum,
            self._frame,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the mean as values of JSON, all digits, to which epochs can be added again."""
        return {
            "names": self._names,
            "coordinates": packed(self._coordinates, ALL_DIGITS),
            "free": self._free.tolist(),
            "normal": packed(self._normal[np.triu_indices(len(self._right))], ALL_DIGITS),
            "right": packed(self._right, ALL_DIGITS),
            **{name: getattr(self, f"_{name}") for name in _NUMBERS},
            **({} if self._frame is None else frame_record(self._frame)),
        }

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> MeanEstimate:
        """Return the mean of a record of `to_json`."""
        out, k = cls(), len(record["names"])
        out._names = [*record["names"]]
        out._coordinates = unpacked(record["coordinates"], k, 3, digits=ALL_DIGITS)
        out._free = np.array(record["free"], dtype=bool).reshape(k, 3)
        out._right = unpacked(record["right"], -1, digits=ALL_DIGITS)
        n = len(out._right)
        upper, out._normal = np.triu_indices(n), np.zeros((n, n))
        out._normal[upper] = unpacked(record["normal"], len(upper[0]), digits=ALL_DIGITS)
        out._normal[upper[::-1]] = out._normal[upper]
        for name in _NUMBERS:
            setattr(out, f"_{name}", record[name])
        out._frame = frame_of_record(record) if out._number else None
        return out


def _evened(g: Array) -> Array:
    """Return motions of unit length, so that none counts as rounding beside another."""
    size = np.linalg.norm(g, axis=0)
    return np.asarray(g / np.where(size > 0, size, 1.0))


def mean_estimate(epochs: Iterable[EpochEstimate], number: int = 0) -> EpochEstimate:
    """Return the mean of epochs of points that kept their places, see `MeanEstimate`."""
    return MeanEstimate(epochs).estimate(number)
