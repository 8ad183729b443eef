"""Reader of specs in TOML: keys are the names of parameters, tables are nested dataclasses.

Example:
    ::

        name = "a small block"
        [[parts]]
        kind = "aerial"
        strips = 2
        [control]
        horizontal = "perimeter"
        vertical = "full"
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from ..errors import InputError, Problem, known
from ..io.text import parse_toml, read_text
from .spec import Spec


def read_spec(source: str | Path) -> Spec:
    """Read a spec.

    Args:
        source: a file, or the TOML text itself (text with a line break or an equals sign).

    Raises:
        InputError: all problems, each with the path of its key.
    """
    text, where = _text(source)
    document = parse_toml(text, where)
    names = [f.name for f in fields(Spec)]
    found = [
        Problem(f"unknown key; valid: {known(names, meant=key, most=40)}", key)
        for key in document
        if key not in names
    ]
    if "parts" not in document:
        found.append(Problem("is missing: a spec has at least one part", "parts"))
    try:
        # The rest is checked even with faulty parts, whose problems are already in the list.
        rest = {k: v for k, v in document.items() if k in names}
        spec = Spec(**{"parts": None, **rest})
    except InputError as error:
        absent = "parts" not in document
        found += [p for p in error.problems if not (absent and p.where == "parts")]
    if found:
        raise InputError(found)
    return spec


def _text(source: str | Path) -> tuple[str, str]:
    """Return the TOML text and its name for messages."""
    if isinstance(source, str) and ("\n" in source or "=" in source):
        return source, "spec"
    path = Path(source)
    return read_text(path, path.name), path.name
