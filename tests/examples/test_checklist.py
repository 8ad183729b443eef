"""The page of what the papers name: all rows are there, and what each row names exists."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from argparse import _SubParsersAction
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from docs._ext.checklist import COUNTS, STATES, Row, counts_of_checklist, rows_by_part
from examples.papers.methods_1980 import METHODS
from examples.papers.programs_1980 import PROGRAMS
from factorgraph_adj.cli.command_line import command_parser
from factorgraph_adj.models.lens_registry import LENSES
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import KINDS
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.photo_blocks import Aerial, CrossStrips
from factorgraph_adj.simulation.spec import Spec, simulate
from factorgraph_adj.triangulation.independent_models import as_models
from tests.support.places import EXAMPLES, ROOT

RESULTS = ROOT / "docs" / "results"
ROWS = {"G": 17, "E": 8, "A": 83, "M": 30, "P": 28, "T": 7, "B": 24}
"""Number of rows by the letter of their part."""
THERE, PART, MISSING, WITHOUT = STATES


def rows() -> list[Row]:
    """Return the rows of the page."""
    return [row for part in rows_by_part().values() for row in part]


@cache
def functions_of(path: Path) -> frozenset[str]:
    """Return the names of the functions of a module."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return frozenset(n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))


@cache
def names() -> frozenset[str]:
    """Return names that a user can write: kinds, lenses, unknowns, functions, classes, options."""
    subparsers = (a for a in command_parser()._actions if isinstance(a, _SubParsersAction))
    (commands,) = subparsers
    found = {*KINDS, *LENSES, *UNKNOWNS, *dir(fga)}
    for name, parser in commands.choices.items():
        found |= {f"factorgraph-adj {name}", *parser.filled()._option_string_actions}
    for folder in (ROOT / "factorgraph_adj", EXAMPLES / "papers"):
        for path in folder.rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.FunctionDef | ast.ClassDef):
                    found.add(node.name)
                if isinstance(node, ast.FunctionDef):
                    every = (*node.args.args, *node.args.kwonlyargs)
                    found |= {a.arg for a in every}
    return frozenset(found)


def exists(evidence: str) -> bool:
    """Return whether a test, a module that is run, or an option of it exists."""
    if "::" in evidence:
        module, name = evidence.split("::")
        path = ROOT / "tests" / f"{module}.py"
        return path.is_file() and name in functions_of(path)
    python, m, module, *arguments = shlex.split(evidence)
    if (python, m) != ("python", "-m") or find_spec(module) is None:
        return False
    if not arguments:
        return True
    try:
        importlib.import_module(module).command_parser().parse_args(arguments)
    except SystemExit:
        return False
    return True


def test_the_page_has_197_rows() -> None:
    found = [r.name for r in rows()]
    assert found == [f"{letter}{i + 1}" for letter, n in ROWS.items() for i in range(n)]
    assert len(found) == 197


def test_every_row_says_what_it_is_and_what_shows_it() -> None:
    for row in rows():
        assert row.paper and row.here, row.name
        assert row.state in (THERE, PART, MISSING, WITHOUT), row.name
        assert bool(row.shown) == (row.state in (THERE, PART)), row.name


def test_everything_that_rows_name_exists() -> None:
    wrong = []
    for row in rows():
        wrong += [(row.name, e) for e in re.findall(r"`([^`]+)`", row.shown) if not exists(e)]
        for name in re.findall(r"(?<!\})`([^`]+)`", row.here):
            option = name.startswith(("--", "factorgraph-adj"))
            written = [name] if option else name.split("(")[0].split(".")
            wrong += [(row.name, w) for w in written if w not in names()]
            options = re.findall(r"(\w+)=", name)
            wrong += [(row.name, o) for o in options if o not in names()]
        for page in re.findall(r"\{doc\}`([^`]+)`", row.here):
            wrong += [(row.name, page)] if not (RESULTS / f"{page}.md").is_file() else []
        rest = re.sub(r"`[^`]+`", "", row.shown).strip()
        wrong += [(row.name, rest)] if rest else []
    assert not wrong


@pytest.mark.parametrize(
    "evidence",
    [
        "triangulation/test_models::test_the_real_strips",
        "triangulation/test_model::test_the_real_strip",
        "python -m examples.papers.methods_1890",
        "python -m examples.papers.methods_1980 --methods 31",
        "python -m examples.papers.programs_1980 --programs PAT-M44",
    ],
)
def test_what_does_not_exist_is_noticed(evidence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert not exists(evidence)
    capsys.readouterr()


def test_methods_and_programs_are_there_where_they_have_a_function() -> None:
    state = {r.name: r.state for r in rows()}
    for row in METHODS:
        assert (row.method is not None) == (state[f"M{row.number}"] in (THERE, PART)), row.name
    for i, program in enumerate(PROGRAMS, 1):
        assert (program.run is not None) == (state[f"P{i}"] in (THERE, PART)), program.name


def test_the_page_of_the_papers_has_the_counts() -> None:
    assert f"\n\n{COUNTS}\n\n" in (RESULTS / "papers.md").read_text(encoding="utf-8")
    table = re.findall(r"^\|.*?\|((?: \d+ \|)+)$", counts_of_checklist(), re.M)
    counts = np.array([[int(n) for n in re.findall(r"\d+", cells)] for cells in table])
    assert counts[:, 0].tolist() == [*ROWS.values(), 197]
    np.testing.assert_array_equal(counts[:, 0], counts[:, 1:].sum(axis=1))
    np.testing.assert_array_equal(counts[-1], counts[:-1].sum(axis=0))
    assert counts[-1, 1:].tolist() == [sum(r.state == s for r in rows()) for s in STATES]


def test_every_program_has_its_command_on_the_page_of_programs() -> None:
    text = (RESULTS / "programs.md").read_text(encoding="utf-8")
    commands = re.findall(r"`(python -m examples[^`]+)`", text)
    assert all(exists(c) for c in commands)
    own = [shlex.split(c)[-1] for c in commands if "--programs" in c]
    assert [p.name for p in PROGRAMS if p.run is not None] == own


def flat(*parts: object, **control: object) -> fga.Network:
    """Return a block over flat ground, four control points, an unknown principal distance."""
    spec = Spec(
        parts=(Aerial(strips=2, photos_per_strip=4, relief=0.0, points_per_photo=20), *parts),
        control=Control(),
        seed=7,
    )
    network = simulate(spec).network
    for name, camera in network.cameras.items():
        fixed = tuple(n != "c" for n in camera.lens.names)
        network.cameras[name] = replace(camera, fixed=fixed)
    return network


def sigma_of_c(network: fga.Network) -> float:
    """Return the standard deviation of the principal distance, in its unit."""
    solution = fga.adjust(network)
    (name,) = network.cameras
    return float(solution.unknown("calibration", name).sigma("c"))


def test_centres_or_two_flying_heights_tell_c_on_flat_ground() -> None:
    """One height tells c by tilts alone; two heights, or centres with 5 cm, tell it directly."""
    one = flat()
    height = next(iter(one.photos.values())).position[2]  # type: ignore[index]
    higher = flat(CrossStrips(height=1.5 * height))
    observed = flat()
    for n, photo in observed.photos.items():
        observed.add(fga.PhotoPosition(n, photo.position, sigma=(0.05,) * 3))
    alone = sigma_of_c(one)
    assert sigma_of_c(higher) < 0.5 * alone
    assert sigma_of_c(observed) < 0.5 * alone


def test_units_of_nine_photos_and_triplets_across_are_blocks() -> None:
    """Hirvonen's units of three by three photos; triplets along strips and across them."""
    block = Aerial(
        strips=3, photos_per_strip=4, forward_overlap=0.6, side_overlap=0.6, points_per_photo=30
    )
    network = simulate(Spec(parts=(block,), control=Control(), seed=3)).network
    nine = [[f"{s}/{k + i}" for s in (1, 2, 3) for i in range(3)] for k in (1, 2)]
    along = [[f"{s}/{k + i}" for i in range(3)] for s in (1, 2, 3) for k in (1, 2)]
    across = [[f"{s}/{k}" for s in (1, 2, 3)] for k in (1, 2, 3, 4)]
    bundle = fga.adjust(network)
    check = [n for n, p in network.points.items() if p.check is not None and not any(p.fixed)]
    for units in (nine, [*along, *across]):
        models = as_models(network, units)
        assert [len(m.photos) for m in models.models] == [len(u) for u in units]
        found = fga.adjust(models.network)
        off = [
            (found.point(n) - bundle.point(n)) / bundle.standard_deviations(n)
            for n in check
            if n in found.network.points
        ]
        assert len(off) > 0.9 * len(check) > 50
        assert np.sqrt(np.mean(np.square(off))) < 1.0
