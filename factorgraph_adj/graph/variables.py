"""The unknowns as arrays: columns, start values, steps, component names, calibration scales.

Every variable that has a free component owns consecutive columns. A held component keeps its
column, whose partials and step are zero. Completely held variables own no columns and are
constants of the observations.

Raw powers of millimetres or pixels give columns whose norms differ by a factor of 10¹⁰, on which
GTSAM's optimisers stop at once and its Cholesky finds no pivots. In a GTSAM graph a calibration is
therefore the vector of its given values divided by scales.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import chain
from typing import TypeAlias

import numpy as np

from ..entities import Camera, Key, Parameter, parameter_name
from ..errors import AdjustmentError
from ..models.base import DegenerateError
from ..models.inverse_lens import rough_rays
from ..models.unknown_registry import ROTATION, UNKNOWNS, UnknownKind, VariableKind
from ..network.network import Network
from ..types import Array, Index, Mask
from .interior_orientations import start_interior_orientations

HALF_FORMAT = 0.5
"""Half of the format, relative to the principal distance, where no format is stated."""
RASTER_POINTS = 9
"""Number of image points along each axis of the format at which partials are compared."""
State: TypeAlias = dict[VariableKind, Array]
"""Values of all variables, (n, width) for each kind; a pose has 9 of rotation and 3 of centre."""
MaskState: TypeAlias = dict[VariableKind, Mask]
"""Flags of the values of a state, with the shapes of the state."""
DEFAULT = ""
"""Name of the constant of a kind, for observations that name no unknown of that kind."""


def calibration_scales(camera: Camera) -> Array:
    """Return the scale s of each calibration parameter K, (k,): given value = s × value in a graph.

    s is the power of two, by which numbers are multiplied without rounding, that is nearest to

        r / max |∂v/∂K|

    over the format with half diagonal r: a change of one moves image points by about r, like a
    rotation of one radian. It depends on the camera's stated values alone, not on what was
    measured, so that a network keeps its scales while it grows.
    """
    k = np.array(camera.values, dtype=float)
    named = dict(zip(camera.lens.names, k.tolist(), strict=True))
    c = abs(named.get("c", 1.0)) or 1.0
    middle = np.array([named.get("x0", 0.0), named.get("y0", 0.0)])
    corners = camera.corners() or (middle - HALF_FORMAT * c, middle + HALF_FORMAT * c)
    x, y = (a.ravel() for a in np.meshgrid(*np.linspace(*corners, RASTER_POINTS).T))
    radius = float(np.hypot(x - middle[0], y - middle[1]).max())
    try:
        with np.errstate(all="ignore"):
            ray = rough_rays(camera.lens, np.stack([x, y], axis=1), k[None], middle, c)
            by_k = camera.lens.seen(ray, x, y, k[None]).by_k
            largest = [float(np.hypot(*np.broadcast_arrays(*pair)).max()) for pair in by_k]
    except (AdjustmentError, DegenerateError):
        return np.ones(len(k))
    out = np.ones(len(k))
    for j, most in enumerate(largest):
        if np.isfinite(most) and most > 0.0:
            out[j] = 2.0 ** np.round(np.log2(radius / most))
    return out


@dataclass(frozen=True)
class Variables:
    """All variables of one kind."""

    kind: VariableKind
    """Kind."""
    names: tuple[str, ...]
    """Names; an orientation is named station/set."""
    values: Array
    """Start values (n, width); NaN where unknown."""
    size: Index
    """Number of components of the tangent, (n,)."""
    free: Mask
    """Flags of free components, (n, largest size)."""
    sigma: Array
    """Standard deviations of weighted components, infinite for others, (n, largest size)."""
    offset: Index
    """First column of each variable, −1 for variables without columns."""

    @cached_property
    def number(self) -> dict[str, int]:
        """Number by name."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def has_column(self) -> Mask:
        """Which components have a column, (n, largest size)."""
        inside = np.arange(self.free.shape[1]) < self.size[:, None]
        return inside & (self.offset >= 0)[:, None]

    @cached_property
    def columns(self) -> slice:
        """Columns of the kind, component by component of one variable after another."""
        count = int(self.has_column.sum())
        first = int(self.offset[self.offset >= 0][0]) if count else 0
        return slice(first, first + count)

    @cached_property
    def _every(self) -> bool:
        return bool(self.has_column.all())

    def in_columns(self, values: Array) -> Array:
        """Return values of all components (n, largest size, …) in column order, (columns, …)."""
        if self._every:
            return values.reshape(-1, *values.shape[2:])
        return values[self.has_column]

    def of_columns(self, values: Array) -> Array:
        """Return values in column order (columns, …) by component, (n, largest size, …).

        They are zero where there is no column.
        """
        shape = (*self.free.shape, *values.shape[1:])
        if self._every:
            return values.reshape(shape)
        out = np.zeros(shape, dtype=values.dtype)
        out[self.has_column] = values
        return out


class Unknowns:
    """All variables of a network and their columns."""

    def __init__(self, network: Network) -> None:
        """Arrange the variables of ``network`` in tables and columns."""
        self.network = network
        tables: dict[VariableKind, Variables] = {}
        for kind in UNKNOWNS:
            names, values, sizes, free, sigma = _laid_out(network, kind)
            nowhere = np.full(len(names), -1, dtype=np.intp)
            tables[kind] = Variables(kind, tuple(names), values, sizes, free, sigma, nowhere)
        self._place(tables)

    def _place(self, tables: dict[VariableKind, Variables]) -> None:
        """Give columns to the variables that have a free component."""
        self.tables: dict[VariableKind, Variables] = {}
        first = 0
        for kind, table in tables.items():
            if not table.free.any():
                held = bool((table.offset < 0).all())
                nowhere = np.full(len(table.names), -1, dtype=np.intp)
                self.tables[kind] = table if held else replace(table, offset=nowhere)
                continue
            active = table.free.any(axis=1)
            columns = np.where(active, table.size, 0)
            offset = first + np.cumsum(columns) - columns
            placed = np.where(active, offset, -1).astype(np.intp)
            self.tables[kind] = replace(table, offset=placed)
            first += int(columns.sum())
        self.n_columns = first
        self.placed = tuple(k for k, t in self.tables.items() if (t.offset >= 0).any())
        """Kinds of which a variable has columns."""
        some = (self.tables[kind] for kind in self.placed)
        self.free = np.concatenate([np.zeros(0, dtype=bool), *(t.free[t.has_column] for t in some)])
        self.n_unknowns = int(self.free.sum())

    def freed(self, held: Mapping[VariableKind, Mask]) -> Unknowns:
        """Return the unknowns with held components free.

        Args:
            held: flags of the components to free, (n, largest size), by kind.
        """
        out = copy(self)
        out.__dict__.pop("size_at", None)
        out._place(
            {
                kind: replace(table, free=table.free | held[kind]) if kind in held else table
                for kind, table in self.tables.items()
            }
        )
        return out

    def holding(self, known: Callable[[VariableKind, str], bool]) -> Unknowns:
        """Return the unknowns with all components held of those that are known."""
        out = copy(self)
        out.__dict__.pop("size_at", None)
        tables = dict(self.tables)
        for kind, table in self.tables.items():
            if table.free.any():
                open_ = np.array([not known(kind, name) for name in table.names], dtype=bool)
                tables[kind] = replace(table, free=table.free & open_[:, None])
        out._place(tables)
        return out

    @cached_property
    def size_at(self) -> dict[int, int]:
        """Number of columns of each variable, by its first column."""
        return {
            first: size
            for table in self.tables.values()
            for first, size in zip(table.offset.tolist(), table.size.tolist(), strict=True)
            if first >= 0
        }

    def columns_of(self, first: Sequence[int]) -> Index:
        """Return the columns of variables, one after another, from their first columns."""
        return np.concatenate([np.arange(k, k + self.size_at[k]) for k in first])

    def __getitem__(self, kind: VariableKind) -> Variables:
        """Return the variables of one kind."""
        return self.tables[kind]

    def start(self) -> State:
        """Return the start values, NaN where unknown."""
        return {kind: table.values.copy() for kind, table in self.tables.items()}

    def starting_at(self, state: State) -> Unknowns:
        """Return the unknowns with the values of a state as start values, NaN where unknown."""
        out = copy(self)
        out.tables = {k: replace(table, values=state[k]) for k, table in self.tables.items()}
        return out

    def rough(self) -> MaskState:
        """Return which values of a state are approximate: free, and without a weight."""
        return {
            kind: UNKNOWNS[kind].in_stored_form(table.free & ~np.isfinite(table.sigma))
            for kind, table in self.tables.items()
        }

    def carried(
        self, into: State, source: Unknowns, values: State, *, where: MaskState | None = None
    ) -> State:
        """Return a state with the values of another network's state, by name.

        Args:
            into: state with the values of all other variables; this state is not changed.
            source: the other network's unknowns.
            values: the other network's state.
            where: flags of the values to take, with the shapes of ``into``; None: all.
        """
        out = dict(into)
        for kind, table in self.tables.items():
            other = source[kind]
            width = min(into[kind].shape[1], values[kind].shape[1])
            if table.names == other.names:
                mine = theirs = np.arange(len(table.names))
            else:
                common = [n for n in table.names if n in other.number]
                mine = np.array([table.number[n] for n in common], dtype=np.intp)
                theirs = np.array([other.number[n] for n in common], dtype=np.intp)
            filled = into[kind].copy()
            taken = values[kind][theirs, :width]
            if where is not None:
                taken = np.where(where[kind][mine, :width], taken, filled[mine, :width])
            filled[mine, :width] = taken
            out[kind] = filled
        return out

    def moving(self) -> MaskState:
        """Return which values of a state an adjustment may change."""
        return {
            kind: UNKNOWNS[kind].in_stored_form(table.free) for kind, table in self.tables.items()
        }

    def retract(self, state: State, step: Array) -> State:
        """Move a state by a step (n_columns,)."""
        moved = dict(state)
        for kind in self.placed:
            table = self.tables[kind]
            on = table.offset >= 0
            delta, retract = table.of_columns(step[table.columns]), UNKNOWNS[kind].retract
            if on.all():
                moved[kind] = retract(state[kind], delta)
            else:
                moved[kind] = state[kind].copy()
                moved[kind][on] = retract(state[kind][on], delta[on])
        return moved

    def spacing(self, state: State) -> Array:
        """Return the unit in the last digit of the values of all columns, (n_columns,).

        It is the distance of a value from the next floating-point number; that of an element 1 of
        a rotation matrix for the components of a rotation.
        """
        out = np.zeros(self.n_columns)
        for kind in self.placed:
            table = self.tables[kind]
            record, width = UNKNOWNS[kind], table.free.shape[1]
            values = state[kind][:, :width]
            if record.rotates:
                values = np.ones((len(values), width))
                values[:, 3:] = state[kind][:, ROTATION : ROTATION - 3 + width]
            out[table.columns] = np.spacing(np.abs(table.in_columns(values)))
        return out

    def columns(self, kind: VariableKind, number: int) -> Index:
        """Return the columns of one variable; empty for a completely held variable."""
        table = self.tables[kind]
        if table.offset[number] < 0:
            return np.zeros(0, dtype=np.intp)
        return np.asarray(table.offset[number] + np.arange(table.size[number]), dtype=np.intp)

    def component_names(self, kind: VariableKind, number: int) -> tuple[str, ...]:
        """Return the names of the components of one variable."""
        if kind == "calibration":
            name = self.tables[kind].names[number]
            camera = camera_of_calibration(self.network, name)
            return camera.lens.names
        return UNKNOWNS[kind].names(int(self.tables[kind].size[number]))

    def graph_scale(self, kind: VariableKind, number: int) -> Array | None:
        """Return what a value in a GTSAM graph is multiplied by to be a given one, (size,).

        None: the values are the given ones; those of calibrations are not, see `scales`.
        """
        if kind != "calibration":
            return None
        camera = camera_of_calibration(self.network, self.tables[kind].names[number])
        if camera not in self._scales:
            self._scales[camera] = calibration_scales(camera)
        return self._scales[camera]

    @cached_property
    def _scales(self) -> dict[Camera, Array]:
        return {}

    def given(self, state: State, kind: VariableKind, number: int) -> Array:
        """Return the values of one variable in the form of a network's input, (size,)."""
        stored = state[kind][number][None]
        return UNKNOWNS[kind].given(stored)[0, : self.tables[kind].size[number]].copy()

    def by_step(self, state: State, kind: VariableKind, number: int) -> Array:
        """Return the partials of `given` by the columns of one variable, (size, size)."""
        size = int(self.tables[kind].size[number])
        return UNKNOWNS[kind].by_step(state[kind][number][None])[0, :size, :size]

    def covariance_of_given(
        self, state: State, kind: VariableKind, number: int, covariance: Array
    ) -> Array:
        """Return the covariance of the `given` values from that of the columns, (size, size).

        The columns of a rotation are turns about its own axes; its values are a rotation vector.
        """
        if not UNKNOWNS[kind].rotates:
            return covariance
        by = self.by_step(state, kind, number)
        return np.asarray(by @ covariance @ by.T)

    def shown(self, state: State, kind: VariableKind, number: int) -> Array:
        """Return the values of one variable for results, (size,): orientations in [0, 2π)."""
        stored = state[kind][number][None]
        return UNKNOWNS[kind].shown(stored)[0, : self.tables[kind].size[number]].copy()

    def describe(self, column: int) -> tuple[VariableKind, str, str]:
        """Return kind, name and component of a column."""
        for kind, table in self.tables.items():
            inside = (
                (table.offset >= 0)
                & (table.offset <= column)
                & (column < table.offset + table.size)
            )
            if inside.any():
                number = int(np.flatnonzero(inside)[0])
                component = self.component_names(kind, number)[column - table.offset[number]]
                return kind, table.names[number], component
        raise IndexError(f"column {column} belongs to no variable")

    def owners(self, columns: Index) -> list[tuple[VariableKind, str]]:
        """Return kind and name of the variables to which columns belong, each once."""
        out = []
        for kind in self.placed:
            table = self.tables[kind]
            on = np.flatnonzero(table.offset >= 0)
            at = np.searchsorted(table.offset[on], columns, side="right") - 1
            number = on[np.maximum(at, 0)]
            inside = (at >= 0) & (columns < table.offset[number] + table.size[number])
            out += [(kind, table.names[i]) for i in np.unique(number[inside]).tolist()]
        return out

    def active(self) -> Iterator[tuple[VariableKind, int]]:
        """Iterate over kind and number of the variables that own columns, in column order."""
        for kind in self.placed:
            for number in np.flatnonzero(self.tables[kind].offset >= 0):
                yield kind, int(number)


_Raw: TypeAlias = tuple[list[str], Array, Index, Mask, Array]


def calibration_name(network: Network, photo: str) -> str:
    """Return the name of the calibration that a photo uses."""
    camera = network.cameras[network.photos[photo].camera]
    return f"{camera.name}@{photo}" if camera.per_photo else camera.name


def camera_of_calibration(network: Network, name: str) -> Camera:
    """Return the camera of a calibration: of ``camera``, or of ``camera@photo``."""
    return network.cameras.get(name) or network.cameras[name.split("@")[0]]


def _points(network: Network) -> _Raw:
    points = list(network.points.values())
    n = len(points)
    values = np.fromiter(chain.from_iterable(p.coordinates for p in points), float, 3 * n)
    fixed = np.fromiter(chain.from_iterable(p.fixed for p in points), bool, 3 * n)
    sigma = np.full((n, 3), np.inf)
    for i, p in enumerate(points):
        if p.sigma is not None:
            sigma[i] = p.sigma
    free = ~fixed.reshape(n, 3)
    return list(network.points), values.reshape(n, 3), np.full(n, 3, dtype=np.intp), free, sigma


def _poses(network: Network) -> _Raw:
    n = len(network.photos)
    values = np.full((n, 12), np.nan)
    free = np.ones((n, 6), dtype=bool)
    sigma = np.full((n, 6), np.inf)
    for i, photo in enumerate(network.photos.values()):
        if photo.rotation is not None:
            values[i, :9] = photo.rotation.ravel()
        if photo.position is not None:
            values[i, 9:] = photo.position
        free[i] = ~np.array(photo.fixed)
        if photo.sigma_attitude is not None:
            sigma[i, :3] = photo.sigma_attitude
        if photo.sigma_position is not None:
            sigma[i, 3:] = photo.sigma_position
    return list(network.photos), values, np.full(n, 6, dtype=np.intp), free, sigma


def _calibrations(network: Network) -> _Raw:
    names: list[str] = []
    cameras = []
    for camera in network.cameras.values():
        own = [f.name for f in network.photos.values() if f.camera == camera.name]
        for name in [f"{camera.name}@{f}" for f in own] if camera.per_photo else [camera.name]:
            names.append(name)
            cameras.append(camera)
    n = len(names)
    width = max((len(c.values) for c in cameras), default=0)
    values = np.zeros((n, width))
    free = np.zeros((n, width), dtype=bool)
    sigma = np.full((n, width), np.inf)
    for i, camera in enumerate(cameras):
        k = len(camera.values)
        values[i, :k] = camera.values
        free[i, :k] = ~np.array(camera.fixed)
        sigma[i, :k] = camera.sigma
    unknown = free & np.isinf(sigma)
    start_interior_orientations(network, cameras, names, calibration_name, values, unknown)
    return names, values, np.array([len(c.values) for c in cameras], dtype=np.intp), free, sigma


@cache
def _unstated(kind: VariableKind) -> _Raw:
    """Arrange the parameters of a kind of which a network states none."""
    out = _parameters(UNKNOWNS[kind], {})
    for array in out[1:]:
        array.flags.writeable = False
    return out


def _parameters(kind: UnknownKind, stated: Mapping[Key, Parameter]) -> _Raw:
    """Arrange the parameters of one kind, the default first."""
    entries = {parameter_name(key): p for key, p in stated.items()}
    if kind.default is not None:
        k = kind.usual
        entries = {DEFAULT: Parameter(kind.default, (True,) * k, (np.inf,) * k)} | entries
    n = len(entries)
    values = np.zeros((n, kind.size))
    constants = np.zeros((n, len(kind.constants)))
    free = np.zeros((n, kind.size), dtype=bool)
    sigma = np.full((n, kind.size), np.inf)
    sizes = np.zeros(n, dtype=np.intp)
    for i, p in enumerate(entries.values()):
        k = sizes[i] = len(p.values)
        values[i, :k] = p.values
        constants[i, : len(p.constants)] = p.constants
        free[i, :k] = ~np.array(p.fixed)
        sigma[i, :k] = p.sigma
    stored = np.concatenate([kind.store(values), constants], axis=1)
    return list(entries), stored, sizes, free, sigma


_ENTITIES = {"point": _points, "pose": _poses, "calibration": _calibrations}


def _laid_out(network: Network, kind: VariableKind) -> _Raw:
    entities = _ENTITIES.get(kind)
    if entities is not None:
        return entities(network)
    stated = network.parameters.get(kind)
    return _parameters(UNKNOWNS[kind], stated) if stated else _unstated(kind)
