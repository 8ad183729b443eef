"""The commands ``factorgraph-adj plan`` and ``propose``: designs, before anything is measured."""

from __future__ import annotations

import argparse

import numpy as np

from .errors import InputError, Problem
from .options import add_probabilities, add_project, count, read
from .planning.files import Wishes, read_wishes
from .planning.plan import Plan, plan
from .planning.propose import Proposal, propose
from .planning.targets import SemiAxis, describe, limit_of, short

FINE, FAILED = 0, 1
LISTED = 20
"""Rows of a list, unless --rows says otherwise."""


def add_plan(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands."""
    look = commands.add_parser("plan", help="what a design will give; it needs no readings")
    add_project(look)
    look.add_argument("--targets", metavar="FILE", help="TOML with [[target]] tables to check")
    _add_common(look)
    look.set_defaults(run=_plan)
    wish = commands.add_parser("propose", help="the cheapest additions that meet the targets")
    add_project(wish)
    wish.add_argument(
        "candidates", metavar="CANDIDATES", help="TOML with [[target]] and [[candidate]] tables"
    )
    _add_common(wish)
    wish.set_defaults(run=_propose)


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rows", type=count, metavar="N", help=f"rows of a list ({LISTED})")
    add_probabilities(parser)


def _plan(options: argparse.Namespace) -> int:
    project = read(options.project, readings=False)
    wishes = Wishes((), ())
    if options.targets is not None:
        wishes = read_wishes(options.targets, project)
    found = plan(project.network, wishes.targets, alpha=options.alpha, power=options.power)
    print(render_plan(found, options.rows or LISTED))
    return FINE if found.met else FAILED


def _propose(options: argparse.Namespace) -> int:
    project = read(options.project, readings=False)
    wishes = read_wishes(options.candidates, project)
    missing = [
        Problem(f"has no [[{what}]]", options.candidates)
        for what, given in (("target", wishes.targets), ("candidate", wishes.candidates))
        if not given
    ]
    if missing:
        raise InputError(missing)
    found = propose(
        project.network,
        wishes.candidates,
        wishes.targets,
        alpha=options.alpha,
        power=options.power,
    )
    print(render_proposal(found, options.rows or LISTED))
    return FINE


def render_plan(found: Plan, rows: int) -> str:
    """Return a plan as text: points, weakest observations, targets."""
    solution, rel = found.solution, found.reliability
    lines = [
        f"Plan of {found.network.name or 'a network'}: {solution.n_observations} observations, "
        f"{solution.n_unknowns} unknowns, redundancy {solution.redundancy}; σ0 = 1",
        "",
    ]
    names = [n for n, p in found.network.points.items() if not all(p.fixed)]
    if names:
        axis = SemiAxis(1.0, points=tuple(names))
        figures = dict(zip(*found.figures(axis), strict=True))
        order = sorted(names, key=lambda n: -figures[n])[:rows]
        width = max(len(n) for n in (*order, "point"))
        lines.append(f"  {'point':{width}}   σX      σY      σZ      95 % semi-axis, mm")
        for n in order:
            sigma = 1000 * solution.standard_deviations(n)
            cells = "".join(f"{s:8.2f}" for s in (*sigma, 1000 * figures[n]))
            lines.append(f"  {n:{width}}{cells}")
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
        sign = "≥" if describe(t) == "redundancy number" else "≤"
        state = "met" if not failing else f"{len(failing)} fail"
        lines.append(f"  target: {describe(t)} {sign} {limit_of(t):g}: {state}")
        lines += [f"    {s.item}: {short(s.figure)}" for s in failing[:rows]]
        if len(failing) > rows:
            lines.append(f"    … {len(failing) - rows} more")
    return lines


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
