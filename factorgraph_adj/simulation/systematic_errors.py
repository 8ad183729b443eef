"""Systematic errors: image shifts by lens and film; true refraction, scale and zero of distances.

Some errors concern quantities of the network, such as refraction or the scale of a tape: the
readings are made with the true value, and the network has the assumed value. Other errors are in
the photo and are added to the image coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from ..entities import REFRACTION_OF_THE_NETWORK, Parameter
from ..errors import Problem, unknown_name
from ..network.network import Network
from ..observations.base import of_quantities
from ..observations.registry import DISTANCE_QUANTITIES, INCLINATION_QUANTITIES
from ..types import Array
from ..units import MILLIMETRE, PPM
from .generate.scene import MICROMETRE
from .parameters import Parameters, number, path_of

TRUE_SCALE = "true scale"
"""Name of the distance meter for readings of distances that state no distance meter."""


@dataclass(frozen=True)
class Systematic(Parameters):
    """Base of the systematic errors."""

    @property
    def is_zero(self) -> bool:
        """Whether the size of the error is zero."""
        raise NotImplementedError

    def unknown(self, plan: Network, where: str) -> list[Problem]:
        """Return problems with names and readings that the plan lacks."""
        problems = self._not_there(plan, where)
        if problems or self.is_zero:
            return problems
        without = self._without_readings(plan)
        return [Problem(f"changes no reading: {without}", where)] if without else []

    def _not_there(self, plan: Network, where: str) -> list[Problem]:
        """Return problems with names in the error that the plan lacks."""
        raise NotImplementedError

    def _without_readings(self, plan: Network) -> str:
        """Return the reason why the error changes no reading; empty if it changes readings."""
        raise NotImplementedError

    def make_true(self, true: Network) -> None:
        """Set the true values of a plan, from which the readings are made."""

    def shift(self, camera: str, centred: Array) -> Array:
        """Return the errors (n, 2), mm, at image coordinates about the principal point (n, 2)."""
        return np.zeros_like(centred)


@dataclass(frozen=True)
class InImages(Systematic):
    """Base of systematic errors of image coordinates."""

    camera: str = ""
    """Camera of the photos with the error; empty: all cameras."""

    def _not_there(self, plan: Network, where: str) -> list[Problem]:
        """Return what the plan does not have."""
        if self.camera in ("", *plan.cameras):
            return []
        what = unknown_name("camera", self.camera, plan.cameras)
        return [Problem(what, path_of(where, "camera"))]

    def _without_readings(self, plan: Network) -> str:
        """Return a message if the plan has no image points."""
        photo, _, _, _ = plan.images.columns()
        cameras = np.array([f.camera for f in plan.photos.values()])
        if photo.size and (not self.camera or np.any(cameras[photo] == self.camera)):
            return ""
        whose = f"camera {self.camera!r}" if self.camera else "the network"
        return f"{whose} has no image points"


@dataclass(frozen=True)
class LensDistortion(InImages):
    """Radial distortion: image points lie δ(r) farther from the principal point.

    Either δ = Σ cᵢ (r/R)^(2i+1), i = 0, 1, 2 …, with ``coefficients_um`` and R = ``radius_mm``;
    or a curve through (0, 0) and the points of a table, monotone between them (PCHIP) and
    constant beyond the last point.
    """

    kind = "lens_distortion"
    coefficients_um: tuple[float, ...] = ()
    """Coefficients c₀, c₁ …, µm."""
    radius_mm: float = number(100.0, above=0)
    """Reference radius R, mm."""
    radii_mm: tuple[float, ...] = number((), above=0)
    """Increasing radii of the table, mm."""
    distortion_um: tuple[float, ...] = ()
    """Distortion at these radii, µm."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        if bool(self.coefficients_um) == bool(self.radii_mm):
            found.append(
                Problem(
                    "give either coefficients_um or radii_mm with distortion_um",
                    path_of(where, "coefficients_um"),
                )
            )
        if len(self.radii_mm) != len(self.distortion_um):
            what = f"has {len(self.distortion_um)} values, radii_mm has {len(self.radii_mm)}"
            found.append(Problem(what, path_of(where, "distortion_um")))
        if any(a >= b for a, b in zip(self.radii_mm, self.radii_mm[1:], strict=False)):
            found.append(Problem("must rise", path_of(where, "radii_mm")))
        return found

    @property
    def is_zero(self) -> bool:
        """Whether the size of the error is zero."""
        return not any((*self.coefficients_um, *self.distortion_um))

    def curve(self, r: Array) -> Array:
        """Return δ (n,), mm, at radii r (n,), mm."""
        if self.coefficients_um:
            t = r / self.radius_mm
            terms = [c * t ** (2 * i + 1) for i, c in enumerate(self.coefficients_um)]
            return np.asarray(sum(terms) * MICROMETRE)
        at = np.array([0.0, *self.radii_mm])
        interpolate = PchipInterpolator(at, np.array([0.0, *self.distortion_um]))
        return np.asarray(interpolate(np.minimum(r, at[-1])) * MICROMETRE)

    def shift(self, camera: str, centred: Array) -> Array:
        """Return what is added to image coordinates."""
        r = np.linalg.norm(centred, axis=1)
        part = self.curve(r) / np.where(r > 0, r, 1.0)
        return np.asarray(centred * part[:, None])


@dataclass(frozen=True)
class AffineFilm(InImages):
    """Affine deformation of the film: δx = (scale x + shear y) / edge.

    ``scale_um`` is the difference of the scales of x and y, ``shear_um`` the deviation of the
    axes from a right angle; both are displacements at ``edge_mm`` from the centre.
    """

    kind = "affine_film"
    scale_um: float = 0.0
    """Displacement in x at x = edge, µm."""
    shear_um: float = 0.0
    """Displacement in x at y = edge, µm."""
    edge_mm: float = number(115.0, above=0)
    """Distance from the centre at which these displacements occur, mm."""

    @property
    def is_zero(self) -> bool:
        """Whether the size of the error is zero."""
        return self.scale_um == self.shear_um == 0.0

    def shift(self, camera: str, centred: Array) -> Array:
        """Return what is added to image coordinates."""
        x = centred @ [self.scale_um, self.shear_um] * MICROMETRE / self.edge_mm
        return np.column_stack([x, np.zeros_like(x)])


@dataclass(frozen=True)
class Refraction(Systematic):
    """A coefficient of refraction that differs from the assumed one."""

    kind = "refraction"
    difference: float = number(0.1, least=-2, most=2)
    """True − assumed κ."""
    group: str = ""
    """Group of refraction; empty: the coefficient of the network."""

    @property
    def is_zero(self) -> bool:
        """Whether the size of the error is zero."""
        return self.difference == 0.0

    def _not_there(self, plan: Network, where: str) -> list[Problem]:
        """Return what the plan does not have."""
        if self.group in ("", *plan.refractions):
            return []
        what = unknown_name("refraction group", self.group, plan.refractions)
        return [Problem(what, path_of(where, "group"))]

    def _without_readings(self, plan: Network) -> str:
        """Return a message if the plan has no zenith and no vertical angles."""
        for o in of_quantities(plan.observations.values(), *INCLINATION_QUANTITIES):
            group = REFRACTION_OF_THE_NETWORK if o.refraction is None else o.refraction
            if group == self.group:
                return ""
        return "the network has no zenith and no vertical angles of this group"

    def make_true(self, true: Network) -> None:
        """Set the true coefficient."""
        there = true.refractions.get(self.group, Parameter((0.0,), (True,), (np.inf,)))
        value = there.values[0] + self.difference
        true.refractions[self.group] = replace(there, values=(value,))


@dataclass(frozen=True)
class TapeCalibration(Systematic):
    """Error of distances: the reading is (1 + ppm·10⁻⁶) S + zero."""

    kind = "tape"
    ppm: float = 0.0
    """Scale error, 1e-6."""
    zero_mm: float = 0.0
    """Zero constant, mm."""
    distance_meter: str = ""
    """Distance meter of the distances with the error; empty: all distances."""

    @property
    def is_zero(self) -> bool:
        """Whether the size of the error is zero."""
        return self.ppm == self.zero_mm == 0.0

    def _not_there(self, plan: Network, where: str) -> list[Problem]:
        """Return what the plan does not have."""
        if self.distance_meter in ("", *plan.distance_meters):
            return []
        what = unknown_name("distance meter", self.distance_meter, plan.distance_meters)
        return [Problem(what, path_of(where, "distance_meter"))]

    def _without_readings(self, plan: Network) -> str:
        """Return a message if the plan has no distances."""
        for o in of_quantities(plan.observations.values(), *DISTANCE_QUANTITIES):
            if self.distance_meter in ("", o.instrument):
                return ""
        whose = f"distance meter {self.distance_meter!r}" if self.distance_meter else "the network"
        return f"{whose} has no distances"

    def make_true(self, true: Network) -> None:
        """Set scale and zero constant."""
        if not self.distance_meter:
            for ident, o in true.observations.items():
                if (
                    o.record.quantity in DISTANCE_QUANTITIES
                    and getattr(o, "instrument", "") is None
                ):
                    if TRUE_SCALE not in true.distance_meters:
                        true.set_distance_meter(TRUE_SCALE)
                    changed: dict[str, Any] = {"instrument": TRUE_SCALE}
                    true.observations[ident] = replace(o, **changed)
        for name, there in true.distance_meters.items():
            if self.distance_meter in ("", name):
                scale, zero = there.values
                values = (scale + self.ppm * PPM, zero + self.zero_mm * MILLIMETRE)
                true.distance_meters[name] = replace(there, values=values)
