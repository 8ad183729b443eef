"""README, CONTRIBUTING and the documentation: every block of code runs and prints what is shown.

The blocks of a page run in order, in one namespace and one folder of their own, in which
``examples`` is that of the repository:

- ``python`` is executed; where a ``text`` block follows, at most a few words later, it prints that;
- ``console`` has commands after ``$ ``, each followed by what it prints;
- a block with a caption is a file of that name;
- ``toml``, ``csv`` and ``json`` are parsed.

``…`` in an output stands for anything.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import importlib
import inspect
import io
import json
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import takewhile, zip_longest
from pathlib import Path
from typing import Any

import pytest

import factorgraph_adj
from docs._ext.kinds import with_kinds
from factorgraph_adj.cli.command_line import command_parser, main
from factorgraph_adj.export.formats import EXPORT_FORMATS
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.io.writers import WRITERS
from factorgraph_adj.models.lens_registry import LENSES
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import KINDS
from factorgraph_adj.report import plots
from tests.support.places import ROOT

PAGES = {
    str(p.relative_to(ROOT)): p
    for p in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *sorted(
            p
            for p in (ROOT / "docs").rglob("*.md")
            if not {"_build", "gallery"} & set(p.relative_to(ROOT).parts)
        ),
    )
}
LANGUAGES = {"python", "text", "console", "toml", "csv", "json", "sh"}
DIRECTIVES = {"toctree", "eval-rst", "include", "math", "note", "image", "figure"}
LONG_PAGES = {
    f"docs/how_to/{page}.md"
    for page in (
        *("parts", "images_alone", "plots", "independent_models", "heights_in_the_air", "designs"),
        *("experiments", "own_factor", "radial_triangulation", "report", "additional_parameters"),
    )
}
LONG = pytest.mark.slow(
    "pages whose blocks adjust large networks or repeat adjustments; what they call has short "
    "tests of its own"
)
SHORT = 80
"""Characters that may stand between a script and its output."""


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    language: str
    body: str
    line: int
    caption: str | None
    between: str
    """Text since the block before."""


@dataclass
class Shell:
    """What the commands of a page run in."""

    folder: Path
    namespace: dict[str, object] = field(default_factory=lambda: {"__name__": "__main__"})
    code: int = 0

    def run(self, command: str) -> str:
        """Run a command of a ``console`` block; return what it prints."""
        program, *arguments = shlex.split(command)
        if program == "echo":
            assert arguments == ["$?"], command
            return str(self.code)
        if program == "cat":
            return "".join((self.folder / a).read_text(encoding="utf-8") for a in arguments)
        if program == "ls":
            return "\n".join(sorted(p.name for p in (self.folder / arguments[0]).iterdir()))
        assert program == "factorgraph-adj", f"unknown command: {command}"
        source = ""
        if "<" in arguments:
            *arguments, _, name = arguments
            source = (self.folder / name).read_text(encoding="utf-8")
        with printed(source) as out:
            try:
                self.code = main(arguments)
            except SystemExit as ended:
                self.code = int(ended.code or 0)
        return out[0]

    def execute(self, block: Block, page: str) -> str:
        """Execute a script of the page; return what it prints."""
        # Empty lines first, so that a traceback names the line of the page.
        code = compile("\n" * block.line + block.body, page, "exec", dont_inherit=True)
        with printed() as out:
            exec(code, self.namespace)
        return out[0]


@contextlib.contextmanager
def printed(source: str = "") -> Iterator[list[str]]:
    """Catch both streams as a terminal shows them; the list has their text afterwards."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
    given, sys.stdin = sys.stdin, io.TextIOWrapper(io.BytesIO(source.encode()), encoding="utf-8")
    out: list[str] = []
    try:
        with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
            yield out
    finally:
        sys.stdin = given
        out.append(stream.buffer.getvalue().decode("utf-8"))


def blocks_of(text: str) -> list[Block]:
    """Return the fenced blocks of a page."""
    found: list[Block] = []
    between: list[str] = []
    lines = iter(enumerate(text.splitlines(), start=1))
    for number, line in lines:
        opening = re.match(r"^(```+)(?:\{([\w-]+)\} ?)?([\w/.-]*)\s*$", line)
        if not opening:
            between.append(line)
            continue
        fence, directive, language = opening.groups()
        body = [
            inner for _, inner in takewhile(lambda entry, end=fence: entry[1].strip() != end, lines)
        ]
        options = {}
        while directive and body and (option := re.match(r"^:([\w-]+): ?(.*)$", body[0])):
            options[option.group(1)] = option.group(2)
            body.pop(0)
        what = language if directive in (None, "code-block") else directive
        text_between = "\n".join(between)
        found.append(
            Block(what, "\n".join(body) + "\n", number, options.get("caption"), text_between)
        )
        between = []
    return found


def pattern(expected: str) -> re.Pattern[str]:
    """Return what an output must match: its words, with anything for ``…``."""
    words = expected.split()
    text = ""
    for before, word in zip(["…", *words], words, strict=False):
        text += "" if "…" in (before, word) else r"\s+"
        text += re.escape(word).replace("…", ".*?")
    return re.compile(text, re.DOTALL)


def commands_of(block: Block) -> list[tuple[str, str]]:
    """Return the commands of a ``console`` block and what each prints."""
    parts = re.split(r"^\$ (.*)$", block.body, flags=re.MULTILINE)
    assert not parts[0].strip(), f"line {block.line}: output before a command"
    return list(zip(parts[1::2], parts[2::2], strict=True))


def same(shown: str, found: str, where: str) -> None:
    assert pattern(shown).fullmatch(found.strip()), f"{where} prints\n{found}\nnot\n{shown}"


@pytest.fixture
def registries() -> Iterator[None]:
    """Forget the kinds that a page registers."""
    tables: tuple[dict[str, Any], ...] = (KINDS, UNKNOWNS, LENSES)
    before = [dict(t) for t in tables]
    yield
    for table, kinds in zip(tables, before, strict=True):
        table.clear()
        table.update(kinds)


def test_long_pages_are_pages() -> None:
    assert PAGES.keys() >= LONG_PAGES


@pytest.mark.usefixtures("registries")
@pytest.mark.parametrize(
    "page", [pytest.param(p, marks=LONG if p in LONG_PAGES else ()) for p in PAGES]
)
def test_every_block_of_a_page_runs_and_prints_what_is_shown(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    shell = Shell(tmp_path)
    blocks = blocks_of(PAGES[page].read_text(encoding="utf-8"))
    for block, after in zip_longest(blocks, blocks[1:]):
        where = f"{page}:{block.line}"
        assert block.language in LANGUAGES | DIRECTIVES, f"{where}: {block.language!r}"
        if block.language == "toml":
            tomllib.loads(block.body)
        elif block.language == "json":
            [json.loads(line) for line in block.body.splitlines()]
        elif block.language == "csv":
            rows = list(csv.reader(block.body.splitlines()))
            assert {len(r) for r in rows} == {len(rows[0])}, where
        if block.caption is not None:
            file = tmp_path / block.caption
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(block.body, encoding="utf-8")
        elif block.language == "console":
            for command, shown in commands_of(block):
                same(shown, shell.run(command), f"{where}: {command}")
        elif block.language == "python":
            found = shell.execute(block, page)
            prints = after is not None and after.language == "text" and not after.caption
            if prints and len(after.between) < SHORT and "#" not in after.between:
                same(after.body, found, where)


def test_the_parser_finds_the_scripts_their_outputs_and_the_commands() -> None:
    blocks = [b for p in PAGES.values() for b in blocks_of(p.read_text(encoding="utf-8"))]
    kinds = [b.language for b in blocks]
    assert kinds.count("python") > 20
    assert kinds.count("console") > 5
    assert sum(b.caption is not None for b in blocks) > 5
    # Every fence of every page is seen.
    fences = sum(
        len(re.findall(r"^```", p.read_text(encoding="utf-8"), re.MULTILINE))
        for p in PAGES.values()
    )
    assert fences == 2 * len(blocks)


def test_an_output_that_differs_is_noticed() -> None:
    same("a … d", "a b\nc d", "here")
    same("… d", "c d", "here")
    with pytest.raises(AssertionError, match="prints"):
        same("a b d", "a b c", "here")
    with pytest.raises(AssertionError, match="prints"):
        same("a b", "a b c", "here")
    same('{"a": 1.5…, …}', '{"a": 1.52, "b": 3}', "here")
    with pytest.raises(AssertionError, match="prints"):
        same("1.5 …", "1x5 b", "here")


@pytest.mark.parametrize("page", PAGES)
def test_every_relative_link_of_a_page_leads_somewhere(page: str) -> None:
    text = re.sub(r"^```.*?^```", "", PAGES[page].read_text(encoding="utf-8"), flags=re.S | re.M)
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    for target in targets:
        path, _, _ = target.partition("#")
        if not path or re.match(r"[a-z]+:", target) or "gallery/" in path:
            continue
        assert (PAGES[page].parent / path).exists(), f"{page}: {target}"


def test_every_test_that_a_page_names_is_there() -> None:
    test = re.compile(r"\b((?:[a-z_]+/)+test_[a-z0-9_]+)(?:\.py)?(?:::(test_\w+))?")
    texts = [p.read_text(encoding="utf-8") for p in PAGES.values()]
    named = {m.groups() for text in texts for m in test.finditer(text)}
    assert len(named) > 20
    for module, function in named:
        if (ROOT / "factorgraph_adj" / f"{module}.py").exists():
            continue  # a module of the package about test statistics
        text = (ROOT / "tests" / f"{module.removeprefix('tests/')}.py").read_text(encoding="utf-8")
        assert function is None or f"def {function}(" in text, (module, function)


@pytest.mark.parametrize("module", [factorgraph_adj, factorgraph_adj.observations, plots])
def test_every_public_name_is_in_the_reference(module: Any) -> None:
    folder = ROOT / "docs" / "reference" / "api"
    pages = [p.read_text(encoding="utf-8") for p in sorted(folder.glob("*.md"))]
    text = "\n".join(with_kinds(page) for page in pages)
    documented = [
        getattr(importlib.import_module(home), name, None)
        for home, name in re.findall(r"^\.\. auto\w+:: (\S+)\.(\w+)$", text, re.MULTILINE)
    ]
    described = (inspect.isclass, inspect.isfunction)
    names = [n for n in module.__all__ if any(is_(getattr(module, n)) for is_ in described)]
    assert len(names) > 8
    assert not [n for n in names if getattr(module, n) not in documented]
    if module is factorgraph_adj:
        index = (folder / "index.md").read_text(encoding="utf-8")
        assert not [n for n in names if f".{n}`" not in index]


def test_every_kind_and_every_table_of_unknowns_has_a_row() -> None:
    """Rows of the file format that nobody wrote follow from the records of the kinds."""
    columns, equations = (
        with_kinds(PAGES[f"docs/reference/{page}.md"].read_text(encoding="utf-8"))
        for page in ("file_format", "observation_equations")
    )
    for name in set(KINDS) - {"image"}:  # image points have a table and equations of their own
        assert re.search(rf"^\|[^|]*`{name}`", columns, re.MULTILINE), name
        assert f"`{name}`" in equations, name
    for kind in UNKNOWNS.values():
        if kind.table is not None:
            assert columns.count(f"| `{kind.table.file}.csv` |") == 1, kind.name


def test_a_row_that_nobody_wrote_follows_from_the_record() -> None:
    page = PAGES["docs/reference/file_format.md"].read_text(encoding="utf-8")
    less = re.sub(r"^\| `(gyro_azimuth|gyros\.csv)` \|.*\n", "", page, flags=re.MULTILINE)
    rows = set(with_kinds(less).splitlines()) - set(page.splitlines())
    assert rows >= {
        "| `gyro_azimuth` | `station` `target` | `value` "
        "| `instrument_height` `target_height` `gyro` |",
        "| `gyros.csv` | `name` `value` with a unit, σ of each, `fixed`: gyrotheodolite |",
    }


def test_every_name_of_the_reference_is_there() -> None:
    for page in sorted((ROOT / "docs" / "reference").rglob("*.md")):
        text = with_kinds(page.read_text(encoding="utf-8"))
        for what, name in re.findall(r"^\.\. auto(\w+):: (\S+)$", text, re.MULTILINE):
            module, _, attribute = name.rpartition(".")
            if what == "module":
                importlib.import_module(name)
            else:
                assert hasattr(importlib.import_module(module), attribute), f"{page}: {name}"


NAMED_BY_CONTENT = {"openmvg", "micmac"}
"""Formats whose row states names of files instead of suffixes."""


def commands() -> dict[str, argparse.ArgumentParser]:
    """Return the commands with their parsers."""
    subparsers = [a for a in command_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    (found,) = subparsers
    return {name: command.filled() for name, command in found.choices.items()}


def test_every_option_of_every_command_is_in_the_reference() -> None:
    """In the line of its command, or in the tables of READ and HOW; and none that is not there."""
    text = PAGES["docs/reference/command.md"].read_text(encoding="utf-8")
    synopsis = text.partition("```text\n")[2].partition("```")[0]
    tables = text.partition("## How to read")[2].partition("## Files")[0]
    shown = {*re.findall(r"--[a-z][a-z-]*", tables)}
    assert len(commands()) > 8
    for name, command in commands().items():
        usage = "".join(
            u
            for u in re.split(r"(?=^factorgraph-adj )", synopsis, flags=re.M)
            if u.startswith((f"factorgraph-adj {name} ", f"factorgraph-adj {name}\n"))
        )
        assert usage, name
        valid = set(command._option_string_actions)
        said = {*re.findall(r"--[a-z][a-z-]*", usage)}
        options = {o for o in valid if o.startswith("--")} - {"--help"}
        assert not options - said - shown, (name, options - said - shown)
        assert not said - valid, (name, said - valid)
    rows = re.findall(r"^\| (`--[^|]*?) \|", tables, flags=re.M)
    assert len(rows) == len(set(rows)), "an option has two rows"


@pytest.mark.parametrize(
    ("title", "entries"),
    [("Read", READERS.entries), ("Written", WRITERS.entries), ("Results", EXPORT_FORMATS)],
)
def test_every_format_has_its_row(title: str, entries: Any) -> None:
    """The page of formats has one row for each, with its suffixes, and no other rows."""
    text = PAGES["docs/reference/formats.md"].read_text(encoding="utf-8")
    part = text.partition(f"\n## {title}\n")[2].partition("\n## ")[0].partition("\n### ")[0]
    rows = [r.strip("|").split("|") for r in re.findall(r"^\| `.*$", part, flags=re.M)]
    words, names = (sorted(r[0].strip(" `") for r in rows), sorted(e.name for e in entries))
    what = f"the table {title!r} of docs/reference/formats.md needs one row for each, by its name"
    assert words == names, f"{what}: {sorted(set(words) ^ set(names))}"
    for row in rows:
        (entry,) = (e for e in entries if e.name == row[0].strip(" `"))
        lacking = [s for s in entry.suffixes if not re.search(rf"{re.escape(s)}`", row[2])]
        assert not lacking or entry.name in NAMED_BY_CONTENT, (
            f"the third column of {entry.name} in formats.md lacks these suffixes: {lacking}"
        )
        assert all(cell.strip() for cell in row), f"{entry.name} in formats.md has an empty cell"


def test_what_people_come_from_has_a_page() -> None:
    """COLMAP, Metashape, STAR*NET, Gama, JAG3D, Comp3D, a total station; one page each at least."""
    index = PAGES["docs/how_to/index.md"].read_text(encoding="utf-8")
    coming = index.partition(":caption: Coming from another program")[2].partition("```")[0]
    pages = coming.split()
    wanted = "colmap metashape star_net gama jag3d comp3d total_station"
    assert not set(wanted.split()) - set(pages)
    for page in pages:
        blocks = blocks_of(PAGES[f"docs/how_to/{page}.md"].read_text(encoding="utf-8"))
        assert [b for b in blocks if b.language in ("python", "console")], page


def test_the_version_is_that_of_the_installed_package() -> None:
    assert factorgraph_adj.__version__ == version("factorgraph_adj")


def test_the_citation_states_the_version_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {project['version']}\n" in citation


def broken_tables(text: str) -> list[str]:
    """Return what is wrong with the tables of a page: no header, another number of cells, text."""
    out, table, fenced = [], list[tuple[int, str]](), False
    for number, line in enumerate([*text.splitlines(), ""], start=1):
        fenced ^= line.lstrip().startswith(("```", "~~~"))
        if not fenced and line.startswith("|"):
            table.append((number, line))
            continue
        if table:
            if line:
                out.append(f"{number}: text stands directly below a table")
            cells = [len(re.findall(r"(?<!\\)\|", row)) for _, row in table]
            if len(table) < 2 or not re.fullmatch(r"\|( *:?-+:? *\|)+", table[1][1].strip()):
                out.append(f"{table[0][0]}: the table has no header")
            wrong = (n for (n, _), c in zip(table, cells, strict=True) if c != cells[0])
            out += [f"{n}: the row has another number of cells than the header" for n in wrong]
        table = []
    return out


def test_no_table_of_a_page_is_broken() -> None:
    broken = {
        name: broken_tables(with_kinds(p.read_text(encoding="utf-8"))) for name, p in PAGES.items()
    }
    assert not {name: found for name, found in broken.items() if found}


@pytest.mark.parametrize(
    ("broken", "what"),
    [
        (
            "| a | b |\n| - | - |\n| 1 | 2 |\n\nA sentence.\n| 3 | 4 |\n",
            "6: the table has no header",
        ),
        ("| a | b |\n| - | - |\n| 1 | 2 |\nA sentence.\n", "4: text stands directly below a table"),
        ("| a | b |\n| - | - |\n| 1 | 2 | 3 |\n", "3: the row has another number of cells"),
    ],
)
def test_a_broken_table_is_found(broken: str, what: str) -> None:
    (found,) = broken_tables(broken)
    assert found.startswith(what)
