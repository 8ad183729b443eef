"""iSAM2 over linear factors: what it holds, gives and refuses.

The factors are `LinearContainerFactor`s over plain vectors that start at zero, and iSAM2 never
relinearises them: that is the business of `factorgraph_adj.incremental.rows`, which knows what a
unit of each variable is worth. Its back-substitution is complete (no wildfire threshold), so that
δ is the solution of the linear system to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from ..solve.singular import SingularError
from ..solve.tree import SMALL, nested_dissection
from ..solve.triangular import upper_solve
from ..types import Array, Index

NEVER = 10**9
"""Updates between two relinearisations by iSAM2."""
MOST_BY_QR = 20
"""Keys up to which QR of the root gives their joint covariance sooner than the tree's method."""


class LinearTree:
    """An iSAM2 of linear factors."""

    def __init__(self, *, qr: bool) -> None:
        """Start empty.

        Args:
            qr: QR instead of Cholesky, which refuses networks of poor condition.
        """
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR" if qr else "CHOLESKY")
        parameters.enableRelinearization = False
        parameters.relinearizeSkip = NEVER
        parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
        self.isam = gtsam.ISAM2(parameters)
        self.qr = qr
        self.slots = 0
        """Slots given out so far; those of removed factors stay empty."""
        self.updates = 0
        """How often it has changed."""

    def copy(self) -> LinearTree:
        """Return a tree of its own."""
        out = LinearTree(qr=self.qr)
        out.isam, out.slots, out.updates = gtsam.ISAM2(self.isam), self.slots, self.updates
        return out

    def update(
        self,
        factors: Sequence[gtsam.NonlinearFactor],
        values: gtsam.Values,
        remove: Sequence[int] = (),
        late: Sequence[tuple[int, int]] = (),
    ) -> list[int]:
        """Add and remove factors; return the slots of those added.

        Args:
            factors: what is added.
            values: zero vectors for variables that are new.
            remove: slots; none of them twice.
            late: keys to be eliminated late, with their groups 1, 2 …; others come first.

        Raises:
            SingularError: a variable is not determined. The tree is useless then.
        """
        self.updates += 1
        graph = gtsam.NonlinearFactorGraph()
        for factor in factors:
            graph.add(factor)
        groups = None
        if late:
            groups = gtsam.KeyGroupMap()
            for key, group in late:
                groups.insert2(key, group)
        try:
            result = self.isam.update(graph, values, list(remove), groups)
        except RuntimeError as error:
            raise SingularError(str(error)) from None
        new = list(result.getNewFactorsIndices())
        self.slots += len(new)
        return new

    def linear(self) -> gtsam.GaussianFactorGraph:
        """Return all factors as they are."""
        return self.isam.getFactorsUnsafe().linearize(self.isam.getLinearizationPoint())

    def ordering(self) -> gtsam.Ordering:
        """Return an order of elimination with little fill: by nested dissection of a large one."""
        graph = self.linear()
        if len(graph.keyVector()) > SMALL:
            return nested_dissection(graph)
        return gtsam.Ordering.ColamdGaussianFactorGraph(graph)

    def delta(self, keys: Sequence[int]) -> Array:
        """Return δ of variables, one after the other."""
        if not keys:
            return np.zeros(0)
        return np.array(self.isam.getDelta().vector(keys)).ravel()

    def joint(self, keys: Sequence[int], *, arrived: bool = False) -> Array:
        """Return the joint covariance of variables, in their order.

        Args:
            keys: the variables.
            arrived: they are those of the last update. They then are in the root, from which QR
                has their joint conditional at once; elsewhere the tree's own method is quicker.

        Raises:
            SingularError: a variable is hardly determined.
        """
        if not keys:
            return np.zeros((0, 0))
        try:
            if not arrived or len(keys) > MOST_BY_QR:
                return np.array(self.isam.jointMarginalCovariance(list(keys)).fullMatrix())
            net = self.isam.jointBayesNet(list(keys), gtsam.EliminateQR)
        except RuntimeError as error:
            raise SingularError(str(error)) from None
        r = np.asfortranarray(net.matrix()[0])
        inverse = upper_solve(r, np.eye(len(r)))
        covariance = np.asarray(inverse @ inverse.T)
        # The net has an order of its own.
        first: dict[int, Index] = {}
        n = 0
        for i in range(net.size()):
            conditional = net.at(i)
            size = np.asarray(conditional.R()).shape[1]
            first[conditional.keys()[0]] = np.arange(n, n + size)
            n += size
        at = np.concatenate([first[k] for k in keys])
        return np.asarray(covariance[np.ix_(at, at)])
