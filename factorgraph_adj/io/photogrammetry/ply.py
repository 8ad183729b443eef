"""PLY files of vertices: a header of named properties, then a table of numbers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...errors import InputError, Problem

TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
"""Types of properties by their names in a header."""
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
MOST_HEADER = 10_000
"""Largest number of bytes of a header."""


def read_vertices(content: bytes, where: str) -> dict[str, npt.NDArray[np.generic]]:
    """Return the columns of the first element, by property, (n,) each.

    Args:
        content: the file.
        where: its name in messages.

    Raises:
        InputError: the file is no PLY file, has a list where numbers are expected, or is cut.
    """

    def refuse(what: str) -> InputError:
        return InputError(Problem(what, where))

    end = content.find(b"end_header", 0, MOST_HEADER)
    if not content.startswith(b"ply") or end < 0:
        raise refuse("is no PLY file: it must begin with 'ply' and have a line end_header")
    start = content.find(b"\n", end) + 1
    lines = [line.split() for line in content[:end].decode("latin-1").splitlines()]
    order, count = "", -1
    properties: list[tuple[str, str]] = []
    elements = 0
    for words in lines:
        if words[:1] == ["format"] and len(words) == 3 and words[1] in ORDERS:
            order = words[1]
        elif words[:1] == ["element"]:
            elements += 1
            if elements == 1 and len(words) == 3 and words[2].isascii() and words[2].isdigit():
                count = int(words[2][:18])
        elif words[:1] == ["property"] and elements == 1:
            if len(words) != 3 or words[1] not in TYPES or words[2] in dict(properties):
                raise refuse(f"property {' '.join(words[1:])!r} is none of a table of numbers")
            properties.append((words[2], TYPES[words[1]]))
    if not order or count < 0 or not properties or not start:
        raise refuse("has no complete header: format, element vertex, properties, end_header")
    if order == "ascii":
        return _ascii(content[start:], properties, count, where)
    kind = np.dtype([(name, ORDERS[order] + t) for name, t in properties])
    if len(content) - start < count * kind.itemsize:
        what = f"is cut: {count} vertices of {kind.itemsize} bytes, {len(content) - start} bytes"
        raise refuse(what)
    table = np.frombuffer(content, kind, count, start)
    return {name: table[name] for name, _ in properties}


def _ascii(
    body: bytes, properties: list[tuple[str, str]], count: int, where: str
) -> dict[str, npt.NDArray[np.generic]]:
    words = body.split()
    if len(words) < count * len(properties):
        what = f"is cut: {count} vertices of {len(properties)} numbers, {len(words)} numbers"
        raise InputError(Problem(what, where))
    try:
        table = np.array([float(w) for w in words[: count * len(properties)]])
    except ValueError as error:
        raise InputError(Problem(f"is not a table of numbers: {error}", where)) from None
    table = table.reshape(count, len(properties))
    return {name: table[:, i] for i, (name, _) in enumerate(properties)}
