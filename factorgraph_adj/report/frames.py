"""Section of the protocol: frames of their own, such as models and scanner stations."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt

import numpy as np

from ..models.sub_frame import split_frame
from ..network.entities import Parameter
from ..observations import observation_kind
from ..quality.posed import PLACE, place_of_frame
from ..rotation import TURN_ABOUT_X, angles_by_rotation, omega_phi_kappa
from ..units import ANGLE, decimal, decimal_angle
from .context import Report
from .layout import decimals, paragraph, short, table, title

MEANING = (
    "X = O + Eᵀ e^ℓ R (q + c): rotation R of ω, φ, κ, offset c of x, y, z, scale e^ℓ; E: the "
    "horizon at the origin O of a level frame. Offset and v are in the unit of the frame, which is "
    "e^ℓ times that of the network. X, Y, Z: the place of the zero of the frame in the network, "
    "where a scanner or tracker stands. Under each value its σ, (w) where it was weighted"
)


@dataclass(frozen=True)
class _Seen:
    """What was measured in a frame."""

    places: int
    """Number of points and projection centres that were measured in it."""
    rms: float
    """Root mean square of residuals that are lengths, unit of the frame; NaN: there are none."""
    normalised: float
    """Root mean square of v/σ; NaN: nothing was measured."""


def frames(report: Report) -> list[str]:
    """Return the frames: origin, places, residuals; rotation, offset and scale with their σ."""
    stated, seen, units = report.network.frames, _seen(report), report.units
    number = report.solution.equations.unknowns["frame"].number
    own = _own(report, seen)
    if not own:
        return []
    names, note = report.cut(own, "frames", "unknowns.csv")
    overview: list[list[str]] = []
    rows: list[list[str]] = []
    places: list[list[str]] = []
    for name in names:
        found = seen[number[name]]
        overview.append(
            [
                name,
                _origin(report, stated[name]),
                "yes" if stated[name].constants[-1] else "no",
                str(found.places),
                short(found.rms / report.small),
                short(found.normalised),
            ]
        )
        rows += _values(report, name, stated[name])
        places += _place(report, name)
    angle = decimal_angle(units.angle)
    header = [
        "frame",
        f"origin [{units.length}]",
        "level",
        "places",
        f"RMS v [{units.sigma_length}]",
    ]
    header += ["RMS v/σ"]
    second = [
        "frame",
        *(f"{a} [{angle}]" for a in "ωφκ"),
        *(f"{a} [{units.length}]" for a in "xyz"),
    ]
    small = f"σ [{units.sigma_angle}, {units.sigma_length}, ppm]"
    return [
        *title("Frames"),
        *table(header, overview, left=3),
        *note,
        "",
        *table([*second, "scale"], [r if r[0] else [f"  {small}", *r[1:]] for r in rows]),
        "",
        *table(
            ["frame", *(f"{a} [{units.length}]" for a in PLACE)],
            [r if r[0] else [f"  σ [{units.sigma_length}]", *r[1:]] for r in places],
        ),
        *paragraph(MEANING),
    ]


def measured_frames(report: Report) -> list[str]:
    """Return the frames in which something was measured, and those that are no shapes."""
    return _own(report, _seen(report))


def _own(report: Report, seen: list[_Seen]) -> list[str]:
    """Return the frames of the section; a shape has a table of its own instead."""
    number = report.solution.equations.unknowns["frame"].number
    shapes = {s.name for s in report.shapes}
    return [n for n in report.network.frames if n not in shapes or seen[number[n]].places]


def _place(report: Report, name: str) -> list[list[str]]:
    """Return two rows of the table of places: X, Y, Z of a frame's zero, and their σ."""
    e = place_of_frame(report.solution, name)
    small = [float(s) / report.small for s in e.sigmas]
    digits = decimals([s * report.small / report.metre for s in small], default=4, most=9)
    values = [decimal(float(v) / report.metre, digits) for v in e.values]
    return [[name, *values], ["", *("held" if s == 0 else short(s) for s in small)]]


def _origin(report: Report, stated: Parameter) -> str:
    """Return the point at the origin, or its constant coordinates."""
    if stated.origin:
        return f"point {stated.origin}"
    return " ".join(_short(v / report.metre) for v in stated.constants[:3])


def _short(value: float) -> str:
    """Return a constant coordinate with at most three decimals."""
    return f"{value + 0.0:.3f}".rstrip("0").rstrip(".")


def _seen(report: Report) -> list[_Seen]:
    """Return what was measured in each frame, by number."""
    equations = report.solution.equations
    n = len(equations.unknowns["frame"].names)
    places: list[set[tuple[str, int]]] = [set() for _ in range(n)]
    lengths, scalars, square, norm = np.zeros((4, n))
    for block in equations.blocks:
        if (
            not block.named
            or block.variables[0][0] != "frame"
            or observation_kind(block.kind).shape
        ):
            continue
        index = block.variables[0][1]
        for (kind, numbers), attribute in zip(block.arguments, block.named, strict=True):
            if kind in ("point", "pose") and "." not in attribute:
                for i, number in np.unique(np.stack([index, numbers], 1), axis=0).tolist():
                    places[i].add((kind, number))
        v = report.solution.observations.residuals[block.rows].reshape(block.observed.shape)
        scalars += block.dimension * np.bincount(index, minlength=n)
        norm += np.bincount(index, np.sum((v / block.sigma) ** 2, axis=1), n)
        if block.unit == "m":
            lengths += block.dimension * np.bincount(index, minlength=n)
            square += np.bincount(index, np.sum(v**2, axis=1), n)
    with np.errstate(invalid="ignore"):
        found = zip(places, np.sqrt(square / lengths), np.sqrt(norm / scalars), strict=True)
    return [_Seen(len(p), float(v), float(w)) for p, v, w in found]


def _values(report: Report, name: str, stated: Parameter) -> list[list[str]]:
    """Return two rows of the table: the values of a frame, and their σ."""
    solution, units = report.solution, report.units
    table_ = solution.equations.unknowns["frame"]
    stored = solution.state["frame"][table_.number[name]]
    rotation, offset, ln_scale, _, _ = (x[0] for x in split_frame(stored[None]))
    covariance = solution.variable_covariance(("frame", name))
    # ω, φ, κ turn photogrammetric axes, and the functions take rotations of camera axes.
    camera = rotation @ TURN_ABOUT_X
    turn = angles_by_rotation(camera) @ TURN_ABOUT_X
    by_angles = np.diag(turn @ covariance[:3, :3] @ turn.T).tolist()
    variances = [*by_angles, *np.diag(covariance)[3:].tolist()]
    sizes = [report.radian] * 3 + [report.small] * 3 + [1e-6]
    sigmas = [sqrt(v) / s if v >= 0 else v for v, s in zip(variances, sizes, strict=True)]
    weighted = np.isfinite(stated.sigma) & ~np.array(stated.fixed)
    below = [
        "held" if s == 0 else short(s) + (" (w)" if w else "")
        for s, w in zip(sigmas, weighted.tolist(), strict=True)
    ]
    whole = ANGLE[decimal_angle(units.angle)]
    digits = [
        decimals([s * small / large for s in sigmas[part]], default=4, most=9)
        for part, small, large in (
            (slice(0, 3), report.radian, whole),
            (slice(3, 6), report.small, report.metre),
        )
    ]
    values = [decimal(a / whole, digits[0]) for a in omega_phi_kappa(camera)]
    values += [decimal(float(c) / report.metre, digits[1]) for c in offset]
    return [[name, *values, _scale(float(ln_scale), sigmas[6])], ["", *below]]


def _scale(ln_scale: float, sigma_ppm: float) -> str:
    """Return a scale as the factor e^ℓ, to the second digit of its σ."""
    if ln_scale == 0 and sigma_ppm == 0:
        return "1"
    scale = exp(ln_scale)
    return decimal(scale, decimals([1e-6 * sigma_ppm * scale], default=6, most=12))
