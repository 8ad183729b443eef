"""PLY: adjusted points and projection centres for programs that show point clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..io.atomic import write_files
from ..report.context import Report
from ..report.html.places import states
from ..version import __version__
from .layers import Result, adjusted_of

VERTEX = np.dtype(
    [
        *((a, "<f8") for a in ("x", "y", "z")),
        *((f"sigma_{a}", "<f4") for a in "xyz"),
        *((c, "u1") for c in ("red", "green", "blue")),
        ("kind", "u1"),
    ]
)
"""One vertex; σ in metres, NaN where unknown."""
TYPES = {"<f8": "double", "<f4": "float", "|u1": "uchar"}
"""Names of the types of `VERTEX` in PLY."""
COLOURS = {
    "held": (0, 158, 115),
    "part": (0, 158, 115),
    "known": (0, 158, 115),
    "datum": (0, 158, 115),
    "check": (213, 94, 0),
    "station": (204, 121, 167),
    "new": (200, 200, 200),
    "side_shot": (240, 228, 66),
}
"""Colours of points by what they are."""
PHOTO = (0, 114, 178)
"""Colour of projection centres."""


def write_ply(result: Result, path: str | Path, *, binary: bool = True) -> None:
    """Write adjusted points, and then projection centres, as the vertices of a PLY file.

    Vertices have x, y, z in the frame of the network (double, metres), sigma_x, sigma_y, sigma_z
    (float, metres), a colour, and ``kind``: 0 a point, 1 a projection centre. They are in the order
    of the network: PLY has no texts, and so no names. Grid coordinates are not Cartesian; use
    `write_geopackage` for them.

    Args:
        result: the result of `adjust`, or its report.
        path: the file, such as ``points.ply``.
        binary: whether numbers are binary (little-endian), or text with all digits.

    Raises:
        InputError: the result is a comparison of two epochs, or the file cannot be written.
    """
    report = adjusted_of(result, "PLY")
    file = Path(path)
    write_files(file.parent, {file.name: ply(report, binary=binary)})


def ply(report: Report, *, binary: bool = True) -> bytes:
    """Return the content of a PLY file."""
    solution, network = report.solution, report.network
    number = solution.equations.unknowns["pose"].number
    poses = solution.state["pose"][[number[n] for n in network.photos]]
    n = len(network.points)
    out = np.zeros(n + len(poses), dtype=VERTEX)
    xyz = np.concatenate([solution.state["point"], poses[:, 9:12]])
    sigmas = np.full(xyz.shape, np.nan)
    if not report.singular:
        sigmas[:n] = np.array([report.sigmas[p] for p in network.points]).reshape(-1, 3)
        photos = [report.poses[p].sigma_position for p in network.photos]
        sigmas[n:] = np.array(photos).reshape(-1, 3)
    for i, a in enumerate("xyz"):
        out[a], out[f"sigma_{a}"] = xyz[:, i], sigmas[:, i]
    colours = [COLOURS[s] for s in states(report)] + [PHOTO] * len(poses)
    for i, colour in enumerate(("red", "green", "blue")):
        out[colour] = [c[i] for c in colours]
    out["kind"][n:] = 1
    head = [
        "ply",
        f"format {'binary_little_endian' if binary else 'ascii'} 1.0",
        f"comment factorgraph_adj {__version__}: {' '.join(network.name.split())}",
        "comment metres in the frame of the network; kind 0 point, 1 projection centre",
        f"element vertex {len(out)}",
        *(f"property {TYPES[VERTEX[c].str]} {c}" for c in VERTEX.names or ()),
        "end_header",
    ]
    start = ("\n".join(head) + "\n").encode("ascii", "replace")
    if binary:
        return start + out.tobytes()
    lines = (" ".join(str(v) for v in row) for row in out.tolist())
    return start + "".join(f"{line}\n" for line in lines).encode("ascii")
