"""Unknowns that a network states by kind: orientations, refraction, frames, mounts, profiles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from ..control_characters import refuse_control_characters
from ..entities import (
    REFRACTION_OF_THE_NETWORK,
    Key,
    Parameter,
    Point,
    parameter,
    parameter_name,
)
from ..errors import InputError, Problem
from ..models.deformation import HIGHEST
from ..models.unknown_registry import VariableKind, unknown_kind
from .arcs import Arcs
from .composite_unknowns import OfKind, StatedShapes
from .construction import (
    checked_frame,
    free_components,
    refuse_duplicate,
    refuse_wrong_parts,
    required,
)
from .refracted_images import RefractedImages


class StatedUnknowns(StatedShapes, RefractedImages, Arcs):
    """Part of a network: its unknowns besides points, photos and cameras, by kind and name."""

    points: dict[str, Point]
    """Points by name."""
    parameters: dict[VariableKind, dict[Any, Parameter]]
    """Unknowns by kind and name."""

    def set_unknown(
        self,
        kind: VariableKind,
        key: Key,
        values: Sequence[float] | None = None,
        *,
        fixed: bool | Iterable[str] = False,
        sigma: float | Sequence[float] | Mapping[str, float] | None = None,
    ) -> None:
        """State an unknown of any kind; its components are free unless held or weighted.

        Args:
            kind: name of the kind, see `factorgraph_adj.models.unknown_registry.UNKNOWNS`.
                ``photo_motion``: velocity of the projection centre (x_t …, m/s, axes of the
                network) and angular velocity (rx_t …, rad/s, camera axes x right, y down, z
                forward), at the middle row; 12 or 18 values have terms of t² and t³ too.
            key: name of the unknown, or several names such as station and set.
            values: values of the components, SI; None: the start values of the kind.
            fixed: whether all components are held, or the names of the held components.
            sigma: standard deviations of weighted components, SI: one for all, one for each, or
                some by name.

        Raises:
            InputError: an unknown kind, point or photo, a motion of a photo whose camera has no
                readout time, a value that is not finite, a wrong number of values, or a component
                that is both held and weighted.
        """
        record = unknown_kind(kind)
        if record.table is None:
            raise InputError(f"a {record.noun} is no parameter: use add_{record.noun}")
        keys = (key,) if isinstance(key, str) or not isinstance(key, tuple) else key
        if len(keys) != len(record.table.keys) or not all(isinstance(k, str) for k in keys):
            what = " and ".join(record.table.keys)
            raise InputError(Problem(f"it is named by {what}, not by {key!r}", record.noun))
        refuse_control_characters(keys, record.noun)
        where = f"{record.noun} {parameter_name(key)!r}"
        if record.at_point:
            required(keys[0], self.points, "point", where)
        if record.in_photo:
            self.check_readout(keys[0], where)
        start = [c.start for c in record.components[: record.usual]] if values is None else values
        self.of_kind(kind)[key] = parameter(record, start, fixed, sigma, where)

    def of_kind(self, kind: VariableKind) -> dict[Any, Parameter]:
        """Return the stated unknowns of a kind by key."""
        return self.parameters.setdefault(kind, {})

    def set_orientation(
        self,
        station: str,
        *,
        set: str = "1",
        value: float,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the orientation unknown of a set of directions, radians.

        Without this call the unknown is free; its start value is computed from the directions.
        """
        self.set_unknown("orientation", (station, set), (value,), fixed=fixed, sigma=sigma)

    def set_refraction(
        self,
        group: str = REFRACTION_OF_THE_NETWORK,
        *,
        value: float = 0.13,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the coefficient of refraction κ of a group; free unless held or weighted.

        The group of the network is that of observations without one; not stated, its κ is 0, held.
        """
        self.set_unknown("refraction", group, (value,), fixed=fixed, sigma=sigma)

    def set_vertical(
        self,
        station: str,
        *,
        xi: float = 0.0,
        eta: float = 0.0,
        sigma: float | Sequence[float] | None = None,
        fixed: bool = False,
    ) -> None:
        """State the deflection of the vertical of a station; free unless held or weighted.

        Args:
            station: the point.
            xi: ξ = Φ − φ, radians, north positive.
            eta: η = (Λ − λ) cosφ, radians, east positive.
            sigma: standard deviations, radians.
            fixed: whether ξ and η are held. A station without this call has ξ = η = 0, held.
        """
        self.set_unknown("vertical", station, (xi, eta), fixed=fixed, sigma=sigma)

    def set_distance_meter(
        self,
        name: str,
        *,
        scale: float = 0.0,
        zero: float = 0.0,
        sigma_scale: float | None = None,
        sigma_zero: float | None = None,
        free: Iterable[Literal["scale", "zero"]] = (),
    ) -> None:
        """State a distance meter: observed = (1 + scale) S + zero.

        Args:
            name: its name, as in ``instrument`` of the distances.
            scale: m, dimensionless (1e-6 is one ppm).
            zero: additive constant, metres.
            sigma_scale: standard deviation of a weighted scale.
            sigma_zero: standard deviation of a weighted constant, metres.
            free: components to estimate without a prior. Components that are neither free nor
                weighted are held.
        """
        asked = set(free)
        if not asked <= {"scale", "zero"}:
            where = f"distance meter {name!r}"
            raise InputError(Problem(f"free must be some of scale, zero, not {asked}", where))
        given = {"scale": sigma_scale, "zero": sigma_zero}
        sigma = {n: np.inf if s is None else s for n, s in given.items()}
        held = [n for n, s in sigma.items() if s == np.inf and n not in asked]
        self.set_unknown("edm", name, (scale, zero), fixed=held, sigma=sigma)

    def add_frame(
        self,
        name: str,
        *,
        free: Iterable[str] = ("rx", "ry", "rz", "x", "y", "z"),
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
        origin: str | Sequence[float] = (0.0, 0.0, 0.0),
        level: bool = False,
    ) -> None:
        """State a frame of its own: of a model, a scanner or tracker station, a shape.

        Coordinates in the frame are q = e^{−ℓ} Rᵀ E (X − O) − c, see
        `factorgraph_adj.models.sub_frame`. Its components are the rotation vector rx, ry, rz of R
        (radians, frame → object), the offset x, y, z = c (unit of the frame) and ln_scale = ℓ.

        Args:
            name: its name.
            free: components to estimate without a prior, also by the words ``rotation``, ``offset``
                and ``scale``; those that are neither free nor weighted are held. Steps of a
                rotation are about the axes of the frame: with rx and ry held its z axis keeps its
                direction. rz alone is held where nothing observes the turn about z, as with shapes
                of revolution, or where rx and ry are small; rx or ry alone cannot be held.
            values: values of components by name, SI; a held or weighted component without one has
                0; a free one without one is computed from common points.
            sigma: standard deviations of weighted components by name; of the rotations, rx and ry
                (the tilts, about the axes of the frame) or all three.
            origin: O, the name of a point, such as the station of a scanner, whose offset is then
                held unless it is free; or constant coordinates, metres. Choose them near the
                middle of the points of the frame: far away, offset and rotation have nearly the
                same effect.
            level: whether R counts from the horizon (east, north, up) at O, as that of a levelled
                instrument does.

        Raises:
            InputError: a frame of this name is there, an unknown point or component, numbers that
                are not finite, a component that is both free and weighted.
        """
        refuse_duplicate(name, self.of_kind("frame"), "frame")
        self.of_kind("frame")[name] = checked_frame(
            name, free, values or {}, sigma or {}, origin, level, self.points
        )

    def set_mount(
        self,
        name: str,
        *,
        free: Iterable[str] = (),
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
    ) -> None:
        """State a mount: how an instrument sits on what carries it.

        A boresight, a lever arm, a camera of a rig. Its components are the rotation vector rx, ry,
        rz of B (radians, instrument → carrier) and the arm x, y, z = b (metres, in axes of the
        carrier; those of a camera are photogrammetric: x right, y up, z backwards).

        Args:
            name: its name.
            free: components to estimate without a prior; those that are neither free nor weighted
                are held. Steps of the rotation are about the axes of the instrument.
            values: values of components by name, SI; others are 0.
            sigma: standard deviations of weighted components by name; of the rotations, rx and ry
                or all three.

        Raises:
            InputError: an unknown component, numbers that are not finite, a component that is both
                free and weighted.
        """
        self._set_parts("mount", name, free, values or {}, sigma or {})

    def set_drift(
        self,
        name: str,
        *,
        free: Iterable[str] = (),
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
    ) -> None:
        """State the shift and drift of a strip, flight or profile: s + d t + e t².

        Its components are s = x, y, z (metres), d = x_t, y_t, z_t (metres per unit of t) and e =
        x_tt, y_tt, z_tt. The unit of t is that in which the observations state it: seconds,
        exposures, or kilometres along the strip. Where t counts from the middle of the strip,
        shift and drift are nearly uncorrelated.

        Args:
            name: its name.
            free: components to estimate without a prior; those that are neither free nor weighted
                are held.
            values: values of components by name, SI; others are 0.
            sigma: standard deviations of weighted components by name.

        Raises:
            InputError: as `set_mount`.
        """
        self._set_parts("drift", name, free, values or {}, sigma or {})

    def set_attitude_drift(
        self,
        name: str,
        *,
        free: Iterable[str] = (),
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
    ) -> None:
        """State the drift of observed attitudes of a strip or flight: ψ = ψ₀ + ψ₁ t, radians.

        Its components are ψ₀ = rx, ry, rz and ψ₁ = rx_t, ry_t, rz_t (per unit of t): a rotation
        vector about east, north and up at the photo, by which the axes of an inertial platform are
        turned: the true attitude is Exp(ψ) times the observed one. The unit of t is that in which
        the observations state it.

        Args:
            name: its name.
            free: components to estimate without a prior; those that are neither free nor weighted
                are held.
            values: values of components by name, radians; others are 0.
            sigma: standard deviations of weighted components by name.

        Raises:
            InputError: as `set_mount`.
        """
        self._set_parts("attitude_drift", name, free, values or {}, sigma or {})

    def set_shutter(
        self, name: str, *, error: float = 0.0, sigma: float | None = None, fixed: bool = False
    ) -> None:
        """State the time error of a shutter, seconds: recorded minus true time of exposure.

        This is not the rolling shutter, see ``readout`` of `add_camera` and ``photo_motion`` of
        `set_unknown`.

        It is free unless held or weighted. With the velocity Ẋ of the antenna, the position that
        belongs to the recorded time is ahead by Ẋ times the error: one of 10 ms is 0.6 m at 60 m/s.
        """
        self.set_unknown("shutter", name, (error,), fixed=fixed, sigma=sigma)

    def set_size(
        self,
        name: str,
        value: float | None = None,
        *,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State an unknown length, metres: a radius, a sag, an offset that observations share.

        It is free unless held or weighted; a free one without a value is computed.
        """
        self._set_one("size", name, value, sigma, fixed)

    def set_level(
        self,
        name: str,
        value: float | None = None,
        *,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the height of a level surface, metres: of a lake, or of the water of a tube.

        It is free unless held or weighted; a free one without a value is computed.
        """
        self._set_one("level", name, value, sigma, fixed)

    def set_polynomial(
        self,
        name: str,
        *,
        plan: int | None = 2,
        height: Iterable[str] = ("z", "z_x", "z_y", "z_xx"),
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
    ) -> None:
        """State the polynomial by which a strip bends, see `factorgraph_adj.models.deformation`.

        Args:
            name: name of the strip.
            plan: degree in plan, up to 4: a0, b0 to an, bn are free; None: none of them.
            height: free terms of the height, such as ``z_xxy`` for along² across.
            values: values of coefficients by name, metres; others are 0.
            sigma: standard deviations of weighted coefficients by name.

        Raises:
            InputError: a degree that is too high, an unknown term, numbers that are not finite.
        """
        given, weights = dict(values or {}), dict(sigma or {})
        if plan is not None and not 0 <= plan <= HIGHEST:
            what = f"plan must be a degree from 0 to {HIGHEST} or none, not {plan}"
            raise InputError(Problem(what, f"strip polynomial {name!r}"))
        degrees = range(0 if plan is None else plan + 1)
        terms = [*(f"{c}{j}" for j in degrees for c in "ab"), *height]
        free = [n for n in terms if n not in weights]
        self._set_parts("polynomial", name, free, given, weights, first=True)

    def set_model_deformation(
        self,
        name: str,
        *,
        free: Iterable[str] = (),
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
    ) -> None:
        """State a deformation that models share, see `factorgraph_adj.models.deformation`.

        Args:
            name: its name, to which observations refer.
            free: components to estimate without a prior; those that are neither free nor weighted
                are held.
            values: values of components by name, unit of the frames; others are 0.
            sigma: standard deviations of weighted components by name: with the value 0 they say how
                large a deformation may be.

        Raises:
            InputError: as `set_mount`.
        """
        self._set_parts("model_deformation", name, free, values or {}, sigma or {})

    def set_profile(
        self,
        name: str,
        *,
        free: Iterable[str] | None = None,
        values: Mapping[str, float] | None = None,
        sigma: Mapping[str, float] | None = None,
    ) -> None:
        """State the height profile of a statoscope, barometer or airborne profile recorder.

        Its reading at the height h is (1 + s) (h − a − b t − c t²): a (metres) is the height of the
        surface from which it reads, b and c (metres per unit of t and of t²) how the surface rises
        along the profile, s the scale of its readings. The components are height = a, height_t =
        b, height_tt = c and scale = s. The unit of t is that of the observations, such as
        kilometres along the strip; where t counts from the middle of the profile, a and b are
        nearly uncorrelated. The slope of a surface of equal pressure is known from the wind, see
        `factorgraph_adj.atmosphere.pressure_slope`.

        Args:
            name: its name.
            free: components to estimate without a prior; None: the height, unless it is weighted.
                Those that are neither free nor weighted are held.
            values: values of components by name, SI; others are 0.
            sigma: standard deviations of weighted components by name.

        Raises:
            InputError: as `set_mount`.
        """
        if free is None:
            free = () if "height" in (sigma or {}) else ("height",)
        self._set_parts("profile", name, free, values or {}, sigma or {})

    def set_gyro(
        self,
        name: str,
        value: float | None = None,
        *,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the constant E of a gyrotheodolite, radians: azimuth = reading + E.

        It is free unless held or weighted; a free one without a value is computed.
        """
        self._set_one("gyro", name, value, sigma, fixed)

    def _set_one(
        self, kind: VariableKind, name: str, value: float | None, sigma: float | None, fixed: bool
    ) -> None:
        """State an unknown of one component; NaN represents a value to be found."""
        if value is None and (fixed or sigma is not None):
            where = f"{unknown_kind(kind).noun} {name!r}"
            raise InputError(Problem("it is held or weighted, and has no value", where))
        self.set_unknown(
            kind, name, (np.nan if value is None else value,), fixed=fixed, sigma=sigma
        )

    def _set_parts(
        self,
        kind: VariableKind,
        name: str,
        free: Iterable[str],
        values: Mapping[str, float],
        sigma: Mapping[str, float],
        *,
        first: bool = False,
    ) -> None:
        """State an unknown whose components are held unless they are free or weighted.

        With ``first`` it has only the first components, up to the last one that is named.
        """
        record = unknown_kind(kind)
        where, names = f"{record.noun} {name!r}", record.names()
        wanted = free_components(record, free, where)
        refuse_wrong_parts(names, wanted, values, sigma, where)
        if first:
            named = [names.index(n) for n in (*wanted, *values, *sigma)]
            names = names[: 1 + max(named, default=0)]
        held = [n for n in names if n not in wanted and n not in sigma]
        given = [float(values.get(n, 0.0)) for n in names]
        self.set_unknown(kind, name, given, fixed=held, sigma=sigma)

    frames = OfKind("frame")
    """Frames by name."""
    orientations = OfKind("orientation")
    """Orientation unknowns by station and set."""
    refractions = OfKind("refraction")
    """Coefficients of refraction by group."""
    verticals = OfKind("vertical")
    """Deflections of the vertical by station."""
    distance_meters = OfKind("edm")
    """Scales and zero constants by distance meter."""
    mounts = OfKind("mount")
    """Rotations and arms by mount."""
    drifts = OfKind("drift")
    """Shifts and drifts by strip, flight or profile."""
    attitude_drifts = OfKind("attitude_drift")
    """Turns and their rates by strip or flight."""
    shutters = OfKind("shutter")
    """Time errors by shutter."""
    sizes = OfKind("size")
    """Unknown lengths by name."""
    levels = OfKind("level")
    """Heights of level surfaces by name."""
    polynomials = OfKind("polynomial")
    """Coefficients by strip."""
    model_deformations = OfKind("model_deformation")
    """Deformations that groups of models share, by name."""
    profiles = OfKind("profile")
    """Height profiles of statoscopes, barometers and profile recorders by name."""
    gyros = OfKind("gyro")
    """Constants of gyrotheodolites by name."""
