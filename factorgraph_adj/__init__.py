"""Combined adjustment of terrestrial and photogrammetric observations in one factor graph.

import factorgraph_adj as fga
solution = fga.adjust(fga.read_project("project.toml"))
"""

from .errors import AdjustmentError, ApproximationError, DatumError, InputError
from .frames import GeocentricFrame, LocalFrame, TopocentricFrame
from .graph.build import build_graph
from .io.bal import read_bal
from .io.gama import read_gama
from .io.project import read_project
from .io.write_project import write_project
from .network import Network
from .quality.reliability import reliability
from .quality.solution import Solution
from .report.text import protocol
from .solve.batch import adjust
from .stochastic import StandardDeviation

__all__ = [
    "AdjustmentError",
    "ApproximationError",
    "DatumError",
    "GeocentricFrame",
    "InputError",
    "LocalFrame",
    "Network",
    "Solution",
    "StandardDeviation",
    "TopocentricFrame",
    "adjust",
    "build_graph",
    "protocol",
    "read_bal",
    "read_gama",
    "read_project",
    "reliability",
    "write_project",
]
