"""Standard deviations of observations as numbers, for formats that have one in each line."""

from __future__ import annotations

from ...approximate.rounds import reach
from ...graph.equations import compile_rows
from ...graph.weights import weighed_where_known
from ...network.network import Network


def sigmas_of(network: Network) -> dict[str, float]:
    """Return σ of the first component by id of observation, at the coordinates of the network.

    Coordinates are given or approximate ones that observations determine; σ is NaN where it
    depends on others.
    """
    equations = compile_rows(network)
    state, _ = reach(equations)
    out: dict[str, float] = {}
    for block in equations.blocks:
        if block.prior or block.lens is not None:
            continue
        found = weighed_where_known(network, block, state)
        out |= dict(zip(found.ids, found.sigma[:, 0].tolist(), strict=True))
    return out
