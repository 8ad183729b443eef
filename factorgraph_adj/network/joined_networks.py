"""Several networks of one object as one, and GNSS vectors in a reference frame of their own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from ..entities import Key, Parameter, Point, parameter_name
from ..errors import Doubt, InputError, Problem, known, taking
from ..frames import Frame, LocalFrame
from ..models.unknown_registry import UNKNOWNS, parameter_kinds
from ..observations import FrameVector, Observation
from ..observations.base import joined_points
from .network import Network

SAME_RADIUS = 1e-5
"""Largest relative difference of two radii of the Earth that are one: programs have 6 371 000 or
6 371 007 m. It changes the curvature d²/2R over 1 km by less than 1 µm."""
Sets: TypeAlias = Literal["apart", "same"]
"""Whether sets of one name at one station, in several networks, are set-ups of their own."""
SetUp: TypeAlias = tuple[str, str]
"""Station and set."""
_AXES = ("x", "y", "z")
ZERO = {"rx": 0.0, "ry": 0.0, "rz": 0.0}
"""Start of rotations between reference frames, radians: they are seconds of arc."""


def join(networks: Iterable[Network], *, name: str | None = None, sets: Sets = "apart") -> Network:
    """Return one network of several of the same object.

    A point is one point wherever its name is. Its coordinates are those of the network that holds
    or weights them, otherwise those of the first that has any. Plan coordinates of a network of
    heights, where every point is held in x and y, and heights of a network in plan give way to
    those of the others. Everything else that two networks state of one name must agree.

    Observations keep their ids. Where an id is there already, the name of the network comes before
    it; ids that nobody stated are numbered on.

    Args:
        networks: the networks, in one frame: a geocentric network of GNSS vectors joins one in a
            grid after ``from_grid(network, crs, frame="geocentric")``.
        name: name of the result; None: their names, joined.
        sets: ``apart``: a set of directions whose station and name an earlier network has is
            another set-up with an orientation of its own, and gets the next number, and so do the
            errors of circles of this set-up; ``same``: it is one set, as in the parts of a
            network.

    Raises:
        InputError: no network, different frames or reference systems, points, cameras, photos or
            further unknowns that are stated differently; all of them are listed.
    """
    given = [n.with_listed_points() if isinstance(n, Network) else n for n in networks]
    if not given or not all(isinstance(n, Network) for n in given):
        raise InputError("join takes a list of networks: join([first, second])")
    if sets not in (valid := ("apart", "same")):
        raise InputError(f"unknown sets {sets!r}; valid: {known(valid, meant=str(sets))}")
    labels = _labels(given)
    problems = [*_frames(given, labels)]
    free = all(n.datum == "free" for n in given)
    out = Network(
        " + ".join(labels) if name is None else name,
        frame=given[0].frame,
        datum="free" if free else "given",
        crs=next((n.crs for n in given if n.crs is not None), None),
    )
    out.points = _points(given, labels, problems)
    out.point_number = {n: i for i, n in enumerate(out.points)}
    for network, label in zip(given, labels, strict=True):
        new = _new_sets(out, network) if sets == "apart" else {}
        _photos(out, network, label, problems)
        _parameters(out, network, label, new, problems)
        _observations(out, network, label, new)
    problems += _defaults(out, given, labels)
    if problems:
        raise InputError(problems)
    return out


def _labels(networks: Sequence[Network]) -> list[str]:
    """Return a name for each network, different from those of the others."""
    names = [n.name or f"network {i}" for i, n in enumerate(networks, 1)]
    return [f"{n} ({i})" if names.count(n) > 1 else n for i, n in enumerate(names, 1)]


def _frames(networks: Sequence[Network], labels: Sequence[str]) -> Iterable[Problem]:
    """Iterate over networks in another frame or reference system than the first that has one."""
    first = networks[0].frame
    system = None
    for network, label in zip(networks, labels, strict=True):
        if not _same(network.frame, first):
            what = f"is in another frame than {labels[0]!r} ({_apart(network.frame, first)}"
            yield Problem(what, f"network {label!r}")
        system = network.crs if system is None else system
        if network.crs is not None and network.crs != system:
            what = f"has another reference system: {network.crs}, {system}"
            yield Problem(what, f"network {label!r}")


def _same(frame: Frame, first: Frame) -> bool:
    """Return whether two frames are one, up to the mean radius of the Earth of two programs."""
    if isinstance(frame, LocalFrame) and isinstance(first, LocalFrame):
        near = abs(frame.radius - first.radius) <= SAME_RADIUS * first.radius
        return near and replace(frame, radius=first.radius) == first
    return frame == first


def _apart(frame: Frame, first: Frame) -> str:
    """Return what differs in two frames, and what helps."""
    if type(frame) is not type(first):
        return (
            f"{frame}, {first}): move one of them, such as "
            "from_grid(network, crs, frame='geocentric'), or with --crs"
        )
    differ = [f.name for f in fields(frame) if getattr(frame, f.name) != getattr(first, f.name)]
    own = ", ".join(f"{n}={getattr(frame, n)!r}" for n in differ)
    others = ", ".join(f"{n}={getattr(first, n)!r}" for n in differ)
    return f"{own} and not {others}): both must state the same"


def _idle(network: Network) -> tuple[bool, ...]:
    """Return the components that a network holds of every point because it has no use for them.

    A list of points has no observations: what it holds is control.
    """
    if not network.observations and not network.n_image_points:
        return (False,) * 3
    every = tuple(
        all(held) for held in zip(*(p.fixed for p in network.points.values()), strict=True)
    )
    return (False,) * 3 if all(every) else every


@dataclass(frozen=True)
class _Stated:
    """A component of a point in one network."""

    label: str
    """Name of the network."""
    value: float
    """Coordinate, metres; NaN where unknown."""
    fixed: bool
    """Whether it is held."""
    sigma: float
    """Standard deviation, metres; infinite unless weighted."""
    idle: bool
    """Whether the network holds it of every point."""
    observed: bool
    """Whether the network observes the point."""

    @property
    def binds(self) -> bool:
        """Whether it is held or weighted for the adjustment."""
        return not self.idle and (self.fixed or self.sigma < np.inf)

    def alike(self, other: _Stated) -> bool:
        """Return whether both state the same."""
        return (self.value, self.fixed, self.sigma) == (other.value, other.fixed, other.sigma)


def _points(
    networks: Sequence[Network], labels: Sequence[str], problems: list[Problem]
) -> dict[str, Point]:
    """Return the points of all networks."""
    idle = [_idle(n) for n in networks]
    observed = [_observed_points(n) for n in networks]
    out = {}
    for name in dict.fromkeys(n for network in networks for n in network.points):
        own = [
            (network.points[name], label, flags, name in seen)
            for network, label, flags, seen in zip(networks, labels, idle, observed, strict=True)
            if name in network.points
        ]
        if len(own) == 1:
            out[name] = own[0][0]
            continue
        chosen = []
        for i, axis in enumerate(_AXES):
            given = [
                _Stated(
                    label, p.coordinates[i], p.fixed[i], (p.sigma or (np.inf,) * 3)[i], f[i], seen
                )
                for p, label, f, seen in own
            ]
            chosen.append(_component(given, f"point {name!r}", axis, problems))
        checks = {p.check: label for p, label, *_ in own if p.check is not None}
        if len(checks) > 1:
            what = f"has different check coordinates in {' and '.join(map(repr, checks.values()))}"
            problems.append(Problem(what, f"point {name!r}"))
        sigma = tuple(c.sigma for c in chosen)
        x, y, z = (c.value for c in chosen)
        a, b, c = (c.fixed for c in chosen)
        out[name] = Point(
            name,
            (x, y, z),
            (a, b, c),
            None if np.isinf(sigma).all() else (sigma[0], sigma[1], sigma[2]),
            any(p.datum for p, *_ in own),
            next(iter(checks), None),
            # What another network determines as well is no side shot of the whole.
            all(p.side_shot for p, *_ in own) and len(own) == 1,
        )
    return out


def _component(given: Sequence[_Stated], where: str, axis: str, problems: list[Problem]) -> _Stated:
    """Return one component of a point from those of the networks."""
    binding = [c for c in given if c.binds]
    for other in binding[1:]:
        if not other.alike(binding[0]):
            statements = " and ".join(
                f"{_statement(c)} in {c.label!r}" for c in (binding[0], other)
            )
            what = f"{axis} is {statements}: let one network hold or weight it"
            problems.append(Problem(what, where))
    if binding:
        return binding[0]
    # A list that does not know a component of a point does not ask for it: a bench mark of a list
    # of heights stays where the levelled line has it in plan.
    used = [c for c in given if not c.idle and (c.observed or c.value == c.value)]
    used = used or [c for c in given if c.idle] or list(given)
    return next((c for c in used if c.value == c.value), used[0])


def _observed_points(network: Network) -> set[str]:
    """Return the names of the points that a network observes."""
    out = joined_points(network.observations.values())
    if network.n_image_points:
        names = list(network.points)
        out |= {names[i] for i in np.unique(network.images.columns()[1]).tolist()}
    return out


def _statement(c: _Stated) -> str:
    """Return a held or weighted value as text."""
    return f"{c.value:.10g} m, {'held' if c.fixed else f'σ {1e3 * c.sigma:.4g} mm'}"


def _set_ups(network: Network) -> list[SetUp]:
    """Return stations and sets for which the network has orientations or errors of circles."""
    out: dict[SetUp, None] = {}
    for kind in parameter_kinds():
        for key in network.of_kind(kind.name):
            if kind.absent == "found" and not isinstance(key, str):
                out[key[0], key[1]] = None
            elif isinstance(key, str) and kind.instrument and "/" in key:
                station, number = key.rsplit("/", 1)
                if station in network.points:
                    out[station, number] = None
    return list(out)


def _new_sets(out: Network, network: Network) -> dict[SetUp, str]:
    """Return new names of the sets whose station and name the joined network has already."""
    there, own = set(_set_ups(out)), _set_ups(network)
    taken = there | set(own)
    new: dict[SetUp, str] = {}
    for station, number in own:
        if (station, number) not in there:
            continue
        i = 2
        while (station, str(i)) in taken:
            i += 1
        new[station, number] = str(i)
        taken.add((station, str(i)))
    return new


def _renamed(key: Key, new: Mapping[SetUp, str]) -> Key:
    """Return the key of an unknown with the new name of its set-up."""
    if isinstance(key, str):
        station, _, number = key.rpartition("/")
        return f"{station}/{new[station, number]}" if (station, number) in new else key
    station, number = key[0], key[-1]
    return (station, new[station, number]) if (station, number) in new else key


def _photos(out: Network, network: Network, label: str, problems: list[Problem]) -> None:
    """Add cameras, photos and image points."""
    for name, camera in network.cameras.items():
        if out.cameras.setdefault(name, camera) != camera:
            what = f"is stated differently in {label!r}: give one of them another name"
            problems.append(Problem(what, f"camera {name!r}"))
    for name, photo in network.photos.items():
        if name in out.photos:
            what = f"is in {label!r} and in a network before: give one of them another name"
            if not (network.n_image_points or out.n_image_points):
                what += (
                    "; join does not know whether both are one pose: if they are, in Python "
                    "first.add(*second.observations.values()) adds what was observed of it"
                )
            problems.append(Problem(what, f"photo {name!r}"))
            continue
        out.photo_number[name] = len(out.photo_number)
        out.photos[name] = photo
    if not network.n_image_points:
        return
    of_photo = np.array([out.photo_number[n] for n in network.photos], dtype=np.intp)
    of_point = np.array([out.point_number[n] for n in network.points], dtype=np.intp)
    out.images.take_over(network.images, of_photo, of_point)


def _parameters(
    out: Network,
    network: Network,
    label: str,
    new: Mapping[SetUp, str],
    problems: list[Problem],
) -> None:
    """Add further unknowns; those of one name must be stated alike."""
    for kind in parameter_kinds():
        table = out.of_kind(kind.name)
        for old, parameter in network.of_kind(kind.name).items():
            key = old if kind.in_photo else _renamed(old, new)
            there = table.setdefault(key, parameter)
            if not _alike(there, parameter):
                what = f"is stated differently in {label!r}: {_values(there)}, {_values(parameter)}"
                problems.append(Problem(what, f"{kind.noun} {parameter_name(key)!r}"))


def _alike(one: Parameter, two: Parameter) -> bool:
    """Return whether two parameters state the same; NaN agrees with NaN."""
    numbers = zip(
        (*one.values, *one.sigma, *one.constants),
        (*two.values, *two.sigma, *two.constants),
        strict=False,
    )
    return (
        (one.fixed, one.origin, len(one.constants)) == (two.fixed, two.origin, len(two.constants))
    ) and all(a == b or (a != a and b != b) for a, b in numbers)


def _values(p: Parameter) -> str:
    """Return what is stated of a parameter, as text."""
    held = "held" if all(p.fixed) else "free" if not any(p.fixed) else "held in part"
    return f"{', '.join(f'{v:.6g}' for v in p.values)} ({held})"


def _observations(out: Network, network: Network, label: str, new: Mapping[SetUp, str]) -> None:
    """Add observations under ids that are free, correlated groups, and doubts."""
    ids: dict[str, str] = {}
    for old, o in network.observations.items():
        ids[old] = out.insert(_as_named(o, out, label, new))
    out.clusters += [(tuple(ids[i] for i in group), q) for group, q in network.clusters]
    out.left_out += network.left_out
    out.remarks += network.remarks
    for doubt in network.doubts:
        out.doubts.append(Doubt(doubt.what, doubt.where, tuple(ids[i] for i in doubt.ids)))


def _as_named(o: Observation, out: Network, label: str, new: Mapping[SetUp, str]) -> Observation:
    """Return an observation with a free id and the names of its set-up in the joined network."""
    changes: dict[str, str] = {}
    ident = o.id
    if ident is not None and ident in out.observations:
        changes["id"] = f"{label}/{ident}"
    for (kind, attribute), (_, key) in zip(o.record.parameters, o.parameters(), strict=False):
        # Names of photos are no set-ups, even if they look like station/set.
        renamed = key if UNKNOWNS[kind].in_photo else _renamed(key, new)
        if renamed != key:
            found = UNKNOWNS[kind].absent == "found"
            changes[attribute] = renamed[1] if found else str(renamed)
    return replace(o, **changes) if changes else o


def _defaults(
    out: Network, networks: Sequence[Network], labels: Sequence[str]
) -> Iterable[Problem]:
    """Iterate over unknowns that one network states, while observations of another rely on none.

    A coefficient of refraction that one network states for all its sights would act on the
    sights of another network, which had none.
    """
    for network, label in zip(networks, labels, strict=True):
        used = {pair for o in network.observations.values() for pair in o.parameters()}
        for kind, key in sorted(used, key=str):
            record = UNKNOWNS[kind]
            if (
                record.default is None
                or record.at_point
                or record.in_photo
                or key in network.of_kind(kind)
            ):
                continue
            stated = out.of_kind(kind).get(key)
            if stated is not None and stated.values != record.default:
                what = (
                    f"its observations have no {record.noun} {parameter_name(key)!r}, which "
                    f"another network states as {_values(stated)}: state it in both"
                )
                yield Problem(what, f"network {label!r}")


@taking(Network)
def vectors_in_own_datum(
    network: Network,
    name: str = "GNSS",
    *,
    free: Iterable[str] = ("rotation", "scale"),
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    ids: Iterable[str] | None = None,
) -> Network:
    """Return the network with GNSS vectors in a frame whose rotation and scale are unknown.

    Each `GnssVector` becomes a `FrameVector` of the same id, covariance and source, along the same
    axes; X_j − X_i = e^ℓ R d, with the rotation vector of R about the axes of the network, which in
    geocentric networks are geocentric. Vectors of several systems get a frame each: call it for
    each of them.

    Args:
        network: the network, in a geocentric or topocentric frame, or a local one.
        name: name of the new frame.
        free: components that are unknown: ``rotation``, ``scale``, or some of rx, ry, rz, ln_scale.
        sigma: standard deviations of weighted components, radians; ln_scale is a ratio.
        values: values of components; those that are not stated are 0.
        ids: ids of the vectors; None: all GNSS vectors.

    Raises:
        InputError: there is no such vector, one has heights of antennas, or the frame is there.
    """
    every: dict[str, Any] = {
        i: o for i, o in network.observations.items() if o.record.quantity == "vector"
    }
    wanted = list(every) if ids is None else list(ids)
    problems = [
        Problem(f"there is no GNSS vector {i!r}; known: {known(every)}")
        for i in wanted
        if i not in every
    ]
    problems += [
        Problem("has heights of antennas: reduce it to the marks", every[i].label())
        for i in wanted
        if i in every and (every[i].instrument_height or every[i].target_height)
    ]
    if not wanted:
        problems.append(Problem("has no GNSS vectors", network.name))
    if problems:
        raise InputError(problems)
    out = network.copy()
    out.add_frame(name, free=free, values={**ZERO, **(values or {})}, sigma=sigma)
    for i in wanted:
        o = every[i]
        out.observations[i] = FrameVector(
            name,
            o.station,
            o.target,
            o.value,
            sigma=o.sigma,
            covariance=o.covariance,
            id=o.id,
            source=o.source,
        )
    return out
