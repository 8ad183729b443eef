"""Addition of finished points, photos, cameras and unknowns to a network; all problems at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from ..control_characters import refuse_control_characters
from ..entities import Camera, Key, Parameter, Photo, Point, parameter_name
from ..errors import InputError, Problem, known
from ..models.unknown_registry import UNKNOWNS, VariableKind
from .construction import required
from .network import Network

UnknownsGiven: TypeAlias = Mapping[VariableKind, Mapping[Any, Parameter]]
"""Unknowns by kind and key."""
NO_UNKNOWNS: UnknownsGiven = MappingProxyType({})


def unknowns_by_kind(given: object) -> UnknownsGiven:
    """Return unknowns by kind and key, as ``Network.parameters`` has them; None: none.

    Raises:
        InputError: they are something else.
    """
    if given is None:
        return NO_UNKNOWNS
    if not isinstance(given, Mapping) or not all(
        isinstance(of_kind, Mapping) for of_kind in given.values()
    ):
        raise InputError(
            "give unknowns by kind and name, as the parameters of a scratch network: "
            "unknowns=scratch.parameters"
        )
    return {kind: dict(of_kind) for kind, of_kind in given.items() if of_kind}


def add_entities(
    network: Network,
    *,
    points: Sequence[Point],
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    unknowns: UnknownsGiven = NO_UNKNOWNS,
) -> list[Problem]:
    """Add entities to a network; return all problems.

    Entities without a problem are added even if other entities have problems. Other unknowns are
    given by kind and key, as ``Network.parameters`` has them.
    """
    problems: list[Problem] = []
    stated = [(kind, key, p) for kind, given in unknowns.items() for key, p in given.items()]
    adders: tuple[tuple[Callable[[Network, Any], None], Sequence[Any]], ...] = (
        (_add_camera, cameras),
        (_add_point, points),
        (_add_photo, photos),
        (_add_unknown, stated),
    )
    for add, items in adders:
        for item in items:
            try:
                add(network, item)
            except InputError as error:
                problems.extend(error.problems)
            except (AttributeError, TypeError, ValueError) as error:
                problems.append(Problem(f"is no such thing: {error}", repr(item)[:80]))
    return problems


def _add_camera(network: Network, camera: Camera) -> None:
    parts = list(zip(camera.lens.names, camera.fixed, camera.sigma, strict=True))
    network.add_camera(
        camera.name,
        camera.lens,
        camera.values,
        free=[n for n, fixed, s in parts if not fixed and np.isinf(s)],
        sigma={n: s for n, fixed, s in parts if not fixed and np.isfinite(s)},
        unit=camera.unit,
        per_photo=camera.per_photo,
        format=camera.format,
        origin=camera.origin,
        y_down_in_files=camera.y_down_in_files,
        readout=camera.readout,
        readout_towards=camera.readout_towards,
    )


def _add_point(network: Network, point: Point) -> None:
    fixed: Any = point.fixed
    if not isinstance(fixed, str):
        fixed = point.held
    network.add_point(
        point.name,
        point.coordinates,
        fixed=fixed,
        sigma=point.sigma,
        datum=point.datum,
        check=point.check,
        side_shot=point.side_shot,
    )


def _add_photo(network: Network, photo: Photo) -> None:
    network.add_photo(
        photo.name,
        photo.camera,
        position=photo.position,
        rotation=photo.rotation,
        fixed=photo.fixed,
        sigma_position=photo.sigma_position,
        sigma_attitude=photo.sigma_attitude,
    )


def _add_unknown(network: Network, given: tuple[VariableKind, Key, Parameter]) -> None:
    """State a finished unknown, whose own numbers were checked when it was made."""
    kind, key, p = given
    record = UNKNOWNS.get(kind)
    if record is None or record.table is None:
        valid = known([k.name for k in UNKNOWNS.values() if k.table is not None], meant=kind)
        raise InputError(Problem(f"unknown kind {kind!r}; valid: {valid}", "unknowns"))
    keys = (key,) if not isinstance(key, tuple) else key
    nameless = record.table.keys == ("name",) and record.default is not None
    texts = all(isinstance(k, str) and (k or nameless) for k in keys)
    if len(keys) != len(record.table.keys) or not texts:
        what = f"it is named by {' and '.join(record.table.keys)}, not by {key!r}"
        raise InputError(Problem(what, record.noun))
    where = f"{record.noun} {parameter_name(key)!r}"
    refuse_control_characters(keys, record.noun)
    if key in network.of_kind(kind):
        raise InputError(Problem("is stated already", where))
    if not isinstance(p, Parameter):
        what = f"is no Parameter: {p!r:.60}; a scratch network makes them, by its methods"
        raise InputError(Problem(what, where))
    if not len(p.values) == len(p.fixed) == len(p.sigma) <= record.size:
        raise InputError(Problem(f"it needs {record.size} values, not {len(p.values)}", where))
    if record.in_photo:
        network.check_readout(str(keys[0]), where)
    for point in (*keys[:1], p.origin) if record.at_point else (p.origin,):
        if point:
            required(point, network.points, "point", where)
    network.of_kind(kind)[key] = p
