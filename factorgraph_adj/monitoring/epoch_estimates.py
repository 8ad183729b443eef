"""Estimate of one epoch: coordinates with joint cofactors and open motions, without observations.

An `EpochEstimate` is what all monitoring works on. It is small, and it is what `compare_epochs` of
`factorgraph_adj.epochs.congruence` reads: two estimates are compared with the result of the
comparison of their adjustments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..blas_threads import with_one_thread
from ..epochs.epoch_coordinates import SolutionCoordinates
from ..errors import InputError, Problem, known
from ..frames import Frame, frame_of_record, frame_record
from ..ledger.journal_entries import ALL_DIGITS, packed, unpacked
from ..solve.solution import Solution
from ..types import Array, Index, Mask

_FIELDS = (
    *("number", "time", "names", "coordinates", "components", "cofactors", "motions", "vtpv"),
    *("redundancy", "n_observations", "undetermined", "datum", "frame", "frame_parameters"),
)


@dataclass(frozen=True, eq=False)
class EpochEstimate:
    """Coordinates of n points at one epoch, with the cofactors of the k that are unknowns."""

    number: int
    """Number of the epoch."""
    time: float
    """When it was measured, seconds since 1970 UTC, such as the middle of its observations."""
    names: tuple[str, ...]
    """Names of the points."""
    coordinates: Array
    """Coordinates, (n, 3) metres."""
    components: Index
    """Numbers 3·point + axis of the coordinates that are unknowns, ascending, (k,)."""
    cofactors: Array
    """Their cofactors Q, (k, k) metres²: the covariance for σ0 = 1."""
    motions: Array
    """Motions of them that the observations leave open, the d datum defects, (k, d). Their columns
    span these motions; the lengths of the columns mean nothing."""
    vtpv: float
    """Weighted sum of squared residuals vᵀPv, without unit."""
    redundancy: int
    """Redundancy of the adjustment."""
    n_observations: int
    """Number of scalar observations."""
    undetermined: tuple[str, ...]
    """Names of points that were left out because nothing determines them."""
    datum: str
    """Where the datum comes from, as of the network: ``given`` or ``free``."""
    frame: Frame
    """Frame of the coordinates."""

    @classmethod
    @with_one_thread
    def of(
        cls,
        solution: Solution,
        number: int,
        time: float,
        *,
        points: Sequence[str] | None = None,
    ) -> EpochEstimate:
        """Return the estimate of an adjustment.

        Args:
            solution: the adjustment.
            number: number of the epoch.
            time: when it was measured, seconds since 1970 UTC.
            points: names of the points that are kept; None: all of them. Points that the solution
                lacks are left out.

        Raises:
            InputError: the adjustment did not converge, or none of the points is in it, or none is
                free.
        """
        if not solution.converged:
            raise InputError(
                Problem(f"its adjustment is not converged: {solution.reason}", f"epoch {number}")
            )
        places = SolutionCoordinates(solution)
        kept = None if points is None else set(points)
        at = np.array(
            [i for i, n in enumerate(places.names) if kept is None or n in kept], dtype=np.intp
        )
        if not len(at):
            raise InputError(
                Problem(f"has none of the points; it has {known(places.names)}", f"epoch {number}")
            )
        free = places.free[at]
        if not free.any():
            what = "determines no point: all coordinates that it has are given"
            raise InputError(Problem(what, f"epoch {number}"))
        rows = (3 * at[:, None] + np.arange(3))[free]
        return cls(
            number,
            float(time),
            tuple(places.names[i] for i in at),
            places.coordinates[at],
            np.flatnonzero(free),
            places.cofactors_of(rows),
            places.motions_of(rows),
            solution.vtpv,
            solution.redundancy,
            solution.n_observations,
            tuple(n for n in places.undetermined if kept is None or n in kept),
            solution.network.datum,
            places.frame,
        )

    @cached_property
    def free(self) -> Mask:
        """Which coordinates are unknowns, (n, 3)."""
        flags = np.zeros(3 * len(self.names), dtype=bool)
        flags[self.components] = True
        return flags.reshape(-1, 3)

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the points all of whose coordinates are held."""
        return tuple(n for n, f in zip(self.names, self.free, strict=True) if not f.any())

    @property
    def sigma0(self) -> float:
        """σ̂0; NaN without redundancy."""
        return float(np.sqrt(self.vtpv / self.redundancy)) if self.redundancy > 0 else float("nan")

    def cofactors_of(self, components: Index) -> Array:
        """Return Q of free coordinates 3·point + axis (m,): (m, m) metres² for σ0 = 1.

        Raises:
            InputError: one of them is held, or is none.
        """
        at = self._rows(components)
        return np.asarray(self.cofactors[np.ix_(at, at)])

    def motions_of(self, components: Index) -> Array:
        """Return how the datum defects move free coordinates 3·point + axis (m,): (m, d).

        Raises:
            InputError: one of them is held, or is none.
        """
        return np.asarray(self.motions[self._rows(components)])

    def _rows(self, components: Index) -> Index:
        unknown = np.isin(components, self.components)
        if not unknown.all():
            wrong = known(np.asarray(components)[~unknown].tolist())
            what = f"coordinates (3·point + axis) {wrong} are no unknowns, and have no cofactors"
            raise InputError(Problem(what, f"epoch {self.number}"))
        return np.asarray(np.searchsorted(self.components, components), dtype=np.intp)

    def to_json(self) -> dict[str, Any]:
        """Return the estimate as values of JSON: the upper triangle of Q as text, all digits."""
        upper = np.triu_indices(len(self.components))
        return {
            "number": self.number,
            "time": self.time,
            "names": list(self.names),
            "coordinates": self.coordinates.tolist(),
            "components": self.components.tolist(),
            "cofactors": packed(self.cofactors[upper], ALL_DIGITS),
            "motions": packed(self.motions, ALL_DIGITS),
            "vtpv": self.vtpv,
            "redundancy": self.redundancy,
            "n_observations": self.n_observations,
            "undetermined": list(self.undetermined),
            "datum": self.datum,
            **frame_record(self.frame),
        }

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> EpochEstimate:
        """Return the estimate of a record of `to_json`.

        Raises:
            InputError: it is no such record.
        """
        if missing := [name for name in _FIELDS if name not in record]:
            raise InputError(f"no estimate of an epoch: it lacks {', '.join(missing)}")
        components = np.array(record["components"], dtype=np.intp)
        k = len(components)
        cofactors = np.zeros((k, k))
        upper = np.triu_indices(k)
        try:
            cofactors[upper] = unpacked(record["cofactors"], len(upper[0]), digits=ALL_DIGITS)
            motions = unpacked(record["motions"], -1, digits=ALL_DIGITS)
            motions = motions.reshape(k, -1 if k else 0)
            coordinates = np.array(record["coordinates"], dtype=float).reshape(-1, 3)
            if len(coordinates) != len(record["names"]):
                raise ValueError(f"{len(coordinates)} places of {len(record['names'])} points")
            frame = frame_of_record(record)
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(f"no estimate of an epoch: {error}") from error
        cofactors[upper[::-1]] = cofactors[upper]
        return cls(
            int(record["number"]),
            float(record["time"]),
            tuple(record["names"]),
            coordinates,
            components,
            cofactors,
            motions,
            float(record["vtpv"]),
            int(record["redundancy"]),
            int(record["n_observations"]),
            tuple(record["undetermined"]),
            str(record["datum"]),
            frame,
        )
