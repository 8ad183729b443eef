"""Grammars of instruments by their words, and how a grammar is added.

A grammar is a class or function with keyword-only arguments, which become keys of [[instrument]];
what it returns has one method, ``read``, see `Grammar`. Its module has the record ``GRAMMAR`` of
class `GrammarRecord`, and `GRAMMAR_MODULES` a line with the word. A module is imported when an
instrument needs it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from ..errors import InputError, known
from ..io.format_options import arguments_of, options_of
from .readings import Reading, ReceivedLine


class Grammar(Protocol):
    """Parser of the lines of one instrument; it may keep a state from line to line."""

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return what a line says; nothing: it is of the grammar and has no reading.

        Raises:
            InputError: the line is not of the grammar; the problems say what, why and what would
                be valid. The whole line is refused and counted, and the state does not change.
        """


@dataclass(frozen=True)
class GrammarRecord:
    """A grammar: its word, and what makes a parser of it."""

    word: str
    """Value of ``grammar`` in [[instrument]]."""
    description: str
    """What it reads, in words."""
    make: Callable[..., Grammar]
    """Class or function that makes the parser; its keyword-only arguments are keys of
    [[instrument]], and have defaults unless a user must state them."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of its keys of [[instrument]]."""
        return options_of(self.make)

    def parser(self, options: Mapping[str, Any]) -> Grammar:
        """Return a parser with options of [[instrument]], those of groups among them.

        Raises:
            InputError: the options do not fit together.
        """
        return self.make(**arguments_of(self.make, options))


GRAMMAR_MODULES = {
    "gsi-online": "gsi_online",
    "geocom": "geocom",
    "gsi-level": "gsi_level_online",
    "nmea": "nmea",
    "ros": "ros_bags",
    "sensor-lines": "sensor_lines",
    "sokkia-set": "sokkia_set",
}
"""Module of each grammar by its word."""
_REGISTERED: dict[str, GrammarRecord] = {}


def register_grammar(record: GrammarRecord) -> GrammarRecord:
    """Add a grammar of one's own; return it."""
    _REGISTERED[record.word] = record
    return record


def grammar_words() -> tuple[str, ...]:
    """Return the words of all grammars."""
    return (*GRAMMAR_MODULES, *_REGISTERED)


def grammar_record(word: str) -> GrammarRecord:
    """Return the grammar of a word.

    Raises:
        InputError: there is none.
    """
    if word in _REGISTERED:
        return _REGISTERED[word]
    if word not in GRAMMAR_MODULES:
        valid = known(grammar_words(), meant=word, most=40)
        raise InputError(f"unknown grammar {word!r}; valid: {valid}")
    module = import_module(f".{GRAMMAR_MODULES[word]}", __package__)
    found: GrammarRecord = module.GRAMMAR
    return found
