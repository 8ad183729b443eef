"""What a protocol says of a run of the command, and the pairs of places that its options name."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import fields
from datetime import datetime
from typing import Literal

from ..errors import InputError, Problem, known
from ..io.project import AdjustOptions, Project
from ..network.network import Network
from ..quality.relative import Place
from ..report.options import Run


def run_of(options: argparse.Namespace, project: Project | None = None) -> Run:
    """Return file, date and options of a run.

    Args:
        options: options of the command, with all that was ``typed``.
        project: the project, whose own options are told where they are not the usual ones.
    """
    named = options.project if isinstance(options.project, list) else [options.project]
    typed = options.typed[1:]
    for name in named:
        typed.remove(name)
    said = [shlex.join(typed) or "none", *_own(project)]
    return Run(", ".join(named), _date(options.date), "; ".join(said))


def _date(stated: str | None) -> str:
    if stated is not None:
        return "" if stated == "none" else stated
    return datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z")


def _own(project: Project | None) -> list[str]:
    """Return the options of a project that are not the usual ones."""
    if project is None:
        return []
    usual, stated = AdjustOptions(), project.options
    each = ((f.name, getattr(stated, f.name), getattr(usual, f.name)) for f in fields(usual))
    said = [f"{name} {value}" for name, value, default in each if value != default]
    return [f"of the project: {', '.join(said)}"] if said else []


def lines_of(
    options: argparse.Namespace, network: Network
) -> list[tuple[Place, Place]] | Literal["observed"] | None:
    """Return the pairs of places whose lines are wanted; None without an option for them.

    Raises:
        InputError: an option names no two places of the network.
    """
    if options.between is None:
        return "observed" if options.relative else None
    if options.relative:
        raise InputError("--relative lists all pairs that observations join, --between one pair")
    problems: list[Problem] = []
    pairs = [_pair(text, network, problems) for text in options.between]
    if problems:
        raise InputError(problems)
    return [pair for pair in pairs if pair is not None]


def _pair(text: str, network: Network, problems: list[Problem]) -> tuple[Place, Place] | None:
    """Return the two places of A,B; names may have commas of their own."""
    commas = [i for i, c in enumerate(text) if c == ","]
    for i in commas:
        a, b = (_place(part.strip(), network) for part in (text[:i], text[i + 1 :]))
        if a is not None and b is not None and a != b:
            return a, b
    names = [*network.points, *network.photos]
    what = "needs two places of the network, such as A,B"
    if len(commas) == 1:
        wrong = [p.strip() for p in text.split(",") if _place(p.strip(), network) is None]
        what = f"unknown {wrong[0]!r}" if wrong else "needs two different places"
    problems.append(Problem(f"{what}; known: {known(names)}", f"--between {text}"))
    return None


def _place(name: str, network: Network) -> Place | None:
    if name in network.points:
        return name
    return ("pose", name) if name in network.photos else None
