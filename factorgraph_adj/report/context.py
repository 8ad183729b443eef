"""What every section of a protocol needs to know."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import nan, sqrt
from typing import TypeVar

from ..graph.variables import calibration_name
from ..io.numbers import Units
from ..models.registry import VariableKind
from ..network import Network
from ..quality.solution import CalibrationEstimate, Solution
from ..rotation import angles_by_rotation, omega_phi_kappa
from ..solve.tree import SingularError
from ..types import Array
from ..units import ANGLE, LENGTH
from .rows import Rows

Line = TypeVar("Line")


@dataclass(frozen=True)
class PoseFigures:
    """Exterior orientation of a photo as surveyors state it."""

    position: tuple[float, ...]
    """X0, Y0, Z0, metres."""
    angles: tuple[float, ...]
    """ω, φ, κ, radians."""
    rotation: Array
    """world_R_camera (3, 3)."""
    sigma_position: tuple[float, ...]
    """σ of X0, Y0, Z0, metres."""
    sigma_angles: tuple[float, ...]
    """σ of ω, φ, κ, radians; NaN at φ = ±π/2."""


@dataclass(frozen=True)
class Report:
    """A solution, and how it is to be shown."""

    solution: Solution
    """What was found."""
    units: Units = field(default_factory=Units)
    """Units of coordinates, angles and their standard deviations."""
    most: int = 60
    """Rows after which a list is cut."""
    tables: str = ""
    """Folder where the CSV tables lie."""

    @property
    def network(self) -> Network:
        """The network."""
        return self.solution.network

    @cached_property
    def rows(self) -> Rows:
        """Its scalar observations."""
        return Rows(self.solution, self.units)

    @cached_property
    def singular(self) -> bool:
        """Whether there is no covariance: it can be so where an iteration stopped half-way."""
        if self.solution.converged:
            return False
        try:
            kind, number = next(self.solution.equations.unknowns.active())
            name = self.solution.equations.unknowns[kind].names[number]
            self.solution.variable_covariance((kind, name))
        except SingularError:
            return True
        return False

    @property
    def metre(self) -> float:
        """Metres in one unit of coordinates."""
        return LENGTH[self.units.length]

    @property
    def small(self) -> float:
        """Metres in one unit of σ of lengths."""
        return LENGTH[self.units.sigma_length]

    @property
    def radian(self) -> float:
        """Radians in one unit of σ of angles."""
        return ANGLE[self.units.sigma_angle]

    def free(self, kind: VariableKind, name: str) -> bool:
        """Return whether any component of a variable is unknown."""
        table = self.solution.equations.unknowns[kind]
        return bool(table.offset[table.number[name]] >= 0)

    @cached_property
    def poses(self) -> dict[str, PoseFigures]:
        """Exterior orientations by photo."""
        return {name: self._pose(name) for name in self.network.photos}

    def _pose(self, name: str) -> PoseFigures:
        state = self.solution.state["pose"]
        stored = state[self.solution.equations.unknowns["pose"].number[name]]
        rotation = stored[:9].reshape(3, 3)
        covariance = self.solution.pose_covariance(name)
        turn = angles_by_rotation(rotation)
        variances = (turn @ covariance[:3, :3] @ turn.T).diagonal().tolist()
        return PoseFigures(
            tuple(stored[9:].tolist()),
            omega_phi_kappa(rotation),
            rotation,
            tuple(sqrt(max(v, 0.0)) for v in covariance.diagonal().tolist()[3:]),
            tuple(sqrt(v) if v >= 0 else nan for v in variances),
        )

    @cached_property
    def calibrations(self) -> dict[str, CalibrationEstimate]:
        """Calibrations in use, by camera or camera@photo."""
        names = dict.fromkeys(calibration_name(self.network, f) for f in self.network.photos)
        return {name: self.solution.calibration(name) for name in names}

    @cached_property
    def sigmas(self) -> dict[str, tuple[float, ...]]:
        """Standard deviations of points, metres."""
        points = self.network.points
        return {n: tuple(self.solution.standard_deviations(n).tolist()) for n in points}

    def where(self, file: str) -> str:
        """Return where a table is, or how to get it."""
        return f"{self.tables}/{file}" if self.tables else f"the table {file} (option --out)"

    def cut(self, rows: list[Line], what: str, file: str) -> tuple[list[Line], list[str]]:
        """Return the rows to show, and a line about those left out, if any are."""
        if len(rows) <= self.most:
            return rows, []
        note = f"  … {len(rows) - self.most} more {what} in {self.where(file)}"
        return rows[: self.most], [note]
