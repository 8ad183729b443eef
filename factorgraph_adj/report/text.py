"""Text report of an adjustment: overview, doubts, global test, datum, all sections."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from textwrap import wrap

from ..control_characters import escaped
from ..epochs.comparison_result import Congruence
from ..errors import taking
from ..quality.rejections import Snooping
from ..solve.solution import Solution
from ..statistical_tests import GlobalOutcome, GlobalTest, global_test
from ..version import __version__
from .adjusted_coordinates import lines_section
from .adjusted_observations import adjusted_observations_section, weighted_coordinates_section
from .adjusted_photos import centre_ellipsoids_section, photos_section
from .adjusted_points import check_points_section, points_section, side_shots_section
from .adjustment_report import Report
from .data_snooping import snooping_section
from .doubtful_results import notes_of_network, notes_of_solution, unknowns_left_out
from .epochs_report import render_congruence
from .frames_and_shapes import frames_section, shapes_section
from .geodetic_coordinates import (
    frame_in_words,
    geographic_section,
    grid_photos_section,
    grid_section,
    reference_system_line,
)
from .layout import LINE_WIDTH, paragraph, short, table, title
from .left_out_readings import left_out_section
from .misfit_causes import (
    all_doubts,
    causes_section,
    exchange_hints,
    given_values_section,
    most_probable_cause,
    variance_components_section,
)
from .options import Provenance, ReportOptions, Run
from .reliability import reliability_section, suspects_section, weakest_section
from .unknowns import (
    calibrations_section,
    orientations_section,
    other_unknowns_section,
    overparametrised_section,
)

NO_REDUNDANCY = "no redundancy: no observation checks another"
"""What is said in place of σ̂0 where there is none."""
GLOBAL_WORDS: dict[GlobalOutcome, str] = {
    "untested": "none",
    "accepted": "accepted",
    "too_small": "readings better than stated",
    "too_large": "REJECTED",
}
"""Words for what the global test found."""
GLOBAL_HINTS: dict[GlobalOutcome, str] = {
    "too_small": "no sign of a gross error: σ stated too large, or readings not independent",
    "too_large": "blunders, systematic errors, or standard deviations stated too small",
}
"""What an outcome of the global test may come from."""


@taking(Solution | Snooping | Congruence)
def text_report(
    solution: Solution | Snooping | Congruence,
    options: ReportOptions | None = None,
    provenance: Provenance | None = None,
) -> str:
    """Return the text report of an adjustment, or of the comparison of two epochs.

    The text report contains: the run, the network, the number of observations of each kind, datum,
    iterations and the reason of their end, σ̂0 and its test, redundancy numbers by kind, weakest
    observations and points, adjusted coordinates, corrections of weighted ones, photos, shapes,
    frames, calibrations and other unknowns with their standard deviations and tests, check points,
    the lines that the options ask for, the adjusted observations station by station, and the
    largest test values with estimated errors and inseparable observations.

    Args:
        solution: the result of `adjust`, of `snoop` (the adjustment without what was rejected),
            or of `congruence`: what moved, and why it is believed.
        options: units, lengths of lists, probabilities, tests, ellipses of an adjustment.
        provenance: data snooping or variance components that the solution comes from.
    """
    if isinstance(solution, Congruence):
        return render_congruence(solution)
    origin = provenance or Provenance()
    if isinstance(solution, Snooping):
        origin, solution = origin.with_snooping(solution), solution.solution
    return render_text(Report(solution, options or ReportOptions(), origin))


def render_text(report: Report) -> str:
    """Return a report as text."""
    precise = (
        points_section,
        side_shots_section,
        geographic_section,
        grid_section,
        weighted_coordinates_section,
        check_points_section,
        photos_section,
        grid_photos_section,
        centre_ellipsoids_section,
        shapes_section,
        frames_section,
        calibrations_section,
        orientations_section,
        other_unknowns_section,
        overparametrised_section,
        lines_section,
    )
    sections = (
        *(
            _overview,
            _observations,
            _result,
            causes_section,
            snooping_section,
            left_out_section,
            variance_components_section,
            reliability_section,
            given_values_section,
        ),
        weakest_section,
        *(() if report.singular else precise),
        adjusted_observations_section,
        suspects_section,
    )
    texts = [section(report) for section in sections]
    out = [line.rstrip() for text in texts if text for line in [*text, ""]]
    return escaped("\n".join(out[:-1]) + "\n")


def _overview(report: Report) -> list[str]:
    network = report.network
    given = network.points.values()
    weighted = sum(
        p.sigma is not None
        and any(isfinite(s) and not f for s, f in zip(p.sigma, p.fixed, strict=True))
        for p in given
    )
    counts = {
        "held": sum(all(p.fixed) for p in given),
        "held in part": sum(any(p.fixed) and not all(p.fixed) for p in given),
        "weighted": weighted,
        "side shots": sum(p.side_shot for p in given),
        "with check coordinates": sum(p.check is not None for p in given),
    }
    parts = ", ".join(f"{n} {what}" for what, n in counts.items() if n)
    out = [
        f"Adjustment of {report.subject or 'a network without a name'}",
        "=" * LINE_WIDTH,
        *doubt_lines(report),
        *note_lines(report),
        *run_lines(report.provenance.run),
        f"  frame          {frame_in_words(network.frame)}",
        *reference_system_line(report),
        f"  points         {len(network.points)}" + (f" ({parts})" if parts else ""),
    ]
    if network.photos:
        named = [f"{c.name} ({c.lens.kind})" for c in list(network.cameras.values())[:4]]
        more = f", … {len(network.cameras)} in all" if len(network.cameras) > 4 else ""
        out += [f"  photos         {len(network.photos)}"]
        out += [f"  cameras        {', '.join(named)}{more}"]
    if network.orientations:
        out += [f"  direction sets {len(network.orientations)}"]
    for sentence in (*report.solution.begun, *map(str, network.left_out), *network.remarks):
        out += paragraph(sentence, indent=2)
    return out


def run_lines(run: Run, *, width: int = 15) -> list[str]:
    """Return program, file, date and options of a run, with names padded to ``width``."""
    said = {"program": f"factorgraph_adj {__version__}", **asdict(run)}
    return [f"  {name:{width}}{text}" for name, text in said.items() if text]


def doubt_lines(report: Report) -> list[str]:
    """Return why the result is not to be trusted, and the most probable cause."""
    doubts = all_doubts(report)
    if not doubts:
        return []
    out = paragraph(f"DOUBTFUL RESULT: {'; '.join(doubts)}")
    hints = exchange_hints(report)
    if (cause := most_probable_cause(report)) and cause not in report.doubts:
        hints.insert(0, cause)
    out += paragraph("; ".join(hints), indent=4) if hints else []
    return [*out, ""]


def note_lines(report: Report) -> list[str]:
    """Return what was left out, as nothing determines it, and what is striking."""
    said = [
        *unknowns_left_out(report.network),
        *notes_of_solution(report.solution),
        *notes_of_network(report.network),
    ]
    return [line for each in said for line in (*paragraph(each), "")]


def _observations(report: Report) -> list[str]:
    rows = []
    for g in report.rows.groups():
        low, high = (short(s / g.scale.size) for s in g.sigma)
        sigma = low if low == high else f"{low} … {high}"
        plain = [f"{sigma} {g.scale.small}", f"{short(g.rms / g.scale.size)} {g.scale.small}"]
        rows.append(
            [
                g.label,
                str(g.observations),
                str(g.scalars),
                *(plain if g.scale.small else ["", ""]),
                f"{g.normalised_rms:.2f}",
                f"{g.largest:.2f}",
            ]
        )
    stated = "σ a priori" if report.components is None else "σ estimated"
    header = ["kind", "number", "scalars", stated, "RMS v", "RMS v/σ", "max |v/σ|"]
    return [*title("Observations"), *table(header, rows)]


def _result(report: Report) -> list[str]:
    s = report.solution
    test = global_test(s)
    ended = "converged" if s.converged else "NOT CONVERGED"
    out = [
        *title("Adjustment"),
        f"  observations n        {s.n_observations}",
        f"  unknowns u            {s.n_unknowns}",
        f"  datum defect d        {s.datum_defect}",
        f"  redundancy n − u + d  {s.redundancy}",
        f"  datum                 {_datum(report)}",
        f"  iterations            {s.iterations}, {ended}: {s.reason}",
        *([f"  extrapolations        {s.extrapolated}"] if s.extrapolated.count else []),
        f"  vᵀPv                  {s.vtpv:.6g}",
    ]
    if test.redundancy <= 0:
        return [*out, f"  σ̂0                    {NO_REDUNDANCY}"]
    if report.components is not None:
        return [
            *out,
            f"  σ̂0                    {test.sigma0:.5f}: weights are fitted to these residuals",
            f"  global test           {global_test_text(test, fitted=True)}",
            *_precision(report),
        ]
    out += [
        f"  σ̂0                    {test.sigma0:.5f} (a priori 1)",
        f"  global test           {global_test_text(test)}",
    ]
    if hint := GLOBAL_HINTS.get(test.outcome):
        out.append(f"                        {hint}")
    return [*out, *_precision(report)]


def global_test_text(test: GlobalTest, *, fitted: bool = False) -> str:
    """Return the result of the global test, with the bounds of σ̂0.

    Args:
        test: the test, of a network with redundancy.
        fitted: whether variance components were fitted to the residuals that it would test.
    """
    if fitted:
        return "none: it would test that fit; find blunders first (--snoop)"
    return (
        f"{GLOBAL_WORDS[test.outcome]}: χ², two-sided, {100 * (1 - test.alpha):.0f} %, "
        f"{test.lower:.4f} ≤ σ̂0 ≤ {test.upper:.4f}"
    )


def _precision(report: Report) -> list[str]:
    s = report.solution
    if report.singular:
        first, *rest = wrap(f"none: {s.run.solver.no_inverse}", LINE_WIDTH - 24)
        return [f"  precision             {first}", *(f"{'':24}{line}" for line in rest)]
    if report.components is not None:
        what = "σ of unknowns are those of the estimated weights"
        return [f"  precision             {what}"]
    a_priori = "all σ of unknowns are a priori: for a standard deviation of unit weight of 1"
    a_posteriori = f"all σ of unknowns are a posteriori: multiplied by σ̂0 = {s.sigma0:.5f}"
    chosen = a_priori if s.variance == "a-priori" else a_posteriori
    return [f"  precision             {chosen}"]


def _datum(report: Report) -> str:
    s = report.solution
    if s.datum is None:
        if report.network.datum == "free":
            return "given: what is held or known leaves no defect for a free network"
        return "given: held and weighted unknowns, control"
    flagged = sum(p.datum for p in report.network.points.values())
    which = f"{flagged} datum points" if flagged else "all points"
    return f"free network: inner constraints over {which}; free {_motions(s)}"


def _motions(solution: Solution) -> str:
    """Return the motions that inner constraints hold, in a few words."""
    found: dict[str, list[str]] = {}
    for name in (n for d in solution.defects for n in d.names()):
        what, _, axis = name.replace(" in ", " ").replace(" about ", " ").partition(" ")
        found.setdefault(what, []).append(axis)
    return ", ".join(f"{what} {' '.join(axes)}".strip() for what, axes in found.items())
