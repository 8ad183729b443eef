"""The observation equations of a network: unknowns, blocks of observations, clusters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, Problem
from ..models import position
from ..models.registry import KINDS, VariableKind
from ..models.sight import sight
from ..network import REFRACTION_OF_THE_NETWORK, Network
from ..observations import (
    AstronomicLatitude,
    ControlPoint,
    GnssVector,
    HeightDifference,
    Observation,
    PhotoPosition,
)
from ..stochastic import StandardDeviation, whitening
from ..types import Array, Index, Mask
from .blocks import Block
from .variables import NO_DEFLECTION, NO_METER, State, Unknowns, calibration_name


@dataclass(frozen=True)
class Cluster:
    """Scalar rows that share a covariance."""

    rows: Index
    """Their numbers among all rows."""
    whitener: Array
    """W = L⁻¹ of the covariance L Lᵀ."""


@dataclass(frozen=True)
class Equations:
    """Everything that an adjustment needs to know of a network, in arrays."""

    network: Network
    """The network."""
    unknowns: Unknowns
    """The unknowns and their columns."""
    blocks: tuple[Block, ...]
    """Observations by kind; image coordinates last, one block for each lens model."""
    clusters: tuple[Cluster, ...]
    """Correlated rows across observations; their own standard deviations are those of the
    covariance's diagonal."""
    in_cluster: dict[int, Index]
    """For each block with clustered rows, by its place: the observations in clusters."""

    @property
    def n_rows(self) -> int:
        """Number of scalar observations, weighted unknowns among them."""
        return sum(b.observed.size for b in self.blocks)

    def residuals(self, state: State, *, whitened: bool = True) -> Array:
        """Return v (n_rows,), whitened or in units of the observations."""
        out = np.empty(self.n_rows)
        raw = np.empty(self.n_rows) if self.clusters else out
        for block in self.blocks:
            v = block.evaluate(self.network.frame, state, jacobians=False).residual
            out[block.rows] = (block.whiten(v) if whitened else v).ravel()
            if self.clusters:
                raw[block.rows] = v.ravel()
        if whitened:
            for c in self.clusters:
                out[c.rows] = c.whitener @ raw[c.rows]
        return out

    def sigmas(self) -> Array:
        """Return the standard deviation of every scalar row (n_rows,)."""
        return np.concatenate([b.sigma.ravel() for b in self.blocks] or [np.zeros(0)])

    def label(self, row: int) -> str:
        """Return a readable name of a scalar row."""
        for block in self.blocks:
            if block.rows.start <= row < block.rows.stop:
                i, component = divmod(row - block.first_row, block.dimension)
                name = block.components[component]
                return f"{block.labels(i)} {name}".strip()
        raise IndexError(row)

    def weighted_at(self, state: State) -> Equations:
        """Return the equations with standard deviations for the geometry of ``state``.

        Parts such as ppm and centring depend on the lengths of sights.
        """
        return replace(self, blocks=tuple(_weigh(self.network, b, state) for b in self.blocks))


def compile_network(network: Network) -> Equations:
    """Turn a network into arrays.

    Raises:
        InputError: nothing to adjust, or a point measured twice in one photo.
    """
    unknowns = Unknowns(network)
    blocks = [*_plain_blocks(network, unknowns), *_control_blocks(network, unknowns)]
    blocks += [*_weighted_blocks(unknowns), *_image_blocks(network, unknowns)]
    first, placed = 0, []
    for block in blocks:
        placed.append(replace(block, first_row=first))
        first += block.observed.size
    if first == 0:
        raise InputError("nothing to adjust: the network has no observations")
    if unknowns.n_columns == 0:
        raise InputError("nothing to adjust: everything is held")
    clusters, in_cluster = _clusters(network, placed)
    return Equations(network, unknowns, tuple(placed), clusters, in_cluster)


# -- blocks ---------------------------------------------------------------------------------------


def _number(
    network: Network, unknowns: Unknowns, kind: VariableKind, attribute: str, o: Observation
) -> int:
    """Return the number of the variable that an observation touches."""
    name = getattr(o, attribute)
    if kind == "orientation":
        name = f"{o.station}/{name}"  # type: ignore[attr-defined]
    elif kind == "vertical":
        name = name if name in network.verticals else NO_DEFLECTION
    elif kind == "refraction" and name is None:
        name = REFRACTION_OF_THE_NETWORK
    elif kind == "edm" and name is None:
        name = NO_METER
    return unknowns[kind].number[name]


def _constant_sigma(o: Observation) -> float:
    """Return the constant part of the standard deviation (any positive value stands in)."""
    sigma = o.sigma  # type: ignore[attr-defined]
    if isinstance(sigma, StandardDeviation):
        return sigma.constant or 1.0
    return float(sigma)


def _by_kind(network: Network) -> dict[str, list[tuple[str, Observation]]]:
    groups: dict[str, list[tuple[str, Observation]]] = {}
    for ident, o in network.observations.items():
        groups.setdefault(o.kind, []).append((ident, o))
    return groups


def _plain_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    for name, group in _by_kind(network).items():
        kind = KINDS.get(name)
        if kind is None:
            continue
        observations = [o for _, o in group]
        variables = tuple(
            (
                what,
                np.array(
                    [_number(network, unknowns, what, attribute, o) for o in observations],
                    dtype=np.intp,
                ),
            )
            for what, attribute in kind.variables
        )
        n = len(group)
        d = len(observations[0].components)
        whitener = None
        if isinstance(observations[0], GnssVector | PhotoPosition):
            sigma, whitener = _vector_weights(observations)
        else:
            sigma = np.array([_constant_sigma(o) for o in observations]).reshape(n, 1)
        yield Block(
            name,
            kind.unit,
            variables,
            np.array([o.value for o in observations], dtype=float).reshape(n, d),  # type: ignore[attr-defined]
            sigma,
            [ident for ident, _ in group],
            observations[0].components,
            lambda i, found=observations: found[i].label(),  # type: ignore[misc]
            whitener,
            kind.model,
            constants={
                c: np.array([getattr(o, c) for o in observations], dtype=float)
                for c in kind.constants
            },
        )


def _vector_weights(observations: list[Observation]) -> tuple[Array, Array | None]:
    """Return σ (n, d) and, where covariances are given, W (n, d, d)."""
    covariances = [
        np.diag(np.square(o.sigma)) if o.covariance is None else np.asarray(o.covariance)  # type: ignore[attr-defined]
        for o in observations
    ]
    sigma = np.sqrt(np.array([np.diag(c) for c in covariances]))
    if all(o.covariance is None for o in observations):  # type: ignore[attr-defined]
        return sigma, None
    return sigma, np.array([whitening(c) for c in covariances])


def _control_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    """Control points, GNSS positions: each known coordinate is a row."""
    groups = _by_kind(network)
    for name in ("control", "gnss_position"):
        rows: list[tuple[int, Array, Array, float, float]] = []
        ids: list[str] = []
        labels: list[str] = []
        for ident, o in groups.get(name, []):
            assert isinstance(o, ControlPoint)
            number = unknowns["point"].number[o.point]
            sigma = o.sigma if o.covariance is None else np.sqrt(np.diag(o.covariance)).tolist()
            assert sigma is not None
            for i, axis in enumerate(o.axes):
                if axis in "xyz":
                    vector, reference, value = np.eye(3)["xyz".index(axis)], np.zeros(3), o.value[i]
                else:
                    reference = np.array(o.value, dtype=float)
                    basis = network.frame.basis(reference[None], np.zeros((1, 2)))
                    vector, value = basis.enu[0, "enu".index(axis)], 0.0
                rows.append((number, vector, reference, value, sigma[i]))
                ids.append(ident)
                labels.append(f"{o.label()} {axis}")
        if rows:
            yield _coordinate_block(name, rows, ids, labels)


def _coordinate_block(
    kind: str,
    rows: list[tuple[int, Array, Array, float, float]],
    ids: list[str],
    labels: list[str],
) -> Block:
    number, axis, reference, value, sigma = zip(*rows, strict=True)
    return Block(
        kind,
        "m",
        (("point", np.array(number, dtype=np.intp)),),
        np.array(value, dtype=float)[:, None],
        np.array(sigma, dtype=float)[:, None],
        ids,
        ("",),
        labels.__getitem__,
        model=position.coordinate,
        constants={"axis": np.array(axis), "reference": np.array(reference)},
    )


def _weighted_blocks(unknowns: Unknowns) -> Iterable[Block]:
    """Weighted unknowns: their given values are observations."""
    for kind, table in unknowns.tables.items():
        weighted = np.isfinite(table.sigma) & table.free
        if kind == "pose":
            yield from _weighted_poses(unknowns, weighted)
            continue
        numbers, which = np.nonzero(weighted)
        if not len(numbers):
            continue
        components = [
            unknowns.component_names(kind, int(i))[c] for i, c in zip(numbers, which, strict=True)
        ]
        ids = [f"{kind} {table.names[i]} {c}" for i, c in zip(numbers, components, strict=True)]
        values = table.values[numbers, which]
        sigma = table.sigma[numbers, which]
        if kind == "point":
            eye, zero = np.eye(3), np.zeros(3)
            yield _coordinate_block(
                "control",
                [
                    (int(i), eye[c], zero, float(v), float(s))
                    for i, c, v, s in zip(numbers, which, values, sigma, strict=True)
                ],
                ids,
                [f"weighted {i}" for i in ids],
            )
            continue
        yield Block(
            f"weighted_{kind}",
            "mixed",
            ((kind, numbers.astype(np.intp)),),
            values[:, None],
            sigma[:, None],
            ids,
            ("",),
            [f"weighted {i}" for i in ids].__getitem__,
            model=position.component,
            constants={"which": which.astype(float)},
        )


def _weighted_poses(unknowns: Unknowns, weighted: Mask) -> Iterable[Block]:
    """Attitudes as a whole, projection centres by coordinate: each may be weighted or not."""
    table = unknowns["pose"]
    rows = np.flatnonzero(weighted[:, :3].any(axis=1))
    if len(rows):
        names = [f"photo {table.names[i]} attitude" for i in rows]
        yield Block(
            "weighted_attitude",
            "rad",
            (("pose", rows.astype(np.intp)),),
            np.zeros((len(rows), 3)),
            table.sigma[rows, :3],
            names,
            ("rx", "ry", "rz"),
            [f"weighted {n}" for n in names].__getitem__,
            model=position.photo_attitude,
            constants={"reference": table.values[rows, :9].reshape(-1, 3, 3)},
        )
    rows, axes = np.nonzero(weighted[:, 3:])
    if len(rows):
        names = [
            f"photo {table.names[i]} position {'xyz'[c]}" for i, c in zip(rows, axes, strict=True)
        ]
        yield Block(
            "weighted_position",
            "m",
            (("pose", rows.astype(np.intp)),),
            table.values[rows, 9 + axes][:, None],
            table.sigma[rows, 3 + axes][:, None],
            names,
            ("",),
            [f"weighted {n}" for n in names].__getitem__,
            model=position.photo_coordinate,
            constants={"axis": np.eye(3)[axes]},
        )


class _ImageIds:
    """Ids of image points, made when they are asked for."""

    def __init__(self, network: Network, rows: Index, photo: Index, point: Index) -> None:
        self._photos, self._points = tuple(network.photos), tuple(network.points)
        self._own, self._sources = network.images.ids, network.images.sources
        self._rows, self._photo, self._point = rows, photo, point

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, i: int) -> str:
        own = self._own.get(int(self._rows[i]))
        return own or f"{self._photos[self._photo[i]]}/{self._points[self._point[i]]}"

    def label(self, i: int) -> str:
        source = self._sources.get(int(self._rows[i]))
        text = f"image {self._photos[self._photo[i]]} {self._points[self._point[i]]}"
        return f"{source}: {text}" if source else text


def _image_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    photo, point, xy, sigma = network.images.columns()
    if not len(photo):
        return
    _refuse_duplicates(network, photo, point)
    calibration = np.array(
        [unknowns["calibration"].number[calibration_name(network, f)] for f in network.photos],
        dtype=np.intp,
    )
    lenses = [network.cameras[f.camera].lens for f in network.photos.values()]
    distinct = list(dict.fromkeys(lenses))
    lens_of_photo = np.array([distinct.index(lens) for lens in lenses])
    for number, lens in enumerate(distinct):
        rows = np.flatnonzero(lens_of_photo[photo] == number)
        if not len(rows):
            continue
        # Photo by photo: what is summed for each photo then lies together.
        rows = rows[np.argsort(photo[rows], kind="stable")]
        ids = _ImageIds(network, rows, photo[rows], point[rows])
        yield Block(
            "image",
            "image",
            (
                ("pose", photo[rows]),
                ("calibration", calibration[photo[rows]]),
                ("point", point[rows]),
            ),
            xy[rows],
            sigma[rows],
            ids,  # type: ignore[arg-type]
            ("x", "y"),
            ids.label,
            lens=lens,
        )


def _refuse_duplicates(network: Network, photo: Index, point: Index) -> None:
    code = np.sort(photo * len(network.points) + point)
    twice = np.unique(code[1:][code[1:] == code[:-1]])
    if len(twice):
        photos, points = tuple(network.photos), tuple(network.points)
        raise InputError(
            [
                Problem(
                    "the point is measured more than once in this photo",
                    f"image point {photos[c // len(points)]}/{points[c % len(points)]}",
                )
                for c in twice
            ]
        )


# -- weights --------------------------------------------------------------------------------------


def _weigh(network: Network, block: Block, state: State) -> Block:
    """Return the block with standard deviations that depend on lengths evaluated."""
    if block.kind not in KINDS or block.whitener is not None or block.dimension > 1:
        return block
    observations = [network.observations[i] for i in block.ids]
    sigmas = [
        None if isinstance(o, AstronomicLatitude) else o.sigma  # type: ignore[attr-defined]
        for o in observations
    ]
    rows = np.array(
        [i for i, s in enumerate(sigmas) if isinstance(s, StandardDeviation)], dtype=np.intp
    )
    if not len(rows):
        return block
    part = block.select(rows)
    chosen = [sigmas[i] for i in rows]
    constant, ppm, per_km, ci, ct = (
        np.array([getattr(s, name) for s in chosen])
        for name in (
            "constant",
            "ppm",
            "per_sqrt_km",
            "centring_instrument",
            "centring_target",
        )
    )
    x = [state[kind][index] for kind, index in part.variables]
    q = sight(
        network.frame, *x[:4], *(part.constants[c] for c in ("instrument_height", "target_height"))
    ).q
    slope, level = np.linalg.norm(q, axis=1), np.hypot(q[:, 0], q[:, 1])
    if block.kind in ("slope_distance", "horizontal_distance"):
        length = np.abs(part.observed[:, 0])
        variance = (constant + 1e-6 * ppm * length) ** 2 + ci**2 + ct**2
    elif block.kind == "height_difference":
        km = np.array(
            [
                o.length_km if isinstance(o, HeightDifference) and o.length_km is not None else h
                for o, h in zip((observations[i] for i in rows), level / 1000.0, strict=True)
            ]
        )
        variance = constant**2 + per_km**2 * km + ci**2 + ct**2
    elif block.kind in ("vertical_angle", "zenith_angle"):
        variance = constant**2 + (ci**2 + ct**2) / slope**2
    elif block.kind == "horizontal_angle":
        q2 = sight(
            network.frame,
            x[0],
            x[1],
            x[4],
            x[5],
            part.constants["instrument_height"],
            part.constants["target2_height"],
        ).q
        level2 = np.hypot(q2[:, 0], q2[:, 1])
        across = np.hypot(q2[:, 0] - q[:, 0], q2[:, 1] - q[:, 1])
        variance = (
            constant**2
            + ci**2 * (across / (level * level2)) ** 2
            + ct**2 * (1 / level**2 + 1 / level2**2)
        )
    else:
        variance = constant**2 + (ci**2 + ct**2) / level**2
    problems = [
        Problem("the standard deviation is zero here: none of its parts applies", part.labels(i))
        for i in np.flatnonzero(~(variance > 0))
    ]
    if problems:
        raise InputError(problems)
    sigma = block.sigma.copy()
    sigma[rows, 0] = np.sqrt(variance)
    return replace(block, sigma=sigma)


def _clusters(
    network: Network, blocks: list[Block]
) -> tuple[tuple[Cluster, ...], dict[int, Index]]:
    """Find the rows of the network's clusters and of control points with a covariance."""
    groups = list(network.clusters)
    groups += [
        ((ident,), np.asarray(o.covariance))
        for ident, o in network.observations.items()
        if isinstance(o, ControlPoint)
        and o.covariance is not None
        and not any(ident in g for g, _ in network.clusters)
    ]
    if not groups:
        return (), {}
    rows_of: dict[str, list[int]] = {}
    place: dict[str, list[tuple[int, int]]] = {}
    for number, block in enumerate(blocks):
        if block.kind == "image" or block.kind.startswith("weighted"):
            continue
        for i, ident in enumerate(block.ids):
            first = block.first_row + i * block.dimension
            rows_of.setdefault(ident, []).extend(range(first, first + block.dimension))
            place.setdefault(ident, []).append((number, i))
    clusters = []
    members: dict[int, list[int]] = {}
    for ids, covariance in groups:
        rows = np.array([r for ident in ids for r in rows_of[ident]], dtype=np.intp)
        clusters.append(Cluster(rows, whitening(covariance)))
        for ident in ids:
            for number, i in place[ident]:
                members.setdefault(number, []).append(i)
    for number in members:
        # A clustered observation is weighted by its cluster; σ for reports is the diagonal's.
        block = blocks[number]
        sigma = block.sigma.copy()
        for c, (_, covariance) in zip(clusters, groups, strict=True):
            own = (c.rows >= block.rows.start) & (c.rows < block.rows.stop)
            sigma.ravel()[c.rows[own] - block.first_row] = np.sqrt(np.diag(covariance))[own]
        whitener = block.whitener
        if whitener is not None:
            whitener = whitener.copy()
        blocks[number] = replace(block, sigma=sigma, whitener=whitener)
    return tuple(clusters), {n: np.array(sorted(i), dtype=np.intp) for n, i in members.items()}
