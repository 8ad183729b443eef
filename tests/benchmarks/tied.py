"""Photos that total stations tie together, against independent solutions of sparse equations.

``python -m tests.benchmarks.tied PHOTOS STATIONS`` prints one line of JSON.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import SuperLU, splu

from factorgraph_adj.quality.reliability import Reliability
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.types import Array, Index

from .blocks import simulate_tied
from .worker import Measured, adjusted

COMPARED = 40
"""Number of points, photos and stations whose covariances are compared, of each kind."""
ROWS = 100
"""Number of redundancy numbers that are compared, in each block of observations."""


@dataclass(frozen=True)
class Tied:
    """What the adjustment took, and how far it is from the independent solutions."""

    measured: Measured
    """Time and memory."""
    in_fronts: bool
    """Whether the terrestrial side is in the third layer."""
    fronts: int
    """Number of fronts."""
    largest_front: int
    """Nodes of the largest front."""
    width: int
    """Columns of a node."""
    covariances: float
    """Largest difference of a covariance, relative to the standard deviations of its unknowns."""
    redundancy_numbers: float
    """Largest difference of a redundancy number."""


def sparse_rows(system: LinearisedEquations) -> csr_array:
    """Return the whitened partials A of all observations, (n_rows, n_columns).

    The network has no clusters and no factors of a user.
    """
    rows, columns, values = [], [], []
    for lb in system.blocks:
        first = np.arange(lb.block.rows.start, lb.block.rows.stop).reshape(lb.block.observed.shape)
        for offset, a in zip(lb.offsets, lb.a, strict=True):
            on = np.flatnonzero(offset >= 0)
            if not len(a) or not len(on):
                continue
            part = a[on]
            rows.append(np.broadcast_to(first[on][:, :, None], part.shape).ravel())
            column = offset[on][:, None, None] + np.arange(part.shape[2])
            columns.append(np.broadcast_to(column, part.shape).ravel())
            values.append(part.ravel())
    places = np.concatenate(rows), np.concatenate(columns)
    shape = system.equations.n_rows, system.unknowns.n_columns
    return csr_array(coo_array((np.concatenate(values), places), shape=shape))


class SparseNormal:
    """Independent solutions of AᵀA x = y by SuperLU, scaled to a unit diagonal."""

    def __init__(self, system: LinearisedEquations) -> None:
        """Factorise."""
        self.a = sparse_rows(system)
        self.free = np.flatnonzero(system.unknowns.free)
        a = csc_array(self.a[:, self.free])
        self.scale = 1.0 / np.sqrt(np.asarray(a.multiply(a).sum(axis=0)).ravel())
        a = csc_array(a.multiply(self.scale[None, :]))
        self.factor: SuperLU = splu(
            csc_array(a.T @ a),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def solve(self, y: Array) -> Array:
        """Return N⁻¹ y for y (n_columns, k); held components are zero."""
        out = np.zeros_like(y)
        scale = self.scale[:, None]
        out[self.free] = scale * self.factor.solve(np.ascontiguousarray(scale * y[self.free]))
        return out

    def covariance(self, columns: Index) -> Array:
        """Return the covariance of some unknowns, (k, k)."""
        y = np.zeros((self.a.shape[1], len(columns)))
        y[columns, np.arange(len(columns))] = 1.0
        return self.solve(y)[columns]

    def redundancy_numbers(self, rows: Index) -> Array:
        """Return 1 − aᵢ N⁻¹ aᵢᵀ of some rows, (k,)."""
        a = self.a[rows].toarray()
        return np.asarray(1.0 - np.einsum("ij,ji->i", a, self.solve(a.T)))


def differences(rel: Reliability, seed: int) -> tuple[float, float]:
    """Return the largest differences of covariances and redundancy numbers, as in `Tied`."""
    solution = rel.solution
    assert solution.variance == "a-priori"
    system = solution.normal().system
    independent = SparseNormal(system)
    rng = np.random.default_rng(seed)
    worst = 0.0
    unknowns = solution.equations.unknowns
    for kind in ("point", "pose", "orientation", "calibration"):
        table = unknowns[kind]
        adjusted_ = np.flatnonzero(table.offset >= 0)
        chosen = set(rng.choice(adjusted_, min(COMPARED, len(adjusted_)), replace=False).tolist())
        if kind == "point":  # stations are the last points
            chosen |= set(adjusted_[-COMPARED:].tolist())
        for number in sorted(chosen):
            wanted = independent.covariance(unknowns.columns(kind, number))
            found = solution.variable_covariance((kind, table.names[number]))
            sigma = np.sqrt(np.diag(wanted))
            sigma[sigma == 0] = 1.0
            worst = max(worst, float(np.max(np.abs(found - wanted) / np.outer(sigma, sigma))))
    off = 0.0
    for lb in system.blocks:
        rows = np.arange(lb.block.rows.start, lb.block.rows.stop)
        rows = np.sort(rng.choice(rows, min(ROWS, len(rows)), replace=False))
        difference = rel.redundancy_numbers[rows] - independent.redundancy_numbers(rows)
        off = max(off, float(np.max(np.abs(difference))))
    return worst, off


def main(photos: str, stations: str) -> Tied:
    """Adjust, and compare."""
    measured, rel = adjusted(lambda: simulate_tied(1, photos=int(photos), stations=int(stations)))
    fronts = rel.solution.factor.fronts
    assert fronts is not None
    sizes = [f.size for f in fronts.fronts]
    return Tied(
        measured,
        not rel.solution.run.solver.layers.by_qr,
        len(sizes),
        max(sizes),
        fronts.pattern.width,
        *differences(rel, 1),
    )


if __name__ == "__main__":
    print(json.dumps(asdict(main(*sys.argv[1:]))))
