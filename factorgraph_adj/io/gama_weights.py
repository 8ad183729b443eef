"""Weights of the observations of a ``.gkf`` file: ``stdev``, defaults, ``<cov-mat>``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..errors import InputError
from ..observations import AnyObservation, Correlated, Observation
from ..types import Array
from .gama_source import GamaSource
from .xml_tree import Element

DEFAULT_STDEV = {
    "distance": "distance-stdev",
    "s-distance": "distance-stdev",
    "direction": "direction-stdev",
    "angle": "angle-stdev",
    "z-angle": "zenith-angle-stdev",
    "azimuth": "azimuth-stdev",
}
"""Attribute of ``<points-observations>`` with the default standard deviation, by element."""


@dataclass(frozen=True)
class Pending:
    """An observation that waits for its weight."""

    element: Element
    """XML element of the observation."""
    units: tuple[float, ...]
    """Unit of the standard deviation of each component, in metres or radians."""
    sigma: float | None
    """Standard deviation from ``stdev``, ``dist`` or a default, in the file's unit."""
    make: Callable[[Array], Observation]
    """Function that makes the observation from its covariance (k, k), metres² or radians²."""


class GamaWeights:
    """The observations with their weights."""

    def __init__(self, source: GamaSource) -> None:
        """Start without observations."""
        self.source = source
        self.observations: list[AnyObservation] = []

    def weigh(self, group: Element, pending: Sequence[Pending | None]) -> None:
        """Give the observations of a group their weights and keep them; None is a faulty one."""
        matrices = list(group.all("cov-mat"))
        if len(matrices) > 1:
            self.source.add(matrices[1], "a second <cov-mat> of the same observations")
        whole = [p for p in pending if p is not None]
        if all(e.tag == "cov-mat" for e in group.children):
            self.source.add(group, f"<{group.tag}> has no observations")
        elif not matrices:
            for p in whole:
                self._independent(p)
        elif len(whole) == len(pending):
            self._correlated(matrices[0], whole)

    def _independent(self, p: Pending) -> None:
        tag = p.element.tag
        if tag in ("vec", "point"):
            self.source.add(p.element, f"<{tag}> needs a <cov-mat> in its group")
        elif p.sigma is None:
            other = "dist" if tag == "dh" else f"<points-observations {DEFAULT_STDEV[tag]}=…>"
            self.source.add(
                p.element, f"<{tag}> has no standard deviation: give stdev, {other} or a <cov-mat>"
            )
        else:
            sigma = float(p.sigma * p.units[0])
            variance = sigma * sigma  # a product, because powers beyond the range raise
            if 0 < variance < np.inf:
                self._keep(p.make, np.array([[variance]]))
            else:
                what = f"<{tag}> has a standard deviation of {p.sigma:g}, which has no variance"
                self.source.add(p.element, f"{what}: the number is out of range")

    def _correlated(self, element: Element, pending: list[Pending]) -> None:
        units = np.concatenate([p.units for p in pending])
        matrix = self._matrix(element, len(units))
        if matrix is None:
            return
        covariance = matrix * np.outer(units, units)
        ends = np.cumsum([len(p.units) for p in pending])
        rows = [np.arange(e - len(p.units), e) for p, e in zip(pending, ends, strict=True)]
        for members in _uncorrelated_groups(covariance, rows):
            together = np.concatenate([rows[i] for i in members])
            block = covariance[np.ix_(together, together)]
            if len(members) == 1:
                self._keep(pending[members[0]].make, block)
            else:
                own = [covariance[np.ix_(rows[i], rows[i])] for i in members]
                self._keep(_cluster([pending[i] for i in members], own), block)

    def _keep(self, make: Callable[[Array], AnyObservation], covariance: Array) -> None:
        try:
            self.observations.append(make(covariance))
        except InputError as error:
            self.source.problems.extend(error.problems)

    def _matrix(self, element: Element, size: int) -> Array | None:
        """Return the covariance (size, size) in the file's units; None if it is wrong."""
        before = len(self.source.problems)
        dim = self.source.count(element, "dim")
        band = self.source.count(element, "band")
        if len(self.source.problems) > before:
            return None
        expected = dim * (band + 1) - band * (band + 1) // 2
        numbers = np.zeros(0)
        wrong = ""
        try:
            numbers = np.array([float(w) for w in element.text.split()])
        except ValueError as error:
            wrong = str(error)
        if dim != size:
            wrong = f"dim is {dim}, but {size} values are observed"
        elif band >= dim:
            wrong = f"band is {band}; valid: 0 to {dim - 1}"
        elif not wrong and len(numbers) != expected:
            wrong = f"has {len(numbers)} numbers; dim {dim} and band {band} need {expected}"
        if wrong:
            self.source.add(element, f"<cov-mat>: {wrong}")
            return None
        matrix, first = np.zeros((dim, dim)), 0
        for i in range(dim):  # upper triangle within the band, row by row
            last = min(dim, i + band + 1)
            matrix[i, i:last] = matrix[i:last, i] = numbers[first : first + last - i]
            first += last - i
        if not np.all(np.isfinite(matrix)) or not np.all(np.diag(matrix) > 0):
            self.source.add(element, "<cov-mat> needs finite numbers and variances > 0")
            return None
        return matrix


def _cluster(members: list[Pending], own: list[Array]) -> Callable[[Array], Correlated]:
    """Return a function that makes a cluster from its joint covariance.

    ``own`` are the covariance matrices of the members, the diagonal blocks.
    """
    return lambda joint: Correlated(
        tuple(p.make(q) for p, q in zip(members, own, strict=True)), joint
    )


def _uncorrelated_groups(covariance: Array, rows: list[Array]) -> list[list[int]]:
    """Split observations into mutually uncorrelated groups."""
    owner = np.concatenate([np.full(len(r), i) for i, r in enumerate(rows)])
    i, j = np.nonzero(covariance)
    joined = coo_array((np.ones(len(i)), (owner[i], owner[j])), shape=(len(rows), len(rows)))
    number, group = connected_components(joined, directed=False)
    return [np.flatnonzero(group == g).tolist() for g in range(number)]
