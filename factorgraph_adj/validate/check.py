"""What is wrong with a network before it is adjusted: structure, and geometry where given.

The checks need no solution and find all they can at once. They are necessary, not
sufficient: what only the numbers tell (a rank, a poor start) is left to the adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from ..errors import InputError, Problem, known
from ..frames import GeocentricFrame
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_network
from ..graph.variables import Unknowns, Variables, calibration_name
from ..models.image import depth
from ..models.registry import VariableKind
from ..network.network import Network
from ..solve.datum import parts
from ..types import Array, Index, Mask

Sources: TypeAlias = Mapping[tuple[str, str], str]

TINY = 5
"""Points and photos below which a free network may leave single points undetermined."""
AXES = ("x", "y", "z")
OTHERS: dict[VariableKind, str] = {
    "calibration": "calibration of camera",
    "orientation": "orientation of set",
    "refraction": "refraction group",
    "vertical": "vertical of station",
    "edm": "distance meter",
}
"""Unknowns besides points and photos, as messages call them."""
LEAST_RADIUS = 6_300_000.0
"""Metres from the centre of the Earth, deeper than any point that is measured."""


def check(
    network: Network, *, sources: Mapping[tuple[str, str], str] | None = None
) -> tuple[Problem, ...]:
    """Return everything that is found wrong with a network, nothing if it seems fit.

    Nothing to adjust; points without observations or with too few; photos with too few points;
    unconnected parts; no datum without a free network asked for; and, from the given
    approximate values where there are any: sights without length, vertical sights with an
    azimuth, points behind a camera or in its focal plane.

    Args:
        network: what is to be adjusted.
        sources: file and line of points and photos, by ("point" or "photo", name).
    """
    at = sources or {}
    try:
        equations = compile_network(network)
    except InputError as error:
        return error.problems
    inside = tuple(_inside_the_earth(network, at))
    return (
        *_points(equations, at),
        *_photos(equations, at),
        *_others(equations),
        *_datum(equations),
        *(inside or _geometry(equations)),
    )


# -- counts ---------------------------------------------------------------------------------------


def _touching(equations: Equations, kind: VariableKind) -> tuple[Array, list[dict[str, int]]]:
    """Return scalar observations of each variable, and observations of each by kind."""
    n = len(equations.unknowns.tables[kind].names)
    rows = np.zeros(n)
    counts: list[dict[str, int]] = [{} for _ in range(n)]
    for block in equations.blocks:
        for what, index in block.variables:
            if what != kind:
                continue
            times = np.bincount(index, minlength=n)
            rows += block.dimension * times
            name = block.kind.removeprefix("weighted_")
            for i in np.flatnonzero(times):
                counts[i][name] = counts[i].get(name, 0) + int(times[i])
    return rows, counts


def _points(equations: Equations, at: Sources) -> Iterator[Problem]:
    network, table = equations.network, equations.unknowns["point"]
    rows, counts = _touching(equations, "point")
    free = table.free.sum(axis=1)
    idle = [table.names[i] for i in np.flatnonzero((rows == 0) & (free > 0))]
    if idle:
        yield Problem(
            "no observation: observe it, hold it (column fixed), or take it out",
            _listed("point", idle, at),
        )
    if network.datum == "free" and len(network.points) + len(network.photos) < TINY:
        return
    groups: dict[tuple[int, str], list[str]] = {}
    for i in np.flatnonzero((rows > 0) & (rows < free)):
        groups.setdefault((int(free[i]), _counted(counts[i])), []).append(table.names[i])
    for (unknown, have), names in groups.items():
        yield Problem(
            f"{have} for {unknown} free coordinates: observe it more, give control, "
            "or hold coordinates (column fixed)",
            _listed("point", names, at),
        )


def _counted(counts: dict[str, int]) -> str:
    words = {"image": "image ray"}
    each = [(n, words.get(k, k).replace("_", " ")) for k, n in counts.items()]
    return "only " + ", ".join(f"{n} {word}{'s' * (n > 1)}" for n, word in each)


def _listed(noun: str, names: Sequence[str], at: Sources) -> str:
    """Return file and line of the first name, and the names."""
    source = at.get((noun, names[0]))
    where = "" if source is None else f"{source}: "
    if len(names) == 1:
        return f"{where}{noun} {names[0]!r}"
    return f"{where}{noun}s {known(map(repr, names))}"


def _photos(equations: Equations, at: Sources) -> Iterator[Problem]:
    network, table = equations.network, equations.unknowns["pose"]
    rows, counts = _touching(equations, "pose")
    calibrations = equations.unknowns["calibration"]
    for i, name in enumerate(table.names):
        unknown = int(table.free[i].sum())
        camera = network.cameras[network.photos[name].camera]
        if camera.per_photo:
            own = calibrations.number[calibration_name(network, name)]
            unknown += int((calibrations.free[own] & ~np.isfinite(calibrations.sigma[own])).sum())
        if rows[i] < unknown:
            n = counts[i].get("image", 0)
            needed = n + int(np.ceil((unknown - rows[i]) / 2))
            yield Problem(
                f"{n} image point{'s' * (n != 1)}: its {unknown} unknowns need at least {needed}",
                _listed("photo", [name], at),
            )


def _others(equations: Equations) -> Iterator[Problem]:
    """Find unknowns besides points and photos that nothing observes."""
    for kind, noun in OTHERS.items():
        table = equations.unknowns.tables[kind]
        rows, _ = _touching(equations, kind)
        for i in np.flatnonzero((rows == 0) & table.free.any(axis=1)):
            yield Problem(
                "it is unknown, but no observation depends on it: hold it, or take it out",
                f"{noun} {table.names[i]!r}",
            )


# -- datum ----------------------------------------------------------------------------------------


def _label_of(table: Variables, label: Index, numbers: Index) -> Index:
    """Return the part of variables by number, −1 where held or unobserved."""
    offset = table.offset[numbers]
    return np.where(offset >= 0, label[np.maximum(offset, 0)], -1)


class _Held:
    """Directions in which the shift of each part is held."""

    def __init__(self, n: int) -> None:
        self.normal = np.zeros((n, 3, 3))

    def add(self, part: Index, direction: Array) -> None:
        """Hold parts (m,) along directions (m, 3); −1 is none."""
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


def _datum(equations: Equations) -> Iterator[Problem]:
    """Find parts that nothing holds in place."""
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
            if kind in ("point", "pose"):
                labels.append(_label_of(table, label, index))
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
            'control or GNSS positions, or ask for a free network (datum = "free")',
            f"network {network.name!r}",
        )


def _hold(
    block: Block,
    unknowns: Unknowns,
    part: Index,
    tables: list[tuple[Variables, Index, str]],
    held: _Held,
) -> None:
    """Note in which directions the observations of a block hold their parts."""
    n = block.n
    everything = np.ones((n, 3), dtype=bool)
    if "axis" in block.constants:
        held.add(part, block.constants["axis"])
    elif block.kind in ("photo_position", "weighted_position"):
        held.add_axes(part, np.isfinite(block.sigma))
    elif block.kind.startswith("astronomic"):
        held.add_axes(part, everything)
    for table, index, kind in tables:
        fixed = ~table.free[index][:, :3] if kind == "point" else ~table.free[index][:, 3:6]
        held.add_axes(part, fixed)


def _inside_the_earth(network: Network, at: Sources) -> Iterator[Problem]:
    """Find local coordinates in a geocentric frame: they have no latitude there."""
    if not isinstance(network.frame, GeocentricFrame):
        return
    for p in network.points.values():
        distance = float(np.linalg.norm(p.coordinates))
        if distance < LEAST_RADIUS:
            yield Problem(
                f"it lies {distance / 1000:.3f} km from the centre of the Earth: a geocentric "
                "frame needs geocentric coordinates",
                _listed("point", [p.name], at),
            )


# -- geometry -------------------------------------------------------------------------------------


def _geometry(equations: Equations) -> Iterator[Problem]:
    """Compute the observations whose points and photos have given values."""
    state = equations.unknowns.start()
    filled = {
        k: v if k in ("point", "pose") else np.nan_to_num(v, nan=0.0) for k, v in state.items()
    }
    for block in equations.blocks:
        known_rows = np.ones(block.n, dtype=bool)
        for kind, index in block.variables:
            known_rows &= np.isfinite(filled[kind][index]).all(axis=1)
        rows = np.flatnonzero(known_rows)
        if not len(rows):
            continue
        some = block.select(rows)
        named: set[str] = set()
        try:
            some.evaluate(equations.network.frame, filled, jacobians=False)
        except InputError as error:
            yield from error.problems
            named = {p.where for p in error.problems}
        if block.kind == "image":
            (_, photo), _, (_, point) = some.variables
            depths = depth(filled["pose"][photo], filled["point"][point])
            for i in np.flatnonzero(depths < 0):
                if some.labels(int(i)) in named:
                    continue  # in the focal plane, up to rounding
                yield Problem(
                    f"the point lies {-depths[i]:.3g} m behind the camera, by the given "
                    "coordinates and orientation: correct them, or leave approximate ones out",
                    some.labels(int(i)),
                )
