"""Solution of an adjustment: values, covariances, redundancy, tables, summary; at other states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..blas_threads import with_one_thread
from ..columns import Columns
from ..errors import InputError, SingularError, unknown_name
from ..graph.equations import Equations
from ..graph.variables import State, camera_of_calibration
from ..models.unknown_registry import VariableKind, unknown_kind
from ..network.network import Network
from ..result_display import Rows, Shown
from ..statistical_tests import global_test
from ..types import Array, Index
from .added_factors import AddedFactors
from .adjustment_run import RunRecord
from .datum_defects import Defect, FreeDatum
from .estimates import (
    CalibrationEstimate,
    Estimate,
    ObservationTable,
    PoseEstimate,
    estimate,
    kind_and_name,
    network_with_values,
)
from .factorisation import Factorisation
from .gauss_newton_steps import NO_EXTRAPOLATIONS, ExtrapolationRecord
from .inner_constraints import ReferenceDatum
from .normal_equations import NormalEquations

if TYPE_CHECKING:
    import pandas

MIN_VARIANCE_ERROR = 1e-15
"""Smallest relative error of a variance that is assumed."""
MAX_CANCELLATION_ERROR = 1e-6
"""Largest relative error of a variance from the S-transformation of a block. Above it the normal
equations are solved instead, where σ cancels and not σ²."""


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Shown):
    """An adjusted network: the object stores data; derived quantities are computed on request.

    A solution can be copied and pickled. Factors that the user added are pickled as their rows at
    the solution, see `factorgraph_adj.solve.added_factors.AddedFactors`.
    """

    network: Network
    """The adjusted network."""
    equations: Equations
    """Observation equations of the network, with evaluated weights."""
    state: State
    """Values of all variables."""
    start: State
    """Given or approximate values x₀, to which the inner constraints of a free network refer."""
    converged: bool
    """Whether the iteration converged."""
    reason: str
    """Why the iteration ended."""
    iterations: int
    """Number of iterations."""
    vtpv: float
    """Weighted sum vᵀPv, for an a-priori standard deviation of unit weight 1."""
    run: RunRecord = field(repr=False)
    """Record of the adjustment for computations that continue from the solution."""
    within: float = np.inf
    """No unknown is further than this multiple of its own σ from the minimum; infinite if the
    iteration did not converge."""
    second_places: tuple[str, ...] = ()
    """Sentences on points that fit equally well at a second place, see `second_minimum`."""
    begun: tuple[str, ...] = ()
    """Sentences on how the start values were found from image points alone, see
    `factorgraph_adj.orient`; none for given and approximate values."""
    datum: FreeDatum | None = None
    """Inner constraints of a free network."""
    defects: tuple[Defect, ...] = ()
    """Datum defects that were found."""
    variance: Literal["a-priori", "a-posteriori"] = "a-priori"
    """Whether covariances are scaled by 1 or by σ̂0²."""
    weights: Array | None = None
    """Factor on the weight of each scalar observation; None: all factors are 1."""
    extra: AddedFactors = field(default_factory=AddedFactors, repr=False)
    """Factors that the user added, linearised at the solution."""
    extrapolated: ExtrapolationRecord = NO_EXTRAPOLATIONS
    """The extrapolations of steps that the iteration took; as text it says what they gained."""
    reference: ReferenceDatum | None = None
    """Datum points that covariances refer to instead of a given datum, see `s_transform`."""

    def headline(self) -> str:
        """Return the numbers of the adjustment, and how it ended."""
        ended = "converged" if self.converged else f"NOT CONVERGED: {self.reason}"
        if not (test := global_test(self)).accepted:
            bounds = f"σ̂0 accepted from {test.lower:.3f} to {test.upper:.3f}"
            failed = "fits better than its σ say" if test.too_good else "GLOBAL TEST REJECTED"
            ended += f", {failed}: {bounds}"
        if gone := len(self.network.unknowns_left_out):
            ended += f", {gone} undetermined unknown{'s' * (gone > 1)} left out"
        ended += "".join(f", BUT {place}" for place in self.second_places if self.converged)
        return (
            f"Solution of {self.network.name!r}: n {self.n_observations}, u {self.n_unknowns}, "
            f"d {self.datum_defect}, redundancy {self.redundancy}, σ̂0 {self.sigma0:.4f}, {ended}"
        )

    def first_rows(self) -> Rows:
        """Return the adjusted points, metres."""
        return Rows(
            ("point", "x", "y", "z"),
            (
                (name, *map(float, x))
                for name, x in zip(self.network.points, self.state["point"], strict=True)
            ),
            len(self.network.points),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return the data for copies and pickles, without derived quantities."""
        run = replace(self.run, linearised=None)
        return {f.name: getattr(self, f.name) for f in fields(self)} | {"run": run}

    # -- figures ------------------------------------------------------------------------------

    @property
    def n_observations(self) -> int:
        """Number of scalar observations n, including weighted unknowns."""
        return self.equations.n_rows + self.extra.n_rows

    @property
    def n_unknowns(self) -> int:
        """Number of free components u."""
        return self.equations.unknowns.n_unknowns

    @property
    def datum_defect(self) -> int:
        """Number of datum defects d that inner constraints fill."""
        return sum(d.size for d in self.defects)

    @property
    def redundancy(self) -> int:
        """Redundancy r = n − u + d."""
        return self.n_observations - self.n_unknowns + self.datum_defect

    @property
    def sum_of_redundancy_numbers(self) -> int | None:
        """Sum that the redundancy numbers must have; None: other parts of the network decide."""
        return self.redundancy

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight √(vᵀPv/r), a priori 1; NaN without redundancy."""
        return float(np.sqrt(self.vtpv / self.redundancy)) if self.redundancy > 0 else np.nan

    @property
    def variance_factor(self) -> float:
        """Scale of covariances: 1, or σ̂0² if asked for and the redundancy is positive."""
        if self.variance == "a-posteriori" and self.redundancy > 0:
            return self.sigma0**2
        return 1.0

    # -- estimates ----------------------------------------------------------------------------

    def point(self, name: str) -> Array:
        """Return the adjusted coordinates of a point, (3,) metres."""
        return np.array(self.state["point"][self.number("point", name)])

    def pose(self, photo: str) -> PoseEstimate:
        """Return the adjusted exterior orientation of a photo."""
        stored = self.state["pose"][self.number("pose", photo)]
        sigmas = np.sqrt(np.diag(self.pose_covariance(photo)))
        return PoseEstimate(stored[9:].copy(), stored[:9].reshape(3, 3).copy(), sigmas)

    def calibration(self, camera: str) -> CalibrationEstimate:
        """Return the adjusted calibration of a camera, image units.

        Args:
            camera: name of the camera; ``camera@photo`` if every photo has its own calibration.
        """
        e = self._estimate("calibration", camera)
        unit = camera_of_calibration(self.network, camera).unit
        return CalibrationEstimate(e.names, e.values, e.sigmas, e.correlation, unit)

    def orientation(self, station: str, set: str = "1") -> Estimate:
        """Return the orientation unknown of a set of directions, radians in [0, 2π)."""
        return self._estimate("orientation", f"{station}/{set}")

    def refraction(self, group: str = "") -> Estimate:
        """Return the refraction coefficient of a group; by default that of the network."""
        return self._estimate("refraction", group)

    def vertical(self, station: str) -> Estimate:
        """Return the deflections (ξ, η) of a station, radians."""
        return self._estimate("vertical", station)

    def distance_meter(self, name: str) -> Estimate:
        """Return scale (dimensionless) and zero constant (metres) of a distance meter."""
        return self._estimate("edm", name)

    def unknown(self, kind: VariableKind, name: str) -> Estimate:
        """Return an unknown of any kind by its name, SI.

        Standard deviations and correlations are those of the returned values: of a rotation, those
        of the components of its rotation vector. Turns about the turned axes are the tangent, whose
        covariance is that of `variable_covariance`. Where only some turns are held, the components
        of the vector all have a standard deviation.
        """
        return self._estimate(kind, name)

    @cached_property
    def observations(self) -> ObservationTable:
        """Every scalar observation with its residual."""
        return ObservationTable(
            self.equations, self.equations.residuals(self.state, whitened=False)
        )

    def point_table(self) -> Columns:
        """Return the adjusted points as columns: coordinates, σ, and what is held; metres.

        In a geocentric or topocentric frame also ``latitude`` and ``longitude`` (radians, north
        and east positive), ``height`` above the ellipsoid, ``sigma_east sigma_north sigma_up``.
        """
        # The table of points, and all reports, are above this module.
        return self._frame("adjusted_points", "point_frame")

    def photo_table(self) -> Columns:
        """Return the adjusted photos as columns: centres, angles and σ; metres, radians."""
        return self._frame("adjusted_photos", "photo_frame")

    def unknown_table(self) -> Columns:
        """Return all other unknowns as columns, one row for each component; SI, image units."""
        return self._frame("unknowns", "unknown_frame")

    def _frame(self, module: str, function: str) -> Columns:
        found: Columns = getattr(import_module(f"factorgraph_adj.report.{module}"), function)(self)
        return found

    # -- covariances --------------------------------------------------------------------------

    def covariance(self, a: str | Sequence[str], b: str | Sequence[str] | None = None) -> Array:
        """Return the covariance of points, or between points, metres².

        Σ = σ² Q, with σ² = 1 or σ̂0² as chosen for the adjustment; zero for held components. In a
        free network Σ belongs to the inner constraints. Where ``converged`` is false it belongs to
        the place where the iteration stopped, and may be wrong by several times.

        Args:
            a: a point, or several.
            b: a point, or several; by default those of ``a``.

        Returns:
            (3, 3) for one point, (3 m, 3 n) for several, x, y, z of each together.
        """
        other = a if b is None else b
        if isinstance(a, str) and isinstance(other, str):
            return self.variable_covariance(("point", a), ("point", other))
        first, second = ([n] if isinstance(n, str) else list(n) for n in (a, other))
        return np.block([[self.covariance(i, j) for j in second] for i in first])

    def save(self, path: str | Path) -> None:
        """Write the solution into a file; `factorgraph_adj.load_solution` brings all of it back.

        Raises:
            InputError: as `factorgraph_adj.io.solution_file.save_solution`.
        """
        # Files of networks are above this module.
        import_module("factorgraph_adj.io.solution_file").save_solution(self, path)

    def summary(self) -> str:
        """Return the result on one screen; `factorgraph_adj.text_report` returns all of it."""
        # Reports are above this module.
        found: str = import_module("factorgraph_adj.report.summary").summary(self)
        return found

    def to_pandas(self) -> dict[str, pandas.DataFrame]:
        """Return ``points``, ``photos``, ``unknowns``, ``observations``: m, rad, image units.

        Raises:
            InputError, AdjustmentError: as `factorgraph_adj.export.formats.to_pandas`.
        """
        found: dict[str, pandas.DataFrame]
        found = import_module("factorgraph_adj.export.formats").to_pandas(self)
        return found

    def as_network(self) -> Network:
        """Return the network with adjusted values as given ones, to write it or adjust it again.

        What is held stays held. What is weighted keeps its σ, about the adjusted value then. A
        camera with a calibration for each photo keeps its given values.
        """
        return network_with_values(self.network, self.equations.unknowns, self.state)

    @cached_property
    @with_one_thread
    def point_covariances(self) -> Array:
        """Covariances of all points at once, (number of points, 3, 3) metres², as `covariance`."""
        table = self.equations.unknowns["point"]
        out = np.zeros((len(table.names), 3, 3))
        reduced = self.factor.layers.reduced
        out[reduced] = self.factor.point_covariances()
        rest = np.flatnonzero((table.offset >= 0) & ~reduced)
        out[rest] = self.factor.joint(table.offset[rest, None] + np.arange(3))
        out *= table.free[:, :, None] & table.free[:, None, :]
        if self.datum is not None and self._datum_cross is not None:
            f, e = self._datum_cross
            on = np.flatnonzero(table.offset >= 0)
            columns = table.offset[on, None] + np.arange(3)
            both = self.datum.basis[columns], f[columns]
            moved = self.datum.transformed(out[on], both, both, e)
            for i in np.flatnonzero(self._cancelled(out[on], moved)).tolist():
                moved[i] = self._cross(columns[i], columns[i])
            out[on] = moved
        if self.reference is not None:
            out = self.reference.transformed_points(out)
        return out * self.variance_factor

    def standard_deviations(self, name: str) -> Array:
        """Return the standard deviations of a point, (3,) metres."""
        return np.sqrt(np.maximum(np.diag(self.covariance(name)), 0.0))

    def pose_covariance(self, photo: str) -> Array:
        """Return the covariance of a photo, (6, 6): rotations about its axes (rad), X0 (m)."""
        return self.variable_covariance(("pose", photo))

    @with_one_thread
    def variable_covariance(
        self, a: tuple[VariableKind, str], b: tuple[VariableKind, str] | None = None
    ) -> Array:
        """Return the covariance of two variables, pairs of kind and name; InputError for others.

        It is that of steps of the tangent: of a rotation R ← R Exp(ω), ω about the turned axes.
        """
        a, b = kind_and_name(a), kind_and_name(a if b is None else b)
        columns_a, size_a, rows_a = self._columns(*a)
        columns_b, size_b, rows_b = self._columns(*b)
        out = np.zeros((size_a, size_b))
        if len(columns_a) and len(columns_b):
            block = self._own(*a, columns_a) if a == b else self._cross(columns_a, columns_b)
            out[np.ix_(rows_a, rows_b)] = block
        if self.reference is not None:
            out = self.reference.transformed(out, a, b)
        return out * self.variance_factor

    def normal(self) -> NormalEquations:
        """Return the normal equations at the solution."""
        return self._normal

    @cached_property
    @with_one_thread
    def _normal(self) -> NormalEquations:
        here = self.run.linearised
        if here is not None and here.state is self.state and here.solver is self.run.solver:
            return here
        return NormalEquations(self.run.solver, self.state, self.extra.rows)

    @cached_property
    @with_one_thread
    def factor(self) -> Factorisation:
        """The factorised normal equations at the solution; a free network has a minimal datum.

        Raises:
            SingularError: an unknown is not determined, or so weakly that covariances would be
                wrong; the text has the reason why the iteration ended.
        """
        normal = self.normal()
        try:
            return normal.for_covariances(self.run.constraint, self.datum)
        except SingularError as error:
            why = "; ".join(filter(None, (str(error), self.reason)))
            what = f"the normal equations are singular at the solution ({why})"
            raise SingularError(what) from None

    @cached_property
    @with_one_thread
    def _datum_cross(self) -> tuple[Array, Array] | None:
        """F = Q_min B_D (n_columns, d) and E = B_Dᵀ F, see `FreeDatum.transformed`."""
        if self.datum is None:
            return None
        f = self.factor.solve(self.datum.masked)
        return f, self.datum.masked.T @ f

    def _free(self, block: Array, a: Index, b: Index) -> Array:
        """S-transform the cofactor block between columns a and b."""
        if self.datum is None or self._datum_cross is None:
            return block
        f, e = self._datum_cross
        g = self.datum.basis
        return self.datum.transformed(block, (g[a], f[a]), (g[b], f[b]), e)

    @with_one_thread
    def cofactor_times(self, y: Array) -> Array:
        """Return Q y for y (n_columns, k); in a free network Q = S Q_min Sᵀ, S = I − B B_Dᵀ."""
        if self.datum is None:
            return self.factor.solve(y)
        basis, masked = self.datum.basis, self.datum.masked
        x = self.factor.solve(y - masked @ (basis.T @ y))
        return np.asarray(x - basis @ (masked.T @ x))

    def _cross(self, a: Index, b: Index) -> Array:
        unit = np.zeros((self.equations.unknowns.n_columns, len(b)))
        unit[b, np.arange(len(b))] = 1.0
        return self.cofactor_times(unit)[a]

    @cached_property
    def _reduced(self) -> tuple[Array, Index]:
        """Cofactors of the points of the first layer, and the place of each point in them."""
        place = np.cumsum(self.factor.layers.reduced) - 1
        return self.factor.point_covariances(), place

    def _own(self, kind: VariableKind, name: str, columns: Index) -> Array:
        """Return the cofactor of one variable, from the selected inverse if digits suffice."""
        if self.run.solver.iterative:
            return self._cross(columns, columns)
        number = self.number(kind, name)
        if kind == "point" and self.factor.layers.reduced[number]:
            every, place = self._reduced
            block = every[place[number]]
        else:
            block = self.factor.joint(columns[None])[0]
        free = self.equations.unknowns.free[columns]
        block = np.where(np.outer(free, free), block, 0.0)
        moved = self._free(block, columns, columns)
        return self._cross(columns, columns) if self._cancelled(block, moved) else moved

    def _cancelled(self, before: Array, after: Array) -> Array:
        """Return where the S-transformation of blocks (…, k, k) has lost too many digits, (…)."""
        was, left = (np.diagonal(x, axis1=-2, axis2=-1) for x in (before, after))
        rounding = max(self.factor.uncertainty, MIN_VARIANCE_ERROR)
        return np.asarray(np.any(rounding * was > MAX_CANCELLATION_ERROR * np.abs(left), axis=-1))

    # -- helpers ------------------------------------------------------------------------------

    def number(self, kind: VariableKind, name: str) -> int:
        """Return the number of a variable.

        Raises:
            InputError: no variable has this name, or no kind; the error lists the valid ones.
        """
        title = unknown_kind(kind).title
        table = self.equations.unknowns[kind]
        if name not in table.number:
            raise InputError(unknown_name(title, name, table.names))
        return table.number[name]

    def _columns(self, kind: VariableKind, name: str) -> tuple[Index, int, Index]:
        number = self.number(kind, name)
        columns = self.equations.unknowns.columns(kind, number)
        size = int(self.equations.unknowns[kind].size[number])
        return columns, size, np.arange(size) if len(columns) else np.zeros(0, dtype=np.intp)

    def _estimate(self, kind: VariableKind, name: str) -> Estimate:
        tangent, number = self.variable_covariance((kind, name)), self.number(kind, name)
        return estimate(self.equations.unknowns, self.state, kind, number, tangent)


def solution_at(solution: Solution, state: State) -> Solution:
    """Return a solution object at another state, which need not be a minimum.

    Raises:
        InputError: the solution was pickled and has lost factors that the user added.
    """
    return replace(solution, state=state, extra=solution.extra.at(solution.equations, state))


@with_one_thread
def normal_equations_at(solution: Solution, state: State) -> NormalEquations:
    """Return the normal equations of a solution at any state.

    Raises:
        InputError: as `solution_at`.
    """
    extra = solution.extra.at(solution.equations, state)
    return NormalEquations(solution.run.solver, state, extra.rows)


def forget_normal_equations(solution: Solution) -> None:
    """Give the memory of the normal equations back; they are made again when asked for."""
    object.__setattr__(solution, "run", replace(solution.run, linearised=None))
    for name in ("_normal", "factor"):
        solution.__dict__.pop(name, None)


def datum_cross(solution: Solution) -> tuple[Array, Array] | None:
    """Return F = Q_min B_D and E = B_Dᵀ F of a free network, see `FreeDatum.transformed`."""
    return solution._datum_cross


def cofactors_at(solution: Solution, columns: Index) -> Array:
    """Return the cofactors of some columns, (n, n)."""
    q = solution._cross(columns, columns)
    return np.asarray((q + q.T) / 2.0)
