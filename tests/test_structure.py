"""The package keeps its order: imports point one way, and only to what is declared."""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib
import statistics
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import factorgraph_adj as package
from factorgraph_adj.observations import KINDS
from tests.support.places import ROOT

PACKAGE = "factorgraph_adj"
SOURCE = ROOT / PACKAGE

LAYERS: tuple[tuple[str, ...], ...] = (
    ("errors", "types", "version", "result_display"),
    (
        "units",
        "rotation",
        "ellipsoid",
        "blas_threads",
        "columns",
        "files",
        "control_characters",
        "garbage_collection",
        "statistical_tests",
    ),
    ("constructors",),
    ("frames", "stochastic_model", "atmosphere"),
    # Grid coordinates and heights of reference systems, and geoids.
    ("crs",),
    ("models",),
    ("entities",),
    ("observations",),
    ("network",),
    # The equations in arrays; the same as factors of GTSAM.
    ("graph",),
    # Approximate values, and poses and points from image points alone.
    ("start",),
    # The minimum of vᵀPv from start values.
    ("solve",),
    # Poses and points from image points alone; the start of every adjustment.
    ("orientation",),
    ("adjustment",),
    ("quality",),
    ("accuracy",),
    # Signals with a covariance function: filtered and predicted.
    ("collocation",),
    # The whole as a factor graph for GTSAM's optimisers, and in its iSAM2.
    ("factor_graph",),
    ("validate",),
    ("triangulation",),
    # Two epochs: what moved.
    ("epochs",),
    ("io",),
    ("parts",),
    # What has arrived; where everything is; what happens when more arrives.
    ("ledger",),
    ("linear_system",),
    ("incremental",),
    ("report",),
    # Results in formats of other programs.
    ("export",),
    ("simulation",),
    ("experiment",),
    ("planning",),
    # Epoch after epoch of one object: motions, alarms.
    ("monitoring",),
    # Lines of instruments become records of the stream protocol.
    ("instruments",),
    # What the stream says is in the units and names of reports.
    ("service",),
    # Networks that live: a database, an API, a page.
    ("site",),
    ("cli",),
    ("__main__",),
)
"""From the bottom up; the longest entry that a module's name starts with is its place. Modules
of one entry may import one another, those of two entries of a line may not."""

DECLARED = {"gtsam", "numpy", "scipy", "threadpoolctl"}
EXTRAS = {
    "rich": ("cli",),
    "shtab": ("cli",),
    "matplotlib": ("report",),
    "distributed": ("experiment", "parts"),
    "pandas": ("experiment", "columns", "solve", "export"),
    "polars": ("experiment", "columns"),
    "xarray": ("export",),
    "poselib": ("orientation",),
    "yaml": ("io",),
    "openpyxl": ("io",),
    "pyproj": ("crs",),
    "ezdxf": ("export",),
    "laspy": ("export",),
    "jinja2": ("report",),
    "plotly": ("report", "site"),
    "itables": ("report",),
    "serial": ("instruments",),
    "sqlalchemy": ("site",),
    "alembic": ("site",),
    "fastapi": ("site",),
    "starlette": ("site",),
    "httpx2": ("site",),
    "uvicorn": ("cli",),
    "paho": ("instruments",),
    "rosbags": ("instruments",),
}
"""Optional; imported when they are needed, and where."""
OF_EXTRAS = (
    *("site.tables", "site.migrations", "site.api", "site.dependencies"),
    *("site.site_routes", "site.network_routes", "site.epoch_routes"),
)
"""Modules that only an extra uses; no module outside their room imports them before it runs."""

MOST_LINES, MEDIAN_LINES = 500, 350
"""Bounds of the number of lines of a module: of every one, and of half of them."""


@dataclass(frozen=True)
class Import:
    """One imported module, where it stands and whether only type checkers see it."""

    module: str
    line: int
    in_function: bool
    for_types: bool


def _name(path: Path) -> str:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {_name(path): path for path in sorted(SOURCE.rglob("*.py"))}
SUBPACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}


def _walk(
    node: ast.AST, in_function: bool = False, for_types: bool = False
) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool, bool]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            continue  # nothing is imported in an expression
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, in_function, for_types
        elif isinstance(child, ast.If) and ast.unparse(child.test).lstrip("_") == "TYPE_CHECKING":
            for inner in child.body:
                yield from _walk(ast.Module([inner], []), in_function, True)
            yield from _walk(ast.Module(child.orelse, []), in_function, for_types)
        else:
            function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            yield from _walk(child, in_function or function, for_types)


@functools.cache
def _imports(name: str) -> tuple[Import, ...]:
    """Return what a module imports, with full names."""
    found = []
    for node, *where in _walk(ast.parse(MODULES[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [Import(alias.name, node.lineno, *where) for alias in node.names]
            continue
        base = node.module or ""
        if node.level:
            here = [PACKAGE, *(name.split(".") if name else [])]
            if name not in SUBPACKAGES:
                here.pop()
            here = here[: len(here) - (node.level - 1)]
            base = ".".join([*here, base] if base else here)
        for alias in node.names:
            # `from ..models import position` imports a module, other names are of their module.
            inner = f"{base}.{alias.name}".removeprefix(f"{PACKAGE}.")
            full = f"{PACKAGE}.{inner}" if base.startswith(PACKAGE) and inner in MODULES else base
            found.append(Import(full, node.lineno, *where))
    return tuple(found)


def _inside(imported: Import) -> str | None:
    """Return the name of a module of the package, none for others."""
    if imported.module == PACKAGE:
        return ""
    if imported.module.startswith(f"{PACKAGE}."):
        return imported.module.removeprefix(f"{PACKAGE}.")
    return None


@functools.cache
def _place(module: str) -> tuple[int, str]:
    """Return the layer of a module and the entry that puts it there."""
    fitting = [
        (len(entry), number, entry)
        for number, entries in enumerate(LAYERS)
        for entry in entries
        if module == entry or module.startswith(f"{entry}.")
    ]
    assert fitting, f"{module} has no place in LAYERS"
    _, number, entry = max(fitting)
    return number, entry


def test_imports_point_one_way():
    wrong = []
    for name in MODULES:
        if not name:
            continue
        layer, entry = _place(name)
        for imported in _imports(name):
            inner = _inside(imported)
            if inner is None or imported.for_types:
                continue
            where = f"{name}, line {imported.line} imports"
            assert inner in MODULES, f"{where} {imported.module}"
            other, other_entry = _place(inner) if inner else (len(LAYERS), "")
            if other > layer or (other == layer and entry != other_entry):
                wrong.append(f"{where} {inner or PACKAGE}")
    assert not wrong


def test_no_modules_import_one_another_in_a_circle():
    """Imports that only type checkers see count too: a reader follows them like any other."""
    graph = {
        name: {inner for i in _imports(name) if (inner := _inside(i)) is not None}
        for name in MODULES
    }
    assert len(list(graphlib.TopologicalSorter(graph).static_order())) == len(MODULES)


def test_modules_are_short():
    lines = {
        name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in MODULES.items()
    }
    assert not [name for name, n in lines.items() if n > MOST_LINES]
    assert statistics.median(lines.values()) < MEDIAN_LINES


def test_every_entry_of_the_layers_is_a_module():
    assert {entry for entries in LAYERS for entry in entries} <= set(MODULES)


def test_a_module_imports_only_what_is_declared():
    wrong = []
    for name in MODULES:
        for imported in _imports(name):
            top = imported.module.split(".")[0]
            if top in EXTRAS:
                late = imported.in_function or imported.for_types or name.startswith(OF_EXTRAS)
                allowed = late and name.split(".")[0] in EXTRAS[top]
            else:
                allowed = top == PACKAGE or top in DECLARED or top in sys.stdlib_module_names
            if not allowed:
                wrong.append(f"{name}, line {imported.line}: {top}")
    assert not wrong


def test_only_rooms_of_the_graph_and_its_solution_know_gtsam():
    users = {n for n in MODULES for i in _imports(n) if i.module.split(".")[0] == "gtsam"}
    assert users
    assert {name.split(".")[0] for name in users} <= {
        "graph",
        "solve",
        "factor_graph",
        "linear_system",
        "incremental",
    }


def test_only_one_module_makes_custom_factors():
    text = {name: path.read_text(encoding="utf-8") for name, path in MODULES.items()}
    assert [name for name in MODULES if "CustomFactor" in text[name]] == ["graph.factors"]


ALONE = """
import importlib, sys
for name in sys.argv[2:]:
    importlib.import_module(name)
package = importlib.import_module(sys.argv[1])
for public in getattr(package, "__all__", ()):
    getattr(package, public)
"""


def test_every_module_can_be_imported_and_every_public_name_resolves():
    """From the top down; without circles, what can be imported at all can be imported alone."""
    names = [f"{PACKAGE}.{name}" if name else PACKAGE for name in reversed(MODULES)]
    ran = subprocess.run(
        [sys.executable, "-c", ALONE, PACKAGE, *names],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert ran.returncode == 0, ran.stderr


# -- public names ---------------------------------------------------------------------------------

LATE = ("scipy.stats", "scipy.optimize", "scipy.interpolate", *EXTRAS)
"""What takes long to import, and only some computations need."""

LOADED = """
import sys
import factorgraph_adj as package
late = sys.argv[1:]
assert not {"numpy", "scipy", "gtsam", *late} & set(sys.modules), "by the package alone"
for name in package.__all__:
    getattr(package, name)
assert not set(late) & set(sys.modules), sorted(set(late) & set(sys.modules))
assert {"numpy", "scipy", "gtsam"} <= set(sys.modules)
"""


def test_the_package_loads_what_is_asked_for_and_nothing_that_takes_long():
    ran = subprocess.run(
        [sys.executable, "-c", LOADED, *LATE],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert ran.returncode == 0, ran.stderr


def test_public_names_are_the_same_for_programs_and_for_type_checkers():
    homes = {}
    for node, _, for_types in _walk(ast.parse(MODULES[""].read_text(encoding="utf-8"))):
        if for_types:
            homes |= {alias.name: node.module for alias in node.names}
    assert homes == package._MODULES
    assert sorted(homes) == sorted(package.__all__)
    for name, home in homes.items():
        assert name in dir(package)
        found = getattr(package, name)
        assert found is getattr(importlib.import_module(f"{PACKAGE}.{home}"), name)
        if hasattr(found, "__module__"):  # texts and numbers know no module
            assert found.__module__ == f"{PACKAGE}.{home}", f"{name} is defined in another module"


def test_public_names_hide_no_module():
    """An imported module becomes an attribute of the package, in the place of such a name."""
    assert not set(package.__all__) & {name.split(".")[0] for name in MODULES}


def test_modules_of_the_package_are_its_attributes_and_other_names_are_unknown():
    assert package.observations is sys.modules[f"{PACKAGE}.observations"]
    with pytest.raises(AttributeError, match="has no attribute 'adjusted'"):
        _ = package.adjusted
    with pytest.raises(ImportError):
        exec("from factorgraph_adj import adjusted")


# -- kinds of observations ------------------------------------------------------------------------

READERS = ("io",)
"""Rooms that translate kinds into words of other programs, and so have to name them."""
QUANTITIES = {"unit", "fixes", "in_frame", "quantity"}
"""Attributes of records whose values may be words that are names of kinds too."""
ASKED_FOR: dict[str, tuple[str, ...]] = {
    # An image table has rows of image points alone: what stores observations tells them apart.
    "ImagePoint": ("ledger", "linear_system", "network", "observations"),
    # The record says that there are axes; the class tells type checkers so. Collocation is of
    # known coordinates alone.
    "ControlPoint": ("graph", "collocation"),
}
"""Classes of kinds that some rooms may ask for."""


def _words(node: ast.expr) -> set[object]:
    """Return the constants of an expression, or of the collection that it is."""
    parts = node.elts if isinstance(node, ast.Tuple | ast.Set | ast.List) else [node]
    return {part.value for part in parts if isinstance(part, ast.Constant)}


def _last_name(node: ast.expr) -> str:
    """Return the name of a variable or attribute, also of one of its items."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _kinds_in_conditions(tree: ast.AST, kinds: set[str], classes: set[str]) -> Iterator[str]:
    """Iterate over comparisons with the name of a kind, and over tests for a class of one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            named = any(kinds & _words(side) for side in sides)
            if named and not QUANTITIES & {_last_name(side) for side in sides}:
                yield ast.unparse(node)
        elif isinstance(node, ast.Call) and _last_name(node.func) in ("isinstance", "issubclass"):
            yield from sorted(classes & {_last_name(n) for n in ast.walk(node.args[1])})
        elif isinstance(node, ast.Match) and _last_name(node.subject) not in QUANTITIES:
            for case in node.cases:
                values = [n.value for n in ast.walk(case) if isinstance(n, ast.MatchValue)]
                if any(kinds & _words(value) for value in values):
                    yield ast.unparse(node.subject)


def test_no_condition_names_a_kind_of_observation():
    """What differs between kinds is an attribute of their records: a new kind has it too."""
    kinds = set(KINDS)
    classes = {record.observation.__name__ for record in KINDS.values()}
    wrong = []
    for name, path in MODULES.items():
        room = name.split(".")[0]
        if room in READERS:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        wrong += [
            f"{name}: {found}"
            for found in _kinds_in_conditions(tree, kinds, classes)
            if room not in ASKED_FOR.get(found, ())
        ]
    assert not wrong


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("if block.kind == 'direction': pass", ["block.kind == 'direction'"]),
        ("if o.kind in ('azimuth', 'image'): pass", ["o.kind in ('azimuth', 'image')"]),
        ("if isinstance(o, Direction | Azimuth): pass", ["Azimuth", "Direction"]),
        ("match o.kind:\n    case 'image': pass", ["o.kind"]),
        ("if block.quantity == 'direction': pass", []),
    ],
)
def test_a_condition_that_names_a_kind_is_found(source, found):
    classes = {"Direction", "Azimuth"}
    tree = ast.parse(source)
    assert list(_kinds_in_conditions(tree, {"direction", "azimuth", "image"}, classes)) == found
