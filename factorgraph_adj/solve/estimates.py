"""Estimates with σ: poses, cameras, geodetic, other unknowns; observation table; as a network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, overload

import numpy as np

from ..entities import parameter_name
from ..errors import InputError, unknown_name
from ..frames import Frame
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..models.unknown_registry import UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import Network
from ..rotation import omega_phi_kappa
from ..types import Array


def kind_and_name(variable: object) -> tuple[VariableKind, str]:
    """Return a variable that is given as a pair.

    Raises:
        InputError: it is something else, such as a name alone.
    """
    match variable:
        case (str() as kind, str() as name):
            return kind, name
    raise InputError(
        f"a variable is a pair of kind and name, such as ('point', 'P1'), not {variable!r}; two "
        "variables are two pairs"
    )


def network_with_values(network: Network, unknowns: Unknowns, state: State) -> Network:
    """Return a network with the values of a state as given values; what is held stays held.

    A camera with a calibration for each photo keeps its given values: a network has one set of
    values for it.

    Args:
        network: the network; it is not changed.
        unknowns: its unknowns.
        state: values of all of them.
    """
    out = network.copy()
    points, poses = unknowns["point"].number, unknowns["pose"].number
    out.points = {
        n: replace(p, coordinates=tuple(state["point"][points[n]].tolist()))
        for n, p in network.points.items()
    }
    for name, photo in network.photos.items():
        stored = state["pose"][poses[name]]
        at = tuple(stored[9:].tolist())
        rotation = stored[:9].reshape(3, 3).copy()
        out.photos[name] = replace(photo, position=at, rotation=rotation)
    calibrations = unknowns["calibration"].number
    for name, camera in network.cameras.items():
        if name in calibrations and not camera.per_photo:
            values = unknowns.given(state, "calibration", calibrations[name])
            out.cameras[name] = replace(camera, values=tuple(values.tolist()))
    for kind in parameter_kinds():
        numbers = unknowns[kind.name].number
        for key, parameter in network.parameters.get(kind.name, {}).items():
            values = unknowns.shown(state, kind.name, numbers[parameter_name(key)])
            out.of_kind(kind.name)[key] = replace(parameter, values=tuple(values.tolist()))
    return out


class EstimatedNetwork(Protocol):
    """A network with adjusted values and the covariances of its points."""

    @property
    def network(self) -> Network:
        """The network."""
        ...

    @property
    def equations(self) -> Equations:
        """Its observation equations."""
        ...

    @property
    def state(self) -> State:
        """Values of all variables."""
        ...

    @property
    def point_covariances(self) -> Array:
        """Covariances of all points, (n, 3, 3)."""
        ...


class EstimatedNetworkWithPhotos(EstimatedNetwork, Protocol):
    """The same with the covariances of its photos."""

    def pose_covariance(self, photo: str) -> Array:
        """Return the covariance of a photo, (6, 6)."""
        ...


@dataclass(frozen=True)
class Estimate:
    """A small vector unknown and its precision."""

    names: tuple[str, ...]
    """Names of the components."""
    values: Array
    """Estimates, SI."""
    sigmas: Array
    """Standard deviations of the estimates; zero where they are held."""
    correlation: Array
    """Correlations; zero with held components."""

    def __getitem__(self, name: str) -> float:
        """Return the estimate of one component."""
        return float(self.values[self._index(name)])

    def sigma(self, name: str) -> float:
        """Return the standard deviation of one component."""
        return float(self.sigmas[self._index(name)])

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise InputError(unknown_name("component", name, self.names))
        return self.names.index(name)


def estimate(
    unknowns: Unknowns, state: State, kind: VariableKind, number: int, tangent: Array
) -> Estimate:
    """Return one unknown with the precision of its values.

    Args:
        unknowns: all unknowns.
        state: their values.
        kind: its kind.
        number: its number.
        tangent: covariance of its columns, (k, k); those of a rotation are turns about its axes.
    """
    covariance = unknowns.covariance_of_given(state, kind, number, tangent)
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(sigmas > 0, sigmas, 1.0)
    return Estimate(
        unknowns.component_names(kind, number),
        unknowns.shown(state, kind, number),
        sigmas,
        covariance / np.outer(safe, safe),
    )


@dataclass(frozen=True)
class CalibrationEstimate(Estimate):
    """Calibration of a camera, in image units."""

    unit: str = "mm"
    """Unit of image coordinates."""


@dataclass(frozen=True)
class PoseEstimate:
    """Exterior orientation of a photo."""

    position: Array
    """Projection centre, (3,) metres."""
    rotation: Array
    """world_R_camera (3, 3), camera axes x right, y down, z forward."""
    sigmas: Array
    """Standard deviations of rotations about the camera's axes (rad) and X, Y, Z (m), (6,)."""

    @property
    def omega_phi_kappa(self) -> Array:
        """ω, φ, κ, radians."""
        return np.array(omega_phi_kappa(self.rotation))


@dataclass(frozen=True, eq=False)
class GeodeticCoordinates:
    """Geodetic coordinates of n points on the ellipsoid of their frame."""

    latitude: Array
    """φ, (n,) radians, north positive."""
    longitude: Array
    """λ, (n,) radians in (−π, π], east positive."""
    height: Array
    """Ellipsoidal height, (n,) metres."""
    sigma: Array
    """Standard deviations along east, north and up at each point, (n, 3) metres."""


def geodetic_coordinates(
    frame: Frame, xyz: Array, covariances: Array
) -> GeodeticCoordinates | None:
    """Return geodetic coordinates of positions; None for a local frame, which has no ellipsoid.

    σ² = diag(E Σ Eᵀ), E the rows east, north, up of the ellipsoid's normal at the point.

    Args:
        frame: frame of the network.
        xyz: positions (n, 3), metres.
        covariances: their covariances Σ, (n, 3, 3) metres².
    """
    found = frame.geodetic(xyz)
    if found is None:
        return None
    enu = frame.basis(xyz, np.zeros((len(xyz), 2))).enu
    variances = np.einsum("nai,nij,naj->na", enu, covariances, enu)
    return GeodeticCoordinates(*found, np.sqrt(np.maximum(variances, 0.0)))


class AdjustedNetwork(EstimatedNetworkWithPhotos, Protocol):
    """What the columns are taken from."""

    def number(self, kind: VariableKind, name: str) -> int:
        """Return the number of a variable."""
        ...

    def variable_covariance(
        self, a: tuple[VariableKind, str], b: tuple[VariableKind, str] | None = None
    ) -> Array:
        """Return the covariance between two variables."""
        ...


def unknown_arrays(solution: AdjustedNetwork) -> dict[str, np.ndarray[Any, Any]]:
    """Return ``kind``, ``name``, ``component``, ``value``, ``sigma``, ``held`` of other unknowns.

    These are calibrations and all that is stated or found besides points and photos.
    """
    unknowns = solution.equations.unknowns
    rows: list[tuple[str, str, str, float, float, bool]] = []
    for kind in UNKNOWNS:
        if kind in ("point", "pose"):
            continue
        table = unknowns[kind]
        for number, name in enumerate(table.names):
            values = unknowns.shown(solution.state, kind, number)
            tangent = solution.variable_covariance((kind, name))
            covariance = unknowns.covariance_of_given(solution.state, kind, number, tangent)
            sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
            names = unknowns.component_names(kind, number)
            held = ~table.free[number, : len(names)]
            for cells in zip(names, values, sigma, held, strict=True):
                component, value, s, is_held = cells
                rows.append((kind, name, component, float(value), float(s), bool(is_held)))
    header = ("kind", "name", "component", "value", "sigma", "held")
    types = (object, object, object, float, float, bool)
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    return {n: np.array(c, dtype=t) for n, c, t in zip(header, columns, types, strict=True)}


@dataclass(frozen=True, slots=True)
class ObservationRecord:
    """One scalar observation after the adjustment, SI or image units."""

    id: str
    """Id of the observation."""
    kind: str
    """Kind of the observation."""
    component: str
    """Component of the observation, empty for scalar kinds: x, y; an axis of control or a weighted
    point; a parameter of a weighted calibration."""
    observed: float
    """Observed value."""
    residual: float
    """Computed − observed."""
    sigma: float
    """A-priori standard deviation."""


class ObservationTable(Sequence[ObservationRecord]):
    """A sequence of records of all scalar observations, including weighted unknowns.

    ``residuals`` and ``sigmas`` are arrays in the same order.
    """

    def __init__(self, equations: Equations, residuals: Array) -> None:
        """Describe the rows of ``equations``."""
        self._equations = equations
        self.residuals = residuals
        self.sigmas = equations.sigmas()

    def __len__(self) -> int:
        return len(self.residuals)

    @overload
    def __getitem__(self, row: int) -> ObservationRecord: ...
    @overload
    def __getitem__(self, row: slice) -> list[ObservationRecord]: ...
    def __getitem__(self, row: int | slice) -> ObservationRecord | list[ObservationRecord]:
        """Return one record, or several."""
        if isinstance(row, slice):
            return [self[i] for i in range(*row.indices(len(self)))]
        if row < 0:
            row += len(self)
        for block in self._equations.blocks:
            if block.rows.start <= row < block.rows.stop:
                i, c = divmod(row - block.first_row, block.dimension)
                return ObservationRecord(
                    block.ids[i],
                    block.kind,
                    block.component(i, c),
                    float(block.observed[i, c]),
                    float(self.residuals[row]),
                    float(self.sigmas[row]),
                )
        raise IndexError(row)

    def __iter__(self) -> Iterator[ObservationRecord]:
        return (self[i] for i in range(len(self)))

    def row(self, id: str, component: str | None = None) -> int:
        """Return the row of an observation by its id.

        Args:
            id: id of the observation; ``photo/point`` for image points.
            component: component such as ``x``; needed if the observation has several.

        Raises:
            InputError: no observation has this id, or it has several components and none is named.
        """
        rows = self._rows.get(id, [])
        if not rows:
            raise InputError(unknown_name("observation", id, self._rows))
        found = [r for r in rows if component is None or self[r].component == component]
        if len(found) != 1:
            names = ", ".join(self[r].component or f"row {r}" for r in rows)
            raise InputError(
                f"observation {id!r} has the components {names}: name one of them with component="
            )
        return found[0]

    @cached_property
    def _rows(self) -> dict[str, list[int]]:
        out: dict[str, list[int]] = {}
        for row, ident in enumerate(self.ids):
            out.setdefault(ident, []).append(row)
        return out

    @cached_property
    def kinds(self) -> list[str]:
        """Kind of each row."""
        return [b.kind for b in self._equations.blocks for _ in range(b.observed.size)]

    @cached_property
    def ids(self) -> list[str]:
        """Id of each row."""
        return [
            b.ids[i] for b in self._equations.blocks for i in range(b.n) for _ in range(b.dimension)
        ]

    @cached_property
    def components(self) -> list[str]:
        """Component of each row, empty for scalar kinds."""
        return [
            b.component(i, c)
            for b in self._equations.blocks
            for i in range(b.n)
            for c in range(b.dimension)
        ]

    @cached_property
    def normalised(self) -> Array:
        """Residuals divided by their a-priori standard deviations."""
        return self.residuals / self.sigmas
