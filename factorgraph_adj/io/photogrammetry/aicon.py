"""Reader of AICON 3D Studio (.ior, .eor, .obc, .phc, .scale): cameras, photos, points, scale bars.

Lengths are millimetres, angles radians; image coordinates have x right and y up. ``Ck`` is the
negative principal distance. Columns of the files:

    .ior    camera, –, Ck, xh, yh, A1, A2, R0 / A3 / B1, B2 / C1, C2 / width, height, columns, rows
    .eor    photo, camera, X, Y, Z, ω, φ, κ, sequence of rotations, active, state
    .obc    point, X, Y, Z, sX, sY, sZ, rays, active, new, datum
    .phc    photo, point, x, y, sx, sy, vx, vy, method, active, –
    .scale  number, "name", point, point, length, σ, active
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from ...errors import InputError, Problem
from ...models.lens import BalancedLens
from ...network.network import Network
from ...observations import ControlPoint, SlopeDistance
from ...units import MILLIMETRE
from ..format_reader import NetworkReader, Reader
from ..source import Problems, is_unread
from ..text_files import read_text
from .block_source import PHOTOS_SWITCHED_OFF, ImagePoints, filled_lines, whole_number

BLOCK_SUFFIXES = (".phc", ".eor", ".obc", ".ior")
"""Files that a block needs; .scale may be absent."""
AICON_PARAMETERS = ("c", "x0", "y0", "A1", "A2", "B1", "B2")
"""Parameters that AICON estimates; A3, C1 and C2 are held."""
CAMERA_LINE_COUNTS = (8, 1, 2, 2, 4)
"""Numbers in each line of a camera."""
UNORIENTED_STATE = "1"
"""State of a photo in .eor without a pose."""


def read_aicon(
    path: str | Path,
    *,
    sigma_mm: float = 0.0005,
    calibration: Sequence[str] = AICON_PARAMETERS,
    rejected: Literal["leave out", "keep"] = "leave out",
    datum: Literal["all", "marked"] = "all",
) -> Network:
    """Read a block of AICON 3D Studio.

    Active points and photos are read, with image points of these; those of points that the .obc
    file does not have or that are inactive are left out, as AICON leaves them out. New points
    carry the datum of a free network. Given points (new = 0) are control points with the standard
    deviations of the .obc file, and held where these are zero. Active scale bars are slope
    distances. A photo that is not oriented has no approximate pose.

    The sx and sy of the .phc file are precisions of the measurement of a target, which AICON
    does not weight by; they are not read, nor are residuals, methods and numbers of rays.

    Args:
        path: one of the files, or a folder with one block; the others have the same name.
        sigma_mm: a-priori standard deviation of image coordinates, millimetres; the files do
            not state it, reports of AICON do.
        calibration: unknown parameters of the cameras.
        rejected: whether image points that AICON rejected are kept.
        datum: whether all new points carry the datum, or those that the .obc file marks.

    Raises:
        InputError: a file is missing or has problems, each with file and line.
    """
    if not sigma_mm > 0:
        raise InputError(f"sigma_mm must be greater than zero, not {sigma_mm}")
    stem = _stem(Path(path))
    problems = Problems()
    network = Network(stem.name, datum="free")
    cameras = _cameras(stem.with_name(stem.name + ".ior"), network, problems, calibration)
    inactive = _points(stem.with_name(stem.name + ".obc"), network, problems, datum == "marked")
    off = _photos(stem.with_name(stem.name + ".eor"), network, problems, cameras)
    images = ImagePoints(problems)
    measured = stem.with_name(stem.name + ".phc")
    _image_points(measured, images, problems, network, off, sigma_mm, rejected == "keep")
    images.into(network)
    scale = stem.with_name(stem.name + ".scale")
    if scale.exists():
        _scale_bars(scale, network, problems, inactive)
    problems.finish(network)
    if any(o.kind == ControlPoint.kind for o in network.observations.values()) or any(
        any(p.fixed) for p in network.points.values()
    ):
        network.datum = "given"
    return network


def _stem(path: Path) -> Path:
    """Return folder and common name of the files of a block, without suffix.

    Raises:
        InputError: a file is missing, or a folder has several blocks.
    """
    if path.is_dir():
        names = sorted(p.stem for p in path.glob("*.obc"))
        if len(names) != 1:
            what = f"has {len(names)} files .obc; name the file of one block"
            raise InputError(Problem(what, str(path)))
        stem = path / names[0]
    else:
        stem = path.with_suffix("")
    absent = [s for s in BLOCK_SUFFIXES if not stem.with_name(stem.name + s).is_file()]
    if absent:
        raise InputError(Problem(f"the block lacks {', '.join(absent)}", str(stem)))
    return stem


def _rows(
    path: Path, sizes: range, problems: Problems, what: str, flags: Sequence[int] = ()
) -> Iterator[tuple[str, list[str]]]:
    """Yield file:line and the fields of each row that has a valid number of them.

    Args:
        path: the file.
        sizes: valid numbers of fields.
        problems: where problems go.
        what: names of the fields, for messages.
        flags: indices of fields that are 0 or 1.
    """
    for number, line in filled_lines(read_text(path)):
        if line.lstrip().startswith("#"):
            continue
        where = f"{path.name}:{number}"
        try:
            fields = shlex.split(line) if '"' in line else line.split()
        except ValueError:
            problems.wrong("a quotation mark is missing", where)
            continue
        if len(fields) not in sizes:
            problems.wrong(f"a row has {sizes[-1]} fields ({what}), not {len(fields)}", where)
        elif any(fields[i] not in ("0", "1") for i in flags if i < len(fields)):
            names = [n.strip() for n in what.split(",")]
            bad = next(i for i in flags if fields[i] not in ("0", "1"))
            problems.wrong(f"{names[bad]} must be 0 or 1, not {fields[bad][:20]!r}", where)
        else:
            yield where, fields


def _cameras(
    path: Path, network: Network, problems: Problems, calibration: Sequence[str]
) -> set[str]:
    """Add the cameras, of five lines each; return their names, also of those with problems."""
    rows = list(_rows(path, range(1, 9), problems, "a camera"))
    names: set[str] = set()
    for begin in range(0, len(rows), len(CAMERA_LINE_COUNTS)):
        part = rows[begin : begin + len(CAMERA_LINE_COUNTS)]
        where = part[0][0]
        if len(part) < len(CAMERA_LINE_COUNTS) - 1:
            problems.wrong(f"a camera has {len(CAMERA_LINE_COUNTS)} lines, not {len(part)}", where)
            break
        short = [
            (w, n, len(f))
            for (w, f), n in zip(part, CAMERA_LINE_COUNTS, strict=False)
            if len(f) != n
        ]
        if short:
            where, n, found_size = short[0]
            problems.wrong(f"this line of a camera has {n} numbers, not {found_size}", where)
            break
        name = part[0][1][0]
        texts = [t for (_, f), n in zip(part, CAMERA_LINE_COUNTS, strict=False) for t in f[:n]]
        texts[:2] = []
        found = problems.field(texts, f"camera {name!r}", where).numbers(len(texts))
        names.add(name)
        if is_unread(found):
            continue
        ck, x0, y0, a1, a2, radius, a3, b1, b2, c1, c2, *size = found
        values = {"c": -ck, "x0": x0, "y0": y0, "A1": a1, "A2": a2, "A3": a3}
        values |= {"B1": b1, "B2": b2, "C1": c1, "C2": c2}
        with problems.collect(where):
            network.add_camera(
                name,
                BalancedLens(zero_radius=radius),
                values,
                free=calibration,
                unit="mm",
                format=size[:2] or None,
            )
    if not rows:
        problems.wrong("has no camera", f"{path.name}:1")
    return names


def _points(path: Path, network: Network, problems: Problems, marked: bool) -> set[str]:
    """Add the active points; return the keys of the inactive ones."""
    off: set[str] = set()
    seen: set[str] = set()
    what = "point, X, Y, Z, sX, sY, sZ, rays, active, new, datum"
    for where, fields in _rows(path, range(11, 12), problems, what, (8, 9, 10)):
        name, active, new, datum = fields[0], fields[8], fields[9], fields[10]
        if name in seen:
            problems.wrong(f"point {name!r} is defined twice", where)
            continue
        seen.add(name)
        if whole_number(fields[7]) is None:
            problems.wrong(f"the number of rays must be whole, not {fields[7][:20]!r}", where)
        found = problems.field(fields[1:7], f"point {name!r}", where).numbers(6)
        if active == "0":
            off.add(f"point {name}")
            problems.leave_out(PHOTOS_SWITCHED_OFF, f"point {name}", where)
        if active == "0" or is_unread(found):
            continue
        at = (MILLIMETRE * found[0], MILLIMETRE * found[1], MILLIMETRE * found[2])
        with problems.collect(where):
            if new != "0":
                network.add_point(name, at, datum=not marked or datum != "0")
                continue
            held = "".join(a for a, s in zip("xyz", found[3:], strict=True) if not s)
            network.add_point(name, at, fixed=held)
            axes = [i for i in range(3) if found[3 + i]]
            if axes:
                value, sigma = (tuple(v[i] for i in axes) for v in (at, found[3:]))
                o = ControlPoint(
                    name,
                    value,
                    axes="".join("xyz"[i] for i in axes),
                    sigma=tuple(MILLIMETRE * s for s in sigma),
                    source=where,
                )
                network.add(o)
    return off


def _photos(path: Path, network: Network, problems: Problems, cameras: set[str]) -> set[str]:
    """Add the active photos; return the keys of the inactive ones."""
    off: set[str] = set()
    seen: set[str] = set()
    what = "photo, camera, X, Y, Z, ω, φ, κ, rotations, active, state"
    for where, fields in _rows(path, range(11, 12), problems, what):
        name, camera = fields[0], fields[1]
        if name in seen:
            problems.wrong(f"photo {name!r} is defined twice", where)
            continue
        seen.add(name)
        for number, what_for in zip(fields[9:11], ("active", "state"), strict=True):
            if whole_number(number) is None:
                problems.wrong(f"{what_for} must be a whole number, not {number[:20]!r}", where)
        if fields[9] == "0":
            off.add(f"photo {name}")
            problems.leave_out(PHOTOS_SWITCHED_OFF, f"photo {name}", where)
            continue
        if fields[8] != "0":
            what_is = f"sequence of rotations {fields[8]!r} cannot be read; valid: 0 (ω, φ, κ)"
            problems.wrong(what_is, where)
            continue
        found = problems.field(fields[2:8], f"photo {name!r}", where).numbers(6)
        if is_unread(found) or (camera in cameras and camera not in network.cameras):
            continue
        oriented = fields[10] != UNORIENTED_STATE
        with problems.collect(where):
            network.add_photo(
                name,
                camera,
                position=[MILLIMETRE * v for v in found[:3]] if oriented else None,
                omega_phi_kappa=found[3:] if oriented else None,
            )
    return off


def _image_points(
    path: Path,
    images: ImagePoints,
    problems: Problems,
    network: Network,
    off: set[str],
    sigma: float,
    keep: bool,
) -> None:
    """Gather the image points of points that the network has, in active photos."""
    what = "photo, point, x, y, sx, sy, vx, vy, method, active, –"
    for where, fields in _rows(path, range(10, 12), problems, what, (9,)):
        photo, point = fields[0], fields[1]
        if is_unread(problems.field(fields[2:9], f"image point {photo}/{point}", where).numbers(7)):
            continue
        left = point not in network.points or f"photo {photo}" in off
        if left or (fields[9] == "0" and not keep):
            problems.leave_out(PHOTOS_SWITCHED_OFF, f"image point {photo}/{point}", where)
            continue
        xy = problems.field(fields[2:4], f"image point {photo}/{point}", where).numbers(2)
        if not is_unread(xy):
            images.add(photo, point, xy, (sigma,), where)


def _scale_bars(path: Path, network: Network, problems: Problems, off: set[str]) -> None:
    """Add the active scale bars between active points."""
    what = 'number, "name", point, point, length, σ, active'
    for where, fields in _rows(path, range(7, 8), problems, what, (6,)):
        name, a, b = fields[1], fields[2], fields[3]
        if whole_number(fields[0]) is None:
            what_is = f"the number of a scale bar must be whole, not {fields[0][:20]!r}"
            problems.wrong(what_is, where)
        if fields[6] == "0" or f"point {a}" in off or f"point {b}" in off:
            problems.leave_out(PHOTOS_SWITCHED_OFF, f"scale bar {name}", where)
            continue
        found = problems.field(fields[4:6], f"scale bar {name!r}", where).numbers(2)
        if not is_unread(found):
            taken = name in network.observations
            with problems.collect(where):
                network.add(
                    SlopeDistance(
                        a,
                        b,
                        MILLIMETRE * found[0],
                        sigma=MILLIMETRE * found[1],
                        id=None if taken else name,
                        source=where,
                    )
                )


READER = Reader(
    "aicon", (".obc", ".phc", ".eor", ".ior"), "AICON 3D Studio", NetworkReader(read_aicon)
)
