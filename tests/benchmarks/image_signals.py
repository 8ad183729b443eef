"""Gain by signals in images (Ayeni's method 27) on the geometry of Casa Grande, by their length.

    python -m tests.benchmarks.image_signals [SEEDS]

Two strips with four photos, 1 : 4000, 60 and 40 per cent, as in `examples.papers.table_3_1980`.
Images of all photos have a Gaussian random field in x and in y in common. Six control points lie
around the 0.7 km² of the table, and all other points in it are check points. The size of the field
is such that the bundle without signals has about the printed error in plan, 3.2 cm, or, with small
random errors, the printed one in height, 2.9 cm; figures with signals have no part in the choice.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np

from examples.papers.methods_1980 import METHODS, ran
from examples.papers.methods_1980_block import CAMERA, FORMAT, MethodBlock, read_images
from examples.papers.table_3_1980 import BLOCKS
from factorgraph_adj.collocation.covariance_function import CovarianceFunction
from factorgraph_adj.collocation.signal_variables import empty_grid
from factorgraph_adj.models.grid_lens import GridLens
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.network import Network
from factorgraph_adj.types import Array

AREA = 0.7e6
"""Area of the table, square metres."""
NODES = 21
"""Number of nodes of the field along a side of the image."""


@dataclass(frozen=True)
class Case:
    """What the table does not state."""

    points: int
    """Points in a photo."""
    length: float
    """Correlation length of the field, mm."""
    signal: float
    """Standard deviation of the field, mm."""
    noise: float = 0.004
    """Standard deviation of image coordinates, mm."""
    side: float = 0.4
    """Overlap across the strips."""


CASES = (
    Case(20, 60.0, 0.0115),
    Case(20, 92.0, 0.0120),
    Case(60, 60.0, 0.0125),
    Case(60, 92.0, 0.0125),
    Case(60, 60.0, 0.0120, side=0.6),
    Case(60, 60.0, 0.0039, 0.0022),
)
"""Cases of the table in the documentation."""
CASA_GRANDE = next(b for b in BLOCKS if b.name == "Casa Grande")
"""The block."""


def block(case: Case, seed: int) -> MethodBlock:
    """Return the measured block of a case."""
    sides = (CASA_GRANDE.overlaps[0], case.side)
    plan = replace(CASA_GRANDE, points=case.points, overlaps=sides).network(seed)
    half = FORMAT / 2
    lens = empty_grid(GridLens(NoDistortion()), (np.full(2, -half), np.full(2, half)), NODES)
    x, y = np.meshgrid(np.array(lens.x), np.array(lens.y))
    function = CovarianceFunction("gaussian", sigma=case.signal, length=case.length)
    values, vectors = np.linalg.eigh(function.between(np.column_stack([x.ravel(), y.ravel()])))
    random = np.random.default_rng([seed, 7]).normal(size=(2, len(values)))
    # The symmetric root does not depend on which vectors of equal values are found.
    fields = random @ (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    del plan.cameras[CAMERA]
    lens = lens.plus(fields[0].reshape(x.shape), fields[1].reshape(x.shape))
    plan.add_camera(CAMERA, lens, {"c": CASA_GRANDE.focal})
    _set_control(plan)
    read = read_images(plan, case.noise, 10 * seed, CASA_GRANDE.focal)
    return MethodBlock(read, read)


def _set_control(plan: Network) -> None:
    """Hold the points nearest to the corners and long sides of the area; check those within."""
    centres = np.array([p.position for p in plan.photos.values()], dtype=float)[:, :2]
    extent = np.ptp(centres, axis=0)
    along = int(np.argmax(extent))
    half = np.full(2, extent[along] / 2)
    half[1 - along] = AREA / extent[along] / 2
    places = np.array([p.coordinates for p in plan.points.values()], dtype=float)[:, :2]
    off = places - centres.mean(axis=0)
    control: list[int] = []
    for side in (-1.0, 1.0):
        for end in (-1.0, 0.0, 1.0):
            place = half * (np.roll([end, side], along))
            order = np.argsort(np.linalg.norm(off - place, axis=1)).tolist()
            control.append(next(i for i in order if i not in control))
    within = np.all(np.abs(off) < half, axis=1)
    for i, (name, p) in enumerate([*plan.points.items()]):
        held = i in control
        check = p.coordinates if within[i] and not held else None
        plan.points[name] = replace(p, fixed=(held,) * 3, check=check)


def errors(case: Case, seeds: int) -> Array:
    """Return RMS errors in plan and height of methods 25 and 27, cm, (2, 2), where 27 is run."""
    rows = [next(r for r in METHODS if r.number == n) for n in (25, 27)]
    squares = []
    for seed in range(1, seeds + 1):
        measured = block(case, seed)
        found = [ran(row, measured) for row in rows]
        if all(f.outcome is not None for f in found):
            squares.append([[np.mean(f.rms[:2] ** 2), f.rms[2] ** 2] for f in found])
    print(f"{len(squares)} of {seeds} seeds: {case}")
    return np.asarray(100 * np.sqrt(np.mean(squares, axis=0)))


def main() -> None:
    """Print errors without and with signals, and their ratios."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    for case in CASES:
        (plan, height), (plan_27, height_27) = errors(case, seeds).tolist()
        print(
            f"  plan {plan:.1f} → {plan_27:.1f} ({plan_27 / plan:.2f}), "
            f"height {height:.1f} → {height_27:.1f} ({height_27 / height:.2f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
