"""Files of OpenCV's FileStorage as read: YAML or XML, values and matrices with their lines.

YAML is read by PyYAML (the extra ``opencv``), XML by the parser of the package.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...errors import InputError, Problem
from ...files import MAX_YAML_BYTES
from ...types import Array
from ..source import Field, Problems, is_unread
from ..text_files import last_line_number, read_text
from ..xml_files import Element, parse_xml

PYYAML_MISSING = "OpenCV's YAML files need PyYAML: pip install 'factorgraph_adj[opencv]'"
MATRIX_TYPE = "opencv-matrix"
_TYPE = re.compile(r"\"?(\d?)[ucwsifd]\"?", re.ASCII)
"""Type of the elements of a matrix, with their number of channels before it."""


@dataclass(frozen=True)
class StorageValue:
    """A value of a file."""

    text: str
    """Text of a scalar; that of the data of a matrix."""
    where: str
    """File and line."""
    shape: tuple[str, str, str] | None = None
    """Rows, columns and type of a matrix; None of a scalar."""

    def field(self, problems: Problems, name: str) -> Field:
        """Return a scalar as a field."""
        return problems.field(self.text, name, self.where)

    def matrix(self, problems: Problems, name: str) -> Array | None:
        """Return a matrix (rows, columns, channels); None after a problem."""
        if self.shape is None:
            problems.wrong(f"{name} must be a matrix ({MATRIX_TYPE})", self.where)
            return None
        rows, columns, kind = self.shape
        found_type = _TYPE.fullmatch(kind)
        sizes = [rows, columns, "-" if found_type is None else found_type[1] or "1"]
        if not all(s.isascii() and s.isdigit() and len(s) < 10 for s in sizes):
            said = f"rows {rows!r}, cols {columns!r}, dt {kind!r}"
            what = f"{name} has {said}; valid: two whole numbers, a type such as d or 2f"
            problems.wrong(what, self.where)
            return None
        shape = tuple(int(s) for s in sizes)
        found = self.field(problems, name).numbers(int(np.prod(shape)))
        return None if is_unread(found) else np.array(found).reshape(shape)


def read_storage(path: Path) -> tuple[dict[str, StorageValue], int]:
    """Return the values of a file by name, and the number of its last line.

    Raises:
        InputError: the file cannot be read, or is neither YAML nor XML of OpenCV.
    """
    text = read_text(path)
    if text.lstrip().startswith("<"):
        return _of_xml(parse_xml(text.encode("utf-8"), path.name), path.name), last_line_number(
            text
        )
    return _of_yaml(text, path.name), last_line_number(text)


def _of_xml(root: Element, name: str) -> dict[str, StorageValue]:
    if root.tag != "opencv_storage":
        what = f"has the element <{root.tag}> where OpenCV writes <opencv_storage>"
        raise InputError(Problem(what, f"{name}:{root.line}"))
    out = {}
    for child in root.children:
        where = f"{name}:{child.line}"
        inner = {c.tag: c.text.strip() for c in child.children}
        if child.tag in out:
            raise InputError(Problem(f"{child.tag} is defined twice", where))
        if "data" in inner:
            shape = (inner.get("rows", ""), inner.get("cols", ""), inner.get("dt", ""))
            out[child.tag] = StorageValue(inner["data"], where, shape)
        elif child.attributes.get("type_id") == MATRIX_TYPE or "rows" in inner:
            raise InputError(Problem(f"matrix {child.tag} has no <data>", where))
        elif not child.children:
            out[child.tag] = StorageValue(child.text.strip().strip('"'), where)
    return out


def _yaml() -> ModuleType:
    try:
        import yaml
    except ImportError:
        raise InputError(PYYAML_MISSING) from None
    module: ModuleType = yaml
    return module


def yaml_mapping(text: str, name: str) -> Any:
    """Return the root of a YAML text, a mapping node of PyYAML, whose nodes have their lines.

    Args:
        text: the text; ``%YAML:1.0``, OpenCV's own spelling, may be its first line.
        name: name of the file in messages.

    Raises:
        InputError: PyYAML is missing, or the text is not YAML with names and values.
    """
    yaml = _yaml()
    if len(text) > MAX_YAML_BYTES:
        what = f"has {len(text)} characters; valid: at most {MAX_YAML_BYTES} for YAML"
        raise InputError(Problem(what, name))
    lines = text.split("\n")
    if lines and lines[0].startswith("%YAML"):
        lines[0] = ""  # %YAML:1.0 is OpenCV's own spelling, which no other program reads
    try:
        root = yaml.compose("\n".join(lines), Loader=_loader(yaml))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        at = getattr(error, "position", len(text))  # of a character that YAML does not allow
        line = "\n".join(lines).count("\n", 0, at) if mark is None else mark.line
        where = f"{name}:{min(line + 1, len(lines))}"
        reason = getattr(error, "problem", None) or str(error).split("\n")[0]
        raise InputError(Problem(f"is not YAML: {reason}", where)) from None
    except (RecursionError, ValueError) as error:
        raise InputError(Problem(f"is not YAML: {str(error)[:80]}", f"{name}:1")) from None
    if not isinstance(root, yaml.MappingNode):
        raise InputError(Problem("has no names and values", f"{name}:{last_line_number(text)}"))
    return root


def _of_yaml(text: str, name: str) -> dict[str, StorageValue]:
    yaml = _yaml()
    root = yaml_mapping(text, name)
    out: dict[str, StorageValue] = {}
    for key, node in root.value:
        where = f"{name}:{node.start_mark.line + 1}"
        if not isinstance(key, yaml.ScalarNode):
            raise InputError(Problem("a name must be a word, no list or table", where))
        if key.value in out:
            raise InputError(Problem(f"{key.value} is defined twice", where))
        if isinstance(node, yaml.ScalarNode):
            out[str(key.value)] = StorageValue(node.value, where)
        elif isinstance(node, yaml.MappingNode):
            inner = {k.value: v for k, v in node.value if isinstance(k.value, str)}
            sizes = [_scalar(yaml, inner.get(k)) for k in ("rows", "cols", "dt")]
            data = inner.get("data")
            if isinstance(data, yaml.SequenceNode):
                words = " ".join(_scalar(yaml, v) for v in data.value)
                out[str(key.value)] = StorageValue(words, where, (sizes[0], sizes[1], sizes[2]))
            elif str(node.tag).endswith(MATRIX_TYPE) or "rows" in inner:
                what = f"matrix {key.value} has no data, such as data: [ 1., 2. ]"
                raise InputError(Problem(what, where))
    return out


def _loader(yaml: ModuleType) -> Any:
    """Return the loader of YAML that is ten times as fast, where it was built."""
    return getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _scalar(yaml: ModuleType, node: Any) -> str:
    """Return the text of a scalar; of anything else a text that is no number."""
    if not isinstance(node, yaml.ScalarNode):
        return "-"
    text = str(node.value)
    return text + "0" if text.endswith(".") else text
