"""Report: a solution with options, whose tests, ellipses, poses, doubts all sections share."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import nan
from typing import TypeVar

import numpy as np

from ..errors import AdjustmentError, InputError, SingularError
from ..graph.variables import calibration_name
from ..io.numbers import Units
from ..models.unknown_registry import VariableKind
from ..network.network import Network
from ..observations.registry import in_image_table
from ..quality.causes.cause_search import Causes
from ..quality.causes.shared_error_tests import GivenValue
from ..quality.derived_quantities import (
    AdjustedLine,
    AdjustedShape,
    adjusted_lines,
    adjusted_shapes,
)
from ..quality.doubtful_sigmas import doubtful_sigmas
from ..quality.error_ellipses import ErrorEllipse, ErrorEllipsoid, error_ellipses, error_ellipsoids
from ..quality.misleading_readings import likely_causes
from ..quality.parameter_significance import (
    ParameterLabel,
    Significance,
    TestedParameter,
    significance,
)
from ..quality.point_precision import Place, check_points
from ..quality.protection_levels import ProtectionLevels, protection_levels
from ..quality.rejections import (
    Rejected,
    Snooping,
    Unresolved,
    group_losses,
    lost_control,
    rejected_coordinates,
    uncontrolled_datum,
)
from ..quality.reliability import Reliability, reliability, stiff_ties
from ..quality.variance_components import VarianceComponents
from ..solve.estimates import CalibrationEstimate, GeodeticCoordinates, geodetic_coordinates
from ..solve.grid_coordinates import GridCoordinates, GridPhotos, grid_coordinates, grid_photos
from ..solve.solution import Solution
from ..types import Array, Mask
from ..units import ANGLE, LENGTH
from ..validate.mistyped_names import listed_doubts, mistyped_names
from ..validate.preliminary_checks import named_mistakes, preliminary
from ..validate.stated_values import wrong_line_lengths
from . import image_axes
from .doubtful_results import (
    check_point_doubts,
    doubts_of_network,
    doubts_of_solution,
    exceedance_doubts,
    findings_on_misfits,
    loss_sentences,
)
from .exterior_orientations import PoseFigures, pose_figures
from .observation_rows import ReportRows
from .options import Provenance, ReportOptions
from .rejected_observations import RejectedObservations, set_aside

Line = TypeVar("Line")

MAX_FINDINGS_NAMED = 3
"""Largest number of findings of `check` that are said of an adjustment that is bent."""


@dataclass(frozen=True)
class Report:
    """A solution with the options of its report."""

    solution: Solution
    """Result of the adjustment."""
    options: ReportOptions = field(default_factory=ReportOptions)
    """Units, lengths of lists, probabilities and tests of the report."""
    provenance: Provenance = field(default_factory=Provenance)
    """Data snooping or variance components that the solution comes from."""
    known: Reliability | None = None
    """Reliability that was computed before."""

    @property
    def network(self) -> Network:
        """The network."""
        return self.solution.network

    @property
    def subject(self) -> str:
        """What was adjusted: the subject of the run, or the name of the network; may be empty."""
        return self.provenance.run.subject or self.network.name

    @property
    def units(self) -> Units:
        """Units of coordinates, angles and their standard deviations."""
        return self.options.units

    @property
    def snooping(self) -> Snooping | None:
        """Data snooping that the solution comes from."""
        return self.provenance.snooping

    @property
    def components(self) -> VarianceComponents | None:
        """Variance components that the weights of the solution come from."""
        return self.provenance.components

    @cached_property
    def rows(self) -> ReportRows:
        """Scalar observations of the solution."""
        residuals = self.solution.observations.residuals
        return ReportRows(self.solution.equations, residuals, self.units)

    @cached_property
    def singular(self) -> bool:
        """Whether covariances are missing: conjugate gradients, or an iteration stopped early."""
        if (iterative := self.solution.run.solver.iterative) or self.solution.converged:
            return iterative
        try:
            kind, number = next(self.solution.equations.unknowns.active())
            name = self.solution.equations.unknowns[kind].names[number]
            self.solution.variable_covariance((kind, name))
        except SingularError:
            return True
        return False

    @cached_property
    def _reliability(self) -> Reliability | str:
        """Reliability of every observation, or the reason why it cannot be computed."""
        snooping = self.snooping
        if snooping is not None and snooping.solution is self.solution:
            return snooping.reliability
        if self.known is not None:
            return self.known
        if self.singular:
            return f"no reliability: {self.solution.run.solver.no_inverse}"
        try:
            return reliability(self.solution, alpha=self.options.alpha, power=self.options.power)
        except InputError:
            raise
        except AdjustmentError as error:
            return str(error)

    @property
    def reliability(self) -> Reliability | None:
        """Reliability of every observation; None if it cannot be computed."""
        return None if isinstance(self._reliability, str) else self._reliability

    @property
    def no_reliability(self) -> str:
        """Reason why the reliability cannot be computed; empty if it can."""
        return self._reliability if isinstance(self._reliability, str) else ""

    @cached_property
    def stiff(self) -> Mask:
        """Which rows are stiff ties of the model, (n_rows,); none without reliability."""
        if self.reliability is None:
            return np.zeros(len(self.rows), dtype=bool)
        return stiff_ties(self.reliability)

    @property
    def pope(self) -> bool:
        """Whether the test values are τ (Pope) and not w (Baarda)."""
        test = self.options.test
        return test == "pope" if test else self.solution.variance == "a-posteriori"

    @property
    def tests(self) -> tuple[Array, float]:
        """Test values w or τ of all rows and their critical value; empty without reliability."""
        rel = self.reliability
        if rel is None:
            return np.zeros(0), nan
        return (rel.tau, rel.critical_tau) if self.pope else (rel.w, rel.critical_w)

    @property
    def above_critical(self) -> list[str]:
        """How many test values are above the critical one, if chance does not make as many."""
        values, critical = self.tests
        name, alpha = "τ" if self.pope else "w", self.options.alpha
        return exceedance_doubts(values, critical, name, alpha, self.redundancy_of_tau)

    @property
    def redundancy_of_tau(self) -> int | None:
        """Redundancy, if the test values are τ; none: they are w."""
        return self.solution.redundancy if self.pope else None

    @cached_property
    def doubts(self) -> list[str]:
        """Why the result may be wrong; empty if there are none."""
        return [
            *doubts_of_solution(self.solution),
            *self.sigma_doubts,
            *doubts_of_network(self.network),
            *self.above_critical,
            *self.shared_error_doubts,
            *self.doubtful_check_points,
        ]

    @cached_property
    def sigma_doubts(self) -> list[str]:
        """The groups whose σ, or lengths on which it depends, may be stated in a wrong unit."""
        rel, s = self.reliability, self.solution
        lengths = wrong_line_lengths(s.equations, s.state) if s.converged else []
        return [*lengths, *([] if rel is None else map(str, doubtful_sigmas(rel)))]

    @property
    def doubtful_check_points(self) -> list[str]:
        """The check points that lie far off."""
        if self.singular:
            return []
        free = self.solution.datum is not None
        return check_point_doubts(check_points(self.solution), free=free)

    @property
    def shared_error_doubts(self) -> list[str]:
        """What speaks against gross errors of single readings."""
        return [*self.more_probable, *self._found_before, *self._lost, *self._mistyped]

    @cached_property
    def _mistyped(self) -> list[str]:
        """The names that may be typing errors."""
        s = self.solution
        if not s.converged:
            return []
        return listed_doubts(
            mistyped_names(s.equations, s.state, lambda at: s.point_covariances[at])
        )

    @property
    def bent(self) -> bool:
        """Whether gross errors have bent an adjustment without snooping.

        It has no minimum, or the cause that explains most has a size that nobody makes.
        """
        if not self.solution.converged:
            return True
        return not all(c.plausible for c in (self.causes.found[:1] if self.causes else ()))

    @cached_property
    def _found_before(self) -> list[str]:
        """The preliminary findings that explain what does not fit.

        After data snooping they concern rejected or unresolved observations; without it they are
        mistakes of whole groups, such as a unit, and where gross errors have bent it, all others.
        """
        original = self.provenance.original
        if self.snooping is None and doubts_of_solution(self.solution):
            network = self.network if original is None else original
            units = {"length": self.units.length, "angle": self.units.angle}
            every = named_mistakes(network, **units)
            if not every and self.bent:
                every = preliminary(network, **units)[:MAX_FINDINGS_NAMED]
            return [f"found before the adjustment: {finding}" for finding in every]
        if self.snooping is None or original is None:
            return []
        wrong = {*self.snooping.rejected_ids, *(u.id for u in self.snooping.unresolved)}
        if not wrong:
            return []
        found = preliminary(original, length=self.units.length, angle=self.units.angle)
        first = None if self.causes is None else self.causes.most_probable
        named = set() if first is None else set(first.ids)
        return findings_on_misfits([f for f in found if not named or set(f.ids) != named], wrong)

    @cached_property
    def _lost(self) -> list[str]:
        """The instruments and points of which much was rejected."""
        original = self.provenance.original
        if self.snooping is None or original is None:
            return []
        place = uncontrolled_datum(self.snooping)
        found = loss_sentences(group_losses(self.snooping, original, self.snooping.whole))
        control = lost_control(self.snooping, original)
        given = rejected_coordinates(self.snooping, original) if place is None else None
        return [*found, *(str(x) for x in (place, control, given) if x is not None)]

    @property
    def more_probable(self) -> list[str]:
        """The cause that explains more than what data snooping rejected; empty if there is none.

        Without snooping the test values are the doubt; with σ0 estimated it may show in none.
        """
        if self.causes is None:
            return []
        first = self.causes.most_probable
        if self.snooping is None and first is not None and not first.sizes:
            return [f"readings fit without a mistake: {first}"]
        if self.snooping is None and not self.pope:
            return []
        if first is None:
            return self.causes.undecided_sentences
        what = "" if self.causes.alone(first) else "one of several errors, "
        rest = self.causes.consequence(first)
        return [f"{what}more probable than gross errors of single readings: {first}{rest}"]

    @cached_property
    def causes(self) -> Causes | None:
        """Causes that several observations share; None where nothing misfits."""
        if self.snooping is not None:
            found = self.snooping.causes
        else:
            alpha, pope = self.options.alpha, self.pope
            found = likely_causes(self.solution, self.reliability, alpha=alpha, estimated=pope)
        return None if found is None else image_axes.causes_in_files(self.network, found)

    @cached_property
    def given(self) -> tuple[GivenValue, ...]:
        """Tests of given values that are held, in the axes of files."""
        found = () if self.reliability is None else self.reliability.given_values
        return tuple(image_axes.given_value_in_files(self.network, v) for v in found)

    @cached_property
    def set_aside(self) -> RejectedObservations | None:
        """Observations rejected by data snooping; None without snooping or original network."""
        found, original = self.snooping, self.provenance.original
        if found is None or original is None:
            return None
        return set_aside(self.solution, found.rejected_ids, original, self.units)

    def sign_in_report(self, found: Rejected | Unresolved) -> float:
        """Return the factor from figures of data snooping to those shown, as `Row.sign`.

        It is NaN where cameras have different axes and the original network is not there.
        """
        if not in_image_table(found.kind) or found.component != "y":
            return 1.0
        down = {c.y_down_in_files for c in self.network.cameras.values()}
        if len(down) == 1:
            return -1.0 if down.pop() else 1.0
        aside = self.set_aside
        return nan if aside is None else aside.find(found.id, found.component).sign

    @cached_property
    def significance(self) -> Significance | None:
        """Tests of calibration and other parameters, y0 as in files; None without covariance."""
        try:
            if self.singular:
                return None
            return image_axes.significance_in_files(self.network, significance(self.solution))
        except AdjustmentError:
            return None

    def tested(self, kind: VariableKind, name: str, component: str) -> TestedParameter | None:
        """Return the test of a parameter; None if the parameter has no test."""
        return self._tests.get((kind, name, component))

    @cached_property
    def _tests(self) -> dict[ParameterLabel, TestedParameter]:
        return {p.label: p for p in getattr(self.significance, "parameters", ())}

    @cached_property
    def ellipses(self) -> dict[str, ErrorEllipse]:
        """Error ellipses of the points, if the options ask for them."""
        if self.options.confidence is None or self.singular:
            return {}
        found = error_ellipses(self.solution, confidence=self.options.confidence)
        return dict(zip(self.network.points, found, strict=True))

    @cached_property
    def ellipsoids(self) -> dict[str, ErrorEllipsoid]:
        """Error ellipsoids of free projection centres, if the options ask for them."""
        if self.options.confidence is None or self.singular:
            return {}
        names = [n for n in self.network.photos if self.free("pose", n)]
        places: list[Place] = [("pose", n) for n in names]
        found = error_ellipsoids(self.solution, places, confidence=self.options.confidence)
        return dict(zip(names, found, strict=True))

    @cached_property
    def protection_levels(self) -> ProtectionLevels | None:
        """Protection levels of the points, if the options ask for them and there is a reliability.

        Raises:
            InputError: as `protection_levels`.
        """
        risk, snooping = self.options.protection_risk, self.snooping
        if risk is None or self.reliability is None:
            return None
        snooped = snooping is not None and snooping.solution is self.solution
        return protection_levels(
            snooping if snooped and snooping is not None else self.reliability,
            risk=risk,
            faults=self.options.faults,
        )

    @cached_property
    def lines(self) -> tuple[AdjustedLine, ...]:
        """Adjusted lines between the pairs of places that the options name."""
        pairs = self.options.relative
        if pairs is None or self.singular:
            return ()
        named = None if pairs == "observed" else pairs
        return adjusted_lines(self.solution, named, confidence=self.options.confidence)

    @cached_property
    def shapes(self) -> tuple[AdjustedShape, ...]:
        """Shapes as engineers state them; none where there is no covariance."""
        return () if self.singular else adjusted_shapes(self.solution)

    @property
    def metre(self) -> float:
        """Unit of coordinates, in metres."""
        return LENGTH[self.units.length]

    @property
    def small(self) -> float:
        """Unit of σ of lengths, in metres."""
        return LENGTH[self.units.sigma_length]

    @property
    def radian(self) -> float:
        """Unit of σ of angles, in radians."""
        return ANGLE[self.units.sigma_angle]

    def free(self, kind: VariableKind, name: str) -> bool:
        """Return whether any component of a variable is unknown."""
        table = self.solution.equations.unknowns[kind]
        return bool(table.offset[table.number[name]] >= 0)

    @cached_property
    def poses(self) -> dict[str, PoseFigures]:
        """Exterior orientations by photo."""
        known = not self.singular
        return {n: pose_figures(self.solution, n, known=known) for n in self.network.photos}

    @cached_property
    def calibrations(self) -> dict[str, CalibrationEstimate]:
        """Calibrations of the network by camera or camera@photo, in the axes of files."""
        network, found = self.network, self.solution.calibration
        names = dict.fromkeys(calibration_name(network, f) for f in network.photos)
        return {n: image_axes.calibration_in_files(network, n, found(n)) for n in names}

    @cached_property
    def sigmas(self) -> Array:
        """Standard deviations of points in the order of the network, (n, 3) metres."""
        variances = np.einsum("nii->ni", self.solution.point_covariances)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    @cached_property
    def geographic(self) -> GeodeticCoordinates | None:
        """Latitude, longitude and height of the points; None in a local frame."""
        s = self.solution
        return geodetic_coordinates(self.network.frame, s.state["point"], s.point_covariances)

    @cached_property
    def _grids(self) -> tuple[GridCoordinates, GridPhotos] | str:
        """Points and photos in the grid, or the reason why there are none."""
        system = self.network.crs
        if system is None:
            return "the network has no reference system"
        try:
            if not system.projected:
                return f"reference system {system.name} has no grid"
            return grid_coordinates(self.solution), grid_photos(self.solution)
        except AdjustmentError as error:
            return str(error)

    @property
    def grid(self) -> GridCoordinates | None:
        """Points in the grid of the reference system; None without one."""
        return None if isinstance(self._grids, str) else self._grids[0]

    @property
    def grid_photos(self) -> GridPhotos | None:
        """Photos in the grid of the reference system; None without one."""
        return None if isinstance(self._grids, str) else self._grids[1]

    @property
    def no_grid(self) -> str:
        """Reason why there are no grid coordinates; empty if there are."""
        return self._grids if isinstance(self._grids, str) else ""

    def where(self, file: str) -> str:
        """Return the place of a table, or the way to write it."""
        folder, noun = self.options.tables, "the table" if file.endswith(".csv") else "the file"
        return f"{folder}/{file}" if folder else f"{noun} {file} (option --out)"

    def cut(self, rows: list[Line], what: str, file: str) -> tuple[list[Line], list[str]]:
        """Return the rows to show, and a line about omitted rows, if any."""
        if len(rows) <= self.options.most:
            return rows, []
        note = f"  … {len(rows) - self.options.most} more {what} in {self.where(file)}"
        return rows[: self.options.most], [note]
