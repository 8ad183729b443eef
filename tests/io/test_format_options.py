"""Options of readers and writers: names and kinds of values, refused in one way for all formats."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.format_options import fitting_options
from factorgraph_adj.io.format_reader import NetworkReader
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.io.writers import WRITERS


def reader(
    path: Path,
    *,
    sigma: float = 1.0,
    number: int | None = None,
    station: str | None = None,
    table: str | Path | None = None,
    held: bool = False,
    choice: Literal["a", "b"] = "a",
    names: Literal["all"] | Sequence[str] = "all",
    several: str | Iterable[str] = (),
    pair: tuple[float, float] = (1.0, 2.0),
    shift: Sequence[float] = (),
    accuracy: Mapping[str, float] | None = None,
    network: fga.Network | None = None,
    anything: Any = None,
) -> None:
    """Have options of every kind."""


FITTING = {
    "sigma": [2, 0.5, np.float32(0.5), np.int64(3), float("nan")],
    "number": [None, 3],
    "station": ["P1", None],
    "table": ["a.csv", Path("a.csv"), None],
    "held": [True, False],
    "choice": ["a", "b"],
    "names": ["all", ["c", "k1"], ("c",), []],
    "several": ["P1", ["P1", "P2"], {"P1"}],
    "pair": [(1, 2.0), [0.1, 0.2], np.array([1.0, 2.0])],
    "shift": [[1, 2, 3], np.zeros(3)],
    "accuracy": [{"a": 1}, {}, None],
    "network": [None, fga.Network("a")],
    "anything": [object, 1, "x"],
}
MISFITS = {
    "sigma": ["0,5", True, None, [1.0]],
    "number": [0.5, "3", True],
    "station": [1.5, ["P1"], False],
    "table": [0.5, {"a": 1}],
    "held": [1, "yes", None],
    "choice": ["c", 1, None],
    "names": ["c", [1], 3, {"c": 1}],
    "several": [1.5, [1]],
    "pair": [1.0, (1.0,), ("a", "b"), "ab"],
    "shift": ["123", 1.0, ["a"]],
    "accuracy": [{"a": "b"}, {1: 1.0}, "a", [1.0]],
    "network": [3.5, "a"],
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, vs in FITTING.items() for v in vs])
def test_values_of_the_stated_kind_are_taken_as_they_are(name: str, value: Any) -> None:
    assert fitting_options(reader, {name: value}, doing="reading X", where="f")[name] is value


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, vs in MISFITS.items() for v in vs])
def test_values_of_another_kind_are_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError) as caught:
        fitting_options(reader, {name: value}, doing="reading X", where="f")
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"f: reading X: option {name} must be ")
    assert str(problem).endswith(f", not {value!r}")


def test_all_misfits_are_named_at_once_with_what_would_be_valid() -> None:
    given = {"sigma": "0,5", "choice": "c", "names": "c", "pair": 1, "accuracy": "a", "held": 1}
    with pytest.raises(InputError) as caught:
        fitting_options(reader, given, doing="reading X", where="f")
    said = [str(p).removeprefix("f: reading X: option ") for p in caught.value.problems]
    assert said == [
        "sigma must be a number, not '0,5'",
        "choice must be 'a' or 'b', not 'c'",
        "names must be 'all' or a list of texts, such as [\"a\", \"b\"], not 'c'",
        "pair must be a list of 2 numbers, not 1",
        "accuracy must be a table, such as {name = 0.5}, not 'a'",
        "held must be true or false, not 1",
    ]


def test_a_name_that_is_a_number_is_a_name() -> None:
    """The command reads station=101 as a number."""
    assert fitting_options(reader, {"station": 101}, doing="", where="") == {"station": "101"}
    assert fitting_options(reader, {"several": 7}, doing="", where="") == {"several": "7"}


@pytest.mark.parametrize("word", ["none", "None", "NONE"])
def test_none_is_nothing_where_nothing_is_allowed_and_no_text(word: str) -> None:
    """The command has no other word: refraction=none; a station may be called none."""

    def book(*, refraction: float | None = 0.13, station: str | None = None) -> None:
        """Read."""

    given = {"refraction": word, "station": word}
    found = fitting_options(book, given, doing="", where="")
    assert found == {"refraction": None, "station": word}
    with pytest.raises(InputError, match="option sigma must be a number, not 'none'"):
        fitting_options(reader, {"sigma": "none"}, doing="", where="")


@pytest.mark.parametrize("entry", [*READERS.entries, *WRITERS.entries], ids=lambda e: e.name)
def test_the_defaults_of_every_format_are_of_the_kinds_that_are_valid(entry: Any) -> None:
    """An annotation that cannot be resolved, or that its default contradicts, would refuse all."""
    function = getattr(entry, "write", None) or entry.load
    function = function.read if isinstance(function, NetworkReader) else function
    given = {
        p.name: p.default
        for p in inspect.signature(function).parameters.values()
        if p.kind is p.KEYWORD_ONLY and p.default is not p.empty
    }
    for group in [v for v in given.values() if is_dataclass(v)]:
        given |= {f.name: getattr(group, f.name) for f in fields(group)}
    given = {n: v for n, v in given.items() if n in entry.options}
    needed = {n: "a" for n in entry.options if n not in given}
    assert fitting_options(function, given | needed, doing="", where="") == given | needed
    for name in needed:
        with pytest.raises(InputError, match=f"f: reading X needs the option {name}: "):
            fitting_options(function, given, doing="reading X", where="f")


@pytest.mark.parametrize("value", ["abc", [1, 2], {"a": 1}, ["zz"], -1, 0.5, True])
def test_no_option_of_a_reader_ends_in_a_fault(tmp_path: Path, value: Any) -> None:
    """Of empty files: a problem of the input, or an empty network, and no other exception."""
    for entry in READERS.entries:
        suffix = (*entry.suffixes, "")[0]
        path = tmp_path / f"file{suffix}"
        path.write_text("") if suffix else path.mkdir(exist_ok=True)
        for option in entry.options:
            with suppress(InputError):
                READERS.load(path, format=entry.name, options={option: value})
