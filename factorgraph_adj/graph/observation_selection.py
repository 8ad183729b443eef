"""Networks with some observations alone, or without some; without some unknowns, points, photos."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ..entities import Key, Parameter, parameter_name
from ..errors import InputError, Problem, known, taking
from ..models.unknown_registry import UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import Network
from ..observations import Observation
from ..types import Array, Mask
from .block_construction import weighted_blocks
from .image_ids import find_images
from .variables import Unknowns, calibration_name

Stated: TypeAlias = tuple[VariableKind, Key]
"""A parameter: its kind and its key in the network."""
Weighted: TypeAlias = tuple[VariableKind, str, int]
"""Kind, name and component of a weighted unknown; component −1 means a whole attitude."""


@taking(Network)
def without(
    network: Network,
    ids: Iterable[str],
    *,
    points: Iterable[str] = (),
    photos: Iterable[str] = (),
) -> Network:
    """Return a new network without some observations; ``network`` stays unchanged.

    The remaining observations of a correlated group keep their part of the covariance. A doubt
    about readings ends with an observation that was made from them. A free
    orientation unknown, refraction group, vertical or distance meter is removed together with
    its last observation; held and weighted parameters stay. A weighted unknown is an observation
    of its given value; without this observation the unknown is free.

    Args:
        network: network with the observations.
        ids: ids of observations, as in ``solution.observations``: image points by photo/point or
            their own id, weighted unknowns by names such as ``"point P1 x"``.
        points: points to remove together with all their observations, and with the frames that
            have their origin there.
        photos: photos to remove with their observations, and with cameras that took no others.

    Raises:
        InputError: the network lacks ids, points or photos; the message lists all of them.
    """
    ids, points, photos = ([x] if isinstance(x, str) else x for x in (ids, points, photos))
    wanted, lost, unseen = list(dict.fromkeys(ids)), dict.fromkeys(points), dict.fromkeys(photos)
    problems = [
        Problem(f"unknown point; known: {known(network.points, meant=p)}", f"point {p!r}")
        for p in lost
        if p not in network.points
    ]
    problems += [
        Problem(f"unknown photo; known: {known(network.photos, meant=p)}", f"photo {p!r}")
        for p in unseen
        if p not in network.photos
    ]
    gone = {i for i in wanted if i in network.observations}
    keep, in_images = _images(network, wanted)
    problems += [
        Problem(
            "both an image point and another observation have this id: give one of them another",
            f"observation {i!r}",
        )
        for i in wanted
        if i in gone and i in in_images
    ]
    rest = [i for i in wanted if i not in gone and i not in in_images]
    weights = weighted_unknowns(network) if rest else {}
    every = [*network.observations, *weights]
    rays = "; image points are photo/point" if network.n_image_points else ""
    problems += [
        Problem(
            f"unknown observation{rays}; known: {known(every, meant=i)}",
            f"observation {i!r}",
        )
        for i in rest
        if i not in weights
    ]
    if problems:
        raise InputError(problems)
    if lost:
        gone |= {
            i
            for i, o in network.observations.items()
            if not lost.keys().isdisjoint(o.points())
            or any(origin_of(network, kind, key) in lost for kind, key in o.parameters())
        }
    if unseen:
        taken = unseen.keys()
        gone |= {
            i
            for i, o in network.observations.items()
            if not taken.isdisjoint(o.photos())
            or any(UNKNOWNS[kind].in_photo and key in taken for kind, key in o.parameters())
        }
    out = network.copy()
    out.observations = {i: o for i, o in network.observations.items() if i not in gone}
    out.clusters = [c for group in network.clusters if (c := _remaining(network, group, gone))]
    out.doubts = [d for d in network.doubts if gone.isdisjoint(d.ids)]
    _drop_unobserved(out, [network.observations[i] for i in gone])
    for i in rest:
        _free(out, weights[i])
    if not keep.all():
        out.image_mask(keep)
    if lost:
        _drop_points(out, lost)
    if unseen:
        _drop_photos(out, unseen)
    return out


def only(
    network: Network,
    name: str,
    observations: Collection[str],
    images: Mask,
    unknowns: Mapping[VariableKind, Collection[str]],
) -> Network:
    """Return a new network with some observations, and with what they name.

    Args:
        network: network with the observations.
        name: name of the new network.
        observations: ids of observations other than image points.
        images: whether each row of the image table stays, (n,).
        unknowns: names of the unknowns that the new network has besides, by kind.
    """
    wanted = {kind: set(names) for kind, names in unknowns.items()}
    out = Network(name, frame=network.frame, datum=network.datum, crs=network.crs)
    out.observations = {i: o for i, o in network.observations.items() if i in observations}
    out.clusters = [group for group in network.clusters if group[0][0] in observations]
    for o in out.observations.values():
        wanted["point"].update(o.points())
        wanted["pose"].update(o.photos())
        for kind, key in o.parameters():
            wanted[kind].add(parameter_name(key))
            if (origin := origin_of(network, kind, key)) is not None:
                wanted["point"].add(origin)
    for kind in (k.name for k in parameter_kinds() if k.in_photo):
        wanted["pose"].update(n for n in wanted.get(kind, ()) if n in network.photos)
    out.photos = {n: f for n, f in network.photos.items() if n in wanted["pose"]}
    cameras = {f.camera for f in out.photos.values()} | wanted["calibration"]
    out.cameras = {n: c for n, c in network.cameras.items() if n in cameras}
    out.points = {n: p for n, p in network.points.items() if n in wanted["point"]}
    for kind, table in network.parameters.items():
        named = wanted.get(kind, set())
        out.of_kind(kind).update({k: p for k, p in table.items() if parameter_name(k) in named})
    out.point_number = {n: i for i, n in enumerate(out.points)}
    out.photo_number = {n: i for i, n in enumerate(out.photos)}
    out.images = network.images.kept(images)
    for numbers, old, new in (
        (out.images.photo, network.photos, out.photo_number),
        (out.images.point, network.points, out.point_number),
    ):
        place = np.array([new.get(n, -1) for n in old], dtype=np.intp)
        numbers[:] = [place[each] for each in numbers]
    return out


def weighted_unknowns(network: Network) -> dict[str, Weighted]:
    """Return the weighted unknowns by the ids that they have in ``solution.observations``."""
    out: dict[str, Weighted] = {}
    unknowns = Unknowns(network)
    for block in weighted_blocks(unknowns):
        kind, numbers = block.variables[0]
        names = unknowns[kind].names
        for i, (ident, number) in enumerate(zip(block.ids, numbers.tolist(), strict=True)):
            if block.dimension > 1:
                component = -1
            elif "which" in block.constants:
                component = int(block.constants["which"][i])
            else:
                component = int(np.argmax(block.constants["axis"][i]))
            out[ident] = (kind, names[number], component)
    return out


def origin_of(network: Network, kind: VariableKind, key: Key) -> str | None:
    """Return the point at the origin of an unknown; none: it has none there."""
    stated = network.of_kind(kind).get(key)
    return stated.origin or None if stated is not None else None


def _images(network: Network, ids: list[str]) -> tuple[Mask, set[str]]:
    """Return flags of the rows of the image table that stay, and the ids of the other rows."""
    photo, point, *_ = network.images.columns()
    keep = np.ones(len(photo), dtype=bool)
    if not len(photo):
        return keep, set()
    own = {ident: row for row, ident in network.images.ids.items()}
    rows = find_images(photo, point, list(network.photos), list(network.points), own, ids)
    keep[rows[rows >= 0]] = False
    return keep, {ids[i] for i in np.flatnonzero(rows >= 0)}


def _remaining(
    network: Network, group: tuple[tuple[str, ...], Array], gone: set[str]
) -> tuple[tuple[str, ...], Array] | None:
    """Return a correlated group without the ids ``gone``; None if no observation is left."""
    ids, covariance = group
    if gone.isdisjoint(ids):
        return group
    stays = [i not in gone for i in ids]
    if not any(stays):
        return None
    sizes = [len(network.observations[i].component_names()) for i in ids]
    rows = np.flatnonzero(np.repeat(stays, sizes))
    left = tuple(i for i, s in zip(ids, stays, strict=True) if s)
    return left, covariance[np.ix_(rows, rows)]


def _drop_unobserved(network: Network, gone: list[Observation]) -> None:
    """Remove the free parameters on which only the observations ``gone`` depended."""
    loose = {
        (kind, key)
        for o in gone
        for kind, key in o.parameters()
        if key in (table := network.of_kind(kind))
        and _is_free(table[key])
        # A photo without its motion would stand still, which nobody has said.
        and not UNKNOWNS[kind].in_photo
    }
    if loose:
        for o in network.observations.values():
            loose.difference_update(o.parameters())
    for kind, key in loose:
        del network.of_kind(kind)[key]


def _is_free(p: Parameter) -> bool:
    return any(not f and s == np.inf for f, s in zip(p.fixed, p.sigma, strict=True))


def _free(network: Network, weighted: Weighted) -> None:
    """Remove the weight of a weighted unknown."""
    kind, name, component = weighted
    if kind == "point":
        point = network.points[name]
        assert point.sigma is not None
        sigma = _infinite(point.sigma, component)
        left = None if np.isinf(sigma).all() else sigma
        network.points[name] = replace(point, sigma=left)  # type: ignore[arg-type]
    elif kind == "pose":
        photo = network.photos[name]
        if component < 0:
            network.photos[name] = replace(photo, sigma_attitude=None)
            return
        assert photo.sigma_position is not None
        sigma = _infinite(photo.sigma_position, component)
        left = None if np.isinf(sigma).all() else sigma
        network.photos[name] = replace(photo, sigma_position=left)  # type: ignore[arg-type]
    elif kind == "calibration":
        camera = network.cameras.get(name)
        if camera is None:
            raise InputError(
                Problem(
                    "the weights of a camera with a calibration for each photo hold for all its "
                    "photos: none can be taken from one alone",
                    f"{kind} {name!r}",
                )
            )
        network.cameras[name] = replace(camera, sigma=_infinite(camera.sigma, component))
    else:
        table = network.of_kind(kind)
        key = next(k for k in table if parameter_name(k) == name)
        sigma = table[key].sigma
        for i in range(3) if component < 0 else (component,):
            sigma = _infinite(sigma, i)
        table[key] = replace(table[key], sigma=sigma)


def _infinite(sigma: tuple[float, ...], component: int) -> tuple[float, ...]:
    return tuple(np.inf if i == component else s for i, s in enumerate(sigma))


def _drop_points(network: Network, lost: Iterable[str]) -> None:
    """Remove points, their image points, and the parameters stated for them as stations."""
    stays = np.array([name not in set(lost) for name in network.points], dtype=bool)
    network.image_mask(stays[network.images.columns()[1]])
    number = np.cumsum(stays) - 1
    network.images.point = [number[p] for p in network.images.point]
    for name in lost:
        del network.points[name]
        for kind in (k.name for k in parameter_kinds() if k.at_point):
            table = network.of_kind(kind)
            for key in [k for k in table if name == (k if isinstance(k, str) else k[0])]:
                del table[key]
        for each in parameter_kinds():
            table = network.of_kind(each.name)
            for key in [k for k, p in table.items() if p.origin == name]:
                del table[key]
    network.point_number = {name: i for i, name in enumerate(network.points)}


def _drop_photos(network: Network, lost: Iterable[str]) -> None:
    """Remove photos with their image points, and the cameras that took no others."""
    gone = set(lost)
    cameras = {network.photos[name].camera for name in gone}
    stays = np.array([name not in gone for name in network.photos], dtype=bool)
    network.image_mask(stays[network.images.columns()[0]])
    keep_entities(network, [n for n in network.photos if n not in gone], list(network.points))
    for kind in (k.name for k in parameter_kinds() if k.in_photo):
        for name in gone & network.of_kind(kind).keys():
            del network.of_kind(kind)[name]
    for camera in cameras - {photo.camera for photo in network.photos.values()}:
        del network.cameras[camera]


def filtered(
    network: Network,
    stays: Callable[[VariableKind, str], bool],
    *,
    inside: Mapping[VariableKind, Collection[str]] | None = None,
) -> Network:
    """Return the network without some of its unknowns; its observations stay.

    Args:
        network: the network.
        stays: whether an unknown stays, by kind and name.
        inside: names of the unknowns, by kind, that stay in any case; none: there are none.
    """
    known: Mapping[VariableKind, Collection[str]] = {} if inside is None else inside

    def keep(kind: VariableKind, name: str) -> bool:
        return name in known.get(kind, ()) or stays(kind, name)

    out = network.copy()
    photos = [
        n
        for n in network.photos
        if keep("pose", n) and keep("calibration", calibration_name(network, n))
    ]
    placed = known.get("point", ())
    points = [n for n in network.points if n in placed or stays("point", n)]
    if len(photos) < len(network.photos) or len(points) < len(network.points):
        keep_entities(out, photos, points)
    used = {f.camera for f in out.photos.values()}
    out.cameras = {n: c for n, c in network.cameras.items() if n in used or keep("calibration", n)}
    for kind in parameter_kinds():
        out.parameters[kind.name] = {
            k: p
            for k, p in network.of_kind(kind.name).items()
            if keep(kind.name, parameter_name(k))
            and (not kind.at_point or (k if isinstance(k, str) else k[0]) in out.points)
            and (not kind.in_photo or k in out.photos)
        }
    return out


def keep_entities(network: Network, photos: Sequence[str], points: Sequence[str]) -> None:
    """Keep some photos and points; image points are numbered anew."""
    of_photo, of_point, *_ = network.images.columns()
    photo_number, point_number = ({n: i for i, n in enumerate(names)} for names in (photos, points))
    new_photo = np.array([photo_number.get(n, -1) for n in network.photos], dtype=np.intp)
    new_point = np.array([point_number.get(n, -1) for n in network.points], dtype=np.intp)
    network.images = network.images.with_columns(
        photo=new_photo[of_photo], point=new_point[of_point]
    )
    network.photos = {n: network.photos[n] for n in photos}
    network.points = {n: network.points[n] for n in points}
    network.photo_number, network.point_number = photo_number, point_number
