"""Observation equations of a network once more, in extended precision, and Newton's steps.

Nothing here uses the library's formulas, partial derivatives or solvers. Columns of unknowns are
numbered as the library numbers them, so that movements can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    ImagePoint,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.types import Array
from tests.support.arrivals import items

from .dual import LONG, Dual, stacked, total, turned

RANK = 1e-13
"""Singular values of the scaled partials, relative to the largest, that count as zero."""
FAR = 1e-4
"""Movement in units of σ by which the second derivatives are found."""
SMALL = 1e-9
"""Negative eigenvalue of the second derivatives, relative to the largest one, that is rounding."""
STEPS = 40
"""Largest number of Newton's steps."""
REST, ALMOST = 1e-7, 0.01
"""Newton's step in units of σ, and relative to the whole way, that is small enough."""
LOST = 1e3
"""Movement in units of σ beyond which there is no minimum near the solution."""


class Variables:
    """All variables of a network as functions of the movement of its columns.

    Points and projection centres are movements from where they are in the solution, so that
    differences of large coordinates are exact.
    """

    def __init__(self, solution: Solution) -> None:
        """Begin at the values of a solution."""
        self.solution = solution
        self.unknowns = solution.equations.unknowns
        self.n = self.unknowns.n_columns
        self.state = {k: np.asarray(v, dtype=LONG) for k, v in solution.state.items()}

    def moved(self, movement: Array) -> dict[str, Dual]:
        """Return the variables after a movement (n_columns,), by kind."""
        return {kind: self._of_kind(kind, movement) for kind in self.state}

    def _of_kind(self, kind: str, movement: Array) -> Dual:
        table = self.unknowns[kind]  # type: ignore[index]
        values = self.state[kind]
        out = Dual(values.copy(), np.zeros((*values.shape, self.n), LONG))
        if kind == "point":
            out.value[:] = 0.0
        elif kind == "pose":
            out.value[:, 9:] = 0.0
        for i, (first, size) in enumerate(zip(table.offset, table.size, strict=True)):
            if first < 0:
                continue
            if kind != "pose":
                for j in range(size):
                    out.value[i, j] += movement[first + j]
                    out.slope[i, j, first + j] = 1.0
                continue
            omega = Dual(movement[first : first + 3], np.zeros((3, self.n), LONG))
            for j in range(3):
                omega.slope[j, first + j] = 1.0
                out.value[i, 9 + j] += movement[first + 3 + j]
                out.slope[i, 9 + j, first + 3 + j] = 1.0
            for a, row in enumerate(turned(values[i, :9].reshape(3, 3), omega)):
                for b, element in enumerate(row):
                    out.value[i, 3 * a + b] = element.value
                    out.slope[i, 3 * a + b] = element.slope
        return out

    def line(
        self, x: dict[str, Dual], a: tuple[str, int, int], b: tuple[str, int, int]
    ) -> list[Dual]:
        """Return the components of b − a, each by kind, number and first component."""
        (kind, i, first), (other, j, second) = a, b
        return [
            x[other][j, second + k]
            - x[kind][i, first + k]
            + (self.state[other][j, second + k] - self.state[kind][i, first + k])
            for k in range(3)
        ]


@dataclass(frozen=True)
class Rows:
    """Residuals v = computed − observed divided by σ, and their derivatives."""

    v: Array
    """Residuals, (n,)."""
    a: Array
    """Derivatives, (n, n_columns)."""

    @property
    def gradient(self) -> Array:
        """Aᵀv, (n_columns,)."""
        return np.asarray(self.a.T @ self.v)

    @property
    def square(self) -> float:
        """Return vᵀv."""
        return float(self.v @ self.v)


def rows_at(solution: Solution, variables: Variables, movement: Array) -> Rows:
    """Return all rows after a movement of the unknowns (n_columns,)."""
    x = variables.moved(movement)
    network = solution.network
    parts = [_of_readings(network, variables, x), *_priors(variables, x)]
    v = np.concatenate([p.value.ravel() for p in parts])
    a = np.concatenate([p.slope.reshape(-1, variables.n) for p in parts])
    a[:, ~variables.unknowns.free] = 0.0
    return Rows(v, a)


def _of_readings(network: Network, variables: Variables, x: dict[str, Dual]) -> Dual:
    number = {kind: variables.unknowns[kind].number for kind in x}  # type: ignore[index]
    out: list[Dual] = []
    for o in items(network):
        if isinstance(o, ImagePoint):
            out += _image(network, o, number, variables, x)
            continue
        i, j = number["point"][o.station], number["point"][o.target]  # type: ignore[attr-defined]
        q = variables.line(x, ("point", i, 0), ("point", j, 0))
        if isinstance(o, GnssVector):
            sigma = np.sqrt(np.diag(np.asarray(o.covariance)))
            out += [_weighted(q[k] - o.value[k], sigma[k]) for k in range(3)]
            continue
        meter = None
        if isinstance(o, SlopeDistance | HorizontalDistance) and o.instrument:
            meter = x["edm"][number["edm"][o.instrument]]
        q2 = q
        if isinstance(o, HorizontalAngle):
            q2 = variables.line(x, ("point", i, 0), ("point", number["point"][o.target2], 0))
        out.append(_terrestrial(o, q, q2, number, x, meter))
    return stacked(out)


def _terrestrial(
    o: object,
    q: list[Dual],
    q2: list[Dual],
    number: dict[str, dict[str, int]],
    x: dict[str, Dual],
    meter: Dual | None,
) -> Dual:
    level2 = q[0] * q[0] + q[1] * q[1]
    observed = LONG(o.value)  # type: ignore[attr-defined]
    sigma = _sigma(o)
    if isinstance(o, SlopeDistance | HorizontalDistance):
        level = isinstance(o, HorizontalDistance)  # a kind of slope distance
        length = (level2 if level else level2 + q[2] * q[2]).root()
        if meter is not None:
            length = (meter[0] + 1.0) * length + meter[1]
        return _weighted(length - observed, sigma)
    if isinstance(o, HeightDifference):
        return _weighted(q[2] - observed, sigma)
    if isinstance(o, ZenithAngle):
        return _weighted(_wrapped(level2.root().angle(q[2]) - observed), sigma)
    azimuth = q[0].angle(q[1])
    if isinstance(o, Direction):
        azimuth = azimuth - x["orientation"][number["orientation"][f"{o.station}/{o.set}"], 0]
    elif isinstance(o, HorizontalAngle):
        azimuth = q2[0].angle(q2[1]) - azimuth
    else:
        assert isinstance(o, Azimuth), o
    return _weighted(_wrapped(azimuth - observed), sigma)


def _image(
    network: Network,
    o: ImagePoint,
    number: dict[str, dict[str, int]],
    variables: Variables,
    x: dict[str, Dual],
) -> list[Dual]:
    """Return x and y by the collinearity equations, axes x right, y down, z forward."""
    pose = x["pose"][number["pose"][o.photo]]
    key = o.photo if o.photo in number["calibration"] else network.photos[o.photo].camera
    k = x["calibration"][number["calibration"][key]]
    photo, point = number["pose"][o.photo], number["point"][o.point]
    d = variables.line(x, ("pose", photo, 9), ("point", point, 0))
    p = [total(*(pose[3 * i + j] * d[i] for i in range(3))) for j in range(3)]
    lens = network.cameras[network.photos[o.photo].camera].lens
    place = {name: i for i, name in enumerate(lens.names)}
    c, x0, y0 = (k[place[n]] for n in ("c", "x0", "y0"))
    sigma = np.broadcast_to(np.asarray(o.sigma, dtype=float), 2)
    return [
        _weighted(x0 + c * (p[0] / p[2]) - o.x, sigma[0]),
        _weighted(y0 - c * (p[1] / p[2]) - o.y, sigma[1]),
    ]


def _sigma(o: object) -> float:
    """Return σ = constant + ppm·10⁻⁶ S of a length, otherwise its constant."""
    sigma = o.sigma  # type: ignore[attr-defined]
    if isinstance(sigma, StandardDeviation):
        return sigma.constant + 1e-6 * sigma.ppm * o.value  # type: ignore[attr-defined,no-any-return]
    return float(sigma)


def _weighted(v: Dual, sigma: float) -> Dual:
    return v * (LONG(1) / LONG(sigma))


def _wrapped(v: Dual) -> Dual:
    turn = 2 * LONG("3.14159265358979323846264338327950288")
    return Dual(v.value - turn * np.round(v.value / turn), v.slope)


def _priors(variables: Variables, x: dict[str, Dual]) -> list[Dual]:
    """Return rows of weighted components: (value − given value) / σ; not of attitudes."""
    out = []
    for kind, table in ((k, variables.unknowns[k]) for k in x):  # type: ignore[index]
        shift = 6 if kind == "pose" else 0
        for i, j in zip(*np.nonzero(np.isfinite(table.sigma) & table.free), strict=True):
            v = x[kind][i, j + shift] - LONG(table.values[i, j + shift])
            if kind in ("point", "pose"):
                v = v + variables.state[kind][i, j + shift]
            out.append(_weighted(v, table.sigma[i, j])[None])
    return out


@dataclass(frozen=True)
class Nearest:
    """The minimum near a solution."""

    way: float
    """Distance of the solution from it, √(dxᵀN dx)."""
    unknown: float
    """Largest distance of an unknown from it, relative to its own σ; in a free network `way`."""
    curvature: float
    """Smallest eigenvalue of the second derivatives of vᵀPv/2 at the solution, relative to N."""
    defect: int
    """Number of columns that the rows do not determine."""
    found: bool
    """Whether Newton's steps came to rest."""


def nearest(solution: Solution) -> Nearest:
    """Follow Newton's steps from a solution to its minimum.

    Steps are taken in coordinates y with x = W y and WᵀN W = I at the solution, in which every
    unknown and every function of the unknowns has its own σ as unit.
    """
    variables = Variables(solution)
    zero = np.zeros(variables.n, LONG)
    here = rows_at(solution, variables, zero)
    free = variables.unknowns.free
    scale = np.sqrt(np.sum(np.asarray(here.a, dtype=float) ** 2, axis=0))
    scale[~free | (scale == 0.0)] = 1.0
    _, s, vt = np.linalg.svd(np.asarray(here.a / scale, dtype=float), full_matrices=False)
    kept = s > RANK * s[0]
    w = np.asarray((vt[kept] / s[kept, None]).T / scale[:, None], dtype=LONG)
    n = w.shape[1]

    def gradient(y: Array) -> Array:
        return np.asarray(w.T @ rows_at(solution, variables, w @ y).gradient)

    second = np.empty((n, n))
    for j in range(n):
        ahead = np.zeros(n, LONG)
        ahead[j] = FAR
        second[:, j] = np.asarray((gradient(ahead) - gradient(-ahead)) / (2 * FAR), dtype=float)
    second = (second + second.T) / 2
    curved = np.linalg.eigvalsh(second)
    curvature = float(curved[0]) if curved[0] < -SMALL * curved[-1] else abs(float(curved[0]))
    y = np.zeros(n, LONG)
    found = False
    for _ in range(STEPS):
        step = np.linalg.solve(second, np.asarray(gradient(y), dtype=float))
        y = y - step
        size = float(np.linalg.norm(step))
        way = float(np.linalg.norm(np.asarray(y, dtype=float)))
        if not np.isfinite(size) or way > LOST:
            break
        if size < max(REST, ALMOST * way):
            found = True
            break
    dx = np.asarray(w @ y, dtype=float)
    sigma = np.sqrt(np.sum(np.asarray(w, dtype=float) ** 2, axis=1))
    way = float(np.linalg.norm(np.asarray(y, dtype=float)))
    defect = int(free.sum()) - n
    on = free & (sigma > 0)
    unknown = way if defect else float(np.max(np.abs(dx[on]) / sigma[on], initial=0.0))
    return Nearest(way, unknown, curvature, defect, found)
