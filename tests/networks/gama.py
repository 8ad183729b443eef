"""Networks of GNU Gama with the results that are published beside them, adjusted once.

What was found about the results: `tests/published/test_gama.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.graph.equations import Equations
from factorgraph_adj.graph.variables import State
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.network.network import Network
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array, Mask
from factorgraph_adj.units import GON
from tests.loaders.gama_result import GamaResult, read_gama_result
from tests.support.places import data_dir

NETWORKS = {
    "gama_3d_networks": (
        "2020-barta-phase_0-1TK",
        "2020-barta-phase_0-2TK",
        "2020-barta-phase_1-1TK",
        "2020-barta-phase_1-2TK",
        "local_3d",
        "tst-tetrahedron-2",
    ),
    "gama_levelling": (
        "mikhail-7.4",
        "mikhail-7.4-cov",
        "stroner-levelling-a",
        "stroner-levelling-b",
    ),
    "krumm_textbook": (
        "Baumann_Height_fix",
        "Benning82_Distance_fix",
        "Benning83_DistanceDirection_fix",
        "Benning88_Distance_fix",
        "Caspary",
        "Ghilani12_6_Height_fix",
        "Ghilani14_5_Distance_fix",
        "Ghilani15_4_Angle_fix",
        "Ghilani16_2_DistanceAngleAzimuth_fix",
        "Ghilani_Wolf_Distance_Angle",
        "Hoepke_Distance_free",
        "Krumm_Height_fix",
        "LotherStrehle_Direction1",
        "LotherStrehle_Direction2",
        "LotherStrehle_Direction4",
        "LotherStrehle_Direction7",
        "Niemeier_DistanceDirection_fix",
        "Niemeier_Height_fix1",
        "StrangBorre_Distance_fix",
        "Wolf_3D_Distance_fix",
        "Wolf_DistanceDirectionAngle_free",
    ),
}


WITHOUT_XML = "Ghilani21_1"
"""See test_ghilani_21_1.py."""


FOLDER = {name: folder for folder, names in NETWORKS.items() for name in names}


GAMA_STOPS = 0.5e-6
"""Metres: Gama iterates until linearisation matters less than 0.0005 mm in any observation."""


MICROMETRE_START = 1e-6
"""Relative: approximate coordinates are printed to 1 µm (±0.5), the shortest sights are 2 m."""


LINEARISED_ELSEWHERE = 1e-3
"""Relative: Gama's σ belong to the coordinates before its last step. Worst: σx of R in Ghilani
16.2, 11 µm by an azimuth of ±0.001″, is turned with it by 3 mm in 1640 m; next 0.14 ‰."""


@dataclass(frozen=True)
class Case:
    network: Network
    result: GamaResult
    solution: Solution

    @property
    def to_gama(self) -> float:
        """Gama's weights over ours: vᵀPv of Gama = this · ours."""
        return self.result.apriori**2

    @property
    def equations(self) -> Equations:
        return self.solution.equations

    def columns(self) -> list[int]:
        """Return our columns of the coordinates in Gama's covariance matrix."""
        table = self.equations.unknowns["point"]
        return [
            int(table.offset[table.number[name]]) + "xyz".index(axis)
            for name, axis in self.result.place
        ]

    def datum(self) -> Mask:
        """Return the columns of datum points, (n_columns,)."""
        unknowns = self.equations.unknowns
        out = np.zeros(unknowns.n_columns, dtype=bool)
        for point, first in zip(
            self.network.points.values(), unknowns["point"].offset, strict=True
        ):
            if point.datum and first >= 0:
                out[first : first + 3] = True
        return out & unknowns.free


def as_used(network: Network, result: GamaResult) -> Network:
    """Take out the observations that Gama left out."""
    used = iter(result.observations)
    expected = next(used)
    for ident, o in list(network.observations.items()):
        names = o.names()
        first = o.value if isinstance(o.value, float) else o.value[0]
        if expected.kind in ("direction", "angle", "azimuth", "zenith-angle"):
            first /= GON
        if names != expected.names or abs(first - expected.observed) > 1e-9 * abs(first):
            del network.observations[ident]
            continue
        for _ in range(1 if isinstance(o.value, float) else len(o.value)):
            expected = next(used, expected)
    return network


@cache
def solved(name: str) -> Case:
    path = data_dir(FOLDER[name]) / f"{name}.gkf"
    result = read_gama_result(path.with_suffix(".xml"))
    network = as_used(read_gama(path), result)
    variance = "a-posteriori" if result.used == "aposteriori" else "a-priori"
    return Case(network, result, adjust(network, variance=variance))


def state_at(equations: Equations, coordinates: dict[str, Array]) -> State:
    """Return the state at given coordinates, orientation unknowns as their directions say."""
    state = equations.unknowns.start()
    table = equations.unknowns["point"]
    for point, xyz in coordinates.items():
        row = table.number[point]
        state["point"][row] = np.where(np.isnan(xyz), state["point"][row], xyz)
    state["orientation"] = np.zeros_like(state["orientation"])
    for block in equations.blocks:
        if block.kind == "direction":
            v = block.evaluate(equations.network.frame, state).residual[:, 0]
            (of_set,) = (index for kind, index in block.variables if kind == "orientation")
            for i in range(len(state["orientation"])):
                state["orientation"][i] = np.angle(np.mean(np.exp(1j * v[of_set == i])))
    return state
