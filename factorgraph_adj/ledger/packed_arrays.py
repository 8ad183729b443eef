"""Arrays as text in a line of a journal, where a few digits are enough."""

from __future__ import annotations

from base64 import b64decode, b64encode
from itertools import permutations

import numpy as np

from ..types import Array, Index

THREE_DIGITS, SEVEN_DIGITS = "<f2", "<f4"
"""Types of the numbers in text: little-endian, of half and of single precision."""


def packed(a: Array) -> str:
    """Return numbers as text, with seven digits each."""
    return b64encode(np.asarray(a, dtype=SEVEN_DIGITS).tobytes()).decode("ascii")


def unpacked(text: str, *shape: int) -> Array:
    """Return the numbers of a text, in a shape."""
    return np.frombuffer(b64decode(text), dtype=SEVEN_DIGITS).astype(float).reshape(shape)


def packed_symmetric(a: Array) -> tuple[float, str]:
    """Return the largest number of a tensor (k, k, k), and all as text, relative to it.

    The tensor is symmetric in all its places; numbers have three digits.
    """
    most = float(np.abs(a).max(initial=0.0))
    each = a[_places(len(a))] / (most or 1.0)
    return most, b64encode(each.astype(THREE_DIGITS).tobytes()).decode("ascii")


def unpacked_symmetric(most: float, text: str, k: int) -> Array:
    """Return the tensor, (k, k, k)."""
    out, places = np.empty((k, k, k)), _places(k)
    each = most * np.frombuffer(b64decode(text), dtype=THREE_DIGITS).astype(float)
    for order in permutations(places):
        out[order] = each
    return out


def _places(k: int) -> tuple[Index, ...]:
    """Return the places of the numbers of a symmetric tensor that differ."""
    i = np.arange(k)
    return np.nonzero((i[:, None, None] <= i[:, None]) & (i[:, None] <= i))
