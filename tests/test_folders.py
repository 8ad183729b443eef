"""Tests lie where they are looked for, and share nothing but what holds no tests."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import TypeGuard

import pytest

from tests.support.places import ROOT
from tests.support.studies import cases, without_studies

TESTS = ROOT / "tests"
PACKAGE = ROOT / "factorgraph_adj"
SHARED = {"networks", "support", "loaders", "benchmarks"}
"""Folders of modules that hold no tests."""
OTHERS = {"badly_posed", "examples", "field_mistakes", "hostile", "published"}
"""Folders of tests that belong to no room of the package."""
WHOLE = {
    "test_structure",
    "test_folders",
    "test_readme",
    "test_examples",
    "test_docs",
    "test_extension",
    "test_glossary",
}
"""Tests of the whole repository, which lie beside the folders, as do tests of modules that lie
beside the rooms of the package."""
MODULES = {str(p.relative_to(TESTS)): p for p in sorted(TESTS.rglob("*.py"))}


def statements(text: str) -> Iterator[ast.AST]:
    """Yield the statements of a module, inner ones too, without what stands in expressions."""
    todo: list[ast.AST] = [ast.parse(text)]
    while todo:
        yield (node := todo.pop())
        todo.extend(n for n in ast.iter_child_nodes(node) if not isinstance(n, ast.expr))


def imported(text: str, path: Path) -> set[str]:
    """Return the full names of the test modules that the text of a module imports."""
    here = path.relative_to(ROOT).parent.parts
    found = set()
    for node in statements(text):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = here[: len(here) - node.level + 1] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            found |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    inside = (name.split(".") for name in found)
    return {".".join(n) for n in inside if n[0] == "tests" and n[-1].startswith("test_")}


def test_no_module_imports_a_test_module():
    where = ", ".join(f"tests/{folder}" for folder in sorted(SHARED))
    for name, path in MODULES.items():
        found = imported(path.read_text(encoding="utf-8"), path)
        assert not found, f"{name}: what tests share lies in {where}"


def test_imports_of_every_form_are_seen():
    text = (
        "import tests.solve.test_a\nfrom tests.solve.test_b import x\n"
        "from tests.solve import test_c\nfrom .test_d import x\nfrom . import test_e\n"
        "from ..io.test_f import x\nimport numpy\n"
    )
    assert imported(text, TESTS / "solve" / "test_solution.py") == {
        *("tests.solve.test_a", "tests.solve.test_b", "tests.solve.test_c"),
        *("tests.solve.test_d", "tests.solve.test_e", "tests.io.test_f"),
    }


def test_every_room_of_the_package_has_its_folder_of_tests():
    rooms = {p.parent.name for p in PACKAGE.glob("*/__init__.py")}
    folders = {p.parent.name for p in TESTS.glob("*/__init__.py")}
    assert folders == rooms | SHARED | OTHERS
    empty = [f for f in rooms | OTHERS if not any((TESTS / f).glob("test_*.py"))]
    assert not empty


def test_only_tests_of_the_whole_repository_lie_beside_the_folders():
    found = {p.stem for p in TESTS.glob("test_*.py")}
    beside = {f"test_{p.stem}" for p in PACKAGE.glob("*.py")}
    assert found <= WHOLE | beside, "tests of a room of the package lie in the folder of its name"
    assert len(found) > 3


def test_every_long_test_says_what_it_proves_beyond_the_short_ones():
    wrong = []
    for name, path in MODULES.items():
        text = path.read_text(encoding="utf-8")
        nodes = list(ast.walk(ast.parse(text))) if "mark.slow" in text else []
        said = {id(n.func): n.args for n in nodes if isinstance(n, ast.Call)}
        for node in filter(is_mark, nodes):
            (proves,) = said.get(id(node), (None,))
            if not isinstance(proves, ast.Constant) or len(str(proves.value)) <= 40:
                wrong.append(f"{name}, line {node.lineno}: says little or nothing")
    assert not wrong


def is_mark(node: ast.AST) -> TypeGuard[ast.Attribute]:
    """Whether a node is ``pytest.mark.slow``."""
    named = isinstance(node, ast.Attribute) and node.attr == "slow"  # most have another name
    return named and ast.unparse(node) == "pytest.mark.slow"


def is_slow(node: ast.AST) -> bool:
    """Whether a decorator, or the value of a name, marks tests as slow."""
    return any(map(is_mark, ast.walk(node)))


def has_short_tests(text: str) -> bool:
    """Whether a module has a test that ``-m "not slow"`` takes."""
    tree = ast.parse(text)
    assigned = {ast.unparse(n.targets[0]): n.value for n in tree.body if isinstance(n, ast.Assign)}
    if "pytestmark" in assigned and is_slow(assigned["pytestmark"]):
        return False
    slow = {n for n, v in assigned.items() if ast.unparse(v).startswith("pytest.mark.slow(")}
    return any(
        isinstance(n, ast.FunctionDef)
        and n.name.startswith("test_")
        and not any(
            ast.unparse(d) in slow or ast.unparse(d).startswith("pytest.mark.slow(")
            for d in n.decorator_list
        )
        for n in statements(text)
    )


def test_every_folder_has_short_tests():
    for folder in {name.rpartition("/")[0] for name in MODULES if "/test_" in name}:
        files = (TESTS / folder).glob("test_*.py")
        assert any(has_short_tests(p.read_text(encoding="utf-8")) for p in files), folder


@pytest.mark.parametrize(
    ("text", "short"),
    [
        ("def test_a(): pass", True),
        ("pytestmark = pytest.mark.slow('x')\ndef test_a(): pass", False),
        ("@pytest.mark.slow('x')\ndef test_a(): pass", False),
        ("LONG = pytest.mark.slow('x')\n@LONG\ndef test_a(): pass", False),
        ("@pytest.mark.slow('x')\ndef test_a(): pass\ndef test_b(): pass", True),
        ("def helper(): pass", False),
    ],
)
def test_short_tests_are_told_from_long_ones(text, short):
    assert has_short_tests(text) is short


def test_only_cases_among_tested_ones_are_a_study():
    """So that no test has nothing but studies."""
    wrong = [n for n, p in MODULES.items() if "mark.study" in p.read_text(encoding="utf-8")]
    assert wrong == ["test_folders.py"], "tests.support.studies.cases marks them"
    kept = cases([1, pytest.param(2, marks=pytest.mark.published), (3, 4)], [1, (3, 4)])
    assert kept[0] == 1 and kept[2] == (3, 4)
    assert kept[1].values == (2,)
    assert [m.name for m in kept[1].marks] == ["published", "study"]
    for some in ([], [5]):
        with pytest.raises(AssertionError):
            cases([1, 2], some)


class Item:
    """A test that was collected."""

    def __init__(self, name: str, engine: str, *markers: str) -> None:
        self.path, self.originalname, self.markers = Path("test_a.py"), name, markers
        self.callspec = SimpleNamespace(params={"engine": engine})

    def get_closest_marker(self, name: str) -> str | None:
        return name if name in self.markers else None


@pytest.mark.parametrize(
    ("markers", "left_out"),
    [
        ((), []),
        (("slow",), ["b isam2", "a fronts"]),
        (("slow", "one_engine"), ["a fronts", "b fronts"]),
        (("study",), ["a isam2", "b isam2", "a fronts", "b fronts"]),
    ],
)
def test_long_tests_take_the_engines_in_turn(markers, left_out):
    every = [Item(name, engine, *markers) for engine in ("isam2", "fronts") for name in "ab"]
    kept, left = without_studies(every)
    assert [f"{i.originalname} {i.callspec.params['engine']}" for i in left] == left_out
    assert len(kept) + len(left) == len(every)


def test_tests_against_published_figures_are_marked():
    files = sorted((TESTS / "published").glob("test_*.py"))
    assert files
    for path in files:
        assert "pytest.mark.published" in path.read_text(encoding="utf-8"), path.name


def test_modules_that_are_shared_hold_no_tests():
    for name, path in MODULES.items():
        if name.split("/")[0] in SHARED:
            inner = statements(path.read_text(encoding="utf-8"))
            functions = [n.name for n in inner if isinstance(n, ast.FunctionDef)]
            assert not path.name.startswith("test_"), name
            assert not [f for f in functions if f.startswith("test_")], name
