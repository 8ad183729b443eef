"""Tables of places: points, check points, photos, lines between two places."""

from __future__ import annotations

from math import isfinite

import numpy as np

from ...quality.check_points import check_points as compare
from ...units import decimal, format_angle, format_turn
from ..context import Report
from ..coordinates import by_photo, digits_of_points, held_of_pose
from ..geographic import angle_digits
from ..layout import decimals, percent, short
from ..lines import place_name
from ..plots.marks import status_of
from ..precision import coarse, ellipse_columns
from ..weakest import point_redundancy
from .language import Texts
from .sheets import NONE, Column, Head, Sheet, columns_of, sheet

NEW = "new"
"""What a point is that is nothing else."""
STATES = ("held", "part", "known", "check", "datum", "station", NEW, "side_shot")
"""Keys of what a point may be; the first that fits is shown, and `NEW` where none does."""


def states(report: Report) -> list[str]:
    """Return the key of what each point is, one of `STATES`."""
    status = status_of(report.solution)
    out = np.full(len(report.network.points), NEW, dtype=object)
    for key in reversed([k for k in STATES if k != NEW]):
        out[getattr(status, key)] = key
    return [str(k) for k in out]


def largest_tests(report: Report) -> np.ndarray:
    """Return the largest |w| or |τ| of the observations of each point; NaN without any, (n,)."""
    out = np.full(len(report.network.points), np.nan)
    values = report.tests[0]
    if not len(values):
        return out
    for block in report.solution.equations.blocks:
        size = np.abs(values[block.rows].reshape(block.observed.shape))
        largest = np.fmax.reduce(size, axis=1)
        for kind, index in block.variables:
            if kind == "point":
                np.fmax.at(out, index, largest)
    return out


def points(report: Report, t: Texts) -> Sheet | None:
    """Return adjusted coordinates with standard deviations, ellipses and redundancy."""
    network, units, given = report.network, report.units, report.network.points
    places, digits = digits_of_points(report)
    x = report.solution.state["point"] / report.metre
    columns = [
        Column(t("col.point"), list(given)),
        Column(t("col.state"), [t(f"state.{k}") for k in states(report)]),
    ]
    for i, a in enumerate("xyz"):
        values = [decimal(v, digits) for v in x[:, i].tolist()]
        columns.append(Column(f"{a} [{units.length}]", values, True))
    if not report.singular:
        sigmas = np.array([report.sigmas[n] for n in given]).reshape(-1, 3) / report.small
        for i, a in enumerate("xyz"):
            held = [p.fixed[i] for p in given.values()]
            cells = [
                t("held") if h else f"{s:.{places}f}"
                for h, s in zip(held, sigmas[:, i].tolist(), strict=True)
            ]
            columns.append(Column(f"σ{a} [{units.sigma_length}]", cells, True))
        header, cells_of, _ = ellipse_columns(report, places)
        for i, head in enumerate(header):
            values = [cells_of[n][i] if n in cells_of else "" for n in given]
            title = head.replace("azimuth", t("col.azimuth"))
            columns.append(Column(title, values, True, t("help.ellipse")))
        columns += _geographic(report, t, digits)
    if report.reliability is not None:
        counts = point_redundancy(report.reliability)
        mean = counts.redundancy / np.maximum(counts.rows, 1)
        columns += [
            Column(t("col.scalars"), [str(n) for n in counts.rows.tolist()], True),
            Column(
                t("col.mean_r"),
                [
                    f"{max(v, 0.0):.2f}" if n else NONE
                    for v, n in zip(mean.tolist(), counts.rows.tolist(), strict=True)
                ],
                True,
                t("help.r"),
            ),
            Column(
                f"max |{'τ' if report.pope else 'w'}|",
                [f"{v:.2f}" if isfinite(v) else NONE for v in largest_tests(report).tolist()],
                True,
                t("help.test"),
            ),
        ]
    notes = [t("points.reference")] if report.solution.datum is not None else []
    if report.options.confidence is not None:
        notes.append(t("points.ellipses", level=percent(report.options.confidence)))
    if not network.points:
        return None
    return sheet("points", t("points.caption"), columns, notes=notes)


def _geographic(report: Report, t: Texts, digits: int) -> list[Column]:
    found = report.geographic
    if found is None:
        return []
    unit, small = report.units.geographic, report.units.sigma_length
    fine = angle_digits(unit, digits, report.metre)
    out = []
    for key, values in (("col.latitude", found.latitude), ("col.longitude", found.longitude)):
        cells = [format_angle(v, unit, fine) for v in values.tolist()]
        out.append(Column(f"{t(key)} [{unit}]", cells, unit != "dms"))
    heights = [decimal(v / report.metre, digits) for v in found.height.tolist()]
    out.append(Column(f"{t('col.height')} [{report.units.length}]", heights, True))
    for i, a in enumerate("ENU"):
        sigmas = [short(v) for v in (found.sigma[:, i] / report.small).tolist()]
        out.append(Column(f"σ{a} [{small}]", sigmas, True))
    return out


def check_points(report: Report, t: Texts) -> Sheet | None:
    """Return the differences at check points, with mean, RMS and expected RMS as notes."""
    if report.singular:
        return None
    found = compare(report.solution)
    if not found.names:
        return None
    unit = report.units.sigma_length
    d = found.differences / report.small
    places = decimals(np.abs(d[np.isfinite(d)]).tolist(), default=2, most=5)

    def cell(value: float) -> str:
        return decimal(value, places) if isfinite(value) else NONE

    columns = [Column(t("col.point"), list(found.names))]
    for i, a in enumerate("xyz"):
        columns.append(Column(f"d{a} [{unit}]", [cell(v) for v in d[:, i].tolist()], True))
    for name, values in (
        (f"√(dx²+dy²) [{unit}]", np.hypot(d[:, 0], d[:, 1])),
        (f"√(dx²+dy²+dz²) [{unit}]", np.sqrt(np.sum(d**2, axis=1))),
    ):
        columns.append(Column(name, [cell(v) for v in values.tolist()], True))
    for i, a in enumerate("xyz"):
        ratio = found.normalised[:, i].tolist()
        cells = [decimal(v, 2) if isfinite(v) else NONE for v in ratio]
        columns.append(Column(f"d{a}/σ", cells, True, t("help.check_ratio")))

    def three(values: np.ndarray) -> str:
        return ", ".join(cell(v) for v in (values / report.small).tolist())

    note = t(
        "check.note",
        unit=unit,
        mean=three(found.mean),
        rms=three(found.rms),
        expected=three(found.rms_sigma),
    )
    return sheet("check", t("check.caption"), columns, notes=[note])


def photos(report: Report, t: Texts) -> Sheet | None:
    """Return exterior orientations with their standard deviations, points and RMS."""
    network, units = report.network, report.units
    if not network.photos:
        return None
    counts, norms = by_photo(report)
    digits = {"dms": 1, "rad": 6, "mrad": 3, "mgon": 1, "cc": 0, "arcsec": 0}.get(units.angle, 4)
    rows = []
    for name, photo in network.photos.items():
        rms = f"{norms[name]:.2f}" if counts[name] else NONE
        cells = [name, photo.camera, str(counts[name]), rms]
        if report.singular:
            rows.append(cells)
            continue
        pose = report.poses[name]
        cells += [decimal(v / report.metre, 4) for v in pose.position]
        sigmas = [s / report.small for s in pose.sigma_position]
        sigmas += [s / report.radian for s in pose.sigma_angles]
        all_held = not report.free("pose", name)
        held = [all_held or h for h in held_of_pose(photo.fixed)]
        shown = [t("held") if h else short(s) for s, h in zip(sigmas, held, strict=True)]
        angles = [format_angle(v, units.angle, digits) for v in pose.angles]
        rows.append([*cells, *shown[:3], *angles, *shown[3:]])
    number = units.angle != "dms"
    heads: list[Head] = [(t("col.photo"), False), (t("col.camera"), False)]
    heads += [(t("col.image_points"), True), ("RMS v/σ", True)]
    if not report.singular:
        names = ("X0", "Y0", "Z0")
        heads += [(f"{a} [{units.length}]", True) for a in names]
        heads += [(f"σ {a} [{units.sigma_length}]", True) for a in names]
        heads += [(f"{a} [{units.angle}]", number) for a in "ωφκ"]
        heads += [(f"σ {a} [{units.sigma_angle}]", True) for a in "ωφκ"]
    return sheet("photos", t("photos.caption"), columns_of(heads, rows))


def lines(report: Report, t: Texts) -> Sheet | None:
    """Return adjusted distances, azimuths and rises with relative error ellipses."""
    units, small = report.units, report.units.sigma_length
    rows = []
    for x in report.lines:
        azimuth = format_turn(x.azimuth, units.angle, 5) if isfinite(x.azimuth) else NONE
        a, b = x.ellipse.semi_axes
        rows.append(
            [
                place_name(x.a),
                place_name(x.b),
                decimal(x.distance / report.metre, 5),
                short(x.sigma_distance / report.small),
                short(x.ppm),
                azimuth,
                short(x.sigma_azimuth / report.radian),
                decimal(x.rise / report.metre, 5),
                short(x.sigma_rise / report.small),
                short(a / report.small),
                short(b / report.small),
                coarse(report, x.ellipse.azimuth) if a > 0 else NONE,
            ]
        )
    heads: list[Head] = [
        (t("col.from"), False),
        (t("col.to"), False),
        (f"{t('col.distance')} [{units.length}]", True),
        (f"σ [{small}]", True),
        ("ppm", True),
        (f"{t('col.azimuth')} [{units.angle}]", units.angle != "dms"),
        (f"σ [{units.sigma_angle}]", True),
        (f"{t('col.rise')} [{units.length}]", True),
        (f"σ [{small}]", True),
        (f"a [{small}]", True),
        (f"b [{small}]", True),
        (f"{t('col.azimuth')} a [{units.angle}]", units.angle != "dms"),
    ]
    level = report.options.confidence
    note = t("lines.standard") if level is None else t("points.ellipses", level=percent(level))
    return sheet("lines", t("lines.caption"), columns_of(heads, rows), notes=[note])
