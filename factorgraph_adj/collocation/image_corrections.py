"""Correction grids of cameras from the residuals of a block: systematic image errors, filtered.

Residuals v = computed − observed of all photos of a camera have in common what the lens model
lacks: lens, film, sensor. In the axes of the camera they are

    v̄ = s(x, y) + n

with the mean residual v̄ of each cell of the image, whose noise has the standard deviation within
the cells divided by √(number of rays). Collocation predicts s at the nodes of a grid that is added
to the measured coordinates, `factorgraph_adj.models.grid_lens.GridLens`, for a second bundle.
Poses and points have taken part of the systematic errors, so that residuals show only the rest:
each further bundle with grid finds more of it, until the residuals have no signal or the stated
number of bundles is reached.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from ..adjustment import adjust
from ..errors import InputError, refuse_other_types, taking
from ..models.grid_lens import GridLens, y_is_time
from ..network.network import Network
from ..result_display import Shown
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_MODEL
from ..types import Array, Index
from .collocation import Collocation, collocate
from .covariance_estimation import CovarianceEstimate, estimate_covariance
from .covariance_function import CovarianceFunction
from .signal_test import SignalTest, signal_test
from .signal_variables import empty_grid

CELLS, NODES = 14, 21
"""Numbers of cells, and of nodes of the grid, along the longer side of the image."""
LEAST_CELLS = 12
"""Least number of cells with rays from which a grid is made."""
ImageCovariance: TypeAlias = CovarianceFunction | str


@dataclass(frozen=True, eq=False, repr=False)
class CameraCorrections(Shown):
    """Correction grid of a camera."""

    camera: str
    """Name of the camera."""
    collocation: Collocation
    """Signal and noise of the mean residuals of cells: components x and y, image units."""
    estimate: CovarianceEstimate | None
    """Estimated covariance function; None where one was stated."""
    test: SignalTest
    """Moran's test of the mean residuals."""
    lens: GridLens
    """The lens model with the grid, before the lens that the camera had."""
    sigmas: Array
    """σ of the corrections at the nodes, (nodes of y, nodes of x, 2), image units."""
    largest: float
    """Largest correction that was added, image units."""

    def headline(self) -> str:
        """Return the camera, the largest correction and the test."""
        return (
            f"CameraCorrections of {self.camera!r}: up to {self.largest:.3g} from "
            f"{len(self.collocation.places)} cells; {self.test.headline()}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class ImageCorrections(Shown):
    """Correction grids of the cameras of a network."""

    cameras: Mapping[str, CameraCorrections]
    """Corrections by camera, of cameras whose residuals have a signal."""
    remarks: tuple[str, ...]
    """Why cameras have no correction, as sentences."""

    def headline(self) -> str:
        """Return the cameras and the remarks."""
        each = "; ".join([*(c.headline() for c in self.cameras.values()), *self.remarks])
        return f"ImageCorrections: {each}"

    def applied(self, network: Network) -> Network:
        """Return a network whose cameras have these grids; ``network`` stays unchanged."""
        out = network.copy()
        for name, found in self.cameras.items():
            out.cameras[name] = replace(out.cameras[name], lens=found.lens)
        return out


def image_corrections(
    solution: Solution,
    *,
    covariance: ImageCovariance = "gaussian",
    cells: int = CELLS,
    nodes: int = NODES,
    alpha: float = ALPHA_OF_MODEL,
) -> ImageCorrections:
    """Filter the systematic residuals of each camera, as grids of corrections.

    Args:
        solution: the bundle adjustment.
        covariance: covariance function of x and y in the image, image units; or its kind, of which
            σ and L are estimated.
        cells: number of cells along the longer side of the image, whose residuals are averaged.
        nodes: number of nodes of a new grid along the longer side; a grid that the camera has
            already keeps its nodes, and the corrections are added to it.
        alpha: probability with which the test finds a signal where there is none. A camera without
            a signal keeps its lens.

    Cameras whose lens takes no grid, or whose y is a time (lens ``line``), keep their lens, and a
    remark says so.

    Raises:
        InputError: there are no image points, or a number is too small.
    """
    refuse_other_types(solution, Solution, "image_corrections")
    if cells < 3 or nodes < 2:
        raise InputError("a grid needs 3 or more cells and 2 or more nodes along a side")
    photo, xy, residuals = _image_residuals(solution)
    if not len(photo):
        raise InputError("the network has no image points")
    network = solution.network
    number = {name: i for i, name in enumerate(network.cameras)}
    of_photo = np.array([number[f.camera] for f in network.photos.values()], dtype=np.intp)
    found: dict[str, CameraCorrections] = {}
    remarks: list[str] = []
    for name, camera in network.cameras.items():
        on = of_photo[photo] == number[name]
        if not on.any():
            continue
        if camera.lens.takes != "tangents":
            remarks.append(f"camera {name!r}: its lens {camera.lens.kind!r} takes no grid")
            continue
        if y_is_time(camera.lens):
            remarks.append(
                f"camera {name!r}: y of its lens {camera.lens.kind!r} is the time of a line of the "
                "image, on which corrections of a grid have no effect"
            )
            continue
        corners = camera.corners() or (xy[on].min(axis=0), xy[on].max(axis=0))
        lens = camera.lens if isinstance(camera.lens, GridLens) else None
        if lens is None or not lens.x:
            lens = empty_grid(GridLens(camera.lens) if lens is None else lens, corners, nodes)
        try:
            found[name] = _of_camera(
                name, lens, xy[on], residuals[on], corners, covariance, cells, alpha
            )
        except InputError as error:
            remarks.append(f"camera {name!r}: {error}")
    return ImageCorrections(found, tuple(remarks))


def _image_residuals(solution: Solution) -> tuple[Index, Array, Array]:
    """Return numbers of photos (n,), measured coordinates and residuals (n, 2), image units."""
    v = solution.observations.residuals
    blocks = [b for b in solution.equations.blocks if b.image]
    empty = np.zeros((0, 2))
    return (
        np.concatenate([np.zeros(0, dtype=np.intp), *(b.variables[0][1] for b in blocks)]),
        np.concatenate([empty, *(b.observed for b in blocks)]),
        np.concatenate([empty, *(v[b.rows].reshape(-1, 2) for b in blocks)]),
    )


def _of_camera(
    name: str,
    lens: GridLens,
    xy: Array,
    residuals: Array,
    corners: tuple[Array, Array],
    covariance: ImageCovariance,
    cells: int,
    alpha: float,
) -> CameraCorrections:
    """Return the corrections of a camera from its residuals.

    Raises:
        InputError: there are too few rays, or no signal.
    """
    places, means, noise = _means_of_cells(xy, residuals, corners, cells)
    estimate: CovarianceEstimate | None = None
    if isinstance(covariance, str):
        estimate = estimate_covariance(
            places, means, kind=covariance, noise=noise, trend="none", alpha=alpha
        )
        function, test = estimate.function, estimate.test
    else:
        function = covariance
        test = signal_test(places, means, noise=noise, trend="none", alpha=alpha)
        if not test.has_signal:
            raise InputError(test.headline())
    collocation = collocate(places, means, covariance=function, noise=noise, trend="none")
    x, y = np.meshgrid(np.array(lens.x), np.array(lens.y))
    prediction = collocation.predict(np.column_stack([x.ravel(), y.ravel()]))
    dx, dy = (prediction.values[:, i].reshape(x.shape) for i in range(2))
    return CameraCorrections(
        name,
        collocation,
        estimate,
        test,
        lens.plus(dx, dy),
        prediction.sigmas.reshape(*x.shape, 2),
        float(np.hypot(dx, dy).max()),
    )


def _means_of_cells(
    xy: Array, residuals: Array, corners: tuple[Array, Array], cells: int
) -> tuple[Array, Array, Array]:
    """Return mean places and residuals of the cells with rays, and σ of their noise, (k, 2) each.

    Raises:
        InputError: fewer than `LEAST_CELLS` cells have rays, or no cell has two.
    """
    low, high = corners
    side = float((high - low).max()) / cells
    column, row = np.floor((xy - low) / side).astype(np.intp).T
    _, cell = np.unique(np.column_stack([row, column]), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell).astype(float)
    if len(count) < LEAST_CELLS or len(xy) == len(count):
        raise InputError(f"{len(xy)} rays in {len(count)} cells are too few for a grid")

    def mean(values: Array) -> Array:
        sums = [np.bincount(cell, weights=values[:, i]) for i in range(2)]
        return np.asarray(np.column_stack(sums) / count[:, None])

    means = mean(residuals)
    within = residuals - means[cell]
    pooled = np.sqrt(np.sum(within**2, axis=0) / (len(xy) - len(count)))
    return mean(xy), means, pooled / np.sqrt(count)[:, None]


@dataclass(frozen=True, eq=False)
class CorrectedBundle:
    """Bundle adjustments that follow each other, each with the grids of the residuals before it."""

    solution: Solution
    """The last bundle."""
    rounds: tuple[ImageCorrections, ...]
    """Corrections before each further bundle; without cameras at the end, if no signal is left."""
    solutions: tuple[Solution, ...]
    """All bundles, the given one first."""


@taking(Solution)
def corrected_bundle(
    solution: Solution,
    *,
    covariance: ImageCovariance = "gaussian",
    rounds: int = 5,
    cells: int = CELLS,
    nodes: int = NODES,
    alpha: float = ALPHA_OF_MODEL,
) -> CorrectedBundle:
    """Adjust again with correction grids until the residuals have no signal, or ``rounds`` times.

    Args:
        solution: the first bundle adjustment.
        covariance: as for `image_corrections`.
        rounds: largest number of further bundles.
        cells: as for `image_corrections`.
        nodes: as for `image_corrections`.
        alpha: as for `image_corrections`.

    Raises:
        InputError: as `image_corrections`; errors of `factorgraph_adj.adjust`.
    """
    solutions, found = [solution], []
    for _ in range(rounds):
        last = solutions[-1]
        corrections = image_corrections(
            last, covariance=covariance, cells=cells, nodes=nodes, alpha=alpha
        )
        found.append(corrections)
        if not corrections.cameras:
            break
        # Grids change residuals by their own size alone: the last places are a good start.
        solutions.append(
            adjust(corrections.applied(last.network), start=last, variance=last.variance)
        )
    return CorrectedBundle(solutions[-1], tuple(found), tuple(solutions))
