"""Combined adjustment of terrestrial and photogrammetric observations in one factor graph.

import factorgraph_adj as fga
solution = fga.adjust(fga.read("project.toml"))

A public name is imported at its first use, so that a program loads only the modules that it uses.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .block_orientation.dlt import dlt
    from .block_orientation.orient import orient
    from .crs.similarity import SevenParameters
    from .crs.system import ReferenceSystem
    from .epochs.blocks import block_motion
    from .epochs.congruence import congruence
    from .errors import AdjustmentError, ApproximationError, DatumError, InputError
    from .export.arrays import covariance_array, to_xarray
    from .export.dxf import write_dxf
    from .export.exports import write
    from .export.geojson import write_geojson
    from .export.geopackage import write_geopackage
    from .export.kml import write_kml
    from .export.ply import write_ply
    from .export.results import results_schema, write_results
    from .factor_graph.build import build_graph
    from .factor_graph.factor_tests import FactorTests
    from .factor_graph.isam import Isam
    from .field.faces import reduce_faces
    from .field.readings import FaceReading
    from .frames import GeocentricFrame, LocalFrame, TopocentricFrame
    from .incremental.adjustment import IncrementalAdjustment
    from .io.bal import read_bal
    from .io.gama import read_gama
    from .io.gnss.dynaml import read_dynaml
    from .io.gnss.gvx import read_gvx
    from .io.gnss.sinex import read_sinex
    from .io.gnss.write_dynaml import write_dynaml
    from .io.gnss.write_gvx import write_gvx
    from .io.gnss.write_sinex import write_sinex
    from .io.photogrammetry.aicon import read_aicon
    from .io.photogrammetry.bundler import read_bundler
    from .io.photogrammetry.colmap import read_colmap
    from .io.photogrammetry.colmap_write import write_colmap
    from .io.photogrammetry.dbat import read_dbat
    from .io.photogrammetry.metashape import read_metashape
    from .io.photogrammetry.metashape_write import write_metashape
    from .io.photogrammetry.micmac import read_micmac
    from .io.photogrammetry.opencv import read_opencv, write_opencv
    from .io.photogrammetry.openmvg import read_openmvg
    from .io.photogrammetry.opensfm import read_opensfm
    from .io.photogrammetry.opf import read_opf
    from .io.photogrammetry.opf_write import write_opf
    from .io.project import read_project
    from .io.readers import read
    from .io.solution_file import load_solution
    from .io.survey.accuracies import Accuracies
    from .io.survey.columns import read_columns
    from .io.survey.comp3d import read_comp3d
    from .io.survey.gsi import read_gsi
    from .io.survey.jag3d import read_jag3d
    from .io.survey.jobxml import read_jobxml
    from .io.survey.landxml import read_landxml
    from .io.survey.lgc2 import read_lgc2
    from .io.survey.mmvii import read_mmvii
    from .io.survey.sdr33 import read_sdr33
    from .io.survey.star_net import read_star_net
    from .io.survey.star_net_options import StarNetOptions
    from .io.survey.write_jag3d import write_jag3d
    from .io.survey.write_landxml import write_landxml
    from .io.survey.write_star_net import write_star_net
    from .io.write_project import write_project
    from .models.registry import register_lens
    from .models.unknown import UnknownKind
    from .models.variables import register_unknown
    from .network.entities import Camera, Parameter, Photo, Point
    from .network.from_grid import from_grid
    from .network.join import join
    from .network.network import Network
    from .network.own_datum import vectors_in_own_datum
    from .network.selection import without
    from .observations.airborne import (
        AntennaVector,
        NavigationAttitude,
        PhotoAngle,
        PhotoAttitude,
        PhotoBase,
        PhotoRange,
    )
    from .observations.base import Observation
    from .observations.correlated import Correlated
    from .observations.far_directions import GyroAzimuth, PhotoSight, PhotoTilt
    from .observations.frame_sights import FrameDirection, FrameDistance, FrameZenith
    from .observations.image import ImagePoint
    from .observations.in_frames import FrameCoordinate, FrameVector
    from .observations.positions import ControlPoint, GnssPosition, GnssVector, PhotoPosition
    from .observations.registry import ObservationKind, register_observation
    from .observations.relative import RelativePosition, RelativeRotation
    from .observations.strips import StripCoordinate
    from .observations.terrestrial import (
        AstronomicLatitude,
        AstronomicLongitude,
        Azimuth,
        Direction,
        HeightDifference,
        HorizontalAngle,
        HorizontalDistance,
        SlopeDistance,
        VerticalAngle,
        ZenithAngle,
    )
    from .observations.vertical import LevelHeight, ProfileHeight
    from .parts.adjust import adjust_parts
    from .parts.network import adjust
    from .parts.part import Part
    from .parts.result import PartsSolution
    from .planning.candidates import Candidate
    from .planning.plan import plan
    from .planning.propose import propose
    from .planning.spare import find_sparable
    from .quality.causes.search import causes
    from .quality.check_points import check_points
    from .quality.datum_change import s_transform
    from .quality.ellipses import error_ellipse, error_ellipsoid
    from .quality.exclusion import exclude_insignificant
    from .quality.lines import adjusted_lines
    from .quality.prediction import predict
    from .quality.relative import distance_precision
    from .quality.reliability import reliability
    from .quality.robust import robust_adjust
    from .quality.snooping import snoop
    from .quality.systematic import significance
    from .quality.variance_components import estimate_variance_components
    from .report.html.write import write_report
    from .report.options import Provenance, ReportOptions
    from .report.text import protocol
    from .solve.batch import determined_part, memory_needed
    from .solve.grid import (
        GridCoordinates,
        GridPhotos,
        grid_coordinates,
        grid_photos,
        wgs84_coordinates,
    )
    from .solve.solution import Solution
    from .stochastic import StandardDeviation
    from .triangulation.models import as_models
    from .triangulation.relative import relative_model
    from .validate.preliminary.finding import Finding
    from .validate.preliminary.search import preliminary
    from .version import __version__

__all__ = [
    "Accuracies",
    "AdjustmentError",
    "AntennaVector",
    "ApproximationError",
    "AstronomicLatitude",
    "AstronomicLongitude",
    "Azimuth",
    "Camera",
    "Candidate",
    "ControlPoint",
    "Correlated",
    "DatumError",
    "Direction",
    "FaceReading",
    "FactorTests",
    "Finding",
    "FrameCoordinate",
    "FrameDirection",
    "FrameDistance",
    "FrameVector",
    "FrameZenith",
    "GeocentricFrame",
    "GnssPosition",
    "GnssVector",
    "GridCoordinates",
    "GridPhotos",
    "GyroAzimuth",
    "HeightDifference",
    "HorizontalAngle",
    "HorizontalDistance",
    "ImagePoint",
    "IncrementalAdjustment",
    "InputError",
    "Isam",
    "LevelHeight",
    "LocalFrame",
    "NavigationAttitude",
    "Network",
    "Observation",
    "ObservationKind",
    "Parameter",
    "Part",
    "PartsSolution",
    "Photo",
    "PhotoAngle",
    "PhotoAttitude",
    "PhotoBase",
    "PhotoPosition",
    "PhotoRange",
    "PhotoSight",
    "PhotoTilt",
    "Point",
    "ProfileHeight",
    "Provenance",
    "ReferenceSystem",
    "RelativePosition",
    "RelativeRotation",
    "ReportOptions",
    "SevenParameters",
    "SlopeDistance",
    "Solution",
    "StandardDeviation",
    "StarNetOptions",
    "StripCoordinate",
    "TopocentricFrame",
    "UnknownKind",
    "VerticalAngle",
    "ZenithAngle",
    "__version__",
    "adjust",
    "adjust_parts",
    "adjusted_lines",
    "as_models",
    "block_motion",
    "build_graph",
    "causes",
    "check_points",
    "congruence",
    "covariance_array",
    "determined_part",
    "distance_precision",
    "dlt",
    "error_ellipse",
    "error_ellipsoid",
    "estimate_variance_components",
    "exclude_insignificant",
    "find_sparable",
    "from_grid",
    "grid_coordinates",
    "grid_photos",
    "join",
    "load_solution",
    "memory_needed",
    "orient",
    "plan",
    "predict",
    "preliminary",
    "propose",
    "protocol",
    "read",
    "read_aicon",
    "read_bal",
    "read_bundler",
    "read_colmap",
    "read_columns",
    "read_comp3d",
    "read_dbat",
    "read_dynaml",
    "read_gama",
    "read_gsi",
    "read_gvx",
    "read_jag3d",
    "read_jobxml",
    "read_landxml",
    "read_lgc2",
    "read_metashape",
    "read_micmac",
    "read_mmvii",
    "read_opencv",
    "read_openmvg",
    "read_opensfm",
    "read_opf",
    "read_project",
    "read_sdr33",
    "read_sinex",
    "read_star_net",
    "reduce_faces",
    "register_lens",
    "register_observation",
    "register_unknown",
    "relative_model",
    "reliability",
    "results_schema",
    "robust_adjust",
    "s_transform",
    "significance",
    "snoop",
    "to_xarray",
    "vectors_in_own_datum",
    "wgs84_coordinates",
    "without",
    "write",
    "write_colmap",
    "write_dxf",
    "write_dynaml",
    "write_geojson",
    "write_geopackage",
    "write_gvx",
    "write_jag3d",
    "write_kml",
    "write_landxml",
    "write_metashape",
    "write_opencv",
    "write_opf",
    "write_ply",
    "write_project",
    "write_report",
    "write_results",
    "write_sinex",
    "write_star_net",
]

_MODULES = {
    "AdjustmentError": "errors",
    "ApproximationError": "errors",
    "AstronomicLatitude": "observations.terrestrial",
    "AstronomicLongitude": "observations.terrestrial",
    "Azimuth": "observations.terrestrial",
    "Camera": "network.entities",
    "Candidate": "planning.candidates",
    "ControlPoint": "observations.positions",
    "Correlated": "observations.correlated",
    "DatumError": "errors",
    "Direction": "observations.terrestrial",
    "FaceReading": "field.readings",
    "Finding": "validate.preliminary.finding",
    "FrameCoordinate": "observations.in_frames",
    "FrameDirection": "observations.frame_sights",
    "FrameDistance": "observations.frame_sights",
    "FrameVector": "observations.in_frames",
    "FrameZenith": "observations.frame_sights",
    "AntennaVector": "observations.airborne",
    "GridCoordinates": "solve.grid",
    "GridPhotos": "solve.grid",
    "NavigationAttitude": "observations.airborne",
    "PhotoAngle": "observations.airborne",
    "PhotoAttitude": "observations.airborne",
    "PhotoBase": "observations.airborne",
    "PhotoRange": "observations.airborne",
    "GeocentricFrame": "frames",
    "GnssPosition": "observations.positions",
    "GnssVector": "observations.positions",
    "GyroAzimuth": "observations.far_directions",
    "HeightDifference": "observations.terrestrial",
    "HorizontalAngle": "observations.terrestrial",
    "HorizontalDistance": "observations.terrestrial",
    "ImagePoint": "observations.image",
    "IncrementalAdjustment": "incremental.adjustment",
    "InputError": "errors",
    "LevelHeight": "observations.vertical",
    "LocalFrame": "frames",
    "Network": "network.network",
    "Observation": "observations.base",
    "ObservationKind": "observations.registry",
    "Parameter": "network.entities",
    "Part": "parts.part",
    "PartsSolution": "parts.result",
    "Photo": "network.entities",
    "PhotoPosition": "observations.positions",
    "PhotoSight": "observations.far_directions",
    "PhotoTilt": "observations.far_directions",
    "Point": "network.entities",
    "ProfileHeight": "observations.vertical",
    "Provenance": "report.options",
    "ReferenceSystem": "crs.system",
    "RelativePosition": "observations.relative",
    "RelativeRotation": "observations.relative",
    "ReportOptions": "report.options",
    "SevenParameters": "crs.similarity",
    "SlopeDistance": "observations.terrestrial",
    "Solution": "solve.solution",
    "StandardDeviation": "stochastic",
    "StripCoordinate": "observations.strips",
    "TopocentricFrame": "frames",
    "UnknownKind": "models.unknown",
    "VerticalAngle": "observations.terrestrial",
    "ZenithAngle": "observations.terrestrial",
    "__version__": "version",
    "adjust": "parts.network",
    "adjust_parts": "parts.adjust",
    "adjusted_lines": "quality.lines",
    "as_models": "triangulation.models",
    "build_graph": "factor_graph.build",
    "FactorTests": "factor_graph.factor_tests",
    "Isam": "factor_graph.isam",
    "block_motion": "epochs.blocks",
    "causes": "quality.causes.search",
    "check_points": "quality.check_points",
    "congruence": "epochs.congruence",
    "distance_precision": "quality.relative",
    "dlt": "block_orientation.dlt",
    "error_ellipse": "quality.ellipses",
    "error_ellipsoid": "quality.ellipses",
    "estimate_variance_components": "quality.variance_components",
    "exclude_insignificant": "quality.exclusion",
    "find_sparable": "planning.spare",
    "from_grid": "network.from_grid",
    "grid_coordinates": "solve.grid",
    "grid_photos": "solve.grid",
    "join": "network.join",
    "load_solution": "io.solution_file",
    "determined_part": "solve.batch",
    "memory_needed": "solve.batch",
    "orient": "block_orientation.orient",
    "plan": "planning.plan",
    "predict": "quality.prediction",
    "preliminary": "validate.preliminary.search",
    "propose": "planning.propose",
    "protocol": "report.text",
    "write_report": "report.html.write",
    "read": "io.readers",
    "read_bal": "io.bal",
    "read_colmap": "io.photogrammetry.colmap",
    "read_gama": "io.gama",
    "read_comp3d": "io.survey.comp3d",
    "read_dynaml": "io.gnss.dynaml",
    "read_gvx": "io.gnss.gvx",
    "read_sinex": "io.gnss.sinex",
    "write_dynaml": "io.gnss.write_dynaml",
    "write_gvx": "io.gnss.write_gvx",
    "write_sinex": "io.gnss.write_sinex",
    "read_metashape": "io.photogrammetry.metashape",
    "write_metashape": "io.photogrammetry.metashape_write",
    "read_dbat": "io.photogrammetry.dbat",
    "read_aicon": "io.photogrammetry.aicon",
    "read_opf": "io.photogrammetry.opf",
    "write_opf": "io.photogrammetry.opf_write",
    "read_openmvg": "io.photogrammetry.openmvg",
    "read_opensfm": "io.photogrammetry.opensfm",
    "read_opencv": "io.photogrammetry.opencv",
    "write_opencv": "io.photogrammetry.opencv",
    "read_bundler": "io.photogrammetry.bundler",
    "read_micmac": "io.photogrammetry.micmac",
    "read_lgc2": "io.survey.lgc2",
    "read_project": "io.project",
    "reduce_faces": "field.faces",
    "register_lens": "models.registry",
    "register_observation": "observations.registry",
    "register_unknown": "models.variables",
    "relative_model": "triangulation.relative",
    "reliability": "quality.reliability",
    "robust_adjust": "quality.robust",
    "s_transform": "quality.datum_change",
    "significance": "quality.systematic",
    "snoop": "quality.snooping",
    "wgs84_coordinates": "solve.grid",
    "without": "network.selection",
    "StarNetOptions": "io.survey.star_net_options",
    "covariance_array": "export.arrays",
    "read_columns": "io.survey.columns",
    "Accuracies": "io.survey.accuracies",
    "read_gsi": "io.survey.gsi",
    "read_jag3d": "io.survey.jag3d",
    "read_jobxml": "io.survey.jobxml",
    "read_landxml": "io.survey.landxml",
    "read_mmvii": "io.survey.mmvii",
    "read_sdr33": "io.survey.sdr33",
    "read_star_net": "io.survey.star_net",
    "results_schema": "export.results",
    "vectors_in_own_datum": "network.own_datum",
    "to_xarray": "export.arrays",
    "write": "export.exports",
    "write_colmap": "io.photogrammetry.colmap_write",
    "write_dxf": "export.dxf",
    "write_geojson": "export.geojson",
    "write_geopackage": "export.geopackage",
    "write_jag3d": "io.survey.write_jag3d",
    "write_kml": "export.kml",
    "write_landxml": "io.survey.write_landxml",
    "write_ply": "export.ply",
    "write_results": "export.results",
    "write_star_net": "io.survey.write_star_net",
    "write_project": "io.write_project",
}
"""Module of each public name; type checkers read the imports above."""


if not TYPE_CHECKING:  # a type checker would then accept any name as public

    def __getattr__(name: str) -> Any:
        """Import a public name, or a module of the package, at its first use."""
        if name in _MODULES:
            found = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
            globals()[name] = found
            return found
        if not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
            return import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
