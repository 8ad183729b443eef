"""Combined adjustment of terrestrial and photogrammetric observations in one factor graph.

import factorgraph_adj as fga
solution = fga.adjust(fga.read("project.toml"))

A public name is imported at its first use, so that a program loads only the modules that it uses.
"""

from importlib import import_module as _import_module
from importlib.util import find_spec as _find_spec
from typing import TYPE_CHECKING as _TYPE_CHECKING

if _TYPE_CHECKING:
    from .accuracy.instrument_tests import (
        direction_test,
        distance_meter_test,
        level_test,
        zenith_test,
    )
    from .accuracy.positional_accuracy import positional_accuracy
    from .accuracy.uncertainty_budget import BudgetInput, solution_budget, uncertainty_budget
    from .adjustment import determined_part, memory_needed
    from .collocation.collocation import collocate
    from .collocation.covariance_estimation import (
        empirical_covariance,
        estimate_covariance,
        fit_variogram,
    )
    from .collocation.covariance_function import CovarianceFunction
    from .collocation.image_corrections import corrected_bundle, image_corrections
    from .collocation.point_corrections import point_corrections
    from .collocation.signal_test import signal_test
    from .collocation.signal_variables import with_image_signals, with_signals
    from .crs.reference_system import ReferenceSystem
    from .crs.transformation_chain import SevenParameters
    from .entities import Camera, Parameter, Photo, Point
    from .epochs.block_motion import block_motion
    from .epochs.congruence import congruence
    from .errors import AdjustmentError, ApproximationError, DatumError, InputError
    from .experiment.study import Experiment
    from .export.dxf_ply import write_dxf, write_ply
    from .export.formats import covariance_array, results_schema, to_xarray, write, write_results
    from .export.geojson_kml import write_geojson, write_kml
    from .export.geopackage import write_geopackage
    from .export.precision_files import write_precision_map
    from .factor_graph.factor_tests import FactorTests
    from .factor_graph.isam import Isam
    from .factor_graph.network_graph import build_graph
    from .frames import GeocentricFrame, LocalFrame, TopocentricFrame
    from .graph.observation_selection import without
    from .incremental.adjustment import IncrementalAdjustment
    from .io.example_files import fetch_example
    from .io.field_books.accuracies import Accuracies
    from .io.field_books.gsi import read_gsi
    from .io.field_books.jobxml import read_jobxml
    from .io.field_books.landxml import read_landxml, write_landxml
    from .io.field_books.sdr33 import read_sdr33
    from .io.gnss.dynadjust import read_dynadjust
    from .io.gnss.dynaml import read_dynaml
    from .io.gnss.dynaml_writer import write_dynaml
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
    from .io.photogrammetry.rpc import add_rpc_image, read_rpc
    from .io.project import read_project
    from .io.project_writer import write_project
    from .io.readers import read, register_reader
    from .io.solution_file import load_solution
    from .io.survey.comp3d import read_comp3d
    from .io.survey.gama import read_gama
    from .io.survey.gama_g3 import read_gama_g3
    from .io.survey.jag3d import read_jag3d, write_jag3d
    from .io.survey.lgc2 import read_lgc2
    from .io.survey.mapped_tables import read_columns
    from .io.survey.mmvii import read_mmvii
    from .io.survey.star_net import read_star_net
    from .io.survey.star_net_options import StarNetOptions
    from .io.survey.star_net_project import read_star_net_project
    from .io.survey.star_net_writer import write_star_net
    from .models.lens import BrownLens
    from .models.lens_registry import register_lens
    from .models.unknown import UnknownKind
    from .models.unknown_registry import register_unknown
    from .monitoring.alarm_rules import AlarmRule
    from .monitoring.epoch_estimates import EpochEstimate
    from .monitoring.monitor import Monitor
    from .network.face_readings import FaceReading
    from .network.face_reduction import reduce_faces
    from .network.grid.conversion import from_grid
    from .network.joined_networks import join, vectors_in_own_datum
    from .network.network import Network
    from .observations.airborne_observations import (
        AntennaVector,
        NavigationAttitude,
        PhotoAngle,
        PhotoAttitude,
        PhotoBase,
        PhotoRange,
        PhotoSight,
        PhotoTilt,
    )
    from .observations.base import Observation
    from .observations.correlated_observations import Correlated
    from .observations.frame_observations import (
        FrameCoordinate,
        FrameDirection,
        FrameDistance,
        FrameInclination,
        FrameRoll,
        FrameVector,
        FrameZenith,
        StripCoordinate,
        UnitVector,
        WireReading,
        WireReadingOnBody,
    )
    from .observations.image import ImagePoint
    from .observations.offsets import (
        HydrostaticReading,
        LineOffset,
        PlaneOffset,
        PlumbOffset,
        RadialOffset,
        SightOffset,
        SightPlaneOffset,
    )
    from .observations.positions import ControlPoint, GnssPosition, GnssVector, PhotoPosition
    from .observations.registry import ObservationKind, register_observation
    from .observations.relations import (
        AxisAngle,
        CoordinateDifference,
        EqualDistance,
        EqualHeightDifference,
        ImageLine,
        ParallelAxes,
        PlaneDistance,
        PointDirection,
        RightAngle,
    )
    from .observations.relative_poses import RelativePosition, RelativeRotation
    from .observations.shape_points import (
        OnCircle,
        OnCone,
        OnCylinder,
        OnLine,
        OnParaboloid,
        OnPlane,
        OnSphere,
        OnTorus,
    )
    from .observations.surface_heights import LevelHeight, ProfileHeight
    from .observations.terrestrial_observations import (
        AstronomicLatitude,
        AstronomicLongitude,
        Azimuth,
        Direction,
        GyroAzimuth,
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
    from .quality.causes.cause_search import causes
    from .quality.datum_change import s_transform
    from .quality.derived_quantities import adjusted_lines
    from .quality.error_ellipses import error_ellipse, error_ellipsoid
    from .quality.estimated_precision import estimate_precision
    from .quality.parameter_exclusion import exclude_insignificant
    from .quality.parameter_significance import significance
    from .quality.point_precision import check_points, distance_precision
    from .quality.precision_maps import precision_map
    from .quality.prediction import predict
    from .quality.protection_levels import protection_levels
    from .quality.reliability import reliability
    from .quality.robust_estimation import robust_adjust
    from .quality.snooping import snoop
    from .quality.variance_components import estimate_variance_components
    from .report.html.page import write_report
    from .report.options import Provenance, ReportOptions
    from .report.plots.network_plan import plot_network
    from .report.text import text_report
    from .simulation.measurement import measure
    from .solve.grid_coordinates import (
        GridCoordinates,
        GridPhotos,
        grid_coordinates,
        grid_photos,
        wgs84_coordinates,
    )
    from .solve.solution import Solution
    from .stochastic_model import StandardDeviation
    from .triangulation.film_coordinates import film_coordinates
    from .triangulation.image_refinement import refine_images
    from .triangulation.independent_models import as_models, relative_model
    from .triangulation.plan_units import radial_units
    from .units import GON
    from .validate.findings import Finding
    from .validate.preliminary_checks import preliminary
    from .version import __version__

# fmt: off
__all__ = [
    "GON", "Accuracies", "AdjustmentError", "AlarmRule", "AntennaVector", "ApproximationError",
    "AstronomicLatitude", "AstronomicLongitude", "AxisAngle", "Azimuth", "BrownLens", "BudgetInput",
    "Camera", "Candidate", "ControlPoint", "CoordinateDifference", "Correlated",
    "CovarianceFunction", "DatumError", "Direction", "EpochEstimate", "EqualDistance",
    "EqualHeightDifference", "Experiment", "FaceReading", "FactorTests", "Finding",
    "FrameCoordinate", "FrameDirection", "FrameDistance", "FrameInclination", "FrameRoll",
    "FrameVector", "FrameZenith", "GeocentricFrame", "GnssPosition", "GnssVector",
    "GridCoordinates", "GridPhotos", "GyroAzimuth", "HeightDifference", "HorizontalAngle",
    "HorizontalDistance", "HydrostaticReading", "ImageLine", "ImagePoint", "IncrementalAdjustment",
    "InputError", "Isam", "LevelHeight", "LineOffset", "LocalFrame", "Monitor",
    "NavigationAttitude", "Network", "Observation", "ObservationKind", "OnCircle", "OnCone",
    "OnCylinder", "OnLine", "OnParaboloid", "OnPlane", "OnSphere", "OnTorus", "ParallelAxes",
    "Parameter", "Part", "PartsSolution", "Photo", "PhotoAngle", "PhotoAttitude", "PhotoBase",
    "PhotoPosition", "PhotoRange", "PhotoSight", "PhotoTilt", "PlaneDistance", "PlaneOffset",
    "PlumbOffset", "Point", "PointDirection", "ProfileHeight", "Provenance", "RadialOffset",
    "ReferenceSystem", "RelativePosition", "RelativeRotation", "ReportOptions", "RightAngle",
    "SevenParameters", "SightOffset", "SightPlaneOffset", "SlopeDistance", "Solution",
    "StandardDeviation", "StarNetOptions", "StripCoordinate", "TopocentricFrame", "UnitVector",
    "UnknownKind", "VerticalAngle", "WireReading", "WireReadingOnBody", "ZenithAngle",
    "__version__", "add_rpc_image", "adjust", "adjust_parts", "adjusted_lines", "as_models",
    "block_motion", "build_graph", "causes", "check_points", "collocate", "congruence",
    "corrected_bundle", "covariance_array", "determined_part", "direction_test",
    "distance_meter_test", "distance_precision", "dlt", "empirical_covariance", "error_ellipse",
    "error_ellipsoid", "estimate_covariance", "estimate_precision", "estimate_variance_components",
    "exclude_insignificant", "fetch_example", "film_coordinates", "find_sparable", "fit_variogram",
    "from_grid", "grid_coordinates", "grid_photos", "image_corrections", "join", "level_test",
    "load_solution", "measure", "memory_needed", "orient", "plan", "plot_network",
    "point_corrections", "positional_accuracy", "precision_map", "predict", "preliminary",
    "propose", "protection_levels", "radial_units", "read", "read_aicon", "read_bal",
    "read_bundler", "read_colmap", "read_columns", "read_comp3d", "read_dbat", "read_dynadjust",
    "read_dynaml", "read_gama", "read_gama_g3", "read_gsi", "read_gvx", "read_jag3d", "read_jobxml",
    "read_landxml", "read_lgc2", "read_metashape", "read_micmac", "read_mmvii", "read_opencv",
    "read_openmvg", "read_opensfm", "read_opf", "read_project", "read_rpc", "read_sdr33",
    "read_sinex", "read_star_net", "read_star_net_project", "reduce_faces", "refine_images",
    "register_lens", "register_observation", "register_reader", "register_unknown",
    "relative_model", "reliability", "results_schema", "robust_adjust", "s_transform",
    "signal_test", "significance", "snoop", "solution_budget", "text_report", "to_xarray",
    "uncertainty_budget", "vectors_in_own_datum", "wgs84_coordinates", "with_image_signals",
    "with_signals", "without", "write", "write_colmap", "write_dxf", "write_dynaml",
    "write_geojson", "write_geopackage", "write_gvx", "write_jag3d", "write_kml", "write_landxml",
    "write_metashape", "write_opencv", "write_opf", "write_ply", "write_precision_map",
    "write_project", "write_report", "write_results", "write_sinex", "write_star_net",
    "zenith_test",
]
# fmt: on

_NAMES = {
    "accuracy.instrument_tests": "direction_test distance_meter_test level_test zenith_test",
    "accuracy.positional_accuracy": "positional_accuracy",
    "accuracy.uncertainty_budget": "BudgetInput solution_budget uncertainty_budget",
    "adjustment": "determined_part memory_needed",
    "collocation.collocation": "collocate",
    "collocation.covariance_estimation": "empirical_covariance estimate_covariance fit_variogram",
    "collocation.covariance_function": "CovarianceFunction",
    "collocation.image_corrections": "corrected_bundle image_corrections",
    "collocation.point_corrections": "point_corrections",
    "collocation.signal_test": "signal_test",
    "collocation.signal_variables": "with_image_signals with_signals",
    "crs.reference_system": "ReferenceSystem",
    "crs.transformation_chain": "SevenParameters",
    "entities": "Camera Parameter Photo Point",
    "epochs.block_motion": "block_motion",
    "epochs.congruence": "congruence",
    "errors": "AdjustmentError ApproximationError DatumError InputError",
    "experiment.study": "Experiment",
    "export.dxf_ply": "write_dxf write_ply",
    "export.formats": "covariance_array results_schema to_xarray write write_results",
    "export.geojson_kml": "write_geojson write_kml",
    "export.geopackage": "write_geopackage",
    "export.precision_files": "write_precision_map",
    "factor_graph.factor_tests": "FactorTests",
    "factor_graph.isam": "Isam",
    "factor_graph.network_graph": "build_graph",
    "frames": "GeocentricFrame LocalFrame TopocentricFrame",
    "graph.observation_selection": "without",
    "incremental.adjustment": "IncrementalAdjustment",
    "io.gnss.dynadjust": "read_dynadjust",
    "io.example_files": "fetch_example",
    "io.gnss.dynaml": "read_dynaml",
    "io.gnss.dynaml_writer": "write_dynaml",
    "io.gnss.gvx": "read_gvx write_gvx",
    "io.gnss.sinex": "read_sinex write_sinex",
    "io.photogrammetry.aicon": "read_aicon",
    "io.photogrammetry.bundler": "read_bal read_bundler",
    "io.photogrammetry.colmap": "read_colmap",
    "io.photogrammetry.colmap_writer": "write_colmap",
    "io.photogrammetry.dbat": "read_dbat",
    "io.photogrammetry.metashape": "read_metashape",
    "io.photogrammetry.metashape_writer": "write_metashape",
    "io.photogrammetry.micmac": "read_micmac",
    "io.photogrammetry.opencv": "read_opencv write_opencv",
    "io.photogrammetry.openmvg": "read_openmvg",
    "io.photogrammetry.opensfm": "read_opensfm",
    "io.photogrammetry.opf": "read_opf",
    "io.photogrammetry.opf_writer": "write_opf",
    "io.photogrammetry.rpc": "add_rpc_image read_rpc",
    "io.project": "read_project",
    "io.project_writer": "write_project",
    "io.readers": "read register_reader",
    "io.solution_file": "load_solution",
    "io.survey.comp3d": "read_comp3d",
    "io.field_books.accuracies": "Accuracies",
    "io.survey.gama": "read_gama",
    "io.survey.gama_g3": "read_gama_g3",
    "io.field_books.gsi": "read_gsi",
    "io.survey.jag3d": "read_jag3d write_jag3d",
    "io.field_books.jobxml": "read_jobxml",
    "io.field_books.landxml": "read_landxml write_landxml",
    "io.survey.lgc2": "read_lgc2",
    "io.survey.mapped_tables": "read_columns",
    "io.survey.mmvii": "read_mmvii",
    "io.field_books.sdr33": "read_sdr33",
    "io.survey.star_net": "read_star_net",
    "io.survey.star_net_project": "read_star_net_project",
    "io.survey.star_net_options": "StarNetOptions",
    "io.survey.star_net_writer": "write_star_net",
    "models.lens": "BrownLens",
    "models.lens_registry": "register_lens",
    "models.unknown": "UnknownKind",
    "models.unknown_registry": "register_unknown",
    "monitoring.alarm_rules": "AlarmRule",
    "monitoring.epoch_estimates": "EpochEstimate",
    "monitoring.monitor": "Monitor",
    "network.face_readings": "FaceReading",
    "network.face_reduction": "reduce_faces",
    "network.grid.conversion": "from_grid",
    "network.joined_networks": "join vectors_in_own_datum",
    "network.network": "Network",
    "observations.airborne_observations": (
        "AntennaVector NavigationAttitude PhotoAngle PhotoAttitude PhotoBase "
        "PhotoRange PhotoSight PhotoTilt"
    ),
    "observations.base": "Observation",
    "observations.correlated_observations": "Correlated",
    "observations.frame_observations": (
        "FrameCoordinate FrameDirection FrameDistance FrameInclination FrameRoll FrameVector "
        "FrameZenith StripCoordinate UnitVector WireReading WireReadingOnBody"
    ),
    "observations.image": "ImagePoint",
    "observations.offsets": (
        "HydrostaticReading LineOffset PlaneOffset PlumbOffset RadialOffset SightOffset "
        "SightPlaneOffset"
    ),
    "observations.positions": "ControlPoint GnssPosition GnssVector PhotoPosition",
    "observations.registry": "ObservationKind register_observation",
    "observations.relations": (
        "AxisAngle CoordinateDifference EqualDistance EqualHeightDifference ImageLine "
        "ParallelAxes PlaneDistance PointDirection RightAngle"
    ),
    "observations.relative_poses": "RelativePosition RelativeRotation",
    "observations.shape_points": (
        "OnCircle OnCone OnCylinder OnLine OnParaboloid OnPlane OnSphere OnTorus"
    ),
    "observations.surface_heights": "LevelHeight ProfileHeight",
    "observations.terrestrial_observations": (
        "AstronomicLatitude AstronomicLongitude Azimuth Direction GyroAzimuth HeightDifference "
        "HorizontalAngle HorizontalDistance SlopeDistance VerticalAngle ZenithAngle"
    ),
    "orientation.block_orientation": "orient",
    "orientation.unknown_calibration": "dlt",
    "parts.adjustment": "adjust_parts",
    "parts.part_files": "Part",
    "parts.solution": "PartsSolution",
    "parts.whole_network": "adjust",
    "planning.candidates": "Candidate",
    "planning.dispensable_observations": "find_sparable",
    "planning.plan": "plan",
    "planning.proposals": "propose",
    "quality.causes.cause_search": "causes",
    "quality.datum_change": "s_transform",
    "quality.derived_quantities": "adjusted_lines",
    "quality.error_ellipses": "error_ellipse error_ellipsoid",
    "quality.estimated_precision": "estimate_precision",
    "quality.parameter_exclusion": "exclude_insignificant",
    "quality.parameter_significance": "significance",
    "quality.point_precision": "check_points distance_precision",
    "quality.precision_maps": "precision_map",
    "quality.prediction": "predict",
    "quality.protection_levels": "protection_levels",
    "quality.reliability": "reliability",
    "quality.robust_estimation": "robust_adjust",
    "quality.snooping": "snoop",
    "quality.variance_components": "estimate_variance_components",
    "report.html.page": "write_report",
    "report.options": "Provenance ReportOptions",
    "report.plots.network_plan": "plot_network",
    "report.text": "text_report",
    "simulation.measurement": "measure",
    "solve.grid_coordinates": (
        "GridCoordinates GridPhotos grid_coordinates grid_photos wgs84_coordinates"
    ),
    "solve.solution": "Solution",
    "stochastic_model": "StandardDeviation",
    "triangulation.film_coordinates": "film_coordinates",
    "triangulation.image_refinement": "refine_images",
    "triangulation.independent_models": "as_models relative_model",
    "triangulation.plan_units": "radial_units",
    "units": "GON",
    "validate.findings": "Finding",
    "validate.preliminary_checks": "preliminary",
    "version": "__version__",
}
"""Public names of each module; type checkers read the imports above."""
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}


if not _TYPE_CHECKING:  # a type checker would then accept any name as public

    def __getattr__(name: str) -> object:
        """Import a public name, or a module of the package, at its first use."""
        if name in _MODULES:
            found = getattr(_import_module(f"{__name__}.{_MODULES[name]}"), name)
            globals()[name] = found
            return found
        if not name.startswith("_") and _find_spec(f"{__name__}.{name}") is not None:
            return _import_module(f"{__name__}.{name}")
        if not name.startswith("_") and name in _found_in_modules():
            return _found_in_modules()[name]
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)


def _found_in_modules() -> dict[str, type]:
    """Return the classes of kinds of observations that modules state themselves, by name."""
    from .observations.built_in_kinds import FOUND_IN_MODULES

    return {kind.observation.__name__: kind.observation for kind in FOUND_IN_MODULES}


def __dir__() -> list[str]:
    """Return the public names: what a script needs, and not what has been imported so far."""
    return sorted({*__all__, *_found_in_modules()})
