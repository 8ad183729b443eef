"""Exceptions with lists of problems; doubts; what was left out; valid names and classes."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from os import PathLike, fspath
from types import UnionType
from typing import ParamSpec, TypeVar, get_args

Given = ParamSpec("Given")
Found = TypeVar("Found")

MOST_COMPARED = 2_000
"""Largest number of names that are compared with a wrong one, which takes 10 µs for each name."""
MEANT = "; did you mean"
"""Begin of the end of a message that asks for the name that was meant."""
_NUMBER = re.compile(r"\d+")
_LIST = re.compile(r"(?<=; )(valid|known|it takes): .{60,}?(?=; did you mean '|$)", re.DOTALL)
"""A long list of what would be valid, to the end of a message or to the name that was meant."""


class AdjustmentError(Exception):
    """Base of every error that this library raises on purpose."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with an input."""

    what: str
    """What is wrong, why, and what would be valid."""
    where: str = ""
    """File and line, or the observation, point or photo concerned."""

    def __str__(self) -> str:
        return f"{self.where}: {self.what}" if self.where else self.what

    def at(self, place: str) -> Problem:
        """Return the problem with the file and line before its own place."""
        return Problem(self.what, f"{place}: {self.where}" if self.where else place)


@dataclass(frozen=True)
class Doubt(Problem):
    """Readings that did not agree when they were reduced to observations."""

    ids: tuple[str, ...] = ()
    """Observations made from these readings: the doubt ends when one of them is taken out. Empty
    for readings of a whole set-up."""


@dataclass(frozen=True)
class Unreached(Problem):
    """Unknowns of one sort that have no approximate value for the same reason."""

    noun: str = ""
    """The sort."""
    names: frozenset[str] = frozenset()
    """Their names."""

    def of(self, name: str) -> str:
        """Say it of one of them."""
        return str(Problem(self.what, f"{self.noun} {name}"))


@dataclass(frozen=True)
class LeftOut:
    """Rows of one sort that a reader left out."""

    what: str
    """The rows, in words: ``marks of known points``."""
    why: str
    """Why they were left out."""
    names: tuple[str, ...]
    """Names of the photos, points or rows, each once."""
    count: int
    """Number of the rows."""
    of: int = 0
    """Number of all rows of the sort, if it is known; 0: it is not."""
    where: str = ""
    """File and line of the first row."""
    hint: str = ""
    """What may have been meant."""
    doubtful: bool = False
    """Whether the rows were expected to be used, so that the result is doubtful."""

    def __str__(self) -> str:
        of = f" of {self.of}" if self.of else ""
        named = f": {known(self.names)}{self.hint}" if self.names else ""
        first = f"; first in {self.where}" if self.where else ""
        return f"{self.what}: {self.count}{of} left out, as {self.why}{named}{first}"


@dataclass(frozen=True)
class UnknownLeftOut:
    """An unknown that was left out before an adjustment, as nothing determines it."""

    kind: str
    """Kind of the unknown, such as ``point``."""
    name: str
    """Its name."""
    why: str
    """Why it was left out."""
    ids: tuple[str, ...]
    """Observations that were left out with it; image points by photo/point."""


def listed_once(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Return problems of which each long list of valid names stands in the first one only.

    >>> row = "unknown kind 'd'; valid: " + ", ".join(f"kind_{i}" for i in range(20))
    >>> listed_once([Problem(row, "a.csv:2"), Problem(row, "a.csv:3")])[1].what
    "unknown kind 'd'; valid: as above"
    """
    seen: set[str] = set()
    out = []
    for p in problems:
        found = _LIST.search(p.what)
        if found is not None and found[0] in seen:
            after = p.what[found.end() :]
            p = Problem(f"{p.what[: found.start()]}{found[1]}: as above{after}", p.where)
        elif found is not None:
            seen.add(found[0])
        out.append(p)
    return tuple(out)


class InputError(AdjustmentError):
    """An input has problems; the exception lists all of them.

    ``problems`` have each long list of valid names once; ``noted`` are the problems as they were
    given, for a reader that puts them among others and sorts them.
    """

    def __init__(self, problems: str | Problem | Iterable[Problem]) -> None:
        if isinstance(problems, str):
            problems = [Problem(problems)]
        elif isinstance(problems, Problem):
            problems = [problems]
        self.noted = tuple(problems)
        self.problems: tuple[Problem, ...] = listed_once(self.noted)
        super().__init__("\n".join(str(p) for p in self.problems))


class DatumError(AdjustmentError):
    """The observations and priors do not determine every unknown.

    ``defect`` is the number of missing conditions. ``names`` are the unknowns that the message
    lists; ``unknowns`` are kind and name of all unknowns concerned. ``apart`` are the same of parts
    without a datum beside a part that has one.
    """

    def __init__(
        self,
        message: str,
        *,
        defect: int,
        names: Sequence[str] = (),
        unknowns: Sequence[tuple[str, str]] = (),
        apart: Sequence[tuple[str, str]] = (),
    ) -> None:
        self.apart = tuple(apart)
        self.defect = defect
        self.names = tuple(names)
        self.unknowns = tuple(unknowns)
        super().__init__(message)


class ApproximationError(AdjustmentError):
    """Approximate values could not be found; ``problems`` names the unknowns and the reasons.

    ``photos`` are the names of all photos without a pose, ``unknowns`` kind and name of all
    unknowns without a value.
    """

    def __init__(
        self,
        problems: Iterable[Problem],
        *,
        photos: Iterable[str] = (),
        unknowns: Iterable[tuple[str, str]] = (),
    ) -> None:
        self.photos = tuple(photos)
        self.unknowns = tuple(unknowns)
        self.problems: tuple[Problem, ...] = tuple(problems)
        super().__init__("\n".join(str(p) for p in self.problems))


def known(names: Iterable[object], *, meant: object = "", most: int = 12) -> str:
    """List valid names for an error message, cut to ``most``; ask for the one that was meant.

    >>> known(["a", "b", "c"], most=2)
    'a, b, … (3 in all)'
    >>> known(["given", "free"], meant="fre")
    "given, free; did you mean 'free'?"
    >>> known(["", "a"])
    'a'

    Args:
        names: the valid names; the empty one, of a default that stands for all that have no name
            of their own, is not listed.
        meant: the wrong name, see `similar`; none: nothing is asked.
        most: number of names that are listed at most.
    """
    listed = [text for n in names if (text := str(n))]
    if not listed:
        return "none"
    asked = similar(meant, listed) if isinstance(meant, str) else ""
    if len(listed) <= most:
        return ", ".join(listed) + asked
    return ", ".join(listed[:most]) + f", … ({len(listed)} in all)" + asked


def counted(n: int, noun: str) -> str:
    """Return a number with its noun, which takes an s except for 1.

    >>> counted(1, "posting"), counted(2, "posting")
    ('1 posting', '2 postings')
    """
    return f"{n} {noun}{'s' * (n != 1)}"


def unknown_name(noun: str, name: object, names: Iterable[object], *, most: int = 12) -> str:
    """Say that a name is unknown, and which are known, see `known`.

    >>> unknown_name("point", "Q", ["A", "B"])
    "unknown point 'Q'; known: A, B"
    """
    return f"unknown {noun} {name!r}; known: {known(names, meant=name, most=most)}"


def system_reason(error: Exception) -> str:
    """Return why the system refused a file, in the words of messages.

    >>> system_reason(FileNotFoundError(2, "No such file or directory"))
    'no such file or folder'
    """
    said = str(getattr(error, "strerror", None) or error).replace("directory", "folder")
    # "I/O error" stays as it is.
    return said if said[1:2] in "/" or said[1:2].isupper() else said[:1].lower() + said[1:]


def similar(name: str, names: Collection[str]) -> str:
    """Return ``"; did you mean 'x'?"`` with the name that is most similar; empty if none is.

    Units are not asked for: ``grad`` is like ``rad``, and means ``gon``. Names with other numbers
    are others: ``LT2`` is another instrument than ``LT1``.

    >>> similar("d1", ["D1", "D2"])
    "; did you mean 'D1'?"
    """
    if len(names) > MOST_COMPARED:
        return ""
    number = _NUMBER.findall(name)
    there = {n.casefold(): n for n in names if not number or _NUMBER.findall(n) in ([], number)}
    close = get_close_matches(name.casefold(), there, 1)
    return f"{MEANT} {there[close[0]]!r}?" if close else ""


_SOURCES = {
    "Network": ("fga.read({0!r})", "fga.read(path), or the network of a solution"),
    "Solution": ("fga.adjust(fga.read({0!r}))", "fga.adjust(network)"),
    "Congruence": ("fga.congruence(first, second)", "fga.congruence(first, second)"),
    "Reliability": ("fga.reliability(fga.adjust(fga.read({0!r})))", "fga.reliability(solution)"),
}
"""Where the objects of a computation come from: from a file, and from another object."""


def refuse_other_types(value: object, valid: type | UnionType, function: str) -> None:
    """Refuse an object that a function cannot take, such as the path of a project for a network.

    Args:
        value: what was given.
        valid: the class, or classes, that the function takes.
        function: its name.

    Raises:
        InputError: which classes are valid, and what returns one of them.
    """
    if isinstance(value, valid):
        return
    names = [cls.__name__ for cls in get_args(valid) or (valid,)]
    path = fspath(value) if isinstance(value, str | PathLike) else None
    given = "None" if value is None else f"an object of {type(value).__name__}"
    listed = " or ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    what = f"{function} takes a {listed}, not {given if path is None else repr(path)}"
    from_file, from_object = next((_SOURCES[n] for n in names if n in _SOURCES), ("", ""))
    if from_file:
        what += f": give {from_object if path is None else from_file.format(path)}"
    raise InputError(what)


def taking(
    valid: type | UnionType,
) -> Callable[[Callable[Given, Found]], Callable[Given, Found]]:
    """Return a decorator of functions whose first argument is of some classes.

    Raises:
        InputError: when the function is called with something else, see `refuse_other_types`.
    """

    def decorate(function: Callable[Given, Found]) -> Callable[Given, Found]:
        argument = next(iter(signature(function).parameters))

        @wraps(function)
        def checked(*args: Given.args, **kwargs: Given.kwargs) -> Found:
            if args or argument in kwargs:
                value = args[0] if args else kwargs[argument]
                refuse_other_types(value, valid, function.__name__)
            return function(*args, **kwargs)

        return checked

    return decorate


class SingularError(AdjustmentError):
    """A pivot of the elimination is zero; the caller determines the unknowns concerned."""
