"""Control characters: refused in names, and shown as escapes wherever other text is printed.

A name may come from anybody's file. Characters that steer a terminal, that break lines or that
turn the direction of writing make a report or a table say what is not in it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator

from .errors import InputError, Problem

_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters (C0, DEL, C1), separators of lines and paragraphs, characters that set the
direction of writing, and halves of characters, which no file can hold."""
_KEPT = "\n\t"
"""Control characters of printed text that is made of lines."""


def escaped(text: str) -> str:
    r"""Return a text with its control characters as escapes; line breaks and tabulators stay.

    >>> escaped("P\x1b[2J\u202e\n")
    'P\\x1b[2J\\u202e\n'
    """
    return text if text.isprintable() else _CONTROL.sub(_escape_in_text, text)


def one_line(text: str) -> str:
    r"""Return a text as one line: blanks for line breaks and tabulators, escapes for the others.

    >>> one_line("first\n  second\x07")
    'first second\\x07'
    """
    return text if text.isprintable() else _CONTROL.sub(_escape, " ".join(_words(text)))


def has_control_characters(name: str) -> bool:
    """Return whether a name has characters that no name may have."""
    return not name.isprintable() and _CONTROL.search(name) is not None


def has_half_characters(value: object) -> bool:
    r"""Return whether data of JSON have halves of characters (lone surrogates) in their texts.

    JSON can write them, UTF-8 cannot: neither an answer nor a file could hold such a text.

    >>> has_half_characters(["P\ud800"]), has_half_characters({"P": "\U0001f5fb"})
    (True, False)
    """
    try:
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    except UnicodeEncodeError:
        return True
    return False


def refuse_half_characters(text: str, found: object, what: str) -> None:
    """Refuse data of JSON with halves of characters.

    Args:
        text: the JSON, in which they are escapes.
        found: the data.
        what: what they are of, for the message.

    Raises:
        InputError: there are some.
    """
    if "\\u" in text and has_half_characters(found):
        raise InputError(f"the {what} has half a character (a lone surrogate)")


def problems_of_names(names: Iterable[str], what: str) -> Iterator[Problem]:
    """Yield a problem for every name with control characters; ``what`` it is the name of."""
    for name in names:
        if has_control_characters(name):
            yield Problem(why_refused(name), f"{what} '{_CONTROL.sub(_escape, name)}'")


def refuse_control_characters(names: Iterable[str], what: str) -> None:
    """Refuse names with characters that would steer a terminal or break a line."""
    if problems := list(problems_of_names(names, what)):
        raise InputError(problems)


def why_refused(name: str) -> str:
    r"""Return what is wrong with a name that has control characters.

    >>> why_refused("P\x1b")
    'a name cannot have control characters: \\x1b'
    """
    found = sorted(set(_CONTROL.findall(name)))
    return f"a name cannot have control characters: {' '.join(map(_escaped, found))}"


def _words(text: str) -> list[str]:
    return [word for word in re.split("[ \n\r\t]+", text) if word]


def _escaped(c: str) -> str:
    return f"\\x{ord(c):02x}" if ord(c) < 256 else f"\\u{ord(c):04x}"


def _escape(found: re.Match[str]) -> str:
    return _escaped(found[0])


def _escape_in_text(found: re.Match[str]) -> str:
    return found[0] if found[0] in _KEPT else _escaped(found[0])
