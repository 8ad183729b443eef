"""Precision maps as files: PLY and LAS with fields for M3C2-PM, tables of text with covariances.

LAS: ASPRS, LAS specification 1.4-R15, extra bytes. It requires the extra ``las``.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import numpy as np

from ..errors import InputError, Problem, taking
from ..io.file_transaction import write_files
from ..quality.precision_maps import PrecisionMap, precision_map
from ..report.adjustment_report import Report
from ..solve.solution import Solution
from ..types import Array
from ..units import MILLIMETRE
from ..version import __version__

PRECISION_VERTEX = np.dtype(
    [*((a, "<f8") for a in ("x", "y", "z", "sx", "sy", "sz")), ("photos", "<i4")]
)
"""One vertex: coordinates and standard deviations in metres, number of photos."""
PLY_PROPERTIES = {"<f8": "double", "<i4": "int"}
"""Names of the types of `PRECISION_VERTEX` in PLY."""
TABLE_HEAD = (
    "X(m) Y(m) Z(m) sX(mm) sY(mm) sZ(mm) "
    "covXX(m2) covXY(m2) covXZ(m2) covYY(m2) covYZ(m2) covZZ(m2)"
)
"""Columns of the table, with tabs between them: those of the files ``_pt_prec.txt`` of the scripts
of James et al., which SfM_precision reads."""
PLACES_OF_COVARIANCES = np.triu_indices(3)
"""Rows and columns of the covariances in the table."""

LASPY_MISSING = "LAS needs laspy: pip install 'factorgraph_adj[las]'"
LAS_SCALES = (1e-6, 1e-5, 1e-4)
"""Steps of coordinates, metres: the finest counts with which four bytes reach over the cloud. The
coarsest keeps 0.1 mm and reaches over 429 km."""
LAS_REACH = 2**31 - 1
"""Largest number of steps from the offset."""
LAS_OFFSET_M = 1.0
"""Metres to which the offset is rounded."""
LAS_FIELDS = (
    *((f"sigma_{a}", "f4", f"standard deviation of {a}, m") for a in "xyz"),
    *((f"cov_{a}", "f4", f"covariance of {a[0]} and {a[1]}, m2") for a in ("xy", "xz", "yz")),
    ("photos", "i4", "photos that see the point"),
)
"""Extra dimensions with their types and descriptions, which have 31 letters at most."""


@taking(PrecisionMap | Solution | Report)
def write_precision_map(what: PrecisionMap | Solution | Report, path: str | Path) -> None:
    """Write a precision map as PLY, LAS or a table of text, by the suffix of the file.

    ``.ply``: binary, little-endian; vertices have x, y, z and sx, sy, sz in metres (double), which
    CloudCompare reads as scalar fields for the plugin M3C2, "precision maps", with scale 1, and
    ``photos``, the number of photos that see the point. ``.las``: LAS 1.4, coordinates in steps of
    1 µm, or of 10 or 100 µm where four bytes do not reach over the cloud, with the extra dimensions
    ``sigma_x``, ``sigma_y``, ``sigma_z`` in metres, ``cov_xy``, ``cov_xz``, ``cov_yz`` in square
    metres (float) and ``photos``; it states no reference system. ``.txt``: the columns
    ``X(m) Y(m) Z(m) sX(mm) sY(mm) sZ(mm) covXX(m2) covXY(m2) covXZ(m2) covYY(m2) covYZ(m2)
    covZZ(m2)`` with tabs between them and one line for each point, as the scripts of James et al.
    write them; coordinates have all digits, the others nine. Points that are not determined have
    NaN in all.

    Args:
        what: the result of `precision_map`; or a solution, or its report, for the adjusted points.
        path: the file, such as ``cloud.ply``.

    Raises:
        InputError: the suffix is another one; laspy is missing, or the cloud is too large for LAS;
            or the file cannot be written.
        AdjustmentError: the solution has no covariances.
    """
    file = Path(path)
    if file.suffix.lower() not in _CONTENT:
        raise InputError(
            Problem(f"a precision map is written as {' or '.join(_CONTENT)}", str(path))
        )
    if not isinstance(what, PrecisionMap):
        what = precision_map(what.solution if isinstance(what, Report) else what)
    write_files(file.parent, {file.name: _CONTENT[file.suffix.lower()](what)})


def _ply(found: PrecisionMap) -> bytes:
    out = np.empty(len(found.points), dtype=PRECISION_VERTEX)
    sigmas = found.sigmas
    for i, a in enumerate("xyz"):
        out[a], out[f"s{a}"] = found.points[:, i], sigmas[:, i]
    out["photos"] = found.photos
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment factorgraph_adj {__version__}: precision map, metres",
        f"element vertex {len(out)}",
        *(
            f"property {PLY_PROPERTIES[PRECISION_VERTEX[name].str]} {name}"
            for name in PRECISION_VERTEX.names or ()
        ),
        "end_header",
    ]
    return ("\n".join(head) + "\n").encode("ascii") + out.tobytes()


def _table(found: PrecisionMap) -> bytes:
    rows, columns = PLACES_OF_COVARIANCES
    numbers: Array = np.column_stack(
        [found.sigmas / MILLIMETRE, found.covariances[:, rows, columns]]
    )
    lines = [TABLE_HEAD.replace(" ", "\t")]
    for x, values in zip(found.points.tolist(), numbers.tolist(), strict=True):
        lines.append("\t".join([*map(repr, x), *(f"{v:.9g}" for v in values)]))
    return ("\n".join(lines) + "\n").encode("ascii")


def _las(found: PrecisionMap) -> bytes:
    if find_spec("laspy") is None:
        raise InputError(Problem(LASPY_MISSING))
    # Slow to import, and needed here alone.
    import laspy

    points = found.points
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0)) if len(points) else np.zeros(3)
    offset = np.round(middle / LAS_OFFSET_M) * LAS_OFFSET_M
    reach = float(np.abs(points - offset).max(initial=0.0))
    scale = next((s for s in LAS_SCALES if reach <= s * LAS_REACH), None)
    if scale is None:
        raise InputError(
            Problem(
                f"LAS reaches {LAS_SCALES[-1] * LAS_REACH / 1000:.0f} km from the middle of clouds "
                f"with 0.1 mm, and points are {reach / 1000:.0f} km away; valid: .ply or .txt"
            )
        )
    header = laspy.LasHeader(version="1.4", point_format=0)
    header.generating_software = f"factorgraph_adj {__version__}"
    # The same map makes the same file on any day.
    header.creation_date = None
    header.scales, header.offsets = np.full(3, scale), offset
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, kind, description) for name, kind, description in LAS_FIELDS]
    )
    out = laspy.LasData(header)
    out.x, out.y, out.z = points.T
    for i, a in enumerate("xyz"):
        out[f"sigma_{a}"] = found.sigmas[:, i]
        for j in range(i + 1, 3):
            out[f"cov_{a}{'xyz'[j]}"] = found.covariances[:, i, j]
    out["photos"] = found.photos
    out.return_number[:] = out.number_of_returns[:] = 1
    file = BytesIO()
    out.write(file)
    return file.getvalue()


_CONTENT: dict[str, Callable[[PrecisionMap], bytes]] = {".ply": _ply, ".las": _las, ".txt": _table}
