"""The solution of a network that was adjusted in parts, as a whole and part by part."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import InputError, Problem, UnknownLeftOut, known
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..result_display import Rows, Shown
from ..solve.adjustment_run import RunRecord
from ..solve.estimates import Estimate, estimate
from ..solve.factorisation import Factorisation
from ..solve.normal_equations import NormalEquations
from ..solve.solution import Solution
from ..types import Array
from .junctions import (
    MAX_LISTED_TESTS,
    IterationState,
    Junctions,
    PartQuality,
    PartStart,
    TestedObservation,
)
from .loaded_part import STAMP_FILE, LoadedPart, PartJob, variable_key
from .part_files import TemporaryFolder


@dataclass(frozen=True)
class Totals:
    """Figures of the whole network."""

    vtpv: float
    """Value of vᵀPv."""
    redundancy: int
    """Redundancy."""
    variance_factor: float
    """Scale of covariances: 1, or σ̂0²."""
    converged: bool
    """Whether the iteration converged."""
    reason: str
    """Why the iteration ended."""
    iterations: int
    """Number of iterations."""
    within: float
    """No unknown is further than this multiple of its own σ from the minimum."""


@dataclass(frozen=True, eq=False, repr=False)
class PartSolution(Solution):
    """The solution of a part of a network that was adjusted in parts.

    Estimates, covariances and redundancy numbers are those of the whole network; redundancy, vᵀPv
    and σ̂0 too. Observations and unknowns are those of the part.
    """

    totals: Totals | None = None
    """Figures of the whole network."""

    @classmethod
    def of(
        cls, normal: NormalEquations, start: State, factor: Factorisation, totals: Totals
    ) -> PartSolution:
        """Return the solution of a part.

        Args:
            normal: the linearisation at the solution.
            start: the values that the iteration started from.
            factor: the eliminated part, which knows the covariances of its junctions.
            totals: figures of the whole network.
        """
        equations = normal.solver.equations
        out = cls(
            network=equations.network,
            equations=equations,
            state=normal.state,
            start=start,
            converged=totals.converged,
            reason=totals.reason,
            iterations=totals.iterations,
            within=totals.within,
            vtpv=totals.vtpv,
            run=RunRecord(normal.solver, 0.0 * normal.diagonal, linearised=normal),
            totals=totals,
        )
        out.__dict__["factor"] = factor
        return out

    def every_covariance(self) -> dict[str, Array]:
        """Return the covariances of all variables, (n, k, k) for each kind, zero where held."""
        out = {"point": self.point_covariances}
        for kind, table in self.equations.unknowns.tables.items():
            if kind == "point":
                continue
            k = table.free.shape[1]
            found = np.zeros((len(table.names), k, k))
            for size in np.unique(table.size[table.offset >= 0]).tolist():
                on = np.flatnonzero((table.offset >= 0) & (table.size == size))
                columns = table.offset[on, None] + np.arange(size)
                found[on, :size, :size] = self.factor.joint(columns)
            found *= table.free[:, :, None] & table.free[:, None, :]
            out[kind] = found * self.variance_factor
        return out

    @property
    def redundancy(self) -> int:
        """Redundancy of the whole network."""
        assert self.totals is not None
        return self.totals.redundancy

    @property
    def sum_of_redundancy_numbers(self) -> None:
        """Only all parts together have a known sum."""
        return None

    @property
    def variance_factor(self) -> float:
        """Scale of covariances: 1, or σ̂0² of the whole network."""
        assert self.totals is not None
        return self.totals.variance_factor


@dataclass(frozen=True)
class WholeQuality:
    """Figures of the whole network, and of each part."""

    totals: Totals
    """Figures of the whole network."""
    n_observations: int
    """Number of scalar observations."""
    n_unknowns: int
    """Number of free components."""
    parts: tuple[PartQuality, ...]
    """Figures of each part."""
    second_places: tuple[str, ...] = ()
    """Sentences on points of one part alone that fit equally well at a second place."""


@dataclass(frozen=True, eq=False)
class PartResult:
    """A part after the adjustment; arrays are in the order of its points or observations."""

    equations: Equations
    """Observation equations of the part; given values of weighted junctions count in one part."""
    state: State
    """Values of all its variables, in stored form."""
    covariances: dict[VariableKind, Array]
    """Covariance of the tangent of each variable by kind, (n, k, k), SI; zero where held."""
    redundancy_numbers: Array
    """Redundancy number of each scalar observation, (n,)."""
    w: Array
    """Test value of Baarda of each scalar observation, (n,)."""
    mdb: Array
    """Smallest detectable error of each scalar observation, (n,)."""
    delta_bar: Array
    """External reliability of each scalar observation, (n,)."""
    estimated_errors: Array
    """Estimated error of each scalar observation if only it is wrong, (n,)."""

    def residuals(self) -> Array:
        """Return v = computed − observed of every scalar observation, (n,), SI or image units."""
        return self.equations.residuals(self.state, whitened=False)

    def unknown(self, kind: VariableKind, number: int) -> Estimate:
        """Return an unknown by its number in the part, SI; see `Solution.unknown`."""
        unknowns = self.equations.unknowns
        k = int(unknowns[kind].size[number])
        tangent = self.covariances[kind][number, :k, :k]
        return estimate(unknowns, self.state, kind, number, tangent)


@dataclass(frozen=True, eq=False, repr=False)
class PartsSolution(Shown):
    """An adjusted network in parts; what belongs to a part is read from its folder on request."""

    name: str
    """Name of the network."""
    jobs: tuple[PartJob, ...]
    """The parts."""
    junctions: Junctions
    """The unknowns that several parts have."""
    state: int
    """Number of the written state of the solution."""
    weights: int
    """Number of the written state whose lengths of sights give the standard deviations."""
    begun: tuple[PartStart, ...]
    """Sizes of the parts."""
    quality: WholeQuality
    """Figures of the whole network and of each part."""
    repeated: tuple[tuple[str, str], ...]
    """Part and name of observations that agree with one of another part in kind, unknowns and all
    digits of the value: each of them counts, although they are probably the same."""
    sent: int
    """Bytes of the arrays that were sent to the parts."""
    received: int
    """Bytes of the arrays that were received from the parts."""
    _last: dict[str, PartResult] = field(default_factory=dict, repr=False)
    temporary: TemporaryFolder | None = field(default=None, repr=False)
    """The folder of the run, if it disappears with the solution."""
    unknowns_left_out: tuple[UnknownLeftOut, ...] = ()
    """Unknowns that were left out as nothing determines them, see `determined_part`."""

    def headline(self) -> str:
        """Return the numbers of the adjustment, and how it ended."""
        ended = "converged" if self.converged else f"NOT CONVERGED: {self.reason}"
        return (
            f"PartsSolution of {self.name!r}: {len(self.jobs)} parts, "
            f"{self.junctions.n_columns} junction components, n {self.n_observations}, "
            f"u {self.n_unknowns}, redundancy {self.redundancy}, σ̂0 {self.sigma0:.4f}, {ended}"
        )

    def first_rows(self) -> Rows:
        """Return the parts."""
        return Rows(
            ("part", "observations", "own unknowns", "junctions", "Σr", "largest |w|"),
            (
                (
                    job.part.name,
                    b.n_rows,
                    b.n_unknowns,
                    len(of_part),
                    q.redundancy,
                    max((abs(t.w) for t in q.largest), default=0.0),
                )
                for job, b, q, of_part in zip(
                    self.jobs, self.begun, self.quality.parts, self.junctions.of_part, strict=True
                )
            ),
            len(self.jobs),
        )

    # -- figures ------------------------------------------------------------------------------

    @property
    def converged(self) -> bool:
        """Whether the iteration converged."""
        return self.quality.totals.converged

    @property
    def reason(self) -> str:
        """Why the iteration ended."""
        return self.quality.totals.reason

    @property
    def second_places(self) -> tuple[str, ...]:
        """Sentences on points of one part alone that fit equally well at a second place."""
        return self.quality.second_places

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return self.quality.totals.iterations

    @property
    def vtpv(self) -> float:
        """Weighted sum vᵀPv."""
        return self.quality.totals.vtpv

    @property
    def n_observations(self) -> int:
        """Number of scalar observations n."""
        return self.quality.n_observations

    @property
    def n_unknowns(self) -> int:
        """Number of free components u."""
        return self.quality.n_unknowns

    @property
    def redundancy(self) -> int:
        """Redundancy r = n − u."""
        return self.quality.totals.redundancy

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight √(vᵀPv/r); NaN without redundancy."""
        return float(np.sqrt(self.vtpv / self.redundancy)) if self.redundancy > 0 else np.nan

    @property
    def sum_of_redundancy_numbers(self) -> float:
        """Σr over all observations of all parts; it equals the redundancy up to rounding."""
        return sum(p.redundancy for p in self.quality.parts)

    @cached_property
    def largest_tests(self) -> tuple[tuple[str, TestedObservation], ...]:
        """The observations with the largest |w| in all parts, each with the name of its part."""
        every = [
            (job.part.name, t)
            for job, q in zip(self.jobs, self.quality.parts, strict=True)
            for t in q.largest
        ]
        return tuple(sorted(every, key=lambda entry: -abs(entry[1].w))[:MAX_LISTED_TESTS])

    # -- parts --------------------------------------------------------------------------------

    def part(self, name: str) -> PartResult:
        """Return the results of a part, which is read again.

        Raises:
            InputError: no part has this name; the folder has the results of a later run; or the
                part has changed since.
        """
        found = {job.part.name: job for job in self.jobs}
        if name not in found:
            raise InputError(
                Problem(f"unknown part; known: {known(found, meant=name)}", f"part {name!r}")
            )
        loaded = LoadedPart(found[name])
        folder = found[name].own
        if folder.read(STAMP_FILE) != list(loaded.stamp()):
            what = (
                "a later run has written into the folder of this solution, or the part has "
                "changed since: adjust again, and give each solution a folder of its own"
            )
            raise InputError(Problem(what, f"part {name!r}, {folder.path}"))
        tests = folder.arrays("reliability")
        return PartResult(
            loaded.solver_at(IterationState(self.state, self.weights)).equations,
            loaded.state(self.state),
            dict(folder.arrays("covariances")),
            tests["r"],
            tests["w"],
            tests["mdb"],
            tests["delta_bar"],
            tests["estimated_errors"],
        )

    def results(self) -> Iterator[tuple[str, PartResult]]:
        """Iterate over the names and results of all parts; one part is in memory at a time."""
        for job in self.jobs:
            yield job.part.name, self.part(job.part.name)

    def point(self, name: str) -> Array:
        """Return the adjusted coordinates of a point, (3,) metres.

        Raises:
            InputError: no part has the point.
        """
        result, number = self._found("point", name)
        return np.array(result.state["point"][number])

    def covariance(self, name: str) -> Array:
        """Return the covariance of a point, (3, 3) metres²."""
        result, number = self._found("point", name)
        return np.array(result.covariances["point"][number])

    def unknown(self, kind: VariableKind, name: str) -> Estimate:
        """Return an unknown of any kind by its name, SI; see `Solution.unknown`."""
        result, number = self._found(kind, name)
        return result.unknown(kind, number)

    def _in_memory(self, name: str) -> PartResult:
        """Return the results of the part that was asked for last, or read them."""
        last = self._last.get(name)
        if last is None:
            self._last.clear()
            last = self._last[name] = self.part(name)
        return last

    def _found(self, kind: VariableKind, name: str) -> tuple[PartResult, int]:
        key = variable_key(kind, name)
        for job in self.jobs:
            keys = job.own.arrays("keys")[kind]
            if key in keys:
                return self._in_memory(job.part.name), int(np.flatnonzero(keys == key)[0])
        raise InputError(Problem("no part has it", f"{UNKNOWNS[kind].noun} {name!r}"))
