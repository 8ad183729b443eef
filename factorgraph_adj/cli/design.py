"""Commands ``plan`` (a design, its targets) and ``propose`` (cheapest additions to it), as text."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..adjustment import determined_part
from ..errors import AdjustmentError, InputError, Problem
from ..files import refuse_replacing
from ..io.project import Project, project_table_names
from ..io.project_writer import write_project
from ..planning.candidates import as_planned, identified, with_candidates
from ..planning.plan import Plan, plan
from ..planning.proposals import Proposal, propose
from ..planning.target_files import Wishes, read_wishes
from ..planning.targets import (
    DetectableError,
    RedundancyNumber,
    SemiAxis,
    Target,
    apart,
    at_least,
    describe,
    for_points,
    limit_of,
)
from ..report.doubtful_results import listed_points_text, unknowns_left_out
from ..units import LENGTH
from ..validate.network_structure import problems_with_lines
from .input import add_project, read_input, reading_options
from .messages import EXIT_DOUBTFUL, EXIT_FINE, FURTHER_EXIT_CODES
from .options import add_leave_out, add_probabilities, positive_count

DEFAULT_ROWS_LISTED = 20
"""Default number of rows of a list (option --rows)."""
NO_READINGS = "No readings are needed: observations.csv may go without its column value."


def add_plan(look: argparse.ArgumentParser) -> None:
    """Add the arguments of ``plan``."""
    look.description = (
        f"Tell what a design will give, and whether it meets its targets. {NO_READINGS}"
    )
    look.epilog = (
        "exit codes: 0 all targets are met, or there are none; 1 a target is not met; "
        f"{FURTHER_EXIT_CODES}; 2 also where the design is not determined"
    )
    add_project(look)
    look.add_argument("--targets", metavar="FILE", help="TOML with [[target]] tables to check")
    _add_common(look)
    add_leave_out(look)
    look.set_defaults(run=_plan, command="plan")


def add_propose(wish: argparse.ArgumentParser) -> None:
    """Add the arguments of ``propose``."""
    wish.description = (
        f"Propose the cheapest additions with which a design meets its targets. {NO_READINGS}"
    )
    wish.epilog = (
        "exit codes: 0 a proposal was found, or nothing has to be added; 1 the targets "
        f"cannot be met; {FURTHER_EXIT_CODES}; 2 also where the design is not determined"
    )
    add_project(wish)
    wish.add_argument(
        "candidates",
        metavar="CANDIDATES",
        help="TOML with [[target]] and [[candidate]] tables; [files] names a CSV of candidates",
    )
    wish.add_argument(
        "--out",
        metavar="PROJECT",
        help="write the design as proposed: a .toml file, or a folder for project.toml",
    )
    add_leave_out(wish)
    _add_common(wish)
    wish.set_defaults(run=_propose, command="propose")


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rows", type=positive_count, metavar="N", help=f"rows of a list ({DEFAULT_ROWS_LISTED})"
    )
    add_probabilities(parser)


def _plan(options: argparse.Namespace) -> int:
    project = read_input(options, readings=False)
    wishes = Wishes((), ())
    if options.targets is not None:
        wishes = read_wishes(options.targets, project, candidates=False)
        if not wishes.targets:
            raise InputError(Problem("has no [[target]]", options.targets))
    with _hint_at_adjustment(options, project), _lines_of(project):
        found = plan(
            project.network,
            wishes.targets,
            alpha=options.alpha,
            power=options.power,
            leave_out_undetermined=options.leave_out_undetermined,
        )
    for said in unknowns_left_out(found.network):
        print(said, file=sys.stderr)
    print(render_plan(found, options.rows or DEFAULT_ROWS_LISTED))
    return EXIT_FINE if found.met else EXIT_DOUBTFUL


def _propose(options: argparse.Namespace) -> int:
    project = read_input(options, readings=False)
    wishes = read_wishes(options.candidates, project)
    problems = [
        Problem(f"has no [[{what}]]", options.candidates)
        for what, given in (("target", wishes.targets), ("candidate", wishes.candidates))
        if not given
    ]
    out = None
    if options.out is not None:
        out = _checked_out(options.out, project, problems)
        try:
            refuse_replacing(
                [out, *(out.with_name(f"{table}.csv") for table in project_table_names())]
            )
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    chances = {"alpha": options.alpha, "power": options.power}
    rows = options.rows or DEFAULT_ROWS_LISTED
    if options.leave_out_undetermined:
        with _hint_at_adjustment(options, project), _lines_of(project):
            project = replace(project, network=determined_part(as_planned(project.network)))
        for said in unknowns_left_out(project.network):
            print(said, file=sys.stderr)
    try:
        with _hint_at_adjustment(options, project):
            found = propose(project.network, wishes.candidates, wishes.targets, **chances)
    except InputError as error:
        try:
            unmet = _unmet(project, wishes, **chances)
        except AdjustmentError:
            raise InputError(problems_with_lines(error.problems, project.sources)) from None
        if not unmet.explains(error):
            raise
        print(render_unmet(unmet, error, rows))
        return EXIT_DOUBTFUL
    print(render_proposal(found, rows))
    if out is not None:
        write_project(found.plan.network, out, units=project.units)
        print(f"\n{out}: the design as proposed; its readings are those that its coordinates give")
    return EXIT_FINE


@contextmanager
def _lines_of(project: Project) -> Iterator[None]:
    """Report problems of unknowns with the file and line of the project that state them."""
    try:
        yield
    except InputError as error:
        raise InputError(problems_with_lines(error.problems, project.sources)) from None


@contextmanager
def _hint_at_adjustment(options: argparse.Namespace, project: Project) -> Iterator[None]:
    """Note, where coordinates are missing, the command that gives those of a measured network.

    A design whose observations have no values cannot be adjusted: it needs coordinates of a map.
    """
    try:
        yield
    except InputError as error:
        network = project.network
        missing = [n for n, p in network.points.items() if not np.isfinite(p.coordinates).all()]
        if not missing or not _has_readings(options):
            raise
        words = ["factorgraph-adj", "adjust", str(options.project), *reading_options(options)]
        command = shlex.join([*words, "--export", "next/project.toml"])
        error.add_note(
            f"These points are measured: {command} writes the adjusted network, with their "
            f"coordinates; then: factorgraph-adj {options.command} next"
        )
        raise


def _has_readings(options: argparse.Namespace) -> bool:
    """Return whether the observations of the project have values."""
    try:
        network = read_input(options).network
    except InputError:
        return False
    return bool(network.observations)


@dataclass(frozen=True)
class _Unmet:
    """Targets that no choice of candidates meets."""

    best: Plan
    """The design with all candidates."""
    hopeless: bool
    """Whether points and observations of the design miss targets even with all candidates."""
    which: str
    """Description of all candidates."""

    def explains(self, error: InputError) -> bool:
        """Return whether an error concerns only items of the targets; others mean bad input."""
        items = {i for t in self.best.targets for i in self.best.figures(t)[0]}
        return all(
            p.where in items or any(p.where.startswith(f"{i}: ") for i in items)
            for p in error.problems
        )


def _unmet(project: Project, wishes: Wishes, *, alpha: float, power: float) -> _Unmet:
    """Return the unmet targets of the design with all candidates; raise problems of the input."""
    own = list(project.network.points)
    targets = tuple(for_points(t, own) for t in wishes.targets)
    without = plan(project.network, alpha=alpha, power=power)
    before = Plan(without.solution, without.reliability, targets)
    whole = with_candidates(project.network, identified(wishes.candidates))
    best = plan(whole, targets, alpha=alpha, power=power)
    hopeless = {s.item for s in before.shortfalls} & {s.item for s in best.shortfalls}
    n, cost = len(wishes.candidates), sum(c.cost for c in wishes.candidates)
    which = f"all {n} candidates together" if n > 1 else "the only candidate"
    return _Unmet(best, bool(hopeless), f"{which}, cost {cost:g}")


def _checked_out(name: str, project: Project, problems: list[Problem]) -> Path:
    """Return the file of the proposed design; it must not overwrite the design."""
    path = Path(name)
    if path.suffix != ".toml":
        path = path / "project.toml"
    if path.parent.resolve() == project.path.parent.resolve():
        # Even with another TOML file, the tables of the design would be overwritten.
        problems.append(Problem("--out must be in another folder than the design", name))
    return path


def render_plan(found: Plan, rows: int) -> str:
    """Return a plan as text: points, weakest observations, targets."""
    solution, rel = found.solution, found.reliability
    lines = [
        f"Plan of {found.network.name or 'a network'}: {solution.n_observations} observations, "
        f"{solution.n_unknowns} unknowns, redundancy {solution.redundancy}; σ0 = 1",
        *unknowns_left_out(found.network),
        *listed_points_text(found.network),
        "",
    ]
    names = [n for n, p in found.network.points.items() if not all(p.fixed)]
    if names:
        axis = SemiAxis(1.0, points=tuple(names))
        figures = dict(zip(*found.figures(axis), strict=True))
        order = sorted(names, key=lambda n: -figures[n])[:rows]
        width = max(len(n) for n in (*order, "point"))
        heads = "".join(f"{f'σ{a}, mm':>9}" for a in "XYZ")
        lines.append(f"  {'point':{width}}{heads}  95 % semi-axis, mm")
        for n in order:
            sigma = 1000 * solution.standard_deviations(n)
            cells = "".join(f"{s:9.2f}" for s in sigma)
            lines.append(f"  {n:{width}}{cells}{1000 * figures[n]:20.2f}")
        if len(names) > rows:
            lines.append(f"  … {len(names) - rows} more, smaller")
        lines.append("")
    r = rel.redundancy_numbers
    loose = np.flatnonzero(~rel.controlled)
    lines.append(
        f"  redundancy numbers: mean {max(float(r.mean()), 0.0):.2f}, {len(loose)} not controlled"
    )
    lines += [f"    not controlled: {solution.equations.label(i)}" for i in loose[:rows].tolist()]
    if len(loose) > rows:
        lines.append(f"    … {len(loose) - rows} more")
    if found.targets:
        lines += ["", *_targets(found, rows)]
    return "\n".join(lines)


def _targets(found: Plan, rows: int) -> list[str]:
    lines = []
    for t in found.targets:
        failing = [s for s in found.shortfalls if s.target is t]
        what, unit, size = _measure(t)
        sign, limit = "≥" if at_least(t) else "≤", limit_of(t) / size
        state = "met" if not failing else f"{len(failing)} fail"
        lines.append(f"  target: {what} {sign} {limit:g}{unit}: {state}")
        lines += [f"    {s.item}: {apart(s.figure / size, limit)[0]}{unit}" for s in failing[:rows]]
        if len(failing) > rows:
            lines.append(f"    … {len(failing) - rows} more")
    return lines


def _measure(target: Target) -> tuple[str, str, float]:
    """Return the name of a target's figures, their printed unit, and the size of the unit in SI."""
    what = re.sub(r" \([^()]+\)$", "", describe(target))
    if isinstance(target, RedundancyNumber):
        return what, "", 1.0
    if isinstance(target, DetectableError):
        return what, " σ", 1.0
    return what, " mm", LENGTH["mm"]


def render_unmet(found: _Unmet, error: InputError, rows: int) -> str:
    """Return a text about the targets that are unmet with all candidates together."""
    if found.hopeless:
        head = [f"The targets cannot be met. The best that can be had, with {found.which}:"]
    else:
        head = ["No choice of candidates was found that meets the targets:"]
        head += [f"  {p}" for p in error.problems[:rows]]
        head += ["", f"With {found.which}:"]
    return "\n".join([*head, "", render_plan(found.best, rows)])


def render_proposal(found: Proposal, rows: int) -> str:
    """Return a proposal as text."""
    if not found.steps:
        return "All targets are met: nothing has to be added.\n\n" + render_plan(found.plan, rows)
    width = max(len(s.candidate.name) for s in found.steps)
    lines = [
        f"{len(found.before.shortfalls)} items fail the targets. To be added, cost {found.cost:g}:",
        "",
        f"  {'':{width}}    cost  together    gain    lack left",
    ]
    for s in found.steps:
        lines.append(
            f"  {s.candidate.name:{width}}{s.candidate.cost:8g}{s.cost:10g}{s.gain:8.3f}"
            f"{max(s.lack, 0.0):13.3f}"
        )
    lines += ["", "  gain and lack: sum over all items of the logarithm of figure and limit", ""]
    return "\n".join(lines) + render_plan(found.plan, rows)
