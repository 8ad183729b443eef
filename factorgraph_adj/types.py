"""Types of arrays of floats, indices, masks and keys; docstrings of functions state the shapes."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
"""Floating point array."""
Index: TypeAlias = npt.NDArray[np.intp]
"""Integer array that indexes another."""
Mask: TypeAlias = npt.NDArray[np.bool_]
"""Boolean array."""
Keys: TypeAlias = npt.NDArray[np.uint64]
"""Array of 64-bit numbers that stand for names."""

NO_ROWS: Index = np.zeros(0, dtype=np.intp)
"""An index of no rows."""
