"""A block of two strips that polynomials bend, as plan with true values."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

import factorgraph_adj as fga

TRUE = {
    "north": {"a0": 3.0, "b0": -2.0, "z": 1.5, "a1": 0.4, "b1": -0.7, "z_x": 0.8, "z_y": -0.3}
    | {"a2": 0.25, "b2": -0.15, "z_xx": 0.6, "z_xy": 0.2},
    "south": {"a0": -1.0, "b0": 4.0, "z": -0.5, "a1": -0.2, "b1": 0.3, "z_x": -0.4, "z_y": 0.5}
    | {"a2": -0.1, "b2": 0.35, "z_xx": -0.3, "z_xy": 0.4},
}
"""True coefficients, metres for each power of a kilometre."""
HEIGHT = ("z", "z_x", "z_y", "z_xx", "z_xy")
SIGMA = (0.1, 0.1, 0.15)
"""Standard deviations of strip coordinates, metres."""
COLUMNS, ROWS = 9, 5
"""Points along and across; the strips share the middle row."""
CONTROL = frozenset(f"{i}-{j}" for i in (0, 4, 8) for j in (0, 2, 4))
"""Control points: ends and middle of the outer rows and of the shared one."""


def bent_strips(
    *, control: Iterable[str] = CONTROL, degree: int = 2, height: Iterable[str] = HEIGHT
) -> fga.Network:
    """Return the plan, whose strip coordinates are to be measured."""
    held, terms = set(control), tuple(height)
    network = fga.Network("bent strips")
    rng = np.random.default_rng(6)
    for i in range(COLUMNS):
        for j in range(ROWS):
            x = (500.0 * i, 400.0 * j, float(rng.uniform(80, 160)))
            network.add_point(f"{i}-{j}", x, fixed="xyz" if f"{i}-{j}" in held else "")
    for n, (name, true) in enumerate(TRUE.items()):
        plan = {f"{c}{k}" for c in "ab" for k in range(degree + 1)}
        values = {c: v for c, v in true.items() if c in plan or c in terms}
        network.set_polynomial(name, plan=degree, height=terms, values=values)
        for i in range(COLUMNS):
            for j in range(2 * n, 2 * n + 3):
                along, across = 0.5 * (i - 4), 0.4 * (j - 2 * n - 1)
                network.add(
                    fga.StripCoordinate(
                        name,
                        f"{i}-{j}",
                        (0.0, 0.0, 0.0),
                        along=along,
                        across=across,
                        sigma=SIGMA,
                        id=f"{name} {i}-{j}",
                    )
                )
    return network
