"""Check of a network: counts by point, photo, frame, shape; datum of each part; given geometry.

The checks need no solution and report all problems at once. A network that passes can still fail
in the adjustment, because of its rank or of poor start values.

Sufficient counts are necessary for a solution; only the rank shows that a solution exists. A shape
is counted by its conditions from points, against the unknowns of its frame and its sizes. Problems
name the file and the line of the unknowns concerned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ..errors import InputError, Problem, known
from ..frames import GeocentricFrame
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_network
from ..graph.listed_points import with_listed_points_apart
from ..graph.variables import Unknowns, Variables, calibration_name
from ..models.shapes import Shape
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import KINDS
from ..observations.registry import PLAN_QUANTITIES, PLANE_ADVICE, in_image_table
from ..solve.datum_defects import connected_parts
from ..start.image_axes import problems_of_marks
from ..types import Array, Index, Mask

Sources: TypeAlias = Mapping[tuple[str, str], str]
"""File and line by noun (point, photo) and name."""
MIN_COUNTED_ENTITIES = 5
"""Free networks with fewer points and photos are exempt from the count for each point."""
DATUM_AXES = ("x", "y", "z")
LEAVE_OUT_ADVICE = "adjust --leave-out-undetermined"
"""Ends the problems that leaving out solves."""
MIN_GEOCENTRIC_DISTANCE = 0.988
"""Smallest distance of points from the centre of the ellipsoid, in semi-major axes."""
PLACE_KINDS = ("point", "pose", "frame", "size")
"""Kinds of variables without which an observation has no geometry: zeros do not stand for them."""


def located_names(noun: str, names: Sequence[str], at: Sources) -> str:
    """Return file and line of the first name, and the names."""
    source = at.get((noun, names[0]))
    where = "" if source is None else f"{source}: "
    if len(names) == 1:
        return f"{where}{noun} {names[0]!r}"
    return f"{where}{noun}s {known(map(repr, names))}"


def problems_with_lines(problems: Sequence[Problem], at: Sources) -> list[Problem]:
    """Return problems of single unknowns with the file and line that state them, where known."""
    lines = {f"{noun} {name!r}": source for (noun, name), source in at.items()}
    return [
        replace(p, where=f"{lines[p.where]}: {p.where}") if p.where in lines else p
        for p in problems
    ]


def _touching(equations: Equations, kind: VariableKind) -> tuple[Array, list[dict[str, int]]]:
    """Return numbers of scalar observations of each variable, and of observations by kind."""
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


def point_problems(equations: Equations, at: Sources) -> Iterator[Problem]:
    """Find points without observations or with fewer observations than unknowns."""
    network, table = equations.network, equations.unknowns["point"]
    rows, counts = _touching(equations, "point")
    free = table.free.sum(axis=1)
    idle = [table.names[i] for i in np.flatnonzero((rows == 0) & (free > 0))]
    if idle:
        yield Problem(
            "no observation: observe it, hold it (column fixed), take it out, or "
            f"{LEAVE_OUT_ADVICE}",
            located_names("point", idle, at),
        )
    if network.datum == "free" and len(network.points) + len(network.photos) < MIN_COUNTED_ENTITIES:
        return
    groups: dict[tuple[int, str, frozenset[str]], list[str]] = {}
    for i in np.flatnonzero((rows > 0) & (rows < free)):
        key = int(free[i]), _counted(counts[i]), frozenset(counts[i])
        groups.setdefault(key, []).append(table.names[i])
    for (unknown, have, kinds), names in groups.items():
        quantities = {KINDS[k].quantity if k in KINDS else None for k in kinds}
        in_plan = unknown == 3 and quantities <= PLAN_QUANTITIES
        plane = f"{PLANE_ADVICE}, " if in_plan else ""
        yield Problem(
            f"{have} for {unknown} free coordinates: observe it more, give control, "
            f"hold coordinates (column fixed), {plane}or {LEAVE_OUT_ADVICE}",
            located_names("point", names, at),
        )


def _counted(counts: dict[str, int]) -> str:
    each = [
        (n, "image ray" if in_image_table(k) else k.replace("_", " ")) for k, n in counts.items()
    ]
    return "only " + ", ".join(f"{n} {word}{'s' * (n > 1)}" for n, word in each)


def photo_problems(equations: Equations, at: Sources) -> Iterator[Problem]:
    """Find photos with fewer image points than their unknowns need."""
    network, table = equations.network, equations.unknowns["pose"]
    rows, counts = _touching(equations, "pose")
    calibrations = equations.unknowns["calibration"]
    unknown_of = (calibrations.free & ~np.isfinite(calibrations.sigma)).sum(axis=1)
    for block in equations.blocks:  # what observes a calibration alone, as fiducial marks do
        if not block.prior and [kind for kind, _ in block.variables] == ["calibration"]:
            np.subtract.at(unknown_of, block.variables[0][1], block.dimension)
    for i, name in enumerate(table.names):
        unknown = int(table.free[i].sum())
        camera = network.cameras[network.photos[name].camera]
        if camera.per_photo:
            unknown += max(unknown_of[calibrations.number[calibration_name(network, name)]], 0)
        if rows[i] < unknown:
            n = counts[i].get("image", 0)
            needed = n + int(np.ceil((unknown - rows[i]) / 2))
            yield Problem(
                f"{n} image point{'s' * (n != 1)}: its {unknown} unknowns need at least {needed}",
                located_names("photo", [name], at),
            )


def frame_problems(equations: Equations) -> Iterator[Problem]:
    """Find frames with fewer places that are common with the rest than their unknowns need.

    A place is common if something else is known of it: it is held, or another observation or
    another frame has it. The origin of a frame whose offset is held is one of its places.
    """
    table = equations.unknowns["frame"]
    unknown = table.free & np.isinf(table.sigma)
    seen, elsewhere = common_frame_places(equations, unknown)
    times = np.bincount([p for places in seen for p in places], minlength=len(elsewhere))
    names = [*equations.unknowns["point"].names, *equations.unknowns["pose"].names]
    shapes = shape_frames(equations)
    for f, places in enumerate(seen):
        if not places or not unknown[f].any() or f in shapes:
            continue
        common = sorted(p for p in places if elsewhere[p] or times[p] > 1)
        if not common and equations.network.datum == "free":
            continue  # the frame may be all that there is
        turns = int(unknown[f, :3].sum())
        need = 3 if turns > 1 else 2 if turns or unknown[f, 6] else 1
        stated = equations.network.frames[table.names[f]]
        need -= not stated.origin and not unknown[f, 3:6].any()
        if len(common) < need:
            which = f" ({known([names[p] for p in common])})" if common else ""
            verb = "is" if len(common) == 1 else "are"
            line = " that do not lie in one line" if need == 3 else ""
            yield Problem(
                f"only {len(common)} of its {len(places)} places {verb} common with the rest of "
                f"the network{which}, and its {int(unknown[f].sum())} unknowns need {need}{line}: "
                "observe more of them from elsewhere, or hold some of its components",
                f"frame {table.names[f]!r}",
            )


def shape_blocks(equations: Equations) -> list[Block]:
    """Return the observations of points on shapes."""
    records = ((b, KINDS.get(b.kind)) for b in equations.blocks if not b.prior)
    return [b for b, k in records if k is not None and isinstance(k.model, Shape)]


def shape_frames(equations: Equations) -> set[int]:
    """Return the numbers of the frames of shapes."""
    return {f for b in shape_blocks(equations) for f in b.variables[0][1].tolist()}


def common_frame_places(equations: Equations, unknown: Mask) -> tuple[list[set[int]], Mask]:
    """Return the places of every frame, and whether something outside of frames knows a place.

    Photos are numbered behind the points. ``unknown`` are the components without a given value.
    """
    points, poses = equations.unknowns["point"], equations.unknowns["pose"]
    first = {"point": 0, "pose": len(points.names)}
    held = [~points.free.any(axis=1), ~poses.free[:, 3:].any(axis=1)]
    elsewhere = np.concatenate(held)
    seen: list[set[int]] = [set() for _ in unknown]
    for block in equations.blocks:
        index = next((i for what, i in block.variables if what == "frame"), None)
        for number, (what, place) in enumerate(block.variables):
            if what not in first:
                continue
            if index is None:
                elsewhere[place + first[what]] = True
                continue
            for f, p in zip(index.tolist(), (place + first[what]).tolist(), strict=True):
                # Behind its frame and its place stands the point at the origin of the frame.
                if number < 2 or not unknown[f, 3:6].any():
                    seen[f].add(p)
    return seen, elsewhere


def unobserved_problems(equations: Equations) -> Iterator[Problem]:
    """Find unknowns without observations, other than points and photos."""
    for kind, table in equations.unknowns.tables.items():
        if kind in ("point", "pose"):
            continue  # these kinds have their own checks
        rows, _ = _touching(equations, kind)
        for i in np.flatnonzero((rows == 0) & table.free.any(axis=1)):
            yield Problem(
                "it is unknown, but no observation depends on it: hold it, or take it out",
                f"{UNKNOWNS[kind].noun} {table.names[i]!r}",
            )


def shape_problems(equations: Equations) -> Iterator[Problem]:
    """Find shapes with fewer conditions than unknowns.

    A condition counts if something else is known of its point: the point is held, or another
    observation or another frame has it. Unknowns are the components of the frame without a given
    value, and the sizes that nothing else depends on.
    """
    table = equations.unknowns["frame"]
    unknown = table.free & np.isinf(table.sigma)
    seen, elsewhere = common_frame_places(equations, unknown)
    times = np.bincount([p for places in seen for p in places], minlength=len(elsewhere))
    common: Mask = elsewhere | (times > 1)
    sizes = _sizes(equations)
    for f in sorted(shape_frames(equations)):
        names = [c for c, u in zip(UNKNOWNS["frame"].names(), unknown[f], strict=True) if u]
        names += [UNKNOWNS[kind].noun for (kind, _), users in sizes.items() if users == {f}]
        rows, points = _conditions(equations, f, common)
        if rows < len(names):
            n = int(common[sorted(points)].sum())
            yield Problem(
                f"{n} of its {len(points)} points {'is' if n == 1 else 'are'} determined "
                f"otherwise, which is {rows} condition{'s' * (rows != 1)} for {len(names)} "
                f"unknowns ({', '.join(names)}): observe more points, or hold some of its "
                "components",
                f"shape {table.names[f]!r}",
            )


def _conditions(equations: Equations, f: int, common: Mask) -> tuple[int, set[int]]:
    """Return the number of conditions of a shape, and the numbers of its points."""
    rows, points = 0, set[int]()
    on_shapes = {id(b) for b in shape_blocks(equations)}
    for block in equations.blocks:
        if id(block) in on_shapes:
            own = block.variables[1][1][block.variables[0][1] == f]
            points |= set(own.tolist())
            rows += block.dimension * int(common[own].sum())
        else:
            rows += sum(
                block.dimension * int(np.count_nonzero(index == f))
                for kind, index in block.variables
                if kind == "frame"
            )
    return rows, points


def _sizes(equations: Equations) -> dict[tuple[str, int], set[int]]:
    """Return the shapes that depend on each unknown size; −1 stands for any other observation."""
    users: dict[tuple[str, int], set[int]] = {}
    on_shapes = {id(b) for b in shape_blocks(equations)}
    own = dict.fromkeys(
        kind
        for b in equations.blocks
        if id(b) in on_shapes
        for kind, _ in b.variables[2:]
        if kind not in ("point", "vertical")
    )
    for block in equations.blocks:
        for kind, index in block.variables:
            if kind not in own:
                continue
            frames = block.variables[0][1] if id(block) in on_shapes else np.full_like(index, -1)
            for i, f in zip(index.tolist(), frames.tolist(), strict=True):
                if equations.unknowns[kind].free[i].any():
                    users.setdefault((kind, i), set()).add(f)
    return users


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


def geocentric_problems(network: Network, at: Sources) -> Iterator[Problem]:
    """Find local coordinates in a geocentric frame, where such coordinates have no latitude."""
    if not isinstance(frame := network.frame, GeocentricFrame):
        return
    for p in network.points.values():
        distance = float(np.linalg.norm(p.coordinates))
        if distance < MIN_GEOCENTRIC_DISTANCE * frame.ellipsoid.a:
            yield Problem(
                f"it lies {distance / 1000:.3f} km from the centre of the ellipsoid "
                f"{frame.ellipsoid_name}: a geocentric frame needs geocentric coordinates",
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

    The problems are: nothing to adjust; datum points, and stations of stated unknowns, without
    observations (other points without any are listed, not adjusted); points with too few; photos
    with too few points; frames with too few common places; unconnected parts; a missing datum in a
    network that is not free; marks of known points along other axes than stated, and known points
    that all have the same coordinates; and, for given approximate values: sights without length,
    vertical sights with an azimuth, points in the focal plane of a camera.

    Args:
        network: the network.
        sources: file and line of points and photos, by ("point" or "photo", name).
    """
    at = sources or {}
    network = with_listed_points_apart(network)
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
