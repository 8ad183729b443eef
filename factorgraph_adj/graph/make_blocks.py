"""Observations and weighted unknowns of a network as blocks of arrays, kind by kind."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, cast

import numpy as np

from ..models import position
from ..models.registry import KINDS, VariableKind
from ..network.entities import REFRACTION_OF_THE_NETWORK
from ..network.network import Network
from ..observations import ControlPoint, GnssVector, Observation, PhotoPosition
from ..types import Array, Mask
from .blocks import Block, ObservationLabels
from .variables import NO_DEFLECTION, NO_METER, Unknowns
from .weights import constant_sigma, vector_weights


def variable_name(network: Network, kind: VariableKind, attribute: str, o: Observation) -> str:
    """Return the name of the variable of a kind that an attribute of an observation names."""
    name: str | None = getattr(o, attribute)
    if kind == "orientation":
        return f"{o.station}/{name}"  # type: ignore[attr-defined]
    if kind == "vertical" and name not in network.verticals:
        return NO_DEFLECTION
    if name is None:
        return REFRACTION_OF_THE_NETWORK if kind == "refraction" else NO_METER
    return name


def _by_kind(network: Network) -> dict[str, list[tuple[str, Observation]]]:
    groups: dict[str, list[tuple[str, Observation]]] = {}
    for ident, o in network.observations.items():
        groups.setdefault(o.kind, []).append((ident, o))
    return groups


def plain_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    """Observations of the kinds that have a model of their own."""
    for name, group in _by_kind(network).items():
        kind = KINDS.get(name)
        if kind is None:
            continue
        observations = [o for _, o in group]
        variables = tuple(
            (
                what,
                np.array(
                    [
                        unknowns[what].number[variable_name(network, what, attribute, o)]
                        for o in observations
                    ],
                    dtype=np.intp,
                ),
            )
            for what, attribute in kind.variables
        )
        n = len(group)
        d = len(observations[0].components)
        whitener = None
        if isinstance(observations[0], GnssVector | PhotoPosition):
            sigma, whitener = vector_weights(observations)
        else:
            sigma = np.array([constant_sigma(o) for o in observations]).reshape(n, 1)
        yield Block(
            name,
            kind.unit,
            variables,
            np.array([o.value for o in cast(Any, observations)], dtype=np.float64).reshape(n, d),
            sigma,
            [ident for ident, _ in group],
            observations[0].components,
            ObservationLabels(observations),
            whitener,
            kind.model,
            constants={
                c: np.array([getattr(o, c) for o in observations], dtype=float)
                for c in kind.constants
            },
        )


def control_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    """Control points, GNSS positions: each known coordinate is a row."""
    groups = _by_kind(network)
    for name in ("control", "gnss_position"):
        rows: list[tuple[int, Array, Array, float, float]] = []
        ids: list[str] = []
        labels: list[str] = []
        axes: list[str] = []
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
                axes.append(axis)
        if rows:
            yield _coordinate_block(name, rows, ids, labels, axes)


def _coordinate_block(
    kind: str,
    rows: list[tuple[int, Array, Array, float, float]],
    ids: list[str],
    labels: list[str],
    axes: list[str],
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
        axes=axes,
    )


def weighted_blocks(unknowns: Unknowns) -> Iterable[Block]:
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
                components,
            )
            continue
        # Variables of one size at a time: calibrations of different lens models are not alike.
        for size in np.unique(table.size[numbers]):
            at = np.flatnonzero(table.size[numbers] == size)
            chosen, named = [ids[i] for i in at], [components[i] for i in at]
            yield Block(
                f"weighted_{kind}",
                "mixed",
                ((kind, numbers[at].astype(np.intp)),),
                values[at, None],
                sigma[at, None],
                chosen,
                ("",),
                [f"weighted {i}" for i in chosen].__getitem__,
                model=partial(position.component, size=int(size)),
                constants={"which": which[at].astype(float)},
                axes=named,
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
            axes=["xyz"[c] for c in axes],
        )
