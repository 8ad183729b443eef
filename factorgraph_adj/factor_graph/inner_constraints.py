"""Inner constraints of a free network as one linear factor of GTSAM."""

from __future__ import annotations

import gtsam
import numpy as np

from ..errors import DatumError
from ..graph.keys import KeyMap, insert, to_gtsam
from ..graph.variables import State
from ..solve.datum import FreeDatum, find_defects
from ..solve.free_network import datum_columns
from ..solve.linear import LinearisedEquations
from ..types import Array

STIFFEST = 2.0**20
"""Weight of the constraints, relative to that of the best observed coordinate."""


def inner_constraints(
    system: LinearisedEquations, diagonal: Array, origin: State, keys: KeyMap
) -> gtsam.LinearContainerFactor | None:
    """Return the inner constraints of a free network over its datum points.

        v = B_Dᵀ (x − x₀)_D / σ,    B_DᵀB_D = I

    B spans the motions that no observation notices at the start. As nothing pulls at them, v is
    zero at the minimum whatever σ is. With the weights P of all observations of a coordinate,
    1/σ² = `STIFFEST` max Σ P: σ² is what covariances have too much along these motions, and
    GTSAM's Cholesky takes no more.

    Args:
        system: the network, linearised at its start.
        diagonal: diagonal of N there, (n_columns,).
        origin: x₀.
        keys: keys of the variables.

    Returns:
        The factor; none where the observations notice every motion.

    Raises:
        DatumError: the datum points cannot carry the datum, or the parts of the network are not
            connected with one another.
    """
    equations, state = system.equations, system.state
    defects = [d for d in find_defects(system, state, diagonal, free=True) if d.motions.shape[1]]
    if not defects:
        return None
    if len(defects) > 1:
        raise DatumError(
            f"the observations connect the network in {len(defects)} parts, each without a datum: "
            "a free network is one",
            defect=sum(d.motions.shape[1] for d in defects),
            names=[],
        )
    (defect,) = defects
    columns = datum_columns(equations, defect.motions)
    rows = FreeDatum(defect.motions, columns).masked.T
    weight = float(np.sqrt(diagonal[columns].max(initial=0.0) * STIFFEST)) or 1.0
    unknowns, values, terms = equations.unknowns, gtsam.Values(), []
    for kind, number in unknowns.active():
        own = rows[:, unknowns.columns(kind, number)] * weight
        if own.any():
            scale = unknowns.graph_scale(kind, number)
            insert(values, unknowns, origin, [(kind, number)], [keys.at(kind, number)])
            part = to_gtsam(kind, own, state[kind][number], scale)
            terms.append((keys.at(kind, number), np.asfortranarray(part)))
    unit = gtsam.noiseModel.Unit.Create(len(rows))
    # A JacobianFactor takes three keys at most in Python; a conditional takes any number.
    conditional = gtsam.GaussianConditional(terms, 1, np.zeros(len(rows)), unit)
    return gtsam.LinearContainerFactor(conditional, values)
