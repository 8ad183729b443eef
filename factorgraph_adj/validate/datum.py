"""Checks of the datum: connected parts of a network that can shift."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import Problem, known
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import Unknowns, Variables
from ..models.variables import UNKNOWNS
from ..network.network import Network
from ..solve.datum import parts
from ..types import Array, Index, Mask

AXES = ("x", "y", "z")


def _label_of(table: Variables, label: Index, numbers: Index) -> Index:
    """Return the connected part of each variable, −1 for held or unobserved variables."""
    offset = table.offset[numbers]
    return np.where(offset >= 0, label[np.maximum(offset, 0)], -1)


class _Held:
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
        return [AXES[i] for i in sorted(order.tolist())]


def datum_problems(equations: Equations) -> Iterator[Problem]:
    """Find connected parts that can shift."""
    unknowns, network = equations.unknowns, equations.network
    label = parts(equations)
    held = _Held(int(label.max(initial=-1)) + 1)
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
            + _taken_up(network),
            f"network {network.name!r}",
        )


def _taken_up(network: Network) -> str:
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
    held: _Held,
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
                held.add(np.where(known, part, -1), np.tile(_up(unknowns.network), (block.n, 1)))
    for table, index, kind in tables:
        fixed = ~table.free[index][:, :3] if kind == "point" else ~table.free[index][:, 3:6]
        held.add_axes(part, fixed)


def _up(network: Network) -> Array:
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
