"""Precision maps as files: PLY with fields for M3C2-PM, and tables of text with covariances."""

from __future__ import annotations

from collections.abc import Callable
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


@taking(PrecisionMap | Solution | Report)
def write_precision_map(what: PrecisionMap | Solution | Report, path: str | Path) -> None:
    """Write a precision map as PLY or as a table of text, by the suffix of the file.

    ``.ply``: binary, little-endian; vertices have x, y, z and sx, sy, sz in metres (double), which
    CloudCompare reads as scalar fields for the plugin M3C2, "precision maps", with scale 1, and
    ``photos``, the number of photos that see the point. ``.txt``: the columns
    ``X(m) Y(m) Z(m) sX(mm) sY(mm) sZ(mm) covXX(m2) covXY(m2) covXZ(m2) covYY(m2) covYZ(m2)
    covZZ(m2)`` with tabs between them and one line for each point, as the scripts of James et al.
    write them; coordinates have all digits, the others nine. Points that are not determined have
    NaN in both.

    Args:
        what: the result of `precision_map`; or a solution, or its report, for the adjusted points.
        path: the file, such as ``cloud.ply``.

    Raises:
        InputError: the suffix is another one, or the file cannot be written.
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


_CONTENT: dict[str, Callable[[PrecisionMap], bytes]] = {".ply": _ply, ".txt": _table}
