"""What formats declare as not read, in docstrings and formats.md: patterns of changes.

A change is ``file|way|word|row``: its way, the word that was replaced or added, and the row before
the change, see `tests.hostile.silence`.
"""

from __future__ import annotations

import re

NAMES_ARE_OPEN = (
    *("metashape", "metashape-xml", "opf", "opensfm", "opencv", "micmac", "jobxml", "landxml"),
    *("gvx", "openmvg"),
)
"""Readers of formats that grow by elements, attributes and keys: others than the read ones are not
looked at. Values of what is read are judged as everywhere."""
OF_ALL = (r"\|<\?xml", r"\|name\|xmlns\|", r"\|value\|http")
"""The declaration of XML and the names of name spaces."""
PATTERNS: dict[str, tuple[str, ...]] = {
    "bal": (),
    "colmap": (r"\|#", r"\|word\| qz7x\|.*\.jpg$"),  # comments; an image name may have blanks
    "metashape-xml": (
        r"<document version=|next_id=|next_group_id=",
        r"<property name=\"fixed\"",  # a sensor that is fixed is one without optimised parameters
        r"<resolution .*",  # of a calibration: that of the sensor counts
        r"<scalebar id=|<frame id=|LOCAL_CS",
    ),
    "opf": (
        r"\"(id|description|version)\": \"",  # of items: their type and resources count
        r"input-cameras\.json\|value\|",  # first calibrations, positions before the projection
        r"input-control-points\.json\|value\|-?\d",  # coordinates before the projection
        r"\"generator\"|\"name\": \"factorgraph_adj\"|\"type\": \"\w+\"$",  # sources of an item
        r"calibrated-cameras\.json\|value\|\d+\|\s*\"sensor_id\"",
        r"scene-reference-frame\.json\|value",  # of coordinates before the projection
        r"calibrated-control-points\.json\|value\|",  # approximate coordinates
    ),
    "opensfm": (
        r"reconstruction\.json\|value\|.*\|\s*(-?[\d.]+,?|\"gps_dop.*)$",  # positions by GPS
        r"tracks\.csv",  # photos and points without reconstruction, features, colours
        r"gcp_list\.txt\|(value\|\d\.jpg|word)",  # photos without reconstruction; extra columns
    ),
    "opencv": (r"%YAML", r"type_id="),
    "micmac": (),
    "bundler": (r"\|# Bundle",),
    "dbat": (
        r"\|#",
        r"<meta>|<document |min_rays=|images\.txt\|",
        r"\|value\|1\|<cameras><camera><id>",  # the only camera
    ),
    "aicon": (
        r"block\.ior\|value\|-999\|",  # number of the set of parameters
        r"block\.obc\|value\|\d\|",  # points that no photo sees
        r"block\.phc\|value\|\d\|",  # points that .obc does not have; method
    ),
    "star-net": (r"\|#|#   held|# held", r"'a point"),
    "sdr33": (
        r"\|00NM|\|10NM|\|01NM",  # header without options, job, instrument
        r"\|value\|control\||\|word\|",  # descriptions behind the fields
    ),
    "jobxml": (r"<JOBFile version|<PointRecord ID=|\|value\|x\|",),
    "landxml": (r"ObservationGroup id=|pntRef=|InstrumentSetup id=|\|value\|A\|", r"Hexagon"),
    "columns": (
        r"Bemerkung|\|value\|x\|",  # columns that are not mapped
        r"\|word\|;qz7x\|(Ziel|Punkt)",
        r"mapping\.toml\|value\|=\|",
    ),
    "sinex": (
        r"\|%=SNX|\|\*",  # header, comments
        r"\|value\|2\||TROTOT",  # kind of constraint, parameters that are no coordinates
        r"\|-SOLUTION/MATRIX|%ENDSNX",
    ),
    "dynaml": (r"type=\"Combined", r"\|attribute\|", r"<Description"),
    "gvx": (
        r"SOURCE_DATA|REFERENCE_SYSTEM|EQUIPMENT|SURVEY_SETUP|EPOCH|GEODETIC|<SESSION ID",
        r"\|value\|unknown\|",
    ),
    "comp3d": (r"\|\*|\*comment", r"\|-1 OUT"),
    "lgc2": (
        r"\|a small network|\|\*TITR|\|\*PREC|\*OLOC$",  # title, printing; a plane is the default
        r"% a comment",
        r"\*POLAR|\|P1 |\*SCALE",  # targets that are not used, further numbers of instruments
    ),
    "gama": (),
    "jag3d": (
        r"\|#",
        r"\|(SET|CREATE|ALTER) ",  # statements without rows; words of columns
        r"ProjectMetadata|ReductionDefinition",  # what no task reduces
    ),
    "mmvii": (r"\|\*|\* (given|clockwise)", r" -1$"),  # comments; what is switched off
    "openmvg": (
        r"root_path|\"(id_feat|id_view|width|height|polymorphic_id)\"",
        r"\"(local_path|filename|id_intrinsic)\"",  # of views without a pose
    ),
    "project": (r"\|\|",),
}
"""Patterns by reader of what may change without an effect."""
LEFT_OUT: dict[str, tuple[str, ...]] = {
    "opensfm": (r"tracks\.csv\|value", r"gcp_list\.txt\|value\|\d\.jpg"),  # of other photos
    "aicon": (r"block\.(obc|phc)\|value\|\d\|",),  # image points of points that .obc lacks
}
"""Patterns by reader of what is left out with what belongs to it."""


def is_declared(reader: str, change: str, *, lost: bool) -> bool:
    """Return whether a format declares that what was changed is not read.

    Args:
        reader: name of the reader.
        change: the change.
        lost: whether parts of the network are lost by it.
    """
    patterns = LEFT_OUT.get(reader, ()) if lost else (*OF_ALL, *PATTERNS.get(reader, ()))
    return any(re.search(p, change) for p in patterns)
