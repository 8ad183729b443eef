"""Names of modules are terms of the glossary, and the glossary names what there is."""

from __future__ import annotations

import ast
import builtins
import importlib
import keyword
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.support.places import ROOT

PACKAGE = ROOT / "factorgraph_adj"
GLOSSARY = ROOT / "docs" / "reference" / "glossary.md"
FORMATS = ROOT / "docs" / "reference" / "formats.md"


def words(text: str) -> list[str]:
    """Return the words of a term or a name in lower case."""
    return re.findall(r"[^\W_]+", text.lower())


PREPOSITIONS = frozenset(
    words("""
    aboard about above across after against along amid among around as at before behind below
    beneath beside besides between beyond by despite down during except for from in inside into
    like near of off on onto out outside over past per since through throughout till to toward
    towards under underneath until up upon via with within without
    """)
)
ADVERBS = frozenset(
    words("""
    again ago ahead alike almost alone already also altogether always anew anywhere apart aside
    away back backwards both downwards early elsewhere else enough ever everywhere far farther
    forth forwards further hence here how however indeed instead just late later least less maybe
    meanwhile more moreover most much never no not nowhere now often once only otherwise perhaps
    quite rather seldom so somehow sometimes somewhere soon still then there thereby therefore
    thus together too twice upwards very well when whenever where wherever why yes yet
    """)
)
PRONOUNS = frozenset(
    words("""
    all any anybody anyone anything both each either every everybody everyone everything few he
    her hers him his i it its itself many me mine my neither nobody none nothing one other others
    our ours same several she some somebody someone something such that theirs them themselves
    these they this those us we what whatever which whichever who whom whose you your yours
    """)
)
CONJUNCTIONS = frozenset(
    words("although and because but if lest nor or once than though unless whereas whether while")
)
CLOSED_CLASSES = PREPOSITIONS | ADVERBS | PRONOUNS | CONJUNCTIONS
"""Words of English that no noun is made of."""
JOINING = frozenset({"and", "of"})
"""Words that may stand between the nouns of one name."""
NOT_YET_NOUNS = frozenset({"incremental", "simulation/generate", "solve", "validate"})
"""Modules whose names are no nouns and are to be changed; no new one joins them."""


@dataclass(frozen=True)
class Entry:
    """One row of a table of terms."""

    term: str
    meaning: str
    modules: tuple[str, ...]


def rows(page: Path, header: str) -> Iterator[list[str]]:
    """Yield the cells of the rows of all tables of a page whose first column has this header."""
    inside = False
    for line in page.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|"):
            inside = False
        elif not inside:
            inside = cells[0] == header
        elif not set(cells[0]) <= set("-: "):
            yield cells


def singulars(word: str) -> set[str]:
    """Return a word and every word of which it may be the plural."""
    found = {word}
    for ending, singular in (("s", ""), ("es", ""), ("es", "is"), ("ies", "y"), ("ices", "ix")):
        if word.endswith(ending) and len(word) > len(ending) + 1:
            found.add(word.removesuffix(ending) + singular)
    return found


def head(name: str) -> str:
    """Return the noun of a term or a name: the last word before a preposition, without numbers."""
    found = words(name)
    after = [i for i, word in enumerate(found) if i and word in PREPOSITIONS]
    nouns = [word for word in found[: after[0] if after else None] if not word.isdigit()]
    return nouns[-1]


ENTRIES = [
    Entry(term, meaning, tuple(re.findall(r"`([^`]+)`", modules)))
    for term, _, meaning, modules in rows(GLOSSARY, "term")
]
MODULES = {
    path.relative_to(PACKAGE).with_suffix("").as_posix().removesuffix("/__init__")
    for path in PACKAGE.rglob("*.py")
    if "migrations" not in path.parts  # alembic states their names
} - {"__init__", "__main__"}
FORMAT_WORDS, SHORT_FORMS = (
    {name for cells in rows(page, "word") for name in re.findall(r"`([^`]+)`", cells[0])}
    for page in (FORMATS, GLOSSARY)
)
NAMES = {word for name in FORMAT_WORDS | SHORT_FORMS for word in words(name)}
"""Words of formats, and names and short forms that the glossary lists for modules."""
WORDS = {s for entry in ENTRIES for word in words(entry.term) for s in singulars(word)}
NOUNS = {s for entry in ENTRIES for s in singulars(head(entry.term))}


def test_glossary_lists_terms_formats_and_modules():
    assert len(ENTRIES) > 200 and len(MODULES) > 200
    assert {"redundancy", "suspect", "epoch"} <= WORDS
    assert {"gsi", "star", "net", "crs"} <= NAMES
    assert head("choice_of_start") == "choice" and head("tables_1981") == "tables"
    assert singulars("axes") & singulars("axis") and singulars("indices") & {"index", "indix"}
    unfinished = [e.term for e in ENTRIES if not (e.modules and e.meaning.endswith("."))]
    assert not unfinished, f"terms without a module or a sentence: {unfinished}"


def test_every_term_stands_once():
    counts = Counter(" ".join(min(singulars(w), key=len) for w in words(e.term)) for e in ENTRIES)
    assert not [term for term, count in counts.items() if count > 1]


def test_every_module_of_the_glossary_exists():
    unknown = {name: e.term for e in ENTRIES for name in e.modules if name not in MODULES}
    assert not unknown, f"modules of the glossary that are not in the package: {unknown}"


def test_every_module_stands_in_the_glossary():
    """The one module of a format has its row in formats.md: the word there is its name."""
    named = {name for entry in ENTRIES for name in entry.modules}
    formats = {name.replace("-", "_") for name in FORMAT_WORDS}
    missing = {
        module
        for module in MODULES - named
        if not (module.startswith("io/") and module.rpartition("/")[2] in formats)
    }
    assert not missing, f"give these modules a row in {GLOSSARY.name}: {sorted(missing)}"


def test_names_of_modules_consist_of_terms():
    known = WORDS | NAMES | JOINING
    missing = {
        module: lacking
        for module in sorted(MODULES - NOT_YET_NOUNS)
        if (lacking := [w for w in words(module.rpartition("/")[2]) if not singulars(w) & known])
    }
    assert not missing, f"words that no term of {GLOSSARY.name} has: {missing}"


def test_names_of_modules_are_nouns():
    """Terms are nouns, so that the noun of a name is the noun of a term, or a name itself."""
    found = set()
    for module in MODULES:
        name = module.rpartition("/")[2]
        all_words, noun = words(name), head(name)
        if all_words[-1] in CLOSED_CLASSES or not singulars(noun) & (NOUNS | NAMES):
            found.add(module)
    assert not found - NOT_YET_NOUNS, "a module's name is a noun of the glossary"
    assert not NOT_YET_NOUNS - found, "these are nouns by now: take them out of NOT_YET_NOUNS"
    assert not NOUNS & CLOSED_CLASSES, "the noun of a term is no preposition, adverb or pronoun"
    assert not [e.term for e in ENTRIES if head(e.term).endswith("ed")], "no participle is a noun"


BACKTICKED = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)`(?!`)")
"""A name in single backticks, as docstrings refer to what the package has."""


def names_of(tree: ast.AST) -> Iterator[str]:
    """Yield every name that a module defines, imports, uses or states as a string."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name
            case ast.ClassDef(name=name) | ast.alias(name=name):
                yield from name.split(".")
                yield getattr(node, "asname", None) or name
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                yield name
            case ast.keyword(arg=str(name)):
                yield name
            case ast.Constant(value=str(text)) if re.fullmatch(r"[\w.\-]+", text):
                yield from text.split(".")


@cache
def sources() -> dict[str, ast.Module]:
    """Return the parsed modules of the package by path."""
    return {
        path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in PACKAGE.rglob("*.py")
    }


def is_importable(name: str) -> bool:
    """Return whether a dotted name leads to something of another library."""
    module, _, attribute = name.rpartition(".")
    try:
        importlib.import_module(name)
    except ImportError:
        try:
            return bool(module) and hasattr(importlib.import_module(module), attribute)
        except ImportError:
            return False
    return True


def unknown_names(text: str, names: set[str]) -> list[str]:
    """Return the names in single backticks that are neither in the package nor in a library."""
    found = dict.fromkeys(BACKTICKED.findall(text))
    return [n for n in found if not set(n.split(".")) <= names and not is_importable(n)]


def test_every_name_in_backticks_of_a_docstring_exists():
    names = {*dir(builtins), *keyword.kwlist, "factorgraph_adj"}
    for path, tree in sources().items():
        names |= {*path.removesuffix(".py").split("/"), *names_of(tree)}
    wrong = {
        f"{path}:{node.lineno}": unknown
        for path, tree in sources().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and (unknown := unknown_names(node.value, names))
    }
    assert not wrong


def test_a_wrong_name_in_backticks_is_found():
    text = "See `adjust`, `scipy.stats`, ``literal`` and `solve.no_such_function`."
    assert unknown_names(text, {"adjust", "solve"}) == ["solve.no_such_function"]
