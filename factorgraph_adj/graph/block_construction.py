"""Blocks from a network: observations, control, weighted unknowns, users' factors; variables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from typing import Any, cast

import numpy as np

from ..entities import parameter_key, parameter_name
from ..errors import InputError, Problem
from ..frames import Frame
from ..models import attitude, positions
from ..models.base import Linearised
from ..models.unknown_registry import ENTITIES, UNKNOWNS, UnknownKind, VariableKind
from ..network.network import Network
from ..observations import KINDS, ControlPoint, Observation, ObservationKind, Unit, observation_kind
from ..observations.user_factor import OwnFactor
from ..rotation import exp_rotation
from ..types import Array, Index, Mask
from .blocks import Block, ObservationLabels
from .variables import DEFAULT, Unknowns, Variables, calibration_name
from .weights import constant_sigma, vector_weights

ABSENT = ""
"""Name of a variable that an observation could have and has not."""
NO_PLANES = (
    "lens model {!r} has no projection centre, through which the plane of a line or a refracted "
    "ray could pass: measure these points in photos of central projection"
)
"""Why lines in images and refracted image points cannot be computed."""


def variable_name(network: Network, kind: VariableKind, attribute: str, o: Observation) -> str:
    """Return the name of the variable to which an attribute of an observation refers.

    It is empty for a variable that is not there: the attribute is None, or the origin of its frame
    is no point.
    """
    attribute, _, part = attribute.partition(".")
    if part:
        return _at_origin(network, kind, getattr(o, attribute))
    if kind == "calibration":
        return calibration_name(network, getattr(o, attribute))
    if kind in ENTITIES:
        return getattr(o, attribute) or ""
    record = UNKNOWNS[kind]
    key = parameter_key(record, attribute, o)
    if record.in_photo and attribute not in o.record.photos and key not in network.of_kind(kind):
        what = f"photo {key!r} has no {record.short} of which it says something"
        raise InputError(Problem(what, o.label()))
    if record.absent == "default" and key not in network.parameters.get(kind, {}):
        return DEFAULT
    return parameter_name(key)


def _at_origin(network: Network, kind: VariableKind, frame: str) -> str:
    """Return the name of the variable at the origin of a frame; empty: it is not there."""
    stated = network.frames[frame]
    if kind == "point":
        return stated.origin
    level = bool(stated.constants[-1])
    return stated.origin if level and stated.origin in network.of_kind(kind) else DEFAULT


@dataclass(frozen=True)
class Group:
    """The observations of one kind."""

    ids: list[str] = field(default_factory=list)
    """Their ids."""
    observations: list[Observation] = field(default_factory=list)
    """The observations."""


def by_kind(network: Network) -> dict[str, Group]:
    """Return the observations of a network by the names of their kinds."""
    groups: dict[str, Group] = {}
    for ident, o in network.observations.items():
        group = groups.get(o.kind)
        if group is None:
            group = groups[o.kind] = Group()
        group.ids.append(ident)
        group.observations.append(o)
    return groups


def plain_blocks(
    network: Network, unknowns: Unknowns, groups: Mapping[str, Group]
) -> Iterable[Block]:
    """Yield the blocks of the kinds that have a model function."""
    for name, group in groups.items():
        kind = observation_kind(name)
        if kind.model is not None:
            yield from _plain_blocks(network, unknowns, kind, group)


def _plain_blocks(
    network: Network, unknowns: Unknowns, kind: ObservationKind, group: Group
) -> Iterable[Block]:
    """Yield the block of a kind, or several blocks if its observations differ in form.

    They do if unknowns of a kind differ in size, if some have variables or components that others
    have not, or if a variable is in several roles of some, and not of others.
    """
    index = [_numbers(network, unknowns, *v, group.observations) for v in kind.variables]
    unequal = [j for j, (what, _) in enumerate(kind.variables) if UNKNOWNS[what].variable_size]
    columns = [unknowns[kind.variables[j][0]].size[index[j]] for j in unequal]
    columns += [(i >= 0).astype(np.intp) for i in index]
    first = [*_first_roles(unknowns, kind, index)]
    columns += first
    cameras = _cameras(network, kind, group.observations)
    columns.append(np.array([cameras.index(camera) for camera in cameras], dtype=np.intp))
    form: dict[tuple[str, ...], int] = {}
    forms = (form.setdefault(o.component_names(), len(form)) for o in group.observations)
    columns.append(np.fromiter(forms, np.intp, len(group.ids)))
    differ = np.stack(columns, axis=1)
    if (differ == differ[0]).all():
        widths = dict(zip(unequal, differ[0].tolist(), strict=False))
        yield _plain_block(kind, group, index, [int(f[0]) for f in first], widths, cameras[0])
        return
    for each in np.unique(differ, axis=0):
        rows = np.flatnonzero((differ == each).all(axis=1))
        widths = dict(zip(unequal, each.tolist(), strict=False))
        at = rows.tolist()
        some = Group([group.ids[i] for i in at], [group.observations[i] for i in at])
        own = [int(f[rows[0]]) for f in first]
        yield _plain_block(kind, some, [n[rows] for n in index], own, widths, cameras[rows[0]])


def _first_roles(
    unknowns: Unknowns, kind: ObservationKind, index: Sequence[Index]
) -> Iterable[Index]:
    """Yield the first role of each variable of a kind, (n,) each: its own place, or an earlier one.

    The value by default, which stands for all variables that nobody stated, is a constant and no
    variable in several roles.
    """
    for j, (what, _) in enumerate(kind.variables):
        first = np.full(len(index[j]), j, dtype=np.intp)
        earlier = [i for i in range(j) if kind.variables[i][0] == what]
        if earlier:
            stated = (index[j] >= 0) & (index[j] != unknowns[what].number.get(DEFAULT, -1))
            for i in reversed(earlier):
                first[stated & (index[i] == index[j])] = i
        yield first


def _numbers(
    network: Network,
    unknowns: Unknowns,
    what: VariableKind,
    attribute: str,
    observations: Sequence[Observation],
) -> Index:
    """Return the number of the variable of each observation, (n,); −1 where it is not there."""
    number = dict(unknowns[what].number)
    if what in ENTITIES:
        number.setdefault(ABSENT, -1)
    keys = attribute_keys(what, attribute, observations)
    one = dict(zip(keys, observations, strict=True))
    found = {k: number[variable_name(network, what, attribute, o)] for k, o in one.items()}
    return np.fromiter(map(found.__getitem__, keys), np.intp, len(keys))


def attribute_keys(
    what: VariableKind, attribute: str, observations: Sequence[Observation]
) -> list[Any]:
    """Return for each observation what the name of a variable depends on, for `variable_name`.

    Names are looked up once for all observations in which it is equal.
    """
    table = UNKNOWNS[what].table
    beside = () if table is None or "." in attribute else table.keys[:-1]
    return list(map(attrgetter(*beside, attribute.partition(".")[0]), observations))


def _cameras(
    network: Network, kind: ObservationKind, observations: Sequence[Observation]
) -> list[dict[str, Any]]:
    """Return lens and readout of the camera of each observation whose model has a calibration.

    Raises:
        InputError: lines in images of lens models of places.
    """
    attribute = next((a for what, a in kind.variables if what == "calibration"), None)
    if attribute is None:
        return [{}] * len(observations)
    photos = [network.photos[getattr(o, attribute)] for o in observations]
    problems = [
        Problem(NO_PLANES.format(network.cameras[f.camera].lens.kind), o.label())
        for f, o in zip(photos, observations, strict=True)
        if network.cameras[f.camera].lens.takes == "places"
    ]
    if problems:
        raise InputError(problems)
    used = {f.camera: network.cameras[f.camera] for f in network.photos.values()}
    given = {name: {"lens": c.lens, "readout": c.times()} for name, c in used.items()}
    return [given[f.camera] for f in photos]


def _plain_block(
    kind: ObservationKind,
    group: Group,
    index: Sequence[Index],
    first: Sequence[int],
    widths: dict[int, int],
    camera: Mapping[str, Any],
) -> Block:
    observations = group.observations
    n = len(observations)
    components = observations[0].component_names()
    d = len(components)
    whitener = None
    if kind.takes_covariance:
        sigma, whitener = vector_weights(observations)
    else:
        sigma = np.array([constant_sigma(o) for o in observations]).reshape(n, 1)
    present = [i[0] >= 0 for i in index]
    there = [j for j, is_there in enumerate(present) if is_there]
    own = [j for j in there if first[j] == j]
    return Block(
        kind.name,
        kind.unit,
        tuple((kind.variables[j][0], index[j]) for j in own),
        np.array([o.value for o in cast(Any, observations)], dtype=np.float64).reshape(n, d),
        sigma,
        group.ids,
        components,
        ObservationLabels(observations),
        whitener,
        _model(kind, present, components, camera),
        constants={
            c: np.array([getattr(o, c) for o in observations], dtype=float) for c in kind.constants
        },
        fixes=kind.fixes,
        roles=tuple(own.index(first[j]) for j in there) if len(own) < len(there) else (),
        named=tuple(kind.variables[j][1] for j in there),
        widths={there.index(j): width for j, width in widths.items() if j in there},
        composed=kind.moved,
    )


def _model(
    kind: ObservationKind,
    present: Sequence[bool],
    components: tuple[str, ...],
    camera: Mapping[str, Any],
) -> Callable[..., Linearised]:
    """Return the model of a kind for observations that have some of its variables and axes.

    ``camera`` has the lens and the readout of its camera, if the model has a calibration.
    """
    assert kind.model is not None
    model = partial(kind.model, **camera) if camera else kind.model
    if "axes" in kind.attributes:
        model = partial(model, axes=tuple("xyz".index(a) for a in components))
    return model if all(present) else partial(_with_absent, model, tuple(present))


def _with_absent(
    model: Callable[..., Linearised],
    present: tuple[bool, ...],
    frame: Frame,
    *values: Array,
    **given: Array,
) -> Linearised:
    """Return what a model makes of the variables that are there, with None for the others."""
    there = iter(values)
    return model(frame, *(next(there) if p else None for p in present), **given)


def own_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    """Yield the users' factors that are observations, a block each."""
    for ident, o in network.observations.items():
        if isinstance(o, OwnFactor):
            numbers = [unknowns[k].number[parameter_name(key)] for k, key in o.unknowns]
            yield Block(
                o.kind,
                o.record.unit,
                tuple((k, np.array([n])) for (k, _), n in zip(o.unknowns, numbers, strict=True)),
                np.zeros((1, o.dimension)),
                np.full((1, o.dimension), o.sigma),
                [ident],
                o.component_names(),
                ObservationLabels([o]),
                model=o.model,
                widths={
                    j: int(unknowns[k].size[n])
                    for j, ((k, _), n) in enumerate(zip(o.unknowns, numbers, strict=True))
                    if UNKNOWNS[k].variable_size
                },
            )


def control_blocks(
    network: Network, unknowns: Unknowns, groups: Mapping[str, Group]
) -> Iterable[Block]:
    """Yield control points and GNSS positions, one row for each known coordinate."""
    for name in (k.name for k in KINDS.values() if k.by_axis):
        rows: list[tuple[int, Array, Array, float, float]] = []
        ids: list[str] = []
        labels: list[str] = []
        axes: list[str] = []
        group = groups.get(name, Group())
        for ident, o in zip(group.ids, group.observations, strict=True):
            assert isinstance(o, ControlPoint)
            number = unknowns["point"].number[o.point]
            sigma = o.sigma if o.covariance is None else np.sqrt(np.diag(o.covariance)).tolist()
            assert sigma is not None
            for i, axis in enumerate(o.axes):
                if not o.local:
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
    *,
    prior: bool = False,
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
        model=positions.coordinate,
        constants={"axis": np.array(axis), "reference": np.array(reference)},
        prior=prior,
        fixes="coordinates",
        by_axis=True,
        axes=axes,
    )


def weighted_blocks(unknowns: Unknowns) -> Iterable[Block]:
    """Yield the given values of weighted unknowns as observations."""
    for kind, table in unknowns.tables.items():
        weighted = np.isfinite(table.sigma) & table.free
        record = UNKNOWNS[kind]
        if record.rotates:
            yield from _weighted_rotations(unknowns.network, record, table, weighted)
            weighted[:, :3] = False
        if kind == "pose":
            yield from _weighted_centres(table, weighted)
            continue
        numbers, which = np.nonzero(weighted)
        if not len(numbers):
            continue
        components = [
            unknowns.component_names(kind, int(i))[c] for i, c in zip(numbers, which, strict=True)
        ]
        ids = [f"{kind} {table.names[i]} {c}" for i, c in zip(numbers, components, strict=True)]
        shift = record.moving - record.size
        values = table.values[numbers, which + shift]
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
                prior=True,
            )
            continue
        # One block for each size, because calibrations of different lens models differ in size.
        for size in np.unique(table.size[numbers]):
            at = np.flatnonzero(table.size[numbers] == size)
            chosen, named = [ids[i] for i in at], [components[i] for i in at]
            yield Block(
                f"weighted_{kind}",
                unit_of(record),
                ((kind, numbers[at].astype(np.intp)),),
                values[at, None],
                sigma[at, None],
                chosen,
                ("",),
                [f"weighted {i}" for i in chosen].__getitem__,
                model=partial(positions.component, size=int(size), shift=shift),
                constants={"which": which[at].astype(float)},
                prior=True,
                axes=named,
            )


def unit_of(kind: UnknownKind) -> Unit:
    """Return the unit of the values of a kind of unknowns."""
    each = {c.quantity for c in kind.components}
    return "rad" if each == {"angle"} else "m" if each == {"length"} else "mixed"


def _weighted_rotations(
    network: Network, kind: UnknownKind, table: Variables, weighted: Mask
) -> Iterable[Block]:
    """Yield weighted attitudes, each as a whole, because the three rotations do not commute."""
    tilts = np.flatnonzero(weighted[:, 0] & ~weighted[:, 2])
    if len(tilts):
        yield _weighted_tilts(network, kind, table, tilts)
    rows = np.flatnonzero(weighted[:, :3].all(axis=1))
    if not len(rows):
        return
    pose = kind.name == "pose"
    what, called = (kind.noun, "attitude") if pose else (kind.name, "rotation")
    names = [f"{what} {table.names[i]} {called}" for i in rows]
    yield Block(
        "weighted_attitude" if pose else f"weighted_{kind.name}",
        "rad",
        ((kind.name, rows.astype(np.intp)),),
        np.zeros((len(rows), 3)),
        table.sigma[rows, :3],
        names,
        kind.names(3),
        [f"weighted {n}" for n in names].__getitem__,
        model=partial(attitude.attitude, size=kind.size),
        constants={"reference": table.values[rows, :9].reshape(-1, 3, 3)},
        prior=True,
        fixes="attitude",
    )


def _weighted_tilts(network: Network, kind: UnknownKind, table: Variables, rows: Index) -> Block:
    """Return the weighted tilts about x and y, which say nothing of the turn about z."""
    given = [network.of_kind(kind.name)[table.names[i]].values[:3] for i in rows.tolist()]
    names = [f"{kind.name} {table.names[i]} tilt" for i in rows]
    return Block(
        f"weighted_{kind.name}",
        "rad",
        ((kind.name, rows.astype(np.intp)),),
        np.zeros((len(rows), 2)),
        table.sigma[rows, :2],
        names,
        kind.names(2),
        [f"weighted {n}" for n in names].__getitem__,
        model=partial(attitude.tilt, size=kind.size),
        # The turn about z may not be known yet.
        constants={"upright": _upright(exp_rotation(np.nan_to_num(np.array(given)))[:, 2])},
        prior=True,
        fixes="horizon",
    )


def _upright(g: Array) -> Array:
    """Return the shortest turns (n, 3, 3) from directions g (n, 3) to (0, 0, 1)."""
    across = np.hypot(g[:, 0], g[:, 1])
    angle = np.arctan2(across, g[:, 2])
    axis = np.stack([g[:, 1], -g[:, 0], np.zeros(len(g))], axis=1)
    axis[across == 0.0] = [1.0, 0.0, 0.0]
    return exp_rotation(axis * (angle / np.where(across == 0.0, 1.0, across))[:, None])


def _weighted_centres(table: Variables, weighted: Mask) -> Iterable[Block]:
    """Yield weighted projection centres, coordinate by coordinate."""
    rows, axes = np.nonzero(weighted[:, 3:])
    if not len(rows):
        return
    names = [f"photo {table.names[i]} position {'xyz'[c]}" for i, c in zip(rows, axes, strict=True)]
    yield Block(
        "weighted_position",
        "m",
        (("pose", rows.astype(np.intp)),),
        table.values[rows, 9 + axes][:, None],
        table.sigma[rows, 3 + axes][:, None],
        names,
        ("",),
        [f"weighted {n}" for n in names].__getitem__,
        model=positions.photo_coordinate,
        constants={"axis": np.eye(3)[axes]},
        prior=True,
        fixes="coordinates",
        axes=["xyz"[c] for c in axes],
    )
