"""Combined adjustment of terrestrial and photogrammetric observations in one factor graph.

import factorgraph_adj as fga
solution = fga.adjust(fga.read("project.toml"))

A public name is imported at its first use, so that a program loads only the modules that it uses.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .adjustment import determined_part, memory_needed
    from .crs.reference_system import ReferenceSystem
    from .crs.transformation_chain import SevenParameters
    from .entities import Camera, Parameter, Photo, Point
    from .epochs.block_motion import block_motion
    from .epochs.congruence import congruence
    from .errors import AdjustmentError, ApproximationError, DatumError, InputError
    from .export.dxf_ply import write_dxf, write_ply
    from .export.formats import covariance_array, results_schema, to_xarray, write, write_results
    from .export.geojson_kml import write_geojson, write_kml
    from .export.geopackage import write_geopackage
    from .factor_graph.factor_tests import FactorTests
    from .factor_graph.isam import Isam
    from .factor_graph.network_graph import build_graph
    from .frames import GeocentricFrame, LocalFrame, TopocentricFrame
    from .graph.observation_selection import without
    from .incremental.adjustment import IncrementalAdjustment
    from .io.gnss.dynaml import read_dynaml, write_dynaml
    from .io.gnss.gvx import read_gvx, write_gvx
    from .io.gnss.sinex import read_sinex, write_sinex
    from .io.photogrammetry.aicon import read_aicon
    from .io.photogrammetry.bundler import read_bal, read_bundler
    from .io.photogrammetry.colmap import read_colmap
    from .io.photogrammetry.colmap_writer import write_colmap
    from .io.photogrammetry.dbat import read_dbat
    from .io.photogrammetry.metashape import read_metashape
    from .io.photogrammetry.metashape_writer import write_metashape
    from .io.photogrammetry.micmac import read_micmac
    from .io.photogrammetry.opencv import read_opencv, write_opencv
    from .io.photogrammetry.openmvg import read_openmvg
    from .io.photogrammetry.opensfm import read_opensfm
    from .io.photogrammetry.opf import read_opf
    from .io.photogrammetry.opf_writer import write_opf
    from .io.project import read_project
    from .io.project_writer import write_project
    from .io.readers import read
    from .io.solution_file import load_solution
    from .io.survey.comp3d import read_comp3d
    from .io.survey.field_book import Accuracies
    from .io.survey.gama import read_gama
    from .io.survey.gsi import read_gsi
    from .io.survey.jag3d import read_jag3d, write_jag3d
    from .io.survey.jobxml import read_jobxml
    from .io.survey.landxml import read_landxml, write_landxml
    from .io.survey.lgc2 import read_lgc2
    from .io.survey.mapped_tables import read_columns
    from .io.survey.mmvii import read_mmvii
    from .io.survey.sdr33 import read_sdr33
    from .io.survey.star_net import read_star_net
    from .io.survey.star_net_options import StarNetOptions
    from .io.survey.star_net_writer import write_star_net
    from .models.lens_registry import register_lens
    from .models.unknown import UnknownKind
    from .models.variables import register_unknown
    from .network.face_readings import FaceReading
    from .network.face_reduction import reduce_faces
    from .network.grid.conversion import from_grid
    from .network.joined_networks import join, vectors_in_own_datum
    from .network.network import Network
    from .observations.airborne import (
        AntennaVector,
        GyroAzimuth,
        NavigationAttitude,
        PhotoAngle,
        PhotoAttitude,
        PhotoBase,
        PhotoRange,
        PhotoSight,
        PhotoTilt,
    )
    from .observations.base import Observation
    from .observations.correlated import Correlated
    from .observations.frame_observations import (
        FrameCoordinate,
        FrameDirection,
        FrameDistance,
        FrameVector,
        FrameZenith,
        StripCoordinate,
    )
    from .observations.image import ImagePoint
    from .observations.positions import ControlPoint, GnssPosition, GnssVector, PhotoPosition
    from .observations.registry import ObservationKind, register_observation
    from .observations.relative_poses import RelativePosition, RelativeRotation
    from .observations.surface_heights import LevelHeight, ProfileHeight
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
    from .orientation.block_orientation import orient
    from .orientation.unknown_calibration import dlt
    from .parts.adjustment import adjust_parts
    from .parts.part_files import Part
    from .parts.solution import PartsSolution
    from .parts.whole_network import adjust
    from .planning.candidates import Candidate
    from .planning.dispensable_observations import find_sparable
    from .planning.plan import plan
    from .planning.proposals import propose
    from .quality.causes.search import causes
    from .quality.datum_change import s_transform
    from .quality.derived_quantities import adjusted_lines
    from .quality.error_ellipses import error_ellipse, error_ellipsoid
    from .quality.parameter_exclusion import exclude_insignificant
    from .quality.parameter_significance import significance
    from .quality.point_precision import check_points, distance_precision
    from .quality.prediction import predict
    from .quality.reliability import reliability
    from .quality.robust_estimation import robust_adjust
    from .quality.snooping import snoop
    from .quality.variance_components import estimate_variance_components
    from .report.html.page import write_report
    from .report.options import Provenance, ReportOptions
    from .report.text import protocol
    from .solve.grid_coordinates import (
        GridCoordinates,
        GridPhotos,
        grid_coordinates,
        grid_photos,
        wgs84_coordinates,
    )
    from .solve.solution import Solution
    from .stochastic import StandardDeviation
    from .triangulation.independent_models import as_models, relative_model
    from .validate.findings import Finding
    from .validate.preliminary_checks import preliminary
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
    "Camera": "entities",
    "Candidate": "planning.candidates",
    "ControlPoint": "observations.positions",
    "Correlated": "observations.correlated",
    "DatumError": "errors",
    "Direction": "observations.terrestrial",
    "FaceReading": "network.face_readings",
    "Finding": "validate.findings",
    "FrameCoordinate": "observations.frame_observations",
    "FrameDirection": "observations.frame_observations",
    "FrameDistance": "observations.frame_observations",
    "FrameVector": "observations.frame_observations",
    "FrameZenith": "observations.frame_observations",
    "AntennaVector": "observations.airborne",
    "GridCoordinates": "solve.grid_coordinates",
    "GridPhotos": "solve.grid_coordinates",
    "NavigationAttitude": "observations.airborne",
    "PhotoAngle": "observations.airborne",
    "PhotoAttitude": "observations.airborne",
    "PhotoBase": "observations.airborne",
    "PhotoRange": "observations.airborne",
    "GeocentricFrame": "frames",
    "GnssPosition": "observations.positions",
    "GnssVector": "observations.positions",
    "GyroAzimuth": "observations.airborne",
    "HeightDifference": "observations.terrestrial",
    "HorizontalAngle": "observations.terrestrial",
    "HorizontalDistance": "observations.terrestrial",
    "ImagePoint": "observations.image",
    "IncrementalAdjustment": "incremental.adjustment",
    "InputError": "errors",
    "LevelHeight": "observations.surface_heights",
    "LocalFrame": "frames",
    "Network": "network.network",
    "Observation": "observations.base",
    "ObservationKind": "observations.registry",
    "Parameter": "entities",
    "Part": "parts.part_files",
    "PartsSolution": "parts.solution",
    "Photo": "entities",
    "PhotoPosition": "observations.positions",
    "PhotoSight": "observations.airborne",
    "PhotoTilt": "observations.airborne",
    "Point": "entities",
    "ProfileHeight": "observations.surface_heights",
    "Provenance": "report.options",
    "ReferenceSystem": "crs.reference_system",
    "RelativePosition": "observations.relative_poses",
    "RelativeRotation": "observations.relative_poses",
    "ReportOptions": "report.options",
    "SevenParameters": "crs.transformation_chain",
    "SlopeDistance": "observations.terrestrial",
    "Solution": "solve.solution",
    "StandardDeviation": "stochastic",
    "StripCoordinate": "observations.frame_observations",
    "TopocentricFrame": "frames",
    "UnknownKind": "models.unknown",
    "VerticalAngle": "observations.terrestrial",
    "ZenithAngle": "observations.terrestrial",
    "__version__": "version",
    "adjust": "parts.whole_network",
    "adjust_parts": "parts.adjustment",
    "adjusted_lines": "quality.derived_quantities",
    "as_models": "triangulation.independent_models",
    "build_graph": "factor_graph.network_graph",
    "FactorTests": "factor_graph.factor_tests",
    "Isam": "factor_graph.isam",
    "block_motion": "epochs.block_motion",
    "causes": "quality.causes.search",
    "check_points": "quality.point_precision",
    "congruence": "epochs.congruence",
    "distance_precision": "quality.point_precision",
    "dlt": "orientation.unknown_calibration",
    "error_ellipse": "quality.error_ellipses",
    "error_ellipsoid": "quality.error_ellipses",
    "estimate_variance_components": "quality.variance_components",
    "exclude_insignificant": "quality.parameter_exclusion",
    "find_sparable": "planning.dispensable_observations",
    "from_grid": "network.grid.conversion",
    "grid_coordinates": "solve.grid_coordinates",
    "grid_photos": "solve.grid_coordinates",
    "join": "network.joined_networks",
    "load_solution": "io.solution_file",
    "determined_part": "adjustment",
    "memory_needed": "adjustment",
    "orient": "orientation.block_orientation",
    "plan": "planning.plan",
    "predict": "quality.prediction",
    "preliminary": "validate.preliminary_checks",
    "propose": "planning.proposals",
    "protocol": "report.text",
    "write_report": "report.html.page",
    "read": "io.readers",
    "read_bal": "io.photogrammetry.bundler",
    "read_colmap": "io.photogrammetry.colmap",
    "read_gama": "io.survey.gama",
    "read_comp3d": "io.survey.comp3d",
    "read_dynaml": "io.gnss.dynaml",
    "read_gvx": "io.gnss.gvx",
    "read_sinex": "io.gnss.sinex",
    "write_dynaml": "io.gnss.dynaml",
    "write_gvx": "io.gnss.gvx",
    "write_sinex": "io.gnss.sinex",
    "read_metashape": "io.photogrammetry.metashape",
    "write_metashape": "io.photogrammetry.metashape_writer",
    "read_dbat": "io.photogrammetry.dbat",
    "read_aicon": "io.photogrammetry.aicon",
    "read_opf": "io.photogrammetry.opf",
    "write_opf": "io.photogrammetry.opf_writer",
    "read_openmvg": "io.photogrammetry.openmvg",
    "read_opensfm": "io.photogrammetry.opensfm",
    "read_opencv": "io.photogrammetry.opencv",
    "write_opencv": "io.photogrammetry.opencv",
    "read_bundler": "io.photogrammetry.bundler",
    "read_micmac": "io.photogrammetry.micmac",
    "read_lgc2": "io.survey.lgc2",
    "read_project": "io.project",
    "reduce_faces": "network.face_reduction",
    "register_lens": "models.lens_registry",
    "register_observation": "observations.registry",
    "register_unknown": "models.variables",
    "relative_model": "triangulation.independent_models",
    "reliability": "quality.reliability",
    "robust_adjust": "quality.robust_estimation",
    "s_transform": "quality.datum_change",
    "significance": "quality.parameter_significance",
    "snoop": "quality.snooping",
    "wgs84_coordinates": "solve.grid_coordinates",
    "without": "graph.observation_selection",
    "StarNetOptions": "io.survey.star_net_options",
    "covariance_array": "export.formats",
    "read_columns": "io.survey.mapped_tables",
    "Accuracies": "io.survey.field_book",
    "read_gsi": "io.survey.gsi",
    "read_jag3d": "io.survey.jag3d",
    "read_jobxml": "io.survey.jobxml",
    "read_landxml": "io.survey.landxml",
    "read_mmvii": "io.survey.mmvii",
    "read_sdr33": "io.survey.sdr33",
    "read_star_net": "io.survey.star_net",
    "results_schema": "export.formats",
    "vectors_in_own_datum": "network.joined_networks",
    "to_xarray": "export.formats",
    "write": "export.formats",
    "write_colmap": "io.photogrammetry.colmap_writer",
    "write_dxf": "export.dxf_ply",
    "write_geojson": "export.geojson_kml",
    "write_geopackage": "export.geopackage",
    "write_jag3d": "io.survey.jag3d",
    "write_kml": "export.geojson_kml",
    "write_landxml": "io.survey.landxml",
    "write_ply": "export.dxf_ply",
    "write_results": "export.formats",
    "write_star_net": "io.survey.star_net_writer",
    "write_project": "io.project_writer",
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
