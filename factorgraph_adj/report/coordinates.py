"""Sections of the protocol: adjusted points, check points, photos."""

from __future__ import annotations

from math import isfinite, nan, sqrt

from ..quality.check_points import check_points as compare
from ..types import Array
from ..units import decimal, format_angle
from .context import Report
from .layout import decimals, exponent, rms, short, table, title
from .precision import ellipse_columns

NOT_AT_A_MINIMUM = (
    "not converged: standard deviations belong to the place where the iteration stopped; at a "
    "minimum they may be several times larger or smaller"
)
"""What is said of the precision of a result that is none."""


def points(report: Report) -> list[str]:
    """Return adjusted coordinates with their standard deviations, RMS and weakest point."""
    given = {n: p for n, p in report.network.points.items() if not p.side_shot}
    names = [n for n in given if report.free("point", n)]
    if not names:
        return []
    sigmas = {n: [s / report.small for s in report.sigmas[n]] for n in names}
    places, _ = digits_of_points(report)
    axes = [i for i in range(3) if not all(given[n].fixed[i] for n in names)]
    out = [*title("Adjusted coordinates"), *_coordinates(report, list(given), axes)]
    if not report.solution.converged:
        out.append(f"  {NOT_AT_A_MINIMUM}")
    if len(names) > 1:
        free = {i: [sigmas[n][i] for n in names if not given[n].fixed[i]] for i in axes}
        mean = ", ".join(f"σ{'xyz'[i]} {rms(each):.{places}f}" for i, each in free.items())
        worst = max(names, key=lambda n: sum(s * s for s in sigmas[n]))
        out.append(
            f"  root mean square {mean} {report.units.sigma_length}; weakest point {worst}: "
            f"{sqrt(sum(s * s for s in sigmas[worst])):.{places}f} {report.units.sigma_length}"
        )
    return out


def side_shots(report: Report) -> list[str]:
    """Return the side shots: points that follow from the adjusted ones, and bear on none."""
    given = report.network.points
    names = [n for n, p in given.items() if p.side_shot and report.free("point", n)]
    if not names:
        return []
    axes = [i for i in range(3) if not all(given[n].fixed[i] for n in names)]
    heading = title("Side shots: computed from the adjusted points; nothing checks them")
    return [*heading, *_coordinates(report, names, axes)]


def _coordinates(report: Report, names: list[str], axes: list[int]) -> list[str]:
    """Return the table of the coordinates of some points, with their standard deviations."""
    solution, units, given = report.solution, report.units, report.network.points
    places, digits = digits_of_points(report)
    shown, note = report.cut(names, "points", "points.csv")
    figures, cells, meaning = ellipse_columns(report, places)
    rows = []
    for name in shown:
        xyz, fixed = solution.point(name).tolist(), given[name].fixed
        place = [decimal(xyz[i] / report.metre, digits) for i in axes]
        sigmas = [s / report.small for s in report.sigmas[name]]
        sigma = ["held" if fixed[i] else f"{sigmas[i]:.{places}f}" for i in axes]
        rows.append([name, *place, *sigma, *cells.get(name, [""] * len(figures))])
    header = ["point", *(f"{'xyz'[i]} [{units.length}]" for i in axes)]
    header += [f"σ{'xyz'[i]} [{units.sigma_length}]" for i in axes]
    return [*table([*header, *figures], rows), *note, *([meaning] if meaning else [])]


def digits_of_points(report: Report) -> tuple[int, int]:
    """Return the decimals of σ of points, and those of coordinates, which show as much."""
    names = (n for n in report.network.points if report.free("point", n))
    sigmas = (s / report.small for n in names for s in report.sigmas[n])
    places = decimals(sigmas, default=2, most=5)
    return places, min(max(places + exponent(report.metre / report.small * 1.0001), 0), 9)


def check_points(report: Report) -> list[str]:
    """Return the differences at check points, whose coordinates are known, and their RMS."""
    found = compare(report.solution)
    if not found.names:
        return []
    differences = (found.differences / report.small).tolist()
    known = [abs(v) for three in differences for v in three if isfinite(v)]
    places = decimals(known, default=2, most=5)

    def row(name: str, values: Array | list[float]) -> list[str]:
        return [name, *(decimal(v, places) if isfinite(v) else "" for v in values)]

    rows = [row(name, d) for name, d in zip(found.names, differences, strict=True)]
    shown, note = report.cut(rows, "check points", "points.csv")
    total = row("RMS", found.rms / report.small)
    expected = row("RMS σ", found.rms_sigma / report.small)
    header = ["check point", *(f"d{a} [{report.units.sigma_length}]" for a in "xyz")]
    heading = title("Check points: adjusted − known coordinates, which took no part")
    return [*heading, *table(header, [*shown, total, expected]), *note]


def photos(report: Report) -> list[str]:
    """Return exterior orientation, standard deviations, number of points and RMS of each photo."""
    network, units = report.network, report.units
    if not network.photos:
        return []
    counts, norms = by_photo(report)
    digits = {"dms": 1, "rad": 6, "mrad": 3, "mgon": 1, "cc": 0, "arcsec": 0}.get(units.angle, 4)
    names, note = report.cut(list(network.photos), "photos", "photos.csv")
    rows = []
    for name in names:
        pose = report.poses[name]
        place = [decimal(v / report.metre, 4) for v in pose.position]
        angles = [format_angle(v, units.angle, digits) for v in pose.angles]
        rows.append(
            [
                name,
                str(counts[name]),
                f"{norms[name]:.2f}" if counts[name] else "–",
                *place,
                *angles,
            ]
        )
        if not report.free("pose", name):
            rows.append(["", "", "", *["held"] * 6])
            continue
        about = [s / report.radian for s in pose.sigma_angles]
        centre = [s / report.small for s in pose.sigma_position]
        sigmas = zip([*centre, *about], held_of_pose(network.photos[name].fixed), strict=True)
        label = f"σ [{units.sigma_length}, {units.sigma_angle}]"
        rows.append(["", "", label, *("held" if held else short(s) for s, held in sigmas)])
    header = ["photo", "points", "RMS v/σ", *(f"{a} [{units.length}]" for a in ("X0", "Y0", "Z0"))]
    header += [f"{a} [{units.angle}]" for a in "ωφκ"]
    stopped = [] if report.solution.converged else [f"  {NOT_AT_A_MINIMUM}"]
    return [*title("Photos"), *table(header, rows), *note, *stopped]


def held_of_pose(fixed: tuple[bool, ...]) -> tuple[bool, ...]:
    """Return whether X0, Y0, Z0, ω, φ, κ are held; an angle is held if all rotations are."""
    return (*fixed[3:], *[all(fixed[:3])] * 3)


def by_photo(report: Report) -> tuple[dict[str, int], dict[str, float]]:
    """Return number of image points and RMS v/σ of each photo."""
    names = list(report.network.photos)
    counts, squares = dict.fromkeys(names, 0), dict.fromkeys(names, 0.0)
    normalised = report.solution.observations.normalised
    for block in report.solution.equations.blocks:
        if block.kind != "image":
            continue
        v = normalised[block.rows].reshape(block.observed.shape)
        each = (v * v).sum(axis=1).tolist()
        for photo, square in zip(block.variables[0][1].tolist(), each, strict=True):
            counts[names[photo]] += 1
            squares[names[photo]] += square
    return counts, {n: sqrt(squares[n] / (2 * c)) if c else nan for n, c in counts.items()}
