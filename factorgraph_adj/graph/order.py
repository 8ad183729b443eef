"""The stable order of numbers of photos, points and pairs."""

from __future__ import annotations

import numpy as np

from ..types import Index

DIGIT = 16
"""Bits that are sorted at once: numpy sorts numbers of 16 bits by radix, longer ones by merging,
which takes five times as long."""


def stable_order(numbers: Index, count: int) -> Index:
    """Return the order in which numbers from 0 to ``count`` − 1 ascend; equal ones keep theirs.

    Args:
        numbers: the numbers, (n,).
        count: a number that none of them reaches.
    """
    order: Index = np.argsort(numbers.astype(np.uint16), kind="stable")
    for shift in range(DIGIT, max(count - 1, 0).bit_length(), DIGIT):
        digits = (numbers >> shift).astype(np.uint16)  # the higher bits are cut off
        order = order[np.argsort(digits[order], kind="stable")]
    return order
