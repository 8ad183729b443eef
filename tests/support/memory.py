"""How much memory objects of this process hold, and how much a process has."""

from __future__ import annotations

import gc
import resource
import sys
from pathlib import Path

import numpy as np


def held_bytes() -> int:
    """Return the bytes of all objects that this process can reach, data of arrays included."""
    gc.collect()
    todo = gc.get_objects()
    seen = {id(todo)}
    seen.add(id(seen))
    total = 0
    while todo:
        each = todo.pop()
        if id(each) in seen:
            continue
        seen.add(id(each))
        total += sys.getsizeof(each, 0)
        todo.extend(gc.get_referents(each))
        if isinstance(each, np.ndarray):  # which has no referents
            todo += [] if each.base is None else [each.base]
            todo += each.ravel().tolist() if each.dtype.hasobject else []
    return total


def resident_bytes(process: int) -> int:
    """Return the bytes of memory that a process has, by its id (Linux)."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * resource.getpagesize()
