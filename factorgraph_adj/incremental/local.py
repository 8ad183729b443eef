"""The part of a network that some observations touch, with what is known held.

It is a network like any other: the models, the search for approximate values and the adjustment
of small parts are those of every network.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State, calibration_name
from ..models.variables import ENTITIES, UNKNOWNS, VariableKind, parameter_kinds
from ..network.entities import FREE_ORIENTATION, Camera, ImageTable, Parameter, parameter_name
from ..network.network import DatumChoice, Network
from ..solve.solution import Solution
from ..types import Array
from .register import Register
from .units import Unit, components

HELD = (True, True, True)


def local_network(
    network: Network, register: Register, units: Iterable[Unit], *, datum: DatumChoice = "given"
) -> Network:
    """Return the network of some units; variables that are known are held where they are.

    A camera with a calibration for each photo becomes one camera for each photo, of the name
    that its calibration has among the unknowns.
    """
    chosen = list(units)
    out = Network(network.name, frame=network.frame, datum=datum)
    variables = dict.fromkeys(v for u in chosen for v in u.variables)
    poses: list[str] = []
    for kind, name in variables:
        if kind == "point":
            _take_point(out, network, register, name)
        elif kind == "pose":
            poses.append(name)
        elif kind not in ENTITIES and UNKNOWNS[kind].absent != "found":
            given = network.of_kind(kind)
            compound = (k for k in given if not isinstance(k, str) and parameter_name(k) == name)
            key = name if name in given else next(compound, None)
            if key is not None:
                out.of_kind(kind)[key] = _small(register, kind, name, given[key])
    for name in out.verticals:
        # A vertical needs its station; horizons turn with it.
        if name not in out.points:
            _take_point(out, network, register, name)
    for name in poses:
        _take_photo(out, network, register, name)
    for unit in chosen:
        out.add(unit.item)
    for kind in (k.name for k in parameter_kinds() if k.absent == "found"):
        found, given = out.of_kind(kind), network.of_kind(kind)
        for key in found:
            parameter = given.get(key, FREE_ORIENTATION)
            found[key] = _small(register, kind, parameter_name(key), parameter)
    return out


def _take_point(out: Network, network: Network, register: Register, name: str) -> None:
    point = network.points[name]
    value = _value(register, "point", name)
    if value is not None:
        point = replace(point, coordinates=tuple(value.tolist()), fixed=HELD, sigma=None)
    out.points[name] = point
    out._point_number[name] = len(out._point_number)


def _take_photo(out: Network, network: Network, register: Register, name: str) -> None:
    photo = network.photos[name]
    camera = network.cameras[photo.camera]
    calibration = f"{camera.name}@{name}" if camera.per_photo else camera.name
    if calibration not in out.cameras:
        out.cameras[calibration] = _camera(register, camera, calibration)
    value = _value(register, "pose", name)
    if value is not None:
        photo = replace(
            photo,
            position=tuple(value[9:].tolist()),
            rotation=value[:9].reshape(3, 3),
            fixed=(True,) * 6,
            sigma_position=None,
            sigma_attitude=None,
        )
    out.photos[name] = replace(photo, camera=calibration)
    out._photo_number[name] = len(out._photo_number)


def _camera(register: Register, camera: Camera, name: str) -> Camera:
    value = _value(register, "calibration", name)
    if value is None:
        return replace(camera, name=name, per_photo=False)
    k = len(camera.values)
    return replace(
        camera,
        name=name,
        per_photo=False,
        values=tuple(value[:k].tolist()),
        fixed=(True,) * k,
        sigma=(np.inf,) * k,
    )


def _small(register: Register, kind: VariableKind, name: str, given: Parameter) -> Parameter:
    value = _value(register, kind, name)
    if value is None:
        return given
    k = len(given.values)
    value = UNKNOWNS[kind].given(value[None])[0]
    return Parameter(tuple(value[:k].tolist()), (True,) * k, (np.inf,) * k)


def _value(register: Register, kind: VariableKind, name: str) -> Array | None:
    """Return where a variable is, none while it is not known."""
    table = register[kind]
    number = table.number.get(name)
    if number is None or not table.known.view[number]:
        return None
    return np.array(table.value.view[number])


def known_network(network: Network, register: Register) -> Network:
    """Return the network without the unknowns that are not known yet; its observations stay."""

    def stays(kind: VariableKind, name: str) -> bool:
        return register.known(kind, name) or not components(network, (kind, name))[0]

    return filtered(network, stays)


def filtered(network: Network, stays: Callable[[VariableKind, str], bool]) -> Network:
    """Return the network without some of its unknowns; its observations stay.

    Args:
        network: the network.
        stays: whether an unknown stays, by kind and name.
    """
    out = network.copy()
    photos = [
        n
        for n in network.photos
        if stays("pose", n) and stays("calibration", calibration_name(network, n))
    ]
    points = [n for n in network.points if stays("point", n)]
    if len(photos) < len(network.photos) or len(points) < len(network.points):
        _keep(out, photos, points)
    used = {f.camera for f in out.photos.values()}
    out.cameras = {n: c for n, c in network.cameras.items() if n in used or stays("calibration", n)}
    for kind in parameter_kinds():
        out.parameters[kind.name] = {
            k: p
            for k, p in network.of_kind(kind.name).items()
            if stays(kind.name, parameter_name(k))
            and (not kind.at_point or (k if isinstance(k, str) else k[0]) in out.points)
        }
    return out


def _keep(network: Network, photos: list[str], points: list[str]) -> None:
    """Keep some photos and points; image points are numbered anew."""
    of_photo, of_point, xy, sigma = network.images.columns()
    ids, sources = network.images.ids, network.images.sources
    photo_number, point_number = ({n: i for i, n in enumerate(names)} for names in (photos, points))
    new_photo = np.array([photo_number.get(n, -1) for n in network.photos], dtype=np.intp)
    new_point = np.array([point_number.get(n, -1) for n in network.points], dtype=np.intp)
    network.images = ImageTable()
    network.images.append(new_photo[of_photo], new_point[of_point], xy, sigma)
    network.images.ids, network.images.sources = dict(ids), dict(sources)
    network.photos = {n: network.photos[n] for n in photos}
    network.points = {n: network.points[n] for n in points}
    network._photo_number, network._point_number = photo_number, point_number


def local_state(equations: Equations, register: Register, found: State | None = None) -> State:
    """Return the state of a local network: what is known from the register, the rest ``found``."""
    state = {k: v.copy() for k, v in (found or equations.unknowns.start()).items()}
    for kind, theirs in equations.unknowns.tables.items():
        table = register[kind]
        for i, name in enumerate(theirs.names):
            number = table.number.get(name)
            if number is not None and table.known.view[number]:
                width = min(state[kind].shape[1], table.value.view.shape[1])
                state[kind][i, :width] = table.value.view[number, :width]
    return state


def starting_state(
    equations: Equations, register: Register, found: Iterable[Solution]
) -> tuple[State, State]:
    """Return where the variables are, from the register or what was ``found``, and x₀."""
    unknowns = equations.unknowns
    state = given = unknowns.start()
    for part in found:
        there = part.equations.unknowns
        state = unknowns.carried(state, there, part.state)
        given = unknowns.carried(given, there, part.start)
    return local_state(equations, register, state), given


def describe(units: Sequence[Unit], variable: tuple[VariableKind, str]) -> str:
    """Say what observes a variable: ``2 image rays, 1 direction``."""
    counts: dict[str, int] = {}
    for unit in units:
        for o in unit.observations:
            counts[o.kind] = counts.get(o.kind, 0) + 1
    words = {"image": "image ray" if variable[0] == "point" else "image point"}
    return ", ".join(
        f"{n} {words.get(k, k.replace('_', ' '))}{'s' * (n > 1)}" for k, n in counts.items()
    )
