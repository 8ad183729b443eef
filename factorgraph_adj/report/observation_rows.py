"""Scalar observations of a solution as rows of reports: groups, identity columns, units shown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, log10

import numpy as np

from ..entities import Camera
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.image_ids import ImageIds
from ..graph.variables import camera_of_calibration
from ..io.numbers import Units, write_quantity
from ..models.base import within
from ..observations import KINDS, observation_kind
from ..observations import Unit as ObservationUnit
from ..observations.registry import in_image_table
from ..types import Array, Index
from ..units import ANGLE, LENGTH
from .tables import Unit, unit_of

POINT_COLUMNS = ("station", "target", "target2", "station2", "point", "start", "end")
"""Columns of the points of observations, in tables of a project as in those of results."""
DECIMALS_TOLERANCE = 0.01
"""Part of a decimal that rounding of units may cost without a further decimal."""
MAX_CAMERAS_GROUPED_APART = 8
"""Largest number of cameras with one group each; more cameras are grouped by image unit."""


@dataclass(frozen=True)
class Scale:
    """Units in which values, and the smaller σ and v, are shown."""

    unit: str
    """Unit of values: m, gon, dms, px …; empty for no unit or several units."""
    small: str
    """Unit of σ and v."""
    size: float
    """Size of ``small`` in the unit of the solution (SI, or image units)."""
    image: bool = False
    """Whether values are in units of a camera, which the solution has in ``unit``."""
    y_down: bool = False
    """Whether y of image coordinates is shown downwards, as in the files of its camera."""

    def sign(self, component: str) -> float:
        """Return the factor from a component of an image point in memory to the one shown."""
        return -1.0 if self.y_down and component == "y" else 1.0

    @property
    def further_decimals(self) -> int:
        """Decimals that a value has more than σ and v to show as much; 0 for the same unit."""
        if self.image or not self.unit:
            return 0
        unit = "arcsec" if self.unit == "dms" else self.unit
        whole = ANGLE[unit] if unit in ANGLE else LENGTH[unit]
        return ceil(log10(whole / self.size) - DECIMALS_TOLERANCE)

    def whole(self, *, turn: bool = False) -> Unit:
        """Return the unit of values; ``turn``: of angles of the whole circle."""
        if self.image or not self.unit:
            return Unit(self.unit)
        return unit_of(self.unit, turn=turn and (self.unit in ANGLE or self.unit == "dms"))

    @property
    def fine(self) -> Unit:
        """Unit of σ and v."""
        return Unit(self.small, self.size)


@dataclass(frozen=True, slots=True)
class Row:
    """One scalar observation after the adjustment, in the units of the solution.

    Image coordinates are those of the files of their camera, where y may point down.
    """

    number: int
    """Number of the row among all rows."""
    id: str
    """Id of the observation."""
    kind: str
    """Kind of the observation."""
    names: tuple[str, ...]
    """Frame, points and photo; empty for weighted unknowns, which their id identifies."""
    component: str
    """Component of the observation; empty if it has only one."""
    observed: float
    """Observed value."""
    residual: float
    """v = computed − observed."""
    sigma: float
    """A-priori standard deviation."""
    scale: Scale
    """Units in which the row is shown."""
    source: str
    """File and line, if the observation was read from a file."""
    points: tuple[str, ...] = ()
    """Points."""
    frame: str = ""
    """Frame of its own in which it was measured; empty: none."""
    photo: str = ""
    """Photo; empty: none."""
    sign: float = 1.0
    """Factor of test values and errors that are computed in the axes of the network: −1 for y and
    y0 of a camera whose files have y down, else 1."""
    turned: float | None = None
    """Adjusted value of a rotation, whose v is a turn; None: observed + v."""

    @property
    def kind_name(self) -> str:
        """Name of the kind as printed in reports."""
        return kind_name(self.kind, weighted=not self.names)

    @property
    def what(self) -> str:
        """Identification of the row: frame, points, photo and component."""
        if not self.names:
            # The id of a weighted unknown may already end in the component.
            return (
                self.id if self.id.endswith(f" {self.component}") else self.with_component(self.id)
            )
        return self.with_component(("/" if in_image_table(self.kind) else " ").join(self.names))

    @property
    def own_id(self) -> str:
        """Id; empty where `what` identifies the row without it."""
        return self.id if self.names and not in_image_table(self.kind) else ""

    @property
    def circular(self) -> bool:
        """Whether the row is an angle of the whole circle."""
        return bool(self.names) and observation_kind(self.kind).circular

    @property
    def adjusted(self) -> float:
        """Observed + v; a direction or azimuth lies in [0, 2π); a rotation is turned by v."""
        if self.turned is not None:
            return self.turned
        value = self.observed + self.residual
        return float(within(np.asarray(value))) if self.circular else value

    def with_component(self, name: str) -> str:
        """Return a name with the component, if there are several."""
        return f"{name} {self.component}".strip()


@dataclass(frozen=True)
class RowGroup:
    """Observations of one kind; image coordinates of one camera."""

    label: str
    """Kind of the observations, with the camera."""
    observations: int
    """Number of observations."""
    rows: Index
    """Rows of their scalar components."""
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

    @property
    def scalars(self) -> int:
        """Number of scalar components."""
        return len(self.rows)


class ReportRows:
    """Scalar observations and their residuals."""

    def __init__(self, equations: Equations, residuals: Array, units: Units) -> None:
        """Refer to the rows of ``equations``."""
        self.equations = equations
        self.units = units
        self.network = equations.network
        self._photos, self._points = tuple(self.network.photos), tuple(self.network.points)
        self._residuals = residuals

    def __len__(self) -> int:
        return self.equations.n_rows

    def scale(self, block: Block, i: int = 0) -> Scale:
        """Return the units of observation i of a block; in an image, those of its camera."""
        of = _calibrations(block)
        return observation_scale(block.unit, self.units) if of is None else self._scales[of[i]]

    @cached_property
    def _scales(self) -> list[Scale]:
        """The units of image coordinates, by number of the calibration."""
        return [image_scale(c) for c in self._cameras]

    @cached_property
    def _cameras(self) -> list[Camera]:
        """The cameras, by number of the calibration."""
        names = self.equations.unknowns["calibration"].names
        return [camera_of_calibration(self.network, name) for name in names]

    def signs(self) -> Array:
        """Return the sign of every row, (n_rows,), as `Row.sign`."""
        out = np.ones(len(self))
        for block in self.equations.blocks:
            of = _calibrations(block)
            if of is not None:
                down = np.array([c.y_down_in_files for c in self._cameras], dtype=bool)
                along_y = [c == "y" for c in block.components]
                out[_numbers(block)[down[of]][:, along_y]] = -1.0
            elif _calibrates(block):
                out[block.rows] = [row.sign for row in self._of_block(block, range(block.n))]
        return out

    def all(self) -> tuple[Row, ...]:
        """Return every scalar observation; tables, results and maps share them."""
        return self._every

    @cached_property
    def _every(self) -> tuple[Row, ...]:
        return tuple(
            row for block in self.equations.blocks for row in self._of_block(block, range(block.n))
        )

    @cached_property
    def identities(self) -> dict[str, list[str]]:
        """The columns that identify all rows, see `identities`."""
        return identity_columns(self._every)

    def at(self, numbers: Iterable[int]) -> list[Row]:
        """Return the rows with these numbers."""
        out: list[Row] = []
        for number in numbers:
            block = next(b for b in self.equations.blocks if b.rows.start <= number < b.rows.stop)
            i, component = divmod(int(number) - block.first_row, block.dimension)
            out.append(list(self._of_block(block, [i]))[component])
        return out

    def groups(self) -> list[RowGroup]:
        """Return the groups, by kind and camera, with their figures."""
        found: dict[str, list[tuple[Block, Array, Array, Array]]] = {}
        for block in self.equations.blocks:
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
            norm = v / sigma
            out.append(
                RowGroup(
                    label,
                    sum(_n_observations(p[0], p[3]) for p in parts),
                    np.concatenate([_numbers(p[0])[p[3]].ravel() for p in parts]),
                    (float(sigma.min()), float(sigma.max())),
                    float(np.sqrt(np.mean(v**2))),
                    float(np.sqrt(np.mean(norm**2))),
                    float(np.max(np.abs(norm))),
                    self.scale(block, int(np.argmax(rows))),
                )
            )
        return out

    def _labels(self, block: Block) -> Array:
        """Return the group of each observation of a block."""
        name = kind_name(block.kind, weighted=block.prior)
        of = _calibrations(block)
        if of is None or len(self.network.cameras) == 1:
            return np.full(block.n, name)
        by = "name" if len(self.network.cameras) <= MAX_CAMERAS_GROUPED_APART else "unit"
        labels = np.array([f"{name}, {getattr(c, by)}" for c in self._cameras])
        return np.asarray(labels[of])

    def _of_block(self, block: Block, rows: Sequence[int]) -> Iterator[Row]:
        if isinstance(block.ids, ImageIds):
            yield from self._of_images(block, block.ids, rows)
            return
        first, d = block.first_row, block.dimension
        for i in rows:
            ident, source = str(block.ids[i]), ""
            names: tuple[str, ...] = ()
            points, of_frame, of_photo = names, "", ""
            if not block.prior:
                observation = self.network.observations.get(ident)
                if observation is not None:
                    names, points = observation.names(), observation.points()
                    of_frame = next(iter(observation.frames()), "")
                    of_photo = next(iter(observation.photos()), "")
                    source = observation.source or ""
            scale = self.scale(block, i)
            turned = self._turned(block, i)
            for c in range(d):
                row = first + i * d + c
                component = block.component(i, c)
                sign = scale.sign(component)
                if _calibrates(block):
                    sign = self._cameras[block.variables[0][1][i]].sign_in_files(component)
                yield Row(
                    row,
                    ident,
                    block.kind,
                    names,
                    component,
                    sign * float(block.observed[i, c]),
                    sign * float(self._residuals[row]),
                    float(block.sigma[i, c]),
                    scale,
                    source,
                    points,
                    of_frame,
                    of_photo,
                    sign,
                    None if turned is None else float(turned[c]),
                )

    def _of_images(self, block: Block, ids: ImageIds, rows: Sequence[int]) -> Iterator[Row]:
        """Iterate over image points: no other kind has as many."""
        chosen = np.fromiter(rows, dtype=np.intp, count=len(rows))
        d, observed, sigma = block.dimension, block.observed, block.sigma
        own = _numbers(block)[chosen]
        photos, points = (block.variables[k][1][chosen].tolist() for k in (0, 2))
        every = zip(
            chosen.tolist(),
            photos,
            points,
            own.tolist(),
            observed[chosen].tolist(),
            self._residuals[own].tolist(),
            sigma[chosen].tolist(),
            strict=True,
        )
        for i, photo, point, numbers, values, residuals, sigmas in every:
            names = (self._photos[photo], self._points[point])
            scale, ident, source = self.scale(block, i), str(ids[i]), ids.source(i)
            for c in range(d):
                component = block.component(i, c)
                sign = scale.sign(component)
                yield Row(
                    numbers[c],
                    ident,
                    block.kind,
                    names,
                    component,
                    sign * values[c],
                    sign * residuals[c],
                    sigmas[c],
                    scale,
                    source,
                    names[1:],
                    "",
                    names[0],
                    sign,
                )

    def _turned(self, block: Block, i: int) -> Array | None:
        """Return the adjusted values of observation i if its errors are not added."""
        if block.composed is None:
            return None
        v = self._residuals[block.first_row + i * block.dimension + np.arange(block.dimension)]
        return np.asarray(block.select(np.array([i])).moved(v[None])[0])


def identity_columns(rows: Sequence[Row]) -> dict[str, list[str]]:
    """Return the columns that identify the observations, named as in tables of a project.

    Points stand in `POINT_COLUMNS`: a sight has a station and a target, an image point a point.
    """
    columns = {key: _ends(*key) for key in {(r.kind, len(r.points)) for r in rows}}
    ends = [dict(zip(columns[r.kind, len(r.points)], r.points, strict=False)) for r in rows]
    return {
        "id": [r.id for r in rows],
        "kind": [r.kind for r in rows],
        **{name: [own.get(name, "") for own in ends] for name in POINT_COLUMNS},
        "photo": [r.photo for r in rows],
        "frame": [r.frame for r in rows],
        "component": [r.component for r in rows],
        "observed": [r.scale.whole().exact(r.observed) for r in rows],
        "unit": [r.scale.unit for r in rows],
    }


def _ends(kind: str, count: int) -> tuple[str, ...]:
    """Return the columns of the points of an observation."""
    record = KINDS.get(kind)
    own = () if record is None else record.variables
    named = tuple(name for of, name in own if of == "point" and name in POINT_COLUMNS)
    if len(named) == count:
        return named
    return ("point",) if count == 1 else POINT_COLUMNS


def observation_scale(unit: ObservationUnit, units: Units) -> Scale:
    """Return the units of a kind of observation; `image_scale` does this for image coordinates."""
    if unit == "m":
        return Scale(units.length, units.sigma_length, LENGTH[units.sigma_length])
    if unit == "rad":
        return Scale(units.angle, units.sigma_angle, ANGLE[units.sigma_angle])
    return Scale("", "", 1.0)


def image_scale(camera: Camera) -> Scale:
    """Return the units of image coordinates; for millimetres, σ and v are in micrometres."""
    unit, down = camera.unit, camera.y_down_in_files
    small, size = ("um", 1e-3) if unit == "mm" else (unit, 1.0)
    return Scale(unit, small, size, image=True, y_down=down)


def all_digits(value: float, unit: str = "") -> str:
    """Write a value with all its digits in a unit; −0 is 0."""
    return write_quantity(value + 0.0, unit)


def kind_name(kind: str, *, weighted: bool = False) -> str:
    """Return the printed name of a kind; control by a weighted point has its own name."""
    record = KINDS.get(kind)
    if weighted and record is not None and record.by_axis:
        return "weighted coordinates"
    return kind.replace("_", " ")


def _calibrates(block: Block) -> bool:
    """Return whether the rows are given values of calibration parameters."""
    return block.prior and block.variables[0][0] == "calibration"


def _calibrations(block: Block) -> Index | None:
    """Return the calibrations (n,) whose cameras state the units; None: values in other units."""
    if block.prior or block.unit != "image":
        return None
    return dict(block.variables).get("calibration")


def _numbers(block: Block) -> Index:
    """Return the numbers of the rows of a block, (n, d)."""
    return np.arange(block.rows.start, block.rows.stop).reshape(block.observed.shape)


def _n_observations(block: Block, rows: Array) -> int:
    """Return the number of observations; control points have one row for each coordinate."""
    if block.by_axis:
        return len({ident for ident, on in zip(block.ids, rows, strict=True) if on})
    return int(rows.sum())
