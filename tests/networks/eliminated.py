"""Adjusted networks of every sort of elimination, with their dense normal matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.solve.factorisation import Factorisation
from factorgraph_adj.types import Index
from tests.networks.adjusted import held_photos
from tests.networks.simulated import NETWORKS
from tests.networks.small_block import small_block
from tests.support.dense import DenseNormal
from tests.support.elimination_rules import everything_by_qr, rule

ROUNDING = 1e-16
"""Error of cofactors relative to σᵢσⱼ, for each unit of the condition of the scaled N."""
DIGITS = 1e-11
"""Error that is allowed however good the condition is."""


def held_height() -> fga.Network:
    """The combined block, in which a point that only photos see has a held height."""
    network = small_block(4)
    network.points["P9"] = replace(network.points["P9"], fixed=(False, False, True))
    return network


CASES: dict[str, Callable[[], fga.Network]] = {
    "photos": NETWORKS["aerial block"],
    "photos, free": NETWORKS["images, free"],
    "held photos": held_photos,
    "terrestrial": NETWORKS["gnss"],
    "terrestrial, free": NETWORKS["total station, free"],
    "mixed": NETWORKS["combined block"],
    "mixed, free": NETWORKS["combined block, free"],
    "mixed, own cameras": NETWORKS["own cameras"],
    "mixed, weighted photos": NETWORKS["weighted photos"],
    "mixed, held height": held_height,
}
CHOLESKY, QR = ", by Cholesky", ", by QR"
"""Ends of the names of cases whose fronts are factorised in the other way."""
ELIMINATED = (*CASES, *(n + QR for n in ("mixed", "photos, free")), "terrestrial" + CHOLESKY)
"""Names of all cases."""
FIRST_LAYER = tuple(n for n in CASES if not n.startswith("terrestrial"))
"""Cases with points that only cameras see."""


class Eliminated:
    """A solution, and its normal matrix with all columns."""

    def __init__(self, network: fga.Network) -> None:
        """Adjust the network."""
        self.solution = fga.adjust(network)
        self.factor: Factorisation = self.solution.factor
        self.points: Index = self.factor.layers.point_columns
        """Columns of the points that only cameras see, (p, 3)."""
        self.dense = DenseNormal.of(self.solution)
        free = self.dense.free
        self.others: Index = np.setdiff1d(np.arange(len(free)), self.points)
        """All other columns."""
        n = self.dense.matrix[np.ix_(free, free)]
        root = np.sqrt(np.diag(n))
        condition = float(np.linalg.cond(n / np.outer(root, root)))
        self.rounding = max(ROUNDING * condition, DIGITS)
        """Error of cofactors that rounding explains, relative to σᵢσⱼ."""


@cache
def eliminated(name: str) -> Eliminated:
    """Return a case."""
    if name.endswith(QR):
        with everything_by_qr():
            return Eliminated(CASES[name.removesuffix(QR)]())
    if name.endswith(CHOLESKY):
        with rule(max_qr_variables=0):
            return Eliminated(CASES[name.removesuffix(CHOLESKY)]())
    return Eliminated(CASES[name]())
