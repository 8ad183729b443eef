"""Commands of SNAP's jobs by what they concern: listings, iterations, stations, observations.

Format: LINZ, SNAP help, "Alphabetical list of commands", and ``control.c`` of the program (BSD-3).
"""

from __future__ import annotations

from typing import Literal, TypeAlias

from ..source import LeftOutReason

Mode: TypeAlias = Literal["adjustment", "data_check", "free", "design"]
MODES: dict[str, Mode] = {
    "adjustment": "adjustment",
    "data_check": "data_check",
    "free_net_adjustment": "free",
    "data_consistency": "free",
    "network_analysis": "design",
    "preanalysis": "design",
}
DIMENSIONS = {"3d": "3d", "2d": "2d", "horizontal": "2d", "1d": "1d", "vertical": "1d"}
INCLUDED_DEPTH = 20
"""Largest number of files that include one another; more are a circle."""
LISTING = (
    *(
        "title",
        "list",
        "print",
        "output",
        "output_csv",
        "output_coordinate_file",
        "output_precision",
    ),
    *("add_residual_column", "define_residual_format", "coordinate_precision", "plot"),
    *("station_code_width", "sort_observations", "summarize_errors_by", "summarise_errors_by"),
    *("summarize_residuals_by", "summarise_residuals_by", "number_of_worst_residuals"),
    *("flag_significance", "redundancy_flag_level", "mde_power", "file_location_frequency"),
    *("specification", "test_specification", "spec_test_options", "error_type"),
)
"""Commands of the listing."""
ITERATION = (
    *("convergence_tolerance", "max_iterations", "min_iterations", "max_adjustment"),
    *("reorder_stations", "magic_number", "use_zero_inverse", "topocentre"),
)
"""Commands of the computation, which the reader or the adjustment settles itself."""
OF_LISTING = LeftOutReason("commands of the listing", "they have no effect on the network")
OF_COMPUTATION = LeftOutReason(
    "commands of the computation", "the adjustment settles iterations, order and middle itself"
)
REFUSED = {
    "geoid": "the geoid {0} is a grid of SNAP that is not read: write geoid heights and "
    "deflections into the coordinate file, as snapgeoid does",
    "systematic_error": "parameters of systematic errors ({0}) have no counterpart",
    "gps_vertical": "one vertical for the errors of all vectors ({0}) is not read: leave it out, "
    "and each has its own",
    "reference_frame_scale_error": "a scale of the frame of the network ({0}) has no counterpart: "
    "state a scale of distances and of reference frames",
}
"""Commands that are refused, with the reason."""
HARMLESS = {"geoid": "none", "gps_vertical": "individual"}
"""Words with which a refused command changes nothing."""
StationCommand: TypeAlias = Literal["fix", "free", "float", "reject", "ignore", "accept"]
DEFORMING_DATUMS = {"NZGD2000": "the deformation model of NZGD2000"}
"""Models that SNAP applies by default, by datum."""
STATION_COMMANDS: tuple[StationCommand, ...] = (
    *("fix", "free", "float"),
    *("reject", "ignore", "accept"),
)
OBSERVATION_OPTIONS = {
    "calculate_gx_translation": "GX",
    "use_distance_ratios_as_distances": "DR",
}
"""Options of observations, with the kind that they concern."""
ANTENNA = "gps_antenna_height"
OFFSET_ERROR, CENTROID_ERROR = "offset_error", "centroid_error"
"""Further errors of GNSS vectors: of the place of an antenna, of a set of positions as a whole."""
FURTHER_ERROR_UNITS = {"m": 1.0, "mm": 1e-3}
"""Metres of the units of further errors."""
OBSERVATION_COMMANDS = (
    *("reject_observations", "ignore_observations", "reweight_observations"),
    ANTENNA,
)
