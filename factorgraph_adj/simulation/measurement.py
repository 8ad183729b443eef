"""Simulated measurements of a plan with drawn errors, its true values; disturbed start values.

A plan is a `Network` whose given values are the true ones; its observed values are ignored. The
measurements come from the same models that an adjustment uses. A simulation therefore tests
geometry, weights, solver and covariances; only real measurements can test the models themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..entities import Camera, Parameter, Photo, parameter_name
from ..errors import taking
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_network
from ..graph.image_ids import ImageIds
from ..graph.variables import State
from ..models.unknown_registry import UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import Network
from ..observations import BUILT_IN, KINDS
from ..rotation import exp_rotation
from ..types import Array, Mask
from .planned_values import with_given_values

Seed = int
"""Seed of a simulation: the same seed gives the same errors on every machine."""

NUMBERED = BUILT_IN[: BUILT_IN.index("image") + 1]
"""Kinds of observations whose streams of errors have numbers. Kinds that came later have their
names as streams, so that a seed gives the same errors in every version."""
STREAMS = ("point", "orientation", "refraction", "vertical", "edm", "pose", "calibration")
"""Kinds of unknowns of the package, in the order of their streams of errors."""
NEGLIGIBLE = 1e-13
"""Tolerance of the inversion of measured → ideal lens models, relative to principal distance."""
MOST_ROUNDS = 50


@dataclass(frozen=True)
class Truth:
    """True values of a simulated network."""

    points: Mapping[str, Array]
    """Coordinates (3,), metres, by point."""
    photos: Mapping[str, Photo]
    """Exterior orientation by photo."""
    cameras: Mapping[str, Camera]
    """Calibration by camera."""
    parameters: Mapping[VariableKind, Mapping[Any, Parameter]]
    """Other unknowns by kind and name: refraction, verticals, distance meters …"""

    @classmethod
    def of(cls, plan: Network) -> Truth:
        """Return the given values of a plan as true values."""
        return cls(
            {name: np.array(p.coordinates) for name, p in plan.points.items()},
            dict(plan.photos),
            dict(plan.cameras),
            {kind: dict(given) for kind, given in plan.parameters.items()},
        )

    def calibration(self, camera: str, parameter: str) -> float:
        """Return the true value of a calibration parameter, image units."""
        found = self.cameras[camera]
        return found.values[found.lens.names.index(parameter)]

    @property
    def refractions(self) -> Mapping[str, Parameter]:
        """Coefficients of refraction by group."""
        return self.parameters.get("refraction", {})

    @property
    def verticals(self) -> Mapping[str, Parameter]:
        """Deflections ξ, η, radians, by station."""
        return self.parameters.get("vertical", {})

    @property
    def distance_meters(self) -> Mapping[str, Parameter]:
        """Scale and zero constant, metres, by distance meter."""
        return self.parameters.get("edm", {})


@dataclass(frozen=True)
class SimulatedNetwork:
    """A network with simulated measurements, and their true values and errors."""

    network: Network
    """Measurements and approximate values, the input of an adjustment."""
    truth: Truth
    """True values that the adjustment should find."""
    gross_errors: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """Sizes of the gross errors in the readings by id and component (empty if there is only
    one): metres, radians, image units."""
    dropped: tuple[str, ...] = ()
    """Ids of the observations that were lost."""


@taking(Network)
def measure(plan: Network, *, seed: Seed, noise: bool = True) -> Network:
    """Return ``plan`` with every observation measured: its true value plus a drawn error.

        l = f(x) + L z,    z ~ N(0, I),    L Lᵀ = Σ

    with the models f, the true values x of ``plan`` and the covariances Σ that its observations
    state, SI or image units; where σ depends on a length, it is that of the true length. Every
    kind of observation draws from its own stream, in the order of the plan: two plans that begin
    with the same observations of a kind measure them with the same errors. Weighted unknowns are
    observations too: their given values are drawn, except for cameras with a calibration for
    each photo.

    Errors of image coordinates are added to the measured coordinates. A lens model that has its
    residuals in ideal coordinates (``residuals="ideal"``) adjusts corrected coordinates with the
    same weights: a distortion that stretches the image by one per cent also increases σ̂0 by one
    per cent.

    Args:
        plan: a network with true values everywhere; those that may be missing are those of
            `factorgraph_adj.simulation.planned_values`.
        seed: seed of the errors.
        noise: whether readings have random errors; otherwise all readings are true values.

    Returns:
        A new network with the readings l; unknowns keep the values of ``plan``, weighted ones
        apart.

    Raises:
        InputError: an unknown without a value that is needed, or an observation that cannot be
            computed, as its geometry has no answer.
    """
    plan = with_given_values(plan)
    equations = compile_network(plan)
    state = equations.unknowns.start()
    true = [_observed_truly(equations, block, state) for block in equations.blocks]
    # Standard deviations may depend on the measured length, so weighting follows measuring.
    equations = replace(equations, blocks=tuple(true)).weighted_at(state)
    errors = _errors(equations, seed) if noise else np.zeros(equations.n_rows)
    measured = _weighted_drawn(equations, plan, seed) if noise else plan.copy()
    seen = np.zeros((plan.n_image_points, 2))
    values: dict[str, list[float]] = {}
    for block in equations.blocks:
        value = block.moved(errors[block.rows].reshape(block.observed.shape))
        if block.image:
            assert isinstance(block.ids, ImageIds)
            seen[block.ids.rows] = value
            continue
        for ident, row in zip(block.ids, value.tolist(), strict=True):
            values.setdefault(ident, []).extend(row)
    measured.images = plan.images.with_columns(xy=seen)
    measured.observations = {
        ident: o.with_reading(values[ident], plan.frame) for ident, o in plan.observations.items()
    }
    return measured


def disturb(
    network: Network,
    *,
    seed: Seed,
    points: float = 0.0,
    centres: float = 0.0,
    attitudes: float = 0.0,
    restart: bool = False,
) -> Network:
    """Return ``network`` with approximate values: free unknowns moved by drawn errors.

    Held and weighted values stay; orientation unknowns lose their values, which an adjustment
    computes again.

    Args:
        network: a network with values.
        seed: seed of the errors.
        points: standard deviation of free coordinates, metres.
        centres: standard deviation of free projection centres, metres.
        attitudes: standard deviation of free attitudes about each axis, radians.
        restart: whether free components of all other unknowns lose their values: an adjustment
            starts from those of their kinds, such as zero for a mount, or computes them, such as
            frames.
    """
    # The number is between the streams of noise and of weighted unknowns, so each is unique.
    rng = np.random.default_rng([seed, len(NUMBERED)])
    moved = copy(network)
    tables = compile_network(network).unknowns.tables
    loose = {k: table.free & np.isinf(table.sigma) for k, table in tables.items()}
    by = points * rng.standard_normal((len(network.points), 3)) * loose["point"]
    moved.points = {
        name: replace(p, coordinates=_sum(p.coordinates, by[i]))
        for i, (name, p) in enumerate(network.points.items())
    }
    scale = np.repeat([attitudes, centres], 3)
    by = scale * rng.standard_normal((len(network.photos), 6)) * loose["pose"]
    moved.photos = {
        name: _moved_photo(f, by[i]) for i, (name, f) in enumerate(network.photos.items())
    }
    moved.parameters = dict(network.parameters)
    for kind in parameter_kinds():
        if not (restart or kind.absent == "found"):
            continue
        number, start = tables[kind.name].number, [c.start for c in kind.components]
        moved.parameters[kind.name] = {
            key: _restarted(p, loose[kind.name][number[parameter_name(key)]], start, restart)
            for key, p in network.of_kind(kind.name).items()
        }
    return moved


def _restarted(p: Parameter, loose: Mask, start: Sequence[float], single: bool) -> Parameter:
    """Return a parameter with start values where its components are loose, or all of them are."""
    n = len(p.values)
    if not (single or loose[:n].all()):
        return p
    rows = zip(p.values, loose[:n].tolist(), start[:n], strict=True)
    return replace(p, values=tuple(s if free else v for v, free, s in rows))


def look_at(position: Array, target: Array) -> Array:
    """Return world_R_camera (3, 3) of a camera that looks from ``position`` at ``target``.

    The x axis of the image is level. Positions are metres in a frame with Z up; the direction of
    view must not be vertical.
    """
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _moved_photo(photo: Photo, shift: Array) -> Photo:
    """Return a photo moved by [turn about the camera's axes (rad), shift (m)], (6,)."""
    if photo.position is None or photo.rotation is None:
        return photo
    return replace(
        photo,
        position=_sum(photo.position, shift[3:]),
        rotation=photo.rotation @ exp_rotation(shift[:3]),
    )


def _weighted_drawn(equations: Equations, plan: Network, seed: Seed) -> Network:
    """Return a copy of the plan with the given values of weighted unknowns drawn."""
    drawn = plan.copy()
    errors: dict[VariableKind, Array] = {}
    for kind, table in equations.unknowns.tables.items():
        weighted = np.isfinite(table.sigma) & table.free
        stream = _stream(kind, STREAMS, len(NUMBERED) + 1)
        z = np.random.default_rng([seed, *stream]).standard_normal(weighted.shape)
        errors[kind] = np.where(weighted, table.sigma, 0.0) * np.where(weighted, z, 0.0)
    number = {kind: table.number for kind, table in equations.unknowns.tables.items()}

    def error(kind: VariableKind, name: str) -> Array:
        return np.asarray(errors[kind][number[kind][name]])

    def parameter(kind: VariableKind, name: str, given: Parameter) -> Parameter:
        by = error(kind, name)[: len(given.values)]
        if not by.any():
            return given
        record, values = UNKNOWNS[kind], np.array([given.values])
        moved = record.given(record.retract(record.store(values), by[None]))
        return replace(given, values=tuple(moved[0].tolist()))

    drawn.points = {
        n: replace(p, coordinates=_sum(p.coordinates, error("point", n)))
        for n, p in plan.points.items()
    }
    drawn.photos = {n: _moved_photo(f, error("pose", n)) for n, f in plan.photos.items()}
    drawn.cameras = {
        n: c if c.per_photo else replace(c, values=_sum(c.values, error("calibration", n)))
        for n, c in plan.cameras.items()
    }
    drawn.parameters = {
        kind: {key: parameter(kind, parameter_name(key), p) for key, p in given.items()}
        for kind, given in plan.parameters.items()
    }
    return drawn


def _sum(values: tuple[float, ...], error: Array) -> tuple[Any, ...]:
    return tuple((np.array(values) + error[: len(values)]).tolist())


def _errors(equations: Equations, seed: Seed) -> Array:
    """Draw the error of every scalar row (n_rows,), units of the observations."""
    out = np.zeros(equations.n_rows)
    normal = np.zeros(equations.n_rows)
    streams: dict[str, np.random.Generator] = {}
    for block in equations.blocks:
        if block.kind not in KINDS:
            continue
        if block.kind not in streams:
            streams[block.kind] = np.random.default_rng([seed, *_stream(block.kind, NUMBERED, 0)])
        z = streams[block.kind].standard_normal(block.observed.shape)
        normal[block.rows] = z.ravel()
        if block.whitener is None:
            out[block.rows] = (z * block.sigma).ravel()
        else:
            out[block.rows] = np.linalg.solve(block.whitener, z[:, :, None]).ravel()
    for cluster in equations.clusters:
        out[cluster.rows] = np.linalg.solve(cluster.whitener, normal[cluster.rows])
    return out


def _stream(kind: str, built_in: Sequence[str], first: int) -> list[int]:
    """Return the number of the stream of a kind; a kind without a number has its name as stream.

    The streams of the package's own kinds do not depend on registered kinds.
    """
    if kind in built_in:
        return [first + built_in.index(kind)]
    return [first, *kind.encode()]


def _observed_truly(equations: Equations, block: Block, state: State) -> Block:
    """Return a block with true readings: v = computed − observed is added to the observed values.

    One addition is sufficient except for lens models from measured to ideal coordinates; there
    the slope of the distortion leaves a small v, and the addition is repeated.
    """
    frame = equations.network.frame
    imaged = block.unit == "image"
    c = float(state["calibration"][:, 0].max()) if imaged else 1.0
    for _ in range(MOST_ROUNDS if imaged else 1):
        v = block.evaluate(frame, state, jacobians=False).residual
        block = replace(block, observed=block.moved(v))
        if np.abs(v).max() < NEGLIGIBLE * c:
            break
    return block
