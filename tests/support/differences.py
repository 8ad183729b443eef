"""The one numerical check of partials: central differences on the manifold of the unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factorgraph_adj.frames import Frame, LocalFrame
from factorgraph_adj.graph.blocks import Block
from factorgraph_adj.graph.equations import Equations
from factorgraph_adj.graph.variables import State, Unknowns
from factorgraph_adj.types import Array

TRUNCATION = 1e-9
"""Error of seven-point differences relative to the largest partial of a variable, for steps of
a hundredth of the length on which the function changes: below 40 (1/100)⁶."""
ABOVE = {
    "equal_height_difference",
    *("ellipsoid_height", "ellipsoid_height_difference"),
    *("ellipsoid_distance", "mean_height_distance"),
}
"""Kinds that observe heights."""
BETWEEN_FEET = {"ellipsoid_distance", "mean_height_distance"}
"""Kinds of distances between feet: the feet are rounded in height, too, by which no partial is."""
ROUNDINGS = 60
"""Rounding errors of coordinates, in units in the last place, that may add up in one value."""


def columns_of(unknowns: Unknowns, block: Block, partials: tuple[Array, ...]) -> Array:
    """Place the partials of a block among all columns, (n d, n_columns)."""
    out = np.zeros((block.n, block.dimension, unknowns.n_columns))
    for (kind, index), part in zip(block.variables, partials, strict=True):
        for row, number in enumerate(index):
            columns = unknowns.columns(kind, int(number))
            out[row][:, columns] += part[row][:, : len(columns)]
    return out.reshape(-1, unknowns.n_columns)


STENCIL = ((1, 45.0), (2, -9.0), (3, 1.0))
"""f'(0) ≈ Σ w (f(d h) − f(−d h)) / 60 h for (d, w): exact for polynomials of degree six."""


def displaced(unknowns: Unknowns, state: State, steps: Array) -> State:
    """Return ``state`` moved along every column by ±1, ±2, ±3 steps, one below the other."""
    moved = []
    for column in range(unknowns.n_columns):
        for distance, _ in STENCIL:
            for sign in (1.0, -1.0):
                step = np.zeros(unknowns.n_columns)
                step[column] = sign * distance * steps[column]
                moved.append(unknowns.retract(state, step))
    return {kind: np.concatenate([m[kind] for m in moved]) for kind in state}


def numerical(block: Block, frame: Frame, unknowns: Unknowns, moved: State, steps: Array) -> Array:
    """Return partials (n d, n_columns) by seven-point differences of all `displaced` states."""
    copies = unknowns.n_columns * len(STENCIL) * 2
    tiled = block.select(np.tile(np.arange(block.n), copies))
    variables = []
    for kind, index in block.variables:
        first = np.arange(copies) * len(unknowns[kind].names)
        variables.append((kind, (first[:, None] + index).ravel()))
    tiled = replace(tiled, variables=tuple(variables))
    v = tiled.evaluate(frame, moved, jacobians=False).residual
    values = v.reshape(unknowns.n_columns, len(STENCIL), 2, block.observed.size)
    weights = np.array([w for _, w in STENCIL])
    change = np.einsum("s,csr->cr", weights, values[:, :, 0] - values[:, :, 1])
    return (change / (60.0 * steps[:, None])).T


def observed_as_computed(equations: Equations, state: State) -> Equations:
    """Return the equations with residuals of zero: no angle then wraps within a step."""
    frame = equations.network.frame
    blocks = []
    for block in equations.blocks:
        v = block.evaluate(frame, state, jacobians=False).residual
        blocks.append(block if block.lens is not None else replace(block, observed=block.moved(v)))
    return replace(equations, blocks=tuple(blocks))


def assert_partials_are_right(equations: Equations, state: State, steps: Array) -> None:
    """Compare every analytic partial with its numerical value.

    Each is compared relative to the largest partial of the same variable in the same row; the
    rest of the tolerance is the rounding of coordinates and values, divided by the step.
    """
    unknowns, frame = equations.unknowns, equations.network.frame
    extent = float(np.nanmax(np.abs(state["point"]), initial=0.0))
    if len(state["pose"]):
        extent = max(extent, float(np.max(np.abs(state["pose"][:, 9:]))))
    in_metres = np.zeros(unknowns.n_columns, dtype=bool)
    for kind, number in unknowns.active():
        columns = unknowns.columns(kind, number)
        if kind in ("point", "pose"):
            in_metres[columns[-3:]] = True
    moved = displaced(unknowns, state, steps)
    for block in equations.blocks:
        v, partials = block.evaluate(frame, state)
        assert np.isfinite(v).all()
        analytic = columns_of(unknowns, block, partials)
        difference = np.abs(analytic - numerical(block, frame, unknowns, moved, steps))
        by_metre = np.max(np.abs(analytic[:, in_metres]), axis=1, initial=0.0)
        if block.kind in BETWEEN_FEET:
            by_metre = np.maximum(by_metre, 1.0)
        # A height above an ellipsoid comes from geocentric coordinates in any frame.
        above = block.kind in ABOVE or {k for k, _ in block.variables} & {"level", "profile"}
        earth = 0.0 if isinstance(frame, LocalFrame) or not above else frame.radius
        size = np.abs(block.observed).ravel() + max(extent, earth) * by_metre + np.abs(v).ravel()
        rounding = ROUNDINGS * np.finfo(float).eps * size[:, None] / steps
        for kind, number in unknowns.active():
            columns = unknowns.columns(kind, number)
            in_steps = np.abs(analytic[:, columns]) * steps[columns]
            allowed = (
                TRUNCATION * in_steps.max(axis=1, keepdims=True) / steps[columns]
                + rounding[:, columns]
            )
            wrong = difference[:, columns] > allowed
            if wrong.any():
                row, column = np.argwhere(wrong)[0]
                raise AssertionError(
                    f"{block.labels(row // block.dimension)}: partial by "
                    f"{unknowns.describe(int(columns[column]))} is "
                    f"{analytic[row, columns[column]]}, numerically it differs by "
                    f"{difference[row, columns[column]]} > {allowed[row, column]}"
                )


def whitened_system(equations: Equations, state: State) -> tuple[Array, Array]:
    """Return whitened A (n_rows, n_columns) and v (n_rows,) of all equations, clusters too."""
    a = np.zeros((equations.n_rows, equations.unknowns.n_columns))
    raw = a.copy()
    for block in equations.blocks:
        partials = block.evaluate(equations.network.frame, state).jacobians
        raw[block.rows] = columns_of(equations.unknowns, block, partials)
        whitened = tuple(block.whiten(np.asarray(p)) for p in partials)
        a[block.rows] = columns_of(equations.unknowns, block, whitened)
    for cluster in equations.clusters:
        a[cluster.rows] = cluster.whitener @ raw[cluster.rows]
    return a, equations.residuals(state)
