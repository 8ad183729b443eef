"""Network from groups of JAG3D: observations and additional parameters of each kind.

| JAG3D (observation/*.java) | here |
| --- | --- |
| distance: (S − a) / m | (1 + scale) S + zero: scale = 1/m − 1, zero = −a/m |
| zenith angle: z − (k − e) D / 2R, e = 1 with curvature of the Earth, otherwise 0 | z − κ D / 2R |
| height difference: (z_j − z_i) / m | the same with m = 1 |
| GNSS: m R (X_j − X_i) | the same; unknown and turned ones e^{−ℓ} Rᵀ (X_j − X_i) in a frame |
| deflection of the vertical: rotations r_x, r_y of the horizon | η = r_x, ξ = −r_y |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ...errors import InputError, Problem
from ...network.network import Network
from ...observations import (
    CoordinateDifference,
    Direction,
    FrameVector,
    GnssVector,
    HeightDifference,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ...rotation import log_rotation
from ...stochastic_model import StandardDeviation
from ..source import Problems
from .jag3d_model import (
    DEFAULT_POINT_SIGMA_M,
    Conversion,
    Deflection,
    ObservationGroup,
    ObservationRow,
    PointRow,
    Reduction,
    sigma_along,
)

ObservationFunction: TypeAlias = (
    "Callable[[Conversion, ObservationGroup, ObservationRow], Observation]"
)
_TO_XYZ = str.maketrans("yxz", "xyz")
"""Axes of JAG3D, y east and x north, in a frame with axes east, north."""


def _direction(made: Conversion, group: ObservationGroup, row: ObservationRow) -> Observation:
    return Direction(
        row.start,
        row.end,
        row.value[0],
        sigma=made.of_angle(group, row, plan=True),
        set=group.name,
        instrument_height=row.ih,
        target_height=row.th,
        source=row.source,
    )


def _zenith(made: Conversion, group: ObservationGroup, row: ObservationRow) -> Observation:
    value = row.value[0] % (2.0 * math.pi)
    return ZenithAngle(
        row.start,
        row.end,
        value if value <= math.pi else 2.0 * math.pi - value,
        sigma=made.of_angle(group, row, plan=False),
        refraction=_refracted(made, group),
        instrument_height=row.ih,
        target_height=row.th,
        source=row.source,
    )


def _distance(kind: type[SlopeDistance]) -> ObservationFunction:
    def make(made: Conversion, group: ObservationGroup, row: ObservationRow) -> Observation:
        sigma = made.of_length(group, row)
        if kind is HorizontalDistance:
            row = made.reduction.distance(row)
        return kind(
            row.start,
            row.end,
            row.value[0],
            sigma=sigma,
            instrument=_metered(group),
            instrument_height=row.ih,
            target_height=row.th,
            source=row.source,
        )

    return make


def _levelling(made: Conversion, group: ObservationGroup, row: ObservationRow) -> Observation:
    for name in (row.start, row.end):
        if name in made.deflected:
            what = (
                f"a height difference at {name!r}, which has a deflection of the vertical: JAG3D "
                "turns its height about the origin of the coordinates"
            )
            raise InputError(Problem(what, row.source))
    a, b, c = group.uncertainty
    sigma: float | StandardDeviation = row.sigma[0]
    length_km = None
    if not row.sigma[0] > 0:
        sigma = a
        if b > 0 or c > 0:
            d = made.length(row, plan=True)
            length_km = d / 1000.0
            sigma = StandardDeviation(a, per_sqrt_km=b, combine="quadratic")
            if c > 0:
                sigma, length_km = sigma_along(group, d), None
    m = group.extra("scale").value
    sigma = sigma.scaled(m) if isinstance(sigma, StandardDeviation) else sigma * m
    return HeightDifference(
        row.start,
        row.end,
        row.value[0] * m,
        sigma=sigma,
        length_km=length_km,
        instrument_height=row.ih,
        target_height=row.th,
        source=row.source,
    )


def _gnss(made: Conversion, group: ObservationGroup, row: ObservationRow) -> Observation:
    sigma = tuple(
        s if s > 0 else sigma_along(group, abs(v))
        for s, v in zip(row.sigma, row.value, strict=True)
    )
    if _in_frame(group):
        three, sigmas = (row.value[0], row.value[1], row.value[2]), (sigma[0], sigma[1], sigma[2])
        return FrameVector(group.name, row.start, row.end, three, sigma=sigmas, source=row.source)
    m = group.extra("scale").value
    value, sigma = tuple(v / m for v in row.value), tuple(s / m for s in sigma)
    if group.kind.axes == "yxz":
        three = (value[0], value[1], value[2])
        sigmas = (sigma[0], sigma[1], sigma[2])
        return GnssVector(row.start, row.end, three, sigma=sigmas, source=row.source)
    axes = group.kind.axes.translate(_TO_XYZ)
    return CoordinateDifference(
        row.start, row.end, value, axes=axes, sigma=sigma, source=row.source
    )


OBSERVATION_FUNCTIONS: dict[str, ObservationFunction] = {
    "levelling": _levelling,
    "directions": _direction,
    "horizontal_distances": _distance(HorizontalDistance),
    "slope_distances": _distance(SlopeDistance),
    "zenith_angles": _zenith,
    "gnss_1d": _gnss,
    "gnss_2d": _gnss,
    "gnss_3d": _gnss,
}
"""Function that makes an observation of a row, by kind."""


# -- parameters of groups -------------------------------------------------------------------------


def _orient(made: Conversion, group: ObservationGroup) -> None:
    orientation = group.extra("orientation")
    stations = list(dict.fromkeys(row.start for row in group.rows))
    if orientation.free and len(stations) > 1:
        what = (
            f"group {group.name!r} has one unknown orientation for directions of "
            f"{len(stations)} stations ({', '.join(stations[:4])}): give each station its group"
        )
        made.refuse(what, group.source)
        return
    if not orientation.free:
        for station in stations:
            if station in made.network.points:
                made.network.set_orientation(
                    station, set=group.name, value=orientation.value, fixed=True
                )


def _metered(group: ObservationGroup) -> str | None:
    """Return the name of the distance meter of a group; None where it has no effect."""
    scale, zero = group.extra("scale"), group.extra("zero point offset")
    idle = scale.value == 1.0 and zero.value == 0.0 and not scale.free and not zero.free
    return None if idle else group.name


def _meter(made: Conversion, group: ObservationGroup) -> None:
    name = _metered(group)
    if name is None:
        return
    scale, zero = group.extra("scale"), group.extra("zero point offset")
    if not 0.1 < scale.value < 10.0:
        made.refuse(f"group {group.name!r}: a scale of {scale.value}; valid: near 1", group.source)
        return
    if scale.free and not zero.free and zero.value != 0.0:
        what = (
            f"group {group.name!r} has an unknown scale and a zero point offset that is held at "
            f"{zero.value} m: add the offset to the distances"
        )
        made.refuse(what, group.source)
        return
    free = [n for n, e in (("scale", scale), ("zero", zero)) if e.free]
    made.attempt(
        group.source,
        lambda: made.network.set_distance_meter(
            name,
            scale=1.0 / scale.value - 1.0,
            zero=-zero.value / scale.value,
            free=free,  # type: ignore[arg-type]
        ),
    )


def _refracted(made: Conversion, group: ObservationGroup) -> str | None:
    """Return the name of the group of refraction; None where its coefficient is 0 and held."""
    k = group.extra("refraction")
    return None if k.value == 0.0 and not k.free and not made.reduction.curvature else group.name


def _refract(made: Conversion, group: ObservationGroup) -> None:
    name = _refracted(made, group)
    if name is None:
        return
    k = group.extra("refraction")
    value = k.value - (1.0 if made.reduction.curvature else 0.0)
    made.attempt(
        group.source,
        lambda: made.network.set_refraction(name, value=value, fixed=not k.free),
    )


def _refuse_unknown_scale(made: Conversion, group: ObservationGroup) -> None:
    """Refuse unknown scales and rotations of heights and vectors, and rotations that are held."""
    for name, e in group.extras.items():
        turned = name.startswith("rotation") and e.value != 0.0
        if e.free or turned or (name == "scale" and not e.value > 0):
            what = f"an unknown {name}" if e.free else f"a {name} of {e.value}"
            made.refuse(
                f"group {group.name!r} has {what}, which {group.kind.name} do not have here: hold "
                "it in JAG3D where it has no effect, or correct the values",
                group.source,
            )


def _in_frame(group: ObservationGroup) -> bool:
    """Return whether the vectors of a group are measured in a frame of their own."""
    rotations = [group.extra(f"rotation {axis}") for axis in "xyz"]
    turned = any(r.free or r.value != 0.0 for r in rotations)
    return group.kind.axes == "yxz" and (turned or group.extra("scale").free)


def _frame(made: Conversion, group: ObservationGroup) -> None:
    """State the frame of GNSS vectors: rotation vector of R, logarithm of the scale 1 / m.

    JAG3D's vector is m Rx Ry Rz (ΔX, ΔY, ΔZ) with X north and Y east
    (GNSSBaselineDelta{X,Y,Z}3D.java); here it is e^{−ℓ} Rᵀ d in east, north, up.
    """
    if not _in_frame(group):
        _refuse_unknown_scale(made, group)
        return
    m = group.extra("scale")
    rx, ry, rz = (group.extra(f"rotation {axis}") for axis in "xyz")
    free = [n for n, e in (("rx", ry), ("ry", rx), ("rz", rz), ("ln_scale", m)) if e.free]
    if rx.free != ry.free or not m.value > 0:
        what = f"group {group.name!r}: rotations x and y are unknown together, or held together"
        made.refuse(what if m.value > 0 else f"a scale of {m.value}", group.source)
        return
    (cx, cy, cz), (sx, sy, sz) = ([f(e.value) for e in (rx, ry, rz)] for f in (math.cos, math.sin))
    of_jag3d = np.array(
        [
            [cy * cz, cx * sz + sx * sy * cz, sx * sz - cx * sy * cz],
            [-cy * sz, cx * cz - sx * sy * sz, sx * cz + cx * sy * sz],
            [sy, -sx * cy, cx * cy],
        ]
    )
    swapped = [1, 0, 2]
    turn = log_rotation(of_jag3d[np.ix_(swapped, swapped)].T)
    values = dict(zip(("rx", "ry", "rz"), turn.tolist(), strict=True))
    values["ln_scale"] = -math.log(m.value)
    made.attempt(group.source, lambda: made.network.add_frame(group.name, free=free, values=values))


PARAMETER_FUNCTIONS: dict[str, Callable[[Conversion, ObservationGroup], None]] = {
    "levelling": _refuse_unknown_scale,
    "directions": _orient,
    "horizontal_distances": _meter,
    "slope_distances": _meter,
    "zenith_angles": _refract,
    "gnss_1d": _refuse_unknown_scale,
    "gnss_2d": _refuse_unknown_scale,
    "gnss_3d": _frame,
}
"""Function that states the parameters of a group, by kind."""


def as_network(
    name: str,
    points: Sequence[PointRow],
    groups: Sequence[ObservationGroup],
    *,
    deflections: Sequence[Deflection] = (),
    reduction: Reduction | None = None,
    point_sigma: float = DEFAULT_POINT_SIGMA_M,
    problems: Problems | None = None,
    where: str,
) -> Network:
    """Return the network of groups of points and observations.

    Args:
        name: its name.
        points: the points.
        groups: the groups of observations; their names are sets of directions, distance meters
            and groups of refraction.
        deflections: deflections of the vertical.
        reduction: reductions that JAG3D applies.
        point_sigma: σ of stochastic points that state none, metres.
        problems: collection with the problems found so far.
        where: names of the files, for what concerns all of them.

    Raises:
        InputError: all problems.
    """
    made = Conversion(name, reduction or Reduction(), point_sigma, problems or Problems())
    made.add_points(points)
    made.add_deflections(deflections)
    for group in groups:
        _add_group(made, group)
    if not made.problems.count and not made.network.points:
        made.problems.wrong("there are no points", where)
    made.problems.raise_all()
    return made.network


def _add_group(made: Conversion, group: ObservationGroup) -> None:
    """Add the observations of a group, and its parameters."""
    a = group.uncertainty[0]
    if not a > 0 or any(not part >= 0 for part in group.uncertainty):
        what = f"group {group.name!r}: the constant part of σ must be > 0, the others ≥ 0"
        made.refuse(what, group.source)
        return
    make = OBSERVATION_FUNCTIONS[group.kind.name]
    before = made.problems.count
    PARAMETER_FUNCTIONS[group.kind.name](made, group)
    if made.problems.count > before:
        return
    for row in group.rows:
        if _has_valid_ends(made, group, row):
            made.attempt(
                row.source,
                lambda row=row: made.network.add(make(made, group, row)),  # type: ignore[misc]
            )


def _has_valid_ends(made: Conversion, group: ObservationGroup, row: ObservationRow) -> bool:
    """Return whether both points of a row are known and may have such an observation."""
    valid = group.kind.dimensions
    good = True
    for name in (row.start, row.end):
        point = made.rows.get(name)
        if point is None:
            made.refuse(f"unknown point {name!r}: no file or group of points has it", row.source)
            good = False
        elif point.dimension not in valid:
            what = (
                f"{group.kind.name} join points of {' or '.join(map(str, valid))} dimensions, "
                f"{name!r} has {point.dimension}: JAG3D leaves this row out"
            )
            made.refuse(what, row.source)
            good = False
    return good


def groups_with_set_names(groups: Sequence[ObservationGroup]) -> list[ObservationGroup]:
    """Return the groups with names, each of which occurs once."""
    seen: dict[str, int] = {}
    out = []
    for group in groups:
        seen[group.name] = n = seen.get(group.name, 0) + 1
        out.append(group if n == 1 else replace(group, name=f"{group.name} ({n})"))
    return out
