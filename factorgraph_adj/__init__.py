"""Combined adjustment of terrestrial and photogrammetric observations in one factor graph.

import factorgraph_adj as fga
solution = fga.adjust(fga.read("project.toml"))
"""

from .errors import AdjustmentError, ApproximationError, DatumError, InputError
from .frames import GeocentricFrame, LocalFrame, TopocentricFrame
from .graph.build import build_graph
from .incremental.adjustment import IncrementalAdjustment
from .io.bal import read_bal
from .io.gama import read_gama
from .io.project import read_project
from .io.readers import read
from .io.write_project import write_project
from .network.network import Network
from .network.selection import without
from .planning.candidates import Candidate
from .planning.plan import plan
from .planning.propose import propose
from .planning.spare import spare
from .quality.check_points import check_points
from .quality.datum_change import s_transform
from .quality.ellipses import error_ellipse, error_ellipsoid
from .quality.exclusion import exclude_insignificant
from .quality.prediction import predict
from .quality.relative import distance_precision
from .quality.reliability import reliability
from .quality.robust import robust
from .quality.snooping import snoop
from .quality.systematic import significance
from .quality.variance_components import variance_components
from .report.options import Provenance, ReportOptions
from .report.text import protocol
from .solve.batch import adjust
from .solve.solution import Solution
from .stochastic import StandardDeviation

__all__ = [
    "AdjustmentError",
    "ApproximationError",
    "Candidate",
    "DatumError",
    "GeocentricFrame",
    "IncrementalAdjustment",
    "InputError",
    "LocalFrame",
    "Network",
    "Provenance",
    "ReportOptions",
    "Solution",
    "StandardDeviation",
    "TopocentricFrame",
    "adjust",
    "build_graph",
    "check_points",
    "distance_precision",
    "error_ellipse",
    "error_ellipsoid",
    "exclude_insignificant",
    "plan",
    "predict",
    "propose",
    "protocol",
    "read",
    "read_bal",
    "read_gama",
    "read_project",
    "reliability",
    "robust",
    "s_transform",
    "significance",
    "snoop",
    "spare",
    "variance_components",
    "without",
    "write_project",
]
