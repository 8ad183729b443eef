"""How much memory the objects of this process hold."""

from __future__ import annotations

import gc
import sys

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
