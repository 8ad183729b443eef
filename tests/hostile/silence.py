"""Words that a reader must not pass over: each is taken for something, refused, or declared.

A word of a file is replaced by one that no format has, a word or a line is added, an element, an
attribute or a key is added or renamed. A reader that reads what it is given either refuses this
with its place, or makes another network of it, in which nothing is lost. Where the network is the
same, or has fewer parts, the reader has skipped something, which only what the format declares as
not read may do.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import factorgraph_adj as fga

STRANGE = "qz7x"
"""A word that no format has."""
_SOURCE = re.compile(r"source=(None|'[^']*'|\"[^\"]*\")")
_WORD = re.compile(r"\S+")
_CELL = re.compile(r"[^,;\s]+")
_VALUE_XML = re.compile(r"(?<==\")[^\"<>]+(?=\")|(?<==')[^'<>]+(?=')|[^<>\s]+(?=[^<>]*<)")
_TAG = re.compile(r"(?<=<)[A-Za-z_][\w:.-]*")
_ATTRIBUTE = re.compile(r"(?<=\s)[A-Za-z_][\w:.-]*(?=\s*=\s*[\"'])")
_SCALAR = re.compile(r"(?<=[:\[,\s])(-?\d[\w.+-]*|\"[^\"\n]*\"|true|false)(?=\s*[,\]}\n])")
_KEY = re.compile(r"\"[^\"\n]*\"(?=\s*:)")


@dataclass(frozen=True)
class Change:
    """One change of a text."""

    way: str
    """What was done: value, name, word, line, element, attribute or key."""
    word: str
    """What stood there before, or what was put there."""
    line: int
    """Line of the change, from 1."""
    row: str
    """The text of this line before."""
    text: str
    """The file with the change."""


def changes(name: str, text: str) -> Iterator[Change]:
    """Iterate over all single changes of a file."""
    head = text.lstrip()[:5]
    if head.startswith("<"):
        yield from _replaced("value", _VALUE_XML, text, STRANGE)
        yield from _renamed_elements(text)
        yield from _replaced("name", _ATTRIBUTE, text, STRANGE)
        for m in _TAG.finditer(text):
            end = m.end()
            yield _change("attribute", text, end, end, f' {STRANGE}="1"')
            close = text.find(">", end)
            if close > 0 and text[close - 1] not in "/?":
                yield _change("element", text, close + 1, close + 1, f"<{STRANGE}>1</{STRANGE}>")
    elif name.endswith((".json", ".opf", ".gltf")):
        yield from _replaced("value", _SCALAR, text, f'"{STRANGE}"')
        yield from _replaced("name", _KEY, text, f'"{STRANGE}"')
        for m in re.finditer(r"\{", text):
            if text[m.end() :].lstrip()[:1] != "}":
                yield _change("key", text, m.end(), m.end(), f'"{STRANGE}": 1,')
    else:
        word = _CELL if name.endswith(".csv") else _WORD
        yield from _replaced("value", word, text, STRANGE)
        at = 0
        for row in text.split("\n")[:-1]:
            end = at + len(row)
            if row.strip():
                sep = next((s for s in ";,\t" if s in row and name.endswith(".csv")), " ")
                yield _change("word", text, end, end, sep + STRANGE)
            yield _change("line", text, end, end, f"\n{STRANGE} 1 2 3")
            at = end + 1


def _replaced(way: str, pattern: re.Pattern[str], text: str, by: str) -> Iterator[Change]:
    for m in pattern.finditer(text):
        yield _change(way, text, m.start(), m.end(), by)


def _renamed_elements(text: str) -> Iterator[Change]:
    for m in _TAG.finditer(text):
        tag, depth = re.escape(m[0]), 0
        close = text.find(">", m.end())
        changed = _change("name", text, m.start(), m.end(), STRANGE)
        if text[close - 1 : close] == "/":
            yield changed
            continue
        for other in re.finditer(rf"<(/?){tag}(?=[\s>/])[^>]*?(/?)>", text[m.start() - 1 :]):
            if other[2]:
                continue
            depth += -1 if other[1] else 1
            if depth == 0:
                end = m.start() - 1 + other.start() + 2
                both = text[: m.start()] + STRANGE + text[m.end() : end] + STRANGE
                both += text[end + len(m[0]) :]
                yield Change("name", m[0], changed.line, changed.row, both)
                break


def _change(way: str, text: str, start: int, end: int, by: str) -> Change:
    line = text.count("\n", 0, start) + 1
    row = text.split("\n")[line - 1]
    return Change(way, text[start:end] or by, line, row, text[:start] + by + text[end:])


def told(network: fga.Network) -> str:
    """Return everything that a network says, but for the lines where it was read."""
    with np.printoptions(threshold=10**6, precision=17):
        parts = {k: v for k, v in vars(network).items() if k != "images"}
        images = [c.tolist() for c in network.images.columns()]
        return _SOURCE.sub("", repr((parts, images, network.images.ids)))


def size(network: fga.Network) -> int:
    """Return the number of parts of a network: points, photos, cameras, observations, rays."""
    numbers = (network.points, network.photos, network.cameras, network.observations)
    return sum(map(len, numbers)) + network.n_image_points


def cuts(rng: np.random.Generator, content: bytes, count: int) -> Iterator[bytes]:
    """Iterate over a file of bytes that ends too early, in any of its parts."""
    for size in rng.permutation(len(content))[:count].tolist():
        yield content[:size]


def skipped(before: fga.Network, change: Change, after: fga.Network) -> str:
    """Say what a reader has skipped; empty: nothing.

    Args:
        before: the network of the undamaged files.
        change: the change.
        after: the network of the changed files.
    """
    if told(after) == told(before):
        return "the change is skipped"
    if size(after) < size(before):
        return f"parts are lost: {size(before)} before, {size(after)} after"
    if change.way == "value" or (change.way == "line" and size(after) > size(before)):
        return ""
    return "what does not belong there changes the network"
