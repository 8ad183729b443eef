"""Residuals in measured coordinates of lens models that correct these, and their partials.

Equations 18 and 20 of El-Hakim & Faig (1981), in every iteration and to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ..types import Array, Index, Mask

Correction: TypeAlias = tuple[Array, Array, tuple[Array, ...], list[tuple[Array, Array]]]
"""dV_x, dV_y (n,), ∂dV_x/∂x̄, ∂dV_x/∂ȳ, ∂dV_y/∂x̄, ∂dV_y/∂ȳ, and pairs of partials of dV_x and dV_y
by each additional parameter; no partials where none are asked for."""
Pair: TypeAlias = tuple[Array | float, Array | float]
"""Partials of v_x and v_y, (n,) each; a number where all of them are equal."""
Corrects: TypeAlias = Callable[[Array, Array, Array, bool], Correction]
"""The corrections of measured x̄, ȳ (n,) for parameters (n, k) or (1, k), with partials or not."""

MAX_STEPS = 30
"""Largest number of steps to the measured coordinates of a ray."""
LARGEST_STEP = 1e-16
"""Largest step to measured coordinates that is left out, in principal distances."""


def measured_residuals(
    correction: Corrects,
    tx: Array,
    ty: Array,
    x: Array,
    y: Array,
    k: Array,
    *,
    jacobians: bool,
) -> tuple[tuple[Array, Array], tuple[Pair, ...], tuple[Pair, ...]]:
    """Return v = l̂ − l with w(l̂) = 0, and its partials by the tangents and the parameters.

    l̂ is found by two steps with the B of l, else by Newton's method. Where that leads away, v is
    the residual w(l) in ideal coordinates.

    Args:
        correction: dV_x, dV_y and their partials, of measured coordinates from the principal point.
        tx: tangents t_x of the rays, (n,).
        ty: tangents t_y of the rays, (n,).
        x: measured coordinates x, (n,).
        y: measured coordinates y, (n,).
        k: calibration parameters c, x0, y0 and those of the correction, (n, …) or (1, …).
        jacobians: whether to compute the partials.
    """
    c, ax, ay = k[:, 0], x - k[:, 1], y - k[:, 2]
    ux, uy = c * tx, c * ty
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        dx, dy, d, _ = correction(ax, ay, k, True)
        to_measured = _Inverse(d)
        vx, vy = to_measured(ux - ax - dx, uy - ay - dy)
        sizes = [np.maximum(np.abs(vx), np.abs(vy))]
        for _ in range(2):  # B changes little as far as l̂, so that that of l serves again
            bx, by = ax + vx, ay + vy
            dx, dy, _, _ = correction(bx, by, k, False)
            sx, sy = to_measured(ux - bx - dx, uy - by - dy)
            vx, vy = vx + sx, vy + sy
            sizes.append(np.maximum(np.abs(sx), np.abs(sy)))
        # Steps shrink by the same ratio each.
        limit = LARGEST_STEP * np.abs(c)
        far = np.flatnonzero(~(sizes[1] ** 3 <= limit * sizes[0] ** 2))
        ideal = np.zeros(0, dtype=np.intp)
        if len(far):
            own = k if len(k) == 1 else k[far]
            found = _far(correction, ux[far], uy[far], ax[far], ay[far], own)
            vx[far], vy[far], lost = found
            ideal = far[lost]
        if not jacobians:
            return (vx, vy), (), ()
        ax, ay = ax + vx, ay + vy
        ax[ideal], ay[ideal] = (x - k[:, 1])[ideal], (y - k[:, 2])[ideal]
        _, _, d, columns = correction(ax, ay, k, True)
        turned = _Inverse(d, ideal)
    xx, xy, yx, yy = turned.elements
    by_x0: Pair = (1.0, 0.0)
    by_y0: Pair = (0.0, 1.0)
    if len(ideal):  # of these w counts, whose partials by x0 and y0 are B
        dxx, dxy, dyx, dyy = d
        outside = np.zeros(len(x), dtype=bool)
        outside[ideal] = True
        by_x0 = np.where(outside, 1.0 + dxx, 1.0), np.where(outside, dyx, 0.0)
        by_y0 = np.where(outside, dxy, 0.0), np.where(outside, 1.0 + dyy, 1.0)
    by_k = [turned(tx, ty), by_x0, by_y0, *(turned(-px, -py) for px, py in columns)]
    return (vx, vy), ((c * xx, c * yx), (c * xy, c * yy)), tuple(by_k)


def _far(
    correction: Corrects, ux: Array, uy: Array, ax: Array, ay: Array, k: Array
) -> tuple[Array, Array, Mask]:
    """Return v_x, v_y by Newton's method, and whether they are those of ideal coordinates.

    Args:
        correction: the corrections.
        ux: ideal coordinates c t_x, (n,).
        uy: ideal coordinates c t_y, (n,).
        ax: measured coordinates x − x0, (n,).
        ay: measured coordinates y − y0, (n,).
        k: calibration parameters, (n, number of names) or (1, ...).
    """
    bx, by = ax.copy(), ay.copy()
    limit = np.sqrt(LARGEST_STEP) * np.abs(k[:, 0])  # the next step is its square
    size = np.full(len(ax), np.inf)
    going, lost = np.ones(len(ax), dtype=bool), np.zeros(len(ax), dtype=bool)
    for _ in range(MAX_STEPS):
        dx, dy, d, _ = correction(bx, by, k, True)
        sx, sy = _Inverse(d)(ux - bx - dx, uy - by - dy)
        before, size = size, np.maximum(np.abs(sx), np.abs(sy))
        # Steps that do not shrink lead away from the image.
        lost |= going & ~(size <= np.maximum(0.5 * before, limit))
        going &= ~lost
        # Those that have arrived stay, so that no ray depends on the others.
        bx[going] += sx[going]
        by[going] += sy[going]
        going &= size > limit
        if not going.any():
            break
    lost |= going
    dx, dy, _, _ = correction(ax, ay, k, False)
    vx, vy = np.where(lost, ux - ax - dx, bx - ax), np.where(lost, uy - ay - dy, by - ay)
    return vx, vy, lost


class _Inverse:
    """B⁻¹ of rays, B = I + ∂dV/∂(x̄, ȳ) = −∂w/∂l; I for some of them."""

    def __init__(self, d: tuple[Array, ...], ideal: Index | None = None) -> None:
        dxx, dxy, dyx, dyy = d
        xx, yy = 1.0 + dxx, 1.0 + dyy
        determinant = xx * yy - dxy * dyx
        self.elements = yy / determinant, -dxy / determinant, -dyx / determinant, xx / determinant
        if ideal is not None and len(ideal):
            for element, value in zip(self.elements, (1.0, 0.0, 0.0, 1.0), strict=True):
                element[ideal] = value

    def __call__(self, px: Array, py: Array) -> tuple[Array, Array]:
        """Return B⁻¹ p."""
        xx, xy, yx, yy = self.elements
        return xx * px + xy * py, yx * px + yy * py
