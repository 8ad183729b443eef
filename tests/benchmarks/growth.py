"""How time and memory grow with the size of a network."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

GROWTH = (10_000, 30_000, 100_000, 300_000, 1_000_000)
"""Image points of the aerial blocks."""
GRIDS = (100, 1_024, 10_000)
"""Points of the terrestrial grids."""


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return b of the line log(value) = a + b log(size) that fits best by least squares.

    Costs that do not depend on the size lower the exponent where small sizes take part.
    """
    slope, _ = np.polyfit(np.log(sizes), np.log(values), 1)
    return float(slope)
