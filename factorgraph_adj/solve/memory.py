"""How much memory an adjustment takes, told before it is taken."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..graph.equations import Equations
from ..graph.variables import State
from .factor import Plan

NUMBER = 8
"""Bytes of a number."""
GIGABYTE = 1e9
"""Bytes of a gigabyte."""
LISTS = 120
"""Bytes of the index lists and observed values of each ray."""
CHUNK = 12_000_000
"""Bytes of the temporary arrays while one chunk of rays is evaluated."""
POINT = 900
"""Bytes of the factors, cross products and right sides of each object point."""
ROW = 300
"""Bytes of the partials and index lists of each terrestrial row."""
PRODUCTS = 24
"""Bytes of the products of each terrestrial row, for each element of a block."""
ROW_OF_RELIABILITY = 2000
"""Bytes of the leverages, tests and detectable errors of each terrestrial row."""
OF_RAY = 30
"""Numbers of the reliability of each image point: its leverages, tests and detectable errors."""
WORTH_SAYING = 1e8
"""Bytes below which an adjustment is not compared with the free memory."""


@dataclass(frozen=True)
class Memory:
    """Bytes that an adjustment takes beside the network itself, by what takes them."""

    partials: int
    """Partials and residuals of one linearisation, with the lists of its rays and rows."""
    points: int
    """Factors of the object points, and their products with the cameras (W)."""
    fronts: int
    """Fronts of the reduced system."""
    reliability: int
    """What reliability takes besides: products with covariances, leverages, tests."""

    @property
    def adjustment(self) -> int:
        """Bytes of the adjustment."""
        return self.partials + self.points + self.fronts

    @property
    def total(self) -> int:
        """Bytes of adjustment and reliability."""
        return self.adjustment + self.reliability

    def __str__(self) -> str:
        """Return both in gigabytes."""
        return (
            f"{self.adjustment / GIGABYTE:.2f} GB, {self.total / GIGABYTE:.2f} GB with reliability"
        )


def memory_of(plan: Plan, equations: Equations, state: State) -> Memory:
    """Estimate the memory of an adjustment from its index lists.

    Args:
        plan: the layers of the elimination.
        equations: the network.
        state: any state; the fronts depend on where photos and points are.
    """
    rays = pairs = width = spokes = 0
    columns = 8
    if equations.rays:
        rays = sum(c.block.n for c in equations.rays.values())
        columns = 2 * max(8 + len(c.lens_free) for c in equations.rays.values())
    rows = equations.n_rows - 2 * rays
    fronts = points = side = 0
    if plan.nodes is not None:
        width = plan.nodes.width
        codes = [np.zeros(0, dtype=np.intp)]
        if plan.rays is not None:
            codes.append(plan.rays.pair_codes)
            points, pairs = plan.rays.n_points, len(plan.rays.left)
            if plan.rays.spokes is not None:
                spokes = len(plan.rays.spokes.points)
        if plan.rows is not None:
            codes.append(plan.rows.pair_codes)
        _, order = plan.nodes.structure(np.concatenate(codes), plan.nodes.positions(state))
        side = plan.nodes.side
        sizes = [(width * len(f.own), width * f.size + side) for f in order]
        # Factors, and what waits for the parent at the same time: at most once more.
        fronts = 2 * sum(own * whole for own, whole in sizes) + max((w * w for _, w in sizes))
    w = 3 * width * (rays + spokes) * NUMBER
    of_rays = rays * (columns * NUMBER + LISTS) + (CHUNK if rays else 0)
    return Memory(
        partials=of_rays + rows * (ROW + PRODUCTS * width**2),
        points=points * (POINT + 6 * side * NUMBER) + w + pairs * NUMBER,
        fronts=fronts * NUMBER,
        reliability=w
        + rays * OF_RAY * NUMBER
        + 6 * points * side * NUMBER
        + rows * ROW_OF_RELIABILITY,
    )


def available() -> float:
    """Return the bytes of memory that are free; infinite where the system does not tell."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return 1024.0 * float(line.split()[1])
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (OSError, ValueError, AttributeError):
        return float("inf")


def refuse_too_large(plan: Plan, equations: Equations, state: State) -> None:
    """Refuse an adjustment that takes more memory than there is.

    Raises:
        InputError: the adjustment takes more memory than is free; both figures are told.
    """
    # Pairs and fronts take long to count; small networks are let through without them.
    rays = sum(c.block.n for c in equations.rays.values())
    if rays * 500 + equations.n_rows * ROW < WORTH_SAYING:
        return
    needed, free = memory_of(plan, equations, state), available()
    if needed.adjustment > free:
        raise InputError(
            f"the adjustment of network {equations.network.name!r} takes about {needed}, and "
            f"{free / GIGABYTE:.2f} GB of memory are free: end other programs, divide the network "
            "into parts, or measure fewer points in the photos"
        )
