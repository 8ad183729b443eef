"""What reports and tables show of a solution, gathered once: scalar observations and groups."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..graph.blocks import Block
from ..io.numbers import Units
from ..observations import ControlPoint
from ..quality.solution import Solution
from ..types import Array
from ..units import ANGLE, LENGTH, format_angle

MOST_CAMERAS = 8
"""Cameras that are groups of their own; more are grouped by the unit of their images."""
IN_RADIANS = ("weighted_orientation", "weighted_vertical", "weighted_attitude")


@dataclass(frozen=True)
class Scale:
    """Units in which values and their small companions (σ, v) are shown."""

    unit: str
    """Unit of values: m, gon, dms, px …; empty for what has none or several."""
    small: str
    """Unit of σ and v."""
    size: float
    """One ``small`` in the unit of the solution (SI, or image units)."""

    def value(self, value: float, digits: int) -> str:
        """Write a value."""
        if self.unit in ANGLE or self.unit == "dms":
            return format_angle(value, self.unit, digits)
        return f"{value / LENGTH.get(self.unit, 1.0):.{digits}f}"


@dataclass(frozen=True)
class Row:
    """One scalar observation after the adjustment, in the units of the solution."""

    id: str
    """Id of the observation."""
    kind: str
    """Kind."""
    names: tuple[str, ...]
    """Points and photo."""
    component: str
    """Which component of it; empty where there is one only."""
    observed: float
    """Observed value."""
    residual: float
    """v = computed − observed."""
    sigma: float
    """A-priori standard deviation."""
    scale: Scale
    """Units to show it in."""
    source: str
    """File and line, where it was read from one."""


@dataclass(frozen=True)
class Group:
    """Observations of one kind; image coordinates of one camera."""

    label: str
    """Kind, and camera."""
    observations: int
    """Number of observations."""
    scalars: int
    """Number of scalar components."""
    sigma: tuple[float, float]
    """Smallest and largest a-priori standard deviation."""
    rms: float
    """Root mean square of v."""
    normalised_rms: float
    """Root mean square of v/σ."""
    largest: float
    """Largest |v/σ|."""
    scale: Scale
    """Units of σ and v."""


class Rows:
    """The scalar observations of a solution."""

    def __init__(self, solution: Solution, units: Units) -> None:
        """Look at a solution."""
        self.solution = solution
        self.units = units
        self.network = solution.network
        self._photos, self._points = tuple(self.network.photos), tuple(self.network.points)
        self._residuals: Array = solution.observations.residuals

    def scale(self, block: Block, photo: int | None = None) -> Scale:
        """Return the units of a block; those of image coordinates are their camera's."""
        units = self.units
        if block.kind == "image":
            camera = self.network.photos[self._photos[photo or 0]].camera
            return image_scale(self.network.cameras[camera].unit)
        if block.unit == "m":
            return Scale(units.length, units.sigma_length, LENGTH[units.sigma_length])
        if block.unit == "rad" or block.kind in IN_RADIANS:
            return Scale(units.angle, units.sigma_angle, ANGLE[units.sigma_angle])
        return Scale("", "", 1.0)

    def all(self) -> Iterator[Row]:
        """Iterate over every scalar observation."""
        for block in self.solution.equations.blocks:
            yield from self._of_block(block, range(block.n))

    def largest(self, most: int) -> list[Row]:
        """Return the rows with the largest |v/σ|, largest first."""
        size = np.abs(self.solution.observations.normalised)
        order = np.argsort(-size, kind="stable")[:most]
        out: list[Row] = []
        for index in order.tolist():
            block = next(
                b for b in self.solution.equations.blocks if b.rows.start <= index < b.rows.stop
            )
            i, component = divmod(index - block.first_row, block.dimension)
            out.append(list(self._of_block(block, [i]))[component])
        return out

    def groups(self) -> list[Group]:
        """Return figures by kind."""
        found: dict[str, list[tuple[Block, Array, Array, Array]]] = {}
        for block in self.solution.equations.blocks:
            v = self._residuals[block.rows].reshape(block.observed.shape)
            labels = self._labels(block)
            for label in dict.fromkeys(labels.tolist()):
                rows = labels == label
                found.setdefault(label, []).append((block, v[rows], block.sigma[rows], rows))
        out = []
        for label, parts in found.items():
            v = np.concatenate([p[1].ravel() for p in parts])
            sigma = np.concatenate([p[2].ravel() for p in parts])
            block, rows = parts[0][0], parts[0][3]
            photo = int(block.variables[0][1][np.argmax(rows)]) if block.kind == "image" else None
            norm = v / sigma
            out.append(
                Group(
                    label,
                    sum(_n_observations(p[0], p[3]) for p in parts),
                    len(v),
                    (float(sigma.min()), float(sigma.max())),
                    float(np.sqrt(np.mean(v**2))),
                    float(np.sqrt(np.mean(norm**2))),
                    float(np.max(np.abs(norm))),
                    self.scale(block, photo),
                )
            )
        return out

    def _labels(self, block: Block) -> Array:
        """Return the group of each observation of a block."""
        name = block.kind.replace("weighted_", "weighted ").replace("_", " ")
        if block.kind == "control" and block.ids[0] not in self.network.observations:
            name = "weighted coordinates"
        if block.kind != "image" or len(self.network.cameras) == 1:
            return np.full(block.n, name)
        by = "name" if len(self.network.cameras) <= MOST_CAMERAS else "unit"
        cameras = [self.network.cameras[f.camera] for f in self.network.photos.values()]
        labels = np.array([f"image, {getattr(c, by)}" for c in cameras])
        return np.asarray(labels[block.variables[0][1]])

    def _of_block(self, block: Block, rows: range | list[int]) -> Iterator[Row]:
        first, d = block.first_row, block.dimension
        for i in rows:
            ident, source, axes = str(block.ids[i]), "", block.components
            names: tuple[str, ...] = ()
            photo = None
            observation = self.network.observations.get(ident)
            if block.kind == "image":
                photo = int(block.variables[0][1][i])
                names = (self._photos[photo], self._points[int(block.variables[2][1][i])])
                source = block.labels(i).partition(": image ")[0]
                source = "" if source == block.labels(i) else source
            elif observation is not None and not block.kind.startswith("weighted"):
                names = observation.names()
                source = getattr(observation, "source", None) or ""
                if isinstance(observation, ControlPoint):
                    before = 0
                    while i - before > 0 and block.ids[i - before - 1] == ident:
                        before += 1
                    axes = (observation.axes[before],)
            scale = self.scale(block, photo)
            for c in range(d):
                yield Row(
                    ident,
                    block.kind,
                    names,
                    axes[c],
                    float(block.observed[i, c]),
                    float(self._residuals[first + i * d + c]),
                    float(block.sigma[i, c]),
                    scale,
                    source,
                )


def image_scale(unit: str) -> Scale:
    """Return the units of image coordinates: micrometres for σ and v of millimetres."""
    return Scale(unit, "um", 1e-3) if unit == "mm" else Scale(unit, unit, 1.0)


def _n_observations(block: Block, rows: Array) -> int:
    """Return the number of observations: control has a row for each of its coordinates."""
    if block.kind in ("control", "gnss_position"):
        return len({ident for ident, on in zip(block.ids, rows, strict=True) if on})
    return int(rows.sum())
