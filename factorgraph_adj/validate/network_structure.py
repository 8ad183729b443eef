"""Structure of a network: connected parts, datum, and geometry of given values.

The checks need no solution and report all problems at once. A network that passes can still fail
in the adjustment, because of its rank or of poor start values.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import InputError, Problem, known
from ..frames import GeocentricFrame
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_network
from ..graph.variables import Unknowns, Variables
from ..models.variables import UNKNOWNS
from ..network.network import Network
from ..solve.datum_defects import connected_parts
from ..start.image_axes import problems_of_marks
from ..types import Array, Index, Mask
from .observation_counts import (
    Sources,
    frame_problems,
    located_names,
    photo_problems,
    point_problems,
    shape_problems,
    unobserved_problems,
)

DATUM_AXES = ("x", "y", "z")
MIN_GEOCENTRIC_RADIUS_M = 6_300_000.0
"""Smallest distance from the centre of the Earth, metres; measured points are farther away."""


def _label_of(table: Variables, label: Index, numbers: Index) -> Index:
    """Return the connected part of each variable, −1 for held or unobserved variables."""
    offset = table.offset[numbers]
    return np.where(offset >= 0, label[np.maximum(offset, 0)], -1)


class _HeldDirections:
    """Directions in which the shift of each part is held."""

    def __init__(self, n: int) -> None:
        self.normal = np.zeros((n, 3, 3))

    def add(self, part: Index, direction: Array) -> None:
        """Hold parts (m,) along directions (m, 3); part −1 is skipped."""
        on = part >= 0
        d = direction[on]
        np.add.at(self.normal, part[on], d[:, :, None] * d[:, None, :])

    def add_axes(self, part: Index, held: Mask) -> None:
        """Hold parts (m,) along the axes (m, 3) that are held."""
        for axis in range(3):
            on = held[:, axis]
            self.add(part[on], np.tile(np.eye(3)[axis], (int(on.sum()), 1)))

    def missing(self, part: int) -> list[str]:
        """Return the axes along which a part may shift."""
        values, vectors = np.linalg.eigh(self.normal[part])
        loose = vectors[:, values < 1e-12]
        share = np.sqrt(np.sum(loose**2, axis=1))
        order = np.argsort(-share, kind="stable")[: loose.shape[1]]
        return [DATUM_AXES[i] for i in sorted(order.tolist())]


def datum_problems(equations: Equations) -> Iterator[Problem]:
    """Find connected parts that can shift."""
    unknowns, network = equations.unknowns, equations.network
    label = connected_parts(equations)
    held = _HeldDirections(int(label.max(initial=-1)) + 1)
    observed = np.zeros(unknowns.n_columns, dtype=bool)
    for block in equations.blocks:
        labels: list[Index] = []
        tables: list[tuple[Variables, Index, str]] = []
        for kind, index in block.variables:
            table = unknowns[kind]
            on = table.offset[index] >= 0
            observed[table.offset[index][on]] = True
            if UNKNOWNS[kind].connects:
                labels.append(_label_of(table, label, index))
            if kind in ("point", "pose"):
                tables.append((table, index, kind))
        if labels:
            _hold(block, unknowns, np.max(labels, axis=0), tables, held)
    members: dict[int, list[str]] = {}
    for kind, noun in (("point", ""), ("pose", "photo ")):
        table = unknowns.tables[kind]
        for i in np.flatnonzero(table.offset >= 0):
            if observed[table.offset[i]]:
                members.setdefault(int(label[table.offset[i]]), []).append(noun + table.names[i])
    loose = {part: held.missing(part) for part in members}
    loose = {part: axes for part, axes in loose.items() if axes}
    if len(loose) > 1 or (loose and len(members) > 1 and network.datum == "given"):
        for part in loose:
            others = known([n for p, m in members.items() if p != part for n in m], most=6)
            yield Problem(
                f"no observation joins this part to the rest ({others}), and nothing holds its "
                f"{', '.join(loose[part])}: observe between them, or give it control",
                f"unconnected part of {known(members[part], most=8)}",
            )
    elif loose and network.datum == "given":
        axes = ", ".join(next(iter(loose.values())))
        yield Problem(
            f"no datum: nothing holds {axes} of the network; fix or weight coordinates, give "
            'control or GNSS positions, or ask for a free network (datum = "free")'
            + _drifts_with_free_shifts(network),
            f"network {network.name!r}",
        )


def _drifts_with_free_shifts(network: Network) -> str:
    """Name the drifts whose free shifts take up what positions of photos would hold."""
    free = [
        name
        for name, drift in network.drifts.items()
        if not all(drift.fixed[:3]) and np.isinf(drift.sigma[:3]).any()
    ]
    if not free:
        return ""
    return f"; free shifts of drift {known(map(repr, free), most=4)} take up positions of photos"


def _hold(
    block: Block,
    unknowns: Unknowns,
    part: Index,
    tables: list[tuple[Variables, Index, str]],
    held: _HeldDirections,
) -> None:
    """Add the directions in which the observations of a block hold their parts."""
    everything = np.ones((block.n, 3), dtype=bool)
    if "axis" in block.constants:
        held.add(part, block.constants["axis"])
    elif block.fixes == "coordinates":
        held.add_axes(part, _observed_axes(block, unknowns))
    elif block.fixes == "place":
        held.add_axes(part, everything)
    elif block.fixes == "nothing":
        for kind, index in block.variables:
            if UNKNOWNS[kind].on_earth:
                table = unknowns[kind]
                known = ~table.free[index, 0] | np.isfinite(table.sigma[index, 0])
                held.add(
                    np.where(known, part, -1),
                    np.tile(_vertical_direction(unknowns.network), (block.n, 1)),
                )
    for table, index, kind in tables:
        fixed = ~table.free[index][:, :3] if kind == "point" else ~table.free[index][:, 3:6]
        held.add_axes(part, fixed)


def _vertical_direction(network: Network) -> Array:
    """Return the direction of the vertical, (3,), in the middle of the given coordinates."""
    given = np.array([p.coordinates for p in network.points.values()], dtype=float)
    complete = given[np.isfinite(given).all(axis=1)]
    middle = complete.mean(axis=0) if len(complete) else np.zeros(3)
    if not np.any(middle):
        return np.array([0.0, 0.0, 1.0])
    return np.asarray(network.frame.basis(middle[None], np.zeros((1, 2))).enu[0, 2])


def _observed_axes(block: Block, unknowns: Unknowns) -> Mask:
    """Return the axes (n, 3) of coordinates that hold a part: not those with an unknown shift."""
    observed = np.zeros((block.n, 3), dtype=bool)
    observed[:, ["xyz".index(c) for c in block.components]] = True
    for kind, index in block.variables:
        if UNKNOWNS[kind].shifts:
            table = unknowns[kind]
            observed &= ~(table.free[index] & np.isinf(table.sigma[index]))[:, :3]
    return observed


PLACE_KINDS = ("point", "pose", "frame", "size")
"""Kinds of variables without which an observation has no geometry: zeros do not stand for them."""


def geocentric_problems(network: Network, at: Sources) -> Iterator[Problem]:
    """Find local coordinates in a geocentric frame, where such coordinates have no latitude."""
    if not isinstance(network.frame, GeocentricFrame):
        return
    for p in network.points.values():
        distance = float(np.linalg.norm(p.coordinates))
        if distance < MIN_GEOCENTRIC_RADIUS_M:
            yield Problem(
                f"it lies {distance / 1000:.3f} km from the centre of the Earth: a geocentric "
                "frame needs geocentric coordinates",
                located_names("point", [p.name], at),
            )


def geometry_problems(equations: Equations) -> Iterator[Problem]:
    """Compute the observations whose points and photos have given values.

    Yields:
        Problems of geometry that a model refuses (a sight without length, an azimuth of a vertical
        sight).
    """
    state = equations.unknowns.start()
    filled = {k: v if k in PLACE_KINDS else np.nan_to_num(v, nan=0.0) for k, v in state.items()}
    for block in equations.blocks:
        known_rows = np.ones(block.n, dtype=bool)
        for kind, index in block.variables:
            known_rows &= np.isfinite(filled[kind][index]).all(axis=1)
        rows = np.flatnonzero(known_rows)
        if not len(rows):
            continue
        some = block.select(rows)
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # coordinates of 1e200 are damage
                some.evaluate(equations.network.frame, filled, jacobians=False)
        except InputError as error:
            yield from error.problems


def check(network: Network, *, sources: Sources | None = None) -> tuple[Problem, ...]:
    """Return all problems that the checks find in a network.

    The problems are: nothing to adjust; points without observations or with too few; photos with
    too few points; frames with too few common places; unconnected parts; a missing datum in a
    network that is not free; marks of known points along other axes than stated, and known points
    that all have the same coordinates; and, for given approximate values: sights without length,
    vertical sights with an azimuth, points in the focal plane of a camera.

    Args:
        network: the network.
        sources: file and line of points and photos, by ("point" or "photo", name).
    """
    at = sources or {}
    try:
        equations = compile_network(network)
    except InputError as error:
        return error.problems
    inside = tuple(geocentric_problems(network, at))
    return (
        *point_problems(equations, at),
        *photo_problems(equations, at),
        *frame_problems(equations),
        *shape_problems(equations),
        *unobserved_problems(equations),
        *datum_problems(equations),
        *problems_of_marks(network),
        *(inside or geometry_problems(equations)),
    )
